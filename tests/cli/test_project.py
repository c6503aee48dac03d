"""`mgsgraph project`: CSV in and out and single places, conventions of pixels, and what is refused."""

import csv
from pathlib import Path

import numpy as np
import pytest
from commands import refused, run

SIM = "SIM/A"


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_a_table_there_and_back_and_nothing_is_left_out(case_file: Path) -> None:
    given, ground, back = (case_file.with_name(name) for name in ("given.csv", "ground.csv", "back.csv"))
    given.write_text('note,isis_line,isis_sample\n"a, b",1,1\n,500.25,30\nfar,1e9,3\n', encoding="utf-8")
    done = run("project", case_file, SIM, "--points", given, "--out", ground)
    assert done.returncode == 0, done.stderr
    there = rows(ground)
    assert [row["note"] for row in there] == ["a, b", "", "far"]
    assert [row["state"] for row in there] == ["seen", "seen", "far outside the image"]
    assert there[2]["x_m"] == ""
    assert run("project", case_file, SIM, "--points", ground, "--image", "--out", back).returncode == 0
    again = rows(back)
    for name in ("isis_line", "isis_sample"):  # the header says how pixels are counted, and so does the result's
        np.testing.assert_allclose(
            [float(row[name]) for row in again[:2]], [float(row[f"given_{name}"]) for row in again[:2]], atol=1e-6
        )
    assert [row["state"] for row in again] == ["seen", "seen", "no ground"]
    both = run("project", case_file, SIM, "--points", ground)
    refused(both, "--ground")


def test_single_places_and_conventions(case_file: Path) -> None:
    def values(*options: object) -> dict[str, str]:
        done = run("project", case_file, SIM, *options)
        assert done.returncode == 0, done.stderr
        return dict(line.split(" = ") for line in done.stdout.splitlines())

    ours, isis = values("--pixel", 99.5, 9.5), values("--pixel", 100, 10, "--isis")
    assert ours["x_m"] == isis["x_m"]
    place = ours["longitude_deg"], ours["latitude_deg"]
    line = values("--place", *place)
    assert float(line["line"]) == pytest.approx(99.5, abs=1e-6)
    assert float(values("--place", *place, "--isis")["isis_line"]) == pytest.approx(100.0, abs=1e-6)
    assert float(values("--pixel", 99.5, 9.5, "--radius", 3.38e6)["radius_m"]) == pytest.approx(3.38e6, abs=1e-6)
    assert "sigma_line_px" not in line


def test_results_have_the_adjusted_orientation_and_sigmas(case_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "result"
    assert run("adjust", case_file, "--out", out, "--no-figures").returncode == 0
    adjusted, nominal = (run("project", source, SIM, "--pixel", 100, 20).stdout for source in (out, case_file))
    assert "sigma_latitude_m" in adjusted
    assert adjusted.splitlines()[3] != nominal.splitlines()[3]
    given = case_file.with_name("given.csv")
    given.write_text("longitude_deg,latitude_deg\n1,2\n", encoding="utf-8")
    shown = run("project", out, SIM, "--points", given)  # a table on the screen, words beside it
    assert next(csv.DictReader(shown.stdout.splitlines()))["state"]
    assert shown.stderr.startswith("- 1 ground place")


WRONG = {
    "no place": ((), "--points"),
    "two ways": (("--pixel", 1, 2, "--place", 1, 2), "one of"),
    "two grounds": (("--pixel", 1, 2, "--height", 1, "--ellipsoid"), "one of"),
    "a reference of nothing": (("--pixel", 1, 2, "--reference-radius", 1), "--terrain"),
    "a latitude": (("--place", 1, 91), "91"),
    "no such file": (("--points", "none.csv"), "none.csv"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_what_is_refused(case_file: Path, fault: str) -> None:
    options, said = WRONG[fault]
    refused(run("project", case_file, SIM, *options), said)


@pytest.mark.parametrize(("name", "said"), [("SIM", "2 images"), ("nothing", "no image")])
def test_images_by_their_names(case_file: Path, name: str, said: str) -> None:
    refused(run("project", case_file, name, "--pixel", 1, 2), said)
    assert run("project", case_file, "/B", "--pixel", 1, 2).returncode == 0
