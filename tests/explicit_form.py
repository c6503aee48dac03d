"""The adjustment that GTSAM alone makes of a network: an independent reference for small ones."""

from dataclasses import replace

import gtsam
import numpy as np

from mgsgraph.adjustment.graph import lay_out
from mgsgraph.adjustment.graph.bundle import point_key, shared_vector
from mgsgraph.adjustment.graph.explicit import explicit_covariances, explicit_graph
from mgsgraph.adjustment.graph.variables import pass_values, shared_values, shift_values
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
