"""Candidates: images, laser profiles and control points that might be observed, with the measures that they would get.

The measures are projections of planned positions with the network's adjusted orientation, so that the geometry, which
is all that a covariance needs, is that of real ones. Their residuals are zero.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.records import Array, Index, no_rows
from mgsgraph.names import Names, numbered
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, ProfileShifts, Ranges, Surface
from mgsgraph.network.joining import with_definitions
from mgsgraph.network.parts import KnownImage, image_columns, joined, select_points
from mgsgraph.planning.coverage import ImageCoverage, OrientedImage, even_places
from mgsgraph.planning.state import ReducedNetwork
from mgsgraph.record import Record

Kind = Literal["image", "profile", "control point", "tie point"]


@dataclass(frozen=True, slots=True, eq=False)
class Candidate(Record):
    """An image, laser profile or control point that might be observed."""

    name: str
    """Of the image, the profile or the control point."""
    kind: Kind
    """Kind of candidate."""
    addition: Network | None
    """The measures it would bring, points at their planned places; None where there are none."""
    reason: str = ""
    """Reason why it brings no measures."""
    images: tuple[str, ...] = ()
    """Images of the network in which it would be measured, or whose trajectory carries it."""
    overlap: float = float("nan")
    """m^2, area that an image has in common with images of the network, pair by pair; NaN for others."""

    @property
    def rays(self) -> int:
        """Number of image coordinates (pairs of line and sample) to measure."""
        return 0 if self.addition is None else int(self.addition.rays.point.size)

    @property
    def ranges(self) -> int:
        """Number of laser ranges."""
        return 0 if self.addition is None else int(self.addition.ranges.point.size)

    @property
    def measures(self) -> int:
        """Number of image coordinates and ranges."""
        return self.rays + self.ranges

    def __repr__(self) -> str:
        what = self.reason or f"{self.rays} image measures, {self.ranges} ranges"
        return f"Candidate({self.kind} {self.name!r}: {what})"


@dataclass(frozen=True, slots=True)
class PlannedTies:
    """Tie points that a candidate image would get."""

    count: int = 20
    """New ones in each overlap with an image of the network."""
    sigma: float = 1.0
    """px, of line and sample."""
    own_sigma: float | None = None
    """px, of those in the candidate itself; the same when absent."""
    existing: bool = False
    """Whether tie points of the network that it shows are measured in it, too."""


@dataclass(frozen=True, slots=True, eq=False)
class PlannedShots:
    """Laser shots of a candidate profile; n of them."""

    times: Array
    """(n,) s TDB past J2000."""
    footprints: Array
    """(n, 3) m, body-fixed."""
    image: str | None
    """Image whose trajectory carries the ranges; None for a profile without ranges."""
    range_sigmas: Array
    """(n,) m."""
    covariances: Array
    """(n, 3, 3) m^2, of the footprints."""
    shift_sigma: float | None = None
    """m, of a shift that they share; None for none."""
    image_sigma: float | None = None
    """px, of their places in the images that show them; None for no such measures."""


def planned_image(coverage: ImageCoverage, known: KnownImage, ties: PlannedTies) -> Candidate:
    """A candidate image with its tie points; images of the network in their order, and then the candidate."""
    name = known.image.name
    found = "a candidate that is an image of the network already"
    require(name not in coverage.views, f"candidate {name}", found, "a new image", "take it out of the candidates")
    view = coverage.new_image(known)
    near = coverage.overlapping(view)
    if not near:
        return Candidate(name, "image", None, "no overlap with an image of the network", overlap=0.0)
    area = sum(common for _, common in near)
    neighbors = [other for other, _ in near]
    parts = _new_ties(coverage, view, neighbors, ties), _existing_ties(coverage, view, ties)
    additions = [part for part in parts if part is not None]
    if not additions:
        reason = "no tie point can be placed where it overlaps: too little ground, or rays nearly parallel"
        return Candidate(name, "image", None, reason, overlap=area)
    addition = joined(additions)
    measured = {image.name for image in addition.images} - {name}
    return Candidate(name, "image", addition, "", tuple(v for v in coverage.views if v in measured), area)


def _new_ties(
    coverage: ImageCoverage, view: OrientedImage, near: Sequence[OrientedImage], ties: PlannedTies
) -> Network | None:
    """New tie points in the overlaps with the images near; None where there are none that their rays determine."""
    grids = [_tie_places(coverage, view, other, ties) for other in near]
    points = np.concatenate(grids)
    if points.shape[0] == 0:
        return None
    point, images, places = coverage.rays(points, [*near, view])
    ids = (f"{view.image.name}:tie:{k + 1}:{i + 1}" for k, grid in enumerate(grids) for i in range(len(grid)))
    rays = point, images, places, _sigmas(images, view, ties)
    network = _network(coverage, _points(ids, PointClass.TIE, points), rays, new_image=view.known)
    if network is None:
        return None
    determined = ReducedNetwork(network, coverage.state.settings, coverage.state.values, points).determined
    return select_points(network, np.flatnonzero(determined)) if np.any(determined) else None


def _tie_places(coverage: ImageCoverage, view: OrientedImage, other: OrientedImage, ties: PlannedTies) -> Array:
    """(n, 3) m, new tie points on an even grid over the overlap of two images."""
    small, large = sorted((view, other), key=lambda image: image.footprint.area)
    shape = (small.image.lines, small.image.samples)
    if not ties.count:
        return np.zeros((0, 3))
    shared = partial(coverage.common_ground, small, large, other.height)
    return shared(even_places(shape, lambda places: shared(places)[1], ties.count))[0]


def _existing_ties(coverage: ImageCoverage, view: OrientedImage, ties: PlannedTies) -> Network | None:
    """Tie points of the network that the candidate shows, each with its measure in it; None unless they're wanted."""
    if not ties.existing:
        return None
    network, state = coverage.network, coverage.state
    members = np.flatnonzero((network.points.classes == PointClass.TIE) & (network.ray_counts > 0))
    some, places = view.shown(state.places[members])
    if some.size == 0:
        return None
    old, n = members[some], some.size
    points = _points(network.points.ids[old], PointClass.TIE, state.places[old])
    names = [view.image.name] * n
    rays = np.arange(n), names, places, _sigmas(names, view, ties)
    return _network(coverage, points, rays, view.known, old=True)


def _sigmas(images: Sequence[str], view: OrientedImage, ties: PlannedTies) -> Array:
    own = ties.sigma if ties.own_sigma is None else ties.own_sigma
    column = np.where(np.array(images) == view.image.name, own, ties.sigma)
    return np.column_stack([column, column])


def planned_profile(coverage: ImageCoverage, name: str, shots: PlannedShots) -> Candidate:
    """A candidate laser profile: footprints known by their covariances, ranges, and image places if they are wanted."""
    n = shots.times.size
    if name in coverage.network.shift_names:
        raise InputError(f"candidate {name}", "a profile of the network", "a new profile", "give it another name")
    if n == 0:
        return Candidate(name, "profile", None, "no shot falls in an image of the network")
    ids = Names.of(f"{name}:{i + 1}" for i in range(n))
    _require_new(coverage, ids, name)
    points = _points(ids, PointClass.LASER, shots.footprints, shots.covariances)
    rays: _Rays = (no_rows(), [], np.zeros((0, 2)), np.zeros((0, 2)))
    if shots.image_sigma is not None:
        point, images, places = coverage.rays(shots.footprints, coverage.near(shots.footprints))
        rays = point, images, places, np.full(places.shape, shots.image_sigma)
    ranges: _Ranges | None = None
    if shots.image is not None:
        values = np.linalg.norm(coverage.views[shots.image].positions(shots.times) - shots.footprints, axis=1)
        ranges = np.arange(n), shots.image, shots.times, values, shots.range_sigmas
    shifts = None
    if shots.shift_sigma is not None:
        shifts = ProfileShifts((name,), np.zeros(n, dtype=np.int64), np.array([shots.shift_sigma]))
    addition = _network(coverage, points, rays, ranges=ranges, shifts=shifts)
    if addition is None:
        reason = "no image was taken along with it, and no image coordinates are planned (image_sigma_px)"
        return Candidate(name, "profile", None, reason)
    return Candidate(name, "profile", addition, "", tuple(image.name for image in addition.images))


def planned_point(
    coverage: ImageCoverage, name: str, place: Array, covariance: Array | None, sigma: float
) -> Candidate:
    """A candidate control point, or a tie point, measured in all images that show it.

    Parameters
    ----------
    coverage : ImageCoverage
        Of the network.
    name : str
        One that no point of the network has.
    place : (3,)
        m, body-fixed.
    covariance : (3, 3) or None
        m^2, of a control point; None for a tie point.
    sigma : float
        px, of its line and sample.

    Raises
    ------
    InputError
        If the network has a point of this name.

    Examples
    --------
    >>> coverage = mgsgraph.ImageCoverage(solution)
    >>> mgsgraph.planned_point(coverage, "rim", solution.places[0], np.eye(3), sigma=0.5)
    Candidate(control point 'rim': 2 image measures, 0 ranges)
    """
    _require_new(coverage, (name,), name)
    point, images, places = coverage.rays(place[None], coverage.near(place[None]))
    kind: Kind = "tie point" if covariance is None else "control point"
    if len(images) < (2 if covariance is None else 1):
        few = "fewer than two images of the network show it"
        few = few if covariance is None else "no image of the network shows it"
        return Candidate(name, kind, None, few, tuple(images))
    covariances = None if covariance is None else covariance[None]
    points = _points([name], PointClass.TIE if covariances is None else PointClass.CONTROL, place[None], covariances)
    addition = _network(coverage, points, (point, images, places, np.full(places.shape, sigma)))
    return Candidate(name, kind, addition, "", tuple(images))


def require_candidates(where: str, names: Sequence[str]) -> None:
    """Raise InputError for no candidate, and for a name given twice."""
    require(names, where, "no candidate", "at least one image, profile or control point")
    for name in sorted({candidate for candidate in names if names.count(candidate) > 1})[:1]:
        raise InputError(where, f"two candidates named {name!r}", "each name once")


def _points(ids: Iterable[str], kind: PointClass, places: Array, covariances: Array | None = None) -> GroundPoints:
    """Points at places (n, 3) in m: constrained with their covariances (n, 3, 3) in m^2, free without."""
    n, constrained = places.shape[0], PointKind.FREE if covariances is None else PointKind.CONSTRAINED
    given = np.zeros((n, 3, 3)) if covariances is None else covariances
    return GroundPoints(Names.of(ids), np.full(n, int(kind)), np.full(n, int(constrained)), places, given)


def _require_new(coverage: ImageCoverage, ids: Sequence[str], name: str) -> None:
    present = set(coverage.network.points.ids)
    for point_id in ids:
        found = f"the point {point_id!r}, which is in the network already"
        require(point_id not in present, f"candidate {name}", found, "a new point", "give it another name")


_Rays = tuple[Index, Sequence[str], Array, Array]
"""Point (k,), image, place (k, 2) and sigma (k, 2) of image rays."""
_Ranges = tuple[Index, str, Array, Array, Array]
"""Point (r,), image of all, time (r,), value (r,) and sigma (r,) of ranges."""


def _network(
    coverage: ImageCoverage, points: GroundPoints, rays: _Rays, new_image: KnownImage | None = None,
    ranges: _Ranges | None = None, shifts: ProfileShifts | None = None, old: bool = False,
) -> Network | None:  # fmt: skip
    """Points with their rows and the images that they name; None without any row. `old` points have their
    terrain rows already.
    """
    point, names, places, sigmas = rays
    used = {*names, *([ranges[1]] if ranges else [])}
    if not used:
        return None
    images = [view.known for name, view in coverage.views.items() if name in used]
    images += [new_image] if new_image is not None and new_image.image.name in used else []
    number = numbered(image.image.name for image in images)
    shots = Ranges.none()
    if ranges is not None:
        shots = Ranges(ranges[0], np.full(ranges[0].size, number[ranges[1]]), *ranges[2:])
    image = np.array([number[name] for name in names], dtype=np.int64)
    network = Network(*image_columns(images), points, ImageRays(point, image, places, sigmas), shots, shifts)
    network = with_definitions(network, coverage.definitions)
    if old:
        return network
    considered = (*coverage.network.considered, *network.considered)
    return replace(network, surface=_surface(coverage, points)).considering(dict.fromkeys(considered))


def _surface(coverage: ImageCoverage, points: GroundPoints) -> Surface | None:
    """New tie points on the network's terrain model, as its own are."""
    surface = coverage.network.surface
    if surface is None:
        return None
    over = np.isfinite(surface.grid.at(points.places)) & (points.classes == PointClass.TIE)
    finite = surface.sigmas[np.isfinite(surface.sigmas)]
    if not (np.any(over) and finite.size):
        return None
    return replace(surface, sigmas=np.where(over, np.median(finite), np.inf))
