"""Corrections of the exterior orientation along the images, with their 1-sigma bands, all images on one sheet."""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mgsgraph.adjustment.solution import OrientationProfile, Solution, orientation_profile
from mgsgraph.geometry.records import Array
from mgsgraph.results.figures.passes import largest_correlation, pass_sheets
from mgsgraph.results.figures.sheet import (
    AFTER,
    MOST_SHEETS,
    SOFT,
    Sheet,
    new_sheet,
    number,
    plain_style,
    short,
)
from mgsgraph.text import many
from mgsgraph.units import ARCSEC

_PLACES = 800
"""Places along all images together; each has three at least."""
_NAMED = 12
"""Images up to which their names stand below the panels."""
_ROWS = ("X (m)", "Y (m)", "Z (m)", "about x\n(arcsec)", "about y\n(arcsec)", "about z\n(arcsec)")


def orientation_sheets(solution: Solution, most_passes: int = MOST_SHEETS) -> Iterator[Sheet]:
    """Sheets of passes (`figures.passes`), then one sheet of all images with an orientation of their own."""
    yield from pass_sheets(solution, most_passes)
    own = np.flatnonzero(solution.network.pass_of < 0).tolist()
    if own:
        yield orientation_sheet(solution, own)


@plain_style()
def orientation_sheet(solution: Solution, images: Sequence[int]) -> Sheet:
    """Six panels; each image takes one unit of the horizontal axis, from its first line to its last."""
    places = max(_PLACES // len(images), 3)
    curves = np.array([components(orientation_profile(solution, j, places)) for j in images])  # (m, 6, 2, places)
    at = (np.arange(len(images))[:, None] + np.linspace(0.02, 0.98, places)).ravel()
    at[places - 1 :: places] = np.nan  # no line from one image to the next
    sheet = new_sheet(
        "orientation", 11.0 if len(images) > 4 else 7.2, 8.4, "Corrections of the exterior orientation",
        _caption(solution, images, curves),
    )  # fmt: skip
    grid = sheet.panels(6, 1, sharex="col")[:, 0]
    for n, panel in enumerate(grid):
        value, sigma = curves[:, n, 0].ravel(), curves[:, n, 1].ravel()
        panel.axhline(0.0, color=SOFT, lw=0.8, zorder=1)
        panel.fill_between(at, value - sigma, value + sigma, color=AFTER, alpha=0.22, lw=0.0)
        panel.plot(at, value, color=AFTER)
        low, high = np.quantile(np.concatenate([value - sigma, value + sigma]), [0.01, 0.99]).tolist()
        room = 0.12 * max(high - low, 1e-9)
        panel.set(ylabel=_ROWS[n], ylim=(low - room, high + room), xlim=(0.0, len(images)))
        panel.locator_params(axis="y", nbins=5)
    if len(images) <= _NAMED:
        names = [short(solution.network.images[j].name, 60 // len(images) + 6) for j in images]
        grid[-1].set_xticks(np.arange(len(images)) + 0.5, names)
        for panel in grid:
            panel.set_xticks(np.arange(len(images) + 1), minor=True)
            panel.grid(visible=False, axis="x", which="major")
            panel.grid(visible=True, axis="x", which="minor")
    grid[-1].set_xlabel("images in the order of the case, each from its first line to its last")
    sheet.legend([
        Line2D([], [], color=AFTER, label="adjusted minus nominal"),
        Patch(color=AFTER, alpha=0.22, lw=0.0, label="± 1 sigma (sigma0 = 1)"),
    ])  # fmt: skip
    return sheet


def components(profile: OrientationProfile) -> list[tuple[Array, Array]]:
    """Correction and sigma (n,) of X, Y, Z in m and of the rotations about the camera's x, y, z in arcsec."""
    shift = profile.position_after - profile.position_before
    position = [(shift[:, k], profile.position_sigma[:, k]) for k in range(3)]
    rotation = [(profile.rotation[:, k] / ARCSEC, profile.rotation_sigma[:, k] / ARCSEC) for k in range(3)]
    return position + rotation


def coupling(solution: Solution, image: int) -> float:
    """Largest correlation between a constant position correction and a constant rotation of an image; 0 when held."""
    return largest_correlation(solution.image_covariance(image)[:6, :6])


def _caption(solution: Solution, images: Sequence[int], curves: Array) -> str:
    """What one sees, with figures; `curves` (m, 6, 2, n) are corrections and sigmas."""
    held = int(np.count_nonzero(solution.network.held[list(images)]))
    if held == len(images):
        return "All images are held: their orientation is the nominal one and has no sigma."
    size = np.abs(curves).max(axis=(0, 3))
    (shift, spread), (turn, twist) = size[:3].max(axis=0), size[3:].max(axis=0)
    most = max(coupling(solution, j) for j in images)
    kept = f" Held at nominal: {held}." if held else ""
    return (
        f"{many(len(images), 'image')}: positions (body-fixed X, Y, Z) moved by up to {number(float(shift))} m, the "
        f"cameras turned by up to {number(float(turn))} arcsec about their own axes; sigmas reach "
        f"{number(float(spread))} m and {number(float(twist))} arcsec. Position and rotation correlate "
        f"by up to {most:.3f}.{kept}"
    )
