"""What jigsaw's users look for: bundleout.txt, bundleout_images.csv, bundleout_points.csv, bundleout_lidar.csv and
residuals.csv, with jigsaw's names, order and units of columns.

Latitudes are planetocentric, places km, sigmas and corrections m, angles degrees, pixels counted from 1. Sources:
DOI-USGS/ISIS3, BundleSolutionInfo.cpp (outputHeader, outputText, outputImagesCSV, outputPointsCSV, outputLidarCSV,
outputResiduals), BundleControlPoint.cpp (formatBundleOutputSummaryString, ...DetailString), IsisBundleObservation.cpp
(bundleOutputString, bundleOutputCSV), BundleLidarRangeConstraint.cpp. The CSV files have no room for notes: these stand
at the head of bundleout.txt.
"""

import math
from pathlib import Path
from typing import NamedTuple

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
from mgsgraph.export.bundle_text import Tables, bundle_text
from mgsgraph.files.output.csv_json import picked, quoted
from mgsgraph.files.tie_points import PointKind
from mgsgraph.files.writing import write_files
from mgsgraph.geometry.body import in_turn, planetocentric
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import PointClass
from mgsgraph.units import DEG, ISIS_OFFSET, KM, MM

TEXT, IMAGES, POINTS, LIDAR, RESIDUALS = (
    "bundleout.txt", "bundleout_images.csv", "bundleout_points.csv", "bundleout_lidar.csv", "residuals.csv",
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


class _Measures(NamedTuple):
    """Means over measures that took part."""

    accepted: Index
    total: Index
    rms: Array
    """pixels: (n,) of points; (n, 3) of images: samples, lines, both."""


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
    degree = common_degree(solution)
    orientation = [orientation_polynomials(solution, j, degree) for j in range(len(solution.network.images))]
    tables = _tables(solution, orientation, factor)
    texts = {
        TEXT: bundle_text(solution, tables, scaled),
        IMAGES: _images_csv(solution, tables),
        POINTS: _points_csv(solution, tables),
        **({LIDAR: _lidar_csv(solution)} if solution.network.ranges.point.size else {}),
        RESIDUALS: _residuals_csv(solution),
    }
    return write_files(folder, texts)


def _tables(solution: Solution, orientation: list[OrientationPolynomials], factor: float) -> Tables:
    """Everything in jigsaw's units."""
    points = solution.network.points
    before, after = planetocentric(solution.places_before), planetocentric(solution.places)
    change = after - before
    change[:, 0] = in_turn(change[:, 0])
    radius, latitude = after[:, 2], after[:, 1]
    metres = np.stack([change[:, 1] * radius, change[:, 0] * radius * np.cos(latitude), change[:, 2]], axis=1)
    constrained = points.kinds == PointKind.CONSTRAINED
    prior = np.where(constrained[:, None], _local_sigmas(points.covariances, solution.places_before), np.nan)
    of_points, of_images = _of_points(solution), _of_images(solution)
    return Tables(
        status=picked([kind.name for kind in PointKind], points.kinds).tolist(),
        accepted=of_points.accepted, total=of_points.total, rms=of_points.rms,
        places=_reported(after), corrections=change[:, [1, 0, 2]] / [DEG, DEG, KM], corrections_m=metres,
        prior=prior, sigmas=_local_sigmas(solution.covariances, solution.places) * factor,
        image_accepted=of_images.accepted, image_total=of_images.total, image_rms=of_images.rms,
        orientation=orientation, factor=factor,
    )  # fmt: skip


def _reported(places: Array) -> Array:
    """(n, 3) latitude and longitude in degrees, 0 .. 360, and radius in km."""
    return np.stack([places[:, 1] / DEG, places[:, 0] / DEG % 360.0, places[:, 2] / KM], axis=1)


def _local_sigmas(covariances: Array, places: Array) -> Array:
    """(n, 3) m, sigmas along latitude, longitude and radius."""
    return local_sigmas(covariances, places)[:, [1, 0, 2]]


def _of_points(solution: Solution) -> _Measures:
    rays, used, n = solution.network.rays, solution.rays_used, len(solution.network.points)
    squares = np.bincount(rays.point[used], (solution.residuals[used] ** 2).sum(axis=1), minlength=n)
    accepted = used_ray_counts(solution)
    return _Measures(accepted, solution.network.ray_counts, np.sqrt(squares / np.maximum(2 * accepted, 1)))


def _of_images(solution: Solution) -> _Measures:
    rays, used, m = solution.network.rays, solution.rays_used, len(solution.network.images)
    accepted = np.bincount(rays.image[used], minlength=m)
    line, sample = (
        np.bincount(rays.image[used], solution.residuals[used, c] ** 2, minlength=m) / np.maximum(accepted, 1)
        for c in range(2)
    )
    rms = np.sqrt(np.stack([sample, line, 0.5 * (sample + line)], axis=1))
    return _Measures(accepted, np.bincount(rays.image, minlength=m), rms)


def _images_csv(solution: Solution, tables: Tables) -> str:
    terms = tables.orientation[0].before.shape[1]
    names = [f"{name}(t{k})" if terms > 1 else name for name in PARAMETERS for k in range(terms)]
    parts = ("Initial", "Correction", "Final", "Apriori Sigma", "Adj Sigma")
    # the comma at the end of both lines is jigsaw's
    rows = [
        ",".join(["Image", "rms", "rms", "rms", *(name for name in names for _ in parts), ""]),
        ",".join(["Filename", "sample res", "line res", "total res", *(part for _ in names for part in parts), ""]),
    ]
    for j, image in enumerate(solution.network.images):
        fields = [quoted(image.name), *map(repr, tables.image_rms[j].tolist())]
        for before, correction, after, prior, sigma, _ in tables.parameters(j, solution):
            fields += [repr(before), repr(correction), repr(after), prior, sigma]
        rows.append(",".join(fields))
    return "\n".join([*rows, ""])


def _points_csv(solution: Solution, tables: Tables) -> str:
    """One row for each point that has a place and was not rejected, laser footprints among them."""
    kept = np.flatnonzero(~rejected_points(solution)).tolist()
    ids = [quoted(name) for name in solution.network.points.ids]
    numbers = np.hstack([tables.places, tables.sigmas, tables.corrections_m, solution.places / KM])
    form = "{},{},{},{},{:6.2f}," + ",".join([_NUMBER] * numbers.shape[1]) + "\n"
    rejected = (tables.total - tables.accepted).tolist()
    # as its name says; jigsaw's column holds all measures (BundleControlPoint::numberOfMeasures)
    columns = (ids, tables.status, tables.accepted.tolist(), rejected, tables.rms.tolist())
    every = list(zip(*columns, numbers.tolist(), strict=True))
    rows = [form.format(*values, *figures) for *values, figures in (every[i] for i in kept)]
    return "".join([_POINTS_HEAD, *rows])


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
