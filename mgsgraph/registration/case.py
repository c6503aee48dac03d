"""Registration of a case: where its laser profiles fall in its images, by how much images contradict each other about
them, before an adjustment and after it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import Case
from mgsgraph.errors import InputError, require
from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.names import numbered
from mgsgraph.network.footprints import (
    Corrections,
    Misregistration,
    Registration,
    discrepancy,
    footprints_in_images,
)
from mgsgraph.text import listed, many

_FEWEST_TIES = 3
"""Common tie points without which two images can't be compared."""
_NAMED = 4
"""How many pairs without enough tie points are named."""


@dataclass(frozen=True, slots=True, eq=False)
class ProfileRegistration:
    """One laser profile under one orientation of the images."""

    name: str
    """Its file's name without ending."""
    footprints: Registration
    """Where its shots fall."""
    points: Array
    """(n, 3) m, body-fixed, its footprints: as archived, or adjusted."""
    discrepancies: tuple[Misregistration, ...]
    """Of each pair of images that see some of it and have ties in common."""


@dataclass(frozen=True, slots=True, eq=False)
class CaseRegistration:
    """All profiles of a case in all its images."""

    name: str
    """What the case is called."""
    before: tuple[ProfileRegistration, ...]
    """Footprints as archived, nominal orientation."""
    after: tuple[ProfileRegistration, ...]
    """The same profiles, adjusted footprints and orientation; empty without a solution."""
    pictures: tuple[Path | None, ...]
    """File of each image's pixels, where the case names one."""
    warnings: tuple[str, ...]
    """Sentences: what could not be compared, and why."""

    @property
    def images(self) -> tuple[PushbroomImage, ...]:
        """As the case has them."""
        return self.before[0].footprints.images

    def states(self) -> Iterator[tuple[str, tuple[ProfileRegistration, ...]]]:
        """Name of the orientation, and the profiles under it."""
        yield "nominal", self.before
        if self.after:
            yield "adjusted", self.after

    def __repr__(self) -> str:
        states = " and ".join(name for name, _ in self.states())
        return f"CaseRegistration({self.name!r}: {len(self.before)} profiles, {len(self.images)} images, {states})"


# --- registering


def register_case(case: Case, solution: Solution | None = None) -> CaseRegistration:
    """Project the footprints of a case into its images, and compare the images at them.

    Parameters
    ----------
    case : Case
        With at least one profile of [[shots]].
    solution : Solution, optional
        Adjustment of the same case; with it everything is there a second time, after the adjustment.

    Raises
    ------
    InputError
        Without a profile, or when the solution is that of another case.
    """
    require(
        case.profiles, str(case.path), "no laser profile to be registered", "at least one [[shots]]",
        "`mgsgraph adjust` shows how shots of an ISIS lidar file fit",
    )  # fmt: skip
    images = case.network.images
    names = [Path(shots.source).stem for shots in case.profiles]
    nothing: Corrections = [None] * len(images)
    before = tuple(
        _register(name, images, shots, shots.footprints, nothing, case.ties)
        for name, shots in zip(names, case.profiles, strict=True)
    )
    warnings = _not_compared(before, case.ties)
    after: tuple[ProfileRegistration, ...] = ()
    if solution is not None:
        adjusted, corrections = _of_solution(case, solution)
        rows = numbered(solution.network.points.ids)
        after = tuple(
            _register(name, adjusted, shots, _adjusted_places(name, shots, solution, rows), corrections, case.ties)
            for name, shots in zip(names, case.profiles, strict=True)
        )
        if not solution.converged:
            warnings += (f"The adjustment has NOT CONVERGED: the adjusted values are not valid. {solution.message}",)
    return CaseRegistration(case.name, before, after, case.pictures or (None,) * len(images), warnings)


def _register(
    name: str,
    images: tuple[PushbroomImage, ...],
    shots: AltimeterShots,
    points: Array,
    corrections: Corrections,
    ties: TiePoints | None,
) -> ProfileRegistration:
    registration = footprints_in_images(images, shots, corrections, points)
    compared = [] if ties is None else [
        (i, j) for i, j in _sharing(registration) if _common_ties(ties, images[i], images[j]) >= _FEWEST_TIES
    ]
    return ProfileRegistration(name, registration, points, tuple(
        discrepancy((images[i], images[j]), shots, ties, (corrections[i], corrections[j]), points)
        for i, j in compared if ties is not None
    ))


def _sharing(registration: Registration) -> list[tuple[int, int]]:
    """Pairs of images that see a footprint in common."""
    inside = registration.inside
    return [(i, j) for i, j in combinations(range(len(registration.images)), 2) if np.any(inside[i] & inside[j])]


def _common_ties(ties: TiePoints, first: PushbroomImage, second: PushbroomImage) -> int:
    number = ties.measure_image.over([first.name, second.name])
    return int(np.intersect1d(*(ties.measure_point[number == k] for k in range(2))).size)


def _not_compared(profiles: tuple[ProfileRegistration, ...], ties: TiePoints | None) -> tuple[str, ...]:
    """Sentences about the pairs that see footprints in common and can't be compared."""
    images = profiles[0].footprints.images
    pairs = sorted({pair for profile in profiles for pair in _sharing(profile.footprints)})
    if not pairs:
        return ("No two images see the same footprint: there is nothing to compare.",) if len(images) > 1 else ()
    counts = {(i, j): 0 if ties is None else _common_ties(ties, images[i], images[j]) for i, j in pairs}
    poor = [(images[i].name, images[j].name, count) for (i, j), count in counts.items() if count < _FEWEST_TIES]
    sentences = [
        f"{a} and {b} see footprints in common, but have {many(count, 'tie point')} in common: whether they agree "
        f"can't be known with fewer than {_FEWEST_TIES}."
        for a, b, count in poor[:_NAMED]
    ]
    return (*sentences, *([f"The same holds for {many(len(poor) - _NAMED, 'more pair')}."] if poor[_NAMED:] else []))


def _of_solution(case: Case, solution: Solution) -> tuple[tuple[PushbroomImage, ...], Corrections]:
    """The case's images as they were adjusted, and their corrections."""
    rows = numbered(solution.network.image_names)
    for image in case.network.images:
        row = rows.get(image.name)
        if row is None:
            names = listed(list(rows)[:_NAMED])
            raise InputError(f"solution {solution.name!r}", f"no image {image.name}", f"one of this case ({names})")
        other = solution.network.images[row]
        if (image.lines, image.samples) != (other.lines, other.samples):
            raise InputError(
                f"solution {solution.name!r}, image {image.name}", f"{other.lines} x {other.samples} pixels",
                f"{image.lines} x {image.samples} as in the case", "adjust the case again",
            )
    chosen = [rows[image.name] for image in case.network.images]
    return tuple(solution.image(j) for j in chosen), [solution.correction(j) for j in chosen]


def _adjusted_places(name: str, shots: AltimeterShots, solution: Solution, rows: Mapping[str, int]) -> Array:
    """(n, 3) m, adjusted footprints of a profile, which the network calls by the profile's name and the shot's."""
    point_ids = [f"{name}:{shot}" for shot in shots.ids]
    for point_id in [point_id for point_id in point_ids if point_id not in rows][:1]:
        raise InputError(
            f"solution {solution.name!r}", f"no laser shot {point_id}", "all shots of the case", "adjust the case again"
        )
    return solution.places[[rows[point_id] for point_id in point_ids]]
