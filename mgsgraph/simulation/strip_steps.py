"""One image of a strip after the other: its correction, the ground it shares with earlier ones, ties and shots."""

from dataclasses import dataclass, field

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index
from mgsgraph.simulation.circle import on_terrain
from mgsgraph.simulation.observations import MARGIN, NoiseSettings, free_points, profile, shots_along
from mgsgraph.simulation.sighting import Sighting, sighting
from mgsgraph.ties import TiePoints

SOURCE = "simulated strip"
"""What messages call observations that were not read from a file."""

_DRAWS = 12
"""Rounds of drawing before an image counts as sharing no ground."""
_NO_OVERLAP = "take longer images, more overlap, a smaller off_nadir or smaller position and angle sigmas"


@dataclass(frozen=True, slots=True, eq=False)
class Step:
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
class _Sights:
    """Which point stands where in which image: rows as they are found."""

    point: list[Index] = field(default_factory=list)
    image: list[Index] = field(default_factory=list)
    places: list[Array] = field(default_factory=list)

    def add(self, points: Index, image: int, places: Array) -> None:
        self.point.append(points)
        self.image.append(np.full(points.size, image))
        self.places.append(places)

    def ordered(self) -> tuple[Index, Index, Array]:
        """Points (k,), images (k,), places (k, 2), by point and then by image."""
        point, image = (np.concatenate([np.zeros(0, dtype=np.int64), *rows]) for rows in (self.point, self.image))
        order = np.lexsort([image, point])
        return point[order], image[order], np.concatenate([np.zeros((0, 2)), *self.places])[order]


@dataclass(slots=True, eq=False)
class Steps:
    """A strip while it grows."""

    ties: int
    """New tie points of each image after the first."""
    shots: int
    """Laser shots of each nadir image; every second image is one."""
    relief: float
    """m."""
    noise: NoiseSettings
    """Sigmas."""
    taken: list[Step] = field(default_factory=list)
    """Steps so far."""
    _images: list[Sighting] = field(default_factory=list)
    _footprints: list[LaserProfile] = field(default_factory=list)
    """As given, of each nadir image, without measures."""

    def add(self, image: PushbroomImage, rng: np.random.Generator) -> None:
        """Take the next image of the strip."""
        of_orientation, of_ties, of_shots = rng.spawn(3)
        true = self.noise.correction(of_orientation)
        new = sighting(image, true, self.relief)
        neighbours = [j for j, other in enumerate(self._images) if new.meets(other)]
        self._images.append(new)
        ties, true_ties = self._tie_points(neighbours, of_ties)
        laser, true_footprints = self._laser_shots(neighbours, of_shots)
        self.taken.append(Step(image, true, ties, true_ties, laser, true_footprints))

    def _tie_points(self, neighbours: list[int], rng: np.random.Generator) -> tuple[TiePoints, Array]:
        """Ties of the last image, and the true places of the new ones among them."""
        k = len(self._images) - 1
        sights, points = _Sights(), np.zeros((0, 3))
        known = list(range(max(min(neighbours, default=0), 1), k))
        if known:
            shown, places = self._images[k].seen(np.concatenate([self.taken[i].true_ties for i in known]))
            sights.add(shown + (known[0] - 1) * self.ties, k, places)
        if k > 0:
            points = self._new_points(neighbours, sights, rng)
        point, image, places = sights.ordered()
        numbers, local = np.unique(point, return_inverse=True)
        ties = free_points(
            SOURCE,
            tuple(f"T{i // self.ties + 1:03d}-{i % self.ties + 1:05d}" for i in numbers.tolist()),
            local,
            self._names(image),
            places + self.noise.tie * rng.standard_normal(places.shape),
            self.noise.tie,
        )
        return ties, points

    def _new_points(self, neighbours: list[int], sights: _Sights, rng: np.random.Generator) -> Array:
        """True places (ties, 3) in m of new ties of the last image, at random where an earlier one sees them, too."""
        k, wanted = len(self._images) - 1, self.ties
        new = self._images[k]
        if not neighbours:
            raise _unshared(new.image, 0, wanted)
        first, last = self._shared_lines(neighbours)
        kept, offset = list[Array](), (k - 1) * wanted
        found = 0
        for _ in range(_DRAWS):
            count = int(1.15 * (wanted - found)) + 20
            drawn = rng.uniform([first, MARGIN], [last, new.image.samples - MARGIN], (count, 2))
            level, _ = new.image.image_to_ground(drawn[:, 0], drawn[:, 1], 0.0, new.true)
            points = on_terrain(level, self.relief)
            seen = [(j, *self._images[j].seen(points)) for j in [*neighbours, k]]
            rays = np.bincount(np.concatenate([shown for _, shown, _ in seen]), minlength=count)
            shared = np.intersect1d(np.flatnonzero(rays > 1), seen[-1][1])[: wanted - found]
            number = np.full(count, -1)
            number[shared] = np.arange(shared.size) + offset + found
            for j, shown, places in seen:
                mine = number[shown] >= 0
                sights.add(number[shown[mine]], j, places[mine])
            kept.append(points[shared])
            found += shared.size
            if found == wanted:
                return np.concatenate(kept)
        raise _unshared(new.image, found, wanted)

    def _shared_lines(self, neighbours: list[int]) -> tuple[float, float]:
        """First and last line of the last image between which ground is worth a draw."""
        new = self._images[-1]
        spans = [new.lines_of(self._images[j]) for j in neighbours]
        least, most = MARGIN, new.image.lines - MARGIN
        first, last = (float(np.clip(f([span[i] for span in spans]), least, most)) for i, f in ((0, min), (1, max)))
        return first, last

    def _laser_shots(self, neighbours: list[int], rng: np.random.Generator) -> tuple[LaserProfile | None, Array]:
        """Shots of the last image and those it shows of others, and the true footprints of the new ones."""
        k = len(self._images) - 1
        sights, points = _Sights(), np.zeros((0, 3))
        owners = list(range(min(neighbours, default=0) // 2 * 2, k, 2))
        if owners:
            shown, places = self._images[k].seen(np.concatenate([self.taken[i].true_footprints for i in owners]))
            sights.add(shown + owners[0] // 2 * self.shots, k, places)
        if k % 2 == 0:
            points = self._new_shots(neighbours, sights, rng)
        shot, image, places = sights.ordered()
        if shot.size == 0:
            return None, points
        numbers, local = np.unique(shot, return_inverse=True)
        times, ranges, footprints = self._given(numbers)
        own = self._images[k].image.name
        laser = profile(
            SOURCE,
            tuple(f"S{2 * (i // self.shots):03d}-{i % self.shots + 1:04d}" for i in numbers.tolist()),
            times,
            ranges,
            footprints,
            tuple((own,) if 2 * (i // self.shots) == k else () for i in numbers.tolist()),
            local,
            self._names(image),
            places + self.noise.shot_image * rng.standard_normal(places.shape),
            self.noise,
        )
        return laser, points

    def _new_shots(self, neighbours: list[int], sights: _Sights, rng: np.random.Generator) -> Array:
        """True footprints (shots, 3) in m of the last image."""
        k, n = len(self._images) - 1, self.shots
        new = self._images[k]
        exact = shots_along(new.image, new.true, n, self.relief)
        for j in [*neighbours, k]:
            shown, places = self._images[j].seen(exact.points)
            sights.add(shown + k // 2 * n, j, places)
        self._footprints.append(profile(
            SOURCE,
            tuple(f"{i}" for i in range(n)),
            exact.times,
            exact.ranges + self.noise.range * rng.standard_normal(n),
            exact.points + self.noise.ground * rng.standard_normal((n, 3)),
            ((),) * n,
            np.zeros(0, dtype=np.int64),
            (),
            np.zeros((0, 2)),
            self.noise,
        ))
        return exact.points

    def _given(self, shots: Index) -> tuple[Array, Array, Array]:
        """Times (n,), ranges (n,) and footprints (n, 3) of shots by their number, as given."""
        first = int(shots[0]) // self.shots
        some, local = self._footprints[first:], shots - first * self.shots
        return (
            np.concatenate([one.times for one in some])[local],
            np.concatenate([one.ranges for one in some])[local],
            np.concatenate([one.footprints for one in some])[local],
        )

    def _names(self, images: Index) -> tuple[str, ...]:
        names = [taken.image.name for taken in self._images]
        return tuple(names[j] for j in images.tolist())


def _unshared(image: PushbroomImage, found: int, wanted: int) -> InputError:
    found_ground = f"ground shared with earlier images for {found} of {wanted} tie points"
    return InputError(f"{SOURCE}, image {image.name}", found_ground, remedy=_NO_OVERLAP)
