"""Model states of usgscsm are where it sees the ground, and distortion models have its names, numbers and units."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import usgscsm
from outside import refuses
from usgscsm import HEAD, NODES, state

from mgsgraph.files.kinds import image_kind, image_name
from mgsgraph.files.support_data.isd_layout import (
    NUMBERS,
    distortion_of_state,
    distortion_of_support,
    state_optics,
    support_optics,
)
from mgsgraph.files.support_data.model_state import read_model_state
from mgsgraph.geometry import camera as models
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.results.archive import pack, unpack
from mgsgraph.units import MM

# --- model states


def read(folder: Path, content: dict[str, Any]) -> PushbroomImage:
    path = folder / "a.adjusted_state.json"
    path.write_text(f"{HEAD}\n{json.dumps(content, indent=1)}\n")
    return read_model_state(path, "A/1")


@pytest.mark.parametrize("changes", [
    {}, {"m_platformFlag": 0}, {"m_distortionType": 4, "m_opticalDistCoeffs": [1e-5]},
    {"m_intTimeLines": [1.0], "m_intTimeStartTimes": [-1.0], "m_intTimes": [1e-3]},
], ids=["plain", "four nodes", "LROC", "line 1"])  # fmt: skip
def test_it_is_where_usgscsm_sees_it(tmp_path: Path, changes: dict[str, Any]) -> None:
    content = state(**changes)
    image = read(tmp_path, content)

    assert usgscsm.largest_difference(image, content) < 1e-3
    back, _ = image.ground_to_image(image.image_to_ground(np.array([100.3]), np.array([7.1]))[0])
    np.testing.assert_allclose(back, [[100.3, 7.1]], atol=1e-6)


def test_a_path_with_corners_is_followed(tmp_path: Path) -> None:
    """jitter_solve moves single samples; then the polynomials that meet at a sample have other slopes there."""
    content = state()
    noise = np.random.default_rng(1).normal(size=3 * NODES)
    content["m_positions"] = (np.array(content["m_positions"]) + noise).tolist()

    assert usgscsm.largest_difference(read(tmp_path, content), content) < 1e-3


@pytest.mark.parametrize("file", ["csm-", pytest.param("jitter_solved_run-csm-", marks=pytest.mark.slow)])
def test_real_states_are_where_usgscsm_sees_them(shared_data: Path, file: str) -> None:
    """WorldView, before and after ASP's jitter_solve: focal plane in pixels, lines that are timed from 1."""
    path = shared_data / "usgscsm_states" / f"{file}104001001427B900.r100.adjusted_state.json"
    image = read_model_state(path, "WV")

    assert (image.lines, image.samples) == (294448, 42500)
    assert usgscsm.largest_difference(image, usgscsm.read_content(path)) < 1e-3


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
        ({"m_currentParameterValue": [0.0] * 15 + [1.0]}, "m_currentParameterValue"),
        ({"m_zDirection": -1.0}, "m_zDirection: -1"),
        ({"m_positions": [1.0] * 7}, "m_positions: 7 numbers"),
        ({"m_intTimes": [1e-3]}, "m_intTimeLines, m_intTimeStartTimes, m_intTimes: 2 and 2 and 1"),
        ({"m_nLines": 9000}, "first or last line"),
        ({"m_dtQuat": None}, "m_dtQuat"),
        # they were halved 16 times: of a real state, 4 GB and 200 s
        ({"m_positions": [1.0] * 3 + [1e20] + [1.0] * (3 * NODES - 4)}, "position 1, 1e[+]20 m"),
        ({"m_quaternions": [0.0] * (4 * NODES)}, r"\[0.0, 0.0, 0.0, 0.0\] at"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    refuses(rf"a\.adjusted_state\.json.*{said}", read, tmp_path, state(**changes))


# --- distortion in support data and model states


FOCAL = 0.5
RADIAL = models.RadialDistortion(1e-4, 3.0, 40.0)
KNOWN: list[models.Distortion] = [
    RADIAL,
    models.TransverseDistortion(
        (1e-5, 1.002, 1e-4, 0.02, -0.03, 0.01, 2.0, 1.0, -1.0, 3.0),
        (-2e-5, -2e-4, 0.998, 0.01, 0.02, 0.04, -1.0, 2.0, 3.0, 1.0),
    ),
    models.KaguyaDistortion((-9.6e-7, 9.8e-4, 8.6e-3, -3.7), (-1.4e-6, 1.4e-5, 2.7e-3, -6.2)),
    models.DawnDistortion(8.4),
    models.LrocNacDistortion(18.1),
    models.CahvorDistortion(RADIAL, 3e-4, -2e-3),
    models.RadtanDistortion(-0.05, 0.02, 1e-3, -2e-3, 0.01, FOCAL),
    models.ShadowCamDistortion(-17.41),
]
EACH = pytest.mark.parametrize("optics", KNOWN, ids=lambda optics: type(optics).__name__)
PLACES = np.stack([np.linspace(-0.3e-3, 0.4e-3, 9), np.linspace(-17e-3, 17e-3, 9)], axis=1)


def assert_same(one: models.Distortion, other: models.Distortion) -> None:
    assert type(one) is type(other)
    np.testing.assert_allclose(one.undistort(PLACES)[0], other.undistort(PLACES)[0], rtol=0, atol=1e-15)


@EACH
def test_there_and_back(optics: models.Distortion) -> None:
    name, coefficients = state_optics(optics, "image")

    assert_same(distortion_of_state(NUMBERS[name], coefficients, FOCAL, "state"), optics)
    assert_same(distortion_of_support(support_optics(optics, "image"), FOCAL, "isd"), optics)


@EACH
def test_usgscsm_applies_what_is_taken_off(optics: models.Distortion) -> None:
    """Its applyDistortion, in mm, is in `usgscsm.py`, which shares nothing with us."""
    name, coefficients = state_optics(optics, "image")
    state = {"m_distortionType": NUMBERS[name], "m_opticalDistCoeffs": coefficients, "m_focalLength": FOCAL / MM}

    bent = np.column_stack(usgscsm.distort(state, *optics.undistort(PLACES)[0].T / MM))
    np.testing.assert_allclose(bent, PLACES / MM, rtol=0, atol=1e-9)


def test_all_that_usgscsm_knows_are_tried() -> None:
    assert {state_optics(optics, "image")[0] for optics in KNOWN} == set(NUMBERS)


def test_kaguya_as_ale_writes_it() -> None:
    """ale/drivers/selene_drivers.py: mm, the boresight apart."""
    said = {"x": [1e-3, 2e-3], "y": [0.0, 0.0, 3e-3, 4e-4], "boresight_x": -0.5, "boresight_y": 0.25}
    ideal, _ = distortion_of_support({"kaguyalism": said}, FOCAL, "isd").undistort(np.array([[3.0, 4.0]]) * MM)

    x, y = 3.0 + 1e-3 + 2e-3 * 5.0 - 0.5, 4.0 + 3e-3 * 25.0 + 4e-4 * 125.0 + 0.25
    np.testing.assert_allclose(ideal[0] / MM, [x, y], rtol=1e-14)


def test_types_of_no_line_scanner_are_refused() -> None:
    refuses(r"x\.json, m_distortionType", distortion_of_state, 6, [0.0], FOCAL, "x.json")


def test_themis_is_transverse() -> None:
    themis = models.ThemisIrDistortion(0.99426, 0.00447623, 1.07556)
    same = distortion_of_support(support_optics(themis, "image"), FOCAL, "isd")
    np.testing.assert_allclose(same.undistort(PLACES)[0], themis.undistort(PLACES)[0], rtol=0, atol=1e-15)


WIDE = models.MocWideAngleDistortion((1.0, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0, 0.01)


@pytest.mark.parametrize("optics", [WIDE, models.KaguyaMiDistortion((0.0,) * 4, (0.0,) * 4)])
def test_what_usgscsm_lacks_is_not_written(optics: models.Distortion) -> None:
    refuses(type(optics).__name__, support_optics, optics, "image")
