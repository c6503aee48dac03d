"""[[mountings]] in a case file."""

from pathlib import Path

import numpy as np
import pytest
from rig_files import PASS, write_rig
from rigs import rig

import mgsgraph
from mgsgraph.case.passes import MountingInput, mounted_images
from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.records import Array
from mgsgraph.network import SharedKind, SharedUnknown
from mgsgraph.network.shared import image_effect
from mgsgraph.units import MRAD

R = '[[mountings]]\ncamera = ["R"]\nname = "NAC-R"\n'


def shared_of(folder: Path, tables: str) -> list[SharedUnknown]:
    return list(mgsgraph.read_case(write_rig(folder, PASS + tables)).network.shared)


def turned(angles: list[float]) -> tuple[Array, Array]:
    """Matrices (n, 3, 3) of R so mounted, at some lines; and these lines."""
    image = rig().images[1]
    entry = MountingInput(camera=("R",), sharing="fixed", boresight_mrad=tuple(angles))
    (moved,) = mounted_images([entry], [""], [image], "here")
    lines = np.linspace(0.0, image.lines, 7)
    pose = moved.pose(lines)
    return pose.matrix, lines


def test_what_is_stated_is_what_the_unknowns_of_the_same_values_do() -> None:
    """To first order, by the effects that the adjustment takes."""
    image = rig().images[1]
    angles = [0.03, -0.02, 0.05]
    matrices, lines = turned(angles)
    nominal = image.pose(lines)
    u = image.normalised(lines)[:, None] ** np.arange(6)
    by_turn = np.einsum(
        "c,cpk,np->nk", np.array(angles) * MRAD, image_effect(image, SharedKind.CAMERA_BORESIGHT, "camera"), u
    )
    turns = rotation.logarithm(nominal.matrix @ np.swapaxes(matrices, 1, 2))
    np.testing.assert_allclose(turns, by_turn[:, 3:], atol=1e-9)


def test_a_fixed_mounting_is_no_unknown(tmp_path: Path) -> None:
    path = write_rig(tmp_path, PASS + R + 'sharing = "fixed"\nboresight_mrad = [0.5, 0.0, 0.0]\n')
    net = mgsgraph.read_case(path).network
    assert net.shared == ()
    before = mgsgraph.read_case(write_rig(tmp_path, PASS)).network
    assert net.passes[0].axes is not None
    assert before.passes[0].axes is not None
    turn = rotation.logarithm((net.passes[0].axes[1] @ before.passes[0].axes[1].T)[None])[0]
    np.testing.assert_allclose(turn, [-0.5 * MRAD, 0.0, 0.0], atol=1e-9)


def test_unknowns_of_a_campaign_and_of_each_pass(tmp_path: Path) -> None:
    (one,) = shared_of(tmp_path, R + "boresight_sigma_mrad = [1.6, 1.6, 0.5]\n")
    assert (one.name, one.kind, one.images.tolist()) == ("boresight of NAC-R", SharedKind.CAMERA_BORESIGHT, [1])
    np.testing.assert_allclose(one.sigmas, np.array([1.6, 1.6, 0.5]) * MRAD)
    both = '[[mountings]]\ncamera = ["other", "R"]\nname = "R"\nsharing = "pass"\nlever_arm_sigma_m = 0.2\n'
    found = shared_of(tmp_path, both)
    assert [one.name for one in found] == ["lever arm of R, one", "lever arm of R, other"]
    assert [one.images.tolist() for one in found] == [[1], [2]]
    assert {one.kind for one in found} == {SharedKind.CAMERA_LEVER_ARM}


WRONG = {
    "no camera": ("[[mountings]]\nboresight_sigma_mrad = 1", r"mountings\[0\]: no camera; expected one of camera, ins"),
    "no sigma": (R, "an unknown mounting without a sigma"),
    "a fixed one of nothing": (R + 'sharing = "fixed"', "a fixed mounting without angles"),
    "two mountings": (R + "boresight_sigma_mrad = 1\n" + R + "lever_arm_sigma_m = 1", r"'R', which mountings\[0\] has"),
    "two cameras": (
        '[[mountings]]\ncamera = ["L", "R"]\nboresight_sigma_mrad = 1', r"L and R of one camera, mounted 178 deg apart"
    ),
    "shared, too": (
        R + 'boresight_sigma_mrad = 1\n[[shared]]\nkind = "camera boresight"\nimages = ["R"]\nsigma_mrad = 1',
        r"mountings: a camera boresight of image R in \[\[shared\]\], too",
    ),
    "an instrument that no file names": (
        '[[mountings]]\ninstrument = "NACR"\nboresight_sigma_mrad = 1', "'NACR', of no image; .*ISDs and states"
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", WRONG)
def test_one_clear_line(tmp_path: Path, fault: str) -> None:
    tables, message = WRONG[fault]
    with pytest.raises(InputError, match=message) as caught:
        mgsgraph.read_case(write_rig(tmp_path, PASS + tables))
    assert "\n" not in str(caught.value)
