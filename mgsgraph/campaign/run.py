"""Many cases: those that are due are done, one after the other here or as tasks on a cluster, each recorded."""

import os
import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mgsgraph.adjustment.cluster import Lost, open_cluster, parse_cluster
from mgsgraph.campaign.cases import find_cases, result_folders
from mgsgraph.campaign.entry import AS_WRITTEN, Entry, Wishes
from mgsgraph.campaign.inputs import checksums
from mgsgraph.campaign.record import Record, open_record
from mgsgraph.campaign.task import Order, failed, run_case
from mgsgraph.output.folders import RECORD as RESULT

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
            connection.require_visible_file(path)
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
