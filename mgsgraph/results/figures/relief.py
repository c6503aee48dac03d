"""A registration by relief drawn: misfit over shifts with its minima, profiles and terrain models against the stereo
surface (Figure 4 of Yoon & Shan (2005) made a test), and a map of the misplacements; before the adjustment with stereo
rows and after it.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from mgsgraph.geometry.body import centre_of, east_north_up, geodetic, plane_coordinates
from mgsgraph.geometry.records import Array, Index, thinned
from mgsgraph.network import PointClass
from mgsgraph.registration.minima import CostSurface, ProfileState, ReliefProfile, ReliefRegistration
from mgsgraph.results.figures.map import frame, map_axes
from mgsgraph.results.figures.sheet import (
    AFTER,
    BEFORE,
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
    round_figure,
    sheet_name,
    short,
)
from mgsgraph.text import many
from mgsgraph.units import KM

_LARGE, _MOST = 4, 52
"""Profiles that are drawn one by one, and those that have a row on the sheet of all."""
_NAMED_MINIMA = 1e-3
"""Weight from which on a minimum is marked, besides the best two."""
_NEAR = 0.3
"""Share of the reach that is drawn of cost surfaces after the adjustment."""
_LEAST_TOP = 5.0
"""sigmas, upper end of the colours at least: what stays below it does not tie a profile."""
_STATES = ("before", "after")
_MISFIT = "root of the misfit above the best (sigmas)"


def relief_sheets(registration: ReliefRegistration) -> Iterator[Sheet]:
    """Cost surfaces, profiles and the map; those profiles large that most need a look, the others together."""
    order = _worst_first(registration.profiles)
    large, small = sorted(order[:_LARGE]), order[_LARGE:]
    yield _costs(registration, large)
    sheets = len(large) + bool(small)
    for k, p in enumerate(large):
        yield _profile(registration, registration.profiles[p], sheet_name("profiles", k + 1, sheets))
    if small:
        yield _heights_of_all(registration, sheet_name("profiles", sheets, sheets))
    yield _map(registration)


def _worst_first(profiles: Sequence[ReliefProfile]) -> list[int]:
    """Numbers of profiles: those without a clear minimum first, then by how far they were off."""
    off = [float(np.nan_to_num(np.linalg.norm(one.before.misplacement))) for one in profiles]
    return sorted(range(len(profiles)), key=lambda p: (profiles[p].after.cost.clear, -off[p]))


# --- cost surfaces


@plain_style()
def _costs(registration: ReliefRegistration, chosen: Sequence[int]) -> Sheet:
    """Misfit over shifts of some profiles, before above after."""
    profiles, shifts = registration.profiles, registration.solution.network.shifts
    assert shifts is not None
    count = len(chosen)
    side = 3.1 if count <= 2 else 2.5
    sheet = new_sheet(
        "costs", max(count * (side + 0.35) + 0.6, 6.4), 2.0 * (side + 0.45) + 0.5,
        f"Misfit over shifts: {short(registration.name, 50)}", _costs_caption(registration, len(chosen)),
    )  # fmt: skip
    grid = sheet.panels(2, count)
    top = _top([profiles[p].before.cost for p in chosen])
    shown = None
    for c, p in enumerate(chosen):
        one, prior = profiles[p], float(shifts.sigmas[p])
        for row, state in enumerate((one.before, one.after)):
            panel = grid[row, c]
            shown = _draw_cost(panel, state.cost, top, 1.0 if row == 0 else _NEAR) or shown
            if state.cost.minima and row == 0:
                draw_ellipse(panel, np.zeros(2), np.eye(2) * prior**2, "--")
            elif state.cost.minima:
                draw_ellipse(panel, state.cost.minima[0].shift, state.cost.minima[0].covariance, "-")
            panel.set_title(f"{short(one.name, 24)}, {_STATES[row]}")
            panel.set(xlabel="shift east (m)", ylabel="shift north (m)" if c == 0 else "")
    if shown is not None:
        sheet.colour_bar(shown, grid.ravel().tolist(), _MISFIT, MaxNLocator(6), "max")
    sheet.legend(_cost_handles())
    return sheet


def _cost_handles() -> list[Line2D]:
    return [
        Line2D([], [], ls="", marker="+", ms=8, mew=1.2, color=INK, label="where the profile is"),
        Line2D([], [], ls="", marker="X", ms=7, mfc="white", mec=INK, label="best shift"),
        Line2D([], [], ls="", marker="o", ms=6, mfc="none", mec="#CC79A7", mew=1.4, label="other minima"),
        Line2D([], [], ls="--", lw=1.1, color=BEFORE, label="a-priori sigma"),
        Line2D([], [], ls="-", lw=1.1, color=BEFORE, label="sigma of the best shift"),
    ]


def _top(costs: Sequence[CostSurface]) -> float:
    """Upper end of the colours, in sigmas: what most shifts of some profiles stay below."""
    values = [np.sqrt(np.nanquantile(_above_best(cost), 0.9)) for cost in costs if cost.minima]
    return max(float(np.median(values)), _LEAST_TOP) if values else _LEAST_TOP


def _above_best(cost: CostSurface) -> Array:
    """(k, k) chi-square above that of the best shift."""
    return np.asarray((cost.misfits - np.nanmin(cost.misfits)) / cost.scale)


def _draw_cost(panel: Axes, cost: CostSurface, top: float, share: float) -> AxesImage | None:
    """The cost surface with its minima, a share of its reach; words where too few shots are on the surface."""
    panel.grid(visible=False)
    panel.set_facecolor("#DDDDDD")
    reach = float(cost.shifts[-1] + 0.5 * (cost.shifts[1] - cost.shifts[0]))
    panel.set(xlim=(-share * reach, share * reach), ylim=(-share * reach, share * reach), aspect="equal")
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10], symmetric=True))
    if not cost.minima:
        panel.text(0.5, 0.5, "too few shots\non the surface", ha="center", va="center", transform=panel.transAxes)
        return None
    shown = panel.imshow(
        np.ma.masked_invalid(np.sqrt(_above_best(cost)).T), extent=(-reach, reach, -reach, reach), origin="lower",
        cmap="viridis_r", vmin=0.0, vmax=top, interpolation="nearest",
    )  # fmt: skip
    panel.plot(0.0, 0.0, "+", ms=8, mew=1.2, color=INK, zorder=4)
    for k, one in enumerate(cost.minima):
        if k == 0:
            panel.plot(*one.shift, "X", ms=7, mfc="white", mec=INK, mew=0.8, zorder=5)
        elif k == 1 or one.weight >= _NAMED_MINIMA:
            panel.plot(*one.shift, "o", ms=6, mfc="none", mec="#CC79A7", mew=1.4, zorder=5)
    return shown


def draw_ellipse(panel: Axes, middle: Array, covariance: Array, stroke: str, colour: str = BEFORE) -> None:
    """One standard deviation about a position, in the units of the panel."""
    values, ways = np.linalg.eigh(covariance)
    width, height = 2.0 * np.sqrt(np.maximum(values, 0.0))
    angle = float(np.degrees(np.arctan2(ways[1, 0], ways[0, 0])))
    panel.add_patch(
        Ellipse((middle[0], middle[1]), width, height, angle=angle, fill=False, ls=stroke, lw=1.1, ec=colour, zorder=7)
    )


def _costs_caption(registration: ReliefRegistration, shown: int) -> str:
    profiles = registration.profiles
    clear = sum(one.after.cost.clear for one in profiles)
    tied = sum(one.after.cost.tied for one in profiles)
    text = (
        "How badly each profile fits the stereo surface when it is shifted as a whole, level and slope along the track "
        "removed: above where the images were adjusted without relief, below with it, where zero is agreement; "
        f"{clear} of {many(len(profiles), 'profile')} with one clear minimum, {len(profiles) - tied} not tied by relief"
    )
    more = len(profiles) - shown
    return f"{text}; grey: too few shots on the surface{f'; of {more} more see profiles.csv' if more else ''}."


# --- profiles


@plain_style()
def _profile(registration: ReliefRegistration, one: ReliefProfile, name: str) -> Sheet:
    """Heights of the shots and of the surface under them along the track, and their difference, before and after."""
    what, colour, marker = "Laser profile", CLASS_COLOUR[one.point_class], CLASS_MARKER[one.point_class]
    if one.of_posts:
        what = "Terrain model"
    sheet = new_sheet(
        name, 10.0, 4.6, f"{what} {short(one.name, 30)} against the stereo surface", _profile_caption(one)
    )
    grid = sheet.panels(2, 2, heights=[2.0, 1.0], sharex=True, sharey="row")
    order, along, stroke = _along(one)
    body = registration.solution.network.images[0].body
    up, covariances = east_north_up(one.before.points)[:, 2], registration.solution.network.points.covariances[one.mine]
    sigmas = np.hypot(one.sigmas, np.sqrt(np.einsum("ni,nij,nj->n", up, covariances, up)))
    sigmas = np.where(one.taken, sigmas, np.nan)[order]
    widest = 0.0
    for c, state in enumerate((one.before, one.after)):
        upper, lower = grid[:, c]
        heights, off = geodetic(state.points, body)[:, 2], vertical(state)
        off = np.where(one.taken & state.heights.covered, off, np.nan)
        heights, off = heights[order], off[order]
        upper.plot(along, heights - off, color=AFTER, ls=stroke, lw=1.0, marker=".", ms=2.5, zorder=2)
        upper.plot(along, heights, ls="", marker=marker, ms=3.0, mfc="none", mew=0.7, color=colour, zorder=3)
        upper.set_title(_STATES[c])
        lower.axhline(0.0, color=SOFT, lw=0.8, zorder=1)
        lower.fill_between(along, -sigmas, sigmas, color=SOFT, alpha=0.35, lw=0.0, zorder=1)
        lower.plot(along, off, color=INK, ls=stroke, lw=0.7, marker=".", ms=3.0, zorder=2)
        lower.set_xlabel(f"along {'its longer side' if one.of_posts else 'the track'} (km)")
        known = np.abs(off[np.isfinite(off)])
        if known.size:
            widest = max(widest, min(float(known.max()), _CLIPPED * float(np.quantile(known, 0.95))))
    grid[0, 0].set_ylabel("height above the ellipsoid (m)")
    grid[1, 0].set_ylabel(f"{one.unit} minus surface (m)")
    grid[1, 0].set_ylim(-1.15 * max(widest, 1.0), 1.15 * max(widest, 1.0))
    sheet.legend([
        Line2D([], [], ls="", marker=marker, ms=5, mfc="none", color=colour, label=CLASS_NAME[one.point_class]),
        Line2D([], [], color=AFTER, ls=stroke, lw=1.0, marker=".", ms=4, label=f"stereo surface at the {one.unit}s"),
        Line2D([], [], color=SOFT, lw=6.0, alpha=0.35, label="a-priori sigma of a difference"),
    ])  # fmt: skip
    return sheet


_CLIPPED = 4.0
"""Times the 95 % quantile of differences, beyond which single ones are cut off."""


def _along(one: ReliefProfile) -> tuple[Index, Array, str]:
    """Order (n,) of points, and where they lie in this order, km: shots along their track, posts along the longer side
    of their model; the stroke that joins them.
    """
    points = one.before.points
    if not one.of_posts:
        return np.arange(len(points)), along_track(points) / KM, "-"
    apart = points - points.mean(axis=0)
    along = apart @ np.linalg.svd(apart, full_matrices=False)[2][0]
    order = np.argsort(along, kind="stable")
    return order, (along[order] - along[order[0]]) / KM, ""


def along_track(points: Array) -> Array:
    """(n,) m from the first of points (n, 3), along the track."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def vertical(state: ProfileState) -> Array:
    """(n,) m, heights above the surface along the vertical."""
    up = np.einsum("nj,nj->n", east_north_up(state.points)[:, 2], state.heights.normals)
    return np.asarray(state.heights.heights / up)


def _profile_caption(one: ReliefProfile) -> str:
    on = int(one.taken.sum())
    what = "terrain model" if one.of_posts else "profile"
    text = f"{on} of {many(one.mine.size, one.unit)} lie on the surface that the images show"
    if not on:
        return f"{text}: the {what} takes no part."
    text += f"; {one.unit} minus surface {number(one.rms_before)} m rms before, {number(one.rms_after)} m after"
    if not one.after.cost.tied:
        return f"{text}; relief does not tie the {what} horizontally."
    if not one.before.cost.tied:
        return f"{text}; before, nothing said by how much the {what} had to move."
    east, north = one.before.misplacement
    return (
        f"{text}; before, the {what} had to move {number(round(float(east)))} m east and "
        f"{number(round(float(north)))} m north to fit."
    )


@plain_style()
def _heights_of_all(registration: ReliefRegistration, name: str) -> Sheet:
    """Rms of shot minus surface and misplacement of every profile, before and after."""
    profiles = registration.profiles
    shown = [profiles[p] for p in thinned(len(profiles), _MOST).tolist()]
    rms = np.array([[one.rms_before, one.rms_after] for one in shown])
    off = np.array([[np.linalg.norm(state.misplacement) for state in (one.before, one.after)] for one in shown])
    omitted = f"; {len(shown)} of {len(profiles)} are drawn, profiles.csv has all" if shown[len(profiles) :] else ""
    middle = np.nanmedian(np.hstack([off, rms]), axis=0) if np.any(np.isfinite(rms)) else np.full(4, np.nan)
    caption = (
        f"All profiles: misplacement {number(middle[0])} m before and {number(middle[1])} m after, rms of shot minus "
        f"surface {number(middle[2])} and {number(middle[3])} m (medians); no mark where relief does not tie a profile"
        f"{omitted}."
    )
    title = "All profiles and terrain models, and the stereo surface"
    sheet = new_sheet(name, 8.4, 0.16 * len(shown) + 0.9, title, caption)
    grid = sheet.panels(1, 2, sharey=True)[0]
    rows = np.arange(len(shown))
    kinds = ("misplacement (m)", off), ("rms of shot minus surface (m)", rms)
    for panel, (what, values) in zip(grid, kinds, strict=True):
        for k, (colour, marker) in enumerate(((BEFORE, "o"), (AFTER, "s"))):
            panel.plot(np.maximum(values[:, k], 1e-3), rows, marker, ms=4.0, color=colour, zorder=3)
        panel.set_xscale("log")
        panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        panel.xaxis.set_major_formatter("{x:g}")
        panel.xaxis.set_minor_formatter(NullFormatter())
        panel.set_xlabel(what)
    grid[0].set_yticks(rows, [short(one.name, 18) for one in shown], size=7.0)
    grid[0].set_ylim(len(shown) - 0.5, -0.5)
    sheet.legend([
        Line2D([], [], ls="", marker="o", color=BEFORE, label="before"),
        Line2D([], [], ls="", marker="s", color=AFTER, label="after"),
    ])  # fmt: skip
    return sheet


# --- the map


@plain_style()
def _map(registration: ReliefRegistration) -> Sheet:
    """Tie points, shots, and of each profile an arrow by which it has to move, before and after."""
    solution, profiles = registration.solution, registration.profiles
    centre = centre_of(solution.places)
    ties = solution.members(PointClass.TIE)
    tracks = [plane_coordinates(one.before.points, centre) / KM for one in profiles]
    places = plane_coordinates(solution.places[ties], centre) / KM
    low, high, (width, height) = frame(np.concatenate([places, *tracks]), (4.6, 3.0))
    title = "Misplacement of laser, terrain models and images"
    sheet = new_sheet("shifts", width + 1.2, height + 0.75, title, _map_caption(profiles))
    panel: Axes = sheet.panels()[0, 0]
    map_axes(panel, low, high, centre)
    some = thinned(ties.size, MOST_MARKS)
    panel.plot(*places[some].T, "o", ms=1.8, color=SOFT, mew=0.0, zorder=2)
    for one, track in zip(profiles, tracks, strict=True):
        for mask, marker in ((one.taken, CLASS_MARKER[one.point_class]), (~one.taken, "x")):
            mine = np.flatnonzero(mask)[thinned(int(mask.sum()), MOST_MARKS // len(profiles) + 1)]
            panel.plot(
                *track[mine].T, ls="", marker=marker, ms=2.4, mfc="none", mew=0.5, color=CLASS_COLOUR[one.point_class],
                zorder=3,
            )
    _draw_arrows(panel, profiles, tracks, float((high - low).max()))
    sheet.legend([
        Line2D([], [], ls="", marker="o", ms=3, color=SOFT, label="tie points"),
        *(
            Line2D([], [], ls="", marker=CLASS_MARKER[c], ms=4, mfc="none", color=CLASS_COLOUR[c], label=CLASS_NAME[c])
            for c in sorted({one.point_class for one in profiles})
        ),
        Line2D([], [], color=BEFORE, lw=2.5, label="before"),
        Line2D([], [], color=AFTER, lw=2.5, label="after"),
    ])  # fmt: skip
    return sheet


def _draw_arrows(panel: Axes, profiles: Sequence[ReliefProfile], tracks: Sequence[Array], side: float) -> None:
    """Misplacements in the middle of each profile, enlarged, with a scale; `side` is that of the map in km."""
    off = np.array([[one.before.misplacement, one.after.misplacement] for one in profiles])
    sizes = np.linalg.norm(off[:, 0], axis=1)
    if not np.any(np.isfinite(sizes)):
        panel.text(0.5, 0.5, "relief ties no profile", ha="center", va="center", transform=panel.transAxes)
        return
    longest = max(float(np.nanmax(np.linalg.norm(off, axis=2))), 1e-3)
    metres_per_km = longest / (0.16 * side)
    starts = np.array([_start(one, track, p) for p, (one, track) in enumerate(zip(profiles, tracks, strict=True))])
    for k, (colour, thick) in enumerate(((BEFORE, 0.005), (AFTER, 0.004))):
        arrows = panel.quiver(
            *starts.T, *off[:, k].T, color=colour, angles="xy", scale_units="xy", scale=metres_per_km, width=thick,
            units="height", zorder=5 + k,
        )  # fmt: skip
        if k == 0:
            scale = round_figure(longest)
            panel.quiverkey(arrows, 0.84, 0.04, scale, f"{scale:g} m", labelpos="N", coordinates="axes", color=INK)
    for one, start in zip(profiles, starts, strict=True):
        if one.after.cost.tied:
            covariance = one.after.misplacement_covariance / metres_per_km**2
            draw_ellipse(panel, start + one.after.misplacement / metres_per_km, covariance, "-", AFTER)
        if len(profiles) <= _LARGE:
            panel.annotate(short(one.name, 16), start, (8.0, 4.0), textcoords="offset points", size=7.5, zorder=8)


def _start(one: ReliefProfile, track: Array, p: int) -> Array:
    """(2,) km, where the arrow of the p-th profile begins: neighbours' at different parts of their tracks."""
    shots = np.flatnonzero(one.taken) if np.any(one.taken) else np.arange(len(track))
    share = 0.3 + 0.1 * (2 * p % 5)
    share = 1.0 - share if one.of_posts else share  # posts begin in the north
    return np.asarray(track[shots[int(share * (shots.size - 1))]])


def _map_caption(profiles: Sequence[ReliefProfile]) -> str:
    off = np.array([
        [np.linalg.norm(state.misplacement) for state in (one.before, one.after)] for one in profiles
    ])  # fmt: skip
    known = np.all(np.isfinite(off), axis=1)
    text = "By how much each profile has to move onto the surface that the images show (arrows, enlarged, with sigmas)"
    if not np.any(known):
        return f"{text}: relief ties none."
    before, after = np.sqrt(np.mean(off[known] ** 2, axis=0))
    return (
        f"{text}: {number(float(before))} m before and {number(float(after))} m after the adjustment with stereo rows "
        f"(rms of {many(int(known.sum()), 'profile')}); crosses: what takes no part."
    )
