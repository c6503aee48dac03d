"""The benchmark: its ratios and its gate judge right, it hears the peer, its command line is clear."""

import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from runs import figures

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import benchmark  # noqa: E402
import benchmark_speed as speed  # noqa: E402
import peer_blocks as blocks  # noqa: E402
import peer_problem as peer  # noqa: E402

from mgsgraph.errors import InputError  # noqa: E402

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
    assert speed.ratio(runs, "plain", "seconds_covariance") is None
    assert speed.ratio(runs, "custom", "seconds_solve") is None


def test_a_run_that_is_not_repeated_is_compared_with_its_neighbour() -> None:
    runs = {
        speed.OURS: [figures(seconds_solve=one) for one in (1.0, 2.0, 2.0)],
        "custom": [{"seconds_solve": 8.0}],
    }
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
    with pytest.raises(InputError, match="S: b: not measured"):
        speed.judged(limits, {"S: a": 2.5}, ["S"])
    with pytest.raises(InputError, match="no line of the baseline for M"):
        speed.judged(limits, {}, ["M"])


def test_the_committed_baseline_holds_what_the_issue_demands() -> None:
    limits = speed.read_baseline(speed.BASELINE)
    for size in ("L", "XL"):
        for variant, least in (("plain", 12.0), ("analytic", 4.0), ("custom", 1.0)):
            assert limits[f"{size}: solve, {variant} / mgsgraph"].required == least
        assert limits[f"{size}: bytes per observation"].required == 300.0
    assert limits["S: solve, best / mgsgraph"].required == 0.5
    assert limits["L: covariance, custom / mgsgraph"].required == 2.0
    assert not [name for name in limits if "second" in name]  # seconds belong to a machine
    for size in blocks.SIZES:
        assert limits[f"{size}: cost, relative difference"].required == 1e-8
    variants = {name: [{"seconds_solve": 1.0, "cost_final": 1.0, "seconds_covariance": 1.0}]
                for name in speed.VARIANTS}  # fmt: skip
    known = {name for size in blocks.SIZES for name in speed.metrics(size, {speed.OURS: [figures()], **variants})}
    assert set(limits) <= known


def test_updating_the_baseline_keeps_its_lines(tmp_path: Path) -> None:
    path = tmp_path / "baseline.json"
    path.write_text(speed.BASELINE.read_text(encoding="utf-8"), encoding="utf-8")
    before = speed.read_baseline(path)
    speed.update_baseline(path, {"L: solve, plain / mgsgraph": 33.0, "something else": 1.0})
    after = speed.read_baseline(path)
    assert list(after) == list(before)
    assert after["L: solve, plain / mgsgraph"] == speed.Limit("higher", 12.0, 33.0, 0.25)
    assert after["XL: solve, plain / mgsgraph"] == before["XL: solve, plain / mgsgraph"]
    speed.update_baseline(path, {})  # a run of other sizes
    assert speed.read_baseline(path) == after


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", '{"metrics": 3}', '{"metrics": {"S: a": {"direction": "up", "required": 1}}}',
        '{"metrics": {"S: a": {"direction": "lower"}}}', '{"metrics": {"S: a": {"direction": "lower", "value": NaN}}}',
        '{"metrics": {"S: a": {"direction": "lower", "required": "1"}}}',
        '{"metrics": {"S: a": {"direction": "lower", "required": 1, "colour": 2}}}',
    ],
)  # fmt: skip
def test_a_file_that_is_no_baseline_is_one_clear_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "baseline.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        speed.read_baseline(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


# --- the peer's program


def test_the_peers_figures_in_our_words(fake_peer: Path) -> None:
    one = speed.run_peer(fake_peer, Path("S.bin"), "custom", 2)
    assert (one["seconds_solve"], one["seconds_covariance"], one["cost_final"]) == (1.0, 3.0, 100.0)
    assert one["converged"]
    assert "seconds_covariance" not in speed.run_peer(fake_peer, Path("S.bin"), "analytic", 2)


@pytest.mark.parametrize("says", ["", "no json", "{}", '{"t_solve": "fast"}'])
def test_a_peer_that_says_something_else_is_one_clear_line(tmp_path: Path, says: str) -> None:
    path = tmp_path / "odd"
    path.write_text(f"#!/bin/sh\necho '{says}'\necho 'bad file' >&2\nexit 3\n", encoding="utf-8")
    path.chmod(0o755)
    with pytest.raises(InputError, match=r"exit status 3, saying 'bad file'.*build\.sh"):
        speed.run_peer(path, Path("S.bin"), "plain", 1)


def test_a_peer_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        speed.require_peer(tmp_path / "peer_ceres")
    (tmp_path / "text").write_text("not a program", encoding="utf-8")
    with pytest.raises(InputError, match="not executable"):
        speed.require_peer(tmp_path / "text")


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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["speed", "--problem", "none.bin"], "none.bin: can't be read"),
        (["speed", "--problem", "none.bin", "--json", "/proc/none/out.json"], "out.json: can't be written"),
        (["speed", "XXL"], "no size 'XXL'"),
        (["speed", "S", "S"], "named twice"),
        (["speed", "S", "--problem", "none.bin"], "exclude"),
        (["speed", "--problem", "none.bin", "--gate"], "the gate judges sizes"),
        (["speed", "S", "--gate"], "no peer to compare with"),
        (["speed", "S", "--peer", "none"], "none: no such file"),
        (["speed", "S", "--repeat", "0"], "at least 1"),
        (["speed", "S", "--repeat", "many"], "at least 1"),
        (["speed", "S", "--shared", "none"], "gen.py: no such file"),
        (["speed", "--unheard-of"], "unrecognized"),
        (["scaling"], "invalid choice: 'scaling'"),
        (["unheard-of"], "invalid choice: 'unheard-of'"),
        ([], "invalid choice: ''"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    arguments: list[str], message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert called(monkeypatch, *arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"benchmark {arguments[0]}: error: " if arguments[1:] else "benchmark: error: ")
    assert err.count("\n") == 1
    assert message in err
    assert not list(tmp_path.iterdir())


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
        limit.pop("value", None)  # the issue's demands alone
    demands.write_text(json.dumps(limits), encoding="utf-8")
    given = ("speed", "S", "L", "--peer", fake_peer, "--repeat", "3", "--json", out, "--markdown", page)
    given += ("--gate", "--baseline", demands)
    assert called(monkeypatch, *given) == 1
    # interleaved, and each repeat begins with another
    assert order[:8] == ["ours", "plain", "analytic", "custom", "plain", "analytic", "custom", "ours"]
    assert len(order) == 24
    text = capsys.readouterr().out
    assert "| L | 8.00 (8.00 .. 8.00) | 4.00 (4.00 .. 4.00) | 2.00 (2.00 .. 2.00) | 4.00 (4.00 .. 4.00) |" in text
    assert page.read_text(encoding="utf-8") in text
    assert "FAILED L: solve, plain / mgsgraph: 8, at least 12" in text
    assert text.count("FAILED") == 1
    record = json.loads(out.read_text(encoding="utf-8"))
    assert record["metrics"]["S: solve, best / mgsgraph"] == 2.0
    assert len(record["runs"]["L"]["custom"]) == 3
    lax = tmp_path / "lax.json"
    lax.write_text('{"metrics": {"S: solve, plain / mgsgraph": {"direction": "higher", "required": 8.0}}}')
    assert called(monkeypatch, "speed", "S", "--peer", fake_peer, "--gate", "--baseline", lax) == 0
    assert "The gate is passed." in capsys.readouterr().out
    monkeypatch.setattr(speed, "ours", lambda *given: figures(converged=False, message="no rest"))
    assert called(monkeypatch, "speed", "S") == 1
    assert "FAILED S: ours did not converge (no rest)" in capsys.readouterr().out


@pytest.mark.usefixtures("small_sizes")
def test_what_takes_minutes_runs_once(monkeypatch: pytest.MonkeyPatch, fake_peer: Path, tmp_path: Path) -> None:
    monkeypatch.setattr(speed, "ours", lambda *given: figures())
    given = ("speed", "Kaguya", "--peer", fake_peer, "--repeat", "3", "--json", tmp_path / "out.json")
    assert called(monkeypatch, *given) == 0
    runs = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))["runs"]["Kaguya"]
    assert {name: len(one) for name, one in runs.items()} == {"mgsgraph": 3, "plain": 3, "analytic": 3, "custom": 1}


@pytest.mark.usefixtures("small_sizes")
def test_a_folder_of_problems_is_used_and_left(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    seen: list[Path] = []

    def ours(problem: Path, line: str, threads: int) -> dict[str, Any]:
        seen.append(problem)
        return figures()

    monkeypatch.setattr(speed, "ours", ours)
    for _ in range(2):
        assert called(monkeypatch, "speed", "M", "--repeat", "1", "--work", tmp_path / "work") == 0
        written = (tmp_path / "work" / "M.bin").stat().st_mtime_ns
        assert seen[-1] == tmp_path / "work" / "M.bin"
    assert (tmp_path / "work" / "M.bin").stat().st_mtime_ns == written


def test_a_failed_run_of_ours_says_why(tmp_path: Path) -> None:
    (tmp_path / "bad.bin").write_bytes(b"something else")
    with pytest.raises(InputError, match=r"exit status 2: .*b'somethin' at its head"):
        speed.ours(tmp_path / "bad.bin", "measured", 1)
