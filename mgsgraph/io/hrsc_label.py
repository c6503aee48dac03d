"""Labels of HRSC images (Mars Express): PDS3 of levels 2 and below, and ISIS cubes; what the geometry needs of them.

Keywords: ISIS hrsc2isis and its translation tables. SPACECRAFT_CLOCK_START_COUNT and ..._STOP_COUNT are not read: those
of h5270_0000_ir2 lie 7 s before START_TIME and 64 s after STOP_TIME, and so belong to something longer than the image.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from mgsgraph.errors import InputError
from mgsgraph.io.image_label import bytes_around, cube_of, cube_size, data_location, read_label
from mgsgraph.io.pvl import Block

Detector = Literal["S2", "RED", "P2", "BLUE", "NADIR", "GREEN", "P1", "IR", "S1"]
"""The nine lines in the order of their NAIF ids, from -41211 to -41219; those that look ahead come last."""
DETECTORS: tuple[Detector, ...] = get_args(Detector)
ACTIVE_PIXELS = 5184
"""Of each line (instrument kernel; 5272 are there)."""

_MACROPIXELS = (1, 2, 4, 8)
_PROJECTED_LEVEL = 3
"""PROCESSING_LEVEL_ID from which on images are maps."""
_TIME_BYTES = 12
"""At the head of a line's prefix: its time and exposure."""
_TIMES_TABLE = "linescantimes"
_TIMES_FIELDS = [("ephemeristime", "double"), ("exposuretime", "double"), ("linestart", "integer")]
_TIMES_RECORD = 20
"""bytes."""


@dataclass(frozen=True, slots=True)
class LineTimesLocation:
    """Where in a file the times of lines lie."""

    file: Path
    """Which holds them."""
    kind: Literal["prefixes", "table"]
    """Before each line's pixels (PDS3), or the table LineScanTimes that hrsc2isis made of these."""
    offset: int
    """bytes before the first."""
    count: int
    """Number of lines, or of records."""
    stride: int
    """bytes from one to the next."""


@dataclass(frozen=True, slots=True)
class HrscLabel:
    """What the label of an HRSC image says of its geometry."""

    path: Path
    """File that was read."""
    detector: Detector
    """Which of the nine lines."""
    product: str
    """Product id, such as H5270_0000_IR2.IMG."""
    target: str
    """Body, such as MARS."""
    start_time: str
    """UTC, rounded to 1 ms, of the beginning of the first line."""
    stop_time: str
    """UTC, rounded to 1 ms, of the beginning of the last line (h5270: within 1 ms of its table LineScanTimes)."""
    macropixel: int
    """Detector pixels per image sample, and as many along track in one line's time."""
    lines: int
    """Number of lines."""
    samples: int
    """Number of samples."""
    times: LineTimesLocation | None
    """Where the times of the lines are; None where the file holds the label only."""


def read_hrsc_label(path: Path) -> HrscLabel:
    """Read the label of an HRSC image.

    Parameters
    ----------
    path : Path
        ``.img`` (its label attached, or detached beside it), ``.lbl`` of either kind, or an ISIS ``.cub``.

    Raises
    ------
    InputError
        Missing file, no such label, a map, a line (detector) that is not one of the nine, a keyword missing, out of
        range, or contradicted by another.
    """
    root = read_label(path)
    cube = cube_of(root)
    label = _pds(path, root) if cube is None else _cube(path, root, cube)
    if label.macropixel not in _MACROPIXELS:
        expected = ", ".join(map(str, _MACROPIXELS))
        raise InputError(str(path), f"macropixels of {label.macropixel}", f"one of {expected}")
    width = label.samples * label.macropixel
    if width > ACTIVE_PIXELS:
        raise InputError(
            str(path), f"{label.samples} samples of {label.macropixel} pixels, {width} in all",
            f"at most the line's {ACTIVE_PIXELS}", "mend the macropixel or the samples in the label",
        )  # fmt: skip
    return label


def _require_hrsc(block: Block, key: str) -> None:
    name = block.text(key)
    if name.upper() != "HRSC":
        raise InputError(block.where(key), f"the instrument {name!r}", "HRSC")


def _detector(block: Block, key: str) -> Detector:
    """One of the nine by its id, such as MEX_HRSC_IR."""
    stated = block.text(key)
    for name in DETECTORS:
        if stated.upper() == f"MEX_HRSC_{name}":
            return name
    expected = f"MEX_HRSC_ and one of {', '.join(DETECTORS)}"
    remedy = "the super resolution channel is a frame camera, and not modelled" if "SRC" in stated.upper() else ""
    raise InputError(block.where(key), f"the line {stated!r}", expected, remedy)


# --- PDS3


def _pds(path: Path, root: Block) -> HrscLabel:
    _require_hrsc(root, "INSTRUMENT_ID")
    level = root.number("PROCESSING_LEVEL_ID", {"": 1.0}) if "PROCESSING_LEVEL_ID" in root else 0.0
    if level >= _PROJECTED_LEVEL:
        raise InputError(root.where("PROCESSING_LEVEL_ID"), f"a map (level {level:g})", "an image of level 2 or below")
    detector = _detector(root, "DETECTOR_ID")
    image = root.inner("IMAGE")
    lines, samples = image.count("LINES"), image.count("LINE_SAMPLES")
    return HrscLabel(
        path=path,
        detector=detector,
        product=root.text("PRODUCT_ID"),
        target=root.text("TARGET_NAME"),
        start_time=root.text("START_TIME"),
        stop_time=root.text("STOP_TIME"),
        macropixel=root.count("MACROPIXEL_SIZE") if "MACROPIXEL_SIZE" in root else 1,
        lines=lines,
        samples=samples,
        times=_prefixes(path, root, image, lines, samples),
    )


def _prefixes(path: Path, root: Block, image: Block, lines: int, samples: int) -> LineTimesLocation | None:
    """Where the prefixes are; None where there are none, or not all of them."""
    prefix, suffix = bytes_around(image)
    if prefix < _TIME_BYTES:
        return None
    stride = prefix + samples * (image.count("SAMPLE_BITS") // 8) + suffix
    file, offset = data_location(path, root)
    if file.stat().st_size < offset + lines * stride:
        return None
    return LineTimesLocation(file, "prefixes", offset, lines, stride)


# --- ISIS


def _cube(path: Path, root: Block, cube: Block) -> HrscLabel:
    instrument, archive = cube.inner("Instrument"), cube.inner("Archive")
    _require_hrsc(instrument, "InstrumentId")
    detector = _detector(archive, "DetectorId")
    lines, samples = cube_size(cube)
    return HrscLabel(
        path=path,
        detector=detector,
        product=archive.text("ProductId"),
        target=instrument.text("TargetName"),
        start_time=instrument.text("StartTime"),
        stop_time=instrument.text("StopTime"),
        macropixel=instrument.count("Summing"),
        lines=lines,
        samples=samples,
        times=_table(path, root),
    )


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
