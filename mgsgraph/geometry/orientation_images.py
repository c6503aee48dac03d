"""Orientation images: exterior orientation at a few chosen times only, and between them from the four nearest.

Hofmann, Dorrer & Nave 1982; for HRSC Ebner et al. 2004 and Spiegel 2007. Two bases with local support: Lagrange's
polynomials of third order through the four neighbours, whose coefficients are the corrections at the nodes themselves,

    P(t) = sum_i P(t_i) prod_{j != i} (t - t_j) / (t_i - t_j),

and the uniform cubic B-spline, which is smooth at the nodes, too (its coefficients are not the values there: these are
(c_{i-1} + 4 c_i + c_{i+1}) / 6). All lines of a strip share one trajectory, so nodes are times, not lines.
"""

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index, assign, frozen
from mgsgraph.record import Record

Basis = Literal["lagrange", "spline"]
"""How orientation between nodes follows from them."""

SUPPORT = 4
"""Nodes that a time depends on."""
_EVEN = 1e-6
"""Share of the spacing by which the spacings of a uniform spline may differ."""


@dataclass(frozen=True, slots=True, eq=False)
class OrientationImages(Record):
    """The nodes of one strip, and the basis between them.

    Examples
    --------
    >>> from mgsgraph.geometry.orientation_images import OrientationImages
    >>> nodes = OrientationImages("lagrange", 0.0, np.arange(0.0, 50.0, 10.0))
    >>> len(nodes), nodes.coverage, nodes.spacing
    (5, (0.0, 40.0), 10.0)
    """

    basis: Basis
    """Lagrange's third-order polynomials, or the uniform cubic B-spline."""
    epoch: float
    """s TDB past J2000 from which the nodes' times count."""
    times: Array
    """(k,) s past the epoch, increasing: at least four. A spline's are evenly spaced, and the first and the last one
    lie outside of what it describes."""
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
        if self.basis == "spline" and np.ptp(steps) > _EVEN * steps.mean():
            found = f"spacings of {steps.min():g} to {steps.max():g} s"
            raise InputError("orientation images, times", found, "even ones for a uniform spline", "take lagrange")
        if self.span is not None and not (np.all(np.isfinite(self.span)) and self.span[0] < self.span[1]):
            raise InputError("orientation images, span", f"{self.span}", "two times, the first one earlier")
        assign(self, times=times)

    def __len__(self) -> int:
        return int(self.times.size)

    @property
    def inner(self) -> Array:
        """Times, s past the epoch, of the nodes within what they describe: all but the outer two of a spline."""
        return self.times if self.basis == "lagrange" else self.times[1:-1]

    @property
    def coverage(self) -> tuple[float, float]:
        """First and last time, s past the epoch, that they describe."""
        return float(self.inner[0]), float(self.inner[-1])

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
        if self.basis == "lagrange":
            return _lagrange(since, self.times[first[:, None] + np.arange(SUPPORT)])
        return _spline(since - self.times[first + 1], float(np.diff(self.times).mean()))

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
        beyond, steps = len(self) - self.inner.size >> 1, np.diff(self.times)
        if self.basis == "spline":
            steps[:] = steps.mean()
        first, last = self.coverage
        missing = (first - start) / steps[0], (stop - last) / steps[-1]
        before, after = (max(int(np.ceil(count - _EVEN)), 0) for count in missing)
        times = np.concatenate([
            self.times[0] - steps[0] * np.arange(before, 0, -1), self.times,
            self.times[-1] + steps[-1] * np.arange(1, after + 1),
        ])  # fmt: skip
        inner = times[beyond : times.size - beyond]
        low = max(int(np.searchsorted(inner, start + _EVEN * steps[0], "right")) - 1, 0)
        high = min(int(np.searchsorted(inner, stop - _EVEN * steps[-1])), inner.size - 1)
        while high - low < SUPPORT - 1 and high - low < inner.size - 1:
            low, high = (low - 1, high) if low > 0 else (low, high + 1)
        return replace(self, times=times[low : high + 1 + 2 * beyond], span=self.trend_span)

    def with_nodes_at(self, times: Array) -> "OrientationImages":
        """The same with other nodes."""
        return replace(self, times=times)


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


def _spline(since: Array, spacing: float) -> tuple[Array, Array]:
    """The four cubic B-splines that are not zero at times `since` (n,) after the second one's node."""
    t = since / spacing
    rest = 1.0 - t
    values = np.stack([
        rest**3, 3.0 * t**3 - 6.0 * t**2 + 4.0, 3.0 * rest**3 - 6.0 * rest**2 + 4.0, t**3
    ], axis=1) / 6.0  # fmt: skip
    rates = np.stack([
        -3.0 * rest**2, 9.0 * t**2 - 12.0 * t, -9.0 * rest**2 + 12.0 * rest, 3.0 * t**2
    ], axis=1) / (6.0 * spacing)  # fmt: skip
    return values, rates


def evenly_spaced(basis: Basis, epoch: float, coverage: tuple[float, float], spacing: float) -> OrientationImages:
    """Nodes over a strip at even spacings of at most `spacing` s: at least three intervals; a spline has one more node
    on either side.
    """
    start, stop = coverage
    if not (np.isfinite(spacing) and spacing > 0.0):
        raise InputError("orientation images, spacing", f"{spacing} s", "a positive number of seconds")
    if not start < stop:
        raise InputError("orientation images", f"a strip from {start} to {stop} s", "a start before the stop")
    intervals = max(int(np.ceil((stop - start) / spacing - 1e-9)), SUPPORT - 1)
    step = (stop - start) / intervals
    beyond = 0 if basis == "lagrange" else 1
    numbers = np.arange(-beyond, intervals + 1 + beyond, dtype=np.float64)
    return OrientationImages(basis, epoch, np.asarray(start + step * numbers))
