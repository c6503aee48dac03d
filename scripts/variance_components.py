"""Do variance components find wrong sigmas, and are their own uncertainties right? A strip drawn over and over.

Planted: in each draw the groups of rows have errors 0.5, 2 or 5 times as large as their stated sigmas, by turns, all of
them at once (of position and pointing one in turn: on narrow images neither is worth much against the other);
`iterated_components` must find the factors. Null: all sigmas are right; one adjustment each, for the p-values
of the tests. Writes docs/variance_components.md by default.

    python scripts/variance_components.py [--planted 90] [--null 60] [--images 24] [--out FILE]
"""

import sys
import time
from pathlib import Path

import numpy as np
from scipy.stats import binom, chi2, kstest
from study import DOCS, Z99, at_least, command, show, write_page

from mgsgraph.adjustment.adjust import adjust_network, versions
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.components import Components, Judgement, components_of, iterated_components
from mgsgraph.analysis.grouping import Grouping, group_rows, scaled
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.residual_tests import ALPHA, chi_square_test, residual_statistics
from mgsgraph.network import Network
from mgsgraph.network.observations import observed
from mgsgraph.network.parts import KnownImage
from mgsgraph.simulation.observations import NoiseSettings
from mgsgraph.simulation.strip import StripSettings, simulate_strip

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from redraw import redraw

from mgsgraph.text import root_mean_square

FACTORS = (0.5, 2.0, 5.0)
NOISE = NoiseSettings(tie=0.5, shot_image=1.0, range=10.0, ground=3.0)
"""Under which every group of the strip can be judged."""
WORDS = """# Variance components: are planted factors found?

A strip, {network}, is drawn anew from its
sigmas, but with the errors of each group of rows 0.5, 2 or 5 times as large as the sigmas that the adjustment is given,
by turns and all groups at once, in {planted} draws; but of position and pointing priors one in turn is right (1), for
they can hardly be told apart on narrow images, and what one of them is thought to be decides what the other is found to
be. `iterated_components` scales and adjusts until all factors are one within 1%. Made by
`scripts/variance_components.py`; seeds from {first} on, {seconds:.0f} s on a busy machine.

* *z*: the factor found against the planted one as a standard normal deviate (Wilson & Hilferty's transform of the
  chi-square with the stated degrees of freedom). Mean 0 and rms 1 are promised; in brackets their 99% bands. *beyond*:
  draws with |z| > 2.58 (1% is promised), and how many a binomial law allows in 99% of cases.
* *spread*: standard deviation of ln(factor / planted) over the draws; *stated*: rms of the stated relative sigmas.
* *degrees*: median degrees of freedom of the squared factor. *not judged*: draws in which the group was called not
  judgeable; they have no z.
* *dependent*: draws whose verdict on the group says that it holds if another group's stated sigmas, which can't be
  judged, are right: their z are counted by themselves, and the other columns have the rest. Vague factors (sigma above
  15 %) that go together with another's (correlation above 0.5) are stated without a sigma, and count as not judged:
  what is the one's may have been booked under the other.
"""
NULL = """
## All sigmas right

{null} draws from the stated sigmas themselves, one adjustment each. Chi-square test: p-values uniform with
p = {uniform:.2g} (Kolmogorov & Smirnov), false alarms at {alpha:g}%: {alarms} of {null} ({low} to {high} allowed, 99%).
Squares over degrees of freedom: mean {ratio:.4f} (1 +- {band:.4f}, 99%). Helmert's matrix: rows add up to the
redundancies within {sum:.1e}.

*z*: as above, from a single pass. *p < 0.05*: draws whose normalised residuals fail the Kolmogorov-Smirnov test at 5%;
the test counts independent residuals on the safe side, so that fewer than 5% fail.

| group | rows | redundancy | z mean | z rms | p < 0.05 |
|---|---|---|---|---|---|
"""


def strip(images: int) -> Network:
    """The strip's network with the sigmas that it was drawn from."""
    made = simulate_strip(StripSettings(images=images, ties=20, shots=12, noise=NOISE))
    known = {image.name: KnownImage(image, NOISE.prior) for image in made.images}
    network = observed(known, [made.ties, *made.lasers], NOISE.tie, NOISE.shot_image)
    assert network is not None
    return network


def planted_factors(seed: int, groups: int) -> np.ndarray:
    """(g,) each group has each factor in every third draw, in changing company; but of the last two, position and
    pointing, one in turn is right.
    """
    blocks = np.random.default_rng([7, seed // 3]).permuted(np.tile(FACTORS, (groups, 1)), axis=1)
    factors = np.asarray(blocks[:, seed % 3])
    factors[-1 - seed // 3 % 2] = 1.0
    return factors


def planted(network: Network, grouping: Grouping, seeds: range) -> tuple[list[np.ndarray], list[Components], int]:
    """Planted factors and what was found, and how many did not come to rest."""
    truths, found, restless = list[np.ndarray](), list[Components](), 0
    for seed in seeds:
        truth = planted_factors(seed, len(grouping.names))
        drawn = redraw(scaled(network, grouping, truth), np.random.default_rng([1, seed])).network
        honest = iterated_components(scaled(drawn, grouping, 1.0 / truth), SolverSettings())
        restless += not honest.converged
        truths.append(truth)
        found.append(honest.components)
        show(f"planted: draw {len(found)} of {len(seeds)}")
    return truths, found, restless


def planted_table(names: tuple[str, ...], truths: list[np.ndarray], found: list[Components]) -> str:
    """A row for each group and factor, and one for each group."""
    lines = [
        "| group | planted | draws | z mean | z rms | beyond | spread | stated | degrees | dependent: draws, z rms | "
        "not judged |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for g, name in enumerate(names):
        for factors in [(one,) for one in (1.0, *FACTORS)] + [(1.0, *FACTORS)]:
            mine = [(t[g], c.groups[g]) for t, c in zip(truths, found, strict=True) if t[g] in factors]
            if not mine:
                continue
            good = [(t, one) for t, one in mine if one.judgement is Judgement.JUDGED]
            plain, dependent = ([(t, one) for t, one in good if bool(one.given) is which] for which in (False, True))
            z = np.array([one.deviation(t) for t, one in dependent])
            beside = f"{z.size}, {root_mean_square(z):.2f}" if z.size else "0"
            what = f"{factors[0]:g}" if len(factors) == 1 else "all"
            lines.append(f"| {name} | {what} | {len(mine)} | {figures(plain)} | {beside} | {len(mine) - len(good)} |")
    every = [(t[g], one) for t, c in zip(truths, found, strict=True) for g, one in enumerate(c.groups)]
    for which, what in ((False, "not dependent"), (True, "dependent")):
        good = [(t, one) for t, one in every if one.judgement is Judgement.JUDGED and bool(one.given) is which]
        lines.append(f"| all groups, {what} | all | {len(good)} | {figures(good)} | | |")
    return "\n".join(lines)


def figures(good: list) -> str:  # type: ignore[type-arg]
    """z, spread, stated sigma and degrees of the draws that were judged."""
    n = len(good)
    if n < 2:
        return "- | - | - | - | - | -"
    z = np.array([one.deviation(truth) for truth, one in good])
    logs = np.array([np.log(one.factor / truth) for truth, one in good])
    stated = root_mean_square(np.array([one.sigma / one.factor for _, one in good]))
    low, high = np.sqrt(chi2.ppf([0.005, 0.995], n) / n)
    beyond, allowed = int(np.count_nonzero(np.abs(z) > Z99)), int(binom.ppf(0.99, n, 0.01))
    degrees = np.median([one.degrees for _, one in good])
    return (
        f"{z.mean():.2f} (+-{Z99 / np.sqrt(n):.2f}) | {root_mean_square(z):.2f} ({low:.2f}-{high:.2f}) | "
        f"{beyond} ({allowed}) | {logs.std(ddof=1):.3f} | {stated:.3f} | {degrees:.0f}"
    )


def null_page(network: Network, grouping: Grouping, seeds: range) -> str:
    """Tests and components of draws from the stated sigmas."""
    tests, found, p_values, off = [], list[Components](), [], 0.0
    draws = len(seeds)
    for seed in seeds:
        solution = adjust_network(redraw(network, np.random.default_rng([2, seed])).network, SolverSettings())
        at = at_solution(solution)
        tests.append(chi_square_test(solution.fit))
        found.append(components_of(at, grouping))
        p_values.append([one.p_value for one in residual_statistics(at, grouping)])
        sums = found[-1].helmert.sum(axis=1) - np.array([one.redundancy for one in found[-1].groups])
        off = max(off, float(np.abs(sums).max()))
        show(f"null: draw {len(found)} of {draws}")
    low, high = binom.ppf([0.005, 0.995], draws, ALPHA).astype(int)
    degrees = tests[0].degrees
    page = NULL.format(
        null=draws, uniform=kstest([one.larger for one in tests], "uniform").pvalue, alpha=100 * ALPHA, low=low,
        high=high, alarms=sum(not one.passed for one in tests), sum=off,
        ratio=np.mean([one.squares for one in tests]) / degrees, band=Z99 * np.sqrt(2.0 / degrees / draws),
    )  # fmt: skip
    for g, name in enumerate(grouping.names):
        one, p = found[0].groups[g], np.array(p_values)[:, g]
        z = np.array([c.groups[g].deviation(1.0) for c in found if c.groups[g].judgement is Judgement.JUDGED])
        judged = f"{z.mean():.2f} | {root_mean_square(z):.2f}" if z.size else "- | -"
        page += f"| {name} | {one.rows} | {one.redundancy:.1f} | {judged} | "
        page += f"{100 * np.mean(p < 0.05):.0f}% |\n" if np.all(np.isfinite(p)) else "- |\n"
    return page


def main() -> int:
    """Draw, estimate, write."""
    parser = command(__doc__)
    parser.add_argument("--planted", type=at_least(0), default=90)
    parser.add_argument("--null", type=at_least(1), default=60)
    parser.add_argument("--first", type=at_least(0), default=0, help="first seed")
    parser.add_argument("--images", type=at_least(2), default=24)
    parser.add_argument("--out", type=Path, default=DOCS / "variance_components.md")
    options = parser.parse_args()

    def page() -> str:
        start, network = time.perf_counter(), strip(options.images)
        grouping = group_rows(network)
        first = options.first
        truths, found, restless = planted(network, grouping, range(first, first + options.planted))
        table = planted_table(grouping.names, truths, found)
        null = null_page(network, grouping, range(first, first + options.null))
        seconds = time.perf_counter() - start
        words = WORDS.format(network=network, planted=options.planted, first=first, seconds=seconds)
        rest = f"\nNot at rest after all passes: {restless} of {options.planted} draws.\n"
        return f"{words}\n{table}\n{rest}{null}\n{versions()}\n"

    return write_page(parser, options.out, page)


if __name__ == "__main__":
    sys.exit(main())
