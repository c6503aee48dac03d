"""A pass: images on one trajectory (the lines of one camera, or several cameras of one spacecraft), and its orientation
images with what is known of them beforehand.

What is known of a pass's orientation images beforehand, as whitened rows on its nodes and its trend.

The trajectory is observed at every node, with a bias and a linear drift that the whole pass shares (Spiegel 2007, as
corrections to the observed exterior orientation): of a node at time t, s = -1 .. 1 over the pass,

    c(t) = bias + drift s + e(t),

where e has the node's own sigma and, between nodes, the correlation exp(-|dt| / correlation time) of a Gauss-Markov
process. So a node depends on the one before it by a smoothness factor, e_k - a e_{k-1} with a = exp(-dt / time) and
sigma root(1 - a^2) times the node's; without correlation time nodes are observed independently, as Spiegel has it.
Closer nodes then don't say more than the trajectory knows (`NodePrior`).

Other departures: any Gaussian process (`ProcessPrior`, `network.conditioning`), its rows between neighbouring nodes by
sequential conditioning (`network.conditioning`). Or none, and the corrections polynomials of time (`PolynomialPrior`):
four nodes of Lagrange's basis hold a cubic polynomial exactly.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.geometry.orientation import SUPPORT, OrientationImages
from mgsgraph.geometry.records import Array, Index, Mask, assign, frozen, frozen_index, read_only
from mgsgraph.network.conditioning import Conditionals, Process, conditionals, variances
from mgsgraph.record import Record


class BiasAndDrift(Record):
    """The trend of a prior that has sigmas of a bias and of a drift, as unknowns: those with a sigma above zero."""

    __slots__ = ()
    bias: Array
    """(6,) m and rad, sigma of the constant part; 0 where there is none."""
    drift: Array
    """(6,) m and rad, sigma of the linear part, at the ends of the pass; 0 where there is none."""

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

    def scaled_trend(self, factors: Array) -> tuple[Array, Array]:
        """(6,) sigmas of the bias, and (6,) of the drift, those of the trend's unknowns times factors (w,)."""
        of_bias, of_drift = np.ones(6), np.ones(6)
        biases = int(np.count_nonzero(self.bias))
        of_bias[self.bias > 0.0], of_drift[self.drift > 0.0] = factors[:biases], factors[biases:]
        return self.bias * of_bias, self.drift * of_drift


_LONGEST = 1e9
"""s: departures that take longer to forget themselves can't be told from a bias."""
_HELD = 1e-4
"""Share of a component's largest sigma to which polynomial terms above the degree are held; less would cost the
covariances their digits."""
_NOTHING = np.array([100.0] * 3 + [1e-3] * 3)
"""m and rad, that sigma where there is none."""


class LinearFactor(NamedTuple):
    """Whitened rows sum_v blocks[v] x_v on some unknowns of a pass: its nodes 0 .. k - 1, and its trend, number k."""

    unknowns: tuple[int, ...]
    """Which, each once."""
    blocks: tuple[Array, ...]
    """Of each a matrix (rows, width)."""
    about: Index
    """(rows, 2) what each row is chiefly about: one of the unknowns, and which of its columns."""


@dataclass(frozen=True, slots=True, eq=False)
class NodePrior(BiasAndDrift):
    """What is known of a pass's nodes beforehand; every entry (6,), m along X, Y, Z and rad."""

    sigmas: Array
    """(6,) m and rad, of a node's coefficient about the trend; infinite where nothing is known."""
    bias: Array
    """(6,) m and rad, sigma of the trend's constant part; 0 where there is none."""
    drift: Array
    """(6,) m and rad, sigma of the trend's linear part, at the ends of the pass; 0 where there is none."""
    correlation_time: float = 0.0
    """s in which the departures from the trend forget themselves to 1/e; 0 for nodes that know nothing of each other"""

    def __post_init__(self) -> None:
        sigmas = np.array(self.sigmas, dtype=np.float64)
        if sigmas.shape != (6,) or np.any(np.isnan(sigmas)) or np.any(sigmas <= 0.0):
            raise InputError("node prior, sigmas", f"{sigmas.tolist()}", "six positive sigmas")
        sigmas.flags.writeable = False
        bias, drift = frozen(self.bias, "node prior, bias", (6,)), frozen(self.drift, "node prior, drift", (6,))
        for name, trend in (("bias", bias), ("drift", drift)):
            require(trend.min() >= 0.0, f"node prior, {name}", f"{trend.min()}", "sigmas, or 0 for none")
            for c in np.flatnonzero((trend > 0.0) & np.isinf(sigmas))[:1]:
                found = f"sigma {trend[c]} of component {c} whose nodes have none"
                raise InputError(f"node prior, {name}", found, "a sigma of the nodes, too", "leave it out")
        if not 0.0 <= self.correlation_time <= _LONGEST:
            expected = f"0 (none) to {_LONGEST:g} s"
            raise InputError("node prior, correlation time", f"{self.correlation_time} s", expected)
        assign(self, sigmas=sigmas, bias=bias, drift=drift)

    def node_sigmas(self, s: Array) -> Array:
        """(n, 6) a-priori sigma of nodes at s (n,), with the trend's."""
        return np.sqrt(self.sigmas**2 + self.bias**2 + (s[:, None] * self.drift) ** 2)

    def own_sigmas(self, nodes: OrientationImages) -> Array:
        """(k, 6) a-priori sigma of each of some nodes, with the trend's."""
        return self.node_sigmas(normalised(nodes))

    def scaled(self, nodes: Array, trend: Array) -> "NodePrior":
        """With the sigmas of nodes times factors (6,), those of the trend's unknowns times factors (w,)."""
        bias, drift = self.scaled_trend(trend)
        return replace(self, sigmas=self.sigmas * nodes, bias=bias, drift=drift)

    def factors(self, nodes: OrientationImages) -> Iterator[LinearFactor]:
        """Whitened rows on the nodes and the trend."""
        finite = np.flatnonzero(np.isfinite(self.sigmas))
        s, count = normalised(nodes), len(nodes)
        trend, weight = self.trend(s)[:, finite], np.diag(1.0 / self.sigmas)[finite]
        with np.errstate(divide="ignore"):
            intervals = np.diff(nodes.times) / self.correlation_time
        memory, forgotten = np.exp(-intervals), np.sqrt(-np.expm1(-2.0 * intervals))
        has_trend = trend.shape[2] > 0
        for k in range(count if finite.size else 0):
            before = float(memory[k - 1]) if k else 0.0
            scale = 1.0 / float(forgotten[k - 1]) if k else 1.0
            parts = {k - 1: -before * scale * weight} if before > 0.0 else {}
            parts[k] = scale * weight
            if has_trend:
                follow = trend[k] - before * trend[k - 1] if k else trend[k]
                parts[count] = -scale * follow / self.sigmas[finite][:, None]
            yield LinearFactor(tuple(parts), tuple(parts.values()), _about(k, finite))
        yield from _on_trend(count, self.trend_sigmas)


@dataclass(frozen=True, slots=True, eq=False)
class PolynomialPrior(BiasAndDrift):
    """Corrections are polynomials of s = -1 .. 1 over the pass, sum_j a_j s^j, without a trend; on four nodes of
    Lagrange's basis.
    """

    position_sigmas: Array
    """(dp + 1, 3) m, of the coefficients of s^0 .. s^dp along X, Y, Z; dp <= 3; infinite where nothing is known, 0 for
    a term that is held at zero."""
    attitude_sigmas: Array
    """(da + 1, 3) rad, the same of the rotations about x, y, z."""

    def __post_init__(self) -> None:
        for name in ("position_sigmas", "attitude_sigmas"):
            where = f"polynomial prior, {name.replace('_', ' ')}"
            given = np.array(getattr(self, name), dtype=np.float64)
            if given.ndim != 2 or given.shape[1] != 3 or not 1 <= given.shape[0] <= SUPPORT:
                raise InputError(where, f"shape {given.shape}", "(degree + 1, 3), of a degree of 0 to 3")
            if np.any(np.isnan(given)) or given.min() < 0.0:
                raise InputError(where, f"{given.tolist()}", "sigmas, not negative")
            assign(self, **{name: read_only(given)})

    @property
    def polynomial(self) -> bool:
        """One polynomial: it holds before and after its nodes, too."""
        return True

    @property
    def coefficient_sigmas(self) -> Array:
        """(4, 6) m and rad of the coefficients of s^0 .. s^3, those held at a sigma so small that it is nothing."""
        sigmas = np.zeros((SUPPORT, 6))
        sigmas[: self.position_sigmas.shape[0], :3] = self.position_sigmas
        sigmas[: self.attitude_sigmas.shape[0], 3:] = self.attitude_sigmas
        largest = np.where(np.isfinite(sigmas), sigmas, 0.0).max(axis=0)
        held = _HELD * np.where(largest > 0.0, largest, _NOTHING)
        return np.where(sigmas > 0.0, sigmas, held)

    @property
    def bias(self) -> Array:  # type: ignore[override]
        """(6,) none."""
        return np.zeros(6)

    drift = bias

    def node_sigmas(self, s: Array) -> Array:
        """(n, 6) a-priori sigma of nodes at s (n,)."""
        powers = np.abs(s)[:, None, None] ** np.arange(SUPPORT)[:, None]
        with np.errstate(invalid="ignore"):  # 0 at s = 0 times a sigma that is infinite
            parts = np.where(powers > 0.0, powers * self.coefficient_sigmas, 0.0)
        return np.asarray(np.sqrt(np.sum(parts**2, axis=1)))

    def own_sigmas(self, nodes: OrientationImages) -> Array:
        """(4, 6) a-priori sigma of each of some nodes."""
        return self.node_sigmas(normalised(nodes))

    def scaled(self, nodes: Array, trend: Array) -> "PolynomialPrior":
        """With all sigmas times factors (6,), by component."""
        return PolynomialPrior(self.position_sigmas * nodes[:3], self.attitude_sigmas * nodes[3:])

    def factors(self, nodes: OrientationImages) -> Iterator[LinearFactor]:
        """One factor: a whitened row of each coefficient that is known or held."""
        expected = f"{SUPPORT}, which hold a cubic polynomial"  # four of Lagrange's basis
        require(len(nodes) == SUPPORT, "polynomial prior", f"{len(nodes)} nodes", expected,
                "leave the nodes out, or take a process")  # fmt: skip
        s = normalised(nodes)
        to_terms = np.linalg.solve(s[:, None] ** np.arange(SUPPORT), np.eye(SUPPORT))
        sigmas = self.coefficient_sigmas
        term, component = np.nonzero(np.isfinite(sigmas))
        if not term.size:
            return
        rows, weights = np.arange(term.size), 1.0 / sigmas[term, component]
        blocks = np.zeros((SUPPORT, term.size, 6))
        blocks[:, rows, component] = weights * to_terms[term].T
        yield LinearFactor(tuple(range(SUPPORT)), tuple(blocks), np.stack([term, component], axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class ProcessPrior(BiasAndDrift):
    """Departures from bias and drift are Gaussian processes: of position, and of attitude.

    An integrated Wiener process is zero and at rest amid the trend's span: bias and drift, which it must have (large
    where nothing is known), say its value and its rate there.
    """

    position: tuple[Process, ...]
    """Their sum: along X, Y, Z; m. Where there is none, departures from the trend are held at nothing."""
    attitude: tuple[Process, ...]
    """The same about x, y, z; rad."""
    bias: Array
    """(6,) m and rad, sigma of the trend's constant part; 0 where there is none."""
    drift: Array
    """(6,) m and rad, sigma of the trend's linear part, at the ends of the pass; 0 where there is none."""

    def __post_init__(self) -> None:
        assign(self, bias=frozen(self.bias, "process prior, bias", (6,)))
        assign(self, drift=frozen(self.drift, "process prior, drift", (6,)))
        if min(self.bias.min(), self.drift.min()) < 0.0:
            raise InputError("process prior, bias and drift", "a negative sigma", "sigmas, or 0 for none")
        for name, part, axes in (("position", self.position, slice(0, 3)), ("attitude", self.attitude, slice(3, 6))):
            if not isinstance(part, tuple):
                raise InputError(f"process prior, {name}", "no tuple", "processes, of which the sum is meant, or none")
            if any(not p.stationary for p in part) and min(self.bias[axes].min(), self.drift[axes].min()) == 0.0:
                found = "an integrated Wiener process without bias or drift"
                raise InputError(f"process prior, {name}", found, "both, large where nothing is known")

    def node_sigmas(self, s: Array) -> Array:
        """(n, 6) a-priori sigma of values at s (n,), with the trend's, without what integrated Wiener processes add: it
        depends on the time from the middle of the pass (`own_sigmas` has it).
        """
        parts = (self._parts(0), self._parts(3))
        of_processes = [sum(p.sigmas**2 for p in part if p.stationary) + np.zeros(3) for part in parts]
        return np.sqrt(np.concatenate(of_processes) + self.bias**2 + (s[:, None] * self.drift) ** 2)

    def own_sigmas(self, nodes: OrientationImages) -> Array:
        """(k, 6) a-priori sigma of the coefficient of each of some nodes, with the trend's."""
        of_processes = np.stack([variances(self._parts(c), c % 3, nodes) for c in range(6)], axis=1)
        return np.asarray(np.sqrt(of_processes + self.bias**2 + (normalised(nodes)[:, None] * self.drift) ** 2))

    def scaled(self, nodes: Array, trend: Array) -> "ProcessPrior":
        """With the strengths of processes times factors (6,), the sigmas of the trend's unknowns times factors (w,)."""
        bias, drift = self.scaled_trend(trend)
        return replace(
            self,
            position=tuple(process.scaled(nodes[:3]) for process in self.position),
            attitude=tuple(process.scaled(nodes[3:]) for process in self.attitude),
            bias=bias,
            drift=drift,
        )

    def _parts(self, component: int) -> tuple[Process, ...]:
        """Processes of a component (0 .. 5); where there are none, white noise that is nothing."""
        axes = slice(0, 3) if component < 3 else slice(3, 6)
        largest = np.maximum(self.bias, self.drift)[axes]
        held = np.where(largest > 0.0, largest, _NOTHING[axes])
        return (self.position if component < 3 else self.attitude) or (Process("white", _HELD * held),)

    def conditionals(self, nodes: OrientationImages) -> tuple[Conditionals, ...]:
        """Of each of the six components: how a node follows from those before it, and what is lost by taking few."""
        result, computed = list[Conditionals](), dict[tuple[float, ...], Conditionals]()
        for c in range(6):
            part = self._parts(c)
            size = float(part[0].sigmas[c % 3])
            key = (c // 3, *(float(process.sigmas[c % 3]) / size for process in part[1:]))
            if key not in computed:
                unit = tuple(process.scaled(np.full(3, 1.0 / size)) for process in part)
                computed[key] = conditionals(unit, c % 3, nodes)
            result.append(replace(computed[key], sigmas=size * computed[key].sigmas))
        return tuple(result)

    def divergence(self, nodes: OrientationImages) -> float:
        """Nats a node and component that rows between neighbours lose of the processes; see `network.conditioning`."""
        return max(component.divergence for component in self.conditionals(nodes))

    def factors(self, nodes: OrientationImages) -> Iterator[LinearFactor]:
        """Whitened rows between neighbouring nodes, and on the trend."""
        of_components, count, components = self.conditionals(nodes), len(nodes), np.arange(6)
        memory = max(component.memory for component in of_components)
        sigmas = np.stack([component.sigmas for component in of_components], axis=1)
        weights = np.zeros((count, memory, 6))
        for c, component in enumerate(of_components):
            weights[:, : component.memory, c] = component.weights
        trend = self.trend(normalised(nodes))
        for k in range(count):
            parts, follow = dict[int, Array](), trend[k].copy()
            for j in reversed(range(min(memory, k))):
                if np.any(weights[k, j]):
                    parts[k - 1 - j] = np.diag(-weights[k, j] / sigmas[k])
                    follow -= weights[k, j][:, None] * trend[k - 1 - j]
            parts[k] = np.diag(1.0 / sigmas[k])
            if trend.shape[2]:
                parts[count] = -follow / sigmas[k][:, None]
            yield LinearFactor(tuple(parts), tuple(parts.values()), _about(k, components))
        yield from _on_trend(count, self.trend_sigmas)


PassPrior = NodePrior | PolynomialPrior | ProcessPrior
"""What may be known of a pass beforehand."""


def _on_trend(unknown: int, sigmas: Array) -> Iterator[LinearFactor]:
    """Rows on the trend, where there is one."""
    if sigmas.size:
        yield LinearFactor((unknown,), (np.diag(1.0 / sigmas),), _about(unknown, np.arange(sigmas.size)))


def _about(unknown: int, columns: Index) -> Index:
    """(rows, 2) of rows that are about one unknown."""
    return np.stack([np.full(columns.size, unknown), columns], axis=1)


def normalised(nodes: OrientationImages) -> Array:
    """(k,) times of the nodes as s = -1 .. 1 over the pass (`trend_span`)."""
    start, stop = nodes.trend_span
    return (2.0 * nodes.times - start - stop) / (stop - start)


_NO_ROTATION = 1e-6
"""Of a product of a matrix with its transpose, off the unit matrix."""


@dataclass(frozen=True, slots=True, eq=False)
class Pass(Record):
    """Images that share a trajectory and its orientation images."""

    name: str
    """What to call it in reports, each once."""
    images: Index
    """(m,) its images in the network, each of one pass alone."""
    nodes: OrientationImages
    """Times of the orientation images, and the basis between them."""
    prior: PassPrior
    """What is known of them."""
    axes: Array | None = None
    """(m, 3, 3) how each camera is mounted: rotation from the axes of the pass, about which nodes turn, to the camera's
    own; None where all cameras have the axes of the pass."""
    whole: bool = True
    """Whether its nodes reach over all lines of its images; else over those with rows alone, or they are those of one
    polynomial, which holds before and after them."""

    def __post_init__(self) -> None:
        require(self.name, "pass", "an empty name", "what to call it")
        images = frozen_index(self.images, f"pass {self.name!r}, images", np.size(self.images), 2**31)
        if images.size == 0 or np.unique(images).size != images.size:
            raise InputError(f"pass {self.name!r}, images", f"{images.tolist()[:10]}", "at least one, each once")
        assign(self, images=images)
        if self.axes is not None:
            where = f"pass {self.name!r}, axes"
            axes = frozen(self.axes, where, (images.size, 3, 3))
            off = np.abs(axes @ axes.mT - np.eye(3)).max()
            if off > _NO_ROTATION or np.linalg.det(axes).min() < 0.0:
                raise InputError(where, f"matrices that are no rotations (off by {off:.2g})", "orthonormal rows")
            assign(self, axes=axes)

    def axes_of(self, image: int) -> Array | None:
        """(3, 3) from the axes of the pass to the camera of one of its images; None where they are the same."""
        if self.axes is None:
            return None
        return np.asarray(self.axes[int(np.flatnonzero(self.images == image)[0])])

    @property
    def widths(self) -> Index:
        """Columns of its unknowns: six of each node, then those of the trend, where it has one."""
        trend = self.prior.trend_sigmas.size
        return np.array([6] * len(self.nodes) + ([trend] if trend else []), dtype=np.int64)

    @property
    def sigmas(self) -> list[Array]:
        """A-priori sigmas of each of them, m and rad, by itself."""
        of_nodes = list(self.prior.own_sigmas(self.nodes))
        return of_nodes + ([self.prior.trend_sigmas] if self.prior.trend_sigmas.size else [])

    @property
    def asks_for_strengths(self) -> bool:
        """Whether the strength of one of its processes is to be estimated."""
        prior = self.prior
        return isinstance(prior, ProcessPrior) and any(p.estimated for p in (*prior.position, *prior.attitude))

    def part(self, unknown: int, inside: int) -> tuple[str, int]:
        """What a column of one of its unknowns belongs to, in words, and its component."""
        if unknown < len(self.nodes):
            return f"node {unknown + 1} of {len(self.nodes)}", inside
        return self.prior.trend_names[inside], int(self.prior.trend_components[inside])

    def scaled(self, nodes: Array, trend: Array) -> "Pass":
        """With a-priori sigmas of nodes times factors (6,), those of the trend's unknowns times factors (w,)."""
        return replace(self, prior=self.prior.scaled(nodes, trend))

    @property
    def angular(self) -> list[Mask]:
        """True for a column in rad, of each of them."""
        masks = [np.arange(6) >= 3 for _ in range(len(self.nodes))]
        if self.prior.trend_sigmas.size:
            masks.append(self.prior.trend_components >= 3)
        return masks
