"""Laser shots of any altimeter in a case file: names of today and of old, sigmas, and lengths in a wrong unit."""

import json
from pathlib import Path

import numpy as np
import pytest
from profiles import with_profile

import mgsgraph
from mgsgraph.case.case_file import decode
from mgsgraph.case.laser import ShotsInput
from mgsgraph.errors import InputError
from mgsgraph.geometry.altimeters import LOLA, MLA, MOLA


def test_files_of_earlier_versions_say_mola_and_pedr(case_file: Path) -> None:
    today = with_profile(case_file).read_text(encoding="utf-8")
    old = case_file.with_name("old.toml")
    old.write_text(today.replace('[[shots]]\nfile =', '[[mola]]\npedr ='), encoding="utf-8")

    assert decode(old).shots == decode(case_file).shots
    assert decode(old).shots[0].file == "profile.csv"
    old.write_text(old.read_text(encoding="utf-8").replace("[[mola]]", '[[mola]]\nleap_seconds = "old.tls"'))
    assert decode(old).shots == decode(case_file).shots
    found = mgsgraph.read_case(old).network
    np.testing.assert_array_equal(found.ranges.values, mgsgraph.read_case(case_file).network.ranges.values)
    both = old.with_name("both.toml")
    both.write_text(old.read_text(encoding="utf-8") + '\n[[shots]]\nfile = "more.csv"\n', encoding="utf-8")
    assert [entry.file for entry in decode(both).shots] == ["profile.csv", "more.csv"]


def test_sigmas_are_the_altimeters_where_a_case_says_none() -> None:
    entry = ShotsInput("shots.csv")
    assert entry.settled(MOLA, "x").range_sigma_m == entry.settled(MOLA, "x").ground_sigma_m == 10.0
    assert entry.settled(LOLA, "x").range_sigma_m == LOLA.range_sigma == 1.0
    assert ShotsInput("x", range_sigma_m=3.0).settled(LOLA, "x").range_sigma_m == 3.0
    with pytest.raises(InputError, match=r"ground_sigma_m.*MLA"):
        entry.settled(MLA, "x")


@pytest.mark.parametrize(
    ("key", "factor", "said"),
    [("range", 1000.0, "ranges"), ("range", 0.001, "ranges"), ("radius", 1000.0, "radii"), ("radius", 0.001, "radii")],
)
def test_lidar_data_in_another_unit_are_named(case_file: Path, key: str, factor: float, said: str) -> None:
    path = case_file.with_name("lidar.json")
    content = json.loads(path.read_text(encoding="utf-8"))
    for point in content["points"]:
        point[key] *= factor
    path.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        mgsgraph.read_case(case_file)
    assert str(path) in str(caught.value)
    assert said in str(caught.value)
    assert ("metres stand where" if factor > 1.0 else "kilometres stand where") in str(caught.value)


def test_a_profile_whose_ranges_are_kilometres(case_file: Path) -> None:
    path = with_profile(case_file).with_name("profile.csv")
    rows = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()]
    for row in rows[1:]:
        row[3] = str(float(row[3]) / 1000.0)
    path.write_text("\n".join(map(",".join, rows)), encoding="utf-8")
    with pytest.raises(InputError, match=r"ranges.*kilometres stand where"):
        mgsgraph.read_case(case_file)


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
