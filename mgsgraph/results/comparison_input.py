"""What two solutions differ in before they were adjusted: settings of the solver, a-priori sigmas, measures."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.files.output.table import Column, Table
from mgsgraph.geometry.records import Index
from mgsgraph.names import Names
from mgsgraph.results.section import Section
from mgsgraph.text import NAMED, many, some

_SAME_PLACE = 1e-9
"""px between measures that are the same: what a network's text form loses."""
_SAME_SIGMA = 1e-12
"""Relative difference of sigmas that are the same."""


def settings_section(earlier: Solution, solution: Solution, labels: tuple[str, str]) -> Section:
    """Settings that differ, by the names that a case file has for them, and versions of what computed."""
    one, other = dataclasses.asdict(earlier.settings), dataclasses.asdict(solution.settings)
    different = [name for name in one if one[name] != other[name]]
    said = f"Settings that differ: {', '.join(different)}." if different else "The solver's settings are the same."
    versions = sorted(
        name for name in {*earlier.versions, *solution.versions}
        if earlier.versions.get(name) != solution.versions.get(name)
    )  # fmt: skip
    rows = [(name, _word(one[name]), _word(other[name])) for name in different]
    rows += [
        (f"version of {name}", earlier.versions.get(name, ""), solution.versions.get(name, ""))
        for name in versions
    ]
    names, before, after = ([row[k] for row in rows] for k in range(3))
    table = Table("settings_compared", "Settings and versions that differ", (
        Column("setting", names, page="s", text="<28"),
        Column(labels[0], before, page="s", text=">22"),
        Column(labels[1], after, page="s", text=">22"),
    ))  # fmt: skip
    return Section("settings", sentences=[said], tables=[table])


def _word(value: object) -> str:
    return "not set" if value is None else str(value)


def input_section(earlier: Solution, solution: Solution, labels: tuple[str, str]) -> Section:
    """Measures and a-priori sigmas that differ, by the names of points and images."""
    measures = _measures(earlier, solution)
    rows = {image.name: j for j, image in enumerate(earlier.network.images)}
    shared = [(rows[image.name], j) for j, image in enumerate(solution.network.images) if image.name in rows]
    before, after = np.array(shared, dtype=np.int64).reshape(-1, 2).T
    images = len(solution.network.images)
    other_priors = np.array([_priors_differ(earlier, i, solution, j) for i, j in shared], dtype=bool)
    counts = [np.bincount(one.network.rays.image, minlength=len(one.network.images))[k]
              for one, k in ((earlier, before), (solution, after))]  # fmt: skip
    of_image = solution.network.rays.image[measures.later]
    moved = np.bincount(of_image[measures.moved], minlength=images)[after]
    weighted = np.bincount(of_image[measures.weighted], minlength=images)[after]
    listed = np.flatnonzero((counts[0] != counts[1]) | (moved > 0) | (weighted > 0) | other_priors)
    names = [solution.network.images[j].name for j in after[listed].tolist()]
    table = Table("input_compared", "Images of other measures or a-priori sigmas", (
        Column("image", names, page="s", text="<28"),
        *(
            Column(f"measures_{label.replace(' ', '_')}", count[listed], head=f"measures, {label}", page="s",
                   text=">18")
            for label, count in zip(labels, counts, strict=True)
        ),
        Column("moved", moved[listed], head="at another place", page="s", text=">17"),
        Column("weighted", weighted[listed], head="of another sigma", page="s", text=">17"),
        Column("priors", ["other" if one else "same" for one in other_priors[listed].tolist()],
               head="a-priori sigmas", page="s", text=">16"),
    ))  # fmt: skip
    said = [measures.differences(labels)]
    if np.any(other_priors):
        changed = [solution.network.images[j].name for j in after[other_priors].tolist()]
        said.append(f"Images of other a-priori sigmas: {some(changed, len(changed))}.")
    both = [one.network for one in (earlier, solution)]
    said += only("Shared unknowns", [[each.name for each in network.shared] for network in both])
    said += only("Shifts of profiles and terrain models", [list(network.shift_names) for network in both])
    said += only("Passes", [[each.name for each in network.passes] for network in both])
    return Section("inputs", sentences=said, tables=[table])


def only(what: str, names: Sequence[Sequence[str]], most: int = NAMED) -> list[str]:
    """A sentence about names that only the earlier, or only the later of two solutions has."""
    before, after = (dict.fromkeys(each) for each in names)
    new, gone = [name for name in after if name not in before], [name for name in before if name not in after]
    parts = [f"{word}: {some(one, len(one), most)}" for word, one in (("new", new), ("gone", gone)) if one]
    return [f"{what} that only one of both has, {'; '.join(parts)}."] if parts else []


@dataclass(frozen=True, slots=True, eq=False)
class _Measures:
    """Measures of the same point in the same image, in both adjustments."""

    only_earlier: int
    only_later: int
    later: Index
    """(n,) common measures' numbers in the later one."""
    distance: np.ndarray
    """(n,) px between the measured places."""
    moved: np.ndarray
    """(n,) True where they differ."""
    weighted: np.ndarray
    """(n,) True where the sigmas do."""

    def differences(self, labels: tuple[str, str]) -> str:
        """How the measures of both adjustments differ, in a sentence."""
        if not (self.only_earlier or self.only_later or self.moved.any() or self.weighted.any()):
            return f"The {many(self.later.size, 'image measure')} are the same."
        parts = [f"Image measures: {self.later.size} of both"]
        parts += [f"{number} {label} alone" for number, label in
                  ((self.only_earlier, labels[0]), (self.only_later, labels[1])) if number]  # fmt: skip
        if self.moved.any():
            count = int(np.count_nonzero(self.moved))
            parts.append(f"{count} measured at another place (by up to {self.distance.max():.3g} px)")
        if self.weighted.any():
            parts.append(f"{np.count_nonzero(self.weighted)} of another sigma")
        return ", ".join(parts) + "."


def _measures(earlier: Solution, solution: Solution) -> _Measures:
    """Measures of both by point and image; of several measures of a point in one image the first counts."""
    one, other = earlier.network, solution.network
    _, (points_before, points_after) = Names.united([Names.of(one.points.ids), Names.of(other.points.ids)])
    pictures = [Names.of([image.name for image in network.images]) for network in (one, other)]
    every, (images_before, images_after) = Names.united(pictures)
    keys = [points[network.rays.point] * len(every) + images[network.rays.image]
            for network, points, images in ((one, points_before, images_before), (other, points_after, images_after))]
    _, before, after = np.intersect1d(keys[0], keys[1], return_indices=True)
    distance = np.linalg.norm(other.rays.places[after] - one.rays.places[before], axis=1)
    sigmas = np.abs(other.rays.sigmas[after] / one.rays.sigmas[before] - 1.0).max(axis=1, initial=0.0)
    return _Measures(
        keys[0].size - before.size, keys[1].size - after.size, after, distance, distance > _SAME_PLACE,
        sigmas > _SAME_SIGMA,
    )  # fmt: skip


def _priors_differ(earlier: Solution, i: int, solution: Solution, j: int) -> bool:
    """Whether an image has other a-priori sigmas, or is held in one of both only."""
    one, other = earlier.network.priors[i].sigmas, solution.network.priors[j].sigmas
    held = bool(earlier.network.held[i]) != bool(solution.network.held[j])
    return held or one.shape != other.shape or not np.allclose(one, other, rtol=_SAME_SIGMA, atol=0.0)
