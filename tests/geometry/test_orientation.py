"""Orientation corrections: what they do to a pose, and how it changes with each of them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import along, directions

from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.orientation import Angles, OrientationCorrection, OrientationPrior
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.simulation.pair import simulate_pair

KINDS = pytest.mark.parametrize("angles", ["camera", "opk-paper", "opk-peer"])
U = np.array([-1.0, -0.3, 0.0, 0.8, 1.0])
IMAGE = simulate_pair().images[1]
LINES = 0.5 * (U + 1.0) * IMAGE.lines
NOMINAL, MOMENTS = IMAGE.pose(LINES), IMAGE.moments(LINES)

coefficients = st.lists(st.floats(-1.0, 1.0), min_size=18, max_size=18).map(
    lambda c: np.reshape(c, (3, 6)) * ([500.0] * 3 + [0.02] * 3)
)


@KINDS
@pytest.mark.parametrize("degree", [0, 2])
def test_no_correction_is_the_nominal_pose(angles: Angles, degree: int) -> None:
    pose = OrientationCorrection(np.zeros((degree + 1, 6)), angles).apply(NOMINAL, MOMENTS)

    for name, tolerance in (("position", 0.0), ("velocity", 0.0), ("matrix", 1e-14), ("angular_rate", 1e-15)):
        np.testing.assert_allclose(getattr(pose, name), getattr(NOMINAL, name), rtol=0, atol=tolerance)


@given(coefficients)
def test_camera_corrections_turn_the_camera(c: np.ndarray) -> None:
    """M = Exp([theta]x)' M_nominal: components in the camera frame turn back when the camera turns by theta."""
    pose = OrientationCorrection(c).apply(NOMINAL, MOMENTS)
    correction = np.array([c[0] + c[1] * u + c[2] * u * u for u in U])

    np.testing.assert_allclose(pose.position, NOMINAL.position + correction[:, :3], atol=2e-9)
    found = -rotation.logarithm(pose.matrix @ np.swapaxes(NOMINAL.matrix, 1, 2))
    np.testing.assert_allclose(found, correction[:, 3:], atol=1e-14)


@pytest.mark.parametrize("angles", ["opk-paper", "opk-peer"])
@given(c=coefficients)
def test_angle_corrections_add_to_the_angles(angles: Angles, c: np.ndarray) -> None:
    def angles_of(matrix: np.ndarray) -> np.ndarray:
        return rotation.omega_phi_kappa(matrix if angles == "opk-paper" else np.swapaxes(matrix, 1, 2))

    pose = OrientationCorrection(c, angles).apply(NOMINAL, MOMENTS)
    correction = np.array([c[0] + c[1] * u + c[2] * u * u for u in U])
    want = rotation.from_omega_phi_kappa(angles_of(NOMINAL.matrix) + correction[:, 3:])

    np.testing.assert_allclose(pose.matrix, want if angles == "opk-paper" else np.swapaxes(want, 1, 2), atol=1e-14)
    np.testing.assert_allclose(pose.position, NOMINAL.position + correction[:, :3], atol=2e-9)


@KINDS
@given(c=coefficients, line=st.floats(100.0, 4900.0))
def test_rates_of_the_corrected_pose_against_differences(angles: Angles, c: np.ndarray, line: float) -> None:
    correction = OrientationCorrection(c, angles)
    knot = np.abs(IMAGE.timing.at(np.array([line]))[0] - IMAGE.trajectory.camera.times).min() / 1.446e-3
    line += 20.0 if knot < 10.0 else 0.0  # the tables bend at their nodes

    def pose(step: float) -> Pose:
        return IMAGE.pose(np.array([line + step]), correction)

    now = pose(0.0)
    np.testing.assert_allclose(now.velocity[0], along(lambda s: pose(s).position[0], 2.0), atol=1e-8)
    want = along(lambda s: pose(s).matrix[0], 2.0)
    np.testing.assert_allclose(-rotation.skew(now.angular_rate[0]) @ now.matrix[0], want, atol=1e-13)


@KINDS
@given(c=coefficients)
def test_axes_against_differences(angles: Angles, c: np.ndarray) -> None:
    """Column k: the camera's turn, about its own axes, per rad of component k of the constant coefficient."""
    correction = OrientationCorrection(c, angles)
    now, axes = correction.apply(NOMINAL, MOMENTS), correction.axes(NOMINAL, MOMENTS)

    for k in range(3):

        def turn(step: float, component: int = 3 + k) -> np.ndarray:
            moved = c.copy()
            moved[0, component] += step
            matrix = OrientationCorrection(moved, angles).apply(NOMINAL, MOMENTS).matrix
            return -rotation.logarithm(matrix @ np.swapaxes(now.matrix, 1, 2))

        np.testing.assert_allclose(axes[:, :, k], along(turn, 1e-3), atol=1e-9)


@given(directions)
def test_small_turns_agree_between_the_conventions(axis: np.ndarray) -> None:
    """A turn of 1e-6 rad about the camera axes, put into angles by their axes, is the same to second order."""
    turn = 1e-6 * axis
    want = OrientationCorrection(np.array([[0.0, 0.0, 0.0, *turn]])).apply(NOMINAL, MOMENTS)
    for kind in ("opk-paper", "opk-peer"):
        none = OrientationCorrection(np.zeros((1, 6)), kind)  # type: ignore[arg-type]
        for j, chain in enumerate(none.axes(NOMINAL, MOMENTS)):
            correction = OrientationCorrection(np.array([[0.0, 0.0, 0.0, *np.linalg.solve(chain, turn)]]), none.angles)
            pose = correction.apply(NOMINAL, MOMENTS)
            np.testing.assert_allclose(pose.matrix[j], want.matrix[j], atol=1e-9)


def test_an_unknown_convention_is_refused() -> None:
    with pytest.raises(InputError, match="angles: 'OPK'; expected one of camera, opk-paper, opk-peer"):
        OrientationCorrection(np.zeros((1, 6)), "OPK")  # type: ignore[arg-type]


def test_coefficients_have_six_components() -> None:
    with pytest.raises(InputError, match=r"shape \(3, 5\); expected shape \(n, 6\)"):
        OrientationCorrection(np.zeros((3, 5)))


@pytest.mark.parametrize(
    ("sigmas", "said"),
    [
        (np.ones(6), r"shape \(6,\); expected \(degree \+ 1, 6\)"),
        (np.zeros((1, 6)), r"sigma 0\.0; expected positive sigmas"), (np.full((1, 6), np.nan), "sigma nan"),
    ],
)  # fmt: skip
def test_priors_are_positive(sigmas: np.ndarray, said: str) -> None:
    with pytest.raises(InputError, match=said):
        OrientationPrior(sigmas)


def test_a_prior_may_be_infinite_and_knows_its_degree() -> None:
    prior = OrientationPrior(np.full((3, 6), np.inf))

    assert prior.degree == 2
    with pytest.raises(ValueError, match="read-only"):
        prior.sigmas[0, 0] = 1.0
