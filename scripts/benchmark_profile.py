"""Where the time of one iteration goes: stages timed, their operations counted, beside what the machine can do.

    python scripts/benchmark_profile.py [--problem FILE.bin] [--page docs/speed.md --figure docs/speed.png]
    python scripts/benchmark_profile.py --problem FILE.bin --json OUT

Without a file the peer's size L is made by its generator. `--page` puts the tables between the page's two marks and
leaves its words alone. Seconds are medians, peaks the best of as many. Exit status: 0 done, 2 bad input, 130
interrupted. What is counted comes from benchmark_stages, in a process of its own, where nothing is compiled.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from benchmark import OneLine, at_least
from benchmark_blocks import SHARED, made
from benchmark_profile_page import Profile, Sweep, draw, into_page, tables
from benchmark_run import require_writable, write_json, write_text
from peer_problem import write_problem

from mgsgraph.errors import InputError, MgsgraphError

if TYPE_CHECKING:  # numba counts threads when it is imported: not before --threads is read
    from mgsgraph.adjustment.graph import BundleGraph, Layout
    from mgsgraph.factors.bundle import Reduction

CALLS = 300
"""Tiles in a row that make one timing of a stage."""

@dataclass(eq=False)
class Recorder:
    """Sweeps in this process, and remembers where each began."""

    seen: list[tuple[Any, Any]] = field(default_factory=list)

    def reduction(
        self, layout: "Layout", rows: Any, orientation: Any, system: bool, points: Any
    ) -> "Reduction":
        """All points solved (and eliminated)."""
        from mgsgraph.adjustment.graph.bundle import IN_PROCESS

        if system:
            self.seen.append((orientation.copy(), points))
        return IN_PROCESS.reduction(layout, rows, orientation, system, points)

    def __getattr__(self, name: str) -> Any:
        from mgsgraph.adjustment.graph import bundle

        return getattr(bundle.IN_PROCESS, name)


def middle(run: Callable[[], object], repeat: int, clock: Callable[[], float] = time.perf_counter) -> float:
    """Milliseconds of a call, the median of many."""
    taken = []
    for _ in range(repeat):
        start = clock()
        run()
        taken.append(1e3 * (clock() - start))
    return median(taken)


def profile(path: Path, line: str, repeat: int, name: str) -> Profile:
    """Measure everything on one problem file."""
    import numpy as np
    from benchmark_peaks import peaks
    from benchmark_stages import laid_out

    counts = counted(path, line)
    layout = laid_out(path, line)
    from mgsgraph.adjustment.graph import BundleGraph

    recorder = Recorder()
    graph = BundleGraph(layout, sweeper=recorder)
    iterations, sweeps, iteration, afterwards = loop(graph, recorder, repeat)
    rows, alike = layout.rows, same_sights(layout)
    points = {key: int(np.isin(rows.piece[:, 0], mine) @ rows.piece[:, 2]) for key, mine in alike.items()}
    patterns = {key: len(mine) for key, mine in alike.items()}
    stages, sizes = timed(layout, repeat)
    rays = int(layout.network.rays.point.size)
    arrays = {"constants": rows.data.nbytes, "weights": rows.weight.nbytes, "first places": rows.start.nbytes}
    arrays["kinds, tables"] = sum(array.nbytes for array in rows) - sum(arrays.values())
    arrays["places, states"] = 25 * rows.kind.size
    held = {key: size / rays for key, size in arrays.items()}
    best = peaks(max(sizes.values()) // 8, threads(), repeat)
    found = (iteration, afterwards, sweeps, stages, counts, patterns, held, sizes, best)
    return Profile(name, threads(), repeat, iterations, rays, points, *found)


def threads() -> int:
    """Threads of the kernel."""
    import numba

    return int(numba.get_num_threads())


def counted(path: Path, line: str) -> dict[str, dict[str, dict[str, float]]]:
    """Operations per point, counted in a process that compiles nothing."""
    command = [sys.executable, str(Path(__file__).with_name("benchmark_stages.py")), str(path), line]
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if done.returncode:
        raise InputError(f"counting {path}", (done.stderr.strip() or "nothing said").splitlines()[-1])
    found: dict[str, dict[str, dict[str, float]]] = json.loads(done.stdout)
    if not found:
        raise InputError(str(path), "no pattern with a full tile of points", "a larger problem")
    return found


def loop(
    graph: "BundleGraph", recorder: Recorder, repeat: int
) -> tuple[int, list[Sweep], dict[str, float], dict[str, float]]:
    """The optimisation once, then each of its parts many times, where it had them."""
    import gtsam
    import numba
    import numpy as np
    from mgsgraph.adjustment.posterior import orientation_covariance, point_covariances
    from mgsgraph.adjustment.problems import BundleProblem, solve_bundle
    from mgsgraph.adjustment.settings import SolverSettings

    layout, count = graph.layout, numba.get_num_threads()
    start = np.zeros(layout.columns)
    outcome, last = solve_bundle(graph, start, None, SolverSettings(), lambda _: None)
    seen = list(recorder.seen)
    sweeps = []
    for x, begin in seen:
        again = partial(graph.reduction, x, True, begin)
        together = middle(again, repeat)
        numba.set_num_threads(1)
        alone = middle(again, repeat, time.thread_time)
        numba.set_num_threads(count)
        sweeps.append(Sweep(mean_steps(layout, x, begin), together, alone))
    problem, linear = BundleProblem(graph, last), graph.linear(last)
    ordering = gtsam.Ordering.ColamdGaussianFactorGraph(linear)
    step, (x, begin) = linear.optimize(ordering), seen[-1]
    iteration = {
        "sweep with system": median(sweep.milliseconds for sweep in sweeps),
        "Hessian factors": middle(lambda: graph.linear(last), repeat),
        "GTSAM's elimination": middle(lambda: linear.optimize(ordering), repeat),
        "moving the state": middle(lambda: problem.moved(start, step), repeat),
    }
    joint = orientation_covariance(graph, last)
    afterwards = {
        "a sweep for the cost alone": middle(lambda: graph.reduction(x, False, begin), repeat),
        "covariance of the orientation": middle(lambda: orientation_covariance(graph, last), repeat),
        "covariance of the points": middle(
            lambda: point_covariances(layout, graph.rows, outcome.state, last.points, joint), repeat
        ),
    }
    return len(outcome.history), sweeps, iteration, afterwards


def same_sights(layout: "Layout") -> dict[str, list[int]]:
    """Patterns whose points see the same kinds of sights, by the names of `benchmark_stages.PATTERNS`."""
    import numpy as np
    from benchmark_stages import PATTERNS, piece_of

    rows = layout.rows
    kinds = [tuple(part.tolist()) for part in np.split(rows.sight_kind, rows.pattern_sight[1:-1])]
    return {
        name: [pattern for pattern, kind in enumerate(kinds) if kind == sights]
        for name, sights in PATTERNS.items()
        if piece_of(rows, sights) is not None
    }


def mean_steps(layout: "Layout", x: Any, begin: Any) -> dict[str, float]:
    """Inner steps of a point in a sweep, their mean, by pattern."""
    import numpy as np
    from benchmark_timing import inner_steps
    from mgsgraph.factors import tile

    size, base, depth = tile.workspace(layout.rows)
    places = (layout.rows.start if begin is None else begin.points).copy()
    steps, points = (np.zeros(layout.rows.pattern_group.size) for _ in range(2))
    inner_steps(layout.rows, layout.model, x, places, np.zeros(size), base, depth, steps)
    np.add.at(points, layout.rows.piece[:, 0], layout.rows.piece[:, 2])
    return {name: float(steps[mine].sum() / points[mine].sum()) for name, mine in same_sights(layout).items()}


def timed(layout: "Layout", repeat: int) -> tuple[dict[str, dict[str, float]], dict[str, int]]:
    """ns per point by pattern and stage (of `spread`, per pattern), and bytes of each pattern's tile."""
    from benchmark_stages import INNER, PATTERNS, piece_of, settle, tile_of
    from benchmark_timing import DRIVERS, drive
    from mgsgraph.factors.lanes import LANES

    found, sizes = {}, {}
    for name, kinds in PATTERNS.items():
        piece = piece_of(layout.rows, kinds)
        if piece is None:
            continue
        t, work = tile_of(layout, piece)
        for stage in ("load", *INNER, *list(INNER) * 3, "store", "load", *INNER):
            drive(DRIVERS[stage], t, work, 1)
        runs: dict[str, list[float]] = {stage: [] for stage in DRIVERS}
        for _ in range(repeat):
            for stage, driver in DRIVERS.items():
                runs[stage].append(drive(driver, t, work, CALLS))
        found[name] = {stage: 1e9 * median(taken) / CALLS for stage, taken in runs.items()}
        found[name]["factorise"] -= found[name]["normal equations"]
        for stage in found[name]:
            found[name][stage] /= 1 if stage == "spread" else LANES
        sizes[name] = 8 * (t.base + len(kinds) * t.depth)
    return found, sizes


def arguments(given: list[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = OneLine(prog="profile", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problem", type=Path, help="file of the peer's format; its size L when absent")
    parser.add_argument("--shared", type=Path, default=SHARED, help="folder with the peer's gen.py")
    parser.add_argument("--line", choices=("measured", "predicted"), default="measured", help="measured is the peer's")
    parser.add_argument("--threads", type=at_least(1), default=os.cpu_count() or 1)
    parser.add_argument("--repeat", type=at_least(1), default=15)
    parser.add_argument("--page", type=Path, help="page whose tables are to be renewed, between its two marks")
    parser.add_argument("--figure", type=Path, help="PNG")
    parser.add_argument("--json", type=Path, help="file for the figures")
    return parser.parse_args(given)


def measure(wanted: argparse.Namespace) -> None:
    """Profile, and what is to be written of it."""
    require_writable(wanted.page, wanted.figure, wanted.json)
    if wanted.page:
        into_page("", wanted.page)  # before long work
    with tempfile.TemporaryDirectory() as folder:
        path, name = wanted.problem, str(wanted.problem and wanted.problem.name)
        if path is None:
            path, name = Path(folder, "L.bin"), "L"
            write_problem(made("L", wanted.shared)[0], path)
        found = profile(path, wanted.line, wanted.repeat, name)
    text = tables(found)
    if wanted.json:
        write_json(asdict(found), wanted.json)
    if wanted.figure:
        draw(found, wanted.figure)
    if wanted.page:
        write_text(into_page(text, wanted.page), wanted.page)
    else:
        print(text)


def main() -> int:
    wanted = arguments()
    os.environ["NUMBA_NUM_THREADS"] = str(wanted.threads)  # before anything imports numba
    try:
        measure(wanted)
    except MgsgraphError as error:
        print(f"profile: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("profile: interrupted", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
