"""Square root of the information on the unknowns that points share, as GTSAM's elimination leaves it.

Elimination turns a linear system into triangular rows, clique by clique of a tree (the Bayes tree): R x_F + T x_S = d,
the frontal variables F of a clique given its separator S, all of which lie in the parent clique. R' R over all rows is
the information, and its inverse the covariance.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index

_ALONE = 1 << 18
"""Multiplications in a product up to which OpenBLAS stays on the calling thread (its interface/gemm.c)."""
_LEAST_ROWS = 8
"""Rows of a piece below which cutting costs more than it spares."""


@dataclass(frozen=True, eq=False)
class SquareRoot:
    """Triangular rows by clique, a parent before its children."""

    first: Index
    """(v,) first column of each variable; -1 for a held one."""
    width: Index
    """(v,) number of its columns; of a held one, how many it would have."""
    members: Index
    """(j,) variables of the cliques, clique after clique, the frontal ones of each before its
    separator."""
    sizes: Index
    """(c,) number of variables of each clique."""
    frontals: Index
    """(c,) how many of them are frontal."""
    rows: Array
    """(t,) 1/m and 1/rad, rows [R T] of the cliques, flat: f rows of f + s numbers for f frontal and s other
    columns."""

    def __post_init__(self) -> None:
        for name in ("first", "width", "members", "sizes", "frontals", "rows"):
            getattr(self, name).flags.writeable = False
        if not self._holds_together():
            found = "cliques, variables and rows that contradict each other"
            raise InputError("square root", found, "each adjusted variable frontal in one clique, after its parents")

    def __repr__(self) -> str:
        return f"SquareRoot({self.columns} columns, {self.sizes.size} cliques, {self.rows.size} numbers)"

    @property
    def columns(self) -> int:
        """Number of shared unknowns."""
        return int(self.width[self.adjusted].sum())

    @cached_property
    def adjusted(self) -> Index:
        """Variables that have columns."""
        return np.flatnonzero(self.first >= 0)

    @cached_property
    def first_member(self) -> Index:
        """(c + 1,) where the members of each clique begin, and where the last ones end."""
        return begins(self.sizes)

    @cached_property
    def clique_of_member(self) -> Index:
        """Clique of each of `members`."""
        return np.repeat(np.arange(self.sizes.size), self.sizes)

    @cached_property
    def frontal_members(self) -> Index:
        """Places in `members` of frontal variables."""
        place = np.arange(self.members.size) - self.first_member[self.clique_of_member]
        return np.flatnonzero(place < self.frontals[self.clique_of_member])

    @cached_property
    def inner_column(self) -> Index:
        """First column of each of `members` within its clique."""
        before = begins(self.width[self.members])
        return before[:-1] - before[self.first_member[self.clique_of_member]]

    @cached_property
    def shapes(self) -> tuple[Index, Index]:
        """(c,) rows (frontal columns) and (c,) columns of each clique."""
        before, start = begins(self.width[self.members]), self.first_member[:-1]
        return before[start + self.frontals] - before[start], before[start + self.sizes] - before[start]

    @cached_property
    def offset(self) -> Index:
        """(c + 1,) where each clique's rows begin in the flat arrays, and where the last ones end."""
        return begins(self.shapes[0] * self.shapes[1])

    @cached_property
    def home(self) -> Index:
        """(v,) clique in which each variable is frontal; -1 for a held one."""
        home = np.full(self.width.size, -1)
        home[self.members[self.frontal_members]] = self.clique_of_member[self.frontal_members]
        return home

    @cached_property
    def parent(self) -> Index:
        """(c,) parent of each clique, -1 for a root: of the homes of its separator, its ancestors, the last."""
        separators = np.delete(np.arange(self.members.size), self.frontal_members)
        parent = np.full(self.sizes.size, -1)
        np.maximum.at(parent, self.clique_of_member[separators], self.home[self.members[separators]])
        return parent

    @cached_property
    def columns_of(self) -> list[Index]:
        """Columns of each clique, frontal ones first."""
        return np.split(self._columns(self.members), begins(self.width[self.members])[self.first_member[1:-1]])

    def rows_of(self, clique: int) -> Array:
        """Rows (f, f + s) of a clique."""
        return self.rows[self.offset[clique] : self.offset[clique + 1]].reshape(self.shapes[0][clique], -1)

    @cached_property
    def triangles(self) -> list[list[tuple[int, int, Array]]]:
        """Of each clique, for its frontal variables in turn, first and last inner column and inverse triangle (w, w).

        NumPy has LAPACK's general solver only: in a triangle that finds nothing to swap or to eliminate, and is left
        with the back-substitution of the unit matrix.
        """
        places, inverses = self.frontal_members, [np.zeros((0, 0))] * self.frontal_members.size
        clique, width = self.clique_of_member[places], self.width[self.members[places]]
        stride, begin = self.shapes[1][clique], self.inner_column[places]
        start = self.offset[clique] + begin * (stride + 1)
        for size in np.unique(width):
            mine, inner = np.flatnonzero(width == size), np.arange(size)
            where = start[mine, None, None] + inner[:, None] * stride[mine, None, None] + inner
            for k, inverse in zip(mine, np.linalg.solve(np.triu(self.rows[where]), np.eye(size)), strict=True):
                inverses[k] = inverse
        found: list[list[tuple[int, int, Array]]] = [[] for _ in self.sizes]
        for home, a, size, inverse in zip(clique.tolist(), begin.tolist(), width.tolist(), inverses, strict=True):
            found[home].append((a, a + size, inverse))
        return found

    def cross(self, ones: Index, others: Index) -> Array:
        """Covariance (d, e) of any adjusted variables (d columns together) with any others (e columns together).

        The inverse times the unit columns of `ones`: forward where their ways to the root lead, and back where those of
        the others come from.
        """
        columns = self._columns(ones)
        work = np.zeros((self.columns, columns.size))
        work[columns, np.arange(columns.size)] = 1.0
        self._forward(work, self._ancestry(ones)[::-1])
        self._back(work, self._ancestry(others))
        return np.asarray(work[self._columns(others)].T)

    def forward(self, right: Array) -> Array:
        """R'^-1 times a vector (columns,) or vectors (columns, k): from the leaves of the cliques' tree to its root."""
        work = right.reshape(self.columns, math.prod(right.shape[1:])).copy()
        self._forward(work, range(self.sizes.size)[::-1])
        return work.reshape(right.shape)

    def back(self, right: Array) -> Array:
        """R^-1 times a vector (columns,) or vectors (columns, k): from the root to the leaves."""
        work = right.reshape(self.columns, math.prod(right.shape[1:])).copy()
        self._back(work, range(self.sizes.size))
        return work.reshape(right.shape)

    def covariance_times(self, right: Array) -> Array:
        """Covariance times a vector (columns,) or vectors (columns, k)."""
        return self.back(self.forward(right))

    def _forward(self, work: Array, cliques: Sequence[int]) -> None:
        """R'^-1 times `work` (columns, k), in place, through some cliques, children first."""
        for clique in cliques:
            columns, rows = self.columns_of[clique], self.rows_of(clique)
            for a, b, inverse in self.triangles[clique]:
                work[columns[a:b]] = inverse.T @ work[columns[a:b]]
                work[columns[b:]] -= product(rows[a:b, b:].T, work[columns[a:b]])

    def _back(self, work: Array, cliques: Sequence[int]) -> None:
        """R^-1 times `work` (columns, k), in place, through some cliques, parents first."""
        for clique in cliques:
            columns, rows = self.columns_of[clique], self.rows_of(clique)
            for a, b, inverse in self.triangles[clique][::-1]:
                known = product(work[columns[b:]].T, rows[a:b, b:].T).T
                work[columns[a:b]] = inverse @ (work[columns[a:b]] - known)

    def _columns(self, variables: Index) -> Index:
        """Columns of adjusted variables, one after another."""
        width = self.width[variables]
        return np.arange(width.sum()) + np.repeat(self.first[variables] - begins(width)[:-1], width)

    def _ancestry(self, variables: Index) -> list[int]:
        """Cliques on the ways from variables to the root, parents first."""
        met = set[int]()
        for home in self.home[variables].tolist():
            clique = int(home)
            while clique >= 0 and clique not in met:
                met.add(clique)
                clique = int(self.parent[clique])
        return sorted(met)

    def _holds_together(self) -> bool:
        alike = self.first.shape == self.width.shape and self.sizes.shape == self.frontals.shape
        if not alike or np.any(self.width < 1) or np.any((self.frontals < 1) | (self.frontals > self.sizes)):
            return False
        if self.members.size != self.sizes.sum() or np.any((self.members < 0) | (self.members >= self.width.size)):
            return False
        separators = np.delete(np.arange(self.members.size), self.frontal_members)
        return (
            np.array_equal(self.first[self.adjusted], begins(self.width[self.adjusted])[:-1])
            and np.array_equal(np.sort(self.members[self.frontal_members]), self.adjusted)
            and bool(np.all(self.first[self.members] >= 0))
            and bool(np.all(self.home[self.members[separators]] < self.clique_of_member[separators]))
            and self.rows.shape == (int(self.offset[-1]),)
        )


def eliminate(linear: gtsam.GaussianFactorGraph, keys: Sequence[int | None], widths: Sequence[int]) -> SquareRoot:
    """Square root of a linear system, by GTSAM's multifrontal elimination in Colamd's order.

    Parameters
    ----------
    linear : GaussianFactorGraph
        Factors on the adjusted variables alone; single ones may be indefinite, their sum may not.
    keys : sequence of int or None
        GTSAM key of each variable; None for a held one.
    widths : sequence of int
        Number of columns of each.

    Raises
    ------
    RuntimeError
        "Indeterminate linear system", as GTSAM words it, when the sum is not positive definite.
    """
    width = np.array(widths, dtype=np.int64)
    adjusted = np.array([key is not None for key in keys], dtype=bool)
    first = np.where(adjusted, np.cumsum(width * adjusted) - width, -1)
    variable = {key: v for v, key in enumerate(keys) if key is not None}
    _require_factors(linear, variable)
    ordering = gtsam.Ordering.ColamdGaussianFactorGraph(linear)
    turn = {variable[ordering.at(k)]: k for k in range(ordering.size())}
    tree = gtsam.GaussianFactorGraph()
    tree.push_back(linear.eliminateMultifrontal(ordering))
    factors = [tree.at(k) for k in range(tree.size())]
    conditionals = [factor for factor in factors if isinstance(factor, gtsam.GaussianConditional)]
    keys_of = [conditional.keys() for conditional in conditionals]
    members = [[variable[key] for key in held] for held in keys_of]
    rows = [np.hstack([conditional.R(), conditional.S()]) for conditional in conditionals]
    frontals = [
        int(np.searchsorted(np.cumsum(width[held]), part.shape[0])) + 1
        for held, part in zip(members, rows, strict=True)
    ]
    # a separator is eliminated after its clique: in the order of their last frontal variables, parents follow children
    last = [max(turn[v] for v in held[:number]) for held, number in zip(members, frontals, strict=True)]
    order = np.argsort(last)[::-1].tolist()
    return SquareRoot(
        first,
        width,
        members=np.array([v for k in order for v in members[k]], dtype=np.int64),
        sizes=np.array([len(members[k]) for k in order], dtype=np.int64),
        frontals=np.array([frontals[k] for k in order], dtype=np.int64),
        rows=np.concatenate([np.zeros(0), *(rows[k].ravel() for k in order)]),
    )


def is_indeterminate(error: RuntimeError) -> bool:
    """Whether GTSAM, or `eliminate`, calls a system indeterminate: not positive definite, or so it seems to it."""
    return "Indeterminate" in str(error)


def in_cliques(first: Index, width: Index, cliques: Sequence[Sequence[int]], rows: Sequence[Array]) -> SquareRoot:
    """Square root of information that joins no variable of one clique with one of another.

    Parameters
    ----------
    first, width : (v,)
        As `SquareRoot` has them.
    cliques : sequence of sequence of int
        Variables of each, all frontal.
    rows : sequence of (c, c) arrays
        Triangular rows of each.
    """
    sizes = np.array([len(members) for members in cliques], dtype=np.int64)
    members = np.array([v for clique in cliques for v in clique], dtype=np.int64)
    flat = np.concatenate([np.zeros(0), *(part.ravel() for part in rows)])
    return SquareRoot(first.copy(), width.copy(), members, sizes, sizes.copy(), flat)


def _require_factors(linear: gtsam.GaussianFactorGraph, variable: Mapping[int, int]) -> None:
    """Raise unless there are factors on all of these keys, and on no others."""
    found = set(linear.keyVector())
    if foreign := sorted(found - set(variable)):
        raise ValueError(f"factors on the keys {foreign[:3]}, which belong to no adjusted variable")
    for key in sorted(set(variable) - found)[:1]:
        raise RuntimeError(f"Indeterminate linear system: no factor on variable {variable[key]}")


def begins(sizes: Index) -> Index:
    """(n + 1,) where each of n pieces laid one after another begins, and where the last one ends."""
    return np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(sizes, dtype=np.int64)])


def product(left: Array, right: Array) -> Array:
    """Matrix product, rows of `left` in pieces small enough for one thread.

    Two threads gain little here, and where another program has the second core, each product waits for the helper to
    get its turn: some 10 ms, a hundred times the work.
    """
    rows = _ALONE // max(right.size, 1)
    if rows >= left.shape[0] or rows < _LEAST_ROWS:
        return left @ right
    result = np.empty((left.shape[0], right.shape[1]))
    for k in range(0, left.shape[0], rows):
        np.matmul(left[k : k + rows], right, out=result[k : k + rows])
    return result
