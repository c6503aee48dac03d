"""A candidates file (TOML): images, laser profiles and control points that might be observed; units in the key names.

Paths are relative to the file. What is there is read, and becomes candidates over a network that was adjusted.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from mgsgraph.case.case_file import read_image
from mgsgraph.case.motion import Positive, Sigma
from mgsgraph.case.schema import ImageInput, OrientationInput, SpiceInput
from mgsgraph.errors import InputError, errors_from, require
from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.decoding import read_toml, validated
from mgsgraph.geometry.altimetry import require_on_body
from mgsgraph.geometry.body import east_north_up, from_geodetic, from_planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.network.footprints import footprints_in_images
from mgsgraph.network.parts import KnownImage
from mgsgraph.planning.candidates import (
    Candidate,
    PlannedShots,
    PlannedTies,
    planned_image,
    planned_point,
    planned_profile,
    require_candidates,
)
from mgsgraph.planning.coverage import ImageCoverage
from mgsgraph.planning.state import NetworkState
from mgsgraph.text import some
from mgsgraph.units import DEG
from mgsgraph.workers import no_progress

_MOST_TIES, _MOST_SHOTS = 100_000, 1_000_000
_NAME_THE_IMAGE = "name it: image = ... in [[profiles]]"
_FAR = 0.1
"""Share of the body's radius by which a control point may be off it."""


class CandidateImage(ImageInput, forbid_unknown_fields=True, frozen=True):
    """An image that might be added: as in a case file, and the tie points that it would get."""

    ties: Annotated[int, msgspec.Meta(ge=0, le=_MOST_TIES)] = 20
    """New tie points on an even grid over each overlap with an image of the network, each measured in all images that
    show it."""
    sigma_px: Sigma = 1.0
    """Sigma of line and sample of these; in the candidate measure_sigma_px, where that is said."""
    existing: bool = False
    """Whether tie points of the network that it shows are measured in it, too."""


class CandidateProfile(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A laser profile that might be taken in: its shots' file, or the track of an image of the network."""

    name: Annotated[str, msgspec.Meta(min_length=1)]
    """What to call it."""
    file: str | None = None
    """ISIS lidar data (.json), PEDR binary (.b) or table: footprints and times count, ranges and heights needn't."""
    image: str | None = None
    """Image of the network whose trajectory carries the ranges; with a file, found by its times when absent."""
    every_s: Positive | None = None
    """Without a file: a shot every so many seconds at the nadir of the image, from its first line to its last."""
    range_sigma_m: Sigma = 10.0
    """Sigma of the ranges."""
    ground_sigma_m: Sigma = 10.0
    """Sigma of each footprint in each direction."""
    shift_sigma_m: Sigma | None = None
    """Sigma of the profile's common horizontal error, which becomes an unknown; absent: none."""
    image_sigma_px: Sigma | None = None
    """Sigma of the footprints' image coordinates, in all images that show them; absent: they aren't measured."""
    ranges: bool = True
    """Use the ranges."""


class CandidateControl(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A ground control point that might be surveyed."""

    name: Annotated[str, msgspec.Meta(min_length=1)]
    """What to call it."""
    longitude_deg: Annotated[float, msgspec.Meta(ge=-360.0, le=360.0)]
    """East."""
    latitude_deg: Annotated[float, msgspec.Meta(ge=-90.0, le=90.0)]
    """Geodetic with height_m, planetocentric with radius_m."""
    height_m: float | None = None
    """Above the ellipsoid."""
    radius_m: Positive | None = None
    """From the body's centre, instead."""
    sigma_m: Sigma | list[Sigma] = 1.0
    """Sigma of the place: one number, or eastward, northward and upward."""
    sigma_px: Sigma = 1.0
    """Sigma of line and sample in all images that show it."""


class CandidatesInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A candidates file."""

    format: int
    """Version of this layout: that of case files."""
    orientation: OrientationInput = OrientationInput()
    """For images without sigmas of their own."""
    spice: SpiceInput | None = None
    """SPICE kernels for images that name none."""
    images: tuple[CandidateImage, ...] = ()
    """Images."""
    profiles: tuple[CandidateProfile, ...] = ()
    """Laser profiles."""
    control: tuple[CandidateControl, ...] = ()
    """Control points."""


def read_candidates(
    path: str | Path, state: NetworkState, progress: Callable[[int, int], None] = no_progress
) -> tuple[Candidate, ...]:
    """Read a candidates file and everything that it names, and plan the measures of each candidate.

    Parameters
    ----------
    path : path
        TOML file.
    state : NetworkState
        The network over which they are planned.
    progress : callable
        Called with how many are planned, and how many there are.

    Raises
    ------
    InputError
        With the place, the finding and the remedy: no candidate, unknown keys, a name that is in the network already.
    """
    path = Path(path)
    tables = decode_candidates(path)
    kinds = (tables.images, tables.profiles, tables.control)
    names = [entry.name for kind in kinds for entry in kind]
    require_candidates(str(path), names)
    coverage, candidates = ImageCoverage(state), list[Candidate]()
    plans = [
        *(partial(_image, coverage, entry, tables, path, k) for k, entry in enumerate(tables.images)),
        *(partial(_profile, coverage, entry, path, k) for k, entry in enumerate(tables.profiles)),
        *(partial(_control, coverage, entry, path, k) for k, entry in enumerate(tables.control)),
    ]
    for planned in plans:
        with errors_from(str(path)):
            candidates.append(planned())
        progress(len(candidates), len(plans))
    return tuple(candidates)


def decode_candidates(path: Path) -> CandidatesInput:
    """A candidates file's tables, validated; InputError with the path of what is wrong."""
    return validated(read_toml(path, "candidates file"), CandidatesInput, path, "see docs/plan.md")


def _image(coverage: ImageCoverage, entry: CandidateImage, tables: CandidatesInput, path: Path, k: int) -> Candidate:
    where = f"{path}, images[{k}]"
    orientation = entry.orientation or tables.orientation
    ties = PlannedTies(entry.ties, entry.sigma_px, entry.measure_sigma_px, entry.existing)
    found = f"the image {entry.name!r}, which is in the network already"
    require(entry.name not in coverage.views, where, found, "a new image", "take it out of the candidates")
    image = read_image(entry, tables.spice, path.parent, where)
    require(image.body == coverage.network.body, where, "an image of another body than the network's", "one body")
    image = orientation.nominal_of(image)
    stated = f"{where}.orientation" if entry.orientation else f"{path}, orientation"
    prior = orientation.prior(stated, image.mission)
    return planned_image(coverage, KnownImage(image, prior, entry.held), ties)


def _profile(coverage: ImageCoverage, entry: CandidateProfile, path: Path, k: int) -> Candidate:
    where = f"{path}, profiles[{k}]"
    if (entry.file is None) == (entry.every_s is None):
        found = "neither file nor every_s" if entry.file is None else "both file and every_s"
        raise InputError(where, found, "a file, or image and every_s")
    if entry.image is not None:
        names, found = some(list(coverage.views)), f"the image {entry.image!r}"
        require(entry.image in coverage.views, where, found, f"an image of the network ({names})")
    elif entry.file is None:
        raise InputError(where, "every_s without image", "the image of the network along whose track shots are planned")
    if entry.file is None:
        times, footprints, image = _track(coverage, entry, where)
    elif entry.file.lower().endswith(".json"):
        times, footprints, image = _of_lidar(coverage, entry, path.parent / entry.file)
    else:
        times, footprints, image = _of_pedr(coverage, entry, path.parent / entry.file)
    n = times.size
    shots = PlannedShots(
        times, footprints, image if entry.ranges else None, np.full(n, entry.range_sigma_m),
        np.broadcast_to(np.eye(3) * entry.ground_sigma_m**2, (n, 3, 3)), entry.shift_sigma_m, entry.image_sigma_px,
    )  # fmt: skip
    return planned_profile(coverage, entry.name, shots)


_Shots = tuple[Array, Array, str | None]
"""Times (n,) in s TDB past J2000, footprints (n, 3) in m, and the image that carries the ranges."""


def _track(coverage: ImageCoverage, entry: CandidateProfile, where: str) -> _Shots:
    """Shots at the nadir of an image, evenly in time about its middle."""
    assert entry.image is not None
    assert entry.every_s is not None
    view = coverage.views[entry.image]
    first, last = view.image.span
    count = int((last - first) / entry.every_s) + 1
    if count > _MOST_SHOTS:
        raise InputError(f"{where}, every_s", f"{count} shots", f"at most {_MOST_SHOTS}", "take a longer interval")
    times = 0.5 * (first + last) + entry.every_s * (np.arange(count) - 0.5 * (count - 1))
    return times, coverage.below(view.positions(times), view.height), entry.image


def _of_lidar(coverage: ImageCoverage, entry: CandidateProfile, path: Path) -> _Shots:
    """Shots of ISIS lidar data that were taken along with one image of the network (or with the one named)."""
    profile = read_lidar(path)
    require_on_body(profile.footprints, coverage.network.body, profile.source, profile.ids)
    named = sorted(name for name in profile.simultaneous_image.used if name in coverage.views)
    if entry.image is None and len(named) > 1:
        raise InputError(str(path), f"shots simultaneous with {' and '.join(named)}", "one image", _NAME_THE_IMAGE)
    if not (entry.image or named):
        return profile.times, profile.footprints, None
    owner = entry.image or named[0]
    shots = np.unique(profile.simultaneous_shot[profile.simultaneous_image.over([owner]) == 0])
    return profile.times[shots], profile.footprints[shots], owner


def _of_pedr(coverage: ImageCoverage, entry: CandidateProfile, path: Path) -> _Shots:
    """Shots of MOLA that fall in images: those taken along with one of them (or with the one named), if any were."""
    shots, views = read_shots(path), list(coverage.views.values())
    require_on_body(shots.footprints, coverage.network.body, shots.source)
    images, corrections = [view.image for view in views], [view.correction for view in views]
    hits = footprints_in_images(images, shots, corrections)
    if entry.image is not None:
        owner: int | None = [image.name for image in images].index(entry.image)
    else:
        owner = hits.simultaneous_image(shots.ground, _NAME_THE_IMAGE)
    inside = np.any(hits.inside, axis=0) if owner is None else hits.inside[owner] & hits.simultaneous[owner]
    chosen = inside & shots.ground
    return shots.times[chosen], shots.footprints[chosen], None if owner is None else images[owner].name


def _control(coverage: ImageCoverage, entry: CandidateControl, path: Path, k: int) -> Candidate:
    where = f"{path}, control[{k}]"
    if (entry.height_m is None) == (entry.radius_m is None):
        found = "neither height_m nor radius_m" if entry.height_m is None else "both height_m and radius_m"
        raise InputError(where, found, "one of them")
    at = entry.longitude_deg * DEG, entry.latitude_deg * DEG
    if entry.height_m is not None:
        place = from_geodetic(np.array([*at, entry.height_m]), coverage.network.body)
    else:
        place = from_planetocentric(np.array([[*at, entry.radius_m]]))[0]
    radius = coverage.network.body.equatorial
    if abs(float(np.linalg.norm(place)) - radius) > _FAR * radius:
        found = f"a point {np.linalg.norm(place):.6g} m from the body's centre"
        raise InputError(where, found, f"one near the ground, {radius:.6g} m from it", "give metres")
    sigmas = np.atleast_1d(np.asarray(entry.sigma_m, dtype=np.float64))
    if sigmas.size not in (1, 3):
        raise InputError(f"{where}, sigma_m", f"{sigmas.size} numbers", "one, or three: eastward, northward, upward")
    axes = east_north_up(place[None])[0]
    covariance = axes.T @ np.diag(np.broadcast_to(sigmas, 3) ** 2) @ axes
    return planned_point(coverage, entry.name, place, covariance, entry.sigma_px)
