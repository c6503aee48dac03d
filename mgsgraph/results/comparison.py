"""A solution beside an earlier one: what differs in input and settings, how far points moved, in m and
in sigmas; and where sigmas became smaller or larger.
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
from mgsgraph.names import Names, numbered
from mgsgraph.network import Network, PointClass
from mgsgraph.record import Record
from mgsgraph.results.results import figures_of_merit
from mgsgraph.results.section import Section, columns_of, sheets_by, table_of
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
_SAME_PIXEL = 1e-9
"""px between measures that are the same: what a network's text form loses."""
_SAME_SIGMA = 1e-12
"""Relative difference of sigmas that are the same."""


@dataclass(frozen=True, slots=True)
class Comparison(Record):
    """Result of comparing two solutions."""

    name: str
    """Name of the earlier solution."""
    section: Section
    """Sentences; tables of settings and input that differ, figures of merit, sigmas, images and points."""
    points: CommonPoints
    """The ground points that both have."""

    @property
    def sentences(self) -> Sequence[str]:
        """Differences in sentences."""
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
    common, points = common_images(solution, earlier), CommonPoints(solution, earlier)
    images, movements, sigmas = (_images_section(solution, earlier, common), _points_section(points),
                                 _sigmas_section(points, labels))
    sections = (images, movements, sigmas, settings_section(earlier, solution, labels),
                input_section(earlier, solution, labels))  # fmt: skip
    sentences = [sentence for finding in sections for sentence in finding.sentences]
    sentences += [
        f"{label.capitalize()}: NOT CONVERGED, so that its sigmas mean little."
        for compared, label in zip((earlier, solution), labels, strict=True) if not compared.converged
    ] + [_METHOD.format(labels[1], labels[0])]  # fmt: skip
    tables = [_fit_figures(solution, earlier, labels)]
    tables += [table for k in (2, 3, 4, 0, 1) for table in sections[k].tables if len(table)]
    csv = [*(table for table in tables if table.name != _POINTS), *movements.csv]
    record = {"format": 1, "names": list(labels), "statements": sentences}
    record |= {table.name: table.records() for table in tables if table.name != _POINTS}
    section = Section("comparison", "", sentences, tables, record, csv,
                      sheets=sheets_by("mgsgraph.results.figures.map.comparison_sheet", points, labels))  # fmt: skip
    return Comparison(earlier.name, section, points)


def common_images(solution: Solution, earlier: Solution) -> list[tuple[int, int]]:
    """Numbers of each common image in both solutions; InputError where there is none, or one has other pixels."""
    rows = numbered(earlier.network.image_names)
    common = [(j, rows[image.name]) for j, image in enumerate(solution.network.images) if image.name in rows]
    if not common:
        names = solution.network.image_names
        raise InputError(
            f"solution {earlier.name!r}, to be compared with", "no image in common", f"some of {some(names)}",
            "compare solutions of the same images",
        )  # fmt: skip
    for j, i in common:
        later_image, earlier_image = solution.network.images[j], earlier.network.images[i]
        if (later_image.lines, later_image.samples) != (earlier_image.lines, earlier_image.samples):
            raise InputError(
                f"solution {earlier.name!r}, image {earlier_image.name}",
                f"{earlier_image.lines} x {earlier_image.samples} pixels",
                f"{later_image.lines} x {later_image.samples}, as in {solution.name!r}",
            )  # fmt: skip
    return common


def _fit_figures(solution: Solution, earlier: Solution, labels: tuple[str, str]) -> Table:
    solutions = earlier, solution
    before, after = (np.array([value for _, value in figures_of_merit(compared)]) for compared in solutions)
    texts = [[f"{value:.6g}" if np.isfinite(value) else "" for value in column]
             for column in (before, after, after - before)]  # fmt: skip
    note = "" if earlier.fit.observations == solution.fit.observations else (
        "The numbers of observations differ: costs can't be compared, sigma0 can."
    )
    losses = [f"{settings.loss}, width {settings.loss_width:g}" if settings.loss_width else settings.loss
              for settings in (compared.settings for compared in solutions)]  # fmt: skip
    if losses[0] != losses[1]:  # another loss weighs the same residuals otherwise
        note = f"The losses differ ({'; now '.join(losses)}): neither costs nor sigma0 can be compared."
    return Table("merit_compared", "Figures of merit", (
        Column("figure", ["state", *(name for name, _ in figures_of_merit(solution))], page="s", text="<34"),
        *(Column(name, [first, *text], page="s", text=">14") for name, first, text in
          zip((*labels, "difference"), (*map(state_of, solutions), ""), texts, strict=True)),
    ), note)  # fmt: skip


def orientation_difference(solution: Solution, j: int, earlier: Solution, i: int) -> tuple[Array, Array]:
    """Differences (n, 6) of an image's adjusted orientation over its lines, m (body-fixed) and rad (about the camera's
    axes), and the larger of both sigmas (n, 6).
    """
    lines = np.linspace(0.0, float(solution.network.images[j].lines), PLACES)
    poses = [fit.network.images[k].pose(lines, fit.correction(k)) for fit, k in ((solution, j), (earlier, i))]
    rotations = -rotation.logarithm(poses[0].matrix @ poses[1].matrix.mT)
    profiles = [orientation_profile(fit, k, PLACES) for fit, k in ((solution, j), (earlier, i))]
    sigmas = [np.concatenate([profile.position_sigma, profile.rotation_sigma], axis=1) for profile in profiles]
    differences = np.concatenate([poses[0].position - poses[1].position, rotations], axis=1)
    return differences, np.maximum(*sigmas)


def _images_section(solution: Solution, earlier: Solution, common: list[tuple[int, int]]) -> Section:
    listed = common[:_MOST_IMAGES]
    names = [solution.network.images[j].name for j, _ in listed]
    differences = [orientation_difference(solution, j, earlier, i) for j, i in listed]
    rms = np.array([root_mean_square(difference, 0) for difference, _ in differences])
    with np.errstate(divide="ignore", invalid="ignore"):
        largest_in_sigmas = np.array([np.max(np.where(sigma > 0.0, np.abs(difference) / sigma, np.nan), axis=0)
                                      for difference, sigma in differences])
    largest = np.nanmax(np.nan_to_num(largest_in_sigmas), axis=1)  # NaN of a held image
    worst_image = int(np.argmax(largest))
    sentence = (
        f"The orientation of {many(len(listed), 'common image')} differs by at most {largest[worst_image]:.2g} sigmas "
        f"({names[worst_image]})."
    )
    note = f"Over {PLACES} lines: rms of the differences, and the largest one in sigmas; a dash: held. "
    table = table_of("images_compared", {
        "image": names, "rms_{}": rms[:, :3], "rms_turn_{}": rms[:, 3:], "largest_{}_sigmas": largest_in_sigmas[:, :3],
        "largest_turn_{}_sigmas": largest_in_sigmas[:, 3:],
    }, note=note + cut(len(common), len(listed), "the first ones", "orientation.csv"))  # fmt: skip
    return Section("images", sentences=[sentence], tables=[table])


def _points_section(points: CommonPoints) -> Section:
    new, old = len(points.solution.network.points) - points.shared, len(points.earlier.network.points) - points.shared
    counts = f"{many(points.shared, 'point')} of both, {new} new, {old} removed"
    table = moved_points(points)
    if not len(table):
        return Section("points", sentences=[f"{counts}: no point has a place in both."])
    length = np.linalg.norm(points.moved, axis=1)
    largest_in_sigmas = np.nanmax(points.in_sigmas, initial=0.0)
    sentence = (
        f"{counts}; they moved by {root_mean_square(length):.3g} m (rms), median {np.median(length):.3g} m, at most "
        f"{length.max():.3g} m and {largest_in_sigmas:.2g} sigmas."
    )
    listed = np.argsort(-length, kind="stable")[:_MOST_POINTS]
    note = table.note + cut(len(table), len(listed), "those that moved most", "the table of points")
    return Section("points", sentences=[sentence], tables=[replace(table.take(listed), note=note)], csv=[table])


def moved_points(points: CommonPoints) -> Table:
    """Every common point: how far it moved, and both sigmas."""
    later_rows, _ = points.rows
    earlier, later = points.sigmas
    classes = points.solution.network.points.classes[later_rows]
    ids = Names.of(points.solution.network.points.ids)[later_rows]
    return table_of("moved_points", {
        "point": ids, "class": picked(_CLASSES, classes), "{}": points.moved,
        "distance": np.linalg.norm(points.moved, axis=1), "distance_sigmas": points.in_sigmas,
        "sigma_earlier": earlier, "sigma_later": later,
    }, name=_POINTS)  # fmt: skip


def _sigmas_section(points: CommonPoints, labels: tuple[str, str]) -> Section:
    """Median sigmas of the common points by class, and by what factor the sigma of a point became larger."""
    classes = points.solution.network.points.classes[points.rows[0]]
    ratio, (earlier, later) = points.ratio, points.sigmas
    members = [(kind, np.flatnonzero((classes == kind) & np.isfinite(ratio))) for kind in PointClass]
    rows = [(kind, point_rows) for kind, point_rows in members if point_rows.size]
    medians = np.array([[np.median(sigmas[point_rows]) for sigmas in (earlier, later)]
                        for _, point_rows in rows]).reshape(-1, 2)
    spread = np.array([np.quantile(ratio[point_rows], _QUANTILES) for _, point_rows in rows]).reshape(-1, 3)
    table = table_of("sigmas_compared", {
        "class": [_CLASSES[kind] for kind, _ in rows],
        "points": np.array([point_rows.size for _, point_rows in rows], dtype=np.int64),
        "median_{}": Column(
            "median_{}", medians, "m", parts=labels, head="median, {}", page=".3f", label="median (m)", text=">10"
        ),
        "ratio_{}": spread,
    }, note=f"Ratio: {labels[1]} over {labels[0]}, of each point; below 1 it is better known.")  # fmt: skip
    known = ratio[np.isfinite(ratio)]
    if not known.size:
        return Section("sigmas", tables=[table])
    better, worse = (100.0 * np.count_nonzero(mask) / known.size for mask in (known < 0.99, known > 1.01))
    sentence = (
        f"3-D sigmas of common points, {labels[1]} / {labels[0]}: median {np.median(known):.3g}; {better:.0f} % of the "
        f"points are better by more than 1 %, {worse:.0f} % are worse."
    )
    return Section("sigmas", sentences=[sentence], tables=[table])


# --- before the adjustment


def settings_section(earlier: Solution, solution: Solution, labels: tuple[str, str]) -> Section:
    """Settings that differ, by the names that a case file has for them, and versions of what computed."""
    old, new = (
        dataclasses.asdict(compared.settings)
        | {f"version of {name}": version for name, version in sorted(compared.versions.items())}
        for compared in (earlier, solution)
    )
    names = [name for name in old | new if old.get(name) != new.get(name)]
    different = [name for name in names if not name.startswith("version of ")]
    sentence = f"Settings that differ: {', '.join(different)}." if different else "The solver's settings are the same."
    return Section("settings", sentences=[sentence], tables=[Table(
        "settings_compared", "Settings and versions that differ", (
            Column("setting", names, page="s", text="<28"),
            *(Column(label, ["not set" if settings.get(name) is None else str(settings[name]) for name in names],
                     page="s",
                     text=">22") for label, settings in zip(labels, (old, new), strict=True)),
        ),
    )])  # fmt: skip


def input_section(earlier: Solution, solution: Solution, labels: tuple[str, str]) -> Section:
    """Measures and a-priori sigmas that differ, by the names of points and images."""
    networks = earlier.network, solution.network
    (only_earlier, only_later), later_rows, at_other_pixel, with_other_sigma = _common_measures(*networks)
    rows = numbered(networks[0].image_names)
    common = [(rows[image.name], j) for j, image in enumerate(networks[1].images) if image.name in rows]
    earlier_index, later_index = np.array(common, dtype=np.int64).reshape(-1, 2).T
    prior_differs = np.array([_priors_differ(*networks, i, j) for i, j in common], dtype=bool)
    counts = [np.bincount(network.rays.image, minlength=len(network.images))[index]
              for network, index in zip(networks, (earlier_index, later_index), strict=True)]  # fmt: skip
    of_image = networks[1].rays.image[later_rows]
    moved_counts, weighted_counts = (np.bincount(of_image[mask], minlength=len(networks[1].images))[later_index]
                                     for mask in (at_other_pixel, with_other_sigma))
    listed = np.flatnonzero((counts[0] != counts[1]) | (moved_counts > 0) | (weighted_counts > 0) | prior_differs)
    table = Table("input_compared", "Images of other measures or a-priori sigmas", (
        *columns_of("input_compared", {"image": [networks[1].images[j].name for j in later_index[listed].tolist()]}),
        *(Column(f"measures_{label.replace(' ', '_')}", count[listed], head=f"measures, {label}", page="s", text=">18")
          for label, count in zip(labels, counts, strict=True)),
        *columns_of("input_compared", {
            "moved": moved_counts[listed], "weighted": weighted_counts[listed],
            "priors": ["other" if differs else "same" for differs in prior_differs[listed].tolist()],
        }),
    ))  # fmt: skip
    sentences = [
        f"Image measurements: {later_rows.size} in both, {only_earlier} only in {labels[0]}, {only_later} only in "
        f"{labels[1]}; {np.count_nonzero(at_other_pixel)} at another pixel, {np.count_nonzero(with_other_sigma)} with "
        "another sigma."
    ]
    if np.any(prior_differs):
        names = [networks[1].images[j].name for j in later_index[prior_differs].tolist()]
        sentences.append(f"Images of other a-priori sigmas: {some(names)}.")
    return Section("inputs", sentences=[*sentences, *_unshared_sentences(*networks)], tables=[table])


def _unshared_sentences(earlier: Network, later: Network) -> Iterator[str]:
    """Sentences about names that only the earlier, or only the later of two networks has."""
    networks = earlier, later
    for kind, names in (
        ("Images", [network.image_names for network in networks]),
        ("Shared unknowns", [[unknown.name for unknown in network.shared] for network in networks]),
        ("Shifts of profiles and terrain models", [list(network.shift_names) for network in networks]),
        ("Passes", [[pass_.name for pass_ in network.passes] for network in networks]),
    ):
        earlier_names, later_names = map(dict.fromkeys, names)
        added, removed = [name for name in later_names if name not in earlier_names], [name for name in earlier_names
                                                                                       if name not in later_names]
        parts = [f"{word}: {some(each)}" for word, each in (("new", added), ("removed", removed)) if each]
        if parts:
            yield f"{kind} that only one of both has, {'; '.join(parts)}."


def _common_measures(earlier: Network, later: Network) -> tuple[tuple[int, int], Index, Mask, Mask]:
    """How many measures of a point in an image either network has alone, the other's numbers (n,) of common ones, and
    which of these are at another place, or of another sigma; of several of a point in one image the first counts.
    """
    networks = earlier, later
    _, point_numbers = Names.united([Names.of(network.points.ids) for network in networks])
    united, image_numbers = Names.united([Names.of(network.image_names) for network in networks])
    keys = [of_point[network.rays.point] * len(united) + of_image[network.rays.image]
            for network, of_point, of_image in zip(networks, point_numbers, image_numbers, strict=True)]  # fmt: skip
    _, before, after = np.intersect1d(keys[0], keys[1], return_indices=True)
    distance = np.linalg.norm(later.rays.places[after] - earlier.rays.places[before], axis=1)
    sigmas = np.abs(later.ray_sigmas[after] / earlier.ray_sigmas[before] - 1.0).max(axis=1, initial=0.0)
    unshared = keys[0].size - before.size, keys[1].size - after.size
    return unshared, after, distance > _SAME_PIXEL, sigmas > _SAME_SIGMA


def _priors_differ(earlier: Network, later: Network, i: int, j: int) -> bool:
    """Whether an image has other a-priori sigmas, or is held in one of both only."""
    before, after = earlier.priors[i].sigmas, later.priors[j].sigmas
    held_differs = bool(earlier.held[i]) != bool(later.held[j])
    return held_differs or before.shape != after.shape or not np.allclose(before, after, rtol=_SAME_SIGMA, atol=0.0)
