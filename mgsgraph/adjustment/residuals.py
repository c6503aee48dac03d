"""Residuals of all rows of a network, taking part or not."""

from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.graph import Layout
from mgsgraph.adjustment.graph.bundle import IN_PROCESS, Sweeper
from mgsgraph.geometry.records import Array


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
