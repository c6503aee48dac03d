"""Orientation and points in the axes of the flight: sigmas along the lines of an image, sigmas of points along X
(flight), Y (across, to the left) and Z (up), and the corrections of strips over time.

Corrections of strips are those of the orientation images alone, in the axes of the flight (`datum.frames`): along,
across and radial; roll, pitch and yaw. Unknowns that images share are not in them.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.adjustment.frames import camera_axes, flight_axes
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import sigmas_along
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import COMPONENTS as AXES
from mgsgraph.geometry.orientation import SUPPORT, Angles, Moments, OrientationCorrection
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.network import Network, NodePrior, Pass
from mgsgraph.network.corrections import designs
from mgsgraph.network.joining import nominal_poses, seconds, straightest

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_LEVEL = 1e-9
"""Share of the velocity below which its level part says nothing."""


def pose_sigmas(
    network: Network, image: int, correction: OrientationCorrection, joint: JointCovariance, lines: Array
) -> Array:
    """Sigmas of the orientation of one image at some lines.

    Parameters
    ----------
    network : Network
        Whose numbering of variables `joint` has.
    correction : OrientationCorrection
        Of the image, whole.
    joint : JointCovariance
        Of the shared unknowns, a-priori or of a solution.
    lines : (n,)

    Returns
    -------
    (n, 6)
        m along, across and radial, and rad of roll, pitch and yaw (`datum.frames`), for sigma0 = 1.
    """
    picture = network.images[image]
    moments, nominal = picture.moments(lines), picture.pose(lines)
    turns, result = _turns(nominal, correction.axes(nominal, moments)), np.empty((lines.size, 6))
    for k, partials in enumerate(designs(network, image, correction.angles, lines)):
        design = turns[k] @ np.concatenate([np.zeros((6, 0)), *partials.values()], axis=1)
        result[k] = np.sqrt(np.maximum(np.einsum("ai,ij,aj->a", design, joint.of(partials), design), 0.0))
    return result


def strip_turns(network: Network, strip: int, times: Array, angles: Angles) -> Array:
    """(n, 6, 6) from the components of a strip's corrections, m and rad, to along, across and radial, roll, pitch and
    yaw of its flight, at times (n,) in s TDB past J2000.

    Each time is taken from an image of the strip that knows it (`network.joining.nominal_poses`).
    """
    pose = nominal_poses(network.pictures(strip), times, network.passes[strip].axes)
    axes = OrientationCorrection(np.zeros((1, 6)), angles).axes(pose, Moments.of_times(times, 0.0))
    return _turns(pose, axes)


def _turns(pose: Pose, axes: Array) -> Array:
    """(n, 6, 6) from components of corrections to the axes of the flight; `axes` (n, 3, 3) are how the camera turns
    about its own axes per rad of each rotation component.
    """
    found = np.zeros((axes.shape[0], 6, 6))
    for k, (position, velocity) in enumerate(zip(pose.position, pose.velocity, strict=True)):
        level = flight_axes(position, velocity)
        found[k, :3, :3] = level
        found[k, 3:, 3:] = camera_axes(pose.matrix[k] @ level[0]) @ axes[k]
    return found


def point_sigmas(covariances: Array, places: Array, velocities: Array) -> Array:
    """(n, 3) m, sigmas of points along X, Y, Z of a flight.

    Parameters
    ----------
    covariances : (n, 3, 3)
        m^2, body-fixed.
    places : (n, 3)
        m, body-fixed: where up is.
    velocities : (n, 3)
        Body-fixed, of any length: of the camera that flies over each (`overhead`).
    """
    axes = flight_axes_at(places, velocities)
    return sigmas_along(axes, covariances)


def flight_axes_at(places: Array, velocities: Array) -> Array:
    """(n, 3, 3) rows: unit vectors along, across (left) and up at many places (n, 3), as `frames.flight_axes`."""
    up = places / np.linalg.norm(places, axis=1, keepdims=True)
    along = velocities - up * np.einsum("ni,ni->n", up, velocities)[:, None]
    size = np.linalg.norm(along, axis=1, keepdims=True)
    some = size > _LEVEL * np.linalg.norm(velocities, axis=1, keepdims=True)
    along = np.where(some, along / np.where(some, size, 1.0), np.nan)
    return np.stack([along, np.cross(up, along), up], axis=1)


def overhead(image: PushbroomImage, lines: Array) -> Array:
    """(n, 3) velocities, body-fixed, m per line, of a camera at some lines."""
    return image.pose(lines).velocity


@dataclass(frozen=True, slots=True, eq=False)
class StripCorrections:
    """Corrections of a strip at some times, in the axes of the flight."""

    times: Array
    """(n,) s TDB past J2000."""
    values: Array
    """(n, 6) m along, across and radial, and rad of roll, pitch and yaw."""
    sigmas: Array
    """(n, 6) m and rad, standard deviations of `values`, for sigma0 = 1."""


def strip_corrections(solution: Solution, strip: str | int, times: Array) -> StripCorrections:
    """Corrections of a strip at times (n,) in s TDB past J2000, by the four nodes nearest to each."""
    strip = solution.network.pass_number(strip)
    nodes = solution.network.passes[strip].nodes
    first, basis, _ = nodes.at(times - nodes.epoch, nodes.epoch)
    values = np.einsum("nk,nkc->nc", basis, solution.nodes[strip][first[:, None] + np.arange(SUPPORT)])
    variable = int(solution.network.first_of_passes[strip])
    covariance = np.empty((times.size, 6, 6))
    for k in np.unique(first).tolist():
        mine = first == k
        joint = solution.joint_covariance.of(range(variable + k, variable + k + SUPPORT))
        joint = joint.reshape(SUPPORT, 6, SUPPORT, 6)
        covariance[mine] = np.einsum("np,piqj,nq->nij", basis[mine], joint, basis[mine])
    turn = strip_turns(solution.network, strip, times, solution.settings.angles)
    sigmas = np.sqrt(np.maximum(np.einsum("nij,njk,nik->ni", turn, covariance, turn), 0.0))
    return StripCorrections(times, np.einsum("nij,nj->ni", turn, values), sigmas)


@dataclass(frozen=True, slots=True, eq=False)
class StripReport:
    """Nodes, corrections and trend of one strip."""

    name: str
    """Name of the strip."""
    basis: str
    """Interpolation between its nodes."""
    images: tuple[str, ...]
    """Names of its images."""
    nodes: int
    """Number of nodes."""
    spacing: float
    """s between nodes, on the average."""
    lines: float
    """Lines of the most nadir-looking image between two nodes."""
    ground: float
    """m on the ground between two nodes; NaN where that image misses the body."""
    corrections: StripCorrections
    """Corrections at the nodes within the strip."""
    trend: tuple[tuple[str, str, float, float], ...]
    """Bias and drift of the observed trajectory: "bias" or "drift", component (of the camera's own axes), value and
    sigma in m or rad."""

    @property
    def largest(self) -> Array:
        """(6,) m and rad, largest correction at a node."""
        return np.asarray(np.abs(self.corrections.values).max(axis=0))

    @property
    def mean_sigmas(self) -> Array:
        """(6,) m and rad, mean sigma of the nodes."""
        return np.asarray(self.corrections.sigmas.mean(axis=0))


def strip_reports(solution: Solution) -> list[StripReport]:
    """Reports of all strips, in their order."""
    return [_report(solution, k) for k in range(len(solution.network.passes))]


def node_times(solution: Solution, strip: str | int) -> Array:
    """(k,) s TDB past J2000 of the nodes of a strip."""
    nodes = solution.network.passes[solution.network.pass_number(strip)].nodes
    return nodes.times + nodes.epoch


def _report(solution: Solution, strip: int) -> StripReport:
    one, pictures = solution.network.passes[strip], solution.network.pictures(strip)
    image = pictures[straightest(pictures)]
    start, stop = seconds(image)
    spacing = one.nodes.spacing
    lines = spacing * image.lines / (stop - start)
    _, derivative = image.image_to_ground(np.array([0.5 * image.lines]), np.array([0.5 * image.samples]))
    return StripReport(
        one.name, one.nodes.basis, tuple(picture.name for picture in pictures),
        len(one.nodes), spacing, lines, float(np.linalg.norm(derivative[0, :, 0])) * lines,
        strip_corrections(solution, strip, node_times(solution, strip)), _trend(solution, strip),
    )  # fmt: skip


def _trend(solution: Solution, strip: int) -> tuple[tuple[str, str, float, float], ...]:
    prior, values = solution.network.passes[strip].prior, solution.trends[strip]
    if not isinstance(prior, NodePrior) or not values.size:
        return ()
    variable = int(solution.network.first_of_passes[strip + 1]) - 1
    sigmas = np.sqrt(np.diagonal(solution.joint_covariance.block(variable, variable)))
    biases = int(np.count_nonzero(prior.bias))
    return tuple(
        ("bias" if c < biases else "drift", AXES[component], float(values[c]), float(sigmas[c]))
        for c, component in enumerate(prior.trend_components.tolist())
    )


def prior_sigmas(one: Pass, rows: Array) -> Array:
    """(r,) a-priori sigmas of functions of a pass's nodes; infinite where its prior does not determine all nodes.

    Parameters
    ----------
    one : Pass
        With k nodes; its prior's rows are sparse, and so is what is solved.
    rows : (r, 6 k)
        Per m and rad of the nodes, one after another.
    """
    from scipy.sparse.linalg import splu

    scales = np.concatenate([np.where(np.isfinite(sigmas), sigmas, 1.0) for sigmas in one.sigmas])
    root = _root(one, scales)
    wanted = np.pad(rows, ((0, 0), (0, scales.size - rows.shape[1]))) * scales
    try:
        found = splu((root.T @ root).tocsc()).solve(np.ascontiguousarray(wanted.T))
    except RuntimeError:  # singular: nodes of which nothing is known
        return np.full(rows.shape[0], np.inf)
    return np.asarray(np.sqrt(np.maximum(np.einsum("rc,cr->r", wanted, found), 0.0)))


def _root(one: Pass, scales: Array) -> "csr_array":
    """(rows, columns) whitened rows of the prior on nodes and trend, in units of `scales` (columns,)."""
    from scipy.sparse import csr_array

    first, parts, height = np.concatenate([[0], np.cumsum(one.widths)]), list[tuple[Index, Index, Array]](), 0
    for factor in one.prior.factors(one.nodes):
        for unknown, block in zip(factor.unknowns, factor.blocks, strict=True):
            row, column = np.nonzero(block)
            place = first[unknown] + column
            parts.append((height + row, place, block[row, column] * scales[place]))
        height += factor.blocks[0].shape[0]
    row, column, value = (np.concatenate(part) for part in zip(*parts, strict=True))
    return csr_array((value, (row, column)), shape=(height, scales.size))
