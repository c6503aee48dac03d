"""Figures of an adjustment as PNG: residuals, orientation corrections, map.

This package is the only one that imports matplotlib; import it only where figures are wanted.
"""

from collections.abc import Iterator
from pathlib import Path

from mgsgraph.adjustment.solution import Solution
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.results.figures.connectivity import links_sheets
from mgsgraph.results.figures.map import map_sheets
from mgsgraph.results.figures.orientation import orientation_sheets
from mgsgraph.results.figures.residuals import residual_sheets
from mgsgraph.results.figures.sheet import Sheet, save


def draw_figures(solution: Solution, connected: Connectivity | None = None) -> Iterator[tuple[str, Sheet]]:
    """Figures of an adjustment in the order of the report page: orientation (passes first), residuals, map.

    Parameters
    ----------
    solution : Solution
    connected : Connectivity, optional
        Of the solution; saves computing it again.

    Yields
    ------
    tuple of str and Sheet
        The section of the page, and the figure: `sheet.figure` is matplotlib's, `sheet.title` and `sheet.caption` say
        what is drawn.

    Examples
    --------
    >>> section, sheet = next(mgsgraph.draw_figures(solution))
    >>> section, sheet.name
    ('orientation', 'orientation')
    """
    for section, sheets in (
        ("orientation", orientation_sheets(solution)), ("residuals", residual_sheets(solution)),
        ("map", map_sheets(solution, connected)), ("map", links_sheets(solution, connected)),
    ):  # fmt: skip
        yield from ((section, sheet) for sheet in sheets)


def write_figures(solution: Solution, folder: Path, connected: Connectivity | None = None) -> list[str]:
    """Draw an adjustment into a folder, which is made where it does not exist; returns the names of the files."""
    return save((sheet for _, sheet in draw_figures(solution, connected)), folder)
