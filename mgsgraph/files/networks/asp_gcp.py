"""Ground control points in the text form of the Ames Stereo Pipeline (``.gcp``): to TiePoints, to and from networks.

One point a line, fields apart by blanks or commas: id, latitude, longitude (degrees, geodetic), height (m) above the
ellipsoid, three sigmas (m) along body-fixed X, Y, Z, then for each image its name, column, row (first pixel's centre
0, 0) and their sigmas (pixels). Source: StereoPipeline, docs/tools/bundle_adjust.rst, "Ground control points". A file
made for its option ``--use-lon-lat-height-gcp-error`` holds sigmas along latitude, longitude and height instead; it
doesn't say so and must not be given here. Ids are whole numbers to the pipeline, which skips lines with others
(VisionWorkbench, src/vw/BundleAdjustment/ControlNetworkLoader.cc, add_ground_control_points); here they may be names.
"""

import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.networks.asp_measures import (
    COMMENT,
    RENAME,
    SEPARATOR,
    UNSTATED_SIGMA,
    PixelMeasures,
    candidate,
    filled_lines,
    measures_of,
)
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, PointType, with_names
from mgsgraph.files.networks.tie_points import tie_points
from mgsgraph.files.opening import number_of
from mgsgraph.files.tie_points import TiePoints
from mgsgraph.geometry.body import Ellipsoid, from_geodetic, geodetic
from mgsgraph.units import DEG

_FIXED_SIGMA = 1e-10
"""m; all three sigmas at this value mean a point that is held fixed (StereoPipeline, asp::FIXED_GCP_SIGMA)."""
_KNOWN = frozenset({PointType.CONSTRAINED, PointType.FIXED})
_DIAGONAL = (0, 3, 5)
"""Of xx, xy, xz, yy, yz, zz."""
_NUMBERED = re.compile(r"[0-9]{1,9}")
_TURN = 360.0
"""Degrees of a longitude at most, east or west."""
_LARGEST = 1e100
"""Of sigmas, whose squares must be numbers."""
_POINT_FIELDS, _MEASURE_FIELDS = 7, 5


def read_ground_control(path: Path, ellipsoid: Ellipsoid) -> TiePoints:
    """Read ground control points for an adjustment; see `read_ground_control_network`."""
    return tie_points(read_ground_control_network(path, ellipsoid), body=ellipsoid)


def read_ground_control_network(path: Path, ellipsoid: Ellipsoid) -> ControlNetwork:
    """Read ground control points.

    Parameters
    ----------
    path : Path
        ``.gcp`` file.
    ellipsoid : Ellipsoid
        To which latitudes and heights refer.

    Returns
    -------
    ControlNetwork
        In the file's order, all constrained but those whose three sigmas are 1e-10 m, which are fixed.

    Raises
    ------
    InputError
        With file, line and point: a wrong number of fields, a field that is no finite number, a sigma that is not
        positive, a latitude beyond a pole, an id twice, an image twice in a point, or no point at all.
    """
    points = dict[str, tuple[str, ControlPoint]]()
    for line, fields in filled_lines(path, ground_control=True):
        where = f"{line}, point {fields[0]}"
        if fields[0] in points:
            found = f"the id twice, first in{points[fields[0]][0].removeprefix(f'{path},')}"
            raise InputError(where, found, "each id once")
        points[fields[0]] = line, _point(fields, ellipsoid, where)
    if not points:
        raise InputError(str(path), "no ground control point", "one per line: id latitude longitude height sigmas")
    return with_names(ControlNetwork("", "", tuple(point for _, point in points.values()), source=str(path)))


def _point(fields: list[str], ellipsoid: Ellipsoid, where: str) -> ControlPoint:
    if len(fields) < _POINT_FIELDS or (len(fields) - _POINT_FIELDS) % _MEASURE_FIELDS:
        raise InputError(where, f"{len(fields)} fields", f"{_POINT_FIELDS}, and {_MEASURE_FIELDS} more for each image")
    latitude, longitude, height = (
        number_of(text, f"{where}, {what}")
        for text, what in zip(fields[1:4], ("latitude", "longitude", "height"), strict=True)
    )
    if abs(latitude) > 90.0:
        raise InputError(f"{where}, latitude", f"{latitude:g} degrees", "-90 .. 90", "latitude comes before longitude")
    if abs(longitude) > _TURN:
        raise InputError(f"{where}, longitude", f"{longitude:g} degrees", f"-{_TURN:g} .. {_TURN:g}")
    sigmas = [_positive(text, f"{where}, sigma") for text in fields[4:_POINT_FIELDS]]
    fixed = all(sigma == _FIXED_SIGMA for sigma in sigmas)
    x, y, z = from_geodetic(np.array([longitude * DEG, latitude * DEG, height]), ellipsoid).tolist()
    xx, yy, zz = (sigma**2 for sigma in sigmas)
    measures = dict[str, ControlMeasure]()
    for start in range(_POINT_FIELDS, len(fields), _MEASURE_FIELDS):
        image, *texts = fields[start : start + _MEASURE_FIELDS]
        here = f"{where}, image {image}"
        if image in measures:
            raise InputError(here, "a second measure in this image", "one per point", "remove the worse one")
        column, row = (number_of(text, f"{here}, {what}") for text, what in zip(texts, ("column", "row"), strict=False))
        column_sigma = _positive(texts[2], f"{here}, column sigma")
        row_sigma = _positive(texts[3], f"{here}, row sigma")
        measures[image] = candidate(image, row, column, row_sigma, column_sigma)
    return ControlPoint(
        id=fields[0], type=PointType.FIXED if fixed else PointType.CONSTRAINED, measures=tuple(measures.values()),
        apriori=(x, y, z), apriori_covariance=() if fixed else (xx, 0.0, 0.0, yy, 0.0, zz),
    )  # fmt: skip


def _positive(text: str, where: str) -> float:
    value = number_of(text, where)
    if not 0.0 < value < _LARGEST:
        raise InputError(where, f"{value:g}", "a positive number below 1e100")
    return value


def keeps_ids(points: Sequence[ControlPoint]) -> bool:
    """Whether the ids are numbers as the pipeline reads them; else they are counted anew, with the ids in comments."""
    return all(_NUMBERED.fullmatch(point.id) for point in points)


def ground_control_text(network: ControlNetwork, ellipsoid: Ellipsoid) -> str:
    """Ground control points of a network as text.

    Parameters
    ----------
    network : ControlNetwork
        Its constrained and fixed points, with or without measures; ignored ones are left out.
    ellipsoid : Ellipsoid
        To which latitudes and heights shall refer: the datum that is named to the pipeline.

    Raises
    ------
    InputError
        If there is no such point, one has no a-priori place or (constrained) no covariance with positive variances, or
        an image's name can't be told from the next field.
    """
    measures = measures_of(network, _KNOWN)
    where = network.source or "network"
    if not measures.points:
        found = "no constrained or fixed point that is not ignored"
        raise InputError(where, found, "at least one", "free points go into match files")
    for name in measures.images:
        if len(SEPARATOR.split(COMMENT.sub("", name))) != 1 or not COMMENT.sub("", name):
            raise InputError(f"image {name!r}", "a name with blanks, commas or a # before it", "a name without", RENAME)
    sigmas = [_ground_sigmas(point, f"{where}, point {point.id}") for point in measures.points]
    places = geodetic(np.array([point.apriori for point in measures.points], dtype=np.float64), ellipsoid)
    numbers = np.column_stack([places[:, [1, 0]] / DEG, places[:, 2], np.array(sigmas)]).tolist()
    seen, keep = _measure_texts(measures), keeps_ids(measures.points)
    lines = ["# id latitude longitude height sigma_x sigma_y sigma_z, then image column row and their sigmas"]
    for k, (point, values, images) in enumerate(zip(measures.points, numbers, seen, strict=True), start=1):
        lines += [] if keep else [f"# {k}: {' '.join(point.id.split())}"]
        lines.append(" ".join([point.id if keep else str(k), *map(repr, values), *images]))
    return "\n".join([*lines, ""])


def _ground_sigmas(point: ControlPoint, where: str) -> list[float]:
    """Along body-fixed X, Y, Z, in m."""
    if point.apriori is None:
        raise InputError(where, f"{point.type.name.lower()} without an a-priori place", "X, Y, Z")
    if point.type == PointType.FIXED:
        return [_FIXED_SIGMA] * 3
    variances = [point.apriori_covariance[k] for k in _DIAGONAL] if len(point.apriori_covariance) == 6 else [0.0]
    if min(variances) <= 0.0:
        raise InputError(where, "constrained without positive variances of its a-priori place", "a covariance in m^2")
    return [math.sqrt(variance) for variance in variances]


def _measure_texts(measures: PixelMeasures) -> list[list[str]]:
    """Fields of the measures of each point."""
    texts = list[list[str]]([] for _ in measures.points)
    sigmas = np.where(np.isnan(measures.sigmas), UNSTATED_SIGMA, measures.sigmas)
    rows = np.column_stack([measures.pixels[:, ::-1], sigmas[:, ::-1]]).tolist()
    for point, image, values in zip(measures.point.tolist(), measures.image.tolist(), rows, strict=True):
        texts[point] += [measures.images[image], *map(repr, values)]
    return texts
