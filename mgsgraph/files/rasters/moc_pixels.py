"""Where the pixels of a MOC image of the archive lie in its file (ISIS moc2isis)."""

import os
import struct
from dataclasses import dataclass
from pathlib import Path

from mgsgraph.errors import InputError
from mgsgraph.files.labels.image_label import bytes_around, data_location
from mgsgraph.files.opening import opened, understood
from mgsgraph.files.pvl import Block

_LABEL = 2048
"""bytes before the first fragment of a compressed image."""
_FRAGMENT = 62
"""bytes of a fragment's header; one follows its content."""
_CELL = 16
"""Lines and samples in which fragments are counted."""
_TRANSFORMED, _LAST = 0b1100, 0b10
"""Bits of a header's compression, and of its status."""
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


def pixel_area(path: Path, root: Block) -> PixelArea:
    """That of an image, by its PDS3 label, which is in the file `path` or beside it."""
    image = root.inner("IMAGE")
    if image.number("SAMPLE_BITS", {"": 1.0}) != 8.0:
        raise InputError(image.where("SAMPLE_BITS"), image.text("SAMPLE_BITS"), "8, as all MOC images have")
    prefix, suffix = bytes_around(image)
    encoding = image.text("ENCODING_TYPE") if "ENCODING_TYPE" in image else ""
    size = root.count("RECORD_BYTES") * root.count("FILE_RECORDS") if "FILE_RECORDS" in root else 0
    file, offset = data_location(path, root)
    return PixelArea(file, offset, prefix, suffix, "" if encoding.lower() in _NOTHING else encoding, size)


def require_fragments(area: PixelArea, lines: int, samples: int) -> None:
    """Raise InputError unless the fragments of a compressed image follow each other up to the last one, and are of an
    image of this size: what is decompressed takes memory and time by their headers (which pdr follows).
    """
    where, damaged = str(area.file), "it is damaged: fetch it again"
    if area.offset != _LABEL:
        raise InputError(where, f"compressed pixels after {area.offset} bytes", f"a label of {_LABEL}", damaged)
    with opened(area.file, 1 << 32) as file, understood(where, "a compressed MOC image", damaged):
        size, place, high = os.fstat(file.fileno()).st_size, _LABEL, 0
        while True:
            file.seek(place)
            head = file.read(_FRAGMENT)
            length = struct.unpack_from("<I", head, 58)[0]
            place += _FRAGMENT + length + 1
            part, whole = (_CELL * struct.unpack_from("<H", head, at)[0] for at in (6, 40))
            transformed = head[44] & _TRANSFORMED
            high = high + part if transformed else whole
            found = (high, _CELL * head[43])
            if length == 0 or place > size + 1 or found[1] != samples or found[0] > lines:
                raise InputError(
                    where, f"a fragment of {length} bytes for {found[0]} x {found[1]} pixels",
                    f"one of those of {lines} x {samples}", damaged,
                )  # fmt: skip
            if head[13] & _LAST or (transformed and high == lines):
                return
