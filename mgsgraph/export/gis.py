"""GIS: a GeoPackage with the layers of a solution, and a GeoTIFF of a grid of sigmas.

The coordinate system is IAU_2015's "Sphere / Ocentric" (49900 of Mars, 30100 of the Moon): its latitude is the angle at
the body's centre, and its longitude counts east, as ours do. The others of Mars would say something else: the latitudes
of 49901 are geodetic (0.3 degrees off in the middle latitudes) and its longitudes count west; 49902 says what ours are,
but a GeoPackage defines its systems in a language (WKT 1) that has no word for it, so that GDAL takes its latitudes for
geodetic ones (3.6 and 3.12, tried). Heights are given above the body's ellipsoid, not above the sphere, in columns.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import numpy as np
import shapely

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.places import SigmaGrid
from mgsgraph.atomic_write import made_beside
from mgsgraph.errors import InputError, library
from mgsgraph.export.gis_layers import Layer, ellipse_layers, footprint_layers, point_layers, vector_layers
from mgsgraph.files.output.folders import PROGRAM
from mgsgraph.files.rasters.coordinate_systems import authority_code, geographic_crs, wkt2
from mgsgraph.files.writing import fresh_file
from mgsgraph.results.answers import write_sigma_raster

GEOPACKAGE, RASTER = "solution.gpkg", "sigmas.tif"
"""Names of the files."""
ABOUT = "about"
"""Table of the GeoPackage that says where it came from and what its layers mean; it has no shapes."""
_VERSION = "1.2"
"""Of the GeoPackage: one that GDAL 3.6 knows."""
_NOON = np.datetime64("2000-01-01T12:00:00.000", "ms")
"""J2000."""


def write_gis(solution: Solution, folder: Path, grid: SigmaGrid | None = None) -> list[Path]:
    """Write a GeoPackage into an existing folder; of a grid ``sigmas.tif``, too.

    The same solution gives the same bytes: what a GeoPackage calls its last change is when the last line was read.

    Parameters
    ----------
    solution : Solution
        What was adjusted.
    folder : Path
        Where to; files of these names are replaced.
    grid : SigmaGrid, optional
        Sigmas of new points over the images' overlap (`sigma_grid`).

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    InputError
        If a file can't be written, or pyogrio, of the extra ``[gis]``, is not installed.
    """
    body = solution.network.images[0].body
    layers = [
        *footprint_layers(solution), *point_layers(solution), *ellipse_layers(solution), *vector_layers(solution),
    ]  # fmt: skip
    written = [folder / GEOPACKAGE]
    with fresh_file(written[0]) as aside, made_beside(written[0], folder=True) as scratch:
        _write_layers(layers, _statements(solution, layers), scratch / GEOPACKAGE, solution)
        (scratch / GEOPACKAGE).replace(aside)  # GDAL wants the ending, and leaves its journals beside it
    if grid is not None:
        written.append(folder / RASTER)
        write_sigma_raster(grid, body, written[-1])
    return written


def _write_layers(layers: list[Layer], statements: dict[str, str], path: Path, solution: Solution) -> None:
    pyogrio, body = library("pyogrio", "gis", "GIS layers"), solution.network.images[0].body
    crs = authority_code(body) or wkt2(geographic_crs(body))  # by its code, or a GeoPackage loses the authority
    said = Layer(ABOUT, "Where this came from, and what the layers mean.", "", np.zeros(0), {
        "subject": list(statements), "statement": list(statements.values()),
    })  # fmt: skip
    with _dated(pyogrio, f"{_calendar(solution)[1]}Z"):
        for layer in (*layers, said):
            try:
                _write_layer(pyogrio, layer, crs, path)
            except (RuntimeError, ValueError) as error:  # pyogrio's errors are of these kinds
                where, found = f"{GEOPACKAGE}, layer {layer.name}", f"can't be written ({error})"
                raise InputError(where, found, remedy="free some space, or choose another folder") from None


def _write_layer(pyogrio: ModuleType, layer: Layer, crs: str, path: Path) -> None:
    # not by way of a GeoDataFrame: its coordinate system would lose the name of its authority
    spatial = bool(layer.geometry)
    pyogrio.raw.write(
        path,
        geometry=shapely.to_wkb(layer.shapes) if spatial else None,
        field_data=[one if isinstance(one, np.ndarray) else np.array(one, object) for one in layer.fields.values()],
        fields=np.array(list(layer.fields), dtype=object),
        layer=layer.name,
        driver="GPKG",
        geometry_type=layer.geometry if spatial else None,
        crs=crs if spatial else None,
        promote_to_multi=layer.geometry.startswith("Multi"),
        dataset_options={"VERSION": _VERSION},
        layer_options={"IDENTIFIER": layer.name, "DESCRIPTION": layer.about},
    )


@contextmanager
def _dated(pyogrio: ModuleType, moment: str) -> Iterator[None]:
    """What GDAL takes for the time of day, so that the same solution gives the same bytes."""
    before = pyogrio.get_gdal_config_option("OGR_CURRENT_DATE")
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": moment})
    try:
        yield
    finally:
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": before})


def _calendar(solution: Solution) -> tuple[str, str]:
    """When the first and the last line of all images were read, TDB."""
    edges = np.array([image.span for image in solution.network.images])
    first, last = (_NOON + np.timedelta64(round(1e3 * one), "ms") for one in (edges.min(), edges.max()))
    return str(first), str(last)


def _statements(solution: Solution, layers: list[Layer]) -> dict[str, str]:
    """Where the layers come from and what they mean, by subject."""
    fit, body = solution.fit, solution.network.images[0].body
    first, last = _calendar(solution)
    state = "converged" if solution.converged else "NOT converged"
    return {
        "program": f"{PROGRAM} ({', '.join(f'{name} {version}' for name, version in solution.versions.items())})",
        "solution": f"{solution.name}: {state}; {solution.message}",
        "fit": f"sigma0 {solution.sigma0:.6g}, {fit.degrees_of_freedom} degrees of freedom",
        "time of the images": f"{first} to {last} TDB; columns with et_s are seconds TDB past J2000",
        "coordinates": f"{authority_code(body) or geographic_crs(body)['name']}: degrees, latitudes planetocentric, "
        "longitudes east; shapes are in -180 .. 180 and are split at the date line, the column lon_deg counts from 0 "
        "to 360 as points.csv does",
        "heights": f"columns height_m: above the ellipsoid with radii {body.equatorial:.3f} m at the equator and "
        f"{body.polar:.3f} m at the poles",
        "sigmas": "for sigma0 = 1, as the a-priori sigmas imply; scaled ones are times sigma0",
        "lines and samples": "as ISIS counts them, the first pixel's centre at (1, 1); residuals are measured minus "
        "predicted",
        **{f"layer {layer.name}": layer.about for layer in layers},
    }
