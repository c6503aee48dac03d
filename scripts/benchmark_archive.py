"""From files to results: simulated archives adjusted by the command, each run a process (or a cluster) of its own.

    python scripts/benchmark.py archive --work WORK [block block-pages block-pvl kaguya dense ctx] [--repeat 3]

Archives are made in WORK by `mgsgraph simulate archive` where they aren't there. Every run is added to WORK/runs.jsonl
as soon as it is over, so that an interrupted campaign goes on where it was. Writes docs/scale.md, the part between its
marks; a run that the page needs and that is not there yet is a dash.
"""

import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import threading
import time
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from study import DOCS, OneLine, at_least, machine, made_with, number, show, table, write_page

from mgsgraph.errors import InputError, SolverError

BEGIN, END = "<!-- begin: benchmark.py archive -->", "<!-- end: benchmark.py archive -->"
"""Marks in the page; what lies between them is made."""
_GIGA = 1e9
_PAUSE = 0.2
"""s between two looks at a process's memory."""
STAGES = ("set up", "send to workers", "solve", "residuals", "covariance")
"""Of an adjustment (solution.json, `seconds`), in the table; what others take is small."""


class Job(NamedTuple):
    """What is run: an archive of a kind, and options of `mgsgraph adjust`."""

    kind: str
    images: int | None = None
    """None: as many as its kind has."""
    ties: int | None = None
    options: tuple[str, ...] = ()
    pages: bool = False
    """Whether the report page belongs to it (`mgsgraph report`)."""
    pvl: bool = False
    """Whether its network is PVL text."""
    memory_gb: float | None = None
    """[solver] memory_gb of its case."""


JOBS = {
    "block": Job("block", options=("--no-figures",)),
    "block-pages": Job("block", pages=True),
    "block-pvl": Job("block", options=("--no-figures",), pvl=True),
    "kaguya": Job("kaguya", options=("--no-figures",)),
    "dense-tenth": Job("dense", 2000, 1_200_000, ("--no-figures",)),
    "dense": Job("dense", options=("--no-figures",), memory_gb=14.0),
    "ctx-tenth": Job("ctx", 7000, 240_000, ("--no-figures", "--cluster", "local:2")),
    "ctx": Job("ctx", options=("--no-figures", "--cluster", "local:2")),
}


@dataclass(frozen=True, slots=True)
class Run:
    """One run of a job."""

    job: str
    commit: str
    wall: float
    """s"""
    processor: float
    """s, of all processes."""
    memory: float
    """bytes of memory of its own that all processes had at a time, at most: mapped files don't count, and what forks
    share counts once."""
    images: int
    points: int
    measures: int
    stages: dict[str, float]
    """s, of the adjustment's stages."""


# --- one run


def _processes(first: int) -> list[int]:
    """A process and all that it has begun."""
    found, waiting = list[int](), [first]
    while waiting:
        one = waiting.pop()
        found.append(one)
        try:
            for path in Path(f"/proc/{one}/task").iterdir():
                waiting += map(int, (path / "children").read_text(encoding="ascii").split())
        except OSError:  # it has ended
            continue
    return found


def _own_memory(process: int) -> float:
    """Bytes of memory of its own that a process has; what it shares with forks of it is shared out among them."""
    try:
        text = Path(f"/proc/{process}/smaps_rollup").read_text(encoding="ascii", errors="replace")
    except OSError:
        return 0.0
    found = re.search(r"Pss_Anon:\s+(\d+) kB", text)
    return 1024.0 * float(found[1]) if found else 0.0


def watched(command: Sequence[str]) -> tuple[float, float, float]:
    """Wall time, processor time and largest memory of a command and its children.

    Raises SolverError where it fails.
    """
    before, begin, most = os.times(), time.perf_counter(), 0.0
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as running:
        said = list[str]()
        assert running.stderr is not None
        reader = threading.Thread(target=lambda: said.extend(running.stderr or ()), daemon=True)
        reader.start()
        while running.poll() is None:
            most = max(most, sum(map(_own_memory, _processes(running.pid))))
            time.sleep(_PAUSE)
        reader.join()
    if running.returncode:
        raise SolverError(f"{' '.join(command[:6])} ..: {(said or ['no message'])[-1].strip()}")
    wall, after = time.perf_counter() - begin, os.times()
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    return wall, spent, most


def _mgsgraph(*arguments: str | Path) -> list[str]:
    return [sys.executable, "-m", "mgsgraph", *map(str, arguments)]


def archive_of(job: Job, work: Path) -> Path:
    """The case of a job; its archive is made where it isn't there."""
    name = job.kind if job.images is None else f"{job.kind}{job.images}"
    folder = work / name
    if not (folder / "case.toml").is_file():
        size = [] if job.images is None else ["--images", str(job.images), "--ties", str(job.ties)]
        watched(_mgsgraph("simulate", "archive", "--kind", job.kind, *size, "--out", folder))
    case = folder / "case.toml"
    if job.pvl:
        case = folder / "case-pvl.toml"
        if not case.is_file():
            watched(_mgsgraph("convert", folder / "network.net", "--out", folder / "network.pvl"))
            text = (folder / "case.toml").read_text(encoding="utf-8").replace("network.net", "network.pvl")
            case.write_text(text, encoding="utf-8")
    if job.memory_gb is not None:
        own = folder / "case-memory.toml"
        own.write_text(f"{case.read_text(encoding='utf-8')}\n[solver]\nmemory_gb = {job.memory_gb}\n", encoding="utf-8")
        case = own
    return case


def run(name: str, work: Path) -> Run:
    """Adjust a job's archive once."""
    job, out = JOBS[name], work / "result"
    case = archive_of(job, work)
    shutil.rmtree(out, ignore_errors=True)
    spent = [watched(_mgsgraph("adjust", case, "--out", out, *job.options))]
    if job.pages:
        spent.append(watched(_mgsgraph("report", out, "--out", work / "result.html")))
    record = json.loads((out / "solution.json").read_text(encoding="utf-8"))
    wall, processor, memory = zip(*spent, strict=True)
    measures = sum(image["rays"] for image in record["images"])
    points = sum(one["count"] for one in record["points"].values())
    sizes = len(record["images"]), points, measures
    shutil.rmtree(out)
    return Run(name, _commit(), sum(wall), sum(processor), max(memory), *sizes, record["seconds"])


def _commit() -> str:
    command = ["git", "-C", str(DOCS), "rev-parse", "--short", "HEAD"]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip() or "unknown"


# --- the page


def kept(path: Path) -> list[Run]:
    """Runs that are over."""
    if not path.is_file():
        return []
    return [Run(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]


def medians(runs: Sequence[Run]) -> dict[str, Any]:
    """Medians of the runs of one job."""
    every = [asdict(one) | {"count": len(runs)} for one in runs]
    names = ("wall", "processor", "memory", "images", "points", "measures", "count")
    found: dict[str, Any] = {name: statistics.median(one[name] for one in every) for name in names}
    found["stages"] = {
        stage: statistics.median(one.stages.get(stage, 0.0) for one in runs) for stage in ("reading", *STAGES)
    }
    found["commit"] = runs[-1].commit
    return found


def exponent(sizes: Sequence[float], values: Sequence[float]) -> float:
    """Slope of the logarithms; NaN for fewer than two sizes."""
    if len(set(sizes)) < 2:
        return float("nan")
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def lines(runs: Sequence[Run]) -> list[str]:
    """The made part of the page."""
    of = {name: medians(mine) for name in JOBS if (mine := [one for one in runs if one.job == name])}
    head = ["archive", "images", "points", "measures", "reading (s)", *(f"{stage} (s)" for stage in STAGES),
            "start and results (s)", "wall (s)", "processor (s)", "memory (GB)", "runs", "commit"]  # fmt: skip
    rows = []
    for name, one in of.items():
        stages = [one["stages"]["reading"], *(one["stages"][stage] for stage in STAGES)]
        sizes = [f"{one[key]:.0f}" for key in ("images", "points", "measures")]
        rest = one["wall"] - sum(stages)
        rows.append([
            name, *sizes, *(f"{value:.1f}" for value in (*stages, rest, one["wall"], one["processor"])),
            f"{one['memory'] / _GIGA:.2f}", f"{one['count']:.0f}", one["commit"],
        ])  # fmt: skip
    pairs = [("dense-tenth", "dense"), ("ctx-tenth", "ctx")]
    grown = [
        [f"{a} to {b}", *(number(exponent([of[a]["measures"], of[b]["measures"]], [of[a][key], of[b][key]]))
                          for key in ("wall", "processor", "memory"))]
        for a, b in pairs if a in of and b in of
    ]  # fmt: skip
    words = f"{machine()}. {made_with()}"
    return [
        *table(head, rows), "", "Exponents in the number of measures (slopes of the logarithms between two sizes):", "",
        *table(["from, to", "wall", "processor", "memory"], grown), "", words,
    ]  # fmt: skip


def filled(page: str, made: Sequence[str]) -> str:
    """A page with what is made between its marks.

    Raises InputError for a page without them.
    """
    before, mark, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (mark and end):
        raise InputError("docs/scale.md", "no marks of the made part", f"{BEGIN} .. {END}")
    return "\n".join([before + BEGIN, "", *made, "", END + after])


def page(chosen: Namespace) -> str:
    """Run what is wanted and not over yet, and fill in the page."""
    chosen.work.mkdir(parents=True, exist_ok=True)
    record = chosen.work / "runs.jsonl"
    for name in chosen.jobs:
        while sum(one.job == name for one in kept(record)) < chosen.repeat:
            show(f"{name}: run {1 + sum(one.job == name for one in kept(record))} of {chosen.repeat}")
            done = run(name, chosen.work)
            with record.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(done)) + "\n")
    return filled((DOCS / "scale.md").read_text(encoding="utf-8"), lines(kept(record)))


def main(parser: OneLine, given: list[str]) -> int:
    """`benchmark.py archive`."""
    parser.add_argument("jobs", nargs="*", default=["block", "block-pages", "block-pvl", "kaguya"], metavar="JOB",
                        help=f"of {', '.join(JOBS)}")  # fmt: skip
    parser.add_argument("--work", type=Path, required=True, help="folder of archives and runs; 20 GB for all")
    parser.add_argument("--repeat", type=at_least(1), default=3)
    parser.add_argument("--out", type=Path, default=DOCS / "scale.md")
    chosen = parser.parse_args(given)
    for name in chosen.jobs:
        if name not in JOBS:
            parser.error(f"no job {name!r}; expected some of {', '.join(JOBS)}")
    return write_page(parser, chosen.out, lambda: page(chosen))
