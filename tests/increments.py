"""Images that are added one at a time, and what the result is measured against: batch over the same observations."""

from dataclasses import replace
from functools import cache

import numpy as np

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.incremental.impact import Impact
from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.network import Network
from mgsgraph.network.parts import KnownImage, Unknown, without_images
from mgsgraph.simulation.strip import SimulatedStrip, StripSettings, simulate_strip
from mgsgraph.ties import TiePoints

Places = dict[str, tuple[np.ndarray, np.ndarray]]
"""Place (3,) in m and covariance (3, 3) in m^2 of points by name."""


@cache
def strip(images: int = 6, ties: int = 12, shots: int = 5) -> SimulatedStrip:
    """A short strip; every image shares ground with two or three others."""
    return simulate_strip(StripSettings(images=images, ties=ties, shots=shots), seed=3)


def prior(made: SimulatedStrip) -> OrientationPrior:
    """What the strip's corrections were drawn from."""
    return made.settings.noise.prior


def take(adjustment: IncrementalAdjustment, made: SimulatedStrip, k: int) -> Impact:
    """The strip's next step."""
    step, noise = made.addition(k), made.settings.noise
    observations = [one for one in (step.ties, step.laser) if one is not None]
    return adjustment.add(step.image, observations, noise.prior, noise.tie, noise.shot_image)


def grown(made: SimulatedStrip, count: int) -> IncrementalAdjustment:
    """The strip's first images, added one at a time."""
    adjustment = IncrementalAdjustment()
    for k in range(count):
        take(adjustment, made, k)
    return adjustment


def own_measures(made: SimulatedStrip, image: str) -> list[TiePoints | LaserProfile]:
    """What one image of a strip sees, whatever the others: measures in it alone, and its own shots' ranges."""
    return [_own_ties(made.ties, image), *(_own_shots(laser, image) for laser in made.lasers)]


def _own_ties(ties: TiePoints, image: str) -> TiePoints:
    rows = np.flatnonzero(np.array(ties.measure_image) == image)
    kept, point = np.unique(ties.measure_point[rows], return_inverse=True)
    return replace(
        ties, ids=tuple(ties.ids[i] for i in kept), kinds=ties.kinds[kept], places=ties.places[kept],
        covariances=ties.covariances[kept], measure_point=point, measure_image=(image,) * rows.size,
        measures=ties.measures[rows], measure_sigmas=ties.measure_sigmas[rows],
    )  # fmt: skip


def _own_shots(laser: LaserProfile, image: str) -> LaserProfile:
    rows = np.flatnonzero(np.array(laser.measure_image) == image)
    return replace(
        laser, measure_shot=laser.measure_shot[rows], measure_image=(image,) * rows.size, measures=laser.measures[rows],
        simultaneous=tuple((image,) if image in names else () for names in laser.simultaneous),
    )  # fmt: skip


def by_image(network: Network) -> list[Network]:
    """A network taken apart: what each image sees by itself. Images that see nothing go with the first."""
    names = {image.name for image in network.images}
    parts = [without_images(network, names - {image.name}) for image in network.images]
    return [one for one in parts if one is not None]


def known_images(network: Network) -> list[KnownImage]:
    """The images of a network."""
    return [KnownImage(*one) for one in zip(network.images, network.priors, network.held.tolist(), strict=True)]


def places_of(adjustment: IncrementalAdjustment) -> Places:
    """All points, refreshed."""
    ids, places, covariances = adjustment.points()
    return {name: (place, spread) for name, place, spread in zip(ids, places, covariances, strict=True)}


def values_of(adjustment: IncrementalAdjustment) -> dict[str, np.ndarray]:
    """Orientation coefficients (d,) of all images."""
    return {name: adjustment.correction(name).coefficients.ravel() for name in adjustment.images}
