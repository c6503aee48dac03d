"""Small wrong inputs from outside, and what the verdict, `check` and `adjust` say of them (field/README.md)."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mgsgraph.adjustment.adjust import predict
from mgsgraph.adjustment.factor_graph import factor_graph
from mgsgraph.adjustment.optimize import optimize
from mgsgraph.analysis.geometry_checks import convergence, deviating_heights
from mgsgraph.analysis.verdict import Cause, State, verdict
from mgsgraph.case.reading import Case, adjust, read_case
from mgsgraph.network import PointClass
from mgsgraph.results.inventory import inventory
from mgsgraph.results.summary import summary
from mgsgraph.simulation.files import write_site
from mgsgraph.simulation.site import SimulationOptions, simulate_site
from mgsgraph.units import DEG

CASES = Path(__file__).resolve().parents[2] / "scripts" / "cases"


def with_wrong_samples(case: Case) -> Case:
    """Field case 7: the two samples of one tie point set to 5000 and 60."""
    rays = case.network.rays
    mine = np.flatnonzero(rays.point == case.network.point_number("lro_pair00088"))
    places = rays.places.copy()
    places[mine, 1] = [5000.0, 60.0]
    return replace(case, network=replace(case.network, rays=replace(rays, places=places)))


def test_a_tie_of_two_places_is_named_before_and_after(shared_data: Path) -> None:
    case = read_case(CASES / "lro_nac_lola.toml")
    wrong = with_wrong_samples(case)
    (reason,) = verdict(adjust(wrong)).of(Cause.HEIGHT)
    assert reason.what == "lro_pair00088"
    assert reason.size == pytest.approx(-12e3, rel=0.1)
    assert not verdict(adjust(case)).of(Cause.HEIGHT)
    for one, names in ((case, []), (wrong, ["lro_pair00088"])):
        nominal = predict(one.network, one.settings)
        found = deviating_heights(one.network, nominal.places, nominal.covariances)
        assert [one.network.points.ids[k] for k in found.points.tolist()] == names
    assert "lro_pair00088" in inventory(wrong, details=False)


def test_the_explicit_form_takes_sigmas_of_all_sizes(shared_data: Path) -> None:
    """Field case 10: ties to 0.08 px, footprints to 1.2 px, ranges to 0.02 m."""
    network = read_case(CASES / "lro_nac_lola.toml").network
    laser = (network.points.classes == PointClass.LASER)[network.rays.point]
    rays = replace(network.rays, sigmas=network.rays.sigmas * np.where(laser, 1.2 / 30.0, 0.08)[:, None])
    ranges = replace(network.ranges, sigmas=network.ranges.sigmas * (0.02 / 10.0))
    graph, values, _ = factor_graph(replace(network, rays=rays, ranges=ranges))
    found = optimize(graph, values)
    assert found.converged
    assert found.cost == pytest.approx(1120.278386, abs=1e-6)


def test_attitudes_of_another_time_are_named(tmp_path: Path) -> None:
    """Field case 12: ties are 1,370 m off, sigma0 is 1.04."""
    site = simulate_site("gusev", 1, SimulationOptions("published", pictures=False))
    path = write_site(site, tmp_path)
    assert verdict(adjust(read_case(path))).state is State.VALID
    text = path.read_text(encoding="utf-8")
    for bias in (2.0, 5.0):
        path.write_text(re.sub(r"(kernels = .*\n)", rf"\1attitude_bias_s = {bias}\n", text), encoding="utf-8")
        solution = adjust(read_case(path))
        found = verdict(solution)
        assert solution.sigma0 < 1.1
        assert found.state is State.SUSPECT
        assert found.of(Cause.CORRECTION)
        assert {"pointing priors", "shifts"} <= {one.what for one in found.of(Cause.GROUP)}
        assert "SUSPECT" in summary(solution)[0]


def test_rays_that_hardly_converge_are_told_by_adjust_too(shared_data: Path) -> None:
    """Field case 13."""
    case = read_case(CASES / "moc_wa_three.toml")
    ties = np.flatnonzero(case.network.points.classes == PointClass.TIE)
    angles = convergence(case.network, ties) / DEG
    assert angles.min() == pytest.approx(0.35, abs=0.01)
    assert angles.max() < 5.0
    (line,) = [line for line in summary(adjust(case)) if line.startswith("- Tie points")]
    assert "31 km" in line
    assert "0.35 to" in line
    assert len(summary(adjust(case))) <= 15
