"""The kernel as plain Python (NUMBA_DISABLE_JIT=1), on one thread and on two says the same as compiled here."""

import json
import os
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

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


@pytest.mark.parametrize(
    ("how", "threads"),
    [({"NUMBA_DISABLE_JIT": "1"}, None), ({"NUMBA_NUM_THREADS": "1"}, []), ({"NUMBA_NUM_THREADS": "2"}, [1, 1])],
    ids=["plain", "one thread", "two threads"],
)
def test_the_same_numbers(how: dict[str, str], threads: list[int] | None) -> None:
    """And as many threads are started as numba is told to use."""
    paths = {"PYTHONPATH": str(Path(__file__).resolve().parents[1])}
    done = subprocess.run(
        [sys.executable, "-c", ALONE], capture_output=True, text=True, check=True, env=os.environ | paths | how
    )
    other, started = json.loads(done.stdout)
    here: dict[str, Any] = {}
    with warnings.catch_warnings(action="ignore"):
        exec(CODE, here)
    compiled = np.array(here["found"])
    assert np.abs(np.array(other) - compiled).max() <= 1e-9 * np.abs(compiled).max()
    assert threads is None or started == threads
