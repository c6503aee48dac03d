"""Shapes on the map: circles and lines anywhere on the body, date line and poles too."""

from pathlib import Path

import numpy as np
import pytest
import shapely
from gis_files import LAYERS, degrees, layer, on_body, true_area
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import network

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.export.gis import write_gis
from mgsgraph.geometry.body import Ellipsoid, from_planetocentric
from mgsgraph.geometry.footprint import Footprint, map_lines, map_polygons
from mgsgraph.geometry.records import Array
from mgsgraph.simulation.orbit import MARS
from mgsgraph.simulation.pair import PairSettings, simulate_pair
from mgsgraph.units import DEG, KM

pytest.importorskip("pyogrio", reason="the extra [gis] is not installed")


def cap(longitude: float, latitude: float, radius: float, side: int = 120) -> Array:
    """A small circle (k, 3) on a sphere of Mars' size, closed; degrees."""
    up = from_planetocentric(np.array([longitude * DEG, latitude * DEG, 1.0]))
    first = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    first /= np.linalg.norm(first)
    turn = np.linspace(0.0, 2.0 * np.pi, side + 1)[:, None]
    aside = np.cos(turn) * first + np.sin(turn) * np.cross(up, first)
    ring = 3.39e6 * (np.cos(radius * DEG) * up + np.sin(radius * DEG) * aside)
    ring[-1] = ring[0]
    return np.asarray(ring)


@settings(deadline=None)
@given(
    st.one_of(st.floats(-180.0, 180.0), st.floats(179.0, 181.0)),
    st.one_of(st.floats(-90.0, 90.0), st.floats(88.0, 90.0)),
    st.floats(0.01, 3.0),
)
def test_a_circle_anywhere_keeps_its_area_and_its_inside(longitude: float, latitude: float, radius: float) -> None:
    ring = cap(longitude, latitude, radius)
    (shape,) = map_polygons(ring[None])
    sphere = Ellipsoid(3.39e6, 3.39e6)
    if abs(90.0 - abs(latitude) - radius) < 1e-3:
        return  # an edge through the pole itself
    west, south, east, north = shapely.bounds(shape)
    assert west >= -180.0
    assert east <= 180.0
    assert south >= -90.0
    assert north <= 90.0
    assert shapely.is_valid(shape)
    assert true_area(shape, sphere) == pytest.approx(Footprint("cap", ring, sphere).area, rel=2e-3)
    rng = np.random.default_rng(1)
    middle = ring[:-1].mean(axis=0) / np.linalg.norm(ring[:-1].mean(axis=0))
    around = middle + np.radians(radius) * rng.uniform(-1.5, 1.5, (60, 3))
    away = np.degrees(np.arccos(np.clip(around @ middle / np.linalg.norm(around, axis=1), -1.0, 1.0))) / radius
    clear = np.abs(away - 1.0) > 0.05
    inside = shapely.contains_xy(shape, degrees(around[clear]))
    assert np.array_equal(inside, away[clear] < 1.0)


def test_polygons_are_parted_at_the_date_line_alone() -> None:
    for longitude, parts in ((179.9, 2), (-179.9, 2), (0.0, 1), (170.0, 1)):
        (shape,) = map_polygons(cap(longitude, 10.0, 0.5)[None])
        assert len(shapely.get_parts(shape)) == parts
        assert shapely.bounds(shape)[2] - shapely.bounds(shape)[0] > (300.0 if parts == 2 else 0.9)
    (pole,) = map_polygons(cap(20.0, 89.0, 3.0)[None])
    assert shapely.bounds(pole) == pytest.approx([-180.0, 86.0, 180.0, 90.0], abs=1e-2)
    assert len(shapely.get_parts(pole)) == 1


@settings(deadline=None)
@given(st.floats(-1.0, 1.0), st.floats(-80.0, 80.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_lines_over_the_date_line_keep_their_length(at: float, latitude: float, east: float, north: float) -> None:
    ends = np.radians([[180.0 + at, latitude], [180.0 + at + east, latitude + north]])
    start, end = from_planetocentric(np.column_stack([ends, np.ones(2)]))
    (line,) = map_lines(start[None], end[None])
    assert np.abs(shapely.bounds(line)[[0, 2]]).max() <= 180.0
    pieces = [on_body(part, 1.0) for part in shapely.get_parts(line)]
    found = sum(np.linalg.norm(np.diff(piece, axis=0), axis=1).sum() for piece in pieces)
    assert found == pytest.approx(2.0 * np.arcsin(0.5 * np.linalg.norm(end - start)), rel=1e-4, abs=1e-9)
    if min(abs(at), abs(at + east)) > 1e-6:  # neither end on the date line
        assert len(pieces) == (1 if (at > 0.0) == (at + east > 0.0) else 2)


@pytest.mark.parametrize(("longitude", "latitude"), [(180.0, 4.0), (30.0, 89.99)])
def test_a_solution_on_the_date_line_and_on_the_pole(
    longitude: float, latitude: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mgsgraph.simulation.pair.CENTRE", (longitude * DEG, latitude * DEG))
    solved = adjust_network(network(simulate_pair(PairSettings(ties=10, shots=5))), SolverSettings())
    path = write_gis(solved, tmp_path)[0]
    found = layer(path, "footprints_adjusted")
    if latitude < 80.0:
        assert max(len(shapely.get_parts(shape)) for shape in found.shapes) == 2
    else:
        assert shapely.bounds(found.shapes)[:, 3].max() == 90.0
    for j, shape in enumerate(found.shapes):
        assert shapely.is_valid(shape)
        assert np.abs(shapely.bounds(shape)).max() <= 180.0
        assert true_area(shape, MARS) == pytest.approx(found.fields["area_km2"][j] * KM**2, rel=1e-3)
    points = layer(path, "tie_points")
    assert np.abs(shapely.get_coordinates(points.shapes) - degrees(solved.places[:10])).max() < 1e-9
    assert np.allclose(points.fields["lon_deg"], degrees(solved.places[:10])[:, 0] % 360.0, rtol=0.0, atol=1e-9)
    seen = shapely.contains(shapely.buffer(found.shapes[0], 1e-9), points.shapes)
    assert seen.all()
    for name in LAYERS[:-1]:
        assert shapely.is_valid(layer(path, name).shapes).all()
