"""What held the block on the ground beside orientation priors and points: profile shifts, terrain, back-projections."""

from typing import Any

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.records import Array


def surface_heights(solution: Solution) -> tuple[Array, Array]:
    """Heights (k,) in m of the points that lie on the terrain model, along its normal, before and after."""
    surface = solution.network.surface
    if surface is None:
        return np.zeros(0), np.zeros(0)
    mine = np.isfinite(surface.sigmas) & solution.determined
    before, _ = surface.grid.height_above(solution.places_before[mine])
    places = solution.places[mine]
    if solution.network.terrain_moves:
        places = places - solution.shifts[-1] @ east_north(places)
    after, _ = surface.grid.height_above(places)
    there = np.isfinite(before) & np.isfinite(after)
    return before[there], after[there]


def control_json(solution: Solution) -> dict[str, Any]:
    """Profile shifts, terrain heights and back-projected rays, for solution.json; units in the keys."""
    before, after = surface_heights(solution)
    names = solution.network.shift_names
    return {
        "shifts": [
            {
                "name": name,
                "east_north_m": solution.shifts[p].tolist(),
                "sigma_east_north_m": np.sqrt(np.diag(solution.shift_covariance(p))).tolist(),
            }
            for p, name in enumerate(names)
        ],
        "surface": {
            "count": int(after.size),
            "rms_height_before_m": _rms(before),
            "rms_height_m": _rms(after),
            "mean_height_m": float(after.mean()) if after.size else None,
        },
        "back_projected_rays": _back_projected(solution),
    }


def control_statements(solution: Solution) -> list[str]:
    """Sentences about the same."""
    sentences = []
    for p, name in enumerate(solution.network.shift_names):
        (east, north), sigma = solution.shifts[p], np.sqrt(np.diag(solution.shift_covariance(p)))
        who = "The terrain model" if name == "terrain model" else f"Profile {name}: its footprints"
        sentences.append(
            f"{who} moved as a whole by {east:+.1f} m east and {north:+.1f} m north "
            f"(sigmas {sigma[0]:.1f} and {sigma[1]:.1f} m)."
        )
    before, after = surface_heights(solution)
    if after.size:
        sentences.append(
            f"{after.size} tie points were held to the terrain model: rms height above it {_rms(before):.1f} m before, "
            f"{_rms(after):.1f} m after."
        )
    copied = _back_projected(solution)
    if copied:
        sentences.append(
            f"{copied} image places of laser points are back-projections with the nominal orientation. They repeat the "
            "orientation prior as if it had been measured, so that the stated sigmas are too small."
        )
    return sentences


def _back_projected(solution: Solution) -> int:
    flags = solution.network.rays.back_projected
    return int(np.count_nonzero(flags)) if flags is not None else 0


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if values.size else None
