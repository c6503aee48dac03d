"""One adjustment over a cluster: its points lie in partitions on the workers, which do every sweep.

Per iteration the orientation goes out, and costs, reduced blocks and gradients come back; places, covariances and
residuals come when they are asked for. Rays are laid out about other lines where they are, and here: the source of each
partition stays here, so that a worker that has gone loses nothing. Sums are made in the order of the partitions,
whoever did them, so that a cost is repeatable.
"""

import itertools
import math
import uuid
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from types import TracebackType
from typing import Any
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.cluster.connection import LEAST_MEMORY, Connection, Lost
from mgsgraph.adjustment.cluster.worker_sweeps import (
    CHANGING,
    FOLLOW,
    HOLD,
    PLACES,
    Answer,
    Order,
    Source,
    carry_out,
    forget,
    size_of,
)
from mgsgraph.adjustment.cluster.workers import GIGA
from mgsgraph.adjustment.graph.bundle import IN_PROCESS, sparse_factor
from mgsgraph.adjustment.graph.layout import Layout
from mgsgraph.adjustment.graph.sampled_rays import SampledRays
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.sparse_cholesky import Factor
from mgsgraph.errors import InputError, SolverError
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.reduction import Reduction
from mgsgraph.kernel.rows import Groups, Model, NormalBlocks, Rows, partition
from mgsgraph.kernel.sweep import COSTS, COVARIANCES, RELIABILITY, RESIDUALS, even_parts

_COPIES = 2.0
"""Memory for a partition over its own size: what it is unpacked from, or scratch and results."""
_LARGEST = 0.5 * GIGA
"""bytes of a partition; a worker with more to hold gets several, since dask's messages end at 2 GB."""
_MOST_DEATHS = 4
"""Workers that one sweep over a partition may bring down; dask gives up a task as late."""
_REMEDY = "take more workers on more machines, or give them more memory (--memory-limit)"


def require_bundles(settings: SolverSettings, where: str) -> None:
    """Raise InputError for a way to solve that needs all points in one process."""
    for name, expected in (("form", "bundle"), ("method", "levenberg-marquardt")):
        found = getattr(settings, name)
        if found != expected:
            found, remedy = f"solver, {name} {found!r}", "take that, or leave the cluster out"
            raise InputError(where, found, f"{expected!r} on a cluster", remedy)
    if settings.device == "cuda":
        raise InputError(where, "solver, device 'cuda'", "'cpu' on a cluster", "take one of both")


@dataclass(slots=True, eq=False)
class _Part:
    """Some neighbouring pieces of a layout's points, and the worker that holds them."""

    token: str
    pieces: slice
    points: slice
    observations: slice
    rays: SampledRays | None
    """What lays its rays out anew; None where that takes more than trajectories."""
    ray: Index
    """(k,) network ray of each of them."""
    blocks: Index
    """Where its blocks are among the whole's."""
    target: NormalBlocks
    """Its blocks by themselves."""
    size: int
    """bytes of its source."""
    owner: str = ""
    """Address of the worker that has it, or is to have it."""
    sent: tuple[NDArray[Any], ...] | None = None
    """The whole's CHANGING as its owner knows them; None while it doesn't hold the partition."""
    model: Model | None = None
    """The measurement model as its owner knows it."""
    lines: Array | None = None
    """The whole's lines about which its owner has laid its rays out."""
    deaths: int = 0
    """Workers that have gone since its last answer."""

    @property
    def count(self) -> int:
        """Number of its points."""
        return int(self.points.stop - self.points.start)

    @property
    def need(self) -> float:
        """Bytes of memory that it takes."""
        return _COPIES * self.size


class PartedReduction(Reduction):
    """A reduction whose points stay with the workers until they are asked for."""

    def __init__(
        self, sweep: "Partitions", rows: Rows, number: int, orientation: Array, task: int, parts: list[Answer]
    ) -> None:
        costs = joined(parts, 0)
        whole = {"task": task, "orientation": orientation.copy(), "cost": float(costs.sum()), "piece_cost": costs}
        blocks, gradient = (None, np.empty(0)) if task == COSTS else sweep.summed(parts)
        own = {"rows": rows, "number": number, "_sweep": sweep, "_ends": None}
        for name, value in (whole | {"blocks": blocks, "gradient": gradient} | own).items():
            object.__setattr__(self, name, value)  # frozen, like its parent

    rows: Rows
    number: int
    _sweep: "Partitions"
    _ends: tuple[Array, NDArray[np.int8]] | None

    @property
    def points(self) -> Array:
        """(n, 3) m, solved places in the layout's order."""
        return self._fetched()[0]

    @property
    def states(self) -> NDArray[np.int8]:
        """(n,) rows.GOOD, BEHIND or WEAK."""
        return self._fetched()[1]

    def _fetched(self) -> tuple[Array, NDArray[np.int8]]:
        if self._ends is None:
            object.__setattr__(self, "_ends", self._sweep.places(self))
        assert self._ends is not None
        return self._ends


class Partitions:
    """Sweeps by the workers of a cluster (a `graph.bundle.Sweeper`); a context that lets the points go at its end.

    Parameters
    ----------
    cluster : Connection
    layout : Layout
        What is adjusted; rows that are swept later are its own but for `held.CHANGING`.

    Raises
    ------
    InputError
        A partition that needs more memory than a worker has.
    """

    def __init__(self, cluster: Connection, layout: Layout) -> None:
        self._cluster = cluster
        self._numbers, self._living = itertools.count(), WeakSet[PartedReduction]()
        self._divide(layout)

    def _divide(self, layout: Layout) -> None:
        """Make partitions of a layout's points."""
        cluster, self._layout = self._cluster, layout
        rows, workers = layout.rows, cluster.workers
        common = size_of(rows) - sum(size_of((values,)) for values in (rows.kind, rows.start, rows.data, rows.weight))
        each = max(1, math.ceil((size_of(rows) - common) / (_LARGEST * max(len(workers), 1))))
        edges = even_parts(rows, each * max(len(workers), 1)).tolist()
        self._parts = [_part(layout, first, last, common) for first, last in pairwise(edges) if last > first]
        largest = max(self._parts, key=lambda part: part.size)
        what = f"{_words(largest)} times {each}" if each > 1 else _words(largest)
        cluster.require_memory(LEAST_MEMORY + each * largest.need, what, _REMEDY)

    def _take(self, layout: Layout) -> None:
        """Go on with a layout made of the same network. One with other patterns or stereo rows has partitions of its
        own, and so has one with other lines where workers can't lay rays out.
        """
        now = self._layout
        same = layout.patterns is now.patterns and layout.stereo is now.stereo
        if same and (layout.lines is now.lines or layout.rays.all_sampled):
            self._layout = layout
            return
        self._cluster.call_all(forget, [part.token for part in self._parts])
        self._divide(layout)

    def __enter__(self) -> "Partitions":
        self._sweep(self._layout.rows, lambda part: Order(part.token, HOLD, np.empty(0)))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._cluster.call_all(forget, [part.token for part in self._parts])

    # --- what a Sweeper does

    def reduction(
        self, layout: Layout, rows: Rows, orientation: Array, task: int, points: Array | Reduction | None
    ) -> Reduction:
        """All points solved (and eliminated)."""
        self._take(layout)
        number, kept = next(self._numbers), frozenset(one.number for one in self._living)
        after = points.number if isinstance(points, PartedReduction) else None
        given = points if isinstance(points, np.ndarray) else None

        def order(part: _Part) -> Order:
            begin = None if given is None else given[part.points]
            return Order(part.token, task, orientation, number=number, after=after, kept=kept, points=begin)

        made = PartedReduction(self, rows, number, orientation, task, self._sweep(rows, order))
        self._living.add(made)
        return made

    def covariances(self, layout: Layout, rows: Rows, orientation: Array, joint: Array, points: Array) -> Array:
        """Covariances (n, 3, 3) of the points in m^2, zero for known ones."""
        return self._with_covariance(COVARIANCES, layout, rows, orientation, joint, points)

    def residuals(self, layout: Layout, rows: Rows, orientation: Array, points: Array) -> Array:
        """Residuals (t, 2) of all observations: image rays in pixels, ranges and heights in m."""
        self._take(layout)

        def order(part: _Part) -> Order:
            return Order(part.token, RESIDUALS, orientation, points=points[part.points])

        return joined(self._sweep(rows, order), 0)

    def leverage(self, layout: Layout, rows: Rows, orientation: Array, joint: Array, points: Array) -> Array:
        """Residuals (t, 8) of all observations beside their leverage."""
        return self._with_covariance(RELIABILITY, layout, rows, orientation, joint, points)

    def factor(self, layout: Layout, reduction: Reduction, damping: float) -> Factor:
        """Factor of the full linear system at a reduction: this process's task."""
        return sparse_factor(layout, reduction, damping)

    def _with_covariance(
        self, task: int, layout: Layout, rows: Rows, orientation: Array, joint: Array, points: Array
    ) -> Array:
        self._take(layout)

        def order(part: _Part) -> Order:
            mine, places = joint[part.blocks], points[part.points]
            return Order(part.token, task, orientation, joint=mine, points=places)

        return joined(self._sweep(rows, order), 0)

    def about_lines(self, layout: Layout, orientation: Array, points: Array, near: float, own: bool) -> Layout:
        """Rays about the lines predicted for points (n, 3): found, and laid out, where the points are."""
        self._take(layout)
        if not layout.rays.all_sampled:
            return IN_PROCESS.about_lines(layout, orientation, points, near, own)

        def order(part: _Part) -> Order:
            return Order(part.token, FOLLOW, orientation, points=points[part.points], near=near)

        answers = self._sweep(layout.rows, order)
        if not any(int(turns) for _, turns in answers if turns is not None):
            return layout
        lines = layout.lines.copy()
        for part, (mine, _) in zip(self._parts, answers, strict=True):
            lines[part.ray] = mine
        self._layout = layout.about(lines, orientation, own)
        for part in self._parts:
            part.lines = lines
        return self._layout

    # --- what a PartedReduction asks for

    def places(self, reduction: PartedReduction) -> tuple[Array, NDArray[np.int8]]:
        """Places (n, 3) in m and states (n,) at which a reduction ended; made again where a worker has gone since."""
        kept = frozenset(one.number for one in self._living)

        def order(part: _Part) -> Order:
            return Order(part.token, PLACES, reduction.orientation, number=reduction.number, kept=kept)

        ends = self._sweep(reduction.rows, order)
        return joined(ends, 0), joined(ends, 1)

    def summed(self, parts: list[Answer]) -> tuple[Array | None, Array]:
        """Blocks of the whole, where the parts have theirs, and its gradient."""
        target = self._layout.blocks.target
        blocks, gradient = None, np.zeros(target.columns)
        for part, (_, some, slope) in zip(self._parts, parts, strict=True):
            assert slope is not None
            gradient += slope
            if some is not None:
                blocks = np.zeros(target.size) if blocks is None else blocks
                blocks[part.blocks] += some
        return blocks, gradient

    # --- who does it

    def _sweep(self, rows: Rows, order: Callable[[_Part], Order]) -> list[Answer]:
        """Answers of all partitions, in their order."""
        now = tuple(getattr(rows, name) for name in CHANGING)
        answers: dict[int, Answer] = {}
        while len(answers) < len(self._parts):
            self._settle()
            due = {k: part for k, part in enumerate(self._parts) if k not in answers}
            orders = {k: (part.owner, self._complete(order(part), part, rows, now)) for k, part in due.items()}
            for k, answer in self._cluster.at_workers(carry_out, orders):
                part = due[k]
                part.deaths = part.deaths + 1 if answer is None else 0
                self._require_sense(part, answer)
                part.sent = now if answer else None
                part.model, part.lines = self._layout.model, self._layout.lines
                if answer and not isinstance(answer, Lost):
                    answers[k] = answer
        return [answers[k] for k in range(len(self._parts))]

    def _complete(self, order: Order, part: _Part, rows: Rows, now: tuple[NDArray[Any], ...]) -> Order:
        """An order with what the owner lacks."""
        groups, model, lines = self._layout.groups, self._layout.model, self._layout.lines
        if part.sent is None:
            mine = partition(rows._replace(data=self._layout.rows.data), part.pieces.start, part.pieces.stop)
            return replace(order, source=Source(mine, groups, part.target, model, part.rays, lines[part.ray]))
        news = zip(CHANGING, now, part.sent, strict=True)
        own: dict[str, Any] = {"kind": part.points, "weight": (slice(None), part.observations)}
        return replace(
            order,
            changes={name: new[own[name]] for name, new, old in news if new is not old},
            model=None if model == part.model else model,
            lines=None if lines is part.lines else lines[part.ray],
        )

    def _require_sense(self, part: _Part, answer: Answer | Lost | None) -> None:
        """Raise SolverError where there is no sense in asking again."""
        if isinstance(answer, Lost):
            raise SolverError(f"{self._cluster.where}: {_words(part)} failed on {part.owner}: {answer.message}")
        if part.deaths >= _MOST_DEATHS:
            limits = [worker.memory_limit for worker in self._cluster.workers if worker.memory_limit]
            limit = f" (memory limit {min(limits) / GIGA:.2f} GB)" if limits else ""
            raise SolverError(
                f"{self._cluster.where}: each of the {_MOST_DEATHS} workers that tried {_words(part)} died{limit}; "
                f"{_REMEDY}"
            )

    def _settle(self) -> None:
        """See that every partition has a worker that is there and has memory for it, the load spread evenly."""
        for present in self._cluster.until_workers_return():
            load = Counter[str]()
            most = math.ceil(len(self._parts) / len(present))
            for part in self._parts:
                if part.owner not in present or load[part.owner] == most:
                    part.owner, part.sent = "", None
                load[part.owner] += 1
            homeless = [part for part in self._parts if not part.owner]
            if not homeless or self._place(homeless, load):
                return

    def _place(self, homeless: list[_Part], load: Counter[str]) -> bool:
        """Give partitions to the workers with the least load; whether there is memory for all of them."""
        left = {worker.address: worker.memory_limit or math.inf for worker in self._cluster.workers}
        for part in self._parts:
            left[part.owner] = left.get(part.owner, 0.0) - part.need
        for part in homeless:
            fit = [address for address in sorted(left) if address and left[address] >= LEAST_MEMORY + part.need]
            if not fit:
                return False
            part.owner = min(fit, key=lambda address: load[address])
            load[part.owner] += 1
            left[part.owner] -= part.need
        return True


def _part(layout: Layout, first: int, last: int, common: int) -> _Part:
    """The partition of pieces first .. last - 1; `common` bytes are the whole's tables."""
    rows = layout.rows
    mine = partition(rows, first, last)
    point = int(rows.piece[first, 1])
    observation = int(rows.piece[first, 4])
    own = (mine.kind, mine.start, mine.data, mine.weight)
    used = np.unique(rows.pattern_group[mine.piece[:, 0]])
    sampled = layout.rays.sampled if layout.rays.all_sampled else None
    rays, ray = (None, np.zeros(0, dtype=np.int64)) if sampled is None else sampled.of_pieces(first, last)
    blocks, target = blocks_of_partition(layout.groups, layout.blocks.target, used)
    return _Part(
        uuid.uuid4().hex,
        slice(first, last),
        slice(point, point + mine.kind.size),
        slice(observation, observation + mine.weight.shape[1]),
        rays,
        ray,
        blocks,
        target,
        size_of(own) + size_of((rays, ray)) + common,
    )


def blocks_of_partition(groups: Groups, target: NormalBlocks, used: Index) -> tuple[Index, NormalBlocks]:
    """Blocks of some groups by themselves: where they are among the whole's, and their target."""
    places, sizes = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for group in used:
        width = groups.member_width[groups.member_first[group] : groups.member_first[group + 1]]
        places.append(target.pair[groups.pair_first[group] : groups.pair_first[group + 1]])
        sizes.append(np.multiply.outer(width, width).ravel())
    table = np.concatenate(places)
    first, example = np.unique(table, return_index=True)
    size = np.concatenate(sizes)[example]
    begin = np.cumsum(size) - size
    inside = np.arange(size.sum()) - np.repeat(begin, size)
    pair = np.zeros_like(target.pair)
    for group, found in zip(used, places[1:], strict=True):
        pair[groups.pair_first[group] : groups.pair_first[group + 1]] = begin[np.searchsorted(first, found)]
    return np.repeat(first, size) + inside, target._replace(pair=pair, size=int(size.sum()))


def joined(answers: list[Answer], place: int) -> NDArray[Any]:
    """One of the arrays of all partitions, one after the other."""
    return np.concatenate([values for answer in answers if (values := answer[place]) is not None])


def _words(part: _Part) -> str:
    """A partition as errors name it."""
    return f"a partition of {part.count} points ({part.size / GIGA:.2f} GB)"
