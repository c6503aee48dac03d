"""Seconds and bytes against the number of points and of images: chains like the peer's, fitted exponents, a picture."""

import os
import tempfile
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import benchmark_speed as speed
import numpy as np
from peer_blocks import chain
from peer_problem import write_problem
from study import (
    DOCS,
    OneLine,
    at_least,
    machine,
    number,
    require_writable,
    show,
    table,
    write_figure,
    write_json,
    write_page,
)

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array

POINTS = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
IMAGES = (2, 5, 10, 20, 50, 100, 200, 500)
FIXED_IMAGES, FIXED_POINTS = 20, 100_000
"""Images while points grow, tie points while images do."""
SHOTS = 25
"""Laser shots of each image: few, so that points are what is counted."""
LARGE = 10_000
"""Exponents are fitted from so many points on: below, the fixed cost of an iteration shows."""
KEYS = ("seconds_set_up", "seconds_solve", "seconds_per_iteration", "seconds_covariance")
HEAD = """# How time and memory grow

Chains of image pairs like the peer's, {shots} laser shots an image, made by `scripts/benchmark.py scaling`; medians
of {repeat} runs, each a process of its own, {threads} threads. {machine}. Exponent: slope of the logarithms.
"""


@dataclass(frozen=True, slots=True)
class Row:
    """Medians for one chain."""

    swept: str
    """points or images."""
    images: int
    points: int
    observations: int
    iterations: float
    seconds_set_up: float
    seconds_solve: float
    seconds_per_iteration: float
    seconds_covariance: float
    bytes_per_observation: float


def sweep(wanted: Namespace) -> list[Row]:
    """Both sweeps, up to the largest sizes asked for."""
    most, chains = wanted.most_points, [("points", FIXED_IMAGES, ties) for ties in POINTS if ties <= wanted.most_points]
    chains += [("images", images, min(FIXED_POINTS, most)) for images in IMAGES if images <= wanted.most_images]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for swept, images, ties in chains:
            show(f"{images} images, {ties} ties")
            path = Path(folder, "chain.bin")
            write_problem(chain(images, ties, shots=SHOTS)[0], path)
            runs = [speed.ours(path, wanted.line, wanted.threads) for _ in range(wanted.repeat)]
            rows.append(row_of(swept, runs))
    return rows


def row_of(swept: str, runs: Sequence[dict[str, Any]]) -> Row:
    """Medians of the runs of one chain."""
    for one in runs:
        if not one["converged"]:
            raise InputError(f"chain of {one['images']} images", "did not converge", one["message"])
    counts = [int(runs[0][key]) for key in ("images", "points", "observations")]
    keys = ("iterations", *KEYS, "bytes_per_observation")
    return Row(swept, *counts, *(median(float(one.get(key, np.nan)) for one in runs) for key in keys))


def exponent(sizes: Array, seconds: Array) -> float:
    """Slope of the logarithms; NaN for fewer than two sizes, or where a stage wasn't timed."""
    if sizes.size < 2 or not np.all(seconds > 0.0):
        return float("nan")
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def series(rows: Sequence[Row], swept: str, key: str, least: int = 0) -> tuple[Array, Array]:
    """Sizes (points or images) and a figure of one sweep, from `least` on."""
    mine = [row for row in rows if row.swept == swept and getattr(row, swept) >= least]
    return np.array([float(getattr(row, swept)) for row in mine]), np.array([float(getattr(row, key)) for row in mine])


def marginal_bytes(rows: Sequence[Row]) -> float:
    """Bytes by which each further observation raises the highest memory, over the large chains of the points' sweep."""
    mine = [row for row in rows if row.swept == "points" and row.points >= LARGE]
    if len(mine) < 2:
        return float("nan")
    count = np.array([float(row.observations) for row in mine])
    return float(np.polyfit(count, count * np.array([row.bytes_per_observation for row in mine]), 1)[0])


def page(rows: Sequence[Row], repeat: int, threads: int) -> str:
    """Both tables and the exponents."""
    head = ("images", "points", "observations", "iterations", *KEYS, "bytes per observation")
    parts = [HEAD.format(shots=SHOTS, repeat=repeat, threads=threads, machine=machine())]
    for swept, least in (("points", LARGE), ("images", 0)):
        mine = [row for row in rows if row.swept == swept]
        cells = [
            (f"{row.images}", f"{row.points:,}", f"{row.observations:,}", f"{row.iterations:g}",
             *(number(getattr(row, key)) for key in KEYS), f"{row.bytes_per_observation:.0f}")
            for row in mine
        ]  # fmt: skip
        fitted = "; ".join(
            f"{key.removeprefix('seconds_').replace('_', ' ')} {number(exponent(*series(rows, swept, key, least)))}"
            for key in KEYS
        )
        since = f" from {least:,} on" if least else ""
        parts += [f"## Against the number of {swept}", "", *table([one.replace("_", " ") for one in head], cells), ""]
        parts += [f"Exponents against {swept}{since}: {fitted}.", ""]
    parts += [f"Each further observation takes {marginal_bytes(rows):.0f} bytes beside the input.", ""]
    return "\n".join([*parts, "![time and memory against size](scaling.png)", ""])


def as_record(rows: Sequence[Row]) -> dict[str, Any]:
    """For JSON; what could not be fitted is left out."""
    fitted = {
        f"{swept}: {key}": exponent(*series(rows, swept, key, least))
        for swept, least in (("points", LARGE), ("images", 0))
        for key in KEYS
    }
    fitted["bytes of a further observation"] = marginal_bytes(rows)
    finite = {name: value for name, value in fitted.items() if np.isfinite(value)}
    return {"rows": [asdict(row) for row in rows], "exponents": finite}


def draw(rows: Sequence[Row], path: Path) -> None:
    """Three panels: seconds against points and against images, bytes against points."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.0, 4.2), layout="constrained")
    first, second, third = figure.subplots(1, 3)
    for axes, swept, least in ((first, "points", LARGE), (second, "images", 0)):
        for key in KEYS:
            sizes, seconds = series(rows, swept, key)
            slope = exponent(*series(rows, swept, key, least))
            name = key.removeprefix("seconds_").replace("_", " ")
            axes.loglog(sizes, seconds, "o-", label=name if np.isnan(slope) else f"{name}, exponent {slope:.2f}")
        axes.set(xlabel=f"number of {swept}", ylabel="seconds")
        axes.legend(fontsize=8)
    first.set_title(f"{FIXED_IMAGES} images; exponents from {LARGE:,} points on", fontsize=9)
    second.set_title(f"{FIXED_POINTS:,} tie points", fontsize=9)
    images = sorted({row.images for row in rows if row.swept == "images"})
    second.set_xticks(images, map(str, images))
    second.set_xticks([], minor=True)  # their labels would run into each other
    third.semilogx(*series(rows, "points", "bytes_per_observation"), "o-")
    third.axhline(300.0, color="grey", linestyle="--", linewidth=1.0, label="required: below 300")
    third.set(xlabel="number of points", ylabel="bytes per observation beside the input", ylim=(0.0, None))
    third.set_yscale("symlog", linthresh=300.0)
    third.legend(fontsize=8)
    write_figure(figure, path)


def main(parser: OneLine, given: list[str]) -> int:
    """`benchmark.py scaling`."""
    speed.common_options(parser)
    parser.add_argument("--most-points", type=at_least(1000), default=1_000_000)
    parser.add_argument("--most-images", type=at_least(2), default=500)
    parser.add_argument("--out", type=Path, default=DOCS, help="folder for scaling.md and scaling.png")
    wanted = parser.parse_args(given)
    os.environ["NUMBA_NUM_THREADS"] = str(wanted.threads)  # before anything imports numba

    def text() -> str:
        require_writable(wanted.json)
        figures = sweep(wanted)
        draw(figures, wanted.out / "scaling.png")
        if wanted.json:
            write_json(as_record(figures), wanted.json)
        return page(figures, wanted.repeat, wanted.threads)

    return write_page(parser, wanted.out / "scaling.md", text)
