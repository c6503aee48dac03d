"""State of an incremental adjustment between two changes: bundles with their reduced systems, and shared unknowns.

A bundle is all points that depend on the same shared unknowns (not the bundle of rays of one image). Its reduced system
(points solved and eliminated at one orientation) is all that the tree of iSAM2 ever sees of it; its points are asked
for only when a change touches them. Shared unknowns begin with a-priori values or with a batch solution.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Protocol

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import intersect_ellipsoid
from mgsgraph.geometry.orientation import Angles, OrientationCorrection
from mgsgraph.geometry.records import Array, assign, frozen, read_only, sigmas_of
from mgsgraph.geometry.rotation import skew
from mgsgraph.network import HELD, Network, SharedKind
from mgsgraph.network.joining import Definitions, NamedPass, NamedShared, definitions, spans, with_definitions
from mgsgraph.network.parts import (
    KnownImage,
    Members,
    Unknown,
    bundles,
    joined,
    known_images,
    pass_unknowns,
    unknowns,
    with_images,
    without_images,
    without_points,
)
from mgsgraph.network.passes import normalised
from mgsgraph.network.shared import image_effect
from mgsgraph.units import KM

NOTICEABLE = 0.01
"""Sigmas from which on a move is reported."""


@dataclass(frozen=True, slots=True, eq=False)
class ReducedSystem:
    """Normal equations of a bundle with its points eliminated: cost(x) = cost + gradient' dx + dx' normal dx / 2."""

    unknowns: Members
    """Adjusted unknowns in the order of their columns."""
    at: Array
    """(d,) m and rad, where it was made; dx = x - at."""
    normal: Array
    """(d, d) reduced normal matrix, per m and rad."""
    gradient: Array
    """(d,) reduced gradient."""
    cost: float
    """Half the weighted sum of squares of the points' rows there."""
    slack: float
    """Pixels by which image places may move before it is relinearized (`sweep.slack`)."""

    def __post_init__(self) -> None:
        d = np.size(self.at)
        for name, shape in (("at", (d,)), ("normal", (d, d)), ("gradient", (d,))):
            assign(self, **{name: frozen(getattr(self, name), f"reduced system, {name}", shape)})


def stretches(unknowns: Sequence[Unknown], vectors: Mapping[Unknown, Array]) -> dict[Unknown, slice]:
    """Slices of some unknowns in their joint vector, in this order; `vectors` has one (d,) of each."""
    ends = accumulate((vectors[unknown].size for unknown in unknowns), initial=0)
    return {unknown: slice(*two) for unknown, two in zip(unknowns, pairwise(ends), strict=True)}


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """Points that depend on the same shared unknowns, and their coordinates."""

    network: Network
    """The points with their rows, and the images and shifts that they depend on."""
    reduced: ReducedSystem | None
    """None where no point is determined, or only held images see them."""
    places: Array
    """(n, 3) m, body-fixed, adjusted; NaN for undetermined points."""
    covariances: Array
    """(n, 3, 3) m^2, for sigma0 = 1; zero for fixed points, NaN for undetermined ones."""

    @property
    def sigmas(self) -> Array:
        """(n, 3) m, standard deviations of the points."""
        return sigmas_of(self.covariances)

    def __post_init__(self) -> None:
        n = len(self.network.points)
        for name, shape in (("places", (n, 3)), ("covariances", (n, 3, 3))):
            values = np.array(getattr(self, name), dtype=np.float64).reshape(shape)
            assign(self, **{name: read_only(values)})


Bundles = Mapping[Members, Bundle]
"""Bundles by the unknowns that identify them."""


@dataclass(frozen=True, slots=True, eq=False)
class Shared:
    """One adjusted unknown: the orientation coefficients of an image, or a horizontal shift."""

    prior: Array
    """(d,) m and rad, a-priori sigmas; zero mean."""
    motion: Array
    """(d,) pixels by which image places move, at most, per m and per rad."""
    ground: Array
    """(3, d) by which the ground under the image's middle moves, m per m and per rad; zero for a shift."""
    value: Array
    """(d,) m and rad, adjusted."""
    covariance: Array
    """(d, d) for sigma0 = 1, when it was last computed."""
    considered: bool = False
    """Whether it is held at zero, while its a-priori covariance is carried."""

    def __post_init__(self) -> None:
        d = np.size(self.prior)
        shapes = {"prior": (d,), "motion": (d,), "ground": (3, d), "value": (d,), "covariance": (d, d)}
        for name, shape in shapes.items():
            assign(self, **{name: frozen(getattr(self, name), f"shared unknown, {name}", shape)})

    @property
    def prior_sigmas(self) -> Array:
        """(d,) m and rad, of the prior in the tree: one that holds a considered unknown."""
        return self.prior * HELD if self.considered else self.prior

    @property
    def sigmas(self) -> Array:
        """(d,) standard deviations, m and rad, for sigma0 = 1."""
        return sigmas_of(self.covariance)


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """Result of a change."""

    bundles: dict[Members, Bundle]
    """Bundles changed, relinearized or reached, with the present positions of their points."""
    reached: dict[Members, Array]
    """Joint covariance (d, d) of the unknowns of those that a noticeable change reached, as in their reduced system."""
    updates: int
    """Number of updates of the tree."""
    systems: int
    """Number of reduced systems that were made."""
    converged: bool
    """Whether the adjustment converged."""


class StateStore(Protocol):
    """Storage of the state: in memory (`InMemory`), or in the file of a kept project."""

    def image_names(self) -> list[str]:
        """All images, in the order in which they came."""

    def image(self, name: str) -> KnownImage:
        """An image by its name."""

    def shared(self) -> dict[Unknown, Shared]:
        """All adjusted unknowns."""

    def reduced(self) -> dict[Members, ReducedSystem]:
        """The reduced systems of all bundles that have one, without any of their points."""

    def bundles_of(self, ids: Iterable[str]) -> dict[str, Members]:
        """The bundle of each stored point of these."""

    def seen_by(self, image: str) -> list[Members]:
        """Bundles with points that have a ray or a range from an image."""

    def bundle(self, members: Members) -> Bundle:
        """A bundle with its points."""

    def members(self) -> list[Members]:
        """Members of all bundles."""

    def as_network(self) -> tuple[Network, Array]:
        """The whole state as one network, images in order of addition, and places (n, 3) in m of its points."""

    def add_image(self, image: KnownImage) -> None:
        """Add an image."""

    def drop_image(self, name: str) -> None:
        """Remove an image; its bundles have been replaced before."""

    def set_shared(self, shared: Mapping[Unknown, Shared]) -> None:
        """Add unknowns or replace their values."""

    def drop_shared(self, unknowns: Iterable[Unknown]) -> None:
        """Remove shared unknowns from the store."""

    def replace(self, removed: Iterable[Members], new: Bundles) -> None:
        """Remove bundles and add others, none of which is stored."""

    def renew(self, bundles: Bundles) -> None:
        """New systems and places for bundles whose points are the same."""

    def definitions(self) -> Definitions:
        """Passes and shared unknowns; those of the networks of bundles may be older ones."""

    def set_definitions(self, definitions: Definitions) -> None:
        """Replace all definitions."""


class ImagesByName(Mapping[str, KnownImage]):
    """New images, and those of a store, read on demand."""

    def __init__(self, store: StateStore, new: Sequence[KnownImage]) -> None:
        self._store, self._new = store, {image.image.name: image for image in new}
        self._names = dict.fromkeys([*self._new, *store.image_names()])

    def __getitem__(self, name: str) -> KnownImage:
        if name not in self._names:
            raise KeyError(name)
        return self._new[name] if name in self._new else self._store.image(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


class InMemory:
    """The state in this process's memory."""

    def __init__(self) -> None:
        self._images = dict[str, KnownImage]()
        self._shared = dict[Unknown, Shared]()
        self._bundles = dict[Members, Bundle]()
        self._bundle_of = dict[str, Members]()
        self._seen_by = dict[str, dict[Members, None]]()
        self._definitions = Definitions()

    def image_names(self) -> list[str]:
        """All images, in the order in which they came."""
        return list(self._images)

    def image(self, name: str) -> KnownImage:
        """An image by its name."""
        return self._images[name]

    def shared(self) -> dict[Unknown, Shared]:
        """All adjusted unknowns."""
        return dict(self._shared)

    def reduced(self) -> dict[Members, ReducedSystem]:
        """Reduced systems of all bundles that have one."""
        return {members: bundle.reduced for members, bundle in self._bundles.items() if bundle.reduced is not None}

    def bundles_of(self, ids: Iterable[str]) -> dict[str, Members]:
        """The bundle of each stored point of these."""
        return {name: self._bundle_of[name] for name in ids if name in self._bundle_of}

    def seen_by(self, image: str) -> list[Members]:
        """Bundles with points that have a ray or a range from an image."""
        return list(self._seen_by.get(image, ()))

    def bundle(self, members: Members) -> Bundle:
        """A bundle with its points."""
        return self._bundles[members]

    def members(self) -> list[Members]:
        """Members of all bundles."""
        return list(self._bundles)

    def as_network(self) -> tuple[Network, Array]:
        """All of it as one network, and places (n, 3) in m of its points."""
        parts, definitions = [self._bundles[members] for members in sorted(self._bundles)], self._definitions
        networks = [with_definitions(bundle.network, definitions) for bundle in parts]
        network = with_images(joined(networks), list(self._images.values()))
        return with_definitions(network, definitions), np.concatenate([bundle.places for bundle in parts])

    def add_image(self, image: KnownImage) -> None:
        """Add an image."""
        self._images[image.image.name] = image

    def drop_image(self, name: str) -> None:
        """Remove an image."""
        del self._images[name]

    def set_shared(self, shared: Mapping[Unknown, Shared]) -> None:
        """Add unknowns or replace their values."""
        self._shared |= shared

    def drop_shared(self, unknowns: Iterable[Unknown]) -> None:
        """Remove shared unknowns from the store."""
        for unknown in unknowns:
            del self._shared[unknown]

    def replace(self, removed: Iterable[Members], new: Bundles) -> None:
        """Take bundles out and put others in."""
        for members in removed:
            bundle = self._bundles.pop(members)
            for name in bundle.network.points.ids:
                del self._bundle_of[name]
            for image in bundle.network.images:
                del self._seen_by[image.name][members]
        for members, bundle in new.items():
            self._bundles[members] = bundle
            self._bundle_of |= dict.fromkeys(bundle.network.points.ids, members)
            for image in bundle.network.images:
                self._seen_by.setdefault(image.name, {})[members] = None

    def renew(self, bundles: Bundles) -> None:
        """New systems and places for bundles whose points are the same."""
        self._bundles |= bundles

    def definitions(self) -> Definitions:
        """Passes and shared unknowns."""
        return self._definitions

    def set_definitions(self, definitions: Definitions) -> None:
        """Take these in the place of all that there are."""
        self._definitions = definitions


def with_addition(
    store: StateStore, addition: Network | None, definitions: Definitions | None = None, turned: Iterable[Members] = ()
) -> tuple[list[Members], dict[Members, Network]]:
    """Bundles that share points with an addition, and what they become with it.

    Parameters
    ----------
    addition : Network or None
        Points with their rows.
    known : Definitions, optional
        Passes and shared unknowns from now on; those of the store when absent.
    turned : iterable of Members
        Bundles that are replaced in any case: their passes have changed.

    Raises
    ------
    InputError
        When the two contradict (`network.parts.joined`).
    """
    definitions = store.definitions() if definitions is None else definitions
    if addition is None:
        replaced = sorted(set(turned))
        return _completed(store, replaced, [store.bundle(members).network for members in replaced], definitions)
    replaced = sorted({*store.bundles_of(addition.points.ids).values(), *turned})
    return _completed(store, replaced, [*(store.bundle(m).network for m in replaced), addition], definitions)


def without(
    store: StateStore, images: Sequence[str], definitions: Definitions | None = None, turned: Iterable[Members] = ()
) -> tuple[list[Members], dict[Members, Network]]:
    """Bundles that some images see, and what remains of them; points that no other image sees are removed, too."""
    definitions = store.definitions() if definitions is None else definitions
    replaced = list(dict.fromkeys([*(members for image in images for members in store.seen_by(image)), *turned]))
    rest = [without_images(store.bundle(members).network, images) for members in replaced]
    return _completed(store, replaced, rest, definitions)


def with_points(
    store: StateStore, ids: Sequence[str], network: Network | None, definitions: Definitions,
    turned: Iterable[Members] = (),
) -> tuple[list[Members], dict[Members, Network]]:  # fmt: skip
    """Bundles with some points, and what they become when a network replaces these points; None removes them."""
    replaced = sorted({*store.bundles_of(ids).values(), *turned})
    rest = [without_points(store.bundle(members).network, ids) for members in replaced]
    return _completed(store, replaced, [*rest, network], definitions)


def require_one_body(store: StateStore, new: Sequence[KnownImage]) -> None:
    """Raise InputError for a new image that shows another body than the stored ones, or than the first new one."""
    names = store.image_names()
    present = [store.image(names[0])] if names else []
    for image in new:
        first = (present or new)[0].image
        if image.image.body != first.body:
            problem = f"a body of {image.image.body.equatorial / KM:.1f} km"
            expected = f"that of image {first.name}, {first.body.equatorial / KM:.1f} km"
            raise InputError(f"image {image.image.name}", problem, expected, "use one project for each body")


def _completed(
    store: StateStore, replaced: list[Members], remaining: Sequence[Network | None], definitions: Definitions
) -> tuple[list[Members], dict[Members, Network]]:
    """Bundles of what remains, joined with stored bundles of the same unknowns."""
    parts = [with_definitions(part, definitions) for part in remaining if part is not None]
    completed = bundles(joined(parts)) if parts else {}
    unchanged = set(store.members()) - set(replaced)
    if touched := [members for members in completed if members in unchanged]:
        more = (with_definitions(store.bundle(members).network, definitions) for members in touched)
        completed = bundles(joined([*parts, *more]))
    return [*replaced, *touched], completed


if TYPE_CHECKING:
    from mgsgraph.adjustment.solution import Solution

_PLACES = 17
"""Times of each image at which the basis between nodes is looked at."""


def image_motion(known_image: KnownImage) -> Array:
    """(6 (degree + 1),) pixels by which image places move, at most, per m and per rad of each coefficient."""
    image = known_image.image
    middle = np.array([[0.5 * image.lines, 0.5 * image.samples]])
    per_radian = 1.0 / image.pixel_angle
    ground, _ = image.image_to_ground(*middle.T)
    position = image.pose(middle[:, 0]).position
    distance = float(np.linalg.norm(ground[0] - position[0]))
    if not math.isfinite(distance):  # it looks past the body
        distance = float(np.linalg.norm(position[0])) - image.body.equatorial
    return np.tile(np.repeat([per_radian / distance, per_radian], 3), known_image.prior.degree + 1)


def ground_motion(known_image: KnownImage, angles: Angles) -> Array:
    """(3, 6 (degree + 1)) by which the ground under an image's middle (u = 0) moves, m per m and per rad of each
    coefficient, on the ellipsoid; zero where it looks past the body.
    """
    image, terms = known_image.image, known_image.prior.degree + 1
    line, sample = image.middle
    origin, direction, _, _ = image.rays(line, sample)
    _, by_origin, by_direction = intersect_ellipsoid(origin, direction, image.body, 0.0)
    pose = image.pose(line)
    turn = OrientationCorrection(np.zeros((terms, 6)), angles).axes(pose, image.moments(line))[0]
    look = pose.matrix[0] @ direction[0]
    # M = Exp([theta]x)' M0: a ray d = M' look turns by M0' (theta x look)
    turned = -pose.matrix[0].T @ skew(look) @ turn
    jacobian = np.zeros((3, 6 * terms))
    jacobian[:, :3], jacobian[:, 3:6] = by_origin[0], by_direction[0] @ turned
    return jacobian if np.all(np.isfinite(jacobian)) else np.zeros_like(jacobian)


def shared_image(image: KnownImage, angles: Angles) -> Shared:
    """A-priori orientation of an image."""
    prior = image.prior.sigmas.ravel()
    return Shared(prior, image_motion(image), ground_motion(image, angles), np.zeros(prior.size), np.diag(prior**2))


def shared_shift(network: Network, name: str, motion: float) -> Shared:
    """A horizontal shift of a network, eastward and northward, as it is beforehand; `motion` is pixels per m."""
    sigma, considered = network.shift_sigma(name), name in network.considered
    unmoved = np.full(2, sigma), np.full(2, motion), np.zeros((3, 2)), np.zeros(2), np.eye(2) * sigma**2
    return Shared(*unmoved, considered)


def shared_pass(pass_: NamedPass, images: Mapping[str, KnownImage], angles: Angles) -> dict[Unknown, Shared]:
    """A-priori orientation images and trend of a pass.

    Raises InputError where a component has no a-priori sigma: iSAM2 needs one.
    """
    seen_images = [images[name] for name in pass_.images]
    edges = spans(each.image for each in seen_images) - pass_.nodes.epoch
    sigmas = pass_.prior.node_sigmas(normalised(pass_.nodes))
    if not np.all(np.isfinite(sigmas)):
        expected = "finite sigmas, which iSAM2 needs to begin with"
        raise InputError(f"pass {pass_.name!r}", "orientation images without an a-priori sigma", expected)
    moving, names = _node_motion(pass_, seen_images, edges), pass_unknowns(pass_)
    states = dict[Unknown, Shared]()
    for name, time, prior in zip(names, pass_.nodes.times.tolist(), sigmas, strict=False):
        near = int(np.maximum(edges[:, 0] - time, time - edges[:, 1]).argmin())
        ground = ground_motion(seen_images[near], angles)[:, :6]
        if pass_.axes is not None:
            ground = np.hstack([ground[:, :3], ground[:, 3:] @ pass_.axes[near]])
        states[name] = Shared(prior, moving, ground, np.zeros(6), np.diag(prior**2))
    if pass_.prior.trend_sigmas.size:
        states[names[-1]] = _unmoving(pass_.prior.trend_sigmas)
    return states


def _node_motion(pass_: NamedPass, images: Sequence[KnownImage], edges: Array) -> Array:
    """(6,) pixels by which image places move, at most, per m and per rad of all nodes of a pass."""
    times = np.linspace(edges[:, 0], edges[:, 1], _PLACES).ravel()
    weights = np.abs(pass_.nodes.at(times, pass_.nodes.epoch)[1]).sum(axis=1)
    lenses = {(each.image.pixel_angle, each.image.interior.focal_length): each for each in images}
    return np.asarray(np.max([image_motion(each)[:6] for each in lenses.values()], axis=0) * weights.max())


def _unmoving(sigmas: Array, motion: Array | None = None, considered: bool = False) -> Shared:
    """A-priori state of an unknown that moves no ground of its own."""
    zero = np.zeros(sigmas.size)
    moving = zero if motion is None else motion
    return Shared(sigmas, moving, np.zeros((3, sigmas.size)), zero, np.diag(sigmas**2), considered)


def shared_by_images(unknown: NamedShared, images: Mapping[str, KnownImage], angles: Angles) -> Shared:
    """A-priori state of an unknown that images share; its motion is that of the image that it moves most."""
    largest = np.zeros(unknown.kind.width)
    seeing = (images[name] for name in unknown.images)
    for known_image in {(i.image.pixel_angle, i.image.lines): i for i in seeing}.values():
        motion, image = image_motion(known_image)[:6], known_image.image
        if unknown.kind.moves_pose:
            effect = np.abs(image_effect(image, unknown.kind, angles)).sum(axis=1)
            largest = np.maximum(largest, effect @ motion)
        elif unknown.kind is SharedKind.FOCAL_LENGTH:
            place, _ = image.interior.focal_plane(np.array([0.5, image.samples - 0.5]))
            widest = float(np.linalg.norm(place, axis=1).max())
            largest = np.maximum(largest, widest / image.interior.focal_length**2 / image.pixel_angle)
        elif unknown.kind.acts_on_rays:
            largest = np.maximum(largest, 1.0 / unknown.sigmas)  # linear: a sigma is taken as a pixel
    return _unmoving(unknown.sigmas, largest, unknown.considered)


def shared_of(solution: "Solution") -> dict[Unknown, Shared]:
    """The adjusted unknowns of a batch solution."""
    network, angles, adjusted = solution.network, solution.settings.angles, dict[Unknown, Shared]()
    names, count = unknowns(network), len(network.images)
    for j, (image, prior) in enumerate(zip(network.images, network.priors, strict=True)):
        if network.with_polynomial[j]:
            start = shared_image(KnownImage(image, prior), angles)
            value, covariance = solution.coefficients[j].ravel(), solution.image_covariance(j)
            adjusted[names[j]] = replace(start, value=value, covariance=covariance)
    motion = max((float(start.motion[0]) for start in adjusted.values()), default=1.0)
    for p, name in enumerate(network.shift_names):
        start = shared_shift(network, name, motion)
        adjusted[names[count + p]] = replace(start, value=solution.shifts[p], covariance=solution.shift_covariance(p))
    defined, images = definitions(network), {image.image.name: image for image in known_images(network)}
    more = {Unknown("shared", n): shared_by_images(s, images, angles) for n, s in defined.shared.items()}
    for pass_ in defined.passes.values():
        more |= shared_pass(pass_, images, angles)
    values = solution.values
    for v, unknown in enumerate(names[network.first_shared :], network.first_shared):
        adjusted[unknown] = replace(more[unknown], value=values[v], covariance=solution.joint_covariance.block(v, v))
    return adjusted
