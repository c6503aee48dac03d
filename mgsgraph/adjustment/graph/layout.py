"""The network laid out for the kernel: points sorted by pattern, their rows, and the inverse order."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.graph.patterns import PairBlocks, Patterns, Terms, make_groups, pair_blocks, sort_points
from mgsgraph.adjustment.graph.rays import RayConstants
from mgsgraph.adjustment.graph.rows import ObservationRows, Storage, lay_out_rows, with_stereo
from mgsgraph.adjustment.graph.stereo import StereoRows, accelerated, linear_rows, same_heights
from mgsgraph.adjustment.graph.variables import (
    ANGLE_CODES,
    Prior,
    Variables,
    angles_of,
    make_prior,
    make_variables,
)
from mgsgraph.adjustment.settings import LOSS_WIDTHS, Loss, SolverSettings
from mgsgraph.adjustment.sparse_cholesky import SparseCholesky
from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation import Angles
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.kernel.rows import (
    CAUCHY,
    HUBER,
    MEASURED,
    NO_LOSS,
    OUT,
    PREDICTED,
    TUKEY,
    Groups,
    Model,
    Rows,
)
from mgsgraph.network import Network
from mgsgraph.network.effects import bends

_Kind = TypeVar("_Kind", np.float64, np.bool_, np.int8, np.int64)
_LINES = {"predicted": PREDICTED, "measured": MEASURED}
_LOSSES = {"none": NO_LOSS, "huber": HUBER, "cauchy": CAUCHY, "tukey": TUKEY}


@dataclass(frozen=True, eq=False)
class Layout:
    """Rows of a network in the kernel's order, and the inverse order."""

    network: Network
    """The network that is adjusted."""
    model: Model
    """Forms of the measurement model."""
    rows: Rows
    """All rows, at full weight."""
    groups: Groups
    """Points by set of orientation variables."""
    blocks: PairBlocks
    """The reduced normal matrix."""
    variables: Variables
    """Shared unknowns."""
    prior: Prior
    """Their priors."""
    prior_information: Array
    """Its normal matrix on the unknowns of passes, flat in `blocks`; empty without passes."""
    patterns: Patterns
    """Points by pattern."""
    observation_rows: ObservationRows
    """Network rows among all observations."""
    lines: Array
    """(k,) line about which each network ray is laid out."""
    stereo: StereoRows | None
    """Heights above stereo surfaces, linear about a state; None without any."""
    bent: Array
    """(columns,) shared unknowns with which the slopes of detector lines are those of adjusted interior orientations;
    of the others it says nothing."""
    rays: RayConstants
    """Constants of image rays, which can be renewed."""
    storage: Storage
    """Storage of these constants."""

    @cached_property
    def cholesky(self) -> SparseCholesky:
        """Elimination of the reduced normal equations; the same for layouts made of this one."""
        pairs = np.stack([self.blocks.first, self.blocks.second], axis=1)
        return SparseCholesky(self.variables.first, self.variables.width, pairs, self.blocks.offset)

    @cached_property
    def bending(self) -> Index:
        """Columns of unknowns that change the slopes of detector lines, or the rates of attitudes as vibrations do."""
        network = self.network
        variables = [
            network.first_shared + k
            for k, unknown in enumerate(network.shared)
            if unknown.sine is not None or any(bends(network, k, j) for j in unknown.images.tolist())
        ]
        return self.variables.columns_of_all(variables)

    @property
    def angles(self) -> Angles:
        """How attitude is counted."""
        return angles_of(self.model)

    @property
    def columns(self) -> int:
        """Number of shared unknowns."""
        return int(self.variables.sigmas.size)

    @property
    def sigmas(self) -> Array:
        """(columns,) a-priori sigmas, m and rad, each by itself; infinite where nothing is known."""
        return self.variables.sigmas

    @property
    def scales(self) -> Array:
        """(columns,) units in which the shared unknowns are of order one: a-priori sigmas, else 1 km and 10 mrad."""
        plain = np.where(self.variables.angular, 1e-2, 1e3)
        return np.where(np.isinf(self.sigmas), plain, self.sigmas)

    @property
    def group_variables(self) -> tuple[tuple[int, ...], ...]:
        """Variables of each group, in the order of their columns within it."""
        return self.patterns.group_variables

    @property
    def point_order(self) -> Index:
        """(n,) network point at each index of the layout."""
        return self.patterns.point_order

    def network_order(self, values: NDArray[_Kind]) -> NDArray[_Kind]:
        """Values (n, ...) in the layout's order, back in the network's."""
        return values[self.patterns.point_index]

    def columns_of(self, variable: int) -> slice:
        """Columns of one variable."""
        return self.variables.columns_of(variable)

    def about_stereo(self, points: Array, shared: Array) -> "Layout":
        """The same with heights above stereo surfaces that are linear about points (n, 3), network order, and shared
        unknowns (columns,); itself when they are the same.
        """
        linear = linear_rows(self.network, self.model, self.variables, shared, points, self.stereo)
        if self.stereo is None or linear is None:
            return self
        if same_heights(self.stereo, linear, self.network, self.variables, shared):
            return self
        places = points.copy()
        about, places[linear.points], steps = accelerated(
            self.stereo, self.network, self.variables, shared, points[linear.points]
        )
        linear = linear_rows(self.network, self.model, self.variables, about, places, self.stereo)
        assert linear is not None
        linear = linear._replace(steps=steps)
        if not np.array_equal(linear.sides, self.stereo.sides):
            return replace(self, stereo=linear)._sorted_again(self.lines, self.bent)
        return self._with(stereo=linear, rows=with_stereo(self.network, self.patterns, self.rows, linear, self.storage))

    def with_loss(self, loss: Loss, width: float | None = None) -> "Layout":
        """The same with another loss, at its customary width where none is given."""
        return self._with(model=self.model._replace(loss=_LOSSES[loss], width=width or LOSS_WIDTHS[loss]))

    @property
    def convex(self) -> "Layout":
        """The same with a loss that has one minimum: Huber's in the place of Tukey's."""
        return self.with_loss("huber") if self.model.loss == TUKEY else self

    @property
    def without_steps(self) -> "Layout":
        """The same, its stereo rows as at the start of an optimization: without earlier steps."""
        if self.stereo is None or not self.stereo.steps:
            return self
        return self._with(stereo=self.stereo._replace(steps=()))

    def about(self, lines: Array, shared: Array | None = None, in_place: bool = False) -> "Layout":
        """The same network, points in and out, start positions and stereo rows, with rays laid out about other lines
        (k,), and slopes of detector lines about other shared unknowns (columns,). `in_place`: overwrite the rows of
        this layout, which the caller does not use again.
        """
        bending = self.bent if shared is None else shared
        terms = Terms(self.network, self.variables, lines)
        if self.model.line != PREDICTED or not self.rays.renewable(terms):
            return self._sorted_again(lines, bending)
        rows = self.rows if in_place else self.rows._replace(data=self.storage.copied(self.rows.data))
        self.rays.renew(rows.data, terms, bending)
        return self._with(rows=rows, lines=lines, bent=bending)

    def _sorted_again(self, lines: Array, bending: Array) -> "Layout":
        """The same about other lines, where rays come to depend on other nodes: they have other patterns."""
        like = self.network_order(self.rows.start), self.network_order(self.rows.kind)
        return _lay_out(self.network, self.model, self.variables, None, lines, like, self.stereo, bending, self.storage)

    def _with(self, **changes: Any) -> "Layout":
        """The same with other rows of the same observations; the order of elimination stays."""
        layout = replace(self, **changes)
        if "cholesky" in self.__dict__:
            layout.__dict__["cholesky"] = self.cholesky
        return layout

    def active(self, rays: Mask, ranges: Mask, out: Mask, stereo: Mask | None = None) -> Rows:
        """Rows with some left out: rays (k,), ranges (r,) that take part, points (n,) that don't, points (n,) whose
        heights above stereo surfaces do (all when absent); network order.
        """
        kind, weight = self.rows.kind, self.rows.weight
        if np.any(out[self.point_order] & (kind != OUT)):
            kind = np.where(out[self.point_order], OUT, kind).astype(kind.dtype)
        off = self.observation_rows.stereo[:0]
        if self.stereo is not None and stereo is not None:
            off = self.observation_rows.stereo[~stereo[self.stereo.points]]
        if off.size or not (np.all(rays) and np.all(ranges)):
            weight = weight.copy()
            weight[:, off] = 0.0
            weight[:, self.observation_rows.rays[~rays]] = 0.0
            weight[:, self.observation_rows.ranges[~ranges]] = 0.0
        return self.rows._replace(kind=kind, weight=weight)


def lay_out(network: Network, settings: SolverSettings, places: Array | None = None) -> Layout:
    """Lay a network out for the kernel.

    Parameters
    ----------
    network : Network
    settings : SolverSettings
    places : (n, 3), optional
        m, where its points are thought to be: there the inner solves begin. Where it is NaN, or absent, they begin at
        the a-priori position or at the intersection of the nominal rays. Not used in the papers' form, in which the
        positions where points begin are part of the model (image motion per line), and must be the nominal ones.

    Raises
    ------
    InputError
        When a point that nothing else places lies on a ray that misses the body; for cameras mounted against the axes
        of their pass where angles are not about the camera's axes.
    """
    if settings.angles != "camera" and any(pass_.axes is not None for pass_ in network.passes):
        raise InputError("solver, angles", f"{settings.angles!r} for cameras mounted against each other", "'camera'")
    model = Model(_LINES[settings.line], ANGLE_CODES[settings.angles], _LOSSES[settings.loss], settings.width)
    variables, points = make_variables(network), network.points.places
    for given in (network.stereo.starts if network.stereo else None, places):
        points = points if given is None else np.where(np.isfinite(given), given, points)
    stereo = linear_rows(network, model, variables, np.zeros(variables.sigmas.size), points)
    given = None if model.line == MEASURED else places
    bending = np.zeros(variables.sigmas.size)
    storage = Storage.within(settings.memory_gb)
    lines = network.rays.places[:, 0]
    lines = lines if model.line == MEASURED else lines.copy()
    return _lay_out(network, model, variables, given, lines, None, stereo, bending, storage)


def _lay_out(
    network: Network,
    model: Model,
    variables: Variables,
    places: Array | None,
    lines: Array,
    like: tuple[Array, NDArray[np.int8]] | None,
    stereo: StereoRows | None,
    bending: Array,
    storage: Storage,
) -> Layout:
    """The same with rays laid out about lines (k,), slopes of detector lines about shared unknowns (columns,); `like`
    are starting positions and kinds to keep, network order.
    """
    terms = Terms(network, variables, lines)
    patterns, slot = sort_points(network, terms, stereo)
    laid = lay_out_rows(network, model, variables, patterns, slot, terms, places, like, stereo, bending, storage)
    observations, rows, rays = laid
    groups = make_groups(variables, patterns.group_first, patterns.group_member)
    prior = make_prior(network, variables)
    blocks = pair_blocks(variables, groups, prior.pairs)
    information = _information(prior, blocks)
    return Layout(
        network, model, rows, groups, blocks, variables, prior, information, patterns, observations, lines, stereo,
        bending, rays, storage,
    )  # fmt: skip


def _information(prior: Prior, blocks: PairBlocks) -> Array:
    """The normal matrix of a prior's factors, flat in the blocks of the reduced one; empty where there are none."""
    if not prior.factors:
        return np.zeros(0)
    pairs = zip(blocks.first.tolist(), blocks.second.tolist(), strict=True)
    place, flat = dict(zip(pairs, blocks.offset.tolist(), strict=True)), np.zeros(blocks.target.size)
    for variables, factors, _, _ in prior.factors:
        for k, v in enumerate(variables):
            for w, factor in zip(variables[k:], factors[k:], strict=True):
                product = factors[k].T @ factor
                flat[place[v, w] : place[v, w] + product.size] += product.ravel()
    return flat
