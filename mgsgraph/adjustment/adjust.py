"""The main job: lay a network out, solve it (in passes, when blunders are sought), and read off the posterior."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from mgsgraph.adjustment.cluster.connection import Connection
from mgsgraph.adjustment.cluster.partitions import Partitions, require_bundles
from mgsgraph.adjustment.gpu.choice import remarks_of, require_usable, sweeper_of
from mgsgraph.adjustment.graph import Layout, lay_out
from mgsgraph.adjustment.graph.bundle import Sweeper
from mgsgraph.adjustment.multistart import best_of_starts, starts_wanted
from mgsgraph.adjustment.nominal import nominal_reduction, nominal_state
from mgsgraph.adjustment.results import Clock, read_off
from mgsgraph.adjustment.rounds import Progress, Selection, Solved, determined_points, solve_in_rounds
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network, PointClass
from mgsgraph.network.corrections import require_observed_nodes


def adjust_network(
    network: Network,
    settings: SolverSettings,
    name: str = "adjustment",
    progress: Progress = lambda _: None,
    cluster: Connection | None = None,
    left_in: Selection | None = None,
    begin: Sequence[Array] | None = None,
) -> Solution:
    """Adjust a network.

    Parameters
    ----------
    network : Network
    settings : SolverSettings
    name : str
        What to call it in reports.
    progress : callable
        Called with every iteration.
    cluster : Connection, optional
        Whose workers hold the points, in partitions (`cluster.open_cluster`); this process when absent.
    left_in : Selection, optional
        Rays and ranges that take part; all when absent. Not together with a blunder limit, which judges all anew.
    begin : sequence of array, optional
        Value of each variable, as `Solution.values`, where the optimiser begins; the nominal orientation when absent,
        or, with stereo rows, the images' own adjustment.

    Returns
    -------
    Solution
        Also when it did not converge: its message says so.

    Raises
    ------
    PointBehindCamera
        A point lies behind a camera that has seen it, with the nominal orientation.
    WeakNetwork
        Nothing determines some direction of the orientation.
    InputError
        Orientation images with too few rays near them, closer than the data supports.
        The explicit form on a cluster or a GPU; a partition that is too large for its
        worker; no GPU, or one with too little memory, where one is asked for.
    SolverError
        The cluster has gone.

    Examples
    --------
    >>> settings = mgsgraph.SolverSettings(loss="huber")
    >>> robust = mgsgraph.adjust_network(network, settings, "with Huber's loss")
    >>> robust.converged, round(robust.sigma0, 2)
    (True, 1.1)
    """
    clock = Clock()
    if cluster is not None:
        require_bundles(settings, cluster.where)
    require_usable(settings)
    network.require_observed()
    require_observed_nodes(network, None if left_in is None else left_in.rays)
    layout = lay_out(network, settings)
    clock.stop("set up")
    with _sweeper(layout, settings, cluster) as sweeper:
        if cluster is not None:
            clock.stop("send to workers")
        layout, selection, before = nominal_reduction(layout, sweeper, left_in)
        clock.stop("solve")
        nominal = nominal_state(layout, before, sweeper)
        clock.stop("residuals")
        orientation = None if begin is None else layout.variables.joined(begin)
        solved = solve_in_rounds(layout, settings, selection, before, progress, sweeper, orientation)
        clock.stop("solve")
        starts = 0 if begin is not None or cluster is not None else starts_wanted(network, settings, layout)
        minima, mixture = None, None
        if starts and solved.outcome.converged:
            solved, minima, mixture = best_of_starts(solved, settings, before, starts, sweeper)
            clock.stop("starts")
        _require_ties(name, solved)
        del before, layout  # the posterior needs the memory
        found = read_off(settings, name, solved, nominal, clock, sweeper, mixture)
        return replace(found, minima=minima, message=" ".join([found.message, *remarks_of(sweeper)]))


class Adjustment:
    """Networks adjusted in one go; `IncrementalAdjustment` takes images as they come.

    Examples
    --------
    >>> solution = mgsgraph.Adjustment.batch(network)
    >>> solution.converged, solution.fit.degrees_of_freedom
    (True, 60)
    """

    @staticmethod
    def batch(
        network: Network,
        settings: SolverSettings | None = None,
        name: str = "adjustment",
        progress: Progress = lambda _: None,
    ) -> Solution:
        """Adjust a network with the default settings, or others; see `adjust_network`."""
        return adjust_network(network, settings or SolverSettings(), name, progress)


def _require_ties(name: str, solved: Solved) -> None:
    """Raise InputError where tie points that two rays or more have seen are all lost: what is left to come to rest on
    says nothing of how the images fit together.
    """
    network = solved.layout.network
    ties = (network.points.classes == PointClass.TIE) & (network.ray_counts > 1)
    taking = np.bincount(network.rays.point, solved.selection.rays, len(network.points))
    left = solved.layout.network_order(determined_points(solved.rows)) & (taking > 0)
    if np.any(ties) and not np.any(ties & left):
        lost, weak = int(np.count_nonzero(ties)), int(np.count_nonzero(ties & (taking > 1)))
        raise InputError(
            name, f"none of {lost} tie points is left ({lost - weak} rejected, {weak} not determined by their rays)",
            "ties that agree with the orientations, heights and laser shots",
            "look at mgsgraph check: images, lines and samples, or columns interchanged, orientations far off; "
            "without rejection (reject = 0) the table of residuals shows by how much",
        )


@contextmanager
def _sweeper(layout: Layout, settings: SolverSettings, cluster: Connection | None) -> Iterator[Sweeper]:
    """Who goes over the points."""
    if cluster is None:
        yield sweeper_of(settings, layout)
        return
    with Partitions(cluster, layout) as partitions:
        yield partitions
