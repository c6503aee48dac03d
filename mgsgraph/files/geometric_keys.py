"""Keys that bear on geometry, one table for each format: read, compared with what says the same a second time, or
refused where they say anything else than what is meant here.

Readers look here for what to refuse, `check` for keys that nothing reads, and the page of formats prints the tables. A
name is a regular expression in capitals. Units are those of the file.
"""

import re
import tomllib
from collections.abc import Iterable, Mapping
from enum import StrEnum
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from mgsgraph.errors import InputError
from mgsgraph.files.pvl import Block


class Use(StrEnum):
    """How a key is used."""

    READ = "read"
    COMPARED = "compared"
    REFUSED = "refused"


class Key(NamedTuple):
    """A key, or a family of keys."""

    name: str
    """Regular expression of the whole name."""
    use: Use
    meaning: str
    """What it says; unit, frame."""
    same_as: str = ""
    """What says the same in the same input; of a refused one its usual values, for a reader's eye."""
    usual: str = ""
    """Regular expression of values, in capitals, with which a refused key says what is meant here."""


FORMATS: Mapping[str, tuple[Key, ...]] = {
    name: tuple(Key(pattern, Use(use), *texts) for pattern, use, *texts in keys)
    for name, keys in tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")).items()
}
"""Keys of each format; of some the page of formats alone has them."""
SUPPORT_DATA, IMAGE_LABEL = FORMATS["image support data"], FORMATS["PDS3 label of an image"]
GRID_LABEL, SHOT_LABEL = FORMATS["PDS3 label of MEGDR"], FORMATS["PDS3 label of laser shots"]
_NO_MATTER = ("REFERENCE_HEIGHT.*", "ISIS_CAMERA_VERSION", "IMAGE_IDENTIFIER", r"\w+\.(TIME_DEPENDENT|CONSTANT)_FRAMES")
_GEOMETRIC = re.compile(
    r"LATITUDE|LONGITUDE|RADI(US|I)|FOCAL|DETECTOR|PIXEL|SUMMING|DISTORT|BORESIGHT|QUATERNION|ROTATION|POSITION|POINTING|"
    r"EPHEMERIS|CLOCK|PERIOD|EXPOSURE_DURATION|INTERVAL|PROJECTION|DATUM|OFFSET|SCALING|SCALE|CONSTANT$|DIRECTION|"
    r"COORDINATE|FRAME$|ITRANS|MISSING_CONST|AXIS|LINE_|SAMPLE_|LEVER|BIAS|GEOTRANSFORM|TIME$|TIMES$",
)
_OTHERS = re.compile(
    r"IMAGE_TIME|OFFSET_ANGLE|SCALING_FACTOR|OFFSET|INVALID_PIXELS|.*THRESHOLD.*|RADIANCE.*|REFLECTANCE.*|SAMPLE_BIT.*|"
    r".*_TEMPERATURE|.*CREATION_TIME|OFFSET_MODE_ID|.*_DESC|PROGRAM_START_TIME|"
    r"CENTER_FILTER.*|.*CHANNEL.*OFFSET|LRO:LINE_(EXPOSURE_)?CODE|.*OVERLAP_LINE.*|NOMINAL_LINE_NUMBER|INCIDENCE.*|"
    r"(DEFECT|SHADOWED).*|UPLOAD.*|PIXEL_SUBSAMPLING_FLAG|DETECTOR_STATUS|ORBITAL_.*|PERIAPSIS.*|ASCENDING.*|"
    r"SPACECRAFT_(ORIENTATION|POINTING_MODE|SOLAR_DISTANCE|CLOCK_STOP_COUNT|GROUND_SPEED|ALTITUDE)|\^.*|"
    r"CORRECTED_SC_CLOCK_STOP_COUNT|SATELLITE_MOVING_DIRECTION|SUB_.*|SOLAR_.*|.*_NAME|FILE_.*|PRODUCT_.*",
)
"""Names that look so, and are of other things: radiometry, orbits, production, what follows from the image's times."""


def texts(block: Block) -> dict[str, str]:
    """Value of each keyword of a block, as text."""
    items = {key: entry.value for key, entry in block.entries.items()}
    return {key: value if isinstance(value, str) else ", ".join(value) for key, value in items.items()}


def _of(name: str, keys: Iterable[Key]) -> Key | None:
    return next((key for key in keys if re.fullmatch(key.name, name.upper())), None)


def unread(names: Iterable[str], keys: Iterable[Key]) -> list[str]:
    """Names that look geometric and are not in a format's table."""
    return [*_unread(tuple(names), tuple(keys))]


@lru_cache  # files of one camera have the same names
def _unread(names: tuple[str, ...], table: tuple[Key, ...]) -> tuple[str, ...]:
    return tuple(
        name for name in names
        if _GEOMETRIC.search(name.upper()) and not _OTHERS.fullmatch(name.upper()) and _of(name, table) is None
        and not any(re.fullmatch(pattern, name.upper()) for pattern in _NO_MATTER)
    )  # fmt: skip


@lru_cache
def _refused(names: tuple[str, ...], keys: tuple[Key, ...]) -> tuple[tuple[str, Key], ...]:
    """Names of keys that are refused with values other than the usual ones."""
    refused = [key for key in keys if key.use == Use.REFUSED]
    return tuple((name, key) for name in names if (key := _of(name, refused)) is not None)


def all_blocks(root: Block) -> list[Block]:
    """A label and all objects in it, at any depth."""
    blocks = [root]
    for block in blocks:
        blocks += block.blocks
    return blocks


def require_once(root: Block, keys: Iterable[Key]) -> None:
    """Raise InputError where two objects of a label contradict each other about a key of the format's table, but for
    those of single columns.
    """
    table, first_stated = tuple(keys), dict[str, tuple[str, Block]]()
    for block in all_blocks(root):
        for name, value in texts(block).items() if block.name != "column" else ():
            plain = value.strip("\"' ").upper()
            before, other = first_stated.setdefault(name, (plain, block))
            if before != plain and _of(name, table) is not None:
                raise InputError(block.where(name), repr(value)[:60], f"{before}, as {other.where(name)} says")


def require_usual(values: Mapping[str, object], keys: Iterable[Key], where: str) -> None:
    """Raise InputError for a key with a value by which the file means something else than is read here.

    Parameters
    ----------
    values : mapping
        Text, or what has one, by name.
    keys : iterable of Key
        The format's table.
    where : str
        The file, for messages.
    """
    for name, key in _refused(tuple(values), tuple(keys)):
        value = str(values[name])
        if not re.fullmatch(f"(?:{key.usual})", value.strip().strip("\"'").upper()):
            remedy = f"convert the file first ({key.meaning})"
            raise InputError(f"{where}, {name}", repr(value)[:60], key.same_as, remedy)
