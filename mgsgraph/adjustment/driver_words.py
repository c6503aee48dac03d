"""What drives an adjustment, in sentences."""

import math

from mgsgraph.adjustment.drivers import Contributions, Drivers, Kind, Quantity
from mgsgraph.network import Network
from mgsgraph.text import many

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
