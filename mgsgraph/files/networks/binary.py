"""ISIS's binary control networks, version 5 written and read, versions 1 and 2 read (there are no others).

A label in PVL, padded with NUL to 65536 bytes; ProtoBuffer/Core in it says where the messages are (HeaderStartByte,
HeaderBytes, PointsStartByte, PointsBytes), ProtoBuffer/ControlNetworkInfo the version, and the rest for human eyes.
Then the header, and the points: in version 5 each behind its size (uint32, little endian), in version 2 one upon the
other, with their sizes in the header. Points begin where the header ends, and in version 5 end after PointsBytes. In
version 1 (that of a label without one) there are two messages, at StartByte, Bytes of Core and of LogData.
Source: DOI-USGS/ISIS3, isis/src/control/objs/ControlNetVersioner/ControlNetVersioner.cpp (write, writeFirstPoint,
readProtobufV0005, readProtobufV0002, readProtobufV0001); 2 and 5 in DOI-USGS/plio, plio/io/io_controlnetwork.py, too
(IsisStore.read). Messages: `networks.messages`.

A network is read from either of its forms, recognized by what is in the file.
"""

import re
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace

from mgsgraph.errors import InputError, errors_from, require
from mgsgraph.files.networks.messages import (
    Texts,
    encoded,
    finite,
    message_class,
    points_content,
    read_point,
    second_versions,
)
from mgsgraph.files.networks.pvl import HEAD_TEXTS, parse_pvl_network, where_in
from mgsgraph.files.networks.record import (
    ControlNetwork,
    ControlPoint,
    MeasureType,
    PointType,
    Where,
    of_mars,
    with_names,
)
from mgsgraph.files.networks.tie_points import PointArrays, TiePoints, tie_points
from mgsgraph.files.opening import name_of, read_bytes
from mgsgraph.files.pvl import Block, Document, Value, keyword_lines, text_value, whole_label
from mgsgraph.files.writing import require_as_recorded, write_file
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.records import LONGEST_NAME, Index, Mask
from mgsgraph.names import Names, RepeatedNames

LABEL_BYTES = 65536
"""Of a label, or a multiple of them."""
_SIZE = struct.Struct("<I")
_HEAD = re.compile(
    rb"(?:\s++|#[^\n]*+|/\*.*?\*/)*+(?:begin_)?object\s*+=\s*+protobuffer\b", re.IGNORECASE | re.DOTALL
)
_LOOKED_AT = 4096
"""Bytes from the file's start in which a binary network says that it is one."""
_ANEW = "let ISIS write it again: cnetbin2pvl, then cnetpvl2bin"
_OF_OLD = np.array([PointType.FREE, PointType.FIXED, *PointType])
"""Types of points by their numbers in the file: 0 and 1 are Tie and Ground of old."""


def is_binary(data: bytes) -> bool:
    """Whether a file's content is a binary network, by how it begins."""
    return _HEAD.match(data[:_LOOKED_AT]) is not None


def parse_binary_network(data: bytes, source: str) -> ControlNetwork:
    """The network that a file's content holds.

    Parameters
    ----------
    data : bytes
        All of the file; sizes stated in it are believed only as far as it reaches.
    source : str
        File, for messages.

    Raises
    ------
    InputError
        With file, byte, number and id of the point: a label that is none or contradicts itself; another version;
        content cut short; a message that is none; an unknown type, a number that is not finite, text that is not UTF-8;
        a point without id or type, an id twice, a place or covariance in part; no point at all.
    """
    content = binary_content(data, source)
    texts = Texts()
    points = tuple(content.point(k, texts) for k in range(content.begin.size))
    return replace(content.head, points=points)


class BinaryContent(NamedTuple):
    """A network's head, and where the messages of its points are, as of version 2 and 5."""

    head: ControlNetwork
    """Without points; its source is the file."""
    data: bytes
    begin: Index
    """(n,) byte of `data` at which each point's message begins."""
    end: Index
    """(n,) byte behind it."""

    def where(self, number: int) -> str:
        """File, byte and point, by its number from 0."""
        return f"{self.head.source}, byte {self.begin[number]}, point {number + 1}"

    def point(self, number: int, texts: Texts) -> ControlPoint:
        """One of the points; InputError with what is wrong with it."""
        message, where = self.data[self.begin[number] : self.end[number]], self.where(number)
        return read_point(_parsed("Point", message, where), where, texts)


def binary_content(data: bytes, source: str) -> BinaryContent:
    """Head of a file's content and places of its points; InputError as `parse_binary_network` has it of label, header
    and sizes, and for no point at all.
    """
    version, buffer = _label_of(data, source)
    if version == "1":
        head, parts = _first(data, buffer, source)
        end = np.cumsum([len(part) for part in parts], dtype=np.int64)
        data, begin = b"".join(parts), np.concatenate([[0], end[:-1]]).astype(np.int64)
    else:
        head, start, size = _header(data, version, buffer, source)
        sizes = head.sizes if version == "2" else None
        begin, end = (
            _behind_sizes(data, start, size, source) if sizes is None else _by_sizes(data, start, sizes, source)
        )
    header = _head_of(head, version, source)
    require(end.size, source, "no control point", "an ISIS control network that has some")
    return BinaryContent(header, data, begin, end)


def _label_of(data: bytes, source: str) -> tuple[str, Block]:
    """Version, and what the label says of the messages."""
    label = (data[: data.find(b"\0")] if b"\0" in data else data).decode("latin-1")
    return _version(Document(source, label.replace("\r\n", "\n").replace("\r", "\n")))


def _head_of(head: Any, version: str, source: str) -> ControlNetwork:
    """Of a header's message a network without points."""
    texts = Texts()
    with errors_from(f"{source}, header"):
        values = {name: texts[getattr(head, name)] for name in HEAD_TEXTS.values()}
        values["target_name"] = of_mars(values["target_name"])
        radii = _radii(head.target_radii) if version == "5" else ()
    return ControlNetwork(points=(), source=source, target_radii=radii, **values)


def _first(data: bytes, buffer: Block, source: str) -> tuple[Any, list[bytes]]:
    """Head of a network of version 1, and messages of its points as of version 2."""
    parts = []
    for name, kind in (("Core", "FirstNetwork"), ("LogData", "FirstNetworkLog")):
        with _anew():
            start, size = (_bytes(buffer.inner(name), key) for key in ("StartByte", "Bytes"))
        if start + size > len(data):
            raise _cut_short(f"{source}, {name}", f"{len(data)} bytes", f"its end at byte {start + size}")
        parts.append(_parsed(kind, data[start : start + size], f"{source}, {name}"))
    return parts[0], [message.SerializeToString() for message in second_versions(parts[0], parts[1], source)]


def _header(data: bytes, version: str, buffer: Block, source: str) -> tuple[Any, int, int]:
    """Message of the header of a network of version 2 or 5, where it ends, and the size of all points."""
    start, header_size, points_size = _layout(buffer)
    end = start + header_size
    if end > len(data):
        raise _cut_short(source, f"{len(data)} bytes", f"a header up to byte {end}")
    kind = "Header" if version == "5" else "OldHeader"
    return _parsed(kind, data[start:end], f"{source}, header"), end, points_size


def _radii(values: Sequence[float]) -> tuple[float, ...]:
    require(len(values) in (0, 3), "TargetRadii", f"{len(values)} numbers", "3")
    return tuple(finite(value, "TargetRadii") for value in values)


def _version(document: Document) -> tuple[str, Block]:
    """Version, and what the label says of the messages."""
    with _anew():
        buffer = whole_label(document).inner("ProtoBuffer")
        info = buffer.inner("ControlNetworkInfo")
        version = info.text("Version") if "Version" in info else "1"
        if version not in ("1", "2", "5"):
            raise InputError(info.where("Version"), f"version {version}", "5 (1 and 2 are understood too)")
    return version, buffer


def _layout(buffer: Block) -> tuple[int, int, int]:
    """The header's first byte and size, and the size of all points."""
    with _anew():
        core = buffer.inner("Core")
        start, header, points_start, points = (
            _bytes(core, key) for key in ("HeaderStartByte", "HeaderBytes", "PointsStartByte", "PointsBytes")
        )
        if points_start != start + header:
            found = f"points from byte {points_start}, and a header that ends at {start + header}"
            raise InputError(core.where("PointsStartByte"), found, "one behind the other")
    return start, header, points


@contextmanager
def _anew() -> Iterator[None]:
    """All errors of a label have one remedy."""
    try:
        yield
    except InputError as error:
        raise InputError(error.where, error.found, error.expected, f"binary network: {_ANEW}") from None


def _bytes(core: Block, key: str) -> int:
    text = core.text(key)
    require(re.fullmatch(r"\d{1,18}", text, re.ASCII), core.where(key), repr(text[:60]), "a number of bytes")
    return int(text)


def _behind_sizes(data: bytes, start: int, size: int, source: str) -> tuple[Index, Index]:
    """Where messages of version 5 begin and end."""
    stop, begin, end = start + size, list[int](), [start]
    if stop > len(data):
        raise _cut_short(source, f"{len(data)} bytes", f"points up to byte {stop}")
    while end[-1] < stop:
        begin.append(end[-1] + _SIZE.size)
        end.append(begin[-1] + (_SIZE.unpack_from(data, end[-1])[0] if begin[-1] <= stop else 0))
    if end[-1] > stop:
        raise _cut_short(f"{source}, point {len(begin)}", f"its end at byte {end[-1]}", f"none behind byte {stop}")
    if data[stop:].strip(b"\0"):
        raise _cut_short(source, f"{len(data)} bytes", f"points up to byte {stop}, and nothing behind them")
    return np.array(begin, dtype=np.int64), np.array(end[1:], dtype=np.int64)


def _by_sizes(data: bytes, start: int, of_header: Sequence[int], source: str) -> tuple[Index, Index]:
    """Where messages of version 2 begin and end."""
    sizes = np.array(of_header, dtype=np.int64)
    end = start + np.cumsum(sizes)
    for k in np.flatnonzero((sizes < 0) | (end > len(data)))[:1].tolist():
        found = f"its end at byte {end[k]}" if sizes[k] >= 0 else f"{sizes[k]} bytes"
        raise _cut_short(f"{source}, point {k + 1}", found, f"none behind byte {len(data)}")
    return end - sizes, end


def _cut_short(where: str, found: str, expected: str) -> InputError:
    return InputError(where, found, expected, "the file is cut short or damaged: write it again")


def _parsed(kind: str, data: bytes, where: str) -> Any:
    """The message of a kind, parsed from bytes."""
    from google.protobuf.message import DecodeError

    message = message_class(kind)()
    try:
        message.ParseFromString(data)
    except DecodeError:
        raise InputError(where, f"{len(data)} bytes that are no such message", "ISIS's", _ANEW) from None
    return message


# --- tie points, without an object for each point and measure


def binary_tie_points(data: bytes, source: str, body: Ellipsoid | None = None) -> TiePoints:
    """What an adjustment takes from the content of a binary network; fields that it doesn't take are not judged.

    Parameters
    ----------
    data : bytes
        All of the file.
    source : str
        File, for messages.
    body : Ellipsoid, optional
        That of the images.

    Raises
    ------
    InputError
        With file, byte, and number and id of the point: what `parse_binary_network` and `tie_points` refuse.
    """
    content = binary_content(data, source)
    with_names(content.head)
    arrays = _decoded(content)

    def where(number: int, measure: int | None, key: str) -> str:
        image = "" if measure is None else f"image {arrays.image[int(arrays.first[number]) + measure]}"
        return ", ".join(filter(None, (f"{content.where(number)} ({arrays.ids[number][:60]})", image, key)))

    return arrays.tie_points(where, body)


def _decoded(content: BinaryContent) -> PointArrays:
    from mgsgraph.files.networks import wire

    begin, end, data = content.begin, content.end, np.frombuffer(content.data, dtype=np.uint8)
    count = wire.count_measures(data, begin, end)
    _require(count >= 0, content)
    first = np.concatenate([[0], np.cumsum(count)])
    n, k = begin.size, int(first[-1])
    types, kinds, ignored, out = np.full(n, -1), np.full(k, -1), np.zeros(n, dtype=bool), np.zeros(k, dtype=bool)
    ids, images = np.zeros((n, 2), dtype=np.int64), np.zeros((k, 2), dtype=np.int64)
    both, covariances, measures = np.full((n, 6), np.nan), np.full((n, 6), np.nan), np.full((k, 4), np.nan)
    done = wire.read_points(data, begin, end, first, types, ids, ignored, both, covariances, measures, out, kinds,
                            images)  # fmt: skip
    _require(np.arange(n) != done, content)
    names, coded = _names_at(data, ids), _names_at(data, images).arrow.dictionary_encode()
    image, distinct = np.asarray(coded.indices).astype(np.int64), Names.of(coded.dictionary)
    _require(_shown(names) & (types >= 0) & (types < _OF_OLD.size), content)
    if names.first_repeated is not None:
        number = names.first_repeated
        first_index = names.tolist().index(names[number])
        where = f"{content.where(number)} ({names[number]})"
        raise InputError(where, f"the id twice, first at point {first_index + 1}", "each id once")
    point, types = np.repeat(np.arange(n), count), _OF_OLD[types]
    sound = _shown(distinct)[image] & (kinds >= 0) & (kinds < len(MeasureType)) & ~np.any(np.isinf(measures), axis=1)
    _require(np.bincount(point[~sound], minlength=n) == 0, content)
    free, missing = types == PointType.FREE, np.isnan(both).reshape(n, 2, 3)
    in_part = np.any(missing.any(axis=2) != missing.all(axis=2), axis=1)
    _require(~(in_part | np.any(np.isinf(both) | np.isinf(covariances), axis=1)), content)
    places = np.where((free & missing[:, 0, 0])[:, None], both[:, 3:], both[:, :3])
    return PointArrays(content.head, names, types, ignored, places, covariances, first,
                       RepeatedNames(tuple(distinct), image), measures, out)  # fmt: skip


def _names_at(content: np.ndarray, spans: Index) -> Names:
    """Texts that lie at spans (m, 2) of a file's content (b,) uint8."""
    from mgsgraph.files.networks import wire

    offsets = np.concatenate([[0], np.cumsum(spans[:, 1] - spans[:, 0])]).astype(np.int64)
    return Names(wire.gathered(content, spans, int(offsets[-1])), offsets)


def _shown(names: Names) -> Mask:
    """Which names (n,) can be shown (`record.require_shown`)."""
    sizes = np.diff(names.offsets)
    valid = (sizes >= 1) & (sizes <= LONGEST_NAME)
    if not names.data.tobytes().isascii() or not names.text.isprintable():
        texts = [names.data[a:b].tobytes().decode(errors="replace") for a, b in pairwise(names.offsets.tolist())]
        valid = np.array([text.isprintable() and "\ufffd" not in text and 1 <= len(text) <= LONGEST_NAME
                          for text in texts])  # fmt: skip
    return valid


def _require(sound: Mask, content: BinaryContent) -> None:
    """Raise the InputError for the first point (n,) that is not sound."""
    for number in np.flatnonzero(~sound)[:1].tolist():
        raise _refusal(content, number)


def _refusal(content: BinaryContent, number: int) -> InputError:
    """The InputError for a point, by its number from 0."""
    try:
        point = content.point(number, Texts())
        where = f"{content.where(number)} ({point.id[:60]})"
        name_of(point.id, where, "an id")
        for measure in point.measures:
            name_of(measure.serial_number, where, "an image's name")
    except InputError as error:
        return error
    return InputError(where, "a message with fields of other kinds", "those of ISIS's networks", _ANEW)


# --- writing


def write_binary_network(network: ControlNetwork, path: Path) -> None:
    """Write a network as ISIS's binary version 5.

    Parameters
    ----------
    network : ControlNetwork
        All of it is kept.
    path : Path
        Its folder is made when absent; a file of that name is replaced, once the new one is there whole.

    Raises
    ------
    InputError
        A network without points, a number that is not finite, or a file that can't be written.
    """
    write_file(path, binary_network(network))


def binary_network(network: ControlNetwork) -> bytes:
    """What `write_binary_network` writes."""
    require(network.points, network.source or "network", "no control point", "some to write")
    points, measures = points_content(network.points, network.where), sum(len(p.measures) for p in network.points)
    header = network_header(network)
    label = network_label(network, len(network.points), measures, len(header), len(points))
    return b"".join((label, header, points))


def network_header(network: ControlNetwork) -> bytes:
    """The header's message, of a network with or without its points."""
    texts = {name: encoded(getattr(network, name)) or b"" for name in HEAD_TEXTS.values()}  # all of them, as in ISIS
    head = message_class("Header")(target_radii=_radii(network.target_radii), **texts)
    return head.SerializeToString()  # type: ignore[no-any-return]


def network_label(network: ControlNetwork, points: int, measures: int, header: int, size: int) -> bytes:
    """The label, padded to a multiple of 65536 bytes, of a network with so many points and measures, whose header and
    points take `header` and `size` bytes; its own points aren't looked at.
    """
    start, label = 0, b""
    while len(label) >= start:  # a longer label moves the bytes whose positions it gives
        start += LABEL_BYTES
        label = _label_text(network, (points, measures), start, header, size).encode("utf-8")
    return label.ljust(start, b"\0")


def _label_text(network: ControlNetwork, counts: tuple[int, int], start: int, header: int, points: int) -> str:
    core: list[tuple[str, Value]] = [
        ("HeaderStartByte", f"{start}"),
        ("HeaderBytes", f"{header}"),
        ("PointsStartByte", f"{start + header}"),
        ("PointsBytes", f"{points}"),
    ]
    info: list[tuple[str, Value]] = [
        (key, _for_eyes(getattr(network, attribute))) for key, attribute in HEAD_TEXTS.items()
    ]
    if network.target_radii:
        info.insert(2, ("TargetRadii", tuple(map(repr, network.target_radii))))
    info += [("NumberOfPoints", f"{counts[0]}"), ("NumberOfMeasures", f"{counts[1]}"), ("Version", "5")]
    return "\n".join([
        "Object = ProtoBuffer",
        "  Object = Core",
        *keyword_lines(core, 4),
        "  End_Object",
        "",
        "  # This group is for informational purposes only",
        "  Group = ControlNetworkInfo",
        *keyword_lines(info, 4),
        "  End_Group",
        "End_Object",
        "End\n",
    ])


def _for_eyes(text: str) -> str:
    """A text for the label, where nothing reads it: without what PVL or the label can't hold."""
    return text_value(re.sub(r"[\0\r\n]+", " ", text).replace('"', "'"), "label")


def read_network(path: Path) -> ControlNetwork:
    """Read an ISIS control network with all that is in it.

    Parameters
    ----------
    path : Path
        PVL text of version 1 to 5, or ISIS's binary form of version 1, 2 or 5, whatever its name.

    Returns
    -------
    ControlNetwork
        Points in the file's order, ignored ones too.

    Raises
    ------
    InputError
        With the file, and line and point (text) or byte, number and id (binary): see `parse_pvl_network` and
        `parse_binary_network`.
    """
    return _with_places(path, _content(path))[0]


def read_control_network(path: Path, body: Ellipsoid | None = None) -> TiePoints:
    """Read what an adjustment takes from an ISIS control network; see `tie_points` for what that is.

    Parameters
    ----------
    path : Path
        PVL text of version 1 to 5, or ISIS's binary form of version 1, 2 or 5, recognized by what is in the file.
    body : Ellipsoid, optional
        That of the images.

    Returns
    -------
    TiePoints
        In the file's order; images are called by their serial numbers; measure sigmas are NaN where the file has none.

    Raises
    ------
    InputError
        With the file, and line and point (text) or byte, number and id of the point (binary): what `read_network` and
        `tie_points` refuse; a network of another body.
    """
    data = _content(path)
    if is_binary(data):
        return binary_tie_points(data, str(path), body)
    network, where = _with_places(path, data)
    return tie_points(network, where, body)


def _content(path: Path) -> bytes:
    data = read_bytes(path)
    require_as_recorded(path, data)
    return data


def _with_places(path: Path, data: bytes) -> tuple[ControlNetwork, Where]:
    """The network, and words for where its points and measures stand in the file."""
    if is_binary(data):
        network = with_names(parse_binary_network(data, str(path)))
        return network, network.where
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        expected = "a control network, in PVL text or ISIS's binary form"
        raise InputError(str(path), f"byte {error.start} is not UTF-8 text", expected) from None
    document = Document(str(path), text.replace("\r\n", "\n").replace("\r", "\n"))
    return with_names(parse_pvl_network(document)), where_in(document)
