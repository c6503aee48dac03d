"""Tables of points as a person writes them: both counts, units in the names, faults with line and point."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mgsgraph.errors import InputError
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, MeasureType, PointType
from mgsgraph.files.networks.table import read_table, read_tie_points, table_text
from mgsgraph.geometry.body import Ellipsoid, east_north_up, from_geodetic, from_planetocentric
from mgsgraph.units import DEG

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
    (tmp_path / "points.csv").write_text(HAND)
    np.testing.assert_array_equal(read_tie_points(tmp_path / "points.csv").measures[0], [282.75, 782])


def test_the_real_table_of_the_moc_pair(shared_data: Path, tmp_path: Path) -> None:
    """Its columns must be renamed, which is said in one line; its control points have no places. 66 points then."""
    path = shared_data / "mgs_moc_pair" / "tie_points.csv"
    with pytest.raises(InputError) as caught:
        read_table(path)
    assert "unknown column 'product'" in str(caught.value)
    assert "rename it to 'image'; and name line and sample isis_line and isis_sample if" in str(caught.value)

    first, rest = path.read_text().split("\n", 1)
    renamed = first.replace("product", "image").replace("line", "isis_line").replace("sample", "isis_sample")
    with pytest.raises(InputError, match=r"point gcp001: constrained without an a-priori place; .*make the point free"):
        read_tie_points(_put(tmp_path / "points.csv", f"{renamed}\n{rest}"))
    rest = rest.replace("Constrained", "Free").replace("Fixed", "Free")
    ties = read_tie_points(_put(tmp_path / "points.csv", f"{renamed}\n{rest}"))

    assert len(ties.ids) == 66
    np.testing.assert_allclose(ties.measures[0], [283.0962798003462 - 0.5, 782.1881545442291 - 0.5], rtol=1e-15)


def test_the_table_of_the_documentation(tmp_path: Path) -> None:
    page = Path(__file__).resolve().parents[3] / "docs" / "exchange.md"
    (table,) = re.findall(r"```text\n(.+?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    ties = read_tie_points(_put(tmp_path / "points.csv", table))
    assert ties.ids == ("rim", "hill")
    assert np.linalg.norm(ties.places[1]) == pytest.approx(3391200)


def _put(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


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


HEADERS = {
    "unknown": ("id,image,line,sample,sigma_lin_px", "unknown column 'sigma_lin_px'; .*'sigma_line_px'"),
    "latitude without a unit": ("id,image,line,sample,lat,lon", "unknown column 'lat'; .*'latitude_deg'"),
    "far from all": ("id,image,line,sample,qqq", "unknown column 'qqq'; .*; the columns there are: id, image,"),
    "twice": ("id,id,image,line,sample", "the column 'id' twice"),
    "no image": ("id,line,sample", "no column 'image'"),
    "no place": ("id,image", "no columns of places; .*first pixel is \\(1, 1\\)"),
    "half a place": ("id,image,line", "columns line; expected line and sample"),
    "both counts": ("id,image,line,sample,isis_line,isis_sample", "columns line, sample, isis_line, isis_sample; e"),
    "mixed counts": ("id,image,line,isis_sample", "columns line, isis_sample; expected"),
    "a place in part": ("id,image,line,sample,x_m,y_m", "columns x_m, y_m; expected x_m and y_m and z_m"),
    "which latitude": ("id,image,line,sample,longitude_deg,latitude_deg,height_m", "columns longitude_deg, latitude_d"),
    "sigmas of no place": ("id,image,line,sample,sigma_x_m,sigma_y_m,sigma_z_m", "sigma_x_m without an a-priori place"),
    "semicolons": ("id;image;line;sample", "fields with semicolons between them; .*points in the numbers"),
    "tabs": ("id\timage\tline\tsample", "fields with tabs"),
    "no name": ("id,image,line,sample,", "a column without a name"),
}


@pytest.mark.parametrize("fault", HEADERS)
def test_a_wrong_header_is_said(tmp_path: Path, fault: str) -> None:
    header, said = HEADERS[fault]
    with pytest.raises(InputError, match=f"points.csv, line 1: .*{said}"):
        read(tmp_path, f"{header}\n")


ROWS = {
    "decimal comma": ('a,two,"1,5",1,,', "line 4, point a, line: '1,5'; expected a finite number; write a decimal p"),
    "unquoted decimal comma": ("a,two,1,5,1,5,,,", "line 4: 9 fields; expected 6, as in the header; write decimal"),
    "too few": ("a,two,1", "line 4: 3 fields; expected 6"),
    "no id": (",two,1,1,,", "line 4: no id"),
    "no image": ("a,,1,1,,", "line 4, point a, line: a measure without image"),
    "no line": ("a,two,,1,,", "line 4, point a, line: nothing; expected a finite number"),
    "a word": ("a,two,1,x,,", "line 4, point a, sample: 'x'; expected a finite number"),
    "infinite": ("a,two,inf,1,,", "line 4, point a, line: 'inf'"),
    "sigma of zero": ("a,two,1,1,0,", "line 4, point a, sigma_line_px: 0; expected a positive number"),
    "a measure twice": ("a,one,1,1,,", "line 4, point a, image one: a second measure in this image"),
    "no such type": ("b,one,1,1,,known", "line 4, point b, type: 'known'; expected free, constrained or fixed"),
    "fixed without place": ("b,one,1,1,,fixed", "line 4, point b: fixed without an a-priori place"),
    "a quote left open": ('"a,two,1,1,,', "line 4: no row of a CSV file"),
}


@pytest.mark.parametrize("fault", ROWS)
def test_a_wrong_row_is_said(tmp_path: Path, fault: str) -> None:
    row, said = ROWS[fault]
    with pytest.raises(InputError) as caught:
        read(tmp_path, f"# a comment\nid,image,line,sample,sigma_line_px,type\na,one,1,1,,\n{row}\n")
    assert str(caught.value).startswith(f"{tmp_path / 'points.csv'}, {said}")


@pytest.mark.parametrize(
    ("columns", "row", "said"),
    [
        ("x_m,y_m,z_m", "1,2,3", "constrained without sigmas"),
        ("x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m", "1,2,3,1,0,1", "sigma_y_m: 0; expected a positive number"),
        ("longitude_deg,latitude_deg,radius_m", "1,91,3", "latitude_deg: 91; expected -90 .. 90"),
        ("longitude_deg,latitude_deg,radius_m", "-361,9,3", "longitude_deg: -361; expected -360 .. 360"),
        ("longitude_deg,latitude_deg,radius_m", "1,1,-3", "radius_m: -3; expected a positive"),
        ("longitude_deg,geodetic_latitude_deg,height_m", "1,1,1", "height above an unknown ellipsoid; .*--radii"),
        ("ignore", "maybe", "ignore: 'maybe'; expected true or false"),
        ("measure_type", "guessed", "measure_type: 'guessed'; expected Candidate, Manual"),
    ],
)
def test_a_wrong_control_point_is_said(tmp_path: Path, columns: str, row: str, said: str) -> None:
    with pytest.raises(InputError, match=f"line 2, point a.*{said}"):
        read(tmp_path, f"id,image,line,sample,type,{columns}\na,one,1,1,constrained,{row}\n")


@pytest.mark.parametrize("text", ["", "\n#\n", "id,image,line,sample\n", "id,image,line,sample\n,,,\n"])
def test_a_table_without_points_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"points.csv: (an empty table|no point)"):
        read(tmp_path, text)


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


@pytest.mark.parametrize("name", ["", " a", "a\nb"])
def test_names_that_no_table_can_hold_are_refused(name: str) -> None:
    measure = ControlMeasure(name, MeasureType.MANUAL, 1, 1)
    with pytest.raises(InputError, match="one line without blanks around it"):
        table_text(ControlNetwork("", "", (ControlPoint("a", PointType.FREE, (measure,)),)))


def test_every_prefix_and_mutations(tmp_path: Path) -> None:
    """A network or InputError, nothing else."""
    rng = np.random.default_rng(4)
    for k in range(len(HAND) + 400):
        text = HAND[:k]
        if k > len(HAND):
            at = int(rng.integers(len(HAND)))
            text = HAND[:at] + chr(int(rng.integers(0, 300))) + HAND[at + int(rng.integers(3)) :]
        try:
            assert read(tmp_path, text).points
        except InputError:
            continue


@pytest.mark.parametrize("kind", [PointType.FREE, PointType.CONSTRAINED, PointType.FIXED])
def test_what_no_adjustment_uses_may_be_zero_or_missing(tmp_path: Path, kind: PointType) -> None:
    """ISIS writes covariances of zeros, and points that are ignored need not have any."""
    zeros = (0.0,) * 6
    measure = ControlMeasure("A", MeasureType.MANUAL, 1.0, 2.0)
    of_zeros = ControlPoint(
        "a", kind, (measure,), ignore=kind == PointType.CONSTRAINED, apriori=(1.0, 2.0, 3.0), apriori_covariance=zeros
    )
    bare = ControlPoint("b", kind, (measure,), ignore=True)
    given = ControlNetwork("", "", (of_zeros, bare))
    assert read(tmp_path, table_text(given)).points == given.points


def test_semicolons_below_a_header_with_commas_are_called_so(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"line 2: 1 fields; expected 4.*; write commas between the fields, not semi"):
        read(tmp_path, "id,image,isis_line,isis_sample\na;A;1;2\n")


@pytest.mark.parametrize("name", ["a.gcp", "run-A__B.match", "a.NVM"])
def test_files_of_other_programs_must_be_converted_first(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=rf"a {Path(name).suffix.lower()} file; .*mgsgraph convert {name} network.net"):
        read_tie_points(tmp_path / name)


def test_nothing_is_called_the_nearest_that_is_not_near(tmp_path: Path) -> None:
    """A column of notes must not be renamed to ignore."""
    with pytest.raises(InputError, match=r"unknown column 'note'.*the columns there are: id, image"):
        read(tmp_path, "id,image,isis_line,isis_sample,note\na,A,1,1,blurred\n")


@pytest.mark.parametrize(
    ("columns", "row"), [("longitude_deg,latitude_deg,radius_m", "10,20,3390.5"), ("x_m,y_m,z_m", "3300,600,500")]
)
def test_kilometres_are_noticed_where_the_body_is_known(tmp_path: Path, columns: str, row: str) -> None:
    text = f"id,image,line,sample,{columns}\na,A,1,1,{row}\n"
    assert read(tmp_path, text).points[0].apriori is not None
    with pytest.raises(InputError, match=r"line 2, point a, .*m from the body's centre; expected about 3.39619e\+06 m"):
        read(tmp_path, text, MARS)


def test_sigmas_of_zero_are_none_as_in_match_files(tmp_path: Path) -> None:
    """What is written is read again."""
    measure = ControlMeasure("A", MeasureType.MANUAL, 1.0, 2.0, line_sigma=0.0, sample_sigma=0.5)
    written = table_text(ControlNetwork("", "", (ControlPoint("a", PointType.FREE, (measure,)),)))
    (back,) = read(tmp_path, written).points[0].measures
    assert (back.line_sigma, back.sample_sigma) == (None, 0.5)
