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
    simulated = simulate_strip(STRIP)
    known_images = {image.name: KnownImage(image, NOISE.prior) for image in simulated.images}
    network = build_network(known_images, [simulated.ties, *simulated.lasers], NOISE.tie, NOISE.shot_image)
    assert network is not None
    return network


def planted_factors(seed: int, groups: int) -> np.ndarray:
    """(g,) each group has each factor in every third draw, in varying combinations; of the last two, position and
    pointing, one in turn has the factor 1.
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
        result = iterated_components(scaled(draw, grouping, 1.0 / truth), settings)
        return {"converged": result.converged, "groups": of_groups(result.components, truth)}
    solution = adjust_network(redraw(network, np.random.default_rng([2, seed])).network, settings)
    at, fit = at_solution(solution), solution.fit
    larger = float(chi2.sf(fit.squares, fit.degrees_of_freedom))
    result = components(at, grouping)
    sums = result.helmert.sum(axis=1) - [group.redundancy for group in result.groups]
    return {
        "groups": of_groups(result, np.ones(len(grouping.names))), "off": float(np.abs(sums).max()),
        "passed": bool(min(larger, 1.0 - larger) >= 0.5 * ALPHA), "larger": larger,
        "squares": float(fit.squares / fit.degrees_of_freedom), "degrees": int(fit.degrees_of_freedom),
        "p": [float(test.p_value) for test in residual_statistics(at, grouping)],
    }  # fmt: skip


def of_groups(estimated: Components, truth: np.ndarray) -> list[Draw]:
    """Of each group the planted factor, and where it was judged the factor's deviation from it (standard normal), ln of
    their ratio, its stated relative sigma and its degrees of freedom.
    """
    groups = []
    for factor, group in zip(truth.tolist(), estimated.groups, strict=True):
        record: Draw = {"name": group.name, "planted": factor, "rows": int(group.rows),
                        "redundancy": float(group.redundancy)}  # fmt: skip
        if group.judgement is Judgement.JUDGED:
            record |= {
                "z": float(group.deviation(factor)), "ln": float(np.log(group.factor / factor)),
                "sigma": float(group.sigma / group.factor), "degrees": float(group.degrees),
            }  # fmt: skip
        groups.append(record)
    return groups


def planted_rows(draws: list[Draw]) -> list[list[str]]:
    """A row for each group and factor, and one for each group."""
    groups = [group for draw in draws for group in draw["groups"]]
    rows = []
    for name in dict.fromkeys(group["name"] for group in groups):
        for factor in (1.0, *FACTORS, None):
            chosen = [group for group in groups if group["name"] == name and factor in (None, group["planted"])]
            if chosen:
                rows.append([name, f"{factor:g}" if factor else "all", str(len(chosen)), *figures(chosen)])
    return [*rows, ["all groups", "all", str(len(groups)), *figures(groups)]]


def figures(groups: list[Draw]) -> list[str]:
    """z, spread, stated sigma and degrees of the judged groups; number of the others."""
    judged = [group for group in groups if "z" in group]
    n, end = len(judged), str(len(groups) - len(judged))
    if n < 2:
        return ["-"] * 6 + [end]
    z, logs, sigmas, degrees = (np.array([group[key] for group in judged]) for key in ("z", "ln", "sigma", "degrees"))
    low, high = np.sqrt(chi_square_band(n))
    beyond, allowed = int(np.count_nonzero(np.abs(z) > Z99)), int(binom.ppf(0.99, n, 0.01))
    return [
        f"{z.mean():.2f} (+-{Z99 / np.sqrt(n):.2f})", f"{rms(z):.2f} ({low:.2f}-{high:.2f})", f"{beyond} ({allowed})",
        f"{logs.std(ddof=1):.3f}", f"{rms(sigmas):.3f}", f"{np.median(degrees):.0f}", end,
    ]  # fmt: skip


def right_lines(right: list[Draw]) -> list[str]:
    """Tests and components of draws from the stated sigmas."""
    draws, degrees = len(right), right[0]["degrees"]
    low, high = binom.ppf([0.005, 0.995], draws, ALPHA).astype(int)
    p, rows = np.array([draw["p"] for draw in right]), []
    for g, group in enumerate(right[0]["groups"]):
        z = np.array([draw["groups"][g]["z"] for draw in right if "z" in draw["groups"][g]])
        judged = [f"{z.mean():.2f}", f"{rms(z):.2f}"] if z.size else ["-", "-"]
        failed = f"{100 * np.mean(p[:, g] < 0.05):.0f}%" if np.all(np.isfinite(p[:, g])) else "-"
        rows.append([group["name"], str(group["rows"]), f"{group['redundancy']:.1f}", *judged, failed])
    return [
        f"{draws} draws. Chi-square test: p-values uniform with p = "
        f"{kstest([draw['larger'] for draw in right], 'uniform').pvalue:.2g} (Kolmogorov & Smirnov), false alarms at "
        f"{100 * ALPHA:g}%: {sum(not draw['passed'] for draw in right)} ({low} to {high} allowed, 99%).",
        f"Squares over degrees of freedom: mean {np.mean([draw['squares'] for draw in right]):.4f} "
        f"(1 +- {Z99 * np.sqrt(2.0 / degrees / draws):.4f}, 99%). Helmert's matrix: rows add up to the redundancies "
        f"within {max(draw['off'] for draw in right):.1e}.", "",
        *table(("group", "rows", "redundancy", "z mean", "z rms", "p < 0.05"), rows),
    ]  # fmt: skip


def judge(draws: list[Draw]) -> Blocks:
    """Tables of the cases that were drawn."""
    wrong, right, blocks = cases(draws, "planted"), cases(draws, "right"), dict[str, list[str]]()
    if wrong:
        rest = sum(not draw["converged"] for draw in wrong)
        end = f"Not converged after all passes: {rest} of {len(wrong)} draws."
        blocks["planted"] = [*table(("group", *WIDTHS), planted_rows(wrong)), "", end]
    return blocks | ({"right": right_lines(right)} if right else {})


if __name__ == "__main__":
    sys.exit(run(seeds_of(__doc__, ("planted", "right"), 90, "evidence_errors.md#components"), one_draw, judge))
