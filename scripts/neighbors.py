"""Are the stated sigmas right where neighbors have errors in common? NEES of three sites and a strip.

Each draw has the errors of overlapping windows, and of heights above a terrain model with gaps between its tracks: as
the network's groups of neighbors state them (model), or from the exact covariance, that of moving averages (exact).
Fills the tables of docs/evidence_consistency.md.

    python scripts/neighbors.py [--seeds 50] [--first 1] [--cases gusev ...] [--processes N] [--out FILE]

Exit status: 0 done (whatever the figures are), 2 bad input.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from nees import STRIP, nees, prepared
from scipy.spatial import cKDTree
from study import Blocks, Draw, cases, names_of, nees_cell, number, run, seeds_of, table

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.terrain import Gaps
from mgsgraph.network import Network, PointClass
from mgsgraph.network.common import SPHERE, common_heights, common_matches, correlation
from mgsgraph.simulation.sites import SITE_NAMES

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from block_ground import TerrainErrors
from mex_block import simulate_hrsc_block
from redraw import common_noise, redraw

CASES = tuple(f"{name}, {drawn}" for name in (*SITE_NAMES, "HRSC strip") for drawn in ("model", "exact"))
STATED = ("ties", "heights", "means of 30", "squares")
FORMS = ("groups", "independent")
"""How a network states common errors of neighbors: by groups; by larger sigmas of independent rows."""
_GAP = 20.0
"""m, sigma of the heights between two tracks."""
_MEANS = 3
"""Means of each draw."""


class Correlated(NamedTuple):
    """A network whose measurements have some three neighbors within their windows, and its heights as many in a gap."""

    network: Network
    """With groups of neighbors."""
    settings: SolverSettings
    """Of its adjustment."""
    rays: list[tuple[Index, Array]]
    """Rays of each image, and a root of the exact covariance of their errors in whole sigmas."""
    heights: tuple[Index, Array]
    """The same of points with heights above the terrain model, m."""

    def exact(self, network: Network, rng: np.random.Generator, columns: int) -> Array:
        """Errors of moving averages over windows, and of heights by the exact covariance (`redraw.Noise`)."""
        noise = common_noise(replace(network, common_rays=None, common_heights=None), rng, columns)
        for rows, root in self.rays if columns == 2 else ():
            noise[rows] = root @ rng.standard_normal((rows.size, 2)) * network.ray_sigmas[rows]
        if columns == 1:
            rows, root = self.heights
            noise[rows, 0] = root @ rng.standard_normal(rows.size)
        return noise


@lru_cache(maxsize=len(CASES))
def correlated(name: str) -> Correlated:
    """The network of a site or of the strip."""
    if name == "HRSC strip":
        network, settings = simulate_hrsc_block(replace(STRIP, terrain=TerrainErrors()), 1).network, SolverSettings()
    else:
        network, settings = prepared(f"{name}, rigorous")
    network, places = network.independent, redraw(network, np.random.default_rng(0), settings.angles).places
    ties = network.points.classes[network.rays.point] == PointClass.TIE
    by_image = [np.flatnonzero(ties & (network.rays.image == j)) for j in np.unique(network.rays.image[ties])]
    side = 2.0 * float(np.median(np.concatenate([_nearest(network.rays.places[rows], np.inf) for rows in by_image])))
    rays, common = common_matches(network.rays, np.where(ties, side, 0.0), np.ones(ties.size))
    windows = np.ones(ties.size), np.full(ties.size, side)
    roots = [(rows, _root(network.rays.places, [windows], rows)) for rows in by_image]
    surface = network.surface
    assert surface is not None
    on = np.flatnonzero(np.isfinite(surface.sigmas))
    shape, reach = surface.grid.radii.shape, float(np.median(_nearest(places[on], 2)))
    grid = replace(surface.grid, gaps=Gaps(np.full(shape, _GAP), np.full(shape, reach)))
    sigmas = np.where(np.isfinite(surface.sigmas), grid.height_sigmas(places), np.inf)
    parts = [(sigma / sigmas, SPHERE * distance) for sigma, distance in grid.parts_of_sigmas(places)]
    of_heights = sigmas[on][:, None] * _root(places, parts, on)
    surface, heights = common_heights(replace(surface, grid=grid, sigmas=sigmas), places)
    network = replace(network, rays=rays, surface=surface, common_rays=common, common_heights=heights)
    return Correlated(network, settings, roots, (on, of_heights))


def _nearest(places: Array, norm: float) -> Array:
    """(n,) distance of each place to the nearest other one."""
    return np.asarray(cKDTree(places).query(places, 2, p=norm)[0][:, 1])


def _root(places: Array, parts: Sequence[tuple[Array, Array]], rows: Index) -> Array:
    """Root of the correlation of some rows."""
    values, vectors = np.linalg.eigh(correlation(places, parts, rows[:, None], rows))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def one_draw(case: str, seed: int) -> Draw:
    """Normalized errors of one draw, as each form states them."""
    name, drawn = case.split(", ")
    prepared_case = correlated(name)
    network, noise = prepared_case.network, prepared_case.exact if drawn == "exact" else common_noise
    draw = redraw(network, np.random.default_rng(seed), prepared_case.settings.angles, noise=noise)
    begin, values = time.perf_counter(), dict[str, list[float]]()
    for form, stated in zip(FORMS, (draw.network, draw.network.independent), strict=True):
        solution = adjust_network(stated, prepared_case.settings)
        values[form] = [*_of_points(solution, draw.places), solution.fit.squares / solution.fit.degrees_of_freedom]
    return {"values": values, "groups": sum(group.widths.size for group, _, _ in network.common),
            "seconds": time.perf_counter() - begin}  # fmt: skip


def _of_points(solution: Solution, truth: Array) -> list[float]:
    """Mean NEES per degree of freedom of tie points, of their heights, and of means over neighbors."""
    ties = solution.members(PointClass.TIE)
    error, covariance, places = (solution.places - truth)[ties], solution.covariances[ties], solution.places[ties]
    up = places / np.linalg.norm(places, axis=1, keepdims=True)
    heights = np.einsum("nc,nc->n", error, up) ** 2 / np.einsum("nc,ncd,nd->n", up, covariance, up)
    posterior, means, size = Posterior.of(solution), list[float](), min(30, ties.size)
    for near in cKDTree(places).query(places[:: max(1, ties.size // _MEANS)], size)[1].tolist():
        joint = posterior.covariance([posterior.of_point(int(ties[i])) for i in near])
        mean, spread = error[near].mean(axis=0), joint.reshape(size, 3, size, 3).mean(axis=(0, 2))
        means.append(float(nees(mean[None], spread[None])[0]) / 3.0)
    return [float(nees(error, covariance).mean()) / 3.0, float(heights.mean()), float(np.mean(means))]


def judge(draws: list[Draw]) -> Blocks:
    """A table of each form."""
    blocks = dict[str, list[str]]()
    for form in FORMS:
        rows = list[list[str]]()
        for case in names_of(draws):
            of_case = cases(draws, case)
            values = np.array([draw["values"][form] for draw in of_case])
            cells = [nees_cell(column) for column in values.T.tolist()]
            seconds = np.mean([draw["seconds"] for draw in of_case])
            rows.append([*case.split(", "), str(len(of_case)), str(of_case[0]["groups"]), *cells, number(seconds)])
        blocks[form] = table(("site", "drawn", "N", "groups", *STATED, "s per draw, both forms"), rows)
    return blocks


if __name__ == "__main__":
    sys.exit(run(seeds_of(__doc__, CASES, 50, "evidence_consistency.md#neighbors"), one_draw, judge))
