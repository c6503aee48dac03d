"""Exports for ISIS: the network read back by other means, jigsaw's tables by jigsaw's headers."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from exported import network_differences
from networks import network, pair
from outside import refuses

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.analysis.statistics import local_sigmas
from mgsgraph.case.reading import adjust, read_case
from mgsgraph.export.bundle_out import (
    common_degree,
    orientation_polynomials,
    write_bundle_out,
)
from mgsgraph.export.isis import adjusted_network, write_isis
from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.files.networks.binary import read_network
from mgsgraph.files.networks.record import (
    ControlNetwork,
    PointType,
)
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import east_north_up, in_turn, planetocentric
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.network import GroundPoints, Network, PointClass

CASES = Path(__file__).resolve().parents[2] / "scripts" / "cases"

BLUNDER = 3


@pytest.fixture(scope="module")
def solution() -> Solution:
    return adjust_network(network(pair()), SolverSettings(), "pair")


@pytest.fixture(scope="module")
def mixed() -> Solution:
    """Ties that are free, constrained and fixed, one that nothing determines, one measure that is a blunder."""
    drawn = pair(ties=20)
    net: Network = network(drawn)
    kinds, covariances = net.points.kinds.copy(), net.points.covariances.copy()
    places, free = net.points.places.copy(), net.points.kinds == PointKind.FREE
    solved = adjust_network(net, SolverSettings(), "free")
    places[:2] = solved.places[:2]
    kinds[:2] = PointKind.CONSTRAINED, PointKind.FIXED
    covariances[0] = np.diag([9.0, 16.0, 25.0]) + 1.0
    classes = np.where(free & (kinds != PointKind.FREE), PointClass.CONTROL, net.points.classes)
    points = GroundPoints(net.points.ids, classes, kinds, places, covariances)
    rows = np.flatnonzero(~((net.rays.point == 5) & (net.rays.image == 1)))
    rays = net.rays.chosen(rows)
    spoilt = rays.places.copy()
    spoilt[np.flatnonzero(rays.point == BLUNDER)[0], 0] += 60.0
    net = replace(net, points=points, rays=replace(rays, places=spoilt, sigmas=rays.sigmas * [1.0, 0.75]))
    return adjust_network(net, SolverSettings(reject=4.0), 'mixed "odd" name')


def written(solution: Solution, folder: Path, **options: bool) -> ControlNetwork:
    write_isis(solution, folder, **options)
    return read_network(folder / "network.net")


# --- the network


@pytest.mark.parametrize("name", ["solution", "mixed"])
def test_what_comes_back_is_the_solution(name: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    one: Solution = request.getfixturevalue(name)
    written(one, tmp_path)
    found = network_differences(tmp_path, one)
    assert found.measured.size > 20
    assert found.measured.max() < 1e-9
    assert found.points.max() < 1e-9
    good = one.rays_used[one.determined[one.network.rays.point]]
    assert found.predicted[good].max() < 0.01


def test_both_forms_are_one_network(mixed: Solution, tmp_path: Path) -> None:
    found = written(mixed, tmp_path)
    text = read_network(tmp_path / "network.pvl")
    assert text.points == found.points == adjusted_network(mixed).points
    assert (text.network_id, text.description) == (found.network_id, found.description)
    assert found.target_name == "MARS"


def test_kinds_covariances_and_rejected_marks(mixed: Solution, tmp_path: Path) -> None:
    points = {point.id: point for point in written(mixed, tmp_path).points}
    ids, upper = mixed.network.points.ids, np.triu_indices(3)
    constrained, fixed, undetermined, spoilt = (points[ids[i]] for i in (0, 1, 5, BLUNDER))
    assert (constrained.type, fixed.type) == (PointType.CONSTRAINED, PointType.FIXED)
    assert constrained.apriori_covariance == tuple(mixed.network.points.covariances[0][upper])
    assert constrained.adjusted_covariance == tuple(mixed.covariances[0][upper])
    assert constrained.radius_constrained
    assert fixed.adjusted == fixed.apriori == tuple(mixed.network.points.places[1])
    assert fixed.adjusted_covariance == ()
    freed = mixed.network.points.kinds.copy()
    freed[:2] = PointKind.FREE  # of ground control: checkpoints
    checked = replace(mixed, network=replace(mixed.network, points=replace(mixed.network.points, kinds=freed)))
    for check, point in zip(adjusted_network(checked).points, (constrained, fixed), strict=False):
        assert all(getattr(check, key) == getattr(point, key) for key in ("type", "apriori", "apriori_covariance"))
    assert len(adjusted_network(checked).points[1].adjusted_covariance) == 6
    assert undetermined.adjusted is None
    assert undetermined.jigsaw_rejected
    assert mixed.rays_rejected is not None
    of_spoilt = mixed.rays_rejected[mixed.network.rays.point == BLUNDER]
    assert of_spoilt.any()
    assert [measure.jigsaw_rejected for measure in spoilt.measures] == of_spoilt.tolist()
    rejected = sum(measure.jigsaw_rejected for point in points.values() for measure in point.measures)
    lone = mixed.network.rays.point == 5
    assert rejected == (mixed.rays_rejected & ~lone).sum() > 0
    assert not undetermined.measures[0].jigsaw_rejected


def test_a_measure_of_a_lost_point_is_not_rejected_itself(mixed: Solution) -> None:
    marks = np.zeros(mixed.rays_used.size, dtype=bool)
    marks[0] = True
    ids = mixed.network.points.ids
    for one in (replace(mixed, rays_rejected=marks), replace(mixed, rays_rejected=None)):
        points = {point.id: point for point in adjusted_network(one).points}
        assert not any(measure.jigsaw_rejected for measure in points[ids[5]].measures)
        assert points[ids[5]].measures[0].line_residual is None
    points = {point.id: point for point in adjusted_network(replace(mixed, rays_rejected=marks)).points}
    (first,) = [point for point in points.values() if point.measures[0].jigsaw_rejected]
    assert first.id == ids[mixed.network.rays.point[0]]
    assert first.reference == 1


def test_measures_count_as_isis_does(mixed: Solution, tmp_path: Path) -> None:
    solution = replace(mixed, residuals=np.nan_to_num(mixed.residuals))
    measures = [measure for point in written(solution, tmp_path).points for measure in point.measures]
    order = np.argsort(solution.network.rays.point, kind="stable")
    rays = solution.network.rays.chosen(order)
    assert [(m.line, m.sample) for m in measures] == [tuple(row) for row in (rays.places + 0.5).tolist()]
    assert [(m.line_sigma, m.sample_sigma) for m in measures] == [tuple(row) for row in rays.sigmas.tolist()]
    assert [m.serial_number for m in measures] == [solution.network.images[j].name for j in rays.image.tolist()]


def test_covariances_are_scaled_when_asked_and_it_is_said(solution: Solution, tmp_path: Path) -> None:
    plain, scaled = adjusted_network(solution), adjusted_network(solution, scaled=True)
    one, other = (np.array([p.adjusted_covariance for p in net.points]) for net in (plain, scaled))
    np.testing.assert_allclose(other, one * solution.sigma0**2, rtol=1e-14)
    assert "for sigma0 = 1" in plain.description
    assert "times sigma0^2" in scaled.description
    lost = replace(solution, fit=replace(solution.fit, observations=5, unknowns=5))
    refuses("0 degrees of freedom", write_isis, lost, tmp_path, scaled=True)
    assert not list(tmp_path.iterdir())


def test_laser_footprints_are_in_one_network_and_not_in_the_other(solution: Solution, tmp_path: Path) -> None:
    every, without = written(solution, tmp_path), read_network(tmp_path / "network_without_laser.net")
    laser = solution.network.points.classes == PointClass.LASER
    assert len(every.points) - len(without.points) == laser.sum() > 0


def test_no_measured_point_is_an_error(solution: Solution) -> None:
    net = solution.network
    bare = replace(net, rays=net.rays.chosen(np.zeros(0, dtype=np.int64)))
    lost = replace(solution, network=bare, rays_used=np.zeros(0, bool), residuals=np.zeros((0, 2)))
    refuses("no point that is measured", adjusted_network, lost)


# --- lidar data


def test_lidar_data_come_back(solution: Solution, tmp_path: Path) -> None:
    written(solution, tmp_path)
    found, net = read_lidar(tmp_path / "lidar.json"), solution.network
    index = [net.points.ids.index(name) for name in found.ids]
    np.testing.assert_allclose(found.footprints, net.points.places[index], atol=1e-8, rtol=0.0)
    np.testing.assert_allclose(found.covariances, net.points.covariances[index], atol=1e-9, rtol=1e-9)
    order = np.argsort(net.ranges.point)
    np.testing.assert_allclose(found.ranges, net.ranges.values[order], rtol=1e-15)
    assert found.times.tolist() == net.ranges.times[order].tolist()
    shots = json.loads((tmp_path / "lidar.json").read_text(encoding="utf-8"))["points"]
    adjusted = planetocentric(solution.places[index])
    np.testing.assert_allclose([s["adjustedRadius"] * 1e3 for s in shots], adjusted[:, 2], rtol=1e-15)
    np.testing.assert_allclose(np.radians([s["adjustedLatitude"] for s in shots]), adjusted[:, 1], rtol=1e-14)
    # the radius' variance is that along the plumb line
    up = solution.places[index] / adjusted[:, 2:]
    radial = np.einsum("ni,nij,nj->n", up, solution.covariances[index], up)
    np.testing.assert_allclose([s["adjustedMatrix"][5] for s in shots], radial, rtol=1e-9)


def test_measures_of_shots(solution: Solution, tmp_path: Path) -> None:
    written(solution, tmp_path)
    found, net = read_lidar(tmp_path / "lidar.json"), solution.network
    number = {(name, image): k for k, (name, image) in enumerate(
        zip((found.ids[i] for i in found.measure_shot), found.measure_image, strict=True))}  # fmt: skip
    laser = np.flatnonzero(net.points.classes[net.rays.point] == PointClass.LASER)
    assert len(number) == laser.size > 0
    for k in laser:
        key = net.points.ids[net.rays.point[k]], net.images[net.rays.image[k]].name
        np.testing.assert_allclose(found.measures[number[key]], net.rays.places[k], rtol=1e-15)


def test_two_ranges_of_one_shot_are_refused(solution: Solution, tmp_path: Path) -> None:
    ranges = solution.network.ranges
    twice = ranges.chosen(np.append(np.arange(ranges.point.size), 0))
    values = twice.values.copy()
    values[-1] += 1.0
    net = replace(solution.network, ranges=replace(twice, values=values))
    both = replace(
        solution, network=net, ranges_used=np.append(solution.ranges_used, True),
        range_residuals=np.append(solution.range_residuals, 0.0),
    )  # fmt: skip
    refuses(r"range: two that differ", write_isis, both, tmp_path)


# --- jigsaw's tables


def rows(path: Path) -> list[list[str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))


def test_points_are_under_jigsaws_names(mixed: Solution, tmp_path: Path) -> None:
    write_bundle_out(mixed, tmp_path)
    first, second, third, *table = rows(tmp_path / "bundleout_points.csv")
    assert third[:5] == ["Label", "Status", "Measures", "Measures", "RMS"]
    names = [" ".join(part for part in parts if part) for parts in zip(first, second, third, strict=True)]
    assert names[5:11] == [
        "3-d Latitude (dd)", "3-d Longitude (dd)", "3-d Radius (km)",
        "Sigma Latitude (m)", "Sigma Longitude (m)", "Sigma Radius (m)",
    ]  # fmt: skip
    by_id = {row[0]: row for row in table}
    ids = mixed.network.points.ids
    assert ids[5] not in by_id  # nothing determines it
    assert [by_id[ids[i]][1] for i in range(3)] == ["CONSTRAINED", "FIXED", "FREE"]
    for i in (0, 2, 7):
        row = [float(text) for text in by_id[ids[i]][2:]]
        np.testing.assert_allclose(row[12:], mixed.places[i] / 1e3, atol=1e-8)
        place = planetocentric(mixed.places[i])
        np.testing.assert_allclose(row[3:6], [*np.degrees(place[[1, 0]]) % 360.0, place[2] / 1e3], atol=1e-8)
        np.testing.assert_allclose(row[6:9], local_sigmas(mixed.covariances, mixed.places)[i, [1, 0, 2]], atol=1e-8)
        axes = east_north_up(mixed.places[[i]])[0, [1, 0, 2]]
        moved = axes @ (mixed.places[i] - mixed.places_before[i])
        np.testing.assert_allclose(row[9:12], moved, rtol=1e-3, atol=0.01)


def test_residuals_and_their_marks(mixed: Solution, tmp_path: Path) -> None:
    write_bundle_out(mixed, tmp_path)
    table = rows(tmp_path / "residuals.csv")[3:]
    assert sum(row[-1] == "*" for row in table) == int(np.sum(~mixed.rays_used & np.isfinite(mixed.residuals[:, 0])))
    rays, net = mixed.network.rays, mixed.network
    pairs = enumerate(zip(rays.point.tolist(), rays.image.tolist(), strict=True))
    key = {(net.points.ids[i], net.images[j].name): k for k, (i, j) in pairs}
    for row in table:
        k = key[row[0], row[2]]
        values = [float(text) for text in row[3:10]]
        np.testing.assert_allclose(values[2:4], rays.places[k, ::-1] + 0.5, atol=1e-8)
        np.testing.assert_allclose(values[4:6], mixed.residuals[k, ::-1], atol=1e-8)
        assert values[6] == pytest.approx(np.hypot(*values[4:6]), abs=1e-7)
    focal, _ = net.images[0].interior.focal_plane(rays.places[:1, 1])
    if rays.image[0] == 0:
        first = next(row for row in table if key[row[0], row[2]] == 0)
        np.testing.assert_allclose([float(text) for text in first[3:5]], focal[0] * 1e3, atol=1e-8)


def test_images_are_under_jigsaws_names(solution: Solution, tmp_path: Path) -> None:
    write_bundle_out(solution, tmp_path)
    first, second, *table = rows(tmp_path / "bundleout_images.csv")
    assert second[4:9] == ["Initial", "Correction", "Final", "Apriori Sigma", "Adj Sigma"]
    assert [first[4 + 15 * k] for k in range(6)] == ["X(t0)", "Y(t0)", "Z(t0)", "RA(t0)", "DEC(t0)", "TWIST(t0)"]
    for j, row in enumerate(table):
        assert row[0] == solution.network.images[j].name
        mine = (solution.network.rays.image == j) & solution.rays_used
        rms = np.sqrt(np.mean(solution.residuals[mine] ** 2, axis=0))
        np.testing.assert_allclose([float(row[1]), float(row[2])], rms[::-1])
        initial, correction, final = (float(text) for text in row[4:7])
        assert final == pytest.approx(initial + correction)
        found = orientation_polynomials(solution, j, 2)
        assert float(row[8]) == pytest.approx(found.sigma[0, 0], abs=1e-8)
        assert float(row[7]) == pytest.approx(found.prior[0, 0], rel=1e-7)
        assert float(row[4 + 45]) == pytest.approx(np.degrees(found.before[3, 0]))
        assert float(row[8 + 45]) == pytest.approx(np.degrees(found.sigma[3, 0]), rel=1e-3)


def test_sigmas_of_the_tables_are_scaled_when_asked(solution: Solution, tmp_path: Path) -> None:
    plain, scaled = tmp_path / "plain", tmp_path / "scaled"
    write_bundle_out(solution, plain)
    write_bundle_out(solution, scaled, scaled=True)
    one, other = (float(rows(folder / "bundleout_points.csv")[3][8]) for folder in (plain, scaled))
    assert other == pytest.approx(one * solution.sigma0, rel=1e-5)
    one, other = (float(rows(folder / "bundleout_images.csv")[2][8]) for folder in (plain, scaled))
    assert other == pytest.approx(one * solution.sigma0, rel=1e-5)


# --- orientation in jigsaw's words


def test_polynomials_follow_the_orientation(solution: Solution) -> None:
    degree = common_degree(solution)
    assert degree == 2
    for j, image in enumerate(solution.network.images):
        found, profile = orientation_polynomials(solution, j, degree), orientation_profile(solution, j)
        moved = np.linalg.norm(profile.position_after - profile.position_before, axis=1)
        assert np.linalg.norm(found.correction[:3, 0]) == pytest.approx(moved[15], rel=0.02, abs=0.01)
        # what the constant terms are known to: the position's trace doesn't depend on the axes
        middle = np.linalg.norm(profile.position_sigma[15])
        assert np.linalg.norm(found.sigma[:3, 0]) == pytest.approx(middle, rel=0.05)
        declination = found.sigma[4, 0]
        assert declination < np.linalg.norm(profile.rotation_sigma[15])
        assert np.all(found.prior > found.sigma)
        edges = image.timing.at(np.array([0.0, float(image.lines)]))[0]
        assert isinstance(image.trajectory, Trajectory)
        for at in (edges[0], edges.mean(), edges[1]):  # inertial, and time counts from the middle
            powers = (at - edges.mean()) ** np.arange(3)
            position, _ = image.trajectory.position.at(np.array([at]))
            np.testing.assert_allclose(found.before[:3] @ powers, position[0], atol=1.0)
            attitude, _ = image.trajectory.camera.at(np.array([at]))
            wanted = rotation.angles_313(attitude)[0]
            assert np.abs(in_turn(found.before[3:] @ powers - wanted)).max() < 1e-3


def test_sigmas_are_those_of_propagated_differences(solution: Solution) -> None:
    """Coefficients move with the unknowns as their sigmas say: by differences through the whole road."""
    j, own = 0, solution.coefficients[0]
    covariance = solution.image_covariance(j)
    step = np.sqrt(np.diagonal(covariance)) * 1e-2
    columns = []
    for k in range(own.size):
        pushed = own.copy().ravel()
        pushed[k] += step[k]
        moved = replace(solution, coefficients=(pushed.reshape(own.shape), *solution.coefficients[1:]))
        change = orientation_polynomials(moved, j, 2).correction - orientation_polynomials(solution, j, 2).correction
        columns.append(change.ravel() / step[k])
    slope = np.stack(columns, axis=1)
    want = np.sqrt(np.einsum("rw,wv,rv->r", slope, covariance, slope)).reshape(6, 3)
    np.testing.assert_allclose(orientation_polynomials(solution, j, 2).sigma, want, rtol=1e-3)


def test_a_held_image_has_no_sigmas(tmp_path: Path) -> None:
    held = adjust_network(network(pair(), (True, False)), SolverSettings(), "held")
    found = orientation_polynomials(held, 0, 2)
    assert np.isnan(found.prior).all()
    assert not found.sigma.any()
    write_bundle_out(held, tmp_path)
    row = rows(tmp_path / "bundleout_images.csv")[2]
    assert set(row[7::5]) == set(row[8::5]) == {"N/A"}


def test_lro_comes_back(shared_data: Path, tmp_path: Path) -> None:
    assert shared_data.is_dir()
    one = adjust(read_case(CASES / "lro_nac_lola.toml"))
    written(one, tmp_path)
    found = network_differences(tmp_path, one)
    assert (len(found.measured), found.measured.max(), found.points.max()) == (726, 0.0, 0.0)
    assert found.predicted.max() < 0.01
    ids = [point.id for point in read_network(shared_data / "lro_nac_lola" / "network.pvl").points if not point.ignore]
    assert set(ids) < {point.id for point in read_network(tmp_path / "network.net").points}
