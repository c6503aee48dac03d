"""A solution as tables and arrays of other libraries: pandas, GeoPandas, xarray."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from mgsgraph.adjustment.solution import OrientationProfile, Solution, orientation_profiles
from mgsgraph.analysis.statistics import solution_connectivity
from mgsgraph.errors import library, require
from mgsgraph.export.gis import Layer, ellipse_layers, footprint_layers
from mgsgraph.files.output.table import Column, Table
from mgsgraph.files.rasters.raster_file import geographic_crs, wkt2
from mgsgraph.record import meanings
from mgsgraph.results.passes import nodes_table, shared_table
from mgsgraph.results.tables import (
    GEOMETRY,
    connectivity_table,
    orientation_table,
    points_table,
    residual_points,
    residuals_table,
    with_points,
    with_shapes,
)

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from pandas import DataFrame
    from xarray import Dataset

_EXTRA = "tables"
_PLAIN: dict[str, Callable[[Solution], Table]] = {
    "orientation": orientation_table,
    "connectivity": lambda solution: connectivity_table(solution_connectivity(solution)),
    "shared": shared_table,
    "passes": nodes_table,
}
"""Tables whose rows have no place, by their names."""
_PLACED: dict[str, Callable[[Solution], Table]] = {
    "points": lambda solution: with_points(points_table(solution), solution.places),
    "residuals": lambda solution: with_points(residuals_table(solution), solution.places[residual_points(solution)]),
    "footprints": lambda solution: layer_table(footprint_layers(solution)[1]),
    "error_ellipses": lambda solution: layer_table(ellipse_layers(solution)[0]),
}
"""Tables whose rows have one."""
_AXES = {"position": ("axis", ("x", "y", "z")), "angles": ("angle", ("omega", "phi", "kappa")),
         "rotation": ("camera_axis", ("x", "y", "z"))}  # fmt: skip
"""Last dimension of the vectors of an orientation profile, by the beginning of their names, and its labels."""


def layer_table(layer: Layer) -> Table:
    """A layer of a map as a table with a column of shapes."""
    columns = tuple(Column(name, values) for name, values in layer.fields.items())
    return with_shapes(Table(layer.name, layer.about, columns), shapely.to_wkb(layer.shapes).tolist())


def to_pandas(solution: Solution, what: str = "points") -> "DataFrame":
    """A table of a solution as a DataFrame of pandas (extra ``[tables]``): rows and columns as in the CSV files.

    Parameters
    ----------
    solution : Solution
    what : str
        points, residuals, orientation, footprints, error_ellipses, connectivity, shared or passes. Units are in the
        names of the columns; unknown values are NaN.

    Raises
    ------
    InputError
        If there is no such table, or pandas is not installed.

    Examples
    --------
    >>> frame = mgsgraph.to_pandas(solution, "points")
    >>> list(frame.columns[:3]), len(frame)
    (['id', 'class', 'kind'], 28)
    """
    table = _table(solution, what, _PLAIN | _PLACED)
    library("pandas", _EXTRA, f"table of {what}")
    return table.drop(GEOMETRY).arrow.to_pandas()


def to_geopandas(solution: Solution, what: str = "points") -> "GeoDataFrame":
    """A table of a solution as a GeoDataFrame of GeoPandas, with shapes in planetocentric degrees, -180 .. 180.

    Parameters
    ----------
    solution : Solution
    what : str
        points, residuals (at their points), footprints or error_ellipses (95 %, for sigma0 = 1).

    Raises
    ------
    InputError
        If there is no such table, or GeoPandas is not installed.

    Examples
    --------
    >>> frame = mgsgraph.to_geopandas(solution, "footprints")
    >>> list(frame.columns[:3]), frame.geometry.geom_type[0]
    (['image', 'pass', 'held'], 'Polygon')
    """
    geopandas = library("geopandas", _EXTRA, f"table of {what}")
    frame = _table(solution, what, _PLACED).arrow.to_pandas()
    crs = wkt2(geographic_crs(solution.network.body))
    shapes = geopandas.GeoSeries.from_wkb(frame.pop(GEOMETRY), crs=crs)
    return geopandas.GeoDataFrame(frame, geometry=shapes)


def _table(solution: Solution, what: str, tables: dict[str, Callable[[Solution], Table]]) -> Table:
    require(what in tables, "table of a solution", repr(what), f"one of {', '.join(tables)}")
    require(what != "passes" or solution.network.passes, "table of passes", "a network without any")
    return tables[what](solution)


def to_xarray(solution: Solution, places: int = 31) -> "Dataset":
    """Exterior orientation of all images, before and after, with sigmas, as a Dataset of xarray (extra ``[tables]``).

    Variables are the fields of `OrientationProfile` with dimensions (image, place) and, of vectors, their axis or
    angle; each states its unit (SI) and its meaning.

    Parameters
    ----------
    solution : Solution
    places : int
        Lines of each image, evenly spaced from its first to its last.

    Raises
    ------
    InputError
        If xarray is not installed.

    Examples
    --------
    >>> dataset = mgsgraph.to_xarray(solution, places=3)
    >>> dict(dataset.sizes), list(dataset)[:3]
    ({'image': 2, 'place': 3, 'axis': 3, 'angle': 3, 'camera_axis': 3}, ['lines', 'times', 'position_before'])
    """
    xarray = library("xarray", _EXTRA, "orientation profiles")
    profiles, images = orientation_profiles(solution, places=places), solution.network.image_names
    texts, variables, labels = meanings(OrientationProfile), dict[str, Any](), dict[str, Any]()
    for name in (field for field in texts if isinstance(getattr(profiles, field), np.ndarray)):
        values = getattr(profiles, name)
        dimension, parts = _AXES.get(name.split("_")[0], ("", ()))
        dimensions = ("image", "place", *([dimension] if dimension else []))
        labels |= {dimension: list(parts)} if dimension else {}
        attributes = {"long_name": texts[name], "units": _unit(texts[name])}
        variables[name] = dimensions, values.reshape(len(images), places, *values.shape[1:]), attributes
    body = solution.network.body
    about = {
        "title": f"Exterior orientation of {solution.name}", "frame": "body-fixed",
        "sigma0": solution.sigma0, "sigmas": "for sigma0 = 1",
        "equatorial_radius_m": body.equatorial, "polar_radius_m": body.polar,
    }  # fmt: skip
    return xarray.Dataset(variables, {"image": images, **labels}, about)


def _unit(meaning: str) -> str:
    """Unit that a field's meaning says after its shape: "(n, 3) m, body-fixed"; 1 where there is none."""
    first = meaning.partition(") ")[2].split(",")[0].split(" ")[0]
    return first if first in ("m", "rad", "s") else "1"
