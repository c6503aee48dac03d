"""A map of the block: footprints of the images, tie points by their sigma, laser and control points."""

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.lines import Line2D

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import solution_connectivity
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.map_plane import centre_of, east_north
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import PointClass
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.registration.measured import thinned
from mgsgraph.results.figures.overview_map import MOST_TRACK, WEAK, WEAK_COLOUR, overview_map, weak_points
from mgsgraph.results.figures.sheet import (
    CLASS_COLOUR,
    CLASS_MARKER,
    CLASS_NAME,
    INK,
    MOST_MARKS,
    SOFT,
    Sheet,
    new_sheet,
    number,
    plain_style,
    short,
)
from mgsgraph.units import DEG, KM

_OUTLINES = ((INK, "-"), ("#CC79A7", "--"), ("#56B4E9", "-."), (SOFT, ":"))
"""Colours and strokes of the first outlines; in larger blocks all look alike."""
_FEW = 500
"""Marks of known points that are large enough to be told apart."""
_MOST_WEAK = 50
"""Weak points of a large block that are marked."""
_WIDEST, _TALLEST, _LEAST, _SIDE = 7.2, 7.4, 3.0, 2.9
"""inch: bounds of the map, and the column beside it for legend and colour bar."""


def map_sheets(solution: Solution, connected: Connectivity | None = None) -> Iterator[Sheet]:
    """The map, and of a block with many points their cells; `connected` saves finding the footprints anew."""
    yield map_sheet(solution, connected)
    if _is_large(solution):
        yield overview_map(solution)


@plain_style()
def map_sheet(solution: Solution, connected: Connectivity | None = None) -> Sheet:
    """The map, around the block's centre."""
    centre = centre_of(solution.places)
    footprints = (connected or solution_connectivity(solution)).footprints
    outlines = [east_north(one.outline, centre) / KM for one in footprints]
    places = east_north(solution.places, centre) / KM
    low, high, (width, height) = frame(np.concatenate([*outlines, places]))
    sheet = new_sheet("map", width + 1.4 + _SIDE, height + 0.69, "Map of the block", _caption(solution), band=0.0)
    panel: Axes = sheet.panels()[0, 0]
    map_axes(panel, low, high, centre)
    handles = _draw_outlines(panel, solution, outlines)
    coloured = _draw_ties(panel, solution, places)
    handles += _draw_known(panel, solution, places)
    handles += _draw_weak(panel, solution, places)
    if coloured is not None:
        name = CLASS_NAME[PointClass.TIE]
        handles.append(Line2D([], [], ls="", marker="o", ms=4.5, color="#21918C", label=f"{name}, coloured by sigma"))
        bar = sheet.figure.colorbar(
            coloured, cax=panel.inset_axes((1.0 + 0.2 / width, 0.02, 0.2 / width, 0.5)),
            extend="both" if _clipped(solution) else "neither",
        )
        bar.set_label("3-D sigma of tie points (m, sigma0 = 1)")
    panel.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(1.0 + 0.1 / width, 1.0), borderaxespad=0.0, labelspacing=0.7
    )
    return sheet


def map_axes(panel: Axes, low: Array, high: Array, centre: Array) -> None:
    """One scale between corners (2,) in km, and where its zero, `centre` (3,) in m, lies on the body."""
    panel.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    longitude, latitude, _ = planetocentric(centre) / DEG
    panel.set_xlabel(f"km east of longitude {longitude % 360.0:.3f}° E")
    panel.set_ylabel(f"km north of latitude {abs(latitude):.3f}° {'N' if latitude >= 0.0 else 'S'}")


def frame(corners: Array, least: tuple[float, float] = (_LEAST, _LEAST)) -> tuple[Array, Array, tuple[float, float]]:
    """South-west and north-east corner (2,) of a map that holds places (n, 2), and its width and height in inches, of
    one scale and no less than `least`.
    """
    low, high = _bounds(corners)
    scale = float(np.min(np.array([_WIDEST, _TALLEST]) / (high - low)))
    lack = np.maximum(np.array(least) / scale - (high - low), 0.0)
    low, high = low - 0.5 * lack, high + 0.5 * lack
    width, height = ((high - low) * scale).tolist()
    return low, high, (width, height)


def tie_sigmas(solution: Solution) -> tuple[Index, Array]:
    """Indices (n,) of determined tie points, and their 3-D sigmas (n,) in m: the root of the covariance's trace."""
    ties = solution.members(PointClass.TIE)
    return ties, np.sqrt(np.trace(solution.covariances[ties], axis1=1, axis2=2))


def _bounds(corners: Array) -> tuple[Array, Array]:
    """South-west and north-east corner (2,) in km with a margin."""
    low, high = np.nanmin(corners, axis=0), np.nanmax(corners, axis=0)
    margin = 0.03 * max(float((high - low).max()), 1e-3)
    return low - margin, high + margin


def _draw_outlines(panel: Axes, solution: Solution, outlines: list[Array]) -> list[Line2D]:
    images = solution.network.images
    if len(images) > len(_OUTLINES):
        panel.add_collection(LineCollection(outlines, colors=SOFT, linewidths=0.7, zorder=2), autolim=False)
        return [Line2D([], [], color=SOFT, lw=0.7, label=f"outlines of {len(images)} images")]
    return [
        panel.plot(*outline.T, color=colour, ls=stroke, lw=1.1, zorder=2, label=short(image.name, 32))[0]
        for image, outline, (colour, stroke) in zip(images, outlines, _OUTLINES, strict=False)
    ]


def _draw_ties(panel: Axes, solution: Solution, places: Array) -> PathCollection | None:
    """Tie points coloured by sigma, dark for small; None without any."""
    ties, sigmas = tie_sigmas(solution)
    if not ties.size:
        return None
    low, high = np.quantile(sigmas, [0.02, 0.98])
    many, shown = ties.size > MOST_MARKS, thinned(ties.size, MOST_MARKS)
    if many:  # the largest lie on top, and weak ones are marked apart
        shown = shown[np.argsort(sigmas[shown], kind="stable")]
        shown = shown[~weak_points(solution)[ties[shown]]]
    return panel.scatter(
        places[ties[shown], 0], places[ties[shown], 1], c=sigmas[shown], s=3.0 if many else 11.0, cmap="viridis",
        vmin=low, vmax=max(high, low + 1e-12),
        edgecolors="none", zorder=3,
    )


def _clipped(solution: Solution) -> bool:
    """Whether the colours leave the outer two per cent of either side out."""
    return tie_sigmas(solution)[0].size >= 50


def _draw_known(panel: Axes, solution: Solution, places: Array) -> list[Line2D]:
    """Posts, laser and control points."""
    handles = []
    for point_class in (PointClass.POST, PointClass.LASER, PointClass.CONTROL):
        mine = solution.members(point_class)
        if not mine.size:
            continue
        most = MOST_TRACK if point_class == PointClass.LASER and _is_large(solution) else MOST_MARKS
        size, width = (4.2, 0.9) if mine.size <= _FEW else (1.6, 0.4)
        mine = mine[thinned(mine.size, most)]
        colour, marker = CLASS_COLOUR[point_class], CLASS_MARKER[point_class]
        panel.plot(*places[mine].T, ls="", marker=marker, ms=size, mfc="none", mew=width, color=colour, zorder=4)
        handles.append(
            Line2D([], [], ls="", marker=marker, ms=4.2, mfc="none", mew=0.9, color=colour,
                   label=CLASS_NAME[point_class])
        )  # fmt: skip
    return handles


def _is_large(solution: Solution) -> bool:
    """Whether cells have the points (`overview_map`), so that the map shows a choice of them."""
    return bool(np.count_nonzero(solution.determined) > MOST_MARKS)


def _draw_weak(panel: Axes, solution: Solution, places: Array) -> list[Line2D]:
    """Of a large block, tie points of a sigma far above the median, which are left out of the coloured ones; where they
    are many, cells have them alone (`overview_map`), for their marks would hide a narrow block.
    """
    weak = np.flatnonzero(weak_points(solution) & (solution.network.points.classes == PointClass.TIE))
    if not 0 < weak.size <= _MOST_WEAK or not _is_large(solution):
        return []
    return panel.plot(
        *places[weak].T, ls="", marker="x", ms=4.0, mew=0.9, color=WEAK_COLOUR, zorder=5,
        label=f"sigma above {WEAK:g} times the median",
    )


def _caption(solution: Solution) -> str:
    """What one sees, with figures."""
    ties, sigmas = tie_sigmas(solution)
    counts = {c: solution.members(c).size for c in PointClass}
    text = f"{len(solution.network.images)} image{'s' * (len(solution.network.images) > 1)}"
    text += "".join(f", {count} {CLASS_NAME[c]}" for c, count in counts.items() if count)
    if ties.size:
        low, middle, high = np.quantile(sigmas, [0.0, 0.5, 1.0])
        text += (
            f"; the 3-D sigma of the tie points is {number(low)} to {number(high)} m, for half of them at most "
            f"{number(middle)} m"
        )
    lost = int(np.count_nonzero(~solution.determined))
    text += f"; points that nothing determines are left out ({lost})" if lost else ""
    if max(counts.values()) > MOST_MARKS:
        laser = f" ({MOST_TRACK} laser points)" if counts[PointClass.LASER] > MOST_TRACK else ""
        text += (
            f"; at most {MOST_MARKS} points of a kind are drawn{laser}, none of the tie points whose sigma is above "
            f"{WEAK:g} times the median but as crosses, if there are no more than {_MOST_WEAK}"
        )
    return f"{text}; distances from the centre are true (azimuthal equidistant, planetocentric latitude)."
