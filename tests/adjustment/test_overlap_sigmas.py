"""Sigmas over an overlap: cell by cell the posterior's own intersection; nothing where fewer than two images see."""

from functools import cache

import numpy as np
import pytest
from networks import network, pair

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.analysis.overlap_sigmas import sigma_grid
from mgsgraph.adjustment.analysis.posterior import Pixel, Posterior
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import from_planetocentric


@cache
def posterior(held: tuple[bool, bool] = (False, False)) -> Posterior:
    return Posterior.of(adjust_network(network(pair(), held=held), SolverSettings()))


def test_each_cell_is_an_intersection_of_its_own() -> None:
    asked = posterior()
    grid = sigma_grid(asked, cell=1000.0, sigma=0.8)
    rows, columns = np.nonzero(np.isfinite(grid.values[0]))
    assert rows.size > 20
    middle = rows.size // 2
    row, column = int(rows[middle]), int(columns[middle])
    radius = np.median(np.linalg.norm(asked.linearised.points, axis=1))
    longitude, latitude = grid.west + grid.step * (column + 0.5), grid.north - grid.step * (row + 0.5)
    ground = from_planetocentric(np.array([[longitude, latitude, radius]]))
    pixels = []
    for j, image in enumerate(asked.network.images):
        place, _ = image.ground_to_image(ground, asked.correction(j))
        pixels.append(Pixel(image.name, *place[0].tolist(), sigma=0.8))
    found = asked.intersection(pixels)
    right = np.sqrt(np.diagonal(found.east_north_up))
    assert np.allclose(grid.values[:3, row, column], right, rtol=2e-3)  # the height differs by some metres
    assert grid.values[3, row, column] == pytest.approx(np.sqrt(np.trace(found.covariance)), rel=2e-3)


def test_values_are_there_where_two_images_see_the_ground_and_only_there() -> None:
    grid = sigma_grid(posterior(), cell=2000.0)
    assert np.array_equal(np.isfinite(grid.values[0]), grid.rays >= 2)
    assert 0 < np.isfinite(grid.values[0]).mean() < 1.0


def test_with_the_orientation_held_sigmas_go_with_those_of_the_measures() -> None:
    held = posterior((True, True))
    fine, coarse = (sigma_grid(held, cell=1500.0, sigma=sigma) for sigma in (0.5, 2.0))
    inside = np.isfinite(fine.values)
    assert np.allclose(coarse.values[inside], 4.0 * fine.values[inside], rtol=1e-6)
    free = sigma_grid(posterior(), cell=1500.0, sigma=0.5)
    assert np.all(free.values[inside] > fine.values[inside])


def test_what_makes_no_raster_is_refused() -> None:
    names = [image.name for image in posterior().network.images]
    with pytest.raises(InputError, match="two or more different images"):
        sigma_grid(posterior(), [names[0]])
    with pytest.raises(InputError, match="two or more different images"):
        sigma_grid(posterior(), [names[0], names[0]])
    with pytest.raises(InputError, match=r"cells of .* at most; choose larger cells"):
        sigma_grid(posterior(), names, cell=0.5)
    with pytest.raises(InputError, match="image nowhere: not in the solution"):
        sigma_grid(posterior(), [names[0], "nowhere"])
