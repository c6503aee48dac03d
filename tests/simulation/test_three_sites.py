"""Three sites and a bridge: what the bridge sees, and that all of it adjusts as one."""

import tomllib

import numpy as np
import pytest

from mgsgraph.case.reading import Case, adjust, read_case
from mgsgraph.geometry.body import planetocentric
from mgsgraph.simulation.demo.demonstration import nees
from mgsgraph.simulation.files import write_three_sites
from mgsgraph.simulation.site import (
    BRIDGE,
    BRIDGE_PRIOR,
    SimulatedThreeSites,
    SimulationOptions,
    bridge_image,
    simulate_three_sites,
)
from mgsgraph.units import DEG

TIES = {"eos": 162, "gusev": 154, "isidis": 41}
"""Yoon & Shan (2005), Table 1."""


@pytest.fixture(scope="module")
def simulated() -> SimulatedThreeSites:
    return simulate_three_sites(options=SimulationOptions(pictures=False))


@pytest.fixture(scope="module")
def case(simulated: SimulatedThreeSites, tmp_path_factory: pytest.TempPathFactory) -> Case:
    return read_case(write_three_sites(simulated, tmp_path_factory.mktemp("three")))


def in_bridge(simulated: SimulatedThreeSites) -> np.ndarray:
    return np.array([name == BRIDGE for name in simulated.ties.measure_image])


def test_the_bridge_is_one_swath_of_eight_revolutions_over_places_where_the_orbit_goes() -> None:
    """Ground speed, pixel and revolutions by hand; latitudes turn at 93 degrees of inclination, eight times."""
    image = bridge_image()
    lines = np.arange(0.0, image.lines, 200.0)
    track, per_place = image.image_to_ground(lines, np.full(lines.size, 512.0))
    pixel = np.linalg.norm(per_place, axis=1)
    assert 215.0 < pixel.min() < pixel.max() < 265.0
    latitude = planetocentric(track)[:, 1]
    assert np.abs(latitude).max() == pytest.approx(87.0 * DEG, abs=0.3 * DEG)
    turns = np.count_nonzero(np.diff(np.sign(np.diff(latitude))) < 0)
    assert turns == 8
    heights = np.linalg.norm(image.pose(lines).position, axis=1)
    assert np.ptp(heights) < 0.01  # a circle, between the samples of its table too


def test_every_tie_point_is_measured_in_its_site_s_images_and_in_the_bridge(simulated: SimulatedThreeSites) -> None:
    assert {name: sum(one.startswith(name) for one in simulated.ties.ids) for name in TIES} == TIES
    assert np.bincount(simulated.ties.measure_point).tolist() == [3] * sum(TIES.values())
    for k, site in enumerate(simulated.sites):
        mine = {image.true.name for image in site.images} | {BRIDGE}
        first = sum(list(TIES.values())[:k])
        rows = np.flatnonzero(simulated.ties.measure_point == first)
        assert {simulated.ties.measure_image[row] for row in rows} == mine


def test_bridge_measures_have_their_noise(simulated: SimulatedThreeSites) -> None:
    mine = in_bridge(simulated)
    measures = simulated.ties.measures[mine]
    places, _ = simulated.bridge.ground_to_image(simulated.true_ties, simulated.true_bridge, measures[:, 0])
    errors = (measures - places) / BRIDGE_PRIOR.tie
    assert abs(np.mean(errors**2) - 1.0) < 4.5 * np.sqrt(2.0 / errors.size)
    assert abs(np.mean(errors)) < 4.5 / np.sqrt(errors.size)
    assert np.all(simulated.ties.measure_sigmas[mine] == 0.3)
    assert np.all(simulated.ties.measure_sigmas[~mine] == 1.0)
    origins = simulated.bridge.pose(measures[:, 0], simulated.true_bridge).position
    assert np.all(np.linalg.norm(origins - simulated.true_ties, axis=1) < 400e3)  # not through the planet


def test_the_case_holds_all_files_of_the_sites(simulated: SimulatedThreeSites, case: Case) -> None:
    table = tomllib.loads(case.path.read_text(encoding="utf-8"))
    assert [image["name"] for image in table["images"]][-1] == BRIDGE
    assert len(table["images"]) == 7
    assert len(table["shots"]) == 6
    assert "terrain" not in table
    for site in simulated.sites:
        assert (case.path.parent / site.settings.name / "case.toml").is_file()


def test_all_sites_adjust_as_one(simulated: SimulatedThreeSites, case: Case) -> None:
    """Bridge: chi-square with 18 degrees of freedom below 42 (99.9%). The sites' errors are the papers', not drawn from
    the prior: their ties lie where the stated sigmas say, or better.
    """
    network = case.network
    assert len(network.images) == 7
    joined = {0}
    for _ in range(6):
        points = np.unique(network.rays.point[np.isin(network.rays.image, list(joined))])
        joined |= set(network.rays.image[np.isin(network.rays.point, points)].tolist())
    assert joined == set(range(7))
    solution = adjust(case)
    assert solution.converged
    error = (solution.coefficients[6] - simulated.true_bridge.coefficients).ravel()
    assert nees(error[None], solution.image_covariance(6)[None])[0] < 42.0
    known = dict(zip(simulated.ties.ids, simulated.true_ties, strict=True))
    mine = np.array([name in known for name in network.points.ids])
    truth = np.array([known[name] for name in network.points.ids if name in known])
    assert nees(solution.places[mine] - truth, solution.covariances[mine]).mean() / 3.0 < 2.0
