"""Does an HRSC block come out as the paper says, and are its sigmas right? Many simulated blocks in two steps.

Each seed simulates a block (passes of five stereo lines, trajectory errors drawn from the stated prior, a terrain model
like MOLA's) and adjusts it without and then with the terrain. The page has the figures of merit of Spiegel et al.
(papers/003), mean over the seeds, and the errors of orientation and points normalized by their covariances (NEES).
Sigmas of points before are those of forward intersection, each point by itself; heights above the terrain are those of
the places where the rays alone put the points, with the orientation of each stage.

    python scripts/hrsc_block.py [--cases paper small] [--seeds 20] [--first 1] [--processes N] [--out FILE]

Fills docs/evidence_passes.md with the last of the cases. Exit status: 0 done, 2 bad input.
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from study import Blocks, Draw, cases, degrees_of_points, names_of, nees_cell, number, run, seeds_of, table

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.frames import FLIGHT_NAMES
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network
from mgsgraph.simulation.demo.demonstration import nees
from mgsgraph.text import root_mean_square
from mgsgraph.units import KM, MGON

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from mex_block import BlockSettings, SimulatedBlock, simulate_hrsc_block
from redraw import flight_sigmas, forward_intersection, node_squares

CASES = {
    "paper": BlockSettings(passes=4, points=10_000, length=1500 * KM, spacing=15.0),
    "small": BlockSettings(passes=2, points=1_000, length=200 * KM, spacing=15.0),
}
STAGES = ("before", "step 1", "step 2")
"""Nominal orientation and a-priori sigmas; adjusted without terrain; adjusted with it."""
ATTITUDE = np.array([4, 3, 5])
"""Components of a node about the camera's y, x and z: roll, pitch and yaw."""


def one_draw(case: str, seed: int) -> Draw:
    """Simulate and adjust one block: figures of merit at three stages; NEES of nodes and points after both steps; rms
    errors and stated sigmas (rad) about the camera's y, x, z at the nodes.
    """
    begin, block = time.perf_counter(), simulate_hrsc_block(CASES[case], seed)
    network, without = block.network, replace(block.network, surface=None)
    solutions = [adjust_network(one, SolverSettings()) for one in (without, network)]
    true = [block.true_nodes(k) for k in range(len(network.passes))]
    errors = [-np.concatenate(true), *(np.concatenate(s.nodes) - np.concatenate(true) for s in solutions)]
    (prior, *before), (_, _, after) = forward_intersection(without), forward_intersection(without, solutions[1])
    freedom = sum(one.size for one in true)
    return {
        "nodes": [node_squares(one, true) / freedom for one in solutions], "freedom": freedom,
        "points": [nees((s.places - block.true_points)[s.determined], s.covariances[s.determined]).mean() / 3.0
                   for s in solutions],
        "points_freedom": [degrees_of_points(solution, np.flatnonzero(solution.determined)) for solution in solutions],
        "converged": all(solution.converged for solution in solutions),
        "errors": [root_mean_square(error[:, ATTITUDE], 0).tolist() for error in errors],
        "stated": [_stated(without, prior), *(_stated(s.network, s.joint_covariance) for s in solutions)],
        "mean": flight_sigmas(network, [before[0], *(s.covariances for s in solutions)], block.true_points),
        "heights": heights(block, [before[1], solutions[0].places, after], solutions[1]),
        "seconds": time.perf_counter() - begin,
    }  # fmt: skip


def heights(block: SimulatedBlock, places: list[Array], fitted: Solution) -> list[float]:
    """rms of heights (m) of places at all stages above the terrain model, which step 2 has moved."""
    surface = block.network.surface
    assert surface is not None
    moved = [*places[:2], places[2] - surface.moved(places[2], fitted.shift_values[-1])]
    return [float(root_mean_square(surface.grid.height_above(one)[0])) for one in moved]


def _stated(network: Network, joint: JointCovariance) -> list[float]:
    """(3,) rad, rms over all nodes of the sigmas about the camera's y, x, z."""
    variables = np.concatenate([np.arange(first, first + len(pass_.nodes)) for pass_, first in network.numbered_passes])
    columns = joint.square_root.first[variables][:, None] + ATTITUDE
    return root_mean_square(joint.sigmas[columns], 0).tolist()


def judge(draws: list[Draw]) -> Blocks:
    """Both tables."""
    of_case = cases(draws, names_of(draws)[-1])
    converged, seconds = sum(draw["converged"] for draw in of_case), np.mean([draw["seconds"] for draw in of_case])
    end = f"{converged} of {len(of_case)} blocks converged in both steps; {seconds:.0f} s a block."
    return {"merit": merit_table(of_case), "nees": [*nees_table(of_case), "", end]}


def merit_table(draws: list[Draw]) -> list[str]:
    """Sigmas of points and attitude, and heights, at the three stages."""
    mean, above, stated, errors = (
        np.array([draw[key] for draw in draws]) for key in ("mean", "heights", "stated", "errors")
    )
    cells = [[f"sigma of points in {axis}, m", *_stages(mean[:, :, k])] for k, axis in enumerate("XYZ")]
    for k, axis in enumerate(FLIGHT_NAMES[3:]):
        for quantity, values in (("sigma", stated), ("error", errors)):
            rms = root_mean_square(values[:, :, k] / MGON, 0)[None]
            cells.append([f"{quantity} of {axis} at the nodes, rms, mgon", *_stages(rms)])
    cells.append(["rms of heights above the terrain, m", *_stages(above)])
    return table(["", *STAGES, "factor, step 1", "factor, step 2"], cells)


def _stages(values: Array) -> list[str]:
    """Cells of values (seeds, stages)."""
    mean = values.mean(axis=0)
    scatter = [f" ({b:.2g})" for b in values.std(axis=0, ddof=1)] if len(values) > 1 else [""] * values.shape[1]
    texts = [number(a) + b for a, b in zip(mean, scatter, strict=True)]
    return [*texts, *(number(mean[0] / mean[k]) for k in (1, 2))]


def nees_table(draws: list[Draw]) -> list[str]:
    """NEES of the nodes of all passes, and of the points of a block, whose errors are correlated."""
    rows = []
    for step in (0, 1):
        nodes, points, freedom = ([draw[key][step] for draw in draws] for key in ("nodes", "points", "points_freedom"))
        cells = nees_cell(nodes, draws[0]["freedom"]), nees_cell(points, freedom)
        rows.append([STAGES[step + 1], *cells])
    return table(["", "nodes", "points"], rows)


if __name__ == "__main__":
    sys.exit(run(seeds_of(__doc__, tuple(CASES), 20, "evidence_passes.md#hrsc_block"), one_draw, judge))
