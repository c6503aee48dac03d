"""Quantities of the adjustment as linear functions of its unknowns, and the law of error propagation for them.

Every question to the posterior is put in one form: dq = sum_v J_v dx_v + sum_i N_i e_i, x_v the shared unknowns
(covariance S), e_i noise of unit covariance that point i keeps for itself when x is known (S_p = V^-1 + V^-1 W' S W
V^-1, design.md section 3). Two quantities covary by J1 S J2' + sum_i N1_i N2_i'.
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.geometry.records import Array


@dataclass(frozen=True, slots=True, eq=False)
class Quantity:
    """m numbers that follow from the unknowns."""

    names: tuple[str, ...]
    """(m,) what they are."""
    units: tuple[str, ...]
    """(m,) in which unit."""
    values: Array
    """(m,) at the solution."""
    by_shared: Mapping[int, Array]
    """(m, width) derivatives by each shared unknown they depend on, per m and rad."""
    own: Mapping[Hashable, Array]
    """(m, 3) derivatives by the noise of each point they depend on, by a key of its own: quantities that have one in
    common share that noise."""

    def through(self, names: tuple[str, ...], units: tuple[str, ...], values: Array, jacobian: Array) -> "Quantity":
        """Further numbers (k) that follow from these; `jacobian` (k, m) are their derivatives."""
        by_shared = {variable: jacobian @ part for variable, part in self.by_shared.items()}
        return Quantity(names, units, values, by_shared, {point: jacobian @ part for point, part in self.own.items()})


def together(quantities: Sequence[Quantity]) -> Quantity:
    """Several quantities as one, one after another."""
    ends = np.cumsum([0, *(len(one.names) for one in quantities)]).tolist()
    by_shared: dict[int, Array] = {}
    own: dict[Hashable, Array] = {}
    for first, last, one in zip(ends, ends[1:], quantities, strict=False):
        for variable, part in one.by_shared.items():
            by_shared.setdefault(variable, np.zeros((ends[-1], part.shape[1])))[first:last] = part
        for point, part in one.own.items():
            own.setdefault(point, np.zeros((ends[-1], 3)))[first:last] = part
    return Quantity(
        tuple(name for one in quantities for name in one.names),
        tuple(unit for one in quantities for unit in one.units),
        np.concatenate([one.values for one in quantities]),
        by_shared,
        own,
    )


def covariance(quantity: Quantity, joint: JointCovariance) -> Array:
    """(m, m) covariance of a quantity's numbers, in the product of their units, for sigma0 = 1."""
    m = len(quantity.names)
    found = np.zeros((m, m))
    if quantity.by_shared:
        jacobian = np.hstack(list(quantity.by_shared.values()))
        found += jacobian @ joint.of(quantity.by_shared) @ jacobian.T
    for part in quantity.own.values():
        found += part @ part.T
    return np.asarray(0.5 * (found + found.T))


def correlation(covariance: Array) -> Array:
    """(m, m) correlation matrix of a covariance; NaN where there is no variance."""
    sigmas = np.sqrt(np.diagonal(covariance))
    scale = np.where(sigmas > 0.0, sigmas, np.nan)
    return np.asarray(covariance / scale[:, None] / scale)
