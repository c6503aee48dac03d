"""Rays held out of an adjustment and predicted by it, and how much rays scatter, in their stated sigmas.

*Held out* is one ray of a point that other rays determine. Its misfit, measured minus predicted, is divided by what it
would scatter were the orientation known: the ray's own noise, and that of the point as its other rays determine it.
These numbers are the same for all candidates, whatever nodes they have. The covariance of the orientation stays out on
purpose: it grows with the number of nodes, and dividing by it would reward a candidate for not knowing. So a misfit of
1 is noise, and what is above comes from the orientation.

*Scatter* is what no orientation image can change. Rays of one line that follow one another within a moment see the same
orientation, whatever it is: jitter and what nodes can't follow moves them alike. So the residuals of a few of them,
less their mean, are noise. They are smaller than that of the rays, as their points follow them; by how much follows
from the geometry, ray by ray. The root mean square of both is the factor by which rays scatter more than stated. sigma0
would not do: it also grows with what nodes can't follow or a prior does not allow, and would hide the jitter that is
looked for.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.rounds import Selection, unmarked
from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.files.tie_points import PointKind
from mgsgraph.geometry.records import Array, Index, Mask, assign, frozen_index
from mgsgraph.network import Network
from mgsgraph.network.support import pass_rays

_RAYS = 3
"""Of a point of which one may be held out."""
_TOGETHER = 3
"""Rays of a line, one after the other, that share a mean."""
_FEWEST = 30.0
"""Redundancy below which the stated sigmas are taken at their word."""
_SURE, _LEAST = 3.0, 0.03
"""Standard errors, and share, by which a factor that is worth a word is off 1."""


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Which rays are held out."""

    rays: Index
    """(h,) of the network, of different points, ascending."""
    strip: Index
    """(h,) strip of each."""
    times: Array
    """(h,) s past the epoch of that strip's nodes."""

    def __post_init__(self) -> None:
        assign(self, rays=frozen_index(self.rays, "rays held out", np.size(self.rays), 2**62))

    def taken(self, network: Network) -> Mask:
        """(rays,) those that take part: neither held out nor marked as blunders."""
        taken = unmarked(network).rays
        taken[self.rays] = False
        return taken

    def left_in(self, network: Network) -> Selection:
        """What takes part in an adjustment."""
        return replace(unmarked(network), rays=self.taken(network))


def hold_out(network: Network, share: float, rng: np.random.Generator) -> HeldOut:
    """Draw rays to hold out.

    Parameters
    ----------
    network : Network
        With strips.
    share : float
        Of the points with three rays or more; of each of them one ray, of a strip's image, is held out.
    """
    if not (np.isfinite(share) and 0.0 < share <= 1.0):
        raise InputError("rays held out", f"a share of {share}", "more than 0, and 1 at the most")
    good, in_strip = unmarked(network).rays, network.pass_of[network.rays.image] >= 0
    counts = np.bincount(network.rays.point, good, len(network.points))
    able = np.flatnonzero(good & in_strip & (counts[network.rays.point] >= _RAYS))
    shuffled = rng.permutation(able)
    points, first = np.unique(network.rays.point[shuffled], return_index=True)
    number = round(share * points.size)
    if number < 2:
        found = f"{points.size} points with {_RAYS} rays or more, of which {number} would be held out"
        raise InputError("rays held out", found, "two at least", "hold out a larger share, or match more points")
    rays = np.sort(shuffled[rng.choice(first, number, replace=False)])
    times, strip = np.empty(rays.size), network.pass_of[network.rays.image[rays]]
    for k in np.unique(strip).tolist():
        mine = pass_rays(network, k)
        times[strip == k] = mine.times[np.searchsorted(mine.rays, rays[strip == k])]
    return HeldOut(rays, strip, times)


def misfits(solution: Solution, held: HeldOut) -> Array:
    """(h, 2) px, measured minus predicted line and sample of rays held out, their points where the solution's other
    rays place them; NaN where these don't, or the point isn't seen.
    """
    network = solution.network
    found = np.full((held.rays.size, 2), np.nan)
    points, images = network.rays.point[held.rays], network.rays.image[held.rays]
    for j in np.unique(images).tolist():
        mine = np.flatnonzero((images == j) & solution.determined[points])
        measured = network.rays.places[held.rays[mine]]
        predicted, _ = solution.image(j).ground_to_image(
            solution.places[points[mine]], solution.correction(j), start=measured[:, 0]
        )
        found[mine] = measured - predicted
    return found


def whitening(network: Network, held: HeldOut, places: Array) -> Array:
    """(h, 2, 2) per px, inverse roots of the covariances that misfits have when orientation is known; NaN where the
    other rays of a point place it nowhere.

    Parameters
    ----------
    places : (n, 3)
        m, of the points, about.
    """
    points = network.rays.point[held.rays]
    chosen = np.full(len(network.points), -1)
    chosen[points] = np.arange(points.size)
    taken = np.flatnonzero(held.taken(network) & (chosen[network.rays.point] >= 0))
    owner, known = chosen[network.rays.point[taken]], known_besides_rays(network, points, places)
    slopes = ray_slopes(network, taken, places) / network.rays.sigmas[taken][:, :, None]
    seen = np.isfinite(slopes).all(axis=(1, 2))
    np.add.at(known, owner[seen], np.swapaxes(slopes[seen], 1, 2) @ slopes[seen])
    own = ray_slopes(network, held.rays, places)
    spread = own @ point_covariances(known) @ np.swapaxes(own, 1, 2)
    spread[network.points.kinds[points] == PointKind.FIXED] = 0.0
    spread[:, [0, 1], [0, 1]] += network.rays.sigmas[held.rays] ** 2
    found = np.full_like(spread, np.nan)
    good = np.isfinite(spread).all(axis=(1, 2))
    found[good] = np.linalg.inv(np.linalg.cholesky(spread[good]))
    return found


def known_besides_rays(network: Network, points: Index, places: Array) -> Array:
    """(h, 3, 3) per m^2, what is known of points without their rays: a-priori place, and height above the terrain."""
    known = np.zeros((points.size, 3, 3))
    constrained = network.points.kinds[points] == PointKind.CONSTRAINED
    known[constrained] = np.linalg.inv(network.points.covariances[points[constrained]])
    if network.surface is not None:
        above, normal = network.surface.grid.height_above(places[points])
        weight = np.where(np.isfinite(above), network.surface.sigmas[points] ** -2.0, 0.0)
        normal = np.where(np.isfinite(above)[:, None], normal, 0.0)  # NaN off the model, even of no weight
        known += weight[:, None, None] * normal[:, :, None] * normal[:, None, :]
    return known


def ray_slopes(network: Network, rays: Index, places: Array) -> Array:
    """(m, 2, 3) px per m, how the line and sample of rays follow their points, nominally."""
    found = np.full((rays.size, 2, 3), np.nan)
    points, images = network.rays.point[rays], network.rays.image[rays]
    for j in np.unique(images).tolist():
        mine = np.flatnonzero((images == j) & np.isfinite(places[points]).all(axis=1))
        start = network.rays.places[rays[mine], 0]
        found[mine] = network.images[j].ground_to_image(places[points[mine]], start=start)[1]
    return found


def point_covariances(matrices: Array) -> Array:
    """Inverses of (h, 3, 3); NaN where one is singular, as of a point that nothing places."""
    found = np.full_like(matrices, np.nan)
    scale = np.trace(matrices, axis1=1, axis2=2) / 3.0
    good = np.isfinite(scale) & (scale > 0.0)
    values = np.linalg.eigvalsh(matrices[good] / scale[good, None, None])
    good[good] = values[:, 0] > 1e-10
    found[good] = np.linalg.inv(matrices[good])
    return found


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
    able = solution.rays_used & np.isfinite(solution.residuals).all(axis=1) & (network.pass_of[rays.image] >= 0)
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
