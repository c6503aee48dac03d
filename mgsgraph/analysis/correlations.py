"""Points whose places are wrong together: covariances of one point with all others of a network, in one pass."""

import numpy as np

from mgsgraph.adjustment.linearised import Linearised
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.rows import FIXED, OUT


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
