"""Bilinear interpolation between the nodes of a regular grid."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgsgraph.geometry.records import Array


def between_nodes(nodes: NDArray[Any], at: Array) -> Array:
    """Values (n, ...) of nodes (rows, columns, ...) at fractional rows and columns `at` (n, 2).

    Outside the grid the outermost cells are extrapolated; NaN beside nodes that are NaN.
    """
    i, j = np.clip(np.floor(at), 0, np.maximum(np.array(nodes.shape[:2]) - 2, 0)).astype(np.int64).T
    shape = (-1,) + (1,) * (nodes.ndim - 2)
    down, across = (part.reshape(shape) for part in (at[:, 0] - i, at[:, 1] - j))
    below, right = np.minimum(i + 1, nodes.shape[0] - 1), np.minimum(j + 1, nodes.shape[1] - 1)
    upper = (1.0 - across) * nodes[i, j] + across * nodes[i, right]
    lower = (1.0 - across) * nodes[below, j] + across * nodes[below, right]
    return np.asarray((1.0 - down) * upper + down * lower)


def refined(nodes: NDArray[Any], step: int) -> NDArray[Any]:
    """Nodes (rows, columns) and `step` - 1 values between neighbours: ((rows - 1) step + 1, (columns - 1) step + 1)."""
    part = (np.arange(step) / step).astype(nodes.dtype)
    across = nodes[:, :-1, None] + np.diff(nodes, axis=1)[:, :, None] * part
    full = np.column_stack([across.reshape(nodes.shape[0], -1), nodes[:, -1]])
    down = full[:-1, None, :] + np.diff(full, axis=0)[:, None, :] * part[:, None]
    return np.concatenate([down.reshape(-1, full.shape[1]), full[-1:]])
