"""NAC-L and NAC-R near Hadley rille (`lro_nac_hadley`) by a case with passes and mountings: docs/rig_hadley.md."""

from pathlib import Path

import numpy as np
import pytest
from commands import run

import mgsgraph
from mgsgraph.adjustment.solution import Solution
from mgsgraph.network import SharedKind
from mgsgraph.units import MRAD

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
def hadley(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("hadley") / "case.toml"
    path.write_text(CASE.format(folder=shared_data / "lro_nac_hadley"), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def solution(hadley: Path) -> Solution:
    return mgsgraph.adjust(mgsgraph.read_case(hadley))


def test_check_says_the_mounting_of_r(hadley: Path) -> None:
    """Half a turn about the optical axis: 179.6 degrees, 3.134 rad."""
    done = run("check", hadley)
    assert done.returncode == 0, done.stderr
    assert "2009-07-13" in done.stdout
    line = next(line for line in done.stdout.splitlines() if "mounted at" in line)
    assert "+179." in line, line


def test_case_and_script_have_one_answer(solution: Solution) -> None:
    """Radii free: sigma0 and residuals as docs/rig_hadley.md has them, to its digits."""
    assert solution.converged
    assert solution.sigma0 == pytest.approx(0.536, abs=0.02)
    for j in (0, 1):
        mine = solution.residuals[solution.network.rays.image == j]
        rms = np.sqrt(np.mean(mine**2, axis=0))
        assert rms[0] < 0.02
        assert rms[1] == pytest.approx(0.116, abs=0.01)


def test_boresight_of_r(solution: Solution) -> None:
    """Roll is what the seam sees at once; pitch and turn are one unknown there."""
    (boresight,) = solution.network.shared
    assert boresight.kind is SharedKind.CAMERA_BORESIGHT
    assert boresight.images.tolist() == [1]
    covariance = solution.joint_covariance.of([solution.network.first_shared])
    sigmas = np.sqrt(np.diagonal(covariance))
    assert abs(solution.shared[0][0] - 0.005 * MRAD) < 0.01 * MRAD
    assert sigmas[0] < 2e-3 * MRAD
    assert sigmas[2] > 0.9 * MRAD
    assert covariance[1, 2] / (sigmas[1] * sigmas[2]) > 0.98
