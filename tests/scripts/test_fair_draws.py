"""Errors of simulated sites have the sigmas that their cases state: a few draws of all kinds, over smooth ground."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import fair_draws  # noqa: E402
from study import chi_square_band  # noqa: E402

from mgsgraph.simulation.ground import (  # noqa: E402
    SITES,
    PeriodicSurface,
    SiteTerrain,
)
from mgsgraph.simulation.orbit import MARS  # noqa: E402
from mgsgraph.simulation.sites import SITE_NAMES  # noqa: E402

SEEDS = range(301, 307)


def smooth(name: str) -> SiteTerrain:
    ground, flat = SITES[name], PeriodicSurface(1000.0, np.zeros((1, 1), dtype=np.float32))
    return SiteTerrain(
        name, 1, MARS, ground.longitude, ground.latitude, ground, np.zeros((0, 4)), flat, flat, flat
    )


@pytest.mark.parametrize("name", SITE_NAMES)
def test_every_kind_of_error_has_its_stated_sigma(name: str) -> None:
    """Coefficients of the same power of the line together."""
    together: dict[str, list[tuple[float, int]]] = {}
    for seed in SEEDS:
        for kind, one in fair_draws.one_draw(name, seed, smooth(name))["squares"].items():
            together.setdefault(f"power {kind[-1]}" if "kernels" in kind else kind, []).append(one)
    assert len(together) == 3 + 7
    for kind, parts in together.items():
        squares, count = map(sum, zip(*parts, strict=True))
        low, high = chi_square_band(count)
        assert low < squares / count < high, kind


def test_published_errors_are_not_drawn_from_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """They have no quadratic terms."""
    monkeypatch.setattr(fair_draws, "OPTIONS", replace(fair_draws.OPTIONS, errors="published"))
    found = fair_draws.one_draw("gusev", 301, smooth("gusev"))["squares"]
    assert max(found[f"kernels, {axis} 2"][0] for axis in fair_draws.AXES) < 0.01
