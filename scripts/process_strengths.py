"""Are strengths of Gaussian processes found, and their sigmas true? Planted in simulated strips, many seeds.

    python scripts/process_strengths.py [--seeds 401 420] [--lengths 600 300] [--out docs/process_strengths.md]

Simulated HRSC strips of five lines, nodes 5 s apart at most, 1,600 points, no terrain model. Position and attitude
depart from bias and drift by Gauss-Markov processes of 30 s; their strengths, asked for as `estimated`, begin three
times too large.

* *position*, *attitude*: found over planted, and the stated sigma of it (of the logarithm).
* *z*: logarithm of found over planted in stated sigmas. *z' C^-1 z*: mean squared normalised error of both, a strength.
"""

import sys
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import chi2
from study import DOCS, OneLine, at_least, command, machine, made_with, positive, show, table, write_page

from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.process_strengths import estimated_strengths
from mgsgraph.errors import MgsgraphError
from mgsgraph.network import Process, ProcessPrior
from mgsgraph.simulation.hrsc_block import BlockSettings, TrajectoryErrors, simulate_hrsc_block
from mgsgraph.units import KM

ERRORS = TrajectoryErrors(correlation_time=30.0, position_wander=10.0)
TOO_LARGE = 3.0
HEAD = ("seed", "position", "attitude", "z of position", "z of attitude", "z' C^-1 z / 2", "remarks")
Row = tuple[list[str], tuple[float, float, float] | None]


def one(seed: int, length: float) -> Row:
    """Cells of a strip of a length in m, and the two z and their mean squared normalised error; None where refused."""
    settings = BlockSettings(strips=1, length=length, points=1600, spacing=5.0, terrain=None, errors=ERRORS)
    network, planted = simulate_hrsc_block(settings, seed).network, (ERRORS.position_wander, ERRORS.attitude_wander)
    position, attitude = (
        (Process("gauss-markov", np.full(3, TOO_LARGE * sigma), ERRORS.correlation_time, estimated=True),)
        for sigma in planted
    )
    prior = ProcessPrior(position, attitude, ERRORS.prior.bias, ERRORS.prior.drift)
    network = replace(network, passes=(replace(network.passes[0], prior=prior),))
    try:
        found = estimated_strengths(network, SolverSettings())
    except MgsgraphError as error:
        return [str(seed), *["-"] * 5, str(error)], None
    ratios = np.array([strength.sigma for strength in found.strengths]) / planted
    sigmas, logs = np.sqrt(np.diagonal(found.covariance)), np.log(ratios)
    z, error = logs / sigmas, float(logs @ np.linalg.solve(found.covariance, logs)) / logs.size
    remarks = [] if found.converged else ["not converged"]
    remarks += ["zero" for strength in found.strengths if strength.zero][:1]
    cells = [str(seed), *(f"{a:.3f} +- {b:.3f}" for a, b in zip(ratios, sigmas, strict=True))]
    return [*cells, *(f"{value:.2f}" for value in z), f"{error:.2f}", ", ".join(remarks)], (*z.tolist(), error)


def section(seeds: range, length: float) -> list[str]:
    """A table of all seeds, and what they say."""
    rows = list[Row]()
    for seed in seeds:
        show(f"{length:g} km, seed {seed}")
        rows.append(one(seed, length * KM))
        print(f"{length:g} km", rows[-1][0], file=sys.stderr, flush=True)
    judged = np.array([row[1] for row in rows if row[1] is not None]).reshape(-1, 3)
    count = judged.shape[0]
    z, mean = judged[:, :2], float(judged[:, 2].mean()) if count else np.nan
    low, high = chi2.ppf([0.025, 0.975], 2 * max(count, 1)) / (2 * max(count, 1))
    medians = np.median(np.abs(z), axis=0) if count else np.full(2, np.nan)
    near, outside = int(np.count_nonzero(np.abs(z) < 1.96)), "" if low <= mean <= high else ", **outside**"
    words = (
        f"{count} of {len(rows)} strips give strengths. Mean squared normalised error {mean:.2f} a strength (95 % band "
        f"{low:.2f} to {high:.2f}{outside}); {near} of {z.size} within 1.96 sigmas, "
        f"largest {np.abs(z).max() if count else np.nan:.2f}, median |z| "
        f"{medians[0]:.2f} of position and {medians[1]:.2f} of attitude (normal: 0.67)."
    )
    return [f"## {length:g} km", "", words, "", *table(HEAD, [row[0] for row in rows]), ""]


def page(chosen: Namespace) -> str:
    """The page."""
    first, last = chosen.seeds
    words = (__doc__ or "").split("\n\n", 2)[2].strip()
    parts = [line for length in chosen.lengths for line in section(range(first, last + 1), length)]
    head = ["# Strengths of processes, found again", "", f"Made by `scripts/process_strengths.py`. {words}", ""]
    return "\n".join([*head, *parts, f"{machine()}. {made_with()}", ""])


def main(parser: OneLine, given: list[str]) -> int:
    """The whole command."""
    parser.add_argument("--seeds", type=at_least(1), nargs=2, default=(401, 420), help="the first and the last")
    parser.add_argument("--lengths", type=positive, nargs="+", default=(600.0, 300.0), help="km")
    parser.add_argument("--out", type=Path, default=DOCS / "process_strengths.md")
    chosen = parser.parse_args(given)
    return write_page(parser, chosen.out, lambda: page(chosen))


if __name__ == "__main__":
    sys.exit(main(command(__doc__), sys.argv[1:]))
