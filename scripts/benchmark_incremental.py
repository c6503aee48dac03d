"""What does adding one image cost, and is the result that of batch?

Takes a simulated strip image by image through `IncrementalAdjustment`. Two tables, docs/incremental_cost.md by default:
`--equality N`: after each of N additions the largest difference from batch over the same images, in sigmas; and once
more after the closing check. `--cost N N ...`: wall time of the additions up to so many images, of the
refreshing of all points, and of batch. Whether the figures are good stands in the tables.
"""

import time
from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from study import DOCS, OneLine, at_least, made_with, show, table, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.incremental.impact import CLOSE, EXACT, Impact, closing
from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.simulation.strip import SimulatedStrip, StripSettings, simulate_strip

WORDS = """# Adding images one at a time

A simulated strip (`mgsgraph simulate strip`: pairs along a ground track, nadir and off-nadir, each image with what it
shares with those before it) goes image by image through `IncrementalAdjustment`. Made by
`scripts/benchmark.py incremental`.
"""
EQUALITY = f"""
## Is it what batch finds?

After each addition, batch over the same images from the nominal orientation: the largest difference of any orientation
coefficient and of any coordinate of any point, in its sigma. Promised: {CLOSE:g} after each addition, {EXACT:g} after
the closing check (`IncrementalAdjustment.close`).
"""
COST = """
## What does one more cost?

Medians of the six additions up to the number stated, in one process; wall time. *reached*: images whose orientation
the addition moved noticeably; *moved*: points that it moved by more than 0.01 of their sigma, whose new places and
sigmas are part of what is timed, as are the sigmas of the new image and the impact report. *batch*: the same network
from the nominal orientation, with all covariances; *ratio*: batch over one addition.
"""
_LAST = 6
"""Additions whose median is stated: three of each track."""


@dataclass(frozen=True, slots=True)
class Added:
    """One addition."""

    seconds: float
    reached: int
    moved: int
    updates: int
    systems: int


@dataclass(frozen=True, slots=True)
class Compared:
    """Largest differences from batch in sigmas, after one addition."""

    images: int
    points: int
    orientation: float
    point: float
    added: Added
    batch: float


def add(adjustment: IncrementalAdjustment, strip: SimulatedStrip, k: int) -> Added:
    """Add image k of the strip with what is observed in it."""
    image, *observations = strip.addition(k)
    noise = strip.settings.noise
    begin = time.perf_counter()
    impact: Impact = adjustment.add(
        image, [one for one in observations if one is not None], noise.prior, noise.tie, noise.shot_image
    )
    seconds = time.perf_counter() - begin
    moved = int(np.count_nonzero(~impact.points.new))
    return Added(seconds, len(impact.images.names), moved, impact.updates, impact.systems)


def compare(adjustment: IncrementalAdjustment) -> tuple[float, float, float]:
    """Largest differences of orientation and points from batch in sigmas, and seconds of batch."""
    ids, places, _ = adjustment.points()
    network = adjustment.network
    begin = time.perf_counter()
    solution = adjust_network(network, adjustment.settings)
    seconds = time.perf_counter() - begin
    where = {name: k for k, name in enumerate(ids)}
    found = closing(solution, adjustment.values, places[[where[name] for name in network.points.ids]])
    return found.orientation, found.points, seconds


def equality(images: int, ties: int, seed: int) -> list[str]:
    """The first table."""
    strip = simulate_strip(StripSettings(images=images, ties=ties), seed)
    adjustment, found = IncrementalAdjustment(), []
    for k in range(images):
        show(f"equality: image {k + 1} of {images}")
        added = add(adjustment, strip, k)
        orientation, point, seconds = compare(adjustment)
        found.append(Compared(k + 1, len(adjustment.points()[0]), orientation, point, added, seconds))
    check, _ = adjustment.close()
    orientation, point, _ = compare(adjustment)
    rows = [[str(c.images), str(c.points), f"{c.orientation:.1e}", f"{c.point:.1e}", str(c.added.updates),
             str(c.added.systems), str(c.added.reached), str(c.added.moved), f"{c.added.seconds:.2f}", f"{c.batch:.2f}"]
            for c in found]  # fmt: skip
    head = ["images", "points", "orientation (sigmas)", "points (sigmas)", "updates of the tree", "systems made",
            "images reached", "points moved", "addition (s)", "batch (s)"]  # fmt: skip
    worst = max(max(c.orientation, c.point) for c in found)
    return [
        EQUALITY, *table(head, rows), "",
        f"{ties} ties per image, seed {seed}. Largest of all: {worst:.1e} sigmas. The closing check found "
        f"{check.worst:.1e} sigmas; after it, batch differs by {max(orientation, point):.1e} sigmas.",
    ]  # fmt: skip


def cost(sizes: list[int], ties: int, seed: int) -> list[str]:
    """The second table."""
    strip, adjustment = simulate_strip(StripSettings(images=max(sizes), ties=ties), seed), IncrementalAdjustment()
    added, rows, first = list[Added](), list[list[str]](), 0.0
    for k in range(max(sizes)):
        show(f"cost: image {k + 1} of {max(sizes)}")
        added.append(add(adjustment, strip, k))
        if k + 1 in sizes:
            last = added[-_LAST:]
            middle = {name: float(np.median([getattr(one, name) for one in last])) for name in Added.__slots__}
            first = first or middle["seconds"]
            begin = time.perf_counter()
            count = len(adjustment.points()[0])
            refreshed = time.perf_counter() - begin
            batch = compare(adjustment)[2]
            rows.append(
                [str(k + 1), str(count), f"{middle['seconds']:.3f}", f"{middle['seconds'] / first:.2f}",
                 f"{middle['reached']:.0f}", f"{middle['moved']:.0f}", f"{middle['updates']:.0f}", f"{refreshed:.2f}",
                 f"{batch:.2f}", f"{batch / middle['seconds']:.0f}"]
            )  # fmt: skip
    head = ["images", "points", "one addition (s)", "over the first", "images reached", "points moved",
            "updates of the tree", "refreshing all points (s)", "batch (s)", "ratio"]  # fmt: skip
    return [COST, *table(head, rows), "", f"{ties} ties per image, seed {seed}."]


def page(chosen: Namespace) -> str:
    """The tables that are wanted."""
    parts = [WORDS]
    if chosen.equality:
        parts += equality(chosen.equality, chosen.equality_ties, chosen.seed)
    if chosen.cost:
        parts += cost(chosen.cost, chosen.ties, chosen.seed)
    return "\n".join([*parts, "", made_with(), ""])


def main(parser: OneLine, given: list[str]) -> int:
    """`benchmark.py incremental`."""
    parser.add_argument("--equality", type=at_least(0), default=40, help="images of the first table; 0 for none")
    parser.add_argument("--equality-ties", type=at_least(1), default=300, help="new ties per image there")
    parser.add_argument("--cost", type=at_least(_LAST), nargs="*", default=[10, 100, 500], help="images there already")
    parser.add_argument("--ties", type=at_least(1), default=2000, help="new ties per image of the second table")
    parser.add_argument("--seed", type=at_least(0), default=1)
    parser.add_argument("--out", type=Path, default=DOCS / "incremental_cost.md")
    chosen = parser.parse_args(given)
    return write_page(parser, chosen.out, lambda: page(chosen))
