"""Words and numbers of reports: counts with their nouns, lists of names, aligned cells, root mean squares."""

import math
from collections.abc import Sequence
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NAMED = 4
"""How many of a kind are named before the rest is only counted."""


def cell(value: float, width: int) -> str:
    """A number with as many of three decimals as the width holds; a dash for none."""
    if not math.isfinite(value):
        return "-"
    texts = (f"{value:.{decimals}f}" for decimals in (3, 2, 1, 0))
    return next((text for text in texts if len(text) <= width), f"{value:.0e}")


def three(values: Array) -> str:
    """Three numbers, three significant digits each."""
    return ", ".join(f"{value:.3g}" if value < 1e3 else f"{value:.0f}" for value in values)


def two(value: float) -> str:
    """A number in two significant digits, without an exponent: a sigma."""
    if not math.isfinite(value) or value == 0.0:
        return "0" if value == 0.0 else "-" if math.isnan(value) else "unlimited"
    decimals = 1 - math.floor(math.log10(abs(float(f"{value:.1e}"))))
    return f"{round(value, decimals):,.{max(decimals, 0)}f}"


def length(value: float) -> str:
    """A length in m in two significant digits; in km from 10 km on."""
    if not math.isfinite(value):
        return two(value)
    return f"{two(1e-3 * value)} km" if abs(value) >= 1e4 else f"{two(value)} m"


def span(values: NDArray[Any]) -> str:
    """Least to largest value, or the one that all have."""
    return three(np.unique([values.min(), values.max()])).replace(", ", " to ")


def many(number: int, noun: str) -> str:
    """A number and its noun, with s for more than one."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def listed(parts: list[str]) -> str:
    """A, B and C."""
    return parts[0] if len(parts) == 1 else ", ".join(parts[:-1]) + " and " + parts[-1]


def some(names: Sequence[str], total: int = 0, most: int = NAMED) -> str:
    """Names, `most` at the most, and how many more there are: of themselves, or of `total` that they stand for."""
    named = names[:most]
    more = max(total, len(names)) - len(named)
    return ", ".join(named) + (f" and {more} more" if more else "")


def some_of(names: Sequence[str], index: NDArray[np.int64], most: int = NAMED) -> str:
    """Names with indices (n,), `most` at the most."""
    return some([names[i] for i in index[:most].tolist()], index.size, most)


def short(name: str, width: int = 40) -> str:
    """A name cut in its middle: serial numbers differ at their ends."""
    if len(name) <= width:
        return name
    tail = (width - 3) // 2
    return f"{name[: width - 3 - tail]}...{name[-tail:]}"


@overload
def root_mean_square(values: Array) -> float: ...
@overload
def root_mean_square(values: Array, axis: int) -> Array: ...
def root_mean_square(values: Array, axis: int | None = None) -> Any:
    """Root mean square, about zero, of all values or along an axis; NaN is no value, and the result of none."""
    count = np.count_nonzero(~np.isnan(values), axis=axis)
    found = np.where(count > 0, np.sqrt(np.nansum(values**2, axis=axis) / np.maximum(count, 1)), np.nan)
    return float(found) if axis is None else found
