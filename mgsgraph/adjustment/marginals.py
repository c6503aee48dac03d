"""Covariance of the unknowns that points share, without the full inverse.

From the root of the elimination's tree down (Takahashi, Fagan & Chin 1973; Erisman & Tinney 1975; in estimation Kaess &
Dellaert 2009): of rows R x_F + T x_S = d, the covariance S_SS of what they are conditioned on is known, and X = R^-1 T
gives

    S_FS = -X S_SS,    S_FF = R^-1 R^-T + X S_SS X'.

So every pair of variables within a clique gets its block, among them all pairs that a factor links: what the points
need. Any other block follows from the square root itself.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import lapack

from mgsgraph.adjustment.square_root import SquareRoot, begins, many_threads, one_thread
from mgsgraph.compiled import cached_kernel
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.record import Record

_PIECE = 1 << 18
"""Numbers copied at a time, which bounds the index arrays."""
_TOGETHER = 32
"""Variables whose blocks are solved for at a time."""


class _Places(NamedTuple):
    """Where blocks lie in a flat array: number (a, b) at start + a stride + b."""

    start: Index
    """(m,) place of number (0, 0)."""
    stride: Index
    """(m,) from row to row."""

    def only(self, chosen: Index | Mask) -> "_Places":
        """Some of them."""
        return _Places(self.start[chosen], self.stride[chosen])

    def rows(self, number: int) -> Index:
        """(m, number) where the rows of each block begin."""
        return self.start[:, None] + np.arange(number) * self.stride[:, None]


class _Wanted(NamedTuple):
    """Blocks asked for, and where they go."""

    first: Index
    """(m,) variable of the rows."""
    second: Index
    """(m,) variable of the columns."""
    places: _Places

    def only(self, chosen: Index | Mask) -> "_Wanted":
        """Some of them."""
        return _Wanted(self.first[chosen], self.second[chosen], self.places.only(chosen))


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
    own = covariance[columns]
    root = np.linalg.cholesky(np.diag(sigmas**2) - own)
    return np.asarray(np.linalg.solve(own, covariance.T).T @ root)


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
        if self.blocks.shape != self.square_root.rows.shape:
            raise InputError(
                "joint covariance", f"shape {self.blocks.shape}", f"{self.square_root.rows.shape}, as the square root's"
            )

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
        start, stride = self._stored[1].only(self._find(variables, variables))
        inner = np.arange(self.columns) - np.repeat(begins(width)[:-1], width)
        return np.asarray(np.sqrt(self.blocks[np.repeat(start, width) + inner * np.repeat(stride + 1, width)]))

    def block(self, one: int, other: int) -> Array:
        """Covariance of two variables, m and rad, (width of one, width of other); zero when either is held."""
        flat = self.pairs(np.array([one]), np.array([other]), np.zeros(1, dtype=np.int64))
        return flat.reshape(self.square_root.width[one], self.square_root.width[other])

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
        one = np.repeat(np.arange(flat.size), number[owner])
        other = np.arange(one.size) - np.repeat(begins(number[owner])[:-1] - first_of_set[owner], number[owner])
        stride = size[owner[one]]
        result = np.zeros(begin[-1])
        places = _Places(begin[owner[one]] + inner[one] * stride + inner[other], stride)
        self._fill(_Wanted(flat[one], flat[other], places), result)
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
        self._fill(_Wanted(first, second, _Places(offset, width[second])), result)
        return result

    @cached_property
    def _stored(self) -> tuple[Index, _Places]:
        """(m,) codes, in order, and places of the blocks in store: of a clique's frontal variables with all of its own.

        A code is the first variable times the number of variables, plus the second.
        """
        root = self.square_root
        clique = root.clique_of_member[root.frontal_members]
        count = root.sizes[clique]
        row = np.repeat(root.frontal_members, count)
        column = np.arange(row.size) - np.repeat(begins(count)[:-1] - root.first_member[clique], count)
        stride = np.repeat(root.shapes[1][clique], count)
        start = np.repeat(root.offset[clique], count) + root.inner_column[row] * stride + root.inner_column[column]
        code = root.members[row] * root.width.size + root.members[column]
        order = np.argsort(code)
        return code[order], _Places(start, stride).only(order)

    def _find(self, first: Index, second: Index) -> Index:
        """(m,) place of each pair among those in store; -1 for one that isn't there in this order."""
        code, wanted = self._stored[0], first * self.square_root.width.size + second
        place = np.searchsorted(code, wanted)
        known = np.append(code, -1)[place] == wanted
        return np.where(known, place, -1)

    def _fill(self, wanted: _Wanted, result: Array) -> None:
        """Put blocks where they go."""
        adjusted, width = self.square_root.first >= 0, self.square_root.width
        wanted = wanted.only(adjusted[wanted.first] & adjusted[wanted.second])
        for turned in (False, True):
            place = self._find(wanted.second, wanted.first) if turned else self._find(wanted.first, wanted.second)
            found = place >= 0
            _copy(self.blocks, self._stored[1].only(place[found]), turned, wanted.only(found), width, result)
            wanted = wanted.only(~found)
        self._solve(wanted, result)

    def _solve(self, wanted: _Wanted, result: Array) -> None:
        """Put blocks that no clique holds where they go; each pair is solved for once, whichever way round."""
        width = self.square_root.width
        low, high = np.minimum(wanted.first, wanted.second), np.maximum(wanted.first, wanted.second)
        every = np.unique(low)
        for k in range(0, every.size, _TOGETHER):
            ones = every[k : k + _TOGETHER]
            mine = np.isin(low, ones)
            others = np.unique(high[mine])
            cross = self.square_root.cross(ones, others)
            row = begins(width[ones])[np.searchsorted(ones, low)]
            column = begins(width[others])[np.searchsorted(others, high)]
            places = _Places(row * cross.shape[1] + column, np.full(row.size, cross.shape[1]))
            for turned, chosen in ((False, mine & (wanted.first == low)), (True, mine & (wanted.first != low))):
                _copy(cross.ravel(), places.only(chosen), turned, wanted.only(chosen), width, result)


def _copy(source: Array, places: _Places, turned: bool, wanted: _Wanted, width: Index, result: Array) -> None:
    """Copy blocks from their places in `source`, where they lie transposed when `turned`, to where they are wanted."""
    shapes = np.stack([width[wanted.first], width[wanted.second]], axis=1)
    for shape in np.unique(shapes, axis=0):
        mine = np.flatnonzero(np.all(shapes == shape, axis=1))
        rows, columns = shape[::-1].tolist() if turned else shape.tolist()
        for piece in np.array_split(mine, 1 + mine.size * rows * columns // _PIECE):
            found = sliding_window_view(source, columns)[places.only(piece).rows(rows)]
            goal = sliding_window_view(result, shape[1], writeable=True)
            goal[wanted.places.only(piece).rows(shape[0])] = np.swapaxes(found, 1, 2) if turned else found


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
    whole = dict[int, Array]()
    """Covariance of all variables of a clique, kept while children wait for it."""
    place = np.zeros(root.columns, dtype=np.int64)
    with one_thread():
        for clique, parent in enumerate(root.parent.tolist()):
            columns, rows = root.columns_of[clique], root.rows_of(clique)
            covariance, frontal = np.empty((columns.size, columns.size)), rows.shape[0]
            if parent >= 0:
                place[root.columns_of[parent]] = np.arange(root.columns_of[parent].size)
                _copy_square(whole[parent], place[columns[frontal:]], covariance[frontal:, frontal:])
                waiting[parent] -= 1
                if waiting[parent] == 0:
                    del whole[parent]
            with many_threads(float(frontal) * columns.size**2):
                _fill_frontal(rows, covariance)
            blocks[root.offset[clique] : root.offset[clique + 1]] = covariance[:frontal].ravel()
            if waiting[clique]:
                whole[clique] = covariance
    return blocks


def _fill_frontal(rows: Array, covariance: Array) -> None:
    """S_FF and S_FS of a clique of rows [R T], from its S_SS, which stands in `covariance` already."""
    frontal = rows.shape[0]
    inverse = lapack.dtrtri(np.triu(rows[:, :frontal]).T, lower=1)[0].T
    across = inverse @ rows[:, frontal:]
    beside = -(covariance[frontal:, frontal:] @ across.T)
    own = inverse @ inverse.T - across @ beside
    covariance[:frontal, :frontal] = 0.5 * (own + own.T)
    covariance[frontal:, :frontal], covariance[:frontal, frontal:] = beside, beside.T


@cached_kernel
def _copy_square(source, places, target):
    """Copy source[places][:, places] to `target`."""
    for i in range(places.size):
        row = source[places[i]]
        for j in range(places.size):
            target[i, j] = row[places[j]]
