"""Registration by relief: laser profiles and the surface that the images show find each other, in the adjustment.

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
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.batch import Iteration
from mgsgraph.adjustment.graph.shared import footprint_shifts
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.statistics import local_sigmas
from mgsgraph.case.case_file import decode
from mgsgraph.case.reading import Case
from mgsgraph.case.scene import picture_file, read_scene
from mgsgraph.compiled import in_threads
from mgsgraph.errors import InputError
from mgsgraph.geometry.altimetry import SPOT_WIDTHS
from mgsgraph.geometry.body import east_north, geodetic
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.stereo_surface import LEAST_SHARE, StereoSurface, SurfaceHeights, averaged_surface, heights_above
from mgsgraph.matching.scene import Scene
from mgsgraph.network import TERRAIN, Network, PointClass
from mgsgraph.network.footprints import points_in_images
from mgsgraph.network.records import Crossovers, StereoControl, crossovers
from mgsgraph.network.terrain import Posts, TerrainModel, posts_of, with_posts
from mgsgraph.progress import Progress, no_progress
from mgsgraph.registration.dem.ortho import adjusted_scene, densely_matched, expected_ground
from mgsgraph.registration.search import (
    CostSurface,
    Expected,
    ProfileState,
    ReliefProfile,
    ReliefRegistration,
    ReliefSettings,
    StereoPair,
    search,
    shots_alike,
)
from mgsgraph.text import some

if TYPE_CHECKING:
    from mgsgraph.matching.dense import DenseMatches

_SCATTERS = 3.0
"""Robust standard deviations of the tie points about the ground, within which the ground is sought."""
_CLOSEST = 5.0
"""pixels of the ground grid between dense matches, at least."""
_MATCHES_ACROSS = 12.0
"""Matches across the cell of a terrain model, whose mean they are to show, not its roughness."""
_CELL_SHARE = 0.9
"""Of the usual weight of matches about a node of a cell, below which it is not covered: what a plane through part of a
cell's ground makes of the rest is no mean of it."""
_CELL_PIXELS = 20.0
"""pixels of the images across a cell, at least: what is finer is averaged first."""
_MARGIN = 500.0
"""pixels by which posts may lie beside an image, as shots of [[altimetry]]."""

Cells = tuple[TerrainModel, Posts]
"""A terrain model, and those of its posts that images may show."""


def cells_of(
    models: Sequence[TerrainModel], posterior: Posterior, settings: ReliefSettings
) -> tuple[Cells, ...]:
    """Posts of terrain models in two images at least, or a margin beside them, by the orientation of an adjustment.

    Raises
    ------
    InputError
        Where a model has none.
    """
    images = range(len(posterior.network.images))
    pixel = max(float(_ground_pixel(posterior, j).max()) for j in images)
    least = max(_CELL_PIXELS * pixel, SPOT_WIDTHS * (settings.spacing or 0.0))
    found = list[Cells]()
    for model in models:
        posts = posts_of(model, least)
        seen = points_in_images(
            [posterior.image(j) for j in images], posts.points, _MARGIN, [posterior.correction(j) for j in images]
        )
        there = np.flatnonzero(np.count_nonzero(seen, axis=0) > 1)
        if not there.size:
            raise InputError(
                model.lattice.source, f"{len(posts.ids)} posts, none in two images", "a model of the images' ground"
            )
        found.append((model, posts.chosen(there)))
    return tuple(found)


def _ground_pixel(posterior: Posterior, image: int, place: Array | None = None) -> Array:
    """(2,) m on the ground of a line and of a sample, at a line and sample (2,), or in the middle of an image."""
    one = posterior.image(image)
    line, sample = place if place is not None else 0.5 * np.array([one.lines, one.samples])
    points = posterior.linearised.points
    ground = geodetic(points[np.linalg.norm(points, axis=1) > 0.0], one.body)[:, 2]
    at = np.array([line]), np.array([sample])
    slopes = one.image_to_ground(*at, float(np.median(ground)), posterior.correction(image))[1]
    return np.asarray(np.linalg.norm(slopes[0], axis=0), dtype=np.float64)


class AveragedPair(NamedTuple):
    """The surface that two images show, averaged over one size of footprint."""

    surface: StereoSurface
    """What they show."""
    images: tuple[int, int]
    """First and second, in the network."""
    footprint: float
    """m."""

    def oriented(self, posterior: Posterior) -> StereoPair:
        """With the orientation of an adjustment."""
        first, second = self.images
        return StereoPair(
            self.surface,
            (posterior.image(first), posterior.image(second)),
            (posterior.correction(first), posterior.correction(second)),
        )


def stereo_surfaces(
    path: Path,
    posterior: Posterior,
    footprints: Sequence[float],
    cells: Sequence[Cells],
    settings: ReliefSettings,
    workers: int | None,
    progress: Progress,
) -> tuple[AveragedPair, ...]:
    """Match the pictures of a case densely, as they are adjusted, and average the disparities of each stereo pair over
    each size of footprint (m), of laser spots and of the cells of terrain models.
    """
    wanted = decode(path)
    _, scene = read_scene(path, *expected_ground(posterior, wanted))
    scene = _over_adjusted_ground(adjusted_scene(scene, posterior, settings.images), posterior)
    of_cells = [posts.footprint for _, posts in cells]
    closest = min([size / SPOT_WIDTHS for size in footprints] + [size / _MATCHES_ACROSS for size in of_cells])
    spacing = settings.spacing or max(closest, _CLOSEST * scene.step)
    matches, window = densely_matched(scene, spacing, workers, progress)
    found, sizes = list[AveragedPair](), sorted({*footprints, *of_cells})
    for one in matches:
        first, second = (posterior.network.image_number(scene.pictures[j].image.name) for j in (one.first, one.second))
        for size in sizes:
            progress("stereo surface", len(found), len(matches) * len(sizes))
            found.append(averaged_pair(posterior, one, (first, second), size, spacing, window, size in of_cells))
    return tuple(found)


def _over_adjusted_ground(scene: Scene, posterior: Posterior) -> Scene:
    """The scene with its ground raised to where the adjusted tie points lie, and as uncertain as they scatter about it:
    before registration the images' heights may be hundreds of metres off the terrain model's.
    """
    network, places = posterior.network, posterior.linearised.points
    ties = places[(network.points.classes == PointClass.TIE) & (np.linalg.norm(places, axis=1) > 0.0)]
    if not len(ties):
        return scene
    ground = scene.ground
    above = np.linalg.norm(ties, axis=1) - np.linalg.norm(ground.points(ground.chart.plane(ties)), axis=1)
    above = above[np.isfinite(above)]
    level = float(np.median(above))
    scatter = 1.4826 * float(np.median(np.abs(above - level)))
    terrain = None if ground.terrain is None else replace(ground.terrain, radii=ground.terrain.radii + level)
    sigma = max(ground.height_sigma, _SCATTERS * scatter)
    return replace(scene, ground=replace(ground, terrain=terrain, height=ground.height + level, height_sigma=sigma))


def averaged_pair(
    posterior: Posterior,
    matches: "DenseMatches",
    images: tuple[int, int],
    size: float,
    spacing: float,
    window: float,
    cells: bool = False,
) -> AveragedPair:
    """Matches of two images of a network, `spacing` m apart and made with windows of `window` m, averaged over
    footprints of `size` m, or over cells, which have to be covered as a whole.
    """
    variances = np.asarray(np.linalg.eigvalsh(matches.covariances)[:, 1], dtype=np.float64)
    pixel = _ground_pixel(posterior, images[0], matches.anchors.mean(axis=0))
    width = max(size / SPOT_WIDTHS, spacing)
    return AveragedPair(
        averaged_surface(
            matches.anchors, matches.pixels, variances, pixel, width, window, _CELL_SHARE if cells else LEAST_SHARE
        ),
        images,
        size,
    )



_LEAST_SHOTS = 12
"""On the surface, that make a profile one that can be registered."""
_MOST_ROUNDS = 6
"""Of search and adjustment: heights and tilts that the first round mends have shown the next one another surface."""
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
    new = [np.zeros(one.kind.width) for one in network.shared[k:]]
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
    """Register laser profiles and terrain models with surfaces that are there already.

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
        found = left
        control = _control(network, surfaces, found)
        shown = _counted(progress, "adjustment with stereo rows", solver)
        crossing = _crossing(network, placed, found) if settings.crossovers else None
        anew = replace(network, stereo=control, crossovers=crossing)
        solution = adjust_network(anew, solver, before.name, shown, begin=begin)
        begin = solution.values
        lifted = network.points.places + footprint_shifts(network, solution.shared)
        placed = placed._replace(lifted=lifted, shifts=solution.shifts)
        left = _searched(network, surfaces, Posterior.of(solution), placed, footprints, settings.reach, progress)
        rest = [new.at_rest(old) for old, new in zip(found, left, strict=True)]
        if number == _MOST_ROUNDS:  # what has not come to rest is adjusted once more, as level ground
            unreached = [not one for one in rest]
        left = [one.unreached if never else one for one, never in zip(left, unreached, strict=True)]
        if all(rest):
            break
    profiles = tuple(
        ReliefProfile(
            one.cost.name, PointClass(network.points.classes[one.mine[0]]), one.mine,
            solution.stereo_used[one.mine], control.sigmas[one.mine],
            ProfileState(one.points, one.here, one.cost), ProfileState(after.points, after.here, after.cost),
            solution.shifts[p], solution.shift_covariance(p),
        )
        for p, (one, after) in enumerate(zip(first, left, strict=True))
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
    """Raise InputError unless a case has the images that are wanted, and pixels, before anything takes long."""
    names = [image.name for image in case.network.images]
    for name in settings.images:
        if name not in names:
            raise InputError(str(case.path), f"no image {name}", f"one of {some(names, len(names))}")
    if len(names) < 2:
        raise InputError(str(case.path), "one image", "two that overlap, at least")
    wanted = decode(case.path)
    for j in range(len(wanted.images)):
        picture_file(wanted, j, case.path)


def _require_same(case: Case, before: Solution) -> None:
    """Raise InputError unless a solution has the images and the profiles of a case."""
    networks = case.network, before.network
    for what, (wanted, found) in (
        ("images", [[image.name for image in one.images] for one in networks]),
        ("laser profiles of unknown shift", [list(profile_names(one)) for one in networks]),
    ):
        if wanted != found:
            there = some(found, len(found)) if found else "none"
            raise InputError(
                f"solution {before.name!r}", f"other {what} ({there})",
                f"those of the case ({some(wanted, len(wanted))})", "adjust the case again, or leave --solution out",
            )  # fmt: skip


def _counted(progress: Progress, what: str, solver: SolverSettings) -> Callable[[Iteration], None]:
    """A callback of the adjustment that counts its iterations."""
    done = count(1)

    def show(_: Iteration) -> None:
        progress(what, min(next(done), solver.max_iterations), solver.max_iterations)

    return show


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """A profile as the search leaves it; n shots."""

    mine: Index
    """(n,) its points in the network."""
    surface: int
    """On which it lies."""
    points: Array
    """(n, 3) m, where the adjustment has put its shots."""
    here: SurfaceHeights
    """There."""
    cost: CostSurface
    """Over shifts from there."""
    starts: Array
    """(n, 3) m, after the best shift; the same points where relief doesn't tie the profile."""
    moved: SurfaceHeights
    """There."""

    @property
    def unreached(self) -> "_Found":
        """The same, its best shift being one that adjustments have not come to."""
        return replace(self, cost=replace(self.cost, reached=False), starts=self.points, moved=self.here)

    def at_rest(self, before: "_Found") -> bool:
        """Whether the profile fits where it is, or relief ties it as little as it did `before` the last adjustment."""
        if not self.cost.clear:
            return not before.cost.clear and len(self.cost.possible) == len(before.cost.possible)
        if not before.cost.clear:
            return False
        near = [
            np.all(np.abs(one.shift) <= np.maximum(3.0 * np.sqrt(np.diag(one.covariance)), _NEAR))
            for one in self.cost.minima
            if one.weight > _LIKELY
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
) -> list[_Found]:
    """All profiles, from where their shots and posts are."""
    oriented = [one.oriented(posterior) for one in surfaces]

    def one_profile(p: int) -> _Found:
        usable = [k for k, one in enumerate(surfaces) if one.footprint == footprints[p]]
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
) -> _Found:
    """One profile on the surface, of those `usable`, that has most of its shots."""
    assert network.shifts is not None
    mine = np.flatnonzero(network.shifts.profile == p)
    given = network.points.places[mine]
    ways, sigmas = east_north(given), local_sigmas(network.points.covariances[mine], given)[:, 2]
    points = placed.lifted[mine] + np.einsum("k,nkj->nj", placed.shifts[p], ways)
    expected = None
    if network.points.classes[mine[0]] == PointClass.POST:
        expected = Expected(-placed.shifts[p], float(np.hypot(network.shifts.sigmas[p], placed.sigma)))
    name = network.shifts.names[p]
    costs = [search(oriented[k], points, sigmas, name, reach, expected) for k in usable]
    best = int(np.argmax([cost.shots for cost in costs]))
    pair, cost = oriented[usable[best]], costs[best]
    starts = points + np.einsum("nk,nkj->nj", cost.best(mine.size), ways) if cost.clear else points
    here, moved = (heights_above(pair.surface, *pair.images, places, pair.corrections) for places in (points, starts))
    return _Found(mine, usable[best], points, here, cost, starts, moved)


def _crossing(network: Network, placed: _Placed, found: Sequence[_Found]) -> Crossovers | None:
    """Crossovers of the laser profiles, where the search has found that they lie."""
    assert network.shifts is not None
    moved, clear = placed.shifts[: len(found)].copy(), np.array([one.cost.clear for one in found])
    for p in np.flatnonzero(clear).tolist():
        moved[p] += found[p].cost.best(found[p].mine.size).mean(axis=0)
    sigmas, shots = np.full(len(network.points), np.nan), network.shifts.profile >= 0
    sigmas[shots] = local_sigmas(network.points.covariances[shots], network.points.places[shots])[:, 2]
    return crossovers(network.points, network.shifts, moved, sigmas, ~clear)


def _control(network: Network, surfaces: Sequence[AveragedPair], found: Sequence[_Found]) -> StereoControl:
    """Shots on the surfaces of all profiles that have enough there."""
    n = len(network.points)
    surface, sigmas, starts = np.full(n, -1, dtype=np.int64), np.full(n, np.inf), np.full((n, 3), np.nan)
    level = np.zeros(n, dtype=bool)
    for one in found:
        on = one.moved.covered
        if int(on.sum()) < _LEAST_SHOTS:
            continue
        post = network.points.classes[one.mine[0]] == PointClass.POST
        # a post is the mean of its cell: how rough the ground is within makes it no less certain
        rough = np.zeros(on.size) if post else one.moved.roughness
        surface[one.mine[on]] = one.surface
        sigmas[one.mine[on]] = np.hypot(one.moved.sigmas, rough)[on]
        if not one.cost.clear:
            level[one.mine], sigmas[one.mine[on]] = True, _level_sigma(one.moved.heights[on], 2 if post else 1)
        starts[one.mine[on]] = one.starts[on]
    if not np.any(surface >= 0):
        shots = sum(one.mine.size for one in found)
        raise InputError(
            "laser profiles", f"none of {len(found)} with {_LEAST_SHOTS} shots on the stereo surface ({shots} in all)",
            "profiles that cross the ground that two images show", "check the images' overlap and the profiles' places",
        )  # fmt: skip
    images = np.array([one.images for one in surfaces])
    return StereoControl(tuple(one.surface for one in surfaces), images, surface, sigmas, starts, level=level)


def _level_sigma(heights: Array, directions: int) -> float:
    """m, of heights (n,) above ground of unknown horizontal position: what they differ by from a line along the track,
    as often as neighbours, in so many `directions`, count as one.
    """
    along = np.linspace(-1.0, 1.0, heights.size)
    left = heights - np.polyval(np.polyfit(along, heights, 1), along)
    return float(np.sqrt(np.mean(left**2) * shots_alike(left) ** directions))
