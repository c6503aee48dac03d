"""Both forms of the graph, side by side.

*Bundle form*, of every adjustment: orientation variables and their priors, points solved and eliminated inside
(variable projection; Golub & Pereyra 1973). *Explicit form*, an independent reference for small networks: one GTSAM
factor per observation, points as variables; GTSAM optimises it and states its marginals without the kernel.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, Protocol

import gtsam
import numpy as np

from mgsgraph.adjustment.graph.layout import Layout
from mgsgraph.adjustment.sparse_cholesky import Factor
from mgsgraph.compiled import in_threads
from mgsgraph.factors.collinearity import ImageRay
from mgsgraph.factors.explicit import Correction, Measurement, measurement_factor
from mgsgraph.factors.ground import GroundPrior
from mgsgraph.factors.laser_range import Range
from mgsgraph.factors.pose import about_axes, opk_paper, opk_peer
from mgsgraph.factors.priors import linear_prior, zero_prior
from mgsgraph.factors.stereo_surface import StereoHeight
from mgsgraph.factors.surface import SurfaceHeight
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel import sweep
from mgsgraph.kernel.covariance import NUMBERS
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
    Groups,
    Model,
    NormalBlocks,
    Rows,
    one_observation,
    partition,
)
from mgsgraph.kernel.sweep import SYSTEM, Reduction, all_residuals, point_covariances, reduce

MISFIT, SHARE, EFFECT, BETWEEN = slice(0, 2), slice(2, 4), slice(4, 6), 6
"""Columns of the kernel's numbers of the first two rows of observations (t, 8), side by side, lest each look-up cost
several: whitened residuals; diagonal of H; m that an error of one sigma moves the point; H between the two rows."""
_AT_A_TIME = 1 << 17
"""Observations that a thread takes at a time: their 3 x 7 numbers are 22 MB."""


def of_rows(values: Array, into: Array) -> None:
    """What observations say of themselves (t, 8), from the kernel's numbers of their rows (t, 3, 7)."""
    moved = values[:, :2, 4:]
    into[:, MISFIT], into[:, BETWEEN] = values[:, :2, 0], values[:, 0, 2]
    into[:, SHARE] = values[:, [0, 1], [1, 2]]
    into[:, EFFECT] = np.sqrt(np.einsum("tik,tik->ti", moved, moved))


def numbers(
    rows: Rows,
    groups: Groups,
    target: NormalBlocks,
    model: Model,
    orientation: Array,
    joint: Array,
    points: Array,
    ground: Index | None = None,
) -> tuple[Array, Array]:
    """What observations say of themselves (t, 8), and all that some of them (g,) do (g, 3, 7); other parameters as of
    `kernel.sweep.reliability`.
    """
    ground = np.zeros(0, dtype=np.int64) if ground is None else ground
    begins = np.append(rows.piece[:, 4], rows.weight.shape[1])
    found, chosen = np.empty((begins[-1], 8)), np.empty((ground.size, 3, NUMBERS))
    order = np.argsort(ground)

    def share(ends: tuple[int, int]) -> None:
        first, last = ends
        mine, point = partition(rows, first, last), int(rows.piece[first, 1])
        places = points[point : point + mine.kind.size]
        values = sweep.reliability(mine, groups, target, model, orientation, joint, places)
        of_rows(values, found[begins[first] : begins[last]])
        own = order[slice(*np.searchsorted(ground, [begins[first], begins[last]], sorter=order))]
        chosen[own] = values[ground[own] - begins[first]]

    edges = np.unique(np.searchsorted(begins, [*range(0, begins[-1], _AT_A_TIME), begins[-1]])).tolist()
    in_threads(share, pairwise(edges))
    return found, chosen


def orientation_key(image: int) -> int:
    """GTSAM key of an image's orientation coefficients."""
    return int(gtsam.symbol("o", image))


def point_key(point: int) -> int:
    """GTSAM key of a ground point."""
    return int(gtsam.symbol("p", point))


def shift_key(profile: int) -> int:
    """GTSAM key of the horizontal shift of a laser profile; after these, of the terrain model and of what is shared."""
    return int(gtsam.symbol("s", profile))


def variable_key(layout: Layout, variable: int) -> int:
    """GTSAM key of a shared unknown."""
    images = layout.variables.images
    return orientation_key(variable) if variable < images else shift_key(variable - images)


def shared_values(layout: Layout, vector: Array) -> gtsam.Values:
    """GTSAM values of the vector of shared unknowns (columns,)."""
    values = gtsam.Values()
    for v in layout.variables.adjusted():
        values.insert(variable_key(layout, v), vector[layout.columns_of(v)])
    return values


def shared_vector(layout: Layout, values: gtsam.Values) -> Array:
    """Vector of shared unknowns (columns,) of GTSAM values."""
    vector = np.zeros(layout.columns)
    for v in layout.variables.adjusted():
        vector[layout.columns_of(v)] = values.atVector(variable_key(layout, v))
    return vector


def prior_factors(layout: Layout) -> Iterator[gtsam.NonlinearFactor]:
    """What is known of the shared unknowns beforehand, as GTSAM's factors."""
    for v in layout.variables.adjusted():
        if v not in layout.prior.joined or np.any(layout.prior.weights[layout.columns_of(v)]):
            yield zero_prior(variable_key(layout, v), layout.variables.prior_sigmas[layout.columns_of(v)])
    for factor in layout.prior.factors:
        yield linear_prior([variable_key(layout, v) for v in factor.variables], factor.blocks, factor.target)


class Solving(Protocol):
    """Factored equations."""

    def solve(self, right: Array) -> Array:
        """Solution (columns,), m and rad, for a right side per m and rad."""
        ...


def sparse_factor(layout: Layout, reduction: Reduction, damping: float = 0.0) -> Factor:
    """Cholesky factor of the full linear system at a reduction, damped in units of the unknowns' scales.

    Raises NotDefinite.
    """
    assert reduction.blocks is not None
    return factor_of_blocks(layout, reduction.blocks, damping)


def factor_of_blocks(layout: Layout, blocks: Array, damping: float = 0.0) -> Factor:
    """The same, of a reduced normal matrix (flat blocks of a layout)."""
    flat = blocks + layout.prior_information if layout.prior_information.size else blocks
    return layout.cholesky.factor(flat, layout.prior.weights**2 + damping / layout.scales**2, layout.scales)


class Sweeper:
    """Who goes over all points: this process's threads; a cluster's workers or a GPU where they take over what is here.
    Rows are a layout's, or made of them.
    """

    remark = ""
    """What a user should know of who it was."""

    def reduction(
        self, layout: Layout, rows: Rows, orientation: Array, task: int, points: Array | Reduction | None
    ) -> Reduction:
        """All points solved (and eliminated), see `kernel.sweep.reduce`; `points` as in `BundleGraph.reduction`."""
        begin = points.points if isinstance(points, Reduction) else points
        return reduce(rows, layout.groups, layout.blocks.target, layout.model, orientation, task, begin)

    def covariances(self, layout: Layout, rows: Rows, orientation: Array, joint: Array, points: Array) -> Array:
        """Covariances (n, 3, 3) of the points in m^2, zero for known ones."""
        return point_covariances(rows, layout.groups, layout.blocks.target, layout.model, orientation, joint, points)

    def residuals(self, layout: Layout, rows: Rows, orientation: Array, points: Array) -> Array:
        """Residuals (t, 2) of all observations: image rays in pixels, ranges and heights in m."""
        return all_residuals(rows, layout.groups, layout.blocks.target, layout.model, orientation, points)

    def leverage(self, layout: Layout, rows: Rows, orientation: Array, joint: Array, points: Array) -> Array:
        """Residuals (t, 8) of all observations beside their leverage, see `numbers`."""
        return numbers(rows, layout.groups, layout.blocks.target, layout.model, orientation, joint, points)[0]

    def factor(self, layout: Layout, reduction: Reduction, damping: float) -> Solving:
        """Factor of the full linear system at a reduction, see `sparse_factor`."""
        return sparse_factor(layout, reduction, damping)


IN_PROCESS = Sweeper()


class BundleGraph:
    """Factor graph on orientation variables alone; points are solved inside.

    Parameters
    ----------
    layout : Layout
    rows : Rows, optional
        The layout's rows with some left out (`Layout.active`); all of them when absent.
    sweeper : Sweeper
        Who goes over the points.
    """

    def __init__(self, layout: Layout, rows: Rows | None = None, sweeper: Sweeper = IN_PROCESS) -> None:
        self.layout, self.sweeper = layout, sweeper
        self.rows = layout.rows if rows is None else rows

    def reduction(self, orientation: Array, task: int = SYSTEM, points: Array | Reduction | None = None) -> Reduction:
        """All points solved (and eliminated) at an orientation vector (columns,), beginning at `points` (n, 3), or
        where an earlier reduction ended.
        """
        return self.sweeper.reduction(self.layout, self.rows, orientation, task, points)

    def cost(self, reduction: Reduction) -> float:
        """Full cost: of all points, and of the priors on the shared unknowns."""
        return reduction.cost + self.layout.prior.cost(reduction.orientation)

    def gradient(self, reduction: Reduction) -> Array:
        """(columns,) of the full cost, per m and rad."""
        return reduction.gradient + self.layout.prior.gradient(reduction.orientation)

    def factor(self, reduction: Reduction, damping: float = 0.0) -> Factor:
        """Cholesky factor of the full linear system at a reduction, damped in units of the unknowns' scales.

        Raises NotDefinite.
        """
        return sparse_factor(self.layout, reduction, damping)



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
    directions = tuple(tuple(numbers[last + e * width : last + (e + 1) * width]) for e in range(singles))
    correction = Correction(
        width, 6 if width >= 6 else 3, tuple(columns[:terms]), tuple(basis), tuple(slopes), tuple(columns[terms:]),
        directions,
    )  # fmt: skip
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
        _ATTITUDES[model.angles], tuple(centre), tuple(nominal), velocity, angular_rate, tuple(detector), slope, scale,
        offset[0], focal,
    )  # fmt: skip


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
