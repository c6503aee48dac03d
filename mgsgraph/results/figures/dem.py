"""A terrain model drawn: heights with shading, sigma, the laser shots that check it over the ortho image."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LightSource, Normalize
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mgsgraph.files.rasters.raster_file import open_raster, read_band
from mgsgraph.geometry.records import Array, thinned
from mgsgraph.registration.dem.checking import check_figures
from mgsgraph.registration.dem.model import Dem
from mgsgraph.results.figures.sheet import INK, MOST_MARKS, Sheet, new_sheet, number, plain_style
from mgsgraph.text import many, short, some
from mgsgraph.units import KM

_MOST_POSTS = 1200
"""Rows or columns that are drawn; of larger models every so many-th."""
_TALL, _WIDE, _NARROW, _LOW = 7.0, 3.0, 1.45, 2.4
"""inch, height and width of a map at most, and at least."""
_LETTERS = 2.4
"""inch, width of labels beside the panels in all."""
_SHOWN = (0.02, 0.98)
"""Quantiles to which colors reach."""


def read_ortho(path: Path) -> NDArray[np.uint8]:
    """An ortho image with no more rows and columns than are drawn."""
    with open_raster(path, "the ortho image") as file:
        step = max(1.0, max(file.shape) / _MOST_POSTS)
        return read_band(file, path, out_shape=tuple(max(1, round(size / step)) for size in file.shape))


@plain_style()
def dem_sheet(dem: Dem, ortho: NDArray[np.uint8]) -> Sheet:
    """Shaded heights, sigma, and over the ortho image (0 where there is none) laser shots by how much the model is
    higher.
    """
    grid = dem.model.map
    height = float(np.clip(_WIDE * grid.rows / grid.columns, _LOW, _TALL))
    width = float(np.clip(height * grid.columns / grid.rows, _NARROW, _WIDE))
    sheet = new_sheet(
        "dem", 3.0 * width + _LETTERS, height + 1.0, f"Terrain model: {short(dem.name, 60)}", _caption(dem), band=0.0
    )
    height_panel, sigma_panel, shots_panel = sheet.panels(1, 3)[0]
    step = max(1, -(-max(grid.rows, grid.columns) // _MOST_POSTS))
    heights = dem.heights[::step, ::step]
    _draw_heights(sheet, height_panel, dem, heights, step)
    _draw_sigmas(sheet, sigma_panel, dem, step)
    _draw_shots(sheet, shots_panel, dem, ortho)
    return sheet


def _extent(dem: Dem) -> tuple[float, float, float, float]:
    """km: west, east, south, north of the map."""
    grid = dem.model.map
    east, south = grid.west + grid.columns * grid.post, grid.north - grid.rows * grid.post
    return grid.west / KM, east / KM, south / KM, grid.north / KM


def _norm(values: Array) -> Normalize:
    low, high = np.nanquantile(values, _SHOWN)
    return Normalize(float(low), float(max(high, low + 1e-9)))


def _draw_heights(sheet: Sheet, panel: Axes, dem: Dem, heights: Array, step: int) -> None:
    norm, post = _norm(heights), dem.model.map.post * step
    light = LightSource(315.0, 45.0)
    flat = np.where(np.isfinite(heights), heights, np.nanmean(heights))
    colors = np.asarray(ScalarMappable(norm, "gist_earth").to_rgba(flat))[:, :, :3]
    exaggeration = 1.0 / max(float(np.nanstd(np.gradient(flat, post)[0])) * 4.0, 1e-9)  # slopes that can be seen
    shaded = light.shade_rgb(colors, flat, vert_exag=min(exaggeration, 10.0), dx=post, dy=post, blend_mode="soft")
    shaded = np.dstack([shaded, np.isfinite(heights)])
    panel.imshow(shaded, extent=_extent(dem), interpolation="nearest", aspect="equal")
    shown = ScalarMappable(norm, "gist_earth")
    sheet.colour_bar(shown, panel, f"above {dem.reference.split(' of ')[0]} (m)", MaxNLocator(2), "both")
    _label_axes(panel, "north of the middle (km)")


def _draw_sigmas(sheet: Sheet, panel: Axes, dem: Dem, step: int) -> None:
    sigmas = np.ma.masked_invalid(np.where(np.isfinite(dem.heights), dem.model.sigmas, np.nan)[::step, ::step])
    norm = Normalize(0.0, _norm(sigmas.filled(np.nan)).vmax)
    shown = panel.imshow(
        sigmas, extent=_extent(dem), cmap="viridis", norm=norm, interpolation="nearest", aspect="equal"
    )
    sheet.colour_bar(shown, panel, "sigma of height (m)", MaxNLocator(2), "max")
    _label_axes(panel)


def _draw_shots(sheet: Sheet, panel: Axes, dem: Dem, ortho: NDArray[np.uint8]) -> None:
    checks = dem.checks
    grey = np.ma.masked_equal(ortho, 0)
    panel.imshow(grey, extent=_extent(dem), cmap="Greys_r", vmin=0, vmax=255, interpolation="nearest", aspect="equal")
    half_range = float(np.quantile(np.abs(checks.differences), 0.98)) if len(checks) else 1.0
    norm = Normalize(-max(half_range, 1e-9), max(half_range, 1e-9))
    drawn = thinned(len(checks), MOST_MARKS)
    shown = panel.scatter(
        checks.plane[drawn, 0] / KM, checks.plane[drawn, 1] / KM, c=checks.differences[drawn], cmap="RdBu_r", norm=norm,
        s=9.0, edgecolors=INK, linewidths=0.2, zorder=3,
    )  # fmt: skip
    if len(checks):
        sheet.colour_bar(shown, panel, "model minus shot (m)", MaxNLocator(2), "both")
    _label_axes(panel)
    panel.set_title("ortho image")


def _label_axes(panel: Axes, north: str = "") -> None:
    panel.grid(visible=False)
    panel.xaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
    panel.yaxis.set_major_locator(MaxNLocator(7, steps=[1, 2, 5, 10]))
    panel.set(xlabel="east (km)", ylabel=north)


def _caption(dem: Dem) -> str:
    checks, has_height = dem.checks, np.isfinite(dem.heights)
    text = (
        f"Heights every {number(dem.model.map.post)} m from "
        f"{some([short(name, 30) for name in dem.images])}, lit from the north-west; sigma "
        f"{number(float(np.median(dem.model.sigmas[has_height])))} m (median)"
    )
    if not len(checks):
        return f"{text}. No laser shot that took no part in the adjustment lies on it."
    differences = check_figures(checks, np.ones(len(checks), dtype=bool))
    return (
        f"{text}. {many(len(checks), 'laser shot')} that took no part: model minus shot "
        f"{number(differences['mean_m'])} m on the average, {number(differences['rms_m'])} m rms, "
        f"{number(differences['rms_by_sigma'], 2)} times what is stated."
    )
