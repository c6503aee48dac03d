"""The NEES of drawn networks: a few draws without terrain lie in their bands."""

import sys
from pathlib import Path

import numpy as np
import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import nees  # noqa: E402
from study import nees_band  # noqa: E402


def test_normalized_errors_without_terrain_lie_in_their_band() -> None:
    every = [nees.one_draw("isidis, no-terrain", seed) for seed in range(10)]
    assert all(draw["converged"] for draw in every)
    values = np.array([draw["values"] for draw in every])
    for column, degrees in zip(values.T.tolist(), every[0]["degrees"], strict=True):
        low, high = nees_band(column, degrees)
        assert low < np.mean(column) < high
    means = values.mean(axis=0)
    assert means.min() > 0.5  # bands of points scale with what they judge
    assert means.max() < 1.8
    assert "**outside**" not in nees.row("isidis, no-terrain", every)
