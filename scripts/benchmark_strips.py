"""What do strips with orientation images cost? Seconds per iteration and memory against points and against nodes.

Simulates blocks of HRSC strips in five stereo lines and adjusts each, without terrain, in a process of its own: first
more and more points on the same nodes, then more and more nodes on the same points. Both should grow linearly; the
reduced normal matrix must stay sparse.
"""

import json
import statistics
import subprocess
import sys
import time
from argparse import Namespace
from pathlib import Path

import numpy as np
from study import DOCS, OneLine, at_least, machine, made_with, number, positive, show, status, table, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.graph import BundleGraph, lay_out
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError
from mgsgraph.network import Network
from mgsgraph.simulation.hrsc_block import BlockSettings, simulate_hrsc_block
from mgsgraph.units import KM

PAGE = "strips_cost.md"
SHARES = (0.25, 0.5, 1.0)
"""Of the points, and of the nodes."""
ITERATIONS = 7
"""Timed one after the other, from the nominal orientation; their median counts."""
WORDS = """# What strips with orientation images cost

Made by `scripts/benchmark.py strips`: simulated HRSC strips (`mgsgraph.simulation.hrsc_block`), five stereo lines each,
most points in five lines, those in the overlap of two strips in up to ten; cubic Lagrange between the nodes; without a
terrain model. Each row is the median of {repeat} processes. The machine was shared; compare ratios, not seconds.

* *iteration*: all points solved and eliminated (*sweep*), the reduced system formed and solved by GTSAM.
* *covariance*: of all nodes, and the 3x3 of every point.
* *memory*: the highest during set-up, solve and covariance, beside the network itself.
* *sets*: sets of nodes that some points share; *fill*: share of all pairs of nodes whose block isn't zero.
* *exponent*: slope of the logarithm of the seconds of an iteration (of the megabytes) from the row before: 1 is linear.
"""


def resident(key: str) -> float:
    """MB that this process holds now (VmRSS) or held at most since it was last asked to forget (VmHWM)."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith(key + ":")) / 1024.0


def measured(network: Network) -> dict[str, float]:
    """Seconds and megabytes of one network."""
    settings = SolverSettings()
    Path("/proc/self/clear_refs").write_text("5")  # forget the highest
    before, begin = resident("VmRSS"), time.perf_counter()
    layout = lay_out(network, settings)
    found = {"set up": time.perf_counter() - begin}
    graph, nominal = BundleGraph(layout), np.zeros(layout.columns)
    last = graph.reduction(nominal)
    sweeps, whole = [], []
    for _ in range(ITERATIONS):
        begin = time.perf_counter()
        last = graph.reduction(nominal, points=last)
        sweeps.append(time.perf_counter() - begin)
        graph.factor(last).solve(-graph.gradient(last))
        whole.append(time.perf_counter() - begin)
    found |= {"sweep": statistics.median(sweeps), "iteration": statistics.median(whole)}
    nodes = sum(len(strip.nodes) for strip in network.passes)
    found |= {"sets": len(layout.group_variables), "fill": layout.blocks.first.size / (0.5 * nodes * (nodes + 1))}
    del last, graph, layout
    solution = adjust_network(network, settings)
    found |= {"covariance": solution.seconds["covariance"], "iterations": solution.iterations}
    found |= {"memory": resident("VmHWM") - before, "nodes": nodes, "points": len(network.points)}
    return found | {"rays": network.rays.point.size}


def one(strips: int, points: int, spacing: float, length: float) -> dict[str, float]:
    """The same in a process of its own."""
    wanted = {"strips": strips, "points": points, "spacing": spacing, "length": length}
    options = [text for name, value in wanted.items() for text in (f"--{name}", str(value))]
    command = [sys.executable, sys.argv[0], "strips", *options, "--one"]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    if ended.returncode:
        raise InputError(f"{points} points, {spacing} s", ended.stderr.strip()[-300:] or "a crash", "a run that ends")
    found: dict[str, float] = json.loads(ended.stdout.splitlines()[-1])
    return found


def rows_of(found: list[dict[str, float]], grows: str) -> list[list[str]]:
    """Cells of a table; `grows` is what the exponents are of."""
    rows = []
    for k, run in enumerate(found):
        cells = [f"{run['points']:,.0f}", f"{run['rays']:,.0f}", f"{run['nodes']:.0f}"]
        cells += [number(run[key]) for key in ("set up", "sweep", "iteration", "covariance")]
        cells += [f"{run['memory']:.0f}", f"{run['sets']:,.0f}", f"{100.0 * run['fill']:.1f} %"]
        rows.append(cells + [_exponent(found, k, grows, key) for key in ("iteration", "memory")])
    return rows


def _exponent(found: list[dict[str, float]], k: int, grows: str, key: str) -> str:
    if k == 0:
        return ""
    before, run = found[k - 1], found[k]
    return f"{np.log(run[key] / before[key]) / np.log(run[grows] / before[grows]):.2f}"


def page(by_points: list[dict[str, float]], by_nodes: list[dict[str, float]], title: str, repeat: int) -> str:
    """The page."""
    head = ("points", "rays", "nodes", "set up, s", "sweep, s", "iteration, s", "covariance, s", "memory, MB", "sets",
            "fill", "exponent, s", "exponent, MB")  # fmt: skip
    return "\n".join([
        WORDS.format(repeat=repeat), f"{title}. {machine()}.\n", "## More points\n",
        *table(head, rows_of(by_points, "points")), "", "## More nodes\n", *table(head, rows_of(by_nodes, "nodes")), "",
        made_with(), "",
    ])  # fmt: skip


def whole_page(chosen: Namespace) -> str:
    """All processes, and their page."""
    wanted = [(int(share * chosen.points), chosen.spacing) for share in SHARES]
    wanted += [(chosen.points, chosen.spacing / share) for share in SHARES[:-1]]
    found = {}
    for points, spacing in wanted:
        runs = []
        for turn in range(chosen.repeat):
            show(f"{points:,} points, {spacing:g} s, process {turn + 1} of {chosen.repeat}")
            runs.append(one(chosen.strips, points, spacing, chosen.length))
        found[points, spacing] = {key: statistics.median(run[key] for run in runs) for key in runs[0]}
    by_points = [found[points, chosen.spacing] for points, _ in wanted[: len(SHARES)]]
    by_nodes = [found[one] for one in wanted[len(SHARES) :]] + by_points[-1:]
    return page(by_points, by_nodes, f"{chosen.strips} strips of {chosen.length:g} km", chosen.repeat)


def main(parser: OneLine, given: list[str]) -> int:
    """`benchmark.py strips`."""
    parser.add_argument("--strips", type=at_least(1), default=10)
    parser.add_argument("--points", type=at_least(100), default=200_000, help="the most")
    parser.add_argument("--spacing", type=positive, default=13.5, help="s between nodes, the least")
    parser.add_argument("--length", type=positive, default=2000.0, help="km that a strip is long")
    parser.add_argument("--repeat", type=at_least(1), default=3, help="processes of each row")
    parser.add_argument("--out", type=Path, default=DOCS, help="folder of the page")
    parser.add_argument("--one", action="store_true", help="measure this one, and print it as JSON")
    chosen = parser.parse_args(given)
    if not chosen.one:
        return write_page(parser, chosen.out / PAGE, lambda: whole_page(chosen))
    settings = BlockSettings(
        strips=chosen.strips, points=chosen.points, spacing=chosen.spacing, terrain=None, length=chosen.length * KM
    )
    return status(parser.prog, lambda: print(json.dumps(measured(simulate_hrsc_block(settings, 1).network))))
