"""The mission's story in one picture, as only a simulation can tell it: a laser profile against the stereo surface at a
steep place, before and after registration by relief, and where its footprints truly are.
"""

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from mgsgraph.geometry.body import centre_of, geodetic, plane_coordinates, planetocentric
from mgsgraph.geometry.body import east_north as ways
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import PointClass
from mgsgraph.registration.minima import ReliefProfile, ReliefRegistration
from mgsgraph.results.figures.map import map_axes
from mgsgraph.results.figures.relief import along_track, vertical
from mgsgraph.results.figures.sheet import (
    AFTER,
    BEFORE,
    CLASS_COLOUR,
    INK,
    Sheet,
    new_sheet,
    number,
    plain_style,
    short,
)
from mgsgraph.units import KM

_SHOTS = 14
"""In the picture: 4 km."""
_POSTS = 160
"""Of the shaded ground, along the longer side."""
_SUN = np.array([-1.0, 1.0]) / np.sqrt(2.0)
"""Direction of the light on the map: from the north-west."""
_LASER = CLASS_COLOUR[PointClass.LASER]


@plain_style()
def story_sheet(
    registration: ReliefRegistration,
    profile: ReliefProfile,
    truth: Array,
    ground_radius: Callable[[Array, Array], Array],
    caption: str,
) -> Sheet:
    """Heights along the steepest part of one profile, above before and below after, and a map of its footprints.

    Parameters
    ----------
    registration : ReliefRegistration
        With the profile.
    profile : ReliefProfile
        n shots.
    truth : (n, 3)
        m, body-fixed, where they truly are.
    ground_radius : callable
        Radius (k,) in m of the true ground at longitudes and latitudes (k,) in rad.
    caption : str
        What the picture shows in a sentence.
    """
    apart = [float(np.linalg.norm(state.points - truth, axis=1).mean()) for state in (profile.before, profile.after)]
    caption += (
        f" On the map the profile lies {number(round(apart[1]))} m from its true place (before "
        f"{number(round(apart[0]))} m): what laser and images share, relief does not see."
    )
    title = f"MOLA and MOC before and after registration by relief: {short(profile.name, 20)}"
    sheet = new_sheet("story", 7.6, 5.2, title, caption)
    panels = sheet.figure.subplot_mosaic([["before", "map"], ["after", "map"]], width_ratios=[1.45, 1.0])
    mine = _steepest(profile)
    body = registration.solution.network.images[0].body
    along = along_track(profile.before.points[mine]) / KM
    for name, state, colour in (("before", profile.before, BEFORE), ("after", profile.after, AFTER)):
        heights, off = geodetic(state.points, body)[mine, 2], vertical(state)[mine]
        panel = panels[name]
        panel.plot(along, heights - off, color=INK, lw=1.2, zorder=2)
        panel.plot(along, heights, ls="", marker="^", ms=5.0, mfc=colour, mec=INK, mew=0.5, zorder=3)
        rms = np.sqrt(np.mean(off**2))
        panel.set_title(f"{name}: shot minus surface {rms:.1f} m rms")
        panel.set_ylabel("height above the ellipsoid (m)")
    panels["before"].sharey(panels["after"])
    panels["after"].set_xlabel("along the track (km)")
    _map(panels["map"], profile, mine, truth, ground_radius)
    sheet.legend([
        Line2D([], [], color=INK, lw=1.2, label="stereo surface at the shots"),
        Line2D([], [], ls="", marker="^", ms=5, mfc=BEFORE, mec=INK, mew=0.5, label="shots before"),
        Line2D([], [], ls="", marker="^", ms=5, mfc=AFTER, mec=INK, mew=0.5, label="shots after"),
        Line2D([], [], ls="", marker="+", ms=8, mew=1.2, color=_LASER, label="where they truly are"),
    ])  # fmt: skip
    return sheet


def _steepest(profile: ReliefProfile) -> Index:
    """Shots on the surface that follow one another where the surface rises and falls most."""
    on = np.flatnonzero(profile.taken & profile.before.heights.covered & profile.after.heights.covered)
    if on.size <= _SHOTS:
        return on
    radius = np.linalg.norm(profile.after.points[on], axis=1)
    steps = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(radius)))])
    first = int(np.argmax(steps[_SHOTS - 1 :] - steps[: 1 - _SHOTS]))
    return on[first : first + _SHOTS]


def _map(
    panel: Axes, profile: ReliefProfile, mine: Index, truth: Array, ground_radius: Callable[[Array, Array], Array]
) -> None:
    """Footprints before, after and in truth over the shaded true ground."""
    given, found, true = (one[mine] for one in (profile.before.points, profile.after.points, truth))
    centre = centre_of(true)
    places = [plane_coordinates(one, centre) / KM for one in (given, found, true)]
    corners = np.concatenate(places)
    low, high = corners.min(axis=0) - 0.25, corners.max(axis=0) + 0.25
    lack = np.maximum(0.45 * float((high - low).max()) - (high - low), 0.0)
    low, high = low - 0.5 * lack, high + 0.5 * lack
    shade = _shaded(centre, low * KM, high * KM, ground_radius)
    panel.imshow(
        shade, extent=(low[0], high[0], low[1], high[1]), origin="lower", cmap="gray", vmin=-1.0, vmax=1.0,
        interpolation="bilinear",
    )  # fmt: skip
    panel.grid(visible=False)
    for (x, y), (u, v) in zip(places[0], places[1], strict=True):
        panel.plot([x, u], [y, v], color="white", lw=0.7, zorder=3)
    for points, colour in zip(places[:2], (BEFORE, AFTER), strict=True):
        panel.plot(*points.T, ls="", marker="^", ms=5.0, mfc=colour, mec=INK, mew=0.5, zorder=4)
    panel.plot(*places[2].T, ls="", marker="+", ms=8.0, mew=1.2, color=_LASER, zorder=4)
    map_axes(panel, low, high, centre)


def _shaded(centre: Array, low: Array, high: Array, ground_radius: Callable[[Array, Array], Array]) -> Array:
    """(rows, columns) brightness -1 .. 1 of the ground between corners (2,), m about a centre (3,); from the south."""
    step = float((high - low).max()) / _POSTS
    east, north = (np.arange(a, b, step) for a, b in zip(low, high, strict=True))
    plane = np.stack(np.meshgrid(east, north), axis=-1)
    longitude, latitude, _ = planetocentric(centre + plane.reshape(-1, 2) @ ways(centre[None])[0]).T
    radii = ground_radius(longitude, latitude).reshape(plane.shape[:2])
    by_north, by_east = np.gradient(radii, step)
    slope = -(by_east * _SUN[0] + by_north * _SUN[1])
    return np.asarray(np.clip(slope / (2.5 * max(float(np.std(slope)), 1e-9)), -1.0, 1.0))
