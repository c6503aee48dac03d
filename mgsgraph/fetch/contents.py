"""Whether what has come is what its name promises: an archive's error page comes with status 200, too."""

from pathlib import Path

from mgsgraph.errors import InputError
from mgsgraph.io.image_label import read_label
from mgsgraph.io.pedr import FRAME

_HEAD = 8192
_RECORD = 1024
"""bytes of a record of SPICE's binary kernels."""
_BINARY = {".bsp": (b"DAF/SPK", b"NAIF/DAF"), ".bc": (b"DAF/CK", b"NAIF/DAF")}
"""Beginnings of SPICE's binary kernels; NAIF/DAF is the older one."""
_TEXT = (".tls", ".tsc", ".ti", ".tf", ".tpc")


def require_content(path: Path, name: str) -> None:
    """Raise InputError unless the file at `path` is what one called `name` has to be: a kernel, an image, a PEDR, a
    label, a table or a grid.
    """
    with path.open("rb") as file:
        head = file.read(_HEAD)
    size, suffix = path.stat().st_size, Path(name).suffix.lower()
    if head.lstrip()[:15].lower().startswith((b"<!doctype", b"<html", b"<?xml", b"<head")):
        raise InputError(name, "a web page instead of the file", _expected(suffix))
    if size == 0:
        raise InputError(name, "an empty file", _expected(suffix))
    sound = True
    if suffix in _BINARY:
        sound = head.startswith(_BINARY[suffix]) and size % _RECORD == 0
    elif suffix in _TEXT:
        sound = b"\\begindata" in path.read_bytes()
    elif suffix == ".b":
        sound = b"PDS_VERSION_ID" in head and size % FRAME.itemsize == 0
    elif suffix == ".lbl":
        sound = b"PDS_VERSION_ID" in head
    elif name.startswith("images/"):
        _require_whole_image(path, name)
    elif suffix == ".img":
        sound = size % 2 == 0
    if not sound:
        raise InputError(name, f"{size} bytes that begin with {head[:16]!r}", _expected(suffix))


def _expected(suffix: str) -> str:
    if suffix in _BINARY or suffix in _TEXT:
        return "a SPICE kernel, whole"
    return {".b": "a PEDR file of whole frames", ".lbl": "a PDS3 label"}.get(suffix, "the file")


def _require_whole_image(path: Path, name: str) -> None:
    """A label at the head, and as many bytes as it says, at least."""
    label = read_label(path)
    said = label.count("RECORD_BYTES") * label.count("FILE_RECORDS")
    if path.stat().st_size < said:  # longer ones are whole, too: some archives pad
        raise InputError(name, f"{path.stat().st_size} bytes", f"{said} by its own label")
