"""Tables of shots and tie points: blank lines, numbers and faults far down; tie points by columns."""

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.networks.table import read_tie_points
from mgsgraph.geometry.trajectory import tdb_of_utc, utc_of_tdb, utc_texts

ODE = "long_East,lat_North,topography, MOLArange,  planet_rad, c,A,  Ephermis Time,          UTC,          Orbit\n" + (
    "".join(f"137.3766{k}, -4.09420,   -2659.75, 390043.53,  3393004.81,1,0, -2316293{k}.18358,"
            f"1999-04-08T09:50:0{k}.631, 10372\n" for k in range(5))
)  # fmt: skip
TIES = """\
id,image,type,isis_line,isis_sample,sigma_line_px,sigma_sample_px,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m,measure_type,ignore,reference,point_ignore
a1,A,free,100.25,33.5,0.5,0.25,,,,,,,Candidate,,true,
a1,B,,70,80,,,,,,,,,RegisteredSubPixel,,,
b 2,A,constrained,20.5,31,,,3390000.5,1000,-2000,10,11,12,Manual,no,,
b 2,B,,21.5,32,1,2,,,,,,,reg_pixel,true,,
c,B,fixed,1.5,2.5,,,10,3390000,20,,,,,,,
d,A,free,7,8,,,,,,,,,,,,true
e,,Free,,,,,3390001,1,2,,,,,,,
a1,C,free,7.125,1e2,,,,,,,,,,0,,
"""
SCRIPTS = Path(__file__).resolve().parents[3] / "scripts"


def refusal(path: Path) -> str:
    """What is said of tie points that are refused; nothing of those that are read."""
    try:
        read_tie_points(path)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of numbers that can't be, before they are refused
def test_a_damaged_file_is_read_or_refused_in_a_line(tmp_path: Path) -> None:
    if not SCRIPTS.is_dir():
        pytest.skip("scripts are not here")
    sys.path.append(str(SCRIPTS))
    from fuzz_edits import edited

    path, ends = tmp_path / "ties.csv", set[bool]()

    @settings(max_examples=60)
    @given(edited(TIES.encode(), "csv"))
    def read(content: bytes) -> None:
        path.write_bytes(content)
        said = refusal(path)
        assert "\n" not in said
        ends.add(not said)

    read()
    assert ends == {True, False}


@pytest.mark.parametrize("blank", ["", "   "])
@pytest.mark.parametrize("place", [2, 4, -1, -2])
def test_lines_of_blanks_count_for_nothing(tmp_path: Path, place: int, blank: str) -> None:
    for text, read, wanted in ((ODE, read_shots, "footprints"), (TIES, read_tie_points, "measures")):
        (tmp_path / "whole.csv").write_text(text)
        lines = text.split("\n")
        (tmp_path / "blank.csv").write_text("\n".join([*lines[:place], blank, *lines[place:]]))
        found, expected = (getattr(read(tmp_path / name), wanted) for name in ("blank.csv", "whole.csv"))
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("digits", [1, 17, 25])
def test_numbers_are_rounded_correctly(tmp_path: Path, digits: int) -> None:
    """Python's own float is the authority."""
    rng = np.random.default_rng(digits)
    texts = [f"{rng.integers(1, 9000)}.{''.join(map(str, rng.integers(10, size=digits)))}" for _ in range(500)]
    path = tmp_path / "ties.csv"
    path.write_text("id,image,line,sample\n" + "".join(f"p{k},a,{text},1\n" for k, text in enumerate(texts)))
    found = read_tie_points(path).measures[:, 0]
    assert (found + 0.5 - 0.5).tolist() == [float(text) + 0.5 - 0.5 for text in texts]


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("137.4,x,-2659.75,390043.5,3393004.8,1,0,-23162931.1,1999-04-08T09:50:04.6,10372", "line 4, lat_North: 'x'"),
        ("137.4,-4.1,-2659.75,390043.5,3393004.8,1,0,nan,1999-04-08T09:50:04.6,10372", "line 4, Ephermis Time: 'nan'"),
        ("137.4,-4.1,-2659.75", "line 4: 3 fields; expected 10"),
    ],
)
def test_a_fault_far_down_is_said_with_its_line(tmp_path: Path, row: str, said: str) -> None:
    lines = ODE.split("\n")
    path = tmp_path / "shots.csv"
    path.write_text("\n".join([*lines[:3], row, *lines[3:]]))
    with pytest.raises(InputError) as caught:
        read_shots(path)
    assert f"{path}, {said}" in str(caught.value)


@pytest.mark.parametrize(
    "texts",
    [
        ["2009-09-06T07:50:38.773", "2009-09-06T07:50:38", "2016-12-31T23:59:60.5Z", "1999-04-08 09:50:04.631"],
        ["2009-249T07:50:38.773", "2009-09-06T07:50:38.773"], ["2009-09-06T07:50", "2009-09-06T07:50:00."],
    ],
)  # fmt: skip
def test_times_of_a_column_are_those_of_each(texts: list[str]) -> None:
    found = tdb_of_utc(texts, "x")
    assert found.tolist() == [tdb_of_utc([text], "x")[0] for text in texts]


@pytest.mark.parametrize(
    "text", ["2009-02-29T07:50:38.7", "2009-09-06T07:50:61.0", "2009-09-06T24:50:01.0",
             "2009-249T07:50Z :38"],
)
def test_a_time_that_can_not_be_is_refused_in_a_column_too(text: str) -> None:
    with pytest.raises(InputError, match=text):
        tdb_of_utc(["2009-09-06T07:50:38.773", text], "x")


def test_times_written_are_those_of_each() -> None:
    """Python's datetime is the authority, leap seconds and times before J2000 included."""
    rng = np.random.default_rng(1)
    times = np.concatenate([rng.uniform(-8e8, 1e9, 3000), np.array([-0.0005, 0.0, 64.184, 5e8, 5e8 + 0.9995, 4.8e8])])
    expected = [f"{utc_of_tdb(time):%Y-%m-%dT%H:%M:%S.%f}"[:-3] for time in times.tolist()]
    assert utc_texts(times).tolist() == expected
