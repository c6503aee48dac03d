"""[[shared]], [[altimetry]] and [[shots]] in a case file."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from outside import refuses
from profiles import with_profile
from redraw import redraw
from sites import plain_site

import mgsgraph
from mgsgraph.case.case_file import decode
from mgsgraph.case.reading import read_altimetry
from mgsgraph.case.schema import AltimetryInput, ShotsInput
from mgsgraph.errors import InputError
from mgsgraph.geometry.altimetry import LOLA, MLA, MOLA
from mgsgraph.network import Network, PointClass, SharedKind
from mgsgraph.results.inventory import inventory
from mgsgraph.simulation.files import write_site
from mgsgraph.simulation.orbit import MARS

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


def test_ranges_and_footprints_of_a_case_have_what_their_echoes_say_in_common(rolled: Path) -> None:
    """Each range gets as much more variance as its footprint, which has it with or without ranges."""
    text, networks = rolled.read_text(encoding="utf-8"), list[Network]()
    for stated in ("pulse_share = 0.0", "pulse_share = 0.1", "pulse_share = 0.1\nranges = false"):
        rolled.write_text(text.replace("pulse_share = 0.0", stated), encoding="utf-8")
        networks.append(mgsgraph.read_case(rolled).network)
    plain, echoes, alone = networks
    assert plain.ranges.shares is None
    more = (echoes.points.covariances - plain.points.covariances)[echoes.ranges.point]
    assert np.trace(more, axis1=1, axis2=2) == pytest.approx(echoes.range_sigmas**2 - plain.ranges.sigmas**2, rel=1e-6)
    assert np.median(echoes.range_sigmas) > 1.1 * np.median(plain.ranges.sigmas)
    np.testing.assert_array_equal(alone.points.covariances, echoes.points.covariances)


def test_the_beam_of_a_rolled_profile_is_an_unknown(rolled: Path) -> None:
    default = {"beam of ap19043l": (1, 0.25)}
    assert beams(rolled) == default
    assert beams(rolled, laser=False) == {}
    assert beams(rolled, "beam_sigma_mrad = 0.5") == {"beam of ap19043l": (1, 0.5)}
    assert beams(rolled, "beam_sigma_mrad = 0") == beams(rolled, "ranges = false") == {}
    (nadir,) = set(re.findall(r'file = "(ap.*)"', rolled.read_text(encoding="utf-8"))) - {"ap19043l.b"}
    assert len(beams(rolled, "beam_sigma_mrad = 0.1", nadir)) == 2
    refuses("without ranges", beams, rolled, "ranges = false\nbeam_sigma_mrad = 0.5")
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
    refuses("without shift_sigma_m", mgsgraph.read_case, rolled)


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


# --- laser altimetry in a case file: its keys, and the shots that it names


TABLE = """
[[altimetry]]
file = "cloud.csv"
sigma_m = [5.0, 0.5]
shift_sigma_m = [20.0, 30.0, 2.0]
drift_sigma_m = 1.5
footprint_m = 12.0
margin_px = 20.0
"""
TWO_SHOTS = "longitude_deg,latitude_deg,height_m,orbit\n175.5,-14.5,-1900.0,3\n175.5,-14.6,-1910.0,3\n"


def test_shots_that_a_table_names(tmp_path: Path) -> None:
    (tmp_path / "cloud.csv").write_text(TWO_SHOTS, encoding="utf-8")
    cloud = read_altimetry(AltimetryInput("cloud.csv", footprint_m=12.0), tmp_path, MARS)

    assert (len(cloud.ids), cloud.profiles, cloud.footprint) == (2, ("3",), 12.0)
    refuses(r"cloud\.csv.*footprint_m", read_altimetry, AltimetryInput("cloud.csv"), tmp_path, MARS)


def test_the_size_of_spots_goes_by_the_altimeter(shared_data: Path) -> None:
    entry = AltimetryInput("mola_pedr_ode/insight_topography.csv")
    cloud = read_altimetry(entry, shared_data, MARS)

    assert cloud.footprint == 168.0
    assert np.unique(cloud.profile).size == len(cloud.profiles)


def test_shots_over_the_images_become_points_of_profiles(case_file: Path) -> None:
    """Those beside them don't; each profile has a shift, a height and a drift of its own."""
    alone = mgsgraph.read_case(case_file).network
    ties = alone.points.places[alone.points.classes == PointClass.TIE]
    ground = alone.images[0].image_to_ground(np.array([900.0, 1200.0, 1500.0]), np.full(3, 300.0))[0]
    assert np.linalg.norm(ground - ties.mean(axis=0), axis=1).max() < 50e3 or np.isnan(ties).all()
    rows = "".join(f"{x!r},{y!r},{z!r},{orbit}\n" for (x, y, z), orbit in zip(ground.tolist(), (7, 7, 8), strict=True))
    far = "3396190.0,0.0,0.0,9\n"
    (case_file.parent / "cloud.csv").write_text("x_m,y_m,z_m,orbit\n" + rows + far, encoding="utf-8")
    network = mgsgraph.read_case(with_text(case_file, TABLE.replace("20.0, 30.0", "20.0, 20.0"))).network
    new = np.arange(len(alone.points), len(network.points))

    assert new.size == 3
    np.testing.assert_allclose(network.points.places[new], ground, atol=1e-6)
    up = ground[0] / np.linalg.norm(ground[0])
    assert up @ network.points.covariances[new[0]] @ up == pytest.approx(0.25)
    assert network.shifts is not None
    assert network.shifts.names[-2:] == ("cloud:7", "cloud:8")
    assert network.shifts.profile[new].tolist() == [len(network.shifts.names) - 2] * 2 + [len(network.shifts.names) - 1]
    heights = [one for one in network.shared if one.kind is SharedKind.PROFILE_HEIGHT]
    assert [one.profile for one in heights] == ["cloud:7", "cloud:8"]
    np.testing.assert_allclose(heights[0].sigmas, [2.0, 1.5])


def test_shots_that_no_image_shows_are_refused(case_file: Path) -> None:
    (case_file.parent / "cloud.csv").write_text("x_m,y_m,z_m\n3396190.0,0.0,0.0\n", encoding="utf-8")
    refuses(r"cloud\.csv.*1 shots", mgsgraph.read_case, with_text(case_file, TABLE.replace("20.0, 30.0", "20.0, 20.0")))


# --- laser shots of any altimeter in a case file: names of today and of old, sigmas, and lengths in a wron


@pytest.mark.parametrize(
    ("old", "word"),
    [("[[mola]]", "expected [[shots]]"), ("[[shots]]\npedr = 'x'", "expected file"),
     ("[[shots]]\nleap_seconds = 'x'", "leap seconds are built in"), ("[[strips]]", "with a prior"),
     ("[[passes]]\nprior = { angle_sigma_mgon = 1 }", "expected angle_sigma_mrad; 1 mgon is 0.015708 mrad")],
)  # fmt: skip
def test_words_of_earlier_versions_name_those_of_today(case_file: Path, old: str, word: str) -> None:
    case_file.write_text(f"{case_file.read_text(encoding='utf-8')}\n{old}\n", encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(word)) as caught:
        decode(case_file)
    assert "a word of earlier versions" in str(caught.value)


def test_sigmas_are_the_altimeters_where_a_case_says_none() -> None:
    entry = ShotsInput("shots.csv")
    assert entry.with_sigmas_of(MOLA, "x").range_sigma_m == entry.with_sigmas_of(MOLA, "x").ground_sigma_m == 10.0
    assert entry.with_sigmas_of(LOLA, "x").range_sigma_m == LOLA.range_sigma == 1.0
    assert ShotsInput("x", range_sigma_m=3.0).with_sigmas_of(LOLA, "x").range_sigma_m == 3.0
    refuses(r"ground_sigma_m.*MLA", entry.with_sigmas_of, MLA, "x")


def test_a_profile_whose_ranges_are_kilometres(case_file: Path) -> None:
    path = with_profile(case_file).with_name("profile.csv")
    rows = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()]
    for row in rows[1:]:
        row[3] = str(float(row[3]) / 1000.0)
    path.write_text("\n".join(map(",".join, rows)), encoding="utf-8")
    refuses(r"ranges.*kilometres stand where", mgsgraph.read_case, case_file)


def test_every_so_many_th_shot_is_a_check_point(case_file: Path) -> None:
    """Of every three the third: the others are points of the network, in their order."""
    text = with_profile(case_file).read_text(encoding="utf-8")
    every = list(mgsgraph.read_case(case_file).network.points.ids)
    profile = [name for name in every if name.startswith("profile:")]
    case_file.write_text(text.replace("[[shots]]\n", "[[shots]]\ncheck_every = 3\n"), encoding="utf-8")
    left = list(mgsgraph.read_case(case_file).network.points.ids)
    assert len(profile) > 3
    assert left == [name for name in every if name not in profile[2::3]]


def test_profiles_of_one_file_have_a_shift_each(case_file: Path) -> None:
    path = with_profile(case_file).with_name("profile.csv")
    lines = path.read_text(encoding="utf-8").splitlines()
    half = 1 + len(lines) // 2
    path.write_text("\n".join([*lines[:half], *(f"{line[: -len('18933')]}18945" for line in lines[half:])]))
    text = case_file.read_text(encoding="utf-8").replace("shift_sigma_m", "drift_sigma_m = 3.0\nshift_sigma_m")
    case_file.write_text(text, encoding="utf-8")
    network = mgsgraph.read_case(case_file).network

    assert network.shift_names == ("profile:18933", "profile:18945")
    assert network.shifts is not None
    shots = network.shifts.profile[network.shifts.profile >= 0]
    assert np.count_nonzero(shots == 0) == half - 1
    assert sum("drift" in one.name for one in network.shared) == 2
