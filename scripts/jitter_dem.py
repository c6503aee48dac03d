"""Pictures of a camera that vibrates, to terrain models: is the ripple gone that vibrations make in heights?

A CTX pair (`tests/ctx_pair.py`, second image 22 degrees aside) is rendered by its true orientations, with 0.5 px at 2
Hz in pitch and roll and a drift of 3 px that its support data don't have; control is a terrain model of 463 m posts. By
the commands `match`, `adjust` and `dem` with orientations as polynomials of degree 3 (before), then `adjust` and `dem`
with a slow process and vibrations = "estimated" (after); both models are held against the ground. Rewrites the made
parts of docs/evidence_terrain.md.
"""

import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from study import at_least, command, table, work_and_page, write_page
from whole_road import step

from mgsgraph.geometry.records import Array
from mgsgraph.simulation.case_files import image_file, json_text, support_data
from mgsgraph.simulation.files import write_texts
from mgsgraph.simulation.imagery import render
from mgsgraph.simulation.mola_files import MegdrLayout, write_megdr
from mgsgraph.text import root_mean_square
from mgsgraph.units import DEG, MRAD

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from ctx_pair import PIXEL, CtxSettings, SimulatedCtxPair, image_times, simulate_ctx_pair

PAGE = "evidence_terrain.md#jitter_dem"
FREQUENCY, BAND = 2.0, 0.25
"""Hz of the vibration; and what share of it to either side counts as its ripple."""
_BIN = 16
"""Lines whose height errors are averaged."""
_SUN = 0.9
"""rad, of the Sun from the zenith, in the west."""
_CELLS, _SPACING = 8000, 80.0
"""For ties, two to a post of control; m between matches of the terrain model."""
_NEAR, _ROUNDS = 20.0, 4
"""m between which the ground's slopes are taken; rounds in which a model is fitted to the ground."""
CASES = {"before": "polynomials of degree 3", "after": "slow process and vibrations"}


class Judged(NamedTuple):
    """A terrain model against the ground."""

    errors: Array
    """(n,) m, of heights."""
    rest: Array
    """(n,) m, without displacements that are cubic polynomials of time."""
    sigmas: Array
    """(n,) m, stated."""
    ripple: float
    """m, amplitude about the frequency along the flight."""


def write_pair(pair: SimulatedCtxPair, folder: Path) -> None:
    """Support data, pictures and terrain model."""
    assert pair.network.surface is not None
    images, grid = pair.network.images, pair.network.surface.grid
    write_texts(folder, {image_file(image): json_text(support_data(image)) for image in images})
    zenith = pair.true_points.mean(axis=0) / np.linalg.norm(pair.true_points.mean(axis=0))
    east = np.cross([0.0, 0.0, 1.0], zenith)
    sun = np.cos(_SUN) * zenith - np.sin(_SUN) * east / np.linalg.norm(east)
    for k, (image, true) in enumerate(zip(images, pair.truth, strict=True)):
        picture = render(image, pair.terrain, true.correction, sun, np.random.default_rng([23, k]), between=8)
        cv2.imwrite(str(folder / f"{image.name[-1]}.png"), picture)
    layout = MegdrLayout(grid.radii.shape, grid.first_longitude, grid.first_latitude, grid.longitude_step, 3396000.0)
    write_megdr(folder, "megr", layout, [np.asarray(grid.radii, dtype=np.float64)])


def case(pair: SimulatedCtxPair, settings: CtxSettings, name: str) -> str:
    """A case file."""
    jitter, (first, last) = settings.jitter, image_times(pair.network.images[0])
    angle, drift = jitter.angle / MRAD, jitter.drift * PIXEL / MRAD
    slow = f"[{drift:.4f}, {drift:.4f}, 0.0001]"
    attitude = {
        "before": f"degree = 3\nsigmas_mrad = [{angle}, {slow}, {slow}, {slow}]",
        "after": f'model = "matern-5/2"\nsigma_mrad = {slow}\ncorrelation_time_s = {0.4 * (last - first):.2f}\n'
                 f"bias_sigma_mrad = {angle}",
    }[name]  # fmt: skip
    assert settings.control is not None
    lines = ["format = 1", 'name = "CTX pair that vibrates"', "[terrain]", 'radius = "megr.lbl"',
             f"vertical_sigma_m = {settings.control.vertical}", f"planimetric_sigma_m = {settings.control.planimetric}",
             "[orientation]", f"position_sigma_m = {jitter.position}", f"angle_sigma_mrad = {angle}",
             "degree = 0"]  # fmt: skip
    for image in pair.network.images:
        lines += ["[[images]]", f'name = "{image.name}"', f'isd = "{image_file(image)}"',
                  f'pixels = "{image.name[-1]}.png"', "[[passes]]", f'name = "{image.name}"',
                  f'images = ["{image.name}"]', 'vibrations = "estimated"' if name == "after" else "",
                  "[passes.position]", "degree = 0", f"sigmas_m = [{jitter.position}]", "[passes.attitude]",
                  attitude]  # fmt: skip
    return "\n".join([*lines, ""])


def judge(path: Path, pair: SimulatedCtxPair) -> Judged:
    """Heights of a model against the ground at the same places."""
    import rasterio
    from rasterio.warp import transform

    with rasterio.open(path) as file:
        height, sigma = (file.read(band).astype(np.float64) for band in (1, 2))
        crs, place = file.crs, file.transform
    radius, valid = float(crs.to_dict()["R"]), np.nonzero(np.isfinite(height))
    plane, heights = np.column_stack(place * (valid[1] + 0.5, valid[0] + 0.5)), height[valid]

    def lon_lat(at: Array) -> list[Array]:
        converted = transform(crs, f"+proj=longlat +R={radius} +no_defs", at[:, 0].tolist(), at[:, 1].tolist())
        return [np.array(values) * DEG for values in converted]

    def truth(at: Array) -> Array:
        return np.asarray(pair.terrain.ground_radius(*lon_lat(at)) - radius)

    image = pair.network.images[0]
    pixels = image.ground_to_image(pair.terrain.on_ground(*lon_lat(plane)), pair.truth[0].correction)[0]
    u, across = 2.0 * pixels[:, 0] / image.lines - 1.0, 2.0 * pixels[:, 1] / image.samples - 1.0
    powers = np.polynomial.legendre.legvander(u, 3)
    level, moved = np.column_stack([powers, across[:, None] * powers, across**2]), np.zeros((4, 2))
    for _ in range(_ROUNDS):
        shifted = plane - powers @ moved
        slopes = [(truth(shifted + by) - truth(shifted - by)) / (2.0 * _NEAR) for by in _NEAR * np.eye(2)]
        off, design = heights - truth(shifted), np.column_stack([level, *(-powers * s[:, None] for s in slopes)])
        solution = np.linalg.lstsq(design, off)[0]
        moved = moved + solution[level.shape[1] :].reshape(2, 4).T
    rest = off - level @ solution[: level.shape[1]]
    return Judged(heights - truth(plane), rest, sigma[valid], ripple(pixels[:, 0], rest, image.timing.periods[0]))


def ripple(lines: Array, errors: Array, period: float) -> float:
    """m, amplitude of means over lines in a band about the frequency: root of twice the power, so that of a sine it is
    its amplitude.
    """
    row = np.floor(lines / _BIN).astype(np.int64)
    row -= row.min()  # ground at the edge may lie before the first line
    count = np.bincount(row)
    times, mean = np.flatnonzero(count) * _BIN * period, np.bincount(row, errors)[count > 0] / count[count > 0]
    once = 1.0 / np.ptp(times)
    low, high = np.ceil((1.0 - BAND) * FREQUENCY / once), np.floor((1.0 + BAND) * FREQUENCY / once)
    phase = 2.0 * np.pi * once * np.arange(low, high + 1.0)[:, None] * times
    return float(np.sqrt(np.sum((2.0 / times.size * np.stack([np.cos(phase) @ mean, np.sin(phase) @ mean])) ** 2)))


def main() -> int:
    """Entry point."""
    parser = command(__doc__)
    parser.add_argument("--seed", type=at_least(0), default=201)
    parser.add_argument("--lines", type=at_least(1000), default=6000)
    parser.add_argument("--samples", type=at_least(300), default=5000)
    work_and_page(parser, PAGE)
    options = parser.parse_args()

    def make() -> dict[str, list[str]]:
        began, settings = time.perf_counter(), CtxSettings(lines=options.lines, samples=options.samples, ties=1500)
        pair = simulate_ctx_pair(settings, options.seed)
        with tempfile.TemporaryDirectory() as temporary:
            work = options.work or Path(temporary)
            write_pair(pair, work)
            for name in CASES:
                (work / f"{name}.toml").write_text(case(pair, settings, name), encoding="utf-8")
            steps = [step(f"mgsgraph match before.toml --out MATCHES --cells {_CELLS} --no-figures", [], work)]
            for name in CASES:
                steps.append(step(f"mgsgraph adjust {name}.toml --ties MATCHES/network.pvl --out {name}", [], work))
                dense = f"--case {name}.toml --out DEM_{name} --spacing {_SPACING} --no-figures"
                steps.append(step(f"mgsgraph dem {name} {dense}", [], work))
            for done in steps:
                print(f"$ {done.command}    # {done.seconds:.0f} s\n{done.output}", file=sys.stderr)
            judged = {name: judge(work / f"DEM_{name}" / "dem.tif", pair) for name in CASES}
        rows = [[CASES[name], str(j.errors.size), f"{j.ripple:.2f}",
                 *(f"{root_mean_square(of):.2f}" for of in (j.rest, j.errors, j.sigmas, j.errors / j.sigmas))]
                for name, j in judged.items()]  # fmt: skip
        head = ("orientation", "posts", "ripple at 2 Hz, m", "error without shift and cubic, m rms", "error, m rms",
                "stated sigma, m rms", "error by sigma")  # fmt: skip
        share = judged["before"].ripple / judged["after"].ripple
        sentence = f"The ripple is cut {share:.1f} times. {time.perf_counter() - began:.0f} s in all."
        return {"dem": [*table(head, rows), "", sentence]}

    return write_page(parser, options.out, PAGE, make)


if __name__ == "__main__":
    sys.exit(main())
