"""Candidate spacings of orientation images, judged by how well each predicts rays that it has not seen.

All candidates see the same rays and are asked for the same ones, so that they are judged by differences ray by ray:
what a ray's own noise does to all of them alike drops out. Blunders, where they are sought, are so once, with the
closest nodes that the rays support: wider ones would take what they can't follow for blunders. Rays near in time share
the error of the orientation there and are not independent; standard errors are those of sums over stretches of time. Of
all spacings that are not worse than the best one by more than one standard error of the difference, the coarsest is
chosen (the rule of one standard error, Breiman et al. 1984): it predicts as well, with fewer unknowns.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.rounds import unmarked
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.spacing.rays import HeldOut, Scatter, hold_out, misfits, ray_scatter, whitening
from mgsgraph.errors import InputError, SolverError, WeakNetwork
from mgsgraph.geometry.orientation_images import OrientationImages, evenly_spaced
from mgsgraph.geometry.records import Array, Index, assign, frozen
from mgsgraph.network import Network, NodePrior
from mgsgraph.network.support import LEAST, require_supported

_STRETCHES = 10
"""Stretches of time that a strip has at least, whose sums count as independent."""
_BLUNDER = 6.0
"""Robust standard deviations beyond which a ray held out is a blunder, if it is so for every candidate."""
_MEDIAN = 1.1774100225154747
"""Median norm of two standard normal numbers."""


def respaced(network: Network, spacing: float) -> Network:
    """A network whose strips all have even nodes at a spacing of at most `spacing` s, over the same time."""
    return with_nodes(
        network,
        [
            evenly_spaced(strip.nodes.basis, strip.nodes.epoch, strip.nodes.coverage, spacing)
            for strip in network.passes
        ],
    )


def with_nodes(network: Network, nodes: Sequence[OrientationImages]) -> Network:
    """A network with other nodes of its strips, in their order; the priors stay, which know any nodes."""
    require_respaceable(network)
    strips = (replace(strip, nodes=other) for strip, other in zip(network.passes, nodes, strict=True))
    return replace(network, passes=tuple(strips))


def require_respaceable(network: Network) -> None:
    """Raise InputError unless there are strips, and priors that hold for any nodes."""
    if not network.passes:
        raise InputError("network", "no strips", "images whose orientation follows from orientation images")
    for strip in network.passes:
        if not isinstance(strip.prior, NodePrior):
            found = "a joint prior of just its nodes"
            raise InputError(f"strip {strip.name!r}", found, "one of any nodes (bias, drift and sigmas)")


@dataclass(frozen=True, slots=True, eq=False)
class SpacingCandidate:
    """One spacing and its predictions."""

    spacing: float
    """s, as asked for."""
    nodes: int
    """Of all strips."""
    longest: float
    """s, the longest interval that there is."""
    squares: Array
    """(h,) half the squared norm of each whitened misfit: 1 on the average if all is noise; empty when refused."""
    sigma0: float
    """Of the adjustment without these rays."""
    refused: str = ""
    """Reason why there is no adjustment; empty where there is one."""

    def __post_init__(self) -> None:
        assign(self, squares=frozen(self.squares, "squared misfits", (None,)))

    @property
    def rms(self) -> float:
        """Root mean square of the whitened misfits; 1 is noise."""
        return float(np.sqrt(self.squares.mean())) if self.squares.size else float("nan")

    @property
    def median(self) -> float:
        """Robust rms of the whitened misfits, from the median; 1 is noise."""
        return float(np.sqrt(2.0 * np.median(self.squares))) / _MEDIAN if self.squares.size else float("nan")

    @property
    def median_error(self) -> float:
        """Its standard error: half the distance of the quantiles half a standard error of a rank beside the median."""
        if not self.squares.size:
            return float("nan")
        beside = 0.5 / np.sqrt(self.squares.size)
        low, high = np.quantile(self.squares, [max(0.5 - beside, 0.0), min(0.5 + beside, 1.0)])
        return float(np.sqrt(2.0 * high) - np.sqrt(2.0 * low)) / 2.0 / _MEDIAN


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """Candidates, from the closest to the widest spacing, and the chosen one."""

    network: Network
    """With the nodes that it had."""
    candidates: tuple[SpacingCandidate, ...]
    """Those refused, too."""
    stretch: Index
    """(h,) stretch of time of each ray held out that is judged."""
    rms_errors: Array
    """(c,) standard errors of the candidates' rms; NaN where refused."""
    worse: Array
    """(c,) mean square of the whitened misfits minus that of the best one."""
    worse_errors: Array
    """(c,) standard errors of these differences; 0 of the best one."""
    best: int
    """Of the least rms."""
    chosen: int
    """The coarsest that is not worse by more than one standard error."""
    blunders: int
    """Rays held out that no candidate can predict, and that count for none."""
    unjudged: int
    """Rays held out that count for none, as nothing else places their points well enough."""
    closest: int
    """Closest candidate that can be adjusted with all rays."""
    closest_solution: Solution
    """Of all rays, with its nodes: what it rejected took part with no candidate."""
    scatter: Scatter
    """Of the rays in it."""

    def __post_init__(self) -> None:
        for name in ("rms_errors", "worse", "worse_errors"):
            value = np.array(getattr(self, name), dtype=np.float64)
            value.flags.writeable = False
            assign(self, **{name: value})

    @property
    def rejected(self) -> int:
        """Rays that took part with no candidate, as blunders."""
        marks = self.closest_solution.rays_rejected
        return 0 if marks is None else int(np.count_nonzero(marks))

    @property
    def spacing(self) -> float:
        """s, what is chosen."""
        return self.candidates[self.chosen].spacing

    @property
    def chosen_network(self) -> Network:
        """The network with the nodes chosen; all of its rays take part again."""
        return respaced(self.network, self.spacing)


def choose_spacing(
    network: Network,
    settings: SolverSettings,
    spacings: Sequence[float],
    share: float = 0.2,
    seed: int = 0,
    least: int = LEAST,
    progress: Callable[[int, int], None] = lambda _done, _most: None,
) -> Choice:
    """Adjust a network with each spacing of its strips' nodes, and judge them by rays held out.

    Parameters
    ----------
    network : Network
        With strips; rays and ranges that it marks as rejected take no part, or with a blunder limit are judged anew.
    settings : SolverSettings
        A blunder limit holds in one adjustment of all rays, with the closest nodes; what that rejects takes part with
        no candidate, so that all see the same rays.
    spacings : sequence of float
        s, candidates; two at least that differ in their nodes.
    share : float
        Of the points with three rays or more, of each of which one ray is held out.
    seed : int
        Of the draw of these rays.
    least : int
        Rays that each node needs near it; candidates where one has fewer are refused, with the reason.
    progress : callable
        Called with the number of adjustments done, and of all: one with all rays, and one of each candidate.

    Raises
    ------
    InputError
        Where there is nothing to choose from, or nothing to judge by.
    """
    require_respaceable(network)
    held = hold_out(network, share, np.random.default_rng(seed))
    tried, plain = _distinct(network, spacings), replace(settings, reject=0.0)
    progress(0, len(tried) + 1)
    closest, whole = _closest(tried, settings, least)
    clean = network
    if settings.reject > 0.0:
        clean = network.with_rejected(whole.rays_rejected, whole.ranges_rejected)
        held = hold_out(clean, share, np.random.default_rng(seed))
    trials = list[_Trial]()
    for done, (spacing, one) in enumerate(tried):
        progress(done + 1, len(tried) + 1)
        trials.append(_trial(spacing, replace(clean, passes=one.passes), plain, held, least))
    progress(len(tried) + 1, len(tried) + 1)
    return _choice(network, _judged(clean, trials, held), closest, whole)


def adjust_unmarked(network: Network, settings: SolverSettings, name: str) -> Solution:
    """Adjust a network without what it marks as blunders; a blunder limit judges all anew."""
    return adjust_network(network, settings, name, left_in=None if settings.reject > 0.0 else unmarked(network))


def _closest(tried: Sequence[tuple[float, Network]], settings: SolverSettings, least: int) -> tuple[int, Solution]:
    """The closest spacing that all rays support, and the adjustment with it."""
    said = ""
    for k, (spacing, one) in enumerate(tried):
        name = f"nodes every {spacing:g} s"
        try:
            require_supported(one, least)
            return k, adjust_unmarked(one, settings, name)
        except (InputError, WeakNetwork, SolverError) as error:
            said = f"0 of {len(tried)} that can be adjusted, two needed; of {spacing:g} s: {error}"
    raise InputError("candidate spacings", said)


class _Trial(NamedTuple):
    """A spacing that was tried."""

    spacing: float
    network: Network
    solution: Solution | None
    misfits: Array
    """(h, 2) px; NaN where there is no prediction."""
    refused: str


def _distinct(network: Network, spacings: Sequence[float]) -> list[tuple[float, Network]]:
    """Spacings, ascending, and the networks with them; of those with the same nodes, as wide ones in short strips have
    them, the first.
    """
    found = dict[tuple[int, ...], tuple[float, Network]]()
    for spacing in sorted(set(spacings)):
        one = respaced(network, spacing)
        found.setdefault(tuple(len(strip.nodes) for strip in one.passes), (spacing, one))
    if len(found) < 2:
        asked = ", ".join(f"{one:g}" for one in spacings) or "none"
        expected = "two or more that differ in their nodes (a strip has four at least)"
        raise InputError("candidate spacings", f"{asked} s", expected)
    return list(found.values())


def _trial(spacing: float, network: Network, settings: SolverSettings, held: HeldOut, least: int) -> _Trial:
    try:
        require_supported(network, least, held.taken(network))
        solution = adjust_network(network, settings, f"nodes every {spacing:g} s", left_in=held.left_in(network))
    except (InputError, WeakNetwork, SolverError) as error:
        return _Trial(spacing, network, None, np.zeros((0, 2)), str(error))
    return _Trial(spacing, network, solution, misfits(solution, held), "")


class _Judged(NamedTuple):
    """Whitened misfits of the rays held out, trial by trial."""

    candidates: tuple[SpacingCandidate, ...]
    """One for each trial."""
    stretch: Index
    """(h,) stretch of time of each ray that is judged."""
    blunders: int
    """Number of rays that no candidate can predict."""
    unjudged: int
    """Number of rays whose points nothing else determines well enough."""


def _judged(network: Network, trials: Sequence[_Trial], held: HeldOut) -> _Judged:
    good = [k for k, trial in enumerate(trials) if trial.solution is not None]
    if len(good) < 2:
        last = [trial for trial in trials if trial.refused][-1]
        found = f"{len(good)} of {len(trials)} that can be adjusted, two needed"
        raise InputError("candidate spacings", f"{found}; of {last.spacing:g} s: {last.refused}")
    solution = trials[good[0]].solution
    assert solution is not None
    roots = whitening(network, held, solution.places)
    squares = np.stack([0.5 * np.sum(np.einsum("hij,hj->hi", roots, trials[k].misfits) ** 2, axis=1) for k in good])
    judged = np.all(np.isfinite(squares), axis=0)
    if np.count_nonzero(judged) < 2:
        found = f"{np.count_nonzero(judged)} of {judged.size} rays that their points' other rays predict"
        raise InputError("rays held out", found, "two at least", "hold out a smaller share, or match more points")
    robust = np.sqrt(2.0 * np.median(squares[:, judged], axis=1)) / _MEDIAN
    blunder = judged & np.all(np.sqrt(2.0 * squares) > _BLUNDER * robust[:, None], axis=0)
    kept = judged & ~blunder
    of_trial = {k: row[kept] for k, row in zip(good, squares, strict=True)}
    candidates = tuple(_candidate(trial, of_trial.get(k, np.zeros(0))) for k, trial in enumerate(trials))
    blunders, unjudged = int(np.count_nonzero(blunder)), int(np.count_nonzero(~judged))
    return _Judged(candidates, _stretches(trials, held)[kept], blunders, unjudged)


def _candidate(trial: _Trial, squares: Array) -> SpacingCandidate:
    strips = trial.network.passes
    nodes = sum(len(strip.nodes) for strip in strips)
    longest = max(float(np.diff(strip.nodes.times).max()) for strip in strips)
    sigma0 = float("nan") if trial.solution is None else trial.solution.sigma0
    return SpacingCandidate(trial.spacing, nodes, longest, squares, sigma0, trial.refused)


def _stretches(trials: Sequence[_Trial], held: HeldOut) -> Index:
    """(h,) stretch of time of each ray held out: as long as the widest spacing, or shorter: a strip has some."""
    found, first = np.zeros(held.rays.size, dtype=np.int64), 0
    for k, strip in enumerate(trials[-1].network.passes):
        start, stop = strip.nodes.coverage
        count = max(int((stop - start) / float(np.diff(strip.nodes.times).max())), _STRETCHES)
        mine = held.strip == k
        inside = np.floor((held.times[mine] - start) / (stop - start) * count).astype(np.int64)
        found[mine] = first + np.clip(inside, 0, count - 1)
        first += count
    return found


def _choice(network: Network, judged: _Judged, closest: int, whole: Solution) -> Choice:
    candidates = judged.candidates
    good = [k for k, one in enumerate(candidates) if not one.refused]
    best = min(good, key=lambda k: candidates[k].rms)
    worse, errors, rms_errors = (np.full(len(candidates), np.nan) for _ in range(3))
    for k in good:
        one = candidates[k]
        difference = one.squares - candidates[best].squares
        worse[k], errors[k] = float(difference.mean()), error_of_mean(difference, judged.stretch)
        rms_errors[k] = error_of_mean(one.squares, judged.stretch) / (2.0 * one.rms)
    return Choice(
        network=network,
        candidates=candidates,
        stretch=judged.stretch,
        rms_errors=rms_errors,
        worse=worse,
        worse_errors=errors,
        best=best,
        chosen=max(k for k in good if worse[k] <= errors[k]),
        blunders=judged.blunders,
        unjudged=judged.unjudged,
        closest=closest,
        closest_solution=whole,
        scatter=ray_scatter(whole),
    )


def error_of_mean(values: Array, stretch: Index) -> float:
    """Standard error of the mean of values (h,), of which those of one stretch (h,) are not independent."""
    sums = np.bincount(stretch, values - values.mean())
    count = int(np.count_nonzero(np.bincount(stretch)))
    return float(np.sqrt(np.sum(sums**2) * count / max(count - 1, 1)) / values.size)
