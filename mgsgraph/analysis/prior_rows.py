"""What is known of the shared unknowns beforehand, as measures: each row with its residual and its share in the result.

Most rows are the a-priori value of one unknown. Those of a strip's orientation images join a node to the one before it
and to the trend (`network.strips`); they count as measures of the node.
"""

from dataclasses import dataclass

import numpy as np

from mgsgraph.analysis.linearised import Linearised
from mgsgraph.geometry.records import Array, Index


@dataclass(frozen=True, slots=True, eq=False)
class PriorRows:
    """m rows."""

    about: Index
    """(m,) column of the shared unknowns that each is chiefly about."""
    sigma: Array
    """(m,) its a-priori sigma, all else held, m, rad or s."""
    misfit: Array
    """(m,) whitened residual, measured (zero) minus predicted."""
    share: Array
    """(m,) covariance of the adjusted row in its own units; 1 minus it is the redundancy number."""


def prior_rows(at: Linearised) -> PriorRows:
    """Of a linearised network."""
    prior = at.layout.prior
    own = np.flatnonzero(prior.weights)
    sigma, share = [1.0 / prior.weights[own]], [(at.joint.sigmas[own] * prior.weights[own]) ** 2]
    flat, begin = at.joint.of_each([factor.variables for factor in prior.factors]), 0
    for variables, blocks, about in prior.factors:
        rows = np.concatenate(blocks, axis=1)
        width = rows.shape[1]
        covariance = flat[begin : begin + width**2].reshape(width, width)
        begin += width**2
        share.append(np.einsum("ri,ij,rj->r", rows, covariance, rows))
        columns = np.concatenate([np.arange(*at.layout.columns_of(v).indices(prior.columns)) for v in variables])
        chief = rows[np.arange(about.size), np.argmax(columns == about[:, None], axis=1)]
        sigma.append(1.0 / np.abs(chief))
    misfit = -(prior.every @ at.orientation)
    return PriorRows(prior.about, np.concatenate(sigma), misfit, np.concatenate(share))
