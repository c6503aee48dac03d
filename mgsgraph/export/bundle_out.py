"""What jigsaw's users look for: bundleout_images.csv, bundleout_points.csv, bundleout_lidar.csv and residuals.csv, with
jigsaw's names, order and units of columns.

Latitudes are planetocentric, coordinates km, sigmas and corrections m, angles degrees, pixels counted from 1. Sources:
DOI-USGS/ISIS3, BundleSolutionInfo.cpp (outputImagesCSV, outputPointsCSV, outputLidarCSV, outputResiduals),
IsisBundleObservation.cpp (bundleOutputCSV), BundleLidarRangeConstraint.cpp. The files have no room for notes:
docs/jigsaw.md has them.
"""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import local_sigmas, rejected_points, used_ray_counts
from mgsgraph.errors import InputError
from mgsgraph.export.bundle_orientation import (
    PARAMETERS,
    OrientationPolynomials,
    common_degree,
    orientation_polynomials,
)
from mgsgraph.files.output.csv_json import picked, quoted
from mgsgraph.files.tie_points import PointKind
from mgsgraph.files.writing import write_files
from mgsgraph.geometry.body import in_turn, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.network import PointClass
from mgsgraph.units import DEG, ISIS_OFFSET, KM, MM

IMAGES, POINTS, LIDAR, RESIDUALS = (
    "bundleout_images.csv", "bundleout_points.csv", "bundleout_lidar.csv", "residuals.csv",
)  # fmt: skip
"""Files as jigsaw calls them."""
_POINTS_HEAD = (
    ",,,,,3-d,3-d,3-d,Sigma,Sigma,Sigma,Correction,Correction,Correction,Coordinate,Coordinate,Coordinate\n"
    "Point,Point,Accepted,Rejected,Residual,Latitude,Longitude,Radius,Latitude,Longitude,Radius,Latitude,Longitude,"
    "Radius,X,Y,Z\n"
    "Label,Status,Measures,Measures,RMS,(dd),(dd),(km),(m),(m),(m),(m),(m),(m),(km),(km),(km)\n"
)
_LIDAR_HEAD = (
    ",,measured,a priori,adjusted,adjusted\n"
    "point,image,range,sigma,range,sigma,residual\n"
    "id,name,(km),(km),(km),(km),(km)\n"
)
_RESIDUALS_HEAD = (
    ",,,x image,y image,Measured,Measured,sample,line,Residual Vector\n"
    "Point,Image,Image,coordinate,coordinate,Sample,Line,residual,residual,Magnitude\n"
    "Label,Filename,Serial Number,(mm),(mm),(pixels),(pixels),(pixels),(pixels),(pixels),Rejected\n"
)
_NUMBER = "{:16.8f}"


def write_bundle_out(solution: Solution, folder: Path, scaled: bool = False) -> list[Path]:
    """Write the tables that jigsaw writes, in its layout, into an existing folder.

    Parameters
    ----------
    solution : Solution
        What was adjusted.
    folder : Path
        Where to; bundleout_lidar.csv is written where there are ranges.
    scaled : bool
        Whether adjusted sigmas are times sigma0, as jigsaw's are; else they are for sigma0 = 1, as everywhere here.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    InputError
        If a file can't be written, or sigma0 is asked for and there is none.
    """
    factor = covariance_factor(solution, scaled) ** 0.5
    texts = {
        IMAGES: _images_csv(solution, factor),
        POINTS: _points_csv(solution, factor),
        **({LIDAR: _lidar_csv(solution)} if solution.network.ranges.point.size else {}),
        RESIDUALS: _residuals_csv(solution),
    }
    return write_files(folder, texts)


def _images_csv(solution: Solution, factor: float) -> str:
    """One row for each image: its residuals, and the coefficients of its orientation."""
    images, degree = solution.network.images, common_degree(solution)
    names = [f"{name}(t{k})" if degree else name for name in PARAMETERS for k in range(degree + 1)]
    parts = ("Initial", "Correction", "Final", "Apriori Sigma", "Adj Sigma")
    # the comma at the end of both lines is jigsaw's
    rows = [
        ",".join(["Image", "rms", "rms", "rms", *(name for name in names for _ in parts), ""]),
        ",".join(["Filename", "sample res", "line res", "total res", *(part for _ in names for part in parts), ""]),
    ]
    for j, (image, rms) in enumerate(zip(images, _image_rms(solution).tolist(), strict=True)):
        polynomials = orientation_polynomials(solution, j, degree)
        coefficients = _coefficients(polynomials, factor, bool(solution.network.held[j]))
        rows.append(",".join([quoted(image.name), *map(repr, rms), *coefficients]))
    return "\n".join([*rows, ""])


def _image_rms(solution: Solution) -> Array:
    """(m, 3) pixels, root mean square over measures that took part: samples, lines, both."""
    image, m = solution.network.rays.image[solution.rays_used], len(solution.network.images)
    accepted = np.maximum(np.bincount(image, minlength=m), 1)
    squares = solution.residuals[solution.rays_used] ** 2
    line, sample = (np.bincount(image, squares[:, c], minlength=m) / accepted for c in range(2))
    return np.sqrt(np.stack([sample, line, 0.5 * (sample + line)], axis=1))


def _coefficients(found: OrientationPolynomials, factor: float, held: bool) -> Iterator[str]:
    """Of each coefficient initial value, correction and final value (km, degrees), a-priori and adjusted sigma (m,
    degrees).
    """
    for c in range(len(PARAMETERS)):
        size, spread = (KM, 1.0) if c < 3 else (DEG, DEG)
        for k in range(found.before.shape[1]):
            before, correction = float(found.before[c, k]) / size, float(found.correction[c, k]) / size
            prior, sigma = found.prior[c, k] / spread, found.sigma[c, k] / spread * factor
            yield from map(repr, (before, correction, before + correction))
            yield "N/A" if np.isnan(prior) else "FREE" if np.isinf(prior) else f"{prior:.8g}"
            yield "N/A" if held and sigma == 0.0 else f"{sigma:.8f}" if sigma > 1e-4 else f"{sigma:.8g}"


def _points_csv(solution: Solution, factor: float) -> str:
    """One row for each point that has a place and was not rejected, laser footprints among them."""
    points, rays, used, n = solution.network.points, solution.network.rays, solution.rays_used, len(solution.places)
    accepted = used_ray_counts(solution)
    squares = np.bincount(rays.point[used], (solution.residuals[used] ** 2).sum(axis=1), minlength=n)
    before, after = planetocentric(solution.places_before), planetocentric(solution.places)
    change, radius, latitude = after - before, after[:, 2], after[:, 1]
    east = in_turn(change[:, 0]) * radius * np.cos(latitude)
    numbers = np.column_stack([
        latitude / DEG, after[:, 0] / DEG % 360.0, radius / KM,
        local_sigmas(solution.covariances, solution.places)[:, [1, 0, 2]] * factor,
        change[:, 1] * radius, east, change[:, 2], solution.places / KM,
    ])  # fmt: skip
    form = "{},{},{},{},{:6.2f}," + ",".join([_NUMBER] * numbers.shape[1]) + "\n"
    # as its name says; jigsaw's column holds all measures (BundleControlPoint::numberOfMeasures)
    rejected = (solution.network.ray_counts - accepted).tolist()
    columns = (
        [quoted(name) for name in points.ids], picked([kind.name for kind in PointKind], points.kinds).tolist(),
        accepted.tolist(), rejected, np.sqrt(squares / np.maximum(2 * accepted, 1)),
    )  # fmt: skip
    every = list(zip(*columns, numbers.tolist(), strict=True))
    kept = np.flatnonzero(~rejected_points(solution)).tolist()
    return "".join([_POINTS_HEAD, *(form.format(*values, *figures) for *values, figures in (every[i] for i in kept))])


def _lidar_csv(solution: Solution) -> str:
    """One row for each range that took part; jigsaw leaves the adjusted sigma at 0, here it is N/A."""
    network, ranges = solution.network, solution.network.ranges
    used = np.flatnonzero(solution.ranges_used)
    residuals = solution.range_residuals
    numbers = np.column_stack([ranges.values, ranges.sigmas, ranges.values - residuals, residuals])[used] / KM
    names = [quoted(image.name) for image in network.images]
    rows = [
        f"{quoted(network.points.ids[i])},{names[j]},{measured:.8f},{sigma:.8f},{adjusted:.8f},N/A,{residual:.8f}\n"
        for i, j, (measured, sigma, adjusted, residual) in zip(
            ranges.point[used].tolist(), ranges.image[used].tolist(), numbers.tolist(), strict=True
        )
    ]
    return "".join([_LIDAR_HEAD, *rows])


def _residuals_csv(solution: Solution) -> str:
    """One row for each measure, point by point, control points before laser footprints; * marks rejected ones."""
    network, rays = solution.network, solution.network.rays
    laser = network.points.classes == PointClass.LASER
    order = np.lexsort((rays.point, laser[rays.point]))
    order = order[np.isfinite(solution.residuals[order]).all(axis=1)]
    focal = np.empty((rays.point.size, 2))
    for j in np.unique(rays.image).tolist():
        mine = rays.image == j
        focal[mine], _ = solution.image(j).interior.focal_plane(rays.places[mine, 1])
    residuals = solution.residuals[:, ::-1]
    magnitude = np.hypot(residuals[:, 0], residuals[:, 1])
    places = np.column_stack([focal / MM, rays.places[:, ::-1] + ISIS_OFFSET])
    numbers = np.column_stack([places, residuals, magnitude])[order].tolist()
    ids, names = [quoted(name) for name in network.points.ids], [quoted(image.name) for image in network.images]
    form = "{},{},{}," + ",".join([_NUMBER] * 7) + "{}\n"
    marks = picked((",*", ""), solution.rays_used[order].astype(np.int64))
    seen = zip(rays.point[order].tolist(), rays.image[order].tolist(), numbers, marks, strict=True)
    rows = [form.format(ids[i], names[j], names[j], *figures, mark) for i, j, figures, mark in seen]
    return "".join([_RESIDUALS_HEAD, *rows])


def covariance_factor(solution: Solution, scaled: bool) -> float:
    """sigma0^2 when `scaled`, else 1; InputError where there is no sigma0."""
    if not scaled:
        return 1.0
    if not math.isfinite(solution.sigma0):
        found = f"{solution.fit.degrees_of_freedom} degrees of freedom"
        raise InputError(f"solution {solution.name!r}, sigma0", found, "more than none, to scale by it", "don't scale")
    return solution.sigma0**2
