"""Figures of an adjustment as PNG: residuals, orientation corrections, map.

This package is the only one that imports matplotlib; import it only where figures are wanted.
"""

from collections.abc import Callable, Iterable
from functools import partial
from itertools import chain
from pathlib import Path

from mgsgraph.adjustment.solution import Solution
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.registration.case import CaseRegistration
from mgsgraph.results.figures.closeups import closeup_sheets
from mgsgraph.results.figures.connectivity import links_sheet
from mgsgraph.results.figures.discrepancy import discrepancy_sheets
from mgsgraph.results.figures.map import map_sheets
from mgsgraph.results.figures.minima import minima_sheets
from mgsgraph.results.figures.orientation import orientation_sheets
from mgsgraph.results.figures.overlay import overlay_sheets, pixels_of
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
        Sheets of orientation (passes first), residuals, map, connectivity and minima (where there are several). They
        may be called in any order and process.
    """
    return [
        ("orientation", partial(orientation_sheets, solution)),
        ("residuals", partial(residual_sheets, solution)),
        ("map", partial(map_sheets, solution, connected)),
        ("map", lambda: [links_sheet(solution, connected)]),
        ("map", partial(minima_sheets, solution)),
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


def write_registration_figures(registration: CaseRegistration, folder: Path) -> list[str]:
    """Draw a registration: numbered footprints on each image with the heights beside it, close-ups of pairs of images,
    and the discrepancies along the images; returns the names of the files.

    Raises
    ------
    InputError
        If the pixels of an image can't be read.
    """
    pixels = [pixels_of(path) for path in registration.pictures]
    on_images = chain(overlay_sheets(registration, pixels), closeup_sheets(registration, pixels))
    return save(chain(on_images, discrepancy_sheets(registration)), folder)
