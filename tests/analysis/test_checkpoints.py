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
from commands import call, rows_of, run
from explicit_form import dense_normals, of_layout
from networks import network, pair
from redraw import redraw
from scipy.special import chdtri
from sites import plain_site

import mgsgraph
from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.checkpoints import Discrepancies, checkpoint_discrepancies, leave_out
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.verdict import Cause, State
from mgsgraph.errors import InputError
from mgsgraph.files.networks.table import table_text
from mgsgraph.files.networks.tie_points import PointKind, control_network
from mgsgraph.geometry.body import east_north_up
from mgsgraph.network import GroundPoints, Network, PointClass, SharedKind, SharedUnknown
from mgsgraph.results.ground import checkpoint_sections, leave_out_section
from mgsgraph.results.summary import summary
from mgsgraph.simulation.files import write_site

ONCE = SolverSettings(starts=1)
SIGMA = 4.0
CHECKS, CONTROL = np.arange(6), np.arange(6, 14)


def with_points(net: Network, which: np.ndarray, kind: PointKind, places: np.ndarray, sigma: float = SIGMA) -> Network:
    """The same with some tie points as ground control of a kind, known at `places` (n, 3), off the terrain model."""
    classes, kinds, known, covariances = (
        np.array(part) for part in (net.points.classes, net.points.kinds, net.points.places, net.points.covariances)
    )
    classes[which], kinds[which], known[which] = PointClass.CONTROL, kind, places[which]
    covariances[which] = 0.0 if kind == PointKind.FIXED else np.diag([1.0, 2.0, 3.0]) * sigma**2
    surface = net.surface
    if surface is not None:
        surface = replace(surface, sigmas=np.where(np.isin(np.arange(len(known)), which), np.inf, surface.sigmas))
    return replace(net, points=GroundPoints(net.points.ids, classes, kinds, known, covariances), surface=surface)


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


def found(solution: Any) -> Discrepancies:
    discrepancies = checkpoint_discrepancies(solution)
    assert discrepancies is not None
    return discrepancies


def test_known_coordinates_of_checkpoints_take_no_part() -> None:
    moved = freed(controlled(), CHECKS)
    places, by = moved.points.places.copy(), np.array([300.0, -200.0, 500.0])
    places[CHECKS] += by
    solution = adjust_network(replace(moved, points=replace(moved.points, places=places)))
    np.testing.assert_array_equal(solution.places, checked().places)
    turned = east_north_up(controlled().points.places[CHECKS]) @ by
    np.testing.assert_allclose(found(solution).values, found(checked()).values - turned, atol=0.5)  # axes turn a little
    reason, = mgsgraph.verdict(solution).of(Cause.CHECKPOINT)
    assert reason.state is State.SUSPECT
    assert not mgsgraph.verdict(checked()).of(Cause.CHECKPOINT)
    assert any("larger than the stated sigmas" in sentence for sentence in summary(solution))


def test_sigmas_are_those_of_both_positions() -> None:
    solution, known = checked(), controlled().points
    covariance = Posterior.of(solution).covariance([Posterior.of(solution).of_point(2)]) + known.covariances[2]
    frame = east_north_up(known.places[[2]])[0]
    np.testing.assert_allclose(found(solution).covariances[2], frame @ covariance @ frame.T, rtol=1e-6)
    fixed = with_points(controlled(), CHECKS, PointKind.FIXED, known.places)
    exact = adjust_network(freed(fixed, CHECKS))
    alone = Posterior.of(exact).point(2).east_north_up
    np.testing.assert_allclose(found(exact).sigmas[2] ** 2, alone.diagonal(), rtol=1e-5)


def test_leave_out_equals_dense_algebra_without_the_rows() -> None:
    """The step of the linear problem from which three rows are taken, and its covariance, to 1e-6."""
    at, known = at_solution(checked()), controlled().points
    result = leave_out(at)
    normals = dense_normals(of_layout(at.layout, at.rows), at.orientation, at.points)
    matrix = normals.matrix + np.diag(np.arange(len(normals.matrix)) < normals.columns).astype(float)  # priors
    np.testing.assert_array_equal(result.points, CONTROL)
    for row, point in enumerate(CONTROL.tolist()):
        own = normals.columns + 3 * at.layout_index(point) + np.arange(3)
        weight, off = np.linalg.inv(known.covariances[point]), at.places[point] - known.places[point]
        without = matrix.copy()
        without[np.ix_(own, own)] -= weight
        inverse = np.linalg.inv(without)[np.ix_(own, own)]
        frame = east_north_up(known.places[[point]])[0]
        np.testing.assert_allclose(result.values[row], frame @ (off + inverse @ weight @ off), rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(
            result.covariances[row], frame @ (inverse + known.covariances[point]) @ frame.T, rtol=1e-6, atol=1e-5
        )


def test_leave_out_equals_an_adjustment_without_that_control() -> None:
    result = leave_out(at_solution(checked()))
    for row, point in ((0, 6), (5, 11)):
        anew = found(adjust_network(freed(controlled(), np.append(CHECKS, point))))
        other = int(np.flatnonzero(anew.points == point)[0])
        np.testing.assert_allclose(result.values[row], anew.values[other], atol=1e-3 * anew.sigmas[other].min())
        np.testing.assert_allclose(result.sigmas[row], anew.sigmas[other], rtol=1e-3)


def assert_in_band(net: Network, which: np.ndarray, draws: int, settings: SolverSettings = ONCE) -> None:
    """Chi-square and single tests of independent draws, with every other control point as a checkpoint."""
    counts: dict[str, list[Discrepancies]] = {"checkpoints": [], "left out": []}
    for seed in range(draws):
        solution = adjust_network(freed(redraw(net, np.random.default_rng(seed)).network, which[::2]), settings)
        counts["checkpoints"].append(found(solution))
        counts["left out"].append(leave_out(at_solution(solution)))
    for what, each in counts.items():
        degrees = sum(one.degrees for one in each)
        assert degrees == 3 * sum(one.points.size for one in each), what
        low, high = chdtri(degrees, 0.9995), chdtri(degrees, 0.0005)
        assert low < sum(one.chi_square for one in each) < high, what
        inside = np.mean([one.band[0] <= one.chi_square <= one.band[1] for one in each])
        assert inside >= 0.95 - 4.0 * np.sqrt(0.95 * 0.05 / draws), what
        rms = np.sqrt(np.mean(np.concatenate([one.normalized for one in each]) ** 2, axis=0))
        assert np.all(np.abs(rms - 1.0) < 5.0 / np.sqrt(2.0 * draws)), (what, rms)  # points of a draw depend on others


def test_discrepancies_have_their_stated_sigmas() -> None:
    assert_in_band(controlled_geometry(), np.arange(14), 20)


def test_considered_unknowns_are_in_their_sigmas() -> None:
    """The focal length of an image is held, and is off by 1.4 %."""
    net = controlled_geometry()
    shared = SharedUnknown("focal", SharedKind.FOCAL_LENGTH, np.array([0]), np.array([0.05]))
    assert_in_band(replace(net, shared=(shared,), considered=("focal",)), np.arange(14), 20)


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
    keep = np.flatnonzero((net.rays.point > 2) | (net.rays.image == 0))
    solution = adjust_network(replace(net, rays=net.rays.chosen(keep)))
    np.testing.assert_array_equal(found(solution).undetermined, [0, 1, 2])
    np.testing.assert_array_equal(found(solution).points, [3, 4, 5])
    section, = checkpoint_sections(solution)
    assert "3 points have no discrepancy" in section.sentences[1]
    unseen = net.rays.chosen(np.flatnonzero(net.rays.point >= CHECKS.size))
    none = adjust_network(freed(replace(net, rays=unseen), CHECKS))
    section, = checkpoint_sections(none)
    assert section.sentences[0].endswith("none has a discrepancy.")
    assert not np.any(none.determined[CHECKS])
    mixed = with_points(controlled(), CONTROL[:2], PointKind.FIXED, controlled().points.places)
    left = leave_out_section(at_solution(adjust_network(mixed)))
    assert "Fixed points can't be left out" in left.sentences[-1]
    assert "TIE00007, TIE00008" in left.sentences[-1]


# --- by files


@pytest.fixture
def known_case(case_file: Path) -> Path:
    """The pair's case, nine of whose tie points are known, four of them as checkpoints and one of these Fixed."""
    ties = mgsgraph.read_case(case_file).ties
    assert ties is not None
    known = np.arange(len(ties.ids)) < 9
    places = np.where(known[:, None], mgsgraph.adjust(mgsgraph.read_case(case_file)).places[: known.size], np.nan)
    kinds = np.where(known, PointKind.CONSTRAINED, PointKind.FREE)
    kinds[0] = PointKind.FIXED
    covariances = np.where((kinds == PointKind.CONSTRAINED)[:, None, None], np.eye(3) * 9.0, 0.0)
    controlled_ties = replace(ties, kinds=kinds, places=places, covariances=covariances)
    table = table_text(control_network(controlled_ties, "pair", "MARS"))
    case_file.with_name("control.csv").write_text(table, encoding="utf-8")
    ids = json.dumps([ties.ids[i] for i in (0, 2, 4, 6)])
    text = case_file.read_text(encoding="utf-8").replace("network.pvl", "control.csv")
    case_file.write_text(text.replace("format = 1", f"format = 1\ncheckpoints = {ids}"), encoding="utf-8")
    return case_file


def test_adjust_and_analyze_print_and_write_them(known_case: Path) -> None:
    result = known_case.with_name("R")
    adjusted = run("adjust", known_case, "--out", result, "--no-figures")
    assert adjusted.returncode == 0, adjusted.stderr
    assert "- Checkpoints (4): adjusted minus known has rms " in adjusted.stdout
    assert len(adjusted.stdout.splitlines()) <= 15
    record = json.loads((result / "solution.json").read_text(encoding="utf-8"))["checkpoints"]
    rows = rows_of(result / "checkpoints.csv")
    assert [row["point"] for row in rows] == ["TIE00001", "TIE00003", "TIE00005", "TIE00007"]
    assert record["degrees_of_freedom"] == 12
    upward = [float(row["difference_up_m"]) for row in rows]
    np.testing.assert_allclose(record["rms_east_north_up_m"][2], np.sqrt(np.mean(np.square(upward))))
    analysis = known_case.with_name("A")
    analyzed = run("analyze", result, "--leave-out", "--out", analysis)
    assert "- Control points, each left out (5): " in analyzed.stdout, analyzed.stderr
    assert len(rows_of(analysis / "leave_out.csv")) == 5
    record = json.loads((analysis / "analysis.json").read_text(encoding="utf-8"))["leave_out"][0]
    assert record["degrees_of_freedom"] == 15


def test_a_project_keeps_the_sigmas_of_checkpoints(known_case: Path) -> None:
    project = known_case.with_name("P")
    for words in (("init", project, "--case", known_case), ("solve", project, "--no-figures")):
        assert call("project", *words) == 0
    whole = found(mgsgraph.adjust(mgsgraph.read_case(known_case)))
    rows = rows_of(next(project.glob("solutions/*/checkpoints.csv")))
    np.testing.assert_allclose([float(row["sigma_up_m"]) for row in rows], whole.sigmas[:, 2], rtol=1e-4)


@pytest.mark.parametrize(("name", "message"), [
    ("TIE00012", r"control.csv, point TIE00012: a checkpoint without known coordinates \(Free\); expected a Constr"),
    ("NONE", r"case.toml, checkpoints: no point 'NONE'; expected ids of points"),
])  # fmt: skip
def test_what_is_no_known_point_is_refused(known_case: Path, name: str, message: str) -> None:
    text = known_case.read_text(encoding="utf-8")
    known_case.write_text(text.replace('"TIE00003"', f'"{name}"'), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        mgsgraph.read_case(known_case)
