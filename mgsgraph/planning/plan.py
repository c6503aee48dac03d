"""The plan: every candidate is judged by itself, then they are chosen one by one, each given those before it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mgsgraph.adjustment.graph.forms import IN_PROCESS
from mgsgraph.adjustment.incremental.state import ground_motion
from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError, WeakNetwork, errors_from, require
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.records import Array
from mgsgraph.names import image_names, numbered
from mgsgraph.network import PointClass
from mgsgraph.network.corrections import designs
from mgsgraph.network.parts import KnownImage, Unknown, unknowns
from mgsgraph.planning.candidates import Candidate, Kind, require_candidates
from mgsgraph.planning.state import CurrentState, NetworkState, Update, added, state_of_solution, updated
from mgsgraph.record import Record
from mgsgraph.workers import no_progress

Criterion = Literal["mean", "worst"]
WORDS = ("ties", "all")
"""Targets that are no names."""


@dataclass(frozen=True, slots=True, eq=False)
class Targets(Record):
    """Points and images whose sigmas count."""

    points: tuple[str, ...]
    """Names of points."""
    images: tuple[str, ...]
    """Names of images: what counts is the place of the ground under the image's middle line, on the ellipsoid."""
    wanted: tuple[str, ...]
    """Targets as they were requested."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all targets, points first."""
        return (*self.points, *self.images)

    def __len__(self) -> int:
        return len(self.points) + len(self.images)

    @property
    def words(self) -> str:
        """The targets in words."""
        named = {"ties": "tie points", "all": "points"}
        if len(self.wanted) == 1 and self.wanted[0] in named:
            return f"{len(self)} {named[self.wanted[0]]}"
        return ", ".join(self.wanted)


@dataclass(frozen=True, slots=True)
class Sigmas(Record):
    """Sigmas of the targets in one figure each: their mean, or those of the worst one, in m."""

    total: float
    """Root of the trace of the covariance."""
    east: float
    """Sigma eastward."""
    north: float
    """Sigma northward."""
    up: float
    """Sigma upward."""
    worst: str
    """The target whose total is largest."""


def targets_of(state: NetworkState, names: Sequence[str]) -> Targets:
    """Targets by name.

    Parameters
    ----------
    names : sequence of str
        "ties", "all" (points), or names of points and images; each once.

    Raises
    ------
    InputError
        For a name that is neither, and for one that has no sigma: a fixed point, a held image.
    """
    network = state.network
    ids = network.points.ids
    moving = network.points.kinds != PointKind.FIXED
    names = tuple(dict.fromkeys(names))
    if names in (("ties",), ("all",)):
        chosen = moving & (network.points.classes == PointClass.TIE) if names == ("ties",) else moving
        if not np.any(chosen):
            raise InputError("target", f"no {'tie ' if names == ('ties',) else ''}point that moves", "another target")
        return Targets(tuple(ids[i] for i in np.flatnonzero(chosen).tolist()), (), names)
    place, images = numbered(ids), numbered(network.image_names)
    with errors_from("target, no determined point"):
        whole = (text if text in place or text in WORDS else image_names([text], list(images))[0] for text in names)
        names = tuple(dict.fromkeys(whole))
    for name in names:
        require(name not in WORDS, "target", f"{name!r} beside names", "either 'ties' or 'all', or names")
        if (name in place and not moving[place[name]]) or (name in images and network.held[images[name]]):
            raise InputError("target", f"{name!r}, which is held and has no sigma", "an adjusted one")
    require(names, "target", "none", "'ties', 'all', or names of points and images")
    return Targets(tuple(n for n in names if n in place), tuple(n for n in names if n not in place), names)


class TargetSigmas:
    """Sigmas of targets in the present network, and after an update."""

    def __init__(self, present: CurrentState, targets: Targets) -> None:
        self.present, self.targets = present, targets
        network, layout = present.state.network, present.layout
        self._index = np.array([present.index_of[name] for name in targets.points], dtype=np.int64)
        out = np.ones(len(network.points), dtype=bool)
        out[self._index] = False
        all_rows = np.ones(network.rays.point.size, dtype=bool), np.ones(network.ranges.point.size, dtype=bool)
        self._rows = layout.active(*all_rows, out | ~present.determined)
        number = numbered(network.image_names)
        chosen = [number[name] for name in targets.images]
        images = [KnownImage(network.images[j], network.priors[j]) for j in chosen]
        self._ground = [self._motion(known_image, j) for known_image, j in zip(images, chosen, strict=True)]
        under = np.array([_under(known_image) for known_image in images]).reshape(-1, 3)
        self._axes = east_north_up(np.concatenate([present.state.places[self._index], under]))

    def before(self) -> Array:
        """(t, 4) m: total, east, north, up of every target in the present network."""
        flat = self.present.layout.blocks.filled(self.present.joint)
        joint = self.present.joint
        return self._sigmas(self._of_points(flat), [joint.of(list(unknowns)) for unknowns, _ in self._ground])

    def after(self, update: Update) -> Array:
        """(t, 4) m: total, east, north, up of every target after planned measures."""
        points = self._of_points(update.pairs()) if self._index.size else np.zeros((0, 3, 3))
        place = numbered(self.targets.points)
        ids = update.added.after.network.points.ids
        touched = np.array([i for i, name in enumerate(ids) if name in place], dtype=np.int64)
        if touched.size:
            covariances, _ = update.point_covariances()
            points[[place[ids[i]] for i in touched.tolist()]] = covariances[touched]
        names = self.present.names
        return self._sigmas(points, [update.joint_of([names[v] for v in unknowns]) for unknowns, _ in self._ground])

    def _motion(self, known: KnownImage, image: int) -> tuple[tuple[int, ...], Array]:
        """Variables that the orientation of an image's middle line depends on, and by how much the ground under it
        moves with them (3, d), m per m and per rad.
        """
        angles, network = self.present.state.settings.angles, self.present.network
        (parts,) = designs(network, image, angles, known.image.middle[0])
        return tuple(parts), ground_motion(known, angles)[:, :6] @ np.hstack(list(parts.values()))

    def _of_points(self, flat: Array) -> Array:
        """(p, 3, 3) m^2 with the joint covariance in blocks."""
        present, layout = self.present, self.present.layout
        points = present.reduction.points
        covariances = IN_PROCESS.covariances(layout, self._rows, present.values, flat, points)
        return np.asarray(layout.network_order(covariances)[self._index])

    def _sigmas(self, points: Array, images: Sequence[Array]) -> Array:
        ground = [motion @ spread @ motion.T for (_, motion), spread in zip(self._ground, images, strict=True)]
        covariances = np.concatenate([points, np.array(ground).reshape(-1, 3, 3)])
        local = np.einsum("tij,tjk,tik->ti", self._axes, covariances, self._axes)
        return np.asarray(np.sqrt(np.maximum(np.column_stack([local.sum(axis=1), local]), 0.0)))


def _under(known: KnownImage) -> Array:
    """(3,) m, the ground under an image's middle; where it looks past the body, the camera."""
    image = known.image
    line, sample = image.middle
    ground, _ = image.image_to_ground(line, sample)
    return np.asarray(ground[0] if np.all(np.isfinite(ground)) else image.pose(line).position[0])


def summarised(sigmas: Array, targets: Targets, criterion: Criterion) -> Sigmas:
    """Sigmas (t, 4) of all targets in one figure each."""
    worst = int(np.argmax(sigmas[:, 0]))
    total, east, north, up = (sigmas[worst] if criterion == "worst" else sigmas.mean(axis=0)).tolist()
    return Sigmas(total, east, north, up, targets.names[worst])



Progress = Callable[[int, int], None]
"""Called with how many judgements are done, and how many there will be at most."""
_DIGITS = 9
"""Significant digits in which two falls of a sigma count as the same: then the name decides, not the file's order."""


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation(Record):
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
class Plan(Record):
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
    """

    def __init__(
        self, state: NetworkState, targets: Targets, criterion: Criterion, since: Sequence[Unknown] = ()
    ) -> None:
        self.present, self._criterion, self._targets = CurrentState(state), criterion, targets
        self._watch = TargetSigmas(self.present, targets)
        brought = set(since)
        self._since = [name for name in self.present.adjusted if name in brought]
        self.now = summarised(self._watch.before(), targets, criterion)

    def of(self, *candidates: Candidate) -> Evaluation:
        """What one candidate would do, or several together."""
        name = " + ".join(candidate.name for candidate in candidates)
        kind = candidates[0].kind if len(candidates) == 1 else "several"
        additions = [candidate.addition for candidate in candidates if candidate.addition is not None]
        images = tuple(dict.fromkeys(image for candidate in candidates for image in candidate.images))
        overlap = float(np.sum([candidate.overlap for candidate in candidates]))
        counts = sum(candidate.rays for candidate in candidates), sum(candidate.ranges for candidate in candidates)
        reason, after, bits = "; ".join(candidate.reason for candidate in candidates if candidate.reason), self.now, 0.0
        if additions:
            try:
                update = updated(self.present, added(self.present, additions))
            except WeakNetwork as error:
                reason = str(error)
            else:
                after = summarised(self._watch.after(update), self._targets, self._criterion)
                bits = update.bits_on(self._since)
        return Evaluation(name, kind, self.now, after, bits, *counts, images, overlap, reason)


def plan(
    of: Solution | NetworkState,
    candidates: Sequence[Candidate],
    choose: int = 3,
    wanted: Sequence[str] = ("ties",),
    criterion: Criterion = "mean",
    name: str = "plan",
    progress: Progress = no_progress,
) -> Plan:
    """Rank candidates by what they would do to the sigmas of targets, and choose some of them.

    Parameters
    ----------
    of : Solution or NetworkState
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

    Examples
    --------
    >>> coverage = mgsgraph.ImageCoverage(solution)
    >>> rim = mgsgraph.planned_point(coverage, "rim", solution.places[0], np.eye(3), sigma=0.5)
    >>> found = mgsgraph.plan(solution, [rim], choose=1)
    >>> f"{found.now.total:.1f} m -> {found.after.total:.1f} m"
    '25.3 m -> 15.3 m'
    """
    state = state_of_solution(of)
    require_candidates("plan", [candidate.name for candidate in candidates])
    require(choose >= 1, "plan", f"{choose} to choose", "at least 1")
    targets = targets_of(state, wanted)
    judge = Evaluator(state, targets, criterion)
    useful = [c for c in sorted(candidates, key=lambda c: c.name) if c.addition is not None]
    steps = min(choose, len(useful))
    most, done = sum(len(useful) - k for k in range(max(steps, 1))), 0

    def judged(by: Evaluator, candidate: Candidate) -> Evaluation:
        nonlocal done
        evaluation = by.of(candidate)
        done += 1
        progress(done, most)
        return evaluation

    ranking = sorted((judged(judge, candidate) for candidate in useful), key=_order)
    worthless = [judge.of(candidate) for candidate in candidates if candidate.addition is None]
    present = set(unknowns(state.network))
    chosen, left, now = list[Evaluation](), {candidate.name: candidate for candidate in useful}, ranking
    at, since = state, list[Unknown]()
    for number in range(steps):
        if number:
            later = Evaluator(at, targets, criterion, since)
            now = sorted((judged(later, candidate) for candidate in left.values()), key=_order)
        best = now[0]
        if best.reason or best.bits <= 0.0:
            break
        chosen.append(best)
        added_candidate = left.pop(best.name)
        if number + 1 < steps:
            assert added_candidate.addition is not None
            at = at.extended([added_candidate.addition])
            since = [unknown for unknown in unknowns(at.network) if unknown not in present]
    progress(most, most)
    last = sorted(worthless, key=lambda evaluation: evaluation.name)
    return Plan(name, targets, criterion, judge.now, (*ranking, *last), tuple(chosen))


def _order(evaluation: Evaluation) -> tuple[bool, float, float, str]:
    """Best first, candidates that can't be judged last; then the fall of the sigma, the information, the name."""
    drop, bits = (float(f"{value:.{_DIGITS - 1}e}") for value in (evaluation.drop, evaluation.bits))
    return bool(evaluation.reason), -drop, -bits, evaluation.name
