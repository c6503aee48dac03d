"""Networks in the form of VisualSFM (``.nvm``, NVM_V3), as the Ames Stereo Pipeline uses it.

``NVM_V3``; the number of cameras, and a line for each: name, focal length, quaternion (w, x, y, z) and centre of the
camera, distortion, 0; the number of points, and a line for each: X, Y, Z (m, body-fixed), three colours, number of
measures, and for each measure the camera's number, a feature's number, column and row past the optical centre. That is
half the columns and half the rows for all but pinhole and frame cameras (first pixel's centre at 0, 0), and stands in
``NAME_offsets.txt`` beside ``NAME.nvm``: image, column, row. Cameras are written as placeholders (focal length 1, no
rotation, at the origin), as bundle_adjust does for all but pinhole cameras. Sources: StereoPipeline,
src/asp/Core/Nvm.cc (readNvm, writeNvm, offsetsFilename), docs, "NVM format", and src/asp/Camera/BundleAdjustEigen.cc
(calcOpticalOffsets).
"""

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.networks.asp_measures import RENAME, PixelMeasures, candidate, filled_lines, measures_of
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, PointType, with_names
from mgsgraph.files.opening import number_of

Centres = Mapping[str, tuple[float, float]]
"""Optical centre of each image by its name: row, column, first pixel's centre at (0, 0)."""
_FIRST = "NVM_V3"
_CAMERA = "1 1 0 0 0 0 0 0 0 0"
_CAMERA_FIELDS, _POINT_FIELDS, _MEASURE_FIELDS = 11, 7, 4
_ALL_TYPES = frozenset(PointType)
_REMEDY = "give image sizes (--case, or --images NAME=LINESxSAMPLES), or --nvm-no-shift"


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
        if len(fields) != 3:
            raise InputError(where, f"{len(fields)} fields", "image, column, row")
        if fields[0] in centres:
            raise InputError(where, f"image {fields[0]} twice", "each image once")
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
        if found := next(lines, None):
            return found
        raise InputError(str(path), f"it ends before {what}", "a whole NVM file", "it is cut short")

    def counted(what: str) -> range:
        where, fields = following(f"the number of {what}")
        if len(fields) > 1 or (count := _whole(fields[0])) < 1:
            raise InputError(where, f"{' '.join(fields)[:40]!r}", f"the number of {what}, above 0")
        return range(1, count + 1)

    where, head = following("the first line")
    if not head[0].startswith(_FIRST):
        raise InputError(where, f"{head[0][:40]!r}", _FIRST)
    cameras = [_camera(*following("the last camera")) for _ in counted("cameras")]
    if len(set(cameras)) != len(cameras):
        raise InputError(str(path), "an image twice among its cameras", "each image once")
    centres = _centres(path, cameras, centres) if shifted else dict.fromkeys(cameras, (0.0, 0.0))
    points = tuple(_point(*following(f"point {k}"), k, cameras, centres) for k in counted("points"))
    for where, fields in lines:  # VisualSFM ends the list of models with 0, the pipeline with the file
        if fields != ["0"]:
            raise InputError(where, "more after the last point", "one model")
        break
    return with_names(ControlNetwork("", "", points, source=str(path)))


def _centres(path: Path, cameras: list[str], centres: Centres | None) -> Centres:
    """The optical centre of every camera's image at least."""
    beside = offsets_path(path)
    there = os.path.exists(beside)  # False where it may not be looked at, too
    if there:
        centres = read_offsets(beside)
    for name in cameras:
        if centres is None or name not in centres:
            found = f"no optical centre of image {name}"
            found += "" if there else f", nor a {beside.name} beside it"
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


def _point(where: str, fields: list[str], k: int, cameras: list[str], centres: Centres) -> ControlPoint:
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
    if not measures.points:
        raise InputError(where, "no point that two images see", "at least one")
    for name in measures.images:
        if name not in centres:
            raise InputError(where, f"no size of image {name}", "the size of each image", _REMEDY)
        if len(name.split()) != 1:
            raise InputError(f"image {name!r}", "a name with blanks", "a name without", RENAME)
    cameras = [f"{name} {_CAMERA}" for name in measures.images]
    points = _point_lines(measures, centres)
    text = "\n".join([_FIRST, str(len(cameras)), *cameras, str(len(points)), *points, ""])
    offsets = "".join(f"{name} {centres[name][1]!r} {centres[name][0]!r}\n" for name in measures.images)
    return {path: text.encode(), offsets_path(path): offsets.encode()}


def _point_lines(measures: PixelMeasures, centres: Centres) -> list[str]:
    centre = np.array([centres[name] for name in measures.images])
    shifted = (measures.pixels - centre[measures.image]).tolist()
    feature, seen = [0] * len(shifted), [0] * len(measures.images)
    texts = list[list[str]]([] for _ in measures.points)
    for k, (point, image) in enumerate(zip(measures.point.tolist(), measures.image.tolist(), strict=True)):
        feature[k], seen[image] = seen[image], seen[image] + 1
        row, column = shifted[k]
        texts[point].append(f"{image} {feature[k]} {column!r} {row!r}")
    return [
        " ".join([*map(repr, point.adjusted or point.apriori or (0.0, 0.0, 0.0)), "0 0 0", str(len(mine)), *mine])
        for point, mine in zip(measures.points, texts, strict=True)
    ]
