"""Whitened rows of chosen points as one sparse system, and what the residuals say of a suspected systematic effect.

A suspected effect adds g theta to the whitened rows, theta unknown. With R = 1 - A Q A' the covariance of the whitened
residuals v of all rows (Baarda 1968), g' v has the variance g' R g, and

    T = v' G (G' R G)^-1 G' v

is chi-square with as many degrees of freedom as G has columns if there is no such effect, however the residuals are
correlated and whatever the adjustment has already absorbed: the score test, or Lagrange multiplier test, of theta
(Rao 1948; in geodesy Teunissen 2006, Testing theory). An effect on some of the rows alone is tested as exactly; so
of a large network some points do.

Do residuals of near points resemble each other? Moran's statistic of least-squares residuals (Cliff & Ord 1981).

With v the whitened residuals, of covariance C, and K one for each pair of rows nearer than some distance, else zero,
v' K v is the score of a common correlation of near rows. Its cumulants are those of a quadratic form of normal
variables, kappa_n = 2^(n-1) (n-1)! tr (K C)^n: the correlation that least squares itself brings about is in them. The
eigenvalues of K C say how probable it is.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mgsgraph.adjustment.covariances import Linearised
from mgsgraph.adjustment.fit import residuals
from mgsgraph.adjustment.marginals import begins
from mgsgraph.errors import require
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.rows import GROUND, IMAGE, NO_LOSS, OUT, RANGE, STEREO, SURFACE

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_EXACT = 1e-12
"""Residual in sigmas below which its robust weight is taken as one."""


@dataclass(frozen=True, eq=False)
class ResidualRows:
    """r whitened rows: those of chosen points, then those of the priors of the shared unknowns."""

    at: Linearised
    """Where they are linearised, with the covariance that estimates had were considered unknowns without error."""
    residuals: Array
    """(r,) in sigmas."""
    redundancy: Array
    """(r,) redundancy numbers; of priors' rows 0: they are not judged."""
    by_point: Array
    """(r, 3) per m, derivatives by the row's own point; zero for priors."""
    point: Index
    """(r,) network point; -1 for priors."""
    kind: Index
    """(r,) IMAGE, RANGE, GROUND, SURFACE or STEREO; -1 for priors."""
    component: Index
    """(r,) line 0, sample 1; x, y, z of a ground prior (whitened); else 0."""
    measure: Index
    """(r,) ray or range of the network; else -1."""
    own: "csr_array"
    """(r, 3 p) orthonormal, on what p points keep for themselves."""
    through: "csr_array"
    """(r, columns) on the shared unknowns, which the points follow."""

    def of_kind(self, kind: int) -> Index:
        """Rows of one kind."""
        return np.flatnonzero(self.kind == kind)

    @cached_property
    def begin_of_priors(self) -> int:
        """First row of the priors."""
        return int(np.count_nonzero(self.kind >= 0))

    @cached_property
    def scale(self) -> Array:
        """(r,) of rays and ranges what a pixel or a metre is in the whitened rows, robust weight included; else 0."""
        network, layout = self.at.network, self.at.layout
        factors = np.zeros(self.kind.size)
        rays, ranges = self.of_kind(IMAGE), self.of_kind(RANGE)
        factors[rays] = 1.0 / network.rays.sigmas[self.measure[rays], self.component[rays]]
        factors[ranges] = 1.0 / network.ranges.sigmas[self.measure[ranges]]
        if layout.model.loss != NO_LOSS:
            plain = residuals(layout, self.at.orientation, self.at.points)
            image, single = plain.image[self.measure[rays], self.component[rays]], plain.ranges[self.measure[ranges]]
            for part, residual in ((rays, image), (ranges, single)):
                sound = np.abs(residual * factors[part]) > _EXACT
                factors[part] = np.where(sound, self.residuals[part] / np.where(sound, residual, 1.0), factors[part])
        return factors

    @cached_property
    def considered(self) -> Array:
        """(r, h) residuals that one sigma of each considered unknown brings about.

        They were held at zero by pseudo-observations of a weight w: v = R (e + A c), and in all rows but these
        A' R g = w^2 S A' g with the covariance S of the unknowns.
        """
        variables = self.at.layout.variables
        held = np.flatnonzero(variables.considered)
        factor = variables.sigmas[held] / variables.prior_sigmas[held] ** 2  # others may be unlimited
        unit = np.zeros((self.at.layout.columns, held.size))
        unit[held, np.arange(held.size)] = factor
        effects = np.asarray(self.through @ self._spread(unit))
        priors = np.flatnonzero(self.at.layout.prior.weights)
        effects[self.begin_of_priors + np.flatnonzero(np.isin(priors, held))] = 0.0  # pseudo-observations, no errors
        return effects

    def explained(self, rows: Index, columns: Array) -> Array:
        """C G (r, k) with the covariance C of the residuals: how effects G, whose `columns` (q, k) stand in some rows
        (q,), show in them.
        """
        own, through, brought = self.own[rows], self.through[rows], self.considered
        effects = np.asarray(-(self.own @ (own.T @ columns)) - self.through @ self._spread(through.T @ columns))
        effects[rows] += columns
        return np.asarray(effects + brought @ (brought[rows].T @ columns))

    def variance(self, rows: Index, columns: Array) -> Array:
        """G' C G (k, k) of effects whose columns (q, k) stand in some rows (q,)."""
        chosen = self.own[rows]
        inner, right = chosen[:, np.unique(chosen.indices)].T @ columns, self.through[rows].T @ columns
        brought = self.considered[rows].T @ columns
        result = columns.T @ columns - inner.T @ inner - right.T @ self._spread(right) + brought.T @ brought
        return np.asarray(0.5 * (result + result.T))

    def _spread(self, right: Array) -> Array:
        """Covariance of the shared unknowns times vectors (columns, k)."""
        return self.at.joint.square_root.covariance_times(right)


def residual_rows(at: Linearised, points: Index) -> ResidualRows:
    """Rows of network points (p,), those left out by the adjustment skipped, and of the priors.

    Parameters
    ----------
    at : Linearised
        At its solution.
    points : (p,)
        Each once.
    """
    from scipy.sparse import coo_array, csr_array, vstack  # slow to import

    at = at.of_estimator()
    parts, prior = list(_parts(at, points)), at.layout.prior
    begin = begins(np.array([part.residuals.size for part in parts], dtype=np.int64))
    r = int(begin[-1])

    def joined(name: str, shape: tuple[int, ...] = ()) -> Any:
        """Of all parts, then of the priors."""
        values = [getattr(part, name) for part in parts]
        return np.concatenate([*values, np.full((prior.rows, *shape), -1 if values[0].dtype == np.int64 else 0.0)])

    row = np.concatenate([first + part.row for first, part in zip(begin.tolist(), parts, strict=False)])
    column, value = (np.concatenate([getattr(part, name) for part in parts]) for name in ("column", "value"))
    through = coo_array((value, (row, column)), (r, at.layout.columns)).tocsr()
    misfits, point, observation = joined("residuals"), joined("point"), joined("observation")[:r]
    misfits[r:] = prior.design @ at.orientation
    misfits[misfits.size - prior.target.size :] -= prior.target
    number = np.unique(point[:r], return_inverse=True)[1]
    place = np.repeat(np.arange(r), 3), (3 * number[:, None] + np.arange(3)).ravel()
    own = coo_array((joined("own", (3,))[:r].ravel(), place), (misfits.size, 3 * (number.max(initial=-1) + 1)))
    kind, measure = (np.append(part, np.full(prior.rows, -1)) for part in _what(at, observation))
    return ResidualRows(
        at, misfits, joined("redundancy"), joined("by_point", (3,)), point, kind, joined("component"), measure,
        own.tocsr(), csr_array(vstack([through, prior.design])),
    )  # fmt: skip


class _Part(NamedTuple):
    """Rows of the points of one piece, and entries of `ResidualRows.through` in them."""

    residuals: Array
    redundancy: Array
    by_point: Array
    point: Index
    observation: Index
    """(r,) place among all observations."""
    component: Index
    own: Array
    """(r, 3)"""
    row: Index
    column: Index
    value: Array


def _parts(at: Linearised, points: Index) -> Iterator[_Part]:
    """Piece by piece, point by point; rows without a weight are left out."""
    index = np.sort(at.layout.patterns.point_index[points])
    index = index[at.rows.kind[index] != OUT]
    require(index.size, "tests of the residuals", "no point that took part", "some", "adjust the case again")
    piece = at.layout.patterns.piece_of(index)
    for number in np.unique(piece).tolist():
        _, first, count, _, among = at.rows.piece[number].tolist()
        inside = index[piece == number] - first
        rows = at.rows_inside(number, inside)
        own, through = rows.following()
        m, r = rows.residuals.shape
        share = np.sum(own**2, axis=2) + np.einsum("mrc,cd,mrd->mr", through, at.joint.of(rows.variables), through)
        columns = at.layout.variables.columns_of_all(rows.variables)
        taken = np.any(rows.by_point.reshape(-1, 3) != 0.0, axis=1)
        flat = through.reshape(m * r, -1)[taken]
        row, column = np.nonzero(flat)
        yield _Part(
            rows.residuals.ravel()[taken], (1.0 - share).ravel()[taken], rows.by_point.reshape(-1, 3)[taken],
            np.repeat(at.layout.point_order[first + inside], r)[taken],
            (among + rows.observation * count + inside[:, None]).ravel()[taken], np.tile(rows.row, m)[taken],
            own.reshape(-1, 3)[taken], row, columns[column], flat[row, column],
        )  # fmt: skip


def _what(at: Linearised, observation: Index) -> tuple[Index, Index]:
    """Kind (r,) of observations, by their places among all, and the network's ray or range that each is; else -1."""
    places = at.layout.observation_rows
    kinds = np.full(at.rows.weight.shape[1], GROUND)
    measures = np.full(kinds.size, -1)
    kinds[places.rays], kinds[places.ranges] = IMAGE, RANGE
    kinds[places.heights], kinds[places.stereo] = SURFACE, STEREO
    measures[places.rays], measures[places.ranges] = np.arange(places.rays.size), np.arange(places.ranges.size)
    return kinds[observation], measures[observation]


_MOST_ROWS = 600
"""Rows of a kind that are compared."""
_WITHIN = (1.0, 2.0, 4.0, 8.0)
"""Distances within which points count as near, in median distances of a point to its nearest one."""
_FEWEST_PAIRS = 20
_ROUNDING = 1e-9
"""Eigenvalue of the residuals' covariance that is none."""


@dataclass(frozen=True, slots=True)
class NearCorrelation:
    """Correlation of the residuals of near points, of one kind of rows."""

    where: str
    """What kind of rows."""
    quantity: str
    """What of them."""
    unit: str
    """Of the distance."""
    term: str
    """What to add to the case file."""
    length: float
    """Distance within which the test is clearest."""
    coefficient: float
    """Correlation, by one step from none."""
    sigma: float
    """Of the coefficient."""
    statistic: float
    """v' K v less its mean, in its standard deviations."""
    p_value: float
    """Of all distances together."""
    course: tuple[tuple[float, float, float], ...]
    """Each distance, the coefficient within it and its sigma."""
    spread: float
    """Factor of the variance of sums over many rows that the correlation makes, at most."""


def correlations(
    rows: ResidualRows, residuals: Array, taken: Sequence[tuple[Array, Array]]
) -> Iterator[NearCorrelation]:
    """Of image places of ties, of heights above terrain models, and of ranges.

    Parameters
    ----------
    rows : ResidualRows
    residuals : (r,)
        In sigmas, of what named effects don't explain.
    taken : sequence
        Of each of these C g (r, d) and the inverse (d, d) of g' C g.
    """
    for kinds, where, quantity, unit, term in _KINDS:
        members = np.flatnonzero(np.isin(rows.kind, kinds))
        members = _some(rows, members)
        if members.size < _FEWEST_PAIRS:
            continue
        covariance = rows.variance(members, np.eye(members.size))
        for shown, inverse in taken:
            covariance -= shown[members] @ inverse @ shown[members].T
        squares = float(residuals[members] @ residuals[members]) / max(float(np.trace(covariance)), 1e-9)
        values, vectors = np.linalg.eigh(covariance)
        root = (vectors * np.sqrt(np.maximum(values, 0.0)))[:, values > _ROUNDING]
        tried = [
            (length, *_judged(near, residuals[members], covariance, root, max(1.0, squares)), near.nnz / members.size)
            for length, near in _near(rows, members)
        ]
        if tried:
            length, coefficient, sigma, statistic, p, count = min(tried, key=lambda trial: trial[-2])
            corrected = min(1.0, p * len(tried))
            course = tuple(trial[:3] for trial in tried)
            spread = 1.0 + max(coefficient, 0.0) * count
            yield NearCorrelation(
                where, quantity, unit, term, length, coefficient, sigma, statistic, corrected, course, spread
            )


_KINDS = (
    ((IMAGE,), "image places", "residuals", "px", "[ties] window_px"),
    ((SURFACE, STEREO), "terrain model", "heights", "m", "[terrain] counts, or vertical_sigma_m larger"),
    ((RANGE,), "laser ranges", "residuals", "s", "[[shots]] drift_sigma_m"),
)


def _some(rows: ResidualRows, members: Index) -> Index:
    """Rows of as many points as may be compared: neighbours in the network's order, not scattered ones."""
    if members.size <= _MOST_ROWS:
        return members
    points = np.unique(rows.point[members])
    keep = points[: max(1, points.size * _MOST_ROWS // members.size)]
    return members[np.isin(rows.point[members], keep)]


def _near(rows: ResidualRows, members: Index) -> Iterator[tuple[float, "csr_array"]]:
    """Distances, and pairs (q, q) of rows nearer than these: of the same image and component."""
    from scipy.sparse import coo_array
    from scipy.spatial import cKDTree

    places, owner = _places(rows, members)
    separated = np.column_stack([places, np.zeros(members.size)])
    extent = 1e3 * (np.ptp(places, axis=0).max() + 1.0)
    separated[:, -1] = extent * owner
    tree = cKDTree(separated)
    nearest = tree.query(separated, k=2)[0][:, 1]
    unit = float(np.median(nearest[nearest < extent])) if np.any(nearest < extent) else 0.0
    if unit <= 0.0:
        return
    before = -1
    for within in _WITHIN:
        pairs = tree.query_pairs(within * unit, output_type="ndarray")
        if len(pairs) < _FEWEST_PAIRS or len(pairs) == before:
            continue
        before = len(pairs)
        first, second = np.concatenate([pairs, pairs[:, ::-1]]).T
        yield within * unit, coo_array((np.ones(first.size), (first, second)), (members.size,) * 2).tocsr()


def _places(rows: ResidualRows, members: Index) -> tuple[Array, Index]:
    """Where rows are: line and sample, m on the ground, s; and rows of which set are compared with each other."""
    network, kind = rows.at.network, int(rows.kind[members[0]])
    if kind == IMAGE:
        measure = rows.measure[members]
        return network.rays.places[measure], 2 * network.rays.image[measure] + rows.component[members]
    if kind == RANGE:
        measure = rows.measure[members]
        return network.ranges.times[measure][:, None] - network.ranges.times.min(), network.ranges.image[measure]
    return rows.at.layout.network_order(rows.at.points)[rows.point[members]], np.zeros(members.size, dtype=np.int64)


def _judged(
    near: "csr_array", residuals: Array, covariance: Array, root: Array, factor: float
) -> tuple[float, float, float, float]:
    """Coefficient, its sigma, test and p-value of v' K v, v having `factor` times a covariance, that of `root`."""
    product = near @ covariance
    mean, square = float(np.trace(product)), float(np.sum(product * product.T))
    value = float(residuals @ (near @ residuals)) / factor
    p = quadratic_tail(value, np.linalg.eigvalsh(root.T @ (near @ root))) if value > mean else 0.5
    return (value - mean) / square, float(np.sqrt(2.0 / square)), (value - mean) / float(np.sqrt(2.0 * square)), p


def quadratic_tail(value: float, weights: Array) -> float:
    """Probability that a sum of squares of independent standard normal variables with weights (n,), of either sign,
    exceeds a value: the saddlepoint formula of Lugannani & Rice (Kuonen 1999, Biometrika 86, 929).
    """
    from scipy.special import chdtrc, ndtr  # slow to import

    if np.ptp(weights) <= 1e-9 * np.abs(weights).max():
        return float(chdtrc(weights.size, max(value, 0.0) / weights[0]) if weights[0] > 0.0 else 1.0)
    mean, spread = float(weights.sum()), math.sqrt(2.0 * float(weights @ weights))
    if abs(value - mean) < 1e-3 * spread:  # between the two sides, where the formula is 0 / 0
        low, high = (quadratic_tail(mean + side * 2e-3 * spread, weights) for side in (-1.0, 1.0))
        return low + (high - low) * (0.5 + (value - mean) / (4e-3 * spread))
    t = _saddlepoint(value, weights)
    if not math.isfinite(t):
        return 1.0 if value < mean else 0.0
    inner = 1.0 - 2.0 * t * weights
    w = math.copysign(math.sqrt(max(2.0 * t * value + float(np.sum(np.log(inner))), 1e-300)), t)
    v = t * math.sqrt(2.0 * float(np.sum((weights / inner) ** 2)))
    return float(np.clip(ndtr(-(w + math.log(v / w) / w)), 0.0, 1.0))


def _saddlepoint(value: float, weights: Array) -> float:
    """Where the slope of the cumulant function is a value; NaN where no sum is so small, or so large."""
    from scipy.optimize import brentq

    def slope(t: float) -> float:
        return float(np.sum(weights / (1.0 - 2.0 * t * weights))) - value

    ends = [0.5 / edge * (1.0 - 1e-10) if edge * side > 0.0 else math.nan
            for edge, side in ((weights.min(), -1.0), (weights.max(), 1.0))]  # fmt: skip
    if slope(0.0) > 0.0:
        low, high = (-1.0 / np.abs(weights).max() if math.isnan(ends[0]) else ends[0]), 0.0
        while math.isnan(ends[0]) and slope(low) > 0.0:
            low *= 4.0
            if low < -1e30:
                return math.nan
    else:
        low, high = 0.0, ends[1]
    if not (math.isfinite(high) and slope(low) <= 0.0 <= slope(high)):
        return math.nan
    return float(brentq(slope, low, high))
