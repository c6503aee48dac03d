"""Corrections of the exterior orientation along the image, with their 1-sigma bands."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mgsgraph.adjustment.solution import OrientationProfile, Solution, orientation_profile
from mgsgraph.geometry.records import Array
from mgsgraph.results.figures.aggregate import LARGE_BLOCK
from mgsgraph.results.figures.overview import middle_corrections, orientation_overview, strangeness
from mgsgraph.results.figures.passes import largest_correlation, pass_sheets
from mgsgraph.results.figures.sheet import (
    AFTER,
    MOST_SHEETS,
    SOFT,
    Sheet,
    in_sheets,
    left_out,
    new_sheet,
    number,
    plain_style,
    sheet_name,
    short,
)
from mgsgraph.units import ARCSEC

_PER_SHEET = 4
_FARTHEST, _NEAREST = 6, 2
"""Images of a large block that are drawn one by one, by their corrections in robust sigmas from the block's median."""
_PLACES = 101
_ROWS = ("X (m)", "Y (m)", "Z (m)", "about x\n(arcsec)", "about y\n(arcsec)", "about z\n(arcsec)")


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """One column of a sheet: an image with an orientation of its own."""

    title: str
    """Name."""
    places: Array
    """(n,) lines."""
    curves: list[tuple[Array, Array]]
    """Correction and sigma (n,) of three positions in m and three rotations in arcsec."""
    coupling: float
    """Largest correlation between a position and a rotation."""
    held: bool = False
    """Not adjusted."""


def orientation_sheets(solution: Solution, most_passes: int = MOST_SHEETS) -> Iterator[Sheet]:
    """Sheets of passes (`figures.passes`), then sheets of up to four images on their own; of a large block all of
    these on one sheet, and a choice of them on two.
    """
    yield from pass_sheets(solution, most_passes)
    own = np.flatnonzero(solution.network.pass_of < 0).tolist()
    chosen, which = own, ""
    if len(own) > LARGE_BLOCK:
        found = middle_corrections(solution, own)
        yield orientation_overview(found)
        order = np.argsort(-strangeness(found), kind="stable")
        chosen = sorted(np.array(own)[[*order[:_FARTHEST], *order[-_NEAREST:]]].tolist())
        which = f"{_FARTHEST} farthest from the block's median and {_NEAREST} nearest to it"
    sheets, omitted = in_sheets(chosen, _PER_SHEET), left_out(len(own), len(chosen), which)
    for n, some in enumerate(sheets):
        columns = [drawn_image(solution, k) for k in some]
        yield _sheet(columns, sheet_name("orientation", n + 1, len(sheets)), omitted)


@plain_style()
def _sheet(columns: Sequence[Drawn], name: str, omitted: str) -> Sheet:
    caption = _caption(columns) + omitted + "."
    width = max(7.2, 0.9 + 3.1 * len(columns))
    sheet = new_sheet(name, width, 8.4, "Corrections of the exterior orientation", caption)
    grid = sheet.panels(6, len(columns), sharex="col", sharey="row")
    for c, column in enumerate(columns):
        for n in range(6):
            _draw(grid[n, c], column, n)
        grid[0, c].set_title(short(column.title, 34))
        grid[5, c].set_xlabel("line (px)")
    for panel, what in zip(grid[:, 0], _ROWS, strict=True):
        panel.set_ylabel(what)
    handles: list[Artist] = [
        Line2D([], [], color=AFTER, label="adjusted minus nominal"),
        Patch(color=AFTER, alpha=0.22, lw=0.0, label="± 1 sigma (sigma0 = 1)"),
    ]
    if any(column.held for column in columns):
        handles[1:1] = [Line2D([], [], color=SOFT, ls="--", label="held at nominal")]
    sheet.legend(handles)
    return sheet


def drawn_image(solution: Solution, image: int) -> Drawn:
    """An image with an orientation of its own, over its lines."""
    profile = orientation_profile(solution, image, _PLACES)
    return Drawn(
        solution.network.images[image].name, profile.lines, components(profile), coupling(solution, image),
        bool(solution.network.held[image]),
    )  # fmt: skip


def components(profile: OrientationProfile) -> list[tuple[np.ndarray, np.ndarray]]:
    """Correction and sigma (n,) of X, Y, Z in m and of the rotations about the camera's x, y, z in arcsec."""
    shift = profile.position_after - profile.position_before
    position = [(shift[:, k], profile.position_sigma[:, k]) for k in range(3)]
    rotation = [(profile.rotation[:, k] / ARCSEC, profile.rotation_sigma[:, k] / ARCSEC) for k in range(3)]
    return position + rotation


def coupling(solution: Solution, image: int) -> float:
    """Largest correlation between a constant position correction and a constant rotation of an image; 0 when held."""
    return largest_correlation(solution.image_covariance(image)[:6, :6])


def _draw(panel: Axes, column: Drawn, n: int) -> None:
    value, sigma = column.curves[n]
    panel.set_xlim(column.places[0], column.places[-1])
    panel.locator_params(axis="both", nbins=5)
    if column.held:
        panel.plot(column.places, value, color=SOFT, ls="--")
        return
    panel.axhline(0.0, color=SOFT, lw=0.8, zorder=1)
    panel.fill_between(column.places, value - sigma, value + sigma, color=AFTER, alpha=0.22, lw=0.0)
    panel.plot(column.places, value, color=AFTER)


def _caption(columns: Sequence[Drawn]) -> str:
    """What one sees, with figures."""
    free = [column.curves for column in columns if not column.held]
    if not free:
        return "All images drawn here are held, so that their orientation is the nominal one and has no sigma"
    largest = [[max(float(np.abs(one[k][part]).max()) for one in free) for k in range(6)] for part in (0, 1)]
    (shift, turn), (spread, twist) = [(max(part[:3]), max(part[3:])) for part in largest]
    held = sum(column.held for column in columns)
    kept = f"; held at nominal: {held}" if held else ""
    most = max(column.coupling for column in columns)
    return (
        f"Positions (body-fixed X, Y, Z) moved by up to {number(shift)} m and the camera turned by up to "
        f"{number(turn)} arcsec about its own axes, while their sigmas reach {number(spread)} m and {number(twist)} "
        f"arcsec; position and rotation of an image are correlated by up to {most:.3f}, so that one may stand for the "
        f"other{kept}"
    )
