"""Passes of a simulated Mars Express: a Kepler orbit about its pericentre, HRSC looking down, its lines' times.

The camera's +Z looks to Mars' centre and its +Y follows the motion over the turning ground, so that all lines pass over
the same swath. Each line begins when it sees the first ground of the nadir strip and ends with the last. The line
period is constant between changes, which all lines of a strip make at the same times, and follows height and speed.
"""

from dataclasses import dataclass

import numpy as np

from mgsgraph.geometry.body import intersect_ellipsoid
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.record import Record
from mgsgraph.simulation.camera import HRSC_PIXELS, STEREO, hrsc_interior, line_image, one_rate
from mgsgraph.simulation.mars import MARS, MERIDIAN, body_matrix
from mgsgraph.simulation.orbit import Orbit, sampled_trajectory
from mgsgraph.units import DEG

REFERENCE_ALTITUDE = 265e3
"""m, at which the stated ground pixel holds; higher up it grows with the altitude (12.5 m to 25 m of the paper)."""
SLACK = 2e3
"""m of ground that the other lines see before and after the nadir strip: errors and relief shall not cut it."""

_STEP = 1.0
"""s between the records of the tables."""
_ROTATION = MERIDIAN[1] * DEG / 86400.0
"""rad/s, of Mars."""
_AHEAD, _MARGIN = 0.5, 20.0
"""Tangent beyond that of any line's look, and s, to which the tables reach beyond the nadir strip."""
_SLOWEST = 2e3
"""m/s over ground, below any on these orbits."""


@dataclass(frozen=True, slots=True, eq=False)
class PericentrePass:
    """One pass over the region, which is at its pericentre at the epoch."""

    epoch: float
    """s TDB past J2000 of the pericentre."""
    up: Array
    """(3,) unit, body-fixed: to the pericentre."""
    direction: Array
    """(3,) unit, body-fixed, horizontal: of the inertial flight there."""
    altitude: float
    """m, of the pericentre above the ellipsoid."""
    eccentricity: float
    """0 for a circle."""

    def __post_init__(self) -> None:
        assign(self, up=frozen(self.up, "pass, up", (3,)), direction=frozen(self.direction, "pass, direction", (3,)))

    @property
    def axes(self) -> Array:
        """(3, 3) unit rows, body-fixed: flight, across to its left, up; what tells along from across in the region."""
        return np.stack([self.direction, np.cross(self.up, self.direction), self.up])

    @property
    def orbit(self) -> Orbit:
        """The orbit, inertial."""
        outward, flight = np.stack([self.up, self.direction]) @ body_matrix(np.array([self.epoch]))[0]
        return Orbit(self.epoch, outward, flight, MARS.radius(self.up[None])[0] + self.altitude, self.eccentricity)

    def trajectory(self, start: float, stop: float) -> Trajectory:
        """Tables from before `start` to after `stop`, s past the epoch, at whole seconds."""
        times = np.arange(np.floor(start), np.ceil(stop) + 0.5 * _STEP, _STEP)
        position, velocity = self.orbit.state(times)
        to_body = body_matrix(self.epoch + times)
        over_ground = velocity - _ROTATION * np.cross(to_body[:, 2], position)
        down = -position / np.linalg.norm(position, axis=1, keepdims=True)
        forward = over_ground - np.einsum("ni,ni->n", over_ground, down)[:, None] * down
        forward /= np.linalg.norm(forward, axis=1, keepdims=True)
        camera = np.stack([np.cross(forward, down), forward, down], axis=1)
        return sampled_trajectory(self.epoch, times, (position, velocity), camera, to_body)

    def track(self, times: Array) -> tuple[Array, Array, Array]:
        """Of the ground track at increasing times (n,) in s past the epoch: length (n,) in m from the first, speed
        (n,) in m/s over ground, and altitude (n,) in m of the spacecraft.
        """
        position, _ = self.orbit.state(times)
        fixed = np.einsum("nij,nj->ni", body_matrix(self.epoch + times), position)
        distance = np.linalg.norm(fixed, axis=1)
        below, ground = fixed / distance[:, None], MARS.radius(fixed / distance[:, None])
        steps = np.linalg.norm(np.diff(below * ground[:, None], axis=0), axis=1)
        length = np.concatenate([[0.0], np.cumsum(steps)])
        return length, np.gradient(length, times), distance - ground

    def interval(self, length: float, share: float) -> tuple[float, float]:
        """Times, s past the epoch, between which `length` m of ground pass below, `share` of it before pericentre."""
        times = np.arange(-length / _SLOWEST, length / _SLOWEST + _STEP, _STEP)
        covered, _, _ = self.track(times)
        covered -= np.interp(0.0, times, covered)
        start, stop = np.interp([-share * length, (1.0 - share) * length], covered, times)
        return float(start), float(stop)


@dataclass(frozen=True, slots=True)
class Readout(Record):
    """How the five stereo lines are read out."""

    macropixels: tuple[int, ...] = (2, 2, 1, 2, 2)
    """Detector pixels per sample and per line of S1, P1, ND, P2, S2."""
    ground_pixel: float = 12.5
    """m along track of a line without macropixels at 265 km of altitude. (Across track the optics have 10.6 m there.)
    """
    rates: int = 2
    """Line rates within an image, for even parts of the nadir strip's time."""


def strip_images(
    name: str, flown: PericentrePass, interval: tuple[float, float], readout: Readout
) -> tuple[PushbroomImage, ...]:
    """Nominal images of the five stereo lines, on one trajectory; `interval` is that of the nadir strip, s past the
    pass's epoch.
    """
    start, stop = interval
    _, speed, altitude = flown.track(np.linspace(start, stop, 101))
    reach = _AHEAD * float(altitude.max()) / float(speed.min()) + _MARGIN
    trajectory = flown.trajectory(start - reach, stop + reach)
    ends = trajectory.pose(np.array([start, stop])).position
    beside = np.cross(ends / np.linalg.norm(ends, axis=1, keepdims=True), flown.direction)
    half = 0.5 * HRSC_PIXELS * 4e-5 * altitude[[0, -1]]  # pixels of 40 microradian
    corners = np.concatenate([_below(ends + side * half[:, None] * beside) for side in (-1.0, 0.0, 1.0)])
    (earliest, latest), images = trajectory.coverage, []
    for line, macropixel in zip(STEREO, readout.macropixels, strict=True):
        period, interior, samples = 4e-3 * macropixel, hrsc_interior(line, macropixel), HRSC_PIXELS // macropixel
        all_lines = int((latest - earliest) / period), samples
        whole = line_image(f"{name}/{line}", all_lines, interior, one_rate(earliest, period), trajectory)
        pixels, _ = whole.ground_to_image(corners, start=whole.timing.lines(np.tile(interval, 3)))
        times = whole.timing.at(pixels[:, 0])[0]
        beyond = 0.0 if line == "ND" else SLACK / float(speed.min())
        first, last = float(times.min()) - beyond, float(times.max()) + beyond
        timing, lines = _timing(flown, interval, (first, last), readout, macropixel)
        images.append(line_image(f"{name}/{line}", (lines, samples), interior, timing, trajectory))
    return tuple(images)


def _timing(
    flown: PericentrePass, nadir: tuple[float, float], ends: tuple[float, float], readout: Readout, macropixel: int
) -> tuple[LineTiming, int]:
    """Lines of an image between two `ends`, s past the epoch, and their number."""
    changes = np.linspace(*nadir, readout.rates + 1)
    _, speed, altitude = flown.track(np.linspace(*nadir, 2 * readout.rates + 1))
    ground = readout.ground_pixel * macropixel * altitude[1::2] / REFERENCE_ALTITUDE
    periods, first, starts = ground / speed[1::2], [0.0], [ends[0]]
    for k, change in enumerate([*changes[1:-1], ends[1]]):
        count = max(int(np.ceil((change - starts[k]) / periods[k])), 1)
        first.append(first[k] + count)
        starts.append(starts[k] + count * periods[k])
    return LineTiming(np.array(first[:-1]), np.array(starts[:-1]), periods), int(first[-1])


def _below(points: Array) -> Array:
    """Points (n, 3) in m of the ellipsoid under points (n, 3), along the radius."""
    return intersect_ellipsoid(points, -points, MARS)[0]
