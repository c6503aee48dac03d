"""The network laid out for the kernel: points sorted by the set of orientation variables that they touch.

What of an observation doesn't change during an adjustment is worked out here, once: nominal pose at the measured line
and its rates, basis values, the undistorted focal-plane place.
"""

import itertools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError
from mgsgraph.factors.rows import (
    CAMERA,
    CAUCHY,
    FIXED,
    FREE,
    HUBER,
    MEASURED,
    NO_LOSS,
    OPK_PAPER,
    OPK_PEER,
    OUT,
    PREDICTED,
    PRIOR,
    TUKEY,
    Groups,
    Model,
    Rows,
)
from mgsgraph.geometry import rotation
from mgsgraph.geometry.intersection import intersect_rays
from mgsgraph.geometry.orientation import polynomial
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.network import ImageRays, Network, Ranges
from mgsgraph.ties import PointKind

_LINES = {"predicted": PREDICTED, "measured": MEASURED}
_ANGLES = {"camera": CAMERA, "opk-paper": OPK_PAPER, "opk-peer": OPK_PEER}
_LOSSES = {"none": NO_LOSS, "huber": HUBER, "cauchy": CAUCHY, "tukey": TUKEY}
_CHUNK = 1024
"""Points per piece of parallel work."""
_PARALLEL = 1e-12
"""rad: rays closer to parallel than this start on the ellipsoid instead of at their intersection."""


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Rows of a network in the kernel's order, and the way back."""

    network: Network
    """What is adjusted."""
    model: Model
    """Forms of the measurement model."""
    rows: Rows
    """All rows, at full weight."""
    groups: Groups
    """Points by set of orientation variables."""
    group_images: tuple[tuple[int, ...], ...]
    """Images (not held) of each group, in the order of their columns within it."""
    first_column: Index
    """(images,) first column of each image's coefficients in the orientation vector; -1 when held."""
    sigmas: Array
    """(columns,) a-priori sigmas of the orientation vector, m and rad; infinite where nothing is known."""
    point_order: Index
    """(n,) network point at each place of the layout."""
    ray_order: Index
    """(k,) network ray at each place of the layout."""
    range_order: Index
    """(r,) network range at each place of the layout."""

    @property
    def columns(self) -> int:
        """Number of orientation unknowns."""
        return int(self.sigmas.size)

    def columns_of(self, image: int) -> slice:
        """Columns of one image's coefficients."""
        first = int(self.first_column[image])
        return slice(first, first + self.network.priors[image].sigmas.size)

    def group_columns(self, group: int) -> Index:
        """Columns of a group's variables, in the order of its own columns."""
        parts = [np.arange(self.columns)[self.columns_of(j)] for j in self.group_images[group]]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)

    @property
    def scales(self) -> Array:
        """(columns,) units in which the orientation vector is of order one: a-priori sigmas, else 1 km and 10 mrad."""
        plain = np.tile(np.repeat([1e3, 1e-2], 3), self.columns // 6)
        return np.where(np.isinf(self.sigmas), plain, self.sigmas)

    def adjusted_images(self) -> list[int]:
        """Images whose orientation is adjusted."""
        return [int(j) for j in np.flatnonzero(self.first_column >= 0)]

    def active(self, rays: Mask, ranges: Mask, out: Mask) -> Rows:
        """Rows with some left out: rays (k,), ranges (r,) that take part, points (n,) that don't; network order."""
        kind = self.rows.point_kind.copy()
        kind[out[self.point_order]] = OUT
        return self.rows._replace(
            point_kind=kind,
            weight=self.rows.weight * rays[self.ray_order][:, None],
            range_weight=self.rows.range_weight * ranges[self.range_order],
        )

    def without_loss(self) -> "Layout":
        """The same layout with the plain quadratic loss."""
        return replace(self, model=self.model._replace(loss=NO_LOSS))


def lay_out(network: Network, settings: SolverSettings) -> Layout:
    """Lay a network out for the kernel.

    Raises
    ------
    InputError
        When a point that nothing else places lies on a ray that misses the body.
    """
    model = Model(_LINES[settings.line], _ANGLES[settings.angles], _LOSSES[settings.loss], settings.width)
    first_column, sigmas = _columns(network)
    group_images, group_of_point = _group_points(network, first_column >= 0)
    point_order = np.argsort(group_of_point, kind="stable")
    place_of = np.empty_like(point_order)
    place_of[point_order] = np.arange(point_order.size)
    ray_order = np.lexsort((network.rays.image, place_of[network.rays.point]))
    range_order = np.argsort(place_of[network.ranges.point], kind="stable")
    local = _local_columns(network, group_images)
    starts = _starting_places(network)
    rows = Rows(
        **_point_arrays(network, point_order, starts),
        **_ray_arrays(network, ray_order, place_of, model, first_column, local, group_of_point, starts),
        **_range_arrays(network, range_order, place_of, first_column, local, group_of_point),
    )
    groups = _groups(network, group_images, group_of_point[point_order])
    return Layout(network, model, rows, groups, group_images, first_column, sigmas, point_order, ray_order, range_order)


def _columns(network: Network) -> tuple[Index, Array]:
    """First column of each image (-1 when held), and the prior sigmas of all columns."""
    first = np.full(len(network.images), -1, dtype=np.int64)
    sigmas: list[Array] = []
    width = 0
    for j, prior in enumerate(network.priors):
        if not network.held[j]:
            first[j] = width
            width += prior.sigmas.size
            sigmas.append(prior.sigmas.ravel())
    return first, np.concatenate(sigmas) if sigmas else np.zeros(0)


def _group_points(network: Network, adjusted: Mask) -> tuple[tuple[tuple[int, ...], ...], Index]:
    """Sort points by the set of adjusted images that see them or carry a range of theirs.

    Sets are told apart by the sum of a 63-bit random number per image: one pass, no Python per point.
    """
    pairs = np.unique(
        np.concatenate(
            [
                np.stack([network.rays.point, network.rays.image], axis=1),
                np.stack([network.ranges.point, network.ranges.image], axis=1),
            ]
        ),
        axis=0,
    )
    pairs = pairs[adjusted[pairs[:, 1]]]
    marks = np.random.default_rng(0).integers(1, 2**62, len(network.images), dtype=np.uint64)
    signature = np.zeros(len(network.points), dtype=np.uint64)
    np.add.at(signature, pairs[:, 0], marks[pairs[:, 1]])
    _, example, group = np.unique(signature, return_index=True, return_inverse=True)
    images_of = np.searchsorted(pairs[:, 0], example), np.searchsorted(pairs[:, 0], example, side="right")
    sets = tuple(tuple(int(j) for j in pairs[a:b, 1]) for a, b in zip(*images_of, strict=True))
    return sets, group.reshape(-1).astype(np.int64)


def _local_columns(network: Network, group_images: tuple[tuple[int, ...], ...]) -> Index:
    """(groups, images) first column of an image within a group's own columns; -1 when it isn't in it."""
    local = np.full((len(group_images), len(network.images)), -1, dtype=np.int64)
    for group, images in enumerate(group_images):
        sizes = [network.priors[j].sigmas.size for j in images]
        local[group, list(images)] = np.concatenate([[0], np.cumsum(sizes)[:-1]]) if images else []
    return local


def _groups(network: Network, group_images: tuple[tuple[int, ...], ...], sorted_group: Index) -> Groups:
    sizes = np.array([prior.sigmas.size for prior in network.priors])
    dimension = np.array([sizes[list(images)].sum() for images in group_images], dtype=np.int64)
    chunks = []
    for group in range(len(group_images)):
        first, last = np.searchsorted(sorted_group, [group, group + 1])
        edges = np.append(np.arange(first, last, _CHUNK), last)
        chunks += [(group, a, b) for a, b in itertools.pairwise(edges.tolist())]
    offset = np.concatenate([[0], np.cumsum(dimension * dimension)]).astype(np.int64)
    return Groups(dimension, offset, np.array(chunks, dtype=np.int64).reshape(-1, 3))


def _starting_places(network: Network) -> Array:
    """(n, 3) m: where each point's inner solve begins: its a-priori place, or the intersection of its nominal rays."""
    starts = network.points.places.copy()
    rays = network.rays
    origins, directions = np.empty((rays.point.size, 3)), np.empty((rays.point.size, 3))
    ground = np.empty((rays.point.size, 3))
    for j, image in enumerate(network.images):
        mine = rays.image == j
        origins[mine], directions[mine], _, _ = image.rays(rays.places[mine, 0], rays.places[mine, 1])
        ground[mine], _ = image.image_to_ground(rays.places[mine, 0], rays.places[mine, 1])
    crossing, _, angle = intersect_rays(origins, directions, rays.point, len(network.points))
    with np.errstate(invalid="ignore"):
        distant = np.einsum("ki,ki->k", crossing[rays.point] - origins, directions) <= 0.0
    usable = np.all(np.isfinite(crossing), axis=1) & (angle > _PARALLEL)
    usable[rays.point[distant]] = False
    free = (network.points.kinds == PointKind.FREE) & ~network.undetermined
    starts[free & usable] = crossing[free & usable]
    missing = free & ~np.all(np.isfinite(starts), axis=1)
    _, first_ray = np.unique(rays.point, return_index=True)
    first_of = np.full(len(network.points), -1, dtype=np.int64)
    first_of[rays.point[first_ray]] = first_ray
    starts[missing] = ground[first_of[missing]]
    for i in np.flatnonzero(free & ~np.all(np.isfinite(starts), axis=1))[:1]:
        image = network.images[rays.image[first_of[i]]].name
        raise InputError(
            f"point {network.points.ids[i]}",
            f"its ray in image {image} misses the body",
            "image places on the body",
            "check the image's orientation or leave the point out",
        )
    starts[network.undetermined] = 0.0
    return starts


def _point_arrays(network: Network, order: Index, starts: Array) -> dict[str, Any]:
    kinds = np.array([FREE, PRIOR, FIXED])[network.points.kinds]
    kinds[network.undetermined] = OUT
    roots = np.zeros((len(network.points), 3, 3))
    known = network.points.kinds == PointKind.CONSTRAINED
    if np.any(known):
        information = np.linalg.solve(network.points.covariances[known], np.eye(3))
        roots[known] = np.swapaxes(np.linalg.cholesky(0.5 * (information + np.swapaxes(information, 1, 2))), 1, 2)
    return {"point_kind": kinds[order].astype(np.int64), "point_start": starts[order], "point_root": roots[order]}


def _ray_arrays(
    network: Network,
    order: Index,
    place_of: Index,
    model: Model,
    first_column: Index,
    local: Index,
    group_of_point: Index,
    starts: Array,
) -> dict[str, Any]:
    """Everything of the rays, in layout order."""
    rays = ImageRays(*(getattr(network.rays, name)[order] for name in ("point", "image", "places", "sigmas")))
    k = order.size
    centre, matrix, turning = np.empty((k, 2, 3)), np.empty((k, 3, 3)), np.empty((k, 3))
    detector, focal, to_pixels = np.empty((k, 2, 2)), np.empty(k), np.empty((k, 2, 2))
    angles = np.zeros((0 if model.angles == CAMERA else k, 2, 3))
    for j, image in enumerate(network.images):
        mine = rays.image == j
        lines, samples = rays.places[mine].T
        pose = image.pose(lines)
        centre[mine, 0], centre[mine, 1] = pose.position, pose.velocity
        matrix[mine], turning[mine] = pose.matrix, pose.turning
        detector[mine, 0], detector[mine, 1] = image.interior.focal_plane(samples)
        focal[mine] = image.interior.focal_length
        to_pixels[mine] = _frozen_scale(pose, image.interior.focal_length, starts[rays.point[mine]], detector[mine, 1])
        if angles.size:
            angles[mine] = _nominal_angles(pose, model.angles)
    pairs = _pairs(network, rays.image, rays.places[:, 0], first_column, local, group_of_point[rays.point])
    return {
        "ray_first": _first_of(place_of[rays.point], len(network.points)),
        "centre": centre,
        "matrix": matrix,
        "turning": turning,
        "angles": angles,
        "detector": detector,
        "focal": focal,
        "to_pixels": to_pixels,
        "weight": 1.0 / rays.sigmas,
        "pair_first": pairs[0],
        "pair_column": pairs[1],
        "pair_local": pairs[2],
        "pair_value": np.stack([pairs[3], pairs[4]], axis=1),
    }


def _range_arrays(
    network: Network, order: Index, place_of: Index, first_column: Index, local: Index, group_of_point: Index
) -> dict[str, Any]:
    """Everything of the ranges, in layout order; the instrument is where the camera is at the shot's time."""
    names = ("point", "image", "times", "values", "sigmas")
    ranges = Ranges(*(getattr(network.ranges, name)[order] for name in names))
    centre, lines = np.empty((order.size, 3)), np.empty(order.size)
    for j in np.unique(ranges.image):
        mine, image = ranges.image == j, network.images[j]
        since = ranges.times[mine] - image.trajectory.epoch
        centre[mine] = image.trajectory.pose(since).position
        lines[mine] = image.timing.lines(since)
    pairs = _pairs(network, ranges.image, lines, first_column, local, group_of_point[ranges.point])
    return {
        "range_first": _first_of(place_of[ranges.point], len(network.points)),
        "range_centre": centre,
        "range_value": ranges.values,
        "range_weight": 1.0 / ranges.sigmas,
        "range_pair_first": pairs[0],
        "range_pair_column": pairs[1],
        "range_pair_local": pairs[2],
        "range_pair_value": pairs[3],
    }


def _first_of(places: Index, points: int) -> Index:
    """(points + 1,) where each point's rows begin, rows being sorted by point."""
    return np.searchsorted(places, np.arange(points + 1)).astype(np.int64)


def _pairs(
    network: Network, images: Index, lines: Array, first_column: Index, local: Index, groups: Index
) -> tuple[Index, Index, Index, Array, Array]:
    """(Orientation column, basis value) pairs of rows: first pair of each row, global and local column, value, rate."""
    terms = np.array([prior.degree + 1 for prior in network.priors])
    counts = np.where(first_column[images] >= 0, terms[images], 0)
    first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    column, inside = np.empty(first[-1], dtype=np.int64), np.empty(first[-1], dtype=np.int64)
    value, rate = np.empty(first[-1]), np.empty(first[-1])
    for j in np.unique(images):
        if first_column[j] < 0:
            continue
        mine, image = np.flatnonzero(images == j), network.images[j]
        basis, slope = polynomial(image.normalised(lines[mine]), network.priors[j].degree)
        for term in range(terms[j]):
            place = first[mine] + term
            column[place] = first_column[j] + 6 * term
            inside[place] = local[groups[mine], j] + 6 * term
            value[place], rate[place] = basis[:, term], slope[:, term] * image.normalised_rate
    return first, column, inside, value, rate


def _frozen_scale(pose: Pose, focal_length: float, points: Array, slope: Array) -> Array:
    """(k, 2, 2) focal-plane m to (lines, samples): image motion per line, from the nominal, and detector slope."""
    ray = np.einsum("kij,kj->ki", pose.matrix, points - pose.position)
    rate = -np.cross(pose.turning, ray) - np.einsum("kij,kj->ki", pose.matrix, pose.velocity)
    motion = focal_length * (rate[:, :2] - ray[:, :2] / ray[:, 2:] * rate[:, 2:]) / ray[:, 2:]
    turned = np.stack([slope[:, ::-1], motion[:, ::-1]], axis=1) * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return np.asarray(turned / (motion[:, 0] * slope[:, 1] - motion[:, 1] * slope[:, 0])[:, None, None])


def _nominal_angles(pose: Pose, convention: int) -> Array:
    """(k, 2, 3) omega, phi, kappa and their rates per line, in the papers' or the peer's product."""
    paper = convention == OPK_PAPER
    angles = rotation.omega_phi_kappa(pose.matrix if paper else np.swapaxes(pose.matrix, 1, 2))
    chain = rotation.angle_axes(angles, camera_to_body=paper)
    rates = np.linalg.solve(chain, pose.turning[:, :, None])[:, :, 0]
    return np.stack([angles, rates], axis=1)
