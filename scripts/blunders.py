"""Blunder limits by redundancy: what `reject` throws away of clean data, and what of planted blunders it finds.

Draws of networks whose errors are exactly those that the sigmas state (`tests/redraw.py`; the HRSC block simulates its
own; nothing is rendered): adjusted as they are, and with one ray in fifty moved by so many sigmas in a random
direction, limits and sizes in turn.

    python scripts/blunders.py [--draws 200] [--first 0] [--cases block gusev eos isidis hrsc] [--out FILE]

Exit status: 0 done, 2 bad input.
"""

import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from montecarlo_draw import prepared
from scipy.stats import ncx2
from study import DOCS, Z99, at_least, command, made_with, show, table, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.blunders import UNCONTROLLED, critical_value, judged, swept
from mgsgraph.adjustment.graph.bundle import BETWEEN, SHARE
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Network
from mgsgraph.simulation.hrsc_block import BlockSettings, simulate_hrsc_block
from mgsgraph.simulation.hrsc_flight import PointMatching

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from redraw import redraw

PLANTED = (4.0, 6.0), (4.0, 8.0), (4.0, 12.0), (3.0, 6.0)
"""Limits, and sigmas of the observation by which planted rays are off."""
RATE = 0.02
"""Share of the rays that are off, one of a point at most."""
POWERS = 0.80, 0.95
HRSC = BlockSettings(strips=2, length=120e3, points=240, matches=PointMatching(blunders=0.0), terrain=None)
CASES = "block", "gusev", "eos", "isidis", "hrsc"
WORDS = """# Blunder limits: what goes, and what stays

Made by `scripts/blunders.py`, seeds {first} to {last} of each case: a strip of six images, the three sites (terrain
model left out), a block of two HRSC strips of five lines. All errors are drawn from the sigmas that the adjustment is
told. `--reject 4` is a test of each ray, range and stereo height with the two-sided chance of a normal error beyond
four sigmas, 6.3e-5, in as many dimensions as its redundancy leaves ([theory](theory.md)).

## Clean data

Rays that an adjustment with `--reject 4` throws away, where nothing is wrong. Wanted: 0.05 % at most.

"""
POWER = """
## Planted blunders

{rate:.0%} of the rays are off by so many sigmas of theirs in a random direction, one of a point at most; each
line has every fourth draw. What its redundancy leaves of a blunder *e* (in sigmas) is the non-centrality *e' M e* of
its ray's test, *M* the covariance of the residuals; with it the test is beyond its limit with a probability that is
known beforehand.

* *expected*: sum of these probabilities, each blunder by itself, with the 99 % band of that sum; *found*: planted rays
  that were rejected.
* *80 %*, *95 %*: of the planted rays, those whose blunder is at least the minimal detectable one of that power; how
  many of them were rejected, and in brackets how many were expected to be.
* *beside it*: rays that were not planted, of points with a planted one, that were rejected: what can't be told apart
  from it (of a tie with two rays always the other one). *elsewhere*: rays of points without a blunder.

"""
READING = """
In two dimensions a limit of four sigmas is {least:.2f} in the root of the test, and a blunder of 6 sigmas in a ray that
all others determine without error would be beyond it in {most:.1%} of draws: hardly any of 6 sigmas has a power of
95 % at `--reject 4`. A tie with two rays shows at most half of the square of a blunder, in one dimension. Where rays of
a point come from nearly the same direction (pairs of the block's six images) one may be mistaken for the other: both
go, which costs a good ray for most blunders there. `--reject 3` finds more, and throws away 43 times as many good ones.
"""


def drawn(case: str, seed: int) -> tuple[Network, SolverSettings]:
    """A draw of a case, and the settings it is adjusted with."""
    if case == "hrsc":
        return simulate_hrsc_block(HRSC, 1000 + seed).network, SolverSettings()
    network, settings = prepared(case)
    return redraw(network, np.random.default_rng([seed, 21]), settings.angles).network, settings


def planted(network: Network, size: float, rng: np.random.Generator) -> tuple[Network, Index, Array]:
    """The network with blunders of `size` sigmas in some of its rays, one of a point at most; which, and how (b, 2)."""
    points = rng.permutation(np.unique(network.rays.point))
    count = max(1, round(RATE * network.rays.point.size))
    rows = np.array([rng.choice(np.flatnonzero(network.rays.point == i)) for i in points[:count]])
    angle = rng.uniform(0.0, 2.0 * np.pi, rows.size)
    errors = size * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    places = network.rays.places.copy()
    places[rows] += errors * network.rays.sigmas[rows]
    return replace(network, rays=replace(network.rays, places=places)), rows, errors


def chances(clean: Solution, limit: float, rows: Index, errors: Array) -> Array:
    """Probability (b,) that the test of each ray is beyond a limit, by the redundancy that it has in clean data."""
    at = at_solution(clean)
    numbers = swept(at, np.zeros(0, dtype=np.int64))[0][judged(at.layout).place[rows]]
    left = np.empty((rows.size, 2, 2))
    left[:, [0, 1], [0, 1]] = 1.0 - numbers[:, SHARE]
    left[:, 0, 1] = left[:, 1, 0] = -numbers[:, BETWEEN]
    values = np.linalg.eigvalsh(left)
    dimensions = np.count_nonzero(values > UNCONTROLLED, axis=1)
    shift = np.einsum("bi,bij,bj->b", errors, left, errors)
    limits = np.array([critical_value(limit, d) for d in range(3)])[dimensions]
    return np.where(dimensions > 0, ncx2.sf(limits, np.maximum(dimensions, 1), shift), 0.0)


def of_clean(network: Network, settings: SolverSettings) -> Array:
    """Rays and those rejected, ranges and those rejected."""
    solution = adjust_network(network, replace(settings, reject=4.0))
    assert solution.rays_rejected is not None
    assert solution.ranges_rejected is not None
    marks = solution.rays_rejected, solution.ranges_rejected
    return np.array([number for one in marks for number in (one.size, one.sum())], dtype=np.float64)


def of_planted(clean: Solution, limit: float, size: float, seed: int) -> Array:
    """Planted, found, expected, variance of that; of each power how many, and found; beside it, elsewhere."""
    network, settings = clean.network, replace(clean.settings, reject=limit)
    wrong, rows, errors = planted(network, size, np.random.default_rng([seed, 22]))
    chance = chances(clean, limit, rows, errors)
    gone = adjust_network(wrong, settings).rays_rejected
    assert gone is not None
    found, others = gone[rows], gone.copy()
    others[rows] = False
    beside = np.isin(network.rays.point, network.rays.point[rows])
    strong = [one[chance >= power].sum() for power in POWERS for one in (np.ones(rows.size), found, chance)]
    sums = rows.size, found.sum(), chance.sum(), np.sum(chance * (1.0 - chance))
    return np.array([*sums, *strong, np.sum(others & beside), np.sum(others & ~beside)], dtype=np.float64)


def clean_row(case: str, draws: int, sums: Array) -> Sequence[str]:
    rays, gone, ranges, gone_too = sums
    of_ranges = f"{gone_too:.0f} of {ranges:.0f}" if ranges else "-"
    return case, str(draws), f"{rays:.0f}", f"{gone:.0f}", f"{gone / rays:.4%}", f"{rays * 6.334e-5:.1f}", of_ranges


def planted_row(case: str, limit: float, size: float, sums: Array) -> Sequence[str]:
    count, found, expected, variance, *strong, beside, elsewhere = sums
    half = Z99 * np.sqrt(variance)
    of_powers = [
        f"{gone:.0f} of {number:.0f}, {gone / number:.1%} ({wanted / number:.1%})" if number else "none"
        for number, gone, wanted in (strong[:3], strong[3:])
    ]  # fmt: skip
    band = f"{expected:.0f} ({expected - half:.0f} .. {expected + half:.0f})"
    return (
        case, f"{limit:g}", f"{size:g}", f"{count:.0f}", f"{found:.0f}", band, *of_powers, f"{beside:.0f}",
        f"{elsewhere:.0f}",
    )  # fmt: skip


def page(wanted: Namespace) -> str:
    """Both tables."""
    seeds = range(wanted.first, wanted.first + wanted.draws)
    stays, found = list[Sequence[str]](), list[Sequence[str]]()
    for case in wanted.cases:
        good, bad = np.zeros(4), np.zeros((len(PLANTED), 12))
        for seed in seeds:
            network, settings = drawn(case, seed)
            good += of_clean(network, settings)
            turn = seed % len(PLANTED)
            bad[turn] += of_planted(adjust_network(network, settings), *PLANTED[turn], seed)
            show(f"{case}: {seed + 1 - wanted.first} of {wanted.draws} draws")
        stays.append(clean_row(case, wanted.draws, good))
        found += [planted_row(case, *how, sums) for how, sums in zip(PLANTED, bad, strict=True)]
    least = critical_value(4.0, 2)
    heads = "case", "limit", "sigmas", "planted", "found", "expected", "80 %", "95 %", "beside it", "elsewhere"
    return "\n".join([
        WORDS.format(first=seeds[0], last=seeds[-1]).rstrip(), "",
        *table(("case", "draws", "rays", "rejected", "share", "expected", "ranges rejected"), stays),
        POWER.format(rate=RATE).rstrip(), "", *table(heads, found),
        READING.format(least=np.sqrt(least), most=ncx2.sf(least, 2, 36.0)), made_with(), "",
    ])  # fmt: skip


def main() -> int:
    parser = command(__doc__)
    parser.add_argument("--draws", type=at_least(1), default=200)
    parser.add_argument("--first", type=at_least(0), default=0, help="first seed")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=CASES)
    parser.add_argument("--out", type=Path, default=DOCS / "blunders.md")
    wanted = parser.parse_args()
    return write_page(parser, wanted.out, lambda: page(wanted))


if __name__ == "__main__":
    sys.exit(main())
