"""A network linearised at its solution, the rows of the priors there, and the names of what they are of."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.covariances import Linearised, orientation_covariance
from mgsgraph.adjustment.graph import BundleGraph, Layout, lay_out
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.rounds import exactly, unmarked
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation import COMPONENTS
from mgsgraph.geometry.records import Array, Index, finite_rows
from mgsgraph.kernel.rows import OUT
from mgsgraph.kernel.sweep import COSTS, reduce
from mgsgraph.network import Network, PolynomialPrior
from mgsgraph.network.parts import thinned


def require_covariance(solution: Solution) -> None:
    """Raise InputError unless a solution has a covariance of all that was adjusted, by the network's rows alone."""
    if solution.own_factors:
        what = f"factors of your own on points ({solution.own_factors}), which its measurements do not have"
        raise InputError(solution.name, what, "a solution of its network", "ask mgsgraph.Marginals of your graph")
    determined = solution.determined
    joint, points = solution.joint_covariance.sigmas, solution.covariances[determined]
    if not np.any(determined) or not (np.all(np.isfinite(joint)) and np.all(np.isfinite(points))):
        found, expected = "a solution without covariance", "one of every determined point and image"
        raise InputError(solution.name, found, expected, "adjust the case again")


def at_solution(solution: Solution) -> Linearised:
    """A network at its solution, with the rows that took part in it; InputError where it has no covariance."""
    require_covariance(solution)
    settings, network, out = solution.settings, solution.network, ~solution.determined
    layout = lay_out(network, settings, solution.places)
    orientation, points = _placed(layout, solution.values, np.where(out[:, None], 0.0, solution.places))
    points[layout.rows.kind == OUT] = 0.0
    layout, points = exactly(layout, orientation, points)
    rays = solution.rays_used | out[network.rays.point]
    rows = layout.active(rays, solution.ranges_used, out, solution.stereo_used)
    mixed = solution.minima is not None and solution.minima.several
    mixed = mixed or any(pass_.asks_for_strengths for pass_ in network.passes)
    return Linearised(layout, settings, rows, orientation, points, solution.joint_covariance, mixed)


def at_points(solution: Solution, chosen: Index) -> Linearised:
    """Some points (n,), ascending, where they were solved, with the covariance that all of them gave; InputError where
    the solution has none.
    """
    require_covariance(solution)
    part, joint = thinned(solution.network, chosen, solution.rays_used, solution.ranges_used), solution.joint_covariance
    return at_values(part, solution.settings, solution.values, solution.places[chosen], joint_of=lambda _: joint)


def at_values(
    network: Network, settings: SolverSettings, values: Sequence[Array], places: Array, near: bool = False,
    joint_of: Callable[[Layout], JointCovariance] | None = None,
) -> Linearised:  # fmt: skip
    """A network at given values of its variables (m and rad) and places (n, 3) of its points; NaN for points that
    nothing determines. Blunders, as the network marks them, stay out.

    Parameters
    ----------
    near : bool
        Whether the places are near by alone: the points then go to where the values put them.
    joint_of : function, optional
        Gives the joint covariance of a layout's unknowns, where the network is a part of one from which they follow;
        from the network's own rows when absent.
    """
    layout = lay_out(network, settings, places)
    out = ~finite_rows(places)
    orientation, points = _placed(layout, values, np.where(out[:, None], 0.0, places))
    layout, points = exactly(layout, orientation, points)
    present = unmarked(network)
    rows = layout.active(present.rays, present.ranges, out, present.stereo)
    if joint_of is not None:
        if near:
            points = reduce(rows, layout.groups, layout.blocks.target, layout.model, orientation, COSTS, points).points
        return Linearised(layout, settings, rows, orientation, points, joint_of(layout))
    graph = BundleGraph(layout, rows)
    reduction = graph.reduction(orientation, points=points)
    joint = orientation_covariance(graph, reduction)
    return Linearised(layout, settings, rows, orientation, reduction.points if near else points, joint)


def _placed(layout: Layout, values: Sequence[Array], places: Array) -> tuple[Array, Array]:
    """Shared unknowns (columns,) of the values of all variables, and places (n, 3) in the layout's order."""
    return layout.variables.joined(values), places[layout.point_order]


@dataclass(frozen=True, slots=True, eq=False)
class PriorRows:
    """What is known of the shared unknowns without any point, as m rows.

    Most rows are the a-priori value of one unknown. Those of a pass's orientation images join a node to the one
    before it and to the trend (`network.passes`); they count as measures of the node. Those of a `PolynomialPrior` are
    of coefficients: row about node k and component c of that of s^k. The last are crossovers of laser
    profiles, measured height differences.
    """

    about: Index
    """(m,) column of the shared unknowns that each is chiefly about."""
    sigma: Array
    """(m,) its a-priori sigma, all else held, m, rad or s."""
    misfit: Array
    """(m,) whitened residual, measured (zero but for crossovers) minus predicted."""
    share: Array
    """(m,) covariance of the adjusted row in its own units; 1 minus it is the redundancy number."""
    crossovers: int
    """Rows at the end that are crossovers."""


def prior_rows(at: Linearised) -> PriorRows:
    """Rows of the priors of a linearised network."""
    prior = at.layout.prior
    weighted = np.flatnonzero(prior.weights)
    sigma, share = [1.0 / prior.weights[weighted]], [(at.joint.sigmas[weighted] * prior.weights[weighted]) ** 2]
    flat, begin = at.joint.of_each([factor.variables for factor in prior.factors]), 0
    for variables, blocks, about, _ in prior.factors:
        rows = np.concatenate(blocks, axis=1)
        width = rows.shape[1]
        covariance = flat[begin : begin + width**2].reshape(width, width)
        begin += width**2
        share.append(np.einsum("ri,ij,rj->r", rows, covariance, rows))
        columns = at.layout.variables.columns_of_all(variables)
        chief = rows[np.arange(about.size), np.argmax(columns == about[:, None], axis=1)]
        with np.errstate(divide="ignore"):  # of a polynomial's rows, see below
            sigma.append(1.0 / np.abs(chief))
    misfit = -(prior.design @ at.orientation)
    misfit[misfit.size - prior.target.size :] += prior.target
    sigmas = np.concatenate(sigma)
    for pass_, first in at.network.numbered_passes:
        if isinstance(pass_.prior, PolynomialPrior):
            nodes = np.array([at.layout.variables.first[first + k] for k in range(len(pass_.nodes))])
            of_pass = np.flatnonzero((prior.about >= nodes[0]) & (prior.about < nodes[-1] + 6))
            term = np.searchsorted(nodes, prior.about[of_pass], side="right") - 1
            sigmas[of_pass] = pass_.prior.coefficient_sigmas[term, prior.about[of_pass] - nodes[term]]
    if at.network.crossovers is not None:
        sigmas[sigmas.size - prior.crossovers :] = at.network.crossovers.sigmas
    return PriorRows(prior.about, sigmas, misfit, np.concatenate(share), prior.crossovers)


_POWERS = ("constant", "linear", "quadratic", "cubic")


def unknown_name(network: Network, variable: int, inside: int) -> tuple[str, str]:
    """Name and unit of one column of a variable."""
    if variable < len(network.images):
        power, component = divmod(inside, len(COMPONENTS))
        term = _POWERS[power] if power < len(_POWERS) else f"u^{power}"
        return f"{term} {COMPONENTS[component]} of image {network.images[variable].name}", _unit(component)
    if variable >= network.first_of_passes[-1]:
        return "factor of correlated errors", ""
    if variable >= network.first_of_passes[0]:
        pass_, node = network.of_passes(variable)
        what, component = pass_.part(node, inside)
        if isinstance(pass_.prior, PolynomialPrior):
            what = f"the coefficient of s^{node}"  # what its rows are about; the unknowns are values at nodes
        elif node < len(pass_.nodes):
            what += f" ({pass_.nodes.times[node] - pass_.nodes.times[0]:.6g} s past the first)"
        return f"{COMPONENTS[component]} of {what} of pass {pass_.name}", _unit(component)
    if variable < network.first_shared:
        k = variable - len(network.images)
        return f"{network.shift_terms[k][inside].name} of {network.shift_names[k]}", network.shift_terms[k][inside].unit
    shared = network.shared[variable - network.first_shared]
    return f"{shared.name} {shared.kind.components[inside]}".strip(), shared.kind.unit


def _unit(component: int) -> str:
    """Unit of a component of the orientation: three of position, three of rotation."""
    return "rad" if component >= 3 else "m"
