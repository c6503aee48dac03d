"""The public factors, one by one: their derivatives against differences, what they measure, and what they refuse."""

import math
from collections.abc import Callable
from typing import Any

import gtsam
import numpy as np
import pytest
from explicit_form import assert_jacobians
from gtsam.symbol_shorthand import L, S, X
from hypothesis import example, given, settings
from hypothesis import strategies as st
from networks import network, pair, terrain
from numba import njit
from outside import refuses
from stereo_pair import surface

from mgsgraph import factors
from mgsgraph.errors import PointBehindCamera
from mgsgraph.factors import rotation
from mgsgraph.factors.ranging import Range
from mgsgraph.geometry.altimetry import with_common_errors
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.stereo_surface import heights_above

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


def projection(**more: Any) -> gtsam.CustomFactor:
    point, measured = seen()
    return factors.pushbroom_projection(X(0), L(0), IMAGE, measured, near=point, **more)


FACTORS: dict[str, Callable[[], tuple[gtsam.NonlinearFactor, bool]]] = {
    "laser_range": lambda: (factors.laser_range(X(0), L(0), IMAGE, 2500.0, 380_000.0, 10.0), False),
    "laser_range, of a footprint": lambda: (
        factors.laser_range(
            X(0), L(0), IMAGE, 2500.0, 380_000.0, 10.0, footprint=(seen()[0], np.array([0.3, -0.2, 0.5]))
        ),
        False,
    ),
    "ground_prior": lambda: (factors.ground_prior(L(0), seen()[0], np.diag([9.0, 4.0, 1.0])), False),
    "ground_prior, shifted": lambda: (
        factors.ground_prior(L(0), seen()[0], np.diag([9.0, 4.0, 1.0]), [factors.profile_shift(S(0), seen()[0])]), True,
    ),
    "terrain_height": lambda: (factors.terrain_height(L(0), terrain(NET).spline(), 10.0), False),
    "terrain_height, shifted": lambda: (
        factors.terrain_height(L(0), terrain(NET).spline(), 10.0, [factors.profile_shift(S(0), seen()[0])]), True,
    ),
    "linear_prior": lambda: (factors.linear_prior([X(0)], [np.eye(18)[:5] * 1e-2], np.ones(5)), False),
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


@pytest.mark.parametrize("name", ["pushbroom_projection", "stereo_height", *FACTORS])
def test_a_planted_sign_is_caught(name: str) -> None:
    if name == "stereo_height":
        factor, values, _ = stereo()
    else:
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
        assert_jacobians(planted, values, STEPS | {X(1): STEPS[X(0)]})


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


def test_a_range_bias_lengthens_what_is_measured() -> None:
    """From 4 m away, with 0.5 m too much, 4.5 m are measured; derivatives as by differences."""
    one = Range(4.5, 0.0, np.array([1.0, 2.0, 3.0]))

    def at(state: np.ndarray) -> Any:
        return one(lambda _: (state, np.zeros(13)), np.array([1.0, 2.0, 7.0]))

    exact, step = np.zeros(13), 1e-4
    exact[9] = 0.5
    assert at(exact).residual == pytest.approx([0.0], abs=1e-12)
    by_state = [at(exact + step * way).residual - at(exact - step * way).residual for way in np.eye(13)]
    np.testing.assert_allclose(at(exact).by_state, np.array(by_state).T / (2.0 * step), atol=1e-8)


@settings(max_examples=6)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_range_and_its_footprint_are_the_stated_joint_covariance(seed: int) -> None:
    """With an error that takes the footprint as far on along the beam as it makes the range too long, both factors
    together have the squares by the covariance of all four numbers.
    """
    rng, known, away = np.random.default_rng(seed), seen()[0], IMAGE.pose(np.array([2500.0])).position[0]
    root, place = 2.0 * rng.standard_normal((3, 3)) + 5.0 * np.eye(3), known + rng.normal(0.0, 10.0, 3)
    beam, sigma, size = (known - away) / np.linalg.norm(known - away), 3.0, rng.uniform(0.5, 20.0)
    errors = np.array([size, *size * beam])
    whole = np.block([[np.eye(1) * sigma**2, np.zeros((1, 3))], [np.zeros((3, 1)), root @ root.T]])
    whole += errors[:, None] * errors
    rest, own, shares = with_common_errors(sigma, (root @ root.T)[None], errors[None, 1:])
    measured = np.linalg.norm(known - away) + rng.normal(0.0, 10.0)
    values, footprint = values_at(place, np.zeros(18), shift=True), (known, shares[0])
    moved = east_north(known[None])[0].T @ values.atVector(S(0))
    along = [factors.constant(S(0), slice(9, 10), shares @ east_north(known[None])[0].T)]
    one = factors.laser_range(X(0), L(0), IMAGE, 2500.0, measured, float(rest[0]), shared=along, footprint=footprint)
    other = factors.ground_prior(L(0), known, own[0], [factors.profile_shift(S(0), known)])
    off = np.array([measured - np.linalg.norm(place - away), *(known + moved - place)])
    assert one.error(values) + other.error(values) == pytest.approx(0.5 * off @ np.linalg.solve(whole, off), rel=1e-7)


@settings(max_examples=6)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_ground_prior_is_the_stated_covariance(seed: int) -> None:
    """Its squares are those by the covariance about the a-priori position, moved east and north by the shift."""
    rng, known = np.random.default_rng(seed), seen()[0]
    root = 5.0 * rng.standard_normal((3, 3)) + 10.0 * np.eye(3)
    factor = factors.ground_prior(L(0), known, root @ root.T, [factors.profile_shift(S(0), known)])
    values = values_at(known + rng.normal(0.0, 20.0, 3), shift=True)
    offset = values.atPoint3(L(0)) - known - values.atVector(S(0)) @ east_north(known[None])[0]
    assert factor.error(values) == pytest.approx(0.5 * offset @ np.linalg.solve(root @ root.T, offset), rel=1e-9)


def test_an_unknown_coefficient_has_no_prior_row() -> None:
    factor = factors.orientation_prior(X(0), np.array([1.0, np.inf, 2.0, 1.0, 1.0, 1.0]))
    values = gtsam.Values()
    values.insert(X(0), np.full(6, 4.0))
    assert factor.error(values) == pytest.approx(0.5 * (16.0 * 4 + 4.0))


@pytest.mark.parametrize(("line", "angles"), MODELS)
def test_model_forms_agree_at_the_measured_line(line: Any, angles: Any) -> None:
    """A point on the ray of another sample of the measured line misses by that many samples and no line, in all forms:
    one camera, whatever its pose is called, and no line to look for.
    """
    for k in range(0, 6, 2):
        _, (at_line, sample) = seen(k)
        place, _ = IMAGE.image_to_ground(np.array([at_line]), np.array([sample + 3.0]), 50.0)
        factor = factors.pushbroom_projection(
            X(0), L(0), IMAGE, (at_line, sample), near=place[0], line=line, angles=angles
        )
        error = factor.unwhitenedError(values_at(place[0], np.zeros(18)))
        np.testing.assert_allclose(error, [0.0, -3.0], rtol=0.0, atol=2e-7)


def test_a_time_bias_moves_the_camera_along_its_track() -> None:
    """By 0.2 s as by as many lines more: the pixel of what is seen is earlier by these."""
    factor = factors.pushbroom_projection(
        None, L(0), IMAGE, seen()[1], shared=[factors.time_bias(S(0), IMAGE, 1e-3)]
    )  # fmt: skip
    still, values = projection().unwhitenedError(values_at(seen()[0], np.zeros(18))), values_at(seen()[0])
    values.insert(S(0), np.array([0.02]))
    np.testing.assert_allclose(factor.unwhitenedError(values), still + np.array([20.0, 0.0]), rtol=0.0, atol=1e-3)
    assert_jacobians(factor, values, {L(0): np.ones(3), S(0): np.full(1, 1e-3)})


def test_orientation_images_are_weighted_along_the_line() -> None:
    """Two, halfway between which the mean of both counts: as the mean as coefficients of the image itself."""
    two = factors.OrientationImagesEffect(
        (X(1), X(2)), lambda line: (np.array([1.0 - line / 5000.0, line / 5000.0]), np.array([-2e-4, 2e-4]))
    )
    own = factors.orientation_polynomial(X(0), 1, 5000.0)
    first, second = np.arange(6.0), np.arange(6.0) ** 2
    for line in (0.0, 1234.5, 5000.0):
        for one, other in zip(two.at(line), own.at(line), strict=True):
            right = other @ np.concatenate([first + second, second - first]) / 2.0
            np.testing.assert_allclose(one @ np.concatenate([first, second]), right, atol=1e-12)


# --- the surface of a stereo pair


def stereo() -> tuple[Any, gtsam.Values, Any]:
    """Height of a shot, its values where it is on the surface, and the pair."""
    made = pair(12, 24)
    effects = tuple([factors.orientation_polynomial(X(k), 2, one.lines)] for k, one in enumerate(made.images))
    factor = factors.stereo_height(L(0), surface(made), made.images, effects, 2.0)
    values = values_at(made.true_footprints[11])
    for k, one in enumerate(made.true_corrections):
        values.insert(X(k), one.coefficients.ravel())
    for _ in range(8):
        normal = gtsam.JacobianFactor(factor.linearize(values)).jacobian()[0][0, -3:]
        values.update(L(0), values.atPoint3(L(0)) - factor.whitenedError(values) * normal / (normal @ normal))
    return factor, values, made


def test_a_stereo_height_is_that_above_the_surface() -> None:
    factor, values, made = stereo()
    rng = np.random.default_rng(8)
    for _ in range(5):
        values.update(L(0), made.true_footprints[11] + rng.normal(0.0, 30.0, 3))
        values.update(X(0), made.true_corrections[0].coefficients.ravel() + state(rng.integers(99), 1e-5)[0] / 10.0)
        corrections = tuple(OrientationCorrection(values.atVector(X(k)).reshape(-1, 6)) for k in (0, 1))
        found = heights_above(surface(made), *made.images, values.atPoint3(L(0))[None], corrections)
        np.testing.assert_allclose(factor.unwhitenedError(values), found.heights, rtol=0.0, atol=1e-5)
        jacobian = 2.0 * gtsam.JacobianFactor(factor.linearize(values)).jacobian()[0]
        np.testing.assert_allclose(jacobian[0, -3:], found.normals[0], rtol=0.0, atol=1e-7)
        np.testing.assert_allclose(jacobian[0, :6], found.by_pose[0, 0, :6], rtol=1e-6, atol=1e-7)


def test_derivatives_of_a_stereo_height() -> None:
    """On the surface: elsewhere they hold the direction of the normal."""
    factor, values, _ = stereo()
    steps = STEPS[X(0)]
    assert_jacobians(factor, values, {X(0): steps, X(1): steps, L(0): np.ones(3)}, tolerance=1e-4)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: factors.pushbroom_projection(X(0), L(0), IMAGE, (-3.0, 5.0)), "pixel -3, 5; expected 0"),
        (lambda: factors.pushbroom_projection(X(0), L(0), IMAGE, (3.0, 5.0), 0.0), "sigma 0; expected positive"),
        (lambda: factors.pushbroom_projection(X(0), L(0), IMAGE, (3.0, 5.0), line="measured"), "without `near`"),
        (lambda: factors.laser_range(X(0), L(0), IMAGE, 3.0, 4e5, -1.0), "sigma -1"),
        (lambda: factors.laser_range(X(0), L(0), IMAGE, 3.0, -4e5, 1.0), "-400000 m"),
        (lambda: factors.laser_range(X(0), L(0), IMAGE, 8.7e11, 4e5, 1.0), "line 8.7e"),
        (lambda: factors.orientation_prior(X(0), np.zeros((3, 6))), "sigma 0"),
        (lambda: factors.ground_prior(L(0), seen()[0], -np.eye(3)), "point l0.*positive definite"),
        (lambda: factors.laser_range(L(0), L(0), IMAGE, 3.0, 4e5, 1.0), "key l0 of an unknown and of the point"),
        (lambda: factors.terrain_height(L(0), terrain(NET).spline(), 0.0), "sigma 0"),
        (lambda: factors.terrain_height(np.zeros(2), terrain(NET).spline(), 1.0), "a GTSAM key, or a position"),
        (lambda: factors.pushbroom_projection(X(0), L(0), IMAGE, (3.0, 5.0, 1.0)), "line and sample"),
        (lambda: factors.pushbroom_projection(X(0), L(0), IMAGE, (3.0, 5.0), [1.0, 1.0, 1.0]), "3 sigmas"),
        (lambda: factors.pushbroom_projection(X(0), L(0), IMAGE, (3.0, 5.0), robust="huber"), "one of huber"),
        (lambda: factors.pushbroom_projection(X(0), L(0), IMAGE, (3.0, 5.0), degree=-1), "degree -1"),
        (lambda: factors.orientation_prior(X(0), 1.0), "one of each coefficient"),
        (lambda: factors.ground_prior(L(0), seen()[0], np.ones(3)), "shape"),
    ],
)
def test_what_cannot_be_is_refused(make: Callable[[], Any], said: str) -> None:
    refuses(said, make)


def test_keys_may_be_numbers_of_numpy_and_coefficients_have_their_length() -> None:
    factor = factors.pushbroom_projection(np.uint64(X(0)), np.array([L(0)])[0], IMAGE, seen()[1])
    assert list(factor.keys()) == [X(0), L(0)]
    refuses("12 numbers of variable x0; expected 18", factor.error, values_at(seen()[0], np.zeros(12)))


def test_a_point_behind_the_camera_is_named() -> None:
    values = values_at(3.0 * seen()[0], np.zeros(18))
    assert np.all(np.isinf(projection(label="point T1, image A").unwhitenedError(values)))
    with pytest.raises(PointBehindCamera, match="point T1, image A"):
        projection(label="point T1, image A").linearize(values)


def test_an_image_that_does_not_see_the_point_is_named() -> None:
    """A point 300 km away: at another end of the orbit."""
    values = values_at(seen()[0] + 3e5 * east_north(seen()[0][None])[0, 1], np.zeros(18))
    with pytest.raises(PointBehindCamera, match="point T1, image A"):
        projection(label="point T1, image A").linearize(values)


# --- sine and cosine without branches

ANGLES = st.one_of(
    st.floats(-1e4, 1e4),
    st.floats(-1e-6, 1e-6),
    # about the quarters of a turn, where sine and cosine change places
    st.builds(lambda k, off: (0.25 * math.pi) * k + off, st.integers(-12_000, 12_000), st.floats(-1e-9, 1e-9)),
)


compiled = njit(rotation.sine_cosine, error_model="numpy")
"""As the kernel calls it."""


@settings(max_examples=200)
@given(angle=ANGLES)
@example(angle=0.0)
@example(angle=-0.0)
@example(angle=1e4)
def test_sine_and_cosine(angle: float) -> None:
    """Against the C library's; rotation corrections are of microradians, where the error of a sine is relative."""
    for sine, cosine in (rotation.sine_cosine(angle), compiled(angle)):
        assert abs(sine - math.sin(angle)) <= 4e-16 * min(1.0, abs(angle))
        assert abs(cosine - math.cos(angle)) <= 4e-16
