"""Physical geometry for Hypothesis, and central differences to hold Jacobians against."""

from collections.abc import Callable

import numpy as np
from hypothesis import strategies as st

from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import Ellipsoid

MARS = Ellipsoid(3_396_190.0, 3_376_200.0)
MOON = Ellipsoid(1_737_400.0, 1_737_400.0)


def differences(function: Callable[[np.ndarray], np.ndarray], at: np.ndarray, step: np.ndarray | float) -> np.ndarray:
    """d function / d at (..., k) of a vector `at` (k,), by central differences of fourth order."""
    steps = np.broadcast_to(np.asarray(step, dtype=float), at.shape)

    def column(k: int) -> np.ndarray:
        move = np.zeros_like(at)
        move[k] = steps[k]
        near = function(at + move) - function(at - move)
        far = function(at + 2.0 * move) - function(at - 2.0 * move)
        return (8.0 * near - far) / (12.0 * steps[k])

    return np.stack([column(k) for k in range(at.size)], axis=-1)


def along(function: Callable[[float], np.ndarray], step: float) -> np.ndarray:
    """d function / dt at t = 0, by central differences of fourth order."""
    return (8.0 * (function(step) - function(-step)) - (function(2 * step) - function(-2 * step))) / (12.0 * step)


def turned(one: np.ndarray, other: np.ndarray) -> float:
    """rad, largest angle between rotations (n, 3, 3)."""
    return float(np.linalg.norm(rotation.logarithm(one @ other.mT), axis=1).max())


def _direction(longitude: float, sine: float) -> np.ndarray:
    planar = np.sqrt(1.0 - sine * sine)
    return np.array([planar * np.cos(longitude), planar * np.sin(longitude), sine])


directions = st.builds(_direction, st.floats(-np.pi, np.pi), st.floats(-1.0, 1.0))
"""(3,) unit vectors, poles included."""


def rotation_vectors(largest: float = np.pi - 1e-9) -> st.SearchStrategy[np.ndarray]:
    """(3,) rotation vectors in rad: none, 1e-7, across the change to the series, any, nearly half a turn."""
    angles = st.one_of(
        st.just(0.0), st.floats(0.0, 1e-7), st.floats(0.9e-4, 1.1e-4), st.floats(0.0, largest),
        st.floats(largest - min(1e-7, largest), largest),
    )
    return st.builds(lambda axis, angle: axis * angle, directions, angles)


latitudes = st.one_of(st.floats(-np.pi / 2, np.pi / 2), st.sampled_from([-np.pi / 2, 0.0, np.pi / 2]))
heights = st.floats(-8e3, 22e3)
"""m, from Hellas to Olympus Mons."""
orbits = st.floats(350e3, 450e3)
"""m above the ellipsoid."""


@st.composite
def opk_angles(draw: st.DrawFn) -> np.ndarray:
    """(3,) omega, phi, kappa in rad, phi up to 1e-6 rad from the poles of the angles."""
    turn = st.floats(-3.14, 3.14)
    phi = st.one_of(st.floats(-1.57, 1.57), st.sampled_from([np.pi / 2 - 1e-6, -np.pi / 2 + 1e-6, 0.0]))
    return np.array([draw(turn), draw(phi), draw(turn)])
