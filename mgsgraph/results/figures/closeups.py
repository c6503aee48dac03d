"""Close-ups of a pair of images around a few footprints, before an adjustment and after it.

A footprint belongs to one place of the ground. Where the two images show it at different things, as footprint 77 at
Gusev (Yoon & Shan 2005, Figure 3), they contradict each other; the second image's panels also show, as a square, where
the footprint's place in the first image lies in the second one, as the images' tie points know it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from mgsgraph.files.rasters.pictures import Pixels
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.network.footprints import Misregistration
from mgsgraph.registration.case import CaseRegistration
from mgsgraph.results.figures.overlay import (
    STATE_COLOURS,
    STATE_WORDS,
    averaged,
    draw_numbers,
    footprint_heights,
    ground_size,
    picture,
    stretch,
)
from mgsgraph.results.figures.sheet import INK, MOST_SHEETS, Sheet, new_sheet, number, plain_style, sheet_name, short
from mgsgraph.text import listed
from mgsgraph.units import KM

_WINDOWS = 3
"""Places that are shown."""
_SPACINGS = 2.7
"""Half the side of a window in distances between footprints."""
_UNKNOWN = 900.0
"""m, half the side where that distance is unknown."""
_SIDES = (3.5, 2.7, 2.0)
"""inch, side of a window when one, two or three places are shown."""
_CONTRAST = 16
"""Blocks of a window, each way, over which its contrast is taken."""
_TRANSFERRED = "#F0E442"
"""The palette's yellow."""


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """Two images and one profile, under each orientation."""

    profile: int
    images: tuple[int, int]
    found: tuple[Misregistration, ...]
    """Under the nominal orientation and, with a solution, under the adjusted one."""

    @property
    def shared(self) -> Index:
        """Shots that both images see under every orientation."""
        shots = self.found[0].shots
        for one in self.found[1:]:
            shots = np.intersect1d(shots, one.shots)
        return shots


def closeup_sheets(registration: CaseRegistration, pixels: Sequence[Pixels | None]) -> Iterator[Sheet]:
    """One sheet for each pair of images that are compared, with the profile of which they share most footprints."""
    pairs = _pairs(registration)[:MOST_SHEETS]
    for n, pair in enumerate(pairs):
        yield _closeups(registration, pair, pixels, sheet_name("closeups", n + 1, len(pairs)))


def _pairs(registration: CaseRegistration) -> list[_Pair]:
    names = [image.name for image in registration.images]
    best: dict[tuple[int, int], _Pair] = {}
    states = [profiles for _, profiles in registration.states()]
    for p in range(len(registration.before)):
        for one in registration.before[p].discrepancies:
            images = names.index(one.against), names.index(one.image)
            same = [
                other for profiles in states for other in profiles[p].discrepancies
                if (other.against, other.image) == (one.against, one.image)
            ]
            pair = _Pair(p, images, tuple(same))
            if len(same) < len(states) or not pair.shared.size:
                continue
            if images not in best or pair.shared.size > best[images].shared.size:
                best[images] = pair
    return sorted(best.values(), key=lambda pair: -pair.shared.size)


@plain_style()
def _closeups(registration: CaseRegistration, pair: _Pair, pixels: Sequence[Pixels | None], name: str) -> Sheet:
    profile = registration.before[pair.profile]
    half = _half_side(profile.found.shots.spacing)
    images = [registration.images[j] for j in pair.images]
    halves = [half / ground_size(image) for image in images]
    chosen = _worth_seeing(registration, pair, pixels, halves[0])
    states = list(registration.states())
    first, second = (short(image.name, 24) for image in images)
    shots = listed([str(k + 1) for k in chosen])
    caption = (
        f"Footprints of {profile.name} around {shots} in {first} and {second}, each window "
        f"{number(2.0 * half / KM)} km wide and high on the ground, lines downward; if the orientation is right, "
        "a number lies on the same thing in both; yellow squares: where the first image's place lies in the second one "
        f"according to the images' tie points; {_lengths(registration, pair)}."
    )
    columns, rows, wide = 2 * chosen.size, len(states), _SIDES[chosen.size - 1]
    title = f"{first} and {second}: close-ups"
    sheet = new_sheet(name, 0.5 + columns * (wide + 0.08), rows * (wide + 0.08) + 0.5, title, caption)
    grid = sheet.panels(rows, columns)
    limits = [stretch(pixels[j]) for j in pair.images]
    for row, (state, profiles) in enumerate(states):
        found, off = profiles[pair.profile].found, pair.found[row]
        for c in range(columns):
            k, side = int(chosen[c // 2]), c % 2
            panel, j = grid[row, c], pair.images[side]
            middle = states[-1][1][pair.profile].found.places[j, k]
            lines, samples = _window(middle, halves[side])
            picture(panel, pixels[j], limits[side], registration.images[j], lines, samples, wide, wide)
            panel.set(xlim=samples, ylim=lines[::-1], xticks=[], yticks=[])
            _draw(panel, found.places[j], found.inside[j], k, state)
            if side:
                _transferred(panel, found.places[j], off)
            panel.set_title(f"{(first, second)[side]} around {k + 1}" if row == 0 else "")
            panel.set_xlabel(_apart(pair, k) if side and row == rows - 1 else "")
        grid[row, 0].set_ylabel("before" if row == 0 else "after")
    handles = [
        Line2D([], [], ls="", marker="o", ms=5, color=STATE_COLOURS[state], label=STATE_WORDS[state])
        for state, _ in states
    ]
    handles.append(
        Line2D([], [], color=_TRANSFERRED, marker="s", ms=5, mfc="none", mec=INK,
               label="its place in the first image, transferred")
    )
    sheet.legend(handles)
    return sheet


def _half_side(spacing: float) -> float:
    return _SPACINGS * spacing if np.isfinite(spacing) else _UNKNOWN


def _window(middle: Array, half: Array) -> tuple[tuple[float, float], tuple[float, float]]:
    """Lines and samples around a place, `half` (2,) lines and samples each way."""
    down, across = half
    line, sample = float(middle[0]), float(middle[1])
    return (line - float(down), line + float(down)), (sample - float(across), sample + float(across))


def _worth_seeing(
    registration: CaseRegistration, pair: _Pair, pixels: Sequence[Pixels | None], half: Array
) -> Index:
    """The footprint with most to be seen around it, in each third of the profile."""
    image = registration.images[pair.images[0]]
    places = list(registration.states())[-1][1][pair.profile].found.places[pair.images[0]]
    shared, picture_ = pair.shared, pixels[pair.images[0]]
    heights, _ = footprint_heights(registration.before[pair.profile], image)
    relief = np.abs(heights - 0.5 * (np.roll(heights, 2) + np.roll(heights, -2)))
    score = relief[shared] if picture_ is None else np.array(
        [_contrast(picture_, *_window(places[k], half)) for k in shared]
    )
    parts = np.array_split(np.arange(shared.size), min(_WINDOWS, shared.size))
    return np.array([shared[part[np.argmax(score[part])]] for part in parts])


def _contrast(pixels: Pixels, lines: tuple[float, float], samples: tuple[float, float]) -> float:
    """Standard deviation of the coarse grey values in a window; what lies outside the image counts against it."""
    low, high = [max(0, int(lines[0])), max(0, int(samples[0]))], [max(0, int(lines[1])), max(0, int(samples[1]))]
    steps = [max(1, int(ends[1] - ends[0]) // _CONTRAST) for ends in (lines, samples)]
    # some four pixels of each block, each way, will do
    part = pixels[low[0] : high[0] : max(1, steps[0] // 4), low[1] : high[1] : max(1, steps[1] // 4)]
    if min(part.shape) < _CONTRAST:
        return 0.0
    covered = min(1.0, (part.shape[0] * part.shape[1]) / (4.0 * _CONTRAST) ** 2)
    blocks = averaged(part, max(1, part.shape[0] // _CONTRAST), max(1, part.shape[1] // _CONTRAST))
    return float(blocks.std() * covered)


def _draw(panel: Axes, places: Array, inside: Mask, chosen: int, state: str) -> None:
    """Numbered footprints in a window."""
    which = np.flatnonzero(inside & _seen(panel, places))
    colour = STATE_COLOURS[state]
    panel.plot(
        places[which, 1], places[which, 0], ls="", marker="o", ms=4.0, mew=0.6, mec="black", mfc=colour, zorder=5
    )
    for some, size in ((which[which != chosen], 7.0), (which[which == chosen], 9.5)):
        draw_numbers(panel, places[:, ::-1], some, colour, "right", size)


def _transferred(panel: Axes, places: Array, off: Misregistration) -> None:
    """Where the first image's places lie in the second one, and lines from there to where it has them itself."""
    own = places[off.shots]
    ends = np.stack([own - off.pixels, own], axis=1)
    start, stop = _seen(panel, ends[:, 0]), _seen(panel, ends[:, 1])
    both = start & stop
    panel.plot(ends[both, :, 1].T, ends[both, :, 0].T, color=_TRANSFERRED, lw=1.1, zorder=3)
    panel.plot(
        ends[start, 0, 1], ends[start, 0, 0], ls="", marker="s", ms=5.5, mew=1.0, mec=_TRANSFERRED, mfc="none", zorder=4
    )
    squares = np.full_like(places, np.nan)
    squares[off.shots] = ends[:, 0]
    draw_numbers(panel, squares[:, ::-1], off.shots[start], _TRANSFERRED, "left", 6.0)


def _seen(panel: Axes, places: Array) -> Mask:
    """Which places (line, sample) lie in a panel and not at its very edge."""
    (left, right), (low, high) = panel.get_xlim(), panel.get_ylim()[::-1]
    margin = 0.03 * (high - low)
    with np.errstate(invalid="ignore"):
        return (
            (places[:, 0] > low + margin) & (places[:, 0] < high - margin)
            & (places[:, 1] > left) & (places[:, 1] < right)
        )


def _apart(pair: _Pair, shot: int) -> str:
    """How far square and mark of one footprint are apart."""
    lengths = [float(np.hypot(*one.metres[one.shots == shot][0])) for one in pair.found]
    return f"{shot + 1}: {number(lengths[0])} m apart" + "".join(f", then {number(length)} m" for length in lengths[1:])


def _lengths(registration: CaseRegistration, pair: _Pair) -> str:
    """How far square and mark are apart, in words."""
    parts = [
        f"{number(float(np.mean(np.hypot(*one.metres.T))))} m {'apart before' if row == 0 else 'after'} the adjustment"
        for row, one in enumerate(pair.found)
    ]
    return f"on average square and mark are {' and '.join(parts)}"
