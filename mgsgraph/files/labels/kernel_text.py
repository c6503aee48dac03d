"""What SPICE would cut off a text kernel without a word: ends of long lines, and of long texts such as paths."""

import re
from pathlib import Path

from mgsgraph.errors import InputError

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
        longest, length = max((len(one.replace(b"''", b"'")) for one in texts), default=0), len(line.rstrip())
        if longest > _LONGEST_TEXT:
            raise InputError(where, f"a text of {longest} characters", remedy=_REMEDY)
        if length > _LONGEST_LINE:
            raise InputError(where, f"a line of {length} characters", f"at most {_LONGEST_LINE}, as SPICE reads them")
