"""The factor graph as an independent reference: the Jacobian oracle of a factor, dense normal equations, and the
adjustment that GTSAM alone makes of a small network.

What the kernel sums is compared with NumPy's Schur complement of the factors' Jacobians, which know nothing of the
kernel's patterns, tiles and blocks. The kernel's rows are relinearized about the predicted lines first.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import gtsam
import numpy as np

from mgsgraph.adjustment.covariances import considered_information
from mgsgraph.adjustment.factor_graph import Keys, Selected, factor_graph, measurement_factors
from mgsgraph.adjustment.graph import Layout, lay_out
from mgsgraph.adjustment.graph.patterns import PairBlocks, Variables
from mgsgraph.adjustment.graph.variables import angles_of, pass_values, shared_values, shift_values
from mgsgraph.adjustment.marginals import JointCovariance, dense_covariance
from mgsgraph.adjustment.rounds import about_predicted_lines
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.kernel.rows import OUT, PREDICTED, Groups, Model, Rows
from mgsgraph.kernel.sweep import COSTS, SYSTEM, Reduction, point_covariances, reduce
from mgsgraph.network import Network

LOSSES = ("none", "huber", "cauchy", "tukey")
TURNS = 60
"""Times that rows are relinearized."""

# --- the oracle


def assert_jacobians(
    factor: gtsam.NonlinearFactor, values: gtsam.Values, steps: dict[int, np.ndarray], tolerance: float = 1e-5
) -> None:
    """Compare a factor's linearisation with central differences of its whitened error.

    `steps` holds, by key, the step of each component (metres, radians): about what the variable's scale is. The
    difference of a column may be `tolerance` of the largest column of its block; the message names block and column.
    """
    linear = gtsam.JacobianFactor(factor.linearize(values))
    jacobian, right = linear.jacobian()
    np.testing.assert_allclose(-right, factor.whitenedError(values), rtol=1e-12, atol=1e-12)
    column = 0
    for key in linear.keys():
        size = steps[key].size
        analytic = jacobian[:, column : column + size] * steps[key]
        numeric = np.stack([_difference(factor, values, key, steps[key], k) for k in range(size)], axis=1)
        scale = np.abs(numeric).max()
        worst = np.abs(analytic - numeric).max(axis=0)
        k = int(np.argmax(worst))
        assert worst[k] <= tolerance * max(scale, 1e-6), (
            f"block {gtsam.DefaultKeyFormatter(key)}, column {k}: analytic {analytic[:, k]}, numeric {numeric[:, k]}"
        )
        column += size


def _difference(factor: gtsam.NonlinearFactor, values: gtsam.Values, key: int, steps: np.ndarray, k: int) -> np.ndarray:
    """Change of the whitened error per step of component k, by central differences of fourth order."""

    def error(times: float) -> np.ndarray:
        delta, sizes = gtsam.VectorValues(), values.zeroVectors()
        for other in values.keys():
            move = np.zeros(sizes.at(other).size)
            if other == key:
                move[k] = times * steps[k]
            delta.insert(other, move)
        return factor.whitenedError(values.retract(delta))

    return (8.0 * (error(1.0) - error(-1.0)) - (error(2.0) - error(-2.0))) / 12.0


# --- dense normal equations


@dataclass(eq=False)
class System:
    """Rows of a network with the unknowns that they feel."""

    layout: Layout
    rows: Rows
    """Those that take part."""
    units: np.ndarray | None = None
    """(columns,) of the unknowns, where they are not the layout's."""

    @property
    def network(self) -> Network:
        return self.layout.network

    @property
    def groups(self) -> Groups:
        return self.layout.groups

    @property
    def blocks(self) -> PairBlocks:
        return self.layout.blocks

    @property
    def model(self) -> Model:
        return self.layout.model

    @property
    def variables(self) -> Variables:
        return self.layout.variables

    @property
    def sigmas(self) -> np.ndarray:
        """(columns,) units of the unknowns, m and rad (and s)."""
        return self.layout.scales if self.units is None else self.units

    @property
    def columns(self) -> int:
        return int(self.sigmas.size)

    def reduce(self, x: np.ndarray, points: np.ndarray | None = None, task: int = SYSTEM) -> Reduction:
        return reduce(self.rows, self.groups, self.blocks.target, self.model, x, task, points)

    def matrix(self, flat: np.ndarray) -> np.ndarray:
        """(columns, columns) of blocks."""
        full = np.zeros((self.columns, self.columns))
        for v, w, at in zip(self.blocks.first, self.blocks.second, self.blocks.offset, strict=True):
            rows, columns = self.variables.columns_of(v), self.variables.columns_of(w)
            block = flat[at : at + self.variables.width[v] * self.variables.width[w]]
            full[rows, columns] = block.reshape(self.variables.width[v], self.variables.width[w])
            full[columns, rows] = full[rows, columns].T
        return full

    def flat(self, matrix: np.ndarray) -> np.ndarray:
        """The blocks of a (columns, columns) matrix; the way back."""
        parts = [
            matrix[self.variables.columns_of(v), self.variables.columns_of(w)].ravel()
            for v, w in zip(self.blocks.first, self.blocks.second, strict=True)
        ]
        return np.concatenate(parts)

    def covariances(self, x: np.ndarray, joint: np.ndarray, points: np.ndarray) -> np.ndarray:
        target = self.blocks.target
        return point_covariances(self.rows, self.groups, target, self.model, x, self.flat(joint), points)


    @cached_property
    def graph(self) -> tuple[list[gtsam.NonlinearFactor], Keys]:
        """Factors of the measurements that take part, without priors of shared unknowns."""
        at, network, model = self.layout.observation_rows, self.network, self.model
        out = np.zeros(len(network.points), dtype=bool)
        out[self.layout.point_order[self.rows.kind == OUT]] = True
        nominal, on_stereo = self.layout.network_order(self.rows.start), np.zeros(out.size, dtype=bool)
        if self.layout.stereo is not None:
            on_stereo[self.layout.stereo.points] = self.rows.weight[0, at.stereo] > 0.0
        rays = (self.rows.weight[0, at.rays] > 0.0) & ~out[network.rays.point]
        ranges = (self.rows.weight[0, at.ranges] > 0.0) & ~out[network.ranges.point]
        selected = Selected(nominal, nominal, rays, ranges, ~out, on_stereo & ~out, ())
        settings = SolverSettings(
            line="predicted" if model.line == PREDICTED else "measured", angles=angles_of(model),
            loss=LOSSES[model.loss], loss_width=model.width if np.isfinite(model.width) else None,
        )  # fmt: skip
        keys = Keys(network)
        return list(measurement_factors(network, settings, keys, selected)), keys

    def values(self, x: np.ndarray, points: np.ndarray) -> gtsam.Values:
        """Of all unknowns, at shared ones (columns,) and points (n, 3) in m, layout order."""
        values, (_, keys) = gtsam.Values(), self.graph
        for v in self.variables.adjusted():
            values.insert(keys.variable(int(v)), x[self.variables.columns_of(v)])
        for i, place in zip(self.layout.point_order.tolist(), points, strict=True):
            values.insert(keys.point(i), place)
        return values

    def relinearized(self, x: np.ndarray) -> tuple["System", np.ndarray]:
        """Rows about the lines predicted at shared unknowns (columns,) and at the points that belong to these, and
        these points (n, 3), layout order.
        """
        system, out = self, np.zeros(len(self.network.points), dtype=bool)
        out[self.layout.point_order[self.rows.kind == OUT]] = True
        at = self.layout.observation_rows
        for _ in range(TURNS):
            points = system.reduce(x).points
            anew = about_predicted_lines(system.layout, x, points)
            if anew is system.layout:
                break
            weight, there = anew.rows.weight.copy(), anew.observation_rows
            for mine, before in ((there.rays, at.rays), (there.ranges, at.ranges), (there.stereo, at.stereo)):
                weight[:, mine] = self.rows.weight[:, before]
            kind = np.where(out[anew.point_order], OUT, anew.rows.kind).astype(anew.rows.kind.dtype)
            system = System(anew, anew.rows._replace(weight=weight, kind=kind))
        return system, points


def of_layout(layout: Layout, rows: Rows | None = None) -> System:
    """The system that the adjustment itself solves."""
    return System(layout, layout.rows if rows is None else rows)


@dataclass(eq=False)
class Normals:
    """Dense normal equations at given unknowns and points, in units of the unknowns' sigmas; points in m."""

    matrix: np.ndarray
    """(columns + 3 n, columns + 3 n), without priors on the shared unknowns; zero for points that are known or out."""
    gradient: np.ndarray
    cost: float
    columns: int

    @property
    def solved(self) -> np.ndarray:
        """Columns of the points that are unknowns."""
        mine = np.flatnonzero(np.diag(self.matrix) > 0.0)
        return mine[mine >= self.columns]

    def reduced(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Schur complement of the points, its gradient, and the cost at the points' best places by the linear model."""
        c, p = slice(0, self.columns), self.solved
        gain = np.linalg.solve(self.matrix[np.ix_(p, p)], np.column_stack([self.matrix[p, c], self.gradient[p]]))
        matrix = self.matrix[c, c] - self.matrix[c, p] @ gain[:, :-1]
        gradient = self.gradient[c] - self.matrix[c, p] @ gain[:, -1]
        return matrix, gradient, self.cost - 0.5 * float(self.gradient[p] @ gain[:, -1])

    def inverse(self) -> np.ndarray:
        """Covariance of everything, with priors of the units; zero for what is known."""
        kept = np.concatenate([np.arange(self.columns), self.solved])
        normal = self.matrix[np.ix_(kept, kept)].copy()
        normal[: self.columns, : self.columns] += np.eye(self.columns)
        inverse = np.zeros_like(self.matrix)
        inverse[np.ix_(kept, kept)] = np.linalg.inv(normal)
        return inverse


def dense_normals(system: System, x: np.ndarray, points: np.ndarray) -> Normals:
    """Sum of the factors' linearizations."""
    size = system.columns + 3 * points.shape[0]
    normals = Normals(np.zeros((size, size)), np.zeros(size), 0.0, system.columns)
    (factors, keys), values = system.graph, system.values(x, points)
    adjusted, order = system.variables.adjusted(), system.layout.point_order.tolist()
    columns = {keys.variable(int(v)): np.arange(size)[system.variables.columns_of(v)] for v in adjusted}
    columns |= {keys.point(i): system.columns + 3 * k + np.arange(3) for k, i in enumerate(order)}
    units = np.append(system.sigmas, np.ones(3 * points.shape[0]))
    for factor in factors:
        normals.cost += factor.error(values)
        if not factor.keys():
            continue
        jacobian, right = gtsam.JacobianFactor(factor.linearize(values)).jacobian()
        at = np.concatenate([columns[key] for key in factor.keys()])
        jacobian = jacobian * units[at]
        normals.matrix[np.ix_(at, at)] += jacobian.T @ jacobian
        normals.gradient[at] -= jacobian.T @ right
    return normals


def assert_bundle_is_explicit(system: System, x: np.ndarray, share: float = 1e-9) -> Reduction:
    """Reduced matrix, gradient and cost against the dense Schur complement, to `share` of the largest; covariances of
    the points against the dense inverse, to ten times that. The points are solved first, so that both are of one place.
    """
    system, points = system.relinearized(x)
    found, normals = system.reduce(x, points), dense_normals(system, x, points)
    matrix, gradient, cost = normals.reduced()
    assert found.blocks is not None
    scaled = system.matrix(found.blocks) * system.sigmas * system.sigmas[:, None]
    largest = max(np.abs(matrix).max(initial=0.0), 1e-3)  # where nothing is learned, rounding is left; a prior has 1
    np.testing.assert_allclose(scaled, matrix, rtol=0.0, atol=share * largest)
    # the gradient is a sum over rows that cancels: what it is compared with is what is summed
    summed = np.sqrt(2.0 * cost * largest)
    np.testing.assert_allclose(found.gradient * system.sigmas, gradient, rtol=0.0, atol=share * summed)
    np.testing.assert_allclose(found.cost, cost, rtol=share)
    inverse = normals.inverse()
    joint = inverse[: system.columns, : system.columns] * system.sigmas * system.sigmas[:, None]
    own = np.arange(system.columns, inverse.shape[0]).reshape(-1, 3)
    expected = inverse[own[:, :, None], own[:, None, :]]
    covariances = system.covariances(x, joint, points)
    largest = np.abs(expected).max(initial=1e-300)
    np.testing.assert_allclose(covariances, expected, rtol=0.0, atol=10.0 * share * largest)
    return found


def assert_gradient_is_that_of_the_cost(system: System, x: np.ndarray, share: float = 1e-6) -> None:
    """Central differences of fourth order of the reduced cost, a step of 1e-3 sigma."""
    found = system.reduce(x)
    cost: Callable[[np.ndarray], float] = lambda move: system.reduce(x + move, found.points, COSTS).cost  # noqa: E731
    numeric = np.empty(system.columns)
    for k in range(system.columns):
        step = np.zeros(system.columns)
        step[k] = 1e-3 * system.sigmas[k]
        numeric[k] = (8.0 * (cost(step) - cost(-step)) - (cost(2.0 * step) - cost(-2.0 * step))) / 12e-3
    analytic = found.gradient * system.sigmas
    np.testing.assert_allclose(analytic, numeric, rtol=share, atol=share * np.abs(analytic).max())


# --- an adjustment by GTSAM alone


def by_gtsam(solution: Solution) -> Solution:
    """The solution with what GTSAM's optimiser finds of its factor graph, from the nominal orientation on, and with its
    marginals.
    """
    network, layout = solution.network, lay_out(solution.network, solution.settings)
    variables = layout.variables
    graph, values, keys = factor_graph(solution)
    for v in variables.adjusted():
        values.update(keys.variable(v), np.zeros(int(variables.width[v])))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setDiagonalDamping(True)
    parameters.setRelativeErrorTol(1e-15)
    parameters.setAbsoluteErrorTol(1e-15)
    parameters.setlambdaInitial(1e-10)
    parameters.setMaxIterations(100)
    optimum = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    points = [i for i in range(len(network.points)) if optimum.exists(keys.point(i))]
    order = [keys.variable(v) for v in variables.adjusted()]
    joint, every = explicit_covariances(layout, graph, optimum, order, [keys.point(i) for i in points])
    places, covariances = solution.places.copy(), np.where(np.isnan(solution.covariances), np.nan, 0.0)
    for k, i in enumerate(points):
        mine = slice(layout.columns + 3 * k, layout.columns + 3 * k + 3)
        places[i], covariances[i] = optimum.atPoint3(keys.point(i)), every[mine, mine]
    x = np.concatenate([np.zeros(0), *(optimum.atVector(key) for key in order)])
    own = iter(x[variables.columns_of(j)].reshape(-1, 6) for j in np.flatnonzero(network.with_polynomial).tolist())
    nodes, trends = pass_values(network, variables, x)
    shifts, lift = shift_values(network, variables, x)
    return replace(
        solution,
        cost_final=float(graph.error(optimum)),
        coefficients=tuple(next(own) if mine else np.zeros_like(prior.sigmas)
                           for mine, prior in zip(network.with_polynomial, network.priors, strict=True)),
        shifts=shifts, lift=lift, shared=shared_values(network, variables, x), nodes=nodes, trends=trends,
        places=places, covariances=covariances, joint_covariance=joint,
    )  # fmt: skip


def explicit_covariances(
    layout: Layout, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, shared: list[int], points: list[int]
) -> tuple[JointCovariance, np.ndarray]:
    """Joint covariance of the shared unknowns, and covariance of these and of points: inverted as one matrix."""
    order = gtsam.Ordering()
    for key in (*shared, *points):
        order.push_back(key)
    information = graph.linearize(values).hessian(order)[0]
    scales = np.concatenate([layout.scales, np.full(3 * len(points), 100.0)])

    def inverted() -> tuple[JointCovariance, np.ndarray]:
        units = np.outer(scales, scales)
        every, mine = np.linalg.inv(information * units) * units, slice(layout.columns)
        return dense_covariance(layout.variables.first, layout.variables.width, every[mine, mine]), every

    joint, every = inverted()
    if layout.prior.considered:
        for (v, w), block in considered_information(layout, joint):
            rows, columns = layout.columns_of(v), layout.columns_of(w)
            information[rows, columns] += block
            if v != w:
                information[columns, rows] += block.T
        joint, every = inverted()
    return joint, every
