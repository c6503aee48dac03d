"""Cloud-optimized GeoTIFF, made in memory: what does not fit on a disk, GDAL tells nobody when it closes a file."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

MEDIA_TYPE = "image/tiff; application=geotiff; profile=cloud-optimized"
"""Of such a file, as catalogues name it."""
_BLOCK = 256
"""pixels, side of a file's tiles."""
_LAYOUT = {
    "compress": "DEFLATE", "predictor": "YES", "blocksize": str(_BLOCK), "overview_resampling": "AVERAGE",
    "bigtiff": "IF_SAFER",
}  # fmt: skip
"""What GDAL's COG driver is told; overviews are halved until one fits into a tile."""


@contextmanager
def geotiff(
    path: Path, shape: tuple[int, int, int], crs: str, corner: tuple[float, float], steps: tuple[float, float],
    **kind: Any,
) -> Iterator[Any]:
    """A dataset of rasterio's, to be written; then a file in the layout of GDAL's COG driver, with overviews.

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
    from rasterio.shutil import copy

    count, rows, columns = shape
    with rasterio.MemoryFile() as memory, rasterio.MemoryFile(ext=".tif") as ordered:
        with rasterio.open(
            memory.name, "w", driver="GTiff", width=columns, height=rows, count=count, crs=crs, compress="deflate",
            zlevel=1, transform=rasterio.Affine(steps[0], 0.0, corner[0], 0.0, -steps[1], corner[1]),
            tiled=True, blockxsize=_BLOCK, blockysize=_BLOCK, **kind,
        ) as file:  # fmt: skip
            yield file
        copy(memory.name, ordered.name, driver="COG", **_LAYOUT)  # the driver can't be written to piece by piece
        path.write_bytes(ordered.getbuffer())
