"""The adjustment that GTSAM alone makes of a network: an independent reference for small ones."""

from dataclasses import replace

import gtsam
import numpy as np

from mgsgraph.adjustment.covariances import considered_information
from mgsgraph.adjustment.graph import Layout, lay_out
from mgsgraph.adjustment.graph.forms import explicit_graph, point_key, shared_vector, variable_key
from mgsgraph.adjustment.graph.variables import pass_values, shared_values, shift_values
from mgsgraph.adjustment.marginals import JointCovariance, dense_covariance
from mgsgraph.adjustment.rounds import exactly
from mgsgraph.adjustment.solution import Solution


def by_gtsam(solution: Solution) -> Solution:
    """The solution with what GTSAM's optimiser finds of the explicit graph about the same lines, from the nominal
    orientation on, and with its marginals.
    """
    network, out = solution.network, ~solution.determined
    layout = lay_out(network, solution.settings)
    variables, places = layout.variables, np.where(out[:, None], 0.0, solution.places)
    layout, points = exactly(layout, variables.joined(solution.values), places[layout.point_order])
    rows = layout.active(solution.rays_used | out[network.rays.point], solution.ranges_used, out, solution.stereo_used)
    graph, values = explicit_graph(layout, rows, np.zeros(layout.columns), points)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setDiagonalDamping(True)
    parameters.setRelativeErrorTol(1e-15)
    parameters.setAbsoluteErrorTol(1e-15)
    parameters.setlambdaInitial(1e-10)
    parameters.setMaxIterations(100)
    optimum = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    joint, covariances = explicit_covariances(layout, graph, optimum)
    x = shared_vector(layout, optimum)
    for i in range(len(points)):
        if optimum.exists(point_key(i)):
            points[i] = optimum.atPoint3(point_key(i))
    own = iter(x[variables.columns_of(j)].reshape(-1, 6) for j in np.flatnonzero(network.with_polynomial).tolist())
    nodes, trends = pass_values(network, variables, x)
    shifts, lift = shift_values(network, variables, x)
    return replace(
        solution,
        cost_final=float(graph.error(optimum)),
        coefficients=tuple(next(own) if mine else np.zeros_like(prior.sigmas)
                           for mine, prior in zip(network.with_polynomial, network.priors, strict=True)),
        shifts=shifts, lift=lift, shared=shared_values(network, variables, x), nodes=nodes, trends=trends,
        places=layout.network_order(points), covariances=layout.network_order(covariances), joint_covariance=joint,
    )  # fmt: skip


def explicit_covariances(
    layout: Layout, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> tuple[JointCovariance, np.ndarray]:
    """Joint covariance of the shared unknowns and covariances (n, 3, 3) of points: inverted as one
    matrix.
    """
    order, n = gtsam.Ordering(), layout.rows.kind.size
    points = [i for i in range(n) if values.exists(point_key(i))]
    for key in (*(variable_key(layout, v) for v in layout.variables.adjusted()), *map(point_key, points)):
        order.push_back(key)
    information = graph.linearize(values).hessian(order)[0]
    scales = np.concatenate([layout.scales, np.full(3 * len(points), 100.0)])

    def inverted() -> tuple[JointCovariance, np.ndarray]:
        units = np.outer(scales, scales)
        every, shared = np.linalg.inv(information * units) * units, slice(layout.columns)
        return dense_covariance(layout.variables.first, layout.variables.width, every[shared, shared]), every

    joint, every = inverted()
    if layout.prior.considered:
        for (v, w), block in considered_information(layout, joint):
            rows, columns = layout.columns_of(v), layout.columns_of(w)
            information[rows, columns] += block
            if v != w:
                information[columns, rows] += block.T
        joint, every = inverted()
    found, first = np.zeros((n, 3, 3)), layout.columns
    for k, i in enumerate(points):
        mine = slice(first + 3 * k, first + 3 * k + 3)
        found[i] = every[mine, mine]
    return joint, found
