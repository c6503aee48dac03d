"""Tie points of a binary network: the same as of its whole record, which protobuf reads, and errors that say where."""

import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from isis_networks import assert_same, grid, labelled, networks, wire
from msgspec.structs import replace

from mgsgraph.errors import InputError
from mgsgraph.files.networks.binary import binary_network, binary_tie_points, parse_binary_network, read_control_network
from mgsgraph.files.networks.record import ControlNetwork, PointType, with_names
from mgsgraph.files.networks.tie_points import TiePoints, tie_points

GRID = binary_network(grid(4, 3))
LABEL = 65_536
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


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """A network with bits flipped, bytes written over, cut out or doubled, or an end cut off, behind its label."""
    content, at = bytearray(data), int(rng.integers(LABEL, len(data)))
    kind, size = rng.integers(6), int(rng.integers(1, 12))
    if kind == 0:
        content[at] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        content[at : at + size] = rng.bytes(size)
    elif kind == 2:
        del content[at : at + size]
    elif kind == 3:
        content[at:at] = content[at : at + size]
    elif kind == 4:
        del content[at:]
    else:
        content[at] = int(rng.integers(256))
    return bytes(content)


@settings(deadline=None, max_examples=60)
@given(networks())
def test_any_network_is_as_its_record(network: ControlNetwork) -> None:
    as_the_record(binary_network(network))


def test_a_network_as_isis_writes_it_is_read() -> None:
    assert as_the_record(GRID)


def test_mutated_networks_are_as_their_records() -> None:
    rng = np.random.default_rng(25)
    decoded = sum(as_the_record(mutated(GRID, rng)) for _ in range(400))
    assert 0 < decoded < 400


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


@pytest.mark.parametrize("images", [30, 5100])
def test_many_images_need_a_larger_table(images: int) -> None:
    data = binary_network(grid(1, images))
    assert as_the_record(data)
    found = binary_tie_points(data, "x.net")
    assert len(found.measure_image.used) == images


def test_a_body_without_a_proper_name_is_refused() -> None:
    with pytest.raises(InputError, match="TargetName"):
        binary_tie_points(binary_network(replace(grid(2, 3), target_name="a\tb")), "x.net")


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


MEASURES = grid(2, 3).points[1].measures


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (with_second().replace(b"point_000001", b"point_000000"), "the id twice, first at point 1"),
        (with_second(type=PointType.FIXED, apriori=None), "without an a-priori"),
        (with_second(apriori=(1e13, 0.0, 0.0)), "one on the body"),
        (with_second(measures=(replace(MEASURES[0], line=None), *MEASURES[1:])), r"image .*: no Line"),
        (with_second(measures=(replace(MEASURES[0], line_sigma=-1.0), *MEASURES[1:])), "a positive sigma"),
    ],
)
def test_what_no_adjustment_can_take_is_said_with_byte_and_id(data: bytes, said: str) -> None:
    with pytest.raises(InputError, match=rf"x\.net, byte \d+, point 2 \(.+\).*{said}"):
        binary_tie_points(data, "x.net")


def test_an_image_twice_in_a_point_is_refused() -> None:
    with pytest.raises(InputError, match=r"x\.net, byte \d+, point .*a second measure in this image"):
        binary_tie_points(with_second(measures=(*MEASURES, MEASURES[0])), "x.net")


TEXT_WITH_ACCENTS = {"chooser_name": "José Núñez", "date_time": "2026‑11‑24", "apriori_source_file": "мола.cub"}


def with_accents() -> ControlNetwork:
    """Texts of points and measures, an id and an image's name in UTF-8."""
    points = list(grid(4, 3).points)
    named = replace(points[2].measures[1], chooser_name="Jürgen 🛰", date_time="昨日", serial_number="MGS/é")
    points[2] = replace(points[2], id="Krater Ø", measures=(points[2].measures[0], named), **TEXT_WITH_ACCENTS)
    return replace(grid(4, 3), points=tuple(points))


def test_texts_and_names_in_utf8_are_decoded() -> None:
    data = binary_network(with_accents())
    assert as_the_record(data)
    found = binary_tie_points(data, "x.net")
    assert found.ids[2] == "Krater Ø"
    assert "MGS/é" in found.measure_image


@pytest.mark.parametrize("name", ["a\u2028b", "a\u0085", "a\x7f", "a\tb", "\ufeff"])
def test_names_that_cannot_be_shown_are_refused(name: str) -> None:
    for data in (with_second(id=name), with_second(measures=(replace(MEASURES[0], serial_number=name),))):
        with pytest.raises(InputError, match=r"x\.net, byte \d+, point 2 .*control characters"):
            binary_tie_points(data, "x.net")


def test_mutated_networks_with_accents_are_as_their_records() -> None:
    rng, data = np.random.default_rng(26), binary_network(with_accents())
    decoded = sum(as_the_record(mutated(data, rng)) for _ in range(400))
    assert 0 < decoded < 400
