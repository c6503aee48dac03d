"""Unknowns that images share, and whether they can be separated from along-track pointing.

*Likeness* is the cosine of the angle between what two unknowns do to the measures, points free and priors left out: at
1 the measures cannot separate them, whatever the sigmas are. *Correlation* is the posterior's, priors included.
"""

from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.separability import information
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import SharedKind, SharedUnknown
from mgsgraph.network.shared import ground_shift

_COMPARED = 0.1
"""Share of the largest effect on the ground from which an image is compared at all."""
_TAKES_PART = 0.1
"""Share of the largest pitch from which an image is named among those that together do the same."""


@dataclass(frozen=True, slots=True)
class SharedEstimate:
    """One column of a shared unknown: its value, and what it may be taken for. Units of reports: s, mrad, m, ppm."""

    name: str
    """Name of the unknown."""
    kind: SharedKind
    """Kind of the unknown."""
    axis: str
    """x, y or z of the camera, of a boresight or lever arm; else empty."""
    unit: str
    """s, mrad, m or ppm."""
    value: float
    """Estimated value, in that unit."""
    sigma: float
    """Its standard deviation, for sigma0 = 1."""
    prior_sigma: float
    """Its a-priori standard deviation."""
    image: str
    """Image whose constant pitch (`pitch_axis`) it is most like; empty where all are held."""
    correlation: float
    """Correlation with that pitch."""
    likeness: float
    """Likeness with that pitch, 0 to 1."""
    together: float
    """Likeness with the best mixture of constant pitches of all its images, 0 to 1."""
    mixture: tuple[str, ...]
    """Images of this mixture."""
    ground: float
    """m on the ground, per unit of it, in the middle of that image; NaN where it moves none there."""


def shared_estimates(solution: Solution) -> list[SharedEstimate]:
    """All columns of all shared unknowns, in their order."""
    return [one for k in range(len(solution.network.shared)) for one in _columns(solution, k)]


def _columns(solution: Solution, k: int) -> list[SharedEstimate]:
    shared, values = solution.network.shared[k], solution.shared[k]
    factor, unit = shared.kind.reported
    sigmas = np.sqrt(np.diag(solution.shared_covariance(k)))
    images = shared.images[solution.network.with_polynomial[shared.images]]
    correlation, likeness, shares, together = _with_pitch(solution, k, images)
    found = []
    ground = np.array([_grounds(solution, shared, j) for j in images.tolist()]).reshape(images.size, shared.kind.width)
    for c, axis in enumerate(shared.kind.components):
        size = np.nan_to_num(ground[:, c], nan=1.0) if images.size else np.zeros(0)
        compared = size >= _COMPARED * size.max(initial=0.0)  # a pitch of an image that it does not move is no rival
        rival = np.where(compared, np.maximum(np.abs(correlation[c]), likeness[c]), -1.0)
        nearest = int(np.argmax(rival)) if images.size else -1
        named = images[nearest] if images.size else next(iter(shared.images.tolist()), 0)
        strong = np.abs(shares[c]) > _TAKES_PART * np.abs(shares[c]).max(initial=0.0)
        found.append(SharedEstimate(
            shared.name, shared.kind, axis, unit,
            float(values[c]) / factor, float(sigmas[c]) / factor, float(shared.sigmas[c]) / factor,
            solution.network.images[named].name if images.size else "",
            float(correlation[c, nearest]) if images.size else float("nan"),
            float(likeness[c, nearest]) if images.size else float("nan"),
            float(together[c]),
            tuple(solution.network.images[j].name for j in images[strong].tolist()),
            float(_grounds(solution, shared, int(named))[c]) * factor,
        ))  # fmt: skip
    return found


def _grounds(solution: Solution, shared: SharedUnknown, image: int) -> Array:
    """(c,) metres per s, rad, m or 1 of each column, in the middle of an image; NaN where it moves nothing there."""
    if not (shared.kind.moves_instrument or shared.kind is SharedKind.ALTIMETER_BORESIGHT):
        return np.full(shared.kind.width, np.nan)
    return np.asarray(np.linalg.norm(ground_shift(solution.network.images[image], shared.kind), axis=1))


def _with_pitch(solution: Solution, k: int, images: Index) -> tuple[Array, Array, Array, Array]:
    """Correlation and likeness (c, m) of an unknown's columns with the constant pitches of images, how much (c, m) of
    each pitch makes up their best mixture, and the likeness (c,) with that.
    """
    joint, variable = solution.joint_covariance, solution.shared_variable(k)
    root, width, m = joint.square_root, solution.network.shared[k].kind.width, images.size
    axes = [_axes(solution, j) for j in images.tolist()]
    pitches = [pitch_axis(solution.network.images[j]) for j in images.tolist()]
    correlation = np.empty((width, m))
    for place, j in enumerate(images.tolist()):
        pitch = pitches[place] @ axes[place]
        variance = pitch @ joint.block(j, j)[3:6, 3:6] @ pitch
        own = np.diag(joint.block(variable, variable))
        correlation[:, place] = pitch @ joint.block(j, variable)[3:6] / np.sqrt(variance * own)
    columns = np.concatenate([
        *(root.first[j] + np.arange(3, 6) for j in images.tolist()), root.first[variable] + np.arange(width)
    ])  # fmt: skip
    priors = [solution.network.priors[j].sigmas[0, 3:] for j in images.tolist()]
    known = information(root, columns) - np.diag(1.0 / np.concatenate([*priors, solution.network.shared[k].sigmas])**2)
    turn = np.zeros((columns.size, m + width))
    for place in range(m):
        turn[3 * place : 3 * place + 3, place] = np.linalg.solve(axes[place], pitches[place])
    turn[3 * m :, m:] = np.eye(width)
    normal = turn.T @ known @ turn
    size = np.sqrt(np.maximum(np.diag(normal), np.finfo(np.float64).tiny))
    cosine = normal / np.outer(size, size)
    shares = np.linalg.lstsq(cosine[:m, :m], cosine[:m, m:], rcond=1e-10)[0]
    together = np.sqrt(np.clip(np.einsum("mc,mc->c", shares, cosine[:m, m:]), 0.0, 1.0))
    return correlation, np.minimum(np.abs(cosine[m:, :m]), 1.0), (shares / size[:m, None]).T, together


def pitch_axis(image: PushbroomImage) -> Array:
    """(3,) unit, in camera axes: along the detector, so that turning about it lifts the camera's view forward."""
    middle = np.array([0.5 * image.samples])
    along = np.append(image.interior.focal_plane(middle)[1][0], 0.0)
    pose = image.pose(np.array([0.5 * image.lines]))
    forward = np.cross(along, [0.0, 0.0, 1.0]) @ pose.matrix[0] @ pose.velocity[0]
    return np.asarray(along / np.linalg.norm(along) * np.sign(forward))


def _axes(solution: Solution, image: int) -> Array:
    """(3, 3) how the camera turns about its axes, per rad of each rotation component, in the middle of an image."""
    picture = solution.network.images[image]
    middle = np.array([0.5 * picture.lines])
    return np.asarray(solution.correction(image).axes(picture.pose(middle), picture.moments(middle))[0])
