"""One path for each spacecraft: images of a pass that are taken at the same time are on one trajectory, so that a
spacecraft's SPK says its position once at any time, and ids of cameras and spacecraft that don't contradict.

Cameras of a pass differ in attitude, which the CK of each camera's own frame holds. Their perspective centres differ
where lever arms, or shared unknowns of one of them, move them against each other; SPICE (and ISIS, which takes a
camera's place from the SPK of its spacecraft) then needs a spacecraft id for each.
"""

from collections.abc import Container, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.export.spice_nodes import TOLERANCE, AdjustedNodes
from mgsgraph.export.spice_texts import Carrier
from mgsgraph.geometry.trajectory import PositionTable

SAME_PATH = 0.5 * TOLERANCE
"""px by which the paths of two images may differ at times that they have in common, and be one."""
_LEAST = 1e-4
"""s: a rest of a path that is shorter is none."""


class PathSegment(NamedTuple):
    """A part of the path of a spacecraft, as one segment of the SPK."""

    image: int
    """That it is taken from."""
    first: float
    """s TDB past J2000, from which on the segment holds; nodes of the image may begin before."""
    last: float
    """The same, up to which it holds."""


class Paths(NamedTuple):
    """Carriers whose spacecraft ids don't contradict, and the segments of their paths."""

    carriers: list[Carrier]
    """(m,) one for each image."""
    of_spacecraft: dict[int, list[PathSegment]]
    """Of each spacecraft in order of time, none at the time of another."""
    apart: dict[str, float]
    """Images of a pass that have a spacecraft id of their own, and m by which their path is off that of the pass."""


def united_paths(
    carriers: Sequence[Carrier], nodes: Sequence[AdjustedNodes], pass_of: Sequence[int], stated: Container[str]
) -> Paths:
    """Paths of all images: one for those of a pass, where they agree to `SAME_PATH`.

    Parameters
    ----------
    carriers : sequence of Carrier
        One for each image; ids that are not stated are of this image alone.
    nodes : sequence of AdjustedNodes
        Of each.
    pass_of : sequence of int
        Pass of each image; -1 for one on its own.
    stated : container of str
        Names of images whose ids the user has stated, which are kept.

    Raises
    ------
    InputError
        Where images of one spacecraft are at the same time on paths of their own, or two images of one camera are.
    """
    found = Paths(list(carriers), {}, {})
    of_pass = dict[int, int]()
    for j in np.argsort([_span(one)[0] for one in nodes], kind="stable").tolist():
        own, owner, name = carriers[j], int(pass_of[j]), carriers[j].image.name
        if owner >= 0 and name not in stated:
            spacecraft = of_pass.setdefault(owner, own.spacecraft)
            off = _off(found.of_spacecraft.get(spacecraft, []), nodes, j)
            if off <= SAME_PATH * nodes[j].pixel:
                own = found.carriers[j] = replace(own, spacecraft=spacecraft)
            else:
                found.apart[name] = off
        path = found.of_spacecraft.setdefault(own.spacecraft, [])
        _require_one_path(path, found.carriers, nodes, pass_of, j)
        first, last = _span(nodes[j])
        first = max([first, *(segment.last for segment in path)])
        if last - first > _LEAST:
            path.append(PathSegment(j, first, last))
    _require_one_attitude(found.carriers, nodes)
    return found


def _span(nodes: AdjustedNodes) -> tuple[float, float]:
    """First and last time, s TDB past J2000."""
    return nodes.epoch + float(nodes.times[0]), nodes.epoch + float(nodes.times[-1])


def _off(path: Sequence[PathSegment], nodes: Sequence[AdjustedNodes], image: int) -> float:
    """m, largest distance of an image's path from another at their common times; 0 where they have none."""
    own, off = nodes[image], 0.0
    for segment in path:
        first, last = max(segment.first, _span(own)[0]), min(segment.last, _span(own)[1])
        if last <= first:
            continue
        times = own.times + own.epoch
        times = np.concatenate([[first, last], times[(times > first) & (times < last)]])
        places = [_table(one).at(times - one.epoch)[0] for one in (own, nodes[segment.image])]
        off = max(off, float(np.linalg.norm(places[0] - places[1], axis=1).max()))
    return off


def _table(nodes: AdjustedNodes) -> PositionTable:
    """As SPICE interpolates an SPK of type 13 and degree 3."""
    return PositionTable(nodes.times, nodes.positions, nodes.velocities)


def _require_one_path(
    path: Sequence[PathSegment], carriers: Sequence[Carrier], nodes: Sequence[AdjustedNodes],
    pass_of: Sequence[int], image: int,
) -> None:  # fmt: skip
    """Raise InputError where an image is at the same time as another of its spacecraft that is on another path."""
    own, first = carriers[image], _span(nodes[image])[0]
    for segment in path:
        if segment.last < first:
            continue
        names = f"{carriers[segment.image].image.name} and {own.image.name}"
        if pass_of[image] < 0 or pass_of[segment.image] != pass_of[image]:
            raise _contradiction(own.spacecraft, names, "which have orientation of their own")
        off = _off([segment], nodes, image)
        if off > SAME_PATH * nodes[image].pixel:
            raise _contradiction(own.spacecraft, names, f"whose perspective centres are {off:.3g} m apart")


def _require_one_attitude(carriers: Sequence[Carrier], nodes: Sequence[AdjustedNodes]) -> None:
    """Raise InputError unless images of the same camera are at different times."""
    latest = dict[int, int]()
    for j in np.argsort([_span(one)[0] for one in nodes], kind="stable").tolist():
        before = latest.get(carriers[j].camera)
        if before is not None and _span(nodes[before])[1] >= _span(nodes[j])[0]:
            names = f"{carriers[before].image.name} and {carriers[j].image.name}"
            raise _contradiction(carriers[j].camera, names, "which have orientation of their own")
        if before is None or _span(nodes[before])[1] < _span(nodes[j])[1]:
            latest[carriers[j].camera] = j


def _contradiction(code: int, names: str, why: str) -> InputError:
    return InputError(
        f"NAIF id {code}", f"both {names} at the same time, {why}", "ids that differ",
        "leave the ids of one of them to the export",
    )  # fmt: skip
