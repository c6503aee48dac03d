"""Networks to plan for, and candidates that are really added to them: the same geometry, measures with noise."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
from increments import NOISE, network_of, strip
from once import once

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.orientation import OrientationCorrection, OrientationPrior
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network
from mgsgraph.network.parts import KnownImage, joined
from mgsgraph.planning.candidates import Candidate, PlannedTies, planned_image
from mgsgraph.planning.coverage import ImageCoverage
from mgsgraph.planning.state import NetworkState, state_of_solution
from mgsgraph.simulation.strip import SimulatedStrip

SMALL = 0.02
"""Share of the usual sigmas that a well-known orientation has."""


@cache
def made(images: int = 11) -> SimulatedStrip:
    """A strip, of which the first images are there and the others are candidates."""
    return strip(images, 40, 6)


@once
def solved(images: int = 8) -> Solution:
    """The first images, adjusted."""
    return adjust_network(network_of(made(), range(images)), SolverSettings())


@cache
def coverage(images: int = 8) -> ImageCoverage:
    """Their ground."""
    return ImageCoverage(state_of_solution(solved(images)))


def state(images: int = 8) -> NetworkState:
    """Where they stand."""
    return coverage(images).state


@cache
def candidate(k: int, count: int = 12, existing: bool = False, images: int = 8, sigma: float = NOISE.tie) -> Candidate:
    """One of the strip's other images."""
    ties = PlannedTies(count, sigma=sigma, existing=existing)
    return planned_image(coverage(images), KnownImage(made().images[k], NOISE.prior), ties)


def well_known(k: int, existing: bool = False) -> tuple[Candidate, dict[str, OrientationCorrection]]:
    """The same with an orientation that is known fifty times better, so that it does much; and all true corrections."""
    prior = OrientationPrior(NOISE.prior.sigmas * SMALL)
    image, true = made().images[k], truth(made())
    ties = PlannedTies(12, sigma=NOISE.tie, existing=existing)
    corrections = true | {image.name: OrientationCorrection(true[image.name].coefficients * SMALL)}
    return planned_image(coverage(), KnownImage(image, prior), ties), corrections


def addition(chosen: Candidate) -> Network:
    """Its measures, of which it has some."""
    assert chosen.addition is not None
    return chosen.addition


def truth(simulated: SimulatedStrip) -> dict[str, OrientationCorrection]:
    """True corrections of all images."""
    return {image.name: true for image, true in zip(simulated.images, simulated.true_corrections, strict=True)}


def measured(
    planned: Network, true: Mapping[str, OrientationCorrection], places: Mapping[str, Array], seed: int = 1
) -> Network:
    """Planned measures as they would really be had: the ground seen with the true orientation, and noise.

    `places` are true places (3,) in m of points by name; new points are where they were planned.
    """
    rng = np.random.default_rng(seed)
    ground = np.array([
        places.get(name, place) for name, place in zip(planned.points.ids, planned.points.places, strict=True)
    ])
    seen = planned.rays.places.copy()
    for j, image in enumerate(planned.images):
        mine = planned.rays.image == j
        seen[mine], _ = image.ground_to_image(ground[planned.rays.point[mine]], true[image.name])
    seen += planned.rays.sigmas * rng.standard_normal(seen.shape)
    values = planned.ranges.values.copy()
    for j, image in enumerate(planned.images):
        mine = planned.ranges.image == j
        lines = image.timing.lines(planned.ranges.times[mine] - image.trajectory.epoch)
        eye = image.pose(lines, true[image.name]).position
        values[mine] = np.linalg.norm(eye - ground[planned.ranges.point[mine]], axis=1)
    values += planned.ranges.sigmas * rng.standard_normal(values.size)
    return replace(
        planned,
        rays=replace(planned.rays, places=seen),
        ranges=replace(planned.ranges, values=values),
    )


def really(solution: Solution, planned: Network, true: Mapping[str, OrientationCorrection], seed: int = 1) -> Solution:
    """Batch over everything, the planned measures really taken."""
    simulated = made()
    places = dict(zip(simulated.ties.ids, simulated.true_ties, strict=True))
    return adjust_network(joined([solution.network, measured(planned, true, places, seed)]), solution.settings)


def totals(solution: Solution, names: tuple[str, ...]) -> Array:
    """(n,) m, roots of the traces of the points' covariances."""
    place = {name: i for i, name in enumerate(solution.network.points.ids)}
    chosen = [place[name] for name in names]
    return np.asarray(np.sqrt(np.trace(solution.covariances[chosen], axis1=1, axis2=2)))
