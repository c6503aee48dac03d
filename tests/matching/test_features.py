"""Features of patches and their pairing: what is shifted is found again, what lies outside the window is not."""

from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from mgsgraph.matching.patches import Features, Patch, Tile, Window, detect, pair_up

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


def test_a_better_one_outside_the_window_is_not_seen() -> None:
    one = made([[0.0, 0.0]], [0])
    weaker = np.zeros((2, 128), dtype=np.float32)
    weaker[0, :2] = 0.8, 0.6  # the right one, in the window; the other is the very same, outside
    weaker[1, 0] = 1.0
    other = made([[5.0, 10.0], [5.0, 300.0]], [0, 0])._replace(descriptors=weaker)
    near = Window(np.array([0.0, 1.0]), 50.0, 20.0)
    assert pair_up(one, other, near, 4.0, 0.85)[1].tolist() == [0]
    assert pair_up(one, other, ANYWHERE, 4.0, 0.85)[1].tolist() == [1]


def test_pairs_are_mutual() -> None:
    """Two features choose the same one, which chooses the more like of them."""
    descriptors = np.zeros((2, 128), dtype=np.float32)
    descriptors[0, :2], descriptors[1, :2] = (1.0, 0.0), (0.9, np.sqrt(0.19))
    one = made([[0.0, 0.0], [100.0, 5.0]], [0, 0])._replace(descriptors=descriptors)
    first, second, likeness = pair_up(one, made([[50.0, 2.0]], [0]), ANYWHERE, 4.0, 0.85)
    assert (first.tolist(), second.tolist()) == ([0], [0])
    assert likeness[0] == pytest.approx(1.0)


def test_a_choice_has_to_be_clear() -> None:
    alike = np.zeros((2, 128), dtype=np.float32)
    alike[0, :2], alike[1, :2] = (0.95, np.sqrt(1.0 - 0.95**2)), (0.94, np.sqrt(1.0 - 0.94**2))
    one = made([[0.0, 0.0]], [0])
    apart = made([[0.0, 5.0], [0.0, 60.0]], [0, 0])._replace(descriptors=alike)
    assert pair_up(one, apart, ANYWHERE, 4.0, 0.85)[0].size == 0
    assert pair_up(one, apart, ANYWHERE, 4.0, 0.99)[1].tolist() == [0]
    twice = made([[0.0, 5.0], [0.0, 16.0]], [0, 0])._replace(descriptors=alike)  # the same blob in two sizes
    assert pair_up(one, twice, ANYWHERE, 4.0, 0.85)[1].tolist() == [0]


@pytest.mark.parametrize(
    ("change", "found"),
    [({"direction": [0.4]}, 1), ({"direction": [0.6]}, 0), ({"direction": [6.2]}, 1), ({"size": [6.0]}, 1),
     ({"size": [7.0]}, 0), ({"size": [2.0]}, 0)],
)  # fmt: skip
def test_direction_and_size_are_alike(change: dict[str, list[float]], found: int) -> None:
    one, other = made([[0.0, 0.0]], [0]), made([[1.0, 1.0]], [0], **change)
    assert pair_up(one, other, ANYWHERE, 4.0, 0.85)[0].size == found
