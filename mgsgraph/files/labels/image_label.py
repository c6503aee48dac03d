"""Labels of images, PDS3 (attached or detached) or of ISIS cubes: found, told apart, and where they say data lie."""

import re
from pathlib import Path

from mgsgraph.errors import InputError
from mgsgraph.files.opening import head_of
from mgsgraph.files.pvl import Block, Document, whole_label

_HEAD = 1 << 20
"""bytes; no label of a planetary image comes near."""
_DIGITS = 15
"""Of the longest place in a file."""
_BEGIN = re.compile(rb"(?:\s*(?:CCSD|#)[^\r\n]*[\r\n])*\s*(PDS_VERSION_ID|Object\s*=\s*IsisCube\b)", re.IGNORECASE)
"""Behind the label of a standard formatted data unit (CCSD...) and comments."""


def read_label(path: Path) -> Block:
    """The label of an image, as one block: at its head, or beside it with the ending ``.lbl``.

    Raises
    ------
    InputError
        Missing or unreadable file, no label, or a label that is no PVL.
    """
    text = _head(path)
    if text is None:
        beside = [path.with_suffix(suffix) for suffix in (".lbl", ".LBL") if path.with_suffix(suffix).is_file()]
        text = _head(beside[0]) if beside else None
        path = beside[0] if beside else path
    if text is None:
        raise InputError(
            str(path), "no label", "PDS_VERSION_ID = PDS3 or Object = IsisCube at its head, or a .lbl beside it"
        )
    return whole_label(Document(str(path), text))


def _head(path: Path) -> str | None:
    """The text at the head of a file; None where there is none."""
    return label_text(head_of(path, _HEAD))


def label_text(head: bytes) -> str | None:
    """The label of an image at the head of a file, from its first key on; None where there is none."""
    begin = _BEGIN.match(head)
    # pixels that follow are never parsed: PVL ends at its END; a cube fills up with NUL
    return head[begin.start(1) :].split(b"\0", 1)[0].decode("latin-1").replace("\r\n", "\n") if begin else None


def cube_of(root: Block) -> Block | None:
    """The cube that an ISIS label describes, which is in camera geometry; None for a PDS3 label."""
    if "PDS_VERSION_ID" in root:
        return None
    cube = root.inner("IsisCube")
    for block in cube.blocks:
        if block.name == "mapping":
            raise InputError(block.where(), "a map-projected cube", "an image in camera geometry (before cam2map)")
    return cube


def cube_size(cube: Block) -> tuple[int, int]:
    """Lines and samples of a whole cube: a cropped or reduced one no longer begins when its label says."""
    core = cube.inner("Core").inner("Dimensions")
    size = core.count("Lines"), core.count("Samples")
    for block in cube.blocks:
        if block.name == "alphacube" and (block.count("AlphaLines"), block.count("AlphaSamples")) != size:
            whole = f"{block.count('AlphaLines')} x {block.count('AlphaSamples')}"
            raise InputError(block.where(), f"{size[0]} x {size[1]} pixels cut out of {whole}", "the whole image")
    return size


def instrument_of(path: Path) -> str:
    """What the label of an image calls its instrument, in capitals: MOC-NA, MOC-WA, HRSC."""
    root = read_label(path)
    if "PDS_VERSION_ID" in root:
        return root.text("INSTRUMENT_ID").upper()
    return root.inner("IsisCube").inner("Instrument").text("InstrumentId").upper()


def data_location(path: Path, root: Block) -> tuple[Path, int]:
    """File and offset in bytes of ``^IMAGE``: a record or <BYTES>, in this file or in the one it names."""
    record = root.count("RECORD_BYTES")
    if "^IMAGE" not in root:
        raise InputError(root.where(), "no ^IMAGE", "^IMAGE = record, or (file, record)")
    entry = root.entries["^image"]
    items = [entry.value] if isinstance(entry.value, str) else list(entry.value)
    place = items.pop() if items and items[-1].isdecimal() else "1"
    if len(items) > 1 or len(place) > _DIGITS or int(place) < 1:
        raise InputError(root.where("^IMAGE"), f"{entry.value}", "a record, a file, or (file, record)")
    offset = int(place) - 1 if entry.unit == "bytes" else (int(place) - 1) * record
    return (_beside(path, items[0], root) if items else path), offset


def _beside(path: Path, name: str, root: Block) -> Path:
    """The file of this name, in any case, in the label's folder."""
    if found := files_called(path, name):
        return found[0]
    raise InputError(root.where("^IMAGE"), f"the file {name}, which is not there", "it in the label's folder")


def files_called(path: Path, name: str) -> list[Path]:
    """Those of this name, in any case, in a file's folder; the one in just this case is the first."""
    found = [file for file in path.parent.iterdir() if file.name.lower() == name.lower()]
    return sorted(found, key=lambda file: file.name != name)


def bytes_around(image: Block) -> tuple[int, int]:
    """Bytes before and after each line's pixels, none where the label has neither."""
    keys = ("LINE_PREFIX_BYTES", "LINE_SUFFIX_BYTES")
    prefix, suffix = (int(image.number(key, {"": 1.0})) if key in image else 0 for key in keys)
    if min(prefix, suffix) < 0:
        raise InputError(image.where(), f"{min(prefix, suffix)} bytes before or after a line", "none, or some")
    return prefix, suffix
