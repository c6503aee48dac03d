"""GIS: a GeoPackage with the layers of a solution, and a GeoTIFF of a grid of sigmas.

The coordinate system is IAU_2015's "Sphere / Ocentric" (49900 of Mars, 30100 of the Moon): its latitude is the angle at
the body's centre, and its longitude counts east, as ours do. The others of Mars would say something else: the latitudes
of 49901 are geodetic (0.3 degrees off in the middle latitudes) and its longitudes count west; 49902 says what ours are,
but a GeoPackage defines its systems in a language (WKT 1) that has no word for it, so that GDAL takes its latitudes for
geodetic ones (3.6 and 3.12, tried). Heights are given above the body's ellipsoid, not above the sphere, in columns.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import shapely

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.places import SigmaGrid
from mgsgraph.analysis.statistics import adjusted_points, local_sigmas, ray_statistics, rejected_points
from mgsgraph.atomic_write import made_beside
from mgsgraph.errors import InputError, library
from mgsgraph.files.output.folders import PROGRAM
from mgsgraph.files.output.table import columns, picked
from mgsgraph.files.rasters.raster_file import authority_code, geographic_crs, wkt2
from mgsgraph.files.writing import fresh_file
from mgsgraph.geometry.body import PROBABILITY, east_north_up, ellipsoidal_heights, error_ellipses
from mgsgraph.geometry.footprint import Footprint, Shapes, areas, map_lines, map_points, map_polygon, map_polygons
from mgsgraph.geometry.records import Array, Index, Mask, finite_rows
from mgsgraph.network import PointClass
from mgsgraph.network.connectivity import network_footprints
from mgsgraph.results.answers import write_sigma_raster
from mgsgraph.results.tables import points_table
from mgsgraph.units import DEG, ISIS_OFFSET, KM

_CORNERS = 48
"""Places on an ellipse."""
_SHOWN = 0.05
"""Share of the points' extent that an exaggerated vector or semi-major axis has at most, but for the largest ones."""
_LARGEST = 0.1
"""Share of them that may be larger: blunders, and tie points among laser points, which hardly move."""
_MOST = 1e6
"""Exaggeration at most: beyond it is rounding."""
_REACH = 5 * KM
"""m around an image's footprint within which laser points are projected into it: relief seen obliquely."""

Fields = Mapping[str, Any]
"""Columns (n,) by name; names end in their unit."""


class Layer(NamedTuple):
    """One layer of a GeoPackage."""

    name: str
    """Of its table."""
    about: str
    """What it shows, in a sentence or two."""
    geometry: str
    """Point, MultiLineString or MultiPolygon."""
    shapes: Shapes
    """(n) shapes in degrees; None where a row has no place."""
    fields: Fields
    """Columns (n,): numbers, truth values or text."""


class Vectors(NamedTuple):
    """Arrows on the ground."""

    starts: Array
    """(n, 3) m, body-fixed."""
    steps: Array
    """(n, 3) m, from start to end."""
    typical: Mask
    """(n,) those whose length counts when an exaggeration is chosen."""
    fields: Fields
    """Columns (n,)."""


def exaggeration(lengths: Array, extent: float) -> float:
    """The largest of 1, 2, 5, 10, 20, ... with which 90 % of lengths (m) are at most 5 % of an extent (m).

    At least 1, at most a million; 1 where there is nothing to show.
    """
    sound = lengths[np.isfinite(lengths) & (lengths > 0.0)]
    factor = _SHOWN * extent / float(np.quantile(sound, 1.0 - _LARGEST)) if sound.size else 1.0
    steps = np.array([1.0, 2.0, 5.0])[:, None] * 10.0 ** np.arange(7)
    return float(steps[steps <= max(min(factor, _MOST), 1.0)].max())


def extent(places: Array) -> float:
    """m, diameter of places (n, 3) about their mean; 0 where none is known."""
    sound = places[finite_rows(places)]
    return 2.0 * float(np.linalg.norm(sound - sound.mean(axis=0), axis=1).max()) if sound.size else 0.0


# --- footprints


def footprint_layers(solution: Solution) -> list[Layer]:
    """Footprints of the images with the nominal and with the adjusted orientation."""
    network = solution.network
    before = network_footprints(network, solution.places_before)
    after = _adjusted_footprints(solution)
    heights = "at the middle height of the points that each one measures"
    return [
        _footprints(solution, before, "footprints_nominal", f"Images with their nominal orientation, {heights}."),
        _footprints(solution, after, "footprints_adjusted", f"Images with their adjusted orientation, {heights}."),
    ]


def _adjusted_footprints(solution: Solution) -> tuple[Footprint, ...]:
    """Footprints with adjusted orientation and focal length."""
    images = tuple(solution.image(j) for j in range(len(solution.network.images)))
    return network_footprints(replace(solution.network, images=images), solution.places, solution.correction)


def _footprints(solution: Solution, footprints: tuple[Footprint, ...], name: str, about: str) -> Layer:
    network, rays = solution.network, ray_statistics(solution)
    owners = ["", *(owner.name for owner in network.passes)]
    edges = np.array([image.span for image in network.images])
    heights = [ellipsoidal_heights(footprint.outline, footprint.body) for footprint in footprints]
    fields = {
        "image": network.image_names,
        "pass": picked(owners, network.pass_of + 1),
        "held": network.held,
        "whole": np.array([footprint.whole for footprint in footprints]),
        "lines": np.array([image.lines for image in network.images]),
        "samples": np.array([image.samples for image in network.images]),
        **columns(["first_line_et_s", "last_line_et_s"], edges),
        "area_km2": areas(footprints) / KM**2,
        "height_m": np.array([float(values.mean()) if values.size else np.nan for values in heights]),
        "rays": rays.total,
        "rays_used": rays.count.sum(axis=1),
        **columns(["residual_rms_line_px", "residual_rms_sample_px"], rays.rms_of_images),
    }
    shapes = np.empty(len(footprints), dtype=object)
    shapes[:] = [map_polygon(footprint.outline) for footprint in footprints]
    return Layer(name, about, "MultiPolygon", shapes, fields)


# --- points


_CLASSES = {
    PointClass.TIE: "tie points", PointClass.LASER: "laser points", PointClass.CONTROL: "control points",
    PointClass.POST: "posts of terrain models",
}  # fmt: skip
_POINT_COLUMNS = ("id", "kind", "rejected", "rays", "rays_used", "lon_deg", "lat_deg", "radius_m", "height_m",
                  "height_above_areoid_m")  # fmt: skip
"""Of points.csv that layers of points have."""


def point_layers(solution: Solution) -> list[Layer]:
    """Ground points, a layer for each class, those of none too."""
    fields = _point_fields(solution)
    classes = solution.network.points.classes
    return [
        Layer(
            f"{kind.name.lower()}_points", f"Adjusted places of {what}; no shape where undetermined.", "Point",
            map_points(solution.places[members]), _rows(fields, members),
        )
        for kind, what in _CLASSES.items() if kind in solution.network.classes
        for members in [np.flatnonzero(classes == kind)]
    ]  # fmt: skip


def _point_fields(solution: Solution) -> dict[str, Any]:
    """Columns of points.csv without the body-fixed ones, what moved and sigmas towards east, north and up."""
    places, ways = solution.places, ("east", "north", "up")
    moved = _components(east_north_up(places), places - solution.places_before)
    sigmas = local_sigmas(solution.covariances, places)
    table = {part.name(): part.scaled for column in points_table(solution).columns for part in column.split}
    return {
        **{name: table[name] for name in _POINT_COLUMNS if name in table},
        **columns([f"correction_{way}_m" for way in ways], moved),
        **columns([f"sigma_{way}_m" for way in ways], sigmas),
        **columns([f"scaled_sigma_{way}_m" for way in ways], sigmas * solution.sigma0),
        **_residual_fields(solution),
    }


def _residual_fields(solution: Solution) -> dict[str, Array]:
    """Root mean squares of each point's residuals that took part; NaN where it has none."""
    network, count = solution.network, len(solution.network.points)
    rays, ranges = solution.rays_used, solution.ranges_used

    def rms(point: Index, residuals: Array) -> Array:
        squares = np.bincount(point, residuals**2, count)
        number = np.bincount(point, minlength=count)
        return np.where(number > 0, np.sqrt(squares / np.maximum(number, 1)), np.nan)

    line, sample = (rms(network.rays.point[rays], solution.residuals[rays, c]) for c in range(2))
    distance = rms(network.ranges.point[ranges], solution.range_residuals[ranges])
    return {"residual_rms_line_px": line, "residual_rms_sample_px": sample, "residual_rms_range_m": distance}


def _components(frame: Array, vectors: Array) -> Array:
    """Vectors (n, 3) along the axes (n, 3, 3)."""
    return np.asarray(np.einsum("nij,nj->ni", frame, vectors))


def _rows(fields: Fields, rows: Index) -> dict[str, Any]:
    """Some rows of columns."""
    return {name: v[rows] if isinstance(v, np.ndarray) else picked(v, rows) for name, v in fields.items()}


# --- error ellipses


def ellipse_layers(solution: Solution) -> list[Layer]:
    """Error ellipses of the adjusted points towards east and north, true and exaggerated."""
    points = np.flatnonzero(adjusted_points(solution))
    places, frame = solution.places[points], east_north_up(solution.places[points])
    covariances = frame @ solution.covariances[points] @ frame.mT
    semi_axes, axes = error_ellipses(covariances[:, :2, :2])  # minor first
    factor = exaggeration(semi_axes[:, 1], extent(solution.places))
    azimuth = np.arctan2(axes[:, 0, 1], axes[:, 1, 1]) / DEG % 180.0
    fields = _point_names(solution, points) | {
        **columns(["semi_minor_m", "semi_major_m"], semi_axes),
        **columns(["scaled_semi_minor_m", "scaled_semi_major_m"], semi_axes * solution.sigma0),
        "azimuth_deg": azimuth,
        "sigma_up_m": np.sqrt(np.maximum(covariances[:, 2, 2], 0.0)),
    }
    offsets = _rings(frame[:, :2].mT @ (axes * semi_axes[:, None, :]))
    about = (
        f"Ellipses in which the true places lie with {PROBABILITY:.0%} probability, for sigma0 = 1 (scaled: times "
        "sigma0); azimuth of the major axis from north over east."
    )
    return [
        Layer(name, words, "MultiPolygon", map_polygons(places[:, None] + scale * offsets), _stated(fields, scale))
        for name, words, scale in _both("error_ellipses", about, factor)
    ]


def _rings(semi_axes: Array) -> Array:
    """Places (n, k, 3) on ellipses about the origin with semi-axes (n, 3, 2), the last one the first again."""
    turn = np.linspace(0.0, 2.0 * np.pi, _CORNERS + 1)
    circle = np.stack([np.cos(turn), np.sin(turn)])
    circle[:, -1] = circle[:, 0]
    return np.asarray((semi_axes @ circle).mT)


def _point_names(solution: Solution, points: Index) -> dict[str, Any]:
    """Names and classes of points, one for each row."""
    network = solution.network
    names = [kind.name.lower() for kind in PointClass]
    return {"point": picked(network.points.ids, points), "class": picked(names, network.points.classes[points])}


def _both(name: str, about: str, factor: float) -> list[tuple[str, str, float]]:
    """Name, words and factor of a layer and of its exaggerated copy."""
    more = f"{about} Shapes are exaggerated {factor:g} times, figures are not."
    return [(name, about, 1.0), (f"{name}_exaggerated", more, factor)]


def _stated(fields: Fields, factor: float) -> dict[str, Any]:
    count = len(next(iter(fields.values())))
    return {**fields, "exaggeration": np.full(count, factor)}


# --- vectors


def vector_layers(solution: Solution) -> list[Layer]:
    """Corrections of points, misregistration of laser points and residuals of rays, true and exaggerated."""
    size = extent(solution.places)
    return [
        *_arrows("corrections", "Ground points: from their places before to the adjusted ones.",
                 _corrections(solution), size),
        *_arrows("misregistration", "Laser points in images: from where the nominal orientation puts the pixel that "
                 "shows the point after the adjustment to the adjusted point; moved: its places in the image, after "
                 "minus before.", _misregistration(solution), size),
        *_arrows("residuals", "Rays: from the adjusted point to where the measured place is on the ground at its "
                 "height; residuals are measured minus predicted.", _residuals(solution), size),
    ]  # fmt: skip


def _arrows(name: str, about: str, vectors: Vectors, size: float) -> list[Layer]:
    frame = east_north_up(vectors.starts)
    parts, length = _components(frame, vectors.steps), np.linalg.norm(vectors.steps, axis=1)
    factor = exaggeration(np.linalg.norm(parts[vectors.typical, :2], axis=1), size)
    fields = {**vectors.fields, **columns(["east_m", "north_m", "up_m"], parts), "length_m": length}
    ends, level = vectors.starts + vectors.steps, np.einsum("nij,ni->nj", frame[:, :2], parts[:, :2])
    return [
        Layer(layer_name, words, "MultiLineString", map_lines(vectors.starts, ends + (scale - 1.0) * level),
              _stated(fields, scale))
        for layer_name, words, scale in _both(name, about, factor)
    ]  # fmt: skip


def _corrections(solution: Solution) -> Vectors:
    """All adjusted points that had a place before."""
    step = solution.places - solution.places_before
    points = np.flatnonzero(adjusted_points(solution) & finite_rows(step))
    fields = {**_point_names(solution, points), "rejected": rejected_points(solution)[points]}
    return Vectors(solution.places_before[points], step[points], ~fields["rejected"], fields)


def _misregistration(solution: Solution) -> Vectors:
    """Laser points in every image that they fall into with the adjusted orientation."""
    parts = [_in_image(solution, j, footprint) for j, footprint in enumerate(_adjusted_footprints(solution))]
    points, starts, ends, before, after = (np.concatenate(column) for column in zip(*parts, strict=True))
    images = [name for part, name in zip(parts, solution.network.image_names, strict=True)
              for _ in range(part[0].size)]  # fmt: skip
    fields = {
        **_point_names(solution, points),
        "image": images,
        **columns(["isis_line", "isis_sample"], after + ISIS_OFFSET),
        **columns(["moved_line_px", "moved_sample_px"], after - before),
    }
    return Vectors(starts, ends - starts, np.ones(points.size, dtype=bool), fields)


def _in_image(solution: Solution, j: int, footprint: Footprint) -> tuple[Index, Array, Array, Array, Array]:
    """Laser points (k,) in an image, where its nominal orientation puts them and where they are (k, 3), and their
    places (k, 2) in it before and after.
    """
    near = _near(footprint, solution.places, solution.members(PointClass.LASER))
    nominal, adjusted = solution.network.images[j], solution.image(j)
    points, nominal_points = solution.places[near], solution.places_before[near]
    after, _ = adjusted.ground_to_image(points, solution.correction(j))
    before, _ = nominal.ground_to_image(nominal_points)
    with np.errstate(invalid="ignore"):
        inside = np.all((after >= 0.0) & (after <= [nominal.lines, nominal.samples]), axis=1)
    height = ellipsoidal_heights(points[inside], nominal.body)
    starts, _ = nominal.image_to_ground(after[inside, 0], after[inside, 1], height)
    finite = finite_rows(starts)
    chosen = np.flatnonzero(inside)[finite]
    return near[chosen], starts[finite], points[chosen], before[chosen], after[chosen]


def _near(footprint: Footprint, places: Array, points: Index) -> Index:
    """Those of some points that are near a footprint; all of them where it has no outline."""
    if footprint.outline.shape[0] == 0:
        return points
    reach = np.linalg.norm(footprint.outline - footprint.centre, axis=1).max() + _REACH
    return np.asarray(points[np.linalg.norm(places[points] - footprint.centre, axis=1) < reach])


def _residuals(solution: Solution) -> Vectors:
    """Rays of determined points, rejected ones too."""
    rays, steps = solution.network.rays, np.full((solution.network.rays.point.size, 3), np.nan)
    heights = ellipsoidal_heights(solution.places, solution.network.body)
    for j in np.unique(rays.image).tolist():
        of_image = np.flatnonzero((rays.image == j) & finite_rows(solution.residuals))
        line, sample = (rays.places[of_image] - solution.residuals[of_image]).T
        _, rate = solution.image(j).image_to_ground(line, sample, heights[rays.point[of_image]], solution.correction(j))
        steps[of_image] = np.einsum("nij,nj->ni", rate, solution.residuals[of_image])
    starts = solution.places[rays.point]
    finite = np.flatnonzero(finite_rows(starts + steps))
    names = solution.network.image_names
    fields = {
        **_point_names(solution, rays.point[finite]),
        "image": picked(names, rays.image[finite]),
        "used": solution.rays_used[finite],
        **columns(["isis_line", "isis_sample"], rays.places[finite] + ISIS_OFFSET),
        **columns(["residual_line_px", "residual_sample_px"], solution.residuals[finite]),
        **columns(["normalised_line", "normalised_sample"], (solution.residuals / solution.network.ray_sigmas)[finite]),
    }
    return Vectors(starts[finite], steps[finite], solution.rays_used[finite], fields)



GEOPACKAGE, RASTER = "solution.gpkg", "sigmas.tif"
"""Names of the files."""
ABOUT = "about"
"""Table of the GeoPackage that says where it came from and what its layers mean; it has no shapes."""
_VERSION = "1.2"
"""Of the GeoPackage: one that GDAL 3.6 knows."""
_DECIMALS = 10
"""Of degrees: 6 micrometers on Mars. The last digits of a sum differ with its place in memory."""
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
    body = solution.network.body
    layers = [
        *footprint_layers(solution), *point_layers(solution), *ellipse_layers(solution), *vector_layers(solution),
    ]  # fmt: skip
    written = [folder / GEOPACKAGE]
    with fresh_file(written[0]) as temporary, made_beside(written[0], folder=True) as scratch:
        _write_layers(layers, _statements(solution, layers), scratch / GEOPACKAGE, solution)
        (scratch / GEOPACKAGE).replace(temporary)  # GDAL wants the ending, and leaves its journals beside it
    if grid is not None:
        written.append(folder / RASTER)
        write_sigma_raster(grid, body, written[-1])
    return written


def _write_layers(layers: list[Layer], statements: dict[str, str], path: Path, solution: Solution) -> None:
    pyogrio, body = library("pyogrio", "gis", "GIS layers"), solution.network.body
    crs = authority_code(body) or wkt2(geographic_crs(body))  # by its code, or a GeoPackage loses the authority
    about = Layer(ABOUT, "Where this came from, and what the layers mean.", "", np.zeros(0), {
        "subject": list(statements), "statement": list(statements.values()),
    })  # fmt: skip
    with _dated(pyogrio, f"{_calendar(solution)[1]}Z"):
        for layer in (*layers, about):
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
        geometry=shapely.to_wkb(_rounded(layer.shapes)) if spatial else None,
        field_data=[_digits(name, np.asarray(values)) for name, values in layer.fields.items()],
        fields=np.array(list(layer.fields), dtype=object),
        layer=layer.name,
        driver="GPKG",
        geometry_type=layer.geometry if spatial else None,
        crs=crs if spatial else None,
        promote_to_multi=layer.geometry.startswith("Multi"),
        dataset_options={"VERSION": _VERSION},
        layer_options={"IDENTIFIER": layer.name, "DESCRIPTION": layer.about},
    )


def _rounded(shapes: Shapes) -> Shapes:
    """Rounded to digits that don't depend on memory alignment; narrow wedges at a pole stay valid."""
    rounded = shapely.transform(shapes, lambda xy: xy.round(_DECIMALS))
    return np.where(shapely.is_valid(rounded), rounded, shapes)


def _digits(name: str, column: np.ndarray) -> np.ndarray:
    """The same for all numbers but times."""
    if column.dtype.kind == "f" and not name.endswith("et_s"):
        return np.char.mod("%.12g", column).astype(float)
    return column if column.dtype.kind in "fib" else column.astype(object)


@contextmanager
def _dated(pyogrio: ModuleType, moment: str) -> Iterator[None]:
    """The time of day for GDAL, fixed so that the same solution gives the same bytes."""
    before = pyogrio.get_gdal_config_option("OGR_CURRENT_DATE")
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": moment})
    try:
        yield
    finally:
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": before})


def _calendar(solution: Solution) -> tuple[str, str]:
    """When the first and the last line of all images were read, TDB."""
    edges = np.array([image.span for image in solution.network.images])
    first, last = (_NOON + np.timedelta64(round(1e3 * edge), "ms") for edge in (edges.min(), edges.max()))
    return str(first), str(last)


def _statements(solution: Solution, layers: list[Layer]) -> dict[str, str]:
    """Where the layers come from and what they mean, by subject."""
    fit, body = solution.fit, solution.network.body
    first, last = _calendar(solution)
    return {
        "program": f"{PROGRAM} ({', '.join(f'{name} {version}' for name, version in solution.versions.items())})",
        "solution": f"{solution.name}: {solution.ending}; {solution.message}",
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
