"""ISIS's binary control networks: nothing is lost, the bytes are ISIS's, tie points are those of the whole record."""

import re
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from control_networks import assert_same, contents, grid, labelled, networks, wire
from hypothesis import given, settings
from msgspec.structs import replace
from outside import refuses

from mgsgraph.errors import InputError
from mgsgraph.files.networks.binary import (
    binary_network,
    binary_tie_points,
    parse_binary_network,
    read_control_network,
    read_network,
    write_binary_network,
)
from mgsgraph.files.networks.record import (
    AprioriSource,
    ControlMeasure,
    ControlNetwork,
    ControlPoint,
    MeasureType,
    PointType,
    with_names,
)
from mgsgraph.files.networks.tie_points import TiePoints, tie_points

# --- the whole record


SMALL = ControlNetwork(
    network_id="small",
    target_name="Mars",
    created="2026-11-22T08:00:00",
    last_modified="2026-11-22T09:00:00",
    description="two points",
    points=(
        ControlPoint(
            id="first",
            type=PointType.CONSTRAINED,
            chooser_name="qnet",
            reference=1,
            apriori_source=AprioriSource.BASEMAP,
            apriori_radius_source=AprioriSource.DEM,
            latitude_constrained=True,
            apriori=(1.5, -2.5, 3.5),
            apriori_covariance=(100.0, 1.0, 2.0, 200.0, 3.0, 300.0),
            measures=(
                ControlMeasure(serial_number="A", type=MeasureType.MANUAL, sample=101.5, line=2002.25),
                ControlMeasure(
                    serial_number="B",
                    type=MeasureType.REGISTERED_SUBPIXEL,
                    sample=1.0,
                    line=1.0,
                    sample_residual=0.25,
                    line_residual=-0.5,
                    date_time="2026",
                    ignore=True,
                    jigsaw_rejected=True,
                    diameter=15.0,
                    apriori_sample=2.0,
                    apriori_line=3.0,
                    sample_sigma=0.01,
                    line_sigma=0.02,
                    log=((3, -1.5), (2, 0.75)),
                ),
            ),
        ),
        ControlPoint(
            id="second",
            type=PointType.FREE,
            edit_lock=True,
            adjusted=(1.0, 2.0, 3.0),
            adjusted_covariance=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0),
            measures=(ControlMeasure(serial_number="A", type=MeasureType.CANDIDATE, edit_lock=True),),
        ),
    ),
)


def doubles(*values: float) -> bytes:
    return struct.pack(f"<{len(values)}d", *values)


HEADER = wire((1, b"small"), (2, b"Mars"), (3, b"2026-11-22T08:00:00"), (4, b"2026-11-22T09:00:00"), (5, b"two points"),
              (6, b""))  # fmt: skip
MEASURES = (
    wire((1, b"A"), (2, 1), (3, 101.5), (4, 2002.25)),
    wire((1, b"B"), (2, 3), (3, 1.0), (4, 1.0), (5, 0.25), (6, -0.5), (8, b"2026"), (10, 1), (11, 1), (12, 15.0),
         (13, 2.0), (14, 3.0), (15, 0.01), (16, 0.02), (17, wire((1, 3), (2, -1.5))), (17, wire((1, 2), (2, 0.75)))),
    wire((1, b"A"), (2, 0), (9, 1)),
)  # fmt: skip
POINTS = (
    wire((1, b"first"), (2, 3), (3, b"qnet"), (8, 1), (9, 6), (11, 5), (13, 1), (16, 1.5), (17, -2.5), (18, 3.5),
         (19, doubles(100.0, 1.0, 2.0, 200.0, 3.0, 300.0)), (25, MEASURES[0]), (25, MEASURES[1])),
    wire((1, b"second"), (2, 2), (5, 1), (9, 0), (11, 0), (20, 1.0), (21, 2.0), (22, 3.0),
         (23, doubles(1.0, 0.0, 0.0, 1.0, 0.0, 1.0)), (25, MEASURES[2])),
)  # fmt: skip
"""By the numbers in ISIS's .proto files, encoded without protobuf."""


def behind_sizes(*messages: bytes) -> bytes:
    return b"".join(struct.pack("<I", len(message)) + message for message in messages)


def network(*messages: bytes, header: bytes = HEADER) -> bytes:
    return labelled(5, header, behind_sizes(*messages))


WHOLE = network(*POINTS)


def of_point(*fields: tuple[int, int | float | bytes]) -> bytes:
    """A network of a free point p with these fields."""
    return network(wire((1, b"p"), (2, 2), *fields))


@settings(deadline=None)
@given(drawn=networks())
def test_a_network_survives(drawn: ControlNetwork) -> None:
    assert contents(parse_binary_network(binary_network(drawn), "")) == contents(drawn)


def test_the_bytes_are_those_of_isis() -> None:
    assert binary_network(SMALL) == WHOLE


def test_version_two_is_read() -> None:
    """Sizes stand in the header, as varints."""
    short = [wire((1, b"p%d" % kind), (2, kind), (25, MEASURES[0])) for kind in range(5)]
    data = labelled(2, HEADER + wire((7, bytes(map(len, short)))), b"".join(short))

    points = parse_binary_network(data, "a.net").points

    kinds = [PointType.FREE, PointType.FIXED, PointType.FREE, PointType.CONSTRAINED, PointType.FIXED]
    assert [point.type for point in points] == kinds  # 0 and 1 are Tie and Ground of old
    assert [point.id for point in points] == ["p0", "p1", "p2", "p3", "p4"]
    assert all(point.measures == SMALL.points[0].measures[:1] for point in points)


def test_what_isis_never_set_is_none() -> None:
    null = struct.unpack("<d", struct.pack("<Q", 0xFFEFFFFFFFFFFFFB))[0]  # SpecialPixel.h, NULL8
    log = ((17, b""), (17, wire((1, 2))), (17, wire((1, 2), (2, null))), (17, wire((1, 2), (2, 0.5))))
    measure = wire((1, b"A"), (2, 1), (5, null), (12, null), *log)

    (point,) = parse_binary_network(network(wire((1, b"p"), (2, 2), (25, measure))), "a.net").points

    assert point.measures[0] == ControlMeasure(serial_number="A", type=MeasureType.MANUAL, log=((2, 0.5),))


def test_radii_and_unknown_fields(tmp_path: Path) -> None:
    header = HEADER + wire((7, 2), (8, b"A"), (10, 3396190.0), (10, 3396190.0), (10, 3376200.0))
    read = parse_binary_network(network(*POINTS, header=header), "a.net")

    assert read.target_radii == (3396190.0, 3396190.0, 3376200.0)
    write_binary_network(read, tmp_path / "new" / "b.net")
    assert contents(read_network(tmp_path / "new" / "b.net")) == contents(read)


def test_a_long_label_moves_the_messages() -> None:
    long = ControlNetwork(network_id="n", target_name="Mars", points=SMALL.points, description='a "b"\n\0' * 20000)

    assert contents(parse_binary_network(binary_network(long), "")) == contents(long)
    assert b"HeaderStartByte = 131072" in binary_network(long)[:200]


def test_five_thousand_points_in_two_seconds(tmp_path: Path) -> None:
    many = grid(5_000, 4)
    start = time.process_time()
    write_binary_network(many, tmp_path / "many.net")
    back = read_network(tmp_path / "many.net")
    elapsed = time.process_time() - start

    assert elapsed < 2.0  # 0.2 s on the machine it was written on
    assert back.points == many.points
    assert len(tie_points(back).measure_image) == 20_000


FAULTS = {
    "no id": (network(wire((2, 2))), f"a.net, byte {65540 + len(HEADER)}, point 1: PointId: none"),
    "unknown type": (network(wire((1, b"p"), (2, 9))), "point 1 (p): PointType: 9; expected one of 0, 1, 2, 3, 4"),
    "id twice": (network(POINTS[1], POINTS[0], POINTS[1]), "point 3 (second): the id twice, first at point 1"),
    "reference": (of_point((8, 0)), "point 1 (p): Reference: measure 0 (counted from 0) as reference"),
    "NaN": (of_point((25, wire((1, b"A"), (2, 0), (4, float("nan"))))), "point 1 (p): measure 1: Line: nan"),
    "a place in part": (of_point((16, 1.0)), "point 1 (p): Apriori: a place in part"),
    "covariance": (of_point((19, doubles(1.0))), "AprioriCovarianceMatrix: 1 numbers"),
    "no message": (network(b"\xff\xff"), "point 1: 2 bytes that are no such message"),
    "no points": (network(), "no control point"),
    "size too large": (WHOLE.replace(struct.pack("<I", len(POINTS[0])), b"\xff" * 4), "point 1: its end at byte"),
    "version 6": (labelled(6, HEADER, b""), "version 6; expected 5"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_found_where_it_is(fault: str) -> None:
    data, said = FAULTS[fault]
    with pytest.raises(InputError) as caught:
        parse_binary_network(data, "a.net")
    assert said in str(caught.value)


def test_any_prefix_is_refused() -> None:
    for length in {*range(0, 700, 7), *range(65536, len(WHOLE))}:
        refuses(r"a\.net", parse_binary_network, WHOLE[:length], "a.net")


def test_nothing_half_written(tmp_path: Path) -> None:
    path = tmp_path / "a.net"
    path.write_bytes(b"as it was")
    nowhere = ControlPoint(id="p", type=PointType.FREE, adjusted=(0.0, float("nan"), 0.0))
    for point, said in ((nowhere, r"here, point 3 \(p\): AdjustedY: nan"),
                        (replace(nowhere, id="p\ud800", adjusted=None), r"point 3 \(p.*\): text: ")):  # fmt: skip
        refuses(said, write_binary_network, replace(SMALL, points=(*SMALL.points, point), source="here"), path)
    assert path.read_bytes() == b"as it was"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.net"]


# --- tie points by columns, without it


UNUSED = re.compile(r"Reference: measure|text: |Source: |Residual: |Diameter: |AprioriSample: |AprioriLine: |log data: "
                    r"|Adjusted|no such message")  # fmt: skip
"""What may be wrong with fields that an adjustment doesn't take."""


def outcome(read: Callable[[], TiePoints]) -> TiePoints | InputError:
    """What a file's content is, or the error where it is refused."""
    try:
        return read()
    except InputError as error:
        return error


def as_the_record(data: bytes) -> bool:
    """Whether tie points are read: as those of the whole record, and refused where these are, but for fields
    that no adjustment takes.
    """
    found = outcome(lambda: binary_tie_points(data, "x.net"))
    expected = outcome(lambda: tie_points(with_names(parse_binary_network(data, "x.net"))))
    if isinstance(found, InputError):
        odd = "fields of other kinds" in str(found)  # which protobuf leaves out
        assert odd or isinstance(expected, InputError), found
        return False
    if isinstance(expected, InputError):
        assert UNUSED.search(str(expected)), expected
        return True
    assert_same(found, expected)
    return True


@settings(deadline=None, max_examples=60)
@given(networks())
def test_any_network_is_as_its_record(network: ControlNetwork) -> None:
    as_the_record(binary_network(network))


def test_ignored_points_and_measures_are_left_out(tmp_path: Path) -> None:
    points = list(grid(5, 3).points)
    points[1] = replace(points[1], ignore=True)
    points[3] = replace(points[3], measures=(replace(points[3].measures[0], ignore=True, line=None),
                                             *points[3].measures[1:]))  # fmt: skip
    data = binary_network(replace(grid(5, 3), points=tuple(points)))
    assert as_the_record(data)
    (tmp_path / "a.net").write_bytes(data)
    found = read_control_network(tmp_path / "a.net")
    assert len(found.ids) == 4
    assert np.bincount(found.measure_point).tolist() == [3, 3, 2, 3]


def test_many_images_need_a_larger_table() -> None:
    data = binary_network(grid(1, 5100))
    assert as_the_record(data)
    assert len(binary_tie_points(data, "x.net").measure_image.used) == 5100


def test_measures_of_an_ignored_point_need_no_place() -> None:
    first, second = grid(2, 3).points
    unmeasured = tuple(replace(one, line=None, sample_sigma=-1.0) for one in second.measures)
    assert as_the_record(binary_network(replace(grid(2, 3), points=(first, replace(second, measures=unmeasured,
                                                                                   ignore=True)))))  # fmt: skip


def test_fields_that_isis_may_add_one_day_are_left_out() -> None:
    later = wire((1, b"A"), (2, 0), (3, 5.0), (4, 6.0), (17, wire((1, 2), (2, 0.5), (9, 1))), (30, b"new"))
    point = wire((1, b"p"), (2, 2), (25, later), (25, wire((1, b"B"), (2, 0), (3, 5.0), (4, 6.0))), (24, 1), (31, 2.5))
    assert as_the_record(labelled(5, wire((1, b"n")), struct.pack("<I", len(point)) + point))


def with_second(**changes: Any) -> bytes:
    first, second = grid(2, 3).points
    return binary_network(replace(grid(2, 3), points=(first, replace(second, **changes))))


SEEN = grid(2, 3).points[1].measures


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (with_second().replace(b"point_000001", b"point_000000"), "the id twice, first at point 1"),
        (with_second(type=PointType.FIXED, apriori=None), "without an a-priori"),
        (with_second(measures=(replace(SEEN[0], line=None), *SEEN[1:])), r"image .*: no Line"),
        (with_second(measures=(replace(SEEN[0], line_sigma=0.0), *SEEN[1:])), r"image .*, LineSigma: 0 px"),
        (with_second(measures=(*SEEN, SEEN[0])), "a second measure in this image"),
        (with_second(id="a\x1b[2Jb"), "an id with control characters"),
        (with_second(measures=(replace(SEEN[0], serial_number="a\u2028b"),)), "control characters"),
    ],
)
def test_what_no_adjustment_can_take_is_said_with_byte_and_id(data: bytes, said: str) -> None:
    refuses(rf"x\.net, byte \d+, point 2 .*{said}", binary_tie_points, data, "x.net")


def test_texts_and_names_in_utf8_are_decoded() -> None:
    named = replace(SEEN[1], chooser_name="Jürgen 🛰", date_time="昨日", serial_number="MGS/é")
    data = with_second(id="Krater Ø", measures=(SEEN[0], named), apriori_source_file="мола.cub")
    assert as_the_record(data)
    found = binary_tie_points(data, "x.net")
    assert found.ids[1] == "Krater Ø"
    assert "MGS/é" in found.measure_image
