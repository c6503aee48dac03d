"""Images of which no kernels are at hand: a start of orbit and attitude by the label and by tie points.

The orbit is a circle. Its plane is that of another image's orbit turned about the pole until it passes over the middle
of the image, ascending or descending as that one; inertial speeds are as 1 / sqrt(distance from the body's centre). The
camera is turned about its optical axis as that of the other image and looks at the body's centre, or aside by the
emission angle. All else is the adjustment's: the start is where the orientation corrections are zero, and their priors
are wide.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mgsgraph.case.schema import RESECTED, CaseInput, ImageInput, ResectionInput
from mgsgraph.errors import InputError, require
from mgsgraph.files.cameras.camera import LineScanLabel, NaifKeywords, times_of_label
from mgsgraph.files.cameras.label import read_line_scan_label
from mgsgraph.files.labels.label_statements import require_usual_label
from mgsgraph.files.networks.table import read_tie_points
from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.files.pvl import read_label
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import east_north, from_planetocentric, is_another, surface_radii, target_name
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.plausibility import START, require_plausible
from mgsgraph.geometry.records import Array, finite_rows
from mgsgraph.geometry.trajectory import circular_flight, flight_frame, tdb_of_utc
from mgsgraph.units import DEG, KM

_BEYOND = 0.5
"""s, of the orbit before the first line and after the last one."""
_STOP_SLACK = 0.1
"""s by which the last line may end after the label's STOP_TIME, which is rounded."""
_REMEDY = "name its kernels, or give its support data"


class _Flight(NamedTuple):
    """How another image was taken, in its middle."""

    place: Array
    """(3,) m, body-fixed."""
    velocity: Array
    """(3,) m/s, in inertial space, body-fixed axes."""
    spin: Array
    """(3,) rad/s, of the body."""
    turn: float
    """rad, of the camera about its optical axis, from the direction of flight to the right."""

    @classmethod
    def of(cls, image: PushbroomImage) -> "_Flight":
        pose, (_, period) = image.pose(image.middle[0]), image.timing.at(image.middle[0])
        place, spin = pose.position[0], np.zeros(3) if image.trajectory.spin is None else image.trajectory.spin
        velocity = pose.velocity[0] / period + np.cross(spin, place)
        turned = pose.matrix[0] @ flight_frame(place, velocity).T
        return cls(place, velocity, spin, float(np.arctan2(turned[0, 1], turned[0, 0])))

    def over(self, place: Array) -> Array:
        """(3,) m/s, velocity in inertial space of such an orbit at a place (3,) in m, horizontal.

        cos(inclination) = cos(latitude) sin(azimuth) in the right-angled triangle of node, place and equator.
        """
        normal = rotation.unit_vectors(np.cross(self.place, self.velocity))
        up = rotation.unit_vectors(place)
        sine = np.clip(normal[2] / np.hypot(up[0], up[1]), -1.0, 1.0)
        cosine = np.sqrt(1.0 - sine**2) * (1.0 if self.velocity[2] >= 0.0 else -1.0)
        speed = np.linalg.norm(self.velocity) * np.sqrt(np.linalg.norm(self.place) / np.linalg.norm(place))
        return np.asarray(speed * (np.array([sine, cosine]) @ east_north(place[None])[0]))


def resected_images(tables: CaseInput, known: Mapping[int, PushbroomImage], path: Path) -> dict[int, PushbroomImage]:
    """Images of a case that have a table `resection`, by their numbers.

    Parameters
    ----------
    tables : CaseInput
        The case file, its images plain (`case_file.decode`).
    known : mapping
        The other images by their numbers.
    path : Path
        Where the case file is.

    Raises
    ------
    InputError
        No other image, a label whose camera has no constants here or no line times, no place: neither stated nor by
        tie points that other images see, too.
    """
    entries = {j: entry for j, entry in enumerate(tables.images) if entry.resection is not None}
    if not entries:
        return {}
    where = {j: f"{path}, images[{j}], resection" for j in entries}
    if not known:
        found, expected = "no image with an orbit in the case", "one whose orbit it resembles"
        raise InputError(next(iter(where.values())), found, expected, _REMEDY)
    body = next(iter(known.values())).body
    ties = [read_tie_points(path.parent / group.network, body) for group in tables.tie_groups]
    return {j: _resected(entry, known, ties, path.parent, where[j]) for j, entry in entries.items()}


def _resected(
    entry: ImageInput, known: Mapping[int, PushbroomImage], ties: Sequence[TiePoints], folder: Path, where: str
) -> PushbroomImage:
    stated, file = entry.resection, entry.label or entry.cube
    assert stated is not None
    assert file is not None
    require(not entry.kernels, where, "kernels beside it", "one of the two", "take one of them out")
    require(not entry.held, where, "held = true beside it", "a start that is adjusted", "hold the other image, or none")
    images = {image.name: image for image in known.values()}
    like = images.get(stated.like) if stated.like else next(iter(images.values()))
    if like is None:
        raise InputError(f"{where}, like", repr(stated.like), f"an image with an orbit: {', '.join(list(images)[:4])}")
    if (stated.longitude_deg is None) != (stated.latitude_deg is None):
        raise InputError(where, "one of longitude_deg and latitude_deg", "both, or neither: by tie points")
    label = read_line_scan_label(folder / file)
    if "PDS_VERSION_ID" in (root := read_label(label.path)):
        require_usual_label(root, str(label.path))
    if stated.longitude_deg is None or stated.latitude_deg is None:
        measures, met = _ties_on_ellipsoid(entry.name, ties, images, where)
        ground, source = ground_in_middle(label, measures, met), f"by {len(met)} tie points"
    else:
        direction = from_planetocentric(np.array([stated.longitude_deg * DEG, stated.latitude_deg * DEG, 1.0]))
        ground, source = direction * surface_radii(direction[None], like.body), "as stated"
    image = nominal_image(label, like, ground, stated, entry.name)
    require_plausible(image, where if stated.altitude_km is None else f"{where}, altitude_km")
    sigmas = f"{RESECTED['position_sigma_m']:g} m and {RESECTED['angle_sigma_mrad']:g} mrad unless stated"
    return replace(image, remarks=(f"{START}circular orbit like {like.name}'s, middle {source}; sigmas {sigmas}",))


def nominal_image(
    label: LineScanLabel, like: PushbroomImage, ground: Array, stated: ResectionInput | None = None, name: str = ""
) -> PushbroomImage:
    """An image by its label, from a circular orbit over its middle; see the module.

    Parameters
    ----------
    label : LineScanLabel
        With its start in UTC, and its line period.
    like : PushbroomImage
        Whose orbit it resembles.
    ground : (3,)
        m, body-fixed, middle of the image.
    stated : ResectionInput, optional
        Altitude, emission angle and north azimuth; those of `like`, and nadir, when absent.
    name : str
        By which networks call the image; the product id when empty.

    Raises
    ------
    InputError
        A label of another body, of a camera whose constants or line times only kernels know, or without a start time.
    """
    stated, body, file = stated or ResectionInput(), like.body, str(label.path)
    if is_another(body, label.target):
        raise InputError(file, f"an image of {label.target}", f"one of {target_name(body)}, as {like.name}")
    camera, flight = label.camera, _Flight.of(like)
    if not (camera.constants and label.utc and label.period > 0.0) or camera.line_times is not times_of_label:
        found = f"{camera.name}, whose constants or line times only kernels know"
        raise InputError(file, found, "a camera that needs none (MOC)", _REMEDY)
    interior = camera.interior(NaifKeywords(file, camera.constants), label)
    start = float(tdb_of_utc([label.utc], f"{file}, start time")[0])
    times = times_of_label(NaifKeywords(file, camera.constants), label, start, np.nan)
    stop = float(tdb_of_utc([label.stop], f"{file}, stop time")[0]) if label.stop else np.inf
    if times.stop > stop + _STOP_SLACK:
        found = f"{label.lines} lines of {label.period:.6g} s, {times.stop - stop:.3f} s past the stop time"
        raise InputError(file, found, f"an end by {label.stop}", "check lines, line period and summing")
    epoch = 0.5 * (times.start + times.stop)
    usual = float(np.linalg.norm(flight.place) - surface_radii(flight.place[None], body)[0])
    altitude = usual if stated.altitude_km is None else stated.altitude_km * KM
    place, aside = _camera_place(ground, altitude, stated.emission_deg * DEG, flight)
    velocity, turn = flight.over(place), flight.turn
    if stated.north_azimuth_deg is not None:
        east, north = east_north(place[None])[0] @ velocity
        slope = interior.focal_plane(np.array([0.5 * label.samples]))[1][0]
        turn = -stated.north_azimuth_deg * DEG - float(np.arctan2(east, north) + np.arctan2(slope[1], slope[0]))
    attitude = rotation.exponential(np.array([0.0, 0.0, -turn])) @ rotation.exponential(np.array([aside, 0.0, 0.0]))
    half = 0.5 * (times.stop - times.start) + _BEYOND
    trajectory = circular_flight(epoch, half, place, velocity, flight.spin, attitude)
    return PushbroomImage(
        name or label.product,
        label.lines,
        label.samples,
        interior,
        times.timing(epoch),
        trajectory,
        body,
        mission=camera.mission,
    )


def _camera_place(ground: Array, altitude: float, emission: float, flight: _Flight) -> tuple[Array, float]:
    """Place (3,) in m of a camera at an altitude above the middle of its image, and the angle off the nadir at which it
    looks to the right of the flight: in the triangle with the body's centre, sin(angle) = R sin(emission) / r.
    """
    radius = float(np.linalg.norm(ground))
    distance = radius + altitude
    aside = float(np.arcsin(radius * np.sin(emission) / distance))
    along = rotation.unit_vectors(flight.over(ground))
    return rotation.exponential((aside - emission) * along) @ ground * (distance / radius), aside


def ground_in_middle(label: LineScanLabel, measures: Array, ground: Array) -> Array:
    """Ground (3,) in m, body-fixed, in the middle of an image by an affine map from line and sample (n, 2), the first
    pixel's centre at (0.5, 0.5), to ground (n, 3); n may be 1, and the image's scale is then left out.
    """
    centre, middle = measures.mean(axis=0), np.array([0.5 * label.lines, 0.5 * label.samples])
    slopes = np.linalg.lstsq(measures - centre, ground - ground.mean(axis=0), rcond=None)[0]
    return np.asarray(ground.mean(axis=0) + (middle - centre) @ slopes)


def _ties_on_ellipsoid(
    name: str, ties: Sequence[TiePoints], images: Mapping[str, PushbroomImage], where: str
) -> tuple[Array, Array]:
    """Measures (n, 2) of tie points in an image, and where other images see these on the ellipsoid (n, 3) in m."""
    measures, ground = [np.zeros((0, 2))], [np.zeros((0, 3))]
    for points in ties:
        names = points.measure_image.over([name, *images])
        own = np.flatnonzero(names == 0)
        for j, image in enumerate(images.values(), start=1):
            other = np.flatnonzero(names == j)
            _, first, second = np.intersect1d(points.measure_point[own], points.measure_point[other], True, True)
            measures.append(points.measures[own[first]])
            ground.append(image.image_to_ground(*points.measures[other[second]].T)[0])
    places, met = np.concatenate(measures), np.concatenate(ground)
    sound = finite_rows(met)
    found = f"no tie point that {name} and an image with an orbit measure, and no place"
    require(sound.any(), where, found, "tie points in [ties], or longitude_deg and latitude_deg of its middle")
    return places[sound], met[sound]
