"""Match files: the pipeline's own layout, places to the last bit of float32, tracks, and every damaged file refused."""

import struct
import tracemalloc
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from control_networks import IMAGES, SINGLE, as_set, free_networks
from hypothesis import HealthCheck, given, settings

from mgsgraph.errors import InputError
from mgsgraph.files.networks.asp_match import MatchFile, images_of, joined, match_files, read_match
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, MeasureType, PointType

PAIR = ("one", "two")
IN_ISIS = SINGLE.map(lambda place: place + 1.0)
"""Places that are float32 in the pipeline's count."""
_ANY_FOLDER = settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])


def record(x: float, y: float, scale: float = 1.0, descriptors: Sequence[float] = ()) -> bytes:
    """An interest point as VisionWorkbench's write_ip_record writes it, field by field."""
    head = struct.pack("<ffiifff?IIQ", x, y, int(x), int(y), 0.5, scale, 2.0, True, 3, 4, len(descriptors))
    return head + struct.pack(f"<{len(descriptors)}f", *descriptors)


def match_file(firsts: Sequence[bytes], seconds: Sequence[bytes]) -> bytes:
    return struct.pack("<QQ", len(firsts), len(seconds)) + b"".join(firsts) + b"".join(seconds)


def network(*points: dict[str, tuple[float, float]], **more: float) -> ControlNetwork:
    """Free points of line and sample (ISIS) by image."""
    made = [
        ControlPoint(
            f"p{k}",
            PointType.FREE,
            tuple(
                ControlMeasure(image, MeasureType.CANDIDATE, sample, line, **more)
                for image, (line, sample) in places.items()
            ),
        )
        for k, places in enumerate(points)
    ]
    return ControlNetwork("", "", tuple(made))


@pytest.mark.parametrize("descriptors", [(0, 0, 0, 0), (128, 128, 128, 128), (0, 1, 5, 128)])
def test_the_pipelines_own_layout(tmp_path: Path, descriptors: tuple[int, ...]) -> None:
    """With descriptors or without, as many for each place or not: column before row, the scale is the sigma."""
    path = tmp_path / "run-one__two.match"
    places = [(1.5, 2.5, 1), (7, 8, 0), (3.25, 4, 2), (5, 6, 0.5)]
    rows = [record(*place, [0.25] * number) for place, number in zip(places, descriptors, strict=True)]
    path.write_bytes(match_file(rows[:2], rows[2:]))

    got = read_match(path, PAIR)

    np.testing.assert_array_equal(got.pixels, [[[2.5, 1.5], [8, 7]], [[4, 3.25], [6, 5]]])
    np.testing.assert_array_equal(got.sigmas, [[1, np.nan], [2, 0.5]])


def test_what_is_written_is_the_pipelines_own_layout(tmp_path: Path) -> None:
    """One pixel less than ISIS, and 45 bytes for a place."""
    given = network({"one": (11.5, 21.25), "two": (31, 41)}, sample_sigma=0.5, line_sigma=0.5)

    files = match_files(given, tmp_path / "r")

    (path, content), = files.items()
    assert path == tmp_path / "r-one__two.match"
    assert len(content) == 16 + 2 * 45
    assert struct.unpack_from("<QQffii", content) == (1, 1, 20.25, 10.5, 20, 10)
    assert struct.unpack_from("<fff?IIQ", content, 32) == (0, 0.5, 0, False, 0, 0, 0)
    assert struct.unpack_from("<ff", content, 16 + 45) == (40, 30)


@given(given=free_networks(IN_ISIS))
@_ANY_FOLDER
def test_a_network_survives_its_match_files(tmp_path: Path, given: ControlNetwork) -> None:
    """Points of up to four images come apart into pairs and together again, bit for bit."""
    files = match_files(given, tmp_path / "run")
    read = []
    for path, content in files.items():
        path.write_bytes(content)
        images = images_of(path, prefix="run")
        assert images == images_of(path, known=IMAGES)
        read.append(read_match(path, images))

    back = joined(read)

    assert as_set(back.network) == as_set(given)
    assert back.contradictory == 0


def pairs(names: tuple[str, str], *places: tuple[float, float]) -> MatchFile:
    """MatchFile of places (k, k) and (m, m)."""
    table = np.array([[[k, k] for k, _ in places], [[m, m] for _, m in places]], dtype=np.float64)
    return MatchFile("+".join(names), names, table, np.ones((2, len(places))))


def test_contradictory_tracks_are_dropped_as_the_pipeline_does() -> None:
    """Place 1 of image a is matched by way of c with place 9 of a as well: all of that point goes, and is counted."""
    made = joined([
        pairs(("a", "b"), (1, 2), (5, 6)), pairs(("b", "c"), (2, 3), (6, 7)), pairs(("a", "c"), (9, 3)),
    ])  # fmt: skip

    assert made.contradictory == 1
    assert [point.id for point in made.network.points] == ["match1"]
    assert [(one.serial_number, one.line) for one in made.network.points[0].measures] == [("a", 6), ("b", 7), ("c", 8)]
    with pytest.raises(InputError, match=r"a\+b, b\+c, a\+c: only contradictory matches \(1 point"):
        joined([pairs(("a", "b"), (1, 2)), pairs(("b", "c"), (2, 3)), pairs(("a", "c"), (9, 3))])


def test_a_place_must_be_equal_to_the_last_bit_to_be_the_same() -> None:
    near = float(np.nextafter(np.float32(2), np.float32(3)))
    assert len(joined([pairs(("a", "b"), (1, 2)), pairs(("b", "c"), (near, 3))]).network.points) == 2
    assert len(joined([pairs(("a", "b"), (1, 2)), pairs(("b", "c"), (2, 3))]).network.points) == 1


def test_names_of_files_are_taken_apart() -> None:
    assert images_of(Path("out/run-one__two.match")) == ("one", "two")
    assert images_of(Path("one__two.match")) == ("one", "two")
    assert images_of(Path("run-E02-1__E02-2.match"), prefix="run") == ("E02-1", "E02-2")
    assert images_of(Path("a-b-E02-1__E02-2.match"), prefix="a-b") == ("E02-1", "E02-2")
    assert images_of(Path("a-b-E02-1__E02-2.match"), known=["x/E02-1.cub", "E02-2.cub"]) == ("x/E02-1.cub", "E02-2.cub")
    assert images_of(Path("run-one__two-clean.match"), known=["one", "two"]) == ("one", "two")
    assert images_of(Path("run-one__two-clean.match")) == ("one", "two")
    assert images_of(Path("run-one__two-clean.match"), prefix="out/run") == ("one", "two")
    assert images_of(Path("run-one__two-clean.match"), known=["one", "two-clean"]) == ("one", "two-clean")
    assert images_of(Path("E02-1__E02-2.match"), known=["E02-1", "E02-2"]) == ("E02-1", "E02-2")
    with pytest.raises(InputError, match="may be A/1/NAC and WAC, or A/2/NAC and WAC"):
        images_of(Path("run-NAC__WAC.match"), known=["A/1/NAC", "A/2/NAC", "WAC"])
    with pytest.raises(InputError, match="may be E02-1 and E02-2, or 1 and E02-2"):
        images_of(Path("E02-1__E02-2.match"), known=["E02-1", "E02-2", "1"])
    with pytest.raises(InputError, match=r"its images may be E02-1 and E02-2, or 1 and E02-2; .*say --prefix"):
        images_of(Path("run-E02-1__E02-2.match"))
    with pytest.raises(InputError, match="without two of the images"):
        images_of(Path("run-one__two.match"), known=["one", "three"])
    with pytest.raises(InputError, match="doesn't tell the images"):
        images_of(Path("matches.match"))


def test_images_that_no_file_can_tell_apart_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"the same name as A/1/NAC without folder and ending \(NAC\).*--rename"):
        match_files(network({"A/1/NAC": (1, 1), "A/2/NAC": (1, 1)}), tmp_path / "run")
    with pytest.raises(InputError, match="a name of 271 bytes; expected at most 255"):
        match_files(network({"A" * 255: (1, 1), "B": (1, 1)}), tmp_path / "prefix")
    with pytest.raises(InputError, match="a sigma that a match file can't hold"):
        match_files(network({"A": (1, 1), "B": (1, 1)}, sample_sigma=1e200, line_sigma=1.0), tmp_path / "run")
    with pytest.raises(InputError, match="no free point that two images see"):
        match_files(network({"A": (1, 1)}), tmp_path / "run")


SOUND = match_file([record(1.5, 2.5), record(3, 4, 2, [1, 2])], [record(5, 6), record(7, 8)])


def attempt(path: Path, content: bytes) -> ControlNetwork | None:
    """What is read of a file, None for one that is refused; anything but InputError is a failure."""
    path.write_bytes(content)
    try:
        return joined([read_match(path, PAIR)]).network
    except InputError as error:
        message = str(error)
    assert message.startswith(str(path))
    assert "\n" not in message
    return None


def test_every_prefix_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.match"
    assert attempt(path, SOUND) is not None
    assert all(attempt(path, SOUND[:length]) is None for length in range(len(SOUND)))
    assert attempt(path, SOUND + b"\0") is None


def test_sizes_that_a_file_merely_states_are_not_believed(tmp_path: Path) -> None:
    path = tmp_path / "x.match"
    tracemalloc.start()
    for huge in (2**31, 2**32 - 1, 2**40, 2**63, 2**64 - 1):
        assert attempt(path, struct.pack("<QQ", huge, huge) + SOUND[16:]) is None
        for at in (16 + 37, 16 + 45 + 37):
            assert attempt(path, SOUND[:at] + struct.pack("<Q", huge) + SOUND[at + 8 :]) is None
    assert tracemalloc.get_traced_memory()[1] < 5e6
    tracemalloc.stop()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_places_that_are_no_numbers_are_refused(tmp_path: Path, bad: float) -> None:
    path = tmp_path / "x.match"
    path.write_bytes(match_file([record(1, 2), record(3, 4)], [record(5, 6), placed(bad)]))
    with pytest.raises(InputError, match="match 2: a place or scale that is no finite number"):
        read_match(path, PAIR)


def test_a_signalling_nan_is_refused_without_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "x.match"
    good = record(1, 1)
    path.write_bytes(match_file([good], [good[:4] + b"\x01\x00\xa0\x7f" + good[8:]]))
    with pytest.raises(InputError, match="match 1: a place or scale that is no finite number"):
        read_match(path, PAIR)


def placed(y: float) -> bytes:
    """A record with any float as its row."""
    good = record(1, 1)
    return good[:4] + struct.pack("<f", y) + good[8:]
