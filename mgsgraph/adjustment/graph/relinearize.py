"""Rays of a layout follow their points to the lines in which these are seen."""

import numpy as np

from mgsgraph.adjustment.graph.layout import Layout
from mgsgraph.adjustment.graph.sampled_rays import BEYOND, MOST_TURNS
from mgsgraph.adjustment.graph.sorting import followed
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.reduction import all_residuals
from mgsgraph.kernel.rows import OUT

_UNBENT = 1e-9
"""m, of unknowns of the interior orientation: what they change the slope of a detector line by is then a ten-millionth
of it."""


def about_followed_lines(layout: Layout, orientation: Array, points: Array, near: float, own: bool) -> Layout:
    """The layout itself where its rays are laid out about the lines predicted by shared unknowns (columns,) and points
    (n, 3), layout order, to `near` lines; else one where they are. Where it is the caller's `own` it is renewed in
    place: nobody uses it afterwards.
    """
    network, now, rays = layout.network, layout, layout.network.rays
    size = np.array([image.lines for image in network.images], dtype=np.float64)
    lines = np.empty(now.lines.size)
    for _ in range(MOST_TURNS):
        values = all_residuals(now.rows, now.groups, now.blocks.target, now.model, orientation, points)
        ways = now.observation_rows.rays, now.rows.kind, rays.point, now.patterns.point_index, rays.image
        moved = followed(now.lines, rays.places, values, *ways, size, BEYOND, OUT, lines)
        bent = np.abs(orientation - now.bent)[now.bending].max(initial=0.0)
        if moved <= near and bent <= _UNBENT:
            break
        anew = now.about(lines, orientation, own or now is not layout)
        if anew.patterns is not now.patterns:
            points = now.network_order(points)[anew.point_order]
        lines, now = np.empty(lines.size) if now is layout else now.lines, anew
    return now
