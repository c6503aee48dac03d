"""Published work done again: the papers' case and its tables; the real networks (jigsaw's own adjusted cameras seen
here, what its network determines, MOC's places by ISIS).
"""

import sys
from pathlib import Path

import numpy as np
import pytest

from mgsgraph.case.reading import adjust, read_case
from mgsgraph.errors import WeakNetwork
from mgsgraph.export.bundle_out import orientation_polynomials
from mgsgraph.files.labels.isis_cube import read_isis_cube
from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.geometry.image import PolynomialTrajectory, PushbroomImage
from mgsgraph.network import PointClass

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import jigsaw_cameras  # noqa: E402
import papers_balance as balance  # noqa: E402
import real_networks  # noqa: E402
import reproduce_papers as tables  # noqa: E402
from jigsaw_cameras import PUBLISHED  # noqa: E402

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


# --- the real networks


Rig = tuple[list[PushbroomImage], TiePoints]


@pytest.fixture(scope="module")
def rig(shared_data: Path) -> Rig:
    return jigsaw_cameras.read_rig(shared_data)


def test_the_adjusted_cameras_of_isis_see_the_fixed_points_alike(rig: Rig) -> None:
    """Its expected coefficients are good to 1e-5 degrees, 0.02 px; of its residuals 0.379967 px is the largest."""
    told = PUBLISHED["ISIS 8 and 9"]
    seen = jigsaw_cameras.jigsaw_cameras(*rig, told)
    for left, right in seen.fixed.values():
        np.testing.assert_allclose(left, right, rtol=0, atol=0.01)
        assert np.linalg.norm(left) < told.largest
    np.testing.assert_allclose(seen.moments, 0.0, atol=0.005)
    assert 0.05 < seen.mean < told.mean
    off = jigsaw_cameras.jigsaw_cameras(*rig, told, 0.5)
    assert all(np.abs(left - right).max() > 0.9 for left, right in off.fixed.values())


def test_four_directions_of_the_rig_are_not_determined(rig: Rig, tmp_path: Path) -> None:
    spectrum, sigmas = jigsaw_cameras.determined(*rig)
    assert spectrum[11] > 0.2
    assert spectrum[12] < 2e-5
    assert sigmas.min() > 5e3
    text = (real_networks.CASES / "jigsaw_nac.toml").read_text(encoding="utf-8")
    case = tmp_path / "case.toml"
    text = text.replace("[0.29, 0.29, 1e-9]", "[inf, inf, 1e-9]").replace("../../..", str(real_networks.ROOT.parent))
    case.write_text(text, encoding="utf-8")
    with pytest.raises(WeakNetwork, match=r"nothing determines .* pitch of images"):
        adjust(read_case(case))


def test_the_rig_adjusts(rig: Rig) -> None:
    """Mean residual of ISIS's cameras with free radii: 0.0757 px."""
    one = real_networks.adjusted(real_networks.CASES / "jigsaw_nac.toml")
    size = np.linalg.norm(jigsaw_cameras.rig_residuals(one.solution, rig[1]), axis=1)
    assert one.solution.converged
    assert one.solution.fit.degrees_of_freedom == 52
    assert size.mean() == pytest.approx(0.0756, abs=1e-4)
    assert size.max() == pytest.approx(0.307, abs=1e-3)
    told = PUBLISHED["ISIS 8 and 9"]
    for j in range(2):  # in jigsaw's words; its own adjustment has gone 0.3 deg
        angles = np.degrees(orientation_polynomials(one.solution, j, 3).before[3:5, 0])
        np.testing.assert_allclose(angles, [told.ascension[j, 0], told.declination[j, 0]], rtol=0, atol=0.3)


def test_places_that_isis_computed_are_those_of_the_cameras_here(shared_data: Path) -> None:
    """Measures that nobody measured: with ISIS's positions and way from ground to image they agree to 0.3 m."""
    apparent, geometric = (real_networks.wide_agreement(shared_data, flag) for flag in (True, False))
    assert apparent.meet < 5e-4 < geometric.meet < 0.01
    assert real_networks.wide_agreement(shared_data, True, real_networks.by_isis()).distance < 0.5
    for fault in real_networks.PLANTED.values():
        assert real_networks.wide_agreement(shared_data, True, real_networks.by_isis(fault)).distance > 1.5


def test_tables_and_label_are_one_image(shared_data: Path) -> None:
    folder, lines = shared_data / "mgs_moc_wa_three", np.linspace(0.0, 480.0, 5)
    by_tables, by_label = (read_isis_cube((folder / "cube1").with_suffix(end)) for end in (".isd", ".pvl"))
    assert by_tables.name == by_label.name == "MGS/688540926:0/MOC-WA/RED"
    ground = [image.image_to_ground(lines, lines)[0] for image in (by_tables, by_label)]
    np.testing.assert_array_equal(*ground)


def test_the_wide_angles_adjust_alone_and_on_molas_grid(shared_data: Path) -> None:
    """Rays that nearly coincide know no heights; with the grid they have its heights, 2 km below the ellipsoid."""
    alone, mola = (real_networks.adjusted(real_networks.CASES / f"moc_wa_three{end}.toml") for end in ("", "_mola"))
    assert (alone.solution.fit.degrees_of_freedom, mola.solution.fit.degrees_of_freedom) == (34, 50)
    assert alone.residuals.max() < 0.002
    assert mola.residuals[1] == pytest.approx(0.0076, abs=5e-4)
    assert alone.sigmas[2] > 2e4
    assert mola.sigmas[2] == pytest.approx(50.0, abs=0.5)
    assert np.all((mola.heights > -2200.0) & (mola.heights < -1700.0))
