"""What does one more image of a long strip cost, on a trajectory that goes on with it?

    python scripts/benchmark_passes.py [--cuts 12] [--length 1800] [--out docs/pass_cost.md]

A simulated HRSC strip, each of its five lines cut into segments, which come one after the other in the order of their
times. The first one brings the pass, with orientation images over its own lines alone; each of the others continues
them. In the table, for every k-th image: processor time of `IncrementalAdjustment.add`, and what it had to do. Two
trajectories: one that forgets its errors within a few seconds and has no error in common, and Mars Express's, with a
bias and a drift that the whole strip shares.

What an addition costs goes with the points that it moves. That these are many is no matter of the algorithm: there is
no horizontal control, and tie points chain neighbouring orientation images far better than the trajectory knows them,
so that what a new image says of the trajectory reaches far along the strip, whatever the trajectory itself forgets.
*Moves over distance* are the median moves of old points, in their sigmas, when the last image comes. All of them that
move by more than 0.01 of a sigma are placed anew: up to 60 images the time still grows with their number.
"""

import statistics
import sys
import time
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np
from study import DOCS, OneLine, at_least, command, machine, made_with, positive, show, table, write_page

from mgsgraph.adjustment.incremental.impact import Impact
from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network
from mgsgraph.network.joining import seconds
from mgsgraph.network.parts import without_images
from mgsgraph.simulation.hrsc_block import BlockSettings, TerrainErrors, TrajectoryErrors, simulate_hrsc_block
from mgsgraph.simulation.strip_truth import in_segments
from mgsgraph.units import KM, MGON

FORGETFUL = TrajectoryErrors(0.0, 0.0, 10.0 * MGON, 0.0, 0.0, 20.0, 5.0)
TRAJECTORIES = {"forgets its errors in 5 s": FORGETFUL, "has a bias and a drift": TrajectoryErrors()}
_FAR = ("distance (km)", "old points", "moved", "median move (sigmas)", "(m)")
_CLASS = 200
"""km, of distances that are taken together."""
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


def grown(network: Network, what: str) -> tuple[list[list[str]], list[list[str]]]:
    """A row for each image, and the moves over distance that the last one makes."""
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
    return rows, moves(adjustment, every[-1], impact)


def moves(adjustment: IncrementalAdjustment, last: Network, impact: Impact) -> list[list[str]]:
    """Median moves of old points, by their distance (km) from the middle of what the last image sees; a point that is
    not among those of the impact has moved by less than is noticed, and counts as zero.
    """
    names, places, _ = adjustment.points()
    moved = {name: (sigmas, float(np.linalg.norm(move))) for name, sigmas, move, new in zip(
        impact.points.ids, impact.points.in_sigmas.tolist(), impact.points.moves, impact.points.new, strict=True
    ) if not new}  # fmt: skip
    new = {name for name, fresh in zip(impact.points.ids, impact.points.new.tolist(), strict=True) if fresh}
    seen = set(last.points.ids)
    middle = np.nanmean(places[[name in seen for name in names]], axis=0)
    old = np.array([name not in new for name in names]) & np.isfinite(places[:, 0])
    distance = np.linalg.norm(places - middle, axis=1) / KM
    size: Array = np.array([moved.get(name, (0.0, 0.0)) for name in names])
    rows = list[list[str]]()
    for begin in range(0, int(distance[old].max()) + 1, _CLASS):
        mine = old & (distance >= begin) & (distance < begin + _CLASS)
        if np.any(mine):
            (sigmas, metres), share = np.median(size[mine], axis=0).tolist(), np.mean(size[mine, 0] > 0.0)
            here = f"{begin}-{begin + _CLASS}"
            rows.append([here, str(mine.sum()), f"{share:.0%}", f"{sigmas:.3f}", f"{metres:.2f}"])
    return rows


def page(chosen: Namespace) -> str:
    """A table for each trajectory."""
    lines = ["# One more image of a long strip", "", *(__doc__ or "").split("\n\n", 2)[2].strip().split("\n"), ""]
    for what, errors in TRAJECTORIES.items():
        terrain = TerrainErrors(planimetric=0.0)
        settings = BlockSettings(strips=1, length=chosen.length * KM, points=chosen.points, terrain=terrain,
                                 spacing=chosen.spacing, errors=errors)  # fmt: skip
        network = in_segments(simulate_hrsc_block(settings, seed=chosen.seed).network, chosen.cuts)
        rows, by_distance = grown(network, what)
        lines += [f"## A trajectory that {what}", "", *table(_HEAD[0], [rows[k] for k in _shown(len(rows))]), ""]
        lines += ["Moves over distance:", "", *table(_FAR, by_distance), ""]
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
    parser.add_argument("--cuts", type=at_least(1), default=12, help="segments of each of the five lines")
    parser.add_argument("--length", type=positive, default=1800.0, help="km")
    parser.add_argument("--points", type=at_least(100), default=6000)
    parser.add_argument("--spacing", type=positive, default=10.0, help="s between orientation images")
    parser.add_argument("--seed", type=at_least(0), default=1)
    parser.add_argument("--out", type=Path, default=DOCS / "pass_cost.md")
    chosen = parser.parse_args(given)
    return write_page(parser, chosen.out, lambda: page(chosen))


if __name__ == "__main__":
    sys.exit(main(command(__doc__), sys.argv[1:]))
