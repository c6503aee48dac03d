"""Several minima of an adjustment with tie points on a terrain model: are its sigmas honest as a mixture?

Each draw is a simulated site, as `scripts/cells.py` has it, adjusted three times: from the nominal orientation alone,
with starts over the terrain model's shift as `adjust` has them, and with 15 more. Shift and ties are held against the
truth.

    python scripts/minima.py [--sites eos,gusev,isidis] [--seeds 200] [--first 1] [--keep FILE] [--page docs/minima.md]

With --keep each draw is noted in FILE as soon as it is done, and not done again. Exit status: 0 done, 2 bad input.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from cells import ALONE, KINDS, drawn_case
from study import (
    Draw,
    at_least,
    cases,
    chi_square_band,
    command,
    draws,
    machine,
    refusals,
    student,
    table,
    within,
    write_page,
)

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.multistart import STARTS
from mgsgraph.errors import InputError
from mgsgraph.simulation.sites import SITE_NAMES

MORE = 15
"""Starts beside these."""
_LOWER = 1e-3
"""Of the cost, from which a minimum counts as lower."""
WAYS = {"one": "one start", "mixture": f"{STARTS} starts, mixture"}
WORDS = """# Several minima

Made by `scripts/minima.py` ({machine}), seeds {first} to {last}, draws as in [](cells.md) (*ties*): tie points on the
B-spline of the model's posts, whose shift has an a-priori sigma of 200 m. *one start*: from the nominal orientation;
*mixture*: with {starts} starts over that shift, the lowest minimum with the mean squares about it over the mixture of
all (`adjust`'s default, [](theory.md)). NEES per degree of freedom, 1 if the sigmas are honest, with 99 % bands in
brackets: *terrain* of the model's shift east, north and up (band: chi-square), *ties* of all tie points (band:
scatter over the draws). *several*: draws in which a second minimum is more than 1 % probable; *lower*: in which
starts find a lower one than the first; *15 more*: in which with {more} more starts there is a lower one still. *s*:
of all else, and of the starts.
"""
READING = """
Starts find several minima where there are few tie points (41 at Isidis): there, and at Gusev, the lowest with the
mixture's mean square is nearer to honest than the first one alone. What is left at Isidis is not of several minima.
In the draws with one minimum alone the shift's NEES is as large; by the likelihood ratio, which no bent valley
misleads, it is less (36 draws, seeds 3001 to 3040: 1.58 by the covariance, 1.36 by the ratio, band 0.69 to 1.37):
part is the valley's shape within one minimum; the rest is not explained (the ground between posts, which
no stated sigma covers, is the candidate). The ties' sigmas are honest.
"""
HEAD = ("site", "by", "draws", "terrain", "ties", "model, m", "ties, m", "several", "lower", "15 more", "s")


def main(arguments: list[str] | None = None) -> int:
    """Exit status."""
    parser = command(__doc__)
    parser.add_argument("--sites", default=",".join(SITE_NAMES), help="with commas between")
    parser.add_argument("--seeds", type=at_least(2), default=200, help="draws of each site")
    parser.add_argument("--first", type=at_least(1), default=1, help="first seed")
    parser.add_argument("--keep", type=Path, metavar="FILE", help="note draws here, and go on where it ended")
    parser.add_argument("--page", type=Path, help="file to write the table to")
    given = parser.parse_args(arguments)
    sites, seeds = given.sites.split(","), range(given.first, given.first + given.seeds)

    def make() -> str:
        every = draws(sites, seeds, one_draw, given.keep)
        words = WORDS.format(machine=machine(), first=seeds[0], last=seeds[-1], starts=STARTS, more=MORE)
        rows = [row(site, way, cases(every, site)) for site in sites for way in WAYS]
        return "\n".join([words, *table(HEAD, rows), "", refusals(every), READING])

    return write_page(parser, given.page, make)


def one_draw(name: str, seed: int) -> Draw:
    """Draw, adjust with one start and with many, judge."""
    try:
        with tempfile.TemporaryDirectory() as folder:
            case, truth, _, _ = drawn_case(name, seed, Path(folder))
    except InputError as error:
        return {"refused": str(error)}
    one, mixture, more = (
        adjust_network(case.network, replace(case.settings, starts=count), case.name)
        for count in (0, STARTS, STARTS + MORE)
    )
    found = mixture.minima
    return {
        "one": truth.judge(one) | {"seconds": sum(one.seconds.values())},
        "mixture": truth.judge(mixture) | {"seconds": mixture.seconds.get("starts", 0.0)},
        "weights": [] if found is None else [minimum.weight for minimum in found.each],
        "several": found is not None and found.several,
        "costs": [solution.cost_final for solution in (one, mixture, more)],
    }  # fmt: skip


def row(site: str, way: str, every: list[Draw]) -> list[str]:
    """Of one site, one start or many."""
    mine = [draw[way] for draw in every]
    cells = []
    for kind in ("terrain", "ties"):
        values = np.array([one["nees"][kind] for one in mine])
        half = student(0.01, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values))
        band = chi_square_band(KINDS[kind] * len(values)) if kind in ALONE else (1.0 - half, 1.0 + half)
        cells.append(within(float(values.mean()), band))
    errors = [f"{np.sqrt(np.mean([one[name] ** 2 for one in mine])):.0f}" for name in ("model", "ties")]
    seconds = f"{np.mean([one['seconds'] for one in mine]):.2f}"
    counts = _counts(every) if way == "mixture" else [""] * 3
    return [site, WAYS[way], str(len(mine)), *cells, *errors, *counts, seconds]


def _counts(every: list[Draw]) -> list[str]:
    """Draws with several minima, with a lower one than the first, and with a lower one by more starts."""
    costs: Any = np.array([draw["costs"] for draw in every])
    return [str(sum(draw["several"] for draw in every)), *(str(int(n)) for n in (-np.diff(costs) > _LOWER).sum(axis=0))]


if __name__ == "__main__":
    sys.exit(main())
