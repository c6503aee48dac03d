"""Labels of Mars Orbiter Camera images: PDS3 (attached or detached) and ISIS cubes; what the geometry needs of them.

Keywords and their ranges: ISIS moc2isis, its translation table MgsMocInstrument.trn, and MocLabels.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from mgsgraph.errors import InputError
from mgsgraph.io.image_label import bytes_around, cube_of, cube_size, data_location, read_label
from mgsgraph.io.pvl import Block
from mgsgraph.units import MILLISECOND

Instrument = Literal["MOC-NA", "MOC-WA-RED", "MOC-WA-BLUE"]

EXPOSURE_UNITS = {"milliseconds": MILLISECOND, "ms": MILLISECOND, "seconds": 1.0, "s": 1.0, "": MILLISECOND}
"""Of LineExposureDuration, s; milliseconds where none is stated."""
_DETECTOR = {"MOC-NA": 2048, "MOC-WA-RED": 3456, "MOC-WA-BLUE": 3456}
_HIGHEST_SUMMING = {"MOC-NA": 8, "MOC-WA-RED": 127, "MOC-WA-BLUE": 127}
_VARIABLE_SUMMING = (13, 27)
"""Summings of the wide angles that change along the detector: samples times summing say nothing there."""
_NOTHING = {"n/a", "none", "unk", "null"}


@dataclass(frozen=True, slots=True)
class PixelArea:
    """Where the pixels of a PDS3 image lie, one byte each unless compressed."""

    file: Path
    """Which holds them."""
    offset: int
    """bytes before the first line."""
    prefix: int
    """bytes before each line's pixels."""
    suffix: int
    """bytes after each line's pixels."""
    encoding: str
    """As the label calls the compression, such as MOC-PRED-X-5; empty when there is none."""
    file_size: int
    """bytes that the label says the file has; 0 where it doesn't."""


@dataclass(frozen=True, slots=True)
class MocLabel:
    """What the label of a MOC image says of its geometry."""

    path: Path
    """File that was read."""
    instrument: Instrument
    """Which of the three cameras."""
    product: str
    """Product id, such as M04/02852."""
    target: str
    """Body, such as MARS."""
    start_time: str
    """UTC, rounded to 0.01 s; the clock count is what counts."""
    clock_start: str
    """Spacecraft clock count at the top edge of the first line, such as 619971158:28."""
    exposure: float
    """s, of one detector line before summing."""
    crosstrack_summing: int
    """detector pixels per image sample."""
    downtrack_summing: int
    """exposures per image line."""
    first_sample: int
    """Detector pixel, counted from 1, at which the image begins: EDIT_MODE_ID + 1, ISIS FirstLineSample."""
    lines: int
    """Number of lines."""
    samples: int
    """Number of samples."""
    pixels: PixelArea | None
    """Where the pixels are in a PDS3 file; None for a cube, whose file knows."""

    @property
    def line_period(self) -> float:
        """Time in s from one image line to the next."""
        return self.exposure * self.downtrack_summing

    @property
    def compressed(self) -> bool:
        """Whether the pixels are compressed."""
        return self.pixels is not None and bool(self.pixels.encoding)


def read_moc_label(path: Path) -> MocLabel:
    """Read the label of a MOC image.

    Parameters
    ----------
    path : Path
        ``.imq``, ``.img`` (its label attached, or detached beside it), ``.lbl`` of either kind, or an ISIS ``.cub``.

    Raises
    ------
    InputError
        Missing file, no such label, a keyword missing, out of range, or contradicted by another.
    """
    root = read_label(path)
    cube = cube_of(root)
    label = _pds(path, root) if cube is None else _cube(path, cube)
    _require_consistent(label)
    return label


# --- PDS3


def _pds(path: Path, root: Block) -> MocLabel:
    image = root.inner("IMAGE")
    edit = root.number("EDIT_MODE_ID", {"": 1.0})
    if edit < 0.0 or edit % 1.0:
        raise InputError(root.where("EDIT_MODE_ID"), f"{edit:g}", "a whole number of detector pixels")
    return MocLabel(
        path=path,
        instrument=_instrument(root, root.text("INSTRUMENT_ID"), "FILTER_NAME"),
        product=root.text("PRODUCT_ID"),
        target=root.text("TARGET_NAME"),
        start_time=root.text("START_TIME"),
        clock_start=root.text("SPACECRAFT_CLOCK_START_COUNT"),
        exposure=_exposure(root, "LINE_EXPOSURE_DURATION"),
        crosstrack_summing=root.count("CROSSTRACK_SUMMING"),
        downtrack_summing=root.count("DOWNTRACK_SUMMING"),
        first_sample=int(edit) + 1,
        lines=image.count("LINES"),
        samples=image.count("LINE_SAMPLES"),
        pixels=_pixel_area(path, root, image),
    )


def _pixel_area(path: Path, root: Block, image: Block) -> PixelArea:
    if image.number("SAMPLE_BITS", {"": 1.0}) != 8.0:
        raise InputError(image.where("SAMPLE_BITS"), image.text("SAMPLE_BITS"), "8, as all MOC images have")
    prefix, suffix = bytes_around(image)
    encoding = image.text("ENCODING_TYPE") if "ENCODING_TYPE" in image else ""
    size = root.count("RECORD_BYTES") * root.count("FILE_RECORDS") if "FILE_RECORDS" in root else 0
    file, offset = data_location(path, root)
    return PixelArea(file, offset, prefix, suffix, "" if encoding.lower() in _NOTHING else encoding, size)


# --- ISIS


def _cube(path: Path, cube: Block) -> MocLabel:
    instrument = cube.inner("Instrument")
    lines, samples = cube_size(cube)
    band = next((block for block in cube.blocks if block.name == "bandbin"), instrument)
    return MocLabel(
        path=path,
        instrument=_instrument(band, instrument.text("InstrumentId"), "FilterName"),
        product=cube.inner("Archive").text("ProductId"),
        target=instrument.text("TargetName"),
        start_time=instrument.text("StartTime"),
        clock_start=instrument.text("SpacecraftClockCount"),
        exposure=_exposure(instrument, "LineExposureDuration"),
        crosstrack_summing=instrument.count("CrosstrackSumming"),
        downtrack_summing=instrument.count("DowntrackSumming"),
        first_sample=instrument.count("FirstLineSample"),
        lines=lines,
        samples=samples,
        pixels=None,
    )


# --- both


def _instrument(block: Block, name: str, filter_key: str) -> Instrument:
    if name.upper() == "MOC-NA":
        return "MOC-NA"
    if name.upper() != "MOC-WA":
        raise InputError(block.document.source, f"the instrument {name!r}", "MOC-NA or MOC-WA")
    colour = block.text(filter_key).upper()
    if colour == "RED":
        return "MOC-WA-RED"
    if colour == "BLUE":
        return "MOC-WA-BLUE"
    raise InputError(block.where(filter_key), repr(colour), "RED or BLUE for MOC-WA")


def _exposure(block: Block, key: str) -> float:
    value = block.number(key, EXPOSURE_UNITS)
    if value <= 0.0:
        raise InputError(block.where(key), f"{value} s", "a positive line exposure")
    return value


def _require_consistent(label: MocLabel) -> None:
    """Summing in its range, and the image on its detector."""
    highest, width = _HIGHEST_SUMMING[label.instrument], _DETECTOR[label.instrument]
    for what, value in (("crosstrack", label.crosstrack_summing), ("downtrack", label.downtrack_summing)):
        if not 1 <= value <= highest:
            raise InputError(str(label.path), f"{what} summing {value}", f"1 .. {highest} for {label.instrument}")
    if label.crosstrack_summing in _VARIABLE_SUMMING:
        return
    last = label.first_sample - 1 + label.samples * label.crosstrack_summing
    if last > width:
        raise InputError(
            str(label.path),
            f"{label.samples} samples of {label.crosstrack_summing} pixels from {label.first_sample} on end at {last}",
            f"an end on the detector of {width} pixels", "mend the summing, the samples or the edit mode in the label",
        )
