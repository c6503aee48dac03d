"""Whether the geometry of an image is possible: exchanged units, and tables that contradict themselves.

Images that are one and the same were taken at the same times from the same places in the same directions.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import Ellipsoid, distances, nearness, require_possible, surface_radii
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.records import Array, all_pairs, finite_rows
from mgsgraph.geometry.trajectory import PositionTable, Trajectory
from mgsgraph.units import KM

_FARTHEST = 400
"""Radii of the body, from farther than which no line scanner looks; a low orbit in metres for kilometres is farther."""
_CONTRADICTION = 0.2
"""Share of the velocities by which positions may change otherwise: of sparse tables of a bent orbit it is far less."""
MEASURED = 5e-5
"""rad/s by which the median rate of a camera's attitudes may be off: of MOC's held images all of it is noise."""
_SYSTEM, _FASTEST = 1e13, 1e7
"""m, 70 astronomical units; m/s, a thirtieth of the speed of light."""
_CONVERGENT = 0.05
"""rad, from which on rays meet at a good angle."""
_FLATTEST = 0.1
"""Of ellipsoids that are bodies, polar radius by equatorial one: Haumea has a half."""
_FEW = 5
"""Points; fewer may all be blunders."""


def require_plausible(image: PushbroomImage, where: str) -> None:
    """Raise InputError, naming `where`, unless the body is one that can be, and the image was taken from outside it,
    from not hundreds of its radii away, with velocities that lead from position to position, and sees the ellipsoid in
    its middle.
    """
    body, unit = image.body, "check the units of positions and radii (km, or m where the file says so)"
    table = getattr(image.trajectory, "position", None)
    if isinstance(table, PositionTable):  # a body-fixed path may have corners, where no velocity is right
        require_flight(table, where, 1.0 if isinstance(image.trajectory, Trajectory) else 0.5)
    require_possible(body, "", where)
    middle = image.middle
    distance = float(np.linalg.norm(image.pose(middle[0]).position))
    if not body.polar < distance < _FARTHEST * body.equatorial:
        found = f"a camera {distance / KM:.6g} km from the body's centre, whose radius is {body.equatorial / KM:.6g} km"
        raise InputError(where, found, f"one outside the body and not {_FARTHEST} radii away", unit)
    with np.errstate(all="ignore"):
        ground, _ = image.image_to_ground(*middle, 0.0)
    if not np.isfinite(ground).all():
        remedy = f"check attitudes, focal length and units; {unit}"
        raise InputError(where, "a middle that looks past the body", "one that sees the ellipsoid", remedy)


START = "resected: "
"""How the remark begins of an image that starts by a case's `resection`."""


def resection_remedy(images: Sequence[PushbroomImage]) -> str:
    """What to check first where some of the images start by a resection; empty without any."""
    names = [image.name for image in images if any(remark.startswith(START) for remark in image.remarks)]
    keys = "longitude_deg, latitude_deg, altitude_km, emission_deg, north_azimuth_deg"
    return f"check resection in [[images]] of {', '.join(names[:4])} first ({keys})" if names else ""


def require_on_ground(points: Array, angles: Array, body: Ellipsoid, where: str, remedy: str = "") -> None:
    """Raise InputError, naming `where`, where most rays meet far from the ellipsoid, which then is another body's.

    Parameters
    ----------
    points : (n, 3)
        m, body-fixed, where rays of images meet by their nominal orientation.
    angles : (n,)
        rad, largest between the rays of each; NaN where they don't meet.
    body : Ellipsoid
        Of the images.
    where, remedy : str
        What has them, and what to do.
    """
    met = (angles > _CONVERGENT) & finite_rows(points)
    if np.count_nonzero(met) < _FEW or body.polar < _FLATTEST * body.equatorial:  # a plane, to which no radius belongs
        return
    measured, ground, near = distances(points[met]), surface_radii(points[met], body), nearness(body)
    if not 1.0 / near < np.median(measured / ground) < near:
        raise InputError(
            where, f"rays that meet {np.median(measured) / KM:.6g} km from the body's centre, half of them at least",
            f"points near its surface, {np.median(ground) / KM:.6g} km from there",
            remedy or "check the radii in the images' files, and that the ties are of these images",
        )  # fmt: skip


def require_flight(table: PositionTable, where: str, share: float = 1.0) -> None:
    """Raise InputError, naming `where`, for positions and velocities beyond anything in the solar system, and where
    these don't lead from position to position, in a share of all steps, which are the best.
    """
    require_near_sun(table.positions, where)
    require_slow(table.velocities, where)
    _require_led_by_velocities(table, where, share)


def require_near_sun(positions: Array, where: str) -> None:
    """Raise InputError for positions (n, 3) in m that are the body's centre or beyond the solar system."""
    distances = np.abs(positions).max(axis=1)
    for k in np.flatnonzero((distances < 1.0) | (distances > _SYSTEM))[:1]:
        found = f"position {k}, {distances[k]:g} m from the body's centre"
        raise InputError(where, found, "one outside the body, in its neighbourhood", "check the unit")


def require_slow(velocities: Array, where: str, limit: float = _FASTEST) -> None:
    """Raise InputError for velocities (..., 3) in m/s beyond a limit: by default none in the solar system has."""
    if (fastest := np.abs(velocities).max(initial=0.0)) > limit:
        raise InputError(where, f"a velocity of {fastest:g} m/s", f"at most {limit:g}", "check the unit")


def _require_led_by_velocities(table: PositionTable, where: str, share: float) -> None:
    with np.errstate(all="ignore"):
        steps = np.diff(table.times)[:, None]
        chords, means = np.diff(table.positions, axis=0) / steps, 0.5 * (table.velocities[1:] + table.velocities[:-1])
        speed = np.linalg.norm(chords, axis=1)
        off = np.linalg.norm(chords - means, axis=1) / np.where(speed > 0.0, speed, np.inf)
        off[~np.isfinite(off)] = np.inf
    if np.quantile(off, share, method="lower") > _CONTRADICTION:
        k = int(np.argmax(off))
        stated, at = np.linalg.norm(means[k]), table.times[k]
        found = f"velocities of {stated:.6g} m/s where positions move by {speed[k]:.6g} m/s, or another way"
        found += f" ({np.count_nonzero(off > _CONTRADICTION)} of {off.size} times, most {at:.6g} s past the epoch)"
        raise InputError(where, found, "those of the positions", "check units and signs of both")


def are_unit(quaternions: Array) -> bool:
    """Whether quaternions (n, 4) are not far from unit ones."""
    norms = np.linalg.norm(quaternions, axis=1)
    return bool(np.all((norms > 0.5) & (norms < 2.0)))


def turning(times: Array, quaternions: Array, rates: Array) -> tuple[Array, Array]:
    """How attitudes turn between samples, and the mean angular velocity there, (n - 1, 3) rad/s about inertial axes.

    Parameters
    ----------
    times : (n,)
        s.
    quaternions : (n, 4)
        Inertial to frame, scalar first.
    rates : (n, 3)
        rad/s about inertial axes. None of tables that their records refuse.
    """
    paired = times.size == len(quaternions) == len(rates) > 1
    if not paired or np.any(np.diff(times) <= 0.0) or not are_unit(quaternions):
        return np.zeros((0, 3)), np.zeros((0, 3))
    matrices = rotation.to_matrix(rotation.unit_vectors(quaternions))
    turned = rotation.logarithm(matrices[1:].mT @ matrices[:-1]) / np.diff(times)[:, None]
    return turned, 0.5 * (rates[1:] + rates[:-1])


def turning_otherwise(times: Array, quaternions: Array, rates: Array, noise: float = 0.0) -> str:
    """How attitudes turn differently from their angular velocities; empty where both agree.

    Parameters as of `turning`; of rates, which change between samples, the median interval counts. The noise is that of
    attitudes that were measured, rad/s.
    """
    turned, mean = turning(times, quaternions, rates)
    if not len(turned):
        return ""
    off, size = (float(np.median(np.linalg.norm(vectors, axis=1))) for vectors in (turned - mean, mean))
    if not (size > 0.0 and off > max(_CONTRADICTION * size, noise)):
        return ""
    turn = float(np.median(np.linalg.norm(turned, axis=1)))
    return f"attitudes that turn by {turn:.3g} rad/s (median), with angular velocities of {size:.3g}, or another way"


# --- images that are one and the same

_LINES = 0.5
"""Lines by which the times of their first and last edges may differ."""
_PIXELS = 1.0
"""By which what they see may differ: one image read by two roads differs by thousandths."""
_FAR = 1e3
"""m between two cameras at mid-image from which on they are of two spacecraft."""


class ImageTimes(NamedTuple):
    """When the lines of an image were taken."""

    epoch: float
    """s TDB past J2000, that of the image's trajectory."""
    timing: LineTiming
    """Times of the lines past it."""

    @classmethod
    def of(cls, image: PushbroomImage) -> "ImageTimes":
        """Of an image."""
        return cls(image.trajectory.epoch, image.timing)

    @property
    def start(self) -> float:
        """Time of the first line's first edge, s TDB past J2000."""
        return self.epoch + float(self.timing.at(np.zeros(1))[0][0])


def simultaneous_starts(times: Sequence[ImageTimes]) -> list[tuple[int, int]]:
    """Pairs of images, by their numbers, whose first lines begin at the same time; they alone can be duplicates."""
    starts = [image.start for image in times]
    order, pairs = np.argsort(starts, kind="stable").tolist(), []
    for k, first in enumerate(order):
        for second in order[k + 1 :]:
            if starts[second] - starts[first] > _LINES * float(times[first].timing.periods.max()):
                break
            pairs.append((first, second))
    return pairs


def duplicate_images(images: Sequence[PushbroomImage]) -> list[tuple[int, int]]:
    """Pairs of images, by their numbers, that are the same image under two names.

    Cameras that take images at the same time (LROC's left and right one, the channels of HRSC) look elsewhere, and are
    distinguished by that: the ground on the ellipsoid under a grid of pixels is compared.
    """
    near = simultaneous_starts([ImageTimes.of(image) for image in images])
    flown = {j: images[j].pose(images[j].middle[0]).position[0] for j in {j for pair in near for j in pair}}
    near = [(j, k) for j, k in near if np.linalg.norm(flown[j] - flown[k]) < _FAR]
    return sorted((min(pair), max(pair)) for pair in near if _same(images[pair[0]], images[pair[1]]))


def require_distinct(images: Sequence[PushbroomImage], where: str) -> None:
    """Raise InputError for one image under two names; `where` they stand."""
    for first, second in duplicate_images(images)[:1]:
        both = f"{images[first].name} and {images[second].name}"
        found = f"{both}, which are one image: the same times, the same trajectory"
        raise InputError(where, found, "each image once", "take one of the two out")


def _same(first: PushbroomImage, second: PushbroomImage) -> bool:
    if (first.lines, first.samples, first.body.equatorial) != (second.lines, second.samples, second.body.equatorial):
        return False
    end = np.array([float(first.lines)])
    stops = [image.trajectory.epoch + image.timing.at(end)[0][0] for image in (first, second)]
    if abs(stops[0] - stops[1]) > _LINES * first.timing.periods.max():
        return False
    lines, samples = all_pairs(np.linspace(0.0, first.lines, 3), np.linspace(0.0, first.samples, 3)).T
    ground, slopes = first.image_to_ground(lines, samples)
    distances = np.linalg.norm(second.image_to_ground(lines, samples)[0] - ground, axis=1)
    pixel = np.linalg.norm(slopes, axis=1).max(axis=1)
    finite = np.isfinite(distances)
    return bool(np.any(finite) and np.all(distances[finite] < _PIXELS * pixel[finite]))
