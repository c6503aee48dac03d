"""The plane of comparison: there and back, true lengths and areas, anywhere on the body."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.matching.scene import GroundChart

RADIUS = 3.39e6
PLACES = ((0.3, 0.2), (np.pi - 1e-4, -0.4), (-np.pi + 1e-4, 0.1), (1.0, np.pi / 2 - 1e-5), (-2.0, -np.pi / 2 + 1e-5))
"""rad: on the date line and beside both poles, too."""


def around(longitude: float, latitude: float, size: float = 2e-3) -> np.ndarray:
    """Points (n, 3) on a sphere, some kilometres about a place."""
    middle = from_planetocentric(np.array([[longitude, latitude, RADIUS]]))[0]
    points = middle + size * RADIUS * np.random.default_rng(1).uniform(-1.0, 1.0, (60, 3))
    return np.asarray(points * (RADIUS / np.linalg.norm(points, axis=1, keepdims=True)))


@pytest.mark.parametrize(("longitude", "latitude"), PLACES)
@settings(deadline=None)
@given(turn=st.floats(0.0, 6.3))
def test_there_and_back_with_true_lengths(longitude: float, latitude: float, turn: float) -> None:
    points = around(longitude, latitude)
    flight = np.array([np.cos(turn), np.sin(turn), 0.7])
    chart = GroundChart.about(points, flight)
    plane = chart.plane(points)
    back = chart.directions(plane) * RADIUS
    assert np.abs(back - points).max() < 1e-6
    assert np.abs(chart.plane(back) - plane).max() < 1e-6
    lengths = np.linalg.norm(np.diff(plane, axis=0), axis=1) / np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert np.abs(lengths - 1.0).max() < 1e-5
    np.testing.assert_allclose(chart.axes @ chart.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(chart.axes) == pytest.approx(1.0)
    ahead = chart.plane(points + 10.0 * flight / np.linalg.norm(flight)) - plane
    assert np.all(ahead[:, 1] > 0.0)  # y is along the flight
    assert np.abs(ahead[:, 0]).max() < 0.1


def test_areas_are_true_far_from_the_middle() -> None:
    """Caps of the sphere are discs of the same area (Snyder 1987, p. 182)."""
    chart = GroundChart(np.eye(3), RADIUS)
    for angle in (1e-4, 0.1, 1.0, 3.0):
        edge = np.array([[np.sin(angle), 0.0, np.cos(angle)], [0.0, np.sin(angle), np.cos(angle)]])
        size = np.linalg.norm(chart.plane(edge), axis=1)
        cap = 4.0 * np.pi * RADIUS**2 * np.sin(0.5 * angle) ** 2
        np.testing.assert_allclose(np.pi * size**2, cap, rtol=1e-12)


def test_beyond_the_antipode_is_nowhere() -> None:
    chart = GroundChart(np.eye(3), RADIUS)
    assert np.all(np.isnan(chart.directions(np.array([[2.1 * RADIUS, 0.0]]))))
