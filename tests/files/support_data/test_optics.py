"""Names, numbers and units of distortion models in support data and model states, there and back."""

import numpy as np
import pytest
import usgscsm

from mgsgraph.errors import InputError
from mgsgraph.files.support_data.isd_layout import (
    NUMBERS,
    distortion_of_state,
    distortion_of_support,
    state_optics,
    support_optics,
)
from mgsgraph.geometry import camera as models
from mgsgraph.units import MM

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


@pytest.mark.parametrize("number", [6, 9, 10])
def test_types_of_no_line_scanner_are_refused(number: int) -> None:
    with pytest.raises(InputError, match=r"x\.json, m_distortionType"):
        distortion_of_state(number, [0.0], FOCAL, "x.json")


def test_themis_is_transverse() -> None:
    themis = models.ThemisIrDistortion(0.99426, 0.00447623, 1.07556)
    same = distortion_of_support(support_optics(themis, "image"), FOCAL, "isd")
    np.testing.assert_allclose(same.undistort(PLACES)[0], themis.undistort(PLACES)[0], rtol=0, atol=1e-15)


WIDE = models.MocWideAngleDistortion((1.0, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0, 0.01)


@pytest.mark.parametrize("optics", [WIDE, models.KaguyaMiDistortion((0.0,) * 4, (0.0,) * 4)])
def test_what_usgscsm_lacks_is_not_written(optics: models.Distortion) -> None:
    with pytest.raises(InputError, match=type(optics).__name__):
        support_optics(optics, "image")
