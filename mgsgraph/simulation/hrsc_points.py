"""Points on the ground of a block, and where the lines of its strips see them with their true orientation."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import intersect_ellipsoid, planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.simulation.hrsc_camera import STEREO
from mgsgraph.simulation.observations import MARGIN, require_positive, well_inside
from mgsgraph.simulation.terrain import SiteTerrain

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
class Matches:
    """How points are matched."""

    shares: tuple[float, float, float] = (0.05, 0.15, 0.80)
    """Of the points of a strip that are matched in 3, 4 and 5 of its lines, where five see them; they add up to 1."""
    linked: float = 0.3
    """Share of the points which another strip sees, too, that are matched in its lines as well."""
    sigma: float = 0.4
    """px of each image (macropixels), of line and sample."""
    blunders: float = 0.0
    """Share of rays that are 5 to 100 px off."""

    def __post_init__(self) -> None:
        shares = np.array(self.shares, dtype=np.float64)
        if shares.shape != (3,) or not np.all(shares >= 0.0) or abs(shares.sum() - 1.0) > 1e-9:
            raise InputError("block settings, shares of points", f"{self.shares}", "three shares that add up to 1")
        require_positive("block settings, matching sigma", self.sigma)
        for name in ("linked", "blunders"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(f"block settings, {name}", f"{getattr(self, name)}", "a share, 0 .. 1")


@dataclass(frozen=True, slots=True, eq=False)
class Pass:
    """A strip as it was flown."""

    axes: Array
    """(3, 3) unit rows, body-fixed: flight, across, up at the pericentre."""
    images: tuple[PushbroomImage, ...]
    """Of the five stereo lines, nominal."""
    true: OrientationCorrection
    """Of all of them."""


class Visits(NamedTuple):
    """Which point stands where in which image, ordered by point, then image."""

    point: Index
    """(k,)."""
    image: Index
    """(k,) counted through all passes."""
    places: Array
    """(k, 2) line and sample, exact."""


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


def matched_points(
    passes: list[Pass], relief: SiteTerrain, number: int, matches: Matches, rng: np.random.Generator
) -> tuple[Array, Visits]:
    """Points at random places of the strips' nadir images, evenly many of each strip, and their image places.

    Returns
    -------
    places : (number, 3)
        m, body-fixed, on the true ground.
    visits : Visits
    """
    swaths = [[_swath(one.axes, image, relief.ground.level) for image in one.images] for one in passes]
    counts = np.diff(np.linspace(0, number, len(passes) + 1).astype(int)).tolist()
    places, found, first = list[Array](), list[Visits](), 0
    for k, count in enumerate(counts):
        mine, own = _of_strip(passes, swaths, k, relief, count, matches, rng)
        places.append(mine)
        found += [Visits(own.point + first, own.image, own.places)]
        for j in range(len(passes)):
            if j != k:
                also = _in_other(passes[j], swaths[j], mine, matches, rng)
                found.append(Visits(also.point + first, also.image + len(STEREO) * j, also.places))
        first += count
    point, image = (np.concatenate(parts) for parts in ([v.point for v in found], [v.image for v in found]))
    order = np.lexsort([image, point])
    return np.concatenate(places), Visits(
        point[order], image[order], np.concatenate([v.places for v in found])[order]
    )


def _of_strip(
    passes: list[Pass],
    swaths: list[list[_Swath]],
    k: int,
    relief: SiteTerrain,
    count: int,
    matches: Matches,
    rng: np.random.Generator,
) -> tuple[Array, Visits]:
    """Points of strip k and their places in its own images."""
    kept, found, have = list[Array](), list[Visits](), 0
    for _ in range(_ROUNDS):
        if have == count:
            break
        points = _on_ground(passes[k].images[_NADIR], relief, count - have + 16, rng)
        visits = _matched(passes[k], swaths[k], points, matches, rng)
        seen, number = np.unique(visits.point, return_inverse=True)
        some = number < count - have
        points = points[seen[: count - have]]
        kept.append(points)
        found.append(Visits(number[some] + have, visits.image[some] + len(STEREO) * k, visits.places[some]))
        have += len(points)
    if have < count:
        name = passes[k].images[_NADIR].name
        remedy = "take longer strips or smaller errors of the trajectories"
        raise InputError(f"simulated block, {name}", f"ground for {have} of {count} points", remedy=remedy)
    return np.concatenate([np.zeros((0, 3)), *kept]), _joined(found)


def _in_other(
    other: Pass, swaths: list[_Swath], points: Array, matches: Matches, rng: np.random.Generator
) -> Visits:
    """Places of some of these points in the images of another strip."""
    tried = np.flatnonzero(_beneath(other.axes, swaths[_NADIR], points) & (rng.random(len(points)) < matches.linked))
    visits = _matched(other, swaths, points[tried], matches, rng)
    return Visits(tried[visits.point], visits.image, visits.places)


def _matched(
    one: Pass, swaths: list[_Swath], points: Array, matches: Matches, rng: np.random.Generator
) -> Visits:
    """Where points (n, 3) are matched in lines of a strip: in as many as drawn, of those that see them, or in none."""
    n, m = len(points), len(one.images)
    places = np.empty((m, n, 2))
    for j, (image, swath) in enumerate(zip(one.images, swaths, strict=True)):
        places[j] = _projected(image, one, swath, points)
    visible = np.stack([well_inside(image, own) for image, own in zip(one.images, places, strict=True)], axis=1)
    wanted = rng.choice([3, 4, 5], size=n, p=matches.shares)
    order = np.argsort(np.where(visible, rng.random((n, m)), 2.0), axis=1)
    chosen = np.zeros((n, m), dtype=bool)
    np.put_along_axis(chosen, order, np.arange(m) < wanted[:, None], axis=1)
    chosen &= visible
    chosen[np.count_nonzero(chosen, axis=1) < LEAST] = False
    point, image_number = np.nonzero(chosen)
    return Visits(point, image_number, places[image_number, point])


def _projected(image: PushbroomImage, one: Pass, swath: _Swath, points: Array) -> Array:
    """(n, 2) true line and sample; NaN where unseen. In the order of lines, so that neighbours share tables' rows."""
    guess = np.interp(_angles(one.axes, points)[0], swath.along, swath.lines)
    order, places = np.argsort(guess), np.empty((len(points), 2))
    for first in range(0, len(points), _BLOCK):
        some = order[first : first + _BLOCK]
        places[some], _ = image.ground_to_image(points[some], one.true, guess[some])
    return places


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


def _beneath(axes: Array, swath: _Swath, points: Array) -> Mask:
    """Which points (n, 3) may lie in a swath."""
    along, across = _angles(axes, points)
    middle, half = (np.interp(along, swath.along, one) for one in (swath.across, swath.half_width))
    slack = 0.02 * np.ptp(swath.along)
    inside = (along > swath.along[0] - slack) & (along < swath.along[-1] + slack)
    return np.asarray(inside & (np.abs(across - middle) < _BESIDE * half))


def _angles(axes: Array, points: Array) -> tuple[Array, Array]:
    """Angles (n,) in rad at Mars' centre along and across the flight over the pericentre."""
    flight, across, up = (points @ axes.T / np.linalg.norm(points, axis=1)[:, None]).T
    return np.arctan2(flight, up), np.arcsin(np.clip(across, -1.0, 1.0))


def _joined(parts: list[Visits]) -> Visits:
    none = np.zeros(0, dtype=np.int64)
    return Visits(
        np.concatenate([none, *(one.point for one in parts)]),
        np.concatenate([none, *(one.image for one in parts)]),
        np.concatenate([np.zeros((0, 2)), *(one.places for one in parts)]),
    )
