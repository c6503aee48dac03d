"""What readers of images decided or put right, in sentences."""

import numpy as np

from mgsgraph.network import Network
from mgsgraph.wording import some_of


def reading_statements(network: Network) -> list[str]:
    """One sentence for each remark, with the images that it is of."""
    names = [image.name for image in network.images]
    of_remark = dict[str, list[int]]()
    for j, image in enumerate(network.images):
        for remark in image.remarks:
            of_remark.setdefault(remark, []).append(j)
    return [f"As read, {some_of(names, np.array(members))}: {remark}." for remark, members in of_remark.items()]
