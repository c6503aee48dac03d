"""The messages of ISIS's binary control networks: their fields, and conversion to and from records.

They are made known to protobuf when first needed, without protoc. Numbers of the fields: DOI-USGS/ISIS3,
isis/src/control/objs/ControlNetVersioner/, from which these are ControlPointFileEntryV0002.proto (points of version 2
and of version 5 alike), ControlNetFileHeaderV0005.proto and ControlNetFileHeaderV0002.proto; the same in
DOI-USGS/plio, plio/io/ControlPointFileEntryV0005.proto, ControlNetFileHeaderV0005.proto and ControlNetFileV0002.proto.
Version 1, whose network is one message and whose figures of merit are another, of the same points and measures in the
same order: ControlNetFileProtoV0001.proto and ControlNetLogDataProtoV0001.proto beside the former. What becomes of
them: ControlNetVersioner.cpp (createPoint, createMeasure, writeFirstPoint, readProtobufV0001), ControlPointV0003.cpp.

Fields are called as in the records (`networks.record`): names don't come into the files. To protobuf all of them are
optional here, enumerations are whole numbers and texts are bytes, so that what is wrong with them is found, and said
with the keyword of ISIS's PVL; what is not there reads as UNSET or NULL. Left out: log entries of points and the truth
values of log entries, which ISIS neither writes nor reads, and the header's numPoints, which it doesn't write.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from typing import Any

from mgsgraph.errors import InputError, require
from mgsgraph.files.networks.record import AprioriSource, ControlMeasure, ControlPoint, MeasureType, PointType

_HEADER = (
    "1 text network_id, 2 text target_name, 3 text created, 4 text last_modified, 5 text description, 6 text user_name"
)
_FIELDS = {
    "Log": "1 whole kind, 2 number value",
    "Measure": (
        "1 text serial_number, 2 whole type, 3 number sample, 4 number line, 5 number sample_residual, "
        "6 number line_residual, 7 text chooser_name, 8 text date_time, 9 flag edit_lock, 10 flag ignore, "
        "11 flag jigsaw_rejected, 12 number diameter, 13 number apriori_sample, 14 number apriori_line, "
        "15 number sample_sigma, 16 number line_sigma, 17 Log* log"
    ),
    "Point": (
        "1 text id, 2 whole type, 3 text chooser_name, 4 text date_time, 5 flag edit_lock, 6 flag ignore, "
        "7 flag jigsaw_rejected, 8 whole reference, 9 whole apriori_source, 10 text apriori_source_file, "
        "11 whole apriori_radius_source, 12 text apriori_radius_source_file, 13 flag latitude_constrained, "
        "14 flag longitude_constrained, 15 flag radius_constrained, 16 number apriori_x, 17 number apriori_y, "
        "18 number apriori_z, 19 number+ apriori_covariance, 20 number adjusted_x, 21 number adjusted_y, "
        "22 number adjusted_z, 23 number+ adjusted_covariance, 25 Measure* measures"
    ),
    "Header": f"{_HEADER}, 10 number* target_radii",
    "OldHeader": f"{_HEADER}, 7 whole+ sizes",
    "FirstPlace": "1 number sample, 2 number line, 3 number sample_residual, 4 number line_residual",
    "FirstMeasure": (
        "1 text serial_number, 2 whole type, 3 text chooser_name, 4 text date_time, 5 flag edit_lock, 6 flag ignore, "
        "7 flag jigsaw_rejected, 8 FirstPlace place, 9 number diameter, 10 number apriori_sample, "
        "11 number apriori_line, 12 number sample_sigma, 13 number line_sigma"
    ),
    "FirstPoint": (
        "1 text id, 2 whole type, 3 text chooser_name, 4 text date_time, 5 flag edit_lock, 6 flag ignore, "
        "7 flag jigsaw_rejected, 8 whole apriori_source, 9 text apriori_source_file, 10 whole apriori_radius_source, "
        "11 text apriori_radius_source_file, 12 number apriori_x, 13 number apriori_y, 14 number apriori_z, "
        "15 number+ apriori_covariance, 16 number adjusted_x, 17 number adjusted_y, 18 number adjusted_z, "
        "19 number+ adjusted_covariance, 20 FirstMeasure* measures, 21 whole reference, 22 flag latitude_constrained, "
        "23 flag longitude_constrained, 24 flag radius_constrained"
    ),
    "FirstNetwork": (
        "2 text network_id, 3 text target_name, 4 text created, 5 text last_modified, 6 text description, "
        "7 text user_name, 8 FirstPoint* points"
    ),
    "FirstLog": "2 whole kind, 3 number value",
    "FirstMeasureLog": "2 FirstLog* log",
    "FirstPointLog": "2 FirstMeasureLog* measures",
    "FirstNetworkLog": "1 FirstPointLog* points",
}
"""Number, kind and name of each message's fields; * is repeated, + packed."""
_KINDS = {"text": "TYPE_BYTES", "whole": "TYPE_INT32", "flag": "TYPE_BOOL", "number": "TYPE_DOUBLE"}
UNSET = -1
"""What a whole number reads as that is not there."""
NULL = -1.7976931348623157e308
"""What a number reads as that is not there; ISIS's own Null, and its other special values, are within 1e294 of it."""
LARGEST = 1e300
"""Larger numbers are none, here as in PVL: ISIS's special values begin there."""


@cache
def message_class(name: str) -> Any:
    """Protobuf's class of a message."""
    from google.protobuf import message_factory

    return message_factory.GetMessageClass(_pool().FindMessageTypeByName(f"Isis.{name}"))


@cache
def _pool() -> Any:
    from google.protobuf import descriptor_pb2, descriptor_pool

    file = descriptor_pb2.FileDescriptorProto(name="control_network.proto", package="Isis", syntax="proto2")
    for name, fields in _FIELDS.items():
        message = file.message_type.add(name=name)
        for number, kind, field in map(str.split, fields.split(", ")):
            plain, many = kind.rstrip("*+"), kind[-1] in "*+"
            entry = message.field.add(
                name=field, number=int(number), type=_KINDS.get(plain, "TYPE_MESSAGE"),
                label="LABEL_REPEATED" if many else "LABEL_OPTIONAL",
                type_name=None if plain in _KINDS else f".Isis.{plain}",
            )  # fmt: skip
            if kind.endswith("+"):
                entry.options.packed = True
            if plain in ("whole", "number") and not many:
                entry.default_value = repr(UNSET if plain == "whole" else NULL)
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(file.SerializeToString())
    return pool


# --- values


class Texts(dict[bytes, str]):
    """Texts by their bytes; equal ones are one object, for there are few names and dates in many measures."""

    def __missing__(self, data: bytes) -> str:
        try:
            text = self[data] = data.decode("utf-8")
        except UnicodeDecodeError:
            raise InputError("text", f"{data[:60]!r}", "UTF-8") from None
        return text


def encoded(text: str) -> bytes | None:
    """A text's bytes; None for an empty one."""
    try:
        return text.encode("utf-8") if text else None
    except UnicodeEncodeError:
        raise InputError("text", f"{text[:60]!r}", "what UTF-8 can hold") from None


def finite(value: float, key: str) -> float:
    """The number, if it is one."""
    if not -LARGEST < value < LARGEST:
        raise InputError(key, f"{value}", "a finite number")
    return value


def _optional(value: float, key: str) -> float | None:
    """A number; None for the special values by which ISIS says that it was never set."""
    return None if NULL <= value <= -LARGEST else finite(value, key)


def _covariance(values: Sequence[float], key: str) -> tuple[float, ...]:
    if len(values) not in (0, 6):
        raise InputError(key, f"{len(values)} numbers", "xx, xy, xz, yy, yz, zz")
    return tuple(finite(value, key) for value in values)


def _named(text: str, key: str) -> str:
    if not text:
        raise InputError(key, "none", "a name")
    return text


def _choice(kinds: dict[int, Any]) -> Callable[[int, str], Any]:
    def chosen(number: int, key: str) -> Any:
        if number not in kinds:
            raise InputError(key, "none" if number == UNSET else f"{number}", f"one of {', '.join(map(str, kinds))}")
        return kinds[number]

    return chosen


_source = _choice({int(source): source for source in AprioriSource} | {UNSET: AprioriSource.NONE})
_POINT_TYPES = {0: PointType.FREE, 1: PointType.FIXED} | {int(kind): kind for kind in PointType}
"""By number in the file; 0 and 1 are Tie and Ground of old."""
_KEYS: dict[tuple[str, str], tuple[str, Callable[[Any, str], Any]]] = {
    ("Point", "id"): ("PointId", _named), ("Measure", "serial_number"): ("SerialNumber", _named),
    ("Point", "type"): ("PointType", _choice(_POINT_TYPES)),
    ("Measure", "type"): ("MeasureType", _choice({int(kind): kind for kind in MeasureType})),
    ("Point", "apriori_source"): ("AprioriXYZSource", _source),
    ("Point", "apriori_radius_source"): ("AprioriRadiusSource", _source),
    ("Point", "apriori_covariance"): ("AprioriCovarianceMatrix", _covariance),
    ("Point", "adjusted_covariance"): ("AdjustedCovarianceMatrix", _covariance),
}  # fmt: skip
"""ISIS's keyword of a field and what checks its value, where these don't follow from its name and kind."""


def _plan(message: str) -> list[tuple[str, str, str, Callable[[Any, str], Any] | None]]:
    """Name, kind and keyword of a message's fields, and what checks their values."""
    plan = []
    for _, kind, name in map(str.split, _FIELDS[message].split(", ")):
        plain = "".join(map(str.capitalize, name.split("_")))
        key, check = _KEYS.get((message, name), (plain, _optional if kind == "number" else None))
        plan.append((name, kind.rstrip("*+"), key, check))
    return [field for field in plan if field[1] in _KINDS]


_PLANS = {message: _plan(message) for message in ("Point", "Measure")}


def _values(message: Any, kind: str, texts: Texts) -> dict[str, Any]:
    """Values of a message's fields, which are checked, by their names."""
    values = {}
    for name, field, key, check in _PLANS[kind]:
        value = getattr(message, name)
        if field == "text":
            value = texts[value]
        values[name] = value if check is None else check(value, key)
    return values


# --- records of messages


def read_point(message: Any, where: str, texts: Texts) -> ControlPoint:
    """The point of a message; `where` begins its errors, `texts` are those met before."""
    if message.id:
        name = message.id[:60].decode("utf-8", "replace").replace("\n", " ")
        where += f" ({name})"
    count = len(message.measures)
    try:
        values = _values(message, "Point", texts)
        if not UNSET <= values["reference"] < count:
            found = f"measure {values['reference']} (counted from 0) as reference"
            raise InputError("Reference", found, f"one of its {count} measures")
        values["reference"] = None if values["reference"] == UNSET else values["reference"]
        for stage in ("apriori", "adjusted"):
            values[stage] = _place([values.pop(f"{stage}_{axis}") for axis in "xyz"], stage.capitalize())
        measures = [_read_measure(measure, k, texts) for k, measure in enumerate(message.measures, start=1)]
    except InputError as error:
        raise error.within(where) from None
    return ControlPoint(measures=tuple(measures), **values)


def _read_measure(message: Any, number: int, texts: Texts) -> ControlMeasure:
    try:
        log = [(entry.kind, _optional(entry.value, "log data")) for entry in message.log]
        figures = tuple((kind, value) for kind, value in log if kind > 0 and value is not None)  # as IsValid has it
        return ControlMeasure(log=figures, **_values(message, "Measure", texts))
    except InputError as error:
        raise error.within(f"measure {number}") from None


def _place(values: list[float | None], stage: str) -> tuple[float, float, float] | None:
    x, y, z = values
    if x is None and y is None and z is None:
        return None
    if x is None or y is None or z is None:
        raise InputError(stage, "a place in part", f"{stage}X, {stage}Y and {stage}Z")
    return x, y, z


# --- messages of records


def point_message(point: ControlPoint) -> Any:
    """The message of a point; None is left out, the sources are not, as in ISIS."""
    log = message_class("Log")
    measures = [
        _message(measure, "Measure", log=[log(kind=kind, value=finite(value, "log")) for kind, value in measure.log])
        for measure in point.measures
    ]
    places = {
        f"{stage}_{axis}": value
        for stage, place in (("apriori", point.apriori), ("adjusted", point.adjusted))
        for axis, value in zip("xyz", place or (None,) * 3, strict=True)
    }
    return _message(point, "Point", places, measures=measures)


def points_content(points: Iterable[ControlPoint], where: Callable[[int], str] = "point {}".format) -> bytes:
    """Points one after the other as they lie in the file; `where` names one by its number in what is refused."""
    parts = list[bytes]()
    for index, point in enumerate(points):
        try:
            message = point_message(point).SerializeToString()
        except InputError as error:
            raise error.within(where(index)) from None
        parts += (len(message).to_bytes(4, "little"), message)
    return b"".join(parts)


def _message(record: Any, kind: str, others: dict[str, Any] | None = None, **inner: Any) -> Any:
    """The message of a record, of whose fields `others` stand in place of attributes, and `inner` are messages."""
    fields: dict[str, Any] = {}
    for name, field, key, check in _PLANS[kind]:
        value = others[name] if others and name in others else getattr(record, name)
        if field == "text":
            fields[name] = encoded(value)
        elif field == "flag":
            fields[name] = value or None
        elif field == "whole":
            fields[name] = value if value is None else int(value)
        elif value is not None:
            fields[name] = finite(value, key) if check is _optional else _covariance(value, key)
    return message_class(kind)(**fields, **inner)


# --- version 1


def second_versions(network: Any, log: Any, where: str) -> Iterator[Any]:
    """Points of a network of version 1 and its figures of merit as messages of version 2, as ISIS takes them.

    There types of measures are counted from 1, a measure's place is a message of its own, and every point with an
    a-priori covariance is constrained. Raises InputError for figures of merit of other points or measures.
    """
    _require_same(len(log.points), len(network.points), f"{where}, LogData, points")
    for number, (point, figures) in enumerate(zip(network.points, log.points, strict=True), start=1):
        _require_same(len(figures.measures), len(point.measures), f"{where}, LogData, point {number}, measures")
        converted = message_class("Point")(**_set(point))
        for measure, merit in zip(point.measures, figures.measures, strict=True):
            added = converted.measures.add(**_set(measure), **_set(measure.place))
            added.type = measure.type - 1 if measure.type != UNSET else UNSET
            for entry in merit.log:
                added.log.add(**_set(entry))
        if converted.apriori_covariance:
            converted.type = int(PointType.CONSTRAINED)
        yield converted


def _set(message: Any) -> dict[str, Any]:
    """Fields that are set, without inner messages."""
    return {field.name: value for field, value in message.ListFields() if field.message_type is None}


def _require_same(found: int, expected: int, where: str) -> None:
    require(found == expected, where, f"{found}", f"{expected}, as in Core", "the file is damaged: write it again")
