"""A network drawn anew: the same geometry and sigmas, with a truth and observations from their stated distributions.

Every orientation coefficient, shift, shared unknown and row is drawn from its stated sigma, so that the normalised
estimation errors of the adjustment must average to one: the test of whether its sigmas are honest.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from mex_flight import drawn_nodes, pass_correction
from nac_pair import powers

from mgsgraph.adjustment.covariances import point_covariances, prior_covariance
from mgsgraph.adjustment.frames import flight_axes
from mgsgraph.adjustment.graph import BundleGraph, lay_out
from mgsgraph.adjustment.graph.variables import footprint_shifts
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.rounds import all_rows, relinearized
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import sigmas_along
from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.intersection import intersect_rays
from mgsgraph.geometry.orientation import Angles, OrientationCorrection
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.stereo_surface import heights_above
from mgsgraph.kernel.sweep import COSTS
from mgsgraph.network import GroundPoints, ImageRays, Network, Ranges, SharedKind, Surface
from mgsgraph.network.corrections import adjusted_image
from mgsgraph.network.passes import Pass, PolynomialPrior
from mgsgraph.network.shared import image_effect

_HEIGHT_STEPS = 20


@dataclass(frozen=True, slots=True, eq=False)
class Draw:
    """One draw of a network, and its truth."""

    network: Network
    """Observations and a-priori places as drawn."""
    corrections: tuple[OrientationCorrection, ...]
    """True orientation of each image; none for a held one, and that of its pass for one of a pass."""
    shifts: Array
    """(p, 2) m, east and north: what the a-priori places of each profile lack of the truth, and last, where it has a
    shift of its own, the terrain model."""
    places: Array
    """(n, 3) m, true ground points."""
    lift: Array | None = None
    """(w,) m and rad, how the truth lies above and is tilted to the terrain model, as `Solution.lift` has it; None
    or empty where neither is unknown."""
    shared: tuple[Array, ...] = ()
    """(width,) true value of each unknown that images share."""
    own: tuple[OrientationCorrection, ...] = ()
    """The orientations without what images share."""

    @property
    def vector(self) -> Array:
        """The truth in the order of an adjustment's vector: images without passes, shifts, shared unknowns."""
        return np.concatenate([
            *(one.coefficients.ravel() for one in self.own), self.shifts.ravel(), *self.shared
        ])  # fmt: skip


Change = Callable[[int, OrientationCorrection], OrientationCorrection]
"""Of an image, by its number: its true correction, as drawn, with an error of its nominal orientation in it."""


Noise = Callable[[Network, np.random.Generator, int], Array]
"""Errors (k, 2) of rays, px, where 2 is asked for, and (n, 1) of heights above the terrain model, m, by 1."""


def common_noise(network: Network, rng: np.random.Generator, wanted: int) -> Array:
    """Errors as the network states them, its groups of neighbors among them."""
    sigmas = network.rays.sigmas
    if wanted == 1:
        assert network.surface is not None
        sigmas = np.where(np.isfinite(network.surface.sigmas), network.surface.sigmas, 0.0)[:, None]
    found = rng.standard_normal(sigmas.shape)
    for one, of_row, _ in network.common:
        before = {row.variables[-1]: row for row in one.links}
        values = list[Array]()
        for group, width in enumerate(one.widths.tolist() if of_row == wanted else ()):
            values.append(rng.standard_normal((width, of_row)))
            if group in before:
                *known, own = before[group].blocks
                pairs = zip(known, before[group].variables, strict=False)
                values[-1] = np.linalg.solve(own, values[-1] - sum(block @ values[v] for block, v in pairs))
        if values:
            found[one.members] += one.errors(values)
    return np.asarray(found * sigmas)


def redraw(
    network: Network, rng: np.random.Generator, angles: Angles = "camera", change: Change | None = None,
    noise: Noise = common_noise,
) -> Draw:  # fmt: skip
    """Draw a network anew.

    Parameters
    ----------
    network : Network
        Whose geometry, sigmas and terrain are taken. Back-projected image places are computed anew with the nominal
        orientation, as they came: they are no draws.
    rng : Generator
    angles : str
        What the rotation part of the coefficients is.
    change : callable, optional
        What is wrong with nominal orientations beyond their priors.
    noise : callable
        Gives the errors of rays and of heights.

    Raises
    ------
    InputError
        When a coefficient has no finite a-priori sigma, or a point isn't seen where it was.
    """
    own = _drawn_corrections(network, rng, angles)
    if change is not None:
        own = tuple(change(j, one) for j, one in enumerate(own))
    shared = tuple(rng.standard_normal(one.sigmas.size) * one.sigmas for one in network.shared)
    corrections = _with_shared(network, own, shared, angles)
    terrain = _drawn_terrain(network.surface, rng)
    truth = _on_stereo(network, _true_places(network, terrain, noise, rng), corrections, rng)
    shifts, points, errors = _drawn_points(network, truth, shared, rng)
    level = 2 if network.surface is not None and network.surface.shift_sigma else 0
    if network.terrain_moves:
        shifts = np.concatenate([shifts, np.pad(terrain[:level], (0, 2 - level))[None]])
    rays = _drawn_rays(network, truth, points, corrections, shared, noise(network, rng, 2))
    ranges = _drawn_ranges(network, truth, corrections, shared, errors, rng)
    drawn = replace(network, points=points, rays=rays, ranges=ranges)
    return Draw(drawn, corrections, shifts, truth, terrain[level:], shared, own)


def _with_shared(
    network: Network, own: tuple[OrientationCorrection, ...], shared: tuple[Array, ...], angles: Angles
) -> tuple[OrientationCorrection, ...]:
    """Corrections of images with what unknowns that they share do to them."""
    found = list(own)
    for one, value in zip(network.shared, shared, strict=True):
        for j in one.images.tolist() if one.kind.moves_pose else ():
            before = found[j]
            if one.sine is not None:  # about the image's own axes
                amounts = np.pad(value.reshape(3, 4).T, ((0, 0), (3, 0)))
                rows, sines = np.vstack([before.coefficients, amounts]), (*before.sines, one.sine)
                found[j] = replace(before, coefficients=rows, sines=sines)
                continue
            effect = np.tensordot(value, image_effect(network.images[j], one.kind, angles), 1)
            polynomial = before.polynomial_terms
            rows = max(polynomial, len(effect))
            whole = sum(np.pad(part, ((0, rows - len(part)), (0, 0)))
                        for part in (before.coefficients[:polynomial], effect))  # fmt: skip
            found[j] = replace(before, coefficients=np.vstack([whole, before.coefficients[polynomial:]]))
    return tuple(found)


def _drawn_terrain(surface: Surface | None, rng: np.random.Generator) -> Array:
    """(w,) m and rad, how the truth lies beside the terrain model: a value of each of the model's own unknowns."""
    if surface is None:
        return np.zeros(0)
    level = rng.standard_normal(2)[: 2 if surface.shift_sigma else 0]
    rest = rng.standard_normal(len(surface.terms) - level.size)
    return np.asarray(np.concatenate([level, rest]) * np.array([term.sigma for term in surface.terms]))


def _drawn_corrections(network: Network, rng: np.random.Generator, angles: Angles) -> tuple[OrientationCorrection, ...]:
    """One for each image; the images of a pass have one in common, turned into the axes of each."""
    owner, adjusted = network.pass_of, network.with_polynomial
    own = {
        j: _drawn_correction(network.priors[j].sigmas * adjusted[j], rng, angles)
        for j in np.flatnonzero(owner < 0).tolist()
    }
    for one in network.passes:
        nodes = _drawn_pass(one, rng)
        common = pass_correction(one.nodes, nodes, angles)
        for j in one.images.tolist():
            axes = one.axes_of(j)
            turned = common if axes is None else np.hstack([nodes[:, :3], nodes[:, 3:] @ axes.T])
            own[j] = common if axes is None else pass_correction(one.nodes, turned, angles)
    return tuple(own[j] for j in range(len(network.images)))


def _drawn_pass(one: Pass, rng: np.random.Generator) -> Array:
    """(k, 6) nodes of a pass, m and rad, from their prior."""
    if not isinstance(one.prior, PolynomialPrior):
        return drawn_nodes(one.prior, one.nodes, rng)
    return powers(one.nodes) @ (polynomial_sigmas(one) * rng.standard_normal((len(one.nodes), 6)))


def polynomial_sigmas(one: Pass) -> Array:
    """(k, 6) m and rad, of the coefficients of a pass whose corrections are polynomials; 0 for those that are held."""
    sigmas = np.zeros((len(one.nodes), 6))
    for part, columns in ((one.prior.position_sigmas, slice(0, 3)), (one.prior.attitude_sigmas, slice(3, 6))):
        sigmas[: len(part), columns] = part
    return sigmas


def _drawn_correction(sigmas: Array, rng: np.random.Generator, angles: Angles) -> OrientationCorrection:
    if not np.all(np.isfinite(sigmas)):
        raise InputError("orientation prior", "an infinite sigma", "finite ones, to draw from")
    return OrientationCorrection(rng.standard_normal(sigmas.shape) * sigmas, angles)


def _true_places(network: Network, terrain: Array, noise: Noise, rng: np.random.Generator) -> Array:
    """(n, 3) m: a-priori places, or where the nominal rays meet; on the terrain model, but for a drawn height."""
    rays = network.rays
    origins, directions = np.empty((rays.point.size, 3)), np.empty((rays.point.size, 3))
    for j, image in enumerate(network.images):
        mine = rays.image == j
        origins[mine], directions[mine] = image.sightlines(*rays.places[mine].T)
    crossing, _, _ = intersect_rays(origins, directions, rays.point, len(network.points))
    known = np.all(np.isfinite(network.points.places), axis=1) & (network.points.kinds != PointKind.FREE)
    places = np.where(known[:, None], network.points.places, crossing)
    for i in np.flatnonzero(~np.all(np.isfinite(places), axis=1))[:1]:
        raise InputError(f"point {network.points.ids[i]}", "nothing that places it", "two rays, or an a-priori place")
    if network.surface is None:
        return places
    heights = noise(network, rng, 1)[:, 0]
    for _ in range(_HEIGHT_STEPS):
        above, normal = network.surface.grid.height_above(places - network.surface.moved(places, terrain))
        move = np.where(np.isfinite(network.surface.sigmas) & np.isfinite(above), heights - above, 0.0)
        up = places / np.linalg.norm(places, axis=1, keepdims=True)
        places = places + (move / np.where(move == 0.0, 1.0, np.einsum("ni,ni->n", normal, up)))[:, None] * up
    return places


def _on_stereo(
    network: Network, places: Array, corrections: tuple[OrientationCorrection, ...], rng: np.random.Generator
) -> Array:
    """(n, 3) m: true places (n, 3), but for a drawn height on the stereo surfaces where the true orientation has
    them.
    """
    control = network.stereo
    if control is None:
        return places
    sigmas = np.where(control.surface >= 0, control.sigmas, 0.0)
    heights, places = rng.standard_normal(len(places)) * sigmas, places.copy()
    for s, images in enumerate(control.images.tolist()):
        mine = np.flatnonzero(control.surface == s)
        first, second = (network.images[j] for j in images)
        both = corrections[images[0]], corrections[images[1]]
        for _ in range(_HEIGHT_STEPS):
            found = heights_above(control.surfaces[s], first, second, places[mine], both)
            up = places[mine] / np.linalg.norm(places[mine], axis=1, keepdims=True)
            move = (heights[mine] - found.heights) / np.einsum("ni,ni->n", found.normals, up)
            places[mine] += move[:, None] * up
    return places


def _drawn_points(
    network: Network, truth: Array, shared: tuple[Array, ...], rng: np.random.Generator
) -> tuple[Array, GroundPoints, Array]:
    """True shifts; a-priori places that lack them, what shared unknowns move, and have an error of their covariance;
    and these errors (n, 3), m.
    """
    points = network.points
    places, constrained = points.places.copy(), points.kinds == PointKind.CONSTRAINED
    roots = np.linalg.cholesky(points.covariances[constrained])
    errors = np.zeros_like(places)
    errors[constrained] = -np.einsum("nij,nj->ni", roots, rng.standard_normal((roots.shape[0], 3)))
    places[constrained] = truth[constrained] + errors[constrained]
    known = np.where(constrained[:, None], truth, points.places)
    moved = footprint_shifts(replace(network, points=replace(points, places=known)), shared)
    places[constrained] -= moved[constrained]
    shifts = np.zeros((0, 2))
    if network.shifts is not None:
        shifts = rng.standard_normal((network.shifts.sigmas.size, 2)) * network.shifts.sigmas[:, None]
        mine = network.shifts.profile >= 0
        places[mine] -= np.einsum("nk,nkj->nj", shifts[network.shifts.profile[mine]], east_north(truth[mine]))
    return shifts, replace(points, places=places), errors


def _drawn_rays(
    network: Network,
    truth: Array,
    points: GroundPoints,
    corrections: tuple[OrientationCorrection, ...],
    shared: tuple[Array, ...],
    noise: Array,
) -> ImageRays:
    rays = network.rays
    places = np.empty_like(rays.places)
    repeated = rays.back_projected if rays.back_projected is not None else np.zeros(rays.point.size, dtype=bool)
    values = [np.zeros(0)] * network.first_shared + list(shared)
    for j, image in enumerate(network.images):
        drawn, copied = (rays.image == j) & ~repeated, (rays.image == j) & repeated
        true = adjusted_image(network, j, values)
        seen, _ = true.ground_to_image(truth[rays.point[drawn]], corrections[j], rays.places[drawn, 0])
        places[drawn] = seen + noise[drawn]
        places[copied] = image.ground_to_image(points.places[rays.point[copied]])[0]
    for k in np.flatnonzero(~np.all(np.isfinite(places), axis=1))[:1]:
        where = f"point {network.points.ids[rays.point[k]]}, image {network.images[rays.image[k]].name}"
        raise InputError(where, "not seen any more with the drawn orientation", "smaller a-priori sigmas")
    return replace(rays, places=places)


def _drawn_ranges(
    network: Network, truth: Array, corrections: tuple[OrientationCorrection, ...], shared: tuple[Array, ...],
    errors: Array, rng: np.random.Generator,
) -> Ranges:
    ranges = network.ranges
    values = rng.standard_normal(ranges.values.size) * ranges.sigmas
    if ranges.shares is not None:
        values += np.einsum("ri,ri->r", ranges.shares, errors[ranges.point])
    for j in np.unique(ranges.image):
        mine: Index = np.flatnonzero(ranges.image == j)
        image = network.images[j]
        since = ranges.times[mine] - image.trajectory.epoch
        correction, _ = corrections[j].at(image.moments(image.timing.lines(since)))
        eye = image.trajectory.pose(since).position + correction[:, :3]
        values[mine] += np.linalg.norm(truth[ranges.point[mine]] - eye, axis=1)
    for one, value in zip(network.shared, shared, strict=True):
        if one.kind is SharedKind.RANGE_BIAS:
            values += value[0] * np.isin(ranges.image, one.images)
    return replace(ranges, values=values)


def assert_unit_variance(normalised: np.ndarray) -> None:
    """Mean square 1 and mean 0 within 4.5 sigma of what as many standard normal numbers have."""
    n = normalised.size
    assert abs(np.mean(normalised**2) - 1.0) < 4.5 * np.sqrt(2.0 / n)
    assert abs(np.mean(normalised)) < 4.5 / np.sqrt(n)


def forward_intersection(network: Network, solution: Solution | None = None) -> tuple[JointCovariance, Array, Array]:
    """A-priori covariance of a network's shared unknowns; with it, and the rays, covariances (n, 3, 3) of its points,
    m^2; and their places (n, 3), m, with the nominal orientation, or that of a solution with a terrain model besides.
    """
    layout, selection = lay_out(network, SolverSettings()), all_rows(network)
    joint, values = prior_covariance(layout), np.zeros(layout.columns)
    assert joint is not None  # all sigmas are finite
    if solution is not None:
        model = solution.network.first_shared - 1
        values = layout.variables.joined([*solution.values[:model], *solution.values[model + 1 :]])
    begin = BundleGraph(layout, selection.rows(layout)).reduction(values, COSTS)
    layout, reduction = relinearized(layout, selection, begin, COSTS)
    places = reduction.points
    covariances = point_covariances(layout, selection.rows(layout), values, places, joint)
    return joint, layout.network_order(covariances), layout.network_order(places)


def node_squares(solution: Solution, true: Sequence[Array]) -> float:
    """Normalised square of the errors of all nodes, taking passes as independent; `true` (k, 6) of each pass."""
    result = 0.0
    for nodes, want, (pass_, first) in zip(solution.nodes, true, solution.network.numbered_passes, strict=True):
        error, covariance = (nodes - want).ravel(), solution.joint_covariance.of(range(first, first + len(pass_.nodes)))
        result += float(error @ np.linalg.solve(covariance, error))
    return result


def flight_sigmas(network: Network, covariances: Sequence[Array], places: Array) -> list[list[float]]:
    """Mean sigmas (m) by covariances (n, 3, 3) of points, along the flight of the first image that sees each, across
    and up.
    """
    points, first = np.unique(network.rays.point, return_index=True)
    axes = np.stack([
        flight_axes(place, network.images[network.rays.image[k]].pose(network.rays.places[[k], 0]).velocity[0])
        for place, k in zip(places[points], first.tolist(), strict=True)
    ])  # fmt: skip
    return [sigmas_along(axes, one[points]).mean(axis=0).tolist() for one in covariances]
