"""The first lines of the simulated Gusev pair with pixels and truth: small enough to be matched in a test."""

import itertools
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from once import once
from sites import plain_site

from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection, OrientationPrior
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.matching.match import Matches, match_scene
from mgsgraph.matching.scene import Ground, GroundChart, Picture, Scene
from mgsgraph.matching.settings import MatchSettings
from mgsgraph.simulation.files import write_site
from mgsgraph.simulation.imagery import render
from mgsgraph.simulation.site import SimulatedImage, SimulatedSite
from mgsgraph.units import ARCMIN

Array = NDArray[np.float64]

LINES = 640
HEIGHT = -2580.0
"""m, of the site."""
SETTINGS = MatchSettings(cells=60, features=2500)
DISTURBED = OrientationCorrection(np.array([[60.0, -80.0, 20.0, 1e-4, -1.5e-4, 2e-4]]))
"""Of the third picture."""


@once
def site(lines: int = LINES) -> SimulatedSite:
    """The pair, both images cut after their first lines, which show the same ground, and rendered."""
    whole = plain_site("gusev", 1, "published")
    first, second = (_cut(whole, image, k, lines) for k, image in enumerate(whole.images))
    return replace(whole, images=(first, second))


def _cut(whole: SimulatedSite, image: SimulatedImage, seed: int, lines: int) -> SimulatedImage:
    true = replace(image.true, lines=lines)
    pixels = render(true, whole.terrain, None, image.sun, np.random.default_rng(seed))
    return replace(image, true=true, nominal=replace(image.nominal, lines=lines), pixels=pixels)


@cache
def truth() -> dict[str, PushbroomImage]:
    """Images as they were taken, by name; the third is the first over again."""
    first, second = (image.true for image in site().images)
    again = replace(first, name=f"{first.name}B")
    return {one.name: one for one in (first, second, again)}


def prior(metres: float) -> OrientationPrior:
    """Of an image: so many metres, and the angle that is as much on the ground."""
    return OrientationPrior(np.outer([1.0, 0.1, 0.01], [metres] * 3 + [metres / 100.0 * ARCMIN] * 3))


def ground(terrain: TerrainGrid | None, sigma: float = 100.0) -> Ground:
    """Under the pair."""
    images = list(truth().values())
    places = np.concatenate([_corners(image) for image in images])
    flight = images[0].pose(np.array([0.5 * LINES])).velocity[0]
    chart = GroundChart.about(places, flight)
    return Ground(chart, images[0].body, HEIGHT, sigma, None if terrain is None else terrain.around(places))


def _corners(image: PushbroomImage) -> Array:
    lines, samples = np.meshgrid([0.0, 0.5 * image.lines, image.lines], [0.0, float(image.samples)])
    return image.image_to_ground(lines.ravel(), samples.ravel(), HEIGHT)[0]


@cache
def scene(count: int = 2) -> Scene:
    """Two or three pictures as kernels have them, over the terrain model 200 m off."""
    images = site().images
    pictures = [Picture(image.nominal, image.pixels, prior(100.0 * (k + 1))) for k, image in enumerate(images)]
    third = list(truth().values())[2]
    if count > 2:
        pixels = render(third, site().terrain, None, images[0].sun, np.random.default_rng(9))
        pictures.append(Picture(replace(images[0].nominal, name=third.name), pixels, prior(100.0), DISTURBED))
    return Scene(tuple(pictures), ground(site().grid))


@cache
def true_scene() -> Scene:
    """The pair as it was taken, over the true ground."""
    pictures = [Picture(image.true, image.pixels, prior(100.0)) for image in site().images]
    return Scene(tuple(pictures), ground(true_terrain()))


@cache
def true_terrain(step: float = 5e-4, margin: float = 0.02) -> TerrainGrid:
    """Posts of the true ground every 30 m (degrees), with so much around the images (degrees)."""
    places = np.concatenate([_corners(image) for image in truth().values()])
    longitude, latitude, _ = np.degrees(planetocentric(places)).T
    east = np.arange(longitude.min() - margin, longitude.max() + margin, step)
    south = np.arange(latitude.max() + margin, latitude.min() - margin, -step)
    lon, lat = np.radians(np.meshgrid(east, south))
    radii = site().terrain.ground_radius(lon.ravel(), lat.ravel()).reshape(lon.shape)
    return TerrainGrid("made by the test", radii, *np.radians([east[0], south[0], step, step]))


def matches(count: int = 2) -> Matches:
    """What is found in them."""
    return _matches(count)


@once
def _matches(count: int) -> Matches:
    return match_scene(scene(count), SETTINGS if count == 2 else replace(SETTINGS, features=1200))


def true_places(name: str, places: Array, other: str) -> Array:
    """(n, 2) where the ground under places (n, 2) of an image truly is on another."""
    points = site().terrain.intersect(*truth()[name].sightlines(places[:, 0], places[:, 1]))
    return truth()[other].ground_to_image(points)[0]


def errors(found: Matches) -> Array:
    """(k, 2) pixels, by which each measure but the references lies off its true place, given the reference."""
    ties, reference = found.ties, found.reference
    first = np.empty(len(ties.ids), dtype=np.int64)
    first[ties.measure_point[reference]] = np.flatnonzero(reference)
    others = np.flatnonzero(~reference)
    anchors, off = first[ties.measure_point[others]], np.empty((others.size, 2))
    images = np.array(ties.measure_image)
    for one, other in itertools.permutations(truth(), 2):
        mine = (images[anchors] == one) & (images[others] == other)
        off[mine] = ties.measures[others[mine]] - true_places(one, ties.measures[anchors[mine]], other)
    return off


@cache
def inner(count: int = 200, seed: int = 1) -> Array:
    """(n, 3) m, points of the true ground that both images see."""
    first, second = (image.true for image in site().images)
    drawn = np.random.default_rng(seed).uniform(20.0, np.array([LINES, first.samples]) - 20.0, (4 * count, 2))
    points = site().terrain.intersect(*first.sightlines(drawn[:, 0], drawn[:, 1]))
    places = second.ground_to_image(points)[0]
    seen = np.all((places > 20.0) & (places < np.array([LINES, second.samples]) - 20.0), axis=1)
    return points[seen][:count]


def write_without_ties(folder: Path) -> Path:
    """The same, whose ties are still to be found."""
    case = write(folder)
    head, _, rest = case.read_text(encoding="utf-8").partition("[ties]")
    case.write_text(head + rest[rest.index("\n[") :], encoding="utf-8")
    (folder / "network.pvl").unlink()
    return case


def write(folder: Path) -> Path:
    """The pair as files, in the formats of the archive; its case."""
    return write_site(site(), folder)
