"""Pictures over a ground and its chart: from pixels to the chart and back, derivatives, parallax; tracks."""

from dataclasses import replace

import matched
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.matching.scene import GroundChart, Picture, Pixels, joined, star

SCENES = [("true ground", matched.true_scene), ("terrain model", matched.scene)]


def places(picture: Picture, count: int = 300) -> np.ndarray:
    size = np.array([picture.image.lines, picture.image.samples])
    return np.random.default_rng(2).uniform(0.0, size, (count, 2))


@pytest.mark.parametrize("make", [make for _, make in SCENES], ids=[name for name, _ in SCENES])
@pytest.mark.parametrize("number", [0, 1])
def test_pixels_to_the_chart_and_back(make, number: int) -> None:
    scene = make()
    picture = replace(scene.pictures[number], correction=matched.DISTURBED)
    there = places(picture)
    back = picture.project(scene.ground.points(picture.on_chart(scene.ground, there)))
    off = np.abs(back - there).max(axis=1)
    assert np.quantile(off, 0.99) < 3e-3  # pixels of 3 m: within a centimetre
    assert off.max() < 0.03  # on the walls of craters, seen slantwise


def test_the_ground_is_that_of_the_model() -> None:
    scene = matched.true_scene()
    points = matched.inner()
    off = scene.ground.points(scene.ground.chart.plane(points)) - points
    assert np.median(np.linalg.norm(off, axis=1)) < 0.3  # between posts 30 m apart
    seen = scene.pictures[1].on_chart(scene.ground, scene.pictures[1].project(points))
    assert np.median(np.linalg.norm(seen - scene.ground.chart.plane(points), axis=1)) < 0.2


def test_without_a_model_the_ground_is_level() -> None:
    scene = matched.scene()
    far = replace(scene.ground, terrain=None)
    beyond = np.array([[4e5, 0.0], [0.0, -4e5]])  # where the model says nothing, either
    np.testing.assert_allclose(scene.ground.points(beyond), far.points(beyond), atol=1e-6)
    points = far.points(scene.ground.chart.plane(matched.inner()))
    np.testing.assert_allclose(far.meet(points * 1.1, -points), points, atol=1e-3)


def test_rays_past_the_body_meet_nothing() -> None:
    scene = matched.scene()
    away = OrientationCorrection(np.array([[0.0, 0.0, 0.0, 2.0, 0.0, 0.0]]))
    assert np.all(np.isnan(scene.pictures[0].on_chart(scene.ground, np.array([[5.0, 5.0]]), away)))


def test_a_correction_given_is_taken_in_place_of_the_own() -> None:
    scene = matched.scene()
    picture, at = scene.pictures[1], places(scene.pictures[1], 20)
    own = replace(picture, correction=matched.DISTURBED).on_chart(scene.ground, at)
    np.testing.assert_array_equal(picture.on_chart(scene.ground, at, matched.DISTURBED), own)
    assert np.all(np.linalg.norm(own - picture.on_chart(scene.ground, at), axis=1) > 20.0)


@pytest.mark.parametrize("number", [0, 1])
def test_derivatives_are_differences(number: int) -> None:
    scene = matched.scene()
    ground = replace(scene.ground, terrain=None)
    picture = scene.pictures[number]
    plane = picture.on_chart(ground, places(picture, 50))
    told = picture.derivatives(ground, plane)
    step = np.array([3.0, -2.0])
    moved = picture.project(ground.points(plane + step)) - picture.project(ground.points(plane))
    np.testing.assert_allclose(told @ step, moved, atol=1e-3)  # kinks between nodes of the trajectory


@pytest.mark.parametrize("number", [0, 1])
def test_height_parallax_is_the_displacement_by_height(number: int) -> None:
    scene = matched.scene()
    picture, low = scene.pictures[number], replace(scene.ground, terrain=None)
    high = replace(low, height=low.height + 30.0)
    at = places(picture, 50)
    moved = picture.on_chart(high, at) - picture.on_chart(low, at)
    parallax = picture.height_parallax(low, at)
    np.testing.assert_allclose(30.0 * parallax, moved, atol=0.02)
    size = np.linalg.norm(parallax, axis=1)
    assert np.all(size > 0.35) if number else np.all(size < 0.02)  # tan of 22.1 degrees' emission, and of 0.2


# ---- pictures


def with_pixels(pixels: Pixels) -> Picture:
    return replace(matched.scene().pictures[0], pixels=pixels)


def test_levels_hold_all_but_a_two_hundredth() -> None:
    picture = matched.scene().pictures[0]
    low, high = picture.levels
    assert np.mean((picture.pixels < low) | (picture.pixels > high)) == pytest.approx(0.01, abs=0.006)
    hollow = picture.pixels.astype(np.float32)
    hollow[:200] = np.nan
    assert np.abs(np.array(with_pixels(hollow).levels) - picture.levels).max() < 8.0


def saturated(share: float, value: int = 255) -> Pixels:
    pixels = matched.scene().pictures[0].pixels.copy()
    pixels[: int(share * len(pixels))] = value
    return pixels


@pytest.mark.parametrize(
    ("pixels", "said"),
    [
        (np.full((640, 1024), 120, dtype=np.uint8), "100% of its pixels at the darkest value, 120"),
        (np.full((640, 1024), np.nan, dtype=np.float32), "no valid pixels"),
        (None, "60% of its pixels at the brightest value, 255; expected a picture that is neither blank nor saturated"),
    ],
)
def test_blank_and_saturated_pictures_are_refused(pixels: Pixels | None, said: str) -> None:
    with pytest.raises(InputError, match="picture of E02-00665: ") as caught:
        _ = with_pixels(saturated(0.6) if pixels is None else pixels).levels
    assert said in str(caught.value)
    assert with_pixels(saturated(0.4)).levels[1] == 255.0


# --- the plane of comparison


RADIUS = 3.39e6
PLACES = ((0.3, 0.2), (np.pi - 1e-4, -0.4), (-np.pi + 1e-4, 0.1), (1.0, np.pi / 2 - 1e-5), (-2.0, -np.pi / 2 + 1e-5))
"""rad: on the date line and beside both poles, too."""


def around(longitude: float, latitude: float, size: float = 2e-3) -> np.ndarray:
    """Points (n, 3) on a sphere, some kilometres about a place."""
    middle = from_planetocentric(np.array([[longitude, latitude, RADIUS]]))[0]
    points = middle + size * RADIUS * np.random.default_rng(1).uniform(-1.0, 1.0, (60, 3))
    return np.asarray(points * (RADIUS / np.linalg.norm(points, axis=1, keepdims=True)))


@pytest.mark.parametrize(("longitude", "latitude"), PLACES)
@settings(deadline=None)
@given(turn=st.floats(0.0, 6.3))
def test_there_and_back_with_true_lengths(longitude: float, latitude: float, turn: float) -> None:
    points = around(longitude, latitude)
    flight = np.array([np.cos(turn), np.sin(turn), 0.7])
    chart = GroundChart.about(points, flight)
    plane = chart.plane(points)
    back = chart.directions(plane) * RADIUS
    assert np.abs(back - points).max() < 1e-6
    assert np.abs(chart.plane(back) - plane).max() < 1e-6
    lengths = np.linalg.norm(np.diff(plane, axis=0), axis=1) / np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert np.abs(lengths - 1.0).max() < 1e-5
    np.testing.assert_allclose(chart.axes @ chart.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(chart.axes) == pytest.approx(1.0)
    ahead = chart.plane(points + 10.0 * flight / np.linalg.norm(flight)) - plane
    assert np.all(ahead[:, 1] > 0.0)  # y is along the flight
    assert np.abs(ahead[:, 0]).max() < 0.1


def test_areas_are_true_far_from_the_middle() -> None:
    """Caps of the sphere are discs of the same area (Snyder 1987, p. 182)."""
    chart = GroundChart(np.eye(3), RADIUS)
    for angle in (1e-4, 0.1, 1.0, 3.0):
        edge = np.array([[np.sin(angle), 0.0, np.cos(angle)], [0.0, np.sin(angle), np.cos(angle)]])
        size = np.linalg.norm(chart.plane(edge), axis=1)
        cap = 4.0 * np.pi * RADIUS**2 * np.sin(0.5 * angle) ** 2
        np.testing.assert_allclose(np.pi * size**2, cap, rtol=1e-12)


def test_beyond_the_antipode_is_nowhere() -> None:
    chart = GroundChart(np.eye(3), RADIUS)
    assert np.all(np.isnan(chart.directions(np.array([[2.1 * RADIUS, 0.0]]))))


# --- tracks


def tracks_of(links: list[tuple[int, int]], likeness: list[float], pictures: list[int]) -> set[tuple[int, ...]]:
    found = joined(np.array(links, dtype=np.int64).reshape(-1, 2), np.array(likeness), np.array(pictures))
    return {tuple(track) for track in found}


def test_chains_and_triangles_are_one_track() -> None:
    assert tracks_of([(0, 1), (1, 2)], [0.9, 0.8], [0, 1, 2]) == {(0, 1, 2)}
    assert tracks_of([(0, 1), (1, 2), (0, 2)], [0.9, 0.8, 0.7], [0, 1, 2]) == {(0, 1, 2)}
    assert tracks_of([(2, 1), (0, 2)], [0.9, 0.8], [2, 1, 0]) == {(2, 1, 0)}  # by picture
    assert tracks_of([], [], [0, 1]) == set()


def test_conflicts_split_at_the_weakest_link() -> None:
    """Features 0 and 3 are of one picture; the chain between them breaks where it is weakest."""
    pictures = [0, 1, 2, 0]
    chain = [(0, 1), (1, 2), (2, 3)]
    assert tracks_of(chain, [0.9, 0.5, 0.8], pictures) == {(0, 1), (3, 2)}
    assert tracks_of(chain, [0.5, 0.9, 0.8], pictures) == {(3, 1, 2)}
    assert tracks_of(chain, [0.9, 0.8, 0.5], pictures) == {(0, 1, 2)}


@st.composite
def graphs(draw: st.DrawFn) -> tuple[list[tuple[int, int]], list[float], list[int]]:
    count = draw(st.integers(2, 14))
    pictures = draw(st.lists(st.integers(0, 4), min_size=count, max_size=count))
    pairs = [(i, j) for i in range(count) for j in range(i + 1, count) if pictures[i] != pictures[j]]
    links = draw(st.lists(st.sampled_from(pairs), unique=True, max_size=25)) if pairs else []
    likeness = draw(st.permutations(np.linspace(0.5, 1.0, max(len(links), 1)).tolist()))
    return links, likeness[: len(links)], pictures


@settings(deadline=None)
@given(graph=graphs(), seed=st.integers(0, 100))
def test_order_of_links_does_not_matter(graph: tuple[list[tuple[int, int]], list[float], list[int]], seed: int) -> None:
    links, likeness, pictures = graph
    found = tracks_of(links, likeness, pictures)
    order = np.random.default_rng(seed).permutation(len(links))
    turned = [links[k][:: 1 if k % 2 else -1] for k in order]
    assert tracks_of(turned, [likeness[k] for k in order], pictures) == found
    members = [feature for track in found for feature in track]
    assert len(set(members)) == len(members)
    linked = {frozenset(link) for link in links}
    for track in found:
        assert len(track) > 1
        assert len({pictures[f] for f in track}) == len(track)
        reached, edges = {track[0]}, [link for link in linked if link <= set(track)]
        for _ in track:
            for edge in edges:
                reached |= edge if edge & reached else set()
        assert reached == set(track)
    if links:
        best = links[int(np.argmax(likeness))]
        assert any(set(best) <= set(track) for track in found)


def test_stars_begin_at_the_first() -> None:
    track, first, other = star([[4, 7, 1], [2, 3]])
    assert (track.tolist(), first.tolist(), other.tolist()) == ([0, 0, 1], [4, 4, 2], [7, 1, 3])
    assert [part.size for part in star([])] == [0, 0, 0]
