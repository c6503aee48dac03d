"""Orientations that an adjustment has moved by far more than is said to be known of them."""

from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution

_STRAINED = 5.0
"""A-priori sigmas; of 10,000 coefficients none is off by so many by chance."""


class Strained(NamedTuple):
    """An image whose orientation was moved too far."""

    image: int
    """Which."""
    most: float
    """Largest of its corrections, in a-priori sigmas."""


def strained_orientations(solution: Solution) -> tuple[Strained, ...]:
    """Images whose corrections exceed their sigmas by so much that no noise explains it, worst first: sigma0 hides it
    behind many rays. For a pass stands its first image: nodes against their a-priori sigmas, trend and all.
    """
    net, found = solution.network, list[Strained]()
    for one, nodes in zip(net.passes, solution.nodes, strict=True):
        if (most := float(np.abs(nodes / one.prior.own_sigmas(one.nodes)).max())) > _STRAINED:
            found.append(Strained(int(one.images[0]), most))
    for j in np.flatnonzero(net.with_polynomial).tolist():
        moved, sigmas = solution.correction(j).coefficients, net.priors[j].sigmas
        if moved.shape == sigmas.shape and (most := float(np.abs(moved / sigmas).max())) > _STRAINED:
            found.append(Strained(j, most))
    return tuple(sorted(found, key=lambda one: -one.most))
