"""Checkpoints and control left out in turn: they use no known coordinates, their sigmas hold, and they equal a true
adjustment without this control.
"""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import rows_of, run
from networks import network, pair
from outside import refuses
from redraw import redraw
from scipy.special import chdtri
from sites import plain_site

import mgsgraph
from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.checkpoints import checkpoint_discrepancies as discrepancies
from mgsgraph.analysis.checkpoints import leave_out
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.sanity import Kind, losses
from mgsgraph.analysis.verdict import Cause, State
from mgsgraph.errors import InputError
from mgsgraph.files.networks.table import table_text
from mgsgraph.files.networks.tie_points import PointKind, control_network
from mgsgraph.files.writing import read_record
from mgsgraph.network import GroundPoints, Network, PointClass, SharedKind, SharedUnknown
from mgsgraph.results.ground import checkpoint_sections, leave_out_section
from mgsgraph.results.summary import summary
from mgsgraph.simulation.files import write_site

CHECKS = np.arange(6)


def with_points(net: Network, which: np.ndarray, kind: PointKind, places: np.ndarray) -> Network:
    """The same with some tie points as ground control of a kind, known at `places` (n, 3)."""
    old = net.points
    classes, kinds, known, covariances = (np.array(a) for a in (old.classes, old.kinds, old.places, old.covariances))
    classes[which], kinds[which], known[which] = PointClass.CONTROL, kind, places[which]
    covariances[which] = 0.0 if kind == PointKind.FIXED else np.diag([16.0, 32.0, 48.0])
    return replace(net, points=GroundPoints(old.ids, classes, kinds, known, covariances))


def freed(net: Network, which: np.ndarray) -> Network:
    """Some control points as checkpoints."""
    kinds = net.points.kinds.copy()
    kinds[which] = PointKind.FREE
    return replace(net, points=replace(net.points, kinds=kinds))


@cache
def controlled_geometry() -> Network:
    """The simulated pair with ground control and without laser."""
    net = network(pair(30, 1), laser=False)
    return with_points(net, np.arange(14), PointKind.CONSTRAINED, adjust_network(net).places)


@cache
def controlled() -> Network:
    """It, drawn once."""
    return redraw(controlled_geometry(), np.random.default_rng(2)).network


@cache
def checked() -> Any:
    """Its solution, with checkpoints."""
    return adjust_network(freed(controlled(), CHECKS))


def test_known_coordinates_of_checkpoints_take_no_part() -> None:
    moved = freed(controlled(), CHECKS)
    places, by = moved.points.places.copy(), np.array([300.0, -200.0, 500.0])
    places[CHECKS] += by
    solution = adjust_network(replace(moved, points=replace(moved.points, places=places)))
    np.testing.assert_array_equal(solution.places, checked().places)
    moved = discrepancies(solution).values - discrepancies(checked()).values
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), np.linalg.norm(by), atol=0.1)
    assert [reason.state for reason in mgsgraph.verdict(solution).of(Cause.CHECKPOINT)] == [State.SUSPECT]
    assert not mgsgraph.verdict(checked()).of(Cause.CHECKPOINT)
    assert any("larger than the stated sigmas" in sentence for sentence in summary(solution))


def test_leave_out_equals_an_adjustment_without_that_control() -> None:
    result = leave_out(at_solution(checked()))
    for row, point in ((0, 6), (5, 11)):
        anew = discrepancies(adjust_network(freed(controlled(), np.append(CHECKS, point))))
        other = int(np.flatnonzero(anew.points == point)[0])
        np.testing.assert_allclose(result.values[row], anew.values[other], atol=1e-3 * anew.sigmas[other].min())
        np.testing.assert_allclose(result.sigmas[row], anew.sigmas[other], rtol=1e-3)


def assert_in_band(net: Network, which: np.ndarray, draws: int) -> None:
    """Chi-square and single tests of independent draws, with every other control point as a checkpoint."""
    drawn = [redraw(net, np.random.default_rng(seed)).network for seed in range(draws)]
    solutions = [adjust_network(freed(one, which[::2]), SolverSettings(starts=1)) for one in drawn]
    for each in ([discrepancies(one) for one in solutions], [leave_out(at_solution(one)) for one in solutions]):
        degrees = sum(one.degrees for one in each)
        assert degrees == 3 * sum(one.points.size for one in each)
        assert chdtri(degrees, 0.9995) < sum(one.chi_square for one in each) < chdtri(degrees, 0.0005)
        rms = np.sqrt(np.mean(np.concatenate([one.normalized for one in each]) ** 2, axis=0))
        assert np.all(np.abs(rms - 1.0) < 5.0 / np.sqrt(2.0 * draws)), rms  # points of a draw depend on others


@pytest.mark.parametrize("considered", [False, True])
def test_discrepancies_have_their_stated_sigmas(considered: bool) -> None:
    """Also where the focal length of an image is held, and is off by 1.4 %."""
    focal = SharedUnknown("focal", SharedKind.FOCAL_LENGTH, np.array([0]), np.array([0.05]))
    held = replace(controlled_geometry(), shared=(focal,), considered=("focal",))
    assert_in_band(held if considered else controlled_geometry(), np.arange(14), 20)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gusev", "isidis"])
def test_discrepancies_at_simulated_sites(name: str, tmp_path: Path) -> None:
    """100 draws of a site with its laser, terrain and images, and every sixth tie point as ground control."""
    case = mgsgraph.read_case(write_site(plain_site(name), tmp_path))
    which = np.flatnonzero(case.network.points.classes == PointClass.TIE)[3::6]
    base = adjust_network(case.network, case.settings)
    assert_in_band(with_points(case.network, which, PointKind.CONSTRAINED, base.places), which, 100)


def test_what_has_no_discrepancy_is_named() -> None:
    net = freed(controlled(), CHECKS)
    for unseen in (3, 6):
        keep = np.flatnonzero((net.rays.point >= unseen) | (net.rays.image == 0))
        solution = adjust_network(replace(net, rays=net.rays.chosen(keep)))
        np.testing.assert_array_equal(discrepancies(solution).undetermined, CHECKS[:unseen])
        assert f"the position of {unseen} points, without" in checkpoint_sections(solution)[0].sentences[1]
        assert not [loss for loss in losses(solution) if loss.kind == Kind.CONTROL]
    mixed = with_points(controlled(), np.arange(6, 8), PointKind.FIXED, controlled().points.places)
    assert "Fixed points can't be" in leave_out_section(at_solution(adjust_network(mixed))).sentences[-1]
    with pytest.raises(InputError, match="no point with known coordinates that takes part"):
        leave_out_section(at_solution(adjust_network(network(pair(30, 1)))))


# --- by files


@pytest.fixture
def known_case(case_file: Path) -> Path:
    """The pair's case, nine of whose tie points are known, four of them as checkpoints and one of these Fixed."""
    case = mgsgraph.read_case(case_file)
    kinds = np.where(np.arange(len(case.ties.ids)) < 9, PointKind.CONSTRAINED, PointKind.FREE)
    kinds[0] = PointKind.FIXED
    places, covariances = mgsgraph.adjust(case).places[: kinds.size], np.tile(9.0 * np.eye(3), (kinds.size, 1, 1))
    ties = replace(case.ties, kinds=kinds, places=places, covariances=covariances)
    case_file.with_name("control.csv").write_text(table_text(control_network(ties, "pair", "MARS")), encoding="utf-8")
    text = case_file.read_text(encoding="utf-8").replace("network.pvl", "control.csv")
    ids = f"checkpoints = {json.dumps(ties.ids.tolist()[:7:2])}"
    case_file.write_text(text.replace("format = 1", f"format = 1\n{ids}"), encoding="utf-8")
    return case_file


def test_adjust_and_analyze_print_and_write_them(known_case: Path) -> None:
    result, analysis = known_case.with_name("R"), known_case.with_name("A")
    adjusted = run("adjust", known_case, "--out", result, "--no-figures")
    assert "- Checkpoints (4): adjusted minus known has rms " in adjusted.stdout, adjusted.stderr
    assert "- Control points (5)" in adjusted.stdout  # without the checkpoints
    assert len(adjusted.stdout.splitlines()) <= 15
    record, rows = read_record(result / "solution.json")["checkpoints"], rows_of(result / "checkpoints.csv")
    assert [row["point"] for row in rows] == ["TIE00001", "TIE00003", "TIE00005", "TIE00007"]
    upward = np.array([float(row["difference_up_m"]) for row in rows])
    np.testing.assert_allclose(record["rms_east_north_up_m"][2], np.sqrt(np.mean(upward**2)))
    analyzed = run("analyze", result, "--leave-out", "--out", analysis)
    assert "- Control points, each left out (5): " in analyzed.stdout, analyzed.stderr
    assert len(rows_of(analysis / "leave_out.csv")) == 5


def test_what_is_no_known_point_is_refused(known_case: Path) -> None:
    text = known_case.read_text(encoding="utf-8")
    for name, message in (
        ("TIE00012", r"control.csv, point TIE00012: a checkpoint without known coordinates \(Free\); expected a C"),
        ("NONE", r"case.toml, checkpoints: no point 'NONE'; expected ids of points"),
    ):
        known_case.write_text(text.replace('"TIE00003"', f'"{name}"'), encoding="utf-8")
        refuses(message, mgsgraph.read_case, known_case)
