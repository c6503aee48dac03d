"""Tables of a solution: images, points, orientation, residuals, pairs of images.

The columns of files carry their units. Lines and samples are counted as ISIS does, the first pixel's centre at (1, 1);
latitudes are planetocentric, longitudes run east from 0 to 360 degrees, heights are given as radii.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from mgsgraph.adjustment.solution import Solution, orientation_profiles
from mgsgraph.analysis.statistics import PLACES, local_sigmas, rejected_points, used_ray_counts
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.files.output.table import Column, Table, padded, picked, write_parquet
from mgsgraph.files.rasters.raster_file import geographic_crs
from mgsgraph.geometry.body import Ellipsoid, east_north_up, ellipsoidal_heights, planetocentric
from mgsgraph.geometry.records import Array, Index, no_rows, sigmas_of
from mgsgraph.names import RepeatedNames
from mgsgraph.network import PointClass
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.results.section import record_of, table_of
from mgsgraph.units import DEG, ISIS_OFFSET

_REMARKS = ("bridge", "overlap without common points", "common points without overlap")


def points_table(solution: Solution, rows: slice | Index = slice(None)) -> Table:
    """One row per ground point: adjusted place, sigmas, covariance, rays and correction; unknown where undetermined.
    Some of the `rows` alone where the table has a choice of the points.
    """
    network, places, covariances = solution.network, solution.places[rows], solution.covariances[rows]
    sigmas = sigmas_of(covariances)
    moved, rejected = places - solution.places_before[rows], rejected_points(solution)[rows]
    longitude, latitude, radius = planetocentric(places).T
    a, b = np.triu_indices(3)
    return table_of("points", {
        "id": network.points.ids[rows], "class": _member_names(PointClass, network.points.classes[rows]),
        "kind": _member_names(PointKind, network.points.kinds[rows]), "rejected": rejected,
        "rays": network.ray_counts[rows], "rays_used": used_ray_counts(solution)[rows], "{}": places,
        "lon": longitude / DEG % 360.0, "lat": latitude, "radius": radius,
        "height": ellipsoidal_heights(places, network.body),
        "height_above_areoid": None if network.areoid is None else radius - network.areoid.at(places),
        "sigma_{} m": sigmas, "sigma_{} east/north/up": local_sigmas(covariances, places),
        "scaled_sigma_{}": sigmas * solution.sigma0, "cov_{}": covariances[:, a, b], "correction_{}": moved,
        "moved_{}": np.einsum("nij,nj->ni", east_north_up(places), moved),
        "state": picked(("used", "rejected"), rejected.astype(np.int64)),
    })  # fmt: skip


def orientation_table(solution: Solution) -> Table:
    """The exterior orientation of every image at the papers' 31 places, before and after."""
    images = solution.network.images
    profiles = orientation_profiles(solution, places=PLACES)

    def values_of(name: str) -> Array:
        return np.asarray(getattr(profiles, name))

    names = RepeatedNames(tuple(image.name for image in images), np.repeat(np.arange(len(images)), PLACES))
    before, after = values_of("position_before"), values_of("position_after")
    return table_of("orientation", {
        "image": names, "isis_line": values_of("lines") + ISIS_OFFSET, "time_et": values_of("times"),
        "{}_before m": before,
        "{}_after m": after, "{}_difference m": after - before, **record_of("orientation", profiles),
    })  # fmt: skip


def residuals_table(solution: Solution) -> Table:
    """One row per ray, per range and per height above a stereo surface: residuals (measured minus predicted) before and
    after.

    A normalised residual is the residual over its a-priori sigma. A range has the line at which its shot was taken. A
    height, of which zero is measured, belongs to no image alone, and to no nominal orientation.
    """
    network, rays, ranges = solution.network, solution.network.rays, solution.network.ranges
    stereo_points, heights, height_sigmas = _stereo_heights(solution)
    k, r, h = rays.point.size, ranges.point.size, stereo_points.size
    point_numbers = np.concatenate([rays.point, ranges.point, stereo_points])
    image_numbers = np.concatenate([rays.image, ranges.image, np.full(h, -1)])
    used = np.concatenate([solution.rays_used, solution.ranges_used, solution.stereo_used[stereo_points]])
    before, after, sigmas = solution.residuals_before, solution.residuals, network.ray_sigmas
    tested = solution.test_dimensions
    if tested is not None:
        of_measures, of_points = np.split(tested, [k + r])
        tested = np.concatenate([of_measures, of_points[stereo_points]])
    of_rays = {
        f"{name}_{axis}": padded(values[:, column], 0, r + h)
        for column, axis in enumerate(("line", "sample"))
        for name, values in (("residual_before", before), ("residual", after), ("sigma", sigmas),
                             ("normalised", after / sigmas))
    }  # fmt: skip
    return table_of("measures", {
        "kind": picked(("image", "range", "stereo height"), np.repeat(np.arange(3), [k, r, h])),
        "point": picked(network.points.ids, point_numbers),
        "class": _member_names(PointClass, network.points.classes[point_numbers]),
        "image": picked(["", *network.image_names], image_numbers + 1), "used": used,
        "tested": tested,
        "isis_line": padded(np.concatenate([rays.places[:, 0], _shot_lines(solution)]), 0, h) + ISIS_OFFSET,
        "isis_sample": padded(rays.places[:, 1], 0, r + h) + ISIS_OFFSET, **of_rays,
        "range": padded(ranges.values, k, h), "residual_before_range": padded(solution.range_residuals_before, k, h),
        "residual_range": padded(solution.range_residuals, k, h), "sigma_range": padded(network.range_sigmas, k, h),
        "normalised_range": padded(solution.range_residuals / network.range_sigmas, k, h),
        "residual_height": padded(-heights, k + r, 0), "sigma_height": padded(height_sigmas, k + r, 0),
        "normalised_height": padded(-heights / height_sigmas, k + r, 0),
    })  # fmt: skip


def residual_points(solution: Solution) -> Index:
    """(m,) number of the ground point of each row of `residuals_table`."""
    network = solution.network
    return np.concatenate([network.rays.point, network.ranges.point, _stereo_heights(solution)[0]])


def _stereo_heights(solution: Solution) -> tuple[Index, Array, Array]:
    """Points (h,) on stereo surfaces, their heights above them and a-priori sigmas (h,), m."""
    control, heights = solution.network.stereo, solution.stereo_heights
    if control is None or heights is None:
        return no_rows(), np.zeros(0), np.zeros(0)
    points = np.flatnonzero(control.surface >= 0)
    return points, heights[points], control.sigmas[points]


def connectivity_table(connected: Connectivity) -> Table:
    """One row per pair of images that share points or overlap: points by class, area, distance, and a remark."""
    names, points = connected.names, connected.points
    marks = connected.bridges, (points == 0) & (connected.areas > 0.0), (points > 0) & (connected.gaps > 0.0)
    remarks = [
        ", ".join(word for word, flag in zip(_REMARKS, row, strict=True) if flag) for row in zip(*marks, strict=True)
    ]
    return table_of("connectivity", {
        "image_a": picked(names, connected.pairs[:, 0]), "image_b": picked(names, connected.pairs[:, 1]),
        "common_points": points,
        **{f"{kind.name.lower()}_points": connected.common[:, kind] for kind in PointClass if kind.measured},
        "remark": remarks, "overlap": connected.areas, "overlap_share": connected.shares, "gap": connected.gaps,
    })  # fmt: skip


def _shot_lines(solution: Solution) -> Array:
    """(r,) line of the carrying image that was read when the shot was taken."""
    ranges, lines = solution.network.ranges, np.empty(solution.network.ranges.point.size)
    order = np.argsort(ranges.image, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(ranges.image[order])) + 1) if order.size else []:
        image = solution.network.images[ranges.image[rows[0]]]
        lines[rows] = image.timing.lines(ranges.times[rows] - image.trajectory.epoch)
    return lines


def _member_names(kind: type[PointClass] | type[PointKind], codes: np.ndarray) -> Sequence[str]:
    return picked([member.name.lower() for member in kind], codes)



TableForm = Literal["csv", "parquet"]
"""Form of the tables of points and residuals."""
MOST_CSV_ROWS = 200_000
"""Rows of the longer table up to which both are CSV, unless another form is asked for."""
GEOMETRY = "geometry"
"""Name of the column of positions or shapes."""
_VERSION = "1.1.0"
_POINT = np.dtype([("order", "u1"), ("kind", "<u4"), ("place", "<f8", 2)])
"""A point in the plane as OGC's well-known binary."""


def form_of(solution: Solution, requested: TableForm | None = None) -> TableForm:
    """The form that is asked for, or else the one for tables of this length."""
    network = solution.network
    rows = max(len(network.points), network.rays.point.size + network.ranges.point.size)
    return requested or ("csv" if rows <= MOST_CSV_ROWS else "parquet")


def write_large_tables(solution: Solution, folder: Path, requested: TableForm | None = None) -> list[str]:
    """Write points and residuals into a folder; the names of the two files."""
    form = form_of(solution, requested)
    names = [f"points.{form}", f"residuals.{form}"]
    if form == "csv":
        points_table(solution).write_csv(folder / names[0])
        residuals_table(solution).write_csv(folder / names[1])
        return names
    points = with_points(points_table(solution), solution.places)
    write_geoparquet(folder / names[0], [points], solution.network.body)
    write_parquet(folder / names[1], [residuals_table(solution)])
    return names


# --- rows with a place


def with_points(table: Table, places: Array) -> Table:
    """The table with a column of places (n, 3) in m, as longitude and planetocentric latitude; null where NaN."""
    longitude, latitude, _ = planetocentric(places).T
    east = longitude / DEG % 360.0
    geometry = np.empty(len(places), dtype=_POINT)
    geometry["order"], geometry["kind"] = 1, 1
    geometry["place"][:, 0] = np.where(east > 180.0, east - 360.0, east)
    geometry["place"][:, 1] = latitude / DEG
    validity = np.packbits(np.isfinite(longitude), bitorder="little")
    buffers = [pa.py_buffer(validity), pa.py_buffer(geometry)]
    return with_shapes(table, pa.Array.from_buffers(pa.binary(_POINT.itemsize), len(places), buffers))


def with_shapes(table: Table, shapes: Sequence[bytes | None] | pa.Array) -> Table:
    """The table with a column of shapes (n,), in degrees, as well-known binary; null for None."""
    column = shapes.cast(pa.large_binary()) if isinstance(shapes, pa.Array) else pa.array(shapes, pa.large_binary())
    return replace(table, columns=(*table.columns, Column(GEOMETRY, column, meaning="WKB, degrees")))


def write_geoparquet(path: Path, pieces: Iterable[Table], body: Ellipsoid) -> None:
    """Write tables that `with_points` made, one after another, as one GeoParquet file of points on a body."""
    about: dict[str, Any] = {
        "encoding": "WKB", "geometry_types": ["Point"], "crs": geographic_crs(body), "edges": "planar",
    }  # fmt: skip
    geo = {"version": _VERSION, "primary_column": GEOMETRY, "columns": {GEOMETRY: about}}
    write_parquet(path, pieces, {"geo": json.dumps(geo)})
