"""Are strengths of processes found, are their errors true, and are sigmas that follow from them? Many simulated draws.

HRSC: strips of five lines whose position and attitude depart by Gauss-Markov processes of 30 s. CTX: pairs whose
attitude departs by a Matern process of a quarter of the images' time, drawn from the model for each image, or the same
in both (`same motion`). Two passes: short ones whose attitude departs by Gauss-Markov processes of 10 s, of one
strength, or (`unlike`) the second of a fifth of it. The search begins where the case says, in planted strengths.

    python scripts/process_strengths.py [--cases CASE ...] [--seeds 20] [--first 1] [--processes N] [--out FILE]

Fills docs/evidence_passes.md. Exit status: 0 done, 2 bad input.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from study import Blocks, Draw, cases, names_of, nees_cell, number, run, seeds_of, table

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.process_strengths import estimated_strengths
from mgsgraph.geometry.orientation import OrientationImages, evenly_spaced
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.network import Network, Pass, Process, ProcessPrior
from mgsgraph.simulation.demo.demonstration import nees
from mgsgraph.units import KM

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from ctx_pair import PIXEL, CtxSettings, TrueJitter, image_times, simulate_ctx_pair
from mex_block import BlockSettings, TrajectoryErrors, simulate_hrsc_block
from mex_flight import pass_correction

CASES = ("HRSC 600 km, 3", "HRSC 300 km, 3", "CTX pair, 1", "CTX pair, 3", "CTX same motion, 1", "CTX same motion, 3",
         "Two strips, 1", "Two strips unlike, 1")  # fmt: skip
"""Simulated networks, and the start of the search in planted strengths."""
ERRORS, FASTER = TrajectoryErrors(correlation_time=30.0, position_wander=10.0), TrajectoryErrors(correlation_time=10.0)
BIAS, DRIFT = np.array([10.0] * 3 + [1e-4] * 3), np.array([1e-3] * 3 + [3.0 * PIXEL] * 3)
"""m and rad, sigmas of CTX images."""


class Planted(NamedTuple):
    """A network whose strengths are estimated, and its truth."""

    network: Network
    nodes: tuple[Array, ...]
    """Of each pass (k, 6) m and rad."""
    points: Array
    """(n, 3) m."""
    strengths: Array
    """(p, m) m or rad, of each axis of a process and pass."""


def hrsc(length: float, begin: float, seed: int) -> Planted:
    """A strip of a length in m."""
    settings = BlockSettings(passes=1, length=length, points=1600, spacing=5.0, terrain=None, errors=ERRORS)
    block = simulate_hrsc_block(settings, seed)
    sigmas = ERRORS.position_wander, ERRORS.attitude_wander
    position, attitude = (Process("gauss-markov", np.full(3, begin * sigma), 30.0, estimated=True) for sigma in sigmas)
    prior = ProcessPrior((position,), (attitude,), ERRORS.prior.bias, ERRORS.prior.drift)
    network = replace(block.network, passes=(replace(block.network.passes[0], prior=prior),))
    return Planted(network, (block.true_nodes(0),), block.true_points, np.repeat(sigmas, 3)[:, None])


def two_strips(wander: tuple[float, ...], seed: int) -> Planted:
    """Strips whose departures have strengths times `wander`; strengths of positions are known."""
    settings = BlockSettings(passes=2, length=150.0 * KM, points=800, spacing=3.0, terrain=None, errors=FASTER,
                             wander=wander)  # fmt: skip
    block = simulate_hrsc_block(settings, seed)
    moving, passes = Process("gauss-markov", np.full(3, FASTER.attitude_wander), 10.0, estimated=True), list[Pass]()
    for pass_, times in zip(block.network.passes, wander, strict=True):
        still = Process("gauss-markov", np.full(3, times * FASTER.position_wander), 10.0)
        prior = ProcessPrior((still,), (moving,), FASTER.prior.bias, FASTER.prior.drift)
        passes.append(replace(pass_, prior=prior))
    nodes = block.true_nodes(0), block.true_nodes(1)
    network, strengths = replace(block.network, passes=tuple(passes)), np.outer(moving.sigmas, wander)
    return Planted(network, nodes, block.true_points, strengths)


def ctx(same: bool, begin: float, seed: int) -> Planted:
    """A pair of one pixel's strength about each axis."""
    rng = np.random.default_rng([seed, 23])
    blank = simulate_ctx_pair(CtxSettings(ties=20), seed).network
    spans = [image_times(image) for image in blank.images]
    memory = 0.25 * (spans[0][1] - spans[0][0])
    still, moving = (Process("matern-3/2", np.full(3, sigma), memory) for sigma in (1e-3, PIXEL))
    prior = ProcessPrior((still,), (moving,), BIAS, DRIFT)
    nodes = [evenly_spaced("lagrange", image.trajectory.epoch, span, memory / 3.0)
             for image, span in zip(blank.images, spans, strict=True)]  # fmt: skip
    (first, first_bias), (second, second_bias) = (drawn(prior, some, rng) for some in nodes)
    if same:
        second[:, 3:] = first[:, 3:] + (second_bias - first_bias)[3:]
    truth = [TrueJitter(pass_correction(*pair), np.zeros((2, 2))) for pair in zip(nodes, (first, second), strict=True)]
    pair = simulate_ctx_pair(CtxSettings(ties=1000), seed, truth)
    uncertain = replace(prior, attitude=(replace(moving.scaled(np.full(3, begin)), estimated=True),))
    passes = [replace(p, nodes=some, prior=uncertain) for p, some in zip(pair.network.passes, nodes, strict=True)]
    network, strengths = replace(pair.network, passes=tuple(passes)), np.outer(moving.sigmas, [1.0, 1.0])
    return Planted(network, (first, second), pair.true_points, strengths)


def drawn(prior: ProcessPrior, nodes: OrientationImages, rng: np.random.Generator) -> tuple[Array, Array]:
    """Values (k, 6) of nodes, and the bias (6,) in them, drawn from a prior."""
    rows = list[Array]()
    edges = np.append(6 * np.arange(len(nodes) + 1), 6 * len(nodes) + prior.trend_sigmas.size)
    for unknowns, blocks, about in prior.factors(nodes):
        rows.append(np.zeros((len(about), edges[-1])))
        for unknown, block in zip(unknowns, blocks, strict=True):
            rows[-1][:, edges[unknown] : edges[unknown + 1]] = block
    values = np.linalg.solve(np.concatenate(rows), rng.standard_normal(edges[-1]))
    return values[: edges[-2]].reshape(-1, 6), values[edges[-2] : edges[-2] + 6]


def planted(case: str, seed: int) -> Planted:
    """The network of a case, and its truth."""
    name, begin = case.split(", ")
    if name.startswith("HRSC"):
        return hrsc(float(name.split()[1]) * KM, float(begin), seed)
    if name.startswith("Two"):
        return two_strips((1.0, 0.2 if name.endswith("unlike") else 1.0), seed)
    return ctx(name.endswith("same motion"), float(begin), seed)


def one_draw(case: str, seed: int) -> Draw:
    """Strengths over planted ones, with the deviation of their logarithm, by axis and pass; NEES of nodes and points
    with uncertain strengths, and with the estimates as exact; of two strips also NEES of the nodes of each pass, and
    that of strengths in common.
    """
    truth, settings, start = planted(case, seed), SolverSettings(starts=0), time.perf_counter()
    result = estimated_strengths(truth.network, settings)
    seconds = time.perf_counter() - start
    solutions = result.solution, adjust_network(result.network, settings)
    pairs = [(s, float(b)) for s, b in zip(
        [s for s in result.strengths for _ in s.members], truth.strengths.ravel(), strict=True)]  # fmt: skip
    draw = {
        "ratios": [s.sigma / b for s, b in pairs], "errors": [s.error for s, _ in pairs],
        "seen": [s.seen for s, _ in pairs], "below": [b < s.interval[1] for s, b in pairs],
        "same_motion": result.same_motion, "nodes": [of_nodes(s, truth.nodes) for s in solutions],
        "points": [of_points(s, truth.points) for s in solutions], "seconds": seconds,
    }  # fmt: skip
    if case.startswith("Two"):
        same = estimated_strengths(truth.network, settings, in_common=True)
        draw["differ"] = len(result.strengths) > len(same.strengths)
        draw["passes"] = [
            [of_nodes(r.solution, truth.nodes, slice(k, k + 1)) for k in range(2)] for r in (result, same)
        ]
    return draw


def of_nodes(solution: Solution, true: Sequence[Array], passes: slice = slice(None)) -> float:
    """NEES of all nodes of passes jointly, each component."""
    pairs = solution.network.numbered_passes[passes]
    variables = [first + k for pass_, first in pairs for k in range(len(pass_.nodes))]
    error = np.concatenate([(a - b).ravel() for a, b in zip(solution.nodes[passes], true[passes], strict=True)])
    return float(error @ np.linalg.solve(solution.joint_covariance.of(variables), error)) / error.size


def of_points(solution: Solution, true: Array) -> float:
    """NEES of single points, each coordinate."""
    determined = solution.determined
    return float(nees((solution.places - true)[determined], solution.covariances[determined]).mean()) / 3.0


def judge(draws: list[Draw]) -> Blocks:
    """The tables: of all cases but two strips, and of these by pass."""
    rows, of_two = list[list[str]](), list[list[str]]()
    for name in names_of(draws):
        of_case = cases(draws, name)
        ratios, errors, clear, below, nodes, points = (
            np.array([d[key] for d in of_case]) for key in ("ratios", "errors", "seen", "below", "nodes", "points")
        )
        seconds = number(float(np.mean([draw["seconds"] for draw in of_case])))
        if "passes" in of_case[0]:
            differ, nees_of = f"{np.mean([d['differ'] for d in of_case]):.0%}", np.array([d["passes"] for d in of_case])
            for k in range(nees_of.shape[2]):
                figures = of_clear(*(some[:, k::nees_of.shape[2]] for some in (ratios, errors, clear)))
                cells = [nees_cell(some) for some in nees_of[:, :, k].T]
                of_two.append([name, str(k + 1), str(len(of_case)), differ, *figures, *cells, seconds])
            continue
        cells = [nees_cell(some) for some in (*nodes.T, *points.T)]
        rows.append([name, str(len(of_case)), *of_clear(ratios, errors, clear), f"{below.mean():.0%}", *cells, seconds])
    head = ["case, begin", "draws", "found / planted", "z rms", "seen", "below limit", "NEES of nodes", "plugged in",
            "NEES of points", "plugged in", "s"]  # fmt: skip
    head_of_two = ["case, begin", "pass", "draws", "differ", "found / planted", "z rms", "seen", "NEES of nodes",
                   "in common", "s"]  # fmt: skip
    sections = (("strengths", head, rows), ("passes", head_of_two, of_two))
    return {name: table(columns, some) for name, columns, some in sections if some}


def of_clear(ratios: Array, errors: Array, clear: Mask) -> list[str]:
    """For strengths that are seen: geometric mean of found over planted, z rms; and their share."""
    logs = np.log(ratios)[clear]
    values = [np.exp(np.mean(logs)), np.sqrt(np.mean((logs / errors[clear]) ** 2))] if logs.size else [np.nan] * 2
    return [*(number(float(value)) for value in values), f"{clear.mean():.0%}"]


if __name__ == "__main__":
    sys.exit(run(seeds_of(__doc__, CASES, 20, "evidence_passes.md#process_strengths"), one_draw, judge))
