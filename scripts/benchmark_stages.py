"""A tile's way through the sweep in stages, for benchmark_profile: each timed as compiled, and counted as written.

    NUMBA_DISABLE_JIT=1 python scripts/benchmark_stages.py FILE.bin measured|predicted

counts: the kernel's own source runs as Python, on numbers that count what is done with them. What is printed is JSON:
operations per point, loads and stores of the tile's registers and of arrays, by pattern and stage.
"""

import json
import math
import operator
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from peer_problem import network, read_problem

from mgsgraph.adjustment.graph import Layout, lay_out
from mgsgraph.adjustment.settings import Line
from mgsgraph.factors import pose, surface, tile
from mgsgraph.factors import range as ranges
from mgsgraph.kernel.elimination import (
    couple_all,
    eliminate_tile,
    most_sums,
    pair_sums,
    paired,
    spread,
    state_pair,
    sum_right,
    sum_shared,
    sum_terms,
    term_sums,
)
from mgsgraph.kernel.lanes import LANES, SQUARE, lane
from mgsgraph.kernel.rows import GROUND, IMAGE, RANGE, Groups, Model, Rows, Target
from mgsgraph.kernel.sweep import store_places

PATTERNS = {"two rays": (IMAGE, IMAGE), "three rays": (IMAGE,) * 3, "laser": (IMAGE, IMAGE, RANGE, GROUND)}
"""Kinds of the sights of points that are measured: ties, and a laser shot seen by two images."""
SETTLING = 4
"""Inner steps that bring a tile to rest before anything is measured."""


class Tile(NamedTuple):
    """`LANES` points of one pattern, and what their stages need."""

    rows: Rows
    groups: Groups
    target: Target
    model: Model
    piece: int
    pattern: int
    x: Any
    """(columns,) orientation vector."""
    places: Any
    """(n, 3) m."""
    states: Any
    """(n,)."""
    base: int
    depth: int
    sums: Any
    gradient: Any
    blocks: Any


def piece_of(rows: Rows, kinds: tuple[int, ...]) -> int | None:
    """The first piece with a full tile of such points that aren't known; None without one."""
    for number, (pattern, _, count, _, _) in enumerate(rows.piece.tolist()):
        begin, end = rows.pattern_sight[pattern], rows.pattern_sight[pattern + 1]
        if count >= LANES and not rows.pattern_fixed[pattern] and tuple(rows.sight_kind[begin:end].tolist()) == kinds:
            return number
    return None


def tile_of(layout: Layout, piece: int) -> tuple[Tile, Any]:
    """A tile of a piece with the nominal orientation, and its registers."""
    rows, target = layout.rows, layout.blocks.target
    size, base, depth = tile.workspace(rows)
    results = (np.zeros(most_sums(rows)), np.zeros(target.columns), np.zeros(target.size))
    x, states = np.zeros(layout.columns), np.zeros(rows.kind.size, dtype=np.int8)
    pattern = int(rows.piece[piece, 0])
    own = (layout.groups, target, layout.model, piece, pattern, x, rows.start.copy(), states, base, depth)
    return Tile(rows, *own, *results), np.zeros(size)


@lane
def load(t: Tile, w: Any) -> float:
    """Constants and places from memory into registers."""
    tile.load(t.rows, t.model, t.piece, 0, LANES, w, t.base, t.depth)
    tile.place_points(t.places, t.rows.piece[t.piece, 1], LANES, w)
    return 0.0


@lane
def make_rows(t: Tile, w: Any) -> float:
    """Residuals and derivatives of all sights."""
    tile.all_rows(t.rows, t.model, t.piece, t.x, 0, LANES, w, t.base, t.depth)
    return 0.0


@lane
def normal(t: Tile, w: Any) -> float:
    """The points' own normal equations."""
    tile.normal_equations(t.rows, t.pattern, LANES, w, t.base, t.depth)
    return 0.0


@lane
def factorise(t: Tile, w: Any) -> float:
    """Their Cholesky factors."""
    tile.factorise(LANES, w)
    return 0.0


@lane
def move(t: Tile, w: Any) -> float:
    """The step of the inner solve and its length."""
    tile.step_points(LANES, w)
    return tile.largest(LANES, w, SQUARE)


@lane
def store(t: Tile, w: Any) -> float:
    """Places, states and cost back to memory."""
    return store_places(t.rows.piece[t.piece, 1], LANES, w, t.places, t.states)


@lane
def couple(t: Tile, w: Any) -> float:
    """What each sight's state shares with its point."""
    couple_all(t.rows, t.pattern, LANES, w, t.base, t.depth)
    return 0.0


@lane
def pairs(t: Tile, w: Any) -> float:
    """K_ij between the states of two sights, for all pairs."""
    begin, end = tile.sights_of(t.rows, t.pattern)
    for i in range(begin, end):
        for j in range(i, end):
            if paired(t.rows, t.pattern, i, j):
                s, other = t.base + (i - begin) * t.depth, t.base + (j - begin) * t.depth
                count, width = tile.row_count(t.rows.sight_kind[i]), t.rows.sight_width[i]
                state_pair(count, width, t.rows.sight_width[j], i == j, LANES, w, s, other)
    return 0.0


@lane
def sums(t: Tile, w: Any) -> float:
    """Sums over lanes of K_ij times products of basis values, and of the gradient."""
    begin, end = tile.sights_of(t.rows, t.pattern)
    at, group = 0, t.rows.pattern_group[t.pattern]
    for i in range(begin, end):
        s = t.base + (i - begin) * t.depth
        if t.rows.sight_terms[i] + t.rows.sight_shared[i] > 0:
            sum_right(t.rows, t.groups, t.target, group, i, LANES, w, s, t.gradient)
        for j in range(i, end):
            if paired(t.rows, t.pattern, i, j):
                other = t.base + (j - begin) * t.depth
                sum_terms(t.rows, i, j, LANES, w, s, other, t.sums, at)
                if t.rows.sight_shared[i] > 0 or t.rows.sight_shared[j] > 0:
                    sum_shared(t.rows, i, j, LANES, w, s, other, t.sums, at + term_sums(t.rows, i, j))
                at += pair_sums(t.rows, i, j)
    return 0.0


@lane
def spread_sums(t: Tile, w: Any) -> float:
    """Sums to the blocks of variable pairs, once for all points of a pattern."""
    spread(t.rows, t.groups, t.target, t.pattern, t.sums, t.blocks)
    return 0.0


@lane
def eliminate(t: Tile, w: Any) -> float:
    """couple, pairs and sums as the sweep does them."""
    eliminate_tile(t.rows, t.groups, t.target, t.pattern, LANES, w, t.base, t.depth, t.sums, t.gradient)
    return 0.0


Stages = dict[str, Callable[..., float]]

INNER: Stages = {"rows": make_rows, "normal equations": normal, "factorise": factorise, "step": move}
"""Of every inner step."""
OUTER: Stages = {"couple": couple, "pairs": pairs, "sums": sums}
"""Elimination; once."""
STAGES: Stages = {"load": load, **INNER, "store": store, **OUTER, "spread": spread_sums}
"""`spread` is counted and timed per pattern and not per point."""


# ---- numbers that count
class Counted(float):
    """A float that counts what is done with it."""

    tally: ClassVar[Counter[str]] = Counter()
    __array_ufunc__ = None  # so that NumPy's scalars let it have the operation
    __hash__ = float.__hash__

    def __neg__(self) -> "Counted":
        return Counted(-float(self))

    def __abs__(self) -> "Counted":
        return Counted(abs(float(self)))


def _counting(name: str, kind: str) -> Callable[[Any, Any], Any]:
    """An operator of two floats that counts; by zero it divides as the kernel does."""
    turned = name in ("__radd__", "__rsub__", "__rmul__", "__rtruediv__")
    plain = getattr(operator, name.replace("__r", "__") if turned else name)

    def counted(self: Any, other: Any) -> Any:
        Counted.tally[kind] += 1
        a, b = (float(other), float(self)) if turned else (float(self), float(other))
        try:
            value = plain(a, b)
        except ZeroDivisionError:
            with np.errstate(all="ignore"):
                value = np.divide(a, b)
        return value if kind == "compare" else Counted(value)

    return counted


for _kind, _names in {
    "add": ("__add__", "__radd__", "__sub__", "__rsub__"),
    "multiply": ("__mul__", "__rmul__"),
    "divide": ("__truediv__", "__rtruediv__"),
    "compare": ("__lt__", "__le__", "__gt__", "__ge__", "__eq__", "__ne__"),
}.items():
    for _name in _names:
        setattr(Counted, _name, _counting(_name, _kind))


class Memory:
    """An array whose loads and stores are counted; one index counts through all of it, as registers do."""

    def __init__(self, values: NDArray[Any], where: str) -> None:
        self.values, self.flat, self.shape, self.where = values, values.reshape(-1), values.shape, where

    def _bytes(self, what: str, value: Any) -> None:
        Counted.tally[f"{self.where} {what}"] += np.size(value)
        Counted.tally[f"{self.where} bytes"] += np.size(value) * self.flat.itemsize

    def __getitem__(self, place: Any) -> Counted:
        value = self.values[place] if isinstance(place, tuple) else self.flat[place]
        self._bytes("loads", value)
        return Counted(value)

    def __setitem__(self, place: Any, value: Any) -> None:
        array = self.values if isinstance(place, tuple) else self.flat
        self._bytes("stores", array[place])
        array[place] = value


def counted(t: Tile, work: NDArray[np.float64], stage: Callable[..., float]) -> dict[str, int]:
    """What one stage of a tile does. The kernel must not be compiled."""
    floats = ("start", "data", "weight", "kind", "sight_focal")
    arrays = ("x", "places", "states", "sums", "gradient", "blocks")
    rows = t.rows._replace(**{name: Memory(getattr(t.rows, name), "array") for name in floats})
    own = t._replace(rows=rows, **{name: Memory(getattr(t, name), "array") for name in arrays})
    Counted.tally.clear()
    stage(own, Memory(work, "register"))
    return dict(Counted.tally)


def _count_in_kernel() -> None:
    """Let the kernel's source take numbers that count."""

    def root(value: float) -> Counted:
        Counted.tally["root"] += 1
        return Counted(math.sqrt(value) if value >= 0.0 else math.nan)

    counting = SimpleNamespace(**{**vars(math), "sqrt": root})
    for module in (tile, pose, ranges, surface):
        vars(module)["math"] = counting
    vars(tile)["registers"] = lambda array: array


def settle(t: Tile, work: Any) -> None:
    """Bring a tile to rest, so that no stage is measured on an unusual way."""
    load(t, work)
    for _ in range(SETTLING):
        for stage in INNER.values():
            stage(t, work)
    store(t, work)
    load(t, work)


def counts(layout: Layout) -> dict[str, dict[str, dict[str, float]]]:
    """Operations per point (of `spread`: per pattern) by pattern and stage; the kernel must not be compiled."""
    _count_in_kernel()
    found = {}
    for name, kinds in PATTERNS.items():
        piece = piece_of(layout.rows, kinds)
        if piece is None:
            continue
        t, work = tile_of(layout, piece)
        settle(t._replace(rows=_plain(t.rows)), Memory(work, "register"))
        stages = {stage: counted(t, work, function) for stage, function in STAGES.items()}
        stages["eliminate"] = counted(t, work, eliminate)
        found[name] = {
            stage: {kind: value / (1 if stage == "spread" else LANES) for kind, value in tally.items()}
            for stage, tally in stages.items()
        }
    return found


def _plain(rows: Rows) -> Rows:
    """Rows whose arrays of floats are read as `registers` reads them."""
    return rows._replace(**{name: Memory(getattr(rows, name), "array") for name in ("data", "weight")})


def laid_out(path: Path, line: str) -> Layout:
    """A problem file, laid out for the kernel."""
    return lay_out(*network(read_problem(path), cast(Line, line)))


if __name__ == "__main__":
    print(json.dumps(counts(laid_out(Path(sys.argv[1]), sys.argv[2]))))
