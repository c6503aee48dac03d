"""The whole workflow on a simulated archive, from the ids of two images to a terrain model, command by command.

The site's archives are written to a folder and served from localhost; then the commands of docs/archive_to_dem.md run
one after the other, each in a process of its own as a user types it. Seconds and peak memory of each are told, and
at the end the terrain model is compared with the truth, which is known here.

    python scripts/whole_road.py [--site gusev] [--seed 1] [--work FOLDER] [--out FILE]
"""

import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from study import at_least, command, table, work_and_page, write_page

from mgsgraph.simulation.site import SimulatedSite, simulate_site
from mgsgraph.simulation.sites import SITE_NAMES
from mgsgraph.units import DEG

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from flaky_archive import serving, write_archive

from mgsgraph.text import root_mean_square as rms

PAGE = "evidence_terrain.md#whole_road"
ROAD = (
    "fetch {images} --out DATA",
    "project init PROJECT --case DATA/case.toml",
    "match PROJECT",
    "project solve PROJECT",
    "report PROJECT --out report.html",
    "export PROJECT --to spice --out SPICE",
    "dem PROJECT --out DEM",
)
"""The commands; `fetch` also gets the mirror's address."""
_BANDS = (1, 2, 3)
"""Of dem.tif: height, its sigma, the share of matching in it, m."""
_SAMPLE, _NEAR, _ROUNDS = 20_000, 20.0, 5
"""Posts by which a terrain model is fitted to the truth, m between which slopes are taken, and iterations."""


class Step(NamedTuple):
    """A command that has run."""

    command: str
    seconds: float
    busy: float
    """s of processor time, both cores together."""
    megabytes: float
    """Peak memory of its process."""
    output: str


class Judged(NamedTuple):
    """A terrain model against the truth: heights in m."""

    posts: int
    error: float
    """rms."""
    mean: float
    sigma: float
    """rms of the stated sigma."""
    share: float
    """rms of the error over its stated sigma."""
    moved: np.ndarray
    """(3,) m east, north and up, its shift."""
    residual: float
    """rms, without the shift."""
    matching: float
    """rms of the stated sigma of matching."""


def main() -> int:
    """Entry point."""
    parser = command(__doc__)
    parser.add_argument("--site", choices=SITE_NAMES, default="gusev")
    parser.add_argument("--seed", type=at_least(0), default=1)
    work_and_page(parser, PAGE)
    options = parser.parse_args()

    def make() -> dict[str, list[str]]:
        with tempfile.TemporaryDirectory() as temporary:
            work, site = options.work or Path(temporary), simulate_site(options.site, options.seed)
            steps = workflow(site, work)
            judged = judge(work / "DEM" / "dem.tif", site)
        return {"commands": step_table(steps), "judged": words(judged), "said": report_lines(steps)}

    return write_page(parser, options.out, PAGE, make)


def commands(site: SimulatedSite) -> list[str]:
    """As a user types them."""
    images = " ".join(image.settings.name.replace("-", "/") for image in site.images)
    return [f"mgsgraph {command.format(images=images)}" for command in ROAD]


def workflow(site: SimulatedSite, work: Path) -> list[Step]:
    """Run all commands in the folder `work`, on the site's archives there."""
    archive = write_archive(site, work / "archive")
    with serving(archive) as address:
        steps = []
        for command in commands(site):
            more = ["--mirror", address] if " fetch " in command else []
            steps.append(step(command, more, work))
            print(f"$ {command}\n{steps[-1].output}", flush=True)
    return steps


def step(command: str, more: list[str], folder: Path) -> Step:
    """Run a command; the script ends with its status where it fails."""
    arguments = [sys.executable, "-m", *shlex.split(command), *more]
    begun = time.perf_counter()
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(arguments, cwd=folder, stdout=output, stderr=subprocess.STDOUT)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        text = output.read().decode()
    if process.returncode:
        sys.exit(f"{text}\n{command}: exit status {process.returncode}")
    busy = used.ru_utime + used.ru_stime
    return Step(command, time.perf_counter() - begun, busy, used.ru_maxrss / 1024.0, text.rstrip())


def judge(path: Path, site: SimulatedSite) -> Judged:
    """Heights of a terrain model above its sphere against the true ground at the same positions."""
    import rasterio
    from rasterio.warp import transform

    with rasterio.open(path) as file:
        height, sigma, matching = (file.read(band).astype(np.float64) for band in _BANDS)
        crs, place = file.crs, file.transform
    radius = float(crs.to_dict()["R"])
    valid = np.nonzero(np.isfinite(height))
    x, y = place * (valid[1] + 0.5, valid[0] + 0.5)

    def truth(east: np.ndarray, north: np.ndarray) -> np.ndarray:
        places = transform(crs, f"+proj=longlat +R={radius} +no_defs", east.tolist(), north.tolist())
        return site.terrain.ground_radius(*(np.array(values) * DEG for values in places)) - radius

    error = height[valid] - truth(x, y)
    some = np.random.default_rng(0).choice(x.size, min(x.size, _SAMPLE), replace=False)
    moved, residual = laid_on(truth, x[some], y[some], height[valid][some])
    return Judged(
        x.size, rms(error), float(error.mean()), rms(sigma[valid]), rms(error / sigma[valid]), moved, residual,
        rms(matching[valid][some]),
    )  # fmt: skip


def laid_on(
    truth: Callable[[np.ndarray, np.ndarray], np.ndarray], x: np.ndarray, y: np.ndarray, heights: np.ndarray
) -> tuple[np.ndarray, float]:
    """Shift (3,) of heights against the truth, and the rms of the residuals, m.

    Tilts and a curvature along the flight are removed from the residuals, too: orientation polynomials of order 2.
    """
    along, across = y / np.abs(y).max(), x / np.abs(x).max()
    shape = np.column_stack([np.ones_like(x), along, across, along**2, along * across])
    moved, level, off = np.zeros(2), np.zeros(shape.shape[1]), heights
    for _ in range(_ROUNDS):
        shifted = np.column_stack([x, y]) - moved
        slopes = [
            (truth(*(shifted + step).T) - truth(*(shifted - step).T)) / (2.0 * _NEAR) for step in _NEAR * np.eye(2)
        ]
        off, design = heights - truth(*shifted.T), np.column_stack([shape, *(-slope for slope in slopes)])
        level, more = np.split(np.linalg.lstsq(design, off)[0], [shape.shape[1]])
        moved = moved + more
    return np.array([*moved, level[0]]), rms(off - shape @ level)


def step_table(steps: list[Step]) -> list[str]:
    """Time and memory of each command."""
    parts = [(f"`{step.command}`", step.seconds, step.busy, step.megabytes) for step in steps]
    _, seconds, busy, megabytes = zip(*parts, strict=True)
    parts.append(("all of it", sum(seconds), sum(busy), max(megabytes)))
    rows = [[name, *(f"{value:.0f}" for value in values)] for name, *values in parts]
    return table(("command", "seconds", "of a processor", "peak memory, MB"), rows)


def words(judged: Judged) -> list[str]:
    east, north, up = judged.moved
    return [
        f"* Height error at {judged.posts} posts: {judged.error:.2f} m rms (mean {judged.mean:+.2f} m); stated sigma: "
        f"{judged.sigma:.2f} m rms; error over sigma: {judged.share:.2f} rms.",
        "* Most of that is common to neighbouring posts, as the orientation's share of the sigma says: the model lies "
        f"{east:+.0f} m east, {north:+.0f} m north and {up:+.1f} m up of the truth. Without that, tilts and a bend "
        f"along the flight {judged.residual:.2f} m rms are left; stated sigma of matching: {judged.matching:.2f} m.",
    ]


def report_lines(steps: list[Step]) -> list[str]:
    """Lines that `match` and `dem` printed."""
    outputs = {step.command.split()[1]: step.output.splitlines() for step in steps}
    return [f"* *{verb}*: {line[2:]}" for verb in ("match", "dem") for line in outputs[verb] if line.startswith("- ")]


if __name__ == "__main__":
    sys.exit(main())
