"""`mgsgraph project`: CSV in and out and single places, conventions of pixels, and what is refused."""

import csv
from pathlib import Path

import click
import numpy as np
import pytest
from commands import run

from mgsgraph.cli import group
from mgsgraph.errors import InputError

SIM = "SIM/A"


def call(*arguments: object) -> None:
    """A command in this process."""
    assert not group([str(one) for one in arguments], standalone_mode=False)


def refused(said: str, *arguments: object) -> None:
    """In one line."""
    with pytest.raises((InputError, click.UsageError)) as caught:
        call(*arguments)
    message = caught.value.format_message() if isinstance(caught.value, click.UsageError) else str(caught.value)
    assert said in message
    assert "\n" not in message


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
    call("project", case_file, SIM, "--points", ground, "--into", "image", "--out", back)
    again = rows(back)
    for name in ("isis_line", "isis_sample"):  # the header says how pixels are counted, and so does the result's
        np.testing.assert_allclose(
            [float(row[name]) for row in again[:2]], [float(row[f"given_{name}"]) for row in again[:2]], atol=1e-6
        )
    assert [row["state"] for row in again] == ["seen", "seen", "no ground"]
    refused("--into ground", "project", case_file, SIM, "--points", ground)
    before = given.read_bytes()
    refused("given.csv: exists and is not a table of mgsgraph project", "project", case_file, SIM, "--points", given,
            "--out", given)  # fmt: skip
    assert given.read_bytes() == before
    for source, into, out in ((given, "ground", ground), (ground, "image", back)):  # earlier ones are replaced
        call("project", case_file, SIM, "--points", source, "--into", into, "--out", out)


def test_single_places_and_conventions(case_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def values(*options: object) -> dict[str, str]:
        call("project", case_file, SIM, *options)
        return dict(line.split(" = ") for line in capsys.readouterr().out.splitlines())

    ours, isis = values("--pixel", 99.5, 9.5), values("--pixel", 100, 10, "--isis")
    assert ours["x_m"] == isis["x_m"]
    place = ours["longitude_deg"], ours["latitude_deg"]
    line = values("--place", *place)
    assert float(line["line"]) == pytest.approx(99.5, abs=1e-6)
    assert float(values("--place", *place, "--isis")["isis_line"]) == pytest.approx(100.0, abs=1e-6)
    assert float(values("--pixel", 99.5, 9.5, "--radius", 3.38e6)["radius_m"]) == pytest.approx(3.38e6, abs=1e-6)
    assert "sigma_line_px" not in line


def test_results_have_the_adjusted_orientation_and_sigmas(
    case_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "result"
    call("adjust", case_file, "--out", out, "--no-figures")
    capsys.readouterr()

    def shown(source: Path, *options: object) -> str:
        call("project", source, SIM, *options)
        return capsys.readouterr().out

    adjusted, nominal = (shown(source, "--pixel", 100, 20) for source in (out, case_file))
    assert "sigma_latitude_m" in adjusted
    assert adjusted.splitlines()[3] != nominal.splitlines()[3]
    given = case_file.with_name("given.csv")
    given.write_text("longitude_deg,latitude_deg\n1,2\n", encoding="utf-8")
    call("project", out, SIM, "--points", given)  # a table on the screen, words beside it
    table, words = capsys.readouterr()
    assert next(csv.DictReader(table.splitlines()))["state"]
    assert words.startswith("- 1 ground place")


WRONG = {
    "no place": ((), "--points"),
    "two ways": (("--pixel", 1, 2, "--place", 1, 2), "one of"),
    "two grounds": (("--pixel", 1, 2, "--height", 1, "--ellipsoid"), "one of"),
    "a reference of nothing": (("--pixel", 1, 2, "--reference-radius", 1), "--terrain"),
    "a latitude": (("--place", 1, 91), "91"),
    "a longitude": (("--place", 5000, -2), "5000"),
    "a latitude that is none": (("--place", 0.1, "nan"), "nan"),
    "a way for one pixel": (("--pixel", 1, 2, "--into", "ground"), "--points"),
    "a pixel that is none": (("--pixel", "nan", 2), "nan"),
    "kilometres": (("--pixel", 1, 2, "--radius", 3390), "not in km"),
    "no height": (("--pixel", 1, 2, "--height", "nan"), "finite"),
    "no such file": (("--points", "none.csv"), "none.csv"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_what_is_refused(case_file: Path, fault: str) -> None:
    options, said = WRONG[fault]
    refused(said, "project", case_file, SIM, *options)


def test_images_by_their_names(case_file: Path) -> None:
    refused("2 images", "project", case_file, "SIM", "--pixel", 1, 2)
    refused("no image", "project", case_file, "nothing", "--pixel", 1, 2)
    call("project", case_file, "/B", "--pixel", 1, 2)


def test_a_table_that_counts_otherwise_than_the_flag_is_refused(case_file: Path) -> None:
    given = case_file.with_name("given.csv")
    given.write_text("line,sample\n101,201\n", encoding="utf-8")
    refused("beside --isis", "project", case_file, SIM, "--points", given, "--isis")
    given.write_text("isis_line,isis_sample\n101,201\n", encoding="utf-8")
    call("project", case_file, SIM, "--points", given, "--isis")


def test_a_file_in_the_place_of_a_folder_is_named(case_file: Path) -> None:
    out = case_file / "x.csv"
    refused(f"({case_file} is a file)", "project", case_file, SIM, "--pixel", 1, 2, "--out", out)
    refused(f"({case_file} is a file)", "convert", case_file.with_name("network.pvl"), case_file / "n.net")
