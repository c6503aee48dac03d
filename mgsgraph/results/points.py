"""Ground points and laser ranges of a solution: how well they are known, what the laser gives, what was left out."""

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import laser_gain, point_statistics, range_statistics, used_ray_counts
from mgsgraph.files.output.table import Column, Table
from mgsgraph.files.tie_points import PointKind
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network, PointClass
from mgsgraph.results.section import Section
from mgsgraph.text import many, some_of, span, three
from mgsgraph.units import MRAD

_SAME = 1.05
"""Ratio up to which two sigmas count as the same."""


def points_section(solution: Solution) -> Section:
    """Points by class, and what was left out."""
    table = classes_table(solution)
    there = [point_class for point_class, _ in solution.network.of_class()]
    record = {row.pop("kind"): row for row in table.records()}
    shown = table.take(np.array(there, dtype=np.int64))
    return Section("points", sentences=_left_out(solution), tables=[shown], numbers=record)


def classes_table(solution: Solution) -> Table:
    """One row per class of points (`Network.classes`): how many, how well they are known, how far they moved."""
    found = [point_statistics(solution, c) for c in solution.network.classes]
    sigma, median, high, mean, rms = (
        np.array([getattr(one, name) for one in found])
        for name in ("mean_sigma", "median_sigma", "high_sigma", "mean_correction", "rms_correction")
    )
    axes, capital = ("x", "y", "z"), "XYZ"
    return Table("classes", "Ground points by kind (sigmas for sigma0 = 1)", (
        Column("kind", [c.name.lower() for c in solution.network.classes], page="s", text="<10"),
        Column("count", np.array([one.count for one in found]), head="points", page="s", label="count", text=">8"),
        Column("rejected", np.array([one.rejected for one in found]), page="s", text=">9"),
        Column("weak", np.array([one.weak for one in found]), meaning="sigma over ten times the median: parallel rays",
               page="s", text=">5"),
        Column("median_sigma_{}", median, "m", "for sigma0 = 1, body-fixed", axes,
               tuple(f"median σ {a}" for a in capital), ".2f", "median sigma [m]", ">9", gap=2),
        Column("high_sigma_{}", high, "m", "95 % of the points have this at most", axes,
               tuple(f"95 % σ {a}" for a in capital), ".2f"),
        Column("mean_sigma_{}", sigma, "m", "the mean, which weak points dominate", axes,
               tuple(f"mean σ {a}" for a in capital), ".2f"),
        Column("scaled_sigma_{}", median * solution.sigma0, "m", "median, times sigma0", axes,
               tuple(f"σ {a} × σ₀" for a in capital), ".2f", files=False),
        Column("mean_correction_{}", mean, "m", "adjusted minus before", axes),
        Column("rms_correction_{}", rms, "m", "the same", axes, tuple(f"rms Δ{a}" for a in capital), ".2f",
               "rms correction [m]", ">9", gap=2),
    ), "Body-fixed axes. Sigmas for sigma0 = 1; the median, also times sigma0, is not moved by weak points. "
       "Corrections are adjusted minus before.",
    )  # fmt: skip


def _left_out(solution: Solution) -> list[str]:
    """Points, rays, ranges and heights that took no part."""
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


def ranges_section(solution: Solution) -> Section:
    """How laser ranges fit, with the nominal orientation and with the adjusted one."""
    found = range_statistics(solution)
    record = {
        "count": found.count, "used": found.used, "mean_residual_m": found.mean, "rms_residual_m": found.rms,
        "mean_residual_before_m": found.mean_before, "rms_residual_before_m": found.rms_before,
    }  # fmt: skip
    if not found.count:
        return Section("ranges", numbers=record)
    table = Table("ranges", "Laser ranges", (
        Column("orientation", ["before", "after"], page="s", text="<26"),
        Column("ranges", np.full(2, found.count), page="s", text=">6"),
        Column("used", np.full(2, found.used), page="s", text=">6"),
        Column("mean residual", np.array([found.mean_before, found.mean]), "m", page=".2f", text=">15.3g"),
        Column("rms residual", np.array([found.rms_before, found.rms]), "m", page=".2f", text=">15.3g"),
    ), "Measured minus predicted.")  # fmt: skip
    return Section("ranges", tables=[table], numbers=record)


def laser_section(solution: Solution) -> Section:
    """What the laser gives; or, where nothing is known of the ground, what the sigmas rest on."""
    without = solution.sigmas_without_laser
    if without is None:
        return Section("laser_effect", sentences=_held_by(solution))
    found, gain = point_statistics(solution, PointClass.TIE), laser_gain(solution)
    median = solution.median_sigmas_without_laser
    network, laser = solution.network, solution.network.points.classes == PointClass.LASER
    rays = int(np.sum(solution.rays_used & laser[network.rays.point]))
    ranges = many(int(solution.ranges_used.sum()), "range")
    rows = f"{many(int(laser.sum()), 'point')}, {many(rays, 'ray')}, {ranges}"
    which, sigmas = ("mean", found.mean_sigma) if median is None else ("median", found.median_sigma)
    said = (
        f"Without the laser rows ({rows}) the tie points' {which} sigmas would be "
        f"{three(without if median is None else median)} m in x, y, z instead of {three(sigmas)} m: "
        + ("they add little." if gain < _SAME else f"about {gain:.2g} times larger.")
    )
    if found.weak and median is not None:
        said += (
            f" {many(found.weak, 'tie point')} with more than ten times the median sigma (nearly parallel rays) are "
            f"beside that: mean sigmas are {three(found.mean_sigma)} m, and would be {three(without)} m."
        )
    return Section("laser_effect", sentences=[said], numbers={
        "tie_mean_sigma_m": found.mean_sigma,
        "tie_mean_sigma_without_laser_m": without,
        "ratio": without / found.mean_sigma,
        "tie_median_sigma_m": found.median_sigma,
        "tie_median_sigma_without_laser_m": median,
        "ratio_overall": gain,
    })  # fmt: skip


def _held_by(solution: Solution) -> list[str]:
    """What holds the block on the ground where nothing is known of it."""
    network = solution.network
    known = np.any(solution.determined & (network.points.kinds != PointKind.FREE)) or np.any(solution.ranges_used)
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
