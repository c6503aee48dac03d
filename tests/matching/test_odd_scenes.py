"""Noisy, doubled, uneven and hardly matched scenes, and odd choices."""

from dataclasses import replace

import matched
import numpy as np
import pytest

from mgsgraph.errors import InputError
from mgsgraph.matching.checks import checked_measures
from mgsgraph.matching.coarse import search_radius
from mgsgraph.matching.match import finest_first, match_scene, one_per_window
from mgsgraph.matching.measuring import Measured
from mgsgraph.matching.patches import Links, Tile, blur_sigmas, ortho_patch
from mgsgraph.matching.scene import Scene
from mgsgraph.results.matching import match_statements

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


def test_one_picture_given_twice_has_no_infinite_weight() -> None:
    """The same pixels under another name match without any residual."""
    scene = matched.scene()
    first = scene.pictures[0]
    twin = replace(first, image=replace(first.image, name="TWIN"))
    found = match_scene(replace(scene, pictures=(first, twin)), replace(matched.SETTINGS, cells=20, features=800))
    sigmas = np.linalg.eigvalsh(found.covariances[~found.reference])
    assert np.all(sigmas >= 0.9999 * 0.01**2)
    assert found.ties.measure_sigmas.min() > 0.005


def test_no_measure_is_given_twice() -> None:
    """Two features beside one sharp pixel are measured at that pixel, both."""
    found = matched.matches()
    anchors = found.ties.measures[found.reference]
    assert len(np.unique(anchors, axis=0)) == len(anchors)


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


def test_a_correction_beyond_what_was_stated_is_said() -> None:
    found = matched.matches()
    scene = matched.scene()
    agreement = found.agreements[0]
    assert agreement.expected == pytest.approx(search_radius(*scene.pictures, scene) / 3.0)
    surprising = replace(found, agreements=(agreement._replace(expected=agreement.moved / 5.0),))
    assert "5 TIMES ITS A-PRIORI SIGMA" in match_statements(surprising, scene)[0]
    assert "TIMES" not in match_statements(replace(found, agreements=(agreement._replace(expected=np.nan),)), scene)[0]


def test_points_of_two_runs_have_different_names() -> None:
    one, other = matched.matches(2).ties.ids, matched.matches(3).ties.ids
    assert not set(one) & set(other)
