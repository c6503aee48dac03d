"""Crossovers of laser profiles as rows on what their shots have in common: the profiles' shifts and heights.

A row is the height of the first profile minus that of the second where they cross, which is zero within its sigma. It
takes the shots as they were measured, and not the network's points: what interpolation between them misses, is
mostly more than their own noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.crossovers import crossing, gradient
from mgsgraph.geometry.records import Array, Index, Mask, assign, frozen, frozen_index
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
