"""Strengths of the processes of passes, estimated from the measures by restricted maximum likelihood.

found = estimated_strengths(network, settings)   # adjusts, estimates, adjusts again, until nothing changes
print(found.words())

With everything else eliminated the measures say y = x + e of the nodes x of a pass, x being normal with the covariance
K = sum_i s_i^2 C_i + trend: linear in the variances s_i^2, C_i being the covariance functions' own matrices. Their
likelihood is that of y, with covariance V = K + cov(e). Nothing of y and e has to be formed: an adjustment with K_0
gives W_0 = V_0^-1 = P_0 - P_0 S P_0 and u_0 = V_0^-1 y = P_0 x, S being the posterior covariance, x the estimate and
P_0 = K_0^-1; then with D = K - K_0

    W = W_0 (1 + D W_0)^-1,   u = (1 + W_0 D)^-1 u_0,
    d(log likelihood) / d(s_i^2) = (u' C_i u - tr(W C_i)) / 2,   information F_ik = tr(W C_i W C_k) / 2

(Patterson & Thompson 1971; Rasmussen & Williams 2006, eq. 5.9). Steps of Fisher's scoring are taken in log s. Rays that
scatter more or less than stated would be taken for a process: with `rays` their sigmas are multiplied by the factor of
Foerstner's estimate, v'v / r over all tie rays, in the same rounds; that is its restricted maximum likelihood as well.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.batch import Iteration
from mgsgraph.adjustment.datum.frames import FLIGHT
from mgsgraph.adjustment.rounds import unmarked
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.flight import strip_turns
from mgsgraph.analysis.grouping import group_rows
from mgsgraph.analysis.helmert import group_redundancy
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index, assign, frozen
from mgsgraph.network import Network, Pass, ProcessPrior
from mgsgraph.network.conditioning import dense_covariance

INSEPARABLE = 0.95
"""Correlation beyond which two things are not separable."""
_MOST = 600
"""Nodes of a pass: dense matrices of six times as many rows."""
_STEP = math.log(5.0)
"""Largest change of a log strength in one round."""
_FLOOR = 1e-3
"""Of where the search began: a strength there can't be told from zero."""
_INNER, _HALVINGS, _AT_REST = 30, 8, 1e-4
"""Steps of scoring for one adjustment, and halvings of one; log strengths."""
_AXES = ("X", "Y", "Z", "x", "y", "z")


@dataclass(frozen=True, slots=True)
class Strength:
    """Of one process of one pass, as found."""

    of_pass: str
    """Its name."""
    part: str
    """position or attitude."""
    kind: str
    """Of process."""
    number: int
    """Which of the processes of that part."""
    axes: tuple[int, ...]
    """Components (0 .. 5) that it is of."""
    sigma: float
    """m or rad (per s^1.5 of an integrated Wiener process): of the first of its axes."""
    error: float
    """Standard deviation of `sigma`, of the likelihood's information."""
    zero: bool
    """Whether it went to zero: held at a thousandth of where the search began."""

    @property
    def name(self) -> str:
        """In words."""
        axes = "" if len(self.axes) == 3 else f" {_AXES[self.axes[0]]}"
        return f"{self.part}{axes}, {self.kind}, pass {self.of_pass}"


@dataclass(frozen=True, slots=True, eq=False)
class Combination:
    """What the measures determine of a position and a rotation that they can't tell apart."""

    of_pass: str
    """Name of the pass."""
    position: str
    """Along the track, across it, or radial."""
    rotation: str
    """Roll, pitch or yaw."""
    correlation: float
    """Median over nodes, of the corrections' errors."""
    lever: float
    """m per rad: position + lever times rotation is determined."""
    sigma: float
    """m, of that combination; median over nodes."""
    alone: float
    """m, of the position alone."""

    def words(self) -> str:
        """A sentence."""
        return (
            f"pass {self.of_pass}: {self.position} and {self.rotation} are not separable (correlation "
            f"{self.correlation:.3f} at the nodes): determined is {self.position} {self.lever / 1e3:+.4g} km x "
            f"{self.rotation}, to {self.sigma:.3g} m, {self.position} alone to {self.alone:.3g} m"
        )


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedStrengths:
    """Strengths, and the adjustment with them."""

    network: Network
    """With what was found."""
    solution: Solution
    """Of it."""
    strengths: tuple[Strength, ...]
    """p of them."""
    covariance: Array
    """(p, p) of their natural logarithms."""
    rays: float
    """Factor of the sigmas of tie rays, in total; 1 where it wasn't asked for."""
    rays_error: float
    """Its standard deviation; 0 where it wasn't asked for."""
    combinations: tuple[Combination, ...]
    """Positions and rotations that can't be told apart."""
    converged: bool
    """Whether the last round changed nothing by more than the tolerance."""
    rounds: int
    """Adjustments."""

    def __post_init__(self) -> None:
        count = len(self.strengths)
        assign(self, covariance=frozen(self.covariance, "strengths, covariance", (count, count)))

    @property
    def correlation(self) -> Array:
        """(p, p) of the strengths."""
        scale = np.sqrt(np.maximum(np.diagonal(self.covariance), 1e-300))
        return np.asarray(self.covariance / scale[:, None] / scale)

    def words(self) -> str:
        """A sentence for each strength, for pairs that can't be told apart, and for how it ended."""
        lines = [_said(one) for one in self.strengths]
        if self.rays_error:
            lines.append(f"sigmas of tie rays: times {self.rays:.4g} +- {self.rays_error:.2g}")
        entangled = np.argwhere(np.triu(np.abs(self.correlation) > INSEPARABLE, 1)).tolist()
        for i, k in entangled:
            names = f"{self.strengths[i].name} and {self.strengths[k].name}"
            lines.append(f"{names}: not separable (correlation {self.correlation[i, k]:.3f} of their strengths)")
        lines += [one.words() for one in self.combinations]
        end = "at rest" if self.converged else "NOT at rest"
        return "\n".join([*lines, f"Strengths {end} after {self.rounds} adjustments."])


def _said(one: Strength) -> str:
    unit = "m" if one.part == "position" else "rad"
    unit += "/s^1.5" if one.kind == "integrated-wiener" else ""
    if one.zero:
        return f"{one.name}: not to be seen (strength below {one.sigma:.2g} {unit})"
    return f"{one.name}: {one.sigma:.4g} +- {one.error:.2g} {unit}"


def estimated_strengths(
    network: Network,
    settings: SolverSettings,
    by_axis: bool = False,
    rays: bool = True,
    most: int = 15,
    tolerance: float = 0.01,
    name: str = "adjustment",
    progress: Callable[[Iteration], None] = lambda _: None,
) -> EstimatedStrengths:
    """Find the strengths of all processes that are marked as `estimated`.

    Parameters
    ----------
    network : Network
        Of passes with `ProcessPrior`; the search begins with the sigmas that it has.
    settings : SolverSettings
    by_axis : bool
        Each axis by itself; otherwise a process has one factor for all three axes.
    rays : bool
        Estimate one factor of the sigmas of tie rays, too.
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
    wanted, total, begin = _wanted(network, by_axis), 1.0, network
    left_in = unmarked(network) if settings.reject == 0.0 else None
    for done in range(most):
        solution = adjust_network(network, settings, name, progress, left_in=left_in)
        factor, spread = _ray_factor(solution) if rays else (1.0, 0.0)
        steps, covariance = _scored(solution, wanted)
        # a strength that is known to a tenth only need not be at rest to a hundredth
        sizes = tolerance * np.maximum(1.0, 10.0 * np.minimum(np.sqrt(np.diagonal(covariance)), 1.0))
        now = _sigmas(network, wanted)
        floor = _FLOOR * _sigmas(begin, wanted)
        zero = now * np.exp(steps) <= floor
        change = np.where(zero, np.log(floor / now), np.clip(steps, -_STEP, _STEP))
        converged = bool(np.all(np.abs(change) <= sizes)) and abs(factor - 1.0) <= tolerance
        if converged or done == most - 1:
            break
        network = _with_strengths(network, wanted, np.exp(change))
        if rays:
            network, total = _with_rays(network, factor), total * factor
    errors = now * np.sqrt(np.diagonal(covariance))
    strengths = tuple(
        replace(one, sigma=float(value), error=float(error), zero=bool(gone))
        for (one, _), value, error, gone in zip(wanted, now, errors, zero, strict=True)
    )
    combined = tuple(one for k in sorted({k for _, k in wanted}) for one in combinations(solution, k))
    return EstimatedStrengths(
        network, solution, strengths, covariance, total, total * spread, combined, converged, done + 1
    )


def asks_for_strengths(network: Network) -> bool:
    """Whether some process of a pass is to be estimated."""
    priors = [one.prior for one in network.passes]
    mine = [prior for prior in priors if isinstance(prior, ProcessPrior)]
    return any(one.estimated for prior in mine for one in (*prior.position, *prior.attitude))


def _wanted(network: Network, by_axis: bool) -> list[tuple[Strength, int]]:
    """What is to be found, and the pass that it is of."""
    found = list[tuple[Strength, int]]()
    for k, one in enumerate(network.passes):
        if not isinstance(one.prior, ProcessPrior):
            continue
        for part, first, processes in (("position", 0, one.prior.position), ("attitude", 3, one.prior.attitude)):
            for number, process in enumerate(processes):
                if not process.estimated:
                    continue
                axes = [(c,) for c in range(first, first + 3)] if by_axis else [(first, first + 1, first + 2)]
                found += [(Strength(one.name, part, process.kind, number, own, 0.0, 0.0, False), k) for own in axes]
        if any(of == k for _, of in found) and len(one.nodes) > _MOST:
            remedy = "state the strengths that a shorter part of the pass gives"
            raise InputError(f"pass {one.name!r}, strengths", f"{len(one.nodes)} nodes", f"{_MOST} at most", remedy)
    if not found:
        raise InputError("strengths of processes", "none that is to be estimated", 'some with sigma = "estimated"')
    return found


def _processes(one: Pass, strength: Strength) -> Array:
    """(3,) sigmas of the process of a strength."""
    assert isinstance(one.prior, ProcessPrior)
    part = one.prior.position if strength.part == "position" else one.prior.attitude
    return part[strength.number].sigmas


def _sigmas(network: Network, wanted: list[tuple[Strength, int]]) -> Array:
    return np.array([_processes(network.passes[k], one)[one.axes[0] % 3] for one, k in wanted])


def _scored(solution: Solution, wanted: list[tuple[Strength, int]]) -> tuple[Array, Array]:
    """(p,) how the log strengths should change, and the (p, p) covariance of what is found."""
    steps, spread = np.zeros(len(wanted)), np.zeros((len(wanted), len(wanted)))
    for k in sorted({k for _, k in wanted}):
        mine = [i for i, (_, of) in enumerate(wanted) if of == k]
        steps[mine], covariance = _of_pass(solution, k, [wanted[i][0] for i in mine])
        spread[np.ix_(mine, mine)] = covariance
    return steps, spread


def _of_pass(solution: Solution, number: int, wanted: list[Strength]) -> tuple[Array, Array]:
    one = solution.network.passes[number]
    parts = [_parts(one, strength) for strength in wanted]
    start, push = _information(solution, number)
    steps = np.zeros(len(wanted))
    here = _likelihood(start, push, parts, steps)
    regular = here.information + np.diag(1e-6 + 1e-9 * np.diagonal(here.information))
    covariance = np.linalg.solve(regular, np.eye(len(wanted)))
    for _ in range(_INNER):
        move = np.clip(np.linalg.solve(here.information + 0.05 * np.eye(len(wanted)), here.score), -1.0, 1.0)
        for _ in range(_HALVINGS):
            trial = np.clip(steps + move, -3.0 * _STEP, _STEP)
            there = _likelihood(start, push, parts, trial)
            if there.logarithm >= here.logarithm:
                break
            move = 0.5 * move  # scoring overshoots where the likelihood bends more than is expected
        else:
            break
        steps, here = trial, there
        if np.abs(move).max() < _AT_REST:
            break
    return steps, np.asarray(covariance)


class _Likelihood(NamedTuple):
    """Of log strengths."""

    logarithm: float
    """Of the likelihood, over that of the strengths that the adjustment had."""
    score: Array
    """(p,) its derivatives."""
    information: Array
    """(p, p) that is expected."""


def _likelihood(start: Array, push: Array, parts: Sequence[list[tuple[int, Array]]], steps: Array) -> _Likelihood:
    """Where log strengths change by `steps` (p,); `start` and `push` are W_0 and u_0."""
    from scipy.linalg import lu_factor, lu_solve  # slow to import

    grown, change = np.exp(2.0 * steps), np.zeros_like(start)
    for growth, part in zip(grown, parts, strict=True):
        for c, matrix in part:
            change[c::6, c::6] += (growth - 1.0) * matrix
    factored = lu_factor(np.eye(push.size) + start @ change)
    within, pushed = lu_solve(factored, start), lu_solve(factored, push)
    logarithm = 0.5 * float(push @ change @ pushed - np.sum(np.log(np.abs(np.diagonal(factored[0])))))
    score, products = np.zeros(len(parts)), list[list[tuple[int, Array]]]()
    for i, part in enumerate(parts):
        through = [(c, within[:, c::6] @ (grown[i] * matrix)) for c, matrix in part]
        squares = sum(grown[i] * pushed[c::6] @ matrix @ pushed[c::6] for c, matrix in part)
        score[i] = squares - sum(np.trace(product[c::6]) for c, product in through)
        products.append(through)
    information = np.array([
        [2.0 * sum(np.sum(a[d::6] * b[c::6].T) for c, a in left for d, b in right) for right in products]
        for left in products
    ])  # fmt: skip
    return _Likelihood(logarithm, score, information)


def _parts(one: Pass, strength: Strength) -> list[tuple[int, Array]]:
    """Of each of a strength's axes the covariance (k, k) of the nodes' coefficients, m^2 or rad^2."""
    assert isinstance(one.prior, ProcessPrior)
    part = one.prior.position if strength.part == "position" else one.prior.attitude
    return [(c, dense_covariance((part[strength.number],), c % 3, one.nodes)) for c in strength.axes]


def _information(solution: Solution, number: int) -> tuple[Array, Array]:
    """W_0 (6 k, 6 k) and u_0 (6 k,) of a pass's nodes."""
    one = solution.network.passes[number]
    first, end = solution.network.first_of_passes[number : number + 2].tolist()
    size = 6 * len(one.nodes)
    joint = at_solution(solution).of_estimator().joint.of(range(first, end))[:size, :size]
    prior = _marginal(one)
    found = prior - prior @ joint @ prior
    return 0.5 * (found + found.T), prior @ solution.nodes[number].ravel()


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


def _with_strengths(network: Network, wanted: list[tuple[Strength, int]], factors: Array) -> Network:
    """With strengths times factors (p,)."""
    passes = list(network.passes)
    for (one, k), factor in zip(wanted, factors.tolist(), strict=True):
        prior = passes[k].prior
        assert isinstance(prior, ProcessPrior)
        own = np.ones(3)
        own[[c % 3 for c in one.axes]] = factor
        part = list(prior.position if one.part == "position" else prior.attitude)
        part[one.number] = part[one.number].scaled(own)
        position = one.part == "position"
        changed = replace(prior, position=tuple(part)) if position else replace(prior, attitude=tuple(part))
        passes[k] = replace(passes[k], prior=changed)
    return replace(network, passes=tuple(passes))


def _tie_rays(network: Network) -> Index:
    """(k,) whether each ray is a measured one of a tie, as 1 or 0."""
    grouping = group_rows(network)
    ties = [g for g, name in enumerate(grouping.names) if name == "tie image points"]
    return np.isin(grouping.rays, ties).astype(np.int64)


def _ray_factor(solution: Solution) -> tuple[float, float]:
    """Factor of the sigmas of tie rays, and its standard deviation."""
    found = group_redundancy(at_solution(solution).of_estimator(), group_rows(solution.network))
    mine = [g for g, name in enumerate(found.names) if name == "tie image points"]
    redundancy = float(found.redundancy[mine].sum())
    if redundancy < 1.0:
        return 1.0, 0.0
    return math.sqrt(float(found.squares[mine].sum()) / redundancy), 1.0 / math.sqrt(2.0 * redundancy)


def _with_rays(network: Network, factor: float) -> Network:
    of_rays = np.where(_tie_rays(network) == 1, factor, 1.0)
    return replace(network, rays=replace(network.rays, sigmas=network.rays.sigmas * of_rays[:, None]))


def combinations(solution: Solution, number: int) -> tuple[Combination, ...]:
    """Positions and rotations of a pass, along the axes of its flight, that the measures can't tell apart, and what
    they determine of them.
    """
    one = solution.network.passes[number]
    inner = np.flatnonzero(np.isin(one.nodes.times, one.nodes.inner))
    first, joint = int(solution.network.first_of_passes[number]), at_solution(solution).of_estimator().joint
    turns = strip_turns(solution.network, number, one.nodes.inner + one.nodes.epoch, solution.settings.angles)
    blocks = turns @ np.stack([joint.of([first + k]) for k in inner.tolist()]) @ np.swapaxes(turns, 1, 2)
    scale = np.sqrt(np.diagonal(blocks, axis1=1, axis2=2))
    correlation = np.median(blocks / scale[:, :, None] / scale[:, None, :], axis=0)[:3, 3:]
    found = list[Combination]()
    for p, r in np.argwhere(np.abs(correlation) > INSEPARABLE).tolist():
        lever = -np.median(blocks[:, p, 3 + r] / blocks[:, 3 + r, 3 + r])
        both = blocks[:, p, p] + 2.0 * lever * blocks[:, p, 3 + r] + lever**2 * blocks[:, 3 + r, 3 + r]
        sigma, alone = float(np.sqrt(np.median(both))), float(np.median(scale[:, p]))
        names = FLIGHT[p], FLIGHT[3 + r]
        found.append(Combination(one.name, *names, float(correlation[p, r]), float(lever), sigma, alone))
    return tuple(found)
