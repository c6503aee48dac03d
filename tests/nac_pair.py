"""Cameras mounted on one spacecraft, and errors of their common trajectory and of each mounting.

All cameras of a pass share its trajectory (`MountedCamera.image`), and so its error: values at the nodes of the pass,
drawn from the prior that the network states, about the axes of the pass's first image. A camera's boresight error turns
it about its own axes, after that,

    C_true = Exp(-b) A Exp(-c(t)) C_first(t),

with A from the first camera's nominal axes to this one's. So the truth is composed of rotations as they are built into
a spacecraft; the adjustment adds b and A c as one rotation vector, which differs by half their product (1e-7 rad for
1.6 and 0.15 mrad).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from mex_flight import pass_correction

from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import east_north, intersect_ellipsoid
from mgsgraph.geometry.camera import InteriorOrientation, LrocNacDistortion
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import (
    SUPPORT,
    OrientationCorrection,
    OrientationImages,
    OrientationPrior,
    evenly_spaced,
    polynomial,
)
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.names import Names
from mgsgraph.network import GroundPoints, ImageRays, Network, Pass, PointClass, ProfileShifts, Ranges
from mgsgraph.network.joining import mountings, seconds
from mgsgraph.network.passes import PolynomialPrior
from mgsgraph.network.shared import SharedKind, SharedUnknown
from mgsgraph.simulation.camera import InstrumentErrors, as_taken, interior_orientation, line_image, one_rate
from mgsgraph.simulation.observations import Visible, well_inside
from mgsgraph.simulation.orbit import (
    MOON,
    MOON_BODY,
    CircularPass,
    circle_times,
    circular_trajectory,
    site_at,
)
from mgsgraph.units import DEG

_HELD = 1e-7
"""Sigma of a degree that is held, of the sigma of the constant: it moves nothing, and stays invertible."""


@dataclass(frozen=True, slots=True, eq=False)
class MountedCamera:
    """A line camera on a spacecraft."""

    name: str
    """What its images are called by."""
    interior: InteriorOrientation
    """Its optics."""
    samples: int
    """Of a line."""
    mount: Array
    """(3, 3) rotation from the spacecraft's axes (+X forward, +Z down) to the camera's."""

    def image(self, name: str, flown: CircularPass, lines: int, period: float) -> PushbroomImage:
        """Nominal image whose middle line is taken at the pass's epoch; `period` in s per line."""
        half = 0.5 * lines * period
        trajectory = circular_trajectory(flown, circle_times(half), self.mount, self.mount)
        size = lines, self.samples
        return line_image(name, size, self.interior, one_rate(-half, period), trajectory, flown.body.ellipsoid)


@dataclass(frozen=True, slots=True)
class PassErrors:
    """Sigmas of a pass's trajectory error: polynomials of time, s = -1 .. 1 over the pass, of degree 3 at most."""

    position: tuple[float, ...] = (30.0, 10.0)
    """m, of the coefficients of s^0, s^1, ..., the same along X, Y, Z."""
    attitude: tuple[float, ...] = (1.5e-4, 5e-5, 2e-5, 1e-5)
    """rad, the same of rotations about the first camera's axes."""

    @property
    def sigmas(self) -> Array:
        """(4, 6) of all coefficients; a degree that is held has next to none."""
        rows = [[*stated, *[_HELD * stated[0]] * (SUPPORT - len(stated))] for stated in (self.position, self.attitude)]
        return np.repeat(np.array(rows).T, 3, axis=1)

    @property
    def free(self) -> Array:
        """(4, 6) True for coefficients that are not held."""
        terms = np.arange(SUPPORT)[:, None]
        return np.repeat(terms < np.array([[len(self.position), len(self.attitude)]]), 3, axis=1)

    @property
    def prior(self) -> PolynomialPrior:
        """The same of the nodes of a pass: a cubic polynomial of time is Lagrange's through four of them."""
        rows = self.sigmas
        return PolynomialPrior(rows[: len(self.position), :3], rows[: len(self.attitude), 3:])


def powers(nodes: OrientationImages) -> Array:
    """(k, k) of k nodes: s^0, s^1, ... at each, with s = -1 .. 1 over the pass. Its inverse takes values at the nodes
    to coefficients.
    """
    start, stop = nodes.coverage
    s = (2.0 * nodes.times - start - stop) / (stop - start)
    return polynomial(s, len(nodes) - 1)[0]


def joined(name: str, images: Sequence[PushbroomImage], first: int, errors: PassErrors) -> Pass:
    """The pass of images of one flight, numbered from `first` on in their network, with four nodes."""
    edges = np.array([seconds(image) for image in images])
    epoch = images[0].trajectory.epoch
    start, stop = float(edges[:, 0].min()) - epoch, float(edges[:, 1].max()) - epoch
    nodes = evenly_spaced("lagrange", epoch, (start, stop), stop - start)
    numbers = np.arange(first, first + len(images))
    return Pass(name, numbers, nodes, errors.prior, mountings(images, f"pass {name!r}"))


@dataclass(frozen=True, slots=True, eq=False)
class TrueRig:
    """How images were truly taken."""

    images: tuple[PushbroomImage, ...]
    """With their cameras turned by boresight errors; their trajectories are nominal."""
    corrections: tuple[OrientationCorrection, ...]
    """Of each, about its own turned axes: its true orientation is the image's (+) this."""
    nodes: tuple[Array, ...]
    """(4, 6) of each pass, m and rad about the axes of its first image: what an adjustment should find."""

    @classmethod
    def drawn(
        cls,
        images: Sequence[PushbroomImage],
        passes: Sequence[Pass],
        errors: PassErrors,
        boresights: Array,
        rng: np.random.Generator,
    ) -> "TrueRig":
        """A truth drawn from the prior of the passes; `boresights` (images, 3) in rad are given."""
        values, corrections = [], list[OrientationCorrection]()
        for pass_ in passes:
            nodes = powers(pass_.nodes) @ np.where(errors.free, errors.sigmas * rng.standard_normal((SUPPORT, 6)), 0.0)
            values.append(nodes)
            for j in pass_.images.tolist():
                axes = pass_.axes_of(j)
                own = rotation.exponential(-boresights[j]) @ (np.eye(3) if axes is None else axes)
                turned = np.hstack([nodes[:, :3], nodes[:, 3:] @ own.T])
                corrections.append(pass_correction(pass_.nodes, turned))
        nominal = tuple(
            as_taken(image, InstrumentErrors(camera_boresight=b)) for image, b in zip(images, boresights, strict=True)
        )
        return cls(nominal, tuple(corrections), tuple(values))

    def ground(self, image: int, pixels: Array, heights: Array) -> Array:
        """(n, 3) m, where lines and samples (n, 2) of an image meet the ground at heights (n,) above the ellipsoid."""
        own = self.images[image]
        origins, directions = own.sightlines(pixels[:, 0], pixels[:, 1], self.corrections[image])
        return intersect_ellipsoid(origins, directions, own.body, heights)[0]

    def shots(self, image: int, shares: Array, beam: Array, heights: Array) -> tuple[Array, Array, Array]:
        """Laser shots at shares (n,) of an image's lines along a beam (3,) in its axes: true footprints (n, 3) in m at
        heights (n,) above the ellipsoid, times (n,) in s TDB past J2000 and ranges (n,) in m.
        """
        own = self.images[image]
        times = own.trajectory.epoch + own.timing.at(shares * own.lines)[0]
        pose = own.pose(own.timing.lines(times - own.trajectory.epoch), self.corrections[image])  # as float64 has them
        beams = np.einsum("nji,j->ni", pose.matrix, beam)
        places, _, _ = intersect_ellipsoid(pose.position, beams, own.body, heights)
        return places, times, np.linalg.norm(places - pose.position, axis=1)

    def seen(self, points: Array) -> Visible:
        """Where images show points (n, 3) in m, well inside their edges."""
        visible = Visible()
        for j, (image, correction) in enumerate(zip(self.images, self.corrections, strict=True)):
            pixels, _ = image.ground_to_image(points, correction)
            inside = np.flatnonzero(well_inside(image, pixels))
            visible.add(inside, j, pixels[inside])
        return visible


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedRig:
    """What an adjustment is given, and the truth that it should find."""

    network: Network
    """With passes, and boresights as shared unknowns."""
    truth: TrueRig
    """How images were truly taken."""
    points: Array
    """(n, 3) m, body-fixed: true places of the network's points."""
    shared: tuple[Array, ...]
    """True value of each of the network's shared unknowns."""

    def __repr__(self) -> str:
        return f"SimulatedRig({self.network!r})"


def seen_twice(visible: Visible, count: int) -> Index:
    """Points of `count` that at least two images show."""
    point, _, _ = visible.ordered()
    return np.flatnonzero(np.bincount(point, minlength=count) >= 2)



BORESIGHT = "boresight of NAC-R"
SAMPLES = 5064

_LEFT_TO_RIGHT = rotation.exponential(np.array([-2.15767e-3, -7.52083e-2, -3.13420543]))
"""From the axes of NAC-L to those of NAC-R, by the tables of `lro_nac_hadley`."""
_PITCH = 1.0 / 142857.0
"""m."""
_EPOCHS = (300_000_000.0, 302_360_000.0)
"""s TDB past J2000 of the passes' middles, 27 days apart."""
_SITE = (3.6 * DEG, 26.1 * DEG)
"""rad, longitude and latitude: Hadley rille."""
_RELIEF = 300.0
"""m, sigma of the ground's heights."""
_LOOSE = (1000.0, 1000.0, 30.0)
"""m, east, north and up: sigmas of the place of a tie point that one pass alone shows, by a terrain model's height."""
_TRIES = 60
"""Points drawn for one in the overlap of L and R."""


ALTITUDE = 50e3
"""m."""
_ROLL, _EAST = 20.0 * DEG, 1250.0
"""rad, by which the second pass looks aside; m on the ground by which its middle lies east of the first one's."""
_LINES, _PERIOD = 52_224, 3.4e-4
"""Of each image, and s per line."""
_TIE, _SHOT, _RANGE = 0.3, 3.0, 0.2
"""Sigmas: px of a tie, px of a footprint's place in an image, m of a range."""
_FOOTPRINT, _TRACK = (3.0, 3.0, 1.0), 20.0
"""m, sigmas of a footprint's own place east, north and up; east and north alike of the shift that all footprints of a
pass share."""
_BORESIGHT, _BORESIGHT_SIGMAS = 80.0, np.array([1.6e-3, 1.6e-3, 5e-4])
"""m on the ground below, by which the axis of R is off; rad, its prior, about its axes."""


@dataclass(frozen=True, slots=True)
class NacSettings:
    """What to simulate."""

    ties: int = 400
    """Tie points drawn over the images of the first pass; those count that a second image shows."""
    beside: int = 40
    """Tie points in the overlap of L and R, of each pass; fewer where a boresight error leaves it too narrow."""
    shots: int = 40
    """Laser shots of each pass, along the spacecraft's +Z."""
    errors: PassErrors = field(default_factory=PassErrors)
    """Of each pass's trajectory."""


def nac_cameras() -> tuple[MountedCamera, MountedCamera]:
    """NAC-L and NAC-R, their optical axes as far to the left of the spacecraft's +Z as to its right."""
    ahead = np.array([-1.0, 0.0, 0.0])  # the flight in L's axes, about
    middle = np.array([0.0, 0.0, 1.0]) + _LEFT_TO_RIGHT.T @ [0.0, 0.0, 1.0]
    middle /= np.linalg.norm(middle)
    ahead -= (ahead @ middle) * middle
    ahead /= np.linalg.norm(ahead)
    left = np.stack([ahead, np.cross(middle, ahead), middle], axis=1)
    cameras = []
    for name, focal, centre, k, sign, mount in (
        ("L", 0.69962, 2547.5, 18.1, 1.0, left),
        ("R", 0.70157, 2495.5, 18.3, -1.0, _LEFT_TO_RIGHT @ left),
    ):
        interior = replace(interior_orientation(focal, sign * _PITCH, centre), distortion=LrocNacDistortion(k))
        cameras.append(MountedCamera(name, interior, SAMPLES, mount))
    return cameras[0], cameras[1]


def nac_images() -> tuple[PushbroomImage, ...]:
    """Nominal images: L and R of the first pass at nadir, then of the second one."""
    east, images = _EAST / (MOON.equatorial * np.cos(_SITE[1])), []
    for k, (epoch, roll) in enumerate(zip(_EPOCHS, (0.0, _ROLL), strict=True)):
        site = site_at(_SITE[0] + k * east, _SITE[1], MOON)
        flown = CircularPass(epoch, site, 0.0, ALTITUDE, roll, MOON_BODY, turning=True)
        images += [camera.image(f"{camera.name}{k + 1}", flown, _LINES, _PERIOD) for camera in nac_cameras()]
    return tuple(images)


def simulate_nac_pair(settings: NacSettings | None = None, seed: int = 1) -> SimulatedRig:
    """Simulate two passes; the same settings and seed give the same."""
    settings = settings or NacSettings()
    of_truth, of_points, of_shots, of_noise = np.random.default_rng([seed, 24]).spawn(4)
    images = nac_images()
    passes = tuple(joined(f"pass {k + 1}", images[2 * k : 2 * k + 2], 2 * k, settings.errors) for k in (0, 1))
    boresight = _drawn_boresight(of_truth)
    truth = TrueRig.drawn(images, passes, settings.errors, np.array([0.0, 1.0] * 2)[:, None] * boresight, of_truth)
    ties = _tie_places(truth, settings, of_points)
    shots, times, ranges = _shots(truth, settings.shots, of_shots)
    points, carrier = np.concatenate([ties, shots]), np.repeat([0, 2], settings.shots)
    rays = _rays(truth, points, len(ties), of_noise)
    given, shifts = _given(ties, shots, carrier // 2, _of_one_pass(rays, len(points)), of_noise)
    n = np.arange(len(shots))
    shared = SharedUnknown(BORESIGHT, SharedKind.CAMERA_BORESIGHT, np.array([1, 3]), _BORESIGHT_SIGMAS)
    network = Network(
        images=images,
        priors=own_priors(settings.errors),
        held=np.zeros(4, dtype=bool),
        points=given,
        rays=rays,
        ranges=Ranges(
            len(ties) + n, carrier, times, ranges + _RANGE * of_noise.standard_normal(n.size),
            np.full(n.size, _RANGE),
        ),
        shifts=shifts,
        shared=(shared,),
        passes=passes,
    )  # fmt: skip
    return SimulatedRig(network, truth, points, (boresight,))


def own_priors(errors: PassErrors) -> tuple[OrientationPrior, ...]:
    """Prior of each image by itself: the pass's error, and for R also that of its boresight."""
    sigmas, mounted = errors.sigmas, errors.sigmas.copy()
    mounted[0, 3:] = np.hypot(mounted[0, 3:], _BORESIGHT_SIGMAS)
    return tuple(OrientationPrior(sigma) for sigma in (sigmas, mounted) * 2)


def _drawn_boresight(rng: np.random.Generator) -> Array:
    """(3,) rad: of the stated size about x and y in a direction that is drawn, and drawn about z."""
    direction, size = rng.uniform(0.0, 2.0 * np.pi), _BORESIGHT / ALTITUDE
    about_z = _BORESIGHT_SIGMAS[2] * rng.standard_normal()
    return np.array([size * np.cos(direction), size * np.sin(direction), about_z])


def _tie_places(truth: TrueRig, settings: NacSettings, rng: np.random.Generator) -> Array:
    """(n, 3) m: over both images of the first pass, and in the overlaps of L and R of each pass."""
    def drawn(image: int, count: int) -> Array:
        pixels = np.array([_LINES, SAMPLES]) * rng.random((count, 2))
        return truth.ground(image, pixels, _RELIEF * rng.standard_normal(count))

    everywhere = np.concatenate([drawn(j, settings.ties // 2) for j in (0, 1)])
    places = [everywhere[seen_twice(truth.seen(everywhere), len(everywhere))]]
    for left in (0, 2):
        tried = drawn(left, _TRIES * settings.beside)
        point, image, _ = truth.seen(tried).ordered()
        both = np.intersect1d(point[image == left], point[image == left + 1])[: settings.beside]
        places.append(tried[both])
    return np.concatenate(places)


def _shots(truth: TrueRig, count: int, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """True footprints (n, 3) in m, times (n,) in s TDB past J2000 and ranges (n,) in m of both passes."""
    beam, shares = nac_cameras()[0].mount @ [0.0, 0.0, 1.0], np.linspace(0.02, 0.98, count)
    shots = [truth.shots(left, shares, beam, _RELIEF * rng.standard_normal(count)) for left in (0, 2)]
    places, times, ranges = (np.concatenate(each) for each in zip(*shots, strict=True))
    return places, times, ranges


def _rays(truth: TrueRig, points: Array, ties: int, rng: np.random.Generator) -> ImageRays:
    """As measured, with noise: ties in all images that show them, footprints less well."""
    point, image, exact = truth.seen(points).ordered()
    sigma = np.repeat(np.where(point < ties, _TIE, _SHOT)[:, None], 2, axis=1)
    return ImageRays(point, image, exact + sigma * rng.standard_normal(exact.shape), sigma)


def _of_one_pass(rays: ImageRays, count: int) -> Mask:
    """(count,) True for points that one pass alone shows: their rays are nearly parallel."""
    shown = np.zeros((count, 2), dtype=bool)
    shown[rays.point, rays.image // 2] = True
    return np.asarray(~shown.all(axis=1))


def _given(
    ties: Array, shots: Array, profile: Index, of_one_pass: Mask, rng: np.random.Generator
) -> tuple[GroundPoints, ProfileShifts]:
    """Points as an adjustment is given them. What footprints of a pass have in common is one error, an unknown; tie
    points `of_one_pass` (n,) have a height to start from: their rays are so nearly parallel that
    the boresight's error makes them meet behind the cameras.
    """
    n, m, places = len(ties), len(shots), np.concatenate([ties, shots])
    constrained = of_one_pass | (np.arange(n + m) >= n)
    sigmas = np.repeat([_LOOSE, _FOOTPRINT], [n, m], axis=0)
    errors = sigmas * rng.standard_normal((n + m, 3))
    errors[n:, :2] -= (_TRACK * rng.standard_normal((2, 2)))[profile]
    up = unit_vectors(places)
    frames = np.concatenate([east_north(places), up[:, None]], axis=1)
    points = GroundPoints(
        Names.of([*(f"T{i:04d}" for i in range(n)), *(f"S{i:04d}" for i in range(m))]),
        np.repeat([int(PointClass.TIE), int(PointClass.LASER)], [n, m]),
        np.where(constrained, int(PointKind.CONSTRAINED), int(PointKind.FREE)),
        np.where(constrained[:, None], places + np.einsum("nk,nkj->nj", errors, frames), np.nan),
        np.where(constrained[:, None, None], np.einsum("nk,nki,nkj->nij", sigmas**2, frames, frames), 0.0),
    )  # fmt: skip
    return points, ProfileShifts(("LOLA 1", "LOLA 2"), np.concatenate([np.full(n, -1), profile]), np.full(2, _TRACK))
