"""The explicit form: one factor per observation, points as variables; a reference for small problems and teaching."""

from typing import Any

import gtsam
import numpy as np

from mgsgraph.adjustment.graph.bundle import point_key, prior_factors, shared_values, variable_key
from mgsgraph.adjustment.graph.layout import Layout
from mgsgraph.adjustment.graph.observations import observation_factor
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.rows import (
    CAUCHY,
    FIXED,
    GROUND,
    HUBER,
    IMAGE,
    NO_LOSS,
    OUT,
    RANGE,
    STEREO,
    TUKEY,
    Model,
    Rows,
    one_observation,
)

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
            for j in range(len(layout.patterns.observations[pattern])):
                weights = rows.weight[:, place + j * count + i - first]
                if weights[0] > 0.0:
                    graph.add(_factor(layout, rows, i, pattern, j, weights))
    return graph, values


def _factor(layout: Layout, rows: Rows, i: int, pattern: int, j: int, weights: Array) -> gtsam.CustomFactor:
    """Factor of the j-th observation of a point (place in the layout)."""
    observation, network = layout.patterns.observations[pattern][j], layout.network
    variables = observation.variables
    label = f"point {network.points.ids[layout.point_order[i]]}"
    if observation.image >= 0:
        label += f", image {network.images[observation.image].name}"
    return observation_factor(
        [variable_key(layout, v) for v in variables],
        [int(layout.variables.width[v]) for v in variables],
        rows.start[i] if rows.kind[i] == FIXED else point_key(i),
        one_observation(rows, layout.groups, i, j),
        layout.model,
        observation_noise(observation.kind, weights, layout.model),
        label,
    )


def all_points(layout: Layout, values: gtsam.Values, points: Array) -> Array:
    """(n, 3) m: the places that are variables, in place of those given."""
    result = points.copy()
    for i in range(result.shape[0]):
        if values.exists(point_key(i)):
            result[i] = values.atPoint3(point_key(i))
    return np.asarray(result)
