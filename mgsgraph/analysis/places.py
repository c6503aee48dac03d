"""Sigmas that new points would have over the overlap of images, on a grid of longitude and latitude.

Each cell's ground place is projected into the images that see it, and the covariance of the intersection of these rays
is the law of error propagation with the orientation's joint covariance and the measures' noise: nothing is observed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mgsgraph.analysis.neighbors import predicted_heights
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import (
    Ellipsoid,
    east_north_up,
    ellipsoidal_heights,
    intersect_ellipsoid,
    planetocentric,
)
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.intersection import meet_terrain
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask, all_pairs, finite_rows
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.network import ImageRays
from mgsgraph.network.corrections import designs
from mgsgraph.record import Record
from mgsgraph.text import some
from mgsgraph.units import DEG

if TYPE_CHECKING:
    from mgsgraph.adjustment.solution import Solution
    from mgsgraph.analysis.posterior import Posterior

BANDS = ("sigma east", "sigma north", "sigma up", "sigma of position")
"""What each band holds, m: the last is the root of the trace of the covariance."""
MOST_CELLS = 4_000_000
_CELLS = 20_000
"""Cells in all, about, where nothing is asked for."""
_POLAR = 85.0 * DEG
"""Latitude from which a grid of longitude and latitude makes no sense."""


@dataclass(frozen=True, slots=True, eq=False)
class SigmaGrid(Record):
    """Sigmas of newly intersected points by cells, rows from north to south, columns from west to east.

    Examples
    --------
    >>> grid = mgsgraph.sigma_grid(posterior, cell=500.0, sigma=0.5)
    >>> grid.values.shape, int(grid.rays.max())
    ((4, 45, 12), 2)
    """

    images: tuple[str, ...]
    """Of which two or more see each cell."""
    sigma: float
    """px, of the line and sample of each measure."""
    west: float
    """rad, planetocentric, western edge."""
    north: float
    """rad, northern edge."""
    steps: tuple[float, float]
    """rad, sides of a cell in longitude and in latitude; about square on the ground."""
    values: Array
    """(4, rows, columns) m, `BANDS`; NaN where fewer than two images see the ground, or all from the same side."""
    rays: Index
    """(rows, columns) number of images that see each cell."""

    @property
    def sentence(self) -> str:
        """What it says, in a sentence."""
        inside = np.isfinite(self.values[0])
        middle = [float(np.median(band[inside])) for band in self.values[:3]]
        worst = float(self.values[2][inside].max())
        return (
            f"points measured to {self.sigma:g} px in {some(self.images)} would have sigmas of "
            f"{middle[0]:.3g} m east, {middle[1]:.3g} m north and {middle[2]:.3g} m up (medians over "
            f"{int(inside.sum())} cells); up is worst at {worst:.3g} m"
        )


def sigma_grid(
    posterior: "Posterior", images: Sequence[str] = (), cell: float | None = None, sigma: float = 1.0
) -> SigmaGrid:
    """Sigmas over the overlap of images.

    Parameters
    ----------
    posterior : Posterior
    images : sequence of str
        Names, two or more; all images of the network when empty.
    cell : float, optional
        m, side of a cell; so that there are some twenty thousand when absent.
    sigma : float
        px, of the line and sample of each measure.

    Raises
    ------
    InputError
        Where no two of them see the same ground, or there would be too many cells.

    Examples
    --------
    >>> print(mgsgraph.sigma_grid(posterior, cell=500.0, sigma=0.5).sentence)
    points measured to 0.5 px in SIM/A, SIM/B would have sigmas of 6.63 m east, 7 m north and 20.8 m up (medians
    over 255 cells); up is worst at 24.3 m
    """
    names = tuple(images) or tuple(posterior.network.image_names)
    numbers = [posterior.network.image_number(name) for name in names]
    if len(numbers) < 2 or len(set(names)) < len(names):
        raise InputError("sigma raster", f"images {', '.join(names)}", "two or more different images")
    height = _ground_height(posterior)
    west, north, steps, rows, columns = _extent(posterior, numbers, names, height, cell)
    longitude = west + steps[0] * (np.arange(columns) + 0.5)
    latitude = north - steps[1] * (np.arange(rows) + 0.5)
    ground = _ground(posterior, all_pairs(longitude, latitude), height)
    visible, places = _seen(posterior, numbers, ground)
    several = np.flatnonzero(visible.sum(axis=1) >= 2)
    if several.size == 0:
        raise _no_overlap(names)
    values = np.full((4, rows * columns), np.nan)
    image, cell_of = np.nonzero(visible[several].T)
    rays = ImageRays(
        cell_of, np.array(numbers)[image], places[several[cell_of], image], np.full((cell_of.size, 2), sigma)
    )
    _, covariances = posterior.intersections(rays)
    frame = east_north_up(ground[several])
    variances = np.einsum("nij,njk,nik->ni", frame, covariances, frame)
    values[:3, several] = np.sqrt(variances).T
    values[3, several] = np.sqrt(variances.sum(axis=1))
    if not np.any(np.isfinite(values)):
        found = f"rays of {some(names)} that are all but parallel"
        raise InputError("sigma raster", found, "images that look from different sides")
    counts = visible.sum(axis=1).reshape(rows, columns)
    return SigmaGrid(names, sigma, west, north, steps, values.reshape(4, rows, columns), counts)


def _ground_height(posterior: "Posterior") -> float:
    """Height above the ellipsoid, m: the middle of the adjusted points'."""
    at = posterior.linearised
    places = at.points[np.linalg.norm(at.points, axis=1) > 0.0]
    return float(np.median(ellipsoidal_heights(places, posterior.network.body))) if places.size else 0.0


def _ground(posterior: "Posterior", places: Array, height: float) -> Array:
    """(n, 3) m, ground at longitudes and planetocentric latitudes (n, 2): on the terrain model where there is one, else
    at a height above the ellipsoid.
    """
    body, surface = posterior.network.body, posterior.network.surface
    longitudes, latitudes = places.T
    ground = on_surface(longitudes, latitudes, body, height)
    if surface is None:
        return ground
    over = on_surface(longitudes, latitudes, body, terrain=surface.grid)
    return np.where(np.isfinite(over), over, ground)


def _extent(
    posterior: "Posterior", numbers: Sequence[int], names: Sequence[str], height: float, cell: float | None
) -> tuple[float, float, tuple[float, float], int, int]:
    """West and north edge, sides of a cell (rad), rows and columns: where the boxes of two or more footprints meet."""
    boxes = _boxes(posterior, numbers, height)
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for (low_a, high_a), (low_b, high_b) in combinations(boxes, 2):
        inner = np.maximum(low_a, low_b), np.minimum(high_a, high_b)
        if np.all(inner[0] < inner[1]):
            low, high = np.minimum(low, inner[0]), np.maximum(high, inner[1])
    if not np.all(low < high):
        raise _no_overlap(names)
    if np.abs([low[1], high[1]]).max() > _POLAR:
        found = f"an overlap up to {np.abs([low[1], high[1]]).max() / DEG:.1f} deg of latitude"
        expected = f"at most {_POLAR / DEG:.0f} deg"
        raise InputError("sigma raster", found, expected, "choose images farther from the pole")
    radius, shrunk = posterior.network.body.equatorial, np.array([np.cos(0.5 * (low[1] + high[1])), 1.0])
    side = float(np.sqrt(np.prod((high - low) * shrunk) / _CELLS)) if cell is None else cell / radius
    if not (np.isfinite(side) and 0.0 < side < (high - low).max()):
        found = f"cells of {side * radius:.3g} m"
        raise InputError("sigma raster", found, f"less than the overlap, of {(high - low).max() * radius:.3g} m")
    steps = side / shrunk
    columns, rows = (max(int(np.ceil(size)), 1) for size in (high - low) / steps)
    if rows * columns > MOST_CELLS:
        found = f"{rows} x {columns} cells of {side * radius:.3g} m"
        raise InputError("sigma raster", found, f"{MOST_CELLS} at most", "choose larger cells, or fewer images")
    return float(low[0]), float(high[1]), (float(steps[0]), float(steps[1])), rows, columns


def _boxes(posterior: "Posterior", numbers: Sequence[int], height: float) -> list[tuple[Array, Array]]:
    """Least and largest longitude and latitude of each footprint, all within half a turn of the first."""
    from mgsgraph.geometry.footprint import footprint  # shapely takes its time

    boxes: list[tuple[Array, Array]] = []
    for j in numbers:
        area = footprint(posterior.network.images[j], height, posterior.correction(j))
        if area.pole:
            what = f"image {area.name}, which covers a pole"
            raise InputError("sigma raster", what, "images without a pole", "choose others (--image)")
        if area.outline.shape[0]:
            low, high = area.longitude_latitude.min(axis=0), area.longitude_latitude.max(axis=0)
            offset = low[0] + high[0] - (boxes[0][0][0] + boxes[0][1][0] if boxes else 0.0)
            turn = np.array([2.0 * np.pi * np.round(offset / (4.0 * np.pi)), 0.0])
            boxes.append((low - turn, high - turn))
    return boxes


def _seen(posterior: "Posterior", numbers: Sequence[int], ground: Array) -> tuple[Array, Array]:
    """(n, images) whether each place (n, 3) falls into an image, and (n, images, 2) where."""
    places = np.full((ground.shape[0], len(numbers), 2), np.nan)
    visible = np.zeros((ground.shape[0], len(numbers)), dtype=bool)
    for k, j in enumerate(numbers):
        image = posterior.image(j)
        places[:, k], _ = image.ground_to_image(ground, posterior.correction(j))
        line, sample = places[:, k].T
        visible[:, k] = (line >= 0.0) & (line <= image.lines) & (sample >= 0.0) & (sample <= image.samples)
    return visible, places


def _no_overlap(names: Sequence[str]) -> InputError:
    return InputError("sigma raster", f"no ground that two of {', '.join(names[:4])} see", "images that overlap")


_RELIEF = 0.1
"""m by which a ray may meet the terrain before a place on it, which is seen all the same (posts' edges, rounding)."""
_EDGE = 1e-6
"""px by which a place may lie beyond an edge that it is on (rounding)."""
_REACH = np.array([0.5, 2.0])
"""Share of the lines and samples beyond an image's edges at which its geometry still means something."""
_ROUNDS = 3
"""Of height and place of a ray: the second moves by the first times the ray's slant, relief by a share of that."""


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
    solution: "Solution | None" = None
    """Adjustment that the correction is of, for its covariance."""
    number: int = 0
    """Of the image in that solution."""

    @classmethod
    def adjusted(cls, solution: "Solution", number: int) -> "View":
        """An image of a solution."""
        return cls(solution.image(number), solution.correction(number), solution, number)

    def seen(self, points: Array, terrain: TerrainGrid | None = None) -> Places:
        """Where ground points (n, 3) in m are in the image; on a terrain model, relief may hide them."""
        pixels, _ = self.image.ground_to_image(points, self.correction)
        projected = finite_rows(pixels)
        states = np.full(len(points), State.NO_GROUND, dtype=object)
        states[finite_rows(points)] = State.FAR_OUTSIDE
        states[projected] = State.OUTSIDE
        states[self._inside(pixels)] = State.SEEN
        where = np.flatnonzero(projected)
        origins, directions = self.image.sightlines(pixels[projected, 0], pixels[projected, 1], self.correction)
        if terrain is not None:
            nearer = np.linalg.norm(meet_terrain(origins, directions, terrain) - origins, axis=1)
            hidden = nearer < np.linalg.norm(points[projected] - origins, axis=1) - _RELIEF
            states[where[hidden]] = State.BEHIND_RELIEF
        up = points[projected] / _squares(self.image.body)
        away = np.einsum("ni,ni->n", up, points[projected] - origins) >= 0.0
        states[where[away]] = State.BEHIND_BODY
        covariances = None
        if self.solution is not None:
            covariances = np.full((len(points), 2, 2), np.nan)
            covariances[projected] = self._spread(points[projected], pixels[projected])
        return Places(pixels, points, tuple(states), covariances)

    def on_ground(
        self, pixels: Array, height: Array | float = 0.0, radius: Array | None = None,
        terrain: TerrainGrid | None = None, sigma: Array | float = 0.0,
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
            In place of both; with its own sigma and that of its shift, where they are known.
        sigma : float or (n,)
            m, of the height or radius.
        """
        size = np.array([self.image.lines, self.image.samples])
        states = np.full(len(pixels), State.OUTSIDE, dtype=object)
        states[self._inside(pixels)] = State.SEEN
        near = np.all((pixels >= -_REACH * size) & (pixels <= (1.0 + _REACH) * size), axis=1)
        states[~near] = State.FAR_OUTSIDE
        points, slopes = np.full((len(pixels), 3), np.nan), np.full((len(pixels), 3, 2), np.nan)
        rise, doubt = np.full((len(pixels), 3), np.nan), np.array(np.broadcast_to(sigma, len(pixels)), dtype=np.float64)
        rays = self.image.rays(pixels[near, 0], pixels[near, 1], self.correction)
        origins, directions, d_origins, d_directions = rays
        body, level = self.image.body, np.broadcast_to(height, len(pixels))[near]
        if radius is not None:
            body, level = Ellipsoid(1.0, 1.0), radius[near] - 1.0
        if terrain is None:
            points[near], by_origin, by_direction = intersect_ellipsoid(origins, directions, body, level)
            slopes[near] = by_origin @ d_origins + by_direction @ d_directions
            normals = upward(points[near], body)
        else:
            points[near] = meet_terrain(origins, directions, terrain)
            slopes[near] = terrain_slopes(points[near], origins, directions, d_origins, d_directions, terrain)
            normals = _terrain_normals(points[near], terrain)
            doubt[near] = self._terrain_sigmas(points[near], normals, terrain)
        rise[near] = directions / np.einsum("ni,ni->n", normals, directions)[:, None]  # m along the ray per m of height
        met = finite_rows(points)
        states[near & ~met] = State.NO_GROUND
        covariances = None
        if self.solution is not None:
            covariances = np.full((len(points), 3, 3), np.nan)
            spread = self._spread(points[met], pixels[met])
            moved = rise[met] * doubt[met, None]
            covariances[met] = slopes[met] @ spread @ slopes[met].mT
            covariances[met] += moved[:, :, None] * moved[:, None]
        return Places(pixels, points, tuple(states), covariances)

    def ground_heights(self, pixels: Array) -> tuple[Array, Array]:
        """(n,) m above the ellipsoid of the ground that image places (n, 2) show, by the solution's adjusted points
        about them, and its sigmas (n,) in m.
        """
        bare, near, sigmas = View(self.image, self.correction), np.zeros(len(pixels)), np.zeros(len(pixels))
        for _ in range(_ROUNDS):
            near, sigmas = self.heights_at(bare.on_ground(pixels, near).points)
        return near, sigmas

    def heights_at(self, places: Array) -> tuple[Array, Array]:
        """(n,) m, the same at ground places (n, 3) in m, whose own heights don't matter.

        Raises
        ------
        InputError
            Where there is no adjusted point.
        """
        adjusted = np.flatnonzero(self.solution.determined) if self.solution is not None else np.zeros(0)
        if self.solution is None or not adjusted.size:
            raise InputError(
                self.image.name, "neither a terrain model nor adjusted points to say how high its ground is",
                "the ground's height", "give --height M, --radius M, --terrain FILE or --ellipsoid",
            )  # fmt: skip
        from mgsgraph.analysis.statistics import local_sigmas  # not needed without a solution

        points = self.solution.places[adjusted]
        sigmas = local_sigmas(self.solution.covariances[adjusted], points)[:, 2]
        return predicted_heights(points, ellipsoidal_heights(points, self.image.body), sigmas, places)

    def _terrain_sigmas(self, points: Array, normals: Array, terrain: TerrainGrid) -> Array:
        """(n,) m, of a terrain model's height: its own, and of the solution's model what its shift, lift and tilt do,
        which are not applied. A sigma that the model doesn't know counts as zero.
        """
        sigmas: Array = np.nan_to_num(terrain.height_sigmas(points), posinf=0.0)
        surface = self.solution.network.surface if self.solution is not None else None
        if self.solution is None or surface is None or surface.grid is not terrain or not surface.terms:
            return sigmas
        moved = np.einsum("ni,nki->nk", normals, surface.directions(points))
        value = self.solution.shift_values[-1]
        spread = self.solution.shift_spread(len(self.solution.shifts) - 1) + np.outer(value, value)
        return np.asarray(np.sqrt(sigmas**2 + np.einsum("nk,kl,nl->n", moved, spread, moved)))

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
        joint, joints = self.solution.joint_covariance, dict[tuple[int, ...], Array]()
        covariances = np.empty((len(points), 2, 2))
        follows = designs(self.solution.network, self.number, self.correction.angles, pixels[:, 0])
        for k, parts in enumerate(follows):
            variables = tuple(parts)
            if variables and variables not in joints:
                joints[variables] = joint.of(variables)
            covariances[k] = _through(by_pose[k], parts, joints.get(variables))
        return covariances


def _through(by_pose: Array, parts: Mapping[int, Array], joint: Array | None) -> Array:
    if joint is None:
        return np.zeros((2, 2))
    design = by_pose @ np.concatenate(list(parts.values()), axis=1)
    return np.asarray(design @ joint @ design.T)


def _squares(body: Ellipsoid) -> Array:
    return np.array([body.equatorial, body.equatorial, body.polar]) ** 2


def upward(points: Array, body: Ellipsoid) -> Array:
    """(n, 3) unit vectors, upward from an ellipsoid."""
    return unit_vectors(points / _squares(body))


def terrain_slopes(
    points: Array, origins: Array, directions: Array, d_origins: Array, d_directions: Array, terrain: TerrainGrid
) -> Array:
    """(n, 3, 2) m per px, how places on a terrain model move over it with line and sample."""
    normal = _terrain_normals(points, terrain)
    distance = np.einsum("ni,ni->n", points - origins, directions) / np.einsum("ni,ni->n", directions, directions)
    moved = d_origins + distance[:, None, None] * d_directions
    fall = np.einsum("ni,ni->n", normal, directions)
    back = np.einsum("ni,nij->nj", normal, moved) / fall[:, None]
    return np.asarray(moved - directions[:, :, None] * back[:, None, :])


def _terrain_normals(points: Array, terrain: TerrainGrid) -> Array:
    """(n, 3) gradients of the radius less that of the bilinear surface, at places on it (n, 3) in m."""
    longitude, latitude, radius = planetocentric(points).T
    _, by_longitude, by_latitude = terrain.radius(longitude, latitude)
    axes = east_north_up(points)
    normal = axes[:, 2] - (by_longitude / (radius * np.cos(latitude)))[:, None] * axes[:, 0]
    return np.asarray(normal - (by_latitude / radius)[:, None] * axes[:, 1])


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
