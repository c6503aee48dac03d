"""HRSC labels of both kinds, and the times of lines out of prefixes, tables and text; faults said in one line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mex import CHANGES, CUBE, FOLDER, LABEL, LINES, START, cube_bytes, image_bytes, times_file

from mgsgraph.errors import InputError
from mgsgraph.files.cameras.camera import LineScanLabel, LineTimes, LineTimesLocation, LineTimesSource, NaifKeywords
from mgsgraph.files.cameras.label import HRSC, read_line_scan_label

STOP = START + 19 * 0.0128
STOP_OF_H5270 = CHANGES[2][0] + (LINES - CHANGES[2][2]) * CHANGES[2][1]


def written(folder: Path, *changes: tuple[str, str], times: np.ndarray | None = None) -> Path:
    text = LABEL
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "H5270_0000_IR2.IMG"
    times = START + 0.0128 * np.arange(20) if times is None else times
    path.write_bytes(image_bytes(times.tolist(), [12.8] * 20, text))
    return path


def cube(folder: Path, *changes: tuple[str, str]) -> Path:
    text = CUBE
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "h5270.cub"
    path.write_bytes(cube_bytes(text))
    return path


ADDENDUM = NaifKeywords("the addendum", {
    "INS-41218_ITRANSL": (0.0, 0.0, 142.86), "INS-41218_ITRANSS": (0.0, -142.86, 0.0), "INS-41218_FOCAL_LENGTH": 174.8,
    "INS-41218_BORESIGHT_LINE": 0.0, "INS-41218_BORESIGHT_SAMPLE": 2592.0,
})  # fmt: skip


def times_of(path: Path, source: LineTimesSource = None, stop: float = STOP_OF_H5270) -> LineTimes:
    label = read_line_scan_label(path)
    label.camera.interior(ADDENDUM, label)
    return label.camera.line_times(ADDENDUM, replace(label, times=source or label.times), START, stop)


def refused(path: Path, source: LineTimesSource = None, stop: float = STOP_OF_H5270) -> str:
    """What is said of a file that is refused, in one line that begins with its folder."""
    with pytest.raises(InputError) as caught:
        times_of(path, source, stop)
    assert str(caught.value).startswith(str(path.parent))
    assert "\n" not in str(caught.value)
    return str(caught.value)


# --- labels


def test_pds_label(tmp_path: Path) -> None:
    got = read_line_scan_label(written(tmp_path))
    assert (got.camera.instrument, got.product, got.target) == (-41218, "H5270_0000_IR2.IMG", "MARS")
    assert (got.lines, got.samples, got.sample_summing) == (20, 222, 4)
    assert isinstance(got.times, LineTimesLocation)
    assert (got.times.kind, got.times.offset, got.times.count, got.times.stride) == ("prefixes", 2048, 20, 512)


@pytest.mark.parametrize("name", ["S2", "RED", "P2", "BLUE", "NADIR", "GREEN", "P1", "IR", "S1"])
def test_each_line_is_known(tmp_path: Path, name: str) -> None:
    camera = read_line_scan_label(written(tmp_path, ("MEX_HRSC_IR", f"MEX_HRSC_{name}"))).camera
    assert camera.name == f"MEX HRSC {name}"
    assert camera in HRSC


def test_real_labels_of_both_kinds_say_the_same(shared_data: Path) -> None:
    """They were cut off their images, so the times of the lines are not there."""
    paths = [shared_data / FOLDER / f"h5270_0000_ir2_{kind}.lbl" for kind in ("pds3", "isis3")]
    pds, isis = map(read_line_scan_label, paths)
    for label in (pds, isis):
        assert (label.camera.name, label.product, label.sample_summing) == ("MEX HRSC IR", "H5270_0000_IR2.IMG", 4)
        assert (label.lines, label.samples, label.times) == (15088, 1288, None)
        assert label.start.rstrip("Z") == "2008-02-08T12:08:53.843"
        assert label.stop.rstrip("Z") == "2008-02-08T12:12:10.561"


def test_a_label_without_macropixels_has_single_ones(tmp_path: Path) -> None:
    assert read_line_scan_label(written(tmp_path, ("MACROPIXEL_SIZE              = 4\n", ""))).sample_summing == 1


FAULTS: dict[str, tuple[str, str, str]] = {
    "unknown line": ("MEX_HRSC_IR", "MEX_HRSC_UV", "known by PDS3 labels: MEX HRSC MEX_HRSC_S2, MEX HRSC MEX_HRSC_RED"),
    "super resolution": ("MEX_HRSC_IR", "MEX_HRSC_SRC", "the camera 'HRSC'"),
    "the head alone": ("MEX_HRSC_IR", "MEX_HRSC_HEAD", "the camera 'HRSC'"),
    "no line": ("DETECTOR_ID                  = MEX_HRSC_IR\n", "", "the camera 'HRSC'"),
    "another instrument": ("= HRSC\n", "= OMEGA\n", "the camera 'OMEGA'"),
    "a map": ("PROCESSING_LEVEL_ID          = 2", "PROCESSING_LEVEL_ID          = 3", "a map (level 3)"),
    "macropixels of 3": ("MACROPIXEL_SIZE              = 4", "MACROPIXEL_SIZE = 3", "macropixels of 3; expected"),
    "off the line": ("LINE_SAMPLES       = 222", "LINE_SAMPLES = 1297", "pixels from 1 on end at 5188"),
    "no lines": ("LINES              = 20", "LINES = 0", "0; expected a whole number above zero"),
    "no stop": ("STOP_TIME                    = 2008-02-08T12:08:54.084Z\n", "", "no STOP_TIME"),
    "no image": ("Object = IMAGE\n", "Object = CUBE\n", "no IMAGE"),
    "negative prefix": ("LINE_PREFIX_BYTES  = 68", "LINE_PREFIX_BYTES = -68", "-68 bytes before or after a line"),
    "pointer to nowhere": ("^IMAGE                       = 5", '^IMAGE = "LOST.IMG"', "LOST.IMG, which is not there"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_label_is_refused_in_one_line(tmp_path: Path, fault: str) -> None:
    old, new, said = FAULTS[fault]
    assert said in refused(written(tmp_path, (old, new)))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("MEX_HRSC_IR", "MEX_HRSC_ND", "the camera 'HRSC'"),
        ("= HRSC", "= THEMIS_IR", "no SpacecraftClockCount"),
        ("Summing        = 4", "Summing = 8", "1288 samples of 8 pixels"),
        ("  Group = Archive", "  Group = Mapping\n  End_Group\n  Group = Archive", "a map-projected cube"),
        (
            "  Group = Archive",
            "  Group = AlphaCube\n AlphaSamples = 1288\n AlphaLines = 20000\n  End_Group\n  Group = Archive",
            "15088 of 20000 lines",
        ),
        ("Name = ExposureTime", "Name = Exposures", "expected EphemerisTime, ExposureTime (Double)"),
        ("ByteOrder = Lsb", "ByteOrder = Msb", "ByteOrder = Lsb"),
        ("  StartByte = 4097", "  StartByte = 4098", "a label without the times of its lines"),
        ("LineScanTimes", "Footprints", "name that, or line_times = a text file of EphemerisTime, ExposureTime"),
    ],
)
def test_a_faulty_cube_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert said in refused(cube(tmp_path, (old, new)))


# --- times of lines


def test_the_last_line_ends_when_isis_says(shared_data: Path, tmp_path: Path) -> None:
    """CkTableStartTime and CkTableEndTime of the real cube are the edges of its first and last line, to 1e-5 s."""
    text = (shared_data / FOLDER / "h5270_0000_ir2_isis3.lbl").read_text()
    first, last = (float(text.split(f"CkTable{end}Time")[1].split()[1]) for end in ("Start", "End"))
    times = times_of(cube(tmp_path))
    assert times.start == pytest.approx(first, abs=1e-5)
    assert times.stop == pytest.approx(last, abs=1e-5)
    at, period = times.timing(times.start).at(np.array([LINES - 1.0, LINES]))
    assert at[1] == pytest.approx(last - times.start, abs=1e-5)
    np.testing.assert_allclose(period, CHANGES[2][1], rtol=1e-12)


def test_two_rates_join_at_the_change(tmp_path: Path) -> None:
    """Recorded times stand at the changes, and the lines' times run through them; rates are the exposures to 2%."""
    timing = times_of(cube(tmp_path)).timing(START)
    first = np.array([change[2] - 1.0 for change in CHANGES])
    just_before, _ = timing.at(np.nextafter(first[1:], 0.0))
    at, period = timing.at(first)
    np.testing.assert_allclose(just_before, at[1:], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(at, np.array([change[0] for change in CHANGES]) - START)
    np.testing.assert_allclose(period, [change[1] for change in CHANGES], rtol=0.02)
    assert period[0] == pytest.approx(CHANGES[0][1], rel=1e-6)
    np.testing.assert_allclose(timing.lines(at), first, rtol=0, atol=1e-9)


def test_table_and_text_are_the_same(tmp_path: Path) -> None:
    path = cube(tmp_path)
    table, text = times_of(path), times_of(path, times_file(tmp_path))
    for name in ("first_lines", "starts", "periods"):
        np.testing.assert_array_equal(getattr(table, name), getattr(text, name))


def test_text_may_have_other_columns_and_blanks(tmp_path: Path) -> None:
    path = tmp_path / "times.csv"
    rows = [f"{k}, {line},{time!r} , {period!r}" for k, (time, period, line) in enumerate(CHANGES)]
    path.write_text("\n".join(["Index, LineStart, EphemerisTime, ExposureTime", *rows]))
    np.testing.assert_array_equal(times_of(cube(tmp_path), path).starts, [change[0] for change in CHANGES])


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(
    exposures=st.lists(st.sampled_from([8.96, 12.8, 13.25]), min_size=20, max_size=20),
    pause=st.one_of(st.none(), st.integers(1, 19)),
    noise=st.floats(0.0, 0.1),
)
def test_every_line_is_at_the_time_of_its_prefix(
    tmp_path: Path, exposures: list[float], pause: int | None, noise: float
) -> None:
    """Changes of the rate, a pause of three lines and clocks uneven by up to a tenth of a line included."""
    waits = np.array(exposures[:-1]) * 1e-3
    if pause is not None:
        waits[pause - 1] *= 4.0
    times = START + np.concatenate([[0.0], np.cumsum(waits)])
    uneven = times + 0.5 * noise * 8.96e-3 * (-1.0) ** np.arange(20)
    path = tmp_path / "H5270_0000_IR2.IMG"
    path.write_bytes(image_bytes(uneven.tolist(), exposures))
    got = times_of(path, stop=float(times[-1]))
    at, _ = got.timing(START).at(np.arange(20.0))
    np.testing.assert_allclose(at, uneven - START, rtol=0, atol=noise * 8.96e-3 + 3e-6)  # exposures are float32
    assert got.last == pytest.approx(uneven[-1], abs=noise * 8.96e-3 + 3e-6)
    if pause is not None:
        after, _ = got.timing(START).at(np.array([pause - 1e-9, float(pause)]))
        assert after[1] - after[0] == pytest.approx(waits[pause - 1] * 0.75, abs=2 * noise * 8.96e-3 + 3e-6)


def test_the_mean_of_a_label(tmp_path: Path) -> None:
    """STOP_TIME is when the last line begins; the middle of h5270 is then 1.6 s late."""
    mean = times_of(cube(tmp_path), "mean")
    assert mean.periods[0] == pytest.approx((STOP_OF_H5270 - START) / (LINES - 1), rel=1e-12)
    assert mean.last == pytest.approx(STOP_OF_H5270, abs=1e-6)
    true = times_of(cube(tmp_path)).timing(START)
    late = mean.timing(START).at(np.array([6665.0]))[0] - true.at(np.array([6665.0]))[0]
    assert late[0] == pytest.approx(1.587, abs=1e-3)


first, second, third = CHANGES
WRONG: dict[str, tuple[tuple[tuple[float, float, float], ...], str]] = {
    "rates in ms": (((first[0], 12.8, 1),), "a line rate of 12800 ms per line from line 1 on; expected 1 .. 500 ms"),
    "an endless rate": (((first[0], 1.7e290, 1),), "a line rate of 1.7e+293 ms per line"),
    "no rate": ((first, (second[0], 0.0, 6665)), "a line rate of 0 ms per line from line 6665 on"),
    "negative rate": (((first[0], -0.0128, 1),), "a line rate of -12.8 ms"),
    "lines back": ((first, third, second), "changes at lines 1, 6666, 6665; expected lines from 1 up to 15088"),
    "beyond the image": ((first, (third[0], third[1], 15089)), "changes at lines 1, 15089"),
    "not from the first": ((second, third), "changes at lines 6665, 6666"),
    "times back": ((first, (first[0] + 1.0, 0.0128, 6665)), "line 6665 begins 6.59e+03 lines before the one ahead"),
    "another orbit": (((first[0] - 25000.0, 0.0130389, 1),), "-25000.000 s off the label's START_TIME"),
    "a wrong rate": (((first[0], 0.0132, 1),), "+2.429 s off the label's STOP_TIME"),
    "nothing": ((), "changes at lines none; expected lines from 1"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_line_times_that_make_no_sense(tmp_path: Path, fault: str) -> None:
    changes, said = WRONG[fault]
    assert said in refused(cube(tmp_path), times_file(tmp_path, changes))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("EphemerisTime,ExposureTime\n1,2\n", "the columns EphemerisTime, ExposureTime; expected EphemerisTime, Exp"),
        ("", "the columns none"),
        ("EphemerisTime,ExposureTime,LineStart\n255744599.0,fast,1\n", "line 2, ExposureTime: 'fast'; expected"),
        ("EphemerisTime,ExposureTime,LineStart\n255744599.0\n", "line 2, ExposureTime: ''"),
        ("EphemerisTime,ExposureTime,LineStart\n1," + 140_000 * "1" + ",1\n", "is not a table of line times"),
        ("EphemerisTime,ExposureTime,LineStart\nnan,0.0128,1\n", "'nan'; expected a finite number"),
    ],
)
def test_text_that_is_none(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "times.csv"
    path.write_text(text)
    assert said in refused(cube(tmp_path), path)


def test_prefixes_that_are_none(tmp_path: Path) -> None:
    times = START + 0.0128 * np.arange(20)
    times[7] = np.nan
    assert "prefix of line 8: nan s and 0.0128 s" in refused(written(tmp_path, times=times), stop=STOP)
    early = written(tmp_path, times=np.zeros(20) + 0.0128 * np.arange(20))
    assert "the label's START_TIME" in refused(early, stop=STOP)
    bare = written(tmp_path, ("LINE_PREFIX_BYTES  = 68", "LINE_PREFIX_BYTES = 0"))
    assert "a label without the times" in refused(bare)
    assert "a label without the times" in refused(written(tmp_path, ("LINES              = 20", "LINES = 21")))


@pytest.mark.parametrize(
    ("field", "content"),
    [
        (0, b"\xff" * 8), (0, b"\0" * 6 + b"\xf0\x7f"), (0, b"\xff" * 6 + b"\xef\x7f"), (8, b"\1\0\x80\x7f"),
        (8, b"\0" * 4), (8, b"\0\0\x80\xbf"),
    ],
)  # fmt: skip
def test_damaged_prefixes_are_told_without_numpys_warnings(tmp_path: Path, field: int, content: bytes) -> None:
    """NaN, a signalling one, infinities, times of 1e308 s: warnings are errors here."""
    path = written(tmp_path)
    damaged = bytearray(path.read_bytes())
    at = 4 * 512 + 7 * 512 + field
    damaged[at : at + len(content)] = content
    path.write_bytes(damaged)
    assert "prefix of line 8" in refused(path, stop=STOP)


def test_a_table_of_times_far_from_any_mission(tmp_path: Path) -> None:
    said = refused(cube(tmp_path), times_file(tmp_path, ((1.7e290, 0.0128, 1), (-1.7e290, 0.0128, 5000))))
    assert "the time 1.7e+290 s for line 1" in said


def test_a_mean_needs_two_lines_and_a_sensible_span(tmp_path: Path) -> None:
    single = written(tmp_path, ("LINES              = 20", "LINES = 1"))
    assert "one line; expected at least" in refused(single, "mean", STOP)
    assert "a line rate of 10353.6 ms per line" in refused(written(tmp_path), "mean")
    said = refused(written(tmp_path), "mean", START - 1.0)
    assert "STOP_TIME -1.000 s after START_TIME; expected a time after" in said


def test_files_that_are_not_there(tmp_path: Path) -> None:
    assert "no such file" in refused(cube(tmp_path), tmp_path / "lost.csv")
    with pytest.raises(InputError, match="no such file"):
        read_line_scan_label(tmp_path / "gone.img")


def test_a_label_says_where_it_was_read(tmp_path: Path) -> None:
    got: LineScanLabel = read_line_scan_label(cube(tmp_path))
    assert got.path == tmp_path / "h5270.cub"
    assert isinstance(got.times, LineTimesLocation)
    assert got.times.kind == "table"
