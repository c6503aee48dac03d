"""One adjustment over a cluster: its points lie in partitions on the workers, which do every sweep.

A partition goes to its worker once; after that only changes: the rows that take part, and the constants of rows that
are rebuilt. For each sweep the worker receives the orientation and the start positions of inner solves, and returns the
kernel's results. A lost worker ends the adjustment, which takes minutes: start it again. Sums are made in the order of
the partitions, so that a cost is repeatable.
"""

import math
import time
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import cycle, pairwise
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.cluster.connection import LEAST_MEMORY, Connection, Lost
from mgsgraph.adjustment.cluster.workers import GIGA
from mgsgraph.adjustment.graph.forms import Sweeper, numbers
from mgsgraph.adjustment.graph.layout import Layout
from mgsgraph.errors import SolverError
from mgsgraph.geometry.records import Array, Index, no_rows
from mgsgraph.kernel.rows import Groups, Model, NormalBlocks, Rows, partition
from mgsgraph.kernel.sweep import Reduction, all_residuals, even_parts, point_covariances, reduce, writable
from mgsgraph.text import many

_COPIES = 2.0
"""Memory for a partition over its own size: its packed form, or scratch and results."""
_LARGEST = 0.5 * GIGA
"""bytes of a partition; a worker with more to hold gets several, since dask's messages end at 2 GB."""
_REMEDY = "take more workers on more machines, or give them more memory (--memory-limit)"


# --- on a worker


class Source(NamedTuple):
    """All data of a partition that a worker needs, except the measurement model."""

    rows: Rows
    """Its rows."""
    groups: Groups
    """The whole's groups."""
    target: NormalBlocks
    """Blocks of the pairs of variables that its points depend on."""


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """One sweep over one partition."""

    token: str
    """Of the partition, unlike any other."""
    function: Callable[..., Any] | None
    """Function of rows, groups, blocks and model; None: store the partition."""
    arguments: tuple[Any, ...]
    """Further arguments of the function."""
    model: Model
    """The measurement model."""
    source: Source | None = None
    """The partition, where the worker may not hold it."""
    changes: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """Fields of its rows that are new since the last order."""


Answer = tuple[Any, ...]
"""Result of the function, in a tuple; empty where the worker doesn't hold the partition."""
_held: dict[str, tuple[float, Source]] = {}
"""Partitions that this process holds by their tokens, and when the last order came, s."""
_KEPT = 600.0
"""s without an order after which a partition may be dropped for new ones: its sender has gone, or sends it again."""


def carry_out(order: Order) -> Answer:
    """Carry out an order."""
    now, source = time.monotonic(), order.source
    if source is not None:
        forget([token for token, (used, _) in _held.items() if now - used > _KEPT])
        source = _writable_record(source)
    elif order.token in _held:
        source = _held[order.token][1]
    else:
        return ()
    changes = {name: writable(values) for name, values in order.changes.items()}
    source = source._replace(rows=source.rows._replace(**changes))
    _held[order.token] = now, source
    return (order.function and order.function(*source, order.model, *order.arguments),)


def forget(tokens: list[str]) -> None:
    """Drop partitions."""
    for token in tokens:
        _held.pop(token, None)


def _writable_record(record: Any) -> Any:
    """A record with arrays of its own, and so are those in it."""
    if isinstance(record, np.ndarray):
        return writable(record)
    return type(record)(*map(_writable_record, record)) if isinstance(record, tuple) else record


# --- in this process


@dataclass(slots=True, eq=False)
class _Part:
    """Some neighbouring pieces of a layout's points, and the worker that holds them."""

    pieces: slice
    own: dict[str, Any]
    """Where its points, numbers and observations are in fields of the whole's rows."""
    blocks: Index
    """Where its blocks are among the whole's."""
    target: NormalBlocks
    """Its blocks by themselves."""
    size: int
    """bytes of its source."""
    owner: str
    """Address of the worker that holds it."""
    token: str = field(default_factory=lambda: uuid.uuid4().hex)
    sent: dict[str, list[object]] | None = None
    """`_marks` of the rows that its owner knows; None before it holds the partition."""

    @property
    def points(self) -> slice:
        """Its points."""
        return self.own["kind"]  # type: ignore[no-any-return]

    @property
    def need(self) -> float:
        """Bytes of memory that it takes."""
        return _COPIES * self.size

    def __str__(self) -> str:
        return f"a partition of {self.points.stop - self.points.start} points ({self.size / GIGA:.2f} GB)"


class Partitions(Sweeper):
    """Sweeps by the workers of a cluster; a context that lets the points go at its end.

    Parameters
    ----------
    cluster : Connection
    layout : Layout
        What is adjusted; rows that are swept later are its own but for kinds of points, weights and constants.

    Raises
    ------
    InputError
        A partition that needs more memory than a worker has.
    """

    def __init__(self, cluster: Connection, layout: Layout) -> None:
        self._cluster = cluster
        self._divide(layout)
        workers = many(len({part.owner for part in self._parts}), "worker")
        self.remark = f"Points were spread over {workers}; other numbers of workers give the same to 1e-8."

    def _divide(self, layout: Layout) -> None:
        """Make partitions of a layout's points."""
        cluster, self._layout = self._cluster, layout
        rows, owners = layout.rows, [worker.address for worker in cluster.workers] or [""]
        common = size_of(rows) - size_of((rows.kind, rows.start, rows.data, rows.weight))
        each = max(1, math.ceil((size_of(rows) - common) / (_LARGEST * len(owners))))
        edges = even_parts(rows, each * len(owners)).tolist()
        ends = [(first, last) for first, last in pairwise(edges) if last > first]
        self._parts = [_part(layout, *two, common, owner) for two, owner in zip(ends, cycle(owners), strict=False)]
        largest = max(self._parts, key=lambda part: part.size)
        what = f"{largest} times {each}" if each > 1 else str(largest)
        cluster.require_memory(LEAST_MEMORY + each * largest.need, what, _REMEDY)

    def __enter__(self) -> "Partitions":
        self._sweep(self._layout, self._layout.rows, None, lambda _: ())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._cluster.call_all(forget, [part.token for part in self._parts])

    # --- what a Sweeper does

    def reduction(
        self, layout: Layout, rows: Rows, orientation: Array, task: int, points: Array | Reduction | None,
        rough: bool = False,
    ) -> Reduction:  # fmt: skip
        """All points solved (and eliminated)."""
        begin = points.points if isinstance(points, Reduction) else points
        parts = self._sweep(
            layout, rows, reduce, lambda part: (orientation, task, None if begin is None else begin[part.points], rough)
        )
        target, costs = layout.blocks.target, np.concatenate([part.piece_cost for part in parts])
        blocks = None if parts[0].blocks is None else np.zeros(target.size)
        gradient = np.zeros(target.columns if parts[0].gradient.size else 0)
        for part, answer in zip(self._parts, parts, strict=True):
            gradient += answer.gradient
            if blocks is not None:
                blocks[part.blocks] += answer.blocks
        ends, states = (np.concatenate([getattr(part, name) for part in parts]) for name in ("points", "states"))
        return Reduction(task, orientation.copy(), float(costs.sum()), costs, blocks, gradient, ends, states)

    def covariances(self, layout: Layout, rows: Rows, orientation: Array, joint: Array, points: Array) -> Array:
        """Covariances (n, 3, 3) of the points in m^2, zero for known ones."""
        return np.concatenate(self._sweep(
            layout, rows, point_covariances, lambda part: (orientation, joint[part.blocks], points[part.points])
        ))  # fmt: skip

    def residuals(self, layout: Layout, rows: Rows, orientation: Array, points: Array) -> Array:
        """Residuals (t, 2) of all observations: image rays in pixels, ranges and heights in m."""
        return np.concatenate(
            self._sweep(layout, rows, all_residuals, lambda part: (orientation, points[part.points]))
        )

    def leverage(self, layout: Layout, rows: Rows, orientation: Array, joint: Array, points: Array) -> Array:
        """Residuals (t, 8) of all observations beside their leverage."""
        answers = self._sweep(
            layout, rows, numbers, lambda part: (orientation, joint[part.blocks], points[part.points])
        )
        return np.concatenate([values for values, _ in answers])

    # --- who does it

    def _sweep(
        self, layout: Layout, rows: Rows, function: Callable[..., Any] | None,
        arguments: Callable[[_Part], tuple[Any, ...]],
    ) -> list[Any]:  # fmt: skip
        """Results of a function of the kernel for each partition, in their order."""
        if layout.patterns is not self._layout.patterns:
            self._cluster.call_all(forget, [part.token for part in self._parts])
            self._divide(layout)
        self._layout = layout
        marks, answers = _marks(layout, rows), dict[int, Any]()
        orders = {
            k: self._order(part, rows, marks, function, arguments(part)) for k, part in enumerate(self._parts)
        }
        for k, answer in self._cluster.at_workers(carry_out, orders):
            part = self._parts[k]
            if isinstance(answer, Lost):
                raise SolverError(f"{self._cluster.where}: {part} failed on {part.owner}: {answer.message}")
            if not answer:
                problem = f"{part} was lost with worker {part.owner} (killed, restarted, or out of memory)"
                raise SolverError(f"{self._cluster.where}: {problem}; run this again, or {_REMEDY}")
            part.sent, answers[k] = marks, answer[0]
        return [answers[k] for k in range(len(self._parts))]

    def _order(
        self, part: _Part, rows: Rows, marks: dict[str, list[object]], function: Callable[..., Any] | None,
        arguments: tuple[Any, ...],
    ) -> tuple[str, Order]:  # fmt: skip
        """The owner of a partition, and an order with what it lacks."""
        source, changes = None, dict[str, NDArray[Any]]()
        if part.sent is None:
            source = Source(partition(rows, part.pieces.start, part.pieces.stop), self._layout.groups, part.target)
        else:
            for name, now in marks.items():
                if any(array is not sent for array, sent in zip(now, part.sent[name], strict=True)):
                    changes[name] = getattr(rows, name)[part.own[name]]
        return part.owner, Order(part.token, function, arguments, self._layout.model, source, changes)


def _marks(layout: Layout, rows: Rows) -> dict[str, list[object]]:
    """Fields of rows that change during an adjustment, and the objects that are others when they have changed."""
    return {"kind": [rows.kind], "weight": [rows.weight], "data": [layout.lines, layout.bent, layout.stereo]}


def _part(layout: Layout, first: int, last: int, common: int, owner: str) -> _Part:
    """The partition of pieces first .. last - 1 for a worker; `common` bytes are the whole's tables."""
    rows = layout.rows
    of_part = partition(rows, first, last)
    _, point, _, number, observation = rows.piece[first].tolist()
    used = np.unique(rows.pattern_group[of_part.piece[:, 0]])
    selections = {
        "kind": slice(point, point + of_part.kind.size),
        "data": slice(number, number + of_part.data.size),
        "weight": (slice(None), slice(observation, observation + of_part.weight.shape[1])),
    }
    size = size_of((of_part.kind, of_part.start, of_part.data, of_part.weight)) + common
    blocks = blocks_of_partition(layout.groups, layout.blocks.target, used)
    return _Part(slice(first, last), selections, *blocks, size, owner)


def blocks_of_partition(groups: Groups, target: NormalBlocks, used: Index) -> tuple[Index, NormalBlocks]:
    """Blocks of some groups by themselves: where they are among the whole's, and their target."""
    places, sizes = [no_rows()], [no_rows()]
    for group in used:
        width = groups.member_width[groups.member_first[group] : groups.member_first[group + 1]]
        places.append(target.pair[groups.pair_first[group] : groups.pair_first[group + 1]])
        sizes.append(np.multiply.outer(width, width).ravel())
    first, example = np.unique(np.concatenate(places), return_index=True)
    size = np.concatenate(sizes)[example]
    begin = np.cumsum(size) - size
    inside = np.arange(size.sum()) - np.repeat(begin, size)
    pair = np.zeros_like(target.pair)
    for group, pairs in zip(used, places[1:], strict=True):
        pair[groups.pair_first[group] : groups.pair_first[group + 1]] = begin[np.searchsorted(first, pairs)]
    return np.repeat(first, size) + inside, target._replace(pair=pair, size=int(size.sum()))


def size_of(record: tuple[Any, ...]) -> int:
    """Bytes of a record's arrays."""
    return sum(value.nbytes for value in record if isinstance(value, np.ndarray))
