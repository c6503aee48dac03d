"""Passes and shared unknowns that grow and shrink with the images of an incremental adjustment.

A pass is continued on its own grid: nodes that are there keep their times, new ones come before and after them at its
spacing (`OrientationImages.over`), and what is known of its trend counts from its first nodes (`span`), so that the
rows of old nodes stay what they are. One polynomial (four nodes of a `PolynomialPrior`) has no grid: its nodes and its
span stay those of the first images, and it holds before and after them. With the last image that needs them nodes go.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from mgsgraph.adjustment.incremental.bayes_tree import PriorRows
from mgsgraph.adjustment.incremental.state import StateStore
from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.network.joining import Definitions, NamedPass, mountings, seconds, united
from mgsgraph.network.parts import KnownImage, Members, Unknown, pass_unknowns
from mgsgraph.network.passes import PolynomialPrior

_UNTURNED = 1e-3
"""Of a mounting's matrix, by which two statements of it may differ."""
_SAME_WAY = 0.1
"""rad by which attitudes may differ, at times that are not the same, of lines of one camera."""
_NEIGHBOURS = 6
"""Images of a pass, nearest in time, against which another one's clock, position and mounting are tried."""


class KnowsImages(Protocol):
    """Who has images by their names."""

    def image(self, name: str) -> KnownImage:
        """An image by its name."""
        ...


def extended(
    store: KnowsImages, known: Definitions, brought: Definitions, new: Sequence[KnownImage]
) -> Definitions:
    """Definitions with those that new images bring: of passes that are there the images alone count, for which the
    nodes of these are continued.

    Raises
    ------
    InputError
        For an image whose clock, position or mounting contradicts those of the pass; for one that is there already, on
        its own or in another pass; for a shared unknown of another kind or other sigmas.
    """
    fresh = {one.image.name: one.image for one in new}
    passes = dict(known.passes)
    for name, one in brought.passes.items():
        for image in one.images:
            owner = known.of_image(image)
            if image not in fresh and (owner is None or owner.name != name):
                found = "an image that is there already, " + (f"in pass {owner.name!r}" if owner else "on its own")
                raise InputError(f"pass {name!r}, image {image}", found, "a new image", "remove it first to replace it")
        if name not in passes:
            passes[name] = replace(one, nodes=replace(one.nodes, span=one.nodes.trend_span))
            continue
        joining = [fresh[image] for image in one.images if image in fresh]
        if joining:
            passes[name] = _joined_by(store, passes[name], joining, one.axes is None)
    shared = united([Definitions(shared=known.shared), Definitions(shared=brought.shared)]).shared
    return Definitions(passes, shared)


def shortened(store: StateStore, known: Definitions, gone: Iterable[str]) -> Definitions:
    """Definitions without some images: a pass and a shared unknown without any goes, and nodes that none needs."""
    out = set(gone)
    left = known.of({image for one in known.passes.values() for image in one.images} - out)
    shared = known.of({image for one in known.shared.values() for image in one.images} - out).shared
    passes = {
        name: one if one is known.passes[name] else _over(one, [store.image(image).image for image in one.images])
        for name, one in left.passes.items()
    }
    return Definitions(passes, shared)


def _over(one: NamedPass, images: Sequence[PushbroomImage]) -> NamedPass:
    """A pass with the nodes that its images need."""
    if isinstance(one.prior, PolynomialPrior):
        return one
    edges = np.array([seconds(image) for image in images]) - one.nodes.epoch
    nodes = one.nodes.over(float(edges[:, 0].min()), float(edges[:, 1].max()))
    same = np.array_equal(nodes.times, one.nodes.times)
    return one if same else replace(one, nodes=nodes)


def _joined_by(store: KnowsImages, one: NamedPass, joining: Sequence[PushbroomImage], alike: bool) -> NamedPass:
    """A pass with more images: mounted as their nominal attitudes say, its nodes continued over their lines. `alike`:
    where they have no time in common, lines that look the same way are of one camera.
    """
    where = f"pass {one.name!r}"
    there = [store.image(name).image for name in one.images]
    edges = np.array([seconds(image) for image in there])
    for image in joining:
        start, stop = seconds(image)
        apart = np.maximum(edges[:, 0] - stop, start - edges[:, 1])
        near = sorted(np.argsort(apart, kind="stable")[:_NEIGHBOURS].tolist())
        one_camera = alike and one.axes is None and _turned(there[int(np.argmin(apart))], image) < _SAME_WAY
        found = mountings([there[k] for k in near] + [image], where, one_camera)
        turn = np.eye(3) if found is None else found[-1]
        turn = turn if one.axes is None else turn @ one.axes[near[0]]
        mounted = None if one.axes is None and np.abs(turn - np.eye(3)).max() < _UNTURNED else turn[None]
        one = one.with_images(NamedPass(one.name, (image.name,), one.nodes, one.prior, mounted))
        there, edges = [*there, image], np.vstack([edges, [start, stop]])
    first, last = one.nodes.coverage
    start, stop = float(edges[:, 0].min()) - one.nodes.epoch, float(edges[:, 1].max()) - one.nodes.epoch
    if first <= start and stop <= last:
        return one
    if isinstance(one.prior, PolynomialPrior):
        return replace(one, whole=False)  # one cubic polynomial, which holds before and after them
    nodes = one.nodes.over(min(first, start), max(last, stop))
    return one if np.array_equal(nodes.times, one.nodes.times) else replace(one, nodes=nodes)


def _turned(one: PushbroomImage, other: PushbroomImage) -> float:
    """Rad by which the nominal attitudes of two images differ where they come nearest in time."""
    (first, last), (start, stop) = seconds(one), seconds(other)
    times = np.clip(0.5 * (max(first, start) + min(last, stop)), [first, start], [last, stop])
    poses = [image.trajectory.pose(times[k : k + 1] - image.trajectory.epoch) for k, image in enumerate((one, other))]
    return float(np.linalg.norm(rotation.logarithm(poses[1].matrix @ np.swapaxes(poses[0].matrix, 1, 2))[0]))


def turned_bundles(store: StateStore, before: Definitions, after: Definitions) -> list[Members]:
    """Bundles whose points depend on other orientation images than they did: those at ends that a pass has no more."""
    ends = set[Unknown]()
    for name, one in before.passes.items():
        now = after.passes.get(name)
        if now is None or now.nodes is one.nodes:
            continue
        was, there = pass_unknowns(one), set(pass_unknowns(now))
        nodes = was[: len(one.nodes)]
        ends |= {node for node in nodes if node not in there}
        if one.nodes.times[0] != now.nodes.times[0]:
            ends.add(next(node for node in nodes if node in there))
        if one.nodes.times[-1] != now.nodes.times[-1]:
            ends.add(next(node for node in reversed(nodes) if node in there))
    return [members for members in store.members() if not ends.isdisjoint(members)] if ends else []


def unknowns_of(known: Definitions) -> Members:
    """All unknowns of passes, and those that images share."""
    nodes = (unknown for one in known.passes.values() for unknown in pass_unknowns(one))
    return (*nodes, *(Unknown("shared", name) for name in known.shared))


def prior_rows(known: Definitions) -> list[PriorRows]:
    """What is known of the orientation images and the trends of passes beforehand."""
    found = list[PriorRows]()
    for one in known.passes.values():
        names = pass_unknowns(one)
        for unknowns, blocks, _ in one.prior.factors(one.nodes):
            found.append(PriorRows(tuple(names[k] for k in unknowns), blocks))
    return found


def expected(
    rows: Iterable[PriorRows], new: Mapping[Unknown, Array], values: Mapping[Unknown, Array]
) -> dict[Unknown, Array]:
    """Values (d,) of new unknowns of passes, m and rad, that rows expect of the present ones; `new` are their units."""
    rows = [one for one in rows if not set(new).isdisjoint(one.unknowns)]
    if not any(unknown in values for one in rows for unknown in one.unknowns):
        return {unknown: np.zeros(unit.size) for unknown, unit in new.items()}
    first, size = dict[Unknown, int](), 0
    for unknown, unit in new.items():
        first[unknown], size = size, size + unit.size
    height = sum(one.whitened[0].shape[0] for one in rows)
    design, right, at = np.zeros((height, size)), np.zeros(height), 0
    for one in rows:
        mine = slice(at, at + one.whitened[0].shape[0])
        for unknown, block in zip(one.unknowns, one.whitened, strict=True):
            if unknown in new:
                design[mine, first[unknown] : first[unknown] + block.shape[1]] = block * new[unknown]
            else:
                right[mine] -= block @ values[unknown]
        at = mine.stop
    found = np.linalg.lstsq(design, right, rcond=None)[0]
    return {unknown: found[k : k + new[unknown].size] * new[unknown] for unknown, k in first.items()}
