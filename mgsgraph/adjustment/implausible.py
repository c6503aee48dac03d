"""Orientations that an adjustment has moved by far more than is said to be known of them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mgsgraph.geometry.records import Array
from mgsgraph.network import Network

STRAINED = 5.0
"""A-priori sigmas; of 10,000 coefficients none is off by so many by chance."""
IMPOSSIBLE = 100.0
"""A-priori sigmas from which on an input is wrong, whatever sigma0 says: sigmas that are stated ten times too small
are off by 50 at the most."""


class Strained(NamedTuple):
    """An image whose orientation was moved too far."""

    image: int
    """Which; for a pass stands its first image."""
    most: float
    """Largest of its corrections, in a-priori sigmas."""

    @property
    def impossible(self) -> bool:
        """Whether no stated sigma is to blame, but an input."""
        return self.most > IMPOSSIBLE


def strained_orientations(
    network: Network, coefficients: Sequence[Array], nodes: Sequence[Array]
) -> tuple[Strained, ...]:
    """Images whose own corrections exceed their sigmas by so much that no noise explains it, worst first: sigma0 hides
    it behind many rays.

    Parameters
    ----------
    network : Network
    coefficients : sequence of array
        Of each image, m and rad, as `Solution.coefficients`.
    nodes : sequence of array
        Of each pass, m and rad, as `Solution.nodes`: against their a-priori sigmas, trend and all.
    """
    found = list[Strained]()
    for one, moved in zip(network.passes, nodes, strict=True):
        found.append(Strained(int(one.images[0]), _most(moved, one.prior.own_sigmas(one.nodes))))
    for j in np.flatnonzero(network.with_polynomial).tolist():
        found.append(Strained(j, _most(coefficients[j], network.priors[j].sigmas)))
    return tuple(sorted((one for one in found if one.most > STRAINED), key=lambda one: -one.most))


def _most(corrections: Array, sigmas: Array) -> float:
    """Largest of corrections in sigmas."""
    return float(np.abs(corrections / sigmas).max())
