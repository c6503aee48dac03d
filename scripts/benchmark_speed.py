"""This program beside the C++ peer: seconds, memory and cost; and the gate that holds ratios against a baseline.

A baseline holds ratios, counts and relative differences, never seconds: those belong to the machine.
"""

import argparse
import ctypes
import json
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

from peer_blocks import SHARED, SIZES, chain, made
from peer_problem import network, read_problem, write_problem
from study import (
    OneLine,
    at_least,
    machine,
    number,
    require_writable,
    show,
    status,
    table,
    write_json,
    write_text,
)

from mgsgraph.adjustment.settings import Line
from mgsgraph.errors import InputError

PROGRAM = Path(__file__).with_name("benchmark.py")
BASELINE = Path(__file__).with_name("baseline.json")
OURS = "mgsgraph"
VARIANTS = {
    "plain": ("--cost", "auto", "--layout", "plain", "--radius", "1e4"),
    "analytic": ("--cost", "analytic", "--layout", "fused", "--radius", "1e16"),
    "custom": ("--solver", "custom_gn", "--cov", "schur"),
}
"""Ceres as one writes it first; Ceres at its best here (README of the peer); hand-written Gauss-Newton in C++, which
computes all point covariances as well."""
Runs = Mapping[str, Sequence[Mapping[str, Any]]]
"""Figures of each program, ours and the peer's variants, one of each repeat."""
ONCE = {("Kaguya", "custom")}
"""Runs that aren't repeated: the hand-written C++ fills the dense reduced system of 6750 unknowns, two minutes long."""


TOLERANCE = ("--ftol", "1e-10")
"""Relative change of the cost at which it stops; ours is the same."""
_KEYS = {
    "t_solve": "seconds_solve", "iterations": "iterations", "final_cost": "cost_final", "maxrss_mb": "peak_memory_mb",
    "initial_cost": "cost_initial", "t_load": "seconds_read", "t_build": "seconds_network",
}  # fmt: skip
_REMEDY = "build it with the peer's build.sh"


MEGABYTE = 2.0**20
"""bytes; as the peer counts its memory."""


STAGES = ("read", "network", "set_up", "solve", "covariance")
"""Of ours: reading the file, making the network, laying it out, solving, all covariances."""
HEAD = """# Speed, beside the C++ peer

Made by `scripts/benchmark.py speed`; {repeat} repeats of all programs in turn, each run a process of its own, {threads}
threads each; medians. {machine}. Compare ratios, not seconds: the machine was shared.

* *solve*: from the laid-out problem to the optimum; the kernel is compiled and loaded before (a tiny problem is
  adjusted first). *covariance*: of all orientation coefficients, and the 3x3 of every point.
* *plain*: Ceres with automatic derivatives and its defaults. *analytic*: Ceres at its best here, analytic derivatives,
  fused blocks, Gauss-Newton. *custom*: Gauss-Newton written by hand in C++, with all point covariances.
* Ratios: the peer's seconds over ours; of the medians, and in brackets from the least to the most of the repeats.
* *memory*: highest during the adjustment beside what program and input hold, in bytes per image observation.
"""


# --- ratios


@dataclass(frozen=True, slots=True)
class Ratio:
    """How many times longer the peer takes."""

    value: float
    """of the medians."""
    least: float
    """least, over the repeats."""
    most: float
    """the same."""

    def __str__(self) -> str:
        return f"{self.value:.2f} ({self.least:.2f} .. {self.most:.2f})"


def middle(runs: Sequence[Mapping[str, Any]], key: str) -> float:
    """Median over the repeats; NaN where the figure is missing."""
    values = [float(run[key]) for run in runs if key in run]
    return median(values) if values else math.nan


def ratio(runs: Runs, variant: str, key: str) -> Ratio | None:
    """Peer's seconds over ours; None where one of them has no such figure."""
    pairs = [
        (float(theirs[key]), float(ours[key]))
        for theirs, ours in zip(runs.get(variant, ()), runs[OURS], strict=False)
        if key in theirs and key in ours
    ]
    if not pairs or not all(ours > 0.0 for _, ours in pairs):
        return None
    single = [theirs / ours for theirs, ours in pairs]
    return Ratio(middle(runs[variant], key) / middle(runs[OURS], key), min(single), max(single))


def cost_difference(runs: Runs) -> float:
    """Largest relative difference of our final cost from one of the peer's; NaN without the peer."""
    peers = [middle(runs[variant], "cost_final") for variant in VARIANTS if runs.get(variant)]
    ours = middle(runs[OURS], "cost_final")
    return max((abs(ours - peer) / peer for peer in peers), default=math.nan)


def metrics(size: str, runs: Runs) -> dict[str, float]:
    """All figures of one size that a baseline may limit, by name."""
    figures = {
        f"{size}: iterations": middle(runs[OURS], "iterations"),
        f"{size}: bytes per observation": middle(runs[OURS], "bytes_per_observation"),
        f"{size}: share that converged": sum(bool(run["converged"]) for run in runs[OURS]) / len(runs[OURS]),
    }
    solves = {variant: ratio(runs, variant, "seconds_solve") for variant in VARIANTS}
    figures |= {f"{size}: solve, {variant} / {OURS}": solve.value for variant, solve in solves.items() if solve}
    if any(solves.values()):
        figures[f"{size}: solve, best / {OURS}"] = min(solve.value for solve in solves.values() if solve)
        figures[f"{size}: cost, relative difference"] = cost_difference(runs)
    if covariance := ratio(runs, "custom", "seconds_covariance"):
        figures[f"{size}: covariance, custom / {OURS}"] = covariance.value
    return figures


# --- the baseline


@dataclass(frozen=True, slots=True)
class Limit:
    """The limit of one figure."""

    direction: str
    """higher: higher is better; lower: lower is."""
    required: float | None = None
    """Required value; no tolerance."""
    value: float | None = None
    """Value when the baseline was made."""
    tolerance: float = 0.25
    """Share of `value` by which a figure may be worse: times scatter on shared machines."""

    def bound(self) -> float:
        """The worst that passes."""
        sign = 1.0 if self.direction == "lower" else -1.0
        reached = [] if self.value is None else [self.value * (1.0 + sign * self.tolerance)]
        bounds = reached + ([] if self.required is None else [self.required])
        return min(bounds) if self.direction == "lower" else max(bounds)

    def holds(self, figure: float) -> bool:
        """Whether a figure passes; NaN doesn't."""
        return figure <= self.bound() if self.direction == "lower" else figure >= self.bound()


def read_baseline(path: Path) -> dict[str, Limit]:
    """Limits by name of figure; InputError for a file that isn't a baseline."""
    try:
        lines = json.loads(path.read_text(encoding="utf-8"))["metrics"]
        limits = {str(name): Limit(**line) for name, line in lines.items()}
    except OSError as error:
        raise InputError(str(path), f"can't be read ({error.strerror or error})", "a baseline") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(str(path), f"no baseline ({' '.join(str(error).split())[:100]})") from None
    for name, limit in limits.items():
        numbers = [value for value in (limit.required, limit.value, limit.tolerance) if value is not None]
        fine = all(isinstance(value, int | float) and math.isfinite(value) for value in numbers)
        if limit.direction not in ("higher", "lower") or not fine or len(numbers) < 2:
            expected = "a direction, higher or lower, and a finite number required or reached"
            raise InputError(f"{path}, {name}", f"{line_of(limit)}", expected)
    return limits


def line_of(limit: Limit) -> dict[str, Any]:
    """A limit as the file holds it."""
    line = {"direction": limit.direction, "required": limit.required, "value": limit.value}
    return {key: value for key, value in line.items() if value is not None} | {"tolerance": limit.tolerance}


def judged(limits: Mapping[str, Limit], values: Mapping[str, float], sizes: Sequence[str]) -> list[str]:
    """Sentences, one for each figure of these sizes that fails; InputError where one wasn't measured."""
    chosen = {name: limit for name, limit in limits.items() if name.split(":")[0] in sizes}
    if not chosen:
        raise InputError("gate", f"no line of the baseline for {', '.join(sizes)}", "a size that it holds")
    for name in [key for key in chosen if key not in values][:1]:
        raise InputError(f"gate, {name}", "not measured", "the peer in the same run", "name it with --peer")
    return [
        f"FAILED {name}: {values[name]:.4g}, at {'most' if limit.direction == 'lower' else 'least'} {limit.bound():.4g}"
        for name, limit in chosen.items()
        if not limit.holds(values[name])
    ]


def update_baseline(path: Path, figures: Mapping[str, float]) -> None:
    """Write the values of this run into the baseline's lines; only on a quiet machine."""
    limits = read_baseline(path)
    updated = {name: replace(limit, value=figures.get(name, limit.value)) for name, limit in limits.items()}
    note = json.loads(path.read_text(encoding="utf-8")).get("note", "")
    write_json({"note": note, "metrics": {name: line_of(limit) for name, limit in updated.items()}}, path)


# --- one run, of ours and of the peer's


def run_once(path: Path, line: Line = "measured") -> dict[str, Any]:
    """Figures of one file. Memory: the highest of the whole process in MB, what it held just before the adjustment
    (program, compiled kernel, input), and the difference in bytes per image observation.
    """
    from mgsgraph.adjustment.adjust import (
        adjust_network,  # the kernel: not before --threads counts
        versions,
    )
    from mgsgraph.compiled import threads

    start = time.perf_counter()
    problem = read_problem(path)
    read = time.perf_counter() - start
    adjust_network(*network(chain(40, 40, shots=5)[0], line))  # its factor has several fronts
    start = time.perf_counter()
    net, settings = network(problem, line)
    built = time.perf_counter() - start
    rays, points, images = problem.u.size, problem.places.shape[0], problem.orientation.shape[0]
    del problem
    forget_peak()
    before = resident()
    solution = adjust_network(net, settings, str(path))
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
        "seconds_network": built,
        **stages,
        "seconds_per_iteration": stages["seconds_solve"] / max(solution.iterations, 1),
        "peak_memory_mb": peak / MEGABYTE,
        "memory_before_mb": before / MEGABYTE,
        "bytes_per_observation": (peak - before) / rays,
        "versions": versions(),
    }


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
    """Reset the highest memory, so that reading the input doesn't hide the adjustment; Linux only.

    Memory freed after reading the input is returned to the system first: reused, it would not count.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return  # the figure is then an upper bound


def require_peer(program: Path) -> None:
    """Raise InputError unless the peer's program can be run."""
    if not program.is_file():
        raise InputError(str(program), "no such file", "the peer's program peer_ceres", _REMEDY)
    if not os.access(program, os.X_OK):
        raise InputError(str(program), "not executable", "the peer's program peer_ceres", _REMEDY)


def run_peer(program: Path, problem: Path, variant: str, threads: int) -> dict[str, Any]:
    """Figures of one run; InputError when the program fails or doesn't print the peer's line of JSON."""
    command = [str(program), str(problem), *VARIANTS[variant], *TOLERANCE, "--threads", str(threads)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, errors="replace")
    except OSError as error:
        raise InputError(str(program), f"can't be run ({error.strerror or error})", remedy=_REMEDY) from None
    try:
        answer = json.loads(done.stdout)
        figures: dict[str, Any] = {ours: float(answer[theirs]) for theirs, ours in _KEYS.items()}
    except (ValueError, KeyError, TypeError):
        last = (done.stderr.strip() or done.stdout.strip() or "nothing").splitlines()[-1][:200]
        found = f"exit status {done.returncode}, saying {last!r}"
        raise InputError(f"{program}, {variant}", found, "one line of JSON with its figures", _REMEDY) from None
    figures["converged"] = answer.get("termination") == "CONVERGENCE"
    if "cov_schur_t" in answer:
        figures["seconds_covariance"] = float(answer["cov_schur_t"])
    return figures


# --- all runs


def programs(peer: Path | None) -> list[str]:
    """Programs that run in every repeat."""
    return [OURS, *(VARIANTS if peer else ())]


def ours(problem: Path, line: str, threads: int) -> dict[str, Any]:
    """Figures of one run of ours, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "figures.json")
        command = [sys.executable, str(PROGRAM), "speed", "--problem", str(problem), "--json", str(out), "--line", line]
        command += ["--threads", str(threads)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if not out.is_file():
            last = (done.stderr.strip() or "nothing").splitlines()[-1].removeprefix("benchmark speed: error: ")
            raise InputError(f"run of {problem}, exit status {done.returncode}", last)
        figures: dict[str, Any] = json.loads(out.read_text(encoding="utf-8"))
    return figures


def repeated(
    size: str, problem: Path, peer: Path | None, options: argparse.Namespace
) -> dict[str, list[dict[str, Any]]]:
    """Figures of all programs on one file, repeats interleaved; each repeat begins with another program."""
    runs: dict[str, list[dict[str, Any]]] = {name: [] for name in programs(peer)}
    for turn in range(options.repeat):
        order = programs(peer)
        for name in order[turn % len(order) :] + order[: turn % len(order)]:
            if turn and (size, name) in ONCE:
                continue
            show(f"{size}: {name}, {turn + 1} of {options.repeat}")
            if name == OURS or peer is None:
                runs[name].append(ours(problem, options.line, options.threads))
            else:
                runs[name].append(run_peer(peer, problem, name, options.threads))
    show("")
    return runs


def problem_file(size: str, options: argparse.Namespace, scratch: Path) -> Path:
    """The file of a size: the one in --work, or a new one."""
    path = (options.work or scratch) / f"{size}.bin"
    if path.is_file():
        read_problem(path)
    else:
        show(f"{size}: making it")
        write_problem(made(size, options.shared)[0], path)
    return path


def measure(options: argparse.Namespace) -> int:
    """Run all sizes, write the page, judge the figures; the exit status."""
    sizes = options.sizes or list(SIZES)
    if options.peer:
        require_peer(options.peer)
    if (options.gate or options.update_baseline) and not options.peer:
        raise InputError("gate", "no peer to compare with", "its program", "build it and name it with --peer")
    limits = read_baseline(options.baseline) if options.gate or options.update_baseline else {}
    results = {}
    with tempfile.TemporaryDirectory() as folder:
        for size in sizes:
            results[size] = repeated(size, problem_file(size, options, Path(folder)), options.peer, options)
    figures = {name: value for size, runs in results.items() for name, value in metrics(size, runs).items()}
    text = page(results, options.repeat, options.threads)
    print(text)
    if options.markdown:
        write_text(text, options.markdown)
    if options.json:
        write_json({"runs": results, "metrics": figures}, options.json)
    if options.update_baseline:
        update_baseline(options.baseline, figures)
    failed = judged(limits, figures, sizes) if options.gate else []
    failed += [
        f"FAILED {size}: ours did not converge ({runs[OURS][0]['message']})"
        for size, runs in results.items()
        if not all(run["converged"] for run in runs[OURS])
    ]
    print("\n".join(failed or (["The gate is passed."] if options.gate else [])))
    return 1 if failed else 0


def one_problem(options: argparse.Namespace) -> int:
    """One file, once, its figures as JSON."""
    figures = run_once(options.problem, options.line)
    if options.json:
        write_json(figures, options.json)
    else:
        print(json.dumps(figures, indent=1))
    if not figures["converged"]:
        print(f"benchmark speed: {options.problem}: {figures['message']}", file=sys.stderr)
    return 0 if figures["converged"] else 1


# --- the page


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
        own_runs = runs[OURS]
        counts = (f"{own_runs[0][key]:,}" for key in ("images", "points", "observations"))
        seconds = (number(middle(own_runs, f"seconds_{stage}")) for stage in STAGES)
        last = (f"{middle(own_runs, 'iterations'):g}", number(middle(own_runs, "seconds_per_iteration")))
        memory = (f"{middle(own_runs, 'peak_memory_mb'):.0f}", f"{middle(own_runs, 'bytes_per_observation'):.0f}")
        rows.append((size, *counts, *seconds, *last, *memory))
    return table((*head, "s / iteration", "highest MB", "memory, B / obs."), rows)


def ratio_table(results: Mapping[str, Runs]) -> list[str]:
    """Ratios of solve and covariance."""
    rows = []
    for size, runs in results.items():
        solves = [ratio(runs, variant, "seconds_solve") for variant in VARIANTS]
        cells = [str(value) if value else "-" for value in (*solves, ratio(runs, "custom", "seconds_covariance"))]
        rows.append((size, *cells))
    return table(("size", *(f"{variant}, solve" for variant in VARIANTS), "custom, covariance"), rows)


def cost_table(results: Mapping[str, Runs]) -> list[str]:
    """Solve seconds and iterations of every program; covariance; final cost and its difference."""
    rows = []
    for size, by_program in results.items():
        cells = [size]
        for name in (OURS, *VARIANTS):
            runs = by_program.get(name, ())
            cells.append(f"{number(middle(runs, 'seconds_solve'))} ({middle(runs, 'iterations'):g})" if runs else "-")
        cells += [number(middle(by_program.get(name, ()), "seconds_covariance")) for name in (OURS, "custom")]
        gap = cost_difference(by_program)
        cells += [f"{middle(by_program[OURS], 'cost_final'):.12g}", "-" if math.isnan(gap) else f"{gap:.1e}"]
        rows.append(tuple(cells))
    names = (f"{name}, solve (iterations)" for name in (OURS, *VARIANTS))
    return table(("size", *names, f"{OURS}, covariance", "custom, covariance", "cost", "relative difference"), rows)


# --- the command line


def speed(parser: OneLine, arguments: list[str]) -> int:
    """Seconds, memory and cost of this program on problems of the peer's model, beside the C++ peer in the same run.

    Every run is a process of its own, and every repeat runs all programs in turn, so that other load of the machine
    affects all of them; figures are medians over the repeats, ratios the peer's seconds over ours. Not in the figures:
    compiling the kernel, or loading it from its cache. A tiny problem of the same kind is adjusted first, so that the
    file's own adjustment finds everything compiled, as a second adjustment in one session would.
    """
    parser.add_argument("sizes", nargs="*", metavar="SIZE", help=f"of {', '.join(SIZES)}; all of them when absent")
    parser.add_argument("--peer", type=Path, help="the peer's program peer_ceres, built")
    parser.add_argument("--shared", type=Path, default=SHARED, help="folder with the peer's gen.py")
    parser.add_argument("--work", type=Path, help="folder of problem files, SIZE.bin, used and left there")
    parser.add_argument("--repeat", type=at_least(1), default=5)
    parser.add_argument("--threads", type=at_least(1), default=os.cpu_count() or 1, help="of all programs alike")
    parser.add_argument("--line", choices=("measured", "predicted"), default="measured", help="measured is the peer's")
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--markdown", type=Path, help="file for the tables")
    parser.add_argument("--gate", action="store_true", help="hold the figures against the baseline")
    parser.add_argument("--update-baseline", action="store_true", help="put them into it; do so deliberately")
    parser.add_argument("--baseline", type=Path, default=BASELINE)
    parser.add_argument("--problem", type=Path, help="one file of the peer's format, in place of sizes")
    options = parser.parse_args(arguments)
    for size in options.sizes:
        if size not in SIZES:
            parser.error(f"no size {size!r}; there are {', '.join(SIZES)}")
    if len(set(options.sizes)) < len(options.sizes):
        parser.error("a size named twice")
    if options.sizes and options.problem:
        parser.error("sizes and --problem exclude one another")
    if (options.gate or options.update_baseline) and (options.problem or options.line != "measured"):
        parser.error("the gate judges sizes, in the peer's form")
    os.environ["NUMBA_NUM_THREADS"] = str(options.threads)  # before anything imports numba

    def job() -> int:
        require_writable(options.json, options.markdown)
        return one_problem(options) if options.problem else measure(options)

    return status(parser.prog, job)
