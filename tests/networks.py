"""Small networks of the simulated pair, as an adjustment takes them."""

from dataclasses import replace
from functools import cache

import numpy as np

from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, Ranges
from mgsgraph.simulation.pair import NoiseSettings, PairSettings, SimulatedPair, simulate_pair
from mgsgraph.ties import PointKind


@cache
def pair(ties: int = 12, shots: int = 6, seed: int = 1, noise: NoiseSettings | None = None) -> SimulatedPair:
    """A simulated pair, small enough for the explicit form."""
    settings = PairSettings(ties=ties, shots=shots)
    return simulate_pair(settings if noise is None else replace(settings, noise=noise), seed=seed)


def network(pair: SimulatedPair, held: tuple[bool, bool] = (False, False), laser: bool = True) -> Network:
    """The pair's observations with the sigmas that they were drawn from."""
    noise, ties, shots = pair.settings.noise, pair.ties, pair.laser
    index = {image.name: j for j, image in enumerate(pair.images)}
    n, m = len(ties.ids), len(shots.ids) if laser else 0
    points = GroundPoints(
        ties.ids + shots.ids[:m],
        np.repeat([PointClass.TIE, PointClass.LASER], [n, m]),
        np.repeat([PointKind.FREE, PointKind.CONSTRAINED], [n, m]),
        np.concatenate([ties.places, shots.footprints[:m]]),
        np.concatenate([ties.covariances, shots.covariances[:m]]),
    )
    mine = np.arange(shots.measure_shot.size if laser else 0)
    rays = ImageRays(
        np.concatenate([ties.measure_point, shots.measure_shot[mine] + n]),
        np.array([index[name] for name in ties.measure_image + tuple(shots.measure_image[k] for k in mine)]),
        np.concatenate([ties.measures, shots.measures[mine]]),
        np.concatenate([np.full_like(ties.measures, noise.tie), np.full((mine.size, 2), noise.shot_image)]),
    )
    ranges = Ranges(
        np.arange(n, n + m), np.zeros(m, dtype=int), shots.times[:m], shots.ranges[:m], shots.range_sigmas[:m]
    )
    priors: tuple[OrientationPrior, ...] = (noise.prior, noise.prior)
    return Network(pair.images, priors, np.array(held), points, rays, ranges)
