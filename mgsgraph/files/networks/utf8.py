"""Whether bytes are UTF-8, by compiled code: exactly what Python's strict decoder takes.

Source: The Unicode Standard 15.0, table 3-7, well-formed UTF-8 byte sequences.
"""

from mgsgraph.compiled import compiled


@compiled
def is_utf8(data, at, end):
    """Whether the bytes at..end of data (b,) uint8 are UTF-8."""
    plain = True
    for k in range(at, end):
        plain &= data[k] <= 127
    if plain:
        return True
    while at < end:
        size = _size(data[at])
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
def _size(first):
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
