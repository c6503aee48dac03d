"""The solution as one file, solution.npz, from which it is read back bit for bit.

Every array of the record lies under its own path (`network.points.places`, `joint_covariance.blocks`), so that plain
NumPy reads it too; everything else is a JSON text under `record`. Nothing is pickled: reading an archive runs no code
of its.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError, errors_from
from mgsgraph.files.opening import opened, understood
from mgsgraph.geometry.records import Array
from mgsgraph.results.archive_arrays import Arrays, from_arrays, read_members, record_of, to_arrays

FORMAT = 4
"""Version of the layout, raised whenever an older reader would misread it: 2 holds the joint covariance by blocks,
3 has passes for strips,
4 ids in columns."""
_READ = (2, 3, FORMAT)
ARCHIVE = "solution.npz"
"""Name of the file in a result folder."""
_LARGEST = 1 << 40
"""bytes; every member is held against the file's size."""

_NEWER = "read it with the version of mgsgraph that wrote it, or a newer one"
_OLDER = "adjust the case again, or read it with the older version of mgsgraph that wrote it"
_ANEW = f"adjust the case again, or give the folder (or {ARCHIVE}) that mgsgraph wrote"


def write_archive(solution: Solution, path: Path) -> None:
    """Write a solution to an .npz file."""
    arrays: Arrays = {}
    record = json.dumps(to_arrays(solution, "", arrays), allow_nan=False)
    head = {"format": np.array(FORMAT), "record": np.frombuffer(record.encode(), dtype=np.uint8)}
    with path.open("wb") as file:
        np.savez(file, **head, **arrays)  # type: ignore[arg-type]  # NumPy's stub takes any name for allow_pickle


def read_solution(path: str | Path) -> Solution:
    """Read a solution back.

    Parameters
    ----------
    path : path
        Folder of results, or the archive in it.

    Raises
    ------
    InputError
        If there is no archive, or it is damaged, foreign, or of a format that this version doesn't know.

    Examples
    --------
    >>> print(mgsgraph.read_solution("RESULT"))
    Solution('simulated pair', converged after 5 iterations, cost 449.199 -> 44.8741, sigma0 1.223, 60 degrees of
    freedom; Network(2 images, 28 points (20 tie, 8 laser), 56 rays, 8 ranges))
    """
    path = Path(path)
    path = path / ARCHIVE if path.is_dir() else path
    if not path.exists():
        raise InputError(str(path), "no such file", remedy=_ANEW)
    where = str(path)
    with errors_from(where), understood(where, "an archive of mgsgraph", _ANEW), opened(path, _LARGEST) as file:
        arrays = read_members(file)
        version = int(arrays["format"])
        if version not in _READ:
            raise InputError("format", f"{version}", f"{FORMAT}", _NEWER if version > FORMAT else _OLDER)
        record = record_of(arrays)
        if version == _READ[0] and "strips" in record.get("network", {}):
            record["network"]["passes"] = record["network"].pop("strips")
        record.pop("terrain_cells", None)  # patches that were held, before the terrain model was one smooth surface
        solution: Solution = from_arrays(record, Solution, "", arrays)
        _require_shapes(solution)
        return solution


def _require_shapes(solution: Solution) -> None:
    """Raise InputError unless the arrays of a solution fit its network, so that no later table stumbles over them."""
    network = solution.network
    n, k, r = len(network.points), network.rays.point.size, network.ranges.point.size
    shifts = len(network.shift_names)
    shared = [one.sigmas.size for one in network.shared]
    moves = [len(terms) for terms in network.shift_terms]
    of_passes = [size for one in network.passes for size in one.widths.tolist()]
    width = np.array([prior.sigmas.size for prior in network.priors] + moves + shared + of_passes)
    adjusted = np.append(network.with_polynomial, np.ones(shifts + len(shared) + len(of_passes), dtype=bool))
    first = np.where(adjusted, np.cumsum(width * adjusted) - width, -1)
    expected: dict[str, tuple[int, ...]] = {
        "shifts": (shifts, 2),
        "places_before": (n, 3), "places": (n, 3), "covariances": (n, 3, 3),
        "determined": (n,), "rays_used": (k,), "ranges_used": (r,), "residuals": (k, 2), "residuals_before": (k, 2),
        "range_residuals": (r,), "range_residuals_before": (r,),
    }  # fmt: skip
    newer: dict[str, tuple[int, ...]] = {
        "rays_rejected": (k,), "ranges_rejected": (r,), "stereo_rejected": (n,),
        "stereo_heights": (n,), "test_dimensions": (k + r + n,),
    }  # fmt: skip
    expected |= {name: shape for name, shape in newer.items() if getattr(solution, name) is not None}
    root = solution.joint_covariance.square_root
    found: list[tuple[str, str, Any, Any]] = [
        *((name, "shape ", getattr(solution, name).shape, right) for name, right in expected.items()),
        ("joint_covariance.square_root.first", "", root.first.tolist(), first.tolist()),
        ("joint_covariance.square_root.width", "", root.width.tolist(), width.tolist()),
    ]
    parts: dict[str, tuple[Sequence[Array], list[tuple[int, ...]]]] = {
        "coefficients": (solution.coefficients, [prior.sigmas.shape for prior in network.priors]),
        "lift": (solution.shift_values, [(size,) for size in moves]),
        "shared": (solution.shared, [(size,) for size in shared]),
        "nodes": (solution.nodes, [(len(one.nodes), 6) for one in network.passes]),
        "trends": (solution.trends, [one.prior.trend_sigmas.shape for one in network.passes]),
    }
    found += [(name, "shapes ", [value.shape for value in values], right) for name, (values, right) in parts.items()]
    for name, what, value, right in found:
        if value != right:
            raise InputError(name, f"{what}{str(value)[:60]}", str(right)[:60], _ANEW)
    numbers = {name: list(values) for name, (values, _) in parts.items()} | {
        name: [value] for name in ("shifts", "sigmas_without_laser", "median_sigmas_without_laser")
        if (value := getattr(solution, name)) is not None
    }  # fmt: skip
    for name, arrays in (numbers | {"places": [solution.places[solution.determined]]}).items():
        if not all(np.all(np.isfinite(one)) for one in arrays):
            raise InputError(name, "not a number", "finite numbers", _ANEW)
