"""Correction series of strips over time in the axes of the flight (along, across, radial; roll, pitch, yaw), with the
parts of their errors.

Of the estimate x of the nodes the posterior covariance is C = (L + P)^-1, L being what the data say of them and P the
prior. Were there nothing to correct, x would still not be zero: the noise of the data puts C L C = C - C P C into it.
And of a true correction t it shows C L t = (1 - C P) t: what the prior pulls towards zero is missing. Both are needed
to tell jitter from noise; the posterior covariance alone also holds what the prior leaves open, and no noise.

C follows from the stated sigmas, by which the adjustment weighed, right or wrong. What noise does put into x follows
from how much rays do scatter (`scatter`): f times as much as stated puts f squared C L C into it.
"""

from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.frames import FLIGHT
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.flight import strip_turns
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.spacing.rays import ray_scatter
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.network import NodePrior, Pass

AXES = FLIGHT
"""The six components of a correction series; the first three in m, the others in rad."""
_MOST = 2000
"""Nodes of a strip whose joint covariance is taken as a whole: it takes 1.2 GB then."""


@dataclass(frozen=True, slots=True, eq=False)
class CorrectionSeries:
    """Corrections of a strip at its orientation images; k times, of each six axes (`AXES`), m and rad."""

    strip: str
    """Its name."""
    epoch: float
    """s TDB past J2000."""
    times: Array
    """(k,) s past the epoch; of a spline without the outer nodes, which lie beyond what it describes."""
    values: Array
    """(k, 6) corrections."""
    covariance: Array
    """(6 k, 6 k) of their errors, for sigma0 = 1: node after node."""
    noise: Array
    """(6 k, 6 k) of what the noise of the data, as it is, would put into them, were there nothing to correct."""
    response: Array
    """(6 k, 6 k) what is shown of true corrections there."""
    wander: Array | None
    """(6 k, 6 k) covariance of the departures from bias and drift that the prior expects, where it says how soon they
    forget themselves; else None."""
    known: Array
    """(6,) m and rad, the prior's sigma of departures from the trend, axis by axis; infinite where it knows nothing."""
    factor: float = 1.0
    """Times their stated sigmas that rays scatter: what `noise` holds."""

    def __post_init__(self) -> None:
        k = np.size(self.times)
        assign(self, times=frozen(self.times, "correction series, times", (None,)))
        assign(self, values=frozen(self.values, "correction series, values", (k, 6)))
        for name in ("covariance", "noise", "response"):
            assign(self, **{name: frozen(getattr(self, name), f"correction series, {name}", (6 * k, 6 * k))})

    @property
    def sigmas(self) -> Array:
        """(k, 6) m and rad, of the values, for sigma0 = 1."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0)).reshape(-1, 6)

    def axis(self, matrix: Array, axis: int) -> Array:
        """(k, k) part of one of the matrices that belongs to one axis."""
        return matrix[axis::6, axis::6]


def correction_series(solution: Solution, strip: str | int, factor: float | None = None) -> CorrectionSeries:
    """The corrections of a strip at its nodes.

    Parameters
    ----------
    factor : float, optional
        Times their stated sigmas that rays scatter; taken from the solution's residuals when absent.
    """
    from scipy.linalg import block_diag  # slow to import

    factor = ray_scatter(solution).factor if factor is None else factor
    strip = solution.network.pass_number(strip)
    one = solution.network.passes[strip]
    count = len(one.nodes)
    if count > _MOST:
        found = f"{count} nodes, whose joint covariance would be too large"
        raise InputError(f"strip {one.name!r}", found, f"{_MOST} at the most")
    first, end = solution.network.first_of_passes[strip : strip + 2].tolist()
    joint, prior = at_solution(solution).of_estimator().joint.of(range(first, end)), _prior_information(one)
    through = joint @ prior
    own = slice(0, 6 * count)
    noise = (joint - through @ joint)[own, own]
    response = np.eye(6 * count) - through[own, own]
    times = one.nodes.inner
    to_values, _ = one.nodes.dense(times, one.nodes.epoch)
    turns = strip_turns(solution.network, strip, times + one.nodes.epoch, solution.settings.angles)
    turn = block_diag(*turns) @ np.kron(to_values, np.eye(6))
    # of a spline the coefficients at the outer nodes have no values; the rest stands for the whole
    back = np.linalg.pinv(turn)
    wander = _wander(one)
    return CorrectionSeries(
        strip=one.name,
        epoch=one.nodes.epoch,
        times=times,
        values=(turn @ solution.nodes[strip].ravel()).reshape(-1, 6),
        covariance=_symmetric(turn @ joint[own, own] @ turn.T),
        noise=factor**2 * _symmetric(turn @ noise @ turn.T),
        response=turn @ response @ back,
        wander=None if wander is None else _symmetric(turn @ wander @ turn.T),
        known=_known(one, turns),
        factor=factor,
    )


def _known(strip: Pass, turns: Array) -> Array:
    """(6,) rms over the nodes of the prior's sigmas along each axis."""
    if isinstance(strip.prior, NodePrior):
        sigmas = np.broadcast_to(strip.prior.sigmas, turns.shape[:2])
    else:
        sigmas = strip.prior.own_sigmas(strip.nodes)[: turns.shape[0]]
    with np.errstate(invalid="ignore"):  # an axis that an unknown component has no share in
        squares = np.where(turns == 0.0, 0.0, turns**2 * sigmas[:, None, :] ** 2)
    return np.asarray(np.sqrt(squares.sum(axis=2).mean(axis=0)))


def _prior_information(strip: Pass) -> Array:
    """(c, c) P, of the nodes and the trend."""
    widths = strip.widths
    ends = np.concatenate([[0], np.cumsum(widths)])
    found = np.zeros((int(ends[-1]), int(ends[-1])))
    for factor in strip.prior.factors(strip.nodes):
        for v, left in zip(factor.unknowns, factor.blocks, strict=True):
            for w, right in zip(factor.unknowns, factor.blocks, strict=True):
                found[ends[v] : ends[v + 1], ends[w] : ends[w + 1]] += left.T @ right
    return found


def _wander(strip: Pass) -> Array | None:
    """(6 k, 6 k) of the departures from the trend; None where each node has its own, or nothing is known."""
    prior = strip.prior
    if not isinstance(prior, NodePrior) or prior.correlation_time == 0.0 or not np.all(np.isfinite(prior.sigmas)):
        return None
    apart = np.abs(strip.nodes.times[:, None] - strip.nodes.times)
    return np.asarray(np.kron(np.exp(-apart / prior.correlation_time), np.diag(prior.sigmas**2)), dtype=np.float64)


def _symmetric(matrix: Array) -> Array:
    return np.asarray(0.5 * (matrix + matrix.T))
