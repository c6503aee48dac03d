"""Where the image rays of a layout are, and rays whose nominal poses follow from sampled trajectories alone.

The latter need no network to be laid out about other lines: a partition of them does it where its points are, in this
process or on a worker of a cluster, and follows its points to the lines in which they are seen.
"""

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.graph.poses import PoseTables
from mgsgraph.adjustment.graph.ray_constants import put_sampled, rays_inside
from mgsgraph.adjustment.graph.sorting import followed
from mgsgraph.compiled import in_threads
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.kernel.reduction import all_residuals
from mgsgraph.kernel.rows import OUT, Groups, Model, NormalBlocks, Rows

_Kind = TypeVar("_Kind", bound=np.generic)
MOST_TURNS = 20
"""Times that rays are laid out anew: two or three do it, more where a predicted line lies beside a sample at which the
rates jump."""
BEYOND = 0.5
"""Share of an image's lines by which a predicted line may lie before it or after it."""
_SHARE = 1 << 16
"""Observations that a thread takes at a time."""
NO_UNITS = np.empty((0, 3))
"""No room for directions: they are not asked for."""


class Share(NamedTuple):
    """The r rays of some neighbouring pieces, in the order of their observations."""

    first: int
    """Piece."""
    last: int
    """Piece after the last one."""
    ray: NDArray[np.int32]
    """(r,) ray."""
    at: Index
    """(r,) where its constants begin in the data."""
    stride: Index
    """(r,) step to the next one."""
    place: Index
    """(r,) among all observations."""
    image: Index
    """(r,) whose it is."""

    def by(self, number: Index, among: Mask | None = None) -> Iterator[tuple[int, Index]]:
        """Which rays, of some of them (r,), have the same `number` (r,)."""
        mine = np.arange(self.ray.size) if among is None else np.flatnonzero(among)
        order = mine[np.argsort(number[mine], kind="stable")]
        edges = np.flatnonzero(np.diff(number[order], prepend=-1, append=-1)).tolist()
        for a, b in pairwise(edges):
            yield int(number[order[a]]), order[a:b]


class RayPlaces(NamedTuple):
    """Where k image rays are among all t observations of m pieces; q patterns, s observations of patterns."""

    piece: Index
    """(m, 5) as in Rows."""
    begins: Index
    """(m + 1,) first observation of each piece, and the number of all."""
    observation: Index
    """(q + 1,) first observation of each pattern."""
    before: Index
    """(q, j) numbers per point that a pattern's observations before the j-th store."""
    rays: Index
    """(q,) how many of a pattern's observations, the first ones, are image rays."""
    image: Index
    """(s,) whose they are."""
    ray: NDArray[np.int32]
    """(t,) ray of each observation, -1 for other ones; a small number, for there are many."""

    def each(self, work: Callable[[Share], None]) -> None:
        """Do some work on all rays, shared by threads."""
        total = int(self.begins[-1])
        edges = np.unique(np.searchsorted(self.begins, [*range(0, total, _SHARE), total])).tolist()
        in_threads(lambda ends: work(self._share(*ends)), list(pairwise(edges)))

    def _share(self, first: int, last: int) -> Share:
        most = int(self.begins[last] - self.begins[first])
        ray = np.empty(most, dtype=np.int32)
        at, stride, place, image = (np.empty(most, dtype=np.int64) for _ in range(4))
        count = rays_inside(
            first, last, self.piece, self.before, self.observation, self.rays, self.image, self.ray, ray, at, stride,
            place, image,
        )  # fmt: skip
        return Share(first, last, ray[:count], at[:count], stride[:count], place[:count], image[:count])

    def of_pieces(self, first: int, last: int) -> tuple["RayPlaces", Index]:
        """Those of the pieces first .. last - 1 by themselves, numbered in the order of their observations; and which
        they are here.
        """
        begin, end = int(self.begins[first]), int(self.begins[last])
        there = self.ray[begin:end] >= 0
        number = np.where(there, np.cumsum(there) - 1, -1).astype(np.int32)
        ends = np.array([0, self.piece[first, 1], 0, self.piece[first, 3], begin])
        begins = self.begins[first : last + 1] - begin
        own = self._replace(piece=self.piece[first:last] - ends, begins=begins, ray=number)
        return own, self.ray[begin:end][there].astype(np.int64)


class SampledRays(NamedTuple):
    """Image rays of the strict form whose nominal poses follow from sampled trajectories alone; m images."""

    places: RayPlaces
    """Where they are."""
    tables: PoseTables
    """Trajectories; rays of images that have none are passed over."""
    focal: Array
    """(m,) m, focal length."""
    size: Array
    """(m,) lines."""
    polynomial: Mask
    """(m,) whether the basis is a polynomial, of which u is stored."""
    measured: Array
    """(k, 2) measured line and sample of each ray."""

    def put(self, share: Share, data: Array, lines: Array, units: Array) -> None:
        """Poses of a share's rays about lines (k,); `units` (r, 3), where there is room, are filled with directions."""
        put_sampled(
            share.ray, share.at, share.stride, share.image, self.tables, self.focal, self.size, self.polynomial,
            _read_only(self.measured), lines, data, units,
        )  # fmt: skip

    def renew(self, data: Array, lines: Array) -> None:
        """Poses of all these rays about other lines (k,), in place."""
        self.places.each(lambda share: self.put(share, data, lines, NO_UNITS))

    def of_pieces(self, first: int, last: int) -> tuple["SampledRays", Index]:
        """Those of the pieces first .. last - 1, with the images that they have alone; and which they are here."""
        places, mine = self.places.of_pieces(first, last)
        patterns = np.unique(places.piece[:, 0])
        used = np.concatenate([
            places.image[begin : begin + count]
            for begin, count in zip(places.observation[patterns].tolist(), places.rays[patterns].tolist(), strict=True)
        ])  # fmt: skip
        images = np.unique(used)
        number = np.zeros(self.size.size + 1, dtype=np.int64)
        number[images] = np.arange(images.size)
        own = SampledRays(
            places._replace(image=number[places.image]), self.tables.chosen(images), self.focal[images],
            self.size[images], self.polynomial[images], self.measured[mine],
        )  # fmt: skip
        return own, mine


def _read_only(values: NDArray[_Kind]) -> NDArray[_Kind]:
    """As a network has its arrays: of another type to compiled code, which need not be compiled anew."""
    found = values.view()
    found.flags.writeable = False
    return found


class Followed(NamedTuple):
    """Rays that follow their points."""

    lines: Array
    """(k,) about which they are laid out."""
    turns: int
    """How many times they were laid out anew."""


def follow(
    rows: Rows, groups: Groups, target: NormalBlocks, model: Model, rays: SampledRays, lines: Array, x: Array,
    points: Array, near: float,
) -> Followed:  # fmt: skip
    """Lay rays out, in place, about the lines in which points (n, 3) are seen, to `near` lines, with shared unknowns x.

    All rays are those of sampled trajectories, numbered in the order of their observations; `lines` (k,) are those
    about which they are laid out now.
    """
    places = rays.places
    among = np.flatnonzero(places.ray >= 0)
    of_piece = np.searchsorted(places.begins, among, side="right") - 1
    pattern, first, size, _, begin = places.piece[of_piece].T
    point = first + (among - begin) % size
    image = places.image[places.observation[pattern] + (among - begin) // size]
    of_point, every, of_image = _read_only(point), np.arange(rows.kind.size), _read_only(image)
    ways, known = (among.astype(np.int32), rows.kind, of_point, every, of_image), lines
    for turn in range(MOST_TURNS):
        found = np.empty(known.size)
        values = all_residuals(rows, groups, target, model, x, points)
        if followed(known, _read_only(rays.measured), values, *ways, rays.size, BEYOND, OUT, found) <= near:
            return Followed(known, turn)
        rays.renew(rows.data, found)
        known = found
    return Followed(known, MOST_TURNS)
