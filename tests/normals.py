"""The oracle of bundles: rows put together by hand, and dense normal equations of the same rows one by one.

A layout can be taken apart into points and observations, given columns that no network has yet (time bias, boresight,
focal length, range bias, nodes), and packed again as the kernel wants it. What the kernel then sums is compared with
NumPy's Schur complement of the explicit factors' Jacobians, which know nothing of patterns, tiles and blocks.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import gtsam
import numpy as np

from mgsgraph.adjustment.graph import Layout
from mgsgraph.adjustment.graph.explicit import observation_factor, observation_noise
from mgsgraph.adjustment.graph.patterns import PairBlocks, Variables, make_groups, pair_blocks
from mgsgraph.kernel.rows import FIXED, OUT, PIECE, PREDICTED, Groups, Model, Rows, one_observation
from mgsgraph.kernel.sweep import COSTS, SYSTEM, Reduction, point_covariances, reduce

Column = tuple[int, int]
"""Variable, and column within it."""


@dataclass(eq=False)
class HandObservation:
    """One observation of one point, its constants by name."""

    kind: int
    width: int
    focal: float
    own: np.ndarray
    """What comes before the basis values in `Rows.data`."""
    weight: np.ndarray
    among: int
    """Its place among all observations of the layout that it was taken from."""
    terms: list[Column] = field(default_factory=list)
    basis: np.ndarray = field(default_factory=lambda: np.zeros(0))
    rates: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Per line; empty where the pose isn't carried."""
    singles: list[Column] = field(default_factory=list)
    directions: list[np.ndarray] = field(default_factory=list)
    """(width,) each."""

    @property
    def signature(self) -> tuple[Any, ...]:
        """What observations of one pattern have in common."""
        return self.kind, self.width, self.focal, tuple(self.terms), tuple(self.singles)

    @property
    def felt(self) -> set[int]:
        """Variables."""
        return {variable for variable, _ in [*self.terms, *self.singles]}

    @property
    def numbers(self) -> np.ndarray:
        """All constants, in the order of `Rows.data`."""
        return np.concatenate([self.own, self.basis, self.rates, *self.directions])


@dataclass(eq=False)
class HandPoint:
    """One point and its observations."""

    kind: int
    start: np.ndarray
    observations: list[HandObservation]


@dataclass(eq=False)
class System:
    """Rows with the unknowns that they feel."""

    rows: Rows
    groups: Groups
    blocks: PairBlocks
    model: Model
    variables: Variables
    sigmas: np.ndarray
    """(columns,) units of the unknowns, m and rad (and s)."""

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


def of_layout(layout: Layout, rows: Rows | None = None) -> System:
    """The system that the adjustment itself solves."""
    rows = layout.rows if rows is None else rows
    return System(rows, layout.groups, layout.blocks, layout.model, layout.variables, layout.scales)


def take_apart(layout: Layout, rows: Rows | None = None) -> list[HandPoint]:
    """The points of a layout, in its order."""
    rows, points = layout.rows if rows is None else rows, list[HandPoint]()
    for pattern, first, count, begin, among in rows.piece.tolist():
        observations = range(rows.pattern_observation[pattern], rows.pattern_observation[pattern + 1])
        for i in range(count):
            at, mine = begin + i, list[HandObservation]()
            for k, s in enumerate(observations):
                size = int(rows.observation_numbers[s])
                values = rows.data[at + count * np.arange(size)]
                at += size * count
                mine.append(_observation(layout, rows, pattern, s, values, among + k * count + i))
            points.append(HandPoint(int(rows.kind[first + i]), rows.start[first + i].copy(), mine))
    return points


def _observation(layout: Layout, rows: Rows, pattern: int, s: int, values: np.ndarray, among: int) -> HandObservation:
    kind, width = int(rows.observation_kind[s]), int(rows.observation_width[s])
    terms, shared = int(rows.observation_terms[s]), int(rows.observation_shared[s])
    rates = terms if kind == 0 and layout.model.line == PREDICTED else 0
    if rows.observation_rate[s] and terms:  # of a polynomial u alone is there
        at = values.size - width * shared - 1
        u, t = values[at], np.arange(terms)
        slopes = t * u ** np.maximum(t - 1, 0) * rows.observation_rate[s]
        values = np.concatenate([values[:at], u**t, slopes[:rates], values[at + 1 :]])
    own, basis, rate, directions = np.split(
        values, np.cumsum([values.size - terms - rates - width * shared, terms, rates])
    )
    members = layout.groups.member_variable[layout.groups.member_first[rows.pattern_group[pattern]] :]
    entry = int(rows.observation_entry[s])
    columns = [
        (int(members[rows.entry_member[e]]), int(rows.entry_inside[e])) for e in range(entry, entry + terms + shared)
    ]
    return HandObservation(
        kind,
        width,
        float(rows.observation_focal[s]),
        own,
        rows.weight[:, among].copy(),
        among,
        columns[:terms],
        basis,
        rate,
        columns[terms:],
        list(directions.reshape(shared, width)),
    )


def pack(points: list[HandPoint], units: list[np.ndarray], like: Layout, most: int = PIECE) -> System:
    """Points in the kernel's order, in pieces of at most `most`; units (w,) of each variable's columns.

    A variable without columns (a held image) is not felt by any observation.
    """
    variables = _variables(units)
    sets = [tuple(sorted(set[int]().union(*(s.felt for s in p.observations)))) for p in points]
    members = tuple(sorted(set(sets)))
    keys = [
        (members.index(mine), point.kind == FIXED, *(observation.signature for observation in point.observations))
        for mine, point in zip(sets, points, strict=True)
    ]
    patterns = sorted(set(keys))
    order = sorted(range(len(points)), key=lambda i: patterns.index(keys[i]))
    pieces, data, weight, first, numbers, observations = list[list[int]](), [], [], 0, 0, 0
    while first < len(order):
        pattern = keys[order[first]]
        run = [i for i in order[first : first + most] if keys[i] == pattern]
        pieces.append([patterns.index(pattern), first, len(run), numbers, observations])
        for k in range(len(pattern) - 2):
            data.append(np.stack([points[i].observations[k].numbers for i in run], axis=1).ravel())
            weight.append(np.stack([points[i].observations[k].weight for i in run], axis=1))
            numbers += data[-1].size
        first, observations = first + len(run), observations + (len(pattern) - 2) * len(run)
    rows = like.rows._replace(
        kind=np.array([points[i].kind for i in order], dtype=np.int8),
        start=np.stack([points[i].start for i in order]),
        data=np.concatenate(data),
        weight=np.ascontiguousarray(np.concatenate(weight, axis=1)),
        piece=np.array(pieces),
        pattern_observation=np.cumsum([0, *(len(pattern) - 2 for pattern in patterns)]),
        pattern_group=np.array([pattern[0] for pattern in patterns]),
        pattern_fixed=np.array([int(pattern[1]) for pattern in patterns]),
        pattern_shape=np.arange(len(patterns)),
        **_tables(
            [(signature, members[pattern[0]]) for pattern in patterns for signature in pattern[2:]],
            [one.numbers.size for pattern in patterns for one in points[keys.index(pattern)].observations],
            variables,
        ),
    )
    sizes, flat = [len(mine) for mine in members], [v for mine in members for v in mine]
    groups = make_groups(variables, np.cumsum([0, *sizes]), np.array(flat, dtype=np.int64))
    return System(rows, groups, pair_blocks(variables, groups), like.model, variables, variables.sigmas)


def _variables(units: list[np.ndarray]) -> Variables:
    width = np.array([unit.size for unit in units], dtype=np.int64)
    first = np.where(width > 0, np.cumsum(width) - width, -1)
    sigmas = np.concatenate(units)
    return Variables(0, first, width, sigmas, *np.zeros((2, sigmas.size), dtype=bool))


def _tables(
    observations: list[tuple[Any, tuple[int, ...]]], numbers: list[int], variables: Variables
) -> dict[str, np.ndarray]:
    """The tables of the patterns' observations, and their entries."""
    signatures = [signature for signature, _ in observations]
    entries = [
        (variables.first[variable] + inside, members.index(variable), inside)
        for (_, _, _, terms, singles), members in observations
        for variable, inside in (*terms, *singles)
    ]
    sizes = np.array([len(terms) + len(singles) for _, _, _, terms, singles in signatures], dtype=np.int64)
    column, member, inside = np.array(entries, dtype=np.int64).reshape(-1, 3).T.copy()
    return {
        "observation_kind": np.array([s[0] for s in signatures]),
        "observation_width": np.array([s[1] for s in signatures]),
        "observation_terms": np.array([len(s[3]) for s in signatures]),
        "observation_shared": np.array([len(s[4]) for s in signatures]),
        "observation_entry": np.cumsum(sizes) - sizes,
        "observation_focal": np.array([s[2] for s in signatures]),
        "observation_rate": np.zeros(len(signatures)),
        "observation_numbers": np.array(numbers),
        "entry_column": column,
        "entry_member": member,
        "entry_inside": inside,
    }


@dataclass(eq=False)
class Factor:
    """One observation as a GTSAM factor."""

    point: int
    """Place in the system's order."""
    felt: list[int]
    """Variables."""
    factor: gtsam.CustomFactor
    fixed: bool


def variable_key(variable: int) -> int:
    """Any shared unknown; 'o' is what `jacobians` takes for a vector."""
    return int(gtsam.symbol("o", variable))


def point_key(point: int) -> int:
    return int(gtsam.symbol("p", point))


def explicit_factors(system: System) -> Iterator[Factor]:
    """A factor for each observation that takes part."""
    rows, groups = system.rows, system.groups
    for pattern, first, count, _, among in rows.piece.tolist():
        begin, end = rows.pattern_observation[pattern : pattern + 2]
        for i in range(first, first + count):
            for s in range(begin, end):
                weights = rows.weight[:, among + (s - begin) * count + i - first]
                if rows.kind[i] != OUT and weights[0] > 0.0:
                    entry = rows.observation_entry[s]
                    mine = rows.entry_member[entry : entry + rows.observation_terms[s] + rows.observation_shared[s]]
                    felt = groups.member_variable[groups.member_first[rows.pattern_group[pattern]] + np.unique(mine)]
                    fixed = bool(rows.kind[i] == FIXED)
                    factor = observation_factor(
                        [variable_key(v) for v in felt],
                        [int(system.variables.width[v]) for v in felt],
                        rows.start[i] if fixed else point_key(i),
                        one_observation(rows, groups, i, int(s - begin)),
                        system.model,
                        observation_noise(int(rows.observation_kind[s]), weights, system.model),
                        f"point {i}, observation {s - begin}",
                    )
                    yield Factor(i, [int(v) for v in felt], factor, fixed)


def values_at(system: System, x: np.ndarray, points: np.ndarray) -> gtsam.Values:
    values = gtsam.Values()
    for v in system.variables.adjusted():
        values.insert(variable_key(v), x[system.variables.columns_of(v)])
    for i, place in enumerate(points):
        values.insert(point_key(i), place)
    return values


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
    """Sum of the explicit factors' linearisations."""
    size = system.columns + 3 * points.shape[0]
    normals = Normals(np.zeros((size, size)), np.zeros(size), 0.0, system.columns)
    values = values_at(system, x, points)
    for mine in explicit_factors(system):
        normals.cost += mine.factor.error(values)
        if mine.fixed and not mine.felt:
            continue
        jacobian, right = gtsam.JacobianFactor(mine.factor.linearize(values)).jacobian()
        places = [np.arange(system.columns)[system.variables.columns_of(v)] for v in mine.felt]
        if not mine.fixed:
            places.append(system.columns + 3 * mine.point + np.arange(3))
        at = np.concatenate(places)
        jacobian = jacobian * np.append(system.sigmas, np.ones(3 * points.shape[0]))[at]
        normals.matrix[np.ix_(at, at)] += jacobian.T @ jacobian
        normals.gradient[at] -= jacobian.T @ right
    return normals


def assert_bundle_is_explicit(system: System, x: np.ndarray, share: float = 1e-9) -> Reduction:
    """Reduced matrix, gradient and cost against the dense Schur complement, to `share` of the largest; covariances of
    the points against the dense inverse, to ten times that. The points are solved first, so that both are of one place.
    """
    points = system.reduce(x).points
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
