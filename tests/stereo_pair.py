"""The simulated pair with the surface that its images show, and its laser profile, displaced, on that surface."""

from dataclasses import replace

import numpy as np
from networks import network, pair
from once import once

from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.stereo_surface import StereoSurface, averaged_surface, heights_above
from mgsgraph.network import Network, PointClass, ProfileShifts
from mgsgraph.network.records import StereoControl
from mgsgraph.simulation.ground import rays_to_sines
from mgsgraph.simulation.observations import NoiseSettings
from mgsgraph.simulation.pair import SimulatedPair

SHIFT = 60.0
"""m, a-priori sigma of a profile's shift."""
NOISE = 0.05
"""pixels, of a dense match."""


def surface(made: SimulatedPair) -> StereoSurface:
    """What dense matches of the pair give, every 12 pixels: whatever its ties and shots are."""
    noise = made.settings.noise
    return _surface(made.seed, noise.position, noise.angle, noise.trend)


@once
def _surface(seed: int, position: float, angle: float, trend: tuple[float, ...]) -> StereoSurface:
    made = pair(seed=seed, noise=NoiseSettings(position=position, angle=angle, trend=trend))
    first, second = made.images
    grid = np.meshgrid(np.arange(6.5, first.lines, 12.0), np.arange(6.5, first.samples, 12.0), indexing="ij")
    anchors = np.stack([part.ravel() for part in grid], axis=1)
    ground = rays_to_sines(first, made.true_corrections[0], *anchors.T, made.settings.relief)
    places, _ = second.ground_to_image(ground, made.true_corrections[1])
    seen = np.all((places > 0.0) & (places < [second.lines, second.samples]), axis=1)
    places = places[seen] + np.random.default_rng(made.seed).normal(0.0, NOISE, (int(seen.sum()), 2))
    pixel = np.linalg.norm(np.diff(ground[[0, 1]], axis=0)) / 12.0
    variances = np.full(len(places), NOISE**2)
    return averaged_surface(anchors[seen], places, variances, np.full(2, pixel), 40.0, 12.0 * pixel)


def on_surface(net: Network, made: SimulatedPair) -> Network:
    """The pair's network with the laser points that the surface covers on it."""
    laser = np.flatnonzero(net.points.classes == PointClass.LASER)
    found = heights_above(surface(made), *made.images, made.true_footprints[: laser.size], made.true_corrections)
    on = np.full(len(net.points), -1)
    on[laser[found.covered]] = 0
    return replace(net, stereo=StereoControl((surface(made),), np.array([[0, 1]]), on, np.full(on.size, 1.0)))


def stereo_network(made: SimulatedPair, displaced: bool = True, laser_rays: bool = False) -> Network:
    """The same with the laser profile displaced as a whole."""
    net = network(made)
    laser = net.points.classes == PointClass.LASER
    rng = np.random.default_rng([made.seed, 7])
    move = np.where(laser[:, None], np.einsum("k,nkj->nj", rng.normal(0.0, SHIFT, 2), _ways(net)), 0.0)
    places = net.points.places - (move if displaced else 0.0)
    shifts = ProfileShifts(("profile",), np.where(laser, 0, -1), np.array([SHIFT]))
    rays = net.rays if laser_rays else net.rays.chosen(~laser[net.rays.point])
    return on_surface(replace(net, points=replace(net.points, places=places), shifts=shifts, rays=rays), made)


def _ways(net: Network) -> np.ndarray:
    return east_north(np.nan_to_num(net.points.places, nan=1.0))
