"""Square root of the information on the unknowns that points share, as elimination leaves it.

Elimination turns a linear system into triangular rows, clique by clique of a tree (the Bayes tree): R x_F + T x_S = d,
the frontal variables F of a clique given its separator S, all of which lie in the parent clique. R' R over all rows is
the information, and its inverse the covariance.
"""

import math
import os
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from threadpoolctl import ThreadpoolController

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index

_WORTHWHILE = 1e10
"""Multiplications of one clique from which on more threads are worth their waiting."""


@cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread for the BLAS, in the whole process.

    Between two products OpenBLAS's threads go on waiting, and where another program has the second core, each product
    waits for the helper to get its turn: some 10 ms. On two cores that others use, too, 3,000 images (30 10^9
    multiplications) take 1 to 2 s with one thread, and 4 to 28 s with two.
    """
    with _controller().limit(limits=1, user_api="blas"):
        yield


def many_threads(operations: float) -> AbstractContextManager[object]:
    """Within `one_thread`: all processors for so many multiplications, where that is worth it."""
    if operations < _WORTHWHILE:
        return nullcontext()
    limit: AbstractContextManager[object] = _controller().limit(limits=os.cpu_count() or 1, user_api="blas")
    return limit


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


def is_indeterminate(error: RuntimeError) -> bool:
    """Whether GTSAM calls a system indeterminate: not positive definite, or so it seems to it."""
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
