"""For ISIS: the control network with adjusted points, lidar data, and tables as jigsaw writes them.

The network says what jigsaw says after its adjustment: adjusted places and covariances beside the a-priori ones,
residuals of measures (measured minus predicted, as jigsaw's; of image pixels, where jigsaw takes undistorted detector
pixels) and what was rejected. Images go by the names that the solution has for them: serial numbers, if ISIS is to find
its cubes.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import rejected_points, rejected_rays
from mgsgraph.errors import InputError, require
from mgsgraph.export.bundle_out import covariance_factor, write_bundle_out
from mgsgraph.export.network_content import ADJUSTED_BY, Restored, with_content
from mgsgraph.files.altimetry.lidar import LidarMeasure, LidarShot, lidar_coordinates, lidar_text
from mgsgraph.files.networks.binary import write_binary_network
from mgsgraph.files.networks.pvl import write_pvl_network
from mgsgraph.files.networks.record import (
    AprioriSource,
    ControlMeasure,
    ControlNetwork,
    ControlPoint,
    MeasureType,
    PointType,
)
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.files.output.folders import PROGRAM, WITHOUT_LASER
from mgsgraph.files.writing import write_file
from mgsgraph.geometry.body import target_name
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.names import grouped
from mgsgraph.network import PointClass
from mgsgraph.units import ISIS_OFFSET, KM

NETWORK, NETWORK_TEXT, LIDAR = "network.net", "network.pvl", "lidar.json"
"""Files of the export beside jigsaw's tables (`bundle_out`)."""
_TYPES = {
    PointKind.FREE: PointType.FREE, PointKind.CONSTRAINED: PointType.CONSTRAINED, PointKind.FIXED: PointType.FIXED,
}  # fmt: skip
_UPPER = np.triu_indices(3)


class IsisFiles(NamedTuple):
    """Files written, and sentences about them."""

    paths: list[Path]
    """Files."""
    notes: tuple[str, ...] = ()
    """What became of the source's content, in sentences."""


def write_isis(
    solution: Solution, folder: Path, scaled: bool = False, target: str = "", source: ControlNetwork | None = None
) -> IsisFiles:
    """Write the control network, lidar data and jigsaw's tables into an existing folder.

    Parameters
    ----------
    solution : Solution
        What was adjusted.
    folder : Path
        Where to.
    scaled : bool
        Whether adjusted covariances are times sigma0^2, as jigsaw's are; else they are for sigma0 = 1, as everywhere
        here. The network's description says which.
    target : str
        The body as ISIS calls it; by its radius when absent.
    source : ControlNetwork, optional
        That the points were read from: what it says besides is taken over (`with_content`).

    Returns
    -------
    paths : list of Path
        network.net and network.pvl, the same in both forms, with laser footprints that are measured in an image as
        constrained points; where there are ranges lidar.json; where such footprints are in both, to go with lidar.json
        (jigsaw's LIDARDATA) network_without_laser.net, or else they would count twice; then the tables of
        `write_bundle_out`.
    notes : tuple of str

    Raises
    ------
    InputError
        No point with a measure; what a format can't hold, which is named; a file that can't be written.
    """
    images = frozenset(solution.network.image_names)

    def complete(network: ControlNetwork) -> Restored:
        return Restored(network) if source is None else with_content(network, source, images)

    network, notes = complete(adjusted_network(solution, scaled=scaled, target=target))
    paths = [folder / NETWORK, folder / NETWORK_TEXT]
    write_binary_network(network, paths[0])
    write_pvl_network(network, paths[1])
    if lidar := adjusted_lidar_text(solution, covariance_factor(solution, scaled)):
        write_file(folder / LIDAR, lidar)
        paths.append(folder / LIDAR)
        laser = solution.network.points.classes[solution.network.rays.point] == PointClass.LASER
        if np.any(laser) and not np.all(laser):
            without, _ = complete(adjusted_network(solution, scaled=scaled, laser=False, target=target))
            write_binary_network(without, folder / WITHOUT_LASER)
            paths.append(folder / WITHOUT_LASER)
    return IsisFiles([*paths, *write_bundle_out(solution, folder, scaled)], notes)


def adjusted_network(
    solution: Solution, *, scaled: bool = False, laser: bool = True, target: str = ""
) -> ControlNetwork:
    """The control network of a solution: points that have a measure, in the solution's order.

    A point that nothing determines has no adjusted place; it and one whose measures were all rejected are marked
    rejected. A free point without a-priori place gets the nominal intersection of its rays; a checkpoint has the type
    and known place that it was read with.

    Parameters
    ----------
    solution : Solution
        Images are called as in its network.
    scaled : bool
        Whether adjusted covariances are times sigma0^2.
    laser : bool
        Whether laser footprints are among the points.
    target : str
        The body as ISIS calls it; by its radius when absent.

    Raises
    ------
    InputError
        If no point is left, or sigma0 is asked for and there is none.
    """
    network = solution.network
    chosen = (network.ray_counts > 0) & (laser | (network.points.classes != PointClass.LASER))
    indices = np.flatnonzero(chosen).tolist()
    require(indices, f"solution {solution.name!r}", "no point that is measured in an image", "some for a network")
    factor, rejected = covariance_factor(solution, scaled), rejected_points(solution).tolist()
    measures, body = _measures(solution), network.body
    kinds, known = network.points.kinds.copy(), network.independent.points.covariances
    checks = network.points.checkpoints
    kinds[checks] = np.where(known[checks].any(axis=(1, 2)), int(PointKind.CONSTRAINED), int(PointKind.FIXED))
    prior = _triangles(known, kinds == PointKind.CONSTRAINED)
    free = network.points.kinds != PointKind.FIXED
    adjusted = _triangles(solution.covariances * factor, solution.determined & free)
    stated, first, after = (_places(p) for p in (network.points.places, solution.places_before, solution.places))
    points = []
    for i in indices:
        kind = PointKind(int(kinds[i]))
        constrained, intersected = kind == PointKind.CONSTRAINED, stated[i] is None and first[i] is not None
        points.append(ControlPoint(
            id=network.points.ids[i], type=_TYPES[kind], measures=tuple(measures[i]), chooser_name=PROGRAM,
            jigsaw_rejected=rejected[i],
            reference=next((k for k, measure in enumerate(measures[i]) if not measure.jigsaw_rejected), 0),
            apriori_source=AprioriSource.AVERAGE_OF_MEASURES if intersected else AprioriSource.NONE,
            latitude_constrained=constrained, longitude_constrained=constrained, radius_constrained=constrained,
            apriori=stated[i] or first[i], apriori_covariance=prior[i],
            adjusted=after[i], adjusted_covariance=adjusted[i],
        ))  # fmt: skip
    return ControlNetwork(
        network_id=_one_line(solution.name), target_name=target or target_name(body), points=tuple(points),
        user_name=PROGRAM, description=_description(solution, scaled),
        target_radii=(body.equatorial, body.equatorial, body.polar),
    )  # fmt: skip


def _measures(solution: Solution) -> list[list[ControlMeasure]]:
    """Of each point, in the order of the rays; back-projections are candidates, which were not measured."""
    rays, images = solution.network.rays, solution.network.image_names
    measures = list[list[ControlMeasure]]([] for _ in solution.network.points.ids)
    guessed = rays.back_projected if rays.back_projected is not None else np.zeros(rays.point.size, dtype=np.bool_)
    numbers = (rays.places + ISIS_OFFSET, solution.residuals, solution.network.ray_sigmas)
    marks = (rejected_rays(solution), guessed)
    columns = [column.tolist() for column in (rays.point, rays.image, *numbers, *marks)]
    for i, j, place, residual, sigma, rejected, guess in zip(*columns, strict=True):
        has_residual = math.isfinite(residual[0]) and math.isfinite(residual[1])
        measures[i].append(ControlMeasure(
            serial_number=images[j], type=MeasureType.CANDIDATE if guess else MeasureType.REGISTERED_SUBPIXEL,
            line=place[0], sample=place[1], line_residual=residual[0] if has_residual else None,
            sample_residual=residual[1] if has_residual else None, jigsaw_rejected=rejected,
            line_sigma=sigma[0], sample_sigma=sigma[1],
        ))  # fmt: skip
    return measures


def _places(places: Array) -> list[tuple[float, float, float] | None]:
    """Places (n, 3) in m; None where they are unknown."""
    return [(x, y, z) if math.isfinite(x + y + z) else None for x, y, z in places.tolist()]


def _triangles(covariances: Array, finite: Mask) -> list[tuple[float, ...]]:
    """xx, xy, xz, yy, yz, zz of covariances (n, 3, 3); empty for those that are not known."""
    finite = finite & np.isfinite(covariances).all(axis=(1, 2))
    upper = covariances[:, *_UPPER].tolist()
    return [tuple(row) if is_finite else () for row, is_finite in zip(upper, finite.tolist(), strict=True)]


def _description(solution: Solution, scaled: bool) -> str:
    version = solution.versions.get(PROGRAM, "of unknown version")
    size = f"sigma0 {solution.sigma0:.6g}"
    scale = f"times sigma0^2 ({size}), as jigsaw gives them" if scaled else f"for sigma0 = 1 ({size} not applied)"
    return _one_line(f"{ADJUSTED_BY} {version}: {solution.name}, {solution.ending}. Adjusted covariances {scale}.")


def _one_line(text: str) -> str:
    """A text that PVL can hold."""
    return " ".join(text.split()).replace('"', "'")


# --- lidar data


def adjusted_lidar_text(solution: Solution, factor: float = 1.0) -> str:
    """ISIS lidar data of all points whose range took part; empty without any.

    Measures are those that took part; a shot without one in the image taken along with it, as MOLA's, has a range that
    jigsaw can't use. Adjusted covariances are multiplied by `factor`. Raises InputError for a point with two ranges
    that differ: the format holds one.
    """
    network = solution.network.independent  # as jigsaw takes them
    ranges, used = network.ranges, np.flatnonzero(solution.ranges_used)
    points, first = np.unique(ranges.point[used], return_index=True)
    first = used[first]
    range_of = dict(zip(points.tolist(), first.tolist(), strict=True))
    carriers = dict[int, list[str]]()
    for r in used.tolist():
        i, same = int(ranges.point[r]), range_of[int(ranges.point[r])]
        if (ranges.values[r], ranges.times[r], ranges.sigmas[r]) != (
            ranges.values[same], ranges.times[same], ranges.sigmas[same]
        ):  # fmt: skip
            where = f"lidar data, point {network.points.ids[i]}, range"
            raise InputError(where, "two that differ", "one, for all images taken along with it")
        carriers.setdefault(i, []).append(network.images[int(ranges.image[r])].name)
    stated = np.all(np.isfinite(network.points.places), axis=1, keepdims=True)
    before = np.where(stated, network.points.places, solution.places_before)
    constrained = network.points.kinds == PointKind.CONSTRAINED
    prior, prior_matrices = lidar_coordinates(before, network.points.covariances * constrained[:, None, None])
    adjusted, adjusted_matrices = lidar_coordinates(solution.places, solution.covariances * factor)
    measures = _lidar_measures(solution)
    shots = []
    for i, r in range_of.items():
        latitude, longitude, radius = prior[i].tolist()
        after = adjusted[i].tolist() if np.isfinite(adjusted[i]).all() else [None] * 3
        shots.append(LidarShot(
            id=network.points.ids[i], range=float(ranges.values[r]) / KM, sigma_range=float(ranges.sigmas[r]),
            time=float(ranges.times[r]), latitude=latitude, longitude=longitude, radius=radius,
            apriori_matrix=prior_matrices[i], adjusted_latitude=after[0], adjusted_longitude=after[1],
            adjusted_radius=after[2], adjusted_matrix=adjusted_matrices[i], simultaneous_images=carriers[i],
            measures=measures.get(i, []),
        ))  # fmt: skip
    return lidar_text(shots) if shots else ""


def _lidar_measures(solution: Solution) -> dict[int, list[LidarMeasure]]:
    """Measures that took part, by index of the point."""
    rays, names, used = solution.network.rays, solution.network.image_names, solution.rays_used
    places = (rays.places[used] + ISIS_OFFSET).tolist()
    measures = zip(rays.point[used].tolist(), places, rays.image[used].tolist(), strict=True)
    return grouped((i, LidarMeasure(line, sample, names[j])) for i, (line, sample), j in measures)
