"""What the nominal orientation makes of a network, before anything is solved.

Residuals with the nominal orientation beside what the a-priori sigmas let expect of them, before anything is solved.

Rays of a point, by nominal orientations, miss each other by the images' errors alone, whatever its height. An error of
orientation within its sigmas moves an image's places by so many pixels at most; where residuals are several times
larger, no adjustment within these sigmas explains them: images, lines and samples, or labels are interchanged.

Ranges to footprints whose places are known miss by the orbit's errors, which the shots of an image have in common: a
mean far above those is of the ranges themselves, or of the footprints.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.covariances import orientation_covariance, point_covariances
from mgsgraph.adjustment.datum.datum import require_strength
from mgsgraph.adjustment.graph import BundleGraph, Layout, lay_out
from mgsgraph.adjustment.graph.bundle import IN_PROCESS, Sweeper
from mgsgraph.adjustment.predicted_lines import exactly, settled
from mgsgraph.adjustment.residuals import Residuals, residuals
from mgsgraph.adjustment.rounds import Selection, determined_points, everything, without_weak
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError
from mgsgraph.files.tie_points import PointKind
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.reduction import Reduction
from mgsgraph.kernel.rows import PRIOR
from mgsgraph.network import Network, SharedKind, SharedUnknown
from mgsgraph.network.shared import ground_shift


@dataclass(frozen=True, slots=True, eq=False)
class Nominal:
    """What the nominal orientation makes of the network."""

    places: Array
    """(n, 3) m, network order: a-priori places; for free points the intersection of their rays."""
    residuals: Residuals
    """There."""


def nominal_state(layout: Layout, before: Reduction, sweeper: Sweeper = IN_PROCESS) -> Nominal:
    """Places and residuals with the nominal orientation; `before` is the reduction there."""
    places = np.where((layout.rows.kind == PRIOR)[:, None], layout.rows.start, before.points)
    kept, orientation = layout.network_order(places), np.zeros(layout.columns)
    layout, places = exactly(layout, orientation, places, sweeper)  # a-priori places are not where the rays alone meet
    return Nominal(kept, residuals(layout, orientation, places, sweeper))


def nominal_reduction(
    layout: Layout, sweeper: Sweeper = IN_PROCESS, left_in: Selection | None = None
) -> tuple[Layout, Selection, Reduction]:
    """All points that are determined, and their reduction with the nominal orientation, rays laid out about the lines
    that it predicts.

    Raises PointBehindCamera, and WeakNetwork where nothing determines some direction of the orientation.
    """
    wanted, nominal = left_in or everything(layout.network), np.zeros(layout.columns)
    selection = wanted.without_stereo()
    before = BundleGraph(layout, selection.rows(layout), sweeper).reduction(nominal)
    strong = without_weak(layout, before, selection)
    if np.all(strong.out):
        raise InputError(
            "network",
            f"none of {len(layout.network.points)} points is determined by its rays",
            "points seen from two sides, or with an a-priori place",
        )
    if not np.array_equal(strong.out, selection.out):
        selection, before = strong, BundleGraph(layout, strong.rows(layout), sweeper).reduction(nominal)
    require_strength(layout, before)

    def again(anew: Layout) -> Reduction:
        return BundleGraph(anew, selection.rows(anew), sweeper).reduction(nominal)

    layout, before = settled(layout, before, again, own=True, sweeper=sweeper)
    return layout, replace(selection, stereo=wanted.stereo), before


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """What the geometry and the a-priori sigmas alone say, before anything is solved."""

    places: Array
    """(n, 3) m, where the nominal orientation puts the points; NaN for undetermined ones."""
    covariances: Array
    """(n, 3, 3) m^2, of the points after the adjustment, for sigma0 = 1; NaN for undetermined ones."""
    residuals: Array
    """(k, 2) pixels, with the nominal orientation."""
    range_residuals: Array
    """(r,) m, with the nominal orientation."""


def predict(network: Network, settings: SolverSettings) -> Prediction:
    """Covariances that an adjustment of the network will have; raises what `adjust_network` raises before solving."""
    network.require_observed()
    layout, selection, before = nominal_reduction(lay_out(network, settings))
    rows, orientation = selection.rows(layout), np.zeros(layout.columns)
    joint = orientation_covariance(BundleGraph(layout, rows), before)
    covariances = point_covariances(layout, rows, orientation, before.points, joint)
    nominal = nominal_state(layout, before)
    blank = layout.network_order(np.where(determined_points(rows), 1.0, np.nan))
    return Prediction(
        nominal.places * blank[:, None],
        layout.network_order(covariances) * blank[:, None, None],
        nominal.residuals.image * blank[network.rays.point][:, None],
        nominal.residuals.ranges,
    )


_BEYOND = 5.0
"""Expected sizes beyond which residuals are named; of 10,000 images none is by chance."""
_FEWEST = 3
"""Measures of an image without which nothing is said of it."""


class Unexplained(NamedTuple):
    """An image whose nominal residuals its priors don't explain."""

    image: int
    """Which."""
    median: float
    """pixels, of the length of its residuals."""
    expected: float
    """pixels, one sigma of them by the priors of all images together; an upper limit."""


class UnexplainedRanges(NamedTuple):
    """An image whose laser ranges have a mean residual that its orbit's sigmas don't explain."""

    image: int
    """Which."""
    mean: float
    """m, measured minus nominal."""
    expected: float
    """m, one sigma of it by those of the orbit, the footprints and the ranges; an upper limit."""



def unexplained_residuals(network: Network, residuals: Array) -> tuple[Unexplained, ...]:
    """Images whose residuals (k, 2), pixels, with the nominal orientation, are too large for the a-priori sigmas of
    orientation, of passes and of the unknowns that images share.
    """
    expected = np.array([_pixels(network, j) for j in range(len(network.images))])
    whole = float(np.sqrt(np.sum(expected**2)))
    found = list[Unexplained]()
    rays, size = network.rays, np.linalg.norm(residuals, axis=1)
    ground = np.hypot(_place_sigmas(network), _shift_sigmas(network))[rays.point]
    for j in range(len(network.images)):
        mine = np.flatnonzero((rays.image == j) & np.isfinite(size))
        if mine.size < _FEWEST:
            continue
        sigma = np.hypot(whole, float(np.median(np.linalg.norm(rays.sigmas[mine], axis=1))))
        sigma = float(np.hypot(sigma, np.median(ground[mine]) / _scale(network, j)[0]))
        median = float(np.median(size[mine]))
        if median > _BEYOND * sigma:
            found.append(Unexplained(j, median, sigma))
    return tuple(sorted(found, key=lambda one: -one.median))


def unexplained_ranges(network: Network, residuals: Array) -> tuple[UnexplainedRanges, ...]:
    """Images whose range residuals (r,), m, with the nominal orientation, have too large a mean for the a-priori sigmas
    of orbit and footprints, all of whose errors are taken to be common.

    Nothing is said of images that share unknowns by which ranges change.
    """
    ranges, points, found = network.ranges, network.points, list[UnexplainedRanges]()
    places, shifts = _place_sigmas(network), _shift_sigmas(network)
    felt = [one for one in network.shared if one.kind.acts_on_ranges or one.kind.moves_footprints]
    moved = {j for one in felt for j in one.images.tolist()}
    for j in np.unique(ranges.image).tolist():
        mine = np.flatnonzero((ranges.image == j) & np.isfinite(residuals))
        mine = mine[points.kinds[ranges.point[mine]] != PointKind.FREE]
        if mine.size < _FEWEST or j in moved:
            continue
        orbit = 0.0 if network.held[j] else float(np.linalg.norm(_sigmas(network, j)[:, :3]))
        ground, shift = (float(np.median(one[ranges.point[mine]])) for one in (places, shifts))
        common = ground, float(np.median(ranges.sigmas[mine])), orbit, shift
        sigma, mean = float(np.linalg.norm(common)), float(np.mean(residuals[mine]))
        if abs(mean) > _BEYOND * sigma:
            found.append(UnexplainedRanges(j, mean, sigma))
    return tuple(sorted(found, key=lambda one: -abs(one.mean)))


def _place_sigmas(network: Network) -> Array:
    """(n,) m, of the a-priori places of points, all axes together."""
    return np.asarray(np.sqrt(np.trace(network.points.covariances, axis1=1, axis2=2)))


def _shift_sigmas(network: Network) -> Array:
    """(n,) m, of the shifts of the profiles that points are of, both directions together."""
    if network.shifts is None:
        return np.zeros(len(network.points))
    return np.asarray(np.sqrt(2.0) * np.append(network.shifts.sigmas, 0.0)[network.shifts.profile])


def _sigmas(network: Network, image: int) -> Array:
    """(k, 6) m and rad, of an image's own coefficients; of an image of a pass (1, 6), the largest of its nodes."""
    owner = int(network.pass_of[image])
    if owner < 0:
        return network.priors[image].sigmas
    one = network.passes[owner]
    return np.asarray(one.prior.own_sigmas(one.nodes).max(axis=0)[None])


def _pixels(network: Network, image: int) -> float:
    """pixels, by which an image's places are off by one sigma of all that moves them together, at most."""
    sigmas = np.zeros((1, 6)) if network.held[image] else _sigmas(network, image)
    spacing, away = _scale(network, image)
    own = np.hypot(np.linalg.norm(sigmas[:, :3]), np.linalg.norm(sigmas[:, 3:]) * away) / spacing
    shared = [_shared_pixels(network, image, one, spacing) for one in network.shared]
    return float(np.hypot(own, np.linalg.norm(shared)))


def _shared_pixels(network: Network, image: int, one: SharedUnknown, spacing: float) -> float:
    """pixels, by which an image's places are off by one sigma of a shared unknown; infinite where that isn't known."""
    picture = network.images[image]
    if not (one.of(image) and one.kind.acts_on_rays):
        return 0.0
    if one.kind is SharedKind.FOCAL_LENGTH:
        return float(one.sigmas[0] / picture.interior.focal_length * 0.5 * picture.samples)
    if one.kind.is_interior:  # m in the focal plane, of radial distortion at the farthest pixel
        return float(np.linalg.norm(one.sigmas)) / (picture.pixel_angle * picture.interior.focal_length)
    if not one.kind.moves_pose or picture.trajectory.spin is None:
        return np.inf
    moved = np.linalg.norm(ground_shift(picture, one.kind), axis=1)
    return float(np.linalg.norm(moved * one.sigmas)) / spacing


def _scale(network: Network, image: int) -> tuple[float, float]:
    """In an image's middle: m per line or sample on the ground, the smaller one, and m from the camera to there."""
    one = network.images[image]
    line, sample = np.array([0.5 * one.lines]), np.array([0.5 * one.samples])
    point, derivative = one.image_to_ground(line, sample)
    away = np.linalg.norm(point[0] - one.pose(line).position[0])
    return float(np.linalg.norm(derivative[0], axis=0).min()), float(away)
