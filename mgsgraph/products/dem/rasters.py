"""A terrain model and its ortho image as GeoTIFF files."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.geometry.records import Array
from mgsgraph.matching.scene import Ground, Picture
from mgsgraph.products.atomic import PROGRAM
from mgsgraph.products.dem.gridding import HeightGrid
from mgsgraph.products.dem.map import MapGrid
from mgsgraph.products.dem.ortho import ortho_tiles
from mgsgraph.products.geotiff import geotiff

BANDS = ("height", "sigma", "sigma by matching", "sigma by orientation", "number of points")
"""Of dem.tif; m but for the last."""


def write_model(model: HeightGrid, heights: Array, reference: str, tags: Mapping[str, str], path: Path) -> None:
    """Write dem.tif.

    Parameters
    ----------
    model : HeightGrid
    heights : (rows, columns)
        m, above `reference`.
    reference : str
        What the heights are above.
    tags : mapping
        More about it.
    path : Path
    """
    counts = np.where(np.isfinite(heights), model.counts, np.nan)
    bands = (heights, model.sigmas, model.matching, model.orientation, counts)
    with _on(model.map, path, len(BANDS), dtype="float32", nodata=np.nan) as file:
        file.update_tags(program=PROGRAM, heights=f"above {reference}", **tags)
        for k, (name, values) in enumerate(zip(BANDS, bands, strict=True), start=1):
            file.write(np.where(np.isfinite(heights), values, np.nan).astype(np.float32), k)
            file.set_band_description(k, f"{name} above {reference}" if k == 1 else name)
            file.set_band_unit(k, "m" if k < len(BANDS) else "1")


def write_ortho(
    picture: Picture, model: HeightGrid, ground: Ground, grid: MapGrid, path: Path,
    progress: Callable[[int, int], None] = lambda done, most: None,
) -> None:
    """Write ortho.tif: the picture on the pixels of `grid`, 0 where there is none."""
    from rasterio.windows import Window

    low, high = picture.levels
    with _on(grid, path, 1, dtype="uint8", nodata=0) as file:
        file.update_tags(program=PROGRAM, image=picture.image.name, grey_1=f"{low:g}", grey_255=f"{high:g}")
        file.set_band_description(1, picture.image.name)
        for row, column, grey in ortho_tiles(picture, model, ground, grid, progress):
            file.write(grey, 1, window=Window(column, row, grey.shape[1], grey.shape[0]))


def _on(grid: MapGrid, path: Path, bands: int, **kind: Any) -> AbstractContextManager[Any]:
    """A GeoTIFF on the posts of a map."""
    corner, steps = (grid.west, grid.north), (grid.post, grid.post)
    return geotiff(path, (bands, grid.rows, grid.columns), grid.crs, corner, steps, **kind)
