"""What large blocks are drawn by: aggregates against plain loops, the choice of images, and that sheets stay few."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strip_files import block

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.statistics import medians, solution_connectivity, span
from mgsgraph.network import PointClass
from mgsgraph.results.figures.aggregate import Rows, cell_means, image_rows, limit, means
from mgsgraph.results.figures.connectivity import adjacency, joints, links_sheet
from mgsgraph.results.figures.overview import MiddleCorrections, residual_matrix, strangeness
from mgsgraph.results.figures.overview_map import ground_cells, ground_frame, weak_points
from mgsgraph.results.figures.sheet import encoded

FLOATS = st.one_of(st.floats(-1e6, 1e6, width=32), st.just(float("nan")))


@given(st.lists(st.tuples(FLOATS, st.integers(0, 6)), max_size=60))
def test_means_and_medians_are_those_of_a_loop(pairs: list[tuple[float, int]]) -> None:
    values = np.array([value for value, _ in pairs])
    groups = np.array([group for _, group in pairs], dtype=np.int64)
    for found, of in ((means(values, groups, 7), np.mean), (medians(values, groups, 7), np.median)):
        for k in range(7):
            mine = values[(groups == k) & np.isfinite(values)]
            assert found[k] == pytest.approx(of(mine) if mine.size else np.nan, rel=1e-6, abs=1e-6, nan_ok=True)


def test_cell_means_are_those_of_a_loop() -> None:
    rng = np.random.default_rng(5)
    places, values = rng.uniform(0.0, 1.0, (900, 2)) * (400.0, 90.0), rng.normal(size=(900, 2))
    middles, found = cell_means(places, values, (400.0, 90.0), (8, 6), 17)
    want = {}
    for a in range(8):
        for b in range(6):
            low, size = np.array([50.0 * a, 15.0 * b]), np.array([50.0, 15.0])
            mine = values[np.all((places >= low) & (places < low + size), axis=1)]
            if len(mine) >= 17:
                want[tuple((low + 0.5 * size).tolist())] = mine.mean(axis=0)
    assert 5 < len(want) < 48
    assert [tuple(middle) for middle in middles.tolist()] == list(want)
    assert found == pytest.approx(np.array(list(want.values())))


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
    found = residual_matrix(solution, Rows.of(solution), PointClass.TIE)
    assert found is not None
    bins = found.medians.shape[2]
    compared = 0
    for j, image in enumerate(network.images):
        for b in range(bins):
            part = np.minimum(rays.places[:, 0] / image.lines * bins, bins - 1).astype(int)
            mine = (rays.image == j) & (part == b) & solution.rays_used & (network.points.classes[rays.point] == 0)
            if np.any(mine):
                assert found.medians[:, j, b] == pytest.approx(np.median(solution.residuals[mine], axis=0), rel=1e-5)
                compared += 1
            else:
                assert np.all(np.isnan(found.medians[:, j, b]))
    assert compared > 5


def test_the_image_unlike_the_others_is_found() -> None:
    values = np.random.default_rng(2).normal(size=(50, 6))
    values[31, 4] = 30.0
    assert int(np.argmax(strangeness(MiddleCorrections(np.arange(50), values, np.ones_like(values))))) == 31


def strip_of_places(count: int) -> np.ndarray:
    """Places (n, 3) m on Mars, 1,200 km along a curve and 4 km across it."""
    rng = np.random.default_rng(11)
    along, across = rng.uniform(-0.18, 0.18, count), rng.uniform(-6e-4, 6e-4, count)
    latitude, longitude = along, 1.0 + across + 0.3 * along**2
    return 3.39e6 * np.stack([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude),
                              np.sin(latitude)], axis=1)  # fmt: skip


def test_a_bent_strip_fills_its_frame() -> None:
    """Its middle line goes 33 km aside, eight times its width."""
    places = strip_of_places(20_000)
    sound = np.ones(20_000, dtype=bool)
    sound[::7] = False
    frame = ground_frame(places, sound)
    assert frame.long
    length, width = frame.high - frame.low
    assert length == pytest.approx(0.36 * 3390.0, rel=0.01)
    assert width == pytest.approx(0.0012 * 3390.0, rel=0.05)


def test_cells_of_the_ground_are_those_of_a_loop() -> None:
    solution = adjust_network(block().network, SolverSettings())
    frame = replace(ground_frame(solution.places, solution.determined & ~weak_points(solution)), cells=(7, 3))
    found = ground_cells(solution, frame)
    size = (frame.high - frame.low) / frame.cells
    at = np.clip(np.floor((frame.places - frame.low) / size), 0, [6, 2])
    sigmas = np.linalg.norm(solution.sigmas, axis=1)
    for a in range(7):
        for b in range(3):
            mine = frame.sound & (at[:, 0] == a) & (at[:, 1] == b)
            if np.any(mine):
                assert found.density[a, b] * size[0] * size[1] == pytest.approx(np.count_nonzero(mine))
                assert found.sigma[a, b] == pytest.approx(np.median(sigmas[mine]), rel=1e-5)
            else:
                assert np.isnan(found.density[a, b])
    assert np.nansum(found.density) * size[0] * size[1] == pytest.approx(np.count_nonzero(frame.sound))


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
    linked = [set[int]() for _ in range(count)]
    for (i, j), points in zip(connected.pairs.tolist(), connected.points.tolist(), strict=True):
        if points:
            linked[i].add(j)
            linked[j].add(i)
            for a, b in ((row[i], row[j]), (row[j], row[i])):
                want[a, b] = np.fmax(want[a, b], points)
    assert np.array_equal(found, want, equal_nan=True)
    number, strongest = joints(connected)
    assert number.tolist() == [len(others) for others in linked]
    assert strongest.max() == connected.points.max()


def test_few_images_are_named_and_many_share_the_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    solution = adjust_network(block().network, SolverSettings())
    assert links_sheet(solution).vector
    monkeypatch.setattr("mgsgraph.results.figures.connectivity._NAMED", 2)
    monkeypatch.setattr("mgsgraph.results.figures.connectivity._NUMBERED", 2)
    sheet = links_sheet(solution)
    assert not sheet.vector
    assert len(encoded(sheet, "png")) > 10_000
