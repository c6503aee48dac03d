"""What the machine can do at best, measured: fused multiply-adds in registers, and bytes moved in caches and memory."""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
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

    chains: Any = intrinsic(typed)

    @njit(nogil=True)
    def run(rounds: int) -> float:
        result: float = chains(rounds)
        return result

    return run


@njit(nogil=True, fastmath=True)
def triad(a: Any, b: Any, c: Any, rounds: int) -> None:
    """a = b + s c, over and over."""
    for number in range(rounds):
        for i in range(a.size):
            a[i] = b[i] + (1.0 + number) * c[i]


def together(run: Callable[[int], object], threads: int) -> float:
    """Seconds of the processor that the slowest of `threads` of them takes: what others do isn't in it."""

    def own(number: int) -> float:
        start = time.thread_time()
        run(number)
        return time.thread_time() - start

    with ThreadPoolExecutor(threads) as pool:
        return max(pool.map(own, range(threads)))


def _runs(size: int, threads: int) -> tuple[Callable[[int], object], float]:
    """A triad over arrays of `size` numbers, each thread's its own, and its bytes: two loads and a store an element."""
    arrays = [tuple(np.full(size, 1.0 + j) for j in range(3)) for _ in range(threads)]
    rounds = max(1, 8_000_000 // size)
    return lambda k: triad(*arrays[k], rounds), 24.0 * size * rounds


def peak_jobs(tile_numbers: int, threads: int) -> dict[tuple[str, int], tuple[Callable[[], float], float]]:
    """What to time, by name and number of threads, with the work done in 1e9 flops or bytes; a multiply-add is two.

    `tile_numbers` is how many a tile's registers hold.
    """
    jobs: dict[tuple[str, int], tuple[Callable[[], float], float]] = {}
    for count in (1, threads):
        for name, width in WIDTHS.items():
            run = partial(_rounds, _chains(width))
            jobs[name, count] = (partial(together, run, count), 2e-9 * width * CHAINS * ROUNDS * count)
        for name, size in (("nearest", 680), ("near", tile_numbers // 3), ("memory", LARGE // count)):
            moved, work = _runs(size, count)
            jobs[name, count] = (partial(together, moved, count), 1e-9 * work * count)
    return jobs


def _rounds(run: Callable[[int], float], _: int) -> float:
    """The same for every thread."""
    return run(ROUNDS)
