"""Tables of jigsaw: bundleout_images.csv, bundleout_points.csv, bundleout_lidar.csv and residuals.csv, with
jigsaw's names, order and units of columns.

Latitudes are planetocentric, coordinates km, sigmas and corrections m, angles degrees, pixels counted from 1. Sources:
DOI-USGS/ISIS3, BundleSolutionInfo.cpp (outputImagesCSV, outputPointsCSV, outputLidarCSV, outputResiduals),
IsisBundleObservation.cpp (bundleOutputCSV), BundleLidarRangeConstraint.cpp. The files have no room for notes:
docs/migrate.md has them.

jigsaw solves for polynomials of time of X, Y, Z and of the angles RA, DEC, TWIST; here they are fitted to the
orientation before and after at the papers' 31 lines, and the sigmas of the coefficients follow from the joint
covariance by error propagation (names: IsisBundleObservation.cpp, parameterList, bundleOutputString).
"""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import PLACES, local_sigmas, prior_sigmas, rejected_points, used_ray_counts
from mgsgraph.errors import require
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.files.output.table import picked, quoted
from mgsgraph.files.writing import write_files
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import in_turn, planetocentric
from mgsgraph.geometry.records import Array, by_value, finite_rows
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.network import Network, PointClass, PolynomialPrior
from mgsgraph.network.corrections import designs
from mgsgraph.units import DEG, ISIS_OFFSET, KM, MM

PARAMETERS = ("X", "Y", "Z", "RA", "DEC", "TWIST")
"""jigsaw's names: position, and angles about the axes 3, 1, 3 (`rotation.angles_313`). Its RA is 90 deg more than the
right ascension of the optical axis, its DEC what the declination lacks to 90 deg (docs/evidence_real.md)."""
_USUAL_DEGREE = 2
"""jigsaw's CKDEGREE and SPKDEGREE, for images without polynomials of their own."""
_NOTHING = 1e-9
"""Of the largest: what counts less in a coefficient is rounding."""


class OrientationPolynomials(NamedTuple):
    """One image: coefficients of (t - centre)^k for each of PARAMETERS; m and rad, per s^k.

    Axes are inertial (J2000), or body-fixed where the trajectory doesn't know the body's rotation.
    """

    before: Array
    """(6, d + 1) of the nominal orientation."""
    correction: Array
    """(6, d + 1) adjusted minus nominal."""
    prior: Array
    """(6, d + 1) a-priori sigmas by the prior of the image, or of its pass: infinite where nothing is known, NaN where
    it has none."""
    sigma: Array
    """(6, d + 1) of the adjusted ones, for sigma0 = 1; zero of a held image that shares nothing."""


def common_degree(solution: Solution) -> int:
    """Highest degree of the polynomials of images and passes; jigsaw's usual 2 where none has any."""
    network = solution.network
    degrees = [network.priors[j].degree for j in np.flatnonzero(network.with_polynomial).tolist()]
    for pass_ in network.passes:
        if isinstance(pass_.prior, PolynomialPrior):
            degrees.append(max(len(pass_.prior.attitude_sigmas), len(pass_.prior.position_sigmas)) - 1)
    return max(degrees, default=_USUAL_DEGREE)


def orientation_polynomials(solution: Solution, image: str | int, degree: int) -> OrientationPolynomials:
    """Polynomials of one image's orientation about its centre, the middle between its first and its last line."""
    image = solution.network.image_number(image)
    picture, correction = solution.network.images[image], solution.correction(image)
    lines = np.linspace(0.0, float(picture.lines), PLACES)
    moments = picture.moments(lines)
    before, after = picture.pose(lines), picture.pose(lines, correction)
    centre, half = 0.5 * (moments.times[0] + moments.times[-1]), 0.5 * (moments.times[-1] - moments.times[0])
    fit = np.linalg.pinv(np.vander((moments.times - centre) / half, degree + 1, increasing=True))
    fit /= half ** np.arange(degree + 1)[:, None]
    turn = correction.axes(before, moments)
    trajectory = picture.trajectory
    outward = np.broadcast_to(np.eye(3), (PLACES, 3, 3))
    if isinstance(trajectory, Trajectory):
        outward = trajectory.body.at(moments.times)[0].mT
    position = [np.einsum("nij,nj->ni", outward, pose.position) for pose in (before, after)]
    matrix = [pose.matrix @ outward.mT for pose in (before, after)]
    angles = [rotation.angles_313(attitude) for attitude in matrix]
    values = np.hstack([position[0], np.unwrap(angles[0], axis=0)])
    moved = np.hstack([position[1] - position[0], in_turn(angles[1] - angles[0])])
    to_angles = np.linalg.solve(_axes(matrix[1], angles[1]), turn)
    prior, sigma = _sigmas(solution, image, lines, (outward, np.asarray(to_angles, dtype=np.float64)), fit)
    return OrientationPolynomials((fit @ values).T, (fit @ moved).T, prior, sigma)


def _axes(matrix: Array, angles: Array) -> Array:
    """(n, 3, 3) about which axes of its own the camera turns per rad of each of the three angles, in columns."""
    sine, cosine, zero = np.sin(angles[:, 2]), np.cos(angles[:, 2]), np.zeros(angles.shape[0])
    node = np.stack([cosine, -sine, zero], axis=1)
    return np.stack([matrix[:, :, 2], node, np.broadcast_to([0.0, 0.0, 1.0], node.shape)], axis=2)


def _sigmas(
    solution: Solution, image: int, lines: Array, turned: Sequence[Array], fit: Array
) -> tuple[Array, Array]:
    """A-priori and adjusted sigmas (6, d + 1) of the coefficients."""
    network, width = solution.network, solution.joint_covariance.square_root.width
    effects = designs(network, image, solution.correction(image).angles, lines)
    variables = sorted({variable for part in effects for variable in part})
    first = dict(zip(variables, np.cumsum([0, *(int(width[v]) for v in variables)]).tolist(), strict=False))
    design = np.zeros((lines.size, 6, sum(int(width[v]) for v in variables)))
    for part, row in zip(effects, design, strict=True):
        for variable, matrix in part.items():
            row[:, first[variable] : first[variable] + matrix.shape[1]] = matrix
    halves = [np.einsum("nij,njw->niw", turned[k], design[:, 3 * k : 3 * k + 3]) for k in range(2)]
    rows = np.einsum("kn,ncw->ckw", fit, np.concatenate(halves, axis=1))
    shape, rows = rows.shape[:2], rows.reshape(-1, design.shape[2])
    variance = np.einsum("rw,rw->r", rows @ solution.joint_covariance.of(variables), rows)
    prior = np.full(rows.shape[0], np.nan)
    if network.with_polynomial[image]:
        own = rows[:, first[image] : first[image] + int(width[image])]
        own = np.where(np.abs(own) > _NOTHING * np.abs(own).max(axis=1, keepdims=True), own, 0.0)
        counts, sigmas = own != 0.0, np.broadcast_to(network.priors[image].sigmas.ravel(), own.shape)
        prior = np.sqrt(np.sum(np.where(counts, own, 0.0) ** 2 * np.where(counts, sigmas, 0.0) ** 2, axis=1))
    elif network.pass_of[image] >= 0:
        owner, turn = int(network.pass_of[image]), network.axes_of(image)
        prior = _pass_sigmas(network, owner, lines, image, turned, fit, np.eye(3) if turn is None else turn)
    return prior.reshape(shape), np.sqrt(np.maximum(variance, 0.0)).reshape(shape)


def _pass_sigmas(
    network: Network, owner: int, lines: Array, image: int, turned: Sequence[Array], fit: Array, axes: Array
) -> Array:
    """(6 (d + 1),) a-priori sigmas of an image's coefficients by the priors of its pass's nodes and trend."""
    pass_, moments = network.passes[owner], network.images[image].moments(lines)
    basis, _ = pass_.nodes.dense(moments.times, moments.epoch)
    halves = [np.einsum("nij,nk->nikj", part, basis) for part in (turned[0], turned[1] @ axes)]
    design = np.zeros((lines.size, 6, basis.shape[1], 6))
    design[:, :3, :, :3], design[:, 3:, :, 3:] = halves
    rows = np.einsum("kn,nc...->ck...", fit, design).reshape(6 * fit.shape[0], -1)
    return prior_sigmas(pass_, rows)


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


def _coefficients(polynomials: OrientationPolynomials, factor: float, held: bool) -> Iterator[str]:
    """Of each coefficient initial value, correction and final value (km, degrees), a-priori and adjusted sigma (m,
    degrees).
    """
    for c in range(len(PARAMETERS)):
        size, spread = (KM, 1.0) if c < 3 else (DEG, DEG)
        for k in range(polynomials.before.shape[1]):
            before, correction = float(polynomials.before[c, k]) / size, float(polynomials.correction[c, k]) / size
            prior, sigma = polynomials.prior[c, k] / spread, polynomials.sigma[c, k] / spread * factor
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
    rows = list(zip(*columns, numbers.tolist(), strict=True))
    written = np.flatnonzero(~rejected_points(solution)).tolist()
    return "".join([_POINTS_HEAD, *(form.format(*values, *figures) for *values, figures in (rows[i] for i in written))])


def _lidar_csv(solution: Solution) -> str:
    """One row for each range that took part; jigsaw leaves the adjusted sigma at 0, here it is N/A."""
    network, ranges = solution.network, solution.network.ranges
    used = np.flatnonzero(solution.ranges_used)
    residuals = solution.range_residuals
    numbers = np.column_stack([ranges.values, network.range_sigmas, ranges.values - residuals, residuals])[used] / KM
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
    order = order[finite_rows(solution.residuals[order])]
    focal = np.empty((rays.point.size, 2))
    for j, of_image in by_value(rays.image):
        focal[of_image], _ = solution.image(j).interior.focal_plane(rays.places[of_image, 1])
    residuals = solution.residuals[:, ::-1]
    magnitude = np.hypot(*residuals.T)
    places = np.column_stack([focal / MM, rays.places[:, ::-1] + ISIS_OFFSET])
    numbers = np.column_stack([places, residuals, magnitude])[order].tolist()
    ids, names = [quoted(name) for name in network.points.ids], [quoted(image.name) for image in network.images]
    form = "{},{},{}," + ",".join([_NUMBER] * 7) + "{}\n"
    marks = picked((",*", ""), solution.rays_used[order].astype(np.int64))
    measures = zip(rays.point[order].tolist(), rays.image[order].tolist(), numbers, marks, strict=True)
    rows = [form.format(ids[i], names[j], names[j], *figures, mark) for i, j, figures, mark in measures]
    return "".join([_RESIDUALS_HEAD, *rows])


def covariance_factor(solution: Solution, scaled: bool) -> float:
    """sigma0^2 when `scaled`, else 1; InputError where there is no sigma0."""
    if not scaled:
        return 1.0
    where, found = f"solution {solution.name!r}, sigma0", f"{solution.fit.degrees_of_freedom} degrees of freedom"
    require(math.isfinite(solution.sigma0), where, found, "more than none, to scale by it", "don't scale")
    return solution.sigma0**2
