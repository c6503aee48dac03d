"""Tables of places: which columns say what, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from mgsgraph.errors import InputError
from mgsgraph.files.place_table import PlaceTable, Sort, read_places
from mgsgraph.geometry.body import geodetic, planetocentric
from mgsgraph.simulation.orbit import MARS
from mgsgraph.units import DEG


def table(folder: Path, text: str, sort: Sort | None = None) -> PlaceTable:
    path = folder / "places.csv"
    path.write_text(text, encoding="utf-8")
    return read_places(path, MARS, sort)


def test_both_ways_to_count_pixels(tmp_path: Path) -> None:
    ours, isis = (table(tmp_path, f"{head}\n3.5,7\n") for head in ("line,Sample", "ISIS_LINE, isis_sample"))
    assert (ours.isis, isis.isis) == (False, True)
    np.testing.assert_array_equal(ours.pixels - isis.pixels, [[0.5, 0.5]])
    assert ours.heights is None
    own = table(tmp_path, "line,sample,height_m\n1,2,3\n")
    assert own.heights is not None
    assert own.heights.tolist() == [3.0]


def test_ground_places_of_every_kind(tmp_path: Path) -> None:
    round_ones = table(tmp_path, "longitude_deg,latitude_deg,radius_m\n10,20,3390000\n").points
    np.testing.assert_allclose(planetocentric(round_ones), [[10 * DEG, 20 * DEG, 3.39e6]])
    upright = table(tmp_path, "longitude_deg,geodetic_latitude_deg,height_m\n10,20,500\n").points
    np.testing.assert_allclose(geodetic(upright, MARS), [[10 * DEG, 20 * DEG, 500.0]])
    x, y, z = upright[0].tolist()
    np.testing.assert_array_equal(table(tmp_path, f"x_m,y_m,z_m\n{x!r},{y!r},{z!r}\n").points, upright)
    surface = table(tmp_path, "a,longitude_deg,latitude_deg\n7,10,20\n8,,\n")
    np.testing.assert_allclose(surface.directions, [[10 * DEG, 20 * DEG], [np.nan, np.nan]])
    assert surface.columns["a"] == ["7", "8"]


def test_of_both_it_has_to_be_said(tmp_path: Path) -> None:
    text = "line,sample,longitude_deg,latitude_deg\n1,2,3,4\n"
    with pytest.raises(InputError, match="--into image"):
        table(tmp_path, text)
    assert table(tmp_path, text, "image").pixels.tolist() == [[1.0, 2.0]]
    assert table(tmp_path, text, "ground").pixels.shape == (0, 2)
    with pytest.raises(InputError, match="isis_line"):
        table(tmp_path, "line,sample\n1,2\n", "ground")


TABLES = {
    "a radius in kilometres": ("longitude_deg,latitude_deg,radius_km\n1,2,3380.0\n", "'radius_km'; expected"),
    "no unit": ("line,sample,height\n1,2,3380.0\n", "'height'; expected height_m or radius_m"),
    "no places": ("id,name\n1,2\n", "isis_line"),
    "a header alone": ("line,sample\n", "header alone"),
    "a word": ("line,sample\n1,two\n", "line 2, sample"),
    "too many": ("line,sample\n1,2,3\n", "3 fields"),
    "twice": ("line,line,sample\n1,2,3\n", "twice"),
    "a latitude": ("longitude_deg,latitude_deg\n1,91\n", "line 2"),
    "a longitude beside a radius": ("longitude_deg,latitude_deg,radius_m\n-361,1,3396000\n", "longitude_deg: -361"),
    "an underscore": ("line,sample\n1,1_0\n", "line 2, sample"),
    "kilometres": ("longitude_deg,latitude_deg,radius_m\n1,2,3396\n", "line 2, radius_m: .* not in km"),
    "kilometres along axes": ("x_m,y_m,z_m\n3396,0,0\n", "line 2, z_m: .* not in km"),
}


@pytest.mark.parametrize("fault", TABLES)
def test_tables_that_are_refused(tmp_path: Path, fault: str) -> None:
    text, said = TABLES[fault]
    given = tmp_path / "given.csv"
    given.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        read_places(given, MARS)
