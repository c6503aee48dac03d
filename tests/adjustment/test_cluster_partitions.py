"""One adjustment whose points lie with workers: the same answer as one process's, whoever comes and goes meanwhile;
parts of its rows add up to the whole, and a worker that holds one does as it is told.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface
from outside import refuses

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.cluster import connection, partitions
from mgsgraph.adjustment.cluster.connection import Connection, Lost, open_cluster
from mgsgraph.adjustment.cluster.partitions import Answer, Order, Source, carry_out
from mgsgraph.adjustment.cluster.workers import Worker, require_memory
from mgsgraph.adjustment.graph import Layout, lay_out
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.cli import group
from mgsgraph.errors import InputError, SolverError
from mgsgraph.kernel import sweep
from mgsgraph.kernel.rows import partition
from mgsgraph.kernel.sweep import COSTS, DESIGN, GRADIENT, SYSTEM, all_residuals, point_covariances, reduce
from mgsgraph.network import Network

TIES = 2100
"""Two pieces of ties; the laser's is a third."""


@cache
def many() -> Network:
    """Ties on a terrain model, a shifted laser profile; some blunders among the ties."""
    net = with_shift_and_surface(network(pair(TIES, 30)))
    places = net.rays.places.copy()
    places[50:90:5] += 60.0
    return replace(net, rays=replace(net.rays, places=places))


def scale(values: np.ndarray) -> float:
    return float(np.abs(values).max())


# --- one adjustment on two workers

@pytest.fixture(scope="module")
def two() -> Iterator[Connection]:
    pytest.importorskip("distributed", reason="dask.distributed is not installed (the extra `cluster`)")
    with open_cluster("local:2") as opened:
        yield opened


def assert_the_same(one: Solution, other: Solution) -> None:
    """To 1e-9: of the cost, of sigmas, of a metre, of the largest covariance, of a pixel."""
    assert other.converged == one.converged
    assert other.cost_final == pytest.approx(one.cost_final, rel=1e-9)
    assert other.cost_initial == pytest.approx(one.cost_initial, rel=1e-9)
    assert other.fit.squares == pytest.approx(one.fit.squares, rel=1e-9)
    assert other.fit.observations == one.fit.observations
    for j, (first, second) in enumerate(zip(one.coefficients, other.coefficients, strict=True)):
        sigmas = np.sqrt(np.diagonal(one.image_covariance(j))).reshape(first.shape)
        assert np.all(np.abs(first - second) <= 1e-9 * sigmas)
        np.testing.assert_allclose(
            other.image_covariance(j), one.image_covariance(j), rtol=1e-7, atol=1e-9 * scale(one.image_covariance(j))
        )
    np.testing.assert_allclose(other.shifts, one.shifts, atol=1e-9)
    np.testing.assert_array_equal(other.determined, one.determined)
    np.testing.assert_array_equal(other.rays_used, one.rays_used)
    np.testing.assert_allclose(other.places, one.places, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(other.places_before, one.places_before, rtol=0.0, atol=1e-6)
    largest = np.nanmax(np.abs(one.covariances))
    np.testing.assert_allclose(other.covariances, one.covariances, rtol=0.0, atol=1e-9 * largest)
    np.testing.assert_allclose(other.residuals, one.residuals, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(other.residuals_before, one.residuals_before, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(other.range_residuals, one.range_residuals, rtol=0.0, atol=1e-6)
    if one.sigmas_without_laser is not None:
        np.testing.assert_allclose(other.sigmas_without_laser, one.sigmas_without_laser, rtol=1e-9)


_sweep_all = sweep.sweep_all


def nobody(*given: Any, **named: Any) -> Any:
    """Nothing is solved here, and no residual made; the rows of the few that may be blunders are looked up here."""
    if given[5] != DESIGN:
        raise AssertionError("a sweep in this process")
    return _sweep_all(*given, **named)


# above two seconds: two processes load the kernel
@pytest.mark.parametrize(
    "how", [{}, {"reject": 4.0}, {"loss": "huber"}], ids=["terrain", "blunder passes", "robust"]
)
def test_the_same_answer(two: Connection, how: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    alone = adjust_network(many(), SolverSettings(**how))
    monkeypatch.setattr(sweep, "sweep_all", nobody)
    spread = adjust_network(many(), SolverSettings(**how), cluster=two)
    assert_the_same(alone, spread)
    assert (spread.minima is None) == (alone.minima is None)
    if how.get("reject"):
        assert not np.all(spread.rays_used)
        assert "passes" in spread.message


def test_points_are_let_go_at_the_end(two: Connection) -> None:
    def kept() -> int:
        from mgsgraph.adjustment.cluster import partitions

        return len(partitions._held)

    adjust_network(network(pair()), SolverSettings(), cluster=two)
    assert set(two.client.run(kept).values()) == {0}


# --- workers that come and go, without dask


class _Village:
    """A cluster in this process: workers are memories that can be wiped out."""

    where = "--cluster village"

    def __init__(self, count: int, fate: Callable[[int], list[str]] = lambda _: [], limit: int = 0) -> None:
        self.memories: dict[str, dict[str, Any]] = {f"w{k}": {} for k in range(count)}
        self.orders: list[Order] = []
        self._fate, self._limit, self._sweeps = fate, limit, 0

    @property
    def workers(self) -> tuple[Worker, ...]:
        return tuple(Worker(address, "here", 1, 1, self._limit) for address in self.memories)

    def require_memory(self, needed: float, what: str, remedy: str) -> None:
        require_memory(self.workers, needed, what, self.where, remedy)

    def call_all(self, function: Callable[[Any], None], item: Any) -> None:
        pass

    def at_workers(
        self, function: Callable[[Order], Answer], orders: Mapping[int, tuple[str, Order]]
    ) -> Iterator[tuple[int, Answer | Lost | None]]:
        dying = self._fate(self._sweeps)
        self._sweeps += 1
        for number, (address, order) in orders.items():
            assert address in self.memories
            self.orders.append(order)
            if address in dying:
                yield number, None
                continue
            partitions._held.clear()
            partitions._held.update(self.memories[address])
            yield number, function(order)
            self.memories[address] = dict(partitions._held)


def adjusted(village: _Village, how: SolverSettings) -> Solution:
    return adjust_network(many(), how, cluster=village)  # type: ignore[arg-type]


def test_rows_go_out_once_and_constants_when_they_are_laid_out_anew() -> None:
    village, inside = _Village(2), [0]

    def begin(_: object) -> None:
        inside.append(len(village.orders))

    solution = adjust_network(many(), SolverSettings(reject=4.0), progress=begin, cluster=village)  # type: ignore[arg-type]
    assert solution.history[0].accepted
    sent = Counter(order.token for order in village.orders if order.source is not None)
    assert set(sent.values()) == {1}
    assert len(sent) == 2  # each partition once
    assert {name for order in village.orders for name in order.changes} == {"kind", "weight", "data"}
    for order in village.orders[inside[1] : inside[2]]:  # between two iterations
        assert order.function is sweep.reduce
        assert not order.changes


def test_a_worker_that_goes_ends_the_adjustment() -> None:
    village = _Village(2, lambda sweep: ["w1"] if sweep == 2 else [])
    with pytest.raises(SolverError, match=r"a partition of \d+ points .* was lost with worker w1 .*run this again"):
        adjusted(village, SolverSettings())


def test_a_memory_limit_below_a_partition() -> None:
    message = r"worker w0 .*limit of 0\.40 GB; expected at least 0\.4\d GB for a partition of \d+ points \(0\.00"
    refuses(message, adjusted, _Village(2, limit=int(0.4e9)), SolverSettings())


def test_a_gpu_on_a_cluster_is_refused(
    two: Connection, case_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command line hands the cluster on."""
    monkeypatch.setattr(connection, "open_cluster", lambda *_, **__: nullcontext(two))
    arguments = ["adjust", str(case_file), "--out", str(tmp_path / "o"), "--cluster", "local:2", "--device", "cuda"]
    with pytest.raises(InputError, match=r"^--cluster local:2: solver, device 'cuda'; expected 'cpu' on a cluster"):
        group(arguments, standalone_mode=False)
    assert not (tmp_path / "o").exists()


# --- partitions of the rows


@pytest.fixture(scope="module")
def layout() -> Layout:
    return lay_out(many(), SolverSettings())


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
