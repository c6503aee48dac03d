"""Disparities of two ortho patches whose rows run along the parallax: semi-global matching.

Hirschmueller, H. (2008): Stereo processing by semiglobal matching and mutual information, IEEE PAMI 30(2); OpenCV's,
with Birchfield & Tomasi's cost of horizontal gradients, to which other brightness and contrast don't matter.
"""

import numpy as np

from mgsgraph.geometry.records import Array
from mgsgraph.matching.opencv import opencv
from mgsgraph.matching.patches import Patch

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
