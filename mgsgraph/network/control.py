"""Control that lies between measurements: points on the surfaces that pairs of images show, and crossovers of laser
profiles.

A row of a crossover is the height of the first profile minus that of the second where they cross, which is zero within
its sigma. It takes the shots as they were measured, and not the network's points: what interpolation between them
misses, is mostly more than their own noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.crossovers import crossing, gradient
from mgsgraph.geometry.records import Array, Index, Mask, assign, frozen, frozen_index
from mgsgraph.geometry.stereo_surface import StereoSurface
from mgsgraph.network.records import GroundPoints, PointClass, ProfileShifts
from mgsgraph.record import Record


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
        left = ~np.any(out[self.shots], axis=1)
        parts = (getattr(self, name)[left] for name in self.__slots__)
        return Crossovers(*parts) if np.any(left) else None

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
    used = np.concatenate([np.zeros(0, dtype=np.int64), *members])
    places = points.places.copy()
    ways = east_north_up(places[used])[:, :2]
    places[used] += np.einsum("nk,nkj->nj", moved[shifts.profile[used]], ways)
    boxes = [(places[mine].min(axis=0), places[mine].max(axis=0)) if mine.size else None for mine in members]
    rows = list[tuple[Index, Array, Array, Array, float]]()
    for k, other in combinations(range(len(members)), 2):
        one, two = boxes[k], boxes[other]
        if one is None or two is None or np.any(one[0] > two[1]) or np.any(two[0] > one[1]):
            continue
        noise = float(np.median(sigmas[members[k]])), float(np.median(sigmas[members[other]]))
        found = crossing(places[members[k]], places[members[other]], noise)
        if found is not None:
            shots = np.concatenate([members[k][found[0].shots], members[other][found[1].shots]])
            shares = np.concatenate([found[0].shares, -found[1].shares])
            slope, doubt = gradient(found), shifts.sigmas[[k, other]][unsure[[k, other]]]
            vague = float(np.linalg.norm(slope) * np.linalg.norm(doubt))
            sigma = float(np.linalg.norm(np.array([found[0].sigma, found[1].sigma, vague])))
            rows.append((shots, shares, slope * (not doubt.size), moved[k] - moved[other], sigma))
    return _as_record(rows) if rows else None


def _as_record(rows: Sequence[tuple[Index, Array, Array, Array, float]]) -> Crossovers:
    shots, shares, gradients, about, sigmas = zip(*rows, strict=True)
    return Crossovers(np.array(shots), np.array(shares), np.array(gradients), np.array(about), np.array(sigmas))


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
        mine = self.surface[points]
        kept, inside = np.unique(mine[mine >= 0], return_inverse=True)
        if not kept.size:
            return None
        surface = np.full(mine.size, -1)
        surface[mine >= 0] = inside
        rejected, level = (None if one is None else one[points] for one in (self.rejected, self.level))
        starts = None if self.starts is None else self.starts[points]
        shown = tuple(self.surfaces[s] for s in kept.tolist())
        return StereoControl(shown, self.images[kept], surface, self.sigmas[points], starts, rejected, level)

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
        for one, pair in zip(control.surfaces, control.images, strict=True):
            if id(one) not in number:
                number[id(one)] = len(surfaces)
                surfaces.append(one)
                images.append(image[pair])
        on = np.flatnonzero(control.surface >= 0)
        own = np.array([number[id(one)] for one in control.surfaces])
        surface[place[on]], sigmas[place[on]] = own[control.surface[on]], control.sigmas[on]
        starts[place[on]] = np.nan if control.starts is None else control.starts[on]
        rejected[place[on]] = control.rejected is not None and control.rejected[on]
        level[place[on]] = control.level is not None and control.level[on]
    if not surfaces:
        return None
    return StereoControl(tuple(surfaces), np.array(images), surface, sigmas, starts, rejected, level)
