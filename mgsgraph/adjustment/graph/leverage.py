"""How far each observation determines its own adjusted value: the kernel's reliability, share by share."""

from itertools import pairwise

import numpy as np

from mgsgraph.compiled import in_threads
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel import reduction
from mgsgraph.kernel.reliability import NUMBERS
from mgsgraph.kernel.rows import Groups, Model, NormalBlocks, Rows, partition

MISFIT, SHARE, EFFECT, BETWEEN = slice(0, 2), slice(2, 4), slice(4, 6), 6
"""Columns of the kernel's numbers of the first two rows of observations (t, 8), side by side, lest each look-up cost
several: whitened residuals; diagonal of H; m that an error of one sigma moves the point; H between the two rows."""
_AT_A_TIME = 1 << 17
"""Observations that a thread takes at a time: their 3 x 7 numbers are 22 MB."""


def of_rows(values: Array, into: Array) -> None:
    """What observations say of themselves (t, 8), from the kernel's numbers of their rows (t, 3, 7)."""
    moved = values[:, :2, 4:]
    into[:, MISFIT], into[:, BETWEEN] = values[:, :2, 0], values[:, 0, 2]
    into[:, SHARE] = values[:, [0, 1], [1, 2]]
    into[:, EFFECT] = np.sqrt(np.einsum("tik,tik->ti", moved, moved))


def numbers(
    rows: Rows,
    groups: Groups,
    target: NormalBlocks,
    model: Model,
    orientation: Array,
    joint: Array,
    points: Array,
    ground: Index | None = None,
) -> tuple[Array, Array]:
    """What observations say of themselves (t, 8), and all that some of them (g,) do (g, 3, 7); other parameters as of
    `kernel.reduction.reliability`.
    """
    ground = np.zeros(0, dtype=np.int64) if ground is None else ground
    begins = np.append(rows.piece[:, 4], rows.weight.shape[1])
    found, chosen = np.empty((begins[-1], 8)), np.empty((ground.size, 3, NUMBERS))
    order = np.argsort(ground)

    def share(ends: tuple[int, int]) -> None:
        first, last = ends
        mine, point = partition(rows, first, last), int(rows.piece[first, 1])
        places = points[point : point + mine.kind.size]
        values = reduction.reliability(mine, groups, target, model, orientation, joint, places)
        of_rows(values, found[begins[first] : begins[last]])
        own = order[slice(*np.searchsorted(ground, [begins[first], begins[last]], sorter=order))]
        chosen[own] = values[ground[own] - begins[first]]

    edges = np.unique(np.searchsorted(begins, [*range(0, begins[-1], _AT_A_TIME), begins[-1]])).tolist()
    in_threads(share, pairwise(edges))
    return found, chosen

