"""What the papers print (published/papers.toml), and weights and counts that their own tables imply.

*Weights.* At a least-squares solution the pull of all rows on a constant shift of one image along one of its axes is
that of the orientation's prior, which with the published corrections is below 1 % of either side at Gusev and Isidis,
and a tenth at most at Eos. Footprints and ties move equally under such a shift, so that

    T mean(tie residual) / (1 px)^2 = N mean(correction of footprints) / sigma^2

for T ties and N back-projected footprints in the image: ISPRS Table 3 has both means, digit by digit, and N / sigma^2
follows of each image and coordinate, whatever N was.

*Counts.* PE&RS: sigma0 is "computed from the residuals of the measurements", and "all image points and MOLA ranges are
treated as measurements", ground points and orientation as weighted parameters. So only those rows count, less all
unknowns.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from study import table

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network, PointClass


class Scatter(NamedTuple):
    """Mean and RMSE, as the papers print them."""

    mean: tuple[float, ...]
    spread: tuple[float, ...]


class Sigmas(NamedTuple):
    """Table 4: m in X, Y, Z; pixels."""

    mola: tuple[float, ...]
    tie: tuple[float, ...]
    sigma0: float


class ImageRow(NamedTuple):
    """PE&RS Table 1, one image."""

    emission_deg: float
    exposure_ms: float
    lines: int
    samples: int
    pixel_m: float
    shots: int
    spacing_m: float


class Published(NamedTuple):
    """Published values of a site; their file names the tables."""

    ties: int
    base_to_height: float
    images: tuple[ImageRow, ...]
    orientation: tuple[Scatter, ...]
    mola_pixels: Scatter
    tie_residuals: Scatter
    mola_corrections: Scatter
    tie_corrections: dict[str, Scatter]
    """By paper."""
    sigmas: dict[str, Sigmas]


PAPERS = tomllib.loads((Path(__file__).parent / "published" / "papers.toml").read_text(encoding="utf-8"))


def published(site: dict[str, Any]) -> Published:
    """A site of the file."""
    papers = {name: site[name] for name in ("PE&RS", "ISPRS")}
    scatters = (Scatter(*site[name]) for name in ("mola_pixels", "tie_residuals", "mola_corrections"))
    return Published(
        site["ties"], site["base_to_height"], tuple(ImageRow(*row) for row in site["images"]),
        tuple(Scatter(*pair) for pair in site["orientation"]), *scatters,
        {name: Scatter(*paper["tie_corrections"]) for name, paper in papers.items()},
        {name: Sigmas(**paper["sigmas"]) for name, paper in papers.items()},
    )  # fmt: skip


PUBLISHED = {name: published(site) for name, site in PAPERS["sites"].items()}
UNKNOWNS = 36
"""Coefficients of two images, second-order polynomials of six elements."""
STATED_SIGMA = 30.0
"""pixels, "approximately", of MOLA's image points in PE&RS."""
_RANGE_SQUARES = (1.5 / 10.0) ** 2
"""Of a range: "about 1 meter up to about 2 meters", with a sigma of 10 m."""


def squares(printed: Scatter) -> Array:
    """(2, 2) pixels^2, mean squares of Table 5 or of the ties' residuals: left and right, x and y."""
    mean, spread = (np.array(part) for part in printed)
    return np.asarray((mean**2 + spread**2).reshape(2, 2))


def information(site: str) -> Array:
    """(2, 2) pixels^-2, N / sigma^2 of the footprints in the left and right image, x and y."""
    row = PUBLISHED[site]
    return np.abs(row.ties * np.array(row.tie_residuals.mean) / np.array(row.mola_pixels.mean)).reshape(2, 2)


def implied_sigmas(site: str, counts: Sequence[int]) -> Array:
    """(2, 2) pixels, for `counts` footprints in the left and the right image."""
    return np.sqrt(np.array(counts)[:, None] / information(site))


def shots(site: str) -> int:
    """Footprints of both profiles."""
    return sum(row.shots for row in PUBLISHED[site].images)


def counts_in(network: Network) -> tuple[int, int]:
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
    ray_sigmas = np.where(_footprint_rays(network)[:, None], sigmas[rays.image], 1.0)
    return replace(network, rays=replace(rays, sigmas=ray_sigmas))


def sigma0_of_measurements(solution: Solution) -> float:
    """sigma0 as PE&RS counts: rows of image points and ranges alone, less all unknowns."""
    rays, ranges = solution.network.rays, solution.network.ranges
    rows = [solution.residuals / rays.sigmas, solution.range_residuals / ranges.sigmas]
    unknowns = 3 * len(solution.places) + UNKNOWNS
    freedom = sum(part.size for part in rows) - unknowns
    return float(np.sqrt(sum(float((part**2).sum()) for part in rows) / freedom))


def implied_sigma0(site: str, sigmas: Array, counts: Sequence[int], measurements: bool = True) -> float:
    """sigma0 of the published residuals with (2, 2) pixels of the footprints' sigmas, `counts` in the two images.

    With `measurements` as PE&RS counts; otherwise with the weighted parameters' rows, whose residuals are next to none.
    """
    row, ties, number = PUBLISHED[site], PUBLISHED[site].ties, shots(site)
    total = float((np.array(counts)[:, None] * squares(row.mola_pixels) / sigmas**2).sum())
    total += ties * float(squares(row.tie_residuals).sum()) + number * _RANGE_SQUARES
    freedom = 2 * sum(counts) + 4 * ties + number - 3 * (number + ties)
    return float(np.sqrt(total / (freedom - UNKNOWNS if measurements else freedom + 3 * number)))


def tie_noise() -> float:
    """pixels, of a tie along the flight, where one row of a pair is redundant: pooled residuals of the three sites."""
    total = sum(site.ties * float(squares(site.tie_residuals).sum()) for site in PUBLISHED.values())
    return float(np.sqrt(total / sum(site.ties for site in PUBLISHED.values())))


# --- tables


def balance_table(networks: dict[str, Network]) -> list[str]:
    """Results of the balance for each site, and sigma0 from the published residuals."""
    rows = []
    for site, network in networks.items():
        counts, all_shots = counts_in(network), (shots(site),) * 2
        stated, implied = np.full((2, 2), STATED_SIGMA), [implied_sigmas(site, n) for n in (counts, all_shots)]
        rows.append((
            site, " ".join(map(str, counts)), " ".join(f"{value:.2f}" for value in (information(site) ** -0.5).ravel()),
            *(" ".join(f"{value:.0f}" for value in sigmas.ravel()) for sigmas in implied),
            f"{implied_sigma0(site, implied[0], counts):.3f}", f"{implied_sigma0(site, implied[1], all_shots):.3f}",
            f"{implied_sigma0(site, implied[1], all_shots, measurements=False):.3f}",
            f"{implied_sigma0(site, stated, all_shots):.3f}",
            f"{implied_sigma0(site, stated, all_shots, measurements=False):.3f}",
            f"{PUBLISHED[site].sigmas['PE&RS'].sigma0:.3f}",
        ))  # fmt: skip
    head = (
        "site", "footprints inside, left right", "sigma / sqrt(N) (px): left x y, right x y",
        "sigma (px), footprints inside the images", "sigma (px), all in both", "sigma0, inside", "all in both",
        "all in both, all rows", "30 px", "30 px, all rows", "published",
    )  # fmt: skip
    return table(head, rows)
