"""The papers' figures for a simulated site: orientation differences, correction arrows, footprints on the images."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import Case
from mgsgraph.geometry.records import Array
from mgsgraph.network import PointClass
from mgsgraph.registration.case import register_case
from mgsgraph.results.figures.registration import write_registration_figures
from mgsgraph.results.figures.sheet import (
    CLASS_COLOUR,
    CLASS_NAME,
    Sheet,
    new_sheet,
    number,
    plain_style,
    save,
)
from mgsgraph.units import ARCMIN

_WIDTH, _COLOURS = 1000, 96
"""pixels, and colours of the PNGs that are kept."""
_ROWS = ("X (m)", "Y (m)", "Z (m)", "omega (')", "phi (')", "kappa (')")
_ARROW, _PORTION = 2.0, 1800.0
"""An arrow is drawn so many times longer than the correction; lines of the middle portion that is shown."""


def draw(case: Case, solution: Solution, differences: Sequence[Array], truths: Sequence[Array], folder: Path) -> None:
    """All figures of one site as small PNGs in a folder.

    `differences` and `truths` are (31, 6) per image, m and rad: refined minus SPICE, and truth minus SPICE.
    """
    names = save([orientation_sheet(solution, differences, truths), arrow_sheet(solution)], folder)
    names += write_registration_figures(register_case(case, solution), folder)
    for name in names:
        if name.endswith(".svg"):
            (folder / name).unlink()  # vectors of whole images take megabytes
        else:
            shrink(folder / name)


def shrink(path: Path) -> None:
    """Fewer pixels and colours, so that the repository can hold it."""
    with Image.open(path) as picture:
        whole = picture.convert("RGB")
    if whole.width > _WIDTH:
        whole = whole.resize((_WIDTH, round(whole.height * _WIDTH / whole.width)), Image.Resampling.LANCZOS)
    whole.quantize(_COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(path, optimize=True)


@plain_style()
def orientation_sheet(solution: Solution, differences: Sequence[Array], truths: Sequence[Array]) -> Sheet:
    """Figure 1 of PE&RS: refined minus SPICE orientation over the 30 intervals of each image."""
    images = solution.network.images
    largest = max(float(np.abs(one[:, :3]).max()) for one in differences)
    turned = max(float(np.abs(one[:, 3:]).max()) for one in differences) / ARCMIN
    caption = (
        f"Refined minus SPICE orientation at the 31 ends of 30 intervals (Figure 1 of PE&RS), up to {number(largest)} "
        f"m and {number(turned)} arcmin; grey, what truth is minus SPICE in this simulation. The noise along the image "
        "is the kernels' own, which the polynomials smooth out."
    )
    sheet = new_sheet("orientation", 7.6, 7.6, f"Orientation differences, {solution.name}", caption)
    grid = sheet.panels(6, 2, sharex="col")
    for j, (found, true) in enumerate(zip(differences, truths, strict=True)):
        for k, label in enumerate(_ROWS):
            unit = 1.0 if k < 3 else ARCMIN
            panel = grid[k, j]
            panel.plot(true[:, k] / unit, color="#999999", lw=1.0)
            panel.plot(found[:, k] / unit, color="#0072B2", marker=".", ms=3)
            panel.set_xlim(0, found.shape[0] - 1)
            panel.locator_params(axis="y", nbins=4)
            panel.set(xlabel="interval" if k == 5 else "", ylabel=label, title=images[j].name if k == 0 else "")
    sheet.legend([_line("#0072B2", "refined minus SPICE"), _line("#999999", "truth minus SPICE")])
    return sheet


def _line(colour: str, label: str) -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, label=label)


@plain_style()
def arrow_sheet(solution: Solution) -> Sheet:
    """Figure 2 of PE&RS: corrections of the image coordinates of footprints and tie points in both images."""
    network, rays = solution.network, solution.network.rays
    corrections = -solution.residuals
    means = [
        corrections[(rays.image == j) & (network.points.classes[rays.point] == PointClass.LASER)].mean(axis=0)
        for j in range(len(network.images))
    ]
    told = " and ".join(
        f"{number(float(mean[0]))} lines, {number(float(mean[1]))} samples in {image.name}"
        for mean, image in zip(means, network.images, strict=True)
    )
    caption = (
        f"Corrections of image coordinates in the images' middle portions, {_ARROW:.0f} times enlarged (Figure 2 of "
        "PE&RS); lines run to the right. "
        f"MOLA's are {told} on the average; those of the ties are too short to be seen."
    )
    sheet = new_sheet("arrows", 9.6, 4.4, f"Image coordinate corrections, {solution.name}", caption)
    for panel, j in zip(sheet.panels(2, 1)[:, 0], range(len(network.images)), strict=True):
        image = network.images[j]
        for kind in (PointClass.TIE, PointClass.LASER):
            mine = (rays.image == j) & (network.points.classes[rays.point] == kind)
            (line, sample), (along, across) = rays.places[mine].T, (_ARROW * corrections[mine]).T
            panel.quiver(
                line, sample, along, across, angles="xy", scale_units="xy", scale=1.0, color=CLASS_COLOUR[kind],
                width=0.0014, headwidth=4.0,
            )
            panel.plot(line, sample, ls="", marker=".", ms=2.5, color=CLASS_COLOUR[kind])
        middle = 0.5 * image.lines
        panel.set(xlim=(middle - 0.5 * _PORTION, middle + 0.5 * _PORTION), ylim=(0, image.samples))
        panel.grid(False)
        panel.set(xlabel="line (px)", ylabel="sample (px)", title=image.name)
    sheet.legend([_line(CLASS_COLOUR[kind], CLASS_NAME[kind]) for kind in (PointClass.TIE, PointClass.LASER)])
    return sheet
