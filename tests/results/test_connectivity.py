"""How images are connected, in words, as a table and as a figure: what they say, not what they look like."""

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import solution_connectivity
from mgsgraph.case.reading import Case
from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.geometry.footprint import Footprint
from mgsgraph.network.connectivity import (
    Connectivity,
    connectivity_json,
    connectivity_statements,
)
from mgsgraph.results.figures.connectivity import connectivity_sheet
from mgsgraph.results.figures.sheet import save
from mgsgraph.results.inventory import inventory
from mgsgraph.results.tables import connectivity_table
from mgsgraph.simulation.orbit import MARS
from mgsgraph.units import DEG, KM


@pytest.fixture(scope="module")
def solution(pair_solution: Solution) -> Solution:
    return pair_solution


def box(name: str, west: float) -> Footprint:
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]]) * DEG
    corners[:, 0] += west * DEG
    return Footprint(name, from_planetocentric(np.column_stack([corners, np.full(5, MARS.equatorial)])), MARS)


def block() -> Connectivity:
    """Seven images: 0-1-2 a triangle, 2-3 a bridge, 4-5 an island, 6 alone; 5 and 6 overlap; 0 and 3 lie apart."""
    pairs = np.array([[0, 1], [0, 2], [1, 2], [2, 3], [4, 5], [5, 6]])
    tie = [30, 20, 25, 3, 8, 0]
    return Connectivity(
        footprints=tuple(box(f"I{j}", west) for j, west in enumerate((0.0, 0.1, 0.2, 5.0, 9.0, 9.1, 9.5))),
        seen=np.full(7, 40),
        pairs=pairs,
        common=np.column_stack([tie, [0, 0, 1, 0, 0, 0], np.zeros(6, dtype=int)]),
        areas=np.array([9.0, 8.0, 9.0, 0.0, 9.0, 5.0]) * 1e8,
        shares=np.array([0.9, 0.8, 0.9, 0.0, 0.9, 0.6]),
        gaps=np.array([0.0, 0.0, 0.0, 2.2e5, 0.0, 0.0]),
        islands=((0, 1, 2, 3), (4, 5), (6,)),
        bridges=np.array([False, False, False, True, True, False]),
        spine=np.array([3, 4, 2, 0]),
    )


# --- words


def test_words_of_a_pair(solution: Solution) -> None:
    found = solution_connectivity(solution)
    (said,) = connectivity_statements(found)
    assert said.startswith("SIM/A and SIM/B have 28 points in common and overlap by ")
    assert f"{found.areas[0] / KM**2:.4g} km^2" in said


def test_words_of_a_block() -> None:
    links, islands, untied, apart = connectivity_statements(block())
    assert "7 images are connected by 5 links of 3 to 30 common points (median 20)" in links
    assert "I2 and I3, 3 points, the only link of I3 to the rest" in links
    assert "(I0, I1, I2, I3), (I4, I5), (I6)" in islands
    assert untied.startswith("1 pair of images overlaps without any common point: I5 and I6 by 500 km^2, 60 %")
    assert "I2 and I3 (3 points, 220 km apart)" in apart


def test_slivers_are_not_worth_ties() -> None:
    thin = replace(block(), shares=np.array([0.9, 0.8, 0.9, 0.0, 0.9, 0.01]))
    assert not any("without any common point" in said for said in connectivity_statements(thin))
    assert connectivity_json(thin)["overlaps_without_common_points"] == []


def test_plain_values_of_a_block() -> None:
    record = connectivity_json(block())
    assert record["links"] == 5
    assert [pair["images"] for pair in record["bridges"]] == [["I2", "I3"], ["I4", "I5"]]
    assert record["weakest_joints"][0] == {
        "images": ["I2", "I3"], "common_points": 3, "overlap_km2": 0.0, "overlap_share": 0.0, "gap_km": 220.0,
    }
    assert record["unconnected_images"] == ["I6"]


def test_rejected_points_do_not_hold_the_block(solution: Solution) -> None:
    lost = replace(solution, rays_used=solution.rays_used & (solution.network.rays.image == 0))
    said = " ".join(connectivity_statements(solution_connectivity(lost)))
    assert "split into 2 parts" in said
    assert "SIM/A and SIM/B by " in said


def test_check_tells_of_it(pair_case: Case) -> None:
    text = inventory(pair_case)
    connections = text.split("Connections")[1].split("Weak spots")[0]
    assert "have 28 points in common and overlap by" in connections
    assert re.search(r"SIM/A +SIM/B +28 ", connections)


# --- table


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_table_of_a_block(tmp_path: Path) -> None:
    connectivity_table(block()).write_csv(tmp_path / "c.csv")
    rows = rows_of(tmp_path / "c.csv")
    assert [(row["image_a"], row["image_b"], row["common_points"]) for row in rows[:3]] == [
        ("I0", "I1", "30"), ("I0", "I2", "20"), ("I1", "I2", "26"),
    ]  # fmt: skip
    assert [row["remark"] for row in rows] == [
        "", "", "", "bridge, common points without overlap", "bridge", "overlap without common points",
    ]  # fmt: skip
    assert (rows[2]["tie_points"], rows[2]["laser_points"], rows[2]["control_points"]) == ("25", "1", "0")
    assert (float(rows[0]["overlap_km2"]), float(rows[3]["gap_km"])) == (900.0, 220.0)


def test_table_of_a_solution(solution: Solution, tmp_path: Path) -> None:
    connectivity_table(solution_connectivity(solution)).write_csv(tmp_path / "c.csv")
    (row,) = rows_of(tmp_path / "c.csv")
    assert int(row["common_points"]) == 28
    assert (row["tie_points"], row["laser_points"], row["remark"]) == ("20", "8", "bridge")
    assert 0.5 < float(row["overlap_share"]) <= 1.0


# --- figure


@pytest.mark.parametrize("what", ["pair", "block"])
def test_sheets(solution: Solution, what: str, tmp_path: Path) -> None:
    connected = solution_connectivity(solution) if what == "pair" else block()
    sheet = connectivity_sheet(connected)
    assert save([sheet], tmp_path) == ["connectivity.png"]
    matrix = sheet.figure.axes[0]
    assert [text.get_text() for text in matrix.get_yticklabels()] == list(connected.names)
    assert {str(n) for n in connected.points[connected.links]} <= {text.get_text() for text in matrix.texts}
    labels = {text.get_text() for one in sheet.figure.legends for text in one.get_texts()}
    disagree = {"overlap without common points", "common points without overlap", "image without links"}
    assert labels >= (set() if what == "pair" else disagree | {"weakest links"})
    assert not (labels & disagree if what == "pair" else set())
    assert sheet.caption.startswith(connectivity_statements(connected)[0])
