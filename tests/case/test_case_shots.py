"""Laser shots of any altimeter in a case file: names of today and of old, sigmas, and lengths in a wrong unit."""

import re
from pathlib import Path

import numpy as np
import pytest
from profiles import with_profile

import mgsgraph
from mgsgraph.case.case_file import decode
from mgsgraph.case.schema import ShotsInput
from mgsgraph.errors import InputError
from mgsgraph.geometry.altimetry import ANY, LOLA, MOLA


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
    with pytest.raises(InputError, match=r"range_sigma_m.*an altimeter"):
        entry.with_sigmas_of(ANY, "x")


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
