"""Support data of HRSC's kind, in the layout that ALE documents and writes: several line rates, matrices that turn.

No complete file of a real HRSC image is at hand: numbers of the detector and the line rates are those of h5270_0000_ir2
(ISIS addendum, ALE's test of its driver), position and attitude those of a simulated pass.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mex import CHANGES, LINES, SAMPLES
from strip_files import block

from mgsgraph.errors import InputError
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.simulation.case_files import support_data

CENTRE = 255744697.39357847
"""center_ephemeris_time of h5270_0000_ir2."""
RATES = [[line - 0.5, time - CENTRE, period] for time, period, line in CHANGES]


def hrsc(**changes: Any) -> dict[str, Any]:
    """Support data like ALE's of h5270_0000_ir2."""
    simulated = support_data(block().network.images[0])
    long = np.linspace(CENTRE - 120.0, CENTRE + 120.0, 41)
    tables = {}
    for name in ("instrument_position", "instrument_pointing", "body_rotation"):
        table = dict(simulated[name])
        chosen = np.linspace(0, len(table["ephemeris_times"]) - 1, 41).astype(int)
        for key in ("positions", "velocities", "quaternions"):
            if key in table:
                table[key] = [table[key][k] for k in chosen]
        tables[name] = table | {"ephemeris_times": long.tolist()}
    return simulated | tables | {
        "name_platform": "MARS EXPRESS", "name_sensor": "MEX_HRSC_IR",
        "image_lines": LINES, "image_samples": SAMPLES, "line_scan_rate": RATES,
        "center_ephemeris_time": CENTRE, "starting_ephemeris_time": CHANGES[0][0],
        "focal_length_model": {"focal_length": 174.82}, "detector_center": {"line": 0.0, "sample": 2592.0},
        "focal2pixel_lines": [-7113.11359717265, 0.062856784318668, 142.857129028729],
        "focal2pixel_samples": [-0.778052433438109, -142.857129028729, 0.062856784318668],
        "detector_sample_summing": 4, "detector_line_summing": 4,
        "starting_detector_line": 0, "starting_detector_sample": 0,
        "optical_distortion": {"radial": {"coefficients": [0.0, 0.0, 0.0]}},
        "naif_keywords": {"INS-41218_LIGHTTIME_CORRECTION": "NONE"},
    } | changes  # fmt: skip


def read(folder: Path, **changes: Any) -> PushbroomImage:
    path = folder / "h5270.json"
    path.write_text(json.dumps(hrsc(**changes)))
    return read_isd(path, "h5270")


def test_line_rates(tmp_path: Path) -> None:
    """Three of them: a line's time is that of its change plus whole periods of its own."""
    image = read(tmp_path)
    lines = np.array([0.0, 6663.0, 6664.0, 6664.5, 6665.0, 10000.0])
    times, periods = image.timing.at(lines)
    owner = [0, 0, 1, 1, 2, 2]
    start, period, first = np.array(CHANGES)[owner].T
    want = start - CENTRE + (lines - (first - 1.0)) * period
    np.testing.assert_allclose(times, want, rtol=0, atol=1e-7)
    assert periods.tolist() == period.tolist()
    np.testing.assert_allclose(image.timing.lines(times), lines, atol=1e-5)
    np.testing.assert_allclose(np.diff(image.moments(lines).times), np.diff(times))


def test_ephemeris_times_of_lines_are_understood(tmp_path: Path) -> None:
    """As ALE wrote them once (its test data's mexhrsc_isd.json): the same image, and a remark."""
    image = read(tmp_path, line_scan_rate=[[line - 0.5, time, period] for time, period, line in CHANGES])
    np.testing.assert_allclose(image.timing.start_times, read(tmp_path).timing.start_times, rtol=0, atol=1e-7)
    assert len(image.remarks) == 1


def test_the_detector_lies_where_the_addendum_puts_it(tmp_path: Path) -> None:
    """Y0 = 49.7918 mm ahead along track (facts of the addendum), its samples 28 micrometres apart towards -X."""
    place, slope = read(tmp_path).interior.focal_plane(np.array([0.0, 648.0, 1288.0]))
    np.testing.assert_allclose(place[:, 1], 49.7918e-3, rtol=0, atol=1e-5)
    np.testing.assert_allclose(slope[:, 0], -28e-6, rtol=1e-6)
    assert place[1, 0] == pytest.approx(0.0, abs=2e-5)


def test_macropixels_that_ale_leaves_out_are_known_by_the_size(tmp_path: Path) -> None:
    image = read(tmp_path, detector_sample_summing=1)
    assert image.interior.sample_summing == 4.0
    assert len(image.remarks) == 1


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"focal2pixel_samples": [0.0, 111.111111111111, 0.0]}, "111.111 pixels per mm; expected HRSC's 142.857"),
        ({"line_scan_rate": [RATES[0], RATES[2], RATES[1]]}, "line timing, first lines"),
        ({"line_scan_rate": [[0.5, -98.0, 0.0128], [6664.5, -20.0, 0.0129]]}, "segments one after the other"),
        ({"image_lines": 40_000}, r"image h5270, first or last line: time \d+\.\d+ s .* lies outside the tables"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, changes: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        read(tmp_path, **changes)
    assert str(caught.value).startswith(str(tmp_path / "h5270.json"))
    assert "\n" not in str(caught.value)
