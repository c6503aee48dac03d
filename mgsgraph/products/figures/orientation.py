"""Corrections of the exterior orientation along the image, with their 1-sigma bands."""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mgsgraph.adjustment.solution import OrientationProfile, Solution, orientation_profile
from mgsgraph.products.figures.sheet import (
    AFTER,
    MOST_SHEETS,
    SOFT,
    Sheet,
    in_sheets,
    left_out,
    legend,
    new_sheet,
    number,
    panels,
    sheet_name,
    short,
    words,
)
from mgsgraph.units import ARCSEC

_PER_SHEET = 4
_PLACES = 101
_ROWS = ("X (m)", "Y (m)", "Z (m)", "about x\n(arcsec)", "about y\n(arcsec)", "about z\n(arcsec)")


def orientation_sheets(solution: Solution) -> Iterator[Sheet]:
    """Sheets of up to four images; of a large block, the first ones."""
    images = range(len(solution.network.images))
    chosen = images[: _PER_SHEET * MOST_SHEETS]
    sheets = in_sheets(chosen, _PER_SHEET)
    omitted = left_out(len(images), len(chosen), f"first {len(chosen)}")
    for n, some in enumerate(sheets):
        yield _sheet(solution, some, sheet_name("orientation", n + 1, len(sheets)), omitted)


def _sheet(solution: Solution, images: Sequence[int], name: str, omitted: str) -> Sheet:
    profiles = [orientation_profile(solution, j, _PLACES) for j in images]
    held = [bool(solution.network.held[j]) for j in images]
    caption = _caption(profiles, [coupling(solution, j) for j in images], held) + omitted + "."
    sheet = new_sheet(name, max(7.2, 0.9 + 3.1 * len(images)), 8.4, "Corrections of the exterior orientation", caption)
    grid = panels(sheet, 6, len(images), across=0.25)
    for column, (j, profile, fixed) in enumerate(zip(images, profiles, held, strict=True)):
        for n, (value, sigma) in enumerate(components(profile)):
            panel = grid[n, column]
            panel.sharey(grid[n, 0])
            _draw(panel, profile, value, sigma, fixed)
            panel.tick_params(labelbottom=n == 5, labelleft=column == 0)
            title = short(solution.network.images[j].name, 34) if n == 0 else ""
            words(panel, "line (px)" if n == 5 else "", _ROWS[n] if column == 0 else "", title)
    handles = [
        Line2D([], [], color=AFTER, label="adjusted minus nominal"),
        Patch(color=AFTER, alpha=0.22, lw=0.0, label="± 1 sigma (sigma0 = 1)"),
    ]
    if any(held):
        handles[1:1] = [Line2D([], [], color=SOFT, ls="--", label="held at nominal")]
    legend(sheet.figure, handles)
    return sheet


def components(profile: OrientationProfile) -> list[tuple[np.ndarray, np.ndarray]]:
    """Correction and sigma (n,) of X, Y, Z in m and of the rotations about the camera's x, y, z in arcsec."""
    shift = profile.position_after - profile.position_before
    position = [(shift[:, k], profile.position_sigma[:, k]) for k in range(3)]
    rotation = [(profile.rotation[:, k] / ARCSEC, profile.rotation_sigma[:, k] / ARCSEC) for k in range(3)]
    return position + rotation


def coupling(solution: Solution, image: int) -> float:
    """Largest correlation between a constant position correction and a constant rotation of an image; 0 when held."""
    covariance = solution.image_covariance(image)[:6, :6]
    sigmas = np.sqrt(np.diagonal(covariance))
    if not np.all(sigmas > 0.0):
        return 0.0
    return float(np.abs(covariance / np.outer(sigmas, sigmas))[:3, 3:].max())


def _draw(panel: Axes, profile: OrientationProfile, value: np.ndarray, sigma: np.ndarray, held: bool) -> None:
    panel.set_xlim(profile.lines[0], profile.lines[-1])
    panel.locator_params(axis="both", nbins=5)
    if held:
        panel.plot(profile.lines, value, color=SOFT, ls="--")
        return
    panel.axhline(0.0, color=SOFT, lw=0.8, zorder=1)
    panel.fill_between(profile.lines, value - sigma, value + sigma, color=AFTER, alpha=0.22, lw=0.0)
    panel.plot(profile.lines, value, color=AFTER)


def _caption(profiles: Sequence[OrientationProfile], couplings: Sequence[float], held: Sequence[bool]) -> str:
    """What one sees, with figures."""
    free = [components(profile) for profile, fixed in zip(profiles, held, strict=True) if not fixed]
    if not free:
        return "All images drawn here are held, so that their orientation is the nominal one and has no sigma"
    largest = [[max(float(np.abs(one[k][part]).max()) for one in free) for k in range(6)] for part in (0, 1)]
    (shift, turn), (spread, twist) = [(max(part[:3]), max(part[3:])) for part in largest]
    kept = f"; held at nominal: {sum(held)}" if any(held) else ""
    return (
        f"Positions (body-fixed X, Y, Z) moved by up to {number(shift)} m and the camera turned by up to "
        f"{number(turn)} arcsec about its own axes, while their sigmas reach {number(spread)} m and {number(twist)} "
        f"arcsec; position and rotation of an image are correlated by up to {max(couplings):.3f}, so that one may "
        f"stand for the other{kept}"
    )
