"""sigma0: the weighted sum of squared residuals, observations, unknowns and redundancy of an adjustment.

Orientations that an adjustment has moved by far more than is said to be known of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.graph import Layout
from mgsgraph.adjustment.residuals import Residuals, squares_of
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.rows import CAUCHY, FIXED, HUBER, NO_LOSS, OUT, Model, Rows
from mgsgraph.network import Network
from mgsgraph.record import Record

ABSURD = 10.0
"""sigma0 from which on it is no matter of sigmas: squares are a hundred times what was stated."""


@dataclass(frozen=True, slots=True)
class Fit(Record):
    """Global figures of merit.

    Examples
    --------
    >>> fit = solution.fit
    >>> fit.observations, fit.unknowns, fit.degrees_of_freedom
    (180, 120, 60)
    >>> round(fit.sigma0, 2), fit.absurd
    (1.22, False)
    """

    squares: float
    """Weighted sum of squares of all rows."""
    observations: int
    """Number of rows, priors among them."""
    unknowns: int
    """Number of unknowns, points among them."""

    @property
    def degrees_of_freedom(self) -> int:
        """Redundancy of the adjustment."""
        return self.observations - self.unknowns

    @property
    def sigma0(self) -> float:
        """A-posteriori standard deviation of unit weight; NaN without redundancy."""
        return float(np.sqrt(self.squares / self.degrees_of_freedom)) if self.degrees_of_freedom > 0 else float("nan")

    @property
    def absurd(self) -> bool:
        """Whether sigma0 can't come from sigmas that are merely too small."""
        return self.sigma0 > ABSURD


def fit(layout: Layout, rows: Rows, orientation: Array, points: Array, found: Residuals) -> Fit:
    """Weighted squares (robust weights included), observations and unknowns of the rows that take part."""
    kind = layout.network_order(rows.kind)
    every = squares_of(layout, rows, orientation, points, found).values()
    corrections = layout.prior.residuals(orientation)
    parts = [_weighted(one.values, layout.model) if one.robust else float(one.values.sum()) for one in every]
    free = int(np.count_nonzero((kind != OUT) & (kind != FIXED)))
    return Fit(
        squares=float(sum(parts) + corrections @ corrections),
        observations=sum(one.rows * one.values.size for one in every) + layout.prior.rows,
        unknowns=layout.columns + 3 * free,
    )


def _weighted(squares: Array, model: Model) -> float:
    """Sum of squares with the loss's weights (see `tile.robust` of the factors)."""
    if model.loss == NO_LOSS:
        return float(squares.sum())
    if model.loss == HUBER:
        return float((squares * np.minimum(1.0, model.width / np.sqrt(np.maximum(squares, 1e-300)))).sum())
    ratio = squares / model.width**2
    if model.loss == CAUCHY:
        return float((squares / (1.0 + ratio)).sum())
    return float((squares * np.maximum(1.0 - ratio, 0.0) ** 2).sum())


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
