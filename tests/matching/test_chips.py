"""Chips of tie points: patches of a known ground, the shift that was planted, masks, and what an outsider computes."""

from dataclasses import replace

import numpy as np
import pytest
from chip_scene import PAIR, grey, inner, moved, picture, ties_at
from hypothesis import given, settings
from hypothesis import strategies as st
from outside import refuses

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import east_north
from mgsgraph.matching import chips as chips_module
from mgsgraph.matching.chips import (
    REACH,
    SIDE,
    chip_frames,
    chips,
    compare,
    likeness,
    misfit_beside_neighbours,
    stretched,
)

HALF = SIDE // 2


# --- the grids and the patches


def test_a_chip_shows_the_ground_of_its_grid() -> None:
    """Every chip pixel against the grey value of the place in the tangent plane that it is said to show."""
    ties = ties_at(inner(4))
    frames = chip_frames(PAIR.images, ties)
    for j in range(2):
        mine = np.flatnonzero(frames.image == j)
        patches = chips(picture(j), ties.measures[mine], frames.step[mine])
        middle = PAIR.images[j].image_to_ground(*ties.measures[mine].T)[0]
        for patch, place, spacing in zip(patches, middle, frames.spacing, strict=True):
            row, column = np.mgrid[-HALF : HALF + 1, -HALF : HALF + 1] * spacing
            east, north = east_north(place[None])[0]
            ground = place + column.ravel()[:, None] * east - row.ravel()[:, None] * north
            assert np.std(patch.ravel() - grey(ground)) < 0.12 * np.std(patch)  # bilinear, and the affine map


def test_the_grid_is_that_of_the_coarsest_image() -> None:
    ties = ties_at(inner(3))
    frames = chip_frames(PAIR.images, ties)
    size = 1.0 / np.sqrt(np.abs(np.linalg.det(frames.step)))  # chip pixels per pixel
    assert np.allclose(np.maximum(size[::2], size[1::2]), 1.0)
    assert np.allclose(frames.skew, 0.0, atol=1e-3)
    assert frames.reference.tolist() == [0, 2, 4]


def test_right_matches_are_alike() -> None:
    found = likeness(picture, (ties := ties_at(inner(8))), chip_frames(PAIR.images, ties))
    assert np.isnan(found.correlation[::2]).all()
    assert found.correlation[1::2].min() > 0.98
    assert np.abs(found.shift[1::2]).max() < 0.1
    assert not found.at_edge.any()


@pytest.mark.parametrize("by", [(2.0, -1.0), (-1.6, 0.7), (0.0, 2.4)])
def test_the_shift_leads_back_to_the_right_place(by: tuple[float, float]) -> None:
    """A measure off by some lines and samples: `step @ shift` says what must be added."""
    right = ties_at(inner(6))
    wrong = moved(right, np.arange(1, 12, 2), np.array(by))
    frames = chip_frames(PAIR.images, wrong)
    found = likeness(picture, wrong, frames)
    back = np.einsum("kij,kj->ki", frames.step, found.shift)[1::2]
    assert back == pytest.approx(np.tile(-np.array(by), (6, 1)), abs=0.12)
    assert (found.best[1::2] > found.correlation[1::2] + 0.05).all()


def test_finer_pixels_are_averaged() -> None:
    """White noise under chip pixels of three by three: a third of its sigma is left, not two thirds (bilinear)."""
    noise = np.random.default_rng(0).normal(100.0, 30.0, (400, 400))
    patch = chips(noise, np.array([[200.5, 200.5]]), 3.0 * np.eye(2)[None])[0]
    assert np.std(patch) == pytest.approx(10.0, rel=0.05)


def test_pixels_outside_are_none() -> None:
    patch = chips(np.ones((200, 100)), np.array([[10.2, 50.0]]), np.eye(2)[None])[0]
    outside = np.arange(SIDE) - HALF + 10.2 < 0.0
    assert np.isnan(patch[outside]).all()
    assert np.isfinite(patch[~outside]).all()
    assert stretched(patch[None])[0, 0, 0] == 0


def test_whole_steps_take_pixels_as_they_are() -> None:
    pixels = np.random.default_rng(2).integers(0, 256, (120, 130), dtype=np.uint8)
    patch = chips(pixels, np.array([[60.5, 70.5]]), np.eye(2)[None])[0]
    assert np.array_equal(patch, pixels[60 - HALF : 61 + HALF, 70 - HALF : 71 + HALF])


# --- correlation


def outsiders(first: np.ndarray, second: np.ndarray, row: int, column: int) -> float:
    """Correlation at one shift, as numpy has it."""
    size = first.shape[0]
    left = first[REACH:-REACH, REACH:-REACH].ravel()
    right = second[REACH + row : size - REACH + row, REACH + column : size - REACH + column].ravel()
    both = np.isfinite(left) & np.isfinite(right)
    return float(np.corrcoef(left[both], right[both])[0, 1])


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31), share=st.sampled_from([0.0, 0.1, 0.2]), offset=st.sampled_from([0.0, 1e4]))
def test_correlation_is_numpys_at_every_shift(seed: int, share: float, offset: float) -> None:
    rng = np.random.default_rng(seed)
    first, second = rng.normal(offset, 1.0, (2, 1, 21, 21))
    second += np.roll(first, (1, -2), axis=(1, 2))
    for one in (first, second):
        one[rng.random(one.shape) < share] = np.nan
    surface = chips_module._correlations(first, second)[0]
    for row, column in ((0, 0), (1, -2), (-3, 3), (2, 1)):
        assert surface[REACH + row, REACH + column] == pytest.approx(
            outsiders(first[0], second[0], row, column), abs=1e-7
        )


@settings(max_examples=20, deadline=None)
@given(gain=st.floats(0.1, 10.0), offset=st.floats(-100.0, 100.0))
def test_gain_and_offset_change_nothing(gain: float, offset: float) -> None:
    first, second = np.random.default_rng(4).normal(100.0, 20.0, (2, 3, 25, 25))
    before, after = compare(first, second), compare(gain * first + offset, second)
    for one, other in zip(before, after, strict=True):
        assert np.asarray(other, dtype=float) == pytest.approx(np.asarray(one, dtype=float), abs=1e-8)


def test_flat_and_empty_chips_have_no_correlation() -> None:
    textured = np.random.default_rng(0).normal(size=(1, SIDE, SIDE))
    for useless in (np.full((1, SIDE, SIDE), 255.0), np.full((1, SIDE, SIDE), np.nan), np.zeros((1, SIDE, SIDE))):
        for pair in ((textured, useless), (useless, textured)):
            correlation, best, shift, at_edge = compare(*pair)
            assert np.isnan([correlation[0], best[0], *shift[0]]).all()
            assert not at_edge[0]


# --- rays


def test_a_misfit_stands_out_among_its_neighbours() -> None:
    """The second image's orientation is off by much; one measure, besides, by 8 px across the flight."""
    right = ties_at(inner(30))
    turned = moved(right, np.arange(1, 60, 2), np.array([0.0, 0.0]))
    measures = turned.measures.copy()
    measures[1::2, 0] += 40.0 + 0.01 * measures[1::2, 0]
    measures[2 * 7 + 1, 0] += 8.0
    ties = replace(turned, measures=measures)
    frames = chip_frames(PAIR.images, ties)
    odd = misfit_beside_neighbours(frames, ties)
    assert frames.skew_pixels.min() > 10.0
    assert np.abs(odd).argmax() == 7
    assert np.abs(np.delete(odd, 7)).max() < 0.5 * np.abs(odd[7])


def test_measures_must_lie_in_images_of_the_case() -> None:
    ties = ties_at(inner(2))
    refuses(r"SIM/B.*expected one of the case's images", chip_frames, PAIR.images[:1], ties)
    with pytest.raises(InputError, match=r"P1, image SIM/B: line 9999"):
        chip_frames(PAIR.images, replace(ties, measures=np.vstack([ties.measures[:3], [[9998.5, 20.0]]])))
