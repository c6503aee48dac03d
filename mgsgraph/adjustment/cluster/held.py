"""The worker's side: partitions of an adjustment's points that this process holds, and the sweeps over them.

A partition comes once; after that only what changes: rows that take part, the orientation. Where the
inner solves of a sweep ended stays here for the next one to begin. What a worker doesn't hold (it was begun anew) it
answers with nothing, and gets it again.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.graph.leverage import numbers
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.reduction import all_residuals, point_covariances, reduce
from mgsgraph.kernel.rows import Groups, Model, NormalBlocks, Rows
from mgsgraph.kernel.sweep import COSTS, COVARIANCES, GRADIENT, RELIABILITY, RESIDUALS, SYSTEM, writable

HOLD, PLACES = -1, -2
"""Orders beside the kernel's sweeps: take a partition in; return where the points of an earlier sweep ended."""
CHANGING = ("kind", "weight")
"""Fields of `Rows` that change between the passes of an adjustment."""
NOT_HELD: tuple[()] = ()
"""The answer of a worker that doesn't hold what the order is about."""

_KEPT = 600.0
"""s without an order after which a partition makes room for new ones: whoever sent it has gone, or sends it again."""

Answer = tuple[NDArray[Any] | None, ...]
"""What comes back: arrays, none of them to say that it isn't held."""


class Source(NamedTuple):
    """All that a worker needs of a partition."""

    rows: Rows
    """Its rows."""
    groups: Groups
    """The whole's groups."""
    target: NormalBlocks
    """Blocks of the pairs of variables that its points depend on."""
    model: Model
    """The measurement model."""


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """One sweep over one partition of n points."""

    token: str
    """Of the partition, unlike any other."""
    task: int
    """COSTS, GRADIENT, SYSTEM, COVARIANCES, RELIABILITY, RESIDUALS, HOLD or PLACES."""
    orientation: Array
    """(columns,) m and rad."""
    source: Source | None = None
    """The partition, where the worker may not hold it."""
    changes: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """Fields of its rows that are new since the last order."""
    number: int = 0
    """Of a reduction: by which its places are asked for later (PLACES)."""
    after: int | None = None
    """Reduction at whose places this one begins."""
    kept: frozenset[int] = frozenset()
    """Reductions whose places are still wanted."""
    points: Array | None = None
    """(n, 3) m, where places are given."""
    joint: Array | None = None
    """Covariance of the shared unknowns in the partition's blocks."""


@dataclass(slots=True, eq=False)
class _Partition:
    """A partition and what is known of its points."""

    source: Source
    used: float = 0.0
    """s, when the last order came."""
    ends: dict[int, tuple[Array, NDArray[np.int8]]] = field(default_factory=dict)
    """Places (n, 3) in m and states (n,) at which reductions ended, by their number."""


_partitions: dict[str, _Partition] = {}


def carry_out(order: Order) -> Answer:
    """Do what an order says.

    Returns
    -------
    tuple
        NOT_HELD, or: COSTS, GRADIENT and SYSTEM: cost of each piece, blocks (SYSTEM) or None, gradient; COVARIANCES:
        (n, 3, 3) m^2; RELIABILITY: (t, 8); RESIDUALS: (t, 2); PLACES: (n, 3) m, and states (n,); HOLD: its number of
        bytes.
    """
    held = _find(order)
    if held is None:
        return NOT_HELD
    constants, x, points = held.source, order.orientation, order.points
    if order.task in (COSTS, GRADIENT, SYSTEM):
        return _reduce(held, order)
    if order.task == PLACES:
        if order.number not in held.ends:
            _reduce(held, order)
        return held.ends[order.number]
    if order.task == HOLD:
        return (np.array(size_of(constants.rows)),)
    assert points is not None
    if order.task == RESIDUALS:
        return (all_residuals(*constants, x, points),)
    assert order.joint is not None
    if order.task == RELIABILITY:
        return (numbers(*constants, x, order.joint, points)[0],)
    assert order.task == COVARIANCES
    return (point_covariances(*constants, x, order.joint, points),)


def _find(order: Order) -> _Partition | None:
    """The partition, brought up to date."""
    now = time.monotonic()
    if order.source is not None:
        for token in [token for token, held in _partitions.items() if now - held.used > _KEPT]:
            _partitions.pop(token, None)
        _partitions[order.token] = _Partition(Source(*map(_writable_record, order.source)))
    held = _partitions.get(order.token)
    if held is not None:
        held.used = now
        if order.changes:
            new = {name: writable(values) for name, values in order.changes.items()}
            held.source = held.source._replace(rows=held.source.rows._replace(**new))
    return held


def _reduce(held: _Partition, order: Order) -> Answer:
    """Solve and eliminate; where the points end is kept."""
    begin = order.points
    if order.after in held.ends:
        begin = held.ends[order.after][0]
    found = reduce(*held.source, order.orientation, COSTS if order.task == PLACES else order.task, begin)
    held.ends = {number: end for number, end in held.ends.items() if number in order.kept}
    held.ends[order.number] = found.points, found.states
    return found.piece_cost, found.blocks, found.gradient


def forget(tokens: list[str]) -> None:
    """Let partitions go."""
    for token in tokens:
        _partitions.pop(token, None)


def size_of(record: tuple[Any, ...]) -> int:
    """Bytes of a record's arrays."""
    return sum(values.nbytes for values in record if isinstance(values, np.ndarray))


def _writable_record(record: Any) -> Any:
    """A record with arrays of its own."""
    return type(record)(*(writable(value) if isinstance(value, np.ndarray) else value for value in record))
