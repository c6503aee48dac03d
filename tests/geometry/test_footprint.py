"""Footprints: areas against formulas of sphere and ellipsoid, overlaps and shapes on the map anywhere on the body, date
line and poles too, what is refused.
"""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from gis_files import degrees, on_body, true_area
from hypothesis import example, given, settings
from hypothesis import strategies as st
from outside import refuses

from mgsgraph.geometry.body import Ellipsoid, from_geodetic, from_planetocentric
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.footprint import (
    Footprint,
    eastward_bounds,
    footprint,
    gaps,
    map_bounds,
    map_lines,
    map_polygon,
    map_polygons,
    overlaps,
)
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.simulation.orbit import MARS
from mgsgraph.simulation.pair import simulate_pair
from mgsgraph.simulation.site import bridge_image
from mgsgraph.units import DEG

SPHERE = Ellipsoid(3.39e6, 3.39e6)

PAIR = simulate_pair()


def box(west: float, east: float, south: float, north: float, body: Ellipsoid = SPHERE, side: int = 60) -> Footprint:
    """Meridians and parallels in degrees (geodetic), many places on each side."""
    step = np.linspace(0.0, 1.0, side, endpoint=False)
    longitude = np.concatenate([west + (east - west) * step, np.full(side, east), east - (east - west) * step,
                                np.full(side, west)])  # fmt: skip
    latitude = np.concatenate([np.full(side, south), south + (north - south) * step, np.full(side, north),
                               north - (north - south) * step])  # fmt: skip
    places = from_geodetic(np.column_stack([longitude * DEG, latitude * DEG, np.zeros(4 * side)]), body)
    return Footprint("box", np.concatenate([places, places[:1]]), body)


def cap(latitude: float, radius: float, longitude: float = 0.0, name: str = "cap", side: int = 200) -> Footprint:
    """A small circle on the sphere, in degrees."""
    up = from_planetocentric(np.array([longitude * DEG, latitude * DEG, 1.0]))
    first = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    first /= np.linalg.norm(first)
    turn = np.linspace(0.0, 2.0 * np.pi, side + 1)[:, None]
    aside = np.cos(turn) * first + np.sin(turn) * np.cross(up, first)
    ring = SPHERE.equatorial * (np.cos(radius * DEG) * up + np.sin(radius * DEG) * aside)
    ring[-1] = ring[0]
    return Footprint(name, ring, SPHERE)


def zone(south: float, north: float, body: Ellipsoid) -> float:
    """m^2 per radian of longitude between geodetic latitudes: the integral of M N cos(latitude), by Gauss-Legendre."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    latitude = 0.5 * DEG * ((north - south) * nodes + north + south)
    a, b = body.equatorial, body.polar
    square = 1.0 - (b / a) ** 2
    meridian_times_normal = a * a * (1.0 - square) / (1.0 - square * np.sin(latitude) ** 2) ** 2
    return float(np.sum(weights * meridian_times_normal * np.cos(latitude)) * 0.5 * (north - south) * DEG)


# --- areas


@given(st.floats(-180.0, 180.0), st.floats(-88.0, 80.0), st.floats(0.1, 20.0), st.floats(0.1, 8.0))
def test_area_of_a_box_is_that_of_the_zone(west: float, south: float, width: float, height: float) -> None:
    for body in (SPHERE, MARS, Ellipsoid(3.3e6, 3.4e6)):
        want = zone(south, south + height, body) * width * DEG
        got = box(west, west + width, south, south + height, body).area
        assert got == pytest.approx(want, rel=2e-4)


@pytest.mark.parametrize("latitude", [-90.0, 0.0, 89.0])
@pytest.mark.parametrize("radius", [0.01, 1.0, 30.0])
def test_area_of_a_cap(latitude: float, radius: float) -> None:
    want = 2.0 * np.pi * SPHERE.equatorial**2 * (1.0 - np.cos(radius * DEG))
    assert cap(latitude, radius, 180.0).area == pytest.approx(want, rel=3e-4)  # a circle of 200 corners: 1.6e-4 less


# --- overlaps


def lens(angle: float, one: float, other: float) -> float:
    """m^2 that two caps share (rad): 2 (pi - arccos ... ), the sphere's lens (Tovchigrechko & Vakser 2001, Eq. 3)."""
    c, a, b = np.cos(angle), np.cos(one), np.cos(other)
    sa, sb, sc = np.sin(one), np.sin(other), np.sin(angle)
    area = (
        np.pi - np.arccos((c - a * b) / (sa * sb)) - np.arccos((b - c * a) / (sc * sa)) * a
        - np.arccos((a - c * b) / (sc * sb)) * b
    )  # fmt: skip
    return float(2.0 * area * SPHERE.equatorial**2)


@pytest.mark.parametrize(("latitude", "longitude"), [(0.0, 0.0), (10.0, 180.0), (90.0, 0.0), (-89.5, -179.9)])
def test_caps_share_the_lens(latitude: float, longitude: float) -> None:
    here, there = cap(latitude, 1.0, longitude, "A"), cap(latitude - np.sign(latitude + 0.5) * 1.2, 0.8, longitude, "B")
    found = overlaps([here, there])
    assert found.pairs.tolist() == [[0, 1]]
    assert found.areas[0] == pytest.approx(lens(1.2 * DEG, 1.0 * DEG, 0.8 * DEG), rel=1e-3)
    assert found.shares[0] == pytest.approx(found.areas[0] / there.area)


@given(st.floats(-180.0, 180.0), st.floats(-85.0, 85.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_boxes_share_a_box(west: float, south: float, east_by: float, north_by: float) -> None:
    one = box(west, west + 2.0, south, south + 2.0, MARS)
    two = box(west + east_by, west + east_by + 2.0, south + north_by, min(south + north_by + 2.0, 89.0), MARS)
    low, high = max(south, south + north_by), min(south + 2.0, south + north_by + 2.0, 89.0)
    width = 2.0 - abs(east_by)
    want = zone(low, high, MARS) * width * DEG if width > 0.0 and high > low else 0.0
    found = overlaps([one, two])
    got = float(found.areas[0]) if found.pairs.size else 0.0
    assert got == pytest.approx(want, abs=5e-4 * one.area)
    if want == 0.0 and max(-width, low - high) > 0.01:
        assert found.pairs.size == 0
        gap = gaps([one, two], np.array([[0, 1]]))[0]
        assert gap > 0.0


def test_the_gap_between_boxes_is_the_arc_between_them() -> None:
    row = [box(10.0, 11.0, -0.5, 0.5), box(12.0, 13.0, -0.5, 0.5), box(10.5, 12.5, -0.2, 0.2)]
    found = gaps(row, np.array([[0, 1], [0, 2]]))
    assert found[0] == pytest.approx(SPHERE.equatorial * DEG * np.cos(0.5 * DEG), rel=1e-3)
    assert found[1] == 0.0


def test_prefilter_loses_nothing() -> None:
    """Strips at all angles: every pair cut by brute force, two at a time, where nothing is left aside."""
    rng = np.random.default_rng(1)
    strips = [strip(rng) for _ in range(40)]
    found = overlaps(strips)
    got = {tuple(pair) for pair in found.pairs.tolist()}
    want = {(i, j) for i in range(40) for j in range(i + 1, 40) if crossing(strips[i], strips[j])}
    assert want <= got
    assert len(want) > 30
    assert len(got) < 40 * 39 / 4


def strip(rng: np.random.Generator) -> Footprint:
    """A narrow box of 0.3 x 6 degrees, turned about its middle, around 60 N."""
    along, across = np.linspace(-3.0, 3.0, 30) * DEG, 0.15 * DEG
    sides = [np.column_stack([sign * along, np.full(30, -sign * across)]) for sign in (1.0, -1.0)]
    flat = np.concatenate(sides)
    angle = rng.uniform(0.0, np.pi)
    flat = flat @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    flat += rng.uniform(-5.0, 5.0, 2) * DEG
    ring = np.column_stack([0.5 + flat[:, 0], flat[:, 1], np.full(60, np.sqrt(0.75))])
    ring *= SPHERE.equatorial / np.linalg.norm(ring, axis=1)[:, None]
    return Footprint("strip", np.concatenate([ring, ring[:1]]), SPHERE)


def crossing(one: Footprint, other: Footprint) -> bool:
    """Whether an edge of one crosses an edge of the other, in space: great circles and determinants, no plane."""
    a, b, c, d = one.outline[:-1, None], one.outline[1:, None], other.outline[None, :-1], other.outline[None, 1:]
    side = np.sum(np.cross(a, b) * c, axis=-1) * np.sum(np.cross(a, b) * d, axis=-1)
    back = np.sum(np.cross(c, d) * a, axis=-1) * np.sum(np.cross(c, d) * b, axis=-1)
    return bool(np.any((side < 0.0) & (back < 0.0)))


def test_footprints_of_nearly_half_the_body() -> None:
    """A coordinate along an axis can be largest inside a footprint, not on its outline."""
    found = overlaps([cap(0.0, 80.0, name="A"), cap(0.0, 12.0, 89.0, name="B")])
    assert found.pairs.tolist() == [[0, 1]]
    want = lens(89.0 * DEG, 80.0 * DEG, 12.0 * DEG)
    assert found.areas[0] == pytest.approx(want, rel=0.01)


# --- records


def test_longitudes_go_on_over_the_date_line() -> None:
    one = box(178.0, 183.0, -1.0, 1.0)
    longitude, latitude = one.longitude_latitude.T / DEG
    assert np.ptp(longitude) == pytest.approx(5.0)
    assert np.ptp(latitude) == pytest.approx(2.0)
    assert one.pole == 0


@pytest.mark.parametrize(("latitude", "pole"), [(89.5, 1), (-89.5, -1), (88.0, 0), (0.0, 0)])
def test_poles_inside(latitude: float, pole: int) -> None:
    one = cap(latitude, 1.0, 77.0)
    assert one.pole == pole
    turned = np.ptp(one.longitude_latitude[:, 0])
    assert turned == pytest.approx(2.0 * np.pi) if pole else turned < np.pi


def test_an_outline_is_closed_and_finite() -> None:
    ring = box(0.0, 1.0, 0.0, 1.0).outline
    refuses("the last is the first", Footprint, "A", ring[:-1], SPHERE)
    refuses("finite", Footprint, "A", np.full((5, 3), np.nan), SPHERE)
    refuses("one body", overlaps, [box(0.0, 1.0, 0.0, 1.0), box(0.0, 1.0, 0.0, 1.0, MARS)])


# --- of images


@pytest.mark.parametrize(("equatorial", "polar"), [(MARS.equatorial, 1e-3), (1e300, 1.0)])
def test_an_ellipsoid_that_is_no_bodys(equatorial: float, polar: float) -> None:
    """The sphere of its area has no place for the outline: GEOS would be given NaN."""
    outline = equatorial * np.array([[1.0, 0.0, 0.0], [1.0, 0.1, 0.0], [1.0, 0.1, 0.1], [1.0, 0.0, 0.0]])
    one = Footprint("A", outline, Ellipsoid(equatorial, polar))
    for question in (lambda: one.area, lambda: overlaps([one, one]), lambda: gaps([one, one], np.array([[0, 1]]))):
        refuses("footprint of A: an ellipsoid of", question)


def test_the_outline_projects_to_the_edges() -> None:
    for image in PAIR.images:
        one = footprint(image, 500.0)
        assert one.whole
        places, _ = image.ground_to_image(one.outline)
        edge = np.minimum(np.abs(places), np.abs(places - [image.lines, image.samples]))
        assert edge.min(axis=1).max() < 1e-4
        assert np.array_equal(one.outline[0], one.outline[-1])


def test_sampling_is_fine_enough() -> None:
    one = footprint(PAIR.images[0])
    assert one.area == pytest.approx(footprint(PAIR.images[0], along=400, across=100).area, rel=1e-5)


def test_overlap_of_images_is_where_both_see() -> None:
    """Points thrown at the first image's rectangle: the share of them that the second sees, too."""
    first, second = PAIR.images
    rng = np.random.default_rng(2)
    lines, samples = rng.uniform(0.0, first.lines, 4000), rng.uniform(0.0, first.samples, 4000)
    ground, by_place = first.image_to_ground(lines, samples)
    weight = np.linalg.norm(np.cross(by_place[:, :, 0], by_place[:, :, 1]), axis=1)
    seen, _ = second.ground_to_image(ground)
    inside = np.all((seen >= 0.0) & (seen <= [second.lines, second.samples]), axis=1)
    found = overlaps([footprint(first), footprint(second)])
    assert found.areas[0] == pytest.approx(weight.mean() * first.lines * first.samples * inside.mean(), rel=0.02)


def test_an_image_that_looks_past_the_body() -> None:
    image = PAIR.images[0]
    wide = widened(image, 2000.0)
    one = footprint(wide)
    assert not one.whole
    assert 0.0 < one.area < 2.0 * np.pi * MARS.equatorial**2
    away = replace(image, name="away", body=Ellipsoid(1.0, 1.0))
    nothing = footprint(away)
    assert (nothing.area, nothing.pole, nothing.outline.shape) == (0.0, 0, (0, 3))
    assert np.isnan(nothing.centre).all()
    assert overlaps([nothing, nothing]).pairs.size == 0
    assert np.isnan(gaps([nothing, nothing], np.array([[0, 1]]))).all()


def widened(image: PushbroomImage, factor: float) -> PushbroomImage:
    """The same with a shorter focal length."""
    interior: InteriorOrientation = image.interior
    return replace(image, interior=replace(interior, focal_length=interior.focal_length / factor))


def test_a_swath_around_the_body_has_no_outline() -> None:
    """One of more than a quarter of the way round can't lie in a plane; what it covers is left open, not guessed."""
    bridge = bridge_image()
    found = footprint(bridge)
    assert found.outline.shape == (0, 3)
    assert not found.whole
    assert found.area == 0.0


# --- shapes on the map


@settings(deadline=None)
@given(
    st.one_of(st.floats(-180.0, 180.0), st.floats(179.0, 181.0)),
    st.one_of(st.floats(-90.0, 90.0), st.floats(88.0, 90.0)),
    st.floats(0.01, 3.0),
)
def test_a_circle_anywhere_keeps_its_area_and_its_inside(longitude: float, latitude: float, radius: float) -> None:
    ring = cap(latitude, radius, longitude).outline
    (shape,) = map_polygons(ring[None])
    if abs(90.0 - abs(latitude) - radius) < 1e-3:
        return  # an edge through the pole itself
    west, south, east, north = shapely.bounds(shape)
    assert west >= -180.0
    assert east <= 180.0
    assert south >= -90.0
    assert north <= 90.0
    assert shapely.is_valid(shape)
    assert true_area(shape, SPHERE) == pytest.approx(Footprint("cap", ring, SPHERE).area, rel=2e-3)
    rng = np.random.default_rng(1)
    middle = ring[:-1].mean(axis=0) / np.linalg.norm(ring[:-1].mean(axis=0))
    around = middle + np.radians(radius) * rng.uniform(-1.5, 1.5, (60, 3))
    away = np.degrees(np.arccos(np.clip(around @ middle / np.linalg.norm(around, axis=1), -1.0, 1.0))) / radius
    clear = np.abs(away - 1.0) > 0.05
    inside = shapely.contains_xy(shape, degrees(around[clear]))
    assert np.array_equal(inside, away[clear] < 1.0)


@settings(deadline=None)
@given(
    st.one_of(st.floats(-180.0, 180.0), st.sampled_from([-180.0, -40.0, 0.0, 0.01, 179.9, 180.0])),
    st.one_of(st.floats(-90.0, 90.0), st.sampled_from([-90.0, -89.7, 0.0, 89.6, 90.0])),
    st.floats(0.02, 2.0),
)
@example(179.0, 1.0, 1.0)  # a sliver beyond the date line
def test_bounds_of_a_circle_anywhere(longitude: float, latitude: float, radius: float) -> None:
    """All longitudes around a pole, else asin(sin radius / cos latitude) to both sides (spherical sine rule)."""
    beyond = abs(latitude) + radius - 90.0
    if abs(beyond) < 0.05 * radius:
        return  # an edge close to the pole
    ring = cap(latitude, radius, longitude, side=1000).outline
    found = np.array([map_bounds(map_polygon(ring)), eastward_bounds(ring)])
    want = np.array([longitude, latitude - radius, longitude, latitude + radius])
    if beyond > 0.0:
        want[1 if latitude < 0.0 else 3] = np.copysign(90.0, latitude)
        assert found[:, [0, 2]].tolist() == [[-180.0, 180.0], [0.0, 360.0]]
        assert len(shapely.get_parts(map_polygon(ring))) == 1  # no slit where the ring begins
    else:
        want[[0, 2]] += np.arcsin(np.sin(radius * DEG) / np.cos(latitude * DEG)) / DEG * np.array([-1.0, 1.0])
        off = (found - want)[:, [0, 2]]
        np.testing.assert_allclose((off + 180.0) % 360.0 - 180.0, 0.0, atol=1e-3)
    np.testing.assert_allclose(found[:, [1, 3]], want[[1, 3]] * np.ones((2, 1)), atol=1e-5)
    assert np.all((found[:, [0, 2]] >= [[-180.0], [0.0]]) & (found[:, [0, 2]] <= [[180.0], [360.0]]))


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
