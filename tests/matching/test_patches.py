"""Ortho patches on tiles and features in them: true places, one owner of each, pairs that are shifted alike."""

from dataclasses import replace
from typing import Any

import matched
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from mgsgraph.matching import patches as module
from mgsgraph.matching.checks import cell_numbers, spread
from mgsgraph.matching.patches import (
    Features,
    Links,
    Patch,
    Tile,
    Window,
    concatenated,
    detect,
    ortho_patch,
    owned,
    pair_up,
    tiling,
)
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


# --- tiles, links and cells


SIDES = st.floats(1.0, 9000.0)


@settings(deadline=None, max_examples=40)
@given(
    corners=st.lists(st.tuples(st.floats(-5e3, 5e3), st.floats(-5e3, 5e3), SIDES, SIDES), min_size=2, max_size=4),
    step=st.floats(0.5, 20.0), margin=st.floats(0.0, 300.0), seed=st.integers(0, 99),
)  # fmt: skip
def test_every_shared_place_has_one_owner(
    corners: list[tuple[float, ...]], step: float, margin: float, seed: int
) -> None:
    boxes = [np.array([[x, y], [x + width, y + height]]) for x, y, width, height in corners]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_SIZE", 200)
        tiles = tiling(boxes, step, margin)
    assert [tile.number for tile in tiles] == list(range(len(tiles)))
    drawn = np.random.default_rng(seed)
    places = np.concatenate([drawn.uniform(*box, (60, 2)) for box in boxes])
    shared = sum(np.all((places >= box[0]) & (places <= box[1]), axis=1).astype(int) for box in boxes) > 1
    owners = sum((tile.owns(places).astype(int) for tile in tiles), np.zeros(len(places), dtype=int))
    assert np.all(owners[shared] == 1)
    assert owners.max(initial=0) <= 1
    for tile in tiles:
        assert tile.margin * step >= margin - 1e-6
        assert tile.rows - 2 * tile.margin <= 202
        assert tile.columns - 2 * tile.margin <= 202
        mine = places[tile.owns(places)]
        first, last = tile.plane(np.array([0.0, tile.columns - 1.0]), np.array([0.0, tile.rows - 1.0]))
        assert np.all(mine - first >= margin - 0.51 * step)
        assert np.all(last - mine >= margin - 0.51 * step)


def links(seed: int, count: int) -> Links:
    rng = np.random.default_rng(seed)
    numbers = np.column_stack([np.arange(count), count + rng.permutation(count)])
    return Links(rng.uniform(0.0, 100.0, (2 * count, 2)), np.repeat([0, 1], count), numbers, rng.uniform(size=count))


def test_links_of_tiles_are_numbered_through() -> None:
    parts = [links(1, 5), concatenated([]), links(2, 3)]
    whole = concatenated(parts)
    np.testing.assert_array_equal(whole.plane[whole.links], np.concatenate([p.plane[p.links] for p in parts]))
    np.testing.assert_array_equal(whole.picture[whole.links], [[0, 1]] * 8)
    np.testing.assert_array_equal(whole.likeness, np.concatenate([p.likeness for p in parts]))
    assert [len(column) for column in concatenated([])] == [0, 0, 0, 0]
    assert set(whole._asdict()) == set(Links._fields)


def test_a_tile_keeps_the_links_that_begin_in_it() -> None:
    tile = module.Tile(0, 0.0, 0.0, 1.0, 60, 60, 0)
    all_links = links(3, 40)
    kept = owned(all_links, tile)
    inside = tile.owns(all_links.plane[all_links.links[:, 0]])
    assert 0 < inside.sum() < 40
    np.testing.assert_array_equal(kept.plane[kept.links], all_links.plane[all_links.links[inside]])
    np.testing.assert_array_equal(kept.likeness, all_links.likeness[inside])
    assert len(kept.plane) == 2 * inside.sum()  # no place without a link


@settings(deadline=None)
@given(
    rows=st.lists(st.tuples(st.integers(0, 4), st.integers(0, 2), st.floats(0.0, 1.0)), max_size=60),
    most=st.integers(1, 4),
)
def test_the_best_of_each_cell_and_pair_are_kept(rows: list[tuple[int, int, float]], most: int) -> None:
    cells, pairs, quality = (np.array([row[k] for row in rows]) for k in range(3))
    kept = spread(cells.astype(np.int64), pairs.astype(np.int64), quality.astype(float), most)
    for group in {row[:2] for row in rows}:
        mine = np.flatnonzero((cells == group[0]) & (pairs == group[1]))
        chosen = mine[kept[mine]]
        assert chosen.size == min(most, mine.size)
        assert sorted(quality[chosen]) == sorted(quality[mine])[: chosen.size]
    assert kept.size == len(rows)


def test_cells_are_squares_of_the_chart() -> None:
    rng = np.random.default_rng(1)
    plane = rng.uniform(-5e5, 5e5, (400, 2))
    same = np.floor(plane / 7e4)
    numbers = cell_numbers(plane, 7e4)
    assert np.array_equal(numbers[:, None] == numbers, np.all(same[:, None] == same, axis=2))


def test_nodes_are_the_same_on_all_tiles() -> None:
    """Those of neighbours coincide where they share ground."""
    spacing, found = 37.0, []
    for tile in (Tile(0, -100.0, -60.0, 4.0, 80, 90, 8), Tile(1, 196.0, -60.0, 4.0, 80, 90, 8)):
        rows, columns = (axis.ravel() for axis in np.meshgrid(*tile.nodes(spacing), indexing="ij"))
        plane = tile.plane(columns.astype(float), rows.astype(float))
        assert np.abs(plane - np.rint(plane / spacing) * spacing).max() <= 2.0 + 1e-9
        assert rows.min() >= 0
        assert rows.max() < 80
        assert columns.max() < 90
        found.append({tuple(place) for place in plane.tolist()})
    shared = {place for place in found[0] | found[1] if 196.0 <= place[0] <= 256.0}
    assert len(shared) > 3
    assert all(place in found[0] for place in shared)
    assert all(place in found[1] for place in shared)


# --- features of patches and their pairing


TILE = Tile(0, 1000.0, -500.0, 4.0, 300, 340, 0)
ANYWHERE = Window(np.array([0.0, 1.0]), 1e6, 1e6)


def patch(seed: int = 1, shift: tuple[int, int] = (0, 0)) -> Patch:
    """Blobs of three to six pixels; shifted by rows and columns."""
    rng = np.random.default_rng(seed)
    grey = sum(gaussian_filter(rng.standard_normal((400, 440)), size) * size for size in (2.0, 4.0))
    grey = grey[50 - shift[0] : 350 - shift[0], 50 - shift[1] : 390 - shift[1]]
    return Patch(np.clip(128.0 + 150.0 * grey, 0, 255).astype(np.uint8), np.full(grey.shape, 255, dtype=np.uint8))


def made(plane: list[list[float]], descriptors: list[int], **other: Any) -> Features:
    """Features whose descriptors are axes."""
    n = len(plane)
    columns = {"response": np.ones(n), "size": np.full(n, 4.0), "direction": np.zeros(n), **other}
    thin = {name: np.asarray(values, dtype=np.float32) for name, values in columns.items()}
    return Features(np.array(plane), **thin, descriptors=np.eye(128, dtype=np.float32)[descriptors])


def test_features_of_a_shifted_patch_match_their_originals() -> None:
    one, other = detect(patch(), TILE, 500), detect(patch(shift=(5, -3)), TILE, 500)
    window = Window(np.array([0.0, 1.0]), 40.0, 40.0)
    first, second, likeness = pair_up(one, other, window, TILE.step, 0.85)
    assert first.size > 0.7 * len(one.plane) > 100
    moved = (other.plane[second] - one.plane[first]) / TILE.step - [-3.0, 5.0]
    assert np.mean(np.abs(moved).max(axis=1) < 0.5) > 0.97
    assert np.median(likeness) > 0.97
    assert np.unique(first).size == first.size
    assert np.unique(second).size == second.size


def test_features_lie_where_the_patch_says_and_come_in_order() -> None:
    grey = np.full((300, 340), 100.0)
    rows, columns = np.mgrid[0:300, 0:340]
    grey += 120.0 * np.exp(-((rows - 80) ** 2 + (columns - 210) ** 2) / 50.0)
    found = detect(Patch(grey.astype(np.uint8), np.full(grey.shape, 255, dtype=np.uint8)), TILE, 500)
    assert np.abs(found.plane - TILE.plane(np.array([210.0]), np.array([80.0]))).max() < 1.0
    many = detect(patch(), TILE, 500)
    assert np.all(np.diff(many.plane[:, 1]) >= 0.0)
    np.testing.assert_allclose(np.linalg.norm(many.descriptors, axis=1), 1.0, atol=1e-5)
    few = detect(patch(), TILE, 50)
    assert len(few.plane) <= 60 < len(many.plane)
    assert few.response.min() >= np.quantile(many.response, 0.5)


def test_features_keep_off_where_the_picture_ends() -> None:
    whole = patch()
    valid = whole.valid.copy()
    valid[:, :100] = 0
    found = detect(Patch(np.where(valid, whole.grey, 0).astype(np.uint8), valid), TILE, 2000)
    columns, rows = ((found.plane - [TILE.west, TILE.south]) / TILE.step).T
    assert len(found.plane) > 50
    assert columns.min() > 107.0
    assert rows.min() > 7.0
    assert rows.max() < TILE.rows - 8.0


@pytest.mark.parametrize("angle", [0.0, 0.6, 1.5708])
def test_windows_are_along_their_direction(angle: float) -> None:
    """Counterparts planted at the window's ends, inside and outside."""
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    window = Window(along, 100.0, 20.0)
    for away, found in (
        (99.0 * along, 1), (-99.0 * along, 1), (101.0 * along, 0), (19.0 * across, 1), (-21.0 * across, 0),
        (99.0 * along - 19.0 * across, 1),
    ):  # fmt: skip
        one, other = made([[500.0, 700.0]], [0]), made([(np.array([500.0, 700.0]) + away).tolist()], [0])
        assert pair_up(one, other, window, 4.0, 0.85)[0].size == found, away


def test_pairs_are_mutual() -> None:
    """Two features choose the same one, which chooses the more like of them."""
    descriptors = np.zeros((2, 128), dtype=np.float32)
    descriptors[0, :2], descriptors[1, :2] = (1.0, 0.0), (0.9, np.sqrt(0.19))
    one = made([[0.0, 0.0], [100.0, 5.0]], [0, 0])._replace(descriptors=descriptors)
    first, second, likeness = pair_up(one, made([[50.0, 2.0]], [0]), ANYWHERE, 4.0, 0.85)
    assert (first.tolist(), second.tolist()) == ([0], [0])
    assert likeness[0] == pytest.approx(1.0)


def test_a_choice_has_to_be_clear() -> None:
    descriptors = np.zeros((2, 128), dtype=np.float32)
    descriptors[0, :2], descriptors[1, :2] = (0.95, np.sqrt(1.0 - 0.95**2)), (0.94, np.sqrt(1.0 - 0.94**2))
    one = made([[0.0, 0.0]], [0])
    apart = made([[0.0, 5.0], [0.0, 60.0]], [0, 0])._replace(descriptors=descriptors)
    assert pair_up(one, apart, ANYWHERE, 4.0, 0.85)[0].size == 0
    assert pair_up(one, apart, ANYWHERE, 4.0, 0.99)[1].tolist() == [0]
    twice = made([[0.0, 5.0], [0.0, 16.0]], [0, 0])._replace(descriptors=descriptors)  # the same blob in two sizes
    assert pair_up(one, twice, ANYWHERE, 4.0, 0.85)[1].tolist() == [0]


@pytest.mark.parametrize(
    ("change", "found"),
    [({"direction": [0.4]}, 1), ({"direction": [0.6]}, 0), ({"direction": [6.2]}, 1), ({"size": [6.0]}, 1),
     ({"size": [7.0]}, 0), ({"size": [2.0]}, 0)],
)  # fmt: skip
def test_direction_and_size_are_alike(change: dict[str, list[float]], found: int) -> None:
    one, other = made([[0.0, 0.0]], [0]), made([[1.0, 1.0]], [0], **change)
    assert pair_up(one, other, ANYWHERE, 4.0, 0.85)[0].size == found
