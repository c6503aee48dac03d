"""How the trajectories of strips were corrected along time, and how well that is known.

Corrections are those of the orientation images alone, in the terms of the flight (`datum.frames`): along, across and
radial; roll, pitch and yaw. What unknowns that images share do to them on top is not in them.
"""

from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.flight_sigmas import strip_turns
from mgsgraph.geometry.orientation import COMPONENTS as AXES
from mgsgraph.geometry.orientation_images import SUPPORT
from mgsgraph.geometry.records import Array
from mgsgraph.network import NodePrior
from mgsgraph.network.passes import seconds, straightest


@dataclass(frozen=True, slots=True, eq=False)
class StripCourse:
    """Corrections along a strip, at some times."""

    times: Array
    """(n,) s TDB past J2000."""
    values: Array
    """(n, 6) m along, across and radial, and rad of roll, pitch and yaw."""
    sigmas: Array
    """(n, 6) the same, of `values`, for sigma0 = 1."""


def strip_course(solution: Solution, strip: int, times: Array) -> StripCourse:
    """Corrections of a strip at times (n,) in s TDB past J2000, by the four nodes nearest to each."""
    nodes = solution.network.strips[strip].nodes
    first, basis, _ = nodes.at(times - nodes.epoch, nodes.epoch)
    values = np.einsum("nk,nkc->nc", basis, solution.nodes[strip][first[:, None] + np.arange(SUPPORT)])
    variable = int(solution.network.first_of_strips[strip])
    covariance = np.empty((times.size, 6, 6))
    for k in np.unique(first).tolist():
        mine = first == k
        joint = solution.joint_covariance.of(range(variable + k, variable + k + SUPPORT))
        joint = joint.reshape(SUPPORT, 6, SUPPORT, 6)
        covariance[mine] = np.einsum("np,piqj,nq->nij", basis[mine], joint, basis[mine])
    turn = strip_turns(solution.network, strip, times, solution.settings.angles)
    sigmas = np.sqrt(np.maximum(np.einsum("nij,njk,nik->ni", turn, covariance, turn), 0.0))
    return StripCourse(times, np.einsum("nij,nj->ni", turn, values), sigmas)


@dataclass(frozen=True, slots=True, eq=False)
class StripReport:
    """One strip, in figures."""

    name: str
    """What it is called."""
    basis: str
    """Between its nodes."""
    images: tuple[str, ...]
    """Names."""
    nodes: int
    """All of them; a spline has one beyond either end."""
    spacing: float
    """s between nodes, on the average."""
    lines: float
    """The same in lines of the image that looks straight down."""
    ground: float
    """The same in m over ground; NaN where that image misses the body."""
    course: StripCourse
    """Corrections at the nodes within the strip."""
    trend: tuple[tuple[str, str, float, float], ...]
    """Bias and drift of the observed trajectory: "bias" or "drift", component (of the camera's own axes), value and
    sigma in m or rad."""

    @property
    def largest(self) -> Array:
        """(6,) m and rad, largest correction at a node."""
        return np.asarray(np.abs(self.course.values).max(axis=0))

    @property
    def mean_sigmas(self) -> Array:
        """(6,) m and rad, mean sigma of the nodes."""
        return np.asarray(self.course.sigmas.mean(axis=0))


def strip_reports(solution: Solution) -> list[StripReport]:
    """All strips, in their order."""
    return [_report(solution, k) for k in range(len(solution.network.strips))]


def node_times(solution: Solution, strip: int) -> Array:
    """(k,) s TDB past J2000 of the nodes within a strip: all but the outer two of a spline."""
    nodes = solution.network.strips[strip].nodes
    return nodes.inner + nodes.epoch


def _report(solution: Solution, strip: int) -> StripReport:
    one, pictures = solution.network.strips[strip], solution.network.pictures(strip)
    image = pictures[straightest(pictures)]
    start, stop = seconds(image)
    spacing = one.nodes.spacing
    lines = spacing * image.lines / (stop - start)
    _, derivative = image.image_to_ground(np.array([0.5 * image.lines]), np.array([0.5 * image.samples]))
    return StripReport(
        one.name, one.nodes.basis, tuple(picture.name for picture in pictures),
        len(one.nodes), spacing, lines, float(np.linalg.norm(derivative[0, :, 0])) * lines,
        strip_course(solution, strip, node_times(solution, strip)), _trend(solution, strip),
    )  # fmt: skip


def _trend(solution: Solution, strip: int) -> tuple[tuple[str, str, float, float], ...]:
    prior, values = solution.network.strips[strip].prior, solution.trends[strip]
    if not isinstance(prior, NodePrior) or not values.size:
        return ()
    variable = int(solution.network.first_of_strips[strip + 1]) - 1
    sigmas = np.sqrt(np.diagonal(solution.joint_covariance.block(variable, variable)))
    biases = int(np.count_nonzero(prior.bias))
    return tuple(
        ("bias" if c < biases else "drift", AXES[component], float(values[c]), float(sigmas[c]))
        for c, component in enumerate(prior.trend_components.tolist())
    )
