"""Rays laid out about the lines in which their points are seen, so that every row is that of the true trajectory there.

The kernel takes the pose from the line about which a ray is laid out, the measured one to begin with, to the predicted line
by its rates. Over some lines that is right to 1e-9 of a line, but not across a sample of the attitude (where the rates
jump), nor over a misfit of hundreds of lines. So rays are laid out anew about their predicted lines until nothing moves.
"""

import numpy as np

from mgsgraph.adjustment.graph import Layout
from mgsgraph.adjustment.posterior import residuals
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.rows import PREDICTED

EXACT = 3e-9
"""Lines (and samples) by which a row may be off: what rounding of body-fixed metres leaves."""
_MOST = 5
"""Times: each leaves the square of what was left before, until rounding does."""
_BEYOND = 0.5
"""Share of an image's lines by which a predicted line may lie before it or after it."""


def about_predicted_lines(layout: Layout, orientation: Array, points: Array) -> Layout:
    """The layout itself where its rows are exact at shared unknowns (columns,) and points (n, 3), layout order; else one
    laid out about the predicted lines. Nothing to do in the measured-line form.
    """
    if layout.model.line != PREDICTED:
        return layout
    network, now = layout.network, layout
    size = np.array([image.lines for image in network.images], dtype=np.float64)[network.rays.image]
    places = layout.network_order(points)
    found = residuals(layout, orientation, points).image
    before = np.inf
    for _ in range(_MOST):
        lines = network.rays.places[:, 0] - found[:, 0]
        lines = np.clip(np.where(np.isnan(lines), now.lines, lines), -_BEYOND * size, (1.0 + _BEYOND) * size)
        anew = now.about(lines)
        again = residuals(anew, orientation, places[anew.point_order]).image
        off = float(np.nanmax(np.abs(again - found), initial=0.0))
        if off <= EXACT or off > 0.5 * before:
            return now
        now, found, before = anew, again, off
    return now


def exactly(layout: Layout, orientation: Array, points: Array) -> tuple[Layout, Array]:
    """The same, and the points in its order: for a network that is linearised where it was adjusted."""
    anew = about_predicted_lines(layout, orientation, points)
    return anew, points if anew is layout else layout.network_order(points)[anew.point_order]
