"""The ground of a solution: points, ranges, effect of the laser, rejected observations, and other control
(profile shifts, terrain, stereo surfaces, back-projections); checkpoints, and control points left out in turn.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mgsgraph.adjustment.covariances import Linearised
from mgsgraph.adjustment.multistart import Minima
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.checkpoints import Discrepancies, checkpoint_discrepancies, control_points, leave_out
from mgsgraph.analysis.statistics import laser_gain, point_statistics, range_statistics, rejected_rays, used_ray_counts
from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.files.output.table import Table, numbers
from mgsgraph.geometry.records import Array, sigmas_of
from mgsgraph.names import Names
from mgsgraph.network import Network, PointClass
from mgsgraph.network.observations import Coverage, coverage
from mgsgraph.results.section import Section, record_of, table_of
from mgsgraph.text import length, listed, many, root_mean_square, some_of, span, three, two
from mgsgraph.units import ARCSEC

_AXES = ("east", "north", "up")
_SAME_RATIO = 1.05
"""Ratio up to which two sigmas count as the same."""


def points_section(solution: Solution) -> Section:
    """Points by class, and what was left out."""
    table = classes_table(solution)
    present = [point_class for point_class, _ in solution.network.of_class()]
    record = {row.pop("kind"): row for row in table.records()}
    shown = table.take(np.array(present, dtype=np.int64))
    return Section("points", sentences=omission_sentences(solution), tables=[shown], numbers=record)


def classes_table(solution: Solution) -> Table:
    """One row per class of points (`Network.classes`): how many, how well they are known, how far they moved."""
    statistics = [point_statistics(solution, point_class) for point_class in solution.network.classes]
    return table_of("classes", {
        "kind": [point_class.name.lower() for point_class in solution.network.classes],
        "scaled_sigma_{}": numbers(statistics, "median_sigma") * solution.sigma0,
    }, statistics)  # fmt: skip


def omission_sentences(solution: Solution) -> list[str]:
    """Sentences on points, rays, ranges and heights that took no part."""
    network, sentences = solution.network, []
    determined, rejected = solution.determined, rejected_rays(solution)
    hit = np.unique(network.rays.point[rejected])
    undetermined = np.setdiff1d(np.flatnonzero(~determined), hit)
    if undetermined.size:
        sentences.append(f"{many(undetermined.size, 'point')} of {determined.size} took no part: their rays "
                         "determine no place (fewer than two rays, or nearly parallel ones): "
                         f"{some_of(network.points.ids, undetermined)}.")  # fmt: skip
    ranges = ~solution.ranges_used & determined[network.ranges.point]
    counts = [(int(rejected.sum()), rejected.size, "image point"), (int(ranges.sum()), ranges.size, "range")]
    if solution.stereo_rejected is not None:
        flagged = solution.stereo_rejected & determined
        counts.append((int(np.count_nonzero(flagged)), int(np.count_nonzero(flagged | solution.stereo_used)), "height"))
    if any(count for count, *_ in counts):
        clauses = [f"{count} of {many(total, noun)}" for count, total, noun in counts if total]
        named = f" ({some_of(network.points.ids, hit)})" if hit.size else ""
        lost = hit[~determined[hit] | (used_ray_counts(solution)[hit] == 0)]
        sentences.append(f"Rejected as blunders: {listed(clauses)}{named}; the table of residuals marks them.")
        if lost.size:
            sentences[-1] += f" {many(lost.size, 'point')} lost all rays to that, or all but one: "
            sentences[-1] += f"{some_of(network.points.ids, lost)}."
    if solution.test_dimensions is not None:
        dimensions = solution.test_dimensions[: network.rays.point.size][solution.rays_used]
        if one_direction := int(np.count_nonzero(dimensions < 2)):
            sentences.append(f"Of {dimensions.size} rays that took part others check {one_direction} in one direction "
                             "at most (mostly across the epipolar line): a blunder along the other goes "
                             "unnoticed.")  # fmt: skip
    return sentences


def ranges_section(solution: Solution) -> Section:
    """How laser ranges fit, with the nominal orientation and with the adjusted one."""
    statistics = range_statistics(solution)
    record = record_of("ranges", statistics)  # fmt: skip
    if not statistics.count:
        return Section("ranges", numbers=record)
    table = table_of("ranges", {
        "orientation": ["before", "after"], "ranges": np.full(2, statistics.count), "used": np.full(2, statistics.used),
        "mean residual": np.array([statistics.mean_before, statistics.mean]),
        "rms residual": np.array([statistics.rms_before, statistics.rms]),
    })  # fmt: skip
    return Section("ranges", tables=[table], numbers=record)


def laser_section(solution: Solution, brief: bool = False) -> Section:
    """By how much laser rows reduce sigmas (`brief`: one factor alone); without laser rows, what fixes the datum."""
    without = solution.sigmas_without_laser
    if without is None:
        return Section("laser_effect", sentences=_datum_sentences(solution))
    tie_points, gain = point_statistics(solution, PointClass.TIE), laser_gain(solution)
    median = solution.median_sigmas_without_laser
    network, laser = solution.network, solution.network.points.classes == PointClass.LASER
    rays, ranges = int(np.sum(solution.rays_used & laser[network.rays.point])), int(solution.ranges_used.sum())
    counts = f"{many(int(laser.sum()), 'point')}, {many(rays, 'ray')}, {many(ranges, 'range')}"
    average, sigmas = ("mean", tie_points.mean_sigma) if median is None else ("median", tie_points.median_sigma)
    size = "the same" if gain < _SAME_RATIO else f"{gain:.2g} times larger"
    sentence = f"Without the laser, sigmas of tie points would be {size}." if brief else (
        f"Without the laser ({counts}) the tie points' {average} sigmas would be "
        f"{three(without if median is None else median)} m in x, y, z, not {three(sigmas)} m: {size}."
    )
    return Section("laser_effect", sentences=[sentence], numbers={
        "tie_mean_sigma_m": tie_points.mean_sigma,
        "tie_mean_sigma_without_laser_m": without,
        "ratio": without / tie_points.mean_sigma,
        "tie_median_sigma_m": tie_points.median_sigma,
        "tie_median_sigma_without_laser_m": median,
        "ratio_overall": gain,
    })  # fmt: skip


def _datum_sentences(solution: Solution) -> list[str]:
    """What fixes the datum of a block without laser ranges, ground control and terrain model."""
    network = solution.network
    has_ground = np.any(solution.determined & (network.points.kinds != PointKind.FREE)) or np.any(solution.ranges_used)
    if has_ground or network.surface is not None:
        return []
    of_images = [network.priors[j].sigmas[0] for j in np.flatnonzero(network.with_polynomial)]
    sigmas = np.array(of_images + [pass_.prior.node_sigmas(np.zeros(len(pass_.nodes)))[0] for pass_ in network.passes])
    held_images = f" and {many(int(network.held.sum()), 'held image')}" if np.any(network.held) else ""
    if sigmas.size == 0:
        return ["Every image is held: the points have the sigmas of their rays alone, as if the orientation were true."]
    return [
        f"No laser, no ground control: only the orientation priors{held_images} ({span(sigmas[:, :3])} m, "
        f"{span(sigmas[:, 3:] / ARCSEC)} arcsec) fix the block, and the points' sigmas mostly repeat them."
    ]


# --- checkpoints, and control points left out in turn


def checkpoint_sections(solution: Solution) -> list[Section]:
    """The checkpoints of a solution; no section without any."""
    found = checkpoint_discrepancies(solution)
    return [] if found is None else [_discrepancies_section("checkpoints", found, solution.network)]


def leave_out_section(at: Linearised) -> Section:
    """Control points, each left out in turn; InputError without any."""
    if not any(control_points(at.network, kind).size for kind in (PointKind.CONSTRAINED, PointKind.FIXED)):
        expected = "ground control with sigmas: Constrained points of [ties], or [ground_control]"
        raise InputError("leave-out", "no point with known coordinates that takes part", expected, "adjust with some")
    fixed = control_points(at.network, PointKind.FIXED)
    ids = some_of(at.network.points.ids, fixed)
    remark = [f"Fixed points can't be left out, as their coordinates have no sigma: {ids}."] if fixed.size else []
    return _discrepancies_section("leave_out", leave_out(at), at.network, remark)


def _discrepancies_section(name: str, found: Discrepancies, network: Network, remarks: Sequence[str] = ()) -> Section:
    """The finding, whose name is that of its table, too."""
    ids, table = network.points.ids, discrepancies_table(name, found, network)
    sentences = [_sentence(name, found, ids)]
    if found.undetermined.size:
        sentences.append(f"Nothing else determines the position of {many(found.undetermined.size, 'point')}, without "
                         f"a discrepancy therefore: {some_of(ids, found.undetermined)}.")  # fmt: skip
    return Section(name, sentences=[*sentences, *remarks], tables=[table], csv=[table], numbers={
        "rms_east_north_up_m": found.rms if found.points.size else None, "chi_square": found.chi_square,
        "degrees_of_freedom": found.degrees, "range_95_percent": found.band, "p_value": found.p_value,
        "points_in_chi_square": found.joint, "undetermined": ids[found.undetermined].tolist(),
        "points": table.records(),
    })  # fmt: skip


def discrepancies_table(name: str, found: Discrepancies, network: Network) -> Table:
    """One row per point: adjusted minus known, its sigmas, and in units of them."""
    return table_of(name, {
        "point": network.points.ids[found.points], "east_north_up": found.values, "sigma_east_north_up": found.sigmas,
        "normalized": found.normalized,
    })  # fmt: skip


def _sentence(name: str, found: Discrepancies, ids: Names) -> str:
    """Rms, and whether chi-square is in its band."""
    what = "Checkpoints" if name == "checkpoints" else "Control points, each left out"
    if not found.points.size:
        return f"{what}: nothing could be compared with known coordinates."
    (low, high), (point, axis) = found.band, np.divmod(int(np.argmax(np.abs(found.normalized))), 3)
    size = "smaller than" if found.chi_square < low else "larger than" if found.chi_square > high else "consistent with"
    rms = listed([f"{length(value)} {way}" for value, way in zip(found.rms.tolist(), _AXES, strict=True)])
    largest = f"{two(float(found.normalized[point, axis]))} sigmas ({ids[int(found.points[point])]}, {_AXES[axis]})"
    of_some = f" of {found.joint} of them" if found.joint < found.points.size else ""
    return (
        f"{what} ({found.points.size}): adjusted minus known has rms {rms}, largest {largest}; chi-square{of_some} "
        f"{found.chi_square:.3g} (95 % range {low:.3g} to {high:.3g}): {size} the stated sigmas."
    )


# --- further control


def surface_heights(solution: Solution) -> tuple[Array, Array]:
    """Heights (k,) in m of the points that lie on the terrain model, along its normal, before and after."""
    surface = solution.network.surface
    if surface is None:
        return np.zeros(0), np.zeros(0)
    on_surface = np.isfinite(surface.sigmas) & solution.determined
    before, _ = surface.grid.height_above(solution.places_before[on_surface])
    places = solution.places[on_surface]
    after, _ = surface.grid.height_above(places - _terrain_motion(solution, places))
    covered = np.isfinite(before) & np.isfinite(after)
    return before[covered], after[covered]


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
    covered, stereo = terrain_coverage(solution), stereo_heights(solution)
    back_projected = int(np.count_nonzero([] if (flags := solution.network.rays.back_projected) is None else flags))
    table, sentences = _shifts_table(solution), list[str]()
    shifts = [row | _lift_json(solution, p) for p, row in enumerate(table.records())]
    sentences += [_shift_sentence(solution, p) for p in range(len(shifts))]
    if after.size:
        sentences.append(f"{after.size} tie points were held to the terrain model: rms height above it "
                    f"{root_mean_square(before):.1f} m before, {root_mean_square(after):.1f} m after.")  # fmt: skip
    if covered is not None and covered.words:
        sentences.append(f"Tie points that the terrain model doesn't cover, and doesn't hold: {covered.words}.")
    if stereo.size:
        rms = root_mean_square(stereo)
        sentences.append(f"{stereo.size} points were held to stereo surfaces: rms height above them {rms:.1f} m.")
    if back_projected:
        sentences.append(f"{back_projected} image places of laser points are back-projections with the nominal "
                         "orientation: they repeat its prior, and the stated sigmas are too small.")  # fmt: skip
    return Section("control", sentences=sentences, tables=[table], numbers={
        "shifts": shifts,
        "surface": {
            "count": int(after.size),
            "rms_height_before_m": root_mean_square(before),
            "rms_height_m": root_mean_square(after),
            "mean_height_m": float(after.mean()) if after.size else None,
            "outside": covered.beside if covered else 0,
            "over_missing_posts": covered.over_holes if covered else 0,
        },
        "stereo": {"count": int(stereo.size), "rms_height_m": root_mean_square(stereo) if stereo.size else None},
        "back_projected_rays": back_projected,
    })  # fmt: skip


def _shifts_table(solution: Solution) -> Table:
    names = solution.network.shift_names
    sigmas = [sigmas_of(solution.shift_covariance(p)) for p in range(len(names))]
    return table_of("shifts", {
        "name": names, "east_north": np.array([solution.shifts[p] for p in range(len(names))]).reshape(-1, 2),
        "sigma_east_north": np.array(sigmas).reshape(-1, 2), "considered": np.isin(names, solution.network.considered),
    })  # fmt: skip


def _shift_sentence(solution: Solution, shift: int) -> str:
    """By how much footprints, or a terrain model, were moved, with sigmas."""
    network, name = solution.network, solution.network.shift_names[shift]
    sigmas = sigmas_of(solution.shift_spread(shift))
    if name in network.considered:
        return f"{name}: its shift is considered, not estimated; its sigma of {sigmas[0]:.1f} m is part of all sigmas."
    clauses = [
        f"{term.name} {value / ARCSEC:+.2f} arcsec (sigma {sigma / ARCSEC:.2f})" if term.unit == "rad" else
        f"{term.name} {value:+.1f} m (sigma {sigma:.1f})"
        for term, value, sigma in zip(network.shift_terms[shift], solution.shift_values[shift], sigmas, strict=True)
    ]  # fmt: skip
    return f"{name} moved as a whole: {', '.join(clauses)}."


def stereo_heights(solution: Solution) -> Array:
    """Heights (k,) in m, along the normal, of the points that were held to a stereo surface."""
    heights = solution.stereo_heights
    return np.zeros(0) if heights is None else heights[solution.stereo_used]


def _lift_json(solution: Solution, shift: int) -> dict[str, Any]:
    """Value and sigma of the terrain model's height and tilts, of those that are unknowns."""
    sigmas = sigmas_of(solution.shift_spread(shift)).tolist()
    pair = zip(solution.shift_values[shift].tolist(), sigmas, strict=True)
    pair_of_term = {term.name: pair for term, pair in zip(solution.network.shift_terms[shift], pair, strict=True)}
    record = dict(zip(("up_m", "sigma_up_m"), pair_of_term.get("upward shift", ()), strict=False))
    tilts = np.array([pair for name, pair in pair_of_term.items() if name.startswith("tilt")])
    if tilts.size:
        tilt, sigma = (tilts.T / ARCSEC).tolist()
        record |= {"tilt_about_east_north_arcsec": tilt, "sigma_tilt_about_east_north_arcsec": sigma}
    return record


# --- several places at which a terrain model fits


def minima_section(minima: Minima | None) -> Section:
    """What starts over the terrain model's shift have found; mean and sigma are the mixture's."""
    if minima is None:
        return Section("minima")
    starts = f"{many(minima.starts, 'start')} over the terrain model's shift ({minima.lost} did not converge)"
    sentence = f"No better minimum than this one was found from {starts}."
    if minima.several:
        sentence = f"{len(minima.each)} minima from {starts}: the lowest is the solution; sigmas are of their mixture."
    table = _minima_table(minima)
    return Section("minima", sentences=[sentence], tables=[table], numbers={
        "starts": minima.starts, "not_converged": minima.lost, "number": len(minima.each),
        "shift_mean_east_north_m": minima.mean[:2], "shift_sigma_east_north_m": sigmas_of(minima.covariance)[:2],
        "each": table.records(),
    })  # fmt: skip


def _minima_table(minima: Minima) -> Table:
    """One row per minimum."""
    all_minima = minima.each
    return table_of("minima", {
        "shift_east_north": np.array([minimum.shift[:2] for minimum in all_minima]),
        "sigma_east_north": np.array([sigmas_of(minimum.spread)[:2] for minimum in all_minima]),
    }, all_minima)  # fmt: skip
