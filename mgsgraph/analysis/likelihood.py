"""What the measures say of shared unknowns without linear error propagation: likelihood ratios and profiles.

With some unknowns held at given values and the cost E minimised over everything else, 2 (E - E_min) is chi-square with
as many degrees of freedom as unknowns were held, if the values are true (Wilks 1938). It asks for no coordinates in
which the cost is a paraboloid, as the error ellipsoid does (`adjustment.covariances`). The profile of one unknown is
square over its values; where it stays below the quantile of chi-square with one degree lies its interval.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from mgsgraph.adjustment.batch import HeldProblem, levenberg_marquardt
from mgsgraph.adjustment.covariances import Linearised, Linearity, linearity
from mgsgraph.adjustment.frames import Frames
from mgsgraph.adjustment.graph import BundleGraph, Layout
from mgsgraph.adjustment.rounds import about_predicted_lines
from mgsgraph.errors import InputError, errors_from
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.rows import OUT, Rows
from mgsgraph.kernel.sweep import COSTS, SYSTEM
from mgsgraph.names import image_names
from mgsgraph.record import Record
from mgsgraph.text import listed

LEVELS = (0.68, 0.95, 0.99)
"""Probabilities of a profile's intervals."""
_EXACT = 1e-3
"""Sigmas to which the end of an interval is found."""
_TRIALS = 30
"""Places tried for it."""
_FAR = 30.0
"""Sigmas of the ellipsoid beyond which an interval counts as open."""
_LAYOUTS = 10
"""Times that rays are relinearized."""


@dataclass(frozen=True, slots=True)
class LikelihoodRatio(Record):
    """Given values of some unknowns against the best ones.

    Examples
    --------
    >>> nominal = np.zeros_like(solution.coefficients[0])
    >>> ratio = posterior.likelihood.ratio({"SIM/A": nominal})
    >>> print(f"chi-square {ratio.chi_square:.0f}, {ratio.degrees} degrees of freedom, p < 0.001: {ratio.p < 0.001}")
    chi-square 350, 18 degrees of freedom, p < 0.001: True
    """

    chi_square: float
    """Twice the cost's rise."""
    degrees: int
    """Unknowns that were held."""
    p: float
    """Chance of so much or more if the values are true."""


@dataclass(frozen=True, slots=True)
class Profile(Record):
    """One unknown, in the terms of the flight, by its likelihood.

    Examples
    --------
    >>> (roll,) = posterior.likelihood.profiles("SIM/A", "constant roll")
    >>> roll.unit, round(roll.ratio, 2)
    ('rad', 1.0)
    """

    owner: str
    """Image, shift or shared unknown."""
    axis: str
    """Which of its unknowns, as "constant pitch"."""
    unit: str
    """m, rad or s."""
    value: float
    """Estimate."""
    sigma: float
    """By the covariance."""
    intervals: tuple[tuple[float, float], ...]
    """Ends that hold the truth with the probabilities `LEVELS`; infinite where nothing bounds it."""

    @property
    def ratio(self) -> float:
        """Half the width of the 95 % interval over that which the covariance gives."""
        low, high = self.intervals[1]
        return (high - low) / (2.0 * _quantile(LEVELS[1]) * self.sigma)


def linearity_of(at: Linearised) -> Linearity | None:
    """Whether the covariance where a network was solved may be used for joint statements.

    Examples
    --------
    >>> from mgsgraph.analysis.likelihood import linearity_of
    >>> linearity_of(posterior.linearised).linear
    True
    """
    graph = BundleGraph(at.layout, at.rows)
    return linearity(graph, graph.reduction(at.orientation, SYSTEM, at.points), at.of_estimator().joint.square_root)


class Likelihood(Record):
    """The likelihood about a solution.

    Parameters
    ----------
    at : Linearised
        The network where it was solved.

    Raises
    ------
    InputError
        Where unknowns are considered: the cost says nothing of them; and where a robust loss is no likelihood of
        normal errors.

    Examples
    --------
    >>> (roll,) = posterior.likelihood.profiles("SIM/A", "constant roll")
    >>> low, high = roll.intervals[1]
    >>> print(f"sigma {206265 * roll.sigma:.1f} arcsec; with 95 % between {206265 * low:.0f} and {206265 * high:.0f}")
    sigma 12.9 arcsec; with 95 % between -16 and 35
    """

    def __init__(self, at: Linearised) -> None:
        for name in at.network.considered[:1]:
            found = "a considered unknown, of which the cost says nothing"
            raise InputError(f"likelihood, {name!r}", found, "an estimated one", "take it out of `considered`")
        if at.settings.loss != "none":
            found = f"the loss {at.settings.loss}, which is no likelihood of normal errors"
            raise InputError("likelihood", found, "an adjustment by least squares", "adjust with --loss none")
        at = at.of_estimator()
        self._at, self._frames, self._joint = at, Frames(at.layout), at.joint
        self._begin = BundleGraph(at.layout, at.rows).reduction(at.orientation, SYSTEM, at.points)
        self._lowest = BundleGraph(at.layout, at.rows).cost(self._begin)

    def __repr__(self) -> str:
        return f"Likelihood({self._at.network!r})"

    def ratio(self, values: Mapping[str, Array]) -> LikelihoodRatio:
        """Of values of images' coefficients (degree + 1, 6), shifts (w,) and shared unknowns (w,), by their names; all
        others are what suits them best.
        """
        network, variables = self._at.network, self._at.layout.variables
        names = [*network.image_names, *network.shift_names, *(item.name for item in network.shared)]
        held, wanted = list[int](), self._at.orientation.copy()
        for name, value in values.items():
            variable = names.index(name) if name in names else -1
            if variable < 0 or variables.first[variable] < 0:
                raise _unknown(name)
            columns = variables.columns_of(variable)
            if np.size(value) != columns.stop - columns.start or not np.all(np.isfinite(value)):
                expected = f"{columns.stop - columns.start} finite numbers"
                raise InputError(f"likelihood, {name!r}", f"{np.size(value)} values, or some not finite", expected)
            wanted[columns] = np.ravel(value)
            held += range(columns.start, columns.stop)
        directions = np.zeros((variables.sigmas.size, len(held)))
        directions[held, np.arange(len(held))] = 1.0
        chi_square = 2.0 * (self._held(directions, wanted[held])[0] - self._lowest)
        from scipy.special import chdtrc  # slow to import

        return LikelihoodRatio(chi_square, len(held), float(chdtrc(len(held), max(chi_square, 0.0))) if held else 1.0)

    def profiles(self, owner: str, *axes: str) -> list[Profile]:
        """Of the unknowns of an image, shift or shared unknown in the terms of the flight: all, or those of some axes
        ("constant pitch", "east shift").

        Raises InputError where there are none.
        """
        names = {f"{kind}{owner}" for kind in ("", "image ", "shared unknown ")}
        if names.isdisjoint(axis.owner for axis in self._frames.axes):
            with errors_from(f"likelihood, {owner!r}, no shift or shared unknown"):
                (owner,) = image_names([owner], self._at.network.image_names)
            names = {owner, f"image {owner}"}
        columns = [c for c, axis in enumerate(self._frames.axes) if axis.owner in names]
        for name in axes:
            if name not in (axis_names := [str(self._frames.axes[c]) for c in columns]):
                raise InputError(f"likelihood, {owner!r}", f"no {name!r}", listed(axis_names) or "another name")
        if not columns:
            raise _unknown(owner)
        return [self._profile(c) for c in columns if not axes or str(self._frames.axes[c]) in axes]

    def _profile(self, column: int) -> Profile:
        axis, direction = self._frames.axes[column], self._frames.along(column)
        through = self._joint.square_root.covariance_times(direction)
        value, sigma = float(direction @ self._at.orientation), math.sqrt(float(direction @ through))
        sides = [self._side(direction, value, way * sigma) for way in (-1.0, 1.0)]
        ends = tuple(zip(*sides, strict=True))
        return Profile(axis.owner, str(axis), axis.unit, value, sigma, ends)

    def _side(self, direction: Array, value: float, sigma: float) -> list[float]:
        """Ends of the intervals on one side; `sigma` has its sign."""
        held, begin = direction[:, None], self._at.orientation
        ends, at, root, solved = list[float](), 0.0, 0.0, begin
        for wanted in map(_quantile, LEVELS):
            low, high, trial = (at, root), (math.inf, math.inf), max(wanted, at)
            for _ in range(_TRIALS):
                state = begin + (solved - begin) * (trial / at) if at else None
                cost, state = self._held(held, np.array([value + trial * sigma]), state)
                at, solved = trial, state
                root = math.sqrt(max(2.0 * (cost - self._lowest), 0.0))
                if abs(root - wanted) < _EXACT or trial >= _FAR:
                    break
                low, high = ((trial, root), high) if root < wanted else (low, (trial, root))
                trial = _between(low, high, wanted)
            ends.append(value + at * sigma if at < _FAR else math.copysign(math.inf, sigma))
        return ends

    def _held(self, directions: Array, values: Array, start: Array | None = None) -> tuple[float, Array]:
        """Least cost with directions (columns, m) held at values (m,), and the state (columns,) there."""
        at, root = self._at, self._joint.square_root
        if start is None:
            through = root.covariance_times(directions)
            lacking = values - directions.T @ at.orientation
            start = at.orientation + through @ np.linalg.solve(directions.T @ through, lacking)
        layout, rows, points = at.layout, at.rows, self._begin.points
        for _ in range(_LAYOUTS):
            graph = BundleGraph(layout, rows)
            reduction = graph.reduction(start, SYSTEM, points)
            if not math.isfinite(reduction.cost):
                return math.inf, start
            if 0 < directions.shape[1] < start.size:
                problem = HeldProblem(graph, directions, reduction)
                start = levenberg_marquardt(problem, start, at.settings, lambda _: None).state
                reduction = problem.at(start, COSTS)
            anew = about_predicted_lines(layout, start, reduction.points)
            if anew is layout:
                break
            points = layout.network_order(reduction.points)[anew.point_order]
            layout, rows = anew, _same_rows(layout, rows, anew)
        return graph.cost(reduction), start


def _unknown(name: str) -> InputError:
    return InputError(f"likelihood, {name!r}", "nothing that is adjusted", "an image, shift or shared unknown")


def _same_rows(layout: Layout, rows: Rows, anew: Layout) -> Rows:
    """Rows of another layout of a network, with those out that are out here."""
    places, stereo = layout.observation_rows, None
    if layout.stereo is not None:
        stereo = np.zeros(len(layout.network.points), dtype=bool)
        stereo[layout.stereo.points] = rows.weight[0, places.stereo] > 0.0
    rays, ranges = (rows.weight[0, part] > 0.0 for part in (places.rays, places.ranges))
    return anew.active(rays, ranges, layout.network_order(rows.kind) == OUT, stereo)


def _between(low: tuple[float, float], high: tuple[float, float], wanted: float) -> float:
    """Where the root of the square should be as wanted: by the line through the ends, twice as far where there is one
    end only.
    """
    if not math.isfinite(high[1]):
        if math.isfinite(high[0]):  # no cost there: half way
            return 0.5 * (low[0] + high[0])
        return min(low[0] * min(max(wanted / max(low[1], 1e-3), 1.05), 2.0), _FAR)
    share = (wanted - low[1]) / max(high[1] - low[1], 1e-12)
    return low[0] + min(max(share, 0.02), 0.98) * (high[0] - low[0])


def _quantile(probability: float) -> float:
    """Standard deviations within which a normal error lies with a probability."""
    return NormalDist().inv_cdf(0.5 + 0.5 * probability)
