"""Position and attitude of the camera: sampled position and attitude, interpolated as ISIS and SPICE do.

Position tables are inertial and interpolated by cubic Hermite polynomials; attitude tables turn uniformly between two
samples (the great arc, as SPICE CK type 3 and ISIS). The two are brought to the body-fixed frame at the asked time.

Times are counted from an epoch of the trajectory's own, near its middle: ephemeris time in one float64 resolves 6e-8 s,
which is 2e-4 lines of LROC-NAC.

A sampled trajectory that is known against the body alone: how the body turns in inertial space is not.

Times of an archive in s TDB past J2000: terrestrial time as LOLA's records have it, UTC as tables write it.

The difference of TDB and TT is the term of one year that SPICE has (leap seconds kernel: DELTET/K, EB, M), 1.7 ms: to a
spacecraft 2.7 m of its way. The leap seconds are those of IERS Bulletin C from 1972 up to now.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cached_property

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mgsgraph.errors import EphemerisGap, InputError, require
from mgsgraph.geometry import rotation
from mgsgraph.geometry.records import Array, assign, frozen, read_only
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.record import Record


def _check_times(times: Array, where: str) -> None:
    require(times.size >= 2, where, f"{times.size} samples", "at least 2")
    step = np.diff(times)
    if np.any(step <= 0.0):
        k = int(np.argmax(step <= 0.0))
        raise InputError(where, f"times {times[k]:.6f} s and {times[k + 1]:.6f} s in this order", "increasing times")


@dataclass(frozen=True, slots=True, eq=False)
class PositionTable(Record):
    """Sampled geometric position of the camera relative to the body's centre."""

    times: Array
    """(n,) s past the trajectory's epoch, increasing."""
    positions: Array
    """(n, 3) m, inertial frame."""
    velocities: Array
    """(n, 3) m/s, inertial frame."""

    def __post_init__(self) -> None:
        times = frozen(self.times, "position table, times", (None,))
        _check_times(times, "position table")
        assign(
            self,
            times=times,
            positions=frozen(self.positions, "position table, positions", (times.size, 3)),
            velocities=frozen(self.velocities, "position table, velocities", (times.size, 3)),
        )

    def at(self, times: Array) -> tuple[Array, Array]:
        """Position (n, 3) in m and velocity (n, 3) in m/s at times (n,), by cubic Hermite interpolation."""
        from mgsgraph.geometry.compiled_pose import places  # compiled: not before it is needed

        position, velocity = np.empty((times.size, 3)), np.empty((times.size, 3))
        places(times, (self.times, self.positions, self.velocities), position, velocity)
        return position, velocity


@dataclass(frozen=True, eq=False)
class AttitudeTable(Record):
    """Sampled orientation of a frame against the inertial frame."""

    times: Array
    """(n,) s past the trajectory's epoch, increasing."""
    quaternions: Array
    """(n, 4) unit, scalar first: inertial frame to the sampled frame."""
    constant: Array
    """(3, 3) sampled frame to the frame that is wanted (mount, or principal axes to mean Earth)."""

    def __post_init__(self) -> None:
        times = frozen(self.times, "attitude table, times", (None,))
        _check_times(times, "attitude table")
        quaternions = frozen(self.quaternions, "attitude table, quaternions", (times.size, 4))
        with np.errstate(over="ignore"):
            norm = np.linalg.norm(quaternions, axis=1)
        if np.any(np.abs(norm - 1.0) > 1e-6):
            k = int(np.argmax(np.abs(norm - 1.0)))
            raise InputError("attitude table, quaternions", f"norm {norm[k]:.9f} at [{k}]", "unit quaternions")
        constant = frozen(self.constant, "attitude table, constant rotation", (3, 3))
        large = np.abs(constant).max() > 1.0 + 1e-6
        if large or np.abs(constant @ constant.T - np.eye(3)).max() > 1e-6 or np.linalg.det(constant) < 0.0:
            raise InputError("attitude table, constant rotation", "a matrix that is no rotation", "orthonormal rows")
        unit = quaternions / norm[:, None]
        assign(self, times=times, quaternions=read_only(unit), constant=read_only(np.ascontiguousarray(constant)))

    @cached_property
    def turns(self) -> Array:
        """(n - 1, 3) rad, how the sampled frame turns from each sample to the next, in its own axes."""
        matrices = rotation.to_matrix(self.quaternions)
        # C(t) = Exp(-turn s) C0: the frame turns by +turn, components turn back
        return read_only(-rotation.logarithm(matrices[1:] @ np.swapaxes(matrices[:-1], 1, 2)))

    def at(self, times: Array) -> tuple[Array, Array]:
        """Matrix (n, 3, 3) inertial to wanted frame, and its angular velocity (n, 3) in rad/s in the wanted frame."""
        from mgsgraph.geometry.compiled_pose import attitudes  # compiled: not before it is needed

        matrix, angular_rate = np.empty((times.size, 3, 3)), np.empty((times.size, 3))
        attitudes(times, (self.times, self.quaternions, self.turns, self.constant), matrix, angular_rate)
        return matrix, angular_rate


def require_covered(coverage: tuple[float, float], times: Array, epoch: float, where: str, slack: float = 0.0) -> None:
    """Raise EphemerisGap, naming `where`, unless times (n,), s past the epoch, lie in a coverage widened by `slack`."""
    start, stop = coverage
    outside = ~((times >= start - slack) & (times <= stop + slack))
    if np.any(outside):
        raise EphemerisGap(where, epoch + float(times[outside][0]), epoch + start, epoch + stop)


@dataclass(frozen=True, slots=True, eq=False)
class Pose(Record):
    """Position and attitude of a camera at n moments, with their rates (per second, or per line where so said).

    Examples
    --------
    >>> pose = network.images[0].pose(np.array([0.0, 5000.0]))
    >>> pose.position.shape, pose.matrix.shape
    ((2, 3), (2, 3, 3))
    >>> np.linalg.norm(pose.velocity, axis=1).round(2)
    array([4.91, 4.91])
    """

    position: Array
    """(n, 3) m, body-fixed, perspective centre."""
    velocity: Array
    """(n, 3) m per unit of rate, body-fixed (the frame's own turning included)."""
    matrix: Array
    """(n, 3, 3) body-fixed to camera frame, camera +Z out of the lens."""
    angular_rate: Array
    """(n, 3) rad per unit of rate: angular velocity of the camera against the body-fixed frame, in camera axes;
    dM = -[angular_rate]x M."""

    def scaled(self, rate: Array) -> "Pose":
        """The same pose with rates multiplied by `rate` (n,): seconds per line turn them into rates per line."""
        return Pose(self.position, self.velocity * rate[:, None], self.matrix, self.angular_rate * rate[:, None])

    def in_axes(self, axes: Array | None) -> "Pose":
        """The pose of axes that turn with the camera; `axes` (3, 3) takes them to the camera's, None: no change."""
        if axes is None:
            return self
        return Pose(self.position, self.velocity, axes.T @ self.matrix, self.angular_rate @ axes)


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory(Record):
    """Position and attitude of one camera over its image, and the body's rotation meanwhile.

    Examples
    --------
    >>> trajectory = network.images[0].trajectory
    >>> trajectory.coverage
    (-4.5, 4.5)
    >>> trajectory.pose(np.array([0.0])).position.round(-3)
    array([[ 197000., 3762000.,  263000.]])
    """

    epoch: float
    """s TDB past J2000 from which all times of the tables count."""
    position: PositionTable
    """Geometric position, inertial."""
    camera: AttitudeTable
    """Inertial to camera frame."""
    body: AttitudeTable
    """Inertial to body-fixed frame."""

    def __post_init__(self) -> None:
        require(np.isfinite(self.epoch), "trajectory, epoch", f"{self.epoch}", "s TDB past J2000")
        start, stop = self.coverage
        require(
            start < stop, "trajectory", f"one table begins {start - stop:.6f} s after another has ended",
            "position, attitude and body rotation at the same times",
        )  # fmt: skip

    @property
    def coverage(self) -> tuple[float, float]:
        """First and last time, s past the epoch, at which all three tables hold."""
        tables = (self.position, self.camera, self.body)
        return max(float(t.times[0]) for t in tables), min(float(t.times[-1]) for t in tables)

    @property
    def knots(self) -> Array:
        """(k,) s past the epoch, times of all three tables."""
        return np.concatenate([self.position.times, self.camera.times, self.body.times])

    @property
    def spin(self) -> Array:
        """(3,) rad/s, angular velocity of the body against inertial space, in body-fixed axes: of its table."""
        _, angular_rate = self.body.at(self.body.times[[0, -1]])
        return np.asarray(angular_rate.mean(axis=0))

    def require(self, times: Array, where: str, slack: float = 0.0) -> None:
        """Raise EphemerisGap, naming `where`, unless all times (n,) lie in the coverage widened by `slack` seconds."""
        require_covered(self.coverage, times, self.epoch, where, slack)

    def pose(self, times: Array) -> Pose:
        """Pose at times (n,) in s past the epoch, rates per second; outside the tables their outer intervals go on."""
        from mgsgraph.geometry.compiled_pose import sampled_poses  # compiled: not before it is needed

        n, camera, body = times.size, self.camera, self.body
        pose = Pose(np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3)))
        sampled_poses(
            np.ascontiguousarray(times, dtype=np.float64),
            (self.position.times, self.position.positions, self.position.velocities),
            (camera.times, camera.quaternions, camera.turns, camera.constant),
            (body.times, body.quaternions, body.turns, body.constant),
            pose.position, pose.velocity, pose.matrix, pose.angular_rate,
        )  # fmt: skip
        return pose


# --- known against the body alone

@dataclass(frozen=True, slots=True, eq=False)
class FixedTrajectory:
    """Position and attitude in even or uneven steps, body-fixed, as model states of usgscsm have them."""

    epoch: float
    """s TDB past J2000 (or an unknown zero) from which all times count."""
    position: PositionTable
    """Body-fixed, with body-fixed velocities."""
    camera: AttitudeTable
    """Body-fixed to camera frame."""

    @property
    def coverage(self) -> tuple[float, float]:
        """First and last time, s past the epoch, at which it holds."""
        return self.sampled.coverage

    @property
    def knots(self) -> Array:
        """(k,) s past the epoch, times of both tables."""
        return self.sampled.knots

    @property
    def spin(self) -> Array | None:
        """None: how the body turns in inertial space is not in body-fixed tables."""
        return None

    @property
    def sampled(self) -> Trajectory:
        """The same with the body's axes for inertial ones."""
        unturned = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
        still = AttitudeTable(self.position.times[[0, -1]], unturned, np.eye(3))
        return Trajectory(self.epoch, self.position, self.camera, still)

    def require(self, times: Array, where: str, slack: float = 0.0) -> None:
        """Raise EphemerisGap, naming `where`, unless all times (n,) lie in the coverage widened by `slack` seconds."""
        self.sampled.require(times, where, slack)

    def pose(self, times: Array) -> Pose:
        """Pose at times (n,) in s past the epoch, rates per second; outside the tables their outer intervals go on."""
        return self.sampled.pose(times)


_NODES = 9
"""Of the tables of a circular orbit: an image takes seconds, a thousandth of a turn."""

def circular_flight(
    epoch: float, half: float, place: Array, velocity: Array, spin: Array, attitude: Array
) -> FixedTrajectory:
    """A circular orbit about the body with a camera that keeps its attitude against the flight.

    Parameters
    ----------
    epoch : float
        s TDB past J2000, middle of the flight.
    half : float
        s, before and after the epoch.
    place, velocity : (3,)
        m and m/s at the epoch, body-fixed axes; the velocity is that in inertial space, at right angles to the place.
    spin : (3,)
        rad/s, angular velocity of the body, body-fixed axes.
    attitude : (3, 3)
        Flight frame (along the velocity, to its right, down to the body's centre) to camera frame.

    Notes
    -----
    With n = place x velocity / |place|^2, the flight turns by n t in space, the body beneath it by spin t: body-fixed
    r(t) = Exp(-[spin]x t) Exp([n]x t) place, and the flight frame turns likewise.
    """
    times = np.linspace(-half, half, _NODES)
    normal = np.cross(place, velocity) / (place @ place)
    turns = rotation.exponential(-times[:, None] * spin) @ rotation.exponential(times[:, None] * normal)
    positions = turns @ place
    table = PositionTable(times, positions, turns @ velocity - np.cross(spin, positions))
    matrices = attitude @ flight_frame(place, velocity) @ turns.mT
    camera = AttitudeTable(times, rotation.continuous(rotation.from_matrix(matrices)), np.eye(3))
    return FixedTrajectory(epoch, table, camera)


def flight_frame(place: Array, velocity: Array) -> Array:
    """(3, 3) body-fixed axes to the flight frame of a camera at a place (3,) in m: unit vectors along the horizontal
    part of its velocity (3,) in inertial space, to the right of that, and down to the body's centre.
    """
    down = -rotation.unit_vectors(place)
    along = rotation.unit_vectors(velocity - (velocity @ down) * down)
    return np.stack([along, np.cross(down, along), down])


J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)
"""Zero of all times."""
YEARS = (-1.0e9, 3.2e9)
"""s past J2000 between which times are those of a spacecraft: 1968 to 2101."""
_TT_OF_TAI = 32.184
_TERM, _ECCENTRICITY, _ANOMALY, _MOTION = 1.657e-3, 1.671e-2, 6.239996, 1.99096871e-7
_FIRST_LEAPS = 10
"""TAI minus UTC in s from 1972 on."""
_LEAPS = (
    "1972-01", "1972-07", "1973-01", "1974-01", "1975-01", "1976-01", "1977-01", "1978-01", "1979-01", "1980-01",
    "1981-07", "1982-07", "1983-07", "1985-07", "1988-01", "1990-01", "1991-01", "1992-07", "1993-07", "1994-07",
    "1996-01", "1997-07", "1999-01", "2006-01", "2009-01", "2012-07", "2015-07", "2017-01",
)  # fmt: skip
"""Months from whose first day on that difference is one second more than before."""
_STARTS = np.array([(datetime.fromisoformat(f"{month}-01T00:00Z") - J2000).total_seconds() for month in _LEAPS])
"""s UTC past J2000 of these days."""
_UTC = (
    r"^\s*(?P<minute>\d{4}-(?:\d\d-\d\d|\d{3})[T ]\d\d:\d\d)(?::(?P<second>(?:[0-5]\d|60)(?:\.\d*)?))?Z?\s*$"
)
"""Year, month and day or day of the year, hour, minute; second, a leap second among them."""


def tdb_of_tt(times: Array) -> Array:
    """S TDB past J2000 of times (n,) in s TT past J2000."""
    return np.asarray(times + _yearly_term(times))


def _yearly_term(times: Array) -> Array:
    """S of TDB - TT at times (n,) in either: it changes by 3e-13 s within itself."""
    anomaly = _ANOMALY + _MOTION * times
    return np.asarray(_TERM * np.sin(anomaly + _ECCENTRICITY * np.sin(anomaly)))


def tdb_of_utc(texts: Sequence[str], where: str) -> Array:
    """S TDB past J2000 of times such as 2009-09-06T07:50:38.773, from 1972 on; InputError names `where`."""
    given = Names.of(texts).arrow
    parts = pc.extract_regex(given, _UTC)
    begins = RepeatedNames.of(pc.fill_null(pc.struct_field(parts, "minute"), ""))
    minutes = np.array([_past(begin) for begin in begins.distinct], dtype=np.float64)[begins.numbers]
    for k in np.flatnonzero(np.isnan(minutes))[:1].tolist():
        expected = "UTC such as 2009-09-06T07:50:38.773, from 1972 on"
        raise InputError(where, f"a time that can't be read: {given[k].as_py().strip()[:40]!r}", expected)
    seconds = pc.struct_field(parts, "second")
    whole = np.asarray(pc.if_else(pc.equal(seconds, ""), "0", seconds).cast(pa.float64()))
    leaps = np.searchsorted(_STARTS, minutes, side="right") - 1
    return tdb_of_tt(minutes + whole + leaps + _FIRST_LEAPS + _TT_OF_TAI)


def _past(minute: str) -> float:
    """S UTC past J2000 of a minute as `_UTC` has it; NaN where there is none, or before 1972."""
    date, clock = minute[: -len("T07:50")], minute[-len("07:50") :]
    try:
        day = datetime.strptime(date, "%Y-%m-%d" if date.count("-") > 1 else "%Y-%j").replace(tzinfo=UTC)
        past = (day.replace(hour=int(clock[:2]), minute=int(clock[3:])) - J2000).total_seconds()
    except ValueError:
        return float("nan")
    return past if past >= _STARTS[0] and day.year == int(date[:4]) else float("nan")


def utc_of_tdb(time: float) -> datetime:
    """UTC of a time in s TDB past J2000, from 1972 on."""
    return J2000 + timedelta(seconds=float(_utc_past(np.array([time]))[0]))


def _utc_past(times: Array) -> Array:
    """S UTC past J2000 (n,) of times (n,) in s TDB past J2000, from 1972 on."""
    tai = times - _yearly_term(times) - _TT_OF_TAI
    leaps = np.searchsorted(_STARTS + np.arange(_STARTS.size) + _FIRST_LEAPS, tai, side="right") - 1
    return np.asarray(tai - np.maximum(leaps, 0) - _FIRST_LEAPS)


def utc_texts(times: Array) -> Names:
    """UTC of times (n,) in s TDB past J2000, from 1972 on, as year, month, day, hour, minute, second and thousandths of
    it, cut off there.
    """
    part, whole = np.modf(_utc_past(times))
    past = whole.astype(np.int64) * 10**6 + np.rint(part * 1e6).astype(np.int64)
    since_1970 = past // 1000 + int(J2000.timestamp()) * 1000
    texts = pa.array(since_1970).cast(pa.timestamp("ms")).cast(pa.large_string())
    return Names.of(pc.replace_substring(texts, " ", "T"))


def require_years(times: Array, source: str) -> None:
    """Raise InputError unless times (n,) in s past J2000 (NaN where unknown) are those of spacecraft."""
    for k in np.flatnonzero((times < YEARS[0]) | (times > YEARS[1]))[:1]:
        found, expected = f"a time of {times[k]:g} s past J2000", f"{YEARS[0]:g} .. {YEARS[1]:g} s, 1968 to 2101"
        raise InputError(source, found, expected, "check the unit of the times")
