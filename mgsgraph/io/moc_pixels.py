"""Where the pixels of a MOC image of the archive lie in its file (ISIS moc2isis)."""

from dataclasses import dataclass
from pathlib import Path

from mgsgraph.errors import InputError
from mgsgraph.io.image_label import bytes_around, data_location
from mgsgraph.io.pvl import Block

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
