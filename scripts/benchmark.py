"""How fast, and how large: this program on problems of the peer's model, beside the C++ peer in the same run.

    python scripts/benchmark.py [S M L XL Kaguya] [--peer PEER_CERES] [--repeat 5] [--json OUT] [--markdown OUT]
    python scripts/benchmark.py L XL --peer PEER_CERES --gate          # against baseline.json; exit status 1 if worse
    python scripts/benchmark.py --problem FILE.bin --json OUT          # one file, once
    python scripts/benchmark.py --scaling [--out docs]                 # seconds and bytes against points and images

Every run is a process of its own, and every repeat runs all programs in turn, so that what else the machine does hits
all alike; figures are medians over the repeats, ratios the peer's seconds over ours. Seconds of an adjustment begin
with the compiled kernel in memory (see benchmark_run). Exit status: 0 done, 1 a limit missed or not converged, 2 bad
input, 130 interrupted.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import benchmark_gate as gate
from benchmark_blocks import SHARED, SIZES, made
from benchmark_command import OneLine, at_least, show, status
from benchmark_peer import VARIANTS, require_peer, run_peer
from benchmark_run import require_writable, run, write_json, write_text
from benchmark_table import page
from peer_problem import read_problem, write_problem

from mgsgraph.errors import InputError

ROOT = Path(__file__).resolve().parents[1]
ONCE = {("Kaguya", "custom")}
"""Runs that aren't repeated: the hand-written C++ fills the dense reduced system of 6750 unknowns, two minutes long."""


def programs(peer: Path | None) -> list[str]:
    """What runs in every repeat."""
    return [gate.OURS, *(VARIANTS if peer else ())]


def ours(problem: Path, line: str, threads: int) -> dict[str, Any]:
    """Figures of one run of ours, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "figures.json")
        command = [sys.executable, __file__, "--problem", str(problem), "--json", str(out), "--line", line]
        command += ["--threads", str(threads)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if not out.is_file():
            last = (done.stderr.strip() or "nothing").splitlines()[-1].removeprefix("benchmark: error: ")
            raise InputError(f"run of {problem}, exit status {done.returncode}", last)
        figures: dict[str, Any] = json.loads(out.read_text(encoding="utf-8"))
    return figures


def repeated(
    size: str, problem: Path, peer: Path | None, wanted: argparse.Namespace
) -> dict[str, list[dict[str, Any]]]:
    """Figures of all programs on one file, repeats interleaved; each repeat begins with another program."""
    runs: dict[str, list[dict[str, Any]]] = {name: [] for name in programs(peer)}
    for number in range(wanted.repeat):
        order = programs(peer)
        for name in order[number % len(order) :] + order[: number % len(order)]:
            if number and (size, name) in ONCE:
                continue
            show(f"{size}: {name}, {number + 1} of {wanted.repeat}")
            if name == gate.OURS or peer is None:
                runs[name].append(ours(problem, wanted.line, wanted.threads))
            else:
                runs[name].append(run_peer(peer, problem, name, wanted.threads))
    show("")
    return runs


def problem_file(size: str, wanted: argparse.Namespace, scratch: Path) -> Path:
    """The file of a size: the one in --work, or a new one."""
    path = (wanted.work or scratch) / f"{size}.bin"
    if path.is_file():
        read_problem(path)
    else:
        show(f"{size}: making it")
        write_problem(made(size, wanted.shared)[0], path)
    return path


def measure(wanted: argparse.Namespace) -> int:
    """All sizes, the page, and the gate."""
    sizes = wanted.sizes or list(SIZES)
    if wanted.peer:
        require_peer(wanted.peer)
    if (wanted.gate or wanted.update_baseline) and not wanted.peer:
        raise InputError("gate", "no peer to compare with", "its program", "build it and name it with --peer")
    limits = gate.read_baseline(wanted.baseline) if wanted.gate or wanted.update_baseline else {}
    results = {}
    with tempfile.TemporaryDirectory() as folder:
        for size in sizes:
            results[size] = repeated(size, problem_file(size, wanted, Path(folder)), wanted.peer, wanted)
    found = {name: value for size, runs in results.items() for name, value in gate.metrics(size, runs).items()}
    text = page(results, wanted.repeat, wanted.threads)
    print(text)
    if wanted.markdown:
        write_text(text, wanted.markdown)
    if wanted.json:
        write_json({"runs": results, "metrics": found}, wanted.json)
    if wanted.update_baseline:
        gate.update_baseline(wanted.baseline, found)
    failed = gate.judged(limits, found, sizes) if wanted.gate else []
    failed += [
        f"FAILED {size}: ours did not converge ({runs[gate.OURS][0]['message']})"
        for size, runs in results.items()
        if not all(one["converged"] for one in runs[gate.OURS])
    ]
    print("\n".join(failed or (["The gate is passed."] if wanted.gate else [])))
    return 1 if failed else 0


def one_problem(wanted: argparse.Namespace) -> int:
    """One file, once, its figures as JSON."""
    figures = run(wanted.problem, wanted.line)
    if wanted.json:
        write_json(figures, wanted.json)
    else:
        print(json.dumps(figures, indent=1))
    if not figures["converged"]:
        print(f"benchmark: {wanted.problem}: {figures['message']}", file=sys.stderr)
    return 0 if figures["converged"] else 1


def scaling(wanted: argparse.Namespace) -> int:
    """Figures against points and images, their table and picture."""
    import benchmark_scaling

    require_writable(wanted.out / "scaling.md")

    def measured(problem: Path) -> list[dict[str, Any]]:
        return [ours(problem, wanted.line, wanted.threads) for _ in range(wanted.repeat)]

    figures = benchmark_scaling.sweep(measured, wanted.most_points, wanted.most_images, show)
    text = benchmark_scaling.page(figures, wanted.repeat, wanted.threads)
    benchmark_scaling.draw(figures, wanted.out / "scaling.png")
    write_text(text, wanted.out / "scaling.md")
    if wanted.json:
        write_json(benchmark_scaling.as_record(figures), wanted.json)
    print(text)
    return 0


def arguments(given: list[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = OneLine(prog="benchmark", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
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
    parser.add_argument("--baseline", type=Path, default=gate.BASELINE)
    parser.add_argument("--problem", type=Path, help="one file of the peer's format, in place of sizes")
    parser.add_argument("--scaling", action="store_true", help="chains of all sizes, in place of sizes")
    parser.add_argument("--most-points", type=at_least(1000), default=1_000_000, help="of the scaling")
    parser.add_argument("--most-images", type=at_least(2), default=500, help="of the scaling")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder for scaling.md and scaling.png")
    wanted = parser.parse_args(given)
    for size in wanted.sizes:
        if size not in SIZES:
            parser.error(f"no size {size!r}; there are {', '.join(SIZES)}")
    if len(set(wanted.sizes)) < len(wanted.sizes):
        parser.error("a size named twice")
    if sum([bool(wanted.sizes), wanted.problem is not None, wanted.scaling]) > 1:
        parser.error("sizes, --problem and --scaling exclude one another")
    if (wanted.gate or wanted.update_baseline) and (wanted.problem or wanted.scaling or wanted.line != "measured"):
        parser.error("the gate judges sizes, in the peer's form")
    return wanted


def main() -> int:
    wanted = arguments()
    os.environ["NUMBA_NUM_THREADS"] = str(wanted.threads)  # before anything imports numba

    def job() -> int:
        require_writable(wanted.json, wanted.markdown)
        if wanted.problem:
            return one_problem(wanted)
        return scaling(wanted) if wanted.scaling else measure(wanted)

    return status("benchmark", job)


if __name__ == "__main__":
    sys.exit(main())
