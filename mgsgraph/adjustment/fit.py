"""Residuals of all rows, their weighted squares and sigma0; orientations that an adjustment has moved by far more than
their a-priori sigmas.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from mgsgraph.adjustment.graph import Layout
from mgsgraph.adjustment.graph.forms import IN_PROCESS, Sweeper
from mgsgraph.adjustment.graph.variables import footprint_shifts, shared_values
from mgsgraph.factors.loss import cauchy, huber, tukey
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.records import Array, Index, Mask, no_rows
from mgsgraph.kernel.rows import CAUCHY, FIXED, HUBER, NO_LOSS, OUT, PRIOR, TUKEY, Model, Rows
from mgsgraph.network import Network
from mgsgraph.record import Record


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Residuals of all rows, taking part or not, measured minus predicted; network order."""

    image: Array
    """(k, 2) pixels."""
    ranges: Array
    """(r,) m."""
    heights: Array
    """(n,) m above the terrain model; NaN for points without such a row, or without terrain."""
    stereo: Array
    """(n,) m above the stereo surface, along its normal; NaN for points without such a row."""


def residuals(layout: Layout, orientation: Array, points: Array, sweeper: Sweeper = IN_PROCESS) -> Residuals:
    """Residuals with the shared unknowns (columns,) and points (n, 3), layout order."""
    places = layout.observation_rows
    values = sweeper.residuals(layout, layout.rows, orientation, points)
    undefined = np.broadcast_to(np.nan, points.shape[0])  # it takes no memory
    heights, stereo = undefined, undefined
    if places.on_terrain.size:
        heights = undefined.copy()
        heights[places.on_terrain] = values[places.heights, 0]
    if layout.stereo is not None:
        stereo = undefined.copy()
        stereo[layout.stereo.points] = values[places.stereo, 0]
    return Residuals(values[places.rays], values[places.ranges, 0], heights, stereo)


_LOSSES: dict[int, Callable[..., Any]] = {HUBER: huber, CAUCHY: cauchy, TUKEY: tukey}


class Squares(NamedTuple):
    """Of one kind of measures; m of them take part."""

    point: Index
    """(m,) network point of each."""
    image: Index
    """(m,) its image; -1 for a measure in none."""
    values: Array
    """(m,) whitened squares, of the rows of a measure together; NaN where the point is behind the camera."""
    rows: int
    """Rows of a measure."""
    robust: bool
    """Whether a robust loss acts on it."""

    def costs(self, model: Model) -> Array:
        """(m,) what each adds to the cost."""
        return np.asarray(self._loss(model)[0])

    def weighted(self, model: Model) -> Array:
        """(m,) the squares with the loss's weights."""
        return np.asarray(self.values * self._loss(model)[1])

    def _loss(self, model: Model) -> tuple[Any, Any]:
        """Costs and weights."""
        if not self.robust or model.loss == NO_LOSS:
            return 0.5 * self.values, 1.0
        result: tuple[Any, Any] = _LOSSES[model.loss](self.values, model.width)
        return result


def squares_of(
    layout: Layout, rows: Rows, orientation: Array, points: Array, residual: Residuals
) -> dict[str, Squares]:
    """Squares of each kind of measures: image rays, ranges, a-priori places, heights above the terrain model and above
    stereo surfaces.

    Parameters
    ----------
    layout : Layout
    rows : Rows
        Those that take part.
    orientation : (columns,) array
        Shared unknowns, m and rad.
    points : (n, 3) array
        m, layout order.
    residual : Residuals
        At these.
    """
    network, places, kind = layout.network, layout.observation_rows, layout.network_order(rows.kind)
    rays = _taking((rows.weight[0, places.rays] > 0.0) & (kind[network.rays.point] != OUT))
    whitened = residual.image[rays] / network.rays.sigmas[rays]
    ranges = _taking((rows.weight[0, places.ranges] > 0.0) & (kind[network.ranges.point] != OUT))
    with_prior = np.flatnonzero(kind == PRIOR)
    offset = (layout.network_order(points) - network.points.places)[with_prior]
    offset -= _shifts(layout, orientation, with_prior)
    ground = np.linalg.solve(network.points.covariances[with_prior], offset[:, :, None])[:, :, 0]
    low = np.flatnonzero(np.isfinite(residual.heights) & (kind != OUT))
    sigmas = network.surface.sigmas[low] if network.surface is not None else np.zeros(0)
    range_squares = (residual.ranges[ranges] / network.ranges.sigmas[ranges]) ** 2
    on_stereo, stereo_squares = _of_stereo(layout, rows, residual)

    def nowhere(of: Index) -> Index:
        return np.full(of.size, -1)

    return {
        "rays": Squares(
            network.rays.point[rays], network.rays.image[rays], np.einsum("ki,ki->k", whitened, whitened), 2, True
        ),
        "ranges": Squares(network.ranges.point[ranges], network.ranges.image[ranges], range_squares, 1, True),
        "places": Squares(with_prior, nowhere(with_prior), np.einsum("ki,ki->k", offset, ground), 3, False),
        "heights": Squares(low, nowhere(low), (residual.heights[low] / sigmas) ** 2, 1, False),
        "stereo heights": Squares(on_stereo, nowhere(on_stereo), stereo_squares, 1, True),
    }


def _taking(mask: Mask) -> Index | slice:
    """Index for a true mask (n,): usually all, without a copy."""
    return slice(None) if np.all(mask) else np.flatnonzero(mask)


def _of_stereo(layout: Layout, rows: Rows, residual: Residuals) -> tuple[Index, Array]:
    """(m,) points whose heights above stereo surfaces take part, and their squares in sigmas."""
    control, stereo = layout.network.stereo, layout.stereo
    if control is None or stereo is None:
        return no_rows(), np.zeros(0)
    kind = layout.network_order(rows.kind)[stereo.points]
    points = stereo.points[(rows.weight[0, layout.observation_rows.stereo] > 0.0) & (kind != OUT)]
    return points, (residual.stereo[points] / control.sigmas[points]) ** 2


def _shifts(layout: Layout, orientation: Array, points: Index) -> Array:
    """(p, 3) m: how far profiles' shifts and altimeters' boresights move the a-priori places of network points."""
    network = layout.network
    shift = footprint_shifts(network, shared_values(network, layout.variables, orientation))[points]
    if network.shifts is None:
        return shift
    profile = network.shifts.profile[points]
    moved = profile >= 0
    first = layout.variables.first[len(network.images) + profile[moved]]
    east_and_north = orientation[np.stack([first, first + 1], axis=1)]
    shift[moved] += np.einsum("pk,pkj->pj", east_and_north, east_north(network.points.places[points[moved]]))
    return shift



def errors_with_footprints(layout: Layout, orientation: Array, points: Array) -> Array:
    """(r,) m: errors of ranges by those of their a-priori footprints, where points (n, 3), layout order, and shared
    unknowns (columns,) are right.
    """
    places, of, shares = layout.network.points.places, layout.network.ranges.point, layout.network.ranges.shares
    if shares is None:
        return np.zeros(of.size)
    errors = places[of] + _shifts(layout, orientation, of) - layout.network_order(points)[of]
    return np.asarray(np.einsum("ri,ri->r", shares, np.nan_to_num(errors)))


ABSURD = 10.0
"""sigma0 from which on sigmas are not the cause: squares are a hundred times as large as stated."""


@dataclass(frozen=True, slots=True)
class Fit(Record):
    """Global figures of merit.

    Examples
    --------
    >>> fit = solution.fit
    >>> fit.observations, fit.unknowns, fit.degrees_of_freedom
    (180, 120, 60)
    >>> round(fit.sigma0, 2), fit.absurd
    (1.22, False)
    """

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

    @property
    def absurd(self) -> bool:
        """Whether sigma0 is too large to come from sigmas that are merely too small."""
        return self.sigma0 > ABSURD


def fit(layout: Layout, rows: Rows, orientation: Array, points: Array, residual: Residuals) -> Fit:
    """Weighted squares (robust weights included), observations and unknowns of the rows that take part."""
    kind = layout.network_order(rows.kind)
    kinds = squares_of(layout, rows, orientation, points, residual).values()
    corrections = layout.prior.residuals(orientation)
    free = int(np.count_nonzero((kind != OUT) & (kind != FIXED)))
    return Fit(
        squares=float(sum(squares.weighted(layout.model).sum() for squares in kinds) + corrections @ corrections),
        observations=sum(squares.rows * squares.values.size for squares in kinds) + layout.prior.rows,
        unknowns=layout.columns + 3 * free,
    )


STRAINED = 5.0
"""A-priori sigmas; of 10,000 coefficients none is off by so many by chance."""
IMPOSSIBLE = 100.0
"""A-priori sigmas from which on an input is wrong, for any sigma0: with sigmas stated ten times too small, corrections
reach 50 at most."""


class Strained(NamedTuple):
    """An image whose orientation was moved too far."""

    image: int
    """Number of the image; of a pass its first image."""
    most: float
    """Largest of its corrections, in a-priori sigmas."""

    @property
    def impossible(self) -> bool:
        """Whether an input is wrong, not a stated sigma."""
        return self.most > IMPOSSIBLE


def strained_orientations(
    network: Network, coefficients: Sequence[Array], nodes: Sequence[Array]
) -> tuple[Strained, ...]:
    """Images whose own corrections exceed their sigmas by more than noise explains, worst first: sigma0 hides them
    behind many rays.

    Parameters
    ----------
    network : Network
    coefficients : sequence of array
        Of each image, m and rad, as `Solution.coefficients`.
    nodes : sequence of array
        Of each pass, m and rad, as `Solution.nodes`: against their a-priori sigmas, trend and all.
    """
    candidates = list[Strained]()
    for pass_, moved in zip(network.passes, nodes, strict=True):
        candidates.append(Strained(int(pass_.images[0]), _most(moved, pass_.prior.own_sigmas(pass_.nodes))))
    for j in np.flatnonzero(network.with_polynomial).tolist():
        candidates.append(Strained(j, _most(coefficients[j], network.priors[j].sigmas)))
    return tuple(sorted((image for image in candidates if image.most > STRAINED), key=lambda image: -image.most))


def _most(corrections: Array, sigmas: Array) -> float:
    """Largest of corrections in sigmas."""
    return float(np.abs(corrections / sigmas).max())
