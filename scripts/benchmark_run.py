"""One problem file adjusted once, in a process of its own: seconds by stage, iterations, cost, memory.

Not in the figures: compiling the kernel, or loading it from its cache. A tiny problem of the same kind is adjusted
first, so that the file's own adjustment finds everything compiled, as a second adjustment in one session would.
"""

import ctypes
import json
import os
import resource
import sys
import time
from pathlib import Path
from typing import Any

from benchmark_blocks import chain
from peer_problem import network, read_problem

from mgsgraph.adjustment.settings import Line
from mgsgraph.errors import InputError
from mgsgraph.io.files import fresh_file

MEGABYTE = 2.0**20
"""bytes; as the peer counts its own."""
REMEDY = "choose a file where you may write"


def run(path: Path, line: Line = "measured") -> dict[str, Any]:
    """Figures of one file. Memory: the highest of the whole process in MB, what it held just before the adjustment
    (program, compiled kernel, input), and the difference in bytes per image observation.
    """
    from mgsgraph.adjustment.adjust import adjust_network, versions  # the kernel: not before --threads counts

    start = time.perf_counter()
    problem = read_problem(path)
    read = time.perf_counter() - start
    adjust_network(*network(chain(2, 40, shots=5)[0], line))
    start = time.perf_counter()
    taken, settings = network(problem, line)
    made = time.perf_counter() - start
    rays, points, images = problem.u.size, problem.places.shape[0], problem.orientation.shape[0]
    del problem
    forget_peak()
    before = resident()
    solution = adjust_network(taken, settings, str(path))
    peak = highest()
    stages = {f"seconds_{name.replace(' ', '_')}": value for name, value in solution.seconds.items()}
    return {
        "problem": str(path),
        "line": line,
        "images": images,
        "points": points,
        "observations": rays,
        "threads": threads(),
        "converged": solution.converged,
        "message": solution.message,
        "iterations": solution.iterations,
        "cost_initial": solution.cost_initial,
        "cost_final": solution.cost_final,
        "seconds_read": read,
        "seconds_network": made,
        **stages,
        "seconds_per_iteration": stages["seconds_solve"] / max(solution.iterations, 1),
        "peak_memory_mb": peak / MEGABYTE,
        "memory_before_mb": before / MEGABYTE,
        "bytes_per_observation": (peak - before) / rays,
        "versions": versions(),
    }


def threads() -> int:
    """Threads of the kernel."""
    import numba

    return int(numba.get_num_threads())


def resident() -> float:
    """Bytes of memory that the process holds now; where the system doesn't say, the most it has held."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return highest()
    return float(pages * resource.getpagesize())


def highest() -> float:
    """Bytes, the most memory that the process has held since `forget_peak`."""
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def forget_peak() -> None:
    """Let the highest memory begin anew, so that reading the input doesn't hide the adjustment; Linux only.

    What the input's making has freed goes back to the system first: used again, it would not count.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return  # the figure is then an upper bound


def require_writable(*paths: Path | None) -> None:
    """Raise InputError unless files can be written here; to be asked before long work."""
    for path in paths:
        if path is None:
            continue
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(str(path), f"can't be written ({error.strerror or error})", remedy=REMEDY) from None
        if path.is_dir() or not os.access(path.parent, os.W_OK):
            raise InputError(str(path), "can't be written", remedy=REMEDY)


def write_json(figures: Any, path: Path) -> None:
    """Write figures as JSON, whole or not at all."""
    write_text(json.dumps(figures, indent=1, allow_nan=False) + "\n", path)


def write_text(text: str, path: Path) -> None:
    """Write a text file, whole or not at all."""
    with fresh_file(path, remedy=REMEDY) as aside:
        aside.write_text(text, encoding="utf-8")


def write_figure(figure: Any, path: Path) -> None:
    """Write a figure of matplotlib as PNG, whole or not at all."""
    with fresh_file(path, remedy=REMEDY) as aside:
        figure.savefig(aside, dpi=110, format="png")
