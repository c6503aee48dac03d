"""Simulated observations: the sigmas they are drawn from, tie points, laser shots, and who shows which point where."""

from dataclasses import dataclass, field

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection, OrientationPrior
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.simulation.ground import rays_to_sines
from mgsgraph.ties import PointKind, TiePoints

MARGIN = 30.0
"""pixels which true image points keep from the edges: six default sigmas of a footprint's measure."""


@dataclass(frozen=True, slots=True)
class NoiseSettings:
    """Sigmas from which everything uncertain is drawn, and which the written case states; one sigma, zero mean."""

    tie: float = 1.0
    """pixels, line and sample of a tie point's measure."""
    shot_image: float = 5.0
    """pixels, line and sample of a footprint's measure."""
    range: float = 1.0
    """m, of a laser range."""
    ground: float = 10.0
    """m, of a footprint in each direction."""
    position: float = 30.0
    """m, of the constant position correction in each direction."""
    angle: float = 1e-4
    """rad, of the constant rotation correction about each axis."""
    trend: tuple[float, ...] = (1.0, 0.1, 0.01)
    """Sigma of the coefficients of u^0, u^1, ... in units of the constant ones; its length says the degree."""

    def __post_init__(self) -> None:
        for name in ("tie", "shot_image", "range", "ground", "position", "angle"):
            require_positive(f"noise settings, {name}", getattr(self, name))
        if not self.trend:
            raise InputError("noise settings, trend", "no factors", "one for each power of u")
        for value in self.trend:
            require_positive("noise settings, trend", value)

    @property
    def prior(self) -> OrientationPrior:
        """Prior of each image's orientation corrections."""
        constant = np.array([self.position] * 3 + [self.angle] * 3)
        return OrientationPrior(np.array(self.trend)[:, None] * constant)

    def correction(self, rng: np.random.Generator) -> OrientationCorrection:
        """A true correction of a nominal orientation, drawn from the prior."""
        sigmas = self.prior.sigmas
        return OrientationCorrection(sigmas * rng.standard_normal(sigmas.shape))


def require_positive(where: str, value: float) -> None:
    """Raise InputError unless a value is finite and above zero."""
    if not (np.isfinite(value) and value > 0.0):
        raise InputError(where, f"{value}", "a positive number")


def require_count(where: str, value: int, least: float) -> None:
    """Raise InputError unless a value is a whole number, not below `least`."""
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise InputError(where, f"{value}", f"a whole number, at least {least:.0f}")


def require_relief(where: str, value: float) -> None:
    """Raise InputError unless a height is finite and not below zero."""
    if not (np.isfinite(value) and value >= 0.0):
        raise InputError(where, f"{value} m", "zero or a positive number")


def well_inside(image: PushbroomImage, pixels: Array) -> Mask:
    """Which lines and samples (n, 2) keep the margin from the image's edges; NaN do not."""
    size = np.array([image.lines, image.samples])
    return np.asarray(np.all((pixels >= MARGIN) & (pixels <= size - MARGIN), axis=1))


@dataclass(slots=True, eq=False)
class Visible:
    """Where points stand in images, without noise: rows (point, image, line and sample), added as they are found."""

    point: list[Index] = field(default_factory=list)
    """(k,) each, numbers of points."""
    image: list[Index] = field(default_factory=list)
    """(k,) each, numbers of images."""
    pixels: list[Array] = field(default_factory=list)
    """(k, 2) each, line and sample."""

    def add(self, points: Index, images: Index | int, pixels: Array) -> None:
        """Add rows of points (k,) in images (k,) or in one image, at lines and samples (k, 2)."""
        self.point.append(points)
        self.image.append(np.broadcast_to(images, points.shape))
        self.pixels.append(pixels)

    def ordered(self) -> tuple[Index, Index, Array]:
        """All rows by point and then by image: points (k,), images (k,), lines and samples (k, 2)."""
        point, image = (np.concatenate([np.zeros(0, dtype=np.int64), *rows]) for rows in (self.point, self.image))
        order = np.lexsort([image, point])
        return point[order], image[order], np.concatenate([np.zeros((0, 2)), *self.pixels])[order]


def free_points(
    source: str, ids: tuple[str, ...], point: Index, images: tuple[str, ...], measures: Array, sigma: Array | float
) -> TiePoints:
    """Tie points without a-priori coordinates.

    Parameters
    ----------
    source : str
        What messages call them.
    ids : n names
        Of the points.
    point : (k,)
        Number of each measure's point.
    images : k names
        Image of each measure.
    measures : (k, 2)
        pixels, line and sample.
    sigma : float or (k, 2)
        pixels.
    """
    n, k = len(ids), len(images)
    return TiePoints(
        source=source,
        ids=ids,
        kinds=np.full(n, PointKind.FREE, dtype=np.int64),
        places=np.full((n, 3), np.nan),
        covariances=np.zeros((n, 3, 3)),
        measure_point=point,
        measure_image=images,
        measures=measures,
        measure_sigmas=np.broadcast_to(sigma, (k, 2)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Shots:
    """Laser shots along an image's optical axis, without noise."""

    times: Array
    """(n,) s TDB past J2000."""
    points: Array
    """(n, 3) m, body-fixed, where they meet the terrain."""
    ranges: Array
    """(n,) m."""


def shots_along(image: PushbroomImage, true: OrientationCorrection, number: int, relief: float) -> Shots:
    """Shots from the spacecraft of an image, evenly spaced in time."""
    epoch = image.trajectory.epoch
    elapsed, _ = image.timing.at(np.linspace(2.0 * MARGIN, image.lines - 2.0 * MARGIN, number))
    times = epoch + elapsed
    lines = image.timing.lines(times - epoch)  # of the time as the file can state it
    points = rays_to_sines(image, true, lines, np.full(number, 0.5 * image.samples), relief)
    return Shots(times, points, np.linalg.norm(points - image.pose(lines, true).position, axis=1))


def profile(
    source: str,
    ids: tuple[str, ...],
    times: Array,
    ranges: Array,
    footprints: Array,
    simultaneous: tuple[tuple[str, ...], ...],
    shot: Index,
    images: tuple[str, ...],
    measures: Array,
    noise: NoiseSettings,
) -> LaserProfile:
    """Laser shots as an adjustment is given them, with the sigmas of the settings.

    Parameters
    ----------
    source : str
        What messages call them.
    ids : n names
        Of the shots.
    times, ranges : (n,)
        s TDB past J2000; m.
    footprints : (n, 3)
        m, body-fixed.
    simultaneous : n tuples of names
        Images taken from the same spacecraft along with each shot.
    shot : (k,)
        Number of each measure's shot.
    images : k names
        Image of each measure.
    measures : (k, 2)
        pixels, line and sample.
    noise : NoiseSettings
        Sigmas.
    """
    n = len(ids)
    return LaserProfile(
        source=source,
        ids=ids,
        times=times,
        ranges=ranges,
        range_sigmas=np.full(n, noise.range),
        footprints=footprints,
        covariances=np.broadcast_to(noise.ground**2 * np.eye(3), (n, 3, 3)),
        simultaneous=simultaneous,
        measure_shot=shot,
        measure_image=images,
        measures=measures,
    )
