"""Are vibrations found with the amplitude that was planted, and its sigma right?

Simulated CTX pairs (`simulation.ctx`): 16 s, 800 ties of 0.2 px, second image 22 degrees aside, a terrain model of
463 m posts of 10 m as control; a sine in pitch and roll of each image that no table has, of phases of its own or
(`alike`) the same in both, and a slow drift. `analysis.vibrations.estimated_vibrations` knows neither frequency nor
amplitude, nor whether there is any. Rewrites the made parts of docs/evidence_passes.md.
"""

import math
import sys
import time
from statistics import median

import numpy as np
from study import Blocks, Draw, cases, chi_square_band, names_of, nees_cell, number, run, seeds_of, table, within

from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.analysis.vibrations import Amplitude, amplitudes, estimated_vibrations
from mgsgraph.simulation.ctx import PIXEL, CtxSettings, JitterSettings, SimulatedCtxPair, simulate_ctx_pair
from mgsgraph.simulation.demo.demonstration import nees
from mgsgraph.text import root_mean_square

TIES = 800
PLACES = 33
"""Lines of each image at which pitch and roll are held against the truth."""
_AXES = {"x (roll)": 1, "y (pitch)": 0}
"""Which phasors of the truth."""
_NEAR = 1.0 / 16.0
"""Hz, between a frequency found and the planted one."""
CASES = {
    f"{size:g} px, {frequency:g} Hz, drift {drift:g} px{', alike' if alike else ''}": JitterSettings(
        pitch=size, roll=size, frequency=frequency, drift=drift, alike=alike
    )
    for alike in (False, True)
    for size in (0.0, 0.1, 0.25, 0.5, 1.0)
    for frequency in ((2.0,) if alike or size == 0.0 else (0.5, 2.0, 5.0))
    for drift in ((3.0,) if alike else (0.0, 3.0))
    if size > 0.0 or not alike
}


def one(case: str, seed: int) -> Draw:
    """A pair: what is found of its vibration, and how well all else is known."""
    settings = CASES[case]
    mine = simulate_ctx_pair(CtxSettings(ties=TIES, jitter=settings), 100 * seed + list(CASES).index(case))
    began = time.perf_counter()
    found = estimated_vibrations(mine.network, SolverSettings(starts=0))
    seconds = time.perf_counter() - began
    lines = [each for each in found.lines if abs(each.frequency - settings.frequency) < _NEAR and settings.pitch > 0.0]
    stated = [each for each in amplitudes(found.solution) if each.axis in _AXES and not math.isnan(each.value)]
    right = [each for each in stated if each.shown and any(each.frequency == line.frequency for line in lines)]
    sizes = [[each.value / PIXEL, each.sigma / PIXEL, true_size(mine, each) / PIXEL] for each in right]
    return {
        "seconds": seconds, "converged": found.converged and found.solution.converged, "found": bool(lines),
        "false": len(found.lines) - len(lines), "amplitude": sizes, "axes": [each.axis for each in right],
        "frequency": [(each.frequency - settings.frequency) / each.sigma for each in lines],
        **normalised(mine, found.solution),
    }  # fmt: skip


def true_size(mine: SimulatedCtxPair, stated: Amplitude) -> float:
    """rad, of the same combination of the planted vibrations."""
    images = [{"CTX/A": 0, "CTX/B": 1}[name] for name in stated.names]
    own = [complex(*(mine.truth[k].phasors[_AXES[stated.axis]] * [1.0, -1.0])) for k in images]
    return abs(own[0] - sum(complex(*w) * other for w, other in zip(stated.weights, own[1:], strict=True)))


def normalised(mine: SimulatedCtxPair, solution: Solution) -> dict[str, float]:
    """Mean normalised squares of pitch, of roll and, by coordinate, of points."""
    squares = dict[str, list[float]](pitch=[], roll=[])
    for k, image in enumerate(mine.network.images):
        profile = orientation_profile(solution, k, PLACES)
        true = mine.truth[k].correction.at(image.moments(np.linspace(0.0, image.lines, PLACES)))[0][:, 3:]
        errors = (profile.rotation - true) / profile.rotation_sigma
        for name, axis in (("pitch", 1), ("roll", 0)):
            squares[name].append(float(np.mean(errors[:, axis] ** 2)))
    known = solution.determined
    off = solution.places[known] - mine.true_points[known]
    points = float(nees(off, solution.covariances[known]).mean()) / 3.0
    return {name: float(np.mean(values)) for name, values in squares.items()} | {"points": points}


def z_cell(values: list[float]) -> str:
    """Rms of normalised errors, and its 99.9 % band."""
    if not values:
        return "-"
    low, high = map(math.sqrt, chi_square_band(len(values), 1e-3))
    return within(root_mean_square(np.array(values)), (low, high))


def errors_of(draws: list[Draw]) -> list[float]:
    """Normalised errors of amplitudes."""
    return [(value - true) / sigma for draw in draws for value, sigma, true in draw["amplitude"]]


def row(every: list[Draw], case: str) -> list[str]:
    """Of the table."""
    mine = cases(every, case)
    stated = [each for draw in mine for each in draw["amplitude"]]
    off = [abs(value - true) for value, _, true in stated]
    return [
        case, f"{sum(draw['found'] for draw in mine)} of {len(mine)}", str(sum(draw["false"] for draw in mine)),
        z_cell([each for draw in mine for each in draw["frequency"]]), str(len(stated)),
        number(median(off)) if off else "-", z_cell(errors_of(mine)),
        *(nees_cell([draw[name] for draw in mine]) for name in ("pitch", "roll", "points")),
    ]  # fmt: skip


HEAD = (
    "sine", "found", "others", "frequency, z rms", "stated", "amplitude off, px (median)", "amplitude, z rms",
    "NEES pitch", "NEES roll", "NEES points",
)  # fmt: skip


def judge(every: list[Draw]) -> Blocks:
    """The table, and all together."""
    slow = [draw["seconds"] for draw in every]
    rest = sum(not draw["converged"] for draw in every)
    said = (
        f"All amplitudes: {z_cell(errors_of(every))}; frequencies "
        f"{z_cell([each for draw in every for each in draw['frequency']])}. {rest} of {len(every)} pairs did not "
        f"converge. A pair takes {median(slow):.1f} s (median; {max(slow):.1f} s at most)."
    )
    return {"vibrations": [*table(HEAD, [row(every, case) for case in names_of(every)]), "", said]}


PARSER = seeds_of(__doc__, list(CASES), 20, "evidence_passes.md#vibrations")

if __name__ == "__main__":
    sys.exit(run(PARSER, one, judge))
