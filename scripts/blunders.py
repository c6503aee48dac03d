"""Blunder limits by redundancy: what `reject` throws away of clean data, and what of planted blunders it finds.

Draws of networks whose errors are exactly those that the sigmas state (`tests/redraw.py`; the HRSC block simulates its
own; nothing is rendered): adjusted as they are, and with one ray in fifty moved by so many sigmas in a random
direction, limits and sizes in turn.

    python scripts/blunders.py [--cases block gusev eos isidis hrsc] [--seeds 200] [--processes N] [--out FILE]

Cases `..., tukey` (`--cases tukey`): what `loss = "tukey"` loses of clean data; and the errors of points whose rays are
all good where some of the ties' image coordinates are off by hundreds of pixels, over those of adjustments told so.

Exit status: 0 done, 2 bad input.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from montecarlo import prepared
from nees import prepared as prepared_strip
from networks import network as network_of_pair
from redraw import redraw
from scipy.stats import ncx2
from study import Z99, Blocks, Draw, cases, names_of, run, seeds_of, table

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.blunders import UNCONTROLLED, critical_value, judged, swept
from mgsgraph.adjustment.graph.forms import BETWEEN, SHARE
from mgsgraph.adjustment.rounds import all_rows
from mgsgraph.adjustment.settings import Loss, SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.errors import MgsgraphError
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Network, PointClass
from mgsgraph.simulation.pair import PairSettings, simulate_pair
from mgsgraph.text import root_mean_square

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from mex_block import BlockSettings, simulate_hrsc_block
from mex_flight import PointMatching

PLANTED = (4.0, 6.0), (4.0, 8.0), (4.0, 12.0), (3.0, 6.0)
"""Limits, and errors of planted rays in sigmas of the observation."""
RATE = 0.02
"""Share of the rays that are off, one of a point at most."""
POWERS = 0.80, 0.95
HRSC = BlockSettings(passes=2, length=120e3, points=240, matches=PointMatching(blunders=0.0), terrain=None)
CASES = "block", "gusev", "eos", "isidis", "hrsc"
TUKEY = tuple(f"{case}, tukey" for case in ("pair", "gusev", "eos", "isidis", "strip"))
GROSS, MORE = 0.3, (0.4, 0.5, 0.6, 0.7)
"""Shares of the ties' rays that are far off: in each draw, and in every fourth."""
FAR = 100.0, 900.0
"""px, least and largest such error, in a random direction."""


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
    remaining = np.empty((rows.size, 2, 2))
    remaining[:, [0, 1], [0, 1]] = 1.0 - numbers[:, SHARE]
    remaining[:, 0, 1] = remaining[:, 1, 0] = -numbers[:, BETWEEN]
    values = np.linalg.eigvalsh(remaining)
    dimensions = np.count_nonzero(values > UNCONTROLLED, axis=1)
    shift = np.einsum("bi,bij,bj->b", errors, remaining, errors)
    limits = np.array([critical_value(limit, d) for d in range(3)])[dimensions]
    return np.where(dimensions > 0, ncx2.sf(limits, np.maximum(dimensions, 1), shift), 0.0)


def of_clean(network: Network, settings: SolverSettings) -> Array:
    """Rays and those rejected, ranges and those rejected."""
    solution = adjust_network(network, replace(settings, reject=4.0))
    assert solution.rays_rejected is not None
    assert solution.ranges_rejected is not None
    marks = solution.rays_rejected, solution.ranges_rejected
    return np.array([number for mask in marks for number in (mask.size, mask.sum())], dtype=np.float64)


def of_planted(clean: Solution, limit: float, size: float, seed: int) -> Array:
    """Numbers planted, found, expected, and its variance; by power; false rejections at those points, and elsewhere."""
    network, settings = clean.network, replace(clean.settings, reject=limit)
    wrong, rows, errors = planted(network, size, np.random.default_rng([seed, 22]))
    chance = chances(clean, limit, rows, errors)
    rejected = adjust_network(wrong, settings).rays_rejected
    assert rejected is not None
    caught, not_planted = rejected[rows], rejected.copy()
    not_planted[rows] = False
    beside = np.isin(network.rays.point, network.rays.point[rows])
    strong = [values[chance >= power].sum() for power in POWERS for values in (np.ones(rows.size), caught, chance)]
    sums = rows.size, caught.sum(), chance.sum(), np.sum(chance * (1.0 - chance))
    return np.array([*sums, *strong, np.sum(not_planted & beside), np.sum(not_planted & ~beside)], dtype=np.float64)


def with_truth(case: str, seed: int) -> tuple[Network, Array, SolverSettings]:
    """A draw of a case of Tukey's loss, true places (n, 3) in m, and settings."""
    if case == "pair":
        pair = simulate_pair(PairSettings(ties=60, shots=20), seed)
        places = np.concatenate([pair.true_ties, pair.true_footprints])
        return network_of_pair(pair), places, SolverSettings(loss="tukey")
    network, settings = prepared_strip("HRSC strip, passes") if case == "strip" else prepared(case)
    draw = redraw(network, np.random.default_rng([seed, 21]), settings.angles)
    return draw.network, draw.places, replace(settings, loss="tukey")


def far_off(network: Network, share: float, rng: np.random.Generator) -> tuple[Network, Index]:
    """The network with a share of its ties' rays elsewhere in their images; which."""
    rays, size = network.rays, np.array([(image.lines, image.samples) for image in network.images], dtype=np.float64)
    ties = np.flatnonzero((network.points.classes == PointClass.TIE)[rays.point])
    rows, places = rng.choice(ties, round(share * ties.size), replace=False), rays.places.copy()
    angle, most = rng.uniform(0.0, 2.0 * np.pi, rows.size), size[rays.image[rows]] - 1.0
    off = rng.uniform(*FAR, rows.size)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    outside = np.abs(2.0 * (places[rows] + off) - most - 1.0) > most - 1.0
    places[rows] = np.clip(places[rows] + np.where(outside, -off, off), 1.0, most)
    return replace(network, rays=replace(rays, places=places)), rows


def error_ratios(
    network: Network, truth: Array, settings: SolverSettings, share: float, seed: int, losses: tuple[Loss, ...]
) -> list[float]:
    """Root mean square error of ties whose rays are all good, over that of adjustments (with some losses) that know
    the blunders; 1e9 where the adjustment fails or a point has no place.
    """
    wrong, rows = far_off(network, share, np.random.default_rng([seed, 23]))
    full, good = all_rows(wrong), (network.points.classes == PointClass.TIE) & ~network.undetermined
    good[network.rays.point[rows]] = False
    rays = np.isin(np.arange(network.rays.point.size), rows, invert=True)
    left_in = replace(full, rays=rays)
    try:
        informed = [adjust_network(wrong, replace(settings, loss=loss, starts=0), left_in=left_in) for loss in losses]
        solution = adjust_network(wrong, settings)
    except MgsgraphError:
        return [1e9 for _ in losses]
    good &= np.all([result.determined for result in informed], axis=0)
    error, *best = (np.sqrt(np.sum((result.places - truth)[good] ** 2)) for result in (solution, *informed))
    return [float(error / least) if solution.converged and np.isfinite(error) else 1e9 for least in best]


def with_tukey(case: str, seed: int) -> Draw:
    """Rays and ranges of clean data, and those without weight; ratios of errors; steps and seconds beside Huber's."""
    network, truth, settings = with_truth(case, seed)
    clean, huber = adjust_network(network, settings), adjust_network(network, replace(settings, loss="huber"))
    rejected = np.concatenate([clean.rays_rejected, clean.ranges_rejected])
    turn = seed % len(MORE)
    ratios = error_ratios(network, truth, settings, GROSS, seed, ("tukey", "none"))
    ratios += error_ratios(network, truth, settings, MORE[turn], seed, ("tukey",))
    seconds = [solution.seconds["solve"] for solution in (clean, huber)]
    return {"lost": [rejected.size, int(rejected.sum())], "turn": turn, "ratios": ratios,
            "converged": clean.converged, "steps": [len(s.history) for s in (clean, huber)], "seconds": seconds}


def one_draw(case: str, seed: int) -> Draw:
    """What is rejected of clean data, and of planted blunders."""
    if case in TUKEY:
        return with_tukey(case.split(",")[0], seed)
    network, settings = network_of(case, seed)
    good, clean = of_clean(network, settings), adjust_network(network, settings)
    turn = seed % len(PLANTED)
    return {"clean": good.tolist(), "turn": turn, "planted": of_planted(clean, *PLANTED[turn], seed).tolist()}


def clean_row(case: str, draws: list[Draw]) -> list[str]:
    """Measurements of clean data that a limit of four sigmas rejects."""
    rays, rejected, ranges, ranges_rejected = np.sum([draw["clean"] for draw in draws], axis=0)
    of_ranges = f"{ranges_rejected:.0f} of {ranges:.0f}" if ranges else "-"
    expected = f"{rays * 6.334e-5:.1f}"
    return [case, str(len(draws)), f"{rays:.0f}", f"{rejected:.0f}", f"{rejected / rays:.4%}", expected, of_ranges]


def planted_row(case: str, turn: int, draws: list[Draw]) -> list[str]:
    """Blunders of one size that are found."""
    sums = np.sum([draw["planted"] for draw in draws if draw["turn"] == turn] or np.zeros((1, 12)), axis=0)
    count, caught, expected, variance, *strong, beside, elsewhere = sums
    half = Z99 * np.sqrt(variance)
    of_powers = [
        f"{hits:.0f} of {number:.0f}, {hits / number:.1%} ({expected_hits / number:.1%})" if number else "none"
        for number, hits, expected_hits in (strong[:3], strong[3:])
    ]  # fmt: skip
    band = f"{expected:.0f} ({expected - half:.0f} .. {expected + half:.0f})"
    counts = f"{count:.0f}", f"{caught:.0f}"
    ends = f"{beside:.0f}", f"{elsewhere:.0f}"
    return [case, *(f"{value:g}" for value in PLANTED[turn]), *counts, band, *of_powers, *ends]


def tukey_row(case: str, draws: list[Draw]) -> list[str]:
    """Measurements that Tukey's loss rejects, and its errors."""
    rows, rejected = np.sum([draw["lost"] for draw in draws], axis=0)
    ratios = np.array([draw["ratios"] for draw in draws])
    turns = np.array([draw["turn"] for draw in draws])
    cells = [f"{root_mean_square(values):.3f}, {np.median(values):.3f}, {values.max():.3g}, {np.sum(values > 1.05)}"
             for values in ratios.T[:2]]  # fmt: skip
    more = [ratios[turns == turn, 2] for turn in range(len(MORE))]
    beyond = [f"{np.sum(values > 1.05)} of {values.size}" if values.size else "-" for values in more]
    steps = np.mean([draw["steps"] for draw in draws], axis=0)
    slower = np.median([tukey / huber for tukey, huber in (draw["seconds"] for draw in draws)])
    return [case.split(",")[0], str(len(draws)), f"{rows:.0f}", f"{rejected:.0f}, {rejected / rows:.3%}",
            *cells, *beyond,
            f"{steps[0]:.0f} ({steps[1]:.0f})", f"{slower:.1f}"]


def judge(draws: list[Draw]) -> Blocks:
    """The tables of the cases."""
    of = {case: cases(draws, case) for case in names_of(draws)}
    if any(case in TUKEY for case in of):
        head = ("case", "draws", "measurements", "lost", "told", "told, least squares",
                *(f"{share:.0%}" for share in MORE), "steps (huber)", "time / huber")
        return {"tukey": table(head, [tukey_row(case, of_case) for case, of_case in of.items()])}
    clean = [clean_row(case, of_case) for case, of_case in of.items()]
    wrong = [planted_row(case, turn, of_case) for case, of_case in of.items() for turn in range(len(PLANTED))]
    heads = "case", "limit", "sigmas", "planted", "found", "expected", "80 %", "95 %", "beside it", "elsewhere"
    return {
        "clean": table(("case", "draws", "rays", "rejected", "share", "expected", "ranges rejected"), clean),
        "planted": table(heads, wrong),
    }


if __name__ == "__main__":
    sys.exit(run(seeds_of(__doc__, CASES + TUKEY, 200, "evidence_errors.md#blunders"), one_draw, judge))
