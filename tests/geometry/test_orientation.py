"""Orientation: rotations in SPICE's conventions, with derivatives against central differences; corrections, what they
do to a pose, and how it changes with each of them; what Lagrange's polynomials between orientation images can follow.
"""

import numpy as np
import pytest
import spiceypy
from hypothesis import assume, given
from hypothesis import strategies as st
from outside import refuses
from strategies import along, differences, directions, opk_angles, rotation_vectors

from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.orientation import (
    Angles,
    OrientationCorrection,
    OrientationImages,
    OrientationPrior,
    evenly_spaced,
)
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.simulation.pair import simulate_pair

any_rotation = rotation_vectors().map(rotation.exponential)


@given(rotation_vectors(), rotation_vectors())
def test_products_and_inverses_are_rotations(first: np.ndarray, second: np.ndarray) -> None:
    product = rotation.exponential(first) @ rotation.exponential(second)

    np.testing.assert_allclose(product @ product.T, np.eye(3), atol=4e-15)
    assert np.linalg.det(product) == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(rotation.exponential(-first), rotation.exponential(first).T, atol=1e-16)


@given(directions, st.floats(-np.pi, np.pi))
def test_exponential_is_the_turn_of_spice(axis: np.ndarray, angle: float) -> None:
    """NAIF axisar: the matrix that turns a vector by the angle about the axis."""
    np.testing.assert_allclose(rotation.exponential(axis * angle), spiceypy.axisar(axis, angle), atol=2e-15)


@given(rotation_vectors())
def test_logarithm_gives_the_vector_back(vector: np.ndarray) -> None:
    found = rotation.logarithm(rotation.exponential(vector))

    np.testing.assert_allclose(found, vector, rtol=0, atol=3e-15)
    if np.linalg.norm(vector) < 1e-6:  # no digits lost near the identity
        np.testing.assert_allclose(found, vector, rtol=0, atol=1e-14 * np.linalg.norm(vector) + 1e-300)


@given(directions)
def test_half_a_turn_has_a_logarithm(axis: np.ndarray) -> None:
    matrix = 2.0 * np.outer(axis, axis) - np.eye(3)
    found = rotation.logarithm(matrix)

    assert np.linalg.norm(found) == pytest.approx(np.pi, abs=1e-14)
    np.testing.assert_allclose(rotation.exponential(found), matrix, atol=4e-15)


@given(rotation_vectors(), rotation_vectors(1.0))
def test_cross_products(vector: np.ndarray, other: np.ndarray) -> None:
    np.testing.assert_allclose(rotation.skew(vector) @ other, np.cross(vector, other), atol=1e-15)
    matrix = rotation.exponential(vector)
    np.testing.assert_allclose(rotation.skew(matrix @ other), matrix @ rotation.skew(other) @ matrix.T, atol=2e-15)


@given(rotation_vectors(3.0))
def test_right_jacobian_against_differences(vector: np.ndarray) -> None:
    matrix = rotation.exponential(vector)
    want = differences(lambda v: rotation.logarithm(matrix.T @ rotation.exponential(v)), vector, 1e-3)

    np.testing.assert_allclose(rotation.right_jacobian(vector), want, atol=1e-10)


@given(any_rotation)
def test_quaternions_are_those_of_spice(matrix: np.ndarray) -> None:
    quaternion = rotation.from_matrix(matrix)
    spice = spiceypy.m2q(matrix)

    np.testing.assert_allclose(quaternion * np.sign(quaternion @ spice), spice, atol=2e-15)
    np.testing.assert_allclose(rotation.to_matrix(quaternion), spiceypy.q2m(quaternion), atol=1e-15)
    np.testing.assert_allclose(rotation.to_matrix(quaternion), matrix, atol=4e-15)


def test_functions_work_over_leading_axes() -> None:
    vectors = np.random.default_rng(3).uniform(-2.0, 2.0, (4, 5, 3))
    matrices = rotation.exponential(vectors)

    for function, stack in (
        (rotation.exponential, vectors), (rotation.right_jacobian, vectors), (rotation.skew, vectors),
        (rotation.logarithm, matrices), (rotation.from_matrix, matrices), (rotation.omega_phi_kappa, matrices),
        (rotation.from_omega_phi_kappa, vectors),
    ):  # fmt: skip
        np.testing.assert_allclose(function(stack)[2, 3], function(stack[2, 3]), rtol=0, atol=1e-15)


@given(opk_angles())
def test_omega_phi_kappa_is_the_product_of_spice(angles: np.ndarray) -> None:
    """M' = R3(kappa) R2(phi) R1(omega), each passive as in NAIF eul2m."""
    omega, phi, kappa = angles
    matrix = rotation.from_omega_phi_kappa(angles)

    np.testing.assert_allclose(matrix.T, spiceypy.eul2m(kappa, phi, omega, 3, 2, 1), atol=1e-15)


@given(any_rotation)
def test_every_matrix_is_that_of_its_angles(matrix: np.ndarray) -> None:
    cosine = np.hypot(matrix[0, 0], matrix[0, 1])  # of phi: towards zero, omega and kappa become one
    assume(cosine > 1e-9)

    back = rotation.from_omega_phi_kappa(rotation.omega_phi_kappa(matrix))
    np.testing.assert_allclose(back, matrix, atol=4e-15 / cosine)


@pytest.mark.parametrize("camera_to_body", [True, False])
@given(angles=opk_angles())
def test_angle_axes_against_differences(angles: np.ndarray, camera_to_body: bool) -> None:
    """d(M d) = [M d]x T da for both products, M from body to camera."""

    def matrix(angles: np.ndarray) -> np.ndarray:
        made = rotation.from_omega_phi_kappa(angles)
        return made if camera_to_body else made.T

    axes = rotation.angle_axes(angles, camera_to_body)
    for k, body_vector in enumerate(np.eye(3)):
        want = differences(lambda a, d=body_vector: matrix(a) @ d, angles, 1e-3)
        np.testing.assert_allclose(rotation.skew(matrix(angles)[:, k]) @ axes, want, atol=1e-11)


@given(st.floats(-3.0, 3.0), st.floats(1e-6, np.pi - 1e-6), st.floats(-3.0, 3.0))
def test_angles_about_3_1_3_are_those_of_spice(a: float, b: float, c: float) -> None:
    """NAIF eul2m, as ISIS calls it (SpiceRotation)."""
    matrix = rotation.from_angles_313(np.array([a, b, c]))
    np.testing.assert_allclose(matrix, spiceypy.eul2m(c, b, a, 3, 1, 3), rtol=0, atol=2e-15)
    np.testing.assert_allclose(rotation.angles_313(matrix), [a, b, c], rtol=0, atol=1e-9)


# --- corrections


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
    found = -rotation.logarithm(pose.matrix @ NOMINAL.matrix.mT)
    np.testing.assert_allclose(found, correction[:, 3:], atol=1e-14)


@pytest.mark.parametrize("angles", ["opk-paper", "opk-peer"])
@given(c=coefficients)
def test_angle_corrections_add_to_the_angles(angles: Angles, c: np.ndarray) -> None:
    def angles_of(matrix: np.ndarray) -> np.ndarray:
        return rotation.omega_phi_kappa(matrix if angles == "opk-paper" else matrix.mT)

    pose = OrientationCorrection(c, angles).apply(NOMINAL, MOMENTS)
    correction = np.array([c[0] + c[1] * u + c[2] * u * u for u in U])
    want = rotation.from_omega_phi_kappa(angles_of(NOMINAL.matrix) + correction[:, 3:])

    np.testing.assert_allclose(pose.matrix, want if angles == "opk-paper" else want.mT, atol=1e-14)
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
            return -rotation.logarithm(matrix @ now.matrix.mT)

        np.testing.assert_allclose(axes[:, :, k], along(turn, 1e-3), atol=1e-9)


def test_an_unknown_convention_is_refused() -> None:
    with pytest.raises(InputError, match="angles: 'OPK'; expected one of camera, opk-paper, opk-peer"):
        OrientationCorrection(np.zeros((1, 6)), "OPK")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("sigmas", "said"),
    [
        (np.zeros((1, 6)), r"sigma 0\.0; expected positive sigmas"), (np.full((1, 6), np.nan), "sigma nan"),
    ],
)  # fmt: skip
def test_priors_are_positive(sigmas: np.ndarray, said: str) -> None:
    refuses(said, OrientationPrior, sigmas)


# --- orientation images


EPOCH = 1.3e8

NODES = np.array([0.0, 3.0, 5.0, 9.0, 10.0, 14.0, 20.0])


def seven_images() -> OrientationImages:
    return OrientationImages("lagrange", EPOCH, NODES)


@given(st.floats(-2.0, 22.0), st.lists(st.floats(-2.0, 2.0), min_size=4, max_size=4))
def test_lagrange_goes_through_any_cubic(time: float, coefficients: list[float]) -> None:
    nodes, cubic = seven_images(), np.polynomial.Polynomial(coefficients, domain=(0.0, 20.0), window=(-1.0, 1.0))
    values, rates = nodes.dense(np.array([time]), EPOCH)
    assert values[0] @ cubic(nodes.times) == pytest.approx(cubic(time), abs=1e-10)
    assert rates[0] @ cubic(nodes.times) == pytest.approx(cubic.deriv()(time), abs=1e-10)


def test_a_node_depends_on_its_own_neighbourhood_alone() -> None:
    nodes = seven_images()
    times = np.linspace(*nodes.coverage, 301)
    first, values, _ = nodes.at(times, EPOCH)
    inner = (times > nodes.times[1]) & (times < nodes.times[-2])
    left, right = nodes.times[first + 1], nodes.times[first + 2]
    assert np.all((left <= times + 1e-9)[inner])
    assert np.all((times <= right + 1e-9)[inner])
    assert values.shape == (301, 4)


def test_another_epoch_is_the_same_time() -> None:
    nodes, times = seven_images(), np.array([1.0, 7.5, 19.0])
    for one, other in zip(nodes.at(times, EPOCH), nodes.at(times - 40.0, EPOCH + 40.0), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


@given(length=st.floats(0.5, 2000.0), spacing=st.floats(0.3, 500.0))
def test_even_spacing_covers_the_strip_with_no_larger_steps(length: float, spacing: float) -> None:
    nodes = evenly_spaced("lagrange", EPOCH, (5.0, 5.0 + length), spacing)
    np.testing.assert_allclose(nodes.coverage, (5.0, 5.0 + length), rtol=1e-9)
    steps = np.diff(nodes.times)
    assert steps.max() <= spacing * (1.0 + 1e-6)
    assert len(nodes) == 4 or steps.max() > 0.4 * min(spacing, length / 3.0)


def test_bad_nodes() -> None:
    refuses("3 nodes; expected at least 4", OrientationImages, "lagrange", EPOCH, np.arange(3.0))
    refuses("increasing", OrientationImages, "lagrange", EPOCH, np.array([0.0, 2.0, 2.0, 3.0]))
    with pytest.raises(InputError, match="one of lagrange"):
        OrientationImages("cubic", EPOCH, NODES)  # type: ignore[arg-type]
    refuses(r"-1\.0 s; expected a positive number", evenly_spaced, "lagrange", EPOCH, (0.0, 10.0), -1.0)
