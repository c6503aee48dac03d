"""Images of a solution: residuals, corrections, and residuals that are constant."""

from statistics import NormalDist
from typing import Any

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.residual_tests import ODDS
from mgsgraph.analysis.statistics import (
    ORIENTATION,
    PLACES,
    RayStatistics,
    orientation_statistics,
    ray_statistics,
    worst_first,
)
from mgsgraph.files.output.table import Column, Table
from mgsgraph.network import PointClass
from mgsgraph.results.section import ROWS, Section
from mgsgraph.text import many, some
from mgsgraph.units import ARCSEC

_PIXELS = 0.5
"""Size of a mean residual below which it does no harm."""
_FEW_RAYS = 8
"""Fewer rays don't show how they scatter."""
_NOTE = (
    "Residuals: rms of the measurements that were used, measured minus predicted. Corrections: adjusted minus nominal, "
    f"mean over {PLACES} lines; positions along the body-fixed axes, rotations about the camera's own axes. Sigmas are "
    "those of the adjusted orientation, mean over the same lines; a dash: held. "
)


def images_section(solution: Solution) -> Section:
    """How each class of points fits, and each image."""
    rays, said = ray_statistics(solution), list[str]()
    for point_class in PointClass:
        if count := int(rays.count[:, point_class].sum()):
            line, sample = rays.rms_of_classes[point_class]
            said.append(
                f"{point_class.name.capitalize()} points fit to {line:.2g} lines and {sample:.2g} samples "
                f"(rms of {many(count, 'ray')})."
            )
    record = [_image(solution, j, rays) for j in range(len(solution.network.images))]
    said += _constant_residuals(solution, rays)
    return Section("images", sentences=said, tables=[images_table(solution)], numbers=record)


def images_table(solution: Solution) -> Table:
    """One row per image: measurements, residuals, corrections; in large blocks those that fit worst first."""
    network, rays, count = solution.network, ray_statistics(solution), len(solution.network.images)
    found = [orientation_statistics(solution, j) for j in range(len(network.images))]
    mean, sigma = (np.array([getattr(one, name) for one in found]) for name in ("mean", "mean_sigma"))
    sigma = np.where(network.held[:, None], np.nan, sigma)
    passes = [network.passes[owner].name if owner >= 0 else "" for owner in network.pass_of.tolist()]
    table = Table("images", "Images", (
        Column("image", [image.name for image in network.images], page="s", text="<26"),
        Column("pass", passes, page="s"),
        Column("lines", np.array([image.lines for image in network.images]), "px", page="s"),
        Column("samples", np.array([image.samples for image in network.images]), "px", page="s"),
        Column("measures", rays.total, page="s", label="rays", text=">6"),
        Column("used", rays.count.sum(axis=1), page="s", text=">6"),
        Column("residual_{}", rays.rms_of_images, "px", "rms of the measures used, measured minus predicted",
               ("line", "sample"), "residual {}", ".2f", "residuals [px]", ">7", gap=2),
        Column("correction_{}", mean[:, :3], "m", "adjusted minus nominal, body-fixed, mean over the lines",
               ("X", "Y", "Z"), "Δ{}", ".1f", "mean correction [m]", ">7", gap=2),
        Column("sigma_{}", sigma[:, :3], "m", "of the adjusted position; none of a held image",
               ("X", "Y", "Z"), "σ {}", ".1f"),
        Column("turn_{}", mean[:, 6:], "arcsec", "the same about the camera's own axes", ("x", "y", "z"), "turn {}",
               ".1f", "camera axes [arcsec]", ">7", gap=2),
        Column("sigma_turn_{}", sigma[:, 6:], "arcsec", "of the adjusted attitude", ("x", "y", "z"), "σ turn {}",
               ".1f"),
    ), _NOTE, dict.fromkeys(np.flatnonzero(network.held).tolist(), ("correction_{}", f"{'held':>23}")))  # fmt: skip
    return table if count <= ROWS else table.take(worst_first(solution))


def _image(solution: Solution, j: int, rays: RayStatistics) -> dict[str, Any]:
    """What a record holds of an image."""
    image, owner = solution.network.images[j], int(solution.network.pass_of[j])
    line, sample = rays.rms_of_images[j]
    record: dict[str, Any] = {
        "name": image.name,
        "held": bool(solution.network.held[j]),
        "pass": solution.network.passes[owner].name if owner >= 0 else None,
        "lines": image.lines,
        "samples": image.samples,
        "rays": int(rays.total[j]),
        "rays_used": int(rays.count[j].sum()),
        "residual_rms_line_px": line,
        "residual_rms_sample_px": sample,
    }
    for c in filter(lambda one: one.measured, PointClass):
        record[c.name.lower()] = {"count": int(rays.count[j, c])} | {
            f"{what}_{way}_px": getattr(rays, what)[j, c, k]
            for what in ("mean", "rms") for k, way in enumerate(("line", "sample"))
        }  # fmt: skip
    return record | {"orientation": _orientation(solution, j)}


def _orientation(solution: Solution, j: int) -> dict[str, Any]:
    found = orientation_statistics(solution, j)
    record: dict[str, Any] = {"places": PLACES}
    for k, component in enumerate(ORIENTATION):
        unit, factor = ("m", 1.0) if k < 3 else ("arcsec", ARCSEC)
        record[f"{component.replace(' ', '_')}_{unit}"] = {
            "mean": found.mean[k] / factor, "rms": found.rms[k] / factor, "sigma_mean": found.mean_sigma[k] / factor,
        }
    return record


def _constant_residuals(solution: Solution, rays: RayStatistics) -> list[str]:
    """Mean residuals of a class in an image that are too large for noise: its coordinates contradict the rest."""
    names, enough, found = [image.name for image in solution.network.images], rays.count >= _FEW_RAYS, list[str]()
    size, noise = np.abs(np.nan_to_num(rays.mean)), np.nan_to_num(rays.standard_errors)
    # noise exceeds the limit once in 1 / ODDS solutions, of all means together
    limit = NormalDist().inv_cdf(1.0 - 0.5 * ODDS / max(2 * int(enough.sum()), 1))
    marked = enough[:, :, None] & (size > limit * noise) & (size > _PIXELS)
    for point_class in PointClass:
        rows = np.argwhere(marked[:, point_class])
        worst = rows[np.argsort(-size[rows[:, 0], point_class, rows[:, 1]], kind="stable")].tolist()
        parts = [f"{rays.mean[j, point_class, c]:+.1f} {('lines', 'samples')[c]} in {names[j]}" for j, c in worst]
        if parts:
            found.append(
                f"{point_class.name.capitalize()} image points keep a constant residual of {some(parts, len(parts))}: "
                "no noise, but their image coordinates disagree with ranges, ground places or ties; no sigma covers it."
            )
    return found
