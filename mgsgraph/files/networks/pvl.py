"""ISIS control networks as PVL text: versions 1 to 5 read, version 5 written.

ISIS takes the points of versions 3, 4 and 5 with one and the same code: only the names of point types changed, Ground
to Fixed and Tie to Free. Version 1 (the one without Version) has its own keywords: X, Y, Z or Latitude, Longitude,
Radius for the adjusted place, ApostCovarianceMatrix, AprioriLatLonSource, Held, ErrorLine and ErrorSample, other words
for types of measures, and sigmas in place of covariances. In 1 and 2 every point with an a-priori covariance is
constrained. Source: DOI-USGS/ISIS3, isis/src/control/objs/ControlNetVersioner/, of which ControlNetVersioner.cpp
(toPvl), ControlPointV0001.cpp and ControlPointV0003.cpp, and what ISIS wrote, ControlNetVersioner.truth beside them;
figures of merit: ControlMeasureLogData/ControlMeasureLogData.cpp and .h.

Networks are written as ISIS's cnetbin2pvl does, but with all digits of a number.

Written beside what ISIS writes: JigsawRejected of a point, which ISIS reads; zeros (diameter, residuals, covariances);
RadiusConstrained by itself, for which ISIS asks the longitude. Left out: comments, and texts that say Null.
"""

from collections.abc import Callable, Iterator, Mapping
from enum import IntEnum
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from msgspec import structs

from mgsgraph.errors import InputError, require
from mgsgraph.files.networks.record import (
    AprioriSource,
    ControlMeasure,
    ControlNetwork,
    ControlPoint,
    MeasureType,
    PointType,
    Where,
    of_mars,
)
from mgsgraph.files.pvl import LENGTHS, Block, Document, Entry, Value, inner_blocks, keyword_lines, text_value
from mgsgraph.files.writing import write_file
from mgsgraph.geometry.body import east_north_up, from_planetocentric
from mgsgraph.units import DEG

_TURN = 360.5 * DEG
"""rad of a longitude at most, east or west, and what its rounding may add."""
_VERSIONS = ("1", "2", "3", "4", "5")
_OLD = ("1", "2")
_NULL_SIZE = len("Null")
_ANGLES = dict.fromkeys(("", "deg", "degree", "degrees"), DEG) | dict.fromkeys(("rad", "radian", "radians"), 1.0)
PIXEL_UNITS = dict.fromkeys(("", "pixel", "pixels"), 1.0)

HEAD_TEXTS = {
    "NetworkId": "network_id", "TargetName": "target_name", "UserName": "user_name", "Created": "created",
    "LastModified": "last_modified", "Description": "description",
}  # fmt: skip
"""Keywords of the head by what they are in the record, in ISIS's order."""
NAME_TEXTS = {"ChooserName": "chooser_name", "DateTime": "date_time"}
LOCKS = {"EditLock": "edit_lock", "Ignore": "ignore"}
CONSTRAINTS = {
    "LatitudeConstrained": "latitude_constrained", "LongitudeConstrained": "longitude_constrained",
    "RadiusConstrained": "radius_constrained",
}  # fmt: skip
REJECTED = {"JigsawRejected": "jigsaw_rejected"}
PLACES = {"Sample": "sample", "Line": "line", "Diameter": "diameter", "AprioriSample": "apriori_sample",
          "AprioriLine": "apriori_line"}  # fmt: skip
"""Numbers of a measure that ISIS writes without a unit."""
PIXELS = {
    "SampleSigma": "sample_sigma", "LineSigma": "line_sigma", "SampleResidual": "sample_residual",
    "LineResidual": "line_residual",
}  # fmt: skip
"""Numbers of a measure that ISIS writes in <pixels>."""
POINT_TYPES = {kind: kind.name.title() for kind in PointType}
MEASURE_TYPES = {
    MeasureType.CANDIDATE: "Candidate", MeasureType.MANUAL: "Manual",
    MeasureType.REGISTERED_PIXEL: "RegisteredPixel", MeasureType.REGISTERED_SUBPIXEL: "RegisteredSubPixel",
}  # fmt: skip
SOURCES = {
    AprioriSource.NONE: "None", AprioriSource.USER: "User", AprioriSource.AVERAGE_OF_MEASURES: "AverageOfMeasures",
    AprioriSource.REFERENCE: "Reference", AprioriSource.ELLIPSOID: "Ellipsoid", AprioriSource.DEM: "DEM",
    AprioriSource.BASEMAP: "Basemap", AprioriSource.BUNDLE_SOLUTION: "BundleSolution",
}  # fmt: skip
LOG_NAMES = {
    1: "Obsolete_Eccentricity", 2: "GoodnessOfFit", 3: "MinimumPixelZScore", 4: "MaximumPixelZScore", 5: "PixelShift",
    6: "WholePixelCorrelation", 7: "SubPixelCorrelation", 8: "Obsolete_AverageResidual",
}  # fmt: skip
"""Figures of merit by ISIS's number; 1 and 8 were once called so without Obsolete_."""


def _by_word(words: Mapping[Any, str]) -> dict[str, Any]:
    return {word.lower(): value for value, word in words.items()}


WORDS_OF_POINT_TYPE = _by_word(POINT_TYPES) | {"tie": PointType.FREE, "ground": PointType.FIXED}
WORDS_OF_MEASURE_TYPE, WORDS_OF_SOURCE = _by_word(MEASURE_TYPES), _by_word(SOURCES)
WORDS_OF_LOG = _by_word(LOG_NAMES) | {"eccentricity": 1, "averageresidual": 8}
"""What the words for a choice mean, in lower case, those of old networks too."""
_Choice = TypeVar("_Choice", bound=IntEnum)
_Known = tuple[str, str, Callable[[Block, str], Any]]
"""A keyword, what it is in the record, and what reads it."""


def parse_pvl_network(document: Document) -> ControlNetwork:
    """The network that a text holds.

    A measure without MeasureType, which ISIS doesn't write, is a Candidate; latitude, longitude (degrees,
    planetocentric) and radius (m) stand in for X, Y, Z where these are not there; comments are not kept.

    Raises
    ------
    InputError
        With file, line and point: no control network or another version; text cut short or malformed; a point without
        PointId or PointType, or an id twice; a measure without SerialNumber, or with a keyword that ISIS does not know;
        a number, choice or truth value that is none.
    """
    network, version, points = None, "", list[ControlPoint]()
    positions: dict[str, int] = {}
    for outer, block in inner_blocks(document):
        if outer is not network:
            network, version = outer, _version(outer, network)
        if block.name != "controlpoint":
            raise InputError(block.where(), f"{block.kind} {block.name}", "Object = ControlPoint")
        if version == "1":
            renew_keywords(block)
        point = _point(block)
        if version in _OLD:
            point = renewed_point(point, block, version)
        if point.id in positions:
            first = document.where(positions[point.id])
            raise InputError(block.where("PointId"), f"the id twice, first at {first}", "each id once")
        positions[point.id] = block.position
        points.append(point)
    if network is None:
        raise InputError(
            document.source, "no control point", "an ISIS control network in PVL text (Object = ControlNetwork)"
        )
    texts = {attribute: _text(network, key) for key, attribute in HEAD_TEXTS.items()}
    return ControlNetwork(
        **texts | {"target_name": of_mars(texts["target_name"])},
        points=tuple(points),
        source=document.source,
        target_radii=tuple(network.numbers("TargetRadii", 3)) if "TargetRadii" in network else (),
    )


def where_in(document: Document) -> Where:
    """Where something stands in a text that was read: file, line, point, image and keyword."""

    def where(point: int, measure: int | None = None, key: str = "") -> str:
        block = next(islice(inner_blocks(document), point, None))[1]
        _label(block)
        if measure is None:
            return block.where(key)
        _label_measure(block.blocks[measure], block)
        return block.blocks[measure].where(key)

    return where


def _version(outer: Block, previous: Block | None) -> str:
    """The version; InputError unless this is the file's one control network, in one that is understood."""
    if outer.name != "controlnetwork":
        raise InputError(outer.where(), f"{outer.kind} {outer.name}", "Object = ControlNetwork")
    if previous is not None:
        raise InputError(outer.where(), "a second network", "one in a file", "put it into a file of its own")
    version = outer.text("Version") if "Version" in outer else "1"
    if version not in _VERSIONS:
        remedy = "let ISIS write it again: cnetpvl2bin, then cnetbin2pvl"
        raise InputError(outer.where("Version"), f"version {version}", "1 to 5", remedy)
    return version


def _label(point: Block) -> str:
    """The point's id, named in its messages from now on."""
    name = point.text("PointId")
    point.label = f"point {name}"
    return name


def _label_measure(measure: Block, point: Block) -> None:
    """The measure's image, named in its messages from now on."""
    measure.label = point.label
    measure.label += f", image {measure.text('SerialNumber')}"


def _point(block: Block) -> ControlPoint:
    name = _label(block)
    kind = WORDS_OF_POINT_TYPE.get(block.text("PointType").lower())
    if kind is None:
        raise InputError(block.where("PointType"), repr(block.text("PointType")), "Free, Constrained or Fixed")
    for measure in block.blocks:
        if measure.name != "controlmeasure":
            raise InputError(measure.where(), f"{measure.kind} {measure.name}", "Group = ControlMeasure")
    measures = tuple(_measure(measure, block) for measure in block.blocks)
    references = [k for k, measure in enumerate(block.blocks) if measure.flag("Reference")]
    return ControlPoint(
        id=name,
        type=kind,
        measures=measures,
        reference=references[-1] if references else None,  # the last one, as in ControlPointV0003
        apriori=_place(block, "Apriori"),
        adjusted=_place(block, "Adjusted"),
        **_values(block, _POINT_KEYS),
    )


def _measure(block: Block, point: Block) -> ControlMeasure:
    _label_measure(block, point)
    figures = list[tuple[int, float]]()
    for key in block.entries:
        if key in WORDS_OF_LOG and key in block:
            figures.append((WORDS_OF_LOG[key], block.number(key, PIXEL_UNITS)))
        elif key not in _MEASURE_KEYS and key not in WORDS_OF_LOG and key != "reference":
            raise InputError(block.where(key), f"the keyword {key}", "ISIS's keywords of a measure", "take it out")
    values: dict[str, Any] = {"type": MeasureType.CANDIDATE} | _values(block, _MEASURE_KEYS)
    return ControlMeasure(log=tuple(figures), **values)


def _values(block: Block, keys: Mapping[str, _Known]) -> dict[str, Any]:
    """Values of a block's known keys, by their names in the record."""
    values = dict[str, Any]()
    for key, entry in block.entries.items():
        if key in keys and (len(entry.value) != _NULL_SIZE or key in block):
            name, attribute, read = keys[key]
            values[attribute] = read(block, name)
    return values


def _text(block: Block, key: str) -> str:
    """A text; empty where it is left out, or Null."""
    return block.text(key) if key in block and block.entries[key.lower()].value != "" else ""


def _chosen(block: Block, key: str, choices: Mapping[str, _Choice]) -> _Choice:
    word = block.text(key)
    if word.lower() not in choices:
        raise InputError(block.where(key), repr(word[:60]), f"one of {', '.join(choices)}")
    return choices[word.lower()]


def _place(block: Block, stage: str) -> tuple[float, float, float] | None:
    """A-priori or adjusted place, m body-fixed."""
    x, y, z = f"{stage}X", f"{stage}Y", f"{stage}Z"
    if x in block or y in block or z in block:
        return block.number(x, LENGTHS), block.number(y, LENGTHS), block.number(z, LENGTHS)
    if not any(stage + part in block for part in ("Latitude", "Longitude", "Radius")):
        return None
    longitude, latitude = block.number(f"{stage}Longitude", _ANGLES), block.number(f"{stage}Latitude", _ANGLES)
    radius = block.number(f"{stage}Radius", LENGTHS)
    if abs(latitude) > 90.0 * DEG or abs(longitude) > _TURN or radius <= 0.0:
        found = f"latitude {latitude / DEG:g}, longitude {longitude / DEG:g} degrees, radius {radius:g} m"
        expected = "-90 .. 90 and -360 .. 360 degrees, and a positive radius"
        raise InputError(block.where(f"{stage}Latitude"), found, expected)
    x, y, z = from_planetocentric(np.array([longitude, latitude, radius])).tolist()
    return x, y, z


def _matrix(block: Block, key: str) -> tuple[float, ...]:
    return tuple(block.numbers(key, 6))


def _of(kind: str, names: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    return {key: (attribute, kind) for key, attribute in names.items()}


POINT_KEYS = {
    **_of("text", NAME_TEXTS), **_of("flag", LOCKS | REJECTED),
    "AprioriXYZSource": ("apriori_source", "source"), "AprioriXYZSourceFile": ("apriori_source_file", "text"),
    "AprioriRadiusSource": ("apriori_radius_source", "source"),
    "AprioriRadiusSourceFile": ("apriori_radius_source_file", "text"),
    "Apriori": ("apriori", "place"), "AprioriCovarianceMatrix": ("apriori_covariance", "matrix"),
    **_of("flag", CONSTRAINTS),
    "Adjusted": ("adjusted", "place"), "AdjustedCovarianceMatrix": ("adjusted_covariance", "matrix"),
}  # fmt: skip
MEASURE_KEYS = {
    "SerialNumber": ("serial_number", "name"), "MeasureType": ("type", "type"), **_of("text", NAME_TEXTS),
    **_of("flag", LOCKS), **_of("number", PLACES), **_of("pixels", PIXELS), **_of("flag", REJECTED),
}  # fmt: skip
"""Keywords in ISIS's order, what they are in the record, and how they are read and written; places, of three keywords
each, by how these begin.
"""
_READ: dict[str, Callable[[Block, str], Any]] = {
    "text": _text, "name": Block.text, "flag": Block.flag, "source": partial(_chosen, choices=WORDS_OF_SOURCE),
    "type": partial(_chosen, choices=WORDS_OF_MEASURE_TYPE), "number": partial(Block.number, units=PIXEL_UNITS),
    "pixels": partial(Block.number, units=PIXEL_UNITS), "matrix": _matrix,
}  # fmt: skip
_POINT_KEYS, _MEASURE_KEYS = (
    {key.lower(): (key, attribute, _READ[kind]) for key, (attribute, kind) in keys.items() if kind in _READ}
    for keys in (POINT_KEYS, MEASURE_KEYS)
)
"""How keywords are read, by keyword in lower case."""


# --- versions 1 and 2 in the words of version 5


_POINT = {
    "x": "adjustedx", "y": "adjustedy", "z": "adjustedz", "latitude": "adjustedlatitude",
    "longitude": "adjustedlongitude", "radius": "adjustedradius", "apostcovariancematrix": "adjustedcovariancematrix",
    "apriorilatlonsource": "apriorixyzsource", "apriorilatlonsourcefile": "apriorixyzsourcefile",
}  # fmt: skip
_MEASURE = {"errorline": "lineresidual", "errorsample": "sampleresidual"}
_NEEDLESS = ("errormagnitude", "zscore")
"""Of a measure: they follow from others."""
_MEASURE_TYPES = {
    "estimated": "candidate", "unmeasured": "candidate", "automatic": "registeredpixel",
    "validatedmanual": "registeredpixel", "automaticpixel": "registeredpixel",
    "validatedautomatic": "registeredsubpixel", "automaticsubpixel": "registeredsubpixel",
}  # fmt: skip
_UNKNOWN_SIGMA = 10_000.0
"""m, what ISIS takes where one of three sigmas is not there, not positive, or larger."""
_AXES = ("Longitude", "Latitude", "Radius")


def renew_keywords(point: Block) -> None:
    """Give keywords of a point of version 1, and of its measures, their names of version 5."""
    _rename(point, _POINT)
    if point.flag("Held"):
        point.entries["pointtype"] = point.entries["held"]._replace(value="Ground")
    for measure in point.blocks:
        _rename(measure, _MEASURE)
        for key in _NEEDLESS:
            measure.entries.pop(key, None)
        kind = measure.entries.get("measuretype")
        if kind is not None and isinstance(kind.value, str):
            word = _MEASURE_TYPES.get(kind.value.lower(), kind.value)
            measure.entries["measuretype"] = kind._replace(value=word)
        if "Line" not in measure or "Sample" not in measure:  # it was never measured
            measure.entries["ignore"] = Entry("True", "", measure.position)


def _rename(block: Block, names: dict[str, str]) -> None:
    """Rename keywords, and drop those without content."""
    entries = {key: entry for key, entry in block.entries.items() if entry.value != ""}
    for old, new in names.items():
        if old in entries:
            entry = entries.pop(old)
            entries.setdefault(new, entry)
    block.entries = entries


def renewed_point(point: ControlPoint, block: Block, version: str) -> ControlPoint:
    """A point of version 1 or 2 as ISIS takes it: constrained where there is an a-priori covariance; in version 1 with
    the covariances of sigmas (m, on the ground and upward), and with the adjusted place where it has no a-priori one.
    """
    changed: dict[str, Any] = {}
    if version == "1":
        changed["apriori"] = point.apriori or point.adjusted
        changed |= _covariances(point, block)
    if changed.get("apriori_covariance", point.apriori_covariance):
        changed["type"] = PointType.CONSTRAINED
    return structs.replace(point, **changed)


def _covariances(point: ControlPoint, block: Block) -> dict[str, Any]:
    """Covariances of version 1, and whether coordinates are constrained, by their names in the record."""
    fields: dict[str, Any] = {}
    adjusted, apriori = point.adjusted_covariance, point.apriori_covariance
    if place := point.apriori or point.adjusted:
        apriori = apriori or _of_sigmas(block, "AprioriSigma", place)
    if point.adjusted:
        adjusted = adjusted or _of_sigmas(block, "AdjustedSigma", point.adjusted)
    for axis in _AXES:
        whole = bool(point.apriori_covariance or point.adjusted_covariance)
        fields[f"{axis.lower()}_constrained"] = whole or f"AprioriSigma{axis}" in block
    return fields | {"apriori_covariance": apriori, "adjusted_covariance": adjusted}


def _of_sigmas(block: Block, key: str, place: tuple[float, float, float]) -> tuple[float, ...]:
    """xx, xy, xz, yy, yz, zz in m^2 of sigmas along longitude, latitude and radius; empty without any."""
    names = [f"{key}{axis}" for axis in _AXES]
    if not any(name in block for name in names):
        return ()
    stated = [block.number(name, LENGTHS) if name in block else 0.0 for name in names]
    sigmas = np.array([sigma if 0.0 < sigma < _UNKNOWN_SIGMA else _UNKNOWN_SIGMA for sigma in stated])
    (axes,) = east_north_up(np.array([place]))
    return tuple(((axes.T * sigmas**2) @ axes)[np.triu_indices(3)].tolist())


_LARGEST = 1e300
_Keywords = list[tuple[str, Value]]


def write_pvl_network(network: ControlNetwork, path: Path) -> None:
    """Write a network as PVL text, version 5.

    Parameters
    ----------
    network : ControlNetwork
        All of it is kept but texts that say Null, which is how ISIS spells none.
    path : Path
        Its folder is made when absent; a file of that name is replaced, once the new one is there whole.

    Raises
    ------
    InputError
        A network without points; a number that is not finite; a text that PVL can't hold; a figure of merit that has no
        name, or twice the same; or a file that can't be written.
    """
    write_file(path, network_text(network))


def network_text(network: ControlNetwork) -> str:
    """What `write_pvl_network` writes."""
    where = network.source or "network"
    require(network.points, where, "no control point", "some to write")
    head: _Keywords = [
        (key, text_value(getattr(network, attribute), f"{where}, {key}")) for key, attribute in HEAD_TEXTS.items()
    ]
    if network.target_radii:
        head.append(("TargetRadii", _numbers(network.target_radii, "TargetRadii", 3)))
    lines = ["Object = ControlNetwork", *keyword_lines([*head, ("Version", "5")], 2)]
    for index, point in enumerate(network.points):
        try:
            lines += _point_lines(point)
        except InputError as error:
            raise error.within(network.where(index)) from None
    return "\n".join([*lines, "End_Object", "End", ""])


def _point_lines(point: ControlPoint) -> list[str]:
    keywords: _Keywords = [("PointType", POINT_TYPES[point.type]), ("PointId", _name(point.id, "PointId"))]
    lines = ["", "  Object = ControlPoint", *keyword_lines([*keywords, *_keywords(point, POINT_KEYS)], 4)]
    for k, measure in enumerate(point.measures):
        try:
            lines += _measure_lines(measure, k == point.reference)
        except InputError as error:
            raise error.within(f"measure {k + 1}") from None
    return [*lines, "  End_Object"]


def _measure_lines(measure: ControlMeasure, reference: bool) -> list[str]:
    keywords = list(_keywords(measure, MEASURE_KEYS))
    keywords += _logged(measure)
    if reference:
        keywords.append(("Reference", "True"))
    return ["", "    Group = ControlMeasure", *keyword_lines(keywords, 6), "    End_Group"]


def _logged(measure: ControlMeasure) -> _Keywords:
    kinds = [kind for kind, _ in measure.log]
    for kind in kinds:
        if kind not in LOG_NAMES or kinds.count(kind) > 1:
            found = f"number {kind} twice" if kind in LOG_NAMES else f"number {kind}"
            raise InputError("figures of merit", found, f"1 .. {max(LOG_NAMES)}, each once", "write another format")
    return [(LOG_NAMES[kind], _number(value, LOG_NAMES[kind])) for kind, value in measure.log]


def _keywords(
    record: ControlPoint | ControlMeasure, keys: Mapping[str, tuple[str, str]]
) -> Iterator[tuple[str, Value]]:
    """Keywords with their values, without empty ones."""
    for key, (attribute, kind) in keys.items():
        value = getattr(record, attribute)
        if kind == "name":
            yield key, _name(value, key)
        elif kind == "type":
            yield key, MEASURE_TYPES[value]
        elif value is None or not (value or kind in ("number", "pixels")):
            continue
        elif kind == "text":
            yield from [(key, text_value(value, key))] if value.lower() != "null" else []
        elif kind == "flag":
            yield key, "Yes" if key in REJECTED else "True"
        elif kind == "source":
            yield key, SOURCES[value]
        elif kind == "matrix":
            yield key, _numbers(value, key, 6)
        elif kind == "place":
            for axis, component in zip("XYZ", value, strict=True):
                yield key + axis, _number(component, key + axis) + " <meters>"
        else:
            yield key, _number(value, key) + (" <pixels>" if kind == "pixels" else "")


def _name(text: str, key: str) -> str:
    if not text or text.lower() == "null":
        raise InputError(key, repr(text), "a name that PVL can hold", "change it, or write another format")
    return text_value(text, key)


def _numbers(values: tuple[float, ...], key: str, count: int) -> tuple[str, ...]:
    if len(values) != count:
        raise InputError(key, f"{len(values)} numbers", f"{count}")
    return tuple(_number(value, key) for value in values)


def _number(value: float, key: str) -> str:
    """All digits, so that the same number comes back."""
    if not -_LARGEST < value < _LARGEST:
        raise InputError(key, f"{value}", "a finite number")
    return repr(float(value))
