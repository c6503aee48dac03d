"""The solution as one file, solution.npz, from which it is read back bit for bit.

Every array of the record lies under its own path (`network.points.places`, `joint_covariance.blocks`), so that plain
NumPy reads it too; everything else is a JSON text under `record`. Nothing is pickled: reading an archive runs no code
of its.
"""

import io
import json
import math
import re
import types
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import StrEnum
from functools import cache, reduce
from operator import getitem
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError, errors_from, require
from mgsgraph.files.opening import json_object, opened, understood
from mgsgraph.geometry.camera import MODELS, Distortion
from mgsgraph.geometry.image import ExteriorOrientation, PolynomialTrajectory
from mgsgraph.geometry.records import Array, assign
from mgsgraph.geometry.trajectory import AttitudeTable, FixedTrajectory, Trajectory
from mgsgraph.network import NodePrior, PolynomialPrior, ProcessPrior

if TYPE_CHECKING:
    from mgsgraph.adjustment.solution import Solution

Arrays = dict[str, NDArray[Any]]
"""Arrays by the path of fields that leads to them."""
Kind = TypeVar("Kind")

_KINDS: dict[Any, dict[str, Any]] = {
    protocol: {kind.__name__: kind for kind in kinds}
    for protocol, kinds in (
        (Distortion, MODELS), (ExteriorOrientation, (Trajectory, FixedTrajectory, PolynomialTrajectory)),
    )
}
"""Records that may stand where a protocol is declared; the record says which it is."""
_KIND_NAMES = {name for kinds in _KINDS.values() for name in kinds}
_KIND_NAMES |= {prior_kind.__name__ for prior_kind in (NodePrior, PolynomialPrior, ProcessPrior)}
_REWRITE = "write it again with the program that made it"
_HEADER = re.compile(
    rb"\x93NUMPY\x01\x00(..)\{'descr': '([<|][biufU]\d{1,9})', 'fortran_order': (True|False), "
    rb"'shape': \(([\d, ]{0,200})\), \} *\n", re.DOTALL,
)
"""What NumPy writes before the numbers of an array, of the kinds that records have."""
_VERSION, _RECORD = "format", "record"
"""Members beside the arrays that the record names."""


def pack(record: Any) -> bytes:
    """A record as the bytes of an .npz file; the same record gives the same bytes."""
    file = io.BytesIO()
    np.savez(file, **_members(record))  # type: ignore[arg-type]  # NumPy's stub takes any name for allow_pickle
    return file.getvalue()


def _members(record: Any) -> Arrays:
    arrays: Arrays = {}
    text = json.dumps(to_arrays(record, "", arrays), allow_nan=False)
    return {"record": np.frombuffer(text.encode(), dtype=np.uint8), **arrays}


def unpack(data: bytes, kind: type[Kind], where: str) -> Kind:
    """The record of a kind that `pack` made the bytes of; InputError naming `where` for anything else."""
    with errors_from(where), understood(where, f"a record of kind {kind.__name__}", _REWRITE):
        arrays = read_members(io.BytesIO(data))
        record: Kind = from_arrays(record_of(arrays), kind, "", arrays)
        return record


def unpack_parts(data: bytes, kinds: Mapping[str, Any], where: str) -> list[Any]:
    """Parts of the record that `pack` made the bytes of, without its other arrays.

    Parameters
    ----------
    data : bytes
        All of the record.
    kinds : mapping
        Type of each part by the path of fields that leads to it ("image.timing").
    where : str
        What to call the record in messages.

    Raises
    ------
    InputError
        For anything else, and a part that is not there.
    """
    with errors_from(where), understood(where, f"a record with {', '.join(kinds)}", _REWRITE):
        arrays = read_members(io.BytesIO(data), lambda name: name == _RECORD or name.startswith(tuple(kinds)))
        record = json_object(arrays[_RECORD].tobytes(), _RECORD)
        return [
            from_arrays(reduce(getitem, path.split("."), record), kind, path, arrays) for path, kind in kinds.items()
        ]


def record_of(arrays: Arrays) -> dict[str, Any]:
    """What the text in an archive says; InputError where an array is there that it does not name."""
    record = json_object(arrays[_RECORD].tobytes(), _RECORD)
    for name in sorted(arrays.keys() - set(_array_paths(record)) - {_VERSION, _RECORD})[:1]:
        raise InputError(name, "an array that the archive's record does not name", remedy=_REWRITE)
    return record


def _array_paths(value: Any) -> Iterator[str]:
    """Paths of the arrays in a record as `to_arrays` gives it."""
    if isinstance(value, dict):
        if value.keys() == {"array"}:
            yield str(value["array"])
        for item in value.values():
            yield from _array_paths(item)
    elif isinstance(value, list):
        for item in value:
            yield from _array_paths(item)


def read_members(file: BinaryIO, is_wanted: Callable[[str], bool] = lambda _: True) -> Arrays:
    """Arrays of an archive, all or those whose names are wanted, read-only, each after its checksum; InputError for
    members that are none, or that say they hold more than the file has, before anything of them is read.
    """
    file_size = file.seek(0, io.SEEK_END)
    with zipfile.ZipFile(file) as archive:
        members = archive.infolist()
        content_size = sum(member.file_size for member in members)
        if content_size > file_size or any(member.compress_type != zipfile.ZIP_STORED for member in members):
            content = f"members of {content_size / 1e6:.1f} MB in a file of {file_size / 1e6:.1f} MB, or packed ones"
            raise InputError(members[0].filename, content, "arrays as NumPy's savez writes them", _REWRITE)
        names = [(member, member.filename.removesuffix(".npy")) for member in members]
        return {name: _from_npy(archive.read(member), name) for member, name in names if is_wanted(name)}


def _from_npy(content: bytes, name: str) -> NDArray[Any]:
    """An array out of the bytes of an .npy file, without a copy; nothing in it is evaluated."""
    header = _HEADER.match(content)
    if header is None or header.end() != 10 + int.from_bytes(header[1], "little"):
        raise InputError(name, "no NumPy array of numbers or names", remedy=_REWRITE)
    dtype, shape = np.dtype(header[2].decode()), tuple(int(size) for size in header[4].split(b",") if size.strip())
    if math.prod(shape) * dtype.itemsize != len(content) - header.end():
        raise InputError(name, f"{len(content) - header.end()} bytes", f"an array of shape {shape}", _REWRITE)
    return np.ndarray(shape, dtype, content, header.end(), order="F" if header[3] == b"True" else "C")


# --- a record to arrays and JSON


def to_arrays(value: Any, path: str, arrays: Arrays) -> Any:
    """JSON of a value; the arrays in it go to `arrays`, under the path that leads to them."""
    if isinstance(value, np.ndarray):
        arrays[path] = value
        return {"array": path}
    if is_dataclass(value):
        members = {field.name: to_arrays(getattr(value, field.name), _child_path(path, field.name), arrays)
                   for field in fields(value)}
        return members | ({"kind": type(value).__name__} if type(value).__name__ in _KIND_NAMES else {})
    if isinstance(value, Mapping):
        return {key: to_arrays(item, _child_path(path, key), arrays) for key, item in value.items()}
    if isinstance(value, tuple):
        names = _as_text_array(value)
        if names is not None:
            return to_arrays(names, path, arrays)
        return [to_arrays(item, _child_path(path, str(k)), arrays) for k, item in enumerate(value)]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else {"float": str(float(value))}
    if isinstance(value, int | str | None):
        return value
    raise TypeError(f"{path} is a {type(value).__name__}, for which the archive has no form")


def _as_text_array(names: tuple[Any, ...]) -> np.ndarray | None:
    """Array of names; None where there are none, or NumPy would drop something (it does with closing NULs)."""
    if not names or not all(isinstance(name, str) for name in names):
        return None
    array = np.array(names)
    return array if array.tolist() == list(names) else None


def _child_path(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


# --- arrays and JSON to a record


def from_arrays(value: Any, kind: Any, path: str, arrays: Arrays) -> Any:
    """The value of type `kind` (as the records' fields declare it) from the JSON `value` that `to_arrays` made."""
    origin, options = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        if value is None and type(None) in options:
            return None
        options = tuple(option for option in options if option is not type(None))
        if any(array_scalar(option) for option in options):
            return _read_array(value, options, path, arrays)
        if len(options) > 1:  # records, of which the value says which it is
            return _read_record(value, {kind.__name__: kind for kind in options}[value["kind"]], path, arrays)
        return from_arrays(value, options[0], path, arrays)
    if array_scalar(kind):
        return _read_array(value, (kind,), path, arrays)
    if origin is tuple:
        if isinstance(value, dict):
            return tuple(_read_array(value, (NDArray[np.str_],), path, arrays).tolist())
        return tuple(from_arrays(item, options[0], _child_path(path, str(k)), arrays) for k, item in enumerate(value))
    if origin is Mapping:
        return {key: from_arrays(item, options[1], _child_path(path, key), arrays) for key, item in value.items()}
    if kind in _KINDS:
        return _read_record(value, _KINDS[kind][value["kind"]], path, arrays)
    return _read_record(value, kind, path, arrays) if is_dataclass(kind) else _read_scalar(value, kind, path)


def kinds_of(kind: Any) -> tuple[type[Any], ...]:
    """Records that may stand where a protocol is declared; none of any other type."""
    return tuple(_KINDS[kind].values()) if kind in _KINDS else ()


def array_scalar(kind: Any) -> Any:
    """Type of the numbers of an array's type; None of any other type."""
    if get_origin(kind) is np.ndarray:
        return get_args(get_args(kind)[1])[0]
    return get_args(kind)[0] if get_origin(kind) is NDArray else None  # from NumPy 2.5 on NDArray is an alias


def _read_array(value: dict[str, str], kinds: tuple[Any, ...], path: str, arrays: Arrays) -> np.ndarray:
    """The array; InputError unless its numbers are of one of the kinds NDArray[scalar]."""
    array, scalars = arrays[value["array"]], tuple(map(array_scalar, kinds))
    if not issubclass(array.dtype.type, scalars):
        raise InputError(path, f"an array of {array.dtype}", f"of {' or '.join(s.__name__ for s in scalars)}", _REWRITE)
    return array


def _read_record(value: dict[str, Any], kind: Any, path: str, arrays: Arrays) -> Any:
    hints = _field_types(kind)
    for name in sorted(set(value) - set(hints) - {"kind"})[:1]:
        raise InputError(_child_path(path, name), "a field that this version doesn't know", "", _USE_NEWER)
    # a field that the writer didn't know yet takes its default; one that has none fails there
    members = {name: from_arrays(value[name], hints[name], _child_path(path, name), arrays) for name in hints
               if name in value}
    record = kind(**members)
    if kind is AttitudeTable:
        assign(record, quaternions=members["quaternions"])  # checked above; dividing by the norm again moves last bits
    return record


@cache
def _field_types(kind: Any) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in fields(kind)}


def _read_scalar(value: Any, kind: Any, path: str) -> Any:
    if isinstance(value, dict):
        value = float(value["float"])
    if isinstance(kind, type) and issubclass(kind, StrEnum):
        require(value in tuple(kind), path, f"{value!r}", f"one of {', '.join(kind)}", _USE_NEWER)
        return kind(value)
    if isinstance(kind, type) and not (isinstance(value, kind) or (kind is float and isinstance(value, int))):
        raise InputError(path, f"{value!r}", f"a value of type {kind.__name__}", _REWRITE)
    return value



FORMAT = 4
"""Version of the layout, raised whenever an older reader would misread it; no other is read."""
ARCHIVE = "solution.npz"
"""Name of the file in a result folder."""
_LARGEST = 1 << 40
"""bytes; every member is held against the file's size."""

_USE_NEWER = "read it with the version of mgsgraph that wrote it, or a newer one"
_USE_OLDER = "adjust the case again, or read it with the older version of mgsgraph that wrote it"
_READJUST = f"adjust the case again, or give the folder (or {ARCHIVE}) that mgsgraph wrote"


_SHAPES = {
    "shifts": "s2", "places_before": "n3", "places": "n3", "covariances": "n33", "determined": "n", "rays_used": "k",
    "ranges_used": "r", "residuals": "k2", "residuals_before": "k2", "range_residuals": "r",
    "range_residuals_before": "r", "rays_rejected": "k", "ranges_rejected": "r", "stereo_rejected": "n",
    "stereo_heights": "n", "test_dimensions": "t",
}  # fmt: skip
"""Of a solution's arrays: n points, k rays, r ranges, s shifts, t of these measures and points."""


def write_archive(solution: "Solution", path: Path) -> None:
    """Write a solution to an .npz file."""
    with path.open("wb") as file:
        np.savez(file, format=np.array(FORMAT), **_members(solution))  # type: ignore[arg-type]  # as in `pack`


def read_solution(path: str | Path) -> "Solution":
    """Read a solution back.

    Parameters
    ----------
    path : path
        Folder of results, or the archive in it.

    Raises
    ------
    InputError
        If there is no archive, or it is damaged, foreign, or of a format that this version doesn't know.

    Examples
    --------
    >>> print(mgsgraph.read_solution("RESULT"))
    Solution('simulated pair', converged after 5 iterations, cost 449.199 -> 44.8741, sigma0 1.223, 60 degrees of
    freedom; Network(2 images, 28 points (20 tie, 8 laser), 56 rays, 8 ranges))
    """
    from mgsgraph.adjustment.solution import Solution  # gtsam and the compiler take their time to load

    path = Path(path)
    path = path / ARCHIVE if path.is_dir() else path
    require(path.exists(), str(path), "no such file", remedy=_READJUST)
    require(path.suffix != ".toml", str(path), "a case file", "RESULT, a folder that mgsgraph adjust wrote")
    where = str(path)
    with errors_from(where), understood(where, "an archive of mgsgraph", _READJUST), opened(path, _LARGEST) as file:
        arrays = read_members(file)
        version = int(arrays["format"])
        require(version == FORMAT, "format", f"{version}", f"{FORMAT}", _USE_NEWER if version > FORMAT else _USE_OLDER)
        solution: Solution = from_arrays(record_of(arrays), Solution, "", arrays)
        _require_shapes(solution)
        return solution


def _require_shapes(solution: "Solution") -> None:
    """Raise InputError unless the arrays of a solution fit its network, so that no later table stumbles over them."""
    network = solution.network
    n, k, r = len(network.points), network.rays.point.size, network.ranges.point.size
    sizes = {"n": n, "k": k, "r": r, "s": len(network.shift_names), "t": n + k + r, "2": 2, "3": 3}
    shared_sizes = [unknown.sigmas.size for unknown in network.shared]
    term_counts = [len(terms) for terms in network.shift_terms]
    width = np.array(network.widths)
    estimated = np.append(network.with_polynomial, np.ones(width.size - len(network.images), dtype=bool))
    firsts = np.where(estimated, np.cumsum(width * estimated) - width, -1)
    root = solution.joint_covariance.square_root
    comparisons: list[tuple[str, str, Any, Any]] = [
        *((name, "shape ", value.shape, tuple(sizes[letter] for letter in shape)) for name, shape in _SHAPES.items()
          if (value := getattr(solution, name)) is not None),
        ("joint_covariance.square_root.first", "", root.first.tolist(), firsts.tolist()),
        ("joint_covariance.square_root.width", "", root.width.tolist(), width.tolist()),
    ]
    sequences: dict[str, tuple[Sequence[Array], list[tuple[int, ...]]]] = {
        "coefficients": (solution.coefficients, [prior.sigmas.shape for prior in network.priors]),
        "lift": (solution.shift_values, [(size,) for size in term_counts]),
        "shared": (solution.shared, [(size,) for size in shared_sizes]),
        "nodes": (solution.nodes, [(len(pass_.nodes), 6) for pass_ in network.passes]),
        "trends": (solution.trends, [pass_.prior.trend_sigmas.shape for pass_ in network.passes]),
        "common": (solution.common, [(size,) for size in width[network.first_of_passes[-1] :].tolist()]),
    }
    comparisons += [(name, "shapes ", [value.shape for value in values], expected)
                    for name, (values, expected) in sequences.items()]
    for name, prefix, value, expected in comparisons:
        if value != expected:
            raise InputError(name, f"{prefix}{str(value)[:60]}", str(expected)[:60], _READJUST)
    numbers = {name: list(values) for name, (values, _) in sequences.items()} | {
        name: [value] for name in ("shifts", "sigmas_without_laser", "median_sigmas_without_laser")
        if (value := getattr(solution, name)) is not None
    }  # fmt: skip
    for name, arrays in (numbers | {"places": [solution.places[solution.determined]]}).items():
        require(all(np.all(np.isfinite(array)) for array in arrays), name, "not a number", "finite numbers", _READJUST)
