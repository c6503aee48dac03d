"""Dense matches averaged over a footprint: what is steep is no blunder, and what is one is left out."""

import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline

from mgsgraph.geometry.records import Array
from mgsgraph.geometry.stereo_surface import StereoSurface, averaged_surface

WIDTH = 20.0
"""pixels, and m, standard deviation of the footprint: nodes every 10 pixels."""


def wall(anchors: Array) -> Array:
    """Disparity (n, 2): level, but for a wall of 0.6 pixels per pixel between lines 200 and 400."""
    return np.column_stack([np.zeros(len(anchors)), 0.6 * np.clip(anchors[:, 0] - 300.0, -100.0, 100.0)])


def surface(blunders: int = 0, seed: int = 1) -> StereoSurface:
    """Of matches every 5 pixels with noise of 0.1."""
    rng = np.random.default_rng(seed)
    grid = np.meshgrid(np.arange(2.5, 600.0, 5.0), np.arange(2.5, 300.0, 5.0), indexing="ij")
    anchors = np.stack([part.ravel() for part in grid], axis=1)
    places = anchors + wall(anchors) + rng.normal(0.0, 0.1, anchors.shape)
    places[rng.choice(len(anchors), blunders, replace=False)] += 20.0
    return averaged_surface(anchors, places, np.full(len(anchors), 0.01), np.ones(2), WIDTH, 10.0)


def spots() -> Array:
    """(n, 2) on the wall, three standard deviations from its edges."""
    line, sample = np.meshgrid(np.linspace(265.0, 335.0, 30), np.linspace(80.0, 220.0, 20), indexing="ij")
    return np.column_stack([line.ravel(), sample.ravel()])


def test_matches_on_a_steep_wall_and_at_its_edges_are_kept() -> None:
    """They are as far from the nodes' averages as the wall is steep, and yet on it; the average rounds an edge off by
    0.4 of what a standard deviation of the footprint rises.
    """
    found = surface()
    edges = np.array([[200.0, 150.0], [400.0, 150.0]])
    assert np.all(found.at_nodes(np.concatenate([spots(), edges]))[0])
    rounded = (found.disparity(edges)[0] - edges - wall(edges))[:, 1]
    assert rounded == pytest.approx(0.6 * WIDTH * np.array([1.0, -1.0]) / np.sqrt(2.0 * np.pi), rel=0.1)
    off = found.disparity(spots())[0] - spots() - wall(spots())
    assert np.abs(off).max() < 0.05
    np.testing.assert_allclose(found.disparity(spots())[1][:, 1, 0], 0.6, atol=0.02)


def test_blunders_are_left_out() -> None:
    """One match in a hundred, by 20 pixels."""
    off = surface(blunders=70).disparity(spots())[0] - spots() - wall(spots())
    assert np.abs(off).max() < 0.1


def test_disparities_are_those_of_the_splines() -> None:
    """By FITPACK; outside those at the edge."""
    found, (rows, columns) = surface(), surface().covered.shape
    rng = np.random.default_rng(3)
    at = rng.uniform([-2.0, -2.0], [rows + 1.0, columns + 1.0], (300, 2))
    at[:9] = 0.5 * np.arange(9)[:, None]  # the first interval of a spline is twice as wide as the others
    values, slopes = found.disparity(found.first + at * found.step)
    for k in range(2):
        spline = RectBivariateSpline(np.arange(rows), np.arange(columns), found.places[:, :, k])
        np.testing.assert_allclose(values[:, k], spline.ev(*at.T), rtol=0.0, atol=1e-9)
        for axis, step in enumerate(found.step):
            expected = spline.ev(*at.T, dx=1 - axis, dy=axis) / step
            np.testing.assert_allclose(slopes[:, k, axis], expected, rtol=0.0, atol=1e-9)


def test_what_a_search_reads_is_the_surface_but_for_its_bends() -> None:
    """Linear between points of the splines."""
    found = surface()
    finer, (lines, samples) = found.fine
    corner = np.random.default_rng(2).integers(0, np.array(lines.shape) - 1, (500, 2))
    at, beside = (found.disparity(found.first + (corner + off) * found.step / finer)[0] for off in (0.0, [0.5, 0.0]))
    r, c = corner.T
    np.testing.assert_allclose(np.stack([lines[r, c], samples[r, c]], axis=1), at, atol=1e-9)
    between = 0.5 * np.stack([lines[r, c] + lines[r + 1, c], samples[r, c] + samples[r + 1, c]], axis=1)
    off = np.abs(between - beside)
    assert np.quantile(off, 0.9) < 0.05
    assert off.max() < 0.5  # on the wall
