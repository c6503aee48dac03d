"""What of an observation doesn't change during an adjustment, worked out once.

Nominal pose at the measured line and its rates, basis values, the undistorted focal-plane place, the a-priori places
and the axes along which shifts move them.
"""

from typing import Any

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.factors.rows import CAMERA, FIXED, FREE, OPK_PAPER, OUT, PRIOR, Model, Rows
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.intersection import intersect_rays
from mgsgraph.geometry.orientation import polynomial
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.network import ImageRays, Network, Ranges
from mgsgraph.ties import PointKind

_PARALLEL = 1e-12
"""rad: rays closer to parallel than this start on the ellipsoid instead of at their intersection."""


def lay_out_rows(
    network: Network, model: Model, first: Index, local: Index, group_of_point: Index, point_order: Index
) -> tuple[Index, Index, Rows]:
    """Rows of a network in the kernel's order.

    Parameters
    ----------
    network : Network
    model : Model
    first : (v,)
        First column of each variable (see layout.Variables).
    local : (groups, v)
        The same within each group's own columns.
    group_of_point, point_order : (n,)
        Group of each network point, and the order that sorts them by it.

    Returns
    -------
    ray_order, range_order : (k,), (r,)
        Network ray and range at each place of the layout.
    rows : Rows
    """
    place_of = np.empty_like(point_order)
    place_of[point_order] = np.arange(point_order.size)
    ray_order = np.lexsort((network.rays.image, place_of[network.rays.point]))
    range_order = np.argsort(place_of[network.ranges.point], kind="stable")
    starts = _starting_places(network)
    rows = Rows(
        **_point_arrays(network, point_order, starts),
        **_shift_arrays(network, point_order, first, local, group_of_point),
        **_surface_arrays(network, point_order, starts, first, local, group_of_point),
        **_ray_arrays(network, ray_order, place_of, model, first, local, group_of_point, starts),
        **_range_arrays(network, range_order, place_of, first, local, group_of_point),
    )
    return ray_order, range_order, rows


def _shift_arrays(network: Network, order: Index, first: Index, local: Index, group_of_point: Index) -> dict[str, Any]:
    """East and north at each footprint, along which its profile's two unknowns move the a-priori place."""
    if network.shifts is None:
        none = np.zeros(0, dtype=np.int64)
        return {
            "shift_first": np.zeros(order.size + 1, dtype=np.int64),
            "shift_column": none,
            "shift_local": none,
            "shift_direction": np.zeros((0, 3)),
        }
    profile = network.shifts.profile[order]
    moved = profile >= 0
    variable = profile[moved] + len(network.images)
    column, inside = first[variable], local[group_of_point[order[moved]], variable]
    return {
        "shift_first": np.concatenate([[0], np.cumsum(2 * moved)]).astype(np.int64),
        "shift_column": np.stack([column, column + 1], axis=1).ravel(),
        "shift_local": np.stack([inside, inside + 1], axis=1).ravel(),
        "shift_direction": east_north(network.points.places[order[moved]]).reshape(-1, 3),
    }


def _surface_arrays(
    network: Network, order: Index, starts: Array, first: Index, local: Index, group_of_point: Index
) -> dict[str, Any]:
    if network.surface is None:
        return {
            "surface_weight": np.zeros(order.size),
            "surface_column": np.full(order.size, -1, dtype=np.int64),
            "surface_local": np.full(order.size, -1, dtype=np.int64),
            "surface_direction": np.zeros((0, 2, 3)),
            "terrain": np.zeros((0, 0)),
            "terrain_frame": np.zeros(4),
            "terrain_cell": np.full((order.size, 3), -1, dtype=np.int64),
        }
    grid = network.surface.grid
    felt = np.isfinite(network.surface.sigmas[order]) & network.terrain_moves
    return {
        "surface_weight": 1.0 / network.surface.sigmas[order],
        "surface_column": np.where(felt, first[-1], -1),
        "surface_local": np.where(felt, local[group_of_point[order], -1], -1),
        "surface_direction": east_north(starts[order]),
        "terrain": np.ascontiguousarray(grid.radii, dtype=np.float64),
        "terrain_frame": np.array([grid.first_longitude, grid.first_latitude, grid.longitude_step, grid.latitude_step]),
        "terrain_cell": grid.cells(starts[order]),
    }


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
