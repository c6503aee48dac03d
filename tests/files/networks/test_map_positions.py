"""Ground control read from maps: positions against closed formulas, covariances against differences."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from outside import refuses
from rasters import FLAT, PROJECTIONS, RADIUS, SPHERE, ground, pixels, raster

import mgsgraph
from mgsgraph.analysis.statistics import local_sigmas
from mgsgraph.files.networks.map_positions import ControlMap
from mgsgraph.files.networks.table import read_tie_points
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.geometry.body import east_north_up, from_planetocentric, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.network import PointClass
from mgsgraph.simulation.orbit import MARS
from mgsgraph.units import DEG

PIXEL, SIGMA_PX, SIGMA_UP = 50.0, 0.8, 7.0
SHAPE = (300, 400)
TMERC, PIXELS = "transverse Mercator", "map_line,map_sample"


def radii(points: Array) -> Array:
    """m, of the hills, everywhere."""
    longitudes, latitudes, _ = planetocentric(points).T
    return np.asarray(RADIUS + ground(longitudes, latitudes))


def orthoimage(folder: Path, crs: str, turned: float = 0.0) -> Path:
    return raster(folder / "ortho.tif", np.zeros(SHAPE, np.uint8), crs, pixels(crs, turned, SHAPE, PIXEL)[0])


def control_map(path: Path, surface: Callable[[Array], Array] = radii) -> ControlMap:
    return ControlMap(path, surface, SIGMA_UP, SIGMA_PX, 0.0, MARS)


def read(of: ControlMap, names: str, positions: Array) -> TiePoints:
    """Points at positions (n, 2), each measured in one image."""
    rows = [f"P{k},SIM/A,10.5,20.5,{a!r},{b!r}".replace("nan", "") for k, (a, b) in enumerate(positions.tolist())]
    path = of.orthoimage.with_name("points.csv")
    path.write_text("\n".join([f"id,image,line,sample,{names}", *rows, ""]), encoding="utf-8")
    return read_tie_points(path, MARS, of.ground_columns)


def positions(count: int) -> Array:
    """(n, 2) line and sample in the orthoimage."""
    return np.random.default_rng(1).uniform([5.0, 5.0], np.array(SHAPE) - 5.0, (count, 2))


@pytest.mark.parametrize("name", ["equirectangular", "sinusoidal", "transverse Mercator"])
def test_coordinates_are_those_of_the_projection_and_the_terrain(name: str, tmp_path: Path) -> None:
    crs, inverse = PROJECTIONS[name]
    of, at = control_map(orthoimage(tmp_path, crs, 12.0)), positions(9)
    a, b, c, d, e, f = pixels(crs, 12.0, SHAPE, PIXEL)[0][:6]
    x, y = a * at[:, 1] + b * at[:, 0] + c, d * at[:, 1] + e * at[:, 0] + f
    longitudes, latitudes = inverse(x, y)
    expected = from_planetocentric(np.column_stack([longitudes, latitudes, RADIUS + ground(longitudes, latitudes)]))
    plane, degrees = np.column_stack([x, y]), np.column_stack([longitudes, latitudes]) / DEG
    for names, values in ((PIXELS, at), ("map_x,map_y", plane), ("longitude_deg,latitude_deg", degrees)):
        found = read(of, names, values)
        np.testing.assert_allclose(found.places, expected, atol=1e-3)


@pytest.mark.parametrize("body", [SPHERE, FLAT])
def test_covariances_follow_the_slope(body: str, tmp_path: Path) -> None:
    """Against differences of positions read a pixel aside, on a sphere and on an ellipsoid."""
    of, at = control_map(orthoimage(tmp_path, f"+proj=tmerc +lon_0=86 {body}", 30.0)), positions(5)
    found = read(of, PIXELS, at)
    moved = [read(of, PIXELS, at + step).places - read(of, PIXELS, at - step).places for step in 0.5 * np.eye(2)]
    up = east_north_up(found.places)[:, 2]
    root = np.stack([SIGMA_PX * moved[0], SIGMA_PX * moved[1], SIGMA_UP * up], axis=2)
    np.testing.assert_allclose(found.covariances, root @ root.mT, rtol=1e-3, atol=0.5)


@pytest.mark.parametrize(("names", "position", "message"), [
    (PIXELS, (301.0, 10.0), "line 2, point P0: a position beyond the orthoimage; expected one in"),
    (PIXELS, (10.0, np.nan), "line 2, point P0: half a position; expected both map_line and map_sample"),
    (PIXELS, (np.nan, np.nan), "line 1: no position in the orthoimage in any row; expected map_line and map_sample"),
    (PIXELS, (10.0, 10.0), "line 2, point P0: no height of the terrain model; expected a position over"),
    ("map_line,map_x", (10.0, 10.0), "line 1: columns map_line, map_x; expected map_line and map_sample"),
    ("sigma_line_px,ignore", (1.0, 0.0), "line 1: no columns of positions in the orthoimage; expected map_line"),
])  # fmt: skip
def test_what_gives_no_ground_is_refused(names: str, position: Any, message: str, tmp_path: Path) -> None:
    of = control_map(orthoimage(tmp_path, PROJECTIONS[TMERC][0]), surface=lambda points: np.nan * points[:, 0])
    refuses(re.escape(message), read, of, names, np.array([position]))


def test_a_case_takes_them_as_constrained_control(case_file: Path) -> None:
    crs, inverse = PROJECTIONS[TMERC]
    orthoimage(case_file.parent, crs)
    transform, x, y = pixels(crs, 0.0, SHAPE, 2.0 * PIXEL)
    raster(case_file.with_name("dtm.tif"), ground(*inverse(x, y)).reshape(SHAPE).astype(np.float32), crs, transform)
    rows = ["ID,image,line,sample,Longitude_deg,latitude_deg", "G1,SIM/A,1000.5,300.5,87,4.1", "G1,SIM/B,999.5,301.5,,"]
    case_file.with_name("map.csv").write_text("\n".join(rows), encoding="utf-8")
    terrain = f'{{ radius = "dtm.tif", reference_radius_m = {RADIUS}, vertical_sigma_m = 7.0 }}'
    table = f'\n[ground_control]\nfile = "map.csv"\northoimage = "ortho.tif"\nmap_sigma_m = 20.0\nterrain = {terrain}\n'
    case_file.write_text(case_file.read_text(encoding="utf-8") + table, encoding="utf-8")
    table = case_file.with_name("map.csv")
    table.write_text("\n".join([*rows, "G1,SIM/A,1000.5,300.5,87,4.2"]), encoding="utf-8")
    refuses("4, point G1: longitude_deg and latitude_deg other than in an earlier", mgsgraph.read_case, case_file)
    table.write_text("\n".join([*rows, "F1,SIM/A,1500.5,300.5,,", "F1,SIM/B,1499.5,301.5,,"]), encoding="utf-8")
    case = mgsgraph.read_case(case_file)
    assert [note for note in case.notes if "1 point without a position" in note]
    net = case.network
    control, free = np.flatnonzero(net.points.classes == PointClass.CONTROL)
    assert net.points.kinds[free] == PointKind.FREE
    assert (net.points.kinds[control], net.ray_counts[control]) == (PointKind.CONSTRAINED, 2)
    at = np.array([87.0, 4.1]) * DEG
    expected = from_planetocentric(np.array([[*at, RADIUS + float(ground(*at))]]))[0]
    np.testing.assert_allclose(net.points.places[control], expected, atol=0.2)  # bilinear between posts
    sigmas = local_sigmas(net.points.covariances[[control]], expected[None])[0]
    np.testing.assert_allclose(sigmas, [32.0, 32.0, 7.0], rtol=0.03)
