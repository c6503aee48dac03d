"""MOC narrow-angle images: label and SPICE kernels to a PushbroomImage.

Formulas: ISIS MocNarrowAngleCamera, CameraDetectorMap, LineScanCameraDetectorMap; constants: NAIF's instrument kernel
moc20.ti ("ik") or the ISIS addendum mocAddendum004.ti ("iak", which keeps the nominal focal length and widens the
pitch instead: one pixel is then 3.750 microradians, against 3.714).
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import spiceypy

from mgsgraph.errors import InputError, errors_from
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.distortion import NoDistortion
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.io.kernel_contents import spice_words
from mgsgraph.io.kernels import (
    INTERVAL,
    MGS_ATTITUDE_BIAS,
    Constants,
    Correction,
    clock_time,
    ellipsoid,
    fixed_rotation,
    loaded,
    pool_numbers,
    sample_trajectory,
)
from mgsgraph.io.moc_label import MocLabel, read_moc_label
from mgsgraph.units import ISIS_OFFSET, MM

MGS, MGS_SPACECRAFT, MOC_NA = -94, -94000, -94031
"""NAIF ids of the spacecraft, of its structure's frame (CK), and of the narrow angle."""

_METRES_BELOW = 100.0
"""INS-94031_FOCAL_LENGTH is 3.5 (m) in the IK and 3500 (mm) in the addendum, and the later one wins."""
_CLOCK_SLACK = 1.0
"""s by which START_TIME and the clock count may differ; true labels agree within 0.01 s."""


def read_moc(
    label: Path,
    kernels: Sequence[Path],
    name: str | None = None,
    focal_length: float | None = None,
    constants: Constants = "iak",
    attitude_bias: float = MGS_ATTITUDE_BIAS,
    position_bias: float = 0.0,
    interval: float = INTERVAL,
    aberration: Correction = "NONE",
) -> PushbroomImage:
    """Read a narrow-angle image's geometry.

    Parameters
    ----------
    label : Path
        As `read_moc_label` takes it.
    kernels : sequence of Path
        Leapseconds, SCLK, PCK, IK or addendum (with the camera's frame), SPK and CK, or meta-kernels.
    name : str, optional
        By which networks call the image; the product id when absent.
    focal_length : float, optional
        m; that of the kernels when absent.
    constants : "iak" or "ik"
        Where pitch and centre come from.
    attitude_bias, position_bias : float
        s, see `sample_trajectory`.
    interval : float
        s between nodes of the trajectory.
    aberration : "NONE", "LT" or "LT+S"
        of the positions.

    Raises
    ------
    InputError
        As the label's and the kernels' readers; a wide-angle image; camera constants that are not in the kernels.
    """
    said = read_moc_label(label)
    if said.instrument != "MOC-NA":
        raise InputError(
            str(label), f"an image of {said.instrument}", "MOC-NA",
            "the strong distortion of the wide angles is not modelled: use the narrow angle",
        )
    with errors_from(str(label)), loaded(kernels):
        start = _start(said)
        stop = start + said.lines * said.line_period
        trajectory = sample_trajectory(
            MGS, said.target, MGS_SPACECRAFT, fixed_rotation(MGS_SPACECRAFT, MOC_NA), start, stop, interval,
            attitude_bias=attitude_bias, position_bias=position_bias, aberration=aberration,
        )  # fmt: skip
        return PushbroomImage(
            name=name or said.product,
            lines=said.lines,
            samples=said.samples,
            interior=_interior(said, constants, focal_length),
            timing=LineTiming(np.zeros(1), np.array([start - trajectory.epoch]), np.array([said.line_period])),
            trajectory=trajectory,
            body=ellipsoid(said.target),
        )


def _start(label: MocLabel) -> float:
    """Time in s TDB past J2000 of the top edge of the first line: by the clock count, for START_TIME is rounded."""
    start = clock_time(MGS, label.clock_start)
    with spice_words(f"{label.path}, start time {label.start_time}", "load a leapseconds kernel"):
        stated = float(spiceypy.str2et(label.start_time.removesuffix("Z")))
    if abs(stated - start) > _CLOCK_SLACK:
        raise InputError(
            str(label.path), f"clock count {label.clock_start}, which is {start - stated:.3f} s after START_TIME",
            f"the two within {_CLOCK_SLACK:g} s", "check the label, and whether the SCLK kernel is the spacecraft's",
        )
    return start


def _interior(label: MocLabel, constants: Constants, focal_length: float | None) -> InteriorOrientation:
    """Detector pixel of a sample = sample * summing + first; ISIS counts the same pixels half a pixel higher."""
    to_pixel, centre = _addendum() if constants == "iak" else _instrument_kernel()
    if focal_length is None:
        stated = float(pool_numbers(f"INS{MOC_NA}_FOCAL_LENGTH", 1)[0])
        focal_length = stated if stated < _METRES_BELOW else stated * MM
    return InteriorOrientation(
        focal_length=focal_length,
        to_pixel=to_pixel,
        centre=np.array([0.0, centre]),
        first=np.array([0.0, label.first_sample - 1.0]),
        sample_summing=float(label.crosstrack_summing),
        distortion=NoDistortion(),
    )


def _addendum() -> tuple[Array, float]:
    """Affine map from the focal plane (2, 3) and the centre's pixel, by the ISIS addendum: mm, first pixel 1."""
    line, sample = (pool_numbers(f"INS{MOC_NA}_ITRANS{axis}", 3) for axis in "LS")
    to_pixel = np.stack([line, sample])
    to_pixel[:, 1:] /= MM
    return to_pixel, float(pool_numbers(f"INS{MOC_NA}_BORESIGHT_SAMPLE", 1)[0]) - ISIS_OFFSET


def _instrument_kernel() -> tuple[Array, float]:
    """The same by NAIF's instrument kernel: m, first pixel 0."""
    per_metre = 1.0 / float(pool_numbers(f"INS{MOC_NA}_PIXEL_SIZE", 1)[0])
    to_pixel = np.array([[0.0, per_metre, 0.0], [0.0, 0.0, per_metre]])
    return to_pixel, float(pool_numbers(f"INS{MOC_NA}_CENTER", 2)[0]) + 0.5
