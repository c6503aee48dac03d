"""Which images and points drive an adjustment that does not come to rest, or to what is no result.

These quantities are divided among images and among points, at the state that the adjustment has reached:

* the cost: each measure's part of it belongs to its image and to its point, an a-priori orientation's to its image;
* the next step, with the damping of the last one. An image's part are the squares of its step in a-priori sigmas. A
  point's part are the squares by which its whitened residuals change: over all rows these add up to the square of the
  step's length in posterior sigmas;
* the rise of the cost, where that step would raise it: measures whose own cost rises;
* the points that have no place: behind a camera, on rays that part, or not determined by their rays. They are sought at
  the state itself and after the next step, whose cost they make infinite.

An image or a point *stands out* where its mean square per measure is many times the median of all others', by more than
chance gives. Wrong measures of few points make residuals of many images larger, and one wrong image those of its
points: where nearly all points that stand out are measured in one image, or in those that stand out, and few other
points are, the images explain the points; else the points explain the images, and these are looked at again without
them. Of a redescending loss (Tukey) nothing stands out: what it leaves out depends on where it began.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Network
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
    BLOCKING = "blocking points"
    """Points without a place after the next step, so that it can't be taken."""
    RISE = "rise"
    """What the next step adds to the cost of those measures whose cost it raises."""
    STEP = "step"
    """The squared length of the next step in sigmas."""


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
    cost_after: float
    """The same after the next step; infinite where some points then have no place, NaN without a step."""
    step: float
    """Length of that step in posterior sigmas; NaN without one."""
    behind: int
    """Points behind a camera, at that state or after the step."""
    parting: int
    """Of these, those whose rays are nearly parallel and part."""
    weak: int
    """Points that their rays don't determine, at that state or after the step."""

    @property
    def outstanding(self) -> tuple[Contributions, ...]:
        """Contributions of images and points that stand out, in the order in which they say the most."""
        return tuple(one for one in self.contributions if one.outstanding)


_FIRST = (Quantity.COST, Quantity.LOST, Quantity.BLOCKING)
"""Quantities that are spoken of wherever something stands out; the others only where nothing does in these."""


def driver_sentences(found: Drivers, network: Network) -> list[str]:
    """Which images and points stand out, by name; or that none does."""
    told = [one for one in found.outstanding if one.quantity in _FIRST] or list(found.outstanding[:1])
    if told:
        sentences = [_sentence(one, network) for one in _without_repeated(told)]
        return [f"What drives it: {sentences[0]}", *sentences[1:]]
    largest = [one for one in found.contributions if one.quantity == Quantity.COST and one.members.size]
    shares = " and ".join(f"{_names(one, network, 1)} with {_percent(one.shares[0])}" for one in largest)
    most = f" The largest shares of the cost have {shares}." if shares else ""
    return [f"No image and no point stands out: nothing in particular drives it.{most}"]


def _without_repeated(told: list[Contributions]) -> list[Contributions]:
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
    if one.quantity in (Quantity.LOST, Quantity.BLOCKING):
        when = "where it stopped" if one.quantity == Quantity.LOST else "after the next step, which can't be taken"
        what = "no place (behind a camera, on rays that part, or not determined by them)"
        if one.kind == Kind.POINT:
            return f"{who} {'have' if plural else 'has'} {what} {when}: {names}."
        return f"{who} {'see' if plural else 'sees'} most of the points that have {what} {when}: {names}."
    if one.quantity == Quantity.RISE:
        return f"{who} {'have' if plural else 'has'} {share} of what the next step would add to the cost: {names}."
    return f"{who} {'make' if plural else 'makes'} {share} of the next step: {names}."


def _names(one: Contributions, network: Network, most: int = 3) -> str:
    """Names of images, or ids of points, that stand out; of the first where none does."""
    index = one.members[: min(most, one.outstanding or most)].tolist()
    names = [network.images[i].name if one.kind == Kind.IMAGE else network.points.ids[i] for i in index]
    more = one.outstanding - len(names)
    return ", ".join(names) + (f" and {more} more" if more > 0 else "")


def _percent(share: float) -> str:
    """A share in words."""
    return "less than 1 %" if share < 0.005 else f"{math.floor(100.0 * share + 0.5)} %"
