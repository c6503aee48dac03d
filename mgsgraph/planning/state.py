"""Network state from which a plan begins: the adjusted network, linearised at its solution, with its covariance."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.covariances import orientation_covariance
from mgsgraph.adjustment.datum import require_strength
from mgsgraph.adjustment.graph import BundleGraph, Layout, lay_out
from mgsgraph.adjustment.graph.forms import IN_PROCESS
from mgsgraph.adjustment.incremental.state import shared_of
from mgsgraph.adjustment.marginals import carried
from mgsgraph.adjustment.rounds import Selection, all_rows, determined_points, exactly, without_weak
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import require_covariance
from mgsgraph.errors import WeakNetwork, errors_from, require
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask, sigmas_of
from mgsgraph.kernel.rows import Rows
from mgsgraph.kernel.sweep import Reduction
from mgsgraph.names import numbered
from mgsgraph.network import Network
from mgsgraph.network.corrections import whole_correction
from mgsgraph.network.joining import Definitions, definitions, united, with_definitions
from mgsgraph.network.parts import (
    ByUnknown,
    KnownImage,
    Unknown,
    alone,
    joined,
    known_images,
    require_separable,
    select_points,
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
    values: ByUnknown
    """Shared unknowns (d,), m and rad; those that are missing are zero."""
    places: Array
    """(n, 3) m, of the points."""

    def correction(self, image: str) -> OrientationCorrection:
        """Whole orientation correction of one image; zero for a held one that shares nothing."""
        number = next(j for j, picture in enumerate(self.network.images) if picture.name == image)
        return correction_of(known_images(self.network)[number], self.settings, self.values, definitions(self.network))

    def extended(self, additions: Sequence[Network]) -> "NetworkState":
        """The network state with planned measures: new unknowns at zero, new points at their planned positions."""
        network = joined_networks([self.network, *additions])
        places = network.points.places.copy()
        places[: self.places.shape[0]] = self.places  # the points of the first part come first, in their order
        return NetworkState(network, self.settings, self.values, places)


def joined_networks(networks: Sequence[Network]) -> Network:
    """Networks as one, with the passes and shared unknowns of all of them."""
    shared = united([definitions(network) for network in networks])
    return joined([with_definitions(network, shared) for network in networks])


def correction_of(
    known: KnownImage, settings: SolverSettings, values: ByUnknown, passes: Definitions
) -> OrientationCorrection:
    """Whole orientation correction of an image at values of unknowns; those that are missing are zero."""
    net, image = with_definitions(alone(known), passes), Unknown("image", known.image.name)
    widths = [known.prior.sigmas.size, *(s.kind.width for s in net.shared), *(w for p in net.passes for w in p.widths)]
    parts = [
        values.get(name, np.zeros(width)) if name != image or not known.held else np.zeros(width)
        for name, width in zip(unknowns(net), widths, strict=True)
    ]
    return whole_correction(net, 0, parts, settings.angles)


def state_of_solution(solution: Solution | NetworkState) -> NetworkState:
    """Network state of a batch solution; a state is returned as it is.

    Raises
    ------
    InputError
        For a solution without a covariance: one whose points have none.
    """
    if isinstance(solution, NetworkState):
        return solution
    require_covariance(solution)
    determined = solution.determined
    values = {unknown: shared.value for unknown, shared in shared_of(solution).items()}
    return network_state(
        solution.network, solution.settings, values, np.where(determined[:, None], solution.places, np.nan),
        solution.rays_used, solution.ranges_used,
    )  # fmt: skip


def network_state(
    network: Network, settings: SolverSettings, values: ByUnknown, places: Array, rays: Mask, ranges: Mask
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
    network, placed = network.independent, np.flatnonzero(np.isfinite(places[:, 0]))
    require(placed.size != 0, "plan", "no point has a place", "an adjusted network", "solve it first")
    used = replace(network, rays=network.rays.chosen(rays), ranges=network.ranges.chosen(ranges))
    used = used.with_rejected(None, None)
    left = with_images(select_points(used, placed), known_images(network))
    return NetworkState(left, settings, values, places[placed])


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
        self, network: Network, settings: SolverSettings, values: ByUnknown, places: Array
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
        selection = all_rows(network)
        reduction = self._reduced(selection, begin)
        strong = without_weak(self.layout, reduction, selection)
        if not np.array_equal(strong.out, selection.out):
            selection, reduction = strong, self._reduced(strong, begin)
        self.rows: Rows = selection.rows(self.layout)
        self.reduction: Reduction = reduction

    def _reduced(self, selection: Selection, places: Array) -> Reduction:
        return BundleGraph(self.layout, selection.rows(self.layout)).reduction(self.values, points=places)

    @property
    def determined(self) -> Mask:
        """(n,) points that take part, network order."""
        return self.layout.network_order(determined_points(self.rows))

    def columns(self, names: Sequence[Unknown]) -> Index:
        """Columns of some unknowns, one after another."""
        number = numbered(self.names)
        return self.layout.variables.columns_of_all(number[name] for name in names)

    @property
    def adjusted(self) -> list[Unknown]:
        """Unknowns that have columns, in their order."""
        return [self.names[v] for v in self.layout.variables.adjusted()]

    def information(self, names: Sequence[Unknown], priors: bool = False) -> Array:
        """Information matrix (d, d) of some unknowns, all others known, per m and rad; with or without their priors."""
        layout, number = self.layout, numbered(self.names)
        numbers = [number[name] for name in names]
        first = dict(zip(numbers, np.cumsum([0, *(layout.variables.width[v] for v in numbers)]).tolist(), strict=False))
        size = int(sum(layout.variables.width[v] for v in numbers))
        matrix = np.zeros((size, size))
        assert self.reduction.blocks is not None
        for v, w, block in layout.blocks.each(self.reduction.blocks, layout.variables.width):
            if v in first and w in first:
                rows, across = slice(first[v], first[v] + block.shape[0]), slice(first[w], first[w] + block.shape[1])
                matrix[rows, across] += block
                if v != w:
                    matrix[across, rows] += block.T
        if priors:
            own_columns = self.columns(names)
            constrained = layout.prior.weights[own_columns] > 0.0
            matrix[np.diag_indices(size)] += np.where(constrained, 1.0 / layout.sigmas[own_columns] ** 2, 0.0)
            root = layout.prior.root[:, own_columns].toarray() if layout.prior.factors else np.zeros((0, size))
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
        self.index_of = numbered(state.network.points.ids)

    def held_with(self, names: Sequence[Unknown]) -> Array:
        """Covariance (columns, d), m and rad, of all shared unknowns with some, one after another; considered ones are
        held, as the estimates have them.
        """
        number = numbered(self.names)
        ones = np.array([number[name] for name in names], dtype=np.int64)
        return self._held.square_root.cross(ones, self._held.adjusted).T

    def carried(self, held: Array) -> Array:
        """(columns, c) root of what the considered unknowns add to the covariance, of `held_with` them."""
        columns = self.columns(self.considered)
        return carried(held, columns, self.layout.sigmas[columns])




@dataclass(frozen=True, slots=True, eq=False)
class AddedInformation:
    """Information that planned measures add to a network; the same for as long as its points that they touch are."""

    after: ReducedNetwork
    """The points that the measures touch, with all their rows, old and planned."""
    touched: tuple[Unknown, ...]
    """Unknowns of the present network that feel them."""
    new: tuple[Unknown, ...]
    """New unknowns that come with the measures."""
    root: Array
    """(d, d) L on the touched unknowns, per m and rad."""
    conditional: Array
    """(w, w) covariance of the new unknowns, were the touched ones known."""
    regression: Array
    """(w, d) regression of the new unknowns on the touched ones."""


@dataclass(frozen=True, slots=True, eq=False)
class Update:
    """Planned measures added to the present network."""

    present: CurrentState
    """The present network."""
    added: AddedInformation
    """Information that the measures add."""
    change: Array
    """(columns, d) M of S' = S + M diag(signs) M', on all present unknowns."""
    signs: Array
    """(d,) -1, and 1 for what considered unknowns add afterwards."""
    bits: float
    """Information gained on all present unknowns."""

    def bits_on(self, others: Sequence[Unknown]) -> float:
        """Information gained on the present unknowns without some others, which are marginalized."""
        if not others:
            return self.bits
        # det S of a part is det(information of the others) / det(information of all)
        before = self.present.information(others, priors=True)
        after, position = before.copy(), _positions(self.present, others, self.added.touched)
        inside = np.flatnonzero(position >= 0)
        added = self.added.root @ self.added.root.T
        after[np.ix_(position[inside], position[inside])] += added[np.ix_(inside, inside)]
        scale = 1.0 / sigmas_of(before)
        logs = [np.linalg.slogdet(matrix * scale[:, None] * scale)[1] for matrix in (before, after)]
        return self.bits - float(0.5 * (logs[1] - logs[0]) / np.log(2.0))

    def pairs(self) -> Array:
        """The joint covariance after, in the blocks of the present layout, flat."""
        blocks, layout = self.present.layout.blocks, self.present.layout
        flat, signed = blocks.filled(self.present.joint), self.change * self.signs
        for v, w, block in blocks.each(flat, layout.variables.width):
            block += signed[layout.columns_of(v)] @ self.change[layout.columns_of(w)].T
        return flat

    def joint_of(self, names: Sequence[Unknown]) -> Array:
        """(d, d) m and rad, joint covariance of some present unknowns."""
        present, columns = self.present, self.present.columns(names)
        number, change = [present.names.index(name) for name in names], self.change[columns]
        before = present.joint.of(number) if number else np.zeros((0, 0))
        return before + (change * self.signs) @ change.T

    def point_covariances(self) -> tuple[Array, Mask]:
        """(n, 3, 3) m^2 of the points touched, network order, and (n,) which of them have a place."""
        added, after = self.added, self.added.after
        layout, joint_covariance = after.layout, self.joint_of(added.touched)
        across = added.regression @ joint_covariance
        joint = np.block([[joint_covariance, across.T], [across, added.conditional + across @ added.regression.T]])
        order = np.argsort(after.columns([*added.touched, *added.new]))
        joint, flat = joint[np.ix_(order, order)], np.zeros(layout.blocks.target.size)
        for v, w, block in layout.blocks.each(flat, layout.variables.width):
            block[:] = joint[layout.columns_of(v), layout.columns_of(w)]
        covariances = IN_PROCESS.covariances(layout, after.rows, after.values, flat, after.reduction.points)
        return layout.network_order(covariances), after.determined


def added(present: CurrentState, additions: Sequence[Network]) -> AddedInformation:
    """What planned measures add to what is known.

    Parameters
    ----------
    present : CurrentState
        The network before the measures.
    additions : sequence of Network
        Measures of new points, with their planned places, and of points known already, by their ids; on images known
        already and new ones. At least one.

    Raises
    ------
    WeakNetwork
        When nothing determines a new unknown.
    PointBehindCamera
        At the present values of the unknowns.
    """
    state, index = present.state, present.index_of
    ids = dict.fromkeys(name for addition in additions for name in addition.points.ids)
    touched_points = np.array([index[name] for name in ids if name in index], dtype=np.int64)
    touched_points = np.unique(touched_points)
    before = select_points(state.network, touched_points) if touched_points.size else None
    network = with_definitions(joined_networks([*([before] if before else []), *additions]), definitions(state.network))
    places = network.points.places.copy()
    places[: touched_points.size] = state.places[touched_points]
    after = ReducedNetwork(network, state.settings, state.values, places)
    present_names = set(present.adjusted)
    touched = tuple(name for name in after.adjusted if name in present_names)
    new = tuple(name for name in after.adjusted if name not in present_names)
    whole = after.information([*touched, *new]) + _of_priors(after, [*touched, *new], new)
    if before is not None:
        old = ReducedNetwork(before, state.settings, state.values, state.places[touched_points])
        before_too = [name for name in touched if name in set(old.adjusted)]
        columns = _positions(after, touched, before_too)
        whole[np.ix_(columns, columns)] -= old.information(before_too)
    gained, own, regression = _on_touched(whole, after, touched, new)
    root = _root(gained, present.layout.scales[present.columns(touched)])
    return AddedInformation(after, touched, new, root, own, regression)


def updated(present: CurrentState, adds: AddedInformation) -> Update:
    """What added information does to the joint covariance of the present network."""
    touched, root = adds.touched, adds.root
    spread = present.held_with(touched) @ root if touched else np.zeros((present.layout.columns, 0))
    inner = np.eye(root.shape[1]) + root.T @ spread[present.columns(touched)]
    factor = np.linalg.cholesky(0.5 * (inner + inner.T))
    downdate = np.linalg.solve(factor, spread.T).T
    change, signs = downdate, -np.ones(downdate.shape[1])
    if present.considered:
        held = present.held_with(present.considered)
        before = present.carried(held)
        after = present.carried(held - downdate @ downdate[present.columns(present.considered)].T)
        change = np.hstack([downdate, before, after])
        signs = np.concatenate([signs, -np.ones(before.shape[1]), np.ones(after.shape[1])])
    return Update(present, adds, change, signs, float(np.sum(np.log2(np.diagonal(factor)))))


def _positions(network: ReducedNetwork, among: Sequence[Unknown], some: Sequence[Unknown]) -> Index:
    """(d,) positions of the columns of some unknowns among the columns of others; -1 for none."""
    number = numbered(network.columns(among).tolist())
    return np.array([number.get(column, -1) for column in network.columns(some).tolist()], dtype=np.int64)


def _of_priors(after: ReducedNetwork, names: Sequence[Unknown], new: Sequence[Unknown]) -> Array:
    """(d, d) inverse a-priori covariance of new ones among unknowns."""
    weights, positions = np.zeros(after.columns(names).size), _positions(after, names, new)
    weights[positions] = 1.0 / after.layout.sigmas[after.columns(new)] ** 2
    return np.diag(weights)


def _on_touched(
    whole: Array, after: ReducedNetwork, touched: Sequence[Unknown], new: Sequence[Unknown]
) -> tuple[Array, Array, Array]:
    """Information (d, d) on the touched unknowns with the new ones eliminated, the covariance (w, w) of these were the
    touched ones known, and how they follow them (w, d); `whole` is that on all of them.
    """
    d = after.columns(touched).size
    columns = after.columns(new)
    own = whole[d:, d:]
    scales = after.layout.scales[columns]
    try:
        factor = np.linalg.cholesky(own * scales[:, None] * scales)
    except np.linalg.LinAlgError:
        raise WeakNetwork([f"the orientation of {name}" for name in new[:2]], len(new)) from None
    half = np.linalg.solve(factor, np.diag(scales))
    covariance = half.T @ half
    regression = -covariance @ whole[d:, :d]
    across = half @ whole[d:, :d]
    return whole[:d, :d] - across.T @ across, covariance, regression


def _root(information: Array, scales: Array) -> Array:
    """L with L L' = the information (d, d), which rounding may have left slightly indefinite; per m and rad."""
    scaled = information * scales[:, None] * scales
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)) / scales[:, None])
