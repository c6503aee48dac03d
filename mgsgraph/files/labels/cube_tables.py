"""Tables that spiceinit and jigsaw attach to an ISIS cube: binary behind the label, or the same as JSON.

Layout: ISIS TableField (fields of doubles, record after record); what they mean: SpicePosition::LoadCache,
SpiceRotation::LoadCache. A table of positions or attitudes is a cache of samples, or the coefficients of polynomials of
scaled time (jigsaw, CacheType = PolyFunction): of X, Y, Z in km, or of three angles about the axes 3, 1, 3.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.errors import InputError, errors_from
from mgsgraph.files.opening import ANY_SIZE, opened
from mgsgraph.files.pvl import Block
from mgsgraph.geometry import rotation
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import AttitudeTable, PositionTable
from mgsgraph.units import KM

_JSON_NAMES = {
    "InstrumentPosition": "instrument_position", "InstrumentPointing": "instrument_pointing",
    "BodyRotation": "body_rotation", "SunPosition": "sun_position",
}  # fmt: skip
_QUATERNION, _ANGLES = ("J2000Q0", "J2000Q1", "J2000Q2", "J2000Q3"), ("J2000Ang1", "J2000Ang2", "J2000Ang3")
_POSITION, _VELOCITY = ("J2000X", "J2000Y", "J2000Z"), ("J2000XV", "J2000YV", "J2000ZV")
_COEFFICIENTS = ("J2000SVX", "J2000SVY", "J2000SVZ")
_REMEDY = "run spiceinit on the cube again, with its tables attached"
_LARGEST = 1e100
"""Larger numbers are ISIS's Null, or none at all."""
_NODES = 2049
"""Samples that a polynomial of jigsaw is laid out at; between them cubic and great arc are far below a micropixel."""


@dataclass(frozen=True, slots=True)
class CubeTable:
    """A table of a cube: where it is said, its numbers by field, and what its label says."""

    where: str
    """File and table, for messages."""
    columns: Mapping[str, Array]
    """(records,) by field, as the file has them: km, km/s, s TDB past J2000, rad."""
    constant: Array
    """(3, 3) constant rotation behind the sampled one."""
    first: float | None
    """s TDB past J2000 from which on the label says that it covers; None where it doesn't."""
    last: float | None
    """s TDB past J2000 up to which it does."""

    def stack(self, names: tuple[str, ...]) -> Array:
        """(records, k) of some fields."""
        for name in names:
            if name not in self.columns:
                raise InputError(self.where, f"the fields {', '.join(self.columns)}", ", ".join(names), _REMEDY)
        return np.stack([self.columns[name] for name in names], axis=1)

    @property
    def sampled(self) -> bool:
        """Whether it holds samples, not coefficients."""
        return "ET" in self.columns

    @property
    def times(self) -> Array:
        """(records,) s TDB past J2000 of the samples."""
        return self.stack(("ET",))[:, 0]

    @property
    def velocities(self) -> Array:
        """(records, 3) km/s."""
        return self.stack(_VELOCITY)

    @property
    def start(self) -> float:
        """First time, s TDB past J2000."""
        return float(self.times[0]) if self.sampled else self._stated(self.first)

    @property
    def stop(self) -> float:
        """Last time, s TDB past J2000."""
        return float(self.times[-1]) if self.sampled else self._stated(self.last)

    def _stated(self, time: float | None) -> float:
        if time is None:
            found, expected = "polynomials without the time that they are for", "its TableStartTime and TableEndTime"
            raise InputError(self.where, found, expected)
        return time


# --- as records


def position_table(table: CubeTable, epoch: float) -> PositionTable:
    """Positions in m, inertial, at times in s past an epoch."""
    with errors_from(table.where):
        if table.sampled:
            return PositionTable(table.times - epoch, table.stack(_POSITION) * KM, table.velocities * KM)
        times, values, rates = _laid_out(table, _COEFFICIENTS)
        return PositionTable(times - epoch, values * KM, rates * KM)


def attitude_table(table: CubeTable, epoch: float) -> AttitudeTable:
    """Attitude, inertial to the wanted frame, at times in s past an epoch."""
    with errors_from(table.where):
        if table.sampled:
            return AttitudeTable(table.times - epoch, table.stack(_QUATERNION), table.constant)
        times, angles, _ = _laid_out(table, _ANGLES)
        quaternions = rotation.from_matrix(rotation.from_angles_313(angles))
        return AttitudeTable(times - epoch, rotation.continuous(quaternions), table.constant)


def _laid_out(table: CubeTable, names: tuple[str, ...]) -> tuple[Array, Array, Array]:
    """Times (n,) in s TDB past J2000 over the table's coverage, values (n, 3) and rates (n, 3) of its polynomials.

    The last record holds base time, time scale and degree: t = (ET - base time) / time scale.
    """
    *coefficients, (base, scale, degree) = table.stack(names)
    if scale <= 0.0 or len(coefficients) != degree + 1.0:
        found = f"{len(coefficients)} coefficients of degree {degree:g}, time scale {scale:g} s"
        raise InputError(table.where, found, "degree + 1 coefficients and a positive time scale", _REMEDY)
    polynomial = np.polynomial.Polynomial
    times = np.linspace(table.start, table.stop, _NODES)
    of_axes = [polynomial(axis) for axis in np.stack(coefficients, axis=1)]
    with np.errstate(all="ignore"):  # the records that these are for take finite numbers only
        scaled = (times - base) / scale
        values = np.stack([axis(scaled) for axis in of_axes], axis=1)
        return times, values, np.stack([axis.deriv()(scaled) / scale for axis in of_axes], axis=1)


# --- as JSON


def tables_of_json(content: Mapping[str, Any], source: str) -> dict[str, CubeTable]:
    """Tables by ISIS's names."""
    found = dict[str, CubeTable]()
    for name, key in _JSON_NAMES.items():
        if key in content:
            found[name] = _of_json(content[key], f"{source}, {key}")
    return found


def _of_json(said: Any, where: str) -> CubeTable:
    if not isinstance(said, dict):
        raise InputError(where, repr(said)[:60], "a table")
    columns = dict[str, Array]()
    for key, names in (
        ("positions", _POSITION), ("velocities", _VELOCITY), ("quaternions", _QUATERNION),
    ):  # fmt: skip
        if key in said:
            values = _numbers(said[key], (None, len(names)), f"{where}, {key}")
            columns |= dict(zip(names, values.T, strict=True))
    if "ephemeris_times" in said:
        columns["ET"] = _numbers(said["ephemeris_times"], (None,), f"{where}, ephemeris_times")
    lengths = {column.size for column in columns.values()}
    if len(lengths) != 1 or 0 in lengths:
        found = ", ".join(f"{column.size} of {name}" for name, column in columns.items())
        raise InputError(where, found or "no columns", "as many of each, and some")
    constant = _numbers(said.get("constant_rotation", np.eye(3).ravel().tolist()), (9,), f"{where}, constant_rotation")
    return CubeTable(where, columns, constant.reshape(3, 3), None, None)


def _numbers(values: Any, shape: tuple[int | None, ...], where: str) -> Array:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(where, "what is not a table of numbers", "numbers") from None
    good = array.ndim == len(shape) and all(a in (None, b) for a, b in zip(shape, array.shape, strict=True))
    if not good or not (np.abs(array) < _LARGEST).all():
        wanted = " x ".join("n" if n is None else str(n) for n in shape)
        raise InputError(where, f"numbers of shape {array.shape}", f"{wanted} finite numbers")
    return array


# --- behind a label


def tables_of_label(path: Path, root: Block) -> dict[str, CubeTable]:
    """Tables of a cube, by their names; empty for a cube (or a label of one) that spiceinit has not been run on."""
    labels = {block.text("Name").lower(): block for block in root.blocks if block.name == "table"}
    return {name: _of_cube(path, labels[name.lower()], name) for name in _JSON_NAMES if name.lower() in labels}


def _of_cube(path: Path, label: Block, name: str) -> CubeTable:
    where = f"{path}, table {name}"
    fields = [block for block in label.blocks if block.name == "field"]
    for block in fields:
        if block.text("Type").lower() != "double" or block.count("Size") != 1:
            raise InputError(block.where(), f"a field of {block.count('Size')} {block.text('Type')}", "one Double")
    records, start, size = label.count("Records"), label.count("StartByte") - 1, label.count("Bytes")
    if size != records * len(fields) * 8:
        raise InputError(where, f"{size} bytes", f"{records} records of {len(fields)} doubles")
    order = ">" if label.text("ByteOrder").lower() == "msb" else "<"
    with opened(path, ANY_SIZE) as file:
        there = max(os.fstat(file.fileno()).st_size - start, 0)
        if there < size:
            remedy = "the cube is cut short, or a label alone: name the cube, or put its tables beside it (.isd)"
            raise InputError(where, f"{there} bytes from byte {start + 1} on", f"{size}", remedy)
        file.seek(start)
        raw = file.read(size)
    numbers = np.frombuffer(raw, f"{order}f8").astype(np.float64).reshape(records, len(fields))
    if not (np.abs(numbers) < _LARGEST).all():
        raise InputError(where, "values that are no numbers", "finite ones")
    kind = "Ck" if "Rotation" in name or "Pointing" in name else "Spk"
    ends = (f"{kind}Table{end}Time" for end in ("Start", "End"))
    return CubeTable(
        where,
        {block.text("Name"): numbers[:, k] for k, block in enumerate(fields)},
        np.array(label.numbers("ConstantRotation", 9)).reshape(3, 3) if "ConstantRotation" in label else np.eye(3),
        *(label.number(key) if key in label else None for key in ends),
    )
