"""A stereo pair over Isidis Planitia with laser ranges: a nadir image, and a held off-nadir one from another orbit.

The orbit is a circle at MGS's mapping altitude, the camera is like MOC-NA without distortion. The nadir image turns
with the orbit, the off-nadir one is held in inertial space, as MGS did it. The TRUE orientation is the nominal
trajectory (+) a correction drawn from the stated prior; every observation is the true value plus noise drawn from the
stated sigma, so that an adjustment with these sigmas has consistent statistics.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from mgsgraph.errors import require
from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.record import Record
from mgsgraph.simulation.camera import InstrumentErrors, as_taken, displaced_footprints, narrow_image
from mgsgraph.simulation.ground import CENTRE, rays_to_sines
from mgsgraph.simulation.observations import (
    MARGIN,
    NoiseSettings,
    profile,
    project,
    require_count,
    require_positive,
    require_seed,
    shared_ties,
    shots_along,
)
from mgsgraph.simulation.orbit import HEADING, CircularPass, site_at
from mgsgraph.units import DEG

SOURCE = "simulated pair"
"""What messages call observations that were not read from a file."""

_EPOCHS = (-11_000_000.0, -9_759_012.0)
"""s TDB past J2000 of the images' middles, 14 sols apart; whole numbers, so that table times are exact in files."""
_NO_OVERLAP = "take longer images, a smaller off_nadir or smaller position and angle sigmas"


@dataclass(frozen=True, slots=True, kw_only=True)
class PairSettings(Record):
    """What pair to simulate.

    Examples
    --------
    >>> from mgsgraph.simulation import PairSettings
    >>> settings = PairSettings(lines=3000, off_nadir=np.radians(15.0), ties=40)
    >>> settings.lines, settings.samples
    (3000, 1024)
    """

    lines: int = 5000
    """Lines of each image."""
    samples: int = 1024
    """Samples of each image."""
    period: float = 1.446e-3
    """s per line."""
    altitude: float = 380e3
    """m, of the orbit above the ellipsoid at the site."""
    off_nadir: float = 20.0 * DEG
    """rad, angle at the spacecraft of the second image's optical axis from nadir, across track."""
    relief: float = 100.0
    """m, amplitude of the largest of three sines."""
    ties: int = 150
    """Number of tie points."""
    shots: int = 60
    """Number of laser shots."""
    noise: NoiseSettings = field(default_factory=NoiseSettings)
    """Sigmas."""

    def __post_init__(self) -> None:
        where = type(self).__name__.removesuffix("Settings").lower() + " settings"
        for name, least in (("lines", 8 * MARGIN), ("samples", 8 * MARGIN), ("ties", 1), ("shots", 1)):
            require_count(f"{where}, {name}", getattr(self, name), least)
        for name in ("period", "altitude", "off_nadir"):
            require_positive(f"{where}, {name}", getattr(self, name))
        require(0.0 <= self.relief < np.inf, f"{where}, relief", f"{self.relief} m", "zero or a positive number")


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedPair(Record):
    """A simulated stereo pair: what an adjustment is given, and the truth it should find.

    Examples
    --------
    >>> pair.images[0].name, len(pair.ties.ids), len(pair.laser.ids)
    ('SIM/A', 20, 8)
    >>> off = solution.places[:20] - pair.true_ties
    >>> np.sqrt(np.mean(off**2, axis=0)).round(0)
    array([ 3., 11.,  6.])
    """

    settings: PairSettings
    """What was asked for."""
    seed: int
    """Seed of the random generator."""
    images: tuple[PushbroomImage, ...]
    """Nominal, nadir one first."""
    true_corrections: tuple[OrientationCorrection, ...]
    """One per image: true orientation = nominal (+) correction."""
    ties: TiePoints
    """Tie points, all free, each measured in both images."""
    true_ties: Array
    """(n, 3) m, body-fixed, in the order of `ties.ids`."""
    laser: LaserProfile
    """Laser shots taken from the first image's spacecraft, measured in both images."""
    true_footprints: Array
    """(m, 3) m, body-fixed, in the order of `laser.ids`."""

    def __repr__(self) -> str:
        names = ", ".join(image.name for image in self.images)
        return f"SimulatedPair({names}; {self.ties!r}; {self.laser!r}; seed {self.seed})"


def simulate_pair(
    settings: PairSettings | None = None, seed: int = 1, errors: InstrumentErrors | None = None
) -> SimulatedPair:
    """Simulate a stereo pair with laser ranges; the same settings and seed give the same pair.

    Parameters
    ----------
    settings : PairSettings, optional
        The default pair when absent.
    seed : int
        zero or positive; orientation, ties and shots are drawn from streams of their own.
    errors : InstrumentErrors, optional
        Errors of camera and altimeter, the same in both images; the images stay nominal. None when absent.

    Raises
    ------
    InputError
        Where the images do not share enough ground for the ties and shots asked for.

    Examples
    --------
    >>> from mgsgraph.simulation import PairSettings, simulate_pair
    >>> print(simulate_pair(PairSettings(ties=5, shots=3), seed=2))
    SimulatedPair(SIM/A, SIM/B; TiePoints(5 points (5 free), 10 measures, from simulated pair); LaserProfile(3
    shots, 6 image measures, from simulated pair); seed 2)
    """
    settings = settings or PairSettings()
    require_seed("simulated pair", seed)
    of_orientation, of_ties, of_shots = np.random.default_rng(seed).spawn(3)
    images = tuple(
        narrow_image(
            name,
            CircularPass(epoch, site_at(*CENTRE), HEADING, settings.altitude, off_nadir),
            settings.lines,
            settings.samples,
            settings.period,
        )
        for name, epoch, off_nadir in (("SIM/A", _EPOCHS[0], 0.0), ("SIM/B", _EPOCHS[1], settings.off_nadir))
    )
    true = tuple(settings.noise.correction(of_orientation) for _ in images)
    errors = errors or InstrumentErrors()
    nominal = tuple(as_taken(image, errors) for image in images)
    size, number = np.array([settings.lines, settings.samples]), settings.ties
    drawn = of_ties.uniform(MARGIN, size - MARGIN, (4 * number, 2))
    points = rays_to_sines(nominal[0], true[0], drawn[:, 0], drawn[:, 1], settings.relief)
    ties, true_ties = shared_ties(SOURCE, nominal, true, points, number, settings.noise.tie, of_ties, _NO_OVERLAP)
    laser, footprints = _laser_profile(nominal, true, settings, errors, of_shots)
    return SimulatedPair(settings, seed, images, true, ties, true_ties, laser, footprints)


def _laser_profile(
    images: tuple[PushbroomImage, ...],
    corrections: tuple[OrientationCorrection, ...],
    settings: PairSettings,
    errors: InstrumentErrors,
    rng: np.random.Generator,
) -> tuple[LaserProfile, Array]:
    """Shots along the first image's optical axis, evenly spaced in time, and their true footprints (n, 3) in m."""
    noise, n, k = settings.noise, settings.shots, settings.shots * len(images)
    shots = shots_along(images[0], corrections[0], n, settings.relief)
    pixels, visible = project(images, corrections, shots.points)
    require(np.all(visible), SOURCE, f"images that share {visible.sum()} of {n} laser footprints", remedy=_NO_OVERLAP)
    points = shots.points
    if np.any(errors.altimeter_boresight):
        points = displaced_footprints(images[0], shots.times - images[0].trajectory.epoch, points, errors)
    laser = profile(
        SOURCE,
        tuple(f"SHOT{i + 1:05d}" for i in range(n)),
        replace(shots, points=points, ranges=shots.ranges + errors.range_bias).noisy(noise, rng),
        np.arange(n),
        images[0].name,
        np.repeat(np.arange(n), len(images)),
        tuple(image.name for image in images) * n,
        pixels.reshape(k, 2) + noise.shot_image * rng.standard_normal((k, 2)),
        noise,
    )
    return laser, shots.points
