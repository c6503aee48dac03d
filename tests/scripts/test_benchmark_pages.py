"""The benchmark's pages: stages, memory, exponents and their picture; and the NEES campaign at the peer's sizes."""

import json
import math
import mmap
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from outside import require
from runs import figures

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import benchmark  # noqa: E402
import benchmark_gate as gate  # noqa: E402
import benchmark_project as project  # noqa: E402
import benchmark_scaling as scaling  # noqa: E402
import benchmark_speed as speed  # noqa: E402
import nees_peer  # noqa: E402
import peer_blocks as blocks  # noqa: E402
import peer_problem as peer  # noqa: E402

from mgsgraph.errors import SolverError  # noqa: E402


def test_a_page_without_the_peer_says_so() -> None:
    text = speed.page({"S": {gate.OURS: [figures()]}}, 5, 2)
    assert "The peer took no part" in text
    assert "| S | 2 | 400 | 800 | 0.100 | 0.100 | 0.200 | 0.500 | 0.750 | 3 | 0.100 | 50 | 250 |" in text


def test_commands_of_a_project_by_their_medians(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    runs = [project.Took(9.0, 1.0), project.Took(1.0, 3.0), project.Took(2.0, 2.0)]
    assert project.median(runs) == (2.0, 2.0)

    def measured(strip: object, images: int, chosen: object, work: Path) -> project.Costs:
        add = project.Took(2.5, 0.1 * images)
        return project.Costs(100 * images, 7.0, add, 0.5, runs[0], runs[1], None if images == 2 else runs[2])

    monkeypatch.setattr(project, "measured", measured)
    given = "project", "2", "3", "--ties", "10", "--out", str(tmp_path / "a.md")
    monkeypatch.setattr(sys, "argv", ["benchmark", *given])
    assert benchmark.main() == 0
    text = (tmp_path / "a.md").read_text(encoding="utf-8")
    assert "| 2 | 200 | 7 | 2.50, 0.200 | 1.00 | 0.50 | 9.00, 1.00 | 1.00, 3.00 | - |" in text
    assert "| 3 | 300 | 7 | 2.50, 0.300 | 1.50 | 0.50 | 9.00, 1.00 | 1.00, 3.00 | 2.00, 2.00 |" in text


def test_a_command_is_timed_as_it_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/echo")
    took = project.run(tmp_path, "status")
    assert 0.0 <= took.processor <= took.wall + 0.01
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(SolverError, match="status"):
        project.run(tmp_path, "status")


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


def rows(law: Callable[[float], float]) -> list[scaling.Row]:
    """Figures of chains whose every stage takes law(points or images) seconds and 200 bytes an observation and 1 MB."""
    made = []
    for swept, sizes in (("points", (1000, 10_000, 100_000, 1_000_000)), ("images", (2, 20, 200))):
        for size in sizes:
            images, points = (20, size) if swept == "points" else (size, 100_000)
            memory = 200.0 + 1e6 / (2 * points)
            made.append(scaling.Row(swept, images, points, 2 * points, 4.0, *[law(size)] * 4, memory))
    return made


def test_exponents_and_bytes_are_fitted() -> None:
    found = scaling.as_record(rows(lambda size: 3e-6 * size**1.07))
    assert found["exponents"]["points: seconds_solve"] == pytest.approx(1.07)
    assert found["exponents"]["images: seconds_covariance"] == pytest.approx(1.07)
    assert found["exponents"]["bytes of a further observation"] == pytest.approx(200.0)
    assert len(found["rows"]) == 7
    text = scaling.page(rows(lambda size: 3e-6 * size**1.07), 5, 2)
    assert "Exponents against points from 10,000 on: set up 1.07; solve 1.07" in text
    assert "takes 200 bytes" in text


def test_the_fixed_cost_of_small_chains_does_not_flatter() -> None:
    exponent = scaling.as_record(rows(lambda size: 1.0 if size < 5000 else 1e-4 * size))["exponents"]
    assert exponent["points: seconds_solve"] == pytest.approx(1.0)


def test_scaling_is_drawn_and_written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(speed, "ours", lambda problem, line, threads: figures(
        images=len(peer.read_problem(problem).orientation), points=len(peer.read_problem(problem).places)))  # fmt: skip
    given = ("scaling", "--most-points", "3000", "--most-images", "5", "--repeat", "2", "--out", tmp_path)
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")  # so that it is put back
    given = (*given, "--json", tmp_path / "scaling.json")
    monkeypatch.setattr(sys, "argv", ["benchmark.py", *map(str, given)])
    assert benchmark.main() == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scaling.json", "scaling.md", "scaling.png"]
    assert (tmp_path / "scaling.png").read_bytes().startswith(b"\x89PNG")
    found = json.loads((tmp_path / "scaling.json").read_text(encoding="utf-8"))["rows"]
    assert [(row["swept"], row["images"]) for row in found] == [
        ("points", 20), ("points", 20), ("images", 2), ("images", 5),
    ]  # fmt: skip


# --- NEES


def test_normalised_errors_of_drawn_errors_average_to_one() -> None:
    rng = np.random.default_rng(4)
    roots = rng.standard_normal((2000, 3, 3))
    errors = np.einsum("nij,nj->ni", roots, rng.standard_normal((2000, 3)))
    covariances = roots @ np.swapaxes(roots, 1, 2)
    found = nees_peer.normalised(errors, covariances)
    assert found == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / 6000))
    assert nees_peer.normalised(2.0 * errors, covariances) == pytest.approx(4.0 * found)


@pytest.mark.slow
def test_nees_of_two_draws_of_the_smallest_size(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    require(blocks.SHARED / "gen.py", "the peer's generator")
    monkeypatch.setattr(sys, "argv", ["nees_peer.py", "S", "--draws", "2", "--out", str(tmp_path / "nees.md")])
    assert nees_peer.main() == 0
    text = (tmp_path / "nees.md").read_text(encoding="utf-8")
    assert text in capsys.readouterr().out
    row = next(line for line in text.splitlines() if line.startswith("| S | predicted | 2 |"))
    ties, laser, orientation, squares = (float(part.split()[0]) for part in row.split("|")[4:8])
    assert 0.1 < ties < 4.0  # all ties share one orientation: two draws say no more
    assert 0.8 < laser < 1.2
    assert 0.4 < orientation < 2.0
    assert 0.9 < squares < 1.1


def test_bad_input_of_the_nees_campaign_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for given, message in (
        (["S", "--shared", str(tmp_path)], "gen.py: no such file"),
        (["Q"], "no size 'Q'"),
        (["--draws", "1"], "at least 2"),
        (["--out", str(tmp_path)], "can't be written"),
    ):
        monkeypatch.setattr(sys, "argv", ["nees_peer.py", *given])
        try:
            status = nees_peer.main()
        except SystemExit as left:
            status = int(left.code or 0)
        err = capsys.readouterr().err
        assert status == 2
        assert message in err
        assert err.count("\n") == 1
