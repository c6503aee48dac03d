"""What does a long strip cost, against its length and against its orientation images?

    python scripts/benchmark_nodes.py [--length 4000] [--nodes 1600] [--out docs/node_cost.md]

A simulated HRSC strip of five lines, its prior a Matern 3/2 process beside bias and drift, adjusted whole by
`adjust_network`: first longer and longer with nodes 2.9 s apart, then one length with more and more nodes; six
points a km, so that the rays grow with the length alone. Seconds are of the processor; the machine was shared.

* *reach*: nodes that a point joins with one of its nodes. A point is seen in five lines, up to 90 s apart: with nodes
  closer together more of them lie between. *work*: multiplications of one Cholesky factor, 10^9.
* *factor*: of the reduced normal matrix, once. *total*: `adjust_network`, from the network to all covariances;
  *iteration*: that over its iterations.
* *exponent*: slope of the logarithm from the row before; 1 is linear in the column that grows.

Along the strip the cost is linear: 8 times the length, 8 times the seconds. Of one length the factor alone isn't linear
in the nodes: each is joined with all within 90 s, and so the factor takes nodes times reach squared, by nature; up to
1,600 nodes the points still cost more than it does.
"""

import sys
import time
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np
from study import DOCS, OneLine, at_least, command, machine, made_with, number, positive, show, table, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.graph import BundleGraph, lay_out
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.network import Network, Process, ProcessPrior
from mgsgraph.simulation.hrsc_block import BlockSettings, TrajectoryErrors, simulate_hrsc_block
from mgsgraph.units import KM

SPACING = 2.9
"""s between nodes, at most, where the length grows."""
POINTS = 6.0
"""A km."""
HEAD = ("km", "nodes", "rays", "reach", "work", "factor, s", "iteration, s", "total, s", "iterations",
        "exponent of iteration", "exponent of total")  # fmt: skip
Row = dict[str, float]


def strip(length: float, spacing: float) -> Network:
    """One of a length in m, with nodes that are at most `spacing` s apart; the truth has its own, 10 s apart."""
    settings = BlockSettings(strips=1, length=length, points=int(POINTS * length / KM), spacing=spacing,
                             true_spacing=10.0, terrain=None)  # fmt: skip
    network, errors = simulate_hrsc_block(settings, 1).network, TrajectoryErrors()
    parts = [
        (Process("matern-3/2", np.full(3, sigma), errors.correlation_time),)
        for sigma in (errors.position_wander, errors.attitude_wander)
    ]
    prior = ProcessPrior(*parts, errors.prior.bias, errors.prior.drift)
    return replace(network, passes=(replace(network.passes[0], prior=prior),))


def measured(length: float, spacing: float) -> Row:
    """Seconds and sizes of one strip."""
    network, settings = strip(length, spacing), SolverSettings()
    layout = lay_out(network, settings)
    graph = BundleGraph(layout)
    reduction = graph.reduction(np.zeros(layout.columns))
    work = layout.cholesky._operations / 1e9
    graph.factor(reduction)
    begin = time.process_time()
    graph.factor(reduction)
    factor = time.process_time() - begin
    begin = time.process_time()
    solution = adjust_network(network, settings)
    total = time.process_time() - begin
    nodes = len(network.passes[0].nodes)
    return {
        "km": length / KM, "nodes": nodes, "rays": network.rays.point.size,
        "reach": layout.blocks.first.size / nodes, "work": work, "factor": factor,
        "iteration": total / solution.iterations, "total": total, "iterations": solution.iterations,
    }  # fmt: skip


def cells(found: list[Row], grows: str) -> list[list[str]]:
    """Rows of a table; `grows` is what the exponents are of."""
    rows = []
    for before, run in zip([None, *found], found, strict=False):
        mine = [f"{run['km']:,.0f}", f"{run['nodes']:.0f}", f"{run['rays']:,.0f}", f"{run['reach']:.0f}"]
        mine += [number(run[key]) for key in ("work", "factor", "iteration", "total")]
        step = np.log(run[grows] / before[grows]) if before else np.nan
        slopes = [np.log(run[key] / before[key]) / step if before else np.nan for key in ("iteration", "total")]
        rows.append([*mine, f"{run['iterations']:.0f}", *("" if np.isnan(one) else f"{one:.2f}" for one in slopes)])
    return rows


def page(chosen: Namespace) -> str:
    """A table for each of the two questions."""
    measured(100.0 * KM, SPACING)  # numba compiles
    longest = chosen.length * KM
    shares, found = (0.125, 0.25, 0.5, 1.0), list[list[Row]]()
    show("the longest strip")
    span = float(np.ptp(strip(longest, 50.0).passes[0].nodes.times))
    halves = range(int(np.log2(chosen.nodes / 200.0)), -1, -1)
    wanted = [[(share * longest, SPACING) for share in shares],
              [(longest, span / (chosen.nodes / 2**k - 1.5)) for k in halves]]  # fmt: skip
    for group in wanted:
        found.append([])
        for length, spacing in group:
            show(f"{length / KM:g} km, {spacing:.2f} s")
            found[-1].append(measured(length, spacing))
            print(found[-1][-1], file=sys.stderr, flush=True)
    words = (__doc__ or "").split("\n\n", 2)[2].strip()
    return "\n".join([
        "# What a long strip costs", "", f"Made by `scripts/benchmark_nodes.py`. {words}", "",
        "## Longer strips, nodes as close", "", *table(HEAD, cells(found[0], "km")), "",
        "## More nodes, strips as long", "", *table(HEAD, cells(found[1], "nodes")), "",
        f"{machine()}. {made_with()}", "",
    ])  # fmt: skip


def main(parser: OneLine, given: list[str]) -> int:
    """The whole command."""
    parser.add_argument("--length", type=positive, default=4000.0, help="km, the longest")
    parser.add_argument("--nodes", type=at_least(200), default=1600, help="the most")
    parser.add_argument("--out", type=Path, default=DOCS / "node_cost.md")
    chosen = parser.parse_args(given)
    return write_page(parser, chosen.out, lambda: page(chosen))


if __name__ == "__main__":
    sys.exit(main(command(__doc__), sys.argv[1:]))
