"""ISIS's binary control networks: nothing is lost, the bytes are ISIS's, and what is damaged is said."""

import random
import struct
import time
import tracemalloc
from pathlib import Path

import pytest
from hypothesis import given, settings
from isis_networks import contents, grid, labelled, networks, wire

from mgsgraph.errors import InputError
from mgsgraph.files.networks.binary import binary_network, parse_binary_network, read_network, write_binary_network
from mgsgraph.files.networks.record import (
    AprioriSource,
    ControlMeasure,
    ControlNetwork,
    ControlPoint,
    MeasureType,
    PointType,
)
from mgsgraph.files.networks.tie_points import tie_points

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


def old_network(*messages: bytes, sizes: bytes | None = None) -> bytes:
    sizes = bytes(map(len, messages)) if sizes is None else sizes  # as varints, where they are below 128
    return labelled(2, HEADER + wire((7, sizes)), b"".join(messages))


WHOLE = network(*POINTS)


def refused(data: bytes) -> str:
    with pytest.raises(InputError) as caught:
        parse_binary_network(data, "a.net")
    message = str(caught.value)
    assert message.startswith("a.net")
    assert "\n" not in message
    return message


# ---- what is written comes back, and is ISIS's ---------------------------------------------------------------------


@settings(deadline=None)
@given(drawn=networks())
def test_a_network_survives(drawn: ControlNetwork) -> None:
    assert contents(parse_binary_network(binary_network(drawn), "")) == contents(drawn)


def test_the_bytes_are_those_of_isis() -> None:
    assert binary_network(SMALL) == WHOLE


def test_version_five_is_read() -> None:
    assert contents(parse_binary_network(WHOLE, "a.net")) == contents(SMALL)


def test_version_two_is_read() -> None:
    short = [wire((1, b"p%d" % kind), (2, kind), (25, MEASURES[0])) for kind in range(5)]

    points = parse_binary_network(old_network(*short), "a.net").points

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


# ---- what is wrong is said -----------------------------------------------------------------------------------------

NAN, INFINITE = float("nan"), float("inf")


def point(*fields: tuple[int, int | float | bytes]) -> bytes:
    """A network of a free point p with these fields."""
    return network(wire((1, b"p"), (2, 2), *fields))


def measure(*fields: tuple[int, int | float | bytes]) -> bytes:
    """A network of a point p with a measure of these fields."""
    return point((25, wire(*fields)))


FAULTS = {
    "no id": (network(wire((2, 2))), f"a.net, byte {65540 + len(HEADER)}, point 1: PointId: none"),
    "line break in the id": (network(wire((1, b"p\nA"))), "point 1 (p A): PointType: none"),
    "no type": (network(POINTS[0], wire((1, b"p"))), ", point 2 (p): PointType: none"),
    "unknown type": (network(wire((1, b"p"), (2, 9))), "point 1 (p): PointType: 9; expected one of 0, 1, 2, 3, 4"),
    "unknown source": (point((9, 8)), "AprioriXYZSource: 8"),
    "id twice": (network(POINTS[1], POINTS[0], POINTS[1]), "point 3 (second): the id twice, first at point 1"),
    "reference": (point((8, 0)), "point 1 (p): Reference: measure 0 (counted from 0) as reference"),
    "NaN": (measure((1, b"A"), (2, 0), (4, NAN)), "point 1 (p): measure 1: Line: nan"),
    "infinite": (measure((1, b"A"), (2, 0), (3, INFINITE)), "Sample: inf; expected a"),
    "minus infinite": (point((16, -INFINITE), (17, 0.0), (18, 0.0)), "AprioriX: -inf"),
    "a place in part": (point((16, 1.0)), "point 1 (p): Apriori: a place in part"),
    "covariance": (point((19, doubles(1.0))), "AprioriCovarianceMatrix: 1 numbers"),
    "infinite variance": (point((23, doubles(*[NAN] * 6))), "AdjustedCovarianceMatrix: nan"),
    "wrong UTF-8": (network(wire((1, b"p\xff"), (2, 2))), r"point 1 (p�): text: b'p\xff'; expected UTF-8"),
    "wrong UTF-8 in the head": (network(*POINTS, header=wire((1, b"\xff"))), r"a.net, header: text: b'\xff'"),
    "no image": (measure((2, 0)), "measure 1: SerialNumber: none"),
    "measure type": (measure((1, b"A"), (2, 4)), "MeasureType: 4"),
    "no message": (network(b"\xff\xff"), "point 1: 2 bytes that are no such message"),
    "no header": (network(*POINTS, header=b"\xff\xff"), "header: 2 bytes that are no such message"),
    "radii": (network(*POINTS, header=HEADER + wire((10, 1.0))), "header: TargetRadii: 1 numbers"),
    "no points": (network(), "no control point"),
    "size too large": (WHOLE.replace(struct.pack("<I", len(POINTS[0])), b"\xff" * 4), "point 1: its end at byte"),
    "old size too large": (old_network(POINTS[1], sizes=b"\xff\xff\xff\xff\x07"), "point 1: its end at byte"),
    "old size below zero": (old_network(POINTS[1], sizes=b"\xff" * 9 + b"\x01"), "point 1: -1 bytes"),
    "header too long": (WHOLE.replace(b"HeaderBytes     = ", b"HeaderBytes     = 9999"), "binary network"),
    "header beyond": (
        WHOLE.replace(b"HeaderStartByte = 65536", b"HeaderStartByte = 90000").replace(
            b"%d" % (65536 + len(HEADER)), b"%d" % (90000 + len(HEADER))),
        "expected a header up to byte 90",
    ),
    "points beyond": (WHOLE.replace(b"PointsBytes     = ", b"PointsBytes     =9"), "expected points up to byte"),
    "odd byte": (WHOLE.replace(b"= 65536", b"= 6.5e4"), "line 3, HeaderStartByte: '6.5e4'; expected a number of bytes"),
    "version 3": (labelled(3, HEADER, b""), "line 19, Version: version 3; expected 5"),
    "version 6": (labelled(6, HEADER, b""), "version 6; expected 5"),
    "version ten": (labelled("ten", HEADER, b""), "version ten; expected 5"),
    "no version": (labelled("Null", HEADER, b""), "no StartByte"),
    "no Core": (WHOLE.replace(b"= Core", b"= Kern"), "no Core; expected"),
    "no Info": (WHOLE.replace(b"= ControlNetworkInfo", b"= MatchNetworkInfo__"), "line 1: no ControlNetworkInfo"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_found_where_it_is(fault: str) -> None:
    data, said = FAULTS[fault]

    assert said in refused(data)


def test_any_prefix_is_refused(tmp_path: Path) -> None:
    first, second = map(len, POINTS)
    start = 65536 + len(HEADER)
    boundaries = [65536, start, start + 4, start + 4 + first, start + 8 + first, start + 8 + first + second]
    assert boundaries[-1] == len(WHOLE)
    lengths = {boundary + step for boundary in boundaries for step in (-1, 0, 1)} | set(range(0, 700, 7))
    path = tmp_path / "cut.net"
    for length in sorted(lengths - {len(WHOLE), len(WHOLE) + 1}):
        path.write_bytes(WHOLE[:length])
        with pytest.raises(InputError) as caught:
            read_network(path)
        assert str(caught.value).startswith(str(path))


def test_damaged_files_are_refused_or_networks(tmp_path: Path) -> None:
    """Some hundreds here; scripts/fuzz.py does thousands."""
    rng = random.Random(8)
    path = tmp_path / "damaged.net"
    refusals = 0
    tracemalloc.start()
    for _ in range(400):
        data = bytearray(WHOLE)
        for _ in range(rng.randint(1, 4)):
            place = rng.choice((rng.randrange(600), rng.randrange(65536, len(WHOLE) - 8)))
            change = rng.choice((bytes([rng.randrange(256)]), b"", rng.randbytes(3), b"\xff\xff\xff\x7f", b"9" * 9))
            data[place : place + rng.randint(0, 4)] = change
        path.write_bytes(data)
        try:
            binary_network(read_network(path))
        except InputError:
            refusals += 1
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()

    assert refusals > 100
    assert peak < 20e6


def test_a_folder_an_empty_file_and_none(tmp_path: Path) -> None:
    (tmp_path / "empty.net").write_bytes(b"")
    for name, said in (("", "a folder"), ("empty.net", "no control point"), ("none.net", "no such file")):
        with pytest.raises(InputError, match=said):
            read_network(tmp_path / name)


@pytest.mark.parametrize("data", [b"\xff\xfe\0", b"\0" * 70000, b"P" * 70000, bytes(range(256)) * 300])
def test_what_is_no_network_is_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "no.net").write_bytes(data)
    with pytest.raises(InputError, match=r"no\.net"):
        read_network(tmp_path / "no.net")


# ---- what can't be written -----------------------------------------------------------------------------------------


HALF = ControlPoint(id="p\ud800", type=PointType.FREE)


def test_nothing_half_written(tmp_path: Path) -> None:
    path = tmp_path / "a.net"
    path.write_bytes(b"as it was")
    wrong = ControlNetwork(
        network_id="n",
        target_name="Mars",
        points=(*SMALL.points, ControlPoint(id="p", type=PointType.FREE, adjusted=(0.0, NAN, 0.0))),
        source="here",
    )

    with pytest.raises(InputError, match=r"here, point 3 \(p\): AdjustedY: nan"):
        write_binary_network(wrong, path)
    with pytest.raises(InputError, match="no control point"):
        write_binary_network(ControlNetwork(network_id="n", target_name="Mars", points=()), path)
    with pytest.raises(InputError, match=r"a\.net/b\.net: can't be written"):
        write_binary_network(SMALL, path / "b.net")
    with pytest.raises(InputError, match=r"point 1 \(p.*\): text: "):
        write_binary_network(ControlNetwork(network_id="n", target_name="", points=(HALF,)), path)
    assert path.read_bytes() == b"as it was"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.net"]
