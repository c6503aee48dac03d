"""Cholesky factor of the reduced normal equations as one dense matrix, by the libraries of the device (or NumPy's).

Up to some thousand columns a GPU factors the whole matrix faster than the host finds its way through the sparse one,
and the blocks needn't leave the device.
"""

from importlib.util import find_spec
from types import ModuleType
from typing import Any

import numpy as np

from mgsgraph.adjustment.graph.layout import Layout
from mgsgraph.adjustment.sparse_cholesky import NotDefinite
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.cuda.device import SIMULATED

MOST_COLUMNS = 8000
"""A matrix of 0.5 GB."""


def dense_libraries() -> tuple[ModuleType, ModuleType] | None:
    """Where a device's numbers are, and their linear algebra: CuPy's, or NumPy's and SciPy's where numba's simulator
    stands in for the device; None where CuPy isn't installed.
    """
    if SIMULATED:
        import scipy.linalg

        return np, scipy.linalg
    if find_spec("cupy") is None:
        return None
    import cupy
    import cupyx.scipy.linalg

    return cupy, cupyx.scipy.linalg


class DenseCholesky:
    """The elimination of a layout's normal equations, whatever their numbers.

    Parameters
    ----------
    layout : Layout
    arrays, algebra : module
        NumPy and scipy.linalg, or CuPy and cupyx.scipy.linalg: where the numbers are.
    """

    def __init__(self, layout: Layout, arrays: ModuleType, algebra: ModuleType) -> None:
        self._arrays, self._algebra, self._layout = arrays, algebra, layout
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
            lower = arrays.linalg.cholesky(matrix.reshape(columns, columns))
        except np.linalg.LinAlgError as error:  # CuPy's, too
            raise NotDefinite from error
        if not bool(arrays.isfinite(lower.diagonal()).all()):
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
