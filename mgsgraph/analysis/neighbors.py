"""The posterior of some points alone: their rows, and the covariance, known already, of the unknowns they share."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from mgsgraph.adjustment.graph import Layout
from mgsgraph.adjustment.marginals import JointCovariance, dense_covariance
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_values
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Network
from mgsgraph.network.parts import Unknown, part, unknowns


def stands_alone(network: Network) -> bool:
    """Whether some of its points, with the covariance of their unknowns, say of themselves what the whole says: not
    where rows of other points reach them (passes, stereo surfaces, crossovers, a raised terrain model) or tests need
    the estimator's own covariance (considered unknowns).
    """
    raised = network.surface is not None and network.surface.raised
    profiles = any(one.kind.of_profile for one in network.shared)
    return not (network.passes or network.stereo is not None or network.crossovers is not None or network.considered
                or raised or profiles)  # fmt: skip


def posterior_of(
    network: Network, settings: SolverSettings, values: Mapping[Unknown, Array], places: Array,
    joint: Callable[[Sequence[Unknown]], Array],
) -> Posterior:  # fmt: skip
    """The posterior of a part of what was adjusted.

    Parameters
    ----------
    network : Network
        That part; `stands_alone`.
    values : mapping
        (d,) m and rad, of its adjusted unknowns, and of any others.
    places : (n, 3)
        m, where its points are, all but; NaN for those that nothing determines.
    joint : function
        Gives the joint covariance (d, d) of some adjusted unknowns, m and rad, for sigma0 = 1.
    """
    names = unknowns(network)

    def joint_of(layout: Layout) -> JointCovariance:
        wanted = [names[v] for v in layout.variables.adjusted()]
        found = joint(wanted) if wanted else np.zeros((0, 0))
        return dense_covariance(layout.variables.first, layout.variables.width, found)

    each = [values.get(unknown, np.zeros(0)) for unknown in names]
    return Posterior(at_values(network, settings, each, places, near=True, joint_of=joint_of))


def posterior_of_points(solution: Solution, points: Index) -> Posterior | None:
    """The posterior of some points (m,) of a solution; None where these do not stand alone, or it is a mean over
    several minima.
    """
    whole = solution.network.with_rejected(solution.rays_rejected, solution.ranges_rejected, solution.stereo_rejected)
    if not stands_alone(whole) or (solution.minima is not None and solution.minima.several):
        return None
    number = {unknown: v for v, unknown in enumerate(unknowns(whole))}
    values = dict(zip(number, solution.values, strict=True))
    found = solution.joint_covariance
    return posterior_of(
        part(whole, points), solution.settings, values, solution.places[points],
        lambda wanted: found.of([number[unknown] for unknown in wanted]),
    )  # fmt: skip
