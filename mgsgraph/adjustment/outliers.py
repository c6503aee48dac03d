"""Which of many images, or points, stand out by their part in a quantity."""

import numpy as np

from mgsgraph.adjustment.drivers import LISTED, Contributions, Kind, Quantity
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.network import Network

_FEW = 20.0
"""Times more that is asked of an image with one measure; of one with n measures the n-th part of it."""
LEAST = 1.0
"""Mean square, or step in a-priori sigmas, that stands out at least."""
_SHARE = 0.1
"""Share of a quantity that those who stand out have together at least."""
FEWEST = 5
"""Points that an image must have seen to be named for them."""
_COVERED, _RATIO = 0.8, 3.0
"""Share of the points that stand out which images must have seen to explain them, and times the share of all points."""


def outstanding(
    values: Array, measures: Array, factor: float, whole: float | None = None, share: float = _SHARE,
    least: float = LEAST, pulled: float = 0.0,
) -> Mask:  # fmt: skip
    """(n,) whose mean square per measure is many times the median, and a share `pulled` of the largest, if together
    they have a share of the whole.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        level = np.where(measures > 0.0, values / measures, 0.0)
        few = np.where(measures > 0.0, _FEW / measures, 0.0)
    typical = float(np.median(level[measures > 0.0])) if np.any(measures > 0.0) else 0.0
    found = (level >= least) & (level > typical * (factor + few))
    found &= level >= pulled * np.max(level, initial=0.0, where=found)
    enough = values[found].sum() >= share * (values.sum() if whole is None else whole)
    return np.asarray(found & enough)


def contributions(
    quantity: Quantity, kind: Kind, values: Array, outstanding: Mask, then: Array | None = None,
    whole: float | None = None,
) -> Contributions:  # fmt: skip
    """The record; ties in `values` (n,) go by `then` (n,)."""
    total = float(values.sum() if whole is None else whole)
    if not total > 0.0:
        return Contributions(quantity, kind, values.size, np.zeros(0, dtype=np.int64), np.zeros(0), 0, 0.0)
    parts = []
    for mine in (outstanding, ~outstanding & (values > 0.0)):
        index = np.flatnonzero(mine)
        if then is None and index.size > LISTED:
            index = index[np.argpartition(-values[index], LISTED)[:LISTED]]
        keys = (-values[index],) if then is None else (-then[index], -values[index])
        parts.append(index[np.lexsort(keys)][:LISTED])
    members = np.concatenate(parts)[:LISTED]
    share = 1.0 if whole is not None and np.any(outstanding) else float(values[outstanding].sum()) / total
    return Contributions(
        quantity, kind, values.size, members, values[members] / total, int(np.count_nonzero(outstanding)), share
    )


def covered(network: Network, values: Array, images: Mask, points: Mask) -> bool:
    """Whether those images (images,) that stand out, or the first of them by values (images,), explain the points (n,)
    that do: nearly all of these are measured in them, and few others.
    """
    number = int(np.count_nonzero(points))
    if not np.any(images) or number < FEWEST:
        return False
    first = np.zeros_like(images)
    first[np.argmax(np.where(images, values, -1.0))] = True
    for some in (images, first):
        seen = np.zeros_like(points)
        seen[network.rays.point[some[network.rays.image]]] = True
        share = np.count_nonzero(seen & points) / number
        if share >= _COVERED and share >= _RATIO * np.mean(seen):
            return True
    return False
