"""ISIS control networks of every version in both forms: all that a version holds comes back, as ISIS takes it."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from isis_networks import contents, first_binary, labelled, networks, older, pvl_text

from mgsgraph.errors import InputError
from mgsgraph.files.networks.binary import binary_network, parse_binary_network, read_network
from mgsgraph.files.networks.pvl import parse_pvl_network
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, MeasureType, PointType
from mgsgraph.files.networks.tie_points import PointKind, tie_points
from mgsgraph.files.pvl import Document
from mgsgraph.geometry.body import from_planetocentric, planetocentric_jacobian
from mgsgraph.units import DEG


def parsed(text: str) -> ControlNetwork:
    return parse_pvl_network(Document("a.pvl", text))


def as_version_one_has_it(network: ControlNetwork) -> ControlNetwork:
    """Besides `older`: the adjusted place stands in for the a-priori one, what was not measured is ignored, and
    coordinates are constrained where there is a covariance.
    """
    replace = msgspec.structs.replace
    points = list[ControlPoint]()
    for point in older(network, 1).points:
        measures = tuple(
            replace(one, ignore=one.ignore or one.line is None or one.sample is None) for one in point.measures
        )
        whole = bool(point.apriori_covariance or point.adjusted_covariance)
        points.append(replace(
            point, measures=measures, apriori=point.apriori or point.adjusted, latitude_constrained=whole,
            longitude_constrained=whole, radius_constrained=whole,
        ))  # fmt: skip
    return replace(network, points=tuple(points), target_radii=())


@settings(deadline=None, max_examples=40)
@given(drawn=networks())
def test_versions_one_to_five_in_text(drawn: ControlNetwork) -> None:
    for version in (2, 3, 4, 5):
        assert contents(parsed(pvl_text(drawn, version))) == contents(older(drawn, version)), version
    assert contents(parsed(pvl_text(drawn, 1))) == contents(as_version_one_has_it(drawn))


@settings(deadline=None, max_examples=40)
@given(drawn=networks())
def test_version_one_in_binary(drawn: ControlNetwork) -> None:
    assert contents(parse_binary_network(first_binary(older(drawn, 1)), "a.net")) == contents(older(drawn, 1))


@settings(deadline=None, max_examples=20)
@given(drawn=networks())
def test_a_label_may_have_other_line_ends(drawn: ControlNetwork) -> None:
    for data in (binary_network(drawn), first_binary(older(drawn, 1))):
        label, rest = data[:65536].rstrip(b"\0"), data[65536:]
        for ends in (b"\r\n", b"\r"):
            other = label.replace(b"\n", ends).ljust(65536, b"\0") + rest
            assert contents(parse_binary_network(other, "")) == contents(parse_binary_network(data, ""))


REALLY_OLD = """\
Object = ControlNetwork
  NetworkId    = ""
  NetworkType  = ImageToGround
  TargetName   = MRO/CTX
  UserName     = ""
  Created      = Null

  Object = ControlPoint
    PointType             = Tie
    PointId               = 1001
    Held                  = True
    Latitude              = 30.0
    Longitude             = 120.0
    Radius                = 3390000.0
    AprioriSigmaLatitude  = 20.0
    AprioriSigmaLongitude = -1.0

    Group = ControlMeasure
      SerialNumber   = "M1"
      MeasureType    = ValidatedManual
      Sample         = 893.0
      Line           = 616.0
      ErrorLine      = 0.25
      ErrorSample    = -0.5
      ErrorMagnitude = 0.56
      ZScore         = 1.0
      DateTime       = ""
      Reference      = False
    End_Group

    Group = ControlMeasure
      SerialNumber   = "M2"
      MeasureType    = Unmeasured
      Sample         = Null
      Line           = ""
      Reference      = True
    End_Group
  End_Object

  Object = ControlPoint
    PointType = Tie
    PointId   = "2"
    Held      = True

    Group = ControlMeasure
      SerialNumber   = "M1"
      MeasureType    = AutomaticSubPixel
      Sample         = 1
      Line           = 1
      Eccentricity   = 0.5
    End_Group
  End_Object
 End_Object
End
"""
"""In the words of ISIS's own old networks (oldNetwork.net, reallyOldNetwork.net, isis3.2.1)."""


def test_the_oldest_words() -> None:
    network = parsed(REALLY_OLD)
    first, second = network.points
    place = from_planetocentric(np.array([120.0 * DEG, 30.0 * DEG, 3.39e6]))

    assert (network.target_name, network.created, network.network_id) == ("Mars", "", "")
    assert first.measures[0] == ControlMeasure(
        "M1", MeasureType.REGISTERED_PIXEL, 893.0, 616.0, sample_residual=-0.5, line_residual=0.25
    )
    assert first.measures[1] == ControlMeasure("M2", MeasureType.CANDIDATE, ignore=True)
    assert first.reference == 1
    assert first.apriori == first.adjusted == pytest.approx(tuple(place.tolist()))
    assert (first.latitude_constrained, first.longitude_constrained, first.radius_constrained) == (True, True, False)
    assert (first.type, second.type) == (PointType.CONSTRAINED, PointType.FIXED)
    assert second.measures[0].type == MeasureType.REGISTERED_SUBPIXEL
    assert second.measures[0].log == ((1, 0.5),)
    only = msgspec.structs.replace(network, points=(first,))
    assert tie_points(only).kinds.tolist() == [PointKind.CONSTRAINED]
    # by the Jacobian of the coordinates, which knows nothing of axes: 20 m, and 10 km where nothing usable is said
    backward = np.linalg.inv(planetocentric_jacobian(np.array([120.0 * DEG, 30.0 * DEG, 3.39e6])))
    lengths = np.diag([3.39e6 * np.cos(30.0 * DEG), 3.39e6, 1.0]) @ backward
    found = lengths @ tie_points(only).covariances[0] @ lengths.T
    np.testing.assert_allclose(found, np.diag([1e8, 400.0, 1e8]), atol=1e-3)


def test_a_network_of_the_first_version_goes_through_the_last(tmp_path: Path) -> None:
    (tmp_path / "old.net").write_text(REALLY_OLD.replace("\n", "\r\n"), encoding="utf-8", newline="")
    read = read_network(tmp_path / "old.net")

    assert contents(parse_binary_network(binary_network(read), "")) == contents(read)


WHOLE = first_binary(
    ControlNetwork("n", "Mars", (ControlPoint("p", PointType.FREE, (ControlMeasure("A", MeasureType.MANUAL),)),))
)
FAULTS = {
    "no LogData": (WHOLE.replace(b"= LogData", b"= Figures"), "no LogData"),
    "cut short": (WHOLE[:-1], "LogData: "),
    "figures of others": (
        WHOLE[:-4].replace(b"Bytes     = 4", b"Bytes     = 2") + b"\n\0", "LogData, point 1, measures: 0"
    ),
    "measure type": (WHOLE.replace(b"A\x10\x02", b"A\x10\x00"), "point 1 (p): measure 1: MeasureType"),
    "no message": (WHOLE.replace(b"Bytes     = 4", b"Bytes     = 3"), "LogData: 3 bytes that are no such message"),
    "nothing": (labelled(1, b"", b""), "no StartByte"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_version_one(fault: str) -> None:
    data, said = FAULTS[fault]
    with pytest.raises(InputError) as caught:
        parse_binary_network(data, "a.net")

    assert str(caught.value).startswith("a.net")
    assert said in str(caught.value)
