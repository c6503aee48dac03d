"""ISIS control networks: what is written comes back, and what is wrong is said with file, line and point."""

import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mgsgraph.errors import InputError
from mgsgraph.files.networks.binary import read_control_network
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.units import DEG

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


def read(folder: Path, text: str) -> TiePoints:
    path = folder / "network.pvl"
    path.write_text(text, encoding="utf-8")
    return read_control_network(path)


def assert_refused(folder: Path, text: str) -> str:
    with pytest.raises(InputError) as caught:
        read(folder, text)
    message = str(caught.value)
    assert message.startswith(str(folder / "network.pvl"))
    assert "\n" not in message
    return message


# ---- what is written comes back -----------------------------------------------------------------------------------

names = st.text("abcXYZ019_.:/", min_size=1, max_size=12)
quoted_names = st.text("abc 019_#=(){},<>'-+é", min_size=1, max_size=12).map(str.strip).filter(
    lambda name: bool(name)
)
numbers = st.floats(-1e7, 1e7)
sigmas = st.none() | st.floats(1e-3, 1e3)


@st.composite
def covariances(draw: st.DrawFn) -> np.ndarray:
    factor = np.array(draw(st.lists(st.floats(-10.0, 10.0), min_size=9, max_size=9))).reshape(3, 3)
    return factor @ factor.T + np.eye(3)


@st.composite
def points(draw: st.DrawFn) -> list[dict[str, Any]]:
    ids = draw(st.lists(names | quoted_names, min_size=1, max_size=4, unique=True))
    images = draw(st.lists(names, min_size=1, max_size=3, unique=True))
    records = []
    for name in ids:
        kind = draw(st.sampled_from(PointKind))
        place = None if kind == PointKind.FREE and draw(st.booleans()) else [draw(numbers) for _ in "XYZ"]
        seen = draw(st.lists(st.sampled_from(images), unique=True))
        measures = [(image, draw(numbers), draw(numbers), draw(sigmas), draw(sigmas)) for image in seen]
        record = {"id": name, "kind": kind, "place": place, "covariance": draw(covariances()), "measures": measures}
        records.append(record)
    return records


@st.composite
def spellings(draw: st.DrawFn) -> dict[str, Any]:
    return {
        "case": draw(st.sampled_from([str, str.lower, str.upper])),
        "equals": draw(st.sampled_from(["=", " = ", "\t=   ", " =\n      ", " = /* why */ "])),
        "between": draw(st.sampled_from(["", "\n", "  # Sample = 7\n", "/* Line = 7\n End_Object */\n", "\r\n"])),
        "comma": draw(st.sampled_from([",", ", ", ",\n     ", " , /* on */ "])),
        "metre": draw(st.sampled_from(["", " <meters>", "<m>", " <Meters>"])),
        "line_end": draw(st.sampled_from(["\n", "  \n", " # so\n", " /* so */\n"])),
    }


def written(records: list[dict[str, Any]], spelling: dict[str, Any]) -> str:
    def line(key: str, value: str) -> str:
        return spelling["between"] + spelling["case"](key) + spelling["equals"] + value + spelling["line_end"]

    def quoted(text: str) -> str:
        return text if re.fullmatch(r"[\w.:/]+", text) else f'"{text}"'

    text = line("Object", "ControlNetwork") + line("Version", "5")
    for record in records:
        text += line("Object", "ControlPoint") + line("PointType", record["kind"].name.capitalize())
        text += line("PointId", quoted(record["id"]))
        if record["place"] is not None:
            for axis, value in zip("XYZ", record["place"], strict=True):
                text += line(f"Apriori{axis}", f"{value!r}{spelling['metre']}")
        if record["kind"] == PointKind.CONSTRAINED:
            upper = [repr(float(value)) for value in record["covariance"][np.triu_indices(3)]]
            text += line("AprioriCovarianceMatrix", f"({spelling['comma'].join(upper)})")
        for image, row, column, row_sigma, column_sigma in record["measures"]:
            text += line("Group", "ControlMeasure") + line("SerialNumber", image)
            text += line("Line", repr(row)) + line("Sample", repr(column))
            text += line("LineSigma", f"{row_sigma!r} <pixels>") if row_sigma else ""
            text += line("SampleSigma", f"{column_sigma!r}") if column_sigma else ""
            text += spelling["case"]("End_Group") + "\n"
        text += spelling["case"]("End_Object") + "\n"
    return text + "End_Object\nEnd\nwhatever = ( follows"


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(records=points(), spelling=spellings())
def test_what_is_written_comes_back(tmp_path: Path, records: list[dict[str, Any]], spelling: dict[str, Any]) -> None:
    got = read(tmp_path, written(records, spelling))

    assert got.ids == tuple(record["id"] for record in records)
    assert got.kinds.tolist() == [record["kind"] for record in records]
    rows = [(i, *measure) for i, record in enumerate(records) for measure in record["measures"]]
    assert got.measure_point.tolist() == [row[0] for row in rows]
    assert got.measure_image == tuple(row[1] for row in rows)
    np.testing.assert_array_equal(got.measures, np.array([row[2:4] for row in rows]).reshape(-1, 2) - 0.5)
    wanted_sigmas = np.array([[sigma or np.nan for sigma in row[4:6]] for row in rows]).reshape(-1, 2)
    np.testing.assert_array_equal(got.measure_sigmas, wanted_sigmas)
    for place, covariance, record in zip(got.places, got.covariances, records, strict=True):
        np.testing.assert_array_equal(place, record["place"] or np.full(3, np.nan))
        constrained = record["kind"] == PointKind.CONSTRAINED
        upper = np.triu(record["covariance"]) * constrained
        np.testing.assert_array_equal(covariance, upper + np.triu(upper, 1).T)


@pytest.mark.parametrize("cut", np.linspace(1, len(SMALL) - 1, 25).astype(int).tolist())
def test_a_network_cut_short_is_refused(tmp_path: Path, cut: int) -> None:
    whole = SMALL.rindex("End_Object") + len("End_Object")

    if cut < whole:
        assert_refused(tmp_path, SMALL[:cut])
    else:
        assert read(tmp_path, SMALL[:cut]).ids == ("first", "second")


# ---- what ISIS means ----------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("longitude", ["1000 <degrees>", "6.9 <rad>"])
def test_a_longitude_beyond_a_turn_is_refused(tmp_path: Path, longitude: str) -> None:
    place = f"AprioriLatitude = 14.1 <degrees>\nAprioriLongitude = {longitude}\nAprioriRadius = 3390000"
    text = re.sub(r"AprioriX.*\n.*\n.*AprioriZ.*", place, SMALL)
    assert "a positive radius" in assert_refused(tmp_path, text)


def test_units_are_heeded(tmp_path: Path) -> None:
    place = f"AprioriLatitude = {0.5 / DEG!r}\nAprioriLongitude = -0.25 <radians>\nAprioriRadius = 3394.25 <km>"

    got = read(tmp_path, re.sub(r"AprioriX.*\n.*\n.*AprioriZ.*", place, SMALL))

    radius = 3394250.0
    wanted = [radius * np.cos(0.5) * np.cos(0.25), -radius * np.cos(0.5) * np.sin(0.25), radius * np.sin(0.5)]
    np.testing.assert_allclose(got.places[0], wanted, rtol=0, atol=1e-6)


def test_adjusted_places_are_first_guesses_of_free_points_only(tmp_path: Path) -> None:
    adjusted = "AdjustedX = 1 <meters>\nAdjustedY = 2\nAdjustedZ = 3\n"

    free = read(tmp_path, SMALL.replace("PointId   = second", f"PointId = second\n{adjusted}"))
    fixed = SMALL.replace("PointType = Free", f"PointType = Fixed\n{adjusted}")

    np.testing.assert_array_equal(free.places[1], [1, 2, 3])
    assert "point second: fixed without an a-priori place" in assert_refused(tmp_path, fixed)


def test_ignored_points_and_measures_are_left_out(tmp_path: Path) -> None:
    no_second = read(tmp_path, SMALL.replace("PointId   = second", "PointId = second\n Ignore = True"))
    no_measure = read(tmp_path, SMALL.replace("JigsawRejected = Yes", "IGNORE = yes"))

    assert no_second.ids == ("first",)
    assert len(no_second.measure_image) == 1
    assert no_measure.ids == ("first", "second")
    assert no_measure.measure_point.tolist() == [0]


def test_long_words_and_texts_carried_over_lines(tmp_path: Path) -> None:
    joined = read(tmp_path, SMALL.replace("= first", "= fi-\n       rst"))
    quoted = read(tmp_path, SMALL.replace("= first", "= 'fi\n       rst'"))

    assert joined.ids[0] == "first"
    assert quoted.ids[0] == "fi rst"


def test_real_network(shared_data: Path) -> None:
    path = shared_data / "lro_nac_lola" / "network.pvl"
    text = path.read_text()
    start = time.process_time()
    got = read_control_network(path)
    elapsed = time.process_time() - start

    assert elapsed < 0.5  # 0.05 s on the machine it was written on
    assert len(got.ids) == 311
    assert got.ids == tuple(re.findall(r"PointId\s*= (\S+)", text))
    assert got.measure_image == tuple(re.findall(r"SerialNumber\s*= (\S+)", text))
    lines, samples = (
        np.array(re.findall(rf"^ *{key} *= (\S+)", text, re.MULTILINE), dtype=float) for key in ("Line", "Sample")
    )
    np.testing.assert_array_equal(got.measures, np.stack([lines, samples], axis=1) - 0.5)
    assert np.all(np.isnan(got.measure_sigmas))
    assert np.all(got.kinds == PointKind.FREE)


# ---- what is wrong is said ----------------------------------------------------------------------------------------

FAULTS = {
    "no PointId": ("    PointId                  = first\n", "", 8, "no PointId"),
    "odd PointType": ("= Constrained", "= Floating", 9, "point first, PointType: 'Floating'"),
    "id twice": ("= second", "= first", 32, "point first, PointId: the id twice, first at"),
    "no Line": ("      Line         = 2002.25\n", "", 20, "point first, image MGS/561812335:32/MOC-NA: no Line"),
    "NaN": ("= 2002.25", "= NaN", 24, "first, image MGS/561812335:32/MOC-NA, Line: 'NaN'; expected a finite number"),
    "ISIS Null number": ("= 2002.25", "= -1.7976931348623157e+308", 24, "a finite number"),
    "negative sigma": ("= 0.5 <pixels>", "= -0.5 <pixels>", 25, "LineSigma: -0.5 px; expected a positive sigma"),
    "unit": ("<meters>\n    AprioriY", "<furlongs>\n    AprioriY", 13, "AprioriX: the unit <furlongs>"),
    "part of a place": ("    AprioriY                 = -2937138.2 <meters>\n", "", 8, "point first: no AprioriY"),
    "no covariance": ("AprioriCovarianceMatrix", "AdjustedCovarianceMatrix", 8, "without AprioriCovarianceMatrix"),
    "short covariance": (", 300.0", "", 16, "AprioriCovarianceMatrix: 5 items; expected a list of 6 numbers"),
    "keyword twice": ("      Line         = 2002.25", "      Line = 1\n      line = 2", 25, "line twice in one group"),
    "odd flag": ("= Yes", "= Yes\n Ignore = perhaps", 39, "Ignore: 'perhaps'; expected True or False"),
    "odd group": ("Group = ControlMeasure", "Group = Measure", 20, "group measure; expected Group = ControlMeasure"),
    "wrong end": ("    End_Group\n  End_Object", "    End_Object\n  End_Object", 27, "the end of group controlmeasure"),
    "open quote": ("= second", '= "second', 32, "a quote that is never closed"),
    "open list": ("300.0)", "300.0", 16, "a list broken by"),
    "version 6": ("= 5", "= 6", 6, "version 6; expected 2 to 5"),
    "binary": ("= ControlNetwork", "= ProtoBuffer", 1, "cnetbin2pvl"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_found_where_it_is(tmp_path: Path, fault: str) -> None:
    old, new, line, said = FAULTS[fault]
    assert old in SMALL

    message = assert_refused(tmp_path, SMALL.replace(old, new, 1))

    assert re.match(rf"{re.escape(str(tmp_path))}/network\.pvl, line {line}[,:] ", message), message
    assert said in message


def test_an_image_twice_in_a_point_is_refused(tmp_path: Path) -> None:
    group = SMALL[SMALL.index("    Group") : SMALL.index("    End_Group") + len("    End_Group\n")]

    message = assert_refused(tmp_path, SMALL.replace(group, group + group))

    assert "line 28, point first, image MGS/561812335:32/MOC-NA: a second measure" in message


@pytest.mark.parametrize("correlation", [150.0, -150.0])
def test_a_covariance_that_is_not_positive_definite_is_refused(tmp_path: Path, correlation: float) -> None:
    message = assert_refused(tmp_path, SMALL.replace("(100.0, 1.0", f"(100.0, {correlation}"))

    assert "point first: an a-priori covariance that is not positive definite" in message


@pytest.mark.parametrize("text", ["", "End", "lat,lon\n1,2\n", "\x00\x01"])
def test_text_that_is_no_network_is_refused(tmp_path: Path, text: str) -> None:
    assert_refused(tmp_path, text)


def test_a_network_of_ignored_points_is_refused(tmp_path: Path) -> None:
    ignored = SMALL.replace("PointType", "Ignore = True\nPointType")

    assert "no control point, or only ignored ones" in assert_refused(tmp_path, ignored)
