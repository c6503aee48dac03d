"""Instruments that are not as their kernels say: a camera with a late clock, a boresight or a focal length of its own.

Truth is made by shifting times and turning frames themselves, never by the adjustment's linear directions.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.geometry.trajectory import Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class InstrumentErrors:
    """What is wrong with all images of a camera and with the altimeter beside it; true = nominal (+) these."""

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


def as_it_was(image: PushbroomImage, errors: InstrumentErrors) -> PushbroomImage:
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


def misplaced(image: PushbroomImage, times: Array, points: Array, errors: InstrumentErrors) -> Array:
    """(n, 3) m: where true footprints (n, 3) of shots at times (n,), s past the epoch, are believed to be: at the end
    of a beam without the altimeter's own rotation.
    """
    pose = image.trajectory.pose(times)
    back = rotation.exponential(errors.altimeter_boresight).T
    beams = np.einsum("nij,nj->ni", pose.matrix, points - pose.position) @ back.T
    return np.asarray(pose.position + np.einsum("nji,nj->ni", pose.matrix, beams))
