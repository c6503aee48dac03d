"""Tiles: every place that two images share is one tile's own; links are numbered through; cells are evenly filled."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mgsgraph.matching import patches as module
from mgsgraph.matching.checks import cell_numbers, spread
from mgsgraph.matching.patches import Links, Tile, owned, tiling, together

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


def test_tiles_of_one_image_alone_are_left_out() -> None:
    boxes = [np.array([[0.0, 0.0], [1e3, 1e5]]), np.array([[0.0, 0.0], [1e3, 5e3]])]
    tiles = tiling(boxes, 1.0, 10.0)
    assert 5 <= len(tiles) <= 6


def links(seed: int, count: int) -> Links:
    rng = np.random.default_rng(seed)
    numbers = np.column_stack([np.arange(count), count + rng.permutation(count)])
    return Links(rng.uniform(0.0, 100.0, (2 * count, 2)), np.repeat([0, 1], count), numbers, rng.uniform(size=count))


def test_links_of_tiles_are_numbered_through() -> None:
    parts = [links(1, 5), together([]), links(2, 3)]
    whole = together(parts)
    np.testing.assert_array_equal(whole.plane[whole.links], np.concatenate([p.plane[p.links] for p in parts]))
    np.testing.assert_array_equal(whole.picture[whole.links], [[0, 1]] * 8)
    np.testing.assert_array_equal(whole.likeness, np.concatenate([p.likeness for p in parts]))
    assert [len(column) for column in together([])] == [0, 0, 0, 0]
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
