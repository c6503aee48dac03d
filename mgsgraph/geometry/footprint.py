"""Footprints of images on the ellipsoid, and by how much they overlap; the date line and the poles are no exceptions.

Areas are true on the ellipsoid: outlines go to the sphere of the same area (authalic latitude; Snyder 1987, Map
Projections, p. 16) and from there to the equal-area plane around each pair's middle (Lambert; p. 182), where shapely
cuts polygons.

Body-fixed places as shapes on a map of longitude and latitude, split where they cross the date line.

Degrees: longitude east in -180 .. 180, planetocentric latitude. Edges are great circles: where one spans much
longitude it gets places in between, since a straight line on the map is another curve.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
import shapely.geometry
from numpy.typing import NDArray

from mgsgraph.errors import InputError, require
from mgsgraph.geometry.body import Ellipsoid, planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask, assign, finite_rows, frozen, no_rows
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.units import DEG

Shapes = NDArray[Any]
"""Shapely geometries; None where there is nothing."""

_STEP = 0.1
"""deg of longitude that an edge may span: its great circle leaves the map's straight line by half a metre on Mars."""
_HALF_TURN = 180.0
_SPECK = 1e-14
"""Share of the largest part of a shape up to which another one is rounding."""
_EXACT = 2.0**-40
"""deg (0.1 um) to which longitudes around a pole are rounded, so that both ends of the ring are one place, no slit."""


def map_degrees(points: Array) -> Array:
    """Longitude and latitude (..., 2) in degrees of points (..., 3) in m."""
    return np.asarray(planetocentric(points)[..., :2] / DEG)


def map_points(points: Array) -> Shapes:
    """Points (n) of places (n, 3) in m; None where these are NaN."""
    shapes, finite = _nothing(points.shape[0]), finite_rows(points)
    shapes[finite] = shapely.points(map_degrees(points[finite]))
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
        places[:, 0] = np.round(places[:, 0] / _EXACT) * _EXACT
        places[-1] = places[0] + [np.copysign(2.0 * _HALF_TURN, places[-1, 0] - places[0, 0]), 0.0]
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
    if shapely.is_empty(shape):  # of an outline without an inside
        return shape
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
    sizes = shapely.area(pieces) if dimension == 2 else shapely.length(pieces)
    large = pieces[sizes > _SPECK * sizes.max()]  # what only touches the date line is no part
    return (shapely.multipolygons if dimension == 2 else shapely.multilinestrings)(large)


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


def eastward_bounds(ring: Array) -> tuple[float, float, float, float]:
    """West, south, east and north in degrees of what a closed outline (k, 3) encloses, longitudes in 0 .. 360: west is
    larger than east where it crosses the prime meridian, and they are 0 and 360 around a pole; NaN of an empty one.
    """
    if ring.shape[0] == 0:
        return (np.nan,) * 4
    west, south, east, north = map_bounds(map_polygon(ring))
    turn = 2.0 * _HALF_TURN
    return (0.0, south, turn, north) if east - west == turn else (west % turn, south, east % turn, north)


# --- footprints

_ALONG, _ACROSS = 32, 8
"""Places on each edge along and across the lines: the edges are curved, since the line turns and the body is round."""
_CHUNK = 4000
"""Pairs whose boxes are compared and whose polygons are cut at a time."""
_OBLONG = 10.0
"""How many times as long as the other an axis of a body may be."""
_SLACK = 1e-7
"""rad, by which bounding caps are widened against rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class Footprint:
    """What an image covers on the ground, less than half of the body."""

    name: str
    """Of the image."""
    outline: Array
    """(k, 3) m, body-fixed, closed: the last place is the first; (0, 3) where the image sees nothing of the body, or is
    too long for an outline (a swath of more than a quarter of the way around)."""
    body: Ellipsoid
    """Which it lies on."""
    whole: bool = True
    """False where the image looks past the body in part (the outline then runs straight between the places seen), and
    for a swath that is too long for an outline."""

    def __post_init__(self) -> None:
        outline = frozen(self.outline, f"footprint of {self.name}", (None, 3))
        if outline.shape[0] and (outline.shape[0] < 4 or not np.array_equal(outline[0], outline[-1])):
            found = f"an outline of {outline.shape[0]} places"
            raise InputError(f"footprint of {self.name}", found, "at least four, of which the last is the first")
        assign(self, outline=outline)

    @property
    def centre(self) -> Array:
        """(3,) m: the mean direction of the outline at its mean radius; NaN for an empty footprint."""
        if self.outline.shape[0] == 0:
            return np.full(3, np.nan)
        radii = np.linalg.norm(self.outline[1:], axis=1)
        mean = np.mean(self.outline[1:] / radii[:, None], axis=0)
        return np.asarray(mean / np.linalg.norm(mean) * radii.mean())

    @property
    def longitude_latitude(self) -> Array:
        """(k, 2) rad, planetocentric. The first longitude is -pi .. pi; the others go on from there without a jump,
        beyond pi where the date line is crossed, and once around where the outline goes around a pole.
        """
        longitude, latitude, _ = planetocentric(self.outline).T
        return np.column_stack([np.unwrap(longitude), latitude])

    @property
    def pole(self) -> int:
        """1 where the north pole lies inside, -1 for the south pole, 0 for none."""
        if self.outline.shape[0] == 0:
            return 0
        longitude = self.longitude_latitude[:, 0]
        around = abs(longitude[-1] - longitude[0]) > np.pi
        return int(np.sign(self.centre[2])) if around else 0

    @property
    def area(self) -> float:
        """m^2 on the ellipsoid."""
        return float(areas([self])[0])

    @property
    def __geo_interface__(self) -> dict[str, Any]:
        """GeoJSON feature with the name, planetocentric degrees in -180 .. 180, cut at the date line."""
        shape = map_polygon(self.outline)
        return {"type": "Feature", "geometry": geojson(shape), "properties": {"image": self.name, "whole": self.whole}}

    def __repr__(self) -> str:
        part = "" if self.whole else ", not whole"
        return f"Footprint({self.name!r}, {self.area / 1e6:.6g} km^2{part})"


@dataclass(frozen=True, slots=True, eq=False)
class Overlaps:
    """Pairs of footprints that overlap."""

    pairs: Index
    """(p, 2) footprints, the smaller index first, in order."""
    areas: Array
    """(p,) m^2, positive."""
    shares: Array
    """(p,) of the smaller footprint's area, 0 .. 1."""


def footprint(
    image: PushbroomImage,
    height: float = 0.0,
    correction: OrientationCorrection | None = None,
    along: int = _ALONG,
    across: int = _ACROSS,
) -> Footprint:
    """Footprint of an image at a height above the ellipsoid.

    Parameters
    ----------
    image : PushbroomImage
        Any.
    height : float
        m, of the ground; an oblique image's footprint moves with it.
    correction : OrientationCorrection, optional
        of the nominal orientation; none when absent.
    along, across : int
        Places on each edge along and across the lines.
    """
    down, side = np.linspace(0.0, 1.0, along, endpoint=False), np.linspace(0.0, 1.0, across, endpoint=False)
    lines = np.concatenate([down, np.ones(across), 1.0 - down, np.zeros(across)]) * image.lines
    samples = np.concatenate([np.zeros(along), side, np.ones(along), 1.0 - side]) * image.samples
    places, _ = image.image_to_ground(lines, samples, height, correction)
    visible = finite_rows(places)
    usable = int(np.count_nonzero(visible)) >= 3 and not _goes_round(places[:along][visible[:along]])
    ring = places[visible] if usable else np.zeros((0, 3))
    return Footprint(image.name, np.concatenate([ring, ring[:1]]), image.body, bool(np.all(visible)) and usable)


def _goes_round(edge: Array) -> bool:
    """Whether places along an edge go more than a quarter of the way around the body: outlines lie in one plane."""
    direction = unit_vectors(edge)
    chords = np.linalg.norm(np.diff(direction, axis=0), axis=1)
    return bool(2.0 * np.arcsin(np.minimum(0.5 * chords, 1.0)).sum() > 0.5 * np.pi)


def areas(footprints: Sequence[Footprint]) -> Array:
    """Areas (m,) in m^2 on the ellipsoid; zero for empty footprints."""
    if not footprints:
        return np.zeros(0)
    outlines, radius = _directions(footprints)
    result = np.zeros(len(footprints))
    nonempty = _nonempty(footprints)
    result[nonempty] = shapely.area(_polygons(outlines[nonempty], _middles(outlines[nonempty]), radius))
    return result


def overlaps(footprints: Sequence[Footprint]) -> Overlaps:
    """All pairs of footprints that overlap.

    Pairs are left aside when their bounding caps or the boxes along and across each footprint do not meet; polygons are
    cut for the rest.

    Raises
    ------
    InputError
        If the footprints lie on different bodies.
    """
    if len(footprints) < 2:
        return Overlaps(np.zeros((0, 2), dtype=np.int64), np.zeros(0), np.zeros(0))
    outlines, radius = _directions(footprints)
    pairs = _near(outlines, _nonempty(footprints))
    cut = np.zeros(pairs.shape[0])
    for first in range(0, pairs.shape[0], _CHUNK):
        left, right = _polygon_pairs(outlines, pairs[first : first + _CHUNK], radius)
        cut[first : first + _CHUNK] = shapely.area(shapely.intersection(left, right))
    overlapping = cut > 0.0
    pairs, cut = pairs[overlapping], cut[overlapping]
    smaller = areas(footprints)[pairs].min(axis=1) if pairs.size else cut
    return Overlaps(pairs, cut, np.minimum(cut / smaller, 1.0))


def gaps(footprints: Sequence[Footprint], pairs: Index) -> Array:
    """Distances (p,) in m between pairs (p, 2) of footprints, zero where they meet; NaN with an empty footprint.

    Measured in the equal-area plane around the pair's middle: true to a few per cent for gaps below 0.5 rad.
    """
    distances = np.full(len(pairs), np.nan)
    sound = np.flatnonzero(_nonempty(footprints)[pairs].all(axis=1)) if len(pairs) else no_rows()
    if sound.size:
        outlines, radius = _directions(footprints)
        distances[sound] = shapely.distance(*_polygon_pairs(outlines, pairs[sound], radius))
    return distances


def _nonempty(footprints: Sequence[Footprint]) -> Mask:
    return np.array([footprint.outline.shape[0] > 0 for footprint in footprints])


def _directions(footprints: Sequence[Footprint]) -> tuple[Array, float]:
    """Outlines as unit vectors (m, k, 3) on the sphere of the same area, the last place repeated in shorter ones; and
    that sphere's radius in m.
    """
    body = footprints[0].body
    if not 1.0 / _OBLONG < body.polar / body.equatorial < _OBLONG:  # the sphere of its area would have no digits left
        found = f"an ellipsoid of {body.equatorial:g} x {body.polar:g} m"
        raise InputError(f"footprint of {footprints[0].name}", found, "one that is a body's")
    for other in footprints:
        require(other.body == body, f"footprint of {other.name}", "another body than the first one's", "one body")
    longest = max(max(footprint.outline.shape[0] for footprint in footprints), 1)
    outlines = np.zeros((len(footprints), longest, 3))
    outlines[:, :, 0] = 1.0
    for footprint, row in zip(footprints, outlines, strict=True):
        count = footprint.outline.shape[0]
        if count:
            row[:count], row[count:] = footprint.outline, footprint.outline[-1]
    return _authalic(outlines, body)


def _authalic(points: Array, body: Ellipsoid) -> tuple[Array, float]:
    """Unit vectors (..., 3) of points carried along their meridians so that areas on the ellipsoid become areas on a
    sphere; its radius in m (Snyder 1987, Eq. 3-11 to 3-13; his e^2 is negative for a prolate body).
    """
    a, b = body.equatorial, body.polar
    square = 1.0 - (b / a) ** 2

    def zone(sine: Array) -> Array:
        """Snyder's q of the sine of the geodetic latitude."""
        e = np.sqrt(abs(square))
        if e < 1e-6:
            return 2.0 * sine
        arc = np.arctanh(e * sine) / e if square > 0.0 else np.arctan(e * sine) / e
        return np.asarray((1.0 - square) * (sine / (1.0 - square * sine**2) + arc))

    x, y, z = np.moveaxis(points, -1, 0)
    planar, upright = np.hypot(x, y), z * (a / b) ** 2  # tan of geodetic = (a/b)^2 tan of planetocentric latitude
    top = float(zone(np.ones(1))[0])
    sine = np.clip(zone(upright / np.hypot(planar, upright)) / top, -1.0, 1.0)
    cosine = np.sqrt((1.0 - sine) * (1.0 + sine))
    east = np.where(planar > 0.0, planar, 1.0)
    return np.stack([cosine * x / east, cosine * y / east, sine], axis=-1), a * float(np.sqrt(0.5 * top))


def _middles(outlines: Array) -> Array:
    """Mean directions (m, 3) of outlines (m, k, 3)."""
    return unit_vectors(outlines.mean(axis=1))


def _tangents(centres: Array) -> tuple[Array, Array]:
    """Two unit vectors (m, 3) each, square to unit vectors (m, 3) and to each other."""
    axis = np.eye(3)[np.argmin(np.abs(centres), axis=1)]
    first = unit_vectors(np.cross(axis, centres))
    return first, np.cross(centres, first)


def _polygons(outlines: Array, centres: Array, radius: float) -> NDArray[Any]:
    """Polygons (p) of outlines (p, k, 3) in Lambert's equal-area plane around centres (p, 3), in m."""
    first, second = _tangents(centres)
    depth = np.einsum("pki,pi->pk", outlines, centres)
    factor = radius * np.sqrt(2.0 / np.maximum(1.0 + depth, 1e-9))
    flat = np.stack([np.einsum("pki,pi->pk", outlines, axis) * factor for axis in (first, second)], axis=-1)
    polygons: NDArray[Any] = shapely.polygons(flat)
    twisted = ~shapely.is_valid(polygons)  # jitter can make edges cross
    if np.any(twisted):
        polygons[twisted] = shapely.buffer(shapely.make_valid(polygons[twisted]), 0.0)
    return polygons


def _polygon_pairs(outlines: Array, pairs: Index, radius: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Polygons of pairs (p, 2), each pair around its own middle."""
    middles = _middles(outlines)
    between = middles[pairs].sum(axis=1)
    length = np.linalg.norm(between, axis=1)
    between = unit_vectors(np.where(length[:, None] > 1e-6, between, middles[pairs[:, 0]]))  # antipodes have no middle
    return _polygons(outlines[pairs[:, 0]], between, radius), _polygons(outlines[pairs[:, 1]], between, radius)


def _near(outlines: Array, nonempty: Mask) -> Index:
    """(p, 2) pairs that may overlap, the smaller index first, in order: their caps meet, and so do the boxes along and
    across either one. Found about the one with the larger cap, so that a few wide images don't make all look far.
    """
    from scipy.spatial import cKDTree  # takes its time to load

    centres = _middles(outlines)
    reach = np.arccos(np.clip(np.einsum("mki,mi->mk", outlines, centres), -1.0, 1.0)).max(axis=1) + _SLACK
    members = np.flatnonzero(nonempty)
    chords = 2.0 * np.sin(np.minimum(reach[members], 0.5 * np.pi)) + _SLACK
    around = cKDTree(centres[members]).query_ball_point(centres[members], chords)
    first = np.repeat(members, np.array([len(neighbors) for neighbors in around], dtype=np.int64))
    second = members[np.array([k for neighbors in around for k in neighbors], dtype=np.int64)]
    unique = (reach[second] < reach[first]) | ((reach[second] == reach[first]) & (first < second))
    pairs = np.sort(np.stack([first[unique], second[unique]], axis=1), axis=1)
    pairs = pairs[np.lexsort(pairs.T[::-1])]
    cosine = np.einsum("pi,pi->p", centres[pairs[:, 0]], centres[pairs[:, 1]])
    pairs = pairs[np.arccos(np.clip(cosine, -1.0, 1.0)) <= reach[pairs].sum(axis=1)]
    return np.asarray(pairs[_boxes_meet(outlines, centres, pairs) & _boxes_meet(outlines, centres, pairs[:, ::-1])])


def _boxes_meet(outlines: Array, centres: Array, pairs: Index) -> Mask:
    """(p,) True where the second of a pair (p, 2) lies partly within the first's box along its own main axes.

    The axes are square to the first one's centre: nowhere inside it is a coordinate larger than on its outline, and
    where it is inside the second one, that reaches beyond the box all the more.
    """
    first, second = _tangents(centres)
    flat = np.stack([np.einsum("mki,mi->mk", outlines, axis) for axis in (first, second)], axis=-1)
    spread = flat - flat.mean(axis=1, keepdims=True)
    _, turned = np.linalg.eigh(spread.mT @ spread)
    axes = np.stack([first, second], axis=2) @ turned  # (m, 3, 2)
    own = outlines @ axes
    low, high = own.min(axis=1), own.max(axis=1)
    meet = np.ones(len(pairs), dtype=bool)
    for begin in range(0, len(pairs), _CHUNK):
        j, k = pairs[begin : begin + _CHUNK].T
        along = outlines[k] @ axes[j]
        inside = (along.min(axis=1) <= high[j]) & (along.max(axis=1) >= low[j])
        meet[begin : begin + _CHUNK] = np.all(inside, axis=1)
    return meet
