"""The messages of ISIS's binary control networks, made known to protobuf when first needed, without protoc.

Names and numbers of the fields: DOI-USGS/ISIS3, isis/src/control/objs/ControlNetVersioner/, from which these are
ControlPointFileEntryV0002.proto (points of version 2 and of version 5 alike), ControlNetFileHeaderV0005.proto and
ControlNetFileHeaderV0002.proto; the same in DOI-USGS/plio, plio/io/ControlPointFileEntryV0005.proto,
ControlNetFileHeaderV0005.proto and ControlNetFileV0002.proto. Version 1, whose network is one message and whose figures
of merit are another: ControlNetFileProtoV0001.proto and ControlNetLogDataProtoV0001.proto beside the former.

On the wire nothing differs from ISIS's own; to protobuf all fields are optional here, enumerations are whole numbers
and texts are bytes, so that what is wrong with them is found, and said, by `networks.point_messages`; what is not there
reads as UNSET or NULL. Fields that version 1 has elsewhere are called as in version 2. Left out: log entries of points
and the truth values of log entries, which ISIS neither writes nor reads, and the header's numPoints, which it doesn't
write.
"""

from functools import cache
from typing import Any, NamedTuple

_TEXT, _WHOLE, _FLAG, _NUMBER, _MESSAGE = "TYPE_BYTES", "TYPE_INT32", "TYPE_BOOL", "TYPE_DOUBLE", "TYPE_MESSAGE"


class Field(NamedTuple):
    """A field of a message."""

    name: str
    number: int
    kind: str
    many: bool = False
    packed: bool = False
    of: str = ""
    """Message that it holds."""


_POINT = (
    Field("id", 1, _TEXT),
    Field("type", 2, _WHOLE),
    Field("chooserName", 3, _TEXT),
    Field("datetime", 4, _TEXT),
    Field("editLock", 5, _FLAG),
    Field("ignore", 6, _FLAG),
    Field("jigsawRejected", 7, _FLAG),
    Field("referenceIndex", 8, _WHOLE),
    Field("aprioriSurfPointSource", 9, _WHOLE),
    Field("aprioriSurfPointSourceFile", 10, _TEXT),
    Field("aprioriRadiusSource", 11, _WHOLE),
    Field("aprioriRadiusSourceFile", 12, _TEXT),
    Field("latitudeConstrained", 13, _FLAG),
    Field("longitudeConstrained", 14, _FLAG),
    Field("radiusConstrained", 15, _FLAG),
    Field("aprioriX", 16, _NUMBER),
    Field("aprioriY", 17, _NUMBER),
    Field("aprioriZ", 18, _NUMBER),
    Field("aprioriCovar", 19, _NUMBER, many=True, packed=True),
    Field("adjustedX", 20, _NUMBER),
    Field("adjustedY", 21, _NUMBER),
    Field("adjustedZ", 22, _NUMBER),
    Field("adjustedCovar", 23, _NUMBER, many=True, packed=True),
    Field("measures", 25, _MESSAGE, many=True, of="Measure"),
)
_MEASURE = (
    Field("serialnumber", 1, _TEXT),
    Field("type", 2, _WHOLE),
    Field("sample", 3, _NUMBER),
    Field("line", 4, _NUMBER),
    Field("sampleResidual", 5, _NUMBER),
    Field("lineResidual", 6, _NUMBER),
    Field("choosername", 7, _TEXT),
    Field("datetime", 8, _TEXT),
    Field("editLock", 9, _FLAG),
    Field("ignore", 10, _FLAG),
    Field("jigsawRejected", 11, _FLAG),
    Field("diameter", 12, _NUMBER),
    Field("apriorisample", 13, _NUMBER),
    Field("aprioriline", 14, _NUMBER),
    Field("samplesigma", 15, _NUMBER),
    Field("linesigma", 16, _NUMBER),
    Field("log", 17, _MESSAGE, many=True, of="Log"),
)
_LOG = (Field("doubleDataType", 1, _WHOLE), Field("doubleDataValue", 2, _NUMBER))
_HEADER = (
    Field("networkId", 1, _TEXT),
    Field("targetName", 2, _TEXT),
    Field("created", 3, _TEXT),
    Field("lastModified", 4, _TEXT),
    Field("description", 5, _TEXT),
    Field("userName", 6, _TEXT),
    Field("targetRadii", 10, _NUMBER, many=True),
)
_OLD_HEADER = (*_HEADER[:-1], Field("pointMessageSizes", 7, _WHOLE, many=True, packed=True))
_FIRST_NUMBERS = {
    "Point": {
        "id": 1, "type": 2, "chooserName": 3, "datetime": 4, "editLock": 5, "ignore": 6, "jigsawRejected": 7,
        "aprioriSurfPointSource": 8, "aprioriSurfPointSourceFile": 9, "aprioriRadiusSource": 10,
        "aprioriRadiusSourceFile": 11, "aprioriX": 12, "aprioriY": 13, "aprioriZ": 14, "aprioriCovar": 15,
        "adjustedX": 16, "adjustedY": 17, "adjustedZ": 18, "adjustedCovar": 19, "measures": 20, "referenceIndex": 21,
        "latitudeConstrained": 22, "longitudeConstrained": 23, "radiusConstrained": 24,
    },
    "Measure": {
        "serialnumber": 1, "type": 2, "choosername": 3, "datetime": 4, "editLock": 5, "ignore": 6, "jigsawRejected": 7,
        "diameter": 9, "apriorisample": 10, "aprioriline": 11, "samplesigma": 12, "linesigma": 13,
    },
    "Place": {"sample": 1, "line": 2, "sampleResidual": 3, "lineResidual": 4},
}  # fmt: skip
"""Of fields in version 1; a measure's place is a message in it."""


def _of_version_one(message: str, fields: tuple[Field, ...]) -> tuple[Field, ...]:
    """Those of these fields that a message of version 1 has, by their numbers there."""
    numbers = _FIRST_NUMBERS[message]
    return tuple(
        field._replace(number=numbers[field.name], of=f"First{field.of}" if field.of else "")
        for field in fields
        if field.name in numbers
    )


_FIRST = {
    "FirstPlace": _of_version_one("Place", _MEASURE),
    "FirstMeasure": (
        *_of_version_one("Measure", _MEASURE), Field("measurement", 8, _MESSAGE, of="FirstPlace"),
    ),
    "FirstPoint": _of_version_one("Point", _POINT),
    "FirstNetwork": (
        *(field._replace(number=field.number + 1) for field in _HEADER[:-1]),
        Field("points", 8, _MESSAGE, many=True, of="FirstPoint"),
    ),
    "FirstLog": (Field("doubleDataType", 2, _WHOLE), Field("doubleDataValue", 3, _NUMBER)),
    "FirstMeasureLog": (Field("log", 2, _MESSAGE, many=True, of="FirstLog"),),
    "FirstPointLog": (Field("measures", 2, _MESSAGE, many=True, of="FirstMeasureLog"),),
    "FirstNetworkLog": (Field("points", 1, _MESSAGE, many=True, of="FirstPointLog"),),
}  # fmt: skip
_MESSAGES = {"Log": _LOG, "Measure": _MEASURE, "Point": _POINT, "Header": _HEADER, "OldHeader": _OLD_HEADER} | _FIRST

UNSET = -1
"""What a whole number reads as that is not there."""
NULL = -1.7976931348623157e308
"""What a number reads as that is not there; ISIS's own Null, and its other special values, are within 1e294 of it."""
_DEFAULTS = {_WHOLE: UNSET, _NUMBER: NULL}


class Messages(NamedTuple):
    """Classes of messages."""

    point: Any
    measure: Any
    log: Any
    header: Any
    """Of version 5."""
    old_header: Any
    """Of version 2."""
    first_network: Any
    """All of a network of version 1 but its figures of merit."""
    first_log: Any
    """These."""


@cache
def messages() -> Messages:
    """The classes of the messages, made once."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    file = descriptor_pb2.FileDescriptorProto(name="control_network.proto", package="Isis", syntax="proto2")
    for name, fields in _MESSAGES.items():
        message = file.message_type.add(name=name)
        for field in fields:
            entry = message.field.add(
                name=field.name,
                number=field.number,
                type=field.kind,
                label="LABEL_REPEATED" if field.many else "LABEL_OPTIONAL",
                type_name=f".Isis.{field.of}" if field.of else None,
            )
            if field.packed:
                entry.options.packed = True
            if field.kind in _DEFAULTS and not field.many:
                entry.default_value = repr(_DEFAULTS[field.kind])
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(file.SerializeToString())
    made = {
        name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"Isis.{name}")) for name in _MESSAGES
    }
    names = ("Point", "Measure", "Log", "Header", "OldHeader", "FirstNetwork", "FirstNetworkLog")
    return Messages(*(made[name] for name in names))
