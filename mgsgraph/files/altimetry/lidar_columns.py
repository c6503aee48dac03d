"""ISIS lidar data by columns (`altimetry.lidar`): JSON parsed by Arrow, without a Python object for each shot."""

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mgsgraph.errors import InputError
from mgsgraph.files.opening import name_of
from mgsgraph.geometry.records import LONGEST_NAME, Array, Index
from mgsgraph.names import Names, RepeatedNames

NUMBERS = ("time", "range", "sigmaRange", "longitude", "latitude", "radius")
"""Of a shot: s TDB past J2000, km, m, degrees, degrees, km."""
TRIANGLE, LARGEST_ELEMENT = 6, 1e18
"""Elements of a covariance's upper triangle, and bound of each."""
_REAL, _TEXT = pa.float64(), pa.large_string()
_ADJUSTED = ("adjustedLatitude", "adjustedLongitude", "adjustedRadius")
_MATRICES = ("aprioriMatrix", "adjustedMatrix")
_MEASURE = pa.struct([("line", _REAL), ("sample", _REAL), ("serialNumber", _TEXT)])
_SHOT = pa.struct([
    ("id", _TEXT), *((name, _REAL) for name in (*NUMBERS, *_ADJUSTED)),
    *((name, pa.list_(_REAL)) for name in _MATRICES), ("simultaneousImages", pa.list_(_TEXT)),
    ("measures", pa.list_(_MEASURE)),
])  # fmt: skip
_SCHEMA = pa.schema([("points", pa.list_(_SHOT))])
_LARGEST = 2.0**63
"""From which on a whole number is none to `files.opening`."""


@dataclass(frozen=True, slots=True, eq=False)
class LidarColumns:
    """Shots as a file has them, in its units and counts."""

    ids: Names
    numbers: dict[str, Array]
    """Each (n,), by `NUMBERS`."""
    triangles: Array
    """(n, 6)."""
    simultaneous_shot: Index
    """(r,)."""
    simultaneous_image: RepeatedNames
    """(r)."""
    measure_shot: Index
    """(k,)."""
    measure_image: RepeatedNames
    """(k)."""
    measures: Array
    """(k, 2) line and sample."""


def lidar_columns(content: bytes) -> LidarColumns | None:
    """Shots of a JSON text; None where it leaves a doubt: it is damaged, has other keys, one twice or not at all, other
    kinds of values, numbers or names that can't be, or an image twice in a shot. Bounds of all but covariances are for
    the caller to check.
    """
    shots = _parsed(content)
    if shots is None or not len(shots):
        return None
    try:
        return _columns({one.name: shots.field(k) for k, one in enumerate(_SHOT)})
    except (_Doubtful, InputError):
        return None


class _Doubtful(Exception):
    """What the other reader has to look at."""


def _parsed(content: bytes) -> pa.Array | None:
    from pyarrow import json

    try:
        read = json.ReadOptions(use_threads=False, block_size=len(content) + 1)  # one object: one row
        how = json.ParseOptions(
            explicit_schema=_SCHEMA, newlines_in_values=True, unexpected_field_behavior="error"
        )
        table = json.read_json(pa.BufferReader(content), read, how)
        if table.num_rows != 1 or not (content.isascii() or content.decode()):
            return None
        return _elements(table["points"].combine_chunks())[0]
    except (ValueError, OverflowError, _Doubtful):  # Arrow's are among them, and those of text that is no UTF-8
        return None


def _columns(of: dict[str, pa.Array]) -> LidarColumns:
    triangles = _triangles(of["aprioriMatrix"])
    for name in _ADJUSTED:  # of an earlier adjustment; not used, but looked at
        _numbers(of[name].drop_null())
    _triangles(of["adjustedMatrix"].drop_null())
    along, shot_along = _elements(of["simultaneousImages"])
    measures, shot_measured = _elements(of["measures"])
    line, sample, image = (measures.field(k) for k in range(3))
    found = LidarColumns(
        _ids(of["id"]), {name: _numbers(of[name]) for name in NUMBERS}, triangles,
        shot_along, _images(along), shot_measured, _images(image), np.column_stack([_numbers(line), _numbers(sample)]),
    )  # fmt: skip
    codes = found.measure_shot * len(found.measure_image.distinct) + found.measure_image.numbers
    if np.any(np.diff(np.sort(codes, kind="stable")) == 0):
        raise _Doubtful
    return found


def _triangles(column: pa.Array) -> Array:
    """Upper triangles (n, 6) of covariances."""
    flat, owners = _elements(column)
    values = _numbers(flat)
    if np.any(np.bincount(owners, minlength=len(column)) != TRIANGLE) or np.any(np.abs(values) > LARGEST_ELEMENT):
        raise _Doubtful
    return values.reshape(-1, TRIANGLE)


def _elements(lists: pa.Array) -> tuple[pa.Array, Index]:
    """What lists (n) hold, and the number of each one's list."""
    flat = lists.flatten()
    if lists.null_count or flat.null_count:
        raise _Doubtful
    return flat, np.repeat(np.arange(len(lists)), np.from_dlpack(pc.list_value_length(lists)).astype(np.int64))


def _numbers(column: pa.Array) -> Array:
    """Numbers (n,), all of which are there."""
    if column.null_count:
        raise _Doubtful
    values: Array = np.from_dlpack(column).astype(np.float64, copy=False)
    if not np.all(np.abs(values) < _LARGEST) or np.any(np.signbit(values) & (values == 0.0)):
        raise _Doubtful  # a whole -0 is 0 to Python
    return values


def _ids(column: pa.Array) -> Names:
    if column.null_count:
        raise _Doubtful
    names = Names.of(column)
    sizes = np.diff(names.offsets)
    if not sizes.all() or sizes.max() > LONGEST_NAME or not names.text.isprintable():
        raise _Doubtful
    return names


def _images(column: pa.Array) -> RepeatedNames:
    if column.null_count:
        raise _Doubtful
    names = RepeatedNames.of(column)
    for name in names.distinct:
        name_of(name, "")
    return names
