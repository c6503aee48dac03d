"""Images linked by geometry: the ground under a place of one image, and where every other image shows the same ground.

A place p of image i shows the ground X(p); image j shows that at q = g_j(X(p)), and moves by the Jacobian

    dq/dp = (dg_j/dX) (dX/dp),

of 2 x 2 elements, line and sample by line and sample. Errors of both orientations, and of the height h of the ground,
make an error ellipse of q: with A_i = dg_i/d(orientation of i),

    dq = A_j do_j - (dq/dp) A_i do_i + (dg_j/dX) (dX/dh) dh,

because p is fixed, so that X moves with the orientation of i. The joint covariance of both orientations is used:
common errors cancel.
"""

from collections.abc import Collection
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import KDTree

from mgsgraph.analysis.places import terrain_slopes
from mgsgraph.errors import InputError, require
from mgsgraph.geometry.body import east_north_up, ellipsoidal_heights, error_ellipses, geodetic, planetocentric
from mgsgraph.geometry.intersection import meet_terrain
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, finite_rows
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.network.corrections import designs
from mgsgraph.studio.opened import Block
from mgsgraph.text import many, two
from mgsgraph.units import DEG, KM

NEIGHBOURS = 5
"""Nearest points whose heights are averaged."""
_ROUNDS = 3
"""Iterations of the intersection: the ground's height depends on the position."""
_ELLIPSOID = "on the ellipsoid: neither a terrain model nor a point with a place"
_AROUND = 16
"""Posts of a terrain model that are kept around the images."""


class NoGround(InputError):
    """A place of an image whose ray misses the body."""


class Ground(NamedTuple):
    """The ground at one place of an image."""

    point: Array
    """(3,) m, body-fixed."""
    slopes: Array
    """(3, 2) m per px: derivative of the point by line and sample."""
    by_height: Array
    """(3,) m per m: derivative of the point by the height of the ground, along its ray."""
    height: float
    """m above the ellipsoid."""
    height_sigma: float
    """m, of the height; NaN where unknown."""
    surface: str
    """What the point lies on, as text."""


class GroundModel:
    """The ground of a block.

    Parameters
    ----------
    block : Block
        Its terrain model is used where there is one, else its points with a place.
    """

    def __init__(self, block: Block) -> None:
        self._block = block

    def under(self, image: int, line: float, sample: float) -> Ground:
        """The ground at a place of an image.

        Raises
        ------
        NoGround
            A ray that misses the body.
        """
        ground = self._on_terrain(image, line, sample) or self._near_points(image, line, sample)
        if not np.all(np.isfinite(ground.point)):
            place = f"image {self._block.images[image].name}, line {line:g}, sample {sample:g}"
            raise NoGround(place, "its ray misses the body", "a place that shows ground")
        return ground

    def _on_terrain(self, image: int, line: float, sample: float) -> Ground | None:
        grid = self._grid
        if grid is None:
            return None
        picture, correction = self._block.images[image], self._block.corrections[image]
        rays = picture.rays(np.array([line]), np.array([sample]), correction)
        origins, directions, d_origins, d_directions = rays
        motion = np.zeros((1, 3))
        for _ in range(_ROUNDS):
            point = meet_terrain(origins - motion, directions, grid)
            if not np.all(np.isfinite(point)):
                return None
            moved = self._block.terrain_motion(point)
            if np.abs(moved - motion).max() < 1e-3:
                break
            motion = moved
        slopes = terrain_slopes(point, origins - motion, directions, d_origins, d_directions, grid)
        surface = "on the terrain model" + (", as the adjustment has moved it" if np.any(motion) else "")
        sigma = grid.vertical_sigma
        return self._ground(point + motion, slopes, directions, np.nan if sigma is None else sigma, surface)

    def _near_points(self, image: int, line: float, sample: float) -> Ground:
        picture, correction = self._block.images[image], self._block.corrections[image]
        pixel = np.array([line]), np.array([sample])
        height, sigma, surface = self._block.median_height, np.nan, _ELLIPSOID
        rounds = _ROUNDS if self._tree is not None else 0
        for _ in range(rounds):
            point, _ = picture.image_to_ground(*pixel, height, correction)
            if not np.all(np.isfinite(point)):
                break
            height, sigma, surface = self._height_by(point[0])
        point, slopes = picture.image_to_ground(*pixel, height, correction)
        _, directions = picture.sightlines(*pixel, correction)
        return self._ground(point, slopes, directions, sigma, surface)

    def _height_by(self, point: Array) -> tuple[float, float, str]:
        """Height (m), its sigma (m) and what it is, of the nearest points: means weighted by distance."""
        assert self._tree is not None
        count = min(NEIGHBOURS, self._block.located.size)
        distances, nearest = (np.atleast_1d(array) for array in self._tree.query(point, count))
        points, weights = self._block.located[nearest], weights_by_distance(distances)
        heights, sigmas = self._heights(points), self._sigmas(points)
        height = float(weights @ heights)
        spread = float(np.sqrt(weights @ (heights - height) ** 2 + weights @ sigmas**2))
        kind = "adjusted point" if self._block.adjusted else "a-priori place"
        surface = f"at the height of the nearest {many(count, kind)}, {height:.0f} m with a sigma of {two(spread)} m"
        return height, spread, f"{surface}; the next one is {two(distances.min() / KM)} km away"

    def _ground(self, point: Array, slopes: Array, directions: Array, sigma: float, surface: str) -> Ground:
        up = east_north_up(point)[0, 2]
        direction = directions[0] / (directions[0] @ up)
        height = float(geodetic(point, self._block.images[0].body)[0, 2])
        return Ground(point[0], slopes[0], direction, height, float(sigma), surface)

    @cached_property
    def _grid(self) -> TerrainGrid | None:
        """The terrain model about the block."""
        grid = self._block.terrain
        if grid is None:
            return None
        places = np.concatenate([self._block.places, *self._block.grounds])
        return grid.around(places[finite_rows(places)], _AROUND)

    def _heights(self, points: Index) -> Array:
        """(k,) m above the ellipsoid, of some points with a place."""
        return np.asarray(ellipsoidal_heights(self._block.places[points], self._block.images[0].body))

    def _sigmas(self, points: Index) -> Array:
        """(k,) m, of the same."""
        covariances = self._block.covariances
        if covariances is None:
            return np.zeros(points.size)
        up = east_north_up(self._block.places[points])[:, 2]
        return np.asarray(np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", up, covariances[points], up), 0.0)))

    @cached_property
    def _tree(self) -> KDTree | None:
        places = self._block.places[self._block.located]  # a tree of many points is built fast, not balanced
        return KDTree(places, balanced_tree=False, compact_nodes=False) if len(places) else None


def weights_by_distance(distances: Array) -> Array:
    """(..., k) weights of the nearest points at distances (..., k) in m, inverse to their squares (Shepard 1968), whose
    sum is 1.
    """
    weights = 1.0 / np.maximum(distances, 1.0) ** 2
    return np.asarray(weights / weights.sum(axis=-1, keepdims=True))


class Ellipse(NamedTuple):
    """An error ellipse in an image."""

    covariance: Array
    """(2, 2) px^2 of line and sample, for sigma0 = 1."""
    semi_axes: Array
    """(2,) px, the larger first, within which the place lies with a probability of 95 %."""
    angle: float
    """rad, of the larger one, from the direction of samples towards that of lines."""

    @classmethod
    def of(cls, covariance: Array) -> "Ellipse":
        """The ellipse of a covariance (2, 2) of line and sample."""
        semi_axes, axes = error_ellipses(covariance)
        return cls(covariance, semi_axes[::-1], float(np.arctan2(axes[0, 1], axes[1, 1])))


class Prediction(NamedTuple):
    """Where another image shows the same ground."""

    image: int
    """Which."""
    place: Array
    """(2,) line and sample; may lie outside the image."""
    jacobian: Array
    """(2, 2) px per px, by line and sample of the first image."""
    inside: bool
    """Whether the place lies in the image."""
    ellipse: Ellipse | None
    """None where nothing is known of the orientations."""


class LinkedImages:
    """Images of a block over one ground; answers within milliseconds, for a page that follows the cursor.

    Parameters
    ----------
    block : Block
        In one state; another state needs another record.
    """

    def __init__(self, block: Block) -> None:
        self.block = block
        self.ground = GroundModel(block)

    def under(
        self, image: str, line: float, sample: float, required: Collection[str] = ()
    ) -> tuple[Ground, list[Prediction]]:
        """The ground at a place of an image, and where others show it.

        Parameters
        ----------
        image : str
            Its name.
        line, sample : float
            px, first pixel's centre at 0.5; up to half the image's size outside it.
        required : collection of str
            Images that are predicted even if the place lies outside them.

        Raises
        ------
        InputError
            No such image; a place far outside it.
        NoGround
            A ray that misses the body.
        """
        number = self.block.network.image_number(image)
        picture = self.block.images[number]
        size = np.array([picture.lines, picture.samples])
        place = np.array([line, sample])
        found, expected = f"line {line:g}, sample {sample:g}", f"a place in its {size[0]} x {size[1]} pixels"
        require(np.all(np.abs(place / size - 0.5) <= 1.0), f"image {image}", found, expected)
        ground = self.ground.under(number, line, sample)
        numbers = {self.block.network.image_number(name) for name in required} - {number}
        candidates = [j for j in self._candidates(ground.point) if j != number]
        predictions = (self._prediction(number, place, ground, j) for j in sorted({*candidates, *numbers}))
        return ground, [item for item in predictions if item is not None and (item.inside or item.image in numbers)]

    def _prediction(self, clicked: int, place: Array, ground: Ground, other: int) -> Prediction | None:
        picture, correction = self.block.images[other], self.block.corrections[other]
        places, by_point = picture.ground_to_image(ground.point[None], correction)
        if not np.all(np.isfinite(places)):
            return None
        origin, _ = picture.sightlines(places[:, 0], places[:, 1], correction)
        if (ground.point - origin[0]) @ ground.point >= 0.0:
            return None  # behind the body
        jacobian = by_point[0] @ ground.slopes
        inside = bool(np.all((places[0] >= 0.0) & (places[0] <= [picture.lines, picture.samples])))
        by_height = by_point[0] @ ground.by_height
        ellipse = self._ellipse((clicked, other), (place, places[0]), ground, jacobian, by_height) if inside else None
        return Prediction(other, places[0], jacobian, inside, ellipse)

    def _ellipse(
        self, pair: tuple[int, int], places: tuple[Array, Array], ground: Ground, jacobian: Array, by_height: Array
    ) -> Ellipse | None:
        joint = self.block.joint
        if joint is None:
            return None
        nominal, parts = OrientationCorrection(np.zeros((1, 6)), self.block.settings.angles), dict[int, Array]()
        for number, place, factor in zip(pair, places, (-jacobian, np.eye(2)), strict=True):
            picture, correction = self.block.images[number], self.block.corrections[number] or nominal
            by_pose = picture.by_correction(ground.point[None], place[None], correction)[0, :, :6]
            for variable, part in designs(self.block.network, number, nominal.angles, place[:1])[0].items():
                parts[variable] = parts.get(variable, np.zeros((2, part.shape[1]))) + factor @ by_pose @ part
        covariance = np.zeros((2, 2))
        if parts:
            design = np.concatenate(list(parts.values()), axis=1)
            covariance = design @ joint.of(list(parts)) @ design.T
        if np.isfinite(ground.height_sigma):
            covariance = covariance + ground.height_sigma**2 * np.outer(by_height, by_height)
        return Ellipse.of(covariance)

    def _candidates(self, point: Array) -> list[int]:
        """Images that may show a point (3,), by their caps on the sphere."""
        middles, reaches = self.block.caps
        away = np.arccos(np.clip(middles @ (point / np.linalg.norm(point)), -1.0, 1.0))
        return np.flatnonzero(away <= reaches).tolist()


def ground_record(ground: Ground, predictions: list[Prediction], block: Block) -> dict[str, Any]:
    """The ground and where other images show it, as JSON: degrees and pixels."""
    longitude, latitude, _ = planetocentric(ground.point).tolist()
    return {
        "longitude_deg": longitude / DEG % 360.0, "latitude_deg": latitude / DEG,
        "height_m": ground.height, "height_sigma_m": ground.height_sigma if np.isfinite(ground.height_sigma) else None,
        "surface": ground.surface, "spacing_m": np.linalg.norm(ground.slopes, axis=0).tolist(),
        "east_north_m": (east_north_up(ground.point[None])[0, :2] @ ground.slopes).tolist(),
        "others": {block.images[prediction.image].name: _prediction_record(prediction) for prediction in predictions},
        "sigmas": "posterior" if block.adjusted else "a-priori",
    }  # fmt: skip


def _prediction_record(prediction: Prediction) -> dict[str, object]:
    axes = prediction.ellipse
    ellipse = None if axes is None else {"semi_axes_px": axes.semi_axes.tolist(), "angle_deg": axes.angle / DEG}
    return {
        "line": float(prediction.place[0]), "sample": float(prediction.place[1]), "inside": prediction.inside,
        "jacobian": prediction.jacobian.tolist(), "ellipse_px": ellipse,
    }  # fmt: skip
