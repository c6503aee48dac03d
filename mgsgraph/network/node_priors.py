"""What is known of a pass's orientation images beforehand, as whitened rows on its nodes and its trend.

The trajectory is observed at every node, with a bias and a linear drift that the whole pass shares (Spiegel 2007, as
corrections to the observed exterior orientation): of a node at time t, s = -1 .. 1 over the pass,

    c(t) = bias + drift s + e(t),

where e has the node's own sigma and, between nodes, the correlation exp(-|dt| / correlation time) of a Gauss-Markov
process. So a node hangs on the one before it by a smoothness factor, e_k - a e_{k-1} with a = exp(-dt / time) and sigma
root(1 - a^2) times the node's; without correlation time nodes are observed independently, as Spiegel has it. Closer
nodes then don't say more than the trajectory knows.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation_images import OrientationImages
from mgsgraph.geometry.records import Array, Index, assign, frozen

_LONGEST = 1e9
"""s: departures that take longer to forget themselves can't be told from a bias."""
_UNKNOWN = 1e5
"""m of a position for a rad of a rotation, where nothing else says what counts for more."""


class LinearFactor(NamedTuple):
    """Whitened rows sum_v blocks[v] x_v on some unknowns of a pass: its nodes 0 .. k - 1, and its trend, number k."""

    unknowns: tuple[int, ...]
    """Which, each once."""
    blocks: tuple[Array, ...]
    """Of each a matrix (rows, width)."""
    about: Index
    """(rows, 2) what each row is chiefly about: one of the unknowns, and which of its columns."""


@dataclass(frozen=True, slots=True, eq=False)
class NodePrior:
    """What is known of a pass's nodes beforehand; every entry (6,), m along X, Y, Z and rad."""

    sigmas: Array
    """Of a node's coefficient about the trend; infinite where nothing is known. A spline's orientation at a node is the
    mean of three coefficients, 1:4:1, and so known better: to 0.71 of this where they know nothing of each other."""
    bias: Array
    """Sigma of the trend's constant part; 0 where there is none."""
    drift: Array
    """Sigma of the trend's linear part, at the ends of the pass; 0 where there is none."""
    correlation_time: float = 0.0
    """s in which the departures from the trend forget themselves to 1/e; 0 for nodes that know nothing of each other"""

    def __post_init__(self) -> None:
        sigmas = np.array(self.sigmas, dtype=np.float64)
        if sigmas.shape != (6,) or np.any(np.isnan(sigmas)) or np.any(sigmas <= 0.0):
            raise InputError("node prior, sigmas", f"{sigmas.tolist()}", "six positive sigmas")
        sigmas.flags.writeable = False
        bias, drift = frozen(self.bias, "node prior, bias", (6,)), frozen(self.drift, "node prior, drift", (6,))
        for name, trend in (("bias", bias), ("drift", drift)):
            if trend.min() < 0.0:
                raise InputError(f"node prior, {name}", f"{trend.min()}", "sigmas, or 0 for none")
            for c in np.flatnonzero((trend > 0.0) & np.isinf(sigmas))[:1]:
                found = f"sigma {trend[c]} of component {c} whose nodes have none"
                raise InputError(f"node prior, {name}", found, "a sigma of the nodes, too", "leave it out")
        if not 0.0 <= self.correlation_time <= _LONGEST:
            expected = f"0 (none) to {_LONGEST:g} s"
            raise InputError("node prior, correlation time", f"{self.correlation_time} s", expected)
        assign(self, sigmas=sigmas, bias=bias, drift=drift)

    @property
    def trend_sigmas(self) -> Array:
        """(w,) of the trend's unknowns: the components with a bias, then those with a drift."""
        return np.concatenate([self.bias[self.bias > 0.0], self.drift[self.drift > 0.0]])

    @property
    def trend_components(self) -> Index:
        """(w,) component of each of them."""
        return np.concatenate([np.flatnonzero(self.bias > 0.0), np.flatnonzero(self.drift > 0.0)])

    @property
    def trend_names(self) -> tuple[str, ...]:
        """What each of them is: a bias or a drift."""
        return ("bias",) * int(np.count_nonzero(self.bias)) + ("drift",) * int(np.count_nonzero(self.drift))

    def trend(self, s: Array) -> Array:
        """(n, 6, w) what the trend's unknowns do to nodes at s (n,) in [-1, 1]."""
        result = np.zeros((s.size, 6, self.trend_sigmas.size))
        column = np.arange(self.trend_sigmas.size)
        biases = int(np.count_nonzero(self.bias))
        result[:, self.trend_components, column] = np.where(column < biases, 1.0, s[:, None])
        return result

    def node_sigmas(self, s: Array) -> Array:
        """(n, 6) a-priori sigma of nodes at s (n,), with the trend's."""
        return np.sqrt(self.sigmas**2 + self.bias**2 + (s[:, None] * self.drift) ** 2)

    def scaled(self, nodes: Array, trend: Array) -> "NodePrior":
        """With the sigmas of nodes times factors (6,), those of the trend's unknowns times factors (w,)."""
        of_bias, of_drift = np.ones(6), np.ones(6)
        biases = int(np.count_nonzero(self.bias))
        of_bias[self.bias > 0.0], of_drift[self.drift > 0.0] = trend[:biases], trend[biases:]
        return NodePrior(self.sigmas * nodes, self.bias * of_bias, self.drift * of_drift, self.correlation_time)

    def factors(self, nodes: OrientationImages) -> Iterator[LinearFactor]:
        """Whitened rows on the nodes and the trend."""
        known = np.flatnonzero(np.isfinite(self.sigmas))
        s, count = normalised(nodes), len(nodes)
        trend, weight = self.trend(s)[:, known], np.diag(1.0 / self.sigmas)[known]
        with np.errstate(divide="ignore"):
            apart = np.diff(nodes.times) / self.correlation_time
        memory, forgotten = np.exp(-apart), np.sqrt(-np.expm1(-2.0 * apart))
        has_trend = trend.shape[2] > 0
        for k in range(count if known.size else 0):
            before = float(memory[k - 1]) if k else 0.0
            scale = 1.0 / float(forgotten[k - 1]) if k else 1.0
            parts = {k - 1: -before * scale * weight} if before > 0.0 else {}
            parts[k] = scale * weight
            if has_trend:
                follow = trend[k] - before * trend[k - 1] if k else trend[k]
                parts[count] = -scale * follow / self.sigmas[known][:, None]
            yield LinearFactor(tuple(parts), tuple(parts.values()), _about(k, known))
        if self.trend_sigmas.size:
            about = _about(count, np.arange(self.trend_sigmas.size))
            yield LinearFactor((count,), (np.diag(1.0 / self.trend_sigmas),), about)


@dataclass(frozen=True, slots=True, eq=False)
class JointNodePrior:
    """Any Gaussian prior about zero on all components of all nodes at once; dense, so for passes of few nodes."""

    root: Array
    """(r, 6 k) whitened rows on the nodes, one after another."""
    trend_sigmas: Array
    """(0,) it knows no trend."""

    def __post_init__(self) -> None:
        root = frozen(self.root, "joint node prior", (None, None))
        if root.shape[1] % 6 or not root.size:
            raise InputError("joint node prior", f"shape {root.shape}", "(rows, 6 nodes)")
        assign(self, root=root, trend_sigmas=frozen(self.trend_sigmas, "joint node prior, trend", (0,)))

    @property
    def trend_components(self) -> Index:
        """(0,) no trend, no components."""
        return np.zeros(0, dtype=np.int64)

    @property
    def trend_names(self) -> tuple[str, ...]:
        """None."""
        return ()

    def node_sigmas(self, s: Array) -> Array:
        """(n, 6) a-priori sigma of the n nodes; infinite where their joint prior has no inverse."""
        information = self.root.T @ self.root
        try:
            variances = np.diagonal(np.linalg.solve(information, np.eye(information.shape[0])))
        except np.linalg.LinAlgError:
            variances = np.full(information.shape[0], np.inf)
        return np.sqrt(np.where(variances > 0.0, variances, np.inf)).reshape(s.size, 6)

    def scaled(self, nodes: Array, trend: Array) -> "JointNodePrior":
        """With the sigmas of nodes times factors (6,), by component."""
        return JointNodePrior(self.root / np.tile(nodes, self.root.shape[1] // 6), self.trend_sigmas)

    def factors(self, nodes: OrientationImages) -> Iterator[LinearFactor]:
        """All rows on all nodes."""
        if self.root.shape[1] != 6 * len(nodes):
            raise InputError("joint node prior", f"{self.root.shape[1]} columns", f"six for each of {len(nodes)} nodes")
        sigmas = self.node_sigmas(normalised(nodes)).ravel()
        unknown = np.tile([_UNKNOWN] * 3 + [1.0] * 3, len(nodes))
        counts = np.abs(self.root) * np.where(np.isfinite(sigmas), sigmas, unknown)
        largest = counts.argmax(axis=1)
        about = np.stack(np.divmod(largest, 6), axis=1)
        yield LinearFactor(tuple(range(len(nodes))), tuple(np.split(self.root, len(nodes), axis=1)), about)


PassPrior = NodePrior | JointNodePrior
"""What may be known of a pass beforehand."""


def _about(unknown: int, columns: Index) -> Index:
    """(rows, 2) of rows that are about one unknown."""
    return np.stack([np.full(columns.size, unknown), columns], axis=1)


def normalised(nodes: OrientationImages) -> Array:
    """(k,) times of the nodes as s = -1 .. 1 over the pass (`trend_span`); a spline's outer ones lie beyond."""
    start, stop = nodes.trend_span
    return (2.0 * nodes.times - start - stop) / (stop - start)
