"""A solution beside an earlier one: what differs in input and settings, what moved, by how much, and whether that is
more than was unknown; and where sigmas became smaller or larger.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.analysis.estimates import CommonPoints
from mgsgraph.analysis.statistics import PLACES
from mgsgraph.errors import InputError
from mgsgraph.files.output.table import Column, Table, cut, picked
from mgsgraph.geometry import rotation
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.names import Names
from mgsgraph.network import Network, PointClass
from mgsgraph.record import Record
from mgsgraph.results.results import figures_of_merit
from mgsgraph.results.section import Section, columns_of, drawn, table_of
from mgsgraph.results.verdict import state_of
from mgsgraph.text import many, root_mean_square, some

_POINTS = "points_compared"
_MOST_IMAGES = 300
"""Images whose orientation is compared."""
_MOST_POINTS = 200
"""Points listed, those that moved most."""
_METHOD = (
    "Differences: {} minus {}, in units of the larger of both sigmas (sigma0 = 1). The solutions share observations, "
    "so that the sigma of a difference is unknown."
)
_CLASSES = [kind.name.lower() for kind in PointClass]
_QUANTILES = (0.02, 0.5, 0.98)
_SAME_PLACE = 1e-9
"""px between measures that are the same: what a network's text form loses."""
_SAME_SIGMA = 1e-12
"""Relative difference of sigmas that are the same."""


@dataclass(frozen=True, slots=True)
class Comparison(Record):
    """What is said about two solutions."""

    name: str
    """What the earlier one is called."""
    section: Section
    """Sentences; tables of settings and input that differ, figures of merit, sigmas, images and points."""
    points: CommonPoints
    """The ground points that both have."""

    @property
    def sentences(self) -> Sequence[str]:
        """What differs, in sentences."""
        return self.section.sentences


def compare(solution: Solution, earlier: Solution, labels: tuple[str, str] = ("earlier", "this one")) -> Comparison:
    """Compare two solutions by the names of their images and points.

    Parameters
    ----------
    solution, earlier : Solution
        Differences are the first minus the second, in m and rad.
    labels : (str, str)
        What the earlier and the later one are called in sentences and headings.

    Raises
    ------
    InputError
        If they have no image in common, or one of them with other pixels.

    Examples
    --------
    >>> without = mgsgraph.adjust(mgsgraph.read_case("pair/case.toml", laser=False))
    >>> comparison = mgsgraph.compare(solution, without, ("without laser", "with laser"))
    >>> print(comparison.sentences[0])
    The orientation of 2 common images differs by at most 2.1 sigmas (SIM/B).
    """
    shared, points = common_images(solution, earlier), CommonPoints(solution, earlier)
    images, moved, sigmas = _images(solution, earlier, shared), _points(points), _sigmas(points, labels)
    parts = (images, moved, sigmas, settings_section(earlier, solution, labels),
             input_section(earlier, solution, labels))  # fmt: skip
    said = [sentence for one in parts for sentence in one.sentences]
    said += [
        f"{label.capitalize()}: NOT CONVERGED, so that its sigmas mean little."
        for one, label in zip((earlier, solution), labels, strict=True) if not one.converged
    ] + [_METHOD.format(labels[1], labels[0])]  # fmt: skip
    every = [_fit_figures(solution, earlier, labels)]
    every += [table for k in (2, 3, 4, 0, 1) for table in parts[k].tables if len(table)]
    csv = [*(table for table in every if table.name != _POINTS), *moved.csv]
    record = {"format": 1, "names": list(labels), "statements": said}
    record |= {table.name: table.records() for table in every if table.name != _POINTS}
    section = Section("comparison", "", said, every, record, csv,
                      sheets=drawn("mgsgraph.results.figures.map.comparison_sheet", points, labels))  # fmt: skip
    return Comparison(earlier.name, section, points)


def common_images(solution: Solution, earlier: Solution) -> list[tuple[int, int]]:
    """Numbers of each common image in both solutions; InputError where there is none, or one has other pixels."""
    rows = {image.name: j for j, image in enumerate(earlier.network.images)}
    shared = [(j, rows[image.name]) for j, image in enumerate(solution.network.images) if image.name in rows]
    if not shared:
        names = [image.name for image in solution.network.images]
        raise InputError(
            f"solution {earlier.name!r}, to be compared with", "no image in common",
            f"some of {some(names, len(names))}", "compare solutions of the same images",
        )  # fmt: skip
    for j, i in shared:
        one, other = solution.network.images[j], earlier.network.images[i]
        if (one.lines, one.samples) != (other.lines, other.samples):
            raise InputError(
                f"solution {earlier.name!r}, image {other.name}", f"{other.lines} x {other.samples} pixels",
                f"{one.lines} x {one.samples}, as in {solution.name!r}",
            )  # fmt: skip
    return shared


def _fit_figures(solution: Solution, earlier: Solution, labels: tuple[str, str]) -> Table:
    both = earlier, solution
    before, after = (np.array([value for _, value in figures_of_merit(one)]) for one in both)
    texts = [[f"{value:.6g}" if np.isfinite(value) else "" for value in column]
             for column in (before, after, after - before)]  # fmt: skip
    note = "" if earlier.fit.observations == solution.fit.observations else (
        "The numbers of observations differ: costs can't be compared, sigma0 can."
    )
    losses = [f"{one.loss}, width {one.loss_width:g}" if one.loss_width else one.loss
              for one in (each.settings for each in both)]  # fmt: skip
    if losses[0] != losses[1]:  # another loss weighs the same residuals otherwise
        note = f"The losses differ ({'; now '.join(losses)}): neither costs nor sigma0 can be compared."
    return Table("merit_compared", "Figures of merit", (
        Column("figure", ["state", *(name for name, _ in figures_of_merit(solution))], page="s", text="<34"),
        *(Column(name, [first, *text], page="s", text=">14") for name, first, text in
          zip((*labels, "difference"), (*map(state_of, both), ""), texts, strict=True)),
    ), note)  # fmt: skip


def orientation_difference(solution: Solution, j: int, earlier: Solution, i: int) -> tuple[Array, Array]:
    """Differences (n, 6) of an image's adjusted orientation over its lines, m (body-fixed) and rad (about the camera's
    axes), and the larger of both sigmas (n, 6).
    """
    lines = np.linspace(0.0, float(solution.network.images[j].lines), PLACES)
    poses = [one.network.images[k].pose(lines, one.correction(k)) for one, k in ((solution, j), (earlier, i))]
    turn = -rotation.logarithm(poses[0].matrix @ np.swapaxes(poses[1].matrix, 1, 2))
    profiles = [orientation_profile(one, k, PLACES) for one, k in ((solution, j), (earlier, i))]
    sigmas = [np.concatenate([one.position_sigma, one.rotation_sigma], axis=1) for one in profiles]
    moved = np.concatenate([poses[0].position - poses[1].position, turn], axis=1)
    return moved, np.maximum(*sigmas)


def _images(solution: Solution, earlier: Solution, shared: list[tuple[int, int]]) -> Section:
    shown = shared[:_MOST_IMAGES]
    names = [solution.network.images[j].name for j, _ in shown]
    found = [orientation_difference(solution, j, earlier, i) for j, i in shown]
    rms = np.array([root_mean_square(moved, 0) for moved, _ in found])
    with np.errstate(divide="ignore", invalid="ignore"):
        most = np.array([np.max(np.where(s > 0.0, np.abs(moved) / s, np.nan), axis=0) for moved, s in found])
    largest = np.nanmax(np.nan_to_num(most), axis=1)  # NaN of a held image
    worst = int(np.argmax(largest))
    said = (
        f"The orientation of {many(len(shown), 'common image')} differs by at most {largest[worst]:.2g} sigmas "
        f"({names[worst]})."
    )
    note = f"Over {PLACES} lines: rms of the differences, and the largest one in sigmas; a dash: held. "
    table = table_of("images_compared", {
        "image": names, "rms_{}": rms[:, :3], "rms_turn_{}": rms[:, 3:], "largest_{}_sigmas": most[:, :3],
        "largest_turn_{}_sigmas": most[:, 3:],
    }, note=note + cut(len(shared), len(shown), "the first ones", "orientation.csv"))  # fmt: skip
    return Section("images", sentences=[said], tables=[table])


def _points(points: CommonPoints) -> Section:
    new, gone = len(points.solution.network.points) - points.shared, len(points.earlier.network.points) - points.shared
    counts = f"{many(points.shared, 'point')} of both, {new} new, {gone} gone"
    table = moved_points(points)
    if not len(table):
        return Section("points", sentences=[f"{counts}: no point has a place in both."])
    length = np.linalg.norm(points.moved, axis=1)
    most = np.nanmax(points.in_sigmas, initial=0.0)
    said = (
        f"{counts}; they moved by {root_mean_square(length):.3g} m (rms), median {np.median(length):.3g} m, at most "
        f"{length.max():.3g} m and {most:.2g} sigmas."
    )
    listed = np.argsort(-length, kind="stable")[:_MOST_POINTS]
    note = table.note + cut(len(table), len(listed), "those that moved most", "the table of points")
    return Section("points", sentences=[said], tables=[replace(table.take(listed), note=note)], csv=[table])


def moved_points(points: CommonPoints) -> Table:
    """Every common point: how far it moved, and both sigmas."""
    here, _ = points.rows
    earlier, later = points.sigmas
    classes = points.solution.network.points.classes[here]
    ids = Names.of(points.solution.network.points.ids)[here]
    return table_of("moved_points", {
        "point": ids, "class": picked(_CLASSES, classes), "{}": points.moved,
        "distance": np.linalg.norm(points.moved, axis=1), "distance_sigmas": points.in_sigmas,
        "sigma_earlier": earlier, "sigma_later": later,
    }, name=_POINTS)  # fmt: skip


def _sigmas(points: CommonPoints, labels: tuple[str, str]) -> Section:
    """Median sigmas of the common points by class, and by what factor the sigma of a point became larger."""
    classes = points.solution.network.points.classes[points.rows[0]]
    ratio, (earlier, later) = points.ratio, points.sigmas
    members = [(kind, np.flatnonzero((classes == kind) & np.isfinite(ratio))) for kind in PointClass]
    rows = [(kind, mine) for kind, mine in members if mine.size]
    medians = np.array([[np.median(one[mine]) for one in (earlier, later)] for _, mine in rows]).reshape(-1, 2)
    spread = np.array([np.quantile(ratio[mine], _QUANTILES) for _, mine in rows]).reshape(-1, 3)
    table = table_of("sigmas_compared", {
        "class": [_CLASSES[kind] for kind, _ in rows],
        "points": np.array([mine.size for _, mine in rows], dtype=np.int64),
        "median_{}": Column(
            "median_{}", medians, "m",
            parts=labels,
            head="median, {}",
            page=".3f", label="median (m)", text=">10"
        ),
        "ratio_{}": spread,
    }, note=f"Ratio: {labels[1]} over {labels[0]}, of each point; below 1 it is better known.")  # fmt: skip
    known = ratio[np.isfinite(ratio)]
    if not known.size:
        return Section("sigmas", tables=[table])
    better, worse = (100.0 * np.count_nonzero(side) / known.size for side in (known < 0.99, known > 1.01))
    said = (
        f"3-D sigmas of common points, {labels[1]} / {labels[0]}: median {np.median(known):.3g}; {better:.0f} % of the "
        f"points are better by more than 1 %, {worse:.0f} % are worse."
    )
    return Section("sigmas", sentences=[said], tables=[table])


# --- before the adjustment


def settings_section(earlier: Solution, solution: Solution, labels: tuple[str, str]) -> Section:
    """Settings that differ, by the names that a case file has for them, and versions of what computed."""
    one, other = (
        dataclasses.asdict(each.settings) | {f"version of {name}": text for name, text in sorted(each.versions.items())}
        for each in (earlier, solution)
    )
    names = [name for name in one | other if one.get(name) != other.get(name)]
    different = [name for name in names if not name.startswith("version of ")]
    said = f"Settings that differ: {', '.join(different)}." if different else "The solver's settings are the same."
    return Section("settings", sentences=[said], tables=[Table(
        "settings_compared", "Settings and versions that differ", (
            Column("setting", names, page="s", text="<28"),
            *(Column(label, ["not set" if each.get(name) is None else str(each[name]) for name in names], page="s",
                     text=">22") for label, each in zip(labels, (one, other), strict=True)),
        ),
    )])  # fmt: skip


def input_section(earlier: Solution, solution: Solution, labels: tuple[str, str]) -> Section:
    """Measures and a-priori sigmas that differ, by the names of points and images."""
    both = earlier.network, solution.network
    (only_earlier, only_later), later, moved, weighted = _measures(*both)
    rows = {image.name: j for j, image in enumerate(both[0].images)}
    shared = [(rows[image.name], j) for j, image in enumerate(both[1].images) if image.name in rows]
    before, after = np.array(shared, dtype=np.int64).reshape(-1, 2).T
    priors = np.array([_priors_differ(*both, i, j) for i, j in shared], dtype=bool)
    counts = [np.bincount(one.rays.image, minlength=len(one.images))[k]
              for one, k in zip(both, (before, after), strict=True)]  # fmt: skip
    of_image = both[1].rays.image[later]
    placed, sized = (np.bincount(of_image[one], minlength=len(both[1].images))[after] for one in (moved, weighted))
    listed = np.flatnonzero((counts[0] != counts[1]) | (placed > 0) | (sized > 0) | priors)
    table = Table("input_compared", "Images of other measures or a-priori sigmas", (
        *columns_of("input_compared", {"image": [both[1].images[j].name for j in after[listed].tolist()]}),
        *(Column(f"measures_{label.replace(' ', '_')}", count[listed], head=f"measures, {label}", page="s", text=">18")
          for label, count in zip(labels, counts, strict=True)),
        *columns_of("input_compared", {
            "moved": placed[listed], "weighted": sized[listed],
            "priors": ["other" if one else "same" for one in priors[listed].tolist()],
        }),
    ))  # fmt: skip
    said = [
        f"Image measurements: {later.size} in both, {only_earlier} only in {labels[0]}, {only_later} only in "
        f"{labels[1]}; {np.count_nonzero(moved)} at another pixel, {np.count_nonzero(weighted)} with another sigma."
    ]
    if np.any(priors):
        changed = [both[1].images[j].name for j in after[priors].tolist()]
        said.append(f"Images of other a-priori sigmas: {some(changed, len(changed))}.")
    return Section("inputs", sentences=[*said, *_only(*both)], tables=[table])


def _only(earlier: Network, later: Network) -> Iterator[str]:
    """Sentences about names that only the earlier, or only the later of two networks has."""
    both = earlier, later
    for what, names in (
        ("Images", [[image.name for image in one.images] for one in both]),
        ("Shared unknowns", [[each.name for each in one.shared] for one in both]),
        ("Shifts of profiles and terrain models", [list(one.shift_names) for one in both]),
        ("Passes", [[each.name for each in one.passes] for one in both]),
    ):
        before, after = map(dict.fromkeys, names)
        new, gone = [name for name in after if name not in before], [name for name in before if name not in after]
        parts = [f"{word}: {some(each, len(each))}" for word, each in (("new", new), ("gone", gone)) if each]
        if parts:
            yield f"{what} that only one of both has, {'; '.join(parts)}."


def _measures(one: Network, other: Network) -> tuple[tuple[int, int], Index, Mask, Mask]:
    """How many measures of a point in an image either network has alone, the other's numbers (n,) of common ones, and
    which of these are at another place, or of another sigma; of several of a point in one image the first counts.
    """
    both = one, other
    _, points = Names.united([Names.of(each.points.ids) for each in both])
    every, images = Names.united([Names.of([image.name for image in each.images]) for each in both])
    keys = [of_point[each.rays.point] * len(every) + of_image[each.rays.image]
            for each, of_point, of_image in zip(both, points, images, strict=True)]  # fmt: skip
    _, before, after = np.intersect1d(keys[0], keys[1], return_indices=True)
    distance = np.linalg.norm(other.rays.places[after] - one.rays.places[before], axis=1)
    sigmas = np.abs(other.ray_sigmas[after] / one.ray_sigmas[before] - 1.0).max(axis=1, initial=0.0)
    alone = keys[0].size - before.size, keys[1].size - after.size
    return alone, after, distance > _SAME_PLACE, sigmas > _SAME_SIGMA


def _priors_differ(earlier: Network, later: Network, i: int, j: int) -> bool:
    """Whether an image has other a-priori sigmas, or is held in one of both only."""
    one, other = earlier.priors[i].sigmas, later.priors[j].sigmas
    held = bool(earlier.held[i]) != bool(later.held[j])
    return held or one.shape != other.shape or not np.allclose(one, other, rtol=_SAME_SIGMA, atol=0.0)
