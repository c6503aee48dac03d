"""Tie points decoded by compiled code, against protobuf's own reader: the same, or the same refusal."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isis_networks import assert_same, grid, networks
from msgspec.structs import replace

from mgsgraph.errors import InputError
from mgsgraph.files.networks.binary import binary_network, parse_binary_network
from mgsgraph.files.networks.binary_columns import binary_tie_points
from mgsgraph.files.networks.network_file import read_control_network
from mgsgraph.files.networks.record import ControlNetwork, with_names
from mgsgraph.files.networks.tie_points import tie_points
from mgsgraph.files.networks.utf8 import is_utf8
from mgsgraph.files.tie_points import TiePoints

GRID = binary_network(grid(4, 3))
LABEL = 65_536


def by_protobuf(data: bytes) -> TiePoints | str:
    """What the reference makes of a file's content; the error's text where it refuses it."""
    try:
        return tie_points(with_names(parse_binary_network(data, "x.net")))
    except InputError as error:
        return str(error)


def assert_as_the_reference(data: bytes) -> bool:
    """Whether compiled code read it: then it must be what the reference reads; what it leaves is the reference's."""
    try:
        found: TiePoints | str | None = binary_tie_points(data, "x.net")
    except InputError as error:
        found = str(error)
    if found is None:
        return False
    expected = by_protobuf(data)
    if isinstance(found, str):
        assert found == expected
        return False
    assert isinstance(expected, TiePoints), expected
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
def test_any_network_is_as_protobuf_has_it(network: ControlNetwork) -> None:
    assert_as_the_reference(binary_network(network))


def test_a_network_as_isis_writes_it_is_decoded() -> None:
    """Otherwise all of this would test nothing."""
    assert assert_as_the_reference(GRID)


def test_mutated_networks_are_as_protobuf_has_them() -> None:
    rng = np.random.default_rng(25)
    decoded = sum(assert_as_the_reference(mutated(GRID, rng)) for _ in range(400))
    assert 0 < decoded < 400


def test_ignored_points_and_measures_are_left_out(tmp_path: Path) -> None:
    points = list(grid(5, 3).points)
    points[1] = replace(points[1], ignore=True)
    points[3] = replace(points[3], measures=(replace(points[3].measures[0], ignore=True, line=None),
                                             *points[3].measures[1:]))  # fmt: skip
    data = binary_network(replace(grid(5, 3), points=tuple(points)))
    assert assert_as_the_reference(data)
    (tmp_path / "a.net").write_bytes(data)
    found = read_control_network(tmp_path / "a.net")
    assert len(found.ids) == 4
    assert np.bincount(found.measure_point).tolist() == [3, 3, 2, 3]


@pytest.mark.parametrize("images", [30, 4900])
def test_many_images_need_a_larger_table(images: int) -> None:
    data = binary_network(grid(1, images))
    assert assert_as_the_reference(data)
    found = binary_tie_points(data, "x.net")
    assert found is not None
    assert len(found.measure_image.used) == images


def test_a_body_without_a_proper_name_is_refused_after_its_points() -> None:
    """As protobuf's reader has it, whose error is that of the point."""
    head = replace(grid(2, 3), target_name="a\tb")
    assert "TargetName" in str(by_protobuf(binary_network(head)))
    assert binary_tie_points(binary_network(head), "x.net") is None


TEXT_WITH_ACCENTS = {"chooser_name": "José Núñez", "date_time": "2026‑11‑24", "apriori_source_file": "мола.cub"}


def with_accents() -> ControlNetwork:
    """Texts of points and measures, an id and an image's name in UTF-8."""
    points = list(grid(4, 3).points)
    named = replace(points[2].measures[1], chooser_name="Jürgen 🛰", date_time="昨日", serial_number="MGS/é")
    points[2] = replace(points[2], id="Krater Ø", measures=(points[2].measures[0], named), **TEXT_WITH_ACCENTS)
    return replace(grid(4, 3), points=tuple(points))


def test_texts_and_names_in_utf8_are_decoded() -> None:
    data = binary_network(with_accents())
    assert assert_as_the_reference(data)
    found = binary_tie_points(data, "x.net")
    assert found is not None
    assert found.ids[2] == "Krater Ø"
    assert "MGS/é" in found.measure_image


@pytest.mark.parametrize("name", ["a\u2028b", "a\u0085", "a\x7f", "a\tb", "\ufeff"])
def test_names_that_cannot_be_shown_are_for_the_reference(name: str) -> None:
    points = list(grid(2, 3).points)
    for odd in (replace(points[1], id=name), replace(points[1], measures=(replace(points[1].measures[0],
                serial_number=name),))):  # fmt: skip
        assert binary_tie_points(binary_network(replace(grid(2, 3), points=(points[0], odd))), "x.net") is None


def test_mutated_networks_with_accents_are_as_protobuf_has_them() -> None:
    rng, data = np.random.default_rng(26), binary_network(with_accents())
    decoded = sum(assert_as_the_reference(mutated(data, rng)) for _ in range(400))
    assert 0 < decoded < 400


def is_text(data: bytes) -> bool:
    """What Python's strict decoder says."""
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


def is_text_compiled(data: bytes) -> bool:
    """With other bytes around it, which must not matter."""
    return bool(is_utf8(np.frombuffer(b"\x80" + data + b"\x80", dtype=np.uint8), 1, 1 + len(data)))


@settings(deadline=None, max_examples=200)
@given(st.lists(st.binary(max_size=3) | st.text(max_size=3).map(str.encode), max_size=4).map(b"".join))
def test_utf8_is_what_python_decodes(data: bytes) -> None:
    assert is_text_compiled(data) == is_text(data)


def test_all_beginnings_of_a_character_are_as_python_decodes_them() -> None:
    """All pairs of bytes, alone and with one or two bytes behind that can follow: bounds of every kind of character."""
    for first in range(0x80, 0x100):
        for second in range(0x100):
            for rest in (b"", b"\x80", b"\xbf\xbf", b"\xc0\x80", b"\x80a"):
                data = bytes([first, second]) + rest
                assert is_text_compiled(data) == is_text(data), data
