"""A control network thinned: few points, well spread over every image, and no connection of images lost.

Every image is divided into cells, and the best points are taken one after the other as long as they fall into a cell of
an image of theirs that has none yet; then more, until all images that had points in common keep some. The best are
those in many images, and among these those of small sigmas and a high GoodnessOfFit. Constrained, fixed and locked
points always stay, beside these; ignored ones, and free ones in a single image, never do.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from msgspec import structs

from mgsgraph.errors import InputError
from mgsgraph.files.networks.choosing import common_points, used_images
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, PointType
from mgsgraph.text import many, some

_LINK = 4
"""Points that two images keep in common, if they had as many."""
_GOODNESS = 2
"""Number of GoodnessOfFit among the figures of merit."""
_UNSTATED = 1.0
"""px, for a sigma that is not stated."""

Cell = tuple[str, int, int]
"""Image, row and column."""


class _Grid(NamedTuple):
    """Cells of an image."""

    first: tuple[float, float]
    """Line and sample."""
    step: tuple[float, float]
    """Lines and samples of a cell."""
    shape: tuple[int, int]


def thinned(
    network: ControlNetwork, cells: int, sizes: Mapping[str, tuple[int, int]] | None = None
) -> tuple[ControlNetwork, list[str]]:
    """A network with fewer points, and sentences about what is left of it.

    Parameters
    ----------
    network : ControlNetwork
    cells : int
        In each image; about as many tie points are left in it.
    sizes : mapping, optional
        Lines and samples of images by their names; of others the cells divide the part where there are measures.

    Raises
    ------
    InputError
        No cells, or no point left.
    """
    if cells < 1:
        raise InputError("--thin", f"{cells} cells", "one at least in each image")
    images = [used_images(point) for point in network.points]
    always = {i for i, point in enumerate(network.points) if images[i] and _stays(point)}
    useful = [i for i, names in enumerate(images) if i in always or len(names) > 1]
    if not useful:
        raise InputError(network.source, "no point in two images", "some that connect images")
    ties = sorted((i for i in useful if i not in always), key=lambda i: _badness(network.points[i], len(images[i])))
    grids = _grids([network.points[i] for i in ties], cells, sizes or {})
    kept, taken = set[int](), set[Cell]()
    for i in ties:
        occupied = _cells(network.points[i], grids)
        if not taken.issuperset(occupied):
            kept.add(i)
            taken |= occupied
    before, links = common_points([images[i] for i in ties]), Counter(common_points([images[i] for i in kept]))
    for i in ties:
        pairs = list(combinations(sorted(images[i]), 2))
        if i not in kept and any(links[pair] < min(before[pair], _LINK) for pair in pairs):
            kept.add(i)
            links.update(pairs)
    kept |= always
    points = tuple(network.points[i] for i in sorted(kept))
    needless = len(network.points) - len(useful)
    return structs.replace(network, points=points), _said(network, images, kept, links, needless)


def _stays(point: ControlPoint) -> bool:
    return point.type != PointType.FREE or point.edit_lock


def _badness(point: ControlPoint, images: int) -> tuple[bool, int, float, float]:
    """By which points are sorted, the best first."""
    measures = [one for one in point.measures if not one.ignore]
    sigma = max(max(one.line_sigma or _UNSTATED, one.sample_sigma or _UNSTATED) for one in measures)
    rejected = point.jigsaw_rejected or any(one.jigsaw_rejected for one in measures)
    return rejected, -images, sigma, -min((_goodness(one) for one in measures if one.log), default=0.0)


def _goodness(measure: ControlMeasure) -> float:
    return max((value for kind, value in measure.log if kind == _GOODNESS), default=0.0)


def _grids(points: Sequence[ControlPoint], cells: int, sizes: Mapping[str, tuple[int, int]]) -> dict[str, _Grid]:
    """Cells as nearly square as so many can be."""
    places: dict[str, list[tuple[float, float]]] = {}
    for point in points:
        for one in point.measures:
            if not one.ignore:
                places.setdefault(one.serial_number, []).append((one.line or 0.0, one.sample or 0.0))
    grids = {}
    for name, found in places.items():
        low, high = np.min(found, axis=0), np.max(found, axis=0)
        if name in sizes:
            low, high = np.full(2, 0.5), np.array(sizes[name]) + 0.5
        height, width = np.maximum(high - low, 1.0).tolist()
        columns = int(np.clip(round((cells * width / height) ** 0.5), 1, cells))
        rows = max(1, cells // columns)
        grids[name] = _Grid((float(low[0]), float(low[1])), (height / rows, width / columns), (rows, columns))
    return grids


def _cells(point: ControlPoint, grids: Mapping[str, _Grid]) -> set[Cell]:
    """Cells in which a point has measures."""
    found = set[Cell]()
    for one in point.measures:
        if not one.ignore:
            first, step, shape = grids[one.serial_number]
            row, column = (
                min(max(int(((value or 0.0) - low) / size), 0), count - 1)
                for value, low, size, count in zip((one.line, one.sample), first, step, shape, strict=True)
            )
            found.add((one.serial_number, row, column))
    return found


def _said(
    network: ControlNetwork, images: Sequence[tuple[str, ...]], kept: set[int], links: Mapping[tuple[str, str], int],
    needless: int,
) -> list[str]:  # fmt: skip
    before = Counter(name for names in images for name in names)
    after = Counter(name for i in kept for name in images[i])
    fewest = sorted(after, key=lambda name: (after[name], name))
    of_images = [f"{name} {after[name]} of {before[name]}" for name in fewest]
    said = [
        f"Thinned: {len(kept)} of {many(len(network.points), 'point')} stay; in images, the fewest first: "
        + some(of_images, len(of_images))
    ]
    if links:
        pair = min(links, key=lambda pair: (links[pair], pair))
        said.append(f"Of two images with tie points in common {pair[0]} and {pair[1]} keep the fewest, {links[pair]}")
    if needless:
        said.append(f"Left out, being ignored or seen by a single image: {many(needless, 'point')}")
    return said
