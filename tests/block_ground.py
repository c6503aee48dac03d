"""The ground under simulated HRSC blocks and CTX pairs, a terrain model of it, and networks of ties alone upon it."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import in_turn, planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.names import Names
from mgsgraph.network import (
    GroundPoints,
    ImageRays,
    Network,
    NodePrior,
    Pass,
    PointClass,
    ProcessPrior,
    Ranges,
    Surface,
)
from mgsgraph.network.common import CommonErrors, common_heights
from mgsgraph.record import Record
from mgsgraph.simulation.ground import SiteGround, SiteTerrain, cell_means, posts_between, simulated_grid
from mgsgraph.simulation.orbit import MARS
from mgsgraph.simulation.relief import PeriodicSurface, fractal
from mgsgraph.units import DEG

_LEVEL = -1500.0
"""m, mean height of the ground under a block above the ellipsoid."""
_COARSE, _FINE = 1000.0, 50.0
"""m between the coefficients of a block's relief and detail."""
_ROUGHNESS, _HURST = 600.0, 0.6
"""m rms of a block's relief, over 1024 km, and its Hurst exponent; chosen (see `block_terrain`), not fitted to Mars."""
_DETAIL, _DETAIL_HURST = 15.0, 0.2
"""m rms of a block's detail, over 51 km, and its exponent."""
_PARTS = 3
"""Points along and across a grid's cell whose mean is its post."""
_BEYOND = 6
"""Posts by which a grid reaches beyond its points."""


@lru_cache(maxsize=2)
def block_terrain(longitude: float, latitude: float, seed: int) -> SiteTerrain:
    """True ground about a longitude and latitude in rad; the same ones and the same seed give the same ground.

    The relief is fractal down to a kilometre and doesn't repeat itself within a block; a finer one lies over it.
    Amplitudes are such that a grid of 1/64 degree tells the ground to some 7 m between its posts (rms), so that with
    the posts' noise of 10 m a point lies 10 m off it, rms; slopes are 2 degrees at the posts' distance: what a shift of
    the grid shows by.
    """
    of_relief, of_detail = np.random.default_rng(seed).spawn(2)
    ground = SiteGround(longitude, latitude, _LEVEL, 0.0, _ROUGHNESS, _HURST, 0.0, 0.0, 0.0, 0.0)
    return SiteTerrain(
        site="block",
        seed=seed,
        ellipsoid=MARS,
        centre_lon=longitude,
        centre_lat=latitude,
        ground=ground,
        waves=np.zeros((0, 4)),
        relief=PeriodicSurface(_COARSE, np.float32(_ROUGHNESS) * fractal((4096, 1024), _HURST, of_relief)),
        detail=PeriodicSurface(_FINE, np.float32(_DETAIL) * fractal((1024, 1024), _DETAIL_HURST, of_detail)),
        brightness=PeriodicSurface(_FINE, np.ones((1, 1), dtype=np.float32)),
    )


def block_grid(
    terrain: SiteTerrain,
    points: Array,
    ppd: int,
    noise: float,
    shift: Array,
    missing: float,
    rng: np.random.Generator,
) -> TerrainGrid:
    """A grid under the points (n, 3) of a block, m, body-fixed, and some posts beyond.

    Its content lies off the truth by `shift` (2,) m east and north; each post has noise of `noise` m rms, and the share
    `missing` of them is NaN.
    """
    lon, lat, _ = planetocentric(points).T
    covered = np.stack([in_turn(lon, terrain.centre_lon), lat])
    beyond = _BEYOND * DEG / ppd
    lon, lat = posts_between(covered.min(axis=1) - beyond, covered.max(axis=1) + beyond, DEG / ppd)
    radii = cell_means(terrain, lon, lat, DEG / ppd, shift, _PARTS)
    radii += noise * rng.standard_normal(radii.shape)
    radii[rng.random(radii.shape) < missing] = np.nan
    return simulated_grid("simulated block", ppd, lon, lat, radii, noise or None, None)


def tie_network(
    images: Sequence[PushbroomImage], passes: Sequence[Pass], rays: ImageRays, count: int, surface: Surface | None,
    heights: CommonErrors | None,
) -> Network:  # fmt: skip
    """Images whose orientation is that of their passes, `count` free tie points, their rays, a terrain model, and what
    heights above it have in common.
    """
    prior = passes[0].prior
    assert isinstance(prior, NodePrior | ProcessPrior)
    own, none = OrientationPrior(prior.node_sigmas(np.zeros(1))), np.zeros(0)  # of no effect: passes have their own
    return Network(
        images=tuple(images),
        priors=(own,) * len(images),
        held=np.zeros(len(images), dtype=bool),
        points=GroundPoints(
            ids=Names.of(f"P{i:07d}" for i in range(count)),
            classes=np.full(count, int(PointClass.TIE)),
            kinds=np.full(count, int(PointKind.FREE)),
            places=np.full((count, 3), np.nan),
            covariances=np.zeros((count, 3, 3)),
        ),
        rays=rays,
        ranges=Ranges(none.astype(np.int64), none.astype(np.int64), none, none, none),
        surface=surface,
        passes=tuple(passes),
        common_heights=heights,
    )


@dataclass(frozen=True, slots=True)
class TerrainErrors(Record):
    """A terrain model like MOLA's and its errors."""

    posts_per_degree: int = 64
    """Resolution of the grid."""
    vertical: float = 10.0
    """m rms, noise of each post; and the stated sigma of a point's height above the model (see `block_terrain`)."""
    planimetric: float = 200.0
    """m, sigma eastward and northward of the common shift, which is an unknown of the network; 0 for none."""
    missing: float = 0.0
    """Share of posts that are missing."""


def terrain_model(
    errors: TerrainErrors | None, relief: SiteTerrain, points: Array, rng: np.random.Generator
) -> tuple[Surface | None, CommonErrors | None, Array]:
    """Terrain model as control of points (n, 3) in m, what their heights have in common, and what it lacks of the
    truth, (1, 2) m east and north; no rows where posts miss, no shift (0, 2) without a model or where it has none.
    """
    if errors is None:
        return None, None, np.zeros((0, 2))
    shift = errors.planimetric * rng.standard_normal(2)
    grid = block_grid(relief, points, errors.posts_per_degree, errors.vertical, -shift, errors.missing, rng)
    sigmas = np.nan_to_num(grid.height_sigmas(points), nan=np.inf)
    surface, common = common_heights(Surface(grid, sigmas, errors.planimetric), points)
    return surface, common, shift[None][: 1 if errors.planimetric else 0]
