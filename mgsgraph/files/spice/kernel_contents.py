"""What SPICE kernels hold: files that a meta-kernel names, covered intervals, records of a CK; and what SPICE says."""

import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import spiceypy
from spiceypy.utils.exceptions import NotFoundError, SpiceyError

from mgsgraph.errors import InputError
from mgsgraph.files.opening import ANY_SIZE, LARGEST_TEXT, opened, read_bytes
from mgsgraph.geometry.records import Array

_CK_CLASS, _DEEPEST = 3, 5
"""SPICE's class of frames that a CK orients, and how many of them one on another are followed."""
_RECORD, _WORD = 1024, 8
"""bytes of a binary kernel."""
_SHOWN = 4
"""Covered intervals that a message lists."""


@contextmanager
def spice_words(where: str, remedy: str = "") -> Iterator[None]:
    """Turn an error of SPICE inside into an InputError of one line."""
    try:
        yield
    except SpiceyError as error:
        said = " ".join(str(getattr(error, "long", "") or error).split())
        short = getattr(error, "short", "")
        raise InputError(where, f"SPICE says: {said} {short}".rstrip(), remedy=remedy) from None


# --- files


def members(path: Path, home: Path = Path()) -> list[Path]:
    """The file itself, or the files that a meta-kernel names, from a folder or beside it; all are there and kernels."""
    if b"KERNELS_TO_LOAD" not in _text_of(path):
        return [path]
    with spice_words(str(path)):
        spiceypy.ldpool(str(path))  # its variables only: SPICE itself would stop at the first file it doesn't find
    names = _strings("KERNELS_TO_LOAD")
    symbols = dict(zip(_strings("PATH_SYMBOLS"), _strings("PATH_VALUES"), strict=False))
    for variable in ("KERNELS_TO_LOAD", "PATH_SYMBOLS", "PATH_VALUES"):
        spiceypy.dvpool(variable)
    files = []
    for name in names:
        full = name
        for symbol in sorted(symbols, key=len, reverse=True):
            full = full.replace(f"${symbol}", symbols[symbol])
        found = [place for place in (home / full, path.parent / full) if place.is_file()]
        if not found:
            raise InputError(
                str(path), f"the kernel {name!r} that it names is not there",
                f"it as {(home / full).absolute()} or beside the meta-kernel",
                "fetch it, or mend PATH_VALUES or KERNELS_TO_LOAD",
            )
        if b"KERNELS_TO_LOAD" in _text_of(found[0]):
            raise InputError(str(path), f"the meta-kernel {name!r} among its kernels", "no other meta-kernel in one")
        files.append(found[0])
    return files


def require_whole(path: Path) -> None:
    """Raise InputError for what is no file, and for a double precision array file (SPK, CK, binary PCK) that ends
    before the last word that its file record counts (NAIF, DAF required reading): SPICE trusts it.
    """
    with opened(path, ANY_SIZE) as file:
        record, size = file.read(_RECORD), os.fstat(file.fileno()).st_size
    if record.startswith((b"DAF/", b"NAIF/DAF")):
        order = ">" if record[88:96] == b"BIG-IEEE" else "<"
        needed = max(_RECORD, _WORD * (struct.unpack_from(f"{order}i", record.ljust(_RECORD), 84)[0] - 1))
        if size < needed:
            remedy = "it is cut short or damaged: fetch it again"
            raise InputError(str(path), f"{size} bytes", f"{needed} at least by its own header", remedy)


def _strings(variable: str) -> list[str]:
    """Texts of a pool variable, those joined that '+' carries over; empty when there is no such variable."""
    texts: list[str] = []
    while True:
        try:
            texts.append(spiceypy.stpool(variable, len(texts), "+", 1024)[0])
        except NotFoundError:
            return texts


def _text_of(path: Path) -> bytes:
    """What a text kernel says; nothing of a binary one. InputError unless it is one of both: SPICE takes any file for a
    text kernel.
    """
    require_whole(path)
    with spice_words(str(path)):
        kind, _ = spiceypy.getfat(str(path))
    if kind == "XFR":
        raise InputError(str(path), "a transfer file", "a binary kernel", "convert it with NAIF's tobin")
    if kind in ("DAF", "DAS"):
        return b""
    text = read_bytes(path, LARGEST_TEXT)
    if b"\\begindata" not in text:
        raise InputError(str(path), "no SPICE kernel", "a binary kernel, or a text kernel with \\begindata")
    return text


# --- what kernels cover


class Cover(NamedTuple):
    """What kernels cover."""

    what: str
    """Of what, for messages."""
    intervals: list[tuple[float, float]]
    """s TDB past J2000, increasing."""
    ids: list[int]
    """NAIF ids that the kernels hold."""
    kind: str
    """SPK or CK."""


def _files(kind: str) -> list[str]:
    return [spiceypy.kdata(k, kind, 1024)[0] for k in range(spiceypy.ktotal(kind))]


def spk_cover(spacecraft: int) -> Cover:
    """When the loaded SPK know where a spacecraft is."""
    window, ids = spiceypy.cell_double(200_000), set[int]()
    with spice_words(f"coverage of {spacecraft}"):
        for file in _files("SPK"):
            ids |= set(spiceypy.spkobj(file))
            spiceypy.spkcov(file, spacecraft, window)
    return Cover(f"positions of {spacecraft}", _intervals(window), sorted(ids), "SPK")


def ck_cover(frame_id: int) -> Cover:
    """When the loaded CK know how a spacecraft's structure stands."""
    window, ids = spiceypy.cell_double(200_000), set[int]()
    with spice_words(f"coverage of {frame_id}", "load the SCLK kernel and a leapseconds kernel"):
        for file in _files("CK"):
            ids |= set(spiceypy.ckobj(file))
            spiceypy.ckcov(file, frame_id, False, "INTERVAL", 0.0, "TDB", window)
    return Cover(f"attitude of {frame_id}", _intervals(window), sorted(ids), "CK")


def _intervals(window: Any) -> list[tuple[float, float]]:
    return [spiceypy.wnfetd(window, k) for k in range(spiceypy.wncard(window))]


def covered_interval(cover: Cover, start: float, stop: float) -> tuple[float, float]:
    """The interval that holds start .. stop; InputError with all that are covered when none does."""
    for first, last in cover.intervals:
        if first <= start and stop <= last:
            return first, last
    asked = f"nothing for all of {_span(start, stop)}"
    if cover.intervals:
        nearest = sorted(cover.intervals, key=lambda one: max(one[0] - start, stop - one[1]))[:_SHOWN]
        more = f" and {len(cover.intervals) - _SHOWN} more" if len(cover.intervals) > _SHOWN else ""
        expected = "a time within " + ", ".join(_span(*one) for one in sorted(nearest)) + more
    elif cover.ids:
        expected = f"an id out of those in the kernels: {', '.join(map(str, cover.ids))}"
    else:
        expected = f"at least one {cover.kind}"
    raise InputError(cover.what, asked, expected, f"load the {cover.kind} of this time")


def _span(start: float, stop: float) -> str:
    """An interval in ET and, where a leapseconds kernel is loaded, in UTC."""
    span = f"ET {start:.3f} .. {stop:.3f} s"
    try:
        return f"{spiceypy.et2utc(start, 'ISOC', 3)} .. {spiceypy.et2utc(stop, 'ISOC', 3)} UTC ({span})"
    except SpiceyError:
        return span


def ck_frames(frame_id: int) -> list[int]:
    """The frame, and those that the loaded CK have it relative to, each a CK's own, down to one that is not."""
    frames = [frame_id]
    while len(frames) < _DEEPEST:
        below = {spiceypy.frinfo(one)[1:] for one in _references(frames[-1])}
        turned = sorted(class_id for kind, class_id in below if kind == _CK_CLASS and class_id not in frames)
        if not turned:
            break
        frames.append(turned[0])
    return frames


def _references(frame_id: int) -> set[int]:
    """Frames that segments of a CK frame are relative to."""
    return {int(codes[1]) for _, _, codes in _segments() if codes[0] == frame_id}


def _segments() -> Iterator[tuple[int, Array, tuple[int, ...]]]:
    """Handle, summary and integers (frame, reference, type ...) of each segment of the loaded CK."""
    for file in _files("CK"):
        handle = spiceypy.dafopr(file)
        try:
            spiceypy.dafbfs(handle)
            while spiceypy.daffna():
                summary = spiceypy.dafgs(5)
                yield handle, summary, tuple(int(one) for one in spiceypy.dafus(summary, 2, 6)[1])
        finally:
            spiceypy.dafcls(handle)


def ck_records(frame_id: int, spacecraft: int, start: float, stop: float) -> Array:
    """Times (n,) in s TDB past J2000 of the records of type 3 segments between start and stop."""
    times: list[float] = []
    ticks = [spiceypy.sce2c(spacecraft, time) for time in (start, stop)]
    for handle, summary, (frame, _, kind, *_) in _segments():
        if frame == frame_id and kind == 3:
            times += _type_3_records(handle, summary, *ticks)
    return np.unique([spiceypy.sct2e(spacecraft, tick) for tick in times])


def _type_3_records(handle: int, summary: Array, start: float, stop: float) -> list[float]:
    """Encoded clock of the records of one segment that lie between two."""
    count = int(spiceypy.cknr03(handle, summary))

    def clock(k: int) -> float:
        return float(spiceypy.ckgr03(handle, summary, k + 1)[0])

    low, high = 0, count
    while low < high:  # the first record after start
        middle = (low + high) // 2
        low, high = (middle + 1, high) if clock(middle) <= start else (low, middle)
    times = []
    while low < count and (time := clock(low)) < stop:
        times.append(time)
        low += 1
    return times
