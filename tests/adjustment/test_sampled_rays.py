"""Rays of sampled trajectories laid out about other lines, in parts: the same numbers as by the whole layout."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import network, pair, with_shift_and_surface

from mgsgraph.adjustment.graph import Layout, lay_out
from mgsgraph.adjustment.graph.bundle import IN_PROCESS, BundleGraph
from mgsgraph.adjustment.graph.sampled_rays import follow
from mgsgraph.adjustment.predicted_lines import NEAR
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.kernel.rows import OUT, partition


@pytest.fixture(scope="module")
def layout() -> Layout:
    """Several pieces of ties, footprints of a profile with a shift, a terrain model; one point without a place."""
    made = lay_out(with_shift_and_surface(network(pair(4200, 60))), SolverSettings())
    kinds = made.rows.kind.copy()
    kinds[7] = OUT
    return replace(made, rows=made.rows._replace(kind=kinds))


def copied(layout: Layout) -> Layout:
    return replace(layout, rows=layout.rows._replace(data=layout.rows.data.copy()))


@settings(max_examples=10, deadline=None)
@given(st.data())
def test_parts_follow_as_the_whole_does(layout: Layout, data: st.DataObject) -> None:
    assert layout.rays.all_sampled
    seed = data.draw(st.integers(0, 2**32 - 1))
    x = np.random.default_rng(seed).normal(size=layout.columns) * layout.scales
    points = BundleGraph(layout).reduction(x).points
    whole = IN_PROCESS.about_lines(layout, x, points, NEAR, False)
    assert np.abs(whole.lines - layout.lines).max() > 1.0
    pieces = len(layout.rows.piece)
    cuts = [0, *sorted(data.draw(st.sets(st.integers(1, pieces - 1)))), pieces]
    found, seen = np.full(layout.lines.size, np.nan), list[np.ndarray]()
    for first, last in pairwise(cuts):
        rays, mine = layout.rays.sampled.of_pieces(first, last)
        rows, model = partition(layout.rows, first, last), layout.model
        at = int(layout.rows.piece[first, 1])
        own = points[at : at + rows.kind.size]
        rows = rows._replace(data=rows.data.copy())
        lines, turns = follow(rows, layout.groups, layout.blocks.target, model, rays, layout.lines[mine], x, own, NEAR)
        assert turns >= 1
        found[mine] = lines
        seen.append(rows.data)
    np.testing.assert_allclose(found, whole.lines, rtol=0.0, atol=2.0 * NEAR)
    again = copied(layout).about(found, x, own=True)  # what is laid out in parts is what the whole lays out there
    np.testing.assert_array_equal(np.concatenate(seen), again.rows.data)


def test_rays_that_are_where_they_belong_stay(layout: Layout) -> None:
    x = np.zeros(layout.columns)
    points = BundleGraph(layout).reduction(x).points
    settled = IN_PROCESS.about_lines(layout, x, points, NEAR, False)
    rays, mine = settled.rays.sampled.of_pieces(0, len(settled.rows.piece))
    before = settled.rows.data.copy()
    lines, turns = follow(
        settled.rows, settled.groups, settled.blocks.target, settled.model, rays, settled.lines[mine], x, points, NEAR
    )
    assert turns == 0
    np.testing.assert_array_equal(lines, settled.lines[mine])
    np.testing.assert_array_equal(settled.rows.data, before)
