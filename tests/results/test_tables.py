"""Tables, records and rasters: every figure is recomputed here from the solution, and reads back bit for bit."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv
import pytest
import rasterio
import shapely
from commands import rows_of
from full_disk import files_of_at_most
from networks import network, pair, with_shift_and_surface
from outside import refuses
from pyarrow import parquet
from rasterio.crs import CRS
from stereo_pair import stereo_network

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.analysis.places import BANDS, SigmaGrid
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.statistics import local_sigmas, point_statistics, worst_first
from mgsgraph.case.reading import Case
from mgsgraph.errors import InputError
from mgsgraph.files.rasters.raster_file import geographic_crs
from mgsgraph.geometry.body import Ellipsoid, from_planetocentric
from mgsgraph.network import PointClass
from mgsgraph.results import tables as large_tables
from mgsgraph.results.answers import Questions, replies, write_sigma_raster
from mgsgraph.results.ground import control_section, surface_heights
from mgsgraph.results.inventory import outlying_ranges
from mgsgraph.results.results import solution_json, statements, write_results
from mgsgraph.results.tables import form_of, orientation_table, points_table, residuals_table
from mgsgraph.units import ARCSEC, DEG

XYZ = ("x", "y", "z")


def rows(write: Any, solution: Solution, folder: Path) -> list[dict[str, str]]:
    write(solution).write_csv(folder / "table.csv")
    return rows_of(folder / "table.csv")


def column(table: list[dict[str, str]], name: str) -> np.ndarray:
    return np.array([float(row[name] or "nan") for row in table])


# --- solution.json


def test_json_is_strict_and_has_the_agreed_keys(solution: Solution, lossy: Solution) -> None:
    for one in (solution, lossy):
        record = solution_json(one)
        assert json.loads(json.dumps(record, allow_nan=False)) == record  # nothing but JSON's own types
        assert set(record) >= {
            "status", "message", "iterations", "cost_initial", "cost_final", "sigma0", "degrees_of_freedom",
            "observations", "unknowns", "images", "points", "undetermined", "ranges", "laser_effect", "sigmas",
            "settings", "seconds", "versions", "statements",
        }  # fmt: skip
        assert record["statements"] == statements(one)


def test_what_is_no_number_is_null(solution: Solution) -> None:
    bare = replace(solution, fit=replace(solution.fit, observations=5, unknowns=5), cost_initial=math.inf)
    record = solution_json(bare)
    assert (record["sigma0"], record["degrees_of_freedom"], record["cost_initial"]) == (None, 0, None)
    assert record["sigmas"]["scaled_by_sigma0"]["mean_sigma_m"]["tie"] == [None] * 3
    assert record["points"]["control"]["mean_sigma_m"] == [None] * 3
    json.dumps(record, allow_nan=False)


def test_residuals_by_image_and_class(solution: Solution) -> None:
    """Without rejected rays, by NumPy."""
    spoilt, used, network = solution.residuals.copy(), np.ones(len(solution.residuals), dtype=bool), solution.network
    spoilt[[0, 5]], used[[0, 5]] = 1e6, False
    one = replace(solution, residuals=spoilt, rays_used=used)
    for j, image in enumerate(solution_json(one)["images"]):
        mine = used & (network.rays.image == j)
        rms = np.sqrt(np.mean(spoilt[mine] ** 2, axis=0))
        assert (image["residual_rms_line_px"], image["residual_rms_sample_px"]) == pytest.approx(rms.tolist())
        assert image["rays_used"] == mine.sum()
        for point_class in (PointClass.TIE, PointClass.LASER):
            rays = spoilt[mine & (network.points.classes[network.rays.point] == point_class)]
            part = image[point_class.name.lower()]
            assert part["count"] == len(rays)
            want = [*rays.mean(axis=0), *np.sqrt(np.mean(rays**2, axis=0))]
            names = ("mean_line_px", "mean_sample_px", "rms_line_px", "rms_sample_px")
            assert [part[name] for name in names] == pytest.approx(want)
        worse = replace(solution, residuals=solution.residuals * np.where(mine, 50.0, 1.0)[:, None])
        assert worst_first(worse)[0] == j


def test_orientation_over_the_31_places(solution: Solution) -> None:
    for j, image in enumerate(solution_json(solution)["images"]):
        profile, found = orientation_profile(solution, j, 31), image["orientation"]
        assert found["places"] == 31
        for c, name in enumerate(("X_m", "Y_m", "Z_m")):
            moved = (profile.position_after - profile.position_before)[:, c]
            want = [moved.mean(), np.sqrt(np.mean(moved**2)), profile.position_sigma[:, c].mean()]
            assert [found[name][key] for key in ("mean", "rms", "sigma_mean")] == pytest.approx(want)
        for c, name in enumerate(("omega_arcsec", "phi_arcsec", "kappa_arcsec")):
            want = [profile.angle_differences[:, c].mean() / ARCSEC, profile.angles_sigma[:, c].mean() / ARCSEC]
            assert [found[name]["mean"], found[name]["sigma_mean"]] == pytest.approx(want)
        for c, name in enumerate(("rotation_x_arcsec", "rotation_y_arcsec", "rotation_z_arcsec")):
            assert found[name]["rms"] == pytest.approx(np.sqrt(np.mean(profile.rotation[:, c] ** 2)) / ARCSEC)


def test_points_by_class(solution: Solution, lossy: Solution) -> None:
    record, mine = solution_json(solution), solution.network.points.classes == PointClass.LASER
    moved = (solution.places - solution.places_before)[mine]
    laser = record["points"]["laser"]
    assert (laser["count"], laser["rejected"], record["undetermined"]) == (12, 0, [])
    assert laser["mean_correction_m"] == pytest.approx(moved.mean(axis=0).tolist())
    assert laser["rms_correction_m"] == pytest.approx(np.sqrt(np.mean(moved**2, axis=0)).tolist())
    assert laser["mean_sigma_m"] == pytest.approx(solution.sigmas[mine].mean(axis=0).tolist())
    scaled = record["sigmas"]["scaled_by_sigma0"]["mean_sigma_m"]["laser"]
    assert scaled == pytest.approx((solution.sigma0 * solution.sigmas[mine].mean(axis=0)).tolist())
    assert lossy.network.held.tolist() == [image["held"] for image in solution_json(lossy)["images"]] == [False, True]
    # one has a single ray and no place, the other has lost both its rays
    lost = solution_json(lossy)
    assert (lost["points"]["tie"]["count"], lost["points"]["tie"]["rejected"]) == (40, 2)
    assert lost["undetermined"] == [lossy.network.points.ids[1]]


def test_ranges_and_the_effect_of_the_laser(solution: Solution, case: Case) -> None:
    record = solution_json(solution)
    used = solution.range_residuals
    assert record["ranges"]["rms_residual_m"] == pytest.approx(np.sqrt(np.mean(used**2)))
    assert record["ranges"]["mean_residual_before_m"] == pytest.approx(solution.range_residuals_before.mean())
    effect = record["laser_effect"]
    assert effect["tie_mean_sigma_m"] == pytest.approx(record["points"]["tie"]["mean_sigma_m"])
    quotient = solution.sigmas_without_laser / np.array(effect["tie_mean_sigma_m"])
    assert effect["ratio"] == pytest.approx(quotient.tolist())
    assert quotient.min() <= effect["ratio_overall"] <= quotient.max()
    # outside authority: the pair adjusted without its laser rows
    alone = adjust_network(network(pair(40, 12), laser=False), case.settings)
    assert effect["tie_mean_sigma_without_laser_m"] == pytest.approx(
        solution_json(alone)["points"]["tie"]["mean_sigma_m"], rel=1e-3
    )
    assert solution_json(alone)["laser_effect"] is None
    assert solution_json(alone)["ranges"]["count"] == 0
    assert solution_json(alone)["ranges"]["rms_residual_m"] is None


def test_one_weak_point_does_not_speak_for_all(solution: Solution) -> None:
    """Nearly parallel rays: a sigma of kilometres moves the mean, not the median nor what 95 % have at most."""
    covariances = solution.covariances.copy()
    covariances[3] *= 1e6
    spoilt = replace(solution, covariances=covariances)
    plain, odd = (point_statistics(one, PointClass.TIE) for one in (solution, spoilt))
    assert (plain.weak, odd.weak) == (0, 1)
    assert np.all(odd.mean_sigma > 10.0 * plain.mean_sigma)
    np.testing.assert_allclose(odd.median_sigma, plain.median_sigma, rtol=0.05)
    np.testing.assert_allclose(odd.high_sigma, plain.high_sigma, rtol=0.2)
    one, other = (solution_json(each)["laser_effect"] for each in (solution, spoilt))
    assert other["ratio_overall"] == pytest.approx(one["ratio_overall"], rel=0.05)
    assert other["ratio"][0] < 0.2 * one["ratio"][0]


def test_ranges_that_drift_together_are_not_wild(case: Case) -> None:
    """The nominal orientation's errors are common to a profile: only a range that leaves it is named."""
    ranges = case.network.ranges
    drift = np.linspace(-800.0, 800.0, ranges.point.size)
    rng = np.random.default_rng(1)
    values = drift + rng.normal(0.0, ranges.sigmas)
    assert not outlying_ranges(case.network, values).size
    values[4] += 20e3
    assert outlying_ranges(case.network, values).tolist() == [4]


# --- CSV


def test_points_table_reads_back_bit_for_bit(solution: Solution, lossy: Solution, tmp_path: Path) -> None:
    for one in (solution, lossy):
        table, points = rows(points_table, one, tmp_path), one.network.points
        assert [row["id"] for row in table] == list(points.ids)
        for c, name in enumerate(XYZ):
            np.testing.assert_array_equal(column(table, f"{name}_m"), one.places[:, c])
            np.testing.assert_array_equal(column(table, f"sigma_{name}_m"), one.sigmas[:, c])
            np.testing.assert_array_equal(column(table, f"scaled_sigma_{name}_m"), one.sigmas[:, c] * one.sigma0)
            np.testing.assert_array_equal(
                column(table, f"correction_{name}_m"), (one.places - one.places_before)[:, c]
            )
            for d in range(c, 3):
                np.testing.assert_array_equal(column(table, f"cov_{name}{XYZ[d]}_m2"), one.covariances[:, c, d])


def test_points_table_has_planetocentric_places(solution: Solution, tmp_path: Path) -> None:
    # across the prime meridian longitudes stay in 0 .. 360
    turned = replace(solution, places=solution.places * np.array([1.0, -1.0, 1.0]))
    for one in (solution, turned):
        table = rows(points_table, one, tmp_path)
        longitude, latitude, radius = (column(table, name) for name in ("lon_deg", "lat_deg", "radius_m"))
        assert np.all((longitude >= 0.0) & (longitude < 360.0))
        back = from_planetocentric(np.column_stack([longitude * DEG, latitude * DEG, radius]))
        assert np.abs(back - one.places).max() < 1e-5


def test_points_table_marks_what_is_lost(lossy: Solution, tmp_path: Path) -> None:
    table = rows(points_table, lossy, tmp_path)
    assert [row["rejected"] for row in table[:4]] == ["false", "true", "true", "false"]
    assert [(row["rays"], row["rays_used"]) for row in table[:3]] == [("2", "2"), ("1", "0"), ("2", "0")]
    lost = table[1]
    assert all(not lost[name] for name in lost if name.endswith(("_m", "_m2", "_deg")))
    assert [table[0][name] for name in ("id", "class", "kind")] == ['odd, "id"', "tie", "free"]
    assert (table[-1]["class"], table[-1]["kind"]) == ("laser", "constrained")


def test_local_sigmas_against_a_rotated_covariance(solution: Solution) -> None:
    """At longitude 0 and 90 on the equator east, north and up are body axes; the trace is the same anywhere."""
    points = np.array([[3e6, 0.0, 0.0], [0.0, 3e6, 0.0], [0.0, 0.0, 3e6]])
    covariances = np.broadcast_to(np.diag([1.0, 4.0, 9.0]), (3, 3, 3))
    at_zero, at_ninety, at_pole = local_sigmas(covariances, points)
    assert at_zero == pytest.approx([2.0, 3.0, 1.0])
    assert at_ninety == pytest.approx([1.0, 3.0, 2.0])
    assert at_pole[2] == pytest.approx(3.0)
    total = np.trace(solution.covariances, axis1=1, axis2=2)
    assert np.sum(local_sigmas(solution.covariances, solution.places) ** 2, axis=1) == pytest.approx(total, rel=1e-9)


def test_orientation_table(solution: Solution, tmp_path: Path) -> None:
    table = rows(orientation_table, solution, tmp_path)
    assert [row["image"] for row in table] == ["SIM/A"] * 31 + ["SIM/B"] * 31
    for j in range(2):
        profile, part = orientation_profile(solution, j, 31), table[31 * j : 31 * (j + 1)]
        np.testing.assert_array_equal(column(part, "time_et_s"), profile.times)
        np.testing.assert_array_equal(column(part, "isis_line"), profile.lines + 0.5)
        for c, name in enumerate(XYZ):
            np.testing.assert_array_equal(column(part, f"{name}_after_m"), profile.position_after[:, c])
            difference = column(part, f"{name}_after_m") - column(part, f"{name}_before_m")
            np.testing.assert_array_equal(column(part, f"{name}_difference_m"), difference)
        for c, name in enumerate(("omega", "phi", "kappa")):
            after, before = column(part, f"{name}_after_deg"), column(part, f"{name}_before_deg")
            assert column(part, f"{name}_difference_arcsec") == pytest.approx(3600.0 * (after - before), abs=1e-6)
            assert column(part, f"{name}_sigma_arcsec") == pytest.approx(profile.angles_sigma[:, c] / ARCSEC)


def test_residual_table(lossy: Solution, tmp_path: Path) -> None:
    network, table = lossy.network, rows(residuals_table, lossy, tmp_path)
    images, ranges = ([row for row in table if row["kind"] == kind] for kind in ("image", "range"))
    assert (len(images), len(ranges)) == (network.rays.point.size, network.ranges.point.size)
    assert [row["point"] for row in images] == [network.points.ids[i] for i in network.rays.point]
    assert [row["used"] == "true" for row in images] == lossy.rays_used.tolist()
    # lines and samples are those of the network file, counted from 1
    np.testing.assert_array_equal(column(images, "isis_line"), network.rays.places[:, 0] + 0.5)
    np.testing.assert_array_equal(column(images, "isis_sample"), network.rays.places[:, 1] + 0.5)
    for c, name in enumerate(("line", "sample")):
        np.testing.assert_array_equal(column(images, f"residual_{name}_px"), lossy.residuals[:, c])
        np.testing.assert_array_equal(column(images, f"residual_before_{name}_px"), lossy.residuals_before[:, c])
        assert np.all(column(ranges, f"residual_{name}_px") != column(ranges, f"residual_{name}_px"))  # empty
        normalised = column(images, f"residual_{name}_px") / column(images, f"sigma_{name}_px")
        np.testing.assert_array_equal(column(images, f"normalised_{name}"), normalised)
    np.testing.assert_array_equal(column(ranges, "residual_range_m"), lossy.range_residuals)
    np.testing.assert_array_equal(column(ranges, "range_m"), network.ranges.values)
    # the simulator fires along the optical axis at known lines
    assert column(ranges, "isis_line")[[0, -1]] == pytest.approx([60.5, 5000.0 - 60.0 + 0.5], abs=1e-3)


# --- Parquet


def test_parquet_holds_what_csv_does(solution: Solution, tmp_path: Path) -> None:
    for form in ("csv", "parquet"):
        names = write_results(solution, tmp_path / form, figures=False, tables=form)  # type: ignore[arg-type]
        assert {f"points.{form}", f"residuals.{form}"} <= set(names)
    for name in ("points", "residuals"):
        one = pyarrow.csv.read_csv(tmp_path / "csv" / f"{name}.csv")
        other = parquet.read_table(tmp_path / "parquet" / f"{name}.parquet")
        left = other.drop_columns(["geometry"]) if name == "points" else other
        assert one.column_names == left.column_names
        for column in one.column_names:
            assert [x or None for x in one[column].to_pylist()] == [x or None for x in left[column].to_pylist()], column


def test_places_are_in_geoparquet(solution: Solution, tmp_path: Path) -> None:
    write_results(solution, tmp_path / "r", figures=False, tables="parquet")
    table = parquet.read_table(tmp_path / "r" / "points.parquet")
    about = json.loads(table.schema.metadata[b"geo"])
    assert about["columns"]["geometry"]["crs"] == geographic_crs(solution.network.body)
    shapes = shapely.from_wkb(np.array(table["geometry"].to_pylist(), dtype=object))
    lon, lat = table["lon_deg"].to_numpy(), table["lat_deg"].to_numpy()
    np.testing.assert_allclose(shapely.get_x(shapes) % 360.0, lon, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(shapely.get_y(shapes), lat)


def test_the_longer_table_decides(solution: Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    assert form_of(solution) == "csv"
    assert form_of(solution, "parquet") == "parquet"
    monkeypatch.setattr(large_tables, "MOST_CSV_ROWS", 10)
    assert form_of(solution) == "parquet"
    assert form_of(solution, "csv") == "csv"


# --- shifts and terrain


def test_shifts_and_heights_are_told() -> None:
    solution = adjust_network(with_shift_and_surface(network(pair())), SolverSettings())
    record = control_section(solution).numbers
    shift, terrain = record["shifts"]
    assert terrain["name"] == "terrain model"
    assert shift["east_north_m"] == solution.shifts[0].tolist()
    assert shift["sigma_east_north_m"] == pytest.approx(solution.joint_covariance.sigmas[-4:-2].tolist())
    before, after = surface_heights(solution)
    assert record["surface"]["count"] == after.size == 12
    assert record["surface"]["rms_height_before_m"] == pytest.approx(np.sqrt(np.mean(before**2)))
    assert solution_json(solution)["control"] == record
    plain = control_section(adjust_network(network(pair()), SolverSettings()))
    assert (plain.sentences, plain.numbers["surface"]["count"]) == ([], 0)


def test_heights_above_stereo_surfaces_are_told(tmp_path: Path) -> None:
    solution = adjust_network(stereo_network(pair(), displaced=False), SolverSettings())
    heights = solution.stereo_heights[-6:]
    assert control_section(solution).numbers["stereo"] == {
        "count": 6, "rms_height_m": pytest.approx(np.sqrt(np.mean(heights**2)))
    }  # fmt: skip
    residuals_table(solution).write_csv(tmp_path / "residuals.csv")
    mine = [row for row in rows_of(tmp_path / "residuals.csv") if row["kind"] == "stereo height"]
    assert [row["point"] for row in mine] == list(solution.network.points.ids[-6:])
    assert [float(row["residual_height_m"]) for row in mine] == (-heights).tolist()
    said = {(row["image"], row["used"], row["isis_line"], float(row["sigma_height_m"])) for row in mine}
    assert said == {("", "true", "", 1.0)}


# --- the sigma raster in GDAL's hands


MARS = Ellipsoid(3396190.0, 3376200.0)
STEP = np.radians(0.01)
GRID = SigmaGrid(
    ("A", "B"), 0.7, np.radians(175.0), np.radians(-14.0), (2.0 * STEP, STEP),
    np.arange(60.0).reshape(4, 3, 5), np.full((3, 5), 2),
)  # fmt: skip


def test_each_cell_is_found_by_its_coordinates(tmp_path: Path) -> None:
    write_sigma_raster(GRID, MARS, tmp_path / "sigmas.tif")
    with rasterio.open(tmp_path / "sigmas.tif") as file:
        assert file.crs == CRS.from_user_input("IAU_2015:49900")
        assert file.descriptions == BANDS
        assert set(file.units) == {"m"}
        assert file.tags()["images"] == "A, B"
        for row, column in ((0, 0), (2, 4), (1, 3)):
            place = (175.0 + 0.02 * (column + 0.5), -14.0 - 0.01 * (row + 0.5))
            assert np.array_equal(next(file.sample([place])), GRID.values[:, row, column])


def test_what_is_not_known_is_nodata(tmp_path: Path) -> None:
    values = GRID.values.copy()
    values[:, 1, 2] = np.nan
    write_sigma_raster(replace(GRID, values=values), Ellipsoid(1000e3, 990e3), tmp_path / "sigmas.tif")
    with rasterio.open(tmp_path / "sigmas.tif") as file:
        assert np.array_equal(file.dataset_mask() == 0, np.isnan(values[0]))
        assert "1000000" in file.crs.to_wkt()


def test_a_file_that_does_not_fit_is_an_error(tmp_path: Path) -> None:
    with files_of_at_most(500), pytest.raises(InputError, match="can't be written"):
        write_sigma_raster(GRID, MARS, tmp_path / "sigmas.tif")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").write_text("in the way")
    refuses("can't be written", write_sigma_raster, GRID, MARS, tmp_path / "file" / "sigmas.tif")


def test_every_question_has_its_answer_in_words_and_figures() -> None:
    posterior = Posterior.of(adjust_network(network(pair()), SolverSettings()))
    points, images = posterior.network.points.ids, posterior.network.image_names
    asked = Questions(
        points=points[:1], pairs=((points[0], points[1]),), poses=((images[0], 100.0), (images[1], 50.0)),
        projections=((points[0], images[1]),), correlations=True,
    )  # fmt: skip
    found = {section.numbers["question"]: section for section in replies(posterior, asked)}
    assert list(found) == ["point", "pair", "pose", "projection", "correlations"]
    assert len(found["correlations"].numbers["names"]) == 3 + 3 + 6 + 6 + 2
    assert "95 % error ellipsoid" in found["point"].text()
