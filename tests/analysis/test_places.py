"""Places in images and on the ground: there and back, what is hidden, and sigmas by numeric derivatives."""

from pathlib import Path

import numpy as np
import pytest

import mgsgraph
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.places import State, View, on_surface
from mgsgraph.files.place_table import PlaceTable
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.results.places import Surface, project_places
from mgsgraph.simulation.pair import PairSettings, simulate_pair

PIXEL = 1e-6
"""px that a round trip may lose."""


@pytest.fixture(scope="module")
def solution(tmp_path_factory: pytest.TempPathFactory) -> Solution:
    from mgsgraph.simulation.files import write_pair

    folder = tmp_path_factory.mktemp("pair")
    path = write_pair(simulate_pair(PairSettings(ties=20, shots=8), seed=1), folder)
    return mgsgraph.adjust(mgsgraph.read_case(Path(path)))


def places(view: View) -> Array:
    lines, samples = np.meshgrid(np.linspace(0.0, view.image.lines, 5), np.linspace(0.0, view.image.samples, 4))
    return np.column_stack([lines.ravel(), samples.ravel()])


def relief(view: View, height: float = 300.0) -> TerrainGrid:
    """Hills under the whole image."""
    ground = view.on_ground(places(view)).points
    longitude, latitude, radius = planetocentric(ground).T
    step = 1e-4
    first, last = (longitude.min() - 20 * step, latitude.max() + 20 * step), latitude.min() - 20 * step
    shape = int((first[1] - last) / step), int((longitude.max() - first[0]) / step) + 20
    hills = height * np.random.default_rng(2).standard_normal(shape)
    return TerrainGrid("hills", radius.mean() + hills, *first, step, step)


@pytest.mark.parametrize("surface", ["ellipsoid", "height", "radius", "terrain"])
def test_there_and_back(solution: Solution, surface: str) -> None:
    for view in (View.adjusted(solution, 0), View(solution.network.images[1])):
        pixels, terrain = places(view), relief(view) if surface == "terrain" else None
        radius = np.full(len(pixels), 3.39e6) if surface == "radius" else None
        ground = view.on_ground(pixels, 1234.5 if surface == "height" else 0.0, radius, terrain)
        assert set(ground.states) == {State.SEEN}
        back = view.seen(ground.points, terrain)
        np.testing.assert_allclose(back.pixels, pixels, atol=PIXEL)
        assert set(back.states) == {State.SEEN}
        if surface != "radius":
            height = 1234.5 if surface == "height" else 0.0
            again = on_surface(*planetocentric(ground.points)[:, :2].T, view.image.body, height, terrain)
            np.testing.assert_allclose(again, ground.points, atol=1e-5)


def test_what_is_not_seen_is_marked(solution: Solution) -> None:
    view = View.adjusted(solution, 0)
    size = np.array([view.image.lines, view.image.samples])
    pixels = np.array([0.5 * size, [-10.0, 5.0], [-0.6 * size[0], 5.0]])
    ground = view.on_ground(pixels)
    assert ground.states == (State.SEEN, State.OUTSIDE, State.FAR_OUTSIDE)
    assert ground.covariances is not None
    assert np.isfinite(ground.covariances[:2]).all()
    assert np.isnan(ground.points[2]).all()
    middle = ground.points[0]
    hidden = view.seen(np.stack([middle, -middle, np.full(3, np.nan)]))
    assert hidden.states == (State.SEEN, State.BEHIND_BODY, State.NO_GROUND)
    sky = View(view.image, OrientationCorrection(np.array([[0, 0, 0, 2.0, 0, 0]])))
    assert sky.on_ground(pixels[:1]).states == (State.NO_GROUND,)


@pytest.mark.parametrize("on_relief", [False, True])
def test_sigmas_by_numeric_derivatives(solution: Solution, on_relief: bool) -> None:
    """By all coefficients of the image, one after the other; ground that stays at its height moves with the ray."""
    view = View.adjusted(solution, 1)
    assert view.correction is not None
    pixels, terrain = places(view)[[1, 7, 18]], relief(view) if on_relief else None
    ground = view.on_ground(pixels, terrain=terrain)
    into, coefficients = view.seen(ground.points), view.correction.coefficients
    covariance, step = solution.correction_covariance(1), np.tile([0.1] * 3 + [1e-7] * 3, len(coefficients))
    image_slopes, ground_slopes = [], []
    for k in range(coefficients.size):
        sides = []
        for sign in (1.0, -1.0):
            moved = coefficients.ravel().copy()
            moved[k] += sign * step[k]
            other = View(view.image, OrientationCorrection(moved.reshape(-1, 6), view.correction.angles))
            sides.append((other.seen(ground.points).pixels, other.on_ground(pixels, terrain=terrain).points))
        image_slopes.append((sides[0][0] - sides[1][0]) / (2.0 * step[k]))
        ground_slopes.append((sides[0][1] - sides[1][1]) / (2.0 * step[k]))
    for slopes, found in ((image_slopes, into.covariances), (ground_slopes, ground.covariances)):
        design = np.stack(slopes, axis=2)
        wanted = design @ covariance @ np.swapaxes(design, 1, 2)
        assert found is not None
        np.testing.assert_allclose(found, wanted, rtol=2e-3, atol=2e-3 * np.abs(wanted).max())


def test_relief_hides_places_with_heights_of_their_own_but_not_those_beneath_it(solution: Solution) -> None:
    view = View.adjusted(solution, 1)
    terrain = relief(view, 3000.0)
    longitude, latitude, _ = planetocentric(view.on_ground(places(view)).points).T
    ground = on_surface(longitude, latitude, view.image.body, terrain=terrain)
    hidden = [str(one) for one in view.seen(ground, terrain).states]
    assert {"seen", "behind relief"} <= set(hidden)

    def states(points: Array, surface: TerrainGrid | None) -> list[str]:
        plane = np.zeros((0, 2))
        given = PlaceTable("", {}, "ground", None, plane, None, None, points, plane)
        return [str(row["state"]) for row in project_places(view, given, Surface(surface), isis=False)[0].records()]

    assert states(ground, terrain) == hidden
    assert "behind relief" not in states(ground, None)
    beneath = np.array(states(ground * (1.0 - 50.0 / 3.39e6), terrain)) == "behind relief"
    np.testing.assert_array_equal(beneath, np.array(hidden) == "behind relief")
