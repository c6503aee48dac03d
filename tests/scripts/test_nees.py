"""The NEES of drawn networks: a few draws of a site without terrain, of a strip and of a rig lie in their bands."""

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


@pytest.mark.parametrize(
    ("case", "absent"),
    [
        ("isidis, no-terrain", ["passes"]),
        ("HRSC strip, passes", ["orientation", "shifts", "likelihood ratio", "laser"]),
        ("NAC pair, rig", ["orientation"]),
    ],
)
def test_normalized_errors_lie_in_their_bands(case: str, absent: list[str]) -> None:
    every = [nees.one_draw(case, seed) for seed in range(20)]
    assert all(draw["converged"] for draw in every)
    values = np.array([draw["values"] for draw in every])
    there = [k for k, name in enumerate(nees.COLUMNS) if name not in absent]
    assert [name for name, column in zip(nees.COLUMNS, values.T, strict=True) if np.isnan(column).all()] == absent
    for k in there:
        low, high = nees_band(values[:, k].tolist(), every[0]["degrees"][k])
        assert low < np.mean(values[:, k]) < high
    means = values[:, there].mean(axis=0)
    assert means.min() > 0.5  # bands of points scale with what they judge
    assert means.max() < 1.8
    assert "**outside**" not in nees.row(case, every)
