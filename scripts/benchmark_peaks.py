"""What the machine can do at best, measured: fused multiply-adds in registers, and bytes moved in caches and memory."""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

CHAINS = 12
"""Independent multiply-adds under way: latency (4 cycles) times units (2) is 8; the sixteen registers hold them all."""
WIDTHS = {"256 bit": 4, "512 bit": 8}
"""Numbers of a vector register: AVX2, AVX-512."""
ROUNDS = 2_000_000
LARGE = 8_000_000
"""Numbers of each array of the triad in memory: 64 MB, larger than any cache's share here."""


@dataclass(frozen=True, slots=True)
class Peaks:
    """The best of many tries: on a shared machine others take part of the time."""

    fused: dict[str, tuple[float, float]]
    """Gflop/s of fused multiply-adds with one thread and with all, by width; a multiply-add counts twice."""
    near: float
    """GB/s that a triad moves in one core's cache, over a tile's registers."""
    nearest: float
    """The same over 16 kB, in the first-level cache."""
    memory: tuple[float, float]
    """GB/s of a triad over main memory, one thread and all: two loads and a store, 24 bytes an element."""

    @property
    def best(self) -> tuple[float, float]:
        """Gflop/s of the better width, one thread and all."""
        return max(self.fused.values())


def _chains(width: int) -> Any:
    """x = x a + b in `CHAINS` vectors of some width, again and again; LLVM is told the width outright."""

    def typed(typing: Any, rounds: Any) -> Any:

        def generate(context: Any, builder: Any, call: Any, arguments: Any) -> Any:
            vector = ir.VectorType(ir.DoubleType(), width)
            kind = ir.FunctionType(vector, [vector] * 3)
            fused = cgutils.get_or_insert_function(builder.module, kind, f"llvm.fma.v{width}f64")
            scale, shift = (ir.Constant(vector, [value] * width) for value in (0.999, 0.5))
            places = [cgutils.alloca_once(builder, vector) for _ in range(CHAINS)]
            for number, place in enumerate(places):
                builder.store(ir.Constant(vector, [1.0 + number] * width), place)
            with cgutils.for_range(builder, arguments[0]):
                for place in places:
                    builder.store(builder.call(fused, [builder.load(place), scale, shift]), place)
            total = builder.load(places[0])
            for place in places[1:]:
                total = builder.fadd(total, builder.load(place))
            return builder.extract_element(total, ir.Constant(ir.IntType(32), 0))

        return types.float64(types.int64), generate

    chains = intrinsic(typed)

    @njit(nogil=True)
    def run(rounds):
        return chains(rounds)

    return run


@njit(nogil=True, fastmath=True)
def triad(a, b, c, rounds):
    """a = b + s c, over and over."""
    for number in range(rounds):
        for i in range(a.size):
            a[i] = b[i] + (1.0 + number) * c[i]


def together(run: Callable[[int], object], threads: int) -> float:
    """Seconds that `threads` of them take side by side."""
    if threads == 1:
        start = time.perf_counter()
        run(0)
        return time.perf_counter() - start
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(abs, range(threads)))  # the threads are there
        start = time.perf_counter()
        list(pool.map(run, range(threads)))
        return time.perf_counter() - start


def _rate(run: Callable[[int], object], threads: int, work: float, repeat: int) -> float:
    """Work done per second by `threads`, the best of many, in 1e9."""
    run(0)
    return threads * work / min(together(run, threads) for _ in range(repeat)) / 1e9


def triad_rate(size: int, threads: int, repeat: int) -> float:
    """GB/s of triads over arrays of `size` numbers, each thread's its own."""
    arrays = [tuple(np.full(size, 1.0 + j) for j in range(3)) for _ in range(threads)]
    rounds = max(1, 20_000_000 // size)
    return _rate(lambda k: triad(*arrays[k], rounds), threads, 24.0 * size * rounds, repeat)


def peaks(tile_numbers: int, threads: int, repeat: int) -> Peaks:
    """All of them; `tile_numbers` is how many a tile's registers hold."""
    fused = {}
    for name, width in WIDTHS.items():
        run, work = _chains(width), 2.0 * width * CHAINS * ROUNDS
        one, all_of_them = (_rate(lambda k: run(ROUNDS), count, work, repeat) for count in (1, threads))
        fused[name] = (one, all_of_them)
    memory = tuple(triad_rate(LARGE // count, count, repeat) for count in (1, threads))
    return Peaks(fused, triad_rate(tile_numbers // 3, 1, repeat), triad_rate(680, 1, repeat), (memory[0], memory[1]))
