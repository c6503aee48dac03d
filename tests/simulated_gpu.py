"""The GPU's kernels, run by numba's CUDA simulator in a process of their own: how far they are from the CPU's.

`python simulated_gpu.py NAME...` writes one line of JSON: of each case the largest difference of each result, as a
share of the CPU's largest number. NUMBA_ENABLE_CUDASIM has to be set before numba is imported.
"""

import json
import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from once import once

Differences = dict[str, dict[str, float]]


@once
def differences(*names: str) -> Differences:
    """Of cases by name, from a process in which the simulator stands in for a device."""
    import mgsgraph

    paths = Path(__file__).parent, Path(mgsgraph.__file__).parents[1]  # the package that is tested here
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
    from mgsgraph.kernel.rows import of_points
    from mgsgraph.kernel.sweep import Reduction, reduce

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
    from mgsgraph.kernel.sweep import COSTS, GRADIENT, SYSTEM, all_residuals, point_covariances, reliability

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
    from normals import of_layout

    from mgsgraph.adjustment.graph import lay_out
    from mgsgraph.adjustment.settings import SolverSettings

    layout = lay_out(net(), SolverSettings(**settings))
    system = of_layout(layout, layout.rows)
    system.sigmas = np.where(np.isfinite(system.sigmas), system.sigmas, 1e-3)
    return compare(system, size, in_order=in_order)


def _everything() -> Any:
    from networks import network, pair, with_shift_and_surface

    return with_shift_and_surface(network(pair(3, 2)))


def _stiff(net: Any) -> Any:
    """The same with a constant correction of each image: twelve columns, for the simulator takes its time."""
    from mgsgraph.geometry.orientation import OrientationPrior

    return replace(net, priors=tuple(OrientationPrior(prior.sigmas[:1]) for prior in net.priors))


def _each_kind() -> Any:
    """A tie point and a laser point, with rays, range, stereo surface, terrain, and a shared unknown."""
    from networks import pair, with_shift_and_surface
    from sharing import shared
    from stereo_pair import stereo_network

    from mgsgraph.network import SharedKind as Kind

    net = _stiff(with_shift_and_surface(stereo_network(pair(1, 1), laser_rays=True)))
    return replace(net, shared=(shared(Kind.RANGE_BIAS, [0]),))


def _odd(name: str, line: str) -> dict[str, float]:
    from normals import of_layout
    from odd_networks import made

    now = made(name, line)
    return compare(of_layout(now.layout, now.rows))


def _any_columns(line: str) -> dict[str, float]:
    sys.path.append(str(Path(__file__).parent / "factors"))  # `factors` itself is the package
    from normals import pack, take_apart
    from odd_networks import made
    from test_bundle import with_any_columns

    now = made("shifts and terrain", line)
    variables, points = now.layout.variables, take_apart(now.layout, now.rows)
    units = [
        now.layout.scales[now.layout.columns_of(v)] if variables.first[v] >= 0 else np.zeros(0)
        for v in range(variables.first.size)
    ]
    with_any_columns(points, units, 1)
    return compare(pack(points, units, now.layout), 0.3)


def _stereo() -> Any:
    from networks import pair
    from stereo_pair import stereo_network

    return stereo_network(pair(3, 4))


def _strips() -> Any:
    from adjustment.test_strips import stripped
    from networks import network, pair

    return stripped(network(pair(3, 2)))


def _shared() -> Any:
    from networks import network, pair, with_shift_and_surface
    from sharing import with_all_kinds

    return with_all_kinds(with_shift_and_surface(network(pair(2, 2))))


def _known() -> dict[str, float]:
    from networks import network, pair
    from normals import of_layout
    from odd_networks import case, with_fixed

    return compare(of_layout(case(_stiff(with_fixed(network(pair(2, 2)))), "measured").layout))


def _undetermined() -> dict[str, float]:
    from normals import of_layout
    from odd_networks import case, one_seen_twice_by_one_image

    from mgsgraph.kernel.rows import FREE

    now = case(replace(_stiff(one_seen_twice_by_one_image()), held=np.array([False, True])))
    kinds = now.rows.kind.copy()
    kinds[int(now.layout.patterns.point_index[0])] = FREE
    return compare(of_layout(now.layout, now.rows._replace(kind=kinds)))


def _behind() -> dict[str, float]:
    from networks import network, pair
    from normals import of_layout
    from odd_networks import case

    now = case(_stiff(network(pair(2, 1), held=(False, True))))
    system = of_layout(now.layout)
    x = np.zeros(system.columns)
    x[:3] = -2.0 * now.layout.network.images[0].pose(np.array([2500.0])).position[0]
    return compare(system, x=x)


def _adjusted(memory: float = float("inf"), **chosen: Any) -> dict[str, float]:
    """Whole adjustments, on a device with so much memory beside its reduced equations."""
    from networks import network, pair

    from mgsgraph.adjustment import gpu as choice
    from mgsgraph.adjustment.adjust import adjust_network
    from mgsgraph.adjustment.gpu.sweeper import dense_bytes
    from mgsgraph.adjustment.graph import lay_out
    from mgsgraph.adjustment.settings import SolverSettings

    net, settings = _stiff(network(pair(3, 2), held=(False, True))), SolverSettings(starts=0, **chosen)
    whole = memory + dense_bytes(lay_out(net, settings).columns)
    choice.find_gpu = lambda: choice.Gpu("a simulated one", whole, 1)
    cpu, gpu = (adjust_network(net, replace(settings, device=device)) for device in ("cpu", "cuda"))
    spread = np.sqrt(np.nanmax(np.diagonal(cpu.covariances, axis1=1, axis2=2)))
    return {
        "cost": abs(gpu.cost_final / cpu.cost_final - 1.0),
        "sigma0": abs(gpu.fit.sigma0 / cpu.fit.sigma0 - 1.0),
        "places": float(np.nanmax(np.abs(gpu.places - cpu.places)) / spread),
        "covariances": _share(gpu.covariances, cpu.covariances),
        "rejected": float(np.count_nonzero(gpu.rays_rejected != cpu.rays_rejected)),
        "said": float("simulated" not in gpu.message or ("take turns" in gpu.message) != np.isfinite(memory)),
    }


CASES: dict[str, Callable[[], dict[str, float]]] = {
    **{
        f"{line} line, angles {angles}": partial(_of_network, _everything, line=line, angles=angles)
        for line in ("predicted", "measured")
        for angles in ("camera", "opk-paper", "opk-peer")
    },
    **{
        f"loss {loss}": partial(_of_network, _everything, 0.02, loss=loss, loss_width=width)
        for loss, width in (("huber", 1.0), ("cauchy", 1.0), ("tukey", 6.0))
    },
    "angles opk-peer, loss tukey": partial(
        _of_network, _everything, 0.02, angles="opk-peer", loss="tukey", loss_width=6.0
    ),
    "stereo surfaces": partial(_of_network, _stereo),
    "orientation images, huber": partial(_of_network, _strips, 0.1, loss="huber", loss_width=1.0),
    "shared unknowns, cauchy": partial(_of_network, _shared, 0.1, loss="cauchy", loss_width=1.0),
    "each kind once": partial(
        _of_network, _each_kind, 0.02, False, angles="opk-peer", loss="tukey", loss_width=6.0
    ),
    "each kind once, measured lines": partial(
        _of_network, _each_kind, 0.1, line="measured", angles="opk-paper", loss="huber", loss_width=1.0
    ),
    "any columns, predicted": partial(_any_columns, "predicted"),
    "any columns, measured": partial(_any_columns, "measured"),
    "measured twice": partial(_odd, "measured twice", "predicted"),
    "known points": _known,
    "points left out": partial(_odd, "points left out", "measured"),
    "weights of zero": partial(_odd, "weights of zero", "predicted"),
    "one image held": partial(_odd, "second held", "predicted"),
    "an undetermined point": _undetermined,
    "a point behind its camera": _behind,
    "an adjustment": _adjusted,
    "an adjustment with a search for blunders": partial(_adjusted, loss="huber", reject=4.0),
    "an adjustment in little memory": partial(_adjusted, 5.7e3, deterministic=True),
    "twelve rays a point": partial(_odd, "twelve rays", "predicted"),
    "groups of one point": partial(_odd, "groups of one point", "predicted"),
    "more than a tile": partial(_odd, "more than a tile", "measured"),
}
"""By name; each gives differences."""
QUICK = (
    "each kind once", "known points", "an undetermined point",
    "a point behind its camera", "an adjustment in little memory",
)  # fmt: skip
"""Each kind of measurement, form and state once, on networks of two images and few points."""

if __name__ == "__main__":
    warnings.simplefilter("error")
    print(json.dumps({name: CASES[name]() for name in sys.argv[1:]}))
