"""Unknowns that several images share (a clock's error, a boresight, a bias), and what each does to an observation.

What one does to an image is a small change of its pose, proportional to the unknown: a *polynomial of the line* like
the image's own orientation correction, so that the two add up to one correction (`Solution.correction`). An
attitude-time bias turns the camera by its inertial angular velocity (from the sampled attitude: the noise of a CK's
records is smoothed out); a position-time bias moves it by its inertial velocity. The body goes on turning by its own
clock, so both together are a shift of the lines' times except for that: some 240 m/s times the cosine of the latitude
on Mars. A line rate scales the lines' times about the image's middle, so that the camera is where it is at another
time, the body turned by as much. A lever arm moves an instrument along the camera's axes: the camera for image rays,
the laser for ranges, which are not felt by one another.
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import cache

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import Angles, Moments, Sine
from mgsgraph.geometry.records import Array, Index, assign, frozen, frozen_index, no_rows
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.record import Record
from mgsgraph.units import ARCSEC, PPM

DEGREE = 5
"""Of the polynomials: the velocity of an orbit's arc of 20 deg is one to 2e-9, of 60 deg to 1e-6."""
_PLACES = 31
"""Evenly spread lines to which they are fitted, first and last among them."""
_MISFIT = 1e-3
"""Share of its largest value that a polynomial may be off; not of angular velocities, which carry the CK's noise."""
_NO_DRIFT = 1e-3
"""m, sigma of a profile's drift that is none."""
_NO_CHANGE = 1e-5
"""Of the amplitude's sigma, that of a vibration's drift that is none."""


_SINES = " ".join(f"{axis}-{part}" for axis in "xyz" for part in ("cos", "sin", "drift-cos", "drift-sin"))


class SharedKind(StrEnum):
    """What an unknown is.

    Examples
    --------
    >>> from mgsgraph.network import SharedKind
    >>> bias = SharedKind("range bias")
    >>> bias.unit, bias.width, bias.acts_on_ranges
    ('m', 1, True)
    """

    ATTITUDE_TIME = "attitude-time bias", "s", "", "pose rays"
    """s: attitude at time t is the nominal one of t + bias."""
    POSITION_TIME = "position-time bias", "s", "", "pose rays ranges"
    """s: position at time t is the nominal one of t + bias; of the ranges, too."""
    CAMERA_BORESIGHT = "camera boresight", "rad", "x y z", "pose rays"
    """rad: a small rotation of the camera about its own axes x, y, z."""
    ALTIMETER_BORESIGHT = "altimeter boresight", "rad", "x y z", "footprints"
    """rad: a small rotation of the laser's beam about the camera's axes; moves a-priori footprints."""
    RANGE_BIAS = "range bias", "m", "", "ranges"
    """m: what measured ranges are too long."""
    FOCAL_LENGTH = "focal length", "m", "", "interior rays"
    """m: to be added to the nominal one."""
    PRINCIPAL_POINT = "principal point", "m", "x y", "interior rays"
    """m: where the optical axis meets the focal plane farther along the camera's x and y."""
    RADIAL_DISTORTION_1 = "radial distortion k1", "m", "", "interior rays"
    """m: what ideal places at the reference radius lie farther outward, and in proportion to the radius's cube."""
    RADIAL_DISTORTION_2 = "radial distortion k2", "m", "", "interior rays"
    """m: the same in proportion to its fifth power."""
    RADIAL_DISTORTION_3 = "radial distortion k3", "m", "", "interior rays"
    """m: the same in proportion to its seventh power."""
    ORBIT_POSITION = "orbit position", "m", "radial along across", "pose rays ranges"
    """m: what images are farther out, along their flight and to its left than their orbits say; of the ranges, too."""
    LINE_RATE = "line rate", "", "", "pose rays"
    """Ratio: by what share the line period is longer than the nominal one, about the image's middle line."""
    CAMERA_LEVER_ARM = "camera lever arm", "m", "x y z", "pose rays"
    """m: where the camera is farther along its own axes x, y, z than the trajectory says; not of the ranges."""
    ALTIMETER_LEVER_ARM = "altimeter lever arm", "m", "x y z", "ranges footprints"
    """m: where the laser is farther along the camera's axes x, y, z; moves a-priori footprints as much."""
    PROFILE_HEIGHT = "profile height", "m", "middle drift", "profile footprints"
    """m: what the shots of a laser profile are too low, in its middle, and how much more at its end (drift)."""
    PROFILE_DRIFT = "profile drift", "m", "east north", "profile footprints"
    """m: what is to be added east and north to the shots at a laser profile's end, taken off at its beginning."""
    VIBRATION = "vibration", "rad", _SINES, "pose rays"
    """rad: of a rotation about the axes of a pass (as its orientation images have it), the amounts of cosine and sine
    at one frequency, and how much more these are at the end of the pass."""

    unit: str
    """Unit of its values; empty for a ratio."""
    components: tuple[str, ...]
    """Names of its columns; one empty name where there is but one."""
    width: int
    """Number of columns."""
    moves_pose: bool
    """Whether it changes where the camera is or how it stands."""
    is_interior: bool
    """Whether it is of the camera's interior orientation (`network.corrections`)."""
    acts_on_rays: bool
    """Whether it acts on image rays."""
    acts_on_ranges: bool
    """Whether it acts on laser ranges: they begin where the camera is, and know nothing of attitude."""
    moves_footprints: bool
    """Whether it moves a-priori positions of laser footprints."""
    of_profile: bool
    """Whether it is of a laser profile, and of no images."""

    def __new__(cls, name: str, unit: str = "", components: str = "", effects: str = "") -> "SharedKind":
        """A kind by its name, unit, components and what it acts on, in words."""
        kind = str.__new__(cls, name)
        kind._value_, kind.unit, kind.components = name, unit, tuple(components.split()) or ("",)
        kind.width, kind.moves_pose, kind.is_interior = len(kind.components), "pose" in effects, "interior" in effects
        kind.acts_on_rays, kind.acts_on_ranges = "rays" in effects, "ranges" in effects
        kind.moves_footprints, kind.of_profile = "footprints" in effects, "profile" in effects
        return kind

    @property
    def reported(self) -> tuple[float, str]:
        """One unit of reports in `unit`, and its name."""
        return {"rad": (ARCSEC, "arcsec"), "" : (PPM, "ppm")}.get(self.unit, (1.0, self.unit))

    @property
    def radial_order(self) -> int:
        """1, 2 or 3 for k1, k2, k3 of a radial distortion; else 0."""
        return int(self[-1]) if self.startswith("radial distortion") else 0

    @property
    def moves_instrument(self) -> bool:
        """Whether it acts by where the camera of rays, or the laser of ranges, is or how it stands (`image_effect`)."""
        return self.moves_pose or self is SharedKind.ALTIMETER_LEVER_ARM

    @property
    def of_laser(self) -> bool:
        """Whether it acts on laser rows alone."""
        return not self.acts_on_rays


@dataclass(frozen=True, slots=True, eq=False)
class SharedUnknown(Record):
    """One unknown that several images share: of a camera, an orbit, an altimeter.

    Examples
    --------
    >>> from mgsgraph.network import SharedKind, SharedUnknown
    >>> clock = SharedUnknown("clock", SharedKind.ATTITUDE_TIME, np.array([0, 1]), np.array([0.1]))
    >>> print(clock)
    SharedUnknown(name='clock', kind=<SharedKind.ATTITUDE_TIME: 'attitude-time bias'>, images=[0, 1], sigmas=[0.1],
    profile='', sine=None)
    """

    name: str
    """What to call it in reports, each once."""
    kind: SharedKind
    """What it is."""
    images: Index
    """(m,) images that share it, each once; none of what is of a profile."""
    sigmas: Array
    """(w,) a-priori, about zero, in the unit of its kind; finite."""
    profile: str = ""
    """Laser profile (`ProfileShifts.names`) whose height or drift it is."""
    sine: Sine | None = None
    """Of a vibration its frequency, and the time of its pass."""

    def __post_init__(self) -> None:
        where = f"shared unknown {self.name!r}"
        require(self.name, "shared unknown", "an empty name", "what to call it")
        if (self.sine is None) == (self.kind is SharedKind.VIBRATION):
            raise InputError(where, f"{self.kind}, sine {self.sine}", "a sine of a vibration alone")
        images = frozen_index(self.images, f"{where}, images", np.size(self.images), 2**31)
        of_profile = self.kind.of_profile
        if bool(self.profile) != of_profile:
            raise InputError(where, f"profile {self.profile!r}", "a profile for a profile's height or drift alone")
        if (images.size == 0) != of_profile or np.unique(images).size != images.size:
            raise InputError(f"{where}, images", f"{images.tolist()[:10]}", "at least one image, each once")
        sigmas = frozen(self.sigmas, f"{where}, sigmas", (self.kind.width,))
        require(sigmas.min() > 0.0, f"{where}, sigmas", f"{sigmas.min()} {self.kind.unit}", "positive sigmas")
        assign(self, images=images, sigmas=sigmas)

    @classmethod
    def of_height(cls, profile: str, middle: float, drift: float | None = None) -> "SharedUnknown":
        """Height of a profile with a-priori sigmas of its middle and its drift in m; no drift when None."""
        sigmas, none = np.array([middle, drift or _NO_DRIFT]), no_rows()
        return cls(f"height of {profile}", SharedKind.PROFILE_HEIGHT, none, sigmas, profile)

    @classmethod
    def of_drift(cls, profile: str, sigma: float) -> "SharedUnknown":
        """How much a profile's horizontal shift grows from its middle to its end, with an a-priori sigma in m."""
        none = no_rows()
        return cls(f"drift of {profile}", SharedKind.PROFILE_DRIFT, none, np.full(2, sigma), profile)

    @classmethod
    def of_vibration(
        cls, name: str, images: Index, sine: Sine, amplitudes: Array, drift: float = 0.0
    ) -> "SharedUnknown":
        """A vibration with a-priori sigmas (3,) in rad of its cosine and its sine about x, y, z; those of their change
        up to the end of the pass are by a factor `drift` as large.
        """
        each = np.array([1.0, 1.0, *[max(drift, _NO_CHANGE)] * 2])
        return cls(name, SharedKind.VIBRATION, images, np.outer(amplitudes, each).ravel(), sine=sine)

    def of(self, image: int) -> bool:
        """Whether an image shares it."""
        return bool(np.any(self.images == image))

    def waves(self, moments: Moments) -> tuple[Array, Array]:
        """What a unit of a vibration does to the correction of its pass: (n, width, 6) rad, and per line."""
        assert self.sine is not None
        values, rates = self.sine.at(moments.times, moments.epoch)
        ways = (np.einsum("nk,ab->nakb", part, np.eye(3, 6, 3)) for part in (values, rates * moments.periods[:, None]))
        value, rate = (part.reshape(len(values), self.kind.width, 6) for part in ways)
        return value, rate


def image_effect(image: PushbroomImage, kind: SharedKind, angles: Angles) -> Array:
    """What a unit of an unknown that moves an instrument does to an image's orientation correction (of the laser, to
    the place where its ranges begin); of a vibration, which is no polynomial, what it does at most.

    Parameters
    ----------
    image : PushbroomImage
        With its nominal orientation.
    kind : SharedKind
        One that `moves_instrument`.
    angles : Angles
        What the rotation part of corrections is.

    Returns
    -------
    (kind.width, DEGREE + 1, 6)
        Coefficients of u^0, u^1, ... in m and rad per s, rad, m or 1 of the unknown.

    Raises
    ------
    InputError
        For a time bias or an orbit's position, where the nominal orientation doesn't say how the body turns; where the
        image is so long that no polynomial describes the effect.
    """
    lines = np.linspace(0.0, float(image.lines), _PLACES)
    pose = image.pose(lines)
    effect = np.zeros((kind.width, _PLACES, 6))
    if kind in (SharedKind.CAMERA_BORESIGHT, SharedKind.VIBRATION):
        for column in range(kind.width):
            effect[column, :, 3 + 3 * column // kind.width] = 1.0
    elif kind.endswith("lever arm"):
        effect[:, :, :3] = np.swapaxes(pose.matrix, 0, 1)
    elif kind is SharedKind.LINE_RATE:
        later = _past_middle(image, lines)
        effect[0] = np.hstack([pose.velocity, pose.angular_rate]) * later[:, None]
    else:
        period, spin = image.timing.at(lines)[1][:, None], _spin(image)
        velocity = pose.velocity / period + np.cross(spin, pose.position)
        if kind is SharedKind.ATTITUDE_TIME:
            effect[0, :, 3:] = pose.angular_rate / period + pose.matrix @ spin
        elif kind is SharedKind.POSITION_TIME:
            effect[0, :, :3] = velocity
        else:
            effect[:, :, :3] = _flight_axes(pose.position, velocity)
    if angles != "camera":
        effect[:, :, 3:] = [_added_angles(pose, angles, turned) for turned in effect[:, :, 3:]]
    return _fitted(image, kind, image.normalised(lines), effect)


def _past_middle(image: PushbroomImage, lines: Array) -> Array:
    """(n,) lines by which a line period that is twice as long makes lines (n,) later."""
    times, periods = image.timing.at(lines)
    return np.asarray((times - image.timing.at(image.middle[0])[0]) / periods)


def _flight_axes(positions: Array, velocities: Array) -> Array:
    """(3, n, 3) unit vectors at positions (n, 3): outward, along inertial velocities (n, 3), and along the orbit's
    normal, to the flight's left.
    """
    outward, normal = positions, np.cross(positions, velocities)
    axes = np.stack([outward, np.cross(normal, outward), normal])
    return unit_vectors(axes)


def _spin(image: PushbroomImage) -> Array:
    """(3,) rad/s, body-fixed."""
    spin = image.trajectory.spin
    if spin is None:
        raise InputError(
            f"image {image.name}", "a nominal orientation that doesn't say how fast the body turns",
            "one read from support data or kernels, for a time bias or an orbit's position", "adjust the case again",
        )
    return spin


def _added_angles(pose: Pose, angles: Angles, turned: Array) -> Array:
    """(n, 3) rad added to omega, phi, kappa by small rotations (n, 3) about the camera axes."""
    paper = angles == "opk-paper"
    nominal = rotation.omega_phi_kappa(pose.matrix if paper else pose.matrix.mT)
    return np.asarray(np.linalg.solve(rotation.angle_axes(nominal, paper), turned[:, :, None])[:, :, 0])


def _fitted(image: PushbroomImage, kind: SharedKind, u: Array, effect: Array) -> Array:
    """Coefficients (c, DEGREE + 1, 6) of values (c, n, 6) at u (n,), by least squares in Legendre's basis."""
    basis = np.polynomial.legendre.legvander(u, DEGREE)
    values = np.moveaxis(effect, 1, 0).reshape(u.size, -1)
    fitted = np.linalg.lstsq(basis, values, rcond=None)[0]
    off, largest = np.abs(basis @ fitted - values).max(), np.abs(values).max(initial=0.0)
    if kind is not SharedKind.ATTITUDE_TIME and off > _MISFIT * largest:
        raise InputError(
            f"image {image.name}, {kind}", f"an effect that no polynomial of degree {DEGREE} describes",
            "a shorter image", "leave this image out of it",
        )
    plain = _powers_of_legendre() @ fitted
    return np.moveaxis(plain.reshape(DEGREE + 1, effect.shape[0], 6), 1, 0)


@cache
def _powers_of_legendre() -> Array:
    """(DEGREE + 1, DEGREE + 1) coefficients of u^0, u^1, ... of Legendre's polynomials, a column each."""
    columns = [np.polynomial.legendre.leg2poly(row) for row in np.eye(DEGREE + 1)]
    return np.stack([np.pad(column, (0, DEGREE + 1 - column.size)) for column in columns], axis=1)


def beam_motion(image: PushbroomImage, times: Array, footprints: Array) -> Array:
    """(n, 3, 3) m per rad: how far a footprint moves when the laser's beam turns about the camera's axis x, y or z.

    Parameters
    ----------
    image : PushbroomImage
        Whose camera the laser flies with.
    times : (n,)
        s past its trajectory's epoch, of the shots.
    footprints : (n, 3)
        m, body-fixed.
    """
    pose = image.trajectory.pose(times)
    return np.cross(pose.matrix, (footprints - pose.position)[:, None])


def off_nadir(image: PushbroomImage, times: Array, footprints: Array) -> Array:
    """(n,) rad by which the laser's beam is off the vertical (from the body's centre) at the footprint; arguments as of
    `beam_motion`.
    """
    arm = footprints - image.trajectory.pose(times).position
    sizes = np.linalg.norm(arm, axis=1) * np.linalg.norm(footprints, axis=1)
    return np.asarray(np.arccos(np.clip(-np.einsum("nc,nc->n", arm, footprints) / sizes, -1.0, 1.0)))


def ground_shift(image: PushbroomImage, kind: SharedKind) -> Array:
    """(kind.width, 3) m per s, rad, m or 1: how far the ground moves that the middle of an image shows (or, by the
    altimeter's boresight, a footprint there), level with the ellipsoid.
    """
    line, sample = image.middle
    place, _ = image.image_to_ground(line, sample)
    pose = image.pose(line)
    arm, up = place - pose.position, place[0] / np.array([image.body.equatorial] * 2 + [image.body.polar]) ** 2
    if kind is SharedKind.ALTIMETER_BORESIGHT:
        moved = np.cross(pose.matrix[0], arm)
    elif kind is SharedKind.ALTIMETER_LEVER_ARM:
        moved = pose.matrix[0]
    else:
        effect = image_effect(image, kind, "camera")[:, 0]
        moved = effect[:, :3] + np.cross(effect[:, 3:] @ pose.matrix[0], arm)
    return np.asarray(moved - arm * (moved @ up)[:, None] / (arm @ up)[:, None])
