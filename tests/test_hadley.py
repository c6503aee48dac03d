"""NAC-L and NAC-R near Hadley rille as one rig: what the seam says of R's mounting, and what it can't."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import run

import mgsgraph
from mgsgraph.adjustment.solution import Solution
from mgsgraph.simulation.camera import InstrumentErrors, as_taken

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import hadley  # noqa: E402
from hadley import Rig, adjusted, free_radii  # noqa: E402


@pytest.fixture(scope="module")
def rig(shared_data: Path) -> Rig:
    return hadley.read_rig(shared_data)


def test_the_seam_knows_the_roll_and_one_of_pitch_and_turn(rig: Rig) -> None:
    solution = adjusted(rig.network)
    covariance = solution.joint_covariance.of([rig.network.first_shared])
    sigmas = np.sqrt(np.diagonal(covariance))
    assert solution.converged
    assert sigmas[0] < 1e-6
    assert sigmas[2] > 0.95e-3
    assert covariance[1, 2] / (sigmas[1] * sigmas[2]) > 0.99
    near, far = hadley.seam(rig)
    assert near < 0.3
    assert far > 20.0 * near
    for j in (0, 1):
        size = np.linalg.norm(solution.residuals[rig.network.rays.image == j], axis=1)
        assert np.sqrt(np.mean(size**2)) < 0.16


def test_a_boresight_that_is_planted_is_found_on_top(rig: Rig) -> None:
    """R read with its axes turned by 0.05 mrad about x: the answer moves by that, and nothing else moves."""
    before = adjusted(rig.network)
    turned = as_taken(rig.network.images[1], InstrumentErrors(camera_boresight=np.array([5e-5, 0.0, 0.0])))
    after = adjusted(replace(rig.network, images=(rig.network.images[0], turned)))
    moved = after.shared[0] - before.shared[0]
    np.testing.assert_allclose(moved, [-5e-5, 0.0, 0.0], atol=2e-6)
    np.testing.assert_allclose(after.residuals, before.residuals, atol=0.02)


def test_one_trajectory_sees_heights_that_two_polynomials_do_not(rig: Rig) -> None:
    """By a parallax of 140 lines: the step from the mare to the mountains, 2 km, at lines 26,000 to 31,000 of L."""
    solution = adjusted(free_radii(rig))
    its = rig.network.rays.image == 0
    lines, point = rig.network.rays.places[its][:, 0], rig.network.rays.point[its]
    radii = np.linalg.norm(solution.places, axis=1)[point]
    assert np.median(radii[lines > 31_000]) - np.median(radii[lines < 26_000]) == pytest.approx(2100.0, abs=300.0)
    alone = adjusted(replace(free_radii(rig), passes=(), shared=()))
    assert np.median(hadley.radial_sigmas(alone)) > 8.0 * np.median(hadley.radial_sigmas(solution))


def test_lola_is_beside_the_ties(rig: Rig, shared_data: Path) -> None:
    shots = hadley.read_shots(shared_data / "lro_nac_hadley" / "RDR_hadley_LOLA.csv.gz")
    control = hadley.lola(rig, shots)
    assert control.dates == 8
    assert control.right == 0
    assert 7300 < control.left < 7350
    assert control.nearest > 4.9e3


# --- nAC-L and NAC-R near Hadley rille (`lro_nac_hadley`) by a case with passes and mountings: docs/rig_ha


CASE = """
format = 1
name = "Hadley"
[[images]]
image = "{folder}/observationImageL.pvl"
[[images]]
image = "{folder}/observationImageR.pvl"
[[passes]]
name = "2009-07-13"
position = {{ sigmas_m = [30.0, 10.0] }}
attitude = {{ sigmas_mrad = [0.29, 0.1, 0.1, 0.1] }}
[[mountings]]
name = "NAC-R"
camera = ["LRO/1/269182000:51104/NACR"]
boresight_sigma_mrad = 1.0
[ties]
network = "{folder}/observationPair.net"
sigma_px = 0.3
"""


@pytest.fixture(scope="module")
def case(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("hadley") / "case.toml"
    path.write_text(CASE.format(folder=shared_data / "lro_nac_hadley"), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def solution(case: Path) -> Solution:
    return mgsgraph.adjust(mgsgraph.read_case(case))


def test_check_says_the_mounting_of_r(case: Path) -> None:
    """Half a turn about the optical axis: 179.6 degrees, 3.134 rad."""
    done = run("check", case, "--details")
    assert done.returncode == 0, done.stderr
    assert "2009-07-13" in done.stdout
    line = next(line for line in done.stdout.splitlines() if "mounted at" in line)
    assert "+179." in line, line


def test_case_and_script_have_one_answer(solution: Solution) -> None:
    """Radii free: sigma0 and residuals as docs/evidence_real.md has them, to its digits."""
    assert solution.converged
    assert solution.sigma0 == pytest.approx(0.536, abs=0.02)
    for j in (0, 1):
        mine = solution.residuals[solution.network.rays.image == j]
        rms = np.sqrt(np.mean(mine**2, axis=0))
        assert rms[0] < 0.02
        assert rms[1] == pytest.approx(0.116, abs=0.01)
