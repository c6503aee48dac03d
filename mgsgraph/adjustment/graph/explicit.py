"""The explicit form: one GTSAM factor per observation, points as variables.

An independent reference for small networks: GTSAM optimises it and states its marginals, without the kernel, and
without the elimination of the bundle form. No command makes it.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import gtsam
import numpy as np

from mgsgraph.adjustment.covariances import considered_information
from mgsgraph.adjustment.graph.bundle import point_key, prior_factors, shared_values, variable_key
from mgsgraph.adjustment.graph.layout import Layout
from mgsgraph.adjustment.marginals import JointCovariance, dense_covariance
from mgsgraph.factors.collinearity import ImageRay
from mgsgraph.factors.explicit import Correction, Measurement, measurement_factor
from mgsgraph.factors.ground import GroundPrior
from mgsgraph.factors.laser_range import Range
from mgsgraph.factors.pose import about_axes, opk_paper, opk_peer
from mgsgraph.factors.stereo_surface import StereoHeight
from mgsgraph.factors.surface import SurfaceHeight
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.rows import (
    CAMERA,
    CAUCHY,
    FIXED,
    GROUND,
    HUBER,
    IMAGE,
    NO_LOSS,
    OPK_PAPER,
    OPK_PEER,
    OUT,
    PREDICTED,
    RANGE,
    STEREO,
    TUKEY,
    Model,
    Rows,
    one_observation,
)

_ATTITUDES = {CAMERA: about_axes, OPK_PAPER: opk_paper, OPK_PEER: opk_peer}


def measurement(rows: Rows, model: Model) -> tuple[Measurement, Correction]:
    """The measurement of a single observation (`kernel.rows.one_observation`), and how its columns of unknowns act on
    it.
    """
    kind, width, terms = int(rows.observation_kind[0]), int(rows.observation_width[0]), int(rows.observation_terms[0])
    rates = terms if kind == IMAGE and model.line == PREDICTED else 0
    singles = int(rows.observation_shared[0])
    numbers, last = rows.data.tolist(), rows.data.size - singles * width
    end = last - (min(terms, 1) if rows.observation_rate[0] else terms + rates)
    basis, slopes = numbers[end : end + terms], numbers[end + terms : last] if rates else [0.0] * terms
    if rows.observation_rate[0] and terms:
        basis = [numbers[end] ** t for t in range(terms)]
        slopes = [t * numbers[end] ** max(t - 1, 0) * float(rows.observation_rate[0]) for t in range(terms)]
    columns = rows.entry_column[: terms + singles].tolist()
    correction = Correction(
        width,
        6 if width >= 6 else 3,
        tuple(columns[:terms]),
        tuple(basis),
        tuple(slopes),
        tuple(columns[terms:]),
        tuple(tuple(numbers[last + e * width : last + (e + 1) * width]) for e in range(singles)),
    )
    return _measurement(rows, model, kind, numbers[:end]), correction


def _measurement(rows: Rows, model: Model, kind: int, constants: list[float]) -> Any:
    if kind == IMAGE:
        return _image_ray(model, constants, float(rows.observation_focal[0]))
    if kind == RANGE:
        return Range(constants[3], tuple(constants[:3]))
    if kind == GROUND:
        return GroundPrior(tuple(constants[:3]), tuple(constants[3:]))
    if kind == STEREO:
        return StereoHeight(tuple(constants[:3]), tuple(constants[3:6]), constants[6])
    frame = rows.terrain_frame.tolist()
    return SurfaceHeight(rows.terrain, tuple(frame[:2]), tuple(frame[2:]))


def _image_ray(model: Model, constants: list[float], focal: float) -> ImageRay:
    """Constants in the order of `kernel.tile.load_observation`."""
    angles = 4 if model.angles == CAMERA else 3
    centre, nominal, detector, rest = np.split(np.array(constants), np.cumsum([3, angles, 2]))
    nothing = (0.0, 0.0, 0.0)
    if model.line == PREDICTED:
        (velocity, angular_rate, slope, offset), scale = map(tuple, np.split(rest, [3, 6, 8])), None
    else:
        velocity, angular_rate, slope, offset = nothing, nothing, nothing[:2], (0.0,)
        scale = tuple(rest[:2]), tuple(rest[2:])
    return ImageRay(
        _ATTITUDES[model.angles],
        tuple(centre),
        tuple(nominal),
        velocity,
        angular_rate,
        tuple(detector),
        slope,
        scale,
        offset[0],
        focal,
    )


def observation_factor(
    keys: Sequence[int],
    widths: Sequence[int],
    point_key: int | Array,
    rows: Rows,
    model: Model,
    noise: gtsam.noiseModel.Base,
    label: str,
) -> gtsam.CustomFactor:
    """Factor of a single observation (`kernel.rows.one_observation`); other parameters as of `measurement_factor`."""
    return measurement_factor(keys, widths, point_key, *measurement(rows, model), noise, label)


_ESTIMATORS: dict[int, Any] = {
    HUBER: gtsam.noiseModel.mEstimator.Huber,
    CAUCHY: gtsam.noiseModel.mEstimator.Cauchy,
    TUKEY: gtsam.noiseModel.mEstimator.Tukey,
}


def observation_noise(kind: int, weights: Array, model: Model) -> gtsam.noiseModel.Base:
    """Noise of an observation from its weights (2,); the robust loss is for image rays, ranges and stereo heights."""
    if kind == GROUND:
        return gtsam.noiseModel.Unit.Create(3)
    diagonal = gtsam.noiseModel.Diagonal.Sigmas(1.0 / weights[: 2 if kind == IMAGE else 1])
    if model.loss == NO_LOSS or kind not in (IMAGE, RANGE, STEREO):
        return diagonal
    return gtsam.noiseModel.Robust.Create(_ESTIMATORS[model.loss].Create(model.width), diagonal)


def explicit_graph(
    layout: Layout, rows: Rows, orientation: Array, points: Array
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Graph on orientation and point variables, and its values.

    Parameters
    ----------
    layout : Layout
    rows : Rows
        The layout's rows, with some left out.
    orientation : (columns,)
        m and rad.
    points : (n, 3)
        m, in the layout's order.

    Returns
    -------
    graph, values
        Points are `point_key(i)`, i being their place in the layout; those left out or fixed are no variables.
    """
    graph, values = gtsam.NonlinearFactorGraph(), shared_values(layout, orientation)
    for factor in prior_factors(layout):
        graph.add(factor)
    for pattern, first, count, _, place in rows.piece.tolist():
        for i in range(first, first + count):
            if rows.kind[i] == OUT:
                continue
            if rows.kind[i] != FIXED:
                values.insert(point_key(i), points[i])
            for j in range(layout.patterns.first[pattern + 1] - layout.patterns.first[pattern]):
                weights = rows.weight[:, place + j * count + i - first]
                if weights[0] > 0.0:
                    graph.add(_factor(layout, rows, i, pattern, j, weights))
    return graph, values


def _factor(layout: Layout, rows: Rows, i: int, pattern: int, j: int, weights: Array) -> gtsam.CustomFactor:
    """Factor of the j-th observation of a point (place in the layout)."""
    patterns, network = layout.patterns, layout.network
    s = patterns.first[pattern] + j
    variables = list(dict.fromkeys(patterns.entry_variable[patterns.entry[s] : patterns.entry[s + 1]].tolist()))
    label = f"point {network.points.ids[layout.point_order[i]]}"
    if patterns.image[s] >= 0:
        label += f", image {network.images[patterns.image[s]].name}"
    return observation_factor(
        [variable_key(layout, v) for v in variables],
        [int(layout.variables.width[v]) for v in variables],
        rows.start[i] if rows.kind[i] == FIXED else point_key(i),
        one_observation(rows, layout.groups, i, j),
        layout.model,
        observation_noise(int(patterns.kind[s]), weights, layout.model),
        label,
    )


def explicit_covariances(
    layout: Layout, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> tuple[JointCovariance, Array]:
    """Joint covariance of the shared unknowns and covariances (n, 3, 3) of points, from the explicit graph: GTSAM
    eliminates the points, and gives their marginals.
    """
    linear, first_points, shared = graph.linearize(values), gtsam.Ordering(), gtsam.Ordering()
    points = [i for i in range(layout.rows.kind.size) if values.exists(point_key(i))]
    for i in points:
        first_points.push_back(point_key(i))
    for v in layout.variables.adjusted():
        shared.push_back(variable_key(layout, v))
    _, reduced = linear.eliminatePartialMultifrontal(first_points)
    joint = _joint(layout, reduced, shared)
    if layout.prior.considered:
        for factor in _considered_factors(layout, joint):
            reduced.push_back(factor)
            linear.push_back(factor)
        joint = _joint(layout, reduced, shared)
    covariances, found = np.zeros((layout.rows.kind.size, 3, 3)), gtsam.Marginals(linear, values)
    for i in points:
        covariances[i] = found.marginalCovariance(point_key(i))
    return joint, covariances


def _joint(layout: Layout, reduced: gtsam.GaussianFactorGraph, shared: gtsam.Ordering) -> JointCovariance:
    """Joint covariance of a linear system of the shared unknowns, inverted as one matrix."""
    units = np.outer(layout.scales, layout.scales)
    covariance = np.linalg.inv(reduced.hessian(shared)[0] * units) * units
    return dense_covariance(layout.variables.first, layout.variables.width, covariance)


def _considered_factors(layout: Layout, joint: JointCovariance) -> Iterator[gtsam.HessianFactor]:
    """The information on considered unknowns that is to be added, as GTSAM's factors."""
    for (v, w), block in considered_information(layout, joint):
        keys = variable_key(layout, v), variable_key(layout, w)
        zeros = [np.zeros(size) for size in block.shape]
        if v == w:
            yield gtsam.HessianFactor(keys[0], block, zeros[0], 0.0)
        else:
            empty = [np.zeros((size, size)) for size in block.shape]
            yield gtsam.HessianFactor(*keys, empty[0], block, zeros[0], empty[1], zeros[1], 0.0)
