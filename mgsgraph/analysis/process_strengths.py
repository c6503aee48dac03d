"""Strengths of the processes of passes, estimated from the measures by restricted maximum likelihood.

found = estimated_strengths(network, settings)   # adjusts, estimates, adjusts again, until nothing changes
print(found)

Processes of the same part (position, attitude) and kind have one strength, common to all passes: a pair of
images shows the difference of two passes alone, and whose a vibration is can't be told. All passes are one likelihood,
whose maximum is sought in log s.

A strength that measures hardly see is not searched for, for it would run away: where the search begins, the expected
standard deviation of its logarithm has to be less than 1. Its departures are held at nothing, which is said.

Rays that scatter more than stated would be taken for a process: their sigmas count as right.

The restricted likelihood of strengths follows from an adjustment with other strengths. With everything else eliminated
the measures say y = x + e of the nodes x of all passes, x being normal with the covariance K = sum_i s_i^2 C_i + trend:
linear in the variances s_i^2, C_i being the covariance functions' own matrices.
Their likelihood is that of y, with covariance V = K + cov(e). Nothing of y and e has to be formed: an adjustment with
K_0 gives W_0 = V_0^-1 = P_0 - P_0 S P_0 and u_0 = V_0^-1 y = P_0 x, S being the posterior covariance, x the estimate
and P_0 = K_0^-1; then with D = K - K_0

    W = W_0 (1 + D W_0)^-1,   u = (1 + W_0 D)^-1 u_0,
    d(log likelihood) / d(s_i^2) = (u' C_i u - tr(W C_i)) / 2,   information F_ik = tr(W C_i W C_k) / 2

(Patterson & Thompson 1971; Rasmussen & Williams 2006, eq. 5.9). Components know nothing of each other beforehand, and D
is zero but for those whose strengths are sought: all else falls out of these equations exactly, and isn't formed.
Passes are taken together: where one is seen against another alone, S has it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.optimize import Iteration
from mgsgraph.adjustment.rounds import unmarked
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.separability import LIMIT
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Network, Pass, Process, ProcessPrior
from mgsgraph.network.conditioning import dense_covariance
from mgsgraph.record import Record
from mgsgraph.workers import no_progress

Block = tuple[slice, Array]
"""Rows of a pass's component among all that are sought, and a covariance (k, k) of its nodes, m^2 or rad^2."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What an adjustment says of strengths: n components of nodes, p strengths."""

    start: Array
    """W_0 (n, n)."""
    push: Array
    """u_0 (n,)."""
    parts: tuple[tuple[Block, ...], ...]
    """Of each strength the covariances that it scales, as they are in the adjustment."""

    @classmethod
    def of(cls, solution: Solution, wanted: "Sequence[Strength]") -> "Evidence":
        """Of strengths (p), one at least."""
        network = solution.network
        pairs = sorted({(k, c) for one in wanted for k, _ in one.members for c in one.components})
        ends = np.cumsum([0, *(len(network.passes[k].nodes) for k, _ in pairs)]).tolist()
        rows = {pair: slice(ends[i], ends[i + 1]) for i, pair in enumerate(pairs)}
        known = _known(solution, rows)
        found, push = known.prior - known.prior @ known.posterior @ known.prior, known.prior @ known.values

        def scaled(k: int, number: int, c: int, part: str) -> Block:
            process, nodes = _processes(network, k, part)[number], network.passes[k].nodes
            return rows[k, c], dense_covariance((process,), c % 3, nodes)

        parts = (tuple(scaled(*of, c, one.part) for of in one.members for c in one.components) for one in wanted)
        return cls(0.5 * (found + found.T), push, tuple(parts))

    def maximum(self, most: float) -> Array:
        """(p,) change of the log strengths to the largest likelihood; `most` upward at most."""
        from scipy.optimize import minimize  # slow to import

        def downward(steps: Array) -> tuple[float, Array]:
            found = self.likelihood(steps)
            return -found.logarithm, -found.score

        begin = np.zeros(len(self.parts))
        found = minimize(
            downward, begin, jac=True, bounds=[(-3.0 * most, most)] * begin.size, options={"ftol": 1e-12, "gtol": 1e-6}
        )
        return np.asarray(found.x)

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
    posterior: Array
    """S (n, n)."""
    values: Array
    """x (n,)."""


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


def _known(solution: Solution, rows: dict[tuple[int, int], slice]) -> Known:
    """Of components of passes, (number, component) by the rows they have."""
    network = solution.network
    variables, columns, at = list[int](), list[Index](), 0
    count = max(block.stop for block in rows.values())
    prior, values = np.zeros((count, count)), np.zeros(count)
    for k in sorted({k for k, _ in rows}):
        one, marginal = network.passes[k], _marginal(network.passes[k])
        first, nodes = int(network.first_of_passes[k]), len(one.nodes)
        variables += range(first, first + nodes)
        for c in [c for of, c in rows if of == k]:
            mine = rows[k, c]
            columns.append(at + 6 * np.arange(nodes) + c)
            prior[mine, mine], values[mine] = marginal[c::6, c::6], solution.nodes[k][:, c]
        at += 6 * nodes
    order = np.concatenate(columns)
    joint = at_solution(solution).of_estimator().joint.of(variables)
    return Known(prior, joint[np.ix_(order, order)], values)


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


_MOST = 600
"""Nodes of a pass: dense matrices of its components."""
_STEP = math.log(5.0)
"""Largest change of a log strength in one round."""
_FLOOR = 1e-3
"""Of where the search began: a strength there can't be told from zero."""
_SEEN = 1.0
"""Information on a log strength, where the search begins, for it to be searched for."""


@dataclass(frozen=True, slots=True)
class Strength(Record):
    """Of one process, common to passes, as found."""

    passes: tuple[str, ...]
    """Their names."""
    part: str
    """position or attitude."""
    kind: str
    """Of process."""
    members: tuple[tuple[int, int], ...]
    """Passes and the number of the process within the part of each."""
    sigma: float = 0.0
    """m or rad (per s^1.5 of an integrated Wiener process): of its first axis."""
    error: float = 0.0
    """Standard deviation of `sigma`, of the likelihood's information; 0 where it was not searched for."""
    zero: bool = False
    """Whether it went to zero: held at a thousandth of where the search began."""
    seen: float = 0.0
    """Share of the departures' a-priori variance that measures take away; 0: not observable."""
    searched: bool = True
    """Whether it was searched for; else hardly seen."""

    @property
    def components(self) -> tuple[int, int, int]:
        """X, Y, Z or x, y, z, of 0 .. 5."""
        return (0, 1, 2) if self.part == "position" else (3, 4, 5)

    @property
    def name(self) -> str:
        """Part of the pose, kind of process and passes, for reports."""
        of = f"pass {self.passes[0]}" if len(self.passes) == 1 else f"common to {len(self.passes)} passes"
        return f"{self.part}, {self.kind}, {of}"

    @property
    def sentence(self) -> str:
        """The strength with its standard deviation, or why there is none, as one line of a report."""
        unit = "m" if self.part == "position" else "rad"
        unit += "/s^1.5" if self.kind == "integrated-wiener" else ""
        if not self.searched:
            hardly = f"hardly seen ({self.seen:.1g} of its variance)"
            return f"{self.name}: {hardly}, held at nothing ({self.sigma:.2g} {unit})"
        if self.zero:
            return f"{self.name}: not to be seen (strength below {self.sigma:.2g} {unit})"
        return f"{self.name}: {self.sigma:.4g} +- {self.error:.2g} {unit}"


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedStrengths(Record):
    """Strengths, and the adjustment with them."""

    network: Network
    """With what was found."""
    solution: Solution
    """Of it."""
    strengths: tuple[Strength, ...]
    """p of them."""
    covariance: Array
    """(p, p) of their natural logarithms."""
    converged: bool
    """Whether the last round changed nothing by more than the tolerance."""
    rounds: int
    """Adjustments."""

    @property
    def correlation(self) -> Array:
        """(p, p) of the strengths."""
        scale = np.sqrt(np.maximum(np.diagonal(self.covariance), 1e-300))
        return np.asarray(self.covariance / scale[:, None] / scale)

    @property
    def sentences(self) -> list[str]:
        """One for each strength, for pairs that can't be told apart, and for how it ended."""
        lines = [one.sentence for one in self.strengths]
        entangled = np.argwhere(np.triu(np.abs(self.correlation) > LIMIT, 1)).tolist()
        for i, k in entangled:
            names = f"{self.strengths[i].name} and {self.strengths[k].name}"
            lines.append(f"{names}: not separable (correlation {self.correlation[i, k]:.3f} of their strengths)")
        end = "at rest" if self.converged else "NOT at rest"
        return [*lines, f"Strengths {end} after {self.rounds} adjustments."]


def estimated_strengths(
    network: Network,
    settings: SolverSettings,
    most: int = 15,
    tolerance: float = 0.01,
    name: str = "adjustment",
    progress: Callable[[Iteration], None] = no_progress,
) -> EstimatedStrengths:
    """Find the strengths of all processes that are marked as `estimated`.

    Parameters
    ----------
    network : Network
        Of passes with `ProcessPrior`; the search begins with the sigmas of the first pass that has a process.
    settings : SolverSettings
    most : int
        Adjustments.
    tolerance : float
        Relative change below which they are at rest; ten times that share of a strength's own standard deviation where
        this is more.
    name : str
        What to call the adjustment in reports.
    progress : callable
        Called with every iteration of every adjustment.

    Raises
    ------
    InputError
        Where nothing is to be estimated, or a pass has too many nodes; and what `adjust_network` raises.
    """
    sought, begin = _sought(network), network
    network = _with_changes(network, sought, np.zeros(len(sought)))
    left_in = unmarked(network) if settings.reject == 0.0 else None
    searched, shares = np.zeros(0, dtype=np.int64), np.zeros(0)
    for done in range(most):
        solution = adjust_network(network, settings, name, progress, left_in=left_in)
        if done == 0:
            start = Evidence.of(solution, sought).likelihood(np.zeros(len(sought)))
            searched, shares = np.flatnonzero(np.diagonal(start.information) > _SEEN), start.shares
        steps, covariance = np.zeros(0), np.zeros((0, 0))
        if searched.size:
            evidence = Evidence.of(solution, [sought[i] for i in searched.tolist()])
            steps, covariance = evidence.maximum(_STEP), _covariance(evidence)
        change, zero = _changes(searched, steps, _sigmas(network, sought), _FLOOR * _sigmas(begin, sought))
        # a strength that is known to a tenth only need not be at rest to a hundredth
        sizes = tolerance * np.maximum(1.0, 10.0 * np.minimum(np.sqrt(np.diagonal(covariance)), 1.0))
        converged = bool(np.all(np.abs(change[searched]) <= sizes)) and (done > 0 or searched.size == len(sought))
        if converged or done == most - 1:
            break
        network = _with_changes(network, sought, change)
    now, logs = _sigmas(network, sought), np.zeros((len(sought), len(sought)))
    logs[np.ix_(searched, searched)] = covariance
    errors = now * np.sqrt(np.diagonal(logs))
    strengths = tuple(
        replace(one, sigma=float(now[i]), error=float(errors[i]), zero=bool(zero[i]), seen=float(shares[i]),
                searched=i in searched)
        for i, one in enumerate(sought)
    )  # fmt: skip
    return EstimatedStrengths(network, solution, strengths, logs, converged, done + 1)


def _sought(network: Network) -> list[Strength]:
    """What is to be found: processes alike in part and kind are one, of all passes."""
    found = dict[tuple[str, str, int], list[tuple[int, int]]]()
    for k, one in enumerate(network.passes):
        for part in ("position", "attitude") if isinstance(one.prior, ProcessPrior) else ():
            alike = list[str]()
            for number, process in enumerate(_processes(network, k, part)):
                if process.estimated:
                    found.setdefault((part, process.kind, alike.count(process.kind)), []).append((k, number))
                alike.append(process.kind)
        if len(one.nodes) > _MOST and any(k == of for members in found.values() for of, _ in members):
            remedy = "state the strengths that a shorter part of the pass gives"
            raise InputError(f"pass {one.name!r}, strengths", f"{len(one.nodes)} nodes", f"{_MOST} at most", remedy)
    if not found:
        raise InputError("strengths of processes", "none that is to be estimated", 'some with sigma = "estimated"')
    return [
        Strength(
            tuple(dict.fromkeys(network.passes[k].name for k, _ in members)), part, kind, tuple(members)
        )
        for (part, kind, _), members in found.items()
    ]


def _processes(network: Network, number: int, part: str) -> tuple[Process, ...]:
    """Of a part of a pass."""
    prior = network.passes[number].prior
    assert isinstance(prior, ProcessPrior)
    return prior.position if part == "position" else prior.attitude


def _first(network: Network, one: Strength) -> Array:
    """(3,) sigmas of the first pass that has a strength."""
    of_pass, number = one.members[0]
    return _processes(network, of_pass, one.part)[number].sigmas


def _sigmas(network: Network, sought: Sequence[Strength]) -> Array:
    """(p,) of the first axis of each."""
    return np.array([_first(network, one)[0] for one in sought])


def _covariance(evidence: Evidence) -> Array:
    """(s, s) of the log strengths that are searched for, by the information that is expected."""
    information = evidence.likelihood(np.zeros(len(evidence.parts))).information
    return np.asarray(np.linalg.inv(information + np.diag(1e-6 + 1e-9 * np.diagonal(information))))


def _changes(searched: Index, steps: Array, now: Array, floor: Array) -> tuple[Array, Index]:
    """(p,) change of log strengths, and whether each is at its floor."""
    change = np.log(floor / now)  # of what nothing is seen
    change[searched] = np.maximum(np.clip(steps, -_STEP, _STEP), change[searched])
    zero = np.zeros(now.size, dtype=bool)
    zero[searched] = now[searched] * np.exp(steps) <= floor[searched]
    change[zero] = np.log(floor / now)[zero]
    return change, zero


def _with_changes(network: Network, sought: Sequence[Strength], change: Array) -> Network:
    """With log strengths (p,) changed; those of all passes then are that of the first."""
    passes = list(network.passes)
    for one, growth in zip(sought, np.exp(change).tolist(), strict=True):
        sigmas = growth * _first(network, one)
        for of_pass, number in one.members:
            prior = passes[of_pass].prior
            assert isinstance(prior, ProcessPrior)
            part = list(prior.position if one.part == "position" else prior.attitude)
            part[number] = replace(part[number], sigmas=sigmas)
            if one.part == "position":
                prior = replace(prior, position=tuple(part))
            else:
                prior = replace(prior, attitude=tuple(part))
            passes[of_pass] = replace(passes[of_pass], prior=prior)
    return replace(network, passes=tuple(passes))
