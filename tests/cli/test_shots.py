"""`mgsgraph shots` as a person uses it: a profile found, written, and taken by the case in place of the archive's."""

import csv
from pathlib import Path

import numpy as np
import profiles
import pytest
from commands import refused, run

import mgsgraph
from mgsgraph.cli import group
from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.project.reading import oriented_images
from mgsgraph.results.places import SELECTION


def call(*arguments: object) -> None:
    """A command in this process."""
    assert not group([str(one) for one in arguments], standalone_mode=False)


def test_a_selection_takes_the_archives_place_in_a_case(case_file: Path, tmp_path: Path) -> None:
    case = profiles.with_profile(case_file)
    found = tmp_path / "found.csv"
    done = run("shots", case.with_name("profile.csv"), "--case", case, "--image", "SIM/A", "--along", "--out", found)
    assert done.returncode == 0, done.stderr
    assert "18933 taken along" in done.stdout

    assert SELECTION.known(found)
    mine = tmp_path / "mine.csv"
    mine.write_text("years,of,work\n", encoding="utf-8")
    said = "mine.csv: exists and is not a selection of mgsgraph shots"
    refused(run("shots", case.with_name("profile.csv"), "--case", case, "--out", mine), said)
    assert mine.read_text(encoding="utf-8") == "years,of,work\n"

    before = mgsgraph.read_case(case).network
    case.write_text(case.read_text(encoding="utf-8").replace('"profile.csv"', f'"{found}"'), encoding="utf-8")
    after = mgsgraph.read_case(case).network
    assert after.ranges.values.tolist() == before.ranges.values.tolist()
    assert after.ranges.times.tolist() == before.ranges.times.tolist()

    nothing = tmp_path / "nothing.csv"
    done = run("shots", found, "--case", case, "--dates", "1999-01-01", "1999-01-02", "--out", nothing)
    assert done.returncode == 0
    assert not nothing.exists()


def test_bad_input_writes_nothing(case_file: Path, tmp_path: Path) -> None:
    case, out = profiles.with_profile(case_file), tmp_path / "found.csv"
    shots = case.with_name("profile.csv")
    refused(run("shots", tmp_path / "none.csv", "--case", case, "--out", out), "no such file")
    refused(run("shots", shots, "--case", case, "--image", "SIM/Z", "--out", out), "no image 'SIM/Z'")
    refused(run("shots", shots, "--case", case, "--dates", "1999-13-01", "1999-02-01", "--out", out), "dates")
    assert not out.exists()


@pytest.mark.parametrize("kind", ["result", "project"])
def test_results_and_projects_show_their_shots_as_adjusted(
    kind: str, case_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The profile was simulated along sample 500 of the true image A: as adjusted it falls nearer there than by the
    nominal orientation. An image is called by a part of its name that no other has.
    """
    profile, source = tmp_path / "profile.csv", tmp_path / kind
    profiles.write_profile(profile)
    if kind == "result":
        call("adjust", case_file, "--out", source, "--no-figures")
    else:
        call("init", source, "--case", case_file)
        with pytest.raises(InputError, match="without a batch solution"):
            call("shots", profile, "--case", source)
        call("solve", source, "--no-figures")
    capsys.readouterr()
    call("shots", profile, "--case", source, "--image", "/A", "--along", "--out", tmp_path / "found.csv")
    assert f"SIM/A: {profiles.SHOTS} shots of 1 profile fall in it, 18933 taken along" in capsys.readouterr().out
    with pytest.raises(InputError, match="2 images that 'SIM' may be"):
        call("shots", profile, "--case", source, "--image", "SIM")

    shots = read_shots(tmp_path / "found.csv")
    off = []
    for path in (source, case_file):
        (view,) = oriented_images(path, ("SIM/A",)).views
        samples = view.image.ground_to_image(shots.footprints, view.correction)[0][:, 1]
        off.append(float(np.abs(samples - 500.0).mean()))
    assert off[0] < 0.5 * off[1]


def test_noise_is_left_out_unless_it_is_asked_for(case_file: Path, tmp_path: Path) -> None:
    case, found = profiles.with_profile(case_file), tmp_path / "found.csv"
    call("shots", case.with_name("profile.csv"), "--case", case, "--out", found)
    with found.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows[:7]:
        row["ground"] = "0"
    with (tmp_path / "noisy.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    sizes = []
    for k, more in enumerate([(), ("--quality", "all")]):
        call("shots", tmp_path / "noisy.csv", "--case", case, *more, "--out", tmp_path / f"{k}.csv")
        sizes.append(read_shots(tmp_path / f"{k}.csv").times.size)
    assert sizes == [len(rows) - 7, len(rows)]
