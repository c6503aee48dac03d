"""Images of a case by files that say themselves what they are, and ISIS lists of them."""

from pathlib import Path

import pytest
from commands import run
from cubes import MAPPED, written

from mgsgraph.case.case_file import decode, plain_image, read_image
from mgsgraph.case.reading import picture_of
from mgsgraph.case.schema import ImageInput, SpiceInput
from mgsgraph.errors import InputError

OTHER_CLOCK = ("100:0", "200:0")


def case_file(folder: Path, *images: str) -> Path:
    path = folder / "case.toml"
    tables = "".join(f"[[images]]\n{image}\n" for image in images)
    path.write_text(f'format = 1\nname = "cubes"\n{tables}')
    return path


def test_a_list_is_its_files_called_by_their_serial_numbers(tmp_path: Path) -> None:
    (tmp_path / "cubes").mkdir()
    written(tmp_path / "cubes", name="a.cub")
    written(tmp_path / "cubes", OTHER_CLOCK, name="b.cub")
    (tmp_path / "cubes" / "cubes.lis").write_text("a.cub\n\n# the second\nb.cub   # last\n")
    wanted = decode(case_file(tmp_path, 'list = "cubes/cubes.lis"\nheld = true'))
    assert [(image.name, image.cube, image.held) for image in wanted.images] == [
        ("MGS/100:0/MOC-NA", "cubes/a.cub", True), ("MGS/200:0/MOC-NA", "cubes/b.cub", True),
    ]  # fmt: skip
    image = read_image(wanted.images[1], None, tmp_path, "case")
    assert (image.name, image.lines) == ("MGS/200:0/MOC-NA", 100)


def test_kernels_of_an_image_go_before_its_tables(tmp_path: Path) -> None:
    """Those for all images don't: a cube with tables is whole."""
    written(tmp_path)
    for kernels, spice, kind in (((), None, "cube"), (("a.bsp",), None, "label"), ((), SpiceInput(("a.bsp",)), "cube")):
        entry = plain_image(ImageInput(image="image.cub", kernels=kernels), spice, tmp_path, "case")
        assert [key for key in ("isd", "cube", "label") if getattr(entry, key)] == [kind]


def test_a_cube_without_spice_needs_kernels(tmp_path: Path) -> None:
    written(tmp_path, ("Name = InstrumentPointing", "Name = Other"))
    entry = plain_image(ImageInput(image="image.cub"), SpiceInput(("a.bsp",)), tmp_path, "case")
    assert entry.label == "image.cub"
    entry = plain_image(ImageInput(image="image.cub"), None, tmp_path, "case")
    with pytest.raises(InputError, match=r"run spiceinit on the cube .*, or name the label and its kernels"):
        read_image(entry, None, tmp_path, "case")


def test_pixels_are_the_cubes_own_unless_it_is_a_map(tmp_path: Path) -> None:
    assert picture_of(ImageInput(cube="image.cub"), written(tmp_path).parent) == tmp_path / "image.cub"
    assert picture_of(ImageInput(cube="image.cub"), written(tmp_path, MAPPED).parent) is None


FAULTS = {
    "nothing": (("held = true",), "images[0]: no file of the image; expected one of image, list, isd, state, label"),
    "an empty list": (('list = "empty.lis"',), "empty.lis: no file; expected the name of an image file in every line"),
    "gone": (('list = "gone.lis"',), "gone.lis, line 2: 'c.cub', which is not there"),
    "no image": (('image = "gone.lis"',), "no image, label or support data"),
    "twice": (('image = "image.cub"', 'name = "MGS/100:0/MOC-NA"\nisd = "a.isd"'), "for image.cub and for a.isd"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_said_in_one_line(tmp_path: Path, fault: str) -> None:
    written(tmp_path)
    (tmp_path / "empty.lis").write_text("# nothing\n")
    (tmp_path / "gone.lis").write_text("image.cub\nc.cub\n")
    images, said = FAULTS[fault]
    path = case_file(tmp_path, *images)
    done = run("check", str(path))
    assert done.returncode == 2
    assert said in done.stderr
    assert str(tmp_path) in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize(
    "key", ["attitude_bias_s = 5.0", "focal_length_m = 1.0", 'constants = "ik"', 'line_times = "mean"']
)
def test_keys_that_would_change_nothing_are_refused(tmp_path: Path, key: str) -> None:
    """A cube has its own constants and times: a case that says others would be adjusted as if it didn't."""
    written(tmp_path)
    with pytest.raises(InputError, match=f"{key.split()[0]} for image.cub, which is read as cube"):
        decode(case_file(tmp_path, f'image = "image.cub"\n{key}'))
