"""Passes and shared unknowns that grow and shrink with the images of an incremental adjustment.

A pass is continued on its own grid: old nodes keep their times, new ones come before and after them at its spacing
(`OrientationImages.over`), and the prior of its trend counts from its first nodes (`span`), so that the rows of old
nodes do not change. One polynomial (four nodes of a `PolynomialPrior`) has no grid: its nodes and its span stay those
of the first images, and it holds before and after them. Nodes are removed with the last image that needs them.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from mgsgraph.adjustment.incremental.bayes_tree import PriorRows
from mgsgraph.adjustment.incremental.state import StateStore
from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.network.joining import Definitions, NamedPass, mountings, seconds, spans, united
from mgsgraph.network.parts import ByUnknown, KnownImage, Members, Unknown, pass_unknowns
from mgsgraph.network.passes import PolynomialPrior

_UNTURNED = 1e-3
"""Largest difference of an element between two matrices of the same mounting."""
_SAME_WAY = 0.1
"""rad by which attitudes may differ, at times that are not the same, of lines of one camera."""
_NEIGHBOURS = 6
"""Images of a pass, nearest in time, with which the clock, position and mounting of another one are compared."""


class KnowsImages(Protocol):
    """A source of images by name."""

    def image(self, name: str) -> KnownImage:
        """An image by its name."""
        ...


def extended(
    store: KnowsImages, present: Definitions, brought: Definitions, new: Sequence[KnownImage]
) -> Definitions:
    """Definitions with those of new images. A pass that is defined already takes their images alone, and its nodes are
    continued over them.

    Raises
    ------
    InputError
        For an image whose clock, position or mounting contradicts those of the pass; for one in the adjustment already,
        alone or in another pass; for a shared unknown of another kind or other sigmas.
    """
    fresh = {known_image.image.name: known_image.image for known_image in new}
    passes = dict(present.passes)
    for name, pass_ in brought.passes.items():
        for image in pass_.images:
            owner = present.of_image(image)
            if image not in fresh and (owner is None or owner.name != name):
                problem = "an image that is there already, " + (f"in pass {owner.name!r}" if owner else "on its own")
                where = f"pass {name!r}, image {image}"
                raise InputError(where, problem, "a new image", "remove it first to replace it")
        if name not in passes:
            passes[name] = replace(pass_, nodes=replace(pass_.nodes, span=pass_.nodes.trend_span))
            continue
        joining = [fresh[image] for image in pass_.images if image in fresh]
        if joining:
            passes[name] = _joined_by(store, passes[name], joining, pass_.axes is None)
    return Definitions(passes, united([Definitions(shared=present.shared), Definitions(shared=brought.shared)]).shared)


def shortened(store: StateStore, definitions: Definitions, removed: Iterable[str]) -> Definitions:
    """Definitions without some images, without passes and shared unknowns of these alone, and without unused nodes."""
    out = set(removed)
    remaining = definitions.of({image for pass_ in definitions.passes.values() for image in pass_.images} - out)
    shared = definitions.of({image for pass_ in definitions.shared.values() for image in pass_.images} - out).shared
    passes = {
        name: pass_ if pass_ is definitions.passes[name] else _over(pass_, [store.image(n).image for n in pass_.images])
        for name, pass_ in remaining.passes.items()
    }
    return Definitions(passes, shared)


def _over(pass_: NamedPass, images: Sequence[PushbroomImage]) -> NamedPass:
    """A pass with the nodes that its images need."""
    if isinstance(pass_.prior, PolynomialPrior):
        return pass_
    edges = spans(images) - pass_.nodes.epoch
    nodes = pass_.nodes.over(float(edges[:, 0].min()), float(edges[:, 1].max()))
    return pass_ if np.array_equal(nodes.times, pass_.nodes.times) else replace(pass_, nodes=nodes)


def _joined_by(store: KnowsImages, pass_: NamedPass, joining: Sequence[PushbroomImage], by_look: bool) -> NamedPass:
    """A pass with more images: mounted as their nominal attitudes say, its nodes continued over their lines. `by_look`:
    where they have no time in common, lines that look in the same direction are of one camera.
    """
    where = f"pass {pass_.name!r}"
    members = [store.image(name).image for name in pass_.images]
    edges = spans(members)
    for image in joining:
        start, stop = seconds(image)
        gaps = np.maximum(edges[:, 0] - stop, start - edges[:, 1])
        near = sorted(np.argsort(gaps, kind="stable")[:_NEIGHBOURS].tolist())
        nearest = members[int(np.argmin(gaps))]
        one_camera = by_look and pass_.axes is None and _turned(nearest, image) < _SAME_WAY
        matrices = mountings([members[k] for k in near] + [image], where, one_camera)
        turn = np.eye(3) if matrices is None else matrices[-1]
        turn = turn if pass_.axes is None else turn @ pass_.axes[near[0]]
        axes = None if pass_.axes is None and np.abs(turn - np.eye(3)).max() < _UNTURNED else turn[None]
        pass_ = pass_.with_images(NamedPass(pass_.name, (image.name,), pass_.nodes, pass_.prior, axes))
        members, edges = [*members, image], np.vstack([edges, [start, stop]])
    first, last = pass_.nodes.coverage
    start, stop = float(edges[:, 0].min()) - pass_.nodes.epoch, float(edges[:, 1].max()) - pass_.nodes.epoch
    if first <= start and stop <= last:
        return pass_
    if isinstance(pass_.prior, PolynomialPrior):
        return replace(pass_, whole=False)  # one cubic polynomial, which holds before and after them
    nodes = pass_.nodes.over(min(first, start), max(last, stop))
    return pass_ if np.array_equal(nodes.times, pass_.nodes.times) else replace(pass_, nodes=nodes)


def _turned(first_image: PushbroomImage, second_image: PushbroomImage) -> float:
    """Rad by which the nominal attitudes of two images differ where they come nearest in time."""
    (first, last), (start, stop) = seconds(first_image), seconds(second_image)
    times = np.clip(0.5 * (max(first, start) + min(last, stop)), [first, start], [last, stop])
    images = enumerate((first_image, second_image))
    poses = [image.trajectory.pose(times[k : k + 1] - image.trajectory.epoch) for k, image in images]
    return float(np.linalg.norm(rotation.logarithm(poses[1].matrix @ poses[0].matrix.mT)[0]))


def turned_bundles(store: StateStore, before: Definitions, after: Definitions) -> list[Members]:
    """Bundles whose points depend on other orientation images than before: those at former ends of a pass."""
    ends = set[Unknown]()
    for name, pass_ in before.passes.items():
        now = after.passes.get(name)
        if now is None or now.nodes is pass_.nodes:
            continue
        was, nodes_now = pass_unknowns(pass_), set(pass_unknowns(now))
        nodes = was[: len(pass_.nodes)]
        ends |= {node for node in nodes if node not in nodes_now}
        if pass_.nodes.times[0] != now.nodes.times[0]:
            ends.add(next(node for node in nodes if node in nodes_now))
        if pass_.nodes.times[-1] != now.nodes.times[-1]:
            ends.add(next(node for node in reversed(nodes) if node in nodes_now))
    return [members for members in store.members() if not ends.isdisjoint(members)] if ends else []


def unknowns_of(definitions: Definitions) -> Members:
    """All unknowns of passes, and those that images share."""
    nodes = (unknown for pass_ in definitions.passes.values() for unknown in pass_unknowns(pass_))
    return (*nodes, *(Unknown("shared", name) for name in definitions.shared))


def prior_rows(definitions: Definitions) -> list[PriorRows]:
    """Priors of the orientation images and the trends of passes."""
    rows = list[PriorRows]()
    for pass_ in definitions.passes.values():
        names = pass_unknowns(pass_)
        for unknowns, blocks, _ in pass_.prior.factors(pass_.nodes):
            rows.append(PriorRows(tuple(names[k] for k in unknowns), blocks))
    return rows


def expected(
    rows: Iterable[PriorRows], new: ByUnknown, values: ByUnknown
) -> dict[Unknown, Array]:
    """Values (d,) of new unknowns of passes, m and rad, predicted by rows and present values; `new` are their units."""
    rows = [row for row in rows if not set(new).isdisjoint(row.unknowns)]
    if not any(unknown in values for row in rows for unknown in row.unknowns):
        return {unknown: np.zeros(unit.size) for unknown, unit in new.items()}
    first, size = dict[Unknown, int](), 0
    for unknown, unit in new.items():
        first[unknown], size = size, size + unit.size
    height = sum(row.whitened[0].shape[0] for row in rows)
    design, right, at = np.zeros((height, size)), np.zeros(height), 0
    for row in rows:
        inside = slice(at, at + row.whitened[0].shape[0])
        for unknown, block in zip(row.unknowns, row.whitened, strict=True):
            if unknown in new:
                design[inside, first[unknown] : first[unknown] + block.shape[1]] = block * new[unknown]
            else:
                right[inside] -= block @ values[unknown]
        at = inside.stop
    estimate = np.linalg.lstsq(design, right, rcond=None)[0]
    return {unknown: estimate[k : k + new[unknown].size] * new[unknown] for unknown, k in first.items()}
