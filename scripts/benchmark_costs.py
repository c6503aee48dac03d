"""What commands and questions cost: archives from files to results, a project's commands, questions to an adjustment.

A command is a process of its own, measured by `watched`: wall time, processor time of all its threads and children, and
the most memory that they had at a time. Figures are medians of several runs.
"""

import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from peer_blocks import SHARED, SIZES, made
from peer_problem import network
from study import DOCS, OneLine, at_least, commit, number, show, table, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.analysis.components import components
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.posterior import Pixel, Posterior
from mgsgraph.analysis.reliability import reliability, suspects
from mgsgraph.case.schema import OrientationInput
from mgsgraph.errors import SolverError
from mgsgraph.network import Network
from mgsgraph.network.observations import build_network
from mgsgraph.network.parts import KnownImage
from mgsgraph.project.project import Project, open_project
from mgsgraph.project.settings import MeasuresInput, ProjectSettings
from mgsgraph.results.analysis import reliability_table
from mgsgraph.simulation.case_files import image_file, json_text, laser_text, support_data, tie_network_text
from mgsgraph.simulation.files import write_texts
from mgsgraph.simulation.strip import SimulatedStrip, StripSettings, simulate_strip
from mgsgraph.units import MRAD

_GIGA = 1e9
_PAUSE = 0.2
"""s between two readings of a process's memory."""


# --- a command


class Took(NamedTuple):
    """What a command takes."""

    wall: float
    """s"""
    processor: float
    """s, of all processes."""
    memory: float
    """bytes of memory of its own that all processes had at a time, at most: mapped files don't count, and what forks
    share counts once."""

    def __str__(self) -> str:
        return f"{number(self.wall)}, {number(self.processor)}"


def _processes(root: int) -> list[int]:
    """A process and all its descendants."""
    processes, waiting = list[int](), [root]
    while waiting:
        process = waiting.pop()
        processes.append(process)
        try:
            for path in Path(f"/proc/{process}/task").iterdir():
                waiting += map(int, (path / "children").read_text(encoding="ascii").split())
        except OSError:  # it has ended
            continue
    return processes


def _own_memory(process: int) -> float:
    """Bytes of memory of its own that a process has; memory shared with forks is divided among them."""
    try:
        text = Path(f"/proc/{process}/smaps_rollup").read_text(encoding="ascii", errors="replace")
    except OSError:
        return 0.0
    match = re.search(r"Pss_Anon:\s+(\d+) kB", text)
    return 1024.0 * float(match[1]) if match else 0.0


def watched(command: Sequence[str]) -> Took:
    """Run a command; SolverError where it fails."""
    before, begin, most, running_on = os.times(), time.perf_counter(), 0.0, True
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, env=environment, text=True, **pipes) as running:  # type: ignore[call-overload]
        messages = list[str]()
        reader = threading.Thread(target=lambda: messages.extend(running.stderr), daemon=True)
        reader.start()
        while running_on:
            most = max(most, sum(map(_own_memory, _processes(running.pid))))
            try:
                running_on = running.wait(_PAUSE) is None
            except subprocess.TimeoutExpired:
                continue
        wall = time.perf_counter() - begin
        reader.join()
    if running.returncode:
        raise SolverError(f"{' '.join(command[:6])} ..: {(messages or ['no message'])[-1].strip()}")
    after = os.times()
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    return Took(wall, spent, most)


def mgsgraph(*arguments: str | Path) -> Took:
    """Run a command of this program."""
    return watched([sys.executable, "-m", "mgsgraph", *map(str, arguments)])


def median(runs: Sequence[Took]) -> Took:
    """Median of each figure."""
    return Took(*map(statistics.median, zip(*runs, strict=True)))


# --- archives


class Job(NamedTuple):
    """An archive of a kind, and options of `mgsgraph adjust`."""

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
STAGES = ("reading", "set up", "send to workers", "solve", "residuals", "covariance")
"""Of an adjustment (solution.json, `seconds`), that the table has; the other stages are short."""


@dataclass(frozen=True, slots=True)
class Run:
    """One run of a job: what it took, its sizes, s of the adjustment's stages."""

    job: str
    commit: str
    wall: float
    processor: float
    memory: float
    images: int
    points: int
    measures: int
    stages: dict[str, float]


def archive_of(job: Job, work: Path) -> Path:
    """The case of a job; its archive is made where it is missing."""
    folder = work / (job.kind if job.images is None else f"{job.kind}{job.images}")
    case = folder / "case.toml"
    if not case.is_file():
        size = [] if job.images is None else ["--images", str(job.images), "--ties", str(job.ties)]
        mgsgraph("simulate", "archive", "--kind", job.kind, *size, "--out", folder)
    if job.pvl and not (folder / "network.pvl").is_file():
        mgsgraph("convert", folder / "network.net", "--out", folder / "network.pvl")
    text = case.read_text(encoding="utf-8")
    text = text.replace("network.net", "network.pvl") if job.pvl else text
    text += f"\n[solver]\nmemory_gb = {job.memory_gb}\n" if job.memory_gb is not None else ""
    job_case = folder / "case-job.toml"
    job_case.write_text(text, encoding="utf-8")
    return job_case


def run(name: str, work: Path) -> Run:
    """Adjust a job's archive once."""
    job, out = JOBS[name], work / "result"
    case = archive_of(job, work)
    shutil.rmtree(out, ignore_errors=True)
    spent = [mgsgraph("adjust", case, "--out", out, *job.options)]
    if job.pages:
        spent.append(mgsgraph("report", out, "--out", work / "result.html"))
    record = json.loads((out / "solution.json").read_text(encoding="utf-8"))
    wall, processor, memory = zip(*spent, strict=True)
    measures = sum(image["rays"] for image in record["images"])
    points = sum(kind["count"] for kind in record["points"].values())
    sizes = len(record["images"]), points, measures
    shutil.rmtree(out)
    return Run(name, commit(), sum(wall), sum(processor), max(memory), *sizes, record["seconds"])


def finished(path: Path) -> list[Run]:
    """Finished runs of a file."""
    if not path.is_file():
        return []
    return [Run(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]


def archive_tables(runs: Sequence[Run]) -> list[str]:
    """Medians of each job, and exponents between two sizes of a kind."""
    rows, of = [], dict[str, Run]()
    for name in JOBS:
        if of_job := [asdict(record) for record in runs if record.job == name]:
            keys = ("wall", "processor", "memory", "images", "points", "measures")
            middle = {key: statistics.median(record[key] for record in of_job) for key in keys}
            stages = {key: statistics.median(record["stages"].get(key, 0.0) for record in of_job) for key in STAGES}
            medians = of[name] = Run(**middle, stages=stages, job=name, commit=of_job[-1]["commit"])
            seconds = (*stages.values(), medians.wall - sum(stages.values()), medians.wall, medians.processor)
            sizes = (f"{value:.0f}" for value in (medians.images, medians.points, medians.measures))
            ends = f"{medians.memory / _GIGA:.2f}", str(len(of_job)), medians.commit
            rows.append([name, *sizes, *(f"{value:.1f}" for value in seconds), *ends])
    head = ["archive", "images", "points", "measures", *(f"{stage} (s)" for stage in STAGES), "start and results (s)",
            "wall (s)", "processor (s)", "memory (GB)", "runs", "commit"]  # fmt: skip
    grown = [
        [f"{a} to {b}", *(number(exponent(of[a], of[b], key)) for key in ("wall", "processor", "memory"))]
        for a, b in (("dense-tenth", "dense"), ("ctx-tenth", "ctx")) if a in of and b in of
    ]  # fmt: skip
    caption = "Exponents in the number of measures (slopes of the logarithms between two sizes):"
    return [*table(head, rows), "", caption, "", *table(["from, to", "wall", "processor", "memory"], grown)]


def exponent(small: Run, large: Run, key: str) -> float:
    """Slope of the logarithms of a figure against the number of measures."""
    return float(np.log(getattr(large, key) / getattr(small, key)) / np.log(large.measures / small.measures))


def archive(parser: OneLine, arguments: list[str]) -> int:
    """From files to results: simulated archives adjusted by the command, each run a process (or a cluster) of its own.

    python scripts/benchmark.py archive --work WORK [block block-pages block-pvl kaguya dense ctx] [--repeat 3]

    Archives are made in WORK by `mgsgraph simulate archive` where they aren't there. Every run is added to
    WORK/runs.jsonl as soon as it is over, so that an interrupted campaign goes on where it was. Fills
    docs/evidence_cost.md.
    """
    parser.add_argument("jobs", nargs="*", default=["block", "block-pages", "block-pvl", "kaguya"], metavar="JOB",
                        help=f"of {', '.join(JOBS)}")  # fmt: skip
    parser.add_argument("--work", type=Path, required=True, help="folder of archives and runs; 20 GB for all")
    parser.add_argument("--repeat", type=at_least(1), default=3)
    parser.add_argument("--out", type=Path, default=DOCS / "evidence_cost.md")
    options = parser.parse_args(arguments)
    for name in options.jobs:
        if name not in JOBS:
            parser.error(f"no job {name!r}; expected some of {', '.join(JOBS)}")

    def make() -> dict[str, list[str]]:
        options.work.mkdir(parents=True, exist_ok=True)
        record = options.work / "runs.jsonl"
        for name in options.jobs:
            while (count := sum(r.job == name for r in finished(record))) < options.repeat:
                show(f"{name}: run {count + 1} of {options.repeat}")
                done = run(name, options.work)
                with record.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(done)) + "\n")
        return {"archive": archive_tables(finished(record))}

    return write_page(parser, options.out, "evidence_cost.md#archive", make)


# --- the commands of a project


def solved_project(strip: SimulatedStrip, folder: Path) -> None:
    """A project of a strip, solved."""
    noise = strip.settings.noise
    settings = ProjectSettings(
        OrientationInput(position_sigma_m=noise.position, angle_sigma_mrad=noise.angle / MRAD, trend=noise.trend),
        measures=MeasuresInput(noise.tie, noise.shot_image),
    )
    known_images = {image.name: KnownImage(image, noise.prior) for image in strip.images}
    block = build_network(known_images, [strip.ties, *strip.lasers], noise.tie, noise.shot_image)
    assert block is not None
    solution = adjust_network(block, settings.solver.settings)
    with Project.create(folder, "strip", settings) as made_project:
        IncrementalAdjustment(settings.solver.settings, made_project.store).adopt(solution)
        made_project.record("solve", f"{len(block.images)} images", {})
        made_project.record_batch(solution)


def step(strip: SimulatedStrip, k: int, folder: Path) -> list[str]:
    """Files of image k; the command's arguments for them."""
    image, ties, laser = strip.addition(k)
    texts = {image_file(image): json_text(support_data(image)), "ties.pvl": tie_network_text(ties, "step", "step")}
    arguments = [f"{image.name}={folder / image_file(image)}", "--ties", str(folder / "ties.pvl")]
    if laser is not None:
        texts["lidar.json"] = laser_text((laser,))
        arguments += ["--shots", str(folder / "lidar.json")]
    write_texts(folder, texts)
    return arguments


def tree(folder: Path) -> float:
    """Seconds to grow the tree from what a project holds."""
    begin = time.perf_counter()
    with open_project(folder) as opened:
        IncrementalAdjustment(opened.settings.solver.settings, opened.store)
    return time.perf_counter() - begin


def project_row(strip: SimulatedStrip, images: int, repeats: int, solve: bool, work: Path) -> list[str]:
    """Times of the commands with a number of images in the project."""
    show(f"{images} images: making the project")
    original, copy = work / "kept", work / "copy"
    solved_project(strip.upto(images), original)
    arguments = step(strip, images, work / "step")
    runs: dict[str, list[Took]] = {"add": [], "dry": [], "status": []}
    trees = list[float]()
    for repeat in range(repeats + 1):
        show(f"{images} images: run {repeat} of {repeats}")
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(original, copy)
        runs["status"].append(mgsgraph("project", "status", copy))
        runs["dry"].append(mgsgraph("project", "add", copy, *arguments, "--dry-run"))
        runs["add"].append(mgsgraph("project", "add", copy, *arguments))
        trees.append(tree(copy))
    add, dry, status = (median(times[1:]) for times in (runs["add"], runs["dry"], runs["status"]))  # the first compiles
    size = (original / "project.sqlite").stat().st_size / 1e6
    last = str(mgsgraph("project", "solve", copy, "--no-figures")) if solve else "-"
    points = str(len(strip.upto(images).ties.ids))
    seconds = f"{statistics.median(trees[1:]):.2f}"
    return [str(images), points, f"{size:.0f}", str(add), seconds, str(dry), str(status), last]


def project(parser: OneLine, arguments: list[str]) -> int:
    """What do `project add`, `status` and `solve` cost as commands, with 10, 100, 498 images already in the project?

    Makes a project of a simulated strip's first images (batch, adopted), writes the files of the next image, and runs
    the commands on copies of the project, each several times. Fills docs/evidence_cost.md.
    """
    parser.add_argument("images", type=at_least(2), nargs="*", default=[10, 100, 498], help="images there already")
    parser.add_argument("--ties", type=at_least(1), default=2000, help="new ties per image")
    parser.add_argument("--repeats", type=at_least(1), default=3, help="runs whose median counts")
    parser.add_argument("--no-solve", action="store_true", help="leave solve out")
    parser.add_argument("--out", type=Path, default=DOCS / "evidence_cost.md")
    options = parser.parse_args(arguments)

    def make() -> dict[str, list[str]]:
        strip, rows = simulate_strip(StripSettings(images=max(options.images) + 1, ties=options.ties)), []
        for images in options.images:
            with tempfile.TemporaryDirectory() as folder:
                rows.append(project_row(strip, images, options.repeats, not options.no_solve, Path(folder)))
        head = ["images", "points", "project (MB)", "add (s)", "tree (s)", "dry run (s)", "status (s)", "solve (s)"]
        return {"project": table(head, rows)}

    return write_page(parser, options.out, "evidence_cost.md#project", make)


# --- questions


ITERATION = "iteration"
QUERIES = ("point", "pose", "pair of points", "projection", "intersection")
Seconds = dict[str, list[float]]


def turn(block: Network, settings: Any, queries: int, seconds: Seconds) -> list[str]:
    """Adjust a network, run each query once, record the seconds; its size as text."""

    def timed(name: str, job: Callable[[], Any], count: int = 1) -> Any:
        begin = time.perf_counter()
        result = job()
        seconds.setdefault(name, []).append((time.perf_counter() - begin) / count)
        return result

    solution = adjust_network(block, settings)
    seconds.setdefault(ITERATION, []).append(solution.seconds["solve"] / solution.iterations)
    at = timed("linearised", lambda: at_solution(solution))
    tests = timed("reliability table", lambda: reliability(at))
    timed("sorted", lambda: tests.order(len(tests)))
    timed("suspects", lambda: suspects(tests))
    with tempfile.TemporaryDirectory() as folder:
        timed("file", lambda: reliability_table(tests).write_csv(Path(folder) / "reliability.csv"))
    timed("variance components", lambda: components(at))
    for name, query in zip(QUERIES, single_queries(block, Posterior(at), queries), strict=True):
        query(0)  # the first query fills caches
        timed(name, lambda query=query: [query(k) for k in range(1, queries + 1)], queries)
    return [f"{len(tests):,} scalar measures", f"{solution.iterations} iterations"]


def single_queries(block: Network, posterior: Posterior, queries: int) -> tuple[Callable[[int], object], ...]:
    """The `QUERIES` by number; each number means other points and images, spread over the rays."""
    rays, ids, images = block.rays, block.points.ids, block.images
    chosen = np.linspace(0, rays.point.size - 1, queries + 2).astype(np.int64)
    names, image_of = [ids[i] for i in rays.point[chosen]], [images[j] for j in rays.image[chosen]]
    pixels = [
        [Pixel(images[rays.image[k]].name, *rays.places[k].tolist(), float(rays.sigmas[k].max()))
         for k in np.flatnonzero(rays.point == i).tolist()] for i in rays.point[chosen]
    ]  # fmt: skip
    return (
        lambda k: posterior.point(names[k]),
        lambda k: posterior.pose(image_of[k].name, 0.5 * image_of[k].lines),
        lambda k: posterior.difference(names[k], names[k + 1]),
        lambda k: posterior.projection(names[k], image_of[k].name),
        lambda k: posterior.intersection(pixels[k]),
    )


def query_tables(seconds: Seconds) -> list[str]:
    """Medians, and the ratios to an iteration of the same turn."""
    rows = [[name, f"{statistics.median(times):.3f}", ratio(times, seconds[ITERATION])]
            for name, times in seconds.items() if name not in QUERIES]  # fmt: skip
    single = [[name, f"{1e3 * statistics.median(seconds[name]):.2f}"] for name in QUERIES]
    first = table(["what", "seconds", "over an iteration"], rows)
    return [*first, "", *table(["query", "milliseconds"], single)]


def ratio(times: list[float], iteration: list[float]) -> str:
    """Median ratio of times to those of the same turn, least and most."""
    ratios = sorted(seconds / reference for seconds, reference in zip(times, iteration, strict=True))
    return f"{statistics.median(ratios):.2f} ({ratios[0]:.2f} .. {ratios[-1]:.2f})"


def analysis(parser: OneLine, arguments: list[str]) -> int:
    """Times of queries to an adjustment.

    Adjusts one of the peer's problems (or the Kaguya-sized block) and times, in one process and in turn: an adjustment,
    linearizing it at its solution, the reliability table, its sorting and its file, variance components, and single
    queries of the posterior. The first turn, which also loads the compiled kernel, isn't counted. Fills
    docs/evidence_cost.md.
    """
    parser.add_argument("size", nargs="?", choices=SIZES, default="L")
    parser.add_argument("--repeat", type=at_least(1), default=5, help="turns")
    parser.add_argument("--queries", type=at_least(1), default=20, help="single queries of each kind in a turn")
    parser.add_argument("--shared", type=Path, default=SHARED, help="folder of the peer's generator")
    parser.add_argument("--out", type=Path, default=DOCS / "evidence_cost.md")
    options = parser.parse_args(arguments)

    def make() -> dict[str, list[str]]:
        problem, _ = made(options.size, options.shared)
        inputs, counts, seconds = network(problem, "predicted"), list[str](), Seconds()
        for repeat in range(options.repeat + 1):
            show(f"turn {repeat} of {options.repeat}")
            seconds = Seconds() if repeat <= 1 else seconds
            counts = turn(*inputs, options.queries, seconds)
        sizes = f"{problem.orientation.shape[0]} images", f"{problem.places.shape[0]:,} points", *counts
        title = f"Size {options.size}: {', '.join(sizes)}; {options.repeat} turns."
        return {"analysis": [title, "", *query_tables(seconds)]}

    return write_page(parser, options.out, "evidence_cost.md#analysis", make)
