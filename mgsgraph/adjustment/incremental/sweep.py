"""One bundle laid out for the kernel: its points solved and eliminated, placed, and their covariances."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.covariances import point_covariances as joint_point_covariances
from mgsgraph.adjustment.graph import Layout, lay_out
from mgsgraph.adjustment.graph.patterns import group_blocks
from mgsgraph.adjustment.graph.stereo import heights_at, linear_rows
from mgsgraph.adjustment.incremental.state import Bundle, Bundles, ReducedSystem, stretches
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.rounds import (
    NEAR,
    NEAR_ENOUGH,
    Selection,
    about_predicted_lines,
    determined_points,
    unmarked,
    without_weak,
)
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.orientation import SUPPORT, OrientationImages
from mgsgraph.geometry.records import Array, Index, joined_rows
from mgsgraph.kernel.sweep import COSTS, SYSTEM, Reduction, dense, point_covariances, reduce, sparse
from mgsgraph.names import Names
from mgsgraph.network import Network, NodePrior, Pass
from mgsgraph.network.parts import ByUnknown, Members, Unknown, unknowns

TOLERANCE = 2e-3
"""Posterior sigmas of an unknown's linearisation error: small beside `impact.CLOSE`, since the errors of bundles
add up."""
_ROBUST_SHARE = 0.01
"""Sigmas of an image coordinate by which it may move before the weights of a robust loss are recomputed."""
_STEP = 10.0
"""m, within which a stereo surface's slope and curvature are taken."""
_MOST_ROUNDS = 20
"""Relinearizations of the rows of stereo surfaces for the same unknowns."""
_NOTHING = NodePrior(np.full(6, np.inf), np.zeros(6), np.zeros(6))
"""Prior of orientation images without a-priori sigmas."""


def slack(network: Network, settings: SolverSettings, motion: Array, spread: Array, relief: Array) -> float:
    """Pixels by which image places of a bundle may move before it is relinearized.

    The orientation enters the collinearity equations by sines of small angles: a move of p pixels, of w radians each,
    leaves p (p w) pixels that the linear system doesn't know. And it moves points along their rays: one whose place has
    the sigma d by its rows alone, by p d / s of them at the distance r, which changes its rows by p (p d / s) / r. If
    all rows of sigma s lie wrong the same way, the unknowns do by the root of the sum of these squares over s, of their
    sigmas at most, which shall be no more than TOLERANCE.

    Parameters
    ----------
    motion : (2,)
        Pixels per m and per rad, of the image that has most of them.
    spread : (n,)
        m^2, variance of each point's place in all directions by its rows alone; NaN for those that take no part.
    relief : (k, 2)
        Of each point on a stereo surface, in sigmas of its height: slope that its row doesn't know, per m, and
        curvature, per m^2.
    """
    distance, squares, least = motion[1] / motion[0], 0.0, math.inf
    if network.rays.point.size:
        least = float(network.rays.sigmas.min())
        by_distance = np.nan_to_num(spread)[network.rays.point] / (least * distance) ** 2
        squares += float(np.maximum(by_distance, motion[1] ** -2).sum()) / least**2
    # a range at r turns with the camera: by x across it, it grows by x^2 / 2r
    squares += float(np.sum((0.5 / (motion[0] ** 2 * distance * network.ranges.sigmas)) ** 2))
    # on a stereo surface a point comes to another height
    unknown, curved = np.sum((relief * [1.0 / motion[0], 0.5 / motion[0] ** 2]) ** 2, axis=0).tolist()
    squares += curved
    if squares == 0.0:
        return math.inf
    allowed = math.sqrt(TOLERANCE / math.sqrt(squares))
    allowed = min(allowed, TOLERANCE / math.sqrt(unknown)) if unknown else allowed
    return allowed if settings.loss == "none" else min(allowed, _ROBUST_SHARE * least)


def about(network: Network) -> Network:
    """A network with the orientation images alone that its rays and ranges are about, and one more on either side,
    without priors: the eliminated system of its points holds none.
    """
    if not network.passes:
        return network
    near = (replace(pass_, nodes=_near(network, pass_), prior=_NOTHING, whole=False) for pass_ in network.passes)
    return replace(network, passes=tuple(near))


def _near(network: Network, pass_: Pass) -> OrientationImages:
    """The nodes of a pass near the rays and ranges of a network."""
    indices = list[Index]()
    if network.stereo is not None or len(pass_.nodes) <= SUPPORT:
        return pass_.nodes
    for j in pass_.images.tolist():
        image, epoch = network.images[j], network.images[j].trajectory.epoch
        times, _ = image.timing.at(network.rays.places[network.rays.image == j, 0])
        indices.append(pass_.nodes.first_of_four(times, epoch))
        indices.append(pass_.nodes.first_of_four(network.ranges.times[network.ranges.image == j], 0.0))
    nodes = np.concatenate(indices)
    if nodes.size == 0:
        return pass_.nodes
    first, last = max(int(nodes.min()) - 1, 0), int(nodes.max()) + SUPPORT + 1
    return replace(pass_.nodes, times=pass_.nodes.times[first:last])


class _Joint(NamedTuple):
    """Joint covariance of some unknowns."""

    covariance: Array
    """(d, d) m and rad, joint covariance."""
    place: Mapping[Unknown, slice]
    """Where each of them lies in it."""


class Sweep:
    """A bundle as the kernel takes it.

    Parameters
    ----------
    network : Network
        Points that feel the same shared unknowns; for `reduce` and `places`, any.
    places : (n, 3), optional
        m, where its points are thought to be; NaN where nothing is known.

    Raises
    ------
    InputError
        When a point lies on a ray that misses the body.
    """

    def __init__(self, network: Network, settings: SolverSettings, places: Array | None = None) -> None:
        self.network, self._settings = network, settings
        self._seen = about(network)
        self._names = unknowns(self._seen)
        layout = lay_out(self._seen, settings, places).convex  # new images begin at their nominal orientation
        self._select(layout, unmarked(network))
        self._last: Reduction | None = None
        self._spread: Array | None = None
        self._relief: Array | None = None

    def reduce(self, values: ByUnknown, task: int = SYSTEM) -> Reduction:
        """All points solved and eliminated at values of the unknowns, without undetermined points.

        Raises PointBehindCamera.
        """
        shared, last = self._vector(values), self._last
        near = NEAR_ENOUGH if task == COSTS else NEAR
        if last is not None and last.serves(shared, task):
            return last
        reduction = self._reduced(shared, task, None if last is None else last.points)
        strong = without_weak(self._layout, reduction, self._selection)
        if not np.array_equal(strong.out, self._selection.out):
            self._select(self._layout, strong)
            reduction = self._reduced(shared, task, reduction.points)
        layout = self._layout.without_steps
        for _ in range(1 if layout.stereo is None else _MOST_ROUNDS):
            exact = about_predicted_lines(layout, shared, reduction.points, near, in_place=True)
            if exact is layout:
                break
            same = exact.patterns is layout.patterns
            begin = reduction.points if same else layout.network_order(reduction.points)[exact.point_order]
            layout, self._last = exact, None  # its points may be in another order
            self._select(exact, self._selection)
            reduction = self._reduced(shared, task, begin)
        self._last = reduction
        return reduction

    def system(self, values: ByUnknown, motion: Array) -> ReducedSystem | None:
        """The reduced system; None without adjusted unknowns or determined points. `motion` as in `slack`."""
        reduction, layout = self.reduce(values), self._layout
        if layout.columns == 0 or not np.any(determined_points(self._rows)):
            return None
        names, at, normal, gradient = self._joined(reduction)
        if self._spread is None or self._relief is None:  # hardly change where the points are as near as this
            self._spread = self._free_variances(reduction)
            self._relief = self._stereo_relief(reduction)
        allowed = slack(self.network, self._settings, motion, self._spread, self._relief)
        return ReducedSystem(names, at, normal, gradient, reduction.cost, allowed)

    def of_bundles(
        self, values: ByUnknown, joint: JointCovariance, bundles: Mapping[Members, Network],
        motion: Callable[[Members, Network], Array],
    ) -> dict[Members, Bundle]:  # fmt: skip
        """All bundles of the network, each with its reduced system and its points, by one pass over all points.

        Parameters
        ----------
        joint : JointCovariance
            Of all unknowns of the network, in the order of its variables.
        bundles : mapping
            The network by bundle; without passes and stereo surfaces, for whose points groups of the layout are others.
        motion : function
            As in `slack`, of each bundle.
        """
        reduction, layout = self.reduce(values), self._layout
        places, free = self._ordered(reduction.points), self._free_variances(reduction)
        covariances = self._ordered(
            joint_point_covariances(layout, self._rows, reduction.orientation, reduction.points, joint)
        )
        piece_group, group = self._rows.pattern_group[self._rows.piece[:, 0]], self._group_of_points()
        costs = np.bincount(piece_group, reduction.piece_cost, len(layout.group_variables))
        adopted = dict[Members, Bundle]()
        for members, (network, inside) in zip(bundles, _with_points(bundles, self.network), strict=True):
            (number,) = np.unique(group[inside]).tolist()
            system: ReducedSystem | None = None
            if members and np.any(np.isfinite(places[inside, 0])):
                names, at, normal, gradient = self._of_group(reduction, number)
                allowed = slack(network, self._settings, motion(members, network), free[inside], np.zeros((0, 2)))
                system = ReducedSystem(names, at, normal, gradient, float(costs[number]), allowed)
            adopted[members] = Bundle(network, system, places[inside], covariances[inside])
        return adopted

    def _of_group(self, reduction: Reduction, group: int) -> tuple[Members, Array, Array, Array]:
        """Unknowns of the points of a group, values (d,), normal matrix (d, d) and gradient (d,)."""
        layout, felt = self._layout, self._layout.group_variables[group]
        at = np.concatenate([reduction.orientation[layout.columns_of(v)] for v in felt])
        return tuple(self._names[v] for v in felt), at, *dense(reduction, layout.groups, self._blocks, group)

    def _joined(self, reduction: Reduction) -> tuple[Members, Array, Array, Array]:
        """Unknowns of all points, values (d,), normal matrix (d, d) and gradient (d,): one set of unknowns, or several
        where rays depend on other orientation images than before.
        """
        layout = self._layout
        felt = sorted({v for group in layout.group_variables for v in group})
        first = dict(zip(felt, np.cumsum([0, *(layout.variables.width[v] for v in felt)]).tolist(), strict=False))
        at = np.concatenate([reduction.orientation[layout.columns_of(v)] for v in felt])
        normal, gradient = np.zeros((at.size, at.size)), np.zeros(at.size)
        for group, members in enumerate(layout.group_variables):
            columns = joined_rows(np.arange(first[v], first[v] + layout.variables.width[v]) for v in members)
            block, right = dense(reduction, layout.groups, self._blocks, group)
            normal[np.ix_(columns, columns)] += block
            gradient[columns] += right
        return tuple(self._names[v] for v in felt), at, normal, gradient

    def placed(
        self, values: ByUnknown, system: ReducedSystem | None, joint: Array | None,
    ) -> Bundle:  # fmt: skip
        """The bundle with its points where the unknowns put them; `joint` is the covariance (d, d) of those of the
        system, in their order; absent where it has none.
        """
        reduction = self.reduce(values, COSTS)
        of_system = None if joint is None or system is None else _Joint(joint, stretches(system.unknowns, values))
        covariances = self._covariances(reduction, [of_system] * len(self._layout.group_variables))
        return Bundle(self.network, system, self._ordered(reduction.points), covariances)

    def placed_bundles(
        self, values: ByUnknown, bundles: Bundles,
        systems: Mapping[Members, ReducedSystem], joint: Mapping[Members, Array],
    ) -> dict[Members, Bundle]:  # fmt: skip
        """All bundles of the network with their points where the unknowns put them, by one pass over all points;
        `joint` are the covariances (d, d) of the unknowns of each system. Networks as of `of_bundles`.
        """
        reduction, groups = self.reduce(values, COSTS), self._group_of_points()
        of_groups: list[_Joint | None] = [None] * len(self._layout.group_variables)
        numbered = list(_with_points({members: bundle.network for members, bundle in bundles.items()}, self.network))
        for members, (_, inside) in zip(bundles, numbered, strict=True):
            (number,) = np.unique(groups[inside]).tolist()
            if members in joint:
                of_groups[number] = _Joint(joint[members], stretches(systems[members].unknowns, values))
        places, covariances = self._ordered(reduction.points), self._covariances(reduction, of_groups)
        return {
            members: Bundle(network, systems.get(members), places[inside], covariances[inside])
            for members, (network, inside) in zip(bundles, numbered, strict=True)
        }

    def _group_of_points(self) -> Index:
        """(n,) group of the layout to which each point belongs, network order."""
        piece_group = self._rows.pattern_group[self._rows.piece[:, 0]]
        return self._layout.network_order(np.repeat(piece_group, self._rows.piece[:, 2]))

    def _covariances(self, reduction: Reduction, joint: "Sequence[_Joint | None]") -> Array:
        """(n, 3, 3) m^2 of the points, NaN for undetermined ones, from the joint covariance of the unknowns that each
        group of points feels; of a group without one as if they were known.
        """
        layout, target = self._layout, self._blocks
        blocks = np.zeros(target.size)
        for group, (members, covariance) in enumerate(zip(layout.group_variables, joint, strict=True)):
            if covariance is not None:
                blocks += sparse(self._joint_of(members, covariance), layout.groups, target, group)
        return self._ordered(
            point_covariances(
                self._rows, layout.groups, target, layout.model, reduction.orientation, blocks, reduction.points
            )
        )

    def _free_variances(self, reduction: Reduction) -> Array:
        """(n,) m^2, variance of each point in all directions as if all unknowns were known."""
        held = [None] * len(self._layout.group_variables)
        return np.asarray(np.trace(self._covariances(reduction, held), axis1=1, axis2=2))

    def _joint_of(self, members: Sequence[int], covariance: "_Joint") -> Array:
        """Covariance (d, d) of some variables, taken from that of unknowns; zero for an orientation image that is not
        among these: a ray has just moved next to it, and it has no weight there yet.
        """
        joint, place = covariance
        numbers = np.arange(joint.shape[0])
        columns = joined_rows(
            numbers[place[name]] if (name := self._names[v]) in place else np.full(self._layout.variables.width[v], -1)
            for v in members
        )
        present = np.flatnonzero(columns >= 0)
        block = np.zeros((columns.size, columns.size))
        block[np.ix_(present, present)] = joint[np.ix_(columns[present], columns[present])]
        return block

    def _stereo_relief(self, reduction: Reduction) -> Array:
        """(k, 2) for `slack`: difference of heights from those that the linear rows predict a step away, where these
        take the ground for level; and change of the normals.
        """
        layout, rows, control = self._layout, self._layout.stereo, self.network.stereo
        if rows is None or control is None:
            return np.zeros((0, 2))
        points, squares = layout.network_order(reduction.points), np.zeros((rows.points.size, 2))
        level = np.zeros(rows.points.size) if control.level is None else control.level[rows.points]
        for axis in range(2):
            ahead = points + _STEP * east_north(points)[:, axis]
            rows_ahead = linear_rows(self._seen, layout.model, layout.variables, reduction.orientation, ahead, rows)
            assert rows_ahead is not None
            before, after = (
                heights_at(linear, self._seen, layout.variables, reduction.orientation, rows_ahead.reference)
                for linear in (rows, rows_ahead)
            )
            turned = np.sum((rows_ahead.normals - rows.normals) ** 2, axis=1)
            squares += np.stack([level * (after - before) ** 2, turned], axis=1)
        return np.sqrt(squares) / (_STEP * control.sigmas[rows.points])[:, None]

    def places(self, values: ByUnknown) -> Array:
        """(n, 3) m, positions of the points at these unknowns; NaN for undetermined ones."""
        return self._ordered(self.reduce(values, COSTS).points)

    def _select(self, layout: Layout, selection: Selection) -> None:
        """Which points take part."""
        self._layout, self._selection, self._rows = layout, selection, selection.rows(layout)
        self._blocks = group_blocks(layout.groups)

    def _reduced(self, shared: Array, task: int, begin: Array | None) -> Reduction:
        layout = self._layout
        return reduce(self._rows, layout.groups, self._blocks, layout.model, shared, task, begin)

    def _vector(self, values: ByUnknown) -> Array:
        vector, layout = np.zeros(self._layout.columns), self._layout
        for v in layout.variables.adjusted():
            if self._names[v] in values:  # nodes that no ray is about may have gone
                vector[layout.columns_of(v)] = values[self._names[v]]
        return vector

    def _ordered(self, values: Array) -> Array:
        ordered = self._layout.network_order(values)
        ordered[~self._layout.network_order(determined_points(self._rows))] = np.nan
        return ordered


def _with_points(bundles: Mapping[Members, Network], network: Network) -> Iterator[tuple[Network, Index]]:
    """Networks of bundles, each with the numbers of its points in the whole network."""
    ids = Names.concatenated([network_of_bundle.points.ids for network_of_bundle in bundles.values()])
    numbers = network.points.ids.find(ids)
    ends = np.cumsum([len(network_of_bundle.points) for network_of_bundle in bundles.values()])
    return zip(bundles.values(), np.split(numbers, ends[:-1]), strict=True)
