"""Exterior orientation as a correction of the nominal trajectory: pose(u) = nominal(u) (+) sum_k B_k(u) c_k.

The coefficients c_k are 6-vectors: position in m along the body-fixed axes, then a rotation vector in rad about the
camera axes, so that the camera frame is turned by it: M = Exp([theta]x)' M_nominal; or, by choice, additions to the
nominal omega, phi, kappa, of the papers' product M' = R3 R2 R1 (camera to body, opk-paper) or of M = R3 R2 R1 (body to
camera, opk-peer). B_k(u) = u^k (Yoon & Shan 2005, Eq. 2, as corrections to SPICE), or the basis of a pass's
orientation images (Hofmann et al. 1982), or both: whatever acts linearly on the pose.

Orientation images: exterior orientation at a few chosen times only, and between them from the four nearest.

Hofmann, Dorrer & Nave 1982; for HRSC Ebner et al. 2004 and Spiegel 2007. Lagrange's polynomials of third order through
the four neighbours, whose coefficients are the corrections at the nodes themselves,

    P(t) = sum_i P(t_i) prod_{j != i} (t - t_j) / (t_i - t_j).

All lines of a pass share one trajectory, so nodes are times, not lines.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.factors.pose import opk_paper, opk_peer
from mgsgraph.geometry import rotation
from mgsgraph.geometry.records import Array, Index, assign, frozen, read_only
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.record import Record

Basis = Literal["lagrange"]
"""How orientation between nodes follows from them."""

SUPPORT = 4
"""Nodes that a time depends on."""
_EVEN = 1e-6
"""Share of a spacing that counts as nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class OrientationImages(Record):
    """The nodes of one pass, and the basis between them.

    Examples
    --------
    >>> from mgsgraph.geometry.orientation import OrientationImages
    >>> nodes = OrientationImages("lagrange", 0.0, np.arange(0.0, 50.0, 10.0))
    >>> len(nodes), nodes.coverage, nodes.spacing
    (5, (0.0, 40.0), 10.0)
    """

    basis: Basis
    """Lagrange's third-order polynomials."""
    epoch: float
    """s TDB past J2000 from which the nodes' times count."""
    times: Array
    """(k,) s past the epoch, increasing: at least four."""
    span: tuple[float, float] | None = None
    """s past the epoch, times at which the trend of a prior has s = -1 and 1; None for the first and the last time that
    they describe. Nodes that are continued keep that of the first ones."""

    def __post_init__(self) -> None:
        if self.basis not in get_args(Basis):
            raise InputError("orientation images, basis", repr(self.basis), f"one of {', '.join(get_args(Basis))}")
        times = frozen(self.times, "orientation images, times", (None,))
        if times.size < SUPPORT:
            raise InputError("orientation images", f"{times.size} nodes", f"at least {SUPPORT}", "a smaller spacing")
        steps = np.diff(times)
        if not np.isfinite(self.epoch) or steps.min() <= 0.0:
            raise InputError("orientation images, times", "times that don't increase", "increasing seconds")
        if self.span is not None and not (np.all(np.isfinite(self.span)) and self.span[0] < self.span[1]):
            raise InputError("orientation images, span", f"{self.span}", "two times, the first one earlier")
        assign(self, times=times)

    def __len__(self) -> int:
        return int(self.times.size)

    @property
    def coverage(self) -> tuple[float, float]:
        """First and last time, s past the epoch, that they describe."""
        return float(self.times[0]), float(self.times[-1])

    @property
    def trend_span(self) -> tuple[float, float]:
        """Times, s past the epoch, between which a prior's trend is counted from s = -1 to 1."""
        return self.coverage if self.span is None else self.span

    @property
    def spacing(self) -> float:
        """S between them, on the average."""
        return float(np.ptp(self.times)) / (len(self) - 1)

    def first_of_four(self, times: Array, epoch: float) -> Index:
        """(n,) the first of the four nodes, one after the other, that times (n,) in s past `epoch` depend on.

        Before the first and after the last node the nearest four go on.
        """
        since = times + (epoch - self.epoch)
        return np.clip(np.searchsorted(self.times, since, side="right") - 2, 0, self.times.size - SUPPORT)

    def around(self, first: Index, times: Array, epoch: float) -> tuple[Array, Array]:
        """Basis values (n, 4) of the four nodes from `first` (n,) on at times (n,) in s past `epoch`, and their
        derivatives per second.
        """
        since = times + (epoch - self.epoch)
        return _lagrange(since, self.times[first[:, None] + np.arange(SUPPORT)])

    def at(self, times: Array, epoch: float) -> tuple[Index, Array, Array]:
        """The first of its four nodes of each time (n,) in s past `epoch`, and the values and derivatives (n, 4)."""
        first = self.first_of_four(times, epoch)
        return first, *self.around(first, times, epoch)

    def dense(self, times: Array, epoch: float) -> tuple[Array, Array]:
        """Values and derivatives per second (n, k) of all basis functions; for short lists of times."""
        first, values, rates = self.at(times, epoch)
        result = np.zeros((2, times.size, self.times.size))
        for k in range(SUPPORT):
            result[0, np.arange(times.size), first + k] = values[:, k]
            result[1, np.arange(times.size), first + k] = rates[:, k]
        return result[0], result[1]

    def over(self, start: float, stop: float) -> "OrientationImages":
        """The nodes of the same grid that times from start to stop, s past the epoch, need, four at least: those that
        are there keep their times and the span of their trend; before and after them the grid goes on at its spacing.
        """
        steps, (first, last) = np.diff(self.times), self.coverage
        missing = (first - start) / steps[0], (stop - last) / steps[-1]
        before, after = (max(int(np.ceil(count - _EVEN)), 0) for count in missing)
        times = np.concatenate([
            self.times[0] - steps[0] * np.arange(before, 0, -1), self.times,
            self.times[-1] + steps[-1] * np.arange(1, after + 1),
        ])  # fmt: skip
        low = max(int(np.searchsorted(times, start + _EVEN * steps[0], "right")) - 1, 0)
        high = min(int(np.searchsorted(times, stop - _EVEN * steps[-1])), times.size - 1)
        while high - low < SUPPORT - 1 and high - low < times.size - 1:
            low, high = (low - 1, high) if low > 0 else (low, high + 1)
        return replace(self, times=times[low : high + 1], span=self.trend_span)


def _lagrange(times: Array, nodes: Array) -> tuple[Array, Array]:
    """Lagrange's polynomials through nodes (n, 4) at times (n,), and their derivatives."""
    values, rates = np.ones(nodes.shape), np.zeros(nodes.shape)
    for i in range(SUPPORT):
        for j in range(SUPPORT):
            if j != i:
                span = nodes[:, i] - nodes[:, j]
                factor = (times - nodes[:, j]) / span
                rates[:, i] = rates[:, i] * factor + values[:, i] / span
                values[:, i] *= factor
    return values, rates


def evenly_spaced(basis: Basis, epoch: float, coverage: tuple[float, float], spacing: float) -> OrientationImages:
    """Nodes over a pass at even spacings of at most `spacing` s: at least three intervals."""
    start, stop = coverage
    if not (np.isfinite(spacing) and spacing > 0.0):
        raise InputError("orientation images, spacing", f"{spacing} s", "a positive number of seconds")
    require(start < stop, "orientation images", f"a pass from {start} to {stop} s", "a start before the stop")
    intervals = max(int(np.ceil((stop - start) / spacing - 1e-9)), SUPPORT - 1)
    step = (stop - start) / intervals
    return OrientationImages(basis, epoch, np.asarray(start + step * np.arange(intervals + 1, dtype=np.float64)))


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


@dataclass(frozen=True, slots=True)
class Sine(Record):
    """A vibration of one frequency: cosine and sine amounts, each with a linear drift over the time of a pass (which a
    small error of the frequency is, too).

    Examples
    --------
    >>> from mgsgraph.geometry.orientation import Sine
    >>> Sine(2.0, 0.0, 8.0).at(np.array([4.0]), 0.0)[0].round(12)
    array([[ 1. , -0. ,  0.5, -0. ]])
    """

    frequency: float
    """Hz."""
    middle: float
    """s TDB past J2000, where phases begin and the drift is zero."""
    half: float
    """s, from there to s = 1."""

    def __post_init__(self) -> None:
        cycles = 2.0 * self.half * self.frequency
        if not (np.isfinite(self.middle) and self.half > 0.0 and 1.0 <= cycles < np.inf):
            found, expected = f"{self.frequency:g} Hz over {2.0 * self.half:g} s", "one cycle or more"
            raise InputError("vibration, frequency", found, expected, "what is slower is a drift: a process follows it")

    def at(self, times: Array, epoch: float) -> tuple[Array, Array]:
        """Values (n, 4) of cos, sin, s cos, s sin at times (n,) in s past `epoch`, and their derivatives per second."""
        since, turn = times + (epoch - self.middle), 2.0 * np.pi * self.frequency
        wave = np.stack([np.cos(turn * since), np.sin(turn * since)], axis=1)
        rate, s = turn * np.stack([-wave[:, 1], wave[:, 0]], axis=1), since[:, None] / self.half
        return np.hstack([wave, s * wave]), np.hstack([rate, s * rate + wave / self.half])


@dataclass(frozen=True, slots=True, eq=False)
class OrientationPrior(Record):
    """Prior of one image's orientation corrections: zero mean, and a sigma for each coefficient.

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
        assign(self, sigmas=read_only(sigmas))

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
    """(d, 6) m and rad: of a polynomial of the normalised line, constant term first, then of the orientation images of
    its pass, then four of each sine."""
    angles: Angles = "camera"
    """What the rotation part is."""
    nodes: OrientationImages | None = None
    """Orientation images of its pass; None for a polynomial alone."""
    sines: tuple[Sine, ...] = ()
    """Vibrations."""

    def __post_init__(self) -> None:
        if self.angles not in get_args(Angles):
            options = ", ".join(get_args(Angles))
            raise InputError("orientation correction, angles", repr(self.angles), f"one of {options}")
        coefficients = frozen(self.coefficients, "orientation coefficients", (None, 6))
        if self.nodes is not None and coefficients.shape[0] < len(self.nodes):
            found, expected = f"{coefficients.shape[0]} rows", f"one for each of {len(self.nodes)} nodes, at least"
            raise InputError("orientation coefficients", found, expected)
        assign(self, coefficients=coefficients)

    @property
    def polynomial_terms(self) -> int:
        """Rows that belong to the polynomial."""
        return int(self.coefficients.shape[0]) - (0 if self.nodes is None else len(self.nodes)) - 4 * len(self.sines)

    def basis(self, moments: Moments) -> Array:
        """(n, d) what each row of coefficients counts at n lines; dense, for few of them."""
        parts = [polynomial(moments.u, self.polynomial_terms - 1)[0]]
        if self.nodes is not None:
            parts.append(self.nodes.dense(moments.times, moments.epoch)[0])
        return np.hstack([*parts, *(sine.at(moments.times, moments.epoch)[0] for sine in self.sines)])

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
        for k, sine in enumerate(reversed(self.sines), start=1):
            values, rates = sine.at(moments.times, moments.epoch)
            own = self.coefficients[len(self.coefficients) - 4 * k :][:4]
            correction += values @ own
            slope += rates * moments.periods[:, None] @ own
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
    nominal_angles = rotation.omega_phi_kappa(nominal.matrix if paper else nominal.matrix.mT)
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
