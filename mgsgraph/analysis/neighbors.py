"""The posterior of some points alone: their rows, and the covariance, known already, of the unknowns they share;
and the covariances of one point with all others of a network.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from mgsgraph.adjustment.graph import Layout
from mgsgraph.adjustment.linearised import Linearised
from mgsgraph.adjustment.marginals import JointCovariance, dense_covariance
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_values
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.rows import FIXED, OUT
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


def cross_covariances(at: Linearised, point: int) -> Array:
    """Covariances of a point with every point of a network through the unknowns that they share, for sigma0 = 1.

    With x the shared unknowns and S their covariance, point i is p_i = K_i x + N_i e_i, its noise e_i its own
    (`PointRows.eliminated`): cov(p_0, p_i) = K_0 S K_i', and K_0 S K_0' + N_0 N_0' of the point itself.

    Parameters
    ----------
    at : Linearised
    point : int
        Number of the point in the network.

    Returns
    -------
    (n, 3, 3) array
        m^2, network order; zero for fixed points, NaN for those that nothing determines.

    Raises
    ------
    InputError
        Where nothing determines the point.
    """
    place = at.layout_index(point)
    found = np.full((at.points.shape[0], 3, 3), np.nan)
    own = at.rows_of(point)
    if own.known:
        found[at.rows.kind != OUT] = 0.0
        return at.layout.network_order(found)
    carried, noise = own.eliminated()
    joint = dict[tuple[int, ...], Array]()
    for piece, (_, first, count, *_) in enumerate(at.rows.piece.tolist()):
        there = np.flatnonzero(at.rows.kind[first : first + count] != OUT)
        if not there.size:
            continue
        rows = at.rows_inside(piece, there)
        mine = first + there
        if rows.known:
            found[mine] = 0.0
            continue
        if rows.variables not in joint:
            both = list(dict.fromkeys([*own.variables, *rows.variables]))
            columns = at.layout.variables.width[both]
            begin = dict(zip(both, np.cumsum(columns) - columns, strict=True))
            parts = [
                np.concatenate([np.zeros(0, dtype=np.int64),
                                *(begin[v] + np.arange(at.layout.variables.width[v]) for v in variables)])
                for variables in (own.variables, rows.variables)
            ]  # fmt: skip
            joint[rows.variables] = carried[0] @ at.joint.of(both)[np.ix_(*parts)]
        others, _ = rows.eliminated()
        found[mine] = np.einsum("ac,nbc->nab", joint[rows.variables], others)
    found[place] += noise[0] @ noise[0].T
    found[at.rows.kind == FIXED] = 0.0
    return at.layout.network_order(found)
