"""Where the time of one iteration goes: stages timed, their operations counted, beside what the machine can do.

    python scripts/benchmark_profile.py [--problem FILE.bin] [--page docs/speed.md --figure docs/speed.png]
    python scripts/benchmark_profile.py --problem FILE.bin --json OUT

Without a file the peer's size L is made by its generator. `--page` puts the tables between the page's two marks and
leaves its words alone. Times are medians of the processor's, peaks the best of as many. Exit status: 0 done, 2 bad
input, 130 interrupted. The counts come from benchmark_stages, in a process of its own, where nothing is compiled.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from benchmark_blocks import SHARED, made
from benchmark_command import OneLine, at_least, status
from benchmark_profile_page import Profile, Sweep, draw, into_page, tables
from benchmark_run import require_writable, write_json, write_text
from peer_problem import write_problem

from mgsgraph.errors import InputError

if TYPE_CHECKING:  # numba counts threads when it is imported: not before --threads is read
    from mgsgraph.adjustment.graph import Layout
    from mgsgraph.kernel.bundle import Reduction

CALLS = 300
"""Tiles in a row that make one timing of a stage."""

Key = tuple[Any, ...]
"""What was timed."""

Job = Callable[[], tuple[float, float]]
"""Seconds by the wall and by the processor."""

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


def seconds(run: Callable[[], object]) -> tuple[float, float]:
    """Seconds of a call, and those of the processor, all threads together."""
    start, used = time.perf_counter(), time.process_time()
    run()
    return time.perf_counter() - start, time.process_time() - used


def own(run: Callable[[], float]) -> tuple[float, float]:
    """Of a call that times itself by the processor."""
    taken = run()
    return taken, taken


def interleaved(jobs: Mapping[Key, Job], repeat: int) -> dict[Key, tuple[float, float]]:
    """ms of all jobs, each in its turn, again and again: what else the machine does hits all alike.

    The least by the clock on the wall, and the median by the processor's.
    """
    for run in jobs.values():
        run()  # compiles, and fetches what is in memory
    taken: dict[Key, list[tuple[float, float]]] = {key: [] for key in jobs}
    for _ in range(repeat):
        for key, run in jobs.items():
            taken[key].append(run())
    return {
        key: (1e3 * min(wall for wall, _ in pairs), 1e3 * median(used for _, used in pairs))
        for key, pairs in taken.items()
    }


def profile(path: Path, line: str, repeat: int, name: str) -> Profile:
    """Measure everything on one problem file."""
    import numpy as np
    from benchmark_peaks import peak_jobs
    from benchmark_stages import laid_out

    counts = counted(path, line)
    layout = laid_out(path, line)
    recorder = Recorder()
    iterations, seen, jobs = solved(layout, recorder)
    sizes, of_stage = stage_jobs(layout)
    best = peak_jobs(max(sizes.values()) // 8, threads())
    jobs |= of_stage | {("peak", *key): partial(own, run) for key, (run, _) in best.items()}
    ms = interleaved(jobs, repeat)
    rows, alike = layout.rows, same_sights(layout)
    sweeps = [
        Sweep(mean_steps(layout, *state), *ms["sweep", k], ms["alone", k][1]) for k, state in enumerate(seen)
    ]
    parts = {group: {key[1]: value for key, value in ms.items() if key[0] == group} for group in ("part", "after")}
    rays = int(layout.network.rays.point.size)
    middle = (median(sweep.milliseconds for sweep in sweeps), median(sweep.processor for sweep in sweeps))
    return Profile(
        problem=name,
        threads=threads(),
        repeat=repeat,
        iterations=iterations,
        rays=rays,
        points={key: int(np.isin(rows.piece[:, 0], mine) @ rows.piece[:, 2]) for key, mine in alike.items()},
        patterns={key: len(mine) for key, mine in alike.items()},
        iteration={"sweep with system": middle, **parts["part"]},
        afterwards=parts["after"],
        sweeps=sweeps,
        stages={key: per_point(ms, key) for key in sizes},
        counts=counts,
        held={key: size / rays for key, size in held(rows).items()},
        tile=sizes,
        peaks={f"{key[0]}, {key[1]}": 1e3 * work / ms["peak", *key][0] for key, (_, work) in best.items()},
    )


def held(rows: Any) -> dict[str, float]:
    """Bytes of the kernel's arrays."""
    arrays = {"constants": rows.data.nbytes, "weights": rows.weight.nbytes, "first places": rows.start.nbytes}
    arrays["kinds, tables"] = sum(array.nbytes for array in rows) - sum(arrays.values())
    return {**arrays, "places, states": 25 * rows.kind.size}


def per_point(ms: Mapping[Key, tuple[float, float]], name: str) -> dict[str, float]:
    """ns per point of each stage; of `spread`, per pattern."""
    from mgsgraph.kernel.lanes import LANES

    found = {key[2]: 1e6 * value[1] / CALLS for key, value in ms.items() if key[:2] == ("stage", name)}
    found["factorise"] -= found["normal equations"]
    return {stage: value / (1 if stage == "spread" else LANES) for stage, value in found.items()}


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


def solved(
    layout: "Layout", recorder: Recorder
) -> tuple[int, list[tuple[Any, Any]], dict[Key, Job]]:
    """The optimisation once: its iterations, where its sweeps began, and its parts, to be timed there."""
    import gtsam
    import numpy as np

    from mgsgraph.adjustment.graph import BundleGraph
    from mgsgraph.adjustment.posterior import orientation_covariance, point_covariances
    from mgsgraph.adjustment.problems import BundleProblem, solve_bundle
    from mgsgraph.adjustment.settings import SolverSettings

    graph, start = BundleGraph(layout, sweeper=recorder), np.zeros(layout.columns)
    outcome, last = solve_bundle(graph, start, None, SolverSettings(), lambda _: None)
    seen, graph = list(recorder.seen), BundleGraph(layout)
    problem, linear = BundleProblem(graph, last), graph.linear(last)
    ordering = gtsam.Ordering.ColamdGaussianFactorGraph(linear)
    step, joint, (x, begin) = linear.optimize(ordering), orientation_covariance(graph, last), seen[-1]
    runs: dict[Key, Callable[[], object]] = {
        ("part", "Hessian factors"): lambda: graph.linear(last),
        ("part", "GTSAM's elimination"): lambda: linear.optimize(ordering),
        ("part", "moving the state"): lambda: problem.moved(start, step),
        ("after", "a sweep for the cost alone"): lambda: graph.reduction(x, False, begin),
        ("after", "covariance of the orientation"): lambda: orientation_covariance(graph, last),
        ("after", "covariance of the points"): lambda: point_covariances(
            layout, graph.rows, outcome.state, last.points, joint
        ),
    }
    jobs: dict[Key, Job] = {key: partial(seconds, run) for key, run in runs.items()}
    for k, state in enumerate(seen):
        again = partial(graph.reduction, state[0], True, state[1])
        jobs["sweep", k], jobs["alone", k] = partial(seconds, again), partial(alone, again)
    return len(outcome.history), seen, jobs


def alone(run: Callable[[], object]) -> tuple[float, float]:
    """Seconds with one thread."""
    import numba

    count = numba.get_num_threads()
    numba.set_num_threads(1)
    taken = seconds(run)
    numba.set_num_threads(count)
    return taken


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

    from mgsgraph.kernel import tile

    size, base, depth = tile.workspace(layout.rows)
    places = (layout.rows.start if begin is None else begin.points).copy()
    steps, points = (np.zeros(layout.rows.pattern_group.size) for _ in range(2))
    inner_steps(layout.rows, layout.model, x, places, np.zeros(size), base, depth, steps)
    np.add.at(points, layout.rows.piece[:, 0], layout.rows.piece[:, 2])
    return {name: float(steps[mine].sum() / points[mine].sum()) for name, mine in same_sights(layout).items()}


def stage_jobs(layout: "Layout") -> tuple[dict[str, int], dict[Key, Job]]:
    """Bytes of a tile by pattern, and its stages, to be timed."""
    from benchmark_stages import INNER, PATTERNS, SETTLING, piece_of, tile_of
    from benchmark_timing import DRIVERS, drive

    sizes, jobs = dict[str, int](), dict[Key, Job]()
    for name, kinds in PATTERNS.items():
        piece = piece_of(layout.rows, kinds)
        if piece is None:
            continue
        t, work = tile_of(layout, piece)
        for stage in ("load", *list(INNER) * SETTLING, "store"):
            drive(DRIVERS[stage], t, work, 1)
        for stage, driver in DRIVERS.items():
            jobs["stage", name, stage] = partial(own, partial(drive, driver, t, work, CALLS))
        sizes[name] = 8 * (t.base + len(kinds) * t.depth)
    return sizes, jobs


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
    return status("profile", lambda: measure(wanted))


if __name__ == "__main__":
    sys.exit(main())
