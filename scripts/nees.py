"""Are the stated sigmas right? NEES of orientation and points over many draws of the three sites, a strip and a rig.

Every row and every orientation coefficient or node is drawn anew from its stated sigma (`tests/redraw.py`), the
network is adjusted, and the errors are normalized by the stated covariances: per degree of freedom their mean is one if
the sigmas are right. Fills the table of docs/evidence_consistency.md.

    python scripts/nees.py [--seeds 100] [--first 1] [--cases eos ...] [--processes N] [--out FILE]

A case is a site and a weighting: `no-terrain` is `rigorous` without its surface rows, what is left if these are at
fault; `papers` has the papers' weighting. Two more are an HRSC strip, whose five lines are one pass, and two passes of
LROC's narrow angles with an unknown boresight. Exit status: 0 done (whatever the figures are), 2 bad input.
"""

import sys
import tempfile
import time
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.linalg import block_diag
from study import Blocks, Draw, cases, degrees_of_points, names_of, nees_cell, number, run, seeds_of, table

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.covariances import LINEAR
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.case.reading import read_case
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network, PointClass
from mgsgraph.network.passes import PolynomialPrior
from mgsgraph.simulation.demo.demonstration import nees
from mgsgraph.simulation.files import write_site
from mgsgraph.simulation.site import SimulationOptions, simulate_site
from mgsgraph.simulation.sites import SITE_NAMES

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from mex_block import BlockSettings, simulate_hrsc_block
from mex_flight import PointMatching
from nac_pair import powers, simulate_nac_pair
from redraw import Draw as Redrawn
from redraw import polynomial_sigmas, redraw

COLUMNS = ("orientation", "passes", "shifts", "likelihood ratio", "ties", "laser", "squares")
"""Images' orientation coefficients; nodes of passes; shifts of profiles and terrain; all but passes by
twice the rise of the cost at the truth; tie points; footprints; weighted squares of all rows."""
CASES = tuple(f"{site}, {case}" for site in SITE_NAMES for case in ("rigorous", "no-terrain", "papers"))
STRIP = BlockSettings(passes=1, length=120e3, points=240, matches=PointMatching(blunders=0.0), terrain=None)
CASES += ("HRSC strip, passes", "NAC pair, rig")


@lru_cache(maxsize=len(CASES))
def prepared(case: str) -> tuple[Network, SolverSettings]:
    """The network of a case (a site's as it is read from files), and its settings."""
    if case == "HRSC strip, passes":
        return simulate_hrsc_block(STRIP, 1).network, SolverSettings()
    if case == "NAC pair, rig":
        return simulate_nac_pair().network, SolverSettings()
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
    errors = errors_of(solution, draw)
    first, passes = len(network.images), network.first_of_passes[0]
    groups = [[k for k in errors if low <= k < high] for low, high in ((0, first), (passes, 1 << 30), (first, passes))]
    joint = solution.joint_covariance
    pairs = [(np.concatenate([errors[k] for k in group]), joint.of(group)) if group else None for group in groups]
    pairs[1] = pairs[1] and as_polynomials(network, *pairs[1])
    shared = [shared_nees(*pair) if pair else float("nan") for pair in pairs]
    members = [solution.members(kind) for kind in (PointClass.TIE, PointClass.LASER)]
    points = [nees((solution.places - draw.places)[group], solution.covariances[group]) for group in members]
    freedom = solution.fit.degrees_of_freedom
    names = [*network.image_names, *network.shift_names, *(u.name for u in network.shared)]
    truth = [*(correction.coefficients for correction in draw.own), *draw.shifts, *draw.shared]
    ratio = Posterior.of(solution).likelihood.ratio({names[k]: truth[k] for k in errors if k < passes})
    shared.append(ratio.chi_square / ratio.degrees if ratio.degrees else float("nan"))
    of_points = [float(squares.mean()) / 3.0 if squares.size else float("nan") for squares in points]
    return {
        "values": [*shared, *of_points, solution.fit.squares / freedom],
        "degrees": [
            *(pair[0].size if pair else 0 for pair in pairs), ratio.degrees,
            *(degrees_of_points(solution, group) if group.size else 0 for group in members), freedom,
        ],
        "linear": solution.linearity.ratio if solution.linearity else None, "converged": solution.converged,
        "seconds": time.perf_counter() - begin,
    }  # fmt: skip


def errors_of(solution: Solution, draw: Redrawn) -> dict[int, Array]:
    """Estimate minus truth of each variable of the joint covariance: images' coefficients, shifts and shared unknowns,
    and the nodes of passes.
    """
    network, first = solution.network, len(solution.network.images)
    errors = {
        j: (solution.coefficients[j] - draw.own[j].coefficients).ravel()
        for j in np.flatnonzero(network.with_polynomial).tolist()
    }
    pairs = zip((*solution.shifts, *solution.shared), (*draw.shifts, *draw.shared), strict=True)
    errors |= {first + k: estimate - true for k, (estimate, true) in enumerate(pairs)}
    for nodes, (pass_, variable) in zip(solution.nodes, network.numbered_passes, strict=True):
        true = draw.own[pass_.images[0]].coefficients[-len(pass_.nodes) :]
        errors |= {variable + k: off for k, off in enumerate(nodes - true)}
    return errors


def as_polynomials(network: Network, error: Array, covariance: Array) -> tuple[Array, Array]:
    """Errors of the nodes of all passes and their covariance; for passes that are polynomials, of their coefficients
    in place of nodes, without held ones.
    """
    if not isinstance(network.passes[0].prior, PolynomialPrior):
        return error, covariance
    transform = block_diag(*(np.kron(np.linalg.inv(powers(pass_.nodes)), np.eye(6)) for pass_ in network.passes))
    free = np.concatenate([polynomial_sigmas(pass_).ravel() for pass_ in network.passes]) > 0.0
    return (transform @ error)[free], (transform @ covariance @ transform.T)[np.ix_(free, free)]


def shared_nees(error: Array, covariance: Array) -> float:
    """Normalized error of shared unknowns per degree of freedom."""
    return float(nees(error[None], covariance[None])[0]) / error.size


def row(case: str, draws: list[Draw]) -> list[str]:
    """Means of all draws, with their bands but for the papers' case."""
    values, degrees = (np.array([draw[key] for draw in draws]) for key in ("values", "degrees"))
    cells = [number(mean) for mean in values.mean(axis=0).tolist()]
    if not case.endswith("papers"):
        cells = list(map(nees_cell, values.T.tolist(), degrees.T.tolist()))
    ratios = np.array([draw["linear"] for draw in draws if draw["linear"] is not None])
    good = int(np.sum((ratios <= LINEAR) & (ratios >= 1.0 / LINEAR)))
    linear = f"{ratios.mean():.2f}, {good} of {ratios.size}" if ratios.size else "-"
    failures, seconds = (sum(not draw["converged"] for draw in draws), np.mean([draw["seconds"] for draw in draws]))
    return [*case.split(", "), str(len(draws)), *cells, linear, str(failures), f"{seconds:.1f}"]


def judge(draws: list[Draw]) -> Blocks:
    """The table."""
    head = ("site", "case", "N", *COLUMNS, "linear", "not converged", "s per draw")
    return {"nees": table(head, [row(case, cases(draws, case)) for case in names_of(draws)])}


if __name__ == "__main__":
    sys.exit(run(seeds_of(__doc__, CASES, 100, "evidence_consistency.md#nees"), one_draw, judge))
