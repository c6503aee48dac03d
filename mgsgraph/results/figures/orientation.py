"""Corrections of the exterior orientation with their 1-sigma bands: a sheet of all passes over time, one of all images
that have an orientation of their own, along their lines.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.collections import PolyCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mgsgraph.adjustment.solution import OrientationProfile, Solution, orientation_profiles
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
        pictures = sum(len(pass_.images) for pass_ in network.passes)
        heading = f"{count} {'pass' if count == 1 else 'passes'} of {many(pictures, 'image')}, without shared unknowns"
        yield _curves_sheet("passes", curves, _PASSES, heading,
                            "passes, each from its first orientation image to its last")
    outside_passes = np.flatnonzero(network.pass_of < 0).tolist()
    if outside_passes:
        held = int(np.count_nonzero(network.held[outside_passes]))
        heading = f"{many(len(outside_passes), 'image')}{f', of which {held} are held at nominal' if held else ''}"
        curves = image_curves(solution, outside_passes)
        yield _curves_sheet("orientation", curves, _IMAGES, heading, "images, each from its first line to its last")


def image_curves(solution: Solution, images: Sequence[int]) -> list[Curve]:
    """Positions along the body-fixed axes in m, rotations about the cameras' own axes in arcsec."""
    places, names = max(_PLACES // len(images), _FEWEST), solution.network.image_names
    found = (np.split(part, len(images)) for part in components(orientation_profiles(solution, images, places)))
    return [
        Curve(names[j], np.linspace(0.0, 1.0, places), values, sigmas, np.zeros(0), np.zeros((0, 6)))
        for j, values, sigmas in zip(images, *found, strict=True)
    ]


def pass_curve(solution: Solution, number: int, curves: int = 1) -> Curve:
    """Corrections along, across and radially in m, of roll, pitch and yaw in arcsec."""
    pass_, nodes = solution.network.passes[number], node_times(solution, number)
    start, stop = np.array(pass_.nodes.coverage) + pass_.nodes.epoch
    times = np.linspace(start, stop, max(_PLACES // curves, _PER_INTERVAL * nodes.size + 1))
    corrections, at_nodes = pass_corrections(solution, number, times), pass_corrections(solution, number, nodes)
    units = np.repeat([1.0, ARCSEC], 3)
    return Curve(
        pass_.name, (times - start) / (stop - start), corrections.values / units, corrections.sigmas / units,
        (nodes - start) / (stop - start), at_nodes.values / units,
    )  # fmt: skip


def components(profile: OrientationProfile) -> tuple[Array, Array]:
    """Corrections and sigmas (n, 6) of X, Y, Z in m and of the rotations about the camera's x, y, z in arcsec."""
    shift = profile.position_after - profile.position_before
    return (
        np.hstack([shift, profile.rotation / ARCSEC]),
        np.hstack([profile.position_sigma, profile.rotation_sigma / ARCSEC]),
    )


def _across(k: int, shares: Array) -> Array:
    """Where places of the k-th curve lie on the horizontal axis."""
    return k + 0.02 + 0.96 * shares


def _band(curve: Curve, k: int, panel: int) -> Array:
    """Outline (2 n, 2) of the 1-sigma band of the k-th curve in a panel: matplotlib's `fill_between` takes long over
    thousands of them.
    """
    at, value, sigma = _across(k, curve.shares), curve.values[:, panel], curve.sigmas[:, panel]
    return np.array([np.append(at, at[::-1]), np.append(value - sigma, (value + sigma)[::-1])]).T


@plain_style()
def _curves_sheet(name: str, curves: Sequence[Curve], rows: Sequence[str], heading: str, across: str) -> Sheet:
    """Six panels; each curve takes one unit of the horizontal axis."""
    count, gap = len(curves), [np.nan]  # no line from one curve to the next
    positions = np.concatenate([np.append(_across(k, curve.shares), gap) for k, curve in enumerate(curves)])
    values, sigmas = (
        np.concatenate([np.vstack([getattr(curve, part), np.full((1, 6), np.nan)]) for curve in curves])
        for part in ("values", "sigmas")
    )
    node_positions = np.concatenate([_across(k, curve.node_shares) for k, curve in enumerate(curves)])
    node_values = np.concatenate([curve.node_values for curve in curves])
    sheet = new_sheet(
        name, 11.0 if count > 4 or node_positions.size else 7.2, 8.4, "Corrections of the exterior orientation",
        _caption(heading, curves, rows),
    )  # fmt: skip
    grid = sheet.panels(6, 1, sharex="col")[:, 0]
    for n, panel in enumerate(grid):
        value, sigma = values[:, n], sigmas[:, n]
        panel.axhline(0.0, color=SOFT, lw=0.8, zorder=1)
        bands = [_band(curve, k, n) for k, curve in enumerate(curves)]
        panel.add_collection(PolyCollection(bands, color=AFTER, alpha=0.22, lw=0.0))
        panel.plot(positions, value, color=AFTER)
        panel.plot(node_positions, node_values[:, n], color=INK, ls="", marker="o", ms=_MARK if node_positions.size < 60
                   else 0.5 * _MARK)
        low, high = float(np.nanmin(value - sigma)), float(np.nanmax(value + sigma))
        margin = 0.12 * max(high - low, 1e-9)
        panel.set(ylabel=rows[n], ylim=(low - margin, high + margin), xlim=(0.0, count))
        panel.locator_params(axis="y", nbins=5)
    if count <= _NAMED:
        grid[-1].set_xticks(np.arange(count) + 0.5, [short(curve.name, 60 // count + 6) for curve in curves])
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
    sheet.legend([*handles, nodes] if node_positions.size else handles)
    return sheet


def _caption(heading: str, curves: Sequence[Curve], rows: Sequence[str]) -> str:
    """Caption with the main numbers."""
    largest = np.max([np.abs(curve.values).max(axis=0) for curve in curves], axis=0)
    ratios = [np.abs(curve.values) / np.where(curve.sigmas > 0.0, curve.sigmas, np.inf) for curve in curves]
    k = int(np.argmax([ratio.max() for ratio in ratios]))
    row = rows[int(np.argmax(ratios[k].max(axis=0)))].split("(")[0].strip()
    return (
        f"{heading}: the largest correction is {number(float(ratios[k].max()), 2)} sigmas ({row} of "
        f"{short(curves[k].name)}). Positions moved by up to {number(largest[:3].max())} m, attitudes by up to "
        f"{number(largest[3:].max())} arcsec."
    )
