"""What SPICE takes from a damaged kernel without a word: a file that is cut short or whose summaries have another
length, which it may follow for ever, ends of long lines, and of long texts such as paths.
"""

import os
import re
import struct
from pathlib import Path

from mgsgraph.errors import InputError, require
from mgsgraph.files.opening import ANY_SIZE, opened

_RECORD, _WORD = 1024, 8
"""bytes of a binary kernel."""
_SUMMARIES = ((2, 5), (2, 6))
"""Numbers and integers of a segment's summary: of binary PCK, and of SPK and CK."""

_LONGEST_LINE, _LONGEST_TEXT = 132, 80
"""Characters of a line and of a text that SPICE takes (NAIF, kernel required reading)."""
_REMEDY = f"texts in kernels hold {_LONGEST_TEXT} characters; continue with +, or leave the path relative"
_ASSIGNED, _QUOTED = re.compile(rb"\s*([^\s='(+]+)\s*\+?="), re.compile(rb"'((?:[^']|'')*+)'")


def require_uncut(path: Path, text: bytes) -> None:
    """Raise InputError for a line of a kernel's data, or a text of a meta-kernel's, that is too long."""
    data, variable, paths = False, "", b"KERNELS_TO_LOAD" in text
    for number, line in enumerate(text.splitlines(), start=1):
        if line.strip() in (b"\\begindata", b"\\begintext"):
            data = line.strip() == b"\\begindata"
        if not data:
            continue
        if assigned := _ASSIGNED.match(line):
            variable = f", {assigned[1].decode('latin-1')}"
        where, texts = f"{path}, line {number}{variable}", _QUOTED.findall(line) if paths else []
        longest, length = max((len(word.replace(b"''", b"'")) for word in texts), default=0), len(line.rstrip())
        require(longest <= _LONGEST_TEXT, where, f"a text of {longest} characters", remedy=_REMEDY)
        if length > _LONGEST_LINE:
            raise InputError(where, f"a line of {length} characters", f"at most {_LONGEST_LINE}, as SPICE reads them")


def require_whole(path: Path) -> None:
    """Raise InputError for a missing file, and for a double precision array file (SPK, CK, binary PCK) that ends
    before the last word that its file record counts (NAIF, DAF required reading): SPICE trusts it.
    """
    with opened(path, ANY_SIZE) as file:
        record, size = file.read(_RECORD), os.fstat(file.fileno()).st_size
    if record.startswith((b"DAF/", b"NAIF/DAF")):
        order = ">" if record[88:96] == b"BIG-IEEE" else "<"
        needed = max(_RECORD, _WORD * (struct.unpack_from(f"{order}i", record.ljust(_RECORD), 84)[0] - 1))
        if size < needed:
            remedy = "it is cut short or damaged: fetch it again"
            raise InputError(str(path), f"{size} bytes", f"{needed} at least by its own header", remedy)


def require_summaries(path: Path) -> None:
    """Raise InputError for a double precision array file whose summaries are of another length than those of SPK, CK
    and PCK: SPICE reads on behind their end.
    """
    with opened(path, ANY_SIZE) as file:
        record = file.read(_RECORD)
    if record.startswith((b"DAF/", b"NAIF/DAF")):
        order = ">" if record[88:96] == b"BIG-IEEE" else "<"
        summary = struct.unpack_from(f"{order}2i", record.ljust(_RECORD), 8)
        if summary not in _SUMMARIES:
            found = f"summaries of {summary[0]} numbers and {summary[1]} integers"
            raise InputError(str(path), found, "2, and 5 or 6", "it is damaged: fetch it again")
