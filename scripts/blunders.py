"""Blunder limits by redundancy: what `reject` throws away of clean data, and what of planted blunders it finds.

Draws of networks whose errors are exactly those that the sigmas state (`tests/redraw.py`; the HRSC block simulates its
own; nothing is rendered): adjusted as they are, and with one ray in fifty moved by so many sigmas in a random
direction, limits and sizes in turn.

    python scripts/blunders.py [--cases block gusev eos isidis hrsc] [--seeds 200] [--processes N] [--out FILE]

Exit status: 0 done, 2 bad input.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from montecarlo import prepared
from scipy.stats import ncx2
from study import Z99, Blocks, Draw, cases, names_of, run, seeds_of, table

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.blunders import UNCONTROLLED, critical_value, judged, swept
from mgsgraph.adjustment.graph.forms import BETWEEN, SHARE
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
def network_of(case: str, seed: int) -> tuple[Network, SolverSettings]:
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


def one_draw(case: str, seed: int) -> Draw:
    """What is rejected of clean data, and of planted blunders."""
    network, settings = network_of(case, seed)
    good, clean = of_clean(network, settings), adjust_network(network, settings)
    turn = seed % len(PLANTED)
    return {"clean": good.tolist(), "turn": turn, "planted": of_planted(clean, *PLANTED[turn], seed).tolist()}


def clean_row(case: str, every: list[Draw]) -> list[str]:
    """What a limit of four sigmas takes of clean data."""
    rays, gone, ranges, gone_too = np.sum([draw["clean"] for draw in every], axis=0)
    of_ranges = f"{gone_too:.0f} of {ranges:.0f}" if ranges else "-"
    expected = f"{rays * 6.334e-5:.1f}"
    return [case, str(len(every)), f"{rays:.0f}", f"{gone:.0f}", f"{gone / rays:.4%}", expected, of_ranges]


def planted_row(case: str, turn: int, every: list[Draw]) -> list[str]:
    """What is found of blunders of one size."""
    sums = np.sum([draw["planted"] for draw in every if draw["turn"] == turn] or np.zeros((1, 12)), axis=0)
    count, found, expected, variance, *strong, beside, elsewhere = sums
    half = Z99 * np.sqrt(variance)
    of_powers = [
        f"{gone:.0f} of {number:.0f}, {gone / number:.1%} ({wanted / number:.1%})" if number else "none"
        for number, gone, wanted in (strong[:3], strong[3:])
    ]  # fmt: skip
    band = f"{expected:.0f} ({expected - half:.0f} .. {expected + half:.0f})"
    counts = f"{count:.0f}", f"{found:.0f}"
    ends = f"{beside:.0f}", f"{elsewhere:.0f}"
    return [case, *(f"{value:g}" for value in PLANTED[turn]), *counts, band, *of_powers, *ends]


def judge(every: list[Draw]) -> Blocks:
    """Both tables."""
    of = {case: cases(every, case) for case in names_of(every)}
    clean = [clean_row(case, mine) for case, mine in of.items()]
    wrong = [planted_row(case, turn, mine) for case, mine in of.items() for turn in range(len(PLANTED))]
    heads = "case", "limit", "sigmas", "planted", "found", "expected", "80 %", "95 %", "beside it", "elsewhere"
    return {
        "clean": table(("case", "draws", "rays", "rejected", "share", "expected", "ranges rejected"), clean),
        "planted": table(heads, wrong),
    }


if __name__ == "__main__":
    sys.exit(run(seeds_of(__doc__, CASES, 200, "blunders.md"), one_draw, judge))
