"""The two steps of Spiegel et al. (LPSC 2006): first the rays alone, then their points on the terrain model.

Step 1 makes the block consistent in itself and finds the blunders of matching. Step 2 adds one row for each point over
the terrain model, without the rows that step 1 rejected, and fits the whole block to the model. It also judges points
far off the model: blunders that step 1 could not see (all rays agree on a wrong place), or ground that differs from the
model. Their rays stay, their height rows are removed.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.blunders import MEDIAN, squared_unit
from mgsgraph.adjustment.cluster.connection import Connection
from mgsgraph.adjustment.covariances import point_covariances, prior_covariance
from mgsgraph.adjustment.graph import BundleGraph, Layout, lay_out
from mgsgraph.adjustment.graph.forms import IN_PROCESS
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.optimize import Iteration
from mgsgraph.adjustment.rounds import Progress, Selection, all_rows, determined_points, relinearized
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.kernel.sweep import COSTS
from mgsgraph.network import TERRAIN, Network
from mgsgraph.record import Record
from mgsgraph.workers import no_progress


class RaysAlone:
    """Forward intersection in a network without a terrain model (what is known of points beforehand counts, too).

    Parameters
    ----------
    network : Network
        Without a surface.
    selection : Selection
        Rays and ranges that take part.
    """

    def __init__(self, network: Network, settings: SolverSettings, selection: Selection) -> None:
        self._layout, self._selection = lay_out(network, settings), selection

    @cached_property
    def joint(self) -> JointCovariance | None:
        """A-priori covariance of the shared unknowns; None where some have no prior."""
        return prior_covariance(self._layout)

    def nominal(self) -> tuple[Array, Array]:
        """Positions (n, 3) in m with the nominal orientation, NaN for points that nothing determines, and covariances
        (n, 3, 3) in m^2 with the a-priori one, for sigma0 = 1; NaN there, and all where there is none.
        """
        orientation = np.zeros(self._layout.columns)
        layout, points = self._placed(orientation)
        if self.joint is None:
            covariances = np.full((*points.shape, 3), np.nan)
        else:
            covariances = point_covariances(layout, self._selection.rows(layout), orientation, points, self.joint)
        return self._whole(layout, points), self._whole(layout, covariances)

    def at(self, values: Sequence[Array]) -> tuple[Array, Array]:
        """Positions (n, 3), m, at given values of the shared unknowns, numbered as `Network` has them, and covariances
        (n, 3, 3) in m^2 as if these were true: of the rays' noise alone.
        """
        orientation = self._layout.variables.joined(values)
        layout, points = self._placed(orientation)
        zero, rows = np.zeros(layout.blocks.target.size), self._selection.rows(layout)
        covariances = IN_PROCESS.covariances(layout, rows, orientation, zero, points)
        return self._whole(layout, points), self._whole(layout, covariances)

    def _placed(self, orientation: Array) -> tuple[Layout, Array]:
        """Points (n, 3) where the unknowns put them, and the layout in whose order they are."""
        begin = BundleGraph(self._layout, self._selection.rows(self._layout)).reduction(orientation, COSTS)
        layout, reduction = relinearized(self._layout, self._selection, begin, COSTS)
        return layout, reduction.points

    def _whole(self, layout: Layout, values: Array) -> Array:
        """Values (n, ...) in the network's order, NaN for points that nothing determines."""
        blank = np.where(determined_points(self._selection.rows(layout)), 1.0, np.nan)
        return layout.network_order(values * blank.reshape(-1, *[1] * (values.ndim - 1)))


Announce = Callable[[str], None]
"""Called at the beginning of each step with its name."""

_MOST_PASSES = 6


@dataclass(frozen=True, slots=True, eq=False)
class TwoSteps(Record):
    """Both adjustments of one network."""

    network: Network
    """With its terrain model, as it was given."""
    free: Solution
    """Step 1: without the terrain model."""
    fitted: Solution
    """Step 2: with it. Of its network the surface lacks the rejected rows."""
    rejected: Mask
    """(n,) points whose height row was judged to be a blunder, or whose ground differs from the model's."""
    heights_converged: bool
    """Whether that judgement converged."""
    history: tuple[tuple[Iteration, ...], tuple[Iteration, ...]]
    """Every step tried of either, over all passes."""
    seconds: tuple[float, float]
    """Wall time of either."""
    rays_alone: RaysAlone
    """Forward intersection of the rays that step 1 left in."""

    @property
    def converged(self) -> bool:
        """Whether both did."""
        return self.free.converged and self.fitted.converged

    def __repr__(self) -> str:
        return f"TwoSteps(free {self.free!r}, fitted {self.fitted!r}, {int(self.rejected.sum())} heights rejected)"


def adjust_in_two_steps(
    network: Network,
    settings: SolverSettings,
    name: str = "adjustment",
    progress: Progress = no_progress,
    announce: Announce = no_progress,
    cluster: Connection | None = None,
) -> TwoSteps:
    """Adjust a network without its terrain model, and then with it.

    Parameters
    ----------
    network : Network
        With a terrain model (`Network.surface`).
    settings : SolverSettings
        Its blunder limit (`reject`) judges rays and ranges in step 1, and heights in step 2; 0 judges nothing.
    name, progress, cluster
        As of `adjust_network`.
    announce : callable
        Called at the beginning of each step.

    Raises
    ------
    InputError
        When the network has no terrain model, or no point on it.
    WeakNetwork
        When rays, laser and priors alone leave some direction of the orientation undetermined.

    Examples
    --------
    >>> from mgsgraph.simulation import BlockSettings, simulate_hrsc_block
    >>> block = simulate_hrsc_block(BlockSettings(passes=2, length=100e3, points=100), seed=1)
    >>> steps = mgsgraph.adjust_in_two_steps(block.network, mgsgraph.SolverSettings(reject=4.0))
    >>> steps.converged, int(steps.rejected.sum())
    (True, 0)
    """
    require_terrain(network)
    begin = time.perf_counter()
    announce("step 1 of 2, without terrain")
    free = adjust_network(without_terrain(network), settings, f"{name}, step 1", progress, cluster)
    middle = time.perf_counter()
    announce("step 2 of 2, with terrain")
    selection, quiet = selection_of(network, free), replace(settings, reject=0.0)
    rays_alone = RaysAlone(without_terrain(network), quiet, selection)
    rejected, tried, history = np.zeros(len(network.points), dtype=np.bool_), set[bytes](), tuple[Iteration, ...]()
    while True:
        fitted = adjust_network(without_heights(network, rejected), quiet, name, progress, cluster, selection)
        history += fitted.history
        tried.add(rejected.tobytes())
        judged = implausible_heights(network, fitted, rays_alone, settings.reject)
        heights_converged = np.array_equal(judged, rejected)
        if heights_converged or judged.tobytes() in tried or len(tried) == _MOST_PASSES:
            break
        rejected = judged
    rejected.flags.writeable = False
    seconds = middle - begin, time.perf_counter() - middle
    return TwoSteps(network, free, fitted, rejected, heights_converged, (free.history, history), seconds, rays_alone)


def require_terrain(network: Network, where: str = "two steps") -> None:
    """Raise InputError unless some points lie on a terrain model; `where` names the network in errors."""
    if network.surface is None:
        raise InputError(where, "no terrain model as control", "one to fit the block to in step 2", "add [terrain]")
    if not np.any(np.isfinite(network.surface.sigmas)):
        raise InputError(where, "a terrain model on which no point lies", "points over its posts")


def without_terrain(network: Network) -> Network:
    """A network without its terrain model and what is unknown of that."""
    return replace(network, surface=None, considered=tuple(name for name in network.considered if name != TERRAIN))


def without_heights(network: Network, rejected: Mask) -> Network:
    """A network without the height rows of some points (n,)."""
    surface = network.surface
    if surface is None or not np.any(rejected):
        return network
    return replace(network, surface=replace(surface, sigmas=np.where(rejected, np.inf, surface.sigmas)))


def selection_of(network: Network, free: Solution) -> Selection:
    """Rays and ranges that an adjustment without blunders (step 1) has left in."""
    complete = all_rows(network)
    rays = complete.rays if free.rays_rejected is None else ~free.rays_rejected
    ranges = complete.ranges if free.ranges_rejected is None else ~free.ranges_rejected
    stereo = complete.stereo if free.stereo_rejected is None else ~free.stereo_rejected
    return Selection(rays, ranges, complete.out, stereo)


def heights_above(network: Network, places: Array, solution: Solution | None = None) -> tuple[Array, Array]:
    """Heights of points above the network's terrain model, along its normal.

    Parameters
    ----------
    network : Network
        With a terrain model.
    places : (n, 3)
        m, body-fixed.
    solution : Solution, optional
        The model is where this puts it, which differs where its shift or tilt is unknown; else where it is given.

    Returns
    -------
    heights : (n,)
        m; NaN for points without a place, beside the model or over missing posts.
    normals : (n, 3)
        d(height) / d(place).
    """
    assert network.surface is not None
    if solution is not None and solution.network.terrain_moves:
        places = places - network.surface.moved(places, solution.shift_values[-1])
    heights, normals = np.full(len(places), np.nan), np.full(places.shape, np.nan)
    finite = np.all(np.isfinite(places), axis=1)
    heights[finite], normals[finite] = network.surface.grid.height_above(places[finite])
    return heights, normals


def implausible_heights(network: Network, fitted: Solution, rays_alone: RaysAlone, limit: float) -> Mask:
    """(n,) points whose height contradicts the terrain model by more than `limit` standard deviations.

    Judged is the height h above the model of the place where the rays alone put the point, with the orientation of step
    2, over root(s^2 + q): s is the sigma of the height row, q the variance of h by the rays' noise. That is the row's
    own residual over its standard deviation, s root(1 - q'/s^2) with q' = q s^2 / (s^2 + q), the shared unknowns taken
    for true; so it is the same test whether the row takes part or not, and rows may return. The unit is as
    for rays (`blunders.squared_unit`).
    """
    surface = network.surface
    assert surface is not None
    result = np.zeros(len(network.points), dtype=np.bool_)
    if limit == 0.0:
        return result
    places, covariances = rays_alone.at(orientation_values(network, fitted))
    heights, normals = heights_above(network, places, fitted)
    variances = np.einsum("ni,nij,nj->n", normals, covariances, normals)
    judged = np.flatnonzero(np.isfinite(surface.sigmas) & np.isfinite(heights))
    tests = heights[judged] ** 2 / (surface.sigmas[judged] ** 2 + variances[judged])
    if tests.size:
        result[judged[tests > limit**2 * squared_unit(tests / MEDIAN, tests.size)]] = True
    return result


def orientation_values(network: Network, fitted: Solution) -> list[Array]:
    """Values of the shared unknowns but for the terrain model's, as the network without it numbers them."""
    values = list(fitted.values)
    if network.terrain_moves:
        del values[network.first_shared - 1]
    return values
