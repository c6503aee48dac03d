"""Corrections of passes over time: one sheet for each pass, and all passes on one sheet.

A pass's sheet has its images as bars over the time that they were taken, and below them the corrections of position
(along, across, radial) and of attitude (roll, pitch, yaw) with 1-sigma bands and orientation images as dots.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import StripCorrections, node_times, strip_corrections
from mgsgraph.geometry.records import Array
from mgsgraph.network.joining import seconds
from mgsgraph.results.figures.sheet import (
    AFTER,
    INK,
    MOST_SHEETS,
    SOFT,
    Sheet,
    left_out,
    new_sheet,
    number,
    plain_style,
    sheet_name,
    short,
)
from mgsgraph.text import many
from mgsgraph.units import MGON

PLACES, _PER_INTERVAL = 101, 6
"""Places drawn in a pass at least, and between two nodes."""
_MOST_PLACES = 4000
"""Of a pass, whose curves are no denser."""
_MARK, _MANY = 3.0, 60
"""pt of a node's mark, and nodes from which on it is half as large."""
_LABELLED = 14
"""Images whose bars have their names; more lie in lanes without."""
_EARLY = 0.55
"""Share of a pass's time before which a bar begins whose name stands at its beginning, not at its end."""
_LANES = 30
"""Lanes of bars at most; more images share them."""
MOST_PASSES = 10
"""Passes with a sheet each among the files of a result; a report page has fewer."""
_ALIKE = 0.9
"""Correlation from which on one may stand for another."""
_IN_OVERVIEW = 60
"""Passes on the sheet of all."""
_ROWS = ("along (m)", "across (m)", "radial (m)", "roll (mgon)", "pitch (mgon)", "yaw (mgon)")
_UNITS = np.array([1.0] * 3 + [MGON] * 3)


@dataclass(frozen=True, slots=True, eq=False)
class DrawnPass:
    """One pass over its time."""

    title: str
    """Name."""
    places: Array
    """(n,) s past its first node."""
    curves: list[tuple[Array, Array]]
    """Correction and sigma (n,) along, across, radial in m, and of roll, pitch, yaw in mgon."""
    nodes: Array
    """(k,) s past the first one."""
    at_nodes: list[Array]
    """Corrections (k,) there."""
    images: list[tuple[str, float, float]]
    """Name of each image, and s past the first node of its first and last line."""
    coupling: float
    """Largest correlation between a position and a rotation of the node in the middle."""


def pass_sheets(solution: Solution, most: int = MOST_SHEETS) -> Iterator[Sheet]:
    """All passes on a sheet, where there are several, then a sheet for each of the first ones."""
    count = len(solution.network.passes)
    if count > 1:
        yield _overview(solution)
    for k in range(min(count, most)):
        name = sheet_name("pass", k + 1, min(count, most)) if count > 1 else "passes"
        yield _pass_sheet(drawn_strip(solution, k), name, left_out(count, min(count, most), f"first {most}", "passes"))


def drawn_strip(solution: Solution, strip: int) -> DrawnPass:
    """A pass with its nodes; at so many places that each interval between nodes shows its curve."""
    one, nodes = solution.network.passes[strip], node_times(solution, strip)
    start, stop = one.nodes.coverage
    places = min(max(PLACES, _PER_INTERVAL * nodes.size + 1), _MOST_PLACES)
    times = np.linspace(start, stop, places) + one.nodes.epoch
    series, there = strip_corrections(solution, strip, times), strip_corrections(solution, strip, nodes)
    variable = int(solution.network.first_of_passes[strip]) + len(one.nodes) // 2
    pictures = solution.network.pictures(strip)
    return DrawnPass(
        one.name, times - times[0], [(series.values[:, c] / _UNITS[c], series.sigmas[:, c] / _UNITS[c])
                                     for c in range(6)],
        nodes - times[0], [there.values[:, c] / _UNITS[c] for c in range(6)],
        [(image.name, *(time - times[0] for time in seconds(image))) for image in pictures],
        largest_correlation(solution.joint_covariance.block(variable, variable)),
    )  # fmt: skip


def largest_correlation(covariance: Array) -> float:
    """Between one of the first three unknowns, a position's, and one of the others; 0 where one has no sigma."""
    sigmas = np.sqrt(np.diagonal(covariance))
    if not np.all(sigmas > 0.0):
        return 0.0
    return float(np.abs(covariance / np.outer(sigmas, sigmas))[:3, 3:].max())


# --- one pass


@plain_style()
def _pass_sheet(drawn: DrawnPass, name: str, omitted: str) -> Sheet:
    labelled = len(drawn.images) <= _LABELLED
    lanes = _lanes(drawn.images, labelled)
    bars = 0.35 + (0.17 if labelled else 0.07) * (max(lanes) + 1)
    sheet = new_sheet(
        name, 10.2, 5.4 + bars, f"Corrections of the trajectory of pass {short(drawn.title, 60)}",
        _caption(drawn) + omitted + ".",
    )  # fmt: skip
    grid = sheet.panels(4, 2, heights=[bars, 1.7, 1.7, 1.7], sharex="all")
    for column in range(2):
        _draw_bars(grid[0, column], drawn, lanes, labelled)
        for row in range(3):
            _draw(grid[row + 1, column], drawn, 3 * column + row)
        grid[3, column].set_xlabel("time past the first orientation image (s)")
    grid[0, 0].set_xlim(*_limits(drawn))
    sheet.legend(_handles())
    return sheet


def _limits(drawn: DrawnPass) -> tuple[float, float]:
    """Of the time, so that no dot lies on an edge."""
    length = float(drawn.places[-1])
    return -0.015 * length, 1.015 * length


def _handles() -> list[Artist]:
    return [
        Line2D([], [], color=AFTER, label="adjusted minus nominal"),
        Patch(color=AFTER, alpha=0.22, lw=0.0, label="± 1 sigma (sigma0 = 1)"),
        Line2D([], [], color=INK, ls="", marker="o", ms=_MARK, label="orientation images"),
        Patch(color=SOFT, label="images"),
    ]


def _lanes(images: Sequence[tuple[str, float, float]], apart: bool) -> list[int]:
    """Lane of each image's bar: one of its own, or the first in which no other is at its time."""
    if apart:
        return list(range(len(images)))
    free, lanes = list[float](), [0] * len(images)
    for k in sorted(range(len(images)), key=lambda k: images[k][1]):
        _, start, stop = images[k]
        lane = next((n for n, end in enumerate(free) if end <= start), len(free) if len(free) < _LANES else 0)
        free[lane:lane + 1] = [stop]
        lanes[k] = lane
    return lanes


def _draw_bars(panel: Axes, drawn: DrawnPass, lanes: Sequence[int], labelled: bool) -> None:
    for (name, start, stop), lane in zip(drawn.images, lanes, strict=True):
        panel.barh(lane, stop - start, left=start, height=0.7, color=SOFT, alpha=0.55, lw=0.0)
        if labelled:
            early = start < _EARLY * float(drawn.places[-1])  # a name that is longer than its bar goes on inward
            panel.annotate(f" {short(name, 44)} ", (start if early else stop, lane), ha="left" if early else "right",
                           va="center", size=7.0)  # fmt: skip
    panel.set_ylim(max(lanes) + 0.6, -0.6)
    panel.set_yticks([])
    panel.grid(visible=False)
    panel.tick_params(labelbottom=False)
    for side in ("top", "right", "left"):
        panel.spines[side].set_visible(False)


def _draw(panel: Axes, drawn: DrawnPass, n: int) -> None:
    value, sigma = drawn.curves[n]
    panel.locator_params(axis="both", nbins=6)
    panel.axhline(0.0, color=SOFT, lw=0.8, zorder=1)
    panel.fill_between(drawn.places, value - sigma, value + sigma, color=AFTER, alpha=0.22, lw=0.0)
    panel.plot(drawn.places, value, color=AFTER)
    size = _MARK if drawn.nodes.size <= _MANY else 0.5 * _MARK
    panel.plot(drawn.nodes, drawn.at_nodes[n], color=INK, ls="", marker="o", ms=size, zorder=3)
    panel.set_ylabel(_ROWS[n])


def _caption(drawn: DrawnPass) -> str:
    """What one sees, with figures."""
    shift, turn = (max(float(np.abs(drawn.curves[n][0]).max()) for n in part) for part in (range(3), range(3, 6)))
    spread, twist = (max(float(drawn.curves[n][1].max()) for n in part) for part in (range(3), range(3, 6)))
    stands = ", so that one may stand for the other" if drawn.coupling > _ALIKE else ""
    return (
        f"{many(len(drawn.images), 'image')} on one trajectory with {many(drawn.nodes.size, 'orientation image')} over "
        f"{number(float(drawn.places[-1]), 4)} s: positions moved by up to {number(shift)} m and the axes of the pass "
        f"turned by up to {number(turn)} mgon, with sigmas of up to {number(spread)} m and {number(twist)} mgon; "
        f"position and rotation of the middle one are correlated by up to {drawn.coupling:.3f}{stands}. Boresights, "
        "lever arms and other unknowns that images share are not in these curves"
    )


# --- all passes


@plain_style()
def _overview(solution: Solution) -> Sheet:
    """Range of each pass's corrections at its nodes, and their mean sigma, a row for each pass."""
    count = len(solution.network.passes)
    shown = min(count, _IN_OVERVIEW)
    found = [strip_corrections(solution, k, node_times(solution, k)) for k in range(shown)]
    names = [short(one.name, 24) for one in solution.network.passes[:shown]]
    sheet = new_sheet(
        "passes", 10.2, 0.8 + 2 * (0.35 + 0.135 * max(shown, 4)), "Corrections of all passes",
        _overview_caption(found, count) + left_out(count, shown, f"first {shown}", "passes") + ".",
    )  # fmt: skip
    grid = sheet.panels(2, 3, sharey="all")
    for n in range(6):
        panel = grid[divmod(n, 3)]
        _draw_ranges(panel, found, n)
        panel.set_xlabel(_ROWS[n])
    for row in range(2):
        grid[row, 0].set_yticks(range(shown), names, size=7.0 if shown > 12 else 8.0)
    grid[0, 0].set_ylim(shown - 0.4, -0.6)
    sheet.legend([
        Line2D([], [], color=AFTER, lw=3.0, label="range of the corrections at orientation images"),
        Line2D([], [], color=INK, ls="", marker="|", ms=7.0, label="their mean"),
        Patch(color=AFTER, alpha=0.22, lw=0.0, label="± mean sigma (sigma0 = 1) about the mean"),
    ])
    return sheet


def _draw_ranges(panel: Axes, found: Sequence[StripCorrections], n: int) -> None:
    values = [one.values[:, n] / _UNITS[n] for one in found]
    means, rows = np.array([one.mean() for one in values]), np.arange(len(found))
    sigmas = np.array([one.sigmas[:, n].mean() / _UNITS[n] for one in found])
    panel.axvline(0.0, color=SOFT, lw=0.8, zorder=1)
    panel.barh(rows, 2.0 * sigmas, left=means - sigmas, height=0.8, color=AFTER, alpha=0.22, lw=0.0)
    panel.hlines(rows, [one.min() for one in values], [one.max() for one in values], color=AFTER, lw=3.0)
    panel.plot(means, rows, color=INK, ls="", marker="|", ms=7.0, zorder=3)
    panel.locator_params(axis="x", nbins=5)
    panel.grid(visible=False, axis="y")


def _overview_caption(found: Sequence[StripCorrections], count: int) -> str:
    largest = np.max([np.abs(one.values).max(axis=0) for one in found], axis=0) / _UNITS
    sigmas = np.median([one.sigmas.mean(axis=0) for one in found], axis=0) / _UNITS
    return (
        f"{count} passes: positions along, across the flight and radially moved by up to "
        f"{number(float(largest[:3].max()))} m, attitudes turned by up to {number(float(largest[3:].max()))} mgon; "
        f"sigmas in the middle (median of the passes) are {', '.join(number(v) for v in sigmas[:3].tolist())} m and "
        f"{', '.join(number(v) for v in sigmas[3:].tolist())} mgon"
    )
