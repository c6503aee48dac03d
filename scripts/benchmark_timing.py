"""The kernel's stages as compiled, one at a time: a tile goes through the same one over and over."""

import time
from collections.abc import Callable
from typing import Any

from benchmark_stages import STAGES, Tile, eliminate
from numba import njit

from mgsgraph.kernel import tile
from mgsgraph.kernel.lanes import LANES, SQUARE, lane, registers

_NORMAL, _FACTORISE = STAGES["normal equations"], STAGES["factorise"]


@lane
def _normal_and_factorise(t: Tile, w: Any) -> float:
    """factorise leaves another matrix than it finds: it is only timed after the normal equations."""
    return _NORMAL(t, w) + _FACTORISE(t, w)


def _driver(stage: Callable[..., float]) -> Any:

    @njit(nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
    def again(t: Tile, work: Any, calls: int) -> float:
        w, total = registers(work), 0.0
        for _ in range(calls):
            total += stage(t, w)
        return total

    return again


DRIVERS: dict[str, Any] = {
    name: _driver(_normal_and_factorise if name == "factorise" else stage)
    for name, stage in {**STAGES, "eliminate": eliminate}.items()
}
"""By stage; `factorise` with the normal equations."""


def drive(driver: Any, t: Tile, work: Any, calls: int) -> float:
    """Seconds of the processor that so many calls of one stage take."""
    start = time.thread_time()
    driver(t, work, calls)
    return time.thread_time() - start


@njit(nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def inner_steps(rows, model, x, places, work, base, depth, steps):
    """Add the inner steps of all points to `steps`, by pattern, without a robust loss: `tile.solve_tile`, counted."""
    w = registers(work)
    for piece in range(rows.piece.shape[0]):
        pattern = rows.piece[piece, 0]
        for first in range(0, rows.piece[piece, 2], LANES):
            n = min(LANES, rows.piece[piece, 2] - first)
            tile.load(rows, model, piece, first, n, w, base, depth)
            tile.place_points(places, rows.piece[piece, 1] + first, n, w)
            for _ in range(tile._INNER_STEPS):
                tile.all_rows(rows, model, piece, x, first, n, w, base, depth)
                tile.normal_equations(rows, pattern, n, w, base, depth)
                tile.factorise(n, w)
                tile.step_points(n, w)
                steps[pattern] += n
                if tile.largest(n, w, SQUARE) < tile._PLAIN_TOLERANCE * tile._PLAIN_TOLERANCE:
                    break
