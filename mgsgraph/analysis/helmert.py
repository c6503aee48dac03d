"""Redundancy of groups of rows; Helmert's matrix, which says how the squares of one group depend on the sigmas of
another; and which groups' variance factors are correlated.

With the covariance R = 1 - A Q A' of the whitened residuals, v_g'v_g is expected to be sum_k S_gk s_k for variance
factors s, S_gk = |R_gk|^2 (squares of all numbers of the block) (Helmert 1907; Foerstner 1979; Foerstner & Wrobel 2016,
section 4.2.4). Neither A nor R is ever formed: with the points eliminated, P = B L^-T and A~ = J - P P'J of each point
p and the covariance S of the shared unknowns, the block of A Q A' between points p and q is
P_p P_q' [p = q] + A~_p S A~_q', and its squares add up to

    sum_p |P_g P_k'|^2 + 2 tr(P_k P_g' A~_g S A~_k')  +  tr(N_g S N_k S),    N_g = sum_p A~_g' A~_g.

Priors of the shared unknowns are rows of their own, A~ = 1/sigma.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.adjustment.covariances import Linearised, PointRows
from mgsgraph.adjustment.marginals import JointCovariance, one_thread
from mgsgraph.analysis.grouping import Grouping
from mgsgraph.analysis.linearised import prior_rows
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.rows import OUT

if TYPE_CHECKING:
    from scipy.sparse import csr_array

DENSE = 2000
"""Shared unknowns up to which the last term is exact; beyond, it is estimated with random signs (Hutchinson 1990)."""
_PROBES = 64
CORRELATED = 0.5
"""Correlation of two groups' squared factors from which on a verdict names the other group."""
_HALF = 0.75
"""By how much a variance factor changes when sigmas change by half."""


@dataclass(frozen=True, slots=True, eq=False)
class Redundancy:
    """What the residuals of g groups of rows say of their sigmas."""

    names: tuple[str, ...]
    """(g,) groups."""
    counts: Index
    """(g,) rows that take part."""
    squares: Array
    """(g,) sum of the squares of the whitened residuals."""
    redundancy: Array
    """(g,) sum of the redundancy numbers, expected value of `squares`."""
    helmert: Array
    """(g, g) Helmert's matrix; its rows add up to `redundancy`."""
    exact: bool
    """False where the matrix is an estimate with random signs."""


def group_redundancy(at: Linearised, grouping: Grouping, dense: int = DENSE) -> Redundancy:
    """Redundancy of groups of rows at a solution; `dense` as `DENSE`."""
    sums = _Sums(at, len(grouping.names))
    for rows, groups in _alike(at, grouping):
        sums.add(rows, groups)
    sums.close()
    known, size = prior_rows(at), len(grouping.names)
    of_row = grouping.of_priors(at.layout)
    counts = sums.counts + np.bincount(of_row, minlength=size)
    squares = sums.squares + np.bincount(of_row, known.misfit**2, size)
    shares = sums.shares + np.bincount(of_row, known.share, size)
    normals = sums.normals(of_row)
    redundancy, exact = counts - shares, at.layout.columns <= dense
    if exact:
        helmert = sums.cross + _traces(normals, at.joint.dense())
        helmert[np.diag_indices(size)] += counts - 2.0 * shares
    else:
        helmert = sums.cross + _estimated_traces(normals, at.joint)
        # between groups the estimate is good; within one the rows' sum is known, which leaves no need for it
        np.fill_diagonal(helmert, 0.0)
        helmert[np.diag_indices(size)] = redundancy - helmert.sum(axis=1)
    return Redundancy(grouping.names, counts, squares, redundancy, helmert, exact)


def _alike(at: Linearised, grouping: Grouping) -> Iterator[tuple[PointRows, Index]]:
    """Rows of points that take part and whose rows belong to the same groups (r,)."""
    of_observation, rows = grouping.of_observations(at.layout), at.rows
    for piece, (pattern, first, count, _, among) in enumerate(rows.piece.tolist()):
        inside = np.flatnonzero(rows.kind[first : first + count] != OUT)
        observations = int(rows.pattern_observation[pattern + 1] - rows.pattern_observation[pattern])
        if not inside.size or not observations:
            continue
        whole = at.rows_of_piece(piece)
        groups = of_observation[among : among + observations * count].reshape(observations, count)[:, inside]
        sets, which = np.unique(groups, axis=1, return_inverse=True)
        for k, of_set in enumerate(sets.T):
            mine = inside[which.reshape(-1) == k]
            part = replace(
                whole, residuals=whole.residuals[mine], by_point=whole.by_point[mine], by_shared=whole.by_shared[mine]
            )
            yield part, of_set[part.observation]


class _Sums:
    """What is summed over the points; the blocks of N of one set of unknowns are gathered before they are put away."""

    def __init__(self, at: Linearised, groups: int) -> None:
        self._at, self._blocks = at, at.layout.blocks
        self.counts = np.zeros(groups, dtype=np.int64)
        self.squares, self.shares, self.cross = np.zeros(groups), np.zeros(groups), np.zeros((groups, groups))
        self._flat = np.zeros((groups, self._blocks.target.size))
        self._variables: tuple[int, ...] | None = None
        self._normal, self._covariance = np.zeros((groups, 0, 0)), np.zeros((0, 0))

    @one_thread()
    def add(self, rows: PointRows, groups: Index) -> None:
        """Rows of some points, each row (r,) of one group for all of them."""
        self._open(rows.variables)
        through, rest = rows.following()
        # rows that were rejected are zero
        present = np.any(rows.by_point != 0.0, axis=2) | np.any(rows.by_shared != 0.0, axis=2) | (rows.residuals != 0.0)
        inner, outer, carried = dict[int, Array](), dict[int, Array](), dict[int, Array]()
        found = np.unique(groups).tolist()
        for g in found:
            mine = groups == g
            own, left = through[:, mine], rest[:, mine]
            turned = np.swapaxes(own, 1, 2)
            inner[g], outer[g] = (turned @ own).reshape(-1), _stacked(turned @ left)
            flat = _stacked(left)
            normal = flat.T @ flat
            carried[g] = outer[g] @ self._covariance
            self._normal[g] += normal
            self.counts[g] += np.count_nonzero(present[:, mine])
            self.squares[g] += np.sum(rows.residuals[:, mine] ** 2)
            self.shares[g] += np.sum(own**2) + np.sum(normal * self._covariance)
        for g in found:
            for k in found:
                self.cross[g, k] += inner[g] @ inner[k] + 2.0 * np.vdot(carried[g], outer[k])

    def close(self) -> None:
        """Add the gathered blocks to the sums."""
        if self._variables is None:
            return
        layout = self._at.layout
        group = layout.group_variables.index(self._variables)
        width = layout.variables.width[list(self._variables)].tolist()
        ends, start = np.concatenate([[0], np.cumsum(width)]).tolist(), int(layout.groups.pair_first[group])
        for i, a in enumerate(width):
            for j, b in enumerate(width[i:], i):
                at = int(self._blocks.target.pair[start + i * len(width) + j])
                part = self._normal[:, ends[i] : ends[i] + a, ends[j] : ends[j] + b]
                self._flat[:, at : at + a * b] += part.reshape(part.shape[0], -1)
        self._variables = None

    def normals(self, of_row: Index) -> "list[csr_array]":
        """N of each group, with its priors' own rows, whose groups are `of_row`."""
        from scipy.sparse import coo_array  # slow to import

        layout, found = self._at.layout, []
        variables = layout.variables
        links = list[tuple[Index, Index, Index]]()
        """Row, column, and place in the flat arrays, of the numbers of each block."""
        for v, w, at in zip(self._blocks.first, self._blocks.second, self._blocks.offset, strict=True):
            a, b = np.arange(variables.width[v]), np.arange(variables.width[w])
            where = at + np.arange(a.size * b.size)
            one = np.repeat(variables.first[v] + a, b.size)
            other = np.tile(variables.first[w] + b, a.size)
            links += [(one, other, where)] if v == w else [(one, other, where), (other, one, where)]
        links.append((np.zeros(0, dtype=np.int64),) * 3)
        row, column, place = (np.concatenate(part) for part in zip(*links, strict=True))
        for g, flat in enumerate(self._flat):
            values, prior = flat[place], layout.prior.every[np.flatnonzero(of_row == g)]
            taken = values != 0.0
            made = coo_array((values[taken], (row[taken], column[taken])), shape=(layout.columns, layout.columns))
            found.append(made.tocsr() + (prior.T @ prior).tocsr())
        return found

    def _open(self, variables: tuple[int, ...]) -> None:
        if variables != self._variables:
            self.close()
            self._variables = variables
            self._covariance = self._at.joint.of(variables) if variables else np.zeros((0, 0))
            self._normal = np.zeros((self.counts.size, *self._covariance.shape))


def _stacked(matrices: Array) -> Array:
    """(m r, c) rows of matrices (m, r, c), of which c may be none: that is, of points that held images alone see."""
    m, r, c = matrices.shape
    return matrices.reshape(m * r, c)


def _traces(normals: "list[csr_array]", covariance: Array) -> Array:
    """(g, g) tr(N_g S N_k S)."""
    half = [normal @ covariance for normal in normals]
    found = np.zeros((len(half), len(half)))
    for g, one in enumerate(half):
        for k, other in enumerate(half[: g + 1]):
            found[g, k] = found[k, g] = np.sum(one * other.T)
    return found


def _estimated_traces(normals: "list[csr_array]", joint: JointCovariance) -> Array:
    """(g, g) estimates of tr(N_g S N_k S): with S = U U' and random signs z it is E (U'N_g U z)'(U'N_k U z)."""
    signs, root = np.random.default_rng(0).choice([-1.0, 1.0], (joint.columns, _PROBES)), joint.square_root
    spread = root.back(signs)
    projected = [root.forward(normal @ spread) for normal in normals]
    return np.array([[np.sum(one * other) for other in projected] for one in projected]) / _PROBES


def nearest(found: Redundancy, group: int) -> tuple[str, float]:
    """The group whose residuals have most in common with those of a group that can't be judged, and minus the cosine
    between the two in Helmert's matrix: -1 where all redundancy of the one is the other's.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(found.helmert), 1e-300))
    alike = (found.helmert * scale[:, None] * scale)[group]
    alike[group] = -1.0
    k = int(np.argmax(alike))
    return found.names[k], -float(alike[k])


def most_correlated(found: Redundancy, judged: Index, group: int) -> tuple[str, float]:
    """The judged group whose squared factor is most correlated with that of a group, were they estimated together."""
    others = judged[judged != group]
    if not others.size or found.helmert[group, group] <= 0.0:
        return "", math.nan
    own = np.concatenate([[group], others])
    scale = 1.0 / np.sqrt(np.diag(found.helmert)[own])
    inverse = np.linalg.pinv(found.helmert[np.ix_(own, own)] * scale[:, None] * scale, hermitian=True)
    shared = inverse[0, 1:] / np.sqrt(np.maximum(inverse[0, 0] * np.diag(inverse)[1:], np.finfo(np.float64).tiny))
    k = int(np.argmax(np.abs(shared)))
    return found.names[int(others[k])], float(shared[k])


def given(found: Redundancy, judged: Index, group: int, degrees: float) -> str:
    """The group that isn't judged on whose sigmas the factor of a judged one depends most, where that is much."""
    others = np.setdiff1d(np.arange(len(found.names)), judged)
    if group not in judged or not others.size:
        return ""
    for other in others:
        beside, shared = most_correlated(found, judged, int(other))
        if beside == found.names[group] and abs(shared) > CORRELATED:
            return found.names[int(other)]
    effects = np.linalg.solve(found.helmert[np.ix_(judged, judged)], found.helmert[np.ix_(judged, others)])
    mine = np.abs(effects[judged == group][0])
    worst = int(np.argmax(mine))
    return found.names[int(others[worst])] if _HALF * mine[worst] > 0.5 * math.sqrt(2.0 / degrees) else ""
