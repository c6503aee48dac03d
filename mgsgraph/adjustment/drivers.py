"""Which images and points drive an adjustment that does not converge, or fails the sanity checks.

These quantities are divided among images and among points, at the state that the adjustment has reached:

* the cost: each measure's part of it belongs to its image and to its point, an a-priori orientation's to its image;
* the points that have no place there: behind a camera, on rays that part, or not determined by their rays.

An image or a point *stands out* where its mean square per measure is many times the median of all others', by more than
chance gives. Wrong measures of few points make residuals of many images larger, and one wrong image those of its
points: where nearly all points that stand out are measured in one image, or in those that stand out, and few other
points are, the images explain the points; else the points explain the images, and these are looked at again without
them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.fit import Residuals, residuals, squares_of
from mgsgraph.adjustment.graph import BundleGraph, Layout
from mgsgraph.geometry.records import Array, Index, Mask, no_rows
from mgsgraph.kernel.rows import BEHIND, GOOD, OUT, WEAK
from mgsgraph.kernel.sweep import Reduction
from mgsgraph.network import Network
from mgsgraph.network.parallel import nearly_parallel
from mgsgraph.record import Record
from mgsgraph.text import many

LISTED = 100
"""Images, and points, that are listed of each quantity."""


class Quantity(StrEnum):
    """A quantity divided among images and points."""

    COST = "cost"
    """The cost at the state that was reached."""
    LOST = "lost points"
    """Points without a place at that state."""


class Kind(StrEnum):
    """What it is divided among."""

    IMAGE = "image"
    POINT = "point"


@dataclass(frozen=True, slots=True, eq=False)
class Contributions(Record):
    """Parts of images, or of points, in one quantity."""

    quantity: Quantity
    """The quantity."""
    kind: Kind
    """Images or points."""
    of: int
    """How many images, or points, there are."""
    members: Index
    """(m,) images, or points, those that stand out before others, the largest share first; `LISTED` at the most."""
    shares: Array
    """(m,) of the quantity."""
    flagged: int
    """How many stand out."""
    share: float
    """Share of these together."""

    @property
    def named(self) -> Index:
        """Members that stand out."""
        return self.members[: self.flagged]


@dataclass(frozen=True, slots=True, eq=False)
class Drivers(Record):
    """Which images and points drive an adjustment."""

    contributions: tuple[Contributions, ...]
    """Of each quantity that isn't zero: of images and of points, the more concentrated first."""
    cost: float
    """At the state that was reached, of all measures with a place."""
    behind: int
    """Points behind a camera."""
    parting: int
    """Of these, those whose rays are nearly parallel and part."""
    weak: int
    """Points that their rays don't determine."""

    @property
    def flagged(self) -> tuple[Contributions, ...]:
        """Contributions of images and points that stand out, in the order in which they say the most."""
        return tuple(part for part in self.contributions if part.flagged)


def driver_sentences(drivers: Drivers, network: Network) -> list[str]:
    """Sentences: which images and points stand out, by name; or that none does."""
    if drivers.flagged:
        sentences = [_sentence(part, network) for part in _without_repeated(drivers.flagged)]
        return [f"What drives it: {sentences[0]}", *sentences[1:]]
    largest = [part for part in drivers.contributions if part.quantity == Quantity.COST and part.members.size]
    shares = " and ".join(f"{_names(part, network, 1)} with {_percent(part.shares[0])}" for part in largest)
    most = f" The largest shares of the cost have {shares}." if shares else ""
    return [f"No image and no point stands out: nothing in particular drives it.{most}"]


def _without_repeated(parts: Sequence[Contributions]) -> list[Contributions]:
    """Contributions; of the points without a place only the images where these stand out, else only the points."""
    quantities, selected = set[Quantity](), list[Contributions]()
    for part in parts:
        if part.quantity == Quantity.COST or part.quantity not in quantities:
            selected.append(part)
        quantities.add(part.quantity)
    return selected


def _sentence(part: Contributions, network: Network) -> str:
    """The share of a quantity of those that stand out, and their names."""
    count, kind = part.flagged, str(part.kind)
    who, names = f"{count} of {many(part.of, kind)}", _names(part, network)
    share, plural = _percent(part.share), count != 1
    if part.quantity == Quantity.COST:
        return f"{who} {'carry' if plural else 'carries'} {share} of the cost: {names}."
    what = "no place where it stopped (behind a camera, on rays that part, or not determined by them)"
    if part.kind == Kind.POINT:
        return f"{who} {'have' if plural else 'has'} {what}: {names}."
    return f"{who} {'see' if plural else 'sees'} most of the points that have {what}: {names}."


def _names(part: Contributions, network: Network, most: int = 3) -> str:
    """Names of images, or ids of points, that stand out; of the first where none does."""
    index = part.members[: min(most, part.flagged or most)].tolist()
    names = [network.images[i].name if part.kind == Kind.IMAGE else network.points.ids[i] for i in index]
    more = part.flagged - len(names)
    return ", ".join(names) + (f" and {more} more" if more > 0 else "")


def _percent(share: float) -> str:
    """A share in words."""
    return "less than 1 %" if share < 0.005 else f"{math.floor(100.0 * share + 0.5)} %"


_FEW = 20.0
"""Added to the factor of an image with one measure; of one with n measures the n-th part of it."""
LEAST = 1.0
"""Mean square that stands out at least."""
_SHARE = 0.1
"""Least total share of a quantity of those that stand out."""
FEWEST = 5
"""Points that an image must have seen to be named for them."""
_COVERED, _RATIO = 0.8, 3.0
"""Share of the flagged points that images must see to explain them; its least ratio to the share of all points."""


def flagged_by_share(
    values: Array, measures: Array, factor: float, total: float | None = None, pulled: float = 0.0
) -> Mask:
    """(n,) whose mean square per measure is many times the median, and a share `pulled` of the largest, if together
    they have a share of the whole.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        level = np.where(measures > 0.0, values / measures, 0.0)
        few = np.where(measures > 0.0, _FEW / measures, 0.0)
    typical = float(np.median(level[measures > 0.0])) if np.any(measures > 0.0) else 0.0
    flagged = (level >= LEAST) & (level > typical * (factor + few))
    flagged &= level >= pulled * np.max(level, initial=0.0, where=flagged)
    return np.asarray(flagged & (values[flagged].sum() >= _SHARE * (values.sum() if total is None else total)))


def contributions(
    quantity: Quantity, kind: Kind, values: Array, flagged: Mask, then: Array | None = None,
    all_of_it: float | None = None,
) -> Contributions:  # fmt: skip
    """The record; ties in `values` (n,) go by `then` (n,)."""
    total = float(values.sum() if all_of_it is None else all_of_it)
    if not total > 0.0:
        return Contributions(quantity, kind, values.size, no_rows(), np.zeros(0), 0, 0.0)
    parts = []
    for chosen in (flagged, ~flagged & (values > 0.0)):
        index = np.flatnonzero(chosen)
        keys = (-values[index],) if then is None else (-then[index], -values[index])
        parts.append(index[np.lexsort(keys)][:LISTED])
    members = np.concatenate(parts)[:LISTED]
    share = 1.0 if all_of_it is not None and np.any(flagged) else float(values[flagged].sum()) / total
    return Contributions(
        quantity, kind, values.size, members, values[members] / total, int(np.count_nonzero(flagged)), share
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
        measured = np.zeros_like(points)
        measured[network.rays.point[some[network.rays.image]]] = True
        share = np.count_nonzero(measured & points) / number
        if share >= _COVERED and share >= _RATIO * np.mean(measured):
            return True
    return False


_IMAGES, _POINTS = 4.0, 100.0
"""Times the median mean square from which on an image, and a point, stands out: of ten million points on two
rays, whose squares have one degree of freedom, the largest is 64 times the median."""
_UNADJUSTED = 25.0
"""The same of images where nothing has been adjusted yet: there each has the cost of its own orientation's error."""
_PULLED = 0.1
"""Share of the largest mean square of an image up to which that image causes those of others."""
_MOST = 0.1
"""Share of all points that stand out or have no place, beyond which images are the more likely cause."""


class _Costs(NamedTuple):
    """What each measure of a point that has a place adds to the cost, and what a-priori orientations add."""

    point: Index
    """(m,) point of each measure."""
    image: Index
    """(m,) its image; -1 for none."""
    values: Array
    """(m,) its part of the cost."""
    own: Array
    """(images,) part of each image's a-priori orientation."""
    rows: Array
    """(images,) rows of that, in pairs, as a ray has them."""
    points: int
    """Number of points."""

    def of_images(self) -> tuple[Array, Array]:
        """(images,) part of each image, and the number of its measures."""
        in_images, size = self.image >= 0, self.own.size
        image = self.image[in_images]
        measures = np.bincount(image, minlength=size) + self.rows
        return np.asarray(np.bincount(image, self.values[in_images], size) + self.own), np.asarray(measures)

    def of_points(self) -> tuple[Array, Array]:
        """(n,) part of each point, and the number of its measures."""
        measures = np.bincount(self.point, minlength=self.points).astype(np.float64)
        return np.asarray(np.bincount(self.point, self.values, self.points), dtype=np.float64), measures

    def without(self, points: Mask) -> "_Costs":
        """The same without the measures of some points (n,)."""
        remaining = ~points[self.point]
        return self._replace(point=self.point[remaining], image=self.image[remaining], values=self.values[remaining])


def drivers_of(
    graph: BundleGraph, reduction: Reduction, known_residuals: Residuals | None = None
) -> Drivers:
    """Images and points that drive an adjustment.

    Parameters
    ----------
    graph : BundleGraph
        With the rows that take part.
    reduction : Reduction
        Of these rows, at the state that was reached.
    known_residuals : Residuals, optional
        At that state; they cost a sweep when absent.
    """
    layout, network = graph.layout, graph.layout.network
    taking, states = layout.network_order(graph.rows.kind) != OUT, layout.network_order(reduction.states)
    residuals_ = known_residuals or residuals(layout, reduction.orientation, reduction.points, graph.sweeper)
    unplaced = taking & (states != GOOD)
    costs = _costs(graph, reduction, residuals_, unplaced)
    factor = _IMAGES if np.any(reduction.orientation) else _UNADJUSTED
    parts = _of_cost(network, costs, factor) + _of_unplaced(network, unplaced, costs)
    behind = np.flatnonzero(taking & (states == BEHIND))
    return Drivers(
        contributions=tuple(parts),
        cost=float(costs.values.sum() + costs.own.sum()),
        behind=behind.size,
        parting=int(np.count_nonzero(nearly_parallel(network, behind))),
        weak=int(np.count_nonzero(taking & (states == WEAK))),
    )


def _costs(graph: BundleGraph, reduction: Reduction, residuals_: Residuals, unplaced: Mask) -> _Costs:
    """Parts of the cost at a reduction, none of measures of lost points (n,)."""
    layout = graph.layout
    squares_by_kind = squares_of(layout, graph.rows, reduction.orientation, reduction.points, residuals_).values()
    point, image = (np.concatenate([getattr(kind, name) for kind in squares_by_kind]) for name in ("point", "image"))
    values = np.concatenate([kind.costs(layout.model) for kind in squares_by_kind])
    values[unplaced[point] | ~np.isfinite(values)] = 0.0
    rows = layout.prior.residuals(reduction.orientation)
    rows = np.concatenate([rows[: layout.columns][layout.prior.weights > 0.0], rows[layout.columns :]])
    squares = np.asarray(np.bincount(layout.prior.about, 0.5 * rows**2, layout.columns), dtype=np.float64)
    count = np.asarray(0.5 * np.bincount(layout.prior.about, minlength=layout.columns), dtype=np.float64)
    return _Costs(
        point, image, values, _by_image(layout, squares), _by_image(layout, count), len(layout.network.points)
    )


def _by_image(layout: Layout, values: Array) -> Array:
    """(images,) sum of values (columns,) of the unknowns of each image's orientation; those of a pass go to its images
    in equal parts.
    """
    network, adjusted = layout.network, layout.variables.adjusted()
    sums = np.zeros(layout.variables.first.size)
    np.add.at(sums, np.repeat(adjusted, layout.variables.width[adjusted]), values)
    by_image = sums[: len(network.images)].copy()
    for pass_, first in network.numbered_passes:
        by_image[pass_.images] += sums[first : first + pass_.widths.size].sum() / pass_.images.size
    return by_image


# --- who has how much of each quantity


def _of_cost(network: Network, costs: _Costs, factor: float) -> list[Contributions]:
    """Of the cost: images where they explain the points; else points, and images that stand out without these, too. An
    image stands out from a factor on.
    """
    images, points = costs.of_images(), costs.of_points()
    of_images, of_points = flagged_by_share(*images, factor, pulled=_PULLED), flagged_by_share(*points, _POINTS)
    scattered = bool(np.mean(of_points) > _MOST) and bool(np.any(of_images))
    points_first = bool(np.any(of_points)) and not (scattered or covered(network, images[0], of_images, of_points))
    if points_first:
        of_images &= flagged_by_share(*costs.without(of_points).of_images(), factor, images[0].sum())
        points_first = not np.any(of_images) or images[0][of_images].sum() < points[0][of_points].sum()
    elif np.any(of_images):  # they disturb neighboring images and the points of these
        of_points = np.zeros_like(of_points)
    parts = [
        contributions(Quantity.COST, Kind.IMAGE, images[0], of_images),
        contributions(Quantity.COST, Kind.POINT, points[0], of_points),
    ]
    return [part for part in (parts[::-1] if points_first else parts) if part.members.size]


def _of_unplaced(network: Network, unplaced: Mask, costs: _Costs) -> list[Contributions]:
    """Of points (n,) without a place: all of them stand out where they are few; images by how many of them they see."""
    count = int(np.count_nonzero(unplaced))
    if not count:
        return []
    images_of_unplaced = network.rays.image[unplaced[network.rays.point]]
    number = np.bincount(images_of_unplaced, minlength=len(network.images)).astype(np.float64)
    shares = np.bincount(network.rays.image, minlength=number.size) / unplaced.size
    few, (level, measures) = count <= _MOST * unplaced.size, costs.of_images()
    far = (number >= 0.5 * count) & (number / count >= _IMAGES * shares) & (count >= FEWEST) & few
    level = level / np.maximum(measures, 1.0)
    parts = [
        contributions(Quantity.LOST, Kind.POINT, unplaced.astype(np.float64), unplaced & few),
        contributions(Quantity.LOST, Kind.IMAGE, number, far, level, count),
    ]
    return parts[::-1] if np.any(far) else parts
