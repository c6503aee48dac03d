"""Constants of the observations, computed once in an adjustment.

Nominal pose at the measured line and its rates, basis values, the undistorted focal-plane coordinates, the a-priori
positions and the axes along which shifts move them: the constants that the kernel reads, in the order in which it loads
them.
"""

import math
import mmap
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.graph.patterns import Patterns, Terms, counted
from mgsgraph.adjustment.graph.rays import Crossing, RayConstants
from mgsgraph.adjustment.graph.stereo import StereoRows
from mgsgraph.adjustment.graph.variables import Variables
from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.plausibility import require_on_ground, resection_remedy
from mgsgraph.geometry.records import Array, Index, finite_rows, no_rows, read_only
from mgsgraph.kernel.rows import (
    FIXED,
    FREE,
    IMAGE,
    MEASURED,
    OPK_PEER,
    OUT,
    PRIOR,
    Model,
    Rows,
    numbers_stored,
)
from mgsgraph.network import Network
from mgsgraph.network.effects import SharedEffects, common_lifts, known_motions
from mgsgraph.network.parallel import parallel

_SHARE = 0.25
"""Share of the memory above which an array goes to a file: the rest of an adjustment takes about as much again."""
_GIGA = 1e9
_LIMITS = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))
"""Files in which Linux states a container's memory limit: control groups of version 2 and 1."""


def memory() -> float:
    """Bytes that this machine has, or its container may take; infinite where the system doesn't say."""
    try:
        limit = float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        limit = float("inf")
    for path in _LIMITS:
        try:
            limit = min(limit, float(path.read_text(encoding="ascii")))  # "max" where there is no limit
        except (OSError, ValueError):
            continue
    return limit


@dataclass(frozen=True, slots=True)
class Storage:
    """Storage of the long arrays of an adjustment: memory, or a mapped file where they would take much of the memory.

    The system keeps mapped pages in memory as far as there is room, and reads the others when needed: a sweep takes the
    constants from the first to the last. The kernel sees an array like any other.
    """

    most: float
    """Bytes above which an array goes to a file."""

    @classmethod
    def within(cls, memory_gb: float | None) -> "Storage":
        """Storage of an adjustment that may take so much memory; all of the machine's when None."""
        return cls(_SHARE * (memory() if memory_gb is None else _GIGA * memory_gb))

    def room(self, size: int) -> Array:
        """An array (size,) to be filled, in memory or in a file of the temporary folder that goes with it.

        Raises
        ------
        InputError
            Where the temporary folder has no room for it.
        """
        needed = 8 * size
        return np.empty(size) if needed <= self.most or not size else _in_file(needed)

    def copied(self, values: Array) -> Array:
        """A copy of values (n,), in room of its own."""
        copy = self.room(values.size)
        copy[:] = values
        return copy


def _in_file(needed: int) -> Array:
    """An array of so many bytes in a private file that is deleted with the array."""
    try:
        with tempfile.TemporaryFile(prefix="mgsgraph-rows-") as file:
            if hasattr(os, "posix_fallocate"):  # a mapped page for which the disk has no room would end the process
                os.posix_fallocate(file.fileno(), 0, needed)
            else:
                file.truncate(needed)
            return np.frombuffer(mmap.mmap(file.fileno(), needed), dtype=np.float64)
    except OSError as error:
        problem = f"no room for a file ({error.strerror or error})"
        expected = f"{needed / _GIGA:.1f} GB for the rows of the adjustment"
        where = f"folder {tempfile.gettempdir()}"
        raise InputError(where, problem, expected, "set TMPDIR to another folder") from error


_ASKED = 10_000
"""Points, evenly spaced among all, that must lie near the ground."""
_Component = TypeVar("_Component", int, Index)


@dataclass(frozen=True, eq=False)
class _Store:
    """Place of the constants of each point's observations; n points in network order."""

    patterns: Patterns
    """Points by pattern."""
    before: Index
    """(q, j) numbers per point that a pattern's observations before the j-th store."""
    piece: Index
    """(m, 5) as in Rows."""
    data: Array
    """The array that is filled."""

    def place(self, points: Index, slots: NDArray[np.integer[Any]]) -> tuple[Index, Index, Index]:
        """For the `slots`-th observations of network `points`: first index in `data`, step to the next component, and
        place among all observations.
        """
        at = self.patterns.point_index[points]
        pattern, first, stride, start, observations = self.piece[self.patterns.piece_of(at)].T
        inside = at - first
        return start + stride * self.before[pattern, slots] + inside, stride, observations + slots * stride + inside

    def put(self, place: Index, stride: Index, component: _Component, values: Array) -> _Component:
        """Store components from `component` on, (k,) or (k, c) or (k, c, d) values; which component comes next."""
        flat = values.reshape(place.size, math.prod(values.shape[1:]))
        for c in range(flat.shape[1]):
            self.data[place + (component + c) * stride] = flat[:, c]
        return component + flat.shape[1]


@dataclass(frozen=True, slots=True, eq=False)
class ObservationRows:
    """Places of a network's rows among all t observations."""

    rays: NDArray[np.int32]
    """(k,) of each network ray; int32, since there are many."""
    ranges: Index
    """(r,) of each network range."""
    heights: Index
    """(h,) of the heights above the terrain."""
    on_terrain: Index
    """(h,) network points that they belong to."""
    stereo: Index
    """(k,) of the heights above stereo surfaces, in the order of `StereoRows.points`."""


def lay_out_rows(
    network: Network,
    model: Model,
    variables: Variables,
    patterns: Patterns,
    slot: NDArray[np.int32],
    terms: Terms,
    places: Array | None,
    like: tuple[Array, NDArray[np.int8]] | None,
    stereo: StereoRows | None,
    bending: Array,
    storage: Storage,
) -> tuple[ObservationRows, Rows, RayConstants]:
    """Rows of a network in the kernel's order, their places, and the constants of image rays, which can be renewed.

    `slot` (k,) is each ray's index among its point's observations (overwritten), `places` (n, 3) start positions;
    `like` start positions (n, 3) and kinds (n,) to keep as they are, network order. `bending` (columns,) are the shared
    unknowns with which the slopes of detector lines are those of adjusted interior orientations. `storage` holds the
    constants.
    """
    tables = _observation_tables(network, model, variables, patterns)
    store = _make_store(patterns, tables["observation_numbers"], storage)
    weight = np.zeros((2, int(store.piece[:, 2] @ np.diff(patterns.first)[store.piece[:, 0]])))
    crossing, order = None if like else _begin_crossing(network, places), patterns.point_order
    rays = RayConstants(network, model, variables, patterns, slot, store.piece, store.before)
    rays.fill(store.data, weight, terms, bending, crossing, tables["observation_focal"])
    ranges = _fill_ranges(network, store, terms, rays.effects, weight)
    _fill_ground(network, store, weight)
    starts, kinds = (like[0][order], like[1][order]) if like else _starting_points(network, patterns, crossing)
    if model.line == MEASURED and model.angles != OPK_PEER:
        rays.fill_scales(store.data, starts)
    on_terrain = _fill_surface(network, store, starts, weight)
    observation_rows = ObservationRows(rays.among, ranges, *on_terrain, _fill_stereo(network, store, stereo, weight))
    spline = None if network.surface is None else network.surface.grid.spline()
    laid = Rows(
        kind=kinds,
        start=starts,
        data=store.data,
        weight=weight,
        piece=store.piece,
        **tables,
        terrain=np.zeros((0, 0)) if spline is None else spline.coefficients,
        terrain_frame=np.zeros(4) if spline is None else np.array([*spline.first, *spline.step]),
    )
    return observation_rows, laid, rays


def with_stereo(network: Network, patterns: Patterns, rows: Rows, stereo: StereoRows, storage: Storage) -> Rows:
    """Rows with other heights above stereo surfaces, of the same points, which depend on the same unknowns."""
    store, weight = _make_store(patterns, rows.observation_numbers, storage), rows.weight.copy()
    store.data[:] = rows.data
    _fill_stereo(network, store, stereo, weight)
    return rows._replace(data=store.data, weight=weight)


def _make_store(patterns: Patterns, stored: Index, storage: Storage) -> _Store:
    """Room for everything; each observation of the patterns stores so many numbers (s,)."""
    count = np.diff(patterns.first)
    before = np.zeros((count.size, int(count.max(initial=0))), dtype=np.int64)
    pattern = np.repeat(np.arange(count.size), count)
    slot = np.arange(pattern.size) - np.repeat(patterns.first[:-1], count)
    ends = np.cumsum(stored)
    begin = np.concatenate([[0], ends])[patterns.first]
    before[pattern, slot] = ends - stored - begin[:-1][pattern]
    of_piece, size = patterns.piece_pattern, np.diff(patterns.piece_first)
    numbers, observations = size * np.diff(begin)[of_piece], size * count[of_piece]
    first = patterns.piece_first[:-1]
    begins = [np.cumsum(counts) - counts for counts in (numbers, observations)]
    piece = np.stack([of_piece, first, size, *begins], axis=1)
    return _Store(patterns, before, np.ascontiguousarray(piece, dtype=np.int64), storage.room(int(numbers.sum())))


def _observation_tables(network: Network, model: Model, variables: Variables, patterns: Patterns) -> dict[str, Any]:
    """Kinds of the patterns' observations, and how the unknowns act on them."""
    focal = np.array([image.interior.focal_length for image in network.images] + [0.0])
    rate = np.array([image.normalised_rate for image in network.images] + [0.0])
    slope = patterns.slopes[patterns.image]
    rays, polynomial = patterns.kind == IMAGE, (patterns.image >= 0) & (patterns.node < 0)
    return {
        "pattern_observation": patterns.first,
        "pattern_group": patterns.group,
        "pattern_fixed": patterns.fixed.astype(np.int64),
        "pattern_shape": patterns.shape,
        "observation_kind": patterns.kind,
        "observation_width": patterns.width,
        "observation_terms": patterns.terms,
        "observation_shared": patterns.shared,
        "observation_entry": patterns.entry[:-1].copy(),
        "observation_focal": np.where(rays, focal[patterns.image], 0.0),
        "observation_slope": slope,
        "observation_rate": np.where(polynomial, rate[patterns.image], 0.0),
        "observation_numbers": numbers_stored(
            model, patterns.kind, patterns.width, patterns.terms, patterns.shared, polynomial, slope
        ),
        "entry_column": variables.first[patterns.entry_variable] + patterns.entry_inside,
        "entry_member": patterns.entry_member,
        "entry_inside": patterns.entry_inside,
    }


def _by_image(images: Index, count: int) -> list[Index]:
    """Rows of each image."""
    order, _, sizes = counted(images, np.arange(count))
    return np.split(order, np.cumsum(sizes)[:-1])


def _fill_ranges(network: Network, store: _Store, terms: Terms, effects: SharedEffects, weight: Array) -> Index:
    """Constants of the ranges; the instrument is where the camera is at the shot's time."""
    ranges = network.ranges
    place, stride, among = store.place(ranges.point, store.patterns.range_slot)
    shares = np.zeros((ranges.point.size, 3)) if ranges.shares is None else ranges.shares
    store.put(place, stride, 3, shares)
    positions = np.nan_to_num(network.points.places[ranges.point])
    store.put(place, stride, 6, ranges.values - np.einsum("ri,ri->r", shares, positions))
    after = np.empty(ranges.point.size, dtype=np.int64)
    for j, of_image in enumerate(_by_image(ranges.image, len(network.images))):
        if of_image.size == 0:
            continue
        image = network.images[j]
        since = ranges.times[of_image] - image.trajectory.epoch
        begin, step, at = place[of_image], stride[of_image], 7
        store.put(begin, step, 0, image.trajectory.pose(since).position)
        moments = image.moments(image.timing.lines(since))
        for values in terms.basis(j, moments, terms.of_ranges[of_image], False):
            at = store.put(begin, step, at, values)
        moved = effects.of_ranges(j, moments.u, None if ranges.shares is None else shares[of_image])
        after[of_image] = store.put(begin, step, at, moved)
    for points, _, motion, on_ranges in known_motions(network) if ranges.shares is not None else ():
        if not on_ranges:
            index = np.searchsorted(points, ranges.point).clip(max=points.size - 1)
            moved_ranges = np.flatnonzero(points[index] == ranges.point)
            moved = np.zeros((moved_ranges.size, motion.shape[1], 4))
            moved[:, :, 3] = np.einsum("rcj,rj->rc", motion[index[moved_ranges]], shares[moved_ranges])
            after[moved_ranges] = store.put(place[moved_ranges], stride[moved_ranges], after[moved_ranges], moved)
    weight[0, among] = 1.0 / ranges.sigmas
    return among


def _observations_before(network: Network) -> Index:
    """(n,) rays and ranges of each point."""
    return network.ray_counts + np.bincount(network.ranges.point, minlength=len(network.points))


def _fill_ground(network: Network, store: _Store, weight: Array) -> None:
    """A-priori positions: upper triangular square root U of their information, |U (P - P0)|^2, and shifts on them."""
    with_prior = np.flatnonzero(network.points.kinds == PointKind.CONSTRAINED)
    if with_prior.size == 0:
        return
    information = np.linalg.solve(network.points.covariances[with_prior], np.eye(3))
    root = np.swapaxes(np.linalg.cholesky(0.5 * (information + information.mT)), 1, 2)
    place, stride, among = store.place(with_prior, _observations_before(network)[with_prior])
    store.put(place, stride, 0, network.points.places[with_prior])
    store.put(place, stride, 3, root[:, *np.triu_indices(3)])
    weight[0, among] = 1.0
    after = np.full(with_prior.size, 9)
    for points, _, motion, _ in known_motions(network):
        members = np.searchsorted(with_prior, points)
        after[members] = store.put(place[members], stride[members], after[members], motion)


def _fill_surface(network: Network, store: _Store, starts: Array, weight: Array) -> tuple[Index, Index]:
    """Heights above the terrain model: their weights, and how its unknowns move it.

    Returned are their indices among all observations, and the points that they belong to.
    """
    if network.surface is None:
        return no_rows(), no_rows()
    on_surface = np.flatnonzero(np.isfinite(network.surface.sigmas))
    slots = _observations_before(network) + (network.points.kinds == PointKind.CONSTRAINED)
    place, stride, among = store.place(on_surface, slots[on_surface])
    weight[0, among] = 1.0 / network.surface.sigmas[on_surface]
    starts = starts[store.patterns.point_index]
    moved = store.put(place, stride, 0, network.surface.directions(starts[on_surface]))
    for members, motion in common_lifts(network, starts):
        at = np.searchsorted(on_surface, members)
        store.put(place[at], stride[at], moved, motion)
    return among, on_surface


def _fill_stereo(network: Network, store: _Store, stereo: StereoRows | None, weight: Array) -> Index:
    """Heights above stereo surfaces; their places among all observations."""
    if stereo is None or network.stereo is None:
        return no_rows()
    points, before = stereo.points, _observations_before(network)[stereo.points]
    before += network.points.kinds[points] == PointKind.CONSTRAINED
    if network.surface is not None:
        before += np.isfinite(network.surface.sigmas[points])
    place, stride, among = store.place(points, before)
    weight[0, among] = 1.0 / network.stereo.sigmas[points]
    at = store.put(place, stride, 0, stereo.reference)
    at = store.put(place, stride, at, stereo.normals)
    at = store.put(place, stride, at, stereo.heights)
    for part, directions in stereo.parts:
        store.put(place[part], stride[part], at, directions)
    return among


def _begin_crossing(network: Network, places: Array | None) -> Crossing:
    """Points that start at the intersection of their nominal rays: free ones without a position in `places` (n, 3)."""
    free, known = (network.points.kinds == PointKind.FREE) & ~network.undetermined, network.points.places
    if places is not None:
        given = finite_rows(places)
        free, known = free & ~given, np.where(given[:, None], places, known)
    return Crossing(free, read_only(known), np.empty(known.shape), np.empty(free.size))


def _starting_points(
    network: Network, patterns: Patterns, crossing: Crossing | None
) -> tuple[Array, NDArray[np.int8]]:
    """(n, 3) m, start of each point's inner solve: its known position, its a-priori place, or the intersection of its
    nominal rays; and (n,) the kind of each point.
    """
    assert crossing is not None
    free, _, starts, angles = crossing
    order = patterns.point_order
    where, remedy = "images and their ties", resection_remedy(network.images)
    some = np.arange(0, order.size, 1 + order.size // _ASKED)
    some = some[free[order[some]]]
    require_on_ground(starts[some], angles[order[some]], network.body, where, remedy)
    unknown = np.flatnonzero(~np.isfinite(starts @ np.ones(3)))
    _start_on_the_ground(network, unknown[free[order[unknown]]], patterns, starts)
    starts[unknown[~free[order[unknown]]]] = 0.0
    kinds = np.array([FREE, PRIOR, FIXED], dtype=np.int8)[network.points.kinds]
    kinds[network.undetermined | parallel(network, angles)] = OUT
    return starts, kinds[order]


def _start_on_the_ground(network: Network, missing: Index, patterns: Patterns, starts: Array) -> None:
    """Start points (m,) of the layout without another position (parallel rays) where their first ray meets the
    ellipsoid.
    """
    chosen = np.flatnonzero(np.isin(network.rays.point, patterns.point_order[missing])) if missing.size else missing
    with_rays, first = np.unique(network.rays.point[chosen], return_index=True)
    for i, k in zip(with_rays.tolist(), chosen[first].tolist(), strict=True):
        image, start = network.images[network.rays.image[k]], patterns.point_index[i]
        starts[start] = image.image_to_ground(*network.rays.places[[k]].T)[0][0]
        if not np.all(np.isfinite(starts[start])):
            raise InputError(
                f"point {network.points.ids[i]}", f"its ray in image {image.name} misses the body",
                "image places on the body", "check the image's orientation or leave the point out",
            )  # fmt: skip
