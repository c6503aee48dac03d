"""What a plan is to improve: points, and the ground under images; their sigmas in m, eastward, northward and upward."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mgsgraph.adjustment.graph.forms import IN_PROCESS
from mgsgraph.adjustment.incremental.state import ground_motion
from mgsgraph.errors import InputError
from mgsgraph.files.tie_points import PointKind
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.records import Array
from mgsgraph.network import PointClass
from mgsgraph.network.corrections import designs
from mgsgraph.network.parts import KnownImage
from mgsgraph.planning.state import CurrentState, NetworkState
from mgsgraph.planning.update import Update
from mgsgraph.record import Record

Criterion = Literal["mean", "worst"]
WORDS = ("ties", "all")
"""Targets that are no names."""


@dataclass(frozen=True, slots=True, eq=False)
class Targets(Record):
    """Points and images whose sigmas count."""

    points: tuple[str, ...]
    """Names of points."""
    images: tuple[str, ...]
    """Names of images: what counts is the place of the ground under the image's middle line, on the ellipsoid."""
    wanted: tuple[str, ...]
    """Targets as they were requested."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all targets, points first."""
        return (*self.points, *self.images)

    def __len__(self) -> int:
        return len(self.points) + len(self.images)

    @property
    def words(self) -> str:
        """The targets in words."""
        named = {"ties": "tie points", "all": "points"}
        if len(self.wanted) == 1 and self.wanted[0] in named:
            return f"{len(self)} {named[self.wanted[0]]}"
        return ", ".join(self.wanted)


@dataclass(frozen=True, slots=True)
class Sigmas:
    """Sigmas of the targets in one figure each: their mean, or those of the worst one, in m."""

    total: float
    """Root of the trace of the covariance."""
    east: float
    """Sigma eastward."""
    north: float
    """Sigma northward."""
    up: float
    """Sigma upward."""
    worst: str
    """The target whose total is largest."""


def targets_of(state: NetworkState, wanted: Sequence[str]) -> Targets:
    """Targets by name.

    Parameters
    ----------
    wanted : sequence of str
        "ties", "all" (points), or names of points and images; each once.

    Raises
    ------
    InputError
        For a name that is neither, and for one that has no sigma: a fixed point, a held image.
    """
    network = state.network
    ids = network.points.ids
    moving = network.points.kinds != PointKind.FIXED
    wanted = tuple(dict.fromkeys(wanted))
    if wanted in (("ties",), ("all",)):
        mine = moving & (network.points.classes == PointClass.TIE) if wanted == ("ties",) else moving
        if not np.any(mine):
            raise InputError("target", f"no {'tie ' if wanted == ('ties',) else ''}point that moves", "another target")
        return Targets(tuple(ids[i] for i in np.flatnonzero(mine).tolist()), (), wanted)
    place, images = {name: i for i, name in enumerate(ids)}, {image.name: j for j, image in enumerate(network.images)}
    for name in wanted:
        if name in WORDS:
            raise InputError("target", f"{name!r} beside names", "either 'ties' or 'all', or names")
        if name not in place and name not in images:
            known = ", ".join([*ids[:2], *list(images)[:2]])
            found = f"{name!r}, which is no determined point and no image of the network"
            raise InputError("target", found, f"'ties', 'all', or names ({known}, ...)")
        if (name in place and not moving[place[name]]) or (name in images and network.held[images[name]]):
            raise InputError("target", f"{name!r}, which is held and has no sigma", "an adjusted one")
    if not wanted:
        raise InputError("target", "none", "'ties', 'all', or names of points and images")
    return Targets(tuple(n for n in wanted if n in place), tuple(n for n in wanted if n not in place), wanted)


class TargetSigmas:
    """Sigmas of targets in the present network, and after an update."""

    def __init__(self, present: CurrentState, targets: Targets) -> None:
        self.present, self.targets = present, targets
        network, layout = present.state.network, present.layout
        self._index = np.array([present.index_of[name] for name in targets.points], dtype=np.int64)
        out = np.ones(len(network.points), dtype=bool)
        out[self._index] = False
        every = np.ones(network.rays.point.size, dtype=bool), np.ones(network.ranges.point.size, dtype=bool)
        self._rows = layout.active(*every, out | ~present.determined)
        number = {image.name: j for j, image in enumerate(network.images)}
        chosen = [number[name] for name in targets.images]
        known = [KnownImage(network.images[j], network.priors[j]) for j in chosen]
        self._ground = [self._motion(one, j) for one, j in zip(known, chosen, strict=True)]
        under = np.array([_under(one) for one in known]).reshape(-1, 3)
        self._axes = east_north_up(np.concatenate([present.state.places[self._index], under]))

    def before(self) -> Array:
        """(t, 4) m: total, east, north, up of every target in the present network."""
        flat = self.present.layout.blocks.filled(self.present.joint)
        joint = self.present.joint
        return self._sigmas(self._of_points(flat), [joint.of(list(one)) for one, _ in self._ground])

    def after(self, update: Update) -> Array:
        """(t, 4) m: total, east, north, up of every target after planned measures."""
        points = self._of_points(update.pairs()) if self._index.size else np.zeros((0, 3, 3))
        place = {name: k for k, name in enumerate(self.targets.points)}
        ids = update.added.after.network.points.ids
        again = np.array([i for i, name in enumerate(ids) if name in place], dtype=np.int64)
        if again.size:
            found, _ = update.point_covariances()
            points[[place[ids[i]] for i in again.tolist()]] = found[again]
        names = self.present.names
        return self._sigmas(points, [update.joint_of([names[v] for v in one]) for one, _ in self._ground])

    def _motion(self, known: KnownImage, image: int) -> tuple[tuple[int, ...], Array]:
        """Variables that the orientation of an image's middle line depends on, and by how much the ground under it
        moves with them (3, d), m per m and per rad.
        """
        angles, network = self.present.state.settings.angles, self.present.network
        (parts,) = designs(network, image, angles, np.array([0.5 * known.image.lines]))
        return tuple(parts), ground_motion(known, angles)[:, :6] @ np.hstack(list(parts.values()))

    def _of_points(self, flat: Array) -> Array:
        """(p, 3, 3) m^2 with the joint covariance in blocks."""
        present, layout = self.present, self.present.layout
        points = present.reduction.points
        found = IN_PROCESS.covariances(layout, self._rows, present.values, flat, points)
        return np.asarray(layout.network_order(found)[self._index])

    def _sigmas(self, points: Array, images: Sequence[Array]) -> Array:
        ground = [motion @ spread @ motion.T for (_, motion), spread in zip(self._ground, images, strict=True)]
        every = np.concatenate([points, np.array(ground).reshape(-1, 3, 3)])
        local = np.einsum("tij,tjk,tik->ti", self._axes, every, self._axes)
        return np.asarray(np.sqrt(np.maximum(np.column_stack([local.sum(axis=1), local]), 0.0)))


def _under(known: KnownImage) -> Array:
    """(3,) m, the ground under an image's middle; where it looks past the body, the camera."""
    image = known.image
    line, sample = np.array([0.5 * image.lines]), np.array([0.5 * image.samples])
    ground, _ = image.image_to_ground(line, sample)
    return np.asarray(ground[0] if np.all(np.isfinite(ground)) else image.pose(line).position[0])


def summarised(sigmas: Array, targets: Targets, criterion: Criterion) -> Sigmas:
    """Sigmas (t, 4) of all targets in one figure each."""
    worst = int(np.argmax(sigmas[:, 0]))
    total, east, north, up = (sigmas[worst] if criterion == "worst" else sigmas.mean(axis=0)).tolist()
    return Sigmas(total, east, north, up, targets.names[worst])
