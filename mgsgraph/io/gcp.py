"""Ground control points in the text form of the Ames Stereo Pipeline (``.gcp``) to TiePoints.

One point a line, fields apart by blanks or commas: id, latitude, longitude (degrees, geodetic), height (m) above the
ellipsoid, three sigmas (m) along body-fixed X, Y, Z, then for each image its name, column, row (first pixel's centre
0, 0) and their sigmas (pixels). Source: StereoPipeline, docs/tools/bundle_adjust.rst, "Ground control points". A file
made for its option ``--use-lon-lat-height-gcp-error`` holds sigmas along latitude, longitude and height instead; it
doesn't say so and must not be given here.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import Ellipsoid, from_geodetic
from mgsgraph.io.pvl import finite_number
from mgsgraph.io.text import read_text
from mgsgraph.ties import PointKind, TiePoints
from mgsgraph.units import DEG

_FIXED_SIGMA = 1e-10
"""m; all three sigmas at this value mean a point that is held fixed (StereoPipeline, asp::FIXED_GCP_SIGMA)."""
_FIRST_CENTRE = 0.5
"""The first pixel's centre, (0, 0) in the file, is (0.5, 0.5) inside."""
_COMMENT = re.compile(r"(?:^|(?<=[\s,]))#.*")
_SEPARATOR = re.compile(r"[\s,]+")
_POINT_FIELDS, _MEASURE_FIELDS = 7, 5


@dataclass(slots=True, eq=False)
class _Rows:
    """Columns of a TiePoints while the file is read."""

    lines: dict[str, int] = field(default_factory=dict)
    """By point id, in the file's order: its line."""
    places: list[tuple[float, float, float]] = field(default_factory=list)
    sigmas: list[list[float]] = field(default_factory=list)
    measure_point: list[int] = field(default_factory=list)
    measure_image: list[str] = field(default_factory=list)
    measures: list[tuple[float, float]] = field(default_factory=list)
    measure_sigmas: list[tuple[float, float]] = field(default_factory=list)


def read_ground_control(path: Path, ellipsoid: Ellipsoid) -> TiePoints:
    """Read ground control points.

    Parameters
    ----------
    path : Path
        ``.gcp`` file.
    ellipsoid : Ellipsoid
        To which latitudes and heights refer.

    Returns
    -------
    TiePoints
        In the file's order, all CONSTRAINED but those whose three sigmas are 1e-10 m, which are FIXED.

    Raises
    ------
    InputError
        With file, line and point: a wrong number of fields, a field that is no finite number, a sigma that is not
        positive, a latitude beyond a pole, an id twice, an image twice in a point, or no point at all.
    """
    rows = _Rows()
    for number, line in enumerate(read_text(path).split("\n"), start=1):
        fields = [part for part in _SEPARATOR.split(_COMMENT.sub("", line)) if part]
        if fields:
            _add_point(rows, fields, number, f"{path}, line {number}")
    if not rows.lines:
        raise InputError(str(path), "no ground control point", "one per line: id latitude longitude height sigmas")
    sigmas = np.array(rows.sigmas)
    fixed = np.all(sigmas == _FIXED_SIGMA, axis=1)
    variances = np.where(fixed[:, None], 0.0, sigmas**2)
    return TiePoints(
        source=str(path),
        ids=tuple(rows.lines),
        kinds=np.where(fixed, PointKind.FIXED, PointKind.CONSTRAINED),
        places=from_geodetic(np.array(rows.places), ellipsoid),
        covariances=variances[:, :, None] * np.eye(3),
        measure_point=np.array(rows.measure_point, dtype=np.int64),
        measure_image=tuple(rows.measure_image),
        measures=np.array(rows.measures, dtype=np.float64).reshape(-1, 2) + _FIRST_CENTRE,
        measure_sigmas=np.array(rows.measure_sigmas, dtype=np.float64).reshape(-1, 2),
    )


def _add_point(rows: _Rows, fields: list[str], line: int, where: str) -> None:
    name, where = fields[0], f"{where}, point {fields[0]}"
    if len(fields) < _POINT_FIELDS or (len(fields) - _POINT_FIELDS) % _MEASURE_FIELDS:
        raise InputError(where, f"{len(fields)} fields", f"{_POINT_FIELDS}, and {_MEASURE_FIELDS} more for each image")
    if name in rows.lines:
        raise InputError(where, f"the id twice, first in line {rows.lines[name]}", "each id once")
    names = ("latitude", "longitude", "height")
    latitude, longitude, height = (
        _number(text, f"{where}, {what}") for what, text in zip(names, fields[1:4], strict=True)
    )
    if abs(latitude) > 90.0:
        raise InputError(f"{where}, latitude", f"{latitude:g} degrees", "-90 .. 90", "latitude comes before longitude")
    rows.lines[name] = line
    rows.places.append((longitude * DEG, latitude * DEG, height))
    rows.sigmas.append([_positive(text, f"{where}, sigma") for text in fields[4:_POINT_FIELDS]])
    images: set[str] = set()
    for start in range(_POINT_FIELDS, len(fields), _MEASURE_FIELDS):
        images.add(_add_measure(rows, fields[start : start + _MEASURE_FIELDS], images, where))


def _add_measure(rows: _Rows, fields: list[str], images: set[str], where: str) -> str:
    """Append a measure of the last point; returns its image."""
    image = fields[0]
    where = f"{where}, image {image}"
    if image in images:
        raise InputError(where, "a second measure in this image", "one per point", "remove the worse one")
    column, row = _number(fields[1], f"{where}, column"), _number(fields[2], f"{where}, row")
    column_sigma = _positive(fields[3], f"{where}, column sigma")
    row_sigma = _positive(fields[4], f"{where}, row sigma")
    rows.measure_point.append(len(rows.lines) - 1)
    rows.measure_image.append(image)
    rows.measures.append((row, column))
    rows.measure_sigmas.append((row_sigma, column_sigma))
    return image


def _number(text: str, where: str) -> float:
    try:
        return finite_number(text)
    except ValueError:
        raise InputError(where, f"{text[:60]!r}", "a finite number") from None


def _positive(text: str, where: str) -> float:
    value = _number(text, where)
    if value <= 0.0:
        raise InputError(where, f"{value:g}", "a positive number")
    return value
