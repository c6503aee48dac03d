"""Sweeps: threads share one, and it matters little where its inner solves begin."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import network, pair
from normals import System, of_layout
from odd_networks import NETWORKS, case, made

from mgsgraph.adjustment.graph import lay_out, patterns
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.kernel import sweep
from mgsgraph.kernel.rows import Rows
from mgsgraph.kernel.sweep import COSTS, GRADIENT, SYSTEM

SEEDS = st.integers(0, 2**32 - 1)


def state(system: System, seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(system.columns) * system.sigmas


def all_results(system: System, x: np.ndarray) -> dict[str, np.ndarray]:
    """A reduction's numbers, and covariances."""
    found = system.reduce(x)
    names = ("cost", "piece_cost", "blocks", "gradient", "points", "states")
    covariances = system.covariances(x, np.diag(system.sigmas**2), found.points)
    return {name: np.asarray(getattr(found, name)) for name in names} | {"covariances": covariances}


@pytest.mark.parametrize("name", ["more than a tile", "groups of one point"])
def test_threads_share_the_same_work(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    parts, calls, results = sweep.even_parts, list[int](), list[dict[str, np.ndarray]]()

    def counted(rows: Rows, count: int) -> np.ndarray:
        calls.append(count)
        return parts(rows, count)

    monkeypatch.setattr(sweep, "_WORTHWHILE", 1.0)
    monkeypatch.setattr(sweep, "even_parts", counted)
    monkeypatch.setattr(patterns, "PIECE", 32)
    now = case(NETWORKS[name]())
    system = of_layout(now.layout, now.rows)
    for threads in (1, 2):
        monkeypatch.setattr(sweep, "threads", lambda threads=threads: threads)
        results.append(all_results(system, state(system)))
    assert calls == [2, 2]  # one thread has nothing to divide
    for what, one in results[0].items():
        np.testing.assert_allclose(results[1][what], one, rtol=0.0, atol=1e-12 * np.abs(one).max(), err_msg=what)


@pytest.mark.parametrize("count", [1, 2, 3, 50])
def test_parts_are_all_pieces_once(count: int) -> None:
    rows = made("groups of one point").rows
    edges = sweep.even_parts(rows, count)
    assert edges.size == count + 1
    assert (edges[0], edges[-1]) == (0, rows.piece.shape[0])
    assert np.all(np.diff(edges) >= 0)


@settings(max_examples=8)
@given(seed=SEEDS)
def test_a_warm_start_saves_steps_and_changes_nothing(seed: int) -> None:
    """Begun where a neighbouring orientation's points are. The gradient is of the place before the last step, which may
    be 1e-3 sigma long: with rows that bend by 1e-4 over a sigma (more on rough terrain) its share is 1e-7.
    """
    now = made("shifts and terrain")
    system = of_layout(now.layout)
    x = state(system, seed)
    near = system.reduce(x + 0.1 * state(system, seed + 1)).points
    cold, warm = system.reduce(x), system.reduce(x, near)
    assert warm.cost == pytest.approx(cold.cost, rel=1e-11)
    np.testing.assert_allclose(warm.points, cold.points, rtol=0.0, atol=1e-5)
    scaled = cold.gradient * system.sigmas
    np.testing.assert_allclose(warm.gradient * system.sigmas, scaled, rtol=0.0, atol=1e-6 * np.abs(scaled).max())
    assert system.reduce(x, near, COSTS).cost == warm.cost


@pytest.mark.parametrize("name", NETWORKS)
def test_the_gradient_alone_is_that_of_the_system(name: str) -> None:
    system = of_layout(made(name).layout)
    x = state(system)
    whole, alone = system.reduce(x), system.reduce(x, task=GRADIENT)
    assert alone.blocks is None
    assert alone.serves(x, COSTS)
    assert not alone.serves(x, SYSTEM)
    assert alone.cost == whole.cost
    for part in ("gradient", "points", "states"):
        np.testing.assert_array_equal(getattr(alone, part), getattr(whole, part))


@pytest.mark.parametrize("loss", ["huber", "cauchy", "tukey"])
def test_a_robust_loss_has_one_answer(loss: str) -> None:
    """It may have several minima: from `rows.start` on, always the same one is found, wherever the caller begins."""
    system = of_layout(lay_out(network(pair()), SolverSettings(loss=loss)))
    x = state(system)
    cold = system.reduce(x)
    warm = system.reduce(x, cold.points + np.random.default_rng(4).normal(0.0, 3000.0, cold.points.shape))
    assert warm.cost == cold.cost
    np.testing.assert_array_equal(warm.points, cold.points)
    np.testing.assert_array_equal(warm.gradient, cold.gradient)
