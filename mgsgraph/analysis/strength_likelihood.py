"""Restricted likelihood of the strengths of processes, from an adjustment with other strengths.

With everything else eliminated the measures say y = x + e of the nodes x of all passes, x being normal with the
covariance K = sum_i s_i^2 C_i + trend: linear in the variances s_i^2, C_i being the covariance functions' own matrices.
Their likelihood is that of y, with covariance V = K + cov(e). Nothing of y and e has to be formed: an adjustment with
K_0 gives W_0 = V_0^-1 = P_0 - P_0 S P_0 and u_0 = V_0^-1 y = P_0 x, S being the posterior covariance, x the estimate
and P_0 = K_0^-1; then with D = K - K_0

    W = W_0 (1 + D W_0)^-1,   u = (1 + W_0 D)^-1 u_0,
    d(log likelihood) / d(s_i^2) = (u' C_i u - tr(W C_i)) / 2,   information F_ik = tr(W C_i W C_k) / 2

(Patterson & Thompson 1971; Rasmussen & Williams 2006, eq. 5.9). Components know nothing of each other beforehand, and D
is zero but for those whose strengths are sought: all else falls out of these equations exactly, and isn't formed.
Passes are taken together: where one is seen against another alone, S has it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Pass, ProcessPrior
from mgsgraph.network.conditioning import dense_covariance
from mgsgraph.network.node_priors import normalised

_INNER, _HALVINGS, _AT_REST = 30, 8, 1e-3
"""Steps of scoring for one adjustment, and halvings of one; log strengths, in their standard deviations."""
Block = tuple[slice, Array]
"""Rows of a pass's component among all that are sought, and a covariance (k, k) of its nodes, m^2 or rad^2."""


class Member(NamedTuple):
    """A process of a pass along one axis."""

    of_pass: int
    """Number of the pass."""
    number: int
    """Of the process, within its part."""
    component: int
    """0 .. 5: X, Y, Z, x, y, z."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What an adjustment says of strengths: n components of nodes, p strengths."""

    start: Array
    """W_0 (n, n)."""
    push: Array
    """u_0 (n,)."""
    parts: tuple[tuple[Block, ...], ...]
    """Of each strength the covariances that it scales, as they are in the adjustment."""
    known: "Known"
    """Of the same components."""

    @classmethod
    def of(cls, solution: Solution, wanted: Sequence[Sequence[Member]]) -> "Evidence":
        """Of strengths (p), each of some members."""
        network = solution.network
        pairs = sorted({(one.of_pass, one.component) for members in wanted for one in members})
        sizes = [len(network.passes[k].nodes) for k, _ in pairs]
        ends = np.concatenate([[0], np.cumsum(sizes)]).tolist()
        rows = {pair: slice(ends[i], ends[i + 1]) for i, pair in enumerate(pairs)}
        known = _known(solution, rows, wanted)
        found, push = known.prior - known.prior @ known.posterior @ known.prior, known.prior @ known.values
        parts = [
            tuple((rows[one.of_pass, one.component], _covariance(network.passes[one.of_pass], one)) for one in members)
            for members in wanted
        ]
        return cls(0.5 * (found + found.T), push, tuple(parts), known)

    def without(self, kept: Index) -> "Evidence":
        """Of some strengths alone; the others stay as they are."""
        parts = [self.parts[i] for i in kept.tolist()]
        mine = sorted({(block.start, block.stop) for part in parts for block, _ in part})
        rows = np.concatenate([np.arange(*one) for one in mine] or [np.zeros(0, dtype=np.int64)])
        ends = np.concatenate([[0], np.cumsum([stop - start for start, stop in mine])]).tolist()
        moved = {one: slice(ends[i], ends[i + 1]) for i, one in enumerate(mine)}
        taken = tuple(tuple((moved[b.start, b.stop], matrix) for b, matrix in part) for part in parts)
        return Evidence(self.start[np.ix_(rows, rows)], self.push[rows], taken, self.known.of(rows))

    def maximum(self, most: float) -> Array:
        """(p,) change of the log strengths to the largest likelihood, by Fisher's scoring; `most` upward at most."""
        steps = np.zeros(len(self.parts))
        if not steps.size:
            return steps
        here = self.likelihood(steps)
        for _ in range(_INNER):
            move = np.clip(np.linalg.solve(here.information + 0.05 * np.eye(steps.size), here.score), -1.0, 1.0)
            for _ in range(_HALVINGS):
                trial = np.clip(steps + move, -3.0 * most, most)
                there = self.likelihood(trial)
                if there.logarithm >= here.logarithm:
                    break
                move = 0.5 * move  # scoring overshoots where the likelihood bends more than is expected
            else:
                break
            steps, here = trial, there
            if np.all(np.abs(move) * np.sqrt(1.0 + np.diagonal(here.information)) < _AT_REST):
                break
        return steps

    def over_nothing(self) -> float:
        """Log likelihood of the strengths that the adjustment had, over that of none of these processes, nats.

        D = T - P_0^-1, T being all else that is known; then 1 + W_0 D = P_0 S + W_0 T, without differences.
        """
        from scipy.linalg import lu_factor, lu_solve  # slow to import

        known = self.known
        factored = lu_factor(known.prior @ known.posterior + self.start @ known.others)
        pulled = (known.others @ self.push - known.values) @ lu_solve(factored, self.push)
        return float(0.5 * np.sum(np.log(np.abs(np.diagonal(factored[0])))) - 0.5 * pulled)

    def likelihood(self, steps: Array) -> "Likelihood":
        """Where log strengths change by `steps` (p,)."""
        from scipy.linalg import lu_factor, lu_solve  # slow to import

        grown, change = np.exp(2.0 * steps), np.zeros_like(self.start)
        for growth, part in zip(grown, self.parts, strict=True):
            for mine, matrix in part:
                change[mine, mine] += (growth - 1.0) * matrix
        factored = lu_factor(np.eye(self.push.size) + self.start @ change)
        within, pushed = lu_solve(factored, self.start), lu_solve(factored, self.push)
        logarithm = 0.5 * float(self.push @ change @ pushed - np.sum(np.log(np.abs(np.diagonal(factored[0])))))
        through = [
            [(mine, within[:, mine] @ (growth * matrix)) for mine, matrix in part]
            for growth, part in zip(grown, self.parts, strict=True)
        ]
        traces = np.array([sum(np.trace(product[mine]) for mine, product in part) for part in through])
        squares = np.array([
            growth * sum(pushed[mine] @ matrix @ pushed[mine] for mine, matrix in part)
            for growth, part in zip(grown, self.parts, strict=True)
        ])  # fmt: skip
        information = np.array([
            [2.0 * sum(np.sum(a[d] * b[c].T) for c, a in left for d, b in right) for right in through]
            for left in through
        ])  # fmt: skip
        freedom = np.array([sum(np.trace(c) ** 2 / np.sum(c**2) for _, c in part) for part in self.parts])
        return Likelihood(logarithm, squares - traces, information, np.minimum(traces / freedom, 1.0))


class Known(NamedTuple):
    """n components of nodes before and after an adjustment."""

    prior: Array
    """P_0 (n, n)."""
    others: Array
    """(n, n) covariance beforehand but for the processes that are sought: of the trend and of other processes."""
    posterior: Array
    """S (n, n)."""
    values: Array
    """x (n,)."""

    def of(self, rows: Index) -> "Known":
        """Of some of them."""
        block = np.ix_(rows, rows)
        return Known(self.prior[block], self.others[block], self.posterior[block], self.values[rows])


class Likelihood(NamedTuple):
    """Of log strengths."""

    logarithm: float
    """Of the likelihood, over that of the strengths that the adjustment had."""
    score: Array
    """(p,) its derivatives."""
    information: Array
    """(p, p) that is expected."""
    shares: Array
    """(p,) of the a-priori variance, that measures take away: tr(W C) over the directions that C has, about
    (tr C)^2 / tr(C^2)."""


def _covariance(one: Pass, member: Member) -> Array:
    assert isinstance(one.prior, ProcessPrior)
    part = one.prior.position if member.component < 3 else one.prior.attitude
    return dense_covariance((part[member.number],), member.component % 3, one.nodes)


def _known(solution: Solution, rows: dict[tuple[int, int], slice], wanted: Sequence[Sequence[Member]]) -> Known:
    """Of components of passes, (number, component) by the rows they have."""
    network, sought = solution.network, {one for members in wanted for one in members}
    variables, columns, at = list[int](), list[Index](), 0
    count = max(block.stop for block in rows.values())
    prior, others, values = np.zeros((count, count)), np.zeros((count, count)), np.zeros(count)
    for k in sorted({k for k, _ in rows}):
        one, marginal = network.passes[k], _marginal(network.passes[k])
        first, nodes = int(network.first_of_passes[k]), len(one.nodes)
        variables += range(first, first + nodes)
        for c in [c for of, c in rows if of == k]:
            mine = rows[k, c]
            columns.append(at + 6 * np.arange(nodes) + c)
            prior[mine, mine], values[mine] = marginal[c::6, c::6], solution.nodes[k][:, c]
            others[mine, mine] = _others(one, k, c, sought)
        at += 6 * nodes
    order = np.concatenate(columns)
    joint = at_solution(solution).of_estimator().joint.of(variables)
    return Known(prior, others, joint[np.ix_(order, order)], values)


def _others(one: Pass, number: int, component: int, sought: set[Member]) -> Array:
    """(k, k) covariance of a component's trend, and of its processes that are not sought."""
    assert isinstance(one.prior, ProcessPrior)
    part, s = one.prior.position if component < 3 else one.prior.attitude, normalised(one.nodes)
    found = one.prior.bias[component] ** 2 + one.prior.drift[component] ** 2 * np.outer(s, s)
    for n, process in enumerate(part):
        if Member(number, n, component) not in sought:
            found = found + dense_covariance((process,), component % 3, one.nodes)
    return np.asarray(found)


def _marginal(one: Pass) -> Array:
    """(6 k, 6 k) P_0: information of the prior's rows on the nodes, the trend eliminated."""
    from scipy.linalg import cho_factor, cho_solve  # slow to import

    edges = np.concatenate([[0], np.cumsum(one.widths)])
    whole = np.zeros((edges[-1], edges[-1]))
    for unknowns, blocks, _ in one.prior.factors(one.nodes):
        for v, left in zip(unknowns, blocks, strict=True):
            for w, right in zip(unknowns, blocks, strict=True):
                whole[edges[v] : edges[v + 1], edges[w] : edges[w + 1]] += left.T @ right
    size = 6 * len(one.nodes)
    across = whole[:size, size:]
    if not across.shape[1]:
        return whole
    return np.asarray(whole[:size, :size] - across @ cho_solve(cho_factor(whole[size:, size:]), across.T))


