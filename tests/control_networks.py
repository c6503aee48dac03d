"""Control networks for tests: drawn by hypothesis, laid out on a grid, and as bytes made without protobuf."""

import struct

import msgspec
import numpy as np
from hypothesis import strategies as st

from mgsgraph.files.networks.pvl import network_text
from mgsgraph.files.networks.record import (
    AprioriSource,
    ControlMeasure,
    ControlNetwork,
    ControlPoint,
    MeasureType,
    PointType,
)
from mgsgraph.files.networks.tie_points import TiePoints

NUMBERS = st.floats(-1e299, 1e299)
TEXTS = st.text("abcXYZ019_.:/ #=(){},<>+-*'é漢\t", max_size=12).filter(lambda text: text.lower() != "null")
"""What both forms can hold."""
NAMES = TEXTS.filter(bool)
FLAGS = st.booleans()
OPTIONAL = st.none() | NUMBERS
TRIPLES = st.none() | st.tuples(NUMBERS, NUMBERS, NUMBERS)
COVARIANCES = st.just(()) | st.tuples(*[NUMBERS] * 6)


@st.composite
def measures(draw: st.DrawFn) -> ControlMeasure:
    kinds = draw(st.lists(st.integers(1, 8), unique=True, max_size=3))
    return ControlMeasure(
        serial_number=draw(NAMES), type=draw(st.sampled_from(MeasureType)), sample=draw(OPTIONAL), line=draw(OPTIONAL),
        sample_residual=draw(OPTIONAL), line_residual=draw(OPTIONAL), chooser_name=draw(TEXTS), date_time=draw(TEXTS),
        edit_lock=draw(FLAGS), ignore=draw(FLAGS), jigsaw_rejected=draw(FLAGS), diameter=draw(OPTIONAL),
        apriori_sample=draw(OPTIONAL), apriori_line=draw(OPTIONAL), sample_sigma=draw(OPTIONAL),
        line_sigma=draw(OPTIONAL), log=tuple((kind, draw(NUMBERS)) for kind in kinds),
    )  # fmt: skip


@st.composite
def points(draw: st.DrawFn, name: str) -> ControlPoint:
    seen = tuple(draw(st.lists(measures(), max_size=3)))
    return ControlPoint(
        id=name, type=draw(st.sampled_from(PointType)), measures=seen, chooser_name=draw(TEXTS), date_time=draw(TEXTS),
        edit_lock=draw(FLAGS), ignore=draw(FLAGS), jigsaw_rejected=draw(FLAGS),
        reference=draw(st.none() | st.integers(0, len(seen) - 1)) if seen else None,
        apriori_source=draw(st.sampled_from(AprioriSource)), apriori_source_file=draw(TEXTS),
        apriori_radius_source=draw(st.sampled_from(AprioriSource)), apriori_radius_source_file=draw(TEXTS),
        latitude_constrained=draw(FLAGS), longitude_constrained=draw(FLAGS), radius_constrained=draw(FLAGS),
        apriori=draw(TRIPLES), apriori_covariance=draw(COVARIANCES), adjusted=draw(TRIPLES),
        adjusted_covariance=draw(COVARIANCES),
    )  # fmt: skip


@st.composite
def networks(draw: st.DrawFn) -> ControlNetwork:
    ids = draw(st.lists(NAMES, min_size=1, max_size=3, unique=True))
    return ControlNetwork(
        network_id=draw(TEXTS), target_name=draw(TEXTS), points=tuple(draw(points(name)) for name in ids),
        user_name=draw(TEXTS), created=draw(TEXTS), last_modified=draw(TEXTS), description=draw(TEXTS),
        target_radii=draw(st.just(()) | st.tuples(NUMBERS, NUMBERS, NUMBERS)),
    )  # fmt: skip


def contents(network: ControlNetwork) -> str:
    """All of a record but the file it comes from, with all digits and signs of zeros."""
    return repr(msgspec.structs.replace(network, source=""))


def grid(points: int, images: int) -> ControlNetwork:
    """A network of many points, each measured in all images, as automatic matching leaves them."""
    return ControlNetwork(
        network_id="grid", target_name="Mars", user_name="test", created="2026-11-22T08:00:00",
        last_modified="2026-11-22T08:00:00", description="many points",
        points=tuple(
            ControlPoint(
                id=f"point_{i:06d}", type=PointType.FREE, chooser_name="autoseed", date_time="2026-11-22T08:00:00",
                reference=0,
                measures=tuple(
                    ControlMeasure(
                        serial_number=f"MGS/{561812335 + j}:32/MOC-NA", type=MeasureType.REGISTERED_SUBPIXEL,
                        sample=1.0 + i % 2048 + 0.1 * j, line=2.0 + i / 3.0, chooser_name="pointreg",
                        date_time="2026-11-22T08:00:00", sample_sigma=0.1, line_sigma=0.2, log=((2, 0.9 + 1e-6 * i),),
                    )
                    for j in range(images)
                ),
            )
            for i in range(points)
        ),
    )  # fmt: skip


def assert_same(found: TiePoints, expected: TiePoints) -> None:
    """Tie points are equal to the last bit."""
    assert (found.ids, found.measure_image) == (expected.ids, expected.measure_image)
    for name in ("kinds", "places", "covariances", "measure_point", "measures", "measure_sigmas"):
        one, other = getattr(found, name), getattr(expected, name)
        assert one.shape == other.shape, name
        assert np.array(one).tobytes() == np.array(other).tobytes(), name


def varint(value: int) -> bytes:
    """A whole number as protobuf's wire format has it (negative ones as 64 bits)."""
    value &= (1 << 64) - 1
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def wire(*fields: tuple[int, int | float | bytes]) -> bytes:
    """A message of (number, value) by protobuf's wire format, without protobuf: an authority on what is written."""
    out = b""
    for number, value in fields:
        if isinstance(value, float):
            out += varint(number << 3 | 1) + struct.pack("<d", value)
        elif isinstance(value, int):
            out += varint(number << 3) + varint(value)
        else:
            out += varint(number << 3 | 2) + varint(len(value)) + value
    return out


def older(network: ControlNetwork, version: int) -> ControlNetwork:
    """What is left of a network in an older version: in 1 and 2 constrained points are those with a covariance."""
    points = list[ControlPoint]()
    for point in network.points:
        kind = PointType.FREE if point.type == PointType.CONSTRAINED else point.type
        if version < 3:
            point = msgspec.structs.replace(point, type=PointType.CONSTRAINED if point.apriori_covariance else kind)
        points.append(point)
    radii = network.target_radii if version == 5 else ()
    return msgspec.structs.replace(network, points=tuple(points), target_radii=radii)


_OLD_WORDS = {
    "AdjustedX": "X", "AdjustedY": "Y", "AdjustedZ": "Z", "AdjustedCovarianceMatrix": "ApostCovarianceMatrix",
    "AprioriXYZSource": "AprioriLatLonSource", "AprioriXYZSourceFile": "AprioriLatLonSourceFile",
    "LineResidual": "ErrorLine", "SampleResidual": "ErrorSample",
}  # fmt: skip


def pvl_text(network: ControlNetwork, version: int) -> str:
    """Text of a version from 1 to 5, which has what `older` leaves."""
    lines = list[str]()
    for line in network_text(older(network, version)).splitlines():
        key, equals, value = line.partition("=")
        if version < 4 and key.strip() == "PointType":
            value = {" Free": " Tie", " Fixed": " Ground", " Constrained": " Constrained"}[value]
            if version < 3 and value == " Constrained":
                value = " Tie"
        if version == 1:
            key = key.replace(key.strip(), _OLD_WORDS.get(key.strip(), key.strip()))
            if key.strip() in ("LatitudeConstrained", "LongitudeConstrained", "RadiusConstrained"):
                continue
        if key.strip() == "Version":
            value = f" {version}"
        if not (version == 1 and key.strip() == "Version"):
            lines.append(f"{key}{equals}{value}")
    return "\n".join(lines) + "\n"


def first_binary(network: ControlNetwork) -> bytes:
    """A binary network of version 1, by ControlNetFileProtoV0001.proto and ControlNetLogDataProtoV0001.proto."""
    texts = (network.network_id, network.target_name, network.created, network.last_modified, network.description,
             network.user_name)  # fmt: skip
    head = [(1, wire((2, b"2010/11/18"))), *((number, text.encode()) for number, text in enumerate(texts, start=2))]
    points = [(8, _first_point(point)) for point in network.points]
    logs = [
        (1, wire(*((2, wire(*((2, wire((2, kind), (3, value))) for kind, value in measure.log)))
                   for measure in point.measures)))
        for point in network.points
    ]  # fmt: skip
    core, log = wire(*head, *points), wire(*logs)
    label = f"""\
Object = ProtoBuffer
  Object = Core
    StartByte = 65536
    Bytes     = {len(core)}
  End_Object

  Object = LogData
    StartByte = {65536 + len(core)}
    Bytes     = {len(log)}
  End_Object

  Group = ControlNetworkInfo
    NetworkId = small
  End_Group
End_Object
End
"""
    return label.encode().ljust(65536, b"\0") + core + log


def _first_point(point: ControlPoint) -> bytes:
    flags = (point.edit_lock, point.ignore, point.jigsaw_rejected)
    fields: list[tuple[int, int | float | bytes]] = [
        (1, point.id.encode()), (2, int(point.type == PointType.FIXED)), (3, point.chooser_name.encode()),
        (4, point.date_time.encode()), *zip((5, 6, 7), flags, strict=True), (8, int(point.apriori_source)),
        (9, point.apriori_source_file.encode()), (10, int(point.apriori_radius_source)),
        (11, point.apriori_radius_source_file.encode()),
    ]  # fmt: skip
    for number, place, covariance in ((12, point.apriori, point.apriori_covariance),
                                      (16, point.adjusted, point.adjusted_covariance)):  # fmt: skip
        fields += [(number + axis, value) for axis, value in enumerate(place or ())]
        if covariance:
            fields.append((number + 3, struct.pack("<6d", *covariance)))
    fields += [(20, _first_measure(measure)) for measure in point.measures]
    if point.reference is not None:
        fields.append((21, point.reference))
    constrained = (point.latitude_constrained, point.longitude_constrained, point.radius_constrained)
    return wire(*fields, *zip((22, 23, 24), constrained, strict=True))


def _first_measure(measure: ControlMeasure) -> bytes:
    numbers = ((9, measure.diameter), (10, measure.apriori_sample), (11, measure.apriori_line),
               (12, measure.sample_sigma), (13, measure.line_sigma))  # fmt: skip
    place = ((1, measure.sample), (2, measure.line), (3, measure.sample_residual), (4, measure.line_residual))
    flags = (measure.edit_lock, measure.ignore, measure.jigsaw_rejected)
    return wire(
        (1, measure.serial_number.encode()), (2, int(measure.type) + 1), (3, measure.chooser_name.encode()),
        (4, measure.date_time.encode()), *zip((5, 6, 7), flags, strict=True),
        (8, wire(*((number, value) for number, value in place if value is not None))),
        *((number, value) for number, value in numbers if value is not None),
    )  # fmt: skip


def labelled(version: int | str, header: bytes, points: bytes) -> bytes:
    """A binary network: its label as ISIS lays it out, then header and points."""
    label = f"""\
Object = ProtoBuffer
  Object = Core
    HeaderStartByte = 65536
    HeaderBytes     = {len(header)}
    PointsStartByte = {65536 + len(header)}
    PointsBytes     = {len(points)}
  End_Object

  # This group is for informational purposes only
  Group = ControlNetworkInfo
    NetworkId        = small
    TargetName       = Mars
    UserName         = Null
    Created          = 2026-11-22T08:00:00
    LastModified     = 2026-11-22T09:00:00
    Description      = "two points"
    NumberOfPoints   = 2
    NumberOfMeasures = 3
    Version          = {version}
  End_Group
End_Object
End
"""
    return label.encode().ljust(65536, b"\0") + header + points


IMAGES = ("M0100115", "E02-01461", "R0301000", "S1900001")
SINGLE = st.floats(0.0, 12_000.0, width=32)
SIGMAS = st.floats(0.015625, 10.0, width=32)


@st.composite
def free_networks(draw: st.DrawFn, isis_places: st.SearchStrategy[float], least: int = 2) -> ControlNetwork:
    """Free points in two or more of four images, no two at one place of an image, one sigma for line and sample."""
    count = draw(st.integers(1, 6))
    taken: set[tuple[str, float, float]] = set()
    points = []
    for k in range(1, count + 1):
        measures = []
        for image in sorted(draw(st.sets(st.sampled_from(IMAGES), min_size=least)), key=IMAGES.index):
            line, sample, sigma = draw(isis_places), draw(isis_places), draw(SIGMAS)
            while (image, line, sample) in taken:
                line += 1.0
            taken.add((image, line, sample))
            measures.append(
                ControlMeasure(image, MeasureType.CANDIDATE, sample, line, sample_sigma=sigma, line_sigma=sigma)
            )
        points.append(ControlPoint(f"match{k}", PointType.FREE, tuple(measures)))
    return ControlNetwork("", "", tuple(points))


def as_set(network: ControlNetwork) -> set[frozenset[tuple[str, float | None, float | None, float | None]]]:
    """Points without their names and order: what is measured, and how well."""
    return {
        frozenset((one.serial_number, one.line, one.sample, one.line_sigma) for one in point.measures)
        for point in network.points
    }
