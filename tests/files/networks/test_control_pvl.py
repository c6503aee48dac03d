"""Control networks as PVL text of every version: what ISIS means, laid out as it does, faults with their line."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from control_networks import contents, first_binary, networks, older, pvl_text
from hypothesis import given, settings
from hypothesis import strategies as st
from outside import refuses

from mgsgraph.errors import InputError
from mgsgraph.files.networks.binary import (
    binary_network,
    parse_binary_network,
    read_control_network,
    read_network,
    write_binary_network,
)
from mgsgraph.files.networks.pvl import network_text, parse_pvl_network, write_pvl_network
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, MeasureType, PointType
from mgsgraph.files.networks.tie_points import PointKind, TiePoints, tie_points
from mgsgraph.files.pvl import Document
from mgsgraph.geometry.body import from_planetocentric, planetocentric_jacobian
from mgsgraph.units import DEG

# --- what it means to an adjustment


SMALL = """\
Object = ControlNetwork
  NetworkId    = two_points
  TargetName   = Mars
  Description  = "Two points, of which
                  one is constrained"
  Version      = 5

  Object = ControlPoint
    PointType                = Constrained
    PointId                  = first

    # AprioriLatitude = 14.1 <degrees>
    AprioriX                 = 1485514.8 <meters>
    AprioriY                 = -2937138.2 <meters>
    AprioriZ                 = 829401.9 <meters>
    AprioriCovarianceMatrix  = (100.0, 1.0,
                                2.0, 200.0,
                                3.0, 300.0)

    Group = ControlMeasure
      SerialNumber = MGS/561812335:32/MOC-NA
      MeasureType  = Manual
      Sample       = 101.5
      Line         = 2002.25
      LineSigma    = 0.5 <pixels>
      SampleSigma  = 0.25 <pixels>
    End_Group
  End_Object

  Object = ControlPoint
    PointType = Free
    PointId   = second

    Group = ControlMeasure
      SerialNumber   = MGS/561812335:32/MOC-NA
      Sample         = 1.0
      Line           = 1.0
      JigsawRejected = Yes
    End_Group
  End_Object
End_Object
End
"""

MEASURE = SMALL[SMALL.index("    Group") : SMALL.index("    End_Group") + len("    End_Group\n")]


def read(folder: Path, text: str) -> TiePoints:
    path = folder / "network.pvl"
    path.write_text(text, encoding="utf-8")
    return read_control_network(path)


def test_the_small_network(tmp_path: Path) -> None:
    got = read(tmp_path, SMALL)

    assert got.kinds.tolist() == [PointKind.CONSTRAINED, PointKind.FREE]
    np.testing.assert_array_equal(got.places, [[1485514.8, -2937138.2, 829401.9], [np.nan] * 3])
    np.testing.assert_array_equal(got.covariances[0], [[100, 1, 2], [1, 200, 3], [2, 3, 300]])
    np.testing.assert_array_equal(got.measures, [[2001.75, 101.0], [0.5, 0.5]])  # rejected by jigsaw, yet kept
    np.testing.assert_array_equal(got.measure_sigmas, [[0.5, 0.25], [np.nan, np.nan]])


def test_planetocentric_place_is_the_one_isis_gives(tmp_path: Path) -> None:
    """Latitude, longitude and radius that ISIS itself wrote beside X, Y, Z (ControlNetVersioner/smallPvlTest.pvl)."""
    place = "AprioriLatitude = 14.14339916959 <degrees>\nAprioriLongitude = 296.82889373072\n"
    place += "AprioriRadius = 3394325.0717817 <m>"

    got = read(tmp_path, re.sub(r"AprioriX.*\n.*\n.*AprioriZ.*", place, SMALL))

    np.testing.assert_allclose(got.places[0], [1485514.8494536, -2937138.2000946, 829401.90409959], rtol=0, atol=1e-4)


def test_units_are_heeded(tmp_path: Path) -> None:
    place = f"AprioriLatitude = {0.5 / DEG!r}\nAprioriLongitude = -0.25 <radians>\nAprioriRadius = 3394.25 <km>"

    got = read(tmp_path, re.sub(r"AprioriX.*\n.*\n.*AprioriZ.*", place, SMALL))

    radius = 3394250.0
    wanted = [radius * np.cos(0.5) * np.cos(0.25), -radius * np.cos(0.5) * np.sin(0.25), radius * np.sin(0.5)]
    np.testing.assert_allclose(got.places[0], wanted, rtol=0, atol=1e-6)


def test_adjusted_places_are_first_guesses_of_free_points_only(tmp_path: Path) -> None:
    adjusted = "AdjustedX = 1 <meters>\nAdjustedY = 2\nAdjustedZ = 3\n"

    free = read(tmp_path, SMALL.replace("PointId   = second", f"PointId = second\n{adjusted}"))

    np.testing.assert_array_equal(free.places[1], [1, 2, 3])
    with pytest.raises(InputError, match="point second: fixed without an a-priori place"):
        read(tmp_path, SMALL.replace("PointType = Free", f"PointType = Fixed\n{adjusted}"))


def test_long_words_and_texts_carried_over_lines(tmp_path: Path) -> None:
    joined = read(tmp_path, SMALL.replace("= first", "= fi-\n       rst"))
    quoted = read(tmp_path, SMALL.replace("= first", "= 'fi\n       rst'"))

    assert joined.ids[0] == "first"
    assert quoted.ids[0] == "fi rst"


def test_real_network(shared_data: Path) -> None:
    path = shared_data / "lro_nac_lola" / "network.pvl"
    text = path.read_text()
    got = read_control_network(path)

    assert len(got.ids) == 311
    assert got.ids == tuple(re.findall(r"PointId\s*= (\S+)", text))
    assert got.measure_image == tuple(re.findall(r"SerialNumber\s*= (\S+)", text))
    lines, samples = (
        np.array(re.findall(rf"^ *{key} *= (\S+)", text, re.MULTILINE), dtype=float) for key in ("Line", "Sample")
    )
    np.testing.assert_array_equal(got.measures, np.stack([lines, samples], axis=1) - 0.5)
    assert np.all(np.isnan(got.measure_sigmas))
    assert np.all(got.kinds == PointKind.FREE)


# --- all that is in it, and how ISIS writes it


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


@settings(deadline=None)
@given(drawn=networks())
def test_a_network_survives(drawn: ControlNetwork) -> None:
    assert contents(parsed(network_text(drawn))) == contents(drawn)


def test_the_text_is_that_of_isis() -> None:
    assert network_text(parsed(OF_ISIS)) == OF_ISIS


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


@settings(deadline=None)
@given(
    case=st.sampled_from([str, str.lower, str.upper]),
    equals=st.sampled_from(["=", "\t=   ", " =\n      ", " = /* why */ "]),
    before=st.sampled_from(["", "\n", "  # Sample = 7\n", "/* Line = 7\n End_Object */\n"]),
    comma=st.sampled_from([",", ",\n     ", " , /* on */ "]),
    unit=st.sampled_from([("<", "<"), (" <meters>", ""), (" <pixels>", " <Pixels>")]),
    end=st.sampled_from(["", "  ", " # so", " /* so */"]),
    yes=st.sampled_from(["True", "yes", "TRUE"]),
)
def test_other_ways_to_write_it(
    case: Callable[[str], str], equals: str, before: str, comma: str, unit: tuple[str, str], end: str, yes: str
) -> None:
    def dressed(line: re.Match[str]) -> str:
        return before + case(line[1]) + equals + line[2] + ("" if line[2].rstrip().endswith(",") else end)

    text = re.sub(r"(?m)^ *(\w+) *= *(.*)$", dressed, OF_ISIS.replace("= True", f"= {yes}").replace(*unit))
    assert contents(parsed(re.sub(r",\s+", comma, text))) == contents(parsed(OF_ISIS))


FAULTS = {
    "no PointId": ("    PointId                  = first\n", "", 8, "no PointId"),
    "odd PointType": ("= Constrained", "= Floating", 9, "point first, PointType: 'Floating'"),
    "id twice": ("= second", "= first", 32, "point first, PointId: the id twice, first at"),
    "no Line": ("      Line         = 2002.25\n", "", 20, "point first, image MGS/561812335:32/MOC-NA: no Line"),
    "NaN": ("= 2002.25", "= NaN", 24, "first, image MGS/561812335:32/MOC-NA, Line: 'NaN'; expected a finite number"),
    "negative sigma": ("= 0.5 <pixels>", "= -0.5 <pixels>", 25, "LineSigma: -0.5 px; expected a positive sigma"),
    "unit": ("<meters>\n    AprioriY", "<furlongs>\n    AprioriY", 13, "AprioriX: the unit <furlongs>"),
    "no covariance": ("AprioriCovarianceMatrix", "AdjustedCovarianceMatrix", 8, "without AprioriCovarianceMatrix"),
    "short covariance": (", 300.0", "", 16, "AprioriCovarianceMatrix: 5 items; expected a list of 6 numbers"),
    "image twice": (MEASURE, MEASURE + MEASURE, 28, "image MGS/561812335:32/MOC-NA: a second measure"),
    "wrong end": ("    End_Group\n  End_Object", "    End_Object\n  End_Object", 27, "the end of group controlmeasure"),
    "version 6": ("= 5", "= 6", 6, "version 6; expected 1 to 5"),
    "keyword": ("GoodnessOfFit ", "GoodnessOfFat ", 67, "the keyword goodnessoffat; expected ISIS's keywords"),
    "source": ("= Basemap", "= Atlas", 17, "point T0000, AprioriXYZSource: 'Atlas'; expected one of none, user"),
    "radii": ("(3396190.0, ", "(", 8, "TargetRadii: 2 items; expected a list of 3 numbers"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_found_where_it_is(tmp_path: Path, fault: str) -> None:
    old, new, line, said = FAULTS[fault]

    with pytest.raises(InputError) as caught:
        read(tmp_path, next(text for text in (SMALL, OF_ISIS) if old in text).replace(old, new, 1))

    message = str(caught.value)
    assert re.match(rf"{re.escape(str(tmp_path))}/network\.pvl, line {line}[,:] ", message), message
    assert said in message


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("= second", '= "\x1b[2Jx"', "point 2 .* an id with control characters"),
        ("(100.0, 1.0", "(100.0, -150.0", "point first: an a-priori covariance that is not positive definite"),
    ],
)
def test_a_point_that_can_not_be(tmp_path: Path, old: str, new: str, said: str) -> None:
    refuses(said, read, tmp_path, SMALL.replace(old, new))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"chooser_name": "a\nb"}, r"point 1 \(p\): ChooserName: a line break in"),
        ({"id": "\"'"}, "PointId: both kinds of quotes"),
        ({"apriori": (0.0, float("nan"), 0.0)}, "AprioriY: nan"),
    ],
)
def test_what_pvl_cannot_hold_is_refused(tmp_path: Path, change: dict[str, Any], said: str) -> None:
    point = msgspec.structs.replace(ControlPoint(id="p", type=PointType.FREE), **change)
    with pytest.raises(InputError, match=said):
        write_pvl_network(ControlNetwork(network_id="n", target_name="Mars", points=(point,)), tmp_path / "a.pvl")
    assert not list(tmp_path.iterdir())


# --- older versions


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
