"""`mgsgraph coregister` as a person uses it: files, sentences, exit status; one line for bad input."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import dem_site
import numpy as np
import profiles as mola_profiles
import pytest
import relief_site
from commands import call, refusal, rows_of, run
from outside import refuses
from sites import plain_site

import mgsgraph
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import east_north
from mgsgraph.network import PointClass
from mgsgraph.project import relief as project_relief
from mgsgraph.project.project import open_project
from mgsgraph.registration import relief
from mgsgraph.registration.minima import (
    ReliefRegistration,
)
from mgsgraph.registration.relief_surfaces import cells_of
from mgsgraph.results.figures.relief import relief_sheets, vertical
from mgsgraph.results.figures.sheet import save
from mgsgraph.results.relief import (
    profiles_table,
    relief_shots_table,
    relief_statements,
    slopes_of,
)
from mgsgraph.simulation.demo.demonstration import (
    BY_RELIEF,
    KERNELS,
    TIES,
    disagreement_table,
    disagreements,
    overall,
)
from mgsgraph.simulation.ground import GRID_VERTICAL, grid_shift

APART = 20.0
"""m, by which images and profiles may disagree after the adjustment."""
OPTIONS = ("--search", 400, "--workers", 1)
TABLES = {
    "solution.json", "solution.npz", "points.csv", "orientation.csv", "residuals.csv", "connectivity.csv",
    "coregistration.json", "profiles.csv", "shots.csv",
}  # fmt: skip


@pytest.fixture(scope="module")
def registration() -> ReliefRegistration:
    return relief_site.registration()


# --- what is found and written


# above two seconds: a site is registered by relief once for all tests of the run
def test_images_and_profiles_agree_afterwards(registration: ReliefRegistration) -> None:
    assert registration.solution.converged
    for one in registration.profiles:
        assert one.before.cost.tied
        assert np.linalg.norm(one.before.misplacement) > 50.0
        assert np.linalg.norm(one.after.misplacement) < APART
        assert one.rms_after < 0.5 * one.rms_before


def test_disagreements_with_the_truth_come_down_to_their_sigmas(registration: ReliefRegistration) -> None:
    """As the demo tells it."""
    site, case = plain_site(), mgsgraph.read_case(relief_site.case_path())
    steps = ((KERNELS, None), (TIES, registration.before), (BY_RELIEF, registration.solution))
    found = disagreements(site, case, steps)
    assert len(disagreement_table(found)) == 12
    (_, none), (ties, of_ties), (now, predicted) = (overall(found, state) for state, _ in steps)
    assert np.isnan(none)
    assert now < 0.2 * ties
    assert predicted < 0.2 * of_ties
    assert 0.2 * predicted < now < 3.0 * predicted


def test_slopes_are_those_of_the_surface(registration: ReliefRegistration) -> None:
    """A horizontal step lowers the height above the surface by the slope."""
    one = registration.profiles[0]
    state, network = one.after, registration.solution.network
    assert network.stereo is not None
    up = state.points / np.linalg.norm(state.points, axis=1, keepdims=True)
    vertical = np.einsum("ni,ni->n", state.heights.normals, up)
    east = np.einsum("ni,ni->n", state.heights.normals, east_north(state.points)[:, 0])
    assert slopes_of(state)[:, 0] == pytest.approx(-east / vertical, rel=1e-9, abs=1e-12)


@pytest.mark.usefixtures("light_figures")
@pytest.mark.slow
def test_the_command_writes_a_result(
    registration: ReliefRegistration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Which other verbs take; figures and tables say the same; a second run takes its place."""
    relief_site.use_matches(monkeypatch)
    out, case = tmp_path / "out", relief_site.case_path()
    result = relief_site.result()
    assert call("align", result, "--case", case, "--out", out, *OPTIONS) == 0
    said = capsys.readouterr().out
    figures = {path.stem for path in out.iterdir() if path.suffix == ".png"}
    assert {"costs", "profiles_1", "profiles_2"} <= figures
    assert {path.name for path in out.iterdir() if path.suffix != ".png"} == TABLES
    record = json.loads((out / "coregistration.json").read_text(encoding="utf-8"))
    assert (record["program"], record["status"]) == ("mgsgraph", "converged")
    assert [line[2:] for line in said.splitlines() if line.startswith("- ")] == record["statements"]
    profiles = rows_of(out / "profiles.csv")
    assert [(one["profile"], one["kind"]) for one in profiles] == [("ap18933l", "shot"), ("ap19043l", "shot")]
    shots = rows_of(out / "shots.csv")
    for row, of_json in zip(profiles, record["profiles"], strict=True):
        assert np.hypot(float(row["misplacement_after_east_m"]), float(row["misplacement_after_north_m"])) < APART
        assert of_json["misplacement_before_m"][0] == float(row["misplacement_before_east_m"])
        assert sum(one["weight"] for one in of_json["minima_before"]) == pytest.approx(1.0, abs=1e-3)
        mine = [one for one in shots if one["profile"] == row["profile"] and one["on_surface"] == "true"]
        assert len(mine) == int(row["on_surface"])
        heights = np.array([float(value) for one in mine if (value := one["above_surface_after_m"])])
        assert np.sqrt(np.mean(heights**2)) == pytest.approx(float(row["rms_after_m"]))

    again = mgsgraph.read_solution(out)
    assert again.network.stereo is not None
    assert call("analyze", out) == 0
    assert call("export", out, "--to", "csm", "--out", tmp_path / "csm") == 0
    assert call("report", out, "--out", tmp_path / "report.html") == 0
    monkeypatch.setattr(relief, "register_by_relief", lambda *_, **__: registration)
    assert call("align", result, "--case", case, "--out", out, *OPTIONS, "--no-figures") == 0
    assert {path.name for path in out.iterdir()} == TABLES


def test_not_converged_is_written_and_is_exit_status_1(
    registration: ReliefRegistration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    solution = replace(registration.solution, converged=False, message="It is far away.")
    monkeypatch.setattr(relief, "register_by_relief", lambda *_, **__: replace(registration, solution=solution))
    assert call("align", relief_site.case_path(), "--out", tmp_path / "out", "--no-figures") == 1
    assert "NOT CONVERGED" in capsys.readouterr().out
    record = json.loads((tmp_path / "out" / "coregistration.json").read_text(encoding="utf-8"))
    assert record["status"] == "not converged"


def test_a_result_knows_its_case(
    registration: ReliefRegistration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """RESULT in place of RESULT --case CASE."""
    given: list[Any] = []

    def registered(case: mgsgraph.Case, *_: Any, before: Any = None, **others: Any) -> ReliefRegistration:
        given.append((case, before))
        return registration

    monkeypatch.setattr(relief, "register_by_relief", registered)
    out, again = tmp_path / "out", tmp_path / "again"
    assert call("align", relief_site.case_path(), "--out", out, "--no-figures") == 0
    assert {path.name for path in out.iterdir()} == TABLES
    assert call("align", out, "--out", again, "--no-figures") == 0
    (first, nothing), (second, before) = given
    assert nothing is None
    assert first.settings.loss == "none"
    assert second.path == relief_site.case_path().resolve()
    assert before.name == registration.solution.name
    with pytest.raises(click.UsageError, match="would replace"):
        call("align", out, "--out", out)


def test_a_project_has_the_surfaces_from_then_on(
    registration: ReliefRegistration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    project = tmp_path / "project"
    assert call("project", "init", project, "--case", relief_site.case_path()) == 0
    given: list[Any] = []

    def registered(*arguments: Any, **_: Any) -> ReliefRegistration:
        given.extend(arguments)
        return registration

    monkeypatch.setattr(project_relief, "register_by_relief", registered)
    assert call("align", project, "--no-figures", "--search", 600) == 0
    case, settings = given
    assert set(case.network.image_names) == set(settings.images)
    assert case.network.stereo is None
    assert len(case.network.points) == len(registration.solution.network.points)
    assert {path.name for path in (project / "solutions" / "0001").iterdir()} == TABLES
    with open_project(project) as opened:
        stored, made = opened.store.network(), registration.solution.network.stereo
        kept = stored.stereo
        assert kept is not None
        assert made is not None
        assert (kept.surface >= 0).sum() == (made.surface >= 0).sum() > 100
        assert opened.changes()[-1].verb == "align"
    assert call("project", "status", project) == 0
    assert "align" in capsys.readouterr().out
    with pytest.raises(click.UsageError, match="a project has its own"):
        call("align", project, "--out", tmp_path / "out")
    assert call("project", "undo", project) == 0
    with open_project(project) as opened:
        assert opened.store.network().stereo is None
    assert call("project", "redo", project) in (0, 1)  # moves of hundreds of meters: solve converges
    with open_project(project) as opened:
        again = opened.store.network()
    assert again.stereo is not None
    heights = dict(zip(again.points.ids, again.stereo.sigmas.tolist(), strict=True))
    assert heights == dict(zip(stored.points.ids, kept.sigmas.tolist(), strict=True))


@pytest.mark.slow
def test_a_project_registered_and_solved_has_the_same_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    relief_site.use_matches(monkeypatch)
    project = tmp_path / "project"
    assert call("project", "init", project, "--case", relief_site.case_path()) == 0
    assert call("align", project, "--no-figures", *OPTIONS) == 0
    assert call("project", "solve", project, "--no-figures") == 0
    first, again = (mgsgraph.read_solution(project / "solutions" / name) for name in ("0001", "0002"))
    assert again.cost_final == pytest.approx(first.cost_final, rel=1e-9)
    shifts = [dict(zip(one.network.shift_names, one.shifts, strict=True)) for one in (first, again)]
    for name, shift in shifts[0].items():
        np.testing.assert_allclose(shifts[1][name], shift, atol=1e-3)


# --- terrain models by cells


def test_posts_that_two_images_may_show_are_taken() -> None:
    """And those in a margin beside them."""
    case, posterior = mgsgraph.read_case(dem_site.case_path()), Posterior.of(relief_site.solution())
    ((model, posts),) = cells_of(case.terrain, posterior, relief_site.SETTINGS)
    assert model.name == "megr_gusev"
    assert posts.footprint == pytest.approx(4.0 / np.sqrt(12.0) * 463.0 * np.sqrt(np.cos(np.radians(14.6))), rel=0.01)
    for j in range(2):
        image = posterior.image(j)
        pixels = image.ground_to_image(posts.points, posterior.correction(j))[0]
        assert np.all((pixels > -500.0) & (pixels < np.array([image.lines, image.samples]) + 500.0))
    away = replace(model, lattice=replace(model.lattice, located=lambda *at: -model.lattice.located(*at)))
    refuses("none in two images", cells_of, (away,), posterior, relief_site.SETTINGS)


@pytest.mark.slow
@pytest.mark.parametrize("terrain", ["cells", "spline"])
def test_posts_of_the_terrain_model_lie_on_the_surface(terrain: Any, tmp_path: Path) -> None:
    """Half a thousand, by the 10 m of their noise; tie points lie no longer on its patches, unless asked for."""
    with pytest.MonkeyPatch.context() as patch:
        relief_site.use_matches(patch)
        case = mgsgraph.read_case(dem_site.case_path())
        settings = replace(relief_site.SETTINGS, terrain=terrain)
        found = mgsgraph.register_by_relief(case, settings, before=dem_site.solution())
    network, models = found.solution.network, [one for one in found.profiles if one.of_posts]
    assert found.solution.converged
    assert found.before.network.surface is not None
    assert (network.surface is None) == (terrain == "cells") == bool(models)
    for model in models:
        assert 300 < model.on_surface.sum() < model.on_surface.size
        assert model.rms_after == pytest.approx(GRID_VERTICAL, rel=0.15)
        off = model.shift + grid_shift(dem_site.site().terrain)
        assert off @ np.linalg.solve(model.covariance, off) < 13.8  # 99.9 % of chi-square with two degrees of freedom
    mgsgraph.write_coregistration(found, tmp_path / "out")
    assert len(rows_of(tmp_path / "out" / "profiles.csv")) == 2 + len(models)
    assert call("analyze", tmp_path / "out") == 0
    assert call("report", tmp_path / "out", "--out", tmp_path / "report.html") == 0


# --- sentences and tables of what is not clear


@pytest.mark.usefixtures("light_figures")
def test_profiles_that_are_not_tied_or_take_no_part(registration: ReliefRegistration, tmp_path: Path) -> None:
    """Of forty: few sentences and sheets, and no place of one that no shift suits better than others."""
    first, network = registration.profiles[0], registration.solution.network
    cost = first.before.cost
    cost = replace(cost, minima=tuple(replace(cost.minima[0], weight=0.1) for _ in range(10)))
    before, after = (one._replace(cost=cost) for one in (first.before, first.after))
    profiles = (
        *(replace(registration.profiles[k % 2], name=f"profile {k}") for k in range(38)),
        replace(first, name="plain", before=before, after=after),
        replace(first, name="aside", on_surface=np.zeros_like(first.on_surface)),
    )
    names, none = tuple(one.name for one in profiles), np.full(len(network.points), -1)
    assert network.shifts is not None
    shifts = replace(network.shifts, names=names, profile=none, sigmas=np.ones(len(names)))
    solution = replace(registration.solution, network=replace(network, shifts=shifts))
    made = replace(registration, solution=solution, profiles=profiles)
    said = relief_statements(made)
    assert len(said) < 8
    assert any("too few shots" in line and "(aside)" in line for line in said)
    table = {row["profile"]: row for row in profiles_table(made).records()}
    assert (table["plain"]["misplacement_before_m"], table["plain"]["tied"]) == ([None, None], False)
    assert table["profile 0"]["tied"]
    assert len(save(relief_sheets(made), tmp_path)) == 1 + 4


def test_differences_of_posts_are_a_map_and_a_histogram_of_all(registration: ReliefRegistration) -> None:
    """Profiles are drawn by lines that no axis cuts off; posts, which would bury them, by bars that count each."""
    posts = replace(registration.profiles[0], point_class=PointClass.POST)
    sheets = list(relief_sheets(replace(registration, profiles=(posts, registration.profiles[1]))))
    counted = [bars.get_xy() for bars in sheets[1].figure.axes[1].patches]
    for state, corners in zip((posts.after, posts.before), counted, strict=True):
        heights = vertical(state)[posts.on_surface & state.heights.covered]
        assert corners[1:-1:2, 1].sum() == heights.size
        assert corners[:, 0].min() <= heights.min() <= heights.max() <= corners[:, 0].max()
    other = registration.profiles[1]
    for state, panel in zip((other.before, other.after), sheets[2].figure.axes[2:4], strict=True):
        heights = vertical(state)[other.on_surface & state.heights.covered]
        assert panel.get_ylim()[0] < heights.min() <= heights.max() < panel.get_ylim()[1]


def test_shots_beside_the_surface_have_no_height(registration: ReliefRegistration) -> None:
    table = {column.key: column.values for column in relief_shots_table(registration).columns}
    taken = np.asarray(table["on_surface"])
    for state in ("before", "after"):
        covered = np.concatenate([getattr(one, state).heights.covered for one in registration.profiles])
        assert np.array_equal(np.isfinite(np.asarray(table[f"above_surface_{state}"])), covered)
        assert covered.sum() > 150
    assert np.array_equal(np.isfinite(np.asarray(table["sigma"])), taken)


# --- bad input


def test_what_cannot_be_registered_is_said_in_one_line(case_file: Path, tmp_path: Path) -> None:
    case, foreign = relief_site.case_path(), tmp_path / "foreign"
    text = case.read_text(encoding="utf-8")
    still, bare = (case.with_name(f"{name}.toml") for name in ("still", "bare"))  # of the same files
    still.write_text(text.replace("shift_sigma_m = 100.0", ""), encoding="utf-8")
    bare.write_text(text[: text.index("[[shots]]")], encoding="utf-8")
    foreign.mkdir()
    (foreign / "mine.txt").touch()
    result, project, out = tmp_path / "result", tmp_path / "project", ("--out", tmp_path / "out")
    assert call("adjust", case_file, "--out", result, "--no-figures") == 0
    assert call("project", "init", project) == 0
    for said, arguments in {
        "neither a laser profile nor a terrain model": (still, *out),
        "neither a laser profile": (bare, *out),
        "no pixels": (mola_profiles.with_profile(case_file), *out),
        "no such image": (case, *out, "--image", "E02-00665", "--image", "E02-00666"),
        "reach: nan m": (case, *out, "--search", "nan"),
        "none": (case, *out, "--case", "none"),
        "not a result of mgsgraph": (case, "--out", foreign),
        "other images": (result, "--case", case, *out),
        "no case that names": (project,),
        "no word of the case": (tmp_path, *out),
    }.items():
        assert said in refusal("align", *arguments)
    assert not (tmp_path / "out").exists()


def test_profiles_that_do_not_cross_the_images_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    relief_site.use_matches(monkeypatch)
    solution = relief_site.solution()
    network = solution.network
    assert network.shifts is not None
    mine = network.shifts.profile >= 0
    positions = np.array(network.points.places)
    positions[mine] += 20e3 * east_north(positions[mine])[:, 0]
    away = replace(network, points=replace(network.points, places=positions))
    with pytest.raises(InputError, match="none of 2 with 12 shots on the surface"):
        mgsgraph.register_by_relief(
            mgsgraph.read_case(relief_site.case_path()), relief_site.SETTINGS, before=replace(solution, network=away)
        )


# --- with pixels


@pytest.mark.slow
def test_the_whole_road_on_the_simulated_gusev_site(tmp_path: Path) -> None:
    """Pictures rendered, matched by least squares, registered: images and laser agree."""
    assert call("simulate", "gusev", "--out", tmp_path / "site") == 0
    done = run("align", tmp_path / "site" / "case.toml", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    for row in rows_of(tmp_path / "out" / "profiles.csv"):
        before, after = (
            np.hypot(float(row[f"misplacement_{state}_east_m"]), float(row[f"misplacement_{state}_north_m"]))
            for state in ("before", "after")
        )
        assert row["clear"] == "true"
        assert before > 50.0
        assert after < 15.0
