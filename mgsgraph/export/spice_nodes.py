"""Nodes of an adjusted trajectory: so close together that SPICE's interpolation stays below a small part of a pixel.

What SPK type 13 of degree 3 and CK type 3 do between two nodes is what `PositionTable` and `AttitudeTable` do, so the
error is measured before anything is written.

One path for each spacecraft: images of a pass that are taken at the same time are on one trajectory, so that a
spacecraft's SPK says its position once at any time. Cameras of a pass differ in attitude, which the CK of each camera's
own frame holds. Their perspective centres differ where lever arms, or shared unknowns of one of them, move them against
each other; SPICE (and ISIS, which takes a camera's position from the SPK of its spacecraft) then needs a spacecraft id
for each.
"""

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.export.spice_texts import Carrier
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, finite_rows
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.geometry.trajectory import AttitudeTable, PositionTable, Trajectory

TOLERANCE = 1e-3
"""px, between nodes."""

_FIRST_INTERVALS = 8
"""Even intervals to begin with, apart from the trajectory's own nodes."""
_HALVINGS = 16
_PLACES = 9
"""Lines at which the size of a pixel is looked at."""
_WITHIN = np.array([0.25, 0.5, 0.75])
"""Shares of each interval at which the error is measured."""
_LAST = 1e-3
"""lines before a pause at which there is a node."""
_NEAR = 1e-5
"""s: nodes nearer than this to one another are one (ephemeris time resolves 6e-8 s)."""


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedNodes:
    """Adjusted positions and attitudes of one image at nodes, against the body-fixed frame."""

    epoch: float
    """s TDB past J2000 from which times count."""
    times: Array
    """(n,) s past the epoch, increasing; times + epoch are exact in float64."""
    positions: Array
    """(n, 3) m, perspective centre, geometric."""
    velocities: Array
    """(n, 3) m/s, the change of these positions in the body-fixed frame."""
    matrices: Array
    """(n, 3, 3) body-fixed to camera frame, camera +Z out of the lens."""
    angular_rate: Array
    """(n, 3) rad/s, angular velocity of the camera against the body-fixed frame, in body-fixed axes."""
    error: float
    """px, largest between nodes, where it was measured."""
    pixel: float
    """m across the line of sight, of the smallest line or sample."""


def adjusted_nodes(
    image: PushbroomImage, correction: OrientationCorrection, covered: tuple[float, float],
    tolerance: float = TOLERANCE, body: AttitudeTable | None = None,
) -> AdjustedNodes:  # fmt: skip
    """Nodes from one line to another, halved where interpolation between them is off by more than `tolerance`.

    Parameters
    ----------
    image : PushbroomImage
        With adjusted camera constants.
    correction : OrientationCorrection
        Of its nominal orientation.
    covered : (float, float)
        First and last line; they may lie outside the image.
    tolerance : float
        px, between nodes.
    body : AttitudeTable, optional
        The body's rotation, times in s past the trajectory's epoch: the nodes are in its inertial axes then, instead of
        body-fixed ones.

    Raises
    ------
    InputError
        When the orientation jumps, so that no spacing is small enough.
    """
    pixel, distance = _pixel(image, correction)
    times = _first_times(image, correction, covered)
    for _ in range(_HALVINGS):
        nodes = _nodes(image, correction, times, body)
        off = _errors(image, correction, nodes, distance, body) / pixel
        wrong = off > tolerance
        if not wrong.any():
            return AdjustedNodes(*nodes, error=float(off.max()), pixel=pixel)
        previous = nodes[1]
        times = np.sort(np.concatenate([previous, 0.5 * (previous[1:] + previous[:-1])[wrong]]))
    raise InputError(
        f"image {image.name}, orientation", f"{off.max():.3g} px between nodes {np.diff(previous).min():.3g} s apart",
        f"less than {tolerance:g} px", "an orientation without jumps",
    )  # fmt: skip


_Nodes = tuple[float, Array, Array, Array, Array, Array]


def _nodes(
    image: PushbroomImage, correction: OrientationCorrection, times: Array, body: AttitudeTable | None = None
) -> _Nodes:
    """Fields of `AdjustedNodes` but for the error, at times (n,), rounded to those that ephemeris time can hold."""
    epoch = image.trajectory.epoch
    lines = image.timing.lines((times + epoch) - epoch)
    reached, periods = image.timing.at(lines)  # in a pause of the timing, the time at which it goes on
    chosen = np.unique(reached, return_index=True)[1]
    chosen = chosen[np.diff(reached[chosen], prepend=-np.inf) > _NEAR]
    pose = image.pose(lines[chosen], correction)
    rate = 1.0 / periods[chosen, None]
    angular_rate = np.einsum("nji,nj->ni", pose.matrix, pose.angular_rate * rate)
    times, velocity = (reached[chosen] + epoch) - epoch, pose.velocity * rate
    if body is None:
        return epoch, times, pose.position, velocity, pose.matrix, angular_rate
    turn, spin = body.at(times)
    fixed = pose.position, velocity + np.cross(spin, pose.position), angular_rate + spin
    position, velocity, angular_rate = (np.einsum("nji,nj->ni", turn, vector) for vector in fixed)
    return epoch, times, position, velocity, pose.matrix @ turn, angular_rate


def _first_times(
    image: PushbroomImage, correction: OrientationCorrection, covered: tuple[float, float]
) -> Array:
    """Times, s past the trajectory's epoch: even ones, and kinks of tables, orientation images and line times."""
    trajectory = image.trajectory
    start, stop = image.timing.at(np.array(covered))[0]
    kinks = _pauses(image.timing)
    if isinstance(trajectory, Trajectory):
        kinks += [trajectory.position.times, trajectory.camera.times, trajectory.body.times]
    if correction.nodes is not None:
        kinks.append(correction.nodes.times + (correction.nodes.epoch - trajectory.epoch))
    inner = np.concatenate([np.linspace(start, stop, _FIRST_INTERVALS + 1), *kinks])
    inner = np.unique(inner[(inner > start + _NEAR) & (inner < stop - _NEAR)])
    distinct = np.diff(inner, prepend=start) > _NEAR
    return np.concatenate([[start], inner[distinct], [stop]])


def _pauses(timing: LineTiming) -> list[Array]:
    """Times just before and right after those in which no line is read: nothing can be halved in them."""
    lines, starts, periods = timing.first_lines, timing.start_times, timing.periods
    ends = starts[:-1] + (lines[1:] - lines[:-1] - _LAST) * periods[:-1]
    paused = starts[1:] - ends > _NEAR + _LAST * periods[:-1]
    return [ends[paused], starts[1:][paused]]


def _pixel(image: PushbroomImage, correction: OrientationCorrection) -> tuple[float, float]:
    """Smallest size of a line or sample across the line of sight, m, and the largest distance, m."""
    lines = np.linspace(0.0, float(image.lines), _PLACES)
    samples = np.full(_PLACES, 0.5 * image.samples)
    ground, by_place = image.image_to_ground(lines, samples, 0.0, correction)
    origins, directions = image.sightlines(lines, samples, correction)
    on_ground = finite_rows(ground)
    if not on_ground.any():  # an image of the sky
        distance = float(np.linalg.norm(origins, axis=1).max())
        return distance * image.pixel_angle, distance
    along = unit_vectors(directions)[on_ground]
    size = by_place[on_ground]
    across = size - along[:, :, None] * np.einsum("ni,nik->nk", along, size)[:, None, :]
    distance = np.linalg.norm(ground[on_ground] - origins[on_ground], axis=1)
    return float(np.linalg.norm(across, axis=1).min()), float(distance.max())


def _errors(
    image: PushbroomImage, correction: OrientationCorrection, nodes: _Nodes, distance: float, body: AttitudeTable | None
) -> Array:
    """(n - 1,) m across the line of sight at most, at which interpolation in each interval misses the ground."""
    _, times, positions, velocities, matrices, _ = nodes
    between = (times[:-1, None] + np.diff(times)[:, None] * _WITHIN).ravel()
    _, between, true, _, turned, _ = _nodes(image, correction, between, body)
    place, _ = PositionTable(times, positions, velocities).at(between)
    matrix, _ = AttitudeTable(times, rotation.from_matrix(matrices), np.eye(3)).at(between)
    angle = np.linalg.norm(rotation.logarithm(turned @ matrix.mT), axis=1)
    off = np.linalg.norm(place - true, axis=1) + distance * angle
    largest = np.zeros(times.size - 1)
    np.maximum.at(largest, np.clip(np.searchsorted(times, between, side="right") - 1, 0, times.size - 2), off)
    return largest


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
    departures: dict[str, float]
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
    paths = Paths(list(carriers), {}, {})
    of_pass = dict[int, int]()
    for j in np.argsort([_span(part)[0] for part in nodes], kind="stable").tolist():
        own, owner, name = carriers[j], int(pass_of[j]), carriers[j].image.name
        if owner >= 0 and name not in stated:
            spacecraft = of_pass.setdefault(owner, own.spacecraft)
            off = _off(paths.of_spacecraft.get(spacecraft, []), nodes, j)
            if off <= SAME_PATH * nodes[j].pixel:
                own = paths.carriers[j] = replace(own, spacecraft=spacecraft)
            else:
                paths.departures[name] = off
        path = paths.of_spacecraft.setdefault(own.spacecraft, [])
        _require_one_path(path, paths.carriers, nodes, pass_of, j)
        first, last = _span(nodes[j])
        first = max([first, *(segment.last for segment in path)])
        if last - first > _LEAST:
            path.append(PathSegment(j, first, last))
    _require_one_attitude(paths.carriers, nodes)
    return paths


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
        places = [_table(part).at(times - part.epoch)[0] for part in (own, nodes[segment.image])]
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
    for j in np.argsort([_span(part)[0] for part in nodes], kind="stable").tolist():
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


# --- where a solution sees its points


class Reprojection(NamedTuple):
    """Adjusted points and where the solution sees them, one row for each measure."""

    image: tuple[str, ...]
    """(k,) name of the image."""
    points: Array
    """(k, 3) m, body-fixed."""
    places: Array
    """(k, 2) line and sample predicted by the solution, first pixel's centre at (0.5, 0.5)."""
    times: Array
    """(k,) s TDB past J2000, of these lines."""


def reprojection(solution: Solution) -> Reprojection:
    """Where the solution sees the points of all measures, rejected ones too.

    Those of undetermined points are left out, and those which the adjusted orientation no longer sees near its image
    (`PushbroomImage.ground_to_image` gives NaN).
    """
    rays, images = solution.network.rays, solution.network.images
    places, times = np.full((rays.point.size, 2), np.nan), np.full(rays.point.size, np.nan)
    points = solution.places[rays.point]
    for j, image in enumerate(images):
        rows = np.flatnonzero((rays.image == j) & solution.determined[rays.point])
        computed, _ = solution.image(j).ground_to_image(points[rows], solution.correction(j), rays.places[rows, 0])
        places[rows], times[rows] = computed, image.timing.at(computed[:, 0])[0] + image.trajectory.epoch
    finite = np.flatnonzero(finite_rows(places) & finite_rows(points))
    names = [images[j].name for j in rays.image[finite].tolist()]
    return Reprojection(tuple(names), points[finite], places[finite], times[finite])


def images_of(measured: Reprojection) -> dict[str, Index]:
    """Which measures, ascending, each image has."""
    names = np.array(measured.image)
    return {name: np.flatnonzero(names == name) for name in dict.fromkeys(measured.image)}
