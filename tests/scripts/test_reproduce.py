"""The campaigns in scripts/: the papers' case and its tables; fast smoke tests only."""

import sys
from pathlib import Path

import numpy as np
import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import papers_balance as balance  # noqa: E402
import reproduce_papers as tables  # noqa: E402
import study  # noqa: E402

from mgsgraph.case.reading import read_case  # noqa: E402
from mgsgraph.errors import InputError  # noqa: E402
from mgsgraph.geometry.image import PolynomialTrajectory  # noqa: E402
from mgsgraph.network import PointClass  # noqa: E402
from mgsgraph.simulation.files import write_site  # noqa: E402
from mgsgraph.simulation.site import simulate_site  # noqa: E402

PLAIN = tables.AS_PUBLISHED


@pytest.fixture(scope="module")
def isidis(tmp_path_factory: pytest.TempPathFactory) -> tables.Result:
    return tables.reproduced("isidis", 1, tmp_path_factory.mktemp("isidis"), PLAIN)


@pytest.fixture(scope="module")
def gusev(tmp_path_factory: pytest.TempPathFactory) -> tables.Result:
    return tables.reproduced("gusev", 1, tmp_path_factory.mktemp("gusev"), PLAIN)


def test_the_papers_case_has_the_papers_rows(gusev: tables.Result) -> None:
    network, settings = gusev.case.network, gusev.case.settings
    assert network.shifts is None
    assert network.surface is None
    assert (settings.line, settings.angles) == ("measured", "opk-paper")
    laser = network.points.classes[network.rays.point] == PointClass.LASER
    assert network.rays.back_projected is not None
    np.testing.assert_array_equal(network.rays.back_projected, laser)
    assert set(read_case(gusev.case.path).network.rays.sigmas[laser].ravel()) == {22.0}
    np.testing.assert_allclose(network.rays.sigmas[laser], 22.0, atol=0.8)
    assert set(network.rays.sigmas[~laser].ravel()) == {1.0}
    assert set(network.ranges.sigmas) == {10.0}
    nadir, held = (prior.sigmas for prior in network.priors)
    np.testing.assert_allclose(held, 2.0 * nadir, rtol=1e-3)
    np.testing.assert_allclose(nadir[:, 0], [100.0, 2.0, 0.2])
    for image in network.images:  # polynomials of order 2, as theirs
        assert isinstance(image.trajectory, PolynomialTrajectory)
        assert image.trajectory.position.shape == (3, 3)


def test_both_cases_are_written_and_the_one_asked_for_is_returned(tmp_path: Path) -> None:
    site = simulate_site("isidis", 1, PLAIN)
    rigorous, papers = write_site(site, tmp_path), write_site(site, tmp_path, "papers")
    assert (rigorous.name, papers.name) == ("case.toml", "case_papers.toml")
    assert "back-projected" not in rigorous.read_text(encoding="utf-8")
    assert "[terrain]" not in papers.read_text(encoding="utf-8")
    assert all(isinstance(image.trajectory, PolynomialTrajectory) for image in read_case(rigorous).network.images)
    with pytest.raises(InputError, match="weighting"):
        write_site(site, tmp_path, "equal")  # type: ignore[arg-type]


def test_footprints_and_ties_pull_each_image_with_equal_force(gusev: tables.Result, isidis: tables.Result) -> None:
    for one in (gusev, isidis):  # what the weights are read from in the papers' tables holds in our own
        ties, footprints = (
            tables.image_scatter(one.solution, kind, sign).mean
            for kind, sign in ((PointClass.TIE, 1.0), (PointClass.LASER, -1.0))
        )
        for j in (0, 2):
            pull = abs(balance.PUBLISHED[one.site].ties * ties[j] / footprints[j])
            assert abs(pull / balance.information(one.site)[j // 2, 0] - 1.0) < 0.01


def test_published_residuals_give_the_published_sigma0_as_pe_and_rs_counts() -> None:
    for site in balance.PUBLISHED:
        seen = (balance.shots(site),) * 2
        sigmas, wanted = balance.implied_sigmas(site, seen), balance.PUBLISHED[site].sigmas["PE&RS"].sigma0
        assert abs(balance.implied_sigma0(site, sigmas, seen) / wanted - 1.0) < 0.05
        assert balance.implied_sigma0(site, sigmas, seen, measurements=False) / wanted < 0.7
    np.testing.assert_allclose(balance.implied_sigmas("gusev", (266, 266)), 22.0, atol=0.8)


def test_sigma0_of_measurements_leaves_out_weighted_parameters(isidis: tables.Result) -> None:
    fit, shots = isidis.solution.fit, balance.shots("isidis")
    counted = fit.degrees_of_freedom - 3 * shots - balance.UNKNOWNS
    expected = fit.sigma0 * np.sqrt(fit.degrees_of_freedom / counted)
    assert abs(balance.sigma0_of_measurements(isidis.solution) / expected - 1.0) < 0.01  # parameters hardly move


def test_table_4_is_met(gusev: tables.Result, isidis: tables.Result) -> None:
    for one in (gusev, isidis):
        found, wanted = tables.scaled(tables.sigmas_of(one.solution)), balance.PUBLISHED[one.site].sigmas["PE&RS"]
        assert abs(found.sigma0 / wanted.sigma0 - 1.0) < 0.15
        assert max(tables.factors(found.mola, wanted.mola)) < 1.1
        assert max(tables.factors(found.tie, wanted.tie)) < 1.5


def test_corrections_at_gusev_are_opposite(gusev: tables.Result) -> None:
    left, _, right, _ = tables.image_scatter(gusev.solution, PointClass.LASER, -1.0).mean
    assert -28.0 < left < -20.0
    assert 20.0 < right < 30.0
    injected = tables.along_flight(gusev)
    assert abs(abs(injected[0] - injected[1]) - 229.0) < 3.0


def test_corrections_lead_from_the_back_projected_to_the_adjusted_place(gusev: tables.Result) -> None:
    solution, rays = gusev.solution, gusev.solution.network.rays
    found = tables.image_scatter(solution, PointClass.LASER, -1.0).mean
    for j, image in enumerate(solution.network.images):
        mine = (rays.image == j) & (solution.network.points.classes[rays.point] == PointClass.LASER)
        places, _ = image.ground_to_image(solution.places[rays.point[mine]], solution.correction(j))
        np.testing.assert_allclose((places - rays.places[mine]).mean(axis=0), found[2 * j : 2 * j + 2], atol=0.2)


def test_truth_minus_spice_is_what_was_injected(gusev: tables.Result) -> None:
    _, true = tables.differences(gusev)
    for image, off in zip(gusev.simulated.images, true, strict=True):
        eye = image.true.pose(np.linspace(0.0, float(image.true.lines), tables.PLACES)).position
        up = eye / np.linalg.norm(eye, axis=1, keepdims=True)
        np.testing.assert_allclose(np.einsum("ni,ni->n", off[:, :3], up), -image.errors.position[0, 0], atol=0.5)
        assert np.abs(np.linalg.norm(off[:, :3], axis=1) - np.linalg.norm(image.errors.position)).max() < 0.1


def test_table_5_implies_the_shift_of_the_plan() -> None:
    for site, shift in (("gusev", 229.0), ("isidis", 225.0)):
        assert abs(tables.opposite_shift(balance.PUBLISHED[site].mola_pixels, site) - shift) < 1.0


def test_the_page_has_a_place_for_every_table(isidis: tables.Result, tmp_path: Path) -> None:
    blocks = tables.page([isidis], 1, tmp_path)
    text = study.filled("papers.md", blocks)
    assert "| isidis | papers' case | predicted |" in text
    assert "| eos | papers' case |" not in text
    assert "nan" not in "".join(line for lines in blocks.values() for line in lines)


def test_scatter_is_about_the_mean() -> None:
    found = tables.scatter(np.array([[1.0, 5.0], [3.0, 5.0]]))
    assert found == balance.Scatter((2.0, 5.0), (1.0, 0.0))


def test_reweighting_changes_its_own_rows_alone(isidis: tables.Result) -> None:
    network = isidis.case.network
    for group in tables.GROUPS:
        other = tables.reweighted(network, group, 4.0)
        laser = network.points.classes[network.rays.point] == PointClass.LASER
        changed = {
            "ties": not np.array_equal(other.rays.sigmas[~laser], network.rays.sigmas[~laser]),
            "MOLA image points": not np.array_equal(other.rays.sigmas[laser], network.rays.sigmas[laser]),
            "ranges": not np.array_equal(other.ranges.sigmas, network.ranges.sigmas),
            "MOLA ground points": not np.array_equal(other.points.covariances, network.points.covariances),
            "positions": not np.array_equal(other.priors[0].sigmas[:, :3], network.priors[0].sigmas[:, :3]),
            "angles": not np.array_equal(other.priors[0].sigmas[:, 3:], network.priors[0].sigmas[:, 3:]),
        }
        assert [name for name, is_so in changed.items() if is_so] == [group]
    np.testing.assert_allclose(tables.reweighted(network, "ranges", 4.0).ranges.sigmas, 5.0)
