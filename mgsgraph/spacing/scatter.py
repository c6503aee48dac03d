"""How much rays scatter, in the sigmas that are stated for them: what no orientation image can change.

Rays of one line that follow one another within a moment see the same orientation, whatever it is: jitter and what nodes
can't follow moves them alike. So the residuals of a few of them, less their mean, are noise. They are smaller than that
of the rays, as their points follow them; by how much follows from the geometry, ray by ray. The root mean square of
both is the factor by which rays scatter more than stated. sigma0 would not do: it also grows with what nodes can't
follow or a prior does not allow, and would hide the jitter that is looked for.
"""

import math
from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.records import Array, Index
from mgsgraph.spacing.held_out import known_besides_rays, point_covariances, ray_slopes
from mgsgraph.ties import PointKind

_TOGETHER = 3
"""Rays of a line, one after the other, that share a mean."""
_FEWEST = 30.0
"""Redundancy below which the stated sigmas are taken at their word."""
_SURE, _LEAST = 3.0, 0.03
"""Standard errors, and share, by which a factor that is worth a word is off 1."""


@dataclass(frozen=True, slots=True)
class Scatter:
    """Of the rays of all strips."""

    factor: float
    """Times the stated sigmas; 1 where there are too few rays to tell."""
    freedom: float
    """Redundancy that it is taken from."""

    @property
    def error(self) -> float:
        """Standard error of the factor, of normal noise; infinite where there are too few rays."""
        return self.factor / math.sqrt(2.0 * self.freedom) if self.freedom >= _FEWEST else math.inf

    @property
    def contradicts(self) -> bool:
        """Whether the stated sigmas are wrong, surely and by as much as matters."""
        return abs(self.factor - 1.0) > max(_SURE * self.error, _LEAST)


def ray_scatter(solution: Solution) -> Scatter:
    """Scatter of the rays that took part in an adjustment, best one with close nodes."""
    network, rays = solution.network, solution.network.rays
    able = solution.rays_used & np.isfinite(solution.residuals).all(axis=1) & (network.strip_of[rays.image] >= 0)
    if rays.back_projected is not None:
        able &= ~rays.back_projected  # they have no noise
    mine = np.flatnonzero(able)
    mine = mine[np.lexsort((rays.places[mine, 0], rays.image[mine]))]
    white, left = solution.residuals[mine] / rays.sigmas[mine], _redundancies(solution, mine)
    known = np.isfinite(left).all(axis=1)
    mine, white, left = mine[known], white[known], left[known]
    group = _groups(rays.image[mine])
    size = np.bincount(group)[group]
    mean = np.stack([np.bincount(group, column)[group] for column in white.T], axis=1) / size[:, None]
    freedom = float(np.sum(left * (1.0 - 1.0 / size)[:, None]))
    if freedom < _FEWEST:
        return Scatter(1.0, freedom)
    return Scatter(math.sqrt(float(np.sum((white - mean) ** 2)) / freedom), freedom)


def _groups(image: Index) -> Index:
    """(m,) number of the few rays that each belongs to, of images (m,) in order."""
    starts = np.searchsorted(image, image)  # the first ray of the same image
    inside = (np.arange(image.size) - starts) // _TOGETHER
    return np.asarray(np.cumsum(np.append(True, (np.diff(image) > 0) | (np.diff(inside) > 0))[: image.size]) - 1)


def _redundancies(solution: Solution, mine: Index) -> Array:
    """(m, 2) share of a ray's variance that its residuals have, line and sample, when orientation is known."""
    network, rays = solution.network, solution.network.rays
    taken = np.flatnonzero(solution.rays_used)
    slopes = ray_slopes(network, taken, solution.places) / rays.sigmas[taken][:, :, None]
    seen = np.isfinite(slopes).all(axis=(1, 2))
    normal = known_besides_rays(network, np.arange(len(network.points)), solution.places)
    np.add.at(normal, rays.point[taken[seen]], np.swapaxes(slopes[seen], 1, 2) @ slopes[seen])
    spread = point_covariances(normal)
    spread[network.points.kinds == PointKind.FIXED] = 0.0
    own = np.full((rays.point.size, 2, 3), np.nan)
    own[taken] = slopes
    return np.asarray(1.0 - np.einsum("mij,mjk,mik->mi", own[mine], spread[rays.point[mine]], own[mine]))
