"""Sheets of passes: one for each, all on one, their images as bars and their nodes as dots."""

import numpy as np
import pytest
from rigs import adjusted_rig
from strip_files import block

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.results.figures.passes import _lanes, drawn_strip, pass_sheets


def test_one_pass_has_one_sheet() -> None:
    (sheet,) = pass_sheets(adjusted_rig())
    assert sheet.name == "passes"
    assert "2 images on one trajectory with 6 orientation images over 7.23 s" in sheet.caption
    texts = [text.get_text().strip() for text in sheet.figure.axes[0].texts]
    assert texts == ["L", "R"]
    assert len(sheet.figure.axes) == 8
    labels = [axes.get_ylabel() for axes in sheet.figure.axes if axes.get_ylabel()]
    assert labels == ["along (m)", "roll (mgon)", "across (m)", "pitch (mgon)", "radial (m)", "yaw (mgon)"]


def test_several_passes_are_on_a_sheet_together_first() -> None:
    solution = adjust_network(block().network, SolverSettings())
    sheets = list(pass_sheets(solution, 1))
    assert [sheet.name for sheet in sheets] == ["passes", "pass"]
    assert "of 2 passes the first 1 are drawn" in sheets[1].caption
    rows = [text.get_text() for text in sheets[0].figure.axes[0].get_yticklabels()]
    assert rows == ["HRSC/00", "HRSC/01"]
    ranges = sheets[0].figure.axes[0].collections[0].get_segments()  # type: ignore[attr-defined]
    for k, segment in enumerate(ranges):
        drawn = drawn_strip(solution, k)
        assert segment[:, 0] == pytest.approx([drawn.at_nodes[0].min(), drawn.at_nodes[0].max()])


def test_bars_of_one_lane_have_no_time_in_common() -> None:
    rng = np.random.default_rng(3)
    starts = rng.uniform(0.0, 100.0, 60)
    images = [(str(k), start, start + length) for k, (start, length) in enumerate(
        zip(starts.tolist(), rng.uniform(0.5, 8.0, 60).tolist(), strict=True))]  # fmt: skip
    lanes = _lanes(images, apart=False)
    assert 1 < max(lanes) < 12
    for lane in set(lanes):
        spans = np.array(sorted(images[k][1:] for k in range(60) if lanes[k] == lane))
        assert np.all(spans[1:, 0] >= spans[:-1, 1])
