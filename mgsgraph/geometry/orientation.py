"""Exterior orientation as a correction of the nominal trajectory: pose(u) = nominal(u) (+) sum_k B_k(u) c_k.

The coefficients c_k are 6-vectors: position in m along the body-fixed axes, then a rotation vector in rad about the
camera axes, so that the camera frame is turned by it: M = Exp([theta]x)' M_nominal; or, by choice, additions to the
nominal omega, phi, kappa, of the papers' product M' = R3 R2 R1 (camera to body, opk-paper) or of M = R3 R2 R1 (body to
camera, opk-peer). B_k(u) = u^k (Yoon & Shan 2005, Eq. 2, as corrections to SPICE), or the basis of a strip's
orientation images (Hofmann et al. 1982), or both: whatever acts linearly on the pose.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.factors.pose import opk_paper, opk_peer
from mgsgraph.geometry import rotation
from mgsgraph.geometry.orientation_images import SUPPORT, OrientationImages
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.record import Record

Angles = Literal["camera", "opk-paper", "opk-peer"]
"""What the rotation part of a coefficient is: about the camera axes, or added to omega, phi, kappa."""

COMPONENTS = ("X", "Y", "Z", "rotation x", "rotation y", "rotation z")
"""Names of the six components of a coefficient: m along the body-fixed axes, rad about the camera axes."""


def polynomial(u: Array, degree: int) -> tuple[Array, Array]:
    """Values and derivatives d/du of the basis 1, u, ..., u^degree at u (n,); two arrays (n, degree + 1)."""
    values = np.vander(u, degree + 1, increasing=True)
    return values, np.hstack([np.zeros((u.size, 1)), np.arange(1, degree + 1) * values[:, :-1]])


class Moments(NamedTuple):
    """Where on its image, and when, each of n lines was taken: what bases are functions of."""

    u: Array
    """(n,) normalised line in [-1, 1]."""
    u_rate: float
    """du/dline."""
    times: Array
    """(n,) s past the epoch."""
    periods: Array
    """(n,) s per line there."""
    epoch: float
    """s TDB past J2000."""

    @classmethod
    def of_times(cls, times: Array, epoch: float) -> "Moments":
        """Of times (n,) in s past `epoch` that are no image's lines: for what depends on time alone."""
        nowhere = np.zeros(times.size)
        return cls(nowhere, 0.0, times, nowhere, epoch)


@dataclass(frozen=True, slots=True, eq=False)
class OrientationPrior(Record):
    """What is known of one image's orientation corrections beforehand: zero mean, and a sigma for each coefficient.

    Examples
    --------
    >>> constant = np.array([50.0, 50.0, 50.0, 1e-4, 1e-4, 1e-4])
    >>> prior = mgsgraph.OrientationPrior(np.stack([constant, 0.1 * constant]))
    >>> prior.degree
    1
    """

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
class OrientationCorrection(Record):
    """Coefficients of one image's orientation corrections.

    Examples
    --------
    >>> correction = solution.correction("SIM/A")
    >>> correction.coefficients.shape, correction.angles
    ((3, 6), 'camera')
    >>> place, _ = network.images[0].ground_to_image(solution.places[:1], correction)
    >>> (network.rays.places[0] - place[0]).round(2)
    array([-0.79,  0.  ])
    """

    coefficients: Array
    """(d, 6) m and rad: of a polynomial of the normalised line, constant term first, and then of the orientation images
    of its strip."""
    angles: Angles = "camera"
    """What the rotation part is."""
    nodes: OrientationImages | None = None
    """Orientation images of its strip; None for a polynomial alone."""

    def __post_init__(self) -> None:
        if self.angles not in get_args(Angles):
            known = ", ".join(get_args(Angles))
            raise InputError("orientation correction, angles", repr(self.angles), f"one of {known}")
        coefficients = frozen(self.coefficients, "orientation coefficients", (None, 6))
        if self.nodes is not None and coefficients.shape[0] < len(self.nodes):
            found, expected = f"{coefficients.shape[0]} rows", f"one for each of {len(self.nodes)} nodes, at least"
            raise InputError("orientation coefficients", found, expected)
        assign(self, coefficients=coefficients)

    @property
    def polynomial_terms(self) -> int:
        """Rows that belong to the polynomial."""
        return int(self.coefficients.shape[0]) - (0 if self.nodes is None else len(self.nodes))

    def basis(self, moments: Moments) -> Array:
        """(n, d) what each row of coefficients counts at n lines; dense, for few of them."""
        values, _ = polynomial(moments.u, self.polynomial_terms - 1)
        if self.nodes is None:
            return values
        return np.hstack([values, self.nodes.dense(moments.times, moments.epoch)[0]])

    def at(self, moments: Moments) -> tuple[Array, Array]:
        """Correction (n, 6) in m and rad at n lines, and its derivative per line (n, 6)."""
        values, rates = polynomial(moments.u, self.polynomial_terms - 1)
        plain = self.coefficients[: self.polynomial_terms]
        correction, slope = values @ plain, rates @ plain * moments.u_rate
        if self.nodes is not None:
            first, values, rates = self.nodes.at(moments.times, moments.epoch)
            near = self.coefficients[self.polynomial_terms + first[:, None] + np.arange(SUPPORT)]
            correction += np.einsum("nk,nkc->nc", values, near)
            slope += np.einsum("nk,nkc->nc", rates * moments.periods[:, None], near)
        return correction, slope

    def apply(self, nominal: Pose, moments: Moments) -> Pose:
        """Corrected pose of nominal poses (rates per line) at n lines."""
        return corrected(nominal, *self.at(moments), self.angles)

    def axes(self, nominal: Pose, moments: Moments) -> Array:
        """(n, 3, 3): how the camera turns, about its own axes, per rad of each rotation component at n lines."""
        return correction_axes(nominal, self.at(moments)[0], self.angles)


def corrected(nominal: Pose, correction: Array, slope: Array, angles: Angles) -> Pose:
    """Corrected poses of nominal ones, of one image or of many.

    Parameters
    ----------
    nominal : Pose
        n nominal poses, rates per line.
    correction, slope : (n, 6)
        m and rad, and their derivatives per line.
    angles : Angles
        What the rotation part is.
    """
    position, velocity = nominal.position + correction[:, :3], nominal.velocity + slope[:, :3]
    if angles == "camera":
        return Pose(position, velocity, *_turned(nominal, correction[:, 3:], slope[:, 3:]))
    attitude_of, at, rates = _nominal_angles(nominal, angles)
    turn, turn_rate = (rotation.components(part[:, 3:]) for part in (correction, slope))
    matrix, _, rate = attitude_of(at, rates, 0.0, turn, turn_rate)
    return Pose(position, velocity, rotation.matrices(matrix), rotation.stacked(rate))


def correction_axes(nominal: Pose, correction: Array, angles: Angles) -> Array:
    """(n, 3, 3): how the camera turns, about its own axes, per rad of each rotation component of corrections (n, 6), m
    and rad, of n nominal poses.
    """
    turn = correction[:, 3:]
    if angles == "camera":
        return rotation.right_jacobian(turn)
    attitude_of, at, rates = _nominal_angles(nominal, angles)
    return rotation.matrices(attitude_of(at, rates, 0.0, *[rotation.components(turn)] * 2)[1])


def _nominal_angles(nominal: Pose, angles: Angles) -> tuple[Callable[..., Any], tuple[Array, ...], tuple[Array, ...]]:
    """The equation of `factors.pose` that adds to angles, and nominal angles and rates as it takes them."""
    paper = angles == "opk-paper"
    nominal_angles = rotation.omega_phi_kappa(nominal.matrix if paper else np.swapaxes(nominal.matrix, 1, 2))
    rates = np.linalg.solve(rotation.angle_axes(nominal_angles, paper), nominal.angular_rate[:, :, None])[:, :, 0]
    return opk_paper if paper else opk_peer, rotation.components(nominal_angles), tuple(rates.T)


def _turned(nominal: Pose, turn: Array, turn_rate: Array) -> tuple[Array, Array]:
    """Attitudes (n, 3, 3) and how the camera turns (n, 3), turned by a correction about its axes (n, 3)."""
    from mgsgraph.geometry.compiled_pose import turned_attitudes  # compiled: not before it is needed

    matrix, rate = np.empty((len(turn), 3, 3)), np.empty((len(turn), 3))
    turned_attitudes(
        rotation.from_matrix(nominal.matrix), np.ascontiguousarray(nominal.angular_rate), np.ascontiguousarray(turn),
        np.ascontiguousarray(turn_rate), matrix, rate,
    )  # fmt: skip
    return matrix, rate
