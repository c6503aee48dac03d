"""Steps that a lossy compression leaves in pictures: blocks of 8 x 8 pixels, as JPEG's.

At their edges neighbouring pixels differ more than elsewhere, and windows are matched edge to edge: the ties then lie
by blocks, off by pixels, with sigmas that know nothing of it. Held against each other are the mean differences of
neighbours at each of the eight phases; of blocks one phase stands out, along lines and along samples alike (a
detector's columns read out in turns give several, or one along samples alone).
"""

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.matching.scene import Pixels, Scene

_BLOCK = 8
"""pixels."""
_LOOKED_AT = 1_000_000
"""pixels from which a picture is judged."""
_FEWEST = 4 * _BLOCK
"""Lines and samples without which it isn't."""
STEPPED = 1.5
"""From which on matches suffer: quality 40 and less of JPEG, 2 to 6 % of the ties off by more than a pixel."""
STEEP = 3.5
"""From which on a picture is refused: quality 15 and less, up to 83 %."""


def block_steps(pixels: Pixels) -> float:
    """How many times larger neighbours differ at the edges of blocks than at any other phase; about 1 without."""
    if min(pixels.shape) < _FEWEST:
        return 1.0
    return min(_along(pixels, 1), _along(pixels.T, 1))


def _along(pixels: Pixels, axis: int) -> float:
    """The same across one axis, by some of the rows along it."""
    apart = max(1, pixels.size // _LOOKED_AT)
    steps = np.abs(np.diff(pixels[::apart].astype(np.float32), axis=axis))
    with np.errstate(invalid="ignore"):
        means = np.array([float(np.nanmean(part)) if np.any(np.isfinite(part := steps[:, k::_BLOCK])) else 0.0
                          for k in range(_BLOCK)])  # fmt: skip
    highest, second = np.sort(means)[[-1, -2]]
    return float(highest / second) if second > 0.0 else 1.0


def require_unblocked(scene: Scene) -> tuple[str, ...]:
    """Raise InputError where a picture shows steep blocks; sentences of those that show some."""
    cautions = list[str]()
    for picture in scene.pictures:
        steps, name = block_steps(picture.pixels), picture.image.name
        if steps > STEEP:
            raise InputError(
                f"picture of {name}", f"blocks of 8 x 8 pixels: at their edges grey values step {steps:.1f} times more "
                "than elsewhere, which would be matched in place of the ground", "pixels without strong JPEG steps",
                "take the picture as it was archived, or leave the image out",
            )  # fmt: skip
        if steps > STEPPED:
            cautions.append(
                f"The picture of {name} shows blocks of 8 x 8 pixels (JPEG: steps {steps:.1f} times larger at their "
                "edges): some hundredths of its ties may be off by more than a pixel, which no sigma here covers; "
                "adjust with --reject 4, or take the picture as it was archived."
            )
    return tuple(cautions)
