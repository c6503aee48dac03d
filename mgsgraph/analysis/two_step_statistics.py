"""Statistics of an adjustment in two steps: sigmas of points and orientation, and heights above the terrain, at
each stage; by pass and for all. SI units, NaN for nothing.

Heights are compared like with like: at every stage of the places where the rays alone put the points, with the
orientation of the stage. (In step 2 each point has a height row of its own, which pulls it to the terrain; with that
the heights would be smaller, whatever the orientation.)

Tables, words and figures all take their numbers here, so that they can't contradict each other.
"""

from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.frames import FLIGHT_NAMES
from mgsgraph.adjustment.two_steps import TwoSteps, heights_above, orientation_values
from mgsgraph.analysis.statistics import flight_axes_at, mean_and_rms, pose_sigmas, sigmas_along
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.network import Network, PointClass
from mgsgraph.record import Record

STAGES = ("before", "step_1", "step_2")
"""Nominal orientation and a-priori sigmas; adjusted without terrain; adjusted with it."""
POINT_AXES = ("X", "Y", "Z")
"""Flight direction, across track to the left, height."""
POSE_AXES = FLIGHT_NAMES
"""Components of `GroupStatistics.poses`: m, then rad."""
_LINES = 31
"""Lines of an image at which its orientation is looked at, as the papers do."""


@dataclass(frozen=True, slots=True, eq=False)
class HeightStatistics:
    """Heights of points above the terrain model."""

    count: int
    """Points whose height row took part in step 2."""
    rms: Array
    """(stages,) m, by rays alone."""
    mean: Array
    """(stages,) m, mean height by rays alone."""


@dataclass(frozen=True, slots=True, eq=False)
class GroupStatistics:
    """Of one pass, one image in no pass, or all."""

    name: str
    """Name of the pass or image, or "all"."""
    points: int
    """Tie points that have a place after both steps."""
    mean: Array
    """(stages, 3) m, mean sigma of these along X (flight), Y (across), Z (height); for sigma0 = 1."""
    median: Array
    """(stages, 3) m, median of the same."""
    poses: Array
    """(stages, 6) m and rad, mean sigma of the orientation over evenly spaced lines, as POSE_AXES: of the image, of a
    pass's middle image alone, or the mean of these over all groups."""
    heights: HeightStatistics
    """Of tie points over the terrain model."""


@dataclass(frozen=True, slots=True, eq=False)
class TwoStepStatistics(Record):
    """Statistics of an adjustment in two steps."""

    steps: TwoSteps
    """The adjustment."""
    whole: GroupStatistics
    """All passes together; each point counts once, in the axes of the first pass that sees it."""
    groups: tuple[GroupStatistics, ...]
    """Passes, then images in none; a point that two of them see counts in both."""
    points: Index
    """(m,) points of `heights`."""
    heights: Array
    """(stages, m) m above the terrain model, by rays alone; the model is where it is given, in step 2 where that puts
    it."""
    used: Mask
    """(m,) whose row took part in step 2; the others were judged to be off."""
    without_row: int
    """Tie points without a height row: beside the model, or of whose four posts some are missing."""
    left_out: int
    """Tie points with a height row that lie there at some stage, or have no place: left out of `heights`."""


def two_step_statistics(steps: TwoSteps) -> TwoStepStatistics:
    """Statistics of both steps.

    A-priori sigmas of points are those of forward intersection (`adjustment.two_steps.RaysAlone`), of the rays that
    step 1 left in.

    Parameters
    ----------
    steps : TwoSteps
        Of `adjust_in_two_steps`.

    Examples
    --------
    >>> from mgsgraph.simulation import BlockSettings, simulate_hrsc_block
    >>> block = simulate_hrsc_block(BlockSettings(passes=2, length=100e3, points=100), seed=1)
    >>> steps = mgsgraph.adjust_in_two_steps(block.network, mgsgraph.SolverSettings())
    >>> mgsgraph.two_step_statistics(steps).whole.heights.rms.round(0)  # m: before, without terrain, with it
    array([108.,  29.,  20.])
    """
    network = steps.network
    before, covariances = steps.rays_alone.nominal()
    ties = _ties(steps)
    heights = _heights(steps, before)
    assert network.surface is not None
    of_ties, with_row = network.points.classes == PointClass.TIE, np.isfinite(network.surface.sigmas)
    complete = np.all(np.isfinite(heights), axis=0) & of_ties & with_row
    used = complete & ~steps.rejected
    groups = []
    first = np.full(len(network.points), -1, dtype=np.int64)
    for name, images in owners(network):
        rays = _first_rays(steps, images)
        points_of_rays = network.rays.point[rays]
        fresh = first[points_of_rays] < 0
        first[points_of_rays[fresh]] = rays[fresh]
        heights_of = _height_statistics(heights, points_of_rays[used[points_of_rays]])
        poses = _poses(steps, int(images[images.size // 2]))
        sigmas = _sigmas(steps, covariances, rays[ties[points_of_rays]])
        groups.append(_group(name, sigmas, poses, heights_of))
    rays = first[ties & (first >= 0)]
    everything = _group(
        "all",
        _sigmas(steps, covariances, rays),
        np.mean([group.poses for group in groups], axis=0),
        _height_statistics(heights, np.flatnonzero(used & (first >= 0))),
    )
    points = np.flatnonzero(complete)
    without_row, left_out = (int(np.count_nonzero(of_ties & missing)) for missing in (~with_row, with_row & ~complete))
    of_points = points, heights[:, points], used[points]
    return TwoStepStatistics(steps, everything, tuple(groups), *of_points, without_row, left_out)


def owners(network: Network) -> list[tuple[str, Index]]:
    """Passes with their images; then every other image that is adjusted, or all where none is."""
    passes = [(pass_.name, pass_.images) for pass_ in network.passes]
    alone = np.flatnonzero(network.with_polynomial)
    if not passes and not alone.size:
        alone = np.arange(len(network.images))
    return passes + [(network.images[j].name, np.array([j])) for j in alone.tolist()]


def _ties(steps: TwoSteps) -> Mask:
    """(n,) tie points with an adjusted place after both steps."""
    points = steps.network.points
    adjusted = (points.classes == PointClass.TIE) & (points.kinds != PointKind.FIXED)
    return np.asarray(adjusted & steps.free.determined & steps.fitted.determined)


def _first_rays(steps: TwoSteps, images: Index) -> Index:
    """The first ray that took part of each point that some images see."""
    rays = steps.network.rays
    chosen = np.flatnonzero(np.isin(rays.image, images) & steps.free.rays_used)
    _, first = np.unique(rays.point[chosen], return_index=True)
    return chosen[first]


def _sigmas(steps: TwoSteps, before: Array, rays: Index) -> Array:
    """(stages, n, 3) m of the points of some rays, each in the flight of its ray's image."""
    network = steps.network
    points, image = network.rays.point[rays], network.rays.image[rays]
    velocities = np.empty((rays.size, 3))
    for j in np.unique(image).tolist():
        of_image = image == j
        velocities[of_image] = network.images[j].pose(network.rays.places[rays[of_image], 0]).velocity
    axes = flight_axes_at(steps.fitted.places[points], velocities)
    covariances = (before, steps.free.covariances, steps.fitted.covariances)
    return np.stack([sigmas_along(axes, stage[points]) for stage in covariances])


def _poses(steps: TwoSteps, image: int) -> Array:
    """(stages, 6) m and rad, mean over the lines of an image."""
    lines = np.linspace(0.0, float(steps.network.images[image].lines), _LINES)
    result = np.full((len(STAGES), 6), np.nan)
    for k, solution in enumerate((steps.free, steps.fitted), start=1):
        correction, joint = solution.correction(image), solution.joint_covariance
        result[k] = pose_sigmas(solution.network, image, correction, joint, lines).mean(axis=0)
    prior = steps.rays_alone.joint
    if prior is not None:
        adjusted = steps.free.correction(image)
        nominal = OrientationCorrection(np.zeros_like(adjusted.coefficients), adjusted.angles, adjusted.nodes)
        result[0] = pose_sigmas(steps.free.network, image, nominal, prior, lines).mean(axis=0)
    return result


def _heights(steps: TwoSteps, before: Array) -> Array:
    """(stages, n) m above the terrain model."""
    places, _ = steps.rays_alone.at(orientation_values(steps.network, steps.fitted))
    stages = [(before, None), (steps.free.places, None), (places, steps.fitted)]
    return np.stack([heights_above(steps.network, *stage)[0] for stage in stages])


def _height_statistics(heights: Array, points: Index) -> HeightStatistics:
    mean, rms = mean_and_rms(heights[:, points].T)
    return HeightStatistics(points.size, rms, mean)


def _group(name: str, sigmas: Array, poses: Array, heights: HeightStatistics) -> GroupStatistics:
    count = sigmas.shape[1]
    nothing = np.full((len(STAGES), 3), np.nan)
    mean = sigmas.mean(axis=1) if count else nothing
    median = np.median(sigmas, axis=1) if count else nothing
    return GroupStatistics(name, count, mean, median, poses, heights)
