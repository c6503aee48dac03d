"""Corrections of the exterior orientation with their 1-sigma bands: a sheet of all passes over time, one of all images
that have an orientation of their own, along their lines.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mgsgraph.adjustment.solution import OrientationProfile, Solution, orientation_profile
from mgsgraph.analysis.statistics import node_times, pass_corrections
from mgsgraph.geometry.records import Array
from mgsgraph.results.figures.sheet import AFTER, INK, SOFT, Sheet, new_sheet, number, plain_style
from mgsgraph.text import many, short
from mgsgraph.units import ARCSEC

_PLACES, _FEWEST, _PER_INTERVAL = 800, 3, 6
"""Places along all curves together; of each at least, and between two nodes."""
_NAMED = 12
"""Curves up to which their names stand below the panels."""
_MARK = 3.0
"""pt of a node's mark."""
_IMAGES = ("X (m)", "Y (m)", "Z (m)", "about x\n(arcsec)", "about y\n(arcsec)", "about z\n(arcsec)")
_PASSES = ("along (m)", "across (m)", "radial (m)", "roll (arcsec)", "pitch (arcsec)", "yaw (arcsec)")


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """Corrections along one image, or of one pass."""

    name: str
    """Of the image or pass."""
    shares: Array
    """(n,) places, 0 at the beginning and 1 at the end."""
    values: Array
    """(n, 6) in the units of the panels: three of position, three of attitude."""
    sigmas: Array
    """(n, 6) of these, for sigma0 = 1."""
    node_shares: Array
    """(k,) places of orientation images; none of an image."""
    node_values: Array
    """(k, 6) corrections there."""


def orientation_sheets(solution: Solution) -> Iterator[Sheet]:
    """A sheet of all passes, then one of all images outside of passes; each where there are any."""
    network = solution.network
    if count := len(network.passes):
        curves = [pass_curve(solution, k, count) for k in range(count)]
        pictures = sum(len(one.images) for one in network.passes)
        head = f"{count} {'pass' if count == 1 else 'passes'} of {many(pictures, 'image')}, without shared unknowns"
        yield _sheet("passes", curves, _PASSES, head, "passes, each from its first orientation image to its last")
    own = np.flatnonzero(network.pass_of < 0).tolist()
    if own:
        held = int(np.count_nonzero(network.held[own]))
        head = f"{many(len(own), 'image')}{f', of which {held} are held at nominal' if held else ''}"
        curves = [image_curve(solution, j, len(own)) for j in own]
        yield _sheet("orientation", curves, _IMAGES, head, "images, each from its first line to its last")


def image_curve(solution: Solution, image: int, curves: int = 1) -> Curve:
    """Position along the body-fixed axes in m, rotations about the camera's own axes in arcsec."""
    places = max(_PLACES // curves, _FEWEST)
    values, sigmas = components(orientation_profile(solution, image, places))
    return Curve(
        solution.network.images[image].name, np.linspace(0.0, 1.0, places), values, sigmas,
        np.zeros(0), np.zeros((0, 6)),
    )  # fmt: skip


def pass_curve(solution: Solution, strip: int, curves: int = 1) -> Curve:
    """Corrections along, across and radially in m, of roll, pitch and yaw in arcsec."""
    one, nodes = solution.network.passes[strip], node_times(solution, strip)
    start, stop = np.array(one.nodes.coverage) + one.nodes.epoch
    times = np.linspace(start, stop, max(_PLACES // curves, _PER_INTERVAL * nodes.size + 1))
    along, at_nodes = pass_corrections(solution, strip, times), pass_corrections(solution, strip, nodes)
    units = np.repeat([1.0, ARCSEC], 3)
    return Curve(
        one.name, (times - start) / (stop - start), along.values / units, along.sigmas / units,
        (nodes - start) / (stop - start), at_nodes.values / units,
    )  # fmt: skip


def components(profile: OrientationProfile) -> tuple[Array, Array]:
    """Corrections and sigmas (n, 6) of X, Y, Z in m and of the rotations about the camera's x, y, z in arcsec."""
    shift = profile.position_after - profile.position_before
    return (
        np.hstack([shift, profile.rotation / ARCSEC]),
        np.hstack([profile.position_sigma, profile.rotation_sigma / ARCSEC]),
    )


@plain_style()
def _sheet(name: str, curves: Sequence[Curve], rows: Sequence[str], head: str, across: str) -> Sheet:
    """Six panels; each curve takes one unit of the horizontal axis."""
    count, gap = len(curves), [np.nan]  # no line from one curve to the next
    at = np.concatenate([np.append(k + 0.02 + 0.96 * one.shares, gap) for k, one in enumerate(curves)])
    values, sigmas = (
        np.concatenate([np.vstack([getattr(one, part), np.full((1, 6), np.nan)]) for one in curves])
        for part in ("values", "sigmas")
    )
    dots = np.concatenate([k + 0.02 + 0.96 * one.node_shares for k, one in enumerate(curves)])
    heights = np.concatenate([one.node_values for one in curves])
    sheet = new_sheet(
        name, 11.0 if count > 4 or dots.size else 7.2, 8.4, "Corrections of the exterior orientation",
        _caption(head, curves, rows),
    )  # fmt: skip
    grid = sheet.panels(6, 1, sharex="col")[:, 0]
    for n, panel in enumerate(grid):
        value, sigma = values[:, n], sigmas[:, n]
        panel.axhline(0.0, color=SOFT, lw=0.8, zorder=1)
        panel.fill_between(at, value - sigma, value + sigma, color=AFTER, alpha=0.22, lw=0.0)
        panel.plot(at, value, color=AFTER)
        panel.plot(dots, heights[:, n], color=INK, ls="", marker="o", ms=_MARK if dots.size < 60 else 0.5 * _MARK)
        low, high = float(np.nanmin(value - sigma)), float(np.nanmax(value + sigma))
        room = 0.12 * max(high - low, 1e-9)
        panel.set(ylabel=rows[n], ylim=(low - room, high + room), xlim=(0.0, count))
        panel.locator_params(axis="y", nbins=5)
    if count <= _NAMED:
        grid[-1].set_xticks(np.arange(count) + 0.5, [short(one.name, 60 // count + 6) for one in curves])
        for panel in grid:
            panel.set_xticks(np.arange(count + 1), minor=True)
            panel.grid(visible=False, axis="x", which="major")
            panel.grid(visible=True, axis="x", which="minor")
    grid[-1].set_xlabel(across)
    handles: list[Artist] = [
        Line2D([], [], color=AFTER, label="adjusted minus nominal"),
        Patch(color=AFTER, alpha=0.22, lw=0.0, label="± 1 sigma (sigma0 = 1)"),
    ]
    nodes = Line2D([], [], color=INK, ls="", marker="o", ms=_MARK, label="orientation images")
    sheet.legend([*handles, nodes] if dots.size else handles)
    return sheet


def _caption(head: str, curves: Sequence[Curve], rows: Sequence[str]) -> str:
    """What one sees, with figures."""
    moved = np.max([np.abs(one.values).max(axis=0) for one in curves], axis=0)
    ratios = [np.abs(one.values) / np.where(one.sigmas > 0.0, one.sigmas, np.inf) for one in curves]
    k = int(np.argmax([one.max() for one in ratios]))
    row = rows[int(np.argmax(ratios[k].max(axis=0)))].split("(")[0].strip()
    return (
        f"{head}: the largest correction is {number(float(ratios[k].max()), 2)} sigmas ({row} of "
        f"{short(curves[k].name)}). Positions moved by up to {number(moved[:3].max())} m, attitudes by up to "
        f"{number(moved[3:].max())} arcsec."
    )
