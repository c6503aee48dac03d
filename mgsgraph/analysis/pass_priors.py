"""What the prior of a pass says of linear functions of its nodes, correlations between nodes included."""

from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Pass

if TYPE_CHECKING:
    from scipy.sparse import csr_array


def prior_sigmas(one: Pass, rows: Array) -> Array:
    """(r,) a-priori sigmas of functions of a pass's nodes; infinite where its prior does not determine all nodes.

    Parameters
    ----------
    one : Pass
        With k nodes; its prior's rows are sparse, and so is what is solved.
    rows : (r, 6 k)
        Per m and rad of the nodes, one after another.
    """
    from scipy.sparse.linalg import splu

    scales = np.concatenate([np.where(np.isfinite(sigmas), sigmas, 1.0) for sigmas in one.sigmas])
    root = _root(one, scales)
    wanted = np.pad(rows, ((0, 0), (0, scales.size - rows.shape[1]))) * scales
    try:
        found = splu((root.T @ root).tocsc()).solve(np.ascontiguousarray(wanted.T))
    except RuntimeError:  # singular: nodes of which nothing is known
        return np.full(rows.shape[0], np.inf)
    return np.asarray(np.sqrt(np.maximum(np.einsum("rc,cr->r", wanted, found), 0.0)))


def _root(one: Pass, scales: Array) -> "csr_array":
    """(rows, columns) whitened rows of the prior on nodes and trend, in units of `scales` (columns,)."""
    from scipy.sparse import csr_array

    first, parts, height = np.concatenate([[0], np.cumsum(one.widths)]), list[tuple[Index, Index, Array]](), 0
    for factor in one.prior.factors(one.nodes):
        for unknown, block in zip(factor.unknowns, factor.blocks, strict=True):
            row, column = np.nonzero(block)
            place = first[unknown] + column
            parts.append((height + row, place, block[row, column] * scales[place]))
        height += factor.blocks[0].shape[0]
    row, column, value = (np.concatenate(part) for part in zip(*parts, strict=True))
    return csr_array((value, (row, column)), shape=(height, scales.size))
