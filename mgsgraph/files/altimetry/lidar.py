"""ISIS lidar data (JSON, what ``lrolola2isis`` and ``jigsaw`` write): to a LaserProfile, and of shots.

Kilometres, degrees and pixels counted from 1 end and begin here. Keys and units: DOI-USGS/ISIS3, LidarData.cpp (read,
write; adjusted values since ISIS 4); matrices are SurfacePoint's spherical ones: upper triangles of the covariance of
latitude, longitude (rad) and radius (m).
"""

import json
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.decoding import Name, Number, validated
from mgsgraph.files.opening import LARGEST_TEXT, decoded_text, head_of, json_object, name_of, read_bytes
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.body import from_planetocentric, planetocentric, planetocentric_jacobian
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import YEARS, require_years
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.units import DEG, ISIS_OFFSET, KM

_FROM_TRIANGLE = np.array([[3, 1, 4], [1, 0, 2], [4, 2, 5]])
"""Where in the file's triangle (lat-lat, lat-lon, lat-rad, lon-lon, lon-rad, rad-rad) each element of the covariance of
longitude, latitude, radius stands, which is the order of `planetocentric_jacobian`."""
_HEAD, _TURN, _POLE = 4096, 360.0, 90.0
"""bytes in which JSON begins, and degrees."""
_LONGEST = 1e9
"""Of whatever unit: nothing that is measured is longer, and squares of more would be no numbers."""
TRIANGLE, LARGEST_ELEMENT = 6, 1e18
"""Elements of a covariance's upper triangle, and bound of each."""
_ONCE = tuple(key.encode() for key in (
    "id", "range", "sigmaRange", "time", "latitude", "longitude", "radius", "aprioriMatrix", "simultaneousImages",
    "measures",
))  # fmt: skip
"""Keys of each shot."""
_Length = Annotated[float, msgspec.Meta(gt=0.0, le=_LONGEST)]
_Element = Annotated[float, msgspec.Meta(ge=-LARGEST_ELEMENT, le=LARGEST_ELEMENT)]
_Triangle = Annotated[list[_Element], msgspec.Meta(min_length=TRIANGLE, max_length=TRIANGLE)]
_Latitude = Annotated[float, msgspec.Meta(ge=-_POLE, le=_POLE)]


class LidarMeasure(msgspec.Struct, rename="camel", gc=False):
    """A footprint's pixel in an image, as ISIS counts it."""

    line: Number
    sample: Number
    serial_number: Name
    """Of the image."""


class LidarShot(msgspec.Struct, rename="camel", omit_defaults=True, kw_only=True, gc=False):
    """A laser shot as the file has it: planetocentric degrees, km; sigmas of ranges in m."""

    id: Name
    range: _Length
    sigma_range: _Length
    time: Number
    """s TDB past J2000."""
    latitude: _Latitude
    longitude: Number
    radius: _Length
    apriori_matrix: _Triangle | None = None
    adjusted_latitude: Number | None = None
    adjusted_longitude: Number | None = None
    adjusted_radius: Number | None = None
    adjusted_matrix: _Triangle | None = None
    simultaneous_images: list[Name]
    """Serial numbers of the images taken along with the shot; may be empty."""
    measures: list[LidarMeasure]


class _LidarData(msgspec.Struct):
    points: Annotated[list[LidarShot], msgspec.Meta(min_length=1)]


def read_lidar(path: Path) -> LaserProfile:
    """Read ISIS lidar data.

    Parameters
    ----------
    path : Path
        JSON file.

    Returns
    -------
    LaserProfile
        In the file's order; images are called by their serial numbers.

    Raises
    ------
    InputError
        With file, points[k] and id: a key that is missing or of the wrong kind, an id twice, a range, radius or sigma
        that is not positive, a latitude beyond a pole, an image twice in a shot. A covariance that is not positive
        definite is named by its id.
    """
    if not head_of(path, _HEAD).removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"{"):
        raise InputError(str(path), "no JSON", "ISIS lidar data", "an altimeter's own file goes into [[shots]]")
    shots = _shots(read_bytes(path, LARGEST_TEXT).removeprefix(b"\xef\xbb\xbf"), path)
    _require_sound(shots, str(path))
    return _profile(shots, str(path))


def _shots(content: bytes, path: Path) -> list[LidarShot]:
    """Shots of a JSON text, whose keys and values are checked by their type while it is parsed."""
    with suppress(msgspec.DecodeError, UnicodeDecodeError):
        shots = msgspec.json.decode(content, type=_LidarData).points
        if all(content.count(b'"%b"' % key) == len(shots) for key in _ONCE):  # else a key may be there twice
            return shots
    return validated(json_object(decoded_text(content, path), str(path)), _LidarData, path).points


def _profile(shots: list[LidarShot], source: str) -> LaserProfile:
    """Columns of a file in SI units, and pixels counted from its corner."""
    places = np.array([(shot.longitude * DEG, shot.latitude * DEG, shot.radius * KM) for shot in shots])
    triangles = np.array([shot.apriori_matrix for shot in shots])
    jacobian = planetocentric_jacobian(places)
    along = [(k, name) for k, shot in enumerate(shots) for name in shot.simultaneous_images]
    measures = [(k, one) for k, shot in enumerate(shots) for one in shot.measures]
    pixels = np.array([(one.line, one.sample) for _, one in measures], dtype=np.float64).reshape(-1, 2)
    return LaserProfile(
        source=source,
        ids=Names.of([shot.id for shot in shots]),
        times=np.array([shot.time for shot in shots]),
        ranges=np.array([shot.range for shot in shots]) * KM,
        range_sigmas=np.array([shot.sigma_range for shot in shots]),
        footprints=from_planetocentric(places),
        covariances=jacobian @ triangles[:, _FROM_TRIANGLE] @ jacobian.transpose(0, 2, 1),
        simultaneous_shot=np.array([k for k, _ in along], dtype=np.int64),
        simultaneous_image=RepeatedNames.of([name for _, name in along]),
        measure_shot=np.array([k for k, _ in measures], dtype=np.int64),
        measure_image=RepeatedNames.of([one.serial_number for _, one in measures]),
        measures=pixels - ISIS_OFFSET,
    )


def _require_sound(shots: list[LidarShot], source: str) -> None:
    """Raise InputError for an id twice, an image twice in a shot, or a shot without covariance."""
    first, known = dict[str, int](), set[str]()
    for k, shot in enumerate(shots):
        where, images = f"{source}, points[{k}] ({shot.id[:60]})", [measure.serial_number for measure in shot.measures]
        name_of(shot.id, where, "an id")
        known |= {name_of(name, where, "an image's name") for name in {*shot.simultaneous_images, *images} - known}
        if not YEARS[0] <= shot.time <= YEARS[1]:
            require_years(np.array([shot.time]), where)
        if abs(shot.longitude) > _TURN:
            raise InputError(where, f"longitude {shot.longitude:g} degrees", f"-{_TURN:g} .. {_TURN:g}")
        if first.setdefault(shot.id, k) != k:
            raise InputError(where, f"the id {shot.id!r} twice, first in points[{first[shot.id]}]", "each id once")
        if shot.apriori_matrix is None:
            raise InputError(where, "no key 'aprioriMatrix'", "the covariance of the footprint")
        if len(set(images)) < len(images):
            image = next(name for name in images if images.count(name) > 1)
            raise InputError(where, f"two measures in image {image}", "one per shot", "remove the worse one")


def lidar_coordinates(positions: Array, covariances: Array) -> tuple[Array, list[list[float] | None]]:
    """Body-fixed positions (n, 3) in m and their covariances (n, 3, 3) as the file has them.

    Returns
    -------
    coordinates : (n, 3)
        Latitude, longitude (degrees) and radius (km).
    matrices : (n)
        Upper triangles; None for a covariance that is zero or not known.
    """
    spherical = planetocentric(positions)
    # rad and m in the file: longitude comes first in our Jacobian, latitude in the file
    jacobian = planetocentric_jacobian(spherical)[:, :, [1, 0, 2]]
    known = np.isfinite(covariances).all(axis=(1, 2)) & np.isfinite(spherical).all(axis=1)
    known = np.asarray(known & covariances.any(axis=(1, 2)))
    half = np.linalg.solve(jacobian[known], covariances[known])
    matrix = np.linalg.solve(jacobian[known], np.swapaxes(half, 1, 2))
    triangles = iter(matrix[:, *np.triu_indices(3)].tolist())
    matrices = [next(triangles) if there else None for there in known]
    return np.column_stack([spherical[:, 1] / DEG, spherical[:, 0] / DEG % 360.0, spherical[:, 2] / KM]), matrices


def lidar_text(shots: Iterable[LidarShot]) -> str:
    """Lidar data as JSON, a shot in each line."""
    rows = ",\n".join(json.dumps(msgspec.to_builtins(shot), allow_nan=False) for shot in shots)
    return f'{{"points": [\n{rows}\n]}}\n'
