"""Structure of SPICE's binary kernels that are double precision array files (SPK, CK, binary PCK): SPICE trusts it.

NAIF, DAF required reading: a file record; summary records in a chain, each the number of the next and of its summaries
before these; arrays of double words, whose first and last word each summary says.
"""

import os
import struct
from pathlib import Path
from typing import BinaryIO

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.opening import ANY_SIZE, opened

_ORDERS = {b"LTL-IEEE": "<", b"BIG-IEEE": ">"}
_RECORD, _WORD = 1024, 8
"""bytes."""
_SUMMARIES = _RECORD // _WORD - 3
"""Words of the summaries in a record."""
_PARTS = (2, 5), (2, 6)
"""Numbers of doubles and integers in a summary of a binary PCK, and of an SPK or a CK."""
_REMEDY = "it is cut short or damaged: fetch it again"


def require_sound(path: Path) -> None:
    """Raise InputError for what is no file, and for a DAF that is cut short or whose summaries contradict its size.

    Files of other kinds pass, and those of byte orders that SPICE itself refuses.
    """
    with opened(path, ANY_SIZE) as file:
        record, size = file.read(_RECORD), os.fstat(file.fileno()).st_size
        if not record.startswith((b"DAF/", b"NAIF/DAF")):
            return
        order = _ORDERS.get(record[88:96])
        if order is None:
            _require_size(path, size, _RECORD)
            return
        _require_size(path, size, max(_RECORD, _WORD * (struct.unpack_from(f"{order}i", record.ljust(96), 84)[0] - 1)))
        _require_chain(path, file, record, order, size)


def _require_size(path: Path, size: int, needed: int) -> None:
    """The first free double word of a file record is the one behind the last."""
    if size < needed:
        raise InputError(str(path), f"{size} bytes", f"{needed} at least by its own header", _REMEDY)


def _require_chain(path: Path, file: BinaryIO, record: bytes, order: str, size: int) -> None:
    doubles, integers = struct.unpack_from(f"{order}2i", record, 8)
    number, last, free = struct.unpack_from(f"{order}3i", record, 76)
    words = doubles + (integers + 1) // 2
    if (doubles, integers) not in _PARTS:
        found = f"summaries of {doubles} numbers and {integers} integers"
        raise InputError(str(path), found, "2 and 6 of an SPK or CK, 2 and 5 of a PCK", _REMEDY)
    before, records, seen = 0, size // _RECORD, set[int]()
    while number:
        where = f"{path}, summary record {number}"
        if not 1 < number <= records or number in seen:
            found = "a record that led there" if number in seen else "no such record"
            raise InputError(where, found, f"another one of 2 .. {records}", _REMEDY)
        seen.add(number)
        file.seek((number - 1) * _RECORD)
        content = file.read(_RECORD)
        following, previous, count = struct.unpack_from(f"{order}3d", content)
        whole = all(np.isfinite(one) and one == int(one) for one in (following, previous, count))
        if not whole or previous != before or not 0 <= count <= _SUMMARIES // words:
            found = f"{following:g} as the next record, {previous:g} as the one before, {count:g} summaries"
            raise InputError(where, found, f"whole numbers, {before} and {_SUMMARIES // words} at most", _REMEDY)
        _require_arrays(content[3 * _WORD :], int(count), (doubles, integers), f"{order}i4", free, where)
        before, number = number, int(following)
    if before != last:
        found = f"summaries that end with record {before}"
        raise InputError(str(path), found, f"with {last}, as its file record says", _REMEDY)


def _require_arrays(content: bytes, count: int, parts: tuple[int, int], kind: str, free: int, where: str) -> None:
    """Raise InputError where an array isn't between the records and the first free word."""
    doubles, integers = parts
    words = doubles + (integers + 1) // 2
    table = np.frombuffer(content, kind, count * words * 2).reshape(count, words * 2)
    for begin, end in table[:, 2 * doubles + integers - 2 : 2 * doubles + integers].tolist():
        if not _RECORD // _WORD < begin <= end < free:
            raise InputError(where, f"an array of words {begin} .. {end}", f"some before word {free}", _REMEDY)
