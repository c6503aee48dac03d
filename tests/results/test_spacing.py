"""A study of orientation images as words, files and figures."""

import csv
import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.spacing.study import NodeStudy, study_nodes
from mgsgraph.results.figures.spacing import corrections_sheet, spacing_sheet, spectrum_sheet
from mgsgraph.results.spacing import node_statements, nodes_json, nodes_section, write_nodes
from mgsgraph.simulation.hrsc_block import BlockSettings, simulate_hrsc_block
from mgsgraph.simulation.hrsc_flight import PointMatching
from mgsgraph.simulation.strip_truth import Jitter
from mgsgraph.units import MGON


@cache
def study() -> NodeStudy:
    """One strip of 80 s with 3 mgon of jitter in pitch at 0.06 Hz."""
    settings = BlockSettings(
        strips=1, length=150e3, points=700, terrain=None, spacing=20.0, jitter=Jitter(3.0 * MGON, 0.06, "pitch")
    )
    steps = list[tuple[int, int]]()
    found = study_nodes(
        simulate_hrsc_block(settings, 1).network, SolverSettings(), "block", [3.0, 12.0, 24.0], closer=True,
        progress=lambda done, most: steps.append((done, most)),
    )  # fmt: skip
    assert steps[-1] == (6, 6)
    assert [done for done, _ in steps] == sorted(done for done, _ in steps)
    return found


def test_words() -> None:
    table, said = nodes_section(study()).text(), " ".join(node_statements(study()))
    assert table.count("\n") == len(node_statements(study())) + 11
    assert " chosen" in table
    assert re.search(r"^  HRSC/00 +pitch +0\.0[56]\d* ", table, re.MULTILINE)
    assert "Chosen: 3 s" in said
    assert "closest candidate" in said
    assert "Where residuals asked for closer nodes: " in said


def test_rays_put_aside_and_sigmas_that_are_wrong_are_named() -> None:
    settings = BlockSettings(
        strips=1, length=150e3, points=500, terrain=None, spacing=20.0, matches=PointMatching(blunders=0.01),
        jitter=Jitter(4.0 * MGON, 0.06, "pitch"),
    )  # fmt: skip
    made = simulate_hrsc_block(settings, 1)
    net = replace(made.network, rays=replace(made.network.rays, sigmas=0.5 * made.network.rays.sigmas))
    found = study_nodes(net, SolverSettings(reject=4.0), "block", [4.0, 20.0], closer=True)
    said = " ".join(node_statements(found))
    assert re.search(r"Not counted: \d+ rays rejected as blunders with nodes every 4 s", said)
    factor = re.search(r"scatter (\S+) \+- (\S+) times their stated sigmas, WHICH ARE WRONG", said)
    assert factor is not None
    assert float(factor[1]) == pytest.approx(2.0, abs=4.0 * float(factor[2]))
    record = nodes_json(found)
    assert record["ray_scatter"]["factor"] == pytest.approx(float(factor[1]), abs=1e-3)
    assert record["rays_rejected"] == found.choice.rejected > 0.8 * made.blunders.sum()
    # jitter that wide nodes can't follow is no blunder: the same rays throughout
    assert found.densified is not None
    np.testing.assert_array_equal(
        found.densified.solution.rays_rejected, found.choice.closest_solution.rays_rejected
    )
    assert "WRONG" not in " ".join(node_statements(study()))
    assert "blunders" not in " ".join(node_statements(study()))


@pytest.mark.usefixtures("light_figures")
def test_files(tmp_path: Path) -> None:
    names = write_nodes(study(), tmp_path / "out")
    assert sorted(names) == sorted(path.name for path in (tmp_path / "out").iterdir())
    record = json.loads((tmp_path / "out" / "nodes.json").read_text(encoding="utf-8"))
    assert record["chosen_s"] == 3.0
    mine = [one for one in record["peaks"] if one["beyond_prior"] and not one["echo_of"]]
    assert [one["axis"] for one in mine] == ["pitch"]
    assert mine[0]["frequency_hz"] == pytest.approx(0.06, abs=0.005)
    with (tmp_path / "out" / "spectra.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    pitch = [row for row in rows if row["axis"] == "pitch"]
    # the surest, not the largest: near 0.13 Hz lines follow one another and noise alone is large; below, it wanders
    fast = [row for row in pitch if float(row["frequency_hz"]) > 0.04]
    top = max(fast, key=lambda row: float(row["amplitude"]) / float(row["level"]))
    assert float(top["frequency_hz"]) == pytest.approx(0.06, abs=0.005)
    assert float(top["amplitude"]) == pytest.approx(3.0, abs=1.0)
    assert top["above_level"] == "true"
    with (tmp_path / "out" / "course.csv").open(encoding="utf-8") as file:
        nodes = list(csv.DictReader(file))
    assert len(nodes) == study().corrections[0].times.size
    values = np.array([float(row["roll_mgon"]) for row in nodes])
    np.testing.assert_allclose(values * MGON, study().corrections[0].values[:, 3])


def test_figures_show_the_numbers() -> None:
    made = study()
    spacings = spacing_sheet(made.choice, made.name)
    spectrum = spectrum_sheet(made.strips[0], "spectrum")
    over_time = corrections_sheet(made.corrections[0], made.choice.spacing, "course")
    rms = spacings.figure.axes[0].containers[0].lines[0].get_ydata()
    np.testing.assert_allclose(rms, [one.rms for one in made.choice.candidates])
    pitch = spectrum.figure.axes[3]
    assert pitch.get_ylabel() == "pitch (mgon)"
    marked = [line for line in pitch.get_lines() if line.get_marker() == "v"]
    assert len(marked) == 1
    assert marked[0].get_xdata()[0] == pytest.approx(0.06, abs=0.005)
    assert "pitch" in spectrum.caption
    assert "Nyquist" not in over_time.caption
    assert len(over_time.figure.axes) == 12
