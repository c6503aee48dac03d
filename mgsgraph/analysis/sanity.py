"""Sanity checks: observations that were left out, and nominal residuals beyond what priors explain.

An optimizer converges on any remaining observations. Robust estimates and rejection are valid while more than half of
the observations of a kind are good, and no estimate is valid beyond (breakdown point; Rousseeuw & Leroy 1987, section
1.2): where most are left out, the remaining ones may be the wrong ones.
"""

from enum import StrEnum
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import medians, ray_statistics, rejected_points
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network, PointClass, SharedKind, SharedUnknown
from mgsgraph.network.shared import ground_shift

MOST = 0.5
"""Share of a kind of observations beyond which what is left of it proves nothing."""
MANY = 0.2
"""Share from which on it is worth a warning: blunders are single ones, so many have a cause in common."""
_FEWEST = 3
"""Fewer observations of a kind are not judged by their share, unless all are lost."""


class Kind(StrEnum):
    """What may be left out."""

    TIES = "tie points"
    LASER = "laser points"
    CONTROL = "control points"
    POSTS = "posts of the terrain model"
    RANGES = "laser ranges"
    SHOTS = "heights above stereo surfaces"
    IMAGE = "image measures"


_OF_CLASS = {
    PointClass.TIE: Kind.TIES, PointClass.LASER: Kind.LASER, PointClass.CONTROL: Kind.CONTROL,
    PointClass.POST: Kind.POSTS,
}  # fmt: skip


class Loss(NamedTuple):
    """Observations of one kind that did not take part."""

    kind: Kind
    """Of what kind."""
    image: str
    """Name of their image, of image measures; else empty."""
    left_out: int
    """How many did not take part."""
    total: int
    """Of so many."""

    @property
    def share(self) -> float:
        """Share that did not take part."""
        return self.left_out / self.total

    @property
    def fatal(self) -> bool:
        """Whether what is left proves nothing."""
        return self.left_out == self.total or (self.total >= _FEWEST and self.share > MOST)

    @property
    def large(self) -> bool:
        """Whether it is worth a warning."""
        return self.total >= _FEWEST and self.share > MANY


def losses(solution: Solution) -> tuple[Loss, ...]:
    """Kinds of observations of which many are left out, the most first."""
    network, rays = solution.network, ray_statistics(solution)
    rejected, table = rejected_points(solution), list[Loss]()
    for point_class, kind in _OF_CLASS.items():
        members = network.points.classes == point_class
        members[network.points.checkpoints] = False  # they take no part
        table.append(Loss(kind, "", int(np.count_nonzero(rejected & members)), int(np.count_nonzero(members))))
    ranges = solution.ranges_used
    table.append(Loss(Kind.RANGES, "", int(np.count_nonzero(~ranges)), ranges.size))
    if network.stereo is not None:
        on = network.stereo.surface >= 0
        table.append(Loss(Kind.SHOTS, "", int(np.count_nonzero(on & ~solution.stereo_used)), int(np.count_nonzero(on))))
    unplaced = np.isin(network.rays.point, network.points.checkpoints) & rejected[network.rays.point]
    totals = rays.total - np.bincount(network.rays.image[unplaced], minlength=len(network.images))
    for j, (total, used) in enumerate(zip(totals.tolist(), rays.count.sum(axis=1).tolist(), strict=True)):
        table.append(Loss(Kind.IMAGE, network.images[j].name, total - used, total))
    worth = [loss for loss in table if loss.total and (loss.fatal or loss.large)]
    return tuple(sorted(worth, key=lambda loss: -loss.share))


_BEYOND = 5.0
"""Expected sizes beyond which residuals are named; of 10,000 images none is by chance."""
_MOST_RAYS = 100_000
"""Rays from which medians are taken."""
_FEWEST_MEASURES = 3
"""Measures of an image without which nothing is said of it."""


class Unexplained(NamedTuple):
    """An image whose nominal residuals its priors don't explain."""

    image: int
    """Which."""
    size: float
    """pixels, median length of its image residuals; or m, mean of its ranges', measured minus nominal."""
    expected: float
    """One sigma of it by the priors of all that moves them; an upper limit."""


def unexplained_residuals(network: Network, residuals: Array) -> tuple[Unexplained, ...]:
    """Images whose residuals (k, 2), pixels, with the nominal orientation, are too large for the a-priori sigmas of
    orientation, of passes and of the unknowns that images share.
    """
    images, rays = len(network.images), network.rays
    scale = np.array([_scale(network, j) for j in range(images)])
    expected = np.array([_pixels(network, j, *scale[j].tolist()) for j in range(images)])
    total = float(np.sqrt(np.sum(expected**2)))
    rows = np.flatnonzero(np.isfinite(residuals[:, 0]))[:: -(-residuals.shape[0] // _MOST_RAYS) or 1]
    image, point = rays.image[rows], rays.point[rows]
    ground = np.hypot(_position_sigmas(network)[point], _shift_sigmas(network)[point])
    size, noise, control = (
        medians(values, image, images)
        for values in (*(np.linalg.norm(each[rows], axis=1) for each in (residuals, network.ray_sigmas)), ground)
    )
    sigma = np.sqrt(total**2 + noise**2 + (control / scale[:, 0]) ** 2)
    several = np.bincount(image, minlength=images) >= _FEWEST_MEASURES
    beyond = np.flatnonzero(several & (size > _BEYOND * sigma))
    images_beyond = [Unexplained(j, float(size[j]), float(sigma[j])) for j in beyond.tolist()]
    return tuple(sorted(images_beyond, key=lambda image: -image.size))


def unexplained_ranges(network: Network, residuals: Array) -> tuple[Unexplained, ...]:
    """Images whose range residuals (r,), m, with the nominal orientation, have too large a mean for the a-priori sigmas
    of orbit and footprints, all of whose errors are taken to be common.

    Nothing is said of images that share unknowns by which ranges change.
    """
    ranges, points, unexplained = network.ranges, network.points, list[Unexplained]()
    places, shifts = _position_sigmas(network), _shift_sigmas(network)
    felt = [shared for shared in network.shared if shared.kind.acts_on_ranges or shared.kind.moves_footprints]
    moved = {j for shared in felt for j in shared.images.tolist()}
    for j in np.unique(ranges.image).tolist():
        rows = np.flatnonzero((ranges.image == j) & np.isfinite(residuals))
        rows = rows[points.kinds[ranges.point[rows]] != PointKind.FREE]
        if rows.size < _FEWEST_MEASURES or j in moved:
            continue
        orbit = 0.0 if network.held[j] else float(np.linalg.norm(_sigmas(network, j)[:, :3]))
        ground, shift = (float(np.median(sigmas[ranges.point[rows]])) for sigmas in (places, shifts))
        common = ground, float(np.median(ranges.sigmas[rows])), orbit, shift
        sigma, mean = float(np.linalg.norm(common)), float(np.mean(residuals[rows]))
        if abs(mean) > _BEYOND * sigma:
            unexplained.append(Unexplained(j, mean, sigma))
    return tuple(sorted(unexplained, key=lambda image: -abs(image.size)))


def _position_sigmas(network: Network) -> Array:
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
    pass_ = network.passes[owner]
    return np.asarray(pass_.prior.own_sigmas(pass_.nodes).max(axis=0)[None])


def _pixels(network: Network, image: int, spacing: float, away: float) -> float:
    """pixels, by which an image's places are off by one sigma of all that moves them together, at most."""
    sigmas = np.zeros((1, 6)) if network.held[image] else _sigmas(network, image)
    of_orientation = np.hypot(np.linalg.norm(sigmas[:, :3]), np.linalg.norm(sigmas[:, 3:]) * away) / spacing
    shared = [_shared_pixels(network, image, unknown, spacing) for unknown in network.shared]
    return float(np.hypot(of_orientation, np.linalg.norm(shared)))


def _shared_pixels(network: Network, image: int, unknown: SharedUnknown, spacing: float) -> float:
    """pixels, by which an image's places are off by one sigma of a shared unknown; infinite where that isn't known."""
    picture = network.images[image]
    if not (unknown.of(image) and unknown.kind.acts_on_rays):
        return 0.0
    if unknown.kind is SharedKind.FOCAL_LENGTH:
        return float(unknown.sigmas[0] / picture.interior.focal_length * 0.5 * picture.samples)
    if unknown.kind.is_interior:  # m in the focal plane, of radial distortion at the farthest pixel
        return float(np.linalg.norm(unknown.sigmas)) / (picture.pixel_angle * picture.interior.focal_length)
    if not unknown.kind.moves_pose or picture.trajectory.spin is None:
        return np.inf
    moved = np.linalg.norm(ground_shift(picture, unknown.kind), axis=1)
    return float(np.linalg.norm(moved * unknown.sigmas)) / spacing


def _scale(network: Network, image: int) -> tuple[float, float]:
    """In an image's middle: m per line or sample on the ground, the smaller one, and m from the camera to there."""
    picture = network.images[image]
    line, sample = picture.middle
    point, derivative = picture.image_to_ground(line, sample)
    away = np.linalg.norm(point[0] - picture.pose(line).position[0])
    return float(np.linalg.norm(derivative[0], axis=0).min()), float(away)
