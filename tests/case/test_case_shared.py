"""[[shared]] in a case file."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from redraw import redraw
from sites import plain_site

import mgsgraph
from mgsgraph.errors import InputError
from mgsgraph.network import SharedKind
from mgsgraph.results.inventory import inventory
from mgsgraph.simulation.files import write_site

GOOD = """
[[shared]]
kind = "attitude-time bias"
sigma_s = 1.0

[[shared]]
kind = "camera boresight"
name = "boresight of the spare camera"
images = ["SIM/B"]
sigma_mrad = [0.1, 0.2, 0.3]

[[shared]]
kind = "range bias"
images = ["SIM/A"]
sigma_m = 5.0
"""

MOUNTED = """
[[shared]]
kind = "principal point"
sigma_m = [1e-4, 2e-4]

[[shared]]
kind = "radial distortion k1"
sigma_m = 1e-5

[[shared]]
kind = "line rate"
sigma_ppm = 20.0

[[shared]]
kind = "camera lever arm"
sigma_m = [1.0, 2.0, 3.0]

[[shared]]
kind = "altimeter lever arm"
images = ["SIM/A"]
sigma_m = 4.0
"""


def with_text(case_file: Path, text: str) -> Path:
    case_file.write_text(case_file.read_text(encoding="utf-8") + text, encoding="utf-8")
    return case_file


def test_what_a_case_says_is_what_the_network_has(case_file: Path) -> None:
    first, second, third = mgsgraph.read_case(with_text(case_file, GOOD)).network.shared
    assert (first.name, first.kind, first.images.tolist()) == ("attitude-time bias", SharedKind.ATTITUDE_TIME, [0, 1])
    assert (second.name, second.images.tolist()) == ("boresight of the spare camera", [1])
    np.testing.assert_allclose(second.sigmas, [1e-4, 2e-4, 3e-4])
    assert third.sigmas.tolist() == [5.0]


def test_without_the_laser_what_only_it_feels_goes_too(case_file: Path) -> None:
    kinds = [one.kind for one in mgsgraph.read_case(with_text(case_file, GOOD), laser=False).network.shared]
    assert kinds == [SharedKind.ATTITUDE_TIME, SharedKind.CAMERA_BORESIGHT]


def test_line_rate_and_lever_arms(case_file: Path) -> None:
    found = mgsgraph.read_case(with_text(case_file, MOUNTED))
    wanted = {SharedKind.PRINCIPAL_POINT: [1e-4, 2e-4], SharedKind.RADIAL_DISTORTION_1: [1e-5],
              SharedKind.LINE_RATE: [2e-5], SharedKind.CAMERA_LEVER_ARM: [1.0, 2.0, 3.0],
              SharedKind.ALTIMETER_LEVER_ARM: [4.0] * 3}  # fmt: skip
    assert {one.kind: pytest.approx(one.sigmas.tolist()) for one in found.network.shared} == wanted
    assert re.search(r"line rate .* 20 ppm", inventory(found))
    without = mgsgraph.read_case(case_file, laser=False).network.shared
    assert SharedKind.ALTIMETER_LEVER_ARM not in [one.kind for one in without]
    assert len(without) == len(found.network.shared) - 1


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ('kind = "range bias"', "shared\\[0\\]: no sigma; expected sigma_m for range bias"),
        ('kind = "range bias"\nsigma_s = 1.0', "sigma_s; expected sigma_m"),
        ('kind = "principal point"\nsigma_m = [1.0, 2.0, 3.0]', "one number, or two for principal point"),
        ('kind = "range bias"\nsigma_m = 1.0\nsigma_s = 1.0', "sigma_s and sigma_m; expected sigma_m"),
        ('kind = "camera boresight"\nsigma_mrad = [1.0, 2.0]', "one number from 1e-9 to 1e9, or three"),
        ('kind = "clock"\nsigma_s = 1.0', "kind: 'clock'; expected one of 'altimeter boresight'"),
        ('kind = "focal length"\nsigma_m = 1.0\nimages = ["SIM/C"]', "the image 'SIM/C'"),
    ],
)
def test_one_clear_line(case_file: Path, entry: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        mgsgraph.read_case(with_text(case_file, f"\n[[shared]]\n{entry}\n"))
    assert str(caught.value).startswith(str(case_file))
    assert "\n" not in str(caught.value)


# --- beams of rolled profiles


@pytest.fixture
def rolled(tmp_path: Path) -> Path:
    """The case of Gusev, of whose two profiles one is rolled by 22 degrees, and which states no beam."""
    path = write_site(plain_site(), tmp_path)
    path.write_text(path.read_text(encoding="utf-8").replace("beam_sigma_mrad = 0.0\n", ""), encoding="utf-8")
    return path


def beams(path: Path, stated: str = "", after: str = "ap19043l.b", laser: bool = True) -> dict[str, tuple[int, float]]:
    """Image and sigma (mrad) of each beam of a case, with more text after the line of one of its profiles."""
    text = path.read_text(encoding="utf-8")
    there = path.with_name("stated.toml")
    there.write_text(text.replace(f'"{after}"\n', f'"{after}"\n{stated}\n'), encoding="utf-8")
    found = mgsgraph.read_case(there, laser=laser).network.shared
    assert all(one.kind is SharedKind.ALTIMETER_BORESIGHT for one in found)
    return {one.name: (int(one.images[0]), round(float(one.sigmas[0] * 1e3), 9)) for one in found}


def test_the_beam_of_a_rolled_profile_is_an_unknown(rolled: Path) -> None:
    default = {"beam of ap19043l": (1, 0.25)}
    assert beams(rolled) == default
    assert beams(rolled, laser=False) == {}
    assert beams(rolled, "beam_sigma_mrad = 0.5") == {"beam of ap19043l": (1, 0.5)}
    assert beams(rolled, "beam_sigma_mrad = 0") == beams(rolled, "ranges = false") == {}
    (nadir,) = set(re.findall(r'file = "(ap.*)"', rolled.read_text(encoding="utf-8"))) - {"ap19043l.b"}
    assert len(beams(rolled, "beam_sigma_mrad = 0.1", nadir)) == 2
    with pytest.raises(InputError, match="without ranges"):
        beams(rolled, "ranges = false\nbeam_sigma_mrad = 0.5")
    both = '[[shared]]\nkind = "altimeter boresight"\nsigma_mrad = 1.0\n'
    rolled.write_text(rolled.read_text(encoding="utf-8") + both, encoding="utf-8")
    assert list(beams(rolled)) == ["altimeter boresight"]


def test_a_profile_may_drift(rolled: Path) -> None:
    text = rolled.read_text(encoding="utf-8")
    rolled.write_text(text.replace('"ap19043l.b"\n', '"ap19043l.b"\ndrift_sigma_m = 30.0\n'), encoding="utf-8")
    (drift,) = (one for one in mgsgraph.read_case(rolled).network.shared if one.kind is SharedKind.PROFILE_DRIFT)
    assert (drift.name, drift.profile, drift.sigmas.tolist()) == ("drift of ap19043l", "ap19043l", [30.0, 30.0])
    still = rolled.read_text(encoding="utf-8").replace("shift_sigma_m = 100.0\n", "")
    rolled.write_text(still, encoding="utf-8")
    with pytest.raises(InputError, match="without shift_sigma_m"):
        mgsgraph.read_case(rolled)


@pytest.mark.slow
def test_a_rolled_profiles_heights_are_as_good_as_its_beam(rolled: Path) -> None:
    """Adjusted without the beam from which they are drawn, they are off by many times what is stated."""
    case = mgsgraph.read_case(rolled)
    moved, _ = case.network.beams(case.network.shared[0])
    squares = np.empty((12, 2))
    for seed in range(12):
        draw = redraw(case.network, np.random.default_rng(seed))
        for k, net in enumerate((draw.network, replace(draw.network, shared=()))):
            found = mgsgraph.adjust_network(net, case.settings)
            error, up = found.places[moved] - draw.places[moved], draw.places[moved] / 3.39e6
            height = np.einsum("ni,nij,nj->n", up, found.covariances[moved], up)
            squares[seed, k] = np.mean(np.einsum("ni,ni->n", error, up) ** 2 / height)
    assert 0.25 < squares[:, 0].mean() < 2.4  # chi-square with 12 degrees of freedom, 99%: a profile errs as one
    assert squares[:, 1].mean() > 100.0
