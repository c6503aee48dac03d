"""The public factors, one by one: their derivatives against differences, what they measure, and what they refuse."""

from collections.abc import Callable
from typing import Any

import gtsam
import numpy as np
import pytest
from explicit_form import assert_jacobians
from gtsam.symbol_shorthand import L, S, X
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import network, pair, terrain

from mgsgraph import factors
from mgsgraph.errors import InputError, PointBehindCamera
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.orientation import OrientationCorrection

MODELS = [(line, angles) for line in ("predicted", "measured") for angles in ("camera", "opk-paper", "opk-peer")]
STEPS = {X(0): np.tile(np.repeat([1.0, 1e-5], 3), 3), L(0): np.ones(3), S(0): np.ones(2)}
NET = network(pair())
IMAGE, PLACE, MEASURED = NET.images[0], NET.points.places, NET.rays.places


def seen(k: int = 0) -> tuple[np.ndarray, tuple[float, float]]:
    """A point that is known and its measured pixel in the first image."""
    rays = np.flatnonzero((NET.rays.image == 0) & np.isfinite(PLACE[NET.rays.point]).all(axis=1))
    return PLACE[NET.rays.point[rays[k]]], tuple(MEASURED[rays[k]].tolist())


def values_at(point: np.ndarray, coefficients: np.ndarray | None = None, shift: bool = False) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(L(0), point)
    if coefficients is not None:
        values.insert(X(0), coefficients)
    if shift:
        values.insert(S(0), np.array([70.0, -40.0]))
    return values


def state(seed: int, rotation: float = 1e-4) -> tuple[np.ndarray, np.ndarray]:
    """EO coefficients (18,) of 300 m and `rotation` rad, and 200 m of a point."""
    rng = np.random.default_rng(seed)
    coefficients = rng.standard_normal((3, 6)) * np.outer([1.0, 0.1, 0.01], np.repeat([300.0, rotation], 3))
    return coefficients.ravel(), rng.standard_normal(3) * 200.0


def level(point: np.ndarray) -> factors.PolynomialEffect:
    """A shift east and north of what lies at a point."""
    return factors.constant(S(0), slice(3), east_north(point[None])[0].T)


def projection(**more: Any) -> gtsam.CustomFactor:
    point, measured = seen()
    return factors.pushbroom_projection(X(0), L(0), IMAGE, measured, near=point, **more)


FACTORS: dict[str, Callable[[], tuple[gtsam.NonlinearFactor, bool]]] = {
    "laser_range": lambda: (factors.laser_range(X(0), L(0), IMAGE, 2500.0, 380_000.0, 10.0), False),
    "ground_prior": lambda: (factors.ground_prior(L(0), seen()[0], np.diag([9.0, 4.0, 1.0])), False),
    "ground_prior, shifted": lambda: (
        factors.ground_prior(L(0), seen()[0], np.diag([9.0, 4.0, 1.0]), [level(seen()[0])]), True,
    ),
    "terrain_height": lambda: (factors.terrain_height(L(0), terrain(NET).spline(), 10.0), False),
    "terrain_height, shifted": lambda: (
        factors.terrain_height(L(0), terrain(NET).spline(), 10.0, [level(seen()[0])]), True,
    ),
    "orientation_prior": lambda: (factors.orientation_prior(X(0), NET.priors[0].sigmas), False),
}  # fmt: skip


@pytest.mark.parametrize(("line", "angles"), MODELS)
@settings(max_examples=5)
@given(seed=st.integers(0, 2**32 - 1))
def test_derivatives_of_image_coordinates(line: Any, angles: Any, seed: int) -> None:
    coefficients, move = state(seed)
    values = values_at(seen()[0] + move, coefficients)
    assert_jacobians(projection(line=line, angles=angles), values, STEPS, tolerance=2e-5)


@pytest.mark.parametrize("name", FACTORS)
def test_derivatives(name: str) -> None:
    factor, shifted = FACTORS[name]()
    coefficients, move = state(3)
    values = values_at(seen()[0] + move, coefficients if X(0) in factor.keys() else None, shifted)
    if L(0) not in factor.keys():
        values.erase(L(0))
    assert_jacobians(factor, values, STEPS, tolerance=2e-5)


@pytest.mark.parametrize("name", ["pushbroom_projection", *FACTORS])
def test_a_planted_sign_is_caught(name: str) -> None:
    factor, shifted = (projection(), False) if name == "pushbroom_projection" else FACTORS[name]()
    coefficients, move = state(3)
    values = values_at(seen()[0] + move, coefficients if X(0) in factor.keys() else None, shifted)
    if L(0) not in factor.keys():
        values.erase(L(0))

    def wrong(this: gtsam.CustomFactor, at: gtsam.Values, jacobians: list[np.ndarray] | None) -> np.ndarray:
        if jacobians is not None:
            matrix, _ = gtsam.JacobianFactor(factor.linearize(at)).jacobian()
            edges = np.cumsum([0, *(values.zeroVectors().at(key).size for key in factor.keys())])
            for k in range(len(factor.keys())):
                jacobians[k] = np.asfortranarray(matrix[:, edges[k] : edges[k + 1]] * (-1.0 if k == 0 else 1.0))
        return factor.whitenedError(at)

    rows = factor.whitenedError(values).size
    planted = gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(rows), list(factor.keys()), wrong)
    with pytest.raises(AssertionError, match="block"):
        assert_jacobians(planted, values, STEPS)


def test_image_coordinates_are_those_of_the_image() -> None:
    """Measured minus where the corrected image sees the point, by Newton's method on the line."""
    coefficients, move = state(5)
    point, measured = seen()
    place, _ = IMAGE.ground_to_image((point + move)[None], OrientationCorrection(coefficients.reshape(3, 6)))
    error = projection().unwhitenedError(values_at(point + move, coefficients))
    np.testing.assert_allclose(error, measured - place[0], rtol=0.0, atol=2e-8)


def test_a_range_is_the_distance_from_the_corrected_camera() -> None:
    coefficients, _ = state(5)
    centre = IMAGE.pose(np.array([2500.0]), OrientationCorrection(coefficients.reshape(3, 6))).position[0]
    factor = factors.laser_range(X(0), L(0), IMAGE, 2500.0, 380_000.0, 10.0)
    error = factor.unwhitenedError(values_at(seen()[0], coefficients))
    np.testing.assert_allclose(error, 380_000.0 - np.linalg.norm(seen()[0] - centre), rtol=0.0, atol=1e-7)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: factors.pushbroom_projection(X(0), L(0), IMAGE, (-3.0, 5.0)), "pixel -3, 5; expected 0"),
        (lambda: factors.pushbroom_projection(X(0), L(0), IMAGE, (3.0, 5.0), 0.0), "sigma 0; expected positive"),
        (lambda: factors.pushbroom_projection(X(0), L(0), IMAGE, (3.0, 5.0), line="measured"), "without `near`"),
        (lambda: factors.laser_range(X(0), L(0), IMAGE, 3.0, 4e5, -1.0), "sigma -1"),
        (lambda: factors.laser_range(X(0), L(0), IMAGE, 3.0, -4e5, 1.0), "-400000 m"),
        (lambda: factors.orientation_prior(X(0), np.zeros((3, 6))), "sigma 0"),
    ],
)
def test_what_cannot_be_is_refused(make: Callable[[], Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        make()


def test_a_point_behind_the_camera_is_named() -> None:
    values = values_at(3.0 * seen()[0], np.zeros(18))
    assert np.all(np.isinf(projection(label="point T1, image A").unwhitenedError(values)))
    with pytest.raises(PointBehindCamera, match="point T1, image A"):
        projection(label="point T1, image A").linearize(values)
