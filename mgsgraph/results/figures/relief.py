"""A registration by relief drawn: misfit over shifts with its minima, profiles and terrain models against the stereo
surface (Figure 4 of Yoon & Shan (2005) made a test), and a map of the misplacements; before the adjustment with stereo
rows and after it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from mgsgraph.geometry.body import centre_of, east_north_up, geodetic, plane_coordinates
from mgsgraph.geometry.records import Array, Index
from mgsgraph.registration.minima import CostSurface, ProfileState, ReliefProfile, ReliefRegistration
from mgsgraph.results.figures.map import draw_ellipse, outlines_of, points_window, window_sheet
from mgsgraph.results.figures.sheet import (
    AFTER,
    BEFORE,
    CLASS_COLOUR,
    CLASS_MARKER,
    CLASS_NAME,
    INK,
    MOST_SHEETS,
    SOFT,
    Sheet,
    new_sheet,
    number,
    plain_style,
    sheet_name,
    short,
)
from mgsgraph.text import many
from mgsgraph.units import KM

_NAMED_MINIMA = 1e-3
"""Weight from which on a minimum is marked, besides the best two."""
_NEAR = 0.3
"""Share of the reach that is drawn of cost surfaces after the adjustment."""
_LEAST_TOP = 5.0
"""sigmas, upper end of the colours at least: what stays below it does not tie a profile."""
_STATES = ("before", "after")
_MISFIT = "root of the misfit above the best (sigmas)"


def relief_sheets(registration: ReliefRegistration) -> Iterator[Sheet]:
    """Cost surfaces and heights of the profiles that most need a look, those without a clear minimum first, then by
    how far they were off; and the map of all.
    """
    profiles = registration.profiles
    off = [float(np.nan_to_num(np.linalg.norm(one.before.misplacement))) for one in profiles]
    order = sorted(range(len(profiles)), key=lambda p: (profiles[p].after.cost.clear, -off[p]))
    shown = sorted(order[:MOST_SHEETS])
    yield _costs(registration, shown)
    for k, p in enumerate(shown):
        yield _profile(registration, profiles[p], sheet_name("profiles", k + 1, len(shown)))
    yield _map(registration)


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


def _costs_caption(registration: ReliefRegistration, shown: int) -> str:
    profiles = registration.profiles
    clear = sum(one.after.cost.clear for one in profiles)
    return (
        "How badly each profile fits the stereo surface when it is shifted as a whole, level and slope along the track "
        "removed: above where the images were adjusted without relief, below with it, where zero is agreement; "
        f"{clear} of {many(len(profiles), 'profile')} have one clear minimum, {shown} are drawn."
    )


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
    (order, along), stroke = _along(one), "" if one.of_posts else "-"
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
        lower.set_xlabel("along the longer side (km)")
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


def _along(one: ReliefProfile) -> tuple[Index, Array]:
    """Order (n,) of points along the longer side of a profile or model, and where they lie in this order, km."""
    apart = one.before.points - one.before.points.mean(axis=0)
    along = apart @ np.linalg.svd(apart, full_matrices=False)[2][0]
    order = np.argsort(along, kind="stable")
    return order, (along[order] - along[order[0]]) / KM


def vertical(state: ProfileState) -> Array:
    """(n,) m, heights above the surface along the vertical."""
    up = np.einsum("nj,nj->n", east_north_up(state.points)[:, 2], state.heights.normals)
    return np.asarray(state.heights.heights / up)


def _profile_caption(one: ReliefProfile) -> str:
    east, north = (number(size) for size in one.before.misplacement.tolist())
    return (
        f"{int(one.taken.sum())} of {many(one.mine.size, one.unit)} lie on the surface that the images show; "
        f"{one.unit} minus surface {number(one.rms_before)} m rms before, {number(one.rms_after)} m after; before, "
        f"it had to move {east} m east and {north} m north to fit."
    )


# --- the map


def _map(registration: ReliefRegistration) -> Sheet:
    """On each profile by how much it has to move onto the stereo surface: before an arrow, after a color and an
    ellipse; of neighbors at different parts of their tracks.
    """
    solution, profiles = registration.solution, registration.profiles
    centre = centre_of(solution.places)
    shares = 0.3 + 0.1 * (2 * np.arange(len(profiles)) % 5)
    marked = [one.before.points[int(share * one.mine.size)] for one, share in zip(profiles, shares, strict=True)]
    marks = plane_coordinates(np.array(marked), centre)
    before, after = (np.array([getattr(one, state).misplacement for one in profiles]) for state in _STATES)
    covariances = np.array([one.after.misplacement_covariance for one in profiles])
    outlines, classes = outlines_of(solution, centre), np.array([one.point_class for one in profiles])
    about = registration.name, centre, np.concatenate([marks, *outlines.values()]), outlines
    quantity = "misplacement after (arrows: before)", "m"
    shown = points_window(
        about, marks, np.linalg.norm(after, axis=1), quantity, classes, covariances, before, noun="profile"
    )
    return replace(window_sheet(shown), name="shifts")
