"""The demo of each study site against its truth, and its figures against its records; sigmas of adjustments judged by
the truth of simulations, of networks drawn anew.
"""

import json
from pathlib import Path

import networks
import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface
from outside import refuses
from redraw import redraw
from sharing import with_all_kinds

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.network import PointClass
from mgsgraph.simulation.demo import demonstration
from mgsgraph.simulation.demo.demonstration import (
    DEMONSTRATED,
    DRAWING,
    KERNELS,
    PAIR,
    RELIEF,
    STAGES,
    TIES,
    Demonstration,
    demonstrate,
    nees,
    overall,
    point_errors,
    simulation_options,
)
from mgsgraph.simulation.demo.summary import (
    summary_json,
)
from mgsgraph.simulation.sites import SITE_NAMES
from mgsgraph.text import root_mean_square


@pytest.fixture(scope="module", params=SITE_NAMES)
def demo(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Demonstration:
    folder = tmp_path_factory.mktemp(request.param)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demonstration, "has_opencv", lambda: False)
        return demonstrate(request.param, folder, 1, simulation_options(request.param, pictures=False))


@pytest.mark.slow
def test_misregistration_is_seen_before_and_gone_after(demo: Demonstration) -> None:
    for before, after in zip(demo.registration.before, demo.registration.after, strict=True):
        for one, two in zip(before.discrepancies, after.discrepancies, strict=True):
            assert root_mean_square(np.linalg.norm(one.metres, axis=1)) > 5.0 * root_mean_square(
                np.linalg.norm(two.metres, axis=1)
            )
            assert root_mean_square(two.pixels[:, 0]) < 1.0
    for one in summary_json(demo)["orientation"]:
        assert max(*one["largest_sigmas_position"], *one["largest_sigmas_rotation"]) < 3.5


@pytest.mark.slow
def test_summary_holds_the_figures(demo: Demonstration) -> None:
    record = summary_json(demo)
    assert json.loads(json.dumps(record, allow_nan=False)) == record
    assert record["sigma0"] == demo.solution.sigma0
    assert set(record["seconds"]) == set(STAGES) - {RELIEF, DRAWING}
    shifts = {one["name"]: one["true_m"] for one in record["shifts"]}
    for image in demo.simulated.images:
        assert shifts[image.settings.profile] == (-image.profile.shift).tolist()
    for row, one in zip(record["disagreement"], demo.disagreements, strict=True):
        assert row["rms_m"] == pytest.approx(np.sqrt(np.mean(np.sum(one.found.metres**2, axis=1))))
    for one, image in zip(record["orientation"], demo.simulated.images, strict=True):
        assert one["image"] == image.true.name
        assert max(*one["largest_sigmas_position"], *one["largest_sigmas_rotation"]) < 4.0


@pytest.mark.slow
def test_errors_before_are_those_put_in(demo: Demonstration) -> None:
    """The mean over an image of a + b u + c u^2 is a + c / 3, but for the ends' share in 31 places."""
    for one, image in zip(summary_json(demo)["orientation"], demo.simulated.images, strict=True):
        errors = image.errors.position
        size = np.linalg.norm(one["error_before_mean_m"])
        assert size == pytest.approx(np.linalg.norm(errors[0] + errors[2] / 3.0), abs=1.0)


@pytest.mark.slow
def test_disagreements_are_within_what_is_predicted(demo: Demonstration) -> None:
    for one in demo.disagreements:
        assert one.state in {KERNELS, TIES}
        if one.state == TIES:
            assert np.all(np.abs(one.found.metres.mean(axis=0)) < 4.0 * one.sigmas)
            assert one.rms == pytest.approx(np.linalg.norm(one.found.metres.mean(axis=0)), rel=0.5)
    size, predicted = overall(demo.disagreements, TIES)
    assert 50.0 < predicted < 400.0
    assert size < 4.0 * predicted


@pytest.mark.slow
def test_sources_are_named_from_the_results(demo: Demonstration) -> None:
    """Results are written beside their final place, whose name they must not keep."""
    network, folder = demo.case.network, demo.case.path.parent
    assert network.surface is not None
    assert network.areoid is not None
    sources = [network.surface.grid.source, network.areoid.source, *(shots.source for shots in demo.case.profiles)]
    assert [one.lattice.source for one in demo.case.terrain] == sources[:1]  # by which both are known to be one model
    assert all(source.startswith(f"{folder.name}/") for source in sources)
    assert not any(str(folder) in source for source in sources)


def test_sites_and_options_are_checked(tmp_path: Path) -> None:
    refuses("eos, gusev, isidis or pair", simulation_options, "olympus", known=DEMONSTRATED)
    refuses("attitude time bias", simulation_options, PAIR, 0.5)
    assert simulation_options("gusev", 0.95).attitude_time_bias == 0.95


# --- errors against the truth


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


@pytest.mark.parametrize(
    "extended", ["", "shift and surface", pytest.param("all that images share", marks=pytest.mark.slow)]
)
def test_normalised_errors_average_to_one(extended: str) -> None:
    net = network(pair(ties=30, shots=12))
    net = with_shift_and_surface(net) if extended else net
    net = with_all_kinds(net) if extended.startswith("all") else net
    shared, points, cost = [], [], []
    for seed in range(12):  # 3 s: with fewer draws the bands hold nothing
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
