"""Points of a control network in PVL text straight from the file's bytes, by compiled code.

The scanner takes statements as ISIS writes them: ``keyword = word <unit>`` or a string in one line, matrices over
several, comments between statements. It takes only what it wholly understands: ASCII, keywords and choices that ISIS
knows (`control.pvl_words`), each once, numbers in decimal, places that are whole. At anything else it stops; then the
file is for `io.pvl` and `control.pvl`, which know what it means, or what is wrong with it. Numbers are looked at here,
and left where they are, by the bytes where they begin and end.
"""

import numpy as np

from mgsgraph.compiled import cached_kernel, compiled
from mgsgraph.control import pvl_words as words
from mgsgraph.control.wire import TEXTS, image_number, measured_twice

_FREE, _CONSTRAINED = 0, 1
_TAB, _LINE, _BLANK, _QUOTE, _HASH, _APOSTROPHE, _OPEN, _CLOSE, _STAR = 9, 10, 32, 34, 35, 39, 40, 41, 42
_PLUS, _COMMA, _MINUS, _POINT, _SLASH, _BEGIN_UNIT, _EQUALS, _END_UNIT = 43, 44, 45, 46, 47, 60, 61, 62
_LONGEST = 32
"""Bytes of the longest word that is known."""
_MOST_DIGITS = 250
"""Of a number; with its exponent they are fewer than those of 1e290."""


@compiled
def _skipped(data, at):
    """Place behind blanks and comments; -1 within a comment that is not ASCII or never closed."""
    size = data.size
    while at < size:
        byte = data[at]
        if byte in (_BLANK, _LINE, _TAB):
            at += 1
        elif byte == _HASH:
            while at < size and data[at] != _LINE:
                if data[at] > 127:
                    return -1
                at += 1
        elif byte == _SLASH and at + 1 < size and data[at + 1] == _STAR:
            at += 2
            while at + 1 < size and not (data[at] == _STAR and data[at + 1] == _SLASH):
                if data[at] > 127:
                    return -1
                at += 1
            if at + 1 >= size:
                return -1
            at += 2
        else:
            break
    return at


@compiled
def _along(data, at):
    """Place behind blanks within a line."""
    while at < data.size and (data[at] == _BLANK or data[at] == _TAB):
        at += 1
    return at


@compiled
def _next_line(data, at):
    """Place of the next line, if nothing but blanks are left of this one; else -1."""
    at = _along(data, at)
    if at == data.size:
        return at
    return at + 1 if data[at] == _LINE else -1


@compiled
def _lower(byte):
    return byte + 32 if 65 <= byte <= 90 else byte


@compiled
def _known(data, at, end, vocabulary):
    """Number of a word, in any case, in a `pvl_words.vocabulary`; -1 for one that is not there."""
    slots, begins, texts = vocabulary
    if end - at > _LONGEST or end == at:
        return -1
    code = np.uint64(14695981039346656037)
    for k in range(at, end):
        code = (code ^ np.uint64(_lower(data[k]))) * np.uint64(1099511628211)
    mask = np.uint64(slots.size - 1)
    slot = (code ^ (code >> np.uint64(32))) & mask
    while slots[slot] >= 0:
        number = slots[slot]
        first = begins[number]
        if begins[number + 1] - first == end - at:
            same = True
            for k in range(end - at):
                same &= texts[first + k] == _lower(data[at + k])
            if same:
                return number
        slot = (slot + np.uint64(1)) & mask
    return -1


@compiled
def _keyword(data, at, keys):
    """Number of the keyword at a place, -1 for an unknown one, and the place behind it and blanks in its line."""
    end = at
    while end < data.size:
        byte = data[end]
        if not (97 <= byte <= 122 or 65 <= byte <= 90 or byte == 95 or (48 <= byte <= 57 and end > at)):
            break
        end += 1
    return _known(data, at, end, keys), _along(data, end)


@compiled
def _value(data, at, known):
    """Where the word or string behind a keyword begins and ends, its unit's number (0 without, -1 for an unknown one),
    and the next line; -1 for that where there is another thing than one word or string in this line.
    """
    if at >= data.size or data[at] != _EQUALS:
        return 0, 0, 0, -1
    at = _along(data, at + 1)
    if at < data.size and (data[at] == _QUOTE or data[at] == _APOSTROPHE):
        mark, begin = data[at], at + 1
        at = end = _text_end(data, begin, mark)
        at += 1
        if end < 0:
            return 0, 0, 0, -1
    else:
        begin, at = at, _word_end(data, at)
        end = at
        if end <= begin or data[end - 1] == _MINUS:
            return 0, 0, 0, -1
    unit, at = _unit(data, at, known)
    return begin, end, unit, _next_line(data, at) if at >= 0 else -1


@compiled
def _text_end(data, at, mark):
    """Where a quoted text ends, in its line; -1 where it does not."""
    while at < data.size and data[at] != mark:
        if not (_BLANK <= data[at] <= 126):
            return -1
        at += 1
    return at if at < data.size else -1


@compiled
def _word_end(data, at):
    """Where a word ends; -1 where a comment is in it."""
    while at < data.size:
        byte = data[at]
        if not 33 <= byte <= 126 or _is_mark(byte):
            break
        if byte == _STAR and data[at - 1] == _SLASH:
            return -1
        at += 1
    return at


@compiled
def _is_mark(byte):
    """Whether it ends a word: one of "#'(),<=>{}."""
    if byte in (_QUOTE, _HASH, _COMMA) or _APOSTROPHE <= byte <= _CLOSE:
        return True
    return _BEGIN_UNIT <= byte <= _END_UNIT or byte == 123 or byte == 125


@compiled
def _unit(data, at, known):
    """Number of the unit that follows in a line, 0 without one, -1 for an unknown one, and the place behind it; -1 for
    that where it is never closed.
    """
    at = _along(data, at)
    if at >= data.size or data[at] != _BEGIN_UNIT:
        return 0, at
    begin = end = at + 1
    while end < data.size and data[end] != _END_UNIT:
        if data[end] == _BEGIN_UNIT or not _BLANK <= data[end] <= 126:
            return 0, -1
        end += 1
    if end >= data.size:
        return 0, -1
    return (0 if end == begin else _chosen(data, begin, end, words.UNIT, known)), end + 1


@compiled
def _digits(data, at, end):
    """Place behind digits."""
    while at < end and 48 <= data[at] <= 57:
        at += 1
    return at


@compiled
def _number_end(data, at, end):
    """Where the decimal number at a place ends, whose digits and exponent say that it is finite; -1 for none."""
    if at < end and (data[at] == _PLUS or data[at] == _MINUS):
        at += 1
    whole = _digits(data, at, end)
    count, at = whole - at, whole
    if at < end and data[at] == _POINT:
        fraction = _digits(data, at + 1, end)
        count, at = count + fraction - at - 1, fraction
    if not 0 < count < _MOST_DIGITS:
        return -1
    if at < end and (data[at] | 32) == 101:
        at += 1
        if at < end and (data[at] == _PLUS or data[at] == _MINUS):
            at += 1
        power = _digits(data, at, end)
        exponent = np.int64(0)
        for k in range(at, min(power, at + 4)):
            exponent = 10 * exponent + np.int64(data[k]) - 48
        if power == at or power - at > 4 or exponent + count > 290:
            return -1
        at = power
    return at


@compiled
def _number(data, begin, end, span):
    """Keep where a number is, without a plus sign, which not all readers of numbers take; False for none."""
    if end <= begin or _number_end(data, begin, end) != end:
        return False
    span[0] = begin + (data[begin] == _PLUS)
    span[1] = end
    return True


@compiled
def _matrix(data, at, known, spans):
    """Keep where six numbers in brackets are, (6, 2); the next line, or -1 where there are no such."""
    at = _along(data, at + 1)
    if at >= data.size or data[at] != _OPEN:
        return -1
    at += 1
    for k in range(6):
        at = _within(data, at)
        end = _number_end(data, at, data.size)
        if end < 0:
            return -1
        _number(data, at, end, spans[k])
        _, at = _unit(data, end, known)
        if at < 0:
            return -1
        at = _within(data, at)
        if at >= data.size or data[at] != (_COMMA if k < 5 else _CLOSE):
            return -1
        at += 1
    _, at = _unit(data, at, known)
    return _next_line(data, at) if at >= 0 else -1


@compiled
def _within(data, at):
    """Place behind blanks and ends of lines."""
    while at < data.size and (data[at] == _BLANK or data[at] == _TAB or data[at] == _LINE):
        at += 1
    return at


@compiled
def _chosen(data, begin, end, role, known):
    """What a word means in a role (`pvl_words.MEANINGS`); -1 for a word that is none of its."""
    word = _known(data, begin, end, known[1])
    return known[2][role, word] if word >= 0 else -1


@compiled
def _is_null(data, begin, end):
    return (
        end - begin == 4 and (data[begin] | 32) == 110 and (data[begin + 1] | 32) == 117
        and (data[begin + 2] | 32) == 108 and (data[begin + 3] | 32) == 108
    )  # fmt: skip


@compiled
def _measure(data, at, known, k, measures, name, unused):
    """Read a measure, up to its end: where its line, sample and their sigmas are, whether it is ignored, and where its
    image's name is; the next line, or -1 for an odd one.
    """
    spans, flags, roles, columns = measures[1], measures[2], known[3], known[4]
    seen = np.uint64(0)
    spans[:, k] = 0
    flags[k] = False
    name[:] = 0
    while True:
        at = _skipped(data, at)
        if at < 0:
            return -1
        key, at = _keyword(data, at, known[0])
        if key == words.END_GROUP:
            return _next_line(data, at) if name[1] > name[0] else -1
        bit = np.uint64(1) << np.uint64(max(key, 0))
        if key < 0 or seen & bit or roles[1, key] == words.UNKNOWN:
            return -1
        seen |= bit
        begin, end, unit, at = _value(data, at, known)
        if at < 0:
            return -1
        role, column, null = roles[1, key], columns[key], _is_null(data, begin, end)
        if role == words.NAME:
            if null or not 0 < end - begin <= TEXTS:
                return -1
            name[0], name[1] = begin, end
        elif role == words.PIXEL:
            span = spans[column, k] if column >= 0 else unused
            if not null and not ((unit == 0 or unit == words.IN_PIXELS) and _number(data, begin, end, span)):
                return -1
        elif role != words.TEXT and not null:
            meaning = _chosen(data, begin, end, role, known)
            if meaning < 0:
                return -1
            if key == words.IGNORE:
                flags[k] = meaning == 1


@compiled
def _point_value(data, key, begin, end, unit, i, known, points, here, in_km):
    """Take what stands behind a keyword of a point; whether it was understood."""
    ids, kinds, ignored = points
    role, column, null = known[3][0, key], known[4][key], _is_null(data, begin, end)
    if role == words.NAME:
        ids[i, 0], ids[i, 1] = begin, end
        return not null and 0 < end - begin <= TEXTS
    if role == words.LENGTH:
        in_km[column] = unit == words.IN_KILOMETRES
        in_place = unit == 0 or unit == words.IN_METRES or unit == words.IN_KILOMETRES
        return null or (in_place and _number(data, begin, end, here[column]))
    if role == words.MATRIX:
        return null
    if role == words.TEXT or (null and role != words.POINT_TYPE):
        return True
    meaning = _chosen(data, begin, end, role, known)
    if role == words.POINT_TYPE:
        kinds[i] = meaning
    elif key == words.IGNORE:
        ignored[i] = meaning == 1
    return meaning >= 0


@compiled
def _point(data, at, known, i, k, points, here, in_km, matrices, measures, table, images, spare):
    """Read a point, up to its end: the next line, or -1 for an odd one, -2 where the table of images is full; number of
    the next measure, and whether it has an a-priori covariance.
    """
    seen, given, name, unused = np.uint64(0), False, spare[0], spare[1]
    here[:] = 0
    while True:
        at = _skipped(data, at)
        if at < 0:
            return -1, k, False
        key, at = _keyword(data, at, known[0])
        if key == words.END_OBJECT:
            return _next_line(data, at), k, given
        if key == words.GROUP:
            begin, end, _, at = _value(data, at, known)
            if at < 0 or _known(data, begin, end, known[1]) != words.CONTROL_MEASURE or k >= measures[2].size:
                return -1, k, False
            at = _measure(data, at, known, k, measures, name, unused)
            if at < 0:
                return -1, k, False
            number = image_number(data, name[0], name[1], table, images)
            if number < 0:
                return -2, k, False
            measures[3][k] = number
            k += 1
            continue
        bit = np.uint64(1) << np.uint64(max(key, 0))
        if key < 0 or seen & bit or known[3][0, key] == words.UNKNOWN:
            return -1, k, False
        seen |= bit
        if known[3][0, key] == words.MATRIX:
            column = known[4][key]
            behind = _matrix(data, at, known, matrices[column])
            if behind >= 0:
                given |= column == 0
                at = behind
                continue
        begin, end, unit, at = _value(data, at, known)
        if at < 0 or not _point_value(data, key, begin, end, unit, i, known, points, here, in_km):
            return -1, k, False


@compiled
def _place(i, kind, here, in_km, places, places_in_km):
    """Keep the place of a point: the a-priori one, or for a free point the adjusted one; whether each is whole."""
    for stage in (0, 3):
        there = (here[stage, 1] > 0) + (here[stage + 1, 1] > 0) + (here[stage + 2, 1] > 0)
        if there != 0 and there != 3:
            return False
    first = 3 if kind == _FREE and here[0, 1] == 0 else 0
    for c in range(3):
        places[c, i, 0], places[c, i, 1] = here[first + c, 0], here[first + c, 1]
        places_in_km[c, i] = in_km[first + c]
    return True


@cached_kernel
def read_points(data, at, known, table, images, ids, kinds, ignored, places, in_km, matrices, of_matrix, first, spans,
                flags, image):  # fmt: skip
    """Read the points of a network, up to its end; numbers of points, of measures and of covariances, and the place
    behind. -1 points where something was not understood, -2 where the table of images was full.

    Parameters
    ----------
    data : (b,) uint8
        All of the file.
    at : int
        Where the first point begins.
    known : tuple
        `pvl_words.KNOWN`.
    table : (2^q,)
        -1 everywhere.
    images : (m + 1, 2)
        Of each distinct image where its name lies, filled here; their number in the last row, 0 at the beginning.
    ids : (n, 2)
        Where each point's id lies, filled here, as all that follow.
    kinds : (n,) int64
        PointKind.
    ignored : (n,) bool
    places : (3, n, 2)
        Where the coordinates of each point lie; 0, 0 for none.
    in_km : (3, n) bool
        Those in km; others are in m.
    matrices : (6, c, 2)
        Where the a-priori covariances of constrained points lie, in m^2: xx, xy, xz, yy, yz, zz.
    of_matrix : (c,)
        Their points.
    first : (n + 1,)
        Number of each point's first measure.
    spans : (4, k, 2)
        Where line, sample and their sigmas lie, in pixels; 0, 0 for none.
    flags : (k,) bool
        Measures that are ignored.
    image : (k,)
        Number of each measure's image.
    """
    i, k, c = 0, 0, 0
    points, measures = (ids, kinds, ignored), (first, spans, flags, image)
    here, km = np.zeros((6, 2), dtype=np.int64), np.zeros(6, dtype=np.bool_)
    spare, both = np.zeros((2, 2), dtype=np.int64), np.zeros((2, 6, 2), dtype=np.int64)
    while True:
        at = _skipped(data, at)
        if at < 0:
            return -1, 0, 0, 0
        key, at = _keyword(data, at, known[0])
        if key == words.END_OBJECT:
            first[i] = k
            return i, k, c, _next_line(data, at)
        begin, end, _, at = _value(data, at, known)
        if key != words.OBJECT or at < 0 or i >= kinds.size:
            return -1, 0, 0, 0
        if _known(data, begin, end, known[1]) != words.CONTROL_POINT:
            return -1, 0, 0, 0
        first[i], kinds[i], ignored[i], ids[i, 1] = k, -1, False, 0
        at, k, given = _point(data, at, known, i, k, points, here, km, both, measures, table, images, spare)
        if at < 0 or kinds[i] < 0 or ids[i, 1] == 0 or not _place(i, kinds[i], here, km, places, in_km):
            return min(at, -1), 0, 0, 0
        if not ignored[i] and measured_twice(first[i], k, flags, image):
            return -1, 0, 0, 0
        if given and kinds[i] == _CONSTRAINED and c < of_matrix.size:
            matrices[:, c], of_matrix[c] = both[0], i
            c += 1
        i += 1
