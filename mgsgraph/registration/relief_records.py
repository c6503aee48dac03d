"""What a registration by relief says: its choices, and each laser profile and terrain model against the surface
that the images show, before and after the adjustment with stereo rows.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.stereo_surface import SurfaceHeights
from mgsgraph.network import PointClass
from mgsgraph.record import Record
from mgsgraph.registration.search import REACH, CostSurface

MOST_REACH = 20_000.0
"""m, up to which shifts may be searched: images are a few kilometres wide."""


@dataclass(frozen=True, slots=True)
class ReliefSettings(Record):
    """How laser and images are registered by relief.

    Examples
    --------
    >>> settings = mgsgraph.ReliefSettings(reach=500.0, terrain="spline")
    >>> settings.reach, settings.crossovers
    (500.0, True)
    """

    footprint: float | None = None
    """m, diameter on the ground of all shots; that of each profile's altimeter (`Case.footprints`) when None."""
    reach: float = REACH
    """m, up to which shifts are searched."""
    spacing: float | None = None
    """m between dense matches; a quarter of the smallest footprint when None, but not less than the matching's own."""
    images: tuple[str, ...] = ()
    """Names of those to match; all of the case when empty."""
    terrain: Literal["cells", "spline"] = "cells"
    """Posts of terrain models lie on the surface that the images show, or tie points stay on the surface of those
    of the first model, as in an adjustment without relief."""
    crossovers: bool = True
    """Where two laser profiles cross, their heights agree."""

    def __post_init__(self) -> None:
        for name, value in (("footprint", self.footprint), ("reach", self.reach), ("spacing", self.spacing)):
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise InputError(f"registration by relief, {name}", f"{value} m", "a positive number")
        if self.reach > MOST_REACH:
            found, most = f"shifts up to {self.reach:g} m", f"{MOST_REACH:g} m at most"
            raise InputError("registration by relief, reach", found, most, "mend the orientation or the profiles first")


class ProfileState(NamedTuple):
    """A laser profile and the surface by one orientation of the images; n shots."""

    points: Array
    """(n, 3) m, body-fixed, of the footprints."""
    heights: SurfaceHeights
    """Of the footprints above the surface."""
    cost: CostSurface
    """Misfit over shifts of the profile from here: its minimum is at zero where images and laser agree."""

    @property
    def misplacement(self) -> Array:
        """(2,) m east and north, by which the profile has to move onto the surface; NaN where relief doesn't tie it."""
        return self.cost.minima[0].shift if self.cost.tied else np.full(2, np.nan)

    @property
    def misplacement_covariance(self) -> Array:
        """(2, 2) m^2, of the misplacement: that of all possible minima about the likeliest, by their weights; NaN where
        relief doesn't tie the profile.
        """
        if not self.cost.tied:
            return np.full((2, 2), np.nan)
        weights = np.array([one.weight for one in self.cost.possible])
        off = np.array([one.shift for one in self.cost.possible]) - self.misplacement
        each = np.array([one.covariance for one in self.cost.possible]) + off[:, :, None] * off[:, None]
        return np.asarray(np.einsum("k,kij->ij", weights / weights.sum(), each))


@dataclass(frozen=True, slots=True, eq=False)
class ReliefProfile(Record):
    """One laser profile, or one terrain model, against the stereo surface.

    Examples
    --------
    >>> profile = registration.profiles[0]
    >>> print(f"{profile.taken.sum()} shots: {profile.rms_before:.0f} m before, {profile.rms_after:.1f} m after")
    114 shots: 839 m before, 1.0 m after
    >>> np.sqrt(np.diagonal(profile.covariance)).round(1)
    array([62.5, 62.6])
    """

    name: str
    """Of the profile or the model."""
    point_class: PointClass
    """What it consists of: laser shots, or posts."""
    mine: Index
    """(n,) its points in the network, in the order of their times."""
    taken: Mask
    """(n,) whether they lie on the surface and take part."""
    sigmas: Array
    """(n,) m, of the heights above the surface, along its normal; of no meaning for shots that don't take part."""
    before: ProfileState
    """By the adjustment without stereo rows: its orientation, the footprints where it shifts the profile."""
    after: ProfileState
    """The same by the adjustment with them."""
    shift: Array
    """(2,) m east and north, adjusted."""
    covariance: Array
    """(2, 2) m^2, of the shift."""

    @property
    def of_posts(self) -> bool:
        """Whether it is a terrain model."""
        return self.point_class is PointClass.POST

    @property
    def unit(self) -> str:
        """What one of its points is called."""
        return "post" if self.of_posts else "shot"

    @property
    def rms_before(self) -> float:
        """m, of the heights of the shots above the surface, before."""
        return _rms(self.before.heights, self.taken)

    @property
    def rms_after(self) -> float:
        """m, of the heights of the shots above the surface, after."""
        return _rms(self.after.heights, self.taken)


@dataclass(frozen=True, slots=True, eq=False)
class ReliefRegistration(Record):
    """Laser and images, registered.

    Examples
    --------
    >>> for profile in registration.profiles:
    ...     print(f"{profile.name}: shifted by {np.hypot(*profile.shift):.0f} m")
    ap18933l: shifted by 180 m
    ap19043l: shifted by 62 m
    >>> registration.solution.shifts.shape
    (2, 2)
    """

    name: str
    """Of the case."""
    settings: ReliefSettings
    """Choices."""
    before: Solution
    """Adjusted without stereo rows."""
    solution: Solution
    """Adjusted with them."""
    profiles: tuple[ReliefProfile, ...]
    """Those of the network."""


def _rms(found: SurfaceHeights, taken: Mask) -> float:
    """Of the heights of the shots taken, where the surface is known; NaN without any."""
    taken = found.covered & taken
    return float(np.sqrt(np.mean(found.heights[taken] ** 2))) if np.any(taken) else float("nan")
