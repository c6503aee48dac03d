"""What large blocks are drawn by: aggregates against plain loops, the choice of images, and that sheets stay few."""


import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strip_files import block

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.statistics import medians, solution_connectivity, span
from mgsgraph.network import PointClass
from mgsgraph.results.figures.connectivity import adjacency, links_sheet
from mgsgraph.results.figures.map import LEAST, cell_medians, frame
from mgsgraph.results.figures.residuals import residual_matrix
from mgsgraph.results.figures.sheet import encoded, image_rows, limit, means

FLOATS = st.one_of(st.floats(-1e6, 1e6, width=32), st.just(float("nan")))


@given(st.lists(st.tuples(FLOATS, st.integers(0, 6)), max_size=60))
def test_means_and_medians_are_those_of_a_loop(pairs: list[tuple[float, int]]) -> None:
    values = np.array([value for value, _ in pairs])
    groups = np.array([group for _, group in pairs], dtype=np.int64)
    for found, of in ((means(values, groups, 7), np.mean), (medians(values, groups, 7), np.median)):
        for k in range(7):
            mine = values[(groups == k) & np.isfinite(values)]
            assert found[k] == pytest.approx(of(mine) if mine.size else np.nan, rel=1e-6, abs=1e-6, nan_ok=True)


def test_colour_scales_are_robust() -> None:
    values = np.append(np.linspace(-1.0, 1.0, 2000), [1e9, -1e9, np.nan])
    assert limit(values) == pytest.approx(0.98, abs=0.01)
    assert span(values) == pytest.approx((-0.96, 0.96), abs=0.01)
    assert limit(np.zeros(3)) == limit(np.full(2, np.nan)) == 1.0
    low, high = span(np.full(4, 5.0))
    assert low == 5.0 < high


def test_the_residual_matrix_has_the_medians_of_images_and_lines() -> None:
    solution = adjust_network(block().network, SolverSettings())
    rays, network = solution.network.rays, solution.network
    found = residual_matrix(solution, PointClass.TIE)
    assert found is not None
    bins = found.shape[2]
    compared = 0
    for j, image in enumerate(network.images):
        for b in range(bins):
            part = np.minimum(rays.places[:, 0] / image.lines * bins, bins - 1).astype(int)
            mine = (rays.image == j) & (part == b) & solution.rays_used & (network.points.classes[rays.point] == 0)
            if np.any(mine):
                assert found[:, j, b] == pytest.approx(np.median(solution.residuals[mine], axis=0), rel=1e-5)
                compared += 1
            else:
                assert np.all(np.isnan(found[:, j, b]))
    assert compared > 5


def test_cells_of_the_map_are_those_of_a_loop() -> None:
    rng = np.random.default_rng(11)
    box = np.array([-2e3, 1e3, 6e3, 3e3])
    places, values = rng.uniform(box[:2], box[2:], (3000, 2)), rng.normal(size=3000)
    middles, (found,) = cell_medians(box, places, values)
    rows, columns = found.shape
    assert (rows, columns) == (25, 100)
    size = (box[2:] - box[:2]) / [columns, rows]
    at = np.floor((places - box[:2]) / size).astype(int)
    for row in range(rows):
        for column in range(columns):
            mine = values[(at[:, 0] == column) & (at[:, 1] == row)]
            want = np.median(mine) if mine.size else np.nan
            assert found[row, column] == pytest.approx(want, rel=1e-5, nan_ok=True)
    assert middles[columns + 3] == pytest.approx(box[:2] + size * [3.5, 1.5])


def test_a_long_block_has_two_scales() -> None:
    low, high, (width, height) = frame(np.array([[0.0, 0.0], [1200.0, 4.0]]))
    assert width > 7.0
    assert height == LEAST
    assert high[1] - low[1] == pytest.approx(4.0, rel=0.1)
    low, high, (width, height) = frame(np.array([[0.0, 0.0], [30.0, 6.0]]))
    assert (high[0] - low[0]) / width == pytest.approx((high[1] - low[1]) / height)


@given(st.integers(1, 300), st.integers(1, 40))
def test_rows_are_all_used_and_in_order(images: int, most: int) -> None:
    row = image_rows(images, most)
    assert row.size == images
    assert np.array_equal(np.unique(row), np.arange(min(images, most)))
    assert np.all(np.diff(row) >= 0)
    assert np.ptp(np.bincount(row)) <= 1


def test_cells_of_links_have_the_most_points_of_their_pairs() -> None:
    connected = solution_connectivity(adjust_network(block().network, SolverSettings()))
    count, most = len(connected.names), 3
    found, row = adjacency(connected, most), image_rows(count, most)
    want = np.full((most, most), np.nan)
    for (i, j), points in zip(connected.pairs.tolist(), connected.points.tolist(), strict=True):
        if points:
            for a, b in ((row[i], row[j]), (row[j], row[i])):
                want[a, b] = np.fmax(want[a, b], points)
    assert np.array_equal(found, want, equal_nan=True)


def test_many_images_share_the_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    solution = adjust_network(block().network, SolverSettings())
    monkeypatch.setattr("mgsgraph.results.figures.connectivity._NAMED", 2)
    monkeypatch.setattr("mgsgraph.results.figures.connectivity._NUMBERED", 2)
    sheet = links_sheet(solution)
    assert len(encoded(sheet, "png")) > 10_000
