"""What a network is made of: points, rays, ranges, shifts, terrain. Struct of arrays, SI units, body-fixed metres."""

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.tie_points import PointKind
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.records import (
    Array,
    Index,
    Mask,
    assign,
    frozen,
    frozen_index,
    of_kind,
    require_covariances,
    require_names,
)
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.names import Names
from mgsgraph.record import Record


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
    """(n, 3, 3) m^2, of the a-priori places of constrained points; zero elsewhere."""

    def __post_init__(self) -> None:
        assign(self, ids=Names.of(self.ids, "ground points"))
        n = len(self.ids)
        require_names(self.ids, "ground points")
        kinds = frozen_index(self.kinds, "ground points, kinds", n, len(PointKind))
        places = of_kind(self.places, np.float64)
        if places.shape != (n, 3):
            raise InputError("ground points, places", f"an array of shape {places.shape}", f"shape ({n}, 3)")
        for i in np.flatnonzero(np.any(np.isinf(places), axis=1))[:1]:
            raise InputError(f"ground point {self.ids[i]}", "an infinite place", "metres, or NaN where unknown")
        known = np.all(np.isfinite(places), axis=1)
        for i in np.flatnonzero((kinds != PointKind.FREE) & ~known)[:1]:
            raise InputError(f"ground point {self.ids[i]}", "no a-priori place", "one for a constrained or fixed point")
        covariances = frozen(self.covariances, "ground points, covariances", (n, 3, 3))
        require_covariances(covariances, kinds == PointKind.CONSTRAINED, self.ids, "ground points")
        places.flags.writeable = False
        classes = frozen_index(self.classes, "ground points, classes", n, len(PointClass))
        assign(self, classes=classes, kinds=kinds, places=places, covariances=covariances)

    def __len__(self) -> int:
        return len(self.ids)


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

    def chosen(self, rows: Index | Mask) -> "Ranges":
        """Some of them."""
        return Ranges(
            self.point[rows], self.image[rows], self.times[rows], self.values[rows], self.sigmas[rows],
            _chosen(self.rejected, rows),
        )  # fmt: skip


def _chosen(marks: Mask | None, rows: Index | Mask) -> Mask | None:
    return None if marks is None else marks[rows]


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
        every = (*_horizontal(self.shift_sigma), ShiftTerm("upward shift", "m", self.height_sigma))
        tilts = (ShiftTerm(f"tilt about {way}", "rad", self.tilt_sigma) for way in ("east", "north"))
        return tuple(term for term in (*every, *tilts) if term.sigma > 0.0)

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
