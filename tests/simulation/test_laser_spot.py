"""Mean range over a laser spot: planes leave it as it is, a paraboloid shifts it by its mean height."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mgsgraph.geometry.records import Array
from mgsgraph.simulation.site import ranges_over_spots

HIGH, SIGMA = 400e3, 42.0
"""m, of the spacecraft; standard deviation of the energy on the ground."""


class Ground:
    """z = height(x, y) in place of Mars; rays go down."""

    def __init__(self, height: Callable[[Array, Array], Array]) -> None:
        self.height = height

    def intersect(self, origins: Array, directions: Array) -> Array:
        unit = directions / -directions[:, 2:]
        along = origins[:, 2].copy()
        for _ in range(60):
            points = origins + along[:, None] * unit
            along += points[:, 2] - self.height(points[:, 0], points[:, 1])
        return np.asarray(origins + along[:, None] * unit)


def measured(height: Callable[[Array, Array], Array], tilt: float = 0.0) -> tuple[float, float]:
    """Mean range and spread, of a beam that meets (0, 0, height there) and is tilted towards +X (rad)."""
    beam = np.array([[np.sin(tilt), 0.0, -np.cos(tilt)]])
    top = np.array([[0.0, 0.0, float(height(np.zeros(1), np.zeros(1))[0])]])
    ground: Any = Ground(height)
    mean, spread = ranges_over_spots(ground, top - HIGH * beam, beam)
    return float(mean[0]), float(spread[0])


@pytest.mark.parametrize("slope", [0.0, 0.1, 0.4])
@pytest.mark.parametrize("tilt", [0.0, 0.35])
def test_a_plane_is_ranged_at_its_middle(slope: float, tilt: float) -> None:
    mean, spread = measured(lambda x, y: 30.0 + slope * (0.6 * x + 0.8 * y), tilt)
    assert mean == pytest.approx(HIGH, abs=0.02)  # rays beside the axis are 5 mm longer
    if not tilt:
        assert spread == pytest.approx(slope * SIGMA, abs=0.1)


@pytest.mark.parametrize("radius", [500.0, -900.0])
def test_a_paraboloid_is_ranged_at_its_mean_height(radius: float) -> None:
    mean, _ = measured(lambda x, y: (x**2 + y**2) / (2.0 * radius))
    assert mean == pytest.approx(HIGH - SIGMA**2 / radius + SIGMA**2 / HIGH, abs=1e-3)


def test_a_saddle_and_a_twist_cancel() -> None:
    for height in (lambda x, y: (x**2 - y**2) / 500.0, lambda x, y: x * y / 300.0):
        assert measured(height)[0] == pytest.approx(HIGH, abs=0.01)
