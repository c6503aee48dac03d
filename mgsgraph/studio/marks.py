"""What is drawn on an image: its ties with residuals, its laser shots before and after, and their profile."""

from typing import Any

import numpy as np
from scipy.spatial import KDTree

from mgsgraph.files.output.table import plain
from mgsgraph.geometry.body import east_north_up, ellipsoidal_heights
from mgsgraph.geometry.records import Array, Index, Mask, finite_rows, thinned
from mgsgraph.geometry.terrain import areoid_heights
from mgsgraph.names import grouped
from mgsgraph.network import PointClass
from mgsgraph.studio.linked import NEIGHBOURS, weights_by_distance
from mgsgraph.studio.opened import Block

MOST_TIES = 20_000
"""Most ties of an image that a page is sent, evenly chosen."""
MOST_SHOTS = 20_000
"""Most shots of a profile, likewise."""


def ties_of(block: Block, image: int) -> dict[str, Any]:
    """Measured points of an image with their residuals, as JSON.

    Parameters
    ----------
    block : Block
    image : int
        Its number.

    Returns
    -------
    dict
        names; measured (m, 2) line and sample; residuals (m, 2) px, measured minus predicted, null where the point has
        no place; sigmas (m, 2) px; used (m); kinds (m) of points; count of all.
    """
    rays, network = block.rays_by_image[image], block.network
    total, shown = rays.size, rays[thinned(rays.size, MOST_TIES)]
    points, measured = network.rays.point[shown], network.rays.places[shown]
    predicted = projected(block, image, block.places[points], measured[:, 0])
    return {
        "count": int(total), "names": [network.points.ids[i] for i in points.tolist()],
        "measured": measured.tolist(), "residuals": _pairs(measured - predicted),
        "sigmas": network.ray_sigmas[shown].tolist(), "used": block.used[shown].tolist(),
        "kinds": [PointClass(class_).name.lower() for class_ in network.points.classes[points].tolist()],
    }  # fmt: skip


def projected(block: Block, image: int, points: Array, lines: Array | None = None, nominal: bool = False) -> Array:
    """(n, 2) line and sample of points (n, 3) in m in an image, NaN where it does not see them; `nominal`: with the
    orientation before the adjustment.
    """
    pixels = np.full((len(points), 2), np.nan)
    located = np.flatnonzero(finite_rows(points) & np.any(points, axis=1))
    picture = block.network.images[image] if nominal else block.images[image]
    correction = None if nominal else block.corrections[image]
    if located.size:
        start = None if lines is None else lines[located]
        pixels[located] = picture.ground_to_image(points[located], correction, start)[0]
    return pixels


def shots_of(block: Block, image: int) -> dict[str, Any]:
    """Laser shots that fall in an image before or after the adjustment, profile by profile along its track, as JSON.

    Returns
    -------
    dict
        above: what heights are above; surface: what the surface is, null without one; profiles: of each its name,
        shots' names, before and after (n, 2) line and sample, along_m, height_before_m, height_m, sigma_m,
        surface_before_m and surface_m under the shots before and after (null where nothing is known).
    """
    profiles = []
    for name, profile in laser_profiles(block):
        points = profile[_near(block, image, block.network.points.places[profile])]
        before = projected(block, image, block.network.points.places[points], nominal=True)
        after = projected(block, image, block.places[points]) if block.adjusted else before
        shown = np.flatnonzero(_inside(block, image, before) | _inside(block, image, after))
        shown = shown[thinned(shown.size, MOST_SHOTS)]
        if shown.size:
            shown = shown[_order(block.network.points.places[points[shown]])]
            profiles.append(_profile(block, name, points[shown], before[shown], after[shown]))
    above = "areoid" if block.network.areoid is not None else "ellipsoid"
    return {"above": above, "surface": _surface_words(block), "profiles": profiles}


def laser_profiles(block: Block) -> list[tuple[str, Index]]:
    """Name and points of each laser profile, in the order of its shots: as the case has them, else by the prefix of the
    shots' names.
    """
    points, shifts = block.network.points, block.network.shifts
    laser = np.flatnonzero(points.classes == PointClass.LASER)
    owner = [points.ids[point].rpartition(":")[0] or "laser shots" for point in laser.tolist()]
    if shifts is not None:
        profile = np.asarray(shifts.profile)[laser].tolist()
        owner = [shifts.names[k] if k >= 0 else name for k, name in zip(profile, owner, strict=True)]
    profiles = grouped(zip(owner, laser.tolist(), strict=True))
    return [(name, np.array(members)) for name, members in profiles.items()]


def _order(places: Array) -> Index:
    """Order of shots along their track, from the end of the first one: files may have any order."""
    offsets = places - places.mean(axis=0)
    along = offsets @ np.linalg.svd(offsets, full_matrices=False)[2][0]
    order = np.argsort(along, kind="stable")
    return order if along[0] <= 0.0 else order[::-1]


def _profile(block: Block, name: str, points: Index, before: Array, after: Array) -> dict[str, Any]:
    archived, places = block.network.points.places[points], block.places[points]
    ground = np.where(np.isfinite(places), places, archived)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(archived, axis=0), axis=1))])
    covariances = block.network.points.covariances if block.covariances is None else block.covariances
    up = east_north_up(ground)[:, 2]
    sigmas = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", up, covariances[points], up), 0.0))
    return {
        "name": name, "names": [block.network.points.ids[i] for i in points.tolist()],
        "before": _pairs(before), "after": _pairs(after), "along_m": along.tolist(),
        "height_before_m": plain(_heights(block, archived)), "height_m": plain(_heights(block, ground)),
        "sigma_m": plain(sigmas), "surface_before_m": plain(_surface_heights(block, archived)),
        "surface_m": plain(_surface_heights(block, ground)),
    }  # fmt: skip


def _surface_words(block: Block) -> str | None:
    if block.terrain is not None:
        return "terrain model" + (" as adjusted" if block.adjusted and block.network.terrain_moves else "")
    kind = "adjusted" if block.adjusted else "a-priori"
    return f"mean of the {NEIGHBOURS} nearest {kind} points" if _without_lasers(block).size >= NEIGHBOURS else None


def _surface_heights(block: Block, places: Array) -> Array:
    """(n,) m as `_heights`, of the surface at places (n, 3) in m: the terrain model as adjusted, else the mean of the
    nearest points without laser shots, weighted by the inverse squares of distances; NaN without both.
    """
    if block.terrain is not None:
        motion = block.terrain_motion(places)
        feet = places - motion
        return _heights(block, feet * (block.terrain.at(feet) / np.linalg.norm(feet, axis=1))[:, None] + motion)
    points = block.places[_without_lasers(block)]
    if len(points) < NEIGHBOURS:
        return np.full(len(places), np.nan)
    distances, nearest = KDTree(points).query(places, NEIGHBOURS)
    return np.asarray((weights_by_distance(distances) * _heights(block, points)[nearest]).sum(axis=1))


def _without_lasers(block: Block) -> Index:
    """(m,) points with a place that are no laser shots."""
    return np.asarray(block.located[block.network.points.classes[block.located] != PointClass.LASER])


def _heights(block: Block, points: Array) -> Array:
    """(n,) m above the areoid where it is known, else above the ellipsoid."""
    if block.network.areoid is not None:
        return areoid_heights(points, block.network.areoid)
    return np.asarray(ellipsoidal_heights(points, block.images[0].body))


def _near(block: Block, image: int, places: Array) -> Mask:
    """Mask (n,) of places (n, 3) in m that may fall in an image: few of a campaign's shots."""
    middles, reaches = block.caps
    along = places @ middles[image] / np.linalg.norm(places, axis=1)
    return np.asarray(along >= np.cos(reaches[image]))


def _inside(block: Block, image: int, places: Array) -> Mask:
    picture = block.images[image]
    with np.errstate(invalid="ignore"):
        return np.asarray(np.all((places >= 0.0) & (places <= [picture.lines, picture.samples]), axis=1))


def _pairs(values: Array) -> list[list[float] | None]:
    finite = finite_rows(values).tolist()
    return [pair if is_finite else None for pair, is_finite in zip(values.tolist(), finite, strict=True)]
