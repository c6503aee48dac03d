"""What another optimizer found of a factor graph, as a solution."""

from dataclasses import replace

import gtsam
import numpy as np

from mgsgraph.adjustment.adjust import Clock, nominal_reduction, nominal_state, read_off
from mgsgraph.adjustment.batch import Outcome
from mgsgraph.adjustment.factor_graph import factor_graph
from mgsgraph.adjustment.graph import BundleGraph, Layout, lay_out
from mgsgraph.adjustment.graph.forms import IN_PROCESS
from mgsgraph.adjustment.keys import Keys, Source, network_and_settings
from mgsgraph.adjustment.marginals import dense_covariance
from mgsgraph.adjustment.optimize import Marginals
from mgsgraph.adjustment.rounds import Solved, all_rows, relinearized
from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import PointKind

_CONVERGED = 0.01
"""Posterior sigmas from the minimum within which what was optimized elsewhere counts as converged."""
_FOREIGN = 1e-6
"""Share by which a graph may cost less than the measurements of its network."""


def solution_of(
    source: Source, values: gtsam.Values, graph: gtsam.NonlinearFactorGraph | None = None, name: str | None = None
) -> Solution:
    """The result of another optimizer for `factor_graph`, as a solution to be reported, analyzed and exported.

    Parameters
    ----------
    source : Case, Network or Solution
        What the graph was made of, by `factor_graph` or by hand with its keys.
    values : gtsam.Values
        Of its keys; further ones are of no account.
    graph : gtsam.NonlinearFactorGraph, optional
        What was optimized, where factors of one's own were added: costs and covariances are then its own, residuals
        those of the network's measurements. A solution does not keep such factors: `factor_graph(solution)` is the
        network's graph. With factors of one's own on points it has no tests, and `Marginals` answers in place of
        `Posterior`.
    name : str, optional
        What to call it in reports; the source's own when absent.

    Returns
    -------
    Solution
        Not converged where the minimum is farther than 0.01 posterior sigmas; its message says how far.

    Raises
    ------
    InputError
        Where values or graph lack an unknown of the source, or a value has another length; for a graph of a network
        with considered unknowns.
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
    of_network = factor_graph(source).graph
    optimized = of_network if graph is None else graph
    _require_all(of_network, optimized, values, keys)
    if graph is not None and network.considered:
        raise InputError("graph", "considered unknowns, which it holds", "a network without them", "leave `graph` out")
    if isinstance(source, Solution):
        marks = {"rays": source.rays_rejected, "ranges": source.ranges_rejected, "stereo": source.stereo_rejected}
        left_in = replace(all_rows(network), **{rows: ~mark for rows, mark in marks.items() if mark is not None})
    layout, selection, before = nominal_reduction(lay_out(network, settings), left_in=left_in)
    nominal, first = nominal_state(layout, before), layout.variables.first.tolist()
    unknowns = [values.atVector(keys.variable(v)) if at >= 0 else np.zeros(0) for v, at in enumerate(first)]
    orientation = layout.variables.joined(unknowns)
    reduction = BundleGraph(layout, selection.rows(layout)).reduction(orientation)
    layout, reduction = relinearized(layout, selection, reduction, in_place=True)
    points, begin = reduction.points.copy(), gtsam.Values(values)
    for k, i in enumerate(layout.point_order.tolist()):
        if values.exists(keys.point(i)):
            points[k] = values.atPoint3(keys.point(i))
            begin.update(keys.point(i), nominal.places[i])
    for v in layout.variables.adjusted():
        begin.update(keys.variable(int(v)), np.zeros(int(layout.variables.width[v])))
    marginals = Marginals(optimized, values)
    initial, cost, far = optimized.error(begin), optimized.error(values), marginals.steps_left()
    foreign = cost < (1.0 - _FOREIGN) * of_network.error(values)
    message = _message(far, None if graph is None else graph.size(), of_network.size(), foreign)
    outcome = Outcome(orientation, initial, cost, far < _CONVERGED and not foreign, message, ())
    rows = selection.rows(layout)
    solved = Solved(layout, outcome, (), initial, orientation, points, rows, selection, reduction, 1)
    clock.stop("solve")
    title = getattr(source, "name", "adjustment") if name is None else name
    solution = read_off(settings, str(title), solved, nominal, clock, IN_PROCESS, None)
    if graph is None:
        return solution
    count = max(_on_points(graph) - _on_points(of_network), 0)
    return replace(_with_marginals(solution, layout, marginals, keys), own_factors=count)


def _on_points(graph: gtsam.NonlinearFactorGraph) -> int:
    """Number of factors on ground points."""
    keys = (graph.at(k).keys() for k in range(graph.size()) if graph.exists(k))
    return sum(any(gtsam.Symbol(key).chr() == ord("p") for key in each) for each in keys)


def _require_all(
    of_network: gtsam.NonlinearFactorGraph, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: Keys
) -> None:
    """Raise InputError where values or graph lack an unknown of the network, or one has another length."""
    keys_of_graph, widths = set(graph.keyVector()), _of_lengths(values)
    for key in of_network.keyVector():
        if key not in widths:
            raise InputError("values", f"none of {keys.name(key)}", "one of each unknown of the network")
        if key not in keys_of_graph:
            raise InputError("graph", f"no factor on {keys.name(key)}", "the network's graph, with factors added")
        if widths[key] != (wanted := keys.width(key)):
            raise InputError("values", f"{widths[key]} numbers of {keys.name(key)}", str(wanted))


def _of_lengths(values: gtsam.Values) -> dict[int, int]:
    zeros, keys = values.zeroVectors(), list(values.keys())
    return {key: int(zeros.at(key).size) for key in keys}


def _message(far: float, given: int | None, size: int, foreign: bool) -> str:
    """Distance from the minimum, and the meaning of the costs where another graph than the network's was given."""
    sentences = [f"Optimized elsewhere, {far:.2g} posterior sigmas from the minimum."]
    if foreign:
        sentences.append("The graph is of another network: its cost is below that of this network's measurements.")
    elif given is not None:
        sentences.append(f"The costs are those of the given graph of {given} factors, sigma0 of the network's {size}.")
    if given is None and far >= _CONVERGED:
        sentences.append("Are the values of this network? With factors of your own pass their graph, too.")
    return " ".join(sentences)


def _with_marginals(solution: Solution, layout: Layout, marginals: Marginals, keys: Keys) -> Solution:
    """The same with covariances of another graph."""
    variables, covariances = layout.variables, solution.covariances.copy()
    for i in np.flatnonzero(solution.determined & (solution.network.points.kinds != PointKind.FIXED)).tolist():
        covariances[i] = marginals.covariance(keys.point(i))
    shared = [keys.variable(int(v)) for v in variables.adjusted()]
    joint = dense_covariance(variables.first, variables.width, marginals.covariance(*shared))
    return replace(solution, joint_covariance=joint, covariances=covariances)
