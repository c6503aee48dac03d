"""Does an HRSC block come out as the paper says, and are its sigmas honest? Many simulated blocks in two steps.

Each seed simulates a block (strips of five stereo lines, trajectory errors drawn from the stated prior, a terrain model
like MOLA's) and adjusts it without and then with the terrain. The page has the figures of merit of Spiegel et al.
(papers/003), mean over the seeds, and the errors of orientation and points normalised by their covariances (NEES).

    python scripts/hrsc_block.py [--seeds 20] [--strips 4] [--points 10000] [--length 1500] [--spacing 15]
                                 [--out FOLDER]

Writes hrsc_block.md and hrsc_block.png (heights above the terrain of the first block) to the folder, docs by default.
Exit status: 0 done, 2 bad input.
"""

import shutil
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from study import DOCS, Z99, at_least, command, machine, made_with, number, positive, show, table, write_page

from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.adjustment.two_steps import adjust_in_two_steps
from mgsgraph.analysis.two_step_statistics import POINT_AXES, POSE_AXES, STAGES, TwoStepStatistics, two_step_statistics
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network
from mgsgraph.results.two_steps import write_two_steps
from mgsgraph.simulation.demo.truth import nees
from mgsgraph.simulation.hrsc_block import BlockSettings, SimulatedBlock, simulate_hrsc_block
from mgsgraph.text import root_mean_square
from mgsgraph.units import KM, MGON

PAGE, PICTURE = "hrsc_block.md", "hrsc_block.png"
ATTITUDE = np.array([4, 3, 5])
"""Components of a node about the camera's y, x and z: roll, pitch and yaw."""
WORDS = """# Simulated HRSC blocks, as the paper has them

Made by `scripts/hrsc_block.py`: {seeds} seeds of {strips} strips, {length:g} km each, from {low:g} to {high:g} km above
ground, {points:,} points matched to {sigma:g} px in three to five stereo lines (and where strips overlap in those of
both), orientation images every {spacing:g} s (cubic Lagrange). What is wrong with the trajectories is drawn from the
stated prior: attitude {attitude:.0f} mgon bias, {attitude_drift:.0f} mgon drift, {attitude_wander:.0f} mgon besides;
position {position:g}, {position_drift:g} and {position_wander:g} m. The terrain model has posts {posts} to the degree,
{vertical:g} m of noise and a common planimetric error of {planimetric:g} m, which is an unknown. Each block is adjusted
without the terrain (step 1) and with it (step 2); no blunders, nothing rejected.

Not from the paper, which has none: all figures of the position, the drifts, roll's 28 mgon.
"""
MERIT = """## Figures of merit

Mean over the seeds (and their scatter) of the block's mean sigmas, for sigma0 = 1; the factor is before over after.
Those of position and attitude are means over the lines of each strip's middle image. *At the nodes*, ends included,
where sigmas are larger, is the sigma stated there, rms, and beside it what they really were off: these two compare.
The paper: pitch and yaw from 28 to 1-2 mgon without terrain; X, Y 5-20 m, Z 30-50 m, 2 to 3 times better; heights
above MOLA 2 to 3 times less with it.
"""
HONEST = """## Are the sigmas honest?

Squares of errors normalised by the stated covariance, per degree of freedom; 1 is honest. *nodes*: all nodes of a strip
jointly, strips of all seeds; the band is a chi-square's, 99 %. *points*: mean over the points of a block, which err
together, so the band is from the scatter over the seeds. With the terrain, neighbouring points share posts and so their
error, which the rows on it don't know.
"""
BELOW = """Strips of one block share points, and with the terrain its shift, so that their errors go together; the band
of the nodes is a chi-square's for independent strips, and so a little too narrow (four strips of 600 km: 7 to 9 %).
"""

@dataclass(frozen=True)
class Row:
    """One seed."""

    merit: TwoStepStatistics
    nodes: Array
    """(2, strips) squares of the nodes' errors, normalised; steps 1 and 2."""
    freedom: Array
    """(strips,) their degrees of freedom."""
    points: Array
    """(2,) mean over the points, over 3."""
    attitude: Array
    """(stages, 3) rad, rms error about the camera's y, x, z (roll, pitch, yaw) over all nodes."""
    stated: Array
    """(stages, 3) rad, rms of the sigmas of the same at the same nodes."""
    converged: bool


def one_seed(settings: BlockSettings, seed: int) -> Row:
    """Simulate and adjust one block."""
    block = simulate_hrsc_block(settings, seed)
    steps = adjust_in_two_steps(block.network, SolverSettings(reject=0.0))
    pairs = [_of_nodes(block, one) for one in (steps.free, steps.fitted)]
    points = []
    for one in (steps.free, steps.fitted):
        known = one.determined
        points.append(float(nees((one.places - block.true_points)[known], one.covariances[known]).mean()) / 3.0)
    true = np.concatenate([block.true_nodes(k) for k in range(len(block.network.passes))])
    errors = [np.zeros_like(true), *(np.concatenate(one.nodes) for one in (steps.free, steps.fitted))]
    attitude = np.array([root_mean_square((found - true)[:, ATTITUDE], 0) for found in errors])
    joints = (steps.rays_alone.joint, steps.free.joint_covariance, steps.fitted.joint_covariance)
    networks = (steps.free.network, steps.free.network, steps.fitted.network)
    stated = np.array([_stated(network, joint) for network, joint in zip(networks, joints, strict=True)])
    freedom = np.array([6 * len(strip.nodes) for strip in block.network.passes])
    found = two_step_statistics(steps)
    return Row(found, np.array(pairs), freedom, np.array(points), attitude, stated, steps.converged)


def _stated(network: Network, joint: JointCovariance | None) -> Array:
    """(3,) rad, rms over all nodes of the sigmas about the camera's y, x, z."""
    assert joint is not None  # strips with known sigmas
    variables = np.concatenate([
        np.arange(first, first + len(strip.nodes))
        for strip, first in network.numbered_passes
    ])  # fmt: skip
    columns = joint.square_root.first[variables][:, None] + ATTITUDE
    return root_mean_square(joint.sigmas[columns], 0)


def _of_nodes(block: SimulatedBlock, solution: Solution) -> list[float]:
    """Normalised squares of the errors of each strip's nodes."""
    found = []
    for k, (strip, first) in enumerate(block.network.numbered_passes):
        error = (solution.nodes[k] - block.true_nodes(k)).ravel()
        # the block without terrain has fewer variables before the strips
        first += int(solution.network.first_of_passes[0] - block.network.first_of_passes[0])
        covariance = solution.joint_covariance.of(range(first, first + len(strip.nodes)))
        found.append(float(error @ np.linalg.solve(covariance, error)))
    return found


def merit_table(rows: list[Row]) -> list[str]:
    """Sigmas of points and attitude, and heights, at the three stages."""
    cells = []
    for k, axis in enumerate(POINT_AXES):
        means = np.array([row.merit.whole.mean[:, k] for row in rows])
        cells.append([f"sigma of points in {axis}, m", *_stages(means)])
    for k, axis in enumerate(POSE_AXES):
        unit, scale = ("m", 1.0) if k < 3 else ("mgon", MGON)
        values = np.array([row.merit.whole.poses[:, k] for row in rows]) / scale
        cells.append([f"sigma of {axis}, mean over the middle image's lines, {unit}", *_stages(values)])
        if k >= 3:
            stated, errors = (
                np.array([one[:, k - 3] for one in ones]) / scale
                for ones in ([row.stated for row in rows], [row.attitude for row in rows])
            )
            for what, of_seeds in (("sigma", stated), ("error", errors)):
                whole = root_mean_square(of_seeds, 0)[None]
                cells.append([f"{what} of {axis} at the nodes, rms, {unit}", *_stages(whole)])
    cells.append(["rms of heights above the terrain, m",
                  *_stages(np.array([row.merit.whole.heights.rms for row in rows]))])  # fmt: skip
    return table(["", *(stage.replace("_", " ") for stage in STAGES), "factor, step 1", "factor, step 2"], cells)


def _stages(values: Array) -> list[str]:
    """Cells of values (seeds, stages)."""
    mean, spread = values.mean(axis=0), values.std(axis=0, ddof=1) if len(values) > 1 else np.zeros(values.shape[1])
    scatter = [f" ({b:.2g})" if len(values) > 1 else "" for b in spread.tolist()]
    texts = [number(a) + b for a, b in zip(mean, scatter, strict=True)]
    return [*texts, *(number(mean[0] / mean[k]) for k in (1, 2))]


def honesty_table(rows: list[Row]) -> list[str]:
    """NEES."""
    freedom, cells = sum(float(row.freedom.sum()) for row in rows), []
    for step in (0, 1):
        nodes = sum(float(row.nodes[step].sum()) for row in rows) / freedom
        half = Z99 * np.sqrt(2.0 / freedom)
        points = np.array([row.points[step] for row in rows])
        about = Z99 * float(points.std(ddof=1)) / np.sqrt(len(rows)) if len(rows) > 1 else float("nan")
        inside = abs(nodes - 1.0) <= half
        scatter = ["-", "-"]
        if len(rows) > 1:
            honest = abs(points.mean() - 1.0) <= about
            scatter = [f"{points.mean() - about:.3f} .. {points.mean() + about:.3f}", "in" if honest else "**out**"]
        cells.append([STAGES[step + 1].replace("_", " "), f"{nodes:.3f}", f"{1.0 - half:.3f} .. {1.0 + half:.3f}",
                      "in" if inside else "**out**", f"{points.mean():.3f}", *scatter])  # fmt: skip
    return table(["", "nodes", "band", "", "points", "mean, 99 %", ""], cells)


def page(rows: list[Row], settings: BlockSettings, seconds: float) -> str:
    """The page."""
    errors, terrain = settings.errors, settings.terrain
    assert terrain is not None
    words = WORDS.format(
        seeds=len(rows), strips=settings.strips, length=settings.length / KM, low=settings.altitudes[0] / KM,
        high=settings.altitudes[1] / KM, points=settings.points, sigma=settings.matches.sigma, spacing=settings.spacing,
        attitude=errors.attitude / MGON, attitude_drift=errors.attitude_drift / MGON,
        attitude_wander=errors.attitude_wander / MGON, position=errors.position, position_drift=errors.position_drift,
        position_wander=errors.position_wander, posts=terrain.posts_per_degree, vertical=terrain.vertical,
        planimetric=terrain.planimetric,
    )  # fmt: skip
    at_rest = sum(row.converged for row in rows)
    return "\n".join([
        words, MERIT, *merit_table(rows), "", HONEST, *honesty_table(rows), "", BELOW,
        f"{at_rest} of {len(rows)} blocks converged in both steps; {seconds / len(rows):.0f} s a block.", "",
        f"![heights above the terrain]({PICTURE})", "", f"{made_with()} {machine()}.", "",
    ])  # fmt: skip


def main() -> int:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--seeds", type=at_least(1), default=20)
    parser.add_argument("--strips", type=at_least(1), default=4)
    parser.add_argument("--points", type=at_least(100), default=10_000)
    parser.add_argument("--length", type=positive, default=1500.0, help="km")
    parser.add_argument("--spacing", type=positive, default=15.0, help="s between nodes")
    parser.add_argument("--out", type=Path, default=DOCS, help="folder of the page")
    chosen = parser.parse_args()

    def text() -> str:
        settings = BlockSettings(
            strips=chosen.strips, points=chosen.points, length=chosen.length * KM, spacing=chosen.spacing
        )
        begin, rows = time.perf_counter(), list[Row]()
        for seed in range(1, chosen.seeds + 1):
            show(f"block {seed} of {chosen.seeds}")
            rows.append(one_seed(settings, seed))
            if seed == 1:
                with tempfile.TemporaryDirectory() as folder:
                    write_two_steps(rows[0].merit, Path(folder))
                    shutil.copy(Path(folder) / "height_map_2.png", chosen.out / PICTURE)
        return page(rows, settings, time.perf_counter() - begin)

    return write_page(parser, chosen.out / PAGE, text)


if __name__ == "__main__":
    sys.exit(main())
