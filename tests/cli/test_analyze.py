"""What a person asks of results: `mgsgraph analyze`, `report`, `project`; one line for what can't be answered."""

import csv
import hashlib
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import profiles
import pytest
import rasterio
from commands import call, refusal, rows_of, run

from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import Case
from mgsgraph.results.archive import FORMAT, read_solution
from mgsgraph.results.results import write_results

Said = Callable[..., str]


@pytest.fixture
def said_by(capsys: pytest.CaptureFixture[str]) -> Said:
    """What a command says."""

    def run(*arguments: str | float | Path) -> str:
        call(*arguments)
        return capsys.readouterr().out

    return run


@pytest.fixture
def result(pair_solution: Solution, pair_case: Case, tmp_path: Path) -> Path:
    write_results(pair_solution, tmp_path / "result", figures=False, case=pair_case.path, networks=pair_case.networks)
    return tmp_path / "result"


def test_the_summary_says_what_is_wrong_and_what_is_weak(result: Path, tmp_path: Path, said_by: Said) -> None:
    said = said_by("analyze", result, "--out", tmp_path / "analysis", "--no-figures")
    assert ": valid" in said.splitlines()[0]
    assert len(said_by("analyze", result).splitlines()) <= 10
    assert "Stated sigmas against residuals" in said_by("analyze", result, "--details")
    record = json.loads((tmp_path / "analysis" / "analysis.json").read_text(encoding="utf-8"))
    assert {"unexplained", "consistency", "reliability", "weak"} <= set(record)
    tested = (tmp_path / "analysis" / "unexplained.csv").read_text(encoding="utf-8").splitlines()
    assert len(tested) == 1 + len(record["unexplained"][0]["effects"]) > 1
    redundancy = record["reliability"][0]["redundancy"]
    assert redundancy == pytest.approx(read_solution(result).fit.degrees_of_freedom, abs=1e-4)
    table = (tmp_path / "analysis" / "reliability.csv").read_text(encoding="utf-8").splitlines()
    assert len(table) == 1 + record["reliability"][0]["measures"]
    # an earlier one goes
    again = said_by("analyze", result, "--weak", 1, "--out", tmp_path / "analysis", "--no-figures")
    assert "Stated sigmas" not in again
    assert [path.name for path in (tmp_path / "analysis").iterdir()] == ["analysis.json"]


def test_intervals_by_the_likelihood(result: Path, tmp_path: Path, said_by: Said) -> None:
    image = read_solution(result).network.images[0].name
    said = said_by("analyze", result, "--likelihood", image, "--out", tmp_path / "analysis", "--no-figures")
    assert "constant pitch" in said
    rows = json.loads((tmp_path / "analysis" / "analysis.json").read_text(encoding="utf-8"))["likelihood"][0]
    assert len(rows) == read_solution(result).coefficients[0].size
    assert all(row["low_99"] < row["low_95"] < row["value"] < row["high_95"] < row["high_99"] for row in rows)
    assert rows[0]["ratio"] == pytest.approx(1.0, abs=0.02)
    assert (tmp_path / "analysis" / "likelihood.csv").exists()


def test_questions_are_answered_in_their_order(result: Path, tmp_path: Path, said_by: Said) -> None:
    solution = read_solution(result)
    points, images = solution.network.points.ids, solution.network.image_names
    said = said_by(
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


def test_new_places_and_their_raster(result: Path, tmp_path: Path, said_by: Said) -> None:
    solution = read_solution(result)
    names = solution.network.image_names
    mine = np.flatnonzero(solution.network.rays.point == 0)
    pixels = [
        part
        for k in mine
        for part in ("--pixel", names[solution.network.rays.image[k]], *solution.network.rays.places[k].tolist())
    ]
    more = "--sigma-px", 0.5, "--raster", "--post", 500, "--out", tmp_path / "out"
    assert "New point: longitude" in said_by("analyze", result, *pixels, *more)
    with rasterio.open(tmp_path / "out" / "sigmas.tif") as file:
        assert file.count == 4
        assert np.isfinite(file.read(1)).any()


def test_a_project_answers_as_its_solution_does(case_file: Path, tmp_path: Path) -> None:
    call("project", "init", tmp_path / "project", "--case", case_file)
    assert "without a batch solution" in refusal("analyze", tmp_path / "project")
    call("project", "solve", tmp_path / "project", "--no-figures")
    solution = read_solution(tmp_path / "project" / "solutions" / "0001")
    point = solution.network.points.ids[0]
    call("analyze", tmp_path / "project", "--point", point, "--out", tmp_path / "analysis")
    record = json.loads((tmp_path / "analysis" / "analysis.json").read_text(encoding="utf-8"))
    assert np.allclose(record["answers"][0][0]["covariance_m2"], solution.covariances[0], rtol=1e-4)


def test_what_can_not_be_answered_is_said_in_one_line(result: Path, tmp_path: Path) -> None:
    image = read_solution(result).network.images[0].name
    (tmp_path / "empty").mkdir()
    for said, arguments in {
        "point nowhere: no such point": (result, "--point", "nowhere"),
        "image nowhere: no such image": (result, "--pose", "nowhere", 1.0),
        "1 measures": (result, "--pixel", image, 1.0, 1.0),
        "no --out FOLDER, for the GeoTIFF": (result, "--raster"),
        "no --raster": (result, "--post", 100.0),
        "no question": (result, "--correlations"),
        "--sigma-px: no --pixel or --raster": (result, "--sigma-px", 2.0),
        "--probability: no --point": (result, "--probability", 0.5),
        "--probability: nan": (result, "--probability", "nan", "--point", "TIE00001"),
        "--sigma-px: -1.0": (result, "--sigma-px", -1.0, "--pixel", image, 1.0, 1.0),
        "line nan": (result, "--pose", image, "nan"),
        "line 1e": (result, "--pose", image, 1e9),
        "the same point twice": (result, "--pair", "TIE00001", "TIE00001"),
        "levels, alpha": (result, "--reliability", 3, "--alpha", 0.7),
        "--alpha, --power: no --reliability": (result, "--alpha", 0.01),
        "another kind of result": (result, "--out", result),
        "no such file": (tmp_path / "nothing",),
        "neither solution.npz nor project.sqlite": (tmp_path / "empty",),
    }.items():
        assert said in refusal("analyze", *arguments)


def test_an_adjustment_that_did_not_converge_is_warned_of(result: Path, tmp_path: Path, said_by: Said) -> None:
    write_results(replace(read_solution(result), converged=False), tmp_path / "stuck", figures=False)
    assert "NOT converged" in said_by("analyze", tmp_path / "stuck", "--weak", 1)


# --- `mgsgraph report` as a person uses it: a page with checksums, a comparison, and bad input


@pytest.mark.slow
def test_a_page_of_a_result(case_file: Path, tmp_path: Path) -> None:
    mola_case = profiles.with_profile(case_file)
    result = tmp_path / "result"
    assert run("adjust", mola_case, "--out", result, "--no-figures").returncode == 0
    done = run("report", result, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    assert done.stdout.startswith("The page is report.html (")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert hashlib.sha256((result / "solution.npz").read_bytes()).hexdigest() in text

    done = run("report", result / "solution.npz", "--case", mola_case, "--compare", result, "--out",
               tmp_path / "new" / "page.html")  # fmt: skip
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "new" / "page.html").read_text(encoding="utf-8")
    assert "differs by at most 0 sigmas" in text
    assert hashlib.sha256(mola_case.read_bytes()).hexdigest() in text
    assert hashlib.sha256(mola_case.with_name("profile.csv").read_bytes()).hexdigest() in text
    assert sorted(path.name for path in result.iterdir()) == [
        "connectivity.csv", "orientation.csv", "points.csv", "residuals.csv", "solution.json", "solution.npz"
    ]  # fmt: skip

    solution, page = result / "solution.npz", ("--out", tmp_path / "p.html")
    with np.load(solution) as file:
        arrays = dict(file)
    newer = tmp_path / "newer.npz"
    np.savez(newer, **(arrays | {"format": np.array(99)}))  # type: ignore[arg-type]
    for said, arguments in {
        "'.npz'; expected a page (.html)": (result, "--out", solution),
        "solution.npz: no such file": (tmp_path, *page),
        "no such file": (result, "--compare", tmp_path, *page),
        "none.toml": (result, "--case", tmp_path / "none.toml", *page),
        "give --case, too": (result, "--ties", "net.pvl", *page),
        f"format: 99; expected {FORMAT}; read it with the version": (newer, *page),
    }.items():
        assert said in refusal("report", *arguments)
    assert not (tmp_path / "p.html").exists()


# --- `mgsgraph project`: CSV in and out and single places, conventions of pixels, and what is refused


SIM = "SIM/A"


# above two seconds: three commands one after another
def test_a_table_there_and_back_and_nothing_is_left_out(case_file: Path) -> None:
    given, ground, back = (case_file.with_name(name) for name in ("given.csv", "ground.csv", "back.csv"))
    given.write_text('note,isis_line,isis_sample\n"a, b",1,1\n,500.25,30\nfar,1e9,3\n', encoding="utf-8")
    assert "--ellipsoid" in refusal("locate", case_file, SIM, "--points", given, "--out", ground)
    done = run("locate", case_file, SIM, "--points", given, "--ellipsoid", "--out", ground)
    assert done.returncode == 0, done.stderr
    there = rows_of(ground)
    assert [row["note"] for row in there] == ["a, b", "", "far"]
    assert [row["state"] for row in there] == ["seen", "seen", "far outside the image"]
    assert there[2]["x_m"] == ""
    call("locate", case_file, SIM, "--points", ground, "--into", "image", "--out", back)
    again = rows_of(back)
    for name in ("isis_line", "isis_sample"):  # the header says how pixels are counted, and so does the result's
        np.testing.assert_allclose(
            [float(row[name]) for row in again[:2]], [float(row[f"given_{name}"]) for row in again[:2]], atol=1e-3
        )
    assert [row["state"] for row in again] == ["seen", "seen", "no ground"]
    assert "--into ground" in refusal("locate", case_file, SIM, "--points", ground)
    before = given.read_bytes()
    kept = refusal("locate", case_file, SIM, "--points", given, "--out", given)
    assert "given.csv: exists and is not a table of mgsgraph locate" in kept
    assert given.read_bytes() == before
    for source, into, out in ((given, "ground", ground), (ground, "image", back)):  # earlier ones are replaced
        call("locate", case_file, SIM, "--points", source, "--into", into, "--ellipsoid", "--out", out)


def test_single_places_and_conventions(case_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def values(*options: object) -> dict[str, str]:
        call("locate", case_file, SIM, *options, *([] if "--radius" in options else ["--ellipsoid"]))
        return dict(line.split(" = ") for line in capsys.readouterr().out.splitlines())

    ours, isis = values("--pixel", 99.5, 9.5), values("--pixel", 100, 10, "--isis")
    assert ours["x_m"] == isis["x_m"]
    place = ours["longitude_deg"], ours["latitude_deg"]
    line = values("--ground", *place)
    assert float(line["line"]) == pytest.approx(99.5, abs=1e-3)
    assert float(values("--ground", *place, "--isis")["isis_line"]) == pytest.approx(100.0, abs=1e-3)
    assert float(values("--pixel", 99.5, 9.5, "--radius", 3.38e6)["radius_m"]) == pytest.approx(3.38e6, abs=1e-6)
    assert "sigma_line_px" not in line


def test_results_have_the_adjusted_orientation_and_sigmas(
    case_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "result"
    call("adjust", case_file, "--out", out, "--no-figures")
    capsys.readouterr()

    def shown(source: Path, *options: object, way: tuple[object, ...] = ("--pixel", 100, 20)) -> dict[str, str]:
        call("locate", source, SIM, *way, *options)
        return dict(line.split(" = ") for line in capsys.readouterr().out.splitlines())

    adjusted, nominal, there = shown(out, "--ellipsoid"), shown(case_file, "--ellipsoid"), shown(out)
    assert " +- " not in nominal["latitude_deg"]
    assert [adjusted["height_from"], there["height_from"]] == ["given", "neighbors"]
    assert adjusted["longitude_deg"].split(" +- ")[0] != nominal["longitude_deg"]
    value, sigma = there["height_m"].split(" +- ")  # two digits of the sigma
    assert 1.0 < float(sigma) < 300.0
    assert len(sigma.replace(".", "").rstrip("0")) <= 2
    assert len(value.partition(".")[2]) == len(sigma.partition(".")[2])
    back = shown(out, way=("--ground", *(there[name].split(" +- ")[0] for name in ("longitude_deg", "latitude_deg"))))
    assert back["height_from"] == "neighbors"
    for name, place in (("line", 100.0), ("sample", 20.0)):
        found, spread = map(float, back[name].split(" +- "))
        assert abs(found - place) < spread
    given = case_file.with_name("given.csv")
    given.write_text("longitude_deg,latitude_deg\n1,2\n", encoding="utf-8")
    call("locate", out, SIM, "--points", given)  # a table on the screen, words beside it
    table, words = capsys.readouterr()
    assert next(csv.DictReader(table.splitlines()))["state"]
    assert words.startswith("- 1 ground place")


WRONG = {
    "no place": ((), "--points"),
    "two ways": (("--pixel", 1, 2, "--ground", 1, 2), "one of"),
    "two grounds": (("--pixel", 1, 2, "--height", 1, "--ellipsoid"), "one of"),
    "a reference of nothing": (("--pixel", 1, 2, "--reference-radius", 1), "--terrain"),
    "a latitude": (("--ground", 1, 91), "91"),
    "a longitude": (("--ground", 5000, -2), "5000"),
    "a latitude that is none": (("--ground", 0.1, "nan"), "nan"),
    "a way for one pixel": (("--pixel", 1, 2, "--into", "ground"), "--points"),
    "a pixel that is none": (("--pixel", "nan", 2), "nan"),
    "kilometres": (("--pixel", 1, 2, "--radius", 3390), "not in km"),
    "no height": (("--pixel", 1, 2, "--height", "nan"), "finite"),
    "no such file": (("--points", "none.csv"), "none.csv"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_what_is_refused(case_file: Path, fault: str) -> None:
    options, said = WRONG[fault]
    assert said in refusal("locate", case_file, SIM, *options)


def test_images_by_their_names(case_file: Path) -> None:
    assert re.search(r"2 names.* SIM/A, SIM/B", refusal("locate", case_file, "SIM", "--pixel", 1, 2))
    assert "no such image" in refusal("locate", case_file, "nothing", "--pixel", 1, 2)
    call("locate", case_file, "/B", "--pixel", 1, 2, "--ellipsoid")


def test_a_table_that_counts_otherwise_than_the_flag_is_refused(case_file: Path) -> None:
    given = case_file.with_name("given.csv")
    given.write_text("line,sample\n101,201\n", encoding="utf-8")
    assert "beside --isis" in refusal("locate", case_file, SIM, "--points", given, "--isis")
    given.write_text("isis_line,isis_sample\n101,201\n", encoding="utf-8")
    call("locate", case_file, SIM, "--points", given, "--isis", "--height", 0)


def test_a_file_in_the_place_of_a_folder_is_named(case_file: Path) -> None:
    place = "--pixel", 1, 2, "--height", 0, "--out", case_file / "x.csv"
    assert f"({case_file} is a file)" in refusal("locate", case_file, SIM, *place)
    assert f"({case_file} is a file)" in refusal("convert", case_file.with_name("network.pvl"), case_file / "n.net")
