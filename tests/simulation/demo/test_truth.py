"""Image places by the orientation coefficients: against differences, and what the posterior says against new draws."""

import networks
import numpy as np
import pytest
from strategies import along

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.geometry.orientation import Angles, OrientationCorrection
from mgsgraph.network import PointClass
from mgsgraph.simulation.demo.truth import pixel_jacobian, point_errors, propagated

COEFFICIENTS = np.array([
    [40.0, -25.0, 60.0, 3e-4, -5e-4, 2e-3], [5.0, 3.0, -8.0, 1e-4, 2e-5, -3e-4], [1.0, -2.0, 0.5, 1e-5, -3e-5, 8e-5],
])
"""m and rad: sizes met with MGS."""
STEPS = np.tile([10.0, 10.0, 10.0, 1e-4, 1e-4, 1e-4], 3)


@pytest.mark.parametrize("angles", ["camera", "opk-paper", "opk-peer"])
@pytest.mark.parametrize("which", [0, 1])
def test_jacobian_by_differences(angles: Angles, which: int) -> None:
    pair = networks.pair()
    image, points = pair.images[which], pair.true_ties
    places, jacobian = pixel_jacobian(image, points, OrientationCorrection(COEFFICIENTS, angles))

    def moved(column: int, by: float) -> np.ndarray:
        changed = COEFFICIENTS.copy()
        changed.flat[column] += by
        return image.ground_to_image(points, OrientationCorrection(changed, angles))[0]

    np.testing.assert_array_equal(places, moved(0, 0.0))
    for column, step in enumerate(STEPS):
        numeric = along(lambda by, column=column: moved(column, by), step)
        np.testing.assert_allclose(jacobian[:, :, column] * step, numeric * step, rtol=1e-6, atol=1e-6, err_msg=column)


def test_sigmas_are_the_spread_of_drawn_orientations() -> None:
    pair, rng = networks.pair(), np.random.default_rng(7)
    image, points = pair.images[0], pair.true_ties
    root = rng.normal(size=(18, 18)) * STEPS[:, None]
    _, jacobian = pixel_jacobian(image, points, OrientationCorrection(np.zeros((3, 6))))
    drawn = np.array([
        image.ground_to_image(points, OrientationCorrection((1e-2 * root @ rng.normal(size=18)).reshape(3, 6)))[0]
        for _ in range(250)
    ])
    np.testing.assert_allclose(propagated(jacobian, 1e-4 * root @ root.T), drawn.std(axis=0), rtol=0.2)


def test_errors_of_points_are_normalised_by_all_coordinates() -> None:
    """Truth that lies one sigma off along each axis of every error ellipsoid."""
    solution = adjust_network(networks.network(networks.pair()), SolverSettings())
    off = np.linalg.cholesky(solution.covariances) @ np.ones(3)
    truth = dict(zip(solution.network.points.ids, solution.places - off, strict=True))
    found = point_errors(solution, truth, PointClass.TIE)
    assert found is not None
    assert found.nees == pytest.approx(1.0, rel=1e-6)
    mine = solution.members(PointClass.TIE)
    assert found.rms_after == pytest.approx(np.sqrt(np.mean(np.sum(off[mine] ** 2, axis=1))))


def test_points_that_are_not_seen_have_no_place_and_no_sigma() -> None:
    pair = networks.pair()
    above = 2.0 * pair.true_ties[:2]
    places, jacobian = pixel_jacobian(pair.images[0], above, OrientationCorrection(np.zeros((1, 6))))
    assert np.all(np.isnan(places))
    assert np.all(np.isnan(jacobian))
