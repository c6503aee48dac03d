"""Figures of the report page: those of the results and of a registration, each as a data URI."""

import base64
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.overlap_sigmas import sigma_grid
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.statistics import CommonPoints
from mgsgraph.errors import MgsgraphError
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.registration.case import CaseRegistration
from mgsgraph.results.figures import solution_sheets
from mgsgraph.results.figures.map import comparison_sheet
from mgsgraph.results.figures.registration import discrepancy_sheets, overlay_sheets
from mgsgraph.results.figures.sheet import (
    Sheet,
    encoded,
)
from mgsgraph.results.figures.sigmas import raster_sheet

_MOST_IMAGES = 12
"""Images up to which the sigmas of new points are mapped: each cell is projected into every one."""
_QUALITY = 80
"""Of JPEG, for sheets that are pictures."""
_CSS = 96.0
"""CSS pixels in an inch."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure on the page."""

    name: str
    """As the file of this figure is called in the results."""
    title: str
    """Its title."""
    caption: str
    """What one sees, for those who can't see it."""
    uri: str
    """data: URI of the drawing without title and caption."""
    width: int
    """CSS pixels, true size."""
    height: int
    """CSS pixels."""


def drawn(sheets: Iterable[Sheet], as_picture: bool = False) -> list[Picture]:
    """Sheets as pictures, in order: PNG, or JPEG for what shows pixels. Title and caption are left to the page."""
    how: dict[str, Any] = {"kind": "jpg", "quality": _QUALITY} if as_picture else {"kind": "png"}
    found = []
    for sheet in sheets:
        data = base64.b64encode(encoded(sheet, words=False, optimize=True, **how)).decode()
        width, height = (float(inch) for inch in sheet.figure.get_size_inches())
        size = round(_CSS * width), round(_CSS * (height - sheet.above - sheet.below))
        uri = f"data:image/{'jpeg' if as_picture else 'png'};base64,{data}"
        found.append(Picture(sheet.name, sheet.title, sheet.caption, uri, *size))
    return found


# --- by the page's sections


def figure_tasks(
    solution: Solution, connected: Connectivity
) -> list[tuple[str, Callable[[], list[Picture]]]]:
    """What draws `figures.solution_sheets` as pictures, each with its section of the page."""
    return [(section, partial(_pictures, sheets)) for section, sheets in solution_sheets(solution, connected)]


def _pictures(sheets: Callable[[], Iterable[Sheet]]) -> list[Picture]:
    return drawn(sheets())


def registration_figures(registration: CaseRegistration) -> list[Picture]:
    """Footprints on images, and discrepancies of pairs of images."""
    return [*drawn(overlay_sheets(registration), as_picture=True), *drawn(discrepancy_sheets(registration))]


def comparison_figures(points: CommonPoints) -> list[Picture]:
    """The map of the differences from an earlier solution; none of fewer than three common points."""
    sheet = comparison_sheet(points, ("the earlier one", "this one"))
    return drawn([] if sheet is None else [sheet])


def sigma_figures(solution: Solution) -> tuple[list[Picture], str]:
    """Maps of the sigmas that new points would have; without them, a sentence that says why."""
    count = len(solution.network.images)
    if not 2 <= count <= _MOST_IMAGES:
        return [], (
            f"Sigmas of new points are mapped for 2 to {_MOST_IMAGES} images, and there are {count}: "
            "`mgsgraph analyze --raster --image ...` maps those of your choice."
        )
    try:
        grid = sigma_grid(Posterior.of(solution))
    except MgsgraphError as error:
        return [], f"Sigmas of new points can't be mapped: {error}."
    return drawn([raster_sheet(grid, "sigma_map")], as_picture=True), ""
