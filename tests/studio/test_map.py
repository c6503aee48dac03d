"""The studio's map: images under it, graticule, distances; its names and its room on the screen."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from commands import call
from PIL import Image
from profiles import with_pixels

from mgsgraph.analysis.posterior import Posterior
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import from_planetocentric, geodetic, places_at, plane_coordinates, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.results.archive import read_solution
from mgsgraph.studio.map_distance import distance
from mgsgraph.studio.map_graticule import graticule
from mgsgraph.studio.map_images import MapImages, ground_at
from mgsgraph.studio.opened import Opened
from mgsgraph.studio.tiles import SIDE, Tiles
from mgsgraph.units import DEG

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from studio_server import Page, studio


@pytest.fixture(scope="module")
def pictured(pair_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Opened, MapImages]:
    folder = shutil.copytree(pair_folder, tmp_path_factory.mktemp("pictured") / "case")
    opened = Opened(with_pixels(Path(folder) / "case.toml"))
    images = opened.block().images
    files = {image.name: (opened.pictures[image.name], image.lines, image.samples) for image in images}
    return opened, MapImages(opened, Tiles(files))


def shown_at(opened: Opened, image: int, places: Array) -> Array:
    """(n, 2) m on the map, of lines and samples (n, 2) of an image on the ground of a block without a terrain model."""
    block = opened.block()
    located = block.places[np.all(np.isfinite(block.places), axis=1)]
    height = float(np.median(geodetic(located, block.images[0].body)[:, 2]))
    return opened.map_places(block.images[image].image_to_ground(*places.T, height, block.corrections[image])[0])


def window(centre: Array, pixel: float) -> Array:
    """(4,) box of a tile's size."""
    return np.concatenate([centre - pixel * SIDE / 2.0, centre + pixel * SIDE / 2.0])


@pytest.mark.parametrize("image", [0, 1])
@pytest.mark.parametrize("zoom", [0.5, 1.0])
def test_a_pixel_of_the_map_shows_the_ground_of_the_image(
    pictured: tuple[Opened, MapImages], image: int, zoom: float
) -> None:
    """Grey values are those of the file at the place that the image's own intersection with the ground gives."""
    opened, images = pictured
    name = opened.block().images[image].name
    pixels = np.asarray(Image.open(opened.pictures[name]), dtype=np.float64)
    places = np.array([2500.0, 500.0]) + np.random.default_rng(4).uniform(-20.0, 20.0, (200, 2))
    places = np.floor(places) + 0.5  # middles of pixels
    plane = shown_at(opened, image, places)
    picture, spacing = images._tiles.picture(name), images._sizes[image]
    box = window(plane.mean(axis=0), zoom * spacing)
    grey = images.picture(box, (SIDE, SIDE), ["images"], name)
    at = np.column_stack([box[3] - plane[:, 1], plane[:, 0] - box[0]]) / (zoom * spacing) - 0.5
    found = grey[tuple(np.rint(at).astype(int).T)]
    expected = np.clip((pixels[tuple(places.astype(int).T)] - picture.low) / (picture.high - picture.low), 0, 1) * 255.0
    assert np.corrcoef(found, expected)[0, 1] > (0.95 if zoom == 0.5 else 0.8)  # the map's pixels lie between


@pytest.mark.parametrize("pixel", [3.0, 40.0])
def test_projections_between_the_nodes_are_right_to_half_a_pixel(
    pictured: tuple[Opened, MapImages], pixel: float
) -> None:
    opened, images = pictured
    box = window(shown_at(opened, 0, np.array([[2500.0, 500.0]]))[0], pixel)
    at = np.random.default_rng(5).uniform(0.0, SIDE, (400, 2))
    found = images.projections(0, box, np.full(2, pixel), at)
    ground = ground_at(opened, np.column_stack([box[0] + pixel * at[:, 1], box[3] - pixel * at[:, 0]]))
    exact = opened.block().images[0].ground_to_image(ground, opened.block().corrections[0])[0]
    inside = np.all(np.isfinite(found) & np.isfinite(exact), axis=1)
    assert inside.sum() > 50
    assert np.abs(found - exact)[inside].max() < 0.5 * pixel / images._sizes[0]


def test_the_image_on_top_hides_the_others_and_absent_pixels_are_said(pictured: tuple[Opened, MapImages]) -> None:
    opened, images = pictured
    names = [image.name for image in opened.block().images]
    box = window(opened.footprints()[0].mean(axis=0), 20.0)
    alone = []
    for name in names:
        files = {name: images._tiles.pictures[name]}
        alone.append(MapImages(opened, Tiles(files)).picture(box, (SIDE, SIDE), ["images"]))
    covered = [np.isfinite(grey) for grey in alone]
    assert (covered[0] & covered[1]).sum() > 1000
    for k, name in enumerate(names):
        both = images.picture(box, (SIDE, SIDE), ["images"], name)
        np.testing.assert_array_equal(both, np.where(covered[k], alone[k], alone[1 - k]))
    assert MapImages(opened, Tiles({})).record() == {"names": [], "count": 2, "unreadable": []}
    gone = MapImages(opened, Tiles({names[0]: (Path("gone.tif"), 5000, 1024)}))
    assert not np.any(np.isfinite(gone.picture(box, (SIDE, SIDE), ["images"])))
    assert len(gone.record()["unreadable"]) == 1


# --- graticule


@pytest.mark.parametrize("latitude", [-89.9, -45.0, 0.0, 30.0, 90.0])
@pytest.mark.parametrize("half", [2e3, 1e5, 2e6])
def test_lines_of_the_graticule_are_where_their_labels_say(latitude: float, half: float) -> None:
    """Anywhere on the body, near and at a pole, and across the meridian of 0 degrees."""
    centre = from_planetocentric(np.array([[0.01 * DEG, latitude * DEG, 3.39e6]]))[0]
    opened = SimpleNamespace(centre=centre, map_places=lambda points: plane_coordinates(points, centre))
    box = np.array([-half, -0.5 * half, half, 0.5 * half])
    lines = graticule(cast(Opened, opened), box)
    for is_meridian in (True, False):
        assert 1 <= sum(line["meridian"] == is_meridian for line in lines) <= 40
    for line in lines:
        value, _, side = line["label"].partition("°")
        places = np.array(line["places"])
        lonlat = planetocentric(places_at(places, centre))[:, :2] / DEG
        signed = float(value) * (-1.0 if side.strip() == "S" else 1.0)
        off = lonlat[:, 0] - signed if line["meridian"] else lonlat[:, 1] - signed
        off = np.mod(off + 180.0, 360.0) - 180.0 if line["meridian"] else off
        across = np.cos(lonlat[:, 1] * DEG) if line["meridian"] else 1.0
        assert np.abs(off * across * DEG * 3.39e6).max() < 0.05 + 1e-6 * half
    assert len({line["label"] for line in lines}) == len(lines)


# --- distances


def test_a_distance_has_the_sigmas_of_the_joint_covariance(solved: Path) -> None:
    opened = Opened(solved)
    posterior = Posterior.of(read_solution(solved / "solutions" / "0001"))
    ids = opened.block().network.points.ids
    first, second = (ids[k] for k in np.flatnonzero(np.isfinite(opened.block().places[:, 0]))[[0, 7]])
    expected = posterior.difference(first, second)
    nowhere = np.zeros((2, 2))
    found = distance(opened, (first, second), nowhere)
    assert found["distance_m"] == pytest.approx(expected.distance, rel=1e-9)
    assert found["distance_sigma_m"] == pytest.approx(expected.distance_sigma, rel=1e-6)
    assert found["height_difference_m"] == pytest.approx(expected.height, rel=1e-6)
    assert found["height_sigma_m"] == pytest.approx(expected.height_sigma, rel=1e-6)
    places = opened.map_places(opened.block().places[[ids.find([name])[0] for name in (first, second)]])
    free = distance(opened, ("", ""), places)
    assert "distance_sigma_m" not in free
    assert free["distance_m"] == pytest.approx(np.linalg.norm(places[1] - places[0]), rel=1e-3)
    with pytest.raises(InputError):
        distance(opened, ("nobody", first), nowhere)
    with pytest.raises(InputError):
        distance(opened, (first, first), nowhere)


def test_before_an_adjustment_no_distance_has_a_sigma(case_file: Path) -> None:
    opened = Opened(case_file)
    ids = opened.block().network.points.ids
    names = [ids[k] for k in np.flatnonzero(np.isfinite(opened.block().places[:, 0]))[:2]]
    assert "distance_sigma_m" not in distance(opened, (names[0], names[1]), np.zeros((2, 2)))


# --- in a real browser


@pytest.fixture
def seen(browser: Any, pictured_case: Path, tmp_path: Path) -> Iterator[Page]:
    folder = tmp_path / "project"
    assert call("project", "init", folder, "--case", pictured_case) == 0
    assert call("project", "solve", folder, "--no-figures") == 0
    with studio(folder, "--case", str(pictured_case)) as running:
        page = Page(browser, running)
        page.tab.set_viewport_size({"width": 1280, "height": 800})
        yield page
        page.close()


VIEW = "document.getElementById('map').view"


def test_texts_on_the_map_avoid_each_other_and_it_has_its_room(seen: Page) -> None:
    seen.until(f"{VIEW}.tiles.complete && {VIEW}.tiles.tiles.size > 0 && {VIEW}.layers.graticule")
    size = seen.run(f"[{VIEW}.canvas.clientWidth, {VIEW}.canvas.clientHeight]")
    assert size[0] * size[1] > 0.4 * 1280 * 800
    assert seen.run("document.documentElement.scrollHeight") <= 800
    assert seen.run(f"{VIEW}.frame.names.map(one => one[0])") == seen.run("studio.scene.images.map(one => one.name)")
    for k in range(6):
        seen.run(f"{VIEW}.zoom(1.3)")
        seen.tab.wait_for_timeout(250)
        boxes = np.array(seen.run(f"{VIEW}.frame.taken"))
        for one, box in enumerate(boxes):
            others = np.delete(boxes, one, axis=0)
            beside = (others[:, :2] >= box[2:]) | (others[:, 2:] <= box[:2])
            assert np.all(np.any(beside, axis=1)), k
        assert np.all((boxes[2:, :2] >= 0.0) & (boxes[2:, 2:] <= size))  # beside scale bar and arrow


def test_a_distance_by_keys_and_another_image_on_top(seen: Page) -> None:
    seen.run(f"{VIEW}.canvas.focus()")
    names = seen.run(f"{VIEW}.layers.points.names.slice(0, 2)")
    seen.tab.keyboard.press("d")
    for name in names:
        seen.run(
            f"one => {{ const [x, y] = {VIEW}.placeOf(one); Object.assign({VIEW}.view, {{x, y, scale: 1}}); }}", name
        )
        seen.tab.keyboard.press("Enter")
    assert seen.run(f"{VIEW}.distance.ends.map(one => one.name)") == names
    seen.until(f"!!{VIEW}.distance.ends[1].words")
    expected = seen.run("names => studio.request('/api/questions', {pairs: [names]})", names)[0]["record"]
    assert f"{expected['height_difference_m']:.2g}".lstrip("-")[:3] in seen.run(f"{VIEW}.distance.words.textContent")
    seen.tab.keyboard.press("Escape")
    assert not seen.run(f"{VIEW}.distance.on")
    seen.until(f"{VIEW}.tiles.complete && {VIEW}.tiles.tiles.size > 0")
    picture = f"() => {VIEW}.canvas.toDataURL()"
    before = seen.run(picture)
    seen.tab.select_option("select[title^=Where]", index=2)
    seen.until(f"before => {VIEW}.tiles.complete && {VIEW}.canvas.toDataURL() !== before", before)
