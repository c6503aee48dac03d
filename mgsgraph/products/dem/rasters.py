"""A terrain model and its ortho image as GeoTIFF files that GDAL reads.

They are made in memory: what does not fit on a disk, GDAL tells nobody when it closes a file.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.geometry.records import Array
from mgsgraph.matching.scene import Ground, Picture
from mgsgraph.products.atomic import PROGRAM
from mgsgraph.products.dem.gridding import HeightGrid
from mgsgraph.products.dem.map import MapGrid
from mgsgraph.products.dem.ortho import ortho_tiles

BANDS = ("height", "sigma", "sigma by matching", "sigma by orientation", "number of points")
"""Of dem.tif; m but for the last."""
_BLOCK = 256
"""pixels, side of a file's tiles."""
_OVERVIEWS = (2, 4, 8, 16)
"""Reductions kept in a file, those that leave something."""


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
    with _fresh(path, model.map, count=len(BANDS), dtype="float32", nodata=np.nan) as file:
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
    with _fresh(path, grid, count=1, dtype="uint8", nodata=0) as file:
        file.update_tags(program=PROGRAM, image=picture.image.name, grey_1=f"{low:g}", grey_255=f"{high:g}")
        file.set_band_description(1, picture.image.name)
        for row, column, grey in ortho_tiles(picture, model, ground, grid, progress):
            file.write(grey, 1, window=Window(column, row, grey.shape[1], grey.shape[0]))


@contextmanager
def _fresh(path: Path, grid: MapGrid, **kind: Any) -> Iterator[Any]:
    """A dataset of rasterio's on the posts of a map, to be written; then a file, with overviews where it is large."""
    import rasterio  # takes its time; only who writes one waits for it
    from rasterio.enums import Resampling

    with rasterio.MemoryFile() as memory:
        with rasterio.open(
            memory.name, "w", driver="GTiff", width=grid.columns, height=grid.rows, crs=grid.crs, compress="deflate",
            transform=rasterio.Affine(grid.post, 0.0, grid.west, 0.0, -grid.post, grid.north),
            tiled=True, blockxsize=_BLOCK, blockysize=_BLOCK, **kind,
        ) as file:  # fmt: skip
            yield file
        if smaller := [factor for factor in _OVERVIEWS if factor * _BLOCK < max(grid.rows, grid.columns)]:
            with rasterio.open(memory.name, "r+") as file:
                file.build_overviews(smaller, Resampling.average)
        path.write_bytes(memory.getbuffer())
