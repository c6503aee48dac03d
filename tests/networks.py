"""Small networks of the simulated pair, as an adjustment takes them."""

from dataclasses import replace
from functools import cache

import numpy as np

from mgsgraph.adjustment.factor_graph import nominal_selection
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.altimetry import with_common_errors
from mgsgraph.geometry.body import from_planetocentric, intersect_ellipsoid, planetocentric
from mgsgraph.geometry.orientation import OrientationPrior, evenly_spaced
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import Gaps, TerrainGrid
from mgsgraph.network import (
    GroundPoints,
    ImageRays,
    Network,
    NodePrior,
    Pass,
    PassPrior,
    PointClass,
    ProfileShifts,
    Ranges,
    Surface,
)
from mgsgraph.network.common import common_heights, common_matches
from mgsgraph.simulation.ground import sine_height
from mgsgraph.simulation.observations import NoiseSettings
from mgsgraph.simulation.orbit import MARS
from mgsgraph.simulation.pair import PairSettings, SimulatedPair, simulate_pair


@cache
def pair(ties: int = 12, shots: int = 6, seed: int = 1, noise: NoiseSettings | None = None) -> SimulatedPair:
    """A simulated pair, small enough for the explicit form."""
    settings = PairSettings(ties=ties, shots=shots)
    return simulate_pair(settings if noise is None else replace(settings, noise=noise), seed=seed)


def with_shift_and_surface(net: Network, sigma: float = 60.0) -> Network:
    """The same with an unknown shift of its laser profile, its tie points on a rough terrain model that may shift."""
    laser = net.points.classes == PointClass.LASER
    shifts = ProfileShifts(("profile",), np.where(laser, 0, -1), np.array([sigma]))
    return replace(net, shifts=shifts, surface=Surface(terrain(net), np.where(laser, np.inf, 25.0), 150.0))


def with_tilting_surface(net: Network) -> Network:
    """The same, and the terrain model's height and tilt are unknown, too."""
    net = with_shift_and_surface(net)
    assert net.surface is not None
    middle = np.nanmean(net.points.places, axis=0)
    return replace(net, surface=replace(net.surface, height_sigma=40.0, tilt_sigma=2e-4, middle=middle))


def with_echoes(net: Network, share: float = 1.5) -> Network:
    """The same with an error that each range has in common with its footprint, of so many of its own sigmas."""
    points, ranges = net.points, net.ranges
    beams = points.places[ranges.point].copy()
    for j in np.unique(ranges.image).tolist():
        mine, trajectory = ranges.image == j, net.images[j].trajectory
        beams[mine] -= trajectory.pose(ranges.times[mine] - trajectory.epoch).position
    errors = share * ranges.sigmas[:, None] * beams / np.linalg.norm(beams, axis=1, keepdims=True)
    covariances = points.covariances.copy()
    sigmas, covariances[ranges.point], shares = with_common_errors(ranges.sigmas, covariances[ranges.point], errors)
    return replace(
        net, points=replace(points, covariances=covariances), ranges=replace(ranges, sigmas=sigmas, shares=shares)
    )


def with_neighbors(net: Network, side: float = 400.0, reach: float = 3000.0) -> Network:
    """The same with errors that ties within windows of some pixels, and points on its terrain model within a gap of
    some m, have in common.
    """
    ties = net.points.classes[net.rays.point] == PointClass.TIE
    rays, of_rays = common_matches(net.rays, np.where(ties, side, 0.0), np.full(ties.size, 0.9))
    net, surface, of_heights = replace(net, rays=rays, common_rays=of_rays), net.surface, None
    if surface is not None:
        gaps = (np.full(surface.grid.radii.shape, size) for size in (20.0, reach))
        surface = replace(surface, grid=replace(surface.grid, vertical_sigma=10.0, gaps=Gaps(*gaps)))
        surface, of_heights = common_heights(surface, nominal_selection(net).places)
    return replace(net, surface=surface, common_heights=of_heights)


def terrain(net: Network) -> TerrainGrid:
    """Posts every 0.02 degrees around the network's points, of the simulated relief with errors of some metres."""
    longitude, latitude, _ = planetocentric(net.points.places[np.isfinite(net.points.places[:, 0])]).T
    step, half = np.radians(0.02), 40
    first = longitude.mean() - half * step, latitude.mean() + half * step
    places = np.meshgrid(first[0] + step * np.arange(2 * half), first[1] - step * np.arange(2 * half))
    ground = from_planetocentric(np.stack([*places, np.full_like(places[0], MARS.equatorial)], axis=-1).reshape(-1, 3))
    surface, _, _ = intersect_ellipsoid(ground * 2.0, -ground, MARS, 0.0)
    heights = sine_height(surface, 120.0) + np.random.default_rng(3).normal(0.0, 10.0, ground.shape[0])
    radii = np.linalg.norm(surface, axis=1) + heights
    return TerrainGrid("made by the test", radii.reshape(places[0].shape), *first, step, step)


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


NODES = NodePrior(
    np.array([80.0] * 3 + [2e-4] * 3), np.array([200.0] * 3 + [4e-4] * 3), np.array([50.0] * 3 + [1e-4, 0.0, 1e-4]), 4.0
)
"""A pass whose nodes depart from a bias and a drift."""


def on_passes(
    net: Network, prior: PassPrior = NODES, intervals: int = 6, mounted: dict[int, Array] | None = None
) -> Network:
    """Each image on a pass of its own with so many intervals between its nodes; axes (3, 3) in which images are mounted
    otherwise than along those of their pass.
    """
    passes = []
    for j, image in enumerate(net.images):
        start, stop = image.timing.at(np.array([0.0, float(image.lines)]))[0]
        nodes = evenly_spaced("lagrange", image.trajectory.epoch, (start, stop), (stop - start) / intervals)
        axes = None if mounted is None or j not in mounted else mounted[j][None]
        passes.append(Pass(image.name, np.array([j]), nodes, prior, axes))
    return replace(net, passes=tuple(passes))
