"""Passes and shared unknowns by the names of their images: what they are outlives the networks that a bundle, an
addition or everything together make, in which images have numbers.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation import OrientationImages
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network.network import Network
from mgsgraph.network.passes import Pass, PassPrior
from mgsgraph.network.shared import SharedKind, SharedUnknown


@dataclass(frozen=True, slots=True, eq=False)
class NamedPass:
    """A pass by the names of its images."""

    name: str
    """What to call it."""
    images: tuple[str, ...]
    """(m,) names of its images."""
    nodes: OrientationImages
    """Times of the orientation images, and the basis between them."""
    prior: PassPrior
    """What is known of them."""
    axes: Array | None = None
    """(m, 3, 3) how each camera is mounted (`network.passes.Pass`)."""
    whole: bool = True
    """Whether its nodes reach over all lines of its images (`network.passes.Pass`)."""

    def of(self, names: Iterable[str]) -> "NamedPass | None":
        """The same with some images alone, in the order that it has; None without any."""
        wanted = set(names)
        chosen = [k for k, name in enumerate(self.images) if name in wanted]
        if len(chosen) == len(self.images):
            return self
        axes = None if self.axes is None else self.axes[chosen]
        return replace(self, images=tuple(self.images[k] for k in chosen), axes=axes) if chosen else None

    def with_images(self, other: "NamedPass") -> "NamedPass":
        """The same with those images of another one that it has not."""
        more = [k for k, name in enumerate(other.images) if name not in self.images]
        if not more:
            return self
        axes = None
        if self.axes is not None or other.axes is not None:
            axes = np.concatenate([_axes(self), _axes(other)[more]])
        return replace(self, images=(*self.images, *(other.images[k] for k in more)), axes=axes)

    def numbered(self, number: Mapping[str, int]) -> Pass:
        """In a network in which its images have these numbers."""
        images = np.array([number[name] for name in self.images])
        return Pass(self.name, images, self.nodes, self.prior, self.axes, self.whole)


@dataclass(frozen=True, slots=True, eq=False)
class NamedShared:
    """A shared unknown by the names of its images."""

    name: str
    """What to call it."""
    kind: SharedKind
    """What it is."""
    images: tuple[str, ...]
    """Names of the images that share it."""
    sigmas: Array
    """(kind.width,) a-priori, in the kind's unit."""
    considered: bool = False
    """Whether it is held at zero, while its a-priori covariance is carried."""

    def of(self, names: Iterable[str]) -> "NamedShared | None":
        """The same with some images alone; None without any."""
        wanted = set(names)
        chosen = tuple(name for name in self.images if name in wanted)
        return replace(self, images=chosen) if chosen else None


@dataclass(frozen=True, slots=True, eq=False)
class Definitions:
    """All passes and shared unknowns, by name."""

    passes: Mapping[str, NamedPass] = field(default_factory=dict)
    """Images on one trajectory."""
    shared: Mapping[str, NamedShared] = field(default_factory=dict)
    """Unknowns that several images share."""

    def __bool__(self) -> bool:
        return bool(self.passes or self.shared)

    def of(self, names: Iterable[str]) -> "Definitions":
        """What of it concerns some images."""
        wanted = set(names)
        passes = {name: one for name, every in self.passes.items() if (one := every.of(wanted)) is not None}
        shared = {name: few for name, all_of in self.shared.items() if (few := all_of.of(wanted)) is not None}
        return Definitions(passes, shared)

    def of_image(self, name: str) -> NamedPass | None:
        """The pass of an image; None for one on its own."""
        return next((one for one in self.passes.values() if name in one.images), None)


def definitions(network: Network) -> Definitions:
    """Of a network."""
    names = [image.name for image in network.images]

    def named(images: Index) -> tuple[str, ...]:
        return tuple(names[j] for j in images.tolist())

    passes = {
        one.name: NamedPass(one.name, named(one.images), one.nodes, one.prior, one.axes, one.whole)
        for one in network.passes
    }
    shared = {
        one.name: NamedShared(one.name, one.kind, named(one.images), one.sigmas, one.name in network.considered)
        for one in network.shared
    }
    return Definitions(passes, shared)


def with_definitions(network: Network, known: Definitions) -> Network:
    """A network with these passes and shared unknowns in the place of its own, as far as its images have them."""
    if not (known or network.passes or network.shared):
        return network
    number = {image.name: j for j, image in enumerate(network.images)}
    mine = known.of(number)
    considered = [name for name in network.considered if name in network.shift_names]
    considered += [one.name for one in mine.shared.values() if one.considered]
    return replace(
        network,
        passes=tuple(one.numbered(number) for one in mine.passes.values()),
        shared=tuple(
            SharedUnknown(one.name, one.kind, np.array([number[name] for name in one.images]), one.sigmas)
            for one in mine.shared.values()
        ),
        considered=tuple(considered),
    )


def united(parts: Sequence[Definitions]) -> Definitions:
    """Several as one: what has the same name is the same, and has the images of all.

    Raises InputError where parts contradict each other: other nodes, priors, kinds or sigmas, an image of two passes.
    """
    passes, shared, owner = dict[str, NamedPass](), dict[str, NamedShared](), dict[str, str]()
    for part in parts:
        both: list[tuple[dict[str, Any], Mapping[str, Any]]] = [(passes, part.passes), (shared, part.shared)]
        for every, own in both:
            every |= {name: _united(every[name], one) if name in every else one for name, one in own.items()}
    for name, one in passes.items():
        for image in one.images:
            if owner.setdefault(image, name) != name:
                raise InputError(f"image {image}", f"of the passes {owner[image]} and {name}", "one pass")
    return Definitions(passes, shared)


def _united(one: Any, other: Any) -> Any:
    """A pass, or a shared unknown, of two parts."""
    where = f"{'pass' if isinstance(one, NamedPass) else 'shared unknown'} {one.name!r}"
    for part in fields(one):
        of_parts = getattr(one, part.name), getattr(other, part.name)
        if part.name not in ("images", "axes", "whole") and not alike(*of_parts):
            said = "" if is_dataclass(of_parts[0]) else f" ({of_parts[1]}, {of_parts[0]} before)"
            found = f"{part.name} in one part other than in another{said}"
            raise InputError(where, found, "the same", "give it another name, or state both alike")
    if isinstance(one, NamedPass):
        return replace(one.with_images(other), whole=one.whole and other.whole)
    return replace(one, images=tuple(dict.fromkeys([*one.images, *other.images])))


def joining(
    known: Definitions, image: str, of_pass: str = "", shares: Sequence[str] = (), where: str = "image"
) -> Definitions:
    """Definitions by which an image joins a pass that is known, and shared unknowns; how its camera is mounted its
    attitude says.

    Raises InputError, naming `where`, for an unknown name.
    """
    wanted = [("pass", of_pass, list(known.passes))] if of_pass else []
    for what, name, there in [*wanted, *(("shared unknown", one, list(known.shared)) for one in shares)]:
        if name not in there:
            names = ", ".join(there[:4]) or "there is none"
            raise InputError(where, f"no {what} {name!r}", f"one that is there ({names})", "begin it in a case file")
    passes = [replace(known.passes[of_pass], images=(image,), axes=None)] if of_pass else []
    shared = [replace(known.shared[name], images=(image,)) for name in shares]
    return Definitions({one.name: one for one in passes}, {one.name: one for one in shared})


def latest(parts: Sequence[Definitions]) -> Definitions:
    """Several as one, as `united`, where passes of some parts have been continued: each has the nodes of all parts."""
    times = dict[str, list[Array]]()
    for part in parts:
        for name, one in part.passes.items():
            times.setdefault(name, []).append(one.nodes.times)
    merged = {name: np.unique(np.concatenate(every)) for name, every in times.items()}

    def with_all(one: NamedPass) -> NamedPass:
        every = merged[one.name]
        if every.size == one.nodes.times.size and one.nodes.span is not None:
            return one
        return replace(one, nodes=replace(one.nodes, times=every, span=one.nodes.trend_span))

    passes = [{name: with_all(one) for name, one in part.passes.items()} for part in parts]
    return united([Definitions(mine, part.shared) for mine, part in zip(passes, parts, strict=True)])


def _axes(one: NamedPass) -> Array:
    """(m, 3, 3)"""
    return np.broadcast_to(np.eye(3), (len(one.images), 3, 3)) if one.axes is None else one.axes


def alike(one: Any, other: Any) -> bool:
    """Whether two records, arrays or plain values say the same."""
    if one is other:
        return True
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    if is_dataclass(one):
        return all(alike(getattr(one, part.name), getattr(other, part.name)) for part in fields(one))
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(alike, one, other))
    return bool(one == other)
