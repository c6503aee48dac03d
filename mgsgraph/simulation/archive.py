"""Archives as large as those that are adjusted as a whole: where their images lie, and how each was taken.

Images lie side by side in a block or about the whole globe, with overlaps along and across the track; or in clusters
about places that were looked at again and again. Every image is taken on an orbit of its own, a circle, with a
correction of its own drawn from the prior. True orientation = nominal (+) correction, and measures are true image
places plus noise, so that an adjustment with the stated sigmas has consistent statistics.
"""

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, get_args

import numpy as np

from mgsgraph.errors import require
from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.simulation.camera import interior_orientation, line_image, one_rate
from mgsgraph.simulation.observations import NoiseSettings, require_count, require_seed
from mgsgraph.simulation.orbit import (
    MARS_BODY,
    MOON_BODY,
    CentralBody,
    CircularPass,
    circular_trajectory,
    on_ellipsoid,
)
from mgsgraph.units import DEG

ArchiveKind = Literal["kaguya", "ctx", "moc", "dense", "block", "region"]
"""Camera and layout."""
ARCHIVE_KINDS = get_args(ArchiveKind)
"""What `simulate archive --kind` offers."""

_FIRST, _STEP = -50_000_000.0, 1000.0
"""s TDB past J2000 of the first image's middle, and s from one to the next; whole numbers, exact in files."""
_INCLINATION = 93.0 * DEG
"""Of all orbits: the poles are passed at 3 degrees."""
_NORTHERNMOST = 86.0 * DEG
"""Latitude up to which a globe is covered: beyond it no orbit has its middle."""
_RECORDS = 4
"""Of each image's tables of position and attitude: a circle between two of them is off by less than a centimetre."""
_SHAKEN = 0.05
"""Share of their distances by which images of a block lie off their places, at most."""
_SCATTER = 0.45
"""Share of an image's size by which those of a cluster lie off its middle, at most."""


_TIE = 0.5
"""pixels, sigma of line and sample of a measure."""


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
    """Default settings of an archive."""

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
    about_a_place: float = 4.0
    """Images of a cluster beyond the first two, on the average."""
    extent: float = 1.0
    """Share of all longitudes over which clusters lie, and of the sines of all latitudes about the equator."""
    profiles: bool = False
    """Whether an altimeter's profile was taken along with each image."""


_PLANS: dict[str, _Plan] = {
    "kaguya": _Plan(_TC, 3361, 240_000, "block", (0.15, 0.535), 1, 1000.0),
    "ctx": _Plan(_CTX, 70_000, 2_400_000, "block", (0.25, 0.4), 0, 1000.0),
    "moc": _Plan(_MOC, 97_000, 1_500_000, "clusters", (0.0, 0.0), 0, 150.0),
    "dense": _Plan(_TC, 20_000, 12_000_000, "block", (0.1, 0.25), 0, 1000.0),
    "region": _Plan(_MOC, 1000, 60_000, "clusters", (0.0, 0.0), 0, 150.0, 10.0, 0.1, True),
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
    noise: NoiseSettings
    """Sigmas of corrections and of the measures of ties; its trend has a factor for each degree of the polynomials."""

    def __post_init__(self) -> None:
        require_count("archive settings, images", self.images, 2)
        require_count("archive settings, ties", self.ties, 1)

    @property
    def plan(self) -> _Plan:
        """Camera and layout."""
        return _PLANS[self.kind]


def archive_settings(
    kind: str, images: int | None = None, ties: int | None = None, degree: int | None = None
) -> ArchiveSettings:
    """Settings of a kind of archive, those that aren't given as it is by default; ties go with the images.

    Raises
    ------
    InputError
        For an unknown kind, and for numbers that can't be.
    """
    require(kind in _PLANS, "kind", repr(kind), f"{', '.join(ARCHIVE_KINDS[:-1])} or {ARCHIVE_KINDS[-1]}")
    plan = _PLANS[kind]
    images = plan.images if images is None else images
    ties = max(round(plan.ties * images / plan.images), 1) if ties is None else ties
    degree = plan.degree if degree is None else degree
    require(0 <= degree <= 2, "archive settings, degree", f"{degree}", "0, 1 or 2")
    noise = NoiseSettings(tie=_TIE, trend=NoiseSettings().trend[: degree + 1])
    return ArchiveSettings(kind=kind, images=images, ties=ties, noise=noise)  # type: ignore[arg-type]


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
        center_time = -float(swept) / float(np.sqrt(camera.body.gravity / radius**3))
        flown = CircularPass(
            float(self.epochs[j]), self.sites[j], float(self.headings[j]), camera.altitude, float(self.aside[j]),
            camera.body, turning=True,
        )  # fmt: skip
        half = 0.5 * camera.lines * camera.period
        times = center_time + half * np.linspace(-1.05, 1.05, _RECORDS)
        timing, size = one_rate(center_time - half, camera.period), (camera.lines, camera.samples)
        trajectory = circular_trajectory(flown, times)
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
    sigmas = settings.noise.prior.sigmas
    return Archive(
        settings, seed, sites, np.arcsin(np.cos(_INCLINATION) / np.cos(places[:, 1])),
        of_places.uniform(-camera.aside, camera.aside, n), ahead,
        np.asarray(_FIRST + _STEP * of_times.permutation(n), dtype=np.float64),
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
    sizes = 2 + rng.geometric(1.0 / settings.plan.about_a_place, sites // 2 + 1)
    sizes = sizes[: int(np.searchsorted(np.cumsum(sizes), sites)) + 1]
    of_place = np.repeat(np.arange(sizes.size), sizes)[:sites]
    of_place[-1] = of_place[-2]  # never one alone
    longitudes = settings.plan.extent * rng.uniform(-np.pi, np.pi, sizes.size)[of_place]
    latitudes = np.arcsin(settings.plan.extent * rng.uniform(-0.98, 0.98, sizes.size))[of_place]
    camera = settings.plan.camera
    along, across = (
        rng.uniform(-_SCATTER, _SCATTER, (sites, 2)) * camera.ground_size / camera.body.ellipsoid.equatorial
    ).T
    return np.column_stack([longitudes + across / np.cos(latitudes), latitudes + along])



