"""Minima of a profile's misfit over shifts, and the probability of each.

What is stated of a shot's height is mostly its profile's, which has gone with the level, so the scale of its sigma is
hardly known: marginalised over that scale, whose prior counts as ten shots that are as stated, twice the logarithm of
the likelihood of a shift against another is -D,

    D = ((m + 6) ln((chi^2_1 + 10) / (chi^2_2 + 10)) + sum_i ln(sigma_i1^2 / sigma_i2^2)) / k,  k = (1 + r) / (1 - r),

k being the number of shots that count as one, by the correlation r of successive heights at the best shift. The weight
of a minimum is exp(-D / 2) times the root of its covariance's determinant: the probability that its neighbourhood is
the right one when all shifts have the same prior. The chi^2 of a prior is added to D.

What a registration by relief says: its choices, and each laser profile and terrain model against the surface
that the images show, before and after the adjustment with stereo rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.stereo_surface import SurfaceHeights
from mgsgraph.network import PointClass
from mgsgraph.record import Record

_AS_STATED = 10.0
"""Weight of the stated sigmas as a prior, in shots: the papers state ten times too much for MOLA."""
_MOST_CORRELATED = 0.9
"""Correlation of successive heights that is taken at its word."""
_ALIKE = 5.0
"""m, up to which two fits are the same."""
FITTED = 4
"""Level, slope and two shifts, which misfits have lost."""


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """One shift at which a profile fits."""

    shift: Array
    """(2,) m east and north, to be added to the footprints."""
    misfit: float
    """chi^2."""
    covariance: Array
    """(2, 2) m^2, of the shift."""
    change: Array = field(default_factory=lambda: np.zeros(2))
    """(2,) m east and north, from the middle of the profile to its end, of the shift."""
    weight: float = float("nan")
    """Probability; NaN of a minimum by itself, whose covariance is by the sigmas that are stated."""


def local_minima(shifts: Array, misfits: Array) -> list[Minimum]:
    """Local minima of a misfit (k, k) over shifts (k,), refined by a paraboloid through neighbours; lowest first."""
    filled = np.where(np.isfinite(misfits), misfits, np.inf)
    inner = filled[1:-1, 1:-1]
    around = [filled[1 + i : filled.shape[0] - 1 + i, 1 + j : filled.shape[1] - 1 + j] for i, j in _NEIGHBOURS]
    lowest = np.isfinite(inner) & np.all([inner <= neighbor for neighbor in around], axis=0)
    minima = [_refined(shifts, filled, row + 1, column + 1) for row, column in np.argwhere(lowest)]
    return sorted(minima, key=lambda minimum: minimum.misfit)


def weighted(
    minima: Sequence[Minimum],
    misfits: Array,
    lowest: Array,
    shots: Index,
    variances: Array,
    correlated: float,
    prior: Array,
) -> tuple[Minimum, ...]:
    """Minima with their weights, the likeliest first.

    Parameters
    ----------
    minima : sequence of n
        In any order.
    misfits, lowest : (n,)
        chi^2 of each, and of the one that fits best, over the shots of both.
    shots : (n,)
        Those of both.
    variances : (n,)
        Sum of the logarithms of their variances, less that at the best.
    correlated : float
        Number of successive shots that count as one.
    prior : (n,)
        chi^2 of their shifts by their priors.
    """
    freedom = np.maximum(shots - FITTED, 1) + _AS_STATED
    misfits, lowest = misfits + _AS_STATED, lowest + _AS_STATED
    scale = float(np.min(lowest / freedom)) * correlated
    logs = -0.5 * (freedom * np.log(misfits / lowest) + variances) / correlated - 0.5 * prior
    logs += np.array([0.5 * np.linalg.slogdet(minimum.covariance)[1] for minimum in minima])
    weights = np.exp(logs - logs.max())
    result = [
        replace(minimum, covariance=scale * minimum.covariance, weight=float(weight / weights.sum()))
        for minimum, weight in zip(minima, weights, strict=True)
    ]
    return tuple(sorted(result, key=lambda minimum: -minimum.weight))


def merged(shifts: Array, covariances: Array, misfits: Array, owner: Index, scale: float) -> Array:
    """(s, 2, 2) m^2, covariances of minima; of each that stands for others its mean square over the mixture of them.

    Parameters
    ----------
    shifts : (s, 2)
        m.
    covariances : (s, 2, 2)
        m^2, by the sigmas that are stated.
    misfits : (s,)
        chi^2 over as many shots each.
    owner : (s,)
        Number of the minimum that stands for each, -1 for none.
    scale : float
        By which chi^2 is too large.
    """
    result = covariances.copy()
    for k in np.unique(owner[owner >= 0]).tolist():
        group = [k]
        for other in np.flatnonzero(owner == k).tolist():  # fits that ended at the same place count once
            if np.linalg.norm(shifts[other] - shifts[group], axis=1).min() > _ALIKE:
                group.append(other)
        logs = 0.5 * np.linalg.slogdet(covariances[group])[1] - 0.5 * (misfits[group] - misfits[k]) / scale
        weights, off = np.exp(logs - logs.max()), shifts[group] - shifts[k]
        moments = covariances[group] + off[:, :, None] * off[:, None] / scale
        result[k] = np.einsum("k,kij->ij", weights / weights.sum(), moments)
    return result


def correlated_shots(left: Array) -> float:
    """Number of successive shots that count as one, by the correlation of their height residuals (n,)."""
    if left.size <= FITTED:
        return 1.0
    correlation = float(np.sum(left[1:] * left[:-1]) / max(np.sum(left**2), 1e-12))
    correlation = min(max(correlation, 0.0), _MOST_CORRELATED)
    return (1.0 + correlation) / (1.0 - correlation)


_NEIGHBOURS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]


def _refined(shifts: Array, misfits: Array, row: int, column: int) -> Minimum:
    """The paraboloid through a minimum and its eight neighbours."""
    step = shifts[1] - shifts[0]
    i, j = (part.ravel() for part in np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], indexing="ij"))
    values = misfits[row - 1 : row + 2, column - 1 : column + 2].ravel()
    lowest, at = misfits[row, column], np.array([shifts[row], shifts[column]])
    if not np.all(np.isfinite(values)):
        return Minimum(at, float(lowest), np.eye(2) * step**2)
    terms = np.stack([np.ones(9), i, j, 0.5 * i * i, i * j, 0.5 * j * j], axis=1)
    c, gi, gj, hii, hij, hjj = np.linalg.lstsq(terms, values, rcond=None)[0]
    hessian = np.array([[hii, hij], [hij, hjj]])
    if not (hii > 0.0 and np.linalg.det(hessian) > 1e-6 * hii * hjj):
        return Minimum(at, float(lowest), np.eye(2) * step**2)
    move = -np.linalg.solve(hessian, [gi, gj])
    if np.abs(move).max() > 1.0:
        return Minimum(at, float(lowest), 2.0 * np.linalg.inv(hessian) * step**2)
    misfit = min(float(lowest), float(c + 0.5 * np.array([gi, gj]) @ move))
    return Minimum(at + step * move, misfit, 2.0 * np.linalg.inv(hessian) * step**2)


REACH = 1500.0
"""m, shifts that are searched, in every direction, at least."""
_CLEAR = 1e-3
"""Weight of the second-best minimum up to which the best is the only one."""
_MOST_POSSIBLE = 5
"""Minima above that weight up to which relief ties a profile: more are a plain, in which noise fits anywhere."""


@dataclass(frozen=True, slots=True, eq=False)
class CostSurface:
    """Misfit of a profile (or of several together) over shifts."""

    name: str
    """Of the profile."""
    shifts: Array
    """(k,) m, both eastward and northward."""
    misfits: Array
    """(k, k) chi^2, by shift east (rows) and north (columns); NaN where too few shots are on the surface."""
    shots: int
    """On the surface, at most."""
    minima: tuple[Minimum, ...]
    """Likeliest first."""
    span: tuple[float, float] = (0.0, 0.0)
    """Numbers of the first and the last shot that both images see, before any shift."""
    reached: bool = True
    """False where adjustments have not come to the likeliest minimum: then it isn't clear."""

    def best(self, count: int) -> Array:
        """(count, 2) m east and north, by which each shot of the profile is to be moved to the likeliest minimum."""
        first, last = self.span
        along = (2.0 * np.arange(count) - first - last) / max(last - first, 1.0)
        likeliest = self.minima[0]
        return np.asarray(likeliest.shift + likeliest.change * np.clip(along, -1.0, 1.0)[:, None])

    @property
    def scale(self) -> float:
        """Least misfit per shot: in its units misfits are chi-square."""
        lowest = float(np.nanmin(self.misfits)) if np.any(np.isfinite(self.misfits)) else 0.0
        return lowest / max(self.shots - FITTED, 1) or 1.0

    @property
    def possible(self) -> tuple[Minimum, ...]:
        """Minima that may be the right one."""
        return tuple(minimum for minimum in self.minima if minimum.weight >= _CLEAR)

    @property
    def tied(self) -> bool:
        """Whether relief ties the profile at all: few minima are possible, each narrow beside the shifts searched."""
        widest = (0.25 * np.ptp(self.shifts) / 2.0) ** 2
        return 0 < len(self.possible) <= _MOST_POSSIBLE and all(
            float(np.linalg.eigvalsh(minimum.covariance)[-1]) < widest for minimum in self.possible
        )

    @property
    def clear(self) -> bool:
        """Whether relief ties it at one position only, which adjustments reach."""
        return self.tied and len(self.possible) == 1 and self.reached


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
            raise InputError("registration by relief, reach", found, most, "fix the orientation or the profiles first")


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
        weights = np.array([minimum.weight for minimum in self.cost.possible])
        off = np.array([minimum.shift for minimum in self.cost.possible]) - self.misplacement
        each = np.array([minimum.covariance for minimum in self.cost.possible]) + off[:, :, None] * off[:, None]
        return np.asarray(np.einsum("k,kij->ij", weights / weights.sum(), each))


@dataclass(frozen=True, slots=True, eq=False)
class ReliefProfile(Record):
    """One laser profile, or one terrain model, against the stereo surface.

    Examples
    --------
    >>> profile = registration.profiles[0]
    >>> print(f"{profile.on_surface.sum()} shots: {profile.rms_before:.0f} m before, {profile.rms_after:.1f} m after")
    114 shots: 839 m before, 1.0 m after
    >>> np.sqrt(np.diagonal(profile.covariance)).round(1)
    array([62.5, 62.6])
    """

    name: str
    """Of the profile or the model."""
    point_class: PointClass
    """What it consists of: laser shots, or posts."""
    points: Index
    """(n,) its points in the network, in the order of their times."""
    on_surface: Mask
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
        """Name of one of its points."""
        return "post" if self.of_posts else "shot"

    @property
    def rms_before(self) -> float:
        """m, of the heights of the shots above the surface, before."""
        return _rms(self.before.heights, self.on_surface)

    @property
    def rms_after(self) -> float:
        """m, of the heights of the shots above the surface, after."""
        return _rms(self.after.heights, self.on_surface)


@dataclass(frozen=True, slots=True, eq=False)
class ReliefRegistration(Record):
    """Laser and images, registered.

    Examples
    --------
    >>> for profile in registration.profiles:
    ...     print(f"{profile.name}: shifted by {np.hypot(*profile.shift):.0f} m")
    ap18933l: shifted by 178 m
    ap19043l: shifted by 63 m
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


def _rms(surface_heights: SurfaceHeights, used: Mask) -> float:
    """Rms height of the used shots, where the surface is known; NaN without any."""
    used = surface_heights.covered & used
    return float(np.sqrt(np.mean(surface_heights.heights[used] ** 2))) if np.any(used) else float("nan")
