"""How fast a GPU adjusts, and how much of it a sweep uses: chains like the peer's problems, a Kaguya-sized block.

For a bare machine: needs NumPy, SciPy, numba-cuda and CuPy, neither GTSAM nor files nor network; run it from a checkout
by `python scripts/benchmark_gpu.py --out gpu_times.md`. Problems are made here. What is timed: making the problem,
laying it out, the first adjustment (kernels are compiled, rows sent), the median of more of them; a sweep by itself,
and the covariances of all points.
With NUMBA_ENABLE_CUDASIM=1 the smallest problem shows that the program works.
"""

import json
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]


class _Name(type):
    """A name of a missing library."""

    def __getattr__(cls, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return _Name(name, (), {})

    def __or__(cls, other: Any) -> Any:
        return other

    def __ror__(cls, other: Any) -> Any:
        return other


class _Absent(ModuleType):
    """A library that isn't installed: its names serve annotations only."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return _Name(name, (), {})


def _prepare_imports() -> None:
    """Find the package in this checkout, and replace missing libraries that are not called."""
    if find_spec("mgsgraph") is None:
        sys.path.insert(0, str(ROOT))
    absent = [name for name in ("gtsam", "threadpoolctl", "pyarrow") if find_spec(name) is None]
    for name in absent:
        sys.modules[name] = _Absent(name)
    if "pyarrow" in absent:
        sys.modules["pyarrow.compute"] = sys.modules["pyarrow"].compute = _Absent("pyarrow.compute")
        _name_without_arrow()
    if find_spec("mgsgraph.factors") is None:
        import importlib.util

        import mgsgraph

        spec = importlib.util.spec_from_file_location(
            "mgsgraph.factors", ROOT / "factors" / "__init__.py", submodule_search_locations=[str(ROOT / "factors")]
        )
        assert spec is not None
        assert spec.loader is not None
        sys.modules["mgsgraph.factors"] = mgsgraph.factors = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(mgsgraph.factors)


def _name_without_arrow() -> None:
    """Ids of points, which are numbers here, in columns."""
    import numpy as np

    from mgsgraph.names import Names

    def of(names: Any, source: str = "") -> Names:
        if isinstance(names, Names):
            return names
        data = np.frombuffer("".join(names).encode("ascii"), dtype=np.uint8).copy()
        return Names(data, np.concatenate([[0], np.cumsum([len(name) for name in names], dtype=np.int64)]))

    Names.of = of  # type: ignore[method-assign, assignment]
    Names.first_repeated = None  # type: ignore[assignment]


_prepare_imports()

import numpy as np  # noqa: E402
from peer_blocks import chain, kaguya  # noqa: E402
from peer_problem import PeerProblem, network  # noqa: E402
from study import at_least, command, machine, require_writable, status, table, write_text  # noqa: E402

from mgsgraph.adjustment.batch import BundleProblem, levenberg_marquardt  # noqa: E402
from mgsgraph.adjustment.gpu import find_gpu  # noqa: E402
from mgsgraph.adjustment.gpu.sweeper import GpuSweeper  # noqa: E402
from mgsgraph.adjustment.graph.forms import BundleGraph  # noqa: E402
from mgsgraph.adjustment.graph.layout import lay_out  # noqa: E402
from mgsgraph.kernel.cuda.device import SIMULATED, cuda  # noqa: E402
from mgsgraph.kernel.sweep import COSTS, SYSTEM  # noqa: E402

SIZES: dict[str, Callable[[], tuple[PeerProblem, Any]]] = {
    "S": lambda: chain(2, 40, shots=4),
    "L": lambda: chain(100, 200_000),
    "XL": lambda: chain(200, 1_000_000),
    "Kaguya": kaguya,
    "ten XL": lambda: chain(200, 10_000_000),
}
BOUNDS = {"L": 0.020, "XL": 0.040, "Kaguya": 0.060, "ten XL": 0.12}
"""s, what an adjustment should take on one H100."""


@dataclass
class Times:
    """Of one problem, in s unless stated otherwise."""

    size: str
    images: int
    points: int
    rays: int
    made: float = 0.0
    laid_out: float = 0.0
    first: float = 0.0
    """First adjustment."""
    adjusted: float = 0.0
    """Median of the later ones, s."""
    iterations: int = 0
    cost: float = 0.0
    system: float = 0.0
    """One sweep with normal equations that begins at solved points: one inner step."""
    costs: float = 0.0
    """One sweep for costs alone."""
    covariances: float = 0.0
    """Of all points, with the copy to the host."""


def synchronise() -> None:
    """Wait until the device has finished."""
    if not SIMULATED:
        cuda.synchronize()


def median(job: Callable[[], Any], runs: int) -> float:
    """Median time of a job in s, until the device has finished."""
    times = []
    for _ in range(runs):
        synchronise()
        begin = time.perf_counter()
        job()
        synchronise()
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def timed(size: str, line: Any, runs: int, deterministic: bool) -> Times:
    """Times of one problem."""
    begin = time.perf_counter()
    problem, _ = SIZES[size]()
    net, settings = network(problem, line)
    built = time.perf_counter()
    layout = lay_out(net, settings)
    laid = time.perf_counter()
    times = Times(size, len(net.images), len(net.points), net.rays.point.size, built - begin, laid - built)
    del problem
    sweeper, start = GpuSweeper(find_gpu(), layout, deterministic), np.zeros(layout.columns)

    def adjust() -> Any:
        graph = BundleGraph(layout, layout.rows, sweeper)
        return levenberg_marquardt(BundleProblem(graph), start, settings, lambda _: None)

    times.first, times.adjusted, outcome = median(adjust, 1), median(adjust, runs), adjust()
    times.cost, times.iterations = outcome.cost_final, len(outcome.history)
    last = sweeper.reduction(layout, layout.rows, outcome.state, SYSTEM, None)
    inputs = (layout, layout.rows, outcome.state)
    times.system = median(lambda: sweeper.reduction(*inputs, SYSTEM, last), runs)
    times.costs = median(lambda: sweeper.reduction(*inputs, COSTS, last), runs)
    unit = np.zeros(layout.blocks.target.size)
    times.covariances = median(lambda: sweeper.covariances(*inputs, unit, last.points), runs)
    return times


def page(times: list[Times], line: str, deterministic: bool, runs: int) -> str:
    """The table of a run, in Markdown."""
    head = [
        "problem", "images / points / rays", "made, laid out, s", "first, s", "adjustment, s",
        "iterations", "final cost", "sweep, ms", "costs alone, ms", "covariances, ms",
        "aim, s",
    ]  # fmt: skip
    rows = [
        [
            t.size, f"{t.images} / {t.points:,} / {t.rays:,}", f"{t.made:.1f}, {t.laid_out:.1f}", f"{t.first:.1f}",
            f"{t.adjusted:.4f}", str(t.iterations), f"{t.cost:.9f}",
            f"{1e3 * t.system:.2f}", f"{1e3 * t.costs:.2f}", f"{1e3 * t.covariances:.2f}",
            f"{BOUNDS[t.size]}" if t.size in BOUNDS else "",
        ]
        for t in times
    ]  # fmt: skip
    order = "in a fixed order" if deterministic else "by atomic additions"
    caption = f"{find_gpu().name}. {line.capitalize()} line, sums {order}, medians of {runs} runs. {machine()}"
    return "\n".join(["# Times on a GPU", "", *table(head, rows), "", caption, ""])


def main() -> int:
    """Measure."""
    parser = command(__doc__)
    parser.add_argument("sizes", nargs="*", metavar="SIZE", help=f"of {', '.join(SIZES)}; all but S when absent")
    parser.add_argument("--line", choices=["measured", "predicted"], default="measured")
    parser.add_argument("--runs", type=at_least(1), default=5)
    parser.add_argument("--deterministic", action="store_true", help="sums in a fixed order")
    parser.add_argument("--out", type=Path, help="page in Markdown")
    parser.add_argument("--json", type=Path, help="the same figures")
    options = parser.parse_args()
    sizes = options.sizes or (["S"] if SIMULATED else [size for size in SIZES if size != "S"])
    for size in sizes:
        if size not in SIZES:
            parser.error(f"{size}: expected some of {', '.join(SIZES)}")

    def run() -> int:
        require_writable(options.out, options.json)
        find_gpu()
        results = list[Times]()
        for size in sizes:
            results.append(timed(size, options.line, options.runs, options.deterministic))
            print(json.dumps(asdict(results[-1])), flush=True)  # in case a larger one fails
        text = page(results, options.line, options.deterministic, options.runs)
        print(text)
        if options.out is not None:
            write_text(text, options.out)
        if options.json is not None:
            write_text(json.dumps([asdict(times) for times in results], indent=1) + "\n", options.json)
        return 0

    return status(parser.prog, run)


if __name__ == "__main__":
    sys.exit(main())
