"""The adjusted cameras of ISIS jigsaw's LROC test in this project's geometry, and what its network determines."""

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.files.labels.isis_cube import read_isis_cube
from mgsgraph.files.networks.binary import read_control_network
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.image import PushbroomImage, fit_attitude
from mgsgraph.geometry.intersection import intersect_rays
from mgsgraph.geometry.orientation import OrientationCorrection, polynomial
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.trajectory import AttitudeTable, Trajectory
from mgsgraph.units import DEG

SIDES = ("LRO/1/269182000:51104/NACL", "LRO/1/269182000:51104/NACR")
DEGREE = 3
GROUND = -900.0
"""m, height of the ground above the Moon's sphere, by ISIS's adjusted places; for what depends on it weakly."""


class Jigsaw(NamedTuple):
    """Published results of a version of ISIS; published/jigsaw.toml explains the fields."""

    mean: float
    largest: float
    places: Array
    ascension: Array
    declination: Array


_TEXT = (Path(__file__).parent / "published" / "jigsaw.toml").read_text(encoding="utf-8")
PUBLISHED = {
    version: Jigsaw(**{key: np.array(value) if isinstance(value, list) else value for key, value in entries.items()})
    for version, entries in tomllib.loads(_TEXT).items()
}


def read_rig(data: Path) -> tuple[list[PushbroomImage], TiePoints]:
    """NAC-L and NAC-R with jigsaw's nominal attitude (CKDEGREE 2), and their network."""
    folder = data / "lro_nac_hadley"
    images = [read_isis_cube(folder / f"observationImage{name[-1]}.pvl", name) for name in SIDES]
    return [fit_attitude(image, 2) for image in images], read_control_network(folder / "observationPair.net")


def with_angles(image: PushbroomImage, ascension: Array, declination: Array) -> PushbroomImage:
    """The image with polynomials of scaled time for its first two angles (deg), its twist held: jigsaw's camera."""
    trajectory = image.trajectory
    assert isinstance(trajectory, Trajectory)
    table, s = trajectory.camera, np.linspace(-1.0, 1.0, trajectory.camera.times.size)
    angles = rotation.angles_313(rotation.to_matrix(table.quaternions))
    angles[:, 0] = np.polynomial.polynomial.polyval(s, ascension) * DEG
    angles[:, 1] = np.polynomial.polynomial.polyval(s, declination) * DEG
    quaternions = rotation.continuous(rotation.from_matrix(rotation.from_angles_313(angles)))
    turned = AttitudeTable(table.times, quaternions, table.constant)
    return replace(image, trajectory=replace(trajectory, camera=turned))


def jigsaw_residuals(
    images: list[PushbroomImage], ties: TiePoints, places: Array, corrections: list[OrientationCorrection] | None = None
) -> Array:
    """(k, 2) px, measured minus computed along the focal plane's x and y at the measured line's time, as jigsaw has it
    (ControlPoint::ComputeResiduals), of points at places (n, 3).
    """
    residuals = np.empty(ties.measures.shape)
    for j, image in enumerate(images):
        its = measures_of(ties, image)
        lines, samples = ties.measures[its].T
        pose = image.pose(lines, corrections[j] if corrections else None)
        ray = np.einsum("nij,nj->ni", pose.matrix, places[ties.measure_point[its]] - pose.position)
        computed = ray[:, :2] * image.interior.focal_length / ray[:, 2:]
        pitch = np.linalg.norm(image.interior.to_pixel[0, 1:])
        residuals[its] = (image.interior.focal_plane(samples)[0] - computed) * pitch
    return residuals


def measures_of(ties: TiePoints, image: PushbroomImage) -> Index:
    return np.array([k for k, name in enumerate(ties.measure_image) if name == image.name])


def meeting(images: list[PushbroomImage], ties: TiePoints) -> Array:
    """(n, 3) m, where rays of free points meet; fixed points as they are given."""
    origins, directions = np.empty((2, len(ties.measure_image), 3))
    for image in images:
        its = measures_of(ties, image)
        origins[its], directions[its] = image.sightlines(*ties.measures[its].T)
    places, _, _ = intersect_rays(origins, directions, ties.measure_point, len(ties.ids))
    return np.where((ties.kinds == PointKind.FIXED)[:, None], ties.places, places)


def rig_residuals(solution: Solution, ties: TiePoints) -> Array:
    """Of an adjusted rig, as `jigsaw_residuals`."""
    corrections = [solution.correction(j) for j in range(len(SIDES))]
    return jigsaw_residuals(list(solution.network.images), ties, solution.places, corrections)


class Seen(NamedTuple):
    """Residuals of jigsaw's adjusted cameras in this program."""

    fixed: dict[str, Array]
    """(2, 2) px by point: residuals of a fixed point in L and in R, along x and y of each focal plane."""
    sample_rms: float
    """px, of the residuals along y."""
    moments: Array
    """(4,) px, mean of L's residuals along y times 1, s, s^2, s^3: zero at a least-squares solution."""
    mean: float
    """px, mean residual where radii are such that rays meet best: no more than jigsaw's with its radii held."""
    largest: float
    """px, the largest one of these."""


def jigsaw_cameras(images: list[PushbroomImage], ties: TiePoints, jigsaw: Jigsaw, off: float = 0.0) -> Seen:
    """ISIS's adjusted cameras in this geometry; `off`: samples by which measures are moved, for comparison."""
    moved = replace(ties, measures=ties.measures + np.array([0.0, off]))
    cameras = [with_angles(*values) for values in zip(images, jigsaw.ascension, jigsaw.declination, strict=True)]
    residuals = jigsaw_residuals(cameras, moved, meeting(cameras, moved))
    its = [measures_of(ties, image) for image in images]
    fixed = {}
    for i in np.flatnonzero(ties.kinds == PointKind.FIXED):
        left, right = (residuals[k[ties.measure_point[k] == i][0]] for k in its)
        fixed[ties.ids[i]] = np.array([left, right])
    table = images[0].trajectory.camera.times  # type: ignore[attr-defined]
    times, _ = images[0].timing.at(ties.measures[its[0], 0])
    s = (2.0 * times - table[0] - table[-1]) / (table[-1] - table[0])
    moments = polynomial(s, DEGREE)[0].T @ residuals[its[0], 1] / len(its[0])
    size = np.linalg.norm(residuals, axis=1)
    return Seen(fixed, float(np.sqrt(np.mean(residuals[:, 1] ** 2))), moments, float(size.mean()), float(size.max()))


def determined(images: list[PushbroomImage], ties: TiePoints) -> tuple[Array, Array]:
    """What jigsaw's settings (RADIUS=no) determine.

    Returns
    -------
    spectrum : (16,)
        Singular values of the images' coefficients (unit columns) with the points' horizontal places eliminated.
    sigma : (2,)
        m, median standard deviation of the free points eastward and northward for image residuals of 1 px.
    """
    places, free = ties.places.copy(), ties.kinds == PointKind.FREE
    on_ground = _on_ground(images[0], ties)
    places[free] = on_ground[free]
    cameras = np.zeros((2 * len(ties.measure_image), 2 * 2 * (DEGREE + 1)))
    points = np.zeros((2 * len(ties.measure_image), 2 * len(ties.ids)))
    width, none = 2 * (DEGREE + 1), OrientationCorrection(np.zeros((1, 6)))
    for j, image in enumerate(images):
        its = measures_of(ties, image)
        at = ties.measure_point[its]
        pixels, by_point = image.ground_to_image(places[at], start=ties.measures[its, 0])
        turned = image.by_correction(places[at], pixels, none)[:, :, 3:5]
        powers = polynomial(image.normalised(pixels[:, 0]), DEGREE)[0]
        rows = 2 * its[:, None] + np.arange(2)
        cameras[rows, j * width : (j + 1) * width] = np.einsum("krc,kp->krpc", turned, powers).reshape(-1, 2, width)
        level = east_north_up(places[at])[:, :2].mT
        points[rows[:, :, None], (2 * at[:, None] + np.arange(2))[:, None]] = by_point @ level
    points = points[:, np.repeat(free, 2)]
    across, _ = np.linalg.qr(points)
    cameras /= np.linalg.norm(cameras, axis=0)
    spectrum = np.linalg.svd(cameras - across @ (across.T @ cameras), compute_uv=False)
    design = np.hstack([points, cameras])
    inverse = np.linalg.pinv(design, rcond=1e-14)
    sigmas = np.linalg.norm(inverse, axis=1)[: points.shape[1]].reshape(-1, 2)
    return spectrum, np.median(sigmas, axis=0)


def _on_ground(image: PushbroomImage, ties: TiePoints) -> Array:
    """(n, 3) m, about where an image sees all points."""
    places, its = np.full((len(ties.ids), 3), np.nan), measures_of(ties, image)
    places[ties.measure_point[its]] = image.image_to_ground(*ties.measures[its].T, GROUND)[0]
    return places
