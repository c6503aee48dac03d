"""A small simulated pair over level ground whose grey values are known, with tie points that are exactly right."""

from dataclasses import replace
from functools import cache

import numpy as np

from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.simulation.observations import free_points
from mgsgraph.simulation.pair import PairSettings, simulate_pair

PAIR = simulate_pair(PairSettings(lines=500, samples=400, ties=1, shots=1), seed=3)


def grey(points: np.ndarray) -> np.ndarray:
    """Grey values of ground points (n, 3): waves of 20 to 90 m."""
    longitude, latitude, radius = planetocentric(points).T
    x, y = longitude * radius, latitude * radius
    waves = ((0.31, 0.12, 30.0), (-0.07, 0.21, 25.0), (0.09, 0.08, 20.0), (0.02, -0.16, 15.0))
    return np.asarray(128.0 + sum(size * np.sin(a * x + b * y + size) for a, b, size in waves))


@cache
def picture(number: int) -> np.ndarray:
    """Pixels (lines, samples) of an image of the pair over level ground."""
    image = PAIR.images[number]
    line, sample = np.mgrid[0 : image.lines, 0 : image.samples] + 0.5
    return grey(image.image_to_ground(line.ravel(), sample.ravel())[0]).reshape(image.lines, image.samples)


def ties_at(places: np.ndarray, images: tuple[PushbroomImage, ...] = PAIR.images) -> TiePoints:
    """Points at places (n, 2) of the first image on level ground, measured without error in all."""
    ground = images[0].image_to_ground(*places.T)[0]
    measured = np.stack([image.ground_to_image(ground)[0] for image in images], axis=1)
    n, k = len(places), len(images)
    names = tuple(image.name for image in images) * n
    return free_points("test", tuple(f"P{i}" for i in range(n)), np.repeat(np.arange(n), k), names,
                       measured.reshape(-1, 2), 0.5)  # fmt: skip


def inner(count: int, seed: int = 1) -> np.ndarray:
    """Places (n, 2) whose chips lie inside both images."""
    found = np.random.default_rng(seed).uniform([120.0, 110.0], [380.0, 290.0], (5 * count, 2))
    other = ties_at(found).measures[1::2]
    return found[np.all((other > 110.0) & (other < np.array([390.0, 290.0])), axis=1)][:count]


def moved(ties: TiePoints, rows: np.ndarray, by: np.ndarray) -> TiePoints:
    measures = ties.measures.copy()
    measures[rows] += by
    return replace(ties, measures=measures)
