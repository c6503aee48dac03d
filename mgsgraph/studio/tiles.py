"""Tiles of pictures: grey values of any image that the program reads, at full resolution and halved again and again.

Level 0 has the pixels themselves; a pixel of level n is the mean of 2^n lines and samples. Coarse levels of a picture
are made once, in one pass, and kept; of a large picture fine ones are read from its file where they are looked at.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mgsgraph.errors import InputError, require
from mgsgraph.files.opening import ANY_SIZE, opened
from mgsgraph.files.rasters.pictures import picture_size, read_picture, read_picture_part
from mgsgraph.geometry.records import Array

SIDE = 256
"""Lines and samples of a tile."""
_KEPT = 1 << 24
"""Pixels of the finest level that is kept in memory."""
_MOST_KEPT = 1 << 29
"""bytes of levels of all pictures that are kept."""
_QUANTILES = (0.005, 0.995)
"""Grey values below and above are black and white at first: dead pixels and cosmic rays don't set the contrast."""
_SAMPLED = 1 << 18
"""Pixels from which the quantiles and the histogram are taken."""
_BINS = 128
"""Most classes of a histogram."""

Grey = NDArray[Any]
"""(lines, samples) of a picture: unsigned bytes, or float32 with NaN where there is no pixel."""


def stamp_of(path: Path) -> tuple[int, int]:
    """Size in bytes and time in ns of the last change of a file, which show that it was replaced.

    InputError where there is none, or none that may be read.
    """
    with opened(path, ANY_SIZE) as file:
        status = os.fstat(file.fileno())
    return status.st_size, status.st_mtime_ns


@dataclass(frozen=True, slots=True, eq=False)
class Pyramid:
    """Grey values of a picture, from its finest level in memory on."""

    path: Path
    """File of the pixels."""
    stamp: tuple[int, int]
    """Its state when it was read (`stamp_of`)."""
    lines: int
    """Of the picture."""
    samples: int
    """Of the picture."""
    finest: int
    """Level of the finest one in memory; finer ones are read from the file."""
    in_memory: tuple[Grey, ...]
    """Levels from `finest` on; the last one fits in one tile."""
    low: float
    """Grey value that is black at first."""
    high: float
    """Grey value that is white at first, above `low`."""
    least: float
    """Smallest grey value of some pixels, evenly spread."""
    most: float
    """The largest one, above `least`."""
    first: float
    """Where the histogram of these pixels begins: three times as wide as `low` to `high`, for single pixels lie far."""
    step: float
    """Grey values in one of its classes; a whole number for a picture of whole grey values."""
    counts: tuple[int, ...]
    """Pixels in each class."""

    @property
    def levels(self) -> int:
        """Number of levels."""
        return self.finest + len(self.in_memory)

    @property
    def size(self) -> int:
        """Bytes of the levels in memory."""
        return sum(level.nbytes for level in self.in_memory)

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
        return self.pixels(level, slice(top, min(top + SIDE, lines)), slice(left, min(left + SIDE, samples)))

    def pixels(self, level: int, lines: slice, samples: slice) -> Grey:
        """Pixels of a level, between its lines and samples."""
        if level >= self.finest:
            return self.in_memory[level - self.finest][lines, samples]
        return _reduced(self.path, (self.lines, self.samples), level, lines, samples)

    def value(self, line: float, sample: float) -> float | None:
        """Grey value of the pixel at a place; None outside the picture, NaN where there is no pixel."""
        if not (0 <= line < self.lines and 0 <= sample < self.samples):
            return None
        return float(self.pixels(0, slice(int(line), int(line) + 1), slice(int(sample), int(sample) + 1))[0, 0])

    def contrast(self, corners: Array) -> tuple[float, float]:
        """Black and white by the quantiles inside a window, [line, sample] of two opposite corners (2, 2)."""
        size = np.array([self.lines, self.samples])
        low = np.clip(np.floor(corners.min(axis=0)), 0, size - 1).astype(int)
        high = np.maximum(np.clip(np.ceil(corners.max(axis=0)), 0, size).astype(int), low + 1)
        level = min(int((high - low).max() // (2 * SIDE)).bit_length(), self.levels - 1)
        lines, samples = (slice(a >> level, -(-b >> level)) for a, b in zip(low.tolist(), high.tolist(), strict=True))
        return _contrast(self.pixels(level, lines, samples))[:2]

    def require_unchanged(self) -> None:
        """Raise InputError where the file is gone or has been replaced."""
        found, remedy = "it has changed since its picture was opened", "open the image again, or reload the page"
        require(stamp_of(self.path) == self.stamp, str(self.path), found, "the same file", remedy)


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
    stamp = stamp_of(path)
    size = picture_size(path)
    found, expected = f"{size[0]} x {size[1]} pixels", f"the image's {lines} x {samples}"
    require(size == (lines, samples), str(path), found, expected, "name the image's own, uncropped file in the case")
    finest = 0
    while (-(-lines >> finest)) * (-(-samples >> finest)) > _KEPT:
        finest += 1
    levels = [_float(read_picture(path)) if finest == 0 else _overview(path, lines, samples, finest)]
    while max(levels[-1].shape) > SIDE:
        levels.append(halved(levels[-1]))
    return Pyramid(path, stamp, lines, samples, finest, tuple(levels), *_contrast(levels[0]))


def halved(grey: Grey) -> Grey:
    """Means of 2 x 2 pixels: at odd edges of the existing ones, elsewhere of the valid ones."""
    down, across = (-(-n // 2) for n in grey.shape)
    if grey.dtype == np.uint8:
        padded = np.pad(grey, ((0, 2 * down - grey.shape[0]), (0, 2 * across - grey.shape[1])), mode="edge")
        total = np.zeros((down, across), dtype=np.uint16)
        for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
            total += padded[i::2, j::2]
        return ((total + 2) >> 2).astype(np.uint8)
    total, number = np.zeros((down, across), dtype=np.float32), np.zeros((down, across), dtype=np.uint8)
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        part = grey[i::2, j::2]
        valid = np.isfinite(part)
        total[: part.shape[0], : part.shape[1]] += np.where(valid, part, 0.0)
        number[: part.shape[0], : part.shape[1]] += valid
    return np.where(number > 0, total / np.maximum(number, 1), np.float32(np.nan)).astype(np.float32)


def _overview(path: Path, lines: int, samples: int, level: int) -> Grey:
    """A whole level of a large picture, strip by strip."""
    strips = range(0, -(-lines >> level), SIDE)
    return np.concatenate([
        _reduced(path, (lines, samples), level, slice(top, top + SIDE), slice(0, samples)) for top in strips
    ])


def _reduced(path: Path, size: tuple[int, int], level: int, lines: slice, samples: slice) -> Grey:
    """Lines and samples of a level, read from a file of this size and halved `level` times."""
    down = slice(lines.start << level, min(lines.stop << level, size[0]))
    across = slice(samples.start << level, min(samples.stop << level, size[1]))
    grey = _float(read_picture_part(path, down, across))
    for _ in range(level):
        grey = halved(grey)
    return grey


def _float(pixels: Grey) -> Grey:
    """Bytes as they are, all else as float32."""
    return pixels if pixels.dtype == np.uint8 else pixels.astype(np.float32)


def _contrast(grey: Grey) -> tuple[float, float, float, float, float, float, tuple[int, ...]]:
    """Black and white, least and largest grey value, and the histogram, by some pixels."""
    step = max(1, int(np.sqrt(grey.size / _SAMPLED)))
    some = grey[::step, ::step]
    some = some[np.isfinite(some)]
    if not some.size:
        return 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, (0,)
    low, high, least, most = np.quantile(some, (*_QUANTILES, 0.0, 1.0)).tolist()
    most = most if most > least else least + 1.0
    low, high = (low, high) if high > low else (least, most)
    first, last = max(least, 2.0 * low - high), min(most, 2.0 * high - low)
    is_whole = np.array_equal(some, np.rint(some))  # then each class has as many grey values
    width = float(np.ceil((last - first) / _BINS) if is_whole else (last - first) / _BINS)
    counts = np.bincount(((some[(some >= first) & (some <= last)] - first) / width).astype(int))
    return low, high, least, most, first, width, tuple(counts.tolist())


def encoded_tile(grey: Grey, low: float, high: float) -> bytes:
    """A tile as PNG, black at `low` and white at `high`; transparent where there is no pixel.

    Raises
    ------
    InputError
        Unless `low` is below `high`, both finite.
    """
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise InputError("contrast", f"black at {low:g}, white at {high:g}", "black below white")
    valid = np.isfinite(grey)
    shown = (np.where(valid, grey, low).astype(np.float32) - low) * (255.0 / (high - low))
    bytes_ = np.clip(np.rint(shown), 0.0, 255.0).astype(np.uint8)
    picture = Image.fromarray(bytes_)
    if not np.all(valid):
        picture.putalpha(Image.fromarray(np.where(valid, 255, 0).astype(np.uint8)))
    return png(picture)


def png(picture: Image.Image) -> bytes:
    """A picture as PNG, written fast."""
    file = BytesIO()
    picture.save(file, "PNG", compress_level=1)
    return file.getvalue()


class Tiles:
    """Tiles of the pictures of images, kept while they are looked at; may be asked by several threads.

    Parameters
    ----------
    pictures : mapping
        Of each image's name: file of its pixels (None where unknown), lines and samples.
    """

    def __init__(self, pictures: Mapping[str, tuple[Path | None, int, int]]) -> None:
        self.pictures, self._open, self._lock = pictures, dict[str, Pyramid](), Lock()

    def has(self, image: str) -> bool:
        """Whether a file is known of an image's pixels."""
        return self.pictures.get(image, (None, 0, 0))[0] is not None

    def picture(self, image: str) -> Pyramid:
        """The picture of an image, read again where its file has changed.

        Raises
        ------
        InputError
            No file of it is known; what `open_picture` refuses.
        """
        path, lines, samples = self.pictures.get(image, (None, 0, 0))
        if path is None:
            raise InputError(
                f"image {image}", "no file of its pixels is known, so that its geometry is drawn alone",
                remedy='for its picture add pixels = "FILE" to its table in the case',
            )
        with self._lock:
            pyramid = self._open.pop(image, None)
            if pyramid is None or stamp_of(path) != pyramid.stamp:
                pyramid = open_picture(path, lines, samples)
            self._open[image] = pyramid
            while len(self._open) > 1 and sum(p.size for p in self._open.values()) > _MOST_KEPT:
                del self._open[next(iter(self._open))]
        return pyramid

    def tile(
        self, image: str, level: int, row: int, column: int, low: float | None = None, high: float | None = None
    ) -> bytes:
        """A tile as PNG; black and white by default as the picture has them.

        Raises
        ------
        InputError
            As `picture`; no such tile; a contrast without a span; a file that has changed since it was opened.
        """
        pyramid = self._open.get(image) or self.picture(image)
        pyramid.require_unchanged()
        black, white = pyramid.low if low is None else low, pyramid.high if high is None else high
        return encoded_tile(pyramid.part(level, row, column), black, white)

    def value(self, image: str, line: float, sample: float) -> float | None:
        """Grey value of an image's pixel at a place; None outside it, and where its picture isn't open."""
        pyramid = self._open.get(image)
        return None if pyramid is None else pyramid.value(line, sample)

    def record(self, image: str) -> dict[str, Any]:
        """What the page needs to know of a picture, as JSON."""
        pyramid = self.picture(image)
        return {
            "levels": pyramid.levels, "side": SIDE, "low": pyramid.low, "high": pyramid.high, "least": pyramid.least,
            "most": pyramid.most, "first": pyramid.first,
            "step": pyramid.step, "counts": pyramid.counts, "version": "{:x}-{:x}".format(*pyramid.stamp),
        }  # fmt: skip
