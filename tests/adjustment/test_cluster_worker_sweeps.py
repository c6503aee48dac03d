"""Partitions of an adjustment's rows: they add up to the whole, and a worker that holds one does as it is told."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from networks import network, pair, with_shift_and_surface

from mgsgraph.adjustment.cluster import partitions
from mgsgraph.adjustment.cluster.partitions import Order, Source, blocks_of_partition, carry_out
from mgsgraph.adjustment.graph import Layout, lay_out
from mgsgraph.adjustment.graph.patterns import Variables, make_groups, pair_blocks
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.kernel import sweep
from mgsgraph.kernel.rows import partition
from mgsgraph.kernel.sweep import COSTS, GRADIENT, SYSTEM, all_residuals, point_covariances, reduce

TIES = 2100
"""Two pieces of ties; the laser's is a third."""


# --- partitions of the rows


@pytest.fixture(scope="module")
def layout() -> Layout:
    return lay_out(with_shift_and_surface(network(pair(TIES, 30))), SolverSettings())


def test_partitions_add_up_to_the_whole(layout: Layout) -> None:
    rows, constants = layout.rows, (layout.groups, layout.blocks.target, layout.model)
    x = np.zeros(layout.columns)
    whole = reduce(rows, *constants, x)
    found = all_residuals(rows, *constants, x, whole.points)
    joint = np.random.default_rng(0).normal(size=layout.blocks.target.size)
    spread = point_covariances(rows, *constants, x, joint, whole.points)
    pieces = rows.piece.shape[0]
    assert pieces >= 3
    for cuts in [range(pieces + 1), *([0, k, pieces] for k in range(1, pieces))]:
        mine = [partition(rows, first, last) for first, last in pairwise(cuts)]
        parts = [reduce(part, *constants, x) for part in mine]
        slopes = sum(reduce(part, *constants, x, GRADIENT).gradient for part in mine)
        np.testing.assert_allclose(slopes, whole.gradient, rtol=1e-13, atol=1e-13 * scale(whole.gradient))
        for name in ("blocks", "gradient"):
            total = getattr(whole, name)
            summed = sum(getattr(part, name) for part in parts)
            np.testing.assert_allclose(summed, total, rtol=1e-13, atol=1e-13 * scale(total))
        assert sum(part.cost for part in parts) == pytest.approx(whole.cost, rel=1e-13)
        for name in ("points", "states", "piece_cost"):
            np.testing.assert_array_equal(np.concatenate([getattr(p, name) for p in parts]), getattr(whole, name))
        again = [all_residuals(one, *constants, x, part.points) for one, part in zip(mine, parts, strict=True)]
        np.testing.assert_array_equal(np.concatenate(again), found)
        again = [point_covariances(one, *constants, x, joint, p.points) for one, p in zip(mine, parts, strict=True)]
        np.testing.assert_array_equal(np.concatenate(again), spread)


def scale(values: np.ndarray) -> float:
    return float(np.abs(values).max())


@given(st.data())
def test_blocks_of_some_groups_keep_their_places(data: st.DataObject) -> None:
    widths = np.array(data.draw(st.lists(st.sampled_from([2, 6, 18]), min_size=1, max_size=6)), dtype=np.int64)
    count = widths.size
    member = st.sets(st.integers(0, count - 1), max_size=count).map(lambda one: tuple(sorted(one)))
    sets = tuple(sorted(data.draw(st.sets(member, min_size=1, max_size=8))))
    first, columns = np.cumsum(widths) - widths, int(widths.sum())
    variables = Variables(count, first, widths, np.ones(columns), *np.zeros((2, columns), dtype=bool))
    first_member = np.cumsum([0, *(len(mine) for mine in sets)])
    groups = make_groups(variables, first_member, np.array([v for mine in sets for v in mine], dtype=np.int64))
    whole = pair_blocks(variables, groups).target
    used = np.array(sorted(data.draw(st.sets(st.integers(0, len(sets) - 1), min_size=1))))
    place, mine = blocks_of_partition(groups, whole, used)
    assert np.unique(place).size == place.size == mine.size <= whole.size
    for one in used:
        width = groups.member_width[groups.member_first[one] : groups.member_first[one + 1]]
        table = slice(groups.pair_first[one], groups.pair_first[one + 1])
        for here, there, size in zip(mine.pair[table], whole.pair[table], np.outer(width, width).ravel(), strict=True):
            np.testing.assert_array_equal(place[here : here + size], np.arange(there, there + size))


# --- a worker by itself


@pytest.fixture
def source(layout: Layout, monkeypatch: pytest.MonkeyPatch) -> Source:
    monkeypatch.setattr(partitions, "_held", {})
    return Source(layout.rows, layout.groups, layout.blocks.target)


def order(layout: Layout, token: str, task: int, source: Source | None = None, **changes: np.ndarray) -> Order:
    return Order(token, reduce, (np.zeros(layout.columns), task), layout.model, source, changes)


def test_what_is_not_held_is_answered_with_nothing(source: Source, layout: Layout) -> None:
    assert carry_out(order(layout, "a", SYSTEM)) == ()
    assert carry_out(order(layout, "a", SYSTEM, source)) != ()
    assert carry_out(order(layout, "a", SYSTEM)) != ()
    partitions.forget(["a"])
    assert carry_out(order(layout, "a", SYSTEM)) == ()


def test_what_an_order_says_is_new_holds_for_those_that_follow(source: Source, layout: Layout) -> None:
    x, weight = np.zeros(layout.columns), 0.5 * source.rows.weight
    carry_out(order(layout, "a", COSTS, source))
    rows = source.rows._replace(weight=weight)
    expected = reduce(rows, *source[1:], layout.model, x, COSTS).cost
    for changes in ({"weight": weight}, {}):
        (found,) = carry_out(order(layout, "a", COSTS, **changes))
        assert found.cost == pytest.approx(expected, rel=1e-9)


def test_what_comes_over_the_wire_is_what_the_kernel_was_compiled_for(source: Source, layout: Layout) -> None:
    """A read-only array would be another type to numba: a minute of compiling on every worker."""
    given = order(layout, "a", SYSTEM, source)
    for values in (given.arguments[0], *(one for one in source.rows if isinstance(one, np.ndarray))):
        values.flags.writeable = False
    try:
        assert carry_out(given) != ()
        assert len(sweep.sweep.signatures) == 1
        assert all(one.flags.writeable for one in partitions._held["a"][1].rows)
    finally:
        for values in source.rows:
            values.flags.writeable = values.base is None
