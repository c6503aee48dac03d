"""Ground control read from maps: positions against closed formulas, covariances against differences and draws."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rasters import FLAT, PROJECTIONS, RADIUS, SPHERE, ground, pixels, raster
from scipy.special import chdtri

import mgsgraph
from mgsgraph.errors import InputError
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


def radii(points: Array) -> Array:
    """m, of the hills, everywhere."""
    longitudes, latitudes, _ = planetocentric(points).T
    return np.asarray(RADIUS + ground(longitudes, latitudes))


def orthoimage(folder: Path, crs: str, turned: float = 0.0) -> Path:
    return raster(folder / "ortho.tif", np.zeros(SHAPE, np.uint8), crs, pixels(crs, turned, SHAPE, PIXEL)[0])


def control_map(path: Path, own_sigma: float = 0.0, surface: Callable[[Array], Array] = radii) -> ControlMap:
    return ControlMap(path, surface, SIGMA_UP, SIGMA_PX, own_sigma, MARS)


def read(of: ControlMap, names: str, positions: Array) -> TiePoints:
    """Points at positions (n, 2), each measured in one image."""
    rows = [f"P{k},SIM/A,10.5,20.5,{first!r},{second!r}" for k, (first, second) in enumerate(positions.tolist())]
    path = of.orthoimage.with_name("points.csv")
    path.write_text("\n".join([f"id,image,line,sample,{names}", *rows, ""]), encoding="utf-8")
    return read_tie_points(path, MARS, of.ground_columns)


def positions(count: int, seed: int = 1) -> Array:
    """(n, 2) line and sample in the orthoimage."""
    return np.random.default_rng(seed).uniform([5.0, 5.0], np.array(SHAPE) - 5.0, (count, 2))


@pytest.mark.parametrize("name", ["equirectangular", "sinusoidal", "transverse Mercator"])
def test_coordinates_are_those_of_the_projection_and_the_terrain(name: str, tmp_path: Path) -> None:
    crs, inverse = PROJECTIONS[name]
    of, at = control_map(orthoimage(tmp_path, crs, 12.0)), positions(9)
    a, b, c, d, e, f = pixels(crs, 12.0, SHAPE, PIXEL)[0][:6]
    (lines, samples) = at.T
    x, y = a * samples + b * lines + c, d * samples + e * lines + f
    longitudes, latitudes = inverse(x, y)
    expected = from_planetocentric(np.column_stack([longitudes, latitudes, RADIUS + ground(longitudes, latitudes)]))
    degrees = np.column_stack([longitudes, latitudes]) / DEG
    for names, values in (("map_line,map_sample", at), ("map_x,map_y", np.column_stack([x, y])),
                          ("longitude_deg,latitude_deg", degrees)):  # fmt: skip
        found = read(of, names, values)
        np.testing.assert_allclose(found.places, expected, atol=1e-3)
        assert np.all(found.kinds == PointKind.CONSTRAINED)


@pytest.mark.parametrize("body", [SPHERE, FLAT])
def test_covariances_follow_the_slope(body: str, tmp_path: Path) -> None:
    """Against differences of positions read a pixel aside, on a sphere and on an ellipsoid."""
    of, at = control_map(orthoimage(tmp_path, f"+proj=tmerc +lon_0=86 {body}", 30.0)), positions(5)
    found = read(of, "map_line,map_sample", at)
    moved = [
        read(of, "map_line,map_sample", at + step).places - read(of, "map_line,map_sample", at - step).places
        for step in (np.array([0.5, 0.0]), np.array([0.0, 0.5]))
    ]
    up = east_north_up(found.places)[:, 2]
    expected = SIGMA_UP**2 * up[:, :, None] * up[:, None]
    expected += SIGMA_PX**2 * sum(one[:, :, None] * one[:, None] for one in moved)
    np.testing.assert_allclose(found.covariances, expected, rtol=1e-3, atol=0.5)
    wider = read(control_map(of.orthoimage, 20.0), "map_line,map_sample", at).covariances - found.covariances
    frames = east_north_up(found.places)
    np.testing.assert_allclose(np.einsum("nai,nij,naj->na", frames, wider, frames)[:, :2], 400.0, rtol=1e-3)


def test_errors_of_draws_have_the_stated_sigmas(tmp_path: Path) -> None:
    """100 draws of 20 points read with an error, over heights with one."""
    of, at = control_map(orthoimage(tmp_path, f"+proj=eqc +lon_0=87 {SPHERE}")), positions(20)
    rng = np.random.default_rng(3)
    truth, total = read(of, "map_line,map_sample", at).places, 0.0
    for _ in range(100):
        found = read(of, "map_line,map_sample", at + SIGMA_PX * rng.standard_normal(at.shape))
        errors = found.places - truth + east_north_up(truth)[:, 2] * SIGMA_UP * rng.standard_normal((20, 1))
        total += float(np.einsum("ni,nij,nj->", errors, np.linalg.inv(found.covariances), errors))
    assert chdtri(6000, 0.9995) < total < chdtri(6000, 0.0005)


def test_positions_without_terrain_are_refused(tmp_path: Path) -> None:
    """Where a point lies beside its posts, or nearer to their edge than its sigma."""
    edge = 0.5 * (SHAPE[0] - 1.0)
    of = control_map(orthoimage(tmp_path, f"+proj=eqc +lon_0=87 {SPHERE}"))
    middle = planetocentric(read(of, "map_line,map_sample", np.array([[edge, 200.0]])).places[0])[1]

    def northern(points: Array) -> Array:
        return np.where(planetocentric(points)[:, 1] > middle, radii(points), np.nan)

    cut = control_map(of.orthoimage, surface=northern)
    assert len(read(cut, "map_line,map_sample", np.array([[edge - 2.0, 200.0]])).ids) == 1
    for line in (edge - 0.1, edge + 10.0):
        with pytest.raises(InputError, match=r"points.csv, line 2, point P0: no height of the terrain model; expected"):
            read(cut, "map_line,map_sample", np.array([[line, 200.0]]))


# --- by a case


@pytest.fixture
def mapped_case(case_file: Path) -> Path:
    """The pair's case with two ground control points, each seen by both images where the ties say."""
    crs = PROJECTIONS["transverse Mercator"][0]
    case = mgsgraph.read_case(case_file)
    orthoimage(case_file.parent, crs)
    shape = (300, 400)
    transform, x, y = pixels(crs, 0.0, shape, 100.0)
    heights = ground(*PROJECTIONS["transverse Mercator"][1](x, y)).reshape(shape).astype(np.float32)
    raster(case_file.with_name("dtm.tif"), heights, crs, transform)
    lines = ["ID,image,line,sample,Longitude_deg,latitude_deg"]
    for k, degrees in ((0, "87.0,4.1"), (1, "")):
        lines += [f"G1,{case.network.images[k].name},{1000.5 + k},{300.5 + k},{degrees or ','}"]
    case_file.with_name("map.csv").write_text("\n".join(lines), encoding="utf-8")
    table = f"""
[ground_control]
file = "map.csv"
orthoimage = "ortho.tif"
terrain = {{ radius = "dtm.tif", reference_radius_m = {RADIUS}, vertical_sigma_m = 7.0 }}
"""
    case_file.write_text(case_file.read_text(encoding="utf-8") + table, encoding="utf-8")
    return case_file


def test_a_case_takes_them_as_constrained_control(mapped_case: Path) -> None:
    net = mgsgraph.read_case(mapped_case).network
    (control,) = np.flatnonzero(net.points.classes == PointClass.CONTROL)
    assert net.points.ids[control] == "G1"
    assert net.ray_counts[control] == 2
    at = np.array([87.0, 4.1]) * DEG
    expected = from_planetocentric(np.array([[*at, RADIUS + float(ground(*at))]]))[0]
    np.testing.assert_allclose(net.points.places[control], expected, atol=0.2)  # bilinear between posts
    frame = east_north_up(expected[None])[0]
    sigmas = np.sqrt(np.diagonal(frame @ net.points.covariances[control] @ frame.T))
    np.testing.assert_allclose(sigmas, [25.0, 25.0, 7.0], rtol=0.03)


@pytest.mark.parametrize(("old", "new", "message"), [
    ("87.0,4.1", "87.0,4.5", r"map.csv, line 2, point G1: a position beyond the orthoimage; expected one in its 300"),
    ("87.0,4.1", "87.0,", r"map.csv, line 2, point G1: half a position; expected both longitude_deg and"),
    ("Longitude_deg,latitude_deg", "map_line,latitude_deg", r"map.csv, line 1: columns .*; expected map_line and"),
    ("Longitude_deg,latitude_deg", "type,ignore", r"map.csv, line 1: no columns of positions in the orthoimage"),
    ("line,sample", "type,sample", r"map.csv, line 1: the column 'type'; expected positions in the orthoimage alone"),
    ('orthoimage = "ortho.tif"', "", r"case.toml, ground_control: file, terrain, .*; expected a .gcp file alone"),
    ('radius = "dtm.tif"', 'radius = "none.tif"', r"none.tif: no such file"),
])  # fmt: skip
def test_what_cannot_be_read_is_refused(mapped_case: Path, old: str, new: str, message: str) -> None:
    for path in (mapped_case, mapped_case.with_name("map.csv")):
        path.write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        mgsgraph.read_case(mapped_case)
