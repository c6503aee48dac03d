"""Directions of the orientation in words; and what nothing determines, named before anything is solved: the datum of
the whole network, or single images.

Ties alone leave seven transformations of the whole network free: three translations, three rotations, scale. Their
vectors on the orientation coefficients are built here, about the network's middle, and the null space of the normal
matrix is compared with them; what of it is none of them is named by image and axis.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.frames import Axis, FlightFrame, Frames
from mgsgraph.adjustment.graph import Layout
from mgsgraph.errors import WeakNetwork
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.orientation import Moments, OrientationCorrection, polynomial
from mgsgraph.geometry.records import Array, finite_rows
from mgsgraph.geometry.rotation import skew
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.kernel.sweep import Reduction
from mgsgraph.names import grouped
from mgsgraph.network.joining import nominal_poses
from mgsgraph.text import listed, some
from mgsgraph.units import ARCSEC

_STEPS = 100
_TOLERANCE = 1e-8
"""Relative gain of a step below which the basis is good enough."""


def simple_basis(vectors: Array) -> Array:
    """(k, k) orthogonal R such that the columns of vectors (n, k), orthonormal, times R have simple structure.

    Eigenvectors of (nearly) equal eigenvalues are any mixture of each other. Of all bases of their space, the one with
    the largest sum of fourth powers has few large entries per direction (quartimax: Neuhaus & Wrigley 1954; Kaiser's
    varimax is the same here). It begins from the pivoted QR decomposition of the projector on the space, which depends
    on the space alone, not on the basis it is given in (Damle, Lin & Ying 2015).
    """
    if vectors.shape[1] < 2:
        return np.eye(vectors.shape[1])
    turn = _start(vectors)
    before = 0.0
    for _ in range(_STEPS):
        first, sums, second = np.linalg.svd(vectors.T @ (vectors @ turn)**3)
        turn = first @ second
        if sums.sum() < before * (1.0 + _TOLERANCE):
            break
        before = float(sums.sum())
    return np.asarray(turn)


def _start(vectors: Array) -> Array:
    """The basis nearest to the coordinates that the space holds best."""
    from scipy.linalg import qr  # slow to import

    _, _, pivots = qr(vectors.T, mode="economic", pivoting=True)
    first, _, second = np.linalg.svd(vectors[pivots[: vectors.shape[1]]].T)
    return np.asarray(first @ second)


_LEAST = 0.01
"""Share of a direction from which a part is kept."""
_NAMED_SHARE = 0.08
"""Share from which it is named, until `_ENOUGH` is."""
_ENOUGH = 0.9
_MOST = 4
"""Terms that are named."""
_MAINLY = 0.5
"""Share of what an axis moves that it moves this way on the ground, for it to count there."""
_CANCEL = 0.5
"""Share of the larger effect on the ground that may be left where position and pointing counter each other."""


@dataclass(frozen=True, slots=True)
class Part:
    """What one axis of one image (or one shift) has in a direction."""

    axis: Axis
    """Whose it is, which axis, which order."""
    share: float
    """Of the squared length of the direction, in prior units."""
    amount: float
    """Signed, m or rad per unit of the direction."""


@dataclass(frozen=True, slots=True)
class _Term:
    """One axis, or a position and the pointing that counters it on the ground, of one owner."""

    what: str
    owner: str
    share: float
    sign: float
    parts: tuple[Part, ...]


def parts_of(frames: Frames, direction: Array) -> tuple[Part, ...]:
    """Parts of a direction (columns,), in units of `Layout.scales`, of a share of 1 % or more, largest first."""
    share = frames.turned(direction[:, None])[:, 0] ** 2 / np.sum(direction**2)
    amount = frames.amounts(direction[:, None])[:, 0]
    # rounded, lest the last digit decide the order of equals
    order = np.lexsort((np.arange(share.size), -np.round(share, 6)))
    conditional = [int(c) for c in order if share[c] >= _LEAST]
    return tuple(Part(frames.axes[c], float(share[c]), float(amount[c])) for c in conditional)


def in_words(frames: Frames, parts: Sequence[Part], sigma: float | None = None) -> str:
    """What a direction is; with its sigma (in prior units), how far one sigma moves its main term."""
    terms = sorted(_terms(frames, parts), key=lambda term: -round(term.share, 6))
    groups = grouped((term.what, term) for term in terms)
    ordered = sorted(groups.values(), key=lambda group: -round(sum(term.share for term in group), 6))
    named: list[list[_Term]] = []
    explained = 0.0
    for group in ordered[:_MOST]:
        share = sum(term.share for term in group)
        if named and (share < _NAMED_SHARE or explained >= _ENOUGH):
            break
        explained += share
        named.append(group)
    text = ", with ".join(_group(group) for group in named)
    shares = f" ({'together ' if len(named) > 1 or len(named[0]) > 1 else ''}{100.0 * explained:.0f} %)"
    if sigma is None:
        return text
    main = named[0][0]
    amounts = " against ".join(quantity(abs(part.amount) * sigma, part.axis.unit) for part in main.parts)
    whose = f" of {main.owner}" if len(terms) > 1 and len(named[0]) > 1 else ""
    return f"{text}{shares}: one sigma is {amounts}{whose}"


def quantity(value: float, unit: str) -> str:
    """A length in m or an angle in arcsec, three significant digits."""
    if unit == "rad":
        value, unit = value / ARCSEC, "arcsec"
    return f"{value:.3g} {unit}" if value < 1e3 else f"{value:.0f} {unit}"


def _group(terms: Sequence[_Term]) -> str:
    """The same of several owners."""
    main = max(terms, key=lambda term: round(term.share, 6))
    same_sign = [term.owner for term in terms if term.sign == main.sign]
    opposite = [term.owner for term in terms if term.sign != main.sign]
    text = f"{main.what} of {_owners(same_sign)}" + (" jointly" if len(same_sign) > 1 else "")
    return f"{text} and, with opposite sign, of {_owners(opposite)}" if opposite else text


def _owners(owners: Sequence[str]) -> str:
    images = [owner.removeprefix("image ") for owner in owners if owner.startswith("image ")]
    rest = [owner for owner in owners if not owner.startswith("image ")]
    rest = [some(rest, most=_MOST - 1)] if len(rest) > _MOST else rest
    if len(images) > _MOST:
        images = [some(images, most=_MOST - 1)]
        return listed([f"images {images[0]}", *rest])
    return listed([f"image{'s' * (len(images) > 1)} {listed(images)}", *rest]) if images else listed(rest)


def _terms(frames: Frames, parts: Sequence[Part]) -> list[_Term]:
    """Parts; those of position and pointing that cancel each other are one term."""
    terms = [_alone(part) for part in parts if not part.axis.polynomial]
    of_image = grouped(((part.axis.variable, part.axis.order), part) for part in parts if part.axis.polynomial)
    for (image, _), of_order in of_image.items():
        terms += _against(frames.of(image), of_order)
    return terms


def _against(frame: FlightFrame, parts: Sequence[Part]) -> list[_Term]:
    """Terms of one coefficient of one image: what cancels on the ground along the flight, across it, and the rest."""
    rest, terms = list(parts), list[_Term]()
    for way in frame.ground:
        column = {part: frame.axes.index(part.axis.name) for part in rest}
        moved = {part: float(part.amount * way[k]) for part, k in column.items()}
        mainly = [part for part, k in column.items() if abs(way[k]) > _MAINLY * frame.reach[k]]
        position = [part for part in mainly if part.axis.unit == "m"]
        pointing = [part for part in mainly if part.axis.unit == "rad"]
        first, second = (sum(moved[part] for part in group) for group in (position, pointing))
        if not (position and pointing and abs(first + second) < _CANCEL * max(abs(first), abs(second))):
            continue
        main = tuple(max(group, key=lambda part: abs(moved[part])) for group in (position, pointing))
        share = sum(part.share for part in main)
        if min(part.share for part in main) < 0.1 * share:
            continue
        what = f"{main[0].axis} against {main[1].axis.name}"
        terms.append(_Term(what, main[0].axis.owner, share, np.sign(main[0].amount), main))
        rest = [part for part in rest if part not in main]
    return terms + [_alone(part) for part in rest]


def _alone(part: Part) -> _Term:
    return _Term(str(part.axis), part.axis.owner, part.share, np.sign(part.amount), (part,))


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
    """Raise WeakNetwork, naming the undetermined directions, before anything is solved.

    Only needed where some coefficient has no prior: a prior on each determines all of them.
    """
    if np.any(np.isinf(layout.sigmas)):
        weak = defects(layout, scaled_normal(layout, reduction), UNDETERMINED)
        if weak.number:
            raise weak.error()


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
    undetermined, _, _ = np.linalg.svd(null.T @ np.linalg.qr(moves @ free)[0])
    remaining = null @ undetermined[:, of_datum:]
    frames = Frames(layout)
    if remaining.shape[1]:
        remaining = remaining @ simple_basis(frames.turned(remaining))
    named = tuple(in_words(frames, parts_of(frames, remaining[:, k])) for k in range(min(remaining.shape[1], _NAMED)))
    return Defects(_transformations(free), named, null.shape[1], of_datum)


def _free(moves: Array, normal: Array, least: float) -> Array:
    """(7, d) combinations of `moves` (columns, 7) that the normal matrix leaves free.

    The test takes the transformations themselves: a narrow network has other free directions, some within a thousandth
    of a transformation that it does determine.
    """
    basis, sizes, right = np.linalg.svd(moves, full_matrices=False)
    present = sizes > _THERE * max(sizes[0], _THERE)
    basis, back = basis[:, present], right[present].T / sizes[present]
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
    for k, (pass_, first) in enumerate(layout.network.numbered_passes):
        columns = layout.variables.columns_from(first, len(pass_.nodes))
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


def _of_nodes(layout: Layout, number: int, middle: Array) -> Array:
    """(6 k, 7) m and rad, the nodes of a pass for the seven transformations."""
    pass_ = layout.network.passes[number]
    nodes = pass_.nodes
    times = np.linspace(*nodes.coverage, 2 * _PLACES + 2 * len(nodes))
    pose = nominal_poses(layout.network.pictures(number), times + nodes.epoch, pass_.axes)
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
    grounds = []
    for image in layout.network.images:
        pose = image.pose(image.middle[0])
        grounds.append(pose.position[0] / np.linalg.norm(pose.position[0]) * image.body.equatorial)
    return np.asarray(np.mean(grounds, axis=0))


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
        terrain = None if network.surface is None else network.surface.middle
        return middle if terrain is None else terrain
    places = network.points.places[np.flatnonzero(network.shifts.profile == shift)[:_ROWS]]
    places = places[finite_rows(places)]
    return np.asarray(places.mean(axis=0)) if places.size else middle


def _transformations(free: Array) -> str:
    """Words for the transformations (7, d), combinations of the seven, that are free.

    A rotation about any other place is one about the middle and a translation: rotations and scale are named first, and
    the rest is translation alone.
    """
    words, rest = list[str](), free
    for kind, rows in zip(_KINDS, (slice(3, 6), slice(6, 7), slice(0, 3)), strict=True):
        if rest.shape[1] == 0:
            break
        first, sizes, second = np.linalg.svd((rest / np.linalg.norm(rest, axis=0))[rows])
        rank = int(np.count_nonzero(sizes > _PART))
        if rank:
            words.append(kind if kind == "scale" else f"{kind} {_axes(first[:, :rank])}")
        rest = rest / np.linalg.norm(rest, axis=0) @ second[rank:].T
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
    normal = np.cross(*span.T)
    return "two axes at right angles to ({:.2f}, {:.2f}, {:.2f})".format(*normal)
