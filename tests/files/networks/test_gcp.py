"""Ground control points of the Ames Stereo Pipeline: meaning by its documentation, faults with line and point."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mgsgraph.errors import InputError
from mgsgraph.files.networks.asp_text import read_ground_control
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.geometry.body import Ellipsoid

MARS = Ellipsoid(3396190.0, 3376200.0)
EARTH = Ellipsoid(6378137.0, 6356752.314245179)
DOCUMENTED = "5 23.7 160.1 427.1 1.0 1.0 1.0 image1.tif 124.5 19.7 1.0 1.0 image2.tif 254.3 73.9 1.0 1.0"
"""The example of StereoPipeline's documentation."""


def read(folder: Path, text: str, ellipsoid: Ellipsoid = MARS) -> TiePoints:
    path = folder / "points.gcp"
    path.write_text(text)
    return read_ground_control(path, ellipsoid)


def test_the_documented_line(tmp_path: Path) -> None:
    got = read(tmp_path, DOCUMENTED)

    assert got.ids == ("5",)
    assert got.kinds.tolist() == [PointKind.CONSTRAINED]
    np.testing.assert_array_equal(got.covariances[0], np.eye(3))
    assert got.measure_image == ("image1.tif", "image2.tif")
    np.testing.assert_allclose(got.measures, [[20.2, 125.0], [74.4, 254.8]], rtol=1e-15)  # row before column, plus 0.5
    np.testing.assert_array_equal(got.measure_sigmas, 1.0)
    np.testing.assert_allclose(np.degrees(np.arctan2(got.places[0, 1], got.places[0, 0])), 160.1, rtol=1e-14)


def test_latitude_is_geodetic(tmp_path: Path) -> None:
    """WGS 84, 45 N 0 E, height 0: X 4517590.879 m, Z 4487348.409 m, as any table of the ellipsoid has it."""
    got = read(tmp_path, "a 45 0 0 1 1 1", EARTH)

    np.testing.assert_allclose(got.places[0], [4517590.879, 0.0, 4487348.409], rtol=0, atol=1e-3)


@given(latitude=st.floats(-90, 90), longitude=st.floats(-180, 360), height=st.floats(-8e3, 22e3))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
def test_place_lies_at_its_height_along_the_normal(
    tmp_path: Path, latitude: float, longitude: float, height: float
) -> None:
    ground, above = read(
        tmp_path, f"a {latitude!r} {longitude!r} 0 1 1 1\nb {latitude!r} {longitude!r} {height!r} 1 1 1"
    ).places

    b, m = np.radians(latitude), np.radians(longitude)
    normal = np.array([np.cos(b) * np.cos(m), np.cos(b) * np.sin(m), np.sin(b)])
    np.testing.assert_allclose(above - ground, height * normal, rtol=0, atol=1e-8)
    radii = np.array([MARS.equatorial, MARS.equatorial, MARS.polar])
    assert np.sum((ground / radii) ** 2) == pytest.approx(1.0, abs=1e-14)
    gradient = ground / radii**2
    np.testing.assert_allclose(np.cross(gradient / np.linalg.norm(gradient), normal), 0.0, atol=1e-14)


def test_sigmas_are_along_body_fixed_axes_and_line_goes_before_sample(tmp_path: Path) -> None:
    got = read(tmp_path, "a 0 90 0 1 2 3 one 10 20 0.1 0.2")

    np.testing.assert_array_equal(got.covariances[0], np.diag([1.0, 4.0, 9.0]))
    np.testing.assert_array_equal(got.measure_sigmas, [[0.2, 0.1]])


@pytest.mark.parametrize("sigma", ["1e-10", "1.0E-10", "0.0000000001"])
def test_the_tiny_sigma_means_fixed(tmp_path: Path, sigma: str) -> None:
    got = read(tmp_path, f"a 1 2 3 {sigma} {sigma} {sigma}\nb 1 2 3 1e-9 1e-9 1e-9")

    assert got.kinds.tolist() == [PointKind.FIXED, PointKind.CONSTRAINED]
    np.testing.assert_array_equal(got.covariances[0], 0.0)


def test_commas_comments_and_blank_lines(tmp_path: Path) -> None:
    plain = read(tmp_path, DOCUMENTED)
    dressed = read(tmp_path, f"# id, lat\n\n  \t\n{DOCUMENTED.replace(' ', ', ')} # why\r\n#5 nothing")

    assert dressed.ids == plain.ids
    assert dressed.measure_image == plain.measure_image
    np.testing.assert_array_equal(dressed.places, plain.places)
    np.testing.assert_array_equal(dressed.measures, plain.measures)


def test_a_hash_inside_a_name_is_no_comment(tmp_path: Path) -> None:
    assert read(tmp_path, "a#1 1 2 3 1 1 1 im#2 1 1 1 1").measure_image == ("im#2",)


FAULTS = {
    "a field short": ("x 1 2 3 1 1", "point x: 6 fields; expected 7, and 5 more for each image"),
    "a measure short": ("x 1 2 3 1 1 1 one 1 2 1", "point x: 11 fields"),
    "beyond a turn": ("x 1 361 3 1 1 1", "point x, longitude: 361 degrees; expected -360 .. 360"),
    "latitude": ("x north 2 3 1 1 1", "point x, latitude: 'north'; expected a finite number"),
    "NaN height": ("x 1 2 nan 1 1 1", "point x, height: 'nan'"),
    "infinite longitude": ("x 1 inf 3 1 1 1", "point x, longitude: 'inf'"),
    "swapped": ("x 160.1 23.7 3 1 1 1", "point x, latitude: 160.1 degrees; expected -90 .. 90; latitude comes before"),
    "zero sigma": ("x 1 2 3 1 0 1", "point x, sigma: 0; expected a positive number"),
    "negative sigma": ("x 1 2 3 1 1 -1", "point x, sigma: -1"),
    "NaN column": ("x 1 2 3 1 1 1 one NaN 2 1 1", "point x, image one, column: 'NaN'"),
    "word as row": ("x 1 2 3 1 1 1 one 1 two 1 1", "point x, image one, row: 'two'"),
    "zero pixel sigma": ("x 1 2 3 1 1 1 one 1 2 0 1", "point x, image one, column sigma: 0"),
    "negative pixel sigma": ("x 1 2 3 1 1 1 one 1 2 1 -1", "point x, image one, row sigma: -1"),
    "image twice": ("x 1 2 3 1 1 1 one 1 2 1 1 one 1 2 1 1", "point x, image one: a second measure"),
    "id twice": ("5 1 2 3 1 1 1", "point 5: the id twice, first in line 1"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_said_with_line_and_point(tmp_path: Path, fault: str) -> None:
    line, said = FAULTS[fault]

    with pytest.raises(InputError) as caught:
        read(tmp_path, f"{DOCUMENTED}\n\n{line}\n")

    assert str(caught.value).startswith(f"{tmp_path / 'points.gcp'}, line 3, {said}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "\n", "# nothing but a comment\n"])
def test_a_file_without_points_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match="no ground control point"):
        read(tmp_path, text)
