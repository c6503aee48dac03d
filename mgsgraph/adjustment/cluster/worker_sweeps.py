"""The worker's side: partitions of an adjustment's points that this process holds, and the sweeps over them.

A partition comes once; after that only what changes: rows that take part, the loss, the orientation. Its rays are laid
out about other lines here. Where the inner solves of a sweep ended stays here for the next one to begin. What a worker
doesn't hold (it was begun anew) it answers with nothing, and gets it again.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.graph.leverage import numbers
from mgsgraph.adjustment.graph.sampled_rays import SampledRays, follow
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.reduction import all_residuals, point_covariances, reduce
from mgsgraph.kernel.rows import Groups, Model, NormalBlocks, Rows
from mgsgraph.kernel.sweep import COSTS, COVARIANCES, GRADIENT, RELIABILITY, RESIDUALS, SYSTEM, writable

HOLD, PLACES, FOLLOW = -1, -2, -3
"""Orders beside the kernel's sweeps: take a partition in; return where the points of an earlier sweep ended; lay rays
out about the lines in which points are seen."""
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
    rays: SampledRays | None = None
    """What lays its rays out about other lines; None where that takes more than trajectories."""
    lines: Array = np.zeros(0)
    """(k,) lines about which they are laid out."""

    @property
    def system(self) -> tuple[Rows, Groups, NormalBlocks, Model]:
        """What a sweep takes."""
        return self.rows, self.groups, self.target, self.model


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """One sweep over one partition of n points."""

    token: str
    """Of the partition, unlike any other."""
    task: int
    """COSTS, GRADIENT, SYSTEM, COVARIANCES, RELIABILITY, RESIDUALS, HOLD, PLACES or FOLLOW."""
    orientation: Array
    """(columns,) m and rad."""
    source: Source | None = None
    """The partition, where the worker may not hold it."""
    changes: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """Fields of its rows that are new since the last order."""
    model: Model | None = None
    """The measurement model, where it is new."""
    lines: Array | None = None
    """(k,) lines about which its rays are to be laid out, where these are new."""
    near: float = 0.0
    """Lines that rays may be from those in which points are seen (FOLLOW)."""
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
        bytes; FOLLOW: lines (k,), and how many times rays were laid out.
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
    if order.task == FOLLOW:
        assert constants.rays is not None
        lines, turns = follow(*constants.system, constants.rays, constants.lines, x, points, order.near)
        held.source = constants._replace(lines=lines)
        return lines, np.array(turns)
    if order.task == RESIDUALS:
        return (all_residuals(*constants.system, x, points),)
    assert order.joint is not None
    if order.task == RELIABILITY:
        return (numbers(*constants.system, x, order.joint, points)[0],)
    assert order.task == COVARIANCES
    return (point_covariances(*constants.system, x, order.joint, points),)


def _find(order: Order) -> _Partition | None:
    """The partition, brought up to date."""
    now = time.monotonic()
    if order.source is not None:
        for token in [token for token, held in _partitions.items() if now - held.used > _KEPT]:
            _partitions.pop(token, None)
        _partitions[order.token] = _Partition(_writable_record(order.source))
    held = _partitions.get(order.token)
    if held is not None:
        held.used = now
        held.source = _changed(held.source, order)
    return held


def _changed(source: Source, order: Order) -> Source:
    """A partition with what an order says is new."""
    if order.changes:
        new = {name: writable(values) for name, values in order.changes.items()}
        source = source._replace(rows=source.rows._replace(**new))
    if order.model is not None:
        source = source._replace(model=order.model)
    if order.lines is not None:
        assert source.rays is not None
        lines = writable(order.lines)
        source.rays.renew(source.rows.data, lines)
        source = source._replace(lines=lines)
    return source


def _reduce(held: _Partition, order: Order) -> Answer:
    """Solve and eliminate; where the points end is kept."""
    begin = order.points
    if order.after in held.ends:
        begin = held.ends[order.after][0]
    found = reduce(*held.source.system, order.orientation, COSTS if order.task == PLACES else order.task, begin)
    held.ends = {number: end for number, end in held.ends.items() if number in order.kept}
    held.ends[order.number] = found.points, found.states
    return found.piece_cost, found.blocks, found.gradient


def forget(tokens: list[str]) -> None:
    """Let partitions go."""
    for token in tokens:
        _partitions.pop(token, None)


def size_of(record: tuple[Any, ...]) -> int:
    """Bytes of a record's arrays, and of those of records in it."""
    return sum(
        size_of(value) if isinstance(value, tuple) else value.nbytes
        for value in record
        if isinstance(value, tuple | np.ndarray)
    )


def _writable_record(record: Any) -> Any:
    """A record with arrays of its own, and so are those in it."""
    if isinstance(record, np.ndarray):
        return writable(record)
    return type(record)(*map(_writable_record, record)) if isinstance(record, tuple) else record
