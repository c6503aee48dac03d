"""The GPU: who goes over the points, its memory and its reduced equations, for which none is needed; and its kernels,
run by numba's CUDA simulator in a process of their own, and compiled.

`python test_cuda.py NAME...` is that process: it writes one line of JSON, of each case the largest difference of each
result, as a share of the CPU's largest number. NUMBA_ENABLE_CUDASIM has to be set before numba is imported.
"""

import json
import math
import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import numpy as np
import pytest
import scipy.linalg
from explicit_form import of_layout
from hypothesis import given
from hypothesis import strategies as st
from networks import network, on_passes, pair, with_echoes, with_shift_and_surface
from odd_networks import case, made, one_seen_twice_by_one_image, with_fixed
from once import once
from outside import refuses
from sharing import shared, with_all_kinds
from stereo_pair import stereo_network

import mgsgraph
from mgsgraph.adjustment import gpu
from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.gpu import Gpu, sweeper_of
from mgsgraph.adjustment.gpu.sweeper import DenseCholesky, dense_bytes
from mgsgraph.adjustment.graph import BundleGraph, Layout, lay_out
from mgsgraph.adjustment.graph.forms import IN_PROCESS, sparse_factor
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.sparse_cholesky import NotDefinite
from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.kernel.rows import FREE, of_points
from mgsgraph.kernel.sweep import (
    COSTS,
    GRADIENT,
    SYSTEM,
    Reduction,
    all_residuals,
    point_covariances,
    reduce,
    reliability,
)
from mgsgraph.network import SharedKind

pytest.importorskip("numba_cuda", reason="numba-cuda is not installed (the extra `cuda`)")

SMALL = Gpu("a picture card", 4e9, 32)
NUMPY = np, scipy.linalg


@cache
def layout() -> Layout:
    return lay_out(with_shift_and_surface(network(pair())), SolverSettings())


def test_auto_wants_enough_to_do_and_a_rate_worth_using(monkeypatch: pytest.MonkeyPatch) -> None:
    auto, found = SolverSettings(device="auto"), Gpu("a device", math.inf, 2)
    monkeypatch.setattr(gpu, "find_gpu", lambda: found)
    assert sweeper_of(auto, layout()) is IN_PROCESS
    monkeypatch.setattr(gpu, "_WORTHWHILE", 10)
    monkeypatch.setattr(gpu, "find_gpu", lambda: SMALL)
    assert sweeper_of(auto, layout()) is IN_PROCESS
    assert SMALL.remark
    assert not found.remark


def test_auto_goes_without_a_gpu_of_too_little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu, "_WORTHWHILE", 10)
    monkeypatch.setattr(gpu, "find_gpu", lambda: Gpu("a device", 1e3, 2))
    assert sweeper_of(SolverSettings(device="auto"), layout()) is IN_PROCESS
    refuses("GB to use", sweeper_of, SolverSettings(device="cuda"), layout())


def test_what_is_missing_is_said_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    from mgsgraph.kernel.cuda import device

    net, cuda = layout().network, SolverSettings(device="cuda")
    monkeypatch.setattr(device, "why_not", lambda: "there is no GPU (its driver is not there)")
    with pytest.raises(InputError, match="no GPU") as error:
        adjust_network(net, cuda)
    assert len(str(error.value).splitlines()) == 1
    monkeypatch.setattr("mgsgraph.adjustment.gpu.find.find_spec", lambda name: None)
    refuses("numba-cuda", adjust_network, net, cuda)
    with pytest.raises(InputError, match="device"):
        SolverSettings(device="gpu")  # type: ignore[arg-type]


@given(memory=st.floats(2e4, 1e6))
def test_points_are_divided_so_that_memory_holds_each_part(memory: float) -> None:
    from mgsgraph.adjustment.gpu.sweeper import divided
    from mgsgraph.kernel.cuda.partition import bytes_of_pieces

    held, work = bytes_of_pieces(layout().rows)
    try:
        edges, together = divided(layout().rows, memory)
    except InputError:
        assert (held + work).max() > memory - 100 * layout().rows.kind.size
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
    made = lay_out(with_all_kinds(with_shift_and_surface(network(pair()))), SolverSettings())
    reduction = BundleGraph(made).reduction(np.zeros(made.columns))
    dense = DenseCholesky(made, *NUMPY).factor(reduction.blocks, damping)
    right = np.random.default_rng(1).standard_normal(made.columns) / made.scales
    expected = sparse_factor(made, reduction, damping).solve(right)
    np.testing.assert_allclose(dense.solve(right) / made.scales, expected / made.scales, rtol=1e-7, atol=1e-10)


def test_a_matrix_that_is_not_definite_has_no_factor() -> None:
    reduction = BundleGraph(layout()).reduction(np.zeros(layout().columns))
    assert reduction.blocks is not None
    with pytest.raises(NotDefinite):
        DenseCholesky(layout(), *NUMPY).factor(-1e6 * np.abs(reduction.blocks), 0.0)


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

    reduction = BundleGraph(layout()).reduction(np.zeros(layout().columns))
    assert reduction.blocks is not None
    silent = cast(ModuleType, Silent()), scipy.linalg
    DenseCholesky(layout(), *silent).factor(reduction.blocks, 0.3)
    with pytest.raises(NotDefinite):
        DenseCholesky(layout(), *silent).factor(-1e6 * np.abs(reduction.blocks), 0.0)


@pytest.mark.parametrize("whole", [False, True])
def test_sums_in_order_are_all_sums(whole: bool) -> None:
    """What is added to the same number is one block's task; each job is somebody's."""
    from mgsgraph.kernel.cuda.tables import NONE, OTHER, make_jobs

    owns = layout().rows, layout().groups, layout().blocks.target
    free, ordered = make_jobs(*owns, whole, False), make_jobs(*owns, whole, True)
    assert sorted(map(tuple, free.table.tolist())) == sorted(map(tuple, ordered.table.tolist()))
    assert np.any(free.table[:, OTHER] != NONE) == whole
    assert ordered.edges.size < free.edges.size
    assert ordered.edges[[0, -1]].tolist() == [0, len(free.table)]


# --- the kernels, simulated

Differences = dict[str, dict[str, float]]


@once
def differences(*names: str) -> Differences:
    """Of cases by name, from a process in which the simulator stands in for a device."""
    paths = Path(__file__).parents[1], Path(mgsgraph.__file__).parents[1]  # the package that is tested here
    environment = os.environ | {"NUMBA_ENABLE_CUDASIM": "1", "PYTHONPATH": os.pathsep.join(map(str, paths))}
    command = [sys.executable, "-W", "error", __file__, *names]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    found: Differences = json.loads(done.stdout.splitlines()[-1])
    return found


def _share(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference as a share of the largest number expected; infinite where they aren't finite alike."""
    there = np.isfinite(expected)
    if not np.array_equal(np.isfinite(found), there):
        return float("inf")
    scale = np.abs(expected[there]).max(initial=1e-300)
    return float(np.abs(found[there] - expected[there]).max(initial=0.0) / scale)


def _point_by_point(system: Any, x: np.ndarray) -> Any:
    """The CPU's reduction of each point by itself, added up: in a tile all take as many steps as the slowest."""
    owns = system.groups, system.blocks.target, system.model
    pieces = [
        [reduce(of_points(system.rows, k, np.array([i])), *owns, x) for i in range(count)]
        for k, count in enumerate(system.rows.piece[:, 2].tolist())
    ]
    every = [one for piece in pieces for one in piece]
    costs = np.array([sum(one.cost for one in piece) for piece in pieces])
    blocks, gradient = sum(one.blocks for one in every), sum(one.gradient for one in every)
    ends = [np.concatenate([getattr(one, name) for one in every]) for name in ("points", "states")]
    return Reduction(every[0].task, x, float(costs.sum()), costs, blocks, gradient, *ends)


def compare(system: Any, size: float = 1.0, x: np.ndarray | None = None, in_order: bool = True) -> dict[str, float]:
    """All that sweeps give, of rows with unknowns `size` sigmas off; by atomic sums, and by sums in order."""
    from mgsgraph.kernel.cuda import partition

    owns = system.rows, system.groups, system.blocks.target, system.model
    rng = np.random.default_rng(3)
    x = rng.standard_normal(system.columns) * system.sigmas * size if x is None else x
    root = rng.standard_normal((system.columns, system.columns))
    joint = system.flat(root @ root.T * system.sigmas * system.sigmas[:, None])
    cpu, found, unit = _point_by_point(system, x), {}, system.flat(system.sigmas * system.sigmas[:, None])
    for task, deterministic in ((SYSTEM, False), (COSTS, True), (GRADIENT, True), (SYSTEM, True))[: 3 + in_order]:
        part = partition.Partition(*owns, deterministic)
        work, n = partition.Workspace(part.work), part.points
        points, states = np.empty((n, 3)), np.empty(n, dtype=np.int8)
        gradient, blocks = np.zeros(cpu.gradient.size), np.zeros(cpu.blocks.size)
        costs = part.reduce(work, x, task, system.rows.start.copy(), points, states, gradient, blocks)
        word = f", task {task}" + (", deterministic" if deterministic else "")
        found["costs" + word] = _share(costs, cpu.piece_cost)
        found["points" + word] = _share(points, cpu.points)
        found["states" + word] = float(np.count_nonzero(states != cpu.states))
        if task >= GRADIENT:
            found["gradient" + word] = _share(gradient * system.sigmas, cpu.gradient * system.sigmas)
        if task == SYSTEM:
            found["blocks" + word] = _share(blocks[: unit.size] * unit, cpu.blocks[: unit.size] * unit)
    found["covariances"] = _share(
        part.covariances(work, x, joint, cpu.points), point_covariances(*owns, x, joint, cpu.points)
    )
    found["residuals"] = _share(part.residuals(work, x, cpu.points), all_residuals(*owns, x, cpu.points))
    mine, others = part.reliability(work, x, joint, cpu.points), reliability(*owns, x, joint, cpu.points)
    for name, columns in (("misfits", [0]), ("hat matrix", [1, 2, 3]), ("effects", [4, 5, 6])):
        found[name] = _share(mine[:, :, columns], others[:, :, columns])
    return found


def _of_network(
    net: Callable[[], Any], size: float = 1.0, in_order: bool = True, **settings: Any
) -> dict[str, float]:
    system = of_layout(lay_out(net(), SolverSettings(**settings)))
    system.units = np.where(np.isfinite(system.sigmas), system.sigmas, 1e-3)
    return compare(system, size, in_order=in_order)


def _stiff(net: Any) -> Any:
    """The same with a constant correction of each image: twelve columns, for the simulator takes its time."""
    return replace(net, priors=tuple(OrientationPrior(prior.sigmas[:1]) for prior in net.priors))


def _each_kind() -> Any:
    """A tie point and a laser point, with rays, range and its echo, stereo surface, terrain, and a shared unknown."""
    net = _stiff(with_shift_and_surface(with_echoes(stereo_network(pair(1, 1), laser_rays=True))))
    return replace(net, shared=(shared(SharedKind.RANGE_BIAS, [0]),))


def _odd(name: str, line: str) -> dict[str, float]:
    now = made(name, line)
    return compare(of_layout(now.layout, now.rows))


def _known() -> dict[str, float]:
    return compare(of_layout(case(_stiff(with_fixed(network(pair(2, 2)))), "measured").layout))


def _undetermined() -> dict[str, float]:
    now = case(replace(_stiff(one_seen_twice_by_one_image()), held=np.array([False, True])))
    kinds = now.rows.kind.copy()
    kinds[int(now.layout.patterns.point_index[0])] = FREE
    return compare(of_layout(now.layout, now.rows._replace(kind=kinds)))


def _behind() -> dict[str, float]:
    now = case(_stiff(network(pair(2, 1), held=(False, True))))
    system = of_layout(now.layout)
    x = np.zeros(system.columns)
    x[:3] = -2.0 * now.layout.network.images[0].pose(np.array([2500.0])).position[0]
    return compare(system, x=x)


def _adjusted(memory: float = float("inf"), **chosen: Any) -> dict[str, float]:
    """Whole adjustments, on a device with so much memory beside its reduced equations."""
    net, settings = _stiff(network(pair(3, 2), held=(False, True))), SolverSettings(starts=0, **chosen)
    whole = memory + dense_bytes(lay_out(net, settings).columns)
    gpu.find_gpu = lambda: Gpu("a simulated one", whole, 1)
    cpu, other = (adjust_network(net, replace(settings, device=device)) for device in ("cpu", "cuda"))
    spread = np.sqrt(np.nanmax(np.diagonal(cpu.covariances, axis1=1, axis2=2)))
    return {
        "cost": abs(other.cost_final / cpu.cost_final - 1.0),
        "sigma0": abs(other.fit.sigma0 / cpu.fit.sigma0 - 1.0),
        "places": float(np.nanmax(np.abs(other.places - cpu.places)) / spread),
        "covariances": _share(other.covariances, cpu.covariances),
        "rejected": float(np.count_nonzero(other.rays_rejected != cpu.rays_rejected)),
        "said": float("simulated" not in other.message or ("take turns" in other.message) != np.isfinite(memory)),
    }


def _everything() -> Any:
    return with_shift_and_surface(network(pair(3, 2)))


CASES: dict[str, Callable[[], dict[str, float]]] = {
    "predicted lines": partial(_of_network, _everything, 0.02, loss="cauchy", loss_width=1.0),
    "predicted lines, opk-paper": partial(_of_network, _everything, angles="opk-paper"),
    "measured lines": partial(_of_network, _everything, 0.02, line="measured", loss="tukey", loss_width=6.0),
    "measured lines, opk-peer": partial(_of_network, _everything, line="measured", angles="opk-peer"),
    "stereo surfaces": partial(_of_network, lambda: stereo_network(pair(3, 4))),
    "orientation images, huber": partial(
        _of_network, lambda: on_passes(network(pair(3, 2))), 0.1, loss="huber", loss_width=1.0
    ),
    "shared unknowns, cauchy": partial(
        _of_network, lambda: with_all_kinds(with_shift_and_surface(network(pair(2, 2)))), 0.1, loss="cauchy",
        loss_width=1.0,
    ),
    "each kind once": partial(
        _of_network, _each_kind, 0.02, False, angles="opk-peer", loss="tukey", loss_width=6.0
    ),
    "each kind once, measured lines": partial(
        _of_network, _each_kind, 0.1, line="measured", angles="opk-paper", loss="huber", loss_width=1.0
    ),
    "known points": _known,
    "an undetermined point": _undetermined,
    "a point behind its camera": _behind,
    "an adjustment": _adjusted,
    "an adjustment with a search for blunders": partial(_adjusted, loss="huber", reject=4.0),
    "an adjustment in little memory": partial(_adjusted, 5.7e3, deterministic=True),
    **{
        name: partial(_odd, name, line)
        for name, line in (
            ("measured twice", "predicted"), ("points left out", "measured"), ("weights of zero", "predicted"),
            ("second held", "predicted"), ("twelve rays", "predicted"), ("groups of one point", "predicted"),
            ("more than a tile", "measured"),
        )
    },
}  # fmt: skip
"""By name; each gives differences."""
QUICK = (
    "each kind once", "known points", "an undetermined point",
    "a point behind its camera", "an adjustment in little memory",
)  # fmt: skip
"""Each kind of measurement, form and state once, on networks of two images and few points."""

BOUNDS = {
    "residuals": 1e-9, "misfits": 1e-9, "states": 0.0, "rejected": 0.0, "said": 0.0, "places": 1e-8, "sigma0": 1e-9,
}  # fmt: skip
"""Largest differences as a share of the largest number, in place of 1e-10. A residual of a pixel is what is left of
coordinates of 3,400 km: their rounding is a share of 1e-10 of it; where an optimiser stops is settled to 1e-8 sigmas,
which moves sigma0 of a robust fit in the first order (the cost alone is stationary there).
"""


def assert_near(found: dict[str, float]) -> None:
    far = {name: value for name, value in found.items() if not value <= BOUNDS.get(name.split(",")[0], 1e-10)}
    assert not far


@pytest.mark.parametrize("name", QUICK)
def test_the_simulated_device_gives_the_cpus_answers(name: str) -> None:
    """All in one process, some 10 s: the simulator runs each of the device's threads as Python."""
    assert_near(differences(*QUICK)[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in CASES if name not in QUICK])
def test_the_simulated_device_gives_the_cpus_answers_whatever_the_network(name: str) -> None:
    assert_near(differences(name)[name])


@pytest.mark.program("ptxas", by_ci=False)
def test_the_compiler_takes_the_kernels_and_keeps_them_in_registers() -> None:
    """The simulator takes what a compiler refuses."""
    program = Path(__file__).resolve().parents[2] / "scripts" / "gpu_code.py"
    done = subprocess.run([sys.executable, program], capture_output=True, text=True, check=False)
    if done.returncode == 3:
        pytest.skip(f"NVIDIA's compiler is not here ({done.stderr.strip()})")
    assert done.returncode == 0, done.stdout + done.stderr
    kernels = {line.split("|")[1].strip() for line in done.stdout.splitlines()[2:]}
    assert kernels > {"solve", "couple", "add_up", "cover", "judge"}


def share_arrays() -> None:
    """numba's simulator makes a shared array twice where two of its threads ask for it at once."""
    from numba.cuda.simulator.kernelapi import FakeCUDAShared

    def array(self: Any, shape: int, dtype: Any) -> np.ndarray:
        asking = sys._getframe(1)
        made: np.ndarray = self._allocations.setdefault((asking.f_code, asking.f_lineno), np.empty(shape, dtype))
        return made

    FakeCUDAShared.array = array


if __name__ == "__main__":
    warnings.simplefilter("error")
    share_arrays()
    print(json.dumps({name: CASES[name]() for name in sys.argv[1:]}))
