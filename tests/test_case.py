"""Case files: what they say becomes a network; what is wrong in them is said in one line with its path."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import mgsgraph
from mgsgraph.errors import InputError
from mgsgraph.network import PointClass
from mgsgraph.ties import PointKind
from mgsgraph.units import MRAD

Edit = Callable[[str], str]


def swap(old: str, new: str) -> Edit:
    def edit(text: str) -> str:
        assert old in text, f"{old!r} isn't in the case file"
        return text.replace(old, new, 1)

    return edit


def add(line: str) -> Edit:
    return lambda text: text + "\n" + line + "\n"


def edited(case_file: Path, *edits: Edit) -> Path:
    text = case_file.read_text(encoding="utf-8")
    for edit in edits:
        text = edit(text)
    case_file.write_text(text, encoding="utf-8")
    return case_file


def test_a_case_becomes_a_network(case_file: Path) -> None:
    case = mgsgraph.read_case(case_file)
    net = case.network
    assert [image.name for image in net.images] == ["SIM/A", "SIM/B"]
    assert len(net.points) == 28
    assert net.rays.point.size == 56
    assert net.ranges.point.size == 8
    assert np.all(net.rays.sigmas[net.points.classes[net.rays.point] == PointClass.TIE] == 1.0)
    assert np.all(net.rays.sigmas[net.points.classes[net.rays.point] == PointClass.LASER] == 5.0)
    np.testing.assert_allclose(net.priors[0].sigmas[:, 0], [30.0, 3.0, 0.3])
    np.testing.assert_allclose(net.priors[0].sigmas[:, 3], np.array([1.0, 0.1, 0.01]) * 0.1 * MRAD)
    assert "28 points" in repr(case)


def test_laser_false_leaves_the_laser_out(case_file: Path) -> None:
    with_rows = mgsgraph.read_case(case_file, laser=False).network
    text = re.sub(r"\[laser\][^\[]*", "", case_file.read_text(encoding="utf-8"))
    case_file.write_text(text.replace("format = 1", "format = 1\nlaser = false"), encoding="utf-8")
    net = mgsgraph.read_case(case_file).network
    assert net.ranges.point.size == with_rows.ranges.point.size == 0
    assert len(net.points) == len(with_rows.points) == 20


def test_settings_and_overrides(case_file: Path) -> None:
    case = mgsgraph.read_case(
        edited(
            case_file,
            swap(
                'isd = "image_B.isd"',
                'isd = "image_B.isd"\nheld = true\norientation = {degree = 1, '
                "position_sigma_m = [1.0, 2.0, inf], angle_sigma_mrad = 3, trend = [1, 0.5]}",
            ),
            add('[solver]\nloss = "huber"\nreject = 5\nline = "measured"'),
        )
    )
    assert case.network.held.tolist() == [False, True]
    assert case.network.priors[1].sigmas[0].tolist() == [1.0, 2.0, np.inf, 0.003, 0.003, 0.003]
    assert case.network.priors[1].degree == 1
    assert (case.settings.loss, case.settings.reject, case.settings.line) == ("huber", 5.0, "measured")


def test_files_own_sigmas_where_the_case_is_silent(case_file: Path) -> None:
    case = mgsgraph.read_case(edited(case_file, lambda text: re.sub(r"(range|ground)_sigma_m = .*\n", "", text)))
    assert np.all(case.network.ranges.sigmas == 1.0)
    laser = case.network.points.classes == PointClass.LASER
    np.testing.assert_allclose(
        case.network.points.covariances[laser], np.eye(3) * 100.0 * np.ones((8, 1, 1)), atol=1e-6
    )


def test_ground_control_joins_in(case_file: Path) -> None:
    case_file.with_name("points.gcp").write_text(
        "G1 4.0 87.0 10.0 1 1 1 SIM/A 100 200 1 1 SIM/B 150 220 1 1\n", encoding="utf-8"
    )
    net = mgsgraph.read_case(edited(case_file, add('[ground_control]\nfile = "points.gcp"'))).network
    control = np.flatnonzero(net.points.classes == PointClass.CONTROL)
    assert [net.points.ids[i] for i in control] == ["G1"]
    assert net.points.kinds[control] == [PointKind.CONSTRAINED]
    assert net.rays.places[net.rays.point == control[0]].tolist() == [[200.5, 100.5], [220.5, 150.5]]


WRONG: dict[str, tuple[tuple[Edit, ...], str]] = {
    "no format": ((swap("format = 1", ""),), r"no key 'format'.*format = 1"),
    "newer format": ((swap("format = 1", "format = 99"),), r"format 99"),
    "malformed": ((add("= 3"),), r"malformed TOML.*line"),
    "unknown key": ((swap("sigma_px", "sigma_pix"),), r"ties.*unknown field `sigma_pix`"),
    "unknown key in an image": ((swap('isd = "image_A', 'helt = true\nisd = "image_A'),), r"images\[0\].*helt"),
    "unknown table": ((add("[sulver]"),), r"unknown field `sulver`"),
    "negative sigma": ((swap("sigma_px = 1.0", "sigma_px = -1.0"),), r"ties.sigma_px.*>= 1e-06"),
    "zero sigma": ((swap("range_sigma_m = 1.0", "range_sigma_m = 0"),), r"laser"),
    "absurd sigma": ((swap("sigma_px = 1.0", "sigma_px = 1e300"),), r"ties.sigma_px"),
    "infinite sigma": ((swap("sigma_px = 1.0", "sigma_px = inf"),), r"ties.sigma_px"),
    "negative orientation sigma": ((swap("position_sigma_m = 30.0", "position_sigma_m = -1"),), r"position_sigma_m"),
    "two orientation sigmas": ((swap("position_sigma_m = 30.0", "position_sigma_m = [1, 2]"),), r"position_sigma_m"),
    "nan": ((swap("sigma_px = 1.0", "sigma_px = nan"),), r"nan|>= 1e-06"),
    "nan in a list": ((swap("trend = [1.0", "trend = [nan"),), r"trend"),
    "empty trend": ((swap("trend = [1.0, 0.1, 0.01]", "trend = []"),), r"trend"),
    "text for a number": ((swap("sigma_px = 1.0", 'sigma_px = "one"'),), r"ties.sigma_px"),
    "unknown loss": ((add('[solver]\nloss = "l1"'),), r"solver.loss"),
    "odd reject": ((add("[solver]\nreject = 0.5"),), r"reject"),
    "no images": ((lambda text: re.sub(r"\[\[images\]\][^\[]*", "", text),), r"images"),
    "laser = true": (
        (lambda t: re.sub(r"\[laser\][^\[]*", "", t).replace("format = 1", "format = 1\nlaser = true"),),
        r"laser.*true",
    ),
    "missing ISD": ((swap("image_A.isd", "image_C.isd"),), r"image_C.isd: no such file"),
    "missing network": ((swap("network.pvl", "net.pvl"),), r"net.pvl: no such file"),
    "folder for a file": ((swap("network.pvl", "."),), r"a folder"),
    "unknown image in the network": ((swap('name = "SIM/B"', 'name = "SIM/C"'),), r"the image 'SIM/B'.*SIM/A"),
    "image twice": ((swap('name = "SIM/B"', 'name = "SIM/A"'),), r"SIM/A"),
    "no observations": ((lambda text: re.sub(r"\[(ties|laser)\][^\[]*", "", text),), r"at least one of them"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_what_is_wrong_is_said_in_one_line(case_file: Path, fault: str) -> None:
    edits, said = WRONG[fault]
    with pytest.raises(InputError, match=said) as caught:
        mgsgraph.read_case(edited(case_file, *edits))
    assert "\n" not in str(caught.value)


def test_an_image_that_sees_nothing(case_file: Path) -> None:
    path = edited(case_file, swap("[orientation]", '[[images]]\nname = "SIM/C"\nisd = "image_A.isd"\n\n[orientation]'))
    with pytest.raises(InputError, match=r"image SIM/C: no point is measured in it"):
        mgsgraph.read_case(path)


def test_a_measure_off_its_image(case_file: Path) -> None:
    network = case_file.with_name("network.pvl")
    text = re.sub(r"(\n\s*Line\s*=\s*)[\d.]+", r"\g<1>999999.0", network.read_text(encoding="utf-8"), count=1)
    network.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"line 999999.*a place inside"):
        mgsgraph.read_case(case_file)


def test_a_shot_outside_the_tables(case_file: Path) -> None:
    lidar = case_file.with_name("lidar.json")
    text = lidar.read_text(encoding="utf-8")
    time = re.search(r'"time": (-?[\d.]+)', text)
    assert time
    lidar.write_text(text.replace(time[1], str(float(time[1]) + 1000.0), 1), encoding="utf-8")
    with pytest.raises(InputError, match=r"laser shot .*image SIM/A: time .* outside the tables"):
        mgsgraph.read_case(case_file)


def test_the_same_id_in_two_files(case_file: Path) -> None:
    net = mgsgraph.read_case(case_file).network
    tie = net.points.ids[0]
    case_file.with_name("points.gcp").write_text(f"{tie} 4.0 87.0 10.0 1 1 1 SIM/A 100 200 1 1\n", encoding="utf-8")
    with pytest.raises(InputError, match=rf"the id '{tie}'"):
        mgsgraph.read_case(edited(case_file, add('[ground_control]\nfile = "points.gcp"')))


def test_the_real_case(shared_data: Path) -> None:
    case = mgsgraph.read_case(Path(__file__).parents[1] / "scripts" / "cases" / "lro_nac_lola.toml")
    counts = {name: members.size for name, members in case.network.of_class()}
    assert counts == {PointClass.TIE: 311, PointClass.LASER: 52}
    assert case.network.ranges.point.size == 52
    assert len(case.network.islands()) == 1
