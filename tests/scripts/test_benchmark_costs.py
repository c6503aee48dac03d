"""What commands and questions cost: medians and ratios, processes that are watched, small runs of each part."""

import json
import mmap
import sys
from dataclasses import asdict
from pathlib import Path

import pytest
from outside import require
from runs import figures

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import benchmark  # noqa: E402
import benchmark_costs as costs  # noqa: E402
import benchmark_speed as speed  # noqa: E402
import peer_blocks as blocks  # noqa: E402

from mgsgraph.errors import SolverError  # noqa: E402


def called(monkeypatch: pytest.MonkeyPatch, *given: object) -> int:
    """Exit status of a command of the benchmark."""
    monkeypatch.setattr(sys, "argv", ["benchmark.py", *map(str, given)])
    try:
        return benchmark.main()
    except SystemExit as left:
        return int(left.code or 0)


# --- processes


def test_a_command_is_watched_as_it_runs() -> None:
    took = costs.watched([sys.executable, "-c", "x = bytes(200_000_000)[::4096]; import time; time.sleep(0.5)"])
    assert 0.5 < took.wall < 60.0
    assert 0.0 < took.processor < took.wall
    with pytest.raises(SolverError, match=r"no$"):
        costs.watched([sys.executable, "-c", "import sys; sys.exit('no')"])
    runs = [costs.Took(9.0, 1.0, 5.0), costs.Took(1.0, 3.0, 4.0), costs.Took(2.0, 2.0, 3.0)]
    assert costs.median(runs) == (2.0, 2.0, 4.0)


def test_memory_is_what_the_adjustment_adds() -> None:
    speed.forget_peak()
    before = speed.resident()
    with mmap.mmap(-1, 100 * 2**20) as block:  # an array might come out of what was freed before
        for _ in range(100):  # whole, it would be written from as large a piece of the heap, which may stay
            block.write(b"1" * 2**20)
        after = speed.resident()
    assert after - before == pytest.approx(100 * 2**20, rel=0.1)
    assert speed.highest() >= 0.9 * after
    speed.forget_peak()
    if Path("/proc/self/clear_refs").exists():
        assert speed.highest() < 0.5 * (before + after)


# --- pages


def test_a_page_without_the_peer_says_so() -> None:
    text = speed.page({"S": {speed.OURS: [figures()]}}, 5, 2)
    assert "The peer took no part" in text
    assert "| S | 2 | 400 | 800 | 0.100 | 0.100 | 0.200 | 0.500 | 0.750 | 3 | 0.100 | 50 | 250 |" in text


def one(job: str, wall: float, measures: int = 1000) -> costs.Run:
    """A run of so many seconds."""
    stages = {"solve": 0.5 * wall, "reading": 1.0}
    return costs.Run(job, "abc", wall, 2.0 * wall, 1e6 * measures, 10, 100, measures, stages)


def test_the_archives_table_has_medians_and_exponents() -> None:
    runs = [one("dense-tenth", wall) for wall in (3.0, 9.0, 4.0)] + [one("dense", 40.0, 10_000)]
    made = "\n".join(costs.archive_tables(runs))
    row = "| dense-tenth | 10 | 100 | 1000 | 1.0 | 0.0 | 0.0 | 2.0 | 0.0 | 0.0 | 1.0 | 4.0 | 8.0 | 1.00 | 3 | abc |"
    assert row in made
    assert "| dense-tenth to dense | 1.00 | 1.00 | 1.00 |" in made


def test_questions_have_medians_and_ratios_of_the_same_turn() -> None:
    assert costs.ratio([0.4, 0.9, 0.6], [0.2, 0.3, 0.2]) == "3.00 (2.00 .. 3.00)"
    seconds = {costs.ITERATION: [0.1, 0.3, 0.2], "reliability table": [0.2, 0.3, 0.4]}
    seconds |= {name: [1e-3 * (k + 1)] * 3 for k, name in enumerate(costs.QUERIES)}
    lines = costs.query_tables(seconds)
    assert "| iteration | 0.200 | 1.00 (1.00 .. 1.00) |" in lines
    assert "| reliability table | 0.300 | 2.00 (1.00 .. 2.00) |" in lines
    assert {"| point | 1.00 |", "| intersection | 5.00 |"} <= set(lines)


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
    assert costs.kept(tmp_path / "runs.jsonl") == [found]


@pytest.mark.slow
def test_commands_of_a_small_project(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    given = "project", "2", "--ties", "20", "--repeats", "1", "--out", tmp_path / "a.md"
    assert called(monkeypatch, *given) == 0
    (row,) = (line for line in (tmp_path / "a.md").read_text(encoding="utf-8").splitlines() if line.startswith("| 2 |"))
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


def test_bad_input_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for given, message in (
        (["analysis", "S", "--shared", tmp_path, "--out", tmp_path / "a.md"], "gen.py: no such file"),
        (["analysis", "Q"], "invalid choice"),
        (["analysis", "S", "--repeat", "0"], "at least 1"),
        (["analysis", "S", "--out", tmp_path], "can't be written"),
        (["archive", "mars", "--work", tmp_path], "no job 'mars'"),
    ):
        assert called(monkeypatch, *given) == 2
        err = capsys.readouterr().err
        assert message in err
        assert err.count("\n") == 1
