"""Observations of images as a network: what is added to one that is already there."""

from collections.abc import Mapping, Sequence

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network.network import Network
from mgsgraph.network.parts import KnownImage, image_columns, joined
from mgsgraph.network.records import GroundPoints, ImageRays, PointClass, Ranges
from mgsgraph.ties import PointKind, TiePoints


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
    """
    parts = [
        _of_ties(images, one, tie_sigma) if isinstance(one, TiePoints) else _of_shots(images, one, shot_sigma)
        for one in observations
        if one.measure_image or (isinstance(one, LaserProfile) and any(one.simultaneous))
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
    pairs = [(i, name) for i, simultaneous in enumerate(profile.simultaneous) for name in simultaneous]
    names, image = _numbered(images, (*profile.measure_image, *(name for _, name in pairs)), profile.source)
    k, n = len(profile.measure_image), len(profile.ids)
    shot = np.array([i for i, _ in pairs], dtype=np.int64)
    classes, kinds = np.full(n, int(PointClass.LASER)), np.full(n, int(PointKind.CONSTRAINED))
    points = GroundPoints(profile.ids, classes, kinds, profile.footprints, profile.covariances)
    rays = ImageRays(profile.measure_shot, image[:k], profile.measures, np.full((k, 2), sigma))
    ranges = Ranges(shot, image[k:], profile.times[shot], profile.ranges[shot], profile.range_sigmas[shot])
    return _network([images[name] for name in names], points, rays, ranges, profile.source)


def _numbered(images: Mapping[str, KnownImage], named: Sequence[str], source: str) -> tuple[list[str], Index]:
    """Images named, each once, and the number of each measure's."""
    number = {name: j for j, name in enumerate(dict.fromkeys(named))}
    for name in number:
        if name not in images:
            known = ", ".join(list(images)[:4])
            found, expected = f"measures in the image {name!r}", f"known images ({known})"
            raise InputError(source, found, expected, "add the image first")
    return list(number), np.array([number[name] for name in named], dtype=np.int64)


def _network(
    known: list[KnownImage], points: GroundPoints, rays: ImageRays, ranges: Ranges, source: str
) -> Network:
    columns = image_columns(known)
    require_inside(columns[0], rays.image, rays.places, [points.ids[i] for i in rays.point.tolist()], source)
    return Network(*columns, points, rays, ranges)


def require_inside(
    images: Sequence[PushbroomImage], image: Index, places: Array, names: Sequence[str], source: str
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
        Of the measures' points.
    source : str
        What to call the measures in errors.
    """
    size = np.array([(one.lines, one.samples) for one in images], dtype=np.float64)[image]
    for k in np.flatnonzero(np.any((places < 0.0) | (places > size), axis=1))[:1]:
        raise InputError(
            f"{source}, point {names[k]}, image {images[image[k]].name}",
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
