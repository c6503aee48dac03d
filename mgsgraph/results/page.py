"""The report page of a solution: one HTML file without any outside address, figures and pictures as data URIs."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import solution_connectivity
from mgsgraph.case.reading import Case
from mgsgraph.errors import InputError
from mgsgraph.files.output.page import page_of, write_page
from mgsgraph.files.output.table import NONE
from mgsgraph.files.writing import require_free
from mgsgraph.network import PointClass
from mgsgraph.registration.case import CaseRegistration, register_case, registration_statements
from mgsgraph.results.comparison import compare
from mgsgraph.results.likelihood import linearity_figure
from mgsgraph.results.page_tables import inputs_table, settings_table, tables, versions_table
from mgsgraph.results.soundness import state_of
from mgsgraph.results.summary import statements
from mgsgraph.workers import called_in_workers

_TEMPLATE = "results/templates/report.html"
_SECTIONS = ("map", "registration", "orientation", "residuals", "comparison")
"""Sections of the page that have figures of the solution."""
_ENDINGS = (".html", ".htm")


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
    from mgsgraph.results.figures.page import comparison_figures, figure_tasks, sigma_figures

    compared = None if earlier is None else compare(solution, earlier)  # refused before anything is drawn
    registration = None if case is None or not case.profiles else register_case(case, solution)
    connected = solution_connectivity(solution)
    drawings = figure_tasks(solution, connected)
    if compared is not None:
        drawings.append(("comparison", partial(comparison_figures, compared.points)))
    sections, tasks = zip(*drawings, strict=True)
    with called_in_workers(tasks, "figures of the page", "give this program more memory") as drawn:
        sigmas, without_sigmas = sigma_figures(solution)
        content = {
            "solution": solution,
            "statements": statements(solution, connected),
            "key_figures": _key_figures(solution),
            "without_sigmas": without_sigmas,
            **_registered(solution, case, registration),
            "tables": tables(solution),
            "compared": compared,
            "settings": [settings_table(solution), versions_table(solution)],
            "inputs": inputs_table(inputs),
            "case_name": "" if case is None else case.path.name,
            "version": solution.versions.get("mgsgraph", NONE),
        }
        figures: dict[str, list[Any]] = {section: [] for section in _SECTIONS} | {"sigmas": sigmas}
        for section, pictures in zip(sections, drawn(), strict=True):
            figures[section] += pictures
    return content | {"figures": figures}


def _registered(solution: Solution, case: Case | None, registration: CaseRegistration | None) -> dict[str, Any]:
    """Laser footprints on the images, or why there are none."""
    if registration is None:
        return {"scenes": [], "about_scenes": "", "registered": [], "closeups": [],
                "without_scenes": _without_scenes(solution, case)}  # fmt: skip
    from mgsgraph.results.figures.page import registration_figures
    from mgsgraph.results.figures.page_scene import scenes

    shown, about = scenes(registration)
    return {
        "scenes": shown,
        "about_scenes": about,
        "registered": registration_statements(registration),
        "closeups": registration_figures(registration),
        "without_scenes": "" if shown else "No footprint falls in an image.",
    }


def _without_scenes(solution: Solution, case: Case | None) -> str:
    if case is not None:
        return f"{case.path.name} names no laser profile in [[shots]], whose footprints could be shown here."
    if np.any(solution.network.points.classes == PointClass.LASER):
        return (
            "A solution holds no pixels and no footprints as they were archived: with the case file (--case) this "
            "section shows them on the images, if the case names profiles of MOLA."
        )
    return "This solution has no laser points."


def _key_figures(solution: Solution) -> list[tuple[str, str]]:
    """What one looks at first."""
    network, fit = solution.network, solution.fit
    sigma0 = f"{fit.sigma0:.3g}" if np.isfinite(fit.sigma0) else "not defined"
    return [
        ("state", state_of(solution)),
        ("sigma0", sigma0),
        *linearity_figure(solution.linearity),
        ("cost", f"{solution.cost_initial:.4g} → {solution.cost_final:.4g}"),
        ("degrees of freedom", str(fit.degrees_of_freedom)),
        ("images", str(len(network.images))),
        ("ground points", str(len(network.points))),
        ("image measures", str(network.rays.point.size)),
        ("laser ranges", str(network.ranges.point.size)),
    ]
