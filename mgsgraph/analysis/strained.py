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
    behind many rays.
    """
    net, found = solution.network, list[Strained]()
    for j in np.flatnonzero(~net.held).tolist():
        moved, sigmas = solution.correction(j).coefficients, net.priors[j].sigmas
        if moved.shape == sigmas.shape and (most := float(np.abs(moved / sigmas).max())) > _STRAINED:
            found.append(Strained(j, most))
    return tuple(sorted(found, key=lambda one: -one.most))
