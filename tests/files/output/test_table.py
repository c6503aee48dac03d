"""A table says the same in all its forms: files, values for JSON, aligned text, the page."""

import csv
import io
from pathlib import Path

import numpy as np
import pytest

from mgsgraph.files.output.table import NONE, Column, Table, cut, fixed, quoted
from mgsgraph.units import DEG, MGON

TABLE = Table("things", "Things", (
    Column("name", ['a "b", c', "a name that is too long"], page="s", label="Things", text="<12"),
    Column("count", np.array([3, 4]), page="s", text=">6"),
    Column("good", np.array([True, False])),
    Column("angle", np.array([90.0 * DEG, np.nan]), "deg", page=".1f", label="angle", text=">7.2f"),
    Column("{}_sigma", np.array([[1.0, 2.0], [np.inf, 4.0]]), "m", parts=("x", "y"), head="σ {}", page=".2f",
           label="sigma [m]", text=">6", gap=2),
    Column("value", np.array([1.5, -2.5]), ["s", "m"], text=">+8.3g"),
    Column("per_{unit}", np.array([1.0, 2.0]), ["s", "m"]),
    Column("list", [["a"], []]),
), "A note.")  # fmt: skip


def test_csv_has_units_in_names_and_reads_back(tmp_path: Path) -> None:
    TABLE.drop("list").write_csv(tmp_path / "things.csv")
    with (tmp_path / "things.csv").open(encoding="utf-8", newline="") as file:
        first, second = csv.DictReader(file)
    assert list(first) == ["name", "count", "good", "angle_deg", "x_sigma_m", "y_sigma_m", "value", "per_unit"]
    assert first["name"] == 'a "b", c'
    assert (first["count"], first["good"], second["good"]) == ("3", "true", "false")
    assert float(first["angle_deg"]) == 90.0
    assert (second["angle_deg"], second["x_sigma_m"]) == ("", "")


@pytest.mark.parametrize("text", ["plain", "a, b", 'the "first"', '"', "two\nlines", ""])
def test_quoted_fields_read_back(text: str) -> None:
    assert list(csv.reader(io.StringIO(f"{quoted(text)},{quoted(text)}\n", newline=""))) == [[text, text]]


def test_values_for_json_have_the_unit_of_their_row() -> None:
    first, second = TABLE.records()
    assert first["value_s"] == 1.5
    assert (second["value_m"], second["per_m"]) == (-2.5, 2.0)
    assert first["sigma_m"] == [1.0, 2.0]
    assert second["angle_deg"] is None
    assert (first["good"], first["list"], first["count"]) == (True, ["a"], 3)


def test_text_is_aligned_under_its_headings() -> None:
    head, parts, first, second = TABLE.text(indent=2)
    assert head.startswith("Things          count   angle")
    assert parts.split() == ["x", "y"]
    assert first.split()[-2:] == ["2.000", "+1.5"]
    assert "-" in second
    assert second.startswith("  a nam...long ")
    at = head.index("sigma [m]") + len("sigma [m]")
    assert parts[:at].endswith("y")
    assert first[:at].endswith("2.000")


def test_some_rows_say_something_else_and_the_rest_is_counted() -> None:
    table = Table("few", "Few", TABLE.columns[:4], instead={1: ("angle", "refused")})
    assert table.text()[-1].endswith("4 refused")
    assert table.text(1, "more thing: see things.csv", indent=2)[-1] == "  and 1 more thing: see things.csv"


def test_the_page_has_headings_cells_and_a_dash_for_what_is_not_known() -> None:
    assert TABLE.headings == [("name", ""), ("count", ""), ("angle", "deg"), ("σ x", "m"), ("σ y", "m")]
    assert TABLE.rows[1] == ["a name that is too long", "4", NONE, NONE, "4.00"]
    assert TABLE.numeric == (False, True, True, True, True)


def test_columns_and_rows_are_picked() -> None:
    table = TABLE.pick("count", "name").take(np.array([1]))
    assert [column.key for column in table.columns] == ["count", "name"]
    assert table.rows == [["4", "a name that is too long"]]
    assert TABLE.last("name").columns[-1].key == "name"
    assert len(TABLE.take(np.zeros(0, dtype=np.int64))) == 0


def test_units_leave_si_at_this_edge() -> None:
    assert Column("turn", np.array([2.0 * MGON]), "mgon").scaled[0] == 2.0
    assert Column("turn", np.array([2.0]), "deg", scale=1.0).scaled[0] == 2.0


@pytest.mark.parametrize(("value", "said"), [(1.005e3, "1005.00"), (-0.001, "0.00"), (float("nan"), NONE)])
def test_fixed_decimals(value: float, said: str) -> None:
    assert fixed(value) == said


def test_what_was_cut_is_said() -> None:
    assert cut(3, 3, "", "") == ""
    assert cut(30, 3, "the first ones", "a.csv").startswith("3 of 30 are listed, the first ones; a.csv")
