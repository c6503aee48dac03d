"""A network as a GTSAM factor graph: one factor per measurement, priors on what images and profiles share.

The explicit form, for GTSAM's own optimizers, iSAM2 and Marginals, for factors of one's own, and as a reference for the
bundle form that `adjust` takes: it shares no line with the compiled kernel and its layout. Both take the equations of
`factors`, the images of `geometry`, and what shared unknowns do from `network.effects`.

    case, network, solution ──> factor_graph ──> graph, values, keys ──> any GTSAM optimizer ──> solution_of
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import gtsam
import numpy as np

from mgsgraph.adjustment.keys import Adjusted, Keys, Source, network_and_settings
from mgsgraph.adjustment.optimize import optimize
from mgsgraph.adjustment.settings import LOSS_WIDTHS, SolverSettings
from mgsgraph.errors import InputError
from mgsgraph.factors.effects import (
    LOOK,
    POSITION,
    RANGE,
    SLOPE,
    STATE,
    Effect,
    OrientationImagesEffect,
    PolynomialEffect,
    constant,
    orientation_polynomial,
    range_bias,
)
from mgsgraph.factors.ground import ground_prior
from mgsgraph.factors.priors import linear_prior, orientation_prior
from mgsgraph.factors.projection import pushbroom_projection
from mgsgraph.factors.ranging import laser_range
from mgsgraph.factors.stereo_surface import stereo_height
from mgsgraph.factors.surface import terrain_height
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.camera import Detector
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.intersection import intersect_rays
from mgsgraph.geometry.orientation import SUPPORT, OrientationImages
from mgsgraph.geometry.records import Array, Mask, finite_rows
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.names import grouped
from mgsgraph.network import HELD, Network
from mgsgraph.network.effects import SharedEffects, common_lifts, common_looks, crossover_rows, known_motions
from mgsgraph.network.parallel import parallel
from mgsgraph.network.records import LinearRows
from mgsgraph.network.shared import SharedKind

MARGIN = 100.0
"""Lines by which a measured line and the predicted one may be apart for a ray to find its orientation images."""


class FactorGraph(NamedTuple):
    """What `factor_graph` makes.

    Examples
    --------
    >>> made = mgsgraph.factor_graph(network)
    >>> made.graph.size(), made.values.size()
    (74, 30)
    """

    graph: gtsam.NonlinearFactorGraph
    """Factors."""
    values: gtsam.Values
    """Where to begin: zero for corrections; known places, or where nominal rays cross, for points. With Tukey's loss,
    which begins nowhere else well: the optimum of Huber's."""
    keys: Keys
    """Which key is whose."""


@dataclass(frozen=True, slots=True, eq=False)
class Selected:
    """Measures that take part, and start values."""

    places: Array
    """(n, 3) m, of points."""
    nominal: Array
    """(n, 3) m, where the nominal orientation puts them."""
    rays: Mask
    """(k,)"""
    ranges: Mask
    """(r,)"""
    points: Mask
    """(n,)"""
    on_stereo: Mask
    """(n,) points whose heights above stereo surfaces take part."""
    values: Sequence[Array]
    """Of all variables."""


def factor_graph(source: Source) -> FactorGraph:
    """The whole network as a GTSAM graph: one factor per measurement, priors on the unknowns.

    Parameters
    ----------
    source : Case, Network or Solution
        Of a solution values are those found; what it rejected is left out.

    Returns
    -------
    FactorGraph
        Graph, values, keys. Ground points are Point3 (m, body-fixed), all else Vectors (m, rad).

    Raises
    ------
    InputError
        When an image doesn't see a point that is to lie on its stereo surface.

    Examples
    --------
    >>> graph, values, keys = mgsgraph.factor_graph(network)
    >>> found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    >>> gtsam.Marginals(graph, found).marginalCovariance(keys.point("TIE00001")).shape
    (3, 3)
    """
    network, settings = network_and_settings(source)
    selected = _of_solution(source) if isinstance(source, Adjusted) else nominal_selection(network)
    values, keys = gtsam.Values(), Keys(network)
    for v in _adjusted(network):
        values.insert(keys.variable(v), selected.values[v])
    for i in np.flatnonzero(selected.points & (network.points.kinds != PointKind.FIXED)).tolist():
        values.insert(keys.point(i), selected.places[i])
    if settings.loss == "tukey" and not isinstance(source, Adjusted):
        values = _begun(network, settings, keys, selected, values)
    return FactorGraph(_graph(network, settings, keys, selected), values, keys)


def _graph(network: Network, settings: SolverSettings, keys: Keys, selected: Selected) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    for factor in (*prior_factors(network, keys), *measurement_factors(network, settings, keys, selected)):
        graph.add(factor)
    return graph


def _begun(
    network: Network, settings: SolverSettings, keys: Keys, selected: Selected, values: gtsam.Values
) -> gtsam.Values:
    """Start of Tukey's loss: the optimum of Huber's, reached by sigmas that become narrower."""
    plain, convex = (replace(settings, loss=loss, loss_width=None) for loss in ("none", "huber"))
    graph = _graph(network, plain, keys, selected)
    largest = max((graph.at(i).error(values) for i in range(graph.size())), default=0.0)
    for factor in settings.narrowing(float(np.sqrt(2.0 * largest))):
        rays, ranges, stereo = network.rays, network.ranges, network.stereo
        wide = replace(
            network, rays=replace(rays, sigmas=rays.sigmas * factor),
            ranges=replace(ranges, sigmas=ranges.sigmas * factor),
            stereo=None if stereo is None else replace(stereo, sigmas=stereo.sigmas * factor),
        )  # fmt: skip
        graph = _graph(wide, convex, keys, selected)
        values = optimize(graph, values, cost_tolerance=1e-4).values
    return values


def with_factors(
    network: Network, factors: Iterable[gtsam.NonlinearFactor], values: gtsam.Values | None = None
) -> Network:
    """The same network with factors of one's own on the unknowns that points share: as linear rows, for `adjust`, too.

    Parameters
    ----------
    network : Network
        What they are to be added to.
    factors : iterable of gtsam.NonlinearFactor
        On keys of `Keys` but those of points: a factor on a point is for `factor_graph`, `optimize`, `solution_of`.
        Robust ones keep the weights that they have where they are linearized.
    values : gtsam.Values, optional
        Where they are linearized; the nominal orientation when absent. Linear factors need none.

    Raises
    ------
    InputError
        For a factor on a ground point, or on a key of something else.

    Examples
    --------
    >>> graph, values, keys = mgsgraph.factor_graph(network)
    >>> sigmas = np.tile([5.0, 5.0, 5.0, 1e-3, 1e-3, 1e-3], 3)  # m and rad
    >>> noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    >>> orientation = gtsam.PriorFactorVector(keys.image("SIM/A"), np.zeros(18), noise)
    >>> solution = mgsgraph.adjust_network(mgsgraph.with_factors(network, [orientation]))
    """
    keys, at, widths = Keys(network), gtsam.Values() if values is None else gtsam.Values(values), network.widths
    rows = list(network.linear)
    for factor in factors:
        keys_of = list(factor.keys())
        variables = [keys.number(key) for key in keys_of]
        for key, v in zip(keys_of, variables, strict=True):
            if not at.exists(key):
                at.insert(key, np.zeros(widths[v]))
        jacobian, right = gtsam.JacobianFactor(factor.linearize(at)).jacobian()
        order = sorted(range(len(variables)), key=variables.__getitem__)
        edges = np.cumsum([0, *(widths[v] for v in variables)])
        blocks = [jacobian[:, edges[k] : edges[k + 1]] for k in range(len(variables))]
        begun = np.concatenate([at.atVector(key) for key in keys_of])
        rows.append(
            LinearRows(tuple(variables[k] for k in order), tuple(blocks[k] for k in order), right + jacobian @ begun)
        )
    return replace(network, linear=tuple(rows))


def measurement_factors(
    network: Network, settings: SolverSettings, keys: Keys, selected: Selected
) -> Iterator[gtsam.NonlinearFactor]:
    """One factor of each selected measurement: a-priori positions, rays, ranges, heights."""
    shared = SharedEffects(network, settings.angles)
    moves = [_Moves(network, keys, j, shared) for j in range(len(network.images))]
    yield from _grounds(network, keys, selected)
    yield from _rays(network, keys, selected, settings, moves)
    yield from _ranges(network, keys, selected, settings, moves)
    yield from _heights(network, keys, selected)
    yield from _stereo_heights(network, keys, selected, settings, moves)


def nominal_selection(network: Network) -> Selected:
    """All determined points with their measures, at the nominal orientation."""
    rays, n = network.rays, len(network.points)
    origins, looks = np.empty((rays.point.size, 3)), np.empty((rays.point.size, 3))
    for j, image in enumerate(network.images):
        in_image = rays.image == j
        origins[in_image], looks[in_image] = image.sightlines(*rays.places[in_image].T)
    crossing, _, angles = intersect_rays(origins, looks, rays.point, n)
    given = finite_rows(network.points.places) & (network.points.kinds != PointKind.FREE)
    places = np.where(given[:, None], network.points.places, crossing)
    used = ~(network.undetermined | parallel(network, np.nan_to_num(angles)))
    for i in np.flatnonzero(used & ~finite_rows(places)).tolist():
        k = int(np.flatnonzero(rays.point == i)[0])
        places[i] = network.images[rays.image[k]].image_to_ground(*rays.places[[k]].T)[0][0]
    values = [np.zeros(width) for width in network.widths]
    begin, on_stereo = places, np.zeros(n, dtype=bool)
    if network.stereo is not None:
        on_stereo = used & (network.stereo.surface >= 0)
        if network.stereo.starts is not None:
            begin = np.where(np.isfinite(network.stereo.starts), network.stereo.starts, places)
    return Selected(begin, places, used[rays.point], used[network.ranges.point], used, on_stereo, values)


def _of_solution(solution: Adjusted) -> Selected:
    nominal = nominal_selection(solution.network)
    return replace(
        nominal, places=solution.places, rays=solution.rays_used, ranges=solution.ranges_used,
        points=solution.determined, on_stereo=solution.stereo_used, values=solution.values,
    )  # fmt: skip


def _adjusted(network: Network) -> list[int]:
    """Variables that are unknown."""
    images = np.flatnonzero(network.with_polynomial).tolist()
    return [*images, *range(len(network.images), len(network.widths))]


# --- factors


def prior_factors(network: Network, keys: Keys) -> Iterator[gtsam.NonlinearFactor]:
    """Priors of shared unknowns; considered ones are held."""
    for j in np.flatnonzero(network.with_polynomial).tolist():
        yield orientation_prior(keys.variable(j), network.priors[j].sigmas.ravel())
    for name, terms in zip(network.shift_names, network.shift_terms, strict=True):
        held = [HELD if term.horizontal and name in network.considered else 1.0 for term in terms]
        yield orientation_prior(keys.profile(name), np.array([term.sigma for term in terms]) * held)
    for shared in network.shared:
        considered = shared.name in network.considered
        yield orientation_prior(keys.shared(shared.name), shared.sigmas * (HELD if considered else 1.0))
    for pass_, first in network.numbered_passes:
        for factor in pass_.prior.factors(pass_.nodes):
            members = [keys.variable(first + k) for k in factor.unknowns]
            yield linear_prior(members, factor.blocks, np.zeros(factor.blocks[0].shape[0]))
    links = list(network.common_links)
    linked = {row.variables[-1] for row in links}
    for v in range(int(network.first_of_passes[-1]), len(network.widths)):
        if v not in linked:
            yield orientation_prior(keys.variable(v), np.ones(network.widths[v]))
    for row in (*links, *network.linear, *crossover_rows(network)):
        yield linear_prior([keys.variable(v) for v in row.variables], row.blocks, row.target)


def _movers(network: Network, keys: Keys, of_ranges: bool = False) -> dict[int, list[PolynomialEffect]]:
    """Of each point the unknowns that move its a-priori position; `of_ranges`: without those that act on ranges."""
    return grouped(
        (i, constant(keys.variable(variable), POSITION, motion.T))
        for points, variables, motions, on_ranges in known_motions(network) if not (of_ranges and on_ranges)
        for i, variable, motion in zip(points.tolist(), variables.tolist(), motions, strict=True)
    )  # fmt: skip


def _grounds(network: Network, keys: Keys, selected: Selected) -> Iterator[gtsam.NonlinearFactor]:
    points, movers = network.points, _movers(network, keys)
    for i in np.flatnonzero(selected.points & (points.kinds == PointKind.CONSTRAINED)).tolist():
        yield ground_prior(keys.point(i), points.places[i], points.covariances[i], movers.get(i, []))


def _heights(network: Network, keys: Keys, selected: Selected) -> Iterator[gtsam.NonlinearFactor]:
    """Heights above the terrain model."""
    surface = network.surface
    if surface is None:
        return
    spline = surface.grid.spline()
    lifts = {int(i): lift for each in common_lifts(network, selected.nominal) for i, lift in zip(*each, strict=True)}
    shared = network.common_variables[1].tolist()
    for i in np.flatnonzero(selected.points & np.isfinite(surface.sigmas)).tolist():
        moved = []
        if network.terrain_moves:
            motion = surface.directions(selected.nominal[[i]])[0]
            moved = [constant(keys.variable(network.first_shared - 1), POSITION, motion.T)]
        if i in lifts:
            moved.append(constant(keys.variable(shared[i]), POSITION, lifts[i].T))
        yield terrain_height(_point(network, keys, i), spline, float(surface.sigmas[i]), moved)


def _stereo_heights(
    network: Network, keys: Keys, selected: Selected, settings: SolverSettings, moves: "Sequence[_Moves]"
) -> Iterator[gtsam.NonlinearFactor]:
    control = network.stereo
    for s in range(0 if control is None else len(control.surfaces)):
        assert control is not None
        numbers = control.images[s].tolist()
        for i in np.flatnonzero(selected.on_stereo & (control.surface == s)).tolist():
            pixels = [network.images[j].ground_to_image(selected.nominal[[i]])[0][0] for j in numbers]
            near = [(float(line), float(sample)) for line, sample in pixels]
            if not np.all(np.isfinite(near)):
                problem, expected = "on a stereo surface whose images don't see it", "points that both images show"
                raise InputError(f"ground point {network.points.ids[i]}", problem, expected)
            flat = control.level is not None and control.level[i]
            yield stereo_height(
                _point(network, keys, i),
                control.surfaces[s],
                [_Mounted.of(network, j) for j in numbers],
                [moves[j].of_ray(*pixel) for j, pixel in zip(numbers, near, strict=True)],
                float(control.sigmas[i]),
                angles=settings.angles,
                near=near,
                level=east_north(selected.nominal[[i]])[0].T if flat else None,
                robust=_robust(settings),
                label=f"point {network.points.ids[i]}, height above stereo surface {s}",
            )


def _point(network: Network, keys: Keys, i: int) -> int | Array:
    """Key of a point, or its position where that is known."""
    return network.points.places[i] if network.points.kinds[i] == PointKind.FIXED else keys.point(i)


def _robust(settings: SolverSettings) -> tuple[str, float] | None:
    if settings.loss == "none":
        return None
    return settings.loss, settings.loss_width or LOSS_WIDTHS[settings.loss]


def _rays(
    network: Network, keys: Keys, selected: Selected, settings: SolverSettings, moves: "Sequence[_Moves]"
) -> Iterator[gtsam.NonlinearFactor]:
    rays, common = network.rays, network.common_variables[0].tolist()
    looks = {int(k): look for each in common_looks(network) for k, look in zip(*each, strict=True)}
    for j in range(len(network.images)):
        in_image = np.flatnonzero(selected.rays & (rays.image == j))
        image = _Mounted.of(network, j)
        for k in in_image.tolist():
            i = int(rays.point[k])
            place = (float(rays.places[k, 0]), float(rays.places[k, 1]))
            label = f"point {network.points.ids[i]}, image {network.images[j].name}"
            shared = moves[j].of_ray(*place)
            if k in looks:
                shared.append(constant(keys.variable(common[k]), slice(6, 8), looks[k]))
            yield pushbroom_projection(
                None, _point(network, keys, i), image, place, rays.sigmas[k], shared=shared,
                line=settings.line, angles=settings.angles, near=selected.nominal[i], robust=_robust(settings),
                label=label,
            )  # fmt: skip


def _ranges(
    network: Network, keys: Keys, selected: Selected, settings: SolverSettings, moves: "Sequence[_Moves]"
) -> Iterator[gtsam.NonlinearFactor]:
    ranges = network.ranges
    movers = {} if ranges.shares is None else _movers(network, keys, of_ranges=True)
    for j in np.unique(ranges.image).tolist():
        image = network.images[j]
        in_image = np.flatnonzero(selected.ranges & (ranges.image == j))
        lines = image.timing.lines(ranges.times[in_image] - image.trajectory.epoch)
        for k, line in zip(in_image.tolist(), lines.tolist(), strict=True):
            i, shares = int(ranges.point[k]), np.zeros(3) if ranges.shares is None else ranges.shares[k]
            longer = [constant(m.keys[0], RANGE, shares[None] @ m.coefficients[0, :3]) for m in movers.get(i, ())]
            yield laser_range(
                None, _point(network, keys, i), image, line, float(ranges.values[k]), float(ranges.sigmas[k]),
                shared=[*moves[j].of_range(line, shares), *longer], robust=_robust(settings),
                footprint=(network.points.places[i], shares) if np.any(shares) else None,
                label=f"shot {network.points.ids[i]}, image {image.name}",
            )  # fmt: skip


# --- effects on an image


class _Mounted(NamedTuple):
    """An image in the axes of its pass."""

    image: PushbroomImage
    axes: Array | None

    @classmethod
    def of(cls, network: Network, j: int) -> "_Mounted | PushbroomImage":
        axes = network.axes_of(j)
        return network.images[j] if axes is None else cls(network.images[j], axes)

    @property
    def name(self) -> str:
        return self.image.name

    @property
    def lines(self) -> int:
        return self.image.lines

    @property
    def samples(self) -> int:
        return self.image.samples

    @property
    def interior(self) -> "_Mounted":
        return self

    @property
    def focal_length(self) -> float:
        return self.image.interior.focal_length

    def pose(self, lines: Array) -> Pose:
        return self.image.pose(lines).in_axes(self.axes)

    def focal_plane(self, samples: Array) -> tuple[Array, Array]:
        return Detector(*self.image.interior.focal_plane(samples)).in_axes(self.axes, self.focal_length)


class _Weights(NamedTuple):
    """Of the orientation images around the lines that a measurement may have: four of them at a time."""

    size: int
    nodes: OrientationImages
    first: int
    image: PushbroomImage

    def at(self, line: float) -> tuple[Array, Array]:
        times, periods = self.image.timing.at(np.array([line]))
        begin = int(self.nodes.first_of_four(times, self.image.trajectory.epoch)[0]) - self.first
        begin = min(max(begin, 0), self.size - SUPPORT)
        values, rates = self.nodes.around(np.array([self.first + begin]), times, self.image.trajectory.epoch)
        weights = np.zeros((2, self.size))
        weights[:, begin : begin + SUPPORT] = values[0], rates[0] * periods[0]
        return weights[0], weights[1]


class _Vibration(NamedTuple):
    keys: tuple[int]
    widths: tuple[int]
    at: Callable[[float], tuple[Array, Array]]


class _Moves:
    """Effects of unknowns on the rays and ranges of one image, in the axes of its pass."""

    def __init__(self, network: Network, keys: Keys, j: int, shared: SharedEffects) -> None:
        self._network, self._keys, self._j, self._image, self._shared = network, keys, j, network.images[j], shared
        self._own: list[Effect] = []
        if network.with_polynomial[j]:
            lines = float(self._image.lines)
            self._own.append(orientation_polynomial(keys.image(j), network.priors[j].degree, lines))
        moving = [k for k, unknown in enumerate(network.shared) if unknown.of(j) and unknown.kind.moves_instrument]
        self._pose = {k: self._of_pose(k) for k in moving}

    def _of_pose(self, k: int) -> Effect:
        unknown = self._network.shared[k]
        if unknown.sine is not None:

            def at(line: float) -> tuple[Array, Array]:
                value, rate = unknown.waves(self._image.moments(np.array([line])))
                return np.eye(STATE, 6) @ value[0].T, np.eye(STATE, 6) @ rate[0].T

            return _Vibration((self._keys.shared(k),), (unknown.kind.width,), at)
        effect = self._shared.of_instrument[self._j, unknown.kind]
        coefficients = np.zeros((effect.shape[1], STATE, effect.shape[0]))
        coefficients[:, :6] = effect.transpose(1, 2, 0)
        return PolynomialEffect((self._keys.shared(k),), coefficients, float(self._image.lines))

    def of_ray(self, line: float, sample: float) -> list[Effect]:
        acting = self._shared.acting["rays"][self._j]
        shared = (self._pose[k] if k in self._pose else self._of_interior(k, sample) for k in acting)
        return [*self._own, *self._nodes(line - MARGIN, line + MARGIN), *shared]

    def of_range(self, line: float, shares: Array) -> list[Effect]:
        effects = [*self._own, *self._nodes(line, line)]
        for k in self._shared.acting["ranges"][self._j]:
            kind, key = self._network.shared[k].kind, self._keys.shared(k)
            effects.append(range_bias(key) if kind is SharedKind.RANGE_BIAS else self._pose[k])
            if kind.moves_footprints:
                lengths = (self._shared.of_instrument[self._j, kind][:, :, POSITION] @ shares).T
                coefficients = np.eye(STATE)[RANGE].T * lengths[:, None]
                effects.append(PolynomialEffect((key,), coefficients, float(self._image.lines)))
        return effects

    def _of_interior(self, k: int, sample: float) -> PolynomialEffect:
        directions, slopes = self._shared.of_interior(self._j, k, np.array([sample]))
        coefficients = np.zeros((1, STATE, len(directions)))
        coefficients[0, LOOK], coefficients[0, SLOPE] = directions[:, 0].T, slopes[:, 0].T
        return PolynomialEffect((self._keys.shared(k),), coefficients)

    def _nodes(self, first_line: float, last_line: float) -> list[Effect]:
        owner = int(self._network.pass_of[self._j])
        if owner < 0:
            return []
        nodes, begin = self._network.passes[owner].nodes, int(self._network.first_of_passes[owner])
        times, _ = self._image.timing.at(np.array([first_line, last_line]))
        first, last = nodes.first_of_four(times, self._image.trajectory.epoch).tolist()
        members = tuple(self._keys.variable(begin + k) for k in range(first, last + SUPPORT))
        return [OrientationImagesEffect(members, _Weights(len(members), nodes, first, self._image).at)]
