"""How the images hang together: a graph of the links by common points, and a map of the footprints."""

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import solution_connectivity
from mgsgraph.geometry.footprint import areas
from mgsgraph.geometry.map_plane import centre_of, east_north
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import PointClass
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.network.connectivity_words import WEAKEST, connectivity_statements, worth_tying
from mgsgraph.registration.measured import thinned
from mgsgraph.results.figures.ground_map import frame, map_axes
from mgsgraph.results.figures.sheet import (
    CLASS_COLOUR,
    CLASS_MARKER,
    CLASS_NAME,
    INK,
    MOST_MARKS,
    SOFT,
    Sheet,
    new_sheet,
    plain_style,
    short,
)
from mgsgraph.units import KM

_ISLANDS = ("#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Colours of the largest islands; smaller ones are grey."""
_WEAK, _UNTIED, _APART = "#D55E00", "#777777", "#AA0000"
_GRAPH, _FEW, _LOWEST = (3.6, 5.6), 6, 4.2
"""inch, width of the graph for up to so many images and for more; inch, least height of both panels."""
_PAIR, _OF_PAIR = 2, 2.6
"""Images that stand one above the other in a narrow graph, of so many inches."""
_BESIDE, _RIM = 1.6, 0.45
"""inch: beside the panels for labels and a colour bar in all, and around the nodes."""
_STROKES = ("-", "--", "-.", ":")
"""Of the outlines, where there are no more images than that."""
_NUMBERED = 15
"""Links up to which their numbers of points are written on them; beyond, a colour bar says it."""
_GAP = 4.0
"""pt between a name and what it names."""
_MOST_LINKS = 2000
"""Links drawn; the strongest come first."""


Side = tuple[float, float, float, float]
"""Where a name may stand: x and y of what it names, and pt right of that and above it; 0: centred on it."""


@plain_style()
def connectivity_sheet(solution: Solution, connected: Connectivity | None = None) -> Sheet:
    """Graph and map; `connected` saves finding it anew."""
    connected = connected or solution_connectivity(solution)
    sound = [one for one in connected.footprints if one.outline.shape[0]]
    centre = centre_of(np.concatenate([solution.places, *(one.outline for one in sound)]))
    outlines = [east_north(one.outline, centre) / KM for one in connected.footprints]
    places = east_north(solution.places, centre) / KM
    low, high, (width, height) = frame(np.concatenate([*outlines, places]), least=(2.6, _LOWEST))
    caption = " ".join(connectivity_statements(connected)) or "One image."
    across = _OF_PAIR if len(outlines) <= _PAIR else _GRAPH[len(outlines) > _FEW]
    middles, sizes = _middles(outlines), np.sqrt(areas(connected.footprints)) / KM
    circle = on_one_another(middles, sizes)
    sheet = new_sheet(
        "connectivity", across + _BESIDE + width, height + 0.7, "How the images hang together",
        f"{caption}{_graph_words(connected, circle)}",
    )  # fmt: skip
    graph, ground = sheet.panels(1, 2, widths=[across, width])[0]
    graph.set(xticks=[], yticks=[])
    if len(outlines) > 1 and not circle:
        graph.set(xlabel="west to east (not to scale)", ylabel="south to north (not to scale)")
    several = f"; {len(connected.islands)} islands by colour" if len(connected.islands) > 1 else ""
    graph.set_title(f"images and their common points{several}")
    ground.set_title("footprints and points")
    map_axes(ground, low, high, centre)
    sheet.figure.draw_without_rendering()  # sizes of the panels are known from here on
    sheet.figure.set_layout_engine("none")
    colours = island_colours(connected)
    handles = _draw_graph(graph, connected, middles, sizes, colours)
    handles += _draw_map(ground, solution, outlines, places, colours)
    _name_outlines(ground, connected, outlines)
    sheet.legend(handles)
    return sheet


def island_colours(connected: Connectivity) -> list[str]:
    """Of each image: one for each of the largest islands, grey for smaller ones and for images that stand alone."""
    colours = [SOFT] * len(connected.names)
    for island, colour in zip(connected.islands, _ISLANDS, strict=False):
        for j in island:
            colours[j] = colour if len(island) > 1 or len(colours) == 1 else SOFT
    return colours


def _middles(outlines: list[Array]) -> Array:
    """Middle (m, 2) of each outline's box, km; zero for an empty one."""
    return np.array([0.5 * (o.min(axis=0) + o.max(axis=0)) if o.size else np.zeros(2) for o in outlines])


def _graph_words(connected: Connectivity, circle: bool) -> str:
    if len(connected.names) <= _PAIR:
        return ""
    drawn = f"; the strongest {_MOST_LINKS} links are drawn" if connected.links.size > _MOST_LINKS else ""
    if circle:
        return f" The images lie on one another; in the graph they stand around a circle{drawn}."
    return f" In the graph images stand roughly as on the ground, moved apart where they would hide each other{drawn}."


# --- graph


def node_places(middles: Array, sizes: Array, box: tuple[float, float]) -> Array:
    """Places (m, 2) of nodes in a box (width, height): as on the ground, stretched to fill it and moved apart; around a
    circle where the images lie on one another.

    Parameters
    ----------
    middles : (m, 2)
        Of the footprints on the ground.
    sizes : (m,)
        Of the footprints, in the same unit: apart by less than half of the middle one, images lie on one another.
    """
    size = np.array(box)
    extent = np.ptp(middles, axis=0)
    if len(middles) == 1:
        return 0.5 * size[None]
    if on_one_another(middles, sizes):
        first = -0.5 * np.pi if len(middles) == _PAIR else np.pi  # two of them stand on the longer way, upright
        turn = 2.0 * np.pi * np.arange(len(middles)) / len(middles) + first
        ring = np.column_stack([np.cos(turn), -np.sin(turn)])
        return np.asarray(0.5 * size + (0.5 * size - _RIM) * ring)
    scale = (size - 2.0 * _RIM) / np.maximum(extent, 0.1 * extent.max())
    places = 0.5 * size + (middles - middles.min(axis=0) - 0.5 * extent) * scale
    return _apart(places, _distance(len(middles), box), size)


def on_one_another(middles: Array, sizes: Array) -> bool:
    """Whether all footprints lie within half the size of the middle one."""
    return bool(np.ptp(middles, axis=0).max() < 0.5 * np.median(sizes))


def _distance(images: int, box: tuple[float, float]) -> float:
    """inch, least distance of nodes."""
    return float(min(0.7, 0.7 * np.sqrt(box[0] * box[1] / images) * min((60.0 / images) ** 0.25, 1.0)))


def _apart(places: Array, least: float, box: Array) -> Array:
    """Places pushed from each other until they are `least` apart, or nearly so, within the box."""
    turn = 2.4 * np.arange(len(places))  # the golden angle: nodes at one place leave in all directions
    places = places + 1e-3 * least * np.column_stack([np.cos(turn), np.sin(turn)])
    for _ in range(60):
        between = places[:, None] - places
        length = np.linalg.norm(between, axis=2)
        push = np.where((length > 0.0) & (length < least), 0.5 * (least - length) / np.maximum(length, 1e-12), 0.0)
        if not np.any(push):
            break
        step = np.einsum("ij,ijk->ik", push, between)
        places = np.clip(places + 0.5 * step, 0.5 * _RIM, box - 0.5 * _RIM)
    return np.asarray(places)


def _draw_graph(
    panel: Axes, connected: Connectivity, middles: Array, sizes: Array, colours: list[str]
) -> list[Line2D]:
    """Nodes and links; handles for the legend."""
    box = panel.get_window_extent()
    width, height = box.width / panel.figure.dpi, box.height / panel.figure.dpi
    panel.set(xlim=(0.0, width), ylim=(0.0, height))
    panel.grid(False)
    nodes = node_places(middles, sizes, (width, height))
    count = len(nodes)
    scale = _distance(count, (width, height)) / 0.7
    handles = _draw_links(panel, connected, nodes, scale)
    marker = float(np.clip(18.0 * scale, 3.0, 13.0))
    alone = np.isin(np.arange(count), connected.unconnected) & (count > 1)
    for filled in (True, False):
        mine = np.flatnonzero(alone != filled)
        panel.scatter(
            nodes[mine, 0], nodes[mine, 1], s=marker**2, c=[colours[j] if filled else "white" for j in mine], zorder=4,
            edgecolors=["white" if filled else INK for _ in mine], linewidths=0.6,
        )  # fmt: skip
    away = 0.55 * marker + 1.0
    sides = ((0.0, away), (0.0, -away), (away, 0.0), (-away, 0.0))
    write_names(panel, [short(name, 24 if count > _PAIR else 36) for name in connected.names],
                [[(x, y, *side) for side in (sides[1:] if count == _PAIR and k else sides)]
                 for k, (x, y) in enumerate(nodes.tolist())], 7.0, nodes)  # fmt: skip
    if np.any(alone):
        handles.append(Line2D([], [], ls="", marker="o", mfc="white", mec=INK, ms=5.0, label="image without links"))
    return handles


def _draw_links(panel: Axes, connected: Connectivity, nodes: Array, scale: float) -> list[Line2D]:
    """Links by number of points, the weakest ones underlaid, and pairs where points and footprints disagree."""
    handles = [
        _lines(panel, nodes, connected.pairs[rows], colour, stroke, max(width * scale, 1.0), label)
        for rows, colour, stroke, width, label in (
            (worth_tying(connected)[:200], _UNTIED, ":", 1.0, "overlap without common points"),
            (connected.apart[:200], _APART, "-.", 1.6, "common points without overlap"),
            (_weakest(connected), _WEAK, "-", 7.0, "weakest joints"),
        )
        if rows.size
    ]
    rows = connected.links
    if rows.size == 0:
        return handles
    points = connected.points[rows].astype(np.float64)
    order = np.argsort(points, kind="stable")[-_MOST_LINKS:]
    rows, points = rows[order], points[order]
    top = max(float(points[-1]), 2.0)
    norm = LogNorm(1.0, top) if top > 30.0 * points[0] else Normalize(0.0, top)
    drawn = LineCollection(
        list(nodes[connected.pairs[rows]]), array=points, cmap="YlGnBu", norm=norm, zorder=3,
        linewidths=(0.6 + 3.0 * np.sqrt(points / top)) * scale,
    )  # fmt: skip
    panel.add_collection(drawn, autolim=False)
    if rows.size <= _NUMBERED:
        names = [f"{number:.0f}" for number in points]
        shares = np.array([0.5, 0.4, 0.6, 0.3, 0.7])[:, None]
        along = [(1.0 - shares) * start + shares * stop for start, stop in nodes[connected.pairs[rows]]]
        write_names(panel, names, [[(x, y, 0.0, 0.0) for x, y in one.tolist()] for one in along], 7.5, nodes, cover=1.0)
        return handles
    assert isinstance(panel.figure, Figure)
    bar = panel.figure.colorbar(drawn, cax=panel.inset_axes((0.02, 0.02, 0.02, 0.3)))
    bar.ax.set_title("points", size=7.5, pad=3.0, loc="left")
    bar.ax.tick_params(labelsize=7.0)
    return handles


def _weakest(connected: Connectivity) -> Index:
    """Rows of the links named as the weakest; at most half of all that count."""
    return connected.spine[: min(WEAKEST, connected.spine.size // 2)]


def _lines(
    panel: Axes, nodes: Array, pairs: Index, colour: str, stroke: str, width: float, label: str
) -> Line2D:
    lines = LineCollection(list(nodes[pairs]), colors=colour, linestyles=stroke, linewidths=width, zorder=2)
    panel.add_collection(lines, autolim=False)
    return Line2D([], [], color=colour, ls=stroke, lw=min(width, 4.0), label=label)


def write_names(
    panel: Axes, names: list[str], sides: list[list[Side]], size: float, marks: Array, cover: float = 0.7,
    keep_off: Callable[[int, Bbox], bool] = lambda k, box: False,
) -> list[Annotation]:
    """Write each name at the first of its sides where it hides no other name and none of the marks (k, 2), moved
    sideways into the panel; names without such a side are left out.

    Parameters
    ----------
    panel : Axes
        At its final size.
    size : float
        pt, of letters.
    cover : float
        By how much the white ground behind a name covers what is under it.
    keep_off : callable
        Whether the name with an index may not stand in a box, in the figure's pixels.

    Returns
    -------
    list of Annotation
        Names that were written.
    """
    frame, written = panel.get_window_extent().padded(-3.0), list[Annotation]()
    taken = list[Bbox]()
    hidden = panel.transData.transform(marks)
    ground = {"boxstyle": "square,pad=0.08", "fc": "white", "ec": "none", "alpha": cover}
    for k, (name, options) in enumerate(zip(names, sides, strict=True)):
        text = panel.annotate(
            name, (0.0, 0.0), (0.0, 0.0), textcoords="offset points", size=size, zorder=5, bbox=ground
        )
        for x, y, right, up in options:
            text.xy, text.xyann = (x, y), (right, up)
            text.set_horizontalalignment(("center", "left", "right")[int(np.sign(right))])
            text.set_verticalalignment(("center", "bottom", "top")[int(np.sign(up))])
            box = text.get_window_extent()
            inside = float(np.clip(0.0, frame.x0 - box.x0, max(frame.x1 - box.x1, frame.x0 - box.x0)))
            text.xyann, box = (right + inside * 72.0 / panel.figure.dpi, up), box.translated(inside, 0.0)
            outside = box.y0 < frame.y0 or box.y1 > frame.y1 or box.x1 > frame.x1 + 1e-6
            if not (outside or box.count_overlaps(taken) or box.count_contains(hidden) or keep_off(k, box)):
                written.append(text)
                taken.append(box)
                break
        else:
            text.remove()
    return written


# --- map


def _draw_map(
    panel: Axes, solution: Solution, outlines: list[Array], places: Array, colours: list[str]
) -> list[Line2D]:
    for k, (outline, colour) in enumerate(zip(outlines, colours, strict=True)):
        stroke = _STROKES[k] if len(outlines) <= len(_STROKES) else "-"
        panel.plot(*outline.T, color=colour, ls=stroke, lw=1.1 if len(outlines) <= 60 else 0.6, zorder=2)
    handles = []
    for point_class in PointClass:
        mine = solution.members(point_class)
        if not mine.size:
            continue
        few = mine.size <= 300
        handles += panel.plot(
            *places[mine[thinned(mine.size, MOST_MARKS)]].T, ls="", marker=CLASS_MARKER[point_class],
            ms=2.6 if few else 1.4, mew=0.0, color=CLASS_COLOUR[point_class], alpha=0.8, zorder=3,
            label=CLASS_NAME[point_class],
        )  # fmt: skip
    return [Line2D([], [], ls="", marker=h.get_marker(), ms=4.5, mew=0.0, color=h.get_color(), label=h.get_label())
            for h in handles]  # fmt: skip


def _name_outlines(panel: Axes, connected: Connectivity, outlines: list[Array]) -> None:
    """Names at the northern and southern ends of few footprints, east and west of many, where they fit; every other
    name the other way round. Beside many no name stands on another one's ground: it would be taken for its.
    """
    names, few = [short(name, 24) for name in connected.names], len(outlines) <= _FEW
    grounds = [Bbox(panel.transData.transform([o.min(axis=0), o.max(axis=0)])) if o.size else Bbox.null()
               for o in outlines]  # fmt: skip

    def on_others(k: int, box: Bbox) -> bool:
        x, y = 0.5 * (box.p0 + box.p1)
        return not few and any(one.contains(x, y) for j, one in enumerate(grounds) if j != k)

    sides = []
    for k, outline in enumerate(outlines):
        ends: list[Side] = []
        if outline.size and few:
            north, south = outline[np.argmax(outline[:, 1])], outline[np.argmin(outline[:, 1])]
            ends = [(*north.tolist(), 0.0, _GAP), (*south.tolist(), 0.0, -_GAP)]
        elif outline.size:
            (west, south), (east, north) = outline.min(axis=0), outline.max(axis=0)
            ends = [(east, 0.5 * (south + north), _GAP, 0.0), (west, 0.5 * (south + north), -_GAP, 0.0)]
        sides.append(ends[:: 1 if k % 2 == 0 else -1])
    marks = np.empty((0, 2)) if few else np.concatenate(outlines)
    write_names(panel, names, sides, 6.5, marks, keep_off=on_others)
