"""Construction of records: their arrays are copied to read-only float64 and checked once."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mgsgraph.errors import InputError, require
from mgsgraph.names import Names

_Scalar = TypeVar("_Scalar", bound=np.generic)
LONGEST_NAME = 500
"""Characters of a name."""
Array = NDArray[np.float64]
"""An array of float64."""
Index = NDArray[np.int64]
"""An array of int64."""
Mask = NDArray[np.bool_]
"""An array of truth values."""


def is_frozen(value: Any, kind: Any) -> bool:
    """Whether a value is a read-only array of a kind, so that a record needs no copy of it."""
    if not isinstance(value, np.ndarray) or value.dtype != kind:
        return False
    while isinstance(value, np.ndarray):
        if value.flags.writeable:
            return False
        value = value.base
    return value is None or isinstance(value, bytes)


def of_kind(value: Any, kind: type[_Scalar]) -> NDArray[_Scalar]:
    """An array of a kind: the value itself where it is read-only, else a copy."""
    array: NDArray[_Scalar] = value if is_frozen(value, kind) else np.array(value, dtype=kind)
    return array


def read_only(array: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """An array that was just made and has no other reference: it becomes read-only, so that no record copies it."""
    array.flags.writeable = False
    return array


def repeated(value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Read-only array of a shape that holds one value again and again, in the memory of one."""
    return np.broadcast_to(read_only(np.array(value, dtype=np.float64)), shape)


def repeats(values: NDArray[Any]) -> bool:
    """Whether an array holds one value again and again, in the memory of one (`repeated`)."""
    return values.size > 1 and not any(values.strides)


def finite_rows(values: NDArray[Any]) -> Mask:
    """(n,) whether all numbers of a row of (n, k) are finite."""
    return np.asarray(np.all(np.isfinite(values), axis=1))


def sigmas_of(covariances: NDArray[Any]) -> Array:
    """(..., k) standard deviations, of covariances (..., k, k)."""
    return np.asarray(np.sqrt(np.diagonal(covariances, axis1=-2, axis2=-1)))


def by_value(values: Index) -> Iterator[tuple[int, Index]]:
    """Each number that occurs, from the least on, and where it does."""
    for value in np.unique(values).tolist():
        yield value, np.flatnonzero(values == value)


def no_rows() -> Index:
    """The indices of nothing."""
    return np.zeros(0, dtype=np.int64)


def joined_rows(parts: Iterable[Index]) -> Index:
    """Indices one after another, also of no parts at all."""
    return np.concatenate([no_rows(), *parts])


def all_pairs(x: ArrayLike, y: ArrayLike) -> NDArray[Any]:
    """(n, 2) each number of x (m,) for the first of y (k,), then for the second, and so on."""
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def thinned(size: int, most: int | None) -> Index:
    """All of `size` indices, or `most` of them, evenly spread from the first to the last."""
    if most is None or size <= most:
        return np.arange(size)
    return np.linspace(0, size - 1, most).astype(np.int64)


def place_of(rows: NDArray[np.integer[Any]], size: int) -> Index:
    """(size,) place of each number in `rows` (m,), all different; -1 for one that is not there."""
    place = np.full(size, -1)
    place[rows] = np.arange(rows.size)
    return place


def chosen_rows(values: NDArray[_Scalar], rows: Index | Mask) -> NDArray[_Scalar]:
    """Some rows of an array (n, ...); of one that repeats a value no more memory than before."""
    if repeats(values):
        return np.broadcast_to(values[:1], (np.arange(len(values))[rows].size, *values.shape[1:]))
    return values[rows]


def concatenated(parts: Sequence[NDArray[_Scalar]]) -> NDArray[_Scalar]:
    """Arrays (n, ...) one after another; a single one as it is, those that repeat one value in the memory of one."""
    full = [part for part in parts if part.size]
    if len(full) == 1:
        return full[0]
    if full and all(repeats(part) and part.flat[0] == full[0].flat[0] for part in full):
        return np.broadcast_to(full[0][:1], (sum(map(len, full)), *full[0].shape[1:]))
    return np.concatenate(parts)


def frozen(value: ArrayLike, where: str, shape: tuple[int | None, ...]) -> Array:
    """Copy to a read-only float64 array after checking its shape and that all of it is finite; what nobody can write to
    is not copied.

    Parameters
    ----------
    value : array_like
        What the caller gave.
    where : str
        Name of the field, for the error message.
    shape : tuple of int or None
        Expected shape; None stands for any length.

    Raises
    ------
    InputError
        If the shape differs or a value is NaN or infinite.
    """
    try:
        array = of_kind(value, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(where, f"no array of numbers ({error})", "numbers in even rows") from None
    if array.ndim != len(shape) or any(want not in (None, got) for want, got in zip(shape, array.shape, strict=True)):
        want = "(" + ", ".join("n" if size is None else str(size) for size in shape) + ")"
        raise InputError(where, f"an array of shape {array.shape}", f"shape {want}")
    if not np.isfinite(array).all():
        bad = np.argwhere(~np.isfinite(array))[0]
        place = ", ".join(str(k) for k in bad)
        raise InputError(where, f"{array[tuple(bad)]} at [{place}]", "finite numbers")
    return read_only(array)


def frozen_index(value: ArrayLike, where: str, size: int, upper: int) -> Index:
    """Copy to a read-only int64 array of `size` indices in 0 .. upper - 1; raises InputError otherwise. What nobody can
    write to is not copied.
    """
    given = np.asarray(value)
    if not (is_frozen(given, np.int64) and given.ndim == 1):
        given = given.reshape(-1)
        numbers = given.size == 0 or given.dtype.kind in "iuf"
        whole = given.dtype.kind == "i" or (numbers and np.all(np.abs(given) < 2.0**53) and np.all(given % 1 == 0))
        require(whole, where, f"{given.dtype} values {given[:3].tolist()}", "whole numbers")
        given = given.astype(np.int64)
    require(given.shape == (size,), where, f"{given.size} indices", f"{size}")
    if given.size and (given.min() < 0 or given.max() >= upper):
        raise InputError(where, f"index {given.min()} .. {given.max()}", f"0 .. {upper - 1}")
    return read_only(given)


def frozen_mask(value: ArrayLike | None, where: str, size: int) -> Mask:
    """Read-only marks (size,), none set when absent; `where` names them in errors."""
    mask: Mask = np.zeros(size, dtype=np.bool_) if value is None else of_kind(value, np.bool_)
    require(mask.shape == (size,), where, f"shape {mask.shape}", f"one for each of {size}")
    return read_only(mask)


def assign(record: Any, **fields: Any) -> None:
    """Set fields of a frozen record while it is being made (`__post_init__` only)."""
    for name, value in fields.items():
        object.__setattr__(record, name, value)


def require_names(ids: Sequence[str], source: str) -> None:
    """Raise InputError when a name occurs twice, is overlong, or holds control characters, which would reach a terminal
    and tables.
    """
    names = Names.of(ids, source)
    if not names.text.isprintable() or np.diff(names.offsets).max(initial=0) > LONGEST_NAME:
        for name in names:
            if not name.isprintable() or len(name) > LONGEST_NAME:
                expected = f"at most {LONGEST_NAME} characters that can be printed"
                raise InputError(source, f"the name {name[:60]!r}", expected, "rename it")
    if (again := names.first_repeated) is not None:
        raise InputError(source, f"the id {names[again]!r} twice", "each id once", "rename or remove one of the two")


def require_covariances(covariances: Array, needed: Mask, ids: Sequence[str], source: str) -> None:
    """Raise InputError unless covariances (n, 3, 3) are symmetric and positive definite where `needed` (n,)."""
    chosen = np.flatnonzero(needed)
    if not chosen.size:
        return
    matrices = covariances[chosen]
    scale = np.abs(matrices).max(axis=(1, 2), initial=0.0)
    lopsided = np.abs(matrices - matrices.mT).max(axis=(1, 2), initial=0.0) > 1e-9 * scale
    flat = np.linalg.eigvalsh(matrices)[:, 0] <= 1e-14 * scale
    for k in np.flatnonzero(lopsided | flat)[:1]:
        raise InputError(
            f"{source}, point {ids[chosen[k]]}", "an a-priori covariance that is not positive definite",
            "positive sigmas in all three directions",
        )
