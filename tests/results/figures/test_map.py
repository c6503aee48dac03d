"""The studio's map as a figure: ellipses and corrections have the size that they are said to have."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection
from matplotlib.quiver import Quiver

from mgsgraph.network import PointClass
from mgsgraph.results.figures.map import MapWindow, window_sheet

NORTH_POLE = np.array([0.0, 0.0, 3.38e6])


def window(n: int = 12) -> MapWindow:
    random = np.random.default_rng(4)
    places = random.uniform(-1e4, 1e4, (n, 2))
    covariances = np.tile(np.diag([9.0, 4.0]), (n, 1, 1))
    return MapWindow(
        "block", NORTH_POLE, np.array([-1e4, -1e4, 1e4, 1e4]), {"one": places[:4]}, places, np.arange(float(n)),
        ("3-D sigma", "m"), (0.0, float(n)), n, np.full(n, int(PointClass.TIE)), covariances,
        np.tile([3.0, -4.0], (n, 1)), None, 50.0,
    )  # fmt: skip


def test_ellipses_hold_95_percent() -> None:
    panel = window_sheet(window()).figure.axes[0]
    (ellipses,) = [one for one in panel.collections if isinstance(one, EllipseCollection)]
    assert np.allclose(ellipses.get_widths(), 2e-3 * 50.0 * 3.0 * np.sqrt(5.991465), rtol=1e-6)
    assert np.allclose(ellipses.get_heights(), 2e-3 * 50.0 * 2.0 * np.sqrt(5.991465), rtol=1e-6)
    drawn = np.random.default_rng(5).multivariate_normal([0.0, 0.0], [[9.0, 0.0], [0.0, 4.0]], 40_000)
    across, up = ellipses.get_widths()[0] / 0.1, ellipses.get_heights()[0] / 0.1
    assert np.mean((drawn[:, 0] / across) ** 2 + (drawn[:, 1] / up) ** 2 < 1.0) == pytest.approx(0.95, abs=0.005)


@pytest.mark.parametrize("factor", [50.0, 0.0])
def test_corrections_are_as_long_as_said(factor: float) -> None:
    sheet = window_sheet(replace(window(), factor=factor))
    (arrows,) = [one for one in sheet.figure.axes[0].collections if isinstance(one, Quiver)]
    said = arrows.U[0] / 3e-3
    assert np.allclose(arrows.V, -4e-3 * said)
    assert f"{said:g} times" in sheet.caption
    assert factor in (0.0, pytest.approx(said))


def test_too_many_ellipses_are_thinned_and_counted() -> None:
    sheet = window_sheet(window(1000))
    (ellipses,) = [one for one in sheet.figure.axes[0].collections if isinstance(one, EllipseCollection)]
    assert len(ellipses.get_widths()) == 150
    assert "150" in sheet.caption


def test_cells_lie_where_they_are() -> None:
    values = np.full((4, 5), np.nan)
    values[0, 4] = 7.0
    cells = replace(window(), classes=None, values=values, covariances=None, moved=None)
    (picture,) = window_sheet(cells).figure.axes[0].images
    assert picture.get_array()[0, 4] == 7.0
    assert picture.get_array().count() == 1
    assert picture.origin == "lower"
    assert picture.get_extent() == [-10.0, 10.0, -10.0, 10.0]
