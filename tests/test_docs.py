"""Examples in the docs run as they stand."""

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[1] / "docs"


@pytest.mark.parametrize(
    ("page", "said"),
    [
        ("incremental.md", "Closing check"),
        ("analysis.md", "PoseEstimate("),
        ("strips.md", "HRSC/01: "),
        ("two_steps.md", "reduced by a factor"),
        ("review.md", "5 of 20 tie points"),
        ("jigsaw.md", "network_without_laser.net"),
        ("exchange.md", "PointId of 1 point (they are counted anew)"),
    ],
)
def test_python_examples_run(page: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    blocks = re.findall(r"```python\n(.+?)\n```", (DOCS / page).read_text(encoding="utf-8"), re.DOTALL)
    assert blocks
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, page, "exec"), names)  # our own page
    assert said in capsys.readouterr().out
