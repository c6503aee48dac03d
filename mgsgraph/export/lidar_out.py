"""ISIS lidar data (JSON) of the laser shots: a-priori and adjusted places with their covariances, ranges and measures.

Keys and units: DOI-USGS/ISIS3, LidarData.cpp (write; adjusted values since ISIS 4): degrees, km, sigmas of ranges in m,
matrices of latitude, longitude (rad) and radius (m) as upper triangles, pixels counted from 1. `io.lidar` reads it.
"""

import json
from typing import Any

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import planetocentric, planetocentric_jacobian
from mgsgraph.geometry.records import Array
from mgsgraph.ties import PointKind
from mgsgraph.units import DEG, ISIS_OFFSET, KM


def lidar_text(solution: Solution, factor: float = 1.0) -> str:
    """Lidar data of all points whose range took part; empty without any.

    Measures are those that took part; a shot without one in the image taken along with it, as MOLA's, has a range that
    jigsaw can't use. Adjusted covariances are multiplied by `factor`. Raises InputError for a point with two ranges
    that differ: the format holds one.
    """
    network, ranges = solution.network, solution.network.ranges
    used = np.flatnonzero(solution.ranges_used)
    points, first = np.unique(ranges.point[used], return_index=True)
    first = used[first]
    one = dict(zip(points.tolist(), first.tolist(), strict=True))
    carriers = dict[int, list[str]]()
    for r in used.tolist():
        i, same = int(ranges.point[r]), one[int(ranges.point[r])]
        if (ranges.values[r], ranges.times[r], ranges.sigmas[r]) != (
            ranges.values[same], ranges.times[same], ranges.sigmas[same]
        ):  # fmt: skip
            where = f"lidar data, point {network.points.ids[i]}, range"
            raise InputError(where, "two that differ", "one, for all images taken along with it")
        carriers.setdefault(i, []).append(network.images[int(ranges.image[r])].name)
    known = np.all(np.isfinite(network.points.places), axis=1, keepdims=True)
    before = np.where(known, network.points.places, solution.places_before)
    prior = _columns(before, network.points.covariances)
    adjusted = _columns(solution.places, solution.covariances * factor)
    measures = _measures(solution)
    shots = []
    for i, r in one.items():
        shot: dict[str, Any] = {
            "id": network.points.ids[i], "range": float(ranges.values[r]) / KM,
            "sigmaRange": float(ranges.sigmas[r]), "time": float(ranges.times[r]),
        }  # fmt: skip
        constrained = network.points.kinds[i] == PointKind.CONSTRAINED
        shot |= _place(prior, i, ("latitude", "longitude", "radius", "aprioriMatrix" if constrained else ""))
        shot |= _place(adjusted, i, ("adjustedLatitude", "adjustedLongitude", "adjustedRadius", "adjustedMatrix"))
        shots.append(shot | {"simultaneousImages": carriers[i], "measures": measures.get(i, [])})
    rows = ",\n".join(json.dumps(shot, allow_nan=False) for shot in shots)
    return f'{{"points": [\n{rows}\n]}}\n' if shots else ""


def _columns(places: Array, covariances: Array) -> tuple[Array, Array]:
    """Latitude, longitude (degrees), radius (km) and the upper triangle (rad, rad, m) of every point."""
    spherical = planetocentric(places)
    # rad and m in the file: longitude comes first in our Jacobian, latitude in the file
    jacobian = planetocentric_jacobian(spherical)[:, :, [1, 0, 2]]
    triangle = np.full((places.shape[0], 6), np.nan)
    fine = np.isfinite(covariances).all(axis=(1, 2)) & np.isfinite(spherical).all(axis=1)
    half = np.linalg.solve(jacobian[fine], covariances[fine])
    matrix = np.linalg.solve(jacobian[fine], np.swapaxes(half, 1, 2))
    triangle[fine] = matrix[:, *np.triu_indices(3)]
    return np.column_stack([spherical[:, 1] / DEG, spherical[:, 0] / DEG % 360.0, spherical[:, 2] / KM]), triangle


def _place(columns: tuple[Array, Array], i: int, keys: tuple[str, str, str, str]) -> dict[str, Any]:
    place, triangle = columns[0][i], columns[1][i]
    if not np.isfinite(place).all():
        return {}
    found: dict[str, Any] = dict(zip(keys, place.tolist(), strict=False))
    if keys[3] and np.isfinite(triangle).all() and triangle.any():
        found[keys[3]] = triangle.tolist()
    return found


def _measures(solution: Solution) -> dict[int, list[dict[str, Any]]]:
    """Of each point."""
    found = dict[int, list[dict[str, Any]]]()
    rays, names = solution.network.rays, [image.name for image in solution.network.images]
    for k in np.flatnonzero(solution.rays_used).tolist():
        line, sample = (rays.places[k] + ISIS_OFFSET).tolist()
        measure = {"line": line, "sample": sample, "serialNumber": names[int(rays.image[k])]}
        found.setdefault(int(rays.point[k]), []).append(measure)
    return found
