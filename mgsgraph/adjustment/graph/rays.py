"""Constants of the image rays, share by share of neighbouring pieces: laid out once, and renewed in place where the
lines about which they are laid out change.
"""

import pickle
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.graph.loops import (
    crossings,
    places_of_rays,
    put_detectors,
    put_poses,
    put_scale,
    rays_inside,
)
from mgsgraph.adjustment.graph.patterns import Patterns
from mgsgraph.adjustment.graph.shared import SharedEffects
from mgsgraph.adjustment.graph.variables import Terms, Variables
from mgsgraph.compiled import in_threads
from mgsgraph.factors.algebra import transform
from mgsgraph.factors.collinearity import image_motion, ray_motion, to_lines_and_samples
from mgsgraph.geometry import rotation
from mgsgraph.geometry.camera import Detector
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.kernel.rows import CAMERA, IMAGE, OPK_PAPER, OPK_PEER, PREDICTED, Model
from mgsgraph.network import Network

_SHARE = 1 << 16
"""Observations that a thread takes at a time."""
_NO_UNITS = np.empty((0, 3))
"""No room for directions: they are not asked for."""


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
        self.effects = SharedEffects(network, model)
        rays = np.concatenate([[0], np.cumsum(patterns.kind == IMAGE)])
        begins = np.append(piece[:, 4], int(piece[:, 2] @ np.diff(patterns.first)[piece[:, 0]]))
        piece_of = np.repeat(np.arange(piece.shape[0], dtype=np.int32), piece[:, 2])
        self.among, ray = np.empty(slot.size, dtype=np.int32), np.empty(begins[-1], dtype=np.int32)
        """(k,) place of each ray among all observations; int32, for there are many."""
        places_of_rays(network.rays.point, slot, patterns.point_index, piece_of, piece, self.among, ray)
        counts = np.diff(rays[patterns.first])
        self._piece, self._before, self._begins, self._rays, self._ray = piece, before, begins, counts, ray

    def fill(self, data: Array, weight: Array, terms: Terms, bent: Array, crossing: Crossing | None) -> None:
        """Constants (but for the scale of the measured-line form, `fill_scales`) and weights of all rays, and where
        they cross; slopes of detector lines with shared unknowns `bent` (columns,).
        """
        values, self._nodes = self._variables.split(bent), terms.of_rays if self._network.passes else None

        def fill(share: Share) -> None:
            self._put_detectors(share, data, weight)
            units = _NO_UNITS if crossing is None else np.empty((share.ray.size, 3))
            self._put_poses(share, data, terms, values, units, True)
            if crossing is not None:
                ways = self._piece, self._before, self._rays, self._patterns.point_order
                crossings(share.first, share.last, *ways, data, units, *crossing)

        self._each(fill)

    def _each(self, work: Callable[[Share], None]) -> None:
        """Do some work on all rays, shared by threads."""
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

    def renew(self, data: Array, terms: Terms, bent: Array) -> None:
        """The same constants about other lines, in place; they depend on the same nodes as before. Strict form."""
        values = self._variables.split(bent)
        self._each(lambda share: self._put_poses(share, data, terms, values, _NO_UNITS, False))

    def fill_scales(self, data: Array, starts: Array) -> None:
        """The scale of the measured-line form, from the image motion of points at their starting positions (n, 3)."""
        rays, first = self._network.rays, 5 + (4 if self._model.angles == CAMERA else 3)

        def rescale(share: Share) -> None:
            for j, mine in share.by(share.image):
                image, axes, k = self._network.images[j], self._axes[j], share.ray[mine]
                focal_length = image.interior.focal_length
                pose = image.pose(rays.places[k, 0]).in_axes(axes)
                detector = Detector(*image.interior.focal_plane(rays.places[k, 1])).in_axes(axes, focal_length)
                scale = frozen_scale(pose, focal_length, starts[rays.point[k]], detector.slope)
                put_scale(mine, share.at, share.stride, first, scale.reshape(-1, 4), data)

        self._each(rescale)

    @cached_property
    def _axes(self) -> list[Array | None]:
        """Of each image the axes of its pass (`Network.axes_of`)."""
        strips = self._network.passes
        found: list[Array | None] = [None] * len(self._network.images)
        for strip in strips:
            for j in strip.images.tolist():
                found[j] = strip.axes_of(j)
        return found

    @cached_property
    def _optics(self) -> Index:
        """(m,) images with the same number have the same detector and optics, in the same axes."""
        numbers = dict[bytes, int]()
        keys = (
            pickle.dumps((image.interior, axes)) for image, axes in zip(self._network.images, self._axes, strict=True)
        )
        return np.array([numbers.setdefault(key, len(numbers)) for key in keys], dtype=np.int64)

    def _put_detectors(self, share: Share, data: Array, weight: Array) -> None:
        rays, strict = self._network.rays, self._model.line == PREDICTED
        first = 3 + (4 if self._model.angles == CAMERA else 3)
        for _, mine in share.by(self._optics[share.image]):
            j = int(share.image[mine[0]])
            interior = self._network.images[j].interior
            found = Detector(*interior.focal_plane(rays.places[share.ray[mine], 1]))
            found = found.in_axes(self._axes[j], interior.focal_length)
            put_detectors(
                mine, share.ray, share.at, share.stride, share.place, rays.sigmas, first, strict, *found, data, weight
            )

    def _put_poses(
        self, share: Share, data: Array, terms: Terms, values: Sequence[Array], units: Array, whole: bool
    ) -> None:
        for j, mine in share.by(share.image):
            self._put_image(j, mine, share, data, terms, values, units, whole)

    def _put_image(
        self, j: int, mine: Index, share: Share, data: Array, terms: Terms, values: Sequence[Array], units: Array,
        whole: bool,
    ) -> None:  # fmt: skip
        """Poses of the rays `mine` of an image."""
        rays, model, axes, image = self._network.rays, self._model, self._axes[j], self._network.images[j]
        k, predicted, focal_length = share.ray[mine], model.line == PREDICTED, image.interior.focal_length
        lines, samples = terms.lines[k], rays.places[k, 1]
        pose, nothing = image.pose(lines).in_axes(axes), np.empty((mine.size, 0))
        angular_rate = angle_rates(pose, model.angles) if predicted and model.angles != CAMERA else pose.angular_rate
        slope, scale = nothing, nothing
        if self.effects.bends(j):
            slope = self.effects.slopes(j, samples, values)
        if whole and model.angles == OPK_PEER and not predicted:
            detector = Detector(*image.interior.focal_plane(samples)).in_axes(axes, focal_length)
            scale = peer_scale(slope if slope.size else detector.slope)
        effects = self.effects.of_rays(j, image.normalised(lines), samples)
        tail = [*terms.basis(j, lines, terms.of_rays[k], predicted), effects.reshape(mine.size, -1)]
        put_poses(
            mine, share.at, share.stride, model.angles, predicted,
            (pose.position, pose.matrix, pose.velocity, angular_rate), focal_length, scale, slope,
            lines - rays.places[k, 0], np.hstack(tail), data, units,
        )  # fmt: skip


def angle_rates(pose: Pose, angles: int) -> Array:
    """(k, 3) rates per line of omega, phi, kappa in the product M' = R3 R2 R1 (papers) or M = R3 R2 R1."""
    paper = angles == OPK_PAPER
    found = rotation.omega_phi_kappa(pose.matrix if paper else np.swapaxes(pose.matrix, 1, 2))
    chain = rotation.angle_axes(found, camera_to_body=paper)
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
    of_ray = ray_motion(attitude, ray, tuple(pose.velocity.T), angular_rate)
    motion = image_motion(ray, of_ray, focal_length)
    return np.stack([np.stack(row, axis=1) for row in to_lines_and_samples(motion, tuple(slope.T))], axis=1)
