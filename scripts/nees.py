"""Are the stated sigmas right? NEES of orientation and points over many draws of the three simulated sites.

Every row and every orientation coefficient is drawn anew from its stated sigma (`tests/redraw.py`), the
network is adjusted, and the errors are normalized by the stated covariances: per degree of freedom their mean is one if
the sigmas are right. Fills the table of docs/nees.md.

    python scripts/nees.py [--seeds 100] [--first 1] [--cases eos ...] [--processes N] [--out FILE]

A case is a site and a weighting: `no-terrain` is `rigorous` without its surface rows, what is left if these are at
fault; `papers` has the papers' weighting. Exit status: 0 done (whatever the figures are), 2 bad input.
"""

import sys
import tempfile
import time
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from study import Blocks, Draw, cases, names_of, nees_cell, run, seeds_of, table

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.covariances import LINEAR
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.case.reading import read_case
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network, PointClass
from mgsgraph.simulation.demo.truth import nees
from mgsgraph.simulation.files import write_site
from mgsgraph.simulation.site import SimulationOptions, simulate_site
from mgsgraph.simulation.sites import SITE_NAMES

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from redraw import redraw

COLUMNS = ("orientation", "shifts", "likelihood ratio", "ties", "laser", "squares")
"""Orientation coefficients; shifts of profiles and terrain; both by twice the rise of the cost at the truth; tie
points; footprints; weighted squares of all rows."""
CASES = tuple(f"{site}, {case}" for site in SITE_NAMES for case in ("rigorous", "no-terrain", "papers"))


@lru_cache(maxsize=len(CASES))
def prepared(case: str) -> tuple[Network, SolverSettings]:
    """The network of a case, as it is read from files, and its settings."""
    site, weighting = case.split(", ")
    with tempfile.TemporaryDirectory() as folder:
        simulated = simulate_site(site, 1, SimulationOptions("published", pictures=False))
        read = read_case(write_site(simulated, Path(folder), "papers" if weighting == "papers" else "rigorous"))
    network = replace(read.network, surface=None) if weighting == "no-terrain" else read.network
    return network, read.settings


def one_draw(case: str, seed: int) -> Draw:
    """Normalized errors of one draw per degree of freedom, and their degrees of freedom."""
    network, settings = prepared(case)
    begin, draw = time.perf_counter(), redraw(network, np.random.default_rng(seed), settings.angles)
    solution = adjust_network(draw.network, settings)
    found = [one.ravel() for one in (*solution.coefficients, solution.shifts, *solution.shared)]
    adjusted = np.repeat(~network.held, [one.size for one in solution.coefficients])
    orientation = int(np.count_nonzero(adjusted))
    error = np.concatenate(found) - draw.vector
    error = np.concatenate([error[: adjusted.size][adjusted], error[adjusted.size :]])
    joint, variables = solution.joint_covariance, solution.joint_covariance.adjusted
    of_images = variables < len(network.images)
    shared = [
        shared_nees(error[:orientation], joint.of(variables[of_images])),
        shared_nees(error[orientation:], joint.of(variables[~of_images])),
    ]
    members = [solution.members(kind) for kind in (PointClass.TIE, PointClass.LASER)]
    points = [nees((solution.places - draw.places)[one], solution.covariances[one]) for one in members]
    freedom = solution.fit.degrees_of_freedom
    names = [*(image.name for image in network.images), *network.shift_names, *(one.name for one in network.shared)]
    truth = dict(zip(names, (*(one.coefficients for one in draw.own), *draw.shifts, *draw.shared), strict=True))
    for j in np.flatnonzero(network.held).tolist():
        del truth[names[j]]
    ratio = Posterior.of(solution).likelihood.ratio(truth)
    shared.append(ratio.squares / ratio.degrees)
    values = [*shared, *(float(one.mean()) / 3.0 for one in points), solution.fit.squares / freedom]
    return {
        "values": values, "degrees": [orientation, error.size - orientation, ratio.degrees, 0, 0, freedom],
        "linear": solution.linearity.ratio if solution.linearity else None, "converged": solution.converged,
        "seconds": time.perf_counter() - begin,
    }  # fmt: skip


def shared_nees(error: Array, covariance: Array) -> float:
    """Normalized error of shared unknowns per degree of freedom; NaN where there are none."""
    return float(nees(error[None], covariance[None])[0]) / error.size if error.size else float("nan")


def row(case: str, every: list[Draw]) -> list[str]:
    """Means of all draws, with their bands but for the papers' case."""
    values, degrees = np.array([draw["values"] for draw in every]), every[0]["degrees"]
    cells = [f"{mean:.3g}" for mean in values.mean(axis=0)]
    if not case.endswith("papers"):
        cells = [nees_cell(column, freedom) for column, freedom in zip(values.T.tolist(), degrees, strict=True)]
    ratios = np.array([draw["linear"] for draw in every if draw["linear"] is not None])
    good = int(np.sum((ratios <= LINEAR) & (ratios >= 1.0 / LINEAR)))
    linear = f"{ratios.mean():.2f}, {good} of {ratios.size}" if ratios.size else "-"
    failures, seconds = (sum(not draw["converged"] for draw in every), np.mean([draw["seconds"] for draw in every]))
    return [*case.split(", "), str(len(every)), *cells, linear, str(failures), f"{seconds:.1f}"]


def judge(every: list[Draw]) -> Blocks:
    """The table."""
    head = ("site", "case", "N", *COLUMNS, "linear", "not converged", "s per draw")
    return {"nees": table(head, [row(case, cases(every, case)) for case in names_of(every)])}


if __name__ == "__main__":
    sys.exit(run(seeds_of(__doc__, CASES, 100, "nees.md"), one_draw, judge))
