"""The plan: every candidate judged by itself, then one chosen after the other, each in sight of those before it."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mgsgraph.errors import InputError, WeakNetwork
from mgsgraph.network import Network
from mgsgraph.network.parts import Unknown, unknowns
from mgsgraph.planning.candidates import Candidate, Kind
from mgsgraph.planning.state import CurrentState, NetworkState
from mgsgraph.planning.targets import Criterion, Sigmas, Targets, TargetSigmas, summarised, targets_of
from mgsgraph.planning.update import AddedInformation, added, updated

Progress = Callable[[int, int], None]
"""Called with how many judgements are done, and how many there will be at most."""
_ALIKE = 9
"""Significant digits in which two falls of a sigma count as the same: then the name decides, not the file's order."""


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """What one candidate, or several together, would do."""

    name: str
    """Of the candidate; several are joined by plus signs."""
    kind: Kind | Literal["several"]
    """Kind of the candidate."""
    before: Sigmas
    """Of the targets, m."""
    after: Sigmas
    """Sigmas of the targets with the candidate, m."""
    bits: float
    """Information gained on the shared unknowns that exist already: half the binary logarithm by which the determinant
    of their covariance falls."""
    rays: int
    """Image coordinates (pairs of line and sample) that would have to be measured."""
    ranges: int
    """Number of laser ranges."""
    images: tuple[str, ...] = ()
    """Images of the network that it touches."""
    overlap: float = float("nan")
    """m^2, for an image: area in common with images of the network, pair by pair."""
    reason: str = ""
    """Why it is worth nothing, where it is."""

    @property
    def measures(self) -> int:
        """Number of image coordinates and ranges."""
        return self.rays + self.ranges

    @property
    def drop(self) -> float:
        """Share by which the targets' total sigma falls, 0 .. 1."""
        return 1.0 - self.after.total / self.before.total if self.before.total > 0.0 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Ranking of candidates, and those chosen."""

    name: str
    """Name of the network."""
    targets: Targets
    """Points and images whose sigmas count."""
    criterion: Criterion
    """Whether their mean sigma counts, or the largest one."""
    now: Sigmas
    """Sigmas of the targets in the present network, m."""
    ranking: tuple[Evaluation, ...]
    """Every candidate by itself, best first; worthless ones last, with the reason."""
    chosen: tuple[Evaluation, ...]
    """One after the other, each judged with those before it in place."""
    plain: Evaluation | None
    """The first of the ranking together, as many as were chosen; None where nothing was chosen."""

    @property
    def after(self) -> Sigmas:
        """Of the targets with all chosen candidates, m."""
        return self.chosen[-1].after if self.chosen else self.now

    @property
    def bits(self) -> float:
        """Information that all chosen ones gain together: the sum of what each adds."""
        return float(sum(step.bits for step in self.chosen))

    @property
    def drop(self) -> float:
        """Share by which the targets' total sigma falls with all chosen ones."""
        return 1.0 - self.after.total / self.now.total if self.now.total > 0.0 else 0.0


class Evaluator:
    """Judges candidates over a network and those that were chosen before.

    Parameters
    ----------
    state : NetworkState
        The network, with what was chosen.
    criterion : "mean" or "worst"
    since : sequence of Unknown
        Unknowns that chosen candidates have brought: gains don't count on them.
    known : dict, optional
        What single candidates add, by their names, as far as an earlier judge has found out; more is put there.
    """

    def __init__(
        self, state: NetworkState, targets: Targets, criterion: Criterion, since: Sequence[Unknown] = (),
        known: dict[str, AddedInformation] | None = None,
    ) -> None:  # fmt: skip
        self._known: dict[str, AddedInformation] = {} if known is None else known
        self.present, self._criterion, self._targets = CurrentState(state), criterion, targets
        self._watch = TargetSigmas(self.present, targets)
        brought = set(since)
        self._since = [name for name in self.present.adjusted if name in brought]
        self.now = summarised(self._watch.before(), targets, criterion)

    def of(self, *candidates: Candidate) -> Evaluation:
        """What one candidate would do, or several together."""
        name = " + ".join(one.name for one in candidates)
        kind = candidates[0].kind if len(candidates) == 1 else "several"
        additions = [one.addition for one in candidates if one.addition is not None]
        images = tuple(dict.fromkeys(image for one in candidates for image in one.images))
        overlap = float(np.sum([one.overlap for one in candidates]))
        counts = sum(one.rays for one in candidates), sum(one.ranges for one in candidates)
        reason, after, bits = "; ".join(one.reason for one in candidates if one.reason), self.now, 0.0
        if additions:
            try:
                update = updated(self.present, self._added(name, additions))
            except WeakNetwork as error:
                reason = str(error)
            else:
                after = summarised(self._watch.after(update), self._targets, self._criterion)
                bits = update.bits_on(self._since)
        return Evaluation(name, kind, self.now, after, bits, *counts, images, overlap, reason)

    def _added(self, name: str, additions: Sequence[Network]) -> AddedInformation:
        if len(additions) > 1:
            return added(self.present, additions)
        if name not in self._known:
            self._known[name] = added(self.present, additions)
        return self._known[name]


def plan(
    state: NetworkState,
    candidates: Sequence[Candidate],
    choose: int = 3,
    wanted: Sequence[str] = ("ties",),
    criterion: Criterion = "mean",
    name: str = "plan",
    progress: Progress = lambda _done, _most: None,
) -> Plan:
    """Rank candidates by what they would do to the sigmas of targets, and choose some of them.

    Parameters
    ----------
    state : NetworkState
        The network as it was adjusted.
    candidates : sequence of Candidate
        Each name once; their order doesn't matter.
    choose : int
        How many to choose, at the most: worthless ones aren't.
    wanted : sequence of str
        "ties", "all", or names of points and images.
    criterion : "mean" or "worst"
        Whether the targets' mean sigma counts, or the largest one.
    name : str
        What to call the network.

    Raises
    ------
    InputError
        No candidate, a name twice, an unknown target.
    WeakNetwork
        When the network itself is too weak.
    """
    _require_candidates(candidates, choose)
    targets = targets_of(state, wanted)
    known = dict[str, AddedInformation]()
    judge = Evaluator(state, targets, criterion, known=known)
    useful = [one for one in sorted(candidates, key=lambda one: one.name) if one.addition is not None]
    steps = min(choose, len(useful))
    most, done = sum(len(useful) - k for k in range(max(steps, 1))) + (steps > 1), 0

    def judged(by: Evaluator, one: Candidate) -> Evaluation:
        nonlocal done
        found = by.of(one)
        done += 1
        progress(done, most)
        return found

    ranking = sorted((judged(judge, one) for one in useful), key=_order)
    worthless = [judge.of(one) for one in candidates if one.addition is None]
    chosen, left, now = list[Evaluation](), {one.name: one for one in useful}, ranking
    at, since = state, list[Unknown]()
    for number in range(steps):
        if number:
            later = Evaluator(at, targets, criterion, since, known)
            now = sorted((judged(later, one) for one in left.values()), key=_order)
        best = now[0]
        if best.reason or best.bits <= 0.0:
            break
        chosen.append(best)
        taken = left.pop(best.name)
        if number + 1 < steps:
            assert taken.addition is not None
            at = at.extended([taken.addition])
            _forget(known, left.values(), taken)
            since = [unknown for unknown in _unknowns(at) if unknown not in _unknowns(state)]
    first, plain = {one.name: one for one in useful}, ranking[0] if chosen else None
    if len(chosen) > 1:
        plain = judge.of(*(first[one.name] for one in ranking[: len(chosen)]))
    progress(most, most)
    last = sorted(worthless, key=lambda one: one.name)
    return Plan(name, targets, criterion, judge.now, (*ranking, *last), tuple(chosen), plain)


def _forget(known: dict[str, AddedInformation], left: Iterable[Candidate], taken: Candidate) -> None:
    """Forget what candidates add that measure a point which the taken one measures, too: it says more now."""
    assert taken.addition is not None
    measured = set(taken.addition.points.ids)
    for one in left:
        if one.addition is not None and not measured.isdisjoint(one.addition.points.ids):
            known.pop(one.name, None)


def _unknowns(state: NetworkState) -> tuple[Unknown, ...]:
    return unknowns(state.network)


def _order(one: Evaluation) -> tuple[bool, float, float, str]:
    """Best first: what can't be judged last; then the fall of the sigma, the information, the name."""
    return bool(one.reason), -_rounded(one.drop), -_rounded(one.bits), one.name


def _rounded(value: float) -> float:
    return float(f"{value:.{_ALIKE - 1}e}")


def _require_candidates(candidates: Sequence[Candidate], choose: int) -> None:
    if not candidates:
        raise InputError("plan", "no candidate", "at least one image, profile or control point")
    names = [one.name for one in candidates]
    for name in sorted({one for one in names if names.count(one) > 1})[:1]:
        raise InputError("plan", f"two candidates named {name!r}", "each name once")
    if choose < 1:
        raise InputError("plan", f"{choose} to choose", "at least 1")
