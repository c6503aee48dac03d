"""Is the posterior right? Coverage of its ellipsoids, NEES and bias over many seeds of the three sites and a block.

Every seed draws a truth, an orientation and all measures from the sigmas that the adjustment assumes, adjusts, and
holds what the posterior says of points, poses, pairs, projections and new places against the truth. Writes
montecarlo.md and montecarlo.png, into docs/ by default; 200 seeds of everything take some twelve
minutes of one processor (NUMBA_NUM_THREADS=1).

    python scripts/montecarlo.py [--case three-sites|block|both] [--seeds 200] [--first 0]
                                 [--processes 2 | --cluster PLACE] [--out docs] [--keep FILE]

With --keep every seed that is done is noted in FILE, and not done again. Workers of a cluster that runs elsewhere need
this folder on their PYTHONPATH. Exit status: 0 done (whatever the figures are: the page tells), 2 bad input.
"""

import json
import sys
import time
from argparse import Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

import numpy as np
from montecarlo_draw import BLOCK, CASES, EDGE, KINDS, LINES, NEW, PIXELS, POINTS, Drawn, Order, one_seed
from montecarlo_page import figure, page
from study import DOCS, REMEDY, OneLine, at_least, require_writable, show, status, write_figure, write_text

from mgsgraph.adjustment.adjust import versions
from mgsgraph.adjustment.cluster.connection import Lost, open_cluster
from mgsgraph.errors import InputError, SolverError

CHOICES = {
    "three-sites": tuple(name for name, case in CASES.items() if case.ground is not None),
    "block": tuple(name for name, case in CASES.items() if case.ground is None),
    "both": tuple(CASES),
}


def work(orders: Sequence[Order], place: str | None) -> Iterator[Drawn]:
    """Do orders here, or at the workers of a cluster; as they come."""
    if place is None:
        yield from map(one_seed, orders)
        return
    with open_cluster(place, most=len(orders)) as cluster:
        for number, result in cluster.each(one_seed, orders):
            if isinstance(result, Lost):
                raise SolverError(f"{orders[number].case}, seed {orders[number].seed}: {result.message}")
            yield result


def gathered(orders: Sequence[Order], place: str | None, keep: Path | None) -> list[Drawn]:
    """All orders done, those of an earlier run that kept them included; in the orders' order."""
    with kept(keep) as (before, note):
        done = {order: before[order] for order in orders if order in before}
        due = [order for order in orders if order not in done]
        began = time.perf_counter()
        for over, drawn in enumerate(work(due, place) if due else (), start=1):
            done[drawn.order] = drawn
            if note:
                note.write(as_line(drawn) + "\n")
                note.flush()
            left = (time.perf_counter() - began) / over * (len(due) - over)
            bar = "#" * (20 * over // len(due))
            show(f"[{bar:20}] {over} of {len(due)}, {left:.0f} s left: {drawn.order.case}")
        show("")
    return [done[order] for order in orders]


@contextmanager
def kept(path: Path | None) -> Iterator[tuple[dict[Order, Drawn], TextIO | None]]:
    """What is noted in a file, and the file to note more."""
    if path is None:
        yield {}, None
        return
    try:
        with path.open("a+", encoding="utf-8") as file:
            file.seek(0)
            lines = file.read().split("\n")
            file.truncate(len("\n".join([*lines[:-1], ""]).encode()))  # a crash may have cut the last one short
            found = [from_line(line, f"{path}, line {number}") for number, line in enumerate(lines[:-1], start=1)]
            yield {drawn.order: drawn for drawn in found if drawn is not None}, file
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(str(path), f"can't be read and written ({error})", remedy=REMEDY) from None


def recipe(case: str) -> str:
    """What a kept seed depends on; of another recipe it is done again."""
    return repr((CASES.get(case), BLOCK, POINTS, LINES, PIXELS, NEW, EDGE, sorted(versions().items())))


def as_line(drawn: Drawn) -> str:
    """One line of JSON."""
    order, rounded = drawn.order, {
        name: {kind: np.round(values, 5).tolist() for kind, values in parts.items()}
        for name, parts in (("squares", drawn.squares), ("errors", drawn.errors))
    }
    known = {"case": order.case, "seed": order.seed, "recipe": recipe(order.case), "converged": drawn.converged}
    return json.dumps(known | rounded)


def from_line(line: str, where: str) -> Drawn | None:
    """The same back; None for one of another recipe."""
    try:
        known = json.loads(line)
        if known["recipe"] != recipe(known["case"]):
            return None
        squares, errors = ({kind: np.array(known[name][kind]) for kind in KINDS} for name in ("squares", "errors"))
        return Drawn(Order(known["case"], known["seed"]), known["converged"], squares, errors)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(where, f"not a kept seed ({error})", "what --keep has written", "take it out") from None


def run(arguments: Sequence[str] | None = None) -> int:
    """The command."""
    parser = OneLine(prog="montecarlo.py", description="Coverage, NEES and bias of the posterior over many seeds.")
    parser.add_argument("--case", choices=tuple(CHOICES), default="both")
    parser.add_argument("--seeds", type=at_least(2), default=200, help="number of seeds of each case")
    parser.add_argument("--first", type=at_least(0), default=0, help="first of them")
    workers = parser.add_mutually_exclusive_group()
    workers.add_argument("--processes", type=at_least(1), help="worker processes on this machine")
    workers.add_argument("--cluster", metavar="PLACE", help="local, local:N, tcp://host:port or tls://host:port")
    parser.add_argument("--out", type=Path, default=DOCS, help="folder of montecarlo.md and montecarlo.png")
    parser.add_argument("--keep", type=Path, metavar="FILE", help="note seeds here, and go on where it ended")
    wanted = parser.parse_args(arguments)
    return status(parser.prog, lambda: prove(wanted))


def prove(wanted: Namespace) -> None:
    """Draw, judge, write."""
    table, picture = wanted.out / "montecarlo.md", wanted.out / "montecarlo.png"
    require_writable(table, picture, wanted.keep)
    place = f"local:{wanted.processes}" if wanted.processes and wanted.processes > 1 else wanted.cluster
    seeds = range(wanted.first, wanted.first + wanted.seeds)
    orders = [Order(case, seed) for case in CHOICES[wanted.case] for seed in seeds]
    drawn = gathered(orders, place, wanted.keep)
    by_case = {case: [one for one in drawn if one.order.case == case] for case in CHOICES[wanted.case]}
    write_figure(figure(by_case), picture)
    write_text(page(by_case), table)
    print(f"Written to {table} and {picture}")


if __name__ == "__main__":
    sys.exit(run())
