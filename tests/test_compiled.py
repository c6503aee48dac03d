"""Kernels: what is compiled once, by whom, and what compiled code alone calls."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mgsgraph.matching import equations

ASK = """
from mgsgraph.geometry import compiled_pose, rotation
rotation.from_matrix(__import__("numpy").eye(3))
stats = compiled_pose.quaternions.stats
print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))
"""


def test_one_process_compiles_what_several_need(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    asking = [
        subprocess.Popen([sys.executable, "-c", ASK], env=environment, stdout=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    said = sorted(one.communicate(timeout=300)[0].split() for one in asking)
    assert said == [["0", "1"], ["1", "0"], ["1", "0"]]


def test_python_is_refused_by_what_compiled_code_alone_calls() -> None:
    with pytest.raises(TypeError):
        equations.spline_at(np.zeros((9, 9), dtype=np.float32), 3.0, 3.0)
