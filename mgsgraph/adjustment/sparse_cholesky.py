"""Cholesky factor of the reduced normal equations: multifrontal, over dense blocks of pairs of variables.

The order is GTSAM's (Colamd), the cliques are those of its Bayes tree, so that both factors are the same up to
rounding; what differs is who does the arithmetic. GTSAM's wheels multiply without the processor's wide vectors and
take a Python call per block; here a clique is one dense front, factored by LAPACK (Duff & Reid 1983; Liu 1992).
Of large systems nested dissection (METIS; Karypis & Kumar 1998) is tried beside Colamd, and the order that takes less
work is used: on a grid of 70,000 images it takes 0.6 of it, on 3,000 images it takes more.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.linalg import blas, lapack

from mgsgraph.adjustment.marginals import SquareRoot, begins, many_threads, one_thread
from mgsgraph.compiled import cached_kernel
from mgsgraph.geometry.records import Array, Index, joined_rows, place_of
from mgsgraph.names import numbered

if TYPE_CHECKING:
    import gtsam

_RELAXED = 0.2
"""Share of a front's rows that may be zeros, all that it took in counted, for the sake of a larger one: a few large
fronts take less time than many."""
_POORLY = 2.0**-24
"""Share of a diagonal that elimination must leave of it, or its variable counts as hardly determined (as in GTSAM)."""
_BROAD = 48
"""Columns up to which small cliques of one separator become one, where there are more of these than that."""
_MANY = 1e11
"""Operations from which on another order is tried."""


class NotDefinite(Exception):
    """A normal matrix that is not positive definite."""


@dataclass(frozen=True, eq=False)
class _Front:
    """One clique: its frontal variables, then its separator; and where its numbers come from."""

    variables: Index
    """All of them."""
    frontals: int
    """Number of frontal ones."""
    columns: Index
    """Columns of all, frontal ones first."""
    width: int
    """Frontal columns."""
    source: Index
    """(b,) where its original blocks begin in the flat matrix."""
    shape: Index
    """(b, 2) their rows and columns."""
    place: Index
    """(b, 2) first row and column of each in the front, the lower one first."""
    turned: Index
    """(b,) 1 for a block that stands transposed."""
    children: tuple[int, ...]
    """Cliques whose separators lie in it."""
    index: Index
    """Of its separator's columns, places in the parent's front."""

    @property
    def operations(self) -> float:
        """Multiplications that its elimination takes, roughly."""
        return float(self.width) * self.columns.size**2


class SparseCholesky:
    """The elimination of normal equations of one structure, whatever their numbers.

    Parameters
    ----------
    first, width : (v,)
        First column of each variable, -1 for one without columns, and numbers of columns.
    pairs : (p, 2)
        Variables of the blocks, the first not after the second; each adjusted variable with itself among them.
    offset : (p,)
        Where each block begins in the flat matrix, the first variable's columns down.
    """

    def __init__(self, first: Index, width: Index, pairs: Index, offset: Index) -> None:
        self.first, self.width = first, width
        adjusted = np.all(first[pairs] >= 0, axis=1)
        self._pairs, self._offset = pairs[adjusted], offset[adjusted]
        self._fronts = _make_fronts(first, width, self._pairs, self._offset, _best_cliques(self._pairs, width))
        self.columns = int(width[first >= 0].sum())

    @property
    def operations(self) -> float:
        """Multiplications of a factor, roughly."""
        return sum(front.operations for front in self._fronts)

    def factor(self, flat: Array, diagonal: Array, scales: Array) -> "Factor":
        """Factor of flat blocks plus a diagonal (columns,), per m and rad, in units of `scales` (columns,).

        Raises NotDefinite.
        """
        with one_thread():
            return self._factor(flat.copy(), diagonal, scales)

    def _factor(self, flat: Array, diagonal: Array, scales: Array) -> "Factor":
        _scale(flat, self._offset, self.width[self._pairs], self.first[self._pairs], scales)
        extra = diagonal * scales**2
        rows, updates, determined = list[tuple[Array, Array]](), dict[int, Array](), True
        for k, front in enumerate(self._fronts):
            w, rest = front.width, front.columns.size - front.width
            frontal, across, beyond = (np.zeros(shape, order="F") for shape in ((w, w), (w, rest), (rest, rest)))
            _assemble(frontal.T, across.T, flat, front.source, front.shape, front.place, front.turned)
            for child in front.children:
                _add_at(frontal.T, across.T, beyond.T, updates.pop(child).T, self._fronts[child].index)
            numbers = np.arange(w)
            frontal[numbers, numbers] += extra[front.columns[:w]]
            before = np.diagonal(frontal).copy()
            with many_threads(front.operations):
                frontal, failed = lapack.dpotrf(frontal, lower=0, clean=0, overwrite_a=1)
                if failed:
                    raise NotDefinite
                if rest:
                    across = blas.dtrsm(1.0, frontal, across, lower=0, trans_a=1, overwrite_b=1)
                    updates[k] = blas.dsyrk(-1.0, across, 1.0, beyond, trans=1, lower=0, overwrite_c=1)
            determined &= bool(np.all(np.diagonal(frontal) ** 2 > _POORLY * before))
            rows.append((frontal, across))
        return Factor(self, rows, scales, determined)

    def solve(self, rows: list[tuple[Array, Array]], right: Array) -> Array:
        """Solution (columns,) of the factored equations."""
        with one_thread():
            return self._solve(rows, right.copy())

    def _solve(self, rows: list[tuple[Array, Array]], work: Array) -> Array:
        ends = [np.split(front.columns, [front.width]) for front in self._fronts]
        for (frontal, rest), (upper, across) in zip(ends, rows, strict=True):
            work[frontal] = blas.dtrsv(upper, work[frontal], trans=1)
            work[rest] -= across.T @ work[frontal]
        for (frontal, rest), (upper, across) in zip(ends[::-1], rows[::-1], strict=True):
            work[frontal] = blas.dtrsv(upper, work[frontal] - across @ work[rest])
        return work

    def square_root(self, rows: list[tuple[Array, Array]], scales: Array) -> SquareRoot:
        """The factor as a record, parents first, in 1/m and 1/rad."""
        fronts, at = self._fronts[::-1], 0
        flat = np.empty(sum(front.width * front.columns.size for front in fronts))
        for front, (upper, across) in zip(fronts, rows[::-1], strict=True):
            size = front.width * front.columns.size
            _store_rows(upper.T, across.T, scales[front.columns], flat[at : at + size].reshape(front.width, -1))
            at += size
        return SquareRoot(
            self.first.copy(), self.width.copy(),
            members=joined_rows(front.variables for front in fronts),
            sizes=np.array([front.variables.size for front in fronts], dtype=np.int64),
            frontals=np.array([front.frontals for front in fronts], dtype=np.int64),
            rows=flat,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Factor:
    """A Cholesky factor."""

    structure: SparseCholesky
    rows: list[tuple[Array, Array]]
    """R and T of each clique, children first, in units of `scales`."""
    scales: Array
    """(columns,) m and rad."""
    determined: bool
    """Whether elimination leaves enough of each diagonal that none of the unknowns is suspect."""

    def solve(self, right: Array) -> Array:
        """Solution (columns,), m and rad, for a right side per m and rad."""
        return self.structure.solve(self.rows, right * self.scales) * self.scales

    def square_root(self) -> SquareRoot:
        """The record of it."""
        return self.structure.square_root(self.rows, self.scales)


class _Cliques(NamedTuple):
    """Cliques of an order of elimination, children first."""

    order: Index
    """Variables in this order."""
    members: list[tuple[list[int], list[int]]]
    """Frontal and separator variables of each."""
    parent: list[int]
    """-1 for a root."""
    operations: float
    """Multiplications that they take, roughly."""


def _best_cliques(pairs: Index, width: Index) -> _Cliques:
    """Those of Colamd's order; where they take long, of METIS's, if they take less. Variables that all share rows with
    each other are one clique in any order; the one here is Colamd's.
    """
    variables = np.unique(pairs)
    if len(pairs) == variables.size * (variables.size + 1) // 2:
        return _cliques(np.roll(variables[::-1], 1), pairs, width)
    import gtsam  # slow to import

    graph = gtsam.SymbolicFactorGraph()
    for v, w in pairs.tolist():
        if v == w:
            graph.push_factor(v)
        else:
            graph.push_factor(v, w)
    best = _cliques(_order(gtsam.Ordering.ColamdSymbolicFactorGraph(graph)), pairs, width)
    if best.operations < _MANY:
        return best
    by_metis = _cliques(_order(gtsam.Ordering.MetisSymbolicFactorGraph(graph)), pairs, width)
    return min(best, by_metis, key=lambda cliques: cliques.operations)


def _make_fronts(first: Index, width: Index, pairs: Index, offset: Index, best: _Cliques) -> list[_Front]:
    order, cliques, parent, _ = best
    turn = place_of(order, first.size)
    home = np.full(first.size, -1)
    for k, (frontal, _) in enumerate(cliques):
        home[frontal] = k
    first_eliminated = np.where(turn[pairs[:, 0]] <= turn[pairs[:, 1]], pairs[:, 0], pairs[:, 1])
    blocks = np.argsort(home[first_eliminated], kind="stable")
    edges = np.searchsorted(home[first_eliminated][blocks], np.arange(len(cliques) + 1))
    fronts, place, children = list[_Front](), np.full(first.size, -1), [list[int]() for _ in cliques]
    for k, (frontal, separator) in enumerate(cliques):
        variables = np.array(frontal + separator, dtype=np.int64)
        start = begins(width[variables])
        place[variables] = start[:-1]
        columns = np.repeat(first[variables] - start[:-1], width[variables]) + np.arange(start[-1])
        of_front = blocks[edges[k] : edges[k + 1]]
        at = place[pairs[of_front]]
        turned = at[:, 0] > at[:, 1]
        fronts.append(_Front(
            variables, len(frontal), columns, int(start[len(frontal)]), offset[of_front], width[pairs[of_front]],
            np.where(turned[:, None], at[:, ::-1], at), turned.astype(np.int64), tuple(children[k]), columns[:0],
        ))  # fmt: skip
        if parent[k] >= 0:
            children[parent[k]].append(k)
    inner = np.full(int(width[first >= 0].sum()), -1)
    for front in fronts:
        for child in front.children:
            inner[front.columns] = np.arange(front.columns.size)
            index = inner[fronts[child].columns[fronts[child].width :]]
            object.__setattr__(fronts[child], "index", index)
    return fronts


def _order(ordering: "gtsam.Ordering") -> Index:
    """(v,) variables in the order in which they are eliminated."""
    return np.array([ordering.at(k) for k in range(ordering.size())], dtype=np.int64)


def _cliques(order: Index, pairs: Index, width: Index) -> _Cliques:
    """Cliques of an order, those that hardly differ in one."""
    turn = numbered(order.tolist())
    later = [set[int]() for _ in order]
    for v, w in pairs.tolist():
        low, high = sorted((turn[v], turn[w]))
        later[low].add(high)
    parent, children = [-1] * len(later), [list[int]() for _ in later]
    for k, neighbors in enumerate(later):
        neighbors.discard(k)
        for child in children[k]:
            neighbors |= later[child]
        neighbors.discard(k)
        if neighbors:
            parent[k] = min(neighbors)
            children[parent[k]].append(k)
    frontals: dict[int, list[int]] = {}  # by the last of them
    size = width[order].tolist()
    separator = [sum(size[j] for j in neighbors) for neighbors in later]
    wide, zeros = list(size), [0] * len(size)  # frontal columns of each clique, and the zeros in their rows
    for k in range(len(later)):
        frontals[k] = [k]
        for child in children[k]:  # a child that hardly differs from its parent joins it
            merged = wide[child] + wide[k]
            # zeros that a clique took in before count on: else a band would become one dense front, step by step
            more = zeros[child] + zeros[k] + wide[child] * (wide[k] + separator[k] - separator[child])
            if more <= _RELAXED * merged * (0.5 * merged + separator[k]):
                frontals[k] = frontals.pop(child) + frontals[k]
                wide[k], zeros[k] = merged, more
    _join_twins(frontals, wide, later, children)
    last = sorted(frontals)
    number = numbered(last)
    owner = {k: number[end] for end in last for k in frontals[end]}
    cliques = [
        ([int(order[k]) for k in sorted(frontals[end])], [int(order[k]) for k in sorted(later[end])]) for end in last
    ]
    operations = sum(float(wide[end]) * (wide[end] + separator[end]) ** 2 for end in last)
    return _Cliques(order, cliques, [owner[min(later[end])] if later[end] else -1 for end in last], operations)


def _join_twins(
    frontals: dict[int, list[int]], wide: list[int], later: list[set[int]], children: list[list[int]]
) -> None:
    """Make a few cliques of very many small ones that have no children and the same separator, as groups of errors in
    common have: zeros between them take less time than another front.
    """
    twins = dict[frozenset[int], list[int]]()
    for end in sorted(frontals):
        members = frontals[end]
        if wide[end] < _BROAD and all(child in members for k in members for child in children[k]):
            twins.setdefault(frozenset(later[end]), []).append(end)
    for several in twins.values():
        into = several[0]
        for end in several[1:] if len(several) > _BROAD else ():
            if wide[into] + wide[end] > _BROAD:
                into = end
                continue
            low, high = sorted((into, end))
            frontals[high] += frontals.pop(low)
            wide[high], into = wide[into] + wide[end], high


@cached_kernel
def _scale(flat, offset, shape, first, scales):
    """Bring blocks to units of `scales`."""
    for b in range(offset.size):
        at = offset[b]
        for i in range(shape[b, 0]):
            for j in range(shape[b, 1]):
                flat[at] *= scales[first[b, 0] + i] * scales[first[b, 1] + j]
                at += 1


@cached_kernel
def _store_rows(upper, across, scales, target):
    """Rows [R T] of a clique per m and rad, from R' and T' in units of `scales`; zeros below the diagonal of R.

    In squares that stay in the cache: what is read lies column by column, what is written row by row.
    """
    width, columns = target.shape
    for top in range(0, width, 32):
        for begin in range(0, columns, 32):
            for j in range(begin, min(begin + 32, columns)):
                source = upper[j] if j < width else across[j - width]
                for i in range(top, min(top + 32, width)):
                    target[i, j] = source[i] / scales[j] if i <= j else 0.0


@cached_kernel
def _assemble(frontal, across, flat, source, shape, place, turned):
    """Put original blocks into the rows of a front's frontal variables, upper triangle; a front is given transposed."""
    width = frontal.shape[0]
    for b in range(source.size):
        rows, columns = shape[b]
        down, right = place[b]
        for i in range(rows):
            for j in range(columns):
                value = flat[source[b] + i * columns + j]
                row, column = (down + j, right + i) if turned[b] else (down + i, right + j)
                if column < width:
                    frontal[column, row] += value
                else:
                    across[column - width, row] += value


@cached_kernel
def _add_at(frontal_block, across, beyond, part, index):
    """Add the upper triangle of a child's left-over to its parent's front, at rows and columns `index`, ascending; all
    are given transposed.
    """
    width = frontal_block.shape[0]
    frontal = np.searchsorted(index, width)
    for j in range(index.size):
        column, source = index[j], part[j]
        if column < width:
            target = frontal_block[column]
            for i in range(j + 1):
                target[index[i]] += source[i]
        else:
            target, rest = across[column - width], beyond[column - width]
            for i in range(frontal):
                target[index[i]] += source[i]
            for i in range(frontal, j + 1):
                rest[index[i] - width] += source[i]
