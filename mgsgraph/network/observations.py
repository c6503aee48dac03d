"""Observations of images as a network: what is added to one that is already there; terrain models, whose posts become
its points; and which image carries the range of a shot.

Terrain models: which points lie on one, with what sigma, and which don't, those beside it and those over its holes;
and posts as points of a network: what a laser shot is, ground that is known but for what all posts of
the model are off in common.

A post stands for the mean height of its cell. Where cells are smaller than what images can show, posts are averaged to
cells as large as that.

Which image carries the range of a laser shot: the one that was taken meanwhile, or an image of the pass that was.

Images of a pass are on one trajectory, and orientation images describe it from the first line of the pass to the last
one: so shots between the lines of two of its images are carried, too, where the table of one of them covers their time.
One camera carries all shots of a pass: what turns the beam turns it about one set of axes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError, require
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.geometry.altimetry import (
    SPOT_WIDTHS,
    LaserProfile,
    exchanged_units,
    footprint_covariances,
    require_lengths,
)
from mgsgraph.geometry.body import in_turn, planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, Index, Mask, finite_rows
from mgsgraph.geometry.terrain import PostLattice, TerrainGrid
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.network.common import gap_variances
from mgsgraph.network.footprints import Registration
from mgsgraph.network.joining import spans
from mgsgraph.network.network import Network
from mgsgraph.network.parts import KnownImage, image_columns, joined
from mgsgraph.network.records import GroundPoints, ImageRays, PointClass, ProfileShifts, Ranges
from mgsgraph.network.shared import SharedUnknown
from mgsgraph.record import Record
from mgsgraph.units import DEG, KM

_FAR_OFF = 0.1
"""Part of the way from the camera by which a range may be another: orbits are known to a kilometre or so."""
_LEAST_SIGMA = 0.02
"""m; planetary altimeters range to 0.1 m and worse."""


def build_network(
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
    >>> images = {image.name: mgsgraph.KnownImage(image, pair.settings.noise.prior) for image in pair.images}
    >>> print(mgsgraph.build_network(images, [pair.ties, pair.laser], tie_sigma=0.5))
    Network(2 images, 28 points (20 tie, 8 laser), 56 rays, 8 ranges)
    """
    parts = [
        _of_ties(images, given, tie_sigma) if isinstance(given, TiePoints) else _of_shots(images, given, shot_sigma)
        for given in observations
        if len(given.measure_image) or (isinstance(given, LaserProfile) and len(given.simultaneous_image))
    ]
    return joined(parts) if parts else None


def _of_ties(images: Mapping[str, KnownImage], ties: TiePoints, sigma: float) -> Network:
    names, image = _numbered(images, ties.measure_image, ties.source)
    sigmas = np.where(np.isnan(ties.measure_sigmas), sigma, ties.measure_sigmas)
    classes = np.full(len(ties.ids), int(PointClass.TIE))
    points = GroundPoints(ties.ids, classes, ties.kinds, ties.places, ties.covariances)
    rays = ImageRays(ties.measure_point, image, ties.measures, sigmas)
    return _network([images[name] for name in names], points, rays, Ranges.none(), ties.source)


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
    ranges = Ranges(
        shot, image[k:], profile.times[shot], profile.ranges[shot], profile.range_sigmas[shot],
        shares=None if profile.shares is None else profile.shares[shot],
    )  # fmt: skip
    return _network([images[name] for name in names], points, rays, ranges, profile.source)


def _numbered(images: Mapping[str, KnownImage], named: RepeatedNames, source: str) -> tuple[list[str], Index]:
    """Images named, each once, and the number of each measure's."""
    used = named.used
    for name in used:
        if name not in images:
            listed = ", ".join(list(images)[:4])
            found, expected = f"measures in the image {name!r}", f"known images ({listed})"
            raise InputError(source, found, expected, "add the image first")
    return list(used), named.over(used)


def _network(
    images: list[KnownImage], points: GroundPoints, rays: ImageRays, ranges: Ranges, source: str
) -> Network:
    columns = image_columns(images)
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
    size = np.array([(picture.lines, picture.samples) for picture in images], dtype=np.float64)[image]
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
        of_image = rays.image == j
        lines, samples = rays.places[of_image].T
        ground[of_image], _ = image.image_to_ground(lines, samples, heights[of_image])
    return ground


# --- ranges that can't be


def require_ranges_of(profile: LaserProfile, images: Sequence[PushbroomImage], along: Index) -> None:
    """Raise InputError where ranges are not the distances from the trajectories of the simultaneous images, of which
    `along` (r,) has the indices, or are of times beyond these; see `require_ranges`.
    """
    for j in dict.fromkeys(along.tolist()):
        of_image, image = profile.simultaneous_shot[along == j], images[j]
        times, ground, ranges = profile.times[of_image], profile.footprints[of_image], profile.ranges[of_image]
        past, (start, stop) = times - image.trajectory.epoch, image.trajectory.coverage
        worst = int(np.argmax(np.maximum(start - past, past - stop)))
        where = f"{profile.source}, laser shot {profile.ids[int(of_image[worst])]}, image {image.name}"
        image.trajectory.require(past[[worst]], where)
        require_ranges(image, times, ground, ranges, profile.source, profile.ids[of_image])


def require_ranges(
    image: PushbroomImage, times: Array, footprints: Array, ranges: Array, source: str, names: Sequence[str]
) -> None:
    """Raise InputError where ranges (n,) in m are not the distances from an image's trajectory: all of them by their
    unit, or one of the shots, which have these names. Times at which the trajectory isn't known pass.
    """
    past, (start, stop) = times - image.trajectory.epoch, image.trajectory.coverage
    covered = np.flatnonzero((past >= start) & (past <= stop))
    if not covered.size:
        return
    distances = np.linalg.norm(footprints[covered] - image.trajectory.pose(past[covered]).position, axis=1)
    require_lengths(ranges[covered], distances, "ranges", source)
    for k in np.flatnonzero(np.abs(ranges[covered] / distances - 1.0) > _FAR_OFF)[:1].tolist():
        found = f"a range of {ranges[covered[k]] / KM:,.6g} km"
        expected = f"about {distances[k] / KM:,.6g} km, the way from the trajectory of {image.name}"
        remedy = exchanged_units(ranges[covered[k]] / distances[k]) or "fix it, or take the shot out"
        raise InputError(f"{source}, shot {names[covered[k]]}", found, expected, remedy)


def require_range_sigmas(profile: LaserProfile) -> None:
    """Raise InputError for a sigma of a range that no altimeter reaches, or that is larger than the range."""
    small, large = profile.range_sigmas < _LEAST_SIGMA, profile.range_sigmas > profile.ranges
    for i in np.flatnonzero(small | large)[:1].tolist():
        found = f"a range of {profile.ranges[i] / KM:,.6g} km with a sigma of {profile.range_sigmas[i]:g} m"
        likely = "are sigmas in kilometres, where the format has metres?" if small[i] else "is its unit right?"
        raise InputError(f"{profile.source}, shot {profile.ids[i]}", found, "a sigma in m, 0.02 or more",
                         f"{likely} Mend them, or state range_sigma_m in [laser] of a case")  # fmt: skip


_STEPS = 3
"""Times that a ray's ground is looked up at the height of the terrain under its last place: some metres are left."""


class Coverage(NamedTuple):
    """How a terrain model covers points."""

    on: int
    """Points whose four posts are there."""
    beside: int
    """Points outside the model."""
    over_holes: int
    """Points within it of whose four posts some are missing."""
    points: Array
    """(2, 2) rad, least and largest longitude and latitude of the points; NaN without any."""
    model: Array
    """(2, 2) rad, the same of the model's posts."""

    @property
    def total(self) -> int:
        """All points that were asked about."""
        return self.on + self.beside + self.over_holes

    @property
    def words(self) -> str:
        """Points that the model doesn't cover, and why; empty where it covers all."""
        parts = []
        if self.beside:
            parts.append(
                f"{self.beside} outside the model (points {in_degrees(self.points)}; model {in_degrees(self.model)})"
            )
        if self.over_holes:
            parts.append(f"{self.over_holes} over missing posts")
        return " and ".join(parts)


def coverage(grid: TerrainGrid, places: Array) -> Coverage:
    """How a terrain model covers places (n, 3) in m, body-fixed; those that are NaN count as outside it."""
    sound = finite_rows(places)
    inside = np.zeros(sound.size, dtype=bool)
    inside[sound] = grid.holds(places[sound])
    on = int(np.count_nonzero(np.isfinite(grid.at(places[inside]))))
    within = int(np.count_nonzero(inside))
    return Coverage(on, sound.size - within, within - on, box_of(places[sound], float(grid.box[:, 0].mean())), grid.box)


def terrain_ground(images: Sequence[PushbroomImage], rays: ImageRays, grid: TerrainGrid) -> Array:
    """(k, 3) m, where rays meet the terrain model with the nominal orientation, or the ellipsoid where there is none;
    NaN for those that miss the body.
    """
    heights = np.zeros(rays.point.size)
    places = nominal_ground(images, rays, heights)
    for _ in range(_STEPS):
        above = np.linalg.norm(places, axis=1) - grid.at(places)
        heights -= np.where(np.isfinite(above), above, 0.0)
        places = nominal_ground(images, rays, heights)
    return places


def over_terrain(images: Sequence[PushbroomImage], rays: ImageRays, grid: TerrainGrid) -> tuple[Index, Array]:
    """Points with rays (p,), and places (p, 3) in m where the first ray of each meets the ground (`terrain_ground`)."""
    points, first = np.unique(rays.point, return_index=True)
    return points, terrain_ground(images, rays.chosen(first), grid)


def box_of(places: Array, middle: float) -> Array:
    """(2, 2) rad, least and largest longitude, in the turn about a middle, and latitude of places (n, 3) in m; NaN
    without any.
    """
    if places.shape[0] == 0:
        return np.full((2, 2), np.nan)
    longitudes, latitudes, _ = planetocentric(places).T
    longitudes = in_turn(longitudes, middle)
    corners = np.stack([longitudes, latitudes], axis=1)
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


def in_degrees(box: Array) -> str:
    """A box (2, 2) of longitude and latitude in rad, in words; longitudes in 0 .. 360, eastward from the first."""
    (west, south), (east, north) = box / DEG
    return f"{west % 360.0:.3f} .. {east % 360.0:.3f} E, {south:+.3f} .. {north:+.3f} N"


PLACE_SIGMA = 0.1
"""m, a-priori, east and north of each post by itself: files round longitudes and latitudes so."""
_WIDTH = SPOT_WIDTHS / np.sqrt(12.0)
"""Diameter of the Gaussian footprint (four standard deviations) that is as wide as a square cell, in sides of it."""
_LEAST_SHARE = 0.5
"""Of a cell's posts that have to be there."""


@dataclass(frozen=True, slots=True, eq=False)
class TerrainModel(Record):
    """A terrain model whose place as a whole is unknown."""

    name: str
    """What reports call it."""
    lattice: PostLattice
    """Posts, with their sigma and that of their common horizontal place."""
    height_sigma: float | None = None
    """m, a-priori, of its height as a whole, which is an unknown; None where that is known."""

    def __post_init__(self) -> None:
        if self.lattice.planimetric_sigma is None:
            raise InputError(f"terrain {self.lattice.source}", "no sigma of its horizontal place", "metres, above zero")


class Posts(NamedTuple):
    """Posts of one terrain model, or means of some of them."""

    ids: Names
    """(n) names: that of the model, row and column."""
    points: Array
    """(n, 3) m, body-fixed."""
    sigmas: Array
    """(n,) m, of the heights."""
    footprint: float
    """m, diameter of the Gaussian footprint that stands for a cell."""

    def chosen(self, which: Index) -> "Posts":
        """Some of them."""
        return Posts(self.ids[which], self.points[which], self.sigmas[which], self.footprint)


def posts_of(model: TerrainModel, least: float) -> Posts:
    """Posts of a terrain model by rows from its first one; m by n of them averaged to one where a cell would be smaller
    than `least`, m. The posts' own errors count as independent, and so a mean's sigma is theirs by the root of m n;
    those of interpolation between tracks are common within half the distance between these (`gap_variances`).

    Raises
    ------
    InputError
        Where a post's sigma is unknown, or there is no post.
    """
    lattice = model.lattice
    present = np.isfinite(lattice.values)
    require(np.any(present), f"terrain {lattice.source}", "no post", "a model of the images' ground")
    sides = _sides(lattice)
    wanted = max(least, *sides.tolist())
    high, wide = np.maximum(np.rint(wanted / sides), 1.0).astype(int).tolist()
    blocks = _blocks(present, high, wide)
    filled = blocks.sum(axis=(1, 3)) > _LEAST_SHARE * high * wide
    count = blocks.sum(axis=(1, 3))[filled]
    first = np.argwhere(filled) * [high, wide]
    row = first[:, 0] + (blocks.sum(axis=3) * np.arange(high)[:, None]).sum(axis=1)[filled] / count
    column = first[:, 1] + (blocks.sum(axis=1) * np.arange(wide)).sum(axis=2)[filled] / count

    def mean(values: NDArray[Any]) -> Array:
        """(k,) of values (rows, columns) at posts, over the posts of each block that are there."""
        posts = _blocks(np.where(present, values, 0.0), high, wide)
        return np.asarray(posts.sum(axis=(1, 3), dtype=np.float64)[filled] / count)

    if not lattice.vertical_sigma:
        raise InputError(f"terrain {lattice.source}", "no sigma of its heights", "metres, above zero")
    spread, points = lattice.vertical_sigma**2 / count, lattice.located(row, column, mean(lattice.values))
    if lattice.gaps is not None:
        spread += gap_variances(np.nan_to_num(points), *(mean(gap) for gap in lattice.gaps))
    names = Names.joined(*(first + 1).T).prefixed(f"{model.name}:")
    posts = Posts(names, points, np.sqrt(spread), _WIDTH * float(np.sqrt(np.prod(sides * [high, wide]))))
    return posts.chosen(np.flatnonzero(finite_rows(points)))


def _sides(lattice: PostLattice) -> Array:
    """(2,) m from the middle post to the one below it and to the one beside it."""
    row, column = (np.array(lattice.values.shape) - 1) // 2
    places = lattice.located(
        row + np.array([0.0, 1.0, 0.0]), column + np.array([0.0, 0.0, 1.0]), np.full(3, np.nanmean(lattice.values))
    )
    return np.asarray(np.linalg.norm(places[1:] - places[0], axis=1))


def _blocks(values: NDArray[Any], high: int, wide: int) -> NDArray[Any]:
    """(r, high, c, wide) values (rows, columns) of posts in blocks; zero beyond the last post."""
    rows, columns = values.shape
    padded = np.pad(values, ((0, -rows % high), (0, -columns % wide)))
    return padded.reshape(padded.shape[0] // high, high, padded.shape[1] // wide, wide)


def with_posts(network: Network, models: Sequence[tuple[TerrainModel, Posts]]) -> Network:
    """A network with posts of terrain models as constrained points: each model is a profile with a shift of its own,
    and with a height where that is unknown.
    """
    shifts = network.shifts or ProfileShifts((), np.full(len(network.points), -1), np.zeros(0))
    points, shared = network.points, list(network.shared)
    for model, posts in models:
        n, first = len(posts.ids), len(shifts.names)
        points = GroundPoints(
            Names.concatenated([points.ids, posts.ids]),
            np.append(points.classes, np.full(n, PointClass.POST)),
            np.append(points.kinds, np.full(n, PointKind.CONSTRAINED)),
            np.concatenate([points.places, posts.points]),
            np.concatenate([points.covariances, footprint_covariances(posts.points, PLACE_SIGMA, posts.sigmas)]),
        )
        shifts = ProfileShifts(
            (*shifts.names, model.name),
            np.append(shifts.profile, np.full(n, first)),
            np.append(shifts.sigmas, model.lattice.planimetric_sigma or np.nan),
        )
        if model.height_sigma is not None:
            shared.append(SharedUnknown.of_height(model.name, model.height_sigma))
    surface = network.surface
    if surface is not None:
        surface = replace(surface, sigmas=np.append(surface.sigmas, np.full(len(points) - surface.sigmas.size, np.inf)))
    return replace(network, points=points, shifts=shifts, shared=tuple(shared), surface=surface)


_TURNED = 1e-6
"""Difference of matrices of cameras that have other axes."""


class Members(NamedTuple):
    """Images of a pass, before it has orientation images."""

    images: tuple[int, ...]
    """Which."""
    axes: Array | None = None
    """(m, 3, 3) how their cameras are mounted (`network.passes.Pass`)."""


def carriers(registration: Registration, usable: Mask, passes: Sequence[Members], remedy: str) -> Index:
    """Image whose trajectory carries the range of each shot.

    Parameters
    ----------
    registration : Registration
        Shots in all images, m of them.
    usable : (n,)
        False for shots that don't count.
    passes : sequence of Members
        Each image is of one at most.
    remedy : str
        What to do about shots along several trajectories.

    Returns
    -------
    (n,)
        -1 for shots that none carries.

    Raises
    ------
    InputError
        For shots along images of several trajectories.
    """
    along = np.flatnonzero(np.any(registration.simultaneous & usable, axis=1)).tolist()
    owners = np.full(registration.shots.times.size, -1, dtype=np.int64)
    of_all = [members for members in passes if set(along) & set(members.images)]
    alone = [j for j in along if not any(j in members.images for members in passes)]
    if len(of_all) + len(alone) > 1:
        names = " and ".join(registration.images[j].name for j in along)
        raise InputError(registration.shots.source, f"shots simultaneous with {names}", "images of one pass", remedy)
    if alone:
        owners[registration.simultaneous[alone[0]]] = alone[0]
    elif of_all:
        owners = _along_pass(registration, of_all[0])
    return owners


def shots_carried(registration: Registration, owners: Index, passes: Sequence[Members]) -> Mask:
    """(n,) True for shots with a carrier that fall in an image of its trajectory, or between its images in time;
    without any carrier for those that fall in an image at all.
    """
    used = np.unique(owners[owners >= 0])
    if not used.size:
        return np.asarray(np.any(registration.inside, axis=0))
    images = next((list(members.images) for members in passes if int(used[0]) in members.images), used.tolist())
    between = ~np.any(registration.simultaneous[images], axis=0)
    return np.asarray((owners >= 0) & (between | np.any(registration.inside[images], axis=0)))


def _along_pass(registration: Registration, pass_: Members) -> Index:
    """Carriers among the images of a pass: of the camera that covers most shots; an image's own shots by itself."""
    times, members = registration.shots.times, np.array(pass_.images)
    edges = spans(registration.images[j] for j in pass_.images)
    during = (times >= edges[:, 0].min()) & (times <= edges[:, 1].max())
    covered = np.zeros((members.size, times.size), dtype=bool)
    for k, j in enumerate(pass_.images):
        start, stop = np.array(registration.images[j].trajectory.coverage) + registration.images[j].trajectory.epoch
        covered[k] = during & (times >= start) & (times <= stop)
    cameras = [_same_axes(pass_, k) for k in range(members.size)]
    camera = max(cameras, key=lambda same: int(np.any(covered[same], axis=0).sum()))
    owners = np.full(times.size, -1, dtype=np.int64)
    for shots in (covered, registration.simultaneous[members]):
        for k in np.flatnonzero(camera)[::-1].tolist():
            owners[shots[k]] = members[k]
    return owners


def _same_axes(pass_: Members, member: int) -> Mask:
    """(m,) True for images whose camera has the axes of one member's."""
    if pass_.axes is None:
        return np.ones(len(pass_.images), dtype=np.bool_)
    return np.asarray(np.abs(pass_.axes - pass_.axes[member]).max(axis=(1, 2)) < _TURNED)
