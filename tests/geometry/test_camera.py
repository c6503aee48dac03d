"""Interior orientation: ISIS's detector formulas by hand, slopes against differences."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import along

from mgsgraph.errors import InputError
from mgsgraph.geometry.camera import Distortion, InteriorOrientation, LrocNacDistortion, NoDistortion, RadialDistortion
from mgsgraph.units import MM

LROC = LrocNacDistortion(1.81e-5 / MM**2)
"""LROC-NAC left, ISIS instrument addendum."""
CTX = RadialDistortion(-0.0073433925920054505, 2.8375878636241697e-5 / MM**2, 1.2841989124027099e-8 / MM**4)
"""MRO CTX, ISIS instrument addendum."""
MODELS = pytest.mark.parametrize("distortion", [NoDistortion(), LROC, CTX], ids=lambda model: type(model).__name__)
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


@MODELS
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
        ({"sample_summing": -1.0}, "sample_summing: -1.0"),
        ({"to_pixel": np.array([[0.0, 1.0, 0.0], [0.0, 2.0, 0.0]])}, "a singular map; expected an invertible one"),
        ({"to_pixel": np.zeros((2, 2))}, r"shape \(2, 2\); expected shape \(2, 3\)"),
        ({"first": np.array([0.0, np.inf])}, r"first detector pixel: inf at \[1\]; expected finite numbers"),
    ],
)
def test_what_cannot_be_a_camera_is_refused(change: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        replace(NAC, **change)
