"""Interior orientation: ISIS's detector formulas by hand, models of distortion by the published relation of ideal and
measured place in mm, slopes and Jacobians against differences.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from outside import refuses
from strategies import along, differences

from mgsgraph.geometry import camera as models
from mgsgraph.geometry.camera import Distortion, InteriorOrientation, LrocNacDistortion, NoDistortion, RadialDistortion
from mgsgraph.units import MM

LROC = LrocNacDistortion(1.81e-5 / MM**2)
"""LROC-NAC left, ISIS instrument addendum."""

CTX_OPTICS = RadialDistortion(-0.0073433925920054505, 2.8375878636241697e-5 / MM**2, 1.2841989124027099e-8 / MM**4)
"""MRO CTX, ISIS instrument addendum."""

CURVES = pytest.mark.parametrize("distortion", [NoDistortion(), LROC, CTX_OPTICS], ids=lambda one: type(one).__name__)

PITCH = 0.007 * MM

NAC = InteriorOrientation(
    0.69962, np.array([[0.0, 1.0 / PITCH, 0.0], [0.0, 0.0, 1.0 / PITCH]]), np.array([0.0, 2547.5]), np.zeros(2), 1.0,
    LROC,
)  # fmt: skip

samples = st.floats(0.0, 5064.0)


def test_lroc_samples_by_hand() -> None:
    """Sample 1000.5 is 1547 pixels of 7 um left of the boresight; the line array passes through it."""
    place, slope = NAC.focal_plane(np.array([1000.5, 2547.5]))

    y = -1547.0 * 7e-3
    np.testing.assert_allclose(place[0], [0.0, y / (1.0 + 1.81e-5 * y * y) * MM], rtol=1e-14)
    np.testing.assert_array_equal(place[1], [0.0, 0.0])
    np.testing.assert_allclose(slope[1], [0.0, 7e-6], rtol=1e-14)


@pytest.mark.parametrize("summing", [1, 2, 8])
@pytest.mark.parametrize("first_pixel", [1, 257])
@pytest.mark.parametrize("sample", [1.0, 77.25])
def test_summing_and_first_pixel_are_those_of_isis(sample: float, first_pixel: int, summing: int) -> None:
    """MOC-NA as ISIS CameraDetectorMap and CameraFocalPlaneMap have it, 1-based: y = p (d - 1024.5)."""
    pitch = 0.0131240578522949 * MM
    detector = (sample - 1.0) * summing + 0.5 * summing + 0.5 + (first_pixel - 1.0)
    moc = InteriorOrientation(
        3.5, np.array([[0.0, 1.0 / pitch, 0.0], [0.0, 0.0, 1.0 / pitch]]), np.array([0.0, 1024.5 - 0.5]),
        np.array([0.0, first_pixel - 1.0]), float(summing), NoDistortion(),
    )  # fmt: skip
    place, slope = moc.focal_plane(np.array([sample - 0.5]))

    np.testing.assert_allclose(place[0], [0.0, pitch * (detector - 1024.5)], atol=1e-16)
    np.testing.assert_allclose(slope[0], [0.0, pitch * summing], rtol=1e-14)


@CURVES
@given(sample=samples, tilt=st.floats(-0.1, 0.1), line=st.floats(-500.0, 500.0))
def test_slope_against_differences(distortion: Distortion, sample: float, tilt: float, line: float) -> None:
    """A detector line that is turned, off the principal point, behind optics that bend."""
    turned = np.array([[3.0, np.cos(tilt) / PITCH, np.sin(tilt) / PITCH], [-5.0, -np.sin(tilt) / PITCH, 1.0 / PITCH]])
    camera = InteriorOrientation(0.7, turned, np.array([line, 2547.5]), np.array([1.0, 2.0]), 2.0, distortion)
    _, slope = camera.focal_plane(np.array([sample]))

    want = along(lambda s: camera.focal_plane(np.array([sample + s]))[0][0], 10.0)
    np.testing.assert_allclose(slope[0], want, rtol=0, atol=1e-7 * PITCH)


@given(samples, st.floats(-0.1, 0.1))
def test_focal_plane_places_map_back_to_detector_pixels(sample: float, tilt: float) -> None:
    turned = NAC.to_pixel + np.array([[2.0, tilt, 7.0], [3.0, 5.0, tilt]])
    camera = replace(NAC, to_pixel=turned, distortion=NoDistortion())
    place, _ = camera.focal_plane(np.array([sample]))

    pixel = camera.centre + camera.to_pixel[:, 0] + camera.to_pixel[:, 1:] @ place[0]
    np.testing.assert_allclose(pixel, [0.0, sample], atol=1e-9)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"focal_length": 0.0}, "interior orientation, focal_length: 0.0; expected a positive number"),
        ({"to_pixel": np.array([[0.0, 1.0, 0.0], [0.0, 2.0, 0.0]])}, "a singular map; expected an invertible one"),
    ],
)
def test_what_cannot_be_a_camera_is_refused(change: dict[str, object], said: str) -> None:
    refuses(said, replace, NAC, **change)


# --- distortion


TC1_X, TC1_Y = (-9.6499e-4, 9.8441e-4, 8.5773e-6, -3.7438e-6), (-1.3796e-3, 1.3502e-5, 2.7251e-6, -6.1938e-6)
"""Kaguya TC1, SEL_TC_V01.TI; powers of mm."""

CTX = (-0.0073433925920054505, 2.8375878636241697e-5, 1.2841989124027099e-8)
"""ISIS instrument addendum."""

RED = (0.9993258, 0.4655529, -0.1548756, 1.827967, -3.057435, 2.226331)

RED_BACK = (0.9995458, -0.4237090, 0.2810857, -0.1697522, 0.068131536, -0.012665644)

BLUE = (1.000246, 0.4612695, 0.2352545, 0.3535922, -0.2853861, 0.5574971)
"""MOC wide angle, ISIS MocWideAngleDistortionMap."""

WIDE = 9.674
"""mm, about the focal length of MOC wide angle."""

BENT_X = (0.01, 1.002, 1e-4, 2e-5, -3e-5, 1e-5, 2e-6, 1e-6, -1e-6, 3e-6)

BENT_Y = (-0.02, -2e-4, 0.998, 1e-5, 2e-5, 4e-5, -1e-6, 2e-6, 3e-6, 1e-6)

TERMS = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3)]

RADTAN = (-0.05, 0.02, 1e-3, -2e-3, 0.01)
"""k1, k2, p1, p2, k3."""

Place = tuple[float, float]


class Model(NamedTuple):
    made: models.Distortion
    relation: Callable[[Place, Place], Place]
    """What is zero, mm, of the ideal and the measured place, mm: usgscsm's or ISIS's formula, one number at a time."""


def powers(coefficients: tuple[float, ...]) -> models.Four:
    a, b, c, d = coefficients
    return a * MM, b, c / MM, d / MM**2


def transverse(coefficients: tuple[float, ...], ideal: Place) -> float:
    return sum(c * ideal[0] ** i * ideal[1] ** j for c, (i, j) in zip(coefficients, TERMS, strict=True))


def kaguya(at: float, ideal: Place, measured: Place) -> Place:
    added = [sum(c * at**i for i, c in enumerate(own)) for own in (TC1_X, TC1_Y)]
    return measured[0] + added[0] - ideal[0], measured[1] + added[1] - ideal[1]


def scaled(share: float, ideal: Place, measured: Place) -> Place:
    return measured[0] * share - ideal[0], measured[1] * share - ideal[1]


def radial(ideal: Place, measured: Place) -> Place:
    square = measured[0] ** 2 + measured[1] ** 2
    return scaled(1.0 - (CTX[0] + square * (CTX[1] + square * CTX[2])), ideal, measured)


def wide_angle(coefficients: tuple[float, ...], scale: float, ideal: Place, measured: Place) -> Place:
    measured = measured[0], measured[1] / scale
    s = math.hypot(*measured)
    if s == 0.0:
        return ideal
    angle = math.atan(s / WIDE)
    sp = WIDE * math.tan(sum(c * angle ** (2 * i + 1) for i, c in enumerate(coefficients)))
    return scaled(sp / s, ideal, measured)


def radtan(ideal: Place, measured: Place) -> Place:
    x, y = ideal[0] / 500.0, ideal[1] / 500.0
    k1, k2, p1, p2, k3 = RADTAN
    r2 = x * x + y * y
    share = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    dx = x * share + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    dy = y * share + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return 500.0 * dx - measured[0], 500.0 * dy - measured[1]


def dawn(ideal: Place, measured: Place) -> Place:
    share = 1.0 + 8.4e-6 * (ideal[0] ** 2 + ideal[1] ** 2)
    return scaled(share, measured, ideal)


CTX_MADE = models.RadialDistortion(CTX[0], CTX[1] / MM**2, CTX[2] / MM**4)

MODELS = {
    "none": Model(models.NoDistortion(), lambda u, d: (u[0] - d[0], u[1] - d[1])),
    "lroc": Model(
        models.LrocNacDistortion(1.81e-5 / MM**2), lambda u, d: (u[0] - d[0], u[1] - d[1] / (1.0 + 1.81e-5 * d[1] ** 2))
    ),
    "shadowcam": Model(
        models.ShadowCamDistortion(1.9e-5 / MM**2),
        lambda u, d: (u[0] - d[0], u[1] - d[1] * (1.0 + 1.9e-5 * d[1] ** 2)),
    ),
    "radial": Model(CTX_MADE, radial),
    "cahvor": Model(
        models.CahvorDistortion(CTX_MADE, 0.3 * MM, -2.0 * MM),
        lambda u, d: radial((u[0] - 0.3, u[1] + 2.0), (d[0] - 0.3, d[1] + 2.0)),
    ),
    "kaguya tc": Model(
        models.KaguyaDistortion(powers(TC1_X), powers(TC1_Y)), lambda u, d: kaguya(math.hypot(*d), u, d)
    ),
    "kaguya mi": Model(models.KaguyaMiDistortion(powers(TC1_X), powers(TC1_Y)), lambda u, d: kaguya(d[1], u, d)),
    "moc red": Model(models.MocWideAngleDistortion(RED, 1.0, WIDE * MM), lambda u, d: wide_angle(RED, 1.0, u, d)),
    "moc blue": Model(
        models.MocWideAngleDistortion(BLUE, 1.000452, WIDE * MM), lambda u, d: wide_angle(BLUE, 1.000452, u, d)
    ),
    "themis": Model(
        models.ThemisIrDistortion(0.994260, 0.00447623, 0.00107556 / MM),
        lambda u, d: (u[0] * 0.994260 - d[0], u[1] + 0.00447623 * u[1] + 0.00107556 * u[1] ** 2 - d[1]),
    ),
    "transverse": Model(
        models.TransverseDistortion(
            tuple(c * MM ** (1 - i - j) for c, (i, j) in zip(BENT_X, TERMS, strict=True)),
            tuple(c * MM ** (1 - i - j) for c, (i, j) in zip(BENT_Y, TERMS, strict=True)),
        ),
        lambda u, d: (transverse(BENT_X, u) - d[0], transverse(BENT_Y, u) - d[1]),
    ),
    "dawn": Model(models.DawnDistortion(8.4e-6 / MM**2), dawn),
    "radtan": Model(models.RadtanDistortion(*RADTAN, 0.5), radtan),
}

EACH = pytest.mark.parametrize("name", MODELS)

BRIEFLY = settings(max_examples=30)

coordinates = st.one_of(st.floats(-7.0, 7.0), st.just(0.0))


@EACH
@BRIEFLY
@given(x=coordinates, y=coordinates)
def test_ideal_places_are_those_of_the_published_formula(name: str, x: float, y: float) -> None:
    model = MODELS[name]
    ideal, _ = model.made.undistort(np.array([[x, y]]) * MM)

    assert model.relation(tuple(ideal[0] / MM), (x, y)) == pytest.approx((0.0, 0.0), abs=1e-10)


@EACH
@BRIEFLY
@given(x=coordinates, y=coordinates)
def test_jacobians_against_differences(name: str, x: float, y: float) -> None:
    made, step = MODELS[name].made, 1e-3 * MM
    if name == "kaguya tc" and math.hypot(x, y) * MM < 3.0 * step:
        return  # the radius has a corner there
    place = np.array([x, y]) * MM
    _, jacobian = made.undistort(place[None])

    want = differences(lambda p: made.undistort(p[None])[0][0], place, step)
    np.testing.assert_allclose(jacobian[0], want, rtol=0, atol=1e-7)


def test_every_model_is_tried() -> None:
    assert {type(model.made) for model in MODELS.values()} == set(models.MODELS)


def test_wide_angle_comes_back_by_the_inverse_of_isis() -> None:
    """Its polynomials from ideal to measured angle are a fit, off by up to 0.1 pixel of 0.72 mrad."""
    measured = np.array([[0.0, y] for y in np.linspace(0.5, 9.0, 12)])
    ideal, _ = MODELS["moc red"].made.undistort(measured * MM)
    angle = np.arctan(ideal[:, 1] / MM / WIDE)
    back = sum(c * angle ** (2 * i + 1) for i, c in enumerate(RED_BACK))

    np.testing.assert_allclose(back, np.arctan(measured[:, 1] / WIDE), rtol=0, atol=7e-5)


def test_a_place_that_no_ray_reaches_has_none() -> None:
    beyond = np.array([[0.0, -300.0 * MM], [0.0, 1.0 * MM]])  # the root of THEMIS's parabola ends at -234.6 mm
    ideal, jacobian = MODELS["themis"].made.undistort(beyond)
    lost, bent = models.DawnDistortion(-1.0 / MM**2).undistort(beyond)

    assert np.isnan(ideal[0, 1])
    assert np.isnan(jacobian[0, 1, 1])
    assert np.isfinite(ideal[1]).all()
    assert np.isnan(lost[1]).all()
    assert np.isnan(bent[1]).all()
