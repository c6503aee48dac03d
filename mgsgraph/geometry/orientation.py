"""Exterior orientation as a correction of the nominal trajectory: pose(u) = nominal(u) (+) sum_k B_k(u) c_k.

The coefficients c_k are 6-vectors: position in m along the body-fixed axes, then a rotation vector in rad about the
camera axes, so that the camera frame is turned by it: M = Exp([theta]x)' M_nominal; or, by choice, additions to the
nominal omega, phi, kappa, in the papers' product (camera to body) or the peer's (body to camera). B_k(u) = u^k (Yoon &
Shan 2005, Eq. 2, as corrections to SPICE). Other bases that act linearly on the pose fit the same place.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.geometry.trajectory import Pose

Angles = Literal["camera", "opk-paper", "opk-peer"]
"""What the rotation part of a coefficient is: about the camera axes, or added to omega, phi, kappa."""

COMPONENTS = ("X", "Y", "Z", "rotation x", "rotation y", "rotation z")
"""Names of the six components of a coefficient: m along the body-fixed axes, rad about the camera axes."""


def polynomial(u: Array, degree: int) -> tuple[Array, Array]:
    """Values and derivatives d/du of the basis 1, u, ..., u^degree at u (n,); two arrays (n, degree + 1)."""
    powers = np.arange(degree + 1)
    values = u[:, None] ** powers
    rates = np.zeros_like(values)
    rates[:, 1:] = powers[1:] * values[:, :-1]
    return values, rates


@dataclass(frozen=True, slots=True, eq=False)
class OrientationPrior:
    """What is known of one image's orientation corrections beforehand: zero mean, and a sigma for each coefficient."""

    sigmas: Array
    """(degree + 1, 6) m and rad; infinite where nothing is known."""

    def __post_init__(self) -> None:
        sigmas = np.array(self.sigmas, dtype=np.float64)
        if sigmas.ndim != 2 or sigmas.shape[1] != 6 or sigmas.shape[0] < 1:
            raise InputError("orientation prior", f"shape {sigmas.shape}", "(degree + 1, 6)")
        if np.any(np.isnan(sigmas)) or np.any(sigmas <= 0.0):
            raise InputError("orientation prior", f"sigma {sigmas[~(sigmas > 0.0)][0]}", "positive sigmas")
        sigmas.flags.writeable = False
        assign(self, sigmas=sigmas)

    @property
    def degree(self) -> int:
        """Degree of the orientation polynomials."""
        return int(self.sigmas.shape[0]) - 1


@dataclass(frozen=True, slots=True, eq=False)
class OrientationCorrection:
    """Coefficients of one image's orientation corrections."""

    coefficients: Array
    """(degree + 1, 6) m and rad."""
    angles: Angles = "camera"
    """What the rotation part is."""

    def __post_init__(self) -> None:
        if self.angles not in get_args(Angles):
            known = ", ".join(get_args(Angles))
            raise InputError("orientation correction, angles", repr(self.angles), f"one of {known}")
        assign(self, coefficients=frozen(self.coefficients, "orientation coefficients", (None, 6)))

    def at(self, u: Array) -> tuple[Array, Array]:
        """Correction (n, 6) in m and rad at normalised lines u (n,), and its derivative d/du (n, 6)."""
        values, rates = polynomial(u, self.coefficients.shape[0] - 1)
        return values @ self.coefficients, rates @ self.coefficients

    def apply(self, nominal: Pose, u: Array, rate: float) -> Pose:
        """Corrected pose of nominal poses (rates per line) at normalised lines u (n,), with `rate` = du/dline."""
        correction, slope = self.at(u)
        turn, turn_rate = correction[:, 3:], slope[:, 3:] * rate
        if self.angles == "camera":
            back = np.swapaxes(rotation.exponential(turn), 1, 2)
            turning = np.einsum("nij,nj->ni", back, nominal.turning)
            turning += np.einsum("nij,nj->ni", rotation.right_jacobian(turn), turn_rate)
            matrix = back @ nominal.matrix
        else:
            matrix, turning = self._add_angles(nominal, turn, turn_rate)
        position = nominal.position + correction[:, :3]
        return Pose(position, nominal.velocity + slope[:, :3] * rate, matrix, turning)

    def _add_angles(self, nominal: Pose, turn: Array, turn_rate: Array) -> tuple[Array, Array]:
        """Matrix and turning of the pose whose omega, phi, kappa are larger by `turn` (n, 3), rates by `turn_rate`."""
        paper = self.angles == "opk-paper"
        before = rotation.omega_phi_kappa(nominal.matrix if paper else np.swapaxes(nominal.matrix, 1, 2))
        rates = np.linalg.solve(rotation.angle_axes(before, paper), nominal.turning[:, :, None])[:, :, 0]
        after = before + turn
        product = rotation.from_omega_phi_kappa(after)
        turning = np.einsum("nij,nj->ni", rotation.angle_axes(after, paper), rates + turn_rate)
        return product if paper else np.swapaxes(product, 1, 2), turning

    def axes(self, nominal: Pose, u: Array) -> Array:
        """(n, 3, 3): how the camera turns, about its own axes, per rad of each rotation component at lines u (n,)."""
        turn = self.at(u)[0][:, 3:]
        if self.angles == "camera":
            return rotation.right_jacobian(turn)
        paper = self.angles == "opk-paper"
        before = rotation.omega_phi_kappa(nominal.matrix if paper else np.swapaxes(nominal.matrix, 1, 2))
        return rotation.angle_axes(before + turn, paper)
