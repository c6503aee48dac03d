"""The benchmarks: ratios and the gate judge right, the peer is heard, what commands and questions cost is watched; that
of GPUs runs on a bare machine and finds the CPU's cost, where the simulator stands in for the device.
"""

import json
import math
import os
import runpy
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from outside import refuses, require

from mgsgraph.adjustment.batch import BundleProblem, levenberg_marquardt
from mgsgraph.adjustment.graph import BundleGraph, lay_out
from mgsgraph.errors import SolverError

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import benchmark  # noqa: E402
import benchmark_costs as costs  # noqa: E402
import benchmark_speed as speed  # noqa: E402
import peer_blocks as blocks  # noqa: E402
import peer_problem as peer  # noqa: E402

FAKE = """#!{python}
import json, sys
assert sys.argv[1].endswith(".bin") and "--threads" in sys.argv
layout = sys.argv[sys.argv.index("--layout") + 1] if "--layout" in sys.argv else "custom"
slow = {{"plain": 4.0, "fused": 2.0, "custom": 1.0}}[layout]
said = {{"t_solve": slow, "iterations": 5, "final_cost": 100.0, "initial_cost": 1e6, "maxrss_mb": 9, "t_load": 0.1,
         "t_build": 0.2, "termination": "CONVERGENCE"}}
if "schur" in sys.argv:
    said["cov_schur_t"] = 3.0
print(json.dumps(said))
"""


def figures(**changes: Any) -> dict[str, Any]:
    """What a run of ours says."""
    common = {
        "images": 2, "points": 400, "observations": 800, "converged": True, "message": "fine", "iterations": 3,
        "cost_final": 100.0 * (1.0 + 1e-10), "seconds_read": 0.1, "seconds_network": 0.1, "seconds_set_up": 0.2,
        "seconds_solve": 0.5, "seconds_covariance": 0.75, "seconds_per_iteration": 0.1, "peak_memory_mb": 50.0,
        "bytes_per_observation": 250.0,
    }  # fmt: skip
    return common | changes


@pytest.fixture
def fake_peer(tmp_path: Path) -> Path:
    path = tmp_path / "peer_ceres"
    path.write_text(FAKE.format(python=sys.executable), encoding="utf-8")
    path.chmod(0o755)
    return path


def called(monkeypatch: pytest.MonkeyPatch, *arguments: str | Path) -> int:
    """Exit status of a command of the benchmark, in this process."""
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")  # so that it is put back
    monkeypatch.setattr(sys, "argv", ["benchmark.py", *map(str, arguments)])
    try:
        return benchmark.main()
    except SystemExit as left:
        return int(left.code or 0)


# --- ratios and the gate


def test_ratios_are_of_medians_and_spread_over_neighbours() -> None:
    runs = {
        speed.OURS: [figures(seconds_solve=one) for one in (1.0, 2.0, 3.0)],
        "plain": [{"seconds_solve": one} for one in (10.0, 10.0, 90.0)],
    }
    found = speed.ratio(runs, "plain", "seconds_solve")
    assert found == speed.Ratio(5.0, 5.0, 30.0)
    assert speed.ratio(runs, "custom", "seconds_solve") is None
    runs["custom"] = [{"seconds_solve": 8.0}]  # not repeated: compared with its neighbour
    assert speed.ratio(runs, "custom", "seconds_solve") == speed.Ratio(4.0, 8.0, 8.0)


def test_metrics_of_a_size() -> None:
    runs = {
        speed.OURS: [figures(), figures(converged=False)],
        "plain": [{"seconds_solve": 5.0, "cost_final": 100.0}] * 2,
        "custom": [{"seconds_solve": 1.0, "cost_final": 200.0, "seconds_covariance": 1.5}] * 2,
    }
    found = speed.metrics("L", runs)
    assert found["L: solve, plain / mgsgraph"] == 10.0
    assert found["L: solve, best / mgsgraph"] == 2.0
    assert found["L: covariance, custom / mgsgraph"] == 2.0
    assert found["L: share that converged"] == 0.5
    assert found["L: cost, relative difference"] == pytest.approx(0.5)  # the worst of the peers
    assert set(speed.metrics("L", {speed.OURS: [figures()]})) == {
        "L: iterations", "L: bytes per observation", "L: share that converged",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("limit", "good", "bad"),
    [
        (speed.Limit("higher", required=12.0), 12.0, 11.9),
        (speed.Limit("higher", value=20.0, tolerance=0.25), 15.0, 14.9),
        (speed.Limit("higher", required=12.0, value=20.0), 15.0, 14.9),  # both bind, the stricter decides
        (speed.Limit("higher", required=12.0, value=13.0), 12.0, 11.9),
        (speed.Limit("lower", required=1e-8), 1e-8, 1.1e-8),
        (speed.Limit("lower", required=300.0, value=100.0), 125.0, 126.0),
    ],
)
def test_limits_judge(limit: speed.Limit, good: float, bad: float) -> None:
    assert limit.holds(good)
    assert not limit.holds(bad)
    assert not limit.holds(math.nan)


def test_the_gate_names_what_fails() -> None:
    limits = {
        "S: a": speed.Limit("higher", required=2.0),
        "S: b": speed.Limit("lower", required=2.0),
        "L: a": speed.Limit("higher", required=99.0),
    }
    assert speed.judged(limits, {"S: a": 2.5, "S: b": 1.0}, ["S"]) == []
    failed = speed.judged(limits, {"S: a": 1.5, "S: b": 3.0}, ["S"])
    assert failed == ["FAILED S: a: 1.5, at least 2", "FAILED S: b: 3, at most 2"]
    refuses("S: b: not measured", speed.judged, limits, {"S: a": 2.5}, ["S"])
    refuses("no line of the baseline for M", speed.judged, limits, {}, ["M"])


# --- the peer's program


@pytest.mark.parametrize("says", ["no json", "{}"])
def test_a_peer_that_says_something_else_is_one_clear_line(tmp_path: Path, says: str) -> None:
    path = tmp_path / "odd"
    path.write_text(f"#!/bin/sh\necho '{says}'\necho 'bad file' >&2\nexit 3\n", encoding="utf-8")
    path.chmod(0o755)
    refuses(r"exit status 3, saying 'bad file'.*build\.sh", speed.run_peer, path, Path("S.bin"), "plain", 1)


# --- the command line


@pytest.mark.slow
def test_one_file_of_the_peers_format(tmp_path: Path) -> None:
    """In a process of its own, as it is meant."""
    problem, truth = blocks.chain(4, 80, seed=2, shots=10)
    peer.write_problem(problem, tmp_path / "chain.bin")
    command = [sys.executable, str(SCRIPTS / "benchmark.py"), "speed", "--problem", str(tmp_path / "chain.bin")]
    done = subprocess.run([*command, "--json", str(tmp_path / "out.json")], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    found = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    keys = ("seconds_solve", "seconds_covariance", "iterations", "cost_final", "peak_memory_mb")
    assert all(isinstance(found[key], int | float) and found[key] > 0 for key in keys)
    assert (found["images"], found["points"], found["observations"]) == (4, 120, problem.u.size)
    assert found["converged"]
    start = peer.cost(problem, problem.orientation, problem.places)
    assert found["cost_final"] < peer.cost(problem, truth.orientation, truth.places) < 1e-2 * start
    assert found["peak_memory_mb"] > found["memory_before_mb"] > 50.0
    added = 2.0**20 * (found["peak_memory_mb"] - found["memory_before_mb"])
    assert found["bytes_per_observation"] == pytest.approx(added / problem.u.size)


@pytest.fixture
def small_sizes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed, "made", lambda size, shared: blocks.chain(2, 5, shots=1))


@pytest.mark.usefixtures("small_sizes")
def test_sizes_with_the_peer_in_one_run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path, fake_peer: Path
) -> None:
    order: list[str] = []

    def ours(problem: Path, line: str, threads: int) -> dict[str, Any]:
        peer.read_problem(problem)
        order.append("ours")
        return figures()

    monkeypatch.setattr(speed, "ours", ours)
    true_peer = speed.run_peer
    monkeypatch.setattr(speed, "run_peer", lambda *given: order.append(given[2]) or true_peer(*given))
    out, page, demands = tmp_path / "out.json", tmp_path / "page.md", tmp_path / "demands.json"
    limits = json.loads((speed.BASELINE).read_text(encoding="utf-8"))
    for limit in limits["metrics"].values():
        limit.pop("value", None)  # the demands alone
    demands.write_text(json.dumps(limits), encoding="utf-8")
    given = ("speed", "S", "L", "--peer", fake_peer, "--repeat", "3", "--json", out, "--markdown", page)
    given += ("--gate", "--baseline", demands)
    assert called(monkeypatch, *given) == 1
    # interleaved, and each repeat begins with another
    assert order[:8] == ["ours", "plain", "analytic", "custom", "plain", "analytic", "custom", "ours"]
    assert len(order) == 24
    text = capsys.readouterr().out
    assert page.read_text(encoding="utf-8") in text
    assert "FAILED L: solve, plain / mgsgraph: 8, at least 12" in text
    assert text.count("FAILED") == 1
    record = json.loads(out.read_text(encoding="utf-8"))
    assert record["metrics"]["S: solve, best / mgsgraph"] == 2.0
    assert len(record["runs"]["L"]["custom"]) == 3
    monkeypatch.setattr(speed, "ours", lambda *given: figures(converged=False, message="no rest"))
    assert called(monkeypatch, "speed", "S") == 1
    assert "FAILED S: ours did not converge (no rest)" in capsys.readouterr().out


def test_a_failed_run_of_ours_says_why(tmp_path: Path) -> None:
    (tmp_path / "bad.bin").write_bytes(b"something else")
    refuses(r"exit status 2: .*b'somethin' at its head", speed.ours, tmp_path / "bad.bin", "measured", 1)


# --- what commands and questions cost


# --- processes


def test_a_command_is_watched_as_it_runs() -> None:
    took = costs.watched([sys.executable, "-c", "x = bytes(200_000_000)[::4096]; import time; time.sleep(0.5)"])
    assert 0.5 < took.wall < 60.0
    assert 0.0 < took.processor < took.wall
    with pytest.raises(SolverError, match=r"no$"):
        costs.watched([sys.executable, "-c", "import sys; sys.exit('no')"])
    runs = [costs.Took(9.0, 1.0, 5.0), costs.Took(1.0, 3.0, 4.0), costs.Took(2.0, 2.0, 3.0)]
    assert costs.median(runs) == (2.0, 2.0, 4.0)


# --- pages


def test_questions_have_medians_and_ratios_of_the_same_turn() -> None:
    assert costs.ratio([0.4, 0.9, 0.6], [0.2, 0.3, 0.2]) == "3.00 (2.00 .. 3.00)"


# --- small runs


@pytest.mark.slow
@pytest.mark.program("git")
def test_an_archive_is_made_and_run_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(costs.JOBS, "block-pvl", costs.Job("block", 8, 300, pvl=True, pages=True, memory_gb=1e-6))
    found = costs.run("block-pvl", tmp_path)
    assert (found.images, found.wall > 0.0, found.memory > 1e7) == (8, True, True)
    assert found.measures > 2 * found.points > 0
    assert {"reading", "solve"} <= found.stages.keys()
    (tmp_path / "runs.jsonl").write_text(json.dumps(asdict(found)) + "\n", encoding="utf-8")
    assert costs.finished(tmp_path / "runs.jsonl") == [found]


@pytest.mark.slow
def test_commands_of_a_small_project(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Half a minute, as each command is a process of its own."""
    given = "project", "2", "--ties", "20", "--repeats", "1", "--out", tmp_path / "a.md"
    assert called(monkeypatch, *given) == 0
    text = (tmp_path / "a.md").read_text(encoding="utf-8").partition("<!-- made: project ")[2].partition("<!-- end")[0]
    (row,) = (line for line in text.splitlines() if line.startswith("| 2 |"))
    assert len(row.split("|")) == 10


@pytest.mark.slow
def test_questions_at_the_smallest_size(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    require(blocks.SHARED / "gen.py", "the peer's generator")
    given = ("S", "--repeat", "2", "--queries", "2", "--out", tmp_path / "a.md")
    assert called(monkeypatch, "analysis", *given) == 0
    text = (tmp_path / "a.md").read_text(encoding="utf-8")
    assert "Size S: 2 images, 400 points, 2,636 scalar measures" in text
    rows = [line.split(" | ")[0].strip("| ") for line in text.splitlines() if line.startswith("| ")]
    assert {"linearised", "file", "variance components", *costs.QUERIES} <= set(rows)


# --- GPUs


BARE = """
import importlib.util, runpy, sys
found = importlib.util.find_spec
absent = ("gtsam", "threadpoolctl", "pyarrow")
importlib.util.find_spec = lambda name, *more: None if name in absent else found(name, *more)
sys.argv = sys.argv[1:]
sys.path.insert(0, sys.argv[1])
del sys.argv[1]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


@pytest.mark.slow
def test_it_runs_without_gtsam_to_the_cpus_cost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half a minute, as the simulator runs each thread of a kernel in Python."""
    pytest.importorskip("numba_cuda", reason="numba-cuda is not installed (the extra `cuda`)")
    kept, page = tmp_path / "gpu.json", tmp_path / "gpu.md"
    program = [sys.executable, "-c", BARE, str(SCRIPTS / "benchmark_gpu.py"), str(SCRIPTS)]
    options = ["S", "--runs", "1", "--line", "predicted", "--json", str(kept), "--out", str(page)]
    environment = os.environ | {"NUMBA_ENABLE_CUDASIM": "1"}
    done = subprocess.run([*program, *options], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    (found,) = json.loads(kept.read_text(encoding="utf-8"))
    monkeypatch.syspath_prepend(SCRIPTS)
    problem, _ = runpy.run_path(str(SCRIPTS / "peer_blocks.py"))["chain"](2, 40, shots=4)
    net, settings = runpy.run_path(str(SCRIPTS / "peer_problem.py"))["network"](problem, "predicted")
    layout = lay_out(net, settings)
    start = np.zeros(layout.columns)
    outcome = levenberg_marquardt(BundleProblem(BundleGraph(layout)), start, settings, lambda _: None)
    assert found["cost"] == pytest.approx(outcome.cost_final, rel=1e-9)
    assert found["iterations"] == len(outcome.history)
    assert 0.0 < found["system"] <= found["adjusted"]
    assert f"| {found['size']} |" in page.read_text(encoding="utf-8")
