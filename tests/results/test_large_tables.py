"""Tables of points and residuals as Parquet are those of the CSV files, number for number."""

import json
from pathlib import Path

import numpy as np
import pytest
from networks import network, pair
from pyarrow import csv, parquet

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.files.rasters.raster_file import geographic_crs
from mgsgraph.results import tables as large_tables
from mgsgraph.results.results import write_results
from mgsgraph.results.tables import form_of, points_table, residuals_table, write_large_tables


@pytest.fixture(scope="module")
def solution() -> Solution:
    return adjust_network(network(pair()), SolverSettings())


def test_parquet_holds_what_csv_does(solution: Solution, tmp_path: Path) -> None:
    for form in ("csv", "parquet"):
        names = write_results(solution, tmp_path / form, figures=False, tables=form)  # type: ignore[arg-type]
        assert {f"points.{form}", f"residuals.{form}"} <= set(names)
    for name in ("points", "residuals"):
        one = csv.read_csv(tmp_path / "csv" / f"{name}.csv")
        other = parquet.read_table(tmp_path / "parquet" / f"{name}.parquet")
        left = other.drop_columns(["geometry"]) if name == "points" else other
        assert one.column_names == left.column_names
        for column in one.column_names:
            assert [x or None for x in one[column].to_pylist()] == [x or None for x in left[column].to_pylist()], column


def test_places_are_in_geoparquet(solution: Solution, tmp_path: Path) -> None:
    write_results(solution, tmp_path / "r", figures=False, tables="parquet")
    table = parquet.read_table(tmp_path / "r" / "points.parquet")
    about = json.loads(table.schema.metadata[b"geo"])
    assert about["columns"]["geometry"]["crs"] == geographic_crs(solution.network.images[0].body)
    shapely = pytest.importorskip("shapely")
    shapes = shapely.from_wkb(np.array(table["geometry"].to_pylist(), dtype=object))
    lon, lat = table["lon_deg"].to_numpy(), table["lat_deg"].to_numpy()
    np.testing.assert_allclose(shapely.get_x(shapes) % 360.0, lon, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(shapely.get_y(shapes), lat)


def test_the_longer_table_decides(solution: Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    assert form_of(solution) == "csv"
    assert form_of(solution, "parquet") == "parquet"
    monkeypatch.setattr(large_tables, "MOST_CSV_ROWS", 10)
    assert form_of(solution) == "parquet"
    assert form_of(solution, "csv") == "csv"


def test_large_tables_are_the_small_ones(solution: Solution, tmp_path: Path) -> None:
    whole = (table(solution).arrow for table in (points_table, residuals_table))
    for name, expected in zip(write_large_tables(solution, tmp_path, "parquet"), whole, strict=True):
        found = parquet.read_table(tmp_path / name)
        for column in expected.column_names:
            assert found[column].to_pylist() == expected[column].to_pylist(), column
