"""Residuals of image rays over time, for any image: how a vibration of its camera would show in them.

Of a ray that lies off by d (2,) px, as the camera that took it looked elsewhere, residuals show what the point doesn't
follow. With J a ray's slopes by the point, W its weight and C the point's covariance (all of its rays, and what else is
known of it),

    v_k = d_k - J_k C J_k' W_k d_k   of the ray itself,      v_i = - J_i C J_k' W_k d_k   of the point's other rays.

The share that is left is the ray's redundancy when orientation is known. In a stereo pair it is one half at right
angles to the epipolar line, and nothing along it: there the point takes up all, as a height.

A pitch moves rays along lines, a roll along samples, a yaw along lines in proportion to the sample's distance from the
middle. Motions of the spacecraft do the same: residuals don't tell them from turns.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from mgsgraph.adjustment.linearised import Linearised
from mgsgraph.adjustment.residuals import residuals
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.spacing.rays import known_besides_rays, point_covariances, ray_slopes
from mgsgraph.errors import InputError
from mgsgraph.files.tie_points import PointKind
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.rows import OUT
from mgsgraph.network import Network

Turn = Literal["pitch", "roll", "yaw"]
"""What moves rays: along lines, along samples, along lines at the image's left and right edge the opposite way."""
TURNS: tuple[Turn, ...] = get_args(Turn)


class Series(NamedTuple):
    """Rays of one image that a turn of its camera moves; k rays."""

    image: int
    """Of the network."""
    name: str
    """Of the image."""
    turn: Turn
    """Which."""
    own: Index
    """(k,) of `Residuals.rays`."""
    times: Array
    """(k,) s from the middle of the first and last."""
    moves: Array
    """(k,) px of line (pitch, yaw) or sample (roll) per px of amplitude: 1, or of a yaw the place between the edges."""
    shares: Array
    """(k,) of such a move that is left in the ray's own residual."""
    weights: Array
    """(k,) per px^2."""

    @property
    def component(self) -> int:
        """Of a residual: 0 line, 1 sample."""
        return 1 if self.turn == "roll" else 0

    @property
    def share(self) -> float:
        """Of a move that residuals show, mean over the rays."""
        return float(self.shares.mean())

    @property
    def duration(self) -> float:
        """s, from the first to the last ray."""
        return float(np.ptp(self.times))


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """All rays that took part, by image and line; r of them."""

    rays: Index
    """(r,) of the network."""
    values: Array
    """(r, 2) px, line and sample, measured minus predicted."""
    point: Index
    """(r,) network point."""
    slopes: Array
    """(r, 2, 3) px per m, J."""
    spread: Array
    """(n, 3, 3) m^2, C of each network point; zero of a fixed one."""
    weights: Array
    """(r, 2) per px^2."""
    series: tuple[Series, ...]
    """Three for each image with rays enough."""

    def shown(self, one: Series, moved: Array) -> Array:
        """(r, 2) px, what residuals show of rays of a series that lie off by `moved` (k,) px."""
        found = np.zeros_like(self.values)
        off = np.zeros((one.own.size, 2))
        off[:, one.component] = moved
        found[one.own] = off
        pulled = np.zeros((self.spread.shape[0], 3))
        pull = np.einsum("kij,ki->kj", self.slopes[one.own], self.weights[one.own] * off)
        np.add.at(pulled, self.point[one.own], pull)
        follow = np.einsum("nij,nj->ni", self.spread, pulled)
        return np.asarray(found - np.einsum("rij,rj->ri", self.slopes, follow[self.point]))


def residual_series(of: Solution | Linearised, fewest: int) -> Residuals:
    """Residuals of an adjustment as series over time.

    Parameters
    ----------
    of : Solution or Linearised
        Its rays used count; those that were made from other knowledge (back-projected) have no noise and don't.
    fewest : int
        Rays that an image needs.

    Raises
    ------
    InputError
        Where no image has as many.
    """
    at = at_solution(of) if isinstance(of, Solution) else of
    network, rays, layout = at.network, at.network.rays, at.layout
    places, misfits = layout.network_order(at.points), residuals(layout, at.orientation, at.points).image
    taken_part = at.rows.weight[0, layout.observation_rows.rays] > 0.0
    able = taken_part & (layout.network_order(at.rows.kind) != OUT)[rays.point] & np.isfinite(misfits).all(axis=1)
    if rays.back_projected is not None:
        able &= ~rays.back_projected
    taken = np.flatnonzero(able)
    taken = taken[np.lexsort((rays.places[taken, 0], rays.image[taken]))]
    slopes = ray_slopes(network, taken, places)
    seen = np.isfinite(slopes).all(axis=(1, 2))
    taken, slopes = taken[seen], slopes[seen]
    weights, point = rays.sigmas[taken] ** -2.0, rays.point[taken]
    spread = _spread(network, places, point, slopes, weights)
    shares = 1.0 - np.einsum("rki,rij,rkj->rk", slopes, spread[point], slopes) * weights
    series = [one for j in np.unique(rays.image[taken]).tolist()
              for one in _of_image(network, j, taken, shares, weights, fewest)]  # fmt: skip
    if not series:
        raise InputError("residuals over time", f"no image with {fewest} rays that took part", "ties matched densely")
    return Residuals(taken, misfits[taken], point, slopes, spread, weights, tuple(series))


def _spread(network: Network, places: Array, point: Index, slopes: Array, weights: Array) -> Array:
    """(n, 3, 3) m^2, of all points when orientation is known; zero of fixed ones and of those that nothing places."""
    normal = known_besides_rays(network, np.arange(len(network.points)), places)
    normal = np.where(np.isfinite(normal), normal, 0.0)
    np.add.at(normal, point, np.einsum("rki,rk,rkj->rij", slopes, weights, slopes))
    spread = point_covariances(normal)
    spread[network.points.kinds == PointKind.FIXED] = 0.0
    return np.where(np.isfinite(spread), spread, 0.0)


def _of_image(
    network: Network, image: int, taken: Index, shares: Array, weights: Array, fewest: int
) -> Iterator[Series]:
    """Three of an image with rays enough."""
    own = np.flatnonzero(network.rays.image[taken] == image)
    one, places = network.images[image], network.rays.places[taken[own]]
    times = one.timing.at(places[:, 0])[0]
    if own.size < fewest or not np.ptp(times) > 0.0:
        return
    times = times - 0.5 * (times.min() + times.max())
    for turn in TURNS:
        c = 1 if turn == "roll" else 0
        moves = 2.0 * places[:, 1] / one.samples - 1.0 if turn == "yaw" else np.ones(own.size)
        yield Series(image, one.name, turn, own, times, moves, shares[own, c], weights[own, c])
