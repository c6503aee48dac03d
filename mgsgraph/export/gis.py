"""GIS: a GeoPackage with the layers of a solution, a project for QGIS that shows them, a GeoTIFF of a grid of sigmas.

The project (.qgs) says how each layer is drawn: rules with a symbol each. It names its files relative to itself, has
the coordinate system of the body, and measures on its ellipsoid. QGIS 3.22 and newer read it.

The coordinate system is IAU_2015's "Sphere / Ocentric" (49900 of Mars, 30100 of the Moon): its latitude is the angle at
the body's centre, and its longitude counts east, as ours do. The others of Mars would say something else: the latitudes
of 49901 are geodetic (0.3 degrees off in the middle latitudes) and its longitudes count west; 49902 says what ours are,
but a GeoPackage defines its systems in a language (WKT 1) that has no word for it, so that GDAL takes its latitudes for
geodetic ones (3.6 and 3.12, tried). Heights are given above the body's ellipsoid, not above the sphere, in columns.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import shapely

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.overlap_sigmas import SigmaGrid
from mgsgraph.atomic_write import made_beside
from mgsgraph.errors import InputError
from mgsgraph.export.gis_layers import Layer, ellipse_layers, footprint_layers, point_layers, vector_layers
from mgsgraph.files.output.folders import PROGRAM
from mgsgraph.files.rasters.coordinate_systems import authority_code, geographic_crs, wkt2
from mgsgraph.files.writing import fresh_file
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.records import Array
from mgsgraph.libraries import library
from mgsgraph.results.answers import write_sigma_raster

GEOPACKAGE, RASTER = "solution.gpkg", "sigmas.tif"
"""Names of the files."""
ABOUT = "about"
"""Table of the GeoPackage that says where it came from and what its layers mean; it has no shapes."""
_VERSION = "1.2"
"""Of the GeoPackage: one that GDAL 3.6 knows."""
_NOON = np.datetime64("2000-01-01T12:00:00.000", "ms")
"""J2000."""
PROJECT = "solution.qgs"
"""Name of the project's file."""
_QGIS = "3.22.0"
_KINDS = {"Point": ("marker", "Point", "0"), "MultiLineString": ("line", "Line", "1"),
          "MultiPolygon": ("fill", "Polygon", "2")}  # fmt: skip
"""Type of symbols, QGIS's name and number of a layer's geometry."""
_COLOURS = ("68,1,84", "59,82,139", "33,145,140", "94,201,98", "253,231,37")
"""Of five classes from small to large: viridis."""
_RED, _BLUE, _GREY = "200,30,30", "31,90,160", "120,120,120"
_ARROWS = {"corrections": _BLUE, "misregistration": "120,60,150", "residuals": "20,110,60"}
_SHOWN = ("tie_points", "laser_points", "control_points", "post_points", "residuals_exaggerated",
          "error_ellipses_exaggerated", "footprints_adjusted")  # fmt: skip
"""Layers that are shown at first; the others are there, too."""
_MARGIN = 0.05
"""Of the extent, around what the project shows first."""


def write_gis(solution: Solution, folder: Path, grid: SigmaGrid | None = None) -> list[Path]:
    """Write a GeoPackage and a project for QGIS into an existing folder; of a grid ``sigmas.tif``, too.

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
    shown = [one for kind in ("Point", "MultiLineString", "MultiPolygon") for one in layers if one.geometry == kind]
    written.append(folder / PROJECT)  # points on top, footprints below
    write_project(shown, GEOPACKAGE, body, solution.name, written[-1])
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


# --- how QGIS draws the layers


class Rule(NamedTuple):
    """How some features of a layer are drawn."""

    label: str
    """In the legend."""
    condition: str
    """Expression of QGIS for the features that it is for; empty for all."""
    symbol: str
    """Class of the symbol layer: SimpleMarker, SimpleFill, SimpleLine or ArrowLine."""
    options: dict[str, str]
    """Of that class."""


def style(layer: Layer) -> list[Rule]:
    """How a layer is drawn, by what it shows."""
    name = layer.name.removesuffix("_exaggerated")
    if layer.geometry == "Point":
        return _points(layer)
    if name == "footprints_nominal":
        return [_fill("nominal footprint", "0,0,0,0", _GREY, "dash")]
    if name.startswith("footprints"):
        return [_fill("adjusted footprint", f"{_BLUE},25", _BLUE)]
    if name == "error_ellipses":
        return [_fill(f"95 % error ellipse{_times(layer)}", "230,140,0,60", "200,100,0")]
    label, colour = f"{name.removesuffix('s')}{_times(layer)}", _ARROWS[name]
    if "used" in layer.fields:
        return [_arrow(label, '"used"', colour), _arrow(f"{label}, rejected", 'NOT "used"', _RED)]
    if "rejected" in layer.fields:
        return [_arrow(label, 'NOT "rejected"', colour), _arrow(f"{label}, rejected", '"rejected"', _RED)]
    return [_arrow(label, "", colour)]


def _times(layer: Layer) -> str:
    """By how much shapes are exaggerated, in words for a legend."""
    factors = np.asarray(layer.fields.get("exaggeration", np.ones(0)))
    return f", exaggerated {factors[0]:g} times" if factors.size and factors[0] != 1.0 else ""


def _points(layer: Layer) -> list[Rule]:
    """By the sigma of the height in five classes of as many points each; rejected ones apart."""
    rejected = _marker("rejected, or without a place", '"rejected" OR "sigma_up_m" IS NULL', _RED, "cross2", 2.2)
    sigmas = np.asarray(layer.fields["sigma_up_m"], dtype=np.float64)
    kept = sigmas[np.isfinite(sigmas) & ~np.asarray(layer.fields["rejected"])]
    bounds = np.unique(_rounded(np.quantile(kept, np.linspace(0.0, 1.0, 6)[1:-1]))) if kept.size else np.zeros(0)
    edges = [-np.inf, *bounds.tolist(), np.inf]
    rules = []
    for k, (low, high) in enumerate(pairwise(edges)):
        parts = ['NOT "rejected"', *([f'"sigma_up_m" >= {low!r}'] if low > -np.inf else []),
                 *([f'"sigma_up_m" < {high!r}'] if high < np.inf else ['"sigma_up_m" IS NOT NULL'])]  # fmt: skip
        label = f"{low:g} to {high:g} m" if np.isfinite(low + high) else f"under {high:g} m" if high < np.inf else (
            f"{low:g} m and more" if low > -np.inf else "all")  # fmt: skip
        rules.append(_marker(f"sigma up {label}", " AND ".join(parts), _COLOURS[k], "circle", 2.0))
    return [*rules, rejected]


def _rounded(values: Array) -> Array:
    """To three digits."""
    return np.array([float(f"{value:.3g}") for value in values])


def _marker(label: str, condition: str, colour: str, shape: str, size: float) -> Rule:
    return Rule(label, condition, "SimpleMarker", {
        "name": shape, "color": f"{colour},255", "size": f"{size:g}", "size_unit": "MM", "outline_width": "0.1",
        "outline_color": f"{colour},255" if shape == "cross2" else "40,40,40,255", "outline_width_unit": "MM",
    })  # fmt: skip


def _fill(label: str, colour: str, line: str, pen: str = "solid") -> Rule:
    return Rule(label, "", "SimpleFill", {
        "color": colour, "style": "solid", "outline_color": f"{line},255", "outline_style": pen, "outline_width": "0.3",
        "outline_width_unit": "MM",
    })  # fmt: skip


def _arrow(label: str, condition: str, colour: str) -> Rule:
    return Rule(label, condition, "ArrowLine", {
        "colour": f"{colour},255", "arrow_width": "0.25", "arrow_start_width": "0.25", "head_length": "1.2",
        "head_thickness": "0.7", "is_curved": "0", "is_repeated": "1", "arrow_type": "0", "head_type": "0",
    })  # fmt: skip


# --- the project


def write_project(layers: Sequence[Layer], package: str, body: Ellipsoid, title: str, path: Path) -> None:
    """Write a project of layers that lie in a GeoPackage of the name `package` beside it, the first one on top."""
    root = Element("qgis", {"version": _QGIS, "projectname": title})
    SubElement(root, "homePath", {"path": ""})
    SubElement(root, "title").text = title
    _system(SubElement(root, "projectCrs"), body)
    tree = SubElement(root, "layer-tree-group")
    west, south, east, north = _extent(layers)
    canvas = SubElement(root, "mapcanvas", {"name": "theMapCanvas", "annotationsVisible": "1"})
    SubElement(canvas, "units").text = "degrees"
    _box(SubElement(canvas, "extent"), west, south, east, north)
    _system(SubElement(canvas, "destinationsrs"), body)
    every = SubElement(root, "projectlayers")
    for layer in layers:
        source = f"./{package}|layername={layer.name}"
        shown = "Qt::Checked" if layer.name in _SHOWN else "Qt::Unchecked"
        SubElement(tree, "layer-tree-layer", {
            "id": _id(layer), "name": layer.name.replace("_", " "), "providerKey": "ogr", "source": source,
            "checked": shown, "expanded": "1" if shown == "Qt::Checked" else "0",
        })  # fmt: skip
        _map_layer(every, layer, source, body)
    order = SubElement(root, "layerorder")
    for layer in layers:
        SubElement(order, "layer", {"id": _id(layer)})
    view = SubElement(SubElement(root, "ProjectViewSettings", {"UseProjectScales": "0"}), "DefaultViewExtent", {
        "xmin": repr(west), "ymin": repr(south), "xmax": repr(east), "ymax": repr(north),
    })  # fmt: skip
    _system(view, body)
    said = SubElement(root, "properties")
    SubElement(SubElement(said, "Measure"), "Ellipsoid", {"type": "QString"}).text = _ellipsoid(body)
    SubElement(SubElement(said, "SpatialRefSys"), "ProjectionsEnabled", {"type": "int"}).text = "1"
    indent(root)
    head = b"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
    path.write_bytes(head + tostring(root, encoding="utf-8") + b"\n")


def _id(layer: Layer) -> str:
    return f"mgsgraph_{layer.name}"  # QGIS gives others to layers whose ids have ten letters or fewer


def _map_layer(above: Element, layer: Layer, source: str, body: Ellipsoid) -> None:
    kind = _KINDS[layer.geometry]
    one = SubElement(above, "maplayer", {
        "type": "vector", "geometry": kind[1], "styleCategories": "AllStyleCategories", "labelsEnabled": "0",
    })  # fmt: skip
    for key, text in (("id", _id(layer)), ("datasource", source), ("layername", layer.name.replace("_", " ")),
                      ("abstract", layer.about)):  # fmt: skip
        SubElement(one, key).text = text
    _system(SubElement(one, "srs"), body)
    SubElement(one, "provider", {"encoding": "UTF-8"}).text = "ogr"
    _renderer(one, style(layer))
    SubElement(one, "layerGeometryType").text = kind[2]


def _renderer(above: Element, rules: Sequence[Rule]) -> None:
    """A rule for each; of one without a condition, all features."""
    found = SubElement(above, "renderer-v2", {"type": "RuleRenderer", "forceraster": "0", "symbollevels": "0",
                                              "enableorderby": "0"})  # fmt: skip
    tree, symbols = SubElement(found, "rules", {"key": "rules"}), SubElement(found, "symbols")
    for k, rule in enumerate(rules):
        said = {"label": rule.label, "key": f"rule_{k}", "symbol": str(k)}
        SubElement(tree, "rule", said | ({"filter": rule.condition} if rule.condition else {}))
        kind = {"SimpleMarker": "marker", "SimpleFill": "fill"}.get(rule.symbol, "line")
        symbol = SubElement(symbols, "symbol", {"name": str(k), "type": kind, "alpha": "1", "clip_to_extent": "1"})
        options = dict(rule.options)
        colour = options.pop("colour", "")
        drawn = _options(symbol, rule.symbol, options)
        if colour:  # an arrow is filled by a symbol of its own
            inner = SubElement(drawn, "symbol", {"name": f"@{k}@0", "type": "fill", "alpha": "1"})
            _options(inner, "SimpleFill", {"color": colour, "style": "solid", "outline_style": "no"})


def _options(above: Element, kind: str, options: dict[str, str]) -> Element:
    layer = SubElement(above, "layer", {"class": kind, "enabled": "1", "locked": "0", "pass": "0"})
    held = SubElement(layer, "Option", {"type": "Map"})
    for name, value in options.items():
        SubElement(held, "Option", {"name": name, "type": "QString", "value": value})
    return layer


def _system(above: Element, body: Ellipsoid) -> None:
    system = geographic_crs(body)
    found = SubElement(above, "spatialrefsys", {"nativeFormat": "Wkt"})
    for key, text in (("wkt", wkt2(system)), ("authid", ""), ("description", system["name"]),
                      ("ellipsoidacronym", _ellipsoid(body)), ("geographicflag", "true")):  # fmt: skip
        SubElement(found, key).text = text


def _ellipsoid(body: Ellipsoid) -> str:
    """As QGIS names one by its axes in m: the sphere that latitudes are on."""
    return f"PARAMETER:{body.equatorial:.15g}:{body.equatorial:.15g}"


def _extent(layers: Sequence[Layer]) -> tuple[float, float, float, float]:
    """West, south, east and north in degrees of all that is shown, with a margin."""
    shown = [shapely.total_bounds(layer.shapes) for layer in layers if layer.name in _SHOWN and len(layer.shapes)]
    bounds = np.array([one for one in shown if np.all(np.isfinite(one))]).reshape(-1, 4)
    if not len(bounds):
        return -180.0, -90.0, 180.0, 90.0
    low, high = bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)
    wider = _MARGIN * np.maximum(high - low, 1e-6)
    (west, south), (east, north) = (low - wider).tolist(), (high + wider).tolist()
    return west, south, east, north


def _box(above: Element, *edges: float) -> None:
    for key, value in zip(("xmin", "ymin", "xmax", "ymax"), edges, strict=True):
        SubElement(above, key).text = repr(value)
