"""Are the stated sigmas honest at the peer's sizes? NEES of the points with the strict line and with the measured one.

Draws the peer's problems anew with its own generator (truth, a-priori orientation, every row), adjusts each with
`line = predicted` and `line = measured`, and normalises the errors of the points by their stated covariances: per
degree of freedom their mean is one if the sigmas are honest. Writes a table, docs/nees_peer.md by default.

    python scripts/nees_peer.py [S L] [--draws 12] [--shared DIR] [--out FILE]

Exit status: 0 done (the figures are in the table, inside their bands or not), 2 bad input.
"""

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from peer_blocks import PEER_SIZES, SHARED, peer_size
from peer_problem import PeerProblem, Truth, network, peer_orientation
from study import DOCS, at_least, chi_square_band, command, made_with, show, student, table, within, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import Line
from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.records import Array, Index
from mgsgraph.simulation.demo.truth import nees

FORMS: tuple[Line, ...] = ("predicted", "measured")
WORDS = """# NEES at the peer's sizes

Are the stated sigmas honest, and what does the measured line cost? Each draw is one of the C++ peer's own problems
(`shared/peer/gen.py`, seeds 0 .. N-1): truth, a-priori orientation, image places, ranges and footprints are drawn from
their sigmas; the line's noise is drawn in lines. The points' errors after the adjustment are normalised by the stated
covariances (for sigma0 = 1); the mean of (error' C^-1 error) / 3 over the points is 1 if they are honest. Made by
`scripts/nees_peer.py`.

* *predicted* is the strict form, and the default: the pose is taken where the point is predicted to be seen. *measured*
  is the papers' form, and the peer's: the pose is taken at the measured line, whose noise then sits in the design
  matrix.
* Points of one draw share its orientation, so that they are not independent; the draws are: 99% band of the mean, 1 +-
  Student's quantile times the scatter over the draws / sqrt(N).
* *orientation*: all coefficients, each alone: the mean of (error / sigma)^2; band as that of the points.
* *squares*: weighted squares of all rows over the degrees of freedom. Band: chi-square.
* *difference*: mean over the draws of measured minus predicted, with its standard error: both forms see the same draws.
"""
COLUMNS = ("ties", "laser", "orientation", "squares")


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """Normalised errors of one size in one form, per degree of freedom."""

    size: str
    form: Line
    values: Array
    """(draws, 4), see COLUMNS."""
    freedom: int
    """Degrees of freedom of one draw."""
    failures: int
    """Draws that did not converge; they are counted in."""
    seconds: float
    """Per draw, adjustment alone."""


def normalised(errors: Array, covariances: Array) -> float:
    """Mean of e' C^-1 e / 3 of errors (n, 3) with covariances (n, 3, 3); NaN for none."""
    return float(nees(errors, covariances).mean()) / 3.0 if errors.size else float("nan")


def figures(problem: PeerProblem, truth: Truth, solution: Solution) -> list[float]:
    """See COLUMNS."""
    error = solution.places - truth.places
    laser = np.zeros(error.shape[0], dtype=bool)
    laser[problem.shot_point] = True
    parts: list[Index] = [np.flatnonzero(part & solution.determined) for part in (~laser, laser)]
    points = [normalised(error[part], solution.covariances[part]) for part in parts]
    images = range(problem.orientation.shape[0])
    variances = np.array([np.diagonal(solution.image_covariance(j)).reshape(-1, 6).T for j in images])
    turned = peer_orientation(problem, solution.coefficients) - truth.orientation
    orientation = float((turned**2 / variances).mean())
    return [*points, orientation, solution.fit.squares / solution.fit.degrees_of_freedom]


def campaign(size: str, draws: int, shared: Path) -> list[Drawn]:
    """All draws of one size, each adjusted in both forms."""
    values = {form: np.empty((draws, len(COLUMNS))) for form in FORMS}
    failures, seconds, freedom = dict.fromkeys(FORMS, 0), dict.fromkeys(FORMS, 0.0), dict.fromkeys(FORMS, 0)
    for seed in range(draws):
        problem, truth = peer_size(size, shared, seed)
        for form in FORMS:
            show(f"{size} {form}: draw {seed + 1} of {draws}")
            taken, settings = network(problem, form)
            start = time.perf_counter()
            solution = adjust_network(taken, settings)
            seconds[form] += time.perf_counter() - start
            failures[form] += not solution.converged
            freedom[form] = solution.fit.degrees_of_freedom
            values[form][seed] = figures(problem, truth, solution)
    return [Drawn(size, form, values[form], freedom[form], failures[form], seconds[form] / draws) for form in FORMS]


def bands(one: Drawn) -> list[tuple[float, float]]:
    """99% bands of the means over the draws, if the sigmas are honest."""
    draws = one.values.shape[0]
    half = student(0.01, draws - 1) * one.values[:, :3].std(axis=0, ddof=1) / np.sqrt(draws)
    return [*((1.0 - width, 1.0 + width) for width in half.tolist()), chi_square_band(draws * one.freedom)]


def report(found: list[Drawn]) -> str:
    """The whole page."""
    head = ("size", "line", "N", *COLUMNS, "not converged", "s per draw")
    rows = []
    for one in found:
        cells = [within(mean, band) for mean, band in zip(one.values.mean(axis=0), bands(one), strict=True)]
        ends = (str(one.failures), f"{one.seconds:.2f}")
        rows.append((one.size, one.form, str(one.values.shape[0]), *cells, *ends))
    differences = []
    for strict, loose in zip(found[::2], found[1::2], strict=True):
        gap = loose.values[:, 0] - strict.values[:, 0]
        error = gap.std(ddof=1) / np.sqrt(gap.size)
        differences.append(f"* {strict.size}: difference of the ties' NEES {gap.mean():+.3f} +- {error:.3f}")
    return "\n".join([WORDS, *table(head, rows), "", *differences, "", made_with(), ""])


def main() -> int:
    parser = command(__doc__)
    parser.add_argument("sizes", nargs="*", metavar="SIZE", help=f"of {', '.join(PEER_SIZES)}; S and L when absent")
    parser.add_argument("--draws", type=at_least(2), default=12)
    parser.add_argument("--shared", type=Path, default=SHARED, help="folder with the peer's gen.py")
    parser.add_argument("--out", type=Path, default=DOCS / "nees_peer.md")
    wanted = parser.parse_args()
    for size in wanted.sizes:
        if size not in PEER_SIZES:
            parser.error(f"no size {size!r}; there are {', '.join(PEER_SIZES)}")
    sizes = wanted.sizes or ("S", "L")

    def page() -> str:
        return report([one for size in sizes for one in campaign(size, wanted.draws, wanted.shared)])

    return write_page(parser, wanted.out, page)


if __name__ == "__main__":
    sys.exit(main())
