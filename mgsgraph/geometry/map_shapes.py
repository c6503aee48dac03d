"""Body-fixed places as shapes on a map of longitude and latitude, split where they cross the date line.

Degrees: longitude east in -180 .. 180, planetocentric latitude. Edges are great circles: where one spans much
longitude it gets places in between, since a straight line on the map is another curve.
"""

from typing import Any

import numpy as np
import shapely
import shapely.geometry
from numpy.typing import NDArray

from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.units import DEG

Shapes = NDArray[Any]
"""Shapely geometries; None where there is nothing."""

_STEP = 0.1
"""deg of longitude that an edge may span: its great circle leaves the map's straight line by half a metre on Mars."""
_HALF_TURN = 180.0


def map_degrees(points: Array) -> Array:
    """Longitude and latitude (..., 2) in degrees of points (..., 3) in m."""
    return np.asarray(planetocentric(points)[..., :2] / DEG)


def map_points(points: Array) -> Shapes:
    """Points (n) of places (n, 3) in m; None where these are NaN."""
    shapes, there = _nothing(points.shape[0]), np.isfinite(points).all(axis=1)
    shapes[there] = shapely.points(map_degrees(points[there]))
    return shapes


def map_lines(starts: Array, ends: Array) -> Shapes:
    """Lines (n) between places (n, 3) each, in m."""
    return _shapes(np.stack([starts, ends], axis=1), shapely.linestrings, _line)


def map_polygons(rings: Array) -> Shapes:
    """Polygons (n) of closed outlines (n, k, 3) in m, each around less than half of the body."""
    return _shapes(rings, shapely.polygons, _polygon)


def map_polygon(ring: Array) -> Any:
    """Polygon of one closed outline (k, 3) in m; None of an empty one."""
    return map_polygons(ring[None])[0] if ring.shape[0] else None


def _nothing(count: int) -> Shapes:
    return np.full(count, None, dtype=object)


def _shapes(paths: Array, at_once: Any, one_by_one: Any) -> Shapes:
    """Shapes of paths (n, k, 3): the short ones away from date line and poles at once, the others one by one."""
    shapes, places = _nothing(paths.shape[0]), map_degrees(paths)
    plain = np.all(np.abs(np.diff(places[..., 0], axis=1)) <= _STEP, axis=1)
    shapes[plain] = at_once(places[plain])
    for k in np.flatnonzero(~plain).tolist():
        shapes[k] = one_by_one(paths[k])
    return shapes


def _line(path: Array) -> Any:
    return _in_the_map(shapely.linestrings(_unrolled(path)))


def _polygon(ring: Array) -> Any:
    """Polygon of a closed ring (k, 3); one that goes around a pole reaches up (or down) to the map's edge."""
    places = _unrolled(ring)
    if abs(places[-1, 0] - places[0, 0]) > _HALF_TURN:
        pole = np.copysign(0.5 * _HALF_TURN, ring.mean(axis=0)[2])
        places = np.concatenate([places, [[places[-1, 0], pole], [places[0, 0], pole], places[0]]])
    polygon = shapely.polygons(places)
    if not shapely.is_valid(polygon):  # jitter can make edges cross
        polygon = shapely.buffer(shapely.make_valid(polygon), 0.0)
    return _in_the_map(polygon)


def _unrolled(path: Array) -> Array:
    """Longitude and latitude (m, 2) in degrees along a path (k, 3), longitudes without a jump; no step over _STEP."""
    longitude = np.unwrap(map_degrees(path)[:, 0], period=2.0 * _HALF_TURN)
    pieces = np.maximum(np.ceil(np.abs(np.diff(longitude)) / _STEP), 1).astype(np.int64)
    edge = np.repeat(np.arange(pieces.size), pieces)
    share = (np.arange(edge.size) - np.repeat(np.cumsum(pieces) - pieces, pieces)) / pieces[edge]
    between = path[edge] + share[:, None] * (path[edge + 1] - path[edge])
    places = map_degrees(np.concatenate([between, path[-1:]]))
    places[:, 0] = np.unwrap(places[:, 0], period=2.0 * _HALF_TURN)
    return places


def _in_the_map(shape: Any) -> Any:
    """A shape whose longitudes go on beyond half a turn, cut at the date line and put back into -180 .. 180."""
    west, _, east, _ = shapely.bounds(shape)
    first, last = (int(np.floor((edge + _HALF_TURN) / (2.0 * _HALF_TURN))) for edge in (west, east))
    if first == last == 0:
        return shape
    parts = []
    for turn in range(first, last + 1):
        middle = 2.0 * _HALF_TURN * turn
        sheet = shapely.box(middle - _HALF_TURN, -_HALF_TURN, middle + _HALF_TURN, _HALF_TURN)
        part = shapely.intersection(shape, sheet)
        parts.append(shapely.transform(part, lambda at, middle=middle: at - [middle, 0.0]))
    dimension = shapely.get_dimensions(shape)
    pieces = shapely.get_parts(shapely.union_all(parts))  # a ring around a pole is cut at its own ends, too
    kept = pieces[shapely.get_dimensions(pieces) == dimension]  # what only touches the date line is no part
    return (shapely.multipolygons if dimension == 2 else shapely.multilinestrings)(kept)


def geojson(shape: Any) -> dict[str, Any] | None:
    """A shape as GeoJSON's geometry; None of none."""
    return None if shape is None else dict(shapely.geometry.mapping(shape))


def map_bounds(shape: Any) -> tuple[float, float, float, float]:
    """West, south, east and north of a shape in degrees; west is larger than east where it crosses the date line
    (RFC 7946, 5.2).
    """
    west, south, east, north = (float(edge) for edge in shapely.bounds(shape))
    parts = shapely.bounds(shapely.get_parts(shape))
    left, right = parts[parts[:, 0] == -_HALF_TURN], parts[parts[:, 2] == _HALF_TURN]
    if len(left) and len(right) and len(left) + len(right) == len(parts) and not np.any(left[:, 2] == _HALF_TURN):
        west, east = float(right[:, 0].min()), float(left[:, 2].max())
    return west, south, east, north
