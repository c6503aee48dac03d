"""The target body: an ellipsoid of revolution in its own frame, planetocentric places, and rays that meet it.

A plane on which a block is drawn: azimuthal equidistant about its middle, on the sphere through it.

Error ellipses in a plane: what holds a place with a probability of 95 %.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.geometry.records import Array, finite_rows
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.record import Record
from mgsgraph.units import KM


@dataclass(frozen=True, slots=True)
class Ellipsoid(Record):
    """Reference ellipsoid of revolution, centred on the body-fixed frame, polar axis along +Z.

    Examples
    --------
    >>> from mgsgraph.geometry.body import Ellipsoid
    >>> mars = Ellipsoid(3_396_190.0, 3_376_200.0)
    >>> mars.radius(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    array([3396190., 3376200.])
    """

    equatorial: float
    """m, equatorial radius."""
    polar: float
    """m, polar radius."""

    def __post_init__(self) -> None:
        for name in ("equatorial", "polar"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise InputError(f"ellipsoid, {name} radius", f"{getattr(self, name)} m", "a positive number")

    def radius(self, directions: Array) -> Array:
        """Radius (n,) in m towards unit vectors (n, 3) from the centre, body-fixed."""
        a, b = self.equatorial, self.polar
        return np.asarray(a * b / np.hypot(b * np.hypot(directions[:, 0], directions[:, 1]), a * directions[:, 2]))


_BODIES = {
    "MERCURY": (199, 2440.53, 2438.26), "VENUS": (299, 6051.8, 6051.8), "EARTH": (399, 6378.1366, 6356.7519),
    "MOON": (301, 1737.4, 1737.4), "MARS": (499, 3396.19, 3376.2), "JUPITER": (599, 71492.0, 66854.0),
    "IO": (501, 1829.4, 1815.7), "EUROPA": (502, 1562.6, 1559.5), "GANYMEDE": (503, 2631.2, 2631.2),
    "CALLISTO": (504, 2410.3, 2410.3), "SATURN": (699, 60268.0, 54364.0), "TITAN": (606, 2575.15, 2574.47),
    "URANUS": (799, 25559.0, 24973.0), "NEPTUNE": (899, 24764.0, 24341.0), "TRITON": (801, 1352.6, 1352.6),
    "PLUTO": (999, 1188.3, 1188.3),
}  # fmt: skip
"""NAIF id, equatorial and polar radius in km (IAU 2015, pck00011.tpc) of the bodies that are larger than `_LARGE`."""
_RADII = {name: equatorial * KM for name, (_, equatorial, _) in _BODIES.items()}
_LARGE = 1.0e6
"""m: there are no larger bodies that anything orbits."""
_OFF = 5e-3
"""Share by which radii of a known body may be off: older ones are so by 2e-3, spheres by the flattening."""
_NEAR, _NEAR_UNKNOWN = 1.1, 2.0
"""How many times larger or smaller than a body's radii a place's may be; of a body that is none of these, which may be
of any shape.
"""


def target_name(body: Ellipsoid) -> str:
    """What SPICE and ISIS call the body of this size, to half a per cent; UNKNOWN for others."""
    near = [name for name, radius in _RADII.items() if abs(body.equatorial / radius - 1.0) < _OFF]
    return near[0] if near else "UNKNOWN"


def may_be(body: Ellipsoid, target: str) -> bool:
    """Whether a body is of the size of the one that SPICE and ISIS call so; True for those whose size isn't known."""
    return target.upper() not in _RADII or target_name(body) == target.upper()


def is_another(body: Ellipsoid, target: str) -> bool:
    """Whether a name is not that of this body; False where there is none, or where neither is of a known size."""
    own, other = target_name(body), target.strip().upper()
    return other in _RADII and other != own if own == "UNKNOWN" else other not in ("", own)


def distances(points: Array) -> Array:
    """M from the body's centre of points (n, 3); infinite for those whose squares are no numbers."""
    with np.errstate(over="ignore"):
        return np.asarray(np.linalg.norm(points, axis=1))


def surface_radii(points: Array, body: Ellipsoid) -> Array:
    """M from the body's centre to its ellipsoid (n,), towards points (n, 3); the equatorial radius towards those that
    have no direction.
    """
    with np.errstate(invalid="ignore"):
        radii = distances(points) / distances(points / np.array([body.equatorial, body.equatorial, body.polar]))
    return np.where(np.isfinite(radii), radii, body.equatorial)


def nearness(body: Ellipsoid) -> float:
    """How many times larger or smaller than a body's radii those of places on it may be."""
    return _NEAR_UNKNOWN if target_name(body) == "UNKNOWN" else _NEAR


def naif_id(name: str) -> int | None:
    """NAIF id of a body by the name that `target_name` gives; None for one whose size isn't known here."""
    return _BODIES[name][0] if name in _BODIES else None


def body_name(code: int) -> str:
    """What SPICE calls a body by its NAIF id; empty for one whose size isn't known here."""
    return next((name for name, (naif_id, _, _) in _BODIES.items() if naif_id == code), "")


def require_possible(body: Ellipsoid, target: str, where: str) -> None:
    """Raise InputError, naming `where`, for radii that can't be those of the body that SPICE and ISIS call `target`;
    where that is empty or not known here, for those that no body has.
    """
    size = f"radii of {body.equatorial / KM:.9g} km on the equator and {body.polar / KM:.9g} km at the pole"
    unit = "check the order and the unit of the radii (km, or m where the file says so)"
    if not 0.5 < body.polar / body.equatorial <= 1.0 + 1e-9:
        raise InputError(where, size, "a body that is a little flattened, or not at all", unit)
    name = target.upper() if target.upper() in _BODIES else target_name(body)
    if name == "UNKNOWN":
        if body.equatorial > _LARGE:
            nearest = min(_BODIES, key=lambda other: abs(np.log(_RADII[other] / body.equatorial)))
            expected = f"a body that there is (the one nearest in size is {nearest} of {_RADII[nearest] / KM:g} km)"
            raise InputError(where, size, expected, unit)
        return
    equatorial, polar = (KM * radius for radius in _BODIES[name][1:])
    possible = abs(body.equatorial / equatorial - 1.0) < _OFF and body.polar > (1.0 - _OFF) * polar
    require(possible, where, size, f"those of {name}: {equatorial / KM:g} and {polar / KM:g} km", unit)


def require_near(radii: Array, body: Ellipsoid, where: Callable[[int], str]) -> None:
    """Raise InputError for a distance (n,) in m from the body's centre that is a tenth less than its radii, or more;
    of a body of unknown name half, or twice as much. NaN passes. `where` is the place of the k-th in messages.
    """
    near = nearness(body)
    for k in np.flatnonzero((radii < body.polar / near) | (radii > body.equatorial * near))[:1].tolist():
        found, expected = f"{radii[k]:.6g} m from the body's centre", f"about {body.equatorial:.6g} m"
        raise InputError(where(k), found, expected, "lengths are in m, not in km, and on the images' body")


def in_turn(angles: Array, middle: Array | float = 0.0) -> Array:
    """The same angles (rad, of any shape) in the turn about a middle: at most half a turn from it."""
    return np.asarray(np.mod(angles - middle + np.pi, 2.0 * np.pi) - np.pi + middle)


def planetocentric(points: Array) -> Array:
    """Longitude (east, -pi .. pi), planetocentric latitude (rad) and radius (m) of points (..., 3); (..., 3)."""
    x, y, z = np.moveaxis(points, -1, 0)
    planar = np.hypot(x, y)
    return np.stack([np.arctan2(y, x), np.arctan2(z, planar), np.hypot(planar, z)], axis=-1)


def from_planetocentric(places: Array) -> Array:
    """Body-fixed points (..., 3) in m of longitude, latitude (rad) and radius (m) (..., 3)."""
    longitude, latitude, radius = np.moveaxis(places, -1, 0)
    planar = radius * np.cos(latitude)
    return np.stack([planar * np.cos(longitude), planar * np.sin(longitude), radius * np.sin(latitude)], axis=-1)


def planetocentric_jacobian(places: Array) -> Array:
    """d(x, y, z) / d(longitude, latitude, radius) at places (..., 3); (..., 3, 3), m/rad, m/rad, m/m."""
    longitude, latitude, radius = np.moveaxis(places, -1, 0)
    (sl, cl), (sb, cb) = (np.sin(longitude), np.cos(longitude)), (np.sin(latitude), np.cos(latitude))
    zero = np.zeros_like(radius)
    rows = [
        [-radius * cb * sl, -radius * sb * cl, cb * cl],
        [radius * cb * cl, -radius * sb * sl, cb * sl],
        [zero, radius * cb, sb],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def east_north(points: Array) -> Array:
    """(n, 2, 3) unit vectors eastward and northward, body-fixed, on the sphere at points (n, 3) in m."""
    longitude, latitude, _ = planetocentric(points).T
    (sl, cl), (sb, cb) = (np.sin(longitude), np.cos(longitude)), (np.sin(latitude), np.cos(latitude))
    east = np.stack([-sl, cl, np.zeros_like(sl)], axis=1)
    return np.stack([east, np.stack([-sb * cl, -sb * sl, cb], axis=1)], axis=1)


def east_north_up(points: Array) -> Array:
    """(n, 3, 3) unit vectors eastward, northward and upward, the same."""
    up = unit_vectors(points)
    return np.concatenate([east_north(points), up[:, None]], axis=1)


def geodetic(points: Array, ellipsoid: Ellipsoid) -> Array:
    """Longitude, geodetic latitude (rad) and height above the ellipsoid (m) of points (..., 3); (..., 3).

    Bowring's iteration on the parametric latitude; as exact as float64 (1e-8 m) for heights up to the body's radius.
    """
    a, b = ellipsoid.equatorial, ellipsoid.polar
    x, y, z = np.moveaxis(points, -1, 0)
    planar = np.hypot(x, y)
    excess, second = (a * a - b * b) / (a * a), (a * a - b * b) / (b * b)
    parametric = np.arctan2(z * a, planar * b)
    latitude = parametric
    for _ in range(4):
        latitude = np.arctan2(z + second * b * np.sin(parametric) ** 3, planar - excess * a * np.cos(parametric) ** 3)
        parametric = np.arctan2(b * np.sin(latitude), a * np.cos(latitude))
    sine, cosine = np.sin(latitude), np.cos(latitude)
    height = planar * cosine + z * sine - a * np.sqrt(1.0 - excess * sine**2)
    return np.stack([np.arctan2(y, x), latitude, height], axis=-1)


def ellipsoidal_heights(points: Array, ellipsoid: Ellipsoid) -> Array:
    """(n,) m, heights of points (n, 3) above the ellipsoid."""
    return np.asarray(geodetic(points, ellipsoid)[:, 2])


def from_geodetic(places: Array, ellipsoid: Ellipsoid) -> Array:
    """Body-fixed points (..., 3) in m of longitude, geodetic latitude (rad) and height (m) (..., 3)."""
    longitude, latitude, height = np.moveaxis(places, -1, 0)
    a, b = ellipsoid.equatorial, ellipsoid.polar
    normal = a * a / np.hypot(a * np.cos(latitude), b * np.sin(latitude))
    planar = (normal + height) * np.cos(latitude)
    vertical = (normal * (b / a) ** 2 + height) * np.sin(latitude)
    return np.stack([planar * np.cos(longitude), planar * np.sin(longitude), vertical], axis=-1)


def intersect_ellipsoid(
    origins: Array, directions: Array, ellipsoid: Ellipsoid, height: Array | float = 0.0
) -> tuple[Array, Array, Array]:
    """First intersection of rays that come from outside with the ellipsoid whose radii are larger by `height`.

    Parameters
    ----------
    origins, directions : (n, 3)
        m, body-fixed; directions need not be of unit length.
    ellipsoid : Ellipsoid
        Of the body.
    height : float or (n,)
        m, added to both radii (exactly the height on a sphere).

    Returns
    -------
    points : (n, 3)
        m, body-fixed; NaN where a ray misses the body, points away from it or begins inside.
    d_origin, d_direction : (n, 3, 3)
        Derivatives of the points with respect to origins and directions.
    """
    radii = np.array([ellipsoid.equatorial, ellipsoid.equatorial, ellipsoid.polar]) + np.asarray(height)[..., None]
    start, along = origins / radii, directions / radii
    a = np.einsum("ni,ni->n", along, along)
    b = np.einsum("ni,ni->n", start, along)
    c = np.einsum("ni,ni->n", start, start) - 1.0
    root = b * b - a * c
    with np.errstate(invalid="ignore", divide="ignore"):
        distance = c / (-b + np.sqrt(root))  # the nearer root, free of cancellation
    distance = np.where((b < 0.0) & (c >= 0.0) & (root >= 0.0), distance, np.nan)
    points = origins + distance[:, None] * directions
    normal = points / radii**2
    fall = np.einsum("ni,ni->n", normal, directions)
    with np.errstate(invalid="ignore", divide="ignore"):  # a ray that only touches has no derivative
        d_origin = np.eye(3) - directions[:, :, None] * (normal / fall[:, None])[:, None, :]
    return points, d_origin, distance[:, None, None] * d_origin


def centre_of(points: Array) -> Array:
    """Middle (3,) in m of points (n, 3): the mean of their directions, at their mean distance from the origin."""
    sound = points[finite_rows(points)]
    radii = np.linalg.norm(sound, axis=1)
    mean = np.mean(sound / radii[:, None], axis=0)
    return np.asarray(mean / np.linalg.norm(mean) * radii.mean())


def plane_coordinates(points: Array, centre: Array) -> Array:
    """East and north (n, 2) in m of points (n, 3) around a centre (3,), azimuthal equidistant on the sphere through it.

    Distances and directions from the centre are true however large the block is (Snyder 1987, p. 191).
    """
    radius, up, axes = _axes(centre)
    flat = points @ axes.T
    length = np.linalg.norm(flat, axis=1)
    angle = np.arctan2(length, points @ up)
    return np.asarray(flat * np.where(length > 0.0, radius * angle / np.where(length > 0.0, length, 1.0), 0.0)[:, None])


def places_at(plane: Array, centre: Array) -> Array:
    """(n, 3) m, body-fixed, on the sphere through a centre (3,), of east and north (n, 2) in m around it: the inverse
    of `plane_coordinates`.
    """
    radius, up, axes = _axes(centre)
    length = np.linalg.norm(plane, axis=1)
    angle = length / radius
    flat = plane * np.where(length > 0.0, np.sin(angle) / np.where(length > 0.0, length, 1.0), 0.0)[:, None]
    return np.asarray(radius * (np.cos(angle)[:, None] * up + flat @ axes))


def _axes(centre: Array) -> tuple[float, Array, Array]:
    """Distance of a place (3,) from the origin; unit vectors upward (3,), and eastward and northward (2, 3) there."""
    radius = float(np.linalg.norm(centre))
    up = centre / radius
    planar = float(np.hypot(up[0], up[1]))
    east = np.array([-up[1], up[0], 0.0]) / planar if planar > 0.0 else np.array([0.0, 1.0, 0.0])
    return radius, up, np.stack([east, np.cross(up, east)])


# --- error ellipses

PROBABILITY = 0.95
_SIGMAS = float(np.sqrt(-2.0 * np.log(1.0 - PROBABILITY)))
"""Semi-axes of such an ellipse in sigmas: chi-square of two degrees of freedom is exponentially distributed."""


def error_ellipses(covariances: Array) -> tuple[Array, Array]:
    """Semi-axes (..., 2), the smaller first, and their directions (..., 2, 2), one in each column, of the ellipses that
    hold places of covariances (..., 2, 2) with that probability; in the unit whose square these are in.
    """
    values, axes = np.linalg.eigh(covariances)
    return _SIGMAS * np.sqrt(np.maximum(values, 0.0)), axes
