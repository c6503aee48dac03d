"""Tie points of a binary control network without an object for each point and measure (`networks.wire`)."""

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.networks.binary import ANEW, BinaryContent, binary_content
from mgsgraph.files.networks.point_messages import Texts
from mgsgraph.files.networks.record import ControlPoint, PointType, with_names
from mgsgraph.files.networks.tie_points import PointArrays, require_usable
from mgsgraph.files.opening import name_of
from mgsgraph.files.tie_points import TiePoints
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.records import LONGEST_NAME, Index
from mgsgraph.names import Names, RepeatedNames

_SLOTS = 1 << 12
"""Of the first hash table of images; it grows with what is found to be needed."""
_OF_OLD = np.array([PointType.FREE, PointType.FIXED, *PointType])
"""Types of points by their numbers in the file: 0 and 1 are Tie and Ground of old."""


def binary_tie_points(data: bytes, source: str, body: Ellipsoid | None = None) -> TiePoints:
    """What an adjustment takes from the content of a binary network.

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
        With file, byte, and number and id of the point: what `parse_binary_network` and `tie_points` refuse; a message
        with fields of other kinds than ISIS's.
    """
    content = binary_content(data, source)
    with_names(content.head)
    return _decoded(content, body)


def _decoded(content: BinaryContent, body: Ellipsoid | None) -> TiePoints:
    from mgsgraph.files.networks import wire

    begin, end = content.begin, content.end
    data = np.frombuffer(content.data, dtype=np.uint8)
    count = wire.count_measures(data, begin, end)
    for number in np.flatnonzero(count < 0)[:1].tolist():
        raise _refusal(content, number)
    first = np.concatenate([[0], np.cumsum(count)])
    n, k, slots = begin.size, int(first[-1]), _SLOTS
    types, ids, ignored = np.zeros(n, dtype=np.int64), np.zeros((n, 2), dtype=np.int64), np.zeros(n, dtype=bool)
    places, covariances, measures = np.empty((n, 3)), np.empty((n, 6)), np.empty((k, 4))
    out, spans, image = np.zeros(k, dtype=bool), np.zeros((k, 2), dtype=np.int64), np.zeros(k, dtype=np.int64)
    while True:
        table, images = np.full(slots, -1), np.zeros((slots // 2 + 2, 2), dtype=np.int64)
        done = wire.read_points(data, begin, end, first, table, images, types, ids, ignored, places, covariances,
                                measures, out, spans, image)  # fmt: skip
        if done == n:
            break
        if images[-1, 0] <= slots // 2:
            raise _refusal(content, done)
        slots *= 16
    names, distinct = names_at(data, ids), names_at(data, images[: images[-1, 0]])
    if names.first_repeated is not None:
        number = names.first_repeated
        earlier = names.tolist().index(names[number])
        where = f"{content.where(number)} ({names[number]})"
        raise InputError(where, f"the id twice, first at point {earlier + 1}", "each id once")
    for number in _not_shown(names)[:1]:
        raise _refusal(content, number)
    for number in _not_shown(distinct)[:1]:
        raise _refusal(content, int(np.searchsorted(first, np.argmax(image == number), side="right")) - 1)
    arrays = PointArrays(content.head, names, _OF_OLD[types], ignored, places, covariances, first,
                         RepeatedNames(tuple(distinct), image), measures, out)  # fmt: skip
    try:
        return arrays.tie_points(body)
    except InputError as error:  # of an image twice it knows the point's id, not its byte
        point = np.repeat(np.arange(n), count)
        code = np.where(out | ignored[point], -1 - np.arange(k), point * len(distinct) + image)
        order = np.argsort(code, kind="stable")
        for measure in np.sort(order[1:][np.diff(code[order]) == 0])[:1].tolist():
            raise _refusal(content, int(point[measure])) from error
        raise


def _refusal(content: BinaryContent, number: int) -> InputError:
    """What is wrong with a point, by its number from 0."""
    try:
        point = content.point(number, Texts())
        where = f"{content.where(number)} ({point.id[:60]})"
        name_of(point.id, where, "an id")
        for measure in point.measures:
            name_of(measure.serial_number, where, "an image's name")
        if not point.ignore:
            require_usable(point, 0, lambda _, k, key: ", ".join(filter(None, (where, _image(point, k), key))))
    except InputError as error:
        return error
    return InputError(where, "a message with fields of other kinds", "those of ISIS's networks", ANEW)


def _image(point: ControlPoint, measure: int | None) -> str:
    return "" if measure is None else f"image {point.measures[measure].serial_number}"


def _not_shown(names: Names) -> list[int]:
    """Numbers of names that `record.with_names` refuses."""
    if int(names.data.max(initial=0)) < 128 and np.diff(names.offsets).max(initial=0) <= LONGEST_NAME:
        return []  # ASCII ones that can't be printed have been refused before
    return [k for k, name in enumerate(names.tolist()) if len(name) > LONGEST_NAME or not name.isprintable()]


def names_at(content: np.ndarray, spans: Index) -> Names:
    """Texts that lie at spans (m, 2) of a file's content (b,) uint8."""
    from mgsgraph.files.networks import wire

    offsets = np.concatenate([[0], np.cumsum(spans[:, 1] - spans[:, 0])]).astype(np.int64)
    return Names(wire.gathered(content, spans, int(offsets[-1])), offsets)
