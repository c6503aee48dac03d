"""What a device reaches in float64 arithmetic and in its memory, measured: what its sweeps are to be held against."""

import time
from typing import NamedTuple

from mgsgraph.kernel.cuda.device import SIMULATED, THREADS, cuda, kernel
from mgsgraph.kernel.cuda.partition import zeros

_STEPS, _CHAINS = (4, 8) if SIMULATED else (4096, 8)
"""Multiplications with additions of a thread, one after the other; and how many of them side by side."""
_BLOCKS = 2 if SIMULATED else 132 * 64
_NUMBERS = 64 if SIMULATED else 1 << 27
"""float64 that are copied: a gigabyte, more than a cache holds."""


class Rates(NamedTuple):
    """Of a device."""

    operations: float
    """Per s, multiplications and additions in float64; without its matrix units."""
    bytes: float
    """Per s, read and written."""


@kernel
def multiply_and_add(values):
    """Eight independent chains of multiplications with additions."""
    k = cuda.grid(1)
    x = 1e-9 * k
    a, b, c, d = x, x + 1.0, x + 2.0, x + 3.0
    e, f, g, h = x + 4.0, x + 5.0, x + 6.0, x + 7.0
    for _ in range(_STEPS):
        a = a * 0.999 + x
        b = b * 0.999 + x
        c = c * 0.999 + x
        d = d * 0.999 + x
        e = e * 0.999 + x
        f = f * 0.999 + x
        g = g * 0.999 + x
        h = h * 0.999 + x
    values[k] = a + b + c + d + e + f + g + h


@kernel
def copy(source, sink):
    """Copy numbers."""
    k = cuda.grid(1)
    if k < sink.size:
        sink[k] = source[k]


def synchronise() -> None:
    """Wait until the device has done all that it was told."""
    if not SIMULATED:
        cuda.synchronize()


def measured_rates(runs: int = 5) -> Rates:
    """The best of some runs each; the first compiles."""
    values, source, sink = zeros(_BLOCKS * THREADS), zeros(_NUMBERS), zeros(_NUMBERS)
    blocks = -(-_NUMBERS // THREADS)
    arithmetic, traffic = list[float](), list[float]()
    for _ in range(1 + runs):
        begin = _now()
        multiply_and_add[_BLOCKS, THREADS](values)
        middle = _now()
        copy[blocks, THREADS](source, sink)
        arithmetic.append(middle - begin)
        traffic.append(_now() - middle)
    operations = 2.0 * _CHAINS * _STEPS * _BLOCKS * THREADS
    return Rates(operations / min(arithmetic[1:]), 16.0 * _NUMBERS / min(traffic[1:]))


def _now() -> float:
    synchronise()
    return time.perf_counter()
