"""Undetected errors of inputs: errors of clock, position, pointing, terrain heights and ranges that no test finds,
and by how much they move the points (external reliability; Baarda 1968, Foerstner & Wrobel 2016, 4.6).

An error of the nominal orientation that corrections can follow, by coefficients c, is the same as if the priors were
wrong by c: it stands in their rows alone. With b what an error of one unit adds to the whitened residuals before the
adjustment, its test is w = b'v / sqrt(b'C b) (`residual_rows`), standard normal if the error is zero. It is found with
probability POWER from the size on that shifts w by its critical value and a quantile; until then it moves the shared
unknowns by -S T'b a unit, and the points with them.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.covariances import Linearised
from mgsgraph.adjustment.frames import FLIGHT_NAMES, axes_of_flight
from mgsgraph.analysis.residual_rows import ResidualRows
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.records import Array, Index, place_of
from mgsgraph.kernel.rows import FIXED, GROUND, IMAGE, OUT, RANGE, SURFACE
from mgsgraph.network import Network, PointClass, SharedKind
from mgsgraph.network.shared import image_effect
from mgsgraph.record import Record

POWER = 0.999
"""Probability with which an error of the stated size is found."""
_POINTS = 50
"""Points whose motion is computed, evenly spread over the network's."""
SHIFTS = ("eastward shift", "northward shift", "upward shift")
"""Errors of control."""
_KNOWN = {
    PointClass.TIE: "control points", PointClass.LASER: "laser shots", PointClass.CONTROL: "control points",
    PointClass.POST: "posts of the terrain model",
}  # fmt: skip
"""What points with a-priori coordinates are: those of a network, beside its free ties, are control as well."""
_NOTHING = 1e-3
"""Share of an error that residuals show, which is rounding, or what is not linear."""
_MORE = 1.5
"""Factor from which on it matters what a terrain model adds to a test."""
_MOST_IMAGES = 12
"""Images up to which errors of single ones are looked at, not only those that all have in common."""


@dataclass(frozen=True, slots=True)
class Undetected(Record):
    """A possible error of an input, and how large it may be without being found.

    Examples
    --------
    >>> clock = mgsgraph.verdict(solution).undetected[0]
    >>> clock.what, clock.of, clock.unit, clock.effect > 0.0
    ('clock', 'all images', 's', True)
    """

    what: str
    """What is wrong: clock, roll, terrain height ..."""
    of: str
    """Of which image, or of all."""
    unit: str
    """s, m or rad; empty of a ratio."""
    test: float
    """Test of this error, standard normal if there is none; NaN where nothing tests it."""
    p_value: float
    """Chance of a test so large, or larger; NaN where nothing tests it."""
    size: float
    """Found with probability `POWER` from this size on; infinite where nothing tests it."""
    moves: float
    """m per unit: by how much it moves the points, root of the mean square."""
    in_sigmas: float
    """Per unit, the same in stated sigmas of the points."""
    size_without_terrain: float = math.nan
    """The same as `size` should the relief of a terrain model fit at a wrong place; NaN where that changes little."""
    effect_without_terrain: float = math.nan
    """m, by which the points may be off then."""

    @property
    def tested(self) -> bool:
        """Whether anything tests it."""
        return math.isfinite(self.size)

    @property
    def effect(self) -> float:
        """m, by which the points may be off without a sign."""
        return self.size * self.moves

    @property
    def effect_in_sigmas(self) -> float:
        """The same in stated sigmas of the points."""
        return self.size * self.in_sigmas


@dataclass(frozen=True, slots=True, eq=False)
class _Error:
    """An error of one unit."""

    what: str
    of: str
    unit: str
    rows: Index
    """(q,) of `ResidualRows`."""
    column: Array
    """(q,) what it adds to the whitened residuals there."""
    control: tuple[int, int] = (-1, 0)
    """Kind of the rows of points, and axis of a shift, or image, -1 for all; kind -1 of an error of the priors."""


def undetected(
    rows: ResidualRows, critical: float, without_terrain: ResidualRows | None = None
) -> tuple[Undetected, ...]:
    """Errors that are looked at, with what is left of each when its test finds nothing.

    Parameters
    ----------
    rows : ResidualRows
    critical : float
        Value that a standard normal variable has to exceed to be significant.
    without_terrain : ResidualRows, optional
        The same as if the terrain model weren't there. Its relief tests small errors alone: after large ones it may fit
        at a wrong place.
    """
    errors = _undetected(rows, critical)
    if without_terrain is None:
        return errors
    bare = {(error.what, error.of): error for error in _undetected(without_terrain, critical)}
    return tuple(
        replace(error, size_without_terrain=without.size, effect_without_terrain=without.size * without.moves)
        if (without := bare.get((error.what, error.of))) is not None and without.size > _MORE * error.size else error
        for error in errors
    )  # fmt: skip


def _undetected(rows: ResidualRows, critical: float) -> tuple[Undetected, ...]:
    from scipy.special import ndtr, ndtri  # slow to import

    results, motions = list[Undetected](), Motions(rows.at)
    for error in _errors(rows):
        column = error.column[:, None]
        variance, total = float(rows.variance(error.rows, column)[0, 0]), float(error.column @ error.column)
        test, p, size = math.nan, math.nan, math.inf
        if variance > _NOTHING * total:
            test = float(error.column @ rows.residuals[error.rows]) / math.sqrt(variance)
            p, size = 2.0 * float(ndtr(-abs(test))), (critical + float(ndtri(POWER))) / math.sqrt(variance)
        shared = -rows.at.joint.square_root.covariance_times(np.asarray(rows.through[error.rows].T @ column))[:, 0]
        results.append(Undetected(error.what, error.of, error.unit, test, p, size, *motions.of(shared, error.control)))
    return tuple(results)


def _errors(rows: ResidualRows) -> Iterator[_Error]:
    """All errors that are looked at."""
    network, layout = rows.at.network, rows.at.layout
    prior_rows = layout.prior.design
    priors = rows.begin_of_priors + np.arange(prior_rows.shape[0])
    adjusted = [j for j in range(len(network.images)) if not network.held[j]]
    owners = [[j] for j in adjusted] if len(adjusted) <= _MOST_IMAGES else []
    for images in ([adjusted] if len(adjusted) > 1 else []) + owners:
        of = "all images" if len(images) > 1 else network.images[images[0]].name
        for what, unit, columns in _of_orientation(rows.at, images):
            if np.any(column := np.asarray(prior_rows @ columns)):
                yield _Error(what, of, unit, priors, column)
        chosen = rows.of_kind(IMAGE)
        chosen = chosen[(rows.component[chosen] == 1) & np.isin(network.rays.image[rows.measure[chosen]], images)]
        if chosen.size:
            off = rows.scale[chosen] * from_middle(network, rows.measure[chosen])
            yield _Error("focal length", of, "", chosen, off, (IMAGE, images[0] if len(images) == 1 else -1))
    known = np.unique(network.points.classes[rows.point[rows.of_kind(GROUND)]])
    ground = " and ".join(dict.fromkeys(_KNOWN[PointClass(each)] for each in known.tolist()))
    for kind, of in ((GROUND, ground), (SURFACE, "the terrain model"), (RANGE, "the laser")):
        chosen = rows.of_kind(kind)
        for axis, what in enumerate(("range",) if kind == RANGE else SHIFTS) if chosen.size else ():
            up = rows.at.layout.network_order(rows.at.points)[rows.point[chosen]]
            yield _Error(what, of, "m", chosen, _per_meter(kind, axis, rows.by_point[chosen], up), (kind, axis))


def _of_orientation(at: Linearised, images: list[int]) -> Iterator[tuple[str, str, Array]]:
    """Name, unit and coefficients (columns,) of errors that some images have in common: clocks, and the constant terms
    along the axes of the flight.
    """
    network = at.network
    try:
        times = [
            {j: image_effect(network.images[j], kind, at.settings.angles)[0] for j in images}
            for kind in (SharedKind.ATTITUDE_TIME, SharedKind.POSITION_TIME)
        ]
    except InputError:  # how the body turns is not known, or the image is too long for a polynomial
        times = []
    parts = [_joined(at, effects) for effects in times]
    if parts:
        yield from (("clock", "s", parts[0] + parts[1]), ("attitude time", "s", parts[0]))
        yield "position time", "s", parts[1]
    axes = {j: np.linalg.inv(axes_of_flight(network.images[j], at.settings.angles)[2]) for j in images}
    for k, name in enumerate(FLIGHT_NAMES):
        along = _joined(at, {j: np.asarray(turn[:, k][None]) for j, turn in axes.items()})
        yield name if k > 2 else f"{name} position", "rad" if k > 2 else "m", along


def _joined(at: Linearised, effects: dict[int, Array]) -> Array:
    """(columns,) coefficients of images' corrections; the nodes of a pass have the constant terms of its first."""
    network, layout = at.network, at.layout
    joined = np.zeros(layout.columns)
    for j, effect in effects.items():
        if network.pass_of[j] >= 0:
            continue
        columns = layout.columns_of(j)
        terms = min(len(effect), (columns.stop - columns.start) // 6)
        joined[columns.start : columns.start + 6 * terms] = effect[:terms].ravel()
    for pass_, first in network.numbered_passes:
        of_pass = [effects[j] for j in pass_.images.tolist() if j in effects]
        for variable in range(first, first + len(pass_.nodes)) if of_pass else ():
            joined[layout.columns_of(variable)] = of_pass[0][0]
    return joined


def from_middle(network: Network, rays: Index) -> Array:
    """(q,) px, samples of some rays (q,) from their images' middle: by so much a doubled focal length moves them."""
    middle = np.array([0.5 * image.samples for image in network.images])
    return np.asarray(network.rays.places[rays, 1] - middle[network.rays.image[rays]])


class Motions:
    """What errors do to some points, by their places in the layout (m,); evenly spread ones when absent."""

    def __init__(self, at: Linearised, index: Index | None = None) -> None:
        if index is None:
            index = np.flatnonzero((at.rows.kind != OUT) & (at.rows.kind != FIXED))
            index = index[:: max(1, index.size // _POINTS)]
        self.follow: Array = np.zeros((index.size, 3, at.layout.columns))
        """(m, 3, columns) m per m and rad of the shared unknowns."""
        self.noise: Array = np.zeros((index.size, 3, 3))
        """(m, 3, 3) m^2, covariances with the shared unknowns known."""
        self._control = {
            (kind, axis): np.zeros((index.size, 3)) for kind in (GROUND, SURFACE, RANGE) for axis in range(len(SHIFTS))
        }
        singles = range(len(at.network.images)) if len(at.network.images) <= _MOST_IMAGES else range(0)
        self._control |= {(IMAGE, j): np.zeros((index.size, 3)) for j in (-1, *singles)}
        ray_of = place_of(at.layout.observation_rows.rays, at.rows.weight.shape[1])
        covariances = np.zeros((index.size, 3, 3))
        for k, place in enumerate(index.tolist()):
            piece = int(at.layout.patterns.piece_of(np.array([place]))[0])
            pattern, begin, count, _, among = at.rows.piece[piece].tolist()
            rows = at.rows_inside(piece, np.array([place - begin]))
            try:
                (follows,), (noise,) = rows.eliminated()
            except np.linalg.LinAlgError:  # nearly parallel rays: it moves anywhere
                covariances[k] = np.eye(3)
                continue
            self.follow[k, :, at.layout.variables.columns_of_all(rows.variables)] = follows.T
            self.noise[k] = noise @ noise.T
            covariances[k] = self.noise[k] + follows @ at.joint.of(rows.variables) @ follows.T
            kinds = at.rows.observation_kind[at.rows.pattern_observation[pattern] + rows.observation]
            for (kind, axis), moved in self._control.items():
                by_point = rows.by_point[0][kinds == kind]
                if kind != IMAGE and by_point.size:
                    up = np.broadcast_to(at.points[place], by_point.shape)
                    moved[k] = -self.noise[k] @ by_point.T @ _per_meter(kind, axis, by_point, up)
            samples = np.flatnonzero((kinds == IMAGE) & (rows.row == 1))
            rays = ray_of[among + rows.observation[samples] * count + place - begin]
            off = from_middle(at.network, rays) / at.network.rays.sigmas[rays, 1]
            each = -np.einsum("ij,rj,r->ri", self.noise[k], rows.by_point[0][samples], off)
            self._control[IMAGE, -1][k] = each.sum(axis=0)
            for j in singles:
                self._control[IMAGE, j][k] = each[at.network.rays.image[rays] == j].sum(axis=0)
        self.whitening: Array = np.linalg.inv(np.linalg.cholesky(covariances))
        """(m, 3, 3) inverse roots of their covariances."""

    def of(self, shared: Array, control: tuple[int, int]) -> tuple[float, float]:
        """m, and in stated sigmas, by which the points move with the shared unknowns (columns,) and with control of a
        kind that is off by 1 m along an axis; roots of the mean squares.
        """
        moved = self.follow @ shared + self._control.get(control, 0.0)
        whitened = np.einsum("nij,nj->ni", self.whitening, moved)
        return math.sqrt(np.mean(np.sum(moved**2, axis=1))), math.sqrt(np.mean(whitened**2))


def _per_meter(kind: int, axis: int, by_point: Array, places: Array) -> Array:
    """(q,) what an error of 1 m adds to whitened rows of a kind with derivatives (q, 3) at places (q, 3): a range is
    measured minus predicted, control of places and heights predicted minus known.
    """
    if kind == RANGE:
        return np.asarray(np.linalg.norm(by_point, axis=1))
    return -np.asarray(np.einsum("qc,qc->q", by_point, east_north_up(places)[:, axis]))
