"""Errors of points against the truth of a simulation."""

import networks
import numpy as np
import pytest

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.network import PointClass
from mgsgraph.simulation.demo.demonstration import point_errors


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
