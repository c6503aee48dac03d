"""GeoTIFF files, made in memory: what does not fit on a disk, GDAL tells nobody when it closes a file."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

_BLOCK = 256
"""pixels, side of a file's tiles."""
_OVERVIEWS = (2, 4, 8, 16)
"""Reductions kept in a file, those that leave something."""


@contextmanager
def geotiff(
    path: Path, shape: tuple[int, int, int], crs: str, corner: tuple[float, float], steps: tuple[float, float],
    **kind: Any,
) -> Iterator[Any]:
    """A dataset of rasterio's, to be written; then a file, with overviews where it is large.

    Parameters
    ----------
    path : Path
        Of the file, which is written when all went well.
    shape : (bands, rows, columns)
    crs : str
        Coordinate system, as PROJ knows it.
    corner : (2,)
        x and y of the upper left corner of the first pixel.
    steps : (2,)
        Width and height of a pixel.
    kind
        dtype, nodata and what else rasterio takes.
    """
    import rasterio  # takes its time; only who writes one waits for it
    from rasterio.enums import Resampling

    count, rows, columns = shape
    with rasterio.MemoryFile() as memory:
        with rasterio.open(
            memory.name, "w", driver="GTiff", width=columns, height=rows, count=count, crs=crs, compress="deflate",
            transform=rasterio.Affine(steps[0], 0.0, corner[0], 0.0, -steps[1], corner[1]),
            tiled=True, blockxsize=_BLOCK, blockysize=_BLOCK, **kind,
        ) as file:  # fmt: skip
            yield file
        if smaller := [factor for factor in _OVERVIEWS if factor * _BLOCK < max(rows, columns)]:
            with rasterio.open(memory.name, "r+", driver="GTiff") as file:
                file.build_overviews(smaller, Resampling.average)
        path.write_bytes(memory.getbuffer())
