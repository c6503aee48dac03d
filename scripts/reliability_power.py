"""Power of the w-test and its false alarms, by real re-adjustments of a redrawn pair; writes docs/reliability.md.

Every seed draws truth and observations anew from the stated sigmas (`tests/redraw.py`), plants one blunder of one or
two minimal detectable blunders in a measure of each kind in turn, adjusts, and asks the reliability table.
"""

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import binom, norm
from study import DOCS, at_least, command, show, table, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.measures import MeasureKind
from mgsgraph.analysis.reliability import Reliability, reliability
from mgsgraph.network import Network

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from networks import network, pair
from redraw import redraw

WORDS = """# Reliability: power and false alarms

`scripts/reliability_power.py`: a simulated pair, drawn anew for every seed, one blunder planted, and really
adjusted again. MDB: minimal detectable blunder, by Baarda's levels 0.001 and 0.80. Limits: binomial, 99 %.

    {network}
"""
KINDS = {MeasureKind.RAY: "image coordinate", MeasureKind.RANGE: "range", MeasureKind.GROUND: "ground coordinate"}


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    what: str
    size: int
    seeds: int
    found: int
    first: int


def planted(network: Network, kind: MeasureKind, row: int, component: int, size: float) -> Network:
    """A network with an error of `size` (px or m) in one measure."""
    if kind is MeasureKind.RAY:
        places = network.rays.places.copy()
        places[row, component] += size
        return replace(network, rays=replace(network.rays, places=places))
    if kind is MeasureKind.RANGE:
        values = network.ranges.values.copy()
        values[row] += size
        return replace(network, ranges=replace(network.ranges, values=values))
    places = network.points.places.copy()
    places[row, component] += size
    return replace(network, points=replace(network.points, places=places))


def strongest(found: Reliability, kind: MeasureKind, number: int) -> list[int]:
    """Measures of a kind to plant in, spread over those that something controls (r > 0.1; of ranges, the best)."""
    mine = np.flatnonzero((found.measures.kind == kind) & np.isfinite(found.measures.detectable))
    best = mine[np.argsort(-found.measures.redundancy[mine], kind="stable")]
    good = mine[found.measures.redundancy[mine] > 0.1]
    pool = good if good.size >= number else best[:number]
    return pool[np.linspace(0, pool.size - 1, number).astype(int)].tolist()


def campaign(network: Network, seeds: int) -> tuple[list[Row], int, int]:
    """Rows of the table; false alarms among tests of clean draws, and how many tests there were."""
    plain = SolverSettings()
    base = reliability(adjust_network(network, plain))
    chosen = {kind: strongest(base, kind, min(seeds, 12)) for kind in KINDS}
    counts = {(kind, size): np.zeros(2, dtype=int) for kind in KINDS for size in (1, 2)}
    alarms = tests = 0
    for seed in range(seeds):
        draw = redraw(network, np.random.default_rng(seed)).network
        clean = reliability(adjust_network(draw, plain)).measures
        alone = np.isfinite(clean.test) & ~((clean.kind == MeasureKind.RAY) & (clean.component == 1))
        alarms += int(np.count_nonzero(np.abs(clean.test[alone]) > base.critical))
        tests += int(np.count_nonzero(alone))
        for kind, size in counts:
            k = chosen[kind][seed % len(chosen[kind])]
            about = int(base.measures.row[k]), int(base.measures.component[k])
            error = size * float(base.measures.detectable[k]) * (1.0 if seed % 2 else -1.0)
            found = reliability(adjust_network(planted(draw, kind, *about, error), plain))
            counts[kind, size] += (
                abs(found.measures.test[k]) > found.critical,
                found.measures.point[found.order(1)[0]] == found.measures.point[k],
            )
        show(f"{seed + 1} of {seeds} seeds")
    rows = [Row(KINDS[kind], size, seeds, *count.tolist()) for (kind, size), count in counts.items()]
    return rows, alarms, tests


def page(rows: list[Row], alarms: int, tests: int, network: Network) -> str:
    """The table as Markdown."""
    cells = []
    for row in rows:
        power = {1: 0.80, 2: float(np.round(norm.cdf(2.0 * 4.1321 - 3.2905), 5))}[row.size]
        low, high = binom.ppf([0.005, 0.995], row.seeds, power)
        expected = f"{power * row.seeds:.1f}"
        cells.append(
            (row.what, f"{row.size} MDB", str(row.seeds), str(row.found), expected, f"{low:.0f} .. {high:.0f}",
             str(row.first))
        )  # fmt: skip
    low, high = binom.ppf([0.005, 0.995], tests, 0.001)
    return "\n".join([
        WORDS.format(network=repr(network)),
        *table(("blunder", "size", "seeds", "test over 3.29", "expected", "within", "its point first"), cells), "",
        f"False alarms on clean draws: {alarms} of {tests} tests (samples not counted: those of a tie with two rays",
        f"repeat its lines); {0.001 * tests:.1f} expected, {low:.0f} .. {high:.0f} if all were independent.", "",
    ])  # fmt: skip


def main() -> int:
    parser = command(__doc__)
    parser.add_argument("--seeds", type=at_least(1), default=200)
    parser.add_argument("--out", type=Path, default=DOCS / "reliability.md")
    options = parser.parse_args()
    net = network(pair(ties=20, shots=10))
    return write_page(parser, options.out, lambda: page(*campaign(net, options.seeds), net))


if __name__ == "__main__":
    sys.exit(main())
