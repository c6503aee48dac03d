"""Rays laid out about the lines in which their points are seen, so that every row is that of the true trajectory there;
heights above stereo surfaces linear about the state that counts.

The kernel takes the pose from the line about which a ray is laid out, the measured one to begin with, to the predicted
line by its rates. Over some lines that is right to 1e-9 of a line, but not across a sample of the attitude (where the
rates jump), nor over a misfit of hundreds of lines. So rays are laid out anew about their predicted lines until
nothing moves. So are the slopes of detector lines, by which misplacements count in samples, where unknowns bend them.
"""

from collections.abc import Callable

import numpy as np

from mgsgraph.adjustment.graph import Layout
from mgsgraph.adjustment.graph.bundle import IN_PROCESS, Sweeper
from mgsgraph.adjustment.graph.loops import followed
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.rows import OUT, PREDICTED
from mgsgraph.kernel.sweep import Reduction

NEAR = 1e-5
"""Lines from where a ray is laid out to its predicted line. The rates of a pose jump from sample to sample by much
less than a tenth of themselves, so that a row is then right to 1e-6 lines, and its derivatives to 1e-10."""
NEAR_ENOUGH = 1e-3
"""The same where places of points alone are asked for: rows are right to 1e-4 lines where the rates of a pose jump, and
to rounding everywhere else."""
_MOST = 20
"""Times that points follow their lines, and lines their points."""
_MOST_TURNS = 20
"""Times that rays are laid out anew: two or three do it, more where a predicted line lies beside a sample at which the
rates jump."""
_BEYOND = 0.5
"""Share of an image's lines by which a predicted line may lie before it or after it."""
_UNBENT = 1e-9
"""m, of unknowns of the interior orientation: what they change the slope of a detector line by is then a ten-millionth
of it."""


def about_predicted_lines(
    layout: Layout, orientation: Array, points: Array, near: float = NEAR, own: bool = False,
    sweeper: Sweeper = IN_PROCESS,
) -> Layout:  # fmt: skip
    """The layout itself where its rays are laid out about the lines predicted by shared unknowns (columns,) and points
    (n, 3), layout order, to `near` lines, and its stereo rows are linear about these; else one where they are. In the
    measured-line form lines are what they are. A layout that is the caller's `own` is renewed in place: nobody uses it
    afterwards.
    """
    now = layout
    if layout.model.line == PREDICTED:
        now = _about_followed_lines(layout, orientation, points, near, own, sweeper)
    return now.about_stereo(layout.network_order(points), orientation)


def _about_followed_lines(
    layout: Layout, orientation: Array, points: Array, near: float, own: bool, sweeper: Sweeper
) -> Layout:
    """The same of rays alone, in the strict form."""
    network, now, rays = layout.network, layout, layout.network.rays
    size = np.array([image.lines for image in network.images], dtype=np.float64)
    lines = np.empty(now.lines.size)
    for _ in range(_MOST_TURNS):
        values = sweeper.residuals(now, now.rows, orientation, points)
        ways = now.observation_rows.rays, now.rows.kind, rays.point, now.patterns.point_index, rays.image
        moved = followed(now.lines, rays.places, values, *ways, size, _BEYOND, OUT, lines)
        bent = np.abs(orientation - now.bent)[now.bending].max(initial=0.0)
        if moved <= near and bent <= _UNBENT:
            break
        anew = now.about(lines, orientation, own or now is not layout)
        if anew.patterns is not now.patterns:
            points = now.network_order(points)[anew.point_order]
        lines, now = np.empty(lines.size) if now is layout else now.lines, anew
    return now


def settled(
    layout: Layout, reduction: Reduction, again: Callable[[Layout], Reduction], own: bool = False,
    sweeper: Sweeper = IN_PROCESS,
) -> tuple[Layout, Reduction]:  # fmt: skip
    """Layout and reduction of points that follow their lines, and lines their points, the shared unknowns held.

    `again` solves the points of another layout for the same unknowns; `own` as of `about_predicted_lines`.
    """
    for _ in range(_MOST):
        anew = about_predicted_lines(layout, reduction.orientation, reduction.points, own=own, sweeper=sweeper)
        if anew is layout:
            break
        layout, reduction, own = anew, again(anew), True
    return layout, reduction


def exactly(
    layout: Layout, orientation: Array, points: Array, sweeper: Sweeper = IN_PROCESS
) -> tuple[Layout, Array]:
    """The same, and the points in its order: for a network that is linearised where it was adjusted."""
    anew = about_predicted_lines(layout, orientation, points, sweeper=sweeper)
    return anew, points if anew is layout else layout.network_order(points)[anew.point_order]
