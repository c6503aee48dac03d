"""On which lines an image sees ground points: every line between two others that bracket it is found.

In one line the detector sweeps a plane (a bent one nearly a plane). On which side of it a point lies, w, is linear in
the point, and changes sign over the line that sees it. So

1. *Grid*: lines at which the timing's segments begin and end, at which tables of the trajectory and orientation images
   have records, and so many more that the camera turns and flies round the body by at most `_TURN` from one to the
   next. In between w is smooth.
2. *Brackets*: neighbors on the grid of unlike sign; and neighbors of one sign between which w comes near zero and goes
   back (a camera that turns against its flight sees a place twice), parted where w is nearest to zero.
3. *Newton's method* in each bracket, from the root of the parabola through w at both ends and its slope at one; a step
   that leaves the bracket is replaced by bisection.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mgsgraph.geometry import rotation
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.compiled_search import newton_steps, scan_grid
from mgsgraph.geometry.records import Array, Index, Mask, finite_rows
from mgsgraph.geometry.trajectory import Pose

EDGE = np.array([0.5, 2.0])
"""Shares of its lines and samples by which a place may lie outside an image; beyond it counts as not seen (and the
polynomials of the optics mean nothing)."""
_EVEN, _TURN, _MOST_PARTS = 65, 0.05, 256
"""Even lines of the grid at least; rad between two lines of it at most; into how many parts an interval is cut."""
_PAST = 1e-6
"""Lines past a knot at which the rates are surely those after it."""
_DETECTOR = 33
"""Samples at which a detector's bend is tabulated."""
_BLOCK = 16
"""Intervals of the grid that are looked at together first."""
_STEPS, _CONVERGED = 60, 1e-7
"""Steps of Newton's method; pixels of a step that ends it."""
_JOINT = 0.01
"""Lines of a pause that is one of rounded times alone: a place within it is the end of the segment before it."""
_SLACK = 0.01
"""Lines by which Newton's method may leave its bracket: the table of a bent detector is not the detector."""


class Scan(NamedTuple):
    """What the search knows of an image."""

    pose: Callable[[Array], Pose]
    """Exterior orientation at lines (n,), rates per line."""
    size: Array
    """(2,) lines and samples."""
    interior: InteriorOrientation
    """Camera constants."""
    knots: Array
    """(k,) lines at which rates of the orientation jump."""
    breaks: Array
    """(s,) lines at which segments of the timing begin, ascending, without the first."""
    pauses: Array
    """(s,) lines that would have been taken since the segment before it ended; negative where they overlap."""


class Sightings(NamedTuple):
    """Places at which an image sees points, as many as there are, those of one point by ascending lines."""

    point: Index
    """(m,) number of the point, ascending."""
    places: Array
    """(m, 2) line and sample."""
    jacobian: Array
    """(m, 2, 3) d(line, sample) / d(point), per m."""
    hidden: Mask
    """(m,) whether the point is below the camera's horizon there, the body being between."""


class _Brackets(NamedTuple):
    """Pieces of the grid in which points are seen, or may be."""

    point: Index
    """(m,)"""
    ends: Array
    """(m, 2) lines."""
    place: Array
    """(m, 2) first guess of line and sample."""
    above: Mask
    """(m,) whether w is positive at the first end."""
    dip: Mask
    """(m,) whether w has one sign at both ends."""

    def of(self, rows: Index | Mask) -> "_Brackets":
        return _Brackets(self.point[rows], self.ends[rows], self.place[rows], self.above[rows], self.dip[rows])


def sightings(scan: Scan, points: Array) -> Sightings:
    """All places at which an image sees points (n, 3) in m, body-fixed, within `EDGE`."""
    brackets = _brackets(scan, points)
    if np.any(brackets.dip):
        split = _split(scan, points, brackets.of(brackets.dip))
        parts = brackets.of(~brackets.dip), *split
        brackets = _Brackets(*[np.concatenate([getattr(part, name) for part in parts]) for name in _Brackets._fields])
        brackets = brackets.of(np.lexsort([brackets.ends[:, 0], brackets.point]))
    return _converged(scan, points, brackets)


def _grid(scan: Scan) -> tuple[Array, Pose]:
    """Lines of the grid, ascending, and their poses."""
    low, high = -EDGE[0] * scan.size[0], (1.0 + EDGE[0]) * scan.size[0]
    lines = np.concatenate([scan.knots + _PAST, scan.breaks, np.nextafter(scan.breaks, -np.inf)])
    lines = np.unique(np.concatenate([np.linspace(low, high, _EVEN), lines[(lines > low) & (lines < high)]]))
    pose, steps = scan.pose(lines), np.diff(lines)
    rate = np.linalg.norm(pose.angular_rate, axis=1)
    rate += np.linalg.norm(pose.velocity, axis=1) / np.linalg.norm(pose.position, axis=1)
    parts = np.ceil(np.maximum(rate[:-1], rate[1:]) * steps / _TURN)
    parts = np.clip(np.nan_to_num(parts, nan=1.0), 1, _MOST_PARTS).astype(np.int64)
    if np.all(parts == 1):
        return lines, pose
    of = np.repeat(np.arange(parts.size), parts)
    share = (np.arange(of.size) - (np.cumsum(parts) - parts)[of]) / parts[of]
    lines = np.append(lines[of] + share * steps[of], lines[-1])
    return lines, scan.pose(lines)


class _Bend(NamedTuple):
    """The detector in axes along its middle and across: how far along, sample and bend."""

    axes: Array
    """(2, 3) m: components of a ray times these are across and along, both times the ray's z, 0 on the middle."""
    table: tuple[Array, Array, Array]
    """As `place_at` takes it, m along for times: sample and m across."""
    width: float
    """m across at most; 0 of a straight one."""


def _bend(scan: Scan) -> _Bend:
    """How the detector is bent, as far from its middle as samples follow one another."""
    samples = np.linspace(-EDGE[1] * scan.size[1], (1.0 + EDGE[1]) * scan.size[1], _DETECTOR)
    place, slope = scan.interior.focal_plane(samples)
    middle = _DETECTOR // 2
    along = slope[middle] / np.linalg.norm(slope[middle])
    axes = np.array([[-along[1], along[0]], along])
    place, slope, centre = (place - place[middle]) @ axes.T, slope @ axes.T, axes @ place[middle]
    bad = np.flatnonzero(~((slope[:, 1] > 0.0) & np.isfinite(place[:, 0])))
    span = slice(np.max(bad[bad < middle], initial=-1) + 1, np.min(bad[bad > middle], initial=_DETECTOR))
    zero, place, slope = np.zeros(_DETECTOR)[span], place[span], slope[span]
    table = place[:, 1], np.column_stack([samples[span], place[:, 0], zero])
    rates = np.column_stack([np.ones_like(zero), slope[:, 0], zero]) / slope[:, 1:]
    width = float(np.abs(place[:, 0]).max() + 2.0 * _TURN * scan.interior.focal_length * np.abs(rates[:, 1]).max())
    straight = width < 1e-6 * float(np.linalg.norm(slope[0]))
    rows = np.hstack([scan.interior.focal_length * axes, -centre[:, None]])
    return _Bend(rows, (np.ascontiguousarray(table[0]), table[1], rates), 0.0 if straight else width)


def _brackets(scan: Scan, points: Array) -> _Brackets:
    """Pieces of the grid between which points (n, 3) are seen, or may be."""
    lines, pose = _grid(scan)
    bend, finite = _bend(scan), points[finite_rows(points)]
    origin = finite.mean(axis=0) if len(finite) else np.zeros(3)
    planes = _planes(bend.axes, np.diff(lines, append=lines[-1]), pose, pose.position - origin)
    blocks, room = _blocks(lines, planes, bend.width), 2 * len(points) + 16
    while True:
        which, values = np.empty((room, 2), dtype=np.int64), np.empty((room, 5))
        widths = bend.width, (_TURN if bend.width > 0.0 else 1e-3) * scan.interior.focal_length
        count = scan_grid(points - origin, lines, planes, blocks, bend.table, widths, which, values)
        if count <= room:
            break
        room = count
    which, values = which[:count], values[:count]
    return _Brackets(which[:, 0], values[:, :2], values[:, 2:4], values[:, 4] >= 0.0, which[:, 1] == 1)


def _planes(axes: Array, steps: Array, pose: Pose, position: Array) -> Array:
    """(k, 4, 4) what makes of a point, with -1 as a fourth coordinate, w, the place along the detector times depth,
    depth, all in m, and the change of w to the next line of the grid by its rate; positions (k, 3) and points have one
    origin.
    """
    rows = np.vstack([axes, [0.0, 0.0, 1.0]]) @ pose.matrix
    turning = (pose.angular_rate @ rotation.skew(axes[0]))[:, None] @ pose.matrix * steps[:, None, None]
    planes = np.empty((steps.size, 4, 4))
    planes[:, :3, :3], planes[:, 3:, :3] = rows, turning
    planes[:, :, 3] = np.einsum("kij,kj->ki", planes[:, :, :3], position)
    planes[:, 3, 3] += np.einsum("kj,kj->k", rows[:, 0], pose.velocity) * steps
    return planes


def _blocks(lines: Array, planes: Array, width: float) -> tuple[Index, Array]:
    """Ends (b + 1,) of blocks of the grid, and (b, 2) how near w may come to zero within a block less than at its ends:
    m, and m per m that a point is off the origin.
    """
    ends = np.append(np.arange(0, lines.size - 1, _BLOCK), lines.size - 1)
    k = np.minimum(np.arange(lines.size) // _BLOCK, ends.size - 2)
    share = ((lines - lines[ends[k]]) / (lines[ends[k + 1]] - lines[ends[k]]))[:, None]
    off = planes[:, 0] - (1.0 - share) * planes[ends[k], 0] - share * planes[ends[k + 1], 0]
    reach = [np.linalg.norm(part[:, :3], axis=1) for part in (off, planes[:, 3])]
    far = np.abs(off[:, 3]) + np.abs(planes[:, 3, 3]) + width * np.abs(planes[:, 2, 3])
    margins = np.column_stack([far, reach[0] + reach[1] + width])
    return ends, np.maximum.reduceat(margins, ends[:-1])


def _step(scan: Scan, points: Array, place: Array) -> tuple[Array, Array, Array, Array]:
    """Newton's step from places (n, 2), derivatives, sides as `newton_steps` has them, and the camera's positions."""
    pose = scan.pose(place[:, 0])
    step, derivative, across = np.empty_like(place), np.empty((len(place), 2, 3)), np.empty_like(place)
    detector = scan.interior.focal_plane(place[:, 1])
    motion = pose.position, pose.velocity, pose.matrix, pose.angular_rate
    newton_steps(points, motion, detector, scan.interior.focal_length, step, derivative, across)
    return step, derivative, across, pose.position


def _split(scan: Scan, points: Array, dips: _Brackets) -> tuple[_Brackets, _Brackets]:
    """Brackets before and after the lines at which w is nearest to zero, where it is beyond zero there."""
    place, ends = dips.place.copy(), dips.ends.copy()
    while True:
        place[:, 0] = ends.mean(axis=1)
        across = _step(scan, points[dips.point], place)[2]
        if np.ptp(ends, axis=1).max() < _JOINT:
            break
        back = (across[:, 1] > 0.0) == dips.above
        ends[back, 1], ends[~back, 0] = place[back, 0], place[~back, 0]
    crossed = (across[:, 0] > 0.0) != dips.above
    middle, no = place[:, :1], np.zeros_like(dips.dip)
    halves = np.hstack([dips.ends[:, :1], middle]), np.hstack([middle, dips.ends[:, 1:]])
    before, after = (
        _Brackets(dips.point, part, np.column_stack([part.mean(axis=1), place[:, 1]]), above, no).of(crossed)
        for part, above in zip(halves, (dips.above, ~dips.above), strict=True)
    )
    return before, after


def _converged(scan: Scan, points: Array, brackets: _Brackets) -> Sightings:
    """Places in brackets, by Newton's method, a step that leaves its bracket replaced by bisection."""
    place, ends, live = brackets.place.copy(), brackets.ends.copy(), np.arange(brackets.point.size)
    limits = np.concatenate([[-np.inf], scan.breaks, [np.inf]])
    segment = np.searchsorted(scan.breaks, ends[:, 0], side="right")
    lowest, highest = limits[segment], np.nextafter(limits[segment + 1], -np.inf)
    step, derivative = np.full_like(place, np.nan), np.full((live.size, 2, 3), np.nan)
    camera = np.full((live.size, 3), np.nan)
    for _ in range(_STEPS):
        if not live.size:
            break
        step[live], derivative[live], across, camera[live] = _step(scan, points[brackets.point[live]], place[live])
        line, move = place[live, 0], step[live]
        sure = np.abs(move[:, 0]) > _JOINT + 1e-3 * np.abs(move[:, 1])
        before = (across[:, 0] > 0.0) == brackets.above[live]
        for end, chosen in ((0, sure & before), (1, sure & ~before)):
            ends[live[chosen], end] = line[chosen]
        low, high = np.maximum(ends[live, 0] - _SLACK, lowest[live]), np.minimum(ends[live, 1] + _SLACK, highest[live])
        target = line + move[:, 0]
        inside = (target >= ends[live, 0] - _SLACK) & (target <= ends[live, 1] + _SLACK)
        place[live, 0] = np.where(inside, np.clip(target, low, high), ends[live].mean(axis=1))
        place[live, 1] += move[:, 1]
        live = live[(np.abs(place[live, 0] - line) > _CONVERGED) | (np.abs(move[:, 1]) > _CONVERGED)]
    joint = (np.diff(brackets.ends, axis=1)[:, 0] < 1e-6) & (np.append(scan.pauses, np.inf)[segment] < _JOINT)
    at_zero = np.abs(step).max(axis=1) < np.where(joint, _JOINT, 1e-6)
    within = np.all((place >= -EDGE * scan.size) & (place <= (1.0 + EDGE) * scan.size), axis=1)
    visible = np.flatnonzero(at_zero & within)
    ground = points[brackets.point[visible]]
    hidden = np.einsum("ni,ni->n", ground, camera[visible] - ground) <= 0.0
    return Sightings(brackets.point[visible], place[visible], derivative[visible], hidden)
