"""Figures of an adjustment as PNG: residuals, orientation corrections, map.

This package is the only one that imports matplotlib; import it only where figures are wanted.
"""

from collections.abc import Iterator
from pathlib import Path

from mgsgraph.adjustment.solution import Solution
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.results.figures.connectivity import links_sheet
from mgsgraph.results.figures.map import map_sheets
from mgsgraph.results.figures.orientation import orientation_sheets
from mgsgraph.results.figures.residuals import residual_sheets
from mgsgraph.results.figures.sheet import Sheet, save


def solution_sheets(solution: Solution, connected: Connectivity | None = None) -> Iterator[tuple[str, Sheet]]:
    """Sheets of an adjustment, each with the section of the report page that it belongs to, in the page's order:
    orientation (passes first), residuals, map and connectivity; `connected`, of the solution, saves finding it anew.
    """
    for section, sheets in (
        ("orientation", orientation_sheets(solution)), ("residuals", residual_sheets(solution)),
        ("map", map_sheets(solution, connected)), ("map", [links_sheet(solution, connected)]),
    ):  # fmt: skip
        yield from ((section, sheet) for sheet in sheets)


def write_figures(solution: Solution, folder: Path, connected: Connectivity | None = None) -> list[str]:
    """Draw an adjustment into a folder, which is made where it does not exist; returns the names of the files."""
    return save((sheet for _, sheet in solution_sheets(solution, connected)), folder)
