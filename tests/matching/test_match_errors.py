"""Scenes that cannot be matched, or hardly: one clear line; false matches, blocks and odd choices are no result."""

import math
import sys
from dataclasses import replace
from typing import Any

import matched
import numpy as np
import pytest
from outside import refuses
from scipy.stats import binom

from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation import OrientationCorrection, OrientationPrior
from mgsgraph.matching import match as module
from mgsgraph.matching.checks import PairSigns, _from_neighbours, checked_measures
from mgsgraph.matching.coarse import chance_agreements, corrected_scene
from mgsgraph.matching.match import finest_first, match_scene, one_per_window
from mgsgraph.matching.measuring import Measured, sharpened
from mgsgraph.matching.patches import Links, Tile, blur_sigmas, detect, opencv, ortho_patch
from mgsgraph.matching.scene import STEEP, STEPPED, Pair, Picture, Pixels, Scene, block_steps, require_unblocked
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


def test_without_opencv_the_way_to_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    nothing: Any = None
    for use in (lambda: detect(nothing, nothing, 1), lambda: sharpened(nothing)):
        refuses(r'matching: OpenCV .*; pip install "mgsgraph\[match\]"', use)


def test_pixels_of_the_wrong_shape() -> None:
    image = matched.scene().pictures[0].image
    refuses("640 lines x 1024 samples", Picture, image, np.zeros((1024, 640), dtype=np.uint8), matched.prior(100.0))


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


# --- noisy, doubled, uneven and hardly matched scenes, and odd choices


STEP = 4.0
"""m, pixel of the ground grid."""


def coarse_tile(scene: Scene, step: float) -> Tile:
    """A tile in the middle of the scene."""
    return Tile(0, -40.0 * step, -40.0 * step, step, 80, 80, 0)


def correlation(scene: Scene, tile: Tile) -> float:
    """Of both pictures on a tile, where both show it."""
    one, two = (ortho_patch(p, scene.ground, tile) for p in scene.pictures)
    assert one is not None
    assert two is not None
    both = (one.valid > 0) & (two.valid > 0)
    return float(np.corrcoef(one.grey[both].astype(float), two.grey[both])[0, 1])


def test_a_coarse_grid_averages_the_noise_of_finer_pictures() -> None:
    """As much as the pixels that go into one of the grid's: unfiltered, noise would stay what it is."""
    scene, rng = matched.true_scene(), np.random.default_rng(3)
    noisy = [
        replace(one, pixels=(one.pixels + 15.0 * rng.standard_normal(one.pixels.shape)).astype(np.float32))
        for one in scene.pictures
    ]
    tile = coarse_tile(scene, 4.0 * STEP)
    assert correlation(replace(scene, pictures=tuple(noisy)), tile) > 0.8


def test_the_filter_knows_places_without_a_neighbour() -> None:
    lines, samples = np.meshgrid(np.arange(5) * 16.0 * 4.0, np.arange(7) * 16.0 * 1.5, indexing="ij")
    nodes = np.stack([lines, samples], axis=2)
    nodes[:, 0] = np.nan  # beyond the picture, in every row
    assert blur_sigmas(nodes) == pytest.approx((0.5 * np.sqrt(15.0), 0.0))
    nodes[1:] = np.nan
    assert blur_sigmas(nodes) == (0.0, 0.0)


# above two seconds: a pair matched whole
def test_one_picture_given_twice_has_no_infinite_weight() -> None:
    """The same pixels under another name match without any residual."""
    scene = matched.scene()
    first = scene.pictures[0]
    twin = replace(first, image=replace(first.image, name="TWIN"))
    found = match_scene(replace(scene, pictures=(first, twin)), replace(matched.SETTINGS, cells=20, features=800))
    sigmas = np.linalg.eigvalsh(found.covariances[~found.reference])
    assert np.all(sigmas >= 0.9999 * 0.01**2)
    assert found.ties.measure_sigmas.min() > 0.005


def test_of_measures_in_one_window_the_surest_of_the_longest_track_stays() -> None:
    scene = matched.scene(3)
    anchors = np.array([[300.5, 500.5], [301.5, 500.5], [300.5, 500.5], [300.5, 500.5], [400.5, 500.5]])
    k = len(anchors)
    whole = np.zeros(k, dtype=np.int64)
    measured = Measured(
        np.array([0, 1, 2, 2, 3]), whole, np.array([1, 1, 1, 2, 1]), whole, anchors, anchors, np.zeros((k, 2, 2)),
        np.zeros((k, 2, 2)), np.ones(k), whole, np.ones(k, dtype=bool),
    )  # fmt: skip
    likeness = np.array([0.9, 0.95, 0.8, 0.7])
    kept = one_per_window(scene, measured, likeness, matched.SETTINGS, 10.0)  # half a window is 100 m
    assert kept.tolist() == [False, False, True, True, True]
    pair = measured.some(np.array([0, 1, 4]))
    kept = one_per_window(scene, pair, likeness, matched.SETTINGS, 10.0)
    assert kept.tolist() == [False, True, True]


def test_a_search_beyond_memory_is_refused() -> None:
    scene = matched.scene()
    with pytest.raises(InputError, match=r"ground to search either way, .* pixels of the coarse grid; .*--search"):
        match_scene(scene, replace(matched.SETTINGS, search=4.0 * 2100.0 * scene.step))


def test_the_finest_picture_is_the_reference() -> None:
    """Pictures about as fine stay in their order, whatever the order of the features."""
    scene = matched.scene()
    first, second = scene.pictures
    found = Links(np.zeros((2, 2)), np.array([0, 1]), np.array([[0, 1]]), np.ones(1))
    assert finest_first(scene, found, [[0, 1]]) == [[0, 1]]
    interior = first.image.interior
    image = replace(first.image, interior=replace(interior, focal_length=interior.focal_length / 3.0))
    coarse = replace(first, image=image)
    assert finest_first(replace(scene, pictures=(coarse, second)), found, [[0, 1]]) == [[1, 0]]


def test_a_handful_of_measures_is_not_believed() -> None:
    """They agree with some orientation, however wrong they are."""
    scene, ties = matched.scene(), matched.matches().ties
    names = np.array(ties.measure_image)
    anchors, places = (ties.measures[names == picture.image.name] for picture in scene.pictures)
    n = len(anchors)
    whole, square = np.zeros(n, dtype=np.int64), np.broadcast_to(np.eye(2), (n, 2, 2))
    all_of_them = Measured(
        np.arange(n), whole, whole + 1, whole, anchors, places, square, square, np.ones(n), whole, whole == 0
    )
    assert checked_measures(scene, all_of_them, STEP, 0).coplanar.mean() > 0.9
    assert not checked_measures(scene, all_of_them.some(np.arange(8)), STEP, 0).coplanar.any()


def test_points_of_two_runs_have_different_names() -> None:
    one, other = matched.matches(2).ties.ids, matched.matches(3).ties.ids
    assert not set(one) & set(other)


# --- false matches betray themselves together


NAN = math.nan
FALSE = [  # agreed, found again, cells filled, scatter: measured (docs/evidence_terrain.md)
    (9 / 134, 32 / 2341, 15 / 296, 7.4), (10 / 59, 18 / 1457, 9 / 2490, 9.1), (11 / 178, 65 / 2556, 24 / 274, 12.7),
    (7 / 48, 16 / 1760, 3 / 949, 4.6), (5 / 53, 13 / 1056, 8 / 353, 6.3), (155 / 166, 93 / 1041, 39 / 269, 4.1),
]  # fmt: skip
GOOD = [
    (300 / 309, 1781 / 1900, 236 / 237, 0.54), (102 / 110, 16 / 731, 11 / 222, 1.5),
    (24 / 54, 1202 / 1568, 402 / 650, 1.4), (42 / 52, 197 / 850, 108 / 251, 0.93),
    (14 / 27, 208 / 223, 29 / 30, 0.78), (NAN, 1156 / 1374, 448 / 985, 6.7),
]  # fmt: skip


def test_agreement_by_chance_is_the_binomial_law() -> None:
    for count, agreed, chance in ((40, 15, 0.1), (164, 16, 0.01), (30, 25, 0.3)):
        expected = math.comb(count, 5) * binom.sf(agreed - 6, count - 5, chance)
        assert chance_agreements(count, agreed, chance) == pytest.approx(expected, rel=1e-9)
    assert chance_agreements(164, 16, 0.008) > 1.0  # what an overlap of 25 pixels was matched on
    assert chance_agreements(27, 14, 0.01) < 1e-3
    assert chance_agreements(20, 5, 0.01) == math.inf


@pytest.mark.parametrize("signs", FALSE)
def test_false_pairs_show_two_signs_or_more(signs: tuple[float, ...]) -> None:
    assert PairSigns("A", "B", *signs).refused


@pytest.mark.parametrize("signs", GOOD)
def test_good_pairs_show_one_at_most(signs: tuple[float, ...]) -> None:
    assert not PairSigns("A", "B", *signs).refused


def test_jitter_is_no_scatter() -> None:
    """What neighbours have in common is taken off, noise stays."""
    rng, lines = np.random.default_rng(4), np.sort(np.random.default_rng(3).uniform(0.0, 4000.0, 800))
    noise, jitter = rng.normal(0.0, 0.5, 800), 4.0 * np.sin(2.0 * np.pi * lines / 320.0)
    order = rng.permutation(800)
    assert np.std(_from_neighbours(lines[order], (noise + jitter)[order])) < 0.75
    assert 0.45 < np.std(_from_neighbours(lines, noise)) < 0.65
    assert np.std(_from_neighbours(lines, rng.uniform(-4.0, 4.0, 800))) > 2.0
    few = np.array([1.0, 2.0])
    assert np.array_equal(_from_neighbours(few, few), few)


def blocked(pixels: Pixels, quality: int) -> Pixels:
    cv2 = opencv()
    _, packed = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE))


def test_blocks_are_seen_wherever_they_begin() -> None:
    for picture in matched.scene().pictures:
        clean = block_steps(picture.pixels)
        assert clean < 1.05
        strong, weak = (block_steps(blocked(picture.pixels, quality)[3:, 5:]) for quality in (12, 40))
        assert strong > STEEP > weak > STEPPED > block_steps(blocked(picture.pixels, 90)) > clean


def test_detectors_that_differ_are_no_blocks() -> None:
    """Columns read out in turns step along samples alone, and at more than one phase."""
    pixels = matched.scene().pictures[0].pixels.astype(np.float32)
    columns = np.arange(pixels.shape[1])
    assert block_steps(pixels + 20.0 * (columns % 2)) < 1.1
    assert block_steps(pixels + 40.0 * (columns % 8 == 3)) < 1.1
    holes = pixels.copy()
    holes[100:200] = np.nan
    assert block_steps(holes) < 1.1
    assert block_steps(pixels[:10]) == 1.0
    assert block_steps(np.full_like(pixels, np.nan)) == 1.0


def test_a_picture_of_blocks_is_refused_and_a_little_is_said() -> None:
    pixels = matched.scene().pictures[1].pixels
    with pytest.raises(InputError, match=r"picture of E02-01453: blocks of 8 x 8 pixels"):
        match_scene(with_second(blocked(pixels, 10)), matched.SETTINGS, workers=1)
    (caution,) = require_unblocked(with_second(blocked(pixels, 40)))
    assert "E02-01453" in caution
    assert not require_unblocked(matched.scene())


# above two seconds: a pair matched whole
def test_a_pair_that_shows_two_signs_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = replace(matched.SETTINGS, cells=20, features=800)
    monkeypatch.setattr(module, "pair_signs", lambda *_: [PairSigns("A", "B", *FALSE[0])])
    with pytest.raises(InputError, match=r"images A and B: \d+ matches that belong to no common ground: 7% of the"):
        match_scene(matched.scene(), settings, workers=1)
