"""Ground coverage of a network's images: what each shows of the ground with its adjusted orientation."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.body import Ellipsoid, ellipsoidal_heights, surface_radii
from mgsgraph.geometry.footprint import Footprint, footprint, overlaps
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.intersection import meet_terrain
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask, no_rows
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.network.connectivity import network_footprints
from mgsgraph.network.footprints import visible_places
from mgsgraph.network.joining import Definitions, definitions
from mgsgraph.network.parts import KnownImage, known_images
from mgsgraph.planning.state import NetworkState, correction_of, state_of_solution
from mgsgraph.record import Record

EDGE = 0.01
"""Share of an image's lines and samples along its edges in which nothing is planned."""
_NEAR, _RELIEF = 1.2, 20e3
"""Radii of a footprint, and m, within which a point may show in its image: relief moves oblique ones."""
_RASTER = 1024.0
"""Places at which an overlap is looked for."""


@dataclass(frozen=True, slots=True, eq=False)
class OrientedImage:
    """An image with its adjusted orientation and its footprint."""

    known: KnownImage
    """Geometry and prior of the image."""
    correction: OrientationCorrection
    """Correction of its nominal orientation."""
    height: float
    """m above the ellipsoid, of the ground that it shows."""
    footprint: Footprint
    """Footprint at that height."""

    @property
    def image(self) -> PushbroomImage:
        """Geometry of the image."""
        return self.known.image

    def shown(self, points: Array) -> tuple[Index, Array]:
        """Which of points (n, 3) in m it shows well inside its edges and from above, (k,), and their places (k, 2)."""
        image = self.image
        places, size = visible_places(image, points, self.correction), np.array([image.lines, image.samples])
        with np.errstate(invalid="ignore"):
            inside = np.flatnonzero(np.all((places > EDGE * size) & (places < (1.0 - EDGE) * size), axis=1))
        return inside, places[inside]

    def positions(self, times: Array) -> Array:
        """(n, 3) m, where the camera is at times (n,) in s TDB past J2000."""
        lines = self.image.timing.lines(times - self.image.trajectory.epoch)
        return self.image.pose(lines, self.correction).position


class ImageCoverage(Record):
    """All images of a network and the ground under them.

    Parameters
    ----------
    of : Solution or NetworkState
        With the adjusted orientation.

    Raises
    ------
    InputError
        If the solution has no covariance, or no point has a position.

    Examples
    --------
    >>> coverage = mgsgraph.ImageCoverage(solution)
    >>> list(coverage.views), coverage.image("SIM/A").image.lines
    (['SIM/A', 'SIM/B'], 5000)
    """

    def __init__(self, of: Solution | NetworkState) -> None:
        state = state_of_solution(of)
        network = state.network
        self.state, self.network = state, network
        self.definitions = definitions(network)
        self.grid = None if network.surface is None else network.surface.grid
        heights = ellipsoidal_heights(state.places, network.body)
        self._height = float(np.median(heights))
        footprints = network_footprints(network, state.places, lambda j: state.correction(network.images[j].name))
        self.views = {
            known.image.name: OrientedImage(
                known, state.correction(known.image.name), self._height_of(heights, j), footprints[j]
            )
            for j, known in enumerate(known_images(network))
        }

    def __repr__(self) -> str:
        return f"ImageCoverage({len(self.views)} images)"

    def _height_of(self, heights: Array, image: int) -> float:
        of_image = heights[self.network.rays.point[self.network.rays.image == image]]
        return float(np.median(of_image)) if of_image.size else self._height

    def image(self, name: str) -> KnownImage:
        """An image of the network by its name."""
        return self.views[name].known

    def new_image(self, known: KnownImage) -> OrientedImage:
        """An image that is not in the network, with its nominal orientation."""
        correction = correction_of(known, self.state.settings, {}, Definitions())
        return OrientedImage(known, correction, self._height, footprint(known.image, self._height))

    def overlapping(self, image: OrientedImage) -> list[tuple[OrientedImage, float]]:
        """Images of the network that overlap with another, with the area in m^2."""
        reach = _radius(image.footprint)
        near = [
            view for view in self.views.values()
            if np.linalg.norm(view.footprint.centre - image.footprint.centre) <= 1.1 * (_radius(view.footprint) + reach)
        ]  # fmt: skip
        areas = [overlaps([image.footprint, view.footprint]).areas for view in near]
        return [(view, float(area[0])) for view, area in zip(near, areas, strict=True) if area.size]

    def ground(self, view: OrientedImage, lines: Array, samples: Array, height: float) -> Array:
        """(n, 3) m, where rays of an image meet the terrain model, or where there is none a height (m) above the
        ellipsoid; NaN where they miss the body.
        """
        points, _ = view.image.image_to_ground(lines, samples, height, view.correction)
        if self.grid is None:
            return points
        met = meet_terrain(*view.image.sightlines(lines, samples, view.correction), self.grid)
        return np.where(np.isfinite(met), met, points)

    def common_ground(
        self, image: OrientedImage, other: OrientedImage, height: float, places: Array
    ) -> tuple[Array, Mask]:
        """(n, 3) m, the `ground` at places (n, 2) of an image, and (n,) where another one shows it."""
        ground, shown = self.ground(image, places[:, 0], places[:, 1], height), np.zeros(places.shape[0], dtype=bool)
        finite = np.flatnonzero(np.isfinite(ground[:, 0]))
        shown[finite[other.shown(ground[finite])[0]]] = True
        return ground, shown

    def below(self, places: Array, height: float) -> Array:
        """(n, 3) m, the ground below places (n, 3): on the terrain model, or at a height (m) above the ellipsoid."""
        body = self.network.body
        up = unit_vectors(places)
        radius = surface_radii(up, Ellipsoid(body.equatorial + height, body.polar + height))
        if self.grid is not None:
            over = self.grid.at(places)
            radius = np.where(np.isfinite(over), over, radius)
        return np.asarray(up * radius[:, None])

    def rays(self, points: Array, views: Iterable[OrientedImage]) -> tuple[Index, list[str], Array]:
        """Image places of points (n, 3) in all of these images that show them: point (k,), image, places (k, 2)."""
        index, names, places = [no_rows()], list[str](), [np.zeros((0, 2))]
        for view in views:
            some, where = view.shown(points)
            index.append(some)
            names += [view.image.name] * some.size
            places.append(where)
        return np.concatenate(index), names, np.concatenate(places)

    def near(self, points: Array) -> list[OrientedImage]:
        """Images of the network whose ground lies about points (n, 3) in m."""
        middle = points.mean(axis=0)
        reach = float(np.linalg.norm(points - middle, axis=1).max(initial=0.0))
        return [
            view for view in self.views.values()
            if np.linalg.norm(view.footprint.centre - middle) <= _NEAR * (_radius(view.footprint) + reach) + _RELIEF
        ]  # fmt: skip


def _radius(footprint: Footprint) -> float:
    """m, from the middle of a footprint to its farthest place; infinite where it has no outline."""
    if footprint.outline.shape[0] == 0:
        return float("inf")
    return float(np.linalg.norm(footprint.outline - footprint.centre, axis=1).max())


def even_places(shape: tuple[int, int], shows: Callable[[Array], Mask], count: int) -> Array:
    """(count, 2) lines and samples on an even grid of square cells over the part of an image that `shows` accepts.

    Fewer where the part is too small to be found on a raster of a thousand places; none where there is no such part.
    """
    size = np.array(shape, dtype=np.float64)
    raster = _grid(size, np.zeros(2), size, float(np.sqrt(size.prod() / _RASTER)))
    visible = raster[shows(raster)]
    if visible.shape[0] == 0:
        return visible
    cell = float(np.sqrt(size.prod() / raster.shape[0]))
    low, high = np.maximum(visible.min(axis=0) - cell, 0.0), np.minimum(visible.max(axis=0) + cell, size)
    step = float(np.sqrt(size.prod() * visible.shape[0] / raster.shape[0] / count))
    places = visible
    for _ in range(80):
        trial = _grid(size, low, high, step)
        places = trial[shows(trial)]
        if places.shape[0] >= count:
            break
        step *= 0.96
    return places[np.unique(np.linspace(0, places.shape[0] - 1, count).round().astype(np.int64))]


def _grid(size: Array, low: Array, high: Array, step: float) -> Array:
    """(n, 2) middles of cells of about `step` pixels between two corners, inside the edges."""
    low, high = np.maximum(low, EDGE * size), np.minimum(high, (1.0 - EDGE) * size)
    axes = []
    for a, b in zip(low, high, strict=True):
        cells = max(round((b - a) / step), 1)
        axes.append(a + (b - a) * (np.arange(cells) + 0.5) / cells)
    lines, samples = np.meshgrid(*axes, indexing="ij")
    return np.column_stack([lines.ravel(), samples.ravel()])
