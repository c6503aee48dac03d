"""Corrections of the exterior orientation along the image, with their 1-sigma bands."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mgsgraph.adjustment.solution import OrientationProfile, Solution, orientation_profile
from mgsgraph.analysis.flight import node_times, strip_corrections
from mgsgraph.figures.sheet import (
    AFTER,
    INK,
    MOST_SHEETS,
    SOFT,
    Sheet,
    in_sheets,
    left_out,
    new_sheet,
    number,
    plain_style,
    sheet_name,
    short,
)
from mgsgraph.geometry.records import Array
from mgsgraph.units import ARCSEC, MGON

_PER_SHEET = 4
_PLACES = 101
_PER_INTERVAL = 6
"""Places drawn between two nodes."""
_MARK, _MANY = 3.0, 60
"""pt of a node's mark, and nodes from which on it is half as large."""
_ROWS = ("X (m)", "Y (m)", "Z (m)", "about x\n(arcsec)", "about y\n(arcsec)", "about z\n(arcsec)")
_STRIP_ROWS = ("along (m)", "across (m)", "radial (m)", "roll (mgon)", "pitch (mgon)", "yaw (mgon)")


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """One column of a sheet: an image with an orientation of its own, or a strip."""

    title: str
    """Name."""
    places: Array
    """(n,) abscissa: lines of an image, s of a strip."""
    curves: list[tuple[Array, Array]]
    """Correction and sigma (n,) of three positions in m and three rotations, in arcsec of an image, mgon of a strip."""
    coupling: float
    """Largest correlation between a position and a rotation."""
    held: bool = False
    """Not adjusted."""
    nodes: Array | None = None
    """(k,) s of a strip's orientation images; None for an image."""
    at_nodes: list[Array] = field(default_factory=list)
    """Corrections (k,) there."""


def orientation_sheets(solution: Solution) -> Iterator[Sheet]:
    """Sheets of up to four columns: strips, then images outside of strips; of a large block, the first ones."""
    strips, own = range(len(solution.network.passes)), np.flatnonzero(solution.network.pass_of < 0)
    yield from _sheets(solution, list(strips), "strips", "strips", drawn_strip)
    yield from _sheets(solution, own.tolist(), "orientation", "images", drawn_image)


def _sheets(
    solution: Solution, members: Sequence[int], kind: str, what: str, draw: Callable[[Solution, int], Drawn]
) -> Iterator[Sheet]:
    chosen = members[: _PER_SHEET * MOST_SHEETS]
    sheets = in_sheets(chosen, _PER_SHEET)
    omitted = left_out(len(members), len(chosen), f"first {len(chosen)}", what)
    for n, some in enumerate(sheets):
        yield _sheet([draw(solution, k) for k in some], sheet_name(kind, n + 1, len(sheets)), omitted)


@plain_style()
def _sheet(columns: Sequence[Drawn], name: str, omitted: str) -> Sheet:
    of_strips = columns[0].nodes is not None
    title = "Corrections of the strips' trajectories" if of_strips else "Corrections of the exterior orientation"
    caption = _caption(columns, of_strips) + omitted + "."
    sheet = new_sheet(name, max(7.2, 0.9 + 3.1 * len(columns)), 8.4, title, caption)
    grid = sheet.panels(6, len(columns), sharex="col", sharey="row")
    along, rows = ("time (s)", _STRIP_ROWS) if of_strips else ("line (px)", _ROWS)
    for c, column in enumerate(columns):
        for n in range(6):
            _draw(grid[n, c], column, n)
        grid[0, c].set_title(short(column.title, 34))
        grid[5, c].set_xlabel(along)
    for panel, what in zip(grid[:, 0], rows, strict=True):
        panel.set_ylabel(what)
    handles: list[Artist] = [
        Line2D([], [], color=AFTER, label="adjusted minus nominal"),
        Patch(color=AFTER, alpha=0.22, lw=0.0, label="± 1 sigma (sigma0 = 1)"),
    ]
    if any(column.held for column in columns):
        handles[1:1] = [Line2D([], [], color=SOFT, ls="--", label="held at nominal")]
    if of_strips:
        handles.append(Line2D([], [], color=INK, ls="", marker="o", ms=_MARK, label="orientation images"))
    sheet.legend(handles)
    return sheet


def drawn_image(solution: Solution, image: int) -> Drawn:
    """An image with an orientation of its own, over its lines."""
    profile = orientation_profile(solution, image, _PLACES)
    return Drawn(
        solution.network.images[image].name, profile.lines, components(profile), coupling(solution, image),
        bool(solution.network.held[image]),
    )  # fmt: skip


def drawn_strip(solution: Solution, strip: int) -> Drawn:
    """A strip over its time, with its nodes; at so many places that each interval between nodes shows its curve."""
    one, nodes = solution.network.passes[strip], node_times(solution, strip)
    start, stop = one.nodes.coverage
    times = np.linspace(start, stop, max(_PLACES, _PER_INTERVAL * nodes.size + 1)) + one.nodes.epoch
    series, there = strip_corrections(solution, strip, times), strip_corrections(solution, strip, nodes)
    scale = [1.0] * 3 + [MGON] * 3
    curves = [(series.values[:, c] / scale[c], series.sigmas[:, c] / scale[c]) for c in range(6)]
    variable = int(solution.network.first_of_passes[strip]) + len(one.nodes) // 2
    middle = _largest_correlation(solution.joint_covariance.block(variable, variable))
    return Drawn(
        one.name, times - times[0], curves, middle, nodes=nodes - times[0],
        at_nodes=[there.values[:, c] / scale[c] for c in range(6)],
    )  # fmt: skip


def components(profile: OrientationProfile) -> list[tuple[np.ndarray, np.ndarray]]:
    """Correction and sigma (n,) of X, Y, Z in m and of the rotations about the camera's x, y, z in arcsec."""
    shift = profile.position_after - profile.position_before
    position = [(shift[:, k], profile.position_sigma[:, k]) for k in range(3)]
    rotation = [(profile.rotation[:, k] / ARCSEC, profile.rotation_sigma[:, k] / ARCSEC) for k in range(3)]
    return position + rotation


def coupling(solution: Solution, image: int) -> float:
    """Largest correlation between a constant position correction and a constant rotation of an image; 0 when held."""
    return _largest_correlation(solution.image_covariance(image)[:6, :6])


def _largest_correlation(covariance: Array) -> float:
    sigmas = np.sqrt(np.diagonal(covariance))
    if not np.all(sigmas > 0.0):
        return 0.0
    return float(np.abs(covariance / np.outer(sigmas, sigmas))[:3, 3:].max())


def _draw(panel: Axes, column: Drawn, n: int) -> None:
    value, sigma = column.curves[n]
    panel.set_xlim(column.places[0], column.places[-1])
    panel.locator_params(axis="both", nbins=5)
    if column.held:
        panel.plot(column.places, value, color=SOFT, ls="--")
        return
    panel.axhline(0.0, color=SOFT, lw=0.8, zorder=1)
    panel.fill_between(column.places, value - sigma, value + sigma, color=AFTER, alpha=0.22, lw=0.0)
    panel.plot(column.places, value, color=AFTER)
    if column.nodes is not None:
        size = _MARK if column.nodes.size <= _MANY else 0.5 * _MARK
        panel.plot(column.nodes, column.at_nodes[n], color=INK, ls="", marker="o", ms=size, clip_on=False, zorder=3)


def _caption(columns: Sequence[Drawn], of_strips: bool) -> str:
    """What one sees, with figures."""
    free = [column.curves for column in columns if not column.held]
    if not free:
        return "All images drawn here are held, so that their orientation is the nominal one and has no sigma"
    largest = [[max(float(np.abs(one[k][part]).max()) for one in free) for k in range(6)] for part in (0, 1)]
    (shift, turn), (spread, twist) = [(max(part[:3]), max(part[3:])) for part in largest]
    held = sum(column.held for column in columns)
    kept = f"; held at nominal: {held}" if held else ""
    where, axes = ("along, across, radial", "roll, pitch and yaw") if of_strips else ("body-fixed X, Y, Z", "own")
    of, unit = ("in the middle of a strip", "mgon") if of_strips else ("of an image", "arcsec")
    most = max(column.coupling for column in columns)
    return (
        f"Positions ({where}) moved by up to {number(shift)} m and the camera turned by up to {number(turn)} {unit} "
        f"about its {axes} axes, while their sigmas reach {number(spread)} m and {number(twist)} {unit}; position and "
        f"rotation {of} are correlated by up to {most:.3f}, so that one may stand for the other{kept}"
    )
