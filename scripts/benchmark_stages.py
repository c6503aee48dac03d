"""Nanoseconds that a point spends in each stage of a sweep: one tile, over and over, one thread, as the sweep compiles
it. The tile is that of the largest group of points with so many rays in a chain like the peer's (`peer_blocks.chain`).
A stage alone finds its registers in the processor's cache: the stages added up are less than a sweep takes.
"""

import time
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from peer_blocks import chain
from peer_problem import network
from study import OneLine, require_writable, status, table, write_text

from mgsgraph.errors import InputError

_REPEATS, _TRIES = 300, 7


class Tile(NamedTuple):
    """A solved tile, and buffers for what comes of it."""

    rows: Any
    groups: Any
    target: Any
    model: Any
    x: np.ndarray
    scratch: Any
    piece: int
    points: np.ndarray
    blocks: np.ndarray
    gradient: np.ndarray


def solved_tile(line: str, rays: int) -> Tile:
    """The first tile of the largest piece of points with so many rays and nothing else."""
    from mgsgraph.adjustment.graph import lay_out
    from mgsgraph.kernel.rows import IMAGE
    from mgsgraph.kernel.sweep import scratch_for, with_frozen_terrain

    layout = lay_out(*network(chain(6, 9000)[0], line))  # type: ignore[arg-type]
    rows, target = with_frozen_terrain(layout.rows), layout.blocks.target
    wanted = [
        set(rows.observation_kind[a:b].tolist()) == {IMAGE} and b - a == rays
        for a, b in zip(rows.pattern_observation, rows.pattern_observation[1:], strict=False)
    ]
    sizes = np.where(np.array(wanted)[rows.piece[:, 0]], rows.piece[:, 2], 0)
    if sizes.max() == 0:
        raise InputError("--sights", f"no points with {rays} rays", "2 or 3")
    buffers = np.zeros(target.size), np.zeros(target.columns)
    piece = int(np.argmax(sizes))
    x = np.zeros(layout.columns)
    return Tile(rows, layout.groups, target, layout.model, x, scratch_for(rows), piece, rows.start.copy(), *buffers)


def stages() -> dict[str, Callable[..., Any]]:
    """Each stage as a compiled loop over (tile, count of segments, times)."""
    from numba import njit

    from mgsgraph.kernel import elimination, measurements, tile
    from mgsgraph.kernel.lanes import COUPLED, PAIR, TILE, WIDTH, blocks_of, coupling_of, registers, transposed_of

    compiled = njit(fastmath={"contract", "nsz"}, error_model="numpy")

    @compiled
    def load(t, times):
        for _ in range(times):
            count, _, _ = tile.fill(t.rows, t.piece, 0, t.piece + 1, t.scratch.segments)
            w = registers(t.scratch.work)
            tile.load(t.rows, t.model, t.scratch.segments, count, w, t.scratch.depth, t.points)

    @compiled
    def all_rows(t, times):
        w = registers(t.scratch.work)
        for _ in range(times):
            measurements.all_rows(t.rows, t.model, False, t.scratch.segments, 1, t.x, w, t.scratch.depth, True)

    @compiled
    def solve(t, times):
        w = registers(t.scratch.work)
        for _ in range(times):
            elimination.factorise(w)
            elimination.step_points(w)

    @compiled
    def couple(t, times):
        w, y = registers(t.scratch.work), coupling_of(t.scratch.coupling)
        for _ in range(times):
            elimination.couple_all(t.rows, t.model, t.scratch.segments, w, t.scratch.depth, y)

    @compiled
    def pair(t, times):
        w, y = registers(t.scratch.work), coupling_of(t.scratch.coupling)
        for _ in range(times):
            elimination.state_pair(2, 6, 6, False, w, TILE, y, 0, COUPLED)

    @compiled
    def right(t, times):
        s, w = t.scratch, registers(t.scratch.work)
        buffers = transposed_of(s.transposed), transposed_of(s.weights), transposed_of(s.sums)
        begin = tile.observations_of(t.rows, s.segments)[0]
        for _ in range(times):
            here = t.rows, t.groups, t.target, s.segments, 1, begin, begin
            elimination.sum_right(*here, w, TILE, buffers, t.gradient)

    @compiled
    def turn(t, times):
        w, turned = registers(t.scratch.work), transposed_of(t.scratch.transposed)
        for _ in range(times):
            elimination.transpose_lanes(36, 6, WIDTH, False, PAIR, w, turned)

    @compiled
    def sums(t, times):
        s, w, flat = t.scratch, registers(t.scratch.work), blocks_of(t.blocks)
        buffers = transposed_of(s.transposed), transposed_of(s.weights), transposed_of(s.sums)
        begin = tile.observations_of(t.rows, s.segments)[0]
        for _ in range(times):
            here = t.rows, t.groups, t.target, s.segments, 1, begin, begin + 1, begin
            elimination.sum_terms(*here, w, TILE, TILE + s.depth, buffers, flat)

    @compiled
    def eliminate(t, times):
        s, w, y, flat = t.scratch, registers(t.scratch.work), coupling_of(t.scratch.coupling), blocks_of(t.blocks)
        buffers = transposed_of(s.transposed), transposed_of(s.weights), transposed_of(s.sums)
        for _ in range(times):
            tile_of = t.rows, t.groups, t.target, t.model, s.segments, 1
            elimination.eliminate_tile(*tile_of, True, w, s.depth, y, buffers, flat, t.gradient)

    return {
        "load: constants and places from memory": load,
        "rows: residuals, derivatives, normal equations, all rays": all_rows,
        "solve: Cholesky factor and step of the point": solve,
        "couple: Y = W L^-T, all rays": couple,
        "K_ij of one pair of rays": pair,
        "right sides of one ray": right,
        "K_ij of one pair lane by lane": turn,
        "the same, its products with basis values, summed to blocks": sums,
        "eliminate: all from coupling on": eliminate,
    }


def measure(wanted: Namespace) -> None:
    """The table."""
    require_writable(wanted.markdown)
    t, rows = solved_tile(wanted.line, wanted.sights), []
    for name, stage in stages().items():
        stage(t, 1)
        tries = []
        for _ in range(_TRIES):
            start = time.perf_counter()
            stage(t, _REPEATS)
            tries.append((time.perf_counter() - start) / (_REPEATS * 64) * 1e9)
        rows.append((name, f"{np.median(tries):.1f}"))
    head = (f"stage, points with {wanted.sights} rays, {wanted.line} line", "ns per point")
    text = "\n".join(table(head, rows)) + "\n"
    print(text)
    if wanted.markdown:
        write_text(text, wanted.markdown)


def main(parser: OneLine, given: list[str]) -> int:
    """`benchmark.py stages`."""
    parser.add_argument("--line", choices=("measured", "predicted"), default="measured", help="measured is the peer's")
    parser.add_argument("--sights", type=int, choices=(2, 3), default=2, help="rays of each point")
    parser.add_argument("--markdown", type=Path, help="file for the table")
    wanted = parser.parse_args(given)
    return status(parser.prog, lambda: measure(wanted))
