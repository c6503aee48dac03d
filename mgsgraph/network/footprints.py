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
height. A horizontal error of the footprints moves both places in the same way and stays invisible. Relief between the
ties enters within the epipolar plane only (across the flight, for a pair taken from two orbits); the stated sigmas hold
it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.body import ellipsoidal_heights
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.intersection import intersect_rays
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask, all_pairs, finite_rows
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.network.joining import seconds
from mgsgraph.record import Record

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
    >>> from mgsgraph.network.footprints import crossings
    >>> shots = mgsgraph.read_shots(Path("gusev/ap18933l.b"))
    >>> found = mgsgraph.footprints_in_images([image.nominal for image in site.images], shots)
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
        numbers = np.flatnonzero(np.any(self.inside & self.simultaneous & usable, axis=1)).tolist()
        if len(numbers) > 1:
            names = " and ".join(self.images[j].name for j in numbers)
            raise InputError(self.shots.source, f"shots simultaneous with {names}", "one image", remedy)
        return numbers[0] if numbers else None

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
    >>> from mgsgraph.network.footprints import crossings
    >>> shots = mgsgraph.read_shots(Path("gusev/ap18933l.b"))
    >>> found = mgsgraph.footprints_in_images([image.nominal for image in site.images], shots)
    >>> crossing = crossings(found)[0]
    >>> crossing.image, crossing.profile, crossing.inside, crossing.simultaneous
    ('E02-00665', '18933', 5, 4)
    """
    given = corrections if corrections is not None else [None] * len(images)
    if len(given) != len(images):
        raise InputError("registration", f"{len(given)} corrections", f"one for each of {len(images)} images")
    ground = shots.footprints if points is None else points
    places = np.stack([visible_places(image, ground, change) for image, change in zip(images, given, strict=True)])
    inside = np.stack([_within(image, pixels, margin) for image, pixels in zip(images, places, strict=True)])
    edges = [seconds(image) for image in images]
    beside = [np.minimum(shots.times - first, 0.0) + np.maximum(shots.times - last, 0.0) for first, last in edges]
    return Registration(tuple(images), shots, places, inside, np.stack(beside))


def crossings(registration: Registration) -> tuple[Crossing, ...]:
    """Profiles that cross images, image by image: those taken along first, then by their times."""
    all_crossings, names, orbits = list[Crossing](), registration.shots.profile_names(), registration.shots.orbits
    for image, inside, since in zip(registration.images, registration.inside, registration.seconds, strict=True):
        of_image = list[Crossing]()
        for orbit in np.unique(orbits[inside | (since == 0.0)]):
            members = np.flatnonzero(orbits == orbit)
            within, along = members[inside[members]], members[since[members] == 0.0]
            near = within if within.size else along
            angles = registration.shots.off_nadir[near]
            of_image.append(Crossing(
                names[members[0]], image.name, members.size, within.size, along.size,
                float(since[near][np.argmin(np.abs(since[near]))]),
                float(np.nanmedian(angles)) if np.any(np.isfinite(angles)) else float("nan"),
                float(registration.shots.times[near].min()),
            ))  # fmt: skip
        all_crossings += sorted(of_image, key=lambda crossing: (not crossing.simultaneous, crossing.start))
    return tuple(all_crossings)


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
    >>> mgsgraph.points_in_images(network.images, solution.places).sum(axis=1)
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
    places, near = np.full((points.shape[0], 2), np.nan), _near(image, points, correction)
    projected, _ = image.ground_to_image(points[near], correction)
    way = image.pose(projected[:, 0], correction).position - points[near]
    facing = np.einsum("ni,ni->n", points[near], way) > 0.0
    places[near[facing]] = projected[facing]
    return places


def _near(image: PushbroomImage, points: Array, correction: OrientationCorrection | None) -> Index:
    """Points that are near the image's own ground."""
    edge = np.array([0.0, 0.5, 1.0])
    samples, lines = all_pairs(edge * image.samples, edge * image.lines).T
    ground, _ = image.image_to_ground(lines, samples, correction=correction)
    if not np.all(np.isfinite(ground)):
        return np.arange(len(points))
    centre = ground.mean(axis=0)
    reach = np.linalg.norm(ground - centre, axis=1).max() * 2.0 + _REACH  # places go on beyond the ends
    return np.flatnonzero(np.linalg.norm(points - centre, axis=1) < reach)


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
    projected, _ = image.ground_to_image(ground, correction, true_places[:, 0])
    chosen = np.flatnonzero(finite_rows(projected + true_places))
    off = projected[chosen] - true_places[chosen]
    metres = on_ground(image, projected[chosen], ground[chosen], correction)
    return Misregistration(
        image.name, "truth", chosen, true_places[chosen, 0], off, np.zeros_like(off),
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
    chosen = np.flatnonzero(_within(first, places[0]) & _within(second, places[1]))
    in_first, in_second = places[0, chosen], places[1, chosen]
    measured = _common_measures(pair, ties)
    heights = _tie_heights(pair, measured, corrections)
    surface, surface_sigma = _plane_heights(first, measured[0], heights, in_first)
    transferred, by_height = _transfer(pair, in_first, surface, corrections)
    over_ties, _ = _transfer(pair, measured[0], heights, corrections)
    misplaced, sigmas = _smooth(first, measured[0], measured[1] - over_ties, in_first)
    off = in_second - transferred - misplaced
    lifted = by_height * surface_sigma[:, None]
    metres = on_ground(second, in_second, ground[chosen], corrections[1])
    variance = np.einsum("nij,nj->ni", metres**2, sigmas**2) + np.einsum("nij,nj->ni", metres, lifted) ** 2
    return Misregistration(
        second.name, first.name, chosen, in_second[:, 0], off, np.hypot(sigmas, lifted),
        np.einsum("nij,nj->ni", metres, off), np.sqrt(variance), shots.spacing,
    )


def on_ground(
    image: PushbroomImage, places: Array, points: Array, correction: OrientationCorrection | None
) -> Array:
    """(n, 2, 2) metres along the flight and to its right per line and per sample, at the points' heights."""
    height = ellipsoidal_heights(points, image.body)
    _, to_ground = image.image_to_ground(places[:, 0], places[:, 1], height, correction)
    up = unit_vectors(points)
    flight = image.pose(places[:, 0], correction).velocity
    along = unit_vectors(flight - np.einsum("ni,ni->n", flight, up)[:, None] * up)
    return np.asarray(np.stack([along, np.cross(along, up)], axis=1) @ to_ground)


def _common_measures(pair: tuple[PushbroomImage, PushbroomImage], ties: TiePoints) -> tuple[Array, Array]:
    """Places (k, 2) in the first and in the second image of the ties measured in both."""
    number = ties.measure_image.over([image.name for image in pair])
    in_first, in_second = (np.flatnonzero(number == k) for k in range(2))
    _, i, j = np.intersect1d(ties.measure_point[in_first], ties.measure_point[in_second], return_indices=True)
    if i.size < 3:
        raise InputError(
            f"{ties.source}, images {pair[0].name} and {pair[1].name}", f"{i.size} common tie points",
            "at least 3", "measure tie points in both images: without them their discrepancy can't be known",
        )
    return ties.measures[in_first[i]], ties.measures[in_second[j]]


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
    return ellipsoidal_heights(points, pair[0].body)


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
    _, by_pixel = image.image_to_ground(*image.middle)
    size = np.linalg.norm(by_pixel[0], axis=0)  # m per line and per sample
    distance = np.hypot(down * size[0], across * size[1])
    count = min(_NEAREST, ties.shape[0])
    near = np.argsort(distance, axis=1)[:, :count]
    rows = np.arange(places.shape[0])[:, None]
    design = np.stack([np.ones_like(distance[rows, near]), down[rows, near], across[rows, near]], axis=2)
    design[:, :, 1:] *= size / 1e3  # km, so that the columns are of one size
    normal = design.mT @ design
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)  # ties in one line make no plane
    inverse = np.linalg.inv(normal)
    planes = np.einsum("nij,nkj,nk->ni", inverse, design, heights[near])
    rest = heights[near] - np.einsum("nki,ni->nk", design, planes)
    spread = np.sum(rest**2, axis=1) / (count - 3) if count > 3 else np.full(places.shape[0], np.nan)
    return planes[:, 0], np.sqrt(spread * (1.0 + inverse[:, 0, 0]))


def _smooth(image: PushbroomImage, ties: Array, misplacement: Array, places: Array) -> tuple[Array, Array]:
    """Misplacements (n, 2) in pixels at places, and their sigmas: polynomials fitted to those of the ties (k, 2)."""
    terms = _MISPLACEMENT_TERMS[: max(1, min(len(_MISPLACEMENT_TERMS), ties.shape[0] // 3))]

    def design(at: Array) -> Array:
        u, v = 2.0 * at[:, 0] / image.lines - 1.0, 2.0 * at[:, 1] / image.samples - 1.0
        return np.stack([u**p * v**q for p, q in terms], axis=1)

    rows = design(ties)
    inverse = np.linalg.pinv(rows.T @ rows)
    coefficients = inverse @ rows.T @ misplacement
    rest = misplacement - rows @ coefficients
    spread = np.sum(rest**2, axis=0) / (ties.shape[0] - len(terms))
    at = design(places)
    share = np.einsum("ni,ij,nj->n", at, inverse, at)
    return at @ coefficients, np.sqrt(share[:, None] * spread)
