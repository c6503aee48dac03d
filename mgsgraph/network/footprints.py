"""How laser footprints and images lie to each other: where footprints fall, and by how much images contradict.

Footprints are projected into images by Newton's method. No image content is needed for that; whether a place is the
right one, the projection can't tell.

Two images contradict each other about a footprint when its two places show different ground. Where the place in the
first image lies in the second one, only the images' own tie points know. So the DISCREPANCY is

    projected place in the second image - transferred place of the one projected into the first image,

and the transfer goes over the ground that the ties themselves span under the current orientation: the ray of the place
in the first image is cut at the height of that surface (a plane through the nearest intersected ties), projected into
the second image, and moved by the ties' own misplacement there (measured minus transferred the same way; a low-order
polynomial of line and sample, so that measuring noise averages out). An orientation error across the epipolar plane
shows in the misplacement; one within it lifts the ties' surface off the footprints and shows by the parallax of that
height. A horizontal error of the footprints moves both places alike and shows in neither: ties don't know it. Relief
between the ties enters within the epipolar plane only (across the flight, for a pair taken from two orbits); the stated
sigmas hold it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.tie_points import PointKind, TiePoints
from mgsgraph.geometry.altimetry import AltimeterShots, LaserProfile, exchanged_units, require_lengths
from mgsgraph.geometry.body import geodetic
from mgsgraph.geometry.footprint import intersect_rays
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.names import RepeatedNames
from mgsgraph.network.joining import seconds
from mgsgraph.network.network import Network
from mgsgraph.network.parts import KnownImage, image_columns, joined
from mgsgraph.network.records import GroundPoints, ImageRays, PointClass, Ranges
from mgsgraph.record import Record
from mgsgraph.units import KM

Corrections = Sequence[OrientationCorrection | None]
"""One correction of the nominal orientation per image, None for none."""

_REACH = 40e3
"""m beyond an image's own ground within which footprints are projected: Mars' relief seen at up to 60 degrees."""
_NEAREST = 8
"""Ties that make the plane under a footprint."""
_MISPLACEMENT_TERMS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1))
"""Powers of the normalised line and sample in the ties' misplacement; as many as three ties each can carry."""


@dataclass(frozen=True, slots=True, eq=False)
class Registration(Record):
    """Footprints in images: m images, n shots.

    Examples
    --------
    >>> from mgsgraph.files.altimetry.shots import read_shots
    >>> from mgsgraph.network.footprints import crossings, footprints_in_images
    >>> shots = read_shots(Path("gusev/ap18933l.b"))
    >>> found = footprints_in_images([image.nominal for image in site.images], shots)
    >>> crossing = crossings(found)[0]
    >>> crossing.image, crossing.profile, crossing.inside, crossing.simultaneous
    ('E02-00665', '18933', 5, 4)
    """

    images: tuple[PushbroomImage, ...]
    """(m) images."""
    shots: AltimeterShots
    """(n) shots."""
    places: Array
    """(m, n, 2) line and sample; NaN where the image doesn't see the footprint."""
    inside: Mask
    """(m, n) True where that lies in the image, or its margin."""
    seconds: Array
    """(m, n) s from the image's lines to the shot, negative before them; 0 for shots fired while it was taken."""

    @property
    def simultaneous(self) -> Mask:
        """(m, n) True for shots between the times of the image's first and last line."""
        return np.asarray(self.seconds == 0.0)

    @property
    def chosen(self) -> Index:
        """Shots that fall in any image."""
        return np.flatnonzero(np.any(self.inside, axis=0))

    def simultaneous_image(self, usable: Mask, remedy: str) -> int | None:
        """Index of the only image in which usable shots (n,) fall that were fired meanwhile, so that its trajectory
        carries their ranges; None for none.

        Raises InputError with the remedy when there are several.
        """
        found = np.flatnonzero(np.any(self.inside & self.simultaneous & usable, axis=1)).tolist()
        if len(found) > 1:
            names = " and ".join(self.images[j].name for j in found)
            raise InputError(self.shots.source, f"shots simultaneous with {names}", "one image", remedy)
        return found[0] if found else None

    def __repr__(self) -> str:
        counts = ", ".join(
            f"{image.name}: {n}" for image, n in zip(self.images, self.inside.sum(axis=1).tolist(), strict=True)
        )
        return f"Registration({self.shots.times.size} shots; inside {counts})"


@dataclass(frozen=True, slots=True, eq=False)
class Crossing(Record):
    """Shots of one profile over one image, or taken along with it: what Shan et al. (2004) found by search."""

    profile: str
    """Orbit, or the minute (UTC) in which the crossing began."""
    image: str
    """The image's name."""
    shots: int
    """Shots of the profile that could be chosen."""
    inside: int
    """Those that fall in the image."""
    simultaneous: int
    """Those fired while the image was taken."""
    seconds: float
    """s from the image's nearest line to the nearest of its shots inside; negative before the image."""
    off_nadir: float
    """rad, median of its shots inside; NaN where unknown."""
    start: float
    """s TDB past J2000 of its first shot inside, or else of its first simultaneous one."""


@dataclass(frozen=True, slots=True, eq=False)
class Misregistration:
    """By how much projected places of footprints are off in one image, along the flight and to its right."""

    image: str
    """In whose pixels."""
    against: str
    """Against what: the other image's name, or "truth"."""
    shots: Index
    """(k,) which footprints."""
    lines: Array
    """(k,) where they lie along the image."""
    pixels: Array
    """(k, 2) line and sample, projected minus where it should be."""
    pixel_sigmas: Array
    """(k, 2) pixels; zero against truth."""
    metres: Array
    """(k, 2) m on the ground at the footprints' heights, along the spacecraft's track over the turning body and to its
    right."""
    metre_sigmas: Array
    """(k, 2) m."""
    spacing: float
    """m, distance between footprints of a profile; NaN where unknown."""

    @property
    def spacings(self) -> Array:
        """(k, 2) the metres in units of the distance between footprints."""
        return self.metres / self.spacing

    def __repr__(self) -> str:
        (along, across), k = self.metres.mean(axis=0) if self.shots.size else (np.nan, np.nan), self.shots.size
        return f"Misregistration({k} footprints in {self.image} against {self.against}: {along:.1f}, {across:.1f} m)"


def footprints_in_images(
    images: Sequence[PushbroomImage],
    shots: AltimeterShots,
    corrections: Corrections | None = None,
    points: Array | None = None,
    margin: float = 0.0,
) -> Registration:
    """Project every footprint into every image that sees it.

    Parameters
    ----------
    images : sequence of PushbroomImage
        All of them.
    shots : AltimeterShots
        Footprints and their times.
    corrections : sequence, optional
        Of the images' orientation; none when absent.
    points : (n, 3), optional
        m, places of the footprints instead of their own (adjusted ones).
    margin : float
        pixels by which a footprint may lie outside of an image.

    Examples
    --------
    >>> from mgsgraph.files.altimetry.shots import read_shots
    >>> from mgsgraph.network.footprints import crossings, footprints_in_images
    >>> shots = read_shots(Path("gusev/ap18933l.b"))
    >>> found = footprints_in_images([image.nominal for image in site.images], shots)
    >>> crossing = crossings(found)[0]
    >>> crossing.image, crossing.profile, crossing.inside, crossing.simultaneous
    ('E02-00665', '18933', 5, 4)
    """
    given = corrections if corrections is not None else [None] * len(images)
    if len(given) != len(images):
        raise InputError("registration", f"{len(given)} corrections", f"one for each of {len(images)} images")
    ground = shots.footprints if points is None else points
    places = np.stack([visible_places(image, ground, one) for image, one in zip(images, given, strict=True)])
    inside = np.stack([_within(image, mine, margin) for image, mine in zip(images, places, strict=True)])
    edges = [seconds(image) for image in images]
    beside = [np.minimum(shots.times - first, 0.0) + np.maximum(shots.times - last, 0.0) for first, last in edges]
    return Registration(tuple(images), shots, places, inside, np.stack(beside))


def crossings(found: Registration) -> tuple[Crossing, ...]:
    """Profiles that cross images, image by image: those taken along first, then by their times."""
    every, names, orbits = list[Crossing](), found.shots.profile_names(), found.shots.orbits
    for image, inside, since in zip(found.images, found.inside, found.seconds, strict=True):
        mine = list[Crossing]()
        for orbit in np.unique(orbits[inside | (since == 0.0)]):
            members = np.flatnonzero(orbits == orbit)
            within, along = members[inside[members]], members[since[members] == 0.0]
            near = within if within.size else along
            angles = found.shots.off_nadir[near]
            mine.append(Crossing(
                names[members[0]], image.name, members.size, within.size, along.size,
                float(since[near][np.argmin(np.abs(since[near]))]),
                float(np.nanmedian(angles)) if np.any(np.isfinite(angles)) else float("nan"),
                float(found.shots.times[near].min()),
            ))  # fmt: skip
        every += sorted(mine, key=lambda one: (not one.simultaneous, one.start))
    return tuple(every)


def points_in_images(
    images: Sequence[PushbroomImage],
    points: Array,
    margin: float = 0.0,
    corrections: Corrections | None = None,
) -> Mask:
    """(m, n) which ground points (n, 3) in m are in which images, or at most `margin` pixels beside them; `corrections`
    as of `footprints_in_images`.

    Examples
    --------
    >>> from mgsgraph.network.footprints import points_in_images
    >>> points_in_images(network.images, solution.places).sum(axis=1)
    array([28, 28])
    """
    return np.stack([
        _within(image, visible_places(image, points, correction), margin)
        for image, correction in zip(images, corrections or [None] * len(images), strict=True)
    ])


def _within(image: PushbroomImage, places: Array, margin: float = 0.0) -> Mask:
    with np.errstate(invalid="ignore"):
        size = np.array([image.lines, image.samples])
        inside: Mask = np.all((places >= -margin) & (places <= size + margin), axis=-1)
    return inside


def visible_places(image: PushbroomImage, points: Array, correction: OrientationCorrection | None = None) -> Array:
    """(n, 2) line and sample of points (n, 3) in m; NaN on the far side of the body, or far from the image's ground."""
    places, near = np.full((points.shape[0], 2), np.nan), _visible(image, points, correction)
    if near.size:
        places[near], _ = image.ground_to_image(points[near], correction)
    return places


def _visible(image: PushbroomImage, points: Array, correction: OrientationCorrection | None) -> Index:
    """Points that are near the image's own ground and on its side of the body."""
    edge = np.array([0.0, 0.5, 1.0])
    lines, samples = (one.ravel() for one in np.meshgrid(edge * image.lines, edge * image.samples, indexing="ij"))
    ground, _ = image.image_to_ground(lines, samples, correction=correction)
    eye = image.pose(np.array([0.5 * image.lines]), correction).position[0]
    facing = np.einsum("ni,ni->n", points, eye - points) > 0.0
    if not np.all(np.isfinite(ground)):
        return np.flatnonzero(facing)
    centre = ground.mean(axis=0)
    reach = np.linalg.norm(ground - centre, axis=1).max() * 2.0 + _REACH  # Newton follows half a length beyond the ends
    return np.flatnonzero(facing & (np.linalg.norm(points - centre, axis=1) < reach))


def misregistration(
    image: PushbroomImage,
    shots: AltimeterShots,
    true_places: Array,
    correction: OrientationCorrection | None = None,
    points: Array | None = None,
) -> Misregistration:
    """Projected minus true places of footprints, as only a simulation knows them.

    Parameters
    ----------
    image : PushbroomImage
        In which they are projected.
    shots : AltimeterShots
        Footprints.
    true_places : (n, 2)
        line and sample of each; NaN where it is not in the image.
    correction : OrientationCorrection, optional
        of the nominal orientation; none when absent.
    points : (n, 3), optional
        m, places of the footprints instead of their own (adjusted ones).
    """
    ground = shots.footprints if points is None else points
    projected, _ = image.ground_to_image(ground, correction, np.nan_to_num(true_places[:, 0], nan=0.5 * image.lines))
    kept = np.flatnonzero(np.all(np.isfinite(projected + true_places), axis=1))
    off = projected[kept] - true_places[kept]
    metres = on_ground(image, projected[kept], ground[kept], correction)
    return Misregistration(
        image.name, "truth", kept, true_places[kept, 0], off, np.zeros_like(off),
        np.einsum("nij,nj->ni", metres, off), np.zeros_like(off), shots.spacing,
    )


def discrepancy(
    pair: tuple[PushbroomImage, PushbroomImage],
    shots: AltimeterShots,
    ties: TiePoints,
    corrections: Corrections = (None, None),
    points: Array | None = None,
) -> Misregistration:
    """By how much two images contradict each other about footprints, in pixels of the second; see the module's text.

    Parameters
    ----------
    pair : two PushbroomImage
        First and second image.
    shots : AltimeterShots
        Footprints; those that fall in both images are taken.
    ties : TiePoints
        Among them at least three that are measured in both images.
    corrections : sequence
        of the two images' orientation.
    points : (n, 3), optional
        m, places of the footprints instead of their own (adjusted ones).
    """
    first, second = pair
    ground = shots.footprints if points is None else points
    places = footprints_in_images(pair, shots, corrections, ground).places
    kept = np.flatnonzero(_within(first, places[0]) & _within(second, places[1]))
    in_first, in_second = places[0, kept], places[1, kept]
    measured = _common_measures(pair, ties)
    heights = _tie_heights(pair, measured, corrections)
    surface, surface_sigma = _plane_heights(first, measured[0], heights, in_first)
    transferred, by_height = _transfer(pair, in_first, surface, corrections)
    over_ties, _ = _transfer(pair, measured[0], heights, corrections)
    misplaced, sigmas = _smooth(first, measured[0], measured[1] - over_ties, in_first)
    off = in_second - transferred - misplaced
    lifted = by_height * surface_sigma[:, None]
    metres = on_ground(second, in_second, ground[kept], corrections[1])
    variance = np.einsum("nij,nj->ni", metres**2, sigmas**2) + np.einsum("nij,nj->ni", metres, lifted) ** 2
    return Misregistration(
        second.name, first.name, kept, in_second[:, 0], off, np.hypot(sigmas, lifted),
        np.einsum("nij,nj->ni", metres, off), np.sqrt(variance), shots.spacing,
    )


def on_ground(
    image: PushbroomImage, places: Array, points: Array, correction: OrientationCorrection | None
) -> Array:
    """(n, 2, 2) metres along the flight and to its right per line and per sample, at the points' heights."""
    height = geodetic(points, image.body)[:, 2]
    _, to_ground = image.image_to_ground(places[:, 0], places[:, 1], height, correction)
    up = points / np.linalg.norm(points, axis=1, keepdims=True)
    flight = image.pose(places[:, 0], correction).velocity
    along = flight - np.einsum("ni,ni->n", flight, up)[:, None] * up
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.asarray(np.stack([along, np.cross(along, up)], axis=1) @ to_ground)


def _common_measures(pair: tuple[PushbroomImage, PushbroomImage], ties: TiePoints) -> tuple[Array, Array]:
    """Places (k, 2) in the first and in the second image of the ties measured in both."""
    number = ties.measure_image.over([image.name for image in pair])
    one, two = (np.flatnonzero(number == k) for k in range(2))
    _, i, j = np.intersect1d(ties.measure_point[one], ties.measure_point[two], return_indices=True)
    if i.size < 3:
        raise InputError(
            f"{ties.source}, images {pair[0].name} and {pair[1].name}", f"{i.size} common tie points",
            "at least 3", "measure tie points in both images: without them their discrepancy can't be known",
        )
    return ties.measures[one[i]], ties.measures[two[j]]


def _tie_heights(
    pair: tuple[PushbroomImage, PushbroomImage], measured: tuple[Array, Array], corrections: Corrections
) -> Array:
    """Heights (k,) in m above the ellipsoid at which the rays of ties meet under the current orientation."""
    rays = [
        image.sightlines(places[:, 0], places[:, 1], correction)
        for image, places, correction in zip(pair, measured, corrections, strict=True)
    ]
    origins, directions = (np.concatenate([ray[part] for ray in rays]) for part in (0, 1))
    count = measured[0].shape[0]
    points, _, _ = intersect_rays(origins, directions, np.tile(np.arange(count), 2), count)
    for k in np.flatnonzero(np.isnan(points[:, 0]))[:1]:
        line, sample = measured[0][k]
        raise InputError(
            f"images {pair[0].name} and {pair[1].name}",
            f"parallel rays of the tie at line {line:.1f}, sample {sample:.1f}", "images from different places",
        )
    return geodetic(points, pair[0].body)[:, 2]


def _transfer(
    pair: tuple[PushbroomImage, PushbroomImage], places: Array, heights: Array, corrections: Corrections
) -> tuple[Array, Array]:
    """Places (n, 2) in the second image of places in the first, over ground at heights (n,), and their rates by it."""

    def over(height: Array) -> Array:
        ground, _ = pair[0].image_to_ground(places[:, 0], places[:, 1], height, corrections[0])
        return pair[1].ground_to_image(ground, corrections[1])[0]

    return over(heights), 0.5 * (over(heights + 1.0) - over(heights - 1.0))


def _plane_heights(image: PushbroomImage, ties: Array, heights: Array, places: Array) -> tuple[Array, Array]:
    """Heights (n,) in m at places (n, 2) from planes through the nearest ties, and their sigmas; NaN of three ties.

    The sigma is what the heights of the plane's ties leave, carried to the place, and once again for the relief there.
    """
    down, across = (places[:, None, k] - ties[None, :, k] for k in (0, 1))
    middle = np.array([[0.5 * image.lines, 0.5 * image.samples]])
    _, by_pixel = image.image_to_ground(middle[:, 0], middle[:, 1])
    size = np.linalg.norm(by_pixel[0], axis=0)  # m per line and per sample
    distance = np.hypot(down * size[0], across * size[1])
    count = min(_NEAREST, ties.shape[0])
    near = np.argsort(distance, axis=1)[:, :count]
    rows = np.arange(places.shape[0])[:, None]
    design = np.stack([np.ones_like(distance[rows, near]), down[rows, near], across[rows, near]], axis=2)
    design[:, :, 1:] *= size / 1e3  # km, so that the columns are of one size
    normal = np.swapaxes(design, 1, 2) @ design
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)  # ties in one line make no plane
    inverse = np.linalg.inv(normal)
    found = np.einsum("nij,nkj,nk->ni", inverse, design, heights[near])
    left = heights[near] - np.einsum("nki,ni->nk", design, found)
    spread = np.sum(left**2, axis=1) / (count - 3) if count > 3 else np.full(places.shape[0], np.nan)
    return found[:, 0], np.sqrt(spread * (1.0 + inverse[:, 0, 0]))


def _smooth(image: PushbroomImage, ties: Array, misplacement: Array, places: Array) -> tuple[Array, Array]:
    """Misplacements (n, 2) in pixels at places, and their sigmas: polynomials fitted to those of the ties (k, 2)."""
    terms = _MISPLACEMENT_TERMS[: max(1, min(len(_MISPLACEMENT_TERMS), ties.shape[0] // 3))]

    def design(at: Array) -> Array:
        u, v = 2.0 * at[:, 0] / image.lines - 1.0, 2.0 * at[:, 1] / image.samples - 1.0
        return np.stack([u**p * v**q for p, q in terms], axis=1)

    rows = design(ties)
    inverse = np.linalg.pinv(rows.T @ rows)
    found = inverse @ rows.T @ misplacement
    left = misplacement - rows @ found
    spread = np.sum(left**2, axis=0) / (ties.shape[0] - len(terms))
    at = design(places)
    share = np.einsum("ni,ij,nj->n", at, inverse, at)
    return at @ found, np.sqrt(share[:, None] * spread)



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
    >>> from mgsgraph.network.footprints import observed
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



_TURNED = 1e-6
"""Difference of matrices of cameras that have other axes."""


class Members(NamedTuple):
    """Images of a pass, before it has orientation images."""

    images: tuple[int, ...]
    """Which."""
    axes: Array | None = None
    """(m, 3, 3) how their cameras are mounted (`network.passes.Pass`)."""


def carriers(found: Registration, usable: Mask, passes: Sequence[Members], remedy: str) -> Index:
    """Image whose trajectory carries the range of each shot.

    Parameters
    ----------
    found : Registration
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
    along = np.flatnonzero(np.any(found.simultaneous & usable, axis=1)).tolist()
    owners = np.full(found.shots.times.size, -1, dtype=np.int64)
    of_all = [one for one in passes if set(along) & set(one.images)]
    alone = [j for j in along if not any(j in one.images for one in passes)]
    if len(of_all) + len(alone) > 1:
        names = " and ".join(found.images[j].name for j in along)
        raise InputError(found.shots.source, f"shots simultaneous with {names}", "images of one pass", remedy)
    if alone:
        owners[found.simultaneous[alone[0]]] = alone[0]
    elif of_all:
        owners = _along_pass(found, of_all[0])
    return owners


def shots_carried(found: Registration, owners: Index, passes: Sequence[Members]) -> Mask:
    """(n,) True for shots with a carrier that fall in an image of its trajectory, or between its images in time;
    without any carrier for those that fall in an image at all.
    """
    used = np.unique(owners[owners >= 0])
    if not used.size:
        return np.asarray(np.any(found.inside, axis=0))
    images = next((list(one.images) for one in passes if int(used[0]) in one.images), used.tolist())
    between = ~np.any(found.simultaneous[images], axis=0)
    return np.asarray((owners >= 0) & (between | np.any(found.inside[images], axis=0)))


def _along_pass(found: Registration, one: Members) -> Index:
    """Carriers among the images of a pass: of the camera that covers most shots; an image's own shots by itself."""
    times, members = found.shots.times, np.array(one.images)
    edges = np.array([seconds(found.images[j]) for j in one.images])
    during = (times >= edges[:, 0].min()) & (times <= edges[:, 1].max())
    covered = np.zeros((members.size, times.size), dtype=bool)
    for k, j in enumerate(one.images):
        start, stop = np.array(found.images[j].trajectory.coverage) + found.images[j].trajectory.epoch
        covered[k] = during & (times >= start) & (times <= stop)
    cameras = [_same_axes(one, k) for k in range(members.size)]
    camera = max(cameras, key=lambda same: int(np.any(covered[same], axis=0).sum()))
    owners = np.full(times.size, -1, dtype=np.int64)
    for k in np.flatnonzero(camera)[::-1].tolist():
        owners[covered[k]] = members[k]
    for k in np.flatnonzero(camera)[::-1].tolist():
        owners[found.simultaneous[members[k]]] = members[k]
    return owners


def _same_axes(one: Members, member: int) -> Mask:
    """(m,) True for images whose camera has the axes of one member's."""
    if one.axes is None:
        return np.ones(len(one.images), dtype=np.bool_)
    return np.asarray(np.abs(one.axes - one.axes[member]).max(axis=(1, 2)) < _TURNED)
