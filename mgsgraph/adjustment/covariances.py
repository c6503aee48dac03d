"""Covariances of the adjustment: of the orientation coefficients and shared unknowns, and of every point.

Covariances are stated for sigma0 = 1, as the a-priori sigmas imply; multiply by sigma0 squared to scale them.
"""

from collections.abc import Iterator

import gtsam
import numpy as np

from mgsgraph.adjustment.datum import POORLY, defects, scaled_normal
from mgsgraph.adjustment.graph import BundleGraph, Layout
from mgsgraph.adjustment.graph.bundle import (
    IN_PROCESS,
    Sweeper,
    factor_of_blocks,
    point_key,
    variable_key,
)
from mgsgraph.adjustment.marginals import JointCovariance, dense_covariance, joint_covariance
from mgsgraph.adjustment.sparse_cholesky import NotDefinite
from mgsgraph.adjustment.square_root import SquareRoot, begins, in_cliques
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.rows import Rows
from mgsgraph.kernel.sweep import Reduction


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
    flat, more = reduction.blocks.copy(), dict[tuple[int, int], Array](_considered_information(layout, joint))
    for v, w, block in layout.blocks.each(flat, layout.variables.width):
        if (v, w) in more:
            block += more[v, w]
    return joint_covariance(factor_of_blocks(layout, flat).square_root())


def _considered_information(layout: Layout, joint: JointCovariance) -> Iterator[tuple[tuple[int, int], Array]]:
    """Information to be added on pairs of variables with considered columns (the first not after the second), so that
    the covariance of these becomes what it was beforehand.

    Schmidt (1966): of estimates x with considered unknowns c held at zero, S = dx/dc and a-priori covariance C_c,

        cov(x) = N_xx^-1 + S C_c S',    cov(x, c) = S C_c,    cov(c) = C_c,    S = -N_xx^-1 N_xc,

    which is the inverse of the normal matrix with C_c^-1 + N_cx N_xx^-1 N_xc in place of N_cc. Here x are the other
    columns of the same variables (heights of a terrain model whose shift is considered), everything else is eliminated.
    """
    variables, members = layout.variables, list(layout.prior.considered)
    columns = np.concatenate([np.arange(*variables.columns_of(v).indices(layout.columns)) for v in members])
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


def explicit_covariances(
    layout: Layout, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> tuple[JointCovariance, Array]:
    """The same two from the explicit graph: GTSAM eliminates its points, and gives their marginals (n, 3, 3)."""
    linear, first_points, shared = graph.linearize(values), gtsam.Ordering(), gtsam.Ordering()
    points = [i for i in range(layout.rows.kind.size) if values.exists(point_key(i))]
    for i in points:
        first_points.push_back(point_key(i))
    for v in layout.variables.adjusted():
        shared.push_back(variable_key(layout, v))
    _, reduced = linear.eliminatePartialMultifrontal(first_points)
    joint = _joint(layout, reduced, shared)
    if layout.prior.considered:
        for factor in _considered_factors(layout, joint):
            reduced.push_back(factor)
            linear.push_back(factor)
        joint = _joint(layout, reduced, shared)
    covariances, found = np.zeros((layout.rows.kind.size, 3, 3)), gtsam.Marginals(linear, values)
    for i in points:
        covariances[i] = found.marginalCovariance(point_key(i))
    return joint, covariances


def _joint(layout: Layout, reduced: gtsam.GaussianFactorGraph, shared: gtsam.Ordering) -> JointCovariance:
    """Joint covariance of a linear system of the shared unknowns, inverted as one matrix."""
    units = np.outer(layout.scales, layout.scales)
    covariance = np.linalg.inv(reduced.hessian(shared)[0] * units) * units
    return dense_covariance(layout.variables.first, layout.variables.width, covariance)


def _considered_factors(layout: Layout, joint: JointCovariance) -> Iterator[gtsam.HessianFactor]:
    """The information on considered unknowns that is to be added, as GTSAM's factors."""
    for (v, w), block in _considered_information(layout, joint):
        keys = variable_key(layout, v), variable_key(layout, w)
        zeros = [np.zeros(size) for size in block.shape]
        if v == w:
            yield gtsam.HessianFactor(keys[0], block, zeros[0], 0.0)
        else:
            empty = [np.zeros((size, size)) for size in block.shape]
            yield gtsam.HessianFactor(*keys, empty[0], block, zeros[0], empty[1], zeros[1], 0.0)


def prior_covariance(layout: Layout) -> JointCovariance | None:
    """Joint covariance of the shared unknowns as their priors alone have it; None where of some nothing is known."""
    if np.any(np.isinf(layout.sigmas)):
        return None
    try:
        factor = factor_of_blocks(layout, np.zeros(layout.blocks.target.size))
        if factor.determined:
            return joint_covariance(factor.square_root())
    except NotDefinite:
        pass
    return joint_covariance(_strip_by_strip(layout))


def _strip_by_strip(layout: Layout) -> SquareRoot:
    """Square root of the priors' information by a dense QR decomposition of each strip's rows.

    Nodes that may hardly leave a trend of which little is known make pivots fall below 2^-24 of the diagonal that they
    began with. The rows themselves lose half as many digits as their squares.
    """
    variables, every, scales = layout.variables, layout.prior.every.tocsc(), layout.scales
    cliques, rows = _known_together(layout), list[Array]()
    for members in cliques:
        columns = np.concatenate([np.arange(variables.first[v], variables.columns_of(v).stop) for v in members])
        part = every[:, columns]
        own = part[np.unique(part.nonzero()[0])].toarray() * scales[columns]
        rows.append(np.linalg.qr(own, mode="r") / scales[columns])
    return in_cliques(variables.first, variables.width, cliques, rows)


def _known_together(layout: Layout) -> list[list[int]]:
    """Adjusted variables in groups that no prior joins: strips, profiles that cross, and any other by itself."""
    group, together = layout.prior.group, dict[int, list[int]]()
    for v in layout.variables.adjusted():
        together.setdefault(int(group[v]), []).append(v)
    return list(together.values())
