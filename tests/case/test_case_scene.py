"""A case's images with their pixels over its ground, and what must be in it for them to be matched."""

from pathlib import Path

import matched
import numpy as np
import profiles
import pytest
from strip_files import write_block

from mgsgraph.case.case_file import decode
from mgsgraph.case.reading import picture_of
from mgsgraph.case.scene import read_scene
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import geodetic


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return matched.write(tmp_path_factory.mktemp("site"))


@pytest.fixture
def case(case_file: Path) -> Path:
    """The small simulated pair with pixels of noise."""
    import warnings

    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    grey = np.random.default_rng(0).integers(0, 256, (5000, 1024), dtype=np.uint8)
    text = case_file.read_text(encoding="utf-8")
    for letter in "AB":
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            path = case_file.with_name(f"{letter}.tif")
            with rasterio.open(path, "w", driver="GTiff", height=5000, width=1024, count=1, dtype="uint8") as file:
                file.write(grey, 1)
        text = text.replace(f'isd = "image_{letter}.isd"', f'isd = "image_{letter}.isd"\npixels = "{letter}.tif"')
    case_file.write_text(text, encoding="utf-8")
    return case_file


def without(case: Path, table: str) -> Path:
    """The case without a table and what follows it."""
    head, found, rest = case.read_text(encoding="utf-8").partition(f"[{table}]")
    assert found
    _, bracket, after = rest.partition("\n[")
    case.write_text(head + bracket.strip() + after, encoding="utf-8")
    return case


def test_a_site_is_what_was_written(site: Path) -> None:
    name, scene = read_scene(site)
    assert name == "Gusev Crater"
    ground, ours = scene.ground, matched.ground(matched.site().grid)
    assert ground.height_sigma == 100.0
    assert ground.height == pytest.approx(matched.HEIGHT, abs=60.0)
    for picture, image, made in zip(scene.pictures, matched.site().images, matched.scene().pictures, strict=True):
        assert picture.image.name == image.true.name
        np.testing.assert_array_equal(picture.pixels, image.pixels)
        np.testing.assert_allclose(picture.prior.sigmas[:, :3], made.prior.sigmas[:, :3], rtol=1e-3)
        points = ours.points(ours.chart.plane(matched.inner(40)))
        assert np.abs(ground.points(ground.chart.plane(points)) - points).max() < 1.0  # posts of whole metres
        # polynomials in place of the kernels' noise of four seconds of arc
        assert np.abs(picture.project(points) - made.project(points)).max() < 6.0
    ends = np.array([[0.0, 512.0], [matched.LINES, 512.0]])
    across, along = np.diff(scene.pictures[0].on_chart(ground, ends), axis=0)[0]
    assert abs(across) < 0.02 * along  # y is along the flight


def test_heights_come_from_where_they_are_known(case: Path) -> None:
    """Given; else of the laser shots, whose scatter says how sure it is."""
    _, told = read_scene(case, height=-1234.0, height_sigma=56.0)
    assert (told.ground.height, told.ground.height_sigma, told.ground.terrain) == (-1234.0, 56.0, None)
    _, of_shots = read_scene(case)
    from mgsgraph.files.altimetry.lidar import read_lidar

    heights = geodetic(read_lidar(case.with_name("lidar.json")).footprints, of_shots.ground.body)[:, 2]
    assert of_shots.ground.height == pytest.approx(heights.mean())
    assert of_shots.ground.height_sigma == pytest.approx(max(100.0, 2.0 * heights.std()))
    assert read_scene(case, height_sigma=20.0)[1].ground.height_sigma == 20.0
    profile = profiles.with_profile(case)
    assert read_scene(profile)[1].ground.height == pytest.approx(0.0, abs=20.0)


def test_pixels_are_those_that_the_case_names(case: Path) -> None:
    wanted = decode(case)
    assert picture_of(wanted.images[0], case.parent) == case.with_name("A.tif")
    _, scene = read_scene(case)
    assert scene.pictures[1].pixels.shape == (5000, 1024)
    np.testing.assert_allclose(scene.pictures[0].prior.sigmas[0], [30.0] * 3 + [1e-4] * 3)


def test_images_of_strips_have_their_strip_s_prior(tmp_path: Path) -> None:
    path = write_block(tmp_path)
    with pytest.raises(InputError, match="no pixels"):
        read_scene(path)
    from mgsgraph.case.passes import members
    from mgsgraph.case.scene import image_priors

    wanted = decode(path)
    of_strips = members(wanted.passes, [image.name for image in wanted.images], str(path))
    for prior in image_priors(wanted, of_strips, path):
        assert prior.sigmas.shape == (2, 6)
        assert np.all(np.isfinite(prior.sigmas))
        assert np.all(prior.sigmas > 0.0)


def refused(path: Path, *said: str) -> None:
    with pytest.raises(InputError) as caught:
        read_scene(path)
    for words in said:
        assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_one_image_is_refused(case: Path) -> None:
    text = case.read_text(encoding="utf-8")
    first, second = (text.index(f'[[images]]\nname = "SIM/{letter}"') for letter in "AB")
    case.write_text(text[:first] + text[second:], encoding="utf-8")
    refused(case, "case.toml: one image; expected two that overlap")


def test_pixels_of_another_image_are_refused(case: Path) -> None:
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    with (
        pytest.warns(NotGeoreferencedWarning),
        rasterio.open(
            case.with_name("B.tif"), "w", driver="GTiff", height=50, width=60, count=1, dtype="uint8"
        ) as file,
    ):
        file.write(np.zeros((50, 60), dtype=np.uint8), 1)
    refused(case, "image SIM/B: pixels of shape (50, 60); expected 5000 lines x 1024 samples")
