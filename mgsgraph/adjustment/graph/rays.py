"""Constants of the image rays, image by image: laid out once, and renewed in place where the lines about which they are
laid out change. Intersections of points' nominal rays.
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.graph.patterns import Patterns, Terms
from mgsgraph.adjustment.graph.variables import Variables, angles_of
from mgsgraph.compiled import cached_kernel, compiled, in_threads
from mgsgraph.factors.algebra import add, dot, scale, subtract, transform, transpose
from mgsgraph.factors.collinearity import image_motion, ray_motion, to_lines_and_samples
from mgsgraph.factors.intersection import add_ray, least_eigenvalue, solve_symmetric
from mgsgraph.factors.rotation import opk_rotation, quaternion_matrix
from mgsgraph.geometry import rotation
from mgsgraph.geometry.camera import Detector
from mgsgraph.geometry.compiled_pose import set_vector, vector
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.kernel.rows import CAMERA, IMAGE, OPK_PAPER, PREDICTED, Model, neighboring_pieces, takes_slope
from mgsgraph.network import Network
from mgsgraph.network.effects import SharedEffects, common_looks

_SHARE = 1 << 16
"""Rays that a thread takes at a time."""
_WORTHWHILE = 2_000
"""Rays of an image below which threads wait longer for the interpreter than they save."""
_BLOCK = 1024
"""Rays whose components are stored at a time."""
_Rays = NDArray[np.int32]
"""(m,) numbers of rays in the network; int32, since there are many."""


class Crossing(NamedTuple):
    """Where nominal rays cross; n points."""

    wanted: Mask
    """(n,) points whose place is asked for, network order."""
    known: Array
    """(n, 3) m, of the others, and where rays don't cross; network order."""
    places: Array
    """(n, 3) m, in the order of the layout."""
    apart: Array
    """(n,) rad between the outermost rays, network order."""


class RayConstants:
    """Lays out the constants of a network's image rays.

    Parameters
    ----------
    network : Network
    model : Model
    variables : Variables
    patterns : Patterns
    slot : (k,)
        Index of each ray among its point's observations; overwritten by its place among all observations (`among`).
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
        self._of_look = np.zeros((2, network.rays.point.size if looks else 0), dtype=np.int64)
        """(2, k) table and row of each ray's looks by errors in common; empty where there are none."""
        for number, (members, _) in enumerate(looks, 1):
            self._of_look[:, members] = np.full(members.size, number), np.arange(members.size)
        piece_of = np.repeat(np.arange(piece.shape[0], dtype=np.int32), piece[:, 2])
        self.among = slot
        """(k,) place of each ray among all observations; int32, for there are many."""
        self._table = network.rays.point, patterns.point_index, piece_of, piece, before, self.among
        """What `constants_of` takes."""
        places_of_rays(self._table)
        last = int(self.among.max(initial=-1))
        self._by_image, ends = by_image(network.rays.image, self.among, last, len(network.images))
        self._ends: list[int] = ends.tolist()
        """(k,) rays in the order of their images, and where those of each begin."""

    def fill(
        self, data: Array, weight: Array, terms: Terms, bending: Array, crossing: Crossing | None, focal: Array
    ) -> None:
        """Constants (but for the scale of the measured-line form, `fill_scales`) and weights of all rays, and where
        they cross; slopes of detector lines with shared unknowns `bending` (columns,). `focal` (s,) m are focal
        lengths of the patterns' observations.
        """
        self._nodes = terms.of_rays if self._network.passes else None
        sigmas = self._network.rays.sigmas
        self._each(lambda _, k: set_weights(k, self.among, sigmas, weight))
        self.renew(data, terms, bending)
        if crossing is not None:
            self._cross(data, crossing, focal)

    def _cross(self, data: Array, crossing: Crossing, focal: Array) -> None:
        """Where rays cross, share by share of neighboring pieces."""
        _, _, _, piece, before, _ = self._table
        kinds = np.concatenate([[0], np.cumsum(self._patterns.kind == IMAGE)])
        rays = np.diff(kinds[self._patterns.first])
        patterns = piece, before, self._patterns.first, rays, focal
        many = np.concatenate([[0], np.cumsum(piece[:, 2] * (1 + rays[piece[:, 0]]))])  # rays, and points without any
        angles, order = self._model.angles, self._patterns.point_order
        in_threads(
            lambda ends: crossings(*ends, angles, patterns, order, data, *crossing), neighboring_pieces(many, _SHARE)
        )

    def _each(self, work: Callable[[int, _Rays], None]) -> None:
        """Call a function for each image and some of its rays, in threads where these are many."""
        of_images = (
            (j, self._by_image[at : min(at + _SHARE, last)])
            for j, (first, last) in enumerate(pairwise(self._ends))
            for at in range(first, last, _SHARE)
        )
        if self._by_image.size < _WORTHWHILE * len(self._ends):
            for one in of_images:
                work(*one)
        else:
            in_threads(lambda one: work(*one), of_images)

    def renewable(self, terms: Terms) -> bool:
        """Whether rays about other lines depend on the same nodes as those that were laid out."""
        return self._nodes is None or np.array_equal(self._nodes, terms.of_rays)

    def renew(self, data: Array, terms: Terms, bending: Array) -> None:
        """The same constants about other lines, in place; they depend on the same nodes as before. Strict form."""
        values = self._variables.split(bending)

        def fill(j: int, rays: _Rays) -> None:
            if not self._of_look.size:
                self._fill_image(j, rays, self._looks[0], data, terms, values)
                return
            for number in np.unique(self._of_look[0, rays]).tolist():
                chosen = rays[self._of_look[0, rays] == number]
                self._fill_image(j, chosen, self._looks[number][self._of_look[1, chosen]], data, terms, values)

        self._each(fill)

    def fill_scales(self, data: Array, starts: Array) -> None:
        """The scale of the measured-line form, from the image motion of points at their starting positions (n, 3), in
        the order of the layout.
        """
        first = 9 if self._model.angles == CAMERA else 8  # behind the detector pixel
        rays, index = self._network.rays, self._patterns.point_index

        def rescale(j: int, k: _Rays) -> None:
            image, lines = self._network.images[j], rays.places[k, 0]
            pose, detector = image.pose(lines).in_axes(self._axes[j]), self._pixels(j, rays.places[k, 1])
            scale = frozen_scale(pose, image.interior.focal_length, starts[index[rays.point[k]]], detector.slope)
            begin, step = constants_of(k, self._table)
            store(begin, step, first, scale.reshape(-1, 4), data)

        self._each(rescale)

    def _pixels(self, j: int, samples: Array) -> Detector:
        """Detector pixels of an image at samples (k,), in the axes of its pass."""
        interior = self._network.images[j].interior
        return Detector(*interior.focal_plane(samples)).in_axes(self._axes[j], interior.focal_length)

    @cached_property
    def _axes(self) -> list[Array | None]:
        """Of each image the axes of its pass (`Network.axes_of`)."""
        passes = self._network.passes
        axes: list[Array | None] = [None] * len(self._network.images)
        for pass_ in passes:
            for j in pass_.images.tolist():
                axes[j] = pass_.axes_of(j)
        return axes

    def _fill_image(
        self, j: int, k: _Rays, common: Array, data: Array, terms: Terms, values: Sequence[Array]
    ) -> None:
        """Constants of the rays `k` of an image, whose looks by errors in common are `common`, by as many factors each,
        in the order in which `kernel.tile.load_observation` takes them.
        """
        angles, image, places = self._model.angles, self._network.images[j], self._network.rays.places
        measured, samples = places.take(k, axis=0).T  # indexing takes four times as long
        lines, predicted, pixels = terms.lines[k], self._model.line == PREDICTED, self._pixels(j, samples)
        moments = image.moments(lines)
        pose = image.trajectory.pose(moments.times).in_axes(self._axes[j])
        form = [pose.position, attitudes(pose, angles), pixels.place]
        if predicted:
            pose = pose.scaled(moments.periods)
            rates = pose.angular_rate if angles == CAMERA else angle_rates(pose, angles)
            rates = rates + self.effects.turning(j, moments.u, values)
            form += [pose.velocity, rates, (lines - measured)[:, None]]
        if not takes_slope(self._model):
            form.append(np.zeros((k.size, 4)))  # `fill_scales` fills these
        elif np.isnan(self._patterns.slopes[j, 0]):
            bent = self.effects.bends(j)
            form.append(self.effects.slopes(j, samples, values) if bent else pixels.slope)
        basis = terms.basis(j, moments, terms.of_rays[k if self._network.passes else k[:0]], predicted)
        effects = self.effects.of_rays(j, moments.u, samples, common).reshape(k.size, -1)
        (begin, step), first = constants_of(k, self._table), 0
        for part in (*form, *basis, effects):
            store(begin, step, first, part, data)
            first += part.shape[1]


def attitudes(pose: Pose, angles: int) -> Array:
    """(k, 4 or 3) quaternions, or omega, phi, kappa of the product M' = R3 R2 R1 (papers) or M = R3 R2 R1."""
    if angles == CAMERA:
        return rotation.from_matrix(pose.matrix)
    return rotation.omega_phi_kappa(pose.matrix if angles == OPK_PAPER else pose.matrix.mT)


def angle_rates(pose: Pose, angles: int) -> Array:
    """(k, 3) rates of these angles, per line."""
    chain = rotation.angle_axes(attitudes(pose, angles), camera_to_body=angles == OPK_PAPER)
    return np.asarray(np.linalg.solve(chain, pose.angular_rate[:, :, None])[:, :, 0])


def frozen_scale(pose: Pose, focal_length: float, points: Array, slope: Array) -> Array:
    """(k, 2, 2) focal-plane m to residual lines and samples: image motion per line, from the nominal, and detector
    slope.
    """
    attitude, angular_rate = tuple(np.moveaxis(pose.matrix, 0, -1)), tuple(pose.angular_rate.T)
    ray = transform(attitude, tuple((points - pose.position).T))
    motion = image_motion(ray, ray_motion(attitude, ray, tuple(pose.velocity.T), angular_rate), focal_length)
    return np.stack([np.stack(row, axis=1) for row in to_lines_and_samples(motion, tuple(slope.T))], axis=1)


# --- compiled


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
def places_of_rays(table):
    """Place of each ray among all observations, the last of `table`, in place of its index among its point's."""
    point, point_index, piece_of, piece, _, among = table
    for k in range(point.size):
        index = point_index[point[k]]
        p = piece_of[index]
        among[k] = piece[p, 4] + among[k] * piece[p, 2] + index - piece[p, 1]


@cached_kernel
def by_image(image, among, last, images):
    """Rays (k,) image after image, those of an image in the order of the layout, and where those of each begin
    (images + 1,). `among` as of `RayConstants`; `last` is the largest.
    """
    laid = np.full(last + 1, -1, dtype=np.int32)
    begin, order = np.zeros(images + 1, dtype=np.int64), np.empty(image.size, dtype=np.int32)
    for k in range(image.size):
        laid[among[k]] = k
        begin[image[k] + 1] += 1
    for j in range(images):
        begin[j + 1] += begin[j]
    at = begin.copy()
    for k in laid:
        if k >= 0:
            order[at[image[k]]] = k
            at[image[k]] += 1
    return order, begin


@cached_kernel
def set_weights(rays, among, sigmas, weight):
    """Weights (2, t), the inverse of the sigmas (k, 2), of some rays."""
    for k in rays:
        for axis in range(2):
            weight[axis, among[k]] = 1.0 / sigmas[k, axis]


@cached_kernel
def constants_of(rays, table):
    """Where the constants of some rays (m,) begin in the data, and the steps from one component to the next (m,).

    `table` holds the points of all rays (k,), the points' places in the layout (n,), the pieces (n,) of these, `piece`
    and `before` as of `rows.lay_out_rows`, and places (k,) among all observations. Rays that are neighbors among these
    are mostly of one image and piece; the first of them is looked for.
    """
    point, point_index, piece_of, piece, before, among = table
    begin, step = np.empty(rays.size, dtype=np.int64), np.empty(rays.size, dtype=np.int64)
    last, end = np.int64(-2), np.int64(-1)
    for r in range(rays.size):
        place = np.int64(among[rays[r]])
        if place == last + 1 and place < end:
            begin[r], step[r] = begin[r - 1] + 1, step[r - 1]
        else:
            p = piece_of[point_index[point[rays[r]]]]
            size, rest = piece[p, 2], place - piece[p, 4]
            slot = rest // size
            begin[r], step[r] = piece[p, 3] + size * before[piece[p, 0], slot] + rest - slot * size, size
            end = piece[p, 4] + (slot + 1) * size
        last = place
    return begin, step


@cached_kernel
def store(begin, step, first, values, data):
    """Store components (m, c) of rays whose constants begin at `begin` (m,), from the component `first` on.

    Component after component: those of one ray lie at distances that share one place of the processor's cache.
    """
    for at in range(0, begin.size, _BLOCK):
        end = min(at + _BLOCK, begin.size)
        for c in range(values.shape[1]):
            for r in range(at, end):
                data[begin[r] + (first + c) * step[r]] = values[r, c]


@compiled
def origin_of(data, at, stride):
    """Origin (m) of a nominal ray."""
    return data[at], data[at + stride], data[at + 2 * stride]


@compiled
def look_of(data, at, stride, angles, focal):
    """Unit direction, body-fixed, of a nominal ray whose constants begin at `at`."""
    if angles == CAMERA:
        q = data[at + 3 * stride], data[at + 4 * stride], data[at + 5 * stride], data[at + 6 * stride]
        attitude, at = quaternion_matrix(q), at + 7 * stride
    else:
        product = opk_rotation((data[at + 3 * stride], data[at + 4 * stride], data[at + 5 * stride]))
        attitude, at = transpose(product) if angles == OPK_PAPER else product, at + 6 * stride
    look = transform(transpose(attitude), (data[at], data[at + stride], focal))
    return scale(1.0 / np.sqrt(dot(look, look)), look)


@cached_kernel
def crossings(first, last, angles, patterns, point_order, data, wanted, known, positions, apart):
    """Intersections of the nominal rays of points, and the angles between the rays.

    Parameters
    ----------
    first, last
        Pieces first .. last - 1.
    angles
        As of `Model`.
    patterns
        `piece` and `before` as of `rows.lay_out_rows`, first observation of each pattern (q + 1,), how many of them,
        the first ones, are image rays (q,), and focal lengths (s,) in m.
    point_order : (n,)
        Network point at each index of the layout.
    data
        With origins, attitudes and detector pixels of the rays.
    wanted, known : (n,), (n, 3)
        As of `Crossing`.
    positions : (n, 3)
        m, in the order of the layout; the known ones where rays are closer to parallel than 2e-7 rad or meet behind a
        camera.
    apart : (n,)
        rad between the outermost rays, about: filled for all; zero for fewer than two.
    """
    piece, before, observation, rays, focal = patterns
    units = np.empty((before.shape[1], 3))
    for p in range(first, last):
        pattern, size = piece[p, 0], piece[p, 2]
        count = rays[pattern]
        for inside in range(size):
            i, start, origin = piece[p, 1] + inside, piece[p, 3] + inside, (0.0, 0.0, 0.0)
            normal, right = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
            for s in range(count):
                at = start + size * before[pattern, s]
                centre = origin_of(data, at, size)
                origin = centre if s == 0 else origin
                look = look_of(data, at, size, angles, focal[observation[pattern] + s])
                set_vector(units, s, look)
                normal, right = add_ray(normal, right, subtract(centre, origin), look)
            weakest = least_eigenvalue(normal, 2) / count if count >= 2 else 0.0
            k, point = point_order[i], (0.0, 0.0, 0.0)
            apart[k] = 2.0 * np.arcsin(np.sqrt(min(max(weakest, 0.0), 1.0)))
            usable = wanted[k] and weakest > 1e-14
            if usable:
                point = solve_symmetric(normal, right)
            for s in range(count if usable else 0):  # rays that part meet behind their cameras
                ahead = subtract(add(point, origin), origin_of(data, start + size * before[pattern, s], size))
                usable &= dot(ahead, vector(units, s)) > 0.0
            for a in range(3):
                positions[i, a] = point[a] + origin[a] if usable else known[k, a]
