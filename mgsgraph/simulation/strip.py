"""A strip of overlapping stereo pairs along one ground track, image after image: what a growing campaign is given.

Pair after pair lies further along the track, nadir image first, then one that looks aside from another orbit: image 0
is nadir, 1 looks aside, 2 is nadir again. Two images of one track overlap, so every one is taken on another repeat of
the orbit, sols apart, with tables and a correction of its own. TRUE orientation = nominal (+) a correction drawn from
the prior; observations are true values plus noise of the stated sigmas, so an adjustment has honest statistics.

Step k adds image k to images 0 .. k - 1. It brings new tie points, at random on ground that image k shares with
any earlier one, with their measures in all of these; measures in image k of points known before; and from a nadir image
its laser shots. What is drawn for a step knows nothing of later ones: a shorter strip is the longer one's beginning.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.files.tie_points import TiePoints
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.record import Record
from mgsgraph.simulation.camera import narrow_image
from mgsgraph.simulation.mars import MARS
from mgsgraph.simulation.observations import require_count, require_seed
from mgsgraph.simulation.orbit import HEADING, CircularPass, ground_track, site_at
from mgsgraph.simulation.pair import PairSettings
from mgsgraph.simulation.strip_steps import Step, Steps, merged_profiles, merged_ties
from mgsgraph.units import DEG, KM

MOST = 500
"""Images of a strip."""

_FIRST = -11_000_000.0
"""s TDB past J2000, middle of image 0; whole numbers, so that table times are exact in files."""
_SOL, _LATER = 88_775.0, 1_240_988.0
"""s from one nadir image to the next, about a sol, and from a pair's first image to its second, about 14 of them."""
_START = (90.5 * DEG, -24.0 * DEG)
"""rad, longitude and planetocentric latitude of the first pair; 250 default pairs pass Isidis and end at 31 deg."""
_LONGEST = 100.0 * DEG
"""rad, arc of a strip: further on the track turns back at the pole."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StripSettings(PairSettings):
    """What strip to simulate: pairs with these settings, one after the other; shots are those of each nadir image."""

    images: int = 40
    """Number of images, 2 to 500; an odd number leaves the last nadir image without its partner."""
    ties: int = 2000
    """Number of new tie points that each image after the first brings."""
    overlap: float = 0.4
    """Share of its length that a nadir image has in common with the next one of its track, 0.05 to 0.9."""

    def __post_init__(self) -> None:
        PairSettings.__post_init__(self)
        require_count("strip settings, images", self.images, 2)
        require(self.images <= MOST, "strip settings, images", f"{self.images}", f"2 .. {MOST}")
        expected = "a share of the length, 0.05 .. 0.9"
        require(0.05 <= self.overlap <= 0.9, "strip settings, overlap", f"{self.overlap}", expected)

    @property
    def pairs(self) -> int:
        """Number of nadir images."""
        return (self.images + 1) // 2

    @property
    def interval(self) -> float:
        """Flight time in s between the middles of two images that follow each other on a track."""
        return (1.0 - self.overlap) * self.lines * self.period


class StripAddition(NamedTuple):
    """What an archive gains with one image."""

    image: PushbroomImage
    """The new image, nominal."""
    ties: TiePoints
    """New points with all their measures, and known points with their measure in the new image; no points at first."""
    laser: LaserProfile | None
    """The new image's shots; and known shots that it sees, named again as they were, but simultaneous with no image, so
    that their ranges don't count twice. None where there are neither."""

    def __repr__(self) -> str:
        return f"StripAddition({self.image.name}; {self.ties!r}; {self.laser!r})"


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedStrip(Record):
    """A simulated strip: what an adjustment is given, and the truth it should find."""

    settings: StripSettings
    """As simulated; `upto` keeps those of the whole."""
    seed: int
    """Seed of the random generator."""
    steps: tuple[Step, ...]
    """What each image brought."""
    ties: TiePoints
    """All tie points, free, measured in every image of the strip that shows them."""
    true_ties: Array
    """(n, 3) m, body-fixed, in the order of `ties.ids`."""
    lasers: tuple[LaserProfile, ...]
    """One for each nadir image, its shots measured in every image that shows them."""
    true_footprints: tuple[Array, ...]
    """(m, 3) m, body-fixed, for each of these, in the order of its ids."""

    def __post_init__(self) -> None:
        assign(self, true_ties=frozen(self.true_ties, "simulated strip, true ties", (len(self.ties.ids), 3)))

    @property
    def images(self) -> tuple[PushbroomImage, ...]:
        """Nominal: nadir, aside, nadir, aside ... along the strip."""
        return tuple(step.image for step in self.steps)

    @property
    def true_corrections(self) -> tuple[OrientationCorrection, ...]:
        """One per image: true orientation = nominal (+) correction."""
        return tuple(step.true for step in self.steps)

    def addition(self, k: int) -> StripAddition:
        """What becomes possible when image `k` is added to images 0 .. k - 1; together these are the whole strip."""
        require(0 <= k < len(self.steps), "simulated strip, addition", f"image {k}", f"0 .. {len(self.steps) - 1}")
        step = self.steps[k]
        return StripAddition(step.image, step.ties, step.laser)

    def upto(self, count: int) -> "SimulatedStrip":
        """The strip as it was when only the first `count` images had been taken."""
        many = len(self.steps)
        require(1 <= count <= many, "simulated strip, upto", f"{count} images", f"1 .. {many}")
        return _of_steps(self.settings, self.seed, self.steps[:count])

    def __repr__(self) -> str:
        shots = sum(len(laser.ids) for laser in self.lasers)
        return f"SimulatedStrip({len(self.steps)} images; {self.ties!r}; {shots} laser shots; seed {self.seed})"


def simulate_strip(settings: StripSettings | None = None, seed: int = 1) -> SimulatedStrip:
    """Simulate a strip; the same settings and seed give the same strip, and fewer images give its beginning.

    Parameters
    ----------
    settings : StripSettings, optional
        The default strip when absent.
    seed : int
        zero or positive; each image has streams of its own for orientation, ties and shots.

    Raises
    ------
    InputError
        Where images do not share enough ground for the ties asked for, or the strip would reach the pole.

    Examples
    --------
    >>> from mgsgraph.simulation.strip import StripSettings, simulate_strip
    >>> strip = simulate_strip(StripSettings(images=3, ties=10), seed=1)
    >>> [image.name for image in strip.images]
    ['STRIP/000N', 'STRIP/001X', 'STRIP/002N']
    """
    settings = settings or StripSettings()
    require_seed("simulated strip", seed)
    steps = Steps(settings.ties, settings.shots, settings.relief, settings.noise)
    streams = np.random.default_rng(seed).spawn(settings.images)
    for image, rng in zip(_images(settings), streams, strict=True):
        steps.add(image, rng)
    return _of_steps(settings, seed, tuple(steps.taken))


def _of_steps(settings: StripSettings, seed: int, steps: tuple[Step, ...]) -> SimulatedStrip:
    lasers = merged_profiles([step.laser for step in steps if step.laser])
    return SimulatedStrip(
        settings,
        seed,
        steps,
        merged_ties([step.ties for step in steps]),
        np.concatenate([step.true_ties for step in steps]),
        lasers,
        tuple(step.true_footprints for step in steps if step.true_footprints.size),
    )


def _images(settings: StripSettings) -> list[PushbroomImage]:
    """Nominal images, nadir and aside by turns, whose middles follow one ground track."""
    first = CircularPass(_FIRST, site_at(*_START), HEADING / np.cos(_START[1]), settings.altitude)
    since: Array = settings.interval * np.arange(settings.pairs, dtype=np.float64)
    sites, headings = ground_track(first, since)
    length = float(np.linalg.norm(np.diff(sites, axis=0), axis=1).sum())
    longest = _LONGEST * MARS.equatorial
    if length > longest:
        raise InputError(
            "strip settings, images", f"a strip of {length / KM:.0f} km, which turns back at the pole",
            f"at most {longest / KM:.0f} km", "take fewer or shorter images, or more overlap",
        )
    images = []
    for k in range(settings.images):
        pair, aside = divmod(k, 2)
        epoch = _FIRST + _SOL * pair + _LATER * aside
        off_nadir = settings.off_nadir if aside else 0.0
        flown = CircularPass(epoch, sites[pair], float(headings[pair]), settings.altitude, off_nadir)
        name = f"STRIP/{k:03d}{'NX'[aside]}"
        images.append(narrow_image(name, flown, settings.lines, settings.samples, settings.period))
    return images
