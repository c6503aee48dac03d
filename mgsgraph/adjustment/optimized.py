"""What another optimizer found of a factor graph, as a solution."""

from dataclasses import replace

import gtsam
import numpy as np

from mgsgraph.adjustment.adjust import Clock, nominal_reduction, nominal_state, read_off
from mgsgraph.adjustment.batch import Outcome
from mgsgraph.adjustment.factor_graph import Source, factor_graph, network_and_settings
from mgsgraph.adjustment.graph import BundleGraph, Layout, lay_out
from mgsgraph.adjustment.graph.forms import IN_PROCESS
from mgsgraph.adjustment.keys import Keys
from mgsgraph.adjustment.marginals import dense_covariance
from mgsgraph.adjustment.optimize import Marginals, steps_left
from mgsgraph.adjustment.rounds import Solved, all_rows, relinearized
from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import PointKind

_CONVERGED = 0.01
"""Posterior sigmas from the minimum within which what was optimized elsewhere counts as converged."""


def solution_of(
    source: Source, values: gtsam.Values, graph: gtsam.NonlinearFactorGraph | None = None, name: str | None = None
) -> Solution:
    """What another optimizer found of `factor_graph`, as a solution to be reported, analyzed and exported.

    Parameters
    ----------
    source : Case, Network or Solution
        What the graph was made of, by `factor_graph` or by hand with its keys.
    values : gtsam.Values
        Of its keys; further ones are of no account.
    graph : gtsam.NonlinearFactorGraph, optional
        What was optimized, where factors of one's own were added: final cost and covariances are then its own.
        Residuals, their statistics and tests are those of the network's measurements, and so is the cost before. A
        solution does not keep such factors: `factor_graph(solution)` is the network's graph.
    name : str, optional
        What to call it in reports; the source's own when absent.

    Returns
    -------
    Solution
        Not converged where the minimum is farther than 0.01 posterior sigmas; its message says how far.

    Raises
    ------
    InputError
        Where a key of the source has no value.
    WeakNetwork
        Some direction of the unknowns is not determined.

    Examples
    --------
    >>> graph, values, keys = mgsgraph.factor_graph(network)
    >>> found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    >>> mgsgraph.solution_of(network, found).converged
    True
    """
    network, settings = network_and_settings(source)
    clock, keys, left_in = Clock(), Keys(network), None
    if isinstance(source, Solution):
        marks = {"rays": source.rays_rejected, "ranges": source.ranges_rejected, "stereo": source.stereo_rejected}
        left_in = replace(all_rows(network), **{name: ~mark for name, mark in marks.items() if mark is not None})
    layout, selection, before = nominal_reduction(lay_out(network, settings), left_in=left_in)
    initial, nominal = BundleGraph(layout).cost(before), nominal_state(layout, before)
    network_graph = factor_graph(source).graph
    whole = network_graph if graph is None else graph
    for key in network_graph.keyVector():
        if not values.exists(key):
            raise InputError("values", f"none of {keys.name(key)}", "one of each unknown of the network")
    known = [
        values.atVector(keys.variable(v)) if first >= 0 else np.zeros(0)
        for v, first in enumerate(layout.variables.first.tolist())
    ]
    orientation = layout.variables.joined(known)
    reduction = BundleGraph(layout, selection.rows(layout)).reduction(orientation)
    layout, reduction = relinearized(layout, selection, reduction, own=True)
    points = reduction.points.copy()
    for k, i in enumerate(layout.point_order.tolist()):
        if values.exists(keys.point(i)):
            points[k] = values.atPoint3(keys.point(i))
    far = steps_left(whole, values)
    message = f"Optimized elsewhere, {far:.2g} posterior sigmas from the minimum."
    if (more := whole.size() - network_graph.size()) > 0:
        message += f" The cost counts {more} factors that are not the network's, sigma0 does not."
    if graph is None and far >= _CONVERGED:
        message += " Are the values of this network? With factors of your own pass their graph, too."
    outcome = Outcome(orientation, initial, whole.error(values), far < _CONVERGED, message, ())
    rows = selection.rows(layout)
    solved = Solved(layout, outcome, (), initial, orientation, points, rows, selection, reduction, 1)
    clock.stop("solve")
    own = getattr(source, "name", "adjustment") if name is None else name
    found = read_off(settings, str(own), solved, nominal, clock, IN_PROCESS, None)
    return found if graph is None else _with_marginals(found, layout, Marginals(graph, values), keys)


def _with_marginals(solution: Solution, layout: Layout, marginals: Marginals, keys: Keys) -> Solution:
    """The same with covariances of another graph."""
    variables, covariances = layout.variables, solution.covariances.copy()
    for i in np.flatnonzero(solution.determined & (solution.network.points.kinds != PointKind.FIXED)).tolist():
        covariances[i] = marginals.covariance(keys.point(i))
    shared = [keys.variable(int(v)) for v in variables.adjusted()]
    joint = dense_covariance(variables.first, variables.width, marginals.covariance(*shared))
    return replace(solution, joint_covariance=joint, covariances=covariances)
