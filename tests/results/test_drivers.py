"""What drives an adjustment that did not converge, in the files of results: record, table, archive, sentences."""

import csv
from pathlib import Path

import numpy as np
import pytest
from networks import network, pair

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.results.archive import read_solution
from mgsgraph.results.page import tables
from mgsgraph.results.results import solution_json, solution_sections, statements, write_results
from mgsgraph.results.soundness import drivers_section, drivers_table


@pytest.fixture(scope="module")
def stopped() -> Solution:
    """Of a pair, after one iteration."""
    return adjust_network(network(pair()), SolverSettings(max_iterations=1))


def test_they_are_in_every_form_of_the_results(stopped: Solution, tmp_path: Path) -> None:
    assert not stopped.converged
    written = write_results(stopped, tmp_path / "result", figures=False)
    assert "drivers.csv" in written
    with (tmp_path / "result" / "drivers.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    record = solution_json(stopped)["drivers"]
    assert record["cost"] == pytest.approx(stopped.cost_final, rel=1e-6)
    images = {image.name for image in stopped.network.images}
    assert {row["name"] for row in rows if row["kind"] == "image"} <= images
    shares = [float(row["share"]) for row in rows if (row["quantity"], row["kind"]) == ("cost", "image")]
    assert sum(shares) <= 1.0 + 1e-12
    assert drivers_section(stopped).sentences[0] in statements(stopped)
    assert any(table.name == "drivers" for table in tables(stopped, solution_sections(stopped)))


def test_they_are_read_back(stopped: Solution, tmp_path: Path) -> None:
    write_results(stopped, tmp_path / "result", figures=False)
    again = read_solution(tmp_path / "result")
    assert drivers_section(again).numbers == drivers_section(stopped).numbers
    assert again.drivers is not None
    assert stopped.drivers is not None
    for mine, theirs in zip(stopped.drivers.contributions, again.drivers.contributions, strict=True):
        np.testing.assert_array_equal(mine.members, theirs.members)
        np.testing.assert_array_equal(mine.shares, theirs.shares)
        assert mine.quantity is theirs.quantity


def test_a_converged_adjustment_has_none(tmp_path: Path) -> None:
    solution = adjust_network(network(pair()), SolverSettings())
    assert solution.converged
    assert "drivers.csv" not in write_results(solution, tmp_path / "result", figures=False)
    assert solution_json(solution)["drivers"] is None
    assert not drivers_section(solution).sentences
    assert len(drivers_table(solution)) == 0
