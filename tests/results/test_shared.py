"""Reports of what images share: figures, sentences, files, and whether it can be told apart from a constant pitch."""

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
from mgsgraph.adjustment.graph import BundleGraph, lay_out
from mgsgraph.adjustment.settings import Angles, SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.separability import pitch_axis, shared_estimates
from mgsgraph.errors import InputError
from mgsgraph.network import SharedKind
from mgsgraph.results.archive import read_solution, write_archive
from mgsgraph.results.passes import shared_section, shared_table
from mgsgraph.results.results import solution_json, statements, summary_table, write_results


@cache
def single(angles: Angles = "camera", sigma: float = 1.0) -> Solution:
    """One nadir image and a held one, whose camera's clock may be late."""
    return adjust_network(camera_clock(network(drawn(1)), sigma), SolverSettings(angles=angles))


@cache
def of_all_kinds() -> Solution:
    return adjust_network(with_all_kinds(with_shift_and_surface(network(pair()))), SolverSettings())


def test_a_single_pair_says_that_it_equals_a_constant_pitch_of_the_nadir_image() -> None:
    (one,) = shared_estimates(single())
    assert one.image == "SIM/A"
    assert one.likeness > 0.999
    assert 0.6 < one.correlation < 0.9
    assert 320.0 < one.ground < 345.0
    (sentence,) = shared_section(single()).sentences
    assert "The priors alone separate it from a constant pitch of image SIM/A" in sentence
    assert f"1 s of it is {one.ground:.0f} m on the ground there" in sentence
    assert sentence in statements(single())


def test_six_images_name_the_three_nadir_ones_together() -> None:
    """Each by itself is like it by one in the square root of three."""
    (one,) = shared_estimates(adjust_network(camera_clock(block(1)), SolverSettings()))
    assert one.likeness == pytest.approx(3.0**-0.5, abs=0.01)
    assert one.together > 0.999
    assert one.mixture == ("SIM/A1", "SIM/A2", "SIM/A3")


def test_where_pitch_is_known_it_is_told_apart() -> None:
    """A thousand times sharper priors on the attitude: the correlation goes, the likeness stays."""
    net = network(drawn(1))
    sharp = tuple(replace(prior, sigmas=prior.sigmas * np.repeat([1.0, 1e-3], 3)) for prior in net.priors)
    solution = adjust_network(camera_clock(replace(net, priors=sharp)), SolverSettings())
    (one,) = shared_estimates(solution)
    assert abs(one.correlation) < 0.01
    assert one.sigma < 0.4
    assert one.likeness > 0.999


def test_likeness_is_that_of_the_data_alone() -> None:
    """By NumPy, from the reduced normal matrix without priors (and about the nominal axis, 1e-4 rad away)."""
    solution = of_all_kinds()
    layout = lay_out(solution.network, solution.settings)
    columns = np.concatenate([c.ravel() for c in solution.coefficients] + [solution.shifts.ravel(), *solution.shared])
    reduction = BundleGraph(layout).reduction(columns)
    normal = np.zeros((layout.columns,) * 2)
    for v, w, own in layout.blocks.each(reduction.blocks, layout.variables.width):
        normal[layout.columns_of(v), layout.columns_of(w)] = own
        normal[layout.columns_of(w), layout.columns_of(v)] = own.T
    first = layout.columns - sum(value.size for value in solution.shared)
    pitch = [layout.columns_of(j).start + 4 for j in (0, 1)]  # about the camera's y, along the detector
    size = np.sqrt(np.diag(normal))
    for k, one in enumerate(shared_estimates(solution)):
        if one.kind.of_profile:
            assert one.image == ""  # no image's pitch is like it
            continue
        expected = np.abs(normal[first + k, pitch] / (size[first + k] * size[pitch]))
        j = ("SIM/A", "SIM/B").index(one.image)
        assert one.likeness == pytest.approx(expected[j], rel=1e-3, abs=1e-3)
        covariance = solution.joint_covariance.dense()[first + k, pitch[j]]
        sigmas = np.sqrt(np.diag(solution.joint_covariance.dense()))
        correlation = covariance / (sigmas[first + k] * sigmas[pitch[j]])
        assert abs(one.correlation) == pytest.approx(abs(correlation), abs=1e-3)


def test_pitch_lifts_the_view_forward() -> None:
    for image in pair().images:
        axis = pitch_axis(image)
        pose = image.pose(np.array([0.5 * image.lines]))
        assert np.linalg.norm(axis) == pytest.approx(1.0)
        assert np.cross(axis, [0.0, 0.0, 1.0]) @ pose.matrix[0] @ pose.velocity[0] > 0.0
        np.testing.assert_allclose(np.abs(axis), [0.0, 1.0, 0.0], atol=1e-9)


def test_angles_of_another_kind_are_as_alike() -> None:
    """The correlation is another: a sigma for each of omega, phi and kappa is not one for each of the camera's axes."""
    (camera,), (angles,) = shared_estimates(single()), shared_estimates(single("opk-paper"))
    assert angles.likeness == pytest.approx(camera.likeness, abs=2e-3)
    assert angles.ground == camera.ground


def test_what_the_measures_say_nothing_about_is_named() -> None:
    said = shared_section(single(sigma=0.01)).sentences
    assert "The measurements say hardly anything about it." in said[0]


def test_held_images_have_no_pitch() -> None:
    net = network(pair(), held=(True, True))
    solution = adjust_network(camera_clock(net), SolverSettings())
    (one,) = shared_estimates(solution)
    assert one.image == ""
    assert np.isnan(one.correlation)
    assert one.sigma < 0.5
    assert solution_json(solution)["shared"][0]["correlation_with_pitch"] is None


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
