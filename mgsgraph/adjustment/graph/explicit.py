"""The explicit form: one factor per row set, points as variables. The reference, for small problems and teaching."""

from typing import Any

import gtsam
import numpy as np

from mgsgraph.adjustment.graph.bundle import orientation_key, point_key, shared_values, shift_key, variable_key
from mgsgraph.adjustment.graph.layout import Layout
from mgsgraph.factors.priors import ground_prior, shifted_ground_prior, zero_prior
from mgsgraph.factors.projection import projection_factor
from mgsgraph.factors.range import range_factor
from mgsgraph.factors.rows import CAUCHY, FIXED, HUBER, NO_LOSS, OUT, PRIOR, TUKEY, Model, Rows
from mgsgraph.factors.surface import surface_factor
from mgsgraph.geometry.records import Array

_ESTIMATORS: dict[int, Any] = {
    HUBER: gtsam.noiseModel.mEstimator.Huber,
    CAUCHY: gtsam.noiseModel.mEstimator.Cauchy,
    TUKEY: gtsam.noiseModel.mEstimator.Tukey,
}


def _noise(sigmas: Array, model: Model) -> gtsam.noiseModel.Base:
    diagonal = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    if model.loss == NO_LOSS:
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
    network = layout.network
    for v in layout.variables.adjusted():
        graph.add(zero_prior(variable_key(layout, v), layout.sigmas[layout.columns_of(v)]))
    for i in range(rows.point_kind.size):
        kind = rows.point_kind[i]
        if kind == OUT:
            continue
        place = point_key(i)
        if kind == FIXED:
            place = rows.point_start[i]
        else:
            values.insert(place, points[i])
            if kind == PRIOR:
                graph.add(_prior(layout, rows, i))
            if rows.surface_weight[i] > 0.0:
                terrain = shift_key(len(network.shift_names) - 1) if rows.surface_column[i] >= 0 else None
                graph.add(surface_factor(place, terrain, rows, i, 1.0 / rows.surface_weight[i]))
        for k in range(rows.ray_first[i], rows.ray_first[i + 1]):
            if rows.weight[k, 0] > 0.0:
                image = int(network.rays.image[layout.ray_order[k]])
                label = f"point {network.points.ids[layout.point_order[i]]}, image {network.images[image].name}"
                key = None if network.held[image] else orientation_key(image)
                noise = _noise(1.0 / rows.weight[k], layout.model)
                graph.add(projection_factor(key, place, rows, k, layout.model, noise, label))
        for r in range(rows.range_first[i], rows.range_first[i + 1]):
            if rows.range_weight[r] > 0.0:
                image = int(network.ranges.image[layout.range_order[r]])
                key = None if network.held[image] else orientation_key(image)
                noise = _noise(np.array([1.0 / rows.range_weight[r]]), layout.model)
                graph.add(range_factor(key, place, rows, r, noise))
    return graph, values


def _prior(layout: Layout, rows: Rows, i: int) -> gtsam.NonlinearFactor:
    """Prior of a constrained point, moved by its profile's shift where it belongs to one."""
    mine = slice(int(rows.shift_first[i]), int(rows.shift_first[i + 1]))
    if mine.start == mine.stop:
        return ground_prior(point_key(i), rows.point_start[i], rows.point_root[i])
    shifts = layout.network.shifts
    assert shifts is not None
    profile = int(shifts.profile[layout.point_order[i]])
    return shifted_ground_prior(
        point_key(i), shift_key(profile), rows.point_start[i], rows.point_root[i], rows.shift_direction[mine]
    )
