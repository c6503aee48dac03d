"""Reports of what images share: figures, sentences, files, and whether it is separable."""

import csv
import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface
from sharing import block, camera_clock, drawn, with_all_kinds

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.separability import Verdict, separations
from mgsgraph.errors import InputError
from mgsgraph.network import SharedKind
from mgsgraph.results.archive import read_solution, write_archive
from mgsgraph.results.passes import shared_section, shared_table
from mgsgraph.results.results import solution_json, statements, summary_table, write_results


@cache
def single(sigma: float = 1.0) -> Solution:
    """One nadir image and a held one, whose camera's clock may be late."""
    return adjust_network(camera_clock(network(drawn(1)), sigma), SolverSettings())


@cache
def of_all_kinds() -> Solution:
    return adjust_network(with_all_kinds(with_shift_and_surface(network(pair()))), SolverSettings())


def test_a_single_pair_says_that_its_pitch_and_the_clock_are_inseparable() -> None:
    (one,) = separations(single())
    assert one.verdict is Verdict.NOT_FROM_OTHERS
    assert one.other == "constant rotation y of image SIM/A"
    assert one.together > 0.999
    assert 0.6 < abs(one.correlation) < 0.9
    assert 320.0 < one.ground < 345.0
    (sentence,) = shared_section(single()).sentences
    assert sentence.startswith("Attitude-time bias: Not separable from all others together: r = 1.000")
    assert sentence in statements(single())


def test_several_images_are_only_together_like_it() -> None:
    (one,) = separations(adjust_network(camera_clock(block(1)), SolverSettings()))
    assert abs(one.correlation) < 0.6
    assert one.together > 0.999


def test_where_pitch_is_known_the_position_is_its_rival() -> None:
    """A thousand times sharper priors on the attitude: late by so much is ahead by so much."""
    net = network(drawn(1))
    sharp = tuple(replace(prior, sigmas=prior.sigmas * np.repeat([1.0, 1e-3], 3)) for prior in net.priors)
    (one,) = separations(adjust_network(camera_clock(replace(net, priors=sharp)), SolverSettings()))
    assert one.verdict is Verdict.NOT_FROM_ONE
    assert one.other == "constant Z of image SIM/A"
    assert one.sigma < 0.4


def test_what_the_measures_say_nothing_about_is_named() -> None:
    said = shared_section(single(sigma=0.01)).sentences
    assert "Determined by its prior alone" in said[0]


def test_images_that_are_held_are_no_rivals() -> None:
    (one,) = separations(adjust_network(camera_clock(network(pair(), held=(True, True))), SolverSettings()))
    assert one.other == ""
    assert one.sigma < 0.5


def test_files(tmp_path: Path) -> None:
    solution = of_all_kinds()
    assert "shared.csv" in write_results(solution, tmp_path / "out", figures=False)
    with (tmp_path / "out" / "shared.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["kind"] for row in rows] == [str(kind) for kind in SharedKind for _ in range(kind.width)]
    assert [row["axis"] for row in rows[2:5]] == ["x", "y", "z"]
    assert float(rows[0]["value"]) == solution.shared[0][0]
    assert float(rows[3]["value"]) == pytest.approx(solution.shared[2][1] * 1e3, rel=1e-12)
    assert float(rows[3]["prior_sigma"]) == pytest.approx(0.1)
    record = json.loads((tmp_path / "out" / "solution.json").read_text(encoding="utf-8"))
    assert record["shared"][3]["value_mrad"] == pytest.approx(float(rows[3]["value"]))
    assert record["shared"][-1]["ground_m_per_m"] is None
    table, summary = shared_table(solution).text(indent=2, units=True), summary_table(solution).splitlines()
    assert set(table[:10]) <= set(summary)
    assert max(map(len, table)) <= 110
    plain = adjust_network(network(pair()), SolverSettings())
    assert "shared.csv" not in write_results(plain, tmp_path / "plain", figures=False)
    assert solution_json(plain)["shared"] == []
    assert len(shared_table(plain)) == 0


def test_the_archive_keeps_them(tmp_path: Path) -> None:
    solution = of_all_kinds()
    write_archive(solution, tmp_path / "solution.npz")
    back = read_solution(tmp_path)
    assert [one.kind for one in back.network.shared] == list(SharedKind)
    assert solution_json(back) == solution_json(solution)
    write_archive(replace(solution, shared=solution.shared[:-1]), tmp_path / "solution.npz")
    with pytest.raises(InputError, match="shared"):
        read_solution(tmp_path)
