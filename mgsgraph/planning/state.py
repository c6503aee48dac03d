"""Network state from which a plan begins: the adjusted network, linearised at its solution, with its covariance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.covariances import orientation_covariance
from mgsgraph.adjustment.datum import require_strength
from mgsgraph.adjustment.graph import BundleGraph, Layout, lay_out
from mgsgraph.adjustment.incremental.state import shared_of
from mgsgraph.adjustment.incremental.trajectories import with_expected
from mgsgraph.adjustment.marginals import carried
from mgsgraph.adjustment.rounds import Selection, determined_points, everything, exactly, without_weak
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import require_covariance
from mgsgraph.errors import InputError, errors_from
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.kernel.rows import Rows
from mgsgraph.kernel.sweep import Reduction
from mgsgraph.network import Network
from mgsgraph.network.corrections import whole_correction
from mgsgraph.network.joining import Definitions, definitions, latest, with_definitions
from mgsgraph.network.parts import (
    KnownImage,
    Unknown,
    alone,
    joined,
    known_images,
    part,
    require_separable,
    unknowns,
    with_images,
)


@dataclass(frozen=True, slots=True, eq=False)
class NetworkState:
    """A network with the values of its unknowns."""

    network: Network
    """Points that have a place, and the rows that take part."""
    settings: SolverSettings
    """Measurement model and loss."""
    values: Mapping[Unknown, Array]
    """Shared unknowns (d,), m and rad; those that are missing are zero."""
    places: Array
    """(n, 3) m, of the points."""

    def correction(self, image: str) -> OrientationCorrection:
        """Whole orientation correction of one image; zero for a held one that shares nothing."""
        number = next(j for j, one in enumerate(self.network.images) if one.name == image)
        return correction_of(known_images(self.network)[number], self.settings, self.values, definitions(self.network))

    def extended(self, additions: Sequence[Network]) -> "NetworkState":
        """The network state with planned measures: new unknowns at zero (orientation images where their neighbours make
        them likely), new points at their planned positions.
        """
        network = together([self.network, *additions])
        places = network.points.places.copy()
        places[: self.places.shape[0]] = self.places  # the points of the first part come first, in their order
        values = with_expected(self.values, definitions(network))
        return NetworkState(network, self.settings, values, places)


def together(networks: Sequence[Network]) -> Network:
    """Networks as one, in which passes have the orientation images that any of them has."""
    known = latest([definitions(one) for one in networks])
    return joined([with_definitions(one, known) for one in networks])


def correction_of(
    known: KnownImage, settings: SolverSettings, values: Mapping[Unknown, Array], passes: Definitions
) -> OrientationCorrection:
    """Whole orientation correction of an image at values of unknowns; those that are missing are zero."""
    one, image = with_definitions(alone(known), passes), Unknown("image", known.image.name)
    widths = [known.prior.sigmas.size, *(s.kind.width for s in one.shared), *(w for p in one.passes for w in p.widths)]
    there = [
        values.get(name, np.zeros(width)) if name != image or not known.held else np.zeros(width)
        for name, width in zip(unknowns(one), widths, strict=True)
    ]
    return whole_correction(one, 0, there, settings.angles)


def state_of_solution(solution: Solution) -> NetworkState:
    """Network state of a batch solution.

    Raises
    ------
    InputError
        For a solution without a covariance: one whose points have none.
    """
    require_covariance(solution)
    there = solution.determined
    values = {unknown: one.value for unknown, one in shared_of(solution).items()}
    return network_state(
        solution.network, solution.settings, values, np.where(there[:, None], solution.places, np.nan),
        solution.rays_used, solution.ranges_used,
    )  # fmt: skip


def network_state(
    network: Network, settings: SolverSettings, values: Mapping[Unknown, Array], places: Array, rays: Mask, ranges: Mask
) -> NetworkState:
    """Leave out of a network what takes no part.

    Parameters
    ----------
    values : mapping
        Shared unknowns, m and rad.
    places : (n, 3)
        m, of the points; NaN for undetermined ones.
    rays, ranges : (k,), (r,)
        False for those that were rejected.
    """
    with errors_from("plan"):
        require_separable(network)
    kept = np.flatnonzero(np.isfinite(places[:, 0]))
    if kept.size == 0:
        raise InputError("plan", "no point has a place", "an adjusted network", "solve it first")
    used = replace(network, rays=network.rays.chosen(rays), ranges=network.ranges.chosen(ranges))
    used = used.with_rejected(None, None)
    left = with_images(part(used, kept), known_images(network))
    return NetworkState(left, settings, values, places[kept])


class ReducedNetwork:
    """A network's points eliminated at given values: the information of the shared unknowns.

    Parameters
    ----------
    values : mapping
        Shared unknowns; those that are missing are zero.
    places : (n, 3)
        m, where the points are.
    """

    def __init__(
        self, network: Network, settings: SolverSettings, values: Mapping[Unknown, Array], places: Array
    ) -> None:
        self.network, self.names = network, unknowns(network)
        layout = lay_out(network, settings, places)
        self.values = np.zeros(layout.columns)
        for v in layout.variables.adjusted():
            if self.names[v] in values:
                self.values[layout.columns_of(v)] = values[self.names[v]]
        begin = places[layout.point_order]
        self.layout: Layout
        self.layout, begin = exactly(layout, self.values, begin)
        selection = everything(network)
        found = self._reduced(selection, begin)
        strong = without_weak(self.layout, found, selection)
        if not np.array_equal(strong.out, selection.out):
            selection, found = strong, self._reduced(strong, begin)
        self.rows: Rows = selection.rows(self.layout)
        self.reduction: Reduction = found

    def _reduced(self, selection: Selection, places: Array) -> Reduction:
        return BundleGraph(self.layout, selection.rows(self.layout)).reduction(self.values, points=places)

    @property
    def determined(self) -> Mask:
        """(n,) points that take part, network order."""
        return self.layout.network_order(determined_points(self.rows))

    def columns(self, names: Sequence[Unknown]) -> Index:
        """Columns of some unknowns, one after another."""
        number = {name: v for v, name in enumerate(self.names)}
        parts = [np.arange(*self.layout.columns_of(number[name]).indices(self.layout.columns)[:2]) for name in names]
        return np.concatenate([np.zeros(0, dtype=np.int64), *parts])

    @property
    def adjusted(self) -> list[Unknown]:
        """Unknowns that have columns, in their order."""
        return [self.names[v] for v in self.layout.variables.adjusted()]

    def information(self, names: Sequence[Unknown], priors: bool = False) -> Array:
        """Information matrix (d, d) of some unknowns, all others known, per m and rad; with or without their priors."""
        layout, number = self.layout, {name: v for v, name in enumerate(self.names)}
        wanted = [number[name] for name in names]
        first = dict(zip(wanted, np.cumsum([0, *(layout.variables.width[v] for v in wanted)]).tolist(), strict=False))
        size = int(sum(layout.variables.width[v] for v in wanted))
        matrix = np.zeros((size, size))
        assert self.reduction.blocks is not None
        for v, w, block in layout.blocks.each(self.reduction.blocks, layout.variables.width):
            if v in first and w in first:
                rows, across = slice(first[v], first[v] + block.shape[0]), slice(first[w], first[w] + block.shape[1])
                matrix[rows, across] += block
                if v != w:
                    matrix[across, rows] += block.T
        if priors:
            mine = self.columns(names)
            known = layout.prior.weights[mine] > 0.0
            matrix[np.diag_indices(size)] += np.where(known, 1.0 / layout.sigmas[mine] ** 2, 0.0)
            root = layout.prior.root[:, mine].toarray() if layout.prior.factors else np.zeros((0, size))
            matrix += root.T @ root
        return matrix


class CurrentState(ReducedNetwork):
    """A whole network linearised at its state, with the joint covariance of its shared unknowns; what is considered of
    them is carried in it.

    Raises WeakNetwork where nothing determines some direction of the orientation.
    """

    def __init__(self, state: NetworkState) -> None:
        super().__init__(state.network, state.settings, state.values, state.places)
        self.state = state
        require_strength(self.layout, self.reduction)
        graph, variables = BundleGraph(self.layout, self.rows), self.layout.variables
        self.joint = orientation_covariance(graph, self.reduction)
        self._held = self.joint
        if variables.with_considered:
            self._held = orientation_covariance(graph, self.reduction, consider=False)
        self.considered = [self.names[v] for v in variables.with_considered]
        self.index_of = {name: i for i, name in enumerate(state.network.points.ids)}

    def held_with(self, names: Sequence[Unknown]) -> Array:
        """Covariance (columns, d), m and rad, of all shared unknowns with some, one after another; considered ones are
        held, as the estimates have them.
        """
        number = {name: v for v, name in enumerate(self.names)}
        ones = np.array([number[name] for name in names], dtype=np.int64)
        return self._held.square_root.cross(ones, self._held.adjusted).T

    def carried(self, held: Array) -> Array:
        """(columns, c) root of what the considered unknowns add to the covariance, of `held_with` them."""
        columns = self.columns(self.considered)
        return carried(held, columns, self.layout.sigmas[columns])
