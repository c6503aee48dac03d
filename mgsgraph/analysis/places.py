"""Ground places in an image, and image places on the ground, with the orientation as it stands: nominal or adjusted.

What an adjustment knows of the orientation goes into sigmas, by the law of error propagation: of image places through
their derivatives by the pose at their line, of ground places as far as the ray moves over the ground, which is held.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.body import Ellipsoid, east_north_up, intersect_ellipsoid, planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.intersection import meet_terrain
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.network.corrections import designs

_RELIEF = 0.1
"""m by which a ray may meet the terrain before a place on it, which is seen all the same (posts' edges, rounding)."""
_EDGE = 1e-6
"""px by which a place may lie beyond an edge that it is on (rounding)."""
_REACH = np.array([0.5, 2.0])
"""Share of the lines and samples beyond an image's edges at which its geometry still means something."""


class State(StrEnum):
    """Whether a place is one that the image shows."""

    SEEN = "seen"
    OUTSIDE = "outside the image"
    FAR_OUTSIDE = "far outside the image"
    BEHIND_BODY = "behind the body"
    BEHIND_RELIEF = "behind relief"
    NO_GROUND = "no ground"
    """The ray misses the body, or goes by the terrain model's edge or a hole; or no terrain model is at a place."""


class Places(NamedTuple):
    """Places that were projected."""

    pixels: Array
    """(n, 2) line and sample, first pixel's centre at (0.5, 0.5); NaN where there are none."""
    points: Array
    """(n, 3) m, body-fixed; NaN where there are none."""
    states: tuple[State, ...]
    """(n) of each."""
    covariances: Array | None
    """(n, 2, 2) px^2 of the line and sample of ground places, or (n, 3, 3) m^2 of the ground of image places, for
    sigma0 = 1; NaN where there is no place; None where nothing is known of the orientation's."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """An image with the orientation that is believed."""

    image: PushbroomImage
    """Its geometry; the trajectory is the nominal one."""
    correction: OrientationCorrection | None = None
    """Of the nominal orientation; none when absent."""
    solution: Solution | None = None
    """Adjustment that the correction is of, for its covariance."""
    number: int = 0
    """Of the image in that solution."""

    @classmethod
    def adjusted(cls, solution: Solution, number: int) -> "View":
        """An image of a solution."""
        return cls(solution.image(number), solution.correction(number), solution, number)

    def seen(self, points: Array, terrain: TerrainGrid | None = None) -> Places:
        """Where ground points (n, 3) in m are in the image; on a terrain model, relief may hide them."""
        pixels, _ = self.image.ground_to_image(points, self.correction)
        found = np.all(np.isfinite(pixels), axis=1)
        states = np.full(len(points), State.NO_GROUND, dtype=object)
        states[np.all(np.isfinite(points), axis=1)] = State.FAR_OUTSIDE
        states[found] = State.OUTSIDE
        states[self._inside(pixels)] = State.SEEN
        where = np.flatnonzero(found)
        origins, directions = self.image.sightlines(pixels[found, 0], pixels[found, 1], self.correction)
        if terrain is not None:
            nearer = np.linalg.norm(meet_terrain(origins, directions, terrain) - origins, axis=1)
            hidden = nearer < np.linalg.norm(points[found] - origins, axis=1) - _RELIEF
            states[where[hidden]] = State.BEHIND_RELIEF
        up = points[found] / _squares(self.image.body)
        away = np.einsum("ni,ni->n", up, points[found] - origins) >= 0.0
        states[where[away]] = State.BEHIND_BODY
        covariances = None
        if self.solution is not None:
            covariances = np.full((len(points), 2, 2), np.nan)
            covariances[found] = self._spread(points[found], pixels[found])
        return Places(pixels, points, tuple(states), covariances)

    def on_ground(
        self, pixels: Array, height: Array | float = 0.0, radius: Array | None = None,
        terrain: TerrainGrid | None = None,
    ) -> Places:  # fmt: skip
        """Where the rays of image places meet the ground.

        Parameters
        ----------
        pixels : (n, 2)
            Line and sample.
        height : float or (n,)
            m above the ellipsoid, added to its radii.
        radius : (n,), optional
            m from the body's centre, in place of the height.
        terrain : TerrainGrid, optional
            In place of both.
        """
        size = np.array([self.image.lines, self.image.samples])
        states = np.full(len(pixels), State.OUTSIDE, dtype=object)
        states[self._inside(pixels)] = State.SEEN
        near = np.all((pixels >= -_REACH * size) & (pixels <= (1.0 + _REACH) * size), axis=1)
        states[~near] = State.FAR_OUTSIDE
        points, slopes = np.full((len(pixels), 3), np.nan), np.full((len(pixels), 3, 2), np.nan)
        rays = self.image.rays(pixels[near, 0], pixels[near, 1], self.correction)
        origins, directions, d_origins, d_directions = rays
        body, level = self.image.body, np.broadcast_to(height, len(pixels))[near]
        if radius is not None:
            body, level = Ellipsoid(1.0, 1.0), radius[near] - 1.0
        if terrain is None:
            points[near], by_origin, by_direction = intersect_ellipsoid(origins, directions, body, level)
            slopes[near] = by_origin @ d_origins + by_direction @ d_directions
        else:
            points[near] = meet_terrain(origins, directions, terrain)
            slopes[near] = terrain_slopes(points[near], origins, directions, d_origins, d_directions, terrain)
        met = np.all(np.isfinite(points), axis=1)
        states[near & ~met] = State.NO_GROUND
        covariances = None
        if self.solution is not None:
            covariances = np.full((len(points), 3, 3), np.nan)
            spread = self._spread(points[met], pixels[met])
            covariances[met] = slopes[met] @ spread @ np.swapaxes(slopes[met], 1, 2)
        return Places(pixels, points, tuple(states), covariances)

    def _inside(self, pixels: Array) -> Mask:
        size = np.array([self.image.lines, self.image.samples])
        inside: Mask = np.all((pixels >= -_EDGE) & (pixels <= size + _EDGE), axis=1)
        return inside

    def _spread(self, points: Array, pixels: Array) -> Array:
        """(n, 2, 2) px^2, covariance of the image places of ground points that is the orientation's."""
        assert self.solution is not None
        assert self.correction is not None
        if not len(points):
            return np.zeros((0, 2, 2))
        by_pose = self.image.by_correction(points, pixels, self.correction)[:, :, :6]
        joint, known = self.solution.joint_covariance, dict[tuple[int, ...], Array]()
        found = np.empty((len(points), 2, 2))
        follows = designs(self.solution.network, self.number, self.correction.angles, pixels[:, 0])
        for k, parts in enumerate(follows):
            variables = tuple(parts)
            if variables and variables not in known:
                known[variables] = joint.of(variables)
            found[k] = _through(by_pose[k], parts, known.get(variables))
        return found


def _through(by_pose: Array, parts: Mapping[int, Array], joint: Array | None) -> Array:
    if joint is None:
        return np.zeros((2, 2))
    design = by_pose @ np.concatenate(list(parts.values()), axis=1)
    return np.asarray(design @ joint @ design.T)


def _squares(body: Ellipsoid) -> Array:
    return np.array([body.equatorial, body.equatorial, body.polar]) ** 2


def terrain_slopes(
    points: Array, origins: Array, directions: Array, d_origins: Array, d_directions: Array, terrain: TerrainGrid
) -> Array:
    """(n, 3, 2) m per px, how places on a terrain model move over it with line and sample."""
    longitude, latitude, radius = planetocentric(points).T
    _, by_longitude, by_latitude = terrain.radius(longitude, latitude)
    axes = east_north_up(points)  # the normal is the gradient of the radius less that of the bilinear surface
    normal = axes[:, 2] - (by_longitude / (radius * np.cos(latitude)))[:, None] * axes[:, 0]
    normal -= (by_latitude / radius)[:, None] * axes[:, 1]
    distance = np.einsum("ni,ni->n", points - origins, directions) / np.einsum("ni,ni->n", directions, directions)
    moved = d_origins + distance[:, None, None] * d_directions
    fall = np.einsum("ni,ni->n", normal, directions)
    back = np.einsum("ni,nij->nj", normal, moved) / fall[:, None]
    return np.asarray(moved - directions[:, :, None] * back[:, None, :])


def on_surface(
    longitudes: Array, latitudes: Array, body: Ellipsoid, height: float = 0.0, terrain: TerrainGrid | None = None
) -> Array:
    """(n, 3) m, body-fixed, of planetocentric longitudes and latitudes (n,) in rad on the ellipsoid whose radii are
    larger by a height, or on a terrain model; NaN beside it.
    """
    up = np.column_stack([
        np.cos(longitudes) * np.cos(latitudes), np.sin(longitudes) * np.cos(latitudes), np.sin(latitudes)
    ])  # fmt: skip
    if terrain is not None:
        return np.asarray(up * terrain.at(up)[:, None])
    return np.asarray(up * Ellipsoid(body.equatorial + height, body.polar + height).radius(up)[:, None])
