"""Covariances of the adjustment; a network linearized at its solution; whether the joint ellipsoid may be used.

Covariances are stated for sigma0 = 1, as the a-priori sigmas imply; multiply by sigma0 squared to scale them.

Their covariance S = N^-1 assumes a cost that is a paraboloid about the optimum x. It is none where a-priori sigmas are
so wide that rows are nonlinear within them. So states x + e are drawn from the ellipsoid, e of covariance S, with the
points solved at each, and twice the rise of the cost, L, is compared with q = e' S^-1 e. L is the square of a
likelihood ratio, chi-square with as many degrees of freedom as unknowns in any parametrization; q is its value by the
ellipsoid. Where L is larger on average, the ellipsoid holds states that the measures exclude: it lies across a curved
valley, and the truth, down in the valley, lies farther from x than chi-square says. Single unknowns may still be
reliable. (Bates & Watts, 1980, take second derivatives at x; draws test the whole region, for one sweep each.)
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.datum import POORLY, defects, scaled_normal
from mgsgraph.adjustment.fit import Fit, fit, residuals
from mgsgraph.adjustment.graph import BundleGraph, Layout, lay_out
from mgsgraph.adjustment.graph.forms import (
    IN_PROCESS,
    Sweeper,
    factor_of_blocks,
)
from mgsgraph.adjustment.marginals import JointCovariance, SquareRoot, begins, in_cliques, joint_covariance
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.sparse_cholesky import NotDefinite
from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.measurements import row_count
from mgsgraph.kernel.rows import OUT, Rows, of_points
from mgsgraph.kernel.sweep import COSTS, ROW_NUMBERS, Reduction, design
from mgsgraph.names import Names, grouped
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, ProfileShifts, Ranges
from mgsgraph.record import Record


def orientation_covariance(graph: BundleGraph, reduction: Reduction, consider: bool = True) -> JointCovariance:
    """Joint covariance of all orientation coefficients, m and rad, from a reduced system.

    Parameters
    ----------
    graph : BundleGraph
    reduction : Reduction
        Of all points, eliminated.
    consider : bool
        False is the covariance of the estimates were considered unknowns zero without error: what redundancy is about.

    Raises
    ------
    WeakNetwork
        Naming the directions, where nothing determines some of them.
    """
    layout = graph.layout
    try:
        factor = graph.factor(reduction)
    except NotDefinite:
        raise defects(layout, scaled_normal(layout, reduction), POORLY).error() from None
    if not factor.determined and np.any(np.isinf(layout.sigmas)):
        weak = defects(layout, scaled_normal(layout, reduction), POORLY)
        if weak.number:
            raise weak.error()
    joint = joint_covariance(factor.square_root())
    if not (consider and layout.prior.considered):
        return joint
    assert reduction.blocks is not None
    flat, more = reduction.blocks.copy(), dict[tuple[int, int], Array](considered_information(layout, joint))
    for v, w, block in layout.blocks.each(flat, layout.variables.width):
        if (v, w) in more:
            block += more[v, w]
    return joint_covariance(factor_of_blocks(layout, flat).square_root())


def considered_information(layout: Layout, joint: JointCovariance) -> Iterator[tuple[tuple[int, int], Array]]:
    """Information to be added on pairs of variables with considered columns (the first not after the second), so that
    the covariance of these becomes what it was beforehand.

    Schmidt (1966): of estimates x with considered unknowns c held at zero, S = dx/dc and a-priori covariance C_c,

        cov(x) = N_xx^-1 + S C_c S',    cov(x, c) = S C_c,    cov(c) = C_c,    S = -N_xx^-1 N_xc,

    which is the inverse of the normal matrix with C_c^-1 + N_cx N_xx^-1 N_xc in place of N_cc. Here x are the other
    columns of the same variables (heights of a terrain model whose shift is considered), everything else is eliminated.
    """
    variables, members = layout.variables, list(layout.prior.considered)
    columns = variables.columns_of_all(members)
    c, scales = np.flatnonzero(variables.considered[columns]), variables.prior_sigmas[columns]
    x = np.flatnonzero(~variables.considered[columns])
    scales = np.where(np.isfinite(scales), scales, layout.scales[columns])
    information = np.linalg.inv(joint.of(members) / scales / scales[:, None]) / scales / scales[:, None]
    wanted = np.diag(variables.sigmas[columns[c]] ** -2)
    wanted += information[np.ix_(c, x)] @ np.linalg.solve(information[np.ix_(x, x)], information[np.ix_(x, c)])
    more = np.zeros_like(information)
    more[np.ix_(c, c)] = wanted - information[np.ix_(c, c)]
    edges = begins(variables.width[members]).tolist()
    for a, v in enumerate(members):
        for b, w in enumerate(members[a:], a):
            yield (v, w), more[edges[a] : edges[a + 1], edges[b] : edges[b + 1]]


def point_covariances(
    layout: Layout,
    rows: Rows,
    orientation: Array,
    points: Array,
    joint: JointCovariance,
    sweeper: Sweeper = IN_PROCESS,
) -> Array:
    """(n, 3, 3) m^2 covariances of points, layout order, by back-substitution in the kernel; zero when fixed or out.

    S_p = V^-1 + V^-1 W' S_eo W V^-1 with the joint covariance S_eo of the orientation variables that see the point.
    """
    return sweeper.covariances(layout, rows, orientation, layout.blocks.filled(joint), points)


def prior_covariance(layout: Layout) -> JointCovariance | None:
    """Joint covariance of the shared unknowns by their priors alone; None where some have no prior."""
    if np.any(np.isinf(layout.sigmas)):
        return None
    try:
        factor = factor_of_blocks(layout, np.zeros(layout.blocks.target.size))
        if factor.determined:
            return joint_covariance(factor.square_root())
    except NotDefinite:
        pass
    return joint_covariance(_pass_by_pass(layout))


def _pass_by_pass(layout: Layout) -> SquareRoot:
    """Square root of the priors' information by a dense QR decomposition of each pass's rows.

    Nodes tightly bound to a weakly known trend make pivots fall below 2^-24 of the original diagonal. The rows
    themselves lose half as many digits as their squares.
    """
    variables, rows_of_priors, scales = layout.variables, layout.prior.design.tocsc(), layout.scales
    cliques, rows = _joined_by_priors(layout), list[Array]()
    for members in cliques:
        columns = variables.columns_of_all(members)
        part = rows_of_priors[:, columns]
        of_pass = part[np.unique(part.nonzero()[0])].toarray() * scales[columns]
        rows.append(np.linalg.qr(of_pass, mode="r") / scales[columns])
    return in_cliques(variables.first, variables.width, cliques, rows)


def _joined_by_priors(layout: Layout) -> list[list[int]]:
    """Adjusted variables grouped by the priors that connect them: passes, profiles that cross, single ones."""
    return list(grouped((int(layout.prior.group[v]), v) for v in layout.variables.adjusted()).values())



DRAWS = 32
"""States drawn: the ratio then has a sigma of 0.02 where it is near one."""
LINEAR = 1.1
"""Ratio up to which statements are made by the ellipsoid: normalised errors a tenth too large, sigmas a twentieth."""
MOST_POINTS, MOST_UNKNOWNS = 5_000, 1_000
"""Size up to which `adjust` tests it, in 0.05 s. Larger ones are tested on request."""


@dataclass(frozen=True, slots=True)
class Linearity(Record):
    """Test of the ellipsoid by states drawn from it.

    Examples
    --------
    >>> solution.linearity.linear
    True
    >>> round(solution.linearity.ratio, 2)
    1.0
    """

    ratio: float
    """Mean of L / q over the draws; infinite where one of them sees a point from behind."""
    scatter: float
    """Standard deviation of L / q."""
    unknowns: int
    """Shared unknowns, jointly."""
    draws: int
    """How many."""

    @property
    def linear(self) -> bool:
        """Whether the ellipsoid may be used for statements about all of them."""
        return 1.0 / LINEAR <= self.ratio <= LINEAR


def linearity(graph: BundleGraph, at: Reduction, root: SquareRoot) -> Linearity | None:
    """Of an optimum.

    Parameters
    ----------
    graph : BundleGraph
    at : Reduction
        There.
    root : SquareRoot
        Of the information there; considered unknowns held.

    Returns
    -------
    Linearity or None
        None where nothing is shared. The same network gives the same draws.
    """
    if root.columns == 0:
        return None
    drawn = np.random.default_rng(0).standard_normal((root.columns, DRAWS))
    squares, lowest = np.sum(drawn**2, axis=0), graph.cost(at)
    rises = np.array([_cost(graph, at, move) for move in root.back(drawn).T]) - lowest
    if not np.all(np.isfinite(rises)):
        return Linearity(math.inf, math.inf, root.columns, DRAWS)
    ratios = 2.0 * rises / squares
    return Linearity(float(ratios.mean()), float(ratios.std(ddof=1)), root.columns, DRAWS)


def _cost(graph: BundleGraph, at: Reduction, move: Array) -> float:
    """Full cost at a state that lies a move (columns,) from the optimum."""
    return graph.cost(graph.reduction(at.orientation + move, COSTS, at))




@dataclass(frozen=True, slots=True, eq=False)
class PointRows:
    """Whitened rows of some points that feel the same unknowns in the same way; m points, r rows, c columns."""

    variables: tuple[int, ...]
    """Shared unknowns that they feel, in the order of the columns."""
    residuals: Array
    """(m, r) in sigmas: of rays and ranges measured minus predicted; of a-priori places and heights above the terrain
    predicted minus known."""
    by_point: Array
    """(m, r, 3) per m."""
    by_shared: Array
    """(m, r, c) per m and rad."""
    observation: Index
    """(r,) observation, counted within the points' pattern, that each row belongs to."""
    row: Index
    """(r,) which row of it: line 0, sample 1; x, y, z of a ground prior."""
    known: bool
    """Whether the points are fixed: no unknowns, whatever the rows' derivatives by them."""

    def of(self, point: int) -> "PointRows":
        """Rows of one of the points."""
        chosen = slice(point, point + 1)
        return replace(
            self, residuals=self.residuals[chosen], by_point=self.by_point[chosen], by_shared=self.by_shared[chosen]
        )

    def following(self) -> tuple[Array, Array]:
        """The rows once the points follow the shared unknowns x: P = B N (m, r, 3) on the noise e that they keep for
        themselves, and J + B K (m, r, c) on x; nothing goes through known points.
        """
        if self.known:
            return np.zeros_like(self.by_point), self.by_shared
        carried, noise = self.eliminated()
        return self.by_point @ noise, self.by_shared + self.by_point @ carried

    def eliminated(self) -> tuple[Array, Array]:
        """The points as functions of the shared unknowns x and of noise e (3,) of their own, of unit covariance:
        point = K x + N e with K (m, 3, c) = -V^-1 W' and N (m, 3, 3) = L^-T, V = B'B = L L', W' = B'J.
        """
        turned = self.by_point.mT
        normal = turned @ self.by_point
        noise = np.linalg.solve(np.linalg.cholesky(normal), np.eye(3)).mT
        return np.asarray(-np.linalg.solve(normal, turned @ self.by_shared)), np.asarray(noise)


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """A network where it is linearised, and the covariance of the unknowns that its points share."""

    layout: Layout
    """Layout of all rows."""
    settings: SolverSettings
    """Settings of the layout."""
    rows: Rows
    """Rows that take part."""
    orientation: Array
    """(columns,) shared unknowns, m and rad."""
    points: Array
    """(n, 3) m, layout order."""
    joint: JointCovariance
    """Of the shared unknowns, for sigma0 = 1."""
    mixed: bool = False
    """Whether that is the mean square over a mixture of minima."""

    @property
    def network(self) -> Network:
        """The network that was adjusted."""
        return self.layout.network

    @property
    def values(self) -> list[Array]:
        """Value (width,) of each variable, m, rad and s; zero for held images."""
        return self.layout.variables.split(self.orientation)

    @property
    def places(self) -> Array:
        """(n, 3) m, of the network's points; NaN for those that nothing determines."""
        return self.layout.network_order(np.where((self.rows.kind == OUT)[:, None], np.nan, self.points))

    def point_covariances(self) -> Array:
        """(n, 3, 3) m^2, of these, for sigma0 = 1; NaN for those that nothing determines."""
        covariances = point_covariances(self.layout, self.rows, self.orientation, self.points, self.joint)
        out = self.rows.kind == OUT
        return self.layout.network_order(np.where(out[:, None, None], np.nan, covariances))

    def fit(self) -> Fit:
        """Weighted squares, observations and unknowns of the rows that take part."""
        misfit = residuals(self.layout, self.orientation, self.points)
        return fit(self.layout, self.rows, self.orientation, self.points, misfit)

    def of_estimator(self) -> "Linearised":
        """The same with the covariance of the estimates if considered unknowns had no error and this were the only
        minimum: for redundancy and tests of residuals. Itself where that is so.
        """
        if not (self.layout.prior.considered or self.mixed):
            return self
        graph = BundleGraph(self.layout, self.rows)
        reduction = graph.reduction(self.orientation, points=self.points)
        return replace(self, joint=orientation_covariance(graph, reduction, consider=False), mixed=False)

    def layout_index(self, point: int) -> int:
        """Place in the layout of a network point that takes part; InputError where nothing determines it."""
        index = int(self.layout.patterns.point_index[point])
        if self.rows.kind[index] == OUT:
            where = f"point {self.network.points.ids[point]}"
            raise InputError(where, "its measures determine no place, or were rejected", "a point that was adjusted")
        return index

    def rows_of(self, point: int) -> PointRows:
        """Rows of one network point that takes part."""
        index = self.layout_index(point)
        piece = int(self.layout.patterns.piece_of(index))
        return self.rows_inside(piece, np.array([index - self.rows.piece[piece, 1]]))

    def rows_of_piece(self, piece: int) -> PointRows:
        """Rows of all points of a piece of the layout, taking part or not."""
        return self.rows_inside(piece, np.arange(self.rows.piece[piece, 2]))

    def rows_inside(self, piece: int, inside: Index) -> PointRows:
        """Rows of some points (m,) of a piece of the layout, by their places in it."""
        rows = of_points(self.rows, piece, inside)
        return point_rows(self.layout, rows, self.orientation, self.points[self.rows.piece[piece, 1] + inside])

    def pair_blocks(self, layout: Layout) -> Array:
        """Covariance of the shared unknowns in the blocks of a layout, this one's or that of `asked`."""
        return layout.blocks.filled(self.joint)

    def asked(self, places: Array, rays: ImageRays, held: bool) -> Layout:
        """Layout of unmeasured places (m, 3) in m, on the same shared unknowns.

        Rays of `held` places are rows without a point; those of others intersect in them.
        """
        network, m = self.network, places.shape[0]
        kinds, ids = np.full(m, PointKind.FIXED if held else PointKind.FREE), Names.of(f"place {k}" for k in range(m))
        points = GroundPoints(ids, np.full(m, PointClass.TIE), kinds, places, np.zeros((m, 3, 3)))
        shifts, surface = network.shifts, network.surface
        none_of = (np.full(size, -1) for size in (network.rays.point.size, len(network.points)))
        of_rays, of_heights = network.common_of(*none_of)
        bare = replace(
            network,
            points=points,
            rays=rays,
            ranges=Ranges.none(),
            shifts=None if shifts is None else ProfileShifts(shifts.names, np.full(m, -1), shifts.sigmas),
            surface=None if surface is None else replace(surface, sigmas=np.full(m, np.inf)),
            stereo=None,
            crossovers=None,
            common_rays=of_rays,
            common_heights=of_heights,
        )
        # the papers' form has no derivatives of a place, only of a misfit at a measured line
        return lay_out(bare, replace(self.settings, line="predicted") if held else self.settings, places)


def point_rows(layout: Layout, rows: Rows, orientation: Array, points: Array) -> PointRows:
    """Rows of the points (m, 3) of one piece, which is all that `rows` holds of the layout's."""
    pattern, _, count, _, _ = rows.piece[0].tolist()
    group, first = int(rows.pattern_group[pattern]), int(rows.pattern_observation[pattern])
    observations = np.arange(first, rows.pattern_observation[pattern + 1])
    numbers = design(rows, layout.groups, layout.blocks.target, layout.model, orientation, points)
    counts = map(row_count.py_func, rows.observation_kind[observations].tolist())
    of_row = [(i, row) for i, count_of in enumerate(counts) for row in range(count_of)]
    observation, row = np.array(of_row, dtype=np.int64).reshape(-1, 2).T
    of_points = numbers.reshape(-1, count, *numbers.shape[1:])[observation, :, row].transpose(1, 0, 2)
    width = layout.groups.member_width[slice(*layout.groups.member_first[group : group + 2])]
    by_shared = np.zeros((count, observation.size, int(width.sum())))
    for k, places in enumerate(_columns(rows, first + observation, np.cumsum(width) - width)):
        for n, column in enumerate(places.tolist()):
            by_shared[:, k, column] += of_points[:, k, ROW_NUMBERS + n]
    known = bool(rows.pattern_fixed[pattern])
    by_point = of_points[:, :, 1:ROW_NUMBERS]
    return PointRows(layout.group_variables[group], of_points[:, :, 0], by_point, by_shared, observation, row, known)


def _columns(rows: Rows, observations: Index, first_of_member: Index) -> list[Index]:
    """For each row's observation, the columns of its numbers in the group."""
    columns = []
    for i in observations.tolist():
        entry, terms = int(rows.observation_entry[i]), int(rows.observation_terms[i])
        own_columns = slice(entry, entry + terms + int(rows.observation_shared[i]))
        begin = first_of_member[rows.entry_member[own_columns]] + rows.entry_inside[own_columns]
        columns.append(np.concatenate([(begin[:terms, None] + np.arange(6)).ravel(), begin[terms:]]))
    return columns
