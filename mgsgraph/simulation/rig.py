"""Cameras mounted on one spacecraft, and what is wrong with their common trajectory and with each mounting.

All cameras of a pass share its trajectory (`MountedCamera.image`), and so its error: values at the nodes of the pass,
drawn from the prior that the network states, about the axes of the pass's first image. A camera's boresight error turns
it about its own axes, after that,

    C_true = Exp(-b) A Exp(-c(t)) C_first(t),

with A from the first camera's nominal axes to this one's. So the truth is composed of rotations as they are built into
a spacecraft; the adjustment adds b and A c as one rotation vector, which differs by half their product (1e-7 rad for
1.6 and 0.15 mrad).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.files.tie_points import PointKind
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import east_north, intersect_ellipsoid
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.orientation import SUPPORT, OrientationCorrection, OrientationImages, evenly_spaced, polynomial
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.names import Names
from mgsgraph.network import GroundPoints, ImageRays, Network, Pass
from mgsgraph.network.joining import mountings, seconds
from mgsgraph.network.passes import PolynomialPrior
from mgsgraph.simulation.camera import InstrumentErrors, as_taken, line_image, one_rate
from mgsgraph.simulation.observations import Visible, well_inside
from mgsgraph.simulation.orbit import CircularPass, circle_times, circular_attitude, circular_orbit, sampled_trajectory
from mgsgraph.simulation.strip_truth import strip_correction

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
        times = circle_times(half)
        camera = self.mount @ circular_attitude(flown, times)
        trajectory = sampled_trajectory(
            flown.epoch, times, circular_orbit(flown).state(times), camera, flown.body.to_fixed(flown.epoch + times),
            self.mount,
        )  # fmt: skip
        timing: LineTiming = one_rate(-half, period)
        return line_image(name, (lines, self.samples), self.interior, timing, trajectory, flown.body.ellipsoid)


@dataclass(frozen=True, slots=True)
class PassErrors:
    """Sigmas of a pass's trajectory error: polynomials of time, s = -1 .. 1 over the pass, of degree 3 at most."""

    position: tuple[float, ...] = (30.0, 10.0)
    """m, of the coefficients of s^0, s^1, ..., along X, Y, Z alike."""
    attitude: tuple[float, ...] = (1.5e-4, 5e-5, 2e-5, 1e-5)
    """rad, the same of rotations about the first camera's axes."""

    @property
    def sigmas(self) -> Array:
        """(4, 6) of all coefficients; a degree that is held has next to none."""
        rows = [[*one, *[_HELD * one[0]] * (SUPPORT - len(one))] for one in (self.position, self.attitude)]
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
        for one in passes:
            nodes = powers(one.nodes) @ np.where(errors.free, errors.sigmas * rng.standard_normal((SUPPORT, 6)), 0.0)
            values.append(nodes)
            for j in one.images.tolist():
                axes = one.axes_of(j)
                own = rotation.exponential(-boresights[j]) @ (np.eye(3) if axes is None else axes)
                turned = np.hstack([nodes[:, :3], nodes[:, 3:] @ own.T])
                corrections.append(strip_correction(one.nodes, turned))
        taken = tuple(
            as_taken(image, InstrumentErrors(camera_boresight=b)) for image, b in zip(images, boresights, strict=True)
        )
        return cls(taken, tuple(corrections), tuple(values))

    def ground(self, image: int, pixels: Array, heights: Array) -> Array:
        """(n, 3) m, where lines and samples (n, 2) of an image meet the ground at heights (n,) above the ellipsoid."""
        one = self.images[image]
        origins, directions = one.sightlines(pixels[:, 0], pixels[:, 1], self.corrections[image])
        return intersect_ellipsoid(origins, directions, one.body, heights)[0]

    def shots(self, image: int, shares: Array, beam: Array, heights: Array) -> tuple[Array, Array, Array]:
        """Laser shots at shares (n,) of an image's lines along a beam (3,) in its axes: true footprints (n, 3) in m at
        heights (n,) above the ellipsoid, times (n,) in s TDB past J2000 and ranges (n,) in m.
        """
        one = self.images[image]
        times = one.trajectory.epoch + one.timing.at(shares * one.lines)[0]
        pose = one.pose(one.timing.lines(times - one.trajectory.epoch), self.corrections[image])  # as float64 has them
        beams = np.einsum("nji,j->ni", pose.matrix, beam)
        places, _, _ = intersect_ellipsoid(pose.position, beams, one.body, heights)
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

    def without_mounting(self) -> Network:
        """The same with mountings as they are stated, without error: the trajectory must take what they lack."""
        return replace(self.network, shared=())

    def __repr__(self) -> str:
        return f"SimulatedRig({self.network!r})"


def given_points(
    names: Iterable[str], classes: Index, known: Mask, places: Array, sigmas: Array, errors: Array
) -> GroundPoints:
    """Points as an adjustment is given them: `known` ones (n,) at their true places (n, 3) and errors (n, 3), east,
    north and up, of these sigmas (n, 3), all in m; the others without a place.
    """
    up = places / np.linalg.norm(places, axis=1)[:, None]
    frames = np.concatenate([east_north(places), up[:, None]], axis=1)
    return GroundPoints(
        Names.of(names), classes,
        np.where(known, int(PointKind.CONSTRAINED), int(PointKind.FREE)),
        np.where(known[:, None], places + np.einsum("nk,nkj->nj", errors, frames), np.nan),
        np.where(known[:, None, None], np.einsum("nk,nki,nkj->nij", sigmas**2, frames, frames), 0.0),
    )  # fmt: skip


def measured(visible: Visible, sigmas: Array, rng: np.random.Generator) -> ImageRays:
    """Rays of what is seen, with noise; `sigmas` (n, images) in px are those of points by image."""
    point, image, exact = visible.ordered()
    sigma = np.repeat(sigmas[point, image][:, None], 2, axis=1)
    return ImageRays(point, image, exact + sigma * rng.standard_normal(exact.shape), sigma)


def seen_twice(visible: Visible, count: int) -> Index:
    """Points of `count` that at least two images show."""
    point, _, _ = visible.ordered()
    return np.flatnonzero(np.bincount(point, minlength=count) >= 2)
