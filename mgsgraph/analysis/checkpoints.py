"""Known ground coordinates against an adjustment that made no use of them: checkpoints, and control left out.

A checkpoint (`GroundPoints.checkpoints`) is adjusted as a tie point is: its image measurements take part, its known
coordinates k do not. Its discrepancy is d = x - k, adjusted minus known; x and k have no error in common, and so

    cov(d) = C + K,  C the posterior covariance of x, K the known one of k.

A control point that takes part has v = x - k of covariance K - C. Were its known coordinates alone left out, the
others unchanged, it would be (Cook & Weisberg 1982, section 2.2; in terms of redundancy R = I - C K^-1 of its rows)

    d = K (K - C)^-1 v,  cov(d) = K (K - C)^-1 K.

Discrepancies of several points depend on each other through the orientation, by the blocks of C between them: the joint
chi-square has these in it. With considered unknowns C in the influence K (K - C)^-1 is that of the estimator, and v
has what the considered unknowns add to C as well.
"""

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from mgsgraph.adjustment.covariances import Linearised
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_points, require_covariance
from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.records import Array, Index, sigmas_of, thinned
from mgsgraph.network import Network, PointClass
from mgsgraph.record import Record

_MOST_JOINT = 200
"""Points whose joint covariance is formed; of more, so many at even steps."""
_CONTROLLED, _ROUNDING = 1e-7, 1e-12
"""Below which only rounding is left of a direction: redundancy, a difference of 1, and variances over the largest."""
_TAIL = 0.025
"""Probability beyond either end of the band of chi-square."""


@dataclass(frozen=True, slots=True, eq=False)
class Discrepancies(Record):
    """Coordinates of n points without their own control, minus their known ones; sigmas for sigma0 = 1.

    Examples
    --------
    >>> from mgsgraph.analysis.checkpoints import leave_out
    >>> len(leave_out(posterior.linearised).points)
    0
    """

    points: Index
    """(n,) numbers in the network."""
    values: Array
    """(n, 3) m, east, north, up."""
    covariances: Array
    """(n, 3, 3) m^2, of them."""
    chi_square: float
    """Of all together, with their correlations."""
    degrees: int
    """Degrees of freedom of that."""
    joint: int
    """Points in it: all, or `_MOST_JOINT` of more."""
    undetermined: Index
    """(u,) further points: nothing but their own control determines them."""

    @property
    def sigmas(self) -> Array:
        """(n, 3) m, east, north, up."""
        return sigmas_of(self.covariances)

    @property
    def normalized(self) -> Array:
        """(n, 3) values over their sigmas."""
        return self.values / self.sigmas

    @property
    def rms(self) -> Array:
        """(3,) m, east, north, up."""
        return np.asarray(np.sqrt(np.mean(self.values**2, axis=0)))

    @property
    def band(self) -> tuple[float, float]:
        """Chi-square is between these with a probability of 95 %, if the stated sigmas are right."""
        from scipy.special import chdtri  # slow to import

        return float(chdtri(self.degrees, 1.0 - _TAIL)), float(chdtri(self.degrees, _TAIL))

    @property
    def p_value(self) -> float:
        """Chance of a chi-square of this size or more."""
        from scipy.special import chdtrc  # slow to import

        return float(chdtrc(self.degrees, self.chi_square)) if self.degrees else 1.0


_OF_SOLUTIONS: "WeakKeyDictionary[Solution, Discrepancies]" = WeakKeyDictionary()
"""Discrepancies at the checkpoints of solutions, which never change: the verdict, sentences and tables ask for them."""


def checkpoint_discrepancies(solution: Solution) -> Discrepancies | None:
    """Adjusted minus known coordinates of the checkpoints; None without any, and of a solution without covariance."""
    if not solution.network.points.checkpoints.size:
        return None
    result = _OF_SOLUTIONS.get(solution)
    if result is None:
        try:
            require_covariance(solution)
        except InputError:
            return None
        result = _OF_SOLUTIONS[solution] = _at_checkpoints(solution)
    return result


def _at_checkpoints(solution: Solution) -> Discrepancies:
    known, points = solution.network.points, solution.network.points.checkpoints
    determined = solution.determined[points]
    chosen, others = points[determined], points[~determined]
    if not chosen.size:
        return Discrepancies(chosen, np.zeros((0, 3)), np.zeros((0, 3, 3)), 0.0, 0, 0, others)
    some = thinned(chosen.size, _MOST_JOINT)
    joint = _joint(at_points(solution, chosen[some]), np.arange(some.size))
    joint += _block_diagonal(known.covariances[chosen[some]])
    scale, values = sigmas_of(joint), solution.places[chosen] - known.places[chosen]
    test = _chi_square(values[some].ravel() / scale, joint / scale / scale[:, None], _ROUNDING)
    covariances = solution.covariances[chosen] + known.covariances[chosen]
    return _local(solution.network, chosen, values, covariances, (*test, some.size), others)


def leave_out(at: Linearised) -> Discrepancies:
    """Discrepancies that constrained ties and ground control points would have, each alone without its a-priori
    position, as the linearised adjustment has them: nothing is adjusted anew.

    Fixed points are none of them: their a-priori position has no sigma, and is no row that could be left out.
    """
    network, estimator = at.network, at.of_estimator()
    points = control_points(network, PointKind.CONSTRAINED)
    root = np.linalg.cholesky(network.points.covariances[points])
    whitening = np.linalg.inv(root)

    def whitened(matrices: Array) -> Array:
        return np.asarray(whitening @ matrices @ whitening.mT)

    of_estimator = whitened(estimator.point_covariances()[points])
    spread = np.eye(3) + whitened(at.point_covariances()[points]) - 2.0 * of_estimator
    redundancy = np.eye(3) - of_estimator
    controlled = np.linalg.eigvalsh(redundancy)[:, 0] > _CONTROLLED
    left, chosen = np.flatnonzero(controlled), points[controlled]
    misfit = at.places[points] - network.points.places[points]
    misfit = np.einsum("nij,nj->ni", whitening, misfit)
    influence = root[left] @ np.linalg.inv(redundancy[left])
    values = np.einsum("nij,nj->ni", influence, misfit[left])
    covariances = influence @ spread[left] @ influence.mT
    some = thinned(chosen.size, _MOST_JOINT)
    difference = _joint(at, chosen[some]) - 2.0 * _joint(estimator, chosen[some])
    turn = _block_diagonal(whitening[left[some]])
    test = _chi_square(misfit[left[some]].ravel(), np.eye(3 * some.size) + turn @ difference @ turn.T, _CONTROLLED)
    return _local(network, chosen, values, covariances, (*test, some.size), points[~controlled])


def control_points(network: Network, kind: PointKind) -> Index:
    """(n,) ties and ground control points of a kind: neither laser shots nor posts, which are no single points."""
    of_class = np.isin(network.points.classes, (PointClass.TIE, PointClass.CONTROL))
    return np.flatnonzero(of_class & (network.points.kinds == kind))


def _local(
    network: Network, points: Index, values: Array, covariances: Array, test: tuple[float, int, int], others: Index
) -> Discrepancies:
    """The record of body-fixed values (n, 3) in m with covariances (n, 3, 3), and of the test of all."""
    frames = east_north_up(network.points.places[points])
    turned = frames @ covariances @ frames.mT
    return Discrepancies(points, np.einsum("nij,nj->ni", frames, values), turned, *test, others)


def _joint(at: Linearised, points: Index) -> Array:
    """(3 n, 3 n) m^2, joint covariance of points (n,)."""
    of_points = [at.rows_of(point) for point in points.tolist()]
    variables = list(dict.fromkeys(variable for rows in of_points for variable in rows.variables))
    width = at.layout.variables.width[np.array(variables, dtype=np.int64)]
    columns = {v: np.arange(end - size, end) for v, size, end in zip(variables, width, np.cumsum(width), strict=True)}
    by_shared, own = np.zeros((points.size, 3, int(width.sum()))), np.zeros((points.size, 3, 3))
    for k, rows in enumerate(of_points):
        carried, noise = rows.eliminated()
        if rows.variables:
            by_shared[k][:, np.concatenate([columns[variable] for variable in rows.variables])] = carried[0]
        own[k] = noise[0] @ noise[0].T
    through = by_shared.reshape(3 * points.size, by_shared.shape[2])
    return np.asarray(through @ at.joint.of(variables) @ through.T + _block_diagonal(own))


def _block_diagonal(blocks: Array) -> Array:
    """(3 n, 3 n) with blocks (n, 3, 3) on its diagonal."""
    n = blocks.shape[0]
    return np.asarray(np.einsum("nij,nm->nimj", blocks, np.eye(n)).reshape(3 * n, 3 * n))


def _chi_square(values: Array, covariance: Array, least: float) -> tuple[float, int]:
    """Chi-square of values (m,) with a covariance (m, m) of sizes about 1, and its degrees of freedom: directions
    of less than the `least` variance, such as datum transformations that nothing else determines, do not count.
    """
    variances, directions = np.linalg.eigh(covariance)
    sound = variances > least
    along = directions.T[sound] @ values
    return float(np.sum(along**2 / variances[sound])), int(np.count_nonzero(sound))
