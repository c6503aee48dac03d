"""What nothing determines, named before anything is solved: the datum of the whole network, or single images.

Ties alone leave seven transformations of the whole network free: three translations, three rotations, scale. Their
vectors on the orientation coefficients are built here, about the network's middle, and the null space of the normal
matrix is compared with them; what of it is none of them is named by image and axis.
"""

from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.datum.frames import Frames
from mgsgraph.adjustment.datum.simple import simple_basis
from mgsgraph.adjustment.datum.words import in_words, parts_of
from mgsgraph.adjustment.graph import Layout
from mgsgraph.errors import WeakNetwork
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.orientation import Moments, OrientationCorrection, polynomial
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.rotation import skew
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.kernel.reduction import Reduction
from mgsgraph.network.joining import nominal_poses
from mgsgraph.text import listed

UNDETERMINED = 1e-13
"""Eigenvalue of the scaled normal matrix, relative to the largest, below which a direction isn't determined."""
POORLY = 1e-9
"""The same, to name what made a factorisation fail."""
_PLACES = 31
"""Lines at which an image's datum transformations are sampled (the papers' number)."""
_INSIDE = 0.999
"""Cosine from which an axis is called X, Y or Z."""
_THERE = 1e-9
"""Singular value from which a transformation is one by itself."""
_PART = 1e-3
"""Share (of a unit vector) from which a free transformation has a rotation or scale in it."""
_ROWS = 300
"""Points from which a shift's place is taken."""
_NAMED = 2
"""Directions that are named."""
_KINDS = ("rotation about", "scale", "translation along")


class Defects(NamedTuple):
    """What a normal matrix leaves undetermined."""

    datum: str
    """Which transformations of the whole network, in words; empty for none."""
    others: tuple[str, ...]
    """Some of the other directions in words."""
    number: int
    """Directions in all."""
    of_datum: int
    """How many of them are transformations of the whole network."""

    def error(self) -> WeakNetwork:
        """What to raise."""
        return WeakNetwork(self.others, self.number, self.datum, self.of_datum)


def require_strength(layout: Layout, reduction: Reduction) -> None:
    """Raise WeakNetwork, naming the directions that nothing determines, before anything is solved.

    Only needed where some coefficient has no prior: a prior on each determines all of them.
    """
    if np.any(np.isinf(layout.sigmas)):
        found = defects(layout, scaled_normal(layout, reduction), UNDETERMINED)
        if found.number:
            raise found.error()


def scaled_normal(layout: Layout, reduction: Reduction) -> Array:
    """(columns, columns) full normal matrix in units of `Layout.scales`."""
    scales = layout.scales
    normal = layout.prior.normal() * np.multiply.outer(scales, scales)
    assert reduction.blocks is not None
    for v, w, block in layout.blocks.each(reduction.blocks, layout.variables.width):
        rows, columns = layout.columns_of(v), layout.columns_of(w)
        normal[rows, columns] += block * scales[rows][:, None] * scales[columns]
        if v != w:
            normal[columns, rows] = normal[rows, columns].T
    return np.asarray(normal)


def defects(layout: Layout, normal: Array, limit: float) -> Defects:
    """Directions with an eigenvalue of the normal matrix, in units of `Layout.scales`, below `limit` of the largest."""
    values, vectors = np.linalg.eigh(normal)
    least = limit * max(values[-1], 1.0)
    null = vectors[:, values < least]
    if null.shape[1] == 0:
        return Defects("", (), 0, 0)
    moves = datum_transformations(layout)
    free = _free(moves, normal, least)
    of_datum = free.shape[1]
    left, _, _ = np.linalg.svd(null.T @ np.linalg.qr(moves @ free)[0])
    others = null @ left[:, of_datum:]
    frames = Frames(layout)
    if others.shape[1]:
        others = others @ simple_basis(frames.turned(others))
    named = tuple(in_words(frames, parts_of(frames, others[:, k])) for k in range(min(others.shape[1], _NAMED)))
    return Defects(_transformations(free), named, null.shape[1], of_datum)


def _free(moves: Array, normal: Array, least: float) -> Array:
    """(7, d) combinations of `moves` (columns, 7) that the normal matrix leaves free.

    Asked of the transformations themselves: a narrow network has other free directions, some within a thousandth of a
    transformation that it does determine.
    """
    basis, sizes, right = np.linalg.svd(moves, full_matrices=False)
    there = sizes > _THERE * max(sizes[0], _THERE)
    basis, back = basis[:, there], right[there].T / sizes[there]
    values, combined = np.linalg.eigh(basis.T @ normal @ basis)
    return np.asarray(back @ combined[:, values < least])


def datum_transformations(layout: Layout) -> Array:
    """(columns, 7) unit vectors, in units of `Layout.scales`, of translations along X, Y, Z, rotations about parallel
    axes through the network's middle, and scale, as far as the orientation polynomials can follow.

    A held image cannot follow, so that with one of them none of these is free; nor can unknowns other than orientation
    and shifts, and tilts of the terrain model.
    """
    moves, middle = np.zeros((layout.columns, 7)), _middle(layout)
    for variable in layout.variables.adjusted():
        columns = layout.columns_of(variable)
        if variable < layout.variables.images:
            moves[columns] = _of_image(layout, variable, middle)
        elif variable < layout.network.first_shared:
            moves[columns] = _of_shift(layout, variable - layout.variables.images, middle)
    for k, (strip, first) in enumerate(layout.network.numbered_passes):
        columns = layout.variables.columns_from(first, len(strip.nodes))
        moves[columns] = _of_nodes(layout, k, middle)
    moves /= layout.scales[:, None]
    if np.any(layout.network.held):
        return np.zeros((layout.columns, 7))
    return np.asarray(moves / np.maximum(np.linalg.norm(moves, axis=0), 1e-300))


def _of_image(layout: Layout, image: int, middle: Array) -> Array:
    """(6 (degree + 1), 7) m and rad, coefficients of one image for the seven transformations (per m, rad and one)."""
    picture, degree = layout.network.images[image], layout.network.priors[image].degree
    lines = np.linspace(0.0, float(picture.lines), _PLACES)
    pose, moments = picture.pose(lines), picture.moments(lines)
    return _fitted(polynomial(moments.u, degree)[0], _changes(layout, pose, moments, middle))


def _of_nodes(layout: Layout, strip: int, middle: Array) -> Array:
    """(6 k, 7) m and rad, the nodes of a strip for the seven transformations."""
    one = layout.network.passes[strip]
    nodes = one.nodes
    times = np.linspace(*nodes.coverage, 2 * _PLACES + 2 * len(nodes))
    pose = nominal_poses(layout.network.pictures(strip), times + nodes.epoch, one.axes)
    changes = _changes(layout, pose, Moments.of_times(times, nodes.epoch), middle)
    return _fitted(nodes.dense(times, nodes.epoch)[0], changes)


def _changes(layout: Layout, pose: Pose, moments: Moments, middle: Array) -> Array:
    """(n, 6, 7) m and rad, corrections of nominal poses at n moments for the seven transformations."""
    change = np.zeros((moments.times.size, 6, 7))
    change[:, :3] = _displacement(pose.position - middle)
    axes = OrientationCorrection(np.zeros((1, 6)), layout.angles).axes(pose, moments)
    change[:, 3:, 3:6] = np.linalg.solve(axes, pose.matrix)
    return change


def _fitted(basis: Array, change: Array) -> Array:
    """(6 d, 7) coefficients of basis values (n, d) for changes (n, 6, 7)."""
    fitted, *_ = np.linalg.lstsq(basis, change.reshape(change.shape[0], 42))
    return np.asarray(fitted.reshape(-1, 7))


def _displacement(arms: Array) -> Array:
    """(n, 3, 7): how the seven transformations move places `arms` (n, 3), counted from the middle."""
    unit = np.broadcast_to(np.eye(3), (arms.shape[0], 3, 3))
    return np.concatenate([unit, -skew(arms), arms[:, :, None]], axis=2)


def _middle(layout: Layout) -> Array:
    """(3,) m, of what the images see: about it rotations and scale leave translations alone as far as can be."""
    seen = []
    for image in layout.network.images:
        pose = image.pose(np.array([0.5 * image.lines]))
        seen.append(pose.position[0] / np.linalg.norm(pose.position[0]) * image.body.equatorial)
    return np.asarray(np.mean(seen, axis=0))


def _of_shift(layout: Layout, shift: int, middle: Array) -> Array:
    """(w, 7) m and rad, unknowns of a profile's shift or of the terrain model for the seven transformations."""
    place, surface = _shifted_place(layout, shift, middle), layout.network.surface
    axes, moved = east_north_up(place[None])[0], _displacement((place - middle)[None])[0]
    if surface is None or shift + 1 < len(layout.network.shift_names) or not layout.network.terrain_moves:
        return np.asarray(axes[:2] @ moved)
    tilted = axes[:2] @ np.eye(3, 7, 3)
    return np.concatenate([
        (axes[:2] @ moved)[: 2 * bool(surface.shift_sigma)], (axes[2:] @ moved)[: bool(surface.height_sigma)],
        tilted[: 2 * bool(surface.tilt_sigma)],
    ])  # fmt: skip


def _shifted_place(layout: Layout, shift: int, middle: Array) -> Array:
    """(3,) m, about where a profile is, or the terrain model's points."""
    network = layout.network
    profiles = 0 if network.shifts is None else len(network.shifts.names)
    if network.shifts is None or shift >= profiles:
        own = None if network.surface is None else network.surface.middle
        return middle if own is None else own
    places = network.points.places[np.flatnonzero(network.shifts.profile == shift)[:_ROWS]]
    places = places[np.all(np.isfinite(places), axis=1)]
    return np.asarray(places.mean(axis=0)) if places.size else middle


def _transformations(free: Array) -> str:
    """Words for the transformations (7, d), combinations of the seven, that are free.

    A rotation about any other place is one about the middle and a translation: what is rotated and scaled is told
    first, what is left is translation alone.
    """
    words, rest = list[str](), free
    for kind, rows in zip(_KINDS, (slice(3, 6), slice(6, 7), slice(0, 3)), strict=True):
        if rest.shape[1] == 0:
            break
        left, sizes, right = np.linalg.svd((rest / np.linalg.norm(rest, axis=0))[rows])
        rank = int(np.count_nonzero(sizes > _PART))
        if rank:
            words.append(kind if kind == "scale" else f"{kind} {_axes(left[:, :rank])}")
        rest = rest / np.linalg.norm(rest, axis=0) @ right[rank:].T
    words = sorted(words, key=lambda word: ("translation", "rotation", "scale").index(word.split()[0]))
    return ", and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def _axes(span: Array) -> str:
    """Words for the directions that span (3, d)."""
    inside = [name for name, row in zip("XYZ", span, strict=True) if np.linalg.norm(row) > _INSIDE]
    if len(inside) == span.shape[1]:
        return listed(inside)
    if span.shape[1] == 1:
        vector = span[:, 0] * np.sign(span[np.argmax(np.abs(span[:, 0])), 0])
        return "({:.2f}, {:.2f}, {:.2f})".format(*vector)
    normal = np.cross(span[:, 0], span[:, 1])
    return "two axes at right angles to ({:.2f}, {:.2f}, {:.2f})".format(*normal)
