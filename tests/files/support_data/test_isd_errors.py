"""Image support data that can't be used: one line that names the file and the key, never a traceback."""

import json
from pathlib import Path

import numpy as np
import pytest
from support_data import IDENTITY, ISD, Keys, edited, read

from mgsgraph.errors import InputError
from mgsgraph.files.labels.aberration import Aberration
from mgsgraph.geometry.plausibility import require_plausible


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


@pytest.mark.parametrize("value", [None, "x", True, {"a": 1}], ids=repr)
@pytest.mark.parametrize("keys", [k for k in places(ISD) if k[0] not in ("naif_keywords", "sun_position")], ids=str)
def test_what_is_of_the_wrong_kind_is_named(tmp_path: Path, keys: Keys, value: object) -> None:
    message = assert_refused(tmp_path, edited(keys, value))

    assert str(keys[0]) in message


@pytest.mark.parametrize("constant", ["NaN", "1e999"])
@pytest.mark.parametrize("number", ["3500.0", "3396.19", "76.9", "0.001", "102.0", "-3.0", "1e-06"])
def test_numbers_that_are_not_finite_are_refused(tmp_path: Path, number: str, constant: str) -> None:
    text = json.dumps(ISD)
    assert number in text

    assert_refused(tmp_path, text.replace(number, constant, 1))


WRONG: dict[str, tuple[Keys, object, str]] = {
    "a frame camera": (("name_model",), "USGS_ASTRO_FRAME_SENSOR_MODEL", "expected USGS_ASTRO_LINE_SCANNER"),
    "half a line": (("image_lines",), 0.5, "image_lines: 0.5;"),
    "negative radius": (("radii", "semimajor"), -3396.19, "radii.semimajor"),
    "miles": (("radii", "unit"), "mi", "expected one of 'km', 'm'"),
    "summing of zero": (("detector_sample_summing",), 0, "detector_sample_summing"),
    "time runs back": (("line_scan_rate", 0, 2), -0.001, "expected positive line periods"),
    "short map": (("focal2pixel_lines",), [0.0, 76.9], "focal2pixel_lines"),
    "unknown optics": (("optical_distortion",), {"fisheye": {}}, "the model 'fisheye'"),
    "times in disorder": (("instrument_position", "ephemeris_times"), [100.0, 102.0, 101.0], "increasing times"),
    "a position short": (("instrument_position", "positions"), [[3796.0, 0.0, 3.0]] * 2, "expected shape (3, 3)"),
    "long quaternion": (("instrument_pointing", "quaternions"), [[0.0, 2.0, 0.0, 0.0]] * 3, "unit quaternions"),
    "mirror": (("instrument_pointing", "constant_rotation"), [-1.0, *IDENTITY[1:]], "no rotation"),
    "another frame": (("instrument_position", "reference_frame"), 17, "reference_frame: 17; expected 1 (J2000)"),
    "light time alone": (("naif_keywords", "INS-94031_LIGHTTIME_CORRECTION"), "LT", "expected 'NONE' or 'LT+S'"),
    "Sun without velocity": (("sun_position", "velocities"), ..., "the Sun's velocity"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_what_is_wrong_is_named(tmp_path: Path, fault: str) -> None:
    keys, value, said = WRONG[fault]

    assert said in assert_refused(tmp_path, edited(keys, value))


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
    with pytest.raises(InputError, match=r"image M00/00001, first or last line: time 102\.500000 s"):
        read(tmp_path, edited(("image_lines",), 2000))


@pytest.mark.parametrize("cut", np.linspace(0, len(json.dumps(ISD)) - 1, 20).astype(int).tolist())
def test_a_file_cut_short_is_refused(tmp_path: Path, cut: int) -> None:
    assert_refused(tmp_path, json.dumps(ISD)[:cut])


# ---- found by trying to break the reader ---------------------------------------------------------------------------


@pytest.mark.parametrize("value", [None, "x", 1, []], ids=repr)
def test_a_malformed_swap_is_refused(tmp_path: Path, value: object) -> None:
    assert_refused(tmp_path, edited(("naif_keywords", "INS-94031_SWAP_OBSERVER_TARGET"), value))


# --- what the file says twice

KEYWORDS = ISD["naif_keywords"] | {
    "BODY_CODE": 499, "BODY499_RADII": [3396.19, 3396.19, 3376.2], "INS-94031_FOCAL_LENGTH": 3500.0,
    "INS-94031_PIXEL_SAMPLES": 512,
}  # fmt: skip
CONTRADICTIONS: dict[str, tuple[dict[str, object], str]] = {
    "semimajor": ({"radii": {"semimajor": 3390.0, "semiminor": 3376.2}}, "radii.semimajor: 3390 km"),
    "another body": ({"naif_keywords": KEYWORDS | {"BODY_CODE": 301}}, "those of MOON"),
    "focal length": ({"focal_length_model": {"focal_length": 3400.0}}, "focal_length_model: 3400 mm"),
    "summing": ({"detector_sample_summing": 2}, "detector_sample_summing: 512 samples of 2 pixels"),
}


def test_a_calibration_may_differ_from_the_keywords(tmp_path: Path) -> None:
    read(tmp_path, ISD | {"naif_keywords": KEYWORDS})
    read(tmp_path, ISD | {"naif_keywords": KEYWORDS, "focal_length_model": {"focal_length": 3502.0}})


@pytest.mark.parametrize("what", CONTRADICTIONS)
def test_what_contradicts_the_keywords_is_named(tmp_path: Path, what: str) -> None:
    changes, said = CONTRADICTIONS[what]
    assert said in assert_refused(tmp_path, ISD | {"naif_keywords": KEYWORDS} | changes)


RADII = [(3396190.0, 3376200.0), (3.39619, 3.3762), (1e9, 1e9), (1e-9, 1e-9), (3300.0, 3290.0), (3396.19, 3000.0),
         (3376.2, 3396.19)]  # fmt: skip


@pytest.mark.parametrize("radii", RADII, ids=str)
def test_radii_of_no_body_are_refused(tmp_path: Path, radii: tuple[float, float]) -> None:
    """Without a keyword that tells; those too small for it by where the camera is, when the case reads the image."""
    isd = ISD | {"radii": dict(zip(("semimajor", "semiminor"), radii, strict=True))}
    if radii[0] < 1000.0:
        image = read(tmp_path, isd)
        with pytest.raises(InputError, match="from the body's centre"):
            require_plausible(image, "image")
        return
    assert "radii" in assert_refused(tmp_path, isd)
