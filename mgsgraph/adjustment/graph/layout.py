"""The network laid out for the kernel: points sorted by the set of shared unknowns that they touch."""

import itertools
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.graph.rows import lay_out_rows
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.factors.rows import (
    CAMERA,
    CAUCHY,
    HUBER,
    MEASURED,
    NO_LOSS,
    OPK_PAPER,
    OPK_PEER,
    OUT,
    PREDICTED,
    TUKEY,
    Groups,
    Model,
    Rows,
)
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.network import Network

_LINES = {"predicted": PREDICTED, "measured": MEASURED}
_ANGLES = {"camera": CAMERA, "opk-paper": OPK_PAPER, "opk-peer": OPK_PEER}
_LOSSES = {"none": NO_LOSS, "huber": HUBER, "cauchy": CAUCHY, "tukey": TUKEY}
_CHUNK = 1024
"""Points per piece of parallel work."""


@dataclass(frozen=True, slots=True, eq=False)
class Variables:
    """Unknowns that points share: orientation coefficients of images, horizontal shifts of profiles and of the terrain.

    Variable j is image j, variable `images` + p is profile p, and the last one may be the terrain model. A held image
    has no columns.
    """

    images: int
    """Number of images."""
    first: Index
    """(v,) first column of each variable in the orientation vector; -1 for a held image."""
    width: Index
    """(v,) number of its columns."""
    sigmas: Array
    """(columns,) a-priori sigmas, m and rad; infinite where nothing is known."""
    angular: Mask
    """(columns,) True for a column in rad."""

    def columns_of(self, variable: int) -> slice:
        """Columns of one variable."""
        first = int(self.first[variable])
        return slice(first, first + int(self.width[variable]))

    def adjusted(self) -> list[int]:
        """Variables that have columns."""
        return [int(v) for v in np.flatnonzero(self.first >= 0)]


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Rows of a network in the kernel's order, and the way back."""

    network: Network
    """What is adjusted."""
    model: Model
    """Forms of the measurement model."""
    rows: Rows
    """All rows, at full weight."""
    groups: Groups
    """Points by set of orientation variables."""
    variables: Variables
    """Shared unknowns."""
    group_variables: tuple[tuple[int, ...], ...]
    """Variables of each group, in the order of their columns within it."""
    point_order: Index
    """(n,) network point at each place of the layout."""
    ray_order: Index
    """(k,) network ray at each place of the layout."""
    range_order: Index
    """(r,) network range at each place of the layout."""

    @property
    def columns(self) -> int:
        """Number of shared unknowns."""
        return int(self.variables.sigmas.size)

    @property
    def sigmas(self) -> Array:
        """(columns,) a-priori sigmas, m and rad; infinite where nothing is known."""
        return self.variables.sigmas

    @property
    def scales(self) -> Array:
        """(columns,) units in which the shared unknowns are of order one: a-priori sigmas, else 1 km and 10 mrad."""
        plain = np.where(self.variables.angular, 1e-2, 1e3)
        return np.where(np.isinf(self.sigmas), plain, self.sigmas)

    def columns_of(self, variable: int) -> slice:
        """Columns of one variable."""
        return self.variables.columns_of(variable)

    def group_columns(self, group: int) -> Index:
        """Columns of a group's variables, in the order of its own columns."""
        parts = [np.arange(self.columns)[self.columns_of(v)] for v in self.group_variables[group]]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)

    def following(self, points: Array, shared: Array) -> "Layout":
        """The same layout with each point's terrain patch under its present place (n, 3), layout order, by the present
        shared unknowns (columns,); itself when all patches are the same.
        """
        surface = self.network.surface
        if surface is None:
            return self
        if self.network.terrain_moves:
            points = points - np.einsum("k,nkj->nj", shared[-2:], self.rows.surface_direction)
        cells = surface.grid.cells(points)
        held = (self.rows.surface_weight > 0.0) & (self.rows.point_kind != OUT)
        if np.array_equal(cells[held], self.rows.terrain_cell[held]):
            return self
        return replace(self, rows=self.rows._replace(terrain_cell=cells))

    def active(self, rays: Mask, ranges: Mask, out: Mask) -> Rows:
        """Rows with some left out: rays (k,), ranges (r,) that take part, points (n,) that don't; network order."""
        kind = self.rows.point_kind.copy()
        kind[out[self.point_order]] = OUT
        return self.rows._replace(
            point_kind=kind,
            weight=self.rows.weight * rays[self.ray_order][:, None],
            range_weight=self.rows.range_weight * ranges[self.range_order],
        )


def lay_out(network: Network, settings: SolverSettings) -> Layout:
    """Lay a network out for the kernel.

    Raises
    ------
    InputError
        When a point that nothing else places lies on a ray that misses the body.
    """
    model = Model(_LINES[settings.line], _ANGLES[settings.angles], _LOSSES[settings.loss], settings.width)
    variables = _variables(network)
    group_variables, group_of_point = _group_points(network, variables)
    point_order = np.argsort(group_of_point, kind="stable")
    ray_order, range_order, rows = lay_out_rows(
        network, model, variables.first, _local_columns(variables, group_variables), group_of_point, point_order
    )
    groups = _groups(variables, group_variables, group_of_point[point_order])
    return Layout(network, model, rows, groups, variables, group_variables, point_order, ray_order, range_order)


def _variables(network: Network) -> Variables:
    sigmas = [prior.sigmas.ravel() for prior in network.priors]
    shifts = np.zeros(0) if network.shifts is None else network.shifts.sigmas
    if network.surface is not None and network.terrain_moves:
        shifts = np.append(shifts, network.surface.shift_sigma)
    sigmas += [np.full(2, sigma) for sigma in shifts]
    width = np.array([part.size for part in sigmas], dtype=np.int64)
    adjusted = np.concatenate([~network.held, np.ones(shifts.size, dtype=bool)])
    first = np.where(adjusted, np.cumsum(width * adjusted) - width, -1)
    kept = [part for part, taken in zip(sigmas, adjusted, strict=True) if taken]
    angular = [np.arange(part.size) % 6 >= 3 for part in kept]
    return Variables(
        len(network.images),
        first,
        width,
        np.concatenate(kept) if kept else np.zeros(0),
        np.concatenate(angular) if angular else np.zeros(0, dtype=bool),
    )


def _group_points(network: Network, variables: Variables) -> tuple[tuple[tuple[int, ...], ...], Index]:
    """Sort points by the set of variables they touch: images that see them or carry a range of theirs, and profiles.

    Sets are told apart by the sum of a 62-bit random number per variable: one pass, no Python per point.
    """
    pairs = [
        np.stack([network.rays.point, network.rays.image], axis=1),
        np.stack([network.ranges.point, network.ranges.image], axis=1),
    ]
    if network.shifts is not None:
        shifted = np.flatnonzero(network.shifts.profile >= 0)
        pairs.append(np.stack([shifted, network.shifts.profile[shifted] + variables.images], axis=1))
    if network.surface is not None and network.terrain_moves:
        on_terrain = np.flatnonzero(np.isfinite(network.surface.sigmas))
        pairs.append(np.stack([on_terrain, np.full(on_terrain.size, variables.first.size - 1)], axis=1))
    touched = np.unique(np.concatenate(pairs), axis=0)
    touched = touched[variables.first[touched[:, 1]] >= 0]
    marks = np.random.default_rng(0).integers(1, 2**62, variables.first.size, dtype=np.uint64)
    signature = np.zeros(len(network.points), dtype=np.uint64)
    np.add.at(signature, touched[:, 0], marks[touched[:, 1]])
    _, example, group = np.unique(signature, return_index=True, return_inverse=True)
    spans = np.searchsorted(touched[:, 0], example), np.searchsorted(touched[:, 0], example, side="right")
    sets = tuple(tuple(int(v) for v in touched[a:b, 1]) for a, b in zip(*spans, strict=True))
    return sets, group.reshape(-1).astype(np.int64)


def _local_columns(variables: Variables, group_variables: tuple[tuple[int, ...], ...]) -> Index:
    """(groups, variables) first column of a variable within a group's own columns; -1 when it isn't in it."""
    local = np.full((len(group_variables), variables.first.size), -1, dtype=np.int64)
    for group, members in enumerate(group_variables):
        width = variables.width[list(members)]
        local[group, list(members)] = np.cumsum(width) - width
    return local


def _groups(variables: Variables, group_variables: tuple[tuple[int, ...], ...], sorted_group: Index) -> Groups:
    dimension = np.array([variables.width[list(members)].sum() for members in group_variables], dtype=np.int64)
    chunks = []
    for group in range(len(group_variables)):
        first, last = np.searchsorted(sorted_group, [group, group + 1])
        edges = np.append(np.arange(first, last, _CHUNK), last)
        chunks += [(group, a, b) for a, b in itertools.pairwise(edges.tolist())]
    offset = np.concatenate([[0], np.cumsum(dimension * dimension)]).astype(np.int64)
    return Groups(dimension, offset, np.array(chunks, dtype=np.int64).reshape(-1, 3))
