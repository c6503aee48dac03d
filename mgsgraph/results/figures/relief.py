"""A registration by relief drawn: misfit over shifts with its minima, profiles and terrain models against the stereo
surface (Figure 4 of Yoon & Shan (2005) made a test), and the shifts onto it; before the adjustment with stereo
rows and after it.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from mgsgraph.geometry.body import east_north_up, geodetic
from mgsgraph.geometry.records import Array, thinned
from mgsgraph.registration.minima import CostSurface, ProfileState, ReliefProfile, ReliefRegistration
from mgsgraph.results.figures.sheet import (
    AFTER,
    BEFORE,
    CLASS_COLOUR,
    CLASS_MARKER,
    CLASS_NAME,
    INK,
    MOST_MARKS,
    MOST_SHEETS,
    SOFT,
    Sheet,
    limit,
    new_sheet,
    number,
    plain_style,
    sheet_name,
)
from mgsgraph.text import many, short
from mgsgraph.units import KM

_NAMED_MINIMA = 1e-3
"""Weight from which on a minimum is marked, besides the best two."""
_SHARE_DRAWN = 0.3
"""Share of the reach that is drawn of cost surfaces after the adjustment."""
_LEAST_TOP = 5.0
"""sigmas, upper end of the colors at least: what stays below it does not tie a profile."""
_STATES = ("before", "after")
_MISFIT = "root of the misfit above the best (sigmas)"


def relief_sheets(registration: ReliefRegistration) -> Iterator[Sheet]:
    """Cost surfaces and heights of the profiles that most need a look, those without a clear minimum first, then by
    how far they were off.
    """
    profiles = registration.profiles
    misplacements = [float(np.nan_to_num(np.linalg.norm(profile.before.misplacement))) for profile in profiles]
    order = sorted(range(len(profiles)), key=lambda p: (profiles[p].after.cost.clear, -misplacements[p]))
    shown = sorted(order[:MOST_SHEETS])
    yield _cost_sheet(registration, shown)
    for k, p in enumerate(shown):
        name = sheet_name("profiles", k + 1, len(shown))
        yield _posts_sheet(profiles[p], name) if profiles[p].of_posts else _profile_sheet(registration, profiles[p],
                                                                                          name)


# --- cost surfaces


@plain_style()
def _cost_sheet(registration: ReliefRegistration, chosen: Sequence[int]) -> Sheet:
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
    top = _color_limit([profiles[p].before.cost for p in chosen])
    shown = None
    for column, p in enumerate(chosen):
        profile = profiles[p]
        for row, state in enumerate((profile.before, profile.after)):
            panel = grid[row, column]
            shown = _draw_cost(panel, state.cost, top, 1.0 if row == 0 else _SHARE_DRAWN) or shown
            panel.set_title(f"{short(profile.name, 24)}, {_STATES[row]}")
            panel.set(xlabel="shift east (m)", ylabel="shift north (m)" if column == 0 else "")
        grid[0, column].add_patch(Circle((0.0, 0.0), float(shifts.sigmas[p]), fill=False, ls="--", ec=BEFORE))
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
    ]


def _color_limit(costs: Sequence[CostSurface]) -> float:
    """Upper end of the colors, in sigmas: what most shifts of some profiles stay below."""
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
    for k, minimum in enumerate(cost.minima):
        if k == 0:
            panel.plot(*minimum.shift, "X", ms=7, mfc="white", mec=INK, mew=0.8, zorder=5)
        elif k == 1 or minimum.weight >= _NAMED_MINIMA:
            panel.plot(*minimum.shift, "o", ms=6, mfc="none", mec="#CC79A7", mew=1.4, zorder=5)
    return shown


def _costs_caption(registration: ReliefRegistration, drawn_count: int) -> str:
    profiles = registration.profiles
    clear = sum(profile.after.cost.clear for profile in profiles)
    return (
        f"{clear} of {many(len(profiles), 'profile')} have one clear minimum; {drawn_count} are drawn. Colors: how "
        "badly a profile fits the stereo surface when it is shifted as a whole, level and slope along the track "
        "removed; above where the images were adjusted without relief, below with it, where zero is agreement."
    )


# --- profiles


@plain_style()
def _profile_sheet(registration: ReliefRegistration, profile: ReliefProfile, name: str) -> Sheet:
    """Heights of the shots and of the surface under them along the track, and their difference, before and after."""
    colour, marker = CLASS_COLOUR[profile.point_class], CLASS_MARKER[profile.point_class]
    title = f"Laser profile {short(profile.name, 30)} against the stereo surface"
    sheet = new_sheet(name, 10.0, 4.6, title, _profile_caption(profile))
    grid = sheet.panels(2, 2, heights=[2.0, 1.0], sharex=True, sharey="row")
    along = _plane_positions(profile)[:, 0]
    order = np.argsort(along, kind="stable")
    along, body = along[order], registration.solution.network.body
    for (upper, lower), state, heading in zip(grid.T, (profile.before, profile.after), _panel_titles(profile),
                                              strict=True):
        heights, differences = geodetic(state.points, body)[order, 2], _heights_above(profile, state)[order]
        upper.plot(along, heights - differences, color=AFTER, lw=1.0, marker=".", ms=2.5, zorder=2)
        upper.plot(along, heights, ls="", marker=marker, ms=3.0, mfc="none", mew=0.7, color=colour, zorder=3)
        upper.set_title(heading)
        lower.axhline(0.0, color=SOFT, lw=0.8, zorder=1)
        lower.plot(along, differences, color=INK, lw=0.7, marker=".", ms=3.0, zorder=2)
        lower.set_xlabel("along the track (km)")
    grid[0, 0].set_ylabel("height above the ellipsoid (m)")
    grid[1, 0].set_ylabel("shot minus surface (m)")
    sheet.legend([
        Line2D([], [], ls="", marker=marker, ms=5, mfc="none", color=colour, label=CLASS_NAME[profile.point_class]),
        Line2D([], [], color=AFTER, lw=1.0, marker=".", ms=4, label="stereo surface at the shots"),
    ])  # fmt: skip
    return sheet


@plain_style()
def _posts_sheet(profile: ReliefProfile, name: str) -> Sheet:
    """A terrain model's posts minus the stereo surface: a map after, and histograms before and after."""
    differences = np.array([_heights_above(profile, state) for state in (profile.before, profile.after)])
    half_range, reach, sides = limit(differences), float(np.nanmax(np.abs(differences),
                                                                   initial=1.0)), _plane_positions(profile)
    title = f"Terrain model {short(profile.name, 30)} minus the stereo surface"
    sheet = new_sheet(name, 10.0, 3.4, title, _profile_caption(profile), band=0.0)
    map_panel, histogram_panel = sheet.panels(1, 2)[0]
    marked = np.flatnonzero(profile.on_surface)[thinned(int(profile.on_surface.sum()), MOST_MARKS)]
    shown = map_panel.scatter(*sides[marked].T, c=differences[1, marked], s=9.0, cmap="RdBu_r", vmin=-half_range,
                              vmax=half_range, lw=0.2, ec=INK)
    map_panel.set(xlabel="along the longer side (km)", ylabel="across (km)")
    sheet.colour_bar(shown, map_panel, "post minus surface, after (m)", MaxNLocator(5), "both")
    histogram_panel.hist(differences.T, 40, range=(-reach, reach), histtype="step", color=[BEFORE, AFTER],
                         label=_panel_titles(profile))
    histogram_panel.set(xlabel="post minus surface (m)", ylabel="posts")
    histogram_panel.legend()
    return sheet


def _plane_positions(profile: ReliefProfile) -> Array:
    """(n, 2) km, where the points of a profile or model lie along its longer side and across."""
    offsets = profile.before.points - profile.before.points.mean(axis=0)
    sides = offsets @ np.linalg.svd(offsets, full_matrices=False)[2][:2].T
    return np.asarray((sides - sides.min(axis=0)) / KM)


def _heights_above(profile: ReliefProfile, state: ProfileState) -> Array:
    """(n,) m, heights of what lies on the surface above it; NaN elsewhere."""
    return np.where(profile.on_surface & state.heights.covered, vertical(state), np.nan)


def _panel_titles(profile: ReliefProfile) -> list[str]:
    """Titles of the panels before and after."""
    return [f"{s}: {number(rms)} m rms"
            for s, rms in zip(_STATES, (profile.rms_before, profile.rms_after), strict=True)]


def vertical(state: ProfileState) -> Array:
    """(n,) m, heights above the surface along the vertical."""
    up = np.einsum("nj,nj->n", east_north_up(state.points)[:, 2], state.heights.normals)
    return np.asarray(state.heights.heights / up)


def _profile_caption(profile: ReliefProfile) -> str:
    east, north = (number(size) for size in profile.before.misplacement.tolist())
    return (
        f"{profile.unit.capitalize()} minus surface: {number(profile.rms_before)} m rms before, "
        f"{number(profile.rms_after)} m after; before, it had to move {east} m east and {north} m north to fit. "
        f"{many(profile.on_surface.sum(), profile.unit)}."
    )


# --- shifts of all
