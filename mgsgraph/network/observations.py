"""Observations of images as a network: what is added to one that is already there."""

from collections.abc import Mapping, Sequence

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.tie_points import PointKind, TiePoints
from mgsgraph.geometry.altimetry import LaserProfile, exchanged_units, require_lengths
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, Index
from mgsgraph.names import RepeatedNames
from mgsgraph.network.network import Network
from mgsgraph.network.parts import KnownImage, image_columns, joined
from mgsgraph.network.records import GroundPoints, ImageRays, PointClass, Ranges
from mgsgraph.units import KM

_FAR_OFF = 0.1
"""Part of the way from the camera by which a range may be another: orbits are known to a kilometre or so."""
_LEAST_SIGMA = 0.02
"""m; planetary altimeters range to 0.1 m and worse."""


def observed(
    images: Mapping[str, KnownImage],
    observations: Sequence[TiePoints | LaserProfile],
    tie_sigma: float = 1.0,
    shot_sigma: float = 30.0,
) -> Network | None:
    """Tie points and laser shots as one network of the images that they name; None where they name none.

    Parameters
    ----------
    images : mapping
        By name; those that no measure names stay out of the network.
    observations : sequence of TiePoints or LaserProfile
    tie_sigma, shot_sigma : float
        px, of the image coordinates of tie points for which their file says nothing, and of laser footprints.

    Raises
    ------
    InputError
        When a measure names another image or lies outside its image, or a point is measured twice in an image.

    Examples
    --------
    >>> from mgsgraph.network.observations import observed
    >>> images = {image.name: mgsgraph.KnownImage(image, pair.settings.noise.prior) for image in pair.images}
    >>> print(observed(images, [pair.ties, pair.laser], tie_sigma=0.5))
    Network(2 images, 28 points (20 tie, 8 laser), 56 rays, 8 ranges)
    """
    parts = [
        _of_ties(images, one, tie_sigma) if isinstance(one, TiePoints) else _of_shots(images, one, shot_sigma)
        for one in observations
        if len(one.measure_image) or (isinstance(one, LaserProfile) and len(one.simultaneous_image))
    ]
    return joined(parts) if parts else None


def _of_ties(images: Mapping[str, KnownImage], ties: TiePoints, sigma: float) -> Network:
    names, image = _numbered(images, ties.measure_image, ties.source)
    sigmas = np.where(np.isnan(ties.measure_sigmas), sigma, ties.measure_sigmas)
    classes = np.full(len(ties.ids), int(PointClass.TIE))
    points = GroundPoints(ties.ids, classes, ties.kinds, ties.places, ties.covariances)
    nothing = np.zeros(0)
    ranges = Ranges(nothing.astype(int), nothing.astype(int), nothing, nothing, nothing)
    rays = ImageRays(ties.measure_point, image, ties.measures, sigmas)
    return _network([images[name] for name in names], points, rays, ranges, ties.source)


def _of_shots(images: Mapping[str, KnownImage], profile: LaserProfile, sigma: float) -> Network:
    named = RepeatedNames.concatenated([profile.measure_image, profile.simultaneous_image])
    names, image = _numbered(images, named, profile.source)
    k, n = len(profile.measure_image), len(profile.ids)
    shot = profile.simultaneous_shot
    classes, kinds = np.full(n, int(PointClass.LASER)), np.full(n, int(PointKind.CONSTRAINED))
    points = GroundPoints(profile.ids, classes, kinds, profile.footprints, profile.covariances)
    rays = ImageRays(profile.measure_shot, image[:k], profile.measures, np.full((k, 2), sigma))
    require_ranges_of(profile, [images[name].image for name in names], image[k:])
    require_range_sigmas(profile)
    ranges = Ranges(shot, image[k:], profile.times[shot], profile.ranges[shot], profile.range_sigmas[shot])
    return _network([images[name] for name in names], points, rays, ranges, profile.source)


def _numbered(images: Mapping[str, KnownImage], named: RepeatedNames, source: str) -> tuple[list[str], Index]:
    """Images named, each once, and the number of each measure's."""
    used = named.used
    for name in used:
        if name not in images:
            known = ", ".join(list(images)[:4])
            found, expected = f"measures in the image {name!r}", f"known images ({known})"
            raise InputError(source, found, expected, "add the image first")
    return list(used), named.over(used)


def _network(
    known: list[KnownImage], points: GroundPoints, rays: ImageRays, ranges: Ranges, source: str
) -> Network:
    columns = image_columns(known)
    require_inside(columns[0], rays.image, rays.places, points.ids, rays.point, source)
    return Network(*columns, points, rays, ranges)


def require_inside(
    images: Sequence[PushbroomImage], image: Index, places: Array, names: Sequence[str], point: Index, source: str
) -> None:
    """Raise InputError unless all measures lie on their images.

    Parameters
    ----------
    images : sequence of PushbroomImage
    image : (k,)
        Number of each measure's image.
    places : (k, 2)
        line, sample.
    names : sequence of str
        Of the points.
    point : (k,)
        Number of each measure's point.
    source : str
        What to call the measures in errors.
    """
    size = np.array([(one.lines, one.samples) for one in images], dtype=np.float64)[image]
    for k in np.flatnonzero(np.any((places < 0.0) | (places > size), axis=1))[:1]:
        raise InputError(
            f"{source}, point {names[int(point[k])]}, image {images[image[k]].name}",
            f"line {places[k, 0] + 0.5:g}, sample {places[k, 1] + 0.5:g} (counted from 1)",
            f"a place inside {size[k, 0]:g} lines x {size[k, 1]:g} samples",
        )


def nominal_ground(images: Sequence[PushbroomImage], rays: ImageRays, heights: Array | None = None) -> Array:
    """(k, 3) m, where rays meet the ellipsoid, or heights (k,) in m above it, with the nominal orientation; NaN for
    those that miss it.
    """
    ground = np.empty((rays.point.size, 3))
    heights = np.zeros(rays.point.size) if heights is None else heights
    for j, image in enumerate(images):
        mine = rays.image == j
        lines, samples = rays.places[mine].T
        ground[mine], _ = image.image_to_ground(lines, samples, heights[mine])
    return ground


# --- ranges that can't be


def require_ranges_of(profile: LaserProfile, images: Sequence[PushbroomImage], along: Index) -> None:
    """Raise InputError where ranges are not the distances from the trajectories of the simultaneous images, of which
    `along` (r,) has the indices, or are of times beyond these; see `require_ranges`.
    """
    for j in dict.fromkeys(along.tolist()):
        mine, image = profile.simultaneous_shot[along == j], images[j]
        times, ground, ranges = profile.times[mine], profile.footprints[mine], profile.ranges[mine]
        past, (start, stop) = times - image.trajectory.epoch, image.trajectory.coverage
        worst = int(np.argmax(np.maximum(start - past, past - stop)))
        where = f"{profile.source}, laser shot {profile.ids[int(mine[worst])]}, image {image.name}"
        image.trajectory.require(past[[worst]], where)
        require_ranges(image, times, ground, ranges, profile.source, profile.ids[mine])


def require_ranges(
    image: PushbroomImage, times: Array, footprints: Array, ranges: Array, source: str, names: Sequence[str]
) -> None:
    """Raise InputError where ranges (n,) in m are not the distances from an image's trajectory: all of them by their
    unit, or one of the shots, which have these names. Times at which the trajectory isn't known pass.
    """
    past, (start, stop) = times - image.trajectory.epoch, image.trajectory.coverage
    known = np.flatnonzero((past >= start) & (past <= stop))
    if not known.size:
        return
    distances = np.linalg.norm(footprints[known] - image.trajectory.pose(past[known]).position, axis=1)
    require_lengths(ranges[known], distances, "ranges", source)
    for k in np.flatnonzero(np.abs(ranges[known] / distances - 1.0) > _FAR_OFF)[:1].tolist():
        found = f"a range of {ranges[known[k]] / KM:,.6g} km"
        expected = f"about {distances[k] / KM:,.6g} km, the way from the trajectory of {image.name}"
        remedy = exchanged_units(ranges[known[k]] / distances[k]) or "mend it, or take the shot out"
        raise InputError(f"{source}, shot {names[known[k]]}", found, expected, remedy)


def require_range_sigmas(profile: LaserProfile) -> None:
    """Raise InputError for a sigma of a range that no altimeter reaches, or that is larger than the range."""
    small, large = profile.range_sigmas < _LEAST_SIGMA, profile.range_sigmas > profile.ranges
    for i in np.flatnonzero(small | large)[:1].tolist():
        found = f"a range of {profile.ranges[i] / KM:,.6g} km with a sigma of {profile.range_sigmas[i]:g} m"
        likely = "are sigmas in kilometres, where the format has metres?" if small[i] else "is its unit right?"
        raise InputError(f"{profile.source}, shot {profile.ids[i]}", found, "a sigma in m, 0.02 or more",
                         f"{likely} Mend them, or state range_sigma_m in [laser] of a case")  # fmt: skip
