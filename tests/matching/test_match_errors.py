"""Images that cannot be matched end in one clear line."""

import sys
from dataclasses import replace
from typing import Any

import matched
import numpy as np
import pytest

from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation import OrientationCorrection, OrientationPrior
from mgsgraph.matching.coarse import corrected_scene
from mgsgraph.matching.match import match_scene
from mgsgraph.matching.measuring import sharpened
from mgsgraph.matching.patches import Links, detect
from mgsgraph.matching.scene import Pair, Picture, Pixels, Scene
from mgsgraph.matching.settings import MatchSettings
from mgsgraph.simulation.ground import make_terrain
from mgsgraph.simulation.imagery import render

SETTINGS = replace(matched.SETTINGS, cells=20, features=800)


def refused(scene: Scene, *said: str, settings: MatchSettings = SETTINGS) -> None:
    with pytest.raises(InputError) as caught:
        match_scene(scene, settings, workers=1)
    assert "\n" not in str(caught.value)
    for words in said:
        assert words in str(caught.value)


def with_second(pixels: Pixels | None = None, **changes: object) -> Scene:
    """The pair with another second picture."""
    scene = matched.scene()
    first, second = scene.pictures
    if pixels is not None:
        changes["pixels"] = pixels
    return replace(scene, pictures=(first, replace(second, **changes)))  # type: ignore[arg-type]


def test_images_without_overlap() -> None:
    aside = OrientationCorrection(np.array([[0.0, 0.0, 0.0, 0.0, 0.05, 0.0]]))
    refused(with_second(correction=aside), "E02-00665, E02-01453: no two of them overlap", "check the images")


def test_an_image_that_sees_nothing_of_the_body() -> None:
    away = OrientationCorrection(np.array([[0.0, 0.0, 0.0, 2.0, 0.0, 0.0]]))
    scene = matched.scene(3)
    pictures = (*scene.pictures[:2], replace(scene.pictures[2], correction=away))
    lost = replace(scene, pictures=pictures)
    refused(lost, "E02-00665B", "nothing of the body", settings=replace(SETTINGS, step=4.0))


def test_a_picture_that_is_saturated_in_half() -> None:
    """Refused where more than half is; with less, matches keep off it."""
    pixels = matched.scene().pictures[1].pixels.copy()
    pixels[: int(0.55 * matched.LINES)] = 255
    refused(with_second(pixels), "picture of E02-01453: 5", "at the brightest value, 255")
    edge = int(0.45 * matched.LINES)
    pixels = matched.scene().pictures[1].pixels.copy()
    pixels[:edge] = 255
    found = match_scene(with_second(pixels), SETTINGS, workers=1)
    second = np.array([name == "E02-01453" for name in found.ties.measure_image])
    assert found.ties.measures[second, 0].min() > edge
    assert np.linalg.norm(matched.errors(found), axis=1).max() < 1.5


def test_pictures_of_different_ground() -> None:
    """Two terrains that have nothing to do with each other, under the same Sun: not a single match."""
    image = matched.site().images[1]
    other = render(image.true, make_terrain("gusev", 7), None, image.sun, np.random.default_rng(1))
    refused(with_second(other), "of ", "agree on one orientation", "widen the search", settings=SETTINGS)


@pytest.mark.parametrize(
    ("height_sigma", "radius", "count"), [(100.0, 160.0, 1500), (1000.0, 900.0, 1500), (1000.0, 160.0, 60)]
)
def test_what_agrees_by_chance_does_not_count(height_sigma: float, radius: float, count: int) -> None:
    """Links from anywhere to anywhere within the search: the more there are, and the less is known, the more agree."""
    scene = matched.scene()
    scene = replace(scene, ground=replace(scene.ground, height_sigma=height_sigma))
    plane = scene.ground.chart.plane(matched.inner(800))
    first, second = np.random.default_rng(2).integers(0, len(plane), (2, 200_000))
    near = np.flatnonzero(np.abs(plane[second] - plane[first]).max(axis=1) < radius)[:count]
    assert near.size == count
    numbers = np.arange(count)
    links = Links(
        np.concatenate([plane[first[near]], plane[second[near]]]), np.repeat([0, 1], count),
        np.column_stack([numbers, count + numbers]), np.ones(count),
    )  # fmt: skip
    with pytest.raises(InputError, match=f"of {count} matches on a coarse grid"):
        corrected_scene(scene, Pair(0, 1, 1.0), links, 16.0, radius, np.random.default_rng(0))
    true = links._replace(plane=np.concatenate([plane[first[near]]] * 2))
    assert corrected_scene(scene, Pair(0, 1, 1.0), true, 16.0, radius, np.random.default_rng(0))[1].agreed == count


def test_unknown_orientation_needs_a_search() -> None:
    unknown = OrientationPrior(np.full((1, 6), np.inf))
    scene = with_second(prior=unknown)
    refused(scene, "image E02-01453: an infinite a-priori sigma of its orientation", "--search METRES")
    found = match_scene(scene, replace(SETTINGS, search=700.0), workers=1)
    assert np.linalg.norm(matched.errors(found), axis=1).max() < 1.5


def test_nothing_that_stands_the_checks() -> None:
    refused(
        matched.scene(), "matching: no match is left of ", "images that look alike",
        settings=replace(SETTINGS, least_correlation=0.99999),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("step", 0.0, "matching, step: 0.0; expected a positive number"),
        ("half_window", 3, "matching, half_window: 3; expected at least 4"),
        ("ratio", 1.0, "matching, ratio: 1.0; expected a number between 0 and 1"),
        ("least_correlation", float("nan"), "matching, least_correlation"),
    ],
)
def test_choices_are_checked(key: str, value: object, said: str) -> None:
    with pytest.raises(InputError) as caught:
        MatchSettings(**{key: value})  # type: ignore[arg-type]
    assert said in str(caught.value)


def test_without_opencv_the_way_to_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    nothing: Any = None
    for use in (lambda: detect(nothing, nothing, 1), lambda: sharpened(nothing)):
        with pytest.raises(InputError, match=r'matching: OpenCV .*; pip install "mgsgraph\[match\]"'):
            use()


def test_pixels_of_the_wrong_shape() -> None:
    image = matched.scene().pictures[0].image
    with pytest.raises(InputError, match="640 lines x 1024 samples"):
        Picture(image, np.zeros((1024, 640), dtype=np.uint8), matched.prior(100.0))


# above two seconds: three pairs are matched, one of them to nothing
def test_a_picture_of_other_ground_is_left_out_and_named() -> None:
    scene = matched.scene(3)
    strange = render(
        matched.site().images[0].true, make_terrain("gusev", 77), None, matched.site().images[0].sun,
        np.random.default_rng(3),
    )  # fmt: skip
    third = replace(scene.pictures[2], pixels=strange)
    found = match_scene(replace(scene, pictures=(*scene.pictures[:2], third)), SETTINGS, workers=1)
    assert set(found.ties.measure_image) == {picture.image.name for picture in scene.pictures[:2]}
    assert np.linalg.norm(matched.errors(found), axis=1).max() < 1.5
    assert len(found.refused) == 2
    assert all(third.image.name in reason for reason in found.refused)


def test_of_three_pictures_one_without_known_orientation_is_no_refusal() -> None:
    scene = matched.scene(3)
    third = replace(scene.pictures[2], prior=OrientationPrior(np.full((1, 6), np.inf)))
    refused(replace(scene, pictures=(*scene.pictures[:2], third)), "an infinite a-priori sigma", "--search METRES")
