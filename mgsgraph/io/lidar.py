"""ISIS lidar data (JSON, what ``lrolola2isis`` and ``jigsaw`` write) to a LaserProfile.

Kilometres, degrees and pixels counted from 1 end here. Keys and units: ISIS LidarData::read and ::write; the matrix is
SurfacePoint's spherical one, the covariance of latitude, longitude (rad) and radius (m).
"""

from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.body import from_planetocentric, planetocentric_jacobian
from mgsgraph.geometry.records import Array
from mgsgraph.io.files import read_json
from mgsgraph.io.json_fields import Fields
from mgsgraph.units import DEG, ISIS_OFFSET, KM

_FROM_TRIANGLE = np.array([[3, 1, 4], [1, 0, 2], [4, 2, 5]])
"""Where in the file's triangle (lat-lat, lat-lon, lat-rad, lon-lon, lon-rad, rad-rad) each element of the covariance of
longitude, latitude, radius stands, which is the order of `planetocentric_jacobian`."""


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
    values = read_json(path)
    shots = Fields(values, str(path)).sections("points")
    if not shots:
        raise InputError(f"{path}, points", "an empty list", "laser shots")
    ids = _named(shots)
    places = np.array([_place(shot) for shot in shots])
    covariances = _covariances(places, np.array([shot.numbers("aprioriMatrix", 6) for shot in shots], dtype=np.float64))
    measures = [_measures(shot) for shot in shots]
    flat = [measure for of_shot in measures for measure in of_shot]
    return LaserProfile(
        source=str(path),
        ids=ids,
        times=np.array([shot.number("time") for shot in shots]),
        ranges=np.array([shot.positive("range") * KM for shot in shots]),
        range_sigmas=np.array([shot.positive("sigmaRange") for shot in shots]),
        footprints=from_planetocentric(places),
        covariances=covariances,
        simultaneous=tuple(
            _names(raw.get("simultaneousImages"), shot.where) for raw, shot in zip(values["points"], shots, strict=True)
        ),
        measure_shot=np.repeat(np.arange(len(ids)), [len(of_shot) for of_shot in measures]),
        measure_image=tuple(image for image, _, _ in flat),
        measures=np.array([place for _, *place in flat], dtype=np.float64).reshape(-1, 2) - ISIS_OFFSET,
    )


def _named(shots: list[Fields]) -> tuple[str, ...]:
    """The shots' ids, each once; from here on messages about a shot carry its id."""
    first: dict[str, str] = {}
    for shot in shots:
        name = shot.text("id")
        if name in first:
            raise InputError(shot.where, f"the id {name!r} twice, first at {first[name]}", "each id once")
        first[name] = shot.where
        shot.where = f"{shot.where}, {name}"
    return tuple(first)


def _place(shot: Fields) -> tuple[float, float, float]:
    """Longitude, latitude (rad, planetocentric), radius (m)."""
    latitude = shot.number("latitude")
    if abs(latitude) > 90.0:
        raise InputError(f"{shot.where}, latitude", f"{latitude:g} degrees", "-90 .. 90")
    return shot.number("longitude") * DEG, latitude * DEG, shot.positive("radius") * KM


def _covariances(places: Array, triangles: Array) -> Array:
    """(n, 3, 3) m^2, body-fixed, from places (n, 3) and the file's triangles (n, 6)."""
    jacobian = planetocentric_jacobian(places)
    return np.asarray(jacobian @ triangles[:, _FROM_TRIANGLE] @ jacobian.transpose(0, 2, 1))


def _measures(shot: Fields) -> list[tuple[str, float, float]]:
    """Image, line and sample as the file counts them."""
    measures: dict[str, tuple[str, float, float]] = {}
    for measure in shot.sections("measures"):
        image = measure.text("serialNumber")
        if image in measures:
            found = f"a second measure in image {image}"
            raise InputError(measure.where, found, "one per shot", "remove the worse one")
        measures[image] = (image, measure.number("line"), measure.number("sample"))
    return list(measures.values())


def _names(value: object, where: str) -> tuple[str, ...]:
    """The names in `simultaneousImages`; a list without any says that no image was taken along with the shot."""
    if not isinstance(value, list) or not all(isinstance(name, str) and name for name in value):
        found = "no such list" if value is None else f"{str(value)[:60]!r}"
        raise InputError(f"{where}, simultaneousImages", found, "a list of serial numbers")
    return tuple(value)
