"""Images with their pixels and orientation over one ground: where a position on the chart is on each image, and back;
pairs that share ground, and matches of pairs joined to tracks over images.

The chart is the plane in which images are compared: Lambert's equal-area plane about the scene's middle (Snyder 1987,
p. 182). Its y axis runs along the flight, so that a swath fills upright tiles. Lengths are true in the middle and off
by one per cent a thousand kilometres from it, which is no matter where two images are compared at the same position.

A lossy compression leaves steps in pictures: blocks of 8 x 8 pixels, as JPEG's.
At their edges neighbouring pixels differ more than elsewhere, and windows are matched edge to edge: the ties then lie
by blocks, off by pixels, with sigmas that know nothing of it. Held against each other are the mean differences of
neighbours at each of the eight phases; of blocks one phase stands out, along lines and along samples alike (a
detector's columns read out in turns give several, or one along samples alone).
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError, require
from mgsgraph.geometry.body import Ellipsoid, intersect_ellipsoid
from mgsgraph.geometry.footprint import Footprint, footprint, overlaps
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection, OrientationPrior
from mgsgraph.geometry.records import Array, Index, assign, frozen
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.record import Record

Pixels = NDArray[Any]
"""(lines, samples) grey values; NaN where a float picture has none."""

_MEETINGS = 4
"""Times that a ray is intersected with the ground at the height of the terrain under its last intersection."""
_DIFFERENCE = 20.0
"""m, over which derivatives of pixels by ground positions are taken."""
_LOOKED_AT = 200_000
"""pixels from which a picture's grey values are judged."""
_USELESS = 0.5
"""Share of a picture's pixels at one and the same extreme value beyond which there is nothing to match."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundChart(Record):
    """A plane about a middle, in metres."""

    axes: Array
    """(3, 3) rows: directions of x (to the right), y (along the flight) and of the middle, unit, body-fixed."""
    radius: float
    """m, of the sphere that is laid flat."""

    def __post_init__(self) -> None:
        assign(self, axes=frozen(self.axes, "ground chart, axes", (3, 3)))

    @classmethod
    def about(cls, points: Array, flight: Array) -> "GroundChart":
        """The chart about the mean of points (n, 3) in m, body-fixed, with y along the vector `flight` (3,)."""
        middle = points.mean(axis=0)
        radius = float(np.linalg.norm(points, axis=1).mean())
        if not np.linalg.norm(middle) > 0.1 * radius:
            raise InputError("images to match", "ground all around the body", "images of one region")
        up = middle / np.linalg.norm(middle)
        along = flight - (flight @ up) * up
        along /= np.linalg.norm(along)
        return cls(np.stack([np.cross(along, up), along, up]), radius)

    def directions(self, plane: Array) -> Array:
        """(n, 3) unit, body-fixed, of positions (n, 2) in the plane in m; NaN beyond the antipode."""
        distance = np.linalg.norm(plane, axis=1)
        half = distance / (2.0 * self.radius)
        with np.errstate(invalid="ignore"):
            cosine = np.where(half <= 1.0, 1.0 - 2.0 * half**2, np.nan)
            sideways = np.sqrt(1.0 - half**2) / self.radius  # sine of the angle over the distance
        return np.asarray(np.column_stack([plane * sideways[:, None], cosine]) @ self.axes)

    def plane(self, points: Array) -> Array:
        """(n, 2) m, positions in the plane under points (n, 3) in m, body-fixed."""
        local = unit_vectors(points) @ self.axes.T
        return np.asarray(local[:, :2] * (self.radius * np.sqrt(2.0 / (1.0 + local[:, 2:]))))


@dataclass(frozen=True, slots=True, eq=False)
class Ground(Record):
    """The a-priori ground, over a chart."""

    chart: GroundChart
    """The plane."""
    body: Ellipsoid
    """Reference of the height."""
    height: float
    """m above the ellipsoid, where the terrain model says nothing."""
    height_sigma: float
    """m, by how much the true ground may be higher or lower."""
    terrain: TerrainGrid | None = None
    """Radii of a terrain model."""

    def points(self, plane: Array) -> Array:
        """(n, 3) m, body-fixed, the ground at positions (n, 2) of the chart."""
        directions = self.chart.directions(plane)
        return np.asarray(directions * self._radii(directions)[:, None])

    def _radii(self, directions: Array) -> Array:
        level = Ellipsoid(self.body.equatorial + self.height, self.body.polar + self.height).radius(directions)
        if self.terrain is None:
            return level
        radii = self.terrain.at(directions * level[:, None])
        return np.where(np.isfinite(radii), radii, level)

    def meet(self, origins: Array, directions: Array) -> Array:
        """(n, 3) m, body-fixed, where rays meet the ground, to some metres of height; NaN where they miss the body."""
        heights = np.full(origins.shape[0], self.height)
        points = intersect_ellipsoid(origins, directions, self.body, heights)[0]
        if self.terrain is None:
            return points
        for _ in range(_MEETINGS):
            radii = np.linalg.norm(points, axis=1)
            heights -= np.nan_to_num(radii - self._radii(points / radii[:, None]))
            points = intersect_ellipsoid(origins, directions, self.body, heights)[0]
        return points


@dataclass(frozen=True, eq=False)
class Picture(Record):
    """An image with its pixels and its current orientation."""

    image: PushbroomImage
    """Geometry."""
    pixels: Pixels
    """(lines, samples)."""
    prior: OrientationPrior
    """Prior of the corrections of its nominal orientation."""
    correction: OrientationCorrection | None = None
    """Of the nominal orientation."""

    def __post_init__(self) -> None:
        shape = (self.image.lines, self.image.samples)
        found = f"pixels of shape {self.pixels.shape}"
        require(self.pixels.shape == shape, f"image {self.image.name}", found, f"{shape[0]} lines x {shape[1]} samples")

    def project(self, points: Array) -> Array:
        """(n, 2) line and sample of ground points (n, 3) in m; NaN where they are not seen."""
        return self.image.ground_to_image(points, self.correction)[0]

    def derivatives(self, ground: Ground, plane: Array) -> Array:
        """(n, 2, 2) d(line, sample) / d(x, y) in pixels per m at positions (n, 2) of the chart."""
        columns = []
        for axis in np.eye(2):
            ahead, behind = (self.project(ground.points(plane + side * _DIFFERENCE * axis)) for side in (0.5, -0.5))
            columns.append((ahead - behind) / _DIFFERENCE)
        return np.stack(columns, axis=2)

    def on_chart(self, ground: Ground, pixels: Array, correction: OrientationCorrection | None = None) -> Array:
        """(n, 2) m, positions on the chart where the rays of lines and samples (n, 2) meet the ground; by another
        correction than the picture's if one is given.
        """
        rays = self.image.sightlines(pixels[:, 0], pixels[:, 1], correction or self.correction)
        return ground.chart.plane(ground.meet(*rays))

    def height_parallax(self, ground: Ground, pixels: Array) -> Array:
        """(n, 2) m per m of height, by which the rays of lines and samples (n, 2) move over the chart."""
        origins, directions = self.image.sightlines(pixels[:, 0], pixels[:, 1], self.correction)
        points = ground.meet(origins, directions)
        up = unit_vectors(points)
        higher = points + directions / np.einsum("ni,ni->n", directions, up)[:, None]
        return ground.chart.plane(higher) - ground.chart.plane(points)

    def pixel_on_ground(self, ground: Ground) -> Array:
        """(2, 2) m per pixel in the middle of the picture: d(x, y) / d(line, sample)."""
        middle = 0.5 * np.array([[self.image.lines, self.image.samples]])
        plane = self.on_chart(ground, middle)
        if not np.all(np.isfinite(plane)):
            raise InputError(f"image {self.image.name}", "its middle misses the body", "an image of the ground")
        return np.asarray(np.linalg.inv(self.derivatives(ground, plane)[0]))

    @cached_property
    def levels(self) -> tuple[float, float]:
        """Grey values that are shown black and white: all but a two-hundredth of the pixels lie between.

        Raises
        ------
        InputError
            Where the picture is blank or saturated.
        """
        stride = max(1, int(np.sqrt(self.pixels.size / _LOOKED_AT)))
        some = self.pixels[::stride, ::stride]
        some = some[np.isfinite(some)].astype(np.float64)
        where, remedy = f"picture of {self.image.name}", "leave the image out"
        require(some.size != 0, where, "no valid pixels", "a picture", remedy)
        low, high = np.quantile(some, [0.005, 0.995])
        for value, name in ((some.min(), "darkest"), (some.max(), "brightest")):
            share = float(np.mean(some == value))
            if share > _USELESS:
                found = f"{share:.0%} of its pixels at the {name} value, {value:g}"
                raise InputError(where, found, "a picture that is neither blank nor saturated", remedy)
        return float(low), float(max(high, np.nextafter(low, np.inf)))


@dataclass(frozen=True, eq=False)
class Scene(Record):
    """All pictures over one ground."""

    pictures: tuple[Picture, ...]
    """At least two."""
    ground: Ground
    """What they show."""

    @property
    def where(self) -> str:
        """Names of the first images, for messages."""
        return f"images {', '.join(picture.image.name for picture in self.pictures[:4])}"

    @cached_property
    def pixel_sizes(self) -> Array:
        """(pictures,) m, size of each picture's pixels on the ground in its middle: the root of their area."""
        return np.array([
            np.sqrt(abs(np.linalg.det(picture.pixel_on_ground(self.ground)))) for picture in self.pictures
        ])

    @property
    def step(self) -> float:
        """m, size of the coarsest picture's pixels on the ground."""
        return float(self.pixel_sizes.max())

    def require_contrast(self) -> None:
        """Raise InputError where a picture is blank or saturated."""
        for picture in self.pictures:
            _ = picture.levels


# --- steps of a lossy compression


_BLOCK = 8
"""pixels."""
_JUDGED = 1_000_000
"""pixels from which a picture is judged."""
_FEWEST = 4 * _BLOCK
"""Lines and samples without which it isn't."""
STEPPED = 1.5
"""From which on matches suffer: quality 40 and less of JPEG, 2 to 6 % of the ties off by more than a pixel."""
STEEP = 3.5
"""From which on a picture is refused: quality 15 and less, up to 83 %."""


def block_steps(pixels: Pixels) -> float:
    """How many times larger neighbours differ at the edges of blocks than at any other phase; about 1 without."""
    if min(pixels.shape) < _FEWEST:
        return 1.0
    return min(_along(pixels, 1), _along(pixels.T, 1))


def _along(pixels: Pixels, axis: int) -> float:
    """The same across one axis, by some of the rows along it."""
    stride = max(1, pixels.size // _JUDGED)
    steps = np.abs(np.diff(pixels[::stride].astype(np.float32), axis=axis))
    with np.errstate(invalid="ignore"):
        means = np.array([float(np.nanmean(part)) if np.any(np.isfinite(part := steps[:, k::_BLOCK])) else 0.0
                          for k in range(_BLOCK)])  # fmt: skip
    highest, second = np.sort(means)[[-1, -2]]
    return float(highest / second) if second > 0.0 else 1.0


def require_unblocked(scene: Scene) -> tuple[str, ...]:
    """Raise InputError where a picture shows steep blocks; sentences of those that show some."""
    cautions = list[str]()
    for picture in scene.pictures:
        steps, name = block_steps(picture.pixels), picture.image.name
        if steps > STEEP:
            raise InputError(
                f"picture of {name}", f"blocks of 8 x 8 pixels: at their edges grey values step {steps:.1f} times more "
                "than elsewhere, which would be matched in place of the ground", "pixels without strong JPEG steps",
                "take the picture as it was archived, or leave the image out",
            )  # fmt: skip
        if steps > STEPPED:
            cautions.append(
                f"The picture of {name} shows blocks of 8 x 8 pixels (JPEG: steps {steps:.1f} times larger at their "
                "edges): some hundredths of its ties may be off by more than a pixel, which no sigma here covers; "
                "adjust with --reject 4, or take the picture as it was archived."
            )
    return tuple(cautions)




class Pair(NamedTuple):
    """Two pictures that share ground."""

    first: int
    second: int
    area: float
    """m^2 that they share."""


def pairs_of(scene: Scene) -> list[Pair]:
    """Pairs that share ground by their nominal orientation.

    Raises
    ------
    InputError
        Where there is none.
    """
    shared = overlaps(footprints(scene))
    require(
        len(shared.pairs), scene.where, "no two of them overlap (by their nominal orientation)",
        "images of common ground", "check the images and their kernels",
    )  # fmt: skip
    return [Pair(int(i), int(j), float(area)) for (i, j), area in zip(shared.pairs, shared.areas, strict=True)]


def by_pair(first: Index, other: Index) -> Iterator[tuple[int, int, Index]]:
    """Each pair of pictures among `first` and `other` (k,), with its rows (m,)."""
    both = np.column_stack([first, other])
    for i, j in np.unique(both, axis=0).tolist():
        yield i, j, np.flatnonzero((first == i) & (other == j))


def footprints(scene: Scene) -> list[Footprint]:
    """Footprints of all pictures, at the height of the ground.

    Raises
    ------
    InputError
        Where a picture has none.
    """
    shapes = [footprint(picture.image, scene.ground.height, picture.correction) for picture in scene.pictures]
    for shape in shapes:
        where, problem = f"image {shape.name}", "it sees nothing of the body, or a quarter of the way around it"
        require(len(shape.outline), where, problem, "an image of the ground", "leave the image out, or cut it")
    return shapes


def boxes(scene: Scene) -> list[Array]:
    """(2, 2) m, least and largest x and y of each picture's footprint on the chart."""
    planes = [scene.ground.chart.plane(shape.outline) for shape in footprints(scene)]
    return [np.stack([plane.min(axis=0), plane.max(axis=0)]) for plane in planes]


def first_picture(pairs: Sequence[Pair], left: Collection[int]) -> int:
    """Of the pictures that are left, the one that shares most ground."""
    return max(left, key=lambda j: (sum(pair.area for pair in pairs if j in pair[:2]), -j))


def next_pair(
    pairs: Sequence[Pair], aligned: Collection[int], left: Collection[int], tried: Collection[Pair]
) -> Pair | None:
    """The largest overlap of an aligned picture (first) with one that is left (second), without pairs that
    were tried (Prim 1957); None where there is none.
    """
    turned = (Pair(j, i, area) if i in left else Pair(i, j, area) for i, j, area in pairs)
    open_pairs = [pair for pair in turned if pair.first in aligned and pair.second in left and pair not in tried]
    return max(open_pairs, key=lambda pair: pair.area) if open_pairs else None


def joined(links: Index, likeness: Array, picture_of: Index) -> list[list[int]]:
    """Features joined by links (k, 2), the surest first; a link that would bring two features of one picture together,
    or contradicts a surer one, is left out: so a contradictory track is split at its weakest link.

    `likeness` (k,) says how sure each link is, `picture_of` (n,) the picture of each feature. Returns the features of
    each track, at least two, by picture.
    """
    track_of = dict[int, int]()
    tracks = dict[int, list[int]]()
    for k in np.argsort(-likeness, kind="stable").tolist():
        first, second = int(links[k, 0]), int(links[k, 1])
        ours, theirs = (_track(feature, track_of, tracks) for feature in (first, second))
        if ours == theirs:
            continue
        if {int(picture_of[f]) for f in tracks[ours]} & {int(picture_of[f]) for f in tracks[theirs]}:
            continue
        for feature in tracks[theirs]:
            track_of[feature] = ours
        tracks[ours] += tracks.pop(theirs)
    return [sorted(track, key=lambda f: int(picture_of[f])) for track in tracks.values() if len(track) > 1]


def _track(feature: int, track_of: dict[int, int], tracks: dict[int, list[int]]) -> int:
    if feature not in track_of:
        track_of[feature] = feature
        tracks[feature] = [feature]
    return track_of[feature]


def star(tracks: Iterable[list[int]]) -> tuple[Index, Index, Index]:
    """Tracks as links from a first feature to each other one: number of the track, first and other feature (k,)."""
    rows = [(t, track[0], other) for t, track in enumerate(tracks) for other in track[1:]]
    numbers = np.array(rows, dtype=np.int64).reshape(-1, 3)
    return numbers[:, 0], numbers[:, 1], numbers[:, 2]
