"""What an incremental adjustment keeps between two changes: bundles with their reduced systems, and shared unknowns.

A bundle is all points that depend on the same shared unknowns (not the bundle of rays of one image). Its reduced system
(points solved and eliminated at one orientation) is all that the tree of iSAM2 ever sees of it; its points are asked
for only when a change touches them.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Protocol

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.network import HELD, Network
from mgsgraph.network.definitions import Definitions, with_definitions
from mgsgraph.network.parts import KnownImage as KnownImage
from mgsgraph.network.parts import Members, Unknown, bundles, joined, with_images, without_images, without_points
from mgsgraph.units import KM

NOTICEABLE = 0.01
"""Sigmas from which a move is stated."""


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
    """Pixels by which image places may move before it has to be made anew (`sweep.slack`)."""

    def __post_init__(self) -> None:
        d = np.size(self.at)
        for name, shape in (("at", (d,)), ("normal", (d, d)), ("gradient", (d,))):
            assign(self, **{name: frozen(getattr(self, name), f"reduced system, {name}", shape)})


def stretches(unknowns: Sequence[Unknown], vectors: Mapping[Unknown, Array]) -> dict[Unknown, slice]:
    """Where each of some unknowns lies in a joint vector of theirs, in this order; `vectors` has one (d,) of each."""
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
        return np.asarray(np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2)))

    def __post_init__(self) -> None:
        n = len(self.network.points)
        for name, shape in (("places", (n, 3)), ("covariances", (n, 3, 3))):
            values = np.array(getattr(self, name), dtype=np.float64).reshape(shape)
            values.flags.writeable = False
            assign(self, **{name: values})


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
    """(d, d) for sigma0 = 1, when it was looked at last."""
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
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """Result of a change."""

    bundles: dict[Members, Bundle]
    """Bundles changed, made anew or reached, with their points where they are now."""
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
        """For those of the points that are there: their bundle."""

    def seen_by(self, image: str) -> list[Members]:
        """Bundles with points that have a ray or a range from an image."""

    def bundle(self, members: Members) -> Bundle:
        """A bundle with its points."""

    def members(self) -> list[Members]:
        """Members of all bundles."""

    def everything(self) -> tuple[Network, Array]:
        """All of it as one network, images in the order in which they came, and places (n, 3) in m of its points."""

    def put_image(self, known: KnownImage) -> None:
        """Add an image."""

    def drop_image(self, name: str) -> None:
        """Take an image out; its bundles have been replaced before."""

    def put_shared(self, shared: Mapping[Unknown, Shared]) -> None:
        """Add unknowns or replace their values."""

    def drop_shared(self, unknowns: Iterable[Unknown]) -> None:
        """Remove shared unknowns from the store."""

    def replace(self, gone: Iterable[Members], new: Mapping[Members, Bundle]) -> None:
        """Take bundles out and put others in, none of which is there."""

    def renew(self, bundles: Mapping[Members, Bundle]) -> None:
        """New systems and places for bundles whose points are the same."""

    def definitions(self) -> Definitions:
        """Passes and shared unknowns; those of the networks of bundles may be older ones."""

    def put_definitions(self, known: Definitions) -> None:
        """Take these in the place of all that there are."""


class ImagesByName(Mapping[str, KnownImage]):
    """New images, and those of a store, read when they are asked for."""

    def __init__(self, store: StateStore, new: Sequence[KnownImage]) -> None:
        self._store, self._new = store, {one.image.name: one for one in new}
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
        """For those of the points that are there: their bundle."""
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

    def everything(self) -> tuple[Network, Array]:
        """All of it as one network, and places (n, 3) in m of its points."""
        parts, known = [self._bundles[members] for members in sorted(self._bundles)], self._definitions
        networks = [with_definitions(one.network, known) for one in parts]
        whole = with_images(joined(networks), list(self._images.values()))
        return with_definitions(whole, known), np.concatenate([one.places for one in parts])

    def put_image(self, known: KnownImage) -> None:
        """Add an image."""
        self._images[known.image.name] = known

    def drop_image(self, name: str) -> None:
        """Remove an image."""
        del self._images[name]

    def put_shared(self, shared: Mapping[Unknown, Shared]) -> None:
        """Add unknowns or replace their values."""
        self._shared |= shared

    def drop_shared(self, unknowns: Iterable[Unknown]) -> None:
        """Remove shared unknowns from the store."""
        for unknown in unknowns:
            del self._shared[unknown]

    def replace(self, gone: Iterable[Members], new: Mapping[Members, Bundle]) -> None:
        """Take bundles out and put others in."""
        for members in gone:
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

    def renew(self, bundles: Mapping[Members, Bundle]) -> None:
        """New systems and places for bundles whose points are the same."""
        self._bundles |= bundles

    def definitions(self) -> Definitions:
        """Passes and shared unknowns."""
        return self._definitions

    def put_definitions(self, known: Definitions) -> None:
        """Take these in the place of all that there are."""
        self._definitions = known


def with_addition(
    store: StateStore, addition: Network | None, known: Definitions | None = None, turned: Iterable[Members] = ()
) -> tuple[list[Members], dict[Members, Network]]:
    """Bundles with points that an addition sees, too, and what they become with it.

    Parameters
    ----------
    addition : Network or None
        Points with their rows.
    known : Definitions, optional
        Passes and shared unknowns from now on; those of the store when absent.
    turned : iterable of Members
        Bundles that become others in any case, as the passes that they see are not what they were.

    Raises
    ------
    InputError
        When the two contradict each other (`network.parts.joined`).
    """
    known = store.definitions() if known is None else known
    if addition is None:
        gone = sorted(set(turned))
        return _completed(store, gone, [store.bundle(members).network for members in gone], known)
    gone = sorted({*store.bundles_of(addition.points.ids).values(), *turned})
    return _completed(store, gone, [*(store.bundle(members).network for members in gone), addition], known)


def without(
    store: StateStore, images: Sequence[str], known: Definitions | None = None, turned: Iterable[Members] = ()
) -> tuple[list[Members], dict[Members, Network]]:
    """Bundles that some images see, and what is left of them; points that nothing else sees go with the images.
    `known` and `turned` as in `with_addition`.
    """
    known = store.definitions() if known is None else known
    gone = list(dict.fromkeys([*(members for image in images for members in store.seen_by(image)), *turned]))
    parts = (store.bundle(members).network for members in gone)
    rest = [left for network in parts if (left := without_images(network, images)) is not None]
    return _completed(store, gone, rest, known)


def with_points(
    store: StateStore, ids: Sequence[str], network: Network | None, known: Definitions
) -> tuple[list[Members], dict[Members, Network]]:
    """Bundles that have some points, and what they become with these as a network has them; None: without them."""
    gone = sorted(set(store.bundles_of(ids).values()))
    parts = (store.bundle(members).network for members in gone)
    rest = [left for one in parts if (left := without_points(one, ids)) is not None]
    return _completed(store, gone, rest if network is None else [*rest, network], known)


def require_one_body(store: StateStore, new: Sequence[KnownImage]) -> None:
    """Raise InputError for a new image that shows another body than those that are there, or than the first new one."""
    there = store.image_names()
    known = [store.image(there[0])] if there else []
    for one in new:
        first = (known or new)[0].image
        if one.image.body != first.body:
            found = f"a body of {one.image.body.equatorial / KM:.1f} km"
            expected = f"that of image {first.name}, {first.body.equatorial / KM:.1f} km"
            raise InputError(f"image {one.image.name}", found, expected, "keep bodies apart, in projects of their own")


def _completed(
    store: StateStore, gone: list[Members], parts: list[Network], known: Definitions
) -> tuple[list[Members], dict[Members, Network]]:
    """Bundles of some parts, together with those that were there before of the same unknowns."""
    parts = [with_definitions(one, known) for one in parts]
    found = bundles(joined(parts)) if parts else {}
    there = set(store.members()) - set(gone)
    if others := [members for members in found if members in there]:
        more = (with_definitions(store.bundle(members).network, known) for members in others)
        found = bundles(joined([*parts, *more]))
    return [*gone, *others], found
