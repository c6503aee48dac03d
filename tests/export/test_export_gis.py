"""GIS layers in GDAL's hands: points in their places, the coordinate system, names; the file whole or not at all."""

import json
import sqlite3
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from gis_files import LAYERS, ODD, by_gdal, degrees, layer, level_axes, odd_solution, tool
from networks import network, pair

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.places import sigma_grid
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.statistics import rejected_points
from mgsgraph.errors import InputError
from mgsgraph.export.gis import write_gis
from mgsgraph.geometry.body import Ellipsoid, geodetic, intersect_ellipsoid
from mgsgraph.network import PointClass
from mgsgraph.simulation.orbit import MARS
from mgsgraph.units import DEG

pyogrio = pytest.importorskip("pyogrio", reason="the extra [gis] is not installed")
gdal = pytest.mark.program("ogr2ogr")


@pytest.fixture(scope="module")
def solution() -> Solution:
    return odd_solution()


@pytest.fixture(scope="module")
def written(solution: Solution, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_gis(solution, tmp_path_factory.mktemp("gis"))[0]


# --- points


def test_points_lie_where_they_are(solution: Solution, written: Path) -> None:
    for point_class in solution.network.classes:
        mine = np.flatnonzero(solution.network.points.classes == point_class)
        found = layer(written, f"{point_class.name.lower()}_points")
        assert found.fields["id"].tolist() == [solution.network.points.ids[i] for i in mine]
        there = solution.determined[mine]
        assert np.array_equal(~shapely.is_missing(found.shapes), there)
        places = solution.places[mine[there]]
        off = shapely.get_coordinates(found.shapes[there]) - degrees(places)
        assert np.abs(off).max() < 1e-9
        columns = {name: values[there] for name, values in found.fields.items()}
        assert np.allclose(columns["lon_deg"], degrees(places)[:, 0] % 360.0, rtol=0.0, atol=1e-9)
        heights = geodetic(places, MARS)[:, 2]
        assert np.allclose(columns["height_m"], heights, rtol=0.0, atol=1e-6)
        back, _, _ = intersect_ellipsoid(places * 2.0, -places, MARS)  # the height, roughly, without geodetic()
        rise = np.linalg.norm(places, axis=1) - np.linalg.norm(back, axis=1)
        assert np.allclose(columns["height_m"], rise, atol=0.01)


def test_sigmas_and_corrections_of_points(solution: Solution, written: Path) -> None:
    found, mine = layer(written, "control_points").fields, np.flatnonzero(solution.network.points.classes == 2)
    assert mine.size == 3
    for row, i in enumerate(mine.tolist()):
        axes = np.vstack([level_axes(solution.places[i]), solution.places[i] / np.linalg.norm(solution.places[i])])
        sigmas = np.sqrt(np.diag(axes @ solution.covariances[i] @ axes.T))
        moved = axes @ (solution.places[i] - solution.places_before[i])
        for k, way in enumerate(("east", "north", "up")):
            assert found[f"sigma_{way}_m"][row] == pytest.approx(sigmas[k], rel=1e-6)
            assert found[f"scaled_sigma_{way}_m"][row] == pytest.approx(sigmas[k] * solution.sigma0, rel=1e-6)
            assert found[f"correction_{way}_m"][row] == pytest.approx(moved[k], rel=1e-6, abs=1e-7)


def test_rays_and_residuals_of_points(solution: Solution, written: Path) -> None:
    found, net = layer(written, "tie_points").fields, solution.network
    assert found["rays"].tolist() == [2, 1] + [2] * 38
    assert found["rays_used"].tolist() == [2, 0, 0] + [2] * 37
    assert found["rejected"].tolist() == [False, True, True] + [False] * 37
    assert rejected_points(solution)[:3].tolist() == [False, True, True]
    assert np.isnan(found["residual_rms_line_px"][1:3]).all()
    mine = np.flatnonzero(net.rays.point == 5)
    rms = np.sqrt(np.mean(solution.residuals[mine] ** 2, axis=0))
    assert [found[f"residual_rms_{way}_px"][5] for way in ("line", "sample")] == pytest.approx(rms.tolist())
    laser = layer(written, "laser_points").fields
    first = int(np.flatnonzero(net.points.classes == PointClass.LASER)[0])
    residual = abs(solution.range_residuals[net.ranges.point == first][0])
    assert laser["residual_rms_range_m"][0] == pytest.approx(residual)


def test_what_nothing_determines_has_no_place(solution: Solution, written: Path) -> None:
    found = layer(written, "tie_points")
    assert not solution.determined[1]
    assert found.shapes[1] is None
    assert all(np.isnan(found.fields[name][1]) for name in ("lon_deg", "height_m", "sigma_up_m", "correction_east_m"))
    name = solution.network.points.ids[1]
    for other in ("error_ellipses", "corrections", "residuals"):
        assert name not in layer(written, other).fields["point"].tolist()


# --- GDAL's own tools


@gdal
def test_gdal_opens_it_and_finds_everything(solution: Solution, written: Path) -> None:
    said = tool("ogrinfo", "-ro", written)
    assert [line.split(": ")[1].split(" (")[0] for line in said.splitlines() if line[:1].isdigit()] == list(LAYERS)
    rows = by_gdal(written, "tie_points")
    assert rows[0]["properties"]["id"] == ODD
    assert rows[1]["geometry"] is None
    assert rows[1]["properties"]["lat_deg"] is None
    there = np.flatnonzero(solution.determined[:40])
    found = np.array([rows[i]["geometry"]["coordinates"] for i in there])
    assert np.abs(found - degrees(solution.places[there])).max() < 1e-9
    images = [row["properties"]["image"] for row in by_gdal(written, "footprints_adjusted")]
    assert images == [image.name for image in solution.network.images]


@gdal
def test_gdal_and_the_package_know_the_coordinate_system(written: Path) -> None:
    said = tool("ogrinfo", "-ro", "-so", written, "tie_points")
    assert "Mars (2015) - Sphere / Ocentric" in said
    assert 'ID["IAU",49900]' in said
    with sqlite3.connect(written) as base:
        used = base.execute(
            "select distinct organization, organization_coordsys_id from gpkg_contents join gpkg_spatial_ref_sys "
            "using (srs_id) where data_type = 'features'"
        )
        assert used.fetchall() == [("IAU_2015", 49900)]
    base.close()
    # the same number in the sphere's system and at the centre of the body: a place turned into x, y, z and back
    text = tool("ogr2ogr", "-f", "CSV", "-lco", "GEOMETRY=AS_XYZ", "-t_srs", "+proj=geocent +R=3396190", "-dim", "3",
                "/vsistdout/", written, "control_points")  # fmt: skip
    place = np.array([float(word) for word in text.splitlines()[1].split(",")[:3]])
    row = by_gdal(written, "control_points")[0]["properties"]
    assert np.allclose(degrees(place[None])[0] % 360.0, [row["lon_deg"], row["lat_deg"]], rtol=0.0, atol=1e-9)


def test_the_moon_and_bodies_without_a_code(solution: Solution, tmp_path: Path) -> None:
    for radius, code in ((1737400.0, "IAU_2015"), (3390000.0, "NONE")):
        body = Ellipsoid(radius, radius)
        images = tuple(replace(image, body=body) for image in solution.network.images)
        path = write_gis(replace(solution, network=replace(solution.network, images=images)), tmp_path)[0]
        with sqlite3.connect(path) as base:
            rows = base.execute("select organization, definition from gpkg_spatial_ref_sys join gpkg_contents using "
                                "(srs_id) where table_name = 'tie_points'").fetchall()  # fmt: skip
        base.close()
        assert rows[0][0] == code
        assert f"{radius:.0f}" in rows[0][1]


@gdal
def test_the_sigma_raster_goes_along(solution: Solution, tmp_path: Path) -> None:
    grid = sigma_grid(Posterior.of(solution), cell=200.0)
    files = write_gis(solution, tmp_path, grid)
    assert (files[0].name, files[-1].name) == ("solution.gpkg", "sigmas.tif")
    found = json.loads(tool("gdalinfo", "-json", files[-1]))
    west, north = found["cornerCoordinates"]["upperLeft"]
    assert (west, north) == pytest.approx((grid.west / DEG, grid.north / DEG), abs=1e-7)
    assert "Mars (2015) - Sphere / Ocentric" in found["coordinateSystem"]["wkt"]
    row, column = (int(one) for one in np.argwhere(np.isfinite(grid.values[0]))[0])
    at = (grid.west + (column + 0.5) * grid.steps[0]) / DEG, (grid.north - (row + 0.5) * grid.steps[1]) / DEG
    values = tool("gdallocationinfo", "-valonly", "-geoloc", files[-1], *at).split()
    assert np.allclose([float(one) for one in values], grid.values[:, row, column], rtol=1e-6)


# --- the file


def test_what_is_not_there_leaves_an_empty_layer(tmp_path: Path) -> None:
    solved = adjust_network(network(pair(), laser=False), SolverSettings())
    path = write_gis(solved, tmp_path)[0]
    assert pyogrio.list_layers(path)[:, 0].tolist() == list(LAYERS)
    for name in ("laser_points", "control_points", "misregistration", "misregistration_exaggerated"):
        head, _, shapes, fields = pyogrio.raw.read(path, layer=name)
        assert len(shapes) == 0
        assert len(fields) == len(head["fields"]) > 10
        assert head["geometry_type"] in ("Point", "MultiLineString")


def test_it_says_where_it_came_from(solution: Solution, written: Path) -> None:
    _, _, shapes, (subjects, statements) = pyogrio.raw.read(written, layer="about")
    said = dict(zip(subjects, statements, strict=True))
    assert shapes is None
    assert solution.versions["mgsgraph"] in said["program"]
    assert said["solution"].startswith("odd: converged")
    assert "IAU_2015:49900" in said["coordinates"]
    factor = layer(written, "residuals_exaggerated").fields["exaggeration"][0]
    assert f"exaggerated {factor:g} times" in said["layer residuals_exaggerated"]
    assert {one.removeprefix("layer ") for one in said if one.startswith("layer ")} == set(LAYERS[:-1])


def test_the_same_solution_gives_the_same_bytes(solution: Solution, written: Path, tmp_path: Path) -> None:
    assert pyogrio.get_gdal_config_option("OGR_CURRENT_DATE") is None
    again = write_gis(solution, tmp_path)
    assert {path.relative_to(tmp_path) for path in again} == {
        path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file()
    }
    for path in again:
        assert path.read_bytes() == (written.parent / path.relative_to(tmp_path)).read_bytes(), path


def test_columns_say_their_units(written: Path) -> None:
    plain = {"rays", "rays_used", "lines", "samples", "rejected", "used", "held", "whole", "exaggeration",
             "normalised_line", "normalised_sample", "isis_line", "isis_sample"}  # fmt: skip
    for name in LAYERS[:-1]:
        for field, values in layer(written, name).fields.items():
            assert values.dtype == object or field in plain or field.endswith(("_m", "_px", "_deg", "_km2", "_s"))


# --- bad input


def test_without_the_extra_it_says_what_to_install(
    solution: Solution, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyogrio", None)
    with pytest.raises(InputError, match=r"pip install .mgsgraph\[gis\]"):
        write_gis(solution, tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_place_that_can_not_be_written(solution: Solution, tmp_path: Path) -> None:
    (tmp_path / "solution.gpkg").mkdir()
    with pytest.raises(InputError, match="can't be written"):
        write_gis(solution, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["solution.gpkg"]


def test_a_failure_leaves_the_earlier_file(
    solution: Solution, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_gis(solution, tmp_path)[0]
    before, names = path.read_bytes(), {one.name for one in tmp_path.iterdir()}
    write, calls = pyogrio.raw.write, list[int]()

    def failing(*args: Any, **settings: Any) -> None:
        calls.append(1)
        if len(calls) == 4:
            raise pyogrio.errors.DataSourceError("disk full")
        write(*args, **settings)

    monkeypatch.setattr(pyogrio.raw, "write", failing)
    with pytest.raises(InputError, match="layer laser_points: can't be written"):
        write_gis(solution, tmp_path)
    assert path.read_bytes() == before
    assert {one.name for one in tmp_path.iterdir()} == names
    assert pyogrio.get_gdal_config_option("OGR_CURRENT_DATE") is None
