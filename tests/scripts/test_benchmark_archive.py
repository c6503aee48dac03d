"""The benchmark from files to results: a small archive through all of it, medians, exponents, the page's marks."""

import json
import math
import sys
from dataclasses import asdict
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import benchmark_archive as archive  # noqa: E402

from mgsgraph.errors import InputError, SolverError  # noqa: E402


def one(job: str, wall: float, measures: int = 1000) -> archive.Run:
    """A run of so many seconds."""
    stages = {"solve": 0.5 * wall, "reading": 1.0}
    return archive.Run(job, "abc", wall, 2.0 * wall, 1e6 * measures, 10, 100, measures, stages)


def test_the_page_has_medians_and_exponents() -> None:
    runs = [one("dense-tenth", wall) for wall in (3.0, 9.0, 4.0)] + [one("dense", 40.0, 10_000)]
    made = "\n".join(archive.lines(runs))
    row = "| dense-tenth | 10 | 100 | 1000 | 1.0 | 0.0 | 0.0 | 2.0 | 0.0 | 0.0 | 1.0 | 4.0 | 8.0 | 1.00 | 3 | abc |"
    assert row in made
    assert "| dense-tenth to dense | 1.00 | 1.00 | 1.00 |" in made
    page = f"a {archive.BEGIN} old {archive.END} b"
    assert archive.filled(page, ["new"]) == f"a {archive.BEGIN}\n\nnew\n\n{archive.END} b"
    with pytest.raises(InputError):
        archive.filled("no marks", [])
    assert math.isnan(archive.exponent([3.0, 3.0], [1.0, 2.0]))


@pytest.mark.slow
@pytest.mark.program("git")
def test_an_archive_is_made_and_run_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(archive.JOBS, "block-pvl", archive.Job("block", 8, 300, pvl=True, pages=True, memory_gb=1e-6))
    found = archive.run("block-pvl", tmp_path)
    assert (found.images, found.wall > 0.0, found.memory > 1e7) == (8, True, True)
    assert found.measures > 2 * found.points > 0
    assert {"reading", "solve"} <= found.stages.keys()
    (tmp_path / "runs.jsonl").write_text(json.dumps(asdict(found)) + "\n", encoding="utf-8")
    assert archive.kept(tmp_path / "runs.jsonl") == [found]


def test_a_command_that_fails_is_an_error() -> None:
    with pytest.raises(SolverError, match=r"no$"):
        archive.watched([sys.executable, "-c", "import sys; sys.exit('no')"])
