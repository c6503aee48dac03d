"""Figures of the report page: those of the results and, of ground points, arrows of correction; each as a data URI."""

import base64
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.overlap_sigmas import sigma_grid
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.statistics import CommonPoints
from mgsgraph.errors import MgsgraphError
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.map_plane import centre_of, east_north
from mgsgraph.geometry.records import Array
from mgsgraph.network import PointClass
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.registration.case import CaseRegistration
from mgsgraph.registration.measured import thinned
from mgsgraph.results.figures.closeups import closeup_sheets
from mgsgraph.results.figures.comparison import comparison_sheet
from mgsgraph.results.figures.connectivity import links_sheet
from mgsgraph.results.figures.discrepancy import discrepancy_sheets
from mgsgraph.results.figures.ground_map import frame, map_sheets
from mgsgraph.results.figures.minima import minima_sheets
from mgsgraph.results.figures.orientation import orientation_sheets
from mgsgraph.results.figures.overlay import pixels_of
from mgsgraph.results.figures.registration import registration_sheets
from mgsgraph.results.figures.residuals import cut, residual_sheets
from mgsgraph.results.figures.sheet import (
    CLASS_COLOUR,
    CLASS_NAME,
    MOST_MARKS,
    SOFT,
    Sheet,
    encoded,
    new_sheet,
    number,
    plain_style,
    round_figure,
)
from mgsgraph.results.figures.sigmas import raster_sheet
from mgsgraph.units import KM

_MOST_IMAGES = 12
"""Images up to which the sigmas of new points are mapped: each cell is projected into every one."""
_QUALITY = 80
"""Of JPEG, for sheets that are pictures."""
_LARGE = 300_000
"""Bytes of an SVG from which a PNG is tried."""
_CSS = 96.0
"""CSS pixels in an inch."""
_MOST_ARROWS = 800
_LONGEST = 0.5
"""inch, of the longest arrow."""
_SHARE = 0.98
"""Share of the corrections that are drawn in full."""


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
    """What draws the figures that a solution alone allows, each with the section of the page that it belongs to, in the
    order of the page; they may be called in any order and process (`workers.called_in_workers`).
    """
    rays = solution.network.rays
    laser = bool(np.any(solution.network.points.classes[rays.point] == PointClass.LASER))
    sheets: list[tuple[str, Callable[[], Iterable[Sheet]]]] = [
        ("orientation", partial(orientation_sheets, solution)),
        ("residuals", partial(residual_sheets, solution)),
        ("residuals", partial(correction_sheets, solution)),
        *([("registration", partial(registration_sheets, solution))] if laser else []),
        ("map", partial(map_sheets, solution, connected)),
        ("map", lambda: [links_sheet(solution, connected)]),
        ("map", partial(minima_sheets, solution)),
    ]
    return [(section, partial(_pictures, some)) for section, some in sheets]


def _pictures(sheets: Callable[[], Iterable[Sheet]]) -> list[Picture]:
    return drawn(sheets())


def registration_figures(registration: CaseRegistration) -> list[Picture]:
    """Close-ups and discrepancies of images about laser footprints."""
    pixels = [pixels_of(path) for path in registration.pictures]
    closeups = drawn(closeup_sheets(registration, pixels), as_picture=True)
    return [*drawn(discrepancy_sheets(registration)), *closeups]


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


# --- corrections of the ground


def correction_sheets(solution: Solution) -> Iterator[Sheet]:
    """How ground points moved on the map, and by how much upward: one sheet; none where nothing has a place, and
    none of many points, which `overview_map` has by cells.
    """
    if np.count_nonzero(solution.determined) > MOST_MARKS:
        return
    moved = local_corrections(solution)
    if np.any(np.all(np.isfinite(moved), axis=1)):
        yield _correction_sheet(solution, moved)


def local_corrections(solution: Solution) -> Array:
    """(n, 3) m, adjusted minus before, eastward, northward and upward; NaN for points without a place."""
    places = np.where(solution.determined[:, None], solution.places, solution.places_before)
    moved = np.einsum("nij,nj->ni", east_north_up(places), solution.places - solution.places_before)
    return np.asarray(np.where(solution.determined[:, None], moved, np.nan))


@plain_style()
def _correction_sheet(solution: Solution, moved: Array) -> Sheet:
    centre = centre_of(solution.places)
    places = east_north(solution.places, centre) / KM
    low, high, (width, height) = frame(places)
    present = [c for c in PointClass if solution.members(c).size]
    lengths = np.hypot(*moved[solution.determined, :2].T)
    longest = float(np.quantile(lengths, _SHARE)) or 1.0
    sheet = new_sheet(
        "corrections", width + 1.4, height + 0.7, "Corrections of the ground points",
        _correction_caption(solution, moved, present, longest),
    )  # fmt: skip
    panel: Axes = sheet.panels()[0, 0]
    panel.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    panel.set(xlabel="km east of the block's middle", ylabel="km north")
    for n, point_class in enumerate(present):
        mine = solution.members(point_class)
        mine = mine[thinned(mine.size, _MOST_ARROWS)]
        colour = CLASS_COLOUR[point_class]
        arrows = panel.quiver(
            *places[mine].T, *cut(moved[mine, :2], longest).T, color=colour, angles="uv", units="inches",
            scale_units="inches", scale=longest / _LONGEST, width=0.011, headwidth=4.5, headlength=5.0,
            headaxislength=4.5, minlength=0.2, minshaft=1.5, zorder=3,
        )
        key = round_figure(longest)
        panel.quiverkey(
            arrows, (0.75 + 2.2 * n) / (width + 1.4), sheet.band_height(), key,
            f"{CLASS_NAME[point_class]}: {number(key)} m", coordinates="figure", labelpos="E", color=colour,
        )
    panel.plot(*places[solution.determined].T, ls="", marker=".", ms=1.5, mew=0.0, color=SOFT, zorder=2)
    return sheet


def _correction_caption(
    solution: Solution, moved: Array, present: list[PointClass], longest: float
) -> str:
    parts = []
    for point_class in present:
        east, north, up = moved[solution.members(point_class)].mean(axis=0)
        parts.append(
            f"{CLASS_NAME[point_class]} by {number(float(east))} m east, {number(float(north))} m north and "
            f"{number(float(up))} m up"
        )
    many = max(solution.members(c).size for c in present) > _MOST_ARROWS
    return (
        f"Adjusted minus before, on the average {'; '.join(parts)}; arrows show the horizontal part, those longer than "
        f"{number(longest)} m are cut off" + (f"; at most {_MOST_ARROWS} of a kind are drawn." if many else ".")
    )
