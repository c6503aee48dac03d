"""Candidate spacings of orientation images, judged by how well each predicts rays that it has not seen.

All candidates are fitted to the same rays and predict the same ones. They are judged by differences ray by ray, so the
noise of a ray, common to all of them, cancels. Blunders are sought once, if at all, with the closest nodes that the
rays support: wider nodes would mark as blunders what they can't follow. Rays near in time share the error of the
orientation there and are not independent; standard errors are those of sums over stretches of time. Of all spacings
that are not worse than the best one by more than one standard error of the difference, the coarsest is chosen (the rule
of one standard error, Breiman et al. 1984): it predicts as well, with fewer unknowns.

*Held out* is one ray of a point that other rays determine. Its misfit, measured minus predicted, is divided by what it
would scatter were the orientation known: the ray's own noise, and that of the point as its other rays determine it.
These numbers are the same for all candidates, whatever nodes they have. The covariance of the orientation stays out on
purpose: it grows with the number of nodes, and dividing by it would reward uncertain candidates. So a misfit of
1 is noise, and any excess comes from the orientation.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.rounds import Selection, unmarked
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.errors import InputError, SolverError, WeakNetwork, require
from mgsgraph.geometry.orientation import OrientationImages, evenly_spaced
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.kernel.sweep import point_covariances
from mgsgraph.network import Network, NodePrior
from mgsgraph.network.corrections import LEAST, pass_rays, require_supported
from mgsgraph.workers import no_progress

_STRETCHES = 10
"""Stretches of time that a pass has at least, whose sums count as independent."""
_BLUNDER = 6.0
"""Robust standard deviations beyond which a ray held out is a blunder, if it is so for every candidate."""
_RAYS = 3
"""Of a point of which one may be held out."""
_MEDIAN = 1.1774100225154747
"""Median norm of two standard normal numbers."""


def respaced(network: Network, spacing: float) -> Network:
    """A network whose passes all have even nodes at a spacing of at most `spacing` s, over the same time."""
    return with_nodes(
        network,
        [
            evenly_spaced(pass_.nodes.basis, pass_.nodes.epoch, pass_.nodes.coverage, spacing)
            for pass_ in network.passes
        ],
    )


def with_nodes(network: Network, nodes: Sequence[OrientationImages]) -> Network:
    """A network with other nodes of its passes, in their order; the priors stay, which know any nodes."""
    require_respaceable(network)
    passes = (replace(pass_, nodes=respaced_nodes) for pass_, respaced_nodes in zip(network.passes, nodes, strict=True))
    return replace(network, passes=tuple(passes))


def require_respaceable(network: Network) -> None:
    """Raise InputError unless there are passes, and priors that hold for any nodes."""
    require(network.passes, "network", "no passes", "images whose orientation follows from orientation images")
    for pass_ in network.passes:
        if not isinstance(pass_.prior, NodePrior):
            found = "a joint prior of just its nodes"
            raise InputError(f"pass {pass_.name!r}", found, "one of any nodes (bias, drift and sigmas)")


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Which rays are held out."""

    rays: Index
    """(h,) of the network, of different points, ascending."""
    pass_number: Index
    """(h,) pass of each."""
    times: Array
    """(h,) s past the epoch of that pass's nodes."""

    def rays_left(self, network: Network) -> Mask:
        """(rays,) those that take part: neither held out nor marked as blunders."""
        taken = unmarked(network).rays
        taken[self.rays] = False
        return taken

    def left_in(self, network: Network) -> Selection:
        """What takes part in an adjustment."""
        return replace(unmarked(network), rays=self.rays_left(network))


def hold_out(network: Network, share: float, rng: np.random.Generator) -> HeldOut:
    """Draw rays to hold out.

    Parameters
    ----------
    network : Network
        With passes.
    share : float
        Of the points with three rays or more; of each of them one ray, of a pass's image, is held out.
    """
    if not (np.isfinite(share) and 0.0 < share <= 1.0):
        raise InputError("rays held out", f"a share of {share}", "more than 0, and 1 at the most")
    good, in_pass = unmarked(network).rays, network.pass_of[network.rays.image] >= 0
    counts = np.bincount(network.rays.point, good, len(network.points))
    able = np.flatnonzero(good & in_pass & (counts[network.rays.point] >= _RAYS))
    shuffled = rng.permutation(able)
    points, first = np.unique(network.rays.point[shuffled], return_index=True)
    number = round(share * points.size)
    if number < 2:
        found = f"{points.size} points with {_RAYS} rays or more, of which {number} would be held out"
        raise InputError("rays held out", found, "two at least", "hold out a larger share, or match more points")
    rays = np.sort(shuffled[rng.choice(first, number, replace=False)])
    times, pass_number = np.empty(rays.size), network.pass_of[network.rays.image[rays]]
    for k in np.unique(pass_number).tolist():
        of_pass = pass_rays(network, k)
        times[pass_number == k] = of_pass.times[np.searchsorted(of_pass.rays, rays[pass_number == k])]
    return HeldOut(rays, pass_number, times)


def misfits(solution: Solution, held: HeldOut) -> tuple[Array, Array]:
    """(h, 2) px, measured minus predicted line and sample of rays held out, their points where the solution's other
    rays place them, and (h, 2, 3) px per m, how these follow their points; NaN where none places them, or sees them.
    """
    network = solution.network
    misfits_of, slopes = np.full((held.rays.size, 2), np.nan), np.full((held.rays.size, 2, 3), np.nan)
    points, images = network.rays.point[held.rays], network.rays.image[held.rays]
    for j in np.unique(images).tolist():
        of_image = np.flatnonzero((images == j) & solution.determined[points])
        measured = network.rays.places[held.rays[of_image]]
        predicted, slopes[of_image] = solution.image(j).ground_to_image(
            solution.places[points[of_image]], solution.correction(j), start=measured[:, 0]
        )
        misfits_of[of_image] = measured - predicted
    return misfits_of, slopes


def whitening(solution: Solution, held: HeldOut) -> Array:
    """(h, 2, 2) per px, inverse roots of the covariances that misfits have when orientation is known; NaN where the
    other rays of a point place it nowhere.
    """
    at, network, points = at_solution(solution), solution.network, solution.network.rays.point[held.rays]
    layout, fixed = at.layout, np.zeros_like(at.pair_blocks(at.layout))
    covariances = point_covariances(
        at.rows, layout.groups, layout.blocks.target, layout.model, at.orientation, fixed, at.points
    )  # fmt: skip
    _, slopes = misfits(solution, held)
    spread = slopes @ layout.network_order(covariances)[points] @ slopes.mT
    spread[:, [0, 1], [0, 1]] += network.rays.sigmas[held.rays] ** 2
    roots = np.full_like(spread, np.nan)
    good = np.isfinite(spread).all(axis=(1, 2))
    roots[good] = np.linalg.inv(np.linalg.cholesky(spread[good]))
    return roots


@dataclass(frozen=True, slots=True, eq=False)
class SpacingCandidate:
    """One spacing and its predictions."""

    spacing: float
    """s, as asked for."""
    nodes: int
    """Of all passes."""
    longest: float
    """s, the longest interval that there is."""
    squared_errors: Array
    """(h,) half the squared norm of each whitened misfit: 1 on the average if all is noise; empty when refused."""
    sigma0: float
    """Of the adjustment without these rays."""
    refused: str = ""
    """Reason why there is no adjustment; empty where there is one."""

    @property
    def rms(self) -> float:
        """Root mean square of the whitened misfits; 1 is noise."""
        return float(np.sqrt(self.squared_errors.mean())) if self.squared_errors.size else float("nan")


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
    rejected: int
    """Rays that took part with no candidate, as blunders of the adjustment of all rays with its nodes."""

    @property
    def spacing(self) -> float:
        """s, what is chosen."""
        return self.candidates[self.chosen].spacing


def choose_spacing(
    network: Network,
    settings: SolverSettings,
    spacings: Sequence[float],
    share: float = 0.2,
    seed: int = 0,
    progress: Callable[[int, int], None] = no_progress,
) -> Choice:
    """Adjust a network with each spacing of its passes' nodes, and judge them by rays held out.

    Parameters
    ----------
    network : Network
        With passes; rays and ranges that it marks as rejected take no part, or with a blunder limit are judged anew.
    settings : SolverSettings
        A blunder limit holds in one adjustment of all rays, with the closest nodes; what that rejects takes part with
        no candidate, so that all see the same rays.
    spacings : sequence of float
        s, candidates; two at least that differ in their nodes.
    share : float
        Of the points with three rays or more, of each of which one ray is held out.
    seed : int
        Of the draw of these rays.
    progress : callable
        Called with the number of adjustments done, and of all: one with all rays, and one of each candidate.

    Raises
    ------
    InputError
        Where there is nothing to choose from, or nothing to judge by.
    """
    require_respaceable(network)
    tried, clean, rejected = _distinct(network, spacings), network, None
    progress(0, len(tried) + 1)
    if settings.reject > 0.0:
        solved = _closest(tried, settings)
        clean, rejected = network.with_rejected(solved.rays_rejected, solved.ranges_rejected), solved.rays_rejected
    held = hold_out(clean, share, np.random.default_rng(seed))
    trials, plain = list[_Trial](), replace(settings, reject=0.0)
    for done, (spacing, candidate) in enumerate(tried):
        progress(done + 1, len(tried) + 1)
        trials.append(_trial(spacing, replace(clean, passes=candidate.passes), plain, held))
    progress(len(tried) + 1, len(tried) + 1)
    return _choice(network, trials, held, 0 if rejected is None else int(np.count_nonzero(rejected)))


def _closest(tried: Sequence[tuple[float, Network]], settings: SolverSettings) -> Solution:
    """The adjustment of all rays with the closest spacing that they support."""
    reason = ""
    for spacing, candidate in tried:
        try:
            require_supported(candidate, LEAST)
            return adjust_network(candidate, settings, f"nodes every {spacing:g} s")
        except (InputError, WeakNetwork, SolverError) as error:
            reason = f"0 of {len(tried)} that can be adjusted, two needed; of {spacing:g} s: {error}"
    raise InputError("candidate spacings", reason)


class _Trial(NamedTuple):
    """A spacing that was tried."""

    spacing: float
    network: Network
    solution: Solution | None
    misfits: Array
    """(h, 2) px; NaN where there is no prediction."""
    refused: str


def _distinct(network: Network, spacings: Sequence[float]) -> list[tuple[float, Network]]:
    """Spacings, ascending, and the networks with them; of those with the same nodes, as wide ones in short passes have
    them, the first.
    """
    candidates = dict[tuple[int, ...], tuple[float, Network]]()
    for spacing in sorted(set(spacings)):
        network_at = respaced(network, spacing)
        candidates.setdefault(tuple(len(pass_.nodes) for pass_ in network_at.passes), (spacing, network_at))
    if len(candidates) < 2:
        asked = ", ".join(f"{spacing:g}" for spacing in spacings) or "none"
        expected = "two or more that differ in their nodes (a pass has four at least)"
        raise InputError("candidate spacings", f"{asked} s", expected)
    return list(candidates.values())


def _trial(spacing: float, network: Network, settings: SolverSettings, held: HeldOut) -> _Trial:
    try:
        require_supported(network, LEAST, held.rays_left(network))
        solution = adjust_network(network, settings, f"nodes every {spacing:g} s", left_in=held.left_in(network))
    except (InputError, WeakNetwork, SolverError) as error:
        return _Trial(spacing, network, None, np.zeros((0, 2)), str(error))
    return _Trial(spacing, network, solution, misfits(solution, held)[0], "")


def _choice(network: Network, trials: Sequence[_Trial], held: HeldOut, rejected: int) -> Choice:
    solved = {k: trial.solution for k, trial in enumerate(trials) if trial.solution is not None}
    good = list(solved)
    if len(good) < 2:
        last = [trial for trial in trials if trial.refused][-1]
        found = f"{len(good)} of {len(trials)} that can be adjusted, two needed"
        raise InputError("candidate spacings", f"{found}; of {last.spacing:g} s: {last.refused}")
    roots = whitening(solved[good[0]], held)
    squared = np.stack([0.5 * np.sum(np.einsum("hij,hj->hi", roots, trials[k].misfits) ** 2, axis=1) for k in good])
    judged = np.all(np.isfinite(squared), axis=0)
    if np.count_nonzero(judged) < 2:
        found = f"{np.count_nonzero(judged)} of {judged.size} rays that their points' other rays predict"
        raise InputError("rays held out", found, "two at least", "hold out a smaller share, or match more points")
    robust = np.sqrt(2.0 * np.median(squared[:, judged], axis=1)) / _MEDIAN
    blunder = judged & np.all(np.sqrt(2.0 * squared) > _BLUNDER * robust[:, None], axis=0)
    used = judged & ~blunder
    of_trial = {k: row[used] for k, row in zip(good, squared, strict=True)}
    candidates = tuple(_candidate(trial, of_trial.get(k, np.zeros(0))) for k, trial in enumerate(trials))
    best, stretch = min(good, key=lambda k: candidates[k].rms), _stretches(trials, held)[used]
    worse, errors, rms_errors = (np.full(len(candidates), np.nan) for _ in range(3))
    for k in good:
        difference = of_trial[k] - of_trial[best]
        worse[k], errors[k] = float(difference.mean()), error_of_mean(difference, stretch)
        rms_errors[k] = error_of_mean(of_trial[k], stretch) / (2.0 * candidates[k].rms)
    return Choice(
        network, candidates, stretch, rms_errors, worse, errors, best, max(k for k in good if worse[k] <= errors[k]),
        int(np.count_nonzero(blunder)), int(np.count_nonzero(~judged)), rejected,
    )  # fmt: skip


def _candidate(trial: _Trial, squared: Array) -> SpacingCandidate:
    passes = trial.network.passes
    nodes = sum(len(pass_.nodes) for pass_ in passes)
    longest = max(float(np.diff(pass_.nodes.times).max()) for pass_ in passes)
    sigma0 = float("nan") if trial.solution is None else trial.solution.sigma0
    return SpacingCandidate(trial.spacing, nodes, longest, squared, sigma0, trial.refused)


def _stretches(trials: Sequence[_Trial], held: HeldOut) -> Index:
    """(h,) stretch of time of each ray held out: as long as the widest spacing, or shorter: a pass has some."""
    stretches, first = np.zeros(held.rays.size, dtype=np.int64), 0
    for k, pass_ in enumerate(trials[-1].network.passes):
        start, stop = pass_.nodes.coverage
        count = max(int((stop - start) / float(np.diff(pass_.nodes.times).max())), _STRETCHES)
        of_pass = held.pass_number == k
        inside = np.floor((held.times[of_pass] - start) / (stop - start) * count).astype(np.int64)
        stretches[of_pass] = first + np.clip(inside, 0, count - 1)
        first += count
    return stretches


def error_of_mean(values: Array, stretch: Index) -> float:
    """Standard error of the mean of values (h,), of which those of one stretch (h,) are not independent."""
    sums = np.bincount(stretch, values - values.mean())
    count = int(np.count_nonzero(np.bincount(stretch)))
    return float(np.sqrt(np.sum(sums**2) * count / max(count - 1, 1)) / values.size)
