"""The solution as one file, solution.npz, from which it is read back bit for bit.

Every array of the record lies under its own path (`network.points.places`, `joint_covariance.blocks`), so that plain
NumPy reads it too; everything else is a JSON text under `record`. Nothing is pickled: reading an archive runs no code
of its.
"""

import json
from pathlib import Path

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
    of_strips = [size for strip in network.passes for size in strip.widths.tolist()]
    width = np.array([prior.sigmas.size for prior in network.priors] + moves + shared + of_strips)
    adjusted = np.append(network.with_polynomial, np.ones(shifts + len(shared) + len(of_strips), dtype=bool))
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
    for name, shape in expected.items():
        if (found := getattr(solution, name).shape) != shape:
            raise InputError(name, f"shape {found}", f"{shape}", _ANEW)
    root = solution.joint_covariance.square_root
    for name, found, right in (
        ("joint_covariance.square_root.first", root.first, first),
        ("joint_covariance.square_root.width", root.width, width),
    ):
        if not np.array_equal(found, right):
            raise InputError(name, f"{found.tolist()[:10]}", f"{right.tolist()[:10]}", _ANEW)
    shapes = [part.shape for part in solution.coefficients]
    if shapes != [prior.sigmas.shape for prior in network.priors]:
        raise InputError("coefficients", f"shapes {shapes[:5]}", "those of the priors", _ANEW)
    _require_finite(solution)
    if [value.size for value in solution.shift_values] != moves:
        raise InputError("lift", "values of other unknowns", "those of the network's terrain model", _ANEW)
    values = [value.shape for value in solution.shared]
    if values != [(size,) for size in shared]:
        raise InputError("shared", f"shapes {values[:5]}", "those of the network's shared unknowns", _ANEW)
    _require_passes(solution)


def _require_passes(solution: Solution) -> None:
    """Raise InputError unless every strip has its nodes and its trend."""
    strips = solution.network.passes
    for name, values, right in (
        ("nodes", solution.nodes, [(len(strip.nodes), 6) for strip in strips]),
        ("trends", solution.trends, [strip.prior.trend_sigmas.shape for strip in strips]),
    ):
        if [value.shape for value in values] != right:
            found = f"shapes {[value.shape for value in values][:5]}"
            raise InputError(name, found, "those of the network's strips", _ANEW)


def _require_finite(solution: Solution) -> None:
    """Raise InputError where what was adjusted has no value."""
    parts: dict[str, list[Array]] = {
        "coefficients": list(solution.coefficients), "shifts": [solution.shifts], "shared": list(solution.shared),
        "places": [solution.places[solution.determined]], "lift": [] if solution.lift is None else [solution.lift],
        "nodes": list(solution.nodes), "trends": list(solution.trends),
    }  # fmt: skip
    for name in ("sigmas_without_laser", "median_sigmas_without_laser"):
        value = getattr(solution, name)
        parts[name] = [] if value is None else [value]
    for name, values in parts.items():
        if not all(np.all(np.isfinite(one)) for one in values):
            raise InputError(name, "not a number", "finite numbers", _ANEW)
