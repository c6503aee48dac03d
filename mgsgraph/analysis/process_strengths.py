"""Strengths of the processes of passes, estimated from the measures by restricted maximum likelihood, and their
uncertainty carried into the posterior.

found = estimated_strengths(network, settings)   # adjusts, estimates, adjusts again, until nothing changes
print(found)

Processes of the same part (position, attitude) and kind have a strength s along each axis, common to all passes: a pair
of images shows only the difference of two passes, not which of them moves. Axes are observed very differently; so each
has its own strength, and a hardly observed one follows the others: a priori log s is normal about the sigma that the
search begins with, with a deviation common to the axes (`Process.spread`) and one of each (`strengths`).

Where passes differ, each has strengths of its own, which depart from those in common; one that is hardly seen follows
these. Passes differ where all departures together raise the restricted likelihood by more than noise does: not a
process alone, since ties show position and attitude jointly, and what one is held to the other would make up for.

Rays that scatter more than stated would be taken for a process: their sigmas are assumed correct.

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

The posterior is the mixture over strengths (Rue, Martino & Chopin 2009), by importance sampling about the largest
density. No strengths need an adjustment of their own: with other ones all unknowns have

    S(s) = S + A D (1 + W_0 D)^-1 A',   x(s) = x + A D u,   A = S P_0,

and what is stated is the mean square about x, as of several minima (`adjustment.multistart`): S + A Q A'.

Passes may move in the same way. Their difference then shows nothing, and strengths that follow from it would vanish. So
there are two hypotheses: that passes are independent, and (probability `_JOINT` a priori) that what the measures see
of a process has a strength of its own, exp(`_LESS`) of that of what they don't see.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.marginals import dense_covariance as mixture_covariance
from mgsgraph.adjustment.rounds import unmarked
from mgsgraph.adjustment.settings import Progress, SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.separability import LIMIT
from mgsgraph.analysis.statistics import whitened_rows
from mgsgraph.analysis.strengths import (
    Strength,
    of_each_pass,
    processes_of,
    sought_strengths,
    spread_beforehand,
    strength_sigmas,
    with_strength_sigmas,
)
from mgsgraph.geometry.records import Array, Index, sigmas_of
from mgsgraph.network import Network, Pass
from mgsgraph.network.conditioning import NUGGET, dense_covariance
from mgsgraph.record import Record
from mgsgraph.workers import no_progress

Block = tuple[Index, Array]
"""Rows (k,) of components of passes among all that are sought, and a covariance (k, k) of them, m^2 or rad^2."""

_RANGE = 0.95
"""Probability that passes that don't differ get no strengths of their own."""
_JOINT = 0.2
"""A-priori probability that passes move in the same way."""
_NARROW = 0.4
"""Times the spread of what axes have in common, of what measures don't see then: it would run away."""
_LESS, _LESS_BY = -3.0, 1.0
"""Mean and deviation, common to axes, of the log strength of what they see then, less that of what they don't."""
_STARTS, _STEP = np.linspace(-6.0, 6.0, 9), 3.0
"""Changes of all log strengths of a process of which the best is where their maximum is sought, and how far from it."""
_WIDER, _FEW, _DRAWS = 1.2, 6, 7
"""Times the normal approximation's deviation that draws have, of a few strengths; logarithm (2) of their number."""
_LIMIT = 0.95
"""Probability of being below the upper end of an interval, and above its lower one."""
_NOTHING = 1e-5
"""Weight up to which a draw is left out of sums."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What an adjustment, and the prior, say of strengths: n components of nodes, p strengths."""

    start: Array
    """W_0 (n, n)."""
    push: Array
    """u_0 (n,)."""
    before: Array
    """P_0 (q, n), of all unknowns of these passes."""
    variables: tuple[int, ...]
    """Which these are."""
    parts: tuple[tuple[Block, ...], ...]
    """Of each strength the covariances that it scales, as they are in the adjustment."""
    mean: Array
    """(p,) mean beforehand of log strengths, less those of the adjustment."""
    spread: Array
    """(p, p) their covariance beforehand."""

    @classmethod
    def of(cls, solution: Solution, wanted: Sequence[Strength]) -> "Evidence":
        """Of strengths (p)."""
        from scipy.linalg import block_diag  # slow to import

        network, variables, blocks, diagonal_blocks = solution.network, list[int](), list[Array](), list[Array]()
        rows, at = dict[tuple[int, int], Index](), 0
        for k in sorted({k for strength in wanted for k, _ in strength.members}):
            first, count = int(network.first_of_passes[k]), len(network.passes[k].nodes)
            components = sorted({strength.component for strength in wanted if k in dict(strength.members)})
            taken = np.concatenate([np.arange(c, 6 * count, 6) for c in components])
            rows |= {(k, c): at + i * count + np.arange(count) for i, c in enumerate(components)}
            variables += range(first, first + network.passes[k].widths.size)
            blocks.append(_information(network.passes[k])[:, taken])
            diagonal_blocks.append(blocks[-1][taken])
            at += taken.size
        before, joint = block_diag(*blocks), at_solution(solution).of_estimator().joint
        prior = block_diag(*diagonal_blocks)
        start = prior - before.T @ joint.of(variables) @ before
        push = before.T @ np.concatenate([solution.values[v] for v in variables])

        def scaled(strength: Strength, k: int, number: int) -> Block:
            processes, place = processes_of(network, k, strength.part), rows[k, strength.component]
            nodes = network.passes[k].nodes
            covariance = dense_covariance(processes, strength.axis, nodes)
            covariance += NUGGET**2 * np.diag(np.diagonal(covariance))
            # the rows between neighbors have a covariance of their own, a little off the processes': that one scales
            root = np.linalg.cholesky(np.linalg.inv(prior[np.ix_(place, place)]))
            turned = root @ np.linalg.inv(np.linalg.cholesky(covariance))
            return place, turned @ dense_covariance(processes[number : number + 1], strength.axis, nodes) @ turned.T

        parts = tuple(tuple(scaled(strength, *of) for of in strength.members) for strength in wanted)
        mean = np.log(np.array([strength.begin for strength in wanted]) / strength_sigmas(network, wanted))
        return cls(0.5 * (start + start.T), push, before, tuple(variables), parts, mean, spread_beforehand(wanted))

    def by_pass(self, wanted: Sequence[Strength]) -> tuple["Evidence", list[Strength], Index]:
        """With strengths of each pass; these; and which each was before."""
        each, of = of_each_pass(wanted)
        parts = tuple((block,) for part in self.parts for block in part)
        return replace(self, parts=parts, mean=self.mean[of], spread=spread_beforehand(each)), each, of

    def joint(self, wanted: Sequence[Strength]) -> "Evidence":
        """With strengths (2 p) of what is seen of each process, and of what is not, with those of the mean beforehand:
        directions of which measures take more than half of the variance away, and the others.
        """
        from scipy.linalg import block_diag  # slow to import

        information = np.linalg.solve(self._mixed(self.change(self.mean)), self.start)
        observed, rest = list[tuple[Block, ...]](), list[tuple[Block, ...]]()
        for part, mean in zip(self.parts, self.mean.tolist(), strict=True):
            place, of_process = np.concatenate([rows for rows, _ in part]), block_diag(*(matrix for _, matrix in part))
            variances, axes = np.linalg.eigh(of_process)
            root = axes * np.sqrt(np.maximum(variances, 0.0))
            shares, turn = np.linalg.eigh(math.exp(2.0 * mean) * root.T @ information[np.ix_(place, place)] @ root)
            for parts, some in ((observed, root @ turn[:, shares > 0.5]), (rest, root @ turn[:, shares <= 0.5])):
                parts.append(((place, some @ some.T),))
        less, unseen = (
            spread_beforehand([replace(sought, spread=spread) for sought, spread in zip(wanted, spreads, strict=True)])
            for spreads in ([_LESS_BY] * len(wanted), [_NARROW * sought.spread for sought in wanted])
        )
        mean = np.append(self.mean + _LESS, self.mean)
        return replace(self, parts=(*observed, *rest), mean=mean, spread=block_diag(less, unseen))

    def change(self, steps: Array) -> Array:
        """D (n, n), where log strengths change by `steps` (p,)."""
        change = np.zeros_like(self.start)
        for growth, part in zip(np.expm1(2.0 * steps), self.parts, strict=True):
            for place, matrix in part:
                change[np.ix_(place, place)] += growth * matrix
        return change

    def _mixed(self, change: Array) -> Array:
        """1 + W_0 D (n, n)."""
        return np.asarray(np.eye(self.push.size) + self.start @ change)

    def density(self, steps: Array) -> "Density":
        """Where log strengths change by `steps` (p,)."""
        from scipy.linalg import lu_factor, lu_solve  # slow to import

        factored = lu_factor(self._mixed(self.change(steps)))
        within, pushed = lu_solve(factored, self.start), lu_solve(factored, self.push)
        grown = [
            [(place, growth * matrix) for place, matrix in part]
            for growth, part in zip(np.exp(2.0 * steps), self.parts, strict=True)
        ]
        through = [[(place, within[:, place] @ matrix) for place, matrix in part] for part in grown]
        traces = np.array([sum(np.trace(product[place]) for place, product in part) for part in through])
        squares = np.array([sum(pushed[place] @ matrix @ pushed[place] for place, matrix in part) for part in grown])
        information = np.array([
            [2.0 * sum(np.sum(a[d] * b[c].T) for c, a in first for d, b in second) for second in through]
            for first in through
        ])  # fmt: skip
        score = squares - traces - np.linalg.solve(self.spread, steps - self.mean)
        return Density(score, information + np.linalg.inv(self.spread))

    def logarithm(self, steps: Array) -> float:
        """Of the density there, with a constant that all hypotheses have."""
        change, off = self.change(steps), steps - self.mean
        mixed = self._mixed(change)
        pushed = self.push @ change @ np.linalg.solve(mixed, self.push)
        prior = off @ np.linalg.solve(self.spread, off) + np.linalg.slogdet(self.spread)[1]
        return 0.5 * float(pushed - np.linalg.slogdet(mixed)[1] - prior)

    def maximum(self) -> Array:
        """(p,) change of the log strengths to the largest density; there may be another one where they begin."""
        from scipy.optimize import minimize  # slow to import

        begin = np.zeros(self.mean.size)
        for of_process in np.unique(self.spread > 0.0, axis=0):
            starts = begin + _STARTS[:, None] * of_process
            begin = starts[np.argmax([self.logarithm(start) for start in starts])]
        result = minimize(
            lambda at: -self.logarithm(at), begin, jac=lambda at: -self.density(at).score,
            bounds=np.stack([begin - _STEP, begin + _STEP], axis=1), options={"ftol": 1e-12, "gtol": 1e-6},
        )  # fmt: skip
        return np.asarray(result.x)

    def drawn(self) -> tuple[Array, Array]:
        """(m, p) changes of log strengths that stand for their density, and (m,) logarithms of weights, whose mean is
        the probability of the data.
        """
        from scipy.stats import norm, qmc  # slow to import

        mode = self.maximum()
        wider = _WIDER ** min(1.0, _FEW / mode.size)
        root = wider * np.linalg.cholesky(np.linalg.inv(self.density(mode).information))
        normal = norm.ppf(qmc.Sobol(mode.size, seed=1).random_base2(_DRAWS))
        steps = mode + normal @ root.T
        logs = np.array([self.logarithm(step) for step in steps]) + 0.5 * np.sum(normal**2, axis=1)
        return steps, logs + np.sum(np.log(np.diagonal(root)))

    def moved(self, steps: Array) -> Array:
        """What other strengths add to the covariance of the nodes and to squares of their values: A (...) A'."""
        change = self.change(steps)
        mixed = self._mixed(change)
        off = change @ np.linalg.solve(mixed, self.push)
        return np.asarray(np.linalg.solve(mixed.T, change).T + np.outer(off, off))

    def sizes(self, steps: Array, count: int) -> Array:
        """(count,) changes of the logarithms of root mean squares of whole processes."""
        variances = np.array([sum(np.trace(matrix) for _, matrix in part) for part in self.parts])
        grown = (variances * np.exp(2.0 * steps)).reshape(-1, count).sum(axis=0)
        return np.asarray(0.5 * np.log(grown / variances.reshape(-1, count).sum(axis=0)))


class Density(NamedTuple):
    """Of log strengths."""

    score: Array
    """(p,) derivatives of its logarithm."""
    information: Array
    """(p, p) that is expected."""


def _information(pass_: Pass) -> Array:
    """(q, q) P_0: information of the prior's rows on the nodes and the trend of a pass."""
    rows = whitened_rows(pass_, np.ones(sum(pass_.widths)))
    return np.asarray((rows.T @ rows).toarray())


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedStrengths(Record):
    """Strengths, and the adjustment with them."""

    network: Network
    """With the strengths of largest density."""
    solution: Solution
    """Of it, with the covariance of the mixture over strengths."""
    strengths: tuple[Strength, ...]
    """p of them."""
    covariance: Array
    """(p, p) of their natural logarithms."""
    same_motion: float
    """Probability that passes move in the same way, so that their difference doesn't show the strengths."""
    converged: bool
    """Whether the last round changed nothing by more than the tolerance."""
    rounds: int
    """Adjustments."""

    @property
    def correlation(self) -> Array:
        """(p, p) of the strengths."""
        scale = sigmas_of(self.covariance)
        return np.asarray(self.covariance / scale[:, None] / scale)

    @property
    def sentences(self) -> list[str]:
        """One for each strength, for pairs that are inseparable, and for how it ended."""
        lines = [strength.sentence for strength in self.strengths]
        entangled = np.argwhere(np.triu(np.abs(self.correlation) > LIMIT, 1)).tolist()
        for i, k in entangled:
            names = f"{self.strengths[i].name} and {self.strengths[k].name}"
            lines.append(f"{names}: not separable (correlation {self.correlation[i, k]:.3f} of their strengths)")
        if self.same_motion > 0.5:
            lines.append(f"Passes move jointly (probability {self.same_motion:.2f}): their difference hides strengths.")
        end = "converged" if self.converged else "did NOT converge"
        return [*lines, f"Strengths {end} after {self.rounds} adjustments."]


def estimated_strengths(
    network: Network,
    settings: SolverSettings,
    most: int = 15,
    tolerance: float = 0.01,
    name: str = "adjustment",
    progress: Progress = no_progress,
    in_common: bool = False,
) -> EstimatedStrengths:
    """Find the strengths of all processes that are marked as `estimated`, and carry what is not known of them into the
    covariance of all unknowns and points.

    Parameters
    ----------
    network : Network
        Of passes with `ProcessPrior`; the search begins with the sigmas of the first pass that has a process, about
        which strengths are beforehand.
    settings : SolverSettings
    most : int
        Adjustments.
    tolerance : float
        Relative change below which they have converged; ten times that share of a strength's own standard deviation
        where this is more.
    name : str
        What to call the adjustment in reports.
    progress : callable
        Called with every iteration of every adjustment.
    in_common : bool
        Whether passes have the same strengths even where the likelihood asks for others.

    Raises
    ------
    InputError
        Where nothing is to be estimated, or a pass has too many nodes; and what `adjust_network` raises.
    """
    sought = sought_strengths(network)
    several = any(len(strength.passes) > 1 for strength in sought)
    network = with_strength_sigmas(network, sought, strength_sigmas(network, sought))
    left_in = unmarked(network) if settings.reject == 0.0 else None
    for done in range(1, most + 1):
        solution = adjust_network(network, settings, name, progress, left_in=left_in)
        evidence = Evidence.of(solution, sought)
        steps = evidence.maximum()
        # a strength that is known to a tenth only need not converge to a hundredth
        errors = sigmas_of(np.linalg.inv(evidence.density(steps).information))
        converged = bool(np.all(np.abs(steps) <= tolerance * np.maximum(1.0, 10.0 * np.minimum(errors, 1.0))))
        if converged and several and not in_common:
            in_common, (evidence, sought, steps) = True, where_passes_differ(evidence, sought, steps)
            converged = steps.size == errors.size
        if converged or done == most:
            break
        network = with_strength_sigmas(network, sought, strength_sigmas(network, sought) * np.exp(steps))
    hypotheses = [(1.0 - _JOINT, evidence), (_JOINT, evidence.joint(sought))] if several else [(1.0, evidence)]
    drawn, weights, spread = _mixture(hypotheses)
    off = drawn - weights @ drawn
    covariance = off.T @ (weights[:, None] * off)
    points = strength_sigmas(network, sought) * np.exp([_quantiles(some, weights) for some in drawn.T]).T
    strengths = tuple(
        replace(strength, sigma=middle, error=error, interval=(low, high))
        for strength, low, middle, high, error in zip(
            sought, *points.tolist(), sigmas_of(covariance).tolist(), strict=True
        )
    )
    same_motion = float(weights[2**_DRAWS :].sum())
    solution = _with_spread(solution, evidence, spread)
    return EstimatedStrengths(network, solution, strengths, covariance, same_motion, converged, done)


def where_passes_differ(
    evidence: Evidence, sought: list[Strength], steps: Array
) -> tuple[Evidence, list[Strength], Array]:
    """With strengths of each pass where the restricted likelihood asks for them: where twice its logarithm rises by
    more than noise lets it, which is a chi-square variable at most; `steps` (p,) lead to the largest density.
    """
    from scipy.special import chdtri  # slow to import

    wide, each, of = evidence.by_pass(sought)
    best = wide.maximum()
    gain = 2.0 * (wide.logarithm(best) - wide.logarithm(steps[of]))
    if gain <= float(chdtri(len(each) - len(sought), 1.0 - _RANGE)):
        return evidence, sought, steps
    return wide, each, best


def _mixture(hypotheses: Sequence[tuple[float, Evidence]]) -> tuple[Array, Array, Array]:
    """Changes of log strengths (m, p) that stand for the posterior, their weights (m,), and Q."""
    each, logs = list[tuple[Evidence, Array]](), list[Array]()
    for probability, model in hypotheses:
        steps, some = model.drawn()
        each += [(model, step) for step in steps]
        logs.append(some + math.log(probability))
    weights = np.exp(np.concatenate(logs) - max(some.max() for some in logs))
    weights /= weights.sum()
    count = hypotheses[0][1].mean.size
    parts = (w * model.moved(step) for w, (model, step) in zip(weights.tolist(), each, strict=True) if w > _NOTHING)
    return np.array([model.sizes(step, count) for model, step in each]), weights, np.asarray(sum(parts))


def _quantiles(values: Array, weights: Array) -> Array:
    """(3,) 5, 50 and 95 % points of weighted values (m,)."""
    order = np.argsort(values)
    passed = np.cumsum(weights[order]) - 0.5 * weights[order]
    return np.interp((1.0 - _LIMIT, 0.5, _LIMIT), passed, values[order])


def _with_spread(solution: Solution, evidence: Evidence, spread: Array) -> Solution:
    """With A Q A' added to the covariance of the shared unknowns, from which that of the points follows."""
    at, joint = at_solution(solution), solution.joint_covariance
    root, width = joint.square_root, solution.network.widths
    columns = np.concatenate([root.first[v] + np.arange(width[v]) for v in evidence.variables])
    gain = at.of_estimator().joint.dense()[:, columns] @ evidence.before
    covariance = joint.dense() + gain @ spread @ gain.T
    mixed = mixture_covariance(root.first, root.width, 0.5 * (covariance + covariance.T))
    points = replace(at, joint=mixed).point_covariances()
    return replace(
        solution, joint_covariance=mixed, covariances=points, sigmas_without_laser=None,
        median_sigmas_without_laser=None,
    )  # fmt: skip
