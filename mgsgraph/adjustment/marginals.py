"""Square root of the information on the unknowns that points share, as elimination leaves it, and their covariance.

Elimination turns a linear system into triangular rows, clique by clique of a tree (the Bayes tree): R x_F + T x_S = d,
the frontal variables F of a clique given its separator S, all of which lie in the parent clique. R' R over all rows is
the information, and its inverse the covariance.

From the root of the elimination's tree down (Takahashi, Fagan & Chin 1973; Erisman & Tinney 1975; in estimation Kaess &
Dellaert 2009): of rows R x_F + T x_S = d, the covariance S_SS of what they are conditioned on is known, and X = R^-1 T
gives

    S_FS = -X S_SS,    S_FF = R^-1 R^-T + X S_SS X'.

So every pair of variables within a clique gets its block, among them all pairs that a factor links: what the points
need. Any other block follows from the square root itself.
"""

import math
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from scipy.linalg import lapack
from threadpoolctl import ThreadpoolController

from mgsgraph.compiled import cached_kernel
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.record import Record

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
        if not self._is_consistent():
            problem = "cliques, variables and rows that contradict each other"
            raise InputError("square root", problem, "each adjusted variable frontal in one clique, after its parents")

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

    def cross(self, first: Index, second: Index) -> Array:
        """Covariance (d, e) of any adjusted variables (d columns together) with any others (e columns together).

        The inverse times the unit columns of `first`: forward along their paths to the root, and back along those of
        `second`.
        """
        columns = self._columns(first)
        work = np.zeros((self.columns, columns.size))
        work[columns, np.arange(columns.size)] = 1.0
        self._forward(work, self._ancestry(first)[::-1])
        self._back(work, self._ancestry(second))
        return np.asarray(work[self._columns(second)].T)

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

    @one_thread()
    def _forward(self, work: Array, cliques: Sequence[int]) -> None:
        """R'^-1 times `work` (columns, k), in place, through some cliques, children first."""
        for clique in cliques:
            frontal, separator, upper, across = self._parts(clique)
            work[frontal] = lapack.dtrtrs(upper, work[frontal], trans=1)[0]
            work[separator] -= across.T @ work[frontal]

    @one_thread()
    def _back(self, work: Array, cliques: Sequence[int]) -> None:
        """R^-1 times `work` (columns, k), in place, through some cliques, parents first."""
        for clique in cliques:
            frontal, separator, upper, across = self._parts(clique)
            work[frontal] = lapack.dtrtrs(upper, work[frontal] - across @ work[separator])[0]

    def _parts(self, clique: int) -> tuple[Index, Index, Array, Array]:
        """Frontal and other columns of a clique, its R and its T."""
        rows, columns = self.rows_of(clique), self.columns_of[clique]
        frontal = rows.shape[0]
        return columns[:frontal], columns[frontal:], rows[:, :frontal], rows[:, frontal:]

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

    def _is_consistent(self) -> bool:
        same_shapes = self.first.shape == self.width.shape and self.sizes.shape == self.frontals.shape
        if not same_shapes or np.any(self.width < 1) or np.any((self.frontals < 1) | (self.frontals > self.sizes)):
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



_TOGETHER = 32
"""Variables whose blocks are solved for at a time."""


def carried(covariance: Array, columns: Index, sigmas: Array) -> Array:
    """What considered unknowns c put into unknowns x, a root (x, c) of what is to be added to their covariance.

    Schmidt (1966): with c held by their priors to next to nothing, S_xc S_cc^-1 is how x follows c, exactly, and

        S_xx + V V',    V = S_xc S_cc^-1 (C - S_cc)^1/2,

    the covariance of x with the a-priori covariance C of c carried; of c itself it is C.

    Parameters
    ----------
    covariance : (x, c)
        m and rad, of unknowns with those considered, held.
    columns : (c,)
        Which of x these are.
    sigmas : (c,)
        m and rad, their a-priori sigmas.
    """
    considered = covariance[columns]
    return np.asarray(np.linalg.solve(considered, covariance.T).T @ np.linalg.cholesky(np.diag(sigmas**2) - considered))


@dataclass(frozen=True, eq=False)
class JointCovariance(Record):
    """Joint covariance of the shared unknowns, for sigma0 = 1: the blocks that matter, and any other on demand.

    Examples
    --------
    >>> joint = solution.joint_covariance
    >>> joint.block(0, 1).shape
    (18, 18)
    >>> joint.of([0, 1]).shape
    (36, 36)
    """

    square_root: SquareRoot
    """Of the information; says which variables there are."""
    blocks: Array
    """(t,) m and rad squared, rows [S_FF S_FS] of the cliques, flat, laid out as the rows of the square root."""

    def __post_init__(self) -> None:
        self.blocks.flags.writeable = False
        if self.blocks.shape != (wanted := self.square_root.rows.shape):
            raise InputError("joint covariance", f"shape {self.blocks.shape}", f"{wanted}, as the square root's")

    def __repr__(self) -> str:
        return f"JointCovariance({self.columns} columns, {self.blocks.size} numbers stored)"

    @property
    def columns(self) -> int:
        """Number of shared unknowns."""
        return self.square_root.columns

    @property
    def adjusted(self) -> Index:
        """Variables that have columns."""
        return self.square_root.adjusted

    @property
    def sigmas(self) -> Array:
        """(columns,) standard deviations of the shared unknowns, m and rad."""
        variables, width = self.adjusted, self.square_root.width[self.adjusted]
        _, start, stride = (part[self._find(variables, variables)] for part in self._stored)
        inner = np.arange(self.columns) - np.repeat(begins(width)[:-1], width)
        return np.asarray(np.sqrt(self.blocks[np.repeat(start, width) + inner * np.repeat(stride + 1, width)]))

    def block(self, first: int, second: int) -> Array:
        """Covariance of two variables, m and rad, (width of first, width of second); zero when either is held."""
        flat = self.pairs(np.array([first]), np.array([second]), np.zeros(1, dtype=np.int64))
        return flat.reshape(self.square_root.width[first], self.square_root.width[second])

    def of(self, variables: Iterable[int]) -> Array:
        """Joint covariance (d, d) of any variables, one after another in the order given; zero for held ones."""
        flat = self.of_each([list(variables)])
        size = round(np.sqrt(flat.size))
        return flat.reshape(size, size)

    def dense(self) -> Array:
        """The whole matrix (columns, columns), m and rad: for small networks; all else asks for less."""
        return self.of(self.adjusted.tolist())

    def of_each(self, sets: Sequence[Sequence[int]]) -> Array:
        """Joint covariances of several sets of variables, flat, one after another, each (d, d) with its own d."""
        number = np.array([len(members) for members in sets], dtype=np.int64)
        flat = np.array([v for members in sets for v in members], dtype=np.int64)
        owner, width = np.repeat(np.arange(number.size), number), self.square_root.width[flat]
        before, first_of_set = begins(width), begins(number)
        size = np.diff(before[first_of_set])
        inner = before[:-1] - before[first_of_set[owner]]
        begin = begins(size * size)
        # all pairs within a set: each member as often as its set has members, with each of these in turn
        first = np.repeat(np.arange(flat.size), number[owner])
        second = np.arange(first.size) - np.repeat(begins(number[owner])[:-1] - first_of_set[owner], number[owner])
        stride = size[owner[first]]
        result = np.zeros(begin[-1])
        at = begin[owner[first]] + inner[first] * stride + inner[second]
        self._fill(flat[first], flat[second], at, stride, result)
        return result

    def pairs(self, first: Index, second: Index, offset: Index) -> Array:
        """Blocks of pairs of variables, flat.

        Parameters
        ----------
        first, second : (m,)
            Variables of the rows and of the columns.
        offset : (m,)
            Where each block begins, row by row; what lies between blocks, and blocks of held variables, are zero.
        """
        width = self.square_root.width
        result = np.zeros(int(np.max(offset + width[first] * width[second], initial=0)))
        self._fill(first, second, offset, width[second], result)
        return result

    @cached_property
    def _stored(self) -> tuple[Index, Index, Index]:
        """(m + 1,) codes, in order, of the blocks in store (of a clique's frontal variables with all of its own), where
        the first number of each lies in `blocks`, and from row to row.

        A code is the first variable times the number of variables, plus the second; behind them one of no pair.
        """
        root = self.square_root
        clique = root.clique_of_member[root.frontal_members]
        count = root.sizes[clique]
        row = np.repeat(root.frontal_members, count)
        column = np.arange(row.size) - np.repeat(begins(count)[:-1] - root.first_member[clique], count)
        stride = np.repeat(root.shapes[1][clique], count)
        start = np.repeat(root.offset[clique], count) + root.inner_column[row] * stride + root.inner_column[column]
        code = root.members[row] * root.width.size + root.members[column]
        order, last = np.argsort(code), np.iinfo(np.int64).max
        return np.append(code[order], last), np.append(start[order], -1), np.append(stride[order], -1)

    def _find(self, first: Index, second: Index) -> Index:
        """(m,) place of each pair among those in store; -1 for one that isn't there in this order."""
        code, wanted = self._stored[0], first * self.square_root.width.size + second
        place = np.searchsorted(code, wanted)
        return np.where(code[place] == wanted, place, -1)

    def _fill(self, first: Index, second: Index, at: Index, across: Index, result: Array) -> None:
        """Put blocks of pairs (m,) of variables at places `at` of a flat array, `across` numbers from row to row."""
        width, wanted = self.square_root.width, np.stack([first, second, at, across])
        wanted = wanted[:, np.all(self.square_root.first[wanted[:2]] >= 0, axis=0)]
        straight, back = self._find(*wanted[:2]), self._find(*wanted[1::-1])
        place, stored = np.where(straight >= 0, straight, back), (straight >= 0) | (back >= 0)
        _, start, stride = (part[place[stored]] for part in self._stored)
        _copy(self.blocks, start, stride, straight[stored] < 0, width[wanted[:2, stored]], wanted[2:, stored], result)
        self._solve(wanted[:, ~stored], result)

    def _solve(self, wanted: Index, result: Array) -> None:
        """Put blocks that no clique holds where they go; each pair is solved for once, whichever way round."""
        width = self.square_root.width
        low, high = wanted[:2].min(axis=0), wanted[:2].max(axis=0)
        firsts = np.unique(low)
        for k in range(0, firsts.size, _TOGETHER):
            batch = firsts[k : k + _TOGETHER]
            chosen = np.flatnonzero(np.isin(low, batch))
            seconds = np.unique(high[chosen])
            cross = self.square_root.cross(batch, seconds)
            row = begins(width[batch])[np.searchsorted(batch, low[chosen])]
            start = row * cross.shape[1] + begins(width[seconds])[np.searchsorted(seconds, high[chosen])]
            stride, turned = np.full(chosen.size, cross.shape[1]), wanted[0, chosen] != low[chosen]
            _copy(cross.ravel(), start, stride, turned, width[wanted[:2, chosen]], wanted[2:, chosen], result)


def _copy(
    source: Array, start: Index, stride: Index, turned: Mask, shape: Index, goal: Index, result: Array
) -> None:
    """As `_copy_blocks`, of arrays of the types that it was compiled for."""
    source = source.view()
    source.flags.writeable = False
    _copy_blocks(source, start, stride, turned, np.ascontiguousarray(shape), np.ascontiguousarray(goal), result)


@cached_kernel
def _copy_blocks(source, start, stride, turned, shape, goal, result):
    """Copy blocks of `shape` (2, m): of each the first number in `source`, from row to row there, whether it lies
    transposed there; and the same two of where it goes, `goal` (2, m).
    """
    for m in range(start.size):
        down, right = (1, stride[m]) if turned[m] else (stride[m], 1)
        for i in range(shape[0, m]):
            for j in range(shape[1, m]):
                result[goal[0, m] + i * goal[1, m] + j] = source[start[m] + i * down + j * right]


def joint_covariance(root: SquareRoot) -> JointCovariance:
    """Joint covariance of the variables whose information a square root holds."""
    return JointCovariance(root, _clique_blocks(root))


def dense_covariance(first: Index, width: Index, covariance: Array) -> JointCovariance:
    """Joint covariance of variables of which it is known as one matrix.

    Parameters
    ----------
    first, width : (v,)
        First column of each variable, ascending, -1 for a held one; number of its columns.
    covariance : (columns, columns)
        m and rad, positive definite.
    """
    members = np.flatnonzero(first >= 0)
    turned = np.linalg.cholesky(covariance[::-1, ::-1])[::-1, ::-1]  # U upper, U U' = S: R = U^-1, R'R = S^-1
    rows = np.triu(np.linalg.solve(turned, np.eye(covariance.shape[0])))
    cliques = np.array([members.size] if members.size else [], dtype=np.int64)
    root = SquareRoot(first.copy(), width.copy(), members, cliques, cliques.copy(), rows.ravel())
    return JointCovariance(root, np.ascontiguousarray(covariance).ravel().copy())


def _clique_blocks(root: SquareRoot) -> Array:
    """Rows [S_FF S_FS] of all cliques, flat, by the recursion from the root down."""
    blocks = np.empty_like(root.rows)
    waiting = np.bincount(root.parent[root.parent >= 0], minlength=root.sizes.size)
    full = dict[int, Array]()
    """Covariance of all variables of a clique, kept while children wait for it."""
    place = np.zeros(root.columns, dtype=np.int64)
    with one_thread():
        for clique, parent in enumerate(root.parent.tolist()):
            columns, rows = root.columns_of[clique], root.rows_of(clique)
            covariance, frontal = np.empty((columns.size, columns.size)), rows.shape[0]
            if parent >= 0:
                place[root.columns_of[parent]] = np.arange(root.columns_of[parent].size)
                _copy_square(full[parent], place[columns[frontal:]], covariance[frontal:, frontal:])
                waiting[parent] -= 1
                if waiting[parent] == 0:
                    del full[parent]
            with many_threads(float(frontal) * columns.size**2):
                _fill_frontal(rows, covariance)
            blocks[root.offset[clique] : root.offset[clique + 1]] = covariance[:frontal].ravel()
            if waiting[clique]:
                full[clique] = covariance
    return blocks


def _fill_frontal(rows: Array, covariance: Array) -> None:
    """S_FF and S_FS of a clique of rows [R T], from its S_SS, which stands in `covariance` already."""
    frontal = rows.shape[0]
    inverse = lapack.dtrtri(np.triu(rows[:, :frontal]).T, lower=1)[0].T
    across = inverse @ rows[:, frontal:]
    separator = -(covariance[frontal:, frontal:] @ across.T)
    block = inverse @ inverse.T - across @ separator
    covariance[:frontal, :frontal] = 0.5 * (block + block.T)
    covariance[frontal:, :frontal], covariance[:frontal, frontal:] = separator, separator.T


@cached_kernel
def _copy_square(source, places, target):
    """Copy source[places][:, places] to `target`."""
    for i in range(places.size):
        row = source[places[i]]
        for j in range(places.size):
            target[i, j] = row[places[j]]
