"""The map: outlines of the images, ground points colored by one quantity, error ellipses, corrections and relief.

Few points are drawn one by one, many as medians of cells; a block of any size and a window of the studio are one
figure. A block that is far longer than wide has a scale of its own in each direction.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import Normalize
from matplotlib.lines import Line2D
from matplotlib.quiver import Quiver
from matplotlib.ticker import MaxNLocator

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.estimates import CommonPoints
from mgsgraph.analysis.statistics import SHARE, medians, solution_connectivity, span
from mgsgraph.geometry.body import centre_of, east_north_up, error_ellipses, plane_coordinates, planetocentric
from mgsgraph.geometry.records import Array, Index, thinned
from mgsgraph.network import PointClass
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.results.figures.sheet import (
    CLASS_MARKER,
    CLASS_NAME,
    FLAT,
    INK,
    MOST_MARKS,
    SOFT,
    Sheet,
    cell_numbers,
    new_sheet,
    number,
    plain_style,
    round_figure,
)
from mgsgraph.text import many, short
from mgsgraph.units import DEG, KM

_MOST_DRAWN = 40
"""Ellipses and corrections that are drawn, spread over the map: more hide the points."""
_FEWEST, _FEW = 3, 12
"""Points of which a comparison is drawn; images up to which outlines bear numbers."""
_MOVEMENT_COLOR = "#D55E00"
CELLS = 100
"""Cells along the longer side of a block of many points."""
_LONG_RATIO = 6.0
"""Length over width from which on a map has two scales."""
_WIDEST, _TALLEST, LEAST = 7.2, 7.4, 3.0
"""inch: bounds of a map."""
_ELLIPSE, _ARROW = 0.02, 0.06
"""Lengths of large ellipses and corrections, as shares of the map's longer side."""


@dataclass(frozen=True, eq=False)
class MapWindow:
    """What a window of the map shows; m on the map."""

    name: str
    """Of the block."""
    centre: Array
    """(3,) m, body-fixed, where the map has its zero."""
    box: Array
    """(4,) x and y, low and high."""
    outlines: dict[str, Array]
    """(k, 2) of each image."""
    places: Array
    """(n, 2) of points, or of middles of some cells."""
    values: Array
    """(n,) of points by which they are colored, or (rows, columns) of cells, from the south-west; NaN where nothing is
    known."""
    quantity: tuple[str, str]
    """What that is: title and unit."""
    scale: tuple[float, float]
    """Ends of the colors; below and above zero for what has a sign."""
    count: int
    """Points in the window."""
    classes: Index | None
    """(n,) of `PointClass`; None of cells."""
    covariances: Array | None
    """(n, 2, 2) m^2, east and north, for ellipses; None for none."""
    moved: Array | None
    """(n, 2) m, corrections east and north; None for none."""
    ground: Array | None
    """(rows, columns) grey values of the ground in the box, 0 to 1, from the north; None for none."""
    factor: float
    """Enlargement of ellipses and corrections; 0 for round ones that suit."""


def map_sheets(solution: Solution, connected: Connectivity | None = None) -> Iterator[Sheet]:
    """The map of a solution; `connected` saves computing the footprints again. None where no point has a place."""
    if np.any(solution.determined):
        yield window_sheet(block_window(solution, connected))


def block_window(solution: Solution, connected: Connectivity | None = None) -> MapWindow:
    """The whole block: 3-D sigmas of its points, or of cells, and their corrections; posts of terrain models, which
    move as a whole, only where there is nothing else.
    """
    centre = centre_of(solution.places)
    outlines = outlines_of(solution, centre, connected)
    classes = solution.network.points.classes
    rows = np.flatnonzero(solution.determined & (classes != PointClass.POST))
    if not rows.size:
        rows = np.flatnonzero(solution.determined)
    places, covariances = plane_coordinates(solution.places[rows], centre), solution.covariances[rows]
    axes = east_north_up(solution.places[rows])
    sigmas = np.sqrt(np.trace(covariances, axis1=1, axis2=2))
    moved = np.einsum("nij,nj->ni", axes[:, :2], (solution.places - solution.places_before)[rows])
    horizontal = None
    if len(rows) <= MOST_MARKS:
        horizontal = axes[:, :2] @ covariances @ axes[:, :2].mT
    corners = np.concatenate([places, *outlines.values()])
    about = (solution.name, centre, corners, outlines)
    return points_window(about, places, sigmas, ("3-D sigma", "m"), classes[rows], horizontal, moved)


def points_window(
    about: tuple[str, Array, Array, dict[str, Array]], places: Array, values: Array, quantity: tuple[str, str],
    classes: Index, covariances: Array | None = None, moved: Array | None = None,
) -> MapWindow:  # fmt: skip
    """Points (n, 2), or cells of many, with a quantity (n,) and movements (n, 2); `about`: name, centre, places (k, 2)
    that the map holds, and outlines. Colors begin at zero: small differences look small.
    """
    name, centre, corners, outlines = about
    box = np.concatenate([np.nanmin(corners, axis=0), np.nanmax(corners, axis=0)])
    scale = span(values)
    if len(places) <= MOST_MARKS:
        return MapWindow(name, centre, box, outlines, places, values, quantity, scale, len(places), classes,
                         covariances, moved, None, 0.0)  # fmt: skip
    middles, (cells, *components) = cell_medians(box, places, values, *(() if moved is None else moved.T))
    arrows = np.column_stack([component.ravel() for component in components]) if components else None
    return MapWindow(name, centre, box, outlines, middles, cells, quantity, scale, len(places), None, None, arrows,
                     None, 0.0)  # fmt: skip


def outlines_of(solution: Solution, centre: Array, connected: Connectivity | None = None) -> dict[str, Array]:
    """(k, 2) m of each image."""
    footprints = (connected or solution_connectivity(solution)).footprints
    return {
        image.name: plane_coordinates(footprint.outline, centre)
        for image, footprint in zip(solution.network.images, footprints, strict=True)
    }


def comparison_sheet(points: CommonPoints, labels: tuple[str, str]) -> Sheet | None:
    """By how much the common points of two solutions moved, later minus earlier; None of fewer than three."""
    if len(points.places) < _FEWEST:
        return None
    centre = centre_of(points.places)
    places, (later_rows, _) = plane_coordinates(points.places, centre), points.rows
    about = (f"{labels[1]} minus {labels[0]}", centre, places, dict[str, Array]())
    classes, size = points.solution.network.points.classes[later_rows], np.linalg.norm(points.moved, axis=1)
    shown = points_window(about, places, size, ("3-D movement", "m"), classes, moved=points.moved[:, :2])
    return replace(window_sheet(shown), name="comparison")


def cell_medians(box: Array, places: Array, *values: Array) -> tuple[Array, list[Array]]:
    """Middles (rows * columns, 2) of the cells of a box (4,), x and y, low and high, row by row from the south-west,
    and the medians (rows, columns) of values (n,) at places (n, 2) in each; NaN where there are none.
    """
    size = np.maximum(box[2:] - box[:2], 1e-6)
    fewest = CELLS // 5 if size.max() > _LONG_RATIO * size.min() else 1
    columns, rows = np.maximum(np.ceil(CELLS * size / size.max()), fewest).astype(int).tolist()
    cell = cell_numbers((places - box[:2])[:, ::-1], size[::-1], (rows, columns))
    row, column = (index.ravel() + 0.5 for index in np.indices((rows, columns)))
    middles = box[:2] + np.column_stack([column, row]) * size / [columns, rows]
    return middles, [medians(quantity, cell, rows * columns).reshape(rows, columns) for quantity in values]


def map_axes(panel: Axes, low: Array, high: Array, centre: Array) -> None:
    """Corners (2,) in km, and where their zero, `centre` (3,) in m, lies on the body."""
    panel.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="auto" if _is_long(high - low) else "equal")
    longitude, latitude, _ = planetocentric(centre) / DEG
    panel.set_xlabel(f"km east of longitude {longitude % 360.0:.3f}° E")
    panel.set_ylabel(f"km north of latitude {abs(latitude):.3f}° {'N' if latitude >= 0.0 else 'S'}")


def _is_long(size: Array) -> bool:
    return bool(size.max() > _LONG_RATIO * size.min())


def frame(corners: Array) -> tuple[Array, Array, tuple[float, float]]:
    """South-west and north-east corner (2,) of a map that holds places (n, 2), and its width and height in inches, no
    less than LEAST; of one scale unless the block is long.
    """
    low, high = np.nanmin(corners, axis=0), np.nanmax(corners, axis=0)
    margin = 0.03 * np.maximum(high - low, 1e-3 if _is_long(high - low) else max(float((high - low).max()), 1e-3))
    low, high = low - margin, high + margin
    scale = np.array([_WIDEST, _TALLEST]) / (high - low)
    if not _is_long(high - low):
        scale[:] = scale.min()
        lack = np.maximum(LEAST / scale - (high - low), 0.0)
        low, high = low - 0.5 * lack, high + 0.5 * lack
    size = np.maximum((high - low) * scale.min(), LEAST)
    width, height = size.tolist()
    return low, high, (width, height)


@plain_style()
def window_sheet(window: MapWindow) -> Sheet:
    """A window of the map, its points colored by one quantity."""
    low, high, (width, height) = frame(window.box.reshape(2, 2) / KM)
    longest = float((window.box[2:] - window.box[:2]).max())
    movements = np.zeros(0) if window.moved is None else np.linalg.norm(window.moved, axis=1)
    factors = (_enlargement(window, _ellipse_radii(window), _ELLIPSE * longest),
               _enlargement(window, movements, _ARROW * longest))  # fmt: skip
    title, unit = window.quantity
    name = f"{short(window.name, int(8.5 * width) + 20 - len(title))}: {title}"
    sheet = new_sheet("map", width + 3.0, height + 0.69, name, _caption(window, factors), band=0.0)
    panel: Axes = sheet.panels()[0, 0]
    map_axes(panel, low, high, window.centre)
    if window.ground is not None:
        x0, y0, x1, y1 = (window.box / KM).tolist()
        panel.imshow(
            np.ma.masked_invalid(window.ground), extent=(x0, x1, y0, y1), cmap="gray", vmin=0.0, vmax=1.0, zorder=1,
            aspect=panel.get_aspect(),
        )
    named = _draw_outlines(panel, window.outlines, low, high)
    norm, cmap = Normalize(*window.scale), "coolwarm" if window.scale[0] == -window.scale[1] else "viridis"
    handles = _draw_points(panel, window, norm, cmap)
    if window.covariances is not None:
        panel.add_collection(_ellipses(panel, window, factors[0]), autolim=False)
        label = f"95 % ellipses × {factors[0]:g}"
        handles.append(Line2D([], [], ls="", marker="o", ms=8, mfc="none", mec=INK, label=label))
    if window.moved is not None:
        _arrows(panel, window, factors[1])
        handles.append(Line2D([], [], color=_MOVEMENT_COLOR, label=f"movements × {factors[1]:g}"))
    bar_axes = panel.inset_axes((1.0 + 0.2 / width, 0.02, 0.2 / width, 0.5))
    ends = "both" if window.scale[0] else "max"
    bar = sheet.figure.colorbar(ScalarMappable(norm, cmap), cax=bar_axes, extend=ends, ticks=MaxNLocator(5))
    bar.set_label(f"{title} ({unit})")
    panel.legend(handles=handles + named, loc="upper left", bbox_to_anchor=(1.0 + 0.1 / width, 1.0), borderaxespad=0.0)
    return sheet


def _draw_outlines(panel: Axes, outlines: dict[str, Array], low: Array, high: Array) -> list[Line2D]:
    """Outlines; of few images each bears its number where it is farthest from the others, and handles say the names."""
    lines = [outline / KM for outline in outlines.values() if len(outline)]
    panel.add_collection(LineCollection(lines, colors=INK, linewidths=0.8, zorder=2), autolim=False)
    handles: list[Line2D] = []
    for k, (name, outline) in enumerate(outlines.items(), 1):
        corners = outline[np.all((outline / KM > low) & (outline / KM < high), axis=1)] / KM
        if not len(corners) or len(outlines) > _FEW:
            continue
        others = np.concatenate([np.full((1, 2), np.inf),
                                 *(other / KM for key, other in outlines.items() if key != name)])
        distances = np.linalg.norm((corners[:, None] - others) / (high - low), axis=2)
        place = corners[np.argmax(np.nanmin(distances, axis=1))].tolist()
        panel.annotate(
            f"{k}", place, size=7.5, weight="bold", ha="center", va="center", zorder=8,
            bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": INK, "lw": 0.6},
        )  # fmt: skip
        handles.append(Line2D([], [], color="none", label=f"{k}: {short(name, 20)}"))
    return handles


def _draw_points(panel: Axes, window: MapWindow, norm: Normalize, cmap: str) -> list[Line2D]:
    """Points by the mark of their class, or cells; handles of the marks."""
    if window.classes is None:
        x0, y0, x1, y1 = (window.box / KM).tolist()
        panel.imshow(
            np.ma.masked_invalid(window.values), extent=(x0, x1, y0, y1), origin="lower", cmap=cmap,
            norm=norm, interpolation="nearest", zorder=3, aspect=panel.get_aspect(),
        )  # fmt: skip
        return []
    handles = []
    for kind in PointClass:
        rows = np.flatnonzero(window.classes == kind)
        if rows.size:
            x, y = window.places[rows].T / KM
            marker, size = CLASS_MARKER[kind], 14.0 if len(window.places) <= 1500 else 5.0
            panel.scatter(
                x, y, c=window.values[rows], s=size, marker=marker, cmap=colormaps[cmap].with_extremes(bad=SOFT),
                norm=norm, lw=0.25, ec=INK, zorder=3, plotnonfinite=True,
            )  # fmt: skip
            handles.append(Line2D([], [], ls="", marker=marker, ms=4.5, color=SOFT, label=CLASS_NAME[kind]))
    return handles


def _drawn_rows(window: MapWindow, values: Array) -> Index:
    """Rows of values (n, ...) that are known, not too many of them, one after the other along the map's longer side."""
    rows = np.flatnonzero(np.all(np.isfinite(values), axis=tuple(range(1, values.ndim))))
    return rows[np.argsort(window.places[rows, _longer_axis(window)], kind="stable")][thinned(rows.size, _MOST_DRAWN)]


def _longer_axis(window: MapWindow) -> int:
    """0 where the map is wider than high, 1 otherwise: ellipses and arrows take the scale of that axis."""
    return int(np.argmax(window.box[2:] - window.box[:2]))


def _ellipse_radii(window: MapWindow) -> Array:
    """(n,) m, longer semi-axes of the 95 % ellipses."""
    if window.covariances is None:
        return np.zeros(0)
    known = np.all(np.isfinite(window.covariances), axis=(1, 2))
    return error_ellipses(window.covariances[known])[0][:, 1]


def _enlargement(window: MapWindow, lengths: Array, target: float) -> float:
    """By which lengths (n,) in m are enlarged: what was asked, or a round number that makes the long ones as wanted."""
    lengths = lengths[np.isfinite(lengths)]
    if window.factor > 0.0 or not lengths.size:
        return window.factor or 1.0
    return round_figure(target / max(float(np.quantile(lengths, 0.95)), 1e-12))


def _ellipses(panel: Axes, window: MapWindow, factor: float) -> EllipseCollection:
    assert window.covariances is not None
    rows = _drawn_rows(window, window.covariances)
    semi_axes, directions = error_ellipses(window.covariances[rows])
    shorter, longer = 2.0 * factor * semi_axes.T / KM
    angles = np.degrees(np.arctan2(directions[:, 1, 1], directions[:, 0, 1]))  # of the longer one, from the east
    return EllipseCollection(
        longer, shorter, angles, units="y" if _longer_axis(window) else "x", offsets=window.places[rows] / KM,
        offset_transform=panel.transData, facecolors="none", edgecolors=INK, linewidths=0.7, zorder=4,
    )  # fmt: skip


def _arrows(panel: Axes, window: MapWindow, factor: float) -> Quiver:
    assert window.moved is not None
    rows = _drawn_rows(window, window.moved)
    east, north = factor * window.moved[rows].T / KM
    return panel.quiver(
        *(window.places[rows].T / KM), east, north, angles="uv", scale_units="xy"[_longer_axis(window)], scale=1.0,
        width=0.003, color=_MOVEMENT_COLOR, zorder=5,
    )  # fmt: skip


def message(window: MapWindow) -> str:
    """Main statement of the map, one sentence."""
    (title, unit), values = window.quantity, window.values[np.isfinite(window.values)]
    if not values.size:
        return f"{title} of no point is known."
    middle, (low, high) = number(float(np.median(values))), np.quantile(values, [1.0 - SHARE, SHARE])
    if low > 0.0 and high < FLAT * low:
        return f"{title} is nearly the same everywhere: {middle} {unit}."
    return f"{title}: {middle} {unit} (median), {number(float(values[np.argmax(np.abs(values))]))} {unit} at most."


def _caption(window: MapWindow, factors: Sequence[float]) -> str:
    form = "one by one" if window.classes is not None else f"medians of {np.isfinite(window.values).sum()} cells"
    sentences = [
        message(window), f"{many(window.count, 'point')}, {form}; colors reach from {number(window.scale[0])} to "
        f"{number(window.scale[1])} {window.quantity[1]}. Sigmas are for sigma0 = 1."
    ]  # fmt: skip
    for values, marks, factor in zip((window.covariances, window.moved), ("95 % error ellipses", "Movements"), factors,
                                     strict=True):  # fmt: skip
        if values is not None:
            count = many(_drawn_rows(window, values).size, "cell" if window.classes is None else "point")
            sentences.append(f"{marks} of {count}, {factor:g} times true size.")
    if window.ground is not None:
        sentences.append("In gray, orthorectified images or shaded relief (light from the north-west).")
    if _is_long(window.box[2:] - window.box[:2]):
        sentences.append("The map has two scales; ellipses and arrows take that of its longer side.")
    return " ".join(sentences)
