"""Residuals of all rows of a network, taking part or not.

Squares of the whitened residuals of all rows that take part, group by group: which points and images they are of.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from mgsgraph.adjustment.graph import Layout
from mgsgraph.adjustment.graph.bundle import IN_PROCESS, Sweeper
from mgsgraph.adjustment.graph.shared import footprint_shifts, shared_values
from mgsgraph.factors.loss import cauchy, huber, tukey
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.kernel.rows import CAUCHY, HUBER, NO_LOSS, OUT, PRIOR, TUKEY, Model, Rows


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Residuals of all rows, taking part or not, measured minus predicted; network order."""

    image: Array
    """(k, 2) pixels."""
    ranges: Array
    """(r,) m."""
    heights: Array
    """(n,) m above the terrain model; NaN for points without such a row, or without terrain."""
    stereo: Array
    """(n,) m above the stereo surface, along its normal; NaN for points without such a row."""


def residuals(layout: Layout, orientation: Array, points: Array, sweeper: Sweeper = IN_PROCESS) -> Residuals:
    """Residuals with the shared unknowns (columns,) and points (n, 3), layout order."""
    places = layout.observation_rows
    values = sweeper.residuals(layout, layout.rows, orientation, points)
    heights = np.full(points.shape[0], np.nan)
    heights[places.on_terrain] = values[places.heights, 0]
    stereo = np.full(points.shape[0], np.nan)
    if layout.stereo is not None:
        stereo[layout.stereo.points] = values[places.stereo, 0]
    return Residuals(values[places.rays], values[places.ranges, 0], heights, stereo)


_LOSSES: dict[int, Callable[..., Any]] = {HUBER: huber, CAUCHY: cauchy, TUKEY: tukey}


class Squares(NamedTuple):
    """Of one kind of measures; m of them take part."""

    point: Index
    """(m,) network point of each."""
    image: Index
    """(m,) its image; -1 for a measure in none."""
    values: Array
    """(m,) whitened squares, of the rows of a measure together; NaN where the point is behind the camera."""
    rows: int
    """Rows of a measure."""
    robust: bool
    """Whether a robust loss acts on it."""

    def costs(self, model: Model) -> Array:
        """(m,) what each adds to the cost."""
        if not self.robust or model.loss == NO_LOSS:
            return 0.5 * self.values
        cost, _ = _LOSSES[model.loss](self.values, model.width)
        return np.asarray(cost)


def squares_of(
    layout: Layout, rows: Rows, orientation: Array, points: Array, found: Residuals
) -> dict[str, Squares]:
    """Squares of each kind of measures: image rays, ranges, a-priori places, heights above the terrain model and above
    stereo surfaces.

    Parameters
    ----------
    layout : Layout
    rows : Rows
        Those that take part.
    orientation : (columns,) array
        Shared unknowns, m and rad.
    points : (n, 3) array
        m, layout order.
    found : Residuals
        There.
    """
    network, places, kind = layout.network, layout.observation_rows, layout.network_order(rows.kind)
    rays = _taking((rows.weight[0, places.rays] > 0.0) & (kind[network.rays.point] != OUT))
    whitened = found.image[rays] / network.rays.sigmas[rays]
    ranges = _taking((rows.weight[0, places.ranges] > 0.0) & (kind[network.ranges.point] != OUT))
    known = np.flatnonzero(kind == PRIOR)
    offset = layout.network_order(points)[known] - network.points.places[known] - _shifts(layout, orientation, known)
    ground = np.linalg.solve(network.points.covariances[known], offset[:, :, None])[:, :, 0]
    low = np.flatnonzero(np.isfinite(found.heights) & (kind != OUT))
    sigmas = network.surface.sigmas[low] if network.surface is not None else np.zeros(0)
    range_squares = (found.ranges[ranges] / network.ranges.sigmas[ranges]) ** 2
    on_stereo, stereo_squares = _of_stereo(layout, rows, found)

    def nowhere(of: Index) -> Index:
        return np.full(of.size, -1)

    return {
        "rays": Squares(
            network.rays.point[rays], network.rays.image[rays], np.einsum("ki,ki->k", whitened, whitened), 2, True
        ),
        "ranges": Squares(network.ranges.point[ranges], network.ranges.image[ranges], range_squares, 1, True),
        "places": Squares(known, nowhere(known), np.einsum("ki,ki->k", offset, ground), 3, False),
        "heights": Squares(low, nowhere(low), (found.heights[low] / sigmas) ** 2, 1, False),
        "stereo heights": Squares(on_stereo, nowhere(on_stereo), stereo_squares, 1, True),
    }


def _taking(mask: Mask) -> Index | slice:
    """What to take where a mask (n,) is true: as a rule all, without a copy."""
    return slice(None) if np.all(mask) else np.flatnonzero(mask)


def _of_stereo(layout: Layout, rows: Rows, found: Residuals) -> tuple[Index, Array]:
    """(m,) points whose heights above stereo surfaces take part, and their squares in sigmas."""
    control, stereo = layout.network.stereo, layout.stereo
    if control is None or stereo is None:
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    kind = layout.network_order(rows.kind)[stereo.points]
    points = stereo.points[(rows.weight[0, layout.observation_rows.stereo] > 0.0) & (kind != OUT)]
    return points, (found.stereo[points] / control.sigmas[points]) ** 2


def _shifts(layout: Layout, orientation: Array, points: Index) -> Array:
    """(p, 3) m: how far profiles' shifts and altimeters' boresights move the a-priori places of network points."""
    network = layout.network
    shift = footprint_shifts(network, shared_values(network, layout.variables, orientation))[points]
    if network.shifts is None:
        return shift
    profile = network.shifts.profile[points]
    moved = profile >= 0
    first = layout.variables.first[len(network.images) + profile[moved]]
    both = orientation[np.stack([first, first + 1], axis=1)]
    shift[moved] += np.einsum("pk,pkj->pj", both, east_north(network.points.places[points[moved]]))
    return shift
