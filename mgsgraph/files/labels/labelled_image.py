"""Images by their labels and SPICE kernels, whichever of the cameras that are known here took them.

Positions are geometric, and the body turns as the frame that the kernels associate with it (SPICE `cidfrm`): IAU_MARS
and the like, or MOON_ME where moon_assoc_me.tf is among them, as in ISIS.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import spiceypy

from mgsgraph.errors import InputError, errors_from, require
from mgsgraph.files.cameras.camera import Camera, Keywords, LineScanLabel, LineTimes, LineTimesSource
from mgsgraph.files.cameras.label import read_line_scan_label
from mgsgraph.files.labels.kernels import (
    INTERVAL,
    Constants,
    Correction,
    body_code,
    body_frame,
    ck_frame,
    clock_time,
    ellipsoid,
    fixed_rotation,
    loaded,
    pool_numbers,
    sample_trajectory,
    utc_time,
)
from mgsgraph.files.labels.label_statements import require_own_statements, require_usual_label
from mgsgraph.files.opening import understood
from mgsgraph.files.pvl import read_label
from mgsgraph.geometry import rotation
from mgsgraph.geometry.camera import InteriorOrientation, MocWideAngleDistortion
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.text import listed
from mgsgraph.workers import read_apart

_CLOCK_SLACK, _OF_SECONDS = 0.1, 1.0
"""s by which the label's UTC (one in whole seconds) and its clock count may differ; true labels do by 0.03 s."""
_EARLY = 0.02
"""Share of the image's time by which its last line may end before that."""
_STOP_SLACK = 0.1
"""s by which the last line may end after the label's STOP_TIME says, both counted from its start; true labels need
0.007 s (Kaguya, which give the last line's beginning).
"""


@dataclass(frozen=True, slots=True)
class _Sampling:
    """How kernels are sampled; the same for all images of a pass."""

    focal_length: float | None = None
    constants: Constants = "iak"
    attitude_bias: float | None = None
    position_bias: float = 0.0
    interval: float = INTERVAL
    aberration: Correction = "NONE"


def read_labelled_image(
    label: Path, kernels: Sequence[Path], name: str | None = None, line_times: LineTimesSource = None, **how: Any
) -> PushbroomImage:
    """Read an image's geometry; parameters and errors as of `read_pass_images`."""
    return read_pass_images([label], kernels, [name], [line_times], **how)[0]


def read_pass_images(
    labels: Sequence[Path],
    kernels: Sequence[Path],
    names: Sequence[str | None] = (),
    line_times: Sequence[LineTimesSource] = (),
    **how: Any,
) -> tuple[PushbroomImage, ...]:
    """Read the images that lines behind one lens took in one pass; they share one trajectory record.

    Parameters
    ----------
    labels : sequence of Path
        PDS3 image or its label, or an ISIS cube or its label, of a camera in `files.cameras.label.CAMERAS`.
    kernels : sequence of Path
        Leapseconds, SCLK, PCK, frames, IK and then addendum, SPK and CK, or meta-kernels.
    names : sequence of str or None
        By which networks call the images; product ids when absent.
    line_times : sequence of Path, "mean" or None
        of HRSC (`cameras.label.read_line_times`), one for each label; other labels have their line rate in them.
    focal_length : float, optional
        m; that of the kernels when absent.
    constants : "iak" or "ik"
        Camera constants of the ISIS addendum (or those that spiceinit left in the label of a cube, where the kernels
        have none) or of NAIF's instrument kernel.
    attitude_bias : float, optional
        s, see `sample_trajectory`; that of the camera when absent: -1.15 for MOC, none for the others.
    position_bias : float
        s, see `sample_trajectory`.
    interval : float
        s between nodes of the trajectory.
    aberration : "NONE", "LT" or "LT+S"
        of the positions.

    Raises
    ------
    InputError
        As the readers of labels, line times and kernels; another camera; camera constants that are not in the kernels;
        line times for a camera that needs none.
    """
    sampling = _Sampling(**how)
    require(labels, "pass", "no label", "at least one")
    if len(names or labels) != len(labels) or len(line_times or labels) != len(labels):
        found = f"{len(names)} names and {len(line_times)} line times for {len(labels)} labels"
        raise InputError("pass", found, "one each, or none")
    scans = [
        _with_line_times(read_line_scan_label(label.absolute()), source)
        for label, source in zip(labels, line_times or [None] * len(labels), strict=True)
    ]
    for other in scans[1:]:
        _require_same_camera(scans[0], other)
    home, files = Path.cwd(), [Path(path).absolute() for path in kernels]

    def by_kernels() -> tuple[PushbroomImage, ...]:
        with understood(", ".join(map(str, files)), "sound SPICE kernels", "fetch them again"), loaded(files, home):
            return _sampled(scans, names, sampling)

    rotation.from_matrix(np.eye(3))  # loads what is compiled: once, not in every fork
    with errors_from(*(str(label.path) for label in scans)):
        return read_apart(by_kernels, listed([path.name for path in files]), "SPICE kernels", "fetch them again")


def _sampled(
    scans: Sequence[LineScanLabel], names: Sequence[str | None], how: _Sampling
) -> tuple[PushbroomImage, ...]:
    """Images of labels by the kernels that are loaded; parameters as in `read_pass_images`."""
    camera, target = scans[0].camera, scans[0].target
    constant_sets = [_Constants.of(label, how.constants) for label in scans]
    times = [_line_times(label, constants) for label, constants in zip(scans, constant_sets, strict=True)]
    start, stop = min(when.start for when in times), max(when.stop for when in times)
    structure = ck_frame(_frame(camera))
    mount = fixed_rotation(structure, _frame(camera), start)
    bias = camera.attitude_bias if how.attitude_bias is None else how.attitude_bias
    trajectory = sample_trajectory(
        camera.spacecraft, target, structure, mount, start, stop, how.interval,
        attitude_bias=bias, position_bias=how.position_bias, aberration=how.aberration,
    )  # fmt: skip
    body = ellipsoid(target)
    images = tuple(
        PushbroomImage(
            name=name or label.product,
            lines=label.lines,
            samples=label.samples,
            interior=with_focal_length(constants.interior(label), how.focal_length),
            timing=when.timing(trajectory.epoch),
            trajectory=trajectory,
            body=body,
            remarks=(*_remarks(label, constants), *_short(label, when)),
            mission=camera.mission,
        )
        for label, constants, when, name in zip(scans, constant_sets, times, names or [None] * len(scans), strict=True)
    )
    return tuple(_checked(label, image) for label, image in zip(scans, images, strict=True))


def _checked(label: LineScanLabel, image: PushbroomImage) -> PushbroomImage:
    """The image, after a comparison with its PDS3 label."""
    root = read_label(label.path)
    if "PDS_VERSION_ID" not in root:
        return image
    require_usual_label(root, str(label.path))
    return replace(image, remarks=(*image.remarks, *require_own_statements(root, label, image)))


def _with_line_times(label: LineScanLabel, source: LineTimesSource) -> LineScanLabel:
    if source is None:
        return label
    if label.period > 0.0:
        found = f"line times for {label.camera.name}"
        raise InputError(str(label.path), found, "none: its label has the line rate")
    return replace(label, times=source if source == "mean" else Path(source).absolute())


def _require_same_camera(first: LineScanLabel, other: LineScanLabel) -> None:
    if other.target != first.target:
        raise InputError(str(other.path), f"an image of {other.target}", f"one of {first.target}, as the others")
    if _frame(other.camera) != _frame(first.camera):
        expected = f"one behind the lens of {first.camera.name}, as the others"
        raise InputError(str(other.path), f"an image of {other.camera.name}", expected)


def _frame(camera: Camera) -> int:
    return camera.frame or camera.instrument


def _short(label: LineScanLabel, times: LineTimes) -> Iterator[str]:
    """Where the lines end long before the label's stop time: a part of an image, or a wrong line period."""
    if label.stop and label.period > 0.0:
        early = utc_time(label.stop, f"{label.path}, stop time {label.stop}") - times.stop
        if early > max(_STOP_SLACK, _EARLY * (times.stop - times.start)):
            yield f"its {label.lines} lines end {early:.3f} s before the label's stop time"


def _remarks(label: LineScanLabel, constants: "_Constants") -> tuple[str, ...]:
    """Decisions of the reader that the user may not have meant."""
    remarks = []
    if constants.of_label is not None:
        remarks.append("camera constants of the cube's label, for there is no addendum among the kernels")
    if label.target == "MOON":
        frame = body_frame(body_code(label.target))
        better = "" if frame == "MOON_ME" else (
            ", 80 m or so from MOON_ME, as ISIS has it (moon_assoc_me.tf, moon_080317.tf, moon_pa_de421_1900-2050.bpc)"
        )  # fmt: skip
        remarks.append(f"the Moon turns as {frame}, which the kernels associate with it{better}")
    return tuple(remarks)


# --- camera constants


@dataclass(frozen=True, slots=True)
class _Constants:
    """Camera constants, as `Keywords`: of the kernels that are loaded, or else of the label of a cube."""

    camera: Camera
    which: Constants
    of_label: Keywords | None
    """Taken where the kernels have no addendum."""

    @classmethod
    def of(cls, label: LineScanLabel, which: Constants) -> "_Constants":
        camera = label.camera
        if which == "ik" and camera.instrument_kernel is None:
            found, expected = f"constants = 'ik' for {camera.name}", f"'iak': those of the addendum ({camera.addendum})"
            raise InputError(str(label.path), found, expected)
        own = which == "iak" and not spiceypy.expool(f"INS{label.detector or camera.instrument}_ITRANSL")
        return cls(camera, which, label.keywords if own else None)

    def __contains__(self, name: str) -> bool:
        return name in self.of_label if self.of_label is not None else bool(spiceypy.expool(name))

    def numbers(self, name: str, count: int) -> Array:
        """See `Keywords.numbers`."""
        if self.of_label is not None:
            return self.of_label.numbers(name, count)
        kernel = "the camera's instrument kernel"
        kernel += f" and addendum ({self.camera.addendum})" if self.which == "iak" else ""
        return pool_numbers(name, count, f"load {kernel}", more=True)

    def interior(self, label: LineScanLabel) -> InteriorOrientation:
        """Interior orientation by them."""
        by = self.camera.interior if self.which == "iak" else self.camera.instrument_kernel
        assert by is not None
        return by(self, label)


def with_focal_length(interior: InteriorOrientation, focal_length: float | None) -> InteriorOrientation:
    """The same camera with another focal length in m; as it is where that is None."""
    if focal_length is None:
        return interior
    distortion = interior.distortion
    if isinstance(distortion, MocWideAngleDistortion):  # its polynomial is one of angles
        distortion = replace(distortion, focal_length=focal_length)
    return replace(interior, focal_length=focal_length, distortion=distortion)


# --- times


def _line_times(label: LineScanLabel, keywords: Keywords) -> LineTimes:
    camera = label.camera
    stated = utc_time(label.utc, f"{label.path}, start time {label.utc}") if label.utc else np.nan
    if camera.start_is_utc:
        start = stated
    else:
        start = clock_time(camera.clock or camera.spacecraft, label.start)
        slack = _CLOCK_SLACK if "." in label.utc else _OF_SECONDS
        if abs(stated - start) > slack:
            raise InputError(
                str(label.path), f"clock count {label.start}, which is {start - stated:.3f} s after the label's UTC",
                f"the two within {slack:g} s", "check the label, and that the SCLK kernel is the spacecraft's",
            )  # fmt: skip
    stop = utc_time(label.stop, f"{label.path}, stop time {label.stop}") if label.stop else np.nan
    times = camera.line_times(keywords, label, start, stop)
    over = (times.stop - start) - (stop - stated)  # NaN where the label doesn't say both
    if label.period > 0.0 and over > _STOP_SLACK:
        raise InputError(
            str(label.path), f"{label.lines} lines of {times.periods[0]:.6g} s, {over:.3f} s past the stop time",
            f"an end by {label.stop}", "check the number of lines, the line period and the summing",
        )  # fmt: skip
    return times
