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
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.kernel.rows import BEHIND, GOOD, OUT, WEAK
from mgsgraph.kernel.sweep import Reduction
from mgsgraph.network import Network
from mgsgraph.network.parallel import nearly_parallel
from mgsgraph.record import Record
from mgsgraph.text import many

LISTED = 100
"""Images, and points, that are listed of each quantity."""


class Quantity(StrEnum):
    """What images and points have a part in."""

    COST = "cost"
    """The cost at the state that was reached."""
    LOST = "lost points"
    """Points without a place at that state."""


class Kind(StrEnum):
    """What has a part in it."""

    IMAGE = "image"
    POINT = "point"


@dataclass(frozen=True, slots=True, eq=False)
class Contributions(Record):
    """Parts of images, or of points, in one quantity."""

    quantity: Quantity
    """In what."""
    kind: Kind
    """Of what."""
    of: int
    """How many images, or points, there are."""
    members: Index
    """(m,) images, or points, those that stand out before others, the largest share first; `LISTED` at the most."""
    shares: Array
    """(m,) of the quantity."""
    outstanding: int
    """How many stand out."""
    share: float
    """Share of these together."""

    @property
    def named(self) -> Index:
        """Members that stand out."""
        return self.members[: self.outstanding]


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
    def outstanding(self) -> tuple[Contributions, ...]:
        """Contributions of images and points that stand out, in the order in which they say the most."""
        return tuple(one for one in self.contributions if one.outstanding)


def driver_sentences(found: Drivers, network: Network) -> list[str]:
    """Which images and points stand out, by name; or that none does."""
    if found.outstanding:
        sentences = [_sentence(one, network) for one in _without_repeated(found.outstanding)]
        return [f"What drives it: {sentences[0]}", *sentences[1:]]
    largest = [one for one in found.contributions if one.quantity == Quantity.COST and one.members.size]
    shares = " and ".join(f"{_names(one, network, 1)} with {_percent(one.shares[0])}" for one in largest)
    most = f" The largest shares of the cost have {shares}." if shares else ""
    return [f"No image and no point stands out: nothing in particular drives it.{most}"]


def _without_repeated(told: Sequence[Contributions]) -> list[Contributions]:
    """Of the points without a place, the images where these say it, else the points."""
    seen, left = set[Quantity](), list[Contributions]()
    for one in told:
        if one.quantity == Quantity.COST or one.quantity not in seen:
            left.append(one)
        seen.add(one.quantity)
    return left


def _sentence(one: Contributions, network: Network) -> str:
    """How much of a quantity those have that stand out, and their names."""
    count, kind = one.outstanding, str(one.kind)
    who, names = f"{count} of {many(one.of, kind)}", _names(one, network)
    share, plural = _percent(one.share), count != 1
    if one.quantity == Quantity.COST:
        return f"{who} {'carry' if plural else 'carries'} {share} of the cost: {names}."
    what = "no place where it stopped (behind a camera, on rays that part, or not determined by them)"
    if one.kind == Kind.POINT:
        return f"{who} {'have' if plural else 'has'} {what}: {names}."
    return f"{who} {'see' if plural else 'sees'} most of the points that have {what}: {names}."


def _names(one: Contributions, network: Network, most: int = 3) -> str:
    """Names of images, or ids of points, that stand out; of the first where none does."""
    index = one.members[: min(most, one.outstanding or most)].tolist()
    names = [network.images[i].name if one.kind == Kind.IMAGE else network.points.ids[i] for i in index]
    more = one.outstanding - len(names)
    return ", ".join(names) + (f" and {more} more" if more > 0 else "")


def _percent(share: float) -> str:
    """A share in words."""
    return "less than 1 %" if share < 0.005 else f"{math.floor(100.0 * share + 0.5)} %"


_FEW = 20.0
"""Times more that is asked of an image with one measure; of one with n measures the n-th part of it."""
LEAST = 1.0
"""Mean square that stands out at least."""
_SHARE = 0.1
"""Share of a quantity that those who stand out have together at least."""
FEWEST = 5
"""Points that an image must have seen to be named for them."""
_COVERED, _RATIO = 0.8, 3.0
"""Share of the points that stand out which images must have seen to explain them, and times the share of all points."""


def outstanding(
    values: Array, measures: Array, factor: float, whole: float | None = None, pulled: float = 0.0
) -> Mask:
    """(n,) whose mean square per measure is many times the median, and a share `pulled` of the largest, if together
    they have a share of the whole.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        level = np.where(measures > 0.0, values / measures, 0.0)
        few = np.where(measures > 0.0, _FEW / measures, 0.0)
    typical = float(np.median(level[measures > 0.0])) if np.any(measures > 0.0) else 0.0
    found = (level >= LEAST) & (level > typical * (factor + few))
    found &= level >= pulled * np.max(level, initial=0.0, where=found)
    enough = values[found].sum() >= _SHARE * (values.sum() if whole is None else whole)
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


_IMAGES, _POINTS = 4.0, 100.0
"""Times the median mean square from which on an image, and a point, stands out: of ten million points on two
rays, whose squares have one degree of freedom, the largest is 64 times the median."""
_UNADJUSTED = 25.0
"""The same of images where nothing has been adjusted yet: there each has the cost of its own orientation's error."""
_PULLED = 0.1
"""Share of the largest mean square of an image up to which others owe theirs to that image."""
_MOST = 0.1
"""Share of all points beyond which those that stand out, or have no place, are rather the images' doing."""


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
        mine, size = self.image >= 0, self.own.size
        image = self.image[mine]
        measures = np.bincount(image, minlength=size) + self.rows
        return np.asarray(np.bincount(image, self.values[mine], size) + self.own), np.asarray(measures)

    def of_points(self) -> tuple[Array, Array]:
        """(n,) part of each point, and the number of its measures."""
        measures = np.bincount(self.point, minlength=self.points).astype(np.float64)
        return np.asarray(np.bincount(self.point, self.values, self.points), dtype=np.float64), measures

    def without(self, points: Mask) -> "_Costs":
        """The same without the measures of some points (n,)."""
        left = ~points[self.point]
        return self._replace(point=self.point[left], image=self.image[left], values=self.values[left])


def drivers_of(
    graph: BundleGraph, reduction: Reduction, found: Residuals | None = None
) -> Drivers:
    """Images and points that drive an adjustment.

    Parameters
    ----------
    graph : BundleGraph
        With the rows that take part.
    reduction : Reduction
        Of these rows, at the state that was reached.
    found : Residuals, optional
        At that state; they cost a sweep when absent.
    """
    layout, network = graph.layout, graph.layout.network
    taking, states = layout.network_order(graph.rows.kind) != OUT, layout.network_order(reduction.states)
    known = found or residuals(layout, reduction.orientation, reduction.points, graph.sweeper)
    lost = taking & (states != GOOD)
    here = _costs(graph, reduction, known, lost)
    factor = _IMAGES if np.any(reduction.orientation) else _UNADJUSTED
    every = _of_cost(network, here, factor) + _of_lost(network, lost, here)
    behind = np.flatnonzero(taking & (states == BEHIND))
    return Drivers(
        contributions=tuple(every),
        cost=float(here.values.sum() + here.own.sum()),
        behind=behind.size,
        parting=int(np.count_nonzero(nearly_parallel(network, behind))),
        weak=int(np.count_nonzero(taking & (states == WEAK))),
    )


def _costs(graph: BundleGraph, reduction: Reduction, found: Residuals, lost: Mask) -> _Costs:
    """Parts of the cost at a reduction, none of measures of lost points (n,)."""
    layout = graph.layout
    every = squares_of(layout, graph.rows, reduction.orientation, reduction.points, found).values()
    point, image = np.concatenate([one.point for one in every]), np.concatenate([one.image for one in every])
    values = np.concatenate([one.costs(layout.model) for one in every])
    values[lost[point] | ~np.isfinite(values)] = 0.0
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
    network, own = layout.network, layout.variables.adjusted()
    sums = np.zeros(layout.variables.first.size)
    np.add.at(sums, np.repeat(own, layout.variables.width[own]), values)
    found = sums[: len(network.images)].copy()
    for one, first in network.numbered_passes:
        found[one.images] += sums[first : first + one.widths.size].sum() / one.images.size
    return found


# --- who has how much of each quantity


def _of_cost(network: Network, costs: _Costs, factor: float) -> list[Contributions]:
    """Of the cost: images where they explain the points; else points, and images that stand out without these, too. An
    image stands out from a factor on.
    """
    images, points = costs.of_images(), costs.of_points()
    of_images, of_points = outstanding(*images, factor, pulled=_PULLED), outstanding(*points, _POINTS)
    scattered = bool(np.mean(of_points) > _MOST) and bool(np.any(of_images))
    points_first = bool(np.any(of_points)) and not (scattered or covered(network, images[0], of_images, of_points))
    if points_first:
        of_images &= outstanding(*costs.without(of_points).of_images(), factor, images[0].sum())
        points_first = not np.any(of_images) or images[0][of_images].sum() < points[0][of_points].sum()
    elif np.any(of_images):  # what they do to neighbouring images, they do to the points of these
        of_points = np.zeros_like(of_points)
    found = [
        contributions(Quantity.COST, Kind.IMAGE, images[0], of_images),
        contributions(Quantity.COST, Kind.POINT, points[0], of_points),
    ]
    return [one for one in (found[::-1] if points_first else found) if one.members.size]


def _of_lost(network: Network, lost: Mask, costs: _Costs) -> list[Contributions]:
    """Of points (n,) without a place: all of them stand out where they are few; images by how many of them they saw."""
    count = int(np.count_nonzero(lost))
    if not count:
        return []
    seen = network.rays.image[lost[network.rays.point]]
    number = np.bincount(seen, minlength=len(network.images)).astype(np.float64)
    whole = np.bincount(network.rays.image, minlength=number.size) / lost.size
    few, (level, measures) = count <= _MOST * lost.size, costs.of_images()
    far = (number >= 0.5 * count) & (number / count >= _IMAGES * whole) & (count >= FEWEST) & few
    level = level / np.maximum(measures, 1.0)
    found = [
        contributions(Quantity.LOST, Kind.POINT, lost.astype(np.float64), lost & few),
        contributions(Quantity.LOST, Kind.IMAGE, number, far, level, count),
    ]
    return found[::-1] if np.any(far) else found
