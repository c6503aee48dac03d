"""What held the block on the ground beside orientation priors and points: profile shifts, terrain, stereo surfaces,
back-projections.
"""

from typing import Any

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.records import Array
from mgsgraph.network import TERRAIN, PointClass
from mgsgraph.network.terrain_control import Coverage, coverage
from mgsgraph.text import root_mean_square
from mgsgraph.units import MRAD

_LEVEL = ("east shift", "north shift")


def surface_heights(solution: Solution) -> tuple[Array, Array]:
    """Heights (k,) in m of the points that lie on the terrain model, along its normal, before and after."""
    surface = solution.network.surface
    if surface is None:
        return np.zeros(0), np.zeros(0)
    mine = np.isfinite(surface.sigmas) & solution.determined
    before, _ = surface.grid.height_above(solution.places_before[mine])
    places = solution.places[mine]
    after, _ = surface.grid.height_above(places - _terrain_motion(solution, places))
    there = np.isfinite(before) & np.isfinite(after)
    return before[there], after[there]


def terrain_coverage(solution: Solution) -> Coverage | None:
    """How the terrain model covers the determined tie points, at their adjusted places; None without one."""
    network, surface = solution.network, solution.network.surface
    if surface is None:
        return None
    ties = (network.points.classes == PointClass.TIE) & solution.determined
    places = solution.places[ties]
    return coverage(surface.grid, places - _terrain_motion(solution, places))


def _terrain_motion(solution: Solution, places: Array) -> Array:
    """(n, 3) m by which the terrain model has moved at places (n, 3) in m."""
    surface = solution.network.surface
    if surface is None or not solution.network.terrain_moves:
        return np.zeros_like(places)
    return surface.moved(places, solution.shift_values[-1])


def control_json(solution: Solution) -> dict[str, Any]:
    """Profile shifts, terrain heights and back-projected rays, for solution.json; units in the keys."""
    before, after = surface_heights(solution)
    names, covered, on_stereo = solution.network.shift_names, terrain_coverage(solution), stereo_heights(solution)
    return {
        "shifts": [
            {
                "name": name,
                "east_north_m": solution.shifts[p].tolist(),
                "sigma_east_north_m": np.sqrt(np.diag(solution.shift_covariance(p))).tolist(),
                "considered": name in solution.network.considered,
                **_lift_json(solution, p),
            }
            for p, name in enumerate(names)
        ],
        "surface": {
            "count": int(after.size),
            "rms_height_before_m": root_mean_square(before),
            "rms_height_m": root_mean_square(after),
            "mean_height_m": float(after.mean()) if after.size else None,
            "outside": covered.beside if covered else 0,
            "over_missing_posts": covered.over_holes if covered else 0,
        },
        "stereo": {
            "count": int(on_stereo.size), "rms_height_m": root_mean_square(on_stereo) if on_stereo.size else None
        },
        "back_projected_rays": _back_projected(solution),
    }


def stereo_heights(solution: Solution) -> Array:
    """Heights (k,) in m, along the normal, of the points that were held to a stereo surface."""
    heights = solution.stereo_heights
    return np.zeros(0) if heights is None else heights[solution.stereo_used]


def _lift(solution: Solution, shift: int) -> dict[str, tuple[float, float]]:
    """Value and sigma of the terrain model's height (m) and tilts (rad), by name; nothing of what is known."""
    sigmas = np.sqrt(np.diag(solution.shift_spread(shift))).tolist()
    both = zip(solution.shift_values[shift].tolist(), sigmas, strict=True)
    named = zip(solution.network.shift_terms[shift], both, strict=True)
    return {term.name: pair for term, pair in named if term.name not in _LEVEL}


def _lift_json(solution: Solution, shift: int) -> dict[str, Any]:
    found, record = _lift(solution, shift), dict[str, Any]()
    if "upward shift" in found:
        record["up_m"], record["sigma_up_m"] = found["upward shift"]
    tilts = np.array([both for name, both in found.items() if name.startswith("tilt")])
    if tilts.size:
        record["tilt_about_east_north_mrad"], record["sigma_tilt_about_east_north_mrad"] = (tilts.T / MRAD).tolist()
    return record


def _lift_statement(solution: Solution, shift: int) -> list[str]:
    """One sentence where the terrain model's height or tilt was unknown."""
    record, words = _lift_json(solution, shift), list[str]()
    if "up_m" in record:
        words.append(f"rose by {record['up_m']:+.1f} m (sigma {record['sigma_up_m']:.1f} m)")
    if "tilt_about_east_north_mrad" in record:
        east, north = record["tilt_about_east_north_mrad"]
        of_east, of_north = record["sigma_tilt_about_east_north_mrad"]
        words.append(
            f"turned by {east:+.4f} mrad about east and {north:+.4f} mrad about north through the middle of the "
            f"points (sigmas {of_east:.4f} and {of_north:.4f} mrad)"
        )
    return [f"It {' and '.join(words)}."] if words else []


def _mover(solution: Solution, profile: int) -> str:
    """What a profile's shift moves: footprints, or a terrain model whose posts lie on the stereo surface."""
    network = solution.network
    assert network.shifts is not None
    name, mine = network.shifts.names[profile], network.shifts.profile == profile
    if np.any(network.points.classes[mine] == PointClass.POST):
        return f"Terrain model {name}"
    return f"Profile {name}: its footprints"


def control_statements(solution: Solution) -> list[str]:
    """Sentences about profile shifts, terrain heights and back-projected rays."""
    sentences = []
    for p, name in enumerate(solution.network.shift_names):
        (east, north), sigma = solution.shifts[p], np.sqrt(np.diag(solution.shift_covariance(p)))
        who = "The terrain model" if name == TERRAIN else _mover(solution, p)
        if name in solution.network.considered:
            sentences.append(
                f"{who} stayed: the horizontal shift is considered, not estimated; its sigma of {sigma[0]:.1f} m is "
                "part of all sigmas."
            )
        else:
            sentences.append(
                f"{who} moved as a whole by {east:+.1f} m east and {north:+.1f} m north "
                f"(sigmas {sigma[0]:.1f} and {sigma[1]:.1f} m)."
            )
        sentences += _lift_statement(solution, p)
    before, after = surface_heights(solution)
    if after.size:
        sentences.append(
            f"{after.size} tie points were held to the terrain model: rms height above it "
            f"{root_mean_square(before):.1f} m before, {root_mean_square(after):.1f} m after."
        )
    covered = terrain_coverage(solution)
    if covered is not None and covered.words:
        sentences.append(f"Tie points that the terrain model doesn't cover, and doesn't hold: {covered.words}.")
    on_stereo = stereo_heights(solution)
    if on_stereo.size:
        sentences.append(
            f"{on_stereo.size} points were held to stereo surfaces: rms height above them "
            f"{root_mean_square(on_stereo):.1f} m."
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
