"""A finding on the terminal and in files."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from mgsgraph.files.output.folders import PLAN
from mgsgraph.files.output.table import Column, Table
from mgsgraph.results.section import Section, write_sections

TABLE = Table("plan", "Some rows", (
    Column("name", [f"row {k}" for k in range(5)], text="<6"),
    Column("length", np.arange(5.0), "m", text=">7.1f"),
    Column("hidden", np.arange(5.0), "m", json="another_m"),
))  # fmt: skip
FOUND = Section("found", "Five rows", ["They are there."], [TABLE], {"rows": TABLE.records()}, [TABLE])


def test_text_has_sentences_and_as_many_rows_as_wanted() -> None:
    assert FOUND.text(2).splitlines() == [
        "Five rows", "- They are there.", "", "Some rows", "name      length", "               m", "  row 0      0.0",
        "  row 1      1.0", "  and 3 more rows: see plan.csv",
    ]  # fmt: skip
    assert len(FOUND.text(None).splitlines()) == 11
    for nothing in (TABLE.take(np.zeros(0, dtype=np.int64)), TABLE.pick("hidden")):
        assert replace(FOUND, tables=[nothing]).text() == "Five rows\n- They are there."


def test_files_hold_the_record_and_all_rows(tmp_path: Path) -> None:
    assert write_sections([FOUND], FOUND.numbers, tmp_path / "out", PLAN, figures=False) == [PLAN, "plan.csv"]
    record = json.loads((tmp_path / "out" / PLAN).read_text(encoding="utf-8"))
    assert record["rows"][4] == {"name": "row 4", "length_m": 4.0, "another_m": 4.0}
    assert (tmp_path / "out" / "plan.csv").read_text(encoding="utf-8").splitlines()[0] == "name,length_m,hidden_m"
