"""The benchmark of GPUs runs on a bare machine, and finds the CPU's cost; the simulator stands in for the device."""

import json
import os
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mgsgraph.adjustment.batch import BundleProblem, levenberg_marquardt
from mgsgraph.adjustment.graph import BundleGraph, lay_out

pytest.importorskip("numba_cuda", reason="numba-cuda is not installed (the extra `cuda`)")
SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
BARE = """
import importlib.util, runpy, sys
found = importlib.util.find_spec
absent = ("gtsam", "threadpoolctl", "pyarrow")
importlib.util.find_spec = lambda name, *more: None if name in absent else found(name, *more)
sys.argv = sys.argv[1:]
sys.path.insert(0, sys.argv[1])
del sys.argv[1]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


@pytest.mark.slow
@pytest.mark.parametrize("line", ["measured", "predicted"])
def test_it_runs_without_gtsam_to_the_cpus_cost(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figures, page = tmp_path / "gpu.json", tmp_path / "gpu.md"
    program = [sys.executable, "-c", BARE, str(SCRIPTS / "benchmark_gpu.py"), str(SCRIPTS)]
    options = ["S", "--runs", "1", "--line", line, "--json", str(figures), "--out", str(page)]
    environment = os.environ | {"NUMBA_ENABLE_CUDASIM": "1"}
    done = subprocess.run([*program, *options], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    (found,) = json.loads(figures.read_text(encoding="utf-8"))
    monkeypatch.syspath_prepend(SCRIPTS)
    problem, _ = runpy.run_path(str(SCRIPTS / "peer_blocks.py"))["chain"](2, 40, shots=4)
    net, settings = runpy.run_path(str(SCRIPTS / "peer_problem.py"))["network"](problem, line)
    layout = lay_out(net, settings)
    start = np.zeros(layout.columns)
    outcome = levenberg_marquardt(BundleProblem(BundleGraph(layout)), start, settings, lambda _: None)
    assert found["cost"] == pytest.approx(outcome.cost_final, rel=1e-9)
    assert found["iterations"] == len(outcome.history)
    assert 0.0 < found["system"] <= found["adjusted"]
    assert f"| {found['size']} |" in page.read_text(encoding="utf-8")
