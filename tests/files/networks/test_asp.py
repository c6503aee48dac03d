"""Files of the Ames Stereo Pipeline: ground control, matches and NVM, by its documentation, there and back."""

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from control_networks import IMAGES, SINGLE, as_set, free_networks
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec import structs
from outside import refuses

from mgsgraph.errors import InputError
from mgsgraph.files.networks.asp_match import MatchFile, images_of, joined, match_files, read_match, read_match_text
from mgsgraph.files.networks.asp_text import (
    ground_control_text,
    half_sizes,
    nvm_files,
    offsets_path,
    read_ground_control,
    read_ground_control_network,
    read_nvm,
)
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, MeasureType, PointType
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.geometry.body import Ellipsoid, from_geodetic
from mgsgraph.units import DEG

# --- ground control read


MARS = Ellipsoid(3396190.0, 3376200.0)
EARTH = Ellipsoid(6378137.0, 6356752.314245179)
DOCUMENTED = "5 23.7 160.1 427.1 1.0 1.0 1.0 image1.tif 124.5 19.7 1.0 1.0 image2.tif 254.3 73.9 1.0 1.0"
"""The example of StereoPipeline's documentation."""


def control_points(folder: Path, text: str, ellipsoid: Ellipsoid = MARS) -> TiePoints:
    path = folder / "points.gcp"
    path.write_text(text)
    return read_ground_control(path, ellipsoid)


def test_the_documented_line(tmp_path: Path) -> None:
    got = control_points(tmp_path, DOCUMENTED)

    assert got.ids == ("5",)
    assert got.kinds.tolist() == [PointKind.CONSTRAINED]
    np.testing.assert_array_equal(got.covariances[0], np.eye(3))
    assert got.measure_image == ("image1.tif", "image2.tif")
    np.testing.assert_allclose(got.measures, [[20.2, 125.0], [74.4, 254.8]], rtol=1e-15)  # row before column, plus 0.5
    np.testing.assert_array_equal(got.measure_sigmas, 1.0)
    np.testing.assert_allclose(np.degrees(np.arctan2(got.places[0, 1], got.places[0, 0])), 160.1, rtol=1e-14)


def test_latitude_is_geodetic(tmp_path: Path) -> None:
    """WGS 84, 45 N 0 E, height 0: X 4517590.879 m, Z 4487348.409 m, as any table of the ellipsoid has it."""
    got = control_points(tmp_path, "a 45 0 0 1 1 1", EARTH)

    np.testing.assert_allclose(got.places[0], [4517590.879, 0.0, 4487348.409], rtol=0, atol=1e-3)


def test_sigmas_are_along_body_fixed_axes_and_line_goes_before_sample(tmp_path: Path) -> None:
    got = control_points(tmp_path, "a 0 90 0 1 2 3 one 10 20 0.1 0.2")

    np.testing.assert_array_equal(got.covariances[0], np.diag([1.0, 4.0, 9.0]))
    np.testing.assert_array_equal(got.measure_sigmas, [[0.2, 0.1]])


def test_the_tiny_sigma_means_fixed(tmp_path: Path) -> None:
    got = control_points(tmp_path, "a 1 2 3 1e-10 1e-10 0.0000000001\nb 1 2 3 1e-9 1e-9 1e-9")

    assert got.kinds.tolist() == [PointKind.FIXED, PointKind.CONSTRAINED]
    np.testing.assert_array_equal(got.covariances[0], 0.0)


def test_commas_comments_and_blank_lines(tmp_path: Path) -> None:
    plain = control_points(tmp_path, DOCUMENTED)
    names = DOCUMENTED.replace(" ", ", ").replace("image1", "im#age1")
    dressed = control_points(tmp_path, f"# id, lat\n\n  \t\n{names} # why\r\n#5 nothing")

    assert dressed.ids == plain.ids
    assert dressed.measure_image == ("im#age1.tif", "image2.tif")
    np.testing.assert_array_equal(dressed.places, plain.places)
    np.testing.assert_array_equal(dressed.measures, plain.measures)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("x 1 2 3 1 1", "point x: 6 fields; expected 7, and 5 more for each image"),
        ("x 160.1 23.7 3 1 1 1", "point x, latitude: 160.1 degrees; expected -90 .. 90; latitude comes before"),
        ("x 1 2 3 1 0 1", "point x, sigma: 0; expected a positive number"),
        ("x 1 2 3 1 1 1 one 1 2 1 1 one 1 2 1 1", "point x, image one: a second measure"),
        ("5 1 2 3 1 1 1", "point 5: the id twice, first in line 1"),
    ],
)
def test_a_fault_is_said_with_line_and_point(tmp_path: Path, line: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        control_points(tmp_path, f"{DOCUMENTED}\n\n{line}\n")

    assert str(caught.value).startswith(f"{tmp_path / 'points.gcp'}, line 3, {said}")


# --- ground control written


PLACE = from_geodetic(np.array([160.1 * DEG, 23.7 * DEG, 427.1]), MARS)


def point(name: str = "5", kind: PointType = PointType.CONSTRAINED, sigma: float = 2.0, **more: object) -> ControlPoint:
    x, y, z = PLACE.tolist()
    covariance = (sigma**2, 0.0, 0.0, 9.0, 0.0, 16.0) if kind == PointType.CONSTRAINED else ()
    measure = ControlMeasure("a.tif", MeasureType.CANDIDATE, 125.5, 20.75, sample_sigma=0.5, line_sigma=0.25)
    return ControlPoint(name, kind, (measure,), apriori=(x, y, z), apriori_covariance=covariance, **more)  # type: ignore[arg-type]


def net(*points: ControlPoint) -> ControlNetwork:
    return ControlNetwork("", "", points, source="net")


def test_fields_are_those_of_the_documentation() -> None:
    """id latitude longitude height, sigmas, image column row and their sigmas; one pixel less than ISIS."""
    text = ground_control_text(net(point(), point("6", PointType.FIXED)), MARS)
    lines = [line for line in text.splitlines() if not line.startswith("#")]

    fields = lines[0].split()
    np.testing.assert_allclose([float(text) for text in fields[1:4]], [23.7, 160.1, 427.1], rtol=1e-11)
    assert fields[0] == "5"
    assert fields[4:] == ["2.0", "3.0", "4.0", "a.tif", "124.5", "19.75", "0.5", "0.25"]
    assert lines[1].split()[4:7] == ["1e-10"] * 3
    assert "# WKT: GEOGCS[" in text


@given(
    longitude=st.floats(-180, 180), latitude=st.floats(-90, 90), height=st.floats(-8e3, 22e3),
    sigma=st.floats(1e-3, 1e3), line=st.floats(0.5, 1e5), sample=st.floats(0.5, 1e4), fixed=st.booleans(),
)  # fmt: skip
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
def test_points_survive(
    tmp_path: Path, longitude: float, latitude: float, height: float, sigma: float, line: float, sample: float,
    fixed: bool,
) -> None:  # fmt: skip
    """PixelMeasures bit for bit, sigmas to rounding, places to a hundredth of a micrometre."""
    x, y, z = from_geodetic(np.array([longitude * DEG, latitude * DEG, height]), MARS).tolist()
    given = ControlPoint(
        "1",
        PointType.FIXED if fixed else PointType.CONSTRAINED,
        (ControlMeasure("a.tif", MeasureType.CANDIDATE, sample, line, sample_sigma=sigma, line_sigma=2 * sigma),),
        apriori=(x, y, z),
        apriori_covariance=() if fixed else (sigma**2, 0.0, 0.0, 1.0, 0.0, 4.0),
    )
    path = tmp_path / "x.gcp"
    path.write_text(ground_control_text(net(given), MARS))

    (got,) = read_ground_control_network(path, MARS).points

    assert got.measures == given.measures
    assert (got.id, got.type) == (given.id, given.type)
    np.testing.assert_allclose(got.apriori_covariance, given.apriori_covariance, rtol=4e-16)
    np.testing.assert_allclose(got.apriori, given.apriori, rtol=0, atol=1e-8)


def test_ids_that_the_pipeline_does_not_read_are_numbered_with_the_name_in_a_comment(tmp_path: Path) -> None:
    text = ground_control_text(net(point("hill"), point("7")), MARS)

    assert "# 1: hill\n1 " in text
    assert "# 2: 7\n2 " in text
    (tmp_path / "x.gcp").write_text(text)
    assert read_ground_control(tmp_path / "x.gcp", MARS).ids == ("1", "2")


def test_what_a_gcp_file_cannot_hold_is_left_out_or_refused() -> None:
    free = ControlPoint("9", PointType.FREE)
    assert len(ground_control_text(net(point(), free, point("8", ignore=True)), MARS).splitlines()) == 3
    with pytest.raises(InputError, match="point 5: fixed without an a-priori place"):
        ground_control_text(net(ControlPoint("5", PointType.FIXED)), MARS)
    refuses("point 5: constrained without positive variances", ground_control_text, net(point(sigma=0.0)), MARS)
    named = structs.replace(point(), measures=(ControlMeasure("a b", MeasureType.CANDIDATE, 1, 1),))
    refuses("a name with blanks, commas or a #", ground_control_text, net(named), MARS)


# --- match files


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


def network(places: dict[str, tuple[float, float]], **more: float) -> ControlNetwork:
    """A free point of line and sample (ISIS) by image."""
    measures = tuple(
        ControlMeasure(image, MeasureType.CANDIDATE, sample, line, **more) for image, (line, sample) in places.items()
    )
    return ControlNetwork("", "", (ControlPoint("p", PointType.FREE, measures),))


def test_the_pipelines_own_layout(tmp_path: Path) -> None:
    """Descriptors for some places: column before row, the scale is the sigma."""
    path = tmp_path / "run-one__two.match"
    places = [(1.5, 2.5, 1), (7, 8, 0), (3.25, 4, 2), (5, 6, 0.5)]
    rows = [record(*place, [0.25] * number) for place, number in zip(places, (0, 1, 5, 128), strict=True)]
    path.write_bytes(match_file(rows[:2], rows[2:]))

    got = read_match(path, PAIR)

    np.testing.assert_array_equal(got.pixels, [[[2.5, 1.5], [8, 7]], [[4, 3.25], [6, 5]]])
    np.testing.assert_array_equal(got.sigmas, [[1, np.nan], [2, 0.5]])


def test_what_is_written_is_the_pipelines_own_layout(tmp_path: Path) -> None:
    """One pixel less than ISIS, the quadratic mean of the sigmas, and 45 bytes for a place."""
    given = network({"one": (11.5, 21.25), "two": (31, 41)}, sample_sigma=0.1, line_sigma=0.7)

    files = match_files(given, tmp_path / "r")

    ((path, content),) = files.items()
    assert path == tmp_path / "r-one__two.match"
    assert len(content) == 16 + 2 * 45
    assert struct.unpack_from("<QQffii", content) == (1, 1, 20.25, 10.5, 20, 10)
    assert struct.unpack_from("<fff?IIQ", content, 32) == (0, 0.5, 0, False, 0, 0, 0)
    assert struct.unpack_from("<ff", content, 16 + 45) == (40, 30)


@given(given=free_networks(IN_ISIS), text=st.booleans())
@_ANY_FOLDER
def test_a_network_survives_its_match_files(tmp_path: Path, given: ControlNetwork, text: bool) -> None:
    """Points of up to four images come apart into pairs and together again, bit for bit."""
    files = match_files(given, tmp_path / "run", text)
    read = []
    for path, content in files.items():
        path.write_bytes(content)
        images = images_of(path, prefix="run")
        assert images == images_of(path, known=IMAGES)
        read.append((read_match_text if text else read_match)(path, images))

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


NAMES: dict[tuple[str, str, tuple[str, ...]], tuple[str, str] | str] = {
    ("out/run-one__two.match", "", ()): ("one", "two"),
    ("a-b-E02-1__E02-2.match", "a-b", ()): ("E02-1", "E02-2"),
    ("a-b-E02-1__E02-2.match", "", ("x/E02-1.cub", "E02-2.cub")): ("x/E02-1.cub", "E02-2.cub"),
    ("run-one__two-clean.match", "out/run", ()): ("one", "two"),
    ("run-one__two-clean.match", "", ("one", "two-clean")): ("one", "two-clean"),
    ("run-NAC__WAC.match", "", ("A/1/NAC", "A/2/NAC", "WAC")): "may be A/1/NAC and WAC, or A/2/NAC and WAC",
    ("run-E02-1__E02-2.match", "", ()): "its images may be E02-1 and E02-2, or 1 and E02-2; .*say --prefix",
    ("run-one__two.match", "", ("one", "three")): "without two of the images",
}
"""Images, or what is said, by the file, a prefix and the images that are known."""


@pytest.mark.parametrize("given", NAMES, ids=str)
def test_names_of_files_are_taken_apart(given: tuple[str, str, tuple[str, ...]]) -> None:
    name, prefix, known = given
    images = NAMES[given]
    if isinstance(images, tuple):
        assert images_of(Path(name), prefix=prefix or None, known=known) == images
    else:
        refuses(images, images_of, Path(name), prefix=prefix or None, known=known)


def test_images_that_no_file_can_tell_apart_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"the same name as A/1/NAC without folder and ending \(NAC\).*--rename"):
        match_files(network({"A/1/NAC": (1, 1), "A/2/NAC": (1, 1)}), tmp_path / "run")
    with pytest.raises(InputError, match="a sigma that a match file can't hold"):
        match_files(network({"A": (1, 1), "B": (1, 1)}, sample_sigma=1e200, line_sigma=1.0), tmp_path / "run")


SOUND = match_file([record(1.5, 2.5), record(3, 4, 2, [1, 2])], [record(5, 6), record(7, 8)])
"""Descriptors of two numbers for the second place."""


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    """Cut short, with sizes that they merely state, and with places that are no numbers, a signalling one too."""
    path = tmp_path / "x.match"
    path.write_bytes(SOUND)
    assert len(joined([read_match(path, PAIR)]).network.points) == 2
    huge = [struct.pack("<QQ", size, size) + SOUND[16:] for size in (2**31, 2**40, 2**64 - 1)]
    huge += [SOUND[:53] + struct.pack("<Q", size) + SOUND[61:] for size in (2**31, 2**64 - 1)]
    odd = [SOUND[:20] + row + SOUND[24:] for row in (b"\x01\x00\xa0\x7f", struct.pack("<f", np.inf))]
    for content in [*(SOUND[:length] for length in range(len(SOUND))), SOUND + b"\0", *huge, *odd]:
        path.write_bytes(content)
        refuses(r"x\.match", read_match, path, PAIR)


def test_text_is_columns_before_rows(tmp_path: Path) -> None:
    """The documented line: x1 y1 unc1 x2 y2 unc2."""
    path = tmp_path / "x.txt"
    path.write_text("\n124.5 19.7 0.5 254.3 73.9 2\n")
    got = read_match_text(path, PAIR)
    np.testing.assert_array_equal(got.pixels, [[[19.7, 124.5]], [[73.9, 254.3]]])
    np.testing.assert_array_equal(got.sigmas, [[0.5], [2]])
    for line, said in (("1 2 3 4 5", "5 fields; expected six"), ("1 2 1 3 4 0", "uncertainty 0 px; expected a pos")):
        path.write_text(f"1.5 2.5 1 3 4 1\n{line}\n")
        refuses(f"x.txt, line 2: {said}", read_match_text, path, PAIR)


# --- NVM


SIZES = dict(zip(IMAGES, [(4864, 672), (5001, 1023), (10_000, 2048), (1, 1)], strict=True))
GRID = st.integers(512, 12_000 * 1024).map(lambda k: k / 1024.0)
"""Places that lose nothing when half an image is taken off."""
NVM = """NVM_V3
2
left.tif 1 1 0 0 0 0 0 0 0 0
right.tif 1 1 0 0 0 0 0 0 0 0
2
10.5 -20 30 0 0 0 2 0 0 -3.5 4 1 0 1 2
0 0 0 0 0 0 2 0 1 0 0 1 1 5 6
"""
OFFSETS = "left.tif 512 1000.5\nright.tif 0 0\n"


def put(folder: Path, text: str = NVM, offsets: str | None = OFFSETS) -> Path:
    path = folder / "net.nvm"
    path.write_text(text)
    if offsets is not None:
        offsets_path(path).write_text(offsets)
    return path


def test_places_count_from_the_optical_centre_column_first(tmp_path: Path) -> None:
    """-3.5, 4 past column 512, row 1000.5 from the first pixel's centre at 0 is ISIS's sample 509.5, line 1005.5."""
    got = read_nvm(put(tmp_path))

    first, second = got.points
    assert (first.measures[0].sample, first.measures[0].line) == (509.5, 1005.5)
    assert (first.measures[1].sample, first.measures[1].line) == (2, 3)
    assert first.adjusted == (10.5, -20, 30)
    assert second.adjusted is None
    assert [one.serial_number for one in second.measures] == ["left.tif", "right.tif"]


def test_the_centre_is_half_the_image_and_a_file_beside_goes_first(tmp_path: Path) -> None:
    path = put(tmp_path, offsets=None)
    centres = half_sizes({"left.tif": (2001, 1024), "right.tif": (10, 10)})

    assert read_nvm(path, centres).points[0].measures[0].sample == 509.5
    assert read_nvm(path, shifted=False).points[0].measures[0].sample == -2.5
    refuses(r"no optical centre of image left.tif, nor a net_offsets.txt .*--case", read_nvm, path)
    offsets_path(path).write_text(OFFSETS)
    assert read_nvm(path, half_sizes({"left.tif": (1, 1)})).points[0].measures[0].sample == 509.5


@given(given=free_networks(GRID))
@_ANY_FOLDER
def test_a_network_survives_nvm(tmp_path: Path, given: ControlNetwork) -> None:
    """But for its sigmas, which NVM does not have; points stay in their order, and so do their measures."""
    bare = structs.replace(given, points=tuple(
        structs.replace(point, adjusted=(1.5, -float(k), 1e6 / 3), measures=tuple(
            structs.replace(one, line_sigma=None, sample_sigma=None) for one in point.measures
        ))
        for k, point in enumerate(given.points)
    ))  # fmt: skip
    for path, content in nvm_files(bare, tmp_path / "net.nvm", half_sizes(SIZES)).items():
        path.write_bytes(content)

    got = read_nvm(tmp_path / "net.nvm")

    assert [point.measures for point in got.points] == [point.measures for point in bare.points]
    assert [point.adjusted for point in got.points] == [point.adjusted for point in bare.points]
    assert as_set(got) == as_set(bare)


def test_what_visualsfm_writes_is_read(tmp_path: Path) -> None:
    """A calibration behind NVM_V3, blank lines, 0 for the end of the models, and the list of PLY files behind it."""
    text = NVM.replace("NVM_V3\n", "NVM_V3 FixedK 1 2 3 4\n\n").replace("\n2\n10", "\n\n2\n10")
    text += "\n0\n#the last part\n0\n"
    assert read_nvm(put(tmp_path, text)).points == read_nvm(put(tmp_path)).points


NVM_FAULTS = {
    "no NVM": (NVM.replace("NVM_V3", "NVM_V2"), "line 1: 'NVM_V2'; expected NVM_V3"),
    "too many cameras": (NVM.replace("NVM_V3\n2", "NVM_V3\n999999999"), "line 5: 1 fields; expected 11"),
    "no such camera": (NVM.replace("1 0 1 2", "2 0 1 2"), "line 6, point 1: camera 2; expected 0 .. 1"),
    "an image twice in a point": (NVM.replace("1 0 1 2", "0 0 1 2"), "line 6, point 1: two measures in one image"),
    "a second model": (NVM + "2\n", "line 8: more after the last point; expected one model"),
    "cut short": (NVM[:-30], "it ends before point 2; expected a whole NVM file"),
}


@pytest.mark.parametrize("fault", NVM_FAULTS)
def test_faults_of_nvm_are_said_with_their_line(tmp_path: Path, fault: str) -> None:
    text, said = NVM_FAULTS[fault]
    with pytest.raises(InputError) as caught:
        read_nvm(put(tmp_path, text))
    assert said in str(caught.value)


def test_what_nvm_cannot_hold_is_refused(tmp_path: Path) -> None:
    given = network({"a b": (1, 1), "c": (1, 1)})
    with pytest.raises(InputError, match="image 'a b': a name with blanks"):
        nvm_files(given, tmp_path / "x.nvm", half_sizes({"a b": (1, 1), "c": (1, 1)}))
    refuses(r"no size of image a b; .*--size NAME=LINESxSAMPLES", nvm_files, given, tmp_path / "x.nvm", {})
