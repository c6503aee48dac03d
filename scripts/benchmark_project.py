"""What does `mgsgraph add` cost as a command, with 10, 100, 500 images already in the project?

Makes a project of a simulated strip's first images (batch, adopted), writes the files of the next image, and runs the
command on copies of the project. Writes a table, docs/project_cost.md by default.
"""

import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from argparse import Namespace
from pathlib import Path

from study import DOCS, OneLine, at_least, machine, made_with, show, table, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.case.schema import OrientationInput
from mgsgraph.errors import SolverError
from mgsgraph.incremental.incremental import IncrementalAdjustment
from mgsgraph.network.observations import observed
from mgsgraph.network.parts import KnownImage
from mgsgraph.project.project import Project, open_project
from mgsgraph.project.settings import MeasuresInput, ProjectSettings
from mgsgraph.simulation.files import write_texts
from mgsgraph.simulation.isis_files import image_file, json_text, laser_text, support_data, tie_network_text
from mgsgraph.simulation.strip import SimulatedStrip, StripSettings, simulate_strip
from mgsgraph.units import MRAD

WORDS = """# What `mgsgraph add` costs

A project of the first images of a simulated strip, solved by batch, gains one more with its ties and shots. Each figure
is the median of several runs of the command on copies of the project. Made by `scripts/benchmark.py project`.

* *command*: wall time of `mgsgraph add PROJECT NAME=image.isd --ties ties.pvl --shots lidar.json`, from the start of
  Python to its end, the project written and synchronised to disk.
* *tree*: of this, reading all reduced systems and growing iSAM2's tree from them (measured apart, in one process).
* *dry run*: of this, starting Python and reading the new image's files (measured apart, with `--dry-run`).
* *solve*: wall time of `mgsgraph solve PROJECT --no-figures`, batch over everything, once.
"""
_HEAD = ["images", "points", "project (MB)", "command (s)", "over the first", "tree (s)", "dry run (s)", "solve (s)"]


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


def run(project: Path, verb: str, *arguments: str) -> float:
    """Seconds that a command takes."""
    command = [sys.executable, "-m", "mgsgraph.cli", verb, str(project), *arguments]
    begin = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - begin
    if done.returncode != 0:
        raise SolverError(f"{verb}: {done.stderr.strip() or done.stdout.strip()}")
    return seconds


def tree(project: Path) -> float:
    """Seconds to grow the tree from what a project holds."""
    begin = time.perf_counter()
    with open_project(project) as opened:
        IncrementalAdjustment(opened.settings.solver.settings, opened.store)
    return time.perf_counter() - begin


def measured(strip: SimulatedStrip, images: int, repeats: int, work: Path) -> list[float]:
    """Points, MB, seconds of the command, of the tree, of reading files, and of solve."""
    show(f"{images} images: making the project")
    project, copy = work / "kept", work / "copy"
    kept(strip.upto(images), project)
    arguments = step(strip, images, work / "step")
    found = list[tuple[float, float, float]]()
    for number in range(repeats):
        show(f"{images} images: run {number + 1} of {repeats}")
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(project, copy)
        dry = run(copy, "add", *arguments, "--dry-run")
        found.append((run(copy, "add", *arguments), tree(project), dry))
    show(f"{images} images: solve")
    solved = run(copy, "solve", "--no-figures")
    size = (project / "project.sqlite").stat().st_size / 1e6
    points = len(strip.upto(images).ties.ids)
    shutil.rmtree(work)
    return [points, size, *(statistics.median(column) for column in zip(*found, strict=True)), solved]


def page(chosen: Namespace) -> str:
    """A row for each number of images."""
    strip, rows, first = simulate_strip(StripSettings(images=max(chosen.images) + 1, ties=chosen.ties)), [], 0.0
    for images in chosen.images:
        with tempfile.TemporaryDirectory() as folder:
            work = Path(folder) / "work"
            points, size, command, grown, dry, solved = measured(strip, images, chosen.repeats, work)
        first = first or command
        rows.append([str(images), f"{points:.0f}", f"{size:.0f}", f"{command:.2f}", f"{command / first:.2f}",
                     f"{grown:.2f}", f"{dry:.2f}", f"{solved:.1f}"])  # fmt: skip
    words = f"{chosen.ties} new ties per image, {chosen.repeats} runs. {machine()}. {made_with()}"
    return "\n".join([WORDS, *table(_HEAD, rows), "", words, ""])


def main(parser: OneLine, given: list[str]) -> int:
    """`benchmark.py project`."""
    parser.add_argument("images", type=at_least(2), nargs="*", default=[10, 100, 498], help="images there already")
    parser.add_argument("--ties", type=at_least(1), default=2000, help="new ties per image")
    parser.add_argument("--repeats", type=at_least(1), default=3)
    parser.add_argument("--out", type=Path, default=DOCS / "project_cost.md")
    chosen = parser.parse_args(given)
    return write_page(parser, chosen.out, lambda: page(chosen))
