"""Ortho patches: both pictures show the same, where the orientation is true."""

from dataclasses import replace

import matched
import numpy as np
import pytest

from mgsgraph.matching.patches import Patch, Tile, ortho_patch
from mgsgraph.matching.scene import Picture, Scene


def middle_tile(scene: Scene, rows: int = 300, columns: int = 500, step: float = 4.0) -> Tile:
    west, south = scene.ground.chart.plane(matched.inner()).mean(axis=0) - 0.5 * step * np.array([columns, rows])
    return Tile(0, float(west), float(south), step, rows, columns, 20)


def patch_of(scene: Scene, picture: Picture, tile: Tile) -> Patch:
    found = ortho_patch(picture, scene.ground, tile)
    assert found is not None
    return found


def likeness(one: Patch, other: Patch) -> float:
    both = (one.valid > 0) & (other.valid > 0)
    assert both.mean() > 0.5
    return float(np.corrcoef(one.grey[both], other.grey[both])[0, 1])


def test_true_orientations_show_the_same_pixel_by_pixel() -> None:
    scene = matched.true_scene()
    tile = middle_tile(scene)
    one, other = (patch_of(scene, picture, tile) for picture in scene.pictures)
    assert likeness(one, other) > 0.9
    assert likeness(one, Patch(np.roll(other.grey, 2, axis=0), other.valid)) < 0.9
    nominal = matched.scene()
    assert likeness(*(patch_of(nominal, picture, tile) for picture in nominal.pictures)) < 0.3  # 229 m off


@pytest.mark.parametrize("number", [0, 1])
def test_a_patch_has_the_picture_s_grey_values_where_it_says(number: int) -> None:
    scene = matched.true_scene()
    picture, tile = scene.pictures[number], middle_tile(scene)
    patch = patch_of(scene, picture, tile)
    row, column = np.random.default_rng(1).integers(0, [tile.rows, tile.columns], (500, 2)).T
    places = picture.project(scene.ground.points(tile.plane(column.astype(float), row.astype(float))))
    inside = np.all((places > 3.0) & (places < np.array(picture.pixels.shape) - 3.0), axis=1)
    assert np.all(patch.valid[row[inside], column[inside]] == 255)
    line, sample = np.floor(places[inside]).astype(int).T
    low, high = picture.levels
    shown = np.clip((picture.pixels[line, sample] - low) * 255.0 / (high - low), 0.0, 255.0)
    assert np.corrcoef(shown, patch.grey[row[inside], column[inside]])[0, 1] > 0.9


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("axis", [0, 1])
def test_pixels_are_resampled_where_their_centres_are(number: int, axis: int) -> None:
    """A picture whose grey values are its own lines, or samples: pixels' centres have halves."""
    scene = matched.true_scene()
    tile = middle_tile(scene, rows=40, columns=40)
    ramp = np.indices(scene.pictures[number].pixels.shape)[axis].astype(np.float32) + 0.5
    picture = replace(scene.pictures[number], pixels=ramp)
    columns, rows = np.meshgrid(np.arange(40.0), np.arange(40.0))
    true = picture.project(scene.ground.points(tile.plane(columns.ravel(), rows.ravel())))[:, axis]
    low = float(np.median(true)) - 25.0
    vars(picture)["levels"] = (low, low + 51.0)  # in place of those that would be found, which are too coarse
    patch = ortho_patch(picture, scene.ground, tile)
    assert patch is not None
    inside = (true > low + 1.0) & (true < low + 50.0)
    assert inside.sum() > 300
    off = patch.grey.ravel()[inside] * 0.2 + low - true[inside]
    assert np.median(off) == pytest.approx(-0.1, abs=0.05)  # grey values are cut, not rounded
    assert np.quantile(np.abs(off), 0.95) < 0.35  # places between nodes are interpolated


def test_pixels_that_are_missing_are_not_valid() -> None:
    scene = matched.true_scene()
    tile = middle_tile(scene)
    whole = patch_of(scene, scene.pictures[0], tile)
    hollow = scene.pictures[0].pixels.astype(np.float32)
    hollow[250:330, 400:500] = np.nan
    part = patch_of(scene, replace(scene.pictures[0], pixels=hollow), tile)
    lost = (whole.valid > 0) & (part.valid == 0)
    row, column = np.nonzero(lost)
    places = scene.pictures[0].project(scene.ground.points(tile.plane(column.astype(float), row.astype(float))))
    assert np.all((places > [246.9, 396.9]) & (places < [333.1, 503.1]))
    assert lost.sum() == pytest.approx(84 * 104 * 4.41 * 2.8 / 16.0, rel=0.05)
    far = (whole.valid > 0) & (part.valid > 0)
    assert np.abs(whole.grey[far].astype(int) - part.grey[far]).max() < 2  # the levels differ a little
    assert np.all(part.grey[part.valid == 0] == 0)


def test_places_outside_the_picture_are_not_valid() -> None:
    scene = matched.true_scene()
    tile = middle_tile(scene, rows=700, columns=1100)
    patch = patch_of(scene, scene.pictures[1], tile)
    rows, columns = np.mgrid[0:700:7, 0:1100:7]
    places = scene.pictures[1].project(scene.ground.points(tile.plane(columns.ravel() * 1.0, rows.ravel() * 1.0)))
    size = np.array(scene.pictures[1].pixels.shape)
    inside = np.all((places > 0.0) & (places < size), axis=1)
    deep = np.all((places > 1.5) & (places < size - 1.5), axis=1)
    valid = patch.valid[rows.ravel(), columns.ravel()] > 0
    assert 0.2 < inside.mean() < 0.8
    assert not np.any(valid & ~inside)
    assert np.all(valid[deep])


def test_tiles_elsewhere_show_nothing() -> None:
    scene = matched.true_scene()
    for east in (30e3, 4e6, 9e6):  # beside the picture, behind the horizon, beyond the antipode
        tile = middle_tile(scene)._replace(west=east)
        assert ortho_patch(scene.pictures[0], scene.ground, tile) is None


def test_tiles_own_what_lies_without_their_margin() -> None:
    tile = Tile(0, -100.0, 50.0, 2.0, 60, 80, 10)
    columns = np.array([9.4, 9.6, 69.4, 69.6, 40.0, 40.0])
    rows = np.array([30.0, 30.0, 30.0, 30.0, 9.4, 49.4])
    assert tile.owns(tile.plane(columns, rows)).tolist() == [False, True, True, False, False, True]
