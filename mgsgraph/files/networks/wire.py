"""Points of a binary control network straight from the file's bytes into arrays, by compiled code.

The wire format is protobuf's: a field is its number and kind, then a whole number in sevens of bits, eight bytes of a
float64, or a size and so many bytes. What is decoded is what an adjustment takes of a point (`messages` has the
fields). The decoder takes texts in UTF-8 (The Unicode Standard 15.0, table 3-7), choices that exist, numbers that are
finite or ISIS's special values, places that are whole, measures that an adjustment can use. At anything else it stops,
and says at which point; what is wrong with that one `networks.binary_columns` says.
"""

import numpy as np

from mgsgraph.compiled import cached_kernel, compiled
from mgsgraph.files.networks.point_messages import LARGEST
from mgsgraph.files.networks.tie_points import FARTHEST
from mgsgraph.geometry.records import LONGEST_NAME

_VARINT, _FIXED64, _BYTES = 0, 1, 2
"""Kinds of fields on the wire."""
_LONGEST = 4 * LONGEST_NAME
"""Bytes of a name."""
_LAST_OF_POINT, _LAST_OF_MEASURE = 25, 17
"""Fields beyond are unknown, and left out."""


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
    """The float64 at a place, by way of `bits` and `number`, which are one memory."""
    value = np.uint64(0)
    for k in range(8):
        value |= np.uint64(data[at + k]) << np.uint64(8 * k)
    bits[0] = value
    return number[0]


@compiled
def _kept(value):
    """A number as it is, NaN for those of ISIS's special values that say that none was set, inf for what is none."""
    if -LARGEST < value < LARGEST:
        return value
    return np.nan if value < 0.0 and value > -np.inf else np.inf


@compiled
def _name_at(data, at, end, spans, row):
    """Whether a text can be a name, as far as bytes tell; where it lies goes to a row of `spans`."""
    spans[row, 0], spans[row, 1] = at, end
    plain = True
    for k in range(at, end):
        plain &= data[k] >= 32 and data[k] != 127
    return 0 < end - at <= _LONGEST and plain and is_utf8(data, at, end)


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


@compiled
def is_utf8(data, at, end):
    """Whether the bytes at..end of data (b,) uint8 are UTF-8."""
    plain = True
    for k in range(at, end):
        plain &= data[k] <= 127
    if plain:
        return True
    while at < end:
        size = _character_size(data[at])
        if size == 0 or size > end - at:
            return False
        if size > 1 and not _follows(data[at], data[at + 1]):
            return False
        for k in range(at + 2, at + size):
            if not 0x80 <= data[k] <= 0xBF:
                return False
        at += size
    return True


@compiled
def _character_size(first):
    """Bytes of the character that begins with a byte; 0 where none does."""
    if first <= 0x7F:
        return 1
    if first < 0xC2 or first > 0xF4:
        return 0
    return 2 if first < 0xE0 else 3 if first < 0xF0 else 4


@compiled
def _follows(first, second):
    """Whether a second byte can follow the first one: no character is longer than it need be, half of a pair (a
    surrogate) or beyond U+10FFFF.
    """
    least = 0xA0 if first == 0xE0 else 0x90 if first == 0xF0 else 0x80
    most = 0x9F if first == 0xED else 0x8F if first == 0xF4 else 0xBF
    return least <= second <= most


@cached_kernel
def count_measures(data, begin, end):
    """(n,) measures of points whose messages lie at begin (n,) to end (n,); -1 for a message that is none."""
    found = np.zeros(begin.size, dtype=np.int64)
    for i in range(begin.size):
        at = begin[i]
        while at < end[i]:
            number, _, _, at = _field(data, at, end[i])
            if number < 0:
                found[i] = -1
                break
            found[i] += number == 25
    return found


@compiled
def _logged(data, at, end, bits, number):
    """Whether an entry of the log is one."""
    while at < end:
        field, kind, value, at = _field(data, at, end)
        if field == 1 and kind == _VARINT:
            continue
        if field < 0 or field == 1:
            return False
        if field == 2 and (kind != _FIXED64 or np.isinf(_kept(_number(data, value, bits, number)))):
            return False
    return True


@compiled
def _read_measure(data, at, end, bits, number, k, measures, flags, serial):
    """Line, sample and their sigmas of a measure to row k, its mark of ignorance and where its serial number is; False
    for an odd one.
    """
    kind_of_measure, there = -1, False
    measures[k] = np.nan
    flags[k] = False
    while at < end:
        field, kind, value, at = _field(data, at, end)
        if field == 1 and kind == _BYTES:
            there = _name_at(data, value, at, serial, k)
            if not there:
                return False
        elif field == 2 and kind == _VARINT:
            kind_of_measure = value
            if value > 3:
                return False
        elif (3 <= field <= 6 or 12 <= field <= 16) and kind == _FIXED64:
            found = _kept(_number(data, value, bits, number))
            if np.isinf(found):
                return False
            column = 1 if field == 3 else 0 if field == 4 else 3 if field == 15 else 2 if field == 16 else -1
            if column >= 0:
                measures[k, column] = found
        elif (field == 7 or field == 8) and kind == _BYTES:
            if not is_utf8(data, value, at):
                return False
        elif (field == 9 or field == 10 or field == 11) and kind == _VARINT:
            if value > 1:
                return False
            if field == 10:
                flags[k] = value == 1
        elif field == 17 and kind == _BYTES:
            if not _logged(data, value, at, bits, number):
                return False
        elif field <= _LAST_OF_MEASURE:
            return False
    return there and kind_of_measure >= 0


@compiled
def _measured(begin, end, measures, flags):
    """Whether measures that are not ignored have line and sample, and no sigma that is none."""
    for k in range(begin, end):
        line, sample, first, second = measures[k]
        if not flags[k] and (np.isnan(line) or np.isnan(sample) or first <= 0.0 or second <= 0.0):
            return False
    return True


@compiled
def _same(data, a, b, c, d):
    if b - a != d - c:
        return False
    same = True
    for k in range(b - a):
        same &= data[a + k] == data[c + k]
    return same


@compiled
def image_number(data, at, end, table, first):
    """Number of the image of a name: that of an equal one in `table`, a hash table of numbers, whose names lie where
    `first` says, or a new one; -1 when the table is full.
    """
    code = np.uint64(14695981039346656037)
    for k in range(at, end):
        code = (code ^ np.uint64(data[k])) * np.uint64(1099511628211)
    code ^= code >> np.uint64(32)
    mask = np.uint64(table.size - 1)
    slot = code & mask
    while table[slot] >= 0:
        number = table[slot]
        if _same(data, at, end, first[number, 0], first[number, 1]):
            return number
        slot = (slot + np.uint64(1)) & mask
    number = first[-1, 0]
    if 2 * number > table.size:
        return -1
    table[slot] = number
    first[number, 0], first[number, 1] = at, end
    first[-1, 0] = number + 1
    return number


@cached_kernel
def read_points(data, begin, end, first_measure, table, images, points, ids, marks, places, covariances, measures,
                flags, serial, image):  # fmt: skip
    """Decode points; how many of them were understood.

    Parameters
    ----------
    data : (b,) uint8
        All of the file.
    begin, end : (n,)
        Where the points' messages lie.
    first_measure : (n + 1,)
        Number of each point's first measure.
    table : (2^q,)
        -1 everywhere.
    images : (m + 1, 2)
        Of each distinct image where its name lies, filled here; their number in the last row, 0 at the beginning.
    points : (n,) int64
        Type by its number in the file, filled here.
    ids : (n, 2)
        Where each point's id lies, filled here.
    marks : (n,) bool
        Points that are ignored, filled here.
    places : (n, 3)
        m, a-priori places; for free points without one adjusted ones; NaN where there is none. Filled here.
    covariances : (n, 6)
        m^2, of a-priori places: xx, xy, xz, yy, yz, zz; filled here, NaN where there is none.
    measures : (k, 4)
        Line, sample, their sigmas, in pixels, NaN for none; filled here.
    flags : (k,) bool
        Measures that are ignored, filled here.
    serial : (k, 2)
        Where their images' names lie, filled here.
    image : (k,)
        Number of each measure's image, filled here.
    """
    bits = np.zeros(1, dtype=np.uint64)
    number = bits.view(np.float64)
    place, upper, other, seen = np.empty(6), np.empty(6), np.empty(6), np.empty(2, dtype=np.bool_)
    for i in range(begin.size):
        at, k = begin[i], first_measure[i]
        there, reference = False, -1
        points[i] = -1
        marks[i] = False
        seen[:] = False
        place[:], upper[:] = np.nan, np.nan
        while at < end[i]:
            field, kind, value, at = _field(data, at, end[i])
            if field == 1 and kind == _BYTES:
                there = _name_at(data, value, at, ids, i)
                if not there:
                    return i
            elif field == 2 and kind == _VARINT and value <= 4:
                points[i] = value
            elif field == 6 and kind == _VARINT and value <= 1:
                marks[i] = value == 1
            elif field == 8 and kind == _VARINT:
                reference = value
            elif (16 <= field <= 18 or 20 <= field <= 22) and kind == _FIXED64:
                column = field - 16 if field < 19 else field - 17
                place[column] = _kept(_number(data, value, bits, number))
                if np.isinf(place[column]):
                    return i
            elif field == 19 and kind == _BYTES:
                if not _read_covariance(data, value, at, bits, number, upper, seen, 0):
                    return i
            elif field == 23 and kind == _BYTES:
                if not _read_covariance(data, value, at, bits, number, other, seen, 1):
                    return i
            elif field == 25 and kind == _BYTES:
                if not _read_measure(data, value, at, bits, number, k, measures, flags, serial):
                    return i
                image[k] = image_number(data, serial[k, 0], serial[k, 1], table, images)
                if image[k] < 0:
                    return i
                k += 1
            elif not _is_unused(data, field, kind, value, at):
                return i
        covariances[i] = upper
        if not there or points[i] < 0 or reference >= k - first_measure[i]:
            return i
        if not (_is_whole(place[:3]) and _is_whole(place[3:])):
            return i
        if not _usable(i, points[i], seen[0], marks, place, places, covariances):
            return i
        if not marks[i] and not _measured(first_measure[i], k, measures, flags):
            return i
    return begin.size


@compiled
def _is_unused(data, field, kind, value, at):
    """Whether a field of a point, of no use here, is one that can be: texts, marks, sources of places, unknown ones."""
    if field == 24 or field > _LAST_OF_POINT:
        return True
    if kind == _BYTES:
        return (field == 3 or field == 4 or field == 10 or field == 12) and is_utf8(data, value, at)
    if kind != _VARINT:
        return False
    if field == 9 or field == 11:
        return value <= 7
    return (field == 5 or field == 7 or 13 <= field <= 15) and value <= 1


@compiled
def _read_covariance(data, at, end, bits, number, upper, seen, which):
    """Six numbers to `upper`, and that they were seen; False for another count, numbers that are none, or twelve."""
    if end == at:
        return True
    if end - at != 48 or seen[which]:
        return False
    seen[which] = True
    for c in range(6):
        upper[c] = _number(data, at + 8 * c, bits, number)
        if not -LARGEST < upper[c] < LARGEST:
            return False
    return True


@compiled
def _is_whole(place):
    """Whether all three coordinates of a place are there, or none."""
    missing = np.isnan(place[0]) + np.isnan(place[1]) + np.isnan(place[2])
    return missing == 0 or missing == 3


@compiled
def _usable(i, kind, given, marks, place, places, covariances):
    """Whether an adjustment can take a point of a kind (0 and 2 are free, 3 is constrained), whose place it stores."""
    free = kind == 0 or kind == 2
    first = 3 if free and np.isnan(place[0]) else 0
    for c in range(3):
        places[i, c] = place[first + c]
        if abs(places[i, c]) > FARTHEST and not marks[i]:
            return False
    if marks[i] or free:
        return True
    if np.isnan(place[0]):
        return False
    if kind != 3:
        return True
    return given and covariances[i, 0] > 0.0 and covariances[i, 3] > 0.0 and covariances[i, 5] > 0.0


@cached_kernel
def gathered(data, spans, total):
    """Bytes of texts at spans (m, 2), one after another, `total` in all."""
    found, at = np.empty(total, dtype=np.uint8), 0
    for i in range(spans.shape[0]):
        for k in range(spans[i, 0], spans[i, 1]):
            found[at] = data[k]
            at += 1
    return found
