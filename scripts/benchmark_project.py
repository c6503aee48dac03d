"""What do `mgsgraph add`, `status` and `solve` cost as commands, with 10, 100, 498 images already in the project?

Makes a project of a simulated strip's first images (batch, adopted), writes the files of the next image, and runs the
commands on copies of the project, each several times. Writes a table, docs/project_cost.md by default.
"""

import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from argparse import Namespace
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from study import DOCS, OneLine, at_least, machine, made_with, number, show, table, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.case.schema import OrientationInput
from mgsgraph.errors import SolverError
from mgsgraph.network.observations import observed
from mgsgraph.network.parts import KnownImage
from mgsgraph.project.project import Project, open_project
from mgsgraph.project.settings import MeasuresInput, ProjectSettings
from mgsgraph.simulation.case_files import image_file, json_text, laser_text, support_data, tie_network_text
from mgsgraph.simulation.files import write_texts
from mgsgraph.simulation.strip import SimulatedStrip, StripSettings, simulate_strip
from mgsgraph.units import MRAD

WORDS = """# What the commands of a project cost

A project of the first images of a simulated strip, solved by batch, gains one more with its ties and shots. Each figure
is the median of several runs of a command on copies of the project (`solve`: one run). Made by
`scripts/benchmark.py project`.

Seconds are two of each command: wall time from the start of Python to its end, and processor time of all its threads.
Where other jobs run beside it the latter says more.

* *add*: `mgsgraph add PROJECT NAME=image.isd --ties ties.pvl --shots lidar.json`, the project written and synchronised
  to disk.
* *over the first*: its processor time over that in the first row.
* *tree*: of this, reading all reduced systems and growing iSAM2's tree from them (wall time, in one process).
* *dry run*: the same with `--dry-run`: starting Python and reading the new image's files.
* *status*: `mgsgraph status PROJECT`.
* *solve*: `mgsgraph solve PROJECT --no-figures`, batch over everything with all tables.

Kernels are compiled and Python's bytecode is written by a run before the first that counts, as both are after an
installation.
"""
_HEAD = ["images", "points", "project (MB)", "add (s)", "over the first", "tree (s)", "dry run (s)", "status (s)",
         "solve (s)"]  # fmt: skip


class Took(NamedTuple):
    """Time that a command takes."""

    wall: float
    """s"""
    processor: float
    """s, of all threads, in the program and in the system."""

    def __str__(self) -> str:
        return f"{number(self.wall)}, {number(self.processor)}"


class Costs(NamedTuple):
    """A row of the table."""

    points: int
    megabytes: float
    add: Took
    tree: float
    dry: Took
    status: Took
    solve: Took | None


def kept(strip: SimulatedStrip, folder: Path) -> None:
    """A project of a strip, solved."""
    noise = strip.settings.noise
    settings = ProjectSettings(
        OrientationInput(position_sigma_m=noise.position, angle_sigma_mrad=noise.angle / MRAD, trend=noise.trend),
        measures=MeasuresInput(noise.tie, noise.shot_image),
    )
    known = {image.name: KnownImage(image, noise.prior) for image in strip.images}
    network = observed(known, [strip.ties, *strip.lasers], noise.tie, noise.shot_image)
    if network is None:
        raise SolverError("a strip without observations")
    solution = adjust_network(network, settings.solver.settings)
    with Project.create(folder, "strip", settings) as project:
        IncrementalAdjustment(settings.solver.settings, project.store).adopt(solution)
        project.record("solve", f"{len(network.images)} images", {})
        project.record_batch(solution)


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


def run(project: Path, verb: str, *arguments: str) -> Took:
    """Run a command of this interpreter, and time it."""
    command = [sys.executable, "-m", "mgsgraph", verb, str(project), *arguments]
    variables = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=variables)
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != 0:
        raise SolverError(f"{verb}: {done.stderr.strip() or done.stdout.strip()}")
    return Took(wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)


def median(runs: Iterable[Took]) -> Took:
    """Median wall time and median processor time."""
    return Took(*map(statistics.median, zip(*runs, strict=True)))


def tree(project: Path) -> float:
    """Seconds to grow the tree from what a project holds."""
    begin = time.perf_counter()
    with open_project(project) as opened:
        IncrementalAdjustment(opened.settings.solver.settings, opened.store)
    return time.perf_counter() - begin


def measured(strip: SimulatedStrip, images: int, chosen: Namespace, work: Path) -> Costs:
    """What the commands cost with so many images in the project."""
    show(f"{images} images: making the project")
    project, copy = work / "kept", work / "copy"
    kept(strip.upto(images), project)
    arguments = step(strip, images, work / "step")
    found = list[tuple[Took, Took, Took, float]]()
    for again in range(chosen.repeats + 1):
        show(f"{images} images: run {again} of {chosen.repeats}")
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(project, copy)
        status, dry = run(copy, "status"), run(copy, "add", *arguments, "--dry-run")
        found.append((run(copy, "add", *arguments), dry, status, tree(project)))
    adds, dries, statuses, trees = zip(*found[1:], strict=True)  # the first compiles
    show(f"{images} images: solve")
    solved = None if chosen.no_solve else run(copy, "solve", "--no-figures")
    size = (project / "project.sqlite").stat().st_size / 1e6
    points = len(strip.upto(images).ties.ids)
    shutil.rmtree(work)
    return Costs(points, size, median(adds), statistics.median(trees), median(dries), median(statuses), solved)


def page(chosen: Namespace) -> str:
    """A row for each number of images."""
    strip, rows, first = simulate_strip(StripSettings(images=max(chosen.images) + 1, ties=chosen.ties)), [], 0.0
    loads = [os.getloadavg()[0]]
    for images in chosen.images:
        with tempfile.TemporaryDirectory() as folder:
            found = measured(strip, images, chosen, Path(folder) / "work")
        first = first or found.add.processor
        rows.append([
            str(images), str(found.points), f"{found.megabytes:.0f}", str(found.add),
            f"{found.add.processor / first:.2f}", f"{found.tree:.2f}", str(found.dry), str(found.status),
            "-" if found.solve is None else str(found.solve),
        ])  # fmt: skip
        loads.append(os.getloadavg()[0])
    load = f"load {' '.join(f'{one:.1f}' for one in loads)} before the first row and after each"
    words = f"{chosen.ties} new ties per image, {chosen.repeats} runs. {machine()}, {load}. {made_with()}"
    return "\n".join([WORDS, *table(_HEAD, rows), "", words, ""])


def main(parser: OneLine, given: list[str]) -> int:
    """`benchmark.py project`."""
    parser.add_argument("images", type=at_least(2), nargs="*", default=[10, 100, 498], help="images there already")
    parser.add_argument("--ties", type=at_least(1), default=2000, help="new ties per image")
    parser.add_argument("--repeats", type=at_least(1), default=3, help="runs whose median counts")
    parser.add_argument("--no-solve", action="store_true", help="leave solve out")
    parser.add_argument("--out", type=Path, default=DOCS / "project_cost.md")
    chosen = parser.parse_args(given)
    return write_page(parser, chosen.out, lambda: page(chosen))
