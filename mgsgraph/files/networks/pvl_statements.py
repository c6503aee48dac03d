"""Statements of control networks in PVL text, by compiled code: as ISIS writes them, ``keyword = word <unit>`` or a
string in one line, matrices over several, comments between statements. Places are numbers of bytes in the file.

Only what is wholly understood is taken: ASCII, known words (`networks.pvl_words`), numbers in decimal, which are looked
at here and left where they are, by the bytes where they begin and end.
"""

import numpy as np

from mgsgraph.compiled import compiled
from mgsgraph.files.networks import pvl_words as words

_TAB, _LINE, _BLANK, _QUOTE, _HASH, _APOSTROPHE, _OPEN, _CLOSE, _STAR = 9, 10, 32, 34, 35, 39, 40, 41, 42
_PLUS, _COMMA, _MINUS, _POINT, _SLASH, _BEGIN_UNIT, _EQUALS, _END_UNIT = 43, 44, 45, 46, 47, 60, 61, 62
_LONGEST = 32
"""Bytes of the longest word that is known."""
_MOST_DIGITS = 250
"""Of a number; with its exponent they are fewer than those of 1e290."""


@compiled
def behind_blanks(data, at):
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
def next_line(data, at):
    """Place of the next line, if nothing but blanks are left of this one; else -1."""
    at = _along(data, at)
    if at == data.size:
        return at
    return at + 1 if data[at] == _LINE else -1


@compiled
def _lower(byte):
    return byte + 32 if 65 <= byte <= 90 else byte


@compiled
def word_number(data, at, end, vocabulary):
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
def keyword_at(data, at, keys):
    """Number of the keyword at a place, -1 for an unknown one, and the place behind it and blanks in its line."""
    end = at
    while end < data.size:
        byte = data[end]
        if not (97 <= byte <= 122 or 65 <= byte <= 90 or byte == 95 or (48 <= byte <= 57 and end > at)):
            break
        end += 1
    return word_number(data, at, end, keys), _along(data, end)


@compiled
def value_at(data, at, known):
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
    return begin, end, unit, next_line(data, at) if at >= 0 else -1


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
    return (0 if end == begin else meaning_of(data, begin, end, words.UNIT, known)), end + 1


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
def keep_number(data, begin, end, span):
    """Keep where a number is, without a plus sign, which not all readers of numbers take; False for none."""
    if end <= begin or _number_end(data, begin, end) != end:
        return False
    span[0] = begin + (data[begin] == _PLUS)
    span[1] = end
    return True


@compiled
def keep_matrix(data, at, known, spans):
    """Keep where six numbers in brackets are, (6, 2); the next line, or -1 where there are no such."""
    if at >= data.size or data[at] != _EQUALS:
        return -1
    at = _along(data, at + 1)
    if at >= data.size or data[at] != _OPEN:
        return -1
    at += 1
    for k in range(6):
        at = _within(data, at)
        end = _number_end(data, at, data.size)
        if end < 0:
            return -1
        keep_number(data, at, end, spans[k])
        _, at = _unit(data, end, known)
        if at < 0:
            return -1
        at = _within(data, at)
        if at >= data.size or data[at] != (_COMMA if k < 5 else _CLOSE):
            return -1
        at += 1
    _, at = _unit(data, at, known)
    return next_line(data, at) if at >= 0 else -1


@compiled
def _within(data, at):
    """Place behind blanks and ends of lines."""
    while at < data.size and (data[at] == _BLANK or data[at] == _TAB or data[at] == _LINE):
        at += 1
    return at


@compiled
def meaning_of(data, begin, end, role, known):
    """What a word means in a role (`pvl_words.MEANINGS`); -1 for a word that is none of its."""
    word = word_number(data, begin, end, known[1])
    return known[2][role, word] if word >= 0 else -1


@compiled
def is_null(data, begin, end):
    """Whether a word is Null, in any case."""
    return (
        end - begin == 4 and (data[begin] | 32) == 110 and (data[begin + 1] | 32) == 117
        and (data[begin + 2] | 32) == 108 and (data[begin + 3] | 32) == 108
    )  # fmt: skip
