"""Kernels: what is compiled once, by whom, and what compiled code alone calls."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba.core.errors import TypingError

from mgsgraph.compiled import cached_kernel
from mgsgraph.matching import equations

ASK = """
import numba  # else it runs as plain Python, for so few matrices
from mgsgraph.geometry import compiled_pose, rotation
rotation.from_matrix(__import__("numpy").eye(3))
stats = compiled_pose.quaternions.stats
print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))
"""


FEW = """
import pickle
import sys
import numpy as np
from mgsgraph.geometry import compiled_pose, rotation
assert pickle.loads(pickle.dumps(compiled_pose.quaternions)) is compiled_pose.quaternions
matrices = np.linalg.qr(np.random.default_rng(1).normal(size=(400, 3, 3)))[0]
matrices *= np.linalg.det(matrices)[:, None, None]
first, second = rotation.from_matrix(matrices), rotation.from_matrix(matrices)
assert "numba" not in sys.modules
assert np.isnan(rotation.from_matrix(np.full((1, 3, 3), np.inf))).all()
third = rotation.from_matrix(matrices)
assert compiled_pose.quaternions.signatures
print("numba" in sys.modules, np.array_equal(first, second), 1e-15 > np.abs(first - third).max())
"""


def test_the_first_few_items_of_a_process_need_no_compiler() -> None:
    """More than a thousand in all do; results differ by rounding, and nothing is a warning in either."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-W", "error", "-c", FEW], env=environment, capture_output=True, text=True)
    assert done.stdout.split() == ["True", "True", "True"], done.stderr


def test_one_process_compiles_what_several_need(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    asking = [
        subprocess.Popen([sys.executable, "-c", ASK], env=environment, stdout=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    said = sorted(one.communicate(timeout=300)[0].split() for one in asking)
    assert said == [["0", "1"], ["1", "0"], ["1", "0"]]
    (stored,) = tmp_path.rglob("*.nbc")
    (_, _, (code, bitcode)), *_ = pickle.loads(stored.read_bytes())
    assert len(bitcode) < 2000 < len(code)  # the latter alone is needed


THREADS = """
from concurrent.futures import ThreadPoolExecutor
from mgsgraph.kernel.measurements import place_of_loop, range_rows
with ThreadPoolExecutor(8) as pool:
    print(len(set(pool.map(place_of_loop.__wrapped__, [range_rows] * 8))))
"""


def test_threads_that_need_a_kernel_at_once_find_the_same(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", THREADS], env=environment, capture_output=True, text=True)
    assert done.stdout.split() == ["1"], done.stderr


@cached_kernel
def inner(value):
    """Twice a number."""
    return 2.0 * value


@cached_kernel
def outer(value):
    """Four times a number."""
    return inner(inner(value))


def test_kernels_do_not_call_each_other() -> None:
    """They are cached without what a caller would need."""
    assert inner(1.0) == 2.0
    with pytest.raises(TypingError, match="inner"):
        outer(1.0)


def test_python_is_refused_by_what_compiled_code_alone_calls() -> None:
    with pytest.raises(TypeError):
        equations.spline_at(np.zeros((9, 9), dtype=np.float32), 3.0, 3.0)
