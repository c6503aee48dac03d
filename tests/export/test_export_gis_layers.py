"""Footprints, error ellipses and vectors of the GIS layers against formulas and the images themselves."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from gis_files import degrees, layer, level_axes, odd_solution, on_body, true_area
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import adjusted_points
from mgsgraph.export.gis import exaggeration, write_gis
from mgsgraph.geometry.body import from_planetocentric, geodetic
from mgsgraph.geometry.records import Array
from mgsgraph.network import PointClass
from mgsgraph.network.connectivity import network_footprints
from mgsgraph.simulation.orbit import MARS
from mgsgraph.units import DEG, KM

pytest.importorskip("pyogrio", reason="the extra [gis] is not installed")


@pytest.fixture(scope="module")
def solution() -> Solution:
    return odd_solution()


@pytest.fixture(scope="module")
def written(solution: Solution, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_gis(solution, tmp_path_factory.mktemp("gis"))[0]


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


@settings(deadline=None)
@given(st.lists(st.floats(1e-9, 1e9), max_size=12), st.floats(0.0, 1e7))
def test_an_exaggeration_is_round_and_not_too_large(lengths: list[float], size: float) -> None:
    found = exaggeration(np.array([*lengths, np.nan, 0.0]), size)
    assert 1.0 <= found <= 1e6
    assert f"{found:.0e}"[0] in "125"
    if found > 1.0:
        assert found * np.quantile(lengths, 0.9) <= 0.05 * size * (1.0 + 1e-9)
    elif lengths:
        assert 2.0 * np.quantile(lengths, 0.9) > 0.05 * size * (1.0 - 1e-9)


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
    names = [image.name for image in net.images]
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
