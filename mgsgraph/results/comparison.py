"""A solution beside an earlier one: what differs in input and settings, what moved, by how much, and whether that is
more than was unknown; and where sigmas became smaller or larger.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.analysis.statistics import PLACES, CommonPoints
from mgsgraph.errors import InputError
from mgsgraph.files.output.csv_json import picked
from mgsgraph.files.output.folders import COMPARISON
from mgsgraph.files.output.table import Column, Table, cut
from mgsgraph.geometry import rotation
from mgsgraph.geometry.records import Array
from mgsgraph.names import Names
from mgsgraph.network import PointClass
from mgsgraph.results.comparison_input import input_section, only, settings_section
from mgsgraph.results.section import Section, write_sections
from mgsgraph.results.soundness import state_of
from mgsgraph.results.summary import figures_of_merit
from mgsgraph.text import many, root_mean_square, some

if TYPE_CHECKING:
    from mgsgraph.results.figures.sheet import Sheet

_POINTS = "points_compared"
_MOST_IMAGES = 300
"""Images whose orientation is compared."""
_MOST_POINTS = 200
"""Points listed, those that moved most."""
_TITLE = "Ground points that moved most"
_METHOD = (
    "A difference is {} minus {}. It is stated in units of the larger of both sigmas (sigma0 = 1): the solutions share "
    "observations and priors, so that the sigma of their difference isn't known from theirs."
)
_CLASSES = [kind.name.lower() for kind in PointClass]
_QUANTILES = (0.02, 0.5, 0.98)


@dataclass(frozen=True, slots=True)
class Comparison:
    """What is said about two solutions."""

    name: str
    """What the earlier one is called."""
    labels: tuple[str, str]
    """What the earlier one and the later one are called in headings."""
    section: Section
    """Sentences; tables of settings and input that differ, figures of merit, sigmas, images and points."""
    points: CommonPoints
    """The ground points that both have."""


def compare(solution: Solution, earlier: Solution, labels: tuple[str, str] = ("earlier", "this one")) -> Comparison:
    """Compare two solutions by the names of their images and points.

    Parameters
    ----------
    solution, earlier : Solution
        Differences are the first minus the second.
    labels : (str, str)
        What the earlier and the later one are called in sentences and headings.

    Raises
    ------
    InputError
        If they have no image in common, or one of them with other pixels.
    """
    shared, points = common_images(solution, earlier), CommonPoints(solution, earlier)
    images, moved, sigmas = _images(solution, earlier, shared), _points(points), _sigmas(points, labels)
    settings, inputs = settings_section(earlier, solution, labels), input_section(earlier, solution, labels)
    others = only("Images", [[image.name for image in one.network.images] for one in (earlier, solution)])
    others += [
        f"{label.capitalize()}: NOT CONVERGED, so that its sigmas mean little."
        for one, label in zip((earlier, solution), labels, strict=True) if not one.converged
    ]  # fmt: skip
    said = [_METHOD.format(labels[1], labels[0])]
    said += [sentence for one in (images, moved, sigmas, settings, inputs) for sentence in one.sentences]
    every = [_fit_figures(solution, earlier, labels)]
    every += [table for one in (sigmas, settings, inputs, images, moved) for table in one.tables if len(table)]

    def sheets() -> "list[Sheet]":
        from mgsgraph.results.figures.comparison import comparison_sheet  # matplotlib takes its time

        sheet = comparison_sheet(points, labels)
        return [] if sheet is None else [sheet]

    csv = [*(table for table in every if table.name != _POINTS), *moved.csv]
    record = {"format": 1, "names": list(labels), "statements": [*said, *others]}
    record |= {table.name: table.records() for table in every if table.name != _POINTS}
    section = Section("comparison", "", [*said, *others], every, record, csv, sheets=sheets)
    return Comparison(earlier.name, labels, section, points)


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
    names = [name for name, _ in figures_of_merit(solution)]
    before, after = (np.array([value for _, value in figures_of_merit(one)]) for one in (earlier, solution))
    states = [state_of(one) for one in (earlier, solution)]
    texts = [[f"{value:.6g}" if np.isfinite(value) else "" for value in column]
             for column in (before, after, after - before)]  # fmt: skip
    note = "" if earlier.fit.observations == solution.fit.observations else (
        "The numbers of observations differ: costs can't be compared, sigma0 can."
    )
    losses = [(one.settings.loss, one.settings.loss_width) for one in (earlier, solution)]
    if losses[0] != losses[1]:  # another loss weighs the same residuals otherwise
        words = "; now ".join(_loss(*one) for one in losses)
        note = f"The losses differ ({words}): neither costs nor sigma0 can be compared."
    return Table("merit_compared", "Figures of merit", (
        Column("figure", ["state", *names], page="s", text="<34"),
        *(Column(name, [first, *text], page="s", text=">14")
          for name, first, text in zip((*labels, "difference"), (*states, ""), texts, strict=True)),
    ), note)  # fmt: skip


def _loss(name: str, width: float | None) -> str:
    return name if width is None else f"{name}, width {width:g}"


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
    worst, where = (largest.max(), names[int(np.argmax(largest))]) if largest.max(initial=0.0) > 0.0 else (0.0, "")
    said = f"The orientation of {many(len(shown), 'common image')} differs by at most {worst:.2g} sigmas"
    said += f" ({where})." if where else "."
    note = f"Over {PLACES} lines: rms of the differences, and the largest one in sigmas; a dash: held. "
    axes, turns = ("X", "Y", "Z"), ("x", "y", "z")
    table = Table("images_compared", "Orientation of the images", (
        Column("image", names, page="s", text="<28"),
        Column("rms_{}", rms[:, :3], "m", parts=axes, head="rms {}", page=".2f", label="rms (m)", text=">8"),
        Column("rms_turn_{}", rms[:, 3:], "arcsec", parts=turns, head="rms turn {}", page=".2f",
               label="rms turn (arcsec)", text=">8"),
        Column("largest_{}_sigmas", most[:, :3], parts=axes, head="largest {} (σ)", page=".2f",
               label="largest (sigmas)", text=">7"),
        Column("largest_turn_{}_sigmas", most[:, 3:], parts=turns, head="largest turn {} (σ)", page=".2f",
               label="largest turn (sigmas)", text=">7"),
    ), note + cut(len(shared), len(shown), "the first ones", "orientation.csv"))  # fmt: skip
    return Section("images", sentences=[said], tables=[table])


def _points(points: CommonPoints) -> Section:
    new, gone = len(points.solution.network.points) - points.shared, len(points.earlier.network.points) - points.shared
    counts = f"{many(points.shared, 'point')} of both, {new} new, {gone} gone"
    table = moved_points(points)
    if not len(table):
        return Section("points", sentences=[f"{counts}: no point has a place in both."])
    length, off = np.linalg.norm(points.moved, axis=1), points.in_sigmas
    known = off[np.isfinite(off)]
    largest = f", by {known.max():.2g} sigmas at the most" if known.size else ""
    rms, half = root_mean_square(length), np.median(length)
    words = f"{counts}; they moved by {rms:.3g} m (rms), {length.max():.3g} m at the most{largest}"
    listed = np.argsort(-length, kind="stable")[:_MOST_POINTS]
    note = table.note + cut(len(table), len(listed), "those that moved most", "the table of points")
    words += f"; half of them by less than {half:.3g} m."
    return Section("points", sentences=[words], tables=[replace(table.take(listed), note=note)], csv=[table])


def moved_points(points: CommonPoints) -> Table:
    """Every common point: how far it moved, and both sigmas."""
    here, _ = points.rows
    earlier, later = points.sigmas
    classes = points.solution.network.points.classes[here]
    ids = Names.of(points.solution.network.points.ids)[here]
    return Table(_POINTS, _TITLE, (
        Column("point", ids, page="s", text="<28"),
        Column("class", picked(_CLASSES, classes), text="<8"),
        Column("{}", points.moved, "m", "later minus earlier", parts=("east", "north", "up"), head="{}", page=".2f",
               label="moved (m)", text=">9"),
        Column("distance", np.linalg.norm(points.moved, axis=1), "m", page=".2f", text=">9"),
        Column("distance_sigmas", points.in_sigmas, meaning="over the larger of both 3-D sigmas", head="over σ",
               page=".2f", label="sigmas", text=">8"),
        Column("sigma_earlier", earlier, "m", "3-D, earlier", head="σ earlier", page=".2f", label="σ earlier",
               text=">10"),
        Column("sigma_later", later, "m", "3-D, later", head="σ later", page=".2f", label="σ later", text=">9"),
    ), "Sigmas are 3-D, the root of the covariance's trace. ")  # fmt: skip


def _sigmas(points: CommonPoints, labels: tuple[str, str]) -> Section:
    """Median sigmas of the common points by class, and by what factor the sigma of a point became larger."""
    classes = points.solution.network.points.classes[points.rows[0]]
    ratio, (earlier, later) = points.ratio, points.sigmas
    members = [(kind, np.flatnonzero((classes == kind) & np.isfinite(ratio))) for kind in PointClass]
    rows = [(kind, mine) for kind, mine in members if mine.size]
    medians = np.array([[np.median(one[mine]) for one in (earlier, later)] for _, mine in rows]).reshape(-1, 2)
    spread = np.array([np.quantile(ratio[mine], _QUANTILES) for _, mine in rows]).reshape(-1, 3)
    table = Table("sigmas_compared", "3-D sigmas of the common points", (
        Column("class", [_CLASSES[kind] for kind, _ in rows], page="s", text="<8"),
        Column("points", np.array([mine.size for _, mine in rows], dtype=np.int64), page="s", text=">9"),
        Column("median_{}", medians, "m", parts=labels, head="median, {}", page=".3f", label="median (m)", text=">10"),
        Column("ratio_{}", spread, parts=("low", "median", "high"), head=("ratio, 2 %", "ratio, median", "ratio, 98 %"),
               page=".3f", label="ratio: 2 %, median, 98 %", text=">8.3f"),
    ), f"Ratio: {labels[1]} over {labels[0]}, of each point; below 1 it is better known.")  # fmt: skip
    known = ratio[np.isfinite(ratio)]
    if not known.size:
        return Section("sigmas", tables=[table])
    better, worse = (100.0 * np.count_nonzero(side) / known.size for side in (known < 0.99, known > 1.01))
    said = (
        f"3-D sigmas of the common points, {labels[1]} over {labels[0]}: median {np.median(known):.3g}; {better:.0f} % "
        f"of the points are better known by more than 1 %, {worse:.0f} % are worse known."
    )
    return Section("sigmas", sentences=[said], tables=[table])


def write_comparison(found: Comparison, folder: Path, figures: bool = True) -> list[str]:
    """Write comparison.json, a CSV file for each table (of all common points, not only those that moved most) and the
    map of differences to a folder that appears whole or not at all; the names of the files.

    Raises
    ------
    InputError
        If the folder holds anything but an earlier comparison, or can't be written.
    """
    return write_sections([found.section], found.section.numbers, folder, COMPARISON, figures)
