"""Laser footprints on whole images, each with its elevation profile.

The image lies on its side (lines to the right), so that its right edge is the upper one. Heights are drawn on that
edge, as in Figure 4 of Yoon & Shan (2005).
"""

from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.path import Path as MatplotlibPath
from matplotlib.textpath import TextPath
from matplotlib.transforms import Affine2D
from numpy.typing import NDArray

from mgsgraph.files.labels.image_label import cube_of, read_label
from mgsgraph.files.rasters.pictures import Pixels, as_bytes, is_moc, read_picture
from mgsgraph.geometry.body import geodetic
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, Index
from mgsgraph.registration.case import CaseRegistration, ProfileRegistration
from mgsgraph.results.figures.sheet import (
    BEFORE,
    INK,
    MOST_SHEETS,
    Sheet,
    left_out,
    new_sheet,
    number,
    plain_style,
    sheet_name,
    short,
)

AFTER = "#56B4E9"
"""The palette's light blue: its dark one can't be seen on an image."""
STATE_COLOURS = {"nominal": BEFORE, "adjusted": AFTER}
STATE_WORDS = {"nominal": "before: archived footprint, nominal orientation", "adjusted": "after: both adjusted"}
MARKERS = "o^sDv"
"""One for each profile in an image."""
_WIDTH, _TALL, _HEIGHTS, _BETWEEN = 10.6, 1.45, 0.8, 0.36
"""inch: widest strip, lowest one, elevation panel, gap between strips."""
_MOST_STRIPS = 4
_LEAST_RELIEF = 20.0
"""m, span of the heights that are drawn at least."""
_MOST_HEIGHT = 7.0
"""inch, of all strips of an image."""
_PER_INCH = 150
"""pixels drawn; more of them only take time."""
_ADVANCE, _DIGIT = 0.636, 0.729
"""Width and height of any digit of DejaVu Sans in units of the type's size."""
_ROOM = 0.19
"""inch that a number of three digits needs."""
_GAP = 3.6
"""points between the middle of a mark and its number."""
_BLANK = "#D9D9D9"
"""Grey of an image without pixels."""


def pixels_of(path: Path | None) -> Pixels | None:
    """An image's pixels; None where the case names no file of them, or the label of a cube which isn't at hand."""
    if path is None:
        return None
    if path.suffix.lower() != ".cub" and is_moc(path) and cube_of(read_label(path)) is not None:
        beside = [path.with_suffix(suffix) for suffix in (".cub", ".CUB") if path.with_suffix(suffix).is_file()]
        if not beside:
            return None
        path = beside[0]
    return as_bytes(read_picture(path))


def ground_size(image: PushbroomImage) -> Array:
    """(2,) m on the ellipsoid per line and per sample in the image's middle."""
    _, by_pixel = image.image_to_ground(np.array([0.5 * image.lines]), np.array([0.5 * image.samples]))
    return np.asarray(np.linalg.norm(by_pixel[0], axis=0))


def footprint_heights(profile: ProfileRegistration, body_of: PushbroomImage) -> tuple[Array, str]:
    """Heights (n,) in m of archived footprints, and above what: the areoid, or the ellipsoid where that is unknown."""
    shots = profile.found.shots
    heights = np.linalg.norm(shots.footprints, axis=1) - shots.areoid_radii
    if np.all(np.isfinite(heights)):
        return heights, "areoid"
    return geodetic(shots.footprints, body_of.body)[:, 2], "ellipsoid"


# --- whole images


def overlay_sheets(registration: CaseRegistration, pixels: Sequence[Pixels | None]) -> Iterator[Sheet]:
    """One sheet for each of the images with most footprints."""
    chosen, total = with_most_footprints(registration, MOST_SHEETS)
    omitted = left_out(total, len(chosen), f"{len(chosen)} with most footprints")
    for n, j in enumerate(chosen):
        yield _overlay(registration, j, pixels[j], sheet_name("overlay", n + 1, len(chosen)), omitted)


@plain_style()
def _overlay(registration: CaseRegistration, j: int, pixels: Pixels | None, name: str, omitted: str) -> Sheet:
    image, size = registration.images[j], ground_size(registration.images[j])
    strips, width, height = _strips(float(image.samples * size[1] / (image.lines * size[0])))
    order = own_first(registration, j)[: len(MARKERS)]
    ratios = ([_HEIGHTS, height, _BETWEEN] * strips)[:-1]
    caption = _overlay_caption(registration, j, order, pixels is not None) + omitted + "."
    title = f"Laser footprints in {short(image.name, 60)}"
    sheet = new_sheet(name, width + 1.06, sum(ratios) + 0.7, title, caption, gap=0.0)
    grid = sheet.panels(len(ratios), 1, heights=ratios)[:, 0]
    limits = stretch(pixels)
    heights, above = footprint_heights(registration.before[order[0]], image)
    for k in range(strips):
        lines = image.lines * k / strips, image.lines * (k + 1) / strips
        relief, strip = grid[3 * k], grid[3 * k + 1]
        if k < strips - 1:
            grid[3 * k + 2].remove()
        picture(strip, pixels, limits, image, lines, (0.0, float(image.samples)), width, height, on_its_side=True)
        strip.set(xlim=lines, ylim=(0.0, image.samples))
        strip.locator_params(axis="y", nbins=4)
        strip.set(xlabel="line (px)" if k == strips - 1 else "", ylabel="sample (px)")
        relief.set_xlim(lines)
        relief.set_ylabel("height (m)")
        relief.tick_params(labelbottom=False, bottom=False)
        relief.locator_params(axis="y", nbins=4)
        _marks(strip, registration, j, order, (lines[1] - lines[0]) / width)
        _relief(relief, registration, j, order[0], heights)
    grid[0].set_title(
        f"Heights above the {above} on the image's right edge; the image lies on its side, lines go to the right"
    )
    _key(sheet, registration, order)
    return sheet


def _strips(aspect: float) -> tuple[int, float, float]:
    """Into how many strips an image (width over length `aspect`) is cut, and their width and height in inch."""
    strips = min(max(1, int(np.ceil(_TALL / (_WIDTH * aspect)))), _MOST_STRIPS)
    width = min(_WIDTH, _MOST_HEIGHT / (aspect * strips**2))
    height = max(width * aspect * strips, 0.6)
    return strips, max(width, 5.0), height


def with_most_footprints(registration: CaseRegistration, most: int) -> tuple[list[int], int]:
    """Images with most footprints, in their own order, `most` at the most; and how many have any."""
    counts = np.sum([profile.found.inside.sum(axis=1) for profile in registration.before], axis=0)
    chosen = sorted(np.argsort(-counts, kind="stable")[:most].tolist())
    return [j for j in chosen if counts[j]], int(np.count_nonzero(counts))


def own_first(registration: CaseRegistration, j: int) -> list[int]:
    """Profiles that fall in an image; the one taken along with it first, then those with most footprints."""
    counts = [int(profile.found.inside[j].sum()) for profile in registration.before]
    own = [bool(np.any(profile.found.simultaneous[j])) for profile in registration.before]
    return sorted((p for p, count in enumerate(counts) if count), key=lambda p: (not own[p], -counts[p]))


def longest_profile(registration: CaseRegistration, j: int, p: int) -> tuple[Index, Array]:
    """Shots (n,) of a profile whose heights are drawn in an image, and their lines (n,) in order, under the best
    orientation there is: those of one orbit, for a file may hold several.
    """
    _, profiles = list(registration.states())[-1]
    found = profiles[p].found
    orbits, same = found.shots.orbits, found.simultaneous[j]
    crossing = [found.inside[j] & (orbits == orbit) for orbit in np.unique(orbits[found.inside[j]])]
    shots = np.flatnonzero(max(
        crossing, key=lambda one: (np.any(same[np.isin(orbits, orbits[one])]), np.count_nonzero(one)),
        default=found.inside[j],
    ))  # fmt: skip
    shots = shots[np.argsort(found.places[j, shots, 0])]
    return shots, found.places[j, shots, 0]


def _marks(
    panel: Axes, registration: CaseRegistration, j: int, order: Sequence[int], lines_per_inch: float
) -> None:
    """Footprints of all profiles; the first one's with their numbers, before below them and after above them."""
    low, high = panel.get_xlim()
    for state, profiles in registration.states():
        for p, marker in zip(reversed(order), reversed(MARKERS[: len(order)]), strict=True):
            first = p == order[0]
            found = profiles[p].found
            places = found.places[j]
            shown = np.flatnonzero(found.inside[j] & (places[:, 0] >= low) & (places[:, 0] <= high))
            panel.plot(
                places[shown, 0], places[shown, 1], ls="", marker=marker, ms=3.8 if first else 2.8, mew=0.8,
                mec=STATE_COLOURS[state], mfc=STATE_COLOURS[state] if state == "adjusted" else "none", zorder=4 + first,
            )
            if first:
                side = "above" if (state == _upper(registration, j, p)) else "below"
                step = _number_step(places[found.inside[j], 0], lines_per_inch)
                draw_numbers(panel, places, shown[(shown + 1) % step == 0], STATE_COLOURS[state], side, 6.2)


def _upper(registration: CaseRegistration, j: int, p: int) -> str:
    """Under which orientation a profile lies at higher samples."""
    middle = {
        state: float(np.nanmean(profiles[p].found.places[j, :, 1])) for state, profiles in registration.states()
    }
    return max(middle, key=lambda state: middle[state])


def _number_step(lines: Array, lines_per_inch: float) -> int:
    """Every how many footprints there is room for a number."""
    gap = float(np.median(np.abs(np.diff(np.sort(lines))))) / lines_per_inch if lines.size > 1 else 1.0
    return next((step for step in (1, 2, 5, 10, 20, 50) if step * gap > _ROOM), 100)


def draw_numbers(panel: Axes, places: Array, which: Index, colour: str, side: str, size: float) -> None:
    """Footprint numbers above, below, right or left of (`side`) their marks at places (n, 2), x and y.

    Drawn as outlines in one go: matplotlib lays each text out twice, which takes longer than all the rest.
    """
    if not which.size or panel.figure is None:
        return
    paths = [_outline(str(k + 1), size, side) for k in which.tolist()]
    for edge, face, width in (("black", "black", 1.3), ("none", colour, 0.0)):
        drawn = PathCollection(
            paths, offsets=places[which], offset_transform=panel.transData, edgecolors=edge, facecolors=face,
            linewidths=width, zorder=6,
        )
        drawn.set_transform(panel.figure.dpi_scale_trans.frozen().scale(1.0 / 72.0))
        panel.add_collection(drawn, autolim=False)


@cache
def _outline(text: str, size: float, side: str) -> MatplotlibPath:
    """Outline in points of a number beside its mark, which is at the origin."""
    path = MatplotlibPath.make_compound_path(*(
        Affine2D().translate(_ADVANCE * k, 0.0).transform_path(_digit(digit)) for k, digit in enumerate(text)
    ))
    width, height = _ADVANCE * len(text) * size, _DIGIT * size
    right, up = {
        "above": (-0.5 * width, _GAP), "below": (-0.5 * width, -_GAP - height),
        "right": (_GAP + 1.0, -0.5 * height), "left": (-_GAP - 1.0 - width, -0.5 * height),
    }[side]
    return Affine2D().scale(size).translate(right, up).transform_path(path)


@cache
def _digit(digit: str) -> MatplotlibPath:
    """Outline of a digit in units of the type's size."""
    return TextPath((0.0, 0.0), digit, size=1.0, prop=FontProperties(family="DejaVu Sans"))


def _relief(panel: Axes, registration: CaseRegistration, j: int, p: int, heights: Array) -> None:
    """Heights of a profile over the lines at which it falls, under the best orientation there is."""
    (state, _), (mine, lines) = list(registration.states())[-1], longest_profile(registration, j, p)
    first, last = panel.get_xlim()
    here = heights[mine[(lines >= first) & (lines <= last)]]
    if not here.size:
        panel.set_yticks([])
        return
    low, high = float(here.min()), float(here.max())
    lack = 0.5 * max(0.0, _LEAST_RELIEF - (high - low))
    span = high - low + 2.0 * lack
    panel.set_ylim(low - lack - 0.08 * span, high + lack + 0.12 * span)
    panel.fill_between(lines, panel.get_ylim()[0], heights[mine], color=STATE_COLOURS[state], alpha=0.18, lw=0.0)
    panel.plot(lines, heights[mine], color=INK, lw=0.8, marker="*", ms=3.6, mew=0.0)


def _key(sheet: Sheet, registration: CaseRegistration, order: Sequence[int]) -> None:
    handles = [
        Line2D([], [], ls="", marker="o", ms=5, mec=STATE_COLOURS[state], label=STATE_WORDS[state],
               mfc=STATE_COLOURS[state] if state == "adjusted" else "none")
        for state, _ in registration.states()
    ]
    for p, marker in zip(order, MARKERS, strict=False):
        name = short(registration.before[p].name, 24)
        handles.append(Line2D([], [], ls="", marker=marker, ms=5, mec=INK, mfc="none", label=f"profile {name}"))
    sheet.legend(handles)


def _overlay_caption(registration: CaseRegistration, j: int, order: Sequence[int], drawn: bool) -> str:
    """What one sees, with figures."""
    parts = []
    for p in order:
        profile = registration.before[p]
        count = int(profile.found.inside[j].sum())
        words_of = f"{count} of {profile.found.shots.times.size} shots of {profile.name} fall in the image"
        if registration.after:
            moved = registration.after[p].found.places[j] - profile.found.places[j]
            moved = moved[profile.found.inside[j]]
            words_of += (
                f" and move by {number(float(np.nanmean(moved[:, 0])))} lines and "
                f"{number(float(np.nanmean(moved[:, 1])))} samples on the average"
            )
        parts.append(words_of)
    text = "; ".join(parts)
    first = registration.before[order[0]].name
    text += f"; numbers count the shots of {first} from its first in the case; heights have a scale for each strip"
    return text if drawn else text + "; the image's pixels are not at hand, and its frame stands for it"


# --- pictures


def stretch(pixels: Pixels | None) -> tuple[float, float]:
    """Grey values drawn black and white: all but half a per cent of the pixels lie between."""
    if pixels is None:
        return 0.0, 255.0
    some = pixels[:: max(1, pixels.shape[0] // 500), :: max(1, pixels.shape[1] // 200)]
    low, high = np.quantile(some, [0.005, 0.995])
    return float(low), float(max(high, low + 1.0))


def picture(
    panel: Axes,
    pixels: Pixels | None,
    limits: tuple[float, float],
    image: PushbroomImage,
    lines: tuple[float, float],
    samples: tuple[float, float],
    inches: float,
    across_inches: float,
    on_its_side: bool = False,
) -> None:
    """Part of an image between lines and between samples, drawn on so many inches; what lies beside it is black."""
    panel.grid(False)
    panel.set_facecolor("black")
    l0, l1 = max(0, int(lines[0])), min(image.lines, int(np.ceil(lines[1])))
    s0, s1 = max(0, int(samples[0])), min(image.samples, int(np.ceil(samples[1])))
    if l0 >= l1 or s0 >= s1:
        return
    if pixels is None:
        box = (l0, l1, s0, s1) if on_its_side else (s0, s1, l0, l1)
        panel.fill_between(box[:2], box[2], box[3], color=_BLANK, lw=0.0, zorder=0)
        return
    steps = [max(1, int((l1 - l0) / (inches * _PER_INCH))), max(1, int((s1 - s0) / (across_inches * _PER_INCH)))]
    part = averaged(pixels[l0:l1, s0:s1], *steps)
    l1, s1 = l0 + part.shape[0] * steps[0], s0 + part.shape[1] * steps[1]
    panel.imshow(
        part.T if on_its_side else part, cmap="gray", vmin=limits[0], vmax=limits[1], aspect="auto",
        extent=(l0, l1, s0, s1) if on_its_side else (s0, s1, l1, l0),
        origin="lower" if on_its_side else "upper", interpolation="bilinear", zorder=0,
    )


def averaged(pixels: NDArray[Any], down: int, across: int) -> NDArray[np.float32]:
    """Means of blocks of `down` lines and `across` samples; what is left of a block at the end is cut off."""
    rows, columns = pixels.shape[0] // down, pixels.shape[1] // across
    blocks = pixels[: rows * down, : columns * across].reshape(rows, down, columns, across)
    return np.asarray(blocks.mean(axis=(1, 3), dtype=np.float32))
