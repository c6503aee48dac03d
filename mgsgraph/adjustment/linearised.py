"""A network linearised where it stands: the rows of its points, and of planned measures."""

from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.covariances import orientation_covariance, point_covariances
from mgsgraph.adjustment.fit import Fit, fit
from mgsgraph.adjustment.graph import BundleGraph, Layout, lay_out
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.residuals import residuals
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError
from mgsgraph.files.tie_points import PointKind
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.measurements import row_count
from mgsgraph.kernel.rows import OUT, Rows, of_points
from mgsgraph.kernel.sweep import ROW_NUMBERS, design
from mgsgraph.names import Names
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, ProfileShifts, Ranges


@dataclass(frozen=True, slots=True, eq=False)
class PointRows:
    """Whitened rows of some points that feel the same unknowns in the same way; m points, r rows, c columns."""

    variables: tuple[int, ...]
    """Shared unknowns that they feel, in the order of the columns."""
    residuals: Array
    """(m, r) in sigmas: of rays and ranges measured minus predicted; of a-priori places and heights above the terrain
    predicted minus known."""
    by_point: Array
    """(m, r, 3) per m."""
    by_shared: Array
    """(m, r, c) per m and rad."""
    observation: Index
    """(r,) observation, counted within the points' pattern, that each row belongs to."""
    row: Index
    """(r,) which row of it: line 0, sample 1; x, y, z of a ground prior."""
    known: bool
    """Whether the points are fixed: no unknowns, whatever the rows' derivatives by them."""

    def of(self, point: int) -> "PointRows":
        """Rows of one of the points."""
        one = slice(point, point + 1)
        return replace(
            self, residuals=self.residuals[one], by_point=self.by_point[one], by_shared=self.by_shared[one]
        )

    def following(self) -> tuple[Array, Array]:
        """The rows once the points follow the shared unknowns x: P = B N (m, r, 3) on the noise e that they keep for
        themselves, and J + B K (m, r, c) on x; nothing goes through known points.
        """
        if self.known:
            return np.zeros_like(self.by_point), self.by_shared
        carried, noise = self.eliminated()
        return self.by_point @ noise, self.by_shared + self.by_point @ carried

    def eliminated(self) -> tuple[Array, Array]:
        """The points as functions of the shared unknowns x and of noise e (3,) of their own, of unit covariance:
        point = K x + N e with K (m, 3, c) = -V^-1 W' and N (m, 3, 3) = L^-T, V = B'B = L L', W' = B'J.
        """
        turned = np.swapaxes(self.by_point, 1, 2)
        normal = turned @ self.by_point
        noise = np.swapaxes(np.linalg.solve(np.linalg.cholesky(normal), np.eye(3)), 1, 2)
        return np.asarray(-np.linalg.solve(normal, turned @ self.by_shared)), np.asarray(noise)


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """A network where it is linearised, and the covariance of the unknowns that its points share."""

    layout: Layout
    """Layout of all rows."""
    settings: SolverSettings
    """Settings of the layout."""
    rows: Rows
    """Rows that take part."""
    orientation: Array
    """(columns,) shared unknowns, m and rad."""
    points: Array
    """(n, 3) m, layout order."""
    joint: JointCovariance
    """Of the shared unknowns, for sigma0 = 1."""
    mixed: bool = False
    """Whether that is the mean square over a mixture of minima."""

    @property
    def network(self) -> Network:
        """The network that was adjusted."""
        return self.layout.network

    @property
    def values(self) -> list[Array]:
        """Value (width,) of each variable, m, rad and s; zero for held images."""
        variables = self.layout.variables
        return [
            self.orientation[variables.columns_of(v)] if first >= 0 else np.zeros(variables.width[v])
            for v, first in enumerate(variables.first.tolist())
        ]

    @property
    def places(self) -> Array:
        """(n, 3) m, of the network's points; NaN for those that nothing determines."""
        out = self.rows.kind == OUT
        return self.layout.network_order(np.where(out[:, None], np.nan, self.points))

    def point_covariances(self) -> Array:
        """(n, 3, 3) m^2, of these, for sigma0 = 1; NaN for those that nothing determines."""
        found = point_covariances(self.layout, self.rows, self.orientation, self.points, self.joint)
        out = self.rows.kind == OUT
        return self.layout.network_order(np.where(out[:, None, None], np.nan, found))

    def fit(self) -> Fit:
        """Weighted squares, observations and unknowns of the rows that take part."""
        found = residuals(self.layout, self.orientation, self.points)
        return fit(self.layout, self.rows, self.orientation, self.points, found)

    def of_estimator(self) -> "Linearised":
        """The same with the covariance that estimates had were considered unknowns without error, and this the only
        minimum: what redundancy and tests of residuals are about. Itself where that is so.
        """
        if not (self.layout.prior.considered or self.mixed):
            return self
        graph = BundleGraph(self.layout, self.rows)
        reduction = graph.reduction(self.orientation, points=self.points)
        return replace(self, joint=orientation_covariance(graph, reduction, consider=False), mixed=False)

    def layout_index(self, point: int) -> int:
        """Place in the layout of a network point that takes part; InputError where nothing determines it."""
        index = int(self.layout.patterns.point_index[point])
        if self.rows.kind[index] == OUT:
            where = f"point {self.network.points.ids[point]}"
            raise InputError(where, "its measures determine no place, or were rejected", "a point that was adjusted")
        return index

    def rows_of(self, point: int) -> PointRows:
        """Rows of one network point that takes part."""
        index = self.layout_index(point)
        piece = int(self.layout.patterns.piece_of(index))
        return self.rows_inside(piece, np.array([index - self.rows.piece[piece, 1]]))

    def rows_of_piece(self, piece: int) -> PointRows:
        """Rows of all points of a piece of the layout, taking part or not."""
        return self.rows_inside(piece, np.arange(self.rows.piece[piece, 2]))

    def rows_inside(self, piece: int, inside: Index) -> PointRows:
        """Rows of some points (m,) of a piece of the layout, by their places in it."""
        rows = of_points(self.rows, piece, inside)
        return point_rows(self.layout, rows, self.orientation, self.points[self.rows.piece[piece, 1] + inside])

    def pair_blocks(self, layout: Layout) -> Array:
        """Covariance of the shared unknowns in the blocks of a layout, this one's or that of `asked`."""
        return layout.blocks.filled(self.joint)

    def asked(self, places: Array, rays: ImageRays, known: bool) -> Layout:
        """Layout of places (m, 3) in m that nobody has measured, on the same shared unknowns.

        Rays of known positions are rows without a point; those of unknown ones intersect in them.
        """
        network, m = self.network, places.shape[0]
        kinds, ids = np.full(m, PointKind.FIXED if known else PointKind.FREE), Names.of(f"place {k}" for k in range(m))
        points = GroundPoints(ids, np.full(m, PointClass.TIE), kinds, places, np.zeros((m, 3, 3)))
        none, empty = np.zeros(0, dtype=np.int64), np.zeros(0)
        shifts, surface = network.shifts, network.surface
        bare = replace(
            network,
            points=points,
            rays=rays,
            ranges=Ranges(none, none, empty, empty, empty),
            shifts=None if shifts is None else ProfileShifts(shifts.names, np.full(m, -1), shifts.sigmas),
            surface=None if surface is None else replace(surface, sigmas=np.full(m, np.inf)),
            stereo=None,
            crossovers=None,
        )
        # the papers' form has no derivatives of a place, only of a misfit at a measured line
        return lay_out(bare, replace(self.settings, line="predicted") if known else self.settings, places)


def point_rows(layout: Layout, rows: Rows, orientation: Array, points: Array) -> PointRows:
    """Rows of the points (m, 3) of one piece, which is all that `rows` holds of the layout's."""
    pattern, _, count, _, _ = rows.piece[0].tolist()
    group, first = int(rows.pattern_group[pattern]), int(rows.pattern_observation[pattern])
    observations = np.arange(first, rows.pattern_observation[pattern + 1])
    numbers = design(rows, layout.groups, layout.blocks.target, layout.model, orientation, points)
    counts = map(row_count.py_func, rows.observation_kind[observations].tolist())
    of_row = [(i, row) for i, count_of in enumerate(counts) for row in range(count_of)]
    observation, row = np.array(of_row, dtype=np.int64).reshape(-1, 2).T
    mine = numbers.reshape(-1, count, *numbers.shape[1:])[observation, :, row].transpose(1, 0, 2)
    members = slice(*layout.groups.member_first[group : group + 2])
    width = layout.groups.member_width[members]
    by_shared = np.zeros((count, observation.size, int(width.sum())))
    for k, places in enumerate(_columns(rows, first + observation, np.cumsum(width) - width)):
        for n, column in enumerate(places.tolist()):
            by_shared[:, k, column] += mine[:, k, ROW_NUMBERS + n]
    known = bool(rows.pattern_fixed[pattern])
    by_point = mine[:, :, 1:ROW_NUMBERS]
    return PointRows(layout.group_variables[group], mine[:, :, 0], by_point, by_shared, observation, row, known)


def _columns(rows: Rows, observations: Index, first_of_member: Index) -> list[Index]:
    """Of each row's observation, where its numbers go among the columns of the group."""
    found = []
    for i in observations.tolist():
        entry, terms = int(rows.observation_entry[i]), int(rows.observation_terms[i])
        mine = slice(entry, entry + terms + int(rows.observation_shared[i]))
        begin = first_of_member[rows.entry_member[mine]] + rows.entry_inside[mine]
        found.append(np.concatenate([(begin[:terms, None] + np.arange(6)).ravel(), begin[terms:]]))
    return found
