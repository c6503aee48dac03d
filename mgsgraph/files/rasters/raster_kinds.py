"""What a raster file is, by its head, whatever it is called: GDAL's driver for it, and no other, may open it.

A label may lead to data beside it, and nowhere else. GDAL takes damaged keys of labels for absent ones, and these for
zero or the usual: what it needs must be there.
"""

import re
from pathlib import Path
from typing import NamedTuple

from mgsgraph.errors import InputError
from mgsgraph.files.labels.image_label import files_called, label_text
from mgsgraph.files.opening import ANY_SIZE, head_of, opened
from mgsgraph.files.pvl import Block, Document, whole_label

_HEAD = 1 << 20
"""bytes in which a label has to end."""
_NAME = rb"[\w.\-]+"
"""Of a file in the label's folder."""


class _Kind(NamedTuple):
    """What tells a kind of raster file, and where it names other files."""

    driver: str
    """GDAL's."""
    begins: re.Pattern[bytes]
    """The head of such a file."""
    label_ends: re.Pattern[bytes] | None = None
    """How its label does, where it has one."""
    names: re.Pattern[bytes] | None = None
    """Keys by which the label names files."""
    allowed: re.Pattern[bytes] | None = None
    """The same with a value that is none, or is the name of a file beside it, which is the group of the pattern."""


_PVL_ENDS = re.compile(rb"\n(?:END|End)(?=[ \t]*(?:[\r\n\0]|\Z))")
_KINDS = (
    _Kind("GTiff", re.compile(rb"II[*+]\0|MM\0[*+]")),
    _Kind("PNG", re.compile(rb"\x89PNG\r\n\x1a\n")),
    _Kind("JPEG", re.compile(rb"\xff\xd8\xff")),
    _Kind("VICAR", re.compile(rb"LBLSIZE=\d")),
    _Kind(
        "PDS4", re.compile(rb"\s*<\?xml.{0,3000}<(?:\w+:)?Product_Observational", re.DOTALL),
        re.compile(rb"</(?:\w+:)?Product_Observational>"), re.compile(rb"file_name", re.IGNORECASE),
        re.compile(rb"<file_name>\s*(" + _NAME + rb")\s*</file_name>"),
    ),
)  # fmt: skip
"""Those told by their first bytes."""
_CUBE = _Kind(
    "ISIS3", re.compile(rb""), _PVL_ENDS,
    re.compile(rb"\^core|\bformat(?:[\s=\"'(]|(?>/\*.*?\*/)|(?>#[^\n]*))*+geotiff", re.IGNORECASE | re.DOTALL),
    re.compile(rb"\^core\s*=\s*\"?(" + _NAME + rb")\"?\s", re.IGNORECASE),
)  # fmt: skip
_PDS = _Kind(
    "PDS", re.compile(rb""), _PVL_ENDS, re.compile(rb"\^(?:\w*_)?(?:qube|image)\b|compressed_file", re.IGNORECASE),
    re.compile(
        rb"\^(?:\w*_)?(?:qube|image)\s*=\s*(?:\d+(?:\s*<bytes>)?|\(?\s*\"(" + _NAME
        + rb")\"\s*(?:,\s*\d+(?:\s*<bytes>)?\s*)?\)?)\s",
        re.IGNORECASE,
    ),
)  # fmt: skip
"""Those told by the labels that `image_label` knows."""
_BYTES = {
    "unsignedbyte": 1, "signedword": 2, "unsignedword": 2, "signedinteger": 4, "unsignedinteger": 4, "real": 4,
    "double": 8,
}  # fmt: skip
"""Of a pixel, by what ISIS calls its type."""
_OTHERS = {
    rb"\s*(?:<\?xml[^>]*>\s*)?<(?:VRTDataset|OGRVRT)": "a virtual raster (VRT), which names the files to be read",
    rb"\s*(?:<\?xml[^>]*>\s*)?<(?:GDAL_W|WMS_|WCS_|WMTS|GDALTileIndex)": "the description of a service, not a raster",
    rb"\x89HDF": "an HDF5 or netCDF-4 file, which may name others",
    rb"CDF[\1\2\5]": "a netCDF file",
    rb"EHFA_HEADER_TAG": "an Erdas Imagine file, which may name others",
    rb"\0\0\0\x0cjP  |\xff\x4f\xff\x51": "a JPEG 2000 file, whose damage doesn't show",
    rb"PCIDSK": "a PCIDSK file, which may name others",
}
"""By their heads, what users have besides, and GDAL translates."""


class RasterKind(NamedTuple):
    """How a raster file is to be opened."""

    driver: str
    """GDAL's."""
    stated: tuple[int, int, int] | None = None
    """Lines, samples and bytes of a pixel by its PVL label."""


def raster_kind(path: Path, expected: str) -> RasterKind:
    """What a raster file is.

    Raises
    ------
    InputError
        Where it is missing, none of those that are known here, or its label is damaged or leads elsewhere.
    """
    head = head_of(path, _HEAD)
    kind = next((one for one in _KINDS if one.begins.match(head)), None)
    label = label_text(head) if kind is None else None
    if label is not None:
        kind = _PDS if label.startswith("PDS_VERSION_ID") else _CUBE
    if kind is None:
        found = next((name for begin, name in _OTHERS.items() if re.match(begin, head)), "no raster that is known here")
        kinds = "GeoTIFF, ISIS cube, PDS image, VICAR, PNG or JPEG"
        raise InputError(str(path), found, f"{expected} ({kinds})", whole_remedy(path))
    if kind.label_ends is None:
        return RasterKind(kind.driver)
    end = kind.label_ends.search(head)
    if end is None:
        raise InputError(str(path), "a label without an end", f"one within {_HEAD} bytes", "fetch it anew")
    _require_beside(path, head, kind)
    if label is None:
        return RasterKind(kind.driver)
    root = whole_label(Document(str(path), label))
    stated, begin = (_of_cube if kind is _CUBE else _of_image)(root)
    if begin is not None and begin < end.end():
        raise InputError(str(path), f"pixels from byte {begin} on, within its label", "behind it", "fetch it anew")
    return RasterKind(kind.driver, stated)


def whole_remedy(path: Path) -> str:
    """What makes one file of a raster that lies in several."""
    whole = f"{path.stem}_whole.tif" if path.suffix.lower().startswith(".tif") else f"{path.stem}.tif"
    return f"make one GeoTIFF of it: gdal_translate {path.name} {whole}"


def _require_beside(path: Path, head: bytes, kind: _Kind) -> None:
    """Raise InputError where a label names data in another folder, compressed ones, or what is no file; all of the head
    is looked at, for a label that ends here may go on for GDAL.
    """
    if kind.names is None or kind.allowed is None:
        return
    for name in kind.allowed.findall(head):
        for beside in files_called(path, name.decode()) if name else ():
            with opened(beside, ANY_SIZE):  # no pipe, for which GDAL would wait
                pass
    if kind.names.search(kind.allowed.sub(b"", head)):
        raise InputError(
            str(path), "a label whose data are in another folder, or compressed in another file",
            "the data in the file, or in one beside it", whole_remedy(path),
        )  # fmt: skip


def _of_cube(root: Block) -> tuple[tuple[int, int, int], int | None]:
    """What a cube's label states, and the byte of its first pixel, None where that is in another file; InputError where
    it lacks what GDAL needs.
    """
    core = root.inner("IsisCube").inner("Core")
    size, pixels = core.inner("Dimensions"), core.inner("Pixels")
    size.count("Bands")
    for block, key in ((pixels, "ByteOrder"), (core, "Format")):
        block.text(key)
    for key in ("TileSamples", "TileLines") if core.text("Format").lower() == "tile" else ():
        core.count(key)
    each = _BYTES.get(pixels.text("Type").lower())
    if each is None:
        raise InputError(pixels.where("Type"), pixels.text("Type"), f"one of {', '.join(_BYTES)}")
    return (size.count("Lines"), size.count("Samples"), each), None if "^Core" in core else core.count("StartByte") - 1


def _of_image(root: Block) -> tuple[tuple[int, int, int] | None, int | None]:
    """The same of a PDS3 label; nothing of a qube."""
    if "^IMAGE" not in root:
        return None, None
    image = root.inner("IMAGE")
    image.text("SAMPLE_TYPE")
    stated = image.count("LINES"), image.count("LINE_SAMPLES"), image.count("SAMPLE_BITS") // 8
    entry = root.entries["^image"]
    *names, last = [entry.value] if isinstance(entry.value, str) else entry.value
    record = int(last) if last.isdecimal() else 1
    begin = (record - 1) * (1 if entry.unit == "bytes" or record == 1 else root.count("RECORD_BYTES"))
    return stated, None if names or not last.isdecimal() else begin
