"""ISIS lidar data (JSON, what ``lrolola2isis`` and ``jigsaw`` write): to a LaserProfile, and of shots.

Kilometres, degrees and pixels counted from 1 end and begin here. Keys and units: DOI-USGS/ISIS3, LidarData.cpp (read,
write; adjusted values since ISIS 4); matrices are SurfacePoint's spherical ones: upper triangles of the covariance of
latitude, longitude (rad) and radius (m).
"""

import gc
import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.decoding import Name, Number, validated
from mgsgraph.files.networks.record import require_shown
from mgsgraph.files.opening import LARGEST_TEXT, decoded_text, head_of, json_object, read_bytes
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.body import from_planetocentric, planetocentric, planetocentric_jacobian
from mgsgraph.geometry.records import Array, Index, finite_rows
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
_WIDEST = 0.05
"""rad, of a footprint's sigma: a hundred kilometres."""
_REQUIRED, _OF_MEASURE = 10, 3
"""Keys of each shot, and of each of its measures."""
_ADJUSTED = ("adjusted_latitude", "adjusted_longitude", "adjusted_radius", "adjusted_matrix")
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
    content = read_bytes(path, LARGEST_TEXT).removeprefix(b"\xef\xbb\xbf")
    with _uncollected():
        return _profile(_shots(content, path), str(path))


@contextmanager
def _uncollected() -> Iterator[None]:
    """No garbage collection inside: millions of lists are made, and collecting would take most of the time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _shots(content: bytes, path: Path) -> list[LidarShot]:
    """Shots of a JSON text, whose keys and values are checked by their type while it is parsed."""
    with suppress(msgspec.DecodeError, UnicodeDecodeError):
        shots = msgspec.json.decode(content, type=_LidarData).points
        lists, measures = (sum(map(len, _all(shots, name))) for name in ("simultaneous_images", "measures"))
        # "points"; keys and ids; names, and keys of measures
        texts = 1 + (_REQUIRED + 1) * len(shots) + lists + (_OF_MEASURE + 1) * measures
        more = content.count(b'"') - 2 * texts  # keys of adjusted values, or one that is there twice
        if not more or more == 2 * sum(len(shots) - _all(shots, name).count(None) for name in _ADJUSTED):
            return shots
    return validated(json_object(decoded_text(content, path), str(path)), _LidarData, path).points


def _all(records: Sequence[msgspec.Struct], name: str) -> list[Any]:
    """(n) values of one attribute of records."""
    return list(map(attrgetter(name), records))


def _numbers(records: Sequence[msgspec.Struct], name: str) -> Array:
    """(n,) numbers of one attribute of records."""
    return np.fromiter(map(attrgetter(name), records), np.float64, len(records))


def _held(shots: Sequence[LidarShot], name: str) -> tuple[list[Any], Index]:
    """Items (k) of lists of shots, and the number (k,) of each item's shot."""
    lists = _all(shots, name)
    return list(chain.from_iterable(lists)), np.repeat(np.arange(len(lists)), list(map(len, lists)))


def _profile(shots: list[LidarShot], source: str) -> LaserProfile:
    """Columns of a file in SI units, and pixels counted from its corner; InputError for impossible shots."""
    longitudes, times = _numbers(shots, "longitude"), _numbers(shots, "time")
    ids, triangles = Names.of(_all(shots, "id")), _all(shots, "apriori_matrix")
    names, shot_along = _held(shots, "simultaneous_images")
    measures, shot_measured = _held(shots, "measures")
    along, measured = RepeatedNames.of(names), RepeatedNames.of(_all(measures, "serial_number"))

    def where(k: int) -> str:
        return f"{source}, points[{k}] ({shots[k].id[:60]})"

    require_shown(ids, where, "an id")
    for images, owners in ((along, shot_along), (measured, shot_measured)):
        firsts = owners[np.unique(images.numbers, return_index=True)[1]]
        require_shown(Names.of(images.distinct), [where(k) for k in firsts.tolist()].__getitem__)
    for k in np.flatnonzero((times < YEARS[0]) | (times > YEARS[1]))[:1]:
        require_years(times[[k]], where(k))
    for k in np.flatnonzero(np.abs(longitudes) > _TURN)[:1]:
        raise InputError(where(k), f"longitude {longitudes[k]:g} degrees", f"-{_TURN:g} .. {_TURN:g}")
    if (repeated := ids.first_repeated) is not None:
        first = ids.tolist().index(ids[repeated])
        raise InputError(where(repeated), f"the id {ids[repeated]!r} twice, first in points[{first}]", "each id once")
    if None in triangles:
        raise InputError(where(triangles.index(None)), "no key 'aprioriMatrix'", "the covariance of the footprint")
    pairs = np.sort(shot_measured * len(measured.distinct) + measured.numbers)
    for pair in pairs[1:][np.diff(pairs) == 0][:1]:
        k, image = divmod(int(pair), len(measured.distinct))
        found = f"two measures in image {measured.distinct[image]}"
        raise InputError(where(k), found, "one per shot", "remove the worse one")
    places = np.column_stack([longitudes * DEG, _numbers(shots, "latitude") * DEG, _numbers(shots, "radius") * KM])
    elements = np.fromiter(chain.from_iterable(triangles), np.float64, TRIANGLE * len(shots)).reshape(-1, TRIANGLE)
    for k in np.flatnonzero(elements[:, [0, 3]].max(axis=1) > _WIDEST**2)[:1]:
        found = f"sigmas of {np.sqrt(elements[k, 0]):.3g} and {np.sqrt(elements[k, 3]):.3g} rad on the ground"
        expected = f"variances of latitude and longitude in rad^2, below {_WIDEST:g} rad"
        remedy = "m^2 on the ground: divide by the radius squared"
        raise InputError(f"{where(k)}, aprioriMatrix", found, expected, remedy)
    jacobian = planetocentric_jacobian(places)
    return LaserProfile(
        source=source,
        ids=ids,
        times=times,
        ranges=_numbers(shots, "range") * KM,
        range_sigmas=_numbers(shots, "sigma_range"),
        footprints=from_planetocentric(places),
        covariances=jacobian @ elements[:, _FROM_TRIANGLE] @ jacobian.transpose(0, 2, 1),
        simultaneous_shot=shot_along,
        simultaneous_image=along,
        measure_shot=shot_measured,
        measure_image=measured,
        measures=np.column_stack([_numbers(measures, "line"), _numbers(measures, "sample")]) - ISIS_OFFSET,
    )


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
    stated = np.isfinite(covariances).all(axis=(1, 2)) & finite_rows(spherical)
    stated = np.asarray(stated & covariances.any(axis=(1, 2)))
    half = np.linalg.solve(jacobian[stated], covariances[stated])
    matrix = np.linalg.solve(jacobian[stated], half.mT)
    triangles = iter(matrix[:, *np.triu_indices(3)].tolist())
    matrices = [next(triangles) if is_stated else None for is_stated in stated]
    return np.column_stack([spherical[:, 1] / DEG, spherical[:, 0] / DEG % 360.0, spherical[:, 2] / KM]), matrices


def lidar_text(shots: Iterable[LidarShot]) -> str:
    """Lidar data as JSON, a shot in each line."""
    rows = ",\n".join(json.dumps(msgspec.to_builtins(shot), allow_nan=False) for shot in shots)
    return f'{{"points": [\n{rows}\n]}}\n'
