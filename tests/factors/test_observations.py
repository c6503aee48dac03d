"""Every kind of observation against the oracle on physical geometry, and against what the geometry itself says."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import gtsam
import numpy as np
import pytest
from explicit_form import assert_jacobians
from hypothesis import example, given, settings
from hypothesis import strategies as st
from networks import network, pair, with_shift_and_surface
from numba import njit

from mgsgraph.adjustment.graph import Layout, lay_out
from mgsgraph.adjustment.graph.forms import measurement, observation_factor, orientation_key, point_key, shift_key
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import PointBehindCamera
from mgsgraph.factors import rotation
from mgsgraph.factors.ranging import Range
from mgsgraph.factors.priors import zero_prior
from mgsgraph.geometry.body import east_north
from mgsgraph.kernel.rows import GROUND, IMAGE, Rows, one_observation

MODELS = [(line, angles) for line in ("predicted", "measured") for angles in ("camera", "opk-paper", "opk-peer")]
SEEDS = st.integers(0, 2**32 - 1)
ROTATION_SIZES = st.sampled_from([0.0, 1e-7, 1e-4, 1e-3])
"""rad; a milliradian is 270 lines of this camera."""
UNIT = gtsam.noiseModel.Unit.Create


@cache
def layout(line: str = "predicted", angles: str = "camera", surface: bool = False, moving: bool = True) -> Layout:
    """The pair's layout, one per form of the model; with shifts and terrain, which may be known (not moving)."""
    net = network(pair())
    if surface:
        net = with_shift_and_surface(net)
        if not moving:
            net = replace(net, shifts=None, surface=replace(net.surface, shift_sigma=0.0))
    return lay_out(net, SolverSettings(line=line, angles=angles))


def observations_of(made: Layout, kind: int) -> list[tuple[int, int]]:
    """All observations of a kind: points (places in the layout), and which of the point's observations."""
    return [
        (i, j)
        for pattern, first, count in made.rows.piece[:, :3].tolist()
        for i in range(first, first + count)
        for j, one in enumerate(made.patterns.kind[slice(*made.patterns.first[pattern : pattern + 2])])
        if one == kind
    ]


def row_of(made: Layout, point: int, observation: int) -> tuple[int, int]:
    """Network ray of an image observation, and its image."""
    pattern, first, count, _, among = made.rows.piece[np.searchsorted(made.rows.piece[:, 1], point, side="right") - 1]
    ray = int(np.flatnonzero(made.observation_rows.rays == among + observation * count + point - first)[0])
    return ray, int(made.patterns.image[made.patterns.first[pattern] + observation])


def single(made: Layout, point: int, observation: int) -> Rows:
    return one_observation(made.rows, made.groups, point, observation)


def state(seed: int, turned: float) -> tuple[np.ndarray, np.ndarray]:
    """Orientation coefficients (18,) of some 300 m and `turned` rad (linear and quadratic terms 0.1 and 0.01 of it),
    and a displacement (3,) of a point.
    """
    rng = np.random.default_rng(seed)
    coefficients = rng.standard_normal((3, 6)) * np.outer([1.0, 0.1, 0.01], np.repeat([300.0, turned], 3))
    return coefficients.ravel(), rng.standard_normal(3) * 200.0


def steps(point: float = 1.0) -> dict[int, np.ndarray]:
    orientation = np.tile(np.repeat([1.0, 1e-5], 3), 3)
    return {orientation_key(0): orientation, shift_key(0): np.ones(2), point_key(0): np.full(3, point)}


def values_of(key: int, unknowns: np.ndarray, place: np.ndarray) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(key, unknowns)
    values.insert(point_key(0), place)
    return values


def image_factor(made: Layout, point: int, observation: int, noise: gtsam.noiseModel.Base) -> gtsam.CustomFactor:
    rows = single(made, point, observation)
    return observation_factor([orientation_key(0)], [18], point_key(0), rows, made.model, noise, "point P, image I")


@pytest.mark.parametrize(("line", "angles"), MODELS)
@settings(max_examples=6)
@given(seed=SEEDS, turned=ROTATION_SIZES, ray=st.integers(0, 35))
def test_image(line: str, angles: str, seed: int, turned: float, ray: int) -> None:
    made = layout(line, angles)
    coefficients, move = state(seed, turned)
    point, observation = observations_of(made, IMAGE)[ray]
    values = values_of(orientation_key(0), coefficients, made.rows.start[point] + move)
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.7, 1.3]))
    assert_jacobians(image_factor(made, point, observation, noise), values, steps(), tolerance=2e-6)


def test_a_range_bias_lengthens_what_is_measured() -> None:
    """From 4 m away, with 0.5 m too much, 4.5 m are measured; derivatives as by differences."""
    one = Range(4.5, (1.0, 2.0, 3.0))

    def at(state: np.ndarray) -> Any:
        return one(lambda _: (tuple(state.tolist()), (0.0,) * 4), (1.0, 2.0, 7.0))

    exact, step = np.array([0.0, 0.0, 0.0, 0.5]), 1e-4
    assert at(exact).residual == pytest.approx([0.0], abs=1e-12)
    by_state = [(at(exact + step * way).residual - at(exact - step * way).residual) / (2.0 * step) for way in np.eye(4)]
    np.testing.assert_allclose(at(exact).by_state, np.array(by_state).T, atol=1e-8)


@pytest.mark.parametrize("moving", [True, False])
@settings(max_examples=6)
@given(seed=SEEDS, shot=st.integers(0, 5))
def test_ground_prior(moving: bool, seed: int, shot: int) -> None:
    """Oracle, and squares by the stated covariance around the stated place, moved east and north by the shift."""
    made = layout(surface=True, moving=moving)
    rng = np.random.default_rng(seed)
    point, observation = observations_of(made, GROUND)[shot]
    network_point = made.point_order[point]
    place = made.rows.start[point] + rng.normal(0.0, 20.0, 3)
    shift = rng.standard_normal(2) * 50.0
    keys = [shift_key(0)] if moving else []
    factor = observation_factor(
        keys, [2] * len(keys), point_key(0), single(made, point, observation), made.model, UNIT(3), "a prior"
    )
    values = values_of(shift_key(0), shift, place)
    if not moving:
        values.erase(shift_key(0))
    assert_jacobians(factor, values, steps(), tolerance=1e-9)
    stated = made.network.points.places[network_point]
    offset = place - stated - (shift @ east_north(stated[None])[0] if moving else 0.0)
    squares = offset @ np.linalg.solve(made.network.points.covariances[network_point], offset)
    assert factor.error(values) == pytest.approx(0.5 * squares, rel=1e-9)


def test_an_unknown_coefficient_has_no_prior_row() -> None:
    factor = zero_prior(orientation_key(0), np.array([1.0, np.inf, 2.0, 1.0, 1.0, 1.0]))
    values = gtsam.Values()
    values.insert(orientation_key(0), np.full(6, 4.0))
    assert factor.error(values) == pytest.approx(0.5 * (16.0 * 4 + 4.0))


def test_the_oracle_finds_a_sign_error() -> None:
    made = layout()
    coefficients, move = state(3, 1e-3)
    values = values_of(orientation_key(0), coefficients, made.rows.start[0] + move)
    right = image_factor(made, 0, 0, UNIT(2))

    def wrong(this: gtsam.CustomFactor, at: gtsam.Values, jacobians: list[np.ndarray] | None) -> np.ndarray:
        if jacobians is not None:
            matrix, _ = gtsam.JacobianFactor(right.linearize(at)).jacobian()
            jacobians[0], jacobians[1] = np.asfortranarray(matrix[:, :18]), np.asfortranarray(matrix[:, 18:])
            jacobians[0][:, 9:12] *= -1.0
        return right.unwhitenedError(at)

    planted = gtsam.CustomFactor(UNIT(2), [orientation_key(0), point_key(0)], wrong)
    assert_jacobians(right, values, steps())
    with pytest.raises(AssertionError, match=r"block o0, column (9|10|11)"):
        assert_jacobians(planted, values, steps())


def test_a_point_behind_the_camera() -> None:
    made = layout()
    values = values_of(orientation_key(0), np.zeros(18), 2.0 * made.rows.start[0])
    factor = image_factor(made, 0, 0, UNIT(2))
    assert factor.error(values) == np.inf
    with pytest.raises(PointBehindCamera, match="point P, image I"):
        factor.linearize(values)


@pytest.mark.parametrize(("line", "angles"), MODELS)
def test_model_forms_agree_at_the_measured_line(line: str, angles: str) -> None:
    """A point on the ray of another sample of the measured line misses by that many samples and no line, in all forms:
    one camera, whatever its pose is called, and no line to look for.
    """
    made = layout(line, angles)
    for point, observation in observations_of(made, IMAGE)[::5]:
        ray, image = row_of(made, point, observation)
        at_line, sample = made.network.rays.places[[ray]].T
        place, _ = made.network.images[image].image_to_ground(at_line, sample + 3.0, 50.0)
        rows, _ = measurement(single(made, point, observation), made.model)
        found = rows(lambda line_offset: ((0.0,) * 6, (0.0,) * 6), tuple(place[0].tolist()))
        np.testing.assert_allclose(found.residual, [0.0, -3.0], rtol=0.0, atol=2e-7)


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
