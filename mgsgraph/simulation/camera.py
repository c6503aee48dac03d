"""The simulated line camera, MOC, and errors of an instrument: clock, boresight, focal length.

It has no distortion. Narrow-angle images of pair and strip have the numbers of MOC-NA's design, those of the study
sites ISIS' calibrated ones.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.camera import InteriorOrientation, NoDistortion
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.simulation.orbit import MARS, CircularPass, tilted_trajectory
from mgsgraph.simulation.sites import ImageSettings
from mgsgraph.units import MM

FOCAL_LENGTH_MM, PITCH_MM, BORESIGHT_SAMPLE = 3500.0, 0.0131240578522949, 1024.5
"""MOC-NA as ISIS knows it (mocAddendum004.ti): mm, mm, and detector sample counted from 1 at the pixel's centre."""

_NARROW_FOCAL_LENGTH, _NARROW_PITCH, _NARROW_SUMMING = 3.5, 13e-6, 2.0
"""m, m, and detector pixels per sample: MOC-NA (Malin et al. 1992), crosstrack summing of its 1024-sample images."""


def interior_orientation(
    focal_length: float, pitch: float, centre: float, first: float = 0.0, summing: float = 1.0
) -> InteriorOrientation:
    """A single straight line of detectors: focal length and pixel pitch in m; detector samples of the principal point
    and of the image's first pixel; detector pixels per sample.
    """
    return InteriorOrientation(
        focal_length=focal_length,
        to_pixel=np.array([[0.0, 1.0 / pitch, 0.0], [0.0, 0.0, 1.0 / pitch]]),
        centre=np.array([0.0, centre]),
        first=np.array([0.0, first]),
        sample_summing=summing,
        distortion=NoDistortion(),
    )


def line_image(
    name: str,
    size: tuple[int, int],
    interior: InteriorOrientation,
    timing: LineTiming,
    trajectory: Trajectory,
    body: Ellipsoid = MARS,
) -> PushbroomImage:
    """Image of (lines, samples)."""
    return PushbroomImage(
        name=name, lines=size[0], samples=size[1], interior=interior, timing=timing, trajectory=trajectory, body=body
    )


def one_rate(start: float, period: float) -> LineTiming:
    """Lines of one period, in s; the image's upper edge is taken at `start`, s past the trajectory's epoch."""
    return LineTiming(np.zeros(1), np.array([start]), np.array([period]))


def narrow_image(name: str, flown: CircularPass, lines: int, samples: int, period: float) -> PushbroomImage:
    """Nominal image of a camera like MOC-NA on a circle, its middle line at the epoch; `period` in s per line."""
    half, middle = 0.5 * lines * period, 0.5 * _NARROW_SUMMING * samples
    interior = interior_orientation(_NARROW_FOCAL_LENGTH, _NARROW_PITCH, middle, summing=_NARROW_SUMMING)
    return line_image(name, (lines, samples), interior, one_rate(-half, period), tilted_trajectory(flown, half))


def moc_image(settings: ImageSettings, trajectory: Trajectory, start: float) -> PushbroomImage:
    """MOC-NA image of a study site; `start` in s past the trajectory's epoch is the time of its upper edge."""
    interior = interior_orientation(
        FOCAL_LENGTH_MM * MM, PITCH_MM * MM, BORESIGHT_SAMPLE - 0.5, float(settings.edit_mode),
        float(settings.crosstrack_summing),
    )  # fmt: skip
    size = settings.lines, settings.samples
    return line_image(settings.name, size, interior, one_rate(start, settings.period), trajectory)


# --- instruments that are not as their kernels say


@dataclass(frozen=True, slots=True, eq=False)
class InstrumentErrors:
    """Errors of all images of a camera and of the altimeter beside it; true = nominal (+) these.

    Truth is made by shifting times and turning frames themselves, never by the adjustment's linear directions.
    """

    attitude_time: float = 0.0
    """s: true attitude at t is the nominal one of t + this."""
    position_time: float = 0.0
    """s: true position at t is the nominal one of t + this."""
    camera_boresight: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) rad, rotation vector about the camera's axes by which it is turned."""
    altimeter_boresight: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) rad, the same of the laser's beam: given footprints lie where a beam without it would have met."""
    range_bias: float = 0.0
    """m, by which measured ranges are too long."""
    focal_length: float = 0.0
    """m, true minus nominal."""

    def __post_init__(self) -> None:
        for name in ("camera_boresight", "altimeter_boresight"):
            assign(self, **{name: frozen(getattr(self, name), f"instrument errors, {name}", (3,))})
        for name in ("attitude_time", "position_time", "range_bias", "focal_length"):
            if not np.isfinite(getattr(self, name)):
                raise InputError(f"instrument errors, {name}", f"{getattr(self, name)}", "a number")


def as_taken(image: PushbroomImage, errors: InstrumentErrors) -> PushbroomImage:
    """The image as its camera truly took it: what a table held at t + bias is true at t.

    Raises
    ------
    InputError
        For an image whose orientation is not sampled, or whose tables end within a bias of its edges.
    """
    nominal = image.trajectory
    if not isinstance(nominal, Trajectory):
        raise InputError(f"image {image.name}", "an orientation that isn't sampled", "tables of position and attitude")
    turned = rotation.exponential(errors.camera_boresight).T @ nominal.camera.constant
    camera = replace(nominal.camera, times=nominal.camera.times - errors.attitude_time, constant=turned)
    position = replace(nominal.position, times=nominal.position.times - errors.position_time)
    focal_length = image.interior.focal_length + errors.focal_length
    return replace(
        image,
        interior=replace(image.interior, focal_length=focal_length),
        trajectory=replace(nominal, camera=camera, position=position),
    )


def displaced_footprints(image: PushbroomImage, times: Array, points: Array, errors: InstrumentErrors) -> Array:
    """Where true footprints (n, 3) in m of shots at times (n,), s past the image's epoch, are believed to be: (n, 3) m,
    at the end of a beam without the altimeter's own rotation.
    """
    pose = image.trajectory.pose(times)
    back = rotation.exponential(errors.altimeter_boresight).T
    beams = np.einsum("nij,nj->ni", pose.matrix, points - pose.position) @ back.T
    return np.asarray(pose.position + np.einsum("nji,nj->ni", pose.matrix, beams))
