"""Strengths of processes: one of each axis, common to passes or of each pass; where a network has them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Network, Process, ProcessPrior
from mgsgraph.record import Record

_OWN = 0.6
"""Standard deviation beforehand of log strengths of single axes about what a process's axes have in common."""
_DEPARTURE = 0.5
"""Deviation beforehand of a pass from the others, over that of strengths."""
_HARDLY = 0.5
"""Deviation of a log strength from which on its upper limit alone is stated."""
_MOST = 600
"""Of a pass: dense matrices of its components."""


@dataclass(frozen=True, slots=True)
class Strength(Record):
    """Of one axis of a process, common to passes or of one pass, as found."""

    passes: tuple[str, ...]
    """Their names."""
    part: str
    """position or attitude."""
    kind: str
    """Of process."""
    axis: int
    """0 .. 2: X, Y, Z of the position, x, y, z of the attitude."""
    members: tuple[tuple[int, int], ...]
    """Passes and the number of the process within the part of each."""
    process: int
    """Number of the process: its axes, and its passes where they differ, have it in common."""
    begin: float
    """m or rad (per s^1.5 of an integrated Wiener process): a-priori value."""
    spread: float
    """Standard deviation beforehand of the logarithm of what its axes have in common."""
    sigma: float = 0.0
    """In the same unit, median of the posterior."""
    error: float = 0.0
    """Standard deviation of its logarithm."""
    interval: tuple[float, float] = (0.0, 0.0)
    """5 % and 95 % points, in the unit of `sigma`."""

    @property
    def component(self) -> int:
        """Of the pose, 0 .. 5."""
        return self.axis + 3 * (self.part == "attitude")

    @property
    def seen(self) -> bool:
        """Whether measures tell it, and not its upper limit alone."""
        return self.error < _HARDLY

    @property
    def name(self) -> str:
        """Part of the pose, axis, kind of process and passes, for reports."""
        of = f"pass {self.passes[0]}" if len(self.passes) == 1 else f"common to {len(self.passes)} passes"
        return f"{self.part} {'XYZxyz'[self.component]}, {self.kind}, {of}"

    @property
    def sentence(self) -> str:
        """The strength with its interval, or the upper limit alone, as one line of a report."""
        unit = "m" if self.part == "position" else "rad"
        unit += "/s^1.5" if self.kind == "integrated-wiener" else ""
        low, high = self.interval
        if not self.seen:
            return f"{self.name}: hardly seen, below {high:.2g} {unit} (95 %)"
        return f"{self.name}: {self.sigma:.3g} {unit} ({low:.2g} .. {high:.2g}, 90 %)"


def sought_strengths(network: Network) -> list[Strength]:
    """What is to be found: processes alike in part and kind are one, of all passes, with three axes."""
    members_of = dict[tuple[str, str, int], list[tuple[int, int]]]()
    for k, pass_ in enumerate(network.passes):
        for part in ("position", "attitude") if isinstance(pass_.prior, ProcessPrior) else ():
            kinds = list[str]()
            for number, process in enumerate(processes_of(network, k, part)):
                if process.estimated:
                    members_of.setdefault((part, process.kind, kinds.count(process.kind)), []).append((k, number))
                kinds.append(process.kind)
        if len(pass_.nodes) > _MOST and any(k == of for members in members_of.values() for of, _ in members):
            remedy = "state the strengths that a shorter part of the pass gives"
            raise InputError(f"pass {pass_.name!r}, strengths", f"{len(pass_.nodes)} nodes", f"{_MOST} at most", remedy)
    require(members_of, "strengths of processes", "none that is to be estimated", 'some with sigma = "estimated"')
    sought = list[Strength]()
    for number, ((part, kind, _), members) in enumerate(members_of.items()):
        names = tuple(network.passes[k].name for k, _ in members)
        first = processes_of(network, members[0][0], part)[members[0][1]]
        sought += [
            Strength(names, part, kind, axis, tuple(members), number, sigma, first.spread)
            for axis, sigma in enumerate(first.sigmas.tolist())
        ]
    return sought


def of_each_pass(sought: Sequence[Strength]) -> tuple[list[Strength], Index]:
    """With strengths of each pass; and which each was before."""
    pairs = [
        (replace(item, passes=(name,), members=(member,)), k)
        for k, item in enumerate(sought)
        for name, member in zip(item.passes, item.members, strict=True)
    ]
    return [item for item, _ in pairs], np.array([k for _, k in pairs])


def spread_beforehand(sought: Sequence[Strength]) -> Array:
    """(p, p) covariance beforehand of log strengths."""
    process, axis, first = np.array([(item.process, item.axis, item.members[0][0]) for item in sought]).T[:, None]
    same, same_axis = process == process.T, (process == process.T) & (axis == axis.T)
    common = np.outer(*2 * ([item.spread for item in sought],)) * same + _OWN**2 * same_axis
    return np.asarray(common * (1.0 + _DEPARTURE**2 * (same_axis.sum(axis=0) > 1) * (first == first.T)))


def processes_of(network: Network, number: int, part: str) -> tuple[Process, ...]:
    """Of a part of a pass."""
    prior = network.passes[number].prior
    assert isinstance(prior, ProcessPrior)
    processes: tuple[Process, ...] = getattr(prior, part)
    return processes


def strength_sigmas(network: Network, sought: Sequence[Strength]) -> Array:
    """(p,) of the first pass that has each."""
    first = [(item, *item.members[0]) for item in sought]
    return np.array([processes_of(network, k, item.part)[number].sigmas[item.axis] for item, k, number in first])


def with_strength_sigmas(network: Network, sought: Sequence[Strength], sigmas: Array) -> Network:
    """With strengths (p,), of all passes."""
    passes = list(network.passes)
    for item, sigma in zip(sought, sigmas.tolist(), strict=True):
        for of_pass, number in item.members:
            prior: Any = passes[of_pass].prior
            part = list(getattr(prior, item.part))
            of_axes = np.where(np.arange(3) == item.axis, sigma, part[number].sigmas)
            part[number] = replace(part[number], sigmas=of_axes)
            passes[of_pass] = replace(passes[of_pass], prior=replace(prior, **{item.part: tuple(part)}))
    return replace(network, passes=tuple(passes))
