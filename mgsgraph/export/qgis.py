"""Styles for QGIS (.qml), and a project (.qgs) that shows the GIS layers of a solution with them.

A style says no more than how a layer is drawn: rules with a symbol each. The project names its files relative to
itself, has the coordinate system of the body, and measures on its ellipsoid. QGIS 3.22 and newer read both.
"""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import shapely

from mgsgraph.export.gis_layers import Layer
from mgsgraph.files.rasters.coordinate_systems import geographic_crs, wkt2
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.records import Array

PROJECT = "solution.qgs"
"""Name of the project's file."""
STYLES = "styles"
"""Folder of the styles of the GeoPackage's layers."""
_VERSION = "3.22.0"
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
    if "used" in layer.fields:
        used = _marker("took part", '"used"', _BLUE, "circle", 1.6)
        return [used, _marker("rejected", 'NOT "used"', _RED, "cross2", 2.2)]
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


# --- files


def write_style(layer: Layer, path: Path) -> None:
    """Write how a layer is drawn as a .qml; one beside a table of the same name, QGIS takes by itself."""
    root = Element("qgis", {"version": _VERSION, "styleCategories": "Symbology"})
    _renderer(root, style(layer))
    SubElement(root, "layerGeometryType").text = _KINDS[layer.geometry][2]
    _write(root, path)


def write_project(layers: Sequence[Layer], package: str, body: Ellipsoid, title: str, path: Path) -> None:
    """Write a project of layers that lie in a GeoPackage of the name `package` beside it, the first one on top."""
    root = Element("qgis", {"version": _VERSION, "projectname": title})
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
    _write(root, path)


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


def _write(root: Element, path: Path) -> None:
    indent(root)
    head = b"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
    path.write_bytes(head + tostring(root, encoding="utf-8") + b"\n")
