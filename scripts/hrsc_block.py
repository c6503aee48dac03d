"""Does an HRSC block come out as the paper says, and are its sigmas right? Many simulated blocks in two steps.

Each seed simulates a block (passes of five stereo lines, trajectory errors drawn from the stated prior, a terrain model
like MOLA's) and adjusts it without and then with the terrain. The page has the figures of merit of Spiegel et al.
(papers/003), mean over the seeds, and the errors of orientation and points normalized by their covariances (NEES).

    python scripts/hrsc_block.py [--cases paper small] [--seeds 20] [--first 1] [--processes N] [--out FILE]

Fills docs/evidence_passes.md with the last of the cases. Exit status: 0 done, 2 bad input.
"""

import sys
import time

import numpy as np
from study import Blocks, Draw, cases, degrees_of_points, names_of, nees_cell, number, run, seeds_of, table

from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.adjustment.two_steps import adjust_in_two_steps
from mgsgraph.analysis.two_step_statistics import POINT_AXES, POSE_AXES, STAGES, two_step_statistics
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network
from mgsgraph.simulation.demo.demonstration import nees
from mgsgraph.simulation.hrsc_block import BlockSettings, SimulatedBlock, simulate_hrsc_block
from mgsgraph.text import root_mean_square
from mgsgraph.units import KM, MGON

CASES = {
    "paper": BlockSettings(passes=4, points=10_000, length=1500 * KM, spacing=15.0),
    "small": BlockSettings(passes=2, points=1_000, length=200 * KM, spacing=15.0),
}
ATTITUDE = np.array([4, 3, 5])
"""Components of a node about the camera's y, x and z: roll, pitch and yaw."""


def one_draw(case: str, seed: int) -> Draw:
    """Simulate and adjust one block: figures of merit at three stages; NEES of nodes and points after both steps; rms
    errors and stated sigmas (rad) about the camera's y, x, z at the nodes.
    """
    begin, block = time.perf_counter(), simulate_hrsc_block(CASES[case], seed)
    steps = adjust_in_two_steps(block.network, SolverSettings(reject=0.0))
    solutions = steps.free, steps.fitted
    points = [nees((s.places - block.true_points)[s.determined], s.covariances[s.determined]) for s in solutions]
    true = np.concatenate([block.true_nodes(k) for k in range(len(block.network.passes))])
    errors = [np.zeros_like(true), *(np.concatenate(solution.nodes) for solution in solutions)]
    joints = (steps.rays_alone.joint, steps.free.joint_covariance, steps.fitted.joint_covariance)
    networks = (steps.free.network, steps.free.network, steps.fitted.network)
    merit = two_step_statistics(steps).whole
    freedom = sum(6 * len(pass_.nodes) for pass_ in block.network.passes)
    return {
        "nodes": [sum(_of_nodes(block, solution)) / freedom for solution in solutions], "freedom": freedom,
        "points": [float(part.mean()) / 3.0 for part in points],
        "points_freedom": [degrees_of_points(solution, np.flatnonzero(solution.determined)) for solution in solutions],
        "converged": bool(steps.converged),
        "errors": [root_mean_square((error - true)[:, ATTITUDE], 0).tolist() for error in errors],
        "stated": [_stated(*pair).tolist() for pair in zip(networks, joints, strict=True)],
        "mean": merit.mean.tolist(), "poses": merit.poses.tolist(), "heights": np.asarray(merit.heights.rms).tolist(),
        "seconds": time.perf_counter() - begin,
    }  # fmt: skip


def _stated(network: Network, joint: JointCovariance | None) -> Array:
    """(3,) rad, rms over all nodes of the sigmas about the camera's y, x, z."""
    assert joint is not None  # passes with known sigmas
    variables = np.concatenate([
        np.arange(first, first + len(pass_.nodes))
        for pass_, first in network.numbered_passes
    ])  # fmt: skip
    columns = joint.square_root.first[variables][:, None] + ATTITUDE
    return root_mean_square(joint.sigmas[columns], 0)


def _of_nodes(block: SimulatedBlock, solution: Solution) -> list[float]:
    """Normalised squares of the errors of each pass's nodes."""
    squares = []
    for k, (pass_, first) in enumerate(block.network.numbered_passes):
        error = (solution.nodes[k] - block.true_nodes(k)).ravel()
        # the block without terrain has fewer variables before the passes
        first += int(solution.network.first_of_passes[0] - block.network.first_of_passes[0])
        covariance = solution.joint_covariance.of(range(first, first + len(pass_.nodes)))
        squares.append(float(error @ np.linalg.solve(covariance, error)))
    return squares


def judge(draws: list[Draw]) -> Blocks:
    """Both tables."""
    of_case = cases(draws, names_of(draws)[-1])
    converged, seconds = sum(draw["converged"] for draw in of_case), np.mean([draw["seconds"] for draw in of_case])
    end = f"{converged} of {len(of_case)} blocks converged in both steps; {seconds:.0f} s a block."
    return {"merit": merit_table(of_case), "nees": [*nees_table(of_case), "", end]}


def merit_table(draws: list[Draw]) -> list[str]:
    """Sigmas of points and attitude, and heights, at the three stages."""
    mean, poses, heights, stated, errors = (
        np.array([draw[key] for draw in draws]) for key in ("mean", "poses", "heights", "stated", "errors")
    )
    cells = [[f"sigma of points in {axis}, m", *_stages(mean[:, :, k])] for k, axis in enumerate(POINT_AXES)]
    for k, axis in enumerate(POSE_AXES):
        unit, scale = ("m", 1.0) if k < 3 else ("mgon", MGON)
        cells.append([f"sigma of {axis}, mean over the middle image's lines, {unit}", *_stages(poses[:, :, k] / scale)])
        for quantity, values in (("sigma", stated), ("error", errors)) if k >= 3 else ():
            rms = root_mean_square(values[:, :, k - 3] / scale, 0)[None]
            cells.append([f"{quantity} of {axis} at the nodes, rms, {unit}", *_stages(rms)])
    cells.append(["rms of heights above the terrain, m", *_stages(heights)])
    return table(["", *(stage.replace("_", " ") for stage in STAGES), "factor, step 1", "factor, step 2"], cells)


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
        rows.append([STAGES[step + 1].replace("_", " "), *cells])
    return table(["", "nodes", "points"], rows)


if __name__ == "__main__":
    sys.exit(run(seeds_of(__doc__, tuple(CASES), 20, "evidence_passes.md#hrsc_block"), one_draw, judge))
