"""Three programs of sixty lines on the factor graph: several stereo pairs, images added one by one, covariances."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

import mgsgraph
from mgsgraph.simulation import PairSettings, simulate_pair, write_pair

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS, LROC = ROOT / "scripts", ROOT / "scripts" / "cases" / "lro_nac_lola.toml"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import add_images  # noqa: E402
import covariance  # noqa: E402
import stereo_pairs  # noqa: E402

real = pytest.mark.skipif(not (ROOT.parent / "shared").is_dir(), reason="the real data of ../shared are not there")
PATHS = ["simulated", pytest.param("real", marks=real)]


@pytest.fixture(params=PATHS)
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A case: a simulated stereo pair, or two LROC images with LOLA."""
    if request.param == "real":
        return LROC
    return write_pair(simulate_pair(PairSettings(ties=20, shots=8), seed=1), tmp_path / "pair")


@pytest.mark.parametrize("name", ["add_images.py", "covariance.py", "stereo_pairs.py"])
def test_each_has_sixty_lines(name: str) -> None:
    assert len((SCRIPTS / name).read_text(encoding="utf-8").splitlines()) <= 60


def test_stereo_pairs(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stereo_pairs.main(str(path))
    said = capsys.readouterr().out
    costs = [float(one) for one in re.findall(r"cost ([\d.]+)", said)]
    assert costs == pytest.approx([mgsgraph.adjust(mgsgraph.read_case(path)).cost_final] * 2, rel=1e-6)
    assert "points in common" in said


def test_stereo_pairs_of_a_strip(capsys: pytest.CaptureFixture[str]) -> None:
    stereo_pairs.main()
    assert capsys.readouterr().out.count("points in common") > 5


def test_images_are_added(capsys: pytest.CaptureFixture[str]) -> None:
    add_images.main("4")
    said = capsys.readouterr().out
    by_isam, batch = re.findall(r"(?:ISAM2|batch) (\d+\.\d+)(?:,|$)", said, re.MULTILINE)
    assert float(by_isam) == pytest.approx(float(batch), rel=1e-5)
    sigmas = [[float(one) for one in row.split()] for row in re.findall(r"\[(.*?)\]", said)]
    assert len(sigmas) == 3
    assert sigmas[0] == pytest.approx(sigmas[2], rel=1e-2)
    assert sigmas[1] == pytest.approx(sigmas[2], rel=1e-2)


def test_covariances(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    solution = mgsgraph.adjust(mgsgraph.read_case(path))
    one, other = solution.network.points.ids[:2]
    covariance.main(str(path), one, other)
    said = capsys.readouterr().out
    found = re.search(r"is (-?[\d.]+) m farther.* ([\d.]+) m$", said, re.MULTILINE)
    assert found
    right = mgsgraph.Posterior.of(solution).difference(one, other)
    assert float(found[2]) == pytest.approx(right.height_sigma, rel=0.01)
    radii = np.linalg.norm(solution.places[:2], axis=1)
    assert float(found[1]) == pytest.approx(radii[1] - radii[0], abs=0.011)
