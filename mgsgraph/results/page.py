"""The report page of a solution: one HTML file without any outside address, figures and pictures as data URIs."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import solution_connectivity
from mgsgraph.case.reading import Case
from mgsgraph.errors import InputError
from mgsgraph.files.output.table import NONE, Column, Table, cut, picked
from mgsgraph.files.writing import page_of, require_free, write_page
from mgsgraph.registration.case import register_case
from mgsgraph.results.comparison import compare
from mgsgraph.results.registration import registration_section
from mgsgraph.results.results import figures_of_merit, sentences_of, solution_sections, value_text
from mgsgraph.results.section import Section
from mgsgraph.results.tables import points_table, residuals_table
from mgsgraph.results.verdict import state_of

_TEMPLATE = "results/templates/report.html"
_SECTIONS = ("map", "orientation", "residuals", "comparison")
"""Sections of the page that have figures of the solution."""
_ENDINGS = (".html", ".htm")
MOST_ROWS = 1000
"""Rows of one table; the CSV files have all."""
_MOST_MEASURES = 300
"""Measures listed, those that fit worst."""


def write_report(
    solution: Solution,
    path: str | Path,
    case: Case | None = None,
    earlier: Solution | None = None,
    inputs: Mapping[str, str | None] | None = None,
    lead: str = "",
) -> Path:
    """Write the page.

    Parameters
    ----------
    solution : Solution
        Converged or not; one that is not is marked as no result.
    path : path
        HTML file; an earlier report is replaced.
    case : Case, optional
        What was adjusted: with its images' pixels and its laser profiles, footprints are shown on the images.
    earlier : Solution, optional
        To be compared with, by the names of images and points.
    inputs : mapping, optional
        SHA-256 of each file that the page is made from, by its name; None for one that can't be read.
    lead : str
        Sentence that stands before everything else.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If `path` is no HTML file or can't be written, the case is another one, or nothing can be compared.

    Examples
    --------
    >>> mgsgraph.write_report(solution, "report.html").name
    'report.html'
    """
    path = require_page(path)
    write_page(_TEMPLATE, _content(solution, case, earlier, inputs or {}) | {"lead": lead}, path)
    return path


def require_page(path: str | Path) -> Path:
    """The path if it is that of an HTML file, absent or an earlier report; InputError for any other."""
    path = Path(path)
    if path.suffix.lower() not in _ENDINGS:
        raise InputError(str(path), f"the ending {path.suffix!r}", "a page (.html)", "choose another --out")
    require_free(path, page_of(_TEMPLATE), remedy="choose another --out")
    return path


def _content(
    solution: Solution, case: Case | None, earlier: Solution | None, inputs: Mapping[str, str | None]
) -> dict[str, Any]:
    """Everything that the template shows."""
    from mgsgraph.results.figures.page import comparison_figures, registration_figures, solution_figures

    compared = None if earlier is None else compare(solution, earlier)  # refused before anything is drawn
    registration = None if case is None or not case.profiles else register_case(case, solution)
    connected = solution_connectivity(solution)
    sections = solution_sections(solution, connected)
    figures: dict[str, list[Any]] = {section: [] for section in _SECTIONS}
    for section, picture in solution_figures(solution, connected):
        figures[section].append(picture)
    if compared is not None:
        figures["comparison"] = comparison_figures(compared.points)
    return {
        "solution": solution,
        "statements": sentences_of(sections),
        "key_figures": _key_figures(solution),
        "registered": None if registration is None else registration_section(registration),
        "footprints": [] if registration is None else registration_figures(registration),
        "tables": tables(solution, sections),
        "compared": compared,
        "settings": _settings_tables(solution),
        "inputs": _two_columns("inputs", "Files that this page was made from", ("file", "SHA-256"), {
            name: checksum or "could not be read" for name, checksum in inputs.items()
        }),
        "case_name": "" if case is None else case.path.name,
        "version": solution.versions.get("mgsgraph", NONE),
        "figures": figures,
    }


def _key_figures(solution: Solution) -> list[tuple[str, str]]:
    """Key figures: names and values as text."""
    linear = solution.linearity
    return [
        ("state", state_of(solution)),
        *([] if linear is None else [("linear", f"{'yes' if linear.linear else 'NO'} ({linear.ratio:.3g})")]),
        *((name, value_text(value)) for name, value in figures_of_merit(solution)),
    ]


# --- tables


def tables(solution: Solution, sections: Sequence[Section]) -> list[Table]:
    """All tables of a solution that have rows."""
    section_tables = [_shortened(table) for section in sections for table in section.tables]
    return [table for table in [*section_tables, _worst_measures(solution), _listed_points(solution)] if len(table)]


def _shortened(table: Table) -> Table:
    rows = np.arange(min(len(table), MOST_ROWS))
    return replace(table.take(rows), note=table.note + cut(len(table), rows.size, "the first ones", "solution.json"))


def _worst_measures(solution: Solution) -> Table:
    """Measures that fit worst, in units of their sigmas."""
    rays = solution.network.rays
    ratio = np.max(np.abs(solution.residuals / solution.network.ray_sigmas), axis=1) if rays.point.size else np.zeros(0)
    finite = np.flatnonzero(np.isfinite(ratio))
    chosen = finite[np.argsort(-ratio[finite], kind="stable")][:_MOST_MEASURES]
    table = residuals_table(solution).take(chosen)
    state = picked(("rejected", "used"), solution.rays_used[chosen].astype(np.int64))
    extra = Column("largest", ratio[chosen], head="largest over σ", page=".2f"), Column("state", state, page="s")
    pairs = [f"{part}_{axis}" for part in ("residual_before", "residual", "sigma") for axis in ("line", "sample")]
    note = (
        "Lines and samples as ISIS counts them, the first pixel's centre at (1, 1); residuals are measured minus "
        "predicted. " + cut(rays.point.size, chosen.size, "those with the largest residual over its sigma",
                            "the table of residuals")
    )  # fmt: skip
    shown = table.pick("point", "class", "image", "isis_line", "isis_sample", *pairs)
    units = {"isis_line": "px", "isis_sample": "px"}
    columns = (replace(column, unit=units.get(column.key, column.unit)) for column in shown.columns)
    return replace(table, title="Image measures that fit worst", columns=(*columns, *extra), note=note)


def _listed_points(solution: Solution) -> Table:
    """Points in their own order: all, or those without a place and those of the largest sigma."""
    total_sigma = np.nan_to_num(np.linalg.norm(solution.sigmas, axis=1), nan=np.inf)
    chosen = np.sort(np.argsort(-total_sigma, kind="stable")[:MOST_ROWS])
    table = points_table(solution, chosen)
    selection = "those that nothing determines and those of the largest sigma"
    note = table.note + cut(len(solution.network.points), chosen.size, selection, "the table of points")
    return replace(table.last("rays_used", "state"), note=note)


# --- how it was made


def _settings_tables(solution: Solution) -> list[Table]:
    """Settings of the solver, by the names that a case file has for them; versions, and the time of each stage."""
    settings = dataclasses.asdict(solution.settings)
    about_run = {**solution.versions, **{f"{stage} (s)": f"{time:.2f}" for stage, time in solution.seconds.items()}}
    return [_two_columns("settings", "Settings of the solver", ("setting", "value"), settings),
            _two_columns("versions", "Versions and wall time", ("what", "value"), about_run)]  # fmt: skip


def _two_columns(name: str, title: str, heads: tuple[str, str], values: Mapping[str, Any]) -> Table:
    texts = ["" if value is None else str(value) for value in values.values()]
    return Table(name, title, (Column(heads[0], list(values), page="s"), Column(heads[1], texts, page="s")))
