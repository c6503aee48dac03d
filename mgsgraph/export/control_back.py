"""An exported ISIS control network, read back without the writer, without protobuf and without our geometry.

The wire format is protobuf's (protobuf.dev, "Encoding"): keys of field number and wire type as varints, numbers as
eight little-endian bytes, messages behind their length. Layout and field numbers: DOI-USGS/ISIS3,
ControlNetVersioner.cpp and ControlPointFileEntryV0002.proto.
"""

import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.export.round_trip import MeasuredPlaces
from mgsgraph.files.opening import read_bytes

Numbers = np.ndarray[Any, np.dtype[np.float64]]

_NETWORK = "network.net"
_LABEL = 65536
_POINT = {"id": 1, "x": 20, "y": 21, "z": 22, "measures": 25}
_MEASURE = {"image": 1, "sample": 3, "line": 4, "sample residual": 5, "line residual": 6, "ignore": 10}
_FIRST_CENTRE = 0.5
"""The first pixel's centre, (1, 1) in the file, is (0.5, 0.5) in the solution."""


class ControlDifferences(NamedTuple):
    """How far a network is from a solution, a row for each of the solution's measures; infinite where it is missing."""

    measured: Numbers
    """(k,) px, of the measure."""
    predicted: Numbers
    """(k,) px, of the measure less its residual from where the adjusted orientation sees the point; NaN where it
    doesn't."""
    points: Numbers
    """(k,) m, of the adjusted point."""


def control_differences(folder: Path, wanted: MeasuredPlaces) -> ControlDifferences:
    """Compare folder/network.net with the measures and adjusted points of a solution.

    Raises InputError when the file is missing or no network of version 5.
    """
    found = dict(_measures(folder / _NETWORK))
    missing = (np.inf,) * 7
    rows = np.array([found.get(key, missing) for key in zip(wanted.point, wanted.image, strict=True)]).reshape(-1, 7)
    measured, residual, points = rows[:, :2] - _FIRST_CENTRE, rows[:, 2:4], rows[:, 4:]
    with np.errstate(invalid="ignore"):  # infinite less infinite where a measure is missing
        off = np.hypot(*(measured - residual - wanted.predicted).T)
        lost = np.isinf(rows).any(axis=1) & ~np.isnan(wanted.predicted).any(axis=1)
        places = np.linalg.norm(points - wanted.points, axis=1)
    return ControlDifferences(np.hypot(*(measured - wanted.measured).T), np.where(lost, np.inf, off), places)


def _measures(path: Path) -> Iterator[tuple[tuple[str, str], tuple[float, ...]]]:
    """By point and image: line, sample, their residuals, and the adjusted place of the point; infinite where unset.
    Ignored measures are passed over.
    """
    data = read_bytes(path)
    try:
        for point in _points(data):
            fields = _fields(point)
            place = _doubles(fields, [_POINT[axis] for axis in "xyz"])
            name = fields[_POINT["id"]][-1].decode()
            for message in fields.get(_POINT["measures"], []):
                measure = _fields(message)
                if any(measure.get(_MEASURE["ignore"], [b"\0"])[-1]):
                    continue
                numbers = [_MEASURE[key] for key in ("line", "sample", "line residual", "sample residual")]
                yield (name, measure[_MEASURE["image"]][-1].decode()), (*_doubles(measure, numbers), *place)
    except (IndexError, KeyError, ValueError, struct.error) as error:
        raise InputError(str(path), f"no sound network ({error!r})", "an ISIS control network of version 5") from None


def _points(data: bytes) -> Iterator[bytes]:
    """Messages of the points, each behind its size."""
    label = data[:_LABEL].split(b"\0")[0].decode()
    keys = dict(re.findall(r"(\w+)\s*=\s*(\d+)\s*\n", label))
    if keys["Version"] != "5":
        raise ValueError(f"version {keys['Version']}")
    at, end = int(keys["PointsStartByte"]), int(keys["PointsStartByte"]) + int(keys["PointsBytes"])
    if end != len(data):
        raise ValueError(f"{len(data)} bytes instead of {end}")
    while at < end:
        size = struct.unpack_from("<I", data, at)[0]
        at += 4 + size
        if at > end:
            raise ValueError("a point cut short")
        yield data[at - size : at]


def _fields(message: bytes) -> dict[int, list[bytes]]:
    """Raw bytes of each field of a message, by its number; varints are left as they are."""
    found, at = dict[int, list[bytes]](), 0
    while at < len(message):
        key, at = _varint(message, at)
        start = at
        match key & 7:
            case 0:
                _, at = _varint(message, at)
            case 1:
                at += 8
            case 2:
                size, start = _varint(message, at)
                at = start + size
            case 5:
                at += 4
            case kind:
                raise ValueError(f"wire type {kind}")
        if at > len(message):
            raise ValueError("a field cut short")
        found.setdefault(key >> 3, []).append(message[start:at])
    return found


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """A number of seven bits a byte, lowest first, and where it ends."""
    value = shift = 0
    while True:
        byte, at = data[at], at + 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7


def _doubles(fields: dict[int, list[bytes]], numbers: list[int]) -> tuple[float, ...]:
    return tuple(struct.unpack("<d", fields[k][-1])[0] if k in fields else float("inf") for k in numbers)
