"""Passes of a simulated Mars Express: a Kepler orbit about its pericentre, HRSC looking down, its lines' times.

The camera's +Z looks to Mars' centre and its +Y follows the motion over the turning ground, so that all lines pass over
the same swath. Each line begins when it sees the first ground of the nadir image and ends with the last. The line
period is constant between changes, which all lines of a pass make at the same times, and follows height and speed.

The camera has no distortion. Its numbers are those of ISIS' addendum hrscAddendum004.ti (FOCAL_LENGTH, ITRANSL,
ITRANSS), written as what they are made of: each line is turned by theta in the focal plane of MEX_HRSC_HEAD and crosses
its +Y axis (the flight direction; +X is across, against the samples) at Y0, at detector sample So:

    x = -c p (sample - So),  y = Y0 + s p (sample - So),  c, s = cos, sin theta,  p = 7 um.

Y0 over the focal length is the angle by which a line looks ahead: 18.9 deg for S1 and S2, 12.75 deg for P1 and P2.
"""

from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple, get_args

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import intersect_ellipsoid, planetocentric
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.orientation import Angles, Moments, OrientationCorrection, OrientationImages, evenly_spaced
from mgsgraph.geometry.records import Array, Index, Mask, assign, frozen
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.network import NodePrior
from mgsgraph.network.passes import normalised
from mgsgraph.record import Record
from mgsgraph.simulation.camera import interior_orientation, line_image, one_rate
from mgsgraph.simulation.ground import SiteTerrain
from mgsgraph.simulation.observations import MARGIN, Visible, well_inside
from mgsgraph.simulation.orbit import MARS, MERIDIAN, Orbit, body_matrix, sampled_trajectory
from mgsgraph.units import DEG, MM


class DetectorLine(NamedTuple):
    """One of HRSC's nine lines of detectors."""

    focal_length: float
    """mm."""
    offset: float
    """mm, Y0: ahead of the lens's axis."""
    rotation: float
    """rad, theta."""
    crossing: float
    """So: detector sample, first pixel's centre at 1, at which the line crosses the axis of flight."""


HRSC_LINES: dict[str, DetectorLine] = {
    "S1": DetectorLine(174.87, 59.9869, 0.00048, 2595.9317),
    "IR": DetectorLine(174.82, 49.7918, 0.00044, 2594.8517),
    "P1": DetectorLine(174.80, 39.5531, 0.00021, 2597.1421),
    "GREEN": DetectorLine(175.23, 10.2130, 0.00095, 2598.8432),
    "ND": DetectorLine(175.01, -0.0055, -0.00006, 2597.3376),
    "BLUE": DetectorLine(175.01, -10.2417, 0.00019, 2602.0075),
    "P2": DetectorLine(174.74, -39.5483, -0.00034, 2589.3140),
    "RED": DetectorLine(174.61, -49.7678, -0.00004, 2585.3891),
    "S2": DetectorLine(174.80, -59.9927, 0.00011, 2588.7635),
}
"""From the one that looks farthest ahead to the one that looks farthest back."""
STEREO = ("S1", "P1", "ND", "P2", "S2")
"""The five that tie points are matched in."""
HRSC_PIXELS = 5184
"""Active pixels of a line."""

_HRSC_PITCH_MM, _HRSC_MIDDLE = 0.007, 2592.5
"""mm between pixels; detector sample, first pixel's centre at 1, of the lens's axis."""


def hrsc_interior(name: str, macropixel: int = 1) -> InteriorOrientation:
    """Interior orientation of an HRSC line whose samples are means of `macropixel` detector pixels each."""
    if name not in HRSC_LINES:
        raise InputError("HRSC", f"line {name!r}", f"one of {', '.join(HRSC_LINES)}")
    line, pitch = HRSC_LINES[name], _HRSC_PITCH_MM * MM
    sine, cosine, ahead = np.sin(line.rotation), np.cos(line.rotation), line.offset / _HRSC_PITCH_MM
    return replace(
        interior_orientation(line.focal_length * MM, pitch, _HRSC_MIDDLE - 0.5, summing=float(macropixel)),
        to_pixel=np.array([
            [-cosine * ahead, sine / pitch, cosine / pitch],
            [line.crossing - _HRSC_MIDDLE - sine * ahead, -cosine / pitch, sine / pitch],
        ]),
    )  # fmt: skip


_ANGLE = 12.5 / 265e3
"""rad along track of a line without macropixels: 12.5 m at 265 km. (Across track the optics have 10.6 m there.)"""
SLACK = 2e3
"""m of ground that the other lines see before and after the nadir image: errors and relief shall not cut it."""

_STEP = 1.0
"""s between the records of the tables."""
_ROTATION = MERIDIAN[1] * DEG / 86400.0
"""rad/s, of Mars."""
_AHEAD, _MARGIN = 0.5, 20.0
"""Tangent beyond that of any line's look, and s, to which the tables reach beyond the nadir image."""
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
    rates: int = 2
    """Line rates within an image, for even parts of the nadir image's time."""


def pass_images(
    name: str, flown: PericentrePass, interval: tuple[float, float], readout: Readout
) -> tuple[PushbroomImage, ...]:
    """Nominal images of the five stereo lines, on one trajectory; `interval` is that of the nadir image, s past the
    pass's epoch.
    """
    start, stop = interval
    _, speed, altitude = flown.track(np.linspace(start, stop, 101))
    reach = _AHEAD * float(altitude.max()) / float(speed.min()) + _MARGIN
    trajectory = flown.trajectory(start - reach, stop + reach)
    ends = trajectory.pose(np.array([start, stop])).position
    beside = np.cross(unit_vectors(ends), flown.direction)
    half = 0.5 * HRSC_PIXELS * 4e-5 * altitude[[0, -1]]  # pixels of 40 microradian
    corners = np.concatenate([_below(ends + side * half[:, None] * beside) for side in (-1.0, 0.0, 1.0)])
    (earliest, latest), images = trajectory.coverage, []
    for line, macropixel in zip(STEREO, readout.macropixels, strict=True):
        period, interior, samples = 4e-3 * macropixel, hrsc_interior(line, macropixel), HRSC_PIXELS // macropixel
        all_lines = int((latest - earliest) / period), samples
        whole = line_image(f"{name}/{line}", all_lines, interior, one_rate(earliest, period), trajectory)
        pixels, _ = whole.ground_to_image(corners)
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
    periods, first, starts = _ANGLE * macropixel * altitude[1::2] / speed[1::2], [0.0], [ends[0]]
    for k, change in enumerate([*changes[1:-1], ends[1]]):
        count = max(int(np.ceil((change - starts[k]) / periods[k])), 1)
        first.append(first[k] + count)
        starts.append(starts[k] + count * periods[k])
    return LineTiming(np.array(first[:-1]), np.array(starts[:-1]), periods), int(first[-1])


def _below(points: Array) -> Array:
    """Points (n, 3) in m of the ellipsoid under points (n, 3), along the radius."""
    return intersect_ellipsoid(points, -points, MARS)[0]



LEAST = 3
"""Lines of a pass in which a point must have been matched."""

_NADIR = STEREO.index("ND")
_TABLE = 129
"""Lines of an image of which the ground is tabulated, for first guesses."""
_BESIDE = 1.3
"""Half widths of a swath beyond which a point isn't looked for in it."""
_LINKED = 0.3
"""Share of the points which another pass sees, too, that are matched in its lines as well."""
_ROUNDS = 20
"""Of drawing, before passes count as too small."""


@dataclass(frozen=True, slots=True)
class PointMatching(Record):
    """How points are matched."""

    shares: tuple[float, float, float] = (0.05, 0.15, 0.80)
    """Of the points of a pass that are matched in 3, 4 and 5 of its lines, where five see them; they add up to 1."""
    sigma: float = 0.4
    """px of each image (macropixels), of line and sample."""
    blunders: float = 0.0
    """Share of rays that are 5 to 100 px off."""


class _Swath(NamedTuple):
    """Where the lines of an image lie on the ground, nominally."""

    along: Array
    """(t,) rad at Mars' centre from the pericentre, increasing: of the middle samples of some lines."""
    across: Array
    """(t,) rad, of the same."""
    half_width: Array
    """(t,) rad."""


@dataclass(frozen=True, slots=True, eq=False)
class FlownPass:
    """A pass as it was flown."""

    axes: Array
    """(3, 3) unit rows, body-fixed: flight, across, up at the pericentre."""
    images: tuple[PushbroomImage, ...]
    """Of the five stereo lines, nominal."""
    true: OrientationCorrection
    """Of all of them: true orientation = nominal (+) this."""
    level: float
    """m, mean height of the ground above the ellipsoid."""
    swaths: tuple[_Swath, ...] = field(init=False)
    """Where the lines of each image lie on the ground."""

    def __post_init__(self) -> None:
        assign(self, swaths=tuple(_swath(self.axes, image, self.level) for image in self.images))

    def matched(self, points: Array, matches: PointMatching, rng: np.random.Generator) -> tuple[Index, Index, Array]:
        """In which lines points (n, 3) in m are matched: in as many as drawn, of those that see them, or in none.

        Returns
        -------
        point, image : (k,)
            Numbers, by point and then by image.
        pixels : (k, 2)
            True line and sample.
        """
        n, m = len(points), len(self.images)
        pixels = np.stack([self._projected(j, points) for j in range(m)])
        visible = np.stack([well_inside(image, own) for image, own in zip(self.images, pixels, strict=True)], axis=1)
        lines_wanted = rng.choice([3, 4, 5], size=n, p=matches.shares)
        order = np.argsort(np.where(visible, rng.random((n, m)), 2.0), axis=1)
        chosen = np.zeros((n, m), dtype=bool)
        np.put_along_axis(chosen, order, np.arange(m) < lines_wanted[:, None], axis=1)
        chosen &= visible
        chosen[np.count_nonzero(chosen, axis=1) < LEAST] = False
        point, image = np.nonzero(chosen)
        return point, image, pixels[image, point]

    def beneath(self, points: Array) -> Mask:
        """Which of points (n, 3) in m may lie in its nadir image."""
        swath, (along, across) = self.swaths[_NADIR], _angles(self.axes, points)
        middle, half = (np.interp(along, swath.along, values) for values in (swath.across, swath.half_width))
        slack = 0.02 * np.ptp(swath.along)
        inside = (along > swath.along[0] - slack) & (along < swath.along[-1] + slack)
        return np.asarray(inside & (np.abs(across - middle) < _BESIDE * half))

    def _projected(self, j: int, points: Array) -> Array:
        """True line and sample (n, 2) in image j; NaN where unseen."""
        return self.images[j].ground_to_image(points, self.true)[0]


def matched_points(
    passes: list[FlownPass], relief: SiteTerrain, number: int, matches: PointMatching, rng: np.random.Generator
) -> tuple[Array, Visible]:
    """Random points of the true ground in the passes' nadir images, evenly many of each pass, (number, 3) in m, and
    where they are matched; images are counted through all passes.
    """
    counts = np.diff(np.linspace(0, number, len(passes) + 1).astype(int)).tolist()
    points, visible, first = list[Array](), Visible(), 0
    for k, count in enumerate(counts):
        own = _of_pass(passes[k], relief, count, matches, rng, visible, (first, len(STEREO) * k))
        points.append(own)
        for j, other in enumerate(passes):
            if j != k:
                tried = np.flatnonzero(other.beneath(own) & (rng.random(len(own)) < _LINKED))
                point, image, pixels = other.matched(own[tried], matches, rng)
                visible.add(tried[point] + first, image + len(STEREO) * j, pixels)
        first += count
    return np.concatenate(points), visible


def _of_pass(
    pass_: FlownPass,
    relief: SiteTerrain,
    count: int,
    matches: PointMatching,
    rng: np.random.Generator,
    visible: Visible,
    first: tuple[int, int],
) -> Array:
    """Points (count, 3) in m of a pass. What its own images see of them is added to `visible`, with numbers of points
    and images that count from `first`.
    """
    parts, have = [np.zeros((0, 3))], 0
    for _ in range(_ROUNDS):
        if have == count:
            break
        points = _on_ground(pass_.images[_NADIR], relief, count - have + 16, rng)
        point, image, pixels = pass_.matched(points, matches, rng)
        visible_points, number = np.unique(point, return_inverse=True)
        some = number < count - have
        points = points[visible_points[: count - have]]
        parts.append(points)
        visible.add(number[some] + have + first[0], image[some] + first[1], pixels[some])
        have += len(points)
    if have < count:
        name = pass_.images[_NADIR].name
        remedy = "take longer passes or smaller errors of the trajectories"
        raise InputError(f"simulated block, {name}", f"ground for {have} of {count} points", remedy=remedy)
    return np.concatenate(parts)


def _on_ground(nadir: PushbroomImage, relief: SiteTerrain, count: int, rng: np.random.Generator) -> Array:
    """Points (count, 3) in m of the true ground, evenly drawn over the nadir image as nominally oriented."""
    size = np.array([nadir.lines, nadir.samples])
    lines, samples = rng.uniform(MARGIN, size - MARGIN, (count, 2)).T
    ground, _, _ = intersect_ellipsoid(*nadir.sightlines(lines, samples), nadir.body, relief.ground.level)
    longitude, latitude, _ = planetocentric(ground).T
    return relief.on_ground(longitude, latitude)


def _swath(axes: Array, image: PushbroomImage, level: float) -> _Swath:
    lines = np.linspace(0.0, image.lines, _TABLE)
    ground = [
        image.image_to_ground(lines, np.full(_TABLE, share * image.samples), level)[0] for share in (0.0, 0.5, 1.0)
    ]
    left, middle, right = (_angles(axes, points) for points in ground)
    return _Swath(middle[0], middle[1], 0.5 * np.abs(left[1] - right[1]))


def _angles(axes: Array, points: Array) -> tuple[Array, Array]:
    """Angles (n,) in rad at Mars' centre along and across the flight over the pericentre."""
    flight, across, up = (points @ axes.T / np.linalg.norm(points, axis=1)[:, None]).T
    return np.arctan2(flight, up), np.arcsin(np.clip(across, -1.0, 1.0))



Axis = Literal["pitch", "roll", "yaw"]
"""About the camera's x (across), y (flight) or z (optical axis): HRSC's."""

NODES_PER_WAVE = 12
"""True nodes in a period of jitter; Lagrange's polynomials then follow a sine to 0.3 % of its amplitude."""


@dataclass(frozen=True, slots=True)
class Jitter(Record):
    """A vibration of the camera."""

    amplitude: float
    """rad."""
    frequency: float
    """Hz."""
    axis: Axis = "pitch"
    """About which it turns."""

    @property
    def component(self) -> int:
        """Which of the six orientation coefficients it changes."""
        return 3 + get_args(Axis).index(self.axis)


def drawn_nodes(prior: NodePrior, nodes: OrientationImages, rng: np.random.Generator) -> Array:
    """Coefficients (k, 6) of nodes, m and rad, drawn from their prior.

    Raises
    ------
    InputError
        Where the prior leaves a direction of them without finite sigma.
    """
    if not np.all(np.isfinite(prior.sigmas)):
        raise InputError("node prior", "an infinite sigma", "finite ones, to draw from")
    bias, drift = rng.standard_normal((2, 6)) * [prior.bias, prior.drift]
    departures = rng.standard_normal((len(nodes), 6))
    if prior.correlation_time > 0.0:
        memory = np.exp(-np.diff(nodes.times) / prior.correlation_time)
        for k, share in enumerate(memory, start=1):
            departures[k] = share * departures[k - 1] + np.sqrt(1.0 - share**2) * departures[k]
    return np.asarray(bias + drift * normalised(nodes)[:, None] + prior.sigmas * departures)


def pass_correction(nodes: OrientationImages, values: Array, angles: Angles = "camera") -> OrientationCorrection:
    """The correction of any image of a pass: no polynomial, and the values (k, 6) of its nodes."""
    return OrientationCorrection(np.vstack([np.zeros((1, 6)), values]), angles, nodes)


def correction_at(correction: OrientationCorrection, times: Array, epoch: float) -> Array:
    """A pass's correction (n, 6) in m and rad at times (n,) in s past `epoch` (s TDB past J2000)."""
    return correction.at(Moments.of_times(times, epoch))[0]


def true_correction(
    prior: NodePrior,
    nodes: OrientationImages,
    true_spacing: float | None,
    jitter: Jitter | None,
    rng: np.random.Generator,
) -> OrientationCorrection:
    """The truth of a pass: drawn from the prior, but for the jitter, whose phase is drawn.

    It has the adjustment's nodes unless `true_spacing` (s between nodes, at most) or jitter asks for others, which then
    are of Lagrange's basis, so that its values there are the draws, over the same time.
    """
    if true_spacing is not None:
        nodes = evenly_spaced("lagrange", nodes.epoch, nodes.coverage, true_spacing)
    smooth = pass_correction(nodes, drawn_nodes(prior, nodes, rng))
    if jitter is None:
        return smooth
    fine = evenly_spaced("lagrange", nodes.epoch, nodes.coverage, 1.0 / (NODES_PER_WAVE * jitter.frequency))
    values = correction_at(smooth, fine.times, fine.epoch)
    phase = rng.uniform(0.0, 2.0 * np.pi)
    values[:, jitter.component] += jitter.amplitude * np.sin(2.0 * np.pi * jitter.frequency * fine.times + phase)
    return pass_correction(fine, values)
