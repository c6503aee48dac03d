"""Figures of an adjustment as PNG: residuals, orientation corrections, map.

This package is the only one that imports matplotlib; import it only where figures are wanted.
"""

from collections.abc import Callable, Iterable
from functools import partial
from itertools import chain
from pathlib import Path

from mgsgraph.adjustment.solution import Solution
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.results.figures.connectivity import links_sheet
from mgsgraph.results.figures.map import map_sheets
from mgsgraph.results.figures.orientation import orientation_sheets
from mgsgraph.results.figures.residuals import residual_sheets
from mgsgraph.results.figures.sheet import Sheet, save
from mgsgraph.workers import called_in_workers

FIGURES_END = "figures", "give this program more memory, or leave the figures out (--no-figures)"
"""What is said where a worker that draws ends before its time."""


def solution_sheets(
    solution: Solution, connected: Connectivity | None = None
) -> list[tuple[str, Callable[[], Iterable[Sheet]]]]:
    """What draws an adjustment, each with the section of the report page that it belongs to, in the page's order.

    Parameters
    ----------
    solution : Solution
        What an adjustment found.
    connected : Connectivity, optional
        Of the solution, which saves finding it anew.

    Returns
    -------
    list of (str, callable)
        Sheets of orientation (passes first), residuals, map and connectivity. They may be called in any order and
        process.
    """
    return [
        ("orientation", partial(orientation_sheets, solution)),
        ("residuals", partial(residual_sheets, solution)),
        ("map", partial(map_sheets, solution, connected)),
        ("map", lambda: [links_sheet(solution, connected)]),
    ]


def figure_tasks(
    solution: Solution, folder: Path, connected: Connectivity | None = None
) -> list[Callable[[], list[str]]]:
    """What draws `solution_sheets` into a folder, which is made where it does not exist: each writes some figures as
    PNG, one after another in memory, and returns the names of the files (`workers.called_in_workers`).
    """
    return [partial(_saved, sheets, folder) for _, sheets in solution_sheets(solution, connected)]


def _saved(sheets: Callable[[], Iterable[Sheet]], folder: Path) -> list[str]:
    return save(sheets(), folder)


def write_figures(solution: Solution, folder: Path, connected: Connectivity | None = None) -> list[str]:
    """Draw an adjustment (`figure_tasks`), in worker processes; returns the names of the files."""
    with called_in_workers(figure_tasks(solution, folder, connected), *FIGURES_END) as drawn:
        return list(chain.from_iterable(drawn()))
