"""A solution in words: what came out, what it is worth, and what to look at; and as a short table for the terminal."""

import math
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.group_fits import ODDS, group_fits
from mgsgraph.analysis.group_medians import worst_first
from mgsgraph.analysis.statistics import (
    PLACES,
    RayStatistics,
    laser_gain,
    point_statistics,
    range_statistics,
    ray_statistics,
    solution_connectivity,
    used_ray_counts,
)
from mgsgraph.files.tie_points import PointKind
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Network, PointClass
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.network.connectivity_words import connectivity_statements
from mgsgraph.results.control import control_statements
from mgsgraph.results.drivers import drivers_statements
from mgsgraph.results.group_fits import group_fits_table, weight_unit
from mgsgraph.results.input_remarks import range_statements, reading_statements
from mgsgraph.results.likelihood import linearity_statements
from mgsgraph.results.minima import minima_statements
from mgsgraph.results.passes import passes_statements, passes_table
from mgsgraph.results.shared import IN_TEXT, shared_statements, shared_table
from mgsgraph.results.soundness import soundness_statements, state_of
from mgsgraph.results.tables import classes_table, images_table
from mgsgraph.text import NAMED, listed, many, short, some_of, span, three
from mgsgraph.units import MRAD

_PIXELS = 0.5
"""Size of a mean residual below which it does no harm."""
_FEW_RAYS = 8
"""Fewer rays don't show how they scatter."""
_ROWS = 24
"""Images, and passes, listed in the table."""
_ALIKE = 1.05
"""Ratio up to which two sigmas count as the same."""


def statements(solution: Solution, connected: Connectivity | None = None) -> list[str]:
    """Sentences with figures and units, for reports and the terminal; `connected` saves finding it anew."""
    rays = ray_statistics(solution)
    return [
        *_ending(solution),
        *soundness_statements(solution),
        *drivers_statements(solution),
        *weight_unit(solution),
        *_strained(solution),
        *linearity_statements(solution.linearity),
        *minima_statements(solution.minima),
        *_fits(solution, rays),
        *_datum(solution),
        *control_statements(solution),
        *shared_statements(solution),
        *passes_statements(solution),
        *_constant_residuals(solution, rays),
        *_left_out(solution),
        *reading_statements(solution.network.images),
        *connectivity_statements(connected or solution_connectivity(solution)),
    ]


def _ending(solution: Solution) -> list[str]:
    steps = many(solution.iterations, "iteration")
    cost = f"the cost went from {solution.cost_initial:.4g} to {solution.cost_final:.4g}"
    if solution.converged:
        return [f"{solution.message} It took {steps}; {cost}."]
    return [
        f"NOT CONVERGED after {steps}; {cost}. {solution.message}",
        "Nothing below is a result: the figures describe the state at which it stopped. Look at the largest residuals "
        "in the table of residuals for blunders, and at the a-priori sigmas; then adjust again.",
    ]


def _strained(solution: Solution) -> list[str]:
    """Orientations that were moved too far, and ranges that no orbit within its sigmas explains."""
    net, found = solution.network, solution.strained
    ranges = range_statements(net, solution.range_residuals_before)
    said = [f"With the nominal orientation {sentence}." for sentence in ranges]
    if not found or (solution.converged and found[0].impossible):  # of which `soundness_statements` speaks
        return said
    names = some_of([net.images[one.image].name for one in found], np.arange(len(found)))
    return [
        *said,
        f"Moved by up to {found[0].most:.2g} of their a-priori sigmas are the orientations of {names}: an input is "
        "wrong (ranges, images or columns interchanged, a focal length, control), or these sigmas are too small; "
        "either way none of the quoted sigmas holds. Look at the inputs with `mgsgraph check` before making these "
        "sigmas larger, which hides what is wrong. `analyze` tests it.",
    ]


def _fits(solution: Solution, rays: RayStatistics) -> list[str]:
    """Residuals of each class of rays, and of the ranges."""
    found = []
    for point_class in PointClass:
        count = int(rays.count[:, point_class].sum())
        if count:
            line, sample = rays.rms_of_classes[point_class]
            found.append(
                f"{point_class.name.capitalize()} points fit to {line:.2g} lines and {sample:.2g} samples "
                f"(rms of {many(count, 'ray')})."
            )
    ranges = range_statistics(solution)
    if ranges.used:
        found.append(
            f"Laser ranges fit to {ranges.rms:.2g} m (rms of {ranges.used}, mean {ranges.mean:+.2g} m); with the "
            f"nominal orientation to {ranges.rms_before:.2g} m (mean {ranges.mean_before:+.2g} m)."
        )
    return found


# --- what holds the block


def _datum(solution: Solution) -> list[str]:
    """What the laser gives; or, where nothing is known of the ground, what the sigmas rest on."""
    network, kinds = solution.network, solution.network.points.kinds
    if solution.sigmas_without_laser is not None:
        return [_laser_effect(solution, solution.sigmas_without_laser)]
    known = np.any(solution.determined & (kinds != PointKind.FREE)) or np.any(solution.ranges_used)
    if known or network.surface is not None:
        return []
    constant = _constant_sigmas(network)
    if constant.size == 0:
        return ["Every image is held: the points have the sigmas of their rays alone, as if the orientation were true."]
    held = int(network.held.sum())
    also = f" and {many(held, 'held image')}" if held else ""
    return [
        f"No laser rows and no ground control: only the orientation priors{also} hold the block on the ground. The "
        f"constant terms' sigmas are {span(constant[:, :3])} m in position and {span(constant[:, 3:] / MRAD)} mrad "
        "in rotation, and the sigmas of the ground points mostly repeat them."
    ]


def _constant_sigmas(network: Network) -> Array:
    """(n, 6) m and rad, a-priori sigmas of the constant terms of images, and of passes in their middle."""
    own = [network.priors[j].sigmas[0] for j in np.flatnonzero(network.with_polynomial)]
    return np.array(own + [one.prior.node_sigmas(np.zeros(len(one.nodes)))[0] for one in network.passes])


def _laser_effect(solution: Solution, without: Array) -> str:
    network, gain = solution.network, laser_gain(solution)
    laser = network.points.classes == PointClass.LASER
    rays = int(np.sum(solution.rays_used & laser[network.rays.point]))
    ranges = many(int(solution.ranges_used.sum()), "range")
    rows = f"{many(int(laser.sum()), 'point')}, {many(rays, 'ray')}, {ranges}"
    found, median = point_statistics(solution, PointClass.TIE), solution.median_sigmas_without_laser
    which, sigmas = ("mean", found.mean_sigma) if median is None else ("median", found.median_sigma)
    with_units = f"{three(without if median is None else median)} m in x, y, z instead of {three(sigmas)} m"
    weak = ""
    if found.weak and median is not None:
        weak = (
            f" {many(found.weak, 'tie point')} with more than ten times the median sigma (nearly parallel rays) are "
            f"beside that: mean sigmas are {three(found.mean_sigma)} m, and would be {three(without)} m."
        )
    if gain < _ALIKE:
        head = f"The laser rows ({rows}) add little: without them the tie points' {which} sigmas would be {with_units}."
        return head + weak
    head = f"Without the laser rows ({rows}) the tie points' {which} sigmas would be {with_units}"
    return f"{head}: about {gain:.2g} times larger.{weak}"


# --- what to look at


def _constant_residuals(solution: Solution, rays: RayStatistics) -> list[str]:
    """Mean residuals of a class in an image that are too large for noise: its coordinates contradict the rest."""
    names = [image.name for image in solution.network.images]
    enough = rays.count >= _FEW_RAYS
    size, noise = np.abs(np.nan_to_num(rays.mean)), np.nan_to_num(rays.standard_errors)
    limit = _limit(2 * int(enough.sum()))
    marked = enough[:, :, None] & (size > limit * noise) & (size > _PIXELS)
    found = []
    for point_class in PointClass:
        parts = [
            _means(rays.mean[:, point_class, c], marked[:, point_class, c], names, unit)
            for c, unit in enumerate(("lines", "samples"))
        ]
        if any(parts):
            found.append(
                f"{point_class.name.capitalize()} image points keep a constant residual of "
                f"{' and '.join(part for part in parts if part)}. That is no noise but a systematic disagreement "
                "between their stored image coordinates and the ranges, ground places or ties; no sigma here covers it."
            )
    return found


def _limit(trials: int) -> float:
    """Standard deviations that noise exceeds once in 1 / ODDS solutions with so many trials each."""
    return NormalDist().inv_cdf(1.0 - 0.5 * ODDS / max(trials, 1))


def _means(means: Array, marked: np.ndarray, names: list[str], unit: str) -> str:
    """Words for the marked mean residuals of one component, the largest few; empty where none is marked."""
    chosen: Index = np.flatnonzero(marked)
    if chosen.size == 0:
        return ""
    worst = np.sort(chosen[np.argsort(-np.abs(means[chosen]), kind="stable")][:NAMED])
    parts = [f"{means[j]:+.1f}{f' {unit}' if k == 0 else ''} in {names[j]}" for k, j in enumerate(worst)]
    more = f" (and in {many(chosen.size - NAMED, 'more image')})" if chosen.size > NAMED else ""
    opposite = ", of opposite sign" if means[chosen].min() < 0.0 < means[chosen].max() else ""
    return listed(parts) + more + opposite


def _left_out(solution: Solution) -> list[str]:
    network, found = solution.network, []
    lost = np.flatnonzero(~solution.determined)
    if lost.size:
        found.append(
            f"{many(lost.size, 'point')} of {len(network.points)} stayed out, because nothing determines a place "
            "(fewer than two rays, or rays that hardly converge): "
            f"{some_of(network.points.ids, lost)}."
        )
    rays = int(np.sum(~solution.rays_used & solution.determined[network.rays.point]))
    ranges = int(np.sum(~solution.ranges_used & solution.determined[network.ranges.point]))
    heights = 0 if solution.stereo_rejected is None else int(np.sum(solution.stereo_rejected & solution.determined))
    if rays or ranges or heights:
        also = f" and {many(heights, 'height')} above stereo surfaces" if heights else ""
        found.append(
            f"{many(rays, 'ray')} of {network.rays.point.size} and {many(ranges, 'range')} of "
            f"{network.ranges.point.size}{also} were rejected as blunders; the table of residuals marks them."
        )
    if solution.test_dimensions is not None:
        found += _unchecked(solution.test_dimensions[: network.rays.point.size][solution.rays_used])
    bare = np.flatnonzero(solution.determined & (network.ray_counts > 0) & (used_ray_counts(solution) == 0))
    if bare.size:
        found.append(
            f"{many(bare.size, 'point')} lost all rays to that: {some_of(network.points.ids, bare)}."
        )
    return found


def _unchecked(dimensions: NDArray[np.int8]) -> list[str]:
    """Of rays that took part, whose blunder tests have so many degrees of freedom, those that little checks."""
    partly, nothing = int(np.sum(dimensions == 1)), int(np.sum(dimensions == 0))
    if not partly + nothing:
        return []
    of_none = f", and {many(nothing, 'ray')} not at all" if nothing else ""
    return [
        f"Of the {dimensions.size} rays that took part, others check {partly} in one direction only (in most cases "
        f"across the epipolar line){of_none}. There a blunder goes unnoticed."
    ]


# --- the table


def summary_table(solution: Solution) -> str:
    """Images, points, ranges and sigma0 as aligned text of at most 110 columns."""
    there = np.array([point_class for point_class, _ in solution.network.of_class()], dtype=np.int64)
    order, every = images_table(solution), len(solution.network.images)
    chosen = ""
    if every > _ROWS:
        order = order.take(worst_first(solution)[:_ROWS])
        chosen = f"  (of {every} images the {_ROWS} with the largest median residual over its sigma, largest first)"
    images = [*order.text(indent=2), *([chosen] if chosen else [])]
    points = classes_table(solution).take(there).text(indent=2)
    sections = [
        _head(solution),
        "\n".join([*images, f"  (residuals: rms; corrections: means over {PLACES} lines)"]),
        "\n".join([*points, "  (sigmas for sigma0 = 1)"]),
        _range_lines(solution),
        "\n".join(group_fits_table(group_fits(solution)).text(indent=2)),
    ]
    if solution.network.passes:
        passes = passes_table(solution).text(_ROWS, "more pass: see solution.json", indent=2)
        sections.append("\n".join([*passes, "  (sigmas for sigma0 = 1; every node: passes.csv)"]))
    if solution.network.shared:
        sections.append("\n".join(shared_table(solution).pick(*IN_TEXT).text(indent=2)))
    seconds = ", ".join(f"{stage} {time:.2f}" for stage, time in solution.seconds.items())
    return "\n\n".join([section for section in sections if section] + [f"Seconds: {seconds}"])


def _head(solution: Solution) -> str:
    fit, state = solution.fit, state_of(solution)
    sigma0 = "not defined" if math.isnan(fit.sigma0) else f"{fit.sigma0:.4g}"
    return (
        f"{short(solution.name, 60)}: {state}, {many(solution.iterations, 'iteration')}\n"
        f"  sigma0 {sigma0}; {fit.observations} observations, {fit.unknowns} unknowns, "
        f"{fit.degrees_of_freedom} degrees of freedom\n"
        f"  cost {solution.cost_initial:.6g} -> {solution.cost_final:.6g}"
    )


def _range_lines(solution: Solution) -> str:
    found = range_statistics(solution)
    if found.used == 0:
        return f"Ranges: {found.count}, used 0" if found.count else ""
    return (
        f"Ranges: {found.count}, used {found.used}; residual [m]: mean {found.mean:.3g}, rms {found.rms:.3g}; "
        f"before: mean {found.mean_before:.3g}, rms {found.rms_before:.3g}"
    )
