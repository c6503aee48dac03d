"""ISIS control networks of every version in both forms: all that a version holds comes back, as ISIS takes it."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from isis_networks import contents, networks, older, pvl_text

from mgsgraph.errors import InputError
from mgsgraph.files.networks.binary import binary_network, parse_binary_network, read_network
from mgsgraph.files.networks.pvl import parse_pvl_network
from mgsgraph.files.networks.record import ControlNetwork
from mgsgraph.files.pvl import Document


def parsed(text: str) -> ControlNetwork:
    return parse_pvl_network(Document("a.pvl", text))


@settings(deadline=None, max_examples=40)
@given(drawn=networks())
def test_versions_two_to_five_in_text(drawn: ControlNetwork) -> None:
    for version in (2, 3, 4, 5):
        assert contents(parsed(pvl_text(drawn, version))) == contents(older(drawn, version)), version


@settings(deadline=None, max_examples=20)
@given(drawn=networks())
def test_a_label_may_have_other_line_ends(drawn: ControlNetwork) -> None:
    data = binary_network(drawn)
    label, rest = data[:65536].rstrip(b"\0"), data[65536:]
    for ends in (b"\r\n", b"\r"):
        other = label.replace(b"\n", ends).ljust(65536, b"\0") + rest
        assert contents(parse_binary_network(other, "")) == contents(parse_binary_network(data, ""))


@pytest.mark.parametrize("text", [
    "Object = ControlNetwork\n  Object = ControlPoint\n    PointId = a\n  End_Object\nEnd_Object\nEnd\n",
    "Object = ProtoBuffer\n  Object = Core\n    StartByte = 65536\n  End_Object\n  Group = ControlNetworkInfo\n"
    "  End_Group\nEnd_Object\nEnd\n",
])  # fmt: skip
def test_the_first_version_is_refused_by_its_name(tmp_path: Path, text: str) -> None:
    (tmp_path / "old.net").write_text(text)
    with pytest.raises(InputError, match=r"version 1; expected .*let ISIS write it anew"):
        read_network(tmp_path / "old.net")
