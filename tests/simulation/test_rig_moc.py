"""MOC's narrow and wide angle and MOLA in one pass, on the kernels of M04/02852."""

import sys
from pathlib import Path

import numpy as np
import pytest

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.simulation.moc_rig import MocSettings, simulate_moc_rig, wide_angle_label

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

from rig_study import moc_images  # noqa: E402

Two = tuple[PushbroomImage, PushbroomImage]


@pytest.fixture(scope="module")
def images(shared_data: Path) -> Two:
    return moc_images(shared_data)


def test_another_label_is_refused() -> None:
    with pytest.raises(InputError, match="M04/02852"):
        wide_angle_label("Object = IsisCube")


def test_the_wide_angle_is_taken_about_the_narrow_one(images: Two) -> None:
    """Its lines cover the narrow angle's time, and it shows the middle of it within a fifth of its size of its own."""
    narrow, wide = images
    middle, _ = narrow.image_to_ground(np.array([0.5 * narrow.lines]), np.array([0.5 * narrow.samples]))
    place = wide.ground_to_image(middle)[0][0]
    assert np.all(np.abs(place / 480.0 - 0.5) < 0.2)
    width, _ = wide.image_to_ground(np.full(2, 240.0), np.array([0.0, 480.0]))
    assert 100e3 < np.linalg.norm(width[1] - width[0]) < 130e3


def test_the_papers_discrepancy_is_found(images: Two) -> None:
    """325 m along the track, as a turn of the beam: within 3.5 sigmas of the truth, and far from none."""
    rig = simulate_moc_rig(images, seed=4)
    solution = adjust_network(rig.network, SolverSettings(reject=0.0))
    first = rig.network.first_shared
    for k, true in enumerate(rig.shared):
        error = solution.shared[k] - true
        covariance = solution.joint_covariance.of([first + k])
        assert error @ np.linalg.solve(covariance, error) < 16.3
    sigma = np.sqrt(solution.joint_covariance.of([first + 1])[1, 1])
    assert abs(rig.shared[1][1]) * 370e3 == pytest.approx(325.0, rel=0.05)
    assert abs(solution.shared[1][1]) > 6.0 * sigma


def test_what_is_left_out_changes_nothing_else(images: Two) -> None:
    whole, narrow = (simulate_moc_rig(images, MocSettings(wide=wide), 2) for wide in (True, False))
    np.testing.assert_array_equal(narrow.truth.nodes[0], whole.truth.nodes[0])
    np.testing.assert_array_equal(narrow.network.ranges.values, whole.network.ranges.values)
    assert [one.name for one in narrow.network.shared] == ["boresight of MOLA"]
    assert not np.any(narrow.network.rays.image == 1)
