"""Text files of the Ames Stereo Pipeline: ground control points (``.gcp``) and networks (``.nvm``), to and from
networks; and measures of a network as the pipeline counts pixels.

Ground control points: one point a line, fields apart by blanks or commas: id, latitude, longitude (degrees, geodetic),
height (m) above the datum (a line ``# WKT: ...`` says which), three sigmas (m) along body-fixed X, Y, Z, then for each
image its name, column, row
(first pixel's centre 0, 0) and their sigmas (pixels). Source: StereoPipeline, docs/tools/bundle_adjust.rst, "Ground
control points". A file made for its option ``--use-lon-lat-height-gcp-error`` holds sigmas along latitude, longitude
and height instead; it doesn't say so and must not be given here. Ids are whole numbers to the pipeline, which skips
lines with others (VisionWorkbench, src/vw/BundleAdjustment/ControlNetworkLoader.cc, add_ground_control_points); here
they may be names.

Networks in the form of VisualSFM (``.nvm``, NVM_V3), as the Ames Stereo Pipeline uses it.

``NVM_V3``; the number of cameras, and a line for each: name, focal length, quaternion (w, x, y, z) and centre of the
camera, distortion, 0; the number of points, and a line for each: X, Y, Z (m, body-fixed), three colours, number of
measures, and for each measure the camera's number, a feature's number, column and row past the optical centre. That is
half the columns and half the rows for all but pinhole and frame cameras (first pixel's centre at 0, 0), and stands in
``NAME_offsets.txt`` beside ``NAME.nvm``: image, column, row. Cameras are written as placeholders (focal length 1, no
rotation, at the origin), as bundle_adjust does for all but pinhole cameras. Sources: StereoPipeline,
src/asp/Core/Nvm.cc (readNvm, writeNvm, offsetsFilename), docs, "NVM format", and src/asp/Camera/BundleAdjustEigen.cc
(calcOpticalOffsets).
"""

import math
import os
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from msgspec import structs

from mgsgraph.errors import InputError, require
from mgsgraph.files.datum import NAMED, datum_of_wkt, is_same, require_same, wkt_of
from mgsgraph.files.networks.record import (
    ControlMeasure,
    ControlNetwork,
    ControlPoint,
    MeasureType,
    PointType,
    with_names,
)
from mgsgraph.files.networks.tie_points import TiePoints, arrays_of, tie_points
from mgsgraph.files.opening import number_of, read_text
from mgsgraph.geometry.body import Ellipsoid, from_geodetic, geodetic
from mgsgraph.geometry.records import Array, Index
from mgsgraph.units import ASP_OFFSET, DEG, ISIS_OFFSET

FROM_ASP = ISIS_OFFSET - ASP_OFFSET
"""The first pixel's centre, (0, 0) in the pipeline, is (1, 1) in ISIS."""
UNSTATED_SIGMA = 1.0
"""pixels, written where the network has no sigma, as bundle_adjust does."""
RENAME = "give it another name (--rename OLD=NEW)"
"""What to do about an image's name that a format can't hold."""
_SEPARATOR = re.compile(r"[\s,]+")
_COMMENT = re.compile(r"(?:^|(?<=[\s,]))#.*")
"""What stands between the fields of ground control points, and behind them."""


def filled_lines(path: Path, ground_control: bool = False) -> Iterator[tuple[str, list[str]]]:
    """File and line, and fields of every line that has any: between blanks, or those of ground control points."""
    for number, line in enumerate(read_text(path).split("\n"), start=1):
        fields = list(filter(None, _SEPARATOR.split(_COMMENT.sub("", line)))) if ground_control else line.split()
        if fields:
            yield f"{path}, line {number}", fields


@dataclass(frozen=True, slots=True, eq=False)
class PixelMeasures:
    """Those points of a network that a format takes, and their measures, point by point."""

    points: tuple[ControlPoint, ...]
    """(n) as the network has them."""
    images: tuple[str, ...]
    """Names of the images that measures are in, in the order in which they come."""
    point: Index
    """(k,) index of the point measured; it never falls."""
    image: Index
    """(k,) index of the image."""
    pixels: Array
    """(k, 2) row, column, first pixel's centre at (0, 0)."""
    sigmas: Array
    """(k, 2) pixels, of row and column; NaN where the network does not say."""


def takes_part(point: ControlPoint, types: Collection[PointType]) -> bool:
    """Whether a point is of one of these types and not ignored."""
    return point.type in types and not point.ignore


def measures_of(network: ControlNetwork, types: Collection[PointType], least: int = 0) -> PixelMeasures:
    """Points of these types with at least so many measures; those with Ignore = True are left out.

    Raises InputError for a measure without a place and for an image twice in a point.
    """
    chosen = [
        structs.replace(point, measures=tuple(m for m in point.measures if not m.ignore), reference=None)
        for point in network.points if takes_part(point, types)
    ]  # fmt: skip
    points = tuple(point for point in chosen if len(point.measures) >= least)
    network = structs.replace(network, points=points)
    arrays = arrays_of(network)
    point = np.repeat(np.arange(len(points)), np.diff(arrays.first))
    for k in np.flatnonzero(np.isnan(arrays.measures[:, :2]).any(axis=1))[:1].tolist():
        where = network.where(int(point[k]), int(k - arrays.first[point[k]]))
        raise InputError(where, "a measure without line and sample", "both")
    arrays.require_once(network.where)
    places, sigmas = arrays.measures[:, :2] - FROM_ASP, arrays.measures[:, 2:]
    stated_sigmas = np.where(sigmas > 0.0, sigmas, np.nan)
    return PixelMeasures(points, arrays.image.distinct, point, arrays.image.numbers, places, stated_sigmas)


def candidate(image: str, row: float, column: float, row_sigma: float, column_sigma: float) -> ControlMeasure:
    """A measure of which nothing is known but its place (first pixel's centre at 0, 0) and sigmas (NaN: unknown)."""
    return ControlMeasure(
        serial_number=image,
        type=MeasureType.CANDIDATE,
        sample=column + FROM_ASP,
        line=row + FROM_ASP,
        sample_sigma=column_sigma if column_sigma > 0.0 else None,
        line_sigma=row_sigma if row_sigma > 0.0 else None,
    )


# --- ground control points


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
_ANOTHER = 0.01
"""Share by which a datum's radius may be off the body's."""
_WKT, _DATUM = re.compile(r"#\s*WKT\s*:\s*(.+)", re.I), re.compile(r"#\s*datum\s*[:=]\s*[\"']?(\w+)", re.I)
"""Headers of the datum."""
_LIKE_A_DATUM = re.compile(r"GEOGCS\[|PROJCS\[|GEOGCRS\[|SPHEROID\[|^#+\s*(WKT|datum)\b", re.I)
_HEIGHTS = ("height", "elev", "alt", "h", "z")
_COLUMN = re.compile(r"(lat|lon|height|elev|alt|radius|h|x|y|z)(?:gitude|itude|ation)?(?:_|$)")
"""Names of columns by their beginnings."""
_OF_POINT, _OF_MEASURE = 7, 5
"""Fields of ground control points."""


def read_ground_control(path: Path, body: Ellipsoid, datum: Ellipsoid | None = None) -> TiePoints:
    """Read ground control points on a body for an adjustment; see `read_ground_control_network`."""
    return tie_points(read_ground_control_network(path, body, datum), body=body)


def stated_datum(path: Path) -> Ellipsoid | None:
    """The datum of a header ``# WKT:``; InputError for one that is not understood, and for an order of columns that is
    not the one that is read.
    """
    datum = None
    for number, line in enumerate(read_text(path).split("\n"), start=1):
        where, comment = f"{path}, line {number}", line.strip()
        if not comment.startswith("#"):
            continue
        _require_columns(comment, where)
        if wkt := _WKT.match(comment):
            stated = datum_of_wkt(wkt[1], where)
        elif other := _DATUM.match(comment):
            if other[1].upper() not in NAMED:
                raise InputError(where, f"the datum {other[1]!r}", "# WKT: ..., as the Ames Stereo Pipeline writes it")
            stated = NAMED[other[1].upper()]
        elif _LIKE_A_DATUM.search(comment):
            raise InputError(where, repr(comment)[:60], "# WKT: GEOGCS[...], as the Ames Stereo Pipeline writes it")
        else:
            continue
        if datum is not None:
            require_same(stated, datum, where, "the header before")
        datum = stated
    return datum


def _require_columns(comment: str, where: str) -> None:
    """Raise InputError for names of columns in another order, or of other quantities, than those that are read."""
    words = [word for word in _SEPARATOR.split(comment.lstrip("# ").lower()) if word]
    named = [match[1] for word in words if (match := _COLUMN.match(word))][:3]
    sigmas = [word for word in words if re.fullmatch(r"(sigma|s|std)_?(lat|lon|h|height)\w*", word)]
    other_columns = [word for word in words if re.search(r"(_km|radius|areoid|geoid)$", word)]
    if len(named) == 3 and (named not in (["lat", "lon", height] for height in _HEIGHTS) or sigmas or other_columns):
        shown = ", ".join([*named, *sigmas, *other_columns])
        raise InputError(where, f"the columns {shown}", "latitude, longitude, height in m, sigmas along X, Y, Z")


def read_ground_control_network(path: Path, body: Ellipsoid, datum: Ellipsoid | None = None) -> ControlNetwork:
    """Read ground control points.

    Parameters
    ----------
    path : Path
        ``.gcp`` file.
    body : Ellipsoid
        To which latitudes and heights refer where neither the file's header nor `datum` says.
    datum : Ellipsoid, optional
        What the caller knows of it; it must not contradict the header.

    Returns
    -------
    ControlNetwork
        In the file's order, all constrained but those whose three sigmas are 1e-10 m, which are fixed.

    Raises
    ------
    InputError
        A header that isn't understood, or says another datum than the caller or another body's. With file, line and
        point: a wrong number of fields, a field that is no finite number, a sigma that is not
        positive, a latitude beyond a pole, an id twice, an image twice in a point, or no point at all.
    """
    stated = stated_datum(path)
    if datum is not None and stated is not None:
        require_same(stated, datum, str(path), "the case")
    ellipsoid = datum or (body if stated is None or is_same(stated, body) else stated)
    sizes = [np.array([shape.equatorial, shape.polar]) for shape in (ellipsoid, body)]
    if np.abs(sizes[0] / sizes[1] - 1.0).max() > _ANOTHER:
        found, expected = (f"{shape.equatorial:.9g} and {shape.polar:.9g} m" for shape in (ellipsoid, body))
        raise InputError(str(path), f"a datum of {found}", f"the images' body, {expected}")
    points = dict[str, tuple[str, ControlPoint]]()
    for line, fields in filled_lines(path, ground_control=True):
        where = f"{line}, point {fields[0]}"
        if fields[0] in points:
            found = f"the id twice, first in{points[fields[0]][0].removeprefix(f'{path},')}"
            raise InputError(where, found, "each id once")
        points[fields[0]] = line, _gcp_point(fields, ellipsoid, where)
    require(points, str(path), "no ground control point", "one per line: id latitude longitude height sigmas")
    return with_names(ControlNetwork("", "", tuple(point for _, point in points.values()), source=str(path)))


def _gcp_point(fields: list[str], ellipsoid: Ellipsoid, where: str) -> ControlPoint:
    if len(fields) < _OF_POINT or (len(fields) - _OF_POINT) % _OF_MEASURE:
        raise InputError(where, f"{len(fields)} fields", f"{_OF_POINT}, and {_OF_MEASURE} more for each image")
    latitude, longitude, height = (
        number_of(text, f"{where}, {what}")
        for text, what in zip(fields[1:4], ("latitude", "longitude", "height"), strict=True)
    )
    if abs(latitude) > 90.0:
        raise InputError(f"{where}, latitude", f"{latitude:g} degrees", "-90 .. 90", "latitude comes before longitude")
    if abs(longitude) > _TURN:
        raise InputError(f"{where}, longitude", f"{longitude:g} degrees", f"-{_TURN:g} .. {_TURN:g}")
    sigmas = [_positive(text, f"{where}, sigma") for text in fields[4:_OF_POINT]]
    fixed = all(sigma == _FIXED_SIGMA for sigma in sigmas)
    x, y, z = from_geodetic(np.array([longitude * DEG, latitude * DEG, height]), ellipsoid).tolist()
    xx, yy, zz = (sigma**2 for sigma in sigmas)
    measures = dict[str, ControlMeasure]()
    for start in range(_OF_POINT, len(fields), _OF_MEASURE):
        image, *texts = fields[start : start + _OF_MEASURE]
        at = f"{where}, image {image}"
        if image in measures:
            raise InputError(at, "a second measure in this image", "one per point", "remove the worse one")
        column, row = (number_of(text, f"{at}, {what}") for text, what in zip(texts, ("column", "row"), strict=False))
        column_sigma = _positive(texts[2], f"{at}, column sigma")
        row_sigma = _positive(texts[3], f"{at}, row sigma")
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
    """Whether the ids are numbers as the pipeline reads them; else they are counted, with the ids in comments."""
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
        an image's name can't be separated from the next field.
    """
    measures = measures_of(network, _KNOWN)
    where = network.source or "network"
    if not measures.points:
        found = "no constrained or fixed point that is not ignored"
        raise InputError(where, found, "at least one", "free points go into match files")
    for name in measures.images:
        if len(_SEPARATOR.split(_COMMENT.sub("", name))) != 1 or not _COMMENT.sub("", name):
            raise InputError(f"image {name!r}", "a name with blanks, commas or a # before it", "a name without", RENAME)
    sigmas = [_ground_sigmas(point, f"{where}, point {point.id}") for point in measures.points]
    places = geodetic(np.array([point.apriori for point in measures.points], dtype=np.float64), ellipsoid)
    numbers = np.column_stack([places[:, [1, 0]] / DEG, places[:, 2], np.array(sigmas)]).tolist()
    measure_texts, keep = _measure_texts(measures), keeps_ids(measures.points)
    columns = "# id latitude longitude height sigma_x sigma_y sigma_z, then image column row and their sigmas"
    lines = [columns, f"# WKT: {wkt_of(ellipsoid)}"]
    for k, (point, values, images) in enumerate(zip(measures.points, numbers, measure_texts, strict=True), start=1):
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


# --- networks in the form of VisualSFM


Centres = Mapping[str, tuple[float, float]]
"""Optical centre of each image by its name: row, column, first pixel's centre at (0, 0)."""
_FIRST = "NVM_V3"
_CAMERA = "1 1 0 0 0 0 0 0 0 0"
_CAMERA_FIELDS, _POINT_FIELDS, _MEASURE_FIELDS = 11, 7, 4
_ALL_TYPES = frozenset(PointType)
_REMEDY = "give image sizes (--case, or --size NAME=LINESxSAMPLES), or --nvm-no-shift"


def half_sizes(sizes: Mapping[str, tuple[int, int]]) -> dict[str, tuple[float, float]]:
    """Optical centres of images of so many lines and samples, as the pipeline has them for pushbroom cameras."""
    return {name: (lines / 2.0, samples / 2.0) for name, (lines, samples) in sizes.items()}


def offsets_path(path: Path) -> Path:
    """Where the optical centres of an NVM file are."""
    return path.with_name(f"{path.stem}_offsets.txt")


def read_offsets(path: Path) -> dict[str, tuple[float, float]]:
    """Read the optical centres; InputError with the line for what is malformed or stands twice."""
    centres: dict[str, tuple[float, float]] = {}
    for where, fields in filled_lines(path):
        require(len(fields) == 3, where, f"{len(fields)} fields", "image, column, row")
        require(fields[0] not in centres, where, f"image {fields[0]} twice", "each image once")
        centres[fields[0]] = number_of(fields[2], where), number_of(fields[1], where)
    return centres


def read_nvm(path: Path, centres: Centres | None = None, shifted: bool = True) -> ControlNetwork:
    """Read an NVM file.

    Parameters
    ----------
    path : Path
        ``.nvm``.
    centres : mapping, optional
        Optical centres, row and column, where there is no ``_offsets.txt`` beside the file.
    shifted : bool
        False where columns and rows are not past the optical centre (the pipeline's ``--nvm-no-shift``).

    Returns
    -------
    ControlNetwork
        Free points, counted (nvm1, ...); their places are adjusted ones, none for (0, 0, 0).

    Raises
    ------
    InputError
        With file and line: no NVM_V3, malformed or cut short, no optical centre of an image, an image twice in a point.
    """
    lines = filled_lines(path)

    def following(what: str) -> tuple[str, list[str]]:
        if line := next(lines, None):
            return line
        raise InputError(str(path), f"it ends before {what}", "a whole NVM file", "it is cut short")

    def counted(what: str) -> range:
        where, fields = following(f"the number of {what}")
        if len(fields) > 1 or (count := _whole(fields[0])) < 1:
            raise InputError(where, f"{' '.join(fields)[:40]!r}", f"the number of {what}, above 0")
        return range(1, count + 1)

    where, head = following("the first line")
    require(head[0].startswith(_FIRST), where, f"{head[0][:40]!r}", _FIRST)
    cameras = [_camera(*following("the last camera")) for _ in counted("cameras")]
    require(len(set(cameras)) == len(cameras), str(path), "an image twice among its cameras", "each image once")
    centres = _centres(path, cameras, centres) if shifted else dict.fromkeys(cameras, (0.0, 0.0))
    points = tuple(_nvm_point(*following(f"point {k}"), k, cameras, centres) for k in counted("points"))
    for where, fields in lines:  # VisualSFM ends the list of models with 0, the pipeline with the file
        require(fields == ["0"], where, "more after the last point", "one model")
        break
    return with_names(ControlNetwork("", "", points, source=str(path)))


def _centres(path: Path, cameras: list[str], centres: Centres | None) -> Centres:
    """The optical centre of every camera's image at least."""
    beside = offsets_path(path)
    exists = os.path.exists(beside)  # False where it may not be looked at, too
    if exists:
        centres = read_offsets(beside)
    for name in cameras:
        if centres is None or name not in centres:
            found = f"no optical centre of image {name}"
            found += "" if exists else f", nor a {beside.name} beside it"
            raise InputError(str(path), found, "one for each image", _REMEDY)
    assert centres is not None  # there is a camera
    return centres


def _whole(text: str) -> int:
    """A whole number of at most nine digits, or -1: no file has so many lines, nor cameras."""
    return int(text) if len(text) <= 9 and text.isascii() and text.isdigit() else -1


def _camera(where: str, fields: list[str]) -> str:
    if len(fields) != _CAMERA_FIELDS:
        raise InputError(where, f"{len(fields)} fields", f"{_CAMERA_FIELDS}, of a camera whose name has no blank")
    return fields[0]


def _nvm_point(where: str, fields: list[str], k: int, cameras: list[str], centres: Centres) -> ControlPoint:
    where += f", point {k}"
    count = _whole(fields[6]) if len(fields) >= _POINT_FIELDS else -1
    if count < 0 or len(fields) != _POINT_FIELDS + _MEASURE_FIELDS * count:
        expected = "X Y Z, three colours, the number of measures, and four for each of them"
        raise InputError(where, f"{len(fields)} fields", expected)
    x, y, z = (number_of(text, where) for text in fields[:3])
    measures = tuple(
        _measure(fields[start : start + _MEASURE_FIELDS], cameras, centres, where)
        for start in range(_POINT_FIELDS, len(fields), _MEASURE_FIELDS)
    )
    if len({measure.serial_number for measure in measures}) != len(measures):
        raise InputError(where, "two measures in one image", "one per image")
    place = (x, y, z) if any((x, y, z)) else None
    return ControlPoint(id=f"nvm{k}", type=PointType.FREE, measures=measures, adjusted=place)


def _measure(fields: list[str], cameras: list[str], centres: Centres, where: str) -> ControlMeasure:
    camera = _whole(fields[0])
    if not 0 <= camera < len(cameras):
        raise InputError(where, f"camera {fields[0][:20]}", f"0 .. {len(cameras) - 1}")
    name = cameras[camera]
    row, column = centres[name]
    nothing = float("nan")
    return candidate(name, number_of(fields[3], where) + row, number_of(fields[2], where) + column, nothing, nothing)


def nvm_files(network: ControlNetwork, path: Path, centres: Centres) -> dict[Path, bytes]:
    """Contents of an NVM file and of its ``_offsets.txt`` by their paths.

    Points of every type that two images or more see, but ignored ones; the place is the adjusted one, else the
    a-priori one, else (0, 0, 0). Raises InputError if there is none, or an image has no centre or a blank in its name.
    """
    measures = measures_of(network, _ALL_TYPES, least=2)
    where = network.source or "network"
    require(measures.points, where, "no point that two images see", "at least one")
    for name in measures.images:
        require(name in centres, where, f"no size of image {name}", "the size of each image", _REMEDY)
        require(len(name.split()) == 1, f"image {name!r}", "a name with blanks", "a name without", RENAME)
    cameras = [f"{name} {_CAMERA}" for name in measures.images]
    points = _point_lines(measures, centres)
    text = "\n".join([_FIRST, str(len(cameras)), *cameras, str(len(points)), *points, ""])
    offsets = "".join(f"{name} {centres[name][1]!r} {centres[name][0]!r}\n" for name in measures.images)
    return {path: text.encode(), offsets_path(path): offsets.encode()}


def _point_lines(measures: PixelMeasures, centres: Centres) -> list[str]:
    centre = np.array([centres[name] for name in measures.images])
    shifted = (measures.pixels - centre[measures.image]).tolist()
    feature, counts = [0] * len(shifted), [0] * len(measures.images)
    texts = list[list[str]]([] for _ in measures.points)
    for k, (point, image) in enumerate(zip(measures.point.tolist(), measures.image.tolist(), strict=True)):
        feature[k], counts[image] = counts[image], counts[image] + 1
        row, column = shifted[k]
        texts[point].append(f"{image} {feature[k]} {column!r} {row!r}")
    return [
        " ".join([*map(repr, point.adjusted or point.apriori or (0.0, 0.0, 0.0)), "0 0 0", str(len(entries)), *entries])
        for point, entries in zip(measures.points, texts, strict=True)
    ]
