"""A model of jitter from data: vibrations of the residuals' spectrum as processes, their strengths by the evidence.

1. Images are adjusted with orientations that can't follow vibrations; the spectrum of residuals (`vibrations`) names
   frequencies. Orientation images stand `PER_WAVE` in a period of the highest.
2. Attitude departs from bias and drift by a sum of processes along each axis: a slow one (Matern 3/2), and of each
   frequency a damped oscillator. Each has a strength of its own in pitch and in roll, common to all passes.
3. Strengths are those of largest marginal likelihood (REML). With x the nodes' departures, K(theta) = sum_j
   theta_j K_j their prior covariance, and what measures say of them, L and b (information matrix and vector),

       2 log p = -log |I + L K| + b' (K^-1 + L)^-1 b,

   and theta_j <- theta_j q_j / s_j rests at it (Harville 1977), q_j = x' K^-1 K_j K^-1 x and
   s_j = tr(K_j (K + L^-1)^-1) at the posterior mean x.

What measures don't see has s_j = 0: its strength can't be found, and is taken over from the other axis: the spacecraft
that pitches may as well roll. `StrengthFound.seen` says how much of each was seen.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation_images import OrientationImages, evenly_spaced
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network, NodePrior
from mgsgraph.network.conditioning import dense_covariance
from mgsgraph.network.node_priors import ProcessPrior
from mgsgraph.network.processes import Process

PER_WAVE = 6.0
"""Nodes in a period of the highest frequency: Lagrange's polynomials then follow a sine to 3 % of its amplitude."""
_AXES = (0, 1)
"""Rotations whose strengths are found: about x (roll), about y (pitch); of yaw images hardly show anything."""
_OPEN = 10.0
"""Pixels: sigma of nodes that know nothing, for what measures say of them."""
_SLOW = 0.25
"""Correlation time of the slow process over the duration of a pass."""
_BANDWIDTH = 0.5
"""Of a vibration, in reciprocals of a pass's duration: what is narrower can't be told from a sine."""
_STEPS, _TOLERANCE = 40, 1e-2
"""Steps of strengths at most, and their change below which they rest."""
_UNSEEN = 0.5
"""Share of the a-priori variance of a process of one pixel that measures have to take away for its strength to be
found: a strength that is hardly seen runs away."""
_QUIET = 1e-3
"""Pixels: the least strength."""


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
    """Whether it is found; else taken over from the other axis, or left."""


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
        Of the adjustment that says what measures know.
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
    nodes = [evenly_spaced("lagrange", one.nodes.epoch, one.nodes.coverage, spacing) for one in network.passes]
    kinds = [("slow", Process("matern-3/2", np.full(3, pixel), correlation_time=_SLOW * min(durations)))]
    kinds += [
        (f"{one:.3f} Hz", Process("jitter", np.full(3, pixel), frequency=one, bandwidth=_BANDWIDTH / min(durations)))
        for one in frequencies
    ]
    data = _Data.of(network, settings, nodes, _OPEN * pixel)
    search = _Search(network, data, nodes, [one for _, one in kinds])
    search.run(pixel)
    sigmas = np.sqrt(search.theta)  # (processes, axes)
    attitude = tuple(
        replace(one, sigmas=np.append(sigmas[j], _QUIET * pixel), estimated=True) for j, (_, one) in enumerate(kinds)
    )
    passes = tuple(
        replace(one, nodes=other, prior=_prior(one.prior, attitude))
        for one, other in zip(network.passes, nodes, strict=True) if isinstance(one.prior, NodePrior)
    )  # fmt: skip
    strengths = tuple(
        StrengthFound(name, ("roll", "pitch")[a], float(sigmas[j, a]), float(search.seen[j, a]),
                      bool(search.found[j, a]))
        for j, (name, _) in enumerate(kinds) for a in _AXES
    )  # fmt: skip
    return JitterModel(replace(network, passes=passes), tuple(frequencies), strengths, search.evidence())


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


@dataclass(frozen=True, slots=True, eq=False)
class _Data:
    """What measures say of nodes' rolls and pitches: all passes, axis after axis, node after node; n of them."""

    information: Array
    """(n, n) per rad^2, L."""
    vector: Array
    """(n,) per rad, b."""

    @classmethod
    def of(
        cls, network: Network, settings: SolverSettings, nodes: Sequence[OrientationImages], open_sigma: float
    ) -> "_Data":
        """From an adjustment whose nodes know nothing of each other."""
        passes = tuple(
            replace(one, nodes=other, prior=_open(one.prior, open_sigma))
            for one, other in zip(network.passes, nodes, strict=True) if isinstance(one.prior, NodePrior)
        )  # fmt: skip
        solution = adjust_network(replace(network, passes=passes), settings)
        return cls(*_information(solution, open_sigma))


def _open(known: NodePrior, sigma: float) -> NodePrior:
    """Positions with their bias alone, and free rolls and pitches."""
    bias, drift = np.array(known.bias), np.array(known.drift)
    bias[3:5] = drift[3:5] = 0.0
    sigmas = np.concatenate([np.maximum(1e-3 * known.bias[:3], 1e-4), [sigma, sigma, 1e-3 * sigma]])
    return NodePrior(sigmas, bias, drift)


def _information(solution: Solution, open_sigma: float) -> tuple[Array, Array]:
    """L (n, n) and b (n,) of rolls and pitches."""
    network, columns, variables = solution.network, list[int](), list[int]()
    values, at = list[Array](), 0
    for p, one in enumerate(network.passes):
        first = int(network.first_of_passes[p])
        variables += range(first, first + len(one.nodes))
        columns += [at + 6 * k + 3 + a for a in _AXES for k in range(len(one.nodes))]
        values += [solution.nodes[p][:, 3 + a] for a in _AXES]
        at += 6 * len(one.nodes)
    joint = at_solution(solution).of_estimator().joint.of(variables)[np.ix_(columns, columns)]
    inverse = np.linalg.inv(0.5 * (joint + joint.T))
    information = inverse - np.eye(len(columns)) / open_sigma**2
    return 0.5 * (information + information.T), np.asarray(inverse @ np.concatenate(values))


class _Search:
    """Strengths of largest marginal likelihood."""

    def __init__(
        self, network: Network, data: _Data, nodes: Sequence[OrientationImages], processes: Sequence[Process]
    ) -> None:
        sizes = [len(one) for one in nodes]
        ends = np.concatenate([[0], np.cumsum(np.repeat(sizes, len(_AXES)))])
        self._slices = [
            [slice(int(ends[len(_AXES) * p + a]), int(ends[len(_AXES) * p + a + 1])) for p in range(len(sizes))]
            for a in _AXES
        ]
        unit = [replace(one, sigmas=np.ones(3)) for one in processes]
        self._kernels = [[dense_covariance((one,), 0, other) for other in nodes] for one in unit]
        self._trend = np.zeros((int(ends[-1]), int(ends[-1])))
        for a in _AXES:
            for p, (one, other) in enumerate(zip(network.passes, nodes, strict=True)):
                assert isinstance(one.prior, NodePrior)
                s = np.linspace(-1.0, 1.0, len(other))
                mine = self._slices[a][p]
                self._trend[mine, mine] = one.prior.bias[3 + a] ** 2 + one.prior.drift[3 + a] ** 2 * np.outer(s, s)
        # L = G G': what measures say nothing of falls out
        values, vectors = np.linalg.eigh(data.information)
        kept = values > 1e-9 * values[-1]
        self._root = vectors[:, kept] * np.sqrt(values[kept])
        self._pulled = (vectors[:, kept].T @ data.vector) / np.sqrt(values[kept])
        self.theta = np.zeros((len(processes), len(_AXES)))
        self.seen, self.found = np.zeros_like(self.theta), np.zeros(self.theta.shape, dtype=bool)

    def _covariance(self) -> Array:
        """K."""
        whole = self._trend.copy()
        for j, kernels in enumerate(self._kernels):
            for a in _AXES:
                for mine, kernel in zip(self._slices[a], kernels, strict=True):
                    whole[mine, mine] += self.theta[j, a] * kernel
        return whole

    def _projected(self) -> tuple[Array, Array]:
        """M = G (I + G' K G)^-1 G' = (K + L^-1)^-1, and M times the estimate that measures alone give."""
        middle = np.eye(self._root.shape[1]) + self._root.T @ self._covariance() @ self._root
        half = np.linalg.solve(np.linalg.cholesky(middle), self._root.T)
        solved = np.linalg.solve(middle, self._pulled)
        return half.T @ half, self._root @ solved

    def run(self, pixel: float) -> None:
        """Climb from a pixel for each."""
        self.theta[:] = pixel**2
        for step in range(_STEPS):
            before = self.theta.copy()
            projected, residual = self._projected()
            for j in range(len(self._kernels)):
                for a in _AXES:
                    self._step((j, a), projected, residual, pixel, begins=step == 0)
            for j, row in enumerate(self.found):
                if row.any() and not row.all():
                    self.theta[j, ~row] = self.theta[j, row].max()
            if np.abs(np.log(self.theta / before)).max() < _TOLERANCE:
                break

    def _step(
        self, which: tuple[int, int], projected: Array, residual: Array, pixel: float, begins: bool
    ) -> None:
        """A step of one strength; whether it can be found is judged where the search begins."""
        j, a = which
        kernels, q, s = self._kernels[j], 0.0, 0.0
        for mine, kernel in zip(self._slices[a], kernels, strict=True):
            q += float(residual[mine] @ kernel @ residual[mine])
            s += float(np.sum(kernel * projected[mine, mine]))
        self.seen[j, a] = min(self.theta[j, a] * s / _freedom(kernels), 1.0)
        if begins:
            self.found[j, a] = self.seen[j, a] > _UNSEEN
        if self.found[j, a]:
            self.theta[j, a] = max(self.theta[j, a] * q / s, (_QUIET * pixel) ** 2)

    def evidence(self) -> float:
        """Log marginal likelihood less that of trends alone."""
        found, theta = self._likelihood(), self.theta
        self.theta = np.full_like(theta, 0.0)
        nothing = self._likelihood()
        self.theta = theta
        return found - nothing

    def _likelihood(self) -> float:
        middle = np.eye(self._root.shape[1]) + self._root.T @ self._covariance() @ self._root
        lower = np.linalg.cholesky(middle)
        # b'(K^-1 + L)^-1 b = |y|^2 - y' (I + G'KG)^-1 y with b = G y
        left = np.linalg.solve(lower, self._pulled)
        return float(-np.sum(np.log(np.diagonal(lower))) - 0.5 * left @ left)


def _freedom(kernels: Sequence[Array]) -> float:
    """Directions that a process has, about: (tr K)^2 / tr K^2 of each pass."""
    return float(sum(np.trace(one) ** 2 / np.sum(one**2) for one in kernels))
