"""Tables of points by hand and as Parquet: both counts, units in the names, faults with line and point."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from control_networks import assert_same, grid
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec import structs
from msgspec.structs import replace
from outside import refuses
from pyarrow import parquet

from mgsgraph.errors import InputError
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, MeasureType, PointType
from mgsgraph.files.networks.table import read_table, read_tie_points, table_parquet, table_text
from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.geometry.body import Ellipsoid, east_north_up, from_geodetic, from_planetocentric
from mgsgraph.units import DEG

# --- by hand


MARS = Ellipsoid(3396190.0, 3376200.0)
HAND = """\
# measured by hand, 2026
id, image, isis_line, isis_sample, sigma_line_px, sigma_sample_px

crater, E02-01461, 283.25, 782.5, 0.5, 0.25
crater, M01-00115, 834, 454, ,
  # and one more
ridge, E02-01461, 1, 1, ,
"""


def read(folder: Path, text: str, ellipsoid: Ellipsoid | None = None) -> ControlNetwork:
    path = folder / "points.csv"
    path.write_text(text, encoding="utf-8")
    return read_table(path, ellipsoid)


def ties_of(folder: Path, text: str) -> TiePoints:
    path = folder / "points.csv"
    path.write_text(text)
    return read_tie_points(path)


def test_a_hand_written_table(tmp_path: Path) -> None:
    crater, ridge = read(tmp_path, HAND).points

    assert (crater.id, crater.type, ridge.id) == ("crater", PointType.FREE, "ridge")
    first, second = crater.measures
    assert first == ControlMeasure("E02-01461", MeasureType.MANUAL, 782.5, 283.25, sample_sigma=0.25, line_sigma=0.5)
    assert second.line_sigma is None


def test_the_two_counts_differ_by_half_a_pixel(tmp_path: Path) -> None:
    """The first pixel's centre: (1, 1) as ISIS has it, (0.5, 0.5) from the corner."""
    corner = HAND.replace("isis_", "").replace("283.25, 782.5", "282.75, 782").replace("834, 454", "833.5, 453.5")
    corner = corner.replace(" 1, 1,", " 0.5, 0.5,")
    assert read(tmp_path, corner) == read(tmp_path, HAND)
    np.testing.assert_array_equal(ties_of(tmp_path, HAND).measures[0], [282.75, 782])


def test_the_real_table_of_the_moc_pair(shared_data: Path, tmp_path: Path) -> None:
    """Its columns must be renamed, which is said in one line; its control points have no places. 66 points then."""
    path = shared_data / "mgs_moc_pair" / "tie_points.csv"
    refuses(r"'product'; .*rename it to 'image'; and name line and sample isis_line and", read_table, path)

    first, rest = path.read_text().split("\n", 1)
    renamed = first.replace("product", "image").replace("line", "isis_line").replace("sample", "isis_sample")
    with pytest.raises(InputError, match=r"point gcp001: constrained without an a-priori place; .*make the point free"):
        ties_of(tmp_path, f"{renamed}\n{rest}")
    rest = rest.replace("Constrained", "Free").replace("Fixed", "Free")
    ties = ties_of(tmp_path, f"{renamed}\n{rest}")

    assert len(ties.ids) == 66
    np.testing.assert_allclose(ties.measures[0], [283.0962798003462 - 0.5, 782.1881545442291 - 0.5], rtol=1e-15)


def test_the_table_of_the_documentation(tmp_path: Path) -> None:
    page = Path(__file__).resolve().parents[3] / "docs" / "exchange.md"
    (table,) = re.findall(r"```text\n(.+?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    ties = ties_of(tmp_path, table)
    assert ties.ids == ("rim", "hill")
    assert np.linalg.norm(ties.places[1]) == pytest.approx(3391200)


def test_places_in_three_ways(tmp_path: Path) -> None:
    x, y, z = 1485514.8, -2937138.2, 829401.9
    head = "id,image,line,sample,type"
    cartesian = read(tmp_path, f"{head},x_m,y_m,z_m\na,,,,fixed,{x},{y},{z}\n")
    centric = read(tmp_path, f"{head},longitude_deg,latitude_deg,radius_m\na,,,,fixed,137.5,-14.6,3396000\n")
    detic = read(tmp_path, f"{head},longitude_deg,geodetic_latitude_deg,height_m\na,,,,fixed,137.5,-14.6,-1900\n", MARS)

    assert cartesian.points[0].apriori == (x, y, z)
    expected = from_planetocentric(np.array([137.5 * DEG, -14.6 * DEG, 3396000.0]))
    np.testing.assert_allclose(centric.points[0].apriori, expected, rtol=1e-15)
    expected = from_geodetic(np.array([137.5 * DEG, -14.6 * DEG, -1900.0]), MARS)
    np.testing.assert_allclose(detic.points[0].apriori, expected, rtol=1e-15)
    assert cartesian.points[0].measures == ()


def test_sigmas_in_four_ways(tmp_path: Path) -> None:
    head = "id,image,line,sample,type,longitude_deg,latitude_deg,radius_m"
    row = "a,,,,Constrained,137.5,-14.6,3396000"
    place = from_planetocentric(np.array([137.5 * DEG, -14.6 * DEG, 3396000.0]))
    axes = east_north_up(place[None])[0]

    local = read(tmp_path, f"{head},sigma_longitude_m,sigma_latitude_m,sigma_radius_m\n{row},10,20,3\n").points[0]
    straight = read(tmp_path, f"{head},sigma_x_m,sigma_y_m,sigma_z_m\n{row},10,20,3\n").points[0]
    names = ",".join(f"covariance_{pair}_m2" for pair in ("xx", "xy", "xz", "yy", "yz", "zz"))
    matrix = read(tmp_path, f"{head},{names}\n{row},100,1,2,200,3,300\n").points[0]
    detic = head.replace("latitude", "geodetic_latitude").replace("radius", "height")
    detic += ",sigma_longitude_m,sigma_latitude_m,sigma_height_m"
    upright = read(tmp_path, f"{detic}\n{row.replace('3396000', '0')},1e-3,1e-3,3\n", MARS).points[0]

    expected = axes.T @ np.diag([100.0, 400.0, 9.0]) @ axes
    np.testing.assert_allclose(local.apriori_covariance, expected[np.triu_indices(3)], atol=1e-10)
    assert straight.apriori_covariance == (100.0, 0.0, 0.0, 400.0, 0.0, 9.0)
    assert matrix.apriori_covariance == (100.0, 1.0, 2.0, 200.0, 3.0, 300.0)
    longitude, latitude = 137.5 * DEG, -14.6 * DEG
    normal = [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)]
    expected = 9.0 * np.outer(normal, normal)
    np.testing.assert_allclose(upright.apriori_covariance, expected[np.triu_indices(3)], atol=1e-5)


def test_what_is_of_the_point_is_said_once_or_alike(tmp_path: Path) -> None:
    head = "id,image,line,sample,type,x_m,y_m,z_m\n"
    once = read(tmp_path, head + "a,one,1,1,Fixed,1,2,3\na,two,1,1,,,,\n")
    assert once == read(tmp_path, head + "a,one,1,1,Fixed,1,2,3\na,two,1,1,Fixed,1,2,3\n")
    with pytest.raises(InputError, match="line 3, point a, type: 'free', and 'fixed' in an earlier row"):
        read(tmp_path, head + "a,one,1,1,fixed,1,2,3\na,two,1,1,free,,,\n")


@pytest.mark.parametrize(
    ("header", "said"),
    [
        ("id,image,line,sample,sigma_lin_px", "unknown column 'sigma_lin_px'; .*'sigma_line_px'"),
        ("id,image,line,sample,sigma_east_m", "unknown column 'sigma_east_m'; .*'sigma_longitude_m'"),
        ("id,image,line,sample,isis_line,isis_sample", "columns line, sample, isis_line, isis_sample; e"),
        ("id,image,line,sample,longitude_deg,latitude_deg,height_m", "columns longitude_deg, latitude_d"),
        ("id,image,line,sample,sigma_x_m,sigma_y_m,sigma_z_m", "sigma_x_m without an a-priori place"),
        ("id;image;line;sample", "fields with semicolons between them; .*points in the numbers"),
    ],
)
def test_a_wrong_header_is_said(tmp_path: Path, header: str, said: str) -> None:
    refuses(f"points.csv, line 1: .*{said}", read, tmp_path, f"{header}\n")


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ('a,two,"1,5",1,,', "line 4, point a, line: '1,5'; expected a finite number; write a decimal p"),
        ("a,two,1,5,1,5,,,", "line 4: 9 fields; expected 6, as in the header; write decimal"),
        (",two,1,1,,", "line 4: no id"),
        ("a,two,1,1,0,", "line 4, point a, sigma_line_px: 0; expected a positive number"),
        ("a,one,1,1,,", "line 4, point a, image one: a second measure in this image"),
        ("b,one,1,1,,fixed", "line 4, point b: fixed without an a-priori place"),
    ],
)
def test_a_wrong_row_is_said(tmp_path: Path, row: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, f"# a comment\nid,image,line,sample,sigma_line_px,type\na,one,1,1,,\n{row}\n")
    assert str(caught.value).startswith(f"{tmp_path / 'points.csv'}, {said}")


@pytest.mark.parametrize(
    ("columns", "row", "said"),
    [
        ("x_m,y_m,z_m", "1,2,3", "constrained without sigmas"),
        ("longitude_deg,latitude_deg,radius_m", "1,91,3", "latitude_deg: 91; expected -90 .. 90"),
        ("longitude_deg,geodetic_latitude_deg,height_m", "1,1,1", "height above an unknown ellipsoid; .*--radii"),
    ],
)
def test_a_wrong_control_point_is_said(tmp_path: Path, columns: str, row: str, said: str) -> None:
    with pytest.raises(InputError, match=f"line 2, point a.*{said}"):
        read(tmp_path, f"id,image,line,sample,type,{columns}\na,one,1,1,constrained,{row}\n")


NUMBERS = st.floats(-1e12, 1e12)
NAMES = st.text(min_size=1).filter(lambda text: text == text.strip() and text.isprintable())
SIGMAS = st.none() | st.floats(1e-6, 1e3)


@st.composite
def networks(draw: st.DrawFn) -> ControlNetwork:
    """All that a table can hold."""
    points = []
    for name in draw(st.lists(NAMES, min_size=1, max_size=4, unique=True)):
        measures = tuple(
            ControlMeasure(
                image, draw(st.sampled_from(MeasureType)), draw(NUMBERS), draw(NUMBERS), ignore=draw(st.booleans()),
                sample_sigma=draw(SIGMAS), line_sigma=draw(SIGMAS),
            )
            for image in draw(st.lists(NAMES, max_size=3, unique=True))
        )  # fmt: skip
        kind = draw(st.sampled_from(PointType))
        known = kind != PointType.FREE or draw(st.booleans())
        covered = kind == PointType.CONSTRAINED or (known and draw(st.booleans()))
        x, y, z, xx, xy, xz, yy, yz, zz = (draw(NUMBERS) for _ in range(9))
        points.append(
            ControlPoint(
                name, kind, measures, ignore=draw(st.booleans()), apriori=(x, y, z) if known else None,
                reference=draw(st.none() | st.integers(0, len(measures) - 1)) if measures else None,
                apriori_covariance=(abs(xx) + 1, xy, xz, abs(yy) + 1, yz, abs(zz) + 1) if covered else (),
            )
        )  # fmt: skip
    return ControlNetwork("", "", tuple(points))


@given(given=networks())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
def test_what_a_table_can_hold_survives(tmp_path: Path, given: ControlNetwork) -> None:
    assert read(tmp_path, table_text(given)).points == given.points


def test_names_that_no_table_can_hold_are_refused() -> None:
    point = ControlPoint("a", PointType.FREE, (ControlMeasure("a\nb", MeasureType.MANUAL, 1, 1),))
    refuses("one line without blanks around it", table_text, ControlNetwork("", "", (point,)))


def test_what_no_adjustment_uses_may_be_zero_or_missing(tmp_path: Path) -> None:
    """ISIS writes covariances of zeros, and points that are ignored need not have any; a sigma of zero is none."""
    measure = ControlMeasure("A", MeasureType.MANUAL, 1.0, 2.0)
    known = ControlPoint("a", PointType.FREE, (measure,), apriori=(1.0, 2.0, 3.0), apriori_covariance=(0.0,) * 6)
    ignored = structs.replace(known, id="b", type=PointType.CONSTRAINED, ignore=True)
    bare = ControlPoint("c", PointType.CONSTRAINED, (measure,), ignore=True)
    zero = ControlPoint("d", PointType.FREE, (structs.replace(measure, line_sigma=0.0, sample_sigma=0.5),))
    *back, last = read(tmp_path, table_text(ControlNetwork("", "", (known, ignored, bare, zero)))).points
    assert back == [known, ignored, bare]
    assert (last.measures[0].line_sigma, last.measures[0].sample_sigma) == (None, 0.5)


def test_files_of_other_programs_must_be_converted_first(tmp_path: Path) -> None:
    refuses(r"a .nvm file; .*mgsgraph convert a.NVM network.net", read_tie_points, tmp_path / "a.NVM")


def test_kilometres_are_noticed_where_the_body_is_known(tmp_path: Path) -> None:
    text = "id,image,line,sample,x_m,y_m,z_m\na,A,1,1,3300,600,500\n"
    assert read(tmp_path, text).points[0].apriori is not None
    refuses(r"line 2, point a, .*m from the body's centre; expected about 3.39619e\+06 m", read, tmp_path, text, MARS)


# --- Parquet


COLUMNS: dict[str, Any] = {
    "id": ["a", "a", "b"], "image": ["A", "B", "A"], "line": [1.5, 2.5, 3.5], "sample": [10, 20, 30],
    "sigma_line_px": [0.5, None, float("nan")], "ignore": [False, None, False],
}  # fmt: skip


def put(folder: Path, **columns: Any) -> Path:
    path = folder / "ties.parquet"
    given = {name: values for name, values in (COLUMNS | columns).items() if values is not None}
    parquet.write_table(pa.table(given), path)
    return path


def some_of_all() -> ControlNetwork:
    points = list(grid(5, 3).points)
    place, covariance = (3390000.1, 1000.0 / 3.0, -2000.7), (100.0, 1.0, 2.0, 101.0, 1.0 / 3.0, 102.0)
    points[1] = replace(points[1], type=PointType.CONSTRAINED, apriori=place, apriori_covariance=covariance)
    points[2] = replace(points[2], ignore=True)
    points[3] = replace(points[3], measures=(), reference=None)
    return replace(grid(5, 3), points=tuple(points))


def test_a_network_comes_back_from_parquet_as_from_csv(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(table_text(some_of_all()))
    (tmp_path / "a.parquet").write_bytes(table_parquet(some_of_all()))
    found = read_tie_points(tmp_path / "a.parquet")
    expected = read_tie_points(tmp_path / "a.csv")
    assert_same(found, expected)
    assert len(found.ids) == 4
    other = replace(read_table(tmp_path / "a.csv"), source="")
    assert replace(read_table(tmp_path / "a.parquet"), source="") == other


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
        ({"image": ["A", "A", "A"]}, "row 2, point a, image A: a second measure in this image"),
        ({"id": ["a", None, "b"]}, "row 2: no id"),
        ({"line": [True, False, True]}, "column line: values of the kind bool; expected numbers"),
        ({"line": [], "sample": [], "id": [], "image": [], "sigma_line_px": [], "ignore": []}, ": no point"),
    ],
)
def test_a_fault_is_said_with_its_row_or_column(tmp_path: Path, columns: dict[str, Any], said: str) -> None:
    refuses(rf"ties\.parquet.*{said}", read_tie_points, put(tmp_path, **columns))


def test_a_file_that_says_to_hold_more_than_it_can(tmp_path: Path) -> None:
    """A thousand million rows of nothing pack into a few bytes."""
    path, rows = tmp_path / "ties.parquet", 40_000_000
    empty = pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, dtype=np.int8)), ["a"])
    parquet.write_table(pa.table({"id": empty}), path)
    refuses("rows", read_tie_points, path)
