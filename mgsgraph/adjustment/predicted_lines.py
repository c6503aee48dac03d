"""Rays laid out about the lines in which their points are seen, so that every row is that of the true trajectory there;
heights above stereo surfaces linear about the state that counts.

The kernel takes the pose from the line about which a ray is laid out, the measured one to begin with, to the predicted
line by its rates. Over some lines that is right to 1e-9 of a line, but not across a sample of the attitude (where the
rates jump), nor over a misfit of hundreds of lines. So rays are laid out anew about their predicted lines until
nothing moves. So are the slopes of detector lines, by which misplacements count in samples, where unknowns bend them.
"""

from collections.abc import Callable

from mgsgraph.adjustment.graph import Layout
from mgsgraph.adjustment.graph.bundle import IN_PROCESS, Sweeper
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.reduction import Reduction
from mgsgraph.kernel.rows import PREDICTED

NEAR = 1e-5
"""Lines from where a ray is laid out to its predicted line. The rates of a pose jump from sample to sample by much
less than a tenth of themselves, so that a row is then right to 1e-6 lines, and its derivatives to 1e-10."""
NEAR_ENOUGH = 1e-3
"""The same where places of points alone are asked for: rows are right to 1e-4 lines where the rates of a pose jump, and
to rounding everywhere else."""
_MOST = 20
"""Times that points follow their lines, and lines their points."""


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
        now = sweeper.about_lines(layout, orientation, points, near, own)
    return now.about_stereo(layout.network_order(points), orientation)


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
