"""Least-squares refinement of a place that was clicked, against the place of the same ground in another image."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.rasters.pictures import read_picture_part
from mgsgraph.geometry.records import Array
from mgsgraph.matching.equations import SplinePicture
from mgsgraph.matching.least_squares import MatchStatus, match_least_squares
from mgsgraph.matching.measuring import FINEST
from mgsgraph.studio.block import Block
from mgsgraph.studio.linked import LinkedImages

_HALF = (10, 10)
"""px of the reference window on each side of its middle."""
_REACH = 8.0
"""px by which the place may leave where it was clicked."""
_ROOM = 12
"""px that are read beyond the window and its reach."""
_WORDS = {
    MatchStatus.LEFT: "its window leaves the picture, or lies where that has no grey values",
    MatchStatus.NOT_CONVERGED: "it did not come to rest",
    MatchStatus.WANDERED: f"it wandered more than {_REACH:g} px away",
    MatchStatus.FLAT: "there is too little texture",
    MatchStatus.SATURATED: "too many pixels are saturated",
}


class Refined(NamedTuple):
    """A place refined by least squares."""

    place: Array
    """(2,) line and sample."""
    covariance: Array
    """(2, 2) px^2, the reference being given."""
    correlation: float
    """Of both windows."""


def refine(
    linked: LinkedImages, pictures: Mapping[str, Path | None], reference: tuple[str, float, float],
    search: tuple[str, float, float],
) -> Refined:  # fmt: skip
    """Move a clicked place to where the ground around the reference's place is.

    The window's shape follows from the geometry of both images, turned and scaled by the Jacobian of one image's places
    by the other's; least squares adjust it (Grün 1985). The covariance is that of noise and of what the window's own
    bend has above its noise (`matching.least_squares`): in so small a window unknowns of the relief would add more
    noise than they take away.

    Parameters
    ----------
    linked : LinkedImages
    pictures : mapping
        File of each image's pixels.
    reference, search : (str, float, float)
        Image, line and sample: of the place that holds, and of that which was clicked.

    Raises
    ------
    InputError
        No pixels; images that don't show the same ground; a match that wasn't found.
    """
    name, wanted = reference[0], search[0]
    place, start = np.array(reference[1:]), np.array(search[1:])
    _, others = linked.under(*reference, wanted=(wanted,))
    block = linked.block
    found = next((one for one in others if one.image == block.network.image_number(wanted)), None)
    if found is None:
        raise InputError(f"image {wanted}", f"the ground of {name} isn't in it", "a place of the same ground")
    reach = int(np.ceil(_REACH + np.abs(found.jacobian) @ np.array(_HALF)).max())
    template, first = _window(block, pictures, name, place, _HALF[0] + _ROOM)
    other, second = _window(block, pictures, wanted, start, reach + _ROOM)
    anchor = np.floor(place) + 0.5
    begin = start + found.jacobian @ (anchor - place)
    match = match_least_squares(
        template, other, (anchor - first)[None], (begin - second)[None], found.jacobian[None], _HALF,
        reach=_REACH, threads=1,
    )  # fmt: skip
    if not match.converged[0]:
        words = _WORDS[MatchStatus(int(match.status[0]))]
        raise InputError(f"image {wanted}", f"no least-squares match with {name}: {words}", remedy="click it by eye")
    there = match.pixels[0] + second + match.affine[0] @ (place - anchor)
    return Refined(there, match.covariance[0] + FINEST**2 * np.eye(2), float(match.correlation[0]))


def _window(
    block: Block, pictures: Mapping[str, Path | None], image: str, place: Array, half: int
) -> tuple[SplinePicture, Array]:
    """Part of a picture around a place, and line and sample (2,) of its corner."""
    path, record = pictures.get(image), block.images[block.network.image_number(image)]
    if path is None:
        raise InputError(f"image {image}", "no file of its pixels is known", remedy="measure without refinement")
    low = np.maximum(np.floor(place).astype(int) - half, 0)
    high = np.minimum(np.floor(place).astype(int) + half + 1, [record.lines, record.samples])
    if np.any(high - low < 2 * _HALF[0]):
        raise InputError(f"image {image}", "a place too near to its edge", "a window inside the picture")
    pixels = read_picture_part(path, slice(low[0], high[0]), slice(low[1], high[1]))
    return SplinePicture.of(pixels, f"image {image}"), low.astype(np.float64)
