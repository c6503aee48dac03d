"""GIS layers read back: by pyogrio, by GDAL's own programs, and what their shapes mean on the body."""

import json
import os
import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely
from networks import network, pair
from once import once
from sharing import shared

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.body import Ellipsoid, from_planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.network import PointClass, SharedKind

ODD = 'odd, "point" o\'the ☾, <ü>'
LAYERS = (
    "footprints_nominal", "footprints_adjusted", "tie_points", "laser_points", "control_points", "error_ellipses",
    "error_ellipses_exaggerated", "corrections", "corrections_exaggerated", "misregistration",
    "misregistration_exaggerated", "residuals", "residuals_exaggerated", "about",
)  # fmt: skip


class Read(NamedTuple):
    shapes: Any
    fields: dict[str, Any]


def layer(path: Path, name: str) -> Read:
    """A layer by pyogrio."""
    import pyogrio  # only who reads needs the extra

    head, _, shapes, fields = pyogrio.raw.read(path, layer=name)
    assert shapes is not None
    return Read(shapely.from_wkb(shapes), dict(zip(head["fields"], fields, strict=True)))


def tool(*words: object) -> str:
    """What one of GDAL's own programs says; the wheels' settings are none of its business."""
    clean = {key: value for key, value in os.environ.items() if not key.startswith(("GDAL", "PROJ"))}
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, check=True, env=clean)
    assert not done.stderr, done.stderr
    return done.stdout


def by_gdal(path: Path, name: str) -> list[dict[str, Any]]:
    """A layer's rows by ogr2ogr."""
    text = tool("ogr2ogr", "-f", "GeoJSON", "-lco", "COORDINATE_PRECISION=15", "/vsistdout/", path, name)
    rows: list[dict[str, Any]] = json.loads(text)["features"]
    return rows


def degrees(places: Array) -> Array:
    """Longitude and planetocentric latitude, spelt out."""
    x, y, z = places.T
    return np.degrees(np.column_stack([np.arctan2(y, x), np.arcsin(z / np.sqrt(x * x + y * y + z * z))]))


def level_axes(place: Array) -> Array:
    """(2, 3) unit vectors east and north, by differences."""
    east = np.cross([0.0, 0.0, 1.0], place)
    north = np.cross(place, east)
    return np.stack([east / np.linalg.norm(east), north / np.linalg.norm(north)])


def on_body(shape: Any, radius: float) -> Array:
    """Corners (k, 3) in m of a shape in degrees."""
    longitude, latitude = np.radians(shapely.get_coordinates(shape)).T
    return from_planetocentric(np.column_stack([longitude, latitude, np.full(longitude.size, radius)]))


def true_area(shape: Any, body: Ellipsoid) -> float:
    """m^2 of a shape in degrees, on the cylinder on which areas are those of the ellipsoid."""
    centric, height = _cylinder(body)

    def flat(at: Array) -> Array:
        return np.column_stack([np.radians(at[:, 0]), np.interp(np.radians(at[:, 1]), centric, height)])

    return float(shapely.area(shapely.transform(shape, flat)))


@cache
def _cylinder(body: Ellipsoid) -> tuple[Array, Array]:
    """Planetocentric latitudes and the cylinder's heights (m^2 per radian of longitude) there, integrated in steps."""
    latitude = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 200_001)  # geodetic
    a, b = body.equatorial, body.polar
    square = 1.0 - (b / a) ** 2
    strip = a * a * (1.0 - square) * np.cos(latitude) / (1.0 - square * np.sin(latitude) ** 2) ** 2
    height = np.concatenate([[0.0], np.cumsum(0.5 * (strip[1:] + strip[:-1]) * np.diff(latitude))])
    return np.arctan2((b / a) ** 2 * np.sin(latitude), np.cos(latitude)), height


@once
def odd_solution() -> Solution:
    """The pair with odd names, a tie of one ray, three laser points as control points, and an unknown focal length."""
    net = network(pair(40, 12))
    points, rays = net.points, net.rays
    classes = points.classes.copy()
    classes[-3:] = PointClass.CONTROL
    kept = np.delete(np.arange(rays.point.size), np.flatnonzero(rays.point == 1)[0])
    images = replace(net.images[0], name="SIM 'A', \"é\""), net.images[1]
    net = replace(
        net, images=images, points=replace(points, ids=(ODD, *points.ids[1:]), classes=classes), rays=rays.chosen(kept),
        shared=(shared(SharedKind.FOCAL_LENGTH, range(2)),),
    )  # fmt: skip
    found = adjust_network(net, SolverSettings(), "odd")
    return replace(found, rays_used=found.rays_used & (net.rays.point != 2))
