"""Model states of usgscsm are where usgscsm itself sees the ground; what it would do beside its tables is refused."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import usgscsm

from mgsgraph.errors import InputError
from mgsgraph.files.kinds import image_kind, image_name
from mgsgraph.files.support_data.model_state import read_model_state
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.results.archive import pack, unpack

HEAD = "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL"
NODES = 40


def state(**changes: Any) -> dict[str, Any]:
    """400 km above a sphere of 3,400 km, 3.4 km/s along the equator, swaying; the line period changes, with a pause."""
    times = 0.25 * np.arange(NODES) - 5.0
    angle = 3400.0 / 3.8e6 * times + 1e-5 * np.sin(2.0 * times)
    positions = 3.8e6 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    # camera z down, x along the flight, swaying about it; scalar last, camera to body
    half = 0.5 * (angle + np.pi) + 1e-4 * np.sin(3.0 * times)
    turn = np.stack([0.0 * half, 0.0 * half, np.sin(half), np.cos(half)], axis=1)  # about the body's z
    onto = np.array([0.5, 0.5, 0.5, 0.5])  # z to x, x to y, y to z
    return {
        "m_modelName": HEAD, "m_imageIdentifier": "A/1", "m_nLines": 2000, "m_nSamples": 500, "m_platformFlag": 1,
        "m_zDirection": 1.0, "m_focalLength": 3500.0, "m_distortionType": 0, "m_opticalDistCoeffs": [1e-4, 1e-6, 0.0],
        "m_iTransS": [0.0, 0.0, 80.0], "m_iTransL": [0.5, 80.0, 0.0], "m_detectorSampleOrigin": 250.0,
        "m_detectorLineOrigin": 0.0, "m_detectorSampleSumming": 2.0, "m_detectorLineSumming": 2.0,
        "m_startingDetectorSample": -7.0, "m_startingDetectorLine": 0.0, "m_centerEphemerisTime": 1e8,
        "m_intTimeLines": [0.0, 1200.0], "m_intTimeStartTimes": [-1.0, 0.21], "m_intTimes": [1e-3, 1.1e-3],
        "m_t0Ephem": -5.0, "m_dtEphem": 0.25, "m_numPositions": 3 * NODES, "m_positions": positions.ravel().tolist(),
        "m_t0Quat": -5.0, "m_dtQuat": 0.25, "m_numQuaternions": 4 * NODES,
        "m_quaternions": product(turn, onto).ravel().tolist(),
        "m_majorAxis": 3.4e6, "m_minorAxis": 3.4e6, "m_currentParameterValue": [0.0] * 16,
    } | changes  # fmt: skip


def product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Hamilton's product of quaternions (n, 4) and (4,), scalar last."""
    a, w = left[:, :3], left[:, 3:]
    return np.hstack([w * right[:3] + right[3] * a + np.cross(a, right[:3]), w * right[3] - a @ right[:3, None]])


def read(folder: Path, content: dict[str, Any]) -> PushbroomImage:
    path = folder / "a.adjusted_state.json"
    path.write_text(f"{HEAD}\n{json.dumps(content, indent=1)}\n")
    return read_model_state(path, "A/1")


def apart(image: PushbroomImage, content: dict[str, Any]) -> float:
    """Pixels between 25 places and where usgscsm sees their ground points."""
    lines, samples = np.meshgrid(np.linspace(0.5, image.lines - 0.5, 5), np.linspace(0.5, image.samples - 0.5, 5))
    places = np.column_stack([lines.ravel(), samples.ravel()])
    ground, _ = image.image_to_ground(*places.T)
    return float(np.abs(usgscsm.ground_to_image(content, ground) - places).max())


@pytest.mark.parametrize("changes", [
    {}, {"m_platformFlag": 0}, {"m_distortionType": 4, "m_opticalDistCoeffs": [1e-5]},
    {"m_intTimeLines": [1.0], "m_intTimeStartTimes": [-1.0], "m_intTimes": [1e-3]},
], ids=["plain", "four nodes", "LROC", "line 1"])  # fmt: skip
def test_it_is_where_usgscsm_sees_it(tmp_path: Path, changes: dict[str, Any]) -> None:
    content = state(**changes)
    image = read(tmp_path, content)

    assert apart(image, content) < 1e-3
    back, _ = image.ground_to_image(image.image_to_ground(np.array([100.3]), np.array([7.1]))[0])
    np.testing.assert_allclose(back, [[100.3, 7.1]], atol=1e-6)


def test_a_path_with_corners_is_followed(tmp_path: Path) -> None:
    """jitter_solve moves single samples; then the polynomials that meet at a sample have other slopes there."""
    content = state()
    noise = np.random.default_rng(1).normal(size=3 * NODES)
    content["m_positions"] = (np.array(content["m_positions"]) + noise).tolist()

    assert apart(read(tmp_path, content), content) < 1e-3


@pytest.mark.parametrize("file", ["csm-", pytest.param("jitter_solved_run-csm-", marks=pytest.mark.slow)])
def test_real_states_are_where_usgscsm_sees_them(shared_data: Path, file: str) -> None:
    """WorldView, before and after ASP's jitter_solve: focal plane in pixels, lines that are timed from 1."""
    path = shared_data / "usgscsm_states" / f"{file}104001001427B900.r100.adjusted_state.json"
    image = read_model_state(path, "WV")

    assert (image.lines, image.samples) == (294448, 42500)
    assert apart(image, usgscsm.read_content(path)) < 1e-3


def test_its_kind_and_name(tmp_path: Path) -> None:
    read(tmp_path, state())
    bare = tmp_path / "bare.json"
    bare.write_text(json.dumps(state()))
    for path in (tmp_path / "a.adjusted_state.json", bare):
        assert image_kind(path) == "state"
        assert image_name(path, "state") == "A/1"


def test_it_comes_back_from_an_archive(tmp_path: Path) -> None:
    image = read(tmp_path, state())
    back = unpack(pack(image), PushbroomImage, "image")

    lines = np.linspace(0.0, 2000.0, 7)
    np.testing.assert_array_equal(back.pose(lines).matrix, image.pose(lines).matrix)
    assert back.trajectory.spin is None


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"m_modelName": "USGS_ASTRO_FRAME_SENSOR_MODEL"}, r"m_modelName: 'USGS_ASTRO_FRAME"),
        ({"m_currentParameterValue": [0.0] * 15 + [1.0]}, "m_currentParameterValue"),
        ({"m_zDirection": -1.0}, "m_zDirection: -1"),
        ({"m_distortionType": 6}, "m_distortionType: the type 6, of a framing camera"),
        ({"m_opticalDistCoeffs": [0.0]}, "m_opticalDistCoeffs"),
        ({"m_positions": [1.0] * 7}, "m_positions: 7 numbers"),
        ({"m_intTimes": [1e-3]}, "m_intTimeLines, m_intTimeStartTimes, m_intTimes: 2 and 2 and 1"),
        ({"m_nLines": 9000}, "first or last line"),
        ({"m_focalLength": 0.0}, "m_focalLength"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        read(tmp_path, state(**changes))
    assert str(caught.value).startswith(str(tmp_path / "a.adjusted_state.json"))


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    content = state()
    del content["m_dtQuat"]
    with pytest.raises(InputError, match="m_dtQuat"):
        read(tmp_path, content)


@pytest.mark.parametrize(
    ("key", "place", "value", "said"),
    [("m_positions", 3, 1e20, "position 1, 1e+20 m"), ("m_positions", slice(0, 3), [0.0] * 3, "position 0, 0 m"),
     ("m_quaternions", slice(4, 8), [0.0] * 4, "[0.0, 0.0, 0.0, 0.0] at [1]"),
     ("m_quaternions", 5, 1e200, "at [1]")],
)  # fmt: skip
def test_samples_that_cant_be_are_refused_at_once(
    tmp_path: Path, key: str, place: Any, value: Any, said: str
) -> None:
    """They were halved 16 times: of a real state, 4 GB and 200 s."""
    content = state()
    content[key][place] = value
    path = tmp_path / "a.adjusted_state.json"
    path.write_text(f"{HEAD}\n{json.dumps(content)}")
    with pytest.raises(InputError) as caught:
        read_model_state(path, "a")
    assert said in str(caught.value)
