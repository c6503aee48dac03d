"""Small pure functions behind the figures: thinning, round figures, the map's projection."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mgsgraph.geometry.body import from_planetocentric, plane_coordinates
from mgsgraph.geometry.records import thinned
from mgsgraph.results.figures.sheet import number, round_figure, short

MARS = 3.39e6


def test_map_is_true_to_distance_and_direction() -> None:
    """Against the spherical law: a point x rad along a great circle lies x R from the centre; poles included."""
    for longitude, latitude in ((0.3, 0.7), (-3.1, -1.2), (1.0, 0.5 * np.pi)):
        centre = from_planetocentric(np.array([longitude, latitude, MARS]))
        north_pole_of_it = np.array([-np.sin(latitude) * np.cos(longitude), -np.sin(latitude) * np.sin(longitude),
                                     np.cos(latitude)])
        for angle in (1e-7, 0.1, 2.5):
            point = np.cos(angle) * centre + np.sin(angle) * MARS * north_pole_of_it
            place = plane_coordinates(point[None], centre)[0]
            assert np.hypot(*place) == pytest.approx(angle * MARS, rel=1e-8)
            if latitude < 1.5:
                assert place[1] == pytest.approx(angle * MARS, rel=1e-8)
        assert np.abs(plane_coordinates(centre[None], centre)).max() < 1e-6


@given(st.floats(1e-12, 1e12))
def test_round_figures(value: float) -> None:
    step = round_figure(value)
    assert step <= value * (1.0 + 1e-6) < 2.5 * step * (1.0 + 1e-6)
    assert f"{step:.0e}"[0] in "125"


def test_words() -> None:
    assert [number(value) for value in (0.0, -13.23, 1234.5, 0.01234, np.nan)] == ["0", "−13.2", "1234", "0.0123", "–"]
    assert round_figure(0.0) == round_figure(np.nan) == 1.0
    assert len(short("x" * 90)) <= 40
    assert short("SIM/A") == "SIM/A"


@given(st.integers(0, 5000), st.integers(2, 400))
def test_thinning_keeps_both_ends(size: int, most: int) -> None:
    chosen = thinned(size, most)
    assert chosen.size == min(size, most)
    assert len(set(chosen.tolist())) == chosen.size
    if size:
        assert (chosen[0], chosen[-1]) == (0, size - 1)
