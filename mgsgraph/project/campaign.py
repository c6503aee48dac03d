"""A campaign: many independent cases. Those that are due (whose files have changed, by their checksums) are adjusted,
one after the other here or as tasks on a cluster, each into a folder of its own and recorded; and how they ended.

The record is JSON Lines, one for each case that is over, appended whole and never changed. A case that is done again
gets another line; its last one counts. A line that a crash or a full disk has cut short is taken off. Each ends with
its checksum. One campaign at a time may write.
"""

import dataclasses
import json
import math
import os
import re
import socket
import stat
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, Self, get_args

import msgspec

from mgsgraph.adjustment.cluster.connection import Lost, open_cluster
from mgsgraph.adjustment.cluster.workers import parse_cluster
from mgsgraph.analysis.verdict import is_valid, verdict
from mgsgraph.atomic_write import resolved, sweep
from mgsgraph.case.case_file import decode
from mgsgraph.case.reading import adjust, read_case
from mgsgraph.case.terrain import count_files
from mgsgraph.errors import InputError, MgsgraphError, is_interrupt, require
from mgsgraph.files.opening import sha256_of
from mgsgraph.files.output.folders import MATCH, PROJECT, require_replaceable
from mgsgraph.files.output.folders import RECORD as RESULT
from mgsgraph.files.writing import claim, writing_to
from mgsgraph.project.changes import solve_case
from mgsgraph.results.results import AS_WRITTEN, Overrides, write_results
from mgsgraph.results.verdict import reason_sentences
from mgsgraph.text import many
from mgsgraph.workers import no_progress, read_apart

Status = Literal["done", "no result", "not converged", "failed"]
RECORD = "campaign.jsonl"
"""Name of the file in the folder of the results."""
FORMAT = 2
"""Version of the layout."""
_HEAD = json.dumps({"program": "mgsgraph", "record": "campaign", "format": FORMAT}).encode()
_SIGNED = re.compile(rb'(.*),"crc32":"([0-9a-f]{8})"\}', re.DOTALL)
"""A line, and the CRC-32 of what stands before it."""
_ELSEWHERE, _MEND = "choose another --out", "take it away"
_writing = partial(writing_to, remedy="choose another --out, where you may write")


class CampaignEntry(msgspec.Struct, frozen=True):
    """How one case ended."""

    case: str
    """Path of the case file, relative to the record's folder."""
    folder: str
    """Name of the folder with its results."""
    status: Status
    """no result: it converged to what is invalid (`analysis.verdict`); not converged: results are written in
    both; failed: there are none of this run."""
    message: str
    """Reason why the adjustment ended."""
    seconds: float
    """s, wall time on the worker."""
    converged: bool
    sigma0: float | None
    """A-posteriori standard deviation of unit weight; None where there is none."""
    cost: float | None
    """Half the weighted sum of squares at the end."""
    iterations: int | None
    """Number of steps tried."""
    checksums: dict[str, str | None]
    """SHA-256 of the case file and of its inputs, by path as the case writes it."""
    overrides: Overrides = msgspec.field(name="wishes")
    """Options that overruled the case file."""
    version: str
    """Version of this program."""
    machine: str
    """Host name of the worker."""
    finished: str
    """UTC, ISO 8601."""


class Record:
    """An open record; made by `open_record`.

    Attributes
    ----------
    path : Path
    entries : dict of str to CampaignEntry
        The last one of each case, by `CampaignEntry.case`.
    """

    def __init__(self, path: Path, descriptor: int) -> None:
        self.path = path
        self._descriptor = descriptor
        self._new = False
        self.entries: dict[str, CampaignEntry] = {}

    def append(self, entry: CampaignEntry) -> None:
        """Add a line: all of it or nothing, and on the disk before this returns."""
        text = msgspec.json.encode(entry).removesuffix(b"}")
        _append(self._descriptor, text + b',"crc32":"%08x"}\n' % zlib.crc32(text), self.path)
        self.entries[entry.case] = entry

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._descriptor)
        if self._new and not self.entries and os.listdir(self.path.parent) == [self.path.name]:  # nothing came of it
            self.path.unlink()
            self.path.parent.rmdir()


def open_record(folder: Path) -> Record:
    """The record of the campaign in a folder, which is made where there is none.

    Raises
    ------
    InputError
        A folder that holds something else, a record that isn't one or is damaged, one that another campaign is writing,
        or a place where nothing can be written.
    """
    path = folder / RECORD
    with _writing(path):
        _require_ours(folder, path)
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
    record = Record(path, descriptor)
    try:
        with _writing(path):
            is_file = stat.S_ISREG(os.fstat(descriptor).st_mode)
            require(is_file, str(path), "is no file", "the record of a campaign", _ELSEWHERE)
            claim(descriptor, path, "another campaign is writing here")
            text = os.read(descriptor, os.fstat(descriptor).st_size)
            whole = text.rfind(b"\n") + 1
            os.ftruncate(descriptor, whole)
            lines = text[:whole].split(b"\n")[:-1]
            record._new = not lines
            if not lines:
                _append(descriptor, _HEAD + b"\n", path)
            record.entries.update((entry.case, entry) for entry in _entries(lines, path))
    except BaseException:
        os.close(descriptor)
        raise
    return record


def _require_ours(folder: Path, path: Path) -> None:
    is_other = folder.exists() and not folder.is_dir()
    require(not is_other, str(folder), "exists and is a file", "a folder for the results", _ELSEWHERE)
    is_foreign = folder.is_dir() and not path.exists() and any(folder.iterdir())
    found, expected = f"exists, and has no {RECORD}", "an absent or empty folder, or an earlier campaign"
    require(not is_foreign, str(folder), found, expected, _ELSEWHERE)


def _append(descriptor: int, line: bytes, path: Path) -> None:
    size = os.fstat(descriptor).st_size
    full, remedy = "can't be written (the disk is full)", "free some space, and run this again"
    try:
        with _writing(path):
            written = os.write(descriptor, line)
            os.fsync(descriptor)
        require(written == len(line), str(path), full, remedy=remedy)
    except InputError:
        os.ftruncate(descriptor, size)
        raise


def _entries(lines: list[bytes], path: Path) -> list[CampaignEntry]:
    """Entries of the lines of a record after its head."""
    is_ours = not lines or lines[0] == _HEAD
    require(is_ours, f"{path}, line 1", "no head of a campaign's record", _HEAD.decode(), _ELSEWHERE)
    return [_entry(line, f"{path}, line {number}") for number, line in enumerate(lines[1:], start=2)]


def _entry(line: bytes, where: str) -> CampaignEntry:
    signed = _SIGNED.fullmatch(line)
    remedy = "take that line out: its case will be done again"
    if signed is None or zlib.crc32(signed[1]) != int(signed[2], 16):
        raise InputError(where, "a damaged entry (its checksum is another one, or gone)", remedy=remedy)
    try:
        return msgspec.json.decode(line, type=CampaignEntry)
    except (msgspec.MsgspecError, UnicodeError) as error:
        raise InputError(where, f"no entry of a campaign ({error})", remedy=remedy) from None


Progress = Callable[[int, int, CampaignEntry | None], None]
"""Called with the number of cases that are over, of all that are due, and the one just over (None at first)."""
SUFFIX = ".toml"
_PLAIN = "case"
"""Stem of a case file that says nothing; its folder's name is taken instead."""
_BESIDE = {".lbl", ".img", ".imq", ".cub", ".pvl", ".isd", ".json"}
"""Endings of files that belong together: a label, and the pixels, posts or tables that it describes."""


def find_cases(given: Iterable[Path], out: Path) -> tuple[Path, ...]:
    """Case files, resolved and without doubles, in the order in which they were given.

    Parameters
    ----------
    given : iterable of Path
        Case files, and folders of which every ``*.toml`` at any depth is one; what is hidden is left out.
    out : Path
        Folder of the results, which is left out, too: a demonstration's results hold case files of their own.

    Raises
    ------
    InputError
        Something that isn't there, or a folder without case files.
    """
    found: dict[Path, None] = {}
    for path in given:
        if path.is_dir():
            result, hidden = resolved(out, _ELSEWHERE), re.compile(r"(^|/)\.")
            every = (one for one in sorted(path.rglob(f"*{SUFFIX}")) if not hidden.search(str(one.relative_to(path))))
            own = result == path.resolve()
            inside = [one for one in (resolved(one, _MEND) for one in every) if own or result not in one.parents]
            require(inside, str(path), f"no case file (*{SUFFIX}) in this folder", "at least one")
            found.update(dict.fromkeys(inside))
        elif path.exists():
            found[path.resolve()] = None
        else:
            raise InputError(str(path), "no such file or folder", "case files, or folders of them")
    return tuple(found)


def result_folders(cases: Iterable[Path], taken: Mapping[Path, str]) -> dict[Path, str]:
    """Name of the folder of each case's results: the shortest end of its path that no case before it has.

    ``sites/eos.toml`` gives ``eos``, ``sites/eos/case.toml`` as well; of ``a/eos.toml`` and ``b/eos.toml`` the second
    one gives ``b-eos``.

    Parameters
    ----------
    cases : iterable of Path
        Resolved.
    taken : mapping of Path to str
        Names that were given earlier; they stay.
    """
    names, used = dict(taken), {name: case for case, name in taken.items()}
    for case in [case for case in cases if case not in taken]:
        parts = tuple(part for part in case.parent.parts if part != case.anchor)
        parts = parts if case.stem == _PLAIN and parts else (*parts, case.stem)
        ends = ["-".join(parts[-count:]) for count in range(1, len(parts) + 1)]
        name = next((end for end in ends if end not in used), ends[-1])
        found = f"its results would go to {name!r}, like those of {used.get(name)}"
        require(name not in used, str(case), found, "another file name")
        names[case], used[name] = name, case
    return names


def checksums(case: Path) -> dict[str, str | None]:
    """SHA-256 of a case file and of every file that it names, by path as the case writes it: every text in it that is
    one, what lies beside a label, and what a meta-kernel lists. Of a case file that can't be understood there is only
    its own (None where it can't be read).
    """
    sums, folder = {case.name: _checksum(case)}, case.parent
    try:
        wanted = decode(case)
        counts = [name for entry in wanted.terrain_models for name in count_files(entry, folder)]
    except InputError:
        return sums
    kernels = {name for one in (*wanted.images, wanted.spice) for name in (() if one is None else one.kernels)}
    for name in dict.fromkeys([*_texts(msgspec.to_builtins(wanted)), *counts]):
        if (found := _checksum(folder / name)) is not None:
            others = _listed(folder / name) if name in kernels else _described(folder / name)
            sums |= {name: found} | {os.path.relpath(other, folder): _checksum(other) for other in others}
    return sums


def _texts(value: Any) -> Iterator[str]:
    """All texts in tables and lists."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping | list | tuple):
        for one in value.values() if isinstance(value, Mapping) else value:
            yield from _texts(one)


def _described(path: Path) -> list[Path]:
    """Files that are read with a named one: a label and what it describes, and the record of a network's matching."""
    return [
        other
        for other in (sorted(path.parent.iterdir()) if path.parent.is_dir() else ())
        if other.name == MATCH or ({path.suffix.lower(), other.suffix.lower()} <= _BESIDE
        and other.name != path.name and other.stem.lower() == path.stem.lower())
    ]  # fmt: skip


def _listed(kernel: Path) -> list[Path]:
    """Kernels that a meta-kernel lists."""
    from mgsgraph.files.labels.kernels import members  # SPICE takes its time to load

    here, path = Path.cwd(), kernel.absolute()
    with suppress(InputError):  # reading the case will say what is wrong
        found = read_apart(lambda: members(path, here), str(kernel), "a SPICE kernel", "fetch it again")
        return [member for member in found if member != path]
    return []


def _checksum(path: Path) -> str | None:
    with suppress(OSError, InputError):
        state = path.stat()
        return _of_content(path.resolve(), state.st_size, state.st_mtime_ns)
    return None


@cache
def _of_content(path: Path, size: int, changed: int) -> str:
    """SHA-256 of a file; kernels and terrain models that many cases share are read once."""
    return sha256_of(path)


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
    except MemoryError:
        outcome = {"message": "out of memory; give the machine more or leave images out"}
    except Exception as error:  # one case must not end the others
        if is_interrupt(error):
            raise KeyboardInterrupt from error
        unforeseen = f"unforeseen {type(error).__name__}: {error}; `mgsgraph adjust` shows where"
        outcome = {"message": str(error) if isinstance(error, MgsgraphError) else unforeseen}
    return _ended(task, sums, time.perf_counter() - began, outcome)


def _adjusted(task: CaseTask) -> dict[str, Any]:
    """Read, adjust and write; the figures that the record keeps."""
    target, overrides = task.out / task.folder, task.overrides
    if overrides.projects:
        solution = solve_case(task.case, target, overrides.figures, overrides.tables, overrides.device)
    else:
        require_replaceable(target)
        case = read_case(task.case, laser=overrides.laser)
        solution = adjust(dataclasses.replace(case, settings=overrides.over(case.settings)))
        write_results(solution, target, overrides.figures, task.case, case.networks, overrides.tables)
    return {
        "status": "not converged" if not solution.converged else "done" if is_valid(solution) else "no result",
        "message": " ".join([*reason_sentences(verdict(solution).reasons), solution.message]),
        "converged": solution.converged,
        "sigma0": solution.sigma0 if math.isfinite(solution.sigma0) else None,
        "cost": solution.cost_final,
        "iterations": solution.iterations,
    }


def _ended(task: CaseTask, sums: dict[str, str | None], seconds: float, outcome: dict[str, Any]) -> CampaignEntry:
    missing: dict[str, Any] = {"status": "failed", "converged": False, "sigma0": None, "cost": None, "iterations": None}
    outcome = missing | outcome | {"message": " ".join(outcome["message"].split())}
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


def run_campaign(
    given: Iterable[Path],
    out: Path,
    overrides: Overrides = AS_WRITTEN,
    cluster: str | None = None,
    retry: bool = False,
    progress: Progress = no_progress,
    insecure: bool = False,
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
        Where to work (`parse_cluster`), without TLS, too, where `insecure`; in this process when absent.
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
        parse_cluster(cluster, insecure)
    with open_record(out) as record:
        tasks = _tasks(cases, out.resolve(), record, overrides)
        due = [task for task in tasks if _is_due(task, record.entries.get(task.name), retry)]
        if due:
            try:
                with _workers(cluster, insecure, record, due) as each:
                    progress(0, len(due), None)
                    for over, (place, entry) in enumerate(each(run_case, due), start=1):
                        ended, task = entry, due[place]
                        if isinstance(ended, Lost):
                            ended = _ended(task, checksums(task.case), 0.0, {"message": ended.message})
                        record.append(ended)
                        progress(over, len(due), ended)
            finally:
                sweep(out)  # what workers that died have left half-written
        entries = tuple(record.entries[task.name] for task in tasks)
        return Campaign(entries, frozenset(task.name for task in tasks) - {task.name for task in due})


def _tasks(cases: tuple[Path, ...], out: Path, record: Record, overrides: Overrides) -> list[CaseTask]:
    taken = {Path(os.path.normpath(out / entry.case)): entry.folder for entry in record.entries.values()}
    folders = result_folders(cases, taken)
    return [CaseTask(case, os.path.relpath(case, out), out, folders[case], overrides, Path.cwd()) for case in cases]


def _is_due(task: CaseTask, last: CampaignEntry | None, retry: bool) -> bool:
    """Whether a case has to be done: never done, done otherwise or from other inputs, or its results are gone."""
    if last is None or (retry and last.status != "done") or last.overrides != task.overrides:
        return True
    result = PROJECT if task.overrides.projects else RESULT
    gone = last.status != "failed" and not (task.out / task.folder / result).is_file()
    return gone or last.checksums != checksums(task.case)


@contextmanager
def _workers(cluster: str | None, insecure: bool, record: Record, due: Sequence[CaseTask]) -> Iterator[_Each]:
    """How tasks are worked off: in this process, or on a cluster whose workers see the same files."""
    if cluster is None:
        yield lambda function, tasks: enumerate(map(function, tasks))
        return
    with open_cluster(cluster, most=len(due), insecure=insecure) as connection:
        for path in (record.path, due[0].case):
            connection.require_visible_file(path)
        yield connection.each


def summary(campaign: Campaign) -> str:
    """Counts, and a line for each of the cases that failed or did not converge."""
    total, kept = len(campaign.entries), len(campaign.kept)
    counts = ", ".join(f"{number} {status}" for status in get_args(Status) if (number := campaign.count(status)))
    earlier = f" ({kept} of them earlier, and nothing has changed since)" if kept else ""
    troubled = [f"- {line(entry)}" for entry in campaign.entries if entry.status != "done"]
    return "\n".join([f"{many(total, 'case')}: {counts}{earlier}", *troubled])


def line(entry: CampaignEntry) -> str:
    """One case that is over, in one line."""
    if entry.status == "failed":
        return f"{entry.folder}: failed after {entry.seconds:.1f} s: {entry.message}"
    sigma0 = "not defined" if entry.sigma0 is None else f"{entry.sigma0:.4g}"
    ended = f"{entry.folder}: {entry.status}, {entry.iterations} iterations, sigma0 {sigma0}, {entry.seconds:.1f} s"
    return ended if entry.status == "done" else f"{ended}: {entry.message}"
