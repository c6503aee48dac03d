"""How the images hang together: a graph of the links by common points, and a map of the footprints."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import solution_connectivity
from mgsgraph.figures.content import centre_of, east_north
from mgsgraph.figures.ground_map import frame
from mgsgraph.figures.sheet import (
    CLASS_COLOUR,
    CLASS_MARKER,
    CLASS_NAME,
    INK,
    MOST_MARKS,
    SOFT,
    Sheet,
    legend,
    new_sheet,
    panels,
    short,
    words,
)
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.footprint import areas
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import PointClass
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.network.connectivity_words import WEAKEST, connectivity_statements, worth_tying
from mgsgraph.registration.measured import thinned
from mgsgraph.units import DEG, KM

_ISLANDS = ("#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Colours of the largest islands; smaller ones are grey."""
_WEAK, _UNTIED, _APART = "#D55E00", "#777777", "#AA0000"
_GRAPH, _FEW, _LOWEST = (3.6, 5.6), 6, 4.2
"""inch, width of the graph for up to so many images and for more; inch, least height of both panels."""
_LEFT, _BESIDE, _BAR, _RIM = 0.4, 1.0, 0.5, 0.45
"""inch: left of the graph, between the panels (for the map's numbers, and for a colour bar), and around the nodes."""
_STROKES = ("-", "--", "-.", ":")
"""Of the outlines, where there are no more images than that."""
_NUMBERED = 15
"""Links up to which their numbers of points are written on them; beyond, a colour bar says it."""
_LETTER, _LINE = 0.064, 0.13
"""inch, size of a letter of a label."""
_MOST_LINKS = 2000
"""Links drawn; the strongest come first."""


@dataclass(frozen=True, slots=True, eq=False)
class Labels:
    """Names that found room beside their places."""

    which: Index
    """(l,) places that have one."""
    places: Array
    """(l, 2) inch, middle of each."""


def connectivity_sheet(solution: Solution, connected: Connectivity | None = None) -> Sheet:
    """Graph and map; `connected` saves finding it anew."""
    connected = connected or solution_connectivity(solution)
    sound = [one for one in connected.footprints if one.outline.shape[0]]
    centre = centre_of(np.concatenate([solution.places, *(one.outline for one in sound)]))
    outlines = [east_north(one.outline, centre) / KM for one in connected.footprints]
    places = east_north(solution.places, centre) / KM
    low, high, (width, height) = frame(np.concatenate([*outlines, places]), least=(2.6, _LOWEST))
    caption = " ".join(connectivity_statements(connected)) or "One image."
    across = _GRAPH[len(outlines) > _FEW]
    beside = _BESIDE + (_BAR if connected.links.size > _NUMBERED else 0.0)
    middles = _middles(outlines)
    sheet = new_sheet(
        "connectivity", _LEFT + across + beside + width + 0.2, height + 0.7, "How the images hang together",
        f"{caption}{_graph_words(connected, on_one_another(middles, _sizes(connected)))}",
    )  # fmt: skip
    graph, ground = panels(sheet, 1, 2, left=_LEFT, across=beside, widths=[across, width])[0]
    colours = island_colours(connected)
    handles = _draw_graph(graph, connected, middles, colours)
    ground.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    ground.set_aspect("equal")
    handles += _draw_map(ground, solution, outlines, places, colours)
    _name_outlines(ground, connected, outlines, low, (high - low) / np.array([width, height]))
    longitude, latitude, _ = planetocentric(centre) / DEG
    north = f"km north of latitude {abs(latitude):.3f}° {'N' if latitude >= 0.0 else 'S'}"
    words(ground, f"km east of longitude {longitude % 360.0:.3f}° E", north, "footprints and points")
    legend(sheet.figure, handles)
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


def _sizes(connected: Connectivity) -> Array:
    """Roots (m,) of the footprints' areas, km."""
    return np.sqrt(areas(connected.footprints)) / KM


def _graph_words(connected: Connectivity, circle: bool) -> str:
    if len(connected.names) < 2:
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
    room = np.array(box)
    extent = np.ptp(middles, axis=0)
    if len(middles) == 1:
        return 0.5 * room[None]
    if on_one_another(middles, sizes):
        turn = 2.0 * np.pi * np.arange(len(middles)) / len(middles) + np.pi
        ring = np.column_stack([np.cos(turn), -np.sin(turn)])
        return np.asarray(0.5 * room + (0.5 * room - _RIM) * ring)
    scale = (room - 2.0 * _RIM) / np.maximum(extent, 0.1 * extent.max())
    places = 0.5 * room + (middles - middles.min(axis=0) - 0.5 * extent) * scale
    return _apart(places, _distance(len(middles), box), room)


def on_one_another(middles: Array, sizes: Array) -> bool:
    """Whether all footprints lie within half the size of the middle one."""
    return bool(np.ptp(middles, axis=0).max() < 0.5 * np.median(sizes))


def _distance(images: int, box: tuple[float, float]) -> float:
    """inch, least distance of nodes."""
    return float(min(0.7, 0.7 * np.sqrt(box[0] * box[1] / images) * min((60.0 / images) ** 0.25, 1.0)))


def _apart(places: Array, least: float, room: Array) -> Array:
    """Places pushed from each other until they are `least` apart, or nearly so, within the room."""
    turn = 2.4 * np.arange(len(places))  # the golden angle: nodes at one place leave in all directions
    places = places + 1e-3 * least * np.column_stack([np.cos(turn), np.sin(turn)])
    for _ in range(60):
        between = places[:, None] - places
        length = np.linalg.norm(between, axis=2)
        push = np.where((length > 0.0) & (length < least), 0.5 * (least - length) / np.maximum(length, 1e-12), 0.0)
        if not np.any(push):
            break
        step = np.einsum("ij,ijk->ik", push, between)
        places = np.clip(places + 0.5 * step, 0.5 * _RIM, room - 0.5 * _RIM)
    return np.asarray(places)


def _draw_graph(panel: Axes, connected: Connectivity, middles: Array, colours: list[str]) -> list[Line2D]:
    """Nodes and links; handles for the legend."""
    assert isinstance(panel.figure, Figure)
    box, (sheet_width, sheet_height) = panel.get_position(), panel.figure.get_size_inches()
    size = float(box.width * sheet_width), float(box.height * sheet_height)
    panel.set(xlim=(0.0, size[0]), ylim=(0.0, size[1]), xticks=[], yticks=[])
    panel.grid(False)
    reach = _sizes(connected)
    nodes = node_places(middles, reach, size)
    count = len(nodes)
    scale = _distance(count, size) / 0.7
    handles = _draw_links(panel, connected, nodes, scale)
    marker = float(np.clip(18.0 * scale, 3.0, 13.0))
    alone = np.isin(np.arange(count), connected.unconnected) & (count > 1)
    for filled in (True, False):
        mine = np.flatnonzero(alone != filled)
        panel.scatter(
            nodes[mine, 0], nodes[mine, 1], s=marker**2, c=[colours[j] if filled else "white" for j in mine], zorder=4,
            edgecolors=["white" if filled else INK for _ in mine], linewidths=0.6,
        )  # fmt: skip
    names = [short(name, 24) for name in connected.names]
    labels = roomy(names, _around(names, nodes, 0.55 * marker / 72.0), nodes, size)
    for j, place in zip(labels.which.tolist(), labels.places, strict=True):
        _write(panel, place, names[j], 7.0)
    islands = len(connected.islands)
    title = "images and their common points"
    words(panel, title=title + (f"; {islands} islands by colour" if islands > 1 else ""))
    if count > 1 and not on_one_another(middles, reach):
        panel.set_xlabel("west to east (not to scale)")
        panel.xaxis.set_label_coords(0.5, -0.16 / size[1])
        panel.set_ylabel("south to north (not to scale)")
        panel.yaxis.set_label_coords(-0.12 / size[0], 0.5)
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
        ends = nodes[connected.pairs[rows]]
        tries = np.stack([(1.0 - s) * ends[:, 0] + s * ends[:, 1] for s in (0.5, 0.4, 0.6, 0.3, 0.7)], axis=1)
        labels = roomy(names, tries, nodes, (np.inf, np.inf))
        for k, place in zip(labels.which.tolist(), labels.places, strict=True):
            _write(panel, place, names[k], 7.5, 1.0)
        return handles
    assert isinstance(panel.figure, Figure)
    bar = panel.figure.colorbar(drawn, cax=panel.inset_axes((1.015, 0.0, 0.018, 0.45)))
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


def _write(panel: Axes, place: Array, name: str, size: float, cover: float = 0.7) -> None:
    """A name on a white ground that covers what is under it in part."""
    x, y = place.tolist()
    ground = {"boxstyle": "square,pad=0.08", "fc": "white", "ec": "none", "alpha": cover}
    panel.text(x, y, name, size=size, ha="center", va="center", zorder=5, parse_math=False, bbox=ground)


def _around(names: list[str], places: Array, away: float) -> Array:
    """Middles (m, 4, 2), inch, of names above, below, right and left of places (m, 2)."""
    sides = np.array([(0.0, 1.0), (0.0, -1.0), (1.0, 0.0), (-1.0, 0.0)])
    return np.asarray(places[:, None] + sides * (_half(names) + away)[:, None])


def _half(names: list[str]) -> Array:
    """Half of the width and height (m, 2) of names, inch."""
    return np.array([(0.5 * _LETTER * len(name), 0.5 * _LINE) for name in names])


def roomy(names: list[str], tries: Array, marks: Array, box: tuple[float, float]) -> Labels:
    """Names at the first of their places (m, c, 2), in inches, where they hide no other name and none of the marks
    (k, 2), moved sideways into the box; names without such a place stay away.
    """
    which, middles = list[int](), list[Array]()
    taken = np.empty((0, 4))
    for j, (half, places) in enumerate(zip(_half(names), tries, strict=True)):
        for place in places:
            middle = np.array([np.clip(place[0], half[0], max(box[0] - half[0], half[0])), place[1]])
            low, high = middle - half, middle + half
            outside = not np.all(np.isfinite(middle)) or low[1] < 0.0 or high[1] > box[1] or high[0] > box[0] + 1e-9
            on_mark = np.any(np.all((marks > low) & (marks < high), axis=1))
            on_name = np.any(np.all((taken[:, :2] < high) & (taken[:, 2:] > low), axis=1))
            if not (outside or on_mark or on_name):
                which.append(j)
                middles.append(middle)
                taken = np.vstack([taken, np.concatenate([low, high])])
                break
    return Labels(np.array(which, dtype=np.int64), np.array(middles).reshape(-1, 2))


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


def _name_outlines(panel: Axes, connected: Connectivity, outlines: list[Array], low: Array, per_inch: Array) -> None:
    """Names at the ends of few footprints, beside many, where they fit."""
    names = [short(name, 24) for name in connected.names]
    inches = [(outline - low) / per_inch for outline in outlines]
    size = (np.array([panel.get_xlim()[1], panel.get_ylim()[1]]) - low) / per_inch
    few = len(names) <= _FEW
    tries = np.array([_at_ends(o, k) if few else _beside(o, half[0], k)
                      for k, (o, half) in enumerate(zip(inches, _half(names), strict=True))])  # fmt: skip
    if not few:
        _keep_off_others(tries, inches)
    marks = np.empty((0, 2)) if few else np.concatenate(inches)
    labels = roomy(names, tries, marks, (float(size[0]), float(size[1])))
    for j, place in zip(labels.which.tolist(), labels.places, strict=True):
        _write(panel, low + place * per_inch, names[j], 6.5)


def _keep_off_others(tries: Array, outlines: list[Array]) -> None:
    """Strike out places (m, c, 2) beside an outline that lie on another one's ground: a name there would be its."""
    for k, outline in enumerate(outlines):
        if outline.size:
            low, high = outline.min(axis=0), outline.max(axis=0)
            on_it = np.all((tries > low) & (tries < high), axis=2)
            on_it[k] = False
            tries[on_it] = np.nan


def _at_ends(outline: Array, turn: int) -> Array:
    """Above the northern and below the southern end (2, 2) of an outline, every other time the other way round."""
    if not outline.size:
        return np.full((2, 2), np.nan)
    away = np.array([0.0, 0.6 * _LINE])
    ends = np.array([outline[np.argmax(outline[:, 1])] + away, outline[np.argmin(outline[:, 1])] - away])
    return ends[:: 1 if turn % 2 == 0 else -1]


def _beside(outline: Array, half: float, turn: int) -> Array:
    """East and west (2, 2) of an outline's middle, every other time the other way round."""
    if not outline.size:
        return np.full((2, 2), np.nan)
    low, high = outline.min(axis=0), outline.max(axis=0)
    middle = 0.5 * (low[1] + high[1])
    sides = np.array([(high[0] + half + 0.06, middle), (low[0] - half - 0.06, middle)])
    return sides[:: 1 if turn % 2 == 0 else -1]
