"""`mgsgraph adjust --two-steps` as a person uses it."""

import json
import re
from pathlib import Path

import networks
import numpy as np
import pytest
from click.testing import CliRunner
from commands import run

from mgsgraph.analysis import two_step_statistics
from mgsgraph.cli import group
from mgsgraph.units import DEG

REFERENCE = 3_396_190.0
"""m."""


def add_terrain(case_file: Path, east: float = 0.0, missing: float = 0.0) -> None:
    """The simulated relief beside the case, as a GeoTIFF; so many degrees off, some share of its posts missing."""
    rasterio = pytest.importorskip("rasterio")
    grid = networks.terrain(networks.network(networks.pair(ties=20, shots=8)))
    rows, columns = grid.radii.shape
    step = grid.longitude_step / DEG
    radii = np.where(np.random.default_rng(1).random((rows, columns)) < missing, np.nan, grid.radii)
    west, north = grid.first_longitude / DEG - 0.5 * step + east, grid.first_latitude / DEG + 0.5 * step
    with rasterio.open(
        case_file.with_name("terrain.tif"), "w", driver="GTiff", height=rows, width=columns, count=1, dtype="float64",
        crs=f"+proj=longlat +R={REFERENCE} +no_defs", transform=rasterio.Affine(step, 0, west, 0, -step, north),
    ) as file:
        file.write(radii - REFERENCE, 1)
    with case_file.open("a", encoding="utf-8") as file:
        file.write(f'\n[terrain]\nradius = "terrain.tif"\nreference_radius_m = {REFERENCE}\n')


@pytest.mark.slow
def test_from_a_case_to_the_page_and_the_map(case_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = run("adjust", case_file, "--two-steps", "--out", out)
    assert done.returncode == 2
    assert done.stderr.strip() == (
        f"mgsgraph: error: {case_file}: no terrain model as control; expected one to fit the block to in step 2; "
        "add [terrain]"
    )
    assert not out.exists()

    add_terrain(case_file)
    done = run("adjust", case_file, "--two-steps", "--reject", "5", "-v", "--out", out)
    assert done.returncode == 0, done.stderr
    names = {path.name for path in out.iterdir()}
    assert {f"two_steps.{kind}" for kind in ("json", "csv")} <= names
    assert {"heights.csv", "height_map_1.png", "solution.npz"} <= names
    for said in ("step 1, no terrain", "step 2, terrain", "mgon", "smaller by"):
        assert said in done.stdout
    for said in ("step 1 of 2, without terrain", "step 2 of 2, with terrain"):
        assert said in done.stdout + done.stderr
    assert "Figures of merit" in done.stdout
    record = json.loads((out / "two_steps.json").read_text(encoding="utf-8"))
    assert record["program"] == "mgsgraph"
    assert all(one["converged"] for one in record["steps"])

    again = run("adjust", case_file, "--out", out, "--no-figures")  # one step replaces it
    assert again.returncode == 0, again.stderr
    assert not any(path.name.startswith(("two_steps", "height")) for path in out.iterdir())


@pytest.mark.parametrize(("east", "missing"), [(30.0, 0.0), (0.0, 2.0)])
def test_terrain_without_points_is_told_in_a_line(
    case_file: Path, tmp_path: Path, east: float, missing: float
) -> None:
    add_terrain(case_file, east, missing)
    done = run("adjust", case_file, "--two-steps", "--no-figures", "--out", tmp_path / "out")
    assert done.returncode == 2, done.stdout
    assert done.stderr.startswith("mgsgraph: error: ")
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_terrain_without_ties_is_told_in_a_line(case_file: Path, tmp_path: Path) -> None:
    add_terrain(case_file)
    case_file.write_text(re.sub(r"\[ties\][^\[]*", "", case_file.read_text(encoding="utf-8")), encoding="utf-8")
    done = run("adjust", case_file, "--two-steps", "--no-figures", "--out", tmp_path / "out")
    assert done.returncode == 2, done.stdout
    assert done.stderr.endswith("a terrain model for a case without tie points; expected tie points to lie on it\n")
    assert done.stderr.count("\n") == 1


def test_the_solution_outlives_its_merit(
    case_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(_: object) -> None:
        raise KeyboardInterrupt

    add_terrain(case_file)
    monkeypatch.setattr(two_step_statistics, "two_step_statistics", fails)
    out = tmp_path / "out"
    told = CliRunner().invoke(group, ["adjust", str(case_file), "--two-steps", "--no-figures", "--out", str(out)])
    assert told.exit_code != 0
    assert json.loads((out / "solution.json").read_text(encoding="utf-8"))["program"] == "mgsgraph"
    assert (out / "solution.npz").exists()
    assert not (out / "two_steps.json").exists()
