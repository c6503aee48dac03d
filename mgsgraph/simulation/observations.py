"""Simulated observations: the sigmas they are drawn from, tie points, laser shots, who shows which point where, and
images as they were truly taken (`true_image`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection, OrientationPrior
from mgsgraph.geometry.records import Array, Index, Mask, joined_rows
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.record import Record
from mgsgraph.simulation.ground import rays_to_sines

MARGIN = 30.0
"""pixels which true image points keep from the edges: six default sigmas of a footprint's measure."""


@dataclass(frozen=True, slots=True)
class NoiseSettings(Record):
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
        require(self.trend, "noise settings, trend", "no factors", "one for each power of u")
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
    require(0.0 < value < np.inf, where, f"{value}", "a positive number")


def require_count(where: str, value: int, least: float) -> None:
    """Raise InputError unless a value is a whole number, not below `least`."""
    whole = isinstance(value, int) and not isinstance(value, bool)
    require(whole and value >= least, where, f"{value}", f"a whole number, at least {least:.0f}")


def require_seed(where: str, seed: int) -> None:
    """Raise InputError for a seed below zero."""
    require(seed >= 0, f"{where}, seed", f"{seed}", "zero or a positive whole number")


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
        point, image = (joined_rows(rows) for rows in (self.point, self.image))
        order = np.lexsort([image, point])
        return point[order], image[order], np.concatenate([np.zeros((0, 2)), *self.pixels])[order]


def free_points(
    source: str, ids: tuple[str, ...], point: Index, images: tuple[str, ...], measures: Array, sigma: Array | float
) -> TiePoints:
    """Tie points without a-priori coordinates: n points by name, and k measures of point (k,) in images (k names) at
    lines and samples (k, 2), with one sigma in pixels or with sigmas (k, 2).
    """
    n, k = len(ids), len(images)
    return TiePoints(
        source=source,
        ids=Names.of(ids),
        kinds=np.full(n, PointKind.FREE, dtype=np.int64),
        places=np.full((n, 3), np.nan),
        covariances=np.zeros((n, 3, 3)),
        measure_point=point,
        measure_image=RepeatedNames.of(images),
        measures=measures,
        measure_sigmas=np.broadcast_to(sigma, (k, 2)),
    )


def project(
    images: Sequence[PushbroomImage], corrections: Sequence[OrientationCorrection | None], points: Array
) -> tuple[Array, Mask]:
    """Line and sample (n, images, 2) of points (n, 3) in m in each image with its true orientation, nominal (+)
    correction; and which points (n,) all images show well inside their edges.
    """
    pixels = [image.ground_to_image(points, true)[0] for image, true in zip(images, corrections, strict=True)]
    inside = [well_inside(image, each) for image, each in zip(images, pixels, strict=True)]
    return np.stack(pixels, axis=1), np.all(inside, axis=0)


def shared_ties(
    source: str,
    images: Sequence[PushbroomImage],
    corrections: Sequence[OrientationCorrection | None],
    points: Array,
    count: int,
    sigma: float,
    rng: np.random.Generator,
    remedy: str = "",
) -> tuple[TiePoints, Array]:
    """Tie points at the first `count` of points (n, 3) in m that all images show, measured in all of them with noise of
    `sigma` pixels; and these points (count, 3). InputError with the remedy where there are not so many.
    """
    pixels, visible = project(images, corrections, points)
    chosen = np.flatnonzero(visible)[:count]
    if chosen.size < count:
        raise InputError(source, f"images that share ground for {chosen.size} of {count} tie points", remedy=remedy)
    exact = pixels[chosen].reshape(-1, 2)
    ties = free_points(
        source,
        tuple(f"TIE{i + 1:05d}" for i in range(count)),
        np.repeat(np.arange(count), len(images)),
        tuple(image.name for image in images) * count,
        exact + sigma * rng.standard_normal(exact.shape),
        sigma,
    )
    return ties, points[chosen]


@dataclass(frozen=True, slots=True, eq=False)
class Shots:
    """Laser shots along an image's optical axis."""

    times: Array
    """(n,) s TDB past J2000."""
    points: Array
    """(n, 3) m, body-fixed, where they meet the ground."""
    ranges: Array
    """(n,) m."""

    def noisy(self, noise: NoiseSettings, rng: np.random.Generator) -> "Shots":
        """As measured: ranges and points with noise."""
        ranges = self.ranges + noise.range * rng.standard_normal(self.ranges.size)
        return Shots(self.times, self.points + noise.ground * rng.standard_normal(self.points.shape), ranges)


def shots_along(image: PushbroomImage, true: OrientationCorrection, number: int, relief: float) -> Shots:
    """Shots from the spacecraft of an image, evenly spaced in time, without noise."""
    epoch = image.trajectory.epoch
    elapsed, _ = image.timing.at(np.linspace(2.0 * MARGIN, image.lines - 2.0 * MARGIN, number))
    times = epoch + elapsed
    lines = image.timing.lines(times - epoch)  # of the time as the file can state it
    points = rays_to_sines(image, true, lines, np.full(number, 0.5 * image.samples), relief)
    return Shots(times, points, np.linalg.norm(points - image.pose(lines, true).position, axis=1))


def profile(
    source: str,
    ids: tuple[str, ...],
    given: Shots,
    along: Index,
    image: str,
    shot: Index,
    images: tuple[str, ...],
    measures: Array,
    noise: NoiseSettings,
) -> LaserProfile:
    """Laser shots as an adjustment is given them: n shots by name, those of `along` taken with an image; k measures of
    shot (k,) in images (k names) at lines and samples (k, 2); and the sigmas of the settings.
    """
    n = len(ids)
    return LaserProfile(
        source=source,
        ids=Names.of(ids),
        times=given.times,
        ranges=given.ranges,
        range_sigmas=np.full(n, noise.range),
        footprints=given.points,
        covariances=np.broadcast_to(noise.ground**2 * np.eye(3), (n, 3, 3)),
        simultaneous_shot=along,
        simultaneous_image=RepeatedNames((image,), np.zeros(along.size, dtype=np.int64)),
        measure_shot=shot,
        measure_image=RepeatedNames.of(images),
        measures=measures,
    )


_NODES = (11, 8, 5)
"""Lines, samples and heights of the rays by which the size of an image's ground is known."""
_SLACK = 0.02
"""Share of an image's length by which ground may lie beyond it and still be looked for in it."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueImage:
    """An image as it was truly taken, and where its ground lies."""

    image: PushbroomImage
    """Nominal."""
    true: OrientationCorrection
    """True orientation = nominal (+) this."""
    middle: Array
    """(3,) m, body-fixed, of its ground."""
    axes: Array
    """(2, 3) unit rows, body-fixed: along from the first line to the last, across."""
    half_size: Array
    """(2,) m, half of the ground's size in these directions."""

    def project(self, points: Array) -> tuple[Index, Array]:
        """Which of points (n, 3) in m, body-fixed, it shows well inside its edges, (k,); lines and samples (k, 2)."""
        scaled = (points - self.middle) @ self.axes.T / self.half_size
        near = np.flatnonzero(np.all(np.abs(scaled) < 1.0 + _SLACK, axis=1))
        pixels, _ = self.image.ground_to_image(points[near], self.true)
        inside = well_inside(self.image, pixels)
        return near[inside], pixels[inside]

    def may_overlap(self, other: "TrueImage") -> bool:
        """Whether the two may show the same ground."""
        distance = np.linalg.norm(other.middle - self.middle)
        return bool(distance < (1.0 + _SLACK) * (self.half_size[0] + other.half_size[0]))

    def lines_over(self, other: "TrueImage") -> tuple[float, float]:
        """The lines between which it may show ground of another image; they may lie outside."""
        ends = other.middle + np.outer([-1.0 - _SLACK, 1.0 + _SLACK], other.half_size[0] * other.axes[0])
        lines = 0.5 * self.image.lines * (1.0 + (ends - self.middle) @ self.axes[0] / self.half_size[0])
        return float(lines.min()), float(lines.max())


def true_image(image: PushbroomImage, true: OrientationCorrection, relief: float) -> TrueImage:
    """An image as truly taken over ground whose heights stay within 2 `relief` (m) of the ellipsoid."""
    size = np.array([image.lines, image.samples])
    (first, middle, last), _ = image.image_to_ground(
        np.array([0.0, 0.5, 1.0]) * size[0], np.full(3, 0.5 * size[1]), 0.0, true
    )
    along, up = (last - first) / np.linalg.norm(last - first), middle / np.linalg.norm(middle)
    axes = np.stack([along, np.cross(up, along) / np.linalg.norm(np.cross(up, along))])
    spread = [np.cos(np.pi * (np.arange(n) + 0.5) / n) for n in _NODES]
    lines, samples, heights = (grid.ravel() for grid in np.meshgrid(*spread, indexing="ij"))
    pixels = 0.5 * np.column_stack([(lines + 1.0) * image.lines, (samples + 1.0) * image.samples])
    points, _ = image.image_to_ground(pixels[:, 0], pixels[:, 1], (2.0 * relief + 1.0) * heights, true)
    return TrueImage(image, true, middle, axes, np.abs((points - middle) @ axes.T).max(axis=0))
