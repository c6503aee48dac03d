"""Support data that are left unsaid, put right by their sensor, or can't be used: one line with file and key."""

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from outside import refuses
from support_data import IDENTITY, ISD, Keys, edited, read

from mgsgraph.errors import InputError
from mgsgraph.files.labels.aberration import SPACECRAFT, Aberration, geometric
from mgsgraph.geometry.plausibility import require_plausible

# --- what the sensor decides


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
    by_code = SILENT | {"naif_keywords": {f"INS{1000 * sensors.code - 98}_FOCAL_LENGTH": 3500.0}}
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

    isd = edited(("naif_keywords",), {f"INS-131351_{key}": v for key, v in said.items()})
    found = positions(tmp_path, isd | {"optical_distortion": {}})
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
    for period in (1.0, 0.008):  # milliseconds, and what is right
        found = read(tmp_path, moc(line_scan_rate=[[0.5, -0.4, period]]))
        assert found.timing.periods.tolist() == pytest.approx([0.008])
    place, _ = image.interior.focal_plane(np.array([0.5, 255.5]))
    np.testing.assert_allclose(place[:, 1] * 76.9e3, [4.5 - 1024.5, 255.0 * 8.0 + 4.5 - 1024.5], rtol=1e-12)


@pytest.mark.parametrize("centre", [1023.5, 1024.0, 1024.5])
def test_the_narrow_angles_centre_is_put_right_once(tmp_path: Path, centre: float) -> None:
    """ALE has CENTER of moc20.ti, the first pixel 0 there (1023.5); BORESIGHT_SAMPLE is ISIS's, from 1 on."""
    said = {"BODY_CODE": 499, "INS-94031_BORESIGHT_SAMPLE": 1024.5, "INS-94031_LIGHTTIME_CORRECTION": "NONE"}
    image = read(tmp_path, moc(detector_center={"line": 0.0, "sample": centre}, naif_keywords=said))
    assert image.interior.centre.tolist() == [0.0, 1024.0]
    assert image.interior.first.tolist() == [0.0, 0.0]
    with pytest.raises(InputError, match=r"detector_center\.sample: 1030; expected 1024\.5"):
        read(tmp_path, moc(detector_center={"line": 0.0, "sample": 1030.0}))


def dense(first: float) -> dict[str, Any]:
    times = (first + np.linspace(0.0, 0.8, 101)).tolist()
    return ISD["instrument_pointing"] | {"ephemeris_times": times, "quaternions": [[0.0, 1.0, 0.0, 0.0]] * 101}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"instrument_pointing": dense(100.6)}, "attitudes of the C-kernel at the lines' own times"),
        ({"instrument_pointing": dense(101.75)}, "1.15 s after the first line"),
        ({"name_sensor": "MGS_MOC_WA_RED", "optical_distortion": {"radial": {"coefficients": [0, -0.007, 0.007]}}},
         "pixel sizes"),
    ],
)  # fmt: skip
def test_what_ale_leaves_unknown_of_moc_is_refused(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    refuses(f"{said}.*kernels", read, tmp_path, moc(**changes))


KAGUYA = {"INS-131351_LIGHTTIME_CORRECTION": "NONE", "INS-131351_FOCAL_LENGTH": 3500.0}


def test_rates_of_kaguyas_kernels_are_said_to_be_wrong(tmp_path: Path) -> None:
    """ALE's own kaguyatc_isd.json has 0.0024, 0.0001, 0 rad/s where the attitudes turn about y by 0.0009 rad/s."""
    half = 0.5 * 0.0009 * np.arange(-1.0, 2.0)
    turned = [[0.0, float(np.cos(one)), 0.0, float(np.sin(one))] for one in half]
    table = ISD["instrument_pointing"] | {"quaternions": turned, "angular_velocities": [[0.0024, 1e-4, 0.0]] * 3}
    isd = ISD | {"naif_keywords": KAGUYA, "optical_distortion": {}}
    refuses(r"attitudes that turn by 0\.0009 rad/s", read, tmp_path, isd | {"instrument_pointing": table})
    image = read(tmp_path, isd | {"instrument_pointing": table | {"time_dependent_frames": [-131000, 1]}})
    assert any("Kaguya's C-kernels have wrong" in remark for remark in image.remarks)


def test_the_multiband_imager_bends_by_the_signed_place(tmp_path: Path) -> None:
    """ISIS KaguyaMiCameraDistortionMap: y + B + b0 + b1 y + b2 y^2, whichever the sign of y; in mm. TC takes |y|."""
    model = {"x": [0.0, 2e-3, 0.0], "y": [1e-3, 2e-3, 3e-6], "boresight_x": 0.0, "boresight_y": 0.02}
    place = np.array([[0.0, -5e-3]])
    for code, y in ((-131332, -5.0), (-131351, 5.0)):
        said = {f"INS{code}_LIGHTTIME_CORRECTION": "NONE"}
        image = read(tmp_path, ISD | {"naif_keywords": said, "optical_distortion": {"kaguyalism": model}})
        ideal, _ = image.interior.distortion.undistort(place)
        np.testing.assert_allclose(ideal[0, 1] * 1e3, -5.0 + 0.02 + 1e-3 + 2e-3 * y + 3e-6 * 25.0, rtol=1e-12)
        assert any("of MI" in remark for remark in image.remarks) == (code == -131332)


def themis(**changes: Any) -> dict[str, Any]:
    """As ALE's ody_drivers have it of band 9 with time delay integration."""
    said = {"INS-53031_ITRANSL": [0.0, 0.0, 20.0], "INS-53031_LIGHTTIME_CORRECTION": "NONE"}
    return ISD | {
        "name_sensor": "MARS_ODYSSEY", "naif_keywords": said, "focal_length_model": {"focal_length": 202.059},
        "optical_distortion": {"radial": {"coefficients": [0.0, 0.0, 0.0]}}, "focal2pixel_lines": [0.0, 0.0, 20.0],
        "focal2pixel_samples": [0.0, 20.0, 0.0], "image_samples": 320, "starting_detector_line": 120 - 205.5 + 0.025,
        "detector_center": {"line": 0.0, "sample": 160.045},
    } | changes  # fmt: skip


def test_themis_of_ale_is_put_right_or_refused(tmp_path: Path) -> None:
    """ISIS ThemisIrCamera and its distortion map: 203.9213 mm, x = x_d / 0.988653 and y (1 + a1) + a2 y^2 = y_d; the
    line 120.5 - 205.5 + 0.025 half a line earlier.
    """
    image = read(tmp_path, themis())
    ideal, _ = image.interior.distortion.undistort(np.array([[3e-3, -4e-3]]))
    x, y = (ideal[0] * 1e3).tolist()
    assert x == pytest.approx(3.0 / 0.988653, rel=1e-12)
    assert 1.00447623 * y + 0.00107556 * y * y == pytest.approx(-4.0, rel=1e-12)
    assert image.interior.focal_length == pytest.approx(0.2039213)
    assert image.interior.first[0] == pytest.approx(-84.975)
    assert image.timing.start_times[0] == pytest.approx(ISD["line_scan_rate"][0][1] - 0.0005)
    assert any("203.9213 mm" in remark for remark in image.remarks)
    with pytest.raises(InputError, match=r"line 112; expected that of a band of THEMIS-IR; read its cube"):
        read(tmp_path, themis(starting_detector_line=112))


def test_times_of_lroc_are_corrected_as_its_labels_are(tmp_path: Path) -> None:
    """ISIS LroNarrowAngleCamera: 1,024 lines and an offset after the label's time, each line 0.45 % longer."""
    names = {
        "CONSTANT_TIME_OFFSET": 0.01, "ADDITIONAL_PREROLL": 1024, "ADDITIVE_LINE_ERROR": 0,
        "MULTIPLI_LINE_ERROR": 0.0045, "LIGHTTIME_CORRECTION": "NONE",
    }  # fmt: skip
    period = 0.001 * 1.0045
    isd = edited(("naif_keywords",), {f"INS-85600_{name}": value for name, value in names.items()})
    isd["optical_distortion"] = {}
    isd["line_scan_rate"] = [[0.5, -1.0 - 0.01 - 1024 * period, 0.001]]
    isd["image_lines"] = 900
    image = read(tmp_path, isd)
    np.testing.assert_allclose([*image.timing.start_times, *image.timing.periods], [-1.0, period], rtol=0, atol=1e-12)
    assert len(image.remarks) == 1


def test_summed_lines_of_ctx_take_two_line_times(tmp_path: Path) -> None:
    """As ISIS CTXCamera has it; tables that end with the single ones are those of half the image."""
    isd = edited(("naif_keywords",), {"INS-74021_LIGHTTIME_CORRECTION": "NONE"})
    isd |= {"name_sensor": "CONTEXT CAMERA", "detector_sample_summing": 2, "image_lines": 500}
    image = read(tmp_path, isd | {"line_scan_rate": [[0.5, -0.9385, 1.877e-3]]})
    assert (image.timing.periods.tolist(), len(image.remarks)) == ([3.754e-3], 1)
    assert read(tmp_path, isd | {"line_scan_rate": [[0.5, -0.9385, 3.754e-3]]}).remarks == ()
    with pytest.raises(InputError, match=r"lines of 0.001877 s, summed 2; expected 0.003754 s"):
        read(tmp_path, isd | {"line_scan_rate": [[0.5, -0.9385, 1.877e-3]], "image_lines": 800})


def test_metres_for_kilometres_are_named(tmp_path: Path) -> None:
    table = ISD["instrument_position"]
    metres = {key: (1e3 * np.array(table[key])).tolist() for key in ("positions", "velocities")}
    refuses("a camera that moves at 3000 km/s", read, tmp_path, ISD | {"instrument_position": table | metres})


def test_what_nobody_doubts_goes_unremarked(tmp_path: Path) -> None:
    geometric_ones = edited(("naif_keywords",), {"INS-94031_LIGHTTIME_CORRECTION": "NONE"})
    assert read(tmp_path, geometric_ones).remarks == ()


# --- what is wrong


def assert_refused(folder: Path, isd: object) -> str:
    with pytest.raises(InputError) as caught:
        read(folder, isd)
    message = str(caught.value)
    assert message.startswith(str(folder / "image.isd")), message
    assert "\n" not in message
    return message


def places(value: object, keys: Keys = ()) -> list[Keys]:
    """All keys of nested objects; lists count as one."""
    if not isinstance(value, dict):
        return [keys]
    return [keys] * bool(keys) + [place for key, inner in value.items() for place in places(inner, (*keys, key))]


OPTIONAL: set[Keys] = {
    ("radii", "unit"),  # kilometres, as ALE writes
    ("naif_keywords", "INS-94031_LIGHTTIME_CORRECTION"),  # that of MGS
    ("naif_keywords", "INS-94031_SWAP_OBSERVER_TARGET"),  # not swapped, as ISIS SpicePosition takes it
    ("optical_distortion", "radial"),
    ("sun_position", "positions"),  # only its velocity is needed
} | {(part, "constant_rotation") for part in ("instrument_pointing", "body_rotation")} | {
    (part, "reference_frame") for part in ("instrument_position", "instrument_pointing", "body_rotation")
}


def test_the_untouched_file_reads(tmp_path: Path) -> None:
    image = read(tmp_path, ISD)

    assert (image.lines, image.samples) == (1000, 512)
    assert image.interior.focal_length == pytest.approx(3.5)
    assert image.body.equatorial == pytest.approx(3396190.0)
    assert image.trajectory.epoch == 101.0


@pytest.mark.parametrize("keys", [keys for keys in places(ISD) if keys not in OPTIONAL], ids=str)
def test_what_is_missing_is_named(tmp_path: Path, keys: Keys) -> None:
    message = assert_refused(tmp_path, edited(keys, ...))

    assert any(str(key) in message for key in keys) or "LIGHTTIME_CORRECTION" in message


@pytest.mark.parametrize("keys", [k for k in places(ISD) if k[0] not in ("naif_keywords", "sun_position")], ids=str)
def test_what_is_of_the_wrong_kind_is_named(tmp_path: Path, keys: Keys) -> None:
    for value in (None, True, {"a": 1}):
        assert str(keys[0]) in assert_refused(tmp_path, edited(keys, value))
    assert_refused(tmp_path, edited(keys, float("nan")))


@pytest.mark.parametrize(
    ("keys", "value", "said"),
    [
        (("name_model",), "USGS_ASTRO_FRAME_SENSOR_MODEL", "a frame camera; expected USGS_ASTRO_LINE_SCANNER"),
        (("name_model",), "USGS_ASTRO_PUSH_FRAME_SENSOR_MODEL", "a push-frame camera; expected USGS_ASTRO_LINE"),
        (("name_model",), "USGS_ASTRO_SAR_SENSOR_MODEL", "radar; expected USGS_ASTRO_LINE_SCANNER"),
        (("image_lines",), 0.5, "image_lines: 0.5;"),
        (("radii", "unit"), "mi", "expected one of 'km', 'm'"),
        (("line_scan_rate", 0, 2), -0.001, "expected positive line periods"),
        (("optical_distortion",), {"fisheye": {}}, "the model 'fisheye'"),
        (("optical_distortion", "lrolrocnac"), {"coefficients": [0]}, "2 models: radial, lrolrocnac; expected one"),
        (("instrument_position", "ephemeris_times"), [100.0, 102.0, 101.0], "increasing times"),
        (("instrument_position", "positions"), [[3796.0, 0.0, 3.0]] * 2, "expected shape (3, 3)"),
        (("instrument_pointing", "quaternions"), [[0.0, 2.0, 0.0, 0.0]] * 3, "unit quaternions"),
        (("instrument_pointing", "constant_rotation"), [-1.0, *IDENTITY[1:]], "no rotation"),
        (("instrument_position", "reference_frame"), 17, "reference_frame: 17; expected 1 (J2000)"),
        (("naif_keywords", "INS-94031_LIGHTTIME_CORRECTION"), "LT", "expected 'NONE' or 'LT+S'"),
        (("naif_keywords", "INS-1_LIGHTTIME_CORRECTION"), "NONE", "keywords of several instruments that differ"),
        (("sun_position", "velocities"), ..., "the Sun's velocity"),
        (("detector_line_suming",), 1, "did you mean 'detector_line_summing'?"),
        (("radii", "units"), "km", "did you mean 'unit'?"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, keys: Keys, value: object, said: str) -> None:
    """A default would take the place of a key with a slip in it."""
    isd = edited(("radii", "unit"), ...) if keys[-1] == "units" else ISD
    assert said in assert_refused(tmp_path, edited(keys, value, isd))


def test_nobody_says_whether_positions_are_geometric(tmp_path: Path) -> None:
    silent = edited(("naif_keywords",), ...)

    assert "set aberration" in assert_refused(tmp_path, silent)
    np.testing.assert_array_equal(
        read(tmp_path, silent, Aberration("NONE")).trajectory.position.positions,
        1e3 * np.array(ISD["instrument_position"]["positions"]),
    )


def test_the_older_layout_is_named_with_its_remedy(tmp_path: Path) -> None:
    older = {key: value for key, value in ISD.items() if not key.startswith("instrument_")} | {"sensor_position": {}}

    assert "isd_generate" in assert_refused(tmp_path, older)


def test_an_image_that_outlasts_its_tables_is_refused(tmp_path: Path) -> None:
    refuses(r"image M00/00001, first or last line: time 102\.500000 s", read, tmp_path, edited(("image_lines",), 2000))


KEYWORDS = ISD["naif_keywords"] | {
    "BODY_CODE": 499, "BODY499_RADII": [3396.19, 3396.19, 3376.2], "INS-94031_FOCAL_LENGTH": 3500.0,
    "INS-94031_PIXEL_SAMPLES": 512,
}  # fmt: skip


def test_a_calibration_may_differ_from_the_keywords(tmp_path: Path) -> None:
    read(tmp_path, ISD | {"naif_keywords": KEYWORDS})
    read(tmp_path, ISD | {"naif_keywords": KEYWORDS, "focal_length_model": {"focal_length": 3502.0}})


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"radii": {"semimajor": 3390.0, "semiminor": 3376.2}}, "radii.semimajor: 3390 km"),
        ({"radii": ISD["radii"] | {"unit": "m"}}, "radii: radii of 3.39619 km on the equator"),
        ({"naif_keywords": KEYWORDS | {"BODY_CODE": 301}}, "those of MOON"),
        ({"focal_length_model": {"focal_length": 3400.0}}, "focal_length_model: 3400 mm"),
        ({"detector_sample_summing": 2}, "detector_sample_summing: 512 samples of 2 pixels"),
    ],
)
def test_what_contradicts_the_keywords_is_named(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    assert said in assert_refused(tmp_path, ISD | {"naif_keywords": KEYWORDS} | changes)


def test_radii_of_no_body_are_refused(tmp_path: Path) -> None:
    """Without a keyword that tells; those too small for it by where the camera is, when the case reads the image."""
    for major, minor in ((3396190.0, 3376200.0), (3396.19, 3000.0), (3376.2, 3396.19)):
        assert "radii" in assert_refused(tmp_path, ISD | {"radii": {"semimajor": major, "semiminor": minor}})
    image = read(tmp_path, ISD | {"radii": {"semimajor": 3.39619, "semiminor": 3.3762}})
    refuses("from the body's centre", require_plausible, image, "image")
