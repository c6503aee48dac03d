"""Sigmas over an overlap as a GeoTIFF: four bands in metres, on the body's sphere, planetocentric degrees."""

from pathlib import Path

import numpy as np

from mgsgraph.adjustment.analysis.overlap_sigmas import BANDS, SigmaGrid
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.io.fresh_file import fresh_file
from mgsgraph.output.folders import PROGRAM
from mgsgraph.output.geotiff import geotiff
from mgsgraph.units import DEG

_CRS = {3396190.0: "IAU_2015:49900", 1737400.0: "IAU_2015:30100"}
"""Sphere, ocentric, of Mars and of the Moon, by equatorial radius in m."""


def write_sigma_raster(grid: SigmaGrid, body: Ellipsoid, path: Path) -> None:
    """Write a sigma grid as a GeoTIFF (float32, m, NaN where nothing is known), whole or not at all.

    Raises
    ------
    InputError
        If it can't be written.
    """
    across, down = (step / DEG for step in grid.steps)
    tags = {"images": ", ".join(grid.images), "measure_sigma_px": f"{grid.sigma:g}", "program": PROGRAM}
    corner = grid.west / DEG, grid.north / DEG
    with (
        fresh_file(path) as aside,
        geotiff(aside, grid.values.shape, body_crs(body), corner, (across, down), dtype="float32", nodata=np.nan)
        as file,
    ):
        file.write(grid.values.astype(np.float32))
        file.update_tags(**tags)
        for k, name in enumerate(BANDS, start=1):
            file.set_band_description(k, name)
            file.set_band_unit(k, "m")


def body_crs(body: Ellipsoid) -> str:
    """Coordinate system of planetocentric degrees: IAU's code where it has the body's radius, else a sphere of it."""
    return _CRS.get(body.equatorial, f"+proj=longlat +R={body.equatorial:.3f} +no_defs")
