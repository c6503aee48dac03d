"""What of an observation doesn't change during an adjustment, worked out once.

Nominal pose at the measured line and its rates, basis values, the undistorted focal-plane place, the a-priori places
and the axes along which shifts move them: the constants that the kernel reads, in the order in which it loads them.
"""

import math
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.graph.parallel import parallel
from mgsgraph.adjustment.graph.patterns import Patterns
from mgsgraph.adjustment.graph.shared import SharedEffects, footprint_motion
from mgsgraph.adjustment.graph.terms import Terms
from mgsgraph.adjustment.graph.variables import Variables
from mgsgraph.errors import InputError
from mgsgraph.factors.rows import (
    CAMERA,
    FIXED,
    FREE,
    IMAGE,
    MEASURED,
    OPK_PAPER,
    OPK_PEER,
    OUT,
    PRIOR,
    RANGE,
    Model,
    Rows,
    components,
)
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.intersection import RayAngles, RaySums
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.network import Network, SharedKind
from mgsgraph.ties import PointKind

_Component = TypeVar("_Component", int, Index)
_PARALLEL = 1e-12
"""rad: rays closer to parallel than this start on the ellipsoid instead of at their intersection."""


@dataclass(frozen=True, slots=True, eq=False)
class _Store:
    """Where the constants of each point's sights go; n points in network order."""

    patterns: Patterns
    """Points by pattern."""
    before: Index
    """(q, j) numbers per point that a pattern's sights before the j-th store."""
    piece: Index
    """(m, 5) as in Rows."""
    data: Array
    """What is being filled."""

    def place(self, points: Index, slots: Index) -> tuple[Index, Index, Index]:
        """For the `slots`-th sights of network `points`: first place in `data`, step to the next component, and place
        among all sights.
        """
        at = self.patterns.point_place[points]
        pattern, first, stride, start, sights = self.piece[self.patterns.piece_of(at)].T
        inside = at - first
        return start + stride * self.before[pattern, slots] + inside, stride, sights + slots * stride + inside

    def put(self, place: Index, stride: Index, component: _Component, values: Array) -> _Component:
        """Store components from `component` on, (k,) or (k, c) or (k, c, d) values; which component comes next."""
        flat = values.reshape(place.size, math.prod(values.shape[1:]))
        for c in range(flat.shape[1]):
            self.data[place + (component + c) * stride] = flat[:, c]
        return component + flat.shape[1]


@dataclass(frozen=True, slots=True, eq=False)
class SightPlaces:
    """Where a network's rows are among all t sights."""

    rays: NDArray[np.int32]
    """(k,) of each network ray; a small number, for there are many."""
    ranges: Index
    """(r,) of each network range."""
    heights: Index
    """(h,) of the heights above the terrain."""
    on_terrain: Index
    """(h,) network points that they belong to."""


def lay_out_rows(
    network: Network,
    model: Model,
    variables: Variables,
    patterns: Patterns,
    terms: Terms,
    known: Array | None = None,
) -> tuple[SightPlaces, Rows]:
    """Rows of a network in the kernel's order, and where each is; `known` (n, 3) are places at which to begin."""
    store = _make_store(model, patterns)
    starts = _starting_places(network, known)
    weight = np.zeros((2, int(sum(len(patterns.sights[q]) * n for q, n in store.piece[:, [0, 2]]))))
    angles = RayAngles(len(network.points))
    effects = SharedEffects(network, model)
    rays = _fill_rays(network, model, store, terms, effects, starts, weight, angles)
    ranges = _fill_ranges(network, store, terms, effects, weight)
    _fill_ground(network, store, weight)
    places = SightPlaces(rays, ranges, *_fill_surface(network, store, starts, weight))
    order, surface = patterns.point_order, network.surface
    kinds = np.array([FREE, PRIOR, FIXED], dtype=np.int8)[network.points.kinds]
    kinds[network.undetermined | parallel(network, angles.angles())] = OUT
    grid = None if surface is None else surface.grid
    rows = Rows(
        kind=kinds[order],
        start=starts[order],
        data=store.data,
        weight=weight,
        piece=store.piece,
        **_sight_tables(network, variables, patterns),
        terrain=np.zeros((0, 0)) if grid is None else np.ascontiguousarray(grid.radii, dtype=np.float64),
        terrain_frame=np.zeros(4)
        if grid is None
        else np.array([grid.first_longitude, grid.first_latitude, grid.longitude_step, grid.latitude_step]),
        terrain_cell=np.zeros((0, 3), dtype=np.int64) if grid is None else grid.cells(starts[order]),
    )
    return places, rows


def _make_store(model: Model, patterns: Patterns) -> _Store:
    """Room for everything."""
    widest = max(len(sights) for sights in patterns.sights)
    stored = np.zeros((len(patterns.sights), widest), dtype=np.int64)
    for q, sights in enumerate(patterns.sights):
        for j, sight in enumerate(sights):
            stored[q, j] = components(model, sight.kind, sight.width, len(sight.terms), sight.shared)
    ends = np.cumsum(stored, axis=1)
    pattern, count = patterns.piece_pattern, np.diff(patterns.piece_first)
    numbers = count * (ends[:, -1][pattern] if widest else 0)
    sights_of = count * np.array([len(mine) for mine in patterns.sights], dtype=np.int64)[pattern]
    first = patterns.piece_first[:-1]
    piece = np.stack([pattern, first, count, np.cumsum(numbers) - numbers, np.cumsum(sights_of) - sights_of], axis=1)
    return _Store(patterns, ends - stored, np.ascontiguousarray(piece, dtype=np.int64), np.empty(int(numbers.sum())))


def _sight_tables(network: Network, variables: Variables, patterns: Patterns) -> dict[str, Any]:
    """What the patterns' sights feel of the unknowns."""
    table: list[tuple[int, int, int, int, int]] = []
    focal: list[float] = []
    entries: list[tuple[int, int, int]] = []
    for q, sights in enumerate(patterns.sights):
        members = patterns.group_variables[patterns.group[q]]
        for sight in sights:
            table.append((sight.kind, sight.width, len(sight.terms), sight.shared, len(entries)))
            focal.append(network.images[sight.image].interior.focal_length if sight.kind == IMAGE else 0.0)
            inside = list(sight.terms)
            inside += [(sight.moved, step) for step in range(sight.shift)]
            inside += [(v, step) for v in sight.felt for step in range(int(variables.width[v]))]
            entries += [(int(variables.first[v]) + step, members.index(v), step) for v, step in inside]
    columns = np.array(table, dtype=np.int64).reshape(-1, 5).T
    column, member, inside_of = np.array(entries, dtype=np.int64).reshape(-1, 3).T
    sizes = [len(sights) for sights in patterns.sights]
    return {
        "pattern_sight": np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        "pattern_group": patterns.group,
        "pattern_fixed": patterns.fixed.astype(np.int64),
        **{
            f"sight_{name}": np.ascontiguousarray(values)
            for name, values in zip(("kind", "width", "terms", "shared", "entry"), columns, strict=True)
        },
        "sight_focal": np.array(focal),
        "entry_column": np.ascontiguousarray(column),
        "entry_member": np.ascontiguousarray(member),
        "entry_inside": np.ascontiguousarray(inside_of),
    }


def _ranks(points: Index, images: Index, nodes: Index) -> Index:
    """Rank of each row among its point's, by image, then by first node (then as given)."""
    order = np.lexsort((nodes, images, points))
    ordered = points[order]
    begins = np.flatnonzero(np.diff(ordered, prepend=-1))
    rank = np.empty_like(order)
    rank[order] = np.arange(order.size) - np.repeat(begins, np.diff(np.append(begins, order.size)))
    return rank


def _by_image(images: Index, count: int) -> list[Index]:
    """Rows of each image."""
    order = np.argsort(images, kind="stable")
    return np.split(order, np.searchsorted(images[order], np.arange(1, count)))


def _fill_rays(
    network: Network,
    model: Model,
    store: _Store,
    terms: Terms,
    effects: SharedEffects,
    starts: Array,
    weight: Array,
    angles: RayAngles,
) -> NDArray[np.int32]:
    """Constants of the image rays, and their angles; the place of each among all sights."""
    rays = network.rays
    slots = _ranks(rays.point, rays.image, terms.of_rays)
    place_among = np.empty(rays.point.size, dtype=np.int32)
    for j, mine in enumerate(_by_image(rays.image, len(network.images))):
        if mine.size == 0:
            continue
        image, (lines, samples) = network.images[j], rays.places[mine].T
        place, stride, place_among[mine] = store.place(rays.point[mine], slots[mine])
        pose = image.pose(lines)
        detector, slope = image.interior.focal_plane(samples)
        look = np.column_stack([detector, np.full(mine.size, image.interior.focal_length)])
        angles.add(rays.point[mine], np.einsum("kji,kj->ki", pose.matrix, look))
        attitude, turning = _attitude(pose, model.angles)
        at = store.put(place, stride, 0, pose.position)
        at = store.put(place, stride, at, attitude)
        at = store.put(place, stride, at, detector)
        if model.line == MEASURED:
            at = store.put(place, stride, at, _frozen_scale(image, pose, starts[rays.point[mine]], slope, model))
        else:
            for values in (pose.velocity, turning, slope):
                at = store.put(place, stride, at, values)
        if terms.count(j):
            basis, rate = terms.basis(j, lines, terms.of_rays[mine])
            both = np.concatenate([basis, rate], axis=1)
            at = store.put(place, stride, at, basis if model.line == MEASURED else both)
        store.put(place, stride, at, effects.of(IMAGE, j, image.normalised(lines)))
    weight[:, place_among] = 1.0 / rays.sigmas.T
    return place_among


def _fill_ranges(network: Network, store: _Store, terms: Terms, effects: SharedEffects, weight: Array) -> Index:
    """Constants of the ranges; the instrument is where the camera is at the shot's time."""
    ranges = network.ranges
    slots = _ranks(ranges.point, ranges.image, terms.of_ranges) + network.ray_counts[ranges.point]
    place_among = np.empty(ranges.point.size, dtype=np.int64)
    for j, mine in enumerate(_by_image(ranges.image, len(network.images))):
        if mine.size == 0:
            continue
        image = network.images[j]
        since = ranges.times[mine] - image.trajectory.epoch
        place, stride, place_among[mine] = store.place(ranges.point[mine], slots[mine])
        at = store.put(place, stride, 0, image.trajectory.pose(since).position)
        at = store.put(place, stride, at, ranges.values[mine])
        lines = image.timing.lines(since)
        if terms.count(j):
            at = store.put(place, stride, at, terms.basis(j, lines, terms.of_ranges[mine])[0])
        store.put(place, stride, at, effects.of(RANGE, j, image.normalised(lines)))
    weight[0, place_among] = 1.0 / ranges.sigmas
    return place_among


def _sights_before(network: Network) -> Index:
    """(n,) rays and ranges of each point."""
    return network.ray_counts + np.bincount(network.ranges.point, minlength=len(network.points))


def _fill_ground(network: Network, store: _Store, weight: Array) -> None:
    """A-priori places: upper triangular square root U of their information, |U (P - P0)|^2, and where shifts go."""
    known = np.flatnonzero(network.points.kinds == PointKind.CONSTRAINED)
    if known.size == 0:
        return
    information = np.linalg.solve(network.points.covariances[known], np.eye(3))
    root = np.swapaxes(np.linalg.cholesky(0.5 * (information + np.swapaxes(information, 1, 2))), 1, 2)
    place, stride, among = store.place(known, _sights_before(network)[known])
    store.put(place, stride, 0, network.points.places[known])
    store.put(place, stride, 3, root[:, *np.triu_indices(3)])
    weight[0, among] = 1.0
    after = np.full(known.size, 9)
    if network.shifts is not None:
        moved = network.shifts.profile[known] >= 0
        store.put(place[moved], stride[moved], 9, east_north(network.points.places[known[moved]]))
        after[moved] += 6
    for one in network.shared:
        if one.kind is SharedKind.ALTIMETER_BORESIGHT:
            points, motion = footprint_motion(network, one)
            mine = np.searchsorted(known, points)
            after[mine] = store.put(place[mine], stride[mine], after[mine], motion)


def _fill_surface(network: Network, store: _Store, starts: Array, weight: Array) -> tuple[Index, Index]:
    """Heights above the terrain model: their weights, and how its unknowns move it.

    Returned are their places among all sights, and the points that they belong to.
    """
    if network.surface is None:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    mine = np.flatnonzero(np.isfinite(network.surface.sigmas))
    slots = _sights_before(network) + (network.points.kinds == PointKind.CONSTRAINED)
    place, stride, among = store.place(mine, slots[mine])
    weight[0, among] = 1.0 / network.surface.sigmas[mine]
    if network.terrain_moves:
        store.put(place, stride, 0, network.surface.directions(starts[mine]))
    return among, mine


def _starting_places(network: Network, known: Array | None) -> Array:
    """(n, 3) m: where each point's inner solve begins: where it is known to be, its a-priori place, or the intersection
    of its nominal rays.
    """
    starts = network.points.places.copy()
    there = np.zeros(starts.shape[0], dtype=bool)
    if known is not None:
        there = np.all(np.isfinite(known), axis=1)
        starts[there] = known[there]
    free = (network.points.kinds == PointKind.FREE) & ~network.undetermined & ~there
    if np.any(free):
        _start_at_crossings(network, free, starts)
    missing = np.flatnonzero(free & ~np.all(np.isfinite(starts), axis=1))
    if missing.size:
        _start_on_the_ground(network, missing, starts)
    starts[network.undetermined] = 0.0
    return starts


def _start_at_crossings(network: Network, free: Mask, starts: Array) -> None:
    """Where the nominal rays of points (n,) cross, ahead of their cameras."""
    rays, count = network.rays, len(network.images)
    mine = np.flatnonzero(free[rays.point])
    sums = RaySums(starts.shape[0])
    seen = list[tuple[Index, Array, Array]]()
    for j, k in enumerate(_by_image(rays.image[mine], count)):
        if k.size:
            seen.append((mine[k], *network.images[j].sightlines(*rays.places[mine[k]].T)))
            sums.add(rays.point[mine[k]], *seen[-1][1:])
    crossing, angle = sums.places()
    usable = free & np.all(np.isfinite(crossing), axis=1) & (angle > _PARALLEL)
    for rows, origins, directions in seen:  # rays that part meet behind their cameras
        ahead = np.einsum("ki,ki->k", crossing[rays.point[rows]] - origins, directions) > 0.0
        usable[rays.point[rows[~ahead]]] = False
    starts[usable] = crossing[usable]


def _start_on_the_ground(network: Network, missing: Index, starts: Array) -> None:
    """Where nothing else says where a point is (parallel rays): where its first ray meets the ellipsoid."""
    with_rays, first = np.unique(network.rays.point, return_index=True)
    for i in missing:
        k = first[np.searchsorted(with_rays, i)]
        image = network.images[network.rays.image[k]]
        starts[i] = image.image_to_ground(*network.rays.places[[k]].T)[0][0]
        if not np.all(np.isfinite(starts[i])):
            raise InputError(
                f"point {network.points.ids[i]}",
                f"its ray in image {image.name} misses the body",
                "image places on the body",
                "check the image's orientation or leave the point out",
            )


def _attitude(pose: Pose, angles: int) -> tuple[Array, Array]:
    """Attitude (k, 4) as a quaternion of the body-fixed to camera matrix, or (k, 3) omega, phi, kappa in the papers'
    or the peer's product; and its rate per line: angular velocity in camera axes, or rates of the angles.
    """
    if angles == CAMERA:
        return rotation.from_matrix(pose.matrix), pose.turning
    paper = angles == OPK_PAPER
    found = rotation.omega_phi_kappa(pose.matrix if paper else np.swapaxes(pose.matrix, 1, 2))
    chain = rotation.angle_axes(found, camera_to_body=paper)
    return found, np.asarray(np.linalg.solve(chain, pose.turning[:, :, None])[:, :, 0])


def _frozen_scale(image: PushbroomImage, pose: Pose, points: Array, slope: Array, model: Model) -> Array:
    """(k, 2, 2) focal-plane m to (lines, samples): image motion per line, from the nominal, and detector slope.

    In the peer's convention both are pixels of the detector's size, along and across it.
    """
    if model.angles == OPK_PEER:
        square = np.einsum("ki,ki->k", slope, slope)[:, None]
        return np.stack([np.stack([slope[:, 1], -slope[:, 0]], axis=1) / square, slope / square], axis=1)
    ray = np.einsum("kij,kj->ki", pose.matrix, points - pose.position)
    rate = -np.cross(pose.turning, ray) - np.einsum("kij,kj->ki", pose.matrix, pose.velocity)
    motion = image.interior.focal_length * (rate[:, :2] - ray[:, :2] / ray[:, 2:] * rate[:, 2:]) / ray[:, 2:]
    turned = np.stack([slope[:, ::-1], motion[:, ::-1]], axis=1) * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return np.asarray(turned / (motion[:, 0] * slope[:, 1] - motion[:, 1] * slope[:, 0])[:, None, None])
