"""A strip of overlapping stereo pairs along one ground track, image after image: what a growing campaign is given.

Pair after pair lies further along the track, nadir image first, then one that looks aside from another orbit: image 0
is nadir, 1 looks aside, 2 is nadir again. Two images of one track overlap, so every one is taken on another repeat of
the orbit, sols apart, with tables and a correction of its own. TRUE orientation = nominal (+) a correction drawn from
the prior; observations are true values plus noise of the stated sigmas, so an adjustment has consistent statistics.

Step k adds image k to images 0 .. k - 1. It brings new tie points, at random on ground that image k shares with
any earlier one, with their measures in all of these; measures in image k of points known before; and from a nadir image
its laser shots. What is drawn for a step knows nothing of later ones: a shorter strip is the longer one's beginning.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mgsgraph.case.assembly import merged
from mgsgraph.errors import InputError, require
from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.record import Record
from mgsgraph.simulation.camera import narrow_image
from mgsgraph.simulation.ground import on_sines
from mgsgraph.simulation.observations import (
    MARGIN,
    NoiseSettings,
    Shots,
    TrueImage,
    Visible,
    free_points,
    profile,
    require_count,
    require_seed,
    shots_along,
    true_image,
)
from mgsgraph.simulation.orbit import HEADING, MARS, CircularPass, ground_track, site_at
from mgsgraph.simulation.pair import PairSettings
from mgsgraph.units import DEG, KM

SOURCE = "simulated strip"
"""What messages call observations that were not read from a file."""

_DRAWS = 12
"""Rounds of drawing before an image counts as sharing no ground."""
_NO_OVERLAP = "take longer images, more overlap, a smaller off_nadir or smaller position and angle sigmas"


@dataclass(frozen=True, slots=True, eq=False)
class Step(Record):
    """An image, as taken and as known, and what it brings."""

    image: PushbroomImage
    """Nominal."""
    true: OrientationCorrection
    """True orientation = nominal (+) this."""
    ties: TiePoints
    """New points with all their measures, and measures in this image of known ones."""
    true_ties: Array
    """(n, 3) m, body-fixed, of the new points."""
    laser: LaserProfile | None
    """New shots with all their measures, and measures in this image of known ones."""
    true_footprints: Array
    """(m, 3) m, body-fixed, of the new shots."""


@dataclass(slots=True, eq=False)
class Steps:
    """A strip while it grows."""

    ties: int
    """New tie points of each image after the first."""
    shots: int
    """Laser shots of each nadir image; every second image is one."""
    relief: float
    """m, amplitude of the ground's largest sine."""
    noise: NoiseSettings
    """Sigmas."""
    taken: list[Step] = field(default_factory=list)
    """Steps so far."""
    _images: list[TrueImage] = field(default_factory=list)
    _shots: list[Shots] = field(default_factory=list)
    """As given, of each nadir image."""

    def add(self, image: PushbroomImage, rng: np.random.Generator) -> None:
        """Take the next image of the strip."""
        of_orientation, of_ties, of_shots = rng.spawn(3)
        true = self.noise.correction(of_orientation)
        new = true_image(image, true, self.relief)
        neighbours = [j for j, other in enumerate(self._images) if new.may_overlap(other)]
        self._images.append(new)
        ties, true_ties = self._tie_points(neighbours, of_ties)
        laser, true_footprints = self._laser_shots(neighbours, of_shots)
        self.taken.append(Step(image, true, ties, true_ties, laser, true_footprints))

    def _tie_points(self, neighbours: list[int], rng: np.random.Generator) -> tuple[TiePoints, Array]:
        """Ties of the last image, and the true points (n, 3) in m of the new ones among them."""
        k = len(self._images) - 1
        visible, points = Visible(), np.zeros((0, 3))
        shared = list(range(max(min(neighbours, default=0), 1), k))
        if shared:
            shown, pixels = self._images[k].project(np.concatenate([self.taken[i].true_ties for i in shared]))
            visible.add(shown + (shared[0] - 1) * self.ties, k, pixels)
        if k > 0:
            points = self._new_points(neighbours, visible, rng)
        point, image, pixels = visible.ordered()
        numbers, local = np.unique(point, return_inverse=True)
        ties = free_points(
            SOURCE,
            tuple(f"T{i // self.ties + 1:03d}-{i % self.ties + 1:05d}" for i in numbers.tolist()),
            local,
            self._names(image),
            pixels + self.noise.tie * rng.standard_normal(pixels.shape),
            self.noise.tie,
        )
        return ties, points

    def _new_points(self, neighbours: list[int], visible: Visible, rng: np.random.Generator) -> Array:
        """True points (ties, 3) in m of new ties of the last image, at random where an earlier one sees them, too."""
        k, wanted = len(self._images) - 1, self.ties
        new = self._images[k]
        if not neighbours:
            raise _unshared(new.image, 0, wanted)
        first, last = self._shared_lines(neighbours)
        parts, offset = list[Array](), (k - 1) * wanted
        placed = 0
        for _ in range(_DRAWS):
            count = int(1.15 * (wanted - placed)) + 20
            drawn = rng.uniform([first, MARGIN], [last, new.image.samples - MARGIN], (count, 2))
            level, _ = new.image.image_to_ground(drawn[:, 0], drawn[:, 1], 0.0, new.true)
            points = on_sines(level, self.relief)
            projected = [(j, *self._images[j].project(points)) for j in [*neighbours, k]]
            rays = np.bincount(np.concatenate([shown for _, shown, _ in projected]), minlength=count)
            shared = np.intersect1d(np.flatnonzero(rays > 1), projected[-1][1])[: wanted - placed]
            number = np.full(count, -1)
            number[shared] = np.arange(shared.size) + offset + placed
            for j, shown, pixels in projected:
                is_new = number[shown] >= 0
                visible.add(number[shown[is_new]], j, pixels[is_new])
            parts.append(points[shared])
            placed += shared.size
            if placed == wanted:
                return np.concatenate(parts)
        raise _unshared(new.image, placed, wanted)

    def _shared_lines(self, neighbours: list[int]) -> tuple[float, float]:
        """First and last line of the last image between which ground is worth a draw."""
        new = self._images[-1]
        spans = [new.lines_over(self._images[j]) for j in neighbours]
        least, most = MARGIN, new.image.lines - MARGIN
        first, last = (float(np.clip(f([span[i] for span in spans]), least, most)) for i, f in ((0, min), (1, max)))
        return first, last

    def _laser_shots(self, neighbours: list[int], rng: np.random.Generator) -> tuple[LaserProfile | None, Array]:
        """Shots of the last image and those it shows of others, and the true footprints of the new ones."""
        k = len(self._images) - 1
        visible, points = Visible(), np.zeros((0, 3))
        owners = list(range(min(neighbours, default=0) // 2 * 2, k, 2))
        if owners:
            shown, pixels = self._images[k].project(np.concatenate([self.taken[i].true_footprints for i in owners]))
            visible.add(shown + owners[0] // 2 * self.shots, k, pixels)
        if k % 2 == 0:
            points = self._new_shots(neighbours, visible, rng)
        shot, image, pixels = visible.ordered()
        if shot.size == 0:
            return None, points
        numbers, local = np.unique(shot, return_inverse=True)
        own = self._images[k].image.name
        laser = profile(
            SOURCE,
            tuple(f"S{2 * (i // self.shots):03d}-{i % self.shots + 1:04d}" for i in numbers.tolist()),
            self._given(numbers),
            np.flatnonzero(2 * (numbers // self.shots) == k),
            own,
            local,
            self._names(image),
            pixels + self.noise.shot_image * rng.standard_normal(pixels.shape),
            self.noise,
        )
        return laser, points

    def _new_shots(self, neighbours: list[int], visible: Visible, rng: np.random.Generator) -> Array:
        """True footprints (shots, 3) in m of the last image."""
        k, n = len(self._images) - 1, self.shots
        new = self._images[k]
        exact = shots_along(new.image, new.true, n, self.relief)
        for j in [*neighbours, k]:
            shown, pixels = self._images[j].project(exact.points)
            visible.add(shown + k // 2 * n, j, pixels)
        self._shots.append(exact.noisy(self.noise, rng))
        return exact.points

    def _given(self, numbers: Index) -> Shots:
        """Shots by their number, as given."""
        first = int(numbers[0]) // self.shots
        some, local = self._shots[first:], numbers - first * self.shots
        times, points, ranges = (
            np.concatenate([getattr(step, name) for step in some])[local] for name in ("times", "points", "ranges")
        )
        return Shots(times, points, ranges)

    def _names(self, images: Index) -> tuple[str, ...]:
        names = [step.image.name for step in self._images]
        return tuple(names[j] for j in images.tolist())


def _unshared(image: PushbroomImage, found: int, wanted: int) -> InputError:
    ground = f"ground shared with earlier images for {found} of {wanted} tie points"
    return InputError(f"{SOURCE}, image {image.name}", ground, remedy=_NO_OVERLAP)


# --- steps put together


def merged_ties(parts: Sequence[TiePoints]) -> TiePoints:
    """Tie points of several steps together: points in order of appearance, measures by point."""
    ties = merged(parts)
    return ties.with_measures(np.argsort(ties.measure_point, kind="stable"))


def merged_profiles(parts: Sequence[LaserProfile]) -> tuple[LaserProfile, ...]:
    """Shots of several steps by the profile that brought them: one for each step with new shots."""
    _, of_part = Names.united([part.ids for part in parts])
    shot = np.concatenate([own[part.measure_shot] for own, part in zip(of_part, parts, strict=True)])
    images = RepeatedNames.concatenated([part.measure_image for part in parts])
    measures = np.concatenate([part.measures for part in parts])
    order, before, profiles = np.argsort(shot, kind="stable"), 0, list[LaserProfile]()
    for own, part in zip(of_part, parts, strict=True):
        new = np.flatnonzero(own >= before)
        rows = order[np.isin(shot[order], own[new])]
        if new.size:
            profiles.append(_with_measures(part, new, shot[rows] - before, images[rows], measures[rows]))
        before += new.size
    return tuple(profiles)


def _with_measures(part: LaserProfile, new: Index, shot: Index, images: RepeatedNames, measures: Array) -> LaserProfile:
    """New shots (n,) of a step with their measures: shot among these (k,), images (k names), places (k, 2)."""
    along = np.isin(part.simultaneous_shot, new)
    return replace(
        part,
        simultaneous_shot=np.searchsorted(new, part.simultaneous_shot[along]),
        simultaneous_image=part.simultaneous_image[along],
        measure_shot=shot,
        measure_image=images,
        measures=measures,
        **{
            name: getattr(part, name)[new]
            for name in ("ids", "times", "ranges", "range_sigmas", "footprints", "covariances")
        },
    )



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
    """What strip to simulate: pairs with these settings, one after the other; shots are those of each nadir image.

    Examples
    --------
    >>> from mgsgraph.simulation import StripSettings
    >>> StripSettings(images=4).overlap
    0.4
    """

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

    @classmethod
    def of_steps(cls, settings: StripSettings, seed: int, steps: tuple[Step, ...]) -> "SimulatedStrip":
        """The strip that steps make up."""
        return cls(
            settings, seed, steps, merged_ties([step.ties for step in steps]),
            np.concatenate([step.true_ties for step in steps]),
            merged_profiles([step.laser for step in steps if step.laser]),
            tuple(step.true_footprints for step in steps if step.true_footprints.size),
        )  # fmt: skip

    @property
    def images(self) -> tuple[PushbroomImage, ...]:
        """Nominal: nadir, aside, nadir, aside ... along the strip."""
        return tuple(step.image for step in self.steps)

    @property
    def true_corrections(self) -> tuple[OrientationCorrection, ...]:
        """One per image: true orientation = nominal (+) correction."""
        return tuple(step.true for step in self.steps)

    def addition(self, k: int) -> tuple[PushbroomImage, TiePoints, LaserProfile | None]:
        """What becomes possible when image `k` is added to images 0 .. k - 1; together these are the whole strip.

        Shots of earlier images that it sees are named again as they were, but simultaneous with no image, so that their
        ranges don't count twice.
        """
        require(0 <= k < len(self.steps), "simulated strip, addition", f"image {k}", f"0 .. {len(self.steps) - 1}")
        step = self.steps[k]
        return step.image, step.ties, step.laser

    def upto(self, count: int) -> "SimulatedStrip":
        """The strip as it was when only the first `count` images had been taken."""
        many = len(self.steps)
        require(1 <= count <= many, "simulated strip, upto", f"{count} images", f"1 .. {many}")
        return SimulatedStrip.of_steps(self.settings, self.seed, self.steps[:count])

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
    >>> from mgsgraph.simulation import StripSettings, simulate_strip
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
    return SimulatedStrip.of_steps(settings, seed, tuple(steps.taken))


def _images(settings: StripSettings) -> list[PushbroomImage]:
    """Nominal images, nadir and aside by turns, whose middles follow one ground track."""
    first = CircularPass(_FIRST, site_at(*_START), HEADING / np.cos(_START[1]), settings.altitude)
    since: Array = settings.interval * np.arange(settings.pairs, dtype=np.float64)
    sites, headings = ground_track(first, since)
    length = float(np.linalg.norm(np.diff(sites, axis=0), axis=1).sum())
    longest = _LONGEST * MARS.equatorial
    require(
        length <= longest, "strip settings, images", f"a strip of {length / KM:.0f} km, which turns back at the pole",
        f"at most {longest / KM:.0f} km", "take fewer or shorter images, or more overlap",
    )  # fmt: skip
    images = []
    for k in range(settings.images):
        pair, off_nadir_turn = divmod(k, 2)
        epoch = _FIRST + _SOL * pair + _LATER * off_nadir_turn
        off_nadir = settings.off_nadir if off_nadir_turn else 0.0
        flown = CircularPass(epoch, sites[pair], float(headings[pair]), settings.altitude, off_nadir)
        name = f"STRIP/{k:03d}{'NX'[off_nadir_turn]}"
        images.append(narrow_image(name, flown, settings.lines, settings.samples, settings.period))
    return images
