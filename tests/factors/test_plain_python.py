"""The kernel as plain Python (NUMBA_DISABLE_JIT=1) is dense algebra, and says the same as compiled here, on one thread
and on two; compiled kernels are kept, but never among installed packages.
"""

import json
import os
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mgsgraph
from mgsgraph import compiled
from mgsgraph.compiled import find_a_place_for_compiled_kernels, find_a_place_for_fonts

CODE = """
import numpy as np
from networks import network, pair, with_shift_and_surface
from mgsgraph.adjustment.graph import BundleGraph, lay_out
from mgsgraph.adjustment.settings import SolverSettings
found = []
for line in ("predicted", "measured"):
    layout = lay_out(with_shift_and_surface(network(pair(ties=4, shots=2))), SolverSettings(line=line))
    x = 0.1 * np.random.default_rng(1).standard_normal(layout.columns) * layout.scales
    reduction = BundleGraph(layout).reduction(x)
    found.append([reduction.cost, *reduction.gradient * layout.scales])
"""
ALONE = f"""
import json, warnings
from mgsgraph.kernel import sweep
warnings.simplefilter("ignore")  # a lane that takes no part divides by zero
sweep._WORTHWHILE, started, threads = 1.0, [], sweep._threads
sweep._threads = lambda count: started.append(count) or threads(count)
{CODE}
print(json.dumps([found, started]))
"""

DENSE = """
import warnings
import numpy as np
from networks import network, pair, with_shift_and_surface
from explicit_form import assert_bundle_is_explicit, of_layout
from mgsgraph.adjustment.graph import lay_out
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.kernel.sweep import reduce
from mgsgraph.kernel.rows import partition
from mgsgraph.kernel.sweep import SYSTEM
warnings.simplefilter("ignore")
for line, share in (("measured", 1e-11), ("predicted", 1e-8)):
    layout = lay_out(with_shift_and_surface(network(pair(ties=4, shots=2))), SolverSettings(line=line))
    system = of_layout(layout)
    x = np.random.default_rng(3).standard_normal(system.columns) * system.sigmas
    whole, parts = assert_bundle_is_explicit(system, x, share), len(layout.rows.piece)
    assert parts > 1
    found = np.zeros(system.columns)
    for k in range(parts):
        first, count = layout.rows.piece[k, 1:3].tolist()
        rows, points = partition(layout.rows, k, k + 1), whole.points[first : first + count]
        found += reduce(rows, system.groups, system.blocks.target, system.model, x, SYSTEM, points).gradient
    unit = np.abs(whole.gradient * system.sigmas).max()
    np.testing.assert_allclose(found * system.sigmas, whole.gradient * system.sigmas, rtol=0.0, atol=1e-6 * unit)
"""


def alone(code: str, how: dict[str, str]) -> str:
    """What a process of its own prints, with the package that is tested here."""
    paths = Path(__file__).resolve().parents[1], Path(mgsgraph.__file__).parents[1]
    known = {"PYTHONPATH": os.pathsep.join(map(str, paths))}
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, capture_output=True, text=True, env=os.environ | known | how, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_kernel_is_dense_algebra_of_the_explicit_factors() -> None:
    """Also by parts of its points. The whole kernel as Python, for 4 s: six points, both forms of the line."""
    alone(DENSE, {"NUMBA_DISABLE_JIT": "1"})


@pytest.mark.parametrize(
    ("how", "threads"),
    [({"NUMBA_DISABLE_JIT": "1"}, None), ({"NUMBA_NUM_THREADS": "1"}, []), ({"NUMBA_NUM_THREADS": "2"}, [1, 1])],
    ids=["plain", "one thread", "two threads"],
)
def test_the_same_numbers(how: dict[str, str], threads: list[int] | None) -> None:
    """And as many threads are started as numba is told to use. Processes of their own take 3 s to import and load."""
    other, started = json.loads(alone(ALONE, how))
    here: dict[str, Any] = {}
    with warnings.catch_warnings(action="ignore"):
        exec(CODE, here)
    mine = np.array(here["found"])
    assert np.abs(np.array(other) - mine).max() <= 1e-9 * np.abs(mine).max()
    assert threads is None or started == threads


# --- where compiled kernels are kept


def place_of(package: Path, monkeypatch: pytest.MonkeyPatch, caches: Path) -> str | None:
    unset(monkeypatch, "NUMBA_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(caches))
    find_a_place_for_compiled_kernels(package)
    return os.environ.get("NUMBA_CACHE_DIR")


def unset(monkeypatch: pytest.MonkeyPatch, variable: str) -> None:
    """Until the test ends; set before, for `delenv` keeps nothing in mind of what isn't there. Of a cache that stayed
    set, processes of later tests would compile everything anew, for minutes.
    """
    monkeypatch.setenv(variable, "")
    monkeypatch.delenv(variable)


def test_place_of_kernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checkout, installed = tmp_path / "mgsgraph" / "factors", tmp_path / "site-packages" / "mgsgraph" / "factors"
    for folder in (checkout, installed):
        folder.mkdir(parents=True)
    assert place_of(checkout, monkeypatch, tmp_path / "caches") is None
    assert place_of(installed, monkeypatch, tmp_path / "caches") == str(tmp_path / "caches" / "mgsgraph")
    (tmp_path / "file").write_text("")
    found = place_of(installed, monkeypatch, tmp_path / "file")
    assert found is not None
    assert "mgsgraph-kernels" in found
    monkeypatch.setenv("NUMBA_CACHE_DIR", "the user's own choice")
    find_a_place_for_compiled_kernels(installed)
    assert os.environ["NUMBA_CACHE_DIR"] == "the user's own choice"


def test_a_folder_that_somebody_else_has_made_is_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What lies in it would be run."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    planted = tmp_path / f"mgsgraph-kernels-{os.getuid()}"
    planted.mkdir()
    planted.chmod(0o777)
    (tmp_path / "file").write_text("")
    compiled._temporary_caches.cache_clear()
    installed = tmp_path / "site-packages" / "mgsgraph"
    found = place_of(installed, monkeypatch, tmp_path / "file")
    assert found is not None
    assert Path(found) != planted
    assert Path(found).stat().st_mode & 0o777 == 0o700
    compiled._temporary_caches.cache_clear()
    planted.chmod(0o700)
    assert place_of(installed, monkeypatch, tmp_path / "file") == str(planted)
    compiled._temporary_caches.cache_clear()


def test_matplotlib_has_a_place_where_home_is_read_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    (tmp_path / "file").write_text("")
    compiled._temporary_caches.cache_clear()
    for variable in ("XDG_CACHE_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.setenv(variable, str(tmp_path / "fine"))
    unset(monkeypatch, "MPLCONFIGDIR")
    find_a_place_for_fonts()
    assert "MPLCONFIGDIR" not in os.environ
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "file" / "config"))
    find_a_place_for_fonts()
    found = os.environ["MPLCONFIGDIR"]
    assert Path(found).parent.parent == tmp_path
    compiled._temporary_caches.cache_clear()
