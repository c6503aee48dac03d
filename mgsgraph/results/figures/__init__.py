"""Figures of an adjustment, each as PNG and SVG: residuals, orientation corrections, laser registration, map.

This package is the only one that imports matplotlib; import it only where figures are wanted.
"""

from collections.abc import Callable, Iterable
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.network import PointClass
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.registration.case import CaseRegistration
from mgsgraph.results.figures.aggregate import LARGE_BLOCK
from mgsgraph.results.figures.closeups import closeup_sheets
from mgsgraph.results.figures.connectivity import links_sheet
from mgsgraph.results.figures.discrepancy import discrepancy_sheets
from mgsgraph.results.figures.ground_map import map_sheets
from mgsgraph.results.figures.minima import minima_sheets
from mgsgraph.results.figures.orientation import orientation_sheets
from mgsgraph.results.figures.overlay import overlay_sheets, pixels_of
from mgsgraph.results.figures.passes import MOST_PASSES
from mgsgraph.results.figures.registration import registration_sheets
from mgsgraph.results.figures.residuals import residual_sheets
from mgsgraph.results.figures.sheet import Sheet, save
from mgsgraph.workers import called_in_workers

FIGURES_END = "figures", "give this program more memory, or leave the figures out (--no-figures)"
"""What is said where a worker that draws ends before its time."""


def figure_tasks(
    solution: Solution, folder: Path, connected: Connectivity | None = None
) -> list[Callable[[], list[str]]]:
    """What draws an adjustment, in parts that may be called in any order and process (`workers.called_in_workers`).

    Parameters
    ----------
    solution : Solution
        What an adjustment found.
    folder : Path
        Made where it does not exist; files of the same names are replaced.
    connected : Connectivity, optional
        Of the solution, which saves finding it anew.

    Returns
    -------
    list of callable
        Each writes some figures and returns the names of their files: residuals, strips and pass (where there are
        passes), orientation, registration (where laser points are measured in images), map, connectivity and minima
        (where there are several), each as .png and, of blocks whose images are all drawn (`aggregate.LARGE_BLOCK`), as
        .svg (pictures of cells as .png alone), numbered (residuals_1, ...) where a kind takes several sheets.
    """
    rays = solution.network.rays
    laser = np.any(solution.network.points.classes[rays.point] == PointClass.LASER)
    sheets: list[Callable[[], Iterable[Sheet]]] = [
        partial(orientation_sheets, solution, MOST_PASSES),
        partial(residual_sheets, solution),
        *([partial(registration_sheets, solution)] if laser else []),
        partial(map_sheets, solution, connected),
        lambda: [links_sheet(solution, connected)],
        partial(minima_sheets, solution),
    ]
    vector = len(solution.network.images) <= LARGE_BLOCK
    return [partial(_saved, drawn, folder, vector) for drawn in sheets]


def _saved(sheets: Callable[[], Iterable[Sheet]], folder: Path, vector: bool) -> list[str]:
    """Draw and write sheets, one after another, so that no more than one is in memory."""
    return save(sheets(), folder, vector)


def write_figures(solution: Solution, folder: Path, connected: Connectivity | None = None) -> list[str]:
    """Draw an adjustment (`figure_tasks`), in worker processes; returns the names of the files."""
    with called_in_workers(figure_tasks(solution, folder, connected), *FIGURES_END) as drawn:
        return list(chain.from_iterable(drawn()))


def write_registration_figures(registration: CaseRegistration, folder: Path) -> list[str]:
    """Draw a registration: numbered footprints on each image with the heights beside it, close-ups of pairs of images,
    and the discrepancies along the images; returns the names of the files, each sheet as .png and .svg.

    Raises
    ------
    InputError
        If the pixels of an image can't be read.
    """
    pixels = [pixels_of(path) for path in registration.pictures]
    on_images = chain(overlay_sheets(registration, pixels), closeup_sheets(registration, pixels))
    return save(chain(on_images, discrepancy_sheets(registration)), folder)
