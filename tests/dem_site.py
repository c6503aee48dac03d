"""A part of the simulated Gusev pair, adjusted, with dense matches as an adjusted orientation would give them over the
true ground: what is wrong with a terrain model of them is the noise that was added.
"""

import atexit
import shutil
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
from numpy.typing import NDArray
from once import once
from sites import plain_site

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.case.reading import read_case
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.matching.dense import DenseMatches
from mgsgraph.matching.scene import Ground, GroundChart, Picture, Scene
from mgsgraph.registration.dem.gridding import MapGrid
from mgsgraph.registration.dem.ortho import adjusted_scene
from mgsgraph.results.archive import write_archive
from mgsgraph.simulation.files import write_site
from mgsgraph.simulation.site import SimulatedSite

Array = NDArray[np.float64]

HEIGHT = -2580.0
"""m above the ellipsoid, about."""
LINES = (3000.0, 3400.0)
"""Of the first image, that are matched."""
STEP = 5.0
"""pixels between anchors."""
NOISE = np.array([[0.0036, 0.002], [0.002, 0.0121]])
"""pixels^2, covariance of a match."""
CHECK_EVERY = 5
"""Laser shots that are kept out."""


def site() -> SimulatedSite:
    """Geometry alone: its pictures are of one grey."""
    return plain_site()


@cache
def case_path() -> Path:
    """The site's case, every fifth shot of its profiles a check point; for reading only."""
    folder = Path(mkdtemp(prefix="mgsgraph-dem-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    path = write_site(site(), folder / "site")
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("[[shots]]\n", f"[[shots]]\ncheck_every = {CHECK_EVERY}\n"), encoding="utf-8")
    return path


@once
def solution() -> Solution:
    """Adjusted."""
    case = read_case(case_path())
    return adjust_network(case.network, case.settings, case.name)


@cache
def result() -> Path:
    """Its archive."""
    path = case_path().with_name("solution.npz")
    write_archive(solution(), path)
    return path


@cache
def posterior() -> Posterior:
    return Posterior.of(solution())


def textured(lines: int, samples: int) -> NDArray[np.uint8]:
    """A picture whose grey values say where they are: 1 .. 254, a ramp over the lines, steeper over the samples."""
    line, sample = np.mgrid[:lines, :samples]
    return (1 + (line // 16 + sample // 4) % 254).astype(np.uint8)


@cache
def scene() -> Scene:
    """The pair as adjusted over level ground."""
    images = posterior().network.images
    priors = OrientationPrior(np.ones((1, 6)))
    pictures = tuple(Picture(image, textured(image.lines, image.samples), priors) for image in images)
    middle = [image.image_to_ground(np.array([3200.0]), np.array([512.0]), HEIGHT)[0] for image in images]
    chart = GroundChart.about(np.concatenate(middle), np.array([0.0, 0.0, 1.0]))
    return adjusted_scene(Scene(pictures, Ground(chart, images[0].body, HEIGHT, 100.0)), posterior())


@cache
def anchors() -> Array:
    """(n, 2) middles of pixels."""
    line, sample = np.meshgrid(np.arange(*LINES, STEP), np.arange(20.0, 1004.0, STEP), indexing="ij")
    return np.column_stack([line.ravel(), sample.ravel()]) + 0.5


def matched(rng: np.random.Generator | None, first: int = 0, of: Scene | None = None) -> DenseMatches:
    """Matches of the true ground with noise; of one picture with the other, none of them outside."""
    one, other = ((of or scene()).pictures[j] for j in (first, 1 - first))
    points = ground(one, anchors())
    places = other.project(points)
    inside = np.all((places > 0.5) & (places < np.array([other.image.lines, other.image.samples]) - 0.5), axis=1)
    noise = np.zeros((inside.sum(), 2)) if rng is None else rng.multivariate_normal(np.zeros(2), NOISE, inside.sum())
    covariances = np.broadcast_to(NOISE, (inside.sum(), 2, 2))
    return DenseMatches(
        first, 1 - first, 20.0, len(points), anchors()[inside], places[inside] + noise, covariances,
        np.full(inside.sum(), 0.9),
    )  # fmt: skip


def ground(picture: Picture, places: Array) -> Array:
    """(n, 3) m, true ground under places (n, 2)."""
    return site().terrain.intersect(*picture.image.sightlines(places[:, 0], places[:, 1], picture.correction))


def true_heights(grid: MapGrid) -> Array:
    """(rows, columns) m above the sphere, of the true ground at the posts of a map."""
    longitude, latitude, _ = planetocentric(grid.points(grid.posts(), np.zeros(grid.rows * grid.columns))).T
    return (site().terrain.ground_radius(longitude, latitude) - grid.radius).reshape(grid.rows, grid.columns)
