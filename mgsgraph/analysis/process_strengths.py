"""Strengths of the processes of passes, estimated from the measures by restricted maximum likelihood.

found = estimated_strengths(network, settings)   # adjusts, estimates, adjusts again, until nothing changes
print(found)

Processes of the same part (position, attitude), kind and frequency have one strength, common to all passes: a pair of
images shows the difference of two passes alone, and whose a vibration is can't be told. All passes are one likelihood
(`strength_likelihood`); Fisher's scoring takes steps in log s.

A strength that measures hardly see is not searched for, for it would run away: where the search begins, the expected
standard deviation of its logarithm has to be less than 1. With `by_axis` it is taken over from the other axes of its
process (what pitches may as well roll); where none is seen, departures are held at nothing. Both are said.

Rays that scatter more or less than stated would be taken for a process: with `rays` their sigmas are multiplied by the
factor of Foerstner's estimate, v'v / r over all tie rays, in the same rounds; that is its restricted maximum likelihood
as well.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.batch import Iteration
from mgsgraph.adjustment.rounds import unmarked
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.grouping import group_rows
from mgsgraph.analysis.helmert import group_redundancy
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.separability import LIMIT, Inseparable, inseparable
from mgsgraph.analysis.strength_likelihood import Evidence, Member
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index, assign, frozen
from mgsgraph.network import Network, Process, ProcessPrior
from mgsgraph.record import Record

_MOST = 600
"""Nodes of a pass: dense matrices of its components."""
_STEP = math.log(5.0)
"""Largest change of a log strength in one round."""
_FLOOR = 1e-3
"""Of where the search began: a strength there can't be told from zero."""
_SEEN = 1.0
"""Information on a log strength, where the search begins, for it to be searched for."""
_AXES = ("X", "Y", "Z", "x", "y", "z")


@dataclass(frozen=True, slots=True)
class Strength(Record):
    """Of one process, common to passes, as found."""

    passes: tuple[str, ...]
    """Their names."""
    part: str
    """position or attitude."""
    kind: str
    """Of process."""
    frequency: float
    """Hz, of jitter; of others 0."""
    axes: tuple[int, ...]
    """Components (0 .. 5) that it is of."""
    members: tuple[Member, ...]
    """Processes of passes that have it, along these axes."""
    sigma: float = 0.0
    """m or rad (per s^1.5 of an integrated Wiener process): of the first of its axes."""
    error: float = 0.0
    """Standard deviation of `sigma`, of the likelihood's information; 0 where it was not searched for."""
    zero: bool = False
    """Whether it went to zero: held at a thousandth of where the search began."""
    seen: float = 0.0
    """Share of the departures' a-priori variance that measures take away; 0: not observable."""
    searched: bool = True
    """Whether it was searched for; else hardly seen."""
    source: str = ""
    """Axis from which it was taken over, where it was hardly seen and another one was."""

    @property
    def name(self) -> str:
        """Part of the pose, kind of process and passes, for reports."""
        axes = "" if len(self.axes) == 3 else f" {_AXES[self.axes[0]]}"
        kind = f"{self.kind} of {self.frequency:.4g} Hz" if self.frequency else self.kind
        of = f"pass {self.passes[0]}" if len(self.passes) == 1 else f"common to {len(self.passes)} passes"
        return f"{self.part}{axes}, {kind}, {of}"

    @property
    def sentence(self) -> str:
        """The strength with its standard deviation, or why there is none, as one line of a report."""
        unit = "m" if self.part == "position" else "rad"
        unit += "/s^1.5" if self.kind == "integrated-wiener" else ""
        hardly = f"{self.name}: hardly seen ({self.seen:.1g} of its variance)"
        if self.source:
            return f"{hardly}, taken over from {self.source}: {self.sigma:.4g} {unit}"
        if not self.searched:
            return f"{hardly}, held at nothing ({self.sigma:.2g} {unit})"
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
    rays: float
    """Factor of the sigmas of tie rays, in total; 1 where it wasn't asked for."""
    rays_error: float
    """Its standard deviation; 0 where it wasn't asked for."""
    evidence: float
    """Log likelihood of the strengths that were searched for, over that of none of these processes, nats."""
    inseparable: tuple[Inseparable, ...]
    """Positions, rotations and shared unknowns of passes that can't be separated."""
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

    @property
    def sentences(self) -> list[str]:
        """One for each strength, for pairs that can't be told apart, and for how it ended."""
        lines = [one.sentence for one in self.strengths]
        if self.rays_error:
            lines.append(f"sigmas of tie rays: times {self.rays:.4g} +- {self.rays_error:.2g}")
        entangled = np.argwhere(np.triu(np.abs(self.correlation) > LIMIT, 1)).tolist()
        for i, k in entangled:
            names = f"{self.strengths[i].name} and {self.strengths[k].name}"
            lines.append(f"{names}: not separable (correlation {self.correlation[i, k]:.3f} of their strengths)")
        lines += [one.sentence for one in self.inseparable]
        end = "at rest" if self.converged else "NOT at rest"
        return [*lines, f"Strengths {end} after {self.rounds} adjustments."]


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
        Each axis by itself; otherwise a process has one factor for all three axes. A strength is common to all passes
        that have the process (part, kind and frequency): the search begins with that of the first.
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
    sought, total, begin = _sought(network, by_axis), 1.0, network
    network = _with_changes(network, sought, np.zeros(len(sought)))
    left_in = unmarked(network) if settings.reject == 0.0 else None
    searched, shares = np.zeros(0, dtype=np.int64), np.zeros(0)
    for done in range(most):
        solution = adjust_network(network, settings, name, progress, left_in=left_in)
        factor, spread = _ray_factor(solution) if rays else (1.0, 0.0)
        every = Evidence.of(solution, [one.members for one in sought])
        if done == 0:
            start = every.likelihood(np.zeros(len(sought)))
            searched, shares = np.flatnonzero(np.diagonal(start.information) > _SEEN), start.shares
        evidence = every.without(searched)
        covariance = _covariance(evidence, searched)
        change, zero = _changes(sought, searched, evidence.maximum(_STEP), _sigmas(network, sought),
                                _FLOOR * _sigmas(begin, sought))  # fmt: skip
        # a strength that is known to a tenth only need not be at rest to a hundredth
        sizes = tolerance * np.maximum(1.0, 10.0 * np.minimum(np.sqrt(np.diagonal(covariance)), 1.0))
        converged = bool(np.all(np.abs(change[searched]) <= sizes)) and abs(factor - 1.0) <= tolerance
        converged &= done > 0 or searched.size == len(sought)
        if converged or done == most - 1:
            break
        network = _with_changes(network, sought, change)
        if rays:
            network, total = _with_rays(network, factor), total * factor
    now, logs = _sigmas(network, sought), np.zeros((len(sought), len(sought)))
    logs[np.ix_(searched, searched)] = covariance
    errors = now * np.sqrt(np.diagonal(logs))
    strengths = tuple(
        replace(one, sigma=float(now[i]), error=float(errors[i]), zero=bool(zero[i]), seen=float(shares[i]),
                searched=i in searched, source=_source(sought, searched, i, now))
        for i, one in enumerate(sought)
    )  # fmt: skip
    joint = at_solution(solution).of_estimator().joint
    combined = inseparable(solution.network, joint, solution.settings.angles)
    gained = evidence.over_nothing() if searched.size else 0.0
    return EstimatedStrengths(
        network, solution, strengths, logs, total, total * spread, gained, combined, converged, done + 1
    )


def _sought(network: Network, by_axis: bool) -> list[Strength]:
    """What is to be found: processes alike in part, kind and frequency, and along the same axes, are one."""
    found = dict[tuple[str, str, float, int, tuple[int, ...]], list[Member]]()
    for k, one in enumerate(network.passes):
        for part in ("position", "attitude") if isinstance(one.prior, ProcessPrior) else ():
            first, alike = 0 if part == "position" else 3, list[tuple[str, float]]()
            axes = [(c,) for c in range(first, first + 3)] if by_axis else [(first, first + 1, first + 2)]
            for number, process in enumerate(_processes(network, k, part)):
                kind = process.kind, process.frequency
                for own in axes if process.estimated else ():
                    members = found.setdefault((part, *kind, alike.count(kind), own), [])
                    members += [Member(k, number, c) for c in own]
                alike.append(kind)
        if len(one.nodes) > _MOST and any(m.of_pass == k for members in found.values() for m in members):
            remedy = "state the strengths that a shorter part of the pass gives"
            raise InputError(f"pass {one.name!r}, strengths", f"{len(one.nodes)} nodes", f"{_MOST} at most", remedy)
    if not found:
        raise InputError("strengths of processes", "none that is to be estimated", 'some with sigma = "estimated"')
    return [
        Strength(tuple(dict.fromkeys(network.passes[m.of_pass].name for m in members)), part, kind, frequency, axes,
                 tuple(members))
        for (part, kind, frequency, _, axes), members in found.items()
    ]  # fmt: skip


def _processes(network: Network, number: int, part: str) -> tuple[Process, ...]:
    """Of a part of a pass."""
    prior = network.passes[number].prior
    assert isinstance(prior, ProcessPrior)
    return prior.position if part == "position" else prior.attitude


def _sigma(network: Network, one: Strength, component: int) -> float:
    """Of the first pass that has a strength: along an axis."""
    (first,) = [m for m in one.members if m.component == component and m.of_pass == one.members[0].of_pass]
    return float(_processes(network, first.of_pass, one.part)[first.number].sigmas[component % 3])


def _sigmas(network: Network, sought: list[Strength]) -> Array:
    """(p,) of the first axis of each."""
    return np.array([_sigma(network, one, one.axes[0]) for one in sought])


def _covariance(evidence: Evidence, searched: Index) -> Array:
    """(s, s) of the log strengths that are searched for, by the information that is expected."""
    if not searched.size:
        return np.zeros((0, 0))
    information = evidence.likelihood(np.zeros(searched.size)).information
    regular = information + np.diag(1e-6 + 1e-9 * np.diagonal(information))
    return np.asarray(np.linalg.solve(regular, np.eye(searched.size)))


def _siblings(sought: list[Strength], searched: Index, i: int) -> list[int]:
    """Strengths of other axes of the same processes, that are searched for."""
    mine = {m[:2] for m in sought[i].members}
    return [
        k for k in searched.tolist()
        if k != i and sought[k].part == sought[i].part and {m[:2] for m in sought[k].members} == mine
    ]  # fmt: skip


def _source(sought: list[Strength], searched: Index, i: int, now: Array) -> str:
    """Axis that a strength is taken over from; none where it is searched for, or no other one is."""
    others = [] if i in searched else _siblings(sought, searched, i)
    return _AXES[sought[max(others, key=lambda k: now[k])].axes[0]] if others else ""


def _changes(
    sought: list[Strength], searched: Index, steps: Array, now: Array, floor: Array
) -> tuple[Array, Index]:
    """(p,) change of log strengths, and whether each is at its floor."""
    change = np.log(floor / now)  # of what nothing is seen
    change[searched] = np.maximum(np.clip(steps, -_STEP, _STEP), change[searched])
    zero = np.zeros(now.size, dtype=bool)
    zero[searched] = now[searched] * np.exp(steps) <= floor[searched]
    change[zero] = np.log(floor / now)[zero]
    for i in range(len(sought)):
        others = [] if i in searched else _siblings(sought, searched, i)
        if others:
            change[i] = np.log(max(now[k] * np.exp(change[k]) for k in others) / now[i])
    return change, zero


def _with_changes(network: Network, sought: list[Strength], change: Array) -> Network:
    """With log strengths (p,) changed; those of all passes then are that of the first."""
    passes = list(network.passes)
    for one, growth in zip(sought, np.exp(change).tolist(), strict=True):
        for of_pass, number, component in one.members:
            prior = passes[of_pass].prior
            assert isinstance(prior, ProcessPrior)
            part = list(prior.position if one.part == "position" else prior.attitude)
            sigmas = np.array(part[number].sigmas)
            sigmas[component % 3] = growth * _sigma(network, one, component)
            part[number] = replace(part[number], sigmas=sigmas)
            if one.part == "position":
                prior = replace(prior, position=tuple(part))
            else:
                prior = replace(prior, attitude=tuple(part))
            passes[of_pass] = replace(passes[of_pass], prior=prior)
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
