"""Tie points scanned out of PVL text by compiled code: as the reader of whole networks has them, or left to it."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from isis_networks import assert_same, grid, networks, pvl_text
from msgspec.structs import replace

from mgsgraph.errors import InputError
from mgsgraph.files.networks.network_file import read_control_network, read_network
from mgsgraph.files.networks.pvl_columns import pvl_tie_points
from mgsgraph.files.networks.pvl_writing import network_text
from mgsgraph.files.networks.record import ControlNetwork, PointType
from mgsgraph.files.networks.tie_points import tie_points
from mgsgraph.files.tie_points import TiePoints

COVARIANCE = (100.0, 1.5, -2.0, 2500.0, 1e-3, 400.0)
TOKENS = (
    "Null", "True", '"', "'", "(", ")", ",", "<km>", "<meters>", "<pixels>", "< >", "=", "-", "+", "#", "/*", "*/",
    "\n",
    "End", "End_Group", "End_Object\n", "Group = ControlMeasure\n", "Object = ControlPoint\n", "Ignore = yes\n",
    "\t", " ",
    "1e400", ".5", "5.", "1e-400", "nan", "é", "\r\n", "Fixed", "tie", "<", ">", "0", "9", "e", ".", "/", "# word\n",
    "/* two\nlines */", "AprioriLatitude = 1\n", "Reference = True\n", "Line = 3\n", "\0", "{", "}",
    "Eccentricity = 1\n",
)  # fmt: skip


def rich() -> ControlNetwork:
    """A network with something of all that networks have, of points that an adjustment takes."""
    points = list(grid(6, 3).points)
    known = {"apriori": (3.39e6, 1.5, -2e3), "apriori_covariance": COVARIANCE, "type": PointType.CONSTRAINED}
    points[1] = replace(points[1], **known, latitude_constrained=True, chooser_name="A. Name", date_time="2010-08-27")
    points[2] = replace(points[2], apriori=(3.39e6, 0.0, 0.1), type=PointType.FIXED, edit_lock=True)
    points[3] = replace(points[3], apriori=None, adjusted=(1e6, 2e6, 3e6), adjusted_covariance=COVARIANCE)
    points[4] = replace(points[4], ignore=True)
    measures = points[5].measures
    odd = replace(measures[0], ignore=True, line=None, log=((2, 0.5),), diameter=2.0, sample_sigma=None)
    points[5] = replace(points[5], measures=(odd, *measures[1:]))
    return replace(grid(6, 3), points=tuple(points))


RICH = network_text(rich()).encode()


def assert_as_the_reader(data: bytes, folder: Path) -> bool:
    """Whether compiled code read it: then it must be what the reader of whole networks makes of it."""
    try:
        found: TiePoints | str | None = pvl_tie_points(data, str(folder / "x.pvl"))
    except InputError as error:
        found = str(error)
    if found is None:
        return False
    (folder / "x.pvl").write_bytes(data)
    try:
        network = read_network(folder / "x.pvl")
        expected: TiePoints | str = tie_points(network)
    except InputError as error:
        expected = str(error)
    if isinstance(found, str) or isinstance(expected, str):
        assert found == expected
        return False
    assert_same(found, expected)
    return True


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """A text with a token put in or over, a byte changed, lines cut out, doubled or exchanged, or its end cut off."""
    at, kind, size = int(rng.integers(len(data))), rng.integers(7), int(rng.integers(1, 12))
    token = TOKENS[rng.integers(len(TOKENS))].encode()
    if kind < 2:
        return data[:at] + token + data[at + size * (kind == 1) :]
    if kind == 2:
        return data[:at] + bytes([rng.integers(256)]) + data[at + 1 :]
    if kind == 3:
        return data[:at] + data[at + size :]
    if kind == 4:
        return data[:at]
    lines = data.split(b"\n")
    first, second = rng.integers(len(lines), size=2).tolist()
    if kind == 5:
        lines[first], lines[second] = lines[second], lines[first]
    else:
        lines.insert(first, lines[second])
    return b"\n".join(lines)


@settings(deadline=None, max_examples=60)
@given(networks())
def test_any_network_is_as_the_reader_has_it(tmp_path_factory: pytest.TempPathFactory, network: ControlNetwork) -> None:
    assert_as_the_reader(network_text(network).encode(), tmp_path_factory.getbasetemp())


def test_networks_as_isis_writes_them_are_scanned(tmp_path: Path) -> None:
    """Otherwise all of this would test nothing."""
    assert assert_as_the_reader(RICH, tmp_path)
    assert assert_as_the_reader(pvl_text(rich(), 3).encode(), tmp_path)
    assert assert_as_the_reader(pvl_text(rich(), 4).encode(), tmp_path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("\n", "\r\n"), ("\n", " \t\n"), ("Object = ControlPoint\n", "# AprioriLatitude = 1\nObject = ControlPoint\n"),
        ("    Group", "  /* a comment\n of two lines */  Group"), ("<pixels>", "<Pixel>"), ("<meters>", ""),
        ("= True", "= yes"), ("RegisteredSubPixel", "'registeredsubpixel'"), ("(100.0, 1.5, ", "(100.0,\n 1.5\n, "),
    ],
)  # fmt: skip
def test_other_ways_to_write_it_are_scanned(tmp_path: Path, old: str, new: str) -> None:
    text = RICH.decode()
    assert old in text
    assert assert_as_the_reader(text.replace(old, new).encode(), tmp_path)


def test_kilometres_are_metres(tmp_path: Path) -> None:
    found = pvl_tie_points(RICH.replace(b"<meters>", b"<km>"), "x.pvl")
    plain = pvl_tie_points(RICH, "x.pvl")
    assert found is not None
    assert plain is not None
    np.testing.assert_array_equal(found.places, 1000.0 * plain.places)
    assert assert_as_the_reader(RICH.replace(b"<meters>", b"<km>"), tmp_path)


def test_mutated_texts_are_as_the_reader_has_them(tmp_path: Path) -> None:
    rng = np.random.default_rng(25)
    scanned = sum(assert_as_the_reader(mutated(RICH, rng), tmp_path) for _ in range(500))
    assert 50 < scanned < 450


def test_what_is_odd_is_said_as_before(tmp_path: Path) -> None:
    """Through the front door: a file cut short in its last point names the line."""
    path = tmp_path / "short.pvl"
    path.write_bytes(RICH[:-40])
    with pytest.raises(InputError, match=r"short\.pvl, line \d+.*never closed"):
        read_control_network(path)


def test_a_hundred_thousand_digits_are_for_the_reader() -> None:
    assert pvl_tie_points(RICH.replace(b"    Line ", b"    Line = 1" + b"0" * 300 + b"\n#", 1), "x.pvl") is None


@pytest.mark.parametrize("between", ["\n", "#", "x", "( "])
def test_a_matrix_without_an_equals_sign_is_for_the_reader(between: str) -> None:
    text = re.sub(r"(AprioriCovarianceMatrix) *= *", rf"\1 {between}", RICH.decode(), count=1)
    assert f"AprioriCovarianceMatrix {between}(" in text
    assert pvl_tie_points(text.encode(), "x.pvl") is None


def test_more_images_than_the_first_table_has(tmp_path: Path) -> None:
    network = grid(3000, 3)
    points = tuple(
        replace(point, measures=tuple(replace(one, serial_number=f"{one.serial_number}/{k}") for one in point.measures))
        for k, point in enumerate(network.points)
    )
    data = network_text(replace(network, points=points)).encode()
    found = pvl_tie_points(data, "x.pvl")
    assert found is not None
    assert len(found.measure_image.used) == 9000
