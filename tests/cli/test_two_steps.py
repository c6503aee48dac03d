"""`mgsgraph adjust --two-steps` as a person uses it."""

import json
import os
import subprocess
import sys
from pathlib import Path

import networks
import numpy as np
import pytest

from mgsgraph.units import DEG

REFERENCE = 3_396_190.0
"""m."""


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "mgsgraph.cli", *map(str, arguments)], capture_output=True, text=True, timeout=300,
        check=False, env=os.environ | {"COLUMNS": "110"},
    )


def add_terrain(case_file: Path) -> None:
    """The simulated relief beside the case, as a GeoTIFF."""
    rasterio = pytest.importorskip("rasterio")
    grid = networks.terrain(networks.network(networks.pair(ties=20, shots=8)))
    rows, columns = grid.radii.shape
    step = grid.longitude_step / DEG
    west, north = grid.first_longitude / DEG - 0.5 * step, grid.first_latitude / DEG + 0.5 * step
    with rasterio.open(
        case_file.with_name("terrain.tif"), "w", driver="GTiff", height=rows, width=columns, count=1, dtype="float64",
        crs=f"+proj=longlat +R={REFERENCE} +no_defs", transform=rasterio.Affine(step, 0, west, 0, -step, north),
    ) as file:
        file.write(np.asarray(grid.radii) - REFERENCE, 1)
    with case_file.open("a", encoding="utf-8") as file:
        file.write(f'\n[terrain]\nradius = "terrain.tif"\nreference_radius_m = {REFERENCE}\n')


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
    assert {f"two_steps.{kind}" for kind in ("txt", "json", "csv")} <= names
    assert {"heights.csv", "height_cells.csv", "height_map.png", "height_map.svg", "solution.npz"} <= names
    for said in ("step 1, no terrain", "step 2, terrain", "[mgon]", "forward intersection", "reduced by a factor of"):
        assert said in done.stdout
    for said in ("step 1 of 2, without terrain", "step 2 of 2, with terrain"):
        assert said in done.stdout + done.stderr
    page = (out / "two_steps.txt").read_text(encoding="utf-8")
    assert done.stdout[done.stdout.index("Points, mean sigma") :].startswith(page[page.index("Points, mean sigma") :])
    record = json.loads((out / "two_steps.json").read_text(encoding="utf-8"))
    assert record["program"] == "mgsgraph"
    assert all(one["converged"] for one in record["steps"])

    again = run("adjust", case_file, "--out", out, "--no-figures")  # one step replaces it
    assert again.returncode == 0, again.stderr
    assert not any(path.name.startswith(("two_steps", "height")) for path in out.iterdir())
