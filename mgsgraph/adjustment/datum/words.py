"""Directions of the orientation, in parts and in words."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.datum.frames import Axis, FlightFrame, Frames
from mgsgraph.geometry.records import Array
from mgsgraph.text import listed, some

_NODE = re.compile(r"node (\d+) of (\d+) of (pass .+)")
_LEAST = 0.01
"""Share of a direction from which a part is kept."""
_NAMED = 0.08
"""Share from which it is named, until `_ENOUGH` is."""
_ENOUGH = 0.9
_MOST = 4
"""Terms that are named."""
_MAINLY = 0.5
"""Share of what an axis moves that it moves this way on the ground, for it to count there."""
_CANCEL = 0.5
"""Share of the larger effect on the ground that may be left where position and pointing counter each other."""


@dataclass(frozen=True, slots=True)
class Part:
    """What one axis of one image (or one shift) has in a direction."""

    axis: Axis
    """Whose it is, which axis, which order."""
    share: float
    """Of the squared length of the direction, in prior units."""
    amount: float
    """Signed, m or rad per unit of the direction."""


@dataclass(frozen=True, slots=True)
class _Term:
    """One axis, or a position and the pointing that counters it on the ground, of one owner."""

    what: str
    owner: str
    share: float
    sign: float
    parts: tuple[Part, ...]


def parts_of(frames: Frames, direction: Array) -> tuple[Part, ...]:
    """Parts of a direction (columns,), in units of `Layout.scales`, of a share of 1 % or more, largest first."""
    share = frames.turned(direction[:, None])[:, 0] ** 2 / np.sum(direction**2)
    amount = frames.amounts(direction[:, None])[:, 0]
    # rounded, lest the last digit decide the order of equals
    order = np.lexsort((np.arange(share.size), -np.round(share, 6)))
    kept = [int(c) for c in order if share[c] >= _LEAST]
    return tuple(Part(frames.axes[c], float(share[c]), float(amount[c])) for c in kept)


def in_words(frames: Frames, parts: Sequence[Part], sigma: float | None = None) -> str:
    """What a direction is; with its sigma (in prior units), how far one sigma moves its main term."""
    groups: dict[str, list[_Term]] = {}
    terms = sorted(_terms(frames, parts), key=lambda term: -round(term.share, 6))
    for term in terms:
        groups.setdefault(term.what, []).append(term)
    whole = sorted(groups.values(), key=lambda group: -round(sum(term.share for term in group), 6))
    named: list[list[_Term]] = []
    explained = 0.0
    for group in whole[:_MOST]:
        share = sum(term.share for term in group)
        if named and (share < _NAMED or explained >= _ENOUGH):
            break
        explained += share
        named.append(group)
    text = ", with ".join(_group(group) for group in named)
    together = f" ({'together ' if len(named) > 1 or len(named[0]) > 1 else ''}{100.0 * explained:.0f} %)"
    if sigma is None:
        return text
    main = named[0][0]
    amounts = " against ".join(quantity(abs(part.amount) * sigma, part.axis.unit) for part in main.parts)
    whose = f" of {main.owner}" if len(terms) > 1 and len(named[0]) > 1 else ""
    return f"{text}{together}: one sigma is {amounts}{whose}"


def quantity(value: float, unit: str) -> str:
    """A length in m or an angle in mrad, three significant digits."""
    value, unit = (value * 1e3, "mrad") if unit == "rad" else (value, unit)
    return f"{value:.3g} {unit}" if value < 1e3 else f"{value:.0f} {unit}"


def _group(terms: Sequence[_Term]) -> str:
    """The same of several owners."""
    main = max(terms, key=lambda term: round(term.share, 6))
    alike = [term.owner for term in terms if term.sign == main.sign]
    other = [term.owner for term in terms if term.sign != main.sign]
    text = f"{main.what} of {_owners(alike)}" + (" alike" if len(alike) > 1 else "")
    return f"{text} and, the other way, of {_owners(other)}" if other else text


def _owners(owners: Sequence[str]) -> str:
    images = [owner.removeprefix("image ") for owner in owners if owner.startswith("image ")]
    rest = _with_runs([owner for owner in owners if not owner.startswith("image ")])
    if len(images) > _MOST:
        images = [some(images, len(images), _MOST - 1)]
        return listed([f"images {images[0]}", *rest])
    return listed([f"image{'s' * (len(images) > 1)} {listed(images)}", *rest]) if images else listed(rest)


def _with_runs(owners: Sequence[str]) -> list[str]:
    """Owners, nodes of one pass put together: "nodes 2-5 and 9 of 12 of pass A", or "all 12 nodes of pass A"."""
    of_passes, others = dict[tuple[str, str], list[int]](), list[str]()
    for owner in owners:
        if found := _NODE.fullmatch(owner):
            of_passes.setdefault((found[2], found[3]), []).append(int(found[1]))
        else:
            others.append(owner)
    for (count, owner), numbers in of_passes.items():
        if len(numbers) == int(count):
            others.append(f"all {count} nodes of {owner}")
        else:
            runs = np.split(np.sort(numbers), np.flatnonzero(np.diff(np.sort(numbers)) > 1) + 1)
            texts = [f"{run[0]}-{run[-1]}" if run.size > 1 else f"{run[0]}" for run in runs]
            which = some(texts, len(texts)) if len(texts) > _MOST else listed(texts)
            others.append(f"node{'s' * (len(numbers) > 1)} {which} of {count} of {owner}")
    return others


def _terms(frames: Frames, parts: Sequence[Part]) -> list[_Term]:
    """Parts, those of position and pointing that counter each other put together."""
    of_image: dict[tuple[int, int], list[Part]] = {}
    terms: list[_Term] = []
    for part in parts:
        if part.axis.polynomial:
            of_image.setdefault((part.axis.variable, part.axis.order), []).append(part)
        else:
            terms.append(_Term(str(part.axis), part.axis.owner, part.share, np.sign(part.amount), (part,)))
    for (image, _), mine in of_image.items():
        terms += _against(frames.of(image), mine)
    return terms


def _against(frame: FlightFrame, parts: Sequence[Part]) -> list[_Term]:
    """Terms of one coefficient of one image: what cancels on the ground along the flight, across it, and the rest."""
    rest, terms = list(parts), list[_Term]()
    for way in frame.ground:
        column = {part: frame.axes.index(part.axis.name) for part in rest}
        moved = {part: float(part.amount * way[k]) for part, k in column.items()}
        mainly = [part for part, k in column.items() if abs(way[k]) > _MAINLY * frame.reach[k]]
        position = [part for part in mainly if part.axis.unit == "m"]
        pointing = [part for part in mainly if part.axis.unit == "rad"]
        one, other = (sum(moved[part] for part in group) for group in (position, pointing))
        if not (position and pointing and abs(one + other) < _CANCEL * max(abs(one), abs(other))):
            continue
        main = tuple(max(group, key=lambda part: abs(moved[part])) for group in (position, pointing))
        share = sum(part.share for part in main)
        if min(part.share for part in main) < 0.1 * share:
            continue
        what = f"{main[0].axis} against {main[1].axis.name}"
        terms.append(_Term(what, main[0].axis.owner, share, np.sign(main[0].amount), main))
        rest = [part for part in rest if part not in main]
    for part in rest:
        terms.append(_Term(str(part.axis), part.axis.owner, part.share, np.sign(part.amount), (part,)))
    return terms
