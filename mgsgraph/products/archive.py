"""The solution as one file, solution.npz, from which it is read back bit for bit.

Every array of the record lies under its own path (`network.points.places`, `joint_covariance.blocks`), so that plain
NumPy reads it too; everything else is a JSON text under `record`. Nothing is pickled: reading an archive runs no code
of its.
"""

import json
import math
import struct
import types
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.geometry.camera import Distortion, LrocNacDistortion, NoDistortion, RadialDistortion
from mgsgraph.geometry.image import ExteriorOrientation
from mgsgraph.geometry.polynomial_trajectory import PolynomialTrajectory
from mgsgraph.geometry.records import assign
from mgsgraph.geometry.trajectory import AttitudeTable, Trajectory

FORMAT = 2
"""Version of the layout, raised whenever an older reader would misread it: 2 holds the joint covariance by blocks."""
ARCHIVE = "solution.npz"
"""Name of the file in a result folder."""

_KINDS: dict[Any, dict[str, Any]] = {
    protocol: {kind.__name__: kind for kind in kinds}
    for protocol, kinds in (
        (Distortion, (NoDistortion, LrocNacDistortion, RadialDistortion)),
        (ExteriorOrientation, (Trajectory, PolynomialTrajectory)),
    )
}
"""Records that may stand where a protocol is declared; the record says which it is."""
_KIND_NAMES = {name for kinds in _KINDS.values() for name in kinds}
_BROKEN = (
    OSError, EOFError, LookupError, AttributeError, TypeError, ValueError, RuntimeError, OverflowError, MemoryError,
    struct.error, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What zipfile, NumPy and json raise on files that are damaged or no archives."""
_NEWER = "read it with the version of mgsgraph that wrote it, or a newer one"
_OLDER = "adjust the case again, or read it with the older version of mgsgraph that wrote it"
_ANEW = f"adjust the case again, or give the folder (or {ARCHIVE}) that mgsgraph wrote"


def write_archive(solution: Solution, path: Path) -> None:
    """Write a solution to an .npz file."""
    arrays: dict[str, np.ndarray] = {}
    record = json.dumps(_taken_apart(solution, "", arrays), allow_nan=False)
    head = {"format": np.array(FORMAT), "record": np.frombuffer(record.encode(), dtype=np.uint8)}
    with path.open("wb") as file:
        np.savez(file, **head, **arrays)  # type: ignore[arg-type]  # NumPy's stub takes any name for allow_pickle


def read_solution(path: str | Path) -> Solution:
    """Read a solution back.

    Parameters
    ----------
    path : path
        Folder of results, or the archive in it.

    Raises
    ------
    InputError
        If there is no archive, or it is damaged, foreign, or of a format that this version doesn't know.
    """
    path = Path(path)
    path = path / ARCHIVE if path.is_dir() else path
    if not path.is_file():
        raise InputError(str(path), "no such file", remedy=_ANEW)
    try:
        arrays = _members(path)
        version = int(arrays["format"])
        if version == FORMAT:
            record = json.loads(arrays["record"].tobytes().decode())
            solution: Solution = _put_together(record, Solution, "", arrays)
            _require_shapes(solution)
            return solution
    except InputError as error:
        raise error.within(str(path)) from None
    except _BROKEN as error:
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise InputError(str(path), f"no archive of mgsgraph, or a damaged one ({reason})", remedy=_ANEW) from None
    raise InputError(f"{path}, format", f"{version}", f"{FORMAT}", _NEWER if version > FORMAT else _OLDER)


def _members(path: Path) -> dict[str, np.ndarray]:
    """All arrays of an archive, read-only; checksums first, so that NumPy parses nothing that was damaged."""
    with zipfile.ZipFile(path) as archive:
        damaged = archive.testzip()
    if damaged is not None:
        raise InputError(damaged.removesuffix(".npy"), "a wrong checksum", remedy=_ANEW)
    with np.load(path, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray):  # NumPy hands other members out as bytes
            raise InputError(name, "no NumPy array", remedy=_ANEW)
        array.flags.writeable = False
    return arrays


# --- taking a record apart


def _taken_apart(value: Any, where: str, arrays: dict[str, np.ndarray]) -> Any:
    """JSON of a value; the arrays in it go to `arrays`, under the path that leads to them."""
    if isinstance(value, np.ndarray):
        arrays[where] = value
        return {"array": where}
    if is_dataclass(value):
        parts = {field.name: _taken_apart(getattr(value, field.name), _at(where, field.name), arrays)
                 for field in fields(value)}
        return parts | ({"kind": type(value).__name__} if type(value).__name__ in _KIND_NAMES else {})
    if isinstance(value, Mapping):
        return {key: _taken_apart(item, _at(where, key), arrays) for key, item in value.items()}
    if isinstance(value, tuple):
        names = _as_text_array(value)
        if names is not None:
            return _taken_apart(names, where, arrays)
        return [_taken_apart(item, _at(where, str(k)), arrays) for k, item in enumerate(value)]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else {"float": str(float(value))}
    if isinstance(value, int | str | None):
        return value
    raise TypeError(f"{where} is a {type(value).__name__}, for which the archive has no form")


def _as_text_array(names: tuple[Any, ...]) -> np.ndarray | None:
    """Array of names; None where there are none, or NumPy would drop something (it does with closing NULs)."""
    if not names or not all(isinstance(name, str) for name in names):
        return None
    array = np.array(names)
    return array if array.tolist() == list(names) else None


def _at(where: str, name: str) -> str:
    return f"{where}.{name}" if where else name


# --- putting it together again


def _put_together(value: Any, kind: Any, where: str, arrays: dict[str, np.ndarray]) -> Any:
    """The value of type `kind` (as the records' fields declare it) that was taken apart to the JSON `value`."""
    origin, options = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        if value is None and type(None) in options:
            return None
        options = tuple(option for option in options if option is not type(None))
        if any(get_origin(option) is np.ndarray for option in options):
            return _array(value, options, where, arrays)
        return _put_together(value, options[0], where, arrays)
    if origin is np.ndarray:
        return _array(value, (kind,), where, arrays)
    if origin is tuple:
        if isinstance(value, dict):
            return tuple(_array(value, (NDArray[np.str_],), where, arrays).tolist())
        return tuple(_put_together(item, options[0], _at(where, str(k)), arrays) for k, item in enumerate(value))
    if origin is Mapping:
        return {key: _put_together(item, options[1], _at(where, key), arrays) for key, item in value.items()}
    if kind in _KINDS:
        return _record(value, _KINDS[kind][value["kind"]], where, arrays)
    return _record(value, kind, where, arrays) if is_dataclass(kind) else _scalar(value, kind, where)


def _array(value: dict[str, str], kinds: tuple[Any, ...], where: str, arrays: dict[str, np.ndarray]) -> np.ndarray:
    """The array, after a look whether it is of one of the kinds NDArray[scalar]."""
    array, scalars = arrays[value["array"]], tuple(get_args(get_args(kind)[1])[0] for kind in kinds)
    if not issubclass(array.dtype.type, scalars):
        raise InputError(where, f"an array of {array.dtype}", f"of {' or '.join(s.__name__ for s in scalars)}", _ANEW)
    return array


def _record(value: dict[str, Any], kind: Any, where: str, arrays: dict[str, np.ndarray]) -> Any:
    hints = _field_types(kind)
    for name in sorted(set(value) - set(hints) - {"kind"})[:1]:
        raise InputError(_at(where, name), "a field that this version doesn't know", "", _NEWER)
    # a field that the writer didn't know yet takes its default; one that has none fails there
    parts = {name: _put_together(value[name], hints[name], _at(where, name), arrays) for name in hints if name in value}
    record = kind(**parts)
    if kind is AttitudeTable:
        assign(record, quaternions=parts["quaternions"])  # checked above; a second division by the norm moves last bits
    return record


@cache
def _field_types(kind: Any) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in fields(kind)}


def _scalar(value: Any, kind: Any, where: str) -> Any:
    if isinstance(value, dict):
        value = float(value["float"])
    if isinstance(kind, type) and not (isinstance(value, kind) or (kind is float and isinstance(value, int))):
        raise InputError(where, f"{value!r}", f"a value of type {kind.__name__}", _ANEW)
    return value


def _require_shapes(solution: Solution) -> None:
    """Raise InputError unless the arrays of a solution fit its network, so that no later table stumbles over them."""
    network = solution.network
    n, k, r = len(network.points), network.rays.point.size, network.ranges.point.size
    shifts = len(network.shift_names)
    width = np.array([prior.sigmas.size for prior in network.priors] + [2] * shifts)
    adjusted = np.append(~network.held, np.ones(shifts, dtype=bool))
    first = np.where(adjusted, np.cumsum(width * adjusted) - width, -1)
    expected: dict[str, tuple[int, ...]] = {
        "shifts": (shifts, 2),
        "places_before": (n, 3), "places": (n, 3), "covariances": (n, 3, 3),
        "determined": (n,), "rays_used": (k,), "ranges_used": (r,), "residuals": (k, 2), "residuals_before": (k, 2),
        "range_residuals": (r,), "range_residuals_before": (r,),
    }  # fmt: skip
    for name, shape in expected.items():
        if (found := getattr(solution, name).shape) != shape:
            raise InputError(name, f"shape {found}", f"{shape}", _ANEW)
    root = solution.joint_covariance.square_root
    for name, found, right in (
        ("joint_covariance.square_root.first", root.first, first),
        ("joint_covariance.square_root.width", root.width, width),
    ):
        if not np.array_equal(found, right):
            raise InputError(name, f"{found.tolist()[:10]}", f"{right.tolist()[:10]}", _ANEW)
    shapes = [part.shape for part in solution.coefficients]
    if shapes != [prior.sigmas.shape for prior in network.priors]:
        raise InputError("coefficients", f"shapes {shapes[:5]}", "those of the priors", _ANEW)
