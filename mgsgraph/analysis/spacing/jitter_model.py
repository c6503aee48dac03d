"""A model of jitter from data: vibrations of the residuals' spectrum as processes, their strengths by the evidence.

1. Images are adjusted with orientations that can't follow vibrations; the spectrum of residuals (`vibrations`) names
   frequencies. Orientation images stand `PER_WAVE` in a period of the highest.
2. Attitude departs from bias and drift by a sum of processes along each axis: a slow one (Matern 3/2), and of each
   frequency a damped oscillator.
3. Strengths, about each axis by itself and common to all passes, are those of largest restricted likelihood
   (`analysis.process_strengths`). Those that measures don't see are taken over from the other axes: the spacecraft that
   pitches may as well roll. `StrengthFound.seen` says how much of each was seen.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.process_strengths import Strength, estimated_strengths
from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation_images import evenly_spaced
from mgsgraph.network import Network, NodePrior
from mgsgraph.network.conditioning import Process
from mgsgraph.network.node_priors import ProcessPrior

PER_WAVE = 8.0
"""Nodes in a period of the highest frequency: Lagrange's polynomials then follow a sine to 1 % of its amplitude."""
_TURNS = {3: "roll", 4: "pitch"}
"""Rotations about x and y; of yaw images hardly show anything."""
_SLOW = 0.25
"""Correlation time of the slow process over the duration of a pass."""
_REST = 0.03
"""Of the estimate's tolerance: strengths rest that change by less than a third of their standard deviations."""
_BANDWIDTH = 0.5
"""Of a vibration, in reciprocals of a pass's duration: what is narrower can't be told from a sine."""


@dataclass(frozen=True, slots=True)
class StrengthFound:
    """Strength of one process along one axis."""

    process: str
    """slow, or the vibration's frequency."""
    axis: str
    """roll or pitch."""
    sigma: float
    """rad."""
    seen: float
    """Share of the departures' a-priori variance that measures take away; 0: not observable."""
    found: bool
    """Whether it is found; else taken over from another axis, or held at nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class JitterModel:
    """What the data say of the attitude's departures, and the network with it."""

    network: Network
    """With nodes and priors of the model."""
    frequencies: tuple[float, ...]
    """Hz."""
    strengths: tuple[StrengthFound, ...]
    """Of each process along roll and pitch."""
    evidence: float
    """Log marginal likelihood less that of no departures at all, nats."""


def jitter_model(
    network: Network, settings: SolverSettings, frequencies: Sequence[float], pixel: float
) -> JitterModel:
    """A network whose passes follow vibrations of some frequencies, strengths found from its measures.

    Parameters
    ----------
    network : Network
        With passes, whose priors know biases and drifts (`NodePrior`).
    settings : SolverSettings
        Of the adjustments.
    frequencies : sequence of float
        Hz; none for the slow process alone.
    pixel : float
        rad, of a pixel: where the search for strengths begins.

    Raises
    ------
    InputError
        Without passes, or with other priors.
    """
    _require_able(network)
    durations = [float(np.diff(one.nodes.coverage)[0]) for one in network.passes]
    spacing = 1.0 / (PER_WAVE * max([*frequencies, 2.0 / min(durations)]))
    begin = np.full(3, pixel)
    slow = Process("matern-3/2", begin, correlation_time=_SLOW * min(durations), estimated=True)
    width = _BANDWIDTH / min(durations)
    vibrations = [Process("jitter", begin, frequency=f, bandwidth=width, estimated=True) for f in frequencies]
    passes = tuple(
        replace(
            one,
            nodes=evenly_spaced("lagrange", one.nodes.epoch, one.nodes.coverage, spacing),
            prior=_prior(one.prior, (slow, *vibrations)),
        )
        for one in network.passes if isinstance(one.prior, NodePrior)
    )  # fmt: skip
    found = estimated_strengths(replace(network, passes=passes), settings, by_axis=True, rays=False, tolerance=_REST)
    strengths = tuple(_found(one) for one in found.strengths if one.axes[0] in _TURNS)
    return JitterModel(found.network, tuple(frequencies), strengths, found.evidence)


def _found(one: Strength) -> StrengthFound:
    process = f"{one.frequency:.3f} Hz" if one.frequency else "slow"
    return StrengthFound(process, _TURNS[one.axes[0]], one.sigma, one.seen, one.searched)


def _require_able(network: Network) -> None:
    if not network.passes:
        raise InputError("network", "no passes", "images whose orientation follows from orientation images")
    for one in network.passes:
        if not isinstance(one.prior, NodePrior):
            raise InputError(f"pass {one.name!r}", f"a {type(one.prior).__name__}", "bias and drift, and nodes")


def _prior(known: NodePrior, attitude: tuple[Process, ...]) -> ProcessPrior:
    """Bias and drift as they are known, departures of the attitude by processes; none of the position."""
    still = Process("white", np.maximum(1e-3 * known.bias[:3], 1e-4))
    return ProcessPrior((still,), attitude, known.bias, known.drift)
