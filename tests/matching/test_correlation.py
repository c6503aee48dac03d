"""Matches at a grid's nodes: windows are found where they went, clear ones alone."""

from dataclasses import replace

import matched
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from mgsgraph.matching.coarse import window
from mgsgraph.matching.patches import Patch, Tile
from mgsgraph.matching.settings import MatchSettings
from mgsgraph.matching.tiles import correlation_peaks, links_on_grid, matched_nodes, tiling

SETTINGS = MatchSettings(method="grid", half_window=8)


def patch(shift: tuple[int, int] = (0, 0), seed: int = 1, noise: float = 0.0) -> Patch:
    rng = np.random.default_rng(seed)
    grey = gaussian_filter(rng.standard_normal((200, 220)), 1.0)[30 - shift[0] : 170 - shift[0], :][:, 30 - shift[1] :]
    grey = 128.0 + 250.0 * grey[:, :150] + noise * np.random.default_rng(seed + 1).standard_normal((140, 150))
    return Patch(np.clip(grey, 0, 255).astype(np.uint8), np.full(grey.shape, 255, dtype=np.uint8))


def nodes(patch: Patch, spacing: int = 12) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = np.mgrid[10 : patch.grey.shape[0] : spacing, 10 : patch.grey.shape[1] : spacing]
    return rows.ravel().astype(np.int64), columns.ravel().astype(np.int64)


@pytest.mark.parametrize("shift", [(0, 0), (3, -4), (-5, 2)])
def test_windows_are_found_where_they_went(shift: tuple[int, int]) -> None:
    one, other = patch(), patch(shift, noise=5.0)
    rows, columns = nodes(one)
    chosen, shifts, score = matched_nodes(one, other, rows, columns, (6, 6), SETTINGS)
    inner = np.ones(rows.size, dtype=bool)
    for axis, by, size in zip((rows, columns), shift, one.grey.shape, strict=True):
        inner &= (np.minimum(axis, axis + by) >= 8) & (np.maximum(axis, axis + by) + 8 < size)
    assert chosen.tolist() == np.flatnonzero(inner).tolist()
    assert np.all(shifts == shift)
    assert score.min() > 0.9


def test_scores_are_correlation_coefficients() -> None:
    one, other = patch(), patch((2, 1), noise=20.0)
    rows, columns = nodes(one)
    shifts, best, second = correlation_peaks(one.grey, one.valid, other.grey, other.valid, rows, columns, 6, 4, 4)
    for k in np.flatnonzero(best > 0.0)[:8]:
        r, c = rows[k], columns[k]
        mine = one.grey[r - 6 : r + 7, c - 6 : c + 7].ravel()
        scores = {
            (i, j): np.corrcoef(mine, window.ravel())[0, 1]
            for i in range(-4, 5) for j in range(-4, 5)
            if r + i >= 6 and c + j >= 6
            and (window := other.grey[r + i - 6 : r + i + 7, c + j - 6 : c + j + 7]).shape == (13, 13)
        }  # fmt: skip
        top = max(scores, key=lambda shift: scores[shift])
        assert tuple(shifts[k]) == top
        assert best[k] == pytest.approx(scores[top], abs=1e-9)
        rest = max(v for (i, j), v in scores.items() if abs(i - top[0]) > 2 or abs(j - top[1]) > 2)
        assert second[k] == pytest.approx(rest, abs=1e-9)


def test_a_pattern_that_repeats_is_no_match() -> None:
    rows, columns = np.mgrid[0:140, 0:150]
    grey = (128 + 60 * np.sin(rows * 2 * np.pi / 7) * np.sin(columns * 2 * np.pi / 7)).astype(np.uint8)
    rng = np.random.default_rng(1)
    one, other = (
        Patch(grey + rng.integers(0, 6, grey.shape, dtype=np.uint8), np.full(grey.shape, 255, dtype=np.uint8))
        for _ in range(2)
    )
    assert matched_nodes(one, other, *nodes(one), (8, 8), SETTINGS)[0].size == 0
    assert matched_nodes(one, other, *nodes(one), (3, 3), SETTINGS)[0].size > 50


def test_other_ground_and_bare_ground_are_no_match() -> None:
    one, bare = patch(), Patch(np.full((140, 150), 90, dtype=np.uint8), np.full((140, 150), 255, dtype=np.uint8))
    assert matched_nodes(one, patch(seed=5), *nodes(one), (6, 6), SETTINGS)[0].size == 0
    for pair in ((one, bare), (bare, one)):
        assert matched_nodes(*pair, *nodes(one), (6, 6), SETTINGS)[0].size == 0


def test_windows_do_not_reach_into_what_is_missing() -> None:
    one, other = patch(), patch((1, 1))
    other.valid[:, 70:] = 0
    rows, columns = nodes(one)
    chosen, _, _ = matched_nodes(one, other, rows, columns, (3, 3), SETTINGS)
    assert chosen.size > 20
    assert columns[chosen].max() <= 70 - 1 - 1 - 8


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


def test_links_of_a_scene_are_true() -> None:
    scene = matched.true_scene()
    corners = scene.ground.chart.plane(matched.inner())
    (tile,) = tiling([np.stack([corners.min(axis=0), corners.max(axis=0)])] * 2, 4.0, 100.0)
    near = window(*scene.pictures, scene, 5.0, 16.0)
    links = links_on_grid(scene, tile, (0, 1), {(0, 1): near}, replace(SETTINGS, half_window=9))
    assert len(links.links) > 100
    assert np.all(links.picture[links.links] == [0, 1])
    first, second = (links.plane[links.links[:, k]] for k in (0, 1))
    assert np.all(tile.owns(first))
    assert np.quantile(np.abs(second - first), 0.95) <= 4.0  # the very ground: a pixel
    nodes = np.unique(first, axis=0)
    assert len(nodes) == len(first)
