"""What a network is made of: points, rays, ranges, shifts, terrain. Struct of arrays, SI units, body-fixed metres.

Control that lies between measurements: points on the surfaces that pairs of images show, and crossovers of laser
profiles.

A row of a crossover is the height of the first profile minus that of the second where they cross, which is zero within
its sigma. It takes the shots as they were measured, and not the network's points: what interpolation between them
misses, is mostly more than their own noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from itertools import combinations
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError, require
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import east_north, east_north_up
from mgsgraph.geometry.intersection import crossing, gradient
from mgsgraph.geometry.records import (
    Array,
    Index,
    Mask,
    assign,
    finite_rows,
    frozen,
    frozen_index,
    joined_rows,
    of_kind,
    require_covariances,
    require_names,
)
from mgsgraph.geometry.stereo_surface import StereoSurface
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.names import Names
from mgsgraph.record import Record

_Scalar = TypeVar("_Scalar", bound=np.generic)


class PointClass(IntEnum):
    """What a ground point came from."""

    TIE = 0
    """Tie point."""
    LASER = 1
    """Laser footprint."""
    CONTROL = 2
    """Ground control point."""
    POST = 3
    """Post of a terrain model."""

    @property
    def measured(self) -> bool:
        """Whether such points are measured in images."""
        return self is not PointClass.POST


@dataclass(frozen=True, slots=True, eq=False)
class GroundPoints(Record):
    """All ground points of a network.

    Examples
    --------
    >>> from mgsgraph.network import PointClass
    >>> points = network.points
    >>> len(points), points.ids[0], int(np.sum(points.classes == PointClass.LASER))
    (28, 'TIE00001', 8)
    """

    ids: Names
    """(n) names, each once; made of any sequence of them."""
    classes: Index
    """(n,) PointClass."""
    kinds: Index
    """(n,) PointKind."""
    places: Array
    """(n, 3) m, body-fixed, a-priori; NaN where unknown."""
    covariances: Array
    """(n, 3, 3) m^2, of the a-priori places of constrained points and of known places of checkpoints
    (`checkpoints`); zero elsewhere."""

    def __post_init__(self) -> None:
        assign(self, ids=Names.of(self.ids, "ground points"))
        n = len(self.ids)
        require_names(self.ids, "ground points")
        kinds = frozen_index(self.kinds, "ground points, kinds", n, len(PointKind))
        places = of_kind(self.places, np.float64)
        require(places.shape == (n, 3), "ground points, places", f"an array of shape {places.shape}", f"shape ({n}, 3)")
        for i in np.flatnonzero(np.any(np.isinf(places), axis=1))[:1]:
            raise InputError(f"ground point {self.ids[i]}", "an infinite place", "metres, or NaN where unknown")
        located = finite_rows(places)
        for i in np.flatnonzero((kinds != PointKind.FREE) & ~located)[:1]:
            raise InputError(f"ground point {self.ids[i]}", "no a-priori place", "one for a constrained or fixed point")
        covariances = frozen(self.covariances, "ground points, covariances", (n, 3, 3))
        require_covariances(covariances, kinds == PointKind.CONSTRAINED, self.ids, "ground points")
        places.flags.writeable = False
        classes = frozen_index(self.classes, "ground points, classes", n, len(PointClass))
        assign(self, classes=classes, kinds=kinds, places=places, covariances=covariances)

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def checkpoints(self) -> Index:
        """(c,) ground control points whose known places and covariances check the adjustment and take no part in it:
        free ones.
        """
        free_control = (self.classes == PointClass.CONTROL) & (self.kinds == PointKind.FREE)
        return np.flatnonzero(free_control & np.isfinite(self.places[:, 0]))


@dataclass(frozen=True, slots=True, eq=False)
class ImageRays(Record):
    """Image coordinates of points: one ray each.

    Examples
    --------
    >>> rays = network.rays
    >>> seen = rays.image == network.image_number("SIM/B")
    >>> rays.places[seen].shape, rays.sigmas[seen].max().item()
    ((28, 2), 5.0)
    """

    point: Index
    """(k,) ground point."""
    image: Index
    """(k,) image."""
    places: Array
    """(k, 2) pixels, line and sample."""
    sigmas: Array
    """(k, 2) pixels, positive."""
    back_projected: Mask | None = None
    """(k,) True for places that are projections with the nominal orientation: they repeat the prior as if measured."""
    rejected: Mask | None = None
    """(k,) True for blunders of the last batch adjustment: incremental ones leave them out, batch judges anew."""

    def chosen(self, rows: Index | Mask) -> "ImageRays":
        """Some of them."""
        return ImageRays(
            self.point[rows], self.image[rows], self.places[rows], self.sigmas[rows],
            _chosen(self.back_projected, rows), _chosen(self.rejected, rows),
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Ranges(Record):
    """Laser ranges, each from the place of one image's camera at the shot's time.

    Examples
    --------
    >>> ranges = network.ranges
    >>> ranges.values.round(0)[:2], ranges.sigmas[:2]
    (array([379872., 379951.]), array([1., 1.]))
    """

    point: Index
    """(r,) ground point."""
    image: Index
    """(r,) image whose orientation carries the range."""
    times: Array
    """(r,) s TDB past J2000."""
    values: Array
    """(r,) m, one-way."""
    sigmas: Array
    """(r,) m, positive."""
    rejected: Mask | None = None
    """(r,) True for blunders of the last batch adjustment, as for rays."""
    shares: Array | None = None
    """(r, 3) m per m, how much of the error of its point's a-priori position each has, too
    (`LaserProfile.shares`); `sigmas` are then of the rest."""

    @staticmethod
    def none() -> "Ranges":
        """No range."""
        return Ranges(*np.zeros((2, 0), dtype=np.int64), *np.zeros((3, 0)))

    def chosen(self, rows: Index | Mask) -> "Ranges":
        """Some of them."""
        return Ranges(
            self.point[rows], self.image[rows], self.times[rows], self.values[rows], self.sigmas[rows],
            _chosen(self.rejected, rows), _chosen(self.shares, rows),
        )  # fmt: skip


    def in_common(self, points: GroundPoints) -> tuple[Array, Array]:
        """Covariances (r, 3) of the error in common with the errors of their points, and what of their variances (r,)
        these know of, m^2.
        """
        shares = np.zeros((self.point.size, 3)) if self.shares is None else self.shares
        both = np.einsum("rij,rj->ri", points.covariances[self.point], shares)
        return both, np.asarray(np.einsum("ri,ri->r", both, shares))

    def independent(self, points: GroundPoints) -> tuple[GroundPoints, "Ranges"]:
        """Points and ranges with the variance of the error in common twice in each, for rows that count as
        independent.
        """
        if self.shares is None:
            return points, self
        both, known = self.in_common(points)
        size, covariances = np.linalg.norm(both, axis=1), points.covariances.copy()
        beams = both / np.where(size > 0.0, size, 1.0)[:, None]
        np.add.at(covariances, self.point, both[:, :, None] * beams[:, None])
        sigmas = np.sqrt(self.sigmas**2 + known + size)
        return replace(points, covariances=covariances), replace(self, sigmas=sigmas, shares=None)


def _chosen(values: NDArray[_Scalar] | None, rows: Index | Mask) -> NDArray[_Scalar] | None:
    return None if values is None else values[rows]


HELD = 1e-4
"""A-priori sigmas to which a considered unknown is held: it moves by 1e-8 of what the observations would have it."""
TERRAIN = "terrain model"
"""Name of the shift of the terrain model on which tie points lie."""


class ShiftTerm(NamedTuple):
    """One unknown of a laser profile's shift, or of where the terrain model is."""

    name: str
    """What it is, as "east shift"."""
    unit: str
    """m or rad."""
    sigma: float
    """A-priori, in that unit."""
    horizontal: bool = False
    """Whether it is eastward or northward."""


def _horizontal(sigma: float) -> tuple[ShiftTerm, ...]:
    return tuple(ShiftTerm(f"{way} shift", "m", sigma, True) for way in ("east", "north"))


@dataclass(frozen=True, slots=True, eq=False)
class ProfileShifts(Record):
    """Unknown horizontal shifts, one per laser profile: to be added to its footprints' a-priori places."""

    names: tuple[str, ...]
    """(p,) profiles."""
    profile: Index
    """(n,) profile of each ground point; -1 for none. Its points are constrained."""
    sigmas: Array
    """(p,) m, a-priori, eastward and northward alike."""

    @property
    def terms(self) -> tuple[tuple[ShiftTerm, ...], ...]:
        """(p) the two unknowns of each."""
        return tuple(_horizontal(sigma) for sigma in self.sigmas.tolist())


@dataclass(frozen=True, slots=True, eq=False)
class Surface(Record):
    """A terrain model as control: chosen points lie on it.

    Examples
    --------
    >>> from mgsgraph.geometry.terrain import TerrainGrid
    >>> from mgsgraph.network import Surface
    >>> step = np.radians(0.5)
    >>> plain = TerrainGrid("a plain", np.full((9, 9), 3_390_000.0), np.radians(85.0), np.radians(6.0), step, step)
    >>> surface = Surface(plain, np.full(len(network.points), 20.0), shift_sigma=100.0, height_sigma=10.0)
    >>> [term.name for term in surface.terms]
    ['east shift', 'north shift', 'upward shift']
    """

    grid: TerrainGrid
    """Radii."""
    sigmas: Array
    """(n,) m, of each point's height above the terrain; infinite for points without such a row."""
    shift_sigma: float = 0.0
    """m, a-priori sigma of the model's own horizontal place, eastward and northward alike: an unknown that all its
    points share; 0 for none."""
    height_sigma: float = 0.0
    """m, the same of its height: an unknown upward shift; 0 for none."""
    tilt_sigma: float = 0.0
    """rad, the same of its tilt about the axes eastward and northward through `middle`; 0 for none."""
    middle: Array | None = None
    """(3,) m, body-fixed, about which it tilts; of no meaning without a tilt."""

    def __post_init__(self) -> None:
        for name in ("shift_sigma", "height_sigma", "tilt_sigma"):
            value, where = getattr(self, name), f"surface, {name.replace('_', ' ')}"
            if not (np.isfinite(value) and value >= 0.0):
                unit = "rad" if name == "tilt_sigma" else "m"
                raise InputError(where, f"{value} {unit}", "a positive number, or 0")
        if self.middle is not None:
            assign(self, middle=frozen(self.middle, "surface, middle", (3,)))
        if self.tilt_sigma and (self.middle is None or not np.any(self.middle)):
            raise InputError("surface, tilt sigma", "a tilt without a place", "the middle of the points, for its axes")

    @property
    def terms(self) -> tuple[ShiftTerm, ...]:
        """Unknowns of the model itself, in the order of its variable's columns; none where it stays as it is."""
        shifts = (*_horizontal(self.shift_sigma), ShiftTerm("upward shift", "m", self.height_sigma))
        tilts = (ShiftTerm(f"tilt about {way}", "rad", self.tilt_sigma) for way in ("east", "north"))
        return tuple(term for term in (*shifts, *tilts) if term.sigma > 0.0)

    def scaled(self, heights: Array, own: Array) -> "Surface":
        """With the sigmas of its rows times factors (n,), those of its own unknowns times factors (w,)."""
        factor = {term.name: value for term, value in zip(self.terms, own.tolist(), strict=True)}
        return replace(
            self,
            sigmas=self.sigmas * heights,
            shift_sigma=self.shift_sigma * factor.get("east shift", 1.0),
            height_sigma=self.height_sigma * factor.get("upward shift", 1.0),
            tilt_sigma=self.tilt_sigma * factor.get("tilt about east", 1.0),
        )

    @property
    def raised(self) -> bool:
        """Whether its height or its tilt is unknown."""
        return self.height_sigma > 0.0 or self.tilt_sigma > 0.0

    def directions(self, places: Array) -> Array:
        """(n, w, 3) m per m and per rad: how the model moves at places (n, 3) in m with each of its w unknowns; upward
        nothing at a place of zeros, as points have that nothing determines.
        """
        parts = [east_north(places)] if self.shift_sigma else []
        if self.height_sigma:
            size = np.maximum(np.linalg.norm(places, axis=1), 1.0)
            parts.append((places / size[:, None])[:, None])
        if self.tilt_sigma:
            assert self.middle is not None
            about = east_north(self.middle[None])[0]
            parts.append(np.cross(about, (places - self.middle)[:, None]))
        return np.concatenate(parts, axis=1) if parts else np.zeros((places.shape[0], 0, 3))

    def moved(self, places: Array, values: Array) -> Array:
        """(n, 3) m by which values (w,) of its unknowns move the model at places (n, 3) in m."""
        return np.asarray(np.einsum("k,nkj->nj", values, self.directions(places)))


@dataclass(frozen=True, slots=True, eq=False)
class LinearRows(Record):
    """Whitened rows sum_v blocks[v] x_v - target on unknowns that points share."""

    variables: tuple[int, ...]
    """Of the network: images, shifts, shared unknowns, orientation images, counted in this order."""
    blocks: tuple[Array, ...]
    """Of each a matrix (rows, width), per m or rad."""
    target: Array
    """(rows,)"""


@dataclass(frozen=True, slots=True, eq=False)
class Crossovers(Record):
    """Crossovers between profiles of unknown shift: m rows."""

    shots: Index
    """(m, 4) ground points: before and after the crossing, of the first profile and of the second."""
    shares: Array
    """(m, 4) of their heights in the difference; those of the second profile are negative."""
    gradients: Array
    """(m, 2) m per m, the ground's slope east and north."""
    about: Array
    """(m, 2) m, east and north: shift of the first profile minus that of the second, by which the crossing was
    found."""
    sigmas: Array
    """(m,) m, of the difference."""

    def __post_init__(self) -> None:
        m = len(self.shots)
        assign(self, shots=frozen_index(self.shots, "crossovers, shots", 4 * m, 2**31).reshape(m, 4))
        for name, shape in (("shares", (m, 4)), ("gradients", (m, 2)), ("about", (m, 2)), ("sigmas", (m,))):
            assign(self, **{name: frozen(getattr(self, name), f"crossovers, {name}", shape)})

    def without(self, out: Mask) -> "Crossovers | None":
        """Those on which none of some ground points (n,) lies; None without any."""
        remaining = ~np.any(out[self.shots], axis=1)
        parts = (getattr(self, name)[remaining] for name in self.__slots__)
        return Crossovers(*parts) if np.any(remaining) else None

    def profiles(self, shifts: ProfileShifts) -> Index:
        """(m, 2) which cross."""
        return shifts.profile[self.shots[:, ::2]]

    def differences(self, places: Array) -> Array:
        """(m,) m, of the heights of shots at places (n, 3) in m, without anything that moves them."""
        heights = np.einsum("mk,mk->m", self.shares, np.linalg.norm(places[self.shots], axis=2))
        return np.asarray(heights + np.einsum("mk,mk->m", self.gradients, self.about))

    def effect(self, places: Array, motion: Array) -> Array:
        """(m, ...) m by which motions (m, 4, 3, ...) of the shots, at places (n, 3) in m, change the differences."""
        ways = east_north_up(places[self.shots.ravel()]).reshape(*self.shots.shape, 3, 3)
        rise = ways[:, :, 2] - np.einsum("mc,mkcj->mkj", self.gradients, ways[:, :, :2])
        return np.asarray(np.einsum("mk,mkj,mkj...->m...", self.shares, rise, motion))


def crossovers(
    points: GroundPoints, shifts: ProfileShifts, moved: Array, sigmas: Array, unsure: Mask
) -> Crossovers | None:
    """Where profiles of laser shots cross; None where none do.

    Parameters
    ----------
    points : GroundPoints
        With the shots, at their a-priori places.
    shifts : ProfileShifts
        Their profiles.
    moved : (k, 2)
        m, east and north: how far each of the first k profiles is thought to lie from there.
    sigmas : (n,)
        m, of the heights of the shots.
    unsure : (k,)
        Profiles of which nobody knows where within the sigmas of their shifts they lie: their crossovers say something
        of heights alone, as if the ground were level, within what its slope makes of these sigmas.
    """
    laser = points.classes == PointClass.LASER
    members = [np.flatnonzero((shifts.profile == p) & laser) for p in range(len(moved))]
    used = joined_rows(members)
    places = points.places.copy()
    ways = east_north_up(places[used])[:, :2]
    places[used] += np.einsum("nk,nkj->nj", moved[shifts.profile[used]], ways)
    boxes = [(places[part].min(axis=0), places[part].max(axis=0)) if part.size else None for part in members]
    rows = list[tuple[Index, Array, Array, Array, float]]()
    for k, m in combinations(range(len(members)), 2):
        box, second_box = boxes[k], boxes[m]
        if box is None or second_box is None or np.any(box[0] > second_box[1]) or np.any(second_box[0] > box[1]):
            continue
        noise = float(np.median(sigmas[members[k]])), float(np.median(sigmas[members[m]]))
        pair = crossing(places[members[k]], places[members[m]], noise)
        if pair is not None:
            shots = np.concatenate([members[k][pair[0].shots], members[m][pair[1].shots]])
            shares = np.concatenate([pair[0].shares, -pair[1].shares])
            slope, doubt = gradient(pair), shifts.sigmas[[k, m]][unsure[[k, m]]]
            vague = float(np.linalg.norm(slope) * np.linalg.norm(doubt))
            sigma = float(np.linalg.norm(np.array([pair[0].sigma, pair[1].sigma, vague])))
            rows.append((shots, shares, slope * (not doubt.size), moved[k] - moved[m], sigma))
    return Crossovers(*map(np.array, zip(*rows, strict=True))) if rows else None


@dataclass(frozen=True, slots=True, eq=False)
class StereoControl(Record):
    """Surfaces that pairs of images show, and points that lie on them: laser shots, posts of terrain models."""

    surfaces: tuple[StereoSurface, ...]
    """Each averaged over the footprint of its points."""
    images: Index
    """(s, 2) first and second image of each surface."""
    surface: Index
    """(n,) surface of each ground point; -1 for none."""
    sigmas: Array
    """(n,) m, of each point's height above its surface, along the normal; of no meaning for points on none."""
    starts: Array | None = None
    """(n, 3) m, body-fixed, where a search has found the points to lie: their rows begin there. NaN, or None,
    for the a-priori positions."""
    rejected: Mask | None = None
    """(n,) True for heights that are blunders of the last batch adjustment, as for rays."""
    level: Mask | None = None
    """(n,) points whose height counts as if the ground were level, so that relief moves nothing horizontally: those
    whose horizontal position the search has not found, or not yet. None for none."""

    def chosen(self, points: Index) -> "StereoControl | None":
        """Some points (n,) and the surfaces on which they lie, the images' numbers kept; None where there are none."""
        surfaces = self.surface[points]
        present, inside = np.unique(surfaces[surfaces >= 0], return_inverse=True)
        if not present.size:
            return None
        surface = np.full(surfaces.size, -1)
        surface[surfaces >= 0] = inside
        rejected, level = (None if values is None else values[points] for values in (self.rejected, self.level))
        starts = None if self.starts is None else self.starts[points]
        shown = tuple(self.surfaces[s] for s in present.tolist())
        return StereoControl(shown, self.images[present], surface, self.sigmas[points], starts, rejected, level)

    def without(self, images: Mask) -> "StereoControl":
        """The same with no point on the surfaces that some images (m,) show."""
        lost = np.append(np.any(images[self.images], axis=1), False)
        return replace(self, surface=np.where(lost[self.surface], -1, self.surface))


def joined_control(
    controls: Sequence[StereoControl | None], place_of: Sequence[Index], image_of: Sequence[Index], count: int
) -> StereoControl | None:
    """Several as one, where the same record is the same surface.

    Parameters
    ----------
    controls : sequence
        Of several networks.
    place_of, image_of : sequence of (n,), (m,)
        Where the points and the images of each come to be.
    count : int
        Points in all.
    """
    number, surfaces, images = dict[int, int](), list[StereoSurface](), list[Index]()
    surface, sigmas = np.full(count, -1), np.full(count, np.inf)
    starts = np.full((count, 3), np.nan)
    rejected, level = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    for control, place, image in zip(controls, place_of, image_of, strict=True):
        if control is None:
            continue
        for record, pair in zip(control.surfaces, control.images, strict=True):
            if id(record) not in number:
                number[id(record)] = len(surfaces)
                surfaces.append(record)
                images.append(image[pair])
        on = np.flatnonzero(control.surface >= 0)
        numbers = np.array([number[id(record)] for record in control.surfaces])
        surface[place[on]], sigmas[place[on]] = numbers[control.surface[on]], control.sigmas[on]
        starts[place[on]] = np.nan if control.starts is None else control.starts[on]
        rejected[place[on]] = control.rejected is not None and control.rejected[on]
        level[place[on]] = control.level is not None and control.level[on]
    if not surfaces:
        return None
    return StereoControl(tuple(surfaces), np.array(images), surface, sigmas, starts, rejected, level)
