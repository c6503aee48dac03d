"""The benchmark's page in Markdown."""

import math
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmark_gate import OURS, Runs, cost_difference, middle, ratio
from benchmark_peer import VARIANTS

STAGES = ("read", "network", "set_up", "solve", "covariance")
"""Of ours: reading the file, making the network, laying it out, solving, all covariances."""
HEAD = """# Speed, beside the C++ peer

Made by `scripts/benchmark.py`; {repeat} repeats of all programs in turn, each run a process of its own, {threads}
threads each; medians. {machine}. Compare ratios, not seconds: the machine was shared.

* *solve*: from the laid-out problem to the optimum; the kernel is compiled and loaded before (a tiny problem is
  adjusted first). *covariance*: of all orientation coefficients, and the 3x3 of every point.
* *plain*: Ceres with automatic derivatives and its defaults. *analytic*: Ceres at its best here, analytic derivatives,
  fused blocks, Gauss-Newton. *custom*: Gauss-Newton written by hand in C++, with all point covariances.
* Ratios: the peer's seconds over ours; of the medians, and in brackets from the least to the most of the repeats.
* *memory*: highest during the adjustment beside what program and input hold, in bytes per image observation.
"""


def page(results: Mapping[str, Runs], repeat: int, threads: int) -> str:
    """All tables."""
    parts = [HEAD.format(repeat=repeat, threads=threads, machine=machine())]
    parts += ["## Ours, seconds by stage", "", *stage_table(results), ""]
    if any(runs.get(variant) for runs in results.values() for variant in VARIANTS):
        parts += ["## The peer's seconds over ours", "", *ratio_table(results), ""]
        parts += ["## Seconds, and the final cost", "", *cost_table(results), ""]
    else:
        parts += ["The peer took no part: its program was not named (`--peer`).", ""]
    return "\n".join(parts)


def stage_table(results: Mapping[str, Runs]) -> list[str]:
    """Seconds of each stage, iterations, memory."""
    head = ("size", "images", "points", "observations", *(stage.replace("_", " ") for stage in STAGES), "iterations")
    rows = []
    for size, runs in results.items():
        mine = runs[OURS]
        counts = (f"{mine[0][key]:,}" for key in ("images", "points", "observations"))
        seconds = (number(middle(mine, f"seconds_{stage}")) for stage in STAGES)
        last = (f"{middle(mine, 'iterations'):g}", number(middle(mine, "seconds_per_iteration")))
        memory = (f"{middle(mine, 'peak_memory_mb'):.0f}", f"{middle(mine, 'bytes_per_observation'):.0f}")
        rows.append((size, *counts, *seconds, *last, *memory))
    return table((*head, "s / iteration", "highest MB", "memory, B / obs."), rows)


def ratio_table(results: Mapping[str, Runs]) -> list[str]:
    """Ratios of solve and covariance."""
    rows = []
    for size, runs in results.items():
        solves = [ratio(runs, variant, "seconds_solve") for variant in VARIANTS]
        cells = [str(one) if one else "-" for one in (*solves, ratio(runs, "custom", "seconds_covariance"))]
        rows.append((size, *cells))
    return table(("size", *(f"{variant}, solve" for variant in VARIANTS), "custom, covariance"), rows)


def cost_table(results: Mapping[str, Runs]) -> list[str]:
    """Solve seconds and iterations of every program; covariance; final cost and its difference."""
    rows = []
    for size, runs in results.items():
        cells = [size]
        for name in (OURS, *VARIANTS):
            mine = runs.get(name, ())
            cells.append(f"{number(middle(mine, 'seconds_solve'))} ({middle(mine, 'iterations'):g})" if mine else "-")
        cells += [number(middle(runs.get(name, ()), "seconds_covariance")) for name in (OURS, "custom")]
        difference = cost_difference(runs)
        cells += [f"{middle(runs[OURS], 'cost_final'):.12g}", "-" if math.isnan(difference) else f"{difference:.1e}"]
        rows.append(tuple(cells))
    names = (f"{name}, solve (iterations)" for name in (OURS, *VARIANTS))
    return table(("size", *names, f"{OURS}, covariance", "custom, covariance", "cost", "relative difference"), rows)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table."""
    return ["| " + " | ".join(head) + " |", "|---" * len(head) + "|", *("| " + " | ".join(row) + " |" for row in rows)]


def number(value: float) -> str:
    """Three digits; a dash for none."""
    return "-" if math.isnan(value) else f"{value:#.3g}".rstrip(".")


def machine() -> str:
    """What it ran on."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names: list[Any] = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return f"{names[0]}, {len(names)} processors" if names else platform.machine()
