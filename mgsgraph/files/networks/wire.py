"""Points of a binary control network straight from the file's bytes into arrays, by compiled code.

The wire format is protobuf's: a field is its number and kind, then a whole number in sevens of bits, eight bytes of a
float64, or a size and so many bytes. What is decoded is what an adjustment takes of a point (`messages` has the
fields); other fields, and fields of another kind than theirs, are left out, as protobuf does it. What is decoded is not
judged here but for its bytes.
"""

import numpy as np

from mgsgraph.compiled import cached_kernel, compiled
from mgsgraph.files.networks.messages import LARGEST

_VARINT, _FIXED64, _BYTES = 0, 1, 2
"""Kinds of fields on the wire."""


@compiled
def _varint(data, at, end):
    """A whole number below 2^31 and where it ends; -1 for one that is larger, negative or cut short."""
    value, shift = np.int64(0), 0
    while at < end and shift < 35:
        byte = np.int64(data[at])
        at += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return (value, at) if value < 2147483648 else (-1, at)
        shift += 7
    return -1, at


@compiled
def _number(data, at, bits, number):
    """The float64 at a place, by way of `bits` and `number`, which share memory."""
    value = np.uint64(0)
    for k in range(8):
        value |= np.uint64(data[at + k]) << np.uint64(8 * k)
    bits[0] = value
    return number[0]


@compiled
def _set_or_nan(value):
    """A number as it is, NaN for those of ISIS's special values that say that none was set, inf for what is none."""
    if -LARGEST < value < LARGEST:
        return value
    return np.nan if value < 0.0 and value > -np.inf else np.inf


@compiled
def _field(data, at, end):
    """Number, kind and value of the field at a place, and where the next one begins: of a whole number its value, of
    anything else where its bytes begin. Number -1 where that can't be.
    """
    tag, at = _varint(data, at, end)
    number, kind = tag >> 3, tag & 7
    if tag < 8:
        return -1, 0, 0, at
    if kind == _VARINT:
        value, at = _varint(data, at, end)
        return (number if value >= 0 else -1), kind, value, at
    if kind == _FIXED64:
        return (number if at + 8 <= end else -1), kind, at, at + 8
    if kind == _BYTES:
        size, at = _varint(data, at, end)
        return (number if 0 <= size <= end - at else -1), kind, at, at + size
    return -1, kind, 0, at


@cached_kernel
def count_measures(data, begin, end):
    """(n,) measures of points whose messages lie at begin (n,) to end (n,); -1 for a message that is none."""
    counts = np.zeros(begin.size, dtype=np.int64)
    for i in range(begin.size):
        at = begin[i]
        while at < end[i]:
            number, kind, _, at = _field(data, at, end[i])
            if number < 0:
                counts[i] = -1
                break
            counts[i] += number == 25 and kind == _BYTES
    return counts


@compiled
def _read_measure(data, at, end, bits, number, k, measures, ignored, types, images):
    """A measure to row k; False for a message that is none."""
    while at < end:
        field, kind, value, at = _field(data, at, end)
        if field < 0:
            return False
        if field == 1 and kind == _BYTES:
            images[k, 0], images[k, 1] = value, at
        elif field == 2 and kind == _VARINT:
            types[k] = value
        elif field == 10 and kind == _VARINT:
            ignored[k] = value != 0
        elif (field == 3 or field == 4 or field == 15 or field == 16) and kind == _FIXED64:
            column = 1 if field == 3 else 0 if field == 4 else 3 if field == 15 else 2
            measures[k, column] = _set_or_nan(_number(data, value, bits, number))
    return True


@cached_kernel
def read_points(data, begin, end, first, types, ids, ignored, places, covariances, measures, left_out, kinds, images):
    """Decode points; how many of them are messages.

    Parameters
    ----------
    data : (b,) uint8
        All of the file.
    begin, end : (n,)
        Where the points' messages lie.
    first : (n + 1,)
        Number of each point's first measure.
    types : (n,) int64
        By their numbers in the file; this and what follows is filled here where a field is there.
    ids : (n, 2)
        Where each point's id lies.
    ignored : (n,) bool
        Points that are ignored.
    places : (n, 6)
        m, a-priori and adjusted place; NaN where ISIS says that there is none, inf for no number.
    covariances : (n, 6)
        m^2, of a-priori places: xx, xy, xz, yy, yz, zz; inf where there are not six numbers.
    measures : (k, 4)
        Line, sample, their sigmas, in pixels; NaN and inf as for places.
    left_out : (k,) bool
        Measures that are ignored.
    kinds : (k,) int64
        Types of measures by their numbers.
    images : (k, 2)
        Where their images' names lie.
    """
    bits = np.zeros(1, dtype=np.uint64)
    number = bits.view(np.float64)
    for i in range(begin.size):
        at, k, has_covariance = begin[i], first[i], False
        while at < end[i]:
            field, kind, value, at = _field(data, at, end[i])
            if field == 1 and kind == _BYTES:
                ids[i, 0], ids[i, 1] = value, at
            elif field == 2 and kind == _VARINT:
                types[i] = value
            elif field == 6 and kind == _VARINT:
                ignored[i] = value != 0
            elif (16 <= field <= 18 or 20 <= field <= 22) and kind == _FIXED64:
                places[i, field - 16 if field < 19 else field - 17] = _set_or_nan(_number(data, value, bits, number))
            elif field == 19 and not (kind == _BYTES and at == value):
                whole = kind == _BYTES and at - value == 48 and not has_covariance
                for c in range(6):
                    element = _number(data, value + 8 * c, bits, number) if whole else np.inf
                    covariances[i, c] = element if -LARGEST < element < LARGEST else np.inf
                has_covariance = True
            elif field == 25 and kind == _BYTES:
                if not _read_measure(data, value, at, bits, number, k, measures, left_out, kinds, images):
                    return i
                k += 1
    return begin.size


@cached_kernel
def gathered(data, spans, total):
    """Bytes of texts at spans (m, 2), one after another, `total` in all."""
    content, at = np.empty(total, dtype=np.uint8), 0
    for i in range(spans.shape[0]):
        for k in range(spans[i, 0], spans[i, 1]):
            content[at] = data[k]
            at += 1
    return content
