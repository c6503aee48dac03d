"""Ground control written for the pipeline and read back; its reader's own tests are in test_gcp."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mgsgraph.errors import InputError
from mgsgraph.files.networks.asp_text import ground_control_text, read_ground_control, read_ground_control_network
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, MeasureType, PointType
from mgsgraph.geometry.body import Ellipsoid, from_geodetic
from mgsgraph.units import DEG

MARS = Ellipsoid(3396190.0, 3376200.0)
PLACE = from_geodetic(np.array([160.1 * DEG, 23.7 * DEG, 427.1]), MARS)


def point(name: str = "5", kind: PointType = PointType.CONSTRAINED, sigma: float = 2.0, **more: object) -> ControlPoint:
    x, y, z = PLACE.tolist()
    covariance = (sigma**2, 0.0, 0.0, 9.0, 0.0, 16.0) if kind == PointType.CONSTRAINED else ()
    measure = ControlMeasure("a.tif", MeasureType.CANDIDATE, 125.5, 20.75, sample_sigma=0.5, line_sigma=0.25)
    return ControlPoint(name, kind, (measure,), apriori=(x, y, z), apriori_covariance=covariance, **more)  # type: ignore[arg-type]


def net(*points: ControlPoint) -> ControlNetwork:
    return ControlNetwork("", "", points, source="net")


def test_fields_are_those_of_the_documentation() -> None:
    """id latitude longitude height, sigmas, image column row and their sigmas; one pixel less than ISIS."""
    lines = ground_control_text(net(point(), point("6", PointType.FIXED)), MARS).splitlines()

    fields = lines[1].split()
    np.testing.assert_allclose([float(text) for text in fields[1:4]], [23.7, 160.1, 427.1], rtol=1e-11)
    assert fields[0] == "5"
    assert fields[4:] == ["2.0", "3.0", "4.0", "a.tif", "124.5", "19.75", "0.5", "0.25"]
    assert lines[2].split()[4:7] == ["1e-10"] * 3
    assert lines[0].startswith("#")


@given(
    longitude=st.floats(-180, 180), latitude=st.floats(-90, 90), height=st.floats(-8e3, 22e3),
    sigma=st.floats(1e-3, 1e3), line=st.floats(0.5, 1e5), sample=st.floats(0.5, 1e4), fixed=st.booleans(),
)  # fmt: skip
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
def test_points_survive(
    tmp_path: Path, longitude: float, latitude: float, height: float, sigma: float, line: float, sample: float,
    fixed: bool,
) -> None:  # fmt: skip
    """PixelMeasures bit for bit, sigmas to rounding, places to a hundredth of a micrometre."""
    x, y, z = from_geodetic(np.array([longitude * DEG, latitude * DEG, height]), MARS).tolist()
    given = ControlPoint(
        "1",
        PointType.FIXED if fixed else PointType.CONSTRAINED,
        (ControlMeasure("a.tif", MeasureType.CANDIDATE, sample, line, sample_sigma=sigma, line_sigma=2 * sigma),),
        apriori=(x, y, z),
        apriori_covariance=() if fixed else (sigma**2, 0.0, 0.0, 1.0, 0.0, 4.0),
    )
    path = tmp_path / "x.gcp"
    path.write_text(ground_control_text(net(given), MARS))

    (got,) = read_ground_control_network(path, MARS).points

    assert got.measures == given.measures
    assert (got.id, got.type) == (given.id, given.type)
    np.testing.assert_allclose(got.apriori_covariance, given.apriori_covariance, rtol=4e-16)
    np.testing.assert_allclose(got.apriori, given.apriori, rtol=0, atol=1e-8)


def test_ids_that_the_pipeline_does_not_read_are_numbered_with_the_name_in_a_comment(tmp_path: Path) -> None:
    text = ground_control_text(net(point("hill"), point("7")), MARS)

    assert "# 1: hill\n1 " in text
    assert "# 2: 7\n2 " in text
    (tmp_path / "x.gcp").write_text(text)
    assert read_ground_control(tmp_path / "x.gcp", MARS).ids == ("1", "2")


def test_what_it_cannot_hold_is_left_out_or_refused() -> None:
    free = ControlPoint("9", PointType.FREE)
    assert len(ground_control_text(net(point(), free, point("8", ignore=True)), MARS).splitlines()) == 2
    with pytest.raises(InputError, match="net: no constrained or fixed point"):
        ground_control_text(net(free), MARS)
    with pytest.raises(InputError, match="point 5: fixed without an a-priori place"):
        ground_control_text(net(ControlPoint("5", PointType.FIXED)), MARS)
    with pytest.raises(InputError, match="point 5: constrained without positive variances"):
        ground_control_text(net(point(sigma=0.0)), MARS)
    for name in ("a b", "a,b", "#a"):
        measure = ControlMeasure(name, MeasureType.CANDIDATE, 1, 1)
        bad = ControlPoint("5", PointType.FIXED, (measure,), apriori=(1.0, 2.0, 3.0))
        with pytest.raises(InputError, match="a name with blanks, commas or a #"):
            ground_control_text(net(bad), MARS)
