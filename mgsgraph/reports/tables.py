"""Tables of a solution: one JSON record with all figures of merit, and CSV files of points, orientation and residuals.

The CSV columns carry their units. Lines and samples are counted as ISIS does, the first pixel's centre at (1, 1);
latitudes are planetocentric, longitudes run east from 0 to 360 degrees, heights are given as radii.
"""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.adjustment.analysis.merit import (
    ORIENTATION,
    PLACES,
    RayStatistics,
    laser_gain,
    local_sigmas,
    orientation_statistics,
    point_statistics,
    range_statistics,
    ray_statistics,
    rejected_points,
    solution_connectivity,
    used_ray_counts,
)
from mgsgraph.adjustment.solution import OrientationProfile, Solution, orientation_profile
from mgsgraph.geometry.body import geodetic, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.network import PointClass
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.network.connectivity_words import connectivity_json
from mgsgraph.output.csv_json import columns, padded, picked, plain, quoted, truths, whole, write_csv
from mgsgraph.output.folders import PROGRAM
from mgsgraph.reports.control import control_json
from mgsgraph.reports.shared import shared_json
from mgsgraph.reports.strips import strips_json
from mgsgraph.reports.summary import statements
from mgsgraph.ties import PointKind
from mgsgraph.units import ARCSEC, DEG, KM

FORMAT = 1
"""Version of solution.json's layout."""

_ISIS = 0.5
"""pixels from our count of lines and samples to that of ISIS."""
_SIGMAS = "standard deviations for sigma0 = 1, as the a-priori sigmas imply; times sigma0 they are scaled to the fit"
_REMARKS = ("bridge", "overlap without common points", "common points without overlap")


def solution_json(solution: Solution, connected: Connectivity | None = None) -> dict[str, Any]:
    """All figures of merit of a solution, as plain values for strict JSON: what isn't a number is None.

    Units stand in the keys' names. `sigma_mean` is the mean standard deviation over the places, not that of the mean.
    `connected` saves finding it anew.
    """
    network, fit = solution.network, solution.fit
    connected = connected or solution_connectivity(solution)
    rays = ray_statistics(solution)
    record = {
        "program": PROGRAM,
        "format": FORMAT,
        "name": solution.name,
        "status": "converged" if solution.converged else "not converged",
        "message": solution.message,
        "iterations": solution.iterations,
        "cost_initial": solution.cost_initial,
        "cost_final": solution.cost_final,
        "sigma0": solution.sigma0,
        "degrees_of_freedom": fit.degrees_of_freedom,
        "observations": fit.observations,
        "unknowns": fit.unknowns,
        "images": [_image(solution, j, rays) for j in range(len(network.images))],
        "islands": [[network.images[j].name for j in island] for island in connected.islands],
        "connectivity": connectivity_json(connected),
        "points": {_name(c): _points(solution, c) for c in PointClass},
        "undetermined": [network.points.ids[i] for i in np.flatnonzero(~solution.determined)],
        "ranges": _ranges(solution),
        "laser_effect": _laser_effect(solution),
        "control": control_json(solution),
        "shared": shared_json(solution),
        "strips": strips_json(solution),
        "sigmas": _sigmas(solution),
        "settings": dataclasses.asdict(solution.settings),
        "seconds": dict(solution.seconds),
        "versions": dict(solution.versions),
        "statements": statements(solution, connected),
    }
    found: dict[str, Any] = plain(record)
    return found


def _name(point_class: PointClass) -> str:
    return point_class.name.lower()


def _image(solution: Solution, j: int, rays: RayStatistics) -> dict[str, Any]:
    image = solution.network.images[j]
    line, sample = rays.rms_of_images[j]
    record: dict[str, Any] = {
        "name": image.name,
        "held": bool(solution.network.held[j]),
        "strip": _strip_name(solution, j),
        "lines": image.lines,
        "samples": image.samples,
        "rays": int(rays.total[j]),
        "rays_used": int(rays.count[j].sum()),
        "residual_rms_line_px": line,
        "residual_rms_sample_px": sample,
    }
    for c in PointClass:
        record[_name(c)] = {
            "count": int(rays.count[j, c]),
            "mean_line_px": rays.mean[j, c, 0],
            "mean_sample_px": rays.mean[j, c, 1],
            "rms_line_px": rays.rms[j, c, 0],
            "rms_sample_px": rays.rms[j, c, 1],
        }
    return record | {"orientation": _orientation(solution, j)}


def _strip_name(solution: Solution, j: int) -> str | None:
    strip = int(solution.network.strip_of[j])
    return solution.network.strips[strip].name if strip >= 0 else None


def _orientation(solution: Solution, j: int) -> dict[str, Any]:
    found = orientation_statistics(solution, j)
    record: dict[str, Any] = {"places": PLACES}
    for k, component in enumerate(ORIENTATION):
        unit, factor = ("m", 1.0) if k < 3 else ("arcsec", ARCSEC)
        record[f"{component.replace(' ', '_')}_{unit}"] = {
            "mean": found.mean[k] / factor, "rms": found.rms[k] / factor, "sigma_mean": found.mean_sigma[k] / factor,
        }
    return record


def _points(solution: Solution, point_class: PointClass) -> dict[str, Any]:
    found = point_statistics(solution, point_class)
    return {
        "count": found.count,
        "rejected": found.rejected,
        "mean_sigma_m": found.mean_sigma,
        "mean_correction_m": found.mean_correction,
        "rms_correction_m": found.rms_correction,
    }


def _ranges(solution: Solution) -> dict[str, Any]:
    found = range_statistics(solution)
    return {
        "count": found.count,
        "used": found.used,
        "mean_residual_m": found.mean,
        "rms_residual_m": found.rms,
        "mean_residual_before_m": found.mean_before,
        "rms_residual_before_m": found.rms_before,
    }


def _laser_effect(solution: Solution) -> dict[str, Any] | None:
    without = solution.sigmas_without_laser
    if without is None:
        return None
    sigmas = point_statistics(solution, PointClass.TIE).mean_sigma
    return {
        "tie_mean_sigma_m": sigmas,
        "tie_mean_sigma_without_laser_m": without,
        "ratio": without / sigmas,
        "ratio_overall": laser_gain(solution),
    }


def _sigmas(solution: Solution) -> dict[str, Any]:
    """What all sigmas mean, and the mean ones scaled to the fit."""
    scaled = {_name(c): point_statistics(solution, c).mean_sigma * solution.sigma0 for c in PointClass}
    return {"meaning": _SIGMAS, "sigma0": solution.sigma0, "scaled_by_sigma0": {"mean_sigma_m": scaled}}


# --- CSV


def points_csv(solution: Solution, path: Path) -> None:
    """Write every ground point: adjusted place, sigmas, covariance, rays and correction; empty where undetermined."""
    network, sigmas = solution.network, solution.sigmas
    longitude, latitude, radius = planetocentric(solution.places).T
    text = {
        "id": [quoted(name) for name in network.points.ids],
        "class": _names(PointClass, network.points.classes),
        "kind": _names(PointKind, network.points.kinds),
        "rejected": truths(rejected_points(solution)),
        "rays": whole(network.ray_counts),
        "rays_used": whole(used_ray_counts(solution)),
    }
    numbers = {
        **columns(["x_m", "y_m", "z_m"], solution.places),
        "lon_deg": longitude / DEG % 360.0,
        "lat_deg": latitude / DEG,
        "radius_m": radius,
        "height_m": geodetic(solution.places, network.images[0].body)[:, 2],
        **({"height_above_areoid_m": radius - network.areoid.at(solution.places)} if network.areoid else {}),
        **columns(["sigma_x_m", "sigma_y_m", "sigma_z_m"], sigmas),
        **columns(["sigma_east_m", "sigma_north_m", "sigma_up_m"], local_sigmas(solution)),
        **columns(["scaled_sigma_x_m", "scaled_sigma_y_m", "scaled_sigma_z_m"], sigmas * solution.sigma0),
        **{
            f"cov_{'xyz'[a]}{'xyz'[b]}_m2": solution.covariances[:, a, b]
            for a, b in zip(*np.triu_indices(3), strict=True)
        },
        **columns(["correction_x_m", "correction_y_m", "correction_z_m"], solution.places - solution.places_before),
    }
    write_csv(path, text, numbers)


def orientation_csv(solution: Solution, path: Path) -> None:
    """Write the exterior orientation of every image at the papers' 31 places, before and after."""
    images = solution.network.images
    profiles = [orientation_profile(solution, j, PLACES) for j in range(len(images))]
    names = [quoted(image.name) for image in images for _ in range(PLACES)]
    parts = [_orientation_columns(profile) for profile in profiles]
    write_csv(path, {"image": names}, {name: np.concatenate([part[name] for part in parts]) for name in parts[0]})


def _orientation_columns(profile: OrientationProfile) -> dict[str, Array]:
    position, angles, turns = ("x", "y", "z"), ("omega", "phi", "kappa"), ("rotation_x", "rotation_y", "rotation_z")
    return {
        "isis_line": profile.lines + _ISIS,
        "time_et_s": profile.times,
        **columns([f"{name}_before_m" for name in position], profile.position_before),
        **columns([f"{name}_after_m" for name in position], profile.position_after),
        **columns([f"{name}_difference_m" for name in position], profile.position_after - profile.position_before),
        **columns([f"{name}_sigma_m" for name in position], profile.position_sigma),
        **columns([f"{name}_before_deg" for name in angles], profile.angles_before / DEG),
        **columns([f"{name}_after_deg" for name in angles], profile.angles_after / DEG),
        **columns([f"{name}_difference_arcsec" for name in angles], profile.angle_differences / ARCSEC),
        **columns([f"{name}_sigma_arcsec" for name in angles], profile.angles_sigma / ARCSEC),
        **columns([f"{name}_arcsec" for name in turns], profile.rotation / ARCSEC),
        **columns([f"{name}_sigma_arcsec" for name in turns], profile.rotation_sigma / ARCSEC),
    }


def residuals_csv(solution: Solution, path: Path) -> None:
    """Write one row per ray and one per range: residuals (measured minus predicted) before and after.

    A normalised residual is the residual over its a-priori sigma. A range has the line at which its shot was taken.
    """
    network, rays, ranges = solution.network, solution.network.rays, solution.network.ranges
    point, image = np.concatenate([rays.point, ranges.point]), np.concatenate([rays.image, ranges.image])
    text = {
        "kind": ["image"] * rays.point.size + ["range"] * ranges.point.size,
        "point": picked([quoted(name) for name in network.points.ids], point),
        "class": _names(PointClass, network.points.classes[point]),
        "image": picked([quoted(image.name) for image in network.images], image),
        "used": truths(np.concatenate([solution.rays_used, solution.ranges_used])),
    }
    shots, before, after = _shot_lines(solution), solution.residuals_before, solution.residuals
    k, r = rays.point.size, ranges.point.size
    numbers = {"isis_line": np.concatenate([rays.places[:, 0], shots]) + _ISIS,
               "isis_sample": padded(rays.places[:, 1], 0, r) + _ISIS}
    for c, name in enumerate(("line", "sample")):
        numbers |= {
            f"residual_before_{name}_px": padded(before[:, c], 0, r),
            f"residual_{name}_px": padded(after[:, c], 0, r),
            f"sigma_{name}_px": padded(rays.sigmas[:, c], 0, r),
            f"normalised_{name}": padded(after[:, c] / rays.sigmas[:, c], 0, r),
        }
    numbers |= {
        "range_m": padded(ranges.values, k, 0),
        "residual_before_range_m": padded(solution.range_residuals_before, k, 0),
        "residual_range_m": padded(solution.range_residuals, k, 0),
        "sigma_range_m": padded(ranges.sigmas, k, 0),
        "normalised_range": padded(solution.range_residuals / ranges.sigmas, k, 0),
    }
    write_csv(path, text, numbers)


def connectivity_csv(connected: Connectivity, path: Path) -> None:
    """Write one row per pair of images that share points or overlap: points by class, area, distance, and a remark."""
    names, points = [quoted(name) for name in connected.names], connected.points
    marks = connected.bridges, (points == 0) & (connected.areas > 0.0), (points > 0) & (connected.gaps > 0.0)
    remarks = [
        ", ".join(word for word, there in zip(_REMARKS, row, strict=True) if there) for row in zip(*marks, strict=True)
    ]
    text = {
        "image_a": picked(names, connected.pairs[:, 0]),
        "image_b": picked(names, connected.pairs[:, 1]),
        "common_points": whole(points),
        **{f"{_name(c)}_points": whole(connected.common[:, c]) for c in PointClass},
        "remark": [quoted(remark) for remark in remarks],
    }
    numbers = {"overlap_km2": connected.areas / KM**2, "overlap_share": connected.shares, "gap_km": connected.gaps / KM}
    write_csv(path, text, numbers)


def _shot_lines(solution: Solution) -> Array:
    """(r,) line of the carrying image that was read when the shot was taken."""
    ranges, lines = solution.network.ranges, np.empty(solution.network.ranges.point.size)
    for j in np.unique(ranges.image):
        mine, image = ranges.image == j, solution.network.images[j]
        lines[mine] = image.timing.lines(ranges.times[mine] - image.trajectory.epoch)
    return lines


def _names(kind: type[PointClass] | type[PointKind], codes: np.ndarray) -> list[str]:
    return picked([member.name.lower() for member in kind], codes)
