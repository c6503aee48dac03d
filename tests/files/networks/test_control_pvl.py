"""Control networks as PVL text: laid out as ISIS does it, nothing lost on the way through either form."""

from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from isis_networks import contents, networks

from mgsgraph.errors import InputError
from mgsgraph.files.networks.binary import binary_network, parse_binary_network, read_network, write_binary_network
from mgsgraph.files.networks.pvl import network_text, parse_pvl_network, write_pvl_network
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, MeasureType, PointType
from mgsgraph.files.pvl import Document

OF_ISIS = """\
Object = ControlNetwork
  NetworkId    = Test
  TargetName   = Mars
  UserName     = TSucharski
  Created      = 2010-07-10T12:50:15
  LastModified = Null
  Description  = "UnitTest of ControlNetwork"
  TargetRadii  = (3396190.0, 3396190.0, 3376200.0)
  Version      = 5

  Object = ControlPoint
    PointType                = Constrained
    PointId                  = T0000
    ChooserName              = autoseed
    DateTime                 = 2010-08-27T17:10:06
    EditLock                 = True
    AprioriXYZSource         = Basemap
    AprioriXYZSourceFile     = /work1/tsucharski/basemap.cub
    AprioriRadiusSource      = DEM
    AprioriRadiusSourceFile  = $base/dems/molaMarsPlanetaryRadius0003.cub
    AprioriX                 = -424.024048 <meters>
    AprioriY                 = 734.4311949 <meters>
    AprioriZ                 = 529.919264 <meters>
    AprioriCovarianceMatrix  = (100.0, 0.0, 0.0, 2500.0, 0.0, 400.0)
    LatitudeConstrained      = True
    LongitudeConstrained     = True
    RadiusConstrained        = True
    AdjustedX                = -424.024048 <meters>
    AdjustedY                = 734.4311949 <meters>
    AdjustedZ                = 529.919264 <meters>
    AdjustedCovarianceMatrix = (8096.6118516192, 3791.9236705506,
                                -1072.6708105639, 2516.0772474838,
                                2117.9301543094, 9418.2547424025)

    Group = ControlMeasure
      SerialNumber = id0
      MeasureType  = Candidate
      ChooserName  = cnetref
      DateTime     = 2010-08-27T17:10:06
      EditLock     = True
    End_Group

    Group = ControlMeasure
      SerialNumber   = id1
      MeasureType    = Candidate
      ChooserName    = autoseed
      DateTime       = 2010-08-27T17:10:06
      Ignore         = True
      Sample         = 1.0
      Line           = 2.0
      Diameter       = 15.0
      AprioriSample  = 2.0
      AprioriLine    = 5.0
      SampleSigma    = 0.01 <pixels>
      LineSigma      = 0.21 <pixels>
      SampleResidual = -3.0 <pixels>
      LineResidual   = 4.0 <pixels>
    End_Group

    Group = ControlMeasure
      SerialNumber       = Odyssey/THEMIS_IR/823772384.051
      MeasureType        = RegisteredSubPixel
      Sample             = 125.64867138851
      JigsawRejected     = Yes
      MinimumPixelZScore = -6.9339878963865
      MaximumPixelZScore = 7.8509687345151
      GoodnessOfFit      = 0.83301329654337
      Reference          = True
    End_Group
  End_Object
End_Object
End
"""
"""Blocks as ISIS writes them (ControlNetVersioner.truth), put together, without its comments."""


def parsed(text: str) -> ControlNetwork:
    return parse_pvl_network(Document("a.pvl", text))


def one(point: ControlPoint) -> ControlNetwork:
    return ControlNetwork(network_id="n", target_name="Mars", points=(point,))


@settings(deadline=None)
@given(drawn=networks())
def test_a_network_survives(drawn: ControlNetwork) -> None:
    assert contents(parsed(network_text(drawn))) == contents(drawn)


def test_the_text_is_that_of_isis() -> None:
    assert network_text(parsed(OF_ISIS)) == OF_ISIS


def test_the_text_survives_the_binary_form() -> None:
    assert network_text(parse_binary_network(binary_network(parsed(OF_ISIS)), "")) == OF_ISIS


def test_all_is_read() -> None:
    (point,) = parsed(OF_ISIS).points

    assert (point.reference, point.radius_constrained, point.apriori_radius_source_file) == (
        2, True, "$base/dems/molaMarsPlanetaryRadius0003.cub",
    )  # fmt: skip
    assert point.adjusted_covariance[2] == -1072.6708105639
    assert point.measures[1].line_residual == 4.0
    assert point.measures[2].log == ((3, -6.9339878963865), (4, 7.8509687345151), (2, 0.83301329654337))
    assert point.measures[2].jigsaw_rejected


def test_a_real_network_keeps_every_field(shared_data: Path, tmp_path: Path) -> None:
    source = shared_data / "lro_nac_lola" / "network.pvl"
    first = read_network(source)
    write_binary_network(first, tmp_path / "a.net")
    second = read_network(tmp_path / "a.net")
    write_pvl_network(second, tmp_path / "a.pvl")

    assert contents(first) == contents(second) == contents(read_network(tmp_path / "a.pvl"))
    assert len(first.points) == 311
    assert sum(len(measure.log) for point in first.points for measure in point.measures) == 3 * 311
    written, given_text = (path.read_text().split("\n\n") for path in (tmp_path / "a.pvl", source))
    assert len(written) == 1 + 311 + 622
    for mine, theirs in zip(written, given_text, strict=True):
        assert mine == theirs


def test_old_names_of_figures() -> None:
    text = OF_ISIS.replace("GoodnessOfFit ", "Eccentricity ").replace("MinimumPixelZScore", "AverageResidual")

    assert [kind for kind, _ in parsed(text).points[0].measures[2].log] == [8, 4, 1]


def test_the_form_goes_by_the_content(tmp_path: Path) -> None:
    network = parsed(OF_ISIS)
    write_pvl_network(network, tmp_path / "text.net")
    write_binary_network(network, tmp_path / "binary.pvl")

    assert contents(read_network(tmp_path / "text.net")) == contents(read_network(tmp_path / "binary.pvl"))
    assert contents(read_network(tmp_path / "text.net")) == contents(network)


FAULTS = {
    "keyword": ("GoodnessOfFit ", "GoodnessOfFat ", 67, "the keyword goodnessoffat; expected ISIS's keywords"),
    "source": ("= Basemap", "= Atlas", 17, "point T0000, AprioriXYZSource: 'Atlas'; expected one of none, user"),
    "measure type": ("= RegisteredSubPixel", "= Guessed", 62, "MeasureType: 'Guessed'"),
    "figure": ("7.8509687345151", "high", 66, "maximumpixelzscore: 'high'; expected a finite number"),
    "unit of a figure": ("7.8509687345151", "7 <m>", 66, "the unit <m>"),
    "radii": ("(3396190.0, ", "(", 8, "TargetRadii: 2 items; expected a list of 3 numbers"),
    "adjusted place": ("    AdjustedY                = 734.4311949 <meters>\n", "", 11, "point T0000: no AdjustedY"),
    "binary": ("= ControlNetwork", "= ProtoBuffer", 1, "object protobuffer"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_found_where_it_is(fault: str) -> None:
    old, new, line, said = FAULTS[fault]
    with pytest.raises(InputError) as caught:
        parsed(OF_ISIS.replace(old, new, 1))

    assert str(caught.value).startswith(f"a.pvl, line {line}"), str(caught.value)
    assert said in str(caught.value)


MEASURE = ControlMeasure(serial_number="A", type=MeasureType.MANUAL)
POINT = ControlPoint(id="p", type=PointType.FREE, measures=(MEASURE,))
CANNOT = {
    "line break": (msgspec.structs.replace(POINT, chooser_name="a\nb"), "point 1 (p): ChooserName: a line break in"),
    "surrogate": (msgspec.structs.replace(POINT, chooser_name="\ud800"), "ChooserName: half a character in"),
    "quotes": (msgspec.structs.replace(POINT, id="\"'"), "PointId: both kinds of quotes"),
    "null": (msgspec.structs.replace(POINT, id="NULL"), "PointId: 'NULL'; expected a name that PVL can hold"),
    "no image": (
        msgspec.structs.replace(POINT, measures=(msgspec.structs.replace(MEASURE, serial_number=""),)),
        "point 1 (p): measure 1: SerialNumber: ''",
    ),
    "figure": (
        msgspec.structs.replace(POINT, measures=(msgspec.structs.replace(MEASURE, log=((9, 0.0),)),)),
        "figures of merit: number 9; expected 1 .. 8",
    ),
    "figure twice": (
        msgspec.structs.replace(POINT, measures=(msgspec.structs.replace(MEASURE, log=((2, 0.0), (2, 1.0))),)),
        "number 2 twice",
    ),
    "NaN": (msgspec.structs.replace(POINT, apriori=(0.0, float("nan"), 0.0)), "AprioriY: nan"),
    "covariance": (msgspec.structs.replace(POINT, apriori_covariance=(1.0,)), "AprioriCovarianceMatrix: 1 numbers"),
}


@pytest.mark.parametrize("fault", CANNOT)
def test_what_pvl_cannot_hold_is_refused(tmp_path: Path, fault: str) -> None:
    point, said = CANNOT[fault]
    with pytest.raises(InputError) as caught:
        write_pvl_network(one(point), tmp_path / "a.pvl")

    assert str(caught.value).startswith("point 1 (p): ") or "quotes" in said or "null" in fault
    assert said in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_null_is_how_isis_spells_none() -> None:
    assert "ChooserName" not in network_text(one(msgspec.structs.replace(POINT, chooser_name="Null")))


def test_a_network_without_points_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no control point"):
        write_pvl_network(ControlNetwork(network_id="n", target_name="Mars", points=()), tmp_path / "a.pvl")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("\n", "\r\n"), ("\n", " \t\n"), ("Object = ControlPoint\n", "# AprioriLatitude = 1\nObject = ControlPoint\n"),
        ("    Group", "  /* a comment\n of two lines */  Group"), ("<pixels>", "<Pixel>"), ("<meters>", ""),
        ("= True", "= yes"), ("= Candidate", "= 'candidate'"), ("(100.0, ", "(100.0\n, "),
    ],
)  # fmt: skip
def test_other_ways_to_write_it(tmp_path: Path, old: str, new: str) -> None:
    assert old in OF_ISIS
    (tmp_path / "x.pvl").write_bytes(OF_ISIS.replace(old, new).encode())
    assert contents(read_network(tmp_path / "x.pvl")) == contents(parsed(OF_ISIS))
