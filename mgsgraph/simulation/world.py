"""What the world does that no adjustment is told of, or that it knows by a sigma alone: beams that point elsewhere than
their attitude says, shifts of profiles that grow along the track, pulses that slopes make broad, terrain models between
whose tracks nothing was measured, orbits that are wrong alike, cameras that vibrate, and matches that err together.

Each can be switched on by itself (`World`), is drawn from a stream of its own, so that nothing else changes with it,
and is told with the truth. What an adjustment can know of it, by a sigma, its case states (`case_files`); of
vibrations it is told nothing.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Literal, get_args

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.record import Record
from mgsgraph.simulation.orbit import quaternions
from mgsgraph.units import MRAD

Effect = Literal["beam", "drift", "pulse", "tracks", "orbit", "jitter", "matching"]
EFFECTS: tuple[Effect, ...] = get_args(Effect)
"""What can be switched on."""
STRIP_EFFECTS: tuple[Effect, ...] = ("orbit", "jitter", "matching")
"""Those that a strip has: its shots are taken by nadir images, and it has no terrain model."""
BLOCK_EFFECTS: tuple[Effect, ...] = ("tracks", "jitter", "matching")
"""Those that a block of HRSC strips has: no laser, and orbits of its own prior."""
JITTER_PERIODS = (0.5, 5.0)
"""s, shortest and longest period of a vibration."""
_WAVES = 200
"""Of which a random function consists."""
_SAMPLES_PER_PERIOD = 16
"""Attitudes in a period of a vibration: interpolation between them then follows a sine to 0.5 %."""


@dataclass(frozen=True, slots=True)
class World(Record):
    """Sizes of what the world does; 0: it doesn't."""

    beam: float = 0.0
    """rad, sigma of a profile's common pointing error about the axes x and y of the camera beside it."""
    drift: float = 0.0
    """m, sigma of how much a profile's shift grows from its middle to its end, east and north."""
    pulse: float = 0.0
    """Sigma of a range's further error, in standard deviations of the ranges within its spot: of pulses that slopes and
    roughness make broad. The shot's footprint, which comes from its range, has the same error."""
    tracks: float = 0.0
    """m, mean distance between the tracks of a terrain model; posts between them are interpolated."""
    orbit: float = 0.0
    """m, sigma of a position error that all images have in common, radial, along and across the flight."""
    jitter: float = 0.0
    """Pixels, amplitude in line and in sample of each image's vibration; its period and phases are drawn."""
    matching: float = 0.0
    """Share of the variance of tie points' measures that measures within `window` have in common."""
    window: float = 60.0
    """Pixels, distance in an image at which matching errors are correlated by 1/e."""

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            require(0.0 <= value < np.inf, f"simulated world, {name}", f"{value}", "zero or a positive number")
        require(self.matching < 1.0, "simulated world, matching", f"{self.matching}", "a share below 1")
        require(self.window > 0.0, "simulated world, window", f"{self.window} px", "a positive number")

    @classmethod
    def of(cls, effects: Sequence[str]) -> "World":
        """The world with some effects, each of its usual size.

        Raises
        ------
        InputError
            For an effect that there is none of.
        """
        for name in effects:
            if name not in EFFECTS:
                raise InputError("simulated world", repr(name), f"some of {', '.join(EFFECTS)}")
        return replace(cls(), **{name: _USUAL[name] for name in effects})

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Those that are switched on."""
        return tuple(name for name in EFFECTS if getattr(self, name) > 0.0)

    def stream(self, effect: Effect, *seed: int) -> np.random.Generator:
        """Where an effect is drawn from, by the seed of what is simulated."""
        return np.random.default_rng([*seed, 71, EFFECTS.index(effect)])


_USUAL: dict[str, float] = {
    "beam": 0.25 * MRAD, "drift": 30.0, "pulse": 0.1, "tracks": 2000.0, "orbit": 100.0, "jitter": 1.5, "matching": 0.7,
}  # fmt: skip


# --- vibrations


@dataclass(frozen=True, slots=True)
class Vibration(Record):
    """A camera's sinusoidal vibration."""

    period: float
    """s."""
    amplitudes: tuple[float, float]
    """rad, about the camera's axes y (pitch: lines) and x (roll: samples)."""
    phases: tuple[float, float]
    """rad, at the trajectory's epoch."""

    def pixels(self, image: PushbroomImage, lines: Array) -> Array:
        """(n, 2) lines and samples by which points at lines (n,) of an image appear elsewhere, to first order."""
        times = image.timing.at(lines)[0]
        wave = np.sin(2.0 * np.pi * times[:, None] / self.period + np.array(self.phases))
        return np.asarray(wave * np.array(self.amplitudes) / np.array(pixel_angles(image)))

    def turned(self, times: Array) -> Array:
        """(n, 3) rad about the camera's axes at times (n,), s past the epoch."""
        wave = 2.0 * np.pi * times[:, None] / self.period + np.array(self.phases)
        pitch, roll = (np.array(self.amplitudes) * np.sin(wave)).T
        return np.column_stack([roll, pitch, np.zeros(times.size)])


def drawn_vibration(world: World, image: PushbroomImage, rng: np.random.Generator) -> Vibration:
    """A vibration of an image, of the world's amplitude in pixels: its period and its phases are drawn."""
    period = drawn_period(rng)
    first, second = rng.uniform(0.0, 2.0 * np.pi, 2).tolist()
    by_line, by_sample = (world.jitter * angle for angle in pixel_angles(image))
    return Vibration(period, (by_line, by_sample), (first, second))


def drawn_period(rng: np.random.Generator) -> float:
    """S, of a vibration: all octaves between the shortest and the longest are alike."""
    return float(np.exp(rng.uniform(*np.log(JITTER_PERIODS))))


def vibrating(image: PushbroomImage, vibration: Vibration) -> PushbroomImage:
    """The image as a camera that vibrates takes it; InputError where its orientation isn't sampled."""
    steady = image.trajectory
    if not isinstance(steady, Trajectory):
        raise InputError(f"image {image.name}", "an orientation that isn't sampled", "tables of position and attitude")
    table = steady.camera
    step = vibration.period / _SAMPLES_PER_PERIOD
    times = np.linspace(table.times[0], table.times[-1], int(np.ceil((table.times[-1] - table.times[0]) / step)) + 1)
    turned = rotation.exponential(-vibration.turned(times)) @ table.at(times)[0]
    camera = replace(table, times=times, quaternions=quaternions(table.constant.T @ turned))
    return replace(image, trajectory=replace(steady, camera=camera))


def pixel_angles(image: PushbroomImage) -> tuple[float, float]:
    """Angles in rad by which the middle of an image looks elsewhere one line on, and one sample beside."""
    line, sample = np.array([0.5 * image.lines]), np.array([0.5 * image.samples])
    place, below = (image.image_to_ground(line + step, sample)[0][0] for step in (0.0, 1.0))
    rays = np.concatenate([image.sightlines(line, sample + step)[1] for step in (0.0, 1.0)])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    away = np.linalg.norm(place - image.pose(line).position[0])
    return float(np.linalg.norm(below - place) / away), float(np.linalg.norm(np.cross(*rays)))


# --- matches that err together


def common_errors(world: World, errors: Array, image: Index, places: Array, rng: np.random.Generator) -> Array:
    """Errors (k, 2) of measures of which the world's share of the variance is common to those within its window.

    Parameters
    ----------
    errors : (k, 2)
        Pixels, independent, of the measures' sigmas.
    image : (k,)
        In which they are.
    places : (k, 2)
        Lines and samples there.
    """
    scale = np.sqrt(np.mean(errors**2))
    common = np.empty_like(errors)
    for j in np.unique(image):
        mine = image == j
        common[mine] = scale * _smooth(places[mine], world.window, rng)
    return np.asarray(np.sqrt(1.0 - world.matching) * errors + np.sqrt(world.matching) * common)


def _smooth(places: Array, window: float, rng: np.random.Generator) -> Array:
    """(n, 2) values at places (n, 2) of two random functions of unit variance, whose correlation falls as a Gaussian
    to 1/e at a window's distance: sums of waves (Rahimi & Recht 2007).
    """
    values = np.empty_like(places)
    for column in range(2):
        waves = rng.standard_normal((_WAVES, 2)) * np.sqrt(2.0) / window
        phases = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
        values[:, column] = np.sqrt(2.0 / _WAVES) * np.cos(places @ waves.T + phases).sum(axis=1)
    return values


# --- terrain models between tracks


def of_tracks(radii: Array, sides: tuple[float, float], apart: float, rng: np.random.Generator) -> tuple[Array, Mask]:
    """A terrain model's radii (rows, columns) as those make it that are on tracks, and which are.

    Tracks run along the columns, as a polar orbit's do, at a slope of one in twenty, northward and southward ones in
    turn, at random places a mean of `apart` metres from one another; between them rows are interpolated linearly, and
    at the model's ends they go on level.

    Parameters
    ----------
    radii : (rows, columns)
        m, as if each post were measured.
    sides : (2,)
        m between rows and between columns.
    """
    rows, columns = radii.shape
    reach = _SLOPE * rows * sides[0]
    count = max(2, round((columns * sides[1] + reach) / apart))
    places = rng.uniform(-0.5 * reach, columns * sides[1] + 0.5 * reach, count)
    slopes = np.where(np.arange(count) % 2 == 0, _SLOPE, -_SLOPE)
    down = sides[0] * (np.arange(rows) - 0.5 * rows)
    crossed = np.floor((places[None] + slopes[None] * down[:, None]) / sides[1]).astype(np.int64)
    measured = np.zeros(radii.shape, dtype=np.bool_)
    row, track = np.nonzero((crossed >= 0) & (crossed < columns))
    measured[row, crossed[row, track]] = True
    filled = np.array([
        np.interp(np.arange(columns), np.flatnonzero(mine), values[mine]) if mine.any() else np.full(columns, np.nan)
        for values, mine in zip(radii, measured, strict=True)
    ])  # fmt: skip
    return filled, measured


_SLOPE = 0.05
"""Of tracks against the meridian: those of an orbit of 92.9 degrees near the equator."""
