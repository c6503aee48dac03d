"""Laser footprints on images, each image with the elevation profile that crosses it, and by how much two images
contradict each other about footprints.

An image lies on its side (lines to the right), so that its right edge is the upper one. Heights are drawn above that
edge, as in Figure 4 of Yoon & Shan (2005).
"""

from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from mgsgraph.files.pvl import cube_of, read_label
from mgsgraph.files.rasters.pictures import Pixels, as_bytes, is_moc, read_picture
from mgsgraph.geometry.body import ellipsoidal_heights
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network.footprints import Misregistration
from mgsgraph.registration.case import CaseRegistration, ProfileRegistration
from mgsgraph.results.figures.sheet import (
    AFTER,
    BEFORE,
    INK,
    LIGHT,
    MOST_SHEETS,
    SOFT,
    Sheet,
    new_sheet,
    number,
    plain_style,
    save,
    sheet_name,
)
from mgsgraph.text import root_mean_square, short

_ON_IMAGES = {"nominal": BEFORE, "adjusted": LIGHT}
_COLORS = {"nominal": BEFORE, "adjusted": AFTER}
_STATE_LABELS = {"nominal": "before: archived footprint, nominal orientation", "adjusted": "after: both adjusted"}
_MARKERS = "o^sDv"
"""One for each profile in an image."""
_WIDTH, _TALL, _HEIGHTS, _MOST_STRIPS = 10.6, 1.45, 0.8, 4
"""inch: width of a strip of an image, its least height, that of an elevation panel; strips of an image."""
_ACROSS = 300
"""Pixels across a strip that are drawn at most."""
_NUMBER_STEP, _MOST_NUMBERED = 10, 300
"""Step between footprints that bear their number; a strip with more footprints than this has a larger step."""
_DIRECTIONS = ("along the flight", "across the flight")


def write_registration_figures(registration: CaseRegistration, folder: Path) -> list[str]:
    """Draw a registration: numbered footprints on each image with the heights beside it, and the discrepancies along
    the images; returns the names of the files. InputError if the pixels of an image can't be read.
    """
    return save(chain(overlay_sheets(registration), discrepancy_sheets(registration)), folder)


def pixels_of(path: Path | None) -> Pixels | None:
    """An image's pixels; None where the case names no file of them, or the label of a cube which isn't at hand."""
    if path is None:
        return None
    if path.suffix.lower() != ".cub" and is_moc(path) and cube_of(read_label(path)) is not None:
        cubes = [path.with_suffix(suffix) for suffix in (".cub", ".CUB") if path.with_suffix(suffix).is_file()]
        if not cubes:
            return None
        path = cubes[0]
    return as_bytes(read_picture(path))


# --- footprints on images


def overlay_sheets(registration: CaseRegistration) -> Iterator[Sheet]:
    """One sheet for each of the images with most footprints."""
    counts = np.sum([profile.footprints.inside.sum(axis=1) for profile in registration.before], axis=0)
    chosen = sorted(np.argsort(-counts, kind="stable")[: min(MOST_SHEETS, np.count_nonzero(counts))].tolist())
    omitted = "; images with fewer footprints are not drawn" if np.count_nonzero(counts) > len(chosen) else ""
    for n, j in enumerate(chosen):
        pixels = pixels_of(registration.pictures[j])
        yield _overlay_sheet(registration, j, pixels, sheet_name("overlay", n + 1, len(chosen)), omitted)


@plain_style()
def _overlay_sheet(registration: CaseRegistration, j: int, pixels: Pixels | None, name: str, omitted: str) -> Sheet:
    image, order = registration.images[j], _ordered_profiles(registration, j)
    strips, width, height = _image_strips(image)
    caption = _overlay_caption(registration, j, order, pixels is not None) + omitted + "."
    title, ratios = f"Laser footprints in {short(image.name, 60)}", [_HEIGHTS, height] * strips
    sheet = new_sheet(name, width + 1.06, sum(ratios) + 0.36 * strips + 0.4, title, caption, gap=0.02)
    grid = sheet.panels(len(ratios), 1, heights=ratios)[:, 0]
    heights, above = footprint_heights(registration.before[order[0]], image)
    track, lines = _track_shots(registration, j, order[0])
    for k in range(strips):
        ends = image.lines * k / strips, image.lines * (k + 1) / strips
        relief, strip = grid[2 * k], grid[2 * k + 1]
        _draw_picture(strip, pixels, image)
        strip.set(xlim=ends, ylim=(0.0, image.samples), ylabel="sample (px)")
        strip.locator_params(axis="y", nbins=4)
        _draw_footprints(strip, registration, j, order)
        relief.plot(lines, heights[track], color=INK, lw=0.8, marker="*", ms=3.6, mew=0.0)
        relief.set(xlim=ends, ylabel="height (m)")
        relief.tick_params(labelbottom=False, bottom=False)
        relief.locator_params(axis="y", nbins=4)
    grid[-1].set_xlabel("line (px)")
    grid[0].set_title(
        f"Heights above the {above} on the image's right edge; the image lies on its side, lines go to the right"
    )
    states = [(_ON_IMAGES[state], state) for state, _ in registration.states()]
    sheet.legend([
        *(Line2D([], [], ls="", marker="o", ms=5, color=color, label=_STATE_LABELS[state]) for color, state in states),
        *(_profile_mark(k, registration.before[p].name) for k, p in enumerate(order)),
    ])
    return sheet


def _profile_mark(k: int, name: str) -> Line2D:
    """The entry in a legend of the k-th profile."""
    marker = _MARKERS[k % len(_MARKERS)]
    return Line2D([], [], ls="", marker=marker, ms=5, mec=INK, mfc="none", label=f"profile {short(name, 24)}")


def _image_strips(image: PushbroomImage) -> tuple[int, float, float]:
    """Into how many strips an image is cut, and their width and height in inch, true to the ground."""
    _, by_pixel = image.image_to_ground(*image.middle)
    along, across = np.linalg.norm(by_pixel[0], axis=0)
    aspect = float(image.samples * across / (image.lines * along))
    strips = int(np.clip(np.ceil(_TALL / (_WIDTH * aspect)), 1, _MOST_STRIPS))
    return strips, _WIDTH, float(np.clip(_WIDTH * aspect * strips, 0.6, 2.0 * _TALL))


def _ordered_profiles(registration: CaseRegistration, j: int) -> list[int]:
    """Profiles that fall in an image; the one taken along with it first, then those with most footprints."""
    counts = [int(profile.footprints.inside[j].sum()) for profile in registration.before]
    simultaneous = [bool(np.any(profile.footprints.simultaneous[j])) for profile in registration.before]
    order = sorted((p for p, count in enumerate(counts) if count), key=lambda p: (not simultaneous[p], -counts[p]))
    return order[: len(_MARKERS)]


def _track_shots(registration: CaseRegistration, j: int, p: int) -> tuple[Index, Array]:
    """Shots (n,) of a profile that fall in an image, and their lines (n,) in order, under the best orientation there
    is; those of one orbit, for a file may hold several: the one taken along with the image, else the longest.
    """
    footprints = list(registration.states())[-1][1][p].footprints
    inside, orbits, simultaneous = footprints.inside[j], footprints.shots.orbits, footprints.simultaneous[j]
    orbit_numbers = np.unique(orbits[inside & simultaneous] if np.any(inside & simultaneous) else orbits[inside])
    orbit = max(orbit_numbers.tolist(), key=lambda orbit: np.count_nonzero(inside & (orbits == orbit)), default=None)
    shots = np.flatnonzero(inside & (orbits == orbit))
    shots = shots[np.argsort(footprints.places[j, shots, 0])]
    return shots, footprints.places[j, shots, 0]


def footprint_heights(profile: ProfileRegistration, image: PushbroomImage) -> tuple[Array, str]:
    """Heights (n,) in m of archived footprints, and above what: the areoid, or the ellipsoid where that is unknown."""
    shots = profile.footprints.shots
    heights = np.linalg.norm(shots.footprints, axis=1) - shots.areoid_radii
    if np.all(np.isfinite(heights)):
        return heights, "areoid"
    return ellipsoidal_heights(shots.footprints, image.body), "ellipsoid"


def _draw_picture(panel: Axes, pixels: Pixels | None, image: PushbroomImage) -> None:
    """A whole image on its side; gray where there are no pixels."""
    panel.grid(False)
    panel.set_facecolor("#D9D9D9")
    if pixels is not None:
        step = max(1, image.samples // _ACROSS)
        means = averaged(pixels, step, step)
        low, high = np.quantile(means, [0.005, 0.995]).tolist()
        extent = 0.0, float(means.shape[0] * step), 0.0, float(means.shape[1] * step)
        panel.imshow(means.T, cmap="gray", vmin=low, vmax=max(high, low + 1.0), aspect="auto", extent=extent,
                     origin="lower", interpolation="bilinear", zorder=0)  # fmt: skip


def averaged(pixels: NDArray[Any], down: int, across: int) -> NDArray[np.float32]:
    """Means of blocks of `down` lines and `across` samples; what is left of a block at the end is cut off."""
    rows, columns = pixels.shape[0] // down, pixels.shape[1] // across
    blocks = pixels[: rows * down, : columns * across].reshape(rows, down, columns, across)
    return np.asarray(blocks.mean(axis=(1, 3), dtype=np.float32))


def _draw_footprints(panel: Axes, registration: CaseRegistration, j: int, order: Sequence[int]) -> None:
    """Footprints of all profiles; the first one's with their numbers, before below them and after above them."""
    low, high = panel.get_xlim()
    for state, profiles in registration.states():
        color, adjusted = _ON_IMAGES[state], state == "adjusted"
        for k, p in enumerate(order):
            places = profiles[p].footprints.places[j]
            shown = np.flatnonzero(profiles[p].footprints.inside[j] & (places[:, 0] >= low) & (places[:, 0] <= high))
            panel.plot(*places[shown].T, ls="", marker=_MARKERS[k], ms=2.8 if k else 3.8, mew=0.8, mec=color,
                       mfc=color if adjusted else "none", zorder=5 - bool(k))  # fmt: skip
            if k == 0 and shown.size:
                step = _NUMBER_STEP * -(-shown.size // _MOST_NUMBERED)
                for shot in shown[(shown + 1) % step == 0].tolist():
                    panel.annotate(f"{shot + 1}", places[shot], (0.0, 3.5 if adjusted else -3.5), color=color, size=8.0,
                                   weight="bold", textcoords="offset points", ha="center", zorder=6,
                                   va="bottom" if adjusted else "top",
                                   path_effects=[withStroke(linewidth=1.4, foreground="black")])  # fmt: skip


def _overlay_caption(registration: CaseRegistration, j: int, order: Sequence[int], has_pixels: bool) -> str:
    """Caption with the main numbers."""
    sentences = []
    for p in order:
        before = registration.before[p].footprints
        inside = before.inside[j]
        sentence = f"{int(inside.sum())} of {inside.size} shots of {registration.before[p].name} fall in the image"
        if registration.after:
            lines, samples = np.nanmean((registration.after[p].footprints.places[j] - before.places[j])[inside], 0)
            sentence += f" and move by {number(lines)} lines and {number(samples)} samples on average"
        sentences.append(sentence)
    first = registration.before[order[0]].name
    text = f"{'; '.join(sentences)}; numbers count the shots of {first} from its first in the case"
    return text if has_pixels else text + "; the image's pixels are not at hand, and its frame stands for it"


# --- discrepancies


def discrepancy_sheets(registration: CaseRegistration) -> Iterator[Sheet]:
    """One sheet for each pair of images with footprints in common."""
    pairs = list(dict.fromkeys(
        (discrepancy.against, discrepancy.image) for profile in registration.before
        for discrepancy in profile.discrepancies if discrepancy.shots.size
    ))
    shown = pairs[:MOST_SHEETS]
    omitted = f"; of {len(pairs)} pairs the first {len(shown)} are drawn" if pairs[MOST_SHEETS:] else ""
    for n, pair in enumerate(shown):
        yield _discrepancy_sheet(registration, pair, sheet_name("discrepancy", n + 1, len(shown)), omitted)


@plain_style()
def _discrepancy_sheet(registration: CaseRegistration, pair: tuple[str, str], name: str, omitted: str) -> Sheet:
    discrepancies = [
        (state, p, discrepancy) for state, profiles in registration.states() for p, profile in enumerate(profiles)
        for discrepancy in profile.discrepancies if (discrepancy.against, discrepancy.image) == pair
        and discrepancy.shots.size
    ]  # fmt: skip
    first, second = (short(image_name, 30) for image_name in pair)
    states = list(dict.fromkeys(state for state, *_ in discrepancies))
    clauses = []
    for state in states:
        metres = np.concatenate([discrepancy.metres for key, _, discrepancy in discrepancies if key == state])
        along, across = (number(rms) for rms in root_mean_square(metres, 0))
        when = "before" if state == "nominal" else "after"
        clauses.append(f"{along} m along and {across} m across the flight {when} the adjustment")
    caption = (
        f"{first} and {second} disagree about the footprints by {', by '.join(clauses)} (rms). Bands: one standard "
        f"deviation of this comparison, which rests on the tie points{omitted}."
    )
    sheet = new_sheet(name, 9.6, 5.6, f"Discrepancy between {first} and {second} at the footprints", caption)
    grid = sheet.panels(2, 1, sharex="col")[:, 0]
    for k, panel in enumerate(grid):
        panel.axhline(0.0, color=SOFT, lw=0.8, zorder=1)
        for state, p, discrepancy in discrepancies:
            _draw_discrepancy(panel, discrepancy, k, _COLORS[state], _MARKERS[p % len(_MARKERS)])
        panel.set_ylabel(f"{_DIRECTIONS[k]} (m)")
        panel.margins(y=0.1)
    grid[0].set_title(f"{second}: projected position minus the one that {first} and the tie points give")
    grid[1].set_xlabel(f"line of {second} (px)")
    sheet.legend([
        *(Line2D([], [], color=_COLORS[s], marker="o", ms=4, lw=0.9, label=_STATE_LABELS[s]) for s in states),
        *(_profile_mark(p, registration.before[p].name) for p in dict.fromkeys(p for _, p, _ in discrepancies)),
    ])
    return sheet


def _draw_discrepancy(panel: Axes, discrepancy: Misregistration, direction: int, color: str, marker: str) -> None:
    order = np.argsort(discrepancy.lines, kind="stable")
    lines, values, sigmas = discrepancy.lines[order], discrepancy.metres[order,
                                                                         direction], discrepancy.metre_sigmas[order,
                                                                                                              direction]
    panel.plot(lines, values, color=color, lw=0.8, marker=marker, ms=2.8, mew=0.7, mfc="white", zorder=3)
    if np.all(np.isfinite(sigmas)):
        panel.fill_between(lines, values - sigmas, values + sigmas, color=color, alpha=0.18, lw=0.0, zorder=2)
