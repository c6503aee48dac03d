"""Records of what the program has written, as JSON that ends with its checksum: by it a flipped bit is found."""

import json
import zlib
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from mgsgraph.errors import InputError
from mgsgraph.files.opening import json_object, read_bytes

MATCH = "match.json"
"""Record that lies beside the networks that `mgsgraph match` has written."""
FILES = "sha256"
"""Key of a record for the digests of the files beside it, by their names."""
_KEY = "crc32"
_MARK = f',\n "{_KEY}": "%08x"\n}}\n'
"""How a record ends: with the CRC-32 of what stands before."""
_ALIKE = 10
"""bytes of 18 that an end has in common with the mark, from which on it is the mark, or was: flipped bits may hit it;
other ends of JSON have 3.
"""
_AT_ONCE = 2.0
"""s within which files are written by one command, or told apart by the times of a file system (FAT)."""
_REMEDY = "do again what wrote it; if it was changed on purpose, take its key crc32 out"


def record_text(record: Mapping[str, Any]) -> str:
    """A record, which is plain values, as the text of its file."""
    text = json.dumps(record, indent=1, allow_nan=False, ensure_ascii=False).removesuffix("\n}")
    return text + _MARK % zlib.crc32(text.encode())


def read_record(path: Path) -> dict[str, Any]:
    """A record without its checksum; one that was written before records had any is taken as it is.

    Raises
    ------
    InputError
        What `read_json` refuses; one that is not as it was written.
    """
    content, where = read_bytes(path), str(path)
    end = (_MARK % 0).encode()
    body, mark = content[: -len(end)], content[-len(end) :]
    sealed = mark == (_MARK % zlib.crc32(body)).encode()
    alike = sum(one == other for k, (one, other) in enumerate(zip(mark, end, strict=False)) if end[k : k + 1] != b"0")
    record = json_object(content, where) if sealed or alike < _ALIKE else {_KEY: ""}
    if not sealed and _KEY in record:
        raise InputError(where, "is damaged, or was changed (its checksum is another one)", remedy=_REMEDY)
    record.pop(_KEY, None)
    return record


def require_as_recorded(path: Path, content: bytes) -> None:
    """Raise InputError where a file has another content than `mgsgraph match` gave it, by the record beside it.

    A file that was written later (as qnet and cnetedit do) is another's: damage by a disk or a cable changes no time.
    """
    beside = path.with_name(MATCH)
    if not beside.is_file() or path.stat().st_mtime > beside.stat().st_mtime + _AT_ONCE:
        return
    known = read_record(beside).get(FILES)
    digest = known.get(path.name) if isinstance(known, dict) else None
    if digest is not None and digest != sha256(content).hexdigest():
        found, expected = "is damaged, or was changed since", f"the content that {MATCH} beside it has noted"
        remedy = "match again; if it was changed on purpose, touch it, or give it another name or folder"
        raise InputError(str(path), found, expected, remedy)
