"""Are strengths of processes found, are their errors true, and are sigmas that follow from them? Many simulated draws.

HRSC: strips of five lines whose position and attitude depart by Gauss-Markov processes of 30 s. CTX: pairs whose
attitude departs by a Matern process of a quarter of the images' time, drawn from the model for each image, or the same
in both (`alike`). Two strips: short ones whose attitude departs by Gauss-Markov processes of 10 s, of one strength, or
(`unlike`) the second of a fifth of it. The search begins where the case says, in planted strengths.

    python scripts/process_strengths.py [--cases CASE ...] [--seeds 20] [--first 1] [--processes N] [--out FILE]

Fills docs/evidence_passes.md. Exit status: 0 done, 2 bad input.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
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
from mgsgraph.simulation.ctx import PIXEL, CtxSettings, TrueJitter, image_times, simulate_ctx_pair
from mgsgraph.simulation.demo.demonstration import nees
from mgsgraph.simulation.hrsc_block import BlockSettings, TrajectoryErrors, simulate_hrsc_block
from mgsgraph.simulation.hrsc_flight import strip_correction
from mgsgraph.units import KM

CASES = ("HRSC 600 km, 3", "HRSC 300 km, 3", "CTX pair, 1", "CTX pair, 3", "CTX alike, 1", "CTX alike, 3",
         "Two strips, 1", "Two strips unlike, 1")  # fmt: skip
"""What is simulated, and where the search begins, in planted strengths."""
ERRORS, FASTER = TrajectoryErrors(correlation_time=30.0, position_wander=10.0), TrajectoryErrors(correlation_time=10.0)
BIAS, DRIFT = np.array([10.0] * 3 + [1e-4] * 3), np.array([1e-3] * 3 + [3.0 * PIXEL] * 3)
"""m and rad, sigmas of CTX images."""


class Planted(NamedTuple):
    """A network whose strengths are asked for, and its truth."""

    network: Network
    nodes: tuple[Array, ...]
    """Of each pass (k, 6) m and rad."""
    points: Array
    """(n, 3) m."""
    strengths: Array
    """(p, m) m or rad, of each axis of a process and pass."""


def hrsc(length: float, begin: float, seed: int) -> Planted:
    """A strip of a length in m."""
    settings = BlockSettings(strips=1, length=length, points=1600, spacing=5.0, terrain=None, errors=ERRORS)
    made = simulate_hrsc_block(settings, seed)
    sigmas = ERRORS.position_wander, ERRORS.attitude_wander
    one, other = (Process("gauss-markov", np.full(3, begin * sigma), 30.0, estimated=True) for sigma in sigmas)
    prior = ProcessPrior((one,), (other,), ERRORS.prior.bias, ERRORS.prior.drift)
    network = replace(made.network, passes=(replace(made.network.passes[0], prior=prior),))
    return Planted(network, (made.true_nodes(0),), made.true_points, np.repeat(sigmas, 3)[:, None])


def two_strips(wander: tuple[float, ...], seed: int) -> Planted:
    """Strips whose departures are times `wander`; those of positions are known."""
    settings = BlockSettings(strips=2, length=150.0 * KM, points=800, spacing=3.0, terrain=None, errors=FASTER,
                             wander=wander)  # fmt: skip
    made = simulate_hrsc_block(settings, seed)
    moving, passes = Process("gauss-markov", np.full(3, FASTER.attitude_wander), 10.0, estimated=True), list[Pass]()
    for one, times in zip(made.network.passes, wander, strict=True):
        still = Process("gauss-markov", np.full(3, times * FASTER.position_wander), 10.0)
        prior = ProcessPrior((still,), (moving,), FASTER.prior.bias, FASTER.prior.drift)
        passes.append(replace(one, prior=prior))
    nodes = made.true_nodes(0), made.true_nodes(1)
    network, strengths = replace(made.network, passes=tuple(passes)), np.outer(moving.sigmas, wander)
    return Planted(network, nodes, made.true_points, strengths)


def ctx(alike: bool, begin: float, seed: int) -> Planted:
    """A pair of one pixel's strength about each axis."""
    rng = np.random.default_rng([seed, 23])
    blank = simulate_ctx_pair(CtxSettings(ties=20), seed).network
    spans = [image_times(one) for one in blank.images]
    memory = 0.25 * (spans[0][1] - spans[0][0])
    still, moving = (Process("matern-3/2", np.full(3, sigma), memory) for sigma in (1e-3, PIXEL))
    prior = ProcessPrior((still,), (moving,), BIAS, DRIFT)
    nodes = [evenly_spaced("lagrange", one.trajectory.epoch, span, memory / 3.0)
             for one, span in zip(blank.images, spans, strict=True)]  # fmt: skip
    (first, one), (second, other) = (drawn(prior, some, rng) for some in nodes)
    if alike:
        second[:, 3:] = first[:, 3:] + (other - one)[3:]
    truth = [TrueJitter(strip_correction(*pair), np.zeros((2, 2))) for pair in zip(nodes, (first, second), strict=True)]
    made = simulate_ctx_pair(CtxSettings(ties=1000), seed, truth)
    asked = replace(prior, attitude=(replace(moving.scaled(np.full(3, begin)), estimated=True),))
    passes = [replace(one, nodes=some, prior=asked) for one, some in zip(made.network.passes, nodes, strict=True)]
    network, strengths = replace(made.network, passes=tuple(passes)), np.outer(moving.sigmas, [1.0, 1.0])
    return Planted(network, (first, second), made.true_points, strengths)


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
    """What a case is."""
    what, begin = case.split(", ")
    if what.startswith("HRSC"):
        return hrsc(float(what.split()[1]) * KM, float(begin), seed)
    if what.startswith("Two"):
        return two_strips((1.0, 0.2 if what.endswith("unlike") else 1.0), seed)
    return ctx(what.endswith("alike"), float(begin), seed)


def one_draw(case: str, seed: int) -> Draw:
    """Strengths over planted ones, with the deviation of their logarithm, by axis and pass; NEES of nodes and points
    with uncertain strengths, and with them plugged in as found; of two strips also NEES of the nodes of each pass, and
    that of strengths in common.
    """
    truth, settings, start = planted(case, seed), SolverSettings(starts=0), time.perf_counter()
    found = estimated_strengths(truth.network, settings)
    seconds = time.perf_counter() - start
    both = found.solution, adjust_network(found.network, settings)
    every = [(one, float(b)) for one, b in zip(
        [one for one in found.strengths for _ in one.members], truth.strengths.ravel(), strict=True)]  # fmt: skip
    draw = {
        "ratios": [one.sigma / b for one, b in every], "errors": [one.error for one, _ in every],
        "seen": [one.seen for one, _ in every], "below": [b < one.interval[1] for one, b in every],
        "alike": found.alike, "nodes": [of_nodes(one, truth.nodes) for one in both],
        "points": [of_points(one, truth.points) for one in both], "seconds": seconds,
    }  # fmt: skip
    if case.startswith("Two"):
        same = estimated_strengths(truth.network, settings, in_common=True)
        draw["differ"] = len(found.strengths) > len(same.strengths)
        draw["passes"] = [
            [of_nodes(one.solution, truth.nodes, slice(k, k + 1)) for k in range(2)] for one in (found, same)
        ]
    return draw


def of_nodes(solution: Solution, true: Sequence[Array], passes: slice = slice(None)) -> float:
    """NEES of all nodes of passes jointly, each component."""
    pairs = solution.network.numbered_passes[passes]
    variables = [first + k for one, first in pairs for k in range(len(one.nodes))]
    error = np.concatenate([(a - b).ravel() for a, b in zip(solution.nodes[passes], true[passes], strict=True)])
    return float(error @ np.linalg.solve(solution.joint_covariance.of(variables), error)) / error.size


def of_points(solution: Solution, true: Array) -> float:
    """NEES of single points, each coordinate."""
    mine = solution.determined
    return float(nees((solution.places - true)[mine], solution.covariances[mine]).mean()) / 3.0


def judge(every: list[Draw]) -> Blocks:
    """The tables: of all cases but two strips, and of these by pass."""
    rows, of_two = list[list[str]](), list[list[str]]()
    for name in names_of(every):
        mine = cases(every, name)
        ratios, errors, seen, below, nodes, points = (
            np.array([draw[key] for draw in mine]) for key in ("ratios", "errors", "seen", "below", "nodes", "points")
        )
        seconds = number(float(np.mean([draw["seconds"] for draw in mine])))
        if "passes" in mine[0]:
            differ, nees_of = f"{np.mean([draw['differ'] for draw in mine]):.0%}", np.array([d["passes"] for d in mine])
            for k in range(nees_of.shape[2]):
                found = of_seen(*(some[:, k::nees_of.shape[2]] for some in (ratios, errors, seen)))
                cells = [nees_cell(some) for some in nees_of[:, :, k].T]
                of_two.append([name, str(k + 1), str(len(mine)), differ, *found, *cells, seconds])
            continue
        cells = [nees_cell(some) for some in (*nodes.T, *points.T)]
        rows.append([name, str(len(mine)), *of_seen(ratios, errors, seen), f"{below.mean():.0%}", *cells, seconds])
    head = ["case, begin", "draws", "found / planted", "z rms", "seen", "below limit", "NEES of nodes", "plugged in",
            "NEES of points", "plugged in", "s"]  # fmt: skip
    head_of_two = ["case, begin", "pass", "draws", "differ", "found / planted", "z rms", "seen", "NEES of nodes",
                   "in common", "s"]  # fmt: skip
    every_table = (("strengths", head, rows), ("passes", head_of_two, of_two))
    return {name: table(columns, some) for name, columns, some in every_table if some}


def of_seen(ratios: Array, errors: Array, seen: Mask) -> list[str]:
    """Of strengths that are seen: geometric mean of found over planted, z rms; and their share."""
    logs = np.log(ratios)[seen]
    values = [np.exp(np.mean(logs)), np.sqrt(np.mean((logs / errors[seen]) ** 2))] if logs.size else [np.nan] * 2
    return [*(number(float(one)) for one in values), f"{seen.mean():.0%}"]


if __name__ == "__main__":
    sys.exit(run(seeds_of(__doc__, CASES, 20, "evidence_passes.md#process_strengths"), one_draw, judge))
