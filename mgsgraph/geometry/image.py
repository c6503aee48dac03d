"""One pushbroom image: when and from where each line was taken, and the relation of image and ground coordinates.

Ground to image is a search over the lines (`geometry.line_search`).

Nominal orientation in polynomials of time, fitted to a sampled trajectory: the papers', and ISIS jigsaw's.

The papers' are of X, Y, Z, omega, phi, kappa: Yoon & Shan 2005, eq. 2; order 2 fitted to 31 samples of the SPICE
orientation over the image is theirs. jigsaw's (CKDEGREE, without OVEREXISTING) are of the camera's three angles against
J2000, fitted to the records of its attitude table (ISIS SpiceRotation::SetPolynomial); positions stay as they are.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Protocol

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.factors.algebra import transform
from mgsgraph.factors.collinearity import (
    by_interior,
    by_point,
    by_ray,
    by_rotation,
    image_motion,
    ray_motion,
    to_lines_and_samples,
)
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import Ellipsoid, intersect_ellipsoid
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.orientation import Moments, OrientationCorrection
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.geometry.trajectory import AttitudeTable, Pose, Trajectory, require_covered
from mgsgraph.record import Record

if TYPE_CHECKING:
    from mgsgraph.geometry.line_search import Sightings

@dataclass(frozen=True, slots=True, eq=False)
class LineTiming(Record):
    """Time of each line, with one constant line period per segment.

    Examples
    --------
    >>> timing = mgsgraph.LineTiming(np.array([0.0]), np.array([-2.0]), np.array([2e-3]))
    >>> seconds, period = timing.at(np.array([0.0, 1000.0]))
    >>> seconds, timing.lines(seconds)
    (array([-2.,  0.]), array([   0., 1000.]))
    """

    first_lines: Array
    """(s,) line coordinate at which each segment begins (0.0 is the top edge of the image), increasing."""
    start_times: Array
    """(s,) s past the trajectory's epoch, time of that edge."""
    periods: Array
    """(s,) s per image line, positive."""

    def __post_init__(self) -> None:
        lines = frozen(self.first_lines, "line timing, first lines", (None,))
        if lines.size == 0 or np.any(np.diff(lines) <= 0.0):
            raise InputError("line timing, first lines", f"{lines.tolist()}", "at least one, increasing")
        periods = frozen(self.periods, "line timing, periods", (lines.size,))
        require(np.all(periods > 0.0), "line timing, periods", f"{periods.min()} s per line", "positive periods")
        starts = frozen(self.start_times, "line timing, start times", (lines.size,))
        if np.any(np.diff(starts) <= 0.0):
            raise InputError("line timing, start times", "times that go back", "increasing start times")
        assign(self, first_lines=lines, start_times=starts, periods=periods)
        for k in np.flatnonzero(self.pauses < -1.0)[:1]:
            where, late = f"line timing, segment from line {lines[k]}", -self.pauses[k] * periods[k]
            raise InputError(where, f"it ends {late:.6f} s after the next begins", "segments one after the other")

    @property
    def pauses(self) -> Array:
        """(s - 1,) between segments, in lines of the one before; negative where they overlap."""
        before = self.start_times[:-1] + np.diff(self.first_lines) * self.periods[:-1]
        return np.asarray((self.start_times[1:] - before) / self.periods[:-1])

    def at(self, lines: Array) -> tuple[Array, Array]:
        """Times (n,) in s past the epoch of lines (n,), and seconds per line there."""
        if self.periods.size == 1:
            return self.start_times + (lines - self.first_lines) * self.periods, np.full(np.shape(lines), self.periods)
        k = np.maximum(np.searchsorted(self.first_lines, lines, side="right") - 1, 0)
        return self.start_times[k] + (lines - self.first_lines[k]) * self.periods[k], self.periods[k]

    def lines(self, times: Array) -> Array:
        """Lines (n,) that are read at times (n,); inverse of `at`. In a pause, the line at which it goes on."""
        k = np.clip(np.searchsorted(self.start_times, times, side="right") - 1, 0, None)
        goes_on = np.append(self.first_lines[1:], np.inf)
        return np.asarray(np.minimum(self.first_lines[k] + (times - self.start_times[k]) / self.periods[k], goes_on[k]))


class ExteriorOrientation(Protocol):
    """Position and attitude of the camera over its image: sampled (`Trajectory`) or as polynomials of time."""

    @property
    def epoch(self) -> float:
        """Zero of all times, s TDB past J2000."""
        ...

    @property
    def coverage(self) -> tuple[float, float]:
        """First and last time, s past the epoch, at which it holds."""
        ...

    @property
    def spin(self) -> Array | None:
        """(3,) rad/s, angular velocity of the body against inertial space, in body-fixed axes; None where unknown."""
        ...

    @property
    def knots(self) -> Array:
        """(k,) s past the epoch, times at which its rates may jump."""
        ...

    def require(self, times: Array, where: str, slack: float = 0.0) -> None:
        """Raise EphemerisGap, naming `where`, unless all times (n,) lie in the coverage widened by `slack` seconds."""
        ...

    def pose(self, times: Array) -> Pose:
        """Pose at times (n,) in s past the epoch, rates per second."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class PushbroomImage(Record):
    """A line-scanner image with everything that its geometry needs.

    Examples
    --------
    >>> image = network.images[0]
    >>> ground, _ = image.image_to_ground(np.array([2500.0]), np.array([512.0]), 100.0)
    >>> pixel, _ = image.ground_to_image(ground)
    >>> pixel.round(6)
    array([[2500.,  512.]])
    """

    name: str
    """By which networks and shots refer to it (ISIS serial number, product id)."""
    lines: int
    """Number of lines."""
    samples: int
    """Number of samples."""
    interior: InteriorOrientation
    """Camera constants."""
    timing: LineTiming
    """Line to time."""
    trajectory: ExteriorOrientation
    """Nominal exterior orientation."""
    body: Ellipsoid
    """Reference ellipsoid of the body it shows."""
    remarks: tuple[str, ...] = ()
    """What its reader decided or corrected, in phrases."""
    mission: str = ""
    """As ISIS's serial numbers begin (MGS, MRO, LRO, KAGUYA, MEX); empty where its file doesn't say."""

    @property
    def middle(self) -> tuple[Array, Array]:
        """Line (1,) and sample (1,) of its middle."""
        return np.array([0.5 * self.lines]), np.array([0.5 * self.samples])

    def __post_init__(self) -> None:
        require(self.name, "image", "an empty name", "the name by which networks refer to it")
        if self.lines < 1 or self.samples < 1:
            raise InputError(f"image {self.name}", f"{self.lines} x {self.samples} lines x samples", "at least 1 x 1")
        edges, period = self.timing.at(np.array([0.0, float(self.lines)]))
        self.trajectory.require(edges, f"image {self.name}, first or last line", slack=2.0 * float(period.max()))

    def normalised(self, lines: Array) -> Array:
        """Normalised line u in [-1, 1]: 2 line / lines - 1; the variable of the orientation polynomials."""
        return 2.0 * lines / self.lines - 1.0

    @property
    def normalised_rate(self) -> float:
        """Derivative of the normalised line u by the line, per line."""
        return 2.0 / self.lines

    @property
    def span(self) -> Array:
        """(2,) s TDB past J2000, when the first line begins and the last one ends."""
        return self.timing.at(np.array([0.0, float(self.lines)]))[0] + self.trajectory.epoch

    @property
    def pixel_angle(self) -> float:
        """Angle across a detector pixel in the middle of the image, rad."""
        _, slope = self.interior.focal_plane(self.middle[1])
        return float(np.linalg.norm(slope[0])) / self.interior.focal_length

    def pose(self, lines: Array, correction: OrientationCorrection | None = None) -> Pose:
        """Exterior orientation at lines (n,), rates per line; corrected when a correction is given."""
        moments = self.moments(lines)
        nominal = self.trajectory.pose(moments.times).scaled(moments.periods)
        return nominal if correction is None else correction.apply(nominal, moments)

    def moments(self, lines: Array) -> Moments:
        """Where on the image and when lines (n,) are: what orientation corrections are functions of."""
        times, periods = self.timing.at(lines)
        return Moments(self.normalised(lines), self.normalised_rate, times, periods, self.trajectory.epoch)

    def rays(
        self, lines: Array, samples: Array, correction: OrientationCorrection | None = None
    ) -> tuple[Array, Array, Array, Array]:
        """Rays of image places, with derivatives.

        Parameters
        ----------
        lines, samples : (n,)
            image place, first pixel's centre at (0.5, 0.5).
        correction : OrientationCorrection, optional
            of the nominal orientation; none when absent.

        Returns
        -------
        origins, directions : (n, 3)
            m, body-fixed; directions have the focal length along the optical axis.
        d_origins, d_directions : (n, 3, 2)
            per line and per sample.
        """
        pose = self.pose(lines, correction)
        look, direction, slope = self._looks(pose, samples)
        d_origins = np.stack([pose.velocity, np.zeros_like(pose.velocity)], axis=2)
        along_detector = np.column_stack([slope, np.zeros(samples.size)])
        turned = np.stack([np.cross(pose.angular_rate, look), along_detector], axis=2)
        return pose.position, direction, d_origins, pose.matrix.mT @ turned

    def sightlines(
        self, lines: Array, samples: Array, correction: OrientationCorrection | None = None
    ) -> tuple[Array, Array]:
        """Origins and directions (n, 3) of `rays`, without their derivatives."""
        pose = self.pose(lines, correction)
        return pose.position, self._looks(pose, samples)[1]

    def _looks(self, pose: Pose, samples: Array) -> tuple[Array, Array, Array]:
        """Directions (n, 3) in camera axes and body-fixed, the focal length along the optical axis, and the slope
        (n, 2) of the detector.
        """
        place, slope = self.interior.focal_plane(samples)
        look = np.column_stack([place, np.full(samples.size, self.interior.focal_length)])
        return look, np.einsum("nji,nj->ni", pose.matrix, look), slope

    def image_to_ground(
        self,
        lines: Array,
        samples: Array,
        height: Array | float = 0.0,
        correction: OrientationCorrection | None = None,
    ) -> tuple[Array, Array]:
        """Ground points (n, 3) in m, body-fixed, of image places at a height (m) above the ellipsoid, and (n, 3, 2)
        derivatives per line and sample; NaN where the ray misses the body.
        """
        origins, directions, d_origins, d_directions = self.rays(lines, samples, correction)
        points, by_origin, by_direction = intersect_ellipsoid(origins, directions, self.body, height)
        return points, by_origin @ d_origins + by_direction @ d_directions

    def ground_to_image(
        self, points: Array, correction: OrientationCorrection | None = None, start: Array | None = None
    ) -> tuple[Array, Array]:
        """Image places of ground points.

        A point seen several times (`sightings` has all places) is given where the body is not between; of such places
        that in the image, or least outside it in shares of its lines and samples; of several in it the first one.

        Parameters
        ----------
        points : (n, 3)
            m, body-fixed.
        correction : OrientationCorrection, optional
            of the nominal orientation; none when absent.
        start : (n,), optional
            lines: of places where the body is not between the one nearest to it is given. NaN where none is known.

        Returns
        -------
        places : (n, 2)
            line and sample, which may lie outside the image; NaN where the point is behind the camera or more than
            half its length before or after, or twice its width beside the image. The body does not hide anything.
        jacobian : (n, 2, 3)
            d(line, sample) / d(point), per m.
        """
        hits, size = self.sightings(points, correction), np.array([self.lines, self.samples])
        chosen = np.arange(hits.point.size)
        if np.any(np.diff(hits.point) == 0):
            beside = np.abs(hits.places / size - 0.5).max(axis=1)
            away = np.maximum(beside, 0.5) if start is None else np.abs(hits.places[:, 0] - start[hits.point])
            chosen = np.lexsort([hits.places[:, 0], away, hits.hidden, hits.point])
            chosen = chosen[np.flatnonzero(np.diff(hits.point, prepend=-1))]
        places, jacobian = np.full((len(points), 2), np.nan), np.full((len(points), 2, 3), np.nan)
        places[hits.point[chosen]], jacobian[hits.point[chosen]] = hits.places[chosen], hits.jacobian[chosen]
        return places, jacobian

    def sightings(self, points: Array, correction: OrientationCorrection | None = None) -> "Sightings":
        """All places at which it sees ground points (n, 3) in m, body-fixed, within the bounds of `ground_to_image`: a
        camera that turns sees some twice, and behind the body lie others.
        """
        from mgsgraph.geometry.line_search import Scan, sightings  # compiled: not before it is needed

        knots = [self.timing.lines(self.trajectory.knots)]
        if correction is not None and correction.nodes is not None:
            nodes = correction.nodes
            knots.append(self.timing.lines(nodes.times + (nodes.epoch - self.trajectory.epoch)))
        size = np.array([self.lines, self.samples], dtype=np.float64)
        scan = Scan(
            lambda lines: self.pose(lines, correction), size, self.interior, np.concatenate(knots),
            self.timing.first_lines[1:], self.timing.pauses,
        )  # fmt: skip
        return sightings(scan, np.ascontiguousarray(points, dtype=np.float64))

    def by_correction(self, points: Array, places: Array, correction: OrientationCorrection) -> Array:
        """(n, 2, 9) derivatives of the image places (n, 2) of ground points (n, 3), as `ground_to_image` finds them, by
        the position (m) and the rotation (rad) with which the orientation is corrected at their lines, and by the
        detector's x and y and the focal length (m).
        """
        moments = self.moments(places[:, 0])
        nominal = self.pose(places[:, 0])
        pose, axes = correction.apply(nominal, moments), rotation.rows(correction.axes(nominal, moments))
        attitude, focal = rotation.rows(pose.matrix), self.interior.focal_length
        ray = transform(attitude, rotation.components(points - pose.position))
        motion = ray_motion(attitude, ray, rotation.components(pose.velocity), rotation.components(pose.angular_rate))
        slope = rotation.components(self.interior.focal_plane(places[:, 1])[1])
        scale, rows = to_lines_and_samples(image_motion(ray, motion, focal), slope), []
        for row, of_image in zip(by_ray(scale, ray, focal), scale, strict=True):
            parts = by_point(row, attitude), by_rotation(row, ray, axes), by_interior(of_image, ray)
            by_place, *rest = map(rotation.stacked, parts)  # of residuals, which are opposite to the place
            rows.append(np.hstack([by_place, *(-other for other in rest)]))
        return np.stack(rows, axis=1)


_NODES = 2049
"""Records at which polynomials of the attitude are sampled; the great arc between two is then on the curve."""


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
    paper: ClassVar[bool] = True
    """Whether R3(kappa) R2(phi) R1(omega) takes camera to body, as in the papers; else body to camera."""

    def __post_init__(self) -> None:
        where = "polynomial trajectory"
        if not (np.isfinite([self.epoch, self.start, self.stop]).all() and self.start < self.stop):
            raise InputError(where, f"{self.start} .. {self.stop} s past {self.epoch} s", "finite, start before stop")
        position = frozen(self.position, f"{where}, position", (None, 3))
        angles = frozen(self.angles, f"{where}, angles", (None, 3))
        require(position.size and angles.size, where, "no coefficients", "at least the constant ones")
        assign(self, position=position, angles=angles)
        if self.spin is not None:
            assign(self, spin=frozen(self.spin, f"{where}, spin", (3,)))

    @property
    def coverage(self) -> tuple[float, float]:
        """First and last time, s past the epoch, to which the polynomials were fitted."""
        return self.start, self.stop

    @property
    def knots(self) -> Array:
        """None: polynomials are smooth."""
        return np.zeros(0)

    def require(self, times: Array, where: str, slack: float = 0.0) -> None:
        """Raise EphemerisGap, naming `where`, unless all times (n,) lie in the coverage widened by `slack` seconds."""
        require_covered(self.coverage, times, self.epoch, where, slack)

    def pose(self, times: Array) -> Pose:
        """Pose at times (n,) in s past the epoch, rates per second; outside the coverage the polynomials go on."""
        rate = 2.0 / (self.stop - self.start)
        s = rate * (times - self.start) - 1.0
        from mgsgraph.geometry.compiled_pose import polynomial_poses  # compiled: not before it is needed

        pose = Pose(np.empty((s.size, 3)), np.empty((s.size, 3)), np.empty((s.size, 3, 3)), np.empty((s.size, 3)))
        where = pose.position, pose.velocity, pose.matrix, pose.angular_rate
        polynomial_poses(s, rate, self.paper, self.position, self.angles, *where)
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
