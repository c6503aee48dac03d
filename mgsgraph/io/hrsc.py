"""HRSC images: labels and SPICE kernels to PushbroomImages, the lines of one strip on one trajectory.

All nine lines sit behind one lens in the focal plane of MEX_HRSC_HEAD, +Y along track and +X along the lines, each with
a focal length, an offset along track and a turn of its own: those that look ahead or back are lines of the same camera
at other places, so that position, attitude and their corrections are common to all. Formulas: ISIS HrscCamera,
CameraDetectorMap, CameraFocalPlaneMap; constants: the ISIS addendum hrscAddendum004.ti ("iak") or NAIF's instrument
kernel ("ik", one focal length for all, lines through the outer corners of their first and last pixels; these differ
from the addendum's by 0.4 pixels across track and up to 9 along it).
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import spiceypy

from mgsgraph.errors import InputError, errors_from
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.distortion import NoDistortion
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.io.hrsc_label import DETECTORS, Detector, HrscLabel, read_hrsc_label
from mgsgraph.io.hrsc_lines import LineTimes, LineTimesSource, read_line_times
from mgsgraph.io.kernel_contents import spice_words
from mgsgraph.io.kernels import (
    INTERVAL,
    Constants,
    Correction,
    ellipsoid,
    fixed_rotation,
    loaded,
    pool_numbers,
    sample_trajectory,
)
from mgsgraph.units import ISIS_OFFSET, MM

MEX, MEX_SC_REF, HRSC_HEAD = -41, -41001, -41210
"""NAIF ids of the spacecraft, of its structure's frame (CK), and of the camera that all lines share."""
DETECTOR_IDS: dict[Detector, int] = {name: HRSC_HEAD - 1 - k for k, name in enumerate(DETECTORS)}
"""NAIF ids of the lines."""

_NOMINAL_FOCAL_LENGTH = 175.0
"""mm, of all lines in the instrument kernel; the addendum has 174.61 to 175.23 under the same name."""


def read_hrsc(
    label: Path,
    kernels: Sequence[Path],
    name: str | None = None,
    focal_length: float | None = None,
    constants: Constants = "iak",
    attitude_bias: float = 0.0,
    position_bias: float = 0.0,
    interval: float = INTERVAL,
    aberration: Correction = "NONE",
    line_times: LineTimesSource = None,
) -> PushbroomImage:
    """Read one image's geometry.

    Parameters
    ----------
    label : Path
        As `read_hrsc_label` takes it.
    kernels : sequence of Path
        Leapseconds, SCLK, PCK, frames, IK and then addendum, SPK and CK, or meta-kernels.
    name : str, optional
        By which networks call the image; the product id when absent.
    focal_length : float, optional
        m; that of the kernels when absent.
    constants : "iak" or "ik"
        Where focal length and the line's place come from.
    attitude_bias, position_bias : float
        s, see `sample_trajectory`; none is known for Mars Express.
    interval : float
        s between nodes of the trajectory.
    aberration : "NONE", "LT" or "LT+S"
        of the positions.
    line_times : Path, "mean" or None
        See `read_line_times`.

    Raises
    ------
    InputError
        As the readers of label, line times and kernels; camera constants that are not in the kernels.
    """
    return read_hrsc_strip(
        [label], kernels, [name], focal_length, constants, attitude_bias, position_bias, interval, aberration,
        [line_times],
    )[0]  # fmt: skip


def read_hrsc_strip(
    labels: Sequence[Path],
    kernels: Sequence[Path],
    names: Sequence[str | None] = (),
    focal_length: float | None = None,
    constants: Constants = "iak",
    attitude_bias: float = 0.0,
    position_bias: float = 0.0,
    interval: float = INTERVAL,
    aberration: Correction = "NONE",
    line_times: Sequence[LineTimesSource] = (),
) -> tuple[PushbroomImage, ...]:
    """Read the images that several lines took in one pass; they share one trajectory (the very record).

    Parameters as in `read_hrsc`, where `names` and `line_times` are one for each label, or none at all.
    """
    if not labels:
        raise InputError("HRSC strip", "no label", "at least one")
    if len(names or labels) != len(labels) or len(line_times or labels) != len(labels):
        found = f"{len(names)} names and {len(line_times)} line times for {len(labels)} labels"
        raise InputError("HRSC strip", found, "one each, or none")
    said = [read_hrsc_label(label) for label in labels]
    for other in said[1:]:
        if other.target.upper() != said[0].target.upper():
            raise InputError(str(other.path), f"an image of {other.target}", f"one of {said[0].target}, as the others")
    with errors_from(*map(str, labels)), loaded(kernels):
        sources = line_times or [None] * len(said)
        times = [_line_times(one, source) for one, source in zip(said, sources, strict=True)]
        start, stop = min(one.start for one in times), max(one.stop for one in times)
        mount = fixed_rotation(MEX_SC_REF, HRSC_HEAD, start)
        trajectory = sample_trajectory(
            MEX, said[0].target, MEX_SC_REF, mount, start, stop, interval,
            attitude_bias=attitude_bias, position_bias=position_bias, aberration=aberration,
        )  # fmt: skip
        body = ellipsoid(said[0].target)
        return tuple(
            PushbroomImage(
                name=name or one.product,
                lines=one.lines,
                samples=one.samples,
                interior=_interior(one, constants, focal_length),
                timing=when.timing(trajectory.epoch),
                trajectory=trajectory,
                body=body,
            )
            for one, when, name in zip(said, times, names or [None] * len(said), strict=True)
        )


def _line_times(label: HrscLabel, source: LineTimesSource) -> LineTimes:
    times = []
    for key, utc in (("START_TIME", label.start_time), ("STOP_TIME", label.stop_time)):
        with spice_words(f"{label.path}, {key} {utc}", "write 2008-02-08T12:08:53.843; load a leapseconds kernel"):
            times.append(float(spiceypy.str2et(utc.removesuffix("Z"))))
    return read_line_times(label, times[0], times[1], source)


# --- the lines in the focal plane


def _interior(label: HrscLabel, constants: Constants, focal_length: float | None) -> InteriorOrientation:
    """Active pixel of a sample = sample * macropixel, from the first on, as in ISIS. (SAMPLE_FIRST_PIXEL of the label
    counts otherwise: 80 in h5270, with 5152 pixels to follow, would end beyond the active ones.)
    """
    code = DETECTOR_IDS[label.detector]
    to_pixel, centre, focal = _addendum(code) if constants == "iak" else _instrument_kernel(code)
    return InteriorOrientation(
        focal_length=focal if focal_length is None else focal_length,
        to_pixel=to_pixel,
        centre=centre,
        first=np.zeros(2),
        sample_summing=float(label.macropixel),
        distortion=NoDistortion(),  # INS-41210_OD_K are zeros, and ISIS doesn't ask for them
    )


def _addendum(code: int) -> tuple[Array, Array, float]:
    """Affine map from the focal plane (2, 3), the centre's pixel (line, sample) and the focal length by the ISIS
    addendum: mm, first pixel 1.
    """
    to_pixel = np.stack([pool_numbers(f"INS{code}_ITRANS{axis}", 3) for axis in "LS"])
    to_pixel[:, 1:] /= MM
    focal = float(pool_numbers(f"INS{code}_FOCAL_LENGTH", 1)[0])
    if focal == _NOMINAL_FOCAL_LENGTH:
        found = f"{focal:g} mm, the instrument kernel's"
        raise InputError(
            f"kernels, INS{code}_FOCAL_LENGTH", found, "the addendum's, such as 174.8",
            "name the addendum after the instrument kernel (or take constants = 'ik')",
        )  # fmt: skip
    line, sample = (float(pool_numbers(f"INS{code}_BORESIGHT_{axis}", 1)[0]) for axis in ("LINE", "SAMPLE"))
    return to_pixel, np.array([line, sample - ISIS_OFFSET]), focal * MM


def _instrument_kernel(code: int) -> tuple[Array, Array, float]:
    """The same by NAIF's instrument kernel: the line's outer corners in the focal plane, mm."""
    corners = pool_numbers(f"INS{code}_FOV_BOUNDARY_CORNERS", 12).reshape(4, 3) * MM
    first, last = corners[:2, :2].mean(axis=0), corners[2:, :2].mean(axis=0)
    along = (last - first) / float(pool_numbers(f"INS{code}_PIXEL_SAMPLES", 1)[0])
    across = np.array([along[1], -along[0]])  # towards +Y, as +X is towards the first pixel
    turn: Array = np.linalg.inv(np.column_stack([across, along])).astype(np.float64)
    return np.column_stack([-turn @ first, turn]), np.zeros(2), float(corners[0, 2])
