"""What a file is, by what is in it: images, their support data, networks, shots, kernels, terrain models, case files.

A name is looked at only where the content can't tell: MEGDR's grids have no header.
"""

import csv
import os.path
import re
import zlib
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Literal

from mgsgraph.errors import InputError, require
from mgsgraph.files.altimetry.binary import FRAME, RECORD, is_lola_rdr
from mgsgraph.files.altimetry.tables import LOLA_ROW, is_archive
from mgsgraph.files.cameras.label import REMEDY_FOR_MAPS, label_of
from mgsgraph.files.cameras.other_sensors import sensor_kind
from mgsgraph.files.csv_columns import CARTESIAN, GEODETIC, PLANETOCENTRIC
from mgsgraph.files.labels.isis_cube import has_tables, is_cube_json, serial_number
from mgsgraph.files.networks.table import MAGIC, parquet_names
from mgsgraph.files.opening import head_of, json_object, read_bytes, read_text
from mgsgraph.files.pvl import label_text, read_label
from mgsgraph.files.support_data.model_state import MODELS, is_model_state, read_state_json

_HEAD = 1 << 16
"""bytes that are looked at, of what is no JSON."""
_LARGEST_JSON, _LARGEST_LIST = 1 << 28, 1 << 24
"""bytes of JSON and of a list of files, which are read whole."""
_PROGRAM = "mgsgraph"
"""How `program` begins in records of results."""
_MEGDR = re.compile(r"meg([acrt])\d\d[ns]\d{3}[c-h]\w\.img", re.IGNORECASE)
_MEG = re.compile(r"meg([acrt])", re.IGNORECASE)
_ADJUST = re.compile(r"\s*(?:[-+.\deE]++[ \t]+){2}[-+.\deE]++[ \t]*\n\s*(?:[-+.\deE]++[ \t]+){3}[-+.\deE]++\s*")
"""A shift and a quaternion."""
_XML = re.compile(r"(?:<\?.*?\?>|<!--.*?-->|<!DOCTYPE[^>]*>|\s+)*+<(?:\w+:)?(\w+)", re.DOTALL)
_PDS4_NAME = re.compile(r"<(?:\w+:)?logical_identifier>\s*([^<\s]+)")
_FILE_NAME = re.compile(r"[^\s,;=]+\.[A-Za-z]\w{0,4}")
_GCP = re.compile(r"\s*\S+(\s+[-+.\deE]+){6}(\s+\S+(\s+[-+.\deE]+){4})+\s*")
_GEO_KEYS = 34735
"""TIFF tag of a raster that lies on a map (OGC GeoTIFF)."""


class Kind(StrEnum):
    """Kinds of files, in the words of messages."""

    CUBE = "an ISIS cube"
    MAPPED_CUBE = "a map-projected ISIS cube"
    CUBE_LABEL = "the label of an ISIS cube, without its data"
    CUBE_TABLES = "tables of an ISIS cube (JSON)"
    PDS3 = "a PDS3 image or its label"
    SUPPORT_DATA = "image support data"
    MODEL_STATE = "a model state of usgscsm"
    NETWORK = "a control network"
    TIE_TABLE = "a table of tie points"
    GROUND_CONTROL = "ground control points"
    LIDAR = "laser shots of ISIS"
    SHOTS = "laser shots"
    ALTIMETRY = "laser altimetry"
    RADII = "a terrain model of radii"
    TOPOGRAPHY = "a terrain model of heights above the areoid"
    AREOID = "a grid of the areoid"
    COUNTS = "a grid of numbers of shots"
    RASTER = "a georeferenced raster"
    PICTURE = "a picture"
    KERNEL = "a SPICE kernel"
    META_KERNEL = "a SPICE meta-kernel"
    TRANSFER = "a SPICE kernel in transfer format"
    LIST = "an ISIS list of files"
    PDS4 = "a PDS4 label"
    ADJUST = "an adjustment of ASP's bundle_adjust"
    SOCET = "a support file of SOCET SET"
    DIGITALGLOBE = "a camera file of DigitalGlobe (XML)"
    AIRBUS = "a camera file of Airbus (DIMAP XML)"
    CASE = "a TOML file with a format"
    OWN_RECORD = "a record of mgsgraph itself"


_MEGDR_KINDS = {"r": Kind.RADII, "t": Kind.TOPOGRAPHY, "a": Kind.AREOID, "c": Kind.COUNTS}
IMAGES = (Kind.CUBE, Kind.MAPPED_CUBE, Kind.CUBE_LABEL, Kind.CUBE_TABLES, Kind.PDS3, Kind.SUPPORT_DATA,
          Kind.MODEL_STATE)  # fmt: skip
"""Kinds that say an image's geometry, or a part of it."""
_ROOTS = {"Product_Observational": Kind.PDS4, "isd": Kind.DIGITALGLOBE, "Dimap_Document": Kind.AIRBUS}
"""Kinds by the outermost element of XML."""
_STATE = "the state that ASP's bundle_adjust writes (*.adjusted_state.json)"
_SUPPORT = "its ISIS cube after spiceinit, or support data (ALE's isd_generate)"
INSTEAD = {
    Kind.PDS4: f"give {_SUPPORT}", Kind.ADJUST: f"give {_STATE.replace('writes', 'writes beside it')}",
    Kind.SOCET: f"give {_SUPPORT}", Kind.DIGITALGLOBE: f"give {_STATE}", Kind.AIRBUS: f"give {_STATE}",
    Kind.RASTER: REMEDY_FOR_MAPS,
}  # fmt: skip
"""What to give where a file of this kind stands for an image."""


def kind_of(path: Path) -> Kind | None:
    """Kind of a file; None for an unknown kind, an unreadable file, and a path that is no file."""
    try:
        head = head_of(path, _HEAD)
        if head.startswith(b"\x1f\x8b"):
            head = zlib.decompressobj(wbits=31).decompress(head, _HEAD)
        return next((kind for kind in _possible_kinds(head, path) if kind is not None), None)
    except (InputError, OSError, zlib.error):
        return None


def _possible_kinds(head: bytes, path: Path) -> Iterator[Kind | None]:
    """Kind by each test of a file's head, the surest first; None where a test fails."""
    yield _MEGDR_KINDS[match[1].lower()] if (match := _MEGDR.fullmatch(path.name)) else None
    yield _tiff(head)
    yield _kernel(head)
    text = head.split(b"\0", 1)[0].decode("latin-1").replace("\r\n", "\n").lstrip("\ufeffï»¿ \n\t")
    yield _label(label, path, path.stat().st_size) if (label := label_text(head)) else None
    begin = re.match(r"object\s*=\s*(controlnetwork|protobuffer)\b", text, re.IGNORECASE)
    yield Kind.NETWORK if begin else None
    yield Kind.MODEL_STATE if text.startswith(MODELS) else None
    yield _json(path) if text.startswith("{") else None
    if head.startswith(MAGIC):
        yield Kind.TIE_TABLE if {"id", "image"} <= set(parquet_names(path)) else None
        return
    if b"\0" in head:
        yield _shots(head, path)
        return
    yield Kind.CASE if re.search(r"^format\s*=\s*\d+\s*(#.*)?$", text, re.MULTILINE) else None
    yield _of_others(text, path)
    yield Kind.LIST if _is_list(path, text) else None
    yield from _rows(text, path)


def _of_others(text: str, path: Path) -> Kind | None:
    """Camera files and corrections of other programs."""
    if text.startswith("<") and (root := _XML.match(text)):
        return _ROOTS.get(root[1])
    if path.suffix.lower() == ".sup" or re.search(r"^[ \t]*SENSOR_TYPE[ \t]+\w", text, re.MULTILINE):
        return Kind.SOCET
    return Kind.ADJUST if path.suffix.lower() == ".adjust" or _ADJUST.fullmatch(text) else None


def _is_list(path: Path, text: str) -> bool:
    """Whether each line names a file: all look like file names, or one exists."""
    names = [name for _, name in _named_in(text)]
    return any(os.path.isfile(path.parent / name) for name in names) or (
        bool(names) and all(map(_FILE_NAME.fullmatch, names))
    )


def listed_names(path: Path) -> list[str]:
    """Names in an ISIS list, one file in every line, relative to its folder; InputError unless all are there."""
    names = _named_in(read_text(path, limit=_LARGEST_LIST))
    require(names, str(path), "no file", "the name of an image file in every line")
    for number, name in names:
        if not os.path.isfile(path.parent / name):
            expected = "a file, relative to the list's folder"
            raise InputError(f"{path}, line {number}", f"{name!r}, which is not there", expected)
    return [name for _, name in names]


def _named_in(text: str) -> list[tuple[int, str]]:
    """Numbers of an ISIS list's lines, from 1 on, with the names in them; blank lines and # comments have none."""
    lines = enumerate(text.splitlines(), start=1)
    return [(number, name) for number, line in lines if (name := line.split("#", 1)[0].strip())]


def _tiff(head: bytes) -> Kind | None:
    """By the first directory's tags, as far as it lies at the head; a raster that is written in order has it there."""
    orders = {b"II": "little", b"MM": "big"}
    if head[:2] not in orders or head[2:4].strip(b"\0") not in (b"*", b"+"):
        return Kind.PICTURE if head.startswith((b"\x89PNG", b"\xff\xd8\xff")) else None
    big, order = head[2:4].strip(b"\0") == b"+", head[:2]
    tag = _GEO_KEYS.to_bytes(2, "little" if order == b"II" else "big")
    on_map = big or tag in head or len(head) == _HEAD
    return Kind.RASTER if on_map and not _of_bytes(head, order == b"II") else Kind.PICTURE


def _of_bytes(head: bytes, little: bool) -> bool:
    """Whether the first directory of a TIFF (not a BigTIFF) says eight bits for each pixel, which no heights have."""
    entry = b"\x02\x01\x03\x00\x01\x00\x00\x00\x08\x00" if little else b"\x01\x02\x00\x03\x00\x00\x00\x01\x00\x08"
    return entry in head


def _kernel(head: bytes) -> Kind | None:
    if head.startswith((b"DAFETF", b"DASETF", b"'DAFETF")):
        return Kind.TRANSFER
    if head.startswith((b"DAF/", b"NAIF/DAF", b"DAS/", b"NAIF/DAS")):
        return Kind.KERNEL
    if head.startswith(b"KPL/MK") or (not head.startswith(b"KPL/") and b"KERNELS_TO_LOAD" in head):
        return Kind.META_KERNEL
    text = head.startswith(b"KPL/") or re.search(rb"^[ \t]*\\begin(data|text)\s*$", head, re.MULTILINE)
    return Kind.KERNEL if text else None


def _label(text: str, path: Path, size: int) -> Kind:
    if text.upper().startswith("PDS_VERSION_ID"):
        if re.search(r"^[ \t]*OBJECT\s*=\s*IMAGE_MAP_PROJECTION", text, re.MULTILINE):
            pointer = re.search(r"^[ \t]*\^IMAGE\s*=\s*\(?\s*\"?([^\",\s]+)", text, re.MULTILINE)
            letter = _MEG.match(pointer[1] if pointer else path.name) or _MEG.match(path.name)
            return _MEGDR_KINDS[letter[1].lower()] if letter else Kind.RASTER
        of_table = re.search(r"^[ \t]*\^(\w+_)?TABLE\s*=", text, re.MULTILINE)
        of_image = re.search(r"^[ \t]*\^\w*(IMAGE|QUBE)\s*=", text, re.MULTILINE)
        taken_by = re.search(r"^[ \t]*INSTRUMENT_(?:ID|NAME)\s*=\s*\"?([^\"\n]*)", text, re.MULTILINE)
        return Kind.PDS3 if of_image or not of_table or (taken_by and sensor_kind(taken_by[1])) else Kind.SHOTS
    start = re.search(r"^[ \t]*StartByte\s*=\s*(\d{1,18})\b", text, re.MULTILINE | re.IGNORECASE)
    if re.search(r"^[ \t]*\^Core\s*=", text, re.MULTILINE | re.IGNORECASE) is None and start and size < int(start[1]):
        return Kind.CUBE_LABEL
    mapped = re.search(r"^[ \t]*Group\s*=\s*Mapping", text, re.MULTILINE | re.IGNORECASE)
    instrument = re.search(r"^[ \t]*Group\s*=\s*Instrument", text, re.MULTILINE | re.IGNORECASE)
    if mapped and not instrument:
        return Kind.RASTER
    return Kind.MAPPED_CUBE if mapped else Kind.CUBE


def _json(path: Path) -> Kind | None:
    text = read_bytes(path, _LARGEST_JSON)
    try:
        content = json_object(text.removeprefix(b"\xef\xbb\xbf"), str(path))
    except InputError:  # a file that was cut short, which its reader says
        return Kind.SUPPORT_DATA if b'"instrument_po' in text or b'"name_model"' in text else None
    if "points" in content and isinstance(content["points"], list):
        return Kind.LIDAR
    if is_model_state(content):
        return Kind.MODEL_STATE
    if str(content.get("program", "")).startswith(_PROGRAM):
        return Kind.OWN_RECORD
    if is_cube_json(content):
        return Kind.CUBE_TABLES
    return Kind.SUPPORT_DATA if "name_model" in content or "sensor_position" in content else None


def _shots(head: bytes, path: Path) -> Kind | None:
    """By sizes of binary records, which have no header, and values in the first ones."""
    size = path.stat().st_size
    if path.suffix.lower() == ".b" and size % FRAME.itemsize == 0:
        return Kind.SHOTS
    if size % RECORD.itemsize == 0 and is_lola_rdr(head):
        return Kind.SHOTS
    return None


def _rows(text: str, path: Path) -> Iterator[Kind | None]:
    """By the header of a table, or the first row of one that has none."""
    lines = [line for line in text.splitlines()[:100] if line.strip() and not line.lstrip().startswith("#")]
    first = lines[0] if lines else ""
    try:
        names = [name.strip().lower() for name in next(csv.reader([first], strict=True), [])]
    except csv.Error:
        return
    if {"id"} <= set(names) and {"image", "product", "serial_number"} & set(names):
        yield Kind.TIE_TABLE
    if LOLA_ROW.match(first) or is_archive(first.split("," if "," in first else None)):
        yield Kind.SHOTS
    placed = set(CARTESIAN) <= set(names) or {*PLANETOCENTRIC[:2]} <= set(names)
    yield Kind.ALTIMETRY if placed and GEODETIC[1] not in names else None
    yield Kind.GROUND_CONTROL if _GCP.fullmatch(first) else None


ImageKind = Literal["isd", "state", "label", "cube"]

_TEXT_HEAD = 512
_KEYS: dict[Kind | None, ImageKind] = {
    Kind.SUPPORT_DATA: "isd", Kind.MODEL_STATE: "state", Kind.CUBE_TABLES: "cube",
}  # fmt: skip
_OF_LABELS = (Kind.PDS3, Kind.CUBE, Kind.MAPPED_CUBE, Kind.CUBE_LABEL)


def image_kind(path: Path, kernels_of_its_own: bool = False, kernels: bool = False) -> ImageKind:
    """The kind of an image's file.

    Parameters
    ----------
    path : Path
        Image support data (JSON), model state, ISIS cube or its label, tables of a cube as JSON, or PDS3 label.
    kernels_of_its_own : bool
        Whether kernels are named for this very image, which go before the tables of its cube.
    kernels : bool
        Whether there are any kernels that a label could be read with.

    Raises
    ------
    InputError
        Missing file, or none of these.
    """
    kind = kind_of(path)
    if kind in _KEYS:
        return _KEYS[kind]
    if kind is None and head_of(path, _TEXT_HEAD).lstrip().startswith(b"{"):  # what is wrong in it, its reader says
        return "isd"
    if kind not in _OF_LABELS:
        raise _no_image(path, kind)
    root = read_label(path)
    if "PDS_VERSION_ID" in root:
        return "label"
    with_tables = has_tables(path, root)
    return "label" if kernels_of_its_own or (kernels and not with_tables) else "cube"


def refuse_foreign_kinds(path: Path) -> None:
    """Raise InputError for a file in whose place another has to be given; of JSON its reader says what is wrong."""
    if path.suffix.lower() not in (".json", ".isd") and (kind := kind_of(path)) in INSTEAD:
        raise _no_image(path, kind)


def _no_image(path: Path, kind: Kind | None) -> InputError:
    found = described(path, kind) if kind else "no image, label or support data"
    expected = "an ISIS cube, a PDS3 label, JSON of ALE or ISIS, or a model state of usgscsm"
    return InputError(str(path), found, expected, INSTEAD.get(kind, "") if kind else "")


def described(path: Path, kind: Kind) -> str:
    """A file that is no image, with the name that a PDS4 label gives its product."""
    name = _PDS4_NAME.search(head_of(path, _HEAD).decode("latin-1")) if kind is Kind.PDS4 else None
    return f"{kind} of {name[1]}" if name else str(kind)


def image_name(path: Path, kind: ImageKind) -> str:
    """Name of the image in control networks: ISIS's serial number, or the name in support data, or the file's."""
    if kind == "cube":
        return serial_number(path)
    if kind == "label":
        return label_of(path, read_label(path)).serial
    stated = read_state_json(path).get("m_imageIdentifier" if kind == "state" else "image_identifier")
    return stated if isinstance(stated, str) and stated else path.stem
