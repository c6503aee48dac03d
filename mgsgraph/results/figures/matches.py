"""Matches drawn: where they are, and by how much the nominal orientations contradict each other at them."""

import numpy as np
from matplotlib.lines import Line2D

from mgsgraph.geometry.records import Array, thinned
from mgsgraph.matching.coarse import match_offsets
from mgsgraph.matching.match import Matches
from mgsgraph.matching.scene import Scene, by_pair, footprints
from mgsgraph.names import numbered
from mgsgraph.results.figures.sheet import AFTER, BEFORE, INK, MOST_MARKS, SOFT, Sheet, new_sheet, number, plain_style
from mgsgraph.units import KM


@plain_style()
def matches_sheet(matches: Matches, scene: Scene, name: str) -> Sheet:
    """Where the matches are, and along the flight by how much the nominal orientations contradict each other there."""
    plane, nominal = _nominal(matches, scene)
    filled, cell_count = matches.cells
    across, along = np.median(nominal, axis=0)
    caption = (
        f"{len(matches.ties.ids)} tie points from {len(scene.pictures)} images in {filled} of {cell_count} cells of "
        f"{number(matches.cell)} m (the map's two scales differ). By the nominal orientations the second sees them "
        f"{number(across)} m off across the plane of the two rays and {number(along)} m along it (medians)."
    )
    sheet = new_sheet("matches", 9.0, 4.6, f"Matches between images: {name}", caption)
    map_panel, contradiction = sheet.panels(1, 2, sharey=True)[0]
    marked = thinned(len(plane), MOST_MARKS)
    for footprint in footprints(scene):
        map_panel.plot(*(scene.ground.chart.plane(footprint.outline) / KM).T, color=INK, lw=0.8)
    map_panel.plot(*(plane[marked] / KM).T, "o", ms=2.0, color=SOFT)
    map_panel.set(xlabel="across the flight (km)", ylabel="along the flight (km)", title="where")
    for k, color in enumerate((AFTER, BEFORE)):
        contradiction.plot(nominal[marked, k], plane[marked, 1] / KM, ".", ms=2.5, color=color)
    contradiction.set(xlabel="second minus first (m on the ground)", title="contradiction of the nominal orientations")
    sheet.legend([
        Line2D([], [], color=INK, lw=1.0, label="footprints"),
        Line2D([], [], color=SOFT, marker="o", ls="", ms=3.5, label="tie points"),
        Line2D([], [], color=AFTER, marker=".", ls="", label="across the plane of rays (orientation alone)"),
        Line2D([], [], color=BEFORE, marker=".", ls="", label="in it (height, and orientation)"),
    ])  # fmt: skip
    return sheet


def _nominal(matches: Matches, scene: Scene) -> tuple[Array, Array]:
    """Places of matches (n, 2), m of the chart, and their displacements (n, 2), m, by the nominal orientations."""
    ties, reference = matches.ties, matches.reference
    number_of = numbered(picture.image.name for picture in scene.pictures)
    picture = np.array([number_of[name] for name in ties.measure_image])
    first = np.zeros(len(ties.ids), dtype=np.int64)
    first[ties.measure_point[reference]] = np.flatnonzero(reference)
    others = np.flatnonzero(~reference)
    anchors = first[ties.measure_point[others]]
    plane, nominal = np.empty((others.size, 2)), np.empty((others.size, 2))
    for i, j, rows in by_pair(picture[anchors], picture[others]):
        places = ties.measures[anchors[rows]], ties.measures[others[rows]]
        plane[rows] = scene.pictures[i].on_chart(scene.ground, places[0])
        nominal[rows] = match_offsets(scene.pictures[i], scene.pictures[j], places, scene.ground)
    return plane, nominal
