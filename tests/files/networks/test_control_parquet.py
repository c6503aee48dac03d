"""Tables of tie points as Parquet: what CSV says comes back bit for bit, and what is wrong is said with its row."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from isis_networks import assert_same, grid
from msgspec.structs import replace
from pyarrow import parquet

from mgsgraph.errors import InputError
from mgsgraph.export.exchange import convert
from mgsgraph.files.kinds import Kind, kind_of
from mgsgraph.files.networks.record import ControlNetwork, PointType
from mgsgraph.files.networks.table import read_table, read_tie_points, table_parquet, table_text

COLUMNS: dict[str, Any] = {
    "id": ["a", "a", "b"], "image": ["A", "B", "A"], "line": [1.5, 2.5, 3.5], "sample": [10, 20, 30],
    "sigma_line_px": [0.5, None, float("nan")], "ignore": [False, None, False],
}  # fmt: skip


def put(folder: Path, **columns: Any) -> Path:
    path = folder / "ties.parquet"
    given = {name: values for name, values in (COLUMNS | columns).items() if values is not None}
    parquet.write_table(pa.table(given), path)
    return path


def network() -> ControlNetwork:
    points = list(grid(5, 3).points)
    place, covariance = (3390000.1, 1000.0 / 3.0, -2000.7), (100.0, 1.0, 2.0, 101.0, 1.0 / 3.0, 102.0)
    points[1] = replace(points[1], type=PointType.CONSTRAINED, apriori=place, apriori_covariance=covariance)
    points[2] = replace(points[2], ignore=True)
    points[3] = replace(points[3], measures=(), reference=None)
    return replace(grid(5, 3), points=tuple(points))


def test_a_network_comes_back_from_parquet_as_from_csv(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(table_text(network()))
    (tmp_path / "a.parquet").write_bytes(table_parquet(network()))
    found = read_tie_points(tmp_path / "a.parquet")
    expected = read_tie_points(tmp_path / "a.csv")
    assert_same(found, expected)
    assert len(found.ids) == 4
    other = replace(read_table(tmp_path / "a.csv"), source="")
    assert replace(read_table(tmp_path / "a.parquet"), source="") == other


def test_convert_writes_and_reads_it(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(table_text(network()))
    made = convert(tmp_path / "a.csv", tmp_path / "a.parquet")
    assert made.lost == ()
    assert kind_of(tmp_path / "a.parquet") is Kind.TIE_TABLE
    convert(tmp_path / "a.parquet", tmp_path / "b.csv")
    assert (tmp_path / "b.csv").read_text() == (tmp_path / "a.csv").read_text()
    convert(tmp_path / "a.csv", tmp_path / "a.parquet", replace=True)


def test_kinds_of_columns(tmp_path: Path) -> None:
    """Whole numbers, dictionaries and null are what they should be; NaN is as null."""
    path = put(tmp_path, id=[7, 7, 8], image=pa.array(["A", "B", "A"]).dictionary_encode())
    found = read_tie_points(path)
    assert found.ids == ("7", "8")
    assert found.measure_image == ("A", "B", "A")
    np.testing.assert_array_equal(found.measures, [[1.5, 10], [2.5, 20], [3.5, 30]])
    np.testing.assert_array_equal(found.measure_sigmas[:, 0], [0.5, np.nan, np.nan])


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"line": [1.5, float("inf"), 3.5]}, "row 2, point a, line: 'inf'; expected a finite number"),
        ({"line": [1.5, 2.5, None]}, "row 3, point b, line: nothing; expected a finite number"),
        ({"line": ["1", "x", "2"]}, "row 2, point a, line: 'x'; expected a finite number"),
        ({"image": ["A", "A", "A"]}, "row 2, point a, image A: a second measure in this image"),
        ({"id": ["a", None, "b"]}, "row 2: no id"),
        ({"id": ["a", "", "b"]}, "row 2: no id"),
        ({"id": [1.5, 2.5, 3.5]}, "column id: values of the kind double; expected texts"),
        ({"line": [True, False, True]}, "column line: values of the kind bool; expected numbers"),
        ({"ignore": [0.5, 1.0, 0.0]}, "column ignore: values of the kind double; expected truth values"),
        ({"ignore": ["no", "maybe", "yes"]}, "row 2, point a, ignore: 'maybe'"),
        ({"sigma_line_px": [0.5, -1.0, 0.0]}, "row 2, point a, sigma_line_px: -1; expected a positive number"),
        ({"sample": None}, "columns: columns line"),
        ({"colour": [1, 2, 3]}, "columns: an unknown column 'colour'"),
        ({"line": [], "sample": [], "id": [], "image": [], "sigma_line_px": [], "ignore": []}, ": no point"),
    ],
)  # fmt: skip
def test_a_fault_is_said_with_its_row_or_column(tmp_path: Path, columns: dict[str, Any], said: str) -> None:
    path = put(tmp_path, **columns)
    with pytest.raises(InputError) as caught:
        read_tie_points(path)
    assert said in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_damaged_files_are_refused_in_a_line(tmp_path: Path) -> None:
    path = put(tmp_path)
    sound, rng = path.read_bytes(), np.random.default_rng(3)
    for _ in range(100):
        content = bytearray(sound)
        for _ in range(int(rng.integers(1, 4))):
            content[int(rng.integers(len(content)))] = int(rng.integers(256))
        path.write_bytes(bytes(content[: int(rng.integers(1, len(content) + 1))]))
        with pytest.raises(InputError, match=r"ties\.parquet") as caught:
            read_tie_points(path)
        assert "\n" not in str(caught.value)


def test_a_file_that_says_to_hold_more_than_it_can(tmp_path: Path) -> None:
    """A thousand million rows of nothing pack into a few bytes."""
    path, rows = tmp_path / "ties.parquet", 40_000_000
    empty = pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, dtype=np.int8)), ["a"])
    parquet.write_table(pa.table({"id": empty}), path)
    with pytest.raises(InputError, match="rows"):
        read_tie_points(path)
