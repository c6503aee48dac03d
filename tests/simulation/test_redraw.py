"""Networks drawn anew, and the adjustment's sigmas judged by them."""

from pathlib import Path

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface
from redraw import redraw
from sharing import with_all_kinds
from sites import plain_site

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.case.reading import read_case
from mgsgraph.network import PointClass
from mgsgraph.simulation.demo.demonstration import nees
from mgsgraph.simulation.files import write_site


def test_without_noise_the_truth_fits_exactly() -> None:
    net = network(pair())
    draw = redraw(net, np.random.default_rng(0))
    for j, image in enumerate(net.images):
        mine = draw.network.rays.image == j
        exact, _ = image.ground_to_image(draw.places[draw.network.rays.point[mine]], draw.corrections[j])
        error = (draw.network.rays.places[mine] - exact) / net.rays.sigmas[mine]
        assert 0.6 < np.sqrt(np.mean(error**2)) < 1.4


@pytest.mark.parametrize(
    "extended", ["", "shift and surface", pytest.param("all that images share", marks=pytest.mark.slow)]
)
def test_normalised_errors_average_to_one(extended: str) -> None:
    net = network(pair(ties=30, shots=12))
    net = with_shift_and_surface(net) if extended else net
    net = with_all_kinds(net) if extended.startswith("all") else net
    shared, points, cost = [], [], []
    for seed in range(12):
        draw = redraw(net, np.random.default_rng(seed))
        solution = adjust_network(draw.network, SolverSettings())
        found = [part.ravel() for part in (*solution.coefficients, solution.shifts, *solution.shared)]
        error = np.concatenate(found) - draw.vector
        shared.append(nees(error[None], solution.joint_covariance.dense()[None])[0] / error.size)
        points.append(nees(solution.places - draw.places, solution.covariances).mean() / 3.0)
        cost.append(2.0 * solution.cost_final / solution.fit.degrees_of_freedom)
    # 99.9% bands for 12 draws. Points of one draw share orientation and shifts: at worst they err all together, and the
    # band is that of one point per draw (chi-square with 36 degrees of freedom)
    assert 0.8 < np.mean(shared) < 1.25
    assert 0.41 < np.mean(points) < 1.96
    assert 0.85 < np.mean(cost) < 1.17


def test_a_sites_rigorous_case_is_honest(tmp_path: Path) -> None:
    """Ten draws of Gusev, read through its files; scripts/nees.py does a hundred of every site (docs/nees.md)."""
    case = read_case(write_site(plain_site(), tmp_path))
    orientation, ties, laser = [], [], []
    for seed in range(10):
        draw = redraw(case.network, np.random.default_rng(seed))
        solution = adjust_network(draw.network, case.settings)
        error = np.concatenate(
            [
                (found - true.coefficients).ravel()
                for found, true in zip(solution.coefficients, draw.corrections, strict=True)
            ]
        )
        covariance = solution.joint_covariance.of((0, 1))
        orientation.append(nees(error[None], covariance[None])[0] / error.size)
        off = solution.places - draw.places
        for found, kind in ((ties, PointClass.TIE), (laser, PointClass.LASER)):
            members = solution.members(kind)
            found.append(nees(off[members], solution.covariances[members]).mean() / 3.0)
    # 99.9% bands: chi-square with 360 degrees of freedom; points at worst as one point per draw, with 30
    assert 0.77 < np.mean(orientation) < 1.27
    assert 0.36 < np.mean(ties) < 2.07
    assert 0.36 < np.mean(laser) < 2.07
