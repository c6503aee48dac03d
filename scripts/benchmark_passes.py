"""What does one more image of a long strip cost, on a trajectory that goes on with it?

    python scripts/benchmark_passes.py [--cuts 8] [--length 1200] [--out docs/pass_cost.md]

A simulated HRSC strip, each of its five lines cut into segments, which come one after the other in the order of their
times. The first one brings the pass, with orientation images over its own lines alone; each of the others continues
them. In the table, for every k-th image: processor time of `IncrementalAdjustment.add`, and what it had to do. Two
trajectories: one that forgets its errors within a few seconds and has no error in common, and Mars Express's, with a
bias and a drift that the whole strip shares.

It is not flat up to 40 images: along a strip without horizontal control each addition moves all points by more than
0.01 of their sigma, and all that move are placed anew. What it costs goes with the points that it moves, some 0.3 to
0.4 ms each.
"""

import statistics
import sys
import time
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np
from study import DOCS, OneLine, at_least, command, machine, made_with, positive, show, table, write_page

from mgsgraph.incremental.incremental import IncrementalAdjustment
from mgsgraph.network import Network
from mgsgraph.network.joining import seconds
from mgsgraph.network.parts import without_images
from mgsgraph.simulation.hrsc_block import BlockSettings, TerrainErrors, TrajectoryErrors, simulate_hrsc_block
from mgsgraph.simulation.segments import in_segments
from mgsgraph.units import KM, MGON

FORGETFUL = TrajectoryErrors(0.0, 0.0, 10.0 * MGON, 0.0, 0.0, 20.0, 5.0)
TRAJECTORIES = {"forgets its errors in 5 s": FORGETFUL, "has a bias and a drift": TrajectoryErrors()}
_HEAD = (("image", "orientation images", "reached", "points moved", "systems made", "one addition (s)"),)


def pieces(network: Network) -> list[Network]:
    """What each image sees by itself, in the order of time; the nodes of its pass are those that it needs."""
    images = sorted(network.images, key=lambda image: sum(seconds(image)))
    names, found = {image.name for image in images}, list[Network]()
    for image in images:
        one = without_images(network, names - {image.name})
        assert one is not None
        (own,) = one.passes
        start, stop = (edge - own.nodes.epoch for edge in seconds(image))
        found.append(replace(one, passes=(replace(own, nodes=own.nodes.over(start, stop)),)))
    return found


def grown(network: Network, what: str) -> list[list[str]]:
    """A row for each image."""
    adjustment, rows, spent = IncrementalAdjustment(), list[list[str]](), list[float]()
    every = pieces(network)
    for k, one in enumerate(every, 1):
        show(f"{what}: image {k} of {len(every)}")
        began = time.process_time()
        impact = adjustment.add(one)
        spent.append(time.process_time() - began)
        nodes = len(adjustment.store.definitions().passes[network.passes[0].name].nodes)
        moved = int(np.count_nonzero(~impact.points.new))
        last = statistics.median(spent[-5:])
        rows.append([str(k), str(nodes), str(len(impact.images.names)), str(moved), str(impact.systems), f"{last:.2f}"])
    return rows


def page(chosen: Namespace) -> str:
    """A table for each trajectory."""
    lines = ["# One more image of a long strip", "", *(__doc__ or "").split("\n\n", 2)[2].strip().split("\n"), ""]
    for what, errors in TRAJECTORIES.items():
        terrain = TerrainErrors(planimetric=0.0)
        settings = BlockSettings(strips=1, length=chosen.length * KM, points=chosen.points, terrain=terrain,
                                 spacing=chosen.spacing, errors=errors)  # fmt: skip
        network = in_segments(simulate_hrsc_block(settings, seed=chosen.seed).network, chosen.cuts)
        rows = grown(network, what)
        lines += [f"## A trajectory that {what}", "", *table(_HEAD[0], [rows[k] for k in _shown(len(rows))]), ""]
    words = (
        f"Time is the median of the last five additions, of one processor. {chosen.length:g} km, {chosen.points} "
        f"points, {chosen.spacing:g} s between orientation images, a terrain model good to 10 m, seed {chosen.seed}."
    )
    return "\n".join([*lines, words, "", f"{machine()}. {made_with()}", ""])


def _shown(count: int) -> list[int]:
    """Rows that are shown: every fourth, and the last one."""
    return sorted({1, *range(3, count, 4), count - 1})


def main(parser: OneLine, given: list[str]) -> int:
    """The whole command."""
    parser.add_argument("--cuts", type=at_least(1), default=8, help="segments of each of the five lines")
    parser.add_argument("--length", type=positive, default=1200.0, help="km")
    parser.add_argument("--points", type=at_least(100), default=4000)
    parser.add_argument("--spacing", type=positive, default=10.0, help="s between orientation images")
    parser.add_argument("--seed", type=at_least(0), default=1)
    parser.add_argument("--out", type=Path, default=DOCS / "pass_cost.md")
    chosen = parser.parse_args(given)
    return write_page(parser, chosen.out, lambda: page(chosen))


if __name__ == "__main__":
    sys.exit(main(command(__doc__), sys.argv[1:]))
