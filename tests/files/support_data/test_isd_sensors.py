"""What support data leave unsaid and their sensor decides, what is put right in them, and what is said of both."""

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support_data import ISD, edited, read

from mgsgraph.errors import InputError
from mgsgraph.files.cameras.label import CAMERAS
from mgsgraph.files.labels.aberration import SPACECRAFT, Aberration, geometric, spacecraft_of

SILENT = edited(("naif_keywords",), {})


def positions(folder: Path, isd: dict[str, Any], given: Aberration | None = None) -> np.ndarray:
    return read(folder, isd, given).trajectory.position.positions


@pytest.mark.parametrize("sensors", SPACECRAFT, ids=lambda sensors: sensors.names[-1])
def test_the_platform_decides_and_is_said(tmp_path: Path, sensors: Any) -> None:
    for name in (sensors.names[0], sensors.names[0].lower().replace(" ", "_")):
        image = read(tmp_path, SILENT | {"name_platform": name})
        np.testing.assert_array_equal(
            image.trajectory.position.positions, positions(tmp_path, SILENT, sensors.stated)
        )
        assert any(sensors.source in remark for remark in image.remarks)
    by_code = SILENT | {"naif_keywords": {f"INS{1000 * sensors.code - 31}_FOCAL_LENGTH": 3500.0}}
    np.testing.assert_array_equal(positions(tmp_path, by_code), image.trajectory.position.positions)


def test_the_case_overrules_file_and_sensor(tmp_path: Path) -> None:
    mgs = SILENT | {"name_platform": "MARS GLOBAL SURVEYOR"}
    np.testing.assert_array_equal(
        positions(tmp_path, mgs, Aberration("NONE")), 1e3 * np.array(ISD["instrument_position"]["positions"])
    )


@pytest.mark.parametrize(
    ("said", "meant"),
    [
        ({"LIGHTTIME_CORRECTION": "LT+S"}, Aberration("LT+S", "body")),
        ({"LIGHTTIME_CORRECTION": "LT+S", "SWAP_OBSERVER_TARGET": "FALSE"}, Aberration("LT+S", "body")),
        ({"LIGHTTIME_CORRECTION": "LT+S", "SWAP_OBSERVER_TARGET": True}, Aberration("LT+S", "spacecraft")),
        (
            {"LIGHTTIME_CORRECTION": "LT+S", "SWAP_OBSERVER_TARGET": "TRUE", "LT_SURFACE_CORRECT": "TRUE"},
            Aberration("LT+S", "spacecraft", to_surface=True),
        ),
    ],
)
def test_keywords_are_those_of_isis(tmp_path: Path, said: dict[str, Any], meant: Aberration) -> None:
    """Swapped, the spacecraft observes (ISIS SpicePosition, ALE sensor_position, which negates the vector then)."""
    apparent = read(tmp_path, SILENT, Aberration("NONE")).trajectory.position
    radius = 0.5e3 * (3396.19 + 3376.2)
    want = geometric(apparent, np.array([0.0, -24e3, 0.0]), meant, radius)

    found = positions(tmp_path, edited(("naif_keywords",), {f"INS-131351_{key}": v for key, v in said.items()}))
    np.testing.assert_allclose(found, want.positions, rtol=0, atol=1e-6)


def moc(**changes: Any) -> dict[str, Any]:
    """As ALE's mgs_drivers have it of an image summed 8 x 8 (m0402852): the period of one line of the detector, the
    pixel pitch for coefficients, counting from 1.
    """
    isd = copy.deepcopy(ISD) | {
        "name_platform": "MARS GLOBAL SURVEYOR", "name_sensor": "MGS_MOC_NA", "naif_keywords": {"BODY_CODE": 499},
        "image_lines": 100, "image_samples": 256, "line_scan_rate": [[0.5, -0.4, 0.001]],
        "detector_sample_summing": 8, "detector_line_summing": 8, "starting_detector_sample": 1,
        "detector_center": {"line": 0.0, "sample": 1024.5},
        "optical_distortion": {"radial": {"coefficients": [0, 0.0131240578522949, 0.0131240578522949]}},
    }  # fmt: skip
    return isd | changes


def test_narrow_angle_of_ale_is_put_right(tmp_path: Path) -> None:
    """Line period times 8; ISIS, 1-based: detector sample 8 (s - 1) + 4.5 + FirstLineSample - 1, centre 1024.5."""
    image = read(tmp_path, moc())
    assert image.timing.periods.tolist() == pytest.approx([0.008])
    assert len(image.remarks) == 3
    place, _ = image.interior.focal_plane(np.array([0.5, 255.5]))
    np.testing.assert_allclose(place[:, 1] * 76.9e3, [4.5 - 1024.5, 255.0 * 8.0 + 4.5 - 1024.5], rtol=1e-12)


def test_milliseconds_too(tmp_path: Path) -> None:
    assert read(tmp_path, moc(line_scan_rate=[[0.5, -0.4, 1.0]])).timing.periods.tolist() == pytest.approx([0.008])


def test_a_right_line_period_is_left_alone(tmp_path: Path) -> None:
    assert read(tmp_path, moc(line_scan_rate=[[0.5, -0.4, 0.008]])).timing.periods.tolist() == [0.008]


def dense(first: float) -> dict[str, Any]:
    times = (first + np.linspace(0.0, 0.8, 101)).tolist()
    return ISD["instrument_pointing"] | {"ephemeris_times": times, "quaternions": [[0.0, 1.0, 0.0, 0.0]] * 101}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"instrument_pointing": dense(100.6)}, "attitudes of the C-kernel at the lines' own times"),
        ({"instrument_pointing": dense(101.75)}, "1.15 s after the first line"),
        (
            {"name_sensor": "MGS_MOC_WA_RED", "optical_distortion": {"radial": {"coefficients": [0, -0.007, 0.007]}}},
            "pixel sizes",
        ),
        ({"optical_distortion": {"radial": {"coefficients": [0, "0.013", "0.013"]}}}, "pixel sizes"),
    ],
)
def test_what_ale_leaves_unknown_of_moc_is_refused(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        read(tmp_path, moc(**changes))
    assert "kernels" in str(caught.value)


def test_times_of_lroc_are_corrected_as_its_labels_are(tmp_path: Path) -> None:
    """ISIS LroNarrowAngleCamera: 1,024 lines and an offset after the label's time, each line 0.45 % longer."""
    names = {
        "CONSTANT_TIME_OFFSET": 0.01, "ADDITIONAL_PREROLL": 1024, "ADDITIVE_LINE_ERROR": 0,
        "MULTIPLI_LINE_ERROR": 0.0045, "LIGHTTIME_CORRECTION": "NONE",
    }  # fmt: skip
    period = 0.001 * 1.0045
    isd = edited(("naif_keywords",), {f"INS-85600_{name}": value for name, value in names.items()})
    isd["line_scan_rate"] = [[0.5, -1.0 - 0.01 - 1024 * period, 0.001]]
    isd["image_lines"] = 900
    image = read(tmp_path, isd)
    np.testing.assert_allclose([*image.timing.start_times, *image.timing.periods], [-1.0, period], rtol=0, atol=1e-12)
    assert len(image.remarks) == 1


def test_summed_lines_of_ctx_take_two_line_times(tmp_path: Path) -> None:
    """As ISIS CTXCamera has it; tables that end with the single ones are those of half the image."""
    isd = edited(("naif_keywords",), {"INS-74021_LIGHTTIME_CORRECTION": "NONE"})
    isd |= {"name_sensor": "CONTEXT CAMERA", "detector_sample_summing": 2, "image_lines": 500}
    image = read(tmp_path, isd | {"line_scan_rate": [[0.5, -0.9, 1.877e-3]]})
    assert (image.timing.periods.tolist(), len(image.remarks)) == ([3.754e-3], 1)
    assert read(tmp_path, isd | {"line_scan_rate": [[0.5, -0.9, 3.754e-3]]}).remarks == ()
    with pytest.raises(InputError, match=r"lines of 0.001877 s, summed 2; expected 0.003754 s"):
        read(tmp_path, isd | {"line_scan_rate": [[0.5, -0.9, 1.877e-3]], "image_lines": 800})


METRES = {"positions": [[3796e3, 0.0, 3e3], [3796e3, 0.0, 0.0], [3796e3, 0.0, -3e3]], "velocities": [[0, 0, -3e3]] * 3}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"instrument_position": ISD["instrument_position"] | METRES}, "a camera that moves at 3000 km/s"),
        (
            {"radii": {"semimajor": 3396.19, "semiminor": 3376.2, "unit": "m"},
             "naif_keywords": ISD["naif_keywords"] | {"BODY499_RADII": [3396.19, 3396.19, 3376.2]}},
            "radii.semimajor: 3.39619 km, where BODY499_RADII says 3396.19 km",
        ),
    ],
)  # fmt: skip
def test_metres_for_kilometres_are_named(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        read(tmp_path, ISD | changes)


def test_what_nobody_doubts_goes_unremarked(tmp_path: Path) -> None:
    geometric_ones = edited(("naif_keywords",), {"INS-94031_LIGHTTIME_CORRECTION": "NONE"})
    assert read(tmp_path, geometric_ones).remarks == ()


def test_each_camera_of_cubes_is_of_a_spacecraft_that_is_known() -> None:
    assert all(spacecraft_of(camera.spacecraft) is not None for camera in CAMERAS)
