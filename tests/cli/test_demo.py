"""`mgsgraph demo` and `mgsgraph simulate` as a person uses them, in processes of their own."""

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from commands import refused, run, run_afresh

from mgsgraph.simulation.demo.demonstration import STAGES

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """A site with its figures, in an interpreter of its own, and what it said."""
    out = tmp_path_factory.mktemp("site") / "demo"
    done = run_afresh("demo", "isidis", "--out", out)
    assert done.returncode == 0, done.stderr
    return out, done


def test_a_site_with_figures(demo: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    out, done = demo
    said = [line for line in done.stderr.splitlines() if line]
    assert not said or said == [line for line in said if "compiling" in line]
    for word in ("Put in", "Truth", "sigma0", "registration by relief"):
        assert word in done.stdout
    names = {path.name for path in out.iterdir()}
    assert {"summary.json", "solution.json", "registration.json", "points.csv", "discrepancy.csv"} <= names
    assert {"disagreement.csv", "coregistration.json", "profiles.csv", "costs.png"} <= names
    assert {"overlay_1.png", "discrepancy.png", "orientation.png", "map.png"} <= names
    assert {"case.toml", "truth.json", "network.pvl", "mgs.tm"} <= {path.name for path in (out / "inputs").iterdir()}
    record = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert tuple(record["seconds"]) == STAGES
    assert record["converged"]
    sizes = {state: _overall(record, state) for state in ("kernels", "ties and ranges", "relief")}
    assert sizes["relief"] < 0.2 * min(sizes["kernels"], sizes["ties and ranges"])
    assert sizes["relief"] < 30.0
    assert [path.name for path in out.parent.iterdir()] == ["demo"]


def _overall(record: dict[str, Any], state: str) -> float:
    """m, largest rms disagreement of laser and images in one state."""
    return max(one["rms_m"] for one in record["disagreement"] if one["state"] == state)


def test_results_can_be_registered_and_replaced(
    demo: tuple[Path, subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    """The inputs beside the results serve the other verbs; a second run takes the place of the first."""
    out = tmp_path / "demo"
    shutil.copytree(demo[0], out)
    done = run(
        "register", out / "inputs" / "case.toml", "--solution", out, "--out", tmp_path / "again", "--no-figures"
    )
    assert done.returncode == 0, done.stderr
    again, first = (
        json.loads((folder / "registration.json").read_text(encoding="utf-8")) for folder in (tmp_path / "again", out)
    )
    assert again["statements"] == first["statements"]
    assert "unfinished" not in json.dumps(first)
    assert b"unfinished" not in (out / "solution.npz").read_bytes()
    assert (out / first["orientations"]["nominal"][0]["source"]).is_file()
    assert run("demo", "pair", "--out", out, "--no-figures").returncode == 0
    assert not (out / "summary.json").exists()
    assert not list(out.glob("*.png"))


def test_the_pair(tmp_path: Path) -> None:
    done = run("demo", "pair", "--out", tmp_path / "demo", "--no-figures", "--seed", "2")
    assert done.returncode == 0, done.stderr
    assert "Truth, orientation: NEES" in done.stdout
    assert (tmp_path / "demo" / "inputs" / "lidar.json").is_file()


@pytest.mark.parametrize(
    ("verb", "choices"), [("demo", "isidis or pair"), ("simulate", "isidis, pair, strip, three-sites or archive")]
)
def test_unknown_sites_are_one_line_with_the_choices(verb: str, choices: str, tmp_path: Path) -> None:
    refused(run(verb, "olympus", "--out", tmp_path / "x"), f"'olympus'; expected eos, gusev, {choices}")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("site", ["isidis", "pair"])
def test_simulate_gives_the_same_bytes_for_the_same_seed(site: str, tmp_path: Path) -> None:
    for name, seed in (("one", 4), ("two", 4), ("three", 5)):
        done = run("simulate", site, "--out", tmp_path / name, "--seed", str(seed), "--no-pictures")
        assert done.returncode == 0, done.stderr
        assert str(tmp_path / name / "case.toml") in done.stdout
        assert not done.stderr
    one, two, three = (
        {path.name: path.read_bytes() for path in (tmp_path / name).iterdir()} for name in ("one", "two", "three")
    )
    assert one == two
    assert one["truth.json"] != three["truth.json"]


def test_simulate_renders(tmp_path: Path) -> None:
    done = run("simulate", "isidis", "--out", tmp_path / "x")
    assert done.returncode == 0, done.stderr
    assert len(set((tmp_path / "x" / "E0202016.img").read_bytes()[-100_000:])) > 50


def test_simulate_replaces_nothing(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work", encoding="utf-8")
    refused(run("simulate", "pair", "--out", tmp_path), "choose another --out")
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]
