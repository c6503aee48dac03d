"""Tiles of pictures: grey values of any image that the program reads, at full resolution and halved again and again.

Level 0 has the pixels themselves; a pixel of level n is the mean of 2^n lines and samples. Coarse levels of a picture
are made once, in one pass, and kept; of a large picture fine ones are read from its file where they are looked at.
"""

import os
import threading
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError
from mgsgraph.files.opening import ANY_SIZE, opened
from mgsgraph.files.rasters.pictures import picture_size, read_picture, read_picture_part

SIDE = 256
"""Lines and samples of a tile."""
_KEPT = 1 << 24
"""Pixels of the finest level that is kept in memory."""
_MOST_KEPT = 1 << 29
"""bytes of levels of all pictures that are kept."""
_MOST_ENCODED = 1 << 26
"""bytes of finished tiles that are kept."""
_QUANTILES = (0.005, 0.995)
"""Grey values below and above are black and white at first: dead pixels and cosmic rays don't set the contrast."""
_SAMPLED = 1 << 18
"""Pixels of which these are taken."""
_BARS = 64
"""Of the histogram."""

Grey = NDArray[Any]
"""(lines, samples) of a picture: unsigned bytes, or float32 with NaN where there is no pixel."""


class Stamp(NamedTuple):
    """State of a file, by which one sees that it was replaced."""

    size: int
    """bytes."""
    modified: int
    """ns, of its last change."""

    @classmethod
    def of(cls, path: Path) -> "Stamp":
        """That of a file now; InputError where there is none, or none that may be read."""
        with opened(path, ANY_SIZE) as file:
            found = os.fstat(file.fileno())
        return cls(found.st_size, found.st_mtime_ns)


@dataclass(frozen=True, slots=True, eq=False)
class Pyramid:
    """Grey values of a picture, from its finest level in memory on."""

    path: Path
    """File of the pixels."""
    stamp: Stamp
    """Its state when it was read."""
    lines: int
    """Of the picture."""
    samples: int
    """Of the picture."""
    first: int
    """Level of the finest one in memory; finer ones are read from the file."""
    kept: tuple[Grey, ...]
    """Levels from `first` on; the last one fits in one tile."""
    low: float
    """Grey value that is black at first."""
    high: float
    """Grey value that is white at first, above `low`."""
    edges: tuple[float, float]
    """Ends of the histogram: least and largest grey value."""
    counts: NDArray[np.int64]
    """(64,) pixels in each of its equal bars; of some pixels, evenly spread."""

    @property
    def levels(self) -> int:
        """Number of levels."""
        return self.first + len(self.kept)

    @property
    def size(self) -> int:
        """Of these, in bytes."""
        return sum(one.nbytes for one in self.kept)

    def shape(self, level: int) -> tuple[int, int]:
        """Lines and samples of a level."""
        return -(-self.lines >> level), -(-self.samples >> level)

    def part(self, level: int, row: int, column: int) -> Grey:
        """Grey values of a tile, less than 256 x 256 at the picture's lower and right edge.

        Raises
        ------
        InputError
            No such tile; a file that is gone, or has changed since.
        """
        lines, samples = self.shape(level) if 0 <= level < self.levels else (0, 0)
        top, left = row * SIDE, column * SIDE
        if not (0 <= top < lines and 0 <= left < samples):
            found = f"tile {row}, {column} of level {level}"
            raise InputError(str(self.path), found, f"one of {self.levels} levels from {self.lines} x {self.samples}")
        if level >= self.first:
            return self.kept[level - self.first][top : top + SIDE, left : left + SIDE]
        step = 1 << level
        return _reduced(self.path, (self.lines, self.samples), (top * step, left * step), SIDE * step, level)

    def window(
        self, level: int, lines: tuple[float, float], samples: tuple[float, float]
    ) -> tuple[Grey, tuple[float, float, float, float]]:
        """Grey values of a level between lines and samples (px of the picture), rounded outward to its pixels, and the
        extent of these: left, right, bottom, top in px of the picture.
        """
        step, (down, across) = 1 << level, self.shape(level)
        top, bottom = max(0, int(lines[0] // step)), min(down, -int(-lines[1] // step))
        left, right = max(0, int(samples[0] // step)), min(across, -int(-samples[1] // step))
        if level >= self.first:
            grey = self.kept[level - self.first][top:bottom, left:right]
        else:
            side = (bottom - top) * step, (right - left) * step
            grey = _reduced(self.path, (self.lines, self.samples), (top * step, left * step), side, level)
        return grey, (left * step, min(right * step, self.samples), min(bottom * step, self.lines), top * step)

    def require_unchanged(self) -> None:
        """Raise InputError where the file is gone or has been replaced."""
        if Stamp.of(self.path) != self.stamp:
            raise InputError(
                str(self.path), "it has changed since its picture was opened", "the same file",
                "open the image again, or reload the page",
            )


def open_picture(path: Path, lines: int, samples: int) -> Pyramid:
    """Read the coarse levels of an image's picture; of one up to 16 million pixels all of them.

    Parameters
    ----------
    path : Path
        As for `read_picture`.
    lines, samples : int
        Of the image whose pixels they are.

    Raises
    ------
    InputError
        A picture that is missing or can't be read, or of another size than the image.
    """
    stamp = Stamp.of(path)
    found = picture_size(path)
    if found != (lines, samples):
        remedy = "name the image's own, uncropped file in the case"
        raise InputError(str(path), f"{found[0]} x {found[1]} pixels", f"the image's {lines} x {samples}", remedy)
    first = 0
    while (-(-lines >> first)) * (-(-samples >> first)) > _KEPT:
        first += 1
    levels = [_float(read_picture(path)) if first == 0 else _overview(path, lines, samples, first)]
    while max(levels[-1].shape) > SIDE:
        levels.append(halved(levels[-1]))
    low, high, edges, counts = _contrast(levels[0])
    return Pyramid(path, stamp, lines, samples, first, tuple(levels), low, high, edges, counts)


def halved(grey: Grey) -> Grey:
    """Means of 2 x 2 pixels, at odd edges of those that are there; of those that are known, where some are not."""
    down, across = (-(-n // 2) for n in grey.shape)
    if grey.dtype == np.uint8:
        whole = np.pad(grey, ((0, 2 * down - grey.shape[0]), (0, 2 * across - grey.shape[1])), mode="edge")
        total = np.zeros((down, across), dtype=np.uint16)
        for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
            total += whole[i::2, j::2]
        return ((total + 2) >> 2).astype(np.uint8)
    total, known = np.zeros((down, across), dtype=np.float32), np.zeros((down, across), dtype=np.uint8)
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        part = grey[i::2, j::2]
        there = np.isfinite(part)
        total[: part.shape[0], : part.shape[1]] += np.where(there, part, 0.0)
        known[: part.shape[0], : part.shape[1]] += there
    return np.where(known > 0, total / np.maximum(known, 1), np.float32(np.nan)).astype(np.float32)


def _overview(path: Path, lines: int, samples: int, level: int) -> Grey:
    """A whole level of a large picture, strip by strip."""
    step = SIDE << level
    strips = [_reduced(path, (lines, samples), (top, 0), (step, samples), level) for top in range(0, lines, step)]
    return np.concatenate(strips)


def _reduced(
    path: Path, size: tuple[int, int], start: tuple[int, int], side: int | tuple[int, int], level: int
) -> Grey:
    """Pixels of a file from line and sample `start` on, halved `level` times."""
    down, across = (side, side) if isinstance(side, int) else side
    lines = slice(start[0], min(start[0] + down, size[0]))
    samples = slice(start[1], min(start[1] + across, size[1]))
    grey = _float(read_picture_part(path, lines, samples))
    for _ in range(level):
        grey = halved(grey)
    return grey


def _float(pixels: Grey) -> Grey:
    """Bytes as they are, all else as float32."""
    return pixels if pixels.dtype == np.uint8 else pixels.astype(np.float32)


def _contrast(grey: Grey) -> tuple[float, float, tuple[float, float], NDArray[np.int64]]:
    """Black, white, ends and bars of the histogram of some pixels."""
    step = max(1, int(np.sqrt(grey.size / _SAMPLED)))
    some = grey[::step, ::step]
    some = some[np.isfinite(some)]
    if not some.size:
        return 0.0, 1.0, (0.0, 1.0), np.zeros(_BARS, dtype=np.int64)
    low, high = np.quantile(some, _QUANTILES).tolist()
    least, most = float(some.min()), float(some.max())
    if not high > low:
        low, high = least, max(most, least + 1.0)
    if not most > least:
        most = least + 1.0
    return low, high, (least, most), np.histogram(some, _BARS, (least, most))[0].astype(np.int64)


def encoded_tile(grey: Grey, low: float, high: float) -> bytes:
    """A tile as PNG, black at `low` and white at `high`; transparent where there is no pixel.

    Raises
    ------
    InputError
        Unless `low` is below `high`, both finite.
    """
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise InputError("contrast", f"black at {low:g}, white at {high:g}", "black below white")
    from PIL import Image  # takes 0.1 s

    there = np.isfinite(grey)
    shown = (np.where(there, grey, low).astype(np.float32) - low) * (255.0 / (high - low))
    bytes_ = np.clip(np.rint(shown), 0.0, 255.0).astype(np.uint8)
    picture = Image.fromarray(bytes_)
    if not np.all(there):
        picture.putalpha(Image.fromarray(np.where(there, 255, 0).astype(np.uint8)))
    file = BytesIO()
    picture.save(file, "PNG", compress_level=1)
    return file.getvalue()


class Tiles:
    """Tiles of the pictures of images, kept while they are looked at; may be asked by several threads.

    Parameters
    ----------
    pictures : mapping
        Of each image's name: file of its pixels (None where nobody knows one), lines and samples.
    """

    def __init__(self, pictures: Mapping[str, tuple[Path | None, int, int]]) -> None:
        self._pictures = dict(pictures)
        self._pyramids: OrderedDict[str, Pyramid] = OrderedDict()
        self._encoded: OrderedDict[tuple[Any, ...], bytes] = OrderedDict()
        self._size = 0
        self._lock = threading.Lock()
        self._of_image = {name: threading.RLock() for name in self._pictures}

    def knows(self, image: str) -> bool:
        """Whether it is one of the images."""
        return image in self._pictures

    def has(self, image: str) -> bool:
        """Whether a file is known of an image's pixels."""
        return self._pictures.get(image, (None, 0, 0))[0] is not None

    def picture(self, image: str) -> Pyramid:
        """The picture of an image, read anew where its file has changed.

        Raises
        ------
        InputError
            No file of it is known; what `open_picture` refuses.
        """
        path, lines, samples = self._pictures.get(image, (None, 0, 0))
        if path is None:
            raise InputError(
                f"image {image}", "no file of its pixels is known, so that its geometry is drawn alone",
                remedy='for its picture add pixels = "FILE" to its table in the case',
            )
        with self._of_image[image]:  # each picture is opened once, others meanwhile
            kept = self._pyramids.get(image)
            if kept is None or Stamp.of(path) != kept.stamp:
                kept = open_picture(path, lines, samples)
        with self._lock:
            self._pyramids[image] = kept
            self._pyramids.move_to_end(image)
            while len(self._pyramids) > 1 and sum(one.size for one in self._pyramids.values()) > _MOST_KEPT:
                self._pyramids.popitem(last=False)
        return kept

    def tile(
        self, image: str, level: int, row: int, column: int, low: float | None = None, high: float | None = None
    ) -> bytes:
        """A tile as PNG; black and white as the picture has them where they are not said.

        Raises
        ------
        InputError
            As `picture`; no such tile; a contrast without a span; a file that has changed since it was opened.
        """
        known = self._pyramids.get(image)
        if known is not None:
            known.require_unchanged()
        pyramid = known or self.picture(image)
        black = pyramid.low if low is None else low
        white = pyramid.high if high is None else high
        key = (image, pyramid.stamp, level, row, column, black, white)
        with self._lock:
            if key in self._encoded:
                self._encoded.move_to_end(key)
                return self._encoded[key]
        made = encoded_tile(pyramid.part(level, row, column), black, white)
        with self._lock:
            if key not in self._encoded:
                self._encoded[key] = made
                self._size += len(made)
            while self._size > _MOST_ENCODED:
                self._size -= len(self._encoded.popitem(last=False)[1])
        return made

    def record(self, image: str) -> dict[str, Any]:
        """What the page needs to know of a picture, as JSON."""
        found = self.picture(image)
        return {
            "levels": found.levels, "side": SIDE, "low": found.low, "high": found.high,
            "least": found.edges[0], "most": found.edges[1], "histogram": found.counts.tolist(),
            "version": f"{found.stamp.size:x}-{found.stamp.modified:x}", "file": found.path.name,
        }  # fmt: skip
