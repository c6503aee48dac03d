"""GIS layers in GDAL's hands: points, footprints, error ellipses and vectors in their places and by formulas, the
coordinate system; the file whole or not at all.
"""

import json
import sqlite3
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from gis_files import LAYERS, by_gdal, degrees, layer, level_axes, odd_solution, on_body, tool, true_area
from networks import network, pair
from outside import refuses
from scipy.stats import chi2

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.places import sigma_grid
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.statistics import adjusted_points, rejected_points
from mgsgraph.export.gis import exaggeration, write_gis
from mgsgraph.geometry.body import from_planetocentric, geodetic, intersect_ellipsoid
from mgsgraph.geometry.records import Array
from mgsgraph.network import PointClass
from mgsgraph.network.connectivity import network_footprints
from mgsgraph.simulation.orbit import MARS
from mgsgraph.simulation.pair import PairSettings, simulate_pair
from mgsgraph.units import DEG, KM

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


@pytest.mark.parametrize(("longitude", "latitude"), [(180.0, 4.0), (30.0, 89.99)])
def test_a_solution_on_the_date_line_and_on_the_pole(
    longitude: float, latitude: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mgsgraph.simulation.pair.CENTRE", (longitude * DEG, latitude * DEG))
    solved = adjust_network(network(simulate_pair(PairSettings(ties=10, shots=5))), SolverSettings())
    path = write_gis(solved, tmp_path)[0]
    found = layer(path, "footprints_adjusted")
    if latitude < 80.0:
        assert max(len(shapely.get_parts(shape)) for shape in found.shapes) == 2
    else:
        assert shapely.bounds(found.shapes)[:, 3].max() == 90.0
    for j, shape in enumerate(found.shapes):
        assert shapely.is_valid(shape)
        assert np.abs(shapely.bounds(shape)).max() <= 180.0
        assert true_area(shape, MARS) == pytest.approx(found.fields["area_km2"][j] * KM**2, rel=1e-3)
    points = layer(path, "tie_points")
    assert np.abs(shapely.get_coordinates(points.shapes) - degrees(solved.places[:10])).max() < 1e-9
    assert np.allclose(points.fields["lon_deg"], degrees(solved.places[:10])[:, 0] % 360.0, rtol=0.0, atol=1e-9)
    seen = shapely.contains(shapely.buffer(found.shapes[0], 1e-9), points.shapes)
    assert seen.all()
    for name in LAYERS[:-1]:
        assert shapely.is_valid(layer(path, name).shapes).all()


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


def test_the_same_solution_gives_the_same_bytes(solution: Solution, written: Path, tmp_path: Path) -> None:
    assert pyogrio.get_gdal_config_option("OGR_CURRENT_DATE") is None
    again = write_gis(solution, tmp_path)
    assert {path.relative_to(tmp_path) for path in again} == {
        path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file()
    }
    for path in again:
        assert path.read_bytes() == (written.parent / path.relative_to(tmp_path)).read_bytes(), path


# --- bad input


def test_without_the_extra_it_says_what_to_install(
    solution: Solution, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyogrio", None)
    refuses(r"pip install .mgsgraph\[gis\]", write_gis, solution, tmp_path)
    assert not list(tmp_path.iterdir())


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
    refuses("layer laser_points: can't be written", write_gis, solution, tmp_path)
    assert path.read_bytes() == before
    assert {one.name for one in tmp_path.iterdir()} == names
    assert pyogrio.get_gdal_config_option("OGR_CURRENT_DATE") is None


# --- footprints


def test_areas_and_edges_of_footprints(solution: Solution, written: Path) -> None:
    net = solution.network
    every = (("footprints_nominal", network_footprints(net, solution.places_before)),
             ("footprints_adjusted", network_footprints(
                 replace(net, images=(solution.image(0), solution.image(1))), solution.places, solution.correction
             )))  # fmt: skip
    for name, footprints in every:
        found = layer(written, name)
        for j, (shape, one) in enumerate(zip(found.shapes, footprints, strict=True)):
            assert shapely.is_valid(shape)
            assert found.fields["area_km2"][j] * KM**2 == pytest.approx(true_area(shape, MARS), rel=1e-5)
            corners = degrees(one.outline)
            gap = shapely.distance(shapely.points(corners), shapely.get_exterior_ring(shapely.get_parts(shape)[0]))
            assert gap.max() < 1e-9
            radius = float(np.linalg.norm(one.centre))
            edge = np.linalg.norm(np.diff(on_body(shape, radius), axis=0), axis=1).sum()
            assert edge == pytest.approx(np.linalg.norm(np.diff(one.outline, axis=0), axis=1).sum(), rel=1e-4)


def test_footprints_are_the_images_corners(solution: Solution, written: Path) -> None:
    image, height = solution.image(1), layer(written, "footprints_adjusted").fields["height_m"][1]
    ends = np.array([0.0, image.lines, image.lines, 0.0]), np.array([0.0, 0.0, image.samples, image.samples])
    corners, _ = image.image_to_ground(*ends, float(height), solution.correction(1))
    shapes = layer(written, "footprints_adjusted").shapes
    gap = shapely.distance(shapely.points(degrees(corners)), shapely.boundary(shapes[1]))
    assert gap.max() < 1e-8
    moved = layer(written, "footprints_nominal").shapes[1]
    assert not shapely.equals_exact(moved, shapes[1], 1e-4)


def test_figures_of_footprints(solution: Solution, written: Path) -> None:
    found = layer(written, "footprints_adjusted").fields
    for j, image in enumerate(solution.network.images):
        mine = (solution.network.rays.image == j) & solution.rays_used
        assert found["rays_used"][j] == mine.sum()
        assert found["rays"][j] == (solution.network.rays.image == j).sum()
        rms = np.sqrt(np.mean(solution.residuals[mine] ** 2, axis=0))
        assert [found[f"residual_rms_{way}_px"][j] for way in ("line", "sample")] == pytest.approx(rms.tolist())
        first, last = image.timing.at(np.array([0.0, float(image.lines)]))[0] + image.trajectory.epoch
        assert (found["first_line_et_s"][j], found["last_line_et_s"][j]) == (first, last)


# --- ellipses


def test_ellipses_are_those_of_the_covariance(solution: Solution, written: Path) -> None:
    found = layer(written, "error_ellipses")
    mine = np.flatnonzero(adjusted_points(solution))
    quantile = float(chi2.ppf(0.95, 2))
    assert found.fields["point"].tolist() == [solution.network.points.ids[i] for i in mine]
    for row, i in enumerate(mine.tolist()):
        place, axes = solution.places[i], level_axes(solution.places[i])
        covariance = axes @ solution.covariances[i] @ axes.T
        offsets = (on_body(found.shapes[row], float(np.linalg.norm(place))) - place) @ axes.T
        inside = np.einsum("ki,ij,kj->k", offsets, np.linalg.inv(covariance), offsets)
        assert np.allclose(inside, quantile, rtol=1e-4)
        minor, major = np.sqrt(quantile * np.linalg.eigvalsh(covariance))
        assert found.fields["semi_minor_m"][row] == pytest.approx(minor)
        assert found.fields["semi_major_m"][row] == pytest.approx(major)
        assert found.fields["scaled_semi_major_m"][row] == pytest.approx(major * solution.sigma0)
        azimuth = found.fields["azimuth_deg"][row] * DEG
        along = np.array([np.sin(azimuth), np.cos(azimuth)])
        assert along @ covariance @ along == pytest.approx(major**2 / quantile, rel=1e-9)


def test_exaggerated_shapes_are_so_many_times_as_large(solution: Solution, written: Path) -> None:
    for name in ("error_ellipses", "corrections", "misregistration", "residuals"):
        true, large = layer(written, name), layer(written, f"{name}_exaggerated")
        factor = float(large.fields["exaggeration"][0])
        assert set(true.fields["exaggeration"]) == {1.0}
        assert set(large.fields["exaggeration"]) == {factor}
        assert factor > 1.0
        for field, values in true.fields.items():
            assert field == "exaggeration" or np.array_equal(values, large.fields[field]), field
        extents = [shapely.bounds(one.shapes)[:, 2:] - shapely.bounds(one.shapes)[:, :2] for one in (true, large)]
        seen = extents[0] > 1e-7
        assert np.allclose(extents[1][seen], factor * extents[0][seen], rtol=2e-3)


def test_an_exaggeration_is_chosen_by_all_but_the_largest() -> None:
    assert exaggeration(np.array([1.0] * 80 + [50.0] * 20), 1e4) == 10.0  # a fifth of them are large: they count
    assert exaggeration(np.array([1.0] * 95 + [1e6] * 5), 1e4) == 500.0


# --- vectors


def ends_of(shapes: Any) -> tuple[Array, Array]:
    places = shapely.get_coordinates(shapes).reshape(len(shapes), 2, 2)
    return places[:, 0], places[:, 1]


def test_corrections_run_from_before_to_after(solution: Solution, written: Path) -> None:
    found = layer(written, "corrections")
    mine = [solution.network.points.ids.index(name) for name in found.fields["point"]]
    assert mine == np.flatnonzero(adjusted_points(solution)).tolist()
    start, end = ends_of(found.shapes)
    assert np.abs(start - degrees(solution.places_before[mine])).max() < 1e-9
    assert np.abs(end - degrees(solution.places[mine])).max() < 1e-9
    length = np.linalg.norm((solution.places - solution.places_before)[mine], axis=1)
    assert np.allclose(found.fields["length_m"], length)
    parts = np.column_stack([found.fields[f"{way}_m"] for way in ("east", "north", "up")])
    assert np.allclose(np.linalg.norm(parts, axis=1), length)
    assert set(found.fields["class"]) == {"tie", "laser", "control"}


def test_misregistration_is_where_the_nominal_orientation_shows_it(solution: Solution, written: Path) -> None:
    found, net = layer(written, "misregistration"), solution.network
    names = net.image_names
    laser = solution.members(PointClass.LASER)
    for j, image in enumerate(net.images):  # all that it sees, and nothing else
        seen, _ = solution.image(j).ground_to_image(solution.places[laser], solution.correction(j))
        inside = np.all((seen >= 0.0) & (seen <= [image.lines, image.samples]), axis=1)
        mine = found.fields["point"][found.fields["image"] == image.name].tolist()
        assert mine == [net.points.ids[i] for i in laser[inside]]
    assert len(found.shapes) > 6
    start, end = ends_of(found.shapes)
    for row, (point, image) in enumerate(zip(found.fields["point"], found.fields["image"], strict=True)):
        i, j = net.points.ids.index(point), names.index(image)
        assert np.abs(end[row] - degrees(solution.places[i : i + 1])[0]).max() < 1e-9
        place, _ = solution.image(j).ground_to_image(solution.places[i : i + 1], solution.correction(j))
        isis = found.fields["isis_line"][row], found.fields["isis_sample"][row]
        assert np.array(isis) == pytest.approx(place[0] + 0.5)
        known, _ = net.images[j].ground_to_image(solution.places_before[i : i + 1])
        moved = found.fields["moved_line_px"][row], found.fields["moved_sample_px"][row]
        assert np.array(moved) == pytest.approx((place - known)[0])
        height = geodetic(solution.places[i], MARS)[2]
        ground = from_planetocentric(np.append(np.radians(start[row]), 1.0))
        radii = np.array([MARS.equatorial, MARS.equatorial, MARS.polar]) + height
        ground /= np.linalg.norm(ground / radii)
        again, _ = net.images[j].ground_to_image(ground[None])
        assert np.abs(again - place).max() < 1e-3


def test_residuals_end_where_the_measures_are(solution: Solution, written: Path) -> None:
    found, net = layer(written, "residuals"), solution.network
    kept = np.flatnonzero(solution.determined[net.rays.point])
    assert len(found.shapes) == kept.size
    assert found.fields["used"].tolist() == solution.rays_used[kept].tolist()
    assert not found.fields["used"].all()
    assert np.allclose(found.fields["residual_line_px"], solution.residuals[kept, 0])
    assert np.allclose(found.fields["normalised_sample"], (solution.residuals / net.rays.sigmas)[kept, 1])
    start, end = ends_of(found.shapes)
    assert np.abs(start - degrees(solution.places[net.rays.point[kept]])).max() < 1e-9
    heights = geodetic(solution.places, MARS)[:, 2]
    for j in range(2):
        mine = np.flatnonzero(net.rays.image[kept] == j)
        rays = kept[mine]
        (line, sample), height = net.rays.places[rays].T, heights[net.rays.point[rays]]
        ground, _ = solution.image(j).image_to_ground(line, sample, height, solution.correction(j))
        assert np.abs(end[mine] - degrees(ground)).max() < 2e-7  # 1 cm: residuals are linearised
