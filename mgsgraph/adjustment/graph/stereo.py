"""Heights above stereo surfaces as rows: linear in the point and in the orientation of both images, about a state.

The orientation acts through single columns, one for each coefficient of either image and for what these share with
others, each with its direction: meters of height per unit. `Layout.about_stereo` relinearizes the rows about the state
of an optimization until they no longer change: then they are exact at the solution.
"""

from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.graph.variables import Variables, angles_of
from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation import SUPPORT, polynomial
from mgsgraph.geometry.records import Array, Index, Mask, no_rows
from mgsgraph.geometry.stereo_surface import heights_above
from mgsgraph.kernel.rows import Model
from mgsgraph.network import Network
from mgsgraph.network.corrections import adjusted_image, whole_correction
from mgsgraph.network.effects import SharedEffects, acting_on

_TOLERANCE = 1e-6
"""Sigmas, of point and surface together, by which a row may differ from the one about the present state, and by how
much its normal may."""
_DEPTH = 6
"""Number of earlier steps that `accelerated` uses."""
_FARTHEST = 10.0
"""Largest sum of the absolute shares with which they are mixed."""


class StereoRows(NamedTuple):
    """Of the k points on stereo surfaces, surface by surface."""

    points: Index
    """(k,) network points."""
    sides: Index
    """(k, 4) first image and the first of the four nodes that it depends on there (-1: none), second image and node."""
    reference: Array
    """(k, 3) m, about which they are linear."""
    heights: Array
    """(k,) m above the surface there, less the contribution of the unknowns there."""
    normals: Array
    """(k, 3) unit, body-fixed."""
    directions: tuple[Array, ...]
    """Of each surface (k_s, c) m per unit of each column that a row depends on: `columns` of both images."""
    about: Array
    """(columns,) shared unknowns, about which they are linear."""
    lines: Array
    """(k, 2) of both images, in which the points are there; the middle ones where the points are not seen."""
    steps: tuple[tuple[Array, Array], ...] = ()
    """Each (columns + 3 k,): unknowns about which earlier rows were linear, and those found with them, the last step
    last; shared unknowns in a-priori sigmas, points in sigmas of their heights."""

    @property
    def parts(self) -> list[tuple[slice, Array]]:
        """Rows of each surface, and their directions."""
        ends = np.cumsum([0, *(len(directions) for directions in self.directions)]).tolist()
        return [(slice(a, b), directions) for a, b, directions in zip(ends, ends[1:], self.directions, strict=False)]


def combinations(sides: Index) -> tuple[Index, Index]:
    """Sides (c, 4) that there are among (k, 4), and which of them each is (k,)."""
    each = np.ravel_multi_index(tuple(sides.T + 1), sides.max(axis=0, initial=-1) + 2)
    _, first, number = np.unique(each, return_index=True, return_inverse=True)
    return sides[first], number


def columns(network: Network, side: tuple[int, ...]) -> tuple[Index, Index]:
    """Variables (c,), and columns (c,) within them, that a row depends on; `side` is of `StereoRows.sides`."""
    variable, inside = [no_rows()], [no_rows()]

    def add(first: int, count: int, width: int) -> None:
        variable.append(np.repeat(first + np.arange(count), width))
        inside.append(np.tile(np.arange(width), count))

    for image, node in (side[:2], side[2:]):
        if node >= 0:
            add(int(network.first_of_passes[network.pass_of[image]]) + node, SUPPORT, 6)
        elif network.with_polynomial[image]:
            add(image, 1, network.priors[image].sigmas.size)
        for k in acting_on(network, "rays")[image]:
            add(network.first_shared + k, 1, network.shared[k].kind.width)
    return np.concatenate(variable), np.concatenate(inside)


def linear_rows(
    network: Network,
    model: Model,
    variables: Variables,
    orientation: Array,
    points: Array,
    before: StereoRows | None = None,
) -> StereoRows | None:
    """Rows about shared unknowns (columns,) and points (n, 3) in m, network order; None without stereo surfaces.

    Points that an image doesn't see there keep the row that they had `before`, or have one of zeros.
    """
    control = network.stereo
    if control is None:
        return None
    values, effects = variables.split(orientation), SharedEffects(network, angles_of(model))
    surfaces = [
        _of_surface(network, model, values, effects, s, np.flatnonzero(control.surface == s), points, before)
        for s in range(len(control.surfaces))
    ]
    points_of, sides, heights, normals, directions, lines = zip(*surfaces, strict=True)
    chosen = np.concatenate(points_of)
    rows = StereoRows(
        chosen, np.concatenate(sides), points[chosen], np.concatenate(heights), np.concatenate(normals), directions,
        orientation, np.concatenate(lines),
    )  # fmt: skip
    unseen = ~np.isfinite(rows.heights)
    if not np.any(unseen):
        return rows
    zero = rows._replace(
        heights=np.zeros(chosen.size), normals=np.zeros((chosen.size, 3)),
        directions=tuple(np.zeros_like(part) for part in directions),
    )  # fmt: skip
    return _kept(unseen, before or zero, rows)


def require_seen(network: Network, rows: StereoRows) -> None:
    """Raise InputError where images do not see a point on their surface."""
    for i in rows.points[~np.any(rows.normals, axis=1)][:1]:
        problem, expected = "on a stereo surface whose images don't see it", "points that both images show"
        raise InputError(f"ground point {network.points.ids[i]}", problem, expected)


def _kept(unseen: Mask, before: StereoRows, rows: StereoRows) -> StereoRows:
    """Rows, some of them (k,) replaced by those before."""
    return StereoRows(
        rows.points,
        np.where(unseen[:, None], before.sides, rows.sides),
        np.where(unseen[:, None], before.reference, rows.reference),
        np.where(unseen, before.heights, rows.heights),
        np.where(unseen[:, None], before.normals, rows.normals),
        tuple(
            np.where(unseen[part, None], old, new)
            for (part, old), new in zip(before.parts, rows.directions, strict=True)
        ),
        rows.about,
        rows.lines,
    )


def _of_surface(
    network: Network,
    model: Model,
    values: list[Array],
    effects: SharedEffects,
    s: int,
    chosen: Index,
    points: Array,
    before: StereoRows | None,
) -> tuple[Index, Index, Array, Array, Array, Array]:
    """Points, sides, heights, normals, directions and lines of the rows of one surface."""
    assert network.stereo is not None
    first, second = network.stereo.images[s].tolist()
    angles, level = angles_of(model), network.stereo.level
    at = heights_above(
        network.stereo.surfaces[s],
        adjusted_image(network, first, values),
        adjusted_image(network, second, values),
        points[chosen],
        (whole_correction(network, first, values, angles), whole_correction(network, second, values, angles)),
        None if level is None else level[chosen],
        None if before is None else before.lines[before.parts[s][0]],
    )
    sides, parts = np.full((chosen.size, 4), -1, dtype=np.int64), []
    middle = [0.5 * network.images[image].lines for image in (first, second)]
    visible = np.isfinite(at.heights)[:, None]
    lines = np.where(visible, at.lines, middle)
    samples = np.where(visible, at.samples, [0.5 * network.images[image].samples for image in (first, second)])
    for side, image in enumerate((first, second)):
        sides[:, 2 * side] = image
        at_places = lines[:, side], samples[:, side]
        sides[:, 2 * side + 1], part = _directions(network, effects, image, *at_places, at.by_pose[:, side])
        parts.append(part)
    directions = np.hstack(parts)
    counted = _counted(network, values, sides, directions)
    return chosen, sides, at.heights - counted, at.normals, directions, lines


def _directions(
    network: Network, effects: SharedEffects, image: int, lines: Array, samples: Array, by_pose: Array
) -> tuple[Index | int, Array]:
    """First of the four nodes at lines (n,) of an image (-1: none), and (n, c) m per unit of its `columns`.

    `by_pose` (n, 9) is the height's derivative by position, rotation, and what pixels at samples (n,) look along.
    """
    picture, pass_number, axes = network.images[image], int(network.pass_of[image]), network.axes_of(image)
    if axes is not None:
        length = (picture.interior.looks(samples)[0] @ axes)[:, 2:] / picture.interior.focal_length
        by_pose = np.hstack([by_pose[:, :3], by_pose[:, 3:6] @ axes, by_pose[:, 6:] @ axes * length])
    moments = picture.moments(lines)
    node: Index | int = -1
    basis = np.zeros((lines.size, 0))
    if pass_number >= 0:
        nodes = network.passes[pass_number].nodes
        node = nodes.first_of_four(moments.times, moments.epoch)
        basis = nodes.around(node, moments.times, moments.epoch)[0]
    elif network.with_polynomial[image]:
        basis = polynomial(moments.u, network.priors[image].degree)[0]
    polynomials = np.einsum("nt,nc->ntc", basis, by_pose[:, :6]).reshape(lines.size, 6 * basis.shape[1])
    shared = effects.of_rays(image, moments.u, samples)
    return node, np.hstack([polynomials, np.einsum("nce,ne->nc", shared, by_pose[:, : shared.shape[2]])])


def heights_at(rows: StereoRows, network: Network, variables: Variables, shared: Array, points: Array) -> Array:
    """(k,) m above the surfaces, by the rows, of points (k, 3) with shared unknowns (columns,)."""
    values = variables.split(shared)
    heights = rows.heights + np.einsum("kc,kc->k", rows.normals, points - rows.reference)
    for part, directions in rows.parts:
        heights[part] += _counted(network, values, rows.sides[part], directions)
    return np.asarray(heights)


def same_heights(before: StereoRows, after: StereoRows, network: Network, variables: Variables, shared: Array) -> bool:
    """Whether rows about another state predict the same heights there as the rows before."""
    assert network.stereo is not None
    if not np.array_equal(before.sides, after.sides):
        return False
    expected, actual = (heights_at(rows, network, variables, shared, after.reference) for rows in (before, after))
    covariances = network.points.covariances[after.points]
    variances = np.einsum("ki,kij,kj->k", after.normals, covariances, after.normals)
    off = np.abs(expected - actual) / np.sqrt(network.stereo.sigmas[after.points] ** 2 + variances)
    turned = np.abs(before.normals - after.normals)
    return bool(off.max(initial=0.0) <= _TOLERANCE and turned.max(initial=0.0) <= _TOLERANCE)


def accelerated(
    before: StereoRows, network: Network, variables: Variables, shared: Array, points: Array
) -> tuple[Array, Array, tuple[tuple[Array, Array], ...]]:
    """Shared unknowns (columns,) and points (k, 3), m, about which rows are to be linear next, and the steps so far,
    when the rows before have led to `shared` and `points`.

    Single steps may oscillate: on a steep wall, or where the heights are hardly linear in unknowns that little else
    determines. So the next state is that mixture of the last ones with the smallest sum of steps (Anderson 1965, method
    of type II; Walker & Ni 2011, Eq. 2.2).
    """
    assert network.stereo is not None
    scales = np.where(np.isfinite(variables.sigmas), variables.sigmas, 1.0)
    sigmas = network.stereo.sigmas[before.points, None]
    about, reached = (
        np.concatenate([unknowns / scales, (positions / sigmas).ravel()])
        for unknowns, positions in ((before.about, before.reference), (shared, points))
    )
    steps = (*before.steps, (about, reached))[-_DEPTH:]
    starts, ends = (np.stack(part, axis=1) for part in zip(*steps, strict=True))
    changes = ends - starts
    share = np.linalg.lstsq(changes[:, -1:] - changes[:, :-1], changes[:, -1], rcond=1e-6)[0]
    if np.abs(share).sum() > _FARTHEST:
        share = np.zeros_like(share)
    mixed = ends[:, -1] - (ends[:, -1:] - ends[:, :-1]) @ share
    return mixed[: scales.size] * scales, mixed[scales.size :].reshape(-1, 3) * sigmas, steps


def _counted(network: Network, values: list[Array], sides: Index, directions: Array) -> Array:
    """(n,) m by which the values of all variables move the surface, of rows with sides (n, 4), directions (n, c)."""
    moved, (all_sides, number) = np.zeros(len(sides)), combinations(sides)
    for k, side in enumerate(all_sides.tolist()):
        rows = number == k
        variable, inside = columns(network, tuple(side))
        moved[rows] = directions[rows] @ [values[v][c] for v, c in zip(variable.tolist(), inside.tolist(), strict=True)]
    return moved
