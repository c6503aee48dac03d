"""Shifts, terrain and back-projections in the products, against the arrays they come from."""

from dataclasses import replace

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.reports.control import control_json, control_statements, surface_heights
from mgsgraph.reports.results import solution_json


def test_shifts_and_heights_are_told() -> None:
    solution = adjust_network(with_shift_and_surface(network(pair())), SolverSettings())
    record = control_json(solution)
    shift, terrain = record["shifts"]
    assert terrain["name"] == "terrain model"
    assert shift["east_north_m"] == solution.shifts[0].tolist()
    assert shift["sigma_east_north_m"] == pytest.approx(solution.joint_covariance.sigmas[-4:-2].tolist())
    before, after = surface_heights(solution)
    assert record["surface"]["count"] == after.size == 12
    assert record["surface"]["rms_height_before_m"] == pytest.approx(np.sqrt(np.mean(before**2)))
    words = " ".join(control_statements(solution))
    assert "Profile profile" in words
    assert "The terrain model moved" in words
    assert "12 tie points were held to the terrain model" in words
    assert "back-projections" not in words
    assert solution_json(solution)["control"] == record


def test_back_projections_are_owned_up_to() -> None:
    net = network(pair())
    copied = np.arange(net.rays.point.size) % 2 == 0
    solution = adjust_network(replace(net, rays=replace(net.rays, back_projected=copied)), SolverSettings())
    assert control_json(solution)["back_projected_rays"] == copied.sum()
    assert "too small" in " ".join(control_statements(solution))


def test_without_any_of_it_nothing_is_said() -> None:
    solution = adjust_network(network(pair()), SolverSettings())
    assert control_statements(solution) == []
    assert control_json(solution)["surface"]["count"] == 0
