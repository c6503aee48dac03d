"""The kernel as plain Python (NUMBA_DISABLE_JIT=1) is dense algebra, and says the same as compiled here, on one thread
and on two.
"""

import json
import os
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mgsgraph

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
    compiled = np.array(here["found"])
    assert np.abs(np.array(other) - compiled).max() <= 1e-9 * np.abs(compiled).max()
    assert threads is None or started == threads
