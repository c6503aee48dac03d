"""`mgsgraph report` as a person uses it: a page with checksums, a comparison, and bad input."""

import hashlib
from pathlib import Path

import numpy as np
import profiles
import pytest
from commands import refused, run

from mgsgraph.results.archive import FORMAT


@pytest.fixture
def mola_case(case_file: Path) -> Path:
    return profiles.with_profile(case_file)


@pytest.mark.slow
def test_a_page_of_a_result(mola_case: Path, tmp_path: Path) -> None:
    result = tmp_path / "result"
    assert run("adjust", mola_case, "--out", result, "--no-figures").returncode == 0
    done = run("report", result, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    assert done.stdout == "The page is report.html\n"
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

    names = ["case", "new", "report.html", "result"]
    refused(run("report", result, "--out", result / "solution.npz"), "'.npz'; expected a page (.html)", tmp_path, names)
    refused(run("report", tmp_path, "--out", tmp_path / "p.html"), "solution.npz: no such file", tmp_path, names)
    refused(run("report", result, "--compare", tmp_path, "--out", tmp_path / "p.html"), "no such file", tmp_path, names)
    refused(run("report", result, "--case", tmp_path / "none.toml", "--out", tmp_path / "p.html"), "none.toml",
            tmp_path, names)  # fmt: skip
    refused(run("report", result, "--ties", "net.pvl", "--out", tmp_path / "p.html"), "give --case, too", tmp_path,
            names)  # fmt: skip

    with np.load(result / "solution.npz") as file:
        arrays = dict(file)
    np.savez(result / "solution.npz", **(arrays | {"format": np.array(99)}))  # type: ignore[arg-type]
    said = f"format: 99; expected {FORMAT}; read it with the version"
    refused(run("report", result, "--out", tmp_path / "p.html"), said, tmp_path, names)
