"""Do variance components find wrong sigmas, and are their own uncertainties right? A strip drawn over and over.

Case *planted*: in each draw the groups of rows have errors 0.5, 2 or 5 times as large as their stated sigmas, by turns,
all of them at once (of position and pointing one in turn: on narrow images neither is worth much against the other);
`iterated_components` must find the factors. Case *right*: all sigmas are right; one adjustment each, for the p-values
of the tests. Fills docs/evidence_errors.md.

    python scripts/variance_components.py [--cases planted right] [--seeds 90] [--first 1] [--processes N] [--out FILE]
"""

import sys
from functools import cache
from pathlib import Path

import numpy as np
from scipy.stats import binom, chi2, kstest
from study import Z99, Blocks, Draw, cases, chi_square_band, run, seeds_of, table

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.components import Components, Judgement, components, iterated_components
from mgsgraph.analysis.grouping import group_rows, scaled
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.residual_tests import residual_statistics
from mgsgraph.network import Network
from mgsgraph.network.observations import build_network
from mgsgraph.network.parts import KnownImage
from mgsgraph.simulation.observations import NoiseSettings
from mgsgraph.simulation.strip import StripSettings, simulate_strip

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from redraw import redraw

from mgsgraph.text import root_mean_square as rms

ALPHA = 0.05
"""Of the two-sided test of all squares."""
FACTORS = (0.5, 2.0, 5.0)
NOISE = NoiseSettings(tie=0.5, shot_image=1.0, range=10.0, ground=3.0)
"""Under which every group of the strip can be judged."""
STRIP = StripSettings(images=24, ties=20, shots=12, noise=NOISE)
WIDTHS = ("planted", "draws", "z mean", "z rms", "beyond", "spread", "stated", "degrees", "not judged")


@cache
def strip() -> Network:
    """The strip's network with the sigmas that it was drawn from."""
    made = simulate_strip(STRIP)
    known = {image.name: KnownImage(image, NOISE.prior) for image in made.images}
    network = build_network(known, [made.ties, *made.lasers], NOISE.tie, NOISE.shot_image)
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


def one_draw(case: str, seed: int) -> Draw:
    """Components where factors are planted, or tests and components where all sigmas are right."""
    network, settings = strip(), SolverSettings()
    grouping = group_rows(network)
    if case == "planted":
        truth = planted_factors(seed, len(grouping.names))
        draw = redraw(scaled(network, grouping, truth), np.random.default_rng([1, seed])).network
        found = iterated_components(scaled(draw, grouping, 1.0 / truth), settings)
        return {"converged": found.converged, "groups": of_groups(found.components, truth)}
    solution = adjust_network(redraw(network, np.random.default_rng([2, seed])).network, settings)
    at, fit = at_solution(solution), solution.fit
    larger = float(chi2.sf(fit.squares, fit.degrees_of_freedom))
    found = components(at, grouping)
    sums = found.helmert.sum(axis=1) - [one.redundancy for one in found.groups]
    return {
        "groups": of_groups(found, np.ones(len(grouping.names))), "off": float(np.abs(sums).max()),
        "passed": bool(min(larger, 1.0 - larger) >= 0.5 * ALPHA), "larger": larger,
        "squares": float(fit.squares / fit.degrees_of_freedom), "degrees": int(fit.degrees_of_freedom),
        "p": [float(one.p_value) for one in residual_statistics(at, grouping)],
    }  # fmt: skip


def of_groups(found: Components, truth: np.ndarray) -> list[Draw]:
    """Of each group the planted factor, and where it was judged the factor's deviation from it (standard normal), ln of
    their ratio, its stated relative sigma and its degrees of freedom.
    """
    groups = []
    for factor, one in zip(truth.tolist(), found.groups, strict=True):
        told: Draw = {"name": one.name, "planted": factor, "rows": int(one.rows), "redundancy": float(one.redundancy)}
        if one.judgement is Judgement.JUDGED:
            told |= {
                "z": float(one.deviation(factor)), "ln": float(np.log(one.factor / factor)),
                "sigma": float(one.sigma / one.factor), "degrees": float(one.degrees),
            }  # fmt: skip
        groups.append(told)
    return groups


def planted_rows(every: list[Draw]) -> list[list[str]]:
    """A row for each group and factor, and one for each group."""
    groups = [one for draw in every for one in draw["groups"]]
    rows = []
    for name in dict.fromkeys(one["name"] for one in groups):
        for factor in (1.0, *FACTORS, None):
            mine = [one for one in groups if one["name"] == name and factor in (None, one["planted"])]
            if mine:
                rows.append([name, f"{factor:g}" if factor else "all", str(len(mine)), *figures(mine)])
    return [*rows, ["all groups", "all", str(len(groups)), *figures(groups)]]


def figures(mine: list[Draw]) -> list[str]:
    """z, spread, stated sigma and degrees of those that were judged; how many were not."""
    judged = [one for one in mine if "z" in one]
    n, end = len(judged), str(len(mine) - len(judged))
    if n < 2:
        return ["-"] * 6 + [end]
    z, logs, sigmas, degrees = (np.array([one[key] for one in judged]) for key in ("z", "ln", "sigma", "degrees"))
    low, high = np.sqrt(chi_square_band(n))
    beyond, allowed = int(np.count_nonzero(np.abs(z) > Z99)), int(binom.ppf(0.99, n, 0.01))
    return [
        f"{z.mean():.2f} (+-{Z99 / np.sqrt(n):.2f})", f"{rms(z):.2f} ({low:.2f}-{high:.2f})", f"{beyond} ({allowed})",
        f"{logs.std(ddof=1):.3f}", f"{rms(sigmas):.3f}", f"{np.median(degrees):.0f}", end,
    ]  # fmt: skip


def right_lines(every: list[Draw]) -> list[str]:
    """Tests and components of draws from the stated sigmas."""
    draws, degrees = len(every), every[0]["degrees"]
    low, high = binom.ppf([0.005, 0.995], draws, ALPHA).astype(int)
    p, rows = np.array([draw["p"] for draw in every]), []
    for g, one in enumerate(every[0]["groups"]):
        z = np.array([draw["groups"][g]["z"] for draw in every if "z" in draw["groups"][g]])
        judged = [f"{z.mean():.2f}", f"{rms(z):.2f}"] if z.size else ["-", "-"]
        failed = f"{100 * np.mean(p[:, g] < 0.05):.0f}%" if np.all(np.isfinite(p[:, g])) else "-"
        rows.append([one["name"], str(one["rows"]), f"{one['redundancy']:.1f}", *judged, failed])
    return [
        f"{draws} draws. Chi-square test: p-values uniform with p = "
        f"{kstest([draw['larger'] for draw in every], 'uniform').pvalue:.2g} (Kolmogorov & Smirnov), false alarms at "
        f"{100 * ALPHA:g}%: {sum(not draw['passed'] for draw in every)} ({low} to {high} allowed, 99%).",
        f"Squares over degrees of freedom: mean {np.mean([draw['squares'] for draw in every]):.4f} "
        f"(1 +- {Z99 * np.sqrt(2.0 / degrees / draws):.4f}, 99%). Helmert's matrix: rows add up to the redundancies "
        f"within {max(draw['off'] for draw in every):.1e}.", "",
        *table(("group", "rows", "redundancy", "z mean", "z rms", "p < 0.05"), rows),
    ]  # fmt: skip


def judge(every: list[Draw]) -> Blocks:
    """Both tables, of the cases that are there."""
    wrong, right, blocks = cases(every, "planted"), cases(every, "right"), dict[str, list[str]]()
    if wrong:
        rest = sum(not draw["converged"] for draw in wrong)
        end = f"Not converged after all passes: {rest} of {len(wrong)} draws."
        blocks["planted"] = [*table(("group", *WIDTHS), planted_rows(wrong)), "", end]
    return blocks | ({"right": right_lines(right)} if right else {})


if __name__ == "__main__":
    sys.exit(run(seeds_of(__doc__, ("planted", "right"), 90, "evidence_errors.md#components"), one_draw, judge))
