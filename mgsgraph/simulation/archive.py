"""Archives as large as those that are adjusted as a whole: where their images lie, and how each was taken.

Images lie side by side in a block or about the whole globe, with overlaps along and across the track; or in clusters
about places that were looked at again and again. Every image is taken on an orbit of its own, a circle, with a
correction of its own drawn from the prior. True orientation = nominal (+) correction, and measures are true image
places plus noise, so that an adjustment with the stated sigmas has honest statistics.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, NamedTuple, get_args

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.geometry.body import from_planetocentric, surface_radii
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection, OrientationPrior
from mgsgraph.geometry.records import Array, Index
from mgsgraph.simulation.camera import interior_orientation, line_image, one_rate
from mgsgraph.simulation.observations import require_count, require_seed, well_inside
from mgsgraph.simulation.orbit import (
    MARS_BODY,
    MOON_BODY,
    CentralBody,
    CircularPass,
    circular_attitude,
    circular_orbit,
    on_ellipsoid,
    sampled_trajectory,
)
from mgsgraph.units import DEG
from mgsgraph.workers import Count, no_progress

ArchiveKind = Literal["kaguya", "ctx", "moc", "dense", "block"]
"""Camera and layout."""
ARCHIVE_KINDS = get_args(ArchiveKind)
"""What `simulate archive --kind` offers."""

_FIRST, _APART = -50_000_000.0, 1000.0
"""s TDB past J2000 of the first image's middle, and s from one to the next; whole numbers, exact in files."""
_INCLINATION = 93.0 * DEG
"""Of all orbits: the poles are passed at 3 degrees."""
_NORTHERNMOST = 86.0 * DEG
"""Latitude up to which a globe is covered: beyond it no orbit has its middle."""
_RECORDS = 4
"""Of each image's tables of position and attitude: a circle between two of them is off by less than a centimetre."""
_SHAKEN = 0.05
"""Share of their distances by which images of a block lie off their places, at most."""
_MORE_ABOUT_A_PLACE = 4.0
"""Images of a cluster beyond the first two, on the average."""
_SCATTER = 0.45
"""Share of an image's size by which those of a cluster lie off its middle, at most."""


class _Camera(NamedTuple):
    """A line camera on its orbit, and the prior of its orientation."""

    body: CentralBody
    altitude: float
    """m."""
    focal_length: float
    """m."""
    pitch: float
    """m between detector pixels."""
    samples: int
    """Of a line."""
    summing: float
    """Detector pixels per sample."""
    lines: int
    """Of an image, on the average."""
    period: float
    """s per line."""
    ahead: tuple[float, ...]
    """rad by which its detector lines look ahead of nadir; each takes images of its own."""
    aside: float
    """rad from nadir across the track up to which it is rolled."""

    @property
    def ground_size(self) -> Array:
        """(2,) m, length and width of an image's ground at nadir."""
        radius = self.body.ellipsoid.equatorial
        speed = radius * np.sqrt(self.body.gravity / (radius + self.altitude) ** 3)
        width = self.samples * self.summing * self.pitch / self.focal_length * self.altitude
        return np.array([self.lines * self.period * speed, width])

    def interior(self, ahead: float) -> InteriorOrientation:
        """Of the detector line that looks `ahead` (rad)."""
        centre = 0.5 * self.summing * self.samples
        plain = interior_orientation(self.focal_length, self.pitch, centre, summing=self.summing)
        to_pixel = plain.to_pixel.copy()
        to_pixel[0, 0] = -self.focal_length * np.tan(ahead) / self.pitch
        return replace(plain, to_pixel=to_pixel)


_TC = _Camera(MOON_BODY, 100e3, 0.07245, 7e-6, 3208, 1.0, 4656, 6.5e-3, (15.0 * DEG, -15.0 * DEG), 0.0)
"""Kaguya's Terrain Camera: SEL_TC_V01.TI, kaguyaTcAddendum006.ti and the label of TC1S2B0_01_06691S820E0465."""
_CTX = _Camera(MARS_BODY, 300e3, 0.3529272, 7e-6, 5000, 1.0, 26000, 1.877e-3, (0.0,), 12.0 * DEG)
"""MRO's Context Camera: mroctxAddendum005.ti."""
_MOC = _Camera(MARS_BODY, 378e3, 3.5, 13.1240578522949e-6, 1024, 2.0, 6144, 2 * 4.821e-4, (0.0,), 18.0 * DEG)
"""MOC's narrow angle, summed 2 x 2: moc20.ti, mocAddendum004.ti."""


class _Plan(NamedTuple):
    """What an archive is made of by default."""

    camera: _Camera
    images: int
    ties: int
    layout: Literal["block", "clusters"]
    overlap: tuple[float, float]
    """Shares of an image that it has in common with the next along and across the track."""
    degree: int
    """Of the polynomials by which orientations are corrected."""
    relief: float
    """m, amplitude of the ground's largest sine."""


_PLANS: dict[str, _Plan] = {
    "kaguya": _Plan(_TC, 3361, 240_000, "block", (0.15, 0.535), 1, 1000.0),
    "ctx": _Plan(_CTX, 70_000, 2_400_000, "block", (0.25, 0.4), 0, 1000.0),
    "moc": _Plan(_MOC, 97_000, 1_500_000, "clusters", (0.0, 0.0), 0, 150.0),
    "dense": _Plan(_TC, 20_000, 12_000_000, "block", (0.1, 0.25), 0, 1000.0),
    "block": _Plan(_TC, 500, 1_000_000, "block", (0.1, 0.1), 2, 1000.0),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ArchiveSettings:
    """What archive to simulate; sigmas are those that its case states."""

    kind: ArchiveKind
    """Camera and layout."""
    images: int
    """Number of images."""
    ties: int
    """Number of tie points, about: those that only one image turns out to show are left out."""
    degree: int
    """Of the polynomials of the line by which orientations are corrected: 6 (degree + 1) unknowns of each image."""
    position: float = 30.0
    """m, sigma of the constant position correction in each direction."""
    angle: float = 1e-4
    """rad, sigma of the constant rotation correction about each axis."""
    tie: float = 0.5
    """pixels, sigma of line and sample of a measure."""

    def __post_init__(self) -> None:
        require_count("archive settings, images", self.images, 2)
        require_count("archive settings, ties", self.ties, 1)
        require_count("archive settings, degree", self.degree, 0)

    @property
    def plan(self) -> _Plan:
        """Camera and layout."""
        return _PLANS[self.kind]

    @property
    def trend(self) -> tuple[float, ...]:
        """Sigma of the coefficients of u^0, u^1, ... in units of the constant ones."""
        return (1.0, 0.1, 0.01)[: self.degree + 1]

    @property
    def prior(self) -> OrientationPrior:
        """Of each image's corrections."""
        return OrientationPrior(np.outer(self.trend, [self.position] * 3 + [self.angle] * 3))


def archive_settings(
    kind: str, images: int | None = None, ties: int | None = None, degree: int | None = None
) -> ArchiveSettings:
    """Settings of a kind of archive, those that aren't given as it is by default; ties go with the images.

    Raises
    ------
    InputError
        For an unknown kind, and for numbers that can't be.
    """
    if kind not in _PLANS:
        raise InputError("kind", repr(kind), f"{', '.join(ARCHIVE_KINDS[:-1])} or {ARCHIVE_KINDS[-1]}")
    plan = _PLANS[kind]
    images = plan.images if images is None else images
    ties = max(round(plan.ties * images / plan.images), 1) if ties is None else ties
    degree = plan.degree if degree is None else degree
    require(degree <= 2, "archive settings, degree", f"{degree}", "0, 1 or 2")
    return ArchiveSettings(kind=kind, images=images, ties=ties, degree=degree)  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True, eq=False)
class Archive:
    """Where and how each of n images was taken, and its true correction."""

    settings: ArchiveSettings
    """What was asked for."""
    seed: int
    """Seed of everything drawn."""
    sites: Array
    """(n, 3) m, body-fixed, on the ellipsoid: the middles of the images."""
    headings: Array
    """(n,) rad, inertial flight direction from north towards east over the middle."""
    aside: Array
    """(n,) rad, roll from nadir across the track."""
    ahead: Array
    """(n,) rad by which the detector line looks ahead."""
    epochs: Array
    """(n,) s TDB past J2000 at which the spacecraft is beside the middle; in an order drawn at random."""
    corrections: Array
    """(n, degree + 1, 6) m and rad: true orientation = nominal (+) these."""

    def __len__(self) -> int:
        return len(self.epochs)

    def name(self, j: int) -> str:
        """Of image `j`; all are of one length."""
        return f"{self.settings.kind[:3].upper()}/{j:06d}"

    def image(self, j: int) -> PushbroomImage:
        """Image `j`, nominal."""
        camera, ahead = self.settings.plan.camera, float(self.ahead[j])
        radius = float(np.linalg.norm(self.sites[j])) + camera.altitude
        swept = np.arcsin(radius / (radius - camera.altitude) * np.sin(ahead)) - ahead
        seen = -float(swept) / float(np.sqrt(camera.body.gravity / radius**3))
        flown = CircularPass(
            float(self.epochs[j]), self.sites[j], float(self.headings[j]), camera.altitude, float(self.aside[j]),
            camera.body, turning=True,
        )  # fmt: skip
        half = 0.5 * camera.lines * camera.period
        times = seen + half * np.linspace(-1.05, 1.05, _RECORDS)
        trajectory = sampled_trajectory(
            flown.epoch, times, circular_orbit(flown).state(times), circular_attitude(flown, times),
            camera.body.to_fixed(flown.epoch + times),
        )  # fmt: skip
        timing = one_rate(seen - half, camera.period)
        size = camera.lines, camera.samples
        return line_image(self.name(j), size, camera.interior(ahead), timing, trajectory, camera.body.ellipsoid)

    def true(self, j: int) -> OrientationCorrection:
        """The true correction of image `j`."""
        return OrientationCorrection(self.corrections[j])


def lay_out(settings: ArchiveSettings, seed: int = 1) -> Archive:
    """Place the images of an archive; the same settings and seed give the same archive.

    Parameters
    ----------
    settings : ArchiveSettings
    seed : int
        zero or positive.
    """
    require_seed("archive", seed)
    of_places, of_times, of_orientation = np.random.default_rng(seed).spawn(3)
    camera, n = settings.plan.camera, settings.images
    lines = len(camera.ahead)
    places = (_clusters if settings.plan.layout == "clusters" else _tiles)(settings, -(-n // lines), of_places)
    places = np.repeat(places, lines, axis=0)[:n]
    ahead = np.resize(camera.ahead, n)
    sites = on_ellipsoid(from_planetocentric(np.column_stack([places, np.ones(n)])), body=camera.body.ellipsoid)
    sigmas = settings.prior.sigmas
    return Archive(
        settings, seed, sites, np.arcsin(np.cos(_INCLINATION) / np.cos(places[:, 1])),
        of_places.uniform(-camera.aside, camera.aside, n), ahead,
        np.asarray(_FIRST + _APART * of_times.permutation(n), dtype=np.float64),
        sigmas * of_orientation.standard_normal((n, *sigmas.shape)),
    )  # fmt: skip


def _tiles(settings: ArchiveSettings, sites: int, rng: np.random.Generator) -> Array:
    """(sites, 2) rad, longitudes and latitudes of images side by side: of a square block, or all about the globe where
    so many fill it.
    """
    plan, radius = settings.plan, settings.plan.camera.body.ellipsoid.equatorial
    size = plan.camera.ground_size
    along, across = (1.0 - np.array(plan.overlap)) * size / radius
    most = int(2.0 * _NORTHERNMOST / along)
    rows = int(np.clip(round(np.sqrt(sites * across / along)), 1, most))
    latitudes = along * (np.arange(rows) - 0.5 * (rows - 1))
    columns = np.full(rows, -(-sites // rows))
    steps = across / np.cos(latitudes)
    if rows == most or np.any(columns * steps > 2.0 * np.pi):
        latitudes = np.linspace(-_NORTHERNMOST, _NORTHERNMOST, most)
        columns = np.diff(np.rint(sites * np.cumsum([0.0, *np.cos(latitudes)]) / np.cos(latitudes).sum())).astype(int)
        steps = 2.0 * np.pi / np.maximum(columns, 1)
    row = np.repeat(np.arange(latitudes.size), columns)
    column = np.arange(row.size) - np.repeat(np.cumsum(columns) - columns, columns)
    longitudes = steps[row] * (column - 0.5 * (columns[row] - 1))
    shaken = _SHAKEN * rng.uniform(-1.0, 1.0, (row.size, 2)) * np.column_stack([steps[row], np.full(row.size, along)])
    return np.asarray((np.column_stack([longitudes, latitudes[row]]) + shaken)[:sites])


def _clusters(settings: ArchiveSettings, sites: int, rng: np.random.Generator) -> Array:
    """(sites, 2) rad, longitudes and latitudes of images about places at random, 2 or more about each."""
    sizes = 2 + rng.geometric(1.0 / _MORE_ABOUT_A_PLACE, sites // 2 + 1)
    sizes = sizes[: int(np.searchsorted(np.cumsum(sizes), sites)) + 1]
    of_place = np.repeat(np.arange(sizes.size), sizes)[:sites]
    of_place[-1] = of_place[-2]  # never one alone
    longitudes = rng.uniform(-np.pi, np.pi, sizes.size)[of_place]
    latitudes = np.arcsin(rng.uniform(-0.98, 0.98, sizes.size))[of_place]
    camera = settings.plan.camera
    along, across = (
        rng.uniform(-_SCATTER, _SCATTER, (sites, 2)) * camera.ground_size / camera.body.ellipsoid.equatorial
    ).T
    return np.column_stack([longitudes + across / np.cos(latitudes), latitudes + along])



_REGION = 20_000
"""Points of a region, about."""
_DRAWN = 4
"""Places drawn for each point that is wanted."""
_KEPT = 1 << 13
"""Images kept in memory; those of a region are used several times."""
_WAVES = np.array([[1.0, 61e3, 0.0], [0.5, 23e3, 1.3], [0.2, 9e3, 2.9]])
"""Of each wave of the ground: share of the amplitude, wavelength (m), phase (rad)."""
_DIRECTIONS = np.array([[0.48, 0.60, 0.64], [-0.64, 0.60, 0.48], [0.60, -0.64, 0.48]])
"""(3, 3) unit rows along which they run, body-fixed."""


class Footprints(NamedTuple):
    """The ground of n images as parallelograms, nominal, on the ellipsoid."""

    middles: Array
    """(n, 3) m, body-fixed."""
    halves: Array
    """(n, 2, 3) m, from the middle to the last line's and to the last sample's middle."""

    def directions(self, image: Index, along: Array, across: Array) -> Array:
        """Unit vectors (k, 3) to places in images (k,), -1 to 1 along and across each."""
        places = self.middles[image] + along[:, None] * self.halves[image, 0] + across[:, None] * self.halves[image, 1]
        return np.asarray(places / np.linalg.norm(places, axis=1, keepdims=True))

    def coordinates(self, image: Index, directions: Array) -> Array:
        """Places (k, 2) along and across images (k,), within -1 to 1 inside, of directions (k, 3) to the ground."""
        middle = self.middles[image]
        radius = np.linalg.norm(middle, axis=1)
        depth = np.einsum("ki,ki->k", directions, middle) / radius
        off = directions * (radius / depth)[:, None] - middle
        first, second = self.halves[image, 0], self.halves[image, 1]
        a, b, c = (np.einsum("ki,ki->k", *pair) for pair in ((first, first), (first, second), (second, second)))
        e, f = np.einsum("ki,ki->k", off, first), np.einsum("ki,ki->k", off, second)
        return np.asarray(np.column_stack([c * e - b * f, a * f - b * e]) / (a * c - b * b)[:, None])


def footprint(image: PushbroomImage) -> tuple[Array, Array]:
    """Middle (3,) and halves (2, 3) of an image, as `Footprints` has them."""
    lines, samples = np.array([0.5, 0.0, 1.0, 0.5, 0.5]), np.array([0.5, 0.5, 0.5, 0.0, 1.0])
    points, _ = image.image_to_ground(lines * image.lines, samples * image.samples)
    middle, first, last, left, right = points
    return middle, 0.5 * np.stack([last - first, right - left])


class _Cells:
    """Cells of the ground, of equal height and about equal width, and which images reach into each."""

    def __init__(self, footprints: Footprints, size: float) -> None:
        """Cells whose side is `size`, in rad."""
        self._bands = int(np.ceil(np.pi / size))
        middle = (np.arange(self._bands) + 0.5) * np.pi / self._bands - 0.5 * np.pi
        self._columns = np.maximum(np.rint(2.0 * np.pi * np.cos(middle) / size).astype(np.int64), 1)
        self._first = np.cumsum(self._columns) - self._columns
        pairs = [self._reached(footprints, part, size) for part in _parts(len(footprints.middles), 1000)]
        cells, self.images = (np.concatenate(each) for each in zip(*pairs, strict=True))
        order = np.lexsort([self.images, cells])
        self.images = self.images[order]
        self._cells, self._starts = np.unique(cells[order], return_index=True)
        self._ends = np.append(self._starts[1:], order.size)

    def of(self, directions: Array) -> Index:
        """Numbers (k,) of the cells that directions (k, 3) meet."""
        latitude = np.arcsin(np.clip(directions[:, 2], -1.0, 1.0))
        longitude = np.arctan2(directions[:, 1], directions[:, 0])
        band = np.clip(((latitude + 0.5 * np.pi) * (self._bands / np.pi)).astype(np.int64), 0, self._bands - 1)
        column = ((longitude / (2.0 * np.pi) + 0.5) * self._columns[band]).astype(np.int64)
        return np.asarray(self._first[band] + np.minimum(column, self._columns[band] - 1))

    def candidates(self, directions: Array) -> tuple[Index, Index]:
        """Points (c,) and images (c,) that may show them, by points."""
        cells = self.of(directions)
        k = np.minimum(np.searchsorted(self._cells, cells), self._cells.size - 1)
        found = self._cells[k] == cells
        counts = np.where(found, self._ends[k] - self._starts[k], 0)
        point = np.repeat(np.arange(cells.size), counts)
        within = np.arange(point.size) - np.repeat(np.cumsum(counts) - counts, counts)
        return point, self.images[self._starts[k][point] + within]

    def _reached(self, footprints: Footprints, part: Index, size: float) -> tuple[Index, Index]:
        """Cells (c,) and images (c,) of some images that reach into them."""
        radius = np.linalg.norm(footprints.middles[part], axis=1)
        halves = np.linalg.norm(footprints.halves[part], axis=2).max(axis=0) / radius.min()
        along, across = (
            each.ravel() for each in np.meshgrid(*(
                np.linspace(-1.05, 1.05, 2 + int(np.ceil(4.2 * half / size))) for half in halves
            ))
        )  # fmt: skip
        image = np.repeat(part, along.size)
        directions = footprints.directions(image, np.tile(along, part.size), np.tile(across, part.size))
        pairs = np.unique(np.column_stack([self.of(directions), image]), axis=0)
        return pairs[:, 0], pairs[:, 1]


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """Tie points of a region with all their measures."""

    points: Array
    """(n, 3) m, body-fixed, true."""
    counts: Index
    """(n,) number of measures of each, 2 or more."""
    images: Index
    """(k,) image of each measure, by points."""
    measures: Array
    """(k, 2) line and sample, with noise."""


def regions(archive: Archive, footprints: Footprints, progress: Count = no_progress) -> Iterator[Region]:
    """All tie points of an archive, region by region.

    Parameters
    ----------
    archive : Archive
    footprints : Footprints
        Of its images.
    progress : Count
        Called with how many images are done.
    """
    width = np.linalg.norm(footprints.halves[:, 1], axis=1).min() / np.linalg.norm(footprints.middles[0])
    cells = _Cells(footprints, float(width))
    order = _by_place(footprints)
    wanted = archive.settings.ties / len(archive)
    many = max(int(_REGION / wanted), 1)
    image_of = lru_cache(maxsize=_KEPT)(archive.image)
    streams = np.random.default_rng([archive.seed, 1]).spawn(-(-len(archive) // many))
    drawn_so_far = 0
    for k, rng in enumerate(streams):
        owners = order[k * many : (k + 1) * many]
        upto = round(wanted * (k * many + owners.size))
        quota: Index = np.diff(np.linspace(drawn_so_far, upto, owners.size + 1).astype(np.int64)).astype(np.int64)
        drawn_so_far = upto
        directions = _drawn(archive, footprints, cells, owners, quota, rng)
        yield _projected(archive, footprints, cells, image_of, directions, rng)
        progress(k * many + owners.size, len(archive))


def _drawn(
    archive: Archive, footprints: Footprints, cells: _Cells, owners: Index, quota: Index, rng: np.random.Generator
) -> Array:
    """(n, 3) directions to places at random in some images, which another image shows as well; of each image as many
    as wanted, `quota` (images,), where it has so much ground in common.
    """
    owner = np.repeat(np.arange(owners.size), _DRAWN * quota + 8)
    along, across = rng.uniform(-0.99, 0.99, (2, owner.size))
    directions = footprints.directions(owners[owner], along, across)
    point, image = cells.candidates(directions)
    slack = _shares(archive, footprints, image)
    inside = np.all(np.abs(footprints.coordinates(image, directions[point])) < 1.0 - slack, axis=1)
    good = np.bincount(point[inside], minlength=owner.size) > 1
    rank: Index = np.cumsum(good) - good
    begun = np.concatenate([[0], np.cumsum(_DRAWN * quota + 8)[:-1]])
    return np.asarray(directions[good & (rank - rank[begun][owner] < quota[owner])])


def _shares(archive: Archive, footprints: Footprints, image: Index) -> Array:
    """(k, 2) shares of the half length and width of images (k,) by which the ground may lie elsewhere than thought."""
    settings = archive.settings
    moved = 2.0 * (settings.position + settings.angle * settings.plan.camera.altitude) + 0.3 * settings.plan.relief
    return np.asarray(moved / np.linalg.norm(footprints.halves[image], axis=2))


def _projected(
    archive: Archive, footprints: Footprints, cells: _Cells, image_of: Callable[[int], PushbroomImage],
    directions: Array, rng: np.random.Generator,
) -> Region:  # fmt: skip
    """The points in these directions (n, 3) that two or more images truly show, with measures."""
    points = on_waves(archive, directions)
    point, image = cells.candidates(directions)
    places = footprints.coordinates(image, directions[point])
    near = np.flatnonzero(np.all(np.abs(places) < 1.0 + _shares(archive, footprints, image), axis=1))
    near = near[np.argsort(image[near], kind="stable")]
    point, image, along = point[near], image[near], places[near, 0]
    pixels = np.full((near.size, 2), np.nan)
    bounds = np.flatnonzero(np.diff(image, prepend=-1, append=-1))
    for first, last in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
        j = int(image[first])
        taken = image_of(j)
        start = 0.5 * taken.lines * (1.0 + along[first:last])
        found, _ = taken.ground_to_image(points[point[first:last]], archive.true(j), start)
        found[~well_inside(taken, found)] = np.nan
        pixels[first:last] = found
    seen = np.isfinite(pixels[:, 0])
    counts = np.bincount(point[seen], minlength=len(points))
    kept = np.flatnonzero(seen & (counts[point] > 1))
    kept = kept[np.lexsort([image[kept], point[kept]])]
    exact = pixels[kept]
    return Region(
        points[counts > 1], counts[counts > 1], image[kept],
        exact + archive.settings.tie * rng.standard_normal(exact.shape),
    )  # fmt: skip


def on_waves(archive: Archive, directions: Array) -> Array:
    """(n, 3) m, body-fixed, the true ground in directions (n, 3)."""
    radii = surface_radii(directions, archive.settings.plan.camera.body.ellipsoid)
    on_surface = radii[:, None] * directions
    share, length, phase = _WAVES.T
    heights = np.sin(2.0 * np.pi * (on_surface @ _DIRECTIONS.T) / length + phase) @ share
    return np.asarray((radii + archive.settings.plan.relief * heights)[:, None] * directions)


def _by_place(footprints: Footprints) -> Index:
    """Images (n,) in such an order that those which follow each other are neighbours: in bands of latitude."""
    latitude = np.arcsin(footprints.middles[:, 2] / np.linalg.norm(footprints.middles, axis=1))
    longitude = np.arctan2(footprints.middles[:, 1], footprints.middles[:, 0])
    height = 2.0 * np.linalg.norm(footprints.halves[:, 0], axis=1).max() / np.linalg.norm(footprints.middles[0])
    band = np.floor(latitude / height).astype(np.int64)
    return np.lexsort([np.where(band % 2 == 0, longitude, -longitude), band])


def _parts(size: int, most: int) -> list[Index]:
    """Numbers 0 to `size` in parts of at most `most`."""
    return [np.arange(first, min(first + most, size)) for first in range(0, size, most)]
