"""Figures of the report page: those of the results and of a registration, each as a data URI."""

import base64
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.estimates import CommonPoints
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.registration.case import CaseRegistration
from mgsgraph.results.figures import draw_figures
from mgsgraph.results.figures.map import comparison_sheet
from mgsgraph.results.figures.registration import discrepancy_sheets, overlay_sheets
from mgsgraph.results.figures.sheet import Sheet, encoded

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


def pictures_of(sheets: Iterable[Sheet], as_picture: bool = False) -> list[Picture]:
    """Sheets as pictures, in order: PNG, or JPEG for what shows pixels. Title and caption are left to the page."""
    encoding: dict[str, Any] = {"kind": "jpg", "quality": _QUALITY} if as_picture else {"kind": "png"}
    pictures = []
    for sheet in sheets:
        data = base64.b64encode(encoded(sheet, with_text=False, optimize=True, **encoding)).decode()
        width, height = (float(inch) for inch in sheet.figure.get_size_inches())
        size = round(_CSS * width), round(_CSS * (height - sheet.above - sheet.below))
        uri = f"data:image/{'jpeg' if as_picture else 'png'};base64,{data}"
        pictures.append(Picture(sheet.name, sheet.title, sheet.caption, uri, *size))
    return pictures


# --- by the page's sections


def solution_figures(solution: Solution, connected: Connectivity) -> list[tuple[str, Picture]]:
    """`figures.draw_figures` as pictures, each with its section of the page."""
    return [(section, pictures_of([sheet])[0]) for section, sheet in draw_figures(solution, connected)]


def registration_figures(registration: CaseRegistration) -> list[Picture]:
    """Footprints on images, and discrepancies of pairs of images."""
    return [*pictures_of(overlay_sheets(registration), as_picture=True), *pictures_of(discrepancy_sheets(registration))]


def comparison_figures(points: CommonPoints) -> list[Picture]:
    """The map of the differences from an earlier solution; none of fewer than three common points."""
    sheet = comparison_sheet(points, ("the earlier one", "this one"))
    return pictures_of([] if sheet is None else [sheet])
