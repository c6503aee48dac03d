"""Tie points of a binary control network without an object for each point and measure (`networks.wire`)."""

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.networks.binary import head_and_spans
from mgsgraph.files.networks.record import PointType, with_names
from mgsgraph.files.networks.tie_points import KINDS, require_body
from mgsgraph.files.tie_points import PointKind, TiePoints
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.records import Array, Index, Mask, repeated
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.units import ISIS_OFFSET

SLOTS = 1 << 12
"""Of the first hash table of images; it grows with what is found to be needed."""
MOST_SLOTS = 1 << 22
_KIND_OF_TYPE = np.array(
    [int(KINDS[one]) for one in (PointType.FREE, PointType.FIXED, PointType.FREE, PointType.CONSTRAINED,
                                 PointType.FIXED)]
)  # fmt: skip
"""PointKind by the type's number in the file: 0 and 1 are Tie and Ground of old."""


def binary_tie_points(data: bytes, source: str, body: Ellipsoid | None = None) -> TiePoints | None:
    """What an adjustment takes from the content of a binary network of version 2 or 5; None where something is odd, of
    which `parse_binary_network` and `tie_points` know what to think.

    Parameters
    ----------
    data : bytes
        All of the file.
    source : str
        File, for messages.
    body : Ellipsoid, optional
        That of the images.

    Raises
    ------
    InputError
        What is wrong with label and header, as `parse_binary_network`; a network of another body.
    """
    known = head_and_spans(data, source)
    if known is None:
        return None
    head, begin, end = known
    try:
        with_names(head)
    except InputError:  # points are looked at first, there
        return None
    found = _decoded(np.frombuffer(data, dtype=np.uint8), begin, end, source) if begin.size else None
    if found is None:
        return None
    if body is not None:
        require_body(head, found, body)
    return found


def _decoded(content: np.ndarray, begin: Index, end: Index, source: str) -> TiePoints | None:
    """Points whose messages lie at begin (n,) to end (n,)."""
    from mgsgraph.files.networks import wire

    count = wire.count_measures(content, begin, end)
    if np.any(count < 0):
        return None
    first = np.concatenate([[0], np.cumsum(count)])
    n, k, slots = begin.size, int(first[-1]), SLOTS
    types, ids, ignored = np.zeros(n, dtype=np.int64), np.zeros((n, 2), dtype=np.int64), np.zeros(n, dtype=bool)
    places, covariances, measures = np.empty((n, 3)), np.empty((n, 6)), np.empty((k, 4))
    out, spans, image = np.zeros(k, dtype=bool), np.zeros((k, 2), dtype=np.int64), np.zeros(k, dtype=np.int64)
    while True:
        table, images = np.full(slots, -1), np.zeros((slots // 2 + 2, 2), dtype=np.int64)
        done = wire.read_points(content, begin, end, first, table, images, types, ids, ignored, places, covariances,
                                measures, out, spans, image)  # fmt: skip
        if done == n:
            break
        if images[-1, 0] <= slots // 2 or slots >= MOST_SLOTS:
            return None
        slots *= 16
    names, distinct = names_at(content, ids), names_at(content, images[: images[-1, 0]])
    if names.first_repeated is not None or np.all(ignored) or not (_can_be_shown(names) and _can_be_shown(distinct)):
        return None
    return used_points(source, names, _KIND_OF_TYPE[types], ~ignored, places, covariances, first,
                       RepeatedNames(tuple(distinct), image), measures, ~out)  # fmt: skip


def _can_be_shown(names: Names) -> bool:
    """Whether `record.with_names` takes them; ASCII ones that can't be printed have been left out before."""
    return int(names.data.max(initial=0)) < 128 or names.text.isprintable()


def names_at(content: np.ndarray, spans: Index) -> Names:
    """Texts that lie at spans (m, 2) of a file's content (b,) uint8."""
    from mgsgraph.files.networks import wire

    offsets = np.concatenate([[0], np.cumsum(spans[:, 1] - spans[:, 0])]).astype(np.int64)
    return Names(wire.gathered(content, spans, int(offsets[-1])), offsets)


def used_points(
    source: str, names: Names, kinds: Index, used: Mask, places: Array, covariances: Array, first: Index,
    image: RepeatedNames, measures: Array, taken: Mask,
) -> TiePoints:  # fmt: skip
    """Points and measures that are not ignored: `used` (n,) and `taken` (k,)."""
    point = np.repeat(np.arange(kinds.size), np.diff(first))
    if not np.all(used):
        taken = taken & used[point]
        point = (np.cumsum(used) - 1)[point]
        names, kinds, places, covariances = names[used], kinds[used], places[used], covariances[used]
    if not np.all(taken):
        point, image, measures = point[taken], image[taken], measures[taken]
    measures, sigmas = measures[:, :2] - ISIS_OFFSET, measures[:, 2:].copy()
    for array in (kinds, places, point, measures, sigmas):
        array.flags.writeable = False
    return TiePoints(
        source=source, ids=names, kinds=kinds, places=places, covariances=_squares(kinds, covariances),
        measure_point=point, measure_image=image, measures=measures, measure_sigmas=sigmas,
    )


def _squares(kinds: Index, upper: Array) -> Array:
    """(n, 3, 3) m^2 of upper triangles (n, 6); zero for points that are not constrained."""
    constrained = kinds == PointKind.CONSTRAINED
    if not np.any(constrained):
        return repeated(0.0, (kinds.size, 3, 3))
    full = np.where(constrained[:, None], upper, 0.0)[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    full.flags.writeable = False
    return full
