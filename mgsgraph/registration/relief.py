"""Registration by relief: the adjustment aligns laser profiles with the surface that the images show.

Ties make images agree with one another, ranges fix heights; nothing of that holds a footprint horizontally. Relief
does: the images are matched densely with their adjusted orientation, the disparities are averaged over the footprint
(`geometry.stereo_surface`), each profile is searched over shifts (`search`), and the network is adjusted again with one
row more per shot: its height above the surface, which moves with the orientation; and one where two profiles cross
(`geometry.altimetry`). What the profile's shift, the images' orientation and the shots' own places contribute, their
covariances decide.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.graph.variables import footprint_shifts
from mgsgraph.adjustment.settings import Iteration, SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.statistics import local_sigmas
from mgsgraph.case.case_file import decode
from mgsgraph.case.reading import Case
from mgsgraph.case.scene import picture_file
from mgsgraph.compiled import in_threads
from mgsgraph.errors import InputError, errors_from, require
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.records import Array, Index, sigmas_of
from mgsgraph.geometry.stereo_surface import SurfaceHeights, heights_above
from mgsgraph.names import image_names
from mgsgraph.network import TERRAIN, Network, PointClass
from mgsgraph.network.observations import with_posts
from mgsgraph.network.records import Crossovers, StereoControl, crossovers
from mgsgraph.registration.minima import (
    CostSurface,
    ProfileState,
    ReliefProfile,
    ReliefRegistration,
    ReliefSettings,
    correlated_shots,
)
from mgsgraph.registration.relief_surfaces import AveragedPair, Cells, cells_of, stereo_surfaces
from mgsgraph.registration.search import Expected, StereoPair, search
from mgsgraph.text import some
from mgsgraph.workers import Progress, no_progress

_LEAST_SHOTS = 12
"""On the surface, that make a profile one that can be registered."""
_ROUGH = 0.2
"""Share of the ground's roughness within a footprint by which its means differ, of a laser's light and of matches: 0.17
at Gusev, simulated with seed 1."""
_MOST_ROUNDS = 6
"""Of search and adjustment: heights and tilts that the first round corrects have shown the next one another surface."""
_NEAR = 5.0
"""m, by which a best shift may differ from zero and be none, however well it is known."""
_LIKELY = 0.01
"""Weight from which on a minimum counts as one where the profile may be."""


class _Placed(NamedTuple):
    """Where shots and posts of a network are."""

    lifted: Array
    """(n, 3) m, by the heights of their profiles, and boresights."""
    shifts: Array
    """(p, 2) m east and north, of the profiles."""
    sigma: float
    """m, east and north, of what the images show, by an adjustment without stereo rows."""


def _with_cells(before: Solution, cells: Sequence[Cells]) -> tuple[Network, _Placed]:
    """The network with posts, without tie points on the same models; where the shots are by a solution without posts,
    and the posts where it has the model.
    """
    network, considered = with_posts(before.network, cells), before.network.considered
    places = before.network.points.places + footprint_shifts(before.network, before.shared)
    shifts, surface = before.shifts[: len(profile_names(before.network))], before.network.surface
    for model, posts in cells:
        places, shift = np.concatenate([places, posts.points]), np.zeros(2)
        if surface is not None and model.lattice.source == surface.grid.source:
            considered = tuple(model.name if name == TERRAIN else name for name in considered)
            network, shift = replace(network, surface=None, considered=considered), before.shifts[-1]
        shifts = np.concatenate([shifts, shift[None]])
    return network, _Placed(places, shifts, _horizontal_sigma(before))


def _begin(network: Network, before: Solution, placed: _Placed) -> Sequence[Array]:
    """Value of each variable of the network with posts, as it is without them; zero where there was none."""
    values, n, k = before.values, len(before.coefficients), len(before.shared)
    shifts = [*placed.shifts, *before.shift_values[-1:]] if network.surface is not None else [*placed.shifts]
    new = [np.zeros(unknown.kind.width) for unknown in network.shared[k:]]
    return [*values[:n], *shifts, *before.shared, *new, *values[n + len(before.shift_values) + k :]]


def _horizontal_sigma(solution: Solution) -> float:
    """m, east and north, of most tie points."""
    ties = solution.members(PointClass.TIE)
    spreads = local_sigmas(solution.covariances[ties], solution.places[ties])[:, :2]
    return float(np.sqrt(np.median(np.mean(spreads**2, axis=1))))


def register_by_relief(
    case: Case,
    settings: ReliefSettings | None = None,
    solver: SolverSettings | None = None,
    before: Solution | None = None,
    workers: int | None = None,
    progress: Progress = no_progress,
) -> ReliefRegistration:
    """Register the laser profiles of a case with the surface that its images show.

    Parameters
    ----------
    case : Case
        With pixels, and with laser profiles whose shifts are unknown (`shift_sigma_m`).
    settings : ReliefSettings, optional
        Choices.
    solver : SolverSettings, optional
        Of both adjustments; the case's when absent.
    before : Solution, optional
        Adjustment of the case without stereo rows; made here when absent.
    workers : int, optional
        Threads that match; one per processor when absent.
    progress : callable
        Called with the stage, and how much of it is done.

    Raises
    ------
    InputError
        Where there are no profiles, no pixels, no overlap, or no profile has shots enough on the surface.

    Examples
    --------
    >>> registration = mgsgraph.register_by_relief(relief, mgsgraph.ReliefSettings(reach=600.0), before=before)
    >>> [profile.name for profile in registration.profiles]
    ['ap18933l', 'ap19043l']
    >>> registration.solution.converged
    True
    """
    settings, solver = settings or ReliefSettings(), solver or case.settings
    _require_profiles(case)
    _require_pictures(case, settings)
    if before is not None:
        _require_same(case, before)
    before = before or adjust_network(case.network, solver, case.name, _counted(progress, "adjustment", solver))
    posterior = Posterior.of(before)
    footprints = [settings.footprint or case.footprints[name] for name in profile_names(before.network)]
    cells = cells_of(case.terrain, posterior, settings) if settings.terrain == "cells" else ()
    surfaces = stereo_surfaces(case.path, posterior, footprints, cells, settings, workers, progress)
    return registered(before, footprints, cells, surfaces, settings, solver, progress)


def registered(
    before: Solution,
    footprints: Sequence[float],
    cells: Sequence[Cells],
    surfaces: Sequence[AveragedPair],
    settings: ReliefSettings,
    solver: SolverSettings,
    progress: Progress = no_progress,
) -> ReliefRegistration:
    """Register laser profiles and terrain models with given surfaces.

    Parameters
    ----------
    before : Solution
        Without stereo rows.
    footprints : sequence of float
        m, diameter of the spots of each laser profile of its network.
    cells : sequence of (TerrainModel, Posts)
        Terrain models whose posts are to lie on the surfaces; tie points that lay on the surface of those of one of
        them no longer do.
    surfaces : sequence of AveragedPair
        Averaged over each of these footprints and over those of the posts.
    settings, solver, progress
        As of `register_by_relief`.
    """
    network, placed = _with_cells(before, cells)
    footprints = [*footprints, *(posts.footprint for _, posts in cells)]
    first = _searched(network, surfaces, Posterior.of(before), placed, footprints, settings.reach, progress)
    left, begin = first, _begin(network, before, placed)
    unreached = [False] * len(footprints)
    for number in range(1, _MOST_ROUNDS + 2):
        previous = left
        control = _control(network, surfaces, previous)
        counted = _counted(progress, "adjustment with stereo rows", solver)
        crossing = _crossing(network, placed, previous) if settings.crossovers else None
        anew = replace(network, stereo=control, crossovers=crossing)
        solution = adjust_network(anew, solver, before.name, counted, begin=begin)
        begin = solution.values
        lifted = network.points.places + footprint_shifts(network, solution.shared)
        placed = placed._replace(lifted=lifted, shifts=solution.shifts)
        left = _searched(network, surfaces, Posterior.of(solution), placed, footprints, settings.reach, progress)
        converged = [new.converged(old) for old, new in zip(previous, left, strict=True)]
        if number == _MOST_ROUNDS:  # what has not converged is adjusted once more, as level ground
            unreached = [not done for done in converged]
        left = [profile.unreached if never else profile for profile, never in zip(left, unreached, strict=True)]
        if all(converged):
            break
    profiles = tuple(
        ReliefProfile(
            old.cost.name, PointClass(network.points.classes[old.members[0]]), old.members,
            solution.stereo_used[old.members], control.sigmas[old.members],
            ProfileState(old.points, old.above, old.cost), ProfileState(after.points, after.above, after.cost),
            solution.shifts[p], solution.shift_covariance(p),
        )
        for p, (old, after) in enumerate(zip(first, left, strict=True))
    )  # fmt: skip
    return ReliefRegistration(before.name, settings, before, solution, profiles)


def profile_names(network: Network) -> tuple[str, ...]:
    """Laser profiles with a shift of their own."""
    return network.shifts.names if network.shifts is not None else ()


def _require_profiles(case: Case) -> None:
    if not profile_names(case.network) and not case.terrain:
        raise InputError(
            str(case.path), "neither a laser profile nor a terrain model whose shift is unknown",
            "[[shots]] entries with shift_sigma_m, [[altimetry]], or [terrain]",
            "state what is known of the profile's horizontal error, such as shift_sigma_m = 100.0",
        )  # fmt: skip


def _require_pictures(case: Case, settings: ReliefSettings) -> None:
    """Raise InputError unless a case has the necessary images and pixels; called before long work."""
    names = case.network.image_names
    with errors_from(str(case.path)):
        image_names(settings.images, names)
    require(len(names) >= 2, str(case.path), "one image", "two that overlap, at least")
    tables = decode(case.path)
    for j in range(len(tables.images)):
        picture_file(tables, j, case.path)


def _require_same(case: Case, before: Solution) -> None:
    """Raise InputError unless a solution has the images and the profiles of a case."""
    networks = case.network, before.network
    for what, (wanted, found) in (
        ("images", [network.image_names for network in networks]),
        ("laser profiles of unknown shift", [list(profile_names(network)) for network in networks]),
    ):
        if wanted != found:
            raise InputError(
                f"solution {before.name!r}", f"other {what} ({some(found) or 'none'})",
                f"those of the case ({some(wanted)})", "adjust the case again, or give the case itself",
            )  # fmt: skip


def _counted(progress: Progress, what: str, solver: SolverSettings) -> Callable[[Iteration], None]:
    """A callback of the adjustment that counts its iterations."""
    done = count(1)

    def show(_: Iteration) -> None:
        progress(what, min(next(done), solver.max_iterations), solver.max_iterations)

    return show


@dataclass(frozen=True, slots=True, eq=False)
class _SearchedProfile:
    """A profile as the search leaves it; n shots."""

    members: Index
    """(n,) its points in the network."""
    surface: int
    """On which it lies."""
    points: Array
    """(n, 3) m, where the adjustment has put its shots."""
    above: SurfaceHeights
    """There."""
    cost: CostSurface
    """Over shifts from there."""
    starts: Array
    """(n, 3) m, after the best shift; the same points where relief doesn't tie the profile."""
    moved: SurfaceHeights
    """There."""

    @property
    def unreached(self) -> "_SearchedProfile":
        """The same, with the best shift marked as not reached by the adjustment."""
        return replace(self, cost=replace(self.cost, reached=False), starts=self.points, moved=self.above)

    def converged(self, before: "_SearchedProfile") -> bool:
        """Whether the profile fits where it is, or relief ties it as little as it did `before` the last adjustment."""
        if not self.cost.clear:
            return not before.cost.clear and len(self.cost.possible) == len(before.cost.possible)
        if not before.cost.clear:
            return False
        near = [
            np.all(np.abs(minimum.shift) <= np.maximum(3.0 * sigmas_of(minimum.covariance), _NEAR))
            for minimum in self.cost.minima
            if minimum.weight > _LIKELY
        ]
        return any(near)


def _searched(
    network: Network,
    surfaces: Sequence[AveragedPair],
    posterior: Posterior,
    placed: _Placed,
    footprints: Sequence[float],
    reach: float,
    progress: Progress,
) -> list[_SearchedProfile]:
    """All profiles, from where their shots and posts are."""
    oriented = [pair.oriented(posterior) for pair in surfaces]

    def one_profile(p: int) -> _SearchedProfile:
        usable = [k for k, pair in enumerate(surfaces) if pair.footprint == footprints[p]]
        return _search_profile(network, oriented, usable, placed, p, reach)

    progress("search", 0, len(footprints))
    return in_threads(one_profile, range(len(footprints)), done=lambda p: progress("search", p, len(footprints)))


def _search_profile(
    network: Network,
    oriented: Sequence[StereoPair],
    usable: Sequence[int],
    placed: _Placed,
    p: int,
    reach: float,
) -> _SearchedProfile:
    """One profile on the surface, of those `usable`, that has most of its shots."""
    assert network.shifts is not None
    members = np.flatnonzero(network.shifts.profile == p)
    given = network.points.places[members]
    ways, sigmas = east_north(given), local_sigmas(network.points.covariances[members], given)[:, 2]
    points = placed.lifted[members] + np.einsum("k,nkj->nj", placed.shifts[p], ways)
    expected = None
    if network.points.classes[members[0]] == PointClass.POST:
        expected = Expected(-placed.shifts[p], float(np.hypot(network.shifts.sigmas[p], placed.sigma)))
    name = network.shifts.names[p]
    costs = [search(oriented[k], points, sigmas, name, reach, expected) for k in usable]
    best = int(np.argmax([cost.shots for cost in costs]))
    pair, cost = oriented[usable[best]], costs[best]
    starts = points + np.einsum("nk,nkj->nj", cost.best(members.size), ways) if cost.clear else points
    above, moved = (heights_above(pair.surface, *pair.images, places, pair.corrections) for places in (points, starts))
    return _SearchedProfile(members, usable[best], points, above, cost, starts, moved)


def _crossing(network: Network, placed: _Placed, searched: Sequence[_SearchedProfile]) -> Crossovers | None:
    """Crossovers of the laser profiles, at the positions found by the search."""
    assert network.shifts is not None
    moved, clear = placed.shifts[: len(searched)].copy(), np.array([profile.cost.clear for profile in searched])
    for p in np.flatnonzero(clear).tolist():
        moved[p] += searched[p].cost.best(searched[p].members.size).mean(axis=0)
    sigmas, shots = np.full(len(network.points), np.nan), network.shifts.profile >= 0
    sigmas[shots] = local_sigmas(network.points.covariances[shots], network.points.places[shots])[:, 2]
    return crossovers(network.points, network.shifts, moved, sigmas, ~clear)


def _control(network: Network, surfaces: Sequence[AveragedPair], profiles: Sequence[_SearchedProfile]) -> StereoControl:
    """Shots on the surfaces of all profiles that have enough there."""
    n = len(network.points)
    surface, sigmas, starts = np.full(n, -1, dtype=np.int64), np.full(n, np.inf), np.full((n, 3), np.nan)
    level = np.zeros(n, dtype=bool)
    for p in profiles:
        on = p.moved.covered
        if int(on.sum()) < _LEAST_SHOTS:
            continue
        post = network.points.classes[p.members[0]] == PointClass.POST
        # a post is the mean of its cell: how rough the ground is within makes it no less certain
        rough = np.zeros(on.size) if post else _ROUGH * p.moved.roughness
        surface[p.members[on]] = p.surface
        sigmas[p.members[on]] = np.hypot(p.moved.sigmas, rough)[on]
        if not p.cost.clear:
            level[p.members], sigmas[p.members[on]] = True, _level_sigma(p.moved.heights[on], 2 if post else 1)
        starts[p.members[on]] = p.starts[on]
    if not np.any(surface >= 0):
        shots = sum(p.members.size for p in profiles)
        raise InputError(
            "laser profiles", f"none of {len(profiles)} with {_LEAST_SHOTS} shots on the surface ({shots} in all)",
            "profiles that cross the ground that two images show", "check the images' overlap and the profiles' places",
        )  # fmt: skip
    images = np.array([pair.images for pair in surfaces])
    return StereoControl(tuple(pair.surface for pair in surfaces), images, surface, sigmas, starts, level=level)


def _level_sigma(heights: Array, directions: int) -> float:
    """m, of heights (n,) above ground of unknown horizontal position: what they differ by from a line along the track,
    as often as neighbours, in so many `directions`, count as one.
    """
    along = np.linspace(-1.0, 1.0, heights.size)
    left = heights - np.polyval(np.polyfit(along, heights, 1), along)
    return float(np.sqrt(np.mean(left**2) * correlated_shots(left) ** directions))
