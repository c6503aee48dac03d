"""NVM files: counted from the image's middle as the pipeline does, and every damaged file refused."""

from pathlib import Path

import numpy as np
import pytest
from control_networks import IMAGES, as_set, free_networks
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec import structs

from mgsgraph.errors import InputError
from mgsgraph.files.networks.asp_text import half_sizes, nvm_files, offsets_path, read_nvm
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, MeasureType, PointType

SIZES = dict(zip(IMAGES, [(4864, 672), (5001, 1023), (10_000, 2048), (1, 1)], strict=True))
GRID = st.integers(512, 12_000 * 1024).map(lambda k: k / 1024.0)
"""Places that lose nothing when half an image is taken off."""
_ANY_FOLDER = settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
TEXT = """NVM_V3
2
left.tif 1 1 0 0 0 0 0 0 0 0
right.tif 1 1 0 0 0 0 0 0 0 0
2
10.5 -20 30 0 0 0 2 0 0 -3.5 4 1 0 1 2
0 0 0 0 0 0 2 0 1 0 0 1 1 5 6
"""
OFFSETS = "left.tif 512 1000.5\nright.tif 0 0\n"


def put(folder: Path, text: str = TEXT, offsets: str | None = OFFSETS) -> Path:
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
    with pytest.raises(InputError, match=r"no optical centre of image left.tif, nor a net_offsets.txt .*--case"):
        read_nvm(path)
    offsets_path(path).write_text(OFFSETS)
    assert read_nvm(path, half_sizes({"left.tif": (1, 1)})).points[0].measures[0].sample == 509.5


@given(given=free_networks(GRID))
@_ANY_FOLDER
def test_a_network_survives(tmp_path: Path, given: ControlNetwork) -> None:
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


@given(line=st.floats(0.5, 1e5), sample=st.floats(0.5, 1e4))
@_ANY_FOLDER
def test_any_place_survives_to_a_billionth_of_a_pixel(tmp_path: Path, line: float, sample: float) -> None:
    measures = tuple(ControlMeasure(image, MeasureType.CANDIDATE, sample, line) for image in IMAGES[:2])
    net = ControlNetwork("", "", (ControlPoint("a", PointType.FREE, measures),))
    for path, content in nvm_files(net, tmp_path / "net.nvm", half_sizes(SIZES)).items():
        path.write_bytes(content)
    for one in read_nvm(tmp_path / "net.nvm").points[0].measures:
        np.testing.assert_allclose([one.line, one.sample], [line, sample], rtol=0, atol=1e-10)


def test_what_visualsfm_writes_is_read(tmp_path: Path) -> None:
    """A calibration behind NVM_V3, blank lines, 0 for the end of the models, and the list of PLY files behind it."""
    text = TEXT.replace("NVM_V3\n", "NVM_V3 FixedK 1 2 3 4\n\n").replace("\n2\n10", "\n\n2\n10")
    text += "\n0\n#the last part\n0\n"
    assert read_nvm(put(tmp_path, text)).points == read_nvm(put(tmp_path)).points


FAULTS = {
    "no NVM": (TEXT.replace("NVM_V3", "NVM_V2"), "line 1: 'NVM_V2'; expected NVM_V3"),
    "too many cameras": (TEXT.replace("NVM_V3\n2", "NVM_V3\n999999999"), "line 5: 1 fields; expected 11"),
    "an image twice": (TEXT.replace("right", "left"), ": an image twice among its cameras"),
    "a measure short": (TEXT.replace("2 0 0 -3.5", "3 0 0 -3.5"), "line 6, point 1: 15 fields"),
    "no such camera": (TEXT.replace("1 0 1 2", "2 0 1 2"), "line 6, point 1: camera 2; expected 0 .. 1"),
    "an image twice in a point": (TEXT.replace("1 0 1 2", "0 0 1 2"), "line 6, point 1: two measures in one image"),
    "NaN": (TEXT.replace("-3.5", "nan"), "line 6, point 1: 'nan'; expected a finite number"),
    "a second model": (TEXT + "2\n", "line 8: more after the last point; expected one model"),
    "cut short": (TEXT[:-30], "it ends before point 2; expected a whole NVM file"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_said_with_their_line(tmp_path: Path, fault: str) -> None:
    text, said = FAULTS[fault]
    path = put(tmp_path, text)
    with pytest.raises(InputError) as caught:
        read_nvm(path)
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("offsets", "said"),
    [("left.tif 1\n", "line 1: 2 fields"), ("a 1 2\na 1 2\n", "line 2: image a twice"),
     ],
)  # fmt: skip
def test_faults_of_offsets(tmp_path: Path, offsets: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_nvm(put(tmp_path, offsets=offsets))


def test_what_it_cannot_hold_is_refused(tmp_path: Path) -> None:
    measures = tuple(ControlMeasure(image, MeasureType.CANDIDATE, 1, 1) for image in ("a b", "c"))
    net = ControlNetwork("", "", (ControlPoint("a", PointType.FREE, measures),))
    with pytest.raises(InputError, match="image 'a b': a name with blanks"):
        nvm_files(net, tmp_path / "x.nvm", half_sizes({"a b": (1, 1), "c": (1, 1)}))
    with pytest.raises(InputError, match=r"no size of image a b; .*--images NAME=LINESxSAMPLES"):
        nvm_files(net, tmp_path / "x.nvm", {})
    with pytest.raises(InputError, match="no point that two images see"):
        nvm_files(structs.replace(net, points=(ControlPoint("a", PointType.FREE),)), tmp_path / "x.nvm", {})
