"""`mgsgraph shots` as a person uses it: a profile found, written, and taken by the case in place of the archive's."""

from pathlib import Path

import profiles
from commands import refused, run

import mgsgraph


def test_a_selection_takes_the_archives_place_in_a_case(case_file: Path, tmp_path: Path) -> None:
    case = profiles.with_profile(case_file)
    found = tmp_path / "found.csv"
    done = run("shots", case.with_name("profile.csv"), "--case", case, "--image", "SIM/A", "--along", "--out", found)
    assert done.returncode == 0, done.stderr
    assert "18933 taken along" in done.stdout

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
