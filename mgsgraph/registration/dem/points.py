"""Dense matches intersected: ground points, and the two parts of their covariance.

A match says where a pixel of the first image lies in the second, and all its error is between the two. So the point is
on the pixel's own ray P = O + t u, where the ray (X, D) of the pixel found passes it: with n = u x D and m = D x n

    t = (X - O) m / u m,        dt/d(line, sample) = m dX/d(line, sample) / u m,

dX being how the second ray moves at the point. The matching error, a covariance C of two numbers, is then a length
along u of variance (dt) C (dt)': a covariance of rank one, and a height error at a map position that is level only
where the ground is.

The orientation's part is the same for neighbours and changes slowly along the images: it is taken from the posterior
at nodes, of rays of which the second alone is uncertain, alike on the ground, and is bilinear between them (which keeps
a covariance one).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mgsgraph.analysis.posterior import Posterior
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.terrain import between_nodes
from mgsgraph.matching.scene import Ground, Picture, Scene
from mgsgraph.network import ImageRays

if TYPE_CHECKING:
    from mgsgraph.matching.dense import DenseMatches

_AT_ONCE = 1 << 16
"""Matches that are intersected at a time."""
_LEAST_ANGLE = 1e-3
"""rad between two rays below which a position along them means nothing."""
_LINES_PER_NODE, _LEAST_NODES, _NODES_ACROSS = 128, 9, 5
"""Of the orientation's covariance: lines between nodes, nodes along an image at least, and across it."""
_SURE, _UNSURE = 1e-5, 1e-2
"""m on the ground, sigmas of the two rays at nodes: far below what orientation does, for that is all that counts."""


@dataclass(frozen=True, slots=True, eq=False)
class DensePoints:
    """Ground points of dense matches, body-fixed."""

    positions: Array
    """(n, 3) m."""
    matching: Array
    """(n, 3) m, one sigma of matching along the first image's ray: its covariance is the outer product of this."""
    orientation: Array
    """(n, 3, 3) m^2, covariance by the adjusted orientation alone, for sigma0 = 1; common to neighbours."""
    pair: Index
    """(n,) which pair of images each comes from, by its number among those matched."""
    misses: Array
    """(n,) m by which the two rays pass each other."""
    miss_sigmas: Array
    """(n,) m, of that by matching alone: where misses are larger, orientation is not what was adjusted."""

    @property
    def covariances(self) -> Array:
        """(n, 3, 3) m^2, of both parts."""
        return self.matching[:, :, None] * self.matching[:, None, :] + self.orientation

    def __len__(self) -> int:
        return int(self.pair.size)


class _Crossed(NamedTuple):
    """Rays of n matches where they meet."""

    positions: Array
    """(n, 3) m."""
    along: Array
    """(n, 3) unit, of the first ray."""
    by_pixel: Array
    """(n, 2) m along it per pixel of the second's line and sample."""
    misses: Array
    """(n,) m."""
    miss_by_pixel: Array
    """(n, 2) m of them per pixel of the second's line and sample."""
    good: Array
    """(n,) whether they meet, before both cameras."""


def intersected(posterior: Posterior, scene: Scene, matches: Sequence["DenseMatches"]) -> DensePoints:
    """Intersect dense matches of pairs of a scene's pictures, which are the posterior's images as adjusted
    (`production.adjusted_scene`). Those whose rays don't meet are left out; InputError where none is left.
    """
    parts = [
        _of_pair(posterior, scene, one, k, slice(begin, begin + _AT_ONCE), nodes)
        for k, one in enumerate(matches)
        if len(one.anchors)
        for nodes in [_orientation_nodes(posterior, scene, one)]
        for begin in range(0, len(one.anchors), _AT_ONCE)
    ]
    joined = [np.concatenate(part) for part in zip(*parts, strict=True)]
    if not joined or not len(joined[0]):
        found = "no matches, or rays that are all but parallel" if joined else "no matches"
        raise InputError(
            scene.where, f"{found}: nothing to make a terrain model from",
            "images that overlap and look from different sides",
        )  # fmt: skip
    return DensePoints(*joined)


def _of_pair(
    posterior: Posterior, scene: Scene, one: "DenseMatches", number: int, some: slice, nodes: "_Nodes"
) -> tuple[Array, Array, Array, Index, Array, Array]:
    """The record's arrays for some matches of a pair."""
    first, second = (scene.pictures[j] for j in (one.first, one.second))
    met = _crossed(first, second, one.anchors[some], one.pixels[some])
    variance, of_miss = (
        np.einsum("ni,nij,nj->n", rows, one.covariances[some], rows) for rows in (met.by_pixel, met.miss_by_pixel)
    )
    good = met.good & np.isfinite(variance) & (variance > 0.0)
    orientation = nodes.at(one.anchors[some][good])
    matching = met.along[good] * np.sqrt(variance[good])[:, None]
    pair = np.full(int(good.sum()), number)
    return met.positions[good], matching, orientation, pair, met.misses[good], np.sqrt(of_miss[good])


def _crossed(first: Picture, second: Picture, anchors: Array, pixels: Array) -> _Crossed:
    origin, along = first.image.sightlines(anchors[:, 0], anchors[:, 1], first.correction)
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    other, direction, d_other, d_direction = second.image.rays(pixels[:, 0], pixels[:, 1], second.correction)
    common = np.cross(along, direction)
    across = np.cross(direction, common)
    slant = np.einsum("ni,ni->n", along, across)
    length = np.linalg.norm(direction, axis=1)
    sine = np.linalg.norm(common, axis=1) / length
    with np.errstate(invalid="ignore", divide="ignore"):  # parallel rays
        distance = np.einsum("ni,ni->n", other - origin, across) / slant
        point = origin + distance[:, None] * along
        second_distance = np.einsum("ni,ni->n", point - other, direction) / length**2
        moves = d_other + second_distance[:, None, None] * d_direction
        by_pixel = np.einsum("ni,nij->nj", across, moves) / slant[:, None]
        unit = common / (sine * length)[:, None]
        misses = np.einsum("ni,ni->n", point - other, unit)
        miss_by_pixel = -np.einsum("ni,nij->nj", unit, moves)
    good = (sine > np.sin(_LEAST_ANGLE)) & (distance > 0.0) & (second_distance > 0.0)
    return _Crossed(point, along, by_pixel, misses, miss_by_pixel, good)


class _Nodes(NamedTuple):
    """The orientation's covariance of points at nodes of the first image."""

    lines: Array
    """(k,) evenly spaced, increasing."""
    samples: Array
    """(l,) evenly spaced, increasing."""
    covariances: Array
    """(k, l, 3, 3) m^2."""

    def at(self, pixels: Array) -> Array:
        """(n, 3, 3) m^2, bilinear at lines and samples (n, 2) of the first image."""
        axes = zip((self.lines, self.samples), pixels.T, strict=True)
        at = np.column_stack([np.interp(values, nodes, np.arange(nodes.size)) for nodes, values in axes])
        return between_nodes(self.covariances, at)


def _orientation_nodes(posterior: Posterior, scene: Scene, one: "DenseMatches") -> _Nodes:
    """Over the part of the first image that is matched."""
    first, second = (scene.pictures[j] for j in (one.first, one.second))
    low, high = one.anchors.min(axis=0) - 1.0, one.anchors.max(axis=0) + 1.0
    lines = np.linspace(low[0], high[0], max(_LEAST_NODES, int((high[0] - low[0]) / _LINES_PER_NODE) + 1))
    samples = np.linspace(low[1], high[1], _NODES_ACROSS)
    down, across = np.meshgrid(lines, samples, indexing="ij")
    anchors = np.column_stack([down.ravel(), across.ravel()])
    points = scene.ground.meet(*first.image.sightlines(anchors[:, 0], anchors[:, 1], first.correction))
    rays = [
        (anchors, _SURE / _pixel_sizes(first, scene.ground, anchors)),
        ((pixels := second.project(points)), _UNSURE / _pixel_sizes(second, scene.ground, pixels)),
    ]
    number, count = [posterior.network.image_number(picture.image.name) for picture in (first, second)], len(anchors)
    both = [np.stack(part, axis=1).reshape(-1, 2) for part in zip(*rays, strict=True)]
    asked = ImageRays(np.repeat(np.arange(count), 2), np.tile(number, count), *both)
    found = posterior.intersections(asked)[1].reshape(lines.size, samples.size, 3, 3)
    if not np.all(np.isfinite(found)):
        names = f"images {first.image.name} and {second.image.name}"
        raise InputError(names, "rays that don't meet as they were adjusted", "images of common ground")
    return _Nodes(lines, samples, found)


def _pixel_sizes(picture: Picture, ground: Ground, pixels: Array) -> Array:
    """(n, 2) m on the ground of a step of one line and of one sample from lines and samples (n, 2)."""
    here = picture.on_chart(ground, pixels)
    sizes = [np.linalg.norm(picture.on_chart(ground, pixels + step) - here, axis=1) for step in np.eye(2)]
    return np.stack(sizes, axis=1)
