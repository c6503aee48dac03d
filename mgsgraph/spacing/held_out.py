"""Rays that are held out of an adjustment, to be predicted by it: of a point that others place, one ray.

Its misfit, measured minus predicted, is divided by what it would scatter were the orientation known: the ray's own
noise, and that of the point as its other rays place it. These numbers are the same for all candidates, whatever nodes
they have. The covariance of the orientation stays out on purpose: it grows with the number of nodes, and dividing by it
would praise a candidate for not knowing. So a misfit of 1 is noise, and what is above comes from the orientation.
"""

from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.passes import Selection
from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index, Mask, assign, frozen_index
from mgsgraph.network import Network
from mgsgraph.network.support import strip_rays
from mgsgraph.ties import PointKind

_RAYS = 3
"""Of a point of which one may be held out."""


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
        taken = _good(network).copy()
        taken[self.rays] = False
        return taken

    def left_in(self, network: Network) -> Selection:
        """What takes part in an adjustment."""
        return replace(unmarked(network), rays=self.taken(network))


def unmarked(network: Network) -> Selection:
    """All that is not marked as blunders."""
    marks = network.ranges.rejected
    ranges = np.ones(network.ranges.point.size, dtype=bool) if marks is None else ~marks
    return Selection(_good(network), ranges, network.undetermined.copy())


def _good(network: Network) -> Mask:
    marks = network.rays.rejected
    return np.ones(network.rays.point.size, dtype=bool) if marks is None else ~marks


def hold_out(network: Network, share: float, rng: np.random.Generator) -> HeldOut:
    """Draw rays to hold out.

    Parameters
    ----------
    network : Network
        With strips.
    share : float
        Of the points with three rays or more; of each of them one ray, of a strip's image, is held out.
    rng : Generator
    """
    if not (np.isfinite(share) and 0.0 < share <= 1.0):
        raise InputError("rays held out", f"a share of {share}", "more than 0, and 1 at the most")
    good, in_strip = _good(network), network.strip_of[network.rays.image] >= 0
    counts = np.bincount(network.rays.point, good, len(network.points))
    able = np.flatnonzero(good & in_strip & (counts[network.rays.point] >= _RAYS))
    shuffled = rng.permutation(able)
    points, first = np.unique(network.rays.point[shuffled], return_index=True)
    number = round(share * points.size)
    if number < 2:
        found = f"{points.size} points with {_RAYS} rays or more, of which {number} would be held out"
        raise InputError("rays held out", found, "two at least", "hold out a larger share, or match more points")
    rays = np.sort(shuffled[rng.choice(first, number, replace=False)])
    times, strip = np.empty(rays.size), network.strip_of[network.rays.image[rays]]
    for k in np.unique(strip).tolist():
        mine = strip_rays(network, k)
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
    network : Network
    held : HeldOut
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
