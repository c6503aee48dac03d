"""Quantities of the adjustment as linear functions of its unknowns, the law of error propagation for them, and the
estimates that the posterior gives: positions, differences, poses, pixels, each with covariance and local frame.

Every question to the posterior is put in one form: dq = sum_v J_v dx_v + sum_i N_i e_i, x_v the shared unknowns
(covariance S), e_i noise of unit covariance that point i keeps for itself when x is known (S_p = V^-1 + V^-1 W' S W
V^-1, docs/theory.md, Sigmas). Two quantities covary by J1 S J2' + sum_i N1_i N2_i'.

Ground points that two solutions have in common: how far they are apart, and how well each solution knows them.
"""

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mgsgraph.adjustment.frames import camera_axes, flight_axes
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.records import Array, Index, sigmas_of
from mgsgraph.names import Names
from mgsgraph.record import Record
from mgsgraph.units import ARCSEC


@dataclass(frozen=True, slots=True, eq=False)
class Quantity(Record):
    """m numbers that follow from the unknowns.

    Examples
    --------
    >>> height = posterior.of_point("TIE00001")
    >>> up = height.values / np.linalg.norm(height.values)
    >>> radius = height.through(("radius",), ("m",), np.array([np.linalg.norm(height.values)]), up[None])
    >>> posterior.joint([radius]).sigmas.round(0)
    array([22.])
    """

    names: tuple[str, ...]
    """(m,) what they are."""
    units: tuple[str, ...]
    """(m,) in which unit."""
    values: Array
    """(m,) at the solution."""
    by_shared: Mapping[int, Array]
    """(m, width) derivatives by each shared unknown they depend on, per m and rad."""
    noise: Mapping[Hashable, Array]
    """(m, 3) derivatives by the noise of each point they depend on, by a key of its own: quantities that have one in
    common share that noise."""

    def through(self, names: tuple[str, ...], units: tuple[str, ...], values: Array, jacobian: Array) -> "Quantity":
        """Further numbers (k) that follow from these; `jacobian` (k, m) are their derivatives."""
        by_shared = {variable: jacobian @ part for variable, part in self.by_shared.items()}
        return Quantity(names, units, values, by_shared, {point: jacobian @ part for point, part in self.noise.items()})


def joined(quantities: Sequence[Quantity]) -> Quantity:
    """Several quantities as one, in their order."""
    ends = np.cumsum([0, *(len(quantity.names) for quantity in quantities)]).tolist()
    by_shared: dict[int, Array] = {}
    noise: dict[Hashable, Array] = {}
    for first, last, quantity in zip(ends, ends[1:], quantities, strict=False):
        for variable, part in quantity.by_shared.items():
            by_shared.setdefault(variable, np.zeros((ends[-1], part.shape[1])))[first:last] = part
        for point, part in quantity.noise.items():
            noise.setdefault(point, np.zeros((ends[-1], 3)))[first:last] = part
    return Quantity(
        tuple(name for quantity in quantities for name in quantity.names),
        tuple(unit for quantity in quantities for unit in quantity.units),
        np.concatenate([quantity.values for quantity in quantities]),
        by_shared,
        noise,
    )


def covariance(quantity: Quantity, joint: JointCovariance) -> Array:
    """(m, m) covariance of a quantity's numbers, in the product of their units, for sigma0 = 1."""
    m = len(quantity.names)
    matrix = np.zeros((m, m))
    if quantity.by_shared:
        jacobian = np.hstack(list(quantity.by_shared.values()))
        matrix += jacobian @ joint.of(quantity.by_shared) @ jacobian.T
    for part in quantity.noise.values():
        matrix += part @ part.T
    return np.asarray(0.5 * (matrix + matrix.T))


def correlation(covariance: Array) -> Array:
    """(m, m) correlation matrix of a covariance; NaN where there is no variance."""
    sigmas = sigmas_of(covariance)
    scale = np.where(sigmas > 0.0, sigmas, np.nan)
    return np.asarray(covariance / scale[:, None] / scale)


def _roots(covariance: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum(np.diagonal(covariance), 0.0)))


@dataclass(frozen=True, slots=True, eq=False)
class Estimate(Record):
    """m numbers with their joint covariance, for sigma0 = 1.

    Examples
    --------
    >>> both = posterior.joint([posterior.of_point("TIE00001"), posterior.of_point("TIE00002")])
    >>> both.names
    ('X of point TIE00001', 'Y of point TIE00001', 'Z of point TIE00001', 'X of point TIE00002', 'Y of point
    TIE00002', 'Z of point TIE00002')
    >>> both.sigmas.round(0)
    array([ 6., 22.,  8.,  6., 23.,  8.])
    """

    names: tuple[str, ...]
    """(m,) what they are."""
    units: tuple[str, ...]
    """(m,)"""
    values: Array
    """(m,)"""
    covariance: Array
    """(m, m) in the product of the units."""

    @property
    def sigmas(self) -> Array:
        """(m,) standard deviations."""
        return _roots(self.covariance)

    @property
    def correlation(self) -> Array:
        """(m, m) correlation matrix; NaN where there is no variance."""
        return correlation(self.covariance)

    def __repr__(self) -> str:
        return f"Estimate({', '.join(self.names)})"


@dataclass(frozen=True, slots=True, eq=False)
class ErrorEllipsoid(Record):
    """Surface within which the truth lies with a probability, in the local frame east, north, up.

    Examples
    --------
    >>> ellipsoid = posterior.point("TIE00001").ellipsoid(0.95)
    >>> ellipsoid.semi_axes.round(0)
    array([61., 21., 15.])
    >>> np.degrees(ellipsoid.elevations).round(0)
    array([80.,  1., 10.])
    """

    probability: float
    """Probability that the truth lies inside."""
    semi_axes: Array
    """(3,) m, longest first."""
    directions: Array
    """(3, 3) rows: unit vectors of the axes, east, north, up; upward or level."""

    @property
    def azimuths(self) -> Array:
        """(3,) rad, from north over east."""
        return np.asarray(np.arctan2(self.directions[:, 0], self.directions[:, 1]) % (2.0 * np.pi))

    @property
    def elevations(self) -> Array:
        """(3,) rad, above the level."""
        return np.asarray(np.arcsin(np.clip(self.directions[:, 2], -1.0, 1.0)))


def chi_square_radius(probability: float, dimension: int) -> float:
    """Sigmas from the centre within which a normal vector lies with a probability."""
    from scipy.special import gammaincinv  # slow to import

    return math.sqrt(float(2.0 * gammaincinv(0.5 * dimension, probability)))


def error_ellipsoid(covariance: Array, probability: float) -> ErrorEllipsoid:
    """Error ellipsoid of a covariance (3, 3) in east, north, up; m."""
    values, vectors = np.linalg.eigh(covariance)
    directions = vectors.T[::-1]
    directions = directions * np.where(directions[:, [2]] < 0.0, -1.0, 1.0)
    radius = chi_square_radius(probability, 3)
    return ErrorEllipsoid(probability, radius * np.sqrt(np.maximum(values[::-1], 0.0)), directions)


@dataclass(frozen=True, slots=True, eq=False)
class PositionEstimate(Record):
    """Position of a ground point.

    Examples
    --------
    >>> point = posterior.point("TIE00001")
    >>> print(point)
    PositionEstimate('TIE00001', sigma east 6.73 m, north 7.39 m, up 21.5 m)
    >>> np.sqrt(np.diagonal(point.east_north_up)).round(0)
    array([ 7.,  7., 22.])
    """

    name: str
    """Name of the point."""
    position: Array
    """(3,) m, body-fixed."""
    covariance: Array
    """(3, 3) m^2, body-fixed, for sigma0 = 1."""
    misfit: float | None = None
    """Of a new intersection: by how many sigmas its rays miss each other."""

    @property
    def sigmas(self) -> Array:
        """(3,) m in X, Y, Z."""
        return _roots(self.covariance)

    @property
    def east_north_up(self) -> Array:
        """(3, 3) m^2, covariance in the local frame."""
        frame = east_north_up(self.position[None])[0]
        return np.asarray(frame @ self.covariance @ frame.T)

    def ellipsoid(self, probability: float = 0.95) -> ErrorEllipsoid:
        """Error ellipsoid in the local frame."""
        return error_ellipsoid(self.east_north_up, probability)

    def __repr__(self) -> str:
        east, north, up = _roots(self.east_north_up)
        return f"PositionEstimate({self.name!r}, sigma east {east:.3g} m, north {north:.3g} m, up {up:.3g} m)"


@dataclass(frozen=True, slots=True, eq=False)
class Difference(Record):
    """From one point to another; what the two share cancels.

    Examples
    --------
    >>> difference = posterior.difference("TIE00001", "TIE00002")
    >>> print(f"{difference.height:.1f} +- {difference.height_sigma:.1f} m over {difference.distance:.0f} m")
    -60.4 +- 16.3 m over 5047 m
    >>> difference.chance < 0.01
    True
    """

    first: str
    """Name of the point it begins at."""
    second: str
    """Name of the point it ends at."""
    begin: Array
    """(3,) m, body-fixed."""
    end: Array
    """(3,) m, body-fixed."""
    joint: Array
    """(6, 6) m^2, of both places, for sigma0 = 1."""

    @property
    def vector(self) -> Array:
        """(3,) m, body-fixed."""
        return self.end - self.begin

    @property
    def covariance(self) -> Array:
        """(3, 3) m^2 of the vector, body-fixed."""
        jacobian = np.hstack([-np.eye(3), np.eye(3)])
        return np.asarray(jacobian @ self.joint @ jacobian.T)

    @property
    def east_north_up(self) -> Array:
        """(3, 3) m^2, covariance of the vector in the frame of the place half-way."""
        frame = east_north_up(0.5 * (self.begin + self.end)[None])[0]
        return np.asarray(frame @ self.covariance @ frame.T)

    @property
    def height(self) -> float:
        """m, radius of the second point minus that of the first."""
        return float(np.linalg.norm(self.end) - np.linalg.norm(self.begin))

    @property
    def height_sigma(self) -> float:
        """m, its standard deviation, each height along its own vertical."""
        jacobian = np.concatenate([-self.begin / np.linalg.norm(self.begin), self.end / np.linalg.norm(self.end)])
        return math.sqrt(max(float(jacobian @ self.joint @ jacobian), 0.0))

    @property
    def height_sigma_if_independent(self) -> float:
        """m, what it would be if nothing were shared by the two points."""
        ups = self.begin / np.linalg.norm(self.begin), self.end / np.linalg.norm(self.end)
        blocks = self.joint[:3, :3], self.joint[3:, 3:]
        return math.sqrt(sum(float(up @ block @ up) for up, block in zip(ups, blocks, strict=True)))

    @property
    def distance(self) -> float:
        """Length of the vector, m."""
        return float(np.linalg.norm(self.vector))

    @property
    def distance_sigma(self) -> float:
        """Its standard deviation, m."""
        if self.distance == 0.0:
            return math.sqrt(float(np.linalg.eigvalsh(self.covariance)[-1]))
        along = self.vector / self.distance
        return math.sqrt(max(float(along @ self.covariance @ along), 0.0))

    @property
    def chance(self) -> float:
        """Probability of a height difference of this size or more if there were none (two-sided)."""
        if self.height_sigma == 0.0:
            return 0.0 if self.height else 1.0
        return math.erfc(abs(self.height) / self.height_sigma / math.sqrt(2.0))

    @property
    def sentence(self) -> str:
        """Whether the height difference is real, in words."""
        ratio = abs(self.height) / self.height_sigma if self.height_sigma else math.inf
        verdict = "is real" if self.chance < 0.01 else "may be chance" if self.chance > 0.05 else "is probably real"
        return (
            f"{self.second} lies {abs(self.height):.3g} m {'above' if self.height >= 0.0 else 'below'} {self.first}, "
            f"sigma {self.height_sigma:.3g} m ({self.height_sigma_if_independent:.3g} m if their errors were "
            f"independent): {ratio:.1f} sigma, the difference {verdict} (chance {self.chance:.2g})"
        )

    def __repr__(self) -> str:
        return f"Difference({self.sentence})"


@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate(Record):
    """Exterior orientation of an image at a line.

    Examples
    --------
    >>> print(posterior.pose("SIM/A", line=2500.0))
    PoseEstimate('SIM/A', line 2500, sigma along 23.7 m, across 23.7 m, radial 3.53 m; roll 12.9, pitch 13, yaw
    20.6 arcsec)
    """

    image: str
    """Name of the image."""
    line: float
    """Line coordinate."""
    position: Array
    """(3,) m, body-fixed."""
    velocity: Array
    """(3,) m per line, body-fixed."""
    matrix: Array
    """(3, 3) body-fixed to camera frame."""
    covariance: Array
    """(6, 6) of the position along the body-fixed axes (m) and of a small rotation about the camera's axes (rad)."""

    @property
    def flight_turn(self) -> Array:
        """(6, 6) from X, Y, Z and rotations about the camera's axes to the flight's: along, across (left), radial;
        roll, pitch, yaw.
        """
        axes = flight_axes(self.position, self.velocity)
        turn = np.zeros((6, 6))
        turn[:3, :3], turn[3:, 3:] = axes, camera_axes(self.matrix @ axes[0])
        return turn

    @property
    def flight(self) -> Array:
        """(6, 6) covariance in the terms of the flight, m and rad."""
        return np.asarray(self.flight_turn @ self.covariance @ self.flight_turn.T)

    @property
    def sigmas(self) -> Array:
        """(6,) m and rad: along, across, radial, roll, pitch, yaw."""
        return _roots(self.flight)

    def __repr__(self) -> str:
        text = "PoseEstimate({!r}, line {:g}, sigma along {:.3g} m, across {:.3g} m, radial {:.3g} m; "
        text += "roll {:.3g}, pitch {:.3g}, yaw {:.3g} arcsec)"
        return text.format(self.image, self.line, *self.sigmas[:3], *(self.sigmas[3:] / ARCSEC))


@dataclass(frozen=True, slots=True, eq=False)
class PixelEstimate(Record):
    """Where a ground point falls in an image.

    Examples
    --------
    >>> print(posterior.projection("TIE00001", "SIM/B"))
    PixelEstimate(point 'TIE00001' in image 'SIM/B': line 2384.47 sigma 0.69 px, sample 577.91 sigma 1 px)
    """

    point: str
    """Name of the point."""
    image: str
    """Name of the image."""
    pixel: Array
    """(2,) line, sample."""
    covariance: Array
    """(2, 2) px^2, for sigma0 = 1; without the noise of a measure."""

    @property
    def sigmas(self) -> Array:
        """(2,) px, line and sample."""
        return _roots(self.covariance)

    def __repr__(self) -> str:
        line, sample = self.sigmas
        return (
            f"PixelEstimate(point {self.point!r} in image {self.image!r}: line {self.pixel[0]:.2f} sigma "
            f"{line:.3g} px, sample {self.pixel[1]:.2f} sigma {sample:.3g} px)"
        )


@dataclass(frozen=True)
class CommonPoints:
    """Determined ground points that two solutions have under the same name."""

    solution: Solution
    """The later one."""
    earlier: Solution
    """The earlier one."""

    @cached_property
    def _pairs(self) -> Index:
        """(n, 2) numbers of every common name in the later and in the earlier solution."""
        matches = Names.of(self.earlier.network.points.ids).find(self.solution.network.points.ids)
        later = np.flatnonzero(matches >= 0)
        return np.stack([later, matches[later]], axis=1)

    @property
    def shared(self) -> int:
        """Points of the same name, determined or not."""
        return len(self._pairs)

    @cached_property
    def rows(self) -> tuple[Index, Index]:
        """(n,) numbers in the later and in the earlier solution, of those that both determine."""
        later, earlier = self._pairs.T
        sound = self.solution.determined[later] & self.earlier.determined[earlier]
        return later[sound], earlier[sound]

    @cached_property
    def places(self) -> Array:
        """(n, 3) m, body-fixed, of the later solution."""
        return np.asarray(self.solution.places[self.rows[0]])

    @cached_property
    def moved(self) -> Array:
        """(n, 3) m east, north and up, later minus earlier."""
        before = self.earlier.places[self.rows[1]]
        return np.asarray(np.einsum("nij,nj->ni", east_north_up(self.places), self.places - before))

    @cached_property
    def sigmas(self) -> tuple[Array, Array]:
        """(n,) m, 3-D sigmas of the earlier and of the later solution."""
        later, earlier = self.rows
        before, after = (np.trace(solution.covariances[k], axis1=1, axis2=2)
                         for solution, k in ((self.earlier, earlier), (self.solution, later)))  # fmt: skip
        return np.sqrt(np.maximum(before, 0.0)), np.sqrt(np.maximum(after, 0.0))

    @property
    def in_sigmas(self) -> Array:
        """(n,) distance over the larger of both 3-D sigmas; NaN for points without any."""
        sigma = np.maximum(*self.sigmas)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(sigma > 0.0, np.linalg.norm(self.moved, axis=1) / sigma, np.nan)

    @property
    def ratio(self) -> Array:
        """(n,) later 3-D sigma over the earlier one; NaN where a point has none in either."""
        earlier, later = self.sigmas
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where((earlier > 0.0) & (later > 0.0), later / earlier, np.nan)
