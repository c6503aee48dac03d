"""The real networks: jigsaw's own adjusted cameras seen here, what its network determines, MOC's places by ISIS."""

import sys
from pathlib import Path

import numpy as np
import pytest

from mgsgraph.case.reading import adjust, read_case
from mgsgraph.errors import WeakNetwork
from mgsgraph.export.bundle_out import orientation_polynomials
from mgsgraph.files.labels.isis_cube import read_isis_cube
from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.geometry.image import PushbroomImage

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import jigsaw_cameras  # noqa: E402
import real_networks  # noqa: E402
from jigsaw_cameras import PUBLISHED  # noqa: E402

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
    assert real_networks.wide_agreement(shared_data, True, real_networks.by_isis()).apart < 0.5
    for fault in real_networks.PLANTED.values():
        assert real_networks.wide_agreement(shared_data, True, real_networks.by_isis(fault)).apart > 1.5


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
