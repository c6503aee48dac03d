"""Constants of the image rays, share by share of neighboring pieces: laid out once, and renewed in place where the
lines about which they are laid out change. Intersections of points' nominal rays.

Loops over rays take those of some neighboring pieces, observation by observation as they lie in the data: of each of
these r rays there is its number in the network, where its constants begin, the step to the next one, and its place
among all observations.
"""

import pickle
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.graph.patterns import Patterns, Terms
from mgsgraph.adjustment.graph.variables import Variables, angles_of
from mgsgraph.compiled import cached_kernel, compiled, in_threads, make_equations_compilable
from mgsgraph.factors.algebra import add, dot, scale, subtract, transform, transpose
from mgsgraph.factors.collinearity import image_motion, ray_motion, to_lines_and_samples
from mgsgraph.factors.intersection import add_ray, least_eigenvalue, solve_symmetric
from mgsgraph.factors.rotation import matrix_quaternion, opk_angles
from mgsgraph.geometry import rotation
from mgsgraph.geometry.camera import Detector
from mgsgraph.geometry.compiled_pose import rows_of, vector
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.kernel.rows import CAMERA, IMAGE, OPK_PAPER, OPK_PEER, PREDICTED, Model
from mgsgraph.network import Network
from mgsgraph.network.effects import SharedEffects, common_looks

_SHARE = 1 << 16
"""Observations that a thread takes at a time."""
_NO_UNITS = np.empty((0, 3))
"""Empty array where no directions are needed."""


class Share(NamedTuple):
    """The r rays of some neighbouring pieces, in the order of their observations."""

    first: int
    """Piece."""
    last: int
    """Piece after the last one."""
    ray: NDArray[np.int32]
    """(r,) ray."""
    at: Index
    """(r,) where its constants begin in the data."""
    stride: Index
    """(r,) step to the next one."""
    place: Index
    """(r,) among all observations."""
    image: Index
    """(r,) whose it is."""

    def by(self, number: Index) -> Iterator[tuple[int, Index]]:
        """Which rays have the same `number` (r,)."""
        order = np.argsort(number, kind="stable")
        edges = np.flatnonzero(np.diff(number[order], prepend=-1, append=-1)).tolist()
        for a, b in pairwise(edges):
            yield int(number[order[a]]), order[a:b]


class Crossing(NamedTuple):
    """Where nominal rays cross; n points in network order."""

    wanted: Mask
    """(n,) points whose place is asked for."""
    places: Array
    """(n, 3) m."""
    apart: Array
    """(n,) rad between the outermost rays."""


class RayConstants:
    """Lays out the constants of a network's image rays.

    Parameters
    ----------
    network : Network
    model : Model
    variables : Variables
    patterns : Patterns
    slot : (k,)
        Index of each ray among its point's observations.
    piece, before
        As of `rows.lay_out_rows`.
    """

    def __init__(
        self, network: Network, model: Model, variables: Variables, patterns: Patterns, slot: NDArray[np.int32],
        piece: Index, before: Index,
    ) -> None:  # fmt: skip
        self._network, self._model, self._patterns, self._variables = network, model, patterns, variables
        self.effects, looks = SharedEffects(network, angles_of(model)), common_looks(network)
        self._looks = [np.empty((1, 2, 0)), *(look for _, look in looks)]
        self._of_look = np.zeros((2, network.rays.point.size), dtype=np.int64)
        """(2, k) table and row of each ray's looks by errors in common."""
        for number, (members, _) in enumerate(looks, 1):
            self._of_look[:, members] = np.full(members.size, number), np.arange(members.size)
        rays = np.concatenate([[0], np.cumsum(patterns.kind == IMAGE)])
        begins = np.append(piece[:, 4], int(piece[:, 2] @ np.diff(patterns.first)[piece[:, 0]]))
        piece_of = np.repeat(np.arange(piece.shape[0], dtype=np.int32), piece[:, 2])
        self.among, ray = np.empty(slot.size, dtype=np.int32), np.empty(begins[-1], dtype=np.int32)
        """(k,) place of each ray among all observations; int32, for there are many."""
        places_of_rays(network.rays.point, slot, patterns.point_index, piece_of, piece, self.among, ray)
        counts = np.diff(rays[patterns.first])
        self._piece, self._before, self._begins, self._rays, self._ray = piece, before, begins, counts, ray

    def fill(self, data: Array, weight: Array, terms: Terms, bending: Array, crossing: Crossing | None) -> None:
        """Constants (but for the scale of the measured-line form, `fill_scales`) and weights of all rays, and where
        they cross; slopes of detector lines with shared unknowns `bending` (columns,).
        """
        values, self._nodes = self._variables.split(bending), terms.of_rays if self._network.passes else None

        def fill(share: Share) -> None:
            self._fill_detectors(share, data, weight)
            units = _NO_UNITS if crossing is None else np.empty((share.ray.size, 3))
            self._fill_poses(share, data, terms, values, units, True)
            if crossing is not None:
                ways = self._piece, self._before, self._rays, self._patterns.point_order
                crossings(share.first, share.last, *ways, data, units, *crossing)

        self._each(fill)

    def _each(self, work: Callable[[Share], None]) -> None:
        """Call a function for all rays, in threads."""
        total = int(self._begins[-1])
        edges = np.unique(np.searchsorted(self._begins, [*range(0, total, _SHARE), total])).tolist()
        in_threads(lambda ends: work(self._share(*ends)), list(pairwise(edges)))

    def _share(self, first: int, last: int) -> Share:
        most = int(self._begins[last] - self._begins[first])
        ray = np.empty(most, dtype=np.int32)
        at, stride, place, image = (np.empty(most, dtype=np.int64) for _ in range(4))
        count = rays_inside(
            first, last, self._piece, self._before, self._patterns.first, self._rays, self._patterns.image, self._ray,
            ray, at, stride, place, image,
        )  # fmt: skip
        return Share(first, last, ray[:count], at[:count], stride[:count], place[:count], image[:count])

    def renewable(self, terms: Terms) -> bool:
        """Whether rays about other lines depend on the same nodes as those that were laid out."""
        return self._nodes is None or np.array_equal(self._nodes, terms.of_rays)

    def renew(self, data: Array, terms: Terms, bending: Array) -> None:
        """The same constants about other lines, in place; they depend on the same nodes as before. Strict form."""
        values = self._variables.split(bending)
        self._each(lambda share: self._fill_poses(share, data, terms, values, _NO_UNITS, False))

    def fill_scales(self, data: Array, starts: Array) -> None:
        """The scale of the measured-line form, from the image motion of points at their starting positions (n, 3)."""
        rays, first = self._network.rays, 5 + (4 if self._model.angles == CAMERA else 3)

        def rescale(share: Share) -> None:
            for j, chosen in share.by(share.image):
                image, axes, k = self._network.images[j], self._axes[j], share.ray[chosen]
                focal_length = image.interior.focal_length
                pose = image.pose(rays.places[k, 0]).in_axes(axes)
                detector = Detector(*image.interior.focal_plane(rays.places[k, 1])).in_axes(axes, focal_length)
                scale = frozen_scale(pose, focal_length, starts[rays.point[k]], detector.slope)
                store_scale(chosen, share.at, share.stride, first, scale.reshape(-1, 4), data)

        self._each(rescale)

    @cached_property
    def _axes(self) -> list[Array | None]:
        """Of each image the axes of its pass (`Network.axes_of`)."""
        passes = self._network.passes
        axes: list[Array | None] = [None] * len(self._network.images)
        for pass_ in passes:
            for j in pass_.images.tolist():
                axes[j] = pass_.axes_of(j)
        return axes

    @cached_property
    def _optics(self) -> Index:
        """(m,) images with the same number have the same detector and optics, in the same axes."""
        numbers = dict[bytes, int]()
        keys = (
            pickle.dumps((image.interior, axes)) for image, axes in zip(self._network.images, self._axes, strict=True)
        )
        return np.array([numbers.setdefault(key, len(numbers)) for key in keys], dtype=np.int64)

    def _fill_detectors(self, share: Share, data: Array, weight: Array) -> None:
        rays, strict = self._network.rays, self._model.line == PREDICTED
        first = 3 + (4 if self._model.angles == CAMERA else 3)
        for _, chosen in share.by(self._optics[share.image]):
            j = int(share.image[chosen[0]])
            interior = self._network.images[j].interior
            detector = Detector(*interior.focal_plane(rays.places[share.ray[chosen], 1]))
            detector = detector.in_axes(self._axes[j], interior.focal_length)
            store_detectors(
                chosen, share.ray, share.at, share.stride, share.place, rays.sigmas, first, strict, *detector, data,
                weight,
            )

    def _fill_poses(
        self, share: Share, data: Array, terms: Terms, values: Sequence[Array], units: Array, with_scale: bool
    ) -> None:
        several = len(self._looks)
        for number, chosen in share.by(share.image * several + self._of_look[0, share.ray]):
            self._fill_image(*divmod(number, several), chosen, share, data, terms, values, units, with_scale)

    def _fill_image(
        self, j: int, look: int, chosen: Index, share: Share, data: Array, terms: Terms, values: Sequence[Array],
        units: Array, with_scale: bool,
    ) -> None:  # fmt: skip
        """Poses of the `chosen` rays of an image, which have errors in common by as many factors."""
        rays, model, axes, image = self._network.rays, self._model, self._axes[j], self._network.images[j]
        k, predicted, focal_length = share.ray[chosen], model.line == PREDICTED, image.interior.focal_length
        lines, samples = terms.lines[k], rays.places[k, 1]
        pose, empty = image.pose(lines).in_axes(axes), np.empty((chosen.size, 0))
        angular_rate = angle_rates(pose, model.angles) if predicted and model.angles != CAMERA else pose.angular_rate
        if predicted:
            angular_rate = angular_rate + self.effects.turning(j, image.normalised(lines), values)
        slope, scale = empty, empty
        if self.effects.bends(j):
            slope = self.effects.slopes(j, samples, values)
        if with_scale and model.angles == OPK_PEER and not predicted:
            detector = Detector(*image.interior.focal_plane(samples)).in_axes(axes, focal_length)
            scale = peer_scale(slope if slope.size else detector.slope)
        common = self._looks[look][self._of_look[1, k]]
        effects = self.effects.of_rays(j, image.normalised(lines), samples, common)
        tail = [*terms.basis(j, lines, terms.of_rays[k], predicted), effects.reshape(chosen.size, -1)]
        store_poses(
            chosen, share.at, share.stride, model.angles, predicted,
            (pose.position, pose.matrix, pose.velocity, angular_rate), focal_length, scale, slope,
            lines - rays.places[k, 0], np.hstack(tail), data, units,
        )  # fmt: skip


def angle_rates(pose: Pose, angles: int) -> Array:
    """(k, 3) rates per line of omega, phi, kappa in the product M' = R3 R2 R1 (papers) or M = R3 R2 R1."""
    paper = angles == OPK_PAPER
    turned = rotation.omega_phi_kappa(pose.matrix if paper else np.swapaxes(pose.matrix, 1, 2))
    chain = rotation.angle_axes(turned, camera_to_body=paper)
    return np.asarray(np.linalg.solve(chain, pose.angular_rate[:, :, None])[:, :, 0])


def peer_scale(slope: Array) -> Array:
    """(k, 4) focal-plane m to residuals as opk-peer has them: pixels of the detector's size along and across it."""
    square = slope[:, 0] ** 2 + slope[:, 1] ** 2
    return np.stack([slope[:, 1], -slope[:, 0], -slope[:, 0], -slope[:, 1]], axis=1) / square[:, None]


def frozen_scale(pose: Pose, focal_length: float, points: Array, slope: Array) -> Array:
    """(k, 2, 2) focal-plane m to residual lines and samples: image motion per line, from the nominal, and detector
    slope.
    """
    attitude, angular_rate = tuple(np.moveaxis(pose.matrix, 0, -1)), tuple(pose.angular_rate.T)
    ray = transform(attitude, tuple((points - pose.position).T))
    motion = image_motion(ray, ray_motion(attitude, ray, tuple(pose.velocity.T), angular_rate), focal_length)
    return np.stack([np.stack(row, axis=1) for row in to_lines_and_samples(motion, tuple(slope.T))], axis=1)


# --- compiled: those take the rays of some neighboring pieces, observation by observation as they lie in the data

make_equations_compilable()


@cached_kernel
def followed(lines, measured, residuals, among, kind, point, point_index, image, size, beyond, out, predicted):
    """Predicted lines (k,) of rays, as residuals (t, 2) about `lines` (k,) have them, but for points that are `out` and
    those without a place; at most a share `beyond` of an image's lines (`size` (m,)) before it or after it. Returned is
    the largest change.
    """
    farthest = 0.0
    for k in range(lines.size):
        line = measured[k, 0] - residuals[among[k], 0]
        if kind[point_index[point[k]]] == out or not np.isfinite(line):
            line = lines[k]
        most = size[image[k]]
        predicted[k] = min(max(line, -beyond * most), (1.0 + beyond) * most)
        farthest = max(farthest, abs(predicted[k] - lines[k]))
    return farthest


@cached_kernel
def places_of_rays(point, slot, point_index, piece_of, piece, among, ray):
    """Place (k,) of each network ray among all t observations, and the inverse: `ray` (t,), -1 for other ones."""
    ray[:] = -1
    for k in range(point.size):
        index = point_index[point[k]]
        p = piece_of[index]
        among[k] = piece[p, 4] + slot[k] * piece[p, 2] + index - piece[p, 1]
        ray[among[k]] = k


@cached_kernel
def rays_inside(first, last, piece, before, observation, rays, image, ray, network_ray, at, stride, place, of_image):
    """The rays of the pieces first .. last - 1, their number returned.

    `observation` (q + 1,) is each pattern's first one, `rays` (q,) how many of them, the first ones, are image rays,
    `image` (s,) whose they are, `ray` (t,) as of `places_of_rays`. Filled are (r,) arrays: network ray, where its
    constants begin, step, place among all observations, image.
    """
    count = 0
    for p in range(first, last):
        pattern, size = piece[p, 0], piece[p, 2]
        for s in range(rays[pattern]):
            for inside in range(size):
                index = piece[p, 4] + s * size + inside
                network_ray[count], place[count] = ray[index], index
                at[count], stride[count] = piece[p, 3] + size * before[pattern, s] + inside, size
                of_image[count] = image[observation[pattern] + s]
                count += 1
    return count


@compiled
def put(data, at, stride, values):
    """Store the components of a tuple; return the index of the next one."""
    for value in values:
        data[at] = value
        at += stride
    return at


@compiled
def store_look(attitude, data, at, stride, focal, units, c):
    """The unit direction of a ray whose detector pixel is at `at` in the data."""
    look = transform(transpose(attitude), (data[at], data[at + stride], focal))
    units[c, 0], units[c, 1], units[c, 2] = scale(1.0 / np.sqrt(dot(look, look)), look)


@cached_kernel
def store_detectors(chosen, ray, at, stride, place, sigmas, first, predicted, detector, slope, data, weight):
    """Detector pixels (m, 2) of the `chosen` rays (m,), component `first` of each, their slopes in the strict form, and
    the weights.
    """
    for r in range(chosen.size):
        c = chosen[r]
        k, index = ray[c], place[c]
        weight[0, index], weight[1, index] = 1.0 / sigmas[k, 0], 1.0 / sigmas[k, 1]
        begin = at[c] + first * stride[c]
        begin = put(data, begin, stride[c], (detector[r, 0], detector[r, 1]))
        if predicted:
            put(data, begin + 6 * stride[c], stride[c], (slope[r, 0], slope[r, 1]))


@cached_kernel
def store_poses(chosen, at, stride, angles, predicted, pose, focal, scales, slope, offset, tail, data, units):
    """Constants of one image's `chosen` rays (m,) that follow from their lines, in the order in which
    `kernel.tile.load_observation` takes them.

    `pose` is (positions, matrices, velocities, angular rates or rates of the angles), `scales` (m, 4 or 0) S of the
    measured-line form where it is known already, `slope` (m, 2 or 0) that of the detector line where it isn't stored
    yet, `offset` (m,) lines from the measured line, `tail` (m, c) the last values: the line u of a polynomial, or
    values and rates of nodes, then directions. `units` (r, 3) are filled with unit directions unless empty.
    """
    position, matrix, velocity, angular_rate = pose
    for r in range(chosen.size):
        c = chosen[r]
        step = stride[c]
        begin = put(data, at[c], step, vector(position, r))
        attitude = rows_of(matrix[r])
        if angles == CAMERA:
            begin = put(data, begin, step, matrix_quaternion(attitude))
        else:
            begin = put(data, begin, step, opk_angles(transpose(attitude) if angles == OPK_PAPER else attitude))
        if units.shape[0] > 0:
            store_look(attitude, data, begin, step, focal, units, c)
        begin += 2 * step
        if predicted:
            begin = put(data, begin, step, vector(velocity, r))
            begin = put(data, begin, step, vector(angular_rate, r))
            for a in range(slope.shape[1]):
                data[begin + a * step] = slope[r, a]
            data[begin + 2 * step] = offset[r]
            begin += 3 * step
        else:
            for a in range(scales.shape[1]):
                data[begin + a * step] = scales[r, a]
            begin += 4 * step
        for a in range(tail.shape[1]):
            data[begin] = tail[r, a]
            begin += step


@cached_kernel
def store_scale(chosen, at, stride, first, values, data):
    """The scale (m, 4) of the measured-line form, component `first` of each of the `chosen` rays (m,)."""
    for r in range(chosen.size):
        for a in range(4):
            data[at[chosen[r]] + (first + a) * stride[chosen[r]]] = values[r, a]


@compiled
def origin_of(data, at, stride):
    """Origin (m) of a nominal ray."""
    return data[at], data[at + stride], data[at + 2 * stride]


@cached_kernel
def crossings(first, last, piece, before, rays, point_order, data, units, wanted, positions, angles):
    """Intersections of the nominal rays of points, and the angles between the rays.

    Parameters
    ----------
    first, last
        Pieces first .. last - 1.
    piece, before, rays
        As of `rays_inside`.
    point_order : (n,)
        Network point at each index of the layout.
    data
        With the origins of the rays.
    units : (r, 3)
        Directions of the rays, body-fixed.
    wanted : (n,)
        Points whose position is asked for.
    positions : (n, 3)
        m: filled for these, unless the rays are closer to parallel than 2e-7 rad or meet behind a camera.
    angles : (n,)
        rad between the outermost rays, about: filled for all; zero for fewer than two.
    """
    begin = 0
    for p in range(first, last):
        pattern, size = piece[p, 0], piece[p, 2]
        count = rays[pattern]
        for inside in range(size):
            i, start, origin = point_order[piece[p, 1] + inside], piece[p, 3] + inside, (0.0, 0.0, 0.0)
            normal, right = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
            for s in range(count):
                centre = origin_of(data, start + size * before[pattern, s], size)
                origin = centre if s == 0 else origin
                look = vector(units, begin + s * size + inside)
                normal, right = add_ray(normal, right, subtract(centre, origin), look)
            weakest = least_eigenvalue(normal) / count if count >= 2 else 0.0
            angles[i] = 2.0 * np.arcsin(np.sqrt(min(max(weakest, 0.0), 1.0)))
            if wanted[i]:
                point = solve_symmetric(normal, right)
                usable = weakest > 1e-14
                for s in range(count if usable else 0):  # rays that part meet behind their cameras
                    ahead = subtract(add(point, origin), origin_of(data, start + size * before[pattern, s], size))
                    usable &= dot(ahead, vector(units, begin + s * size + inside)) > 0.0
                for a in range(3):
                    positions[i, a] = point[a] + origin[a] if usable else positions[i, a]
        begin += count * size
