"""`mgsgraph nodes` as a person uses it: a case with strips, a table, files, one line for errors."""

import csv
import json
import re
from pathlib import Path

import pytest
from commands import call
from increments import strip

from mgsgraph.errors import InputError
from mgsgraph.simulation.files import write_strip


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six images, each a strip of its own."""
    folder, made = tmp_path_factory.mktemp("nodes"), strip(6)
    write_strip(made, folder)
    table = '\n[[passes]]\nname = "{0}"\nimages = ["{0}"]\nprior = {{}}\n'
    tables = "".join(table.format(one.name) for one in made.images)
    with (folder / "case.toml").open("a", encoding="utf-8") as file:
        file.write(tables)
    return folder / "case.toml"


@pytest.mark.slow
def test_table_sentences_and_files(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = case.parent / "out"
    arguments = ("nodes", case, "--spacings", "3,0.02,1.85", "--hold-out", "0.5", "--out", out)
    assert call(*arguments) == 0
    said = capsys.readouterr().out
    assert re.search(r"^ +0\.02 +\d+ +refused: pass 'STRIP/000N', nodes closer than the data supports", said, re.M)
    assert re.search(r"^ +(1\.85|3) .* chosen$", said, re.M)
    assert "rays held out" in said
    record = json.loads((out / "nodes.json").read_text(encoding="utf-8"))
    assert record["chosen_s"] in (1.85, 3.0)
    with (out / "spacings.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert (rows[0]["spacing_s"], rows[0]["standing"]) == ("0.02", "refused")
    assert call(*arguments) == 0  # an earlier study is replaced


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--spacings", "four"), "'four'; expected positive numbers of seconds"),
        (("--spacings", "4,-1"), "positive numbers"),
        (("--spacings", "3"), "two or more that differ"),
        (("--spacings", "3,0.02", "--hold-out", "2"), "share of 2.0"),
    ],
)
def test_bad_options_are_one_line(case: Path, options: tuple[str, ...], words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)) as caught:
        call("nodes", case, *options)
    assert "\n" not in str(caught.value)


def test_case_without_strips(tmp_path: Path) -> None:
    write_strip(strip(6).upto(2), tmp_path)
    with pytest.raises(InputError, match="no strips"):
        call("nodes", tmp_path / "case.toml")


def test_foreign_folder_is_left_alone(case: Path, tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match="not a result"):
        call("nodes", case, "--out", tmp_path)
