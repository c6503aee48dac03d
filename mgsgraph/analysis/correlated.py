"""Do residuals of near points resemble each other? Moran's statistic of least-squares residuals (Cliff & Ord 1981).

With v the whitened residuals, of covariance C, and K one for each pair of rows nearer than some distance, else zero,
v' K v is the score of a common correlation of near rows. Its cumulants are those of a quadratic form of normal
variables, kappa_n = 2^(n-1) (n-1)! tr (K C)^n: the correlation that least squares itself brings about is in them. By
the first four it is said whether the statistic is suspicious, by all eigenvalues then how much.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.analysis.residual_rows import ResidualRows
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.rows import IMAGE, RANGE, STEREO, SURFACE

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_MOST_ROWS = 600
"""Rows of a kind that are compared."""
_WITHIN = (1.0, 2.0, 4.0, 8.0)
"""Distances within which points count as near, in median distances of a point to its nearest one."""
_FEWEST_PAIRS = 20
_SUSPICIOUS = 0.05
"""p-value by four cumulants from which down all eigenvalues are taken."""
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
        mine = np.flatnonzero(np.isin(rows.kind, kinds))
        mine = _some(rows, mine)
        if mine.size < _FEWEST_PAIRS:
            continue
        covariance = rows.variance(mine, np.eye(mine.size))
        for shown, inverse in taken:
            covariance -= shown[mine] @ inverse @ shown[mine].T
        squares = float(residuals[mine] @ residuals[mine]) / max(float(np.trace(covariance)), 1e-9)
        tried = [
            (length, *_judged(near, residuals[mine], covariance, max(1.0, squares)), near.nnz / mine.size)
            for length, near in _near(rows, mine)
        ]
        if tried:
            length, coefficient, sigma, statistic, p, count = min(tried, key=lambda one: one[-2])
            every = min(1.0, p * len(tried))
            course = tuple(one[:3] for one in tried)
            spread = 1.0 + max(coefficient, 0.0) * count
            yield NearCorrelation(
                where, quantity, unit, term, length, coefficient, sigma, statistic, every, course, spread
            )


_KINDS = (
    ((IMAGE,), "image places", "residuals", "px", "[ties] window_px"),
    ((SURFACE, STEREO), "terrain model", "heights", "m", "[terrain] counts, or vertical_sigma_m larger"),
    ((RANGE,), "laser ranges", "residuals", "s", "[[shots]] drift_sigma_m"),
)


def _some(rows: ResidualRows, mine: Index) -> Index:
    """Rows of as many points as may be compared: neighbours in the network's order, not scattered ones."""
    if mine.size <= _MOST_ROWS:
        return mine
    points = np.unique(rows.point[mine])
    keep = points[: max(1, points.size * _MOST_ROWS // mine.size)]
    return mine[np.isin(rows.point[mine], keep)]


def _near(rows: ResidualRows, mine: Index) -> Iterator[tuple[float, "csr_array"]]:
    """Distances, and pairs (q, q) of rows nearer than these: of the same image and component."""
    from scipy.sparse import coo_array
    from scipy.spatial import cKDTree

    places, owner = _places(rows, mine)
    apart = np.column_stack([places, np.zeros(mine.size)])
    extent = 1e3 * (np.ptp(places, axis=0).max() + 1.0)
    apart[:, -1] = extent * owner
    tree = cKDTree(apart)
    nearest = tree.query(apart, k=2)[0][:, 1]
    unit = float(np.median(nearest[nearest < extent])) if np.any(nearest < extent) else 0.0
    if unit <= 0.0:
        return
    before = -1
    for within in _WITHIN:
        pairs = tree.query_pairs(within * unit, output_type="ndarray")
        if len(pairs) < _FEWEST_PAIRS or len(pairs) == before:
            continue
        before = len(pairs)
        one, other = np.concatenate([pairs, pairs[:, ::-1]]).T
        yield within * unit, coo_array((np.ones(one.size), (one, other)), (mine.size,) * 2).tocsr()


def _places(rows: ResidualRows, mine: Index) -> tuple[Array, Index]:
    """Where rows are: line and sample, m on the ground, s; and rows of which set are compared with each other."""
    network, kind = rows.at.network, int(rows.kind[mine[0]])
    if kind == IMAGE:
        measure = rows.measure[mine]
        return network.rays.places[measure], 2 * network.rays.image[measure] + rows.component[mine]
    if kind == RANGE:
        measure = rows.measure[mine]
        return network.ranges.times[measure][:, None] - network.ranges.times.min(), network.ranges.image[measure]
    return rows.at.layout.network_order(rows.at.points)[rows.point[mine]], np.zeros(mine.size, dtype=np.int64)


def _judged(near: "csr_array", residuals: Array, covariance: Array, factor: float) -> tuple[float, float, float, float]:
    """Coefficient, its sigma, test and p-value of v' K v, v having `factor` times a covariance."""
    product = near @ covariance
    squared = product @ product
    traces = (
        float(np.trace(product)), float(np.trace(squared)),
        float(np.sum(squared * product.T)), float(np.sum(squared * squared.T)),
    )  # fmt: skip
    value = float(residuals @ (near @ residuals)) / factor
    test = (value - traces[0]) / np.sqrt(2.0 * traces[1])
    p = roughly(test, traces)
    if p < _SUSPICIOUS:
        values, vectors = np.linalg.eigh(covariance)
        root = (vectors * np.sqrt(np.maximum(values, 0.0)))[:, values > _ROUNDING]
        p = tail(value, np.linalg.eigvalsh(root.T @ (near @ root)))
    return (value - traces[0]) / traces[1], float(np.sqrt(2.0 / traces[1])), test, p


def roughly(test: float, traces: tuple[float, float, float, float]) -> float:
    """Probability of a quadratic form of normal variables so many standard deviations above its mean, by the traces of
    the first four powers of its matrix (Liu, Tang & Zhang 2009, Computational Statistics & Data Analysis 53, 853).
    """
    from scipy.special import ndtr  # slow to import
    from scipy.stats import ncx2

    _, second, third, fourth = traces
    s1, s2 = third / second**1.5, fourth / second**2
    if s1 <= 0.0:
        return float(ndtr(-test))
    a, shift = 1.0 / s1, 0.0
    degrees = a**2
    if s1**2 > s2:
        a = 1.0 / (s1 - np.sqrt(s1**2 - s2))
        shift = s1 * a**3 - a**2
        degrees = a**2 - 2.0 * shift
    return float(ncx2.sf(test * np.sqrt(2.0) * a + degrees + shift, degrees, shift))


def tail(value: float, weights: Array) -> float:
    """Probability that a sum of squares of independent standard normal variables, with these weights (n,) of either
    sign, exceeds a value above its mean: the saddlepoint formula of Lugannani & Rice (Kuonen 1999, Biometrika 86, 929).
    """
    from scipy.optimize import brentq  # slow to import
    from scipy.special import ndtr

    def slope(t: float) -> float:
        return float(np.sum(weights / (1.0 - 2.0 * t * weights))) - value

    if slope(0.0) >= 0.0:
        return 0.5
    t = brentq(slope, 0.0, 0.5 / weights.max() * (1.0 - 1e-10))
    inner = 1.0 - 2.0 * t * weights
    w = np.sqrt(2.0 * t * value + np.sum(np.log(inner)))
    v = t * np.sqrt(2.0 * np.sum((weights / inner) ** 2))
    return float(ndtr(-(w + np.log(v / w) / w)))
