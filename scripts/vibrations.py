"""Are vibrations found with the amplitude that was planted, and its sigma right?

Simulated CTX pairs (`tests/ctx_pair.py`): 16 s, 800 ties of 0.2 px, second image 22 degrees aside, a terrain model of
463 m posts of 10 m as control; a sine in pitch and roll of each image that no table has, of phases of its own or
(`same_motion`) the same in both, and a slow drift. `analysis.vibrations.estimated_vibrations` knows neither frequency
nor amplitude, nor whether there is any. Rewrites the made parts of docs/evidence_passes.md.
"""

import math
import sys
import time
from pathlib import Path
from statistics import median

import numpy as np
from study import Blocks, Draw, cases, chi_square_band, names_of, nees_cell, number, run, seeds_of, table, within

from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.analysis.vibrations import Amplitude, amplitudes, estimated_vibrations
from mgsgraph.simulation.demo.demonstration import nees
from mgsgraph.text import root_mean_square

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from ctx_pair import PIXEL, CtxSettings, JitterSettings, SimulatedCtxPair, simulate_ctx_pair

TIES = 800
PLACES = 33
"""Lines of each image at which pitch and roll are compared with the truth."""
_AXES = {"x (roll)": 1, "y (pitch)": 0}
"""Which phasors of the truth."""
_NEAR = 1.0 / 16.0
"""Hz, between a frequency found and the planted one."""
CASES = {
    f"{size:g} px, {frequency:g} Hz, drift {drift:g} px{', same motion' if same_motion else ''}": JitterSettings(
        pitch=size, roll=size, frequency=frequency, drift=drift, same_motion=same_motion
    )
    for same_motion in (False, True)
    for size in (0.0, 0.1, 0.25, 0.5, 1.0)
    for frequency in ((2.0,) if same_motion or size == 0.0 else (0.5, 2.0, 5.0))
    for drift in ((3.0,) if same_motion else (0.0, 3.0))
    if size > 0.0 or not same_motion
}


def one_draw(case: str, seed: int) -> Draw:
    """A pair: its estimated vibration, and the errors of all other parameters."""
    settings = CASES[case]
    pair = simulate_ctx_pair(CtxSettings(ties=TIES, jitter=settings), 100 * seed + list(CASES).index(case))
    began = time.perf_counter()
    result = estimated_vibrations(pair.network, SolverSettings(starts=0))
    seconds = time.perf_counter() - began
    lines = [each for each in result.lines if abs(each.frequency - settings.frequency) < _NEAR and settings.pitch > 0.0]
    stated = [each for each in amplitudes(result.solution) if each.axis in _AXES and not math.isnan(each.value)]
    right = [each for each in stated if each.shown and any(each.frequency == line.frequency for line in lines)]
    sizes = [[each.value / PIXEL, each.sigma / PIXEL, true_size(pair, each) / PIXEL] for each in right]
    return {
        "seconds": seconds, "converged": result.converged and result.solution.converged, "found": bool(lines),
        "false": len(result.lines) - len(lines), "amplitude": sizes, "axes": [each.axis for each in right],
        "frequency": [(each.frequency - settings.frequency) / each.sigma for each in lines],
        **normalised(pair, result.solution),
    }  # fmt: skip


def true_size(pair: SimulatedCtxPair, stated: Amplitude) -> float:
    """rad, of the same combination of the planted vibrations."""
    images = [{"CTX/A": 0, "CTX/B": 1}[name] for name in stated.names]
    sizes = [complex(*(pair.truth[k].phasors[_AXES[stated.axis]] * [1.0, -1.0])) for k in images]
    return abs(sizes[0] - sum(complex(*w) * size for w, size in zip(stated.weights, sizes[1:], strict=True)))


def normalised(pair: SimulatedCtxPair, solution: Solution) -> dict[str, float]:
    """Mean normalised squares of pitch, of roll and, by coordinate, of points."""
    squares = dict[str, list[float]](pitch=[], roll=[])
    for k, image in enumerate(pair.network.images):
        profile = orientation_profile(solution, k, PLACES)
        true = pair.truth[k].correction.at(image.moments(np.linspace(0.0, image.lines, PLACES)))[0][:, 3:]
        errors = (profile.rotation - true) / profile.rotation_sigma
        for name, axis in (("pitch", 1), ("roll", 0)):
            squares[name].append(float(np.mean(errors[:, axis] ** 2)))
    determined = solution.determined
    off = solution.places[determined] - pair.true_points[determined]
    points = float(nees(off, solution.covariances[determined]).mean()) / 3.0
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


def row(draws: list[Draw], case: str) -> list[str]:
    """Of the table."""
    pairs = cases(draws, case)
    stated = [each for draw in pairs for each in draw["amplitude"]]
    off = [abs(value - true) for value, _, true in stated]
    return [
        case, f"{sum(draw['found'] for draw in pairs)} of {len(pairs)}", str(sum(draw["false"] for draw in pairs)),
        z_cell([each for draw in pairs for each in draw["frequency"]]), str(len(stated)),
        number(median(off)) if off else "-", z_cell(errors_of(pairs)),
        *(nees_cell([draw[name] for draw in pairs]) for name in ("pitch", "roll", "points")),
    ]  # fmt: skip


HEAD = (
    "sine", "found", "others", "frequency, z rms", "stated", "amplitude off, px (median)", "amplitude, z rms",
    "NEES pitch", "NEES roll", "NEES points",
)  # fmt: skip


def judge(draws: list[Draw]) -> Blocks:
    """The table, and a sentence on all draws."""
    slow = [draw["seconds"] for draw in draws]
    rest = sum(not draw["converged"] for draw in draws)
    sentence = (
        f"All amplitudes: {z_cell(errors_of(draws))}; frequencies "
        f"{z_cell([each for draw in draws for each in draw['frequency']])}. {rest} of {len(draws)} pairs did not "
        f"converge. A pair takes {median(slow):.1f} s (median; {max(slow):.1f} s at most)."
    )
    return {"vibrations": [*table(HEAD, [row(draws, case) for case in names_of(draws)]), "", sentence]}


PARSER = seeds_of(__doc__, list(CASES), 20, "evidence_passes.md#vibrations")

if __name__ == "__main__":
    sys.exit(run(PARSER, one_draw, judge))
