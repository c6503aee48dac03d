"""The kernel as plain Python (NUMBA_DISABLE_JIT=1) and on one thread says the same as compiled."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

CODE = """
import json, warnings
import numpy as np
from networks import network, pair, with_shift_and_surface
from mgsgraph.adjustment.graph import BundleGraph, lay_out
from mgsgraph.adjustment.settings import SolverSettings
warnings.simplefilter("ignore")  # a lane that takes no part divides by zero
found = []
for line in ("predicted", "measured"):
    layout = lay_out(with_shift_and_surface(network(pair(ties=4, shots=2))), SolverSettings(line=line))
    x = 0.1 * np.random.default_rng(1).standard_normal(layout.columns) * layout.scales
    reduction = BundleGraph(layout).reduction(x)
    found.append([reduction.cost, *reduction.gradient * layout.scales])
print(json.dumps(found))
"""


def numbers(**environment: str) -> np.ndarray:
    paths = {"PYTHONPATH": str(Path(__file__).resolve().parents[1])}
    done = subprocess.run(
        [sys.executable, "-c", CODE], capture_output=True, text=True, check=True, env=os.environ | paths | environment
    )
    return np.array(json.loads(done.stdout))


@pytest.mark.parametrize("how", [{"NUMBA_DISABLE_JIT": "1"}, {"NUMBA_NUM_THREADS": "1"}], ids=["plain", "one thread"])
def test_the_same_numbers(how: dict[str, str]) -> None:
    compiled, other = numbers(), numbers(**how)
    assert np.abs(other - compiled).max() <= 1e-9 * np.abs(compiled).max()
