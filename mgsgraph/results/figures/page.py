"""Figures of the report page: those of the results and of a registration, each as a data URI or an SVG element."""

import base64
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.estimates import CommonPoints
from mgsgraph.analysis.places import sigma_grid
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.errors import MgsgraphError
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.registration.case import CaseRegistration
from mgsgraph.results.figures import solution_sheets
from mgsgraph.results.figures.closeups import closeup_sheets
from mgsgraph.results.figures.comparison import comparison_sheet
from mgsgraph.results.figures.discrepancy import discrepancy_sheets
from mgsgraph.results.figures.overlay import overlay_sheets, pixels_of
from mgsgraph.results.figures.sheet import (
    Sheet,
    encoded,
)
from mgsgraph.results.figures.sigmas import raster_sheet

_MOST_IMAGES = 12
"""Images up to which the sigmas of new points are mapped: each cell is projected into every one."""
_QUALITY = 80
"""Of JPEG, for sheets that are pictures."""
_LARGE = 300_000
"""Bytes of an SVG from which a PNG is tried."""
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
    """data: URI of the drawing without title and caption; empty where `svg` has it."""
    svg: str
    """The drawing as an SVG element whose text can be selected; empty where `uri` has it."""
    width: int
    """CSS pixels, true size."""
    height: int
    """CSS pixels."""


def drawn(sheets: Iterable[Sheet], as_picture: bool = False) -> list[Picture]:
    """Sheets as pictures, in order: SVG, or PNG where that is large and for pictures of cells; `as_picture`: JPEG, for
    what shows pixels. Title and caption are left to the page.
    """
    return [_drawn(sheet, as_picture) for sheet in sheets]


def _drawn(sheet: Sheet, as_picture: bool) -> Picture:
    svg = kind = ""
    if as_picture:
        kind, data = "jpeg", encoded(sheet, "jpg", words=False, quality=_QUALITY, optimize=True)
    elif not sheet.vector:
        kind, data = "png", encoded(sheet, "png", words=False)
    else:
        data = encoded(sheet, "svg", words=False, metadata={"Date": None, "Creator": None})
        if len(data) > _LARGE and len(smaller := encoded(sheet, "png", words=False)) < len(data):
            kind, data = "png", smaller
        else:
            svg = data.decode()
    width, height = (float(inch) for inch in sheet.figure.get_size_inches())
    size = (round(_CSS * width), round(_CSS * (height - sheet.above - sheet.below)))
    uri = "" if svg else data_uri(f"image/{kind}", data)
    return Picture(sheet.name, sheet.title, sheet.caption, uri, svg, *size)


def data_uri(kind: str, data: bytes) -> str:
    """A file as an address that holds it."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


# --- by the page's sections


def figure_tasks(
    solution: Solution, connected: Connectivity
) -> list[tuple[str, Callable[[], list[Picture]]]]:
    """What draws `figures.solution_sheets` as pictures, each with its section of the page."""
    return [(section, partial(_pictures, sheets)) for section, sheets in solution_sheets(solution, connected)]


def _pictures(sheets: Callable[[], Iterable[Sheet]]) -> list[Picture]:
    return drawn(sheets())


def registration_figures(registration: CaseRegistration) -> list[Picture]:
    """Footprints on images, discrepancies of pairs of images, and close-ups."""
    pixels = [pixels_of(path) for path in registration.pictures]
    overlays, closeups = (
        drawn(sheets(registration, pixels), as_picture=True) for sheets in (overlay_sheets, closeup_sheets)
    )
    return [*overlays, *drawn(discrepancy_sheets(registration)), *closeups]


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
