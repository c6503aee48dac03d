"""Sine and cosine without branches, against the C library's."""

import math

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numba import njit

from mgsgraph.factors import rotation

ANGLES = st.one_of(
    st.floats(-1e4, 1e4),
    st.floats(-1e-6, 1e-6),
    # about the quarters of a turn, where sine and cosine change places
    st.builds(lambda k, off: (0.25 * math.pi) * k + off, st.integers(-12_000, 12_000), st.floats(-1e-9, 1e-9)),
)


compiled = njit(rotation.sine_cosine, error_model="numpy")
"""As the kernel calls it."""


@settings(max_examples=200)
@given(angle=ANGLES)
@example(angle=0.0)
@example(angle=-0.0)
@example(angle=1e4)
def test_sine_and_cosine(angle: float) -> None:
    for sine, cosine in (rotation.sine_cosine(angle), compiled(angle)):
        assert abs(sine - math.sin(angle)) <= 4e-16
        assert abs(cosine - math.cos(angle)) <= 4e-16


@pytest.mark.parametrize("angle", [1e-9, 1e-5, 1e-3])
def test_small_sines_keep_their_digits(angle: float) -> None:
    """Rotation corrections are of microradians: the error is relative."""
    assert rotation.sine_cosine(angle)[0] == pytest.approx(math.sin(angle), rel=4e-16)
