"""Figures of an adjustment, each as PNG and SVG: residuals, orientation corrections, laser registration, map.

This package is the only one that imports matplotlib; import it only where figures are wanted.
"""

from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.figures.adjacency import links_sheet
from mgsgraph.figures.closeups import closeup_sheets
from mgsgraph.figures.discrepancy import discrepancy_sheets
from mgsgraph.figures.ground_map import map_sheets
from mgsgraph.figures.minima import minima_sheets
from mgsgraph.figures.orientation import orientation_sheets
from mgsgraph.figures.overlay import overlay_sheets, pixels_of
from mgsgraph.figures.passes import MOST_PASSES
from mgsgraph.figures.registration import registration_sheets
from mgsgraph.figures.residuals import residual_sheets
from mgsgraph.figures.sheet import Sheet, save
from mgsgraph.network import PointClass
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.registration.case import CaseRegistration
from mgsgraph.registration.measured import registration_discrepancy as registration_discrepancy
from mgsgraph.registration.measured import registration_offsets as registration_offsets


def write_figures(solution: Solution, folder: Path, connected: Connectivity | None = None) -> list[str]:
    """Draw an adjustment.

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
    list of str
        Names of the files in the folder: residuals, strips and pass (where there are passes), orientation, registration
        (where laser points are measured in images), map, connectivity and minima (where there are several), each as
        .png and .svg, numbered (residuals_1, ...) where a kind takes several sheets.
    """
    return save(_sheets(solution, connected), folder)


def _sheets(solution: Solution, connected: Connectivity | None) -> Iterator[Sheet]:
    """One after another, so that no more than one is in memory."""
    yield from residual_sheets(solution)
    yield from orientation_sheets(solution, MOST_PASSES)
    rays = solution.network.rays
    if np.any(solution.network.points.classes[rays.point] == PointClass.LASER):
        yield from registration_sheets(solution)
    yield from map_sheets(solution, connected)
    yield links_sheet(solution, connected)
    yield from minima_sheets(solution)


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
