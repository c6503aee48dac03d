"""Labels of line-scan images, of ISIS cubes and of the archives, read by what their camera's record says.

High Resolution Stereo Camera (HRSC) of Mars Express, its nine lines.

All nine lines sit behind one lens in the focal plane of MEX_HRSC_HEAD, +Y along track and +X along the lines, each with
a focal length, an offset along track and a turn of its own: those that look ahead or back are lines of the same camera
at other places, so that position, attitude and their corrections are common to all. Formulas: ISIS HrscCamera,
CameraDetectorMap, CameraFocalPlaneMap; keywords: ISIS hrsc2isis and its translation tables. Constants: the ISIS
addendum hrscAddendum004.ti, or NAIF's instrument kernel (one focal length for all, lines through the outer corners of
their first and last pixels; these differ from the addendum's by 0.4 pixels across track and up to 9 along it).

SPACECRAFT_CLOCK_START_COUNT and ..._STOP_COUNT are not read: those of h5270_0000_ir2 lie 7 s before START_TIME and 64 s
after STOP_TIME, and so belong to something longer than the image.

When HRSC takes its lines: out of the lines' prefixes, the table of a cube, a text file, or a mean of the label's.

HRSC changes its line period within an image, to follow the speed over the ground; no label says so. What does:

* PDS3 images: the first 8 bytes of each line's prefix are the time at which its exposure begins (s TDB past J2000),
  the next 4 the exposure in ms, little-endian whatever the pixels are (ISIS hrsc2isis, ALE's notes on HRSC);
* ISIS cubes: the table LineScanTimes, which hrsc2isis makes of these, one record for each change of the exposure;
* text: this table as ISIS `tabledump` writes it, or made by hand.

A time is that of the line's leading edge: so says CkTableEndTime of the cube of h5270, which is the last change plus
all lines that follow, and so has ALE's support data. (Older ISIS took it for the middle, half a line later.)
"""

import csv
import io
from dataclasses import replace
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError, errors_from, require
from mgsgraph.files.cameras.camera import (
    JOINED,
    Camera,
    Keywords,
    LabelBlock,
    LabelKeys,
    LineScanLabel,
    LineTimes,
    LineTimesLocation,
    LineTimesPlace,
    interior_by_addendum,
    keywords_of,
    number,
    pds3_keys,
    require_summing,
)
from mgsgraph.files.cameras.line_scanners import CTX, HIRISE, MI, MOC, NAC, TC, THEMIS
from mgsgraph.files.cameras.other_sensors import sensor_kind
from mgsgraph.files.geometric_keys import all_blocks
from mgsgraph.files.opening import ANY_SIZE, number_of, opened, read_text, understood
from mgsgraph.files.pvl import Block, bytes_around, cube_of, cube_size, data_location, read_label
from mgsgraph.geometry.camera import InteriorOrientation, NoDistortion
from mgsgraph.geometry.records import Array
from mgsgraph.units import MILLISECOND, MM

_SHORTEST, _LONGEST = 1e-3, 0.5
"""s per line; HRSC exposes for 2.24 to 54.5 ms per detector line, of which a macropixel takes 8 at most."""
_LATEST = 1e11
"""s from J2000: three thousand years."""
_SLACK = 1.0
"""s by which times and the label's START_TIME and STOP_TIME may differ; those of h5270 agree within 1 ms."""
_COLUMNS = ("EphemerisTime", "ExposureTime", "LineStart")
_PREFIX = [("time", "<f8"), ("exposure", "<f4")]
_RECORD = np.dtype([("time", "<f8"), ("exposure", "<f8"), ("line", "<i4")])


def read_line_times(place: LineTimesPlace, lines: int, start: float, stop: float, label: str) -> LineTimes:
    """Times of an image's lines.

    Parameters
    ----------
    place : LineTimesLocation, Path, "mean" or None
        Where they are. "mean" is kilometres off in the middle of an image that changes its rate (h5270: 1.6 s, 6 km),
        and so must be asked for.
    lines : int
        of the image.
    start, stop : float
        s TDB past J2000, what its START_TIME and STOP_TIME stand for.
    label : str
        The label's file, for messages.

    Raises
    ------
    InputError
        No line times where they are looked for, a line rate that makes no sense, or times that are not the label's.
    """
    require(start < stop, label, f"STOP_TIME {stop - start:+.3f} s after START_TIME", "a time after START_TIME")
    if place == "mean":
        return _mean(label, lines, start, stop)
    if place is None:
        raise InputError(
            label, "a label without the times of its lines",
            "the image itself (PDS3 with line prefixes, or a cube with its table LineScanTimes)",
            f"name that, or line_times = a text file of {', '.join(_COLUMNS)}, or 'mean' for a rough one",
        )  # fmt: skip
    where = str(place if isinstance(place, Path) else place.file)
    with errors_from(where):
        if isinstance(place, Path):
            times = _of_text(place, lines)
        else:
            times = _of_prefixes(place) if place.kind == "prefixes" else _of_table(place, lines)
    for what, ours, theirs in (("START_TIME", times.start, start), ("STOP_TIME", times.last, stop)):
        if not abs(ours - theirs) <= _SLACK:
            raise InputError(
                where, f"line times {ours - theirs:+.3f} s off the label's {what}",
                f"the two within {_SLACK:g} s", "check the line rates, and whether they are this image's",
            )  # fmt: skip
    return times


def _mean(label: str, lines: int, start: float, stop: float) -> LineTimes:
    """STOP_TIME is that of the last line's beginning."""
    require(lines >= 2, label, "one line", "at least two for a mean line rate")
    with errors_from(f"{label}, START_TIME, STOP_TIME and lines"):
        return _times(np.zeros(1), np.array([start]), np.array([(stop - start) / (lines - 1)]), lines)


def _times(first: Array, starts: Array, periods: Array, lines: int) -> LineTimes:
    for k in np.flatnonzero(~((periods >= _SHORTEST) & (periods <= _LONGEST)))[:1]:
        found = f"a line rate of {float(periods[k]) / MILLISECOND:g} ms per line from line {first[k] + 1.0:g} on"
        raise InputError(
            "line times", found, f"{_SHORTEST / MILLISECOND:g} .. {_LONGEST / MILLISECOND:g} ms, as HRSC's are",
            "check the unit: ms in prefixes, s elsewhere",
        )  # fmt: skip
    for k in np.flatnonzero(~(np.abs(starts) < _LATEST))[:1]:
        found = f"the time {starts[k]:g} s for line {first[k] + 1.0:g}"
        raise InputError("line times", found, "s TDB past J2000")
    return LineTimes(first, starts, periods, lines)


def _of_prefixes(place: LineTimesLocation) -> LineTimes:
    """One segment from each change of the exposure, and from the end of each pause."""
    rest = place.stride - sum(np.dtype(kind).itemsize for _, kind in _PREFIX)
    with opened(place.file, ANY_SIZE) as file, understood(str(place.file), "an image with line prefixes"):
        rows = np.memmap(file, np.dtype([*_PREFIX, ("pixels", f"V{rest}")]), "r", place.offset, place.count)
        times = np.array(rows["time"], dtype=np.float64)
        with np.errstate(invalid="ignore"):  # signalling NaN
            periods = np.array(rows["exposure"], dtype=np.float64) * MILLISECOND
    for k in np.flatnonzero(~((np.abs(times) < _LATEST) & (periods > 0.0) & (periods < _LATEST)))[:1]:
        raise InputError(f"prefix of line {k + 1}", f"{times[k]:g} s and {periods[k]:g} s", "a time and an exposure")
    waited = np.abs(np.diff(times) - periods[:-1]) > JOINED * periods[:-1]
    begins = np.flatnonzero(np.concatenate([[True], waited | (np.diff(periods) != 0.0)]))
    return _times(begins.astype(np.float64), times[begins], periods[begins], place.count)


def _of_table(place: LineTimesLocation, lines: int) -> LineTimes:
    with opened(place.file, ANY_SIZE) as file, understood(str(place.file), "a cube with the times of its lines"):
        file.seek(place.offset)
        rows = np.frombuffer(file.read(place.count * place.stride), _RECORD, place.count)
    return _times(rows["line"] - 1.0, rows["time"].astype(np.float64), rows["exposure"].astype(np.float64), lines)


def _of_text(path: Path, lines: int) -> LineTimes:
    """Comma-separated, with a line of names."""
    with understood(str(path), "a table of line times"):
        rows = csv.DictReader(io.StringIO(read_text(path)), skipinitialspace=True)
        names = [name.strip() for name in rows.fieldnames or ()]
        if any(name not in names for name in _COLUMNS):
            raise InputError(str(path), f"the columns {', '.join(names) or 'none'}", f"{', '.join(_COLUMNS)}")
        rows.fieldnames = names
        values = [
            [number_of((row[name] or "").strip(), f"{path}, line {rows.line_num}, {name}") for name in _COLUMNS]
            for row in rows
        ]
    table = np.array(values, dtype=np.float64).reshape(-1, 3)
    return _times(table[:, 2] - 1.0, table[:, 0], table[:, 1], lines)


# --- the camera

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
            fields = [(field.text("Name").lower(), field.text("Type").lower()) for field in block.blocks]
            if fields != _TIMES_FIELDS or block.text("ByteOrder").upper() != "LSB":
                raise InputError(
                    block.where(), f"the fields {', '.join(' '.join(field) for field in fields)}",
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


CAMERAS: tuple[Camera, ...] = (*MOC, CTX, HIRISE, THEMIS, *HRSC, *NAC, *TC, *MI)
"""In the order in which they are looked for and listed."""
_PERIOD_UNITS = {
    "milliseconds": MILLISECOND, "ms": MILLISECOND, "msec": MILLISECOND, "seconds": 1.0, "s": 1.0, "": MILLISECOND,
}  # fmt: skip
"""Of line periods and exposures, s; milliseconds where none is stated."""
REMEDY_FOR_MAPS = "give the image as it was before it was projected; a map can only be a reference raster"


def read_line_scan_label(path: Path) -> LineScanLabel:
    """Read the label of an image of any camera that is known here.

    Parameters
    ----------
    path : Path
        PDS3 image or its label, ISIS cube, or the label of one.

    Raises
    ------
    InputError
        Missing file, no label, a camera that is not known here (with those that are), a keyword missing or out of
        range, a map, or an image that was reduced.
    """
    return label_of(path, read_label(path))


def label_of(path: Path, root: Block) -> LineScanLabel:
    """As `read_line_scan_label`, of a label that was read already; `path` is its file."""
    block = LabelBlock(root, "pds3" if "PDS_VERSION_ID" in root else "isis")
    _require_no_map(block)
    camera, keys = _recognised(path, block)
    lines, samples, first_line, first_sample, whole = _extent(block)
    summing = block.number(keys.sample_summing) if keys.sample_summing else 1.0
    first = block.number(keys.first_sample) - keys.first_pixel if keys.first_sample else 0.0
    periods = block.number(keys.line_summing) if keys.line_summing else 1.0
    if periods <= 0.0:
        raise InputError(block.where(keys.line_summing), f"{periods:g}", "a summing of 1 or more")
    period = block.number(keys.period, _PERIOD_UNITS) * periods if keys.period else 0.0
    if keys.period and period <= 0.0:
        raise InputError(block.where(keys.period), f"{period} s", "a positive line period")
    label = LineScanLabel(
        path=path,
        camera=camera,
        product=block.text(keys.product) if keys.product in block else path.stem,
        serial=_serial_number(camera, keys, block),
        target=block.text(keys.target).upper(),
        lines=lines,
        samples=samples,
        start=block.text(keys.start),
        utc=block.text(keys.utc) if keys.utc in block else "",
        period=period,
        sample_summing=summing,
        first_sample=first + first_sample * summing,
        first_line=first_line,
        whole=whole if whole != lines else 0,
        padding=(_padding(block, "StartPadding"), _padding(block, "EndPadding")),
        stop=_stop(keys, block),
        keywords=next((keywords_of(group) for group in root.blocks if group.name == "naifkeywords"), None),
    )
    return camera.label_facts(block, label) if camera.label_facts else label


def instrument_name(root: Block) -> str:
    """Name of a label's instrument, for messages."""
    block = LabelBlock(root, "pds3" if "PDS_VERSION_ID" in root else "isis")
    keys = ("INSTRUMENT_ID", "INSTRUMENT_NAME") if block.kind == "pds3" else ("InstrumentId",)
    return next((" ".join(block.words(key)) for key in keys if key in block), "no instrument")


def _recognised(path: Path, block: LabelBlock) -> tuple[Camera, LabelKeys]:
    for camera in CAMERAS:
        keys = camera.keys(block.kind)
        if keys is not None and all(_word(block, key) == wanted for key, wanted in keys.identity.items()):
            return camera, keys
    name = instrument_name(block.root)
    if sensor := _sensor_kind(block):
        raise InputError(str(path), f"the instrument {name} is {sensor}", "an image of a line scanner")
    kind = "ISIS cubes" if block.kind == "isis" else "PDS3 labels"
    found, expected = f"the camera {name} is not known by labels", f"one of those known by {kind}: {_cameras(block)}"
    raise InputError(str(path), found, expected, "give its image support data (ALE's isd_generate) instead")


def _sensor_kind(block: LabelBlock) -> str:
    """What the label's instrument is if it is no line scanner, else empty."""
    alternatives = (("INSTRUMENT_ID", "DETECTOR_ID", "INSTRUMENT_MODE_ID"), ("INSTRUMENT_NAME",), ("InstrumentId",))
    names = (" ".join(" ".join(block.words(key)) for key in keys if key in block) for keys in alternatives)
    return next(filter(None, map(sensor_kind, names)), "")


def _require_no_map(block: LabelBlock) -> None:
    """Refuse a map's pixels without a camera; a cube that was projected still holds the geometry of its image."""
    names = {group.name: group for group in all_blocks(block.root)}
    map_group = names.get("image_map_projection") or ("instrument" not in names and names.get("mapping"))
    if map_group:
        raise InputError(map_group.where(), "a map-projected image", "an image in camera geometry", REMEDY_FOR_MAPS)


def _cameras(block: LabelBlock) -> str:
    """Missions and instruments of all cameras; of those that share the label's instrument, what else tells them."""
    all_keys = [(camera.mission, keys.identity) for camera in CAMERAS if (keys := camera.keys(block.kind)) is not None]
    near = [entry for entry in all_keys if all(_word(block, key) == entry[1][key] for key in list(entry[1])[:1])]
    return ", ".join(dict.fromkeys(" ".join([mission, *values.values()]) for mission, values in near)) or ", ".join(
        dict.fromkeys(f"{mission} {next(iter(values.values()))}" for mission, values in all_keys)
    )


def _word(block: LabelBlock, key: str) -> str:
    return block.text(key).upper().replace(" ", "") if key in block else ""


def _serial_number(camera: Camera, keys: LabelKeys, block: LabelBlock) -> str:
    """Mission and some keywords' values, as ISIS makes serial numbers (appdata/serialnumbers)."""
    parts = [block.text(key) for key in keys.serial if key in block]
    return "/".join([camera.mission, *parts, *filter(None, [keys.serial_end])])


def _stop(keys: LabelKeys, block: LabelBlock) -> str:
    """Line times that the label lacks depend on it; others are compared with it, where it is known."""
    if not keys.stop or (keys.period and (keys.stop not in block or not block.text(keys.stop)[:1].isdigit())):
        return ""
    return block.text(keys.stop)


def _padding(block: LabelBlock, key: str) -> float:
    """Of a cube's tables, s; see `LineScanLabel.padding`."""
    return block.number(key, {"seconds": 1.0, "s": 1.0, "": 1.0}) if block.kind == "isis" and key in block else 0.0


def _extent(block: LabelBlock) -> tuple[int, int, float, float, int]:
    """Lines and samples of the image in camera geometry, how many were cut off before its first ones, and the lines
    before that.

    A map-projected cube gives the image that it was made of (its AlphaCube), whole.
    """
    if block.kind == "pds3":
        image = block.root.inner("IMAGE")
        return image.count("LINES"), image.count("LINE_SAMPLES"), 0.0, 0.0, image.count("LINES")
    cube = block.root.inner("IsisCube")
    size = cube.inner("Core").inner("Dimensions")
    lines, samples = size.count("Lines"), size.count("Samples")
    alpha = next((group for group in cube.blocks if group.name == "alphacube"), None)
    if alpha is None and is_map_projected(block.root):
        raise InputError(cube.where(), "a map-projected cube without AlphaCube", "its size before", REMEDY_FOR_MAPS)
    if alpha is None:
        return lines, samples, 0.0, 0.0, lines
    if is_map_projected(block.root):
        return alpha.count("AlphaLines"), alpha.count("AlphaSamples"), 0.0, 0.0, alpha.count("AlphaLines")
    cut = _cut(alpha, "Line", lines), _cut(alpha, "Sample", samples)
    return lines, samples, *cut, alpha.count("AlphaLines")


def _cut(alpha: Block, axis: str, count: int) -> float:
    """Lines or samples before the first one of a cube that ISIS crop has cut out of a larger one."""
    if f"AlphaStarting{axis}" not in alpha:
        whole = alpha.count(f"Alpha{axis}s")
        if whole != count:
            found = f"{count} of {whole} {axis.lower()}s"
            raise InputError(alpha.where(), found, "the whole image, or where it begins")
        return 0.0
    start, end = alpha.number(f"AlphaStarting{axis}"), alpha.number(f"AlphaEnding{axis}")
    if abs(end - start - count) > 1e-6:
        raise InputError(
            alpha.where(f"AlphaEnding{axis}"), f"{count} {axis.lower()}s made of {end - start:g}", "as many",
            "take the image before it was reduced or enlarged",
        )  # fmt: skip
    return start - 0.5


def is_map_projected(root: Block) -> bool:
    """Whether a cube's pixels are those of a map, not of the camera. A part of a camera's image may have the group of a
    map beside it (from caminfo or camrange), to which its own size has no relation.
    """
    if "PDS_VERSION_ID" in root:
        return False
    cube = root.inner("IsisCube")
    mapped = any(group.name == "mapping" for group in cube.blocks)
    alpha = next((group for group in cube.blocks if group.name == "alphacube"), None)
    if not mapped or alpha is None or "AlphaEndingLine" not in alpha:
        return mapped
    size = cube.inner("Core").inner("Dimensions")
    return any(
        alpha.number(f"AlphaEnding{axis}") - alpha.number(f"AlphaStarting{axis}") != size.count(f"{axis}s")
        for axis in ("Line", "Sample")
    )
