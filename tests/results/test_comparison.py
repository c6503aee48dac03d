"""Two solutions compared: what differs before the adjustment, and what became of the sigmas; moved places and
orientations are in test_report.py.
"""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.quiver import Quiver

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.estimates import CommonPoints
from mgsgraph.cli import group
from mgsgraph.files.output.folders import COMPARISON
from mgsgraph.files.output.table import Table
from mgsgraph.geometry.body import east_north_up
from mgsgraph.results.comparison import compare, input_section, settings_section
from mgsgraph.results.figures.map import comparison_sheet
from mgsgraph.results.results import write_results

LABELS = ("A", "B")


def named(found: list[Table], name: str) -> Table:
    return next(table for table in found if table.name == name)


def test_a_solution_and_itself_have_nothing_apart(solution: Solution) -> None:
    found = compare(solution, solution, LABELS)
    assert {table.name for table in found.section.tables}.isdisjoint({"settings_compared", "input_compared"})
    rows = named(found.section.tables, "sigmas_compared").rows
    ratios = np.array([[float(text) for text in row[4:]] for row in rows])
    np.testing.assert_array_equal(ratios, 1.0)


def test_settings_that_differ_are_listed(solution: Solution) -> None:
    other = replace(solution, settings=replace(solution.settings, loss="huber", loss_width=2.0))
    table = settings_section(solution, other, LABELS).tables[0]
    assert table.rows == [["loss", "none", "huber"], ["loss_width", "not set", "2.0"]]


def test_measures_that_differ_are_counted(solution: Solution) -> None:
    """One left out, two moved by 3 and 4 px, three of twice the sigma."""
    network, rays = solution.network, solution.network.rays
    places, sigmas = rays.places.copy(), rays.sigmas.copy()
    places[[5, 6]] += np.array([3.0, 4.0])
    sigmas[[7, 8, 9]] *= 2.0
    kept = np.arange(1, rays.point.size)
    changed = replace(rays, places=places, sigmas=sigmas).chosen(kept)
    of_measures = {name: getattr(solution, name)[kept] for name in ("residuals", "residuals_before", "rays_used")}
    other = replace(solution, network=replace(network, rays=changed), **of_measures)
    table = input_section(solution, other, LABELS).tables[0]
    numbers = np.array([[int(text) for text in row[1:5]] for row in table.rows])
    assert (numbers[:, 0] - numbers[:, 1]).sum() == 1
    assert numbers[:, 2:].sum(axis=0).tolist() == [2, 3]
    assert input_section(other, solution, LABELS).tables[0].rows[0][5] == "same"


def test_images_of_other_priors_are_named(solution: Solution) -> None:
    network = solution.network
    loose = (replace(network.priors[0], sigmas=3.0 * network.priors[0].sigmas), *network.priors[1:])
    other = replace(solution, network=replace(network, priors=loose))
    found = input_section(solution, other, LABELS)
    assert [row[0] for row in found.tables[0].rows] == [network.images[0].name]
    assert any(network.images[0].name in sentence for sentence in found.sentences)


def test_the_ratio_of_sigmas_is_that_of_the_measures(solution: Solution) -> None:
    """All observations four times as good, priors too: every sigma is a quarter of what it was."""
    earlier, later = (
        replace(solution, covariances=factor * solution.covariances) for factor in (1.0, 1.0 / 16.0)
    )  # fmt: skip
    points = CommonPoints(later, earlier)
    np.testing.assert_allclose(points.ratio[np.isfinite(points.ratio)], 0.25)
    for row in named(compare(later, earlier, LABELS).section.tables, "sigmas_compared").rows:
        assert row[4:] == ["0.250", "0.250", "0.250"]


@pytest.mark.parametrize("copies", [1, 3000])
def test_every_block_has_a_map(solution: Solution, copies: int) -> None:
    """Marks of few points, cells of many; of two points none."""
    rows = np.tile(np.arange(len(solution.network.points)), 1 + copies // len(solution.network.points))
    points = CommonPoints(solution, solution)
    object.__setattr__(points, "rows", (rows, rows))
    sheet = comparison_sheet(points, LABELS)
    assert sheet is not None
    assert ("medians of" in sheet.caption) == (copies > 1)
    few = CommonPoints(solution, solution)
    object.__setattr__(few, "rows", (rows[:2], rows[:2]))
    assert comparison_sheet(few, LABELS) is None


def test_a_square_block_has_arrows(solution: Solution) -> None:
    """Longer than wide by less than four times: drawn east and north to one scale, with the mean movement of cells."""
    points = CommonPoints(solution, solution)
    n, (k, *_) = 400, points.rows[0]
    east, north = np.meshgrid(np.linspace(-2e4, 2e4, 20), np.linspace(-2e4, 2e4, 20))
    frame = east_north_up(solution.places[[k]])[0]
    object.__setattr__(points, "rows", (np.full(n, k), np.full(n, k)))
    plane = np.column_stack([east.ravel(), north.ravel()])
    object.__setattr__(points, "places", solution.places[k] + plane @ frame[:2])
    object.__setattr__(points, "moved", np.tile([3.0, 4.0, 1.0], (n, 1)))
    sheet = comparison_sheet(points, LABELS)
    assert sheet is not None
    (arrows,) = [one for one in sheet.figure.axes[0].collections if isinstance(one, Quiver)]
    np.testing.assert_allclose(np.asarray(arrows.V) / np.asarray(arrows.U), 4.0 / 3.0)


def test_files_hold_every_common_point(solution: Solution, tmp_path: Path) -> None:
    network = solution.network
    other = adjust_network(replace(network, rays=network.rays.chosen(np.arange(network.rays.point.size - 2))),
                           solution.settings)  # fmt: skip
    names = compare(other, solution, LABELS).section.write_folder(tmp_path / "out", COMPARISON)
    assert sorted(names) == sorted(path.name for path in (tmp_path / "out").iterdir())
    with (tmp_path / "out" / "points_compared.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    points = CommonPoints(other, solution)
    assert len(rows) == len(points.places)
    np.testing.assert_array_equal([float(row["east_m"]) for row in rows], points.moved[:, 0])
    record = json.loads((tmp_path / "out" / "comparison.json").read_text(encoding="utf-8"))
    assert record["sigmas_compared"][0]["class"] == "tie"


@pytest.mark.usefixtures("light_figures")
def test_the_command(solution: Solution, tmp_path: Path) -> None:
    write_results(solution, tmp_path / "a", figures=False)
    write_results(replace(solution, places=solution.places + 1.0), tmp_path / "b", figures=False)
    run = CliRunner().invoke(group, ["compare", str(tmp_path / "a"), str(tmp_path / "b"), "--out", str(tmp_path / "c")])
    assert run.exit_code == 0, run.output
    assert {"comparison.json", "comparison.png"} < {path.name for path in (tmp_path / "c").iterdir()}
    again = CliRunner().invoke(group, ["compare", str(tmp_path / "a"), str(tmp_path / "none")])
    assert again.exit_code != 0
