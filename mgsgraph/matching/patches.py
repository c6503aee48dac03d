"""Pictures resampled onto tiles of the ground grid: one scale, one direction, and hardly any displacement left; and the
disparities that are left, where rows run along the parallax, by semi-global matching.

Hirschmueller, H. (2008): Stereo processing by semiglobal matching and mutual information, IEEE PAMI 30(2); OpenCV's,
with Birchfield & Tomasi's cost of horizontal gradients, to which other brightness and contrast don't matter.
"""

from importlib.util import find_spec
from types import ModuleType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import library
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.terrain import refined
from mgsgraph.matching.scene import Ground, Picture

NODE = 16
"""pixels of the ground grid between the nodes that are projected; between nodes, lines and samples are bilinear."""
_SKIPS = 2.0
"""A picture's pixels in one of the ground grid from which on a cubic skips some."""
_BLUR, _UNBLURRED = 0.5, 1e-3
"""Sigma of the filter then, in pixels of the ground grid, and in pixels of one that does nothing."""
_REMAP_LIMIT = 30_000
"""pixels; OpenCV's remap takes pictures of less than 32,768 lines and samples."""


def has_opencv() -> bool:
    """Whether OpenCV is installed, the extra "match"."""
    return find_spec("cv2") is not None


def opencv() -> ModuleType:
    """OpenCV, which only matching needs; InputError where it is not installed, or cannot be loaded."""
    return library("cv2", "match", "matching", "OpenCV")


class Tile(NamedTuple):
    """A rectangle of the ground grid, with a margin in which neighbouring tiles' features are found too."""

    number: int
    west: float
    """m, x of the first column's pixels."""
    south: float
    """m, y of the first row's; rows go along the flight."""
    step: float
    """m between pixels."""
    rows: int
    columns: int
    margin: int
    """pixels on every side that belong to the tile's neighbours."""

    def plane(self, columns: Array, rows: Array) -> Array:
        """(n, 2) m of the chart, of pixel centres counted from zero."""
        return np.column_stack([self.west + columns * self.step, self.south + rows * self.step])

    def nodes(self, spacing: float) -> tuple[Index, Index]:
        """Rows and columns (m,) and (k,) of the pixels next to the lines of a grid that all tiles share."""
        axes = []
        for start, count in ((self.south, self.rows), (self.west, self.columns)):
            lines = np.arange(np.ceil(start / spacing), (start + (count - 1) * self.step) / spacing) * spacing
            axes.append(np.rint((lines - start) / self.step).astype(np.int64))
        return axes[0], axes[1]

    def owns(self, plane: Array) -> NDArray[np.bool_]:
        """(n,) which positions (n, 2) of the chart lie in the tile without its margin."""
        column, row = (plane[:, 0] - self.west) / self.step, (plane[:, 1] - self.south) / self.step
        inside = (column >= self.margin - 0.5) & (column < self.columns - self.margin - 0.5)
        return np.asarray(inside & (row >= self.margin - 0.5) & (row < self.rows - self.margin - 0.5))


class Patch(NamedTuple):
    """A picture on a tile."""

    grey: NDArray[np.uint8]
    """(rows, columns), stretched between the picture's levels."""
    valid: NDArray[np.uint8]
    """(rows, columns), 255 where the picture has pixels."""


def ortho_patch(picture: Picture, ground: Ground, tile: Tile) -> Patch | None:
    """A picture on a tile; None where it shows nothing of it."""
    cv2 = opencv()
    nodes, levels = node_pixels(picture, ground, tile), picture.levels
    size = np.array([picture.image.lines, picture.image.samples], dtype=np.float64)
    touched = np.all((nodes > -2.0 * NODE) & (nodes < size + 2.0 * NODE), axis=2)
    if not touched.any():
        return None
    lines, samples = (refined(nodes[:, :, k], NODE)[: tile.rows, : tile.columns] for k in (0, 1))
    seen = (lines > 0.5) & (lines < size[0] - 0.5) & (samples > 0.5) & (samples < size[1] - 0.5)
    if not seen.any():
        return None
    first = int(max(np.floor(lines[seen].min()) - 4, 0))
    last = min(int(np.ceil(lines[seen].max())) + 4, first + _REMAP_LIMIT)
    seen &= lines < last - 0.5
    part = picture.pixels[first:last].astype(np.float32)
    hollow = ~np.isfinite(part)
    if hollow.any():
        part[hollow] = levels[0]
    blur = blur_sigmas(nodes)
    if any(blur):
        part = cv2.GaussianBlur(part, (0, 0), sigmaX=max(blur[1], _UNBLURRED), sigmaY=max(blur[0], _UNBLURRED))
    down, across = (lines - 0.5 - first).astype(np.float32), (samples - 0.5).astype(np.float32)
    grey = cv2.remap(part, across, down, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    if hollow.any():
        reach = [3 + 2 * int(np.ceil(2.0 * sigma)) for sigma in blur]  # a cubic's one pixel, and the filter's
        wide = cv2.dilate(hollow.astype(np.float32), np.ones(reach, np.uint8))
        dead = cv2.remap(wide, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        seen &= dead == 0
    stretched = np.clip((grey - levels[0]) * (255.0 / (levels[1] - levels[0])), 0.0, 255.0).astype(np.uint8)
    return Patch(np.where(seen, stretched, 0).astype(np.uint8), np.where(seen, 255, 0).astype(np.uint8))


def node_pixels(picture: Picture, ground: Ground, tile: Tile) -> Array:
    """(rows', columns', 2) line and sample of every sixteenth pixel, beyond the tile's last one; NaN where unseen."""
    columns, rows = (np.arange(-(-count // NODE) + 1) * float(NODE) for count in (tile.columns, tile.rows))
    across, along = np.meshgrid(columns, rows)
    points = ground.points(tile.plane(across.ravel(), along.ravel()))
    return picture.project(points).reshape(rows.size, columns.size, 2)


def blur_sigmas(nodes: Array) -> tuple[float, float]:
    """Sigmas in lines and samples of the filter of a picture much finer than the ground grid: unfiltered, the grid's
    pixels would skip most of the picture's, and show their noise and aliases instead. Zero where none is needed.
    """
    apart = [np.abs(np.diff(nodes, axis=k)).reshape(-1, 2) / NODE for k in (0, 1)]
    seen = [one[np.isfinite(one).all(axis=1)] for one in apart]
    if not (len(seen[0]) and len(seen[1])):
        return 0.0, 0.0
    lines, samples = np.hypot(*(np.median(one, axis=0) for one in seen)).tolist()
    sigmas = [_BLUR * float(np.sqrt(size**2 - 1.0)) if size > _SKIPS else 0.0 for size in (lines, samples)]
    return sigmas[0], sigmas[1]


# --- disparities

MOST = 128
"""pixels, disparities either way that are tried at once."""
_BLOCK = 7
"""pixels of a window's side."""
_SMALL, _LARGE = 8, 32
"""Penalties of a disparity that changes by one pixel or by more, per pixel of a window."""
_UNIQUE = 5
"""per cent by which the best cost has to be better than any other."""
_SPECKLE, _SPECKLE_RANGE = 200, 2
"""pixels: a patch of fewer, that its neighbours differ from by more, is a mismatch."""
_SIXTEENTHS = 16.0
"""OpenCV counts disparities in sixteenths of a pixel."""


def disparities(one: Patch, other: Patch, reach: int) -> Array:
    """(rows, columns) d, pixels: what `one` shows in a column lies in `other`, in the same row, d columns before.

    NaN where nothing is alike enough, or a patch has no picture. `reach` is the most that d may be either way, pixels.
    """
    cv2 = opencv()
    most = min(int(reach), MOST)
    count = -(-2 * most // 16) * 16
    matcher = cv2.StereoSGBM_create(
        minDisparity=-count // 2, numDisparities=count, blockSize=_BLOCK, P1=_SMALL * _BLOCK**2, P2=_LARGE * _BLOCK**2,
        disp12MaxDiff=1, preFilterCap=31, uniquenessRatio=_UNIQUE, speckleWindowSize=_SPECKLE,
        speckleRange=_SPECKLE_RANGE, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )  # fmt: skip
    found = cv2.medianBlur(matcher.compute(one.grey, other.grey), 5).astype(np.float64) / _SIXTEENTHS
    known = (found >= -count / 2) & (one.valid > 0)
    return np.where(known, found, np.nan)
