"""Rotations: group axioms, SPICE's conventions, and derivatives against central differences."""

import numpy as np
import pytest
import spiceypy
from hypothesis import assume, given
from hypothesis import strategies as st
from strategies import differences, directions, opk_angles, rotation_vectors

from mgsgraph.geometry import rotation

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
