"""Nominal orientation in polynomials of time, fitted to a sampled trajectory: the papers', and ISIS jigsaw's.

The papers' are of X, Y, Z, omega, phi, kappa: Yoon & Shan 2005, eq. 2; order 2 fitted to 31 samples of the SPICE
orientation over the image is theirs. jigsaw's (CKDEGREE, without OVEREXISTING) are of the camera's three angles against
J2000, fitted to the records of its attitude table (ISIS SpiceRotation::SetPolynomial); positions stay as they are.
"""

from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.errors import EphemerisGap, InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.geometry.trajectory import AttitudeTable, Pose, Trajectory

_NODES = 2049
"""Records at which polynomials of the attitude are laid out again; the great arc between two is then on the curve."""


@dataclass(frozen=True, slots=True, eq=False)
class PolynomialTrajectory:
    """Position and attitude as polynomials of normalised time s = (2 t - start - stop) / (stop - start)."""

    epoch: float
    """s TDB past J2000 from which all times count."""
    start: float
    """s past the epoch, where s = -1: the first line's edge."""
    stop: float
    """s past the epoch, where s = 1: the last line's edge."""
    position: Array
    """(order + 1, 3) m, body-fixed X, Y, Z; row k belongs to s^k."""
    angles: Array
    """(order + 1, 3) rad, omega, phi, kappa as in `rotation.omega_phi_kappa`; row k belongs to s^k."""
    spin: Array | None = None
    """(3,) rad/s, angular velocity of the body against inertial space, in body-fixed axes; None where unknown."""

    def __post_init__(self) -> None:
        where = "polynomial trajectory"
        if not (np.isfinite([self.epoch, self.start, self.stop]).all() and self.start < self.stop):
            raise InputError(where, f"{self.start} .. {self.stop} s past {self.epoch} s", "finite, start before stop")
        position = frozen(self.position, f"{where}, position", (None, 3))
        angles = frozen(self.angles, f"{where}, angles", (None, 3))
        if not position.size or not angles.size:
            raise InputError(where, "no coefficients", "at least the constant ones")
        assign(self, position=position, angles=angles)
        if self.spin is not None:
            assign(self, spin=frozen(self.spin, f"{where}, spin", (3,)))

    @property
    def coverage(self) -> tuple[float, float]:
        """First and last time, s past the epoch, to which the polynomials were fitted."""
        return self.start, self.stop

    def require(self, times: Array, where: str, slack: float = 0.0) -> None:
        """Raise EphemerisGap, naming `where`, unless all times (n,) lie in the coverage widened by `slack` seconds."""
        beyond = np.flatnonzero(~(np.maximum(self.start - times, times - self.stop) <= slack))
        if beyond.size:
            first = float(times[beyond[0]])
            raise EphemerisGap(where, *(self.epoch + time for time in (first, self.start, self.stop)))

    def pose(self, times: Array) -> Pose:
        """Pose at times (n,) in s past the epoch, rates per second; outside the coverage the polynomials go on."""
        rate = 2.0 / (self.stop - self.start)
        s = rate * (times - self.start) - 1.0
        from mgsgraph.geometry.compiled_pose import polynomial_poses  # compiled: not before it is needed

        pose = Pose(np.empty((s.size, 3)), np.empty((s.size, 3)), np.empty((s.size, 3, 3)), np.empty((s.size, 3)))
        where = pose.position, pose.velocity, pose.matrix, pose.angular_rate
        polynomial_poses(s, rate, self.position, self.angles, *where)
        return pose


def fit_polynomials(image: PushbroomImage, order: int = 2, samples: int = 31) -> PushbroomImage:
    """The same image with polynomials in place of its trajectory.

    Parameters
    ----------
    image : PushbroomImage
        With its trajectory as read.
    order : int
        Of the polynomials, at least 0.
    samples : int
        Places, evenly spread in time from the first line's edge to the last one's, that they are fitted to by least
        squares; more than `order`.

    Returns
    -------
    PushbroomImage
        Its trajectory a `PolynomialTrajectory`.
    """
    if order < 0 or samples <= order:
        raise InputError(f"image {image.name}, polynomials", f"order {order} through {samples} samples", "more samples")
    (start, stop), _ = image.timing.at(np.array([0.0, float(image.lines)]))
    s = np.linspace(-1.0, 1.0, samples)
    times = start + 0.5 * (s + 1.0) * (stop - start)
    pose = image.trajectory.pose(times)
    # Legendre's basis keeps the equations well conditioned; the record holds plain powers of s
    basis = np.polynomial.legendre.legvander(s, order)
    values = np.hstack([pose.position, np.unwrap(rotation.omega_phi_kappa(pose.matrix), axis=0)])
    fitted = np.linalg.lstsq(basis, values, rcond=None)[0]
    coefficients = np.zeros((order + 1, 6))
    for column in range(6):
        powers = np.polynomial.legendre.leg2poly(fitted[:, column])
        coefficients[: powers.size, column] = powers
    trajectory = PolynomialTrajectory(
        image.trajectory.epoch, float(start), float(stop), coefficients[:, :3], coefficients[:, 3:],
        image.trajectory.spin,
    )  # fmt: skip
    return replace(image, trajectory=trajectory)


def fit_attitude(image: PushbroomImage, order: int = 2) -> PushbroomImage:
    """The same image with polynomials in place of its attitude, as jigsaw's CKDEGREE fits them.

    Parameters
    ----------
    image : PushbroomImage
        With its trajectory as read.
    order : int
        Of the polynomials, at least 0, and below the number of records of the attitude table.

    Returns
    -------
    PushbroomImage
        Its trajectory's attitude table is of the polynomials; over the table's own times, not the image's.

    Raises
    ------
    InputError
        A trajectory that is no table, or with too few records.
    """
    where, trajectory = f"image {image.name}, polynomials of its attitude", image.trajectory
    if not isinstance(trajectory, Trajectory):
        raise InputError(where, "an orientation in polynomials already", "the tables of support data, cubes or kernels")
    table = trajectory.camera
    if not 0 <= order < table.times.size:
        raise InputError(where, f"order {order} through {table.times.size} records", "more records than the order")
    middle, half = 0.5 * (table.times[0] + table.times[-1]), 0.5 * (table.times[-1] - table.times[0])
    angles = np.unwrap(rotation.angles_313(rotation.to_matrix(table.quaternions)), axis=0)
    legendre = np.polynomial.legendre
    fitted = np.linalg.lstsq(legendre.legvander((table.times - middle) / half, order), angles, rcond=None)[0]
    s = np.linspace(-1.0, 1.0, _NODES)
    quaternions = rotation.from_matrix(rotation.from_angles_313(legendre.legvander(s, order) @ fitted))
    smooth = AttitudeTable(middle + half * s, rotation.continuous(quaternions), table.constant)
    return replace(image, trajectory=replace(trajectory, camera=smooth))
