"""What readers of images decided or put right, in sentences."""

from collections.abc import Sequence

import numpy as np

from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.wording import some_of


def reading_statements(images: Sequence[PushbroomImage]) -> list[str]:
    """One sentence for each remark, with the images that it is of."""
    names = [image.name for image in images]
    of_remark = dict[str, list[int]]()
    for j, image in enumerate(images):
        for remark in image.remarks:
            of_remark.setdefault(remark, []).append(j)
    return [f"As read, {some_of(names, np.array(members))}: {remark}." for remark, members in of_remark.items()]
