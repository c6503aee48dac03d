"""Yoon & Shan's tables beside what this program makes of the simulated sites with the papers' weights.

Simulates the three sites, reads them back through their files, adjusts the case `papers` of each, and puts every table
beside the published numbers. Fills docs/papers.md.

    python scripts/reproduce_papers.py [--sites eos gusev isidis] [--seed 1] [--out FILE]
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import papers_balance as balance
import papers_tables as tables
from papers_tables import Result
from study import DOCS, Blocks, command, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import adjust, read_case
from mgsgraph.simulation.files import write_site
from mgsgraph.simulation.site import SimulationOptions, simulate_site
from mgsgraph.simulation.sites import SITE_NAMES

STATED_BIAS = 0.95
"""s, attitude-time bias of the nadir CK that gives the 325 m of the papers' text."""
PUBLISHED = SimulationOptions(errors="published", tie_noise=balance.tie_noise(), pictures=False)
"""Kernels as wrong as the papers found them, and ties as good."""


def reproduced(site: str, seed: int, folder: Path, options: SimulationOptions) -> Result:
    """A site simulated, written, read back and adjusted with the weights that balance Table 5."""
    one = simulate_site(site, seed, options)
    case = read_case(write_site(one, folder, "papers"))
    sigmas = balance.implied_sigmas(site, balance.seen_in(case.network))
    case = replace(case, network=balance.weighed(case.network, sigmas))
    solution = adjust(case)
    if not solution.converged:
        raise SystemExit(f"{site}: the papers' case did not converge ({solution.message})")
    return Result(site, one, case, solution)


def page(results: list[Result], seed: int, work: Path) -> Blocks:
    """All tables."""
    return {
        "required": tables.requirements(results),
        "images": [line for one in results for line in (*tables.properties(one), "")],
        "orientation": [line for one in results for line in (*tables.orientation_table(one), "")],
        "points": tables.tie_table(results),
        "sigmas": tables.sigma_table([row for one in results for row in with_weights(one)]),
        "balance": balance.balance_table({one.site: one.case.network for one in results}),
        "residuals": tables.residual_table(results),
        "ranges": tables.range_table(results),
        "shift": tables.shift_table([pair for one in results for pair in with_biases(one, seed, work)]),
        "weights": [line for one in results for line in (*tables.sensitivity_table(one), "")],
    }


def with_weights(one: Result) -> list[tuple[str, str, Solution]]:
    """A site adjusted with the weights that balance Table 5, with those of x alone, and with those of the text."""
    network, settings = one.case.network, one.case.settings
    x_alone = np.repeat(balance.implied_sigmas(one.site, balance.seen_in(network))[:, :1], 2, axis=1)
    stated = np.full((2, 2), balance.STATED_SIGMA)
    alone, text = (adjust_network(balance.weighed(network, each), settings) for each in (x_alone, stated))
    return [(one.site, "papers' case", one.solution), (one.site, "y as x", alone), (one.site, "30 px", text)]


def with_biases(one: Result, seed: int, work: Path) -> list[tuple[str, Result]]:
    """A site with its own attitude-time bias and with that of the text."""
    if one.site == "eos":
        return [("the site's", one)]
    options = replace(PUBLISHED, attitude_time_bias=STATED_BIAS)
    stated = reproduced(one.site, seed, work / f"{one.site}_stated", options)
    return [("the site's", one), (f"{STATED_BIAS:g} s", stated)]


def main() -> int:
    parser = command(__doc__)
    parser.add_argument("--sites", nargs="+", choices=SITE_NAMES, default=SITE_NAMES)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=DOCS / "papers.md")
    wanted = parser.parse_args()

    def make() -> Blocks:
        with tempfile.TemporaryDirectory() as folder:
            results = [reproduced(site, wanted.seed, Path(folder) / site, PUBLISHED) for site in wanted.sites]
            return page(results, wanted.seed, Path(folder))

    return write_page(parser, wanted.out, "papers.md", make)


if __name__ == "__main__":
    sys.exit(main())
