"""Are the stated sigmas honest? NEES of orientation and points over many draws of the three simulated sites.

Every row and every orientation coefficient is drawn anew from its stated sigma (`tests/redraw.py`), the
network is adjusted, and the errors are normalised by the stated covariances: per degree of freedom their mean is one if
the sigmas are honest. Writes a table, docs/nees.md by default.

    python scripts/nees.py [--draws 100] [--first 0] [--sites eos gusev isidis] [--cases rigorous no-terrain papers]
                           [--out FILE]
"""

import sys
import tempfile
import time
from argparse import Namespace
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import study
from study import DOCS, at_least, chi_square_band, command, made_with, show, student, within, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.covariances import LINEAR
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.case.reading import read_case
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network, PointClass
from mgsgraph.simulation.demo.truth import nees
from mgsgraph.simulation.files import Weighting, write_site
from mgsgraph.simulation.site import SimulationOptions, simulate_site
from mgsgraph.simulation.sites import SITE_NAMES

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from redraw import redraw

COLUMNS = ("orientation", "shifts", "likelihood ratio", "ties", "laser", "squares")
"""Orientation coefficients; shifts of profiles and terrain; both by twice the rise of the cost at the truth; tie
points; footprints; weighted squares of all rows."""
CASES: dict[str, Weighting] = {"rigorous": "rigorous", "no-terrain": "rigorous", "papers": "papers"}
"""no-terrain is the rigorous case without its surface rows: what is left if these are at fault."""
WORDS = """# NEES of the three sites

Are the stated sigmas honest? Each draw takes the site's network (geometry, sigmas, terrain model), draws every
orientation coefficient, profile shift, footprint, image measure, range and terrain height anew from its stated sigma,
adjusts, and normalises the errors by the stated covariances (for sigma0 = 1). Per degree of freedom the mean is 1 if
they are honest. Made by `scripts/nees.py`; seeds {first} .. {last}.

* *orientation*: all orientation coefficients jointly; *shifts*: those of the profiles and of the terrain model,
  jointly. Band: chi-square with N times their number of degrees of freedom.
* *likelihood ratio*: orientation and shifts jointly, without linear error propagation: held at the truth, by how much
  more than at the optimum twice the cost is, per unknown (`Likelihood.ratio`). Band: chi-square.
* *linear*: by how much more than the joint error ellipsoid says the cost rises over draws from it (`Linearity.ratio`,
  mean), and in how many draws `adjust` says that the ellipsoid may be used.
* *ties*, *laser*: mean over the points of (error' C^-1 error) / 3. Points of one draw share its orientation, so that
  they are not independent; the draws are: 1 +- Student's 99% quantile times the scatter over the draws / sqrt(N).
* *squares*: weighted squares of all rows over the degrees of freedom. Band: chi-square.
* *no-terrain*: the rigorous case without surface rows, to tell where a fault lies.
* *not converged*: draws whose adjustment did not come to rest; they are counted in.
"""
READING = """
Where *rigorous* lies outside its band and *no-terrain* inside, the surface rows are the cause. A tie's height above the
grid says something of the horizontal place only by the ground's slope, which differs from post to post (463 m): over
the hundred metres to which that place is known, the cost may have several minima. `adjust` looks for them and states
the sigmas of their mixture ([](minima.md)). A band that reaches below zero says that a few draws dominate: it tells
nothing.
Where *no-terrain* lies outside, as Eos' orientation does, its priors are too wide for linear error
propagation: 3', 6' and 10' (twice that for the second image), equally wide along the image. (Tried once, 60 draws
without terrain: 1.33 with these sigmas, 1.01 with half of them, 0.97 with a tenth.) The likelihood ratio of the same
draws is in its band, `adjust` says that the case is not linear, and the points are honest there. Single coefficients'
intervals by the likelihood are those by the covariance to 0.5 % (`mgsgraph analyze RESULT --likelihood IMAGE`): what
bends is the valley between them. (The other sites without terrain are a little bent, too, 1.04 to 1.05: within what
counts as linear, and over 200 draws at the edge of the band.)
"""
PAPERS = """
`papers` has no band. Its MOLA image rows are projections of the footprints with the *nominal* orientation: they say
what the orientation's prior says, some hundred times over, as if each were a measurement of its own with a sigma of
40, 22 or 30 px. The adjustment believes them: it states sigmas of the orientation far below the prior's, around
an orientation that is still nothing but the nominal one, from which the truth is as far as the prior says. Hence the
large NEES of the orientation and the tie points. Footprints are held by their own 10 m and hardly move: theirs is about
one. The squares say nothing, for the same reason: back-projected rows have no noise, and contradict each other by
what was drawn of the orientation.
"""


@dataclass(frozen=True)
class Campaign:
    """Normalised errors of one case over all draws, per degree of freedom."""

    site: str
    case: str
    values: Array
    """(draws, 6), see COLUMNS."""
    linear: Array
    """(draws,) ratios of linearity."""
    degrees: tuple[int, ...]
    """Degrees of freedom of each column in one draw."""
    failures: int
    """Draws that did not converge."""
    seconds: float
    """Wall time."""


def campaign(site: str, case: str, network: Network, settings: SolverSettings, seeds: range) -> Campaign:
    """Adjust draws of a network."""
    start, values, linear, failures = time.perf_counter(), np.empty((len(seeds), len(COLUMNS))), list[float](), 0
    for k, seed in enumerate(seeds):
        values[k], degrees, solution = one_draw(network, settings, seed)
        failures += not solution.converged
        linear.append(solution.linearity.ratio if solution.linearity else float("nan"))
        show(f"{site} {case}: draw {k + 1} of {len(seeds)}")
    return Campaign(site, case, values, np.array(linear), degrees, failures, time.perf_counter() - start)


def one_draw(network: Network, settings: SolverSettings, seed: int) -> tuple[list[float], tuple[int, ...], Solution]:
    """Normalised errors of one draw, their degrees of freedom, and the adjustment."""
    draw = redraw(network, np.random.default_rng(seed), settings.angles)
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
    degrees = (
        orientation, error.size - orientation, ratio.degrees, *(3 * one.size for one in points), freedom
    )  # fmt: skip
    return values, degrees, solution


def shared_nees(error: Array, covariance: Array) -> float:
    """Normalised error of shared unknowns per degree of freedom; NaN where there are none."""
    return float(nees(error[None], covariance[None])[0]) / error.size if error.size else float("nan")


def bands(found: Campaign) -> list[tuple[float, float]]:
    """99% bands of the means over all draws, if the sigmas are honest."""
    draws = found.values.shape[0]
    result = []
    for k, name in enumerate(COLUMNS):
        if name not in ("ties", "laser") and found.degrees[k]:
            result.append(chi_square_band(draws * found.degrees[k]))
        else:
            half = student(0.01, draws - 1) * found.values[:, k].std(ddof=1) / np.sqrt(draws)
            result.append((1.0 - half, 1.0 + half))
    return result


def table(found: list[Campaign]) -> list[str]:
    """Markdown: means, with their bands for the rigorous case."""
    rows = []
    for one in found:
        draws, means = one.values.shape[0], one.values.mean(axis=0)
        if one.case == "papers":
            cells = [f"{mean:.3g}" for mean in means]
        else:
            cells = [within(mean, band) for mean, band in zip(means, bands(one), strict=True)]
        told = one.linear[np.isfinite(one.linear)]
        good = int(np.sum((told <= LINEAR) & (told >= 1.0 / LINEAR)))
        linear = f"{told.mean():.2f}, {good} of {told.size}"
        rows.append((one.site, one.case, str(draws), *cells, linear, str(one.failures), f"{one.seconds / draws:.1f}"))
    return study.table(("site", "case", "N", *COLUMNS, "linear", "not converged", "s per draw"), rows)


def page(wanted: Namespace) -> str:
    """All campaigns, and their page."""
    found, seeds = [], range(wanted.first, wanted.first + wanted.draws)
    with tempfile.TemporaryDirectory() as folder:
        for site in wanted.sites:
            simulated = simulate_site(site, 1, SimulationOptions("published", pictures=False))
            for case in wanted.cases:
                read = read_case(write_site(simulated, Path(folder, site), CASES[case]))
                network = replace(read.network, surface=None) if case == "no-terrain" else read.network
                found.append(campaign(site, case, network, read.settings, seeds))
    words = WORDS.format(first=seeds[0], last=seeds[-1])
    return "\n".join([words, *table(found), READING, PAPERS, made_with(), ""])


def main() -> int:
    parser = command(__doc__)
    parser.add_argument("--draws", type=at_least(2), default=100, help="2 or more, to know their scatter")
    parser.add_argument("--first", type=at_least(0), default=0, help="first seed")
    parser.add_argument("--sites", nargs="+", choices=SITE_NAMES, default=SITE_NAMES)
    parser.add_argument("--cases", nargs="+", choices=tuple(CASES), default=tuple(CASES))
    parser.add_argument("--out", type=Path, default=DOCS / "nees.md")
    wanted = parser.parse_args()
    return write_page(parser, wanted.out, lambda: page(wanted))


if __name__ == "__main__":
    sys.exit(main())
