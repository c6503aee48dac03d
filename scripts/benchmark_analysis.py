"""What does it cost to ask an adjustment?

Adjusts one of the peer's problems (or the Kaguya-sized block) and times, in one process and in turn: an adjustment,
linearising it at its solution, the reliability table, its sorting and its file, variance components, and single
queries of the posterior. The first turn, which also loads the compiled kernel, isn't counted.
"""

import statistics
import tempfile
import time
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
from peer_blocks import SHARED, SIZES, made
from peer_problem import network
from study import DOCS, OneLine, at_least, machine, made_with, show, table, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.components import components_of
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.posterior import Pixel, Posterior
from mgsgraph.analysis.reliability import reliability, suspects
from mgsgraph.network import Network
from mgsgraph.results.analysis import reliability_table

PAGE = "analysis_cost.md"
WORDS = """# What it costs to ask

Made by `scripts/benchmark.py analysis`, all in one process and in turn: medians. The machine was shared; compare
ratios, not seconds.

* *iteration*: the solve of the same network, over its number of iterations; *over an iteration*: times of the same
  turn, their ratios' median, with the least and the most in brackets.
* *linearised*: laying the network out at its solution, from which all questions start.
* *reliability table*: redundancy number, test, detectable blunder and effect of every scalar measure; *sorted*: all of
  them by their tests; *suspects*: the twenty worst groups; *file*: `reliability.csv`.
* *query*: mean of {queries} different ones, after the first.
"""
ITERATION = "iteration"
QUERIES = ("point", "pose", "pair of points", "projection", "intersection")
_Found = TypeVar("_Found")
Seconds = dict[str, list[float]]


class Asked:
    """A network that is adjusted and asked; a turn is all of it once."""

    def __init__(self, network: Network, settings: SolverSettings, queries: int, folder: Path) -> None:
        self._network, self._settings, self._queries = network, settings, queries
        self._file = folder / "reliability.csv"
        self.measures = 0
        self.iterations = 0
        self.seconds: Seconds = {}

    def turn(self) -> None:
        """Time all once more."""
        solution = adjust_network(self._network, self._settings)
        self.iterations = solution.iterations
        self._book(ITERATION, solution.seconds["solve"] / solution.iterations)
        at = self._time("linearised", lambda: at_solution(solution))
        found = self._time("reliability table", lambda: reliability(at))
        self.measures = len(found)
        self._time("sorted", lambda: found.order(len(found)))
        both = self.seconds["reliability table"][-1] + self.seconds["sorted"][-1]
        self._book("table and sorting", both)
        self._time("suspects", lambda: suspects(found))
        self._time("file", lambda: reliability_table(found).write_csv(self._file))
        self._time("variance components", lambda: components_of(at))
        for name, query in zip(QUERIES, self._single(Posterior(at)), strict=True):
            query(0)  # what it keeps for the next ones
            begin = time.perf_counter()
            for k in range(1, self._queries + 1):
                query(k)
            self._book(name, (time.perf_counter() - begin) / self._queries)

    def _single(self, posterior: Posterior) -> tuple[Callable[[int], object], ...]:
        """The `QUERIES` by number; each is of other points and images."""
        network, rays = self._network, self._network.rays
        ids, images = network.points.ids, network.images
        # spread over the rays: points that were measured, and images that see them
        chosen = np.linspace(0, rays.point.size - 1, self._queries + 2).astype(np.int64)
        names, others = [ids[i] for i in rays.point[chosen]], [images[j] for j in rays.image[chosen]]
        pixels = [[_pixel(network, k) for k in np.flatnonzero(rays.point == i).tolist()] for i in rays.point[chosen]]
        return (
            lambda k: posterior.point(names[k]),
            lambda k: posterior.pose(others[k].name, 0.5 * others[k].lines),
            lambda k: posterior.difference(names[k], names[k + 1]),
            lambda k: posterior.projection(names[k], others[k].name),
            lambda k: posterior.intersection(pixels[k]),
        )

    def _time(self, name: str, job: Callable[[], _Found]) -> _Found:
        begin = time.perf_counter()
        found = job()
        self._book(name, time.perf_counter() - begin)
        return found

    def _book(self, name: str, seconds: float) -> None:
        self.seconds.setdefault(name, []).append(seconds)


def _pixel(network: Network, ray: int) -> Pixel:
    """A ray as a new measure."""
    rays = network.rays
    line, sample = rays.places[ray].tolist()
    return Pixel(network.images[rays.image[ray]].name, line, sample, float(rays.sigmas[ray].max()))


def page(title: str, seconds: Seconds, queries: int) -> str:
    """The page: `seconds` by turn of each name, an iteration's among them."""
    rows = [[name, f"{statistics.median(times):.3f}", ratio(times, seconds[ITERATION])]
            for name, times in seconds.items() if name not in QUERIES]  # fmt: skip
    single = [[name, f"{1e3 * statistics.median(seconds[name]):.2f}"] for name in QUERIES]
    return "\n".join([
        WORDS.format(queries=queries), f"{title}\n",
        *table(["what", "seconds", "over an iteration"], rows), "",
        *table(["query", "milliseconds"], single), "", made_with(), "",
    ])  # fmt: skip


def ratio(times: list[float], iteration: list[float]) -> str:
    """Median ratio of times to those of the same turn, least and most."""
    found = sorted(one / other for one, other in zip(times, iteration, strict=True))
    return f"{statistics.median(found):.2f} ({found[0]:.2f} .. {found[-1]:.2f})"


def whole_page(chosen: Namespace) -> str:
    """All turns, and their page."""
    problem, _ = made(chosen.size, chosen.shared)
    with tempfile.TemporaryDirectory() as folder:
        asked = Asked(*network(problem, "predicted"), chosen.queries, Path(folder))
        for turn in range(chosen.repeat + 1):
            show(f"turn {turn} of {chosen.repeat}")
            if turn == 1:
                asked.seconds.clear()
            asked.turn()
    title = (
        f"Size {chosen.size}: {problem.orientation.shape[0]} images, {problem.places.shape[0]:,} points, "
        f"{asked.measures:,} scalar measures, {asked.iterations} iterations; {chosen.repeat} turns. {machine()}."
    )
    return page(title, asked.seconds, chosen.queries)


def main(parser: OneLine, given: list[str]) -> int:
    """`benchmark.py analysis`."""
    parser.add_argument("size", nargs="?", choices=SIZES, default="L")
    parser.add_argument("--repeat", type=at_least(1), default=5, help="turns")
    parser.add_argument("--queries", type=at_least(1), default=20, help="single queries of each kind in a turn")
    parser.add_argument("--shared", type=Path, default=SHARED, help="folder of the peer's generator")
    parser.add_argument("--out", type=Path, default=DOCS, help="folder of the page")
    chosen = parser.parse_args(given)
    return write_page(parser, chosen.out / PAGE, lambda: whole_page(chosen))
