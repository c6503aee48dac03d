"""Stereo surfaces as files hold them: whole, in a fifth of their bytes."""

import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.stereo_surface import RESOLUTION, StereoSurface, coarse

Bytes = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class PackedSurface:
    """A stereo surface in a fifth of its bytes, from which it is made again whole: numbers less what neighbours say,
    their bytes sorted by significance and deflated.
    """

    first: Array
    """(2,) as of the surface (`StereoSurface`)."""
    step: Array
    """(2,) the same."""
    shape: Index
    """(2,) rows and columns of nodes."""
    places: Bytes
    """(b,) second differences along both axes, in units of the resolution, int64, packed."""
    covered: Bytes
    """(b,) of each node, whether it has a place, int8, packed."""
    sigmas: Bytes
    """(b,) as of the surface, float16, packed."""
    roughness: Bytes
    """(b,) the same."""

    @property
    def surface(self) -> StereoSurface:
        """The stereo surface that was packed, to its resolution."""
        shape = tuple(self.shape.tolist())
        places = _inflated(self.places, np.int64, (*shape, 2))
        for axis in (0, 0, 1, 1):
            places = np.cumsum(places, axis=axis)
        covered = _inflated(self.covered, np.int8, shape) != 0
        rounded = [_inflated(one, np.float16, shape) for one in (self.sigmas, self.roughness)]
        return StereoSurface(self.first, self.step, places * RESOLUTION, covered, *rounded)


def packed(surface: StereoSurface) -> PackedSurface | StereoSurface:
    """A stereo surface packed; itself where it is of another resolution, as earlier versions made them."""
    whole = np.rint(surface.places / RESOLUTION).astype(np.int64)
    rounded = surface.sigmas, surface.roughness
    if not np.array_equal(whole * RESOLUTION, surface.places):
        return surface
    if not all(np.array_equal(coarse(one), one) for one in rounded):
        return surface
    for axis in (0, 0, 1, 1):
        whole = np.diff(whole, axis=axis, prepend=0)
    shape = np.array(surface.covered.shape, dtype=np.int64)
    small = [_deflated(one.astype(np.float16)) for one in rounded]
    covered = _deflated(surface.covered.astype(np.int8))
    return PackedSurface(surface.first, surface.step, shape, _deflated(whole), covered, *small)


def _deflated(values: NDArray[Any]) -> Bytes:
    sorted_bytes = np.ascontiguousarray(values).view(np.uint8).reshape(-1, values.dtype.itemsize).T
    return np.frombuffer(zlib.compress(sorted_bytes.tobytes()), dtype=np.uint8)


def _inflated(data: Bytes, kind: type[np.generic], shape: tuple[int, ...]) -> NDArray[Any]:
    sorted_bytes = np.frombuffer(zlib.decompress(data.tobytes()), dtype=np.uint8)
    return np.ascontiguousarray(sorted_bytes.reshape(np.dtype(kind).itemsize, -1).T).view(kind).reshape(shape)
