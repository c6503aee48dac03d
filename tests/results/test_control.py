"""Shifts, terrain and back-projections in the products, against the arrays they come from."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface
from stereo_pair import stereo_network

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.results.ground import control_section, surface_heights
from mgsgraph.results.results import solution_json
from mgsgraph.results.tables import residuals_table


def test_shifts_and_heights_are_told() -> None:
    solution = adjust_network(with_shift_and_surface(network(pair())), SolverSettings())
    record = control_section(solution).numbers
    shift, terrain = record["shifts"]
    assert terrain["name"] == "terrain model"
    assert shift["east_north_m"] == solution.shifts[0].tolist()
    assert shift["sigma_east_north_m"] == pytest.approx(solution.joint_covariance.sigmas[-4:-2].tolist())
    before, after = surface_heights(solution)
    assert record["surface"]["count"] == after.size == 12
    assert record["surface"]["rms_height_before_m"] == pytest.approx(np.sqrt(np.mean(before**2)))
    words = " ".join(control_section(solution).sentences)
    assert "profile moved" in words
    assert "terrain model moved" in words
    assert "12 tie points were held to the terrain model" in words
    assert "back-projections" not in words
    assert solution_json(solution)["control"] == record


def test_heights_above_stereo_surfaces_are_told(tmp_path: Path) -> None:
    solution = adjust_network(stereo_network(pair(), displaced=False), SolverSettings())
    heights = solution.stereo_heights[-6:]
    assert control_section(solution).numbers["stereo"] == {
        "count": 6, "rms_height_m": pytest.approx(np.sqrt(np.mean(heights**2)))
    }  # fmt: skip
    assert "6 points were held to stereo surfaces" in " ".join(control_section(solution).sentences)
    residuals_table(solution).write_csv(tmp_path / "residuals.csv")
    with (tmp_path / "residuals.csv").open(encoding="utf-8", newline="") as file:
        mine = [row for row in csv.DictReader(file) if row["kind"] == "stereo height"]
    assert [row["point"] for row in mine] == list(solution.network.points.ids[-6:])
    assert [float(row["residual_height_m"]) for row in mine] == (-heights).tolist()
    said = {(row["image"], row["used"], row["isis_line"], float(row["sigma_height_m"])) for row in mine}
    assert said == {("", "true", "", 1.0)}


def test_back_projections_are_owned_up_to() -> None:
    net = network(pair())
    copied = np.arange(net.rays.point.size) % 2 == 0
    solution = adjust_network(replace(net, rays=replace(net.rays, back_projected=copied)), SolverSettings())
    assert control_section(solution).numbers["back_projected_rays"] == copied.sum()
    assert "too small" in " ".join(control_section(solution).sentences)


def test_without_any_of_it_nothing_is_said() -> None:
    solution = adjust_network(network(pair()), SolverSettings())
    assert control_section(solution).sentences == []
    assert control_section(solution).numbers["surface"]["count"] == 0
