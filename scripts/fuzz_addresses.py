"""Damage to binary files by their addresses, tags and lengths: SPICE kernels, TIFF, PNG, protobuf messages."""

import random
import struct
import zlib
from functools import lru_cache

import numpy as np
from fuzz_mutations import WORDS, flip
from fuzz_structures import ODD_FLOATS, TIMES


def daf(data: bytearray, rng: random.Random) -> str:
    """Of a SPICE kernel: its file record, a summary record, a summary, or the numbers of a segment (NAIF, DAF required
    reading).
    """
    order = "<" if data[88:96] != b"BIG-IEEE" else ">"
    doubles, integers = struct.unpack_from(f"{order}2i", data, 8)
    first = struct.unpack_from(f"{order}i", data, 76)[0]
    kind, begin = rng.randrange(5), 1024 * (first - 1)
    if not 0 <= begin <= len(data) - 1024 or not (0 <= doubles < 100 and 0 <= integers < 100):
        return flip(data, rng)
    if kind == 0:
        struct.pack_into(
            f"{order}i",
            data,
            rng.choice((8, 12, 76, 80, 84)),
            rng.choice((0, 1, -1, 2, 3, 4, 127, 10**6, 2**31 - 1, -(2**31))),
        )
        return "the file record"
    if kind == 1:
        struct.pack_into(
            f"{order}d",
            data,
            begin + 8 * rng.randrange(3),
            rng.choice((0.0, -1.0, float(first), 2.0, 25.0, 1e9, 1e300, np.nan, 0.5, 126.0)),
        )
        return "a summary record"
    count = struct.unpack_from(f"{order}d", data, begin + 16)[0]
    if not 1.0 <= count < 26.0:
        return flip(data, rng)
    size = 8 * (doubles + (integers + 1) // 2)
    summary = begin + 24 + size * rng.randrange(int(count))
    if kind == 2:
        struct.pack_into(f"{order}d", data, summary + 8 * rng.randrange(max(doubles, 1)), rng.choice(ODD_FLOATS))
        return "times of a segment"
    place = summary + 8 * doubles + 4 * rng.randrange(max(integers, 1))
    if kind == 3 and place <= len(data) - 4:
        old = struct.unpack_from(f"{order}i", data, place)[0]
        new = rng.choice((0, 1, -1, old + 1, old - 1, 2 * old, 10**6, 2**31 - 1, -(2**31), 13, 3, 2))
        struct.pack_into(f"{order}i", data, place, max(min(new, 2**31 - 1), -(2**31)))
        return "addresses or types of a segment"
    end = struct.unpack_from(f"{order}i", data, summary + 8 * doubles + 4 * (integers - 1))[0]
    last = 8 * end - 8 * rng.choice((1, 1, 2, 3, 4, rng.randrange(1, 200)))
    if 0 <= last <= len(data) - 8:
        old = struct.unpack_from(f"{order}d", data, last)[0]
        struct.pack_into(f"{order}d", data, last, rng.choice((*ODD_FLOATS, 7.0, old * 1e3, old * 1e-3, 1e6, -2.0, 1e9)))
    return "numbers of a segment"


def tiff(data: bytearray, rng: random.Random) -> str:
    """A tag of a TIFF's first directory: its number, type, count or value; or where the directory is."""
    if data[:2] not in (b"II", b"MM"):
        return flip(data, rng)
    order = "<" if data[:2] == b"II" else ">"
    begin = struct.unpack_from(f"{order}I", data, 4)[0]
    if not 8 <= begin <= len(data) - 2 or rng.random() < 0.03:
        struct.pack_into(f"{order}I", data, 4, rng.choice((0, 8, len(data), len(data) - 2, 2**32 - 1, 4)))
        return "the place of the directory"
    count = struct.unpack_from(f"{order}H", data, begin)[0]
    entry = begin + 2 + 12 * rng.randrange(max(count, 1))
    if entry > len(data) - 12:
        return flip(data, rng)
    kind = rng.randrange(5)
    if kind == 0:
        struct.pack_into(
            f"{order}H",
            data,
            entry,
            rng.choice(
                (
                    256,
                    257,
                    258,
                    259,
                    262,
                    273,
                    277,
                    278,
                    279,
                    284,
                    317,
                    322,
                    339,
                    33550,
                    34735,
                    42113,
                    rng.randrange(65536),
                )
            ),
        )
    elif kind == 1:
        struct.pack_into(f"{order}H", data, entry + 2, rng.randrange(0, 20))
    elif kind == 2:
        struct.pack_into(f"{order}I", data, entry + 4, rng.choice((0, 1, 2, 3, 65536, 2**31, 2**32 - 1, 10**6)))
    else:
        old = struct.unpack_from(f"{order}I", data, entry + 8)[0]
        new = rng.choice((0, 1, old + 1, 2 * old, old // 2, 1000, 30_000, 65535, 10**6, 2**31, 2**32 - 1))
        struct.pack_into(f"{order}I", data, entry + 8, new & 0xFFFFFFFF)
    return (
        "another tag",
        "another type of a tag",
        "another count of a tag",
        "another value of a tag",
        "another value of a tag",
    )[kind]


def png(data: bytearray, rng: random.Random) -> str:
    """The size, depth or colour of a PNG, its checksum right."""
    kind = rng.randrange(3)
    if kind == 0:
        struct.pack_into(
            ">I", data, 16 + 4 * rng.randrange(2), rng.choice((0, 1, 10, 40, 30_000, 65_000, 2**31 - 1, 2**32 - 1))
        )
    elif kind == 1:
        data[24 + rng.randrange(5)] = rng.choice((0, 1, 2, 3, 4, 6, 8, 16, 255))
    else:
        return flip(data, rng)
    struct.pack_into(">I", data, 29, zlib.crc32(data[12:29]))
    return "the head of a PNG"


@lru_cache(maxsize=8)
def _wire(data: bytes, start: int) -> tuple[tuple[int, int, int], ...]:
    """(offset, wire type, size) of the fields that protobuf's format shows from a byte on, inner messages' too."""
    found = list[tuple[int, int, int]]()

    def varint(at: int) -> tuple[int, int]:
        value = shift = 0
        while True:
            value |= (data[at] & 0x7F) << shift
            shift, at = shift + 7, at + 1
            if data[at - 1] < 128 or shift > 63:
                return value, at

    def walk(at: int, stop: int, depth: int) -> bool:
        fields = list[tuple[int, int, int]]()
        mark = len(found)
        while at < stop:
            try:
                key, value = varint(at)
                size = (0, 8, 0, 0, 0, 4)[key & 7] if key & 7 < 6 else -1
                if not key >> 3 or size < 0 or key & 7 in (3, 4):
                    break
                fields.append((at, 0, value - at))
                after = value
                if key & 7 == 0:
                    _, after = varint(value)
                    fields.append((value, 0, after - value))
                elif key & 7 == 2:
                    length, after = varint(value)
                    fields.append((value, 2, after - value))
                    if after + length > stop:
                        break
                    if length > 3 and depth < 6:
                        walk(after, after + length, depth + 1)
                    after += length
                else:
                    fields.append((value, key & 7, size))
                    after += size
            except IndexError:
                break
            at = after
        if at == stop:
            found.extend(fields)
            return True
        del found[mark:]
        return False

    at = start
    while at < len(data) - 4:  # a header, and then messages behind their sizes
        size = int.from_bytes(data[at : at + 4], "little")
        if 0 < size <= len(data) - at - 4 and walk(at + 4, at + 4 + size, 0):
            found.append((at, 5, 4))
            at += 4 + size
            continue
        ends = [stop for stop in range(at + 8, min(at + 300, len(data)) + 1) if walk(at, stop, 0)]
        if not ends:
            walk(at, len(data), 0)
            break
        at = ends[-1]
    return tuple(found)


def wire(data: bytearray, rng: random.Random) -> str:
    """A number, length or key of a message by protobuf's wire format, at the same size."""
    found = _wire(bytes(data), 65536) if len(data) > 65536 else ()
    if not found:
        return flip(data, rng)
    at, kind, size = rng.choice(found)
    if kind == 1:
        data[at : at + 8] = struct.pack(
            "<d",
            rng.choice(ODD_FLOATS) if rng.random() < 0.6 else struct.unpack_from("<d", data, at)[0] * rng.choice(TIMES),
        )
    elif kind == 5:
        data[at : at + 4] = struct.pack("<I", rng.choice((0, 1, 5, 2**31, 2**32 - 1, len(data))))
    elif rng.random() < 0.8:
        data[at] = data[at] & 0x80 | rng.choice((0, 1, 2, 3, 5, 0x7F, rng.randrange(128)))
    else:
        data[at : at + size] = rng.choice(WORDS)
    return "a field of a message"
