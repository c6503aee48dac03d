"""The page of what questions cost: its ratios and medians, and a whole run at the smallest size."""

import sys
from pathlib import Path

import pytest
from outside import require

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import benchmark  # noqa: E402
import benchmark_analysis as analysis  # noqa: E402
import peer_blocks as blocks  # noqa: E402


def test_ratios_are_of_the_same_turn() -> None:
    assert analysis.ratio([0.4, 0.9, 0.6], [0.2, 0.3, 0.2]) == "3.00 (2.00 .. 3.00)"


def test_the_page_has_medians_of_all() -> None:
    seconds = {analysis.ITERATION: [0.1, 0.3, 0.2], "reliability table": [0.2, 0.3, 0.4]}
    seconds |= {name: [1e-3 * (k + 1)] * 3 for k, name in enumerate(analysis.QUERIES)}
    text = analysis.page("A title.", seconds, 7)
    for line in (
        "| iteration | 0.200 | 1.00 (1.00 .. 1.00) |",
        "| reliability table | 0.300 | 2.00 (1.00 .. 2.00) |",
        "| point | 1.00 |",
        "| intersection | 5.00 |",
        "* *query*: mean of 7 different ones, after the first.",
    ):
        assert line in text.splitlines()


@pytest.mark.slow
def test_a_whole_run_at_the_smallest_size(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    require(blocks.SHARED / "gen.py", "the peer's generator")
    given = ("S", "--repeat", "2", "--queries", "2", "--out", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["benchmark.py", "analysis", *given])
    assert benchmark.main() == 0
    text = (tmp_path / "analysis_cost.md").read_text(encoding="utf-8")
    assert text in capsys.readouterr().out
    assert "Size S: 2 images, 400 points, 2,636 scalar measures" in text
    assert [path.name for path in tmp_path.iterdir()] == ["analysis_cost.md"]
    rows = [line.split(" | ")[0].strip("| ") for line in text.splitlines() if line.startswith("| ")]
    assert {"linearised", "file", "variance components", *analysis.QUERIES} <= set(rows)


def test_bad_input_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    for given, message in (
        (["S", "--shared", str(tmp_path)], "gen.py: no such file"),
        (["Q"], "invalid choice"),
        (["S", "--repeat", "0"], "at least 1"),
        (["S", "--out", str(tmp_path / "file")], "can't be written"),
    ):
        given += [] if "--out" in given else ["--out", str(tmp_path)]
        monkeypatch.setattr(sys, "argv", ["benchmark.py", "analysis", *given])
        try:
            status = benchmark.main()
        except SystemExit as left:
            status = int(left.code or 0)
        err = capsys.readouterr().err
        assert status == 2
        assert message in err
        assert err.count("\n") == 1
