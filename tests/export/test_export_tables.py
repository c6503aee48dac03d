"""GeoParquet, frames and arrays of a solution in other libraries' hands: the figures of the results' own tables."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import shapely
from gis_files import degrees, odd_solution, tool
from outside import refuses
from pyarrow import csv, parquet

import mgsgraph
from mgsgraph.adjustment.solution import OrientationProfile, Solution, orientation_profile
from mgsgraph.export.gis import footprint_layers, write_gis
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.network.connectivity import network_footprints
from mgsgraph.results.results import write_results

pytest.importorskip("pyogrio", reason="the extra [gis] is not installed")
geopandas = pytest.importorskip("geopandas", reason="the extra [tables] is not installed")
FILES = ("points", "residuals", "footprints", "error_ellipses")


@pytest.fixture(scope="module")
def solution() -> Solution:
    return odd_solution()


@pytest.fixture(scope="module")
def folder(solution: Solution, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("tables") / "out"
    write_results(solution, out, figures=False, tables="parquet")
    return out


@pytest.fixture(scope="module")
def results(solution: Solution, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("results") / "out"
    write_results(solution, out, figures=False, tables="csv")
    return out


def same(found: Any, expected: pa.ChunkedArray) -> bool:
    """Whether two columns are the same to the last bit, or both unknown."""
    one = [None if value is None or value != value else value for value in found]
    return one == [value if value != "" else None for value in expected.to_pylist()]


# --- GeoParquet


def test_geopandas_reads_what_the_csv_file_says(folder: Path, results: Path) -> None:
    expected = csv.read_csv(results / "points.csv")
    found = geopandas.read_parquet(folder / "points.parquet")
    assert set(found.columns) == {*expected.column_names, "geometry"}
    for column in expected.column_names:
        texts = [None if value == "" else value for value in found[column].tolist()]
        assert same(texts, expected[column]), column
    assert found.crs.to_authority() == ("IAU_2015", "49900")
    there = ~found.geometry.isna()
    assert there.tolist() == np.isfinite(found["x_m"]).tolist()
    east = found.geometry.x[there] % 360.0
    assert east.tolist() == found["lon_deg"][there].tolist()
    assert found.geometry.y[there].tolist() == found["lat_deg"][there].tolist()


def test_duckdb_reads_the_same_points(folder: Path, results: Path) -> None:
    """As docs/export.md has it."""
    duckdb = pytest.importorskip("duckdb", reason="duckdb (of the extra [test]) is not installed")
    with duckdb.connect() as base:
        base.execute("set enable_geoparquet_conversion = false")  # for shapes it would fetch its spatial extension
        rows = base.execute("select x_m, lat_deg from read_parquet(?)", [str(folder / "points.parquet")]).fetchall()
    expected = csv.read_csv(results / "points.csv")
    for column, name in zip(zip(*rows, strict=True), ("x_m", "lat_deg"), strict=True):
        assert same(column, expected[name]), name


def test_shapes_beyond_half_a_turn_are_those_of_the_columns(solution: Solution, tmp_path: Path) -> None:
    """West of the prime meridian: 360 degrees less, without rounding."""
    turn = np.diag([-1.0, -1.0, 1.0])
    turned = replace(solution, places=solution.places @ turn)
    frame = mgsgraph.to_geopandas(turned, "points").dropna(subset=["lon_deg"])
    assert frame["lon_deg"].min() > 180.0
    assert frame.geometry.x.max() < 0.0
    assert (frame.geometry.x + 360.0).tolist() == frame["lon_deg"].tolist()


def test_the_file_says_its_body(folder: Path) -> None:
    about = json.loads(parquet.read_schema(folder / "points.parquet").metadata[b"geo"])
    column = about["columns"][about["primary_column"]]
    assert column["crs"]["id"] == {"authority": "IAU", "code": 49900, "version": 2015}
    shapes = geopandas.read_parquet(folder / "points.parquet").geometry
    assert set(shapes.dropna().geom_type) == set(column["geometry_types"])


OF_OTHER_RADII = [
    ((1737400.0, 1737400.0), "Moon (2015) - Sphere / Ocentric", ("IAU_2015", "30100")),
    ((3396000.0, 3376000.0), "Mars, sphere of 3396000.000 m / Ocentric", None),
]


def with_radii(solution: Solution, radii: tuple[float, float]) -> Solution:
    images = tuple(replace(image, body=Ellipsoid(*radii)) for image in solution.network.images)
    return replace(solution, network=replace(solution.network, images=images))


@pytest.mark.parametrize(("radii", "name", "code"), OF_OTHER_RADII)
def test_bodies_of_their_own_radii(
    solution: Solution, radii: tuple[float, float], name: str, code: tuple[str, str] | None, tmp_path: Path
) -> None:
    write_results(with_radii(solution, radii), tmp_path / "out", figures=False, tables="parquet")
    found = geopandas.read_parquet(tmp_path / "out" / "points.parquet").crs
    assert (found.name, found.to_authority(), found.ellipsoid.semi_major_metre) == (name, code, radii[0])


@pytest.mark.program("ogrinfo")
def test_gdal_finds_the_bodies_names(solution: Solution, tmp_path: Path) -> None:
    for radii, name, _ in OF_OTHER_RADII:
        write_gis(with_radii(solution, radii), tmp_path)
        assert name in tool("ogrinfo", "-ro", "-so", tmp_path / "solution.gpkg", "tie_points")


def test_footprints_and_ellipses_are_the_layers(solution: Solution) -> None:
    layer = footprint_layers(solution)[1]
    found = mgsgraph.to_geopandas(solution, "footprints")
    assert found["image"].tolist() == list(layer.fields["image"])
    assert found["area_km2"].tolist() == layer.fields["area_km2"].tolist()
    assert shapely.equals(found.geometry.to_numpy(), layer.shapes).all()
    ellipses = mgsgraph.to_geopandas(solution, "error_ellipses")
    assert (ellipses["exaggeration"] == 1.0).all()
    assert len(ellipses) == int(solution.determined.sum()) == ellipses.geometry.notna().sum()


# --- frames and arrays


@pytest.mark.parametrize("name", ["points", "residuals", "orientation", "connectivity", "shared"])
def test_pandas_has_the_tables_of_the_results(solution: Solution, results: Path, name: str) -> None:
    found, expected = mgsgraph.to_pandas(solution, name), csv.read_csv(results / f"{name}.csv")
    assert list(found.columns) == expected.column_names
    for column in expected.column_names:
        assert same([None if one == "" else one for one in found[column].tolist()], expected[column]), column


def test_frames_with_shapes(solution: Solution) -> None:
    for name in FILES:
        frame = mgsgraph.to_geopandas(solution, name)
        assert frame.crs.to_authority() == ("IAU_2015", "49900")
        plain = mgsgraph.to_pandas(solution, name)
        assert list(plain.columns) == [column for column in frame.columns if column != "geometry"]
        assert len(plain) == len(frame)
    at = mgsgraph.to_geopandas(solution, "residuals").geometry
    rays = solution.network.rays.point
    there = np.isfinite(solution.places[rays, 0])
    off = shapely.get_coordinates(at.to_numpy()[: rays.size][there]) - degrees(solution.places[rays[there]])
    assert np.abs(off).max() < 1e-12


def test_xarray_has_the_orientation_of_each_image(solution: Solution) -> None:
    pytest.importorskip("xarray", reason="the extra [tables] is not installed")
    found = mgsgraph.to_xarray(solution, places=7)
    assert dict(found.sizes) == {"image": 2, "place": 7, "axis": 3, "angle": 3, "camera_axis": 3}
    units = {"lines": "1", "times": "s", "position_after": "m", "angles_sigma": "rad", "rotation": "rad"}
    assert {name: found[name].attrs["units"] for name in units} == units
    for image in solution.network.images:
        profile = orientation_profile(solution, image.name, 7)
        for name in found.data_vars:
            mine = found[name].sel(image=image.name).to_numpy()
            np.testing.assert_array_equal(mine, getattr(profile, str(name)))
    assert set(found.data_vars) == set(OrientationProfile.__dataclass_fields__)
    kappa = found["angles_after"].sel(image="SIM/B", angle="kappa").to_numpy()
    np.testing.assert_array_equal(kappa, orientation_profile(solution, "SIM/B", 7).angles_after[:, 2])


def test_geo_interfaces(solution: Solution) -> None:
    footprint = network_footprints(solution.network, solution.places)[0]
    shape = shapely.geometry.shape(footprint.__geo_interface__["geometry"])
    assert footprint.__geo_interface__["properties"]["image"] == footprint.name
    assert np.abs(np.array(shape.exterior.coords).mean(axis=0) - degrees(footprint.outline).mean(axis=0)).max() < 0.01


@pytest.mark.parametrize("module", ["pandas", "geopandas", "xarray"])
def test_without_the_extra_it_says_what_to_install(
    solution: Solution, module: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    refuses(r"pip install .mgsgraph\[tables\]", getattr(mgsgraph, f"to_{module}"), solution)


def test_tables_that_there_are_not(solution: Solution) -> None:
    refuses(r"'heights'; expected one of orientation, .*points", mgsgraph.to_pandas, solution, "heights")
    refuses("without any", mgsgraph.to_pandas, solution, "passes")
