"""Every factor against the oracle on physical geometry, and a planted sign error that the oracle finds."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jacobians import assert_jacobians
from networks import network, pair, with_shift_and_surface

from mgsgraph.adjustment.graph import BundleGraph, Layout, lay_out
from mgsgraph.adjustment.graph.bundle import orientation_key, point_key, shift_key
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.factors.priors import ground_prior, shifted_ground_prior, zero_prior
from mgsgraph.factors.projection import projection_factor
from mgsgraph.factors.range import range_factor
from mgsgraph.factors.surface import surface_factor
from mgsgraph.geometry.body import from_planetocentric

MODELS = [(line, angles) for line in ("predicted", "measured") for angles in ("camera", "opk-paper", "opk-peer")]
LAYOUTS: dict[tuple[str, str], Layout] = {}
SEEDS = st.integers(0, 2**32 - 1)
ROTATION_SIZES = st.sampled_from([0.0, 1e-7, 1e-4, 1e-3])
"""rad; a milliradian is 270 lines of this camera."""


def layout(line: str = "predicted", angles: str = "camera") -> Layout:
    """The pair's layout, one per form of the model."""
    if (line, angles) not in LAYOUTS:
        LAYOUTS[line, angles] = lay_out(network(pair()), SolverSettings(line=line, angles=angles))
    return LAYOUTS[line, angles]


def state(seed: int, rotation: float) -> tuple[np.ndarray, np.ndarray]:
    """Orientation coefficients (18,) of some 300 m and `rotation` rad (linear and quadratic terms 0.1 and 0.01 of it),
    and a displacement (3,) of a point.
    """
    rng = np.random.default_rng(seed)
    coefficients = rng.standard_normal((3, 6)) * np.outer([1.0, 0.1, 0.01], np.repeat([300.0, rotation], 3))
    return coefficients.ravel(), rng.standard_normal(3) * 200.0


def steps(point: float = 1.0) -> dict[int, np.ndarray]:
    orientation = np.tile(np.repeat([1.0, 1e-5], 3), 3)
    return {orientation_key(0): orientation, orientation_key(1): orientation} | {
        point_key(i): np.full(3, point) for i in range(18)
    }


def label_of(k: int) -> str:
    return f"ray {k}"


@pytest.mark.parametrize(("line", "angles"), MODELS)
@settings(max_examples=25, deadline=None)
@given(seed=SEEDS, rotation=ROTATION_SIZES, ray=st.integers(0, 35))
def test_projection(line: str, angles: str, seed: int, rotation: float, ray: int) -> None:
    made = layout(line, angles)
    coefficients, move = state(seed, rotation)
    point = int(np.searchsorted(made.rows.ray_first, ray, side="right") - 1)
    values = gtsam.Values()
    values.insert(orientation_key(0), coefficients)
    values.insert(point_key(point), made.rows.point_start[point] + move)
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.7, 1.3]))
    factor = projection_factor(orientation_key(0), point_key(point), made.rows, ray, made.model, noise, label_of(ray))
    assert_jacobians(factor, values, steps(), tolerance=2e-6)


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS, shot=st.integers(0, 5))
def test_range(seed: int, shot: int) -> None:
    made = layout()
    coefficients, move = state(seed, 1e-3)
    values = gtsam.Values()
    values.insert(orientation_key(0), coefficients)
    values.insert(
        point_key(1), made.rows.point_start[made.rows.range_first.searchsorted(shot, side="right") - 1] + move
    )
    factor = range_factor(orientation_key(0), point_key(1), made.rows, shot, gtsam.noiseModel.Isotropic.Sigma(1, 2.0))
    assert_jacobians(factor, values, steps(), tolerance=1e-7)


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS)
def test_priors(seed: int) -> None:
    coefficients, move = state(seed, 1e-2)
    values = gtsam.Values()
    values.insert(orientation_key(0), coefficients)
    values.insert(point_key(1), move)
    sigmas = np.tile(np.repeat([50.0, 1e-3], 3), 3)
    assert_jacobians(zero_prior(orientation_key(0), sigmas), values, steps(), tolerance=1e-9)
    root = np.triu(np.random.default_rng(seed).standard_normal((3, 3)))
    assert_jacobians(ground_prior(point_key(1), np.ones(3), root), values, steps(), tolerance=1e-9)


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS)
def test_shifted_prior(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = gtsam.Values()
    values.insert(point_key(1), rng.standard_normal(3))
    values.insert(shift_key(0), rng.standard_normal(2) * 50.0)
    root, axes = np.triu(rng.standard_normal((3, 3))), rng.standard_normal((2, 3))
    factor = shifted_ground_prior(point_key(1), shift_key(0), rng.standard_normal(3), root, axes)
    assert_jacobians(factor, values, steps() | {shift_key(0): np.ones(2)}, tolerance=1e-9)


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS)
def test_surface(seed: int) -> None:
    """Oracle inside a patch, and the same height and normal as the terrain model itself says."""
    made = lay_out(with_shift_and_surface(network(pair())), SolverSettings())
    grid = made.network.surface.grid
    rng = np.random.default_rng(seed)
    place = np.array(
        [
            grid.first_longitude + (40 + rng.uniform(0.1, 0.9)) * grid.longitude_step,
            grid.first_latitude - (40 + rng.uniform(0.1, 0.9)) * grid.latitude_step,
            grid.radii[40, 40] + rng.normal(0.0, 200.0),
        ]
    )
    shift = rng.normal(0.0, 100.0, 2)
    values = gtsam.Values()
    values.insert(shift_key(0), shift)
    axes = made.rows.surface_direction[0]
    moved = from_planetocentric(place)
    values.insert(point_key(1), moved + shift @ axes)
    rows = made.rows._replace(terrain_cell=np.tile(grid.cells(moved[None]), (18, 1)))
    factor = surface_factor(point_key(1), shift_key(0), rows, 0, 20.0)
    assert_jacobians(factor, values, steps() | {shift_key(0): np.ones(2)}, tolerance=1e-6)
    height, slope = grid.height_above(moved[None])
    assert factor.unwhitenedError(values) == pytest.approx(height, abs=1e-6)
    jacobian, _ = gtsam.JacobianFactor(factor.linearize(values)).jacobian()
    np.testing.assert_allclose(jacobian[:, :3] * 20.0, slope, atol=1e-9)


def test_off_the_terrain_model_there_is_no_row() -> None:
    made = lay_out(with_shift_and_surface(network(pair())), SolverSettings())
    values = gtsam.Values()
    values.insert(point_key(1), np.array([0.0, -3.4e6, 1e3]))
    cell = made.network.surface.grid.cells(np.array([[0.0, -3.4e6, 1e3]]))
    factor = surface_factor(point_key(1), None, made.rows._replace(terrain_cell=cell), 0, 20.0)
    assert factor.error(values) == 0.0
    assert not np.any(gtsam.JacobianFactor(factor.linearize(values)).jacobian()[0])


def test_an_unknown_coefficient_has_no_prior_row() -> None:
    factor = zero_prior(orientation_key(0), np.array([1.0, np.inf, 2.0, 1.0, 1.0, 1.0]))
    values = gtsam.Values()
    values.insert(orientation_key(0), np.full(6, 4.0))
    assert factor.error(values) == pytest.approx(0.5 * (16.0 * 4 + 4.0))


@settings(max_examples=10, deadline=None)
@given(seed=SEEDS, line=st.sampled_from(["predicted", "measured"]), loss=st.sampled_from(["none", "huber", "cauchy"]))
def test_bundle_gradient_is_that_of_the_full_cost(seed: int, line: str, loss: str) -> None:
    """The bundle's error vector is a square root of the cost: what counts is its gradient, A'e = d cost."""
    made = lay_out(network(pair()), SolverSettings(line=line, loss=loss))
    graph = BundleGraph(made)
    factor = graph.graph.at(graph.graph.size() - 1)
    rng = np.random.default_rng(seed)
    x = rng.standard_normal(36) * made.scales
    values = graph.values(x)
    linear = gtsam.JacobianFactor(factor.linearize(values))
    jacobian, right = linear.jacobian()
    gradient = -jacobian.T @ right * made.scales
    assert 0.5 * right @ right == pytest.approx(factor.error(values), rel=1e-12)
    for k in range(36):
        step = np.zeros(36)
        step[k] = 1e-4 * made.scales[k]
        difference = [factor.error(graph.values(x + times * step)) for times in (1.0, -1.0, 2.0, -2.0)]
        numeric = (8.0 * (difference[0] - difference[1]) - (difference[2] - difference[3])) / 12e-4
        # Huber's curvature jumps, which costs the differences some digits
        share = 1e-4 if loss == "huber" else 1e-5
        assert gradient[k] == pytest.approx(numeric, rel=share, abs=share * np.abs(gradient).max())


def test_the_oracle_finds_a_sign_error() -> None:
    made = layout()
    coefficients, move = state(3, 1e-3)
    values = gtsam.Values()
    values.insert(orientation_key(0), coefficients)
    values.insert(point_key(0), made.rows.point_start[0] + move)
    right = projection_factor(
        orientation_key(0), point_key(0), made.rows, 0, made.model, gtsam.noiseModel.Unit.Create(2), label_of(0)
    )

    def wrong(this: gtsam.CustomFactor, at: gtsam.Values, jacobians: list[np.ndarray] | None) -> np.ndarray:
        if jacobians is not None:
            matrix, _ = gtsam.JacobianFactor(right.linearize(at)).jacobian()
            jacobians[0], jacobians[1] = np.asfortranarray(matrix[:, :18]), np.asfortranarray(matrix[:, 18:])
            jacobians[0][:, 9:12] *= -1.0
        return right.unwhitenedError(at)

    planted = gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(2), [orientation_key(0), point_key(0)], wrong)
    assert_jacobians(right, values, steps())
    with pytest.raises(AssertionError, match=r"block o0, column (9|10|11)"):
        assert_jacobians(planted, values, steps())


def test_residual_is_measured_minus_predicted_place() -> None:
    """Against ground_to_image, which finds the line by Newton's method on the true pose."""
    made = layout()
    noise = gtsam.noiseModel.Unit.Create(2)
    rng = np.random.default_rng(5)
    for ray in range(0, 36, 5):
        point = int(np.searchsorted(made.rows.ray_first, ray, side="right") - 1)
        image = int(made.network.rays.image[made.ray_order[ray]])
        place = made.rows.point_start[point] + rng.standard_normal(3) * 50.0
        values = gtsam.Values()
        values.insert(orientation_key(image), np.zeros(18))
        values.insert(point_key(point), place)
        factor = projection_factor(
            orientation_key(image), point_key(point), made.rows, ray, made.model, noise, label_of(ray)
        )
        predicted, _ = made.network.images[image].ground_to_image(place[None])
        measured = made.network.rays.places[made.ray_order[ray]]
        # what carrying the pose by its rates leaves out is the orbit's curvature: half of 3.5 m/s2 over the lines moved
        curvature = 5e-7 * (measured[0] - predicted[0, 0]) ** 2
        np.testing.assert_allclose(
            factor.unwhitenedError(values), measured - predicted[0], rtol=0.0, atol=1e-6 + curvature
        )


def test_a_point_behind_the_camera() -> None:
    from mgsgraph.errors import PointBehindCamera

    made = layout()
    values = gtsam.Values()
    values.insert(orientation_key(0), np.zeros(18))
    values.insert(point_key(0), 2.0 * made.rows.point_start[0])
    factor = projection_factor(
        orientation_key(0), point_key(0), made.rows, 0, made.model, gtsam.noiseModel.Unit.Create(2), "point P, image I"
    )
    assert factor.error(values) == np.inf
    with pytest.raises(PointBehindCamera, match="point P, image I"):
        factor.linearize(values)


def test_model_forms_agree_at_the_measured_line() -> None:
    """Where a point projects onto its measured line, the strict and the papers' form have the same sample residual."""
    made, paper = layout(), layout("measured")
    assert made.rows._replace(angles=paper.rows.angles).ray_first.tolist() == paper.rows.ray_first.tolist()
    first, second = BundleGraph(made), BundleGraph(replace(paper, model=made.model))
    x = np.zeros(36)
    assert first.reduction(x).cost == second.reduction(x).cost
