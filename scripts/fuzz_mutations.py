"""Damage to bytes and to text, by kinds that have names: what a disk, a network, an editor or an enemy does to a file.

Every change is drawn from a generator of random numbers alone: the same draw makes the same file again.
"""

import random
import re
import struct
from collections.abc import Callable, Sequence

Change = Callable[[bytearray, random.Random], str]
"""Changes content in its place, and says what it did in a word or two."""

NUMBERS = (
    b"NaN", b"nan", b"inf", b"-inf", b"Infinity", b"1e308", b"-1e308", b"1e400", b"5e-324", b"-1", b"0", b"-0.0",
    b"", b"1e3",
    b"9" * 400, b"7" * 5000, b"0." + b"3" * 400, b"0x10", b"1_000", "١٢".encode(), b"1,5", b"true", b"null", b"Null",
    b'"1"',
    b"[]", b"{}", b"2147483648", b"4294967296", b"-2147483649", b"9223372036854775808", b"1e19", b"99999999999",
    b"0.1", b"1",
    b"-1.7976931348623157e308", b"1d5", b"1e", b"++1", b"1 km",
)  # fmt: skip
"""What may stand in a number's place."""
NAMES = (
    b"", b"..", b"../../../../etc/passwd", b"/dev/zero", b"/etc/passwd", b"/", b".", b"a" * 300, b"a\0b",
    b"\xff\xfe", b"\x1b[31m",
    "\u202e".encode(), "\ud800".encode("utf-8", "surrogatepass"), b"<script>", b"None", b"%s%n", b"/vsizip/x.zip/y",
    b"Moon", b"Mars",
    b"' OR 1=1", b"\\", b"\n", b"#", b"a b", b"a=b", b"2#1111#", b'"', b"{", b"(", b"=", b"NULL",
)  # fmt: skip
"""What may stand in a name's place."""
CHARACTERS = (b"\0", b"\x07", b"\x1b[2J", b"\x7f", b"\x85", "\u2028".encode(), "\u202e".encode(), b"\xff", b"\xc3",
b"\xed\xa0\x80", b"\t",
              b"\r", b"\n", b"\f", b"\xa0", "\ufeff".encode(), b"\x1a")  # fmt: skip
"""Control characters, marks of direction, and what is no UTF-8."""
WORDS = (b"\xff\xff\xff\x7f", b"\xff\xff\xff\xff", b"\0\0\0\0", b"\xff" * 9 + b"\x01", b"\0\0\0\x80",
b"\x7f\xff\xff\xff",
         b"\0\0\0\0\0\0\xf8\x7f", b"\x7f\xf8\0\0\0\0\0\0", b"\0\0\0\0\0\0\xf0\x7f", b"\xff" * 8,
         b"\x40\x59\0\0\0\0\0\0",
         b"99999999999", b"1e308", b"nan", b"-1")  # fmt: skip
"""Sizes and numbers that are believed at one's peril, in binary."""
_TOKEN = re.compile(rb'"[^"\n]{0,200}"|[-+]?\d[\d.]*(?:[eE][-+]?\d+)?|[A-Za-z_^][\w.:/^-]*|[^\s\w]')
NUMBER = re.compile(rb"[-+]?\d[\d.]*(?:[eE][-+]?\d+)?")
_DEEP = (b"[", b"{", b"(", b'{"a":', b'[{"a":', b"Object = a\n", b"Group = a\n", b"((", b"-", b"{a=", b'"')
_DEPTHS = (101, 1200, 1200, 20_000)

# --- bytes


def _place(data: bytearray, rng: random.Random) -> int:
    """A place in the content; half of them in its first 4 kB, where headers are, and a quarter in its last."""
    part, size = rng.random(), len(data)
    return max(size - 4096, 0) * (part >= 0.75) + rng.randrange(min(size, size if 0.5 <= part < 0.75 else 4096) or 1)


def flip(data: bytearray, rng: random.Random) -> str:
    for _ in range(rng.choice((1, 1, 1, 2, 8))):
        if data:
            data[_place(data, rng)] ^= 1 << rng.randrange(8)
    return "bits flipped"


def overwrite(data: bytearray, rng: random.Random) -> str:
    place = _place(data, rng)
    data[place : place + 1] = bytes([rng.randrange(256)])
    return "a byte overwritten"


def cut_out(data: bytearray, rng: random.Random) -> str:
    place = _place(data, rng)
    del data[place : place + rng.choice((1, 2, 4, 8, 40, 512))]
    return "bytes cut out"


def insert(data: bytearray, rng: random.Random) -> str:
    place = _place(data, rng)
    data[place:place] = rng.randbytes(rng.choice((1, 2, 4, 8, 40)))
    return "bytes put in"


def repeat(data: bytearray, rng: random.Random) -> str:
    place = _place(data, rng)
    piece = data[place : place + rng.choice((1, 8, 40, 200, 1000))]
    data[place:place] = piece * rng.choice((1, 1, 2, 100))
    return "a piece repeated"


def huge(data: bytearray, rng: random.Random) -> str:
    place, word = _place(data, rng), rng.choice(WORDS)
    data[place : place + len(word)] = word
    return "a huge number"


def blank(data: bytearray, rng: random.Random) -> str:
    place, long = _place(data, rng), rng.choice((4, 16, 200, 4096))
    long = min(long, len(data) - place)
    data[place : place + long] = rng.choice((b"\0", b"\xff", b" ")) * long
    return "a stretch blanked"


def cut_short(data: bytearray, rng: random.Random) -> str:
    del data[rng.randrange(len(data) + 1) if rng.random() < 0.9 else 0 :]
    return "cut short"


def lengthen(data: bytearray, rng: random.Random) -> str:
    data += rng.choice((rng.randbytes(16), b"\0" * 5000, b"\n" * 3, bytes(data[: 1 << 12])))
    return "lengthened"


BYTES: tuple[Change, ...] = (flip, flip, overwrite, cut_out, insert, repeat, huge, blank, cut_short, lengthen)

# --- text


def _tokens(data: bytearray, rng: random.Random, only: re.Pattern[bytes] = _TOKEN) -> list[tuple[int, int]]:
    """Where tokens lie in a window of some kB about a random place."""
    start = rng.randrange(max(len(data) - 3000, 0) + 1) if rng.random() < 0.7 else 0
    return [found.span() for found in only.finditer(data, start, start + 4000)]


def number(data: bytearray, rng: random.Random) -> str:
    if spans := _tokens(data, rng, NUMBER):
        begin, end = rng.choice(spans)
        data[begin:end] = rng.choice(NUMBERS)
    return "an odd number"


def name(data: bytearray, rng: random.Random) -> str:
    if spans := _tokens(data, rng):
        begin, end = rng.choice(spans)
        odd = rng.choice(NAMES)
        if data[begin : begin + 1] == b'"' and rng.random() < 0.8:
            begin, end = begin + 1, end - 1
        data[begin:end] = odd
    return "an odd name"


def scale(data: bytearray, rng: random.Random) -> str:
    """Another unit: one number, or the numbers of one key or column, times 1e3 or 1e-3; or another sign."""
    if not (spans := _tokens(data, rng, NUMBER)):
        return "another unit"
    times, many = rng.choice((1e3, 1e-3, 1e6, -1.0, 57.29577951308232, 1.001)), rng.random() < 0.5
    chosen = [rng.choice(spans)]
    if many:
        key = bytes(data[max(data.rfind(b"\n", 0, chosen[0][0]), chosen[0][0] - 40) + 1 : chosen[0][0]]).strip()
        if len(key) > 3 and not key.isdigit():
            pattern = re.compile(re.escape(key) + rb"\s*(" + NUMBER.pattern + rb")")
            chosen = [found.span(1) for found in pattern.finditer(data)] or chosen
    for begin, end in reversed(chosen):
        try:
            data[begin:end] = repr(float(data[begin:end]) * times).encode()
        except ValueError:
            continue
    return "another unit" if times != 1.001 else "another value"


def swap(data: bytearray, rng: random.Random) -> str:
    spans = _tokens(data, rng)
    if len(spans) > 1:
        (a, b), (c, d) = sorted(rng.sample(spans, 2))
        data[a:d] = data[c:d] + data[b:c] + data[a:b]
    return "tokens swapped"


def drop(data: bytearray, rng: random.Random) -> str:
    if spans := _tokens(data, rng):
        begin, end = rng.choice(spans)
        del data[begin:end]
    return "a token left out"


def borrow(data: bytearray, rng: random.Random) -> str:
    spans = _tokens(data, rng)
    if len(spans) > 1:
        (a, b), (c, d) = rng.sample(spans, 2)
        data[a:b] = data[c:d]
    return "a token copied over another"


def line(data: bytearray, rng: random.Random) -> str:
    """A line twice, elsewhere, or not at all."""
    lines = bytes(data).split(b"\n")
    k, kind = rng.randrange(len(lines)), rng.randrange(3)
    if kind == 0:
        lines[k:k] = [lines[k]] * rng.choice((1, 1, 2, 300))
    elif kind == 1:
        lines.insert(rng.randrange(len(lines)), lines.pop(k))
    else:
        del lines[k]
    data[:] = b"\n".join(lines)
    return ("a line twice", "a line elsewhere", "a line left out")[kind]


def deep(data: bytearray, rng: random.Random) -> str:
    spans = _tokens(data, rng)
    begin, end = rng.choice(spans) if spans else (0, 0)
    many = rng.choice(_DEPTHS)
    data[begin:end] = rng.choice(_DEEP) * many
    return "nested deeply"


def dotted(data: bytearray, rng: random.Random) -> str:
    place = data.find(b"\n", _place(data, rng)) + 1
    data[place:place] = rng.choice(
        (b"a." * 20_000 + b"b = 1\n", b"a." * 25 + b"b = 1\n", b"[" + b"a." * 3000 + b"b]\n", b"a.b = 1\na = 2\n")
    )
    return "dotted keys"


def long_line(data: bytearray, rng: random.Random) -> str:
    spans = _tokens(data, rng)
    begin, end = rng.choice(spans) if spans else (0, 0)
    data[begin:end] = rng.choice((b"a", b"1", b" ", b",", b"1 ", b"a,", b'""', b"a = ")) * rng.choice(
        (300, 5000, 50_000)
    )
    return "a long line"


def character(data: bytearray, rng: random.Random) -> str:
    place = _place(data, rng)
    data[place:place] = rng.choice(CHARACTERS)
    return "an odd character"


def newlines(data: bytearray, rng: random.Random) -> str:
    whole = bytes(data).replace(b"\r\n", b"\n")
    data[:] = rng.choice(
        (
            whole.replace(b"\n", b"\r\n"),
            whole.replace(b"\n", b"\r"),
            whole.replace(b"\n", b""),
            whole.replace(b"\n", b"\n\n"),
        )
    )
    return "other ends of lines"


def encoding(data: bytearray, rng: random.Random) -> str:
    text = bytes(data).decode("latin-1")
    data[:] = text.encode(rng.choice(("utf-16", "utf-8-sig", "utf-16-le", "utf-32", "utf-7", "cp037")), "replace")
    return "another encoding"


def case(data: bytearray, rng: random.Random) -> str:
    if spans := _tokens(data, rng):
        begin, end = rng.choice(spans)
        data[begin:end] = data[begin:end].swapcase()
    return "other case"


TEXT: tuple[Change, ...] = (
    number, number, number, name, scale, scale, swap, drop, borrow, line, line, deep, long_line, character, newlines,
    case, encoding,
)  # fmt: skip
DOTTED: tuple[Change, ...] = (dotted,)
_RARE = (deep, dotted, long_line, encoding, newlines)


_UNFIT = (LookupError, struct.error, ValueError, TypeError, ArithmeticError, BufferError, MemoryError)
"""What a change raises of content that it can't change."""


def mutated(data: bytes, changes: Sequence[Change], rng: random.Random) -> tuple[bytes, str]:
    """The content with one change, seldom up to four, and what was done; three of ten are of bytes whatever it is."""
    content = bytearray(data)
    kinds = list[str]()
    for _ in range(rng.choice((1, 1, 1, 1, 2, 4))):
        of_bytes = rng.random() < 0.3 and len(changes) > 1
        change = rng.choice(BYTES) if of_bytes else rng.choice(changes)
        if change in _RARE and rng.random() < 0.5:
            change = rng.choice(changes)
        try:
            kinds.append(change(content, rng))
        except _UNFIT:  # of content that an earlier change left too short, or with numbers of another kind
            kinds.append(flip(content, rng))
    return bytes(content), ", ".join(dict.fromkeys(kinds))
