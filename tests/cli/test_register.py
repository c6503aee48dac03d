"""`mgsgraph register` as a person uses it: files, sentences, exit status, and nothing left over after bad input."""

import json
from pathlib import Path

import profiles
import pytest
from commands import refused, run


@pytest.fixture
def mola_case(case_file: Path) -> Path:
    return profiles.with_profile(case_file)


@pytest.mark.slow
def test_before_and_after_an_adjustment(mola_case: Path, tmp_path: Path) -> None:
    result, out = tmp_path / "result", tmp_path / "registration"
    assert run("adjust", mola_case, "--out", result, "--no-figures").returncode == 0
    done = run("register", mola_case, "--solution", result, "--out", out)
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    record = json.loads((out / "registration.json").read_text(encoding="utf-8"))
    assert set(record["orientations"]) == {"nominal", "adjusted"}
    assert [line[2:] for line in done.stdout.splitlines() if line.startswith("- ")] == record["statements"]
    assert {path.suffix for path in out.iterdir()} == {".json", ".csv", ".png"}
    assert "fall in SIM/A" in done.stdout

    again = run("register", mola_case, "--out", out, "--no-figures")  # an earlier registration is replaced
    assert again.returncode == 0, again.stderr
    assert {path.suffix for path in out.iterdir()} == {".json", ".csv"}
    assert "adjusted" not in again.stdout

    names = sorted(path.name for path in result.iterdir())  # a solution isn't
    refused(run("register", mola_case, "--solution", result, "--out", result), "solution.json", result, names)
    names = sorted(path.name for path in out.iterdir())  # nor a registration by an adjustment
    refused(run("adjust", mola_case, "--out", out), "registration.json", out, names)


def test_bad_input_writes_nothing(mola_case: Path, tmp_path: Path) -> None:
    out = tmp_path / "registration"
    refused(run("register", tmp_path / "none.toml", "--out", out), "no such file", tmp_path, ["case"])
    refused(run("register", mola_case, "--solution", tmp_path, "--out", out), "solution.npz", tmp_path, ["case"])
    text = mola_case.read_text(encoding="utf-8")
    mola_case.write_text(text[: text.index("[[shots]]")], encoding="utf-8")
    refused(run("register", mola_case, "--out", out), "no laser profile", tmp_path, ["case"])
    assert not out.exists()
