"""HRSC's lines without kernels, against the kernel that they are taken from."""

import re
from pathlib import Path

import numpy as np
import pytest
from mex import FOLDER
from outside import require

from mgsgraph.errors import InputError
from mgsgraph.simulation.camera import HRSC_LINES, hrsc_interior
from mgsgraph.units import MM


def test_lines_are_the_addendum_s(shared_data: Path) -> None:
    """Affine maps from mm to pixels and focal lengths as ISIS has them; the published ones have four decimals."""
    kernel = require(shared_data / FOLDER / "hrscAddendum004.ti", "ISIS' addendum for HRSC")
    text = kernel.read_text(encoding="ascii")

    def numbers(code: int, key: str) -> np.ndarray:
        (found,) = re.findall(rf"INS-{code}_{key}\s*=\s*\(?([^)\n]*)", text)
        return np.array(found.replace(",", " ").split(), dtype=np.float64)

    codes = {"S2": 41211, "RED": 41212, "P2": 41213, "BLUE": 41214, "ND": 41215}
    codes |= {"GREEN": 41216, "P1": 41217, "IR": 41218, "S1": 41219}
    assert codes.keys() == HRSC_LINES.keys()
    for name, code in codes.items():
        found = hrsc_interior(name)
        want = np.stack([numbers(code, "ITRANSL"), numbers(code, "ITRANSS")])
        np.testing.assert_allclose(found.to_pixel[:, 0], want[:, 0], rtol=0, atol=1e-3)
        np.testing.assert_allclose(found.to_pixel[:, 1:] * MM, want[:, 1:], rtol=0, atol=1e-5)
        assert found.focal_length / MM == pytest.approx(numbers(code, "FOCAL_LENGTH")[0])
        assert found.centre.tolist() == [0.0, numbers(code, "BORESIGHT_SAMPLE")[0] - 0.5]


def test_macropixels_are_the_same_places() -> None:
    fine, _ = hrsc_interior("S1").focal_plane(np.array([0.0, 1000.0, 5184.0]))
    coarse, _ = hrsc_interior("S1", 4).focal_plane(np.array([0.0, 250.0, 1296.0]))
    np.testing.assert_allclose(coarse, fine, atol=1e-15)


def test_an_unknown_line_is_refused() -> None:
    with pytest.raises(InputError, match="line 'XX'"):
        hrsc_interior("XX")
