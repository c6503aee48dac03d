"""Sigmas along an image's lines and over an overlap: sections of an analysis, a table, a GeoTIFF.

The GeoTIFF has four bands in metres, on the body's sphere, planetocentric degrees.
"""

from functools import partial
from pathlib import Path

import numpy as np

from mgsgraph.adjustment.frames import FLIGHT_NAMES
from mgsgraph.analysis.places import BANDS, SigmaGrid, sigma_grid
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.files.output.folders import PROGRAM
from mgsgraph.files.output.geotiff import geotiff
from mgsgraph.files.output.table import Column, Table
from mgsgraph.files.rasters.coordinate_systems import geographic_crs, wkt2
from mgsgraph.files.writing import file_stem, fresh_file
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.results.section import Section, drawn
from mgsgraph.units import DEG


def _file_of(posterior: Posterior, image: str) -> str:
    """Name of an image's files: its own, made fit, and then with its number, for two names may be made alike."""
    plainly = file_stem(image)
    return f"sigmas_{plainly}" if plainly == image else f"sigmas_{plainly}_{posterior.network.image_number(image) + 1}"


def curve_section(posterior: Posterior, image: str) -> Section:
    """Sigmas of the orientation along an image's lines."""
    picture = posterior.network.images[posterior.network.image_number(image)]
    poses = posterior.poses(image, np.linspace(0.0, float(picture.lines), 61))
    lines, sigmas = np.array([pose.line for pose in poses]), np.array([pose.sigmas for pose in poses])
    units = (("m", sigmas[:, :3], FLIGHT_NAMES[:3]), ("mrad", sigmas[:, 3:], FLIGHT_NAMES[3:]))
    parts = [
        Column(f"sigma_{axis}", values[:, k], unit, label=axis, text=">9.4g")
        for unit, values, axes in units for k, axis in enumerate(axes)
    ]  # fmt: skip
    file = _file_of(posterior, image)
    table = Table(file, f"Sigmas along image {image}", (
        Column("image", [image] * lines.size), Column("line", lines, text=">9.0f"), *parts,
    ))  # fmt: skip

    record = {"image": image, "lines": lines, **{part.name(): part.scaled for part in parts}}
    shown = table.take(np.arange(0, lines.size, 10))
    return Section("curves", tables=[shown], numbers=record, csv=[table],
                   sheets=drawn("mgsgraph.results.figures.sigmas.curve_sheet", poses, file))  # fmt: skip


def raster_section(posterior: Posterior, images: tuple[str, ...], cell: float | None, sigma: float) -> Section:
    """Sigmas of new points, measured to `sigma` px, over the overlap of images (all when empty); cells of `cell` m."""
    grid = sigma_grid(posterior, images, cell, sigma)
    body = posterior.network.images[0].body

    _, rows, columns = grid.values.shape
    record = {
        "images": list(grid.images), "measure_sigma_px": grid.sigma, "cell_m": grid.steps[1] * body.equatorial,
        "rows": rows, "columns": columns, "cells_seen_twice": int(np.count_nonzero(grid.rays >= 2)),
        "median_sigmas_m": np.nanmedian(grid.values[:3], axis=(1, 2)),
    }  # fmt: skip
    said = f"{grid.sentence[0].upper()}{grid.sentence[1:]}."
    files = {"sigmas.tif": partial(write_sigma_raster, grid, body)}
    return Section("raster", sentences=[said], numbers=record, files=files,
                   sheets=drawn("mgsgraph.results.figures.sigmas.raster_sheet", grid, "sigma_map"))  # fmt: skip


def write_sigma_raster(grid: SigmaGrid, body: Ellipsoid, path: Path) -> None:
    """Write a sigma grid as a cloud-optimized GeoTIFF (float32, m, NaN where nothing is known), whole or not at all.

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
        geotiff(
            aside, grid.values.shape, wkt2(geographic_crs(body)), corner, (across, down), dtype="float32", nodata=np.nan
        ) as file,
    ):
        file.write(grid.values.astype(np.float32))
        file.update_tags(**tags)
        for k, name in enumerate(BANDS, start=1):
            file.set_band_description(k, name)
            file.set_band_unit(k, "m")
