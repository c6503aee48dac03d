"""Points on the ground of a block, and where the lines of its strips see them with their true orientation."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import intersect_ellipsoid, planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask, assign
from mgsgraph.record import Record
from mgsgraph.simulation.camera import STEREO
from mgsgraph.simulation.ground import SiteTerrain
from mgsgraph.simulation.observations import MARGIN, Visible, well_inside

LEAST = 3
"""Lines of a strip in which a point must have been matched."""

_NADIR = STEREO.index("ND")
_TABLE = 129
"""Lines of an image of which the ground is tabulated, for first guesses."""
_BESIDE = 1.3
"""Half widths of a swath beyond which a point isn't looked for in it."""
_BLOCK = 1 << 13
"""Points projected at once: what lies between stays in the processor's cache."""
_ROUNDS = 20
"""Of drawing, before strips count as too small."""


@dataclass(frozen=True, slots=True)
class PointMatching(Record):
    """How points are matched."""

    shares: tuple[float, float, float] = (0.05, 0.15, 0.80)
    """Of the points of a strip that are matched in 3, 4 and 5 of its lines, where five see them; they add up to 1."""
    linked: float = 0.3
    """Share of the points which another strip sees, too, that are matched in its lines as well."""
    sigma: float = 0.4
    """px of each image (macropixels), of line and sample."""
    blunders: float = 0.0
    """Share of rays that are 5 to 100 px off."""


class _Swath(NamedTuple):
    """Where the lines of an image lie on the ground, nominally: first guesses."""

    along: Array
    """(t,) rad at Mars' centre from the pericentre, increasing: of the middle samples of some lines."""
    lines: Array
    """(t,)."""
    across: Array
    """(t,) rad, of the same."""
    half_width: Array
    """(t,) rad."""


@dataclass(frozen=True, slots=True, eq=False)
class FlownStrip:
    """A strip as it was flown."""

    axes: Array
    """(3, 3) unit rows, body-fixed: flight, across, up at the pericentre."""
    images: tuple[PushbroomImage, ...]
    """Of the five stereo lines, nominal."""
    true: OrientationCorrection
    """Of all of them: true orientation = nominal (+) this."""
    level: float
    """m, mean height of the ground above the ellipsoid."""
    swaths: tuple[_Swath, ...] = field(init=False)
    """Where the lines of each image lie on the ground."""

    def __post_init__(self) -> None:
        assign(self, swaths=tuple(_swath(self.axes, image, self.level) for image in self.images))

    def matched(self, points: Array, matches: PointMatching, rng: np.random.Generator) -> tuple[Index, Index, Array]:
        """In which lines points (n, 3) in m are matched: in as many as drawn, of those that see them, or in none.

        Returns
        -------
        point, image : (k,)
            Numbers, by point and then by image.
        pixels : (k, 2)
            True line and sample.
        """
        n, m = len(points), len(self.images)
        pixels = np.stack([self._projected(j, points) for j in range(m)])
        visible = np.stack([well_inside(image, own) for image, own in zip(self.images, pixels, strict=True)], axis=1)
        wanted = rng.choice([3, 4, 5], size=n, p=matches.shares)
        order = np.argsort(np.where(visible, rng.random((n, m)), 2.0), axis=1)
        chosen = np.zeros((n, m), dtype=bool)
        np.put_along_axis(chosen, order, np.arange(m) < wanted[:, None], axis=1)
        chosen &= visible
        chosen[np.count_nonzero(chosen, axis=1) < LEAST] = False
        point, image = np.nonzero(chosen)
        return point, image, pixels[image, point]

    def beneath(self, points: Array) -> Mask:
        """Which of points (n, 3) in m may lie in its nadir image."""
        swath, (along, across) = self.swaths[_NADIR], _angles(self.axes, points)
        middle, half = (np.interp(along, swath.along, one) for one in (swath.across, swath.half_width))
        slack = 0.02 * np.ptp(swath.along)
        inside = (along > swath.along[0] - slack) & (along < swath.along[-1] + slack)
        return np.asarray(inside & (np.abs(across - middle) < _BESIDE * half))

    def _projected(self, j: int, points: Array) -> Array:
        """True line and sample (n, 2) in image j; NaN where unseen. In the order of lines, so that neighbours share
        rows of the tables.
        """
        guess = np.interp(_angles(self.axes, points)[0], self.swaths[j].along, self.swaths[j].lines)
        order, pixels = np.argsort(guess), np.empty((len(points), 2))
        for first in range(0, len(points), _BLOCK):
            some = order[first : first + _BLOCK]
            pixels[some], _ = self.images[j].ground_to_image(points[some], self.true, guess[some])
        return pixels


def matched_points(
    strips: list[FlownStrip], relief: SiteTerrain, number: int, matches: PointMatching, rng: np.random.Generator
) -> tuple[Array, Visible]:
    """Random points of the true ground in the strips' nadir images, evenly many of each strip, (number, 3) in m, and
    where they are matched; images are counted through all strips.
    """
    counts = np.diff(np.linspace(0, number, len(strips) + 1).astype(int)).tolist()
    points, visible, first = list[Array](), Visible(), 0
    for k, count in enumerate(counts):
        own = _of_strip(strips[k], relief, count, matches, rng, visible, (first, len(STEREO) * k))
        points.append(own)
        for j, other in enumerate(strips):
            if j != k:
                tried = np.flatnonzero(other.beneath(own) & (rng.random(len(own)) < matches.linked))
                point, image, pixels = other.matched(own[tried], matches, rng)
                visible.add(tried[point] + first, image + len(STEREO) * j, pixels)
        first += count
    return np.concatenate(points), visible


def _of_strip(
    strip: FlownStrip,
    relief: SiteTerrain,
    count: int,
    matches: PointMatching,
    rng: np.random.Generator,
    visible: Visible,
    first: tuple[int, int],
) -> Array:
    """Points (count, 3) in m of a strip. What its own images see of them is added to `visible`, with numbers of points
    and images that count from `first`.
    """
    kept, have = [np.zeros((0, 3))], 0
    for _ in range(_ROUNDS):
        if have == count:
            break
        points = _on_ground(strip.images[_NADIR], relief, count - have + 16, rng)
        point, image, pixels = strip.matched(points, matches, rng)
        seen, number = np.unique(point, return_inverse=True)
        some = number < count - have
        points = points[seen[: count - have]]
        kept.append(points)
        visible.add(number[some] + have + first[0], image[some] + first[1], pixels[some])
        have += len(points)
    if have < count:
        name = strip.images[_NADIR].name
        remedy = "take longer strips or smaller errors of the trajectories"
        raise InputError(f"simulated block, {name}", f"ground for {have} of {count} points", remedy=remedy)
    return np.concatenate(kept)


def _on_ground(nadir: PushbroomImage, relief: SiteTerrain, count: int, rng: np.random.Generator) -> Array:
    """Points (count, 3) in m of the true ground, evenly drawn over the nadir image as nominally oriented."""
    size = np.array([nadir.lines, nadir.samples])
    lines, samples = rng.uniform(MARGIN, size - MARGIN, (count, 2)).T
    ground, _, _ = intersect_ellipsoid(*nadir.sightlines(lines, samples), nadir.body, relief.ground.level)
    longitude, latitude, _ = planetocentric(ground).T
    return relief.on_ground(longitude, latitude)


def _swath(axes: Array, image: PushbroomImage, level: float) -> _Swath:
    lines = np.linspace(0.0, image.lines, _TABLE)
    ground = [
        image.image_to_ground(lines, np.full(_TABLE, share * image.samples), level)[0] for share in (0.0, 0.5, 1.0)
    ]
    left, middle, right = (_angles(axes, points) for points in ground)
    return _Swath(middle[0], lines, middle[1], 0.5 * np.abs(left[1] - right[1]))


def _angles(axes: Array, points: Array) -> tuple[Array, Array]:
    """Angles (n,) in rad at Mars' centre along and across the flight over the pericentre."""
    flight, across, up = (points @ axes.T / np.linalg.norm(points, axis=1)[:, None]).T
    return np.arctan2(flight, up), np.arcsin(np.clip(across, -1.0, 1.0))
