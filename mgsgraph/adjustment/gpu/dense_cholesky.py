"""Cholesky factor of the reduced normal equations as one dense matrix, by the libraries of the device (or NumPy's).

Up to some thousand columns a GPU factors the whole matrix faster than the host finds its way through the sparse one,
and the blocks needn't leave the device.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from importlib.util import find_spec
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from mgsgraph.adjustment.graph.layout import Layout
from mgsgraph.adjustment.sparse_cholesky import NotDefinite
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.cuda.device import SIMULATED

MOST_COLUMNS = 8000
"""A matrix of 0.5 GB."""
_COPIES = 6
"""Matrix, factor, what is gathered, and where its numbers come from, go to, and their units."""


class DenseLibraries(NamedTuple):
    """Where a device's numbers are."""

    arrays: ModuleType
    """NumPy, or CuPy."""
    algebra: ModuleType
    """scipy.linalg, or cupyx.scipy.linalg."""
    raising: Callable[[], AbstractContextManager[Any]]
    """In which linear algebra raises LinAlgError of a matrix that is not definite: CuPy is silent by default."""


def dense_libraries() -> DenseLibraries | None:
    """CuPy, or NumPy and SciPy where numba's simulator stands in for the device; None where CuPy isn't installed."""
    if SIMULATED:
        import scipy.linalg

        return DenseLibraries(np, scipy.linalg, nullcontext)
    if find_spec("cupy") is None:
        return None
    import cupy
    import cupyx.scipy.linalg

    return DenseLibraries(cupy, cupyx.scipy.linalg, partial(cupyx.errstate, linalg="raise"))


def dense_bytes(columns: int) -> float:
    """Bytes that the elimination of so many columns takes on the device; none of more than `MOST_COLUMNS`."""
    return 8.0 * _COPIES * columns**2 if columns <= MOST_COLUMNS else 0.0


class DenseCholesky:
    """The elimination of a layout's normal equations, whatever their numbers.

    Parameters
    ----------
    layout : Layout
    libraries : DenseLibraries
    """

    def __init__(self, layout: Layout, libraries: DenseLibraries) -> None:
        self._arrays, self._algebra, self._raising = libraries
        arrays, self._layout = libraries.arrays, layout
        row, column, place = _places(layout)
        self._from, self._to = arrays.asarray(place), arrays.asarray(column * layout.columns + row)
        self._units = arrays.asarray(layout.scales[row] * layout.scales[column])
        self._scales, self._weights = arrays.asarray(layout.scales), arrays.asarray(layout.prior.weights**2)
        self._more = arrays.asarray(layout.prior_information)

    def factor(self, blocks: Any, damping: float) -> "DenseFactor":
        """Factor of flat blocks plus the priors' information, damped in units of the unknowns' scales.

        Raises NotDefinite.
        """
        arrays, columns = self._arrays, self._layout.columns
        flat = arrays.asarray(blocks)
        flat = flat + self._more if self._more.size else flat
        matrix = arrays.zeros(columns * columns)
        matrix[self._to] = flat[self._from] * self._units
        every = arrays.arange(columns) * (columns + 1)
        matrix[every] += self._weights * self._scales**2 + damping
        try:
            with self._raising():
                lower = arrays.linalg.cholesky(matrix.reshape(columns, columns))
        except np.linalg.LinAlgError as error:
            raise NotDefinite from error
        if not bool((arrays.isfinite(lower.diagonal()) & (lower.diagonal() > 0.0)).all()):
            raise NotDefinite
        return DenseFactor(lower, self._scales, arrays, self._algebra)


class DenseFactor:
    """Such a factor, in units of `scales`."""

    def __init__(self, lower: Any, scales: Any, arrays: ModuleType, algebra: ModuleType) -> None:
        self._lower, self._scales, self._arrays, self._algebra = lower, scales, arrays, algebra

    def solve(self, right: Array) -> Array:
        """Solution (columns,), m and rad, for a right side per m and rad: arrays of the host."""
        solve = self._algebra.solve_triangular
        half = solve(self._lower, self._arrays.asarray(right) * self._scales, lower=True)
        found = solve(self._lower, half, trans=1, lower=True) * self._scales
        return np.asarray(found if self._arrays is np else self._arrays.asnumpy(found))


def _places(layout: Layout) -> tuple[Index, Index, Index]:
    """Row and column of all numbers of the blocks that are adjusted, in the upper triangle or in a diagonal block, and
    their places in the flat array.
    """
    blocks, first, width = layout.blocks, layout.variables.first, layout.variables.width
    mine = np.flatnonzero((first[blocks.first] >= 0) & (first[blocks.second] >= 0))
    one, other = blocks.first[mine], blocks.second[mine]
    sizes = width[one] * width[other]
    block = np.repeat(np.arange(mine.size), sizes)
    inside = np.arange(block.size) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    across = width[other][block]
    row, column = first[one][block] + inside // across, first[other][block] + inside % across
    return row, column, blocks.offset[mine][block] + inside
