"""The recipe of docs/cluster.md on a simulated region: times, memory and a picture; killed in the middle and continued.

    python scripts/region.py [--images 1000] [--seed 52] [--workers 2] [--work FOLDER] [--out FILE]

Some images are withheld at first and come later. The batch is killed (SIGKILL, workers too) when half of the groups are
recorded, and the same command goes on. Points are compared with the truth, which is known here.
"""

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import chdir
from datetime import datetime
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet
from benchmark_costs import Took, mgsgraph
from matplotlib.figure import Figure
from study import DOCS, at_least, command, show, table, work_and_page, write_page

from mgsgraph.case.case_file import decode, read_images
from mgsgraph.geometry.footprint import footprint, map_degrees
from mgsgraph.project.campaign import RECORD
from mgsgraph.text import root_mean_square as rms

PAGE = "cluster.md#region"
BATCH = "batch sites --out blocks --projects --no-figures --cluster local:{}"
_LATER = 4
"""Images that come later, evenly spaced in the archive."""
_AXES = ("x_m", "y_m", "z_m")


def main() -> int:
    """Entry point."""
    parser = command(__doc__)
    parser.add_argument("--images", type=at_least(20), default=1000)
    parser.add_argument("--seed", type=at_least(0), default=52)
    parser.add_argument("--workers", type=at_least(1), default=2)
    work_and_page(parser, PAGE)
    options = parser.parse_args()

    def make() -> dict[str, list[str]]:
        with tempfile.TemporaryDirectory() as temporary, chdir(options.work or temporary):
            return recipe(options.images, options.seed, BATCH.format(options.workers))

    return write_page(parser, options.out, PAGE, make)


def recipe(images: int, seed: int, batch: str) -> dict[str, list[str]]:
    """Run all commands in the working directory; the made parts of the page."""
    rows, case = list[tuple[str, str, Took]](), Path("region/case.toml")

    def run(line: str, note: str = "") -> None:
        show(line)
        rows.append((line, note, mgsgraph(*line.split())))

    run(f"simulate archive --kind region --images {images} --seed {seed} --out region")
    whole, later = case.read_text(encoding="utf-8"), [f'"REG/{j:06d}"' for j in range(images // 9, images, images // 4)]
    case.write_text(without(whole, later), encoding="utf-8")
    run("split region/case.toml --out sites", f"{len(later)} images withheld")
    groups = len(list(Path("sites").iterdir()))
    rows.append((batch, *killed(batch, groups // 2)))
    before = len(entries())
    run(batch, f"goes on with the other {groups - before}")
    times = entries()
    case.write_text(whole, encoding="utf-8")
    run("split region/case.toml --out sites", "all images")
    run(batch, f"the {len(later)} images have come")
    grown = len(entries()) - len(times)
    draw(case, [datetime.fromisoformat(entry["finished"]).timestamp() for entry in times], before)
    lines = [
        (f"`mgsgraph {line}`", note, *(f"{value:.0f}" if value == value else "" for value in figures))
        for line, note, took in rows for figures in [(took.wall, took.processor, took.memory / 1e6)]
    ]  # fmt: skip
    head = ("command", "", "wall (s)", "processor (s)", "memory (MB)")
    return {"commands": table(head, lines), "found": found(groups, before, grown)}


def without(text: str, names: list[str]) -> str:
    """The text of a case without the tables of some images."""
    tables = re.split(r"\n(?=\[\[)", text)
    return "\n".join(one for one in tables if not any(f"= {name}" in one for name in names))


def entries() -> list[dict[str, object]]:
    """Cases that the record of the batch has so far."""
    path = Path("blocks") / RECORD
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()[1:]]


def killed(line: str, after: int) -> tuple[str, Took]:
    """Begin a batch, kill it and its workers when so many cases are recorded; what is left, and what it took."""
    show(line)
    begun = time.perf_counter()
    words = [sys.executable, "-m", "mgsgraph", *line.split()]
    running = subprocess.Popen(words, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while len(entries()) < after and running.poll() is None:
        time.sleep(0.2)
    os.killpg(running.pid, signal.SIGKILL)
    running.wait()
    unfinished = len([path for path in Path("blocks").iterdir() if path.name.startswith(".")])
    note = f"killed (-9) with {len(entries())} groups recorded, {unfinished} half-written"
    return note, Took(time.perf_counter() - begun, np.nan, np.nan)  # workers that were killed told nobody their times


def found(groups: int, before: int, grown: int) -> list[str]:
    """Sentences: what the record says, and errors of the tie points against the truth."""
    last = {str(entry["case"]): entry for entry in entries()}
    truth, shares, metres = pyarrow.parquet.read_table("region/true_points.parquet").to_pydict(), [], []
    true = dict(zip(truth["point_id"], zip(*(truth[axis] for axis in _AXES), strict=True), strict=True))
    for entry in last.values():
        path = sorted(Path("blocks", str(entry["folder"]), "solutions").iterdir())[-1] / "points.csv"
        points = pyarrow.csv.read_csv(path).to_pydict()
        rows = [k for k, name in enumerate(points["id"]) if name in true and not points["rejected"][k]]
        for axis in range(3):
            of = np.array([points[_AXES[axis]][k] - true[points["id"][k]][axis] for k in rows])
            metres.append(of)
            shares.append(of / np.array([points[f"sigma_{_AXES[axis]}"][k] for k in rows]))
    sigma0 = [float(str(entry["sigma0"])) for entry in last.values()]
    states = sorted({str(entry["status"]) for entry in last.values()})
    counts = ", ".join(f"{sum(entry['status'] == state for entry in last.values())} {state}" for state in states)
    return [
        f"* {groups} groups: {counts}; the kill left {before} recorded, and later images changed {grown}.",
        f"* sigma0 of the groups: {min(sigma0):.2f} to {max(sigma0):.2f}, mean {np.mean(sigma0):.3f}.",
        f"* {sum(len(part) for part in metres) // 3} tie points against the truth: {rms(np.concatenate(metres)):.1f} m "
        f"rms in each coordinate, {rms(np.concatenate(shares)):.2f} stated sigmas.",
    ]  # fmt: skip


def draw(case: Path, times: list[float], before: int) -> None:
    """The region's images by group, the largest group, and the groups over time: docs/pictures/region.png."""
    figure = Figure((10.4, 3.6), layout="constrained")
    region, largest, course = figure.subplots(1, 3, width_ratios=(1.5, 0.8, 1.0))
    tables = decode(case)
    images = read_images(tables, tables.orientations, (), case)
    outlines = {image.name: map_degrees(footprint(image).outline) for image in images}
    members = [[image.name for image in decode(path).images] for path in sorted(Path("sites").glob("*/case.toml"))]
    for k, names in enumerate(members):
        middles = np.array([outlines[name].mean(axis=0) for name in names])
        region.plot(*middles.T, ".", color=f"C{k % 10}", markersize=3)
        region.annotate(str(len(names)), middles[0], (3, 2), textcoords="offset points", fontsize=5, color="0.3")
    for name in max(members, key=len):
        largest.plot(*outlines[name].T, color="C0", linewidth=0.6)
    hours = np.array(times) - times[0]
    course.step(hours, np.arange(1, len(times) + 1), where="post")
    course.axvline(hours[before - 1], color="C3", linewidth=1.0)
    course.annotate("killed", (hours[before - 1], before), (4, -10), textcoords="offset points", color="C3", fontsize=8)
    most = len(max(members, key=len))
    for axes, title in ((region, f"{len(images)} images, {len(members)} groups"), (largest, f"group of {most}")):
        axes.set(title=title, xlabel="longitude east (deg)", ylabel="latitude (deg)")
    largest.set_aspect(1.0 / np.cos(np.radians(largest.get_ylim()[0])))
    largest.tick_params(axis="x", rotation=60)
    course.set(title="the batch", xlabel="s since the first group was recorded", ylabel="groups recorded")
    figure.savefig(DOCS / "pictures" / "region.png", dpi=110)


if __name__ == "__main__":
    sys.exit(main())
