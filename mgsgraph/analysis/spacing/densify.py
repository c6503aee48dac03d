"""Closer orientation images where the residuals ask for them.

Every image of a strip hangs on one trajectory, so what its nodes can't follow turns all of its lines at the same time:
residuals show a pattern in time that lines share, of samples (roll), of lines (pitch) and of lines times the place
across (yaw). Each interval between nodes is cut into four parts, and the weighted mean of each pattern in each part is
held against its noise: their squares sum up to chi-square if there is no pattern. Residuals are smaller than the noise
of the rays, as their points follow them: of a point with n rays they have 1 - 3 / (2 n) of its variance, on the
average, and are divided by that, and by how much more rays scatter than is stated for them (`scatter`).

An interval asks for a node in its middle where its sum exceeds what noise explains at the stated level, corrected for
the number of intervals, and where the pattern is large enough to matter. It gets the node if rays support it. Nodes of
Lagrange's polynomials need not be even, but no interval is left more than twice as long as its neighbour: polynomials
through nodes that are less even swing between them. Splines are even, and are halved throughout.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.rounds import Selection
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.spacing.choice import require_respaceable, with_nodes
from mgsgraph.analysis.spacing.rays import ray_scatter
from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation_images import OrientationImages, evenly_spaced
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.network import Network
from mgsgraph.network.support import LEAST, PassRays, pass_rays, require_supported, support_of, useful_rays

_PARTS = 4
"""Parts of an interval in which patterns are averaged."""
_PATTERNS = 3
"""Samples, lines, and lines times the place across."""
_GRADING = 2.0
"""Times its neighbour that an interval may be long."""
_SLACK = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class ResidualPattern:
    """What a strip's residuals show between its nodes."""

    squares: Array
    """(k - 1,) of each interval, chi-square if all is noise."""
    freedom: Index
    """(k - 1,) its degrees of freedom: means that there are."""
    size: Array
    """(k - 1,) rms of the pattern beyond its noise, in sigmas of a ray as it scatters."""

    def asking(self, level: float, worth: float, intervals: int) -> Mask:
        """(k - 1,) intervals whose pattern is none of noise, at a level for all `intervals` of a network together, and
        of `worth` sigmas of a ray at least.
        """
        from scipy.stats import chi2  # slow to import

        limit = np.where(self.freedom > 0, chi2.isf(level / intervals, np.maximum(self.freedom, 1)), np.inf)
        return np.asarray((self.squares > limit) & (self.size >= worth))


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """One adjustment, and what its residuals asked for."""

    nodes: tuple[int, ...]
    """Of each strip."""
    sigma0: float
    """Of the adjustment."""
    asked: tuple[int, ...]
    """Intervals of each strip that asked for another node."""
    granted: tuple[int, ...]
    """Nodes that each strip got."""
    refused: tuple[int, ...]
    """Intervals of each strip that asked for a node which the rays don't support."""
    factor: float
    """Times their stated sigmas that rays scatter."""


@dataclass(frozen=True, slots=True, eq=False)
class Densified:
    """A network whose nodes follow what the residuals asked for."""

    solution: Solution
    """Of its last adjustment."""
    rounds: tuple[Round, ...]
    """One after the other."""
    message: str
    """Why it came to an end."""

    @property
    def network(self) -> Network:
        """With its nodes."""
        return self.solution.network


def densify(
    network: Network,
    settings: SolverSettings,
    level: float = 0.01,
    worth: float = 0.1,
    least: int = LEAST,
    most: int = 6,
    left_in: Selection | None = None,
) -> Densified:
    """Adjust a network, give it nodes where residuals ask for them, and again, until none asks or none can be given.

    Parameters
    ----------
    network : Network
        With strips of few nodes.
    level : float
        Share of networks without any pattern in which an interval asks all the same.
    worth : float
        Sigmas of a ray, rms; smaller patterns don't ask, however sure.
    least : int
        Rays that each node needs near it.
    most : int
        Adjustments at the most.
    left_in : Selection, optional
        Rays and ranges that take part; all when absent. Not together with a blunder limit.
    """
    require_respaceable(network)
    for name, value, high in (("level", level, 0.5), ("worth", worth, math.inf)):
        if not 0.0 < value < high:
            raise InputError(f"densification, {name}", f"{value}", f"more than 0 and less than {high:g}")
    require_supported(network, least, None if left_in is None else left_in.rays)
    rounds = list[Round]()
    while True:
        solution = adjust_network(network, settings, f"round {len(rounds) + 1}", left_in=left_in)
        closer, this = _closer(solution, level, worth, least)
        rounds.append(this)
        if not sum(this.asked):
            return Densified(solution, tuple(rounds), "No interval's residuals ask for another node.")
        if not sum(this.granted):
            return Densified(solution, tuple(rounds), "The rays don't support the nodes that residuals still ask for.")
        if len(rounds) == most:
            message = f"Stopped after {most} adjustments; residuals still ask for nodes."
            return Densified(solution, tuple(rounds), message)
        network = with_nodes(network, closer)


def _closer(solution: Solution, level: float, worth: float, least: int) -> tuple[list[OrientationImages], Round]:
    """Nodes of each strip for the next adjustment, and the round that asked for them."""
    strips = solution.network.passes
    total, factor = sum(len(strip.nodes) - 1 for strip in strips), ray_scatter(solution).factor
    nodes, asked, refused = list[OrientationImages](), list[int](), list[int]()
    for k, strip in enumerate(strips):
        asking = pattern(solution, k, factor).asking(level, worth, total)
        rays = useful_rays(solution.network, k, solution.rays_used)

        def supported(other: OrientationImages, rays: PassRays = rays) -> Mask:
            return ~support_of(other, rays, least).weak

        closer, denied = halved(strip.nodes, asking, supported)
        nodes.append(closer)
        asked.append(int(np.count_nonzero(asking)))
        refused.append(denied)
    counts = tuple(len(strip.nodes) for strip in strips)
    granted = tuple(len(other) - count for other, count in zip(nodes, counts, strict=True))
    return nodes, Round(counts, solution.sigma0, tuple(asked), granted, tuple(refused), factor)


def halved(
    nodes: OrientationImages, asking: Mask, supported: Callable[[OrientationImages], Mask]
) -> tuple[OrientationImages, int]:
    """Nodes with one more in the middle of each asking interval (k - 1,) where all nodes are supported then, and how
    many intervals were refused theirs; a spline gets all or none.
    """
    if not np.any(asking):
        return nodes, 0
    if nodes.basis == "spline":
        finer = evenly_spaced("spline", nodes.epoch, nodes.coverage, 0.5 * float(np.diff(nodes.times).mean()))
        good = bool(np.all(supported(finer)))
        return (finer, 0) if good else (nodes, int(np.count_nonzero(asking)))
    wanted, refused = asking.copy(), 0
    while np.any(wanted):
        finer = nodes.with_nodes_at(_graded(nodes.times, wanted))
        weak = finer.times[~supported(finer)]
        if weak.size == 0:
            return finer, refused
        # the intervals next to a weak node give theirs up; neighbours that only follow have none to give
        near = np.zeros_like(wanted)
        for time in weak.tolist():
            inside = int(np.clip(np.searchsorted(nodes.times, time) - 1, 0, wanted.size - 1))
            near[max(inside - 1, 0) : inside + 2] = True
        given_up = wanted & near if np.any(wanted & near) else wanted
        refused += int(np.count_nonzero(given_up))
        wanted &= ~given_up
    return nodes, refused


def _graded(times: Array, halve: Mask) -> Array:
    """Times with the middles of intervals to be halved, and of those that are too long beside them then."""
    while np.any(halve):
        times = np.sort(np.concatenate([times, 0.5 * (times[:-1] + times[1:])[halve]]))
        steps = np.diff(times)
        beside = np.minimum(np.append(np.inf, steps[:-1]), np.append(steps[1:], np.inf))
        halve = steps > _GRADING * (1.0 + _SLACK) * beside
    return times


def pattern(solution: Solution, strip: str | int, factor: float | None = None) -> ResidualPattern:
    """What the residuals of a strip's rays show between its nodes.

    Parameters
    ----------
    factor : float, optional
        Times their stated sigmas that rays scatter; taken from the solution's residuals when absent.
    """
    factor = ray_scatter(solution).factor if factor is None else factor
    network, strip = solution.network, solution.network.pass_number(strip)
    nodes = network.passes[strip].nodes
    mine = pass_rays(network, strip)
    mine = mine.only(solution.rays_used[mine.rays] & np.isfinite(solution.residuals[mine.rays]).all(axis=1))
    images = network.pictures(strip)
    angle = np.array([image.pixel_angle for image in images])[mine.line]
    width = np.array([float(image.samples) for image in images])[mine.line]
    counts = np.bincount(network.rays.point, solution.rays_used, len(network.points))[network.rays.point[mine.rays]]
    scatter = factor * network.rays.sigmas[mine.rays]
    sigmas = scatter * angle[:, None]
    redundancy = 1.0 - 1.5 / np.maximum(counts, 2)
    residuals = solution.residuals[mine.rays] / scatter / np.sqrt(redundancy)[:, None]
    across = 2.0 * network.rays.places[mine.rays, 1] / width - 1.0
    # whitened residuals of each pattern, and the whitened size that an angle of 1 rad has in them
    shapes = (
        (residuals[:, 1], 1.0 / sigmas[:, 1]),
        (residuals[:, 0], 1.0 / sigmas[:, 0]),
        (residuals[:, 0], across / sigmas[:, 0]),
    )
    knots = nodes.times
    interval = np.clip(np.searchsorted(knots, mine.times, side="right") - 1, 0, knots.size - 2)
    inside = (mine.times - knots[interval]) / np.diff(knots)[interval]
    part = _PARTS * interval + np.clip((_PARTS * inside).astype(np.int64), 0, _PARTS - 1)
    squares, freedom = np.zeros(knots.size - 1), np.zeros(knots.size - 1, dtype=np.int64)
    for white, slope in shapes:
        top = np.bincount(part, slope * white, _PARTS * squares.size)
        below = np.bincount(part, slope**2, _PARTS * squares.size)
        squares += np.divide(top**2, below, out=np.zeros_like(top), where=below > 0.0).reshape(-1, _PARTS).sum(axis=1)
        freedom += np.count_nonzero(below.reshape(-1, _PARTS) > 0.0, axis=1)
    rays = np.bincount(interval, minlength=squares.size)
    size = np.sqrt(np.maximum(squares - freedom, 0.0) / np.maximum(_PATTERNS * rays, 1))
    return ResidualPattern(squares, freedom, size)
