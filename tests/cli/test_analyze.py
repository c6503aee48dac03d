"""`mgsgraph analyze` as a person uses it: questions, summary, files, and one line for what can't be answered."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio

from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import Case
from mgsgraph.cli import group
from mgsgraph.errors import InputError
from mgsgraph.results.archive import read_solution
from mgsgraph.results.results import write_results

Called = Callable[..., str]


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Called:
    def run(*arguments: str | float | Path) -> str:
        group([str(one) for one in arguments], standalone_mode=False)
        return capsys.readouterr().out

    return run


@pytest.fixture
def result(pair_solution: Solution, pair_case: Case, tmp_path: Path) -> Path:
    write_results(pair_solution, tmp_path / "result", figures=False, case=pair_case.path, networks=pair_case.networks)
    return tmp_path / "result"


def test_the_summary_says_what_is_wrong_and_what_is_weak(result: Path, tmp_path: Path, call: Called) -> None:
    said = call("analyze", result, "--out", tmp_path / "analysis", "--no-figures")
    for words in ("Global test", "tie image points", "Nothing controls", "Least-constrained directions"):
        assert words in said
    record = json.loads((tmp_path / "analysis" / "analysis.json").read_text(encoding="utf-8"))
    assert {"unexplained", "honesty", "reliability", "weak"} <= set(record)
    tested = (tmp_path / "analysis" / "unexplained.csv").read_text(encoding="utf-8").splitlines()
    assert len(tested) == 1 + len(record["unexplained"][0]["effects"]) > 1
    redundancy = record["reliability"][0]["redundancy"]
    assert redundancy == pytest.approx(record["honesty"][0]["global_test"]["degrees_of_freedom"], abs=1e-4)
    assert redundancy == pytest.approx(read_solution(result).fit.degrees_of_freedom, abs=1e-4)
    table = (tmp_path / "analysis" / "reliability.csv").read_text(encoding="utf-8").splitlines()
    assert len(table) == 1 + record["reliability"][0]["measures"]
    again = call("analyze", result, "--weak", 1, "--out", tmp_path / "analysis", "--no-figures")  # an earlier one goes
    assert "Global test" not in again
    assert [path.name for path in (tmp_path / "analysis").iterdir()] == ["analysis.json"]


def test_intervals_by_the_likelihood(result: Path, tmp_path: Path, call: Called) -> None:
    image = read_solution(result).network.images[0].name
    said = call("analyze", result, "--likelihood", image, "--out", tmp_path / "analysis", "--no-figures")
    assert "constant pitch" in said
    rows = json.loads((tmp_path / "analysis" / "analysis.json").read_text(encoding="utf-8"))["likelihood"][0]
    assert len(rows) == read_solution(result).coefficients[0].size
    assert all(row["low_99"] < row["low_95"] < row["value"] < row["high_95"] < row["high_99"] for row in rows)
    assert rows[0]["ratio"] == pytest.approx(1.0, abs=0.02)
    assert (tmp_path / "analysis" / "likelihood.csv").exists()


def test_questions_are_answered_in_their_order(result: Path, tmp_path: Path, call: Called) -> None:
    solution = read_solution(result)
    points, images = solution.network.points.ids, [image.name for image in solution.network.images]
    said = call(
        "analyze", result, "--point", points[0], "--pair", points[0], points[1], "--pose", images[0], 10.0,
        "--pose", images[1], 20.0, "--projection", points[0], images[1], "--correlations",
        "--curve", images[1], "--out", tmp_path / "analysis",
    )  # fmt: skip
    parts = (f"Point {points[0]}", f"{points[1]} lies", "at line 10:", "Correlations of")
    places = [said.index(part) for part in parts]
    assert places == sorted(places)
    record = json.loads((tmp_path / "analysis" / "analysis.json").read_text(encoding="utf-8"))
    found = {answer["question"]: answer for answer in record["answers"][0]}
    assert np.allclose(found["point"]["covariance_m2"], solution.covariances[0], rtol=1e-5)
    assert {path.suffix for path in (tmp_path / "analysis").iterdir()} == {".json", ".csv"}


def test_new_places_and_their_raster(result: Path, tmp_path: Path, call: Called) -> None:
    solution = read_solution(result)
    names = [image.name for image in solution.network.images]
    mine = np.flatnonzero(solution.network.rays.point == 0)
    pixels = [
        part
        for k in mine
        for part in ("--pixel", names[solution.network.rays.image[k]], *solution.network.rays.places[k].tolist())
    ]
    said = call("analyze", result, *pixels, "--sigma-px", 0.5, "--raster", "--cell-m", 500, "--out", tmp_path / "out")
    assert "New point: longitude" in said
    with rasterio.open(tmp_path / "out" / "sigmas.tif") as file:
        assert file.count == 4
        assert np.isfinite(file.read(1)).any()


def test_a_project_answers_as_its_solution_does(case_file: Path, tmp_path: Path, call: Called) -> None:
    call("init", tmp_path / "project", "--case", case_file)
    with pytest.raises(InputError, match=r"a project without a solution.*mgsgraph solve"):
        call("analyze", tmp_path / "project")
    call("solve", tmp_path / "project", "--no-figures")
    solution = read_solution(tmp_path / "project" / "solutions" / "0001")
    point = solution.network.points.ids[0]
    call("analyze", tmp_path / "project", "--point", point, "--out", tmp_path / "analysis")
    record = json.loads((tmp_path / "analysis" / "analysis.json").read_text(encoding="utf-8"))
    assert np.allclose(record["answers"][0][0]["covariance_m2"], solution.covariances[0], rtol=1e-4)


def test_what_can_not_be_answered_is_said_in_one_line(result: Path, tmp_path: Path, call: Called) -> None:
    image = read_solution(result).network.images[0].name
    for said, arguments in {
        "point nowhere: no such point": ("--point", "nowhere"),
        "image nowhere: no such image": ("--pose", "nowhere", 1.0),
        "1 measures": ("--pixel", image, 1.0, 1.0),
        "no --out FOLDER, for the GeoTIFF": ("--raster",),
        "no --raster": ("--cell-m", 100.0),
        "no question": ("--correlations",),
        "--sigma-px: no --pixel or --raster": ("--sigma-px", 2.0),
        "--probability: no --point": ("--probability", 0.5),
        "--probability: nan": ("--probability", "nan", "--point", "TIE00001"),
        "--sigma-px: -1.0": ("--sigma-px", -1.0, "--pixel", image, 1.0, 1.0),
        "line nan": ("--pose", image, "nan"),
        "line -1": ("--pose", image, -1.0),
        "line 1e": ("--pose", image, 1e9),
        "the same point twice": ("--pair", "TIE00001", "TIE00001"),
        "levels, alpha": ("--alpha", 0.7),
    }.items():
        with pytest.raises(InputError, match=said) as caught:
            call("analyze", result, *arguments)
        assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="another kind of result"):
        call("analyze", result, "--out", result)
    with pytest.raises(InputError, match="no such file"):
        call("analyze", tmp_path / "nothing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"neither solution.npz nor project.sqlite"):
        call("analyze", tmp_path / "empty")


def test_an_adjustment_that_did_not_converge_is_warned_of(result: Path, tmp_path: Path, call: Called) -> None:
    from dataclasses import replace

    write_results(replace(read_solution(result), converged=False), tmp_path / "stuck", figures=False)
    assert "NOT converged" in call("analyze", tmp_path / "stuck", "--weak", 1)
