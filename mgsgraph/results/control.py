"""What held the block on the ground beside orientation priors and points: profile shifts, terrain, stereo surfaces,
back-projections.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from mgsgraph.adjustment.multistart import Minima, Minimum
from mgsgraph.adjustment.solution import Solution
from mgsgraph.files.output.table import Column, Table
from mgsgraph.geometry.records import Array
from mgsgraph.network import TERRAIN, PointClass
from mgsgraph.network.terrain import Coverage, coverage
from mgsgraph.results.section import Section
from mgsgraph.text import listed, many, root_mean_square
from mgsgraph.units import MRAD


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


def control_section(solution: Solution) -> Section:
    """Profile shifts, terrain heights and back-projected rays; units in the keys of the numbers."""
    before, after = surface_heights(solution)
    covered, on_stereo = terrain_coverage(solution), stereo_heights(solution)
    copied = int(np.count_nonzero([] if (flags := solution.network.rays.back_projected) is None else flags))
    table, said = _shifts_table(solution), list[str]()
    shifts = [row | _lift_json(solution, p) for p, row in enumerate(table.records())]
    for p, row in enumerate(shifts):
        said += _shift_statements(solution, p, row)
    if after.size:
        said.append(
            f"{after.size} tie points were held to the terrain model: rms height above it "
            f"{root_mean_square(before):.1f} m before, {root_mean_square(after):.1f} m after."
        )
    if covered is not None and covered.words:
        said.append(f"Tie points that the terrain model doesn't cover, and doesn't hold: {covered.words}.")
    if on_stereo.size:
        said.append(
            f"{on_stereo.size} points were held to stereo surfaces: rms height above them "
            f"{root_mean_square(on_stereo):.1f} m."
        )
    if copied:
        said.append(
            f"{copied} image places of laser points are back-projections with the nominal orientation. They repeat the "
            "orientation prior as if it had been measured, so that the stated sigmas are too small."
        )
    return Section("control", sentences=said, tables=[table], numbers={
        "shifts": shifts,
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
        "back_projected_rays": copied,
    })  # fmt: skip


def _shifts_table(solution: Solution) -> Table:
    names, ways = solution.network.shift_names, ("east", "north")
    sigmas = [np.sqrt(np.diag(solution.shift_covariance(p))) for p in range(len(names))]
    return Table("shifts", "Horizontal shifts of profiles and terrain model", (
        Column("name", names, page="s"),
        Column("east_north", np.array([solution.shifts[p] for p in range(len(names))]).reshape(-1, 2), "m", parts=ways,
               head="{}", page=".1f"),
        Column("sigma_east_north", np.array(sigmas).reshape(-1, 2), "m", parts=ways, head="σ {}", page=".1f"),
        Column("considered", np.isin(names, solution.network.considered)),
    ))  # fmt: skip


def _shift_statements(solution: Solution, shift: int, row: Mapping[str, Any]) -> list[str]:
    """Sentences about one shift; more where the terrain model's height or tilt was unknown."""
    (east, north), sigmas = row["east_north_m"], row["sigma_east_north_m"]
    who = "The terrain model" if row["name"] == TERRAIN else _mover(solution, shift)
    found = [
        f"{who} stayed: the horizontal shift is considered, not estimated; its sigma of {sigmas[0]:.1f} m is part of "
        "all sigmas."
        if row["considered"] else
        f"{who} moved as a whole by {east:+.1f} m east and {north:+.1f} m north (sigmas {sigmas[0]:.1f} and "
        f"{sigmas[1]:.1f} m)."
    ]  # fmt: skip
    if "up_m" in row:
        found.append(f"It rose by {row['up_m']:+.1f} m (sigma {row['sigma_up_m']:.1f} m).")
    if "tilt_about_east_north_mrad" in row:
        (east, north), sigmas = row["tilt_about_east_north_mrad"], row["sigma_tilt_about_east_north_mrad"]
        found.append(
            f"It turned by {east:+.4f} mrad about east and {north:+.4f} mrad about north through the middle of the "
            f"points (sigmas {sigmas[0]:.4f} and {sigmas[1]:.4f} mrad)."
        )
    return found


def stereo_heights(solution: Solution) -> Array:
    """Heights (k,) in m, along the normal, of the points that were held to a stereo surface."""
    heights = solution.stereo_heights
    return np.zeros(0) if heights is None else heights[solution.stereo_used]


def _lift_json(solution: Solution, shift: int) -> dict[str, Any]:
    """Value and sigma of the terrain model's height and tilts; nothing of what is known."""
    sigmas = np.sqrt(np.diag(solution.shift_spread(shift))).tolist()
    both = zip(solution.shift_values[shift].tolist(), sigmas, strict=True)
    found = {term.name: pair for term, pair in zip(solution.network.shift_terms[shift], both, strict=True)}
    record = dict(zip(("up_m", "sigma_up_m"), found.get("upward shift", ()), strict=False))
    tilts = np.array([both for name, both in found.items() if name.startswith("tilt")])
    if tilts.size:
        record["tilt_about_east_north_mrad"], record["sigma_tilt_about_east_north_mrad"] = (tilts.T / MRAD).tolist()
    return record


def _mover(solution: Solution, profile: int) -> str:
    """What a profile's shift moves: footprints, or a terrain model whose posts lie on the stereo surface."""
    network = solution.network
    assert network.shifts is not None
    name, mine = network.shifts.names[profile], network.shifts.profile == profile
    if np.any(network.points.classes[mine] == PointClass.POST):
        return f"Terrain model {name}"
    return f"Profile {name}: its footprints"


# --- several places at which a terrain model fits


def minima_section(found: Minima | None) -> Section:
    """What starts over the terrain model's shift have found; mean and sigma are the mixture's."""
    if found is None:
        return Section("minima")
    began = f"{many(found.starts, 'start')} over the terrain model's shift"
    lost = f" ({found.lost} did not converge)" if found.lost else ""
    said = f"{began[0].upper()}{began[1:]} found no better minimum than this one{lost}."
    if found.several:
        places = listed([_place(one) for one in found.each if one.weight > 0.001])
        said = (
            f"SEVERAL MINIMA: {began} ended in {len(found.each)} places{lost}, at which the model moved by {places}. "
            "The lowest one is the solution; all sigmas are those of the mixture about it."
        )
    table = _minima_table(found)
    return Section("minima", sentences=[said], tables=[table], numbers={
        "starts": found.starts, "lost": found.lost, "number": len(found.each),
        "shift_mean_east_north_m": found.mean[:2], "shift_sigma_east_north_m": _sigmas(found.covariance),
        "each": table.records(),
    })  # fmt: skip


def _place(one: Minimum) -> str:
    east, north = one.shift[:2]
    return f"{east:+.0f} m east and {north:+.0f} m north ({one.weight:.0%} probable, cost {one.cost:.4g})"


def _sigmas(covariance: Array) -> Array:
    return np.sqrt(np.diagonal(covariance)[:2])


def _minima_table(found: Minima) -> Table:
    """One row per minimum."""
    each, ways = found.each, ("east", "north")
    return Table("minima", "Places at which the terrain model fits", (
        Column("weight", np.array([one.weight for one in each]), page=".3f"),
        Column("cost", np.array([one.cost for one in each]), page=".2f"),
        Column("starts", np.array([one.starts for one in each]), head="starts that ended here", page="s"),
        Column("shift_east_north", np.array([one.shift[:2] for one in each]), "m", parts=ways, head="{}", page=".1f"),
        Column("sigma_east_north", np.array([_sigmas(one.spread) for one in each]), "m", parts=ways, head="σ {}",
               page=".1f"),
    ), "Local minima of the cost over the model's shift; the first is the solution.")  # fmt: skip
