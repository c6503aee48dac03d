"""Registration by relief: laser profiles and the surface that the images show find each other, in the adjustment.

Ties make images agree with one another, ranges fix heights; nothing of that holds a footprint horizontally. Relief
does: the images are matched densely with their adjusted orientation, the disparities are averaged over the footprint
(`geometry.stereo_surface`), each profile is searched over shifts (`search`), and the network is adjusted again with one
row more per shot: its height above the surface, which moves with the orientation. What the profile's shift, the images'
orientation and the shots' own places contribute, their covariances decide.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
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
from mgsgraph.case.reading import Case
from mgsgraph.case.scene import picture_file, read_scene
from mgsgraph.case.schema import decode
from mgsgraph.dem.production import adjusted_scene, densely_matched, expected_ground
from mgsgraph.errors import InputError
from mgsgraph.geometry.altimetry import SPOT_WIDTHS
from mgsgraph.geometry.body import east_north, geodetic
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.stereo_surface import StereoSurface, SurfaceHeights, averaged_surface, heights_above
from mgsgraph.matching.scene import Scene
from mgsgraph.network import Network, PointClass
from mgsgraph.network.stereo_control import StereoControl
from mgsgraph.registration.relief_records import ProfileState, ReliefProfile, ReliefRegistration, ReliefSettings
from mgsgraph.registration.search import CostSurface, StereoPair, search
from mgsgraph.stages import Progress, no_progress
from mgsgraph.wording import some

if TYPE_CHECKING:
    from mgsgraph.matching.dense import DenseMatches

_SCATTERS = 3.0
"""Robust standard deviations of the tie points about the ground, within which the ground is sought."""
_LEAST_SHOTS = 12
"""On the surface, that make a profile one that can be registered."""
_MOST_ROUNDS = 4
"""Of search and adjustment: heights and tilts that the first round mends have shown the next one another surface."""
_LIKELY = 0.01
"""Weight from which on a minimum counts as one where the profile may be."""
_CLOSEST = 5.0
"""pixels of the ground grid between dense matches, at least."""


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
    """
    settings, solver = settings or ReliefSettings(), solver or case.settings
    _require_profiles(case)
    _require_pictures(case, settings)
    if before is not None:
        _require_same(case, before)
    before = before or adjust_network(case.network, solver, case.name, _counted(progress, "adjustment", solver))
    posterior, network = Posterior.of(before), before.network
    footprints = [settings.footprint or case.footprints[name] for name in profile_names(network)]
    surfaces = stereo_surfaces(case.path, posterior, footprints, settings, workers, progress)
    first = _searched(network, surfaces, posterior, before, footprints, settings.reach, progress)
    found, solution = first, before
    for _ in range(_MOST_ROUNDS):
        control = _control(network, surfaces, found)
        shown = _counted(progress, "adjustment with stereo rows", solver)
        anew = replace(network, stereo=control)
        begin = None if solution is before else solution
        solution = adjust_network(anew, solver, case.name, shown, begin=begin)
        left = _searched(network, surfaces, Posterior.of(solution), solution, footprints, settings.reach, progress)
        if all(one.at_rest for one in left):
            break
        found = left
    profiles = tuple(
        ReliefProfile(
            one.cost.name, one.mine, control.surface[one.mine] >= 0, control.sigmas[one.mine],
            ProfileState(one.points, one.here, one.cost), ProfileState(after.points, after.here, after.cost),
            solution.shifts[p], solution.shift_covariance(p),
        )
        for p, (one, after) in enumerate(zip(first, left, strict=True))
    )  # fmt: skip
    return ReliefRegistration(case.name, settings, before, solution, profiles)


def profile_names(network: Network) -> tuple[str, ...]:
    """Laser profiles with a shift of their own."""
    return network.shifts.names if network.shifts is not None else ()


def _require_profiles(case: Case) -> None:
    if not profile_names(case.network):
        raise InputError(
            str(case.path), "no laser profile whose shift is unknown", "[[mola]] entries with shift_sigma_m",
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
    count = iter(range(1, 10**9))

    def show(_: Iteration) -> None:
        progress(what, min(next(count), solver.max_iterations), solver.max_iterations)

    return show


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
    settings: ReliefSettings,
    workers: int | None,
    progress: Progress,
) -> tuple[AveragedPair, ...]:
    """Match the pictures of a case densely, as they are adjusted, and average the disparities of each stereo pair over
    each size of footprint (m).
    """
    wanted = decode(path)
    _, scene = read_scene(path, *expected_ground(posterior, wanted))
    scene = _over_adjusted_ground(adjusted_scene(scene, posterior, settings.images), posterior)
    sizes = sorted(set(footprints))
    spacing = settings.spacing or max(sizes[0] / SPOT_WIDTHS, _CLOSEST * scene.step)
    matches, window = densely_matched(scene, spacing, workers, progress)
    found = list[AveragedPair]()
    for one in matches:
        first, second = (posterior.image_number(scene.pictures[j].image.name) for j in (one.first, one.second))
        for size in sizes:
            progress("stereo surface", len(found), len(matches) * len(sizes))
            width = max(size / SPOT_WIDTHS, spacing)
            found.append(AveragedPair(_surface(posterior, one, first, width, window), (first, second), size))
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


def _surface(posterior: Posterior, matches: "DenseMatches", first: int, width: float, window: float) -> StereoSurface:
    image = posterior.image(first)
    points = posterior.linearised.points
    ground = geodetic(points[np.linalg.norm(points, axis=1) > 0.0], image.body)[:, 2]
    middle = matches.anchors.mean(axis=0, keepdims=True)
    _, slopes = image.image_to_ground(middle[:, 0], middle[:, 1], float(np.median(ground)), posterior.correction(first))
    variances = np.asarray(np.linalg.eigvalsh(matches.covariances)[:, 1], dtype=np.float64)
    pixel = np.asarray(np.linalg.norm(slopes[0], axis=0), dtype=np.float64)
    return averaged_surface(matches.anchors, matches.pixels, variances, pixel, width, window)


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
    def at_rest(self) -> bool:
        """Whether the profile fits where it is, or relief doesn't tie it."""
        if not self.cost.tied:
            return True
        step = float(np.diff(self.cost.shifts[:2])[0])
        near = [
            np.all(np.abs(one.shift) <= np.maximum(3.0 * np.sqrt(np.diag(one.covariance)), step))
            for one in self.cost.minima
            if one.weight > _LIKELY
        ]
        return any(near)


def _searched(
    network: Network,
    surfaces: Sequence[AveragedPair],
    posterior: Posterior,
    solution: Solution,
    footprints: Sequence[float],
    reach: float,
    progress: Progress,
) -> list[_Found]:
    """All profiles, from where a solution has put their shots."""
    oriented = [one.oriented(posterior) for one in surfaces]
    lifted = network.points.places + footprint_shifts(network, solution.shared)
    found = []
    for p, size in enumerate(footprints):
        progress("search", p, len(footprints))
        usable = [k for k, one in enumerate(surfaces) if one.footprint == size]
        found.append(_search_profile(network, oriented, usable, lifted, solution.shifts[p], p, reach))
    progress("search", len(footprints), len(footprints))
    return found


def _search_profile(
    network: Network,
    oriented: Sequence[StereoPair],
    usable: Sequence[int],
    lifted: Array,
    shift: Array,
    p: int,
    reach: float,
) -> _Found:
    """One profile on the surface, of those `usable`, that has most of its shots."""
    assert network.shifts is not None
    mine = np.flatnonzero(network.shifts.profile == p)
    given = network.points.places[mine]
    ways, sigmas = east_north(given), local_sigmas(network.points.covariances[mine], given)[:, 2]
    points = lifted[mine] + np.einsum("k,nkj->nj", shift, ways)
    costs = [search(oriented[k], points, sigmas, network.shifts.names[p], reach) for k in usable]
    best = int(np.argmax([cost.shots for cost in costs]))
    pair, cost = oriented[usable[best]], costs[best]
    starts = points + np.einsum("k,nkj->nj", cost.minima[0].shift if cost.tied else np.zeros(2), ways)
    here, moved = (heights_above(pair.surface, *pair.images, places, pair.corrections) for places in (points, starts))
    return _Found(mine, usable[best], points, here, cost, starts, moved)


def _control(network: Network, surfaces: Sequence[AveragedPair], found: Sequence[_Found]) -> StereoControl:
    """Shots on the surfaces of all profiles that have enough there."""
    n = len(network.points)
    surface, sigmas, starts = np.full(n, -1, dtype=np.int64), np.full(n, np.inf), np.full((n, 3), np.nan)
    for one in found:
        on = one.moved.covered
        if int(on.sum()) < _LEAST_SHOTS:
            continue
        surface[one.mine[on]] = one.surface
        sigmas[one.mine[on]] = np.hypot(one.moved.sigmas, one.moved.roughness)[on]
        starts[one.mine[on]] = one.starts[on]
    if not np.any(surface >= 0):
        shots = sum(one.mine.size for one in found)
        raise InputError(
            "laser profiles", f"none of {len(found)} with {_LEAST_SHOTS} shots on the stereo surface ({shots} in all)",
            "profiles that cross the ground that two images show", "check the images' overlap and the profiles' places",
        )  # fmt: skip
    images = np.array([one.images for one in surfaces])
    return StereoControl(tuple(one.surface for one in surfaces), images, surface, sigmas, starts)
