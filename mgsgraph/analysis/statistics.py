"""Statistics of a solution: means and root mean squares by image, class and component. SI units, NaN for nothing.

Tables, words and figures all take their numbers here, so that they can't contradict each other. Medians of groups of
many values, without a loop, and robust ends of scales; by them, how well each image fits.

Orientation and points in the axes of the flight: sigmas along the lines of an image, and the corrections of passes over
time, which are those of the orientation images alone: unknowns that images share are not in them.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np

from mgsgraph.adjustment.frames import camera_axes, flight_axes
from mgsgraph.adjustment.solution import Solution, orientation_profiles
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.orientation import COMPONENTS as AXES
from mgsgraph.geometry.orientation import SUPPORT, Angles, Moments, OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask, by_value, sigmas_of
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.network import Network, NodePrior, Pass, PointClass
from mgsgraph.network.connectivity import Connectivity, connectivity, network_footprints
from mgsgraph.network.joining import nominal_poses, seconds, straightest
from mgsgraph.record import Record
from mgsgraph.text import root_mean_square

if TYPE_CHECKING:
    from scipy.sparse import csr_array

CLASSES = len(PointClass)
PLACES = 31
"""Lines along an image at which the papers sample its orientation."""
ORIENTATION = ("X", "Y", "Z", "omega", "phi", "kappa", "rotation x", "rotation y", "rotation z")
"""Components of `OrientationStatistics`: m, then rad."""

_WEAK = 10.0
"""Times the median sigma of its class from which on a point is called weak."""
_TOGETHER = 4096
"""Images whose orientation is looked at at a time."""
_CONNECTED: "WeakKeyDictionary[Solution, Connectivity]" = WeakKeyDictionary()
_ORIENTED: "WeakKeyDictionary[Solution, list[OrientationStatistics]]" = WeakKeyDictionary()
"""Found before, of solutions that are there."""


def mean_and_rms(values: Array) -> tuple[Array, Array]:
    """Mean and root mean square along the first axis; NaN where there is nothing."""
    if values.shape[0] == 0:
        nothing = np.full(values.shape[1:], np.nan)
        return nothing, nothing
    return values.mean(axis=0), root_mean_square(values, 0)


@dataclass(frozen=True, eq=False)
class RayStatistics:
    """Image residuals of the rays that took part, by image and class; components line and sample."""

    total: Index
    """(images,) rays measured, used or not."""
    count: Index
    """(images, classes) rays used."""
    mean: Array
    """(images, classes, 2) pixels."""
    rms: Array
    """(images, classes, 2) pixels."""

    @cached_property
    def rms_of_images(self) -> Array:
        """(images, 2) pixels, over all classes."""
        return self._pooled(1)

    @cached_property
    def rms_of_classes(self) -> Array:
        """(classes, 2) pixels, over all images."""
        return self._pooled(0)

    def _pooled(self, axis: int) -> Array:
        squares = np.nan_to_num(self.rms) ** 2 * self.count[:, :, None]
        return np.sqrt(_ratio(squares.sum(axis=axis), self.count.sum(axis=axis)))


def ray_statistics(solution: Solution) -> RayStatistics:
    """Image residuals by image and class, in one pass over the rays."""
    network, images = solution.network, len(solution.network.images)
    used = solution.rays_used
    image, residuals = network.rays.image[used], solution.residuals[used]
    cell = image * CLASSES + network.points.classes[network.rays.point[used]]
    count = np.bincount(cell, minlength=images * CLASSES).reshape(images, CLASSES)

    def summed(values: Array) -> Array:
        parts = [np.bincount(cell, weights=values[:, c], minlength=images * CLASSES) for c in range(2)]
        return np.stack(parts, axis=1).reshape(images, CLASSES, 2).astype(np.float64)  # no rays: counts, not weights

    mean, squares = _ratio(summed(residuals), count), _ratio(summed(residuals**2), count)
    return RayStatistics(np.bincount(network.rays.image, minlength=images), count, mean, np.sqrt(squares))


def _ratio(sums: Array, count: Index) -> Array:
    """Sums (..., 2) over counts (...); NaN where there is nothing."""
    return np.asarray(np.where(count[..., None] > 0, sums / np.maximum(count, 1)[..., None], np.nan))


@dataclass(frozen=True, slots=True, eq=False)
class OrientationStatistics:
    """Corrections of one image's exterior orientation over evenly spaced lines; components as in ORIENTATION."""

    mean: Array
    """(9,) m and rad, adjusted minus nominal."""
    rms: Array
    """(9,) m and rad, of adjusted minus nominal."""
    mean_sigma: Array
    """(9,) m and rad, mean standard deviation of the adjusted orientation, for sigma0 = 1."""


def orientation_statistics(solution: Solution, image: str | int) -> OrientationStatistics:
    """Corrections of one image over the papers' 31 places; those of all images are found at once, the first time."""
    by_image = _ORIENTED.get(solution)
    if by_image is None:
        by_image = _ORIENTED[solution] = _orientation_statistics(solution)
    return by_image[solution.network.image_number(image)]


def _orientation_statistics(solution: Solution) -> list[OrientationStatistics]:
    images, by_image = range(len(solution.network.images)), list[OrientationStatistics]()
    for first in range(0, len(images), _TOGETHER):
        some = images[first : first + _TOGETHER]
        profile = orientation_profiles(solution, some, PLACES)
        moved = profile.position_after - profile.position_before
        values = np.concatenate([moved, profile.angle_differences, profile.rotation], axis=1)
        sigmas = np.concatenate([profile.position_sigma, profile.angles_sigma, profile.rotation_sigma], axis=1)
        values, sigmas = (part.reshape(len(some), PLACES, -1) for part in (values, sigmas))
        mean, rms = values.mean(axis=1), root_mean_square(values, 1)
        by_image += [OrientationStatistics(*rows) for rows in zip(mean, rms, sigmas.mean(axis=1), strict=True)]
    return by_image


@dataclass(frozen=True, slots=True, eq=False)
class PointStatistics:
    """Ground points of one class; sigmas and corrections are of those that were adjusted (fixed ones have none)."""

    count: int
    """Number of points of the class."""
    rejected: int
    """Points without a place, or none of whose rays took part."""
    adjusted: int
    """Number of points with an adjusted position."""
    mean_sigma: Array
    """(3,) m, in x, y, z, for sigma0 = 1."""
    median_sigma: Array
    """(3,) m, the same, which weak points don't move."""
    high_sigma: Array
    """(3,) m, what 95 % of them have at most."""
    weak: int
    """Points whose sigma, of all directions together, is over ten times the class's median."""
    mean_correction: Array
    """(3,) m, adjusted minus before."""
    rms_correction: Array
    """(3,) m, the same."""


def point_statistics(solution: Solution, point_class: PointClass) -> PointStatistics:
    """Sigmas and corrections of one class of points."""
    of_class = solution.network.points.classes == point_class
    adjusted = of_class & adjusted_points(solution)
    mean, rms = mean_and_rms((solution.places - solution.places_before)[adjusted])
    sigmas, none = solution.sigmas[adjusted], np.full(3, np.nan)
    total = np.linalg.norm(sigmas, axis=1)
    return PointStatistics(
        count=int(of_class.sum()),
        rejected=int(np.sum(rejected_points(solution) & of_class)),
        adjusted=int(adjusted.sum()),
        mean_sigma=mean_and_rms(sigmas)[0],
        median_sigma=np.median(sigmas, axis=0) if total.size else none,
        high_sigma=np.quantile(sigmas, 0.95, axis=0) if total.size else none,
        weak=int(np.sum(total > _WEAK * np.median(total))) if total.size else 0,
        mean_correction=mean,
        rms_correction=rms,
    )


def adjusted_points(solution: Solution) -> Mask:
    """(n,) True for points that have a place and are not fixed."""
    return np.asarray(solution.determined & (solution.network.points.kinds != PointKind.FIXED))


def used_ray_counts(solution: Solution) -> Index:
    """(n,) number of rays of each point that took part."""
    return np.bincount(solution.network.rays.point[solution.rays_used], minlength=len(solution.network.points))


def rejected_points(solution: Solution) -> Mask:
    """(n,) True for points without a place and for those that have rays of which none took part."""
    lost = (solution.network.ray_counts > 0) & (used_ray_counts(solution) == 0)
    return np.asarray(~solution.determined | lost)


def rejected_rays(solution: Solution) -> Mask:
    """(k,) True for measures judged blunders, which those of points that were never determined are not; an older
    solution doesn't tell those of points lost by rejection.
    """
    network, judged = solution.network, solution.rays_rejected
    if judged is None:
        return np.asarray(~solution.rays_used & solution.determined[network.rays.point])
    return np.asarray(judged & ~network.undetermined[network.rays.point])


@dataclass(frozen=True, slots=True)
class RangeStatistics:
    """Laser ranges; residuals, measured minus predicted, of those that took part."""

    count: int
    """Number of all ranges."""
    used: int
    """Number of ranges that took part."""
    mean: float
    """m."""
    rms: float
    """m."""
    mean_before: float
    """m, with the nominal orientation."""
    rms_before: float
    """m, with the nominal orientation."""


def range_statistics(solution: Solution) -> RangeStatistics:
    """Residuals of the ranges before and after."""
    used = solution.ranges_used
    after, before = mean_and_rms(solution.range_residuals[used]), mean_and_rms(solution.range_residuals_before[used])
    numbers = (float(value) for value in (*after, *before))
    return RangeStatistics(used.size, int(used.sum()), *numbers)


def laser_gain(solution: Solution) -> float:
    """How many times larger the tie points' median sigmas would be without the laser rows (mean ones, where an older
    version didn't say); NaN where that isn't known.
    """
    mean, median = solution.sigmas_without_laser, solution.median_sigmas_without_laser
    if mean is None:
        return float("nan")
    ties = point_statistics(solution, PointClass.TIE)
    without, with_laser = (mean, ties.mean_sigma) if median is None else (median, ties.median_sigma)
    return float(np.linalg.norm(without) / np.linalg.norm(with_laser))


def local_sigmas(covariances: Array, points: Array) -> Array:
    """(n, 3) m, standard deviations towards east, north and up (radially) of points (n, 3) in m, body-fixed, of
    covariances (n, 3, 3) in m^2.
    """
    return sigmas_along(east_north_up(points), covariances)


def sigmas_along(axes: Array, covariances: Array) -> Array:
    """(n, a) standard deviations along unit vectors (n, a, 3), of covariances (n, 3, 3)."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("nai,nij,naj->na", axes, covariances, axes), 0.0)))


def solution_connectivity(solution: Solution) -> Connectivity:
    """By the rays that were used, with the footprints of the adjusted orientation."""
    result = _CONNECTED.get(solution)
    if result is None:
        footprints = network_footprints(solution.network, solution.places, solution.correction)
        result = _CONNECTED[solution] = connectivity(solution.network, footprints, solution.rays_used)
    return result


SHARE = 0.98
"""Share of the values that a colour scale covers, on either side."""


def medians(values: Array, groups: Index, number: int) -> Array:
    """(number,) median of the finite values (n,) of each group (n,), counted from 0; NaN where there are none."""
    sound = np.isfinite(values)
    values, groups = values[sound], groups[sound]
    by_value = np.argsort(values)  # with sorted groups, of few bits, a third of the time of np.lexsort
    order = by_value[np.argsort(groups[by_value].astype(np.min_scalar_type(number)), kind="stable")]
    ordered, of, middle = values[order], np.bincount(groups, minlength=number), np.full(number, np.nan)
    first, some = np.cumsum(of) - of, of > 0
    low, high = (ordered[(first + shift)[some]] for shift in ((of - 1) // 2, of // 2))
    middle[some] = 0.5 * (low + high)
    return middle


def used_rays(solution: Solution) -> Mask:
    """(k,) rays that took part and whose point is determined."""
    return np.asarray(
        solution.rays_used & np.isfinite(solution.residuals[:, 0]) & np.isfinite(solution.residuals[:, 1])
    )


def median_residuals(solution: Solution) -> Array:
    """(images,) median residual of each image's rays that took part, in units of their sigmas, of a ray the larger one
    of line and sample; NaN where there are none. Blunders hardly change it.
    """
    rays = solution.network.rays
    used = np.flatnonzero(used_rays(solution))
    size = np.max(np.abs(solution.residuals[used]) / solution.network.ray_sigmas[used], axis=1)
    return medians(size, rays.image[used], len(solution.network.images))


def worst_first(solution: Solution) -> Index:
    """(images,) images by their median residuals, largest first; those without any come last."""
    return np.argsort(-np.nan_to_num(median_residuals(solution), nan=-1.0), kind="stable")


def span(values: Array) -> tuple[float, float]:
    """Ends of a color scale: zero, or the 2 % quantile where that is less, for small differences should look small; the
    98 % quantile of the finite values. 0 and 1 where there are none.
    """
    sound = values[np.isfinite(values)]
    if not sound.size:
        return 0.0, 1.0
    low, high = np.quantile(sound, [1.0 - SHARE, SHARE]).tolist()
    return min(low, 0.0), max(high, 1e-12)


def pass_turns(network: Network, pass_number: int, times: Array, angles: Angles) -> Array:
    """(n, 6, 6) from the components of a pass's corrections, m and rad, to along, across and radial, roll, pitch and
    yaw of its flight, at times (n,) in s TDB past J2000.

    Each time is taken from an image of the pass that knows it (`network.joining.nominal_poses`).
    """
    pose = nominal_poses(network.pictures(pass_number), times, network.passes[pass_number].axes)
    axes = OrientationCorrection(np.zeros((1, 6)), angles).axes(pose, Moments.of_times(times, 0.0))
    return _turns(pose, axes)


def _turns(pose: Pose, axes: Array) -> Array:
    """(n, 6, 6) from components of corrections to the axes of the flight; `axes` (n, 3, 3) are how the camera turns
    about its own axes per rad of each rotation component.
    """
    turns = np.zeros((axes.shape[0], 6, 6))
    for k, (position, velocity) in enumerate(zip(pose.position, pose.velocity, strict=True)):
        level = flight_axes(position, velocity)
        turns[k, :3, :3] = level
        turns[k, 3:, 3:] = camera_axes(pose.matrix[k] @ level[0]) @ axes[k]
    return turns


@dataclass(frozen=True, slots=True, eq=False)
class PassCorrections:
    """Corrections of a pass at some times, in the axes of the flight."""

    times: Array
    """(n,) s TDB past J2000."""
    values: Array
    """(n, 6) m along, across and radial, and rad of roll, pitch and yaw."""
    sigmas: Array
    """(n, 6) m and rad, standard deviations of `values`, for sigma0 = 1."""


def pass_corrections(solution: Solution, pass_: str | int, times: Array) -> PassCorrections:
    """Corrections of a pass at times (n,) in s TDB past J2000, by the four nodes nearest to each."""
    pass_ = solution.network.pass_number(pass_)
    nodes = solution.network.passes[pass_].nodes
    first, basis, _ = nodes.at(times - nodes.epoch, nodes.epoch)
    values = np.einsum("nk,nkc->nc", basis, solution.nodes[pass_][first[:, None] + np.arange(SUPPORT)])
    variable = int(solution.network.first_of_passes[pass_])
    covariance = np.empty((times.size, 6, 6))
    for k, members in by_value(first):
        joint = solution.joint_covariance.of(range(variable + k, variable + k + SUPPORT))
        joint = joint.reshape(SUPPORT, 6, SUPPORT, 6)
        covariance[members] = np.einsum("np,piqj,nq->nij", basis[members], joint, basis[members])
    turn = pass_turns(solution.network, pass_, times, solution.settings.angles)
    sigmas = np.sqrt(np.maximum(np.einsum("nij,njk,nik->ni", turn, covariance, turn), 0.0))
    return PassCorrections(times, np.einsum("nij,nj->ni", turn, values), sigmas)


@dataclass(frozen=True, slots=True, eq=False)
class PassReport(Record):
    """Nodes, corrections and trend of one pass."""

    name: str
    """Name of the pass."""
    basis: str
    """Interpolation between its nodes."""
    images: tuple[str, ...]
    """Names of its images."""
    nodes: int
    """Number of nodes."""
    spacing: float
    """s between nodes, on the average."""
    lines: float
    """Lines of the most nadir-looking image between two nodes."""
    ground: float
    """m on the ground between two nodes; NaN where that image misses the body."""
    corrections: PassCorrections
    """Corrections at the nodes within the pass."""
    trend: tuple[tuple[str, str, float, float], ...]
    """Bias and drift of the observed trajectory: "bias" or "drift", component (of the camera's own axes), value and
    sigma in m or rad."""

    @property
    def largest(self) -> Array:
        """(6,) m and rad, largest correction at a node."""
        return np.asarray(np.abs(self.corrections.values).max(axis=0))

    @property
    def mean_sigmas(self) -> Array:
        """(6,) m and rad, mean sigma of the nodes."""
        return np.asarray(self.corrections.sigmas.mean(axis=0))


def pass_reports(solution: Solution) -> list[PassReport]:
    """Nodes, corrections and trend of each pass, in their order; none where no images were taken in one pass.

    Examples
    --------
    >>> mgsgraph.pass_reports(solution)  # of two images, neither in a pass; an example with passes: docs/passes.md
    []
    """
    return [_report(solution, k) for k in range(len(solution.network.passes))]


def node_times(solution: Solution, pass_: str | int) -> Array:
    """(k,) s TDB past J2000 of the nodes of a pass."""
    nodes = solution.network.passes[solution.network.pass_number(pass_)].nodes
    return nodes.times + nodes.epoch


def _report(solution: Solution, pass_number: int) -> PassReport:
    pass_, pictures = solution.network.passes[pass_number], solution.network.pictures(pass_number)
    image = pictures[straightest(pictures)]
    start, stop = seconds(image)
    spacing = pass_.nodes.spacing
    lines = spacing * image.lines / (stop - start)
    _, derivative = image.image_to_ground(*image.middle)
    return PassReport(
        pass_.name, pass_.nodes.basis, tuple(picture.name for picture in pictures),
        len(pass_.nodes), spacing, lines, float(np.linalg.norm(derivative[0, :, 0])) * lines,
        pass_corrections(solution, pass_number, node_times(solution, pass_number)), _trend(solution, pass_number),
    )  # fmt: skip


def _trend(solution: Solution, pass_number: int) -> tuple[tuple[str, str, float, float], ...]:
    prior, values = solution.network.passes[pass_number].prior, solution.trends[pass_number]
    if not isinstance(prior, NodePrior) or not values.size:
        return ()
    variable = int(solution.network.first_of_passes[pass_number + 1]) - 1
    sigmas = sigmas_of(solution.joint_covariance.block(variable, variable))
    biases = int(np.count_nonzero(prior.bias))
    return tuple(
        ("bias" if c < biases else "drift", AXES[component], float(values[c]), float(sigmas[c]))
        for c, component in enumerate(prior.trend_components.tolist())
    )


def prior_sigmas(pass_: Pass, rows: Array) -> Array:
    """(r,) a-priori sigmas of functions of a pass's nodes; infinite where its prior does not determine all nodes.

    Parameters
    ----------
    pass_ : Pass
        With k nodes; its prior's rows are sparse, and so is what is solved.
    rows : (r, 6 k)
        Per m and rad of the nodes, one after another.
    """
    from scipy.sparse.linalg import splu

    scales = np.concatenate([np.where(np.isfinite(sigmas), sigmas, 1.0) for sigmas in pass_.sigmas])
    root = whitened_rows(pass_, scales)
    wanted = np.pad(rows, ((0, 0), (0, scales.size - rows.shape[1]))) * scales
    try:
        solved = splu((root.T @ root).tocsc()).solve(np.ascontiguousarray(wanted.T))
    except RuntimeError:  # singular: nodes of which nothing is known
        return np.full(rows.shape[0], np.inf)
    return np.asarray(np.sqrt(np.maximum(np.einsum("rc,cr->r", wanted, solved), 0.0)))


def whitened_rows(pass_: Pass, scales: Array) -> "csr_array":
    """(rows, columns) whitened rows of the prior on nodes and trend, in units of `scales` (columns,)."""
    from scipy.sparse import csr_array

    first, parts, height = np.concatenate([[0], np.cumsum(pass_.widths)]), list[tuple[Index, Index, Array]](), 0
    for factor in pass_.prior.factors(pass_.nodes):
        for unknown, block in zip(factor.unknowns, factor.blocks, strict=True):
            row, column = np.nonzero(block)
            place = first[unknown] + column
            parts.append((height + row, place, block[row, column] * scales[place]))
        height += factor.blocks[0].shape[0]
    row, column, value = (np.concatenate(part) for part in zip(*parts, strict=True))
    return csr_array((value, (row, column)), shape=(height, scales.size))
