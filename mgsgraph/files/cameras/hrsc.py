"""High Resolution Stereo Camera (HRSC) of Mars Express, its nine lines.

All nine lines sit behind one lens in the focal plane of MEX_HRSC_HEAD, +Y along track and +X along the lines, each with
a focal length, an offset along track and a turn of its own: those that look ahead or back are lines of the same camera
at other places, so that position, attitude and their corrections are common to all. Formulas: ISIS HrscCamera,
CameraDetectorMap, CameraFocalPlaneMap; keywords: ISIS hrsc2isis and its translation tables. Constants: the ISIS
addendum hrscAddendum004.ti, or NAIF's instrument kernel (one focal length for all, lines through the outer corners of
their first and last pixels; these differ from the addendum's by 0.4 pixels across track and up to 9 along it).

SPACECRAFT_CLOCK_START_COUNT and ..._STOP_COUNT are not read: those of h5270_0000_ir2 lie 7 s before START_TIME and 64 s
after STOP_TIME, and so belong to something longer than the image.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.cameras.camera import (
    Camera,
    Keywords,
    LabelBlock,
    LabelKeys,
    LineScanLabel,
    interior_by_addendum,
    number,
    pds3_keys,
    require_summing,
)
from mgsgraph.files.cameras.hrsc_lines import read_line_times
from mgsgraph.files.cameras.line_times import LineTimes, LineTimesLocation
from mgsgraph.files.labels.image_label import bytes_around, cube_of, cube_size, data_location
from mgsgraph.files.pvl import Block
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.distortion import NoDistortion
from mgsgraph.units import MM

DETECTORS = ("S2", "RED", "P2", "BLUE", "NADIR", "GREEN", "P1", "IR", "S1")
"""The nine lines in the order of their NAIF ids, from -41211 to -41219; those that look ahead come last."""
MEX, HRSC_HEAD = -41, -41210
"""NAIF ids of the spacecraft, and of the camera that all lines share."""
_MACROPIXELS = (1, 2, 4, 8)
_NOMINAL_FOCAL_LENGTH = 175.0
"""mm, of all lines in the instrument kernel; the addendum has 174.61 to 175.23 under the same name."""
_PROJECTED_LEVEL = 3
"""PROCESSING_LEVEL_ID from which on images are maps."""
_TIME_BYTES = 12
"""At the head of a line's prefix: its time and exposure."""
_TIMES_TABLE = "linescantimes"
_TIMES_FIELDS = [("ephemeristime", "double"), ("exposuretime", "double"), ("linestart", "integer")]
_TIMES_RECORD = 20
"""bytes."""


# --- labels


def _facts(block: LabelBlock, label: LineScanLabel) -> LineScanLabel:
    """Macropixels, and where the times of the lines are. (SAMPLE_FIRST_PIXEL counts otherwise than ISIS does: 80 in
    h5270, with 5152 pixels to follow, would end beyond the active ones.)
    """
    if block.kind == "isis":
        cube = cube_of(block.root)
        assert cube is not None
        cube_size(cube)  # whole, and no map: a part begins at another line than its table of times
        return replace(label, times=_table(label.path, block.root), sample_summing=block.number("Summing"))
    level = block.number("PROCESSING_LEVEL_ID") if "PROCESSING_LEVEL_ID" in block else 0.0
    if level >= _PROJECTED_LEVEL:
        found = f"a map (level {level:g})"
        raise InputError(block.where("PROCESSING_LEVEL_ID"), found, "an image of level 2 or below")
    macropixel = block.number("MACROPIXEL_SIZE") if "MACROPIXEL_SIZE" in block else 1.0
    return replace(label, times=_prefixes(label, block.root), sample_summing=macropixel)


def _prefixes(label: LineScanLabel, root: Block) -> LineTimesLocation | None:
    """Where the prefixes are; None where there are none, or not all of them."""
    image = root.inner("IMAGE")
    prefix, suffix = bytes_around(image)
    if prefix < _TIME_BYTES:
        return None
    stride = prefix + label.samples * (image.count("SAMPLE_BITS") // 8) + suffix
    file, offset = data_location(label.path, root)
    if file.stat().st_size < offset + label.lines * stride:
        return None
    return LineTimesLocation(file, "prefixes", offset, label.lines, stride)


def _table(path: Path, root: Block) -> LineTimesLocation | None:
    """Where the table is; None where the cube has none, or the file ends before it (a label cut off its cube)."""
    for block in root.blocks:
        if block.name == "table" and block.text("Name").lower() == _TIMES_TABLE:
            fields = [(one.text("Name").lower(), one.text("Type").lower()) for one in block.blocks]
            if fields != _TIMES_FIELDS or block.text("ByteOrder").upper() != "LSB":
                raise InputError(
                    block.where(), f"the fields {', '.join(' '.join(one) for one in fields)}",
                    "EphemerisTime, ExposureTime (Double) and LineStart (Integer), ByteOrder = Lsb",
                )  # fmt: skip
            offset, count = block.count("StartByte") - 1, block.count("Records")
            if path.stat().st_size < offset + count * _TIMES_RECORD:
                return None
            return LineTimesLocation(path, "table", offset, count, _TIMES_RECORD)
    return None


def _line_times(keywords: Keywords, label: LineScanLabel, start: float, stop: float) -> LineTimes:
    return read_line_times(label.times, label.lines, start, stop, str(label.path))


# --- the lines in the focal plane


def _require_macropixel(label: LineScanLabel) -> None:
    if label.sample_summing not in _MACROPIXELS:
        expected = ", ".join(map(str, _MACROPIXELS))
        raise InputError(str(label.path), f"macropixels of {label.sample_summing:g}", f"one of {expected}")
    require_summing(label)


def _interior(keywords: Keywords, label: LineScanLabel) -> InteriorOrientation:
    _require_macropixel(label)
    interior = interior_by_addendum(keywords, label, NoDistortion())  # OD_K are zeros, and ISIS doesn't ask for them
    name = f"INS{label.camera.instrument}_FOCAL_LENGTH"
    if (focal := number(keywords, name)) == _NOMINAL_FOCAL_LENGTH:
        raise InputError(
            f"kernels, {name}", f"{focal:g} mm, the instrument kernel's", "the addendum's, such as 174.8",
            "name the addendum after the instrument kernel (or take constants = 'ik')",
        )  # fmt: skip
    return interior


def _by_instrument_kernel(keywords: Keywords, label: LineScanLabel) -> InteriorOrientation:
    """The line's outer corners in the focal plane, mm."""
    _require_macropixel(label)
    code = label.camera.instrument
    corners = keywords.numbers(f"INS{code}_FOV_BOUNDARY_CORNERS", 12).reshape(4, 3) * MM
    first, last = corners[:2, :2].mean(axis=0), corners[2:, :2].mean(axis=0)
    along = (last - first) / number(keywords, f"INS{code}_PIXEL_SAMPLES")
    across = np.array([along[1], -along[0]])  # towards +Y, as +X is towards the first pixel
    turn = np.linalg.inv(np.column_stack([across, along]))
    return InteriorOrientation(
        focal_length=float(corners[0, 2]),
        to_pixel=np.column_stack([-turn @ first, turn]),
        centre=np.zeros(2),
        first=np.zeros(2),
        sample_summing=label.sample_summing,
        distortion=NoDistortion(),
    )


HRSC = tuple(
    Camera(
        name=f"MEX HRSC {name}", mission="MEX", spacecraft=MEX, instrument=HRSC_HEAD - 1 - k, frame=HRSC_HEAD,
        isis=LabelKeys(
            {"InstrumentId": "HRSC", "DetectorId": f"MEX_HRSC_{name}"},
            ("SpacecraftClockStartCount", "InstrumentId", "DetectorId"), start="StartTime", stop="StopTime",
        ),
        pds3=pds3_keys(
            {"INSTRUMENT_ID": "HRSC", "DETECTOR_ID": f"MEX_HRSC_{name}"},
            ("SPACECRAFT_CLOCK_START_COUNT", "INSTRUMENT_ID", "DETECTOR_ID"), start="START_TIME", period="",
        ),
        interior=_interior, instrument_kernel=_by_instrument_kernel, line_times=_line_times, label_facts=_facts,
        start_is_utc=True, addendum="hrscAddendum004.ti", source="ISIS HrscCamera", pixels=5184,
        summing=_MACROPIXELS[-1],
    )
    for k, name in enumerate(DETECTORS)
)  # fmt: skip
