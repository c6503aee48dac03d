"""Many cases: those that are due are adjusted, one after the other here or as tasks on a cluster, each recorded; and
how they ended, in words.
"""

import dataclasses
import math
import os
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

from mgsgraph.adjustment.cluster.connection import Lost, open_cluster
from mgsgraph.adjustment.cluster.workers import parse_cluster
from mgsgraph.analysis.soundness import is_result
from mgsgraph.atomic_write import sweep
from mgsgraph.case.reading import adjust, read_case
from mgsgraph.errors import MgsgraphError
from mgsgraph.files.output.folders import RECORD as RESULT
from mgsgraph.files.output.folders import require_replaceable
from mgsgraph.project.campaign.inputs import checksums, find_cases, result_folders
from mgsgraph.project.campaign.record import AS_WRITTEN, CampaignEntry, Overrides, Record, open_record
from mgsgraph.results.results import write_results
from mgsgraph.results.soundness import soundness_section

Progress = Callable[[int, int, CampaignEntry | None], None]
"""Called with the number of cases that are over, of all that are due, and the one just over (None at first)."""
_WIDTH = 110
"""columns of the table."""
_NAME = 32
"""columns of a case's name at most."""


@dataclass(frozen=True, slots=True)
class CaseTask:
    """A case that is to be adjusted."""

    case: Path
    """Its file, absolute: the same on all machines."""
    name: str
    """Name of the case in the record."""
    out: Path
    """Folder of the campaign's results, absolute."""
    folder: str
    """Name of the folder in it for this case."""
    overrides: Overrides
    """Options that overrule the case file."""
    base: Path
    """Working directory, from which SPICE looks for what a meta-kernel lists."""


def run_case(task: CaseTask) -> CampaignEntry:
    """Do a case; whatever goes wrong is outcome in the entry."""
    if task.base.is_dir():
        os.chdir(task.base)  # that of a worker elsewhere is another
    began, sums = time.perf_counter(), checksums(task.case)
    try:
        outcome = _adjusted(task)
    except MgsgraphError as error:
        outcome = {"message": str(error)}
    except MemoryError:
        outcome = {"message": "out of memory; give the machine more or leave images out"}
    except Exception as error:  # one case must not end the others
        outcome = {"message": f"unforeseen {type(error).__name__}: {error}; `mgsgraph adjust` shows where"}
    return _entry(task, sums, time.perf_counter() - began, outcome)


def _adjusted(task: CaseTask) -> dict[str, Any]:
    """Read, adjust and write; the figures that the record keeps."""
    target = task.out / task.folder
    require_replaceable(target)
    case = read_case(task.case, laser=task.overrides.laser)
    solution = adjust(dataclasses.replace(case, settings=task.overrides.over(case.settings)))
    write_results(solution, target, task.overrides.figures, task.case, case.networks, task.overrides.tables)
    return {
        "status": "not converged" if not solution.converged else "done" if is_result(solution) else "no result",
        "message": " ".join([*soundness_section(solution).sentences, solution.message]),
        "converged": solution.converged,
        "sigma0": solution.sigma0 if math.isfinite(solution.sigma0) else None,
        "cost": solution.cost_final,
        "iterations": solution.iterations,
    }


def failed(task: CaseTask, message: str) -> CampaignEntry:
    """Entry of a case whose worker has not come back."""
    return _entry(task, checksums(task.case), 0.0, {"message": message})


def _entry(task: CaseTask, sums: dict[str, str | None], seconds: float, outcome: dict[str, Any]) -> CampaignEntry:
    missing: dict[str, Any] = {"status": "failed", "converged": False, "sigma0": None, "cost": None, "iterations": None}
    outcome = missing | outcome
    outcome["message"] = " ".join(outcome["message"].split())
    if outcome["status"] == "failed" and (task.out / task.folder).exists():
        outcome["message"] += f" (what is in {task.folder} is from before)"
    return CampaignEntry(
        case=task.name,
        folder=task.folder,
        seconds=round(seconds, 3),
        checksums=sums,
        overrides=task.overrides,
        version=version("mgsgraph"),
        machine=socket.gethostname(),
        finished=datetime.now(UTC).isoformat(timespec="seconds"),
        **outcome,
    )


_Each = Callable[[Callable[[CaseTask], CampaignEntry], Sequence[CaseTask]], Iterator[tuple[int, CampaignEntry | Lost]]]


@dataclass(frozen=True, slots=True)
class Campaign:
    """State of all cases."""

    entries: tuple[CampaignEntry, ...]
    """One for each case, in the order in which they were given."""
    kept: frozenset[str]
    """`CampaignEntry.case` of those that were left as an earlier run had ended them."""

    def count(self, status: str) -> int:
        """Number of cases with a status."""
        return sum(entry.status == status for entry in self.entries)

    @property
    def well(self) -> bool:
        """Whether every case is done."""
        return self.count("done") == len(self.entries)


def run_campaign(
    given: Iterable[Path],
    out: Path,
    overrides: Overrides = AS_WRITTEN,
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
    overrides : Overrides
        What overrules the case files.
    cluster : str, optional
        Where to work (see `mgsgraph.adjustment.cluster.parse_cluster`); in this process when absent.
    retry : bool
        Do cases again that have failed or not converged, too, though nothing has changed.

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
        tasks = _tasks(cases, out.resolve(), record, overrides)
        due = [task for task in tasks if _is_due(task, record.entries.get(task.name), retry)]
        if due:
            try:
                with _workers(cluster, record, due) as each:
                    progress(0, len(due), None)
                    for over, (place, entry) in enumerate(each(run_case, due), start=1):
                        ended = failed(due[place], entry.message) if isinstance(entry, Lost) else entry
                        record.append(ended)
                        progress(over, len(due), ended)
            finally:
                sweep(out)  # what workers that died have left half-written
        entries = tuple(record.entries[task.name] for task in tasks)
        return Campaign(entries, frozenset(task.name for task in tasks) - {task.name for task in due})


def _tasks(cases: tuple[Path, ...], out: Path, record: Record, overrides: Overrides) -> list[CaseTask]:
    taken = {Path(os.path.normpath(out / entry.case)): entry.folder for entry in record.entries.values()}
    folders = result_folders(cases, taken)
    here = Path.cwd()
    return [CaseTask(case, os.path.relpath(case, out), out, folders[case], overrides, here) for case in cases]


def _is_due(task: CaseTask, last: CampaignEntry | None, retry: bool) -> bool:
    """Whether a case has to be done: never done, done otherwise or from other inputs, or its results are gone."""
    if last is None or last.overrides != task.overrides or last.checksums != checksums(task.case):
        return True
    if last.status != "done" and retry:
        return True
    return last.status != "failed" and not (task.out / task.folder / RESULT).is_file()


@contextmanager
def _workers(cluster: str | None, record: Record, due: Sequence[CaseTask]) -> Iterator[_Each]:
    """How tasks are worked off: in this process, or on a cluster whose workers see the same files."""
    if cluster is None:
        yield _one_by_one
        return
    with open_cluster(cluster, most=len(due)) as connection:
        for path in (record.path, due[0].case):
            connection.require_visible_file(path)
        yield connection.each


def _one_by_one(
    function: Callable[[CaseTask], CampaignEntry], tasks: Sequence[CaseTask]
) -> Iterator[tuple[int, CampaignEntry | Lost]]:
    for place, task in enumerate(tasks):
        yield place, function(task)


def summary(campaign: Campaign) -> str:
    """Counts, and a table of the cases that failed or did not converge; several lines."""
    total, kept = len(campaign.entries), len(campaign.kept)
    states = "done", "no result", "not converged", "failed"
    counts = ", ".join(f"{number} {status}" for status in states if (number := campaign.count(status)))
    earlier = f" ({kept} of them earlier, and nothing has changed since)" if kept else ""
    lines = [f"{total} case{'' if total == 1 else 's'}: {counts}{earlier}", *_other_versions(campaign)]
    troubled = [entry for entry in campaign.entries if entry.status != "done"]
    if troubled:
        width = min(max(len(entry.folder) for entry in troubled), _NAME)
        lines += ["", f"{'Case':<{width}}  {'state':<13}  why"]
        for entry in troubled:
            lines += _row(entry, width)
    return "\n".join(lines)


def line(entry: CampaignEntry) -> str:
    """One case that is over, in one line."""
    if entry.status == "failed":
        return f"{entry.folder}: failed after {entry.seconds:.1f} s: {entry.message}"
    sigma0 = "not defined" if entry.sigma0 is None else f"{entry.sigma0:.4g}"
    return f"{entry.folder}: {entry.status}, {entry.iterations} iterations, sigma0 {sigma0}, {entry.seconds:.1f} s"


def _row(entry: CampaignEntry, width: int) -> list[str]:
    name = entry.folder if len(entry.folder) <= width else f"{entry.folder[: width - 3]}..."
    head = f"{name:<{width}}  {entry.status:<13}  "
    return textwrap.wrap(entry.message, _WIDTH, initial_indent=head, subsequent_indent=" " * len(head))


def _other_versions(campaign: Campaign) -> list[str]:
    """A line where results that were left are another version's."""
    kept = Counter(entry.version for entry in campaign.entries if entry.case in campaign.kept)
    now = {entry.version for entry in campaign.entries if entry.case not in campaign.kept}
    others = [f"{number} by mgsgraph {version}" for version, number in sorted(kept.items()) if version not in now]
    return [f"Of the earlier ones, {', '.join(others)}."] if now and others else []
