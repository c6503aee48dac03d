"""What the adjustment knows afterwards: sigma0, covariance of the orientation coefficients and of every point.

Covariances are stated for sigma0 = 1, as the a-priori sigmas imply; multiply by sigma0 squared to scale them.
"""

from dataclasses import dataclass

import gtsam
import numpy as np

from mgsgraph.adjustment.graph import BundleGraph, Layout
from mgsgraph.adjustment.graph.bundle import point_key, shared_values, variable_key
from mgsgraph.errors import WeakNetwork
from mgsgraph.factors import evaluation, kernels
from mgsgraph.factors.bundle import Reduction
from mgsgraph.factors.rows import CAUCHY, FIXED, HUBER, NO_LOSS, OUT, PRIOR, Model, Rows
from mgsgraph.geometry.orientation import COMPONENTS
from mgsgraph.geometry.records import Array

_WEAK = 1e-13
"""Eigenvalue of the scaled normal matrix, relative to the largest, below which a direction isn't determined."""
_POORLY = 1e-9
"""The same, to name what made a factorisation fail."""
_NAMED = 0.1
"""Share of a weak direction from which a coefficient is named."""


@dataclass(frozen=True, slots=True)
class Fit:
    """Global figures of merit."""

    squares: float
    """Weighted sum of squares of all rows."""
    observations: int
    """Number of rows, priors among them."""
    unknowns: int
    """Number of unknowns, points among them."""

    @property
    def degrees_of_freedom(self) -> int:
        """Redundancy of the adjustment."""
        return self.observations - self.unknowns

    @property
    def sigma0(self) -> float:
        """A-posteriori standard deviation of unit weight; NaN without redundancy."""
        return float(np.sqrt(self.squares / self.degrees_of_freedom)) if self.degrees_of_freedom > 0 else float("nan")


def residuals(layout: Layout, orientation: Array, points: Array) -> tuple[Array, Array]:
    """Residuals of all rows, taking part or not: (k, 2) pixels and (r,) m, measured minus predicted, layout order."""
    rows = layout.rows
    image, ranges = np.empty((rows.focal.size, 2)), np.empty(rows.range_value.size)
    evaluation.all_residuals(rows, layout.model, orientation, points, image, ranges)
    return image, ranges


def fit(layout: Layout, rows: Rows, orientation: Array, points: Array) -> Fit:
    """Weighted squares (robust weights included), observations and unknowns of the rows that take part."""
    image, ranges = residuals(layout, orientation, points)
    owner = np.repeat(np.arange(rows.point_kind.size), np.diff(rows.ray_first))
    range_owner = np.repeat(np.arange(rows.point_kind.size), np.diff(rows.range_first))
    used = (rows.weight[:, 0] > 0.0) & (rows.point_kind[owner] != OUT)
    range_used = (rows.range_weight > 0.0) & (rows.point_kind[range_owner] != OUT)
    image_squares = np.einsum("ki,ki->k", image * rows.weight, image * rows.weight)[used]
    range_squares = ((ranges * rows.range_weight) ** 2)[range_used]
    known = rows.point_kind == PRIOR
    offset = points - rows.point_start
    owner_of_shift = np.repeat(np.arange(offset.shape[0]), np.diff(rows.shift_first))
    np.subtract.at(offset, owner_of_shift, orientation[rows.shift_column][:, None] * rows.shift_direction)
    ground = np.einsum("nij,nj->ni", rows.point_root[known], offset[known])
    heights = surface_heights(rows, orientation, points) * rows.surface_weight
    on_surface = np.isfinite(heights) & (rows.point_kind != OUT)
    whitened = orientation / layout.sigmas
    parts = [_weighted(image_squares, layout.model), _weighted(range_squares, layout.model), np.sum(ground**2)]
    parts.append(np.sum(heights[on_surface] ** 2))
    priors = int(np.count_nonzero(np.isfinite(layout.sigmas))) + 3 * int(known.sum())
    free = int(np.count_nonzero((rows.point_kind != OUT) & (rows.point_kind != FIXED)))
    return Fit(
        squares=float(sum(parts) + whitened @ whitened),
        observations=2 * int(used.sum()) + int(range_used.sum()) + int(on_surface.sum()) + priors,
        unknowns=layout.columns + 3 * free,
    )


def surface_heights(rows: Rows, orientation: Array, points: Array) -> Array:
    """(n,) m, heights above the terrain model of points that have a surface row; NaN for the others."""
    heights = np.empty(points.shape[0])
    evaluation.all_heights(rows, orientation, points, heights)
    return heights


def _weighted(squares: Array, model: Model) -> float:
    """Sum of squares with the loss's weights (see kernels.robust)."""
    if model.loss == NO_LOSS:
        return float(squares.sum())
    if model.loss == HUBER:
        return float((squares * np.minimum(1.0, model.width / np.sqrt(np.maximum(squares, 1e-300)))).sum())
    ratio = squares / model.width**2
    if model.loss == CAUCHY:
        return float((squares / (1.0 + ratio)).sum())
    return float((squares * np.maximum(1.0 - ratio, 0.0) ** 2).sum())


def orientation_covariance(graph: BundleGraph, orientation: Array) -> Array:
    """(columns, columns) joint covariance of all orientation coefficients, m and rad, by GTSAM's elimination."""
    layout = graph.layout
    adjusted = layout.variables.adjusted()
    if not adjusted:
        return np.zeros((0, 0))
    values = shared_values(layout, orientation)
    try:
        marginals = gtsam.Marginals(graph.graph.linearize(values), values)
    except RuntimeError as error:
        if "Indeterminate" not in str(error):
            raise
        raise WeakNetwork(*weak_directions(layout, graph.reduction(orientation), _POORLY)) from None
    keys = [variable_key(layout, v) for v in adjusted]
    joint = marginals.jointMarginalCovariance(keys).fullMatrix()
    return np.asarray(0.5 * (joint + joint.T))


def point_covariances(layout: Layout, rows: Rows, orientation: Array, points: Array, joint: Array) -> Array:
    """(n, 3, 3) m^2 covariances of points, layout order, by back-substitution in the kernel; zero when fixed or out.

    S_p = V^-1 + V^-1 W' S_eo W V^-1 with the joint covariance S_eo of the orientation variables that see the point.
    """
    blocks = []
    for group in range(len(layout.group_variables)):
        columns = layout.group_columns(group)
        blocks.append(joint[np.ix_(columns, columns)].ravel())
    covariances = np.zeros((points.shape[0], 3, 3))
    flat = np.concatenate(blocks) if blocks else np.zeros(0)
    kernels.point_covariances(rows, layout.groups, layout.model, orientation, flat, points, covariances)
    return covariances


def explicit_covariances(
    layout: Layout, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> tuple[Array, Array]:
    """The same two, (columns, columns) and (n, 3, 3), from GTSAM's marginals of the explicit graph."""
    marginals = gtsam.Marginals(graph.linearize(values), values)
    keys = [variable_key(layout, v) for v in layout.variables.adjusted()]
    joint = np.asarray(marginals.jointMarginalCovariance(keys).fullMatrix()) if keys else np.zeros((0, 0))
    covariances = np.zeros((layout.rows.point_kind.size, 3, 3))
    for i in range(covariances.shape[0]):
        if values.exists(point_key(i)):
            covariances[i] = marginals.marginalCovariance(point_key(i))
    return joint, covariances


def require_strength(layout: Layout, reduction: Reduction) -> None:
    """Raise WeakNetwork, naming the directions that nothing determines, before anything is solved.

    Only needed where some coefficient has no prior: a prior on each determines all of them.
    """
    if np.any(np.isinf(layout.sigmas)):
        weak, count = weak_directions(layout, reduction, _WEAK)
        if count:
            raise WeakNetwork(weak, count)


def weak_directions(layout: Layout, reduction: Reduction, limit: float) -> tuple[list[str], int]:
    """The weakest directions of the orientation in words (two at most), and how many there are.

    Weak is what has an eigenvalue of the normal matrix, in units of `Layout.scales`, below `limit` of the largest.
    """
    scales = layout.scales
    normal = np.diag(np.where(np.isinf(layout.sigmas), 0.0, 1.0))
    for group, block in enumerate(reduction.blocks):
        columns = layout.group_columns(group)
        normal[np.ix_(columns, columns)] += block * scales[columns][:, None] * scales[columns]
    values, vectors = np.linalg.eigh(normal)
    weak = vectors[:, values < limit * max(values[-1], 1.0)]
    return [_in_words(layout, weak[:, k]) for k in range(min(weak.shape[1], 2))], weak.shape[1]


def _in_words(layout: Layout, direction: Array) -> str:
    """A direction of the orientation vector: which coefficients of which images make it up."""
    terms = ("constant", "linear", "quadratic", "cubic")
    share = direction**2 / np.sum(direction**2)
    names: list[str] = []
    for column in np.argsort(-share)[:3]:
        if share[column] < _NAMED and names:
            break
        variable = max(v for v in layout.variables.adjusted() if layout.columns_of(v).start <= column)
        inside = int(column) - layout.columns_of(variable).start
        if variable >= layout.variables.images:
            shifted = layout.network.shift_names[variable - layout.variables.images]
            names.append(f"{('east', 'north')[inside]} shift of {shifted}")
            continue
        image, (power, component) = variable, divmod(inside, 6)
        term = terms[power] if power < len(terms) else f"u^{power}"
        names.append(f"{term} {COMPONENTS[component]} of image {layout.network.images[image].name}")
    return " with ".join(names)
