"""Many cases: those that are due are adjusted, one after the other here or as tasks on a cluster, each recorded; and
how they ended, in words.
"""

import dataclasses
import math
import os
import re
import shutil
import socket
import textwrap
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from mgsgraph.adjustment.cluster import Lost, open_cluster, parse_cluster
from mgsgraph.campaign.inputs import checksums, find_cases, result_folders
from mgsgraph.campaign.record import AS_WRITTEN, Entry, Record, Wishes, open_record
from mgsgraph.case.reading import adjust, read_case
from mgsgraph.errors import MgsgraphError
from mgsgraph.output.folders import RECORD as RESULT
from mgsgraph.output.folders import require_replaceable
from mgsgraph.reports.results import write_results


@dataclass(frozen=True, slots=True)
class Order:
    """A case to be done."""

    case: Path
    """Its file, absolute: the same on all machines."""
    name: str
    """What the record calls it."""
    out: Path
    """Folder of the campaign's results, absolute."""
    folder: str
    """Name of the folder in it for this case."""
    wishes: Wishes
    """What overrules the case file."""
    base: Path
    """Working directory, from which SPICE looks for what a meta-kernel lists."""


def run_case(order: Order) -> Entry:
    """Do a case; whatever goes wrong is told in the entry."""
    if order.base.is_dir():
        os.chdir(order.base)  # that of a worker elsewhere is another
    began, sums = time.perf_counter(), checksums(order.case)
    try:
        told = _adjusted(order)
    except MgsgraphError as error:
        told = {"message": str(error)}
    except MemoryError:
        told = {"message": "out of memory; give the machine more or leave images out"}
    except Exception as error:  # one case must not end the others
        told = {"message": f"unforeseen {type(error).__name__}: {error}; `mgsgraph adjust` shows where"}
    return _entry(order, sums, time.perf_counter() - began, told)


def _adjusted(order: Order) -> dict[str, Any]:
    """Read, adjust and write; the figures that the record keeps."""
    target = order.out / order.folder
    require_replaceable(target)
    case = read_case(order.case, laser=order.wishes.laser)
    solution = adjust(dataclasses.replace(case, settings=order.wishes.over(case.settings)))
    write_results(solution, target, figures=order.wishes.figures)
    return {
        "status": "done" if solution.converged else "not converged",
        "message": solution.message,
        "converged": solution.converged,
        "sigma0": solution.sigma0 if math.isfinite(solution.sigma0) else None,
        "cost": solution.cost_final,
        "iterations": solution.iterations,
    }


def failed(order: Order, message: str) -> Entry:
    """Entry of a case whose worker has not come back."""
    return _entry(order, checksums(order.case), 0.0, {"message": message})


def _entry(order: Order, sums: dict[str, str | None], seconds: float, told: dict[str, Any]) -> Entry:
    missing: dict[str, Any] = {"status": "failed", "converged": False, "sigma0": None, "cost": None, "iterations": None}
    told = missing | told
    told["message"] = " ".join(told["message"].split())
    if told["status"] == "failed" and (order.out / order.folder).exists():
        told["message"] += f" (what is in {order.folder} is from before)"
    return Entry(
        case=order.name,
        folder=order.folder,
        seconds=round(seconds, 3),
        checksums=sums,
        wishes=order.wishes,
        version=version("mgsgraph"),
        machine=socket.gethostname(),
        finished=datetime.now(UTC).isoformat(timespec="seconds"),
        **told,
    )


Progress = Callable[[int, int, Entry | None], None]
"""Called with the number of cases that are over, of all that are due, and the one just over (None at first)."""
_Each = Callable[[Callable[[Order], Entry], Sequence[Order]], Iterator[tuple[int, Entry | Lost]]]


@dataclass(frozen=True, slots=True)
class Campaign:
    """How all cases stand."""

    entries: tuple[Entry, ...]
    """One for each case, in the order in which they were given."""
    kept: frozenset[str]
    """`Entry.case` of those that were left as an earlier run had ended them."""

    def count(self, status: str) -> int:
        """How many cases ended so."""
        return sum(entry.status == status for entry in self.entries)

    @property
    def well(self) -> bool:
        """Whether every case is done."""
        return self.count("done") == len(self.entries)


def run_campaign(
    given: Iterable[Path],
    out: Path,
    wishes: Wishes = AS_WRITTEN,
    cluster: str | None = None,
    retry: bool = False,
    progress: Progress = lambda over, due, entry: None,
) -> Campaign:
    """Adjust many cases, each into a folder of its own in `out`; what an earlier run has done, and what has not changed
    since, is left.

    Parameters
    ----------
    given : iterable of Path
        Case files and folders of them.
    out : Path
        Folder of the results and of the record; absent, empty or an earlier campaign's.
    wishes : Wishes
        What overrules the case files.
    cluster : str, optional
        Where to work (see `mgsgraph.adjustment.cluster.parse_cluster`); in this process when absent.
    retry : bool
        Do cases again that have failed or not converged, too, though nothing has changed.
    progress : callable

    Raises
    ------
    InputError
        No cases, a folder that is something else's, or a cluster that can't be used; not what is wrong with a case.
    SolverError
        The cluster has gone; what was over is recorded.
    """
    cases = find_cases(given, out)
    if cluster is not None:
        parse_cluster(cluster)
    with open_record(out) as record:
        orders = _orders(cases, out.resolve(), record, wishes)
        due = [order for order in orders if _is_due(order, record.entries.get(order.name), retry)]
        if due:
            try:
                with _hands(cluster, record, due) as each:
                    progress(0, len(due), None)
                    for over, (place, entry) in enumerate(each(run_case, due), start=1):
                        ended = failed(due[place], entry.message) if isinstance(entry, Lost) else entry
                        record.append(ended)
                        progress(over, len(due), ended)
            finally:
                _sweep(out, due)
        entries = tuple(record.entries[order.name] for order in orders)
        return Campaign(entries, frozenset(order.name for order in orders) - {order.name for order in due})


def _orders(cases: tuple[Path, ...], out: Path, record: Record, wishes: Wishes) -> list[Order]:
    taken = {Path(os.path.normpath(out / entry.case)): entry.folder for entry in record.entries.values()}
    folders = result_folders(cases, taken)
    here = Path.cwd()
    return [Order(case, os.path.relpath(case, out), out, folders[case], wishes, here) for case in cases]


def _is_due(order: Order, last: Entry | None, retry: bool) -> bool:
    """Whether a case has to be done: never done, done otherwise or from other inputs, or its results are gone."""
    if last is None or last.wishes != order.wishes or last.checksums != checksums(order.case):
        return True
    if last.status != "done" and retry:
        return True
    return last.status != "failed" and not (order.out / order.folder / RESULT).is_file()


@contextmanager
def _hands(cluster: str | None, record: Record, due: Sequence[Order]) -> Iterator[_Each]:
    """Who does the work: this process, or a cluster whose workers see the same files."""
    if cluster is None:
        yield _one_by_one
        return
    with open_cluster(cluster, most=len(due)) as connection:
        for path in (record.path, due[0].case):
            connection.require_sight(path)
        yield connection.each


def _one_by_one(function: Callable[[Order], Entry], orders: Sequence[Order]) -> Iterator[tuple[int, Entry | Lost]]:
    for place, order in enumerate(orders):
        yield place, function(order)


def _sweep(out: Path, orders: Sequence[Order]) -> None:
    """Take away what workers that died have left half-written."""
    names = {order.folder for order in orders}
    for path in out.iterdir():
        match = re.fullmatch(r"\.(.+)\.[0-9a-f]{8}\.unfinished", path.name)
        if match and match[1] in names:
            shutil.rmtree(path, ignore_errors=True)


_WIDTH = 110
"""columns of the table."""
_NAME = 32
"""columns of a case's name at most."""


def summary(campaign: Campaign) -> str:
    """Counts, and a table of the cases that failed or did not converge; several lines."""
    total, kept = len(campaign.entries), len(campaign.kept)
    counts = ", ".join(
        f"{number} {status}" for status in ("done", "not converged", "failed") if (number := campaign.count(status))
    )
    earlier = f" ({kept} of them earlier, and nothing has changed since)" if kept else ""
    lines = [f"{total} case{'' if total == 1 else 's'}: {counts}{earlier}", *_other_versions(campaign)]
    troubled = [entry for entry in campaign.entries if entry.status != "done"]
    if troubled:
        width = min(max(len(entry.folder) for entry in troubled), _NAME)
        lines += ["", f"{'Case':<{width}}  {'state':<13}  why"]
        for entry in troubled:
            lines += _row(entry, width)
    return "\n".join(lines)


def line(entry: Entry) -> str:
    """One case that is over, in one line."""
    if entry.status == "failed":
        return f"{entry.folder}: failed after {entry.seconds:.1f} s: {entry.message}"
    sigma0 = "not defined" if entry.sigma0 is None else f"{entry.sigma0:.4g}"
    return f"{entry.folder}: {entry.status}, {entry.iterations} iterations, sigma0 {sigma0}, {entry.seconds:.1f} s"


def _row(entry: Entry, width: int) -> list[str]:
    name = entry.folder if len(entry.folder) <= width else f"{entry.folder[: width - 3]}..."
    head = f"{name:<{width}}  {entry.status:<13}  "
    return textwrap.wrap(entry.message, _WIDTH, initial_indent=head, subsequent_indent=" " * len(head))


def _other_versions(campaign: Campaign) -> list[str]:
    """A line where results that were left are another version's."""
    kept = Counter(entry.version for entry in campaign.entries if entry.case in campaign.kept)
    now = {entry.version for entry in campaign.entries if entry.case not in campaign.kept}
    others = [f"{number} by mgsgraph {version}" for version, number in sorted(kept.items()) if version not in now]
    return [f"Of the earlier ones, {', '.join(others)}."] if now and others else []
