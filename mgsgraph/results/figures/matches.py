"""Matches drawn: where they are and how sharp, by how much the nominal orientations contradict each other at them, and
what is left of it.
"""

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from mgsgraph.geometry.records import Array
from mgsgraph.matching.coarse import apart
from mgsgraph.matching.match import Matches
from mgsgraph.matching.scene import Scene, by_pair, footprints
from mgsgraph.results.figures.sheet import AFTER, BEFORE, INK, MOST_MARKS, SOFT, Sheet, new_sheet, number, plain_style
from mgsgraph.units import KM

_BINS = 40
_SHOWN = 0.99
"""Share of the values that histograms reach to."""


class _Drawn(NamedTuple):
    """Matches with their references, n of them."""

    plane: Array
    """(n, 2) m of the chart."""
    nominal: Array
    """(n, 2) m, displacement by the nominal orientations, across and along."""
    sigma: Array
    """(n,) pixels."""
    misfit: Array
    """(n,) m."""


@plain_style()
def matches_sheet(matches: Matches, scene: Scene, name: str) -> Sheet:
    """Map, nominal contradiction along the flight, histograms of sigma and of what is left."""
    drawn = _drawn(matches, scene)
    title = f"Matches between images: {name}"
    sheet = new_sheet("matches", 11.2, 4.6, title, _caption(matches, scene, drawn))
    where, nominal, sigmas, left = sheet.panels(1, 4, widths=[0.9, 1.2, 0.9, 0.9])[0]
    _map(where, scene, drawn)
    some = _some(drawn)
    nominal.plot(drawn.nominal[some, 0], drawn.plane[some, 1] / KM, ".", ms=2.5, color=AFTER)
    nominal.plot(drawn.nominal[some, 1], drawn.plane[some, 1] / KM, ".", ms=2.5, color=BEFORE)
    nominal.set(
        xlabel="second minus first (m on the ground)", ylabel="along the flight (km)", title="nominal orientation"
    )
    _histogram(sigmas, drawn.sigma)
    sigmas.set(xlabel="sigma of a match (px)", ylabel="matches", title="least-squares matching")
    _histogram(left, drawn.misfit)
    left.set(xlabel="coplanarity residual (m)", title="left under free orientation")
    sheet.legend([
        Line2D([], [], color=INK, lw=1.0, label="footprints"),
        Line2D([], [], color=SOFT, marker="o", ls="", ms=3.5, label="tie points"),
        Line2D([], [], color=AFTER, marker=".", ls="", label="across the plane of rays (orientation alone)"),
        Line2D([], [], color=BEFORE, marker=".", ls="", label="in it (height, and orientation)"),
    ])  # fmt: skip
    return sheet


def _drawn(matches: Matches, scene: Scene) -> _Drawn:
    ties, reference = matches.ties, matches.reference
    number_of = {picture.image.name: j for j, picture in enumerate(scene.pictures)}
    picture = np.array([number_of[name] for name in ties.measure_image])
    first = np.zeros(len(ties.ids), dtype=np.int64)
    first[ties.measure_point[reference]] = np.flatnonzero(reference)
    others = np.flatnonzero(~reference)
    anchors = first[ties.measure_point[others]]
    plane, nominal = np.empty((others.size, 2)), np.empty((others.size, 2))
    for i, j, mine in by_pair(picture[anchors], picture[others]):
        places = ties.measures[anchors[mine]], ties.measures[others[mine]]
        plane[mine] = scene.pictures[i].on_chart(scene.ground, places[0])
        nominal[mine] = apart(scene.pictures[i], scene.pictures[j], places, scene.ground)
    sigma = np.sqrt(np.linalg.eigvalsh(matches.covariances[others])[:, 1])
    return _Drawn(plane, nominal, sigma, matches.misfit[others])


def _some(drawn: _Drawn) -> slice:
    return slice(None, None, max(1, -(-drawn.sigma.size // MOST_MARKS)))


def _map(panel: Axes, scene: Scene, drawn: _Drawn) -> None:
    for one in footprints(scene):
        panel.plot(*(scene.ground.chart.plane(one.outline) / KM).T, color=INK, lw=0.8)
    some = _some(drawn)
    panel.plot(*(drawn.plane[some] / KM).T, "o", ms=2.0, color=SOFT)
    panel.set(xlabel="across the flight (km)", ylabel="along the flight (km)", title="where")


def _histogram(panel: Axes, values: Array) -> None:
    size = float(np.quantile(np.abs(values), _SHOWN))
    low = -size if np.any(values < 0.0) else 0.0
    panel.hist(values, bins=_BINS, range=(low, max(size, 1e-9)), color=AFTER)
    panel.axvline(float(np.median(values)), color=INK, ls="--", lw=1.0)
    panel.locator_params(axis="x", nbins=5)


def _caption(matches: Matches, scene: Scene, drawn: _Drawn) -> str:
    filled, whole = matches.cells
    across, along = np.median(drawn.nominal, axis=0)
    return (
        f"{len(matches.ties.ids)} tie points from {len(scene.pictures)} images in {filled} of {whole} cells of "
        f"{number(matches.cell)} m (the map's two scales differ). By the nominal orientations the second sees them "
        f"{number(across)} m off across the plane of the two rays and {number(along)} m along it (medians). Dashed: "
        f"medians; sigma {number(float(np.median(drawn.sigma)))} px; {_SHOWN:.0%} of the values are shown."
    )
