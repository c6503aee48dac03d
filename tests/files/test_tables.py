"""Tables: which columns of places say what, and that a table of results says the same in all its forms."""

import csv
import io
from pathlib import Path

import numpy as np
import pytest
from outside import refuses

from mgsgraph.files.output.table import NONE, Column, Table, fixed, quoted
from mgsgraph.files.place_table import PlaceTable, Sort, read_places
from mgsgraph.geometry.body import geodetic, planetocentric
from mgsgraph.simulation.orbit import MARS
from mgsgraph.units import ARCSEC, DEG

# --- tables of places, read


def places_of(folder: Path, text: str, sort: Sort | None = None) -> PlaceTable:
    path = folder / "places.csv"
    path.write_text(text, encoding="utf-8")
    return read_places(path, MARS, sort)


def test_both_ways_to_count_pixels(tmp_path: Path) -> None:
    ours, isis = (places_of(tmp_path, f"{head}\n3.5,7\n") for head in ("line,Sample", "ISIS_LINE, isis_sample"))
    assert (ours.isis, isis.isis) == (False, True)
    np.testing.assert_array_equal(ours.pixels - isis.pixels, [[0.5, 0.5]])
    assert ours.heights is None
    own = places_of(tmp_path, "line,sample,height_m\n1,2,3\n")
    assert own.heights is not None
    assert own.heights.tolist() == [3.0]


def test_ground_places_of_every_kind(tmp_path: Path) -> None:
    round_ones = places_of(tmp_path, "longitude_deg,latitude_deg,radius_m\n10,20,3390000\n").points
    np.testing.assert_allclose(planetocentric(round_ones), [[10 * DEG, 20 * DEG, 3.39e6]])
    upright = places_of(tmp_path, "longitude_deg,geodetic_latitude_deg,height_m\n10,20,500\n").points
    np.testing.assert_allclose(geodetic(upright, MARS), [[10 * DEG, 20 * DEG, 500.0]])
    x, y, z = upright[0].tolist()
    np.testing.assert_array_equal(places_of(tmp_path, f"x_m,y_m,z_m\n{x!r},{y!r},{z!r}\n").points, upright)
    surface = places_of(tmp_path, "a,longitude_deg,latitude_deg\n7,10,20\n8,,\n")
    np.testing.assert_allclose(surface.directions, [[10 * DEG, 20 * DEG], [np.nan, np.nan]])
    assert surface.columns["a"] == ["7", "8"]


def test_of_both_it_has_to_be_said(tmp_path: Path) -> None:
    text = "line,sample,longitude_deg,latitude_deg\n1,2,3,4\n"
    refuses("--into image", places_of, tmp_path, text)
    assert places_of(tmp_path, text, "image").pixels.tolist() == [[1.0, 2.0]]
    assert places_of(tmp_path, text, "ground").pixels.shape == (0, 2)
    refuses("isis_line", places_of, tmp_path, "line,sample\n1,2\n", "ground")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("longitude_deg,latitude_deg,radius_km\n1,2,3380.0\n", "'radius_km'; expected"),
        ("line,sample,height\n1,2,3380.0\n", "'height'; expected height_m or radius_m"),
        ("line,sample\n", "header alone"),
        ("line,sample\n1,1_0\n", "line 2, sample"),
        ("longitude_deg,latitude_deg\n1,91\n", "line 2"),
        ("longitude_deg,latitude_deg,radius_m\n1,2,3396\n", "line 2, radius_m: .* not in km"),
        ("x_m,y_m,z_m\n3396,0,0\n", "line 2, z_m: .* not in km"),
    ],
)
def test_tables_that_are_refused(tmp_path: Path, text: str, said: str) -> None:
    refuses(said, places_of, tmp_path, text)


# --- tables of results: files, values for JSON, text, the page


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


def test_quoted_fields_read_back() -> None:
    for text in ("plain", "a, b", 'the "first"', '"', "two\nlines", ""):
        assert list(csv.reader(io.StringIO(f"{quoted(text)},{quoted(text)}\n", newline=""))) == [[text, text]]


def test_values_for_json_have_the_unit_of_their_row() -> None:
    first, second = TABLE.records()
    assert first["value_s"] == 1.5
    assert (second["value_m"], second["per_m"]) == (-2.5, 2.0)
    assert first["sigma_m"] == [1.0, 2.0]
    assert second["angle_deg"] is None
    assert (first["good"], first["list"], first["count"]) == (True, ["a"], 3)


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


def test_units_leave_si_at_this_edge() -> None:
    assert Column("turn", np.array([2.0 * ARCSEC]), "arcsec").scaled[0] == 2.0
    assert Column("turn", np.array([2.0]), "deg", scale=1.0).scaled[0] == 2.0


@pytest.mark.parametrize(("value", "said"), [(1.005e3, "1005.00"), (-0.001, "0.00"), (float("nan"), NONE)])
def test_fixed_decimals(value: float, said: str) -> None:
    assert fixed(value) == said
