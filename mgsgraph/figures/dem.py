"""A terrain model drawn: heights with shading, sigma, the laser shots that check it over the ortho image."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LightSource, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, NullLocator
from numpy.typing import NDArray

from mgsgraph.dem.checking import check_figures
from mgsgraph.dem.model import Dem
from mgsgraph.figures.sheet import (
    AFTER,
    INK,
    MOST_MARKS,
    SOFT,
    Sheet,
    legend,
    new_sheet,
    number,
    panels,
    plain_style,
    save,
    short,
    words,
)
from mgsgraph.geometry.records import Array
from mgsgraph.io.pictures import open_raster
from mgsgraph.units import KM
from mgsgraph.wording import many, some

_MOST_POSTS = 1200
"""Rows or columns that are drawn; of larger models every so many-th."""
_TALL, _WIDE, _NARROW, _LOW = 7.0, 3.0, 1.45, 2.4
"""inch, height and width of a map at most, and at least."""
_BESIDE, _LETTERS = 2.3, 3.2
"""inch, width of the panel of differences, and room for labels beside the panels in all."""
_BAR, _ROOM = 0.11, 0.62
"""inch, height of a colour bar, and room above the panels for bars with their labels."""
_SHOWN = (0.02, 0.98)
"""Quantiles to which colours reach."""


def write_dem_figure(dem: Dem, folder: Path) -> list[str]:
    """Write dem.png and dem.svg to a folder that has the ortho image already; their names."""
    with plain_style():
        return save(dem_sheet(dem, _small(folder / "ortho.tif")), folder)


def _small(path: Path) -> NDArray[np.uint8]:
    """An ortho image as it is drawn."""
    with open_raster(path, "the ortho image") as file:
        step = max(1.0, max(file.shape) / _MOST_POSTS)
        found: NDArray[np.uint8] = file.read(1, out_shape=tuple(max(1, round(size / step)) for size in file.shape))
    return found


def dem_sheet(dem: Dem, ortho: NDArray[np.uint8]) -> Sheet:
    """Shaded heights, sigma, and the laser shots: where they lie on the ortho image (0 where there is none), and by how
    much the model is higher.
    """
    grid = dem.model.map
    height = float(np.clip(_WIDE * grid.rows / grid.columns, _LOW, _TALL))
    width = float(np.clip(height * grid.columns / grid.rows, _NARROW, _WIDE))
    sheet = new_sheet(
        "dem", 3.0 * width + _BESIDE + _LETTERS, height + _ROOM + 0.7, f"Terrain model: {short(dem.name, 60)}",
        _caption(dem),
    )  # fmt: skip
    where, sigma, checks, along = panels(sheet, 1, 4, across=0.7, widths=[width] * 3 + [_BESIDE])[0]
    share = _ROOM / float(sheet.figure.get_figheight())
    for panel in (where, sigma, checks, along):
        box = panel.get_position()
        panel.set_position((box.x0, box.y0, box.width, box.height - share))
    step = max(1, -(-max(grid.rows, grid.columns) // _MOST_POSTS))
    heights = dem.heights[::step, ::step]
    _heights(sheet, where, dem, heights, step)
    _sigmas(sheet, sigma, dem, step)
    _shots(sheet, checks, dem, ortho)
    _differences(along, dem)
    legend(sheet.figure, [
        Line2D([], [], color=AFTER, marker="o", ls="", ms=3.5, label="laser shots that took no part"),
        Line2D([], [], color=SOFT, lw=1.0, label="stated sigma of a difference, once and three times"),
    ])  # fmt: skip
    return sheet


def _extent(dem: Dem) -> tuple[float, float, float, float]:
    """km: west, east, south, north of the map."""
    grid = dem.model.map
    east, south = grid.west + grid.columns * grid.post, grid.north - grid.rows * grid.post
    return grid.west / KM, east / KM, south / KM, grid.north / KM


def _norm(values: Array) -> Normalize:
    low, high = np.nanquantile(values, _SHOWN)
    return Normalize(float(low), float(max(high, low + 1e-9)))


def _heights(sheet: Sheet, panel: Axes, dem: Dem, heights: Array, step: int) -> None:
    norm, post = _norm(heights), dem.model.map.post * step
    light = LightSource(315.0, 45.0)
    flat = np.where(np.isfinite(heights), heights, np.nanmean(heights))
    colours = np.asarray(_map("gist_earth", norm).to_rgba(flat))[:, :, :3]
    tall = 1.0 / max(float(np.nanstd(np.gradient(flat, post)[0])) * 4.0, 1e-9)  # slopes that can be seen
    shaded = light.shade_rgb(colours, flat, vert_exag=min(tall, 10.0), dx=post, dy=post, blend_mode="soft")
    shaded = np.dstack([shaded, np.isfinite(heights)])
    panel.imshow(shaded, extent=_extent(dem), interpolation="nearest", aspect="equal")
    _bar(sheet, panel, _map("gist_earth", norm), f"above {dem.reference.split(' of ')[0]} (m)")
    _axes(panel, dem, True)


def _map(name: str, norm: Normalize) -> ScalarMappable:
    return ScalarMappable(norm, name)


def _sigmas(sheet: Sheet, panel: Axes, dem: Dem, step: int) -> None:
    sigmas = np.ma.masked_invalid(np.where(np.isfinite(dem.heights), dem.model.sigmas, np.nan)[::step, ::step])
    norm = _norm(sigmas.filled(np.nan))
    panel.imshow(sigmas, extent=_extent(dem), cmap="viridis", norm=norm, interpolation="nearest", aspect="equal")
    _bar(sheet, panel, _map("viridis", norm), "sigma of height (m)")
    _axes(panel, dem, False)


def _shots(sheet: Sheet, panel: Axes, dem: Dem, ortho: NDArray[np.uint8]) -> None:
    checks = dem.checks
    grey = np.ma.masked_equal(ortho, 0)
    panel.imshow(grey, extent=_extent(dem), cmap="Greys_r", vmin=0, vmax=255, interpolation="nearest", aspect="equal")
    widest = float(np.quantile(np.abs(checks.differences), 0.98)) if len(checks) else 1.0
    norm = Normalize(-max(widest, 1e-9), max(widest, 1e-9))
    some = _some(len(checks))
    panel.scatter(
        checks.plane[some, 0] / KM, checks.plane[some, 1] / KM, c=checks.differences[some], cmap="RdBu_r", norm=norm,
        s=9.0, edgecolors=INK, linewidths=0.2, zorder=3,
    )  # fmt: skip
    if len(checks):
        _bar(sheet, panel, _map("RdBu_r", norm), "model minus shot (m)")
    _axes(panel, dem, False)


def _differences(panel: Axes, dem: Dem) -> None:
    checks = dem.checks
    order = np.argsort(checks.plane[:, 1])
    some = order[_some(order.size)]
    for times in (-3.0, -1.0, 1.0, 3.0):
        panel.plot(times * checks.sigmas[some], checks.plane[some, 1] / KM, color=SOFT, lw=0.8)
    panel.plot(checks.differences[some], checks.plane[some, 1] / KM, "o", ms=2.2, color=AFTER)
    _, _, south, north = _extent(dem)
    panel.set_ylim(south, north)
    if not len(checks):
        panel.text(0.5, 0.5, "no laser shot\nto check by", ha="center", va="center", transform=panel.transAxes)
    panel.xaxis.set_major_locator(MaxNLocator(4) if len(checks) else NullLocator())
    words(panel, "model minus shot (m)", "", "")


def _some(count: int) -> slice:
    return slice(None, None, max(1, -(-count // MOST_MARKS)))


def _axes(panel: Axes, dem: Dem, first: bool) -> None:
    """The whole map, in a frame as wide as its panel."""
    assert isinstance(panel.figure, Figure)
    west, east, south, north = _extent(dem)
    box, (width, height) = panel.get_position(), panel.figure.get_size_inches()
    shape = box.width * width / (box.height * height)
    half = 0.5 * np.array([max(east - west, (north - south) * shape), max(north - south, (east - west) / shape)])
    middle = 0.5 * np.array([west + east, south + north])
    (left, below), (right, above) = middle - half, middle + half
    panel.set(xlim=(left, right), ylim=(below, above))
    panel.grid(visible=False)
    panel.xaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
    panel.yaxis.set_major_locator(MaxNLocator(7, steps=[1, 2, 5, 10]))
    words(panel, "east (km)", "north of the middle (km)" if first else "")


def _bar(sheet: Sheet, panel: Axes, shown: ScalarMappable, what: str) -> None:
    """A colour bar above a panel."""
    box, inch = panel.get_position(), 1.0 / float(sheet.figure.get_figheight())
    axes = sheet.figure.add_axes((box.x0, box.y1 + 0.1 * inch, box.width, _BAR * inch))
    sheet.figure.colorbar(shown, cax=axes, orientation="horizontal", ticks=MaxNLocator(2), extend="both")
    axes.xaxis.set_ticks_position("top")
    axes.xaxis.set_label_position("top")
    axes.set_xlabel(what)


def _caption(dem: Dem) -> str:
    grid, there, checks = dem.model.map, np.isfinite(dem.heights), dem.checks
    whole, matching, orientation = (
        number(float(np.median(band[there]))) for band in (dem.model.sigmas, dem.model.matching, dem.model.orientation)
    )
    text = (
        f"Heights every {number(grid.post)} m from {some([short(name, 30) for name in dem.images], len(dem.images))}, "
        f"lit from the north-west; sigma {whole} m (median), of which {matching} m by matching and relief and "
        f"{orientation} m by the orientation, common to neighbours"
    )
    if not len(checks):
        return f"{text}. No laser shot that took no part in the adjustment lies on it."
    off = check_figures(checks, np.ones(len(checks), dtype=bool))
    return (
        f"{text}. {many(len(checks), 'laser shot')} that took no part: model minus shot {number(off['mean_m'])} m on "
        f"the average, {number(off['rms_m'])} m rms, {number(off['rms_by_sigma'], 2)} times what is stated."
    )
