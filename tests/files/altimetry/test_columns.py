"""Tables of shots and tie points: blank lines, numbers and faults far down; tie points by columns."""

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from readable_tables import Readable, outcome, readables

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.networks.table import read_tie_points
from mgsgraph.geometry.trajectory import tdb_of_utc, utc_of_tdb, utc_texts

FILES = readables()
NUMBERED = {"frames", "ids"}
"""Fields that count the file's lines."""
TIES = [kind for kind in FILES if kind.startswith("ties")]
SCRIPTS = Path(__file__).resolve().parents[3] / "scripts"


def put(folder: Path, one: Readable, content: bytes | None = None) -> Path:
    path = folder / one.name
    path.write_bytes(one.form(one.content) if content is None else content)
    return path


@pytest.mark.parametrize("kind", TIES)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of numbers that can't be, before they are refused
def test_damaged_files_are_read_or_refused_in_a_line(tmp_path: Path, kind: str) -> None:
    if not SCRIPTS.is_dir():
        pytest.skip("scripts are not here")
    sys.path.append(str(SCRIPTS))
    from fuzz_edits import edited

    one, ends = FILES[kind], set[bool]()

    @settings(max_examples=60)
    @given(edited(one.content, "bytes" if b"\0" in one.content else "csv"))
    def read(content: bytes) -> None:
        try:
            path = put(tmp_path, one, one.form(content))
        except ValueError:  # no table of which a file of another form could be made
            return
        found = outcome(one.read, path)
        assert not isinstance(found, str) or "\n" not in found
        ends.add(isinstance(found, str))

    read()
    assert ends == {True, False}


@pytest.mark.parametrize("blank", ["", " ", "   "])
@pytest.mark.parametrize("kind", ["ODE", "PEDR2TAB", "PEDR2TAB, blanks", "cloud", "ties"])
@pytest.mark.parametrize("place", [2, 4, -1, -2])
def test_lines_of_blanks_count_for_nothing(tmp_path: Path, kind: str, place: int, blank: str) -> None:
    """Found by fuzzing: one at the end of a table with blanks between its columns."""
    lines = FILES[kind].content.decode().split("\n")
    path = put(tmp_path, FILES[kind], "\n".join([*lines[:place], blank, *lines[place:]]).encode())
    found = outcome(FILES[kind].read, path)
    assert not isinstance(found, str)
    expected = outcome(FILES[kind].read, put(tmp_path, FILES[kind]))
    assert {name: value for name, value in found.items() if name not in NUMBERED} == {
        name: value for name, value in expected.items() if name not in NUMBERED
    }


@pytest.mark.parametrize("digits", [1, 9, 15, 17, 25])
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
        (",-4.1,-2659.75,390043.5,3393004.8,1,0,-23162931.1,1999-04-08T09:50:04.6,10372", "line 4, long_East: nothing"),
        ("137.4,x,-2659.75,390043.5,3393004.8,1,0,-23162931.1,1999-04-08T09:50:04.6,10372", "line 4, lat_North: 'x'"),
        ("137.4,-4.1,-2659.75,390043.5,3393004.8,1,0,nan,1999-04-08T09:50:04.6,10372", "line 4, Ephermis Time: 'nan'"),
        ("137.4,-4.1,-2659.75,390043.5,3393004.8,1,0,1e999,1999-04-08T09:50:04.6,10372", "line 4, Ephermis Time"),
        ("137.4,-4.1,-2659.75", "line 4: 3 fields; expected 10"),
        ("137.4,-4.1,-2659.75,390043.5,3393004.8,1,0,-23162931.1,1999-04-08T09:50:04.6,10372,", "line 4: 11 fields"),
    ],
)
def test_a_fault_far_down_is_said_with_its_line(tmp_path: Path, row: str, said: str) -> None:
    lines = FILES["ODE"].content.decode().split("\n")
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
    "text", ["2009-02-29T07:50:38.7", "2009-366T07:50:38.7", "2009-09-06T07:50:61.0", "2009-09-06T24:50:01.0",
             "1969-01-01T00:00:00", "2009-249T07:50Z :38", "2009-249T07:50Z:38"],
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
