"""Laser footprints on an image as one drawing that a browser can pan and zoom, and the profile's heights along it.

The image lies on its side, as in the figures: lines to the right, samples upward. One unit of the drawing is one sample
on the ground, both ways, so that shapes are true.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO

import numpy as np

from mgsgraph.files.rasters.pictures import Pixels
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, Index, thinned
from mgsgraph.registration.case import CaseRegistration
from mgsgraph.results.figures.overlay import (
    averaged,
    footprint_heights,
    ground_size,
    longest_profile,
    own_first,
    pixels_of,
    stretch,
    with_most_footprints,
)
from mgsgraph.results.figures.page import data_uri

MOST_SCENES = 4
"""Images shown, those with most footprints."""
_PIXELS = 6_000_000
"""Pixels of all images together, so that the page stays small."""
_QUALITY = 62
"""Of JPEG; the noise of a camera needs no more."""
_MOST_MARKS = 1500
"""Footprints of a profile in an image."""
_MOST_STRIPS = 4
_ASPECT = 5.0
"""Length over width up to which an image is drawn in one strip on paper."""
_LEVELS = (50, 10, 5)
"""A number that one of these divides is shown from further away."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A footprint in the drawing."""

    x: str
    """Along the lines."""
    y: str
    """Downward."""
    number: int
    """From the profile's first shot in the case, 1."""
    level: int
    """Numbers with 50 are shown from furthest away, with 1 from near by."""


@dataclass(frozen=True, slots=True)
class State:
    """One profile's footprints under one orientation."""

    orientation: str
    """nominal or adjusted."""
    profile: str
    """Its name."""
    numbered: bool
    """Whether numbers stand beside its marks."""
    marks: list[Mark]
    """Those inside the image."""


@dataclass(frozen=True, slots=True)
class Scene:
    """One image of the page."""

    image: str
    """Its name."""
    lines: int
    """Of the image."""
    samples: int
    """Of the image."""
    length: float
    """Extent of the drawing along x."""
    width: float
    """Extent of the drawing along y."""
    per_line: float
    """x of one line."""
    uri: str
    """Pixels as JPEG; empty where they are not at hand."""
    covered: tuple[float, float]
    """x and y that the pixels reach."""
    states: list[State]
    """Before first."""
    moves: str
    """SVG path from each footprint before to where it is after."""
    relief: str
    """SVG path of the heights, x as in the drawing, y from 0 (highest) to 100 (lowest)."""
    dots: str
    """SVG path of a dot at each of them."""
    heights: tuple[str, str]
    """Lowest and highest, m."""
    above: str
    """What heights are above."""
    profile: str
    """Whose heights."""
    strips: list[tuple[float, float]]
    """Start and length, x, of the pieces that are printed."""
    note: str
    """What was left out."""


def scenes(registration: CaseRegistration) -> tuple[list[Scene], str]:
    """The images with most footprints, and a sentence about others where there are any."""
    chosen, total = with_most_footprints(registration, MOST_SCENES)
    omitted = f"Of {total} images with footprints the {len(chosen)} with most are shown." if total > len(chosen) else ""
    return [_scene(registration, j, _PIXELS // len(chosen)) for j in chosen], omitted


def _scene(registration: CaseRegistration, j: int, most_pixels: int) -> Scene:
    image, size = registration.images[j], ground_size(registration.images[j])
    per_line = float(size[0] / size[1])
    uri, (lines, samples) = _picture(image, pixels_of(registration.pictures[j]), most_pixels)
    order = own_first(registration, j)
    states = [
        _state(registration, j, p, state, per_line, numbered=p == order[0])
        for state, _ in registration.states() for p in order
    ]  # fmt: skip
    first = registration.before[order[0]]
    relief, dots, heights, above = _relief(registration, j, order[0], per_line)
    length = image.lines * per_line
    pieces = min(_MOST_STRIPS, max(1, round(length / image.samples / _ASPECT)))
    most = max(int(registration.before[p].found.inside[j].sum()) for p in order)
    return Scene(
        image.name, image.lines, image.samples, round(length, 2), float(image.samples), round(per_line, 6), uri,
        (lines * per_line, float(samples)), states, _moves(registration, j, order, per_line), relief, dots, heights,
        above, first.name, [(k * length / pieces, length / pieces) for k in range(pieces)],
        f"At most {_MOST_MARKS} footprints of a profile are shown." if most > _MOST_MARKS else "",
    )  # fmt: skip


def _picture(image: PushbroomImage, pixels: Pixels | None, most: int) -> tuple[str, tuple[int, int]]:
    """JPEG of an image on its side, and how many of its lines and samples are in it."""
    if pixels is None:
        return "", (0, 0)
    step = max(1, int(np.ceil(np.sqrt(pixels.size / most))))
    low, high = stretch(pixels)
    grey = np.clip((averaged(pixels, step, step) - low) * (255.0 / (high - low)), 0.0, 255.0).astype(np.uint8)
    from matplotlib.image import imsave

    file = BytesIO()
    imsave(file, grey.T[::-1], format="jpg", cmap="gray", vmin=0, vmax=255, pil_kwargs={"quality": _QUALITY})
    return data_uri("image/jpeg", file.getvalue()), (grey.shape[0] * step, grey.shape[1] * step)


def _shown(registration: CaseRegistration, j: int, p: int, state: str) -> tuple[Index, Array]:
    """Shots of a profile that are drawn, and their places (n, 2) in the image."""
    found = dict(registration.states())[state][p].found
    inside = np.flatnonzero(found.inside[j])
    chosen = inside[thinned(inside.size, _MOST_MARKS)]
    return chosen, found.places[j, chosen]


def _state(registration: CaseRegistration, j: int, p: int, state: str, per_line: float, numbered: bool) -> State:
    shots, places = _shown(registration, j, p, state)
    x, y = _drawn(places, per_line, registration.images[j].samples).T
    marks = [Mark(f"{a:.1f}", f"{b:.1f}", k + 1, _level(k + 1)) for a, b, k in zip(x, y, shots.tolist(), strict=True)]
    return State(state, registration.before[p].name, numbered, marks)


def _level(shot: int) -> int:
    return next((level for level in _LEVELS if shot % level == 0), 1)


def _drawn(places: Array, per_line: float, samples: int) -> Array:
    """Line and sample (n, 2) as x and y of the drawing."""
    return np.stack([places[:, 0] * per_line, samples - places[:, 1]], axis=1)


def _moves(registration: CaseRegistration, j: int, order: Sequence[int], per_line: float) -> str:
    if not registration.after:
        return ""
    parts = []
    for p in order:
        shots, places = _shown(registration, j, p, "nominal")
        after = registration.after[p].found
        both = after.inside[j, shots]
        start = _drawn(places[both], per_line, registration.images[j].samples)
        stop = _drawn(after.places[j, shots[both]], per_line, registration.images[j].samples)
        parts += [f"M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}" for (a, b), (c, d) in zip(start, stop, strict=True)]
    return "".join(parts)


def _relief(
    registration: CaseRegistration, j: int, p: int, per_line: float
) -> tuple[str, str, tuple[str, str], str]:
    """Paths of the heights of a profile over the lines at which it falls, their span, and what they are above."""
    heights, above = footprint_heights(registration.before[p], registration.images[j])
    mine, lines = longest_profile(registration, j, p)
    known = np.isfinite(heights[mine])
    mine, x = mine[known], lines[known] * per_line
    if not mine.size:
        return "", "", ("", ""), above
    low, high = float(heights[mine].min()), float(heights[mine].max())
    y = 94.0 - 88.0 * (heights[mine] - low) / max(high - low, 1e-9)
    corners = [f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True)]
    return "M" + "L".join(corners), "".join(f"M{one}h0" for one in corners), (f"{low:.0f}", f"{high:.0f}"), above
