"""Registration by relief: laser profiles and the surface that the images show find each other, in the adjustment.

Ties make images agree with one another, ranges fix heights; nothing of that holds a footprint horizontally. Relief
does: the images are matched densely with their adjusted orientation, the disparities are averaged over the footprint
(`geometry.stereo_surface`), each profile is searched over shifts (`search`), and the network is adjusted again with one
row more per shot: its height above the surface, which moves with the orientation. What the profile's shift, the images'
orientation and the shots' own places contribute, their covariances decide.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.batch import Iteration
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.case.reading import Case
from mgsgraph.case.scene import picture_file, read_scene
from mgsgraph.case.schema import decode
from mgsgraph.dem.production import adjusted_scene, densely_matched, expected_ground
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import east_north, geodetic
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.stereo_surface import StereoSurface, SurfaceHeights, averaged_surface, heights_above
from mgsgraph.network import Network
from mgsgraph.network.records import StereoControl
from mgsgraph.registration.relief_records import ProfileState, ReliefProfile, ReliefRegistration, ReliefSettings
from mgsgraph.registration.search import CostSurface, StereoPair, search
from mgsgraph.stages import Progress, no_progress
from mgsgraph.wording import some

if TYPE_CHECKING:
    from mgsgraph.matching.dense import DenseMatches

_WIDTHS = 4.0
"""Standard deviations of the Gaussian footprint in its diameter."""
_LEAST_SHOTS = 12
"""On the surface, that make a profile one that can be registered."""
_NEAR = 400.0
"""m, reach of the search that looks for what the adjustment has left."""


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
    posterior = Posterior.of(before)
    pairs, numbers = stereo_pairs(case.path, posterior, settings, workers, progress)
    network = before.network
    found = [_search_profile(network, posterior, pairs, p, settings) for p in range(len(profile_names(network)))]
    control = _control(network, pairs, numbers, found)
    solution = adjust_network(
        replace(network, stereo=control), solver, case.name, _counted(progress, "adjustment with stereo rows", solver)
    )
    after = _with_orientation(pairs, numbers, Posterior.of(solution))
    profiles = tuple(
        _profile(network, solution, pairs, after, control, p, one, settings) for p, one in enumerate(found)
    )
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


def _counted(progress: Progress, what: str, solver: SolverSettings):  # type: ignore[no-untyped-def]
    """A callback of the adjustment that counts its iterations."""
    count = iter(range(1, 10**9))

    def show(_: Iteration) -> None:
        progress(what, min(next(count), solver.max_iterations), solver.max_iterations)

    return show


def stereo_pairs(
    path: Path, posterior: Posterior, settings: ReliefSettings, workers: int | None, progress: Progress
) -> tuple[tuple[StereoPair, ...], tuple[tuple[int, int], ...]]:
    """Match the pictures of a case densely, and average the disparities over the footprint: surfaces of all stereo
    pairs, as the images are adjusted; and the numbers of their images in the network.
    """
    wanted = decode(path)
    _, scene = read_scene(path, *expected_ground(posterior, wanted))
    scene = adjusted_scene(scene, posterior, settings.images)
    matches, window = densely_matched(scene, settings.spacing or settings.footprint / 4.0, workers, progress)
    progress("stereo surface", 0, len(matches))
    pairs, numbers = list[StereoPair](), list[tuple[int, int]]()
    for k, one in enumerate(matches):
        first, second = (posterior.image_number(scene.pictures[j].image.name) for j in (one.first, one.second))
        images = posterior.image(first), posterior.image(second)
        corrections = posterior.correction(first), posterior.correction(second)
        surface = _surface(posterior, one, first, settings.footprint / _WIDTHS, window)
        pairs.append(StereoPair(surface, images, corrections))
        numbers.append((first, second))
        progress("stereo surface", k + 1, len(matches))
    return tuple(pairs), tuple(numbers)


def _surface(posterior: Posterior, matches: "DenseMatches", first: int, width: float, window: float) -> StereoSurface:
    image = posterior.image(first)
    points = posterior.linearised.points
    ground = geodetic(points[np.linalg.norm(points, axis=1) > 0.0], image.body)[:, 2]
    middle = matches.anchors.mean(axis=0, keepdims=True)
    _, slopes = image.image_to_ground(middle[:, 0], middle[:, 1], float(np.median(ground)), posterior.correction(first))
    variances = np.asarray(np.linalg.eigvalsh(matches.covariances)[:, 1], dtype=np.float64)
    pixel = np.linalg.norm(slopes[0], axis=0)
    return averaged_surface(matches.anchors, matches.pixels, variances, pixel, width, window)


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """A profile as the search leaves it."""

    mine: Index
    """(n,) its points in the network."""
    pair: int
    """Stereo pair on which it lies."""
    cost: CostSurface
    """Over shifts."""
    starts: Array
    """(n, 3) m, where its shots lie after the best shift, or a-priori where relief doesn't tie it."""
    heights: SurfaceHeights
    """There."""


def _search_profile(
    network: Network, posterior: Posterior, pairs: Sequence[StereoPair], p: int, settings: ReliefSettings
) -> _Found:
    assert network.shifts is not None
    mine = np.flatnonzero(network.shifts.profile == p)
    points, sigmas = network.points.places[mine], _height_sigmas(network, mine)
    name = network.shifts.names[p]
    costs = [search(pair, points, sigmas, name, settings.reach) for pair in pairs]
    k = int(np.argmax([cost.shots for cost in costs]))
    cost = costs[k]
    shift = cost.minima[0].shift if cost.tied else np.zeros(2)
    starts = points + np.einsum("k,nkj->nj", shift, east_north(points))
    heights = heights_above(pairs[k].surface, *pairs[k].images, starts, pairs[k].corrections)
    return _Found(mine, k, cost, starts, heights)


def _height_sigmas(network: Network, points: Index) -> Array:
    """(n,) m, a-priori, of the heights of network points."""
    up = network.points.places[points]
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    return np.asarray(np.sqrt(np.einsum("ni,nij,nj->n", up, network.points.covariances[points], up)))


def _control(
    network: Network, pairs: Sequence[StereoPair], numbers: Sequence[tuple[int, int]], found: Sequence[_Found]
) -> StereoControl:
    """Shots on the surfaces of all profiles that have enough there."""
    n = len(network.points)
    surface, sigmas, starts = np.full(n, -1, dtype=np.int64), np.full(n, np.inf), np.full((n, 3), np.nan)
    for one in found:
        on = one.heights.covered
        if int(on.sum()) < _LEAST_SHOTS:
            continue
        surface[one.mine[on]] = one.pair
        sigmas[one.mine[on]] = np.hypot(one.heights.sigmas, one.heights.roughness)[on]
        starts[one.mine[on]] = one.starts[on]
    if not np.any(surface >= 0):
        shots = sum(one.mine.size for one in found)
        raise InputError(
            "laser profiles", f"none of {len(found)} with {_LEAST_SHOTS} shots on the stereo surface ({shots} in all)",
            "profiles that cross the ground that two images show", "check the images' overlap and the profiles' places",
        )  # fmt: skip
    return StereoControl(tuple(pair.surface for pair in pairs), np.array(numbers), surface, sigmas, starts)


def _with_orientation(
    pairs: Sequence[StereoPair], numbers: Sequence[tuple[int, int]], posterior: Posterior
) -> tuple[StereoPair, ...]:
    """The same surfaces by another orientation."""
    return tuple(
        StereoPair(
            pair.surface,
            (posterior.image(first), posterior.image(second)),
            (posterior.correction(first), posterior.correction(second)),
        )
        for pair, (first, second) in zip(pairs, numbers, strict=True)
    )


def _profile(
    network: Network,
    solution: Solution,
    before: Sequence[StereoPair],
    after: Sequence[StereoPair],
    control: StereoControl,
    p: int,
    found: _Found,
    settings: ReliefSettings,
) -> ReliefProfile:
    """What the adjustment has made of a profile."""
    points, shift = network.points.places[found.mine], solution.shifts[p]
    moved = points + np.einsum("k,nkj->nj", shift, east_north(points))
    old, new = (
        heights_above(pair.surface, *pair.images, places, pair.corrections)
        for pair, places in ((before[found.pair], points), (after[found.pair], moved))
    )
    reach, sigmas = min(_NEAR, settings.reach), _height_sigmas(network, found.mine)
    left = search(after[found.pair], moved, sigmas, found.cost.name, reach)
    return ReliefProfile(
        found.cost.name, found.mine, control.surface[found.mine] >= 0, control.sigmas[found.mine],
        ProfileState(points, old, found.cost), ProfileState(moved, new, left), shift, solution.shift_covariance(p),
    )  # fmt: skip
