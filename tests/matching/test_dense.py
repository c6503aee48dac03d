"""Dense matches of a small simulated pair with the orientation that it was taken with, against truth."""

from dataclasses import replace
from functools import cache

import matched
import numpy as np
import pytest
from numpy.typing import NDArray

from mgsgraph.errors import InputError
from mgsgraph.matching.dense import DenseMatches, dense_matches
from mgsgraph.matching.patches import Patch, disparities
from mgsgraph.matching.scene import Picture, Scene

SPACING = 50.0


@cache
def scene() -> Scene:
    """The pair as it was taken, over the model of its ground, not over the ground itself."""
    pictures = [Picture(image.true, image.pixels, matched.prior(100.0)) for image in matched.site().images]
    return Scene(tuple(pictures), matched.ground(matched.site().grid))


@cache
def found() -> DenseMatches:
    (one,) = dense_matches(scene(), SPACING)
    return one


@cache
def off() -> NDArray[np.float64]:
    """(n, 2) pixels from where the ground under the anchors truly is on the second picture."""
    names = [scene().pictures[j].image.name for j in (found().first, found().second)]
    return found().pixels - matched.true_places(names[0], found().anchors, names[1])


def test_nearly_every_post_is_matched_where_its_ground_is() -> None:
    assert len(off()) > 0.94 * found().posts
    assert np.all(np.sqrt(np.mean(off() ** 2, axis=0)) < 0.2)
    assert np.mean(np.linalg.norm(off(), axis=1) > 1.0) < 1e-3


def test_posts_are_on_a_grid_over_all_the_ground_that_both_show() -> None:
    one, two = (scene().pictures[j] for j in (found().first, found().second))
    plane = one.on_chart(scene().ground, found().anchors)
    lines, samples = np.meshgrid(np.arange(10.0, one.image.lines), np.arange(10.0, one.image.samples), indexing="ij")
    every = one.on_chart(scene().ground, np.column_stack([lines.ravel(), samples.ravel()])[::37])
    places = two.project(scene().ground.points(every))
    shared = np.all((places > 0.0) & (places < [two.image.lines, two.image.samples]), axis=1).mean()
    whole = shared * one.image.lines * one.image.samples * 2.88 * 4.42  # m along and across of a pixel
    assert found().posts == pytest.approx(whole / SPACING**2, rel=0.1)
    np.testing.assert_array_equal(found().anchors % 1.0, 0.5)
    apart = np.linalg.norm(plane[:, None] - plane[None, :200], axis=2)
    apart[apart == 0.0] = np.inf
    nearest = apart.min(axis=0)
    assert np.median(nearest) == pytest.approx(SPACING, rel=0.1)


def test_covariances_are_those_of_the_errors() -> None:
    squares = np.einsum("ni,nij,nj->n", off(), np.linalg.inv(found().covariances), off())
    assert 0.5 < np.mean(squares) / 2.0 < 1.5
    sigmas = np.sqrt(np.diagonal(found().covariances, axis1=1, axis2=2).mean(axis=0))
    assert np.all(np.abs(np.log(sigmas / np.sqrt(np.mean(off() ** 2, axis=0)))) < np.log(1.5))


def test_threads_don_t_matter_and_progress_is_told() -> None:
    told = []
    several, one = (
        dense_matches(scene(), 4.0 * SPACING, workers, lambda *what: told.append(what))[0] for workers in (None, 1)
    )
    np.testing.assert_array_equal(several.pixels, one.pixels)
    assert told[0] == ("dense matching", 0, told[0][2])
    assert told[-1] == ("dense matching", told[0][2], told[0][2])


def test_orientations_that_contradict_each_other_give_hardly_a_match() -> None:
    """228 m between the nominal orientations: nothing is alike along the parallax, and chance is not delivered."""
    with pytest.raises(InputError, match=r"none of \d+ posts matches; expected .* adjusted orientations"):
        dense_matches(matched.scene(), 2.0 * SPACING)


def test_no_overlap() -> None:
    one, two = scene().pictures
    away = replace(two, correction=replace(matched.DISTURBED, coefficients=_moved(40_000.0)))
    with pytest.raises(InputError, match="no two of them overlap"):
        dense_matches(Scene((one, away), scene().ground))


def _moved(metres: float) -> NDArray[np.float64]:
    along = matched.ground(None).chart.axes[1]
    return np.array([[*(along * metres), 0.0, 0.0, 0.0]])


@pytest.mark.parametrize("shift", [-7, 0, 11])
def test_disparities_of_a_shifted_patch(shift: int) -> None:
    rng = np.random.default_rng(2)
    grey = np.kron(rng.integers(40, 210, (60, 90)), np.ones((2, 2))).astype(np.uint8)
    valid = np.full(grey.shape, 255, dtype=np.uint8)
    half = valid.copy()
    half[:, :60] = 0
    found = disparities(Patch(grey, half), Patch(np.roll(grey, -shift, axis=1), valid), 16)
    inner = found[10:-10, 80:-40]
    assert np.isfinite(inner).mean() > 0.95
    assert np.nanmedian(inner) == pytest.approx(shift, abs=0.1)
    assert np.all(np.isnan(found[:, :60]))
