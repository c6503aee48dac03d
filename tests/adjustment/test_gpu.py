"""Who goes over the points, and how a GPU's memory and its reduced equations are dealt with; none is needed here."""

import math
from itertools import pairwise
from types import ModuleType
from typing import cast

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st
from networks import network, pair, with_shift_and_surface
from sharing import with_all_kinds

from mgsgraph.adjustment import gpu
from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.gpu import Gpu, sweeper_of
from mgsgraph.adjustment.gpu.sweeper import DenseCholesky
from mgsgraph.adjustment.graph import BundleGraph, lay_out
from mgsgraph.adjustment.graph.forms import IN_PROCESS, sparse_factor
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.sparse_cholesky import NotDefinite
from mgsgraph.errors import InputError

pytest.importorskip("numba_cuda", reason="numba-cuda is not installed (the extra `cuda`)")
LAYOUT = lay_out(with_shift_and_surface(network(pair())), SolverSettings())
SMALL = Gpu("a picture card", 4e9, 32)
NUMPY = np, scipy.linalg


def test_auto_wants_enough_to_do_and_a_rate_worth_using(monkeypatch: pytest.MonkeyPatch) -> None:
    auto, found = SolverSettings(device="auto"), Gpu("a device", math.inf, 2)
    monkeypatch.setattr(gpu, "find_gpu", lambda: found)
    assert sweeper_of(auto, LAYOUT) is IN_PROCESS
    monkeypatch.setattr(gpu, "_WORTHWHILE", 10)
    monkeypatch.setattr(gpu, "find_gpu", lambda: SMALL)
    assert sweeper_of(auto, LAYOUT) is IN_PROCESS
    assert SMALL.remark
    assert not found.remark


def test_auto_goes_without_a_gpu_of_too_little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu, "_WORTHWHILE", 10)
    monkeypatch.setattr(gpu, "find_gpu", lambda: Gpu("a device", 1e3, 2))
    assert sweeper_of(SolverSettings(device="auto"), LAYOUT) is IN_PROCESS
    with pytest.raises(InputError, match="GB to use"):
        sweeper_of(SolverSettings(device="cuda"), LAYOUT)


def test_what_is_missing_is_said_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    from mgsgraph.kernel.cuda import device

    net, cuda = LAYOUT.network, SolverSettings(device="cuda")
    monkeypatch.setattr(device, "why_not", lambda: "there is no GPU (its driver is not there)")
    with pytest.raises(InputError, match="no GPU") as error:
        adjust_network(net, cuda)
    assert len(str(error.value).splitlines()) == 1
    monkeypatch.setattr("mgsgraph.adjustment.gpu.found.find_spec", lambda name: None)
    with pytest.raises(InputError, match="numba-cuda"):
        adjust_network(net, cuda)
    with pytest.raises(InputError, match="device"):
        SolverSettings(device="gpu")  # type: ignore[arg-type]


@given(memory=st.floats(2e4, 1e6))
def test_points_are_divided_so_that_memory_holds_each_part(memory: float) -> None:
    from mgsgraph.adjustment.gpu.sweeper import divided
    from mgsgraph.kernel.cuda.partition import bytes_of_pieces

    held, work = bytes_of_pieces(LAYOUT.rows)
    try:
        edges, together = divided(LAYOUT.rows, memory)
    except InputError:
        assert (held + work).max() > memory - 100 * LAYOUT.rows.kind.size
        return
    assert edges[0] == 0
    assert edges[-1] == held.size
    needed = held.sum() if together else 0
    for first, last in pairwise(edges):
        assert last > first
        own = 0 if together else held[first:last].sum()
        assert needed + own + work[first:last].sum() <= memory


@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_the_dense_factor_solves_the_sparse_ones_equations(damping: float) -> None:
    layout = lay_out(with_all_kinds(with_shift_and_surface(network(pair()))), SolverSettings())
    reduction = BundleGraph(layout).reduction(np.zeros(layout.columns))
    dense = DenseCholesky(layout, *NUMPY).factor(reduction.blocks, damping)
    right = np.random.default_rng(1).standard_normal(layout.columns) / layout.scales
    expected = sparse_factor(layout, reduction, damping).solve(right)
    np.testing.assert_allclose(dense.solve(right) / layout.scales, expected / layout.scales, rtol=1e-7, atol=1e-10)


def test_a_matrix_that_is_not_definite_has_no_factor() -> None:
    reduction = BundleGraph(LAYOUT).reduction(np.zeros(LAYOUT.columns))
    assert reduction.blocks is not None
    with pytest.raises(NotDefinite):
        DenseCholesky(LAYOUT, *NUMPY).factor(-1e6 * np.abs(reduction.blocks), 0.0)


def test_a_library_that_says_nothing_of_such_a_matrix_is_seen_through() -> None:
    """As cuSOLVER behind CuPy: LAPACK stops at the first minor that is not positive, the rest is left as it was."""

    class Silent:
        """NumPy whose factor is LAPACK's, whatever LAPACK says."""

        class linalg:
            @staticmethod
            def cholesky(matrix: np.ndarray) -> np.ndarray:
                return np.tril(scipy.linalg.lapack.dpotrf(matrix, lower=True)[0])

        def __getattr__(self, name: str) -> object:
            return getattr(np, name)

    reduction = BundleGraph(LAYOUT).reduction(np.zeros(LAYOUT.columns))
    assert reduction.blocks is not None
    silent = cast(ModuleType, Silent()), scipy.linalg
    DenseCholesky(LAYOUT, *silent).factor(reduction.blocks, 0.3)
    with pytest.raises(NotDefinite):
        DenseCholesky(LAYOUT, *silent).factor(-1e6 * np.abs(reduction.blocks), 0.0)


@pytest.mark.parametrize("whole", [False, True])
def test_sums_in_order_are_all_sums(whole: bool) -> None:
    """What is added to the same number is one block's task; each job is somebody's."""
    from mgsgraph.kernel.cuda.tables import NONE, OTHER, make_jobs

    owns = LAYOUT.rows, LAYOUT.groups, LAYOUT.blocks.target
    free, ordered = make_jobs(*owns, whole, False), make_jobs(*owns, whole, True)
    assert sorted(map(tuple, free.table.tolist())) == sorted(map(tuple, ordered.table.tolist()))
    assert np.any(free.table[:, OTHER] != NONE) == whole
    assert ordered.edges.size < free.edges.size
    assert ordered.edges[[0, -1]].tolist() == [0, len(free.table)]
