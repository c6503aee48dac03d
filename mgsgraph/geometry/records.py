"""What every record does on construction: its arrays are copied to read-only float64 and checked once."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mgsgraph.errors import InputError

LONGEST_NAME = 500
"""Characters of a name."""
Array = NDArray[np.float64]
"""An array of float64."""
Index = NDArray[np.int64]
"""An array of int64."""
Mask = NDArray[np.bool_]
"""An array of truth values."""


def frozen(value: ArrayLike, where: str, shape: tuple[int | None, ...]) -> Array:
    """Copy to a read-only float64 array after checking its shape and that all of it is finite.

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
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(where, f"no array of numbers ({error})", "numbers in even rows") from None
    if array.ndim != len(shape) or any(want not in (None, got) for want, got in zip(shape, array.shape, strict=True)):
        want = "(" + ", ".join("n" if size is None else str(size) for size in shape) + ")"
        raise InputError(where, f"an array of shape {array.shape}", f"shape {want}")
    bad = np.argwhere(~np.isfinite(array))
    if bad.size:
        place = ", ".join(str(k) for k in bad[0])
        raise InputError(where, f"{array[tuple(bad[0])]} at [{place}]", "finite numbers")
    array.flags.writeable = False
    return array


def frozen_index(value: ArrayLike, where: str, size: int, upper: int) -> Index:
    """Copy to a read-only int64 array of `size` indices in 0 .. upper - 1; raises InputError otherwise."""
    given = np.asarray(value).reshape(-1)
    numbers = given.size == 0 or given.dtype.kind in "iuf"
    if not (numbers and np.all(np.abs(given) < 2.0**53) and np.all(given % 1 == 0)):
        raise InputError(where, f"{given.dtype} values {given[:3].tolist()}", "whole numbers")
    array = given.astype(np.int64)
    if array.shape != (size,):
        raise InputError(where, f"{array.size} indices", f"{size}")
    if array.size and (array.min() < 0 or array.max() >= upper):
        raise InputError(where, f"index {array.min()} .. {array.max()}", f"0 .. {upper - 1}")
    array.flags.writeable = False
    return array


def frozen_mask(value: ArrayLike | None, where: str, size: int) -> Mask:
    """Read-only marks (size,), none set when absent; `where` names them in errors."""
    mask = np.zeros(size, dtype=np.bool_) if value is None else np.array(value, dtype=np.bool_)
    if mask.shape != (size,):
        raise InputError(where, f"shape {mask.shape}", f"one for each of {size}")
    mask.flags.writeable = False
    return mask


def assign(record: Any, **fields: Any) -> None:
    """Set fields of a frozen record while it is being made (`__post_init__` only)."""
    for name, value in fields.items():
        object.__setattr__(record, name, value)


def require_names(ids: tuple[str, ...], source: str) -> None:
    """Raise InputError when a name occurs twice, is overlong, or holds control characters, which would reach a terminal
    and tables.
    """
    if not "".join(ids).isprintable() or max(map(len, ids), default=0) > LONGEST_NAME:
        found = next(name for name in ids if not name.isprintable() or len(name) > LONGEST_NAME)
        expected = f"at most {LONGEST_NAME} characters that can be printed"
        raise InputError(source, f"the name {found[:60]!r}", expected, "rename it")
    seen: set[str] = set()
    for name in ids:
        if name in seen:
            raise InputError(source, f"the id {name!r} twice", "each id once", "rename or remove one of the two")
        seen.add(name)


def require_covariances(covariances: Array, needed: Mask, ids: tuple[str, ...], source: str) -> None:
    """Raise InputError unless covariances (n, 3, 3) are symmetric and positive definite where `needed` (n,)."""
    chosen = np.flatnonzero(needed)
    matrices = covariances[chosen]
    scale = np.abs(matrices).max(axis=(1, 2), initial=0.0)
    lopsided = np.abs(matrices - np.swapaxes(matrices, 1, 2)).max(axis=(1, 2), initial=0.0) > 1e-9 * scale
    flat = np.linalg.eigvalsh(matrices)[:, 0] <= 1e-14 * scale
    for k in np.flatnonzero(lopsided | flat)[:1]:
        raise InputError(
            f"{source}, point {ids[chosen[k]]}", "an a-priori covariance that is not positive definite",
            "positive sigmas in all three directions",
        )
