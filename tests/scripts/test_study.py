"""The studies' harness: draws that are kept, workers, made parts of pages, bands, one line for bad input."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import study  # noqa: E402

from mgsgraph.errors import InputError  # noqa: E402

CASES = ("eos", "eos, terrain", "gusev")


class Asked:
    """A study whose draws cost nothing; the orders that were made."""

    def __init__(self) -> None:
        self.orders: list[tuple[str, int]] = []

    def one(self, case: str, seed: int) -> study.Draw:
        self.orders.append((case, seed))
        return {"value": seed + 0.5}

    def __call__(self, *given: str | Path) -> int:
        parser = study.seeds_of("A study.", CASES, 5, "fair_draws.md")
        return study.run(parser, self.one, lambda every: {"errors": [json.dumps(every)]}, [str(one) for one in given])


@pytest.fixture
def asked() -> Asked:
    return Asked()


def test_a_page_keeps_its_words_and_gets_new_tables(
    asked: Asked, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.md"
    assert asked("--cases", "gusev", "--seeds", "2", "--first", "7", "--out", page) == 0
    assert asked.orders == [("gusev", 7), ("gusev", 8)]
    text, before = page.read_text(encoding="utf-8"), (study.DOCS / "fair_draws.md").read_text(encoding="utf-8")
    assert text.startswith(before.partition("<!-- made")[0])
    assert '"value": 7.5' in text
    assert "| kernels, X 0 |" not in text
    assert re.search(r"Made by `python scripts/.*`, commit [\w-]+\. .* numpy ", text)
    assert '"value": 7.5' in capsys.readouterr().out
    with pytest.raises(InputError, match="no marks of the made part 'none'"):
        study.filled("fair_draws.md", {"none": []})


@pytest.mark.parametrize("page", sorted(study.DOCS.glob("*.md")), ids=lambda page: page.stem)
def test_marks_of_made_parts_come_in_pairs(page: Path) -> None:
    marks = re.findall(r"<!-- (made: \w+|end) -->", page.read_text(encoding="utf-8"))
    assert all(mark == "end" for mark in marks[1::2])
    assert not any(mark == "end" for mark in marks[::2])
    assert not marks or marks[-2:] == ["made: by", "end"]


def test_cases_are_named_or_found_by_a_word(asked: Asked, tmp_path: Path) -> None:
    assert asked("--seeds", "2", "--out", tmp_path / "a.md", "--cases", "eos") == 0
    assert {case for case, _ in asked.orders} == {"eos"}
    assert asked("--seeds", "2", "--out", tmp_path / "a.md", "--cases", "terrain", "gusev") == 0
    assert {case for case, _ in asked.orders[2:]} == {"eos, terrain", "gusev"}


def test_kept_draws_are_not_made_again(asked: Asked, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keep = tmp_path / "keep.jsonl"
    common = ("--cases", "gusev", "--out", tmp_path / "a.md", "--keep", keep)
    assert asked(*common, "--seeds", "3") == 0
    page = (tmp_path / "a.md").read_text(encoding="utf-8")
    assert asked(*common, "--seeds", "3") == 0
    assert (tmp_path / "a.md").read_text(encoding="utf-8") == page
    assert len(asked.orders) == 3
    keep.write_bytes(keep.read_bytes()[:-20])  # a crash cuts the last line short
    assert asked(*common, "--seeds", "4") == 0
    assert asked.orders[3:] == [("gusev", 3), ("gusev", 4)]
    monkeypatch.setattr(study, "commit", lambda: "another")
    assert asked(*common, "--seeds", "3") == 0
    assert len(asked.orders) == 8


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--seeds", "1"], "at least 2"),
        (["--cases", "venus"], "no case 'venus'"),
        (["--processes", "2", "--cluster", "local"], "not allowed with"),
        (["--cluster", "nowhere"], "no place for the work"),
        (["--keep", "{here}/readme"], "holds no kept draws"),
        (["--out", "{here}/readme/page.md"], "can't be written"),
    ],
)
def test_bad_input_is_told_in_one_line(
    arguments: list[str], told: str, asked: Asked, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "readme").write_text("no draw\n", encoding="utf-8")
    given = [text.format(here=tmp_path) for text in arguments]
    given += [] if "--out" in given else ["--out", str(tmp_path / "page.md")]
    try:
        code = asked(*given)
    except SystemExit as error:
        code = int(error.code or 0)
    assert code == 2
    said = capsys.readouterr().err.strip()
    assert told in said
    assert len(said.splitlines()) == 1


def test_bands_are_those_of_tables() -> None:
    low, high = study.chi_square_band(100)
    assert abs(100.0 * low - 67.328) < 0.001  # chi-square, 100 degrees: 0.005 and 0.995 quantiles
    assert abs(100.0 * high - 140.169) < 0.001
    assert abs(study.student(0.01, 9) - 3.250) < 0.001
    assert abs(study.student(0.01, 99) - 2.626) < 0.001
    assert study.nees_band([1.0] * 5, 20) == study.chi_square_band(100)
    values = np.random.default_rng(1).normal(1.0, 0.1, 10).tolist()
    half = 3.2498 * float(np.std(values, ddof=1)) / np.sqrt(10)
    assert study.nees_band(values) == pytest.approx((1.0 - half, 1.0 + half), rel=1e-4)
