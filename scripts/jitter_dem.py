"""Pictures of a camera that jitters, to terrain models: is the ripple that jitter makes in heights gone?

A CTX pair (`simulation.ctx`, second image 22 degrees aside) is rendered through its true orientations, with 0.5 px at 2
Hz in pitch and roll and a drift of 3 px that its support data don't have; control is a terrain model of 463 m posts. By
the commands `match`, `adjust` (orientations as polynomials of degree 3), `analyze` (which frequencies), `adjust` (slow
process and vibrations of these frequencies, strengths estimated), and `dem` of both; both are held against the ground.

    python scripts/jitter_dem.py [--seed 201] [--lines 6000] [--samples 600] [--work FOLDER] [--figure FILE]

Prints a table; writes docs/jitter_dem.png by default. Exit status: 0 done, 2 bad input.
"""

import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import dem_truth
import numpy as np
from study import DOCS, at_least, command, show, status, table

from mgsgraph.analysis.residual_spectrum import residual_vibrations
from mgsgraph.geometry.records import Array
from mgsgraph.results.archive import read_solution
from mgsgraph.simulation.case_files import image_file, json_text, support_data
from mgsgraph.simulation.ctx import (
    PIXEL,
    CtxSettings,
    DenseTruth,
    SimulatedCtxPair,
    image_times,
    ripple,
    simulate_ctx_pair,
)
from mgsgraph.simulation.files import write_texts
from mgsgraph.simulation.imagery import render
from mgsgraph.simulation.mola_files import MegdrLayout, write_megdr
from mgsgraph.text import root_mean_square as rms
from mgsgraph.units import MRAD

FREQUENCY = 2.0
_BETWEEN = 8
"""px between rays of the rendering: 33 in a period of 2 Hz."""
_BIN = 16
"""Lines whose heights are one mean."""
_SUN = 0.9
"""rad, of the Sun from the zenith, in the west."""
_NEAR = 20.0
"""m between which the ground's slopes are taken."""
_MATCH = ("--cells", "1500", "--no-figures")
WAYS = {"before": "polynomials of degree 3", "after": "slow process and vibrations"}


class Judged(NamedTuple):
    """A terrain model against the truth."""

    dense: DenseTruth
    """Where its posts are in the first image."""
    heights: Array
    """(n,) m, height errors at the posts."""
    left: Array
    """(n,) m, the same without shifts of the model and height errors that are polynomials of degree 3 of time."""
    sigmas: Array
    """(n,) m, stated."""

    @property
    def ripple(self) -> float:
        """m, amplitude about 2 Hz along the flight."""
        return ripple(self.dense, self.left, FREQUENCY)


# --- files of the pair


def write_pair(mine: SimulatedCtxPair, folder: Path) -> None:
    """Support data, pictures and terrain model."""
    images, grid = mine.network.images, mine.network.surface.grid  # type: ignore[union-attr]
    write_texts(folder, {image_file(one): json_text(support_data(one)) for one in images})
    zenith = mine.true_points.mean(axis=0)
    zenith /= np.linalg.norm(zenith)
    east = np.cross([0.0, 0.0, 1.0], zenith)
    sun = np.cos(_SUN) * zenith - np.sin(_SUN) * east / np.linalg.norm(east)
    for k, (image, true) in enumerate(zip(images, mine.corrections, strict=True)):
        rng = np.random.default_rng([mine.seed, 23, k])
        picture = render(image, mine.terrain, true, sun, rng, between=_BETWEEN)
        cv2.imwrite(str(folder / picture_file(image.name)), picture)
    layout = MegdrLayout(grid.radii.shape, grid.first_longitude, grid.first_latitude, grid.longitude_step, 3396000.0)
    write_megdr(folder, "megr", layout, [np.asarray(grid.radii, dtype=np.float64)])


def picture_file(name: str) -> str:
    return f"{name.rsplit('/', 1)[-1]}.png"


def case(mine: SimulatedCtxPair, attitude: str) -> str:
    """The case, with what is known of each pass's attitude beforehand."""
    lines, jitter = ["format = 1", 'name = "CTX pair with jitter"'], mine.settings.jitter
    for image in mine.network.images:
        name = image.name
        lines += ["[[images]]", f'name = "{name}"', f'isd = "{image_file(image)}"', f'pixels = "{picture_file(name)}"']
    angle = float(np.hypot(jitter.angle, jitter.drift * PIXEL)) / MRAD
    lines += ["[orientation]", f"position_sigma_m = {jitter.position}", f"angle_sigma_mrad = {angle:.4f}", "degree = 0"]
    control = mine.settings.control
    assert control is not None
    lines += ["[terrain]", 'radius = "megr.lbl"', f"vertical_sigma_m = {control.vertical}"]
    lines += [f"planimetric_sigma_m = {control.planimetric}"]
    for image in mine.network.images:
        lines += ["[[passes]]", f'name = "{image.name}"', f'images = ["{image.name}"]']
        lines += ["[passes.position]", "degree = 0", f"sigmas_m = [{jitter.position}]", "[passes.attitude]", attitude]
    return "\n".join([*lines, ""])


def polynomial(mine: SimulatedCtxPair) -> str:
    """Of degree 3; only constant errors of yaw."""
    angle, drift = mine.settings.jitter.angle / MRAD, mine.settings.jitter.drift * PIXEL / MRAD
    return f"degree = 3\nsigmas_mrad = [{angle:.4f}, " + ", ".join(3 * [f"[{drift:.4f}, {drift:.4f}, 0.0001]"]) + "]"


def process(mine: SimulatedCtxPair, frequencies: list[float]) -> str:
    """A slow process and vibrations, strengths estimated."""
    angle, drift = mine.settings.jitter.angle / MRAD, mine.settings.jitter.drift * PIXEL / MRAD
    first, last = image_times(mine.network.images[0])
    plus = ", ".join(
        f'{{ model = "jitter", sigma_mrad = "estimated", frequency_hz = {one:.4f}, '
        f"bandwidth_hz = {0.5 / (last - first):.4f} }}"
        for one in frequencies
    )
    return (
        f'model = "matern-3/2"\nsigma_mrad = "estimated"\ncorrelation_time_s = {0.25 * (last - first):.2f}\n'
        f"bias_sigma_mrad = {angle:.4f}\ndrift_sigma_mrad = [{drift:.4f}, {drift:.4f}, 0.0001]\nplus = [{plus}]"
    )


# --- the road


def run(arguments: list[str], folder: Path) -> float:
    """Run a command in a folder; its seconds. What it says is printed."""
    show(f"mgsgraph {arguments[0]}")
    begun = time.perf_counter()
    done = subprocess.run([sys.executable, "-m", "mgsgraph", *arguments], cwd=folder, capture_output=True, text=True)
    seconds = time.perf_counter() - begun
    print(f"$ mgsgraph {' '.join(arguments)}    # {seconds:.0f} s\n{done.stdout}{done.stderr}", file=sys.stderr)
    if done.returncode:
        sys.exit(f"{arguments[0]}: exit status {done.returncode}")
    return seconds


def frequencies(folder: Path) -> list[float]:
    """Hz, of vibrations that the residuals of an adjustment show, each once."""
    kept = list[float]()
    solution = read_solution(folder)
    for one in residual_vibrations(solution).vibrations:
        print(one.words, file=sys.stderr)
        if all(abs(one.frequency - other) > 0.125 for other in kept):
            kept.append(one.frequency)
    return kept


def road(mine: SimulatedCtxPair, folder: Path) -> tuple[list[float], list[list[str]]]:
    """All commands; frequencies found, and command and seconds of each."""
    write_pair(mine, folder)
    (folder / "before.toml").write_text(case(mine, polynomial(mine)), encoding="utf-8")
    seconds = [["match", run(["match", "before.toml", "--out", "MATCHES", *_MATCH], folder)]]
    found = list[float]()
    for way in WAYS:
        if way == "after":
            run(["analyze", "before", "--unexplained"], folder)
            found = frequencies(folder / "before")
            (folder / "after.toml").write_text(case(mine, process(mine, found)), encoding="utf-8")
        ties = ["--ties", "MATCHES/network.pvl", "--out", way]
        seconds += [[f"adjust, {way}", run(["adjust", f"{way}.toml", *ties], folder)]]
        made = ["--case", f"{way}.toml", "--out", f"DEM_{way}", "--no-figures"]
        seconds += [[f"dem, {way}", run(["dem", way, *made], folder)]]
    return found, [[str(name), f"{took:.0f}"] for name, took in seconds]


# --- against the truth


def judge(path: Path, mine: SimulatedCtxPair) -> Judged:
    """Heights of a terrain model against the ground at the same places; posts by their line in the first image."""
    import rasterio
    from rasterio.warp import transform

    with rasterio.open(path) as file:
        height, sigma = (file.read(band).astype(np.float64) for band in (1, 2))
        crs, place = file.crs, file.transform
    radius = float(crs.to_dict()["R"])
    known = np.nonzero(np.isfinite(height))
    plane = np.column_stack(place * (known[1] + 0.5, known[0] + 0.5))
    heights, geographic = height[known], f"+proj=longlat +R={radius} +no_defs"

    def lon_lat(at: Array) -> tuple[Array, Array]:
        lon, lat = transform(crs, geographic, at[:, 0].tolist(), at[:, 1].tolist())
        return np.deg2rad(lon), np.deg2rad(lat)

    def truth(at: Array) -> Array:
        return np.asarray(mine.terrain.ground_radius(*lon_lat(at)) - radius)

    def slopes(at: Array) -> Array:
        ways = [(at + step, at - step) for step in _NEAR * np.eye(2)]
        return np.column_stack([(truth(ahead) - truth(behind)) / (2.0 * _NEAR) for ahead, behind in ways])

    points, image = mine.terrain.on_ground(*lon_lat(plane)), mine.network.images[0]
    pixels = image.ground_to_image(points, mine.corrections[0])[0]
    row = np.floor(pixels[:, 0] / _BIN)
    lines = (np.arange(row.max() + 1.0) + 0.5) * _BIN
    u, across = 2.0 * pixels[:, 0] / image.lines - 1.0, 2.0 * pixels[:, 1] / image.samples - 1.0
    powers = np.polynomial.legendre.legvander(u, 3)
    surface = np.column_stack([powers, across[:, None] * powers[:, :3], across**2])
    fine = partial(dem_truth.laid_on, truth, slopes)(plane, heights, powers, surface)[2]
    dense = DenseTruth(image.timing.at(lines)[0], pixels, pixels, points, row)
    return Judged(dense, heights - truth(plane), fine, sigma[known])


def rows(judged: dict[str, Judged]) -> list[list[str]]:
    """Of the table."""
    return [
        [WAYS[way], str(one.heights.size), f"{one.ripple:.2f}", f"{rms(one.left):.2f}", f"{rms(one.heights):.2f}",
         f"{rms(one.sigmas):.2f}", f"{rms(one.heights / one.sigmas):.2f}"]
        for way, one in judged.items()
    ]  # fmt: skip


HEAD = (
    "orientation", "posts", "ripple at 2 Hz, m", "error without shift and cubic, m rms", "error, m rms",
    "stated sigma, m rms", "error by sigma",
)  # fmt: skip


def draw(judged: dict[str, Judged], mine: SimulatedCtxPair, path: Path) -> None:
    """Maps of what is left of height errors, and their means along the flight."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 7.0), layout="constrained")
    *maps, below = figure.subplots(3, 1, sharex=True, height_ratios=[1.0, 1.0, 1.6])
    samples, lines = mine.settings.samples, mine.settings.lines
    points = next(iter(judged.values())).dense
    order = np.argsort(points.first[:, 0])
    first, last = order[0], order[-1]
    km = float(np.linalg.norm(points.points[last] - points.points[first])) / 1e3
    km /= float(points.first[last, 0] - points.first[first, 0])
    limit = float(np.quantile(np.abs(judged["before"].left), 0.98))
    edges = [np.arange(0.0, lines + 16.0, 16.0), np.arange(0.0, samples + 16.0, 16.0)]
    for axes, (way, one) in zip(maps, judged.items(), strict=True):
        total, count = (
            np.histogram2d(one.dense.first[:, 0], one.dense.first[:, 1], edges, weights=weights)[0]
            for weights in (one.left, None)
        )
        mean = np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)
        shown = axes.pcolormesh(km * edges[0], km * edges[1], mean.T, cmap="RdBu_r", vmin=-limit, vmax=limit)
        axes.set(ylabel="across (km)", title=f"{way}: {WAYS[way]}; ripple {one.ripple:.2f} m")
        row = one.dense.row.astype(np.int64)
        n = np.bincount(row)
        below.plot(km * (np.arange(n.size) + 0.5) * _BIN, np.bincount(row, one.left) / np.maximum(n, 1), label=way)
    figure.colorbar(shown, ax=maps, label="height error (m)")
    below.set(xlabel="along the flight (km)", ylabel="mean height error (m)")
    below.legend()
    below.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def main() -> int:
    """Entry point."""
    parser = command(__doc__)
    parser.add_argument("--seed", type=at_least(0), default=201)
    parser.add_argument("--lines", type=at_least(1000), default=6000)
    parser.add_argument("--samples", type=at_least(300), default=600)
    parser.add_argument("--work", type=Path, help="folder to keep everything in; a temporary one when absent")
    parser.add_argument("--figure", type=Path, default=DOCS / "jitter_dem.png")
    given = parser.parse_args()

    def job() -> None:
        mine = simulate_ctx_pair(CtxSettings(lines=given.lines, samples=given.samples, ties=1500), given.seed)
        with tempfile.TemporaryDirectory() as aside:
            work = given.work or Path(aside)
            found, seconds = road(mine, work)
            judged = {way: judge(work / f"DEM_{way}" / "dem.tif", mine) for way in WAYS}
        draw(judged, mine, given.figure)
        told = ", ".join(f"{one:.3f} Hz" for one in found) or "none"
        print("\n".join([f"Frequencies found: {told}.", "", *table(HEAD, rows(judged)), ""]))
        print("\n".join(table(("command", "seconds"), seconds)))

    return status(parser.prog, job)


if __name__ == "__main__":
    sys.exit(main())
