"""Yoon & Shan's tables and figures beside what this program makes of the simulated sites with the papers' weights.

Simulates the three sites, reads them back through their files, adjusts the case `papers` of each, and puts every table
beside the published numbers, with a word where a simulation can't be expected to match, and why.

    python scripts/reproduce_papers.py [--sites eos gusev isidis] [--seed 1] [--out docs] [--no-figures]

Prints the page and writes it as papers.md, with its figures in papers/, into the folder --out.
"""

import sys
import tempfile
from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import papers_balance as balance
import papers_tables as tables
import papers_words as words
import published
from papers_tables import Result
from study import DOCS, command, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import adjust, read_case
from mgsgraph.simulation.files import write_site
from mgsgraph.simulation.site import SimulatedSite, SimulationOptions, simulate_site
from mgsgraph.simulation.sites import SITE_NAMES
from mgsgraph.units import DEG

STATED_BIAS = 0.95
"""s, attitude-time bias of the nadir CK that gives the 325 m of the papers' text."""
SHAN_EMISSION = 22.0 * DEG
"""rad, of Eos' off-nadir image in Shan's orientation; Table 1 has 17.97 deg."""
PUBLISHED = SimulationOptions(errors="published", tie_noise=balance.tie_noise(), pictures=False)
"""Kernels as wrong as the papers found them, and ties as good."""
SHOWN = ("orientation", "arrows", "overlay_1", "overlay_2")
"""Figures that the page shows."""


def simulated(site: str, seed: int, folder: Path, options: SimulationOptions) -> tuple[SimulatedSite, Path]:
    """A site and the path of its case `papers`."""
    one = simulate_site(site, seed, options)
    return one, write_site(one, folder, "papers")


def reproduced(site: str, seed: int, folder: Path, options: SimulationOptions) -> Result:
    """A site simulated, written, read back and adjusted with the weights that balance Table 5."""
    one, path = simulated(site, seed, folder, options)
    case = read_case(path)
    sigmas = balance.implied_sigmas(site, balance.seen_in(case.network))
    case = replace(case, network=balance.weighed(case.network, sigmas))
    solution = adjust(case)
    if not solution.converged:
        raise SystemExit(f"{site}: the papers' case did not converge ({solution.message})")
    return Result(site, one, case, solution)


def page(results: list[Result], seed: int, work: Path, figures: bool) -> list[str]:
    """All tables as Markdown."""
    eos = [one for one in results if one.site == "eos"]
    return [
        words.HEAD.format(seed=seed),
        "## What is required",
        "",
        *tables.requirements(results),
        "",
        *_sections(results, seed, work),
        *(_eos(eos[0], seed, work) if eos else []),
        *(_pictures(results) if figures else []),
    ]


def _sections(results: list[Result], seed: int, work: Path) -> list[str]:
    return [
        "## Table 1: images and profiles", "",
        *_each(results, tables.properties), words.TABLE_1,
        "## Table 2: orientation, refined minus SPICE (31 places)", "",
        *_each(results, tables.orientation_table), words.TABLE_2,
        "## Table 3: ground points, adjusted minus intersected with the SPICE polynomials", "",
        *tables.tie_table(results), "", words.TABLE_3,
        "## Table 4: sigmas and sigma0", "",
        *_sigmas(results),
        "## Table 5 and ISPRS Table 3: corrections of MOLA image points, residuals of ties", "",
        *tables.residual_table(results), "", words.TABLE_5,
        "## Range residuals", "",
        *tables.range_table(results), "", words.RANGES,
        "## The shift along the flight", "",
        *_shifts(results, seed, work), "", words.SHIFT,
        "## Weights halved and doubled", "",
        *_each(results, tables.sensitivity_table), words.WEIGHTS,
    ]  # fmt: skip


def _each(results: list[Result], table: Callable[[Result], list[str]]) -> list[str]:
    """A table of each site, with an empty line after it."""
    return [line for one in results for line in (*table(one), "")]


def _sigmas(results: list[Result]) -> list[str]:
    """Table 4 with the weights that balance Table 5, and with others; then what the published numbers imply."""
    rows, with_one = list[tuple[str, str, Solution]](), list[float]()
    for one in results:
        network, settings = one.case.network, one.case.settings
        seen = balance.seen_in(network)
        x_alone = np.repeat(balance.implied_sigmas(one.site, seen)[:, :1], 2, axis=1)
        stated = np.full((2, 2), balance.STATED_SIGMA)
        alone, text = (adjust_network(balance.weighed(network, each), settings) for each in (x_alone, stated))
        rows += [(one.site, "papers' case", one.solution), (one.site, "y as x", alone), (one.site, "30 px", text)]
        if one.site == "eos":
            wanted = published.TABLE_4["PE&RS"]["eos"].tie
            found = tables.scaled(tables.sigmas_of(alone)).tie
            with_one = [theirs / mine for mine, theirs in zip(found, wanted, strict=True)]
    networks = {one.site: one.case.network for one in results}
    shares = {one.site: tables.shares_of_positions(one) for one in results if one.site != "eos"}
    return [
        *tables.sigma_table(rows), "", words.TABLE_4.format(noise=PUBLISHED.tie_noise),
        "### Weights that balance Table 5", "",
        *balance.balance_table(networks), "", words.BALANCE.format(worst=100.0 * balance.worst_sigma0()),
        "### Published numbers that exclude each other", "",
        *balance.contradictions(with_one, shares), "", words.CONTRADICTIONS,
    ]  # fmt: skip


def _shifts(results: list[Result], seed: int, work: Path) -> list[str]:
    named = []
    for one in results:
        named.append(("the site's", one))
        if one.site != "eos":
            options = replace(PUBLISHED, attitude_time_bias=STATED_BIAS)
            named.append((f"{STATED_BIAS:g} s", reproduced(one.site, seed, work / f"{one.site}_stated", options)))
    return tables.shift_table(named)


def _eos(eos: Result, seed: int, work: Path) -> list[str]:
    """The tables of Shan, Yoon et al. (2002)."""
    tilted, _ = simulated("eos", seed, work / "eos_shan", replace(PUBLISHED, emission=SHAN_EMISSION))
    shan = tuple(image.nominal for image in tilted.images)
    named = [("simulated, 17.97 deg", eos.nominal), ("simulated, 22 deg", shan)]
    return [
        "## Shan, Yoon et al. (2002): orientation and footprints of Eos", "",
        *tables.eos_orientation(named), "", words.EOS,
        *tables.footprint_table(eos), "", words.FOOTPRINTS,
    ]  # fmt: skip


def _pictures(results: list[Result]) -> list[str]:
    text = ["## Figures", ""]
    for one in results:
        title = one.simulated.settings.title
        text += [f"![{title}, {name}](papers/{one.site}/{name}.png)" for name in SHOWN]
    return [*text, ""]


def draw_all(results: list[Result], folder: Path) -> None:
    """The figures of each site into a folder of its own."""
    from papers_figures import draw

    for one in results:
        draw(one.case, one.solution, *tables.differences(one), folder / one.site)
        for path in (folder / one.site).iterdir():
            if path.stem not in SHOWN:
                path.unlink()


def reproduce(wanted: Namespace) -> str:
    """All sites; the page, once its figures are drawn."""
    options = replace(PUBLISHED, pictures=not wanted.no_figures)
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        results = [reproduced(site, wanted.seed, work / site, options) for site in wanted.sites]
        text = "\n".join(page(results, wanted.seed, work, not wanted.no_figures))
        if not wanted.no_figures:
            draw_all(results, wanted.out / "papers")
    return text


def main() -> int:
    parser = command(__doc__)
    parser.add_argument("--sites", nargs="+", choices=SITE_NAMES, default=SITE_NAMES)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=DOCS)
    parser.add_argument("--no-figures", action="store_true")
    wanted = parser.parse_args()
    return write_page(parser, wanted.out / "papers.md", lambda: reproduce(wanted))


if __name__ == "__main__":
    sys.exit(main())
