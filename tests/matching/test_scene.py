"""Pictures over a ground: from pixels to the chart and back, derivatives, parallax, and pictures that show nothing."""

from dataclasses import replace

import matched
import numpy as np
import pytest

from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.matching.scene import Picture, Pixels

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
