"""What is said before anything is solved: what readers of images decided or put right, and what no prior explains."""

from collections.abc import Sequence

import numpy as np

from mgsgraph.analysis.input_checks import unexplained_ranges, unexplained_residuals
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network
from mgsgraph.text import NAMED, some, some_of


def reading_statements(images: Sequence[PushbroomImage]) -> list[str]:
    """One sentence for each remark, with the images that it is of."""
    names = [image.name for image in images]
    of_remark = dict[str, list[int]]()
    for j, image in enumerate(images):
        for remark in image.remarks:
            of_remark.setdefault(remark, []).append(j)
    return [f"As read, {some_of(names, np.array(members))}: {remark}." for remark, members in of_remark.items()]


def beyond_priors_statements(network: Network, residuals: Array) -> list[str]:
    """Images whose residuals (k, 2) with the nominal orientation no error within the a-priori sigmas explains."""
    found = unexplained_residuals(network, residuals)
    if not found:
        return []
    parts = [
        f"{network.images[one.image].name} {one.median:.0f} px (expected {one.expected:.2g})" for one in found[:NAMED]
    ]
    return [
        "residuals with the nominal orientation are larger than a-priori sigmas explain, median of "
        f"{some(parts, len(found))}: images, lines and samples, or labels may be interchanged, or sigmas too small"
    ]


def range_statements(network: Network, residuals: Array) -> list[str]:
    """Images whose range residuals (r,) with the nominal orientation no error within the a-priori sigmas explains."""
    found = unexplained_ranges(network, residuals)
    if not found:
        return []
    parts = [
        f"{network.images[one.image].name} {one.mean:+.4g} m (expected {one.expected:.2g})" for one in found[:NAMED]
    ]
    return [
        "laser ranges minus the distances to their footprints have a mean that no a-priori sigma explains, "
        f"{some(parts, len(found))}: look at the ranges (their unit, scale and bias), the footprints' radii and the "
        "orbit before a sigma is made larger"
    ]
