"""Weights and counts that the papers' own tables imply, and which of their numbers exclude each other.

*Weights.* At a least-squares solution the pull of all rows on a constant shift of one image along one of its axes is
that of the orientation's prior, which with the published corrections is below 1 % of either side at Gusev and Isidis,
and a tenth at most at Eos. Footprints and ties move alike under such a shift, so that

    T mean(tie residual) / (1 px)^2 = N mean(correction of footprints) / sigma^2

for T ties and N back-projected footprints in the image: ISPRS Table 3 has both means, digit by digit, and N / sigma^2
follows of each image and coordinate, whatever N was.

*Counts.* PE&RS: sigma0 is "computed from the residuals of the measurements", and "all image points and MOLA ranges are
treated as measurements", ground points and orientation as weighted parameters. So only those rows count, less all
unknowns.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import published
from numpy.typing import NDArray
from study import table

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network, PointClass

UNKNOWNS = 36
"""Coefficients of two images, second-order polynomials of six elements."""
STATED_SIGMA = 30.0
"""pixels, "approximately", of MOLA's image points in PE&RS."""
_RANGE_SQUARES = (1.5 / 10.0) ** 2
"""Of a range: "about 1 meter up to about 2 meters", with a sigma of 10 m."""


def squares(site: str, printed: dict[str, published.Scatter]) -> Array:
    """(2, 2) pixels^2, mean squares of Table 5 or of the ties' residuals: left and right, x and y."""
    mean, spread = (np.array(part) for part in printed[site])
    return np.asarray((mean**2 + spread**2).reshape(2, 2))


def information(site: str) -> Array:
    """(2, 2) pixels^-2, N / sigma^2 of the footprints in the left and right image, x and y."""
    ties, footprints = (np.array(part[site].mean) for part in (published.TIE_RESIDUALS, published.TABLE_5))
    return np.asarray(np.abs(published.TIES[site] * ties / footprints).reshape(2, 2))


def implied_sigmas(site: str, seen: Sequence[int]) -> Array:
    """(2, 2) pixels, for `seen` footprints in the left and the right image."""
    return np.sqrt(np.array(seen)[:, None] / information(site))


def shots(site: str) -> int:
    """Footprints of both profiles."""
    return sum(row.shots for row in published.TABLE_1[site])


def seen_in(network: Network) -> tuple[int, int]:
    """Back-projected footprints in the left and the right image."""
    laser = _footprint_rays(network)
    left, right = (int(np.sum(laser & (network.rays.image == j))) for j in (0, 1))
    return left, right


def _footprint_rays(network: Network) -> NDArray[np.bool_]:
    return np.asarray(network.points.classes[network.rays.point] == PointClass.LASER)


def weighed(network: Network, sigmas: Array) -> Network:
    """The network with (2, 2) pixels, sigmas of the footprints in the left and right image, line and sample; ties have
    the 1 px that is the papers' unit of weight, whatever their noise.
    """
    rays = network.rays
    mine = np.where(_footprint_rays(network)[:, None], sigmas[rays.image], 1.0)
    return replace(network, rays=replace(rays, sigmas=mine))


def sigma0_of_measurements(solution: Solution) -> float:
    """sigma0 as PE&RS counts: rows of image points and ranges alone, less all unknowns."""
    rays, ranges = solution.network.rays, solution.network.ranges
    rows = [solution.residuals / rays.sigmas, solution.range_residuals / ranges.sigmas]
    unknowns = 3 * len(solution.places) + UNKNOWNS
    freedom = sum(part.size for part in rows) - unknowns
    return float(np.sqrt(sum(float((part**2).sum()) for part in rows) / freedom))


def implied_sigma0(site: str, sigmas: Array, seen: Sequence[int], measurements: bool = True) -> float:
    """sigma0 of the published residuals with (2, 2) pixels of the footprints' sigmas, `seen` in the two images.

    With `measurements` as PE&RS counts; otherwise with the weighted parameters' rows, whose residuals are next to none.
    """
    ties, number = published.TIES[site], shots(site)
    whole = float((np.array(seen)[:, None] * squares(site, published.TABLE_5) / sigmas**2).sum())
    whole += ties * float(squares(site, published.TIE_RESIDUALS).sum()) + number * _RANGE_SQUARES
    freedom = 2 * sum(seen) + 4 * ties + number - 3 * (number + ties)
    return float(np.sqrt(whole / (freedom - UNKNOWNS if measurements else freedom + 3 * number)))


def worst_sigma0() -> float:
    """By what part sigma0 of the published residuals, with weights that balance them, departs most from Table 4."""
    found = {site: (shots(site),) * 2 for site in published.TABLE_1}
    implied = {site: implied_sigma0(site, implied_sigmas(site, seen), seen) for site, seen in found.items()}
    return max(abs(value / published.TABLE_4["PE&RS"][site].sigma0 - 1.0) for site, value in implied.items())


def tie_noise() -> float:
    """pixels, of a tie along the flight, where one row of a pair is redundant: pooled residuals of the three sites."""
    whole = sum(ties * float(squares(site, published.TIE_RESIDUALS).sum()) for site, ties in published.TIES.items())
    return float(np.sqrt(whole / sum(published.TIES.values())))


# --- tables


def balance_table(networks: dict[str, Network]) -> list[str]:
    """What the balance gives for each site, and which sigma0 follows from the published residuals."""
    rows = []
    for site, network in networks.items():
        seen, whole = seen_in(network), (shots(site),) * 2
        stated, implied = np.full((2, 2), STATED_SIGMA), [implied_sigmas(site, each) for each in (seen, whole)]
        rows.append((
            site, " ".join(map(str, seen)), " ".join(f"{value:.2f}" for value in (information(site) ** -0.5).ravel()),
            *(" ".join(f"{value:.0f}" for value in each.ravel()) for each in implied),
            f"{implied_sigma0(site, implied[0], seen):.3f}", f"{implied_sigma0(site, implied[1], whole):.3f}",
            f"{implied_sigma0(site, implied[1], whole, measurements=False):.3f}",
            f"{implied_sigma0(site, stated, whole):.3f}",
            f"{implied_sigma0(site, stated, whole, measurements=False):.3f}",
            f"{published.TABLE_4['PE&RS'][site].sigma0:.3f}",
        ))  # fmt: skip
    head = (
        "site", "footprints inside, left right", "sigma / sqrt(N) (px): left x y, right x y",
        "sigma (px), footprints inside the images", "sigma (px), all in both", "sigma0, inside", "all in both",
        "all in both, all rows", "30 px", "30 px, all rows", "published",
    )  # fmt: skip
    return table(head, rows)


def contradictions(ties_with_one_sigma: Sequence[float], shares: dict[str, list[list[float]]]) -> list[str]:
    """Published numbers that exclude each other: where, what follows, what is published, how far apart.

    `ties_with_one_sigma`: Table 4 over Eos' tie sigmas with x's sigmas in y, empty without Eos; `shares`: of each site,
    the part of the corrections along the flight (Table 5) that positions take (Table 2), left, right; then simulated.
    """
    rows = []
    for site in published.TABLE_1:
        wanted = published.TABLE_4["PE&RS"][site].sigma0
        whole = (shots(site),) * 2
        stated = implied_sigma0(site, np.full((2, 2), STATED_SIGMA), whole)
        all_rows = implied_sigma0(site, implied_sigmas(site, whole), whole, measurements=False)
        rows += [
            (site, "30 px for MOLA's image points (PE&RS text), residuals of Table 5 and ISPRS Table 3",
             f"sigma0 {stated:.2f}", f"{wanted}", _times(stated, wanted)),
            (site, "the same residuals with the weights that balance them, weighted parameters counted as rows",
             f"sigma0 {all_rows:.2f}", f"{wanted}", _times(all_rows, wanted)),
        ]  # fmt: skip
        sizes, ties = published.TABLE_1[site], published.TIE_RESIDUALS[site].mean
        expected, found = sizes[0].pixel_m / sizes[1].pixel_m, abs(ties[0] / ties[2])
        rows.append((
            site, "pixel sizes of Table 1: ratio of the ties' mean residuals in x, left to right (each tie's own "
            "ground point sees to it)", f"{expected:.2f}", f"{found:.2f}", _times(found, expected),
        ))  # fmt: skip
    needed = published.TABLE_5["eos"].mean[3] * information("eos")[1, 0] / published.TIES["eos"]
    tie = abs(published.TIE_RESIDUALS["eos"].mean[3])
    rows.append((
        "eos", "corrections of 47.1 px in y of the right image (Table 5) with the weight of x: mean residual of ties "
        "in y",
        f"{needed:.3f} px", f"{tie:.3f} px", _times(needed, tie),
    ))  # fmt: skip
    if ties_with_one_sigma:
        rows.append((
            "eos", "one sigma for line and sample (text): tie sigmas X Y Z of Table 4 are larger",
            "1", " ".join(f"{value:.2f}" for value in ties_with_one_sigma) + " times",
            f"{max(ties_with_one_sigma):.2f}",
        ))  # fmt: skip
    spread = published.TABLE_2["eos"][1].spread
    moved, turned = float(np.linalg.norm(spread[:3])), _TILT * spread[3] + spread[4]
    least = (moved - _RANGE_M * turned * np.pi / 648000.0) / published.TABLE_1["eos"][1].pixel_m
    x = abs(published.TABLE_5["eos"].spread[2])
    rows.append((
        "eos", f"Table 2, right: the position varies by {moved:.0f} m RMSE along the flight, and omega and phi by at "
        f"most {turned:.0f}\" across the ray: image corrections in x vary", f"{least:.0f} px or more", f"{x:.1f} px",
        _times(least, x),
    ))  # fmt: skip
    rows.append(("eos", "Table 5, right: a root mean square", "positive", f"{-x} px", ""))
    for site, (theirs, simulated) in shares.items():
        each = [" and ".join(f"{100.0 * value:.0f}" for value in part) for part in (simulated, theirs)]
        rows.append((
            site, "sigmas of pointing that match those of position (text): share of positions in the corrections along "
            "the flight, left and right", f"{each[0]} %", f"{each[1]} %",
            f"{max(max(a / b, b / a) for a, b in zip(theirs, simulated, strict=True)):.2f}",
        ))  # fmt: skip
    for site in ("gusev", "isidis"):
        left, right = published.TABLE_1[site]
        mean = published.TABLE_5[site].mean
        shift = abs(mean[0] * left.pixel_m - mean[2] * right.pixel_m)
        rows.append((
            site, "corrections of Table 5 along the flight, times the pixel sizes of Table 1: shift between images",
            f"{shift:.0f} m", f"{published.STATED_SHIFT_M:.0f} m", _times(shift, published.STATED_SHIFT_M),
        ))  # fmt: skip
    most, isprs = 10.0 * published.TABLE_4["ISPRS"]["isidis"].sigma0, published.TABLE_4["ISPRS"]["isidis"].mola[2]
    rows.append((
        "isidis", "a priori 10 m for each coordinate of a footprint: its sigma in ISPRS Table 4 (PE&RS has 9.85 m)",
        f"at most {most:.1f} m", f"{isprs:.1f} m", _times(isprs, most),
    ))  # fmt: skip
    return table(("site", "what is stated", "what follows", "what is published", "factor"), rows)


_TILT = 0.2425
"""cos(phi) of Eos' right image: how much of a turn about the first axis is across the ray; the rest is yaw."""
_RANGE_M = 405e3
"""m, from Eos' right camera to the ground."""


def _times(found: float, wanted: float) -> str:
    return f"{max(found / wanted, wanted / found):.2f}"
