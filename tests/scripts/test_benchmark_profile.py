"""Where the time goes: operations are counted as the algebra has it, tables add up, the page keeps its words."""

import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import benchmark_blocks as blocks  # noqa: E402
import benchmark_profile  # noqa: E402
import benchmark_profile_page as page  # noqa: E402
import benchmark_stages as stages  # noqa: E402
import peer_problem as peer  # noqa: E402

from mgsgraph.errors import InputError  # noqa: E402

Counts = dict[str, dict[str, dict[str, float]]]


@pytest.fixture(scope="module")
def problem(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("profile") / "chain.bin"
    peer.write_problem(blocks.chain(4, 900, shots=70)[0], path)
    return path


@pytest.fixture(scope="module")
def counts(problem: Path) -> Counts:
    return benchmark_profile.counted(problem, "measured")


def test_counts_are_those_of_the_algebra(counts: Counts) -> None:
    """Per row of a point: six products for B'B, three for B'r; K_ij: three products an entry, and J'J if i = j."""
    ties = counts["two rays"]
    rows = 2 * 2
    assert ties["normal equations"]["multiply"] == ties["normal equations"]["add"] == rows * (6 + 3)
    other, same = 6 * 6, 6 * 7 / 2
    assert ties["pairs"]["multiply"] == other * 3 + 2 * same * (3 + 2)
    assert ties["pairs"]["add"] == other * 2 + 2 * same * (2 + 2)
    of_basis, of_sums = 9 + 2 * 6, other * 9 + 2 * same * 6
    assert ties["sums"]["multiply"] == of_basis + of_sums + 2 * 6 * 3  # the last: the gradient
    assert (ties["factorise"]["root"], ties["factorise"]["divide"]) == (3.0, 3.0)


def test_stages_add_up_to_the_elimination(counts: Counts) -> None:
    """Else a stage here is not what the sweep does."""
    for name, tallies in counts.items():
        parts = sum((Counter(tallies[stage]) for stage in stages.OUTER), Counter[str]())
        assert dict(parts) == pytest.approx({key: value for key, value in tallies["eliminate"].items() if value}), name


def test_each_further_ray_counts_alike(counts: Counts) -> None:
    two, three = counts["two rays"], counts["three rays"]
    for stage in ("rows", "normal equations", "couple"):
        assert page.flops(three[stage]) == pytest.approx(1.5 * page.flops(two[stage])), stage
    assert two["factorise"] == three["factorise"]


def test_bytes_of_memory_are_those_of_the_rows(problem: Path, counts: Counts) -> None:
    """What a sweep reads of a point is what is stored of it, with its place, and no more."""
    rows = stages.laid_out(problem, "measured").rows
    for name, kinds in stages.PATTERNS.items():
        piece = stages.piece_of(rows, kinds)
        assert piece is not None
        ends = np.append(rows.piece[:, 3], rows.data.size)
        held = 8.0 * (ends[piece + 1] - ends[piece]) / rows.piece[piece, 2] + 16.0 * len(kinds)
        assert counts[name]["load"]["array bytes"] == held + 3 * 8 + 1, name  # place, kind
        assert counts[name]["store"]["array bytes"] == 3 * 8 + 1, name


def test_numbers_count() -> None:
    number = stages.Counted(3.0)
    stages.Counted.tally.clear()
    value = (1.0 - number) * np.float64(2.0) / number + np.float64(1.0)
    assert stages.Counted.tally == {"add": 2, "multiply": 1, "divide": 1}
    assert float(value) == pytest.approx(-4.0 / 3.0 + 1.0)
    with np.errstate(all="raise"):
        assert float(number / 0.0) == np.inf  # as the kernel divides


def found(counts: Counts) -> page.Profile:
    """A profile with round figures."""
    names = ("two rays", "three rays", "laser")
    ns = dict.fromkeys((*page.ONCE, *page.INNER, "spread"), 10.0)
    rates = ("256 bit", "512 bit", "near", "nearest", "memory")
    peaks = {f"{name}, {count}": 10.0 for name in rates for count in (1, 2)}
    sweeps = [page.Sweep(dict.fromkeys(names, float(steps)), 1.0, 2.0, 2.0) for steps in (3, 2, 1)]
    return page.Profile(
        problem="chain",
        threads=2,
        repeat=5,
        iterations=3,
        rays=4000,
        points=dict.fromkeys(names, 1000),
        iteration={"a sweep": (2.0, 3.0), "GTSAM": (1.0, 1.0)},
        afterwards={"covariance": (2.0, 2.0)},
        sweeps=sweeps,
        stages=dict.fromkeys(names, ns),
        counts=counts,
        patterns=dict.fromkeys(names, 10),
        held={"constants": 100.0, "weights": 16.0},
        tile=dict.fromkeys(names, 150_000),
        peaks=peaks,
    )


def test_a_sweep_is_the_sum_of_its_stages(counts: Counts) -> None:
    profile = found(counts)
    for sweep in profile.sweeps:
        steps = sweep.steps["laser"]
        total = page.whole_sweep(profile, sweep)
        assert total["nanoseconds"] == pytest.approx(3 * (1000 * (5 + 4 * steps) * 10.0 + 10 * 10.0))
        ties = [counts[name] for name in profile.points]
        inner = sum(page.flops(one[stage]) for one in ties for stage in page.INNER)
        first = page.whole_sweep(profile, profile.sweeps[-1])["flops"]
        assert total["flops"] - first == pytest.approx(1000.0 * (steps - 1.0) * inner)


def test_tables_and_figure(counts: Counts, tmp_path: Path) -> None:
    profile = found(counts)
    text = page.tables(profile)
    assert "| **an iteration** | 3.00 | 4.00 | 100 % |" in text
    assert "| normal equations: 3x3 of the point | 10.0 | 36 + 36 + 0 + 0 | 7.20 | 72 % |" in text
    assert "| **together** | 116 |" in text
    assert page.typical(profile).steps["laser"] == 2.0
    page.draw(profile, tmp_path / "speed.png")
    assert (tmp_path / "speed.png").stat().st_size > 10_000


def test_a_page_keeps_its_words(tmp_path: Path) -> None:
    path = tmp_path / "speed.md"
    path.write_text(f"Before.\n{page.BEGIN}\nold\n{page.END}\nAfter.\n", encoding="utf-8")
    assert page.into_page("new", path) == f"Before.\n{page.BEGIN}\nnew\n{page.END}\nAfter.\n"
    path.write_text(f"{page.END}{page.BEGIN}", encoding="utf-8")
    with pytest.raises(InputError, match="no place for the tables"):
        page.into_page("new", path)


def test_bad_input_is_one_line_and_status_2(tmp_path: Path) -> None:
    command = [sys.executable, str(SCRIPTS / "benchmark_profile.py"), "--problem", "absent.bin"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "absent.bin" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--page", "absent.md"), "absent.md"),
        (("--repeat", "0"), "whole number"),
        (("--shared", "nowhere"), "nowhere"),
    ],
)
def test_bad_input_is_one_line(
    arguments: tuple[str, ...], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")  # so that it is put back
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["benchmark_profile.py", *arguments])
    try:
        status = benchmark_profile.main()
    except SystemExit as left:
        status = int(left.code or 0)
    said = capsys.readouterr().err
    assert status == 2
    assert len(said.strip().splitlines()) == 1
    assert words in said


def test_a_problem_too_small_for_a_tile_says_so(tmp_path: Path) -> None:
    path = tmp_path / "small.bin"
    peer.write_problem(blocks.chain(2, 20, shots=5)[0], path)
    with pytest.raises(InputError, match="no pattern with a full tile"):
        benchmark_profile.counted(path, "measured")


def test_the_published_page_has_its_tables() -> None:
    text = (SCRIPTS.parent / "docs" / "speed.md").read_text(encoding="utf-8")
    assert text.count(page.BEGIN) == text.count(page.END) == 1
    assert "### The sweep as a whole" in text
    assert (SCRIPTS.parent / "docs" / "speed.png").is_file()
